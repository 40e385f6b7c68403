"""Shape: meshes, curves, and surfaces of revolution.

Scenes have spheres and curves by the thousand, each a directive of its own: those that follow each
other with one material become one of ours. Quadrics that ours cannot hold become meshes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import subdivision
from ...scene import (
    Curves,
    Cylinders,
    Disks,
    Instances,
    Material,
    Mesh,
    Shape,
    Spheres,
    Texture,
)
from ..meshes import Indices, Integers, check_indices, ply, smooth_normals, turned
from . import lights, materials, transforms
from .colors import Color, scaled
from .items import Array, Item
from .transforms import Matrix

if TYPE_CHECKING:
    from .reader import Group, Reader, State

# Segments of a mesh that stands for a surface of revolution: around, and along its profile
_AROUND, _ALONG = 128, 64
# Triangles of a scene that stand for surfaces of another kind
_MOST_TRIANGLES = 1 << 22
# Triangles of a scene that subdivision makes
_MOST_SUBDIVIDED = 1 << 21
# Sides of a bilinear patch that is not flat, in segments; where there are more, each is small
_PATCH, _MANY_PATCHES = 8, 4096

# Control points of a segment, points from one segment to the next, and its cubic Bezier points from
# them, as rows, by basis and degree (L. Piegl and W. Tiller, The NURBS Book, 2nd edition, sections
# 5.3 and 5.5)
_ELEVATE = np.array([[3, 0, 0], [1, 2, 0], [0, 2, 1], [0, 0, 3]]) / 3.0
_BASES: dict[tuple[str, int], tuple[int, int, Array]] = {
    ("bezier", 3): (4, 3, np.eye(4)),
    ("bezier", 2): (3, 2, _ELEVATE),
    ("bspline", 3): (
        4,
        1,
        np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0,
    ),
    ("bspline", 2): (3, 1, _ELEVATE @ np.array([[0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5]])),
}


@dataclass(frozen=True)
class _Surface:
    """What a shape is made of, and whether it lies on the other side.

    body: the medium inside, with the index of refraction, for meshes that bound one together.
    """

    material: str | Material
    textured: bool
    body: tuple[str, float] | None = None
    inside_out: bool = False


class Shapes:
    """The shapes of a scene as they come."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader
        self.budget = subdivision.Budget(_MOST_SUBDIVIDED)
        self.named: dict[str, Material] = {}
        self._shown: list[Shape] = []
        # by their directives, which are kept so that no id() is given twice; equal ones are one
        self._made: dict[int, tuple[Item, Material]] = {}
        self._equal: dict[Material, Material] = {}
        self._whole: dict[tuple[Any, ...], Material] = {}
        self._names: dict[str, int] = {}
        self._spent = 0
        self._kept: dict[int, Item] = {}
        self._media: dict[str, Color | None] = {"": None}
        self._sound = np.eye(4)  # the last transformation that was looked at
        self._spheres: dict[tuple[Any, ...], tuple[_Surface, Any, list[Array], list[float]]] = {}
        self._curves: dict[tuple[Any, ...], tuple[_Surface, list[Array], list[Array]]] = {}
        # meshes that bound a medium: where each is, its surface
        self._bounding: dict[tuple[Any, ...], list[tuple[list[Any], int, _Surface]]] = {}
        self._default: Material = Material("diffuse", color=(0.5, 0.5, 0.5))

    def add(self, item: Item, state: State, group: Group | None) -> None:
        """A Shape directive, into an object's shapes or, without one, into the scene's."""
        function = SHAPES.get(item.type)
        if function is None:
            item.report("not supported; left out")
            return
        matrix = state.to_world
        if matrix is not self._sound and not transforms.invertible(matrix):
            raise item.error("the transformation has no inverse")
        self._sound = matrix
        if state.lamp is not None and group is not None:
            self.reader.report(
                "AreaLightSource in an object: pbrt gives it no light; neither do we"
            )
        into = self._shown if group is None else group.shapes
        function(_Job(self, item, state, matrix, into, group))
        item.ignore("material", "shadowalpha")
        item.finish()

    def unique(self, name: str) -> str:
        """The name, with a number if another shape has it."""
        count = self._names[name] = self._names.get(name, 0) + 1
        return name if count == 1 else f"{name} {count}"

    # Materials

    def base(self, state: State) -> tuple[str, Material]:
        """The current material's name, "" for none, and what it is."""
        item, name = state.material, ""
        if item is None:
            return "", self._default
        if isinstance(item, str):
            name = item
            directive = self.reader.named_materials.get(name)
            if directive is None:
                return "", self._missing(name)
            item = directive
        if id(item) not in self._made:
            made = materials.read(item)
            self._made[id(item)] = (item, self._equal.setdefault(made, made))
        return name, self._made[id(item)][1]

    def _missing(self, name: str) -> Material:
        self.reader.report(f"NamedMaterial {name!r}: no material has that name; 0.5 grey is used")
        return self._default

    def kept(self, key: tuple[Any, ...], make: Callable[[], Material]) -> Material:
        """One material for one key, so that shapes can be told to be of the same."""
        if key not in self._whole:
            self._whole[key] = make()
        return self._whole[key]

    def keep(self, *items: Item) -> None:
        """Keeps what a key has the id() of."""
        for item in items:
            self._kept[id(item)] = item

    def absorption(self, name: str) -> Color | None:
        """What a medium takes away, 1 / scene unit; None if nothing, or if it does more."""
        if name not in self._media:
            self._media[name] = self._read_medium(name)
        return self._media[name]

    def _read_medium(self, name: str) -> Color | None:
        medium = self.reader.media.get(name)
        if medium is None:
            self.reader.report(f"MediumInterface: no medium is called {name!r}; ignored")
            return None
        kind = medium.string("type", "homogeneous")
        unseen = f"medium {name!r} ({kind}): participating media are not rendered yet; ignored"
        if kind != "homogeneous" or medium.has("preset") or medium.has("Le"):
            self.reader.report(unseen)
            return None
        scale = medium.number("scale", 1.0)
        medium.ignore("g")
        # pbrt's own, of a substance like milk, in 1 / mm
        scattered = medium.plain("sigma_s", (2.55, 3.21, 3.77), "index")
        absorbed = medium.plain("sigma_a", (0.0011, 0.0024, 0.014), "index")
        medium.finish()
        if not 0.0 <= scale < 1e12:
            raise medium.error(f"scale is {scale:g}; must be 0 or above")
        if max(scattered) * scale > 0.0:
            self.reader.report(unseen)
            return None
        return scaled(absorbed, scale) if max(absorbed) * scale > 0.0 else None

    # Batches

    def sphere(self, surface: _Surface, linear: Matrix, center: Array, radius: float) -> None:
        """A sphere, among those of the same surface; linear: the axes of its frame."""
        rotation = linear / np.linalg.norm(linear, axis=0) if surface.textured else None
        key = (_identity(surface), b"" if rotation is None else rotation.tobytes())
        if key not in self._spheres:
            self._spheres[key] = (surface, rotation, [], [])
        self._spheres[key][2].append(center)
        self._spheres[key][3].append(radius)

    def curve(self, surface: _Surface, style: str, points: Array, radii: Array) -> None:
        """A strand of cubic Bezier segments, among those of the same surface."""
        key = (_identity(surface), style)
        if key not in self._curves:
            self._curves[key] = (surface, [], [])
        self._curves[key][1].append(points)
        self._curves[key][2].append(radii)

    def flush(self, group: Group | None) -> None:
        """Ends the batches, whose shapes go to an object or the scene."""
        into: list[Any] = self._shown if group is None else group.shapes
        for surface, rotation, centers, radii in self._spheres.values():
            into.append(
                Spheres(
                    np.array(centers),
                    np.array(radii),
                    surface.material,
                    rotation=rotation,
                    inside_out=surface.inside_out,
                    name=self.unique("sphere"),
                )
            )
        for (_, style), (surface, points, radii_of) in self._curves.items():
            into.append(
                Curves(
                    np.concatenate(points),
                    np.concatenate(radii_of),
                    np.array([len(strand) for strand in points]),
                    basis="bezier",
                    style=style,
                    capped=False,
                    material=surface.material,
                    name=self.unique("curve"),
                )
            )
        self._spheres.clear()
        self._curves.clear()

    def mesh(self, into: list[Any], mesh: Mesh, surface: _Surface) -> None:
        """A mesh; one that bounds a medium gets its material when all of its like are known."""
        if surface.body is not None:
            assert isinstance(surface.material, Material)
            key = (surface.body[0], materials.changed(surface.material, ior=1.0))
            self._bounding.setdefault(key, []).append((into, len(into), surface))
        into.append(mesh)

    def finish(self, groups: dict[str, Group]) -> list[Shape]:
        """All shapes of the scene."""
        self.flush(None)
        self._bodies()
        if cut := self.budget.report():
            self.reader.report(f"loopsubdiv: {cut}")
        for name, group in groups.items():
            if not group.transforms:
                continue
            placed = np.stack(group.transforms)
            if group.shapes:
                parts = tuple(group.shapes)
                self._shown.append(Instances(parts, placed[:, :3], self.unique(name)))
            for shape, matrix in group.uneven:
                own = (placed @ matrix)[:, :3]
                self._shown.append(Instances((shape,), own, self.unique(name)))
        return self._shown

    def spend(self, item: Item, triangles: int) -> None:
        """Counts triangles that stand for surfaces of another kind: a line of text makes many."""
        self._spent += triangles
        if self._spent > _MOST_TRIANGLES:
            raise item.error(f"the surfaces before it take {_MOST_TRIANGLES} triangles")

    def _bodies(self) -> None:
        """One material for all meshes around one medium, or light that enters the medium through
        one of them would not be known to leave it through another. Where their indices of
        refraction differ, as that of tea to air and to glass, the index is an attribute of faces.
        """
        for (_, material), bounds in self._bounding.items():
            assert isinstance(material, Material)
            indices = {surface.body[1] for _, _, surface in bounds if surface.body}
            shared = len(indices) > 1
            ior = Texture("attribute", name="face_ior") if shared else indices.pop()
            whole = materials.changed(material, ior=ior)
            for into, at, surface in bounds:
                mesh = into[at]
                attributes = dict(mesh.attributes)
                if shared and surface.body:
                    attributes["face_ior"] = np.full(len(mesh.faces), surface.body[1], np.float32)
                into[at] = replace(mesh, material=whole, attributes=attributes)


