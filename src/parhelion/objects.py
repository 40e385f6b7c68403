"""Objects of other libraries as scenes: told by what they have, so that none of them is imported.

Known are Parhelion's own scenes and shapes, paths, NumPy arrays of positions, ASE's Atoms,
MDAnalysis' Universe and AtomGroup, pyvista's and VTK-like data sets, trimesh's meshes and scenes,
and anything with vertices and faces. A new kind is one function and one line in KINDS.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np

from . import particles
from .errors import SceneError
from .io import LoadOptions, check_options, load
from .io.mesh_file import colored, legend_of, shaded
from .io.meshes import MeshData, check_indices
from .particles import Labels, Particles, element_labels
from .particles.boxes import Box
from .scene import (
    Curves,
    Cylinders,
    Disks,
    Instances,
    Material,
    Mesh,
    Scene,
    Shape,
    Spheres,
    Texture,
)
from .studio import axis, dressed, framing

_SHAPES = (Spheres, Mesh, Disks, Cylinders, Curves, Instances)
# Whose shapes stand on a ground where there is no light; particles float.
_STANDING = (Mesh,)
# Up in the meshes of simulations and CAD, unless told otherwise
_MESH_UP = "z"


def scene_of(thing: Any, **options: Any) -> Scene:
    """The scene that an object is, with a view, light and a ground as files get them.

    thing: a Scene, a path, (N, 3) positions, a shape or a list of shapes of this package, or an
    object of ASE, MDAnalysis, pyvista, trimesh, meshio and the like. options: fields of
    LoadOptions, such as color_by, radius, view, ground.

    Raises SceneError for an object of none of these kinds, and for one that makes no scene.
    """
    try:
        chosen = LoadOptions(**options)
    except TypeError as error:
        raise SceneError(f"options of a scene: {error}") from None
    if isinstance(thing, (str, PathLike)):
        return load(thing, chosen)
    if isinstance(thing, Scene) and not options:
        return thing
    for known, make, taken in KINDS:
        if known(thing):
            check_options(chosen, taken, f"objects of type {_named(thing)}")
            scene, bare = make(thing, chosen)
            break
    else:
        kind = type(thing)
        raise SceneError(
            f"an object of type {kind.__module__}.{kind.__qualname__} cannot be rendered (choices:"
            " a Scene or shapes, a path, (N, 3) positions, objects of ASE, MDAnalysis, pyvista,"
            " trimesh or meshio, anything with vertices and faces)"
        )
    return dressed(
        scene,
        view=chosen.view,
        environment=chosen.environment,
        ground=chosen.ground,
        bare=bare,
        standing=_STANDING,
    )


_Made = tuple[Scene, bool]


def _has(*names: str) -> Callable[[Any], bool]:
    return lambda thing: all(hasattr(thing, name) for name in names)


def _named(thing: Any) -> str:
    return type(thing).__name__


def _cloud(found: Particles, options: LoadOptions, name: str) -> _Made:
    scene = particles.to_scene(found, options, name)
    if options.up is not None:
        scene = scene.replace(camera=framing(axis(options.up)))
    return scene, True


def _surface(
    data: MeshData, options: LoadOptions, thing: Any, material: Material | None = None
) -> _Made:
    check_indices(_named(thing), data.faces, len(data.vertices))
    mesh = shaded(colored(data, options), _named(thing), material)
    camera = framing(axis(options.up or _MESH_UP))
    legend = legend_of(data, options)
    scene = Scene([mesh], camera=camera, background=None, name=_named(thing), legend=legend)
    return scene, True


def _own_scene(thing: Scene, _: LoadOptions) -> _Made:
    return thing, False


def _own_shapes(thing: Any, options: LoadOptions) -> _Made:
    shapes: Sequence[Shape] = [thing] if isinstance(thing, _SHAPES) else list(thing)
    camera = framing(axis(options.up or "y"))
    return Scene(shapes, camera=camera, background=None, name="shapes"), True


def _array(thing: Any, options: LoadOptions) -> _Made:
    return _cloud(Particles(_floats(thing)), options, "positions")


def _ase(thing: Any, options: LoadOptions) -> _Made:
    cell = np.asarray(thing.get_cell()[:], np.float64)
    x, y, z = (bool(flag) for flag in thing.get_pbc())
    box = Box(cell, np.zeros(3), (x, y, z)) if cell.any() else None
    found = Particles(
        _floats(thing.get_positions()),
        elements=Labels.of(thing.get_chemical_symbols()),
        fields=_fields(dict(thing.arrays), len(thing), ("numbers", "positions")),
        box=box,
        bonds=_bonds_in_words(thing.arrays.get("bonds")),
    )
    return _cloud(found, options, "atoms")


def _bonds_in_words(words: Any) -> Any:
    """The bonds that ASE's reader of LAMMPS data files leaves: of each atom the indices of others
    and the types of bonds, "5(1),7(2)", or "_"; None where there are none.
    """
    if words is None or np.asarray(words).dtype.kind != "U":
        return None
    found = [
        (i, int(other))
        for i, word in enumerate(np.asarray(words).tolist())
        for other in re.findall(r"(\d{1,18})\(", word)
    ]
    return np.array(found, np.int64).reshape(-1, 2)


def _mdanalysis(thing: Any, options: LoadOptions) -> _Made:
    atoms = thing.atoms
    elements = None
    for attribute in ("elements", "names", "types"):
        values = getattr(atoms, attribute, None)
        if values is not None and elements is None:
            elements = element_labels(Labels.of(np.asarray(values).astype(str)))
    fields = {
        name: getattr(atoms, name)
        for name in ("charges", "masses", "resids", "resnames", "segids", "tempfactors")
        if hasattr(atoms, name)
    }
    names = getattr(atoms, "names", None)
    found = Particles(
        _floats(atoms.positions),
        elements=elements,
        types=None if names is None else Labels.of(np.asarray(names).astype(str)),
        fields=_fields(fields, len(atoms)),
        box=_triclinic(getattr(atoms, "dimensions", None)),
        bonds=_bonds_within(atoms),
    )
    return _cloud(found, options, "atoms")


def _triclinic(dimensions: Any) -> Box | None:
    """The box of three edges and the angles between them in degrees, as MDAnalysis has it: a along
    x, b in the xy plane.
    """
    if dimensions is None or not np.any(dimensions[:3]):
        return None
    a, b, c, *angles = np.asarray(dimensions, np.float64)
    alpha, beta, gamma = np.cos(np.radians(angles))
    sine = np.sqrt(1 - gamma**2)
    y = (alpha - beta * gamma) / sine
    z = np.sqrt(max(0.0, 1 - beta**2 - y**2))
    vectors = [[a, 0, 0], [b * gamma, b * sine, 0], [c * beta, c * y, c * z]]
    return Box(np.array(vectors), np.zeros(3))


def _bonds_within(atoms: Any) -> Any:
    """The bonds of MDAnalysis' atoms, of which both ends are among them, by their places; or None.

    A topology without bonds raises an AttributeError.
    """
    bonds = getattr(atoms, "bonds", None)
    if bonds is None or not len(bonds):
        return None
    pairs = np.asarray(bonds.indices if hasattr(bonds, "indices") else bonds)
    own = np.asarray(atoms.indices)
    places = np.full(max(int(own.max()), int(pairs.max())) + 1, -1)
    places[own] = np.arange(len(own))
    pairs = places[pairs]
    return pairs[(pairs >= 0).all(axis=1)]


def _pyvista(thing: Any, options: LoadOptions) -> _Made:
    if hasattr(thing, "extract_surface") and not hasattr(thing, "faces"):  # a grid
        try:
            thing = thing.extract_surface(algorithm=None)
        except TypeError:  # before version 0.47
            thing = thing.extract_surface()
    data, points = thing, _floats(thing.points)
    faces = np.empty((0, 3), np.int64)
    if hasattr(data, "triangulate") and len(getattr(data, "faces", ())):
        data = data.triangulate()
        points = _floats(data.points)
        faces = np.asarray(data.faces, np.int64).reshape(-1, 4)[:, 1:]
    fields = {str(name): data.point_data[name] for name in data.point_data.keys()}  # noqa: SIM118
    if not len(faces):
        return _cloud(Particles(points, fields=_fields(fields, len(points))), options, "points")
    attributes = _numbers("vertex", fields, len(points))
    if hasattr(data, "cell_data"):
        cells = {str(name): data.cell_data[name] for name in data.cell_data.keys()}  # noqa: SIM118
        attributes |= _numbers("face", cells, len(faces))
    return _surface(MeshData(points, faces, attributes=attributes), options, thing)


def _meshio(thing: Any, options: LoadOptions) -> _Made:
    triangles = [np.empty((0, 3), np.int64)]
    for block in thing.cells:
        if block.type.startswith("triangle"):
            triangles.append(np.asarray(block.data, np.int64)[:, :3])
        elif block.type.startswith("quad"):
            quads = np.asarray(block.data, np.int64)
            triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    faces, points = np.concatenate(triangles), _floats(thing.points)
    if points.shape[1:] == (2,):
        points = np.pad(points, ((0, 0), (0, 1)))
    if not len(faces):
        kinds = ", ".join(sorted({block.type for block in thing.cells})) or "nothing"
        raise SceneError(f"the mesh has no triangles or quadrilaterals; it has {kinds}")
    attributes = _numbers("vertex", dict(getattr(thing, "point_data", {})), len(points))
    return _surface(MeshData(points, faces, attributes=attributes), options, thing)


def _trimesh_scene(thing: Any, options: LoadOptions) -> _Made:
    shapes: list[Shape] = []
    for mesh in thing.dump():
        if hasattr(mesh, "faces"):
            shapes += _mesh(mesh, options)[0].shapes
    if not shapes:
        raise SceneError("the scene has no meshes")
    camera = framing(axis(options.up or _MESH_UP))
    return Scene(shapes, camera=camera, background=None, name="scene"), True


def _mesh(thing: Any, options: LoadOptions) -> _Made:
    vertices, faces = _floats(thing.vertices), np.asarray(thing.faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise SceneError(f"vertices have shape {vertices.shape}, not (V, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise SceneError(f"faces are {faces.dtype} of shape {faces.shape}, not (F, 3) indices")
    visual = getattr(thing, "visual", None)
    attributes = _numbers("vertex", dict(getattr(thing, "vertex_attributes", {})), len(vertices))
    attributes |= _numbers("face", dict(getattr(thing, "face_attributes", {})), len(faces))
    kind = getattr(visual, "kind", None)
    if kind in ("vertex", "face"):  # trimesh's
        colors = np.asarray(getattr(visual, f"{kind}_colors"))[:, :3]
        attributes[f"{kind}_color"] = particles.linear(colors.astype(np.uint8))
    data = MeshData(vertices, faces.astype(np.int64), attributes=attributes)
    if visual is None or kind != "texture" or options.color_by is not None:
        return _surface(data, options, thing)
    uvs = None if visual.uv is None else _floats(visual.uv)
    if uvs is not None and uvs.shape != (len(vertices), 2):
        raise SceneError(f"uvs have shape {uvs.shape}, not ({len(vertices)}, 2)")
    return _surface(replace(data, uvs=uvs), options, thing, _material(visual.material, uvs))


def _material(given: Any, uvs: Any) -> Material:
    """Trimesh's PBRMaterial or SimpleMaterial: its colours and numbers, and the picture of its
    colour; other pictures are told.
    """
    params: dict[str, Any] = {}
    pictures = [given.baseColorTexture] if hasattr(given, "baseColorTexture") else [given.image]
    factor = getattr(given, "main_color", None)  # 8-bit sRGB, as trimesh has them
    if factor is not None:
        params["color"] = _triple(particles.linear(np.asarray(factor, np.uint8)[:3]))
    if pictures[0] is not None and uvs is not None:
        image = np.asarray(pictures[0].convert("RGB"))
        params["color"] = Texture("image", image=image, color_space="srgb")
    for name, theirs in (("metallic", "metallicFactor"), ("roughness", "roughnessFactor")):
        value = getattr(given, theirs, None)
        if value is not None:
            params[name] = min(max(float(value), 0.0), 1.0)
    for name in ("metallicRoughnessTexture", "normalTexture", "emissiveTexture"):
        if getattr(given, name, None) is not None:
            logging.getLogger("parhelion").warning(
                "trimesh's %s is not supported here; load the file itself", name
            )
    return Material("principled", **params)


def _triple(values: Any) -> tuple[float, float, float]:
    red, green, blue = (float(v) for v in values)
    return red, green, blue


_POINTS = (*(name for name in particles.OPTIONS if name != "frame"), "up")
_FACES = ("color_by", "colormap", "color_range", "up")
# What an object is told by, what makes a scene of it, and the options that this reads; the first
# that fits counts.
KINDS: tuple[
    tuple[Callable[[Any], bool], Callable[[Any, LoadOptions], _Made], Sequence[str]], ...
] = (
    (lambda x: isinstance(x, Scene), _own_scene, ()),
    (lambda x: isinstance(x, _SHAPES), _own_shapes, ("up",)),
    (
        lambda x: isinstance(x, (list, tuple)) and len(x) > 0 and isinstance(x[0], _SHAPES),
        _own_shapes,
        ("up",),
    ),
    (_has("get_positions", "get_chemical_symbols"), _ase, _POINTS),
    (lambda x: hasattr(getattr(x, "atoms", None), "positions"), _mdanalysis, _POINTS),
    (_has("points", "point_data", "n_points"), _pyvista, (*_POINTS, *_FACES)),
    (_has("points", "cells", "cell_data"), _meshio, _FACES),
    (_has("geometry", "dump"), _trimesh_scene, _FACES),
    (_has("vertices", "faces"), _mesh, _FACES),
    (
        lambda x: isinstance(x, (np.ndarray, list, tuple)) or hasattr(x, "__array__"),
        _array,
        _POINTS,
    ),
)


def _numbers(of: str, found: dict[str, Any], count: int) -> dict[str, Any]:
    """Fields of numbers as attributes of a mesh's vertices or faces."""
    fields = _fields(found, count)
    return {f"{of}_{name}": x for name, x in fields.items() if not isinstance(x, Labels)}


def _floats(values: Any) -> Any:
    """As an array of single or double precision. Raises SceneError for anything else."""
    try:
        array = np.asarray(values)
        if array.dtype not in (np.float32, np.float64):
            array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise SceneError("positions must be (N, 3) numbers") from None
    return array


def _fields(found: dict[str, Any], count: int, without: Sequence[str] = ()) -> dict[str, Any]:
    """Those of numbers or words that there are `count` of."""
    fields: dict[str, Any] = {}
    for name, values in found.items():
        array = np.asarray(values)
        if name in without or array.ndim not in (1, 2) or len(array) != count:
            continue
        if array.dtype.kind in "iufb":
            fields[name] = array.astype(np.float32) if array.dtype.kind in "iub" else array
        elif array.ndim == 1:
            fields[name] = Labels.of(array.astype(str))
    return fields
