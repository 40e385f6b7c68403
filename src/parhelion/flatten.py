"""From a Scene to what the core takes: contiguous arrays and fixed-size parameter blocks.

Big arrays pass through uncopied where their type and layout already fit.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import arguments, tables
from .errors import SceneError, unknown_name
from .machine import cores_available
from .memory import require
from .scene import (
    Curves,
    Cylinders,
    Disks,
    Instances,
    Light,
    Material,
    Mesh,
    Scene,
    Source,
    Spheres,
    Texture,
)

# (index of the entry in its table, its parameters one after the other)
Block = tuple[int, list[float]]

NONE = 0xFFFFFFFF  # no texture, image or material

# Parameters that every material takes; scene.py says what they mean.
COMMON = {
    "emission", "two_sided_emission", "opacity", "normal_map", "normal_map_frame", "bump_map",
    "two_sided", "back", "priority", "absorption",
}  # fmt: skip

# The names of shapes that were given none
_UNNAMED = {kind.name for kind in (Spheres, Mesh, Disks, Cylinders, Curves, Instances)}

_NORMAL_FRAMES = ("uv", "right_handed")

_CHANNELS = {"luminance": 0, "rgb": 0, "r": 1, "g": 2, "b": 3, "a": 4}


@dataclass(frozen=True)
class Flat:
    """parts: what _core.Scene takes, a dict of lists of dicts; bindings/core.cpp reads them.

    shape_names, material_names: by the indices that features and statistics use. Where several have
    no name, that of their type is followed by a number: "mesh", "mesh 2". materials: what they were
    made of, by the same indices; the scene's named ones come first.
    """

    parts: dict[str, Any]
    shape_names: list[str]
    material_names: list[str]
    materials: list[Material]

    @property
    def object_names(self) -> list[str]:
        """The names of the scene's own shapes, which come last; what Instances copy is seen as
        them.
        """
        return self.shape_names[len(self.shape_names) - len(self.parts["groups"][-1]) :]

    def without(self, objects: Collection[int]) -> Flat:
        """The same without what some of the scene's own shapes are made of; all indices stay."""
        own = self.parts["groups"][-1]
        left = [_emptied(s) if i in objects else s for i, s in enumerate(own)]
        return replace(self, parts={**self.parts, "groups": [*self.parts["groups"][:-1], left]})

    def sha256(self) -> str:
        """Hash of everything that is seen: geometry, materials and lights, not the camera."""
        return self._sha256

    @cached_property
    def _sha256(self) -> str:
        h = hashlib.sha256(b"parhelion scene 2")

        def add(value: Any) -> None:
            if isinstance(value, np.ndarray):
                h.update(f"{value.dtype} {value.shape}".encode())
                h.update(np.ascontiguousarray(value).data)
            elif isinstance(value, Mapping):
                for key in sorted(value):
                    if key == "name" and isinstance(value[key], str):  # of a file, say: not seen
                        continue
                    h.update(repr(key).encode())
                    add(value[key])
            elif isinstance(value, (list, tuple)):
                h.update(f"[{len(value)}".encode())
                for item in value:
                    add(item)
            else:
                h.update(repr(value).encode())

        add(self.parts)
        return h.hexdigest()


def flatten(scene: Scene) -> Flat:
    """Raises SceneError for arrays that do not fit together and for unknown names."""
    arguments.instance("scene", scene, Scene)
    if scene.source is not None:
        arguments.instance("source", scene.source, Source)
    if not isinstance(scene.materials, Mapping):
        raise SceneError(f"materials: a dict is needed, not {type(scene.materials).__name__}")
    for what, values in (("shapes", scene.shapes), ("lights", scene.lights)):
        if not isinstance(values, Sequence):
            raise SceneError(f"{what}: a list is needed, not {type(values).__name__}")
    for name, named in scene.materials.items():
        if not isinstance(named, Material):
            raise SceneError(f"material {name!r}: a Material is needed, not {named!r}")
    if scene.background is not None and not isinstance(scene.background, Light):
        raise SceneError(f"background: a Background is needed, not {scene.background!r}")
    for i, light in enumerate(scene.lights):
        if not isinstance(light, Light):
            raise SceneError(f"lights[{i}]: a Light is needed, not {light!r}")

    parts = _Parts()
    for name in scene.materials:
        parts.materials.append({})  # its place: later ones may be its back or part of its blend
        parts.material_names.append(_text(name))
        parts.places.append(f"material {name!r}")
    named_count = len(parts.materials)
    parts.named = {name: i for i, name in enumerate(scene.materials)}
    own: list[dict[str, Any]] = []
    try:
        for name, named in scene.materials.items():
            parts.materials[parts.named[name]] = parts.material(named, f"material {name!r}", name)
        for shape in scene.shapes:
            if isinstance(shape, Instances):
                own.append(parts.instances(shape))
            else:
                own.append(parts.shape(shape))
    except RecursionError:
        raise SceneError("materials are made of materials too deeply") from None
    parts.check_parts()
    parts.groups.append(own)
    if scene.background is not None:
        parts.light(scene.background, "background", outside=True)
    for i, light in enumerate(scene.lights):
        parts.light(light, f"lights[{i}]")
    return Flat(
        {
            "groups": parts.groups,
            "materials": parts.materials,
            "textures": parts.textures,
            "images": parts.read_images(),
            "lights": parts.lights,
        },
        [s["name"] for group in parts.groups[:-1] for s in group]
        + _told_apart([s["name"] for s in own], [s["name"] in _UNNAMED for s in own]),
        _told_apart(parts.material_names, [i >= named_count for i in range(len(parts.materials))]),
        [*scene.materials.values(), *parts.unnamed],
    )


