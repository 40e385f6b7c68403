"""One module a renderer. Each has

    open(job: dict) -> tuple[dict, Callable[[dict], dict]]

which makes the scene of a job (see bench/measure.py) and returns what is known of the renderer and
a function that renders once. That takes {"spp", "seed", "save", ...} and returns {"seconds",
"cpu_seconds", ...}: wall-clock time of rendering alone, and of the processor, all threads together.
"save" names a .npy file for the linear picture, or is None.

Each runs in a process of its own; see bench/worker.py.
"""

from __future__ import annotations

import time
from typing import Any


class Clock:
    """Times what is done within it: on the clock, and of the processor, all threads together."""

    def __enter__(self) -> Clock:
        self._start = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_error: Any) -> None:
        self._end = time.perf_counter(), time.process_time()

    def times(self) -> dict[str, float]:
        """What an answer has of it."""
        (start, cpu), (end, cpu_end) = self._start, self._end
        return {"seconds": end - start, "cpu_seconds": cpu_end - cpu}
