"""Particles in NumPy's NPZ archives, as numpy.savez and savez_compressed write them.

Keys: positions (N, 3); and, if there, radii, (N,) or one number; colors (N, 3), linear RGB, or
sRGB if of 8 bits; elements, (N,) symbols; types, (N,) strings or numbers; box (3, 3), its edges
in rows, or (3,); origin (3,); periodic (3,), of the box's edges; bonds (B, 2) indices of particles,
from 0; shape, one or (N,) of glyphs.NAMES; half_extents (N, 3) or (3,); orientations (N, 4) or (4,)
quaternions, the real part first; vertices (M, 3) of polyhedra, and rounding_radius. Any other array
of N numbers or strings, or of N rows of numbers, is a field. Nothing else is read.
"""

from __future__ import annotations

import lzma
import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .. import particles
from ..errors import SceneError
from ..particles import Labels, Particles, element_labels, linear, to_scene
from ..particles.boxes import Box
from ..particles.glyphs import Glyphs, named
from ..scene import Scene
from . import LoadOptions, require_memory
from .text import errors_name, frame_index

NAME = "NumPy archive"
PACKED = False
PARTS = True
OPTIONS = particles.OPTIONS
BARE = True

# An archive this large, unpacked, that was packed better than so many times is a zip bomb;
# arrays of numbers pack less than 30 times.
_BOMB_SIZE = 1 << 26
_BOMB_RATIO = 250

# Keys that have a meaning, each with the others that it may be written as
_KEYS = {
    "positions": ("position", "centers"),
    "radii": ("radius",),
    "colors": ("color",),
    "elements": ("element",),
    "types": ("type",),
    "box": (),
    "origin": (),
    "periodic": (),
    "bonds": (),
    "shape": ("shapes",),
    "half_extents": ("semi_axes", "aspherical_shape"),
    "orientations": ("orientation", "quaternions"),
    "vertices": (),
    "rounding_radius": (),
}

_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def load(path: Path, options: LoadOptions) -> Scene:
    """The archive as a scene. Raises FormatError, SceneError."""
    frame_index(path, int(options.frame), 1)  # it has one frame
    return to_scene(read(path), options, path.name)


def contents(path: Path, options: LoadOptions) -> dict[str, Any]:
    """What is in the archive. Raises FormatError."""
    frame_index(path, int(options.frame), 1)
    return particles.contents(read(path))