def _emptied(shape: dict[str, Any]) -> dict[str, Any]:
    """A shape's record without primitives."""
    by_vertex = {"vertices", "normals", "uvs", "tangents"} if "faces" in shape else set()
    count = shape["count"]
    empty = dict(shape, count=0)
    for key, value in shape.items():
        if (
            isinstance(value, np.ndarray)
            and key != "rotation"
            and key not in by_vertex
            and value.ndim
            and len(value) == count
        ):
            empty[key] = value[:0]
    if "attributes" in shape:
        empty["attributes"] = [
            dict(a, values=a["values"][:0]) if a["per_face"] else a for a in shape["attributes"]
        ]
    return empty


def block(kind: str, name: str, params: Mapping[str, Any], where: str) -> Block:
    """The parameter block of a material, texture or light, checked against its table."""
    values = tables.check(kind, name, params, where)
    return list(tables.tables()[kind]).index(name), [x for v in values.values() for x in v]


def _text(name: Any) -> str:
    """A name that can be written; one that comes from a file's may be no text."""
    return str(name).encode(errors="backslashreplace").decode()


def _told_apart(names: Sequence[str], unnamed: Sequence[bool]) -> list[str]:
    """Names of which the unnamed ones get a number where another has theirs: "mesh", "mesh 2"."""
    taken = {name for name, free in zip(names, unnamed, strict=True) if not free}
    counts: dict[str, int] = {}
    result = []
    for name, free in zip(names, unnamed, strict=True):
        chosen = name
        while free and chosen in taken:
            counts[name] = counts.get(name, 1) + 1
            chosen = f"{name} {counts[name]}"
        taken.add(chosen)
        result.append(chosen)
    return result


