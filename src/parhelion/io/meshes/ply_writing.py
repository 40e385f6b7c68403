"""PLY files, binary and little-endian: a scene's triangles as one mesh, or its spheres as points.

Colours are 8-bit sRGB, as nearly all programs expect; docs/meshes.md says what becomes of the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ... import tables
from ...atomic import replacing
from ...display import srgb_encoded
from ...errors import SceneError, unknown_name
from ...framing import is_even
from ...scene import Instances, Material, Mesh, Scene, Shape, Spheres, Texture
from ..files import Reports

# Triangles, or points; copies that make more are refused.
_MOST = 100_000_000
# Records that are put together at a time
_BAND = 1 << 20
_TYPES = {"float32": "float", "float64": "double", "uint8": "uchar"}

Columns = dict[str, NDArray[Any]]


def save(scene: Scene, path: Path, reports: Reports) -> None:
    """Writes the scene; see io.save. Raises SceneError, ResourceError."""
    solids = list(_solids(scene.shapes, reports))
    meshes = [s for s in solids if isinstance(s, Mesh) and np.size(s.faces)]
    spheres = [s for s in solids if isinstance(s, Spheres) and np.size(s.centers)]
    others = {type(s).__name__.lower() for s in solids} - {"mesh", "spheres"}
    for kind in sorted(others):
        reports.add(f"{kind}: PLY has triangles or points; left out")
    if meshes and spheres:
        reports.add("spheres: a PLY file has triangles or points; left out")
    if not meshes and not spheres:
        left = "; ".join(("", *reports.lines))
        raise SceneError(f"the scene has no mesh and no spheres{left}")
    used = meshes or spheres
    _report(scene, used, reports)
    elements = _mesh(scene, meshes, reports) if meshes else {"vertex": _points(scene, spheres)}
    reports.tell()
    with replacing(path) as temporary, open(temporary, "wb") as file:
        file.write(_header(elements))
        for columns in elements.values():
            _write(file, columns)


def _report(scene: Scene, used: Sequence[Mesh | Spheres], reports: Reports) -> None:
    """Names what else there is in the scene."""
    if scene.camera is not None and hasattr(scene.camera, "eye"):
        reports.add("camera: PLY has none; left out")
    if scene.lights or scene.background is not None:
        reports.add("lights and background: PLY has none; left out")
    found = [m for shape in used for m in _materials(scene, shape)]
    if any(isinstance(x, Texture) and x.type != "attribute" for m in found for x in _values(m)):
        reports.add("textures: PLY has none; left out")
    if any(m.type != "diffuse" or set(m.params) - {"color"} for m in found):
        reports.add("materials: PLY has colours only; all else is left out")


def _materials(scene: Scene, shape: Mesh | Spheres) -> list[Material]:
    """Those of a shape."""
    if isinstance(shape.material, Material):
        return [shape.material]
    return [_named(scene, name) for name in np.unique(np.asarray(shape.material)).tolist()]


def _named(scene: Scene, name: str | int) -> Material:
    names = list(scene.materials)
    if isinstance(name, int) and 0 <= name < len(names):
        name = names[name]
    if name not in scene.materials:
        raise SceneError(unknown_name("material", name, map(str, names)))
    return scene.materials[str(name)]


def _values(material: Material) -> Iterator[Any]:
    for value in material.params.values():
        yield value
        if isinstance(value, Material):
            yield from _values(value)


def _solids(shapes: Sequence[Shape], reports: Reports) -> Iterator[Any]:
    """All shapes, copies of meshes and spheres multiplied out."""
    count = 0
    for shape in shapes:
        if not isinstance(shape, Instances):
            yield shape
            continue
        matrices = np.asarray(shape.transforms, np.float64)[:, :3]
        for part in shape.shapes:
            if isinstance(part, Mesh):
                count += len(np.asarray(part.faces)) * len(matrices)
            elif isinstance(part, Spheres):
                count += len(np.asarray(part.centers)) * len(matrices)
            if count > _MOST:
                raise SceneError(f"the copies make more than {_MOST:,} triangles or spheres")
            colors = None
            if shape.colors is not None and part.colors is None:
                colors = np.asarray(shape.colors)
            if isinstance(part, Spheres):
                even = is_even(matrices)
                if not even.all():
                    reports.add(
                        f"shape {shape.name!r}: copies of spheres that are ellipsoids: PLY has"
                        " none; left out"
                    )
                yield _spheres(part, matrices[even], None if colors is None else colors[even])
                continue
            if not isinstance(part, Mesh):
                yield part  # of which none is written
                continue
            for i, matrix in enumerate(matrices):
                moved = _moved(part, matrix)
                if colors is not None:
                    tint = np.tile(colors[i], (len(np.asarray(part.faces)), 1))
                    moved = replace(moved, colors=tint)
                yield moved


def _spheres(
    spheres: Spheres, matrices: NDArray[np.float64], colors: NDArray[Any] | None
) -> Spheres:
    """All copies of spheres. colors: of the copies, None for the spheres' own."""
    centers = np.asarray(spheres.centers).reshape(-1, 3)
    count, copies = len(centers), len(matrices)
    kind = np.float32 if centers.dtype == np.float32 else np.float64
    moved = centers @ matrices[:, :, :3].transpose(0, 2, 1) + matrices[:, None, :, 3]
    scales = np.linalg.norm(matrices[:, :, 0], axis=1)
    radii = scales[:, None] * np.broadcast_to(np.asarray(spheres.radii, np.float64), count)
    material, own = spheres.material, spheres.colors
    return replace(
        spheres,
        centers=moved.reshape(-1, 3).astype(kind),
        radii=radii.ravel(),
        material=material
        if isinstance(material, (str, Material))
        else np.tile(np.asarray(material), copies),
        colors=np.repeat(colors, count, axis=0)
        if colors is not None
        else None
        if own is None
        else np.tile(np.asarray(own), (copies, 1)),
    )


