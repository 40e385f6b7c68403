"""Loads every file of a folder that is in a format we read, and writes docs/files.md.

    python docs/files.py ../shared/scenes

Each file is loaded and prepared in a process of its own, so that neither its memory nor a crash is
another's. The folder is a collection of scenes and data that others made; it is not part of this
repository.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from parhelion.io import COMPRESSED, FORMATS

PAGE = Path(__file__).parent / "files.md"
PARTS = {"models", "meshes", "geometry", "include", "fragments"}  # folders of scenes' parts
# What tells files of formats that we read from others of the same ending
OWN = {".xml": b"<scene version", ".json": b'"parhelion"'}
SECONDS = 300.0  # for one file

# Loads the file it is given and prints what there is to say, as JSON. Other scenes' meshes and
# textures lie in folders beside theirs.
WORKER = """
import json, logging, resource, sys, time
import parhelion as ph

notes = []
class Keep(logging.Handler):
    def emit(self, record):
        notes.append(record.getMessage().partition(": ")[2])
log = logging.getLogger("parhelion")
log.addHandler(Keep())
log.propagate = False
path, root = sys.argv[1:]
said = {}
start = time.perf_counter()
try:
    scene = ph.load(path, ph.LoadOptions(allow_paths=(root,)))
    said["load"] = time.perf_counter() - start
    prepared = ph.prepare(scene)
    said["prepare"] = prepared.seconds
    groups = prepared.flat.parts["groups"]
    own = [s for group in groups for s in group if s["kind"] != "instance"]
    said["primitives"] = sum(s["count"] for s in own)
    said["copies"] = sum(s["count"] for g in groups for s in g if s["kind"] == "instance")
except ph.ParhelionError as error:
    said["error"] = str(error)
said["notes"] = notes
said["mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps(said))
"""


def files(root: Path) -> Iterator[Path]:
    """Those of known endings, in order, without the parts of scenes and other programs' XML."""
    for path in sorted(root.rglob("*")):
        suffixes = [s.lower() for s in path.suffixes]
        if suffixes and suffixes[-1] in COMPRESSED:
            suffixes.pop()
        if not (path.is_file() and suffixes and suffixes[-1] in FORMATS):
            continue
        mark = OWN.get(suffixes[-1], b"")
        if set(path.relative_to(root).parts) & PARTS or mark not in path.read_bytes()[:4096]:
            continue
        yield path


def measured(path: Path, root: Path) -> dict[str, Any]:
    """What the worker says of a file."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", WORKER, str(path), str(root)],
            capture_output=True,
            text=True,
            timeout=SECONDS,
            check=True,
        )
    except subprocess.TimeoutExpired:
        return {"error": f"takes over {SECONDS:g} s", "notes": []}
    except subprocess.CalledProcessError as error:
        return {"error": f"ended with {error.returncode}: {error.stderr[-200:]}", "notes": []}
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return said


def row(name: str, said: dict[str, Any], root: Path) -> str:
    """A line of the table."""

    def text(words: str) -> str:
        return words.replace(str(root.resolve()) + "/", "").replace("|", "\\|").replace("\n", " ")

    if "error" in said:
        return f"| {name} | | | | not read: {text(said['error'])[:300]} |"
    count = f"{said['primitives']:,}"
    if said["copies"]:
        count += f", {said['copies']:,} copies"
    notes = "; ".join(text(note) for note in said["notes"][:12])
    more = f"; and {len(said['notes']) - 12} more" if len(said["notes"]) > 12 else ""
    times = f"{said['load']:.2f} + {said['prepare']:.2f}"
    return f"| {name} | {count} | {times} | {said['mib']:.0f} | {notes}{more} |"


def main() -> None:
    """Writes the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="scenes that others made")
    folder = parser.parse_args().folder.resolve()
    rows = []
    for path in files(folder):
        name = path.relative_to(folder).as_posix()
        print(name, file=sys.stderr)
        rows.append(row(name, measured(path, folder), folder))
    PAGE.write_text(
        "# Files that others made\n\n"
        "Written by `python docs/files.py ../shared/scenes`: every file of that collection that\n"
        "is in a format we read, but for the parts of scenes. Seconds are those of loading, and\n"
        "of checking and building trees, each file once, in a process of its own on two shared\n"
        "cores. MiB is the most memory that the process took, some 50 of which are Python's. What\n"
        "a file asks for and we do not do is told as `parhelion render` tells it.\n\n"
        "| file | primitives | seconds | MiB | not supported |\n| --- | --- | --- | --- | --- |\n"
        + "\n".join(rows)
        + "\n"
    )


if __name__ == "__main__":
    main()
