"""The process that loads the cases: a line with a file's path in, a line of JSON out.

It lives through as many cases as it survives. Its first line tells that it is ready.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import json
import logging
import os
import resource
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import parhelion as ph
from parhelion.errors import ParhelionError

SELF = Path("/proc/self")
PAGE = resource.getpagesize()
# Bytes of address space for a case, beyond what the idle worker has: above what may be resident,
# since address space that is not used costs nothing, and low enough to stop what runs away.
ROOM = 3 << 30
# The longest message that is still one clear error
LONGEST = 2000


def status(field: str) -> int:
    """Bytes that /proc tells of this process."""
    for line in (SELF / "status").read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) << 10
    raise KeyError(field)


def reset_peak() -> None:
    """Has VmHWM begin anew (Linux, proc(5))."""
    (SELF / "clear_refs").write_text("5")


def left_over() -> dict[str, int]:
    """What a case must not leave behind."""
    children = sum(len(p.read_text().split()) for p in SELF.glob("task/*/children"))
    temporary = sum(len(files) for _, _, files in os.walk(os.environ["TMPDIR"]))
    return {
        "open files": len(os.listdir(SELF / "fd")),
        "processes": children,
        "temporary files": temporary,
    }


def memory_error(error: BaseException | None) -> bool:
    """Whether an error is one of memory, which no reader has put in its own words."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return False


def place(error: BaseException) -> str:
    """The innermost line of the package that an error passed through."""
    found = ""
    for frame in traceback.extract_tb(error.__traceback__):
        if f"{os.sep}parhelion{os.sep}" in frame.filename:
            file = frame.filename.rpartition(f"{os.sep}parhelion{os.sep}")[2]
            found = f"{file}:{frame.name}: {frame.line}"
    return found


class Notes(logging.Handler):
    """Keeps what readers say that they do not do."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


def case(path: str, options: dict[str, Any], notes: Notes) -> dict[str, Any]:
    """Loads, prepares and renders a file: what came of it."""
    said: dict[str, Any] = {"outcome": "loaded", "text": ""}
    notes.lines.clear()
    folder = str(Path(path).parent)
    stage = "load"
    try:
        scene = ph.load(path, ph.LoadOptions(**options))
        stage = "prepare"
        prepared = ph.prepare(scene)
        stage = "render"
        ph.render(prepared, width=8, height=8, crop=None, spp=1, max_depth=4, threads=1)
        said["text"] = "; ".join(notes.lines)[:LONGEST]
    except ParhelionError as error:
        said |= {"outcome": "refused", "text": str(error), "place": place(error)}
        if memory_error(error):
            said |= {"outcome": "finding", "kind": "memory", "trace": traceback.format_exc()}
        elif stage == "load" and not str(error).startswith(folder):
            said |= {"outcome": "finding", "kind": "no file named"}
        elif len(str(error).replace(folder, "")) > LONGEST or not all(
            c.isprintable() or c == "\n" for c in str(error).replace(path, "")
        ):
            said |= {"outcome": "finding", "kind": "unclear text"}
    except Exception as error:
        kind = "memory" if memory_error(error) else type(error).__name__
        said = {"outcome": "finding", "kind": kind, "text": str(error)[:LONGEST]}
        said |= {"place": place(error), "trace": traceback.format_exc()}
    said["stage"] = stage
    said["text"] = said["text"].replace(folder, "")
    return said


def main() -> None:
    # Libraries print; answers go where they do not.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    log = logging.getLogger("parhelion")
    notes = Notes()
    log.addHandler(notes)
    log.propagate = False
    # Matplotlib, OpenMP's threads and so on are there before anything is counted.
    warm = ph.Scene(shapes=(ph.Spheres([[0.0, 0.0, 0.0]], 1.0),))
    ph.render(warm, width=8, height=8, spp=1, threads=1)
    room = status("VmSize") + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (room, room))
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        request, before = json.loads(line), left_over()
        reset_peak()
        start, resident = time.process_time(), status("VmRSS")
        said = case(request["path"], request["options"], notes)
        said["seconds"] = time.process_time() - start
        said["peak"] = status("VmHWM") - resident
        gc.collect()
        said["leaks"] = [
            f"{after - before[what]} {what}"
            for what, after in left_over().items()
            if after > before[what]
        ]
        said["resident"] = status("VmRSS")
        print(json.dumps(said), file=answers, flush=True)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()
