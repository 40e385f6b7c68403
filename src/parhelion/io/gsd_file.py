"""GSD files of HOOMD-blue's schema, through the gsd package (an extra).

https://gsd.readthedocs.io/en/stable/schema-hoomd.html is the reference. Chunks of data are read
one by one, so that only what a picture needs is read, and one frame at a time.

HOOMD has no unit of length and its types have any names, so that a type "C" is no carbon: types
have colours of their own, and radii are from the diameters or from the distances of neighbours.
Shapes of types are as in https://gsd.readthedocs.io/en/stable/shapes.html.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import memory, particles
from ..errors import FormatError, ResourceError, SceneError, unknown_name
from ..particles import FARTHEST, Labels, Particles, to_scene
from ..particles.boxes import Box
from ..particles.glyphs import Body, Glyphs, ball, faceted, polygon, polyhedron, union
from ..scene import Scene
from . import COLUMN_TAKES, ROW_TAKES, LoadOptions
from .text import Trajectory, errors_name, frame_index

NAME = "GSD"
PACKED = False
PARTS = True
OPTIONS = particles.OPTIONS
BARE = True

# Chunks that are fields, with their names here
_FIELDS = {
    "particles/mass": "mass",
    "particles/charge": "charge",
    "particles/diameter": "diameter",
    "particles/body": "body",
    "particles/velocity": "velocity",
    "particles/orientation": "orientation",
}

# The file's head: a magic number; where the index and the list of names are, and how many rows they
# have, of so many bytes each (gsd.h, struct gsd_header)
_TABLES, _MAGIC = struct.Struct("<5Q"), 0x65DF65DF65DF65DF
_ROWS = 32, 64

_SHAPES = ("Sphere", "Ellipsoid", "ConvexPolyhedron", "Polygon", "Mesh", "SphereUnion")


def load(path: Path, options: LoadOptions) -> Scene:
    """One frame of the file as a scene. Raises FormatError, SceneError."""
    return to_scene(read(path, int(options.frame)), options, path.name)


def read(path: Path, frame: int = 0) -> Particles:
    """The particles of one frame, counted from 0, or from the end if negative.

    Raises FormatError for a file that is broken or has no such frame, or without the gsd package.
    """
    with _opened(path) as frames:
        return frames.read(frame_index(path, frame, frames.count))


def contents(path: Path, options: LoadOptions) -> dict[str, Any]:
    """What one frame has, and can be coloured by. Raises FormatError."""
    return particles.contents(read(path, int(options.frame)))


def trajectory(path: Path, _: LoadOptions) -> AbstractContextManager[Trajectory]:
    """All frames. Raises FormatError as read() does."""
    return _opened(path)


@contextmanager
def _opened(path: Path) -> Iterator[Trajectory]:
    try:
        from gsd import fl
    except ImportError:
        raise FormatError(f"{path}: GSD files need the gsd package: pip install gsd") from None
    with ExitStack() as stack:
        with _errors(path):
            _check_head(path)
            file = stack.enter_context(fl.open(str(path), "r"))
            if file.schema != "hoomd":
                raise SceneError(f"has the schema {file.schema[:40]!r}, not 'hoomd'")
            if not file.nframes:
                raise SceneError("has no frames")

        def at(frame: int) -> Particles:
            with _errors(path):
                return _particles(file, frame)

        yield Trajectory(file.nframes, at)


def _check_head(path: Path) -> None:
    """Raises SceneError for tables that lie outside of the file. The library multiplies their
    numbers of rows in 64 bits, and reads what is not there where that is too much.
    """
    with path.open("rb") as file:
        head = file.read(_TABLES.size)
    if len(head) < _TABLES.size:
        return  # which it says by itself
    magic, *places = _TABLES.unpack(head)
    if magic != _MAGIC:
        return
    size = path.stat().st_size
    for name, at, rows, row in zip(
        ("index", "names"), places[::2], places[1::2], _ROWS, strict=True
    ):
        if at + rows * row > size:
            raise SceneError(f"its {name} of {rows} rows at byte {at} lie outside of the file")


@contextmanager
def _errors(path: Path) -> Iterator[None]:
    """Those of the library, and ours about particles, as FormatErrors."""
    with errors_name(path):
        try:
            yield
        except (ResourceError, SceneError):
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

    number = chunk("particles/N")
    if number is not None and number.size == 1:
        there = [name for name in _FIELDS if file.chunk_exists(frame, name)]
        takes = ROW_TAKES + COLUMN_TAKES * (3 + len(there))
        path = Path(file.name)
        count = min(int(number.item()), path.stat().st_size // 12)  # a place takes so many
        what = f"reading {count:,} particles of {path.name}"
        memory.require(count * takes, what, "fewer take less")
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
    box = _box(chunk("configuration/box"), chunk("configuration/dimensions"))
    glyphs = None
    shapes = chunk("particles/type_shapes")
    if shapes is not None:
        glyphs, given = _glyphs(_texts(shapes), labels, chunk("particles/orientation"))
        if given.any():
            radii = np.where(given > 0, given, 0.5 if radii is None else radii)
    bonds = chunk("bonds/group")
    return Particles(positions, None, labels, radii, None, fields, box, bonds, glyphs=glyphs)


def _glyphs(
    texts: list[str], types: Labels, turns: NDArray[Any] | None
) -> tuple[Glyphs, NDArray[np.float64]]:
    """What particles are drawn as, by the JSON texts of their types' shapes; and the radii, (N,),
    of those that are spheres of a diameter, of others 0.
    """
    bodies: list[Body | None] = []
    sizes, radii = np.ones((len(types.names), 3)), np.zeros(len(types.names))
    for kind, name in enumerate(types.names):
        text = texts[kind] if kind < len(texts) else ""
        try:
            shape = json.loads(text) if text else {}
            if not isinstance(shape, dict):
                raise SceneError("is not an object of JSON")
            body, sizes[kind], radii[kind] = _body(shape)
        except KeyError as error:
            raise SceneError(f"particles/type_shapes of {name!r}: lacks {error}") from None
        except (OverflowError, RecursionError, TypeError, ValueError) as error:
            # SceneErrors are ValueErrors too
            raise SceneError(f"particles/type_shapes of {name!r}: {str(error)[:200]}") from None
        bodies.append(body)
    if turns is not None and turns.shape != (len(types.codes), 4):
        raise SceneError(f"particles/orientation has shape {turns.shape}, not (N, 4)")
    glyphs = Glyphs(bodies, types.codes, types.each(sizes), turns)
    return glyphs, np.asarray(types.each(radii), np.float64)


def _body(shape: dict[str, Any]) -> tuple[Body | None, Any, float]:
    """Of a type: the body or None for a sphere, its sizes along three axes, the sphere's radius."""
    kind, one = shape.get("type"), (1.0, 1.0, 1.0)
    rounding = shape.get("rounding_radius", 0.0)
    if kind is None:
        return None, one, 0.0
    if kind == "Sphere":
        radius = 0.5 * float(shape["diameter"])
        if not radius > 0:
            raise SceneError(f"diameter {shape['diameter']} is not positive")
        return None, one, radius
    if kind == "Ellipsoid":
        axes = [float(shape[key]) for key in "abc"]
        if not all(0 < axis < FARTHEST for axis in axes):
            raise SceneError(f"an axis of {axes} is not positive")
        return ball(), axes, 0.0
    if kind == "ConvexPolyhedron":
        return polyhedron(shape["vertices"], rounding), one, 0.0
    if kind == "Polygon":
        return polygon(shape["vertices"], rounding), one, 0.0
    if kind == "Mesh":
        return faceted(shape["vertices"], shape["indices"]), one, 0.0
    if kind == "SphereUnion":
        return union(shape["centers"], 0.5 * np.asarray(shape["diameters"], float)), one, 0.0
    raise SceneError(unknown_name("shape", str(kind), _SHAPES))