def _identity(surface: _Surface) -> tuple[Any, ...]:
    material = surface.material
    return (material if isinstance(material, str) else id(material), surface.inside_out)


def _textured(material: Material) -> bool:
    return any(
        isinstance(value, Texture) or (isinstance(value, Material) and _textured(value))
        for value in material.params.values()
    )


@dataclass(frozen=True)
class _Job:
    """One Shape directive: its parameters, the state it came in, and where the result goes."""

    shapes: Shapes
    item: Item
    state: State
    matrix: Matrix
    into: list[Any]
    group: Group | None

    @property
    def name(self) -> str:
        return self.shapes.unique(self.item.type)

    def surface(self, area: Callable[[], float]) -> _Surface:
        """What the shape is made of; area: in scene units, for lamps whose power is told."""
        state, item = self.state, self.item
        name, material = self.shapes.base(state)
        key: tuple[Any, ...] = (name, id(material))
        base = material
        alpha = item.scalar("alpha", 1.0)
        if isinstance(alpha, Texture) or alpha < 1.0:
            cut = alpha if isinstance(alpha, Texture) else max(alpha, 0.0)
            key = (*key, "alpha", cut)
            base = self.shapes.kept(key, lambda: materials.changed(material, opacity=cut))
        lamp = state.lamp if self.group is None else None
        if lamp is not None:
            power = lamp.has("power")
            key = (*key, "lamp", id(lamp), id(item) if power else 0)
            self.shapes.keep(lamp, *([item] if power else []))
            dark = base

            def shining() -> Material:
                radiance, both = lights.emission(lamp, area)
                return materials.changed(dark, emission=radiance, two_sided_emission=both)

            base = self.shapes.kept(key, shining)
        textured = _textured(base)
        body, flipped = None, False
        if state.inside or state.outside:
            base, body, flipped = self._medium(base, key)
        if base is not material or not name:
            return _Surface(base, textured, body, flipped)
        if self.shapes.named.setdefault(name, material) is not material:
            return _Surface(material, textured)  # the name means another by now
        return _Surface(name, textured)

    def _medium(
        self, material: Material, key: tuple[Any, ...]
    ) -> tuple[Material, tuple[str, float] | None, bool]:
        """With what the medium inside absorbs. A medium that only lies outside is inside of the
        same surface turned around.
        """
        inside, outside = self.state.inside, self.state.outside
        if inside == outside:
            return material, None, False
        inner, outer = (self.shapes.absorption(name) for name in (inside, outside))
        if inner is None and outer is None:
            return material, None, False
        if material.type != "dielectric":
            self.shapes.reader.report(
                f"medium {inside or outside!r} within a surface that is no dielectric: ignored"
            )
            return material, None, False
        if inner is not None and outer is not None:
            self.shapes.reader.report(
                f"media {inside!r} and {outside!r} meet in one surface; only the first absorbs"
            )
        flipped = inner is None
        name, absorption = (outside, outer) if flipped else (inside, inner)
        ior = float(material.params["ior"])
        ior = 1.0 / ior if flipped else ior
        made = self.shapes.kept(
            (*key, "medium", name, flipped),
            lambda: materials.changed(material, ior=ior, absorption=absorption),
        )
        return made, (name, ior), flipped

    # Meshes

    def put(
        self,
        vertices: Array,
        faces: Indices,
        normals: Array | None = None,
        uvs: Array | None = None,
        name: str = "",
    ) -> None:
        """A mesh in the shape's own frame.

        Its front is where normals point; without any, where its faces are seen counter-clockwise
        before the transformation. ReverseOrientation turns it around.
        """
        if not np.isfinite(vertices).all():
            bad = int(np.argmin(np.isfinite(vertices).all(axis=1)))
            raise self.item.error(f"vertex {bad} is not finite")
        placed = transforms.points(self.matrix, vertices)
        if not np.isfinite(placed).all():
            raise self.item.error("its transformation moves it out of the range of numbers")
        reverse = self.state.reverse
        if normals is not None:
            moved = transforms.normals(self.matrix, normals)
            lost = ~np.isfinite(moved).all(axis=1)
            if lost.any():
                moved[lost] = smooth_normals(placed, faces)[lost]
            normals = -moved if reverse else moved
            faces = turned(placed, faces, normals)
            reverse = False
        elif transforms.determinant(self.matrix[:3, :3]) < 0.0:
            faces = faces[:, [0, 2, 1]]
        surface = self.surface(lambda: _area(placed, faces))
        if uvs is None and surface.textured:
            # pbrt gives each triangle the same three corners
            placed, normals = (
                placed[faces.ravel()],
                None if normals is None else normals[faces.ravel()],
            )
            faces = np.arange(len(placed)).reshape(-1, 3)
            uvs = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], (len(faces), 1))
        mesh = Mesh(
            vertices=placed.astype(np.float32),
            faces=faces.astype(np.uint32),
            normals=None if normals is None else normals.astype(np.float32),
            uvs=None if uvs is None else uvs.astype(np.float32),
            material=surface.material,
            inside_out=reverse != surface.inside_out,
            name=self.shapes.unique(name or self.item.type),
        )
        self.shapes.mesh(self.into, mesh, surface)


