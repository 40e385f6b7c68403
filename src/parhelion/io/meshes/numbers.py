"""Numbers in text, parsed at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ... import _core


def parse(text: bytes) -> NDArray[np.float64]:
    """The numbers of a text, separated by white space. Raises ValueError for anything else."""
    return _core.numbers(text)


def words_per_line(text: NDArray[np.uint8]) -> NDArray[np.int64]:
    """How many words each line of a text has, which ends with a line's end."""
    blank = text <= 32
    begins = ~blank
    begins[1:] &= blank[:-1]
    total = np.searchsorted(np.flatnonzero(begins), np.flatnonzero(text == 10))
    return np.diff(total, prepend=0).astype(np.int64)
