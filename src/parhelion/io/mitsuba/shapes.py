"""<shape>: meshes from files, and the basic shapes.

A shape under a transform that its kind cannot hold (an ellipsoid, say) becomes an instance of the
basic one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene import Curves, Cylinders, Disks, Instances, Material, Mesh, Shape, Spheres
from ..meshes import Floats, MeshData, levelset, obj, ply, serialized, smooth_normals, turned
from ..meshes.numbers import parse
from . import bsdfs, emitters
from .document import Object
from .reader import Matrix, Reader

Array = NDArray[np.float64]

_NOTHING: Sequence[Shape] = ()

# Lengths and angles of a transform's axes that differ by less, relatively, count as equal: matrices
# in files have about six digits
_ROUNDING = 1e-4


def read(r: Reader, o: Object) -> Sequence[Shape]:
    """The shapes that an object is; instances, and the groups they copy, wait for `instances`."""
    return _NOTHING if o.type == "shapegroup" else r.make(o, SHAPES, _NOTHING)


# Copies that all instances make together; more are nested to fill the memory
_MOST_COPIES = 10_000_000


def instances(r: Reader) -> list[Instances]:
    """All instances, one object a group of shapes; those within groups as copies of their own."""
    placed: dict[int, tuple[Object, Sequence[Shape], list[Matrix]]] = {}
    waiting: list[tuple[Object, list[Matrix], tuple[int, ...]]] = [
        (group, list(matrices), (id(group),)) for group, matrices in r.groups.values()
    ]
    count = 0
    while waiting:
        group, matrices, way = waiting.pop(0)
        r.group = id(group)
        made = r.make(group, _GROUPS, _NOTHING)
        r.group = None
        placed.setdefault(id(group), (group, made, []))[2].extend(matrices)
        for inner, matrix in r.inner.get(id(group), ()):
            if id(inner) in way:
                raise group.error("holds an instance of itself")
            count += len(matrices)
            if count > _MOST_COPIES:
                raise group.error(f"instances in instances make over {_MOST_COPIES} copies")
            waiting.append((inner, [outer @ matrix for outer in matrices], (*way, id(inner))))
    found = []
    for group, made, matrices in placed.values():
        shapes = [shape for shape in made if not isinstance(shape, Instances)]
        if shapes:
            name = r.unique(group.id or "instances")
            found.append(Instances(tuple(shapes), np.stack(matrices), name))
    return found


def _material(r: Reader, o: Object) -> str | Material:
    """What a shape is made of, with what it emits."""
    for inner in r.nested(o, "medium"):
        r.report(f"medium {inner.type!r}: participating media are not rendered yet; ignored")
    inside = r.nested(o, "bsdf")
    if len(inside) > 1:
        raise o.error(f"has {len(inside)} bsdfs; needs 1")
    for inner in r.nested(o, "subsurface"):
        r.report(f"subsurface {inner.type!r}: not supported; ignored")
    lamps = r.nested(o, "emitter")
    if len(lamps) > 1:
        raise o.error(f"has {len(lamps)} emitters; needs 1 at most")
    emission = emitters.area(r, lamps[0]) if lamps else None
    if not inside:
        share = 0.5 if emission is None else 0.0
        material = Material("diffuse", color=(share,) * 3, two_sided=False)
    else:
        material = bsdfs.read(r, inside[0])
        if emission is None and inside[0].id:
            r.materials[inside[0].id] = material
            return inside[0].id
    return material if emission is None else bsdfs.changed(material, emission=emission)


def _common(r: Reader, o: Object, name: str) -> dict[str, Any]:
    r.ignore(o, "silhouette_sampling_weight")
    return {"material": _material(r, o), "name": r.unique(o.id or name)}


# Transforms


def _invertible(o: Object, matrix: Matrix) -> Matrix:
    if not all(map(math.isfinite, matrix.ravel().tolist())):
        raise o.error("its transform is not finite")
    linear = matrix[:3, :3]
    x, y, z = _lengths(linear, 0, 1, 2)
    if not (x > 0.0 and y > 0.0 and z > 0.0) or abs(_determinant(linear)) < 1e-9 * (x * y * z):
        raise o.error("its transform makes it flat: it cannot be inverted")
    return linear


# In plain numbers, since scenes have tens of thousands of transforms: a call of NumPy takes longer


def _determinant(linear: Matrix) -> float:
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def _lengths(linear: Matrix, *columns: int) -> list[float]:
    axes = linear.T.tolist()
    return [math.hypot(*axes[k]) for k in columns]


def _points(matrix: Matrix, points: Array) -> Array:
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def _normals(matrix: Matrix, normals: Array) -> Array:
    """Normals stay perpendicular to surfaces: they go by the inverse transpose."""
    with np.errstate(all="ignore"):
        moved = normals @ np.linalg.inv(matrix[:3, :3])
        moved /= np.linalg.norm(moved, axis=1, keepdims=True)
    return np.asarray(moved)


def _perpendicular(linear: Matrix, *columns: int) -> bool:
    gram = (linear.T @ linear).tolist()
    return all(
        abs(gram[i][j]) < _ROUNDING * math.sqrt(gram[i][i] * gram[j][j])
        for i, j in combinations(columns, 2)
    )


def _equal(linear: Matrix, *columns: int) -> bool:
    sizes = _lengths(linear, *columns)
    return max(sizes) - min(sizes) <= _ROUNDING * max(sizes)


# Meshes


def _file_mesh(
    reader: Callable[[Path, int], MeshData], *, flip_v: bool
) -> Callable[[Reader, Object], Sequence[Shape]]:
    def make(r: Reader, o: Object) -> Sequence[Shape]:
        path = r.file(o)
        index = r.integer(o, "shape_index", 0)
        data = r.once((path, index), lambda: reader(path, index))
        flipped = r.boolean(o, "flip_tex_coords", flip_v)
        flat = r.boolean(o, "face_normals", data.face_normals)
        r.ignore(o, "max_smooth_angle")
        return [_mesh(r, o, data, path.stem, flip_v=flipped, flat=flat)]

    return make


def _mesh(r: Reader, o: Object, data: MeshData, name: str, *, flip_v: bool, flat: bool) -> Mesh:
    matrix = r.matrix(o)
    _invertible(o, matrix)
    vertices = _points(matrix, np.asarray(data.vertices, np.float64))
    if not np.isfinite(vertices).all():
        bad = int(np.argmax(~np.isfinite(vertices).all(axis=1)))
        raise o.error(f"vertex {bad} of {name!r} is not finite")
    faces, uvs = data.faces, data.uvs
    normals: Floats | None = None
    if not flat:
        if data.normals is None:
            normals = smooth_normals(vertices, faces)
        else:
            normals = _normals(matrix, np.asarray(data.normals, np.float64))
            lost = ~np.isfinite(normals).all(axis=1)
            if lost.any():
                normals[lost] = smooth_normals(vertices, faces)[lost]
            faces = turned(vertices, faces, normals)
    if uvs is not None and flip_v:
        uvs = np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1)
    return Mesh(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.uint32),
        normals=None if normals is None else normals.astype(np.float32),
        uvs=None if uvs is None else np.asarray(uvs, np.float32),
        attributes=data.attributes,
        inside_out=r.boolean(o, "flip_normals", False),
        **_common(r, o, name),
    )


def _flat_mesh(r: Reader, o: Object, vertices: Array, faces: Any, uvs: Array, name: str) -> Mesh:
    """A mesh of flat faces whose front stays outside under any transform."""
    matrix = r.matrix(o)
    mirrored = _determinant(_invertible(o, matrix)) < 0.0
    turned = np.asarray(faces, np.uint32)[:, [0, 2, 1] if mirrored else [0, 1, 2]]
    return Mesh(
        vertices=_points(matrix, vertices),
        faces=turned,
        uvs=uvs,
        inside_out=r.boolean(o, "flip_normals", False),
        **_common(r, o, name),
    )


def _rectangle(r: Reader, o: Object) -> Sequence[Shape]:
    uvs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    vertices = np.column_stack([2.0 * uvs - 1.0, np.zeros(4)])
    return [_flat_mesh(r, o, vertices, [[0, 1, 2], [2, 3, 0]], uvs, "rectangle")]


# Directions in which u and v grow on each face of Mitsuba's cube; the normal is v x u
_CUBE = np.array(
    [
        [[0, 0, 1], [1, 0, 0]],
        [[-1, 0, 0], [0, 0, -1]],
        [[0, 1, 0], [0, 0, -1]],
        [[0, 1, 0], [1, 0, 0]],
        [[0, 1, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0]],
    ],
    np.float64,
)


def _cube(r: Reader, o: Object) -> Sequence[Shape]:
    corners = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    normal = np.cross(_CUBE[:, 1], _CUBE[:, 0])
    vertices = normal[:, None] + np.einsum("ck,fki->fci", 2.0 * corners - 1.0, _CUBE)
    first = 4 * np.arange(6)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [3, 0, 2]])).reshape(-1, 3)
    return [_flat_mesh(r, o, vertices.reshape(-1, 3), faces, np.tile(corners, (6, 1)), "cube")]


def _sdf_grid(r: Reader, o: Object) -> Sequence[Shape]:
    """A mesh of the surface, whose normals are Mitsuba's "smooth" ones; its uv is 0 everywhere."""
    path = r.file(o)
    data = r.once((path, 0), lambda: levelset.surface(levelset.read_vol(path)))
    if not len(data.faces):
        r.report(f"{o}: nothing in {path.name!r} is inside; ignored")
    r.ignore(o, "normals", "watertight")
    return [_mesh(r, o, data, path.stem, flip_v=False, flat=False)] if len(data.faces) else ()


