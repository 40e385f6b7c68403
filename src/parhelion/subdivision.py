"""Subdivision surfaces: Catmull-Clark, Loop and bilinear, with creases, corners and boundaries.

E. Catmull and J. Clark, "Recursively generated B-spline surfaces on arbitrary topological meshes",
Computer-Aided Design 10(6), 1978, for polygons; C. Loop, "Smooth Subdivision Surfaces Based on
Triangles", University of Utah, 1987, for triangles, also with J. Warren's simpler weights as in M.
Pharr, W. Jakob and G. Humphreys, "Physically Based Rendering", 3rd edition, section 3.8 (whose
boundaries end a little elsewhere than at their limit). Sharp creases: H. Hoppe et al., "Piecewise
Smooth Surface Reconstruction", SIGGRAPH 1994, section 3. Creases of a sharpness: T. DeRose, M. Kass
and T. Truong, "Subdivision Surfaces in Character Animation", SIGGRAPH 1998, section 3. Where
vertices lie in the limit: M. Halstead, M. Kass and T. DeRose, "Efficient, Fair Interpolation using
Catmull-Clark Surfaces", SIGGRAPH 1993, section 3.1.

All of it works on whole arrays. A polygon mesh is counts (P,), the number of each polygon's
corners, and corners (C,), all corners' vertices, one polygon after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import SceneError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

# Sharpness from which on a crease stays sharp at every level, as in OpenSubdiv
INFINITE = 10.0

# Faces that any mesh may be refined to
_LIMIT_FACES = 1 << 26
# Faces that a mesh is refined to unless it has them already; with these, edges of a model that
# fills a picture are some pixels long. It is refined at least twice, if that does not make more
# than the second number.
_ENOUGH_FACES = 1 << 14
_MOST_FACES = 1 << 20
_MOST_LEVELS = 5
# Levels beyond which one triangle alone is more than any budget
_POWERS = 32


@dataclass(frozen=True, eq=False)
class Refined:
    """A subdivided mesh, all faces with the same number of corners, n.

    points (V, 3): on the limit surface. normals (F, n, 3): at the corners; those of one vertex
    differ only where sharp creases meet in it. faces (F, n); parent (F,): the polygon that each
    was made of. smooth (V, K), linear (V, L), corner (F, n, M): the values of the same names.
    """

    points: Floats
    normals: Floats
    faces: Integers
    parent: Integers
    smooth: Floats
    linear: Floats
    corner: Floats


@dataclass(frozen=True, eq=False)
class _Creases:
    """Edges that are sharp, by their ends (E, 2), and vertices (K,), with how sharp they are."""

    ends: Integers
    edges: Floats
    vertices: Integers
    corners: Floats


@dataclass(frozen=True, eq=False)
class _Topology:
    """What touches what in a mesh of so many vertices.

    face, after, before (C,): of each corner its polygon and its neighbours there. of_corner (C,):
    the edge from each corner to the next. ends (E, 2), uses (E,): faces of an edge. sharp (E,),
    corner (V,): how sharp edges and vertices are; boundaries are infinitely so.
    """

    vertices: int
    counts: Integers
    corners: Integers
    first: Integers
    face: Integers
    after: Integers
    before: Integers
    of_corner: Integers
    ends: Integers
    uses: Integers
    sharp: Floats
    corner: Floats


def levels(faces: int) -> int:
    """How often to subdivide a mesh of so many faces."""
    count = 0
    while count < _MOST_LEVELS and faces << 2 * (count + 1) <= _ENOUGH_FACES:
        count += 1
    while count < 2 and faces << 2 * (count + 1) <= _MOST_FACES:
        count += 1
    return max(count, 1)


class Budget:
    """Triangles that subdivision may make in a scene, shared by its meshes.

    A file of a few lines can ask for as many as fill the memory. known: of meshes that are known
    beforehand, their triangles before they are subdivided and the levels that each wants. All of
    them get so many levels fewer that they take half of the budget at most. A mesh that comes takes
    at most half of what is left, so that there is always some for the next.
    """

    def __init__(self, most: int, known: Sequence[tuple[int, int]] = ()) -> None:
        self.most = self._left = most
        self._fewer, self._cut, self._most_cut = 0, 0, 0
        largest = max((wanted for _, wanted in known), default=0)
        while self._fewer < largest and 2 * self._total(known) > most:
            self._fewer += 1

    def _total(self, known: Sequence[tuple[int, int]]) -> int:
        return sum(n << 2 * max(min(wanted, _POWERS) - self._fewer, 0) for n, wanted in known)

    def levels(self, triangles: int, wanted: int, least: int = 0) -> int:
        """How often to subdivide a mesh of so many triangles; least: even if nothing is left."""
        count = min(wanted, _POWERS) - self._fewer
        while count > least and triangles << 2 * count > self._left // 2:
            count -= 1
        count = max(count, least)
        self._left = max(self._left - (triangles << 2 * count), 0)
        if count < wanted:
            self._cut += 1
            self._most_cut = max(self._most_cut, wanted - count)
        return count

    def report(self) -> str:
        """The sentence about meshes that were subdivided less than they want; "" if none was."""
        if not self._cut:
            return ""
        meshes = "one mesh is" if self._cut == 1 else f"{self._cut} meshes are"
        times = "once" if self._most_cut == 1 else f"up to {self._most_cut} times"
        return (
            f"{meshes} subdivided {times} less than asked for, as subdivision makes at most"
            f" {self.most} triangles of a scene"
        )


def subdivide(
    points: Any,
    counts: Any,
    corners: Any,
    *,
    levels: int,
    scheme: str = "catmullClark",
    creases: Any = (),
    sharpness: Any = (),
    corner_vertices: Any = (),
    corner_sharpness: Any = (),
    sharp_boundary_corners: bool = True,
    smooth: Any = None,
    linear: Any = None,
    corner: Any = None,
) -> Refined:
    """The mesh refined so many times and moved to its limit surface.

    scheme: "loop" or "warren" for triangles; "catmullClark" or "bilinear" for polygons, which must
    be refined at least once.
    points (V, 3); counts, each 3 or more; corners with indices in range. creases (E, 2): edges by
    their vertices, with their sharpness (E,): 0 is smooth, from INFINITE on sharp for ever. Others
    of a mesh's edges do no harm. corner_vertices (K,), corner_sharpness (K,): of vertices.
    sharp_boundary_corners: a vertex of one face only stays where it is. smooth (V, K): values that
    follow the same rules as points. linear (V, L), corner (C, M), these for each corner: values
    that are interpolated linearly.

    Raises SceneError for a mesh of triangles whose faces are none, and for results of more than
    2^26 faces.
    """
    values = np.asarray(points, np.float64)
    count, triangles = len(values), scheme in _BETA
    polygons, around = np.asarray(counts, np.int64), np.asarray(corners, np.int64)
    if triangles and (polygons != 3).any():
        face = int(np.argmax(polygons != 3))
        raise SceneError(f"face {face} has {polygons[face]} corners; Loop's scheme takes triangles")
    if len(around) << 2 * max(levels - 1, 0) > _LIMIT_FACES:
        raise SceneError(f"{len(polygons)} faces, subdivided {levels} times, are more than 2^26")
    extra = np.zeros((count, 0)) if smooth is None else np.asarray(smooth, np.float64)
    flat = np.zeros((count, 0)) if linear is None else np.asarray(linear, np.float64)
    at_corner = np.zeros((len(around), 0)) if corner is None else np.asarray(corner, np.float64)
    values = np.concatenate([values, extra], axis=1)
    rules = _Creases(
        np.asarray(creases, np.int64).reshape(-1, 2),
        np.asarray(sharpness, np.float64).reshape(-1),
        np.asarray(corner_vertices, np.int64).reshape(-1),
        np.asarray(corner_sharpness, np.float64).reshape(-1),
    )
    if sharp_boundary_corners:
        rules = _with_boundary_corners(rules, around, count)
    parent = np.arange(len(polygons))
    for _ in range(levels):
        t = _topology(len(values), polygons, around, rules)
        values = _step(t, values, scheme)
        flat = _step(t, flat, "linear" if triangles else "bilinear")
        at_corner = _corner_step(t, at_corner, triangles)
        parent = np.repeat(parent, 4 if triangles else t.counts)
        around = _child_corners(t, triangles)
        polygons = np.full(len(parent), 3 if triangles else 4)
        rules = _child_creases(t)
    t = _topology(len(values), polygons, around, rules)
    refined = values
    if scheme != "bilinear":
        values = _limit(t, refined, scheme)
    normals = _normals(t, values[:, :3], everywhere=scheme != "bilinear")
    if triangles:
        normals = _tangent_normals(t, refined[:, :3], normals)
    size = 3 if triangles else 4
    return Refined(
        points=values[:, :3],
        normals=normals.reshape(-1, size, 3),
        faces=around.reshape(-1, size),
        parent=parent,
        smooth=values[:, 3:],
        linear=flat,
        corner=at_corner.reshape(len(parent), size, at_corner.shape[1]),
    )


def _summed(index: Integers, values: Floats, count: int) -> Floats:
    """Rows of values added up by index."""
    total = np.zeros((count, values.shape[1]))
    for k in range(values.shape[1]):
        total[:, k] = np.bincount(index, values[:, k], minlength=count)
    return total


def _with_boundary_corners(rules: _Creases, corners: Integers, count: int) -> _Creases:
    """A vertex of one face lies on the boundary, at a corner of the surface."""
    single = np.flatnonzero(np.bincount(corners, minlength=count) == 1)
    return _Creases(
        rules.ends,
        rules.edges,
        np.concatenate([rules.vertices, single]),
        np.concatenate([rules.corners, np.full(len(single), np.inf)]),
    )


def _topology(count: int, counts: Integers, corners: Integers, rules: _Creases) -> _Topology:
    first = np.cumsum(counts) - counts
    face = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(corners))
    after, before = place + 1, place - 1
    last = first + counts - 1
    after[last], before[first] = first, last
    start, end = corners, corners[after]
    key = np.minimum(start, end) * count + np.maximum(start, end)
    keys, of_corner, uses = np.unique(key, return_inverse=True, return_counts=True)
    sharp = np.zeros(len(keys))
    if len(rules.ends) and len(keys):
        low, high = rules.ends.min(axis=1), rules.ends.max(axis=1)
        wanted = low * count + high
        found = np.searchsorted(keys, wanted).clip(max=len(keys) - 1)
        there = keys[found] == wanted
        np.maximum.at(sharp, found[there], rules.edges[there])
    sharp[(uses != 2) | (sharp >= INFINITE)] = np.inf
    corner = np.zeros(count)
    np.maximum.at(corner, rules.vertices, rules.corners)
    corner[corner >= INFINITE] = np.inf
    ends = np.stack([keys // count, keys % count], axis=1)
    return _Topology(
        count, counts, corners, first, face, after, before, of_corner.reshape(-1), ends, uses,
        sharp, corner,
    )  # fmt: skip


# --- One level -----------------------------------------------------------------------------------


def _loop_beta(n: Floats) -> Floats:
    return np.asarray((0.625 - (0.375 + 0.25 * np.cos(2.0 * np.pi / n)) ** 2) / n)


def _warren_beta(n: Floats) -> Floats:
    return np.where(n == 3.0, 3.0 / 16.0, 3.0 / (8.0 * n))


# Schemes of triangles: the weight of each of a vertex' n neighbours
_BETA = {"loop": _loop_beta, "warren": _warren_beta}


def _step(t: _Topology, values: Floats, scheme: str) -> Floats:
    """Values at the old vertices, then those at edges, then, but of triangles, those in faces.

    scheme: that of subdivide, or "linear", which is to triangles what "bilinear" is to polygons.
    """
    both = values[t.ends].sum(axis=1)
    edges = 0.5 * both
    if scheme == "linear":
        return np.concatenate([values, edges])
    if scheme in _BETA:
        facing = _summed(t.of_corner, values[t.corners[t.before]], len(t.ends))
        edges = _blend(t.sharp, edges, 0.375 * both + 0.125 * facing)
        return np.concatenate([_moved(t, values, scheme), edges])
    inside = _summed(t.face, values[t.corners], len(t.counts)) / t.counts[:, None]
    if scheme == "bilinear":
        return np.concatenate([values, edges, inside])
    beside = _summed(t.of_corner, inside[t.face], len(t.ends))
    edges = _blend(t.sharp, edges, 0.25 * (both + beside))
    return np.concatenate([_moved(t, values, scheme, inside), edges, inside])


def _blend(sharp: Floats, crease: Floats, smooth: Floats) -> Floats:
    """A crease of a sharpness below 1 is some of both."""
    share = np.minimum(sharp, 1.0)[:, None]
    return np.asarray(share * crease + (1.0 - share) * smooth)


def _around(t: _Topology, values: Floats, chosen: Flags | None = None) -> tuple[Integers, Floats]:
    """Of each vertex, how many edges it has, and the sum of the values at their other ends."""
    ends = t.ends if chosen is None else t.ends[chosen]
    count = np.bincount(ends.ravel(), minlength=t.vertices)
    return count, _summed(ends.ravel(), values[ends[:, ::-1].ravel()], t.vertices)


def _moved(t: _Topology, values: Floats, scheme: str, inside: Floats | None = None) -> Floats:
    """Where the old vertices go; inside: values in the middle of faces, of polygons."""
    valence, near = _around(t, values)
    n = np.maximum(valence, 1)[:, None].astype(np.float64)
    if inside is None:
        beta = _BETA[scheme](n)
        smooth = (1.0 - n * beta) * values + beta * near
    else:
        across = _summed(t.corners, inside[t.face], t.vertices)
        smooth = (n - 2.0) / n * values + (near + across) / (n * n)
    sharper = _by_rule(t, values, smooth, t.sharp, t.corner, (0.75, 0.125))
    later, later_corner = np.maximum(t.sharp - 1.0, 0.0), np.maximum(t.corner - 1.0, 0.0)
    result = _by_rule(t, values, smooth, later, later_corner, (0.75, 0.125))
    # What is about to become smooth is some of both, by its mean sharpness.
    ending = (t.sharp > 0.0) & (later <= 0.0)
    ends = t.ends[ending].ravel()
    total = _summed(ends, np.repeat(t.sharp[ending], 2)[:, None], t.vertices)[:, 0]
    number = np.bincount(ends, minlength=t.vertices).astype(np.float64)
    vertex = (t.corner > 0.0) & (later_corner <= 0.0)
    total[vertex] += t.corner[vertex]
    number[vertex] += 1.0
    share = np.where(number > 0.0, total / np.maximum(number, 1.0), 0.0)
    return _blend(share, sharper, result)


def _by_rule(
    t: _Topology,
    values: Floats,
    smooth: Floats,
    sharp: Floats,
    corner: Floats,
    weights: tuple[float, float],
) -> Floats:
    """Where two sharp edges meet, a curve goes through, by weights; where more meet, a corner is.

    One sharp edge alone ends in a smooth vertex.
    """
    number, along = _around(t, values, sharp > 0.0)
    own, beside = weights
    result = np.where((number == 2)[:, None], own * values + beside * along, smooth)
    unused = np.bincount(t.corners, minlength=t.vertices) == 0
    stays = (corner > 0.0) | (number > 2) | unused
    return np.where(stays[:, None], values, result)


def _child_corners(t: _Topology, triangles: bool) -> Integers:
    """Vertices of the new faces' corners, one face after the other."""
    edge = t.vertices + t.of_corner
    if triangles:
        a, b, c = t.corners.reshape(-1, 3).T
        ab, bc, ca = edge.reshape(-1, 3).T
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        return np.stack([np.stack(part, axis=1) for part in parts], axis=1).ravel()
    middle = t.vertices + len(t.ends) + t.face
    return np.stack([t.corners, edge, middle, edge[t.before]], axis=1).ravel()


