"""Reading pictures back, and comparing them, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph


def read_picture(path: Path, channels: Sequence[str] = "RGB") -> tuple[np.ndarray, dict[str, Any]]:
    """(H, W, N) of the channels of those names, as they are stored, and the file's attributes."""
    import OpenImageIO as oiio

    file = oiio.ImageInput.open(str(path))
    assert file is not None, oiio.geterror()
    spec = file.spec()
    stored = {"uint8": "uint8", "uint16": "uint16", "half": "half"}.get(str(spec.format), "float")
    pixels = file.read_image(stored)
    assert pixels is not None, file.geterror()
    file.close()
    order = [spec.channelnames.index(name) for name in channels]
    attributes = {a.name: a.value for a in spec.extra_attribs}
    return np.asarray(pixels)[..., order], attributes


def assert_same(a: ph.Image, b: ph.Image) -> None:
    """Two pictures are the same to the last bit: colours, counts of samples and features."""
    np.testing.assert_array_equal(a.numpy(), b.numpy())
    np.testing.assert_array_equal(a.counts, b.counts)
    assert a.features.keys() == b.features.keys()
    for name, values in a.features.items():
        np.testing.assert_array_equal(values, b.features[name], err_msg=name)