# Basic shapes

# Mitsuba's v is 0 at a sphere's +z pole, ours at -z
_DOWN = np.array([1.0, 1.0, -1.0])


def _sphere(r: Reader, o: Object) -> Sequence[Shape]:
    radius = r.number(o, "radius", 1.0)
    if not radius > 0.0:
        raise o.error(f"radius is {radius:g}; must be above 0")
    matrix = r.matrix(o).copy()
    matrix[:3, 3] += matrix[:3, :3] @ r.vector(o, "center", (0.0, 0.0, 0.0))
    matrix[:3, :3] *= radius
    linear = _invertible(o, matrix)
    determinant = _determinant(linear)
    flipped = r.boolean(o, "flip_normals", False) != (determinant < 0.0)
    common = _common(r, o, "sphere")
    if _perpendicular(linear, 0, 1, 2) and _equal(linear, 0, 1, 2):
        size = abs(determinant) ** (1.0 / 3.0)
        rotation = linear / _lengths(linear, 0, 1, 2) * _DOWN
        return [Spheres(matrix[None, :3, 3], size, rotation=rotation, inside_out=flipped, **common)]
    unit = Spheres(np.zeros((1, 3)), 1.0, rotation=np.diag(_DOWN), inside_out=flipped, **common)
    return [Instances((unit,), matrix[None], common["name"])]


