"""Placing a camera so that shapes fill the picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import isfinite, radians, sqrt, tan
from typing import TYPE_CHECKING, Any

import numpy as np

from . import arguments
from .errors import SceneError
from .scene import (
    Camera,
    Curves,
    Cylinders,
    Disks,
    Framing,
    Mesh,
    Scene,
    Shape,
    Spheres,
    Vec3,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.floating[Any]]

# Directions to the corners, edges and faces of a cube, as far as makes a polyhedron around the unit
# sphere of them; its corners are 13 % farther out.
_AROUND = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
_AROUND *= 1.1281 / np.linalg.norm(_AROUND, axis=1, keepdims=True)
# Points of copies of shapes that are looked at one by one; of so many, those at the rim are few.
_MOST_POINTS = 1_000_000


def placed(scene: Scene, aspect: float) -> Camera:
    """The scene's camera; where it has a Framing, or none, one that frames its shapes.

    aspect: width over height of the picture. Raises SceneError for a framing without meaning.
    """
    if isinstance(scene.camera, Camera):
        return scene.camera
    framing = Framing() if scene.camera is None else scene.camera
    if not isinstance(framing, Framing):
        raise SceneError(f"camera: a Camera or a Framing is needed, not {framing!r}")
    for name in ("vfov", "fill"):
        arguments.number(f"camera: {name}", getattr(framing, name))
    if not 0 < framing.vfov < 180:
        raise SceneError(f"camera: vfov is {framing.vfov}; must lie between 0 and 180 degrees")
    if not 0 < framing.fill <= 1:
        raise SceneError(f"camera: fill is {framing.fill}; must lie in (0, 1]")
    if isinstance(framing.shapes, str) or not isinstance(framing.shapes, Sequence):
        raise SceneError(
            "camera: shapes: a list of names or shapes is needed, not"
            f" {type(framing.shapes).__name__}"
        )
    right, up, towards = _axes(framing)
    low, high = bounds(scene)
    if not np.all(np.isfinite(high - low)):  # nothing to see, or an error that the core will name
        return Camera()
    middle = 0.5 * low + 0.5 * high
    half = tan(radians(0.5 * framing.vfov)) * framing.fill
    nearness, offsets = 0.0, []
    for axis, slope in ((right, half * aspect), (up, half)):
        # With the eye at distance d and offset o, a sphere at u along the axis and w towards the
        # camera is between the two planes of slope s if |u - o| + r sqrt(1 + s^2) <= s (d - w).
        plus = minus = -np.inf
        for centers, radii in subject(scene):
            u = centers @ axis - middle @ axis
            most = slope * (centers @ towards - middle @ towards) + radii * sqrt(1 + slope**2)
            plus, minus = max(plus, float(np.max(most + u))), max(minus, float(np.max(most - u)))
        nearness = max(nearness, (plus + minus) / (2 * slope))
        offsets.append((plus - minus) / 2)
    if not nearness > 0.0:  # a single point, say
        nearness = 1.0
    # At a larger distance than this axis needs, its offset leaves equal room on both sides.
    target = middle + offsets[0] * right + offsets[1] * up
    eye = target + nearness * towards
    return Camera(_tuple(eye), _tuple(target), _tuple(up), vfov=framing.vfov)


def subject(scene: Scene) -> Iterator[tuple[Array, Array]]:
    """Centres (N, 3) and radii, (N,) or one, that hold the shapes that the scene is about."""
    about = scene.camera.shapes if isinstance(scene.camera, Framing) else ()
    names = [shape for shape in about if isinstance(shape, str)]
    shown = [shape for shape in scene.shapes if not about or shape.name in names]
    for shape in (*shown, *(shape for shape in about if not isinstance(shape, str))):
        for centers, radii in hull(shape):
            if centers.size:
                yield centers, radii


def hull(shape: Shape) -> Iterator[tuple[Array, Array]]:
    """Spheres that hold a shape: centres (N, 3) and radii, (N,) or one."""
    # unsigned integers would wrap around below 0
    if isinstance(shape, Spheres):
        # in parts, as what is computed of them takes several times their memory
        centers, radii = np.asarray(shape.centers), np.asarray(shape.radii)
        for i in range(0, max(len(centers), 1), _MOST_POINTS):
            part = radii[i : i + _MOST_POINTS] if radii.ndim else radii
            yield centers[i : i + _MOST_POINTS], np.asarray(part, dtype=np.float64)
    elif isinstance(shape, Mesh):
        yield np.asarray(shape.vertices, dtype=np.float64), np.float64(0.0)
    elif isinstance(shape, Disks):
        u, v = (np.asarray(a, dtype=np.float64) for a in (shape.axis_u, shape.axis_v))
        size = np.maximum(np.linalg.norm(u, axis=-1), np.linalg.norm(v, axis=-1))
        yield np.asarray(shape.centers, dtype=np.float64), size
    elif isinstance(shape, Cylinders):
        for ends in (shape.starts, shape.ends):
            yield np.asarray(ends, dtype=np.float64), np.asarray(shape.radii, dtype=np.float64)
    elif isinstance(shape, Curves):
        yield np.asarray(shape.points, dtype=np.float64), np.asarray(shape.radii, np.float64)
    else:
        matrices = np.asarray(shape.transforms, dtype=np.float64)[:, :3]
        parts = [piece for part in shape.shapes for piece in hull(part) if piece[0].size]
        even = bool(is_even(matrices).all())
        points = sum(len(c) * (1 if even or not np.any(r) else len(_AROUND)) for c, r in parts)
        if points * len(matrices) > _MOST_POINTS:
            parts = [_corners(parts)]
        for centers, radii in parts:
            yield _copies(centers, radii, matrices, even)


def is_even(matrices: Array) -> NDArray[np.bool_]:
    """(M,): which (M, 3, 4) matrices turn and scale by the same in all directions, so that spheres
    stay spheres.
    """
    turns = matrices[:, :, :3]
    squares = np.sum(turns[:, :, 0] ** 2, axis=1)[:, None, None]
    off = turns.transpose(0, 2, 1) @ turns - squares * np.eye(3)
    return np.asarray((np.abs(off) <= 1e-6 * squares).all(axis=(1, 2)))


def _corners(parts: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """The corners of the box that holds spheres."""
    low = np.min([np.min(c - r[..., None], axis=0) for c, r in parts], axis=0)
    high = np.max([np.max(c + r[..., None], axis=0) for c, r in parts], axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return corners, np.float64(0.0)


def _copies(centers: Array, radii: Array, matrices: Array, even: bool) -> tuple[Array, Array]:
    """Spheres that hold copies of spheres, by (M, 3, 4) matrices.

    Where these are not even, spheres become ellipsoids, held by the corners of polyhedra.
    """
    if not even and np.any(radii):
        sizes = np.broadcast_to(radii, len(centers))[:, None, None]
        centers = (centers[:, None] + sizes * _AROUND).reshape(-1, 3)
        radii = np.float64(0.0)
    placed_centers = centers @ matrices[:, :, :3].transpose(0, 2, 1) + matrices[:, None, :, 3]
    scales = np.linalg.norm(matrices[:, :, 0], axis=1)
    sizes = np.broadcast_to(radii * scales[:, None], placed_centers.shape[:2])
    return placed_centers.reshape(-1, 3), sizes.reshape(-1)


def bounds(scene: Scene) -> tuple[Array, Array]:
    """Lower and upper corner, (3,) float64 each, of the box that holds what the scene is about."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for centers, radii in subject(scene):
        for k, along in enumerate(centers.T):  # faster than rows of three
            low[k] = np.minimum(low[k], np.min(along - radii))
            high[k] = np.maximum(high[k], np.max(along + radii))
    return low, high


