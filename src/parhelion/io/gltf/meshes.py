"""Primitives of meshes as arrays: corners, morph targets, skins, and where they are placed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import accessors, draco, schema
from .source import Source

Floats = NDArray[np.float32]
Integers = NDArray[np.int64]

POINTS, LINES, TRIANGLES = "points", "lines", "triangles"
# glTF's modes: what their corners are
_MODES = {
    0: POINTS, 1: LINES, 2: "line loop", 3: "line strip",
    4: TRIANGLES, 5: "triangle strip", 6: "triangle fan",
}  # fmt: skip
_CORNERS = {POINTS: 1, LINES: 2, TRIANGLES: 3}

# Attributes: how many numbers they may have
_ATTRIBUTES = {
    "POSITION": (3,), "NORMAL": (3,), "TEXCOORD": (2,), "COLOR": (3, 4), "JOINTS": (4,),
    "WEIGHTS": (4,), "TANGENT": (4,),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Geometry:
    """One primitive, in the mesh's own frame.

    positions: (V, 3). corners: (N, 1 to 3) vertices of each point, line or triangle, by `kind`.
    normals: (V, 3) or None; tangents: (V, 4) or None, of what has normals. uvs: (V, 2) each, by
    the number of the set; v runs down. colors: (V, 3) or (V, 4) or None. joints, weights:
    (V, 4 k) of a skin.
    """

    where: str
    kind: str
    positions: Floats
    corners: Integers
    normals: Floats | None = None
    tangents: Floats | None = None
    uvs: dict[int, Floats] = field(default_factory=dict)
    colors: Floats | None = None
    joints: Integers | None = None
    weights: Floats | None = None
    material: int | None = None


def read(
    s: Source, index: int, weights: Sequence[float] | None, variant: int | None
) -> list[Geometry]:
    """The primitives of a mesh. weights: of morph targets, None for the mesh's own."""
    mesh = s.document.meshes[index]
    used = mesh.weights if weights is None else list(weights)
    made = []
    for k, primitive in enumerate(mesh.primitives):
        where = f"meshes[{index}].primitives[{k}]"
        if "POSITION" not in primitive.attributes:
            s.report(f"{where}: has no POSITION; left out")
            continue
        geometry = _read(s, primitive, used, where)
        made.append(replace(geometry, material=_material(s, primitive, variant, where)))
    return made


def _material(
    s: Source, primitive: schema.Primitive, variant: int | None, where: str
) -> int | None:
    index = primitive.material
    if variant is not None:
        found = s.extension(primitive, "KHR_materials_variants", schema.Mappings, where)
        for mapping in found.mappings if found else ():
            if variant in mapping.variants:
                index = mapping.material
    if index is not None:
        s.item(s.document.materials, "materials", index, f"{where}.material")
    return index


def _read(s: Source, primitive: schema.Primitive, weights: Sequence[float], where: str) -> Geometry:
    packed = s.extension(primitive, "KHR_draco_mesh_compression", schema.Draco, where)
    unpacked = draco.decode(s, packed, where) if packed is not None else None
    count = accessors.count(s, primitive.attributes["POSITION"], f"{where}.attributes.POSITION")
    if unpacked is not None and "POSITION" in unpacked.attributes:
        count = len(unpacked.attributes["POSITION"])
    arrays: dict[str, Any] = {}
    for name, accessor in primitive.attributes.items():
        kind, _, number = name.partition("_")
        if kind not in _ATTRIBUTES or not re.fullmatch("|[0-9]{1,3}", number):
            continue  # what applications add
        place, widths = f"{where}.attributes.{name}", _ATTRIBUTES[kind]
        if unpacked is not None and name in unpacked.attributes:
            values = unpacked.attributes[name]
            if len(values) != count or values.shape[1] not in widths:
                raise s.error(f"{place}: is of shape {values.shape} in the compressed data")
            if kind != "JOINTS":
                normalized = s.item(s.document.accessors, "accessors", accessor, place).normalized
                values = accessors.finite(s, accessors.scaled(values, normalized), place)
        else:
            if accessors.count(s, accessor, place) != count:
                raise s.error(f"{place}: has another number of elements than POSITION, {count}")
            take = accessors.integers if kind == "JOINTS" else accessors.floats
            values = take(s, accessor, place, widths)
        arrays[name] = values
    _morph(s, primitive, weights, arrays, where)
    kind, corners = _corners(s, primitive, count, unpacked.faces if unpacked else None, where)
    return _compact(s, arrays, kind, corners, where)


