"""`parhelion render` up to its first pass over the picture; prints time.monotonic() at its end.

The command itself runs, with the progress bar that a terminal would show, and is left when the
picture has its first sample in every pixel. Its argument is the name of the picture, never written.
"""

from __future__ import annotations

import io
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import parhelion.cli
import parhelion.progress


class Terminal(io.StringIO):
    """Takes what the bar draws, and says that it is a terminal."""

    def isatty(self) -> bool:
        return True


shown = parhelion.progress.bar


@contextmanager
def watched() -> Iterator[parhelion.progress.ProgressCallback]:
    from parhelion import Settings

    with shown(Terminal()) as report:

        def watch(state: parhelion.progress.Progress) -> None:
            report(state)
            if state.samples * Settings().spp >= state.total_samples:
                # The bar has put itself in the place of sys.stdout.
                os.write(1, repr(time.monotonic()).encode())
                os._exit(0)

        yield watch


if __name__ == "__main__":
    parhelion.progress.bar = watched
    parhelion.cli.main(["render", "-o", sys.argv[1]])
    sys.exit("the command ended before its first pass was reported")
