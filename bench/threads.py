"""The group `threads`: what more threads gain, on each scene of the gallery.

All counts in turns, so that a machine that slows down slows all. By the clock, and by the
processor, threads together: the first has also what waits, at the end of a picture or for a lock;
the second, which other programs hardly disturb, only what caches and memory that are shared cost.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from .process import Worker
from .scenes import BenchError
from .summary import Row, ratios

# Speed-up over the number of threads, at least.
EFFICIENCY = 0.97


def threads(plan: Any, notes: Any) -> list[Row]:
    """Seconds with 1, 2, 4, ... threads up to those of the plan, which come first."""
    rows = []
    for name in plan.scenes:
        print(f"measuring: {name}", file=sys.stderr)
        try:
            rows += _scene(plan, notes, name)
        except BenchError as problem:
            notes.add(f"threads, {name}: not measured: {problem}")
    return rows


def counts(most: int) -> list[int]:
    """The greatest first, then powers of two down to 1."""
    return [most, *(2**k for k in reversed(range(most.bit_length())) if 2**k < most)]


def named(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def _scene(plan: Any, notes: Any, name: str) -> list[Row]:
    from .gallery import load
    from .measure import OURS, alternate

    s = load(name, plan.width * plan.height).settings
    job = {"scene": name, "pixels": plan.width * plan.height, "threads": plan.threads}
    worker = Worker(OURS, job | {"width": s.width, "height": s.height, "depth": s.max_depth})
    notes.versions[OURS] = worker.known
    try:
        tried = counts(plan.threads)
        runs = [(named(n), partial(worker.render, plan.spp, threads=n)) for n in tried]
        answers = alternate(runs, plan.rounds)
    finally:
        worker.close()
    rows = []
    for words, clock in (("clock", "seconds"), ("processor", "cpu_seconds")):
        values = {n: [a[clock] for a in answers[named(n)]] for n in tried}
        base = values[plan.threads]
        for n in tried:
            # By the clock k times as many threads shall take a k-th, by the processor as much.
            gain = plan.threads / n if clock == "seconds" else 1.0
            pairs = (
                {}
                if n == plan.threads
                else {
                    "against": named(plan.threads),
                    "ratios": ratios(values[n], base),
                    "least_ratio": EFFICIENCY * gain,
                }
            )
            rows.append(Row(f"threads, {name}, {words}", named(n), "s", values[n], **pairs))
    return rows