@dataclass
class _Parts:
    """What has been gathered so far."""

    groups: list[list[dict[str, Any]]] = field(default_factory=list)
    materials: list[dict[str, Any]] = field(default_factory=list)
    material_names: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)  # of materials, as error texts name them
    textures: list[dict[str, Any]] = field(default_factory=list)
    lights: list[dict[str, Any]] = field(default_factory=list)
    named: dict[str, int] = field(default_factory=dict)
    attributes: dict[str, int] = field(default_factory=dict)
    unnamed: dict[Material, int] = field(default_factory=dict)
    _textures_made: dict[Texture, int] = field(default_factory=dict)
    _images_made: dict[tuple[Any, ...], int] = field(default_factory=dict)
    _image_jobs: list[Callable[[], dict[str, Any]]] = field(default_factory=list)
    _encoded: list[Callable[[], int]] = field(default_factory=list)  # their sizes when read
    _groups_made: dict[int, int] = field(default_factory=dict)
    _kept: list[Any] = field(default_factory=list)  # so that no id() is given twice

    # --- Materials -------------------------------------------------------------------------------

    def material_index(self, material: Any, where: str) -> int:
        """Of a name or a Material."""
        if isinstance(material, str):
            if material not in self.named:
                raise SceneError(f"{where}: {unknown_name('material', material, self.named)}")
            return self.named[material]
        if not isinstance(material, Material):
            raise SceneError(f"{where}: a Material or its name is needed, not {material!r}")
        if material not in self.unnamed:
            index = len(self.materials)
            self.materials.append({})
            self.material_names.append(material.type)
            self.places.append(where)
            self.unnamed[material] = index
            self.materials[index] = self.material(material, where, None, index)
        return self.unnamed[material]

    def material(
        self, m: Material, where: str, name: str | None, index: int | None = None
    ) -> dict[str, Any]:
        """The record of a material; `name` or `index` is its own."""
        own = self.named[name] if name is not None else index
        params = dict(m.params)
        common = {key: params.pop(key) for key in COMMON & params.keys()}
        record: dict[str, Any] = {"bindings": []}
        uses_uv = False
        transmits = False
        if m.type == "blend":
            missing = {"a", "b"} - params.keys()
            extra = params.keys() - {"a", "b", "weight"}
            if missing or extra:
                word = sorted(missing or extra)[0]
                problem = "is missing" if missing else "is unknown"
                raise SceneError(
                    f"{where}: parameter {word!r} {problem} (choices: a, b, weight, and those of"
                    " every material)"
                )
            record["block"] = block("materials", "diffuse", {}, where)
            first = self.material_index(params["a"], f"{where}: a")
            second = self.material_index(params["b"], f"{where}: b")
            record["blend_first"], record["blend_second"] = first, second
            value, texture = self._number(params.get("weight", 0.5), 0.0, 1.0, f"{where}: weight")
            record["blend_weight"] = value
            if texture is not None:
                record["blend_texture"] = texture
            uses_uv = (
                any(self.materials[i].get("uses_uv", True) for i in (first, second))
                or texture is not None
            )
            transmits = True
        else:
            entry = tables.entry("materials", m.type, where)
            transmits = entry.transmits
            plain = {k: v for k, v in params.items() if not isinstance(v, Texture)}
            record["block"] = block("materials", m.type, plain, where)
            listed = {p.name for p in entry.params}
            for key in params:
                if key not in listed:
                    raise SceneError(f"{where}: {unknown_name('parameter', key, listed | COMMON)}")
            record["bindings"] = self.bindings(entry, params, where)
            uses_uv = bool(record["bindings"]) or bool(params.get("anisotropy"))
        emission = common.get("emission", (0.0, 0.0, 0.0))
        both = arguments.flag(
            f"{where}: two_sided_emission", common.get("two_sided_emission", False)
        )
        if m.type == "emissive" and record["bindings"]:
            # light that varies over a surface is of one kind, whatever the material
            if np.any(emission) or isinstance(emission, Texture):
                raise SceneError(f"{where}: has both a texture of radiance and emission")
            emission, both = params["radiance"], True
            record["block"] = block("materials", "emissive", {"radiance": (0.0,) * 3}, where)
            record["bindings"] = []
        if isinstance(emission, Texture):
            record["emission"] = (1.0, 1.0, 1.0)
            record["emission_texture"] = self.binding(emission, 3, 0, f"{where}: emission")
            uses_uv = True
        else:
            record["emission"] = _color(emission, f"{where}: emission")
        record["emits_back"] = both
        value, texture = self._number(common.get("opacity", 1.0), 0.0, 1.0, f"{where}: opacity")
        record["opacity"] = value
        if texture is not None:
            record["opacity_texture"] = texture
            uses_uv = True
        for key in ("normal_map", "bump_map"):
            if common.get(key) is not None:
                if not isinstance(common[key], Texture):
                    raise SceneError(f"{where}: {key} must be a Texture")
                record[key] = self.binding(common[key], 3, 0, f"{where}: {key}", data=True)
                uses_uv = True
        frame = common.get("normal_map_frame", "uv")
        if frame not in _NORMAL_FRAMES:
            raise SceneError(f"{where}: {unknown_name('normal_map_frame', frame, _NORMAL_FRAMES)}")
        record["normal_right_handed"] = frame == "right_handed"
        record["absorption"] = _color(common.get("absorption", (0.0,) * 3), f"{where}: absorption")
        priority = common.get("priority", 0)
        if isinstance(priority, bool) or not isinstance(priority, (int, np.integer)):
            raise SceneError(f"{where}: priority is {priority!r}; must be a whole number")
        if not 0 <= priority < 2**31:
            raise SceneError(f"{where}: priority is {priority}; must lie in [0, {2**31 - 1}]")
        record["priority"] = int(priority)
        back = common.get("back")
        if back is not None:
            record["back"] = self.material_index(back, f"{where}: back")
            uses_uv = uses_uv or bool(self.materials[record["back"]].get("uses_uv", True))
        elif arguments.flag(f"{where}: two_sided", common.get("two_sided", True)) or transmits:
            record["back"] = own
        else:
            record["back"] = NONE
        record["uses_uv"] = uses_uv
        return record

    def check_parts(self) -> None:
        """Light and holes are of a material as a whole, and no blend is made of itself.

        When all are made, as materials may name later ones. Raises SceneError.
        """
        kinds = list(tables.tables()["materials"])
        for index, m in enumerate(self.materials):
            parts = {"a": m.get("blend_first"), "b": m.get("blend_second")}
            if m["back"] not in (index, NONE):
                parts["back"] = m["back"]
            for key, part in parts.items():
                if part is None:
                    continue
                where = f"{self.places[index]}: {key}"
                other = self.materials[part]
                if any(other["emission"]) or kinds[other["block"][0]] == "emissive":
                    raise SceneError(f"{where} shines; give the emission to the whole material")
                if other["opacity"] < 1.0 or "opacity_texture" in other:
                    raise SceneError(f"{where} has holes; give the opacity to the whole material")
        # Blends all of whose parts are known to end, again and again, until no more are found
        ends = {i for i, m in enumerate(self.materials) if "blend_first" not in m}
        while True:
            more = {
                i
                for i, m in enumerate(self.materials)
                if i not in ends and {m["blend_first"], m["blend_second"]} <= ends
            }
            if not more:
                break
            ends |= more
        for i in range(len(self.materials)):
            if i not in ends:
                raise SceneError(f"{self.places[i]}: is a blend of itself, by way of its parts")

    def _number(
        self, value: Any, low: float, high: float, where: str
    ) -> tuple[float, dict[str, int] | None]:
        """A number, and the texture in its place, if there is one."""
        if isinstance(value, Texture):
            return 1.0, self.binding(value, 1, 0, where, limits=(low, high))
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = float("nan")
        if not low <= number <= high:
            raise SceneError(f"{where} is {value!r}; must lie in [{low:g}, {high:g}]")
        return number, None

    # --- Textures --------------------------------------------------------------------------------

    def binding(
        self,
        texture: Texture,
        size: int,
        offset: int,
        where: str,
        data: bool = False,
        limits: tuple[float, float] = (0.0, tables.LARGEST),
    ) -> dict[str, Any]:
        """A texture in the place of `size` numbers of a block, from `offset`. data: no colours.

        limits: what its values are cut to.
        """
        if not isinstance(texture, Texture):
            raise SceneError(f"{where}: a Texture is needed, not {texture!r}")
        _refuse_deep(texture, where)
        channel = texture.params.get("channel", "rgb")
        if not isinstance(channel, str) or channel not in _CHANNELS:
            raise SceneError(f"{where}: texture: {unknown_name('channel', channel, _CHANNELS)}")
        data = data or size == 1
        return {
            "texture": self.texture_index(texture, f"{where}: texture", data),
            "offset": offset,
            "size": size,
            "channel": _CHANNELS[channel],
            "low": limits[0],
            "high": min(limits[1], tables.LARGEST),
        }

    def bindings(
        self, entry: tables.Entry, params: Mapping[str, Any], where: str, data: bool = False
    ) -> list[dict[str, Any]]:
        """Of those parameters that are textures."""
        found: list[dict[str, Any]] = []
        offset = 0
        for p in entry.params:
            given = params.get(p.name)
            if isinstance(given, Texture):
                if p.choices or (entry.name, p.name) == ("attribute", "name"):
                    raise SceneError(f"{where}: parameter {p.name!r} cannot be a Texture")
                what = f"{where}: parameter {p.name!r}"
                limits = (p.low, p.high)
                found.append(self.binding(given, p.size, offset, what, data, limits))
            offset += p.size
        for key in params.keys() - {p.name for p in entry.params}:
            if isinstance(params[key], Texture):
                known = [p.name for p in entry.params]
                raise SceneError(f"{where}: {unknown_name('parameter', key, known)}")
        return found

    def texture_index(self, t: Texture, where: str, data: bool) -> int:
        # Which channel is taken is said where the texture is bound.
        others = {name: value for name, value in t.params.items() if name != "channel"}
        key = Texture(t.type, **others, __data=data)
        index = self._textures_made.get(key)
        if index is None:
            record = self._texture(t, where, data)  # those that it is made of come before it
            index = self._textures_made[key] = len(self.textures)
            self.textures.append(record)
            self._kept.append(t)
        return index

    def _texture(self, t: Texture, where: str, data: bool) -> dict[str, Any]:
        entry = tables.entry("textures", t.type, where)
        params = dict(t.params)
        common = {
            key: params.pop(key)
            for key in ("image", "color_space", "transform", "channel", "uvs")
            if key in params
        }
        made_of = {key: x for key, x in params.items() if isinstance(x, Texture)}
        for key in made_of:
            del params[key]
        if t.type == "attribute":
            name = params.pop("name", None)
            if not isinstance(name, str):
                raise SceneError(f"{where}: parameter 'name', the attribute's, is missing")
            params["name"] = self.attribute(name)
        record: dict[str, Any] = {"block": block("textures", t.type, params, where)}
        record["bindings"] = self.bindings(entry, made_of, where, data)
        if common.get("uvs") is not None:
            if not isinstance(common["uvs"], str):
                raise SceneError(f"{where}: uvs must be the name of an attribute of meshes")
            record["uvs"] = self.attribute(common["uvs"])
        matrix = np.eye(3)[:2]
        if common.get("transform") is not None:
            matrix = arguments.floats(f"{where}: transform", common["transform"])
            if matrix.shape not in ((2, 3), (3, 3)) or not np.all(np.isfinite(matrix)):
                raise SceneError(f"{where}: transform must be a finite (2, 3) or (3, 3) matrix")
        record["to_uv"] = matrix[:2].astype(np.float64).ravel().tolist()
        if entry.image:
            if common.get("image") is None:
                raise SceneError(f"{where}: parameter 'image' is missing")
            mip = record["block"][1][0] == 0.0 if t.type == "image" else False
            record["image"] = self.image_index(
                common["image"], common.get("color_space", "auto"), where, data, mip
            )
        elif common.get("image") is not None:
            raise SceneError(f"{where}: a texture of type {t.type!r} takes no image")
        return record

    def attribute(self, name: str) -> int:
        return self.attributes.setdefault(name, len(self.attributes))

    def image_index(
        self,
        image: Any,
        color_space: str,
        where: str,
        data: bool,
        mip: bool,
        radiance: bool = False,
    ) -> int:
        if color_space not in ("auto", "srgb", "linear"):
            choices = ("auto", "srgb", "linear")
            raise SceneError(f"{where}: {unknown_name('color_space', color_space, choices)}")
        from .image import is_encoded, picture_bytes, read_pixels

        path = isinstance(image, (str, os.PathLike))
        key = (os.fspath(image) if path else id(image), color_space, data, mip, radiance)
        if key not in self._images_made:
            self._kept.append(image)
            name = str(image) if path else getattr(image, "name", "image")

            if is_encoded(image):
                self._encoded.append(lambda: picture_bytes(image, where))

            def record() -> dict[str, Any]:
                what = f"{where}: image"
                stored = (
                    read_pixels(image, where) if is_encoded(image) else arguments.array(what, image)
                )
                pixels = _pixels(stored, what)
                if radiance and pixels.dtype == np.float32 and np.any(pixels < 0):
                    pixels = np.maximum(pixels, np.float32(0))  # as of filters that overshoot
                srgb = color_space == "srgb" or (
                    color_space == "auto" and not data and pixels.dtype == np.uint8
                )
                return {"name": name, "pixels": pixels, "srgb": srgb, "mip": mip}

            self._images_made[key] = len(self._image_jobs)
            self._image_jobs.append(record)
        return self._images_made[key]

    def read_images(self) -> list[dict[str, Any]]:
        """The records of all images, read by as many threads as may run at once.

        Raises what the first of those that cannot be read raises, and ResourceError for more than
        memory can hold.
        """
        if not self._image_jobs:
            return []
        count, size = len(self._encoded), sum(size() for size in self._encoded)
        what = f"{count} image{'s' * (count != 1)}"
        require(size, what, "images of fewer pixels take less")
        with ThreadPoolExecutor(cores_available()) as pool:
            return list(pool.map(lambda job: job(), self._image_jobs))

    # --- Lights ----------------------------------------------------------------------------------

    def light(self, light: Light, where: str, outside: bool = False) -> None:
        entry = tables.entry("lights", light.type, where)
        if outside and not entry.outside:
            choices = [e.name for e in tables.tables()["lights"].values() if e.outside]
            raise SceneError(f"{where}: {unknown_name('background type', light.type, choices)}")
        params = dict(light.params)
        common = {
            key: params.pop(key) for key in ("image", "color_space", "transform") if key in params
        }
        made = block("lights", light.type, params, where)
        checked = tables.check("lights", light.type, params, where)
        for key in ("up", "direction", "sun_direction"):
            if key in checked and not any(checked[key]):
                raise SceneError(f"{where}: parameter {key!r} is 0; it must have a direction")
        rotation, position = np.eye(3), np.zeros(3)
        if common.get("transform") is not None:
            matrix = arguments.floats(f"{where}: transform", common["transform"]).astype(np.float64)
            if matrix.shape not in ((3, 3), (3, 4), (4, 4)) or not np.all(np.isfinite(matrix)):
                raise SceneError(f"{where}: transform must be a finite (3, 3) or (4, 4) matrix")
            rotation = matrix[:3, :3]
            if matrix.shape[1] == 4:
                position = matrix[:3, 3]
            if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
                raise SceneError(f"{where}: transform must be a rotation and a translation")
        record = {
            "name": where,
            "block": made,
            "rotation": rotation.ravel().tolist(),
            "position": position.tolist(),
        }
        if entry.image:
            if common.get("image") is None:
                raise SceneError(f"{where}: parameter 'image' is missing")
            record["image"] = self.image_index(
                common["image"], common.get("color_space", "auto"), where, False, False, True
            )
        elif common.get("image") is not None:
            raise SceneError(f"{where}: a light of type {light.type!r} takes no image")
        self.lights.append(record)

    # --- Shapes ----------------------------------------------------------------------------------

    def shape(self, shape: Any) -> dict[str, Any]:
        makers: dict[type, Callable[[Any, str], dict[str, Any]]] = {
            Spheres: _spheres, Mesh: _mesh, Disks: _disks, Cylinders: _cylinders, Curves: _curves,
        }  # fmt: skip
        if type(shape) not in makers:
            names = ", ".join(t.__name__ for t in makers)
            raise SceneError(
                f"shapes: one of {names} and Instances is needed, not {type(shape).__name__}"
            )
        name = _text(shape.name)
        where = f"shape {name!r}"
        record: dict[str, Any] = makers[type(shape)](shape, where)
        record["name"] = name
        inside_out = getattr(shape, "inside_out", False)
        record["inside_out"] = arguments.flag(f"{where}: inside_out", inside_out)
        count = record["count"]
        if shape.colors is not None:
            record["colors"] = _colors(shape.colors, count, where)
        record["material"] = 0
        if isinstance(shape.material, (Material, str)):
            record["material"] = self.material_index(shape.material, where)
        else:
            record["material_of"] = _indices(shape.material, count, self.named, where)
        if isinstance(shape, Mesh) and not isinstance(shape.attributes, Mapping):
            kind = type(shape.attributes).__name__
            raise SceneError(f"{where}: attributes: a dict is needed, not {kind}")
        if isinstance(shape, Mesh) and shape.attributes:
            record["attributes"] = [
                self._attribute(key, values, count, len(record["vertices"]), where)
                for key, values in shape.attributes.items()
            ]
        return record

    def _attribute(
        self, key: str, values: Any, faces: int, vertices: int, where: str
    ) -> dict[str, Any]:
        what = f"{where}: attribute {key!r}"
        array = arguments.floats(what, values).astype(np.float32, copy=False)
        per_face = key.startswith("face_")
        if not per_face and not key.startswith("vertex_"):
            raise SceneError(f"{what}: its name must begin with 'vertex_' or 'face_'")
        rows = faces if per_face else vertices
        if array.shape not in ((rows,), (rows, 1), (rows, 2), (rows, 3)):
            raise SceneError(
                f"{what} has shape {array.shape}; must be ({rows},), ({rows}, 2) or ({rows}, 3),"
                f" one for each {'face' if per_face else 'vertex'}"
            )
        bad = np.argwhere(~np.isfinite(array))
        if bad.size:
            raise SceneError(f"{what}[{bad[0, 0]}] is not finite")
        return {
            "name": self.attribute(key),
            "values": np.ascontiguousarray(array),
            "components": 1 if array.ndim == 1 else array.shape[1],
            "per_face": per_face,
        }

    def instances(self, shape: Instances) -> dict[str, Any]:
        name = _text(shape.name)
        where = f"shape {name!r}"
        transforms = arguments.floats(f"{where}: transforms", shape.transforms).astype(np.float64)
        if transforms.size == 0:
            transforms = transforms.reshape(0, 3, 4)
        if transforms.ndim != 3 or transforms.shape[1:] not in ((3, 4), (4, 4)):
            raise SceneError(
                f"{where}: transforms has shape {transforms.shape}; must be (N, 3, 4) or (N, 4, 4)"
            )
        if transforms.shape[1] == 4 and not np.allclose(transforms[:, 3], (0, 0, 0, 1)):
            raise SceneError(f"{where}: transforms must be affine, with a last row 0 0 0 1")
        if id(shape.shapes) not in self._groups_made:  # Instances may share a group
            if not isinstance(shape.shapes, Sequence):
                kind = type(shape.shapes).__name__
                raise SceneError(f"{where}: shapes: a list is needed, not {kind}")
            shapes: list[dict[str, Any]] = []
            for part in shape.shapes:
                if isinstance(part, Instances):
                    raise SceneError(f"{where}: holds Instances itself; one level is possible")
                shapes.append(self.shape(part))
            self._groups_made[id(shape.shapes)] = len(self.groups)
            self.groups.append(shapes)
            self._kept.append(shape.shapes)
        group = self._groups_made[id(shape.shapes)]
        record = {
            "kind": "instance",
            "name": name,
            "count": len(transforms),
            "group": group,
            "transforms": np.ascontiguousarray(transforms[:, :3, :]),
        }
        if shape.colors is not None:
            record["colors"] = _colors(shape.colors, len(transforms), where)
        return record


