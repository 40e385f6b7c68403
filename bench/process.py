"""Child processes: one a renderer, that answers requests, and short ones whose start is timed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from .scenes import REPOSITORY, BenchError

SECONDS_A_REQUEST = 600.0

T = TypeVar("T")


def in_turn(runs: Iterable[T], turn: int) -> list[T]:
    """In the order of one of several turns, each with another first, and every second backwards:
    what one leaves to the next, such as a processor that is hot or threads that still spin, does
    not always meet the same one."""
    order = list(runs)
    first = turn % len(order)
    return (order[first:] + order[:first])[:: -1 if turn % 2 else 1]


class Worker:
    """A renderer in a process of its own, with its scene loaded; see bench/worker.py.

    known: what it says of itself. Raises BenchError if it cannot be had.
    """

    def __init__(self, renderer: str, job: dict[str, Any]) -> None:
        self.name = renderer
        self._process = subprocess.Popen(
            [sys.executable, "-m", "bench.worker", renderer],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=REPOSITORY,
            env=environment(),
        )
        assert self._process.stdin
        assert self._process.stdout
        self._requests, self._answers = self._process.stdin, self._process.stdout
        try:
            self.known = self.ask(job)
        except BenchError:
            self.close()
            raise

    def render(
        self, spp: int, seed: int = 0, save: Path | None = None, **options: Any
    ) -> dict[str, Any]:
        """Renders once. options: for ours, more arguments of parhelion.render()."""
        path = str(save) if save else None
        return self.ask({"spp": spp, "seed": seed, "save": path, "options": options})

    def close(self) -> None:
        """Ends the process, at once if it does not go by itself."""
        with suppress(OSError):
            self._requests.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._answers.close()

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """The answer to a request of the renderer's own kind."""
        # A renderer may hang (Mitsuba's pool has); killed, its pipe ends and so does the wait.
        limit = threading.Timer(SECONDS_A_REQUEST, self._process.kill)
        limit.start()
        try:
            self._requests.write(json.dumps(request) + "\n")
            self._requests.flush()
            line = self._answers.readline()
        except OSError:
            line = ""
        finally:
            limit.cancel()
        if not line:
            raise BenchError(f"{self.name}: ended, or gave no answer for {SECONDS_A_REQUEST:g} s")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise BenchError(f"{self.name}: {answer['error']}")
        return answer


def start_seconds(*arguments: str) -> float:
    """Wall-clock time of a whole Python process, from before its start to after its end."""
    start = time.perf_counter()
    run(*arguments)
    return time.perf_counter() - start


def run(*arguments: str) -> str:
    """What a Python process writes to stdout. Raises BenchError if it fails."""
    try:
        done = subprocess.run(
            [sys.executable, *arguments],
            capture_output=True,
            text=True,
            cwd=REPOSITORY,
            env=environment(),
            timeout=SECONDS_A_REQUEST,
        )
    except subprocess.TimeoutExpired:
        name = " ".join(arguments)
        raise BenchError(f"python {name}: took over {SECONDS_A_REQUEST:g} s") from None
    if done.returncode:
        raise BenchError(f"python {' '.join(arguments)}: {done.stderr.strip()[-300:]}")
    return done.stdout


def environment() -> dict[str, str]:
    """Ours, but compiled Python is kept, as it is for everyone whose Python is installed."""
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