def reach(scene: Scene) -> tuple[Array, float]:
    """The middle of the box that holds what the scene is about, (3,), and how far that reaches."""
    low, high = bounds(scene)
    if not np.all(np.isfinite(high - low)):  # nothing to see
        return np.zeros(3), 0.0
    middle = 0.5 * low + 0.5 * high
    radius = 0.0
    for centers, radii in subject(scene):
        squares = np.zeros(len(centers))
        for along, center in zip(centers.T, middle, strict=True):  # faster than rows of three
            squares += (along - center) ** 2
        away = np.sqrt(squares) + radii if np.any(radii) else np.sqrt(np.max(squares))
        radius = max(radius, float(np.max(away)))
    return middle, radius


def _axes(framing: Framing) -> tuple[Array, Array, Array]:
    """Unit vectors to the right and up in the picture, and towards the camera."""
    towards = np.array(arguments.point("camera: direction", framing.direction))
    up = np.array(arguments.point("camera: up", framing.up))
    right = np.cross(up, towards)
    size = float(np.linalg.norm(right))
    if not isfinite(size) or size == 0:
        raise SceneError("camera: direction and up must be finite, not 0 and not parallel")
    right, towards = right / size, towards / np.linalg.norm(towards)
    return right, np.cross(towards, right), towards


def _tuple(vector: Array) -> Vec3:
    x, y, z = vector.tolist()
    return x, y, z