def _disk(r: Reader, o: Object) -> Sequence[Shape]:
    matrix = r.matrix(o)
    linear = _invertible(o, matrix)
    flip = r.boolean(o, "flip_normals", False)
    common = _common(r, o, "disk")
    if _perpendicular(linear, 0, 1):
        mirrored = _determinant(linear) < 0.0
        axes = (linear[None, :, 0], linear[None, :, 1])
        return [Disks(matrix[None, :3, 3], *axes, inside_out=flip != mirrored, **common)]
    unit = Disks(np.zeros((1, 3)), np.eye(3)[[0]], np.eye(3)[[1]], inside_out=flip, **common)
    return [Instances((unit,), matrix[None], common["name"])]


def _cylinder(r: Reader, o: Object) -> Sequence[Shape]:
    radius = r.number(o, "radius", 1.0)
    start = np.array(r.vector(o, "p0", (0.0, 0.0, 0.0)))
    axis = np.array(r.vector(o, "p1", (0.0, 0.0, 1.0))) - start
    length = float(np.linalg.norm(axis))
    if not (radius > 0.0 and length > 0.0):
        raise o.error(f"radius {radius:g} and length {length:g} must be above 0")
    own = np.eye(4)
    own[:3, :3] = _frame(axis / length) * (radius, radius, length)
    own[:3, 3] = start
    matrix = r.matrix(o) @ own
    linear = _invertible(o, matrix)
    flip = r.boolean(o, "flip_normals", False)
    common = _common(r, o, "cylinder")
    whole = _perpendicular(linear, 0, 1, 2) and _equal(linear, 0, 1)
    if whole and _determinant(linear) > 0.0:
        size = np.linalg.norm(linear[:, 0])
        begin = matrix[None, :3, 3]
        end = begin + linear[None, :, 2]
        return [Cylinders(begin, end, size, linear[None, :, 0] / size, inside_out=flip, **common)]
    x, _, z = np.eye(3)[:, None]
    unit = Cylinders(np.zeros((1, 3)), z, 1.0, x, inside_out=flip, **common)
    return [Instances((unit,), matrix[None], common["name"])]