def _moved(mesh: Mesh, matrix: NDArray[np.float64]) -> Mesh:
    linear = matrix[:, :3]
    mirrors = bool(np.linalg.det(linear) < 0.0)
    vertices = np.asarray(mesh.vertices)
    kind = np.float32 if vertices.dtype == np.float32 else np.float64
    faces = np.asarray(mesh.faces)
    normals = mesh.normals
    if normals is not None:
        turned = np.asarray(normals, np.float64) @ np.linalg.inv(linear)
        size = np.linalg.norm(turned, axis=1, keepdims=True)
        normals = (turned / np.where(size > 0.0, size, 1.0)).astype(np.float32)
    return replace(
        mesh,
        vertices=(vertices @ linear.T + matrix[:, 3]).astype(kind),
        faces=faces[:, ::-1] if mirrors else faces,
        normals=normals,
    )


# --- Columns -------------------------------------------------------------------------------------


@dataclass
class _Color:
    """Linear RGB of a shape: (3,) of all of it, or of its vertices or faces."""

    values: NDArray[Any]
    where: str = ""  # "vertex" or "face"


def _color(scene: Scene, mesh: Mesh) -> _Color:
    if mesh.colors is not None:
        return _Color(np.asarray(mesh.colors), "face")
    materials = _materials(scene, mesh)
    if isinstance(mesh.material, (str, Material)):
        value = _first(materials[0])
        if isinstance(value, Texture):
            name = value.params.get("name", "") if value.type == "attribute" else ""
            found = mesh.attributes.get(name)
            if found is not None and np.ndim(found) == 2 and np.shape(found)[1] == 3:
                return _Color(np.asarray(found), name.partition("_")[0])
        return _Color(_constant(value))
    used, index = np.unique(np.asarray(mesh.material), return_inverse=True)
    each = np.stack([_constant(_first(_named(scene, name))) for name in used.tolist()])
    return _Color(each[index.reshape(-1)], "face")


def _first(material: Material) -> Any:
    """The colour of a material: its first parameter."""
    if material.type == "blend":
        return 0.8
    (first, *_) = tables.entry("materials", material.type, "material").params
    return material.params.get(first.name, first.default)


