"""From a Scene to a glTF document: docs/gltf.md, Writing glTF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import atan, radians, tan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import tables
from ...atomic import replacing
from ...display import srgb_encoded
from ...errors import SceneError
from ...framing import bounds, placed
from ...scene import (
    Camera,
    Curves,
    Cylinders,
    Disks,
    Framing,
    Instances,
    Light,
    Material,
    Mesh,
    Scene,
    Shape,
    Solid,
    Spheres,
    Texture,
)
from ...studio import framing, up_of, upright
from ..files import Reports
from . import solids
from .building import INDICES, VERTICES, Builder, text
from .lights import LUMENS_PER_WATT
from .out_materials import Materials, Surface

Matrices = NDArray[np.float64]

# Copies that are nodes of their own, which every program shows; more use EXT_mesh_gpu_instancing.
_MOST_NODES = 1000
_MOST_COPIES = 10_000_000
# Skewed copies, which have to be nodes
_MOST_SKEWED = 200_000
# Colours of spheres, disks or cylinders of one shape; each needs a material
_MOST_COLORS = 1024
# What may be lost of a matrix when it is taken apart, in parts of its size
_SKEW = 1e-6


def save(scene: Scene, path: Path, reports: Reports) -> None:
    """Writes a .glb, or a .gltf that holds everything itself. Raises SceneError, ResourceError."""
    writer = _Writer(scene, reports)
    writer.scene()
    reports.tell()
    with replacing(path) as temporary, open(temporary, "wb") as file:
        for piece in writer.builder.pieces(binary=path.suffix.lower() == ".glb"):
            file.write(piece)


@dataclass
class _Placed:
    """A mesh of the document and where it is, (N, 4, 4)."""

    name: str
    mesh: int
    where: Matrices


class _Writer:
    def __init__(self, scene: Scene, reports: Reports) -> None:
        self._scene = scene
        self._reports = reports
        self.builder = Builder()
        self._materials = Materials(self.builder, scene.materials, reports)
        self._names = list(scene.materials)
        self._usual = _usual_radius(scene.shapes)
        self._made: dict[Any, int] = {}  # meshes of the document by what they were made of
        self._kept: list[Any] = []

    def scene(self) -> None:
        """The whole document."""
        nodes: list[int] = []
        for shape in self._scene.shapes:
            for found in self._shape(shape):
                nodes += self._nodes(found)
        nodes += self._lights()
        nodes += self._camera()
        up = up_of(self._scene)
        if nodes and up != (0.0, 1.0, 0.0):  # y is up in glTF
            turn = np.eye(4)
            turn[:3, :3] = upright(up).T
            root = {"name": "upright", "matrix": _columns(turn), "children": nodes}
            nodes = [self.builder.add("nodes", root)]
        scene: dict[str, Any] = {"name": text(self._scene.name)}
        if nodes:
            scene["nodes"] = nodes
        if self._scene.legend is not None:
            self._reports.add("the legend: not in glTF; left out")
        self.builder.json["scene"] = self.builder.add("scenes", scene)

    # --- Shapes ----------------------------------------------------------------------------------

    def _shape(self, shape: Shape) -> Iterable[_Placed]:
        if isinstance(shape, Instances):
            for parts, copies in self._groups(shape):
                for part in parts:
                    for found in self._shape(part):
                        if len(found.where) * len(copies) > _MOST_COPIES:
                            raise SceneError(
                                f"shape {shape.name!r}: makes more than {_MOST_COPIES:,} copies;"
                                " glTF has no copies of copies"
                            )
                        where = (copies[:, None] @ found.where[None]).reshape(-1, 4, 4)
                        name = shape.name if len(shape.shapes) == 1 else found.name
                        yield _Placed(name, found.mesh, where)
        elif isinstance(shape, Mesh):
            if len(np.asarray(shape.faces)):
                yield _Placed(shape.name, self._mesh(shape), np.eye(4)[None])
        elif isinstance(shape, Curves):
            self._reports.add("curves: glTF has none; left out")
        else:
            self._reports.add(
                "spheres, disks and cylinders: not in glTF; written as meshes of 64 sides or more"
            )
            yield from self._round(shape)

    def _groups(self, shape: Instances) -> Iterable[tuple[Sequence[Solid], Matrices]]:
        """The shapes of instances and where they are, for each colour that they are copied in."""
        copies = _square(shape.transforms)
        if shape.colors is None:
            yield shape.shapes, copies
            return
        colors = np.asarray(shape.colors, np.float32).reshape(-1, 3)
        for own in _alike(*self._rounded(colors).T):
            color = np.clip(colors[own].astype(np.float64).mean(axis=0), 0.0, None)
            yield [self._tinted(part, color) for part in shape.shapes], copies[own]

    def _tinted(self, part: Solid, color: NDArray[np.float64]) -> Solid:
        """A shape in a colour, unless it has its own."""
        if part.colors is not None or isinstance(part, Curves):
            return part
        if isinstance(part, Mesh) and isinstance(part.material, (str, Material)):
            return replace(part, material=self._in_color(part.material, tuple(color.tolist())))
        each: Any = (
            part.faces
            if isinstance(part, Mesh)
            else part.starts
            if isinstance(part, Cylinders)
            else part.centers
        )
        return replace(part, colors=np.tile(color, (len(np.asarray(each)), 1)))

    def _material(self, given: Any) -> Material:
        if isinstance(given, Material):
            return given
        return self._scene.materials[given if isinstance(given, str) else self._names[given]]

    def _in_color(self, given: Any, color: Any) -> Material:
        """A material whose colour is another."""
        material = self._material(given)
        if material.type == "blend":
            self._reports.add("colours of what is made of a blend: not in glTF; left out")
            return material
        (first, *_) = tables.entry("materials", material.type).params
        return Material(material.type, **{**material.params, first.name: color})

    def _mesh(self, mesh: Mesh) -> int:
        key = ("mesh", id(mesh))
        if key not in self._made:
            self._kept.append(mesh)
            self._made[key] = self._new_mesh(mesh)
        return self._made[key]

    def _new_mesh(self, mesh: Mesh) -> int:
        faces = np.asarray(mesh.faces, np.uint32)
        left = dict.fromkeys(mesh.attributes)
        if mesh.colors is not None:
            mesh = replace(mesh, attributes={**mesh.attributes, "face_colors": mesh.colors})
        primitives = []
        for given, own in _by_material(mesh.material, len(faces)):
            material = self._material(given)
            if mesh.colors is not None:
                material = self._in_color(given, Texture("attribute", name="face_colors"))
            surface = self._materials.surface(material, _thickness(mesh.vertices))
            for name in (*surface.sets, surface.color, surface.alpha):
                left.pop(name or "", None)
            part = faces if own is None else faces[own]
            primitives.append(self._primitive(mesh, part, own, surface))
        for name in left:
            self._reports.add(f"attribute {name!r}: no material shows it; left out")
        return self.builder.add("meshes", {"name": text(mesh.name), "primitives": primitives})

    def _primitive(
        self, mesh: Mesh, faces: NDArray[Any], own: NDArray[Any] | None, surface: Surface
    ) -> dict[str, Any]:
        """Faces of one material. own: their indices, None for all of the mesh's."""
        reverse = mesh.inside_out != surface.reverse
        sets = list(surface.sets)
        if mesh.uvs is not None and "" not in sets:
            sets.append("")
        used = [n for n in (*sets, surface.color, surface.alpha) if n]
        apart = any(n.startswith("face_") for n in used)
        corners = faces.ravel()
        if apart:
            faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        which = np.repeat(np.arange(len(corners) // 3) if own is None else own, 3)

        def array(name: str, given: Any, make: Any, **options: Any) -> int:
            """An accessor of a value of each vertex, or of each corner where faces lie apart."""
            if name.startswith("face_"):
                return self.builder.accessor(make(np.asarray(given)[which]), VERTICES, **options)
            if apart:
                return self.builder.accessor(make(np.asarray(given)[corners]), VERTICES, **options)
            made = make(np.asarray(given))
            return self.builder.shared(given, (name, reverse), made, target=VERTICES, **options)

        attributes = {"POSITION": array("points", mesh.vertices, np.float32, bounds=True)}
        if mesh.normals is not None:
            sign = np.float32(-1.0 if reverse else 1.0)
            attributes["NORMAL"] = array("normals", mesh.normals, lambda a: sign * _unit(a))
        if mesh.tangents is not None and mesh.normals is None:
            self._reports.add("tangents without normals: not in glTF; left out")
        elif mesh.tangents is not None:
            attributes["TANGENT"] = array(
                "tangents", mesh.tangents, lambda a: _tangents(a, reverse)
            )
        count = len(np.asarray(mesh.vertices))
        for i, name in enumerate(sets):
            given = mesh.attributes.get(name) if name else mesh.uvs
            if given is None:
                self._reports.add(f"shape {mesh.name!r}: has no {name!r}, which a texture lies on")
                rows = len(np.asarray(mesh.faces)) if name.startswith("face_") else count
                given = np.zeros((rows, 2), np.float32)
            attributes[f"TEXCOORD_{i}"] = array(name or "uvs", given, _downwards)
        if surface.color or surface.alpha:
            attributes["COLOR_0"] = self._colors(mesh, surface, array)
        indices = faces[:, ::-1] if reverse else faces
        indices = indices.astype(np.uint16 if indices.max() < 65535 else np.uint32).ravel()
        if own is None and not apart:
            index = self.builder.shared(mesh.faces, ("faces", reverse), indices, target=INDICES)
        else:
            index = self.builder.accessor(indices, INDICES)
        return {"attributes": attributes, "indices": index, "material": surface.index}

    def _colors(self, mesh: Mesh, surface: Surface, array: Any) -> int:
        """COLOR_0 of a colour attribute and one of opacity, either of which may be missing."""
        names = [n for n in (surface.color, surface.alpha) if n]
        kinds = {n.partition("_")[0] for n in names}
        # black and invisible where there is none
        found = {n: mesh.attributes.get(n) for n in names}
        rows = len(np.asarray(mesh.faces if kinds == {"face"} else mesh.vertices))
        color: Any = np.ones((rows, 3), np.float32)
        if surface.color:
            given = found[surface.color]
            color = np.zeros((rows, 3)) if given is None else np.asarray(given)
            color = color.astype(np.float32).reshape(len(color), -1)
        if len(kinds) > 1:
            self._reports.add(
                "colours by vertex with opacity by face, or the reverse: not in glTF; the opacity"
                " is left out"
            )
        elif surface.alpha:
            given = found[surface.alpha]
            alpha = np.zeros(rows) if given is None else np.asarray(given)
            alpha = alpha.astype(np.float32).reshape(rows, -1)[:, :1]
            color = np.concatenate([np.broadcast_to(color, (rows, 3)), alpha], axis=1)
        if color.shape[1] < 3:
            color = np.broadcast_to(color[:, :1], (len(color), 3))
        key = surface.color or surface.alpha
        self._kept.append(color)
        return int(array(key, color, lambda a: np.clip(np.asarray(a, np.float32), 0.0, 1.0)))

    def _round(self, shape: Spheres | Disks | Cylinders) -> Iterable[_Placed]:
        """Spheres, disks and cylinders: copies of a unit mesh for each material and colour."""
        where = solids.matrices(shape)
        count = len(where)
        sides = np.full(count, solids.SIDES)
        if isinstance(shape, Spheres) and count:
            radii = np.broadcast_to(np.asarray(shape.radii, np.float64), count)
            sides = solids.sides(radii, self._usual)
        material = np.zeros(count, np.int64)
        named = isinstance(shape.material, (str, Material))
        if not named:
            given = np.asarray(shape.material)
            if given.dtype.kind == "U":
                number = {name: i for i, name in enumerate(self._names)}
                given = np.array([number[name] for name in given.tolist()], np.int64)
            material = given.astype(np.int64)
        color = np.zeros((count, 3), np.int64)
        if shape.colors is not None:
            color = self._rounded(np.asarray(shape.colors, np.float32))
        for own in _alike(sides, material, *color.T):
            n, m = int(sides[own[0]]), int(material[own[0]])
            surface = shape.material if named else m
            if shape.colors is not None:
                # the mean is theirs exactly, where all are the same
                mean = np.asarray(shape.colors, np.float64)[own].mean(axis=0)
                surface = self._in_color(surface, tuple(np.clip(mean, 0.0, None).tolist()))
            unit = (
                solids.sphere(n)
                if isinstance(shape, Spheres)
                else solids.disk()
                if isinstance(shape, Disks)
                else solids.cylinder()
            )
            key = ("unit", id(unit), shape.inside_out, self._material(surface))
            if key not in self._made:
                # its arrays stay the same objects, which are written once
                one = replace(
                    unit,
                    material=self._material(surface),
                    name=shape.name,
                    inside_out=shape.inside_out,
                )
                self._made[key] = self._new_mesh(one)
            yield _Placed(shape.name, self._made[key], where[own])

    def _rounded(self, colors: NDArray[np.float32]) -> NDArray[np.int64]:
        """(N, 3) numbers that are the same where colours are, or nearly so if there are many."""
        exact = np.ascontiguousarray(colors).view(np.uint32).astype(np.int64)
        if len(_alike(*exact.T)) <= _MOST_COLORS:
            return exact
        encoded = srgb_encoded(colors)
        for steps in (255, 127, 63, 31, 15, 10):
            found = np.asarray(encoded * np.float32(steps) + np.float32(0.5), np.int64)
            if len(_alike(*found.T)) <= _MOST_COLORS:
                break
        self._reports.add(
            f"more than {_MOST_COLORS} colours of spheres, disks or cylinders: rounded to"
            f" {steps + 1} steps of red, green and blue"
        )
        return found

    # --- Nodes -----------------------------------------------------------------------------------

    def _nodes(self, found: _Placed) -> list[int]:
        """Nodes at all places of a mesh."""
        where = found.where
        straight = _straight(where)
        nodes = []
        if np.count_nonzero(straight) > _MOST_NODES:
            nodes.append(self._many(found, where[straight]))
            where, straight = where[~straight], straight[~straight]
        if len(where) > _MOST_SKEWED:
            raise SceneError(
                f"shape {found.name!r}: has {len(where):,} copies that are skewed; glTF files are"
                f" written with at most {_MOST_SKEWED:,}"
            )
        for matrix, simple in zip(where, straight.tolist(), strict=True):
            nodes.append(self._node(found, matrix, simple))
        return nodes

    def _node(self, found: _Placed, matrix: Matrices, simple: bool) -> int:
        node: dict[str, Any] = {"name": text(found.name), "mesh": found.mesh}
        if simple:
            if not np.array_equal(matrix, np.eye(4)):
                node["matrix"] = _columns(matrix)
            return self.builder.add("nodes", node)
        # A matrix that skews is a turn, then a scaling, then a turn: U S V of its decomposition
        u, s, v = np.linalg.svd(matrix[:3, :3])
        inner, outer = np.eye(4), np.eye(4)
        sign = np.linalg.det(v)
        inner[:3, :3] = v * sign
        outer[:3, :3] = u * s * sign
        outer[:3, 3] = matrix[:3, 3]
        child = self.builder.add("nodes", node | {"matrix": _columns(inner)})
        parent = {"name": node["name"], "matrix": _columns(outer), "children": [child]}
        return self.builder.add("nodes", parent)

    def _many(self, found: _Placed, where: Matrices) -> int:
        """A node with copies, by EXT_mesh_gpu_instancing."""
        scale = np.linalg.norm(where[:, :3, :3], axis=1)
        scale[:, 0] *= np.sign(np.linalg.det(where[:, :3, :3]))
        turn = quaternions(where[:, :3, :3] / scale[:, None, :])
        attributes = {"TRANSLATION": where[:, :3, 3], "ROTATION": turn, "SCALE": scale}
        made = {
            name: self.builder.accessor(values.astype(np.float32))
            for name, values in attributes.items()
        }
        extension = {"EXT_mesh_gpu_instancing": {"attributes": made}}
        self.builder.uses("EXT_mesh_gpu_instancing", required=True)
        return self.builder.add(
            "nodes", {"name": text(found.name), "mesh": found.mesh, "extensions": extension}
        )

    # --- Lights and cameras ----------------------------------------------------------------------

    def _lights(self) -> list[int]:
        if self._scene.background is not None:
            kind = self._scene.background.type
            self._reports.add(f"background {kind!r}: glTF has none; left out")
        nodes = []
        for light in self._scene.lights:
            made = self._light(light)
            if made is None:
                self._reports.add(f"light {light.type!r}: not in glTF; left out")
                continue
            self.builder.uses("KHR_lights_punctual")
            extension = self.builder.json.setdefault("extensions", {})
            lights = extension.setdefault("KHR_lights_punctual", {"lights": []})["lights"]
            lights.append(made[0])
            index = {"KHR_lights_punctual": {"light": len(lights) - 1}}
            node = {"name": light.type, "matrix": _columns(made[1]), "extensions": index}
            nodes.append(self.builder.add("nodes", node))
        return nodes

    def _light(self, light: Light) -> tuple[dict[str, Any], Matrices] | None:
        """A light and the matrix of its node; None for a type that glTF does not have."""
        p = dict(light.params)
        kinds = {"point": "intensity", "spot": "intensity", "directional": "irradiance"}
        if light.type not in kinds:
            return None
        listed = {x.name: x.default for x in tables.entry("lights", light.type).params}
        power = np.asarray(p.get(kinds[light.type], listed[kinds[light.type]]), np.float64)
        matrix = np.eye(4)
        if p.get("transform") is not None:
            given = np.asarray(p["transform"], np.float64)
            matrix[: given.shape[0], : given.shape[1]] = given
        if "direction" in listed:
            direction = np.asarray(p.get("direction", listed["direction"]), np.float64)
            turn = np.eye(4)
            turn[:3, :3] = _towards(-(matrix[:3, :3] @ direction))
        else:
            turn = np.eye(4)
        position = np.asarray(p.get("position", (0.0, 0.0, 0.0)), np.float64)
        turn[:3, 3] = matrix[:3, :3] @ position + matrix[:3, 3]
        if light.type == "directional":
            turn[:3, 3] = 0.0
        most = float(power.max()) or 1.0
        made: dict[str, Any] = {
            "type": light.type,
            "color": (power / most).tolist(),
            "intensity": float(power.max()) * LUMENS_PER_WATT,
        }
        if light.type == "directional" and p.get("angle"):
            self._reports.add("directional lights of some width: glTF has none; written without")
        if light.type == "spot":
            outer = float(p.get("cutoff_angle", listed["cutoff_angle"][0]))
            inner = float(p.get("beam_width", -1.0))
            inner = 0.75 * outer if inner < 0.0 else min(inner, outer)
            if outer > 90.0:
                self._reports.add("spots wider than 90 degrees: not in glTF; cut there")
            angles = [radians(min(x, 90.0)) for x in (inner, outer)]
            # which must differ
            angles[0] = min(angles[0], angles[1] * (1.0 - 1e-4))
            made["spot"] = {"innerConeAngle": angles[0], "outerConeAngle": angles[1]}
        return made, turn

    def _camera(self) -> list[int]:
        """The camera's node. A scene that is framed as every file is needs none."""
        scene = self._scene
        width, height = scene.settings.width, scene.settings.height
        if scene.camera is None or (
            isinstance(scene.camera, Framing)
            and replace(scene.camera, shapes=()) == framing(up_of(scene))
        ):
            return []
        camera = placed(scene, width / height)
        eye = np.asarray(camera.eye, np.float64)
        towards = eye - np.asarray(camera.target, np.float64)
        low, high = bounds(scene.replace(camera=None))
        far = float(np.linalg.norm(towards))
        if np.all(np.isfinite(high - low)):
            far = float(np.linalg.norm(np.maximum(np.abs(low - eye), np.abs(high - eye))))
        near = 1e-3 * float(np.linalg.norm(towards))
        if camera.projection == "perspective":
            yfov = 2.0 * atan(_slope(camera, width, height))
            made: dict[str, Any] = {
                "type": "perspective",
                "perspective": {"yfov": yfov, "aspectRatio": width / height, "znear": near},
            }
        elif camera.projection == "orthographic":
            half = 0.5 * float(camera.height or 1.0)
            size = {"xmag": half * width / height, "ymag": half}
            made = {
                "type": "orthographic",
                "orthographic": size | {"znear": 0.0, "zfar": max(far, near)},
            }
        else:
            self._reports.add(f"camera {camera.projection!r}: not in glTF; left out")
            return []
        if camera.aperture_radius:
            self._reports.add("camera: its depth of field is not in glTF; left out")
        if any(camera.shift):
            self._reports.add("camera: its shift is not in glTF; left out")
        matrix = np.eye(4)
        matrix[:3, :3] = _towards(towards, camera.up)
        matrix[:3, 3] = eye
        if camera.mirrored:
            matrix[:3, 0] *= -1.0
        index = self.builder.add("cameras", made)
        node = {"name": "camera", "camera": index, "matrix": _columns(matrix)}
        return [self.builder.add("nodes", node)]


def _slope(camera: Camera, width: int, height: int) -> float:
    """Half of the picture's height at distance 1; camera.md has both fields of view."""
    if camera.fov is not None:
        step = 2.0 * tan(radians(camera.fov) / 2.0) / max(width - 1, 1)
        return 0.5 * step * height
    return tan(radians(40.0 if camera.vfov is None else camera.vfov) / 2.0)


def _by_material(material: Any, count: int) -> Iterable[tuple[Any, NDArray[np.int64] | None]]:
    """Each material of a mesh, and the faces that have it; None for all."""
    if isinstance(material, (str, Material)):
        yield material, None
        return
    used, first, index = np.unique(np.asarray(material), return_index=True, return_inverse=True)
    for i in np.argsort(first).tolist():
        own = np.flatnonzero(index.reshape(-1) == i)
        yield used[i].item(), None if len(own) == count else own


def _alike(*columns: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The indices of rows that are the same in all columns, for each such row."""
    code = np.zeros(len(columns[0]), np.int64)
    for column in columns:
        each, index = np.unique(column, return_inverse=True)
        code = np.unique(code * len(each) + index, return_inverse=True)[1]
    order = np.argsort(code, kind="stable")
    ends = np.flatnonzero(np.diff(code[order])) + 1
    return [part for part in np.split(order, ends) if len(part)]


def _usual_radius(shapes: Sequence[Shape]) -> float:
    """The median radius of all spheres."""
    radii = [
        np.broadcast_to(np.asarray(s.radii, np.float64), len(np.asarray(s.centers)))
        for shape in shapes
        for s in (shape.shapes if isinstance(shape, Instances) else [shape])
        if isinstance(s, Spheres)
    ]
    together = np.concatenate(radii) if radii else np.ones(0)
    return float(np.median(together)) if len(together) else 1.0


def _thickness(points: Any) -> float:
    """The least extent of a mesh that is not 0; 1 of a point."""
    extent = np.ptp(np.asarray(points, np.float64), axis=0)
    return float(extent[extent > 0.0].min()) if extent.any() else 1.0


def _tangents(given: NDArray[Any], reverse: bool) -> NDArray[np.float32]:
    """As glTF has them: unit, with 1 or -1; the other of these where normals are reversed."""
    made = np.asarray(given, np.float32).copy()
    made[:, :3] = _unit(made[:, :3])
    made[:, 3] = np.where((made[:, 3] < 0.0) != reverse, -1.0, 1.0)
    return np.asarray(made)


def _unit(normals: NDArray[Any]) -> NDArray[np.float32]:
    """Normals of length 1; those that are so nearly stay what they are."""
    normals = np.asarray(normals, np.float32)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    off = np.abs(length - 1.0) > 1e-4
    divided = normals / np.where(length > 0.0, length, 1.0)
    divided[length[:, 0] == 0.0] = (0.0, 0.0, 1.0)
    return np.where(off, divided, normals).astype(np.float32)


def _downwards(uvs: NDArray[Any]) -> NDArray[np.float32]:
    """Coordinates whose v runs down."""
    uvs = np.asarray(uvs, np.float32)
    return np.stack([uvs[:, 0], np.float32(1.0) - uvs[:, 1]], axis=1)


def _square(transforms: Any) -> Matrices:
    """(N, 4, 4) of (N, 3, 4) or (N, 4, 4)."""
    given = np.asarray(transforms, np.float64)
    made = np.tile(np.eye(4), (len(given), 1, 1))
    if len(given):
        made[:, :3] = given[:, :3]
    return made


def _straight(where: Matrices) -> NDArray[np.bool_]:
    """(N,): which ones turn, scale along axes and move, and do not skew."""
    linear = where[:, :3, :3]
    products = linear.transpose(0, 2, 1) @ linear
    size = np.einsum("nii->n", products)
    off = np.abs(products[:, [0, 0, 1], [1, 2, 2]]).max(axis=1)
    return np.asarray(off <= _SKEW * size)


def _columns(matrix: Matrices) -> list[float]:
    """As glTF writes matrices."""
    return [float(x) + 0.0 for x in matrix.T.ravel()]


def _towards(back: Any, up: Any = (0.0, 1.0, 0.0)) -> Matrices:
    """Columns right, up and back, of what looks along -back."""
    back = np.asarray(back, np.float64)
    back = back / np.linalg.norm(back)
    right = np.cross(np.asarray(up, np.float64), back)
    if np.linalg.norm(right) < 1e-6 * np.linalg.norm(up):
        right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


def quaternions(turns: Matrices) -> NDArray[np.float64]:
    """(N, 4) x y z w of rotation matrices.

    4 q q^T has sums of the matrix's elements in it; its row of the largest diagonal element is q
    times a number that is not small.
    """
    m = turns.transpose(1, 2, 0)
    (a, b, c), (d, e, f), (g, h, i) = m
    products = np.array(
        [
            [1 + a - e - i, b + d, c + g, h - f],
            [b + d, 1 - a + e - i, f + h, c - g],
            [c + g, f + h, 1 - a - e + i, d - b],
            [h - f, c - g, d - b, 1 + a + e + i],
        ]
    ).transpose(2, 0, 1)
    best = np.argmax(np.einsum("nkk->nk", products), axis=1)
    found = products[np.arange(len(best)), best]
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))
