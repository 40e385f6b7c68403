"""The published figures of the study that this package grew out of.

A sphere path tracer in C++, written first as a serial program and then parallelised with OpenMP,
was timed on pictures of 16:9 at 20 samples per pixel and depth 50. Neither the machine nor the
number of its cores is published with the figures.
"""

from __future__ import annotations

THREADS = (1, 2, 4, 6, 8, 12, 16, 32)
"""Thread counts; 1 stands for the serial program."""

WIDTHS = (120, 240, 480, 960)
"""Picture widths in pixels."""

ASPECT, SPP, MAX_DEPTH = "16:9", 20, 50

SECONDS = (
    (9.75, 40.86, 167.06, 711.46),
    (6.28, 26.78, 113.66, 428.56),
    (4.05, 19.30, 74.15, 296.31),
    (2.87, 15.46, 57.96, 250.39),
    (2.53, 14.46, 52.20, 227.62),
    (2.36, 13.35, 55.03, 220.34),
    (2.19, 9.90, 39.82, 174.61),
    (3.67, 9.56, 50.70, 224.64),
)
"""Seconds of rendering: a row a thread count, a column a width."""

BEST_THREADS = 16
"""The count the study found best; Amdahl's law is fitted up to here, since 32 threads were slower
at three of the four widths and the law has no way to become slower."""


def seconds(threads: int, width: int) -> float | None:
    """The published time, or None for a combination that was not published."""
    if threads not in THREADS or width not in WIDTHS:
        return None
    return SECONDS[THREADS.index(threads)][WIDTHS.index(width)]


def column(width: int) -> tuple[float, ...]:
    """The published seconds of one width, in the order of THREADS."""
    return tuple(row[WIDTHS.index(width)] for row in SECONDS)
