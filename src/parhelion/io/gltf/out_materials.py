"""Materials out: the inverse of `materials`, as near as glTF comes; docs/gltf.md has the table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import exp, radians
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import tables
from ...display import srgb_encoded
from ...image import encoded, encoded_bytes, is_encoded, read_pixels
from ...scene import Material, Texture
from ..files import Reports
from .building import Builder, text
from .images import linear
from .materials import WHITE

_WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
# v runs down in glTF
_FLIP = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
_FILES = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_CHANNELS = "rgba"
_GREY = 0.8  # in the place of a texture whose mean is not known
# What places a texture on a surface
_MAPPING = ("transform", "uvs", "wrap_u", "wrap_v", "filter")

Triple = tuple[float, float, float]
Object = dict[str, Any]


@dataclass
class Surface:
    """What is written of a material.

    sets: what TEXCOORD_0, 1 and so on are: names of attributes, "" for the mesh's uvs. color,
    alpha: attributes that become COLOR_0. reverse: the faces show their other side.
    """

    index: int
    sets: list[str]
    color: str | None
    alpha: str | None
    reverse: bool


@dataclass
class _Value:
    """A parameter taken apart: a factor, times an image, times an attribute."""

    factor: NDArray[np.float64]
    image: Texture | None = None
    attribute: str | None = None


@dataclass
class _Draft:
    name: str
    sets: list[str] = field(default_factory=list)
    color: str | None = None
    alpha: str | None = None
    reverse: bool = False
    made: Object = field(default_factory=dict)
    extensions: dict[str, Object] = field(default_factory=dict)


class Materials:
    """Writes each material once."""

    def __init__(
        self, builder: Builder, materials: Mapping[str, Material], reports: Reports
    ) -> None:
        self._builder = builder
        self._named = materials
        self._reports = reports
        self._surfaces: dict[Material, Surface] = {}
        self._images: dict[Any, tuple[int, float]] = {}
        self._pixels: dict[Any, NDArray[Any]] = {}
        self._kept: list[Any] = []

    def surface(self, material: Material, size: float) -> Surface:
        """size: about how thick a body of it is, in the mesh's own units."""
        if material not in self._surfaces:
            names = [name for name, m in self._named.items() if m == material]
            draft = _Draft(names[0] if names else material.type)
            self._write(material, draft, size)
            made = {"name": text(draft.name), **draft.made}
            if draft.extensions:
                made["extensions"] = draft.extensions
                for extension in draft.extensions:
                    self._builder.uses(extension)
            index = self._builder.add("materials", made)
            self._surfaces[material] = Surface(
                index, draft.sets, draft.color, draft.alpha, draft.reverse
            )
        return self._surfaces[material]

    # Each type

    def _write(self, m: Material, draft: _Draft, size: float) -> None:
        params = dict(m.params)
        m, params = self._unblended(m, params)
        kind = m.type
        listed = tables.entry("materials", kind, f"material {draft.name!r}").params
        known: dict[str, Any] = {
            p.name: p.choices[int(p.default[0])]
            if p.choices
            else p.default[0]
            if p.size == 1
            else p.default
            for p in listed
        }
        p: dict[str, Any] = known | params
        emission = p.get("emission", (0.0, 0.0, 0.0))
        both_sides = bool(p.get("two_sided_emission", False))
        body: dict[str, Any] = {"metallic": 0.0, "roughness": 1.0}
        base: Any = p.get("color", WHITE)
        opacity: Any = p.get("opacity", 1.0)
        if kind == "diffuse":
            body["specular"] = 0.0
            self._drop(p, "roughness", 0.0, "diffuse: its roughness")
        elif kind == "emissive":
            emission, base, both_sides = p["radiance"], (0.0, 0.0, 0.0), True
            body["specular"] = 0.0
        elif kind == "metal":
            body = {"metallic": 1.0, "roughness": self._fuzz(p["fuzz"])}
            self._tell_unless(base, WHITE, "metal: written as glTF's, which is white at the limb")
        elif kind == "conductor":
            body = {"metallic": 1.0, **_shared(p, "roughness", "anisotropy")}
            base = self._facing(p)
        elif kind == "dielectric":
            body |= {"roughness": p["roughness"], "anisotropy": p["anisotropy"]}
            base = self._product(p["color"], p["transmittance"])
            body["specular_color"] = self._product(p["color"], p["reflectance"])
            ior = self._plain(p["ior"], 1.5)
            if ior < 1.0:  # as seen from the other side
                ior, draft.reverse = 1.0 / ior, True
            body |= {"ior": ior, "transmission": 1.0, "dispersion": p["dispersion"]}
        elif kind == "thin_dielectric":
            self._drop(p, "reflectance", WHITE, "thin_dielectric: its reflectance")
            self._tell_unless(base, WHITE, "thin_dielectric: its color tints what passes alone")
            base = self._product(p["color"], p["transmittance"])
            ior = self._plain(p["ior"], 1.5)
            body |= {"roughness": p["roughness"], "ior": ior, "pane": 1.0}
        elif kind == "plastic":
            self._reports.add("plastic: not in glTF; written as a dielectric of the same albedo")
            ior = self._plain(p["ior"], 1.5)
            if p["nonlinear"] == "on":
                base = self._deepened(base, _kept_within(ior))
            body |= {"roughness": p["roughness"], "ior": ior, "specular_color": p["specular"]}
        elif kind == "diffuse_transmission":
            body["specular"] = 0.0
            base = self._sheet(draft, p)
        elif kind == "null":
            if np.array_equal(base, WHITE):
                opacity = 0.0
            body |= {"roughness": 0.0, "ior": 1.0, "pane": 1.0}
        else:
            body = p
        for name, usual in (("distribution", "ggx"), ("compensation", "on")):
            self._drop(p, name, usual, f"{kind}: its {name}")
        if "pane" in params:  # of a blend with one
            body["pane"] = params["pane"]
        self._base(draft, base, opacity)
        self._metal_rough(draft, body)
        self._anisotropy(draft, body)
        self._reflection(draft, body)
        self._layers(draft, body)
        self._glass(draft, body, p, size)
        self._emission(draft, emission)
        self._normal(draft, p)
        shines = "emissiveFactor" in draft.made
        glass = "KHR_materials_volume" in draft.extensions
        if both_sides if shines else not glass and bool(p.get("two_sided", True)):
            draft.made["doubleSided"] = True
        if not (p.get("two_sided", True) or "KHR_materials_transmission" in draft.extensions):
            self._reports.add("two_sided: backs are black; glTF hides them")
        for name, words in (
            ("bump_map", "bump maps"),
            ("back", "another material of the back"),
            ("priority", "priorities of glass in glass"),
        ):
            if p.get(name):
                self._reports.add(f"{words}: not in glTF; left out")

    def _unblended(self, m: Material, params: dict[str, Any]) -> tuple[Material, dict[str, Any]]:
        """One material of a blend: with a pane it is transmission, else the part of more weight."""
        common = {k: v for k, v in params.items() if k not in ("a", "b", "weight")}
        for _ in range(64):  # parts may be blends
            if m.type != "blend":
                break
            one, other = (
                self._named[x] if isinstance(x, str) else x for x in (m.params["a"], m.params["b"])
            )
            weight = m.params.get("weight", 0.5)
            if other.type == "thin_dielectric" and one.type == "principled":
                self._compare(one, other)
                m, params = one, dict(one.params) | common | {"pane": weight}
                if "ior" in other.params:
                    params["ior"] = other.params["ior"]
                break
            self._reports.add("blend: not in glTF; the part of more weight is written")
            m = other if self._plain(weight, 0.5) > 0.5 else one
            params = dict(m.params) | common
        return m, {k: v for k, v in params.items() if k not in ("a", "b", "weight")}

    def _compare(self, surface: Material, pane: Material) -> None:
        """Tells where a blend's parts differ in what glTF has only once."""
        usual = {x.name: x.default for x in tables.entry("materials", "principled").params}
        for name, own, others in (
            ("color", "color", pane.params.get("transmittance", WHITE)),
            ("roughness", "roughness", pane.params.get("roughness", 0.0)),
            ("ior", "ior", pane.params.get("ior", 1.5)),
            ("reflectance", "", pane.params.get("reflectance", WHITE)),
            ("tint", "", pane.params.get("color", WHITE)),
        ):
            given = surface.params.get(own, usual[own]) if own else WHITE
            words = f"blend with a pane of another {name}: not in glTF; the same for both"
            self._tell_unless(others, given, words)

    def _tell_unless(self, value: Any, usual: Any, words: str) -> None:
        if isinstance(value, Texture) or isinstance(usual, Texture):
            same = value == usual
        else:
            same = np.array_equal(np.broadcast_to(value, 3), np.broadcast_to(usual, 3))
        if not same:
            self._reports.add(words)

    def _drop(self, p: dict[str, Any], name: str, usual: Any, words: str) -> None:
        if p.get(name, usual) is usual:
            return
        self._tell_unless(p[name], usual, f"{words} is not in glTF; left out")

    def _fuzz(self, fuzz: Any) -> float:
        """Roughness of a lobe with the same median angle.

        A point of a sphere of radius f, seen from its middle's distance 1, is off the axis by less
        than f sqrt(1 - 0.5^(2/3)) = 0.608 f in half of all cases. GGX tilts the normal by less than
        atan(alpha) in half of all cases, and the reflection twice as much.
        """
        value = self._plain(fuzz, 0.0)
        if value > 0.0 or isinstance(fuzz, Texture):
            self._reports.add("metal: its fuzz is written as a roughness of the same median angle")
        return float(np.sqrt(0.304 * value))

    def _facing(self, p: dict[str, Any]) -> Any:
        """What a metal reflects of light that meets it straight on."""
        self._reports.add("conductor: written by what it reflects straight on")
        eta, k = (np.asarray(self._means(p[n]), np.float64) for n in ("eta", "k"))
        rest = ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2)
        return self._product(p["color"], _triple(rest))

    def _deepened(self, color: Any, within: float) -> Any:
        """The colour whose share (1 - gloss) is the albedo of a nonlinear plastic of this colour.

        within: the share that the coat throws back from within, k. Of the colour c the albedo is
        (1 - gloss) c (1 - k) / (1 - k c); where c is not taken on again and again, (1 - gloss) c.
        """

        def deep(c: Any) -> Any:
            return c * (1.0 - within) / (1.0 - within * np.clip(c, 0.0, 1.0))

        parts = self._split(color)
        if parts.attribute is not None:
            self._reports.add("plastic: nonlinear is not in glTF; left out where attributes color")
            return color
        if parts.image is None:
            return _triple(deep(parts.factor))
        t = parts.image
        made = deep(self._linear(t, self._is_srgb(t, False)) * np.float32(parts.factor))
        placed = {n: t.params[n] for n in _MAPPING if n in t.params}
        if self._read(t.params["image"]).dtype != np.uint8:
            return Texture("image", image=made, color_space="linear", **placed)
        whole = np.asarray(srgb_encoded(made) * np.float32(255.0) + np.float32(0.5), np.uint8)
        return Texture("image", image=whole, color_space="srgb", **placed)

    def _sheet(self, draft: _Draft, p: dict[str, Any]) -> Triple:
        """A sheet's base colour. The extension's factor f divides light into what is reflected,
        (1 - f) times the base colour, and what comes through, f times a colour of its own.
        """
        back, through = (np.asarray(self._plain_color(p[n])) for n in ("color", "transmittance"))
        both = float(back.max() + through.max())
        if not both > 0.0:
            return (0.0, 0.0, 0.0)
        factor = float(through.max()) / both
        draft.extensions["KHR_materials_diffuse_transmission"] = {
            "diffuseTransmissionFactor": factor,
            "diffuseTransmissionColorFactor": _triple(np.minimum(through / (factor or 1.0), 1.0)),
        }
        return _triple(np.minimum(back / ((1.0 - factor) or 1.0), 1.0))

    # Values

    def _plain_color(self, value: Any) -> Triple:
        """A colour; of a texture the mean, which is told."""
        if isinstance(value, Texture):
            self._reports.add("textures of what glTF has a number for: their mean is written")
        return self._means(value)

    def _product(self, first: Any, second: Any) -> Any:
        if isinstance(first, Texture) or isinstance(second, Texture):
            return Texture("multiply", color0=first, color1=second)
        return _triple(np.asarray(first, np.float64) * np.asarray(second, np.float64))

    def _split(self, value: Any) -> _Value:
        """A number, a colour or a texture as a product of what glTF has."""
        if not isinstance(value, Texture):
            return _Value(np.broadcast_to(np.asarray(value, np.float64), 3))
        if value.type == "image":
            return _Value(np.ones(3), image=value)
        if value.type == "attribute":
            return _Value(np.ones(3), attribute=str(value.params.get("name")))
        if value.type == "multiply":
            parts = [self._split(value.params.get(n, WHITE)) for n in ("color0", "color1")]
            product = _Value(parts[0].factor * parts[1].factor)
            for name in ("image", "attribute"):
                given = [x for x in (getattr(part, name) for part in parts) if x is not None]
                if len(given) > 1:
                    self._reports.add(
                        "products of two images or two attributes: not in glTF; the mean of the"
                        " second is written"
                    )
                    if name == "image":
                        product.factor = product.factor * self._means(given[1])
                setattr(product, name, given[0] if given else None)
            return product
        if value.type == "checker" and not any(
            isinstance(value.params.get(n), Texture) for n in ("color0", "color1")
        ):
            return _Value(np.ones(3), image=_checker(value))
        self._reports.add(f"texture {value.type!r}: not in glTF; its mean is written")
        return _Value(np.asarray(self._means(value)))

    def _means(self, value: Any) -> Triple:
        """The mean of a value over all places, roughly."""
        if not isinstance(value, Texture):
            return _triple(np.broadcast_to(np.asarray(value, np.float64), 3))
        params = value.params
        if value.type == "image":
            pixels = linear(self._read(params["image"]), self._is_srgb(value, False), 0, 1, 2)
            return _triple(pixels.mean(axis=(0, 1), dtype=np.float64))
        if value.type == "attribute":
            return (_GREY,) * 3
        listed = {p.name: p.default for p in tables.entry("textures", value.type).params}
        one, other = (
            np.asarray(self._means(params.get(n, listed[n]))) for n in ("color0", "color1")
        )
        if value.type == "multiply":
            return _triple(one * other)
        share = self._means(params.get("weight", 0.5))[0] if value.type == "mix" else 0.5
        return _triple(one + share * (other - one))

    def _plain(self, value: Any, usual: float) -> float:
        """A number; of a texture the mean, which is told."""
        if not isinstance(value, Texture):
            return float(value)
        self._reports.add("textures of what glTF has a number for: their mean is written")
        return float(np.mean(self._means(value))) if value.type != "attribute" else usual

    def _number(self, value: Any) -> tuple[float, Texture | None]:
        """A factor and an image of numbers."""
        parts = self._split(value)
        if parts.attribute is not None:
            self._reports.add("attributes of anything but colours: not in glTF; left out")
        return float(parts.factor[0]), parts.image

    # Images

    def _read(self, image: Any) -> NDArray[Any]:
        """(H, W, C) pixels, of a file read once."""
        key = _key(image)
        if key not in self._pixels:
            self._kept.append(image)
            pixels = read_pixels(image) if is_encoded(image) else np.asarray(image)
            if pixels.ndim == 2:
                pixels = pixels[:, :, None]
            if pixels.dtype == np.bool_:
                pixels = pixels.astype(np.uint8) * np.uint8(255)
            self._pixels[key] = pixels
        return self._pixels[key]

    def _is_srgb(self, t: Texture, number: bool) -> bool:
        space = t.params.get("color_space", "auto")
        if space != "auto":
            return bool(space == "srgb")
        return not number and self._read(t.params["image"]).dtype == np.uint8

    def _image(
        self, key: Any, make: Callable[[], tuple[NDArray[Any] | bytes, float]]
    ) -> tuple[int, float]:
        """An image of the document, made once; and what it has to be multiplied with."""
        if key not in self._images:
            data, scale = make()
            if not isinstance(data, bytes):
                data = encoded(np.ascontiguousarray(data), {}, ".png")
            kind = next((kind for start, kind in _FILES.items() if data.startswith(start)), "")
            view = self._builder.view(data)
            index = self._builder.add("images", {"bufferView": view, "mimeType": kind})
            self._images[key] = index, scale
        return self._images[key]

    def _stored(self, image: Any) -> NDArray[Any] | bytes | None:
        """An image as it is, if glTF can have it so: the bytes of its file, or whole numbers."""
        if is_encoded(image):
            data = encoded_bytes(image)
            if any(data.startswith(start) for start in _FILES):
                return data
        pixels = self._read(image)
        return pixels if pixels.dtype in (np.uint8, np.uint16) else None

    def _color_image(self, t: Texture) -> tuple[int, float]:
        """An image of encoded colours."""
        channel = t.params.get("channel", "rgb")
        srgb = self._is_srgb(t, False)
        image = t.params["image"]
        plain = channel == "rgb" and srgb

        def make() -> tuple[NDArray[Any] | bytes, float]:
            stored = self._stored(image) if plain else None
            if stored is not None:
                return stored, 1.0
            colors = self._linear(t, srgb)
            scale = max(1.0, float(colors.max()))
            return _sixteen(srgb_encoded(np.ascontiguousarray(colors / np.float32(scale)))), scale

        return self._image(("color", _key(image), channel, srgb), make)

    def _linear(self, t: Texture, srgb: bool) -> NDArray[np.float32]:
        """(H, W, 3) of the channel that a texture takes."""
        pixels = self._read(t.params["image"])
        channel = t.params.get("channel", "rgb")
        if channel in ("r", "g", "b", "a"):
            return linear(pixels, srgb, *[_CHANNELS.index(channel)] * 3)
        colors = linear(pixels, srgb, 0, 1, 2)
        if channel == "luminance":
            colors = np.repeat(_luminance(colors)[:, :, None], 3, axis=2)
        return colors

    def _values(self, t: Texture) -> NDArray[np.float32]:
        """(H, W) of an image of numbers."""
        colors = self._linear(t, self._is_srgb(t, True))
        return _luminance(colors) if t.params.get("channel", "rgb") == "rgb" else colors[:, :, 0]

    def _packed(self, channels: Mapping[int, Texture]) -> int:
        """An image of numbers in channels of its own, 3 being alpha."""
        first = next(iter(channels.values()))
        same = all(
            _key(t.params["image"]) == _key(first.params["image"]) for t in channels.values()
        )
        fits = all(t.params.get("channel") == _CHANNELS[c] for c, t in channels.items())
        plain = not any(self._is_srgb(t, True) for t in channels.values())
        key: tuple[Any, ...] = ("stored", _key(first.params["image"]))
        stored = self._stored(first.params["image"]) if same and fits and plain else None
        if stored is None:
            key = ("packed", *((c, t) for c, t in channels.items()))

        def make() -> tuple[NDArray[Any] | bytes, float]:
            if stored is not None:
                return stored, 1.0
            planes = {c: self._values(t) for c, t in channels.items()}
            fine = any(self._read(t.params["image"]).dtype != np.uint8 for t in channels.values())
            return _stacked(planes, 4 if 3 in planes else 3, fine), 1.0

        return self._image(key, make)[0]

    def _info(self, draft: _Draft, t: Texture, image: int) -> Object:
        """A textureInfo: an image, and where it lies."""
        params = t.params
        wraps = []
        for name in ("wrap_u", "wrap_v"):
            wrap = params.get(name, "repeat")
            if wrap not in _WRAPS:
                self._reports.add(f"wrap mode {wrap!r}: not in glTF; clamped instead")
            wraps.append(_WRAPS.get(wrap, _WRAPS["clamp"]))
        kind = params.get("filter", "mip")
        sampler = {
            "magFilter": 9728 if kind == "nearest" else 9729,
            "minFilter": {"nearest": 9728, "bilinear": 9729}.get(kind, 9987),
            "wrapS": wraps[0],
            "wrapT": wraps[1],
        }
        texture = {"sampler": self._builder.once("samplers", sampler), "source": image}
        info: Object = {"index": self._builder.once("textures", texture)}
        uvs = params.get("uvs") or ""
        if uvs not in draft.sets:
            draft.sets.append(uvs)
        if draft.sets.index(uvs):
            info["texCoord"] = draft.sets.index(uvs)
        if params.get("transform") is not None:
            moved = self._moved(np.asarray(params["transform"], np.float64))
            if moved:
                self._builder.uses("KHR_texture_transform")
                info["extensions"] = {"KHR_texture_transform": moved}
        return info

    def _moved(self, given: NDArray[np.float64]) -> Object:
        matrix = np.eye(3)
        matrix[:2] = given[:2]
        matrix = _FLIP @ matrix @ _FLIP
        (a, b), (c, d) = matrix[:2, :2]
        angle = float(np.arctan2(-c, a))
        cosine, sine = np.cos(angle), np.sin(angle)
        scale = [float(a * cosine - c * sine), float(b * sine + d * cosine)]
        skew = b * cosine - d * sine
        if abs(skew) > 1e-5 * max(map(abs, scale)):
            self._reports.add("textures that are skewed: not in glTF; written without")
        found: Object = {}
        if np.any(matrix[:2, 2]):
            found["offset"] = matrix[:2, 2].tolist()
        if angle:
            found["rotation"] = angle
        if scale != [1.0, 1.0]:
            found["scale"] = scale
        return found

    # Parts of a material

    def _base(self, draft: _Draft, base: Any, opacity: Any) -> None:
        """Base colour, and alpha, which shares its texture."""
        color, alpha = self._split(base), self._split(opacity)
        draft.color, draft.alpha = color.attribute, alpha.attribute
        pbr: Object = {}
        factor = color.factor.copy()
        share = float(alpha.factor[0])
        mapping, over = color.image, alpha.image
        if mapping is not None and over is not None and not _alike(mapping, over):
            self._reports.add(
                "opacity whose texture lies otherwise than that of the colour: not in glTF; its"
                " mean is written"
            )
            share *= float(self._values(over).mean())
            over = None
        if over is not None:
            image, scale = self._with_alpha(mapping, over)
            pbr["baseColorTexture"] = self._info(draft, mapping or over, image)
            factor *= scale
        elif mapping is not None:
            image, scale = self._color_image(mapping)
            pbr["baseColorTexture"] = self._info(draft, mapping, image)
            factor *= scale
        if share < 1.0 or over is not None or draft.alpha is not None:
            draft.made["alphaMode"] = "BLEND"
        numbers = [*self._cut(factor), min(max(share, 0.0), 1.0)]
        if numbers != [1.0] * 4:
            pbr["baseColorFactor"] = numbers
        draft.made["pbrMetallicRoughness"] = pbr

    def _with_alpha(self, color: Texture | None, over: Texture) -> tuple[int, float]:
        """An image of encoded colours and alpha."""
        if color is not None and _key(color.params["image"]) == _key(over.params["image"]):
            plain = color.params.get("channel", "rgb") == "rgb" and self._is_srgb(color, False)
            if plain and over.params.get("channel") == "a":
                return self._color_image(color)

        def make() -> tuple[NDArray[Any] | bytes, float]:
            planes = {3: self._values(over)}
            scale = 1.0
            if color is not None:
                colors = self._linear(color, self._is_srgb(color, False))
                scale = max(1.0, float(colors.max()))
                colors = srgb_encoded(np.ascontiguousarray(colors / np.float32(scale)))
                planes |= {i: colors[:, :, i] for i in range(3)}
            return _stacked(planes, 4, True), scale

        return self._image(("alpha", color, over), make)

    def _metal_rough(self, draft: _Draft, body: dict[str, Any]) -> None:
        pbr = draft.made["pbrMetallicRoughness"]
        metallic, metal_image = self._number(body["metallic"])
        roughness, rough_image = self._number(body["roughness"])
        apart = metal_image and rough_image and not _alike(metal_image, rough_image)
        if metal_image is not None and apart:
            self._reports.add(
                "textures of metallic and roughness that lie differently: not in glTF; the mean of"
                " metallic is written"
            )
            metallic *= float(self._values(metal_image).mean())
            metal_image = None
        channels = {1: rough_image, 2: metal_image}
        given = {c: t for c, t in channels.items() if t is not None}
        if given:
            first = next(iter(given.values()))
            pbr["metallicRoughnessTexture"] = self._info(draft, first, self._packed(given))
        pbr["metallicFactor"], pbr["roughnessFactor"] = metallic, roughness

    def _anisotropy(self, draft: _Draft, body: dict[str, Any]) -> None:
        """From alphas whose geometric mean is r^2 and whose ratio is (1 + a) / (1 - a)."""
        value = body.get("anisotropy", 0.0)
        if not isinstance(value, Texture) and value == 0.0:
            return
        stretch = self._plain(value, 0.0)
        turned = self._plain(body.get("anisotropy_rotation", 0.0), 0.0)
        pbr = draft.made["pbrMetallicRoughness"]
        if "metallicRoughnessTexture" in pbr:
            self._reports.add("anisotropy with a texture of roughness: not in glTF; left out")
            return
        if stretch < 0.0:
            stretch, turned = -stretch, turned + 90.0
        ratio = np.sqrt((1.0 + stretch) / (1.0 - stretch))
        alpha = max(pbr["roughnessFactor"] ** 2, 1e-4)
        if alpha * ratio > 1.0:
            self._reports.add("anisotropy of what is very rough: not in glTF; written with less")
        along, across = min(alpha * ratio, 1.0), alpha / ratio
        pbr["roughnessFactor"] = float(np.sqrt(across))
        strength = np.sqrt(max(along - across, 0.0) / max(1.0 - across, 1e-6))
        draft.extensions["KHR_materials_anisotropy"] = {
            "anisotropyStrength": min(float(strength), 1.0),
            "anisotropyRotation": radians(turned % 360.0),
        }

    def _reflection(self, draft: _Draft, body: dict[str, Any]) -> None:
        ior = self._plain(body.get("ior", 1.5), 1.5)
        if ior != 1.5:
            draft.extensions["KHR_materials_ior"] = {"ior": max(ior, 1.0)}
        made: Object = {}
        self._channel(draft, made, "specular", body.get("specular", 1.0), 1.0, 3)
        self._colored(draft, made, "specularColor", body.get("specular_color", WHITE), WHITE)
        if made:
            draft.extensions["KHR_materials_specular"] = made

    def _channel(
        self, draft: _Draft, made: Object, name: str, value: Any, usual: float, channel: int
    ) -> None:
        """A number of an extension: a factor and a channel of a texture."""
        factor, image = self._number(value)
        if factor != usual:
            made[f"{name}Factor"] = min(max(factor, 0.0), 1.0)
        if image is not None:
            made[f"{name}Texture"] = self._info(draft, image, self._packed({channel: image}))

    def _textured(self, draft: _Draft, made: Object, name: str, value: Any) -> Any:
        """The factor of a colour, whose texture goes where it belongs."""
        parts = self._split(value)
        if parts.attribute is not None:
            self._reports.add("attributes of anything but colours: not in glTF; left out")
        if parts.image is None:
            return parts.factor
        image, scale = self._color_image(parts.image)
        made[f"{name}Texture"] = self._info(draft, parts.image, image)
        return parts.factor * scale

    def _colored(self, draft: _Draft, made: Object, name: str, value: Any, usual: Triple) -> None:
        """A colour of an extension."""
        factor = self._textured(draft, made, name, value)
        if _triple(factor) != usual:
            made[f"{name}Factor"] = self._cut(factor)

    def _cut(self, factor: NDArray[np.float64]) -> list[float]:
        if factor.max() > 1.0 + 1e-6:
            self._reports.add("textures times more than 1: not in glTF but for emission; times 1")
        return [float(x) for x in np.clip(factor, 0.0, 1.0)]

    def _layers(self, draft: _Draft, body: dict[str, Any]) -> None:
        """Coat, sheen and film."""
        self._drop(body, "diffuse_roughness", 0.0, "principled: its diffuse_roughness")
        if _some(body.get("clearcoat", 0.0)):
            made: Object = {}
            self._channel(draft, made, "clearcoat", body["clearcoat"], 0.0, 0)
            rough = body.get("clearcoat_roughness", 0.0)
            self._channel(draft, made, "clearcoatRoughness", rough, 0.0, 1)
            draft.extensions["KHR_materials_clearcoat"] = made
            self._drop(body, "clearcoat_ior", 1.5, "principled: its clearcoat_ior")
        if _some(body.get("sheen_color", 0.0)):
            made = {}
            self._colored(draft, made, "sheenColor", body["sheen_color"], (0.0, 0.0, 0.0))
            self._channel(draft, made, "sheenRoughness", body["sheen_roughness"], 0.0, 3)
            draft.extensions["KHR_materials_sheen"] = made
        if _some(body.get("iridescence", 0.0)):
            made = {}
            self._channel(draft, made, "iridescence", body["iridescence"], 0.0, 0)
            made["iridescenceIor"] = self._plain(body["iridescence_ior"], 1.3)
            thickness = self._plain(body["iridescence_thickness"], 400.0)
            made |= {
                "iridescenceThicknessMinimum": thickness,
                "iridescenceThicknessMaximum": thickness,
            }
            draft.extensions["KHR_materials_iridescence"] = made

    def _glass(self, draft: _Draft, body: dict[str, Any], p: dict[str, Any], size: float) -> None:
        share = body.get("pane", body.get("transmission", 0.0))
        if not _some(share):
            return
        made: Object = {}
        self._channel(draft, made, "transmission", share, 0.0, 0)
        draft.extensions["KHR_materials_transmission"] = made
        if "pane" in body:
            return
        volume: Object = {"thicknessFactor": size}
        lost = np.broadcast_to(np.asarray(p.get("absorption", 0.0), np.float64), 3)
        if lost.max() > 0.0:
            distance = 1.0 / float(lost.max())
            volume["attenuationDistance"] = distance
            volume["attenuationColor"] = [exp(-x * distance) for x in lost.tolist()]
        draft.extensions["KHR_materials_volume"] = volume
        dispersion = self._plain(body.get("dispersion", 0.0), 0.0)
        if dispersion > 0.0:
            draft.extensions["KHR_materials_dispersion"] = {"dispersion": dispersion}

    def _emission(self, draft: _Draft, emission: Any) -> None:
        if not _some(emission):
            return
        factor = self._textured(draft, draft.made, "emissive", emission)
        strength = float(factor.max())
        if strength > 1.0:
            factor = factor / strength
            draft.extensions["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
        draft.made["emissiveFactor"] = factor.tolist()

    def _normal(self, draft: _Draft, p: dict[str, Any]) -> None:
        given = p.get("normal_map")
        if given is None:
            return
        if p.get("normal_map_frame", "uv") != "uv":
            self._reports.add(
                "normal maps of a right-handed frame: not in glTF; the same where texture"
                " coordinates are not mirrored"
            )
        parts = self._split(given)
        if parts.image is None:
            self._reports.add("normal maps that are no images: not in glTF; left out")
            return
        if parts.attribute is not None or np.any(parts.factor != 1.0):
            self._reports.add("products of a normal map: not in glTF; the image alone is written")
        image, srgb = parts.image.params["image"], self._is_srgb(parts.image, True)

        def make() -> tuple[NDArray[Any] | bytes, float]:
            stored = None if srgb else self._stored(image)
            if stored is not None:
                return stored, 1.0
            return _sixteen(linear(self._read(image), srgb, 0, 1, 2)), 1.0

        index = self._image(("normals" if srgb else "stored", _key(image)), make)[0]
        draft.made["normalTexture"] = self._info(draft, parts.image, index)


def _key(image: Any) -> Any:
    return fspath(image) if isinstance(image, (str, PathLike)) else id(image)


def _kept_within(ior: float) -> float:
    """Share that a smooth interface throws back of diffuse light from its denser side."""
    cosines, weights = np.polynomial.legendre.leggauss(64)
    cosines = 0.5 * (cosines + 1.0)
    sines = (1.0 - cosines**2) / ior**2
    inner = np.sqrt(1.0 - sines)
    s = (cosines - ior * inner) / (cosines + ior * inner)
    p = (ior * cosines - inner) / (ior * cosines + inner)
    outside = float(weights @ (cosines * (s**2 + p**2))) / 2.0  # of diffuse light from without
    return 1.0 - (1.0 - outside) / ior**2


def _shared(p: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: p[name] for name in names}


def _triple(values: Any) -> Triple:
    r, g, b = (float(x) for x in values)
    return r, g, b


def _some(value: Any) -> bool:
    """Whether there is any of it."""
    return isinstance(value, Texture) or bool(np.max(np.asarray(value, np.float64)) > 0.0)


def _alike(one: Texture, other: Texture) -> bool:
    """Whether two textures lie on a surface in the same way."""
    for name in _MAPPING:
        first: Any = one.params.get(name)
        second: Any = other.params.get(name)
        same = np.array_equal(first, second) if name == "transform" else first == second
        if not same:
            return False
    return True


def _luminance(colors: NDArray[np.float32]) -> NDArray[np.float32]:
    found: NDArray[np.float32] = colors @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    return found


def _sixteen(values: NDArray[Any]) -> NDArray[np.uint16]:
    return np.asarray(np.clip(values, 0.0, 1.0) * np.float32(65535.0) + np.float32(0.5), np.uint16)


def _stacked(planes: Mapping[int, NDArray[Any]], count: int, fine: bool) -> NDArray[Any]:
    """(H, W, count) of channels in [0, 1], those not given 1; of the largest one's size."""
    height = max(p.shape[0] for p in planes.values())
    width = max(p.shape[1] for p in planes.values())
    made = np.ones((height, width, count), np.float32)
    for channel, plane in planes.items():
        y = np.arange(height) * plane.shape[0] // height
        x = np.arange(width) * plane.shape[1] // width
        made[:, :, channel] = plane[y[:, None], x]
    if fine:
        return _sixteen(made)
    return np.asarray(np.clip(made, 0.0, 1.0) * np.float32(255.0) + np.float32(0.5), np.uint8)


def _checker(t: Texture) -> Texture:
    """The four fields as four texels."""
    listed = {p.name: p.default for p in tables.entry("textures", "checker").params}
    one, other = (np.float32(t.params.get(n, listed[n])) for n in ("color0", "color1"))
    pixels = np.stack([np.stack([other, one]), np.stack([one, other])])
    placed = {n: t.params[n] for n in ("transform", "uvs") if n in t.params}
    return Texture("image", image=pixels, color_space="linear", filter="nearest", **placed)