def _labels(ids: NDArray[Any], types: NDArray[Any] | None) -> Labels:
    """The schema's default is one type, "A"; names are rows of bytes that end in zeros."""
    names = ["A"] if types is None else _texts(types)
    whole = ids.ndim == 1 and ids.dtype.kind in "iu"
    if not whole or (len(ids) and not 0 <= int(ids.min()) <= int(ids.max()) < len(names)):
        raise SceneError("particles/typeid has a type that particles/types does not name")
    return Labels(ids, tuple(names))


def _texts(rows: NDArray[Any]) -> list[str]:
    return [row.tobytes().rstrip(b"\0").decode("utf-8") for row in np.atleast_2d(rows)]


def _box(box: NDArray[Any] | None, dimensions: NDArray[Any] | None) -> Box | None:
    """The schema's Lx, Ly, Lz, xy, xz, yz; the box is centred at 0, tilts are fractions."""
    if box is None:
        return None
    if box.shape != (6,) or not np.isfinite(box).all():
        raise SceneError("configuration/box is not six finite numbers")
    x, y, z, xy, xz, yz = box.astype(np.float64).tolist()
    vectors = np.array([[x, 0, 0], [xy * y, y, 0], [xz * z, yz * z, z]])
    flat = dimensions is not None and np.all(dimensions == 2)
    return Box(vectors, -0.5 * vectors.sum(axis=0), (True, True, not flat))
