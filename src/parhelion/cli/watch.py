"""What a command does while it renders: it shows a bar, and minds signals."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..image import Image
    from ..progress import Progress, ProgressCallback


class Watch:
    """A progress function for one or more pictures: shows a bar, and stops at a signal.

    count: of pictures in all. done: how many of them there are.
    """

    def __init__(self) -> None:
        self.count, self.done = 1, 0
        self._called = False
        self._samples = self._rays = 0
        self._seconds = 0.0
        self._report: ProgressCallback | None = None
        self._stop: list[int] = []

    def __call__(self, state: Progress) -> bool:
        self._called = True
        if self._report is not None:
            self._report(
                replace(
                    state,
                    samples=self._samples + state.samples,
                    total_samples=self.count * state.total_samples,
                    rays=self._rays + state.rays,
                    seconds=self._seconds + state.seconds,
                )
            )
        return self.stopped

    @property
    def stopped(self) -> bool:
        """Whether a signal has come."""
        return bool(self._stop)

    def add(self, image: Image) -> None:
        """Counts a picture that is there."""
        self.done += 1
        self._samples += image.stats.samples
        self._rays += image.stats.rays
        self._seconds += image.stats.seconds

    @contextmanager
    def watching(self, quiet: bool) -> Iterator[None]:
        """Shows a bar and minds signals in the block."""
        with ExitStack() as stack:
            self._stop = stack.enter_context(_interrupts(lambda: self._called))
            if not quiet:
                from ..progress import bar

                self._report = stack.enter_context(bar())
            yield


@contextmanager
def _interrupts(asked: Callable[[], bool]) -> Iterator[list[int]]:
    """A list that is no longer empty once SIGINT or SIGTERM has come; a second one ends at once, as
    does the first while nobody has asked for it yet: a cluster may take hours to come.
    """
    stop: list[int] = []

    def note(number: int, _frame: Any) -> None:
        stop.append(number)
        if len(stop) > 1 or not asked():
            raise KeyboardInterrupt

    old = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
