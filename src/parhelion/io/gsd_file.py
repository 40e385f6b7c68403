"""GSD files of HOOMD-blue's schema, through the gsd package (an extra).

https://gsd.readthedocs.io/en/stable/schema-hoomd.html is the reference. Chunks of data are read
one by one, so that only what a picture needs is read, and one frame at a time.

HOOMD has no unit of length and its types have any names, so that a type "C" is no carbon: types
have colours of their own, and radii are from the diameters or from the distances of neighbours.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import particles
from ..boxes import Box
from ..errors import FormatError, SceneError
from ..particles import Labels, Particles, to_scene
from ..scene import Scene
from . import LoadOptions
from .text import errors_name, frame_index

NAME = "GSD"
SUFFIXES = (".gsd",)
OPTIONS = particles.OPTIONS
BARE = True

# Chunks that are fields, with their names here
_FIELDS = {
    "particles/mass": "mass",
    "particles/charge": "charge",
    "particles/diameter": "diameter",
    "particles/body": "body",
    "particles/velocity": "velocity",
}


def load(path: Path, options: LoadOptions) -> Scene:
    """One frame of the file as a scene. Raises FormatError, SceneError."""
    return to_scene(read(path, options.frame), options, path.name)


def read(path: Path, frame: int = 0) -> Particles:
    """The particles of one frame, counted from 0, or from the end if negative.

    Raises FormatError for a file that is broken or has no such frame, or without the gsd package.
    """
    try:
        from gsd import fl
    except ImportError:
        raise FormatError(f"{path}: GSD files need the gsd package: pip install gsd") from None
    with errors_name(path):
        try:
            with fl.open(str(path), "r") as file:
                if file.schema != "hoomd":
                    raise SceneError(f"has the schema {file.schema[:40]!r}, not 'hoomd'")
                if not file.nframes:
                    raise SceneError("has no frames")
                return _particles(file, frame_index(path, frame, file.nframes))
        except SceneError:
            raise
        except (KeyError, OSError, RuntimeError, TypeError, ValueError) as error:
            reason = str(error).removesuffix(f": {path}")
            raise SceneError(f"cannot be read: {reason[:200]}") from None


def _particles(file: Any, frame: int) -> Particles:
    def chunk(name: str) -> NDArray[Any] | None:
        """The chunk of this frame; else, as the schema says, of frame 0."""
        for source in dict.fromkeys((frame, 0)):
            if file.chunk_exists(source, name):
                try:
                    return np.asarray(file.read_chunk(source, name))
                except MemoryError as error:  # as large as the file says, which may be wrong
                    raise SceneError(f"{name}: {error}") from None
        return None

    positions = chunk("particles/position")
    if positions is None:
        raise SceneError(f"frame {frame} has no particles/position")
    count = len(positions)
    fields: dict[str, NDArray[Any] | Labels] = {}
    names = dict(_FIELDS)
    for name in file.find_matching_chunk_names("log/particles/"):
        names[name] = name.removeprefix("log/particles/")
    for name, key in names.items():
        values = chunk(name)
        if values is not None and values.ndim <= 2 and len(values) == count:
            fields[key] = values
    diameters = fields.get("diameter")
    radii = 0.5 * diameters if isinstance(diameters, np.ndarray) else None
    ids, types = chunk("particles/typeid"), chunk("particles/types")
    labels = _labels(ids if ids is not None else np.zeros(count, np.uint32), types)
    box = _box(chunk("configuration/box"))
    return Particles(positions, None, labels, radii, None, fields, box, chunk("bonds/group"))


def _labels(ids: NDArray[Any], types: NDArray[Any] | None) -> Labels:
    """The schema's default is one type, "A"; names are rows of bytes that end in zeros."""
    names = ["A"]
    if types is not None:
        names = [row.tobytes().rstrip(b"\0").decode("utf-8") for row in np.atleast_2d(types)]
    if ids.ndim != 1 or (len(ids) and int(ids.max()) >= len(names)):
        raise SceneError("particles/typeid has a type that particles/types does not name")
    return Labels(ids, tuple(names))


def _box(box: NDArray[Any] | None) -> Box | None:
    """The schema's Lx, Ly, Lz, xy, xz, yz; the box is centred at 0, tilts are fractions."""
    if box is None:
        return None
    if box.shape != (6,) or not np.isfinite(box).all():
        raise SceneError("configuration/box is not six finite numbers")
    x, y, z, xy, xz, yz = box.astype(np.float64).tolist()
    vectors = np.array([[x, 0, 0], [xy * y, y, 0], [xz * z, yz * z, z]])
    return Box(vectors, -0.5 * vectors.sum(axis=0))