def _colors(values: Any, count: int, where: str) -> NDArray[np.float32]:
    colors = arguments.floats(f"{where}: colors", values)
    with np.errstate(over="ignore"):  # the core names the one that became infinite
        colors = colors.astype(np.float32, copy=False)
    if colors.size == 0:
        colors = colors.reshape(0, 3)
    if colors.shape != (count, 3):
        raise SceneError(f"{where}: colors has shape {colors.shape}; must be ({count}, 3)")
    return np.asarray(colors)


# --- Each kind of shape --------------------------------------------------------------------------


def _spheres(shape: Spheres, where: str) -> dict[str, Any]:
    centers = _points(shape.centers, f"{where}: centers")
    record = {
        "kind": "sphere",
        "count": len(centers),
        "centers": centers,
        "radii": _radii(shape.radii, len(centers), "center", where),
    }
    if shape.rotation is not None:
        rotation = arguments.floats(f"{where}: rotation", shape.rotation).astype(np.float64)
        if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3):
            raise SceneError(f"{where}: rotation must be a (3, 3) rotation matrix")
        record["rotation"] = rotation.astype(np.float32).ravel()
    return record


def _mesh(shape: Mesh, where: str) -> dict[str, Any]:
    vertices = _points(shape.vertices, f"{where}: vertices")
    faces = arguments.array(f"{where}: faces", shape.faces)
    if faces.size == 0:
        faces = faces.reshape(0, 3).astype(np.uint32)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise SceneError(
            f"{where}: faces is {faces.dtype} of shape {faces.shape}; must be (F, 3) whole numbers"
        )
    if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
        face, corner = np.argwhere((faces < 0) | (faces >= len(vertices)))[0]
        raise SceneError(
            f"{where}: faces[{face}] has vertex {faces[face, corner]}; the mesh has vertices 0 to"
            f" {len(vertices) - 1}"
        )
    record = {
        "kind": "triangle",
        "count": len(faces),
        "vertices": vertices,
        "faces": np.ascontiguousarray(faces, dtype=np.uint32),
    }
    for key, width in (("normals", 3), ("uvs", 2), ("tangents", 4)):
        values = getattr(shape, key)
        if values is None:
            continue
        array = arguments.floats(f"{where}: {key}", values).astype(np.float32, copy=False)
        if array.shape != (len(vertices), width):
            raise SceneError(
                f"{where}: {key} has shape {array.shape}; must be ({len(vertices)}, {width}), one"
                " for each vertex"
            )
        broken = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if broken.size:
            raise SceneError(f"{where}: {key}[{broken[0]}] is not finite")
        record[key] = array
    return record


