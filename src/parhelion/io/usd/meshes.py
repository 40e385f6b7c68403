"""Mesh prims: polygons, subdivision surfaces, and parts of them with materials of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdLux, UsdShade, UsdSkel, Vt

from ... import subdivision
from ...errors import SceneError
from ...scene import Mesh
from ..meshes import triangulate
from . import materials, primvars

if TYPE_CHECKING:
    from .reader import Group, Matrix, Reader

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SCHEMES = ("catmullClark", "loop", "bilinear")
# Triangles of a scene that subdivision makes
_MOST_SUBDIVIDED = 1 << 22


@dataclass(eq=False)
class Polygons:
    """points (V, 3); counts (P,) corners of each polygon and their vertices, corners (C,).

    vertex, corner: values by name, (V, K) or (C, K). normals: (C, 3), or None for flat faces.
    part: (P,) number of the part that each polygon belongs to.
    """

    points: Floats
    counts: Integers
    corners: Integers
    vertex: dict[str, Floats]
    corner: dict[str, Floats]
    normals: Floats | None
    part: Integers


def mesh(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    """Adds a Mesh prim, one shape for each of its materials."""
    source = UsdGeom.Mesh(prim)
    points = r.array(prim, source.GetPointsAttr(), 3)
    counts = r.integers(source.GetFaceVertexCountsAttr())
    corners = r.integers(source.GetFaceVertexIndicesAttr())
    if points is None or not len(points) or not len(counts):
        return
    _check(r, prim, points, counts, corners)
    if prim.HasAPI(UsdLux.LightAPI):
        r.report(f"light meshes, such as {prim.GetPath()}: not supported; they do not shine")
    if prim.HasAPI(UsdSkel.BindingAPI):
        r.report(f"skinned meshes, such as {prim.GetPath()}: not supported; they are at rest")
    part, names, looks = _parts(r, prim, len(counts))
    p = _with_primvars(r, prim, Polygons(points, counts, corners, {}, {}, None, part), looks)
    shown = np.ones(len(counts), bool)
    holes = r.integers(source.GetHoleIndicesAttr())
    shown[holes[(holes >= 0) & (holes < len(counts))]] = False
    scheme = str(r.get(source.GetSubdivisionSchemeAttr(), "none"))
    inverted = r.get(source.GetOrientationAttr()) == "leftHanded"
    if scheme == "none":
        p = _with_normals(r, prim, p)
        p = _chosen(p, shown & (counts >= 3))
    else:
        p = _subdivided(r, prim, p, shown, scheme, inverted)
    add(group, matrix, p, list(zip(names, looks, strict=True)), inverted)


def _check(r: Reader, prim: Any, points: Floats, counts: Integers, corners: Integers) -> None:
    """Raises FormatError for faces that have no meaning."""
    if counts.min() < 0:
        at = int(np.argmin(counts))
        raise r.error(prim, f"faceVertexCounts[{at}] is {counts[at]}")
    if counts.sum() != len(corners):
        raise r.error(
            prim,
            f"faceVertexCounts add up to {counts.sum()}; faceVertexIndices has {len(corners)}",
        )
    bad = (corners < 0) | (corners >= len(points))
    if bad.any():
        at = int(np.argmax(bad))
        face = int(np.searchsorted(np.cumsum(counts), at, side="right"))
        raise r.error(
            prim, f"face {face} refers to vertex {corners[at]}; there are {len(points)}, from 0"
        )


# --- Materials and primvars ----------------------------------------------------------------------


def _parts(r: Reader, prim: Any, faces: int) -> tuple[Integers, list[str], list[materials.Look]]:
    """The part of each face; each part's name and look. Part 0 is what is in no subset."""
    double = bool(r.get(UsdGeom.Gprim(prim).GetDoubleSidedAttr(), False))
    part = np.zeros(faces, np.int64)
    names, looks = [str(prim.GetPath())], [materials.look(r, prim, double)]
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        if subset.GetElementTypeAttr().Get() != "face":
            continue
        indices = r.integers(subset.GetIndicesAttr())
        bad = (indices < 0) | (indices >= faces)
        if bad.any():
            at = int(np.argmax(bad))
            raise r.error(
                subset.GetPrim(), f"indices[{at}] is {indices[at]}; the mesh has {faces} faces"
            )
        part[indices] = len(names)
        names.append(str(subset.GetPath()))
        looks.append(materials.look(r, subset.GetPrim(), double))
    return part, names, looks


