"""Files of triangle meshes: one module a format, each with `read`.

What NumPy is slow at, numbers in text, OBJ's lines, equal rows and normals, is compiled (loading/).

A reader checks what it returns: every index in range, every array of one length.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    """

    vertices: Floats
    faces: Indices
    normals: Floats | None = None
    uvs: Floats | None = None
    attributes: Mapping[str, Floats] = field(default_factory=dict)
    face_normals: bool = False


def triangulate(counts: Integers, corners: NDArray[Any]) -> tuple[NDArray[Any], Integers]:
    """Polygons as fans of triangles around their first corner.

    counts: (P,) corners of each polygon, at least 3. corners: all of them, one after the other;
    (C,) or (C, K). Returns (F, 3) or (F, 3, K) corners and the (F,) polygon of each triangle.
    """
    if (counts == 3).all():
        return corners.reshape(-1, 3, *corners.shape[1:]), np.arange(len(counts))
    triangles = counts - 2
    polygon = np.repeat(np.arange(len(counts)), triangles)
    first = (np.cumsum(counts) - counts)[polygon]
    before = (np.cumsum(triangles) - triangles)[polygon]
    second = first + np.arange(len(polygon)) - before + 1
    return np.stack([corners[first], corners[second], corners[second + 1]], axis=1), polygon


def check_indices(name: str, faces: Indices, vertices: int) -> None:
    """Raises FormatError, its text beginning with the mesh's name, for the first bad index."""
    if faces.size and (faces.min() < 0 or faces.max() >= vertices):
        bad = (faces < 0) | (faces >= vertices)
        face = int(np.argmax(bad.any(axis=1)))
        index = int(faces[face][bad[face]][0])
        raise FormatError(
            f"{name}: face {face} refers to vertex {index}; it has {vertices}, from 0"
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

    Faces that share an edge belong to the same part at its ends where their normals differ by less
    than `degrees`, and so do the neighbours of those. Returns the new (F, 3) faces; for each new
    vertex, the old one; and the new vertices' normals, as of smooth_normals.
    """
    return _core.shading(_reals(vertices), np.ascontiguousarray(faces, np.uint32), degrees)


def _reals(vertices: Floats) -> Floats:
    vertices = np.ascontiguousarray(vertices)
    return vertices if vertices.dtype in (np.float32, np.float64) else vertices.astype(np.float64)