def _frame(z: Array) -> Matrix:
    """Columns x, y, z: T. Duff et al., "Building an orthonormal basis, revisited", JCGT 6(1)."""
    sign = np.copysign(1.0, z[2])
    a = -1.0 / (sign + z[2])
    b = z[0] * z[1] * a
    x = (1.0 + sign * z[0] * z[0] * a, sign * b, -sign * z[0])
    return np.stack([x, (b, sign + z[1] * z[1] * a, -z[1]), z], axis=1)


def _curves(basis: str, fewest: int) -> Callable[[Reader, Object], Sequence[Shape]]:
    def make(r: Reader, o: Object) -> Sequence[Shape]:
        """Lines of x, y, z and radius; an empty line begins another strand."""
        path = r.file(o)
        lines = path.read_bytes().replace(b"\r", b"").split(b"\n")
        full = np.array([bool(line.strip()) for line in lines])
        try:
            numbers = parse(b"\n".join(lines))
        except ValueError as error:
            raise o.error(f"{path}: holds {error}") from None
        if len(numbers) != 4 * full.sum() or not len(numbers):
            raise o.error(f"{path}: every line needs 4 numbers: x, y, z and radius")
        strand = np.cumsum(~full)[full]
        counts = np.unique(strand, return_counts=True)[1]
        if counts.min() < fewest:
            at = int(np.argmin(counts))
            raise o.error(f"{path}: strand {at} has {counts[at]} points; needs {fewest} or more")
        points = numbers.reshape(-1, 4)
        matrix = r.matrix(o)
        _invertible(o, matrix)
        return [
            Curves(
                points=_points(matrix, points[:, :3]),
                radii=points[:, 3],  # which Mitsuba does not scale
                counts=counts,
                basis=basis,
                capped=False,
                **_common(r, o, path.stem),
            )
        ]

    return make


# Groups


def _inside(r: Reader, o: Object) -> Sequence[Shape]:
    return [shape for inner in r.nested(o, "shape") for shape in read(r, inner)]


def _group(r: Reader, o: Object) -> Sequence[Shape]:
    found = _inside(r, o)
    # an ellipsoid in a group would be an instance in an instance
    for shape in found:
        if isinstance(shape, Instances):
            r.report(f"{o}: {shape.name!r}, scaled unevenly, is not supported in a group; left out")
    return found


def _instance(r: Reader, o: Object) -> Sequence[Shape]:
    groups = [inner for inner in r.nested(o, "shape") if inner.type == "shapegroup"]
    if len(groups) != 1:
        raise o.error(f"has {len(groups)} shapegroups in it; needs 1")
    matrix = r.matrix(o)
    _invertible(o, matrix)
    if r.group is None:
        r.groups.setdefault(id(groups[0]), (groups[0], []))[1].append(matrix)
    else:
        r.inner.setdefault(r.group, []).append((groups[0], matrix))
    return ()


_GROUPS: dict[str, Callable[[Reader, Object], Sequence[Shape]]] = {"shapegroup": _group}

SHAPES: dict[str, Callable[[Reader, Object], Sequence[Shape]]] = {
    "obj": _file_mesh(lambda path, _: obj.read(path), flip_v=True),
    "ply": _file_mesh(lambda path, _: ply.read(path), flip_v=False),
    "serialized": _file_mesh(serialized.read, flip_v=False),
    "rectangle": _rectangle,
    "cube": _cube,
    "sdfgrid": _sdf_grid,
    "sphere": _sphere,
    "disk": _disk,
    "cylinder": _cylinder,
    "linearcurve": _curves("linear", 2),
    "bsplinecurve": _curves("bspline", 4),
    "instance": _instance,
    "merge": _inside,
}
