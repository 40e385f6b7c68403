"""Sphere, Cube, Cylinder, Cone, Capsule and Plane prims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom

from ...scene import Spheres
from . import materials, primvars
from .meshes import Polygons, add

if TYPE_CHECKING:
    from .reader import Group, Matrix, Reader

Floats = NDArray[np.float64]

# Sides of round solids, and rings of a half sphere
_SIDES = 128
_RINGS = 32

# Lengths and angles of a matrix's axes that differ by less, relatively, count as equal
_ROUNDING = 1e-5

_SIZES = {"constant": 1, "uniform": 1, "vertex": 1, "varying": 1, "faceVarying": 1}


def similarity(matrix: Matrix) -> float | None:
    """The scale of a matrix that keeps angles; None for others."""
    size = np.linalg.norm(matrix[:3, :3], axis=0)
    if not size.min() > 0.0 or np.ptp(size) > _ROUNDING * size.max():
        return None
    axes = matrix[:3, :3] / size
    if np.abs(axes.T @ axes - np.eye(3)).max() > _ROUNDING:
        return None
    return float(size.mean())


def _sphere(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    radius = _size(r, prim, UsdGeom.Sphere(prim).GetRadiusAttr())
    made = materials.plain(r, prim)
    add_sphere(group, matrix, radius, made.material, made.colors, str(prim.GetPath()))


def add_sphere(
    group: Group, matrix: Matrix, radius: float, material: Any, colors: Any, name: str
) -> None:
    """A sphere around the origin; an ellipsoid is a copy of a sphere."""
    from .reader import Group

    scale = similarity(matrix)
    if scale is not None:
        center = matrix[None, :3, 3]
        group.shapes.append(Spheres(center, radius * scale, material, colors, name))
        return
    unit = Spheres(np.zeros((1, 3)), radius, material, colors, name)
    group.copies.append((Group(name, [unit]), matrix[None]))


def _size(r: Reader, prim: Any, attribute: Any) -> float:
    value = r.number(prim, attribute)
    if not value > 0.0:
        raise r.error(prim, f"{attribute.GetName()} is {value:g}; must be above 0")
    return value


def _add(
    r: Reader,
    prim: Any,
    matrix: Matrix,
    group: Group,
    points: Floats,
    faces: Sequence[Any] | NDArray[np.int64],
    normals: Floats | None = None,
) -> None:
    counts = np.array([len(face) for face in faces])
    corners = np.concatenate([np.array(face) for face in faces])
    double = bool(r.get(UsdGeom.Gprim(prim).GetDoubleSidedAttr(), False))
    look = materials.look(r, prim, double)
    vertex = {}
    for name, need in look.needs.items():
        found = primvars.read(r, prim, name, _SIZES, need.width)
        value = np.array([need.fallback]) if found is None else found.values
        vertex[name] = np.repeat(value, len(points), axis=0)
    at_corners = None if normals is None else normals[corners]
    p = Polygons(points, counts, corners, vertex, {}, at_corners, np.zeros(len(counts), np.int64))
    add(group, matrix, p, [(str(prim.GetPath()), look)])


def _cube(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    half = 0.5 * _size(r, prim, UsdGeom.Cube(prim).GetSizeAttr())
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    _add(r, prim, matrix, group, half * corners, sides)


def _plane(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    plane = UsdGeom.Plane(prim)
    x, y = (0.5 * _size(r, prim, a) for a in (plane.GetWidthAttr(), plane.GetLengthAttr()))
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    axis = plane.GetAxisAttr().Get()
    if axis == "X":  # width along z, length along y
        corners = corners[:, [2, 1, 0]] * (1.0, 1.0, -1.0)
    elif axis == "Y":  # width along x, length along z
        corners = corners[:, [0, 2, 1]] * (1.0, 1.0, -1.0)
    _add(r, prim, matrix, group, corners, [(0, 1, 2, 3)])


# --- Solids of revolution ------------------------------------------------------------------------


def _revolved(
    r: Reader, prim: Any, matrix: Matrix, group: Group, pieces: list[tuple[Floats, Floats]]
) -> None:
    """What turning pieces of a profile around the axis makes.

    pieces: (K, 2) distances from the axis and heights, from the top down, and the (K, 2) normals.
    """
    turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    cos, sin = np.cos(turn), np.sin(turn)

    def around(profile: Floats) -> Floats:
        flat = np.stack([np.outer(profile[:, 0], cos), np.outer(profile[:, 0], sin)], axis=2)
        height = np.broadcast_to(profile[:, 1, None, None], (len(profile), _SIDES, 1))
        return np.concatenate([flat, height], axis=2).reshape(-1, 3)

    side = np.arange(_SIDES)
    points, normals, faces = [], [], []
    count = 0
    for profile, across in pieces:
        points.append(around(profile))
        normals.append(around(across))
        ring = count + _SIDES * np.arange(len(profile) - 1)[:, None]
        a, b = ring + side, ring + (side + 1) % _SIDES
        faces.append(np.stack([a, a + _SIDES, b + _SIDES, b], axis=2).reshape(-1, 4))
        count += len(points[-1])
    axis = str(prim.GetAttribute("axis").Get(r.time) or "Z")
    # even permutations, so that the solid is not mirrored
    order = {"X": [2, 0, 1], "Y": [1, 2, 0]}.get(axis, [0, 1, 2])
    _add(
        r,
        prim,
        matrix,
        group,
        np.concatenate(points)[:, order],
        np.concatenate(faces),
        np.concatenate(normals)[:, order],
    )


def _disk(radius: float, height: float, up: float) -> tuple[Floats, Floats]:
    profile = np.array([[0.0, height], [radius, height]])[:: int(up)]
    return profile, np.array([[0.0, up], [0.0, up]])


def _wall(top: float, bottom: float, height: float) -> tuple[Floats, Floats]:
    """A cone's or a cylinder's, from its radii at the top and at the bottom."""
    profile = np.array([[top, 0.5 * height], [bottom, -0.5 * height]])
    across = np.array([height, bottom - top]) / np.hypot(height, bottom - top)
    return profile, np.stack([across, across])


def _dome(radius: float, height: float, up: float) -> tuple[Floats, Floats]:
    angle = 0.5 * np.pi * np.arange(_RINGS + 1) / _RINGS
    across = np.stack([np.sin(angle), up * np.cos(angle)], axis=1)[:: int(up)]
    return radius * across + (0.0, height), across


def _radii(r: Reader, prim: Any) -> tuple[float, float]:
    """At the top and at the bottom."""
    if prim.GetAttribute("radius").IsDefined():
        radius = _size(r, prim, prim.GetAttribute("radius"))
        return radius, radius
    return (
        _size(r, prim, prim.GetAttribute("radiusTop")),
        _size(r, prim, prim.GetAttribute("radiusBottom")),
    )


def _cylinder(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    top, bottom = _radii(r, prim)
    height = _size(r, prim, prim.GetAttribute("height"))
    caps = _disk(top, 0.5 * height, 1.0), _disk(bottom, -0.5 * height, -1.0)
    _revolved(r, prim, matrix, group, [caps[0], _wall(top, bottom, height), caps[1]])


def _cone(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    radius = _size(r, prim, prim.GetAttribute("radius"))
    height = _size(r, prim, prim.GetAttribute("height"))
    pieces = [_wall(0.0, radius, height), _disk(radius, -0.5 * height, -1.0)]
    _revolved(r, prim, matrix, group, pieces)


def _capsule(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    top, bottom = _radii(r, prim)
    height = _size(r, prim, prim.GetAttribute("height"))
    domes = _dome(top, 0.5 * height, 1.0), _dome(bottom, -0.5 * height, -1.0)
    _revolved(r, prim, matrix, group, [domes[0], _wall(top, bottom, height), domes[1]])


SHAPES: dict[str, Callable[[Reader, Any, Matrix, Group], None]] = {
    "Sphere": _sphere,
    "Cube": _cube,
    "Plane": _plane,
    "Cylinder": _cylinder,
    "Cylinder_1": _cylinder,
    "Cone": _cone,
    "Capsule": _capsule,
    "Capsule_1": _capsule,
}