def _corner_step(t: _Topology, values: Floats, triangles: bool) -> Floats:
    """Values of the new faces' corners, in the order of _child_corners."""
    half = 0.5 * (values + values[t.after])  # on the edge from a corner to the next
    if triangles:
        a, b, c = (values[k::3] for k in range(3))
        ab, bc, ca = (half[k::3] for k in range(3))
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        stacked = np.stack([np.stack(part, axis=1) for part in parts], axis=1)
    else:
        middle = (_summed(t.face, values, len(t.counts)) / t.counts[:, None])[t.face]
        stacked = np.stack([values, half, middle, half[t.before]], axis=1)
    return stacked.reshape(int(np.prod(stacked.shape[:-1])), values.shape[1])


def _child_creases(t: _Topology) -> _Creases:
    """Both halves of a crease are one less sharp."""
    sharp = np.flatnonzero((t.sharp > 1.0) & (t.uses == 2))
    middle = t.vertices + sharp
    ends = np.concatenate([np.stack([t.ends[sharp, k], middle], axis=1) for k in range(2)])
    corner = np.flatnonzero(t.corner > 1.0)
    return _Creases(ends, np.tile(t.sharp[sharp] - 1.0, 2), corner, t.corner[corner] - 1.0)


# --- The limit -----------------------------------------------------------------------------------


