"""Files of a single mesh without materials: PLY, STL and OFF; also PLY files of points.

A mesh without normals is shaded smoothly where its faces meet at less than 40 degrees, and has an
edge where they meet more sharply. Colours of vertices or faces are shown. Points are particles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import particles
from ..errors import FormatError, SceneError, option, unknown_name
from ..scene import ColorBar, Material, Mesh, Scene, Texture
from ..studio import axis, framing
from . import COMPRESSED, LoadOptions
from .files import Reports
from .meshes import MeshData, split_at_creases

NAME = "mesh"
OPTIONS = ("up", *particles.OPTIONS)
BARE = True
GROUND = (Mesh,)

# Attributes that are shown; of both, the first
_COLORS = ("vertex_color", "face_color")
# Steeper edges stay sharp, degrees
_CREASE = 40.0
# What is made for printers stands on the xy plane.
_UP = {".stl": "z"}
_POINTS_UP = "z"  # as of all particles


def load(path: Path, options: LoadOptions) -> Scene:
    """The file as a scene. Raises FormatError."""
    suffixes = [s.lower() for s in path.suffixes]
    if suffixes[-1] in COMPRESSED:
        packed = suffixes.pop()
        if packed != ".gz":
            raise FormatError(f"{path}: of packed meshes only .gz is read, not {packed}")
    kind = suffixes[-1]
    reader = import_module(f".meshes.{kind[1:]}", __package__)
    with np.errstate(all="ignore"):  # what is not finite is looked for, and named
        data = reader.read(path, points=True) if kind == ".ply" else reader.read(path)
        finite(path, data)
        reports = Reports(path, options.strict)
        for text in data.left_out:
            reports.add(text)
        kept = _fields(data, reports) if len(data.faces) else []
        reports.tell()
        if not len(data.faces):
            return _points(path, data, options)
        try:
            mesh = shaded(colored(data, options), path.stem, keep=kept)
            legend = legend_of(data, options)
        except SceneError as error:
            raise FormatError(f"{path}: {error}") from None
    up = axis(options.up or _UP.get(kind, "y"))
    return Scene([mesh], camera=framing(up), background=None, name=path.name, legend=legend)


def save(scene: Scene, path: Path, reports: Reports) -> None:
    """Writes a PLY file: docs/meshes.md. Raises SceneError, ResourceError."""
    from .meshes import ply_writing

    ply_writing.save(scene, path, reports)


def finite(path: Path, data: MeshData) -> None:
    """Raises FormatError for a vertex that is not finite."""
    broken = ~np.isfinite(np.asarray(data.vertices)).all(axis=1)
    if broken.any():
        raise FormatError(f"{path}: vertex {int(np.argmax(broken))} is not finite")


def colored(data: MeshData, options: LoadOptions) -> MeshData:
    """The mesh in the colours of the field that the user names, of its vertices or faces.

    Raises SceneError for a field that it does not have, and for options that are for particles.
    """
    for name in particles.OPTIONS:
        if name in ("color_by", "colormap", "color_range"):
            continue
        if getattr(options, name) != getattr(LoadOptions(), name):
            raise SceneError(f"the option {option(name)!r} is for particles; this is a mesh")
    if options.color_by is None:
        return data
    key, values = numbers_of(data.attributes, options.color_by)
    colors = particles.map_colors(values, options.colormap, options.color_range)
    others = {k: v for k, v in data.attributes.items() if k not in _COLORS}
    return replace(data, attributes=others | {f"{key.partition('_')[0]}_color": colors})


def legend_of(data: MeshData, options: LoadOptions) -> ColorBar | None:
    """What the colours stand for that colored() gives the mesh. Raises SceneError as it does."""
    if options.color_by is None:
        return None
    values = numbers_of(data.attributes, options.color_by)[1]
    limits = particles.color_range(values, options.color_range)
    return ColorBar(options.color_by, options.colormap, *limits)


def numbers_of(attributes: Mapping[str, Any], name: str) -> tuple[str, NDArray[np.float64]]:
    """The attribute that a field is, and its numbers, of vectors their lengths.

    Raises SceneError for a field that is none of them.
    """
    # the fields' names, and where they are: "vertex_" or "face_"
    known = {key.partition("_")[2]: key for key in attributes}
    if name not in known:
        raise SceneError(unknown_name("field to colour by", name, known))
    values = np.asarray(attributes[known[name]], np.float64)
    return known[name], np.linalg.norm(values, axis=1) if values.ndim == 2 else values


def _fields(data: MeshData, reports: Reports) -> list[str]:
    """Attributes other than colours, without those that a mesh cannot have, which are told."""
    names = [name for name in data.attributes if name not in _COLORS]
    broken = [name for name in names if not np.isfinite(data.attributes[name]).all()]
    for name in broken:
        place, _, field = name.partition("_")
        reports.add(f"{field!r} of {place!r}: not finite everywhere; left out")
    return [name for name in names if name not in broken]


def shaded(data: MeshData, name: str, material: Any = None, keep: Sequence[str] = ()) -> Mesh:
    """The mesh with normals, and its colours as the material's, unless another is given.

    keep: what else of its attributes the mesh gets.
    """
    color = next((k for k in _COLORS if k in data.attributes), None)
    if material is None:
        material = Material("diffuse")
        if color is not None:
            material = Material("diffuse", color=Texture("attribute", name=color))
    if data.normals is None:
        data = _with_normals(data)
    return Mesh(
        data.vertices,
        data.faces,
        normals=data.normals,
        uvs=data.uvs,
        material=material,
        attributes={k: data.attributes[k] for k in ([color] if color else []) + list(keep)},
        name=name,
    )


def _with_normals(data: MeshData) -> MeshData:
    faces, old, normals = split_at_creases(data.vertices, data.faces, _CREASE)
    return replace(
        data,
        vertices=np.asarray(data.vertices)[old],
        faces=faces,
        normals=normals,
        uvs=None if data.uvs is None else data.uvs[old],
        attributes={
            key: values[old] if key.startswith("vertex_") else values
            for key, values in data.attributes.items()
        },
    )


def _points(path: Path, data: MeshData, options: LoadOptions) -> Scene:
    """Vertices as particles: their colours, radii (radius) and further numbers, if there are."""
    fields = {k.removeprefix("vertex_"): np.asarray(v) for k, v in data.attributes.items()}
    colors, radii = fields.pop("color", None), fields.pop("radius", None)
    if colors is not None:
        colors = np.clip(colors, 0.0, 1.0)
    try:
        found = particles.Particles(
            np.asarray(data.vertices), radii=radii, colors=colors, fields=fields
        )
        scene = particles.to_scene(found, options, path.name)
    except SceneError as error:
        raise FormatError(f"{path}: {error}") from None
    return scene.replace(camera=framing(axis(options.up or _POINTS_UP)))
