"""Files of triangle meshes: one module a format, each with `read`.

What NumPy is slow at, numbers in text, OBJ's lines, equal rows and normals, is compiled (loading/).

A reader checks what it returns: every index in range, every array of one length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...errors import FormatError

Floats = NDArray[np.floating[Any]]
Integers = NDArray[np.int64]
Indices = NDArray[np.integer[Any]]


@dataclass(frozen=True, eq=False)
class MeshData:
    """What a mesh file holds.

    vertices (V, 3), faces (F, 3); normals (V, 3) and uvs (V, 2) or None. attributes: further
    arrays, "vertex_NAME" and "face_NAME". face_normals: the file itself asks for flat faces.
    left_out: what else it holds, in words.
    """

    vertices: Floats
    faces: Indices
    normals: Floats | None = None
    uvs: Floats | None = None
    attributes: Mapping[str, Floats] = field(default_factory=dict)
    face_normals: bool = False
    left_out: Sequence[str] = ()


def triangulate(
    name: str, counts: Integers, corners: NDArray[Any], vertices: Floats
) -> tuple[NDArray[Any], Integers]:
    """Polygons as triangles: fans around the first corner, or, if not convex, ears cut off.

    counts: (P,) corners of each polygon, at least 3. corners: (C,) the vertex of each, one polygon
    after the other, in range. vertices: (V, 3). Returns (F, 3) vertices of the triangles, and the
    (F,) polygon of each. Raises FormatError, its text beginning with `name`, for a polygon of more
    than 16,384 corners that is not convex. Method: loading/polygons.h.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3), np.arange(len(counts))
    try:
        places = _core.polygons(
            np.ascontiguousarray(vertices, np.float64),
            np.ascontiguousarray(counts, np.uint32),
            np.ascontiguousarray(corners, np.uint32),
        )
    except ValueError as error:
        raise FormatError(f"{name}: {error}") from None
    return corners[places], np.repeat(np.arange(len(counts)), counts - 2)


def check_indices(name: str, faces: Indices, vertices: int) -> None:
    """Raises FormatError, its text beginning with the mesh's name, for the first bad index."""
    check_corners(name, np.full(len(faces), 3), faces.ravel(), vertices)


def check_corners(name: str, counts: Integers, corners: Indices, vertices: int) -> None:
    """The same for the vertices of polygons, as triangulate() takes them."""
    if corners.size and (corners.min() < 0 or corners.max() >= vertices):
        at = int(np.argmax((corners < 0) | (corners >= vertices)))
        face = int(np.searchsorted(np.cumsum(counts), at, "right"))
        raise FormatError(
            f"{name}: face {face} refers to vertex {corners[at]}; it has {vertices}, from 0"
        )


def turned(vertices: Floats, faces: Indices, normals: Floats) -> Indices:
    """The faces, those that show their back where their vertices' normals point turned around.

    A file may wind its faces against its normals, and a transform that mirrors makes it do so.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    against = np.einsum("fi,fi->f", across, normals[faces].sum(axis=1)) < 0.0
    return np.where(against[:, None], faces[:, [0, 2, 1]], faces) if against.any() else faces


def smooth_normals(vertices: Floats, faces: Indices) -> NDArray[np.float32]:
    """(V, 3) normals at the vertices: those of the faces around, weighted by the angle there.

    G. Thürmer and C. A. Wüthrich, "Computing vertex normals from polygonal facets", Journal of
    Graphics Tools 3(1), 1998. A vertex of no face, or of faces that cancel, gets (1, 0, 0).
    """
    return _core.shading(_reals(vertices), np.ascontiguousarray(faces, np.uint32), None)[2]


def split_at_creases(
    vertices: Floats, faces: Indices, degrees: float
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32]]:
    """Faces over vertices of which each stands for one smooth part of the surface around it.

    Faces at a vertex that lie within half of `degrees` of the first there are one part. Else those
    that share an edge belong to the same part at its ends where their normals differ by less than
    `degrees`, and so do the neighbours of those. Returns the new (F, 3) faces; for each new
    vertex, the old one; and the new vertices' normals, as of smooth_normals.
    """
    return _core.shading(_reals(vertices), np.ascontiguousarray(faces, np.uint32), degrees)


def _reals(vertices: Floats) -> Floats:
    vertices = np.ascontiguousarray(vertices)
    return vertices if vertices.dtype in (np.float32, np.float64) else vertices.astype(np.float64)