def _limit(t: _Topology, values: Floats, scheme: str) -> Floats:
    """Where vertices end; what is still sharp counts as sharp for ever."""
    valence, near = _around(t, values)
    n = np.maximum(valence, 1)[:, None].astype(np.float64)
    if scheme in _BETA:
        share = 1.0 / (n + 3.0 / (8.0 * _BETA[scheme](n)))
        smooth = (1.0 - n * share) * values + share * near
    else:
        opposite = _summed(t.corners, values[t.corners[t.after[t.after]]], t.vertices)
        smooth = (n * n * values + 4.0 * near + opposite) / (n * (n + 5.0))
    return _by_rule(t, values, smooth, t.sharp, t.corner, (2.0 / 3.0, 1.0 / 6.0))


def _normals(t: _Topology, points: Floats, everywhere: bool) -> Floats:
    """Normals at corners (C, 3): means over the faces around, up to creases, weighted by angle.

    everywhere: else each face has its own.
    """
    corner = points[t.corners]
    to_next, to_last = corner[t.after] - corner, corner[t.before] - corner
    across = np.cross(to_next, to_last)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arctan2(size[:, 0], np.einsum("ci,ci->c", to_next, to_last))
    across *= (angle / np.where(size[:, 0] > 0.0, size[:, 0], 1.0))[:, None]
    part = _parts(t) if everywhere else t.face
    total = _summed(part, across, int(part.max(initial=-1)) + 1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    lost = length[:, 0] < 1e-12
    total[lost], length[lost] = (1.0, 0.0, 0.0), 1.0
    return np.asarray((total / length)[part])


def _tangent_normals(t: _Topology, points: Floats, normals: Floats) -> Floats:
    """Normals at corners, those of the limit surface itself at vertices where all is smooth.

    points: before they are moved to the limit. The k-th of n neighbours, in turn, enters two
    tangents by cos and sin of 2 pi k / n (Hoppe et al. 1994, section 4).
    """
    half = np.arange(len(t.corners))
    smooth = (t.uses == 2) & (t.sharp == 0.0)
    closed = np.ones(t.vertices, bool)
    closed[t.ends[~smooth]] = False
    # the half edge that runs the other way along a smooth edge
    order = np.argsort(t.of_corner, kind="stable")
    pair = (np.cumsum(t.uses) - t.uses)[smooth]
    one, two = order[pair], order[pair + 1] if len(pair) else order[pair]
    opposed = t.corners[one] != t.corners[two]
    twin = half.copy()
    twin[one[opposed]], twin[two[opposed]] = two[opposed], one[opposed]
    closed[t.corners[twin == half]] = False
    valence, _ = _around(t, points)
    start = np.full(t.vertices, -1)
    start[t.corners] = half
    vertex = np.flatnonzero((start >= 0) & closed)
    at = start[vertex]
    s, u, visited = np.zeros((t.vertices, 3)), np.zeros((t.vertices, 3)), np.zeros(t.vertices)
    for k in range(int(valence[vertex].max(initial=0))):
        turn = (2.0 * np.pi * k / valence[vertex])[:, None]
        offset = points[t.corners[t.after[at]]] - points[vertex]
        s[vertex] += np.cos(turn) * offset
        u[vertex] += np.sin(turn) * offset
        visited[vertex] += 1
        at = twin[t.before[at]]
        more = at != start[vertex]
        vertex, at = vertex[more], at[more]
    exact = np.cross(s, u)
    length = np.linalg.norm(exact, axis=1, keepdims=True)
    # where fans meet that do not touch, some neighbours were not visited
    known = closed & (visited == valence) & (length[:, 0] > 1e-30)
    exact /= np.where(length > 0.0, length, 1.0)
    return np.where(known[t.corners, None], exact[t.corners], normals)


def _parts(t: _Topology) -> Integers:
    """A number for each corner; corners of one vertex share it unless creases part them."""
    inner = t.uses == 2
    crease = inner & (t.sharp > 0.0)
    touched = np.zeros(t.vertices, bool)
    touched[t.ends[crease]] = True
    place = np.arange(len(t.corners))
    label = np.where(touched[t.corners], t.vertices + place, t.corners)
    # Corners of one vertex are joined across each smooth edge there.
    order = np.argsort(t.of_corner, kind="stable")
    pair = (np.cumsum(t.uses) - t.uses)[inner & ~crease]
    one, other = order[pair], order[pair + 1] if len(pair) else order[pair]
    left = np.concatenate([one, t.after[one]])
    same = t.corners[one] == t.corners[other]  # both faces run along the edge the same way
    right = np.concatenate(
        [np.where(same, other, t.after[other]), np.where(same, t.after[other], other)]
    )
    changing = touched[t.corners[left]]
    left, right = left[changing], right[changing]
    while len(left):
        least = np.minimum(label[left], label[right])
        if (least == label[left]).all() and (least == label[right]).all():
            break
        np.minimum.at(label, left, least)
        np.minimum.at(label, right, least)
    used = np.zeros(t.vertices + len(place), bool)
    used[label] = True
    return (np.cumsum(used) - 1)[label]