def _disks(shape: Disks, where: str) -> dict[str, Any]:
    centers = _points(shape.centers, f"{where}: centers")
    record = {"kind": "disk", "count": len(centers), "centers": centers}
    for key in ("axis_u", "axis_v"):
        record[key] = _rows(getattr(shape, key), len(centers), f"{where}: {key}")
    u, v = (record[key].astype(np.float64) for key in ("axis_u", "axis_v"))
    size = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    bad = np.flatnonzero(~(np.abs((u * v).sum(axis=1)) <= 1e-4 * size) | (size == 0))
    if bad.size:
        raise SceneError(
            f"{where}: axis_u[{bad[0]}] and axis_v[{bad[0]}] must be finite, not 0 and"
            " perpendicular to each other"
        )
    return record


def _cylinders(shape: Cylinders, where: str) -> dict[str, Any]:
    starts = _points(shape.starts, f"{where}: starts")
    ends = _rows(shape.ends, len(starts), f"{where}: ends")
    axis = ends.astype(np.float64) - starts
    size = np.linalg.norm(axis, axis=1)
    with np.errstate(over="ignore"):  # the core names what is too far away
        first, last = starts.astype(np.float32), ends.astype(np.float32)
    # in single precision, as the core has them
    bad = np.flatnonzero((size == 0) | ((first == last) & np.isfinite(first)).all(axis=1))
    if bad.size:
        raise SceneError(f"{where}: starts[{bad[0]}] and ends[{bad[0]}] are the same point")
    axis = axis / size[:, None]
    if shape.axis_u is None:
        least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    else:
        least = _rows(shape.axis_u, len(starts), f"{where}: axis_u").astype(np.float64)
    side = least - axis * (least * axis).sum(axis=1)[:, None]
    length = np.linalg.norm(side, axis=1)
    bad = np.flatnonzero(length == 0)
    if bad.size:
        raise SceneError(f"{where}: axis_u[{bad[0]}] is along the cylinder's axis")
    return {
        "kind": "cylinder",
        "count": len(starts),
        "starts": starts,
        "ends": ends,
        "axis_u": side / length[:, None],
        "radii": _radii(shape.radii, len(starts), "cylinder", where),
    }


