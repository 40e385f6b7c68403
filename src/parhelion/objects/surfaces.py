"""Objects of pyvista, meshio and trimesh, and others with vertices and faces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from .. import particles
from ..errors import SceneError
from ..io.meshes import MeshData
from ..particles import Particles
from ..scene import Material, Texture
from .arrays import fields_of, floats, numbers
from .parts import Lines, Part, Points, Surface

WHITE = (1.0, 1.0, 1.0)


# --- pyvista -------------------------------------------------------------------------------------


def pyvista_blocks(thing: Any) -> Iterator[Part]:
    """A MultiBlock, blocks of blocks too; those that are empty hold nothing."""
    for k in range(thing.n_blocks):
        block = thing[k]
        if hasattr(block, "n_blocks"):
            yield from pyvista_blocks(block)
        elif block is not None and block.n_points:
            yield from pyvista_parts(block, str(thing.get_block_name(k) or f"block {k}"))


def pyvista_parts(thing: Any, name: str) -> Iterator[Part]:
    """The faces, lines and vertices of a data set, of a grid those of its surface; of points that
    none of these refers to, the points.
    """
    grid = hasattr(thing, "extract_surface") and not hasattr(thing, "faces")
    if grid and not (hasattr(thing, "n_cells") and thing.n_cells == 0):
        try:
            thing = thing.extract_surface(algorithm=None)
        except TypeError:  # before version 0.47
            thing = thing.extract_surface()
    points = floats(thing.points)
    fields, cells = _table(thing, "point_data"), _table(thing, "cell_data")
    chains, lengths = _cells(getattr(thing, "lines", ()))
    dots, clusters = _cells(getattr(thing, "verts", ()))
    corners, vertices, of_vertices, of_faces = _faces(thing)
    if len(corners):
        attributes = numbers("vertex", of_vertices, len(vertices))
        rgb = _rgb(of_vertices)
        if rgb is not None:
            attributes["vertex_color"] = rgb
        # those of faces come last
        last = {name: values[-len(corners) :] for name, values in of_faces.items()}
        attributes |= numbers("face", last, len(corners))
        yield Surface(MeshData(vertices, corners, attributes=attributes), name)
    if len(chains):
        along = {key: values[chains] for key, values in fields.items()}
        attributes = numbers("vertex", along, len(chains))
        # those of lines come between those of vertices and those of faces
        own = slice(len(clusters), len(clusters) + len(lengths))
        between = {key: values[own] for key, values in cells.items()}
        attributes |= numbers("face", between, len(lengths))
        yield Lines(points[chains], lengths, name, attributes)
    chosen: Any = dots if len(corners) or len(chains) else slice(None)
    if chosen is not dots or len(dots):
        own_fields = {key: values[chosen] for key, values in fields.items()}
        found = fields_of(own_fields, len(points[chosen]))
        yield Points(Particles(points[chosen], colors=_rgb(own_fields), fields=found), name)


def _table(thing: Any, name: str) -> dict[str, Any]:
    data = getattr(thing, name, {})
    return {str(key): np.asarray(data[key]) for key in data.keys()}  # noqa: SIM118


def _rgb(fields: dict[str, Any]) -> Any:
    """Colours of points by the names that VTK's readers of PLY and others give these, or None."""
    for name in ("RGB", "RGBA"):
        values = fields.get(name)
        if values is not None and values.dtype == np.uint8 and values.shape[1:] == (len(name),):
            return particles.linear(values[:, :3])
    return None


def _faces(thing: Any) -> tuple[Any, Any, dict[str, Any], dict[str, Any]]:
    """(F, 3) corners, the vertices they refer to, and what is known of these and of all cells, of
    which the faces are the last.
    """
    corners, sizes = _cells(getattr(thing, "faces", ()))
    strips = len(getattr(thing, "strips", ()))
    if strips or (sizes != 3).any():
        thing = thing.triangulate()
        corners, _ = _cells(thing.faces)
    if not len(corners):
        return np.empty((0, 3), np.int64), np.empty((0, 3)), {}, {}
    fields, cells = _table(thing, "point_data"), _table(thing, "cell_data")
    return corners.reshape(-1, 3), floats(thing.points), fields, cells


