"""What the runs of a study amount to: a point a combination, and a fit a width and schedule."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from . import amdahl

if TYPE_CHECKING:
    from .measure import Run, Study


@dataclass(frozen=True)
class Point:
    """All runs of one width, thread count and schedule.

    Seconds: median, least, greatest, and the quartiles q1 and q3. speedup: the median on one
    thread over this median, None before one thread was measured. efficiency: speed-up per thread.
    karp_flatt: see amdahl.karp_flatt. busy: processor seconds per second, the number of cores
    that were at work on average.

    useful, extra, waiting: how the threads' time, seconds x threads, was spent; they add up to 1.
    useful: processor time that one thread needs as well. extra: processor time on top of that,
    as on cores that share a cache, clock or arithmetic unit, or that spin while they wait.
    waiting: the rest, without a core or without work.
    """

    width: int
    height: int
    threads: int
    schedule: str
    oversubscribed: bool
    runs: int
    median: float
    least: float
    greatest: float
    q1: float
    q3: float
    samples_per_second: float
    rays_per_second: float
    busy: float
    speedup: float | None = None
    efficiency: float | None = None
    karp_flatt: float | None = None
    useful: float | None = None
    extra: float | None = None
    waiting: float | None = None


@dataclass(frozen=True)
class Summary:
    """Points in the order width, schedule, threads; fits by (width, schedule), None for no fit."""

    points: list[Point]
    fits: dict[tuple[int, str], amdahl.Amdahl | None]

    def of(self, width: int, schedule: str) -> list[Point]:
        """The points of one width and schedule, by rising thread count."""
        return [p for p in self.points if p.width == width and p.schedule == schedule]

    def point(self, width: int, schedule: str, threads: int) -> Point | None:
        """One point, or None where it was not measured."""
        return next((p for p in self.of(width, schedule) if p.threads == threads), None)

    @property
    def widths(self) -> list[int]:
        """The widths measured, rising."""
        return sorted({p.width for p in self.points})


def summarize(study: Study) -> Summary:
    """Works out a study, complete or not."""
    points: list[Point] = []
    fits: dict[tuple[int, str], amdahl.Amdahl | None] = {}
    for width in study.plan.widths:
        for schedule in study.plan.schedules:
            base: list[Run] = []
            line: list[Point] = []
            for threads in study.plan.threads:
                runs = [
                    run
                    for run in study.runs
                    if (run.width, run.schedule, run.threads) == (width, schedule, threads)
                ]
                if not runs:
                    continue
                if threads == 1:
                    base = runs
                line.append(_point(runs, base))
            usable = [p for p in line if not p.oversubscribed]
            if line:
                fits[width, schedule] = amdahl.fit(
                    [p.threads for p in usable], [p.median for p in usable]
                )
            points += line
    return Summary(points, fits)


def quartiles(values: list[float]) -> tuple[float, float]:
    """First and third quartile, linear between the sorted values (as numpy.quantile does)."""
    ordered = sorted(values)

    def at(fraction: float) -> float:
        place = fraction * (len(ordered) - 1)
        below = int(place)
        above = min(below + 1, len(ordered) - 1)
        return ordered[below] + (place - below) * (ordered[above] - ordered[below])

    return at(0.25), at(0.75)


def _point(runs: list[Run], base: list[Run]) -> Point:
    first = runs[0]
    threads = first.threads
    # Floors: a clock may tick too coarsely to see a very small picture.
    seconds = [max(run.seconds, 1e-9) for run in runs]
    middle = median(seconds)
    cpu = median(run.cpu_seconds for run in runs)
    q1, q3 = quartiles(seconds)
    speedup = efficiency = karp_flatt = useful = extra = waiting = None
    if base:
        speedup = median(max(run.seconds, 1e-9) for run in base) / middle
        efficiency = speedup / threads
        karp_flatt = amdahl.karp_flatt(speedup, threads)
        base_cpu = median(run.cpu_seconds for run in base)
        useful_seconds = min(base_cpu, cpu)
        extra_seconds = max(cpu - base_cpu, 0.0)
        waiting_seconds = max(threads * middle - cpu, 0.0)
        whole = max(useful_seconds + extra_seconds + waiting_seconds, 1e-9)
        useful, extra = useful_seconds / whole, extra_seconds / whole
        waiting = waiting_seconds / whole
    return Point(
        width=first.width,
        height=first.height,
        threads=threads,
        schedule=first.schedule,
        oversubscribed=first.oversubscribed,
        runs=len(runs),
        median=middle,
        least=min(seconds),
        greatest=max(seconds),
        q1=q1,
        q3=q3,
        samples_per_second=first.samples / middle,
        rays_per_second=first.rays / middle,
        busy=cpu / middle,
        speedup=speedup,
        efficiency=efficiency,
        karp_flatt=karp_flatt,
        useful=useful,
        extra=extra,
        waiting=waiting,
    )
