"""Reading pictures back, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def read_picture(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """(H, W, 3) pixels as they are stored, channels by name, and the file's attributes."""
    import OpenImageIO as oiio

    file = oiio.ImageInput.open(str(path))
    assert file is not None, oiio.geterror()
    spec = file.spec()
    stored = {"uint8": "uint8", "uint16": "uint16", "half": "half"}.get(str(spec.format), "float")
    pixels = file.read_image(stored)
    assert pixels is not None, file.geterror()
    file.close()
    order = [spec.channelnames.index(name) for name in "RGB"]
    attributes = {a.name: a.value for a in spec.extra_attribs}
    return np.asarray(pixels)[..., order], attributes
