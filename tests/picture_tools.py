"""Reading pictures back, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


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