def _cells(padded: Any) -> tuple[Any, Any]:
    """The points of all cells, and how many each has, of an array with that number before them."""
    array = np.asarray(padded, np.intp).ravel()
    size = int(array[0]) if len(array) else 0
    if len(array) % (size + 1) == 0:
        rows = array.reshape(-1, size + 1)
        if (rows[:, 0] == size).all():  # as most are
            return rows[:, 1:].ravel(), rows[:, 0]
    heads = [0]
    while heads[-1] + 1 + array[heads[-1]] < len(array):
        heads.append(heads[-1] + 1 + int(array[heads[-1]]))
    return np.delete(array, heads), array[heads]


# --- meshio --------------------------------------------------------------------------------------


def meshio_parts(thing: Any, name: str) -> Iterator[Part]:
    """Triangles and quadrilaterals of a mesh."""
    triangles = [np.empty((0, 3), np.int64)]
    for block in thing.cells:
        if block.type.startswith("triangle"):
            triangles.append(np.asarray(block.data, np.int64)[:, :3])
        elif block.type.startswith("quad"):
            quads = np.asarray(block.data, np.int64)
            triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    faces, points = np.concatenate(triangles), _three(floats(thing.points))
    if not len(faces):
        kinds = ", ".join(sorted({block.type for block in thing.cells})) or "nothing"
        raise SceneError(f"the mesh has no triangles or quadrilaterals; it has {kinds}")
    attributes = numbers("vertex", dict(getattr(thing, "point_data", {})), len(points))
    yield Surface(MeshData(points, faces, attributes=attributes), name)


def _three(points: Any) -> Any:
    """Points of a plane in space."""
    return np.pad(points, ((0, 0), (0, 1))) if points.shape[1:] == (2,) else points


# --- trimesh, and anything with vertices and faces -----------------------------------------------


def trimesh_scene(thing: Any) -> Iterator[Part]:
    """The meshes, paths and clouds of a scene, where they are in it."""
    for geometry in thing.dump():
        name = str(getattr(geometry, "metadata", {}).get("name") or type(geometry).__name__)
        if hasattr(geometry, "faces"):
            if len(geometry.faces):
                yield from mesh_parts(geometry, name)
        elif hasattr(geometry, "entities"):
            yield from trimesh_path(geometry, name)
        elif len(geometry.vertices):
            yield from trimesh_cloud(geometry, name)


def trimesh_path(thing: Any, name: str) -> Iterator[Part]:
    """A Path3D, or a Path2D in the plane z = 0: its lines and arcs, as chains of lines."""
    chains = [np.asarray(entity.discrete(thing.vertices)) for entity in thing.entities]
    colors = [getattr(entity, "color", None) for entity in thing.entities]
    kept = [k for k, chain in enumerate(chains) if len(chain) > 1]
    if not kept:
        return
    tints = None
    if any(colors[k] is not None for k in kept):
        tints = np.array([WHITE if colors[k] is None else _linear(colors[k]) for k in kept])
    points = _three(floats(np.concatenate([chains[k] for k in kept])))
    yield Lines(points, np.array([len(chains[k]) for k in kept]), name, colors=tints)


def trimesh_cloud(thing: Any, name: str) -> Iterator[Part]:
    """A PointCloud with its colours."""
    points, colors = floats(thing.vertices), np.asarray(thing.colors)
    tints = None
    if colors.shape[:1] == (len(points),) and colors.shape[1:] in ((3,), (4,)):
        tints = particles.linear(colors[:, :3].astype(np.uint8))
    yield Points(Particles(points, colors=tints), name)