def _area(vertices: Array, faces: Indices) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _indices(job: _Job, count: int, vertices: int) -> Integers:
    """(N, count) indices of vertices, in range; without any, all vertices in turn."""
    given = job.item.rows("indices", count, "integer")
    if given is None:
        if vertices != count:
            raise job.item.error("needs 'indices'")
        return np.arange(count)[None]
    whole = given.astype(np.int64)
    check_indices(f"{job.item.directive.place}: {job.item}", whole, vertices)
    return whole


def _positions(job: _Job) -> Array:
    found = job.item.rows("P", 3, "point", "point3", "vector", "vector3", "float")
    if found is None or not len(found):
        raise job.item.error("needs 'P', the positions of its vertices")
    return found


def _per_vertex(job: _Job, names: tuple[str, ...], width: int, count: int) -> Array | None:
    """Numbers at each vertex, by the first of these names; of a wrong count they are reported."""
    for name in names:
        found = job.item.rows(
            name, width, "point2", "vector2", "float", "normal", "normal3", "vector", "vector3"
        )
        if found is None:
            continue
        if len(found) == count:
            return found
        job.item.report(f"{name!r} has {len(found)} values for {count} vertices; ignored")
    return None


def _triangles(job: _Job) -> None:
    vertices = _positions(job)
    faces = _indices(job, 3, len(vertices))
    normals = _per_vertex(job, ("N",), 3, len(vertices))
    uvs = _per_vertex(job, ("uv", "st"), 2, len(vertices))
    job.item.ignore("S", "faceIndices", "discarddegenerateUVs", "shadowalpha")
    job.put(vertices, faces, normals, uvs)


