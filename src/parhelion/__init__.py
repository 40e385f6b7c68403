"""Parhelion: a path tracer for data.

    import parhelion as ph
    scene = ph.load("water.xyz")
    ph.render(scene, spp=256).save("water.png")

Names are imported when first used, so that `import parhelion` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .builtin import weekend
    from .errors import FormatError, ParhelionError, ResourceError, SceneError
    from .image import Image
    from .io import LoadOptions, load
    from .progress import Progress
    from .renderer import Prepared, prepare, render
    from .scene import Background, Camera, Framing, Material, Scene, Settings, Spheres

_HOMES = {
    "FormatError": "errors",
    "ParhelionError": "errors",
    "ResourceError": "errors",
    "SceneError": "errors",
    "Image": "image",
    "LoadOptions": "io",
    "load": "io",
    "Prepared": "renderer",
    "Progress": "progress",
    "prepare": "renderer",
    "render": "renderer",
    "Background": "scene",
    "Camera": "scene",
    "Framing": "scene",
    "Material": "scene",
    "Scene": "scene",
    "Settings": "scene",
    "Spheres": "scene",
    "weekend": "builtin",
}

__all__ = [
    "Background",
    "Camera",
    "FormatError",
    "Framing",
    "Image",
    "LoadOptions",
    "Material",
    "ParhelionError",
    "Prepared",
    "Progress",
    "ResourceError",
    "Scene",
    "SceneError",
    "Settings",
    "Spheres",
    "load",
    "prepare",
    "render",
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
