"""Subdivision surfaces as triangle meshes: Loop's scheme.

C. Loop, "Smooth Subdivision Surfaces Based on Triangles", University of Utah, 1987, with Warren's
weights and with boundaries as B-splines (H. Hoppe et al., "Piecewise Smooth Surface
Reconstruction", SIGGRAPH 1994), as in M. Pharr, W. Jakob and G. Humphreys, "Physically Based
Rendering", 3rd edition, section 3.8; but there boundaries end at 3/5 of a vertex and 1/5 of each
neighbour, which is not their limit. All of it works on whole arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import SceneError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Triangles that subdivision may make; each level makes four of one
_MOST_FACES = 1 << 21


@dataclass(frozen=True)
class _Edges:
    """The edges of a mesh, each once.

    ends (E, 2); opposite (E, K): sum of the values at the corners of its faces that face it;
    inner (E,): it has two faces; of_corner (F, 3): the edge from each corner to the next.
    """

    ends: Integers
    opposite: Floats
    inner: NDArray[np.bool_]
    of_corner: Integers


def most_levels(faces: int) -> int:
    """How often so many triangles may be subdivided."""
    levels = 0
    while 0 < faces * 4 ** (levels + 1) <= _MOST_FACES:
        levels += 1
    return levels


def loop(vertices: Any, faces: Any, levels: int) -> tuple[Floats, Integers, Floats]:
    """The mesh refined so many times: positions on the limit surface, faces, limit normals.

    vertices (V, 3), faces (F, 3) with indices in range. An edge of one face, or of more than two,
    is a boundary; a vertex at which other than two of those meet stays where it is. Raises
    SceneError for more than most_levels.
    """
    values = np.asarray(vertices, np.float64)
    corners = np.asarray(faces, np.int64)
    if levels > most_levels(len(corners)):
        raise SceneError(
            f"{len(corners)} faces, subdivided {levels} times, are more than {_MOST_FACES}"
        )
    for _ in range(levels):
        values, corners = _refined(values, corners)
    edges = _edges(values, corners)
    limit, valence, boundary, sharp = _smoothed(values, edges, limit=True)
    normals = _normals(values, corners, edges, valence, boundary, sharp)
    lost = ~(np.linalg.norm(normals, axis=1) > 1e-30)
    if lost.any():
        normals[lost] = _face_normals(limit, corners)[lost]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return limit, corners, normals / np.where(length > 0.0, length, 1.0)


def _edges(values: Floats, faces: Integers) -> _Edges:
    count = len(values)
    start, end = faces, np.roll(faces, -1, axis=1)
    low, high = np.minimum(start, end).ravel(), np.maximum(start, end).ravel()
    keys, index, uses = np.unique(low * count + high, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    facing = values[np.roll(faces, -2, axis=1).ravel()]
    opposite = _summed(index, facing, len(keys))
    ends = np.stack([keys // count, keys % count], axis=1)
    return _Edges(ends, opposite, uses == 2, index.reshape(-1, 3))


def _summed(index: Integers, values: Floats, count: int) -> Floats:
    """Rows of values added up by index."""
    columns = [np.bincount(index, values[:, k], minlength=count) for k in range(values.shape[1])]
    return np.stack(columns, axis=1)


def _refined(values: Floats, faces: Integers) -> tuple[Floats, Integers]:
    """One level: every triangle becomes four."""
    edges = _edges(values, faces)
    both = values[edges.ends].sum(axis=1)
    inner = edges.inner[:, None]
    middle = np.where(inner, 0.375 * both + 0.125 * edges.opposite, 0.5 * both)
    kept, _, _, _ = _smoothed(values, edges, limit=False)
    a, b, c = faces.T
    ab, bc, ca = (len(values) + edges.of_corner).T
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    refined = np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3)
    return np.concatenate([kept, middle]), refined


def _smoothed(
    values: Floats, edges: _Edges, *, limit: bool
) -> tuple[Floats, Integers, NDArray[np.bool_], NDArray[np.bool_]]:
    """Where old vertices go: at the next level, or in the limit.

    Also how many edges each has, whether it lies on a boundary, and whether it stays.
    """
    count = len(values)
    ends = edges.ends
    valence = np.bincount(ends.ravel(), minlength=count)
    around = _summed(ends.ravel(), values[ends[:, ::-1].ravel()], count)
    rim = ends[~edges.inner]
    rims = np.bincount(rim.ravel(), minlength=count)
    along = _summed(rim.ravel(), values[rim[:, ::-1].ravel()], count)
    n = np.maximum(valence, 1)
    beta = np.where(n == 3, 3.0 / 16.0, 3.0 / (8.0 * n))
    rim_weight = 0.125
    if limit:
        beta = 1.0 / (n + 3.0 / (8.0 * beta))
        rim_weight = 1.0 / 6.0  # of a cubic B-spline
    beta = beta[:, None]
    inside = (1.0 - n[:, None] * beta) * values + beta * around
    on_rim = (1.0 - 2.0 * rim_weight) * values + rim_weight * along
    boundary = rims > 0
    sharp = (boundary & (rims != 2)) | (valence == 0)
    moved = np.where(boundary[:, None], on_rim, inside)
    return np.where(sharp[:, None], values, moved), valence, boundary, sharp


def _normals(
    values: Floats,
    faces: Integers,
    edges: _Edges,
    valence: Integers,
    boundary: NDArray[np.bool_],
    sharp: NDArray[np.bool_],
) -> Floats:
    """Normals of the limit surface, of any length; 0 where the mesh is no surface.

    A vertex's neighbours are visited in turn, all vertices at once: the k-th neighbour enters the
    two tangents with the k-th weights.
    """
    count = len(values)
    begin = faces.ravel()
    half = (
        edges.of_corner.ravel()
    )  # the edge of each half edge, which goes from a corner to the next
    place = np.arange(len(begin))
    previous = place - 1 + 3 * (place % 3 == 0)
    # the other half edge of an inner edge, if it goes the other way; else -1
    order = np.argsort(half, kind="stable")
    first = np.flatnonzero(np.diff(half[order], prepend=-1))
    pair = first[edges.inner]
    one, two = order[pair], order[pair + 1] if len(pair) else order[pair]
    opposed = begin[one] != begin[two]
    twin = np.full(len(begin), -1)
    twin[one[opposed]], twin[two[opposed]] = two[opposed], one[opposed]
    # where the turn begins: on a boundary at its first edge, else anywhere
    start = np.full(count, -1)
    start[begin] = place
    rims = place[twin < 0]
    start[begin[rims]] = rims
    vertex = np.flatnonzero((start >= 0) & ~sharp)
    at = start[vertex]
    s, t = np.zeros((count, 3)), np.zeros((count, 3))
    visited = np.zeros(count, np.int64)
    after = np.roll(faces, -1, axis=1).ravel()
    for k in range(int(valence.max(initial=0))):
        target = after[at]
        _add_tangents(s, t, values, vertex, target, k, valence, boundary)
        visited[vertex] += 1
        following = twin[previous[at]]
        # the last neighbour of a boundary has no half edge of its own
        last = (following < 0) & boundary[vertex]
        if last.any():
            ending = vertex[last]
            _add_tangents(s, t, values, ending, begin[previous[at[last]]], k + 1, valence, boundary)
            visited[ending] += 1
        more = (following >= 0) & (following != start[vertex])
        vertex, at = vertex[more], following[more]
        if not len(vertex):
            break
    rim = boundary[:, None]
    normals = np.where(rim, np.cross(t, s), np.cross(s, t))
    # a vertex where two fans meet has neighbours that were not visited
    normals[(visited != valence) | sharp] = 0.0
    return np.asarray(normals)


def _add_tangents(
    s: Floats,
    t: Floats,
    values: Floats,
    vertex: Integers,
    neighbour: Integers,
    k: int,
    valence: Integers,
    boundary: NDArray[np.bool_],
) -> None:
    """Adds the k-th neighbours' share; relative to the vertex, which no sum of weights changes."""
    n = valence[vertex]
    turn = 2.0 * np.pi * k / n
    rim = boundary[vertex]
    theta = np.pi / np.maximum(n - 1, 1)
    ends = (k == 0) | (k == n - 1)
    # across a boundary, inwards, with weights of its own up to valence 4
    across = np.where(ends, -np.sin(theta), (2.0 - 2.0 * np.cos(theta)) * np.sin(k * theta))
    for size, (outer, inner) in {2: (1.0, 0.0), 3: (0.0, 1.0), 4: (-1.0, 2.0)}.items():
        across = np.where(n == size, np.where(ends, outer, inner), across)
    along = np.where(k == 0, -1.0, np.where(k == n - 1, 1.0, 0.0))
    offset = values[neighbour] - values[vertex]
    s[vertex] += np.where(rim, along, np.cos(turn))[:, None] * offset
    t[vertex] += np.where(rim, across, np.sin(turn))[:, None] * offset


def _face_normals(values: Floats, faces: Integers) -> Floats:
    """Normals at vertices as sums of those of the faces around, weighted by area."""
    a, b, c = (values[faces[:, k]] for k in range(3))
    across = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    return _summed(faces.ravel(), across, len(values))