def _ply(job: _Job) -> None:
    path = job.item.file("filename")
    data = job.shapes.reader.once(path, lambda: ply.read(path))
    if job.item.has("displacement"):
        job.item.ignore("displacement", "displacement.edgelength")
        job.item.report("displacement is not supported; ignored")
    job.put(
        np.asarray(data.vertices, np.float64),
        data.faces,
        None if data.normals is None else np.asarray(data.normals, np.float64),
        None if data.uvs is None else np.asarray(data.uvs, np.float64),
        path.name.partition(".")[0],
    )


def _loop(job: _Job) -> None:
    vertices = _positions(job)
    faces = _indices(job, 3, len(vertices))
    levels = job.item.integer("levels", job.item.integer("nlevels", 3))
    job.item.ignore("scheme")
    levels = job.shapes.budget.levels(len(faces), levels)
    made = subdivision.subdivide(
        vertices,
        np.full(len(faces), 3),
        faces.ravel(),
        levels=levels,
        scheme="warren",
        sharp_boundary_corners=False,
    )
    # of a vertex between surfaces that only touch, one corner's normal
    normals = np.zeros_like(made.points)
    normals[made.faces.ravel()] = made.normals.reshape(-1, 3)
    job.put(made.points, made.faces, normals)


def _bilinear(job: _Job) -> None:
    """Patches of four corners p00, p10, p01, p11; flat ones are two triangles."""
    vertices = _positions(job)
    patches = _indices(job, 4, len(vertices))
    normals = _per_vertex(job, ("N",), 3, len(vertices))
    uvs = _per_vertex(job, ("uv",), 2, len(vertices))
    job.item.ignore("faceIndices")
    if job.item.has("emissionfilename"):
        job.item.ignore("emissionfilename")
        job.item.report("'emissionfilename' is not supported; ignored")
    corners = vertices[patches]
    twist = np.abs(corners[:, 0] - corners[:, 1] - corners[:, 2] + corners[:, 3]).max()
    flat = twist <= transforms.ROUNDING * np.abs(np.ptp(corners, axis=1)).max()
    n = 1 if flat else _PATCH if len(patches) <= _MANY_PATCHES else 2
    job.shapes.spend(job.item, 2 * (n * n - 1) * len(patches))
    v, u = (x.ravel() for x in np.meshgrid(*(np.linspace(0.0, 1.0, n + 1),) * 2, indexing="ij"))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    coordinates = np.broadcast_to(square, (len(patches), 4, 2)) if uvs is None else uvs[patches]

    def spread(values: Array) -> Array:
        return np.asarray(np.einsum("kc,pcd->pkd", weights, values).reshape(-1, values.shape[-1]))

    first = (n + 1) ** 2 * np.arange(len(patches))
    faces = (first[:, None, None] + _grid(n, n)).reshape(-1, 3)
    around = None if normals is None else spread(normals[patches])
    job.put(spread(corners), faces, around, spread(coordinates))


