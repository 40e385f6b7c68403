"""Parhelion: a path tracer for data.

    import parhelion as ph
    scene = ph.load("water.xyz")
    ph.render(scene, spp=256).save("water.png")

Names are imported when first used, so that `import parhelion` costs little: it loads the core, for
3 ms, and not NumPy.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .builtin import weekend
    from .comparison import Comparison, compare
    from .errors import FormatError, ParhelionError, ResourceError, SceneError
    from .image import Image
    from .io import LoadOptions, load
    from .io.frames import load_frames
    from .merging import merge
    from .objects import frames_of, scene_of
    from .orbit import turntable
    from .pixel import LightSample, PathVertex, PixelPath, trace_pixel
    from .progress import Progress
    from .provenance import rerender
    from .rays import Hits, intersect, occluded
    from .renderer import Prepared, prepare, render
    from .saving import save
    from .scene import (
        Background,
        Camera,
        ColorBar,
        Curves,
        Cylinders,
        Disks,
        Framing,
        Instances,
        Light,
        Material,
        Mesh,
        Scene,
        Settings,
        Spheres,
        Swatches,
        Texture,
    )
    from .sequence import save_sequence
    from .spectra import conductor

# Idle threads of OpenMP spin before they sleep: GCC's for 300,000 rounds (1 to 15 ms), Clang's for
# 200 ms. What else runs on these cores waits meanwhile: of two processes that render small pictures
# each took up to 1.8 times as long. With these, 0.1 ms and none, one alone takes as long.
_SPINS = {"GOMP_SPINCOUNT": "10000", "KMP_BLOCKTIME": "0"}


def _load_core() -> None:
    """OpenMP reads the environment while the core is loaded; nobody else needs to see this.

    Who has said how threads wait is obeyed.
    """
    told = {} if {"OMP_WAIT_POLICY", *_SPINS} & os.environ.keys() else _SPINS
    os.environ.update(told)
    try:
        import_module("._core", __name__)
    finally:
        for name in told:
            os.environ.pop(name, None)


_load_core()

_HOMES = {
    "FormatError": "errors",
    "ParhelionError": "errors",
    "ResourceError": "errors",
    "SceneError": "errors",
    "Comparison": "comparison",
    "compare": "comparison",
    "Image": "image",
    "LoadOptions": "io",
    "load": "io",
    "load_frames": "io.frames",
    "merge": "merging",
    "save": "saving",
    "rerender": "provenance",
    "scene_of": "objects",
    "frames_of": "objects",
    "Prepared": "renderer",
    "Progress": "progress",
    "Hits": "rays",
    "intersect": "rays",
    "occluded": "rays",
    "prepare": "renderer",
    "render": "renderer",
    "Background": "scene",
    "Camera": "scene",
    "ColorBar": "scene",
    "Framing": "scene",
    "Material": "scene",
    "Curves": "scene",
    "Cylinders": "scene",
    "Disks": "scene",
    "Instances": "scene",
    "Light": "scene",
    "Mesh": "scene",
    "Texture": "scene",
    "Scene": "scene",
    "Settings": "scene",
    "Spheres": "scene",
    "Swatches": "scene",
    "save_sequence": "sequence",
    "conductor": "spectra",
    "LightSample": "pixel",
    "PathVertex": "pixel",
    "PixelPath": "pixel",
    "trace_pixel": "pixel",
    "turntable": "orbit",
    "weekend": "builtin",
}

__all__ = [
    "Background",
    "Camera",
    "ColorBar",
    "Comparison",
    "Curves",
    "Cylinders",
    "Disks",
    "FormatError",
    "Framing",
    "Hits",
    "Image",
    "Instances",
    "Light",
    "LightSample",
    "LoadOptions",
    "Material",
    "Mesh",
    "ParhelionError",
    "PathVertex",
    "PixelPath",
    "Prepared",
    "Progress",
    "ResourceError",
    "Scene",
    "SceneError",
    "Settings",
    "Spheres",
    "Swatches",
    "Texture",
    "compare",
    "conductor",
    "frames_of",
    "intersect",
    "load",
    "load_frames",
    "merge",
    "occluded",
    "prepare",
    "render",
    "rerender",
    "save",
    "save_sequence",
    "scene_of",
    "trace_pixel",
    "turntable",
    "weekend",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'parhelion' has no attribute {name!r}")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
