"""Bodies that particles are drawn as in the place of spheres, each turned and scaled by its own.

A body is a few shapes in a frame of its own, kept once for all particles that are drawn as it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError, unknown_name
from ..scene import Cylinders, Disks, Instances, Material, Mesh, Solid, Spheres
from .limits import FARTHEST, SMALLEST, Floats, refuse

Body = Sequence[Solid]

# Bodies by name; those after the first, of half the extents that each particle has along its axes.
NAMES = ("sphere", "ellipsoid", "box", "cylinder", "spherocylinder", "polyhedron")

# Vertices that a convex hull is looked for; these take seconds.
_MOST_VERTICES = 4096
_MOST_CORNERS = 1_000  # of a polygon that is not convex
# Directions and distances that differ by less than this share are the same.
_SAME = 1e-6
_MATERIAL = Material("diffuse")


@dataclass(frozen=True, eq=False)
class Glyphs:
    """What N particles are drawn as: particle i as bodies[codes[i]], None being a sphere.

    codes: (N,). sizes: (N, 3) factors along the body's own axes; None is 1. orientations: (N, 4)
    quaternions w, x, y, z, of any length but 0, that turn the body's frame to the scene's: a vector
    v of the body points along q v q* in the scene. None is no turn.
    Raises SceneError for arrays that do not fit, and for a size that is not positive or a
    quaternion that is 0 or not finite, naming the particle, from 0; those of spheres are not used.
    """

    bodies: Sequence[Body | None]
    codes: NDArray[np.integer[Any]]
    sizes: Floats | None = None
    orientations: Floats | None = None

    def __post_init__(self) -> None:
        """Checks the numbers; see the class."""
        drawn = ~self.spheres()
        for what, values, width in (
            ("sizes", self.sizes, 3),
            ("orientations", self.orientations, 4),
        ):
            if values is not None and values.shape != (len(self.codes), width):
                raise SceneError(f"{what} have shape {values.shape}, not (N, {width})")
        if self.sizes is not None:
            good = ((self.sizes > SMALLEST) & (self.sizes <= FARTHEST)).all(axis=1) | ~drawn
            refuse(good, self.sizes, "size {} is not three positive numbers of single precision")
        if self.orientations is not None:
            largest = np.abs(self.orientations).max(axis=1)
            good = ((largest > 0) & np.isfinite(largest)) | ~drawn  # NaN is not finite either
            refuse(good, self.orientations, "orientation {} is not a quaternion of a rotation")

    def spheres(self) -> NDArray[np.bool_]:
        """(N,) whether a particle is a sphere."""
        plain = np.array([body is None for body in self.bodies], bool)
        return np.asarray(plain[self.codes])


def named(
    count: int,
    shapes: str | Sequence[str] | NDArray[np.str_],
    half_extents: ArrayLike | None = None,
    orientations: ArrayLike | None = None,
    vertices: ArrayLike | None = None,
    rounding: float = 0.0,
) -> Glyphs:
    """N particles as bodies in NAMES, one for all or (N,) of them.

    half_extents: (N, 3) or (3,): the semi-axes of an ellipsoid, half the edges of a box, the radius
    twice and half the length, along z, of a cylinder and, with its round ends, a spherocylinder; of
    a polyhedron, factors of its vertices. orientations: as in Glyphs. vertices: (M, 3) whose convex
    hull polyhedra are. rounding: a radius of its edges and corners, which adds to its size.
    Raises SceneError.
    """
    kinds, codes = np.unique(np.broadcast_to(np.asarray(shapes), count), return_inverse=True)
    for kind in kinds.tolist():
        if kind not in NAMES:
            raise SceneError(unknown_name("shape of particles", str(kind), NAMES))
    sizes = np.ones((count, 3)) if half_extents is None else _rows(half_extents, count, 3)
    turns = None if orientations is None else _rows(orientations, count, 4)
    bodies: list[Body | None] = []
    place = np.empty(count, np.intp)
    for code, kind in enumerate(kinds.tolist()):
        mine = codes.reshape(-1) == code
        if half_extents is None and kind not in ("sphere", "polyhedron"):
            raise SceneError(f"particles of shape {kind!r} need half extents along three axes")
        place[mine] = len(bodies)
        if kind == "ellipsoid":
            bodies.append(ball())
        elif kind == "box":
            bodies.append(cube())
        elif kind == "cylinder":
            bodies.append(cylinder())
        elif kind == "spherocylinder":
            radius, length = sizes[mine, 0], sizes[mine, 2]
            round_ones = (sizes[mine, 1] == radius) & (length >= radius)
            if not round_ones.all():
                first = int(np.flatnonzero(mine)[np.argmin(round_ones)])
                shown = " ".join(f"{v:g}" for v in sizes[first].tolist())
                raise SceneError(
                    f"particle {first}: a spherocylinder's half extents ({shown}) must be the"
                    " radius, the radius and half the length, which is no less"
                )
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                ratios, which = np.unique(length / radius, return_inverse=True)
            place[mine] += which.reshape(-1)
            bodies += map(capsule, np.nan_to_num(ratios).tolist())  # no radius is refused below
            sizes[mine] = radius[:, None]
        elif kind == "polyhedron":
            if vertices is None:
                raise SceneError("particles of shape 'polyhedron' need vertices")
            bodies.append(polyhedron(vertices, rounding))
        else:
            bodies.append(None)
    return Glyphs(bodies, place, sizes, turns)


def ellipsoids(semi_axes: Floats, orientations: Floats | None = None) -> Glyphs:
    """N ellipsoids; those whose three semi-axes are 0 are spheres, as in OVITO and LAMMPS."""
    shapes = np.where((semi_axes == 0).all(axis=1), "sphere", "ellipsoid")
    return named(len(semi_axes), shapes, semi_axes, orientations)


def _rows(values: ArrayLike, count: int, width: int) -> NDArray[np.float64]:
    """(N, width) of as many, or of one for all."""
    array = np.asarray(values, np.float64)
    if array.shape not in ((count, width), (width,)):
        raise SceneError(f"numbers of shape ({count}, {width}) are needed, not {array.shape}")
    rows: NDArray[np.float64] = np.array(np.broadcast_to(array, (count, width)))
    return rows


def drawn(
    glyphs: Glyphs, positions: Floats, colors: Floats, chosen: NDArray[np.bool_]
) -> list[Instances]:
    """The chosen particles that are no spheres, as instances of their bodies."""
    order = np.argsort(glyphs.codes, kind="stable")
    order = order[(chosen & ~glyphs.spheres())[order]]
    starts = np.flatnonzero(np.diff(glyphs.codes[order], prepend=-1))
    made = []
    for mine in np.split(order, starts[1:]) if len(order) else ():
        body = glyphs.bodies[int(glyphs.codes[mine[0]])]
        assert body is not None
        matrices = _transforms(glyphs, positions, mine)
        made.append(Instances(body, matrices, "particles", colors[mine]))
    return made


def _transforms(glyphs: Glyphs, positions: Floats, chosen: Any) -> NDArray[np.float64]:
    matrices = np.zeros((len(chosen), 3, 4))
    matrices[:, :, :3] = np.eye(3)
    if glyphs.orientations is not None:
        matrices[:, :, :3] = rotations(glyphs.orientations[chosen])
    if glyphs.sizes is not None:
        matrices[:, :, :3] *= glyphs.sizes[chosen][:, None, :]
    matrices[:, :, 3] = positions[chosen]
    return matrices


def rotations(quaternions: Floats) -> NDArray[np.float64]:
    """(N, 3, 3) matrices of (N, 4) quaternions w, x, y, z of any length but 0."""
    q = quaternions.astype(np.float64)
    q /= np.abs(q).max(axis=1, keepdims=True)  # so that squares neither vanish nor overflow
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrices: NDArray[np.float64] = np.array(rows).transpose(2, 0, 1)
    return matrices


# ---------------------------------------------------------------------------------------------
# Bodies


def ball() -> Body:
    """The unit sphere."""
    return (Spheres(np.zeros((1, 3)), 1.0, _MATERIAL),)


def cube() -> Body:
    """From -1 to 1 along each axis."""
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    return polyhedron(corners)


def cylinder() -> Body:
    """Of radius 1, from -1 to 1 along z, closed."""
    ends = np.array([[0.0, 0, -1], [0, 0, 1]])
    x, y = np.array([[1.0, 0, 0], [1, 0, 0]]), np.array([[0.0, -1, 0], [0, 1, 0]])
    return Cylinders(ends[:1], ends[1:], 1.0, None, _MATERIAL), Disks(ends, x, y, _MATERIAL)


def capsule(half_length: float) -> Body:
    """A spherocylinder of radius 1 along z; the half length counts its round ends."""
    ends = np.array([[0.0, 0, 1 - half_length], [0, 0, half_length - 1]])
    if half_length == 1.0:
        return ball()
    return Cylinders(ends[:1], ends[1:], 1.0, None, _MATERIAL), Spheres(ends, 1.0, _MATERIAL)


def union(centers: ArrayLike, radii: ArrayLike) -> Body:
    """Spheres, (M, 3) and (M,), that may overlap. Raises SceneError."""
    places, sizes = _points(centers), np.asarray(radii, np.float64)
    if sizes.shape != (len(places),) or not ((sizes > SMALLEST) & (sizes <= FARTHEST)).all():
        raise SceneError(f"{len(places)} spheres need as many radii, which are positive")
    return (Spheres(places, sizes, _MATERIAL),)


def faceted(vertices: ArrayLike, faces: Sequence[Sequence[int]]) -> Body:
    """A mesh of flat, convex faces, each a list of three or more of the (M, 3) vertices.

    Raises SceneError.
    """
    points = _points(vertices)
    triangles = []
    for face in faces:
        if len(face) < 3 or not all(
            isinstance(i, (int, np.integer)) and 0 <= i < len(points) for i in face
        ):
            raise SceneError(
                f"face {list(face)[:10]} is not three or more of vertices 0 to {len(points) - 1}"
            )
        triangles += [(face[0], b, c) for b, c in pairwise(face[1:])]
    if not triangles:
        raise SceneError("a mesh has no faces")
    return (Mesh(points, np.array(triangles), material=_MATERIAL),)


def polyhedron(vertices: ArrayLike, rounding: float = 0.0) -> Body:
    """The convex hull of (M, 3) vertices, and what is within `rounding` of it: its faces moved
    outwards, tubes along its edges and spheres at its corners.

    Two vertices make a spherocylinder, those of a plane a plate. Raises SceneError for what has no
    surface.
    """
    points = _points(vertices)
    if len(points) > _MOST_VERTICES:
        raise SceneError(f"a polyhedron has {len(points)} vertices; {_MOST_VERTICES} are the most")
    radius = _rounding(rounding)
    faces, edges, corners = hull(points)
    if not radius:
        if not len(faces):
            raise SceneError("the vertices of a polyhedron lie in a line")
        return (Mesh(points, faces, material=_MATERIAL),)
    shapes: list[Solid] = []
    if len(faces):
        sides = points[faces]
        normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        moved = (sides + radius * normals[:, None]).reshape(-1, 3)
        shapes.append(Mesh(moved, np.arange(len(moved)).reshape(-1, 3), material=_MATERIAL))
    if len(edges):
        ends = points[edges]
        shapes.append(Cylinders(ends[:, 0], ends[:, 1], radius, None, _MATERIAL))
    return (*shapes, Spheres(points[corners], radius, _MATERIAL))


def polygon(vertices: ArrayLike, rounding: float = 0.0) -> Body:
    """A simple polygon of (M, 2) corners in order, flat in the xy plane, and what of the plane is
    within `rounding` of it. Raises SceneError.
    """
    flat = np.asarray(vertices, np.float64)
    if flat.ndim != 2 or flat.shape[1] != 2:
        raise SceneError(f"corners of a polygon have shape {flat.shape}, not (M, 2)")
    points = _points(np.pad(flat, ((0, 0), (0, 1))))
    radius = _rounding(rounding)
    shapes: list[Solid] = []
    if len(points) >= 3:
        shapes.append(Mesh(points, _triangles(flat), material=_MATERIAL))
    elif not radius:
        raise SceneError(f"a polygon has {len(points)} corners, and no area")
    if radius:
        ends = np.roll(points, -1, axis=0)
        along = ends - points
        lengths = np.linalg.norm(along, axis=1, keepdims=True)
        kept = lengths[:, 0] > 0
        aside = np.cross([0.0, 0, 1], along[kept] / lengths[kept]) * radius
        quads = np.stack(
            [points[kept] - aside, ends[kept] - aside, ends[kept] + aside, points[kept] + aside], 1
        ).reshape(-1, 3)
        first = 4 * np.arange(len(quads) // 4)[:, None]
        halves = np.concatenate([first + np.array(half) for half in ((0, 1, 2), (0, 2, 3))])
        shapes.append(Mesh(quads, halves, material=_MATERIAL))
        x, y = (np.tile(radius * axis, (len(points), 1)) for axis in np.eye(3)[:2])
        shapes.append(Disks(points, x, y, _MATERIAL))
    return tuple(shapes)


def _points(values: ArrayLike) -> NDArray[np.float64]:
    try:
        points = np.asarray(values, np.float64)
    except (OverflowError, TypeError, ValueError):
        raise SceneError("vertices are not (M, 3) numbers") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise SceneError(f"vertices have shape {points.shape}, not (M, 3)")
    if not (np.abs(points) <= FARTHEST).all():
        raise SceneError("a vertex is not finite, or beyond 1e30")
    return points


def _rounding(radius: float) -> float:
    if not (isinstance(radius, (int, float)) and 0 <= radius <= FARTHEST):
        raise SceneError(f"rounding radius {radius!r} is not a number from 0")
    return float(radius)


# ---------------------------------------------------------------------------------------------
# Geometry


def hull(points: NDArray[np.float64]) -> tuple[Any, Any, Any]:
    """The convex hull of (M, 3) points: triangles, (F, 3), counter-clockwise seen from outside,
    edges between faces that differ in direction, (E, 2), and corners, (C,), all as indices.

    Of points in a plane the triangles are there twice, once for each side; those in a line have no
    triangles and one edge; a single place has a corner alone.
    """
    # a frame of the points' own, so that what is flat or in a line is told by the axes
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    size = float(np.abs(points - middle).max())
    _, first = np.unique(points, axis=0, return_index=True)
    # those far out come first, so that few are corners only for a time
    first = first[np.argsort(-np.abs(points[first] - middle).max(axis=1), kind="stable")]
    if size == 0.0 or len(first) == 1:
        return np.empty((0, 3), int), np.empty((0, 2), int), first[:1]
    own = (points[first] - middle) / size
    a = 0
    b = int(np.argmax(np.linalg.norm(own - own[a], axis=1)))
    line = (own[b] - own[a]) / np.linalg.norm(own[b] - own[a])
    off = own - own[a]
    off -= np.outer(off @ line, line)
    c = int(np.argmax(np.linalg.norm(off, axis=1)))
    if np.linalg.norm(off[c]) < _SAME:
        ends = first[[int(np.argmin(own @ line)), int(np.argmax(own @ line))]]
        return np.empty((0, 3), int), ends[None], ends
    normal = np.cross(line, off[c] / np.linalg.norm(off[c]))
    heights = (own - own[a]) @ normal
    d = int(np.argmax(np.abs(heights)))
    if abs(heights[d]) < _SAME:
        ring = _ring(np.stack([own @ line, own @ np.cross(normal, line)], axis=1))
        fan = np.array([(ring[0], i, j) for i, j in pairwise(ring[1:])])
        edges = np.stack([ring, np.roll(ring, -1)], axis=1)
        return first[np.concatenate([fan, fan[:, ::-1]])], first[edges], first[ring]
    if heights[d] > 0:
        b, c = c, b
    return _solid(own, [(a, b, c), (a, d, b), (b, d, c), (c, d, a)], {a, b, c, d}, first)


def _solid(
    own: NDArray[np.float64],
    start: list[tuple[int, int, int]],
    used: set[int],
    first: NDArray[np.intp],
) -> tuple[Any, Any, Any]:
    """The hull of points around a first tetrahedron, one point after the other: the faces that it
    sees give way to a cone from it over their outline (M. Kallay, Inf. Process. Lett. 19 (1984)).
    """
    faces = np.array(start)
    planes = _planes(own, faces)
    for point in range(len(own)):
        if point in used:
            continue
        seen = planes[:, :3] @ own[point] - planes[:, 3] > 1e-10
        if not seen.any():
            continue
        sides = faces[seen][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).tolist()
        inner = {(i, j) for i, j in sides}
        outline = np.array([(i, j) for i, j in sides if (j, i) not in inner])
        cone = np.column_stack([outline, np.full(len(outline), point)])
        faces = np.concatenate([faces[~seen], cone])
        planes = np.concatenate([planes[~seen], _planes(own, cone)])
    good = planes[:, :3].any(axis=1)  # not those that are but a line
    faces, planes = faces[good], planes[good]
    sides = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    owners = {(i, j): f // 3 for f, (i, j) in enumerate(sides.tolist())}
    edges = []
    for (i, j), face in owners.items():
        other = owners.get((j, i))
        if other is None or (i < j and planes[face, :3] @ planes[other, :3] < 1 - _SAME**2):
            edges.append((i, j))
    corners = np.unique(faces)
    return first[faces], first[np.array(edges)], first[corners]


def _planes(own: NDArray[np.float64], faces: NDArray[np.intp]) -> NDArray[np.float64]:
    """(F, 4) unit normals and distances from 0; those of a face without area are 0."""
    a, b, c = (own[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(sizes > 1e-14, normals / np.where(sizes > 0, sizes, 1.0), 0.0)
    return np.column_stack([normals, np.sum(normals * a, axis=1)])


def _ring(flat: NDArray[np.float64]) -> NDArray[np.intp]:
    """The corners of the convex hull of (M, 2) points, counter-clockwise (A. Andrew, 1979)."""

    def chain(order: NDArray[np.intp]) -> list[int]:
        kept: list[int] = []
        for i in order.tolist():
            while len(kept) > 1 and _turn(flat[kept[-2]], flat[kept[-1]], flat[i]) <= 1e-12:
                kept.pop()
            kept.append(i)
        return kept[:-1]

    order = np.lexsort((flat[:, 1], flat[:, 0]))
    return np.array(chain(order) + chain(order[::-1]))


def _turn(a: Any, b: Any, c: Any) -> Any:
    """Twice the area of a triangle, positive if counter-clockwise."""
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )


def _triangles(flat: NDArray[np.float64]) -> NDArray[np.intp]:
    """Triangles of a simple polygon of (M, 2) corners, M >= 3, by cutting off its ears."""
    if len(flat) > _MOST_CORNERS:
        raise SceneError(f"a polygon has {len(flat)} corners; {_MOST_CORNERS} are the most")
    left = np.arange(len(flat))
    if np.sum(_turn(np.zeros(2), flat, np.roll(flat, -1, axis=0))) < 0:
        left = left[::-1]
    found = []
    while len(left) > 3:
        before, after = flat[np.roll(left, 1)], flat[np.roll(left, -1)]
        here = flat[left]
        areas = _turn(before, here, after)
        for k in np.flatnonzero(areas >= 0).tolist():
            inside = np.ones(len(left), bool)
            corners = (before[k], here[k], after[k])
            for i in range(3):
                inside &= _turn(corners[i], corners[(i + 1) % 3], here) >= 0
            inside[[k - 1, k, (k + 1) % len(left)]] = False
            if areas[k] == 0 or not inside.any():
                break
        else:
            raise SceneError("a polygon's sides cross each other")
        found.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        left = np.delete(left, k)
    return np.array([*found, tuple(left)])
