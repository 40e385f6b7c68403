"""The group `threads`: what more threads gain, on each scene of the gallery.

All counts in turns, so that a machine that slows down slows all. By the clock, and by the
processor, threads together: the first has also what waits, at the end of a picture or for a lock;
the second, which other programs hardly disturb, only what caches and memory that are shared cost.
And as many processes of one thread each: what the machine allows where nothing at all is shared.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import chain
from statistics import mean
from typing import Any

from .process import Worker
from .scenes import by_scene
from .summary import Row, ratios

# Speed-up over the number of threads, at least.
EFFICIENCY = 0.97
# Each holds the scene.
MOST_PROCESSES = 8


def threads(plan: Any, notes: Any) -> Iterator[Row]:
    """Seconds with 1, 2, 4, ... threads up to those of the plan, which come first."""
    return chain.from_iterable(by_scene(plan, notes, "threads", _scene))


def counts(most: int) -> list[int]:
    """The greatest first, then powers of two down to 1."""
    return [most, *(2**k for k in reversed(range(most.bit_length())) if 2**k < most)]


def named(count: int) -> str:
    return "1 thread" if count == 1 else f"{count} threads"


def _scene(plan: Any, notes: Any, name: str) -> list[Row]:
    from .gallery import load, picture_job
    from .measure import OURS, alternate

    pixels = plan.width * plan.height
    job = picture_job(name, load(name, pixels), pixels, plan.threads)
    tried = counts(plan.threads)
    apart = f"{plan.threads} processes"
    with ExitStack() as stack:
        workers = []
        for _ in range(plan.threads if 1 < plan.threads <= MOST_PROCESSES else 1):
            workers.append(Worker(OURS, job))
            stack.callback(workers[-1].close)
        notes.versions[OURS] = workers[0].known
        runs = [(named(n), partial(workers[0].render, plan.spp, threads=n)) for n in tried]
        if len(workers) > 1:
            runs.append((apart, partial(_together, workers, plan.spp)))
        answers = alternate(runs, plan.rounds)
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
    if apart in answers:
        # of the same number of pictures
        seconds = [a["seconds"] / plan.threads for a in answers[apart]]
        base = [a["seconds"] for a in answers[named(plan.threads)]]
        what, pairs = f"threads, {name}, clock", ratios(seconds, base)
        rows.append(Row(what, apart, "s", seconds, against=named(plan.threads), ratios=pairs))
    return rows


def _together(workers: list[Worker], spp: int) -> dict[str, Any]:
    """A picture by each at once, on one thread each. seconds: the mean of theirs."""
    with ThreadPoolExecutor(len(workers)) as pool:
        answers = list(pool.map(lambda worker: worker.render(spp, threads=1), workers))
    return {"seconds": mean(a["seconds"] for a in answers)}