def _with_primvars(r: Reader, prim: Any, p: Polygons, looks: list[materials.Look]) -> Polygons:
    """The values that the materials read, by the primvar's name."""
    vertices, faces = len(p.points), len(p.counts)
    sizes = {
        "constant": 1, "uniform": faces, "vertex": vertices, "varying": vertices,
        "faceVarying": len(p.corners),
    }  # fmt: skip
    needs = {name: need for look in looks for name, need in look.needs.items()}
    for name, need in needs.items():
        found = primvars.read(r, prim, name, sizes, need.width)
        if found is None:
            p.vertex[name] = np.tile(np.array(need.fallback, np.float64), (vertices, 1))
        elif found.interpolation == "constant":
            p.vertex[name] = np.repeat(found.values, vertices, axis=0)
        elif found.interpolation == "uniform":
            p.corner[name] = np.repeat(found.values, p.counts, axis=0)
        elif found.interpolation == "faceVarying":
            p.corner[name] = found.values
        else:
            p.vertex[name] = found.values
    return p


def _with_normals(r: Reader, prim: Any, p: Polygons) -> Polygons:
    """primvars:normals, else normals; a polygon mesh without them is flat."""
    source = UsdGeom.Mesh(prim)
    vertices, faces = len(p.points), len(p.counts)
    sizes = {
        "constant": 1, "uniform": faces, "vertex": vertices, "varying": vertices,
        "faceVarying": len(p.corners),
    }  # fmt: skip
    found = primvars.read(r, prim, "normals", sizes, 3)
    if found is None:
        values = r.array(prim, source.GetNormalsAttr(), 3)
        interpolation = str(source.GetNormalsInterpolation())
        if values is None or not len(values):
            return p
        if len(values) != sizes.get(interpolation):
            r.report(
                f"normals of {prim.GetPath()}: {len(values)} values ({interpolation}) do not fit;"
                " ignored"
            )
            return p
        found = primvars.Primvar(values, interpolation)
    if found.interpolation == "faceVarying":
        p.normals = found.values
    elif found.interpolation in ("vertex", "varying"):
        p.normals = found.values[p.corners]
    # one normal a face or for all is that of a flat face
    return p


# --- Faces ---------------------------------------------------------------------------------------


def _chosen(p: Polygons, shown: NDArray[np.bool_]) -> Polygons:
    """Some of the polygons."""
    if shown.all():
        return p
    corner = np.repeat(shown, p.counts)
    return Polygons(
        p.points,
        p.counts[shown],
        p.corners[corner],
        p.vertex,
        {name: values[corner] for name, values in p.corner.items()},
        None if p.normals is None else p.normals[corner],
        p.part[shown],
    )


