"""The pixels of a texture's file, for what has to be computed from them before rendering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...image import read_pixels
from ...spectra import decode_srgb


def read(path: str | Path, color_space: str) -> NDArray[np.float32]:
    """(H, W, channels) linear values; integers count from 0 to the largest of their type."""
    pixels = read_pixels(path)
    values = np.asarray(pixels, np.float32)
    if pixels.dtype.kind in "iu":
        values = values / np.float32(np.iinfo(pixels.dtype).max)
    if color_space == "srgb":
        values[:, :, :3] = decode_srgb(values[:, :, :3])
    return values