def _curves(shape: Curves, where: str) -> dict[str, Any]:
    from .curves import bezier_segments

    points = _points(shape.points, f"{where}: points")
    arguments.flag(f"{where}: capped", shape.capped)
    radii = np.broadcast_to(_radii(shape.radii, len(points), "point", where), len(points))
    controls, widths, along, flags = bezier_segments(shape, points, radii, where)
    return {
        "kind": "curve",
        "count": len(controls),
        "points": np.ascontiguousarray(controls.reshape(len(controls), 12)),
        "radii": np.ascontiguousarray(widths),
        "along": along,
        "flags": flags,
    }


# Textures are looked up by recursion.
_DEEPEST_TEXTURE = 16


def _refuse_deep(texture: Texture, where: str) -> None:
    """Raises SceneError for textures made of textures made of ... without end."""
    level = [texture]
    for _ in range(_DEEPEST_TEXTURE):
        level = [x for t in level for x in t.params.values() if isinstance(x, Texture)]
        if not level:
            return
        if len(level) > 4096:
            break
    raise SceneError(
        f"{where}: texture: is made of textures more than {_DEEPEST_TEXTURE} deep, or of thousands"
    )


# --- Arrays --------------------------------------------------------------------------------------


def _points(values: Any, what: str) -> Any:
    array = arguments.floats(what, values)
    if array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise SceneError(f"{what} has shape {array.shape}; must be (N, 3)")
    return array