# --- Morph targets -------------------------------------------------------------------------------


def _morph(
    s: Source,
    primitive: schema.Primitive,
    weights: Sequence[float],
    arrays: dict[str, Any],
    where: str,
) -> None:
    """Adds the targets' displacements, as many times as their weights say, to the arrays."""
    for t, (target, weight) in enumerate(zip(primitive.targets, weights, strict=False)):
        if weight == 0.0:
            continue
        for name, accessor in target.items():
            if name not in arrays or name.startswith(("JOINTS", "WEIGHTS")):
                continue
            place = f"{where}.targets[{t}].{name}"
            # a tangent's fourth number is no direction
            width = 3 if name == "TANGENT" else arrays[name].shape[1]
            if accessors.count(s, accessor, place) != len(arrays[name]):
                raise s.error(f"{place}: has another number of elements than the primitive")
            moves = accessors.floats(s, accessor, place, (width,))
            moved = arrays[name].copy()
            moved[:, :width] += np.float32(weight) * moves
            arrays[name] = accessors.finite(s, moved, place)


# --- Corners -------------------------------------------------------------------------------------


def _corners(
    s: Source,
    primitive: schema.Primitive,
    count: int,
    faces: NDArray[Any] | None,
    where: str,
) -> tuple[str, Integers]:
    """What kind of thing the primitive has, and (N, corners of one) indices of vertices."""
    if primitive.mode not in _MODES:
        raise s.error(f"{where}.mode is {primitive.mode}; must lie in [0, 6]")
    mode = _MODES[primitive.mode]
    if faces is not None:
        return TRIANGLES, _in_range(s, faces, count, f"{where}.indices")
    if primitive.indices is None:
        listed = np.arange(count)
    else:
        place = f"{where}.indices"
        found = accessors.integers(s, primitive.indices, place)[:, 0]
        s.spend(8 * len(found), place)
        listed = found.astype(np.int64)
    if mode in _CORNERS:
        size = _CORNERS[mode]
        corners = listed[: len(listed) - len(listed) % size].reshape(-1, size)
        kind = mode
    elif mode == "line loop":
        corners, kind = np.stack([listed, np.roll(listed, -1)], axis=1), LINES
    elif mode == "line strip":
        corners, kind = np.stack([listed[:-1], listed[1:]], axis=1), LINES
    else:
        kind = TRIANGLES
        first = np.arange(max(len(listed) - 2, 0))
        if mode == "triangle strip":  # every other one is turned, so that all face alike
            odd = first % 2
            places = np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)
        else:
            places = np.stack([first + 1, first + 2, 0 * first], axis=1)
        corners = listed[places]
    return kind, _in_range(s, corners, count, f"{where}.indices")


def _in_range(s: Source, corners: NDArray[Any], count: int, where: str) -> Integers:
    found = np.asarray(corners, np.int64)
    wrong = (found >= count) | (found < 0)
    if wrong.any():
        element, corner = np.argwhere(wrong)[0]
        raise s.error(
            f"{where}: element {element} refers to vertex {found[element, corner]}; the primitive"
            f" has {count}, from 0"
        )
    return found


def _compact(
    s: Source, arrays: dict[str, Any], kind: str, corners: Integers, where: str
) -> Geometry:
    """With those vertices only that are used: primitives often share one large array."""
    count = len(arrays["POSITION"])
    used = np.zeros(count, bool)
    used[corners.ravel()] = True
    kept = int(used.sum())
    if kept < count:
        number = np.cumsum(used) - 1
        corners = number[corners]
        arrays = {name: values[used] for name, values in arrays.items()}
    s.spend(corners.nbytes + sum(4 * values.size for values in arrays.values()), where)
    groups: dict[str, list[Any]] = {}
    for name in sorted(arrays, key=lambda name: int(name.partition("_")[2] or 0)):
        groups.setdefault(name.partition("_")[0], []).append(arrays[name])
    sets = [int(name[9:]) for name in arrays if name.startswith("TEXCOORD_")]
    skinned = len(groups.get("JOINTS", ())) == len(groups.get("WEIGHTS", ())) > 0
    return Geometry(
        where=where,
        kind=kind,
        positions=arrays["POSITION"],
        corners=corners,
        normals=arrays.get("NORMAL"),
        tangents=arrays.get("TANGENT") if "NORMAL" in arrays else None,
        uvs={number: arrays[f"TEXCOORD_{number}"] for number in sets},
        colors=arrays.get("COLOR_0"),
        joints=np.hstack(groups["JOINTS"]).astype(np.int64) if skinned else None,
        weights=np.hstack(groups["WEIGHTS"]) if skinned else None,
    )