def _subdivided(
    r: Reader, prim: Any, p: Polygons, shown: NDArray[np.bool_], scheme: str, inverted: bool
) -> Polygons:
    """The limit surface, as fine as subdivision.levels and the scene's budget say."""
    source = UsdGeom.Mesh(prim)
    if scheme not in _SCHEMES:
        raise SceneError(f"subdivisionScheme is {scheme!r}; must be none, {', '.join(_SCHEMES)}")
    smooth_rule = r.get(source.GetTriangleSubdivisionRuleAttr()) == "smooth"
    if smooth_rule and scheme == "catmullClark":  # which alone has a rule for triangles
        r.report(
            "triangleSubdivisionRule 'smooth': not supported; triangles are subdivided as other"
            " polygons are"
        )
    boundary = r.get(source.GetInterpolateBoundaryAttr(), "edgeAndCorner")
    whole = p.counts >= 3
    shown, p = shown[whole], _chosen(p, whole)
    if not len(p.counts):
        return p
    if boundary == "none":  # faces at the border only shape those within
        shown = shown & ~_at_border(p)
    ends, sharpness = _creases(r, prim, source, len(p.points))
    tips = r.integers(source.GetCornerIndicesAttr())
    tip_sharpness = r.array(prim, source.GetCornerSharpnessesAttr())
    if tip_sharpness is None or len(tip_sharpness) != len(tips):
        tips, tip_sharpness = tips[:0], np.zeros(0)
    inside = (tips >= 0) & (tips < len(p.points))
    smooth, by_corner = list(p.vertex), list(p.corner)
    refined = subdivision.subdivide(
        p.points,
        p.counts,
        p.corners,
        levels=r.budget.levels(_triangles(scheme, p.counts), subdivision.levels(len(p.counts)), 1),
        scheme=scheme,
        creases=ends,
        sharpness=sharpness,
        corner_vertices=tips[inside],
        corner_sharpness=tip_sharpness[inside],
        sharp_boundary_corners=boundary == "edgeAndCorner",
        smooth=np.concatenate([p.vertex[n] for n in smooth], axis=1) if smooth else None,
        corner=np.concatenate([p.corner[n] for n in by_corner], axis=1) if by_corner else None,
    )
    faces, size = refined.faces.shape
    made = Polygons(
        refined.points,
        np.full(faces, size),
        refined.faces.ravel(),
        _columns(refined.smooth, p.vertex),
        _columns(refined.corner.reshape(faces * size, -1) if by_corner else None, p.corner),
        refined.normals.reshape(-1, 3) * (-1.0 if inverted else 1.0),
        p.part[refined.parent],
    )
    return _chosen(made, shown[refined.parent])


def budget(stage: Any, time: Any) -> subdivision.Budget:
    """What the stage's subdivision surfaces share; prototypes count once."""
    known = []
    roots = [stage.GetPseudoRoot(), *stage.GetPrototypes()]
    for prim in chain.from_iterable(Usd.PrimRange(root) for root in roots):
        if str(prim.GetTypeName()) != "Mesh":
            continue
        source = UsdGeom.Mesh(prim)
        scheme = str(source.GetSubdivisionSchemeAttr().Get(time))
        value = source.GetFaceVertexCountsAttr().Get(time)
        # of another type, it is an error where the mesh is shown
        if scheme in _SCHEMES and isinstance(value, Vt.IntArray) and len(value):
            counts = np.array(value, np.int64)
            known.append((_triangles(scheme, counts), subdivision.levels(len(counts))))
    return subdivision.Budget(_MOST_SUBDIVIDED, known)


def _triangles(scheme: str, counts: Integers) -> int:
    """As many as make those of the surface if each level makes four of one."""
    # a polygon of n corners becomes n quadrangles first
    return len(counts) if scheme == "loop" else max(int(counts.sum()), 0) // 2


def _columns(values: Floats | None, like: dict[str, Floats]) -> dict[str, Floats]:
    """The named parts of values that were put side by side."""
    found, at = {}, 0
    for name, old in like.items():
        assert values is not None
        found[name] = values[:, at : at + old.shape[1]]
        at += old.shape[1]
    return found


def _at_border(p: Polygons) -> NDArray[np.bool_]:
    """Faces with a vertex on an edge that has no second face."""
    last = np.cumsum(p.counts) - 1
    after = np.roll(p.corners, -1)
    after[last] = p.corners[last - p.counts + 1]
    key = np.minimum(p.corners, after) * len(p.points) + np.maximum(p.corners, after)
    _, index, uses = np.unique(key, return_inverse=True, return_counts=True)
    open_edge = uses[index.reshape(-1)] == 1
    border = np.zeros(len(p.points), bool)
    border[p.corners[open_edge]] = border[after[open_edge]] = True
    face = np.repeat(np.arange(len(p.counts)), p.counts)
    return np.bincount(face, border[p.corners], minlength=len(p.counts)) > 0


