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


def in_order(keys: Integers) -> tuple[Integers, Integers]:
    """The places of keys, which are not negative, from the least to the greatest, equal ones as
    they stood; and the keys so.
    """
    bits = len(keys).bit_length()
    if (
        int(keys.max(initial=0)).bit_length() + bits < 64
    ):  # one sort of both is several times faster
        both = np.sort(keys << bits | np.arange(len(keys)))
        return both & ((1 << bits) - 1), both >> bits
    order = np.argsort(keys, kind="stable")
    return order, keys[order]


def distinct(keys: Integers) -> tuple[Integers, Integers]:
    """Which of the different keys, from the least, each key is; and where each stands first."""
    order, keys = in_order(keys)
    new = np.append(True, keys[1:] != keys[:-1])[: len(keys)]
    which = np.empty_like(order)
    which[order] = np.cumsum(new) - 1
    return which, order[new]


def smooth_normals(vertices: Floats, faces: Integers) -> NDArray[np.float64]:
    """Normals at the vertices: those of the faces around, weighted by the angle there.

    G. Thürmer and C. A. Wüthrich, "Computing vertex normals from polygonal facets", Journal of
    Graphics Tools 3(1), 1998. A vertex of no face, or of faces that cancel, gets (1, 0, 0).
    """
    corners = [np.asarray(vertices, np.float64)[faces[:, i]] for i in range(3)]
    edges = [corners[(i + 1) % 3] - corners[i] for i in range(3)]
    normal = np.cross(edges[0], edges[1])
    area = np.sqrt(np.einsum("fi,fi->f", normal, normal))  # of the parallelogram at any corner
    flat = area == 0.0
    normal /= np.where(flat, 1.0, area)[:, None]
    weighted = np.empty((3, 3, len(faces)))  # axis, corner, face
    for i in range(3):
        angle = np.arctan2(area, -np.einsum("fi,fi->f", edges[i], edges[i - 1]))
        angle[flat] = 0.0
        np.multiply(normal.T, angle, out=weighted[:, i])
    at = faces.T.ravel()
    total = np.stack(
        [np.bincount(at, values.ravel(), minlength=len(vertices)) for values in weighted], axis=1
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
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    length = np.sqrt(np.einsum("fi,fi->f", normals, normals))
    normals /= np.where(length == 0.0, 1.0, length)[:, None]
    # A half edge has the number of the corner where it begins. Those that run between the same two
    # vertices, one after the other; of more than two, as where three sheets meet, neighbours in
    # this order.
    count = faces.size
    begin, after = faces.ravel(), np.roll(np.arange(count).reshape(-1, 3), -1, axis=1).ravel()
    end = begin[after]
    key = np.minimum(begin, end) * len(vertices) + np.maximum(begin, end)
    order, key = in_order(key)
    twin = np.flatnonzero(key[1:] == key[:-1])
    one, other = order[twin], order[twin + 1]
    flat = np.einsum("ei,ei->e", normals[one // 3], normals[other // 3])
    smooth = flat > np.cos(np.radians(degrees))
    one, other = one[smooth], other[smooth]
    # The corners at both ends of such an edge are one vertex.
    along = begin[one] == begin[other]
    left = np.concatenate([one, after[one]])
    right = np.concatenate(
        [np.where(along, other, after[other]), np.where(along, after[other], other)]
    )
    label = np.arange(count)
    while True:
        first, second = label[left], label[right]
        apart = first != second
        if not apart.any():
            break
        left, right, first, second = left[apart], right[apart], first[apart], second[apart]
        least = np.minimum(first, second)
        np.minimum.at(label, first, least)
        np.minimum.at(label, second, least)
        while not np.array_equal(lower := label[label], label):
            label = lower
    own = label == np.arange(count)
    return (np.cumsum(own) - 1)[label].reshape(-1, 3), begin[own].astype(np.int64)