def mesh_parts(thing: Any, name: str) -> Iterator[Part]:
    """Anything with (V, 3) vertices and (F, 3) faces."""
    vertices = floats(thing.vertices)
    try:
        faces = np.asarray(thing.faces)
    except (TypeError, ValueError):
        raise SceneError(
            f"{name}: faces are no (F, 3) indices: not all are of one length"
        ) from None
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise SceneError(f"vertices have shape {vertices.shape}, not (V, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise SceneError(f"faces are {faces.dtype} of shape {faces.shape}, not (F, 3) indices")
    if not len(faces):
        return
    visual = getattr(thing, "visual", None)
    attributes = numbers("vertex", dict(getattr(thing, "vertex_attributes", {})), len(vertices))
    attributes |= numbers("face", dict(getattr(thing, "face_attributes", {})), len(faces))
    kind = getattr(visual, "kind", None)
    if kind in ("vertex", "face"):  # trimesh's
        colors = np.asarray(getattr(visual, f"{kind}_colors"))[:, :3]
        attributes[f"{kind}_color"] = particles.linear(colors.astype(np.uint8))
    data = MeshData(vertices, faces.astype(np.int64), attributes=attributes)
    if visual is None or kind != "texture":
        yield Surface(data, name)
        return
    uvs = None if visual.uv is None else floats(visual.uv)
    if uvs is not None and uvs.shape != (len(vertices), 2):
        raise SceneError(f"uvs have shape {uvs.shape}, not ({len(vertices)}, 2)")
    yield Surface(replace(data, uvs=uvs), name, _material(visual.material, uvs is not None))


def _material(given: Any, mapped: bool) -> Material:
    """Trimesh's PBRMaterial, which is glTF's, or SimpleMaterial, of which the colour is taken.

    mapped: there are texture coordinates, so that pictures can be.
    """
    if not hasattr(given, "baseColorTexture"):
        image = _picture(getattr(given, "image", None), mapped)
        if image is not None:
            return Material("principled", color=Texture("image", image=image, color_space="srgb"))
        color = getattr(given, "main_color", None)  # 8-bit sRGB
        return Material("principled", **({} if color is None else {"color": _linear(color)}))
    # What is left out is as glTF has it. Factors of colours are linear there, and trimesh keeps
    # them as they are, in 8 bits.
    base = _picture(given.baseColorTexture, mapped)
    factor = given.baseColorFactor
    r, g, b, alpha = (1.0,) * 4 if factor is None else (float(x) / 255.0 for x in factor)
    params: dict[str, Any] = {"color": _times((r, g, b), base, "srgb")}
    both = _picture(given.metallicRoughnessTexture, mapped)
    for name, value, channel in (
        ("metallic", given.metallicFactor, "b"),
        ("roughness", given.roughnessFactor, "g"),
    ):
        share = 1.0 if value is None else min(max(float(value), 0.0), 1.0)
        params[name] = share
        if both is not None and share > 0.0:
            params[name] = _times((share,) * 3, both, "linear", channel)
    bumps = _picture(given.normalTexture, mapped)
    if bumps is not None:
        params["normal_map"] = Texture("image", image=bumps, color_space="linear")
    glow = (0.0,) * 3 if given.emissiveFactor is None else _triple(given.emissiveFactor)
    if max(glow) > 0.0:
        params["emission"] = _times(glow, _picture(given.emissiveTexture, mapped), "srgb")
        if given.doubleSided:
            params["two_sided_emission"] = True
    opacity = _opacity(given, alpha, mapped)
    if opacity != 1.0:
        params["opacity"] = opacity
    return Material("principled", **params)


def _opacity(given: Any, alpha: float, mapped: bool) -> Any:
    """A number or a picture, by the material's alphaMode."""
    if given.alphaMode not in ("BLEND", "MASK"):
        return 1.0
    image, shares = given.baseColorTexture, None
    if mapped and image is not None and ("A" in image.getbands() or "transparency" in image.info):
        shares = np.asarray(image.convert("RGBA"))[:, :, 3:]
    if given.alphaMode == "MASK":
        cutoff = 0.5 if given.alphaCutoff is None else float(given.alphaCutoff)
        if shares is None:
            return 1.0 if alpha >= cutoff else 0.0
        shares = np.where(alpha / 255.0 * shares >= cutoff, 255, 0).astype(np.uint8)
        alpha = 1.0
    return _times((alpha,) * 3, shares, "linear", "r")


def _picture(image: Any, mapped: bool) -> Any:
    """(H, W, 3) of 8 bits, of a PIL image; None of none, or where it has no place."""
    return np.asarray(image.convert("RGB")) if image is not None and mapped else None


def _times(factor: Any, image: Any, color_space: str, channel: str = "rgb") -> Any:
    """A picture times a factor, or the factor alone; one number of a channel."""
    if image is None:
        return factor if channel == "rgb" else factor[0]
    texture = Texture("image", image=image, color_space=color_space, channel=channel)
    if factor == (1.0, 1.0, 1.0):
        return texture
    return Texture("multiply", color0=texture, color1=factor)


def _linear(color: Any) -> tuple[float, float, float]:
    """Of 8-bit sRGB, as trimesh has colours."""
    return _triple(particles.linear(np.asarray(color, np.uint8)[:3]))


def _triple(values: Any) -> tuple[float, float, float]:
    red, green, blue = (float(v) for v in values)
    return red, green, blue
