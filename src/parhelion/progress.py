"""How far a rendering is, and a live bar on stderr that shows it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TextIO


@dataclass(frozen=True)
class Progress:
    """How far a picture is. samples and rays so far; seconds since the start."""

    samples: int
    total_samples: int
    rays: int
    seconds: float

    @property
    def fraction(self) -> float:
        """The share that is done, 0 to 1."""
        return self.samples / self.total_samples


ProgressCallback = Callable[[Progress], Any]


@contextmanager
def bar(stream: TextIO | None = None) -> Iterator[ProgressCallback]:
    """A function for render()'s progress argument; shows nothing where stderr is no terminal."""
    out = stream or sys.stderr
    if out is None or not out.isatty():  # None: the process was started without a stderr
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
    with Bar(*columns, console=Console(file=out), transient=True) as shown:
        task = shown.add_task("", total=1.0, rate="")

        def report(progress: Progress) -> None:
            seconds = max(progress.seconds, 1e-6)
            rate = f"{si(progress.samples / seconds)}samples/s  {si(progress.rays / seconds)}rays/s"
            shown.update(task, completed=progress.fraction, rate=rate)

        yield report


def si(x: float) -> str:
    """Three digits and a prefix, with a space before the unit: 1234567 is "1.23 M"."""
    for prefix in ("", "k", "M", "G", "T"):
        if x < 999.5:
            return f"{x:.3g} {prefix}"
        x /= 1000
    return f"{x:.3g} P"
