"""Cases, the worker that loads them, and what counts as a finding."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random
from types import TracebackType
from typing import Any

from .mutate import mutated

# Seconds of the processor's time, and by the clock, that a file may take
SECONDS = 10.0
WALL = 60.0
# Bytes of memory that any file may take, and how many times its size beyond that
MEMORY = 1 << 30
RATIO = 20
# Bytes by which the worker may grow over the cases it lives through
GROWTH = 400 << 20


@dataclass(frozen=True)
class Case:
    """Files by name, one of which is loaded. spoilt: those that are mutated; none for all.

    options: of LoadOptions.
    """

    main: str
    files: dict[str, bytes]
    spoilt: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    def size(self) -> int:
        return sum(len(data) for data in self.files.values())

    def write(self, folder: Path) -> Path:
        """Puts the files where nothing else is; the path of the one to load."""
        shutil.rmtree(folder, ignore_errors=True)
        for name, data in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        return folder / self.main


def read_cases(folder: Path, endings: tuple[str, ...], largest: int = 64_000) -> list[Case]:
    """Files of those endings below a folder, each with what else lies beside it."""
    found = []
    for path in sorted(folder.rglob("*")):
        if not path.name.lower().endswith(endings) or not path.is_file() or path.is_symlink():
            continue
        if path.stat().st_size > largest:
            continue
        beside = [path]
        for other in sorted(path.parent.rglob("*")):
            if other != path and other.is_file() and len(beside) < 20:
                beside.append(other)
        files: dict[str, bytes] = {}
        for other in beside:
            if sum(map(len, files.values())) + other.stat().st_size <= largest:
                with contextlib.suppress(OSError):
                    files[other.relative_to(path.parent).as_posix()] = other.read_bytes()
        if path.name in files:
            found.append(Case(path.name, files))
    return found


def made(seeds: list[Case], random: Random, options: Sequence[Mapping[str, Any]] = ({},)) -> Case:
    """A seed with one or two of its files spoilt, to be loaded with some of the options."""
    seed = random.choice(seeds)
    names = list(seed.spoilt or seed.files)
    if seed.main in names:
        names += [seed.main] * len(names)
    files = dict(seed.files)
    for name in {random.choice(names) for _ in range(random.choice([1, 1, 1, 2]))}:
        ending = name.rpartition(".")[2]
        others = [
            data
            for other in random.sample(seeds, min(4, len(seeds)))
            for n, data in other.files.items()
            if n.rpartition(".")[2] == ending
        ]
        files[name] = mutated(name, files[name], random, others or [files[name]])
    return replace(seed, files=files, options=random.choice(options))


class Worker:
    """A process that loads cases; a new one takes its place when it is gone."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cpu = 0.0  # seconds that processes before this one took
        self.process: subprocess.Popen[bytes] | None = None
        self.resident = 0
        folder.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.stop()

    def start(self) -> None:
        temporary = self.folder / "tmp"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir()
        source = Path(__file__).resolve().parent / "worker.py"
        environment = os.environ | {
            "TMPDIR": str(temporary), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
            "MALLOC_ARENA_MAX": "2", "PXR_WORK_THREAD_LIMIT": "1",
        }  # fmt: skip
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, str(source)],
            start_new_session=True,  # signals are for the harness
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors, env=environment,
            cwd=self.folder,
        )  # fmt: skip
        self.buffer = b""
        if self._answer(WALL)[0] is None:
            raise RuntimeError(f"the worker does not start: {self._stderr()}")
        self.resident = 0

    def stop(self) -> None:
        if self.process is not None:
            self.cpu += self._seconds()
            self.process.kill()
            self.process.wait()
            for pipe in (self.process.stdin, self.process.stdout, self.errors):
                assert pipe is not None
                pipe.close()
            self.process = None

    def seconds(self) -> float:
        """Seconds of the processor's time that all processes have taken."""
        return self.cpu + (self._seconds() if self.process else 0.0)

    def load(self, case: Case) -> dict[str, Any]:
        """What comes of a case: see worker.case; crashes, hangs and memory are findings too."""
        if self.process is None:
            self.start()
        assert self.process is not None
        assert self.process.stdin is not None
        path = case.write(self.folder / "case")
        self.errors.seek(0)
        self.errors.truncate()
        request = {"path": str(path), "options": dict(case.options)}
        self.process.stdin.write(json.dumps(request).encode() + b"\n")
        self.process.stdin.flush()
        said, why = self._answer(WALL)
        if said is None:
            text = self._stderr()
            at = re.findall(r'File ".*/parhelion/(.*)", line \d+ in (\w+)', text)
            place = ":".join(at[0]) if at else ""
            said = {"outcome": "finding", "kind": why, "text": text[:4000], "place": place}
            self.stop()
        else:
            allowed = max(MEMORY, RATIO * case.size())
            if said["outcome"] != "finding":
                if said["peak"] > allowed:
                    said |= {"outcome": "finding", "kind": "memory"}
                elif said["leaks"]:
                    said |= {"outcome": "finding", "kind": "leak: " + ", ".join(said["leaks"])}
            self.resident = self.resident or said["resident"]
            if said["resident"] - self.resident > GROWTH:
                said["grown"] = said["resident"] - self.resident
                self.stop()
        return said

    def _answer(self, wall: float) -> tuple[dict[str, Any] | None, str]:
        """The worker's next line, or None and why there is none."""
        assert self.process is not None
        assert self.process.stdout is not None
        pipe = self.process.stdout.fileno()
        begun, used = time.monotonic(), self._seconds()
        while b"\n" not in self.buffer:
            ready = select.select([pipe], [], [], 0.25)[0]
            if ready:
                part = os.read(pipe, 1 << 16)
                if not part:
                    code = self.process.wait()
                    name = signal.Signals(-code).name if code < 0 else f"exit {code}"
                    return None, f"ended by {name}"
                self.buffer += part
            elif self._seconds() - used > SECONDS or time.monotonic() - begun > wall:
                self.process.send_signal(signal.SIGUSR1)  # has it say where it is
                time.sleep(0.5)
                return None, f"over {SECONDS:g} s"
        line, _, self.buffer = self.buffer.partition(b"\n")
        said: dict[str, Any] = json.loads(line)
        return said, ""

    def _seconds(self) -> float:
        """Of the processor's time, by the process that is there."""
        assert self.process is not None
        try:
            fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0.0
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _stderr(self) -> str:
        self.errors.seek(0)
        return self.errors.read().decode("utf-8", "replace")


