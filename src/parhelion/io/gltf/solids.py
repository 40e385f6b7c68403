"""Spheres, disks and cylinders as meshes: one of unit size, and a matrix for each."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene import Cylinders, Disks, Mesh, Spheres

Matrices = NDArray[np.float64]

# Sides of a circle: the middle of a side lies 1 - cos(pi / 64), 0.12 % of the radius, within it.
SIDES = 64
MOST_SIDES = 1024


def sides(radii: Any, usual: float) -> NDArray[np.int64]:
    """Into how many sides circles are divided: those of large spheres deviate as little as those of
    the usual radius do, as far as that is possible.
    """
    larger = np.maximum(np.asarray(radii, np.float64) / usual, 1.0)
    wanted = SIDES * 2.0 ** np.ceil(0.5 * np.log2(larger))  # the deviation goes by its square
    return np.asarray(np.minimum(wanted, MOST_SIDES), np.int64)


def _grid(columns: int, rows: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Coordinates u and v in [0, 1], and faces that turn counter-clockwise in their plane."""
    u, v = np.meshgrid(np.arange(columns + 1) / columns, np.arange(rows + 1) / rows)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    above = corner + columns + 1
    faces = np.stack([corner, corner + 1, above + 1, corner, above + 1, above], axis=1)
    return u.ravel(), v.ravel(), faces.reshape(-1, 3)


def _mesh(points: Any, normals: Any, u: Any, v: Any, faces: Any) -> Mesh:
    corners = points[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    faces = faces[np.linalg.norm(area, axis=1) > 1e-12]  # none at a pole
    uvs = np.stack([u, v], axis=1)
    return Mesh(np.float32(points), np.uint32(faces), np.float32(normals), np.float32(uvs))


@cache
def sphere(count: int) -> Mesh:
    """Of radius 1; the texture coordinates are those of Spheres."""
    u, v, faces = _grid(count, count // 2)
    around, up = 2 * np.pi * u, np.pi * (v - 0.5)
    level = np.where((v == 0) | (v == 1), 0.0, np.cos(up))
    points = np.stack([np.cos(around) * level, np.sin(around) * level, np.sin(up)], axis=1)
    return _mesh(points, points, u, v, faces)


@cache
def disk() -> Mesh:
    """Of radius 1 in the xy plane, its front towards z."""
    v, u, faces = _grid(SIDES, 1)
    around = 2 * np.pi * v
    points = np.stack([u * np.cos(around), u * np.sin(around), np.zeros_like(u)], axis=1)
    return _mesh(points, np.tile([0.0, 0.0, 1.0], (len(u), 1)), u, v, faces[:, ::-1])


@cache
def cylinder() -> Mesh:
    """Of radius 1 around z from 0 to 1."""
    u, v, faces = _grid(SIDES, 1)
    around = 2 * np.pi * u
    normals = np.stack([np.cos(around), np.sin(around), np.zeros_like(u)], axis=1)
    points = normals + v[:, None] * [0.0, 0.0, 1.0]
    return _mesh(points, normals, u, v, faces)


def matrices(shape: Spheres | Disks | Cylinders) -> Matrices:
    """(N, 4, 4): from the unit mesh to each."""
    if isinstance(shape, Spheres):
        centers = np.asarray(shape.centers, np.float64).reshape(-1, 3)
        radii = np.broadcast_to(np.asarray(shape.radii, np.float64), len(centers))
        turn = np.eye(3) if shape.rotation is None else np.asarray(shape.rotation, np.float64)
        return _placed(turn * radii[:, None, None], centers)
    if isinstance(shape, Disks):
        u, v = (np.asarray(a, np.float64).reshape(-1, 3) for a in (shape.axis_u, shape.axis_v))
        normal = np.cross(u, v)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return _placed(np.stack([u, v, normal], axis=2), shape.centers)
    starts, ends = (np.asarray(a, np.float64).reshape(-1, 3) for a in (shape.starts, shape.ends))
    axis = ends - starts
    along = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    if shape.axis_u is None:
        given = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    else:
        given = np.asarray(shape.axis_u, np.float64).reshape(-1, 3)
    side = given - along * (given * along).sum(axis=1)[:, None]
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    radii = np.broadcast_to(np.asarray(shape.radii, np.float64), len(starts))[:, None]
    columns = [side * radii, np.cross(along, side) * radii, axis]
    return _placed(np.stack(columns, axis=2), starts)


def _placed(linear: Any, positions: Any) -> Matrices:
    made = np.zeros((len(linear), 4, 4))
    made[:, :3, :3] = linear
    made[:, :3, 3] = np.asarray(positions, np.float64).reshape(-1, 3)
    made[:, 3, 3] = 1.0
    return made
