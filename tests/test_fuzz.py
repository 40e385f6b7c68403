"""The fuzzer of tests/fuzz for some 20 s: always the same files, each spoilt in another way.

It runs for hours while readers are written; docs/validation.md says for how long and what it found.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest

from fuzz.harness import Case, Worker, made, read_cases, run, shrunk, signature
from fuzz.seeds import OPTIONS, READERS

# The worker asks Linux for the memory it takes
pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")

# Spoilt files of each reader
COUNT = 30


@pytest.fixture(scope="module")
def worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Worker]:
    with Worker(tmp_path_factory.mktemp("fuzz")) as worker:
        yield worker


@pytest.mark.parametrize("reader", READERS)
def test_spoilt_files_are_read_or_refused(worker: Worker, reader: str) -> None:
    seeds = READERS[reader][1]()
    if not seeds:
        pytest.skip(f"what {reader} files need is not installed")
    for case in seeds:
        said = worker.load(case)
        assert said["outcome"] == "loaded", f"{case.main}: {said['text']}"
    tally = run(
        worker, reader, seeds, seed=1, count=len(seeds) + COUNT, options=OPTIONS.get(reader, ({},))
    )
    found = [f"{name}: {said['text']}" for name, (_, said) in tally.findings.items()]
    assert not found, "\n".join(found)
    assert tally.refused > COUNT / 10


def test_cases_depend_on_nothing_but_their_number() -> None:
    seeds = READERS["obj"][1]()
    assert made(seeds, Random("obj 1 2")) == made(seeds, Random("obj 1 2"))
    assert made(seeds, Random("obj 1 2")) != made(seeds, Random("obj 1 3"))


HOOK = """
import atexit, os, sys, tempfile, time
import parhelion.io as readers
def load(path, options=None):
    word = open(path).read().split()[0]
    if word == "crash":
        os.abort()
    if word == "exit":
        os._exit(3)
    if word == "hang":
        while True:
            pass
    if word == "wrong":
        raise KeyError("word")
    if word == "memory":
        keep = b"x" * (5 << 28)
    if word == "huge":
        bytearray(1 << 45)
    if word == "nameless":
        raise readers.FormatError("no file")
    if word == "escape":
        raise readers.FormatError(f"{path}: {'x' * 900} {'y' * 900} {'z' * 900}" + chr(10) * 2000)
    if word == "open":
        keep_open.append(open(path))
    if word == "file":
        os.close(tempfile.mkstemp()[0])
    return ph.Scene(shapes=(ph.Spheres([[0.0, 0.0, 0.0]], 1.0),))
keep_open = []
import parhelion as ph
ph.load = load
"""


@pytest.mark.parametrize(
    ("word", "kind"),
    [
        ("crash", "ended by SIGABRT"),
        ("exit", "ended by exit 3"),
        ("hang", "over 1 s"),
        ("wrong", "KeyError"),
        ("memory", "memory"),
        ("huge", "memory"),
        ("nameless", "no file named"),
        ("escape", "unclear text"),
        ("open", "leak: 1 open files"),
        ("file", "leak: 1 temporary files"),
        ("fine", ""),
    ],
)
def test_what_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str, kind: str
) -> None:
    """A loader with each fault that the harness has to notice."""
    (tmp_path / "sitecustomize.py").write_text(HOOK)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    if word == "hang":  # the others take what they take
        monkeypatch.setattr("fuzz.harness.SECONDS", 1.0)
    with Worker(tmp_path / "worker") as worker:
        said = worker.load(Case("a.xyz", {"a.xyz": f"{word} and more".encode()}))
        assert said["outcome"] == ("finding" if kind else "loaded")
        assert said.get("kind", "") == kind
        if word == "crash":  # another one takes its place; the finding is made small
            whole = Case("a.xyz", {"a.xyz": b"crash" + b" and more" * 9, "b.xyz": b""})

            def same(case: Case) -> bool:
                found = worker.load(case)
                return found["outcome"] == "finding" and signature(found) == signature(said)

            small = shrunk(whole, same, 120.0)  # much less, but on a busy machine
            assert small.files == {"a.xyz": b"crash"}


def test_files_that_lie_beside_others_come_with_them(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    for name in ("a.obj", "a.mtl", "inner/b.obj"):
        (tmp_path / name).write_text(name)
    first, second = read_cases(tmp_path, (".obj",))
    assert first.main == "a.obj"
    assert set(first.files) == {"a.obj", "a.mtl", "inner/b.obj"}
    assert second == Case("b.obj", {"b.obj": b"inner/b.obj"})