def _constant(value: Any) -> NDArray[np.float64]:
    """A colour, of a texture a light grey."""
    if isinstance(value, Texture):
        value = 0.8
    return np.broadcast_to(np.asarray(value, np.float64), 3)


def _encoded(colors: NDArray[Any]) -> Columns:
    clipped = np.clip(np.asarray(colors, np.float32), 0.0, 1.0)
    whole = np.asarray(srgb_encoded(clipped) * 255.0 + 0.5, np.uint8)
    return {name: whole[:, i] for i, name in enumerate(("red", "green", "blue"))}


def _points(scene: Scene, shapes: Sequence[Spheres]) -> Columns:
    centers: list[NDArray[Any]] = []
    radii: list[NDArray[Any]] = []
    colors: list[NDArray[Any]] = []
    for shape in shapes:
        own = np.asarray(shape.centers).reshape(-1, 3)
        centers.append(own)
        radii.append(np.broadcast_to(np.asarray(shape.radii, np.float32), len(own)))
        if shape.colors is not None:
            colors.append(np.asarray(shape.colors, np.float32))
            continue
        if isinstance(shape.material, (str, Material)):
            (material,) = _materials(scene, shape)
            colors.append(np.broadcast_to(_constant(_first(material)), own.shape))
            continue
        used, index = np.unique(np.asarray(shape.material), return_inverse=True)
        each = np.stack([_constant(_first(_named(scene, name))) for name in used.tolist()])
        colors.append(each[index.reshape(-1)])
    found = _coordinates(centers)
    found["radius"] = np.concatenate(radii)
    return found | _encoded(np.concatenate(colors))


def _coordinates(parts: Sequence[NDArray[Any]]) -> Columns:
    single = all(p.dtype == np.float32 for p in parts)
    points = np.concatenate([p.astype(np.float32 if single else np.float64) for p in parts])
    return {axis: points[:, i] for i, axis in enumerate("xyz")}


def _mesh(scene: Scene, meshes: Sequence[Mesh], reports: Reports) -> dict[str, Columns]:
    """The columns of vertices and faces of all meshes as one."""
    shaded = any(m.normals is not None for m in meshes)
    parts = [_outwards(_flat(m) if shaded and m.normals is None else m) for m in meshes]
    vertex = _coordinates([np.asarray(m.vertices).reshape(-1, 3) for m in parts])
    if shaded:
        normals = np.concatenate([np.asarray(m.normals, np.float32) for m in parts])
        vertex |= {f"n{axis}": normals[:, i] for i, axis in enumerate("xyz")}
    if any(m.uvs is not None for m in parts):
        uvs = np.concatenate(
            [
                np.zeros((len(np.asarray(m.vertices)), 2), np.float32)
                if m.uvs is None
                else np.asarray(m.uvs, np.float32)
                for m in parts
            ]
        )
        vertex |= {"s": uvs[:, 0], "t": uvs[:, 1]}
    begins = np.cumsum([0, *(len(np.asarray(m.vertices)) for m in parts)])
    corners = np.concatenate(
        [np.asarray(m.faces, np.int64) + at for m, at in zip(parts, begins, strict=False)]
    )
    if begins[-1] >= 2**31:
        raise SceneError(f"PLY counts vertices to 2^31; the scene has {begins[-1]:,}")
    face: Columns = {"vertex_indices": corners.astype(np.int32)}
    for place, columns in (("vertex", vertex), ("face", face)):
        columns |= _colors(scene, parts, place) | _attributes(parts, place, reports)
    return {"vertex": vertex, "face": face}


