"""USD stages, through the usd-core package (an extra).

What maps to what, and what does not, is written in docs/usd.md. `stage` opens the file, `reader`
walks over the prims; every kind of them has a file (meshes, solids, strands, materials, lights,
cameras) with a table from the type's name to the function that makes ours of it.
"""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Any

from ...errors import FormatError
from ...scene import Cylinders, Disks, Instances, Mesh, Scene, Spheres
from .. import LoadOptions, Timeline
from ..files import Folders, Reports

NAME = "USD"
PACKED = False
OPTIONS = ("frame", "variant", "camera")
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

    folders, reports = Folders(path.parent, options.allow_paths), Reports(path, options.strict)
    stage = _opened(path, options, folders, reports)
    from .images import Images
    from .reader import Reader
    from .stage import guarded

    images = Images(folders)

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


def contents(path: Path, options: LoadOptions) -> dict[str, Any]:
    """Sets of variants by name, and cameras by path. Raises FormatError."""
    folders, reports = Folders(path.parent, options.allow_paths), Reports(path, options.strict)
    stage = _opened(path, options, folders, reports)
    from . import cameras
    from .stage import guarded

    found: dict[str, Any] = {}
    sets: dict[str, dict[str, list[str]]] = {}
    with guarded(path):
        for prim in stage.TraverseAll():
            for own in map(prim.GetVariantSet, prim.GetVariantSets().GetNames()):
                there = sets.setdefault(own.GetName(), {"names": [], "used": []})
                used = [own.GetVariantSelection()]  # an empty name where there is none
                for name, more in (("names", own.GetVariantNames()), ("used", used)):
                    there[name] += [v for v in more if v and v not in there[name]]
        paths = cameras.paths(stage, options.frame)
        if sets:
            found["variant_sets"] = sets
        if paths:
            found["cameras"] = {
                "names": list(map(str, paths)),
                "used": str(cameras.choice(stage, paths)),
            }
    return found


def _opened(path: Path, options: LoadOptions, folders: Folders, reports: Reports) -> Any:
    """The stage, with the choices of the options. Raises FormatError."""
    try:
        import pxr.Usd  # noqa: F401
    except ImportError:
        raise FormatError(
            f"{path}: USD files need the usd-core package: pip install usd-core"
        ) from None
    from . import cameras
    from .stage import guarded, opened

    with guarded(path):
        stage = opened(path, options, folders, reports)
        if options.camera is not None:
            cameras.ask_for(stage, options.camera)
    return stage