def _grid(across: int, along: int) -> Integers:
    """Triangles between (along + 1) rows of (across + 1) vertices."""
    row, column = (
        x.ravel() for x in np.meshgrid(np.arange(along), np.arange(across), indexing="ij")
    )
    a = row * (across + 1) + column
    b, c, d = a + 1, a + across + 2, a + across + 1
    return np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1).reshape(-1, 3)


def _height_field(job: _Job) -> None:
    """Versions 1 and 2: heights over the unit square."""
    nu, nv = job.item.integer("nu", 0, 2), job.item.integer("nv", 0, 2)
    heights = job.item.numbers("Pz", "float")
    if heights is None or nu < 2 or nv < 2 or len(heights) != nu * nv:
        raise job.item.error("needs 'nu' and 'nv', from 2, and nu times nv heights 'Pz'")
    v, u = (
        x.ravel() for x in np.meshgrid(np.linspace(0, 1, nv), np.linspace(0, 1, nu), indexing="ij")
    )
    job.put(np.stack([u, v, heights], 1), _grid(nu - 1, nv - 1), None, np.stack([u, v], 1))


# Surfaces of revolution


def _turned_profile(job: _Job, profile: Callable[[Array], Array], along: int, sweep: float) -> None:
    """A mesh of the surface that a curve makes as it turns around z.

    profile: (N, 3) points for N places v from 0 to 1. sweep: the angle of the turn, in degrees.
    """
    around = max(8, math.ceil(_AROUND * sweep / 360.0))
    job.shapes.spend(job.item, 2 * around * along)
    u, v = np.linspace(0.0, 1.0, around + 1), np.linspace(0.0, 1.0, along + 1)
    step = 1e-4
    middle = np.clip(v, 2.0 * step, 1.0 - 2.0 * step)  # at its ends a profile may be pointed
    points = profile(v)
    rise = profile(middle + step) - profile(middle - step)
    x, y, _ = profile(middle).T
    # the direction of u, (-y, x, 0), times that of v
    across = np.stack([x * rise[:, 2], y * rise[:, 2], -(x * rise[:, 0] + y * rise[:, 1])], axis=1)
    angle = math.radians(sweep) * u
    turn = np.zeros((around + 1, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0] = np.sin(angle)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1.0
    vertices, normals = (np.einsum("uij,vj->vui", turn, a).reshape(-1, 3) for a in (points, across))
    uvs = np.stack([np.tile(u, along + 1), np.repeat(v, around + 1)], axis=1)
    faces = _grid(around, along)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    size = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    job.put(vertices, faces[size > 1e-12 * size.max(initial=0.0)], normals, uvs)


def _sweep(job: _Job) -> float:
    sweep = job.item.number("phimax", 360.0)
    if not sweep > 0.0:
        raise job.item.error(f"phimax is {sweep:g}; must be above 0")
    return min(sweep, 360.0)


def _positive(job: _Job, name: str) -> float:
    value = job.item.number(name, 1.0)
    if not value > 0.0:
        raise job.item.error(f"{name} is {value:g}; must be above 0")
    return value


def _sphere(job: _Job) -> None:
    radius = _positive(job, "radius")
    low = max(job.item.number("zmin", -radius), -radius)
    high = min(job.item.number("zmax", radius), radius)
    low, high = min(low, high), max(low, high)
    sweep = _sweep(job)
    linear = job.matrix[:3, :3]
    if low > -radius or high < radius or sweep < 360.0:
        ends = [math.acos(max(-1.0, min(1.0, z / radius))) for z in (low, high)]

        def profile(v: Array) -> Array:
            theta = ends[0] + (ends[1] - ends[0]) * v
            return radius * np.stack([np.sin(theta), 0.0 * v, np.cos(theta)], axis=1)

        _turned_profile(job, profile, _ALONG, sweep)
        return
    size = float(abs(transforms.determinant(linear)) ** (1.0 / 3.0)) * radius
    surface = job.surface(lambda: 4.0 * math.pi * size * size)
    if job.state.reverse:
        surface = replace(surface, inside_out=not surface.inside_out)
    if transforms.even(linear, 3):
        job.shapes.sphere(surface, linear, job.matrix[:3, 3], size)
        return
    unit = Spheres(
        np.zeros((1, 3)), radius, surface.material, inside_out=surface.inside_out, name=job.name
    )
    if job.group is None:
        job.into.append(Instances((unit,), job.matrix[None, :3], unit.name))
    else:
        job.group.uneven.append((unit, job.matrix))


def _disk(job: _Job) -> None:
    radius, height = _positive(job, "radius"), job.item.number("height", 0.0)
    inner, sweep = job.item.number("innerradius", 0.0), _sweep(job)
    linear = job.matrix[:3, :3]
    surface = job.surface(
        lambda: math.pi * radius**2 * abs(transforms.determinant(linear)) ** (2.0 / 3.0)
    )
    # texture coordinates of our disks are laid out otherwise
    if (
        inner > 0.0
        or sweep < 360.0
        or surface.textured
        or surface.body
        or not transforms.even(linear, 2)
    ):

        def profile(v: Array) -> Array:
            r = radius + (inner - radius) * v
            return np.stack([r, 0.0 * v, np.full(len(v), height)], axis=1)

        _turned_profile(job, profile, 1, sweep)
        return
    center = transforms.points(job.matrix, np.array([[0.0, 0.0, height]]))
    mirrored = bool(transforms.determinant(linear) < 0.0)
    job.into.append(
        Disks(
            center,
            radius * linear[None, :, 0],
            radius * linear[None, :, 1],
            surface.material,
            inside_out=(job.state.reverse != mirrored) != surface.inside_out,
            name=job.name,
        )
    )


def _cylinder(job: _Job) -> None:
    radius, sweep = _positive(job, "radius"), _sweep(job)
    low, high = job.item.number("zmin", -1.0), job.item.number("zmax", 1.0)
    low, high = min(low, high), max(low, high)
    if low == high:
        raise job.item.error(f"zmin and zmax are both {low:g}")
    linear = job.matrix[:3, :3]
    upright = (
        np.abs(linear[:, 2] @ linear[:, :2]).max() < transforms.ROUNDING * np.abs(linear).max() ** 2
    )
    mirrored = transforms.determinant(linear) < 0.0
    if sweep < 360.0 or not transforms.even(linear, 2) or not upright or mirrored:

        def profile(v: Array) -> Array:
            return np.stack([np.full(len(v), radius), 0.0 * v, low + (high - low) * v], axis=1)

        _turned_profile(job, profile, 1, sweep)
        return
    size = float(np.linalg.norm(linear[:, 0])) * radius
    ends = transforms.points(job.matrix, np.array([[0.0, 0.0, low], [0.0, 0.0, high]]))
    length = float(np.linalg.norm(ends[1] - ends[0]))
    surface = job.surface(lambda: 2.0 * math.pi * size * length)
    job.into.append(
        Cylinders(
            ends[:1],
            ends[1:],
            size,
            linear[None, :, 0],
            surface.material,
            inside_out=job.state.reverse != surface.inside_out,
            name=job.name,
        )
    )


def _cone(job: _Job) -> None:
    radius, height = _positive(job, "radius"), job.item.number("height", 1.0)

    def profile(v: Array) -> Array:
        return np.stack([radius * (1.0 - v), 0.0 * v, height * v], axis=1)

    _turned_profile(job, profile, 1, _sweep(job))


def _paraboloid(job: _Job) -> None:
    radius = _positive(job, "radius")
    low, high = job.item.number("zmin", 0.0), job.item.number("zmax", 1.0)
    if not 0.0 <= low < high:
        raise job.item.error(f"zmin {low:g} and zmax {high:g}: 0 <= zmin < zmax is needed")

    def profile(v: Array) -> Array:
        z = low + (high - low) * v
        return np.stack([radius * np.sqrt(z / high), 0.0 * v, z], axis=1)

    _turned_profile(job, profile, _ALONG, _sweep(job))


def _hyperboloid(job: _Job) -> None:
    one, two = (
        job.item.vector(f"p{i}", d) for i, d in ((1, (0.0, 0.0, 0.0)), (2, (1.0, 1.0, 1.0)))
    )

    def profile(v: Array) -> Array:
        return one + (two - one) * v[:, None]

    _turned_profile(job, profile, _ALONG, _sweep(job))


# Curves


def _curve(job: _Job) -> None:
    item = job.item
    points = _positions(job)
    basis, degree = item.string("basis", "bezier"), item.integer("degree", 3)
    if (basis, degree) not in _BASES:
        raise item.error(f"basis {basis!r} of degree {degree}; must be bezier or bspline of 2 or 3")
    order, step, matrix = _BASES[basis, degree]
    if len(points) < order or (len(points) - order) % step:
        raise item.error(f"{len(points)} control points make no {basis} curve of degree {degree}")
    item.ignore("splitdepth")
    kinds = {"flat": "flat", "cylinder": "round", "ribbon": "flat"}
    style = item.choice("type", "flat", kinds)
    if item.string("type", "flat") == "ribbon":
        item.ignore("N")
        item.report("a ribbon's own direction is not supported; it faces the ray")
    width = item.number("width", 1.0)
    ends = item.number("width0", width), item.number("width1", width)
    if not (min(ends) >= 0.0 and max(ends) > 0.0):
        raise item.error(f"its widths are {ends[0]:g} and {ends[1]:g}; must be above 0")
    linear = job.matrix[:3, :3]
    if not transforms.even(linear, 3):
        item.report("an uneven scale changes a curve's place, not its width")
    size = float(np.cbrt(abs(transforms.determinant(linear))))
    placed = transforms.points(job.matrix, points)
    if (basis, degree) == ("bezier", 3):
        strand = placed
    else:
        segments = (len(points) - order) // step + 1
        window = placed[step * np.arange(segments)[:, None] + np.arange(order)]
        pieces = np.einsum("ij,sjk->sik", matrix, window)
        strand = np.concatenate([pieces[:, :3].reshape(-1, 3), pieces[-1:, 3]])
    # the width runs straight along the curve; a point of no width is not allowed to ours
    along = np.linspace(0.0, 1.0, len(strand))
    widths = np.maximum(ends[0] + (ends[1] - ends[0]) * along, 1e-3 * max(ends))
    surface = job.surface(lambda: float(np.linalg.norm(np.diff(strand, axis=0)) * max(ends) * size))
    job.shapes.curve(surface, style, strand, 0.5 * size * widths)


SHAPES: dict[str, Callable[[_Job], None]] = {
    "trianglemesh": _triangles,
    "plymesh": _ply,
    "loopsubdiv": _loop,
    "bilinearmesh": _bilinear,
    "heightfield": _height_field,
    "sphere": _sphere,
    "disk": _disk,
    "cylinder": _cylinder,
    "cone": _cone,
    "paraboloid": _paraboloid,
    "hyperboloid": _hyperboloid,
    "curve": _curve,
}
