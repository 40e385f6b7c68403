"""Amdahl's law fitted to measured times, and the Karp-Flatt metric."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Amdahl:
    """T(n) = t1 (serial + (1 - serial) / n), the time on n threads in seconds.

    serial: the fraction of the one-thread time that no number of threads makes shorter, 0 to 1.
    residual: root mean square of measured minus fitted seconds. threads: the counts fitted.
    """

    t1: float
    serial: float
    residual: float
    threads: tuple[int, ...]

    def seconds(self, threads: float) -> float:
        """The fitted time on this many threads."""
        return self.t1 * (self.serial + (1 - self.serial) / threads)

    def speedup(self, threads: float) -> float:
        """The fitted speed-up on this many threads; 1 on one thread."""
        return 1 / (self.serial + (1 - self.serial) / threads)

    @property
    def limit(self) -> float:
        """The speed-up that no number of threads passes; infinite without a serial part."""
        return 1 / self.serial if self.serial > 0 else math.inf

    @property
    def exact(self) -> bool:
        """Whether two counts were fitted: two unknowns, so the residual says nothing."""
        return len(self.threads) == 2


def fit(threads: Sequence[int], seconds: Sequence[float]) -> Amdahl | None:
    """The least-squares fit of Amdahl's law, with the serial fraction held in [0, 1].

    threads, seconds: as long as each other; seconds > 0. Returns None with fewer than two
    different counts, which do not determine the two unknowns.
    """
    if len(set(threads)) < 2:
        return None

    # T = a + b/n with a = t1 serial and b = t1 (1 - serial) is linear, and serial in [0, 1] is
    # a >= 0 and b >= 0. The problem is convex: where the free minimum breaks a bound, the
    # minimum lies on one of the two edges.
    x = [1 / n for n in threads]
    mean_x, mean_t = sum(x) / len(x), sum(seconds) / len(seconds)
    slope = sum((u - mean_x) * (t - mean_t) for u, t in zip(x, seconds, strict=True)) / sum(
        (u - mean_x) ** 2 for u in x
    )
    candidates = [(mean_t - slope * mean_x, slope)]
    if min(candidates[0]) < 0:
        through_origin = sum(u * t for u, t in zip(x, seconds, strict=True)) / sum(u * u for u in x)
        candidates = [(0.0, through_origin), (mean_t, 0.0)]

    def squares(ab: tuple[float, float]) -> float:
        a, b = ab
        return sum((a + b * u - t) ** 2 for u, t in zip(x, seconds, strict=True))

    a, b = min(candidates, key=squares)
    return Amdahl(
        t1=a + b,
        serial=a / (a + b),
        residual=math.sqrt(squares((a, b)) / len(x)),
        threads=tuple(threads),
    )


def karp_flatt(speedup: float, threads: int) -> float | None:
    """The serial fraction that explains one measured speed-up by itself; None on one thread.

    Below zero for a speed-up above the number of threads. Where it rises with the thread count,
    the loss is not a fixed serial part but something that grows: waiting, memory traffic.
    """
    if threads == 1:
        return None
    return (1 / speedup - 1 / threads) / (1 - 1 / threads)
