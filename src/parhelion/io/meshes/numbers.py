"""Numbers in text, parsed at once."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray


def parse(text: bytes) -> NDArray[np.float64]:
    """The numbers of a text, separated by white space. Raises ValueError for anything else."""
    with warnings.catch_warnings():
        # NumPy stops at the first thing that is no number, and says so by this warning
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):  # since version 2.3 the latter
            raise ValueError("something that is no number") from None


def words_per_line(text: NDArray[np.uint8]) -> NDArray[np.int64]:
    """How many words each line of a text has, which ends with a line's end."""
    blank = text <= 32
    begins = ~blank
    begins[1:] &= blank[:-1]
    total = np.searchsorted(np.flatnonzero(begins), np.flatnonzero(text == 10))
    return np.diff(total, prepend=0).astype(np.int64)