def _rows(values: Any, count: int, what: str) -> Any:
    array = _points(values, what)
    if len(array) != count:
        raise SceneError(f"{what} has shape {array.shape}; must be ({count}, 3)")
    return array


def _radii(values: Any, count: int, of: str, where: str) -> Any:
    radii = arguments.floats(f"{where}: radii", values)
    if radii.ndim != 0 and radii.shape != (count,):
        raise SceneError(
            f"{where}: radii has shape {radii.shape}; must be ({count},), one for each {of}, or"
            " a single number"
        )
    return radii


def _pixels(array: Any, what: str) -> Any:
    """(H, W, C) of a type that the core takes."""
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim != 3 or array.shape[2] not in (1, 2, 3, 4) or array.size == 0:
        raise SceneError(f"{what} has shape {array.shape}; must be (H, W), (H, W, 3) or (H, W, 4)")
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * 255
    if array.dtype not in (np.uint8, np.uint16, np.float32):
        if array.dtype.kind not in "iuf":
            raise SceneError(f"{what} is {array.dtype}; must be numbers")
        if array.dtype.kind in "iu":
            raise SceneError(f"{what} is {array.dtype}; whole numbers must be uint8 or uint16")
        array = array.astype(np.float32)
    return np.ascontiguousarray(array)