def read(path: Path) -> Particles:
    """The particles of an archive. Raises FormatError for one that is broken or has none."""
    with errors_name(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return _particles(_arrays(archive, path.stat().st_size))
        except SceneError:
            raise
        except (
            EOFError,
            KeyError,
            NotImplementedError,
            OverflowError,
            RuntimeError,  # a member with a password
            SyntaxError,
            ValueError,
            lzma.LZMAError,
            tokenize.TokenError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise SceneError(f"is not a NumPy archive, or broken: {str(error)[:200]}") from None


def _arrays(archive: zipfile.ZipFile, size: int) -> dict[str, NDArray[Any]]:
    """The arrays that have to do with particles, by key; checked by their headers before."""
    headers = {
        member.filename.removesuffix(".npy"): (member, *_header(archive, member))
        for member in archive.infolist()
        if member.filename.endswith(".npy")
    }
    names = sorted(headers)
    for key, others in _KEYS.items():
        written = next((name for name in (key, *others) if name in headers), None)
        if written is not None:
            headers[key] = headers.pop(written)
        elif key == "positions":
            has = ", ".join(names[:20]) or "none"
            raise SceneError(f"has no array 'positions' (position, centers); its arrays: {has}")
    _, shape, dtype = headers["positions"]
    if len(shape) != 2 or shape[1] != 3 or dtype.kind not in "iuf":
        raise SceneError(f"positions: (N, 3) numbers are needed, not {shape} of {dtype}")
    wanted = {}
    for name, (member, lengths, dtype) in headers.items():
        dimensions = {"b": 2, "i": 2, "u": 2, "f": 2, "U": 1, "S": 1}.get(dtype.kind, 0)
        of_particles = lengths[:1] == shape[:1] and len(lengths) <= dimensions
        if name in _KEYS or of_particles:
            wanted[name] = member
    unpacked = sum(member.file_size for member in wanted.values())
    if unpacked > max(_BOMB_SIZE, _BOMB_RATIO * size):
        raise SceneError(
            f"unpacks to more than {_BOMB_RATIO} times its size, which no file of particles does"
        )
    assert archive.filename is not None
    require_memory(Path(archive.filename), unpacked)
    arrays = {}
    for name, member in wanted.items():
        with archive.open(member) as stream:
            array = npy.read_array(stream, allow_pickle=False)
        if array.dtype.kind == "U":
            _check_unicode(array, name)
        arrays[name] = array
    return arrays


def _check_unicode(array: NDArray[Any], name: str) -> None:
    """Raises SceneError for code points that there are none of, of which Python makes no text."""
    order = np.dtype(np.uint32).newbyteorder(array.dtype.byteorder)
    points = np.frombuffer(array.tobytes(), order)
    if ((points > 0x10FFFF) | ((points >= 0xD800) & (points < 0xE000))).any():
        raise SceneError(f"{name}: holds text that is no Unicode")


def _header(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, which fit the member's size. Raises SceneError, ValueError."""
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        if version not in _READERS:
            raise SceneError(f"{member.filename}: NPY version {version} is not supported")
        shape, _, dtype = _READERS[version](stream)
        data = member.file_size - stream.tell()
    if math.prod(shape) * dtype.itemsize != data and not dtype.hasobject:
        raise SceneError(f"{member.filename}: {data} bytes of data for {shape} of {dtype}")
    return shape, dtype


def _particles(arrays: dict[str, NDArray[Any]]) -> Particles:
    def take(key: str, *shapes: tuple[int, ...]) -> NDArray[Any] | None:
        """Takes numbers of one of the shapes out of the arrays."""
        array = arrays.pop(key, None)
        if array is not None and (array.shape not in shapes or array.dtype.kind not in "biuf"):
            allowed = " or ".join(map(str, shapes))
            raise SceneError(
                f"{key}: numbers of shape {allowed} are needed, not {array.shape} of {array.dtype}"
            )
        return array

    positions = _floats(arrays.pop("positions"))
    count = len(positions)
    radii = take("radii", (count,), ())
    colors = take("colors", (count, 3))
    if colors is not None:
        colors = linear(colors) if colors.dtype == np.uint8 else _floats(colors)
    box = take("box", (3, 3), (3,))
    origin = take("origin", (3,))
    periodic = take("periodic", (3,))
    bonds = arrays.pop("bonds", None)
    symbols = species = _labels(arrays, "elements")
    types = _labels(arrays, "types")
    if species is not None:
        symbols = element_labels(species)
        if symbols is None:
            raise SceneError("elements: not all are symbols of elements; call them types")
    elif types is not None:
        symbols = element_labels(types)
    half_extents = take("half_extents", (count, 3), (3,))
    turns = take("orientations", (count, 4), (4,))
    if turns is not None and turns.ndim == 2:  # may be of use for colours too
        arrays["orientations"] = turns
    glyphs = _glyphs(
        count,
        arrays.pop("shape", None),
        half_extents,
        turns,
        arrays.pop("vertices", None),
        take("rounding_radius", ()),
    )
    fields = {
        key: Labels.of(_text(array)) if array.dtype.kind in "US" else array
        for key, array in arrays.items()
    }
    return Particles(
        positions,
        symbols,
        types,
        None if radii is None else np.broadcast_to(_floats(radii), count),
        colors,
        fields,
        None if box is None else _box(box, origin, periodic),
        bonds,
        glyphs=glyphs,
    )


def _glyphs(
    count: int,
    shape: NDArray[Any] | None,
    half_extents: NDArray[Any] | None,
    orientations: NDArray[Any] | None,
    vertices: NDArray[Any] | None,
    rounding: NDArray[Any] | None,
) -> Glyphs | None:
    if shape is None:
        if vertices is None and half_extents is None:
            return None
        shape = np.array("ellipsoid" if vertices is None else "polyhedron")
    if shape.dtype.kind not in "US" or shape.shape not in ((), (count,)):
        what = f"{shape.shape} of {shape.dtype}"
        raise SceneError(f"shape: one name, or ({count},) of them, is needed, not {what}")
    radius = 0.0 if rounding is None else float(rounding)
    return named(count, _text(shape), half_extents, orientations, vertices, radius)


def _floats(array: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """float32 as it is, everything else as float64; both in the machine's byte order."""
    return array.astype(
        np.float32 if array.dtype.itemsize == 4 and array.dtype.kind == "f" else np.float64
    )


def _text(array: NDArray[Any]) -> NDArray[Any]:
    return np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array


def _labels(arrays: dict[str, NDArray[Any]], key: str) -> Labels | None:
    """Takes strings or numbers, one a particle, out of the arrays."""
    array = arrays.pop(key, None)
    if array is None:
        return None
    if array.ndim != 1 or array.dtype.kind not in "biufUS":
        what = f"{array.shape} of {array.dtype}"
        raise SceneError(f"{key}: (N,) strings or numbers are needed, not {what}")
    return Labels.of(_text(array))


def _box(edges: NDArray[Any], origin: NDArray[Any] | None, periodic: NDArray[Any] | None) -> Box:
    vectors = np.diag(edges) if edges.ndim == 1 else edges
    corner = np.zeros(3) if origin is None else origin
    if not (np.isfinite(vectors).all() and np.isfinite(corner).all()):
        raise SceneError("box or origin is not finite")
    x, y, z = (True, True, True) if periodic is None else periodic.astype(bool).tolist()
    return Box(vectors.astype(np.float64), corner.astype(np.float64), (x, y, z))