# --- Places --------------------------------------------------------------------------------------


def skin_matrices(s: Source, index: int, world: NDArray[np.float64]) -> NDArray[np.float64]:
    """(J, 3, 4): from the mesh as it was bound to where each joint carries it."""
    skin = s.document.skins[index]
    where = f"skins[{index}]"
    for k, joint in enumerate(skin.joints):
        s.item(s.document.nodes, "nodes", joint, f"{where}.joints[{k}]")
    joints = world[skin.joints]
    if skin.inverse_bind_matrices is not None:
        place = f"{where}.inverseBindMatrices"
        bind = accessors.floats(s, skin.inverse_bind_matrices, place, (16,))
        if len(bind) < len(joints):
            raise s.error(f"{place}: has {len(bind)} matrices for {len(joints)} joints")
        bind = bind[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = joints @ bind.astype(np.float64)
    return joints[:, :3]


def skinned(s: Source, g: Geometry, matrices: NDArray[np.float64]) -> Geometry:
    """Where the joints carry it, in the scene's frame: linear blend skinning."""
    assert g.joints is not None
    assert g.weights is not None
    wrong = (g.joints >= len(matrices)) & (g.weights != 0.0)
    if wrong.any():
        vertex, k = np.argwhere(wrong)[0]
        raise s.error(
            f"{g.where}.attributes: vertex {vertex} refers to joint {g.joints[vertex, k]}; the skin"
            f" has {len(matrices)}, from 0"
        )
    total = g.weights.sum(axis=1, keepdims=True)
    weights = g.weights / np.where(total > 0.0, total, 1.0)
    blend = np.zeros((len(g.positions), 3, 4), np.float32)
    for k in range(g.joints.shape[1]):
        joint = np.minimum(g.joints[:, k], len(matrices) - 1)
        blend += weights[:, k, None, None] * matrices.astype(np.float32)[joint]
    loose = total[:, 0] <= 0.0
    blend[loose] = np.eye(3, 4)
    moved = np.einsum("vij,vj->vi", blend[:, :, :3], g.positions) + blend[:, :, 3]
    normals = g.normals
    if normals is not None:
        normals = np.einsum("vij,vj->vi", cofactors(blend[:, :, :3]), normals)
    tangents = g.tangents
    if tangents is not None:
        tangents = turned(blend[:, :, :3], tangents)
    return replace(g, positions=moved, normals=normals, tangents=tangents)


def moved(g: Geometry, matrix: NDArray[np.float64]) -> Geometry:
    """Under an affine transform, which may mirror or flatten."""
    if np.array_equal(matrix[:3], np.eye(3, 4)):
        return g
    linear = matrix[:3, :3]
    positions = (g.positions.astype(np.float64) @ linear.T + matrix[:3, 3]).astype(np.float32)
    corners = g.corners
    if g.kind == TRIANGLES and np.linalg.det(linear) < 0.0:
        corners = corners[:, [0, 2, 1]]
    normals = g.normals
    if normals is not None:
        normals = (normals @ cofactors(linear[None])[0].T).astype(np.float32)
    tangents = g.tangents
    if tangents is not None:
        tangents = turned(linear[None], tangents)
    return replace(g, positions=positions, normals=normals, tangents=tangents, corners=corners)


def turned(linear: NDArray[Any], tangents: Floats) -> Floats:
    """Tangents under (N, 3, 3) matrices, or one for all. What is mirrored has its bitangent on the
    other side of normal and tangent.
    """
    made = np.empty_like(tangents)
    made[:, :3] = np.einsum(
        "vij,vj->vi", np.broadcast_to(linear, (len(made), 3, 3)), tangents[:, :3]
    )
    made[:, 3] = np.where(np.linalg.det(linear) < 0.0, -tangents[:, 3], tangents[:, 3])
    return made


def cofactors(linear: NDArray[Any]) -> NDArray[Any]:
    """(N, 3, 3) matrices for normals, which stay perpendicular and outside: the inverse transpose
    up to a positive factor, also of a matrix that has no inverse.
    """
    x, y, z = linear[:, 0], linear[:, 1], linear[:, 2]
    made = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
    sign = np.where(np.einsum("ni,ni->n", made[:, 0], x) < 0.0, -1.0, 1.0)
    return np.asarray(made * sign[:, None, None])
