"""USD stages, through the usd-core package (an extra).

What maps to what, and what does not, is written in docs/usd.md. `stage` opens the file, `reader`
walks over the prims; every kind of them has a file (meshes, solids, strands, materials, lights,
cameras) with a table from the type's name to the function that makes ours of it.
"""

from __future__ import annotations

from pathlib import Path

from ...errors import FormatError
from ...scene import Cylinders, Disks, Instances, Mesh, Scene, Spheres
from .. import LoadOptions

NAME = "USD"
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
PACKED = False
OPTIONS = ("frame", "variant")
TIME_CODES = True
BARE = True
GROUND = (Mesh, Instances, Spheres, Disks, Cylinders)


def load(path: Path, options: LoadOptions) -> Scene:
    """The stage at the time code options.frame as a scene. Raises FormatError.

    What it asks for and we do not do is logged as a warning, one line a feature; with
    options.strict it is an error.
    """
    import numpy as np

    try:
        import pxr.Usd  # noqa: F401
    except ImportError:
        raise FormatError(
            f"{path}: USD files need the usd-core package: pip install usd-core"
        ) from None
    from .reader import Reader
    from .stage import opened

    with np.errstate(all="ignore"), opened(path, options) as (stage, folders, reports):
        return Reader(path, stage, folders, reports, options.frame).scene()
