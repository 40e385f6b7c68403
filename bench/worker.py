"""The child process in which one renderer runs: `python -m bench.worker RENDERER`.

Reads JSON, one object a line: the job first, then requests. Answers each with one line, {"error"}
where something went wrong. Ends at the end of its input.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import sys
import traceback
from typing import Any

from .scenes import BenchError


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it is for who asks to say something
    # Renderers print what they like to stdout; answers go where only we write.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    render = None
    for line in sys.stdin:
        try:
            request = json.loads(line)
            if render is None:
                limit_cores(request["threads"])
                module = importlib.import_module(f"bench.renderers.{sys.argv[1]}")
                answer, render = module.open(request)
            else:
                answer = render(request)
            answer["peak_bytes"] = peak_bytes()
        except BenchError as error:
            answer = {"error": str(error)}
        except ImportError as error:
            answer = {"error": f"not installed: {error}"}
        except Exception as error:
            # Not imported for the others' processes: ours would count in their memory.
            ours = sys.modules.get("parhelion.errors")
            if ours is None or not isinstance(error, ours.ParhelionError):
                traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")


def limit_cores(threads: int) -> None:
    """Keeps this process to as many cores as it shall use, the same ones for every renderer."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])


def peak_bytes() -> int:
    """The most memory that this process has held.

    Not from getrusage() where that can be helped: on Linux a child's figure starts at its parent's.
    """
    peak = status_bytes("VmHWM")
    if peak is not None:
        return peak
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def status_bytes(field: str) -> int | None:
    """What Linux says of this process's memory; None elsewhere."""
    try:
        with open("/proc/self/status") as status:
            fields: dict[str, Any] = dict(line.split(":", 1) for line in status)
    except OSError:
        return None
    return int(fields[field].split()[0]) * 1024


if __name__ == "__main__":
    main()
