"""What is in a scene, counted: for `parhelion info`, as plain dicts and lists."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from .flatten import NONE, Flat, flatten
from .framing import bounds, placed
from .scene import Camera, Instances, Mesh, Scene, Shape
from .tables import tables

# Primitives from which on no tree is built for its statistics: it takes seconds a million.
MOST_FOR_A_TREE = 2_000_000
# Bytes of the film a pixel (core/film.h)
FILM_BYTES = 56

_PRIMITIVES = {"Mesh": "triangles", "Curves": "segments"}


def contents(scene: Scene) -> dict[str, Any]:
    """What docs/reference.md lists under `info --json`, but for what is known of the file alone.

    Raises SceneError for a scene that cannot be rendered; numbers of a large one are not checked.
    """
    from . import _core

    flat = flatten(scene)
    groups = flat.parts["groups"]
    stored = sum(s["count"] for group in groups for s in group if s["kind"] != "instance")
    tree = None
    lights = None
    if stored <= MOST_FOR_A_TREE:
        start = time.perf_counter()
        stats = _core.Scene(flat.parts).stats()
        lights = stats["lights"]
        tree = {
            "nodes": stats["nodes"],
            "leaves": stats["leaves"],
            "bytes": stats["bytes"],
            "seconds": time.perf_counter() - start,
        }
    names = _unique(flat.material_names)
    users: list[dict[str, None]] = [{} for _ in names]
    shapes = [
        _shape(shape, record, flat, names, users, shape_name)
        for shape, record, shape_name in zip(
            scene.shapes, groups[-1], flat.object_names, strict=True
        )
    ]
    low, high = bounds(scene)
    settings = scene.settings
    framed = not isinstance(scene.camera, Camera)
    materials, images = _materials(flat, names, users)
    return {
        "name": scene.name,
        "bounds": _box(low, high),
        "primitives": stored,
        "shown": sum(s["shown"] for s in shapes),
        "shapes": shapes,
        "materials": materials,
        "textures": len(flat.parts["textures"]),
        "images": images,
        "lights": [{"type": light.type} for light in scene.lights],
        "emitters": lights,
        "background": None if scene.background is None else scene.background.type,
        "camera": {"framed": framed, **asdict(placed(scene, settings.width / settings.height))},
        "settings": asdict(settings),
        "tree": tree,
        "film": settings.width * settings.height * FILM_BYTES,
        "hash": flat.sha256(),
    }


def _unique(names: list[str]) -> list[str]:
    """Names of which further ones of a name have a number."""
    counts: dict[str, int] = {}
    made = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        made.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return made


def _box(low: Any, high: Any) -> list[list[float]] | None:
    if not np.all(np.isfinite(np.subtract(high, low))):
        return None
    return [np.asarray(corner, np.float64).tolist() for corner in (low, high)]


def _shape(
    shape: Shape,
    record: Mapping[str, Any],
    flat: Flat,
    names: list[str],
    users: list[dict[str, None]],
    name: str,
) -> dict[str, Any]:
    kind = type(shape).__name__
    box = _box(*bounds(Scene([shape])))
    found: dict[str, Any] = {"type": kind.lower(), "name": name, "count": record["count"]}
    if isinstance(shape, Instances):
        group = flat.parts["groups"][record["group"]]
        parts = [
            _shape(part, inner, flat, names, users, inner["name"])
            for part, inner in zip(shape.shapes, group, strict=True)
        ]
        shown = record["count"] * sum(part["shown"] for part in parts)
        return found | {"shown": shown, "bounds": box, "shapes": parts}
    used = [record["material"]]
    if "material_of" in record:
        used = np.unique(record["material_of"]).tolist()
    for index in used:
        users[index][name] = None
    found |= {
        "unit": _PRIMITIVES.get(kind, kind.lower()),
        "shown": record["count"],
        "bounds": box,
        "materials": [names[i] for i in used],
        "colors": shape.colors is not None,
    }
    if isinstance(shape, Mesh):
        found |= {
            "vertices": len(record["vertices"]),
            "normals": shape.normals is not None,
            "uvs": shape.uvs is not None,
            "tangents": shape.tangents is not None,
            "attributes": list(shape.attributes),
        }
    return found


def _materials(
    flat: Flat, names: list[str], users: list[dict[str, None]]
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The materials, and the images of materials and lights."""
    types = list(tables()["materials"])
    images_of: dict[int, dict[str, None]] = {}
    made = []
    for index, record in enumerate(flat.parts["materials"]):
        kind = "blend" if "blend_first" in record else types[record["block"][0]]
        textures = []
        for parameter, texture in _bindings(record, kind):
            own = dict.fromkeys(_images(flat, texture))
            for image in own:
                images_of.setdefault(image, {})[names[index]] = None
            textures.append(
                {
                    "parameter": parameter,
                    "type": _type(flat, texture),
                    "images": [flat.parts["images"][i]["name"] for i in own],
                }
            )
        parts = [record.get(k) for k in ("blend_first", "blend_second")]
        if record["back"] not in (index, NONE):
            parts.append(record["back"])
        for part in parts:
            if part is not None:
                users[part][f"material {names[index]}"] = None
        made.append({"name": names[index], "type": kind, "textures": textures})
    for material, used in zip(made, users, strict=True):
        material["used_by"] = list(used)
    for light in flat.parts["lights"]:
        if "image" in light:
            images_of.setdefault(light["image"], {})[light["name"]] = None
    images = []
    for i, image in enumerate(flat.parts["images"]):
        height, width, channels = image["pixels"].shape
        images.append(
            {
                "name": image["name"],
                "width": width,
                "height": height,
                "channels": channels,
                "type": image["pixels"].dtype.name,
                "bytes": image["pixels"].nbytes,
                "used_by": list(images_of.get(i, ())),
            }
        )
    return made, images


def _type(flat: Flat, texture: int) -> str:
    names = list(tables()["textures"])
    index: int = flat.parts["textures"][texture]["block"][0]
    return names[index]


def _bindings(record: Mapping[str, Any], kind: str) -> Iterator[tuple[str, int]]:
    """The parameters of a material that are textures."""
    places = {}
    if kind != "blend":
        at = 0
        for param in tables()["materials"][kind].params:
            places[at] = param.name
            at += param.size
    for binding in record["bindings"]:
        yield places[binding["offset"]], binding["texture"]
    for key in ("emission_texture", "opacity_texture", "blend_texture", "normal_map", "bump_map"):
        if key in record:
            yield key.removesuffix("_texture").replace("blend", "weight"), record[key]["texture"]


def _images(flat: Flat, texture: int) -> Iterator[int]:
    """The images of a texture and of those that it is made of."""
    record = flat.parts["textures"][texture]
    if "image" in record:
        yield record["image"]
    for binding in record["bindings"]:
        yield from _images(flat, binding["texture"])
