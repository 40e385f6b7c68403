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


def _edges(vertices: Floats, faces: Integers) -> tuple[list[NDArray[np.float64]], ...]:
    """The (F,) coordinates x, y, z of the edges from each corner to the next, of three corners.

    Arrays of one coordinate are several times as fast to work on as rows of three.
    """
    edges: tuple[list[NDArray[np.float64]], ...] = ([], [], [])
    first, second, third = np.ascontiguousarray(faces.T)
    for along in np.ascontiguousarray(np.asarray(vertices, np.float64).T):
        a, b, c = along[first], along[second], along[third]
        for edge, difference in zip(edges, (b - a, c - b, a - c), strict=True):
            edge.append(difference)
    return edges


def _unit_normals(
    edges: tuple[list[NDArray[np.float64]], ...],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, F) normals of faces, 0 of those without an area; and (F,) twice the area."""
    (ax, ay, az), (bx, by, bz) = edges[:2]
    normals = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    area = np.sqrt(_dot(normals, normals))
    normals /= np.where(area == 0.0, 1.0, area)
    return normals, area


def _dot(a: Any, b: Any) -> Any:
    """Of vectors as three arrays of coordinates."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def smooth_normals(vertices: Floats, faces: Integers) -> NDArray[np.float64]:
    """Normals at the vertices: those of the faces around, weighted by the angle there.

    G. Thürmer and C. A. Wüthrich, "Computing vertex normals from polygonal facets", Journal of
    Graphics Tools 3(1), 1998. A vertex of no face, or of faces that cancel, gets (1, 0, 0).
    """
    edges = _edges(vertices, faces)
    normals, area = _unit_normals(edges)  # the sine of each corner's angle times its two edges
    angles = [np.arctan2(area, -_dot(edges[i], edges[i - 1])) for i in range(3)]
    at = faces.T.ravel()
    total = np.stack(
        [
            np.bincount(at, np.concatenate([axis * a for a in angles]), minlength=len(vertices))
            for axis in normals
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
    `degrees`, and so do the neighbours of those. A vertex around which all edges are smooth and
    shared by two faces is one part. Returns the new (F, 3) faces and, for each new vertex, the old
    one.
    """
    normals, _ = _unit_normals(_edges(vertices, faces))
    # A half edge has the number of the corner where it begins. Those that run between the same two
    # vertices, one after the other; of more than two, as where three sheets meet, neighbours in
    # this order.
    begin, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    order, key = in_order(np.minimum(begin, end) * len(vertices) + np.maximum(begin, end))
    twin = np.flatnonzero(key[1:] == key[:-1])
    one, other = order[twin], order[twin + 1]
    flat = _dot([axis[one // 3] for axis in normals], [axis[other // 3] for axis in normals])
    smooth = flat > np.cos(np.radians(degrees))
    one, other = one[smooth], other[smooth]

    shared = np.bincount(one, minlength=faces.size) + np.bincount(other, minlength=faces.size)
    edge = np.flatnonzero(shared != 1)  # sharp, open, or of more than two faces
    rough = np.zeros(len(vertices), np.bool_)
    rough[begin[edge]] = rough[end[edge]] = True
    near = rough[begin[one]] | rough[end[one]]
    one, other = one[near], other[near]
    # The corners at both ends of such an edge are one vertex.
    along = begin[one] == begin[other]
    next_one, next_other = (h + 1 - 3 * (h % 3 == 2) for h in (one, other))
    left = np.concatenate([one, next_one])
    right = np.concatenate([np.where(along, other, next_other), np.where(along, next_other, other)])
    inside = rough[begin[left]]
    # From here on only corners at rough vertices, by their places among these
    corners = np.flatnonzero(rough[begin])
    left, right = (np.searchsorted(corners, side[inside]) for side in (left, right))
    label = np.arange(len(corners))
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
    # The part that comes first keeps the vertex's number.
    parts = np.flatnonzero(label == np.arange(len(corners)))
    vertex = begin[corners[parts]]
    kept = np.zeros(len(parts), np.bool_)
    kept[distinct(vertex)[1]] = True
    number = np.where(kept, vertex, len(vertices) - 1 + np.cumsum(~kept))
    chosen = begin.copy()
    chosen[corners] = number[np.searchsorted(parts, label)]
    old = np.concatenate([np.arange(len(vertices)), vertex[~kept]])
    used = np.zeros(len(old), np.bool_)
    used[chosen] = True
    if not used.all():
        chosen, old = (np.cumsum(used) - 1)[chosen], old[used]
    return chosen.reshape(-1, 3), old