def _creases(r: Reader, prim: Any, source: Any, vertices: int) -> tuple[Integers, Floats]:
    """Sharp edges (E, 2) and how sharp each is; creases are chains of them."""
    chain = r.integers(source.GetCreaseIndicesAttr())
    lengths = r.integers(source.GetCreaseLengthsAttr())
    values = r.array(prim, source.GetCreaseSharpnessesAttr())
    if not len(chain):
        return np.zeros((0, 2), np.int64), np.zeros(0)
    edges = lengths - 1
    if values is None or lengths.min(initial=2) < 2 or lengths.sum() != len(chain):
        raise r.error(prim, "creaseLengths must be 2 or more, and add up to creaseIndices")
    if len(values) == len(lengths):
        values = np.repeat(values, edges)
    if len(values) != edges.sum():
        raise r.error(prim, f"{len(values)} creaseSharpnesses for {len(lengths)} creases")
    if chain.min() < 0 or chain.max() >= vertices:
        raise r.error(prim, f"creaseIndices refer to vertices beyond the {vertices} there are")
    begins = np.ones(len(chain), bool)
    begins[np.cumsum(lengths) - 1] = False
    start = np.flatnonzero(begins)
    return np.stack([chain[start], chain[start + 1]], axis=1), values


# --- Triangles -----------------------------------------------------------------------------------


def add(
    group: Group,
    matrix: Matrix,
    p: Polygons,
    parts: list[tuple[str, materials.Look]],
    inverted: bool = False,
) -> None:
    """Adds the triangles of polygons, moved by the matrix, one Mesh for each part of them."""
    if not len(p.counts):
        return
    places = np.arange(len(p.corners))
    triangles, polygon = triangulate("polygons", p.counts, places, p.points[p.corners])
    # a mirrored surface keeps its outside
    if inverted != bool(np.linalg.det(matrix[:3, :3]) < 0.0):
        triangles = triangles[:, [0, 2, 1]]
    points = p.points @ matrix[:3, :3].T + matrix[:3, 3]
    normals = None
    if p.normals is not None:
        normals = p.normals @ np.linalg.pinv(matrix[:3, :3])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0.0, length, 1.0)
        normals[length[:, 0] == 0.0] = (0.0, 0.0, 1.0)
    part = p.part[polygon]
    for number, (name, look) in enumerate(parts):
        chosen = triangles if len(parts) == 1 else triangles[part == number]
        if not len(chosen):
            continue
        corner = {n: p.corner[n] for n in look.needs if n in p.corner}
        columns = [*corner.values()] + ([] if normals is None else [normals])
        faces, first = _shared(chosen, p.corners, columns)
        old = p.corners[first]
        values = {n: v[first] for n, v in corner.items()}
        values |= {n: p.vertex[n][old] for n in look.needs if n in p.vertex}
        uvs = values.pop(look.uvs) if look.uvs else None
        group.shapes.append(
            Mesh(
                points[old].astype(np.float32),
                faces.astype(np.uint32),
                normals=None if normals is None else normals[first].astype(np.float32),
                uvs=None if uvs is None else uvs.astype(np.float32),
                material=look.material,
                attributes={f"vertex_{n}": v.astype(np.float32) for n, v in values.items()},
                name=name,
            )
        )


def _shared(
    triangles: Integers, vertices: Integers, columns: list[Floats]
) -> tuple[Integers, Integers]:
    """Faces over new vertices, which corners share that have the same vertex and values.

    triangles (F, 3): corners. Returns the faces and, of each new vertex, a corner.
    """
    used, place = np.unique(triangles, return_inverse=True)
    vertex = vertices[used]
    values = np.zeros((len(used), 0), np.float32)
    if columns:
        values = np.concatenate([v.reshape(len(v), -1) for v in columns], axis=1)[used]
        values = values.astype(np.float32)
    # sorting all values would take most of the time; few differ from the first of their vertex
    first = np.zeros(len(vertex) and vertex.max() + 1, np.int64)
    first[vertex[::-1]] = np.arange(len(vertex))[::-1]
    other = np.flatnonzero((values != values[first[vertex]]).any(axis=1))
    code = vertex[other]
    for column in values[other].T:
        kinds, index = np.unique(column, return_inverse=True)
        code = np.unique(code * len(kinds) + index.reshape(-1), return_inverse=True)[1].reshape(-1)
    whole = vertex.copy()
    whole[other] = len(first) + code
    _, corner, index = np.unique(whole, return_index=True, return_inverse=True)
    return index.reshape(-1)[place].reshape(-1, 3), used[corner]


SHAPES: dict[str, Callable[[Reader, Any, Matrix, Group], None]] = {"Mesh": mesh}
