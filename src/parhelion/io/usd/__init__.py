"""USD stages, through the usd-core package (an extra).

What maps to what, and what does not, is written in docs/usd.md. `stage` opens the file, `reader`
walks over the prims; every kind of them has a file (meshes, solids, strands, materials, lights,
cameras) with a table from the type's name to the function that makes ours of it.
"""

from __future__ import annotations

from math import isfinite
from pathlib import Path

from ...errors import FormatError
from ...scene import Cylinders, Disks, Instances, Mesh, Scene, Spheres
from .. import LoadOptions, Timeline
from ..files import Folders, Reports

NAME = "USD"
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
PACKED = False
OPTIONS = ("frame", "variant")
TIME_CODES = True
BARE = True
GROUND = (Mesh, Instances, Spheres, Disks, Cylinders)
# Time codes a second where a stage says what cannot be: USD's own default
_RATE = 24.0


def load(path: Path, options: LoadOptions) -> Scene:
    """The stage at the time code options.frame as a scene. Raises FormatError.

    What it asks for and we do not do is logged as a warning, one line a feature; with
    options.strict it is an error.
    """
    return timeline(path, options).read(options.frame)


def timeline(path: Path, options: LoadOptions) -> Timeline:
    """Time codes, one a picture, from the stage's first to its last. Raises FormatError."""
    import numpy as np

    try:
        import pxr.Usd  # noqa: F401
    except ImportError:
        raise FormatError(
            f"{path}: USD files need the usd-core package: pip install usd-core"
        ) from None
    from .images import Images
    from .reader import Reader
    from .stage import guarded, opened

    folders, reports = Folders(path.parent, options.allow_paths), Reports(path, options.strict)
    images = Images(folders)
    with guarded(path):
        stage = opened(path, options, folders, reports)

    def read(time: float) -> Scene:
        with np.errstate(all="ignore"), guarded(path):
            return Reader(path, stage, images, reports, time).scene()

    ends = None
    if stage.HasAuthoredTimeCodeRange():
        ends = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    rate = stage.GetTimeCodesPerSecond()
    if not (isfinite(rate) and rate > 0.0):
        rate = _RATE
    return Timeline("frame", "time codes", rate, 1.0, ends, read)
