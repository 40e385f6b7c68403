"""Files of triangle meshes: one module a format, each with `read`, made of NumPy operations only.

A reader checks what it returns: every index in range, every array of one length.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError

Floats = NDArray[np.floating[Any]]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MeshData:
    """What a mesh file holds.

    vertices (V, 3), faces (F, 3); normals (V, 3) and uvs (V, 2) or None. attributes: further
    arrays, "vertex_NAME" and "face_NAME". face_normals: the file itself asks for flat faces.
    """

    vertices: Floats
    faces: Integers
    normals: Floats | None = None
    uvs: Floats | None = None
    attributes: Mapping[str, Floats] = field(default_factory=dict)
    face_normals: bool = False


def triangulate(counts: Integers, corners: Integers) -> tuple[Integers, Integers]:
    """Polygons as fans of triangles around their first corner.

    counts: (P,) corners of each polygon, at least 3. corners: all of them, one after the other;
    (C,) or (C, K). Returns (F, 3) or (F, 3, K) corners and the (F,) polygon of each triangle.
    """
    triangles = counts - 2
    polygon = np.repeat(np.arange(len(counts)), triangles)
    first = (np.cumsum(counts) - counts)[polygon]
    before = (np.cumsum(triangles) - triangles)[polygon]
    second = first + np.arange(len(polygon)) - before + 1
    return np.stack([corners[first], corners[second], corners[second + 1]], axis=1), polygon


def check_indices(name: str, faces: Integers, vertices: int) -> None:
    """Raises FormatError, its text beginning with the mesh's name, for the first bad index."""
    bad = (faces < 0) | (faces >= vertices)
    if bad.any():
        face = int(np.argmax(bad.any(axis=1)))
        index = int(faces[face][bad[face]][0])
        raise FormatError(
            f"{name}: face {face} refers to vertex {index}; it has {vertices}, from 0"
        )


def turned(vertices: Floats, faces: Integers, normals: Floats) -> Integers:
    """The faces, those that show their back where their vertices' normals point turned around.

    A file may wind its faces against its normals, and a transform that mirrors makes it do so.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    against = np.einsum("fi,fi->f", across, normals[faces].sum(axis=1)) < 0.0
    return np.where(against[:, None], faces[:, [0, 2, 1]], faces) if against.any() else faces


def smooth_normals(vertices: Floats, faces: Integers) -> NDArray[np.float64]:
    """Normals at the vertices: those of the faces around, weighted by the angle there.

    G. Thürmer and C. A. Wüthrich, "Computing vertex normals from polygonal facets", Journal of
    Graphics Tools 3(1), 1998. A vertex of no face, or of faces that cancel, gets (1, 0, 0).
    """
    corners = np.asarray(vertices, np.float64)[faces]
    edge = np.roll(corners, -1, axis=1) - corners  # (F, 3, 3): from each corner to the next
    back = -np.roll(edge, 1, axis=1)
    normal = np.cross(edge[:, 0], edge[:, 1])
    area = np.linalg.norm(normal, axis=1)
    flat = area == 0.0
    normal /= np.where(flat, 1.0, area)[:, None]
    sine = np.linalg.norm(np.cross(edge, back), axis=2)
    angle = np.arctan2(sine, np.einsum("fci,fci->fc", edge, back))
    weighted = normal[:, None, :] * np.where(flat[:, None], 0.0, angle)[:, :, None]
    total = np.stack(
        [
            np.bincount(faces.ravel(), weighted[:, :, axis].ravel(), minlength=len(vertices))
            for axis in range(3)
        ],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    lost = length[:, 0] < 1e-12
    total[lost] = (1.0, 0.0, 0.0)
    length[lost] = 1.0
    return np.asarray(total / length)


def split_at_creases(
    vertices: Floats, faces: Integers, degrees: float
) -> tuple[Integers, Integers]:
    """Faces over vertices of which each stands for one smooth part of the surface around it.

    Faces that share an edge belong to the same part where their normals differ by less than
    `degrees`, and so do the neighbours of those. Returns the new (F, 3) faces and, for each new
    vertex, the old one.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(length == 0.0, 1.0, length)
    # Half edges that run between the same two vertices, one after the other; of more than two, as
    # where three sheets meet, neighbours in this order.
    begin, end = faces, np.roll(faces, -1, axis=1)
    key = (np.minimum(begin, end) * len(vertices) + np.maximum(begin, end)).ravel()
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    one, other = order[twin], order[twin + 1]
    flat = np.einsum("ei,ei->e", normals[one // 3], normals[other // 3])
    smooth = flat > np.cos(np.radians(degrees))
    one, other = one[smooth], other[smooth]

    # The corners at both ends of such an edge are one vertex.
    def corner(half_edge: Integers, vertex: Integers) -> Integers:
        face, side = half_edge // 3, half_edge % 3
        return 3 * face + np.where(faces[face, side] == vertex, side, (side + 1) % 3)

    pairs = []
    for at in (begin.ravel()[one], end.ravel()[one]):
        pairs.append(np.stack([corner(one, at), corner(other, at)]))
    left, right = np.concatenate(pairs, axis=1)
    label = np.arange(3 * len(faces))
    while True:
        least = np.minimum(label[left], label[right])
        lower = label.copy()
        np.minimum.at(lower, label[left], least)
        np.minimum.at(lower, label[right], least)
        lower = lower[lower[label]]
        if np.array_equal(lower, label):
            break
        label = lower
    chosen, index = np.unique(label, return_inverse=True)
    return index.reshape(-1, 3).astype(np.int64), faces.ravel()[chosen].astype(np.int64)