def _color(value: Any, where: str) -> tuple[float, float, float]:
    """Three numbers that are not negative."""
    array = np.asarray(value, dtype=object)
    try:
        floats = [float(x) for x in array.ravel()]
    except (TypeError, ValueError):
        floats = []
    if len(floats) == 1 and array.ndim == 0:
        floats = floats * 3
    if len(floats) != 3 or not all(0 <= x <= 1e12 for x in floats):
        raise SceneError(f"{where} is {value!r}; must be three numbers in [0, 1e12]")
    return floats[0], floats[1], floats[2]


def _indices(values: Any, count: int, names: dict[str, int], where: str) -> Any:
    """Indices of materials from indices or from names, one a primitive."""
    array = arguments.array(f"{where}: material", values)
    known = len(names)
    if array.dtype.kind == "U" and array.ndim == 1:
        used, first, inverse = np.unique(array, return_index=True, return_inverse=True)
        for name, i in zip(used.tolist(), first.tolist(), strict=True):
            if name not in names:
                raise SceneError(f"{where}: material[{i}]: {unknown_name('material', name, names)}")
        array = np.array([names[name] for name in used.tolist()], np.uint32)[inverse]
    if array.dtype.kind not in "iu" and array.size:
        raise SceneError(
            f"{where}: material must be a name, a Material, or (N,) whole numbers or names,"
            f" not {array.dtype}"
        )
    if array.shape != (count,):
        raise SceneError(f"{where}: material has shape {array.shape}; must be ({count},)")
    if count and not (array.min() >= 0 and array.max() < known):
        bad = np.flatnonzero((array < 0) | (array >= known))
        raise SceneError(
            f"{where}: material[{bad[0]}] is {array[bad[0]]}; the scene has {known} named materials"
        )
    return np.ascontiguousarray(array, dtype=np.uint32)