def _flat(mesh: Mesh) -> Mesh:
    """The mesh with vertices of each face's own, and its normal."""
    faces = np.asarray(mesh.faces)
    vertices = np.asarray(mesh.vertices)[faces.ravel()]
    corners = vertices.astype(np.float64).reshape(-1, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(size > 0.0, normal / np.where(size > 0.0, size, 1.0), [1.0, 0.0, 0.0])
    return replace(
        mesh,
        vertices=vertices,
        faces=np.arange(len(vertices)).reshape(-1, 3),
        normals=np.repeat(normal, 3, axis=0),
        uvs=None if mesh.uvs is None else np.asarray(mesh.uvs)[faces.ravel()],
        attributes={
            name: np.asarray(values)[faces.ravel()] if name.startswith("vertex_") else values
            for name, values in mesh.attributes.items()
        },
    )


def _outwards(mesh: Mesh) -> Mesh:
    if not mesh.inside_out:
        return mesh
    normals = None if mesh.normals is None else -np.asarray(mesh.normals)
    return replace(mesh, faces=np.asarray(mesh.faces)[:, ::-1], normals=normals)


def _colors(scene: Scene, meshes: Sequence[Mesh], place: str) -> Columns:
    """The colours of all, in one of the two places: that of faces if some mesh needs it."""
    found = [_color(scene, m) for m in meshes]
    kinds = {c.where for c in found}
    grey = _constant(tables.entry("materials", "diffuse").params[0].default)
    if kinds == {""} and all(np.array_equal(c.values, grey) for c in found):
        return {}
    if place != ("face" if "face" in kinds else "vertex"):
        return {}
    parts = []
    for color, mesh in zip(found, meshes, strict=True):
        faces = np.asarray(mesh.faces)
        count = len(faces) if place == "face" else len(np.asarray(mesh.vertices))
        values = color.values
        if color.where == "vertex" and place == "face":
            values = values[faces].mean(axis=1)
        parts.append(np.broadcast_to(values, (count, 3)))
    return _encoded(np.concatenate(parts))


_ENDINGS = {1: ("",), 2: ("_0", "_1"), 3: ("_x", "_y", "_z")}
_TAKEN = {"x", "y", "z", "nx", "ny", "nz", "s", "t", "u", "v", "r", "g", "b", "red", "green",
          "blue", "vertex_indices", "vertex_index", "color", "alpha"}  # fmt: skip


def _attributes(meshes: Sequence[Mesh], place: str, reports: Reports) -> Columns:
    """Further numbers that all meshes have."""
    found: Columns = {}
    names = {n: None for m in meshes for n in m.attributes if n.startswith(f"{place}_")}
    for name in names:
        short = name.removeprefix(f"{place}_")
        none = np.empty((0, 1), np.float32)
        arrays = [np.asarray(m.attributes.get(name, none), np.float32) for m in meshes]
        wide = [a[:, None] if a.ndim == 1 else a for a in arrays]
        width = {a.shape[1] for a in wide}
        usable = all(len(a) for a in wide) and len(width) == 1 and short.isidentifier()
        if short == "color":  # as the colour
            continue
        if not usable or short in _TAKEN or not short.isascii():
            reports.add(f"attribute {name!r}: not of all meshes, or no name for PLY; left out")
            continue
        values = np.concatenate(wide)
        for i, ending in enumerate(_ENDINGS[values.shape[1]]):
            found[short + ending] = values[:, i]
    return found


# --- Bytes ---------------------------------------------------------------------------------------


def _header(elements: Mapping[str, Columns]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment written by Parhelion"]
    for name, columns in elements.items():
        lines.append(f"element {name} {len(next(iter(columns.values())))}")
        for key, values in columns.items():
            if values.ndim == 2:
                lines.append(f"property list uchar int {key}")
            else:
                lines.append(f"property {_TYPES[values.dtype.name]} {key}")
    return "\n".join([*lines, "end_header\n"]).encode()


def _write(file: BinaryIO, columns: Columns) -> None:
    """Records of one value of each column after the other."""
    fields: list[Any] = []
    for name, values in columns.items():
        kind = values.dtype.newbyteorder("<")
        if values.ndim == 2:
            fields += [(f"{name} count", "u1"), (name, kind, values.shape[1])]
        else:
            fields.append((name, kind))
    count = len(next(iter(columns.values())))
    for begin in range(0, count, _BAND):
        records = np.empty(min(_BAND, count - begin), np.dtype(fields))
        for name, values in columns.items():
            records[name] = values[begin : begin + _BAND]
            if values.ndim == 2:
                records[f"{name} count"] = values.shape[1]
        file.write(records.tobytes())
