"""How far a rendering is, and a live bar on stderr that shows it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TextIO


@dataclass(frozen=True)
class Crew:
    """The workers of a cluster: how many have the scene; units of work that they did, and how often
    one was given to another.
    """

    workers: int
    units: int
    again: int


@dataclass(frozen=True)
class Progress:
    """How far a picture is. samples and rays so far; seconds since the start.

    total_samples: that there will be; where noise decides, as far as that can be told. error: of
    the picture at the last look at its noise, as RenderStats.error, or None. seconds_left: until
    the time is up, None for ever. crew: of a cluster, or None.
    """

    samples: int
    total_samples: int
    rays: int
    seconds: float
    error: float | None = None
    seconds_left: float | None = None
    crew: Crew | None = None

    @property
    def fraction(self) -> float:
        """The share that is done, 0 to 1: of the samples or of the time, whichever ends first."""
        share = self.samples / self.total_samples
        if self.seconds_left is None:
            return share
        return max(share, self.seconds / max(self.seconds + self.seconds_left, 1e-6))


ProgressCallback = Callable[[Progress], Any]


@contextmanager
def bar(stream: TextIO | None = None) -> Iterator[ProgressCallback]:
    """A function for render()'s progress argument: a bar in terminals and notebooks; shows nothing
    where stderr is another thing.
    """
    out = stream or sys.stderr
    notebook = stream is None and _in_notebook()
    # None: the process was started without a stderr
    if not notebook and (out is None or not out.isatty()):
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("rendering"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    console = Console(force_jupyter=True) if notebook else Console(file=out)
    with Bar(*columns, console=console, transient=True) as shown:
        task = shown.add_task("", total=1.0, rate="")

        def report(progress: Progress) -> None:
            seconds = max(progress.seconds, 1e-6)
            rate = f"{si(progress.samples / seconds)}samples/s  {si(progress.rays / seconds)}rays/s"
            if progress.error is not None:
                rate += f"  error {100 * progress.error:.2g} %"
            if progress.crew is not None:
                rate += f"  {_told_crew(progress.crew)}"
            shown.update(task, completed=progress.fraction, rate=rate)

        yield report


def _told_crew(crew: Crew) -> str:
    again = f", {crew.again} again" if crew.again else ""
    return f"{crew.workers} worker{'s' * (crew.workers != 1)}  {crew.units} units{again}"


def _in_notebook() -> bool:
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


def si(x: float) -> str:
    """Three digits and a prefix, with a space before the unit: 1234567 is "1.23 M"."""
    for prefix in ("", "k", "M", "G", "T"):
        if x < 999.5:
            return f"{x:.3g} {prefix}"
        x /= 1000
    return f"{x:.3g} P"
