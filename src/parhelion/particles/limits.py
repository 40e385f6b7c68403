"""What numbers of particles must lie within, and the error for one that does not."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError

Floats = NDArray[np.floating[Any]]

# Coordinates and sizes stay below this, so that the light, some hundred times farther away than
# the particles, stays within single precision.
FARTHEST = 1e30
# Lengths and sizes stay above this, which single precision has in full.
SMALLEST = 1e-37


def refuse(good: NDArray[np.bool_], values: Floats, text: str) -> None:
    """Raises SceneError for the first particle that is not good.

    good: (N,). values: (N,) or (N, M). text: with {} for the particle's values in brackets.
    """
    if not good.all():
        first = int(np.argmin(good))
        shown = " ".join(f"{v:g}" for v in np.atleast_1d(values[first]).tolist())
        raise SceneError(f"particle {first}: {text.format(f'({shown})')}")
