"""The surface on which a grid of signed distances is 0, as a mesh; and Mitsuba's .vol grids."""

from __future__ import annotations

import struct
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from . import Floats, Integers, MeshData, turned

# Of a .vol file: "VOL", version 3, type 1 (float32), three sizes, channels, and a box of six floats
_HEADER = struct.Struct("<3sB5i6f")
_LARGEST_SIDE = 2048


def read_vol(path: Path) -> NDArray[np.float32]:
    """The (Z, Y, X) numbers of a .vol file of one channel. Raises FormatError, OSError."""
    data = path.read_bytes()
    if len(data) < _HEADER.size or data[:4] != b"VOL\3":
        raise FormatError(f"{path}: is not a .vol grid of version 3")
    _, _, kind, x, y, z, channels, *_ = _HEADER.unpack_from(data)
    if kind != 1 or channels != 1:
        raise FormatError(f"{path}: type {kind}, {channels} channels; must be 1 and 1, float32")
    if not all(2 <= side <= _LARGEST_SIDE for side in (x, y, z)):
        raise FormatError(f"{path}: {x} by {y} by {z}; must be 2 to {_LARGEST_SIDE} each way")
    if len(data) < _HEADER.size + 4 * x * y * z:
        raise FormatError(f"{path}: is cut short: {x} by {y} by {z} numbers")
    return np.frombuffer(data, "<f4", x * y * z, _HEADER.size).reshape(z, y, x)


def surface(values: Floats) -> MeshData:
    """Where values on the (Z, Y, X) corners of cells that fill the unit cube go through 0.

    Marching tetrahedra: each cell is cut into the six of H. W. Kuhn (1960), which fit those of its
    neighbours, and the values run straight along their edges. Outside is where they are positive.
    Normals are the grid's gradients; uvs are 0.
    """
    flat = np.asarray(values, np.float64).ravel()
    tetrahedra = _tetrahedra(values.shape)
    inside = flat[tetrahedra] < 0.0
    count = inside.sum(axis=1)
    crossed = (count > 0) & (count < 4)
    # the corners inside come first, so that their number says which edges cross
    order = np.argsort(~inside[crossed], axis=1, kind="stable")
    corners = np.take_along_axis(tetrahedra[crossed], order, axis=1)
    count = count[crossed]
    edges = np.concatenate(
        [
            _triangles(corners[count == 1], [(0, 1), (0, 2), (0, 3)]),
            _triangles(corners[count == 3], [(3, 0), (3, 1), (3, 2)]),
            _triangles(corners[count == 2], [(0, 2), (0, 3), (1, 3)]),
            _triangles(corners[count == 2], [(0, 2), (1, 3), (1, 2)]),
        ]
    )
    keys = edges.min(axis=2) * flat.size + edges.max(axis=2)
    used, faces = np.unique(keys, return_inverse=True)
    a, b = used // flat.size, used % flat.size
    share = (flat[a] / (flat[a] - flat[b]))[:, None]
    places, normals = (
        table[a] * (1.0 - share) + table[b] * share for table in _corner_tables(values)
    )
    triangles = turned(places, faces.reshape(-1, 3), normals)
    return MeshData(places, triangles, normals, np.zeros((len(places), 2)))


def _tetrahedra(shape: tuple[int, ...]) -> Integers:
    """(T, 4) corners of all cells' tetrahedra: paths along three edges to the corner across."""
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    first = np.add.outer(
        np.add.outer(np.arange(shape[0] - 1) * strides[0], np.arange(shape[1] - 1) * strides[1]),
        np.arange(shape[2] - 1),
    ).reshape(-1, 1)
    paths = [np.cumsum([0, *strides[list(axes)]]) for axes in permutations(range(3))]
    return np.concatenate([first + path for path in paths])


def _triangles(corners: Integers, edges: list[tuple[int, int]]) -> Integers:
    """(T, 3, 2): for each tetrahedron the triangle whose corners lie on these edges."""
    return np.asarray(corners[:, np.array(edges)])


def _corner_tables(values: Floats) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N, 3) places in the unit cube, as x, y, z, and gradients at the grid's corners."""
    sides = [np.linspace(0.0, 1.0, size) for size in values.shape]
    z, y, x = np.meshgrid(*sides, indexing="ij")
    dz, dy, dx = np.gradient(np.asarray(values, np.float64), *sides)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), np.stack([dx, dy, dz], axis=-1).reshape(
        -1, 3
    )
