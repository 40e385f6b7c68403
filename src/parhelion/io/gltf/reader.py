"""From a document to a Scene: nodes with meshes become shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import option, unknown_name
from ...scene import Curves, Instances, Mesh, Scene, Shape, Solid, Spheres
from .. import LoadOptions
from . import accessors, animation, lights, meshes, nodes, schema
from .materials import Materials, uv_name
from .meshes import Geometry
from .source import Source

Matrices = NDArray[np.float64]

# Points and lines have no size in glTF. They get a radius, in parts of the scene's diagonal, that
# makes them some two pixels wide in a picture of usual size.
_RADIUS = 0.001
# Transforms that flatten more than this cannot be inverted, as Instances need
_FLAT = 1e-9


class Reader:
    """One file on its way to a Scene, or to one at each of several times."""

    def __init__(self, path: Path, options: LoadOptions) -> None:
        self.source = Source(path, options)
        self.options = options
        self.materials = Materials(self.source)
        self._names: dict[str, int] = {}

    def scene(self, time: float | None) -> Scene:
        """The whole scene at a time of the animations, or as it is stored. Raises FormatError."""
        s = self.source
        s.forget()
        self._names = {}
        if time is not None and not s.document.animations:
            name = option("time")
            raise s.error(f"the option {name!r} is {time:g}; the file has no animations")
        tree = nodes.read(s, time)
        placed = self._placed(tree)
        shapes = self._shapes(placed)
        low, high = _bounds(placed)
        found = lights.read(s, tree.seen, tree.world, 0.5 * (low + high))
        camera, settings = lights.camera(s, self._camera(tree.seen), tree.world)
        s.reports.tell()
        return Scene(
            shapes=tuple(shapes),
            materials=dict(self.materials.made),
            camera=camera,
            background=None,
            lights=tuple(found),
            settings=settings,
            name=s.path.name,
        )

    # What there is to choose from

    def contents(self) -> dict[str, Any]:
        """Variants, cameras and animations by name. Raises FormatError."""
        s = self.source
        found: dict[str, Any] = {}
        variants = self._variants()
        if variants:
            found["variants"] = {"names": variants, "used": self.options.variant}
        seen = nodes.read(s, None).seen
        names = {node: name for name, node in reversed(self._cameras(seen).items())}
        if names:
            used = names[self._camera(seen)[0]]
            found["cameras"] = {"names": [names[i] for i in seen if i in names], "used": used}
        if s.document.animations:
            found["animation_seconds"] = animation.seconds(s)
        return found

    def _variants(self) -> list[str]:
        s = self.source
        known = s.extension(s.document, "KHR_materials_variants", schema.Variants, "$")
        return [v.name for v in known.variants] if known else []

    def _variant(self) -> int | None:
        names = self._variants()
        if self.options.variant is None:
            return None
        if self.options.variant not in names:
            raise self.source.error(unknown_name("variant", self.options.variant, names))
        return names.index(self.options.variant)

    def _cameras(self, seen: list[int]) -> dict[str, int]:
        """The nodes with a camera, by its name and by theirs; of several of a name the first, and
        by "nodes[i]" where neither tells them apart.
        """
        s = self.source
        found: dict[str, int] = {}
        for i in seen:
            node = s.document.nodes[i]
            if node.camera is None:
                continue
            camera = s.item(s.document.cameras, "cameras", node.camera, f"nodes[{i}].camera")
            free = [n for n in (camera.name, node.name) if n and n not in found]
            found.update(dict.fromkeys(free or [f"nodes[{i}]"], i))
        return found

    def _camera(self, seen: list[int]) -> list[int]:
        """The node of the camera that is used; none in a scene without."""
        known = self._cameras(seen)
        wanted = self.options.camera
        if wanted is not None and wanted not in known:
            raise self.source.error(unknown_name("camera", wanted, known))
        return list(known.values())[:1] if wanted is None else [known[wanted]]

    # What is where

    def _placed(self, tree: nodes.Tree) -> list[tuple[str, Geometry, Matrices]]:
        """Every primitive that is seen, by name, with the (N, 4, 4) places where it is."""
        s = self.source
        variant = self._variant()
        places: dict[Any, tuple[str, list[Matrices]]] = {}
        for i in tree.seen:
            node = s.document.nodes[i]
            if node.mesh is None:
                continue
            mesh = s.item(s.document.meshes, "meshes", node.mesh, f"nodes[{i}].mesh")
            skin = node.skin
            if skin is not None:
                s.item(s.document.skins, "skins", skin, f"nodes[{i}].skin")
            own = tree.weights.get(i)
            weights = None if own is None else tuple(own)
            name = mesh.name or node.name or f"mesh {node.mesh}"
            where = self._copies(i, node, tree.world[i])
            # joints alone say where a skin is
            key = (node.mesh, weights, skin)
            if skin is None:
                places.setdefault(key, (name, []))[1].append(where)
            elif key not in places:
                places[key] = (name, [np.eye(4)[None]])
        found = []
        for (mesh_index, weights, skin), (name, at) in places.items():
            joints = None if skin is None else meshes.skin_matrices(s, skin, tree.world)
            where = np.concatenate(at)
            for geometry in meshes.read(s, mesh_index, weights, variant):
                if geometry.joints is not None and joints is not None:
                    geometry = meshes.skinned(s, geometry, joints)
                if len(geometry.corners) and len(where):
                    found.append((name, geometry, where))
        return found

    def _copies(self, index: int, node: schema.Node, matrix: Matrices) -> Matrices:
        """(N, 4, 4): where the mesh of a node is: once, or by EXT_mesh_gpu_instancing."""
        s = self.source
        many = s.extension(node, "EXT_mesh_gpu_instancing", schema.Instancing, f"nodes[{index}]")
        if many is None:
            return matrix[None]
        where = f"nodes[{index}].extensions.EXT_mesh_gpu_instancing.attributes"
        rest = {"TRANSLATION": (0.0, 0.0, 0.0), "ROTATION": (0.0, 0.0, 0.0, 1.0),
                "SCALE": (1.0, 1.0, 1.0)}  # fmt: skip
        given = {
            name: accessors.floats(s, many.attributes[name], f"{where}.{name}", (len(value),))
            for name, value in rest.items()
            if name in many.attributes
        }
        counts = {len(values) for values in given.values()}
        if len(counts) != 1:
            raise s.error(f"{where}: must have arrays of one length among {', '.join(rest)}")
        count = counts.pop()
        s.spend(400 * count, where)
        parts = [
            given.get(name, np.broadcast_to(np.array(value), (count, len(value)))).astype(
                np.float64
            )
            for name, value in rest.items()
        ]
        return matrix @ nodes.placed(*parts)

    # Shapes

    def _shapes(self, placed: list[tuple[str, Geometry, Matrices]]) -> list[Shape]:
        """Meshes that are seen once are moved to where they are; of others there are instances."""
        shapes: list[Shape] = []
        groups: dict[int, tuple[str, list[Solid], Matrices]] = {}
        low, high = _bounds(placed)
        radius = _RADIUS * float(np.linalg.norm(high - low)) or _RADIUS
        for name, geometry, where in placed:
            single = len(where) == 1
            alone = where if single else where[_flat(where)]
            # what is scaled to a point or a line is hidden so
            for matrix in alone[np.linalg.matrix_rank(alone[:, :3, :3]) >= 2]:
                shapes.append(self._solid(name, meshes.moved(geometry, matrix), radius))
            upright = where[~_flat(where)]
            if not single and len(upright):
                scale = float(np.cbrt(abs(np.linalg.det(upright[0, :3, :3]))))
                group = groups.setdefault(id(where), (name, [], upright))
                group[1].append(self._solid(name, geometry, radius / scale))
        for name, parts, where in groups.values():
            shapes.append(Instances(tuple(parts), where, self._unique(name)))
        return shapes

    def _solid(self, name: str, g: Geometry, radius: float) -> Solid:
        accessors.finite(self.source, g.positions, f"{g.where}, where it is placed")
        self.source.spend(100 * len(g.positions), g.where)
        return self._mesh(name, g) if g.kind == meshes.TRIANGLES else self._thin(name, g, radius)

    def _mesh(self, name: str, g: Geometry) -> Mesh:
        surface = self.materials.surface(g.material, g.colors)
        uvs = {n: np.stack([a[:, 0], 1.0 - a[:, 1]], axis=1) for n, a in g.uvs.items()}
        for needed in (*surface.others, *[surface.uv_set] * surface.textured):
            if needed not in uvs:
                self.source.report(
                    f"{g.where}: has no TEXCOORD_{needed}, which its material's textures need"
                )
            elif needed in surface.others:
                surface.attributes[uv_name(needed)] = uvs[needed]
        tangents = g.tangents if surface.oriented else None
        return Mesh(
            vertices=np.ascontiguousarray(g.positions, np.float32),
            faces=g.corners.astype(np.uint32),
            normals=None if g.normals is None else np.ascontiguousarray(g.normals, np.float32),
            uvs=uvs.get(surface.uv_set),
            tangents=tangents,
            material=surface.name,
            attributes=surface.attributes,
            name=self._unique(name),
        )

    def _thin(self, name: str, g: Geometry, radius: float) -> Spheres | Curves:
        """Points as spheres, lines as tubes."""
        surface = self.materials.surface(g.material, None)
        colors = None
        if g.colors is not None:
            corners = np.clip(g.colors[:, :3], 0.0, 1.0)[g.corners]
            colors = corners.mean(axis=1)
        if g.kind == meshes.POINTS:
            return Spheres(
                g.positions[g.corners[:, 0]],
                radius,
                material=surface.name,
                colors=colors,
                name=self._unique(name),
            )
        return Curves(
            g.positions[g.corners.ravel()],
            radius,
            counts=np.full(len(g.corners), 2),
            basis="linear",
            material=surface.name,
            colors=colors,
            name=self._unique(name),
        )

    def _unique(self, name: str) -> str:
        count = self._names[name] = self._names.get(name, 0) + 1
        return name if count == 1 else f"{name} {count}"


def _flat(matrices: Matrices) -> NDArray[np.bool_]:
    """(N,): which ones cannot be inverted."""
    linear = matrices[:, :3, :3]
    size = np.linalg.norm(linear, axis=1, keepdims=True)
    whole = (size > 0.0).all(axis=(1, 2))
    return np.asarray(
        ~whole | (np.abs(np.linalg.det(linear / np.where(size > 0.0, size, 1.0))) < _FLAT)
    )


def _bounds(placed: list[tuple[str, Geometry, Matrices]]) -> tuple[Any, Any]:
    """Corners of a box that holds everything; of nothing, the origin."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for _, geometry, where in placed:
        axes = geometry.positions.T  # one after the other, which is faster than rows of three
        lowest = np.array([axis.min() for axis in axes], np.float64)
        highest = np.array([axis.max() for axis in axes], np.float64)
        middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        linear = where[:, :3, :3]
        centers, reach = linear @ middle + where[:, :3, 3], np.abs(linear) @ half
        low = np.minimum(low, (centers - reach).min(axis=0))
        high = np.maximum(high, (centers + reach).max(axis=0))
    if not np.isfinite(high - low).all():
        return np.zeros(3), np.zeros(3)
    return low, high