def words(said: dict[str, Any]) -> str:
    """What a message says, but for names and numbers: to tell messages of other kinds apart."""
    text = re.sub(r"'.*?'|\".*?\"|[-+]?[\d.]+(e[-+]?\d+)?", "#", said.get("text", ""))
    return f"{said['outcome']} {said.get('place', '')} {text[:120]}"


def signature(said: dict[str, Any]) -> str:
    """What findings of one cause share."""
    return f"{said['kind']} at {said.get('place', '')}"


def shrunk(case: Case, same: Callable[[Case], bool], seconds: float) -> Case:
    """A smaller case for which `same` still holds, as far as time allows."""
    end = time.monotonic() + seconds
    for name in list(case.files):
        if name != case.main:
            less = replace(case, files={k: v for k, v in case.files.items() if k != name})
            if same(less):
                case = less
    for name in list(case.files):
        data = case.files[name]
        size = len(data) // 2
        while size and time.monotonic() < end:
            at = 0
            while at < len(data) and time.monotonic() < end:
                less = data[:at] + data[at + size :]
                if same(replace(case, files=case.files | {name: less})):
                    data = less
                else:
                    at += size
            size //= 2
        case = replace(case, files=case.files | {name: data})
    return case


@dataclass
class Tally:
    """What came of many cases. findings: one case and what was said, by signature."""

    cases: int = 0
    loaded: int = 0
    refused: int = 0
    cpu: float = 0.0
    slowest: float = 0.0
    most: int = 0
    kinds: set[str] = field(default_factory=set)
    findings: dict[str, tuple[Case, dict[str, Any]]] = field(default_factory=dict)


def cases(
    reader: str,
    seeds: list[Case],
    learned: list[Case],
    seed: int,
    options: Sequence[Mapping[str, Any]],
) -> Iterator[Case]:
    """Endlessly many cases: the seeds as they are, then spoilt ones."""
    yield from seeds
    number = 0
    while True:
        random = Random(f"{reader} {seed} {number}")
        # what is refused already ends early, whatever else is wrong with it
        again = learned and random.random() < 0.25
        yield made(learned if again else seeds, random, options)
        number += 1


def run(
    worker: Worker,
    reader: str,
    seeds: list[Case],
    *,
    seed: int = 0,
    options: Sequence[Mapping[str, Any]] = ({},),
    seconds: float = float("inf"),
    count: int | None = None,
    learn: bool = False,
    found: Callable[[str, Case, dict[str, Any]], None] = lambda *_: None,
    ended: Callable[[], bool] = lambda: False,
) -> Tally:
    """Loads cases until so many seconds of the worker's time, or so many cases, are gone, or it is
    ended.

    learn: a case with an outcome of a kind that was not seen before becomes a seed.
    """
    tally = Tally()
    learned: list[Case] = []
    begun = worker.seconds()
    for case in cases(reader, seeds, learned, seed, options):
        tally.cpu = worker.seconds() - begun
        if tally.cpu >= seconds or (count is not None and tally.cases >= count) or ended():
            break
        said = worker.load(case)
        tally.cases += 1
        tally.loaded += said["outcome"] == "loaded"
        tally.refused += said["outcome"] == "refused"
        tally.slowest = max(tally.slowest, said.get("seconds", 0.0))
        tally.most = max(tally.most, said.get("peak", 0))
        if said["outcome"] == "finding":
            name = signature(said)
            if name not in tally.findings:
                tally.findings[name] = case, said
                found(name, case, said)
        elif learn and (kind := words(said)) not in tally.kinds:
            tally.kinds.add(kind)
            learned.append(case)
    return tally
