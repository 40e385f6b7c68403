"""Scenes into files: the registry of formats that are written, one line a format here.

A module of io has

    save(scene: Scene, path: pathlib.Path, reports: io.files.Reports) -> None

which names in the reports what the format cannot hold, tells them, and then writes the file whole
or not at all.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from . import arguments
from .errors import FormatError, ResourceError, SceneError, unknown_name
from .flatten import Flat, flatten
from .io.files import Reports
from .scene import Scene
from .studio import without_light

# suffix -> module of io
WRITERS: dict[str, str] = {
    ".json": "json_scene",
    ".ply": "mesh_file",
    ".gltf": "gltf",
    ".glb": "gltf",
}


def save(scene: Scene, path: str | os.PathLike[str], *, strict: bool = False) -> None:
    """Writes a scene; which format is told by the ending of the file's name.

    What the format cannot hold is logged as warnings, one line a feature; with `strict` it is an
    error. A file that is already there is whole until the new one is complete. Raises SceneError
    for a scene that cannot be rendered or written, FormatError for an ending that is not written,
    and ResourceError for what the system refuses.
    """
    file = arguments.path("path", path)
    ending = check_writable(file)
    arguments.instance("scene", scene, Scene)
    arguments.flag("strict", strict)
    try:
        if is_bare(ending):  # when it is read again it gets a light again
            scene = without_light(scene)
        # arrays fit together, names are known, pictures can be read
        _check_finite(flatten(scene))
        _module(ending).save(scene, file, Reports(file, strict))
    except SceneError as error:
        if str(error).startswith(str(file)):
            raise
        raise SceneError(f"{file}: cannot be written: {error}") from error
    except MemoryError:
        raise ResourceError(f"{file}: cannot be written: not enough memory") from None


def _check_finite(flat: Flat) -> None:
    """Raises SceneError for a number of a shape that is none, which not all formats can hold."""
    for group in flat.parts["groups"]:
        for shape in group:
            for key, values in shape.items():
                array = np.asarray(values)
                if array.dtype.kind == "f" and not np.isfinite(array).all():
                    broken = ~np.isfinite(array).reshape(len(array), -1).all(axis=1)
                    place = f"{key}[{int(np.argmax(broken))}]"
                    raise SceneError(f"shape {shape['name']!r}: {place} is not finite")


def check_writable(file: Path) -> str:
    """The ending of a file that save() can write. Raises FormatError for others."""
    ending = file.suffix.lower()
    if ending not in WRITERS:
        raise FormatError(f"{file}: {unknown_name('ending of a scene to write', ending, WRITERS)}")
    if file.is_dir():
        raise FormatError(f"{file}: is a folder")
    return ending


def is_bare(ending: str) -> bool:
    """Whether files with that ending get a view and light when they are read."""
    return bool(getattr(_module(ending), "BARE", False))


def _module(ending: str) -> Any:
    return import_module(f".io.{WRITERS[ending]}", __package__)
