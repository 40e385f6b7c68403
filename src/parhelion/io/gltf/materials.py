"""Materials: glTF's metallic-roughness with its extensions is our `principled`.

Parameters that glTF multiplies with a texture are multiplied here, texel by texel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import degrees, log
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ... import scene
from ...image import srgb_encoded
from . import schema
from .images import Color, Curve, Images, in_bands, linear, to_bytes
from .source import Source

T = TypeVar("T")
Value = float | scene.Texture
Colors = Color | scene.Texture

WHITE = (1.0, 1.0, 1.0)
# Reflectance at normal incidence of an index of 1.5, glTF's default
_DIELECTRIC = 0.04
# The largest index that `principled` takes
_MOST_IOR = 10.0
# A pane is drawn without blur; one that is smoother than this has hardly any
_SMOOTH_PANE = 0.15
_UNSUPPORTED = {
    "KHR_materials_dispersion": "all wavelengths are refracted alike",
}


@dataclass(frozen=True)
class Surface:
    """The material of a primitive: its name in the scene, the set of texture coordinates that its
    textures lie on, and what the primitive's vertex colours add to its attributes.
    """

    name: str
    uv_set: int | None
    attributes: dict[str, NDArray[np.float32]]


@dataclass
class _Draft:
    """A material on its way, by the extensions of its document's."""

    source: schema.Material
    where: str
    uv_set: int | None = None
    tint: Color = WHITE
    alpha: float = 1.0
    vertex_color: bool = False
    vertex_alpha: bool = False


class Materials:
    """The materials of a document; `made` has those that are in use, by name."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._images = Images(source)
        self.made: dict[str, scene.Material] = {}
        self._surfaces: dict[tuple[Any, ...], tuple[str, int | None, _Draft]] = {}

    def surface(self, index: int | None, colors: NDArray[np.float32] | None) -> Surface:
        """What a primitive is made of; index None is glTF's default material. colors: of its
        vertices, (V, 3) or (V, 4).
        """
        source = schema.Material() if index is None else self._source.document.materials[index]
        draft = _Draft(source, "material" if index is None else f"materials[{index}]")
        if colors is not None:
            self._take_colors(draft, colors)
        key = (index, draft.tint, draft.alpha, draft.vertex_color, draft.vertex_alpha)
        if key not in self._surfaces:
            material = self._material(draft)
            name = self._name(source.name or ("default" if index is None else f"material {index}"))
            self.made[name] = material
            self._surfaces[key] = (name, draft.uv_set, draft)
        name, uv_set, _ = self._surfaces[key]
        return Surface(name, uv_set, self._attributes(draft, colors))

    def _name(self, name: str) -> str:
        number, chosen = 1, name
        while chosen in self.made:
            number += 1
            chosen = f"{name} {number}"
        return chosen

    # Vertex colours

    def _take_colors(self, draft: _Draft, colors: NDArray[np.float32]) -> None:
        """Decides how vertex colours come in: as a factor where all are the same, else as an
        attribute, which cannot be multiplied with a texture.
        """
        same = bool((colors == colors[:1]).all()) if len(colors) else True
        base, alpha_base = self._base_textures(draft)
        if same and len(colors):
            red, green, blue = (float(x) for x in np.clip(colors[0, :3], 0.0, 1.0))
            draft.tint = (red, green, blue)
            if colors.shape[1] == 4:
                draft.alpha = float(np.clip(colors[0, 3], 0.0, 1.0))
            return
        if base:
            self._source.report(
                "vertex colours of a material with a base colour texture: not multiplied with it;"
                " ignored"
            )
        else:
            draft.vertex_color = True
        see_through = draft.source.alpha_mode in ("MASK", "BLEND")
        draft.vertex_alpha = colors.shape[1] == 4 and see_through and not alpha_base

    def _base_textures(self, draft: _Draft) -> tuple[bool, bool]:
        """Whether the base colour, and the alpha, come from a texture."""
        info = draft.source.pbr_metallic_roughness.base_color_texture
        glossy = self._extension(draft, "pbrSpecularGlossiness", schema.SpecularGlossiness)
        if glossy is not None:
            info = glossy.diffuse_texture
            if glossy.specular_glossiness_texture is not None:
                return True, info is not None
        return info is not None, info is not None

    def _attributes(
        self, draft: _Draft, colors: NDArray[np.float32] | None
    ) -> dict[str, NDArray[np.float32]]:
        if colors is None:
            return {}
        factor = np.array(self._base_factor(draft), np.float32)
        found = {}
        if draft.vertex_color:
            found["vertex_color"] = np.clip(colors[:, :3] * factor[:3], 0.0, 1.0)
        if draft.vertex_alpha:
            alpha = np.clip(colors[:, 3] * factor[3], 0.0, 1.0)
            if draft.source.alpha_mode == "MASK":
                alpha = (alpha >= draft.source.alpha_cutoff).astype(np.float32)
            found["vertex_alpha"] = alpha
        return found

    def _base_factor(self, draft: _Draft) -> tuple[float, float, float, float]:
        glossy = self._extension(draft, "pbrSpecularGlossiness", schema.SpecularGlossiness)
        factor = (
            draft.source.pbr_metallic_roughness.base_color_factor
            if glossy is None
            else glossy.diffuse_factor
        )
        r, g, b, a = (min(max(x, 0.0), 1.0) for x in factor)
        return r, g, b, a

    # Values: a factor, or a texture of it

    def _extension(self, draft: _Draft, name: str, kind: type[T]) -> T | None:
        return self._source.extension(draft.source, f"KHR_materials_{name}", kind, draft.where)

    def _lies_on(self, draft: _Draft, info: schema.TextureInfo, where: str) -> bool:
        """Whether a texture lies on the same coordinates as those before it."""
        uv_set = self._images.uv_set(info, where)
        if draft.uv_set is None:
            draft.uv_set = uv_set
        if draft.uv_set == uv_set:
            return True
        self._source.report(
            f"{where.partition('.')[2]}: on another set of texture coordinates than the material's"
            " other textures; its mean is used"
        )
        return False

    def _color(
        self, draft: _Draft, info: schema.TextureInfo | None, factor: Color, name: str
    ) -> Colors:
        """A colour, of which glTF multiplies an encoded texture with a linear factor."""
        where = f"{draft.where}.{name}"
        if info is None:
            return factor
        if not self._lies_on(draft, info, where):
            means = [self._images.mean(info, c, True, where) for c in range(3)]
            return factor[0] * means[0], factor[1] * means[1], factor[2] * means[2]
        if max(factor) == 0.0:
            return factor
        return self._images.color(info, factor, where) or factor

    def _number(
        self,
        draft: _Draft,
        info: schema.TextureInfo | None,
        channel: int,
        factor: float,
        name: str,
        curve: Callable[[Any], Any] | None = None,
    ) -> Value:
        """A number: the factor times a channel of the texture, or a curve of that."""
        where = f"{draft.where}.{name}"
        factor = min(max(factor, 0.0), 1.0)
        if info is None and curve is None:
            return factor
        whole: Callable[[Any], Any] = curve or (lambda x: x)
        if info is None:
            return float(whole(np.float32(factor)))
        if not self._lies_on(draft, info, where):
            return float(whole(np.float32(factor * self._images.mean(info, channel, False, where))))
        if factor == 0.0:
            return float(whole(np.float32(0.0)))
        scaled: Curve | None = (
            None if curve is None and factor == 1.0 else lambda x: whole(x * np.float32(factor))
        )
        made = self._images.number(info, channel, where, scaled, (factor, curve))
        return float(whole(np.float32(factor))) if made is None else made

    # Materials

    def _material(self, draft: _Draft) -> scene.Material:
        m = draft.source
        params: dict[str, Any] = {}
        glossy = self._extension(draft, "pbrSpecularGlossiness", schema.SpecularGlossiness)
        base: Colors
        if glossy is not None:
            alpha_info, alpha = glossy.diffuse_texture, glossy.diffuse_factor[3]
            params = self._glossiness(draft, glossy)
            base = params.pop("color")
        else:
            pbr = m.pbr_metallic_roughness
            alpha_info, alpha = pbr.base_color_texture, pbr.base_color_factor[3]
            r, g, b, _ = self._base_factor(draft)
            factor = (r * draft.tint[0], g * draft.tint[1], b * draft.tint[2])
            base = self._color(draft, alpha_info, factor, "pbrMetallicRoughness.baseColorTexture")
            info = pbr.metallic_roughness_texture
            name = "pbrMetallicRoughness.metallicRoughnessTexture"
            params["metallic"] = self._number(draft, info, 2, pbr.metallic_factor, name)
            params |= self._roughness(draft, info, pbr.roughness_factor, name)
        if draft.vertex_color:
            base = scene.Texture("attribute", name="vertex_color")
        common = self._common(draft, alpha_info, min(max(alpha, 0.0), 1.0) * draft.alpha)
        if "KHR_materials_unlit" in m.extensions:
            common.pop("normal_map", None)
            common |= {"emission": base, "two_sided_emission": True}
            return scene.Material("diffuse", color=(0.0, 0.0, 0.0), **common)
        for name, instead in _UNSUPPORTED.items():
            if name in m.extensions:
                self._source.report(f"{name}: not supported; {instead}")
        params |= self._coat(draft) | self._sheen(draft) | self._film(draft)
        params |= self._reflection(draft)
        return self._transmission(draft, base, params, common)

    def _common(
        self, draft: _Draft, alpha_info: schema.TextureInfo | None, alpha: float
    ) -> dict[str, Any]:
        """What every one of our materials may have."""
        m = draft.source
        found: dict[str, Any] = {}
        strength = self._extension(draft, "emissive_strength", schema.EmissiveStrength)
        scale = strength.emissive_strength if strength else 1.0
        r, g, b = (min(x * scale, 1e12) for x in m.emissive_factor)
        if max(r, g, b) > 0.0:
            found["emission"] = self._color(draft, m.emissive_texture, (r, g, b), "emissiveTexture")
            if m.double_sided:
                found["two_sided_emission"] = True
        if m.normal_texture is not None:
            normals = self._normals(draft, m.normal_texture)
            if normals is not None:
                found["normal_map"] = normals
        opacity = self._opacity(draft, alpha_info, alpha)
        if opacity != 1.0:
            found["opacity"] = opacity
        return found

    def _opacity(self, draft: _Draft, info: schema.TextureInfo | None, alpha: float) -> Value:
        mode, cutoff = draft.source.alpha_mode, draft.source.alpha_cutoff
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise self._source.error(
                f"{draft.where}.alphaMode is {mode[:20]!r}; must be one of OPAQUE, MASK, BLEND"
            )
        if mode == "OPAQUE":
            return 1.0
        if draft.vertex_alpha:
            return scene.Texture("attribute", name="vertex_alpha")
        where = f"{draft.where}.pbrMetallicRoughness.baseColorTexture"
        if info is not None and not self._images.has_alpha(info, where):
            info = None
        if mode == "BLEND":
            return self._number(draft, info, 3, alpha, "pbrMetallicRoughness.baseColorTexture")
        if info is None or not self._lies_on(draft, info, where):
            return 1.0 if alpha >= cutoff else 0.0
        make = partial(_holes, alpha, cutoff)
        return self._images.image(info, where, make, ("mask", alpha, cutoff)) or 1.0

    def _normals(self, draft: _Draft, info: schema.TextureInfo) -> scene.Texture | None:
        where = f"{draft.where}.normalTexture"
        if not self._lies_on(draft, info, where):
            return None
        if info.scale == 1.0:
            return self._images.plain(info, where)
        make = partial(in_bands, partial(_scaled_normals, info.scale))
        return self._images.image(info, where, make, ("normals", info.scale))

    def _roughness(
        self, draft: _Draft, info: schema.TextureInfo | None, factor: float, name: str
    ) -> dict[str, Any]:
        """Roughness, and what anisotropy does to it."""
        brushed = self._extension(draft, "anisotropy", schema.Anisotropy)
        if brushed is None or brushed.anisotropy_strength <= 0.0:
            return {"roughness": self._number(draft, info, 1, factor, name)}
        strength = min(brushed.anisotropy_strength, 1.0)
        turned = brushed.anisotropy_rotation
        texture = brushed.anisotropy_texture
        place = "extensions.KHR_materials_anisotropy.anisotropyTexture"
        if texture is None:
            roughness = partial(_stretched_roughness, strength)
            stretch = partial(_stretch, strength)
            return {
                "roughness": self._number(draft, info, 1, factor, name, roughness),
                "anisotropy": self._number(draft, info, 1, factor, name, stretch),
                "anisotropy_rotation": degrees(turned) % 360.0,
            }
        if info is not None:
            self._source.report(
                "anisotropyTexture with a texture of roughness: not supported together; the mean"
                " roughness is used"
            )
            factor *= self._images.mean(info, 1, False, f"{draft.where}.{name}")
        alpha = np.float32(factor)
        found: dict[str, Any] = {
            "roughness": self._number(
                draft, texture, 2, strength, place, lambda b: _stretched_roughness(b, alpha)
            ),
            "anisotropy": self._number(
                draft, texture, 2, strength, place, lambda b: _stretch(b, alpha)
            ),
            "anisotropy_rotation": degrees(turned) % 360.0,
        }
        where = f"{draft.where}.{place}"
        if self._lies_on(draft, texture, where):
            make = partial(in_bands, partial(_angles, turned))
            angles = self._images.image(
                texture, where, make, ("angles", turned), smooth=False, channel="r"
            )
            found["anisotropy_rotation"] = angles or found["anisotropy_rotation"]
        return found

    def _coat(self, draft: _Draft) -> dict[str, Any]:
        coat = self._extension(draft, "clearcoat", schema.Clearcoat)
        if coat is None or coat.clearcoat_factor <= 0.0:
            return {}
        place = "extensions.KHR_materials_clearcoat."
        if coat.clearcoat_normal_texture is not None:
            self._source.report(
                "clearcoatNormalTexture: not supported; the coat has the normals of what it covers"
            )
        return {
            "clearcoat": self._number(
                draft, coat.clearcoat_texture, 0, coat.clearcoat_factor, f"{place}clearcoatTexture"
            ),
            "clearcoat_roughness": self._number(
                draft,
                coat.clearcoat_roughness_texture,
                1,
                coat.clearcoat_roughness_factor,
                f"{place}clearcoatRoughnessTexture",
            ),
        }

    def _sheen(self, draft: _Draft) -> dict[str, Any]:
        sheen = self._extension(draft, "sheen", schema.Sheen)
        if sheen is None or max(sheen.sheen_color_factor) <= 0.0:
            return {}
        place = "extensions.KHR_materials_sheen."
        r, g, b = (min(max(x, 0.0), 1.0) for x in sheen.sheen_color_factor)
        return {
            "sheen_color": self._color(
                draft, sheen.sheen_color_texture, (r, g, b), f"{place}sheenColorTexture"
            ),
            "sheen_roughness": self._number(
                draft,
                sheen.sheen_roughness_texture,
                3,
                sheen.sheen_roughness_factor,
                f"{place}sheenRoughnessTexture",
            ),
        }

    def _film(self, draft: _Draft) -> dict[str, Any]:
        film = self._extension(draft, "iridescence", schema.Iridescence)
        if film is None or film.iridescence_factor <= 0.0:
            return {}
        place = "extensions.KHR_materials_iridescence."
        low, high = (
            min(x, 1e4)
            for x in (film.iridescence_thickness_minimum, film.iridescence_thickness_maximum)
        )
        return {
            "iridescence": self._number(
                draft,
                film.iridescence_texture,
                0,
                film.iridescence_factor,
                f"{place}iridescenceTexture",
            ),
            "iridescence_ior": min(max(film.iridescence_ior, 1.0), _MOST_IOR),
            "iridescence_thickness": self._number(
                draft,
                film.iridescence_thickness_texture,
                1,
                1.0,
                f"{place}iridescenceThicknessTexture",
                lambda x: low + (high - low) * x,
            ),
        }

    def _reflection(self, draft: _Draft) -> dict[str, Any]:
        """The index of refraction and the strength and tint of what it reflects."""
        found: dict[str, Any] = {}
        index = self._extension(draft, "ior", schema.Ior)
        ior = 1.5
        if index is not None:
            ior = min(max(index.ior, 1.0), _MOST_IOR) if index.ior > 0.0 else _MOST_IOR
            found["ior"] = ior
        specular = self._extension(draft, "specular", schema.Specular)
        if specular is None:
            return found
        place = "extensions.KHR_materials_specular."
        found["specular"] = self._number(
            draft, specular.specular_texture, 3, specular.specular_factor, f"{place}specularTexture"
        )
        r, g, b = specular.specular_color_factor
        most = max(r, g, b)
        if most > 1.0:  # reflects more than its index does: so does a larger index
            root = min((ior - 1.0) / (ior + 1.0) * most**0.5, (_MOST_IOR - 1.0) / (_MOST_IOR + 1.0))
            found["ior"] = min((1.0 + root) / (1.0 - root), _MOST_IOR)
            r, g, b = r / most, g / most, b / most
        found["specular_color"] = self._color(
            draft, specular.specular_color_texture, (r, g, b), f"{place}specularColorTexture"
        )
        return found

    def _transmission(
        self, draft: _Draft, base: Colors, params: dict[str, Any], common: dict[str, Any]
    ) -> scene.Material:
        """The material, opaque, or a body of glass, or a pane without thickness."""
        opaque = scene.Material("principled", color=base, **params, **common)
        glass = self._extension(draft, "transmission", schema.Transmission)
        metallic, roughness = params["metallic"], params["roughness"]
        if glass is None or glass.transmission_factor <= 0.0 or metallic == 1.0:
            return opaque

        def share(factor: float) -> Value:
            name = "extensions.KHR_materials_transmission.transmissionTexture"
            return self._number(draft, glass.transmission_texture, 0, factor, name)

        volume = self._extension(draft, "volume", schema.Volume)
        if volume is not None and volume.thickness_factor > 0.0:
            if volume.attenuation_distance is not None:
                common["absorption"] = tuple(
                    -log(min(max(c, 1e-6), 1.0)) / volume.attenuation_distance
                    for c in volume.attenuation_color
                )
            params["transmission"] = share(glass.transmission_factor)
            return scene.Material("principled", color=base, **params, **common)
        if isinstance(roughness, scene.Texture) or roughness > _SMOOTH_PANE:
            self._source.report(
                "KHR_materials_transmission without a volume: rough panes are not supported; what"
                " is seen through them is not blurred"
            )
        if isinstance(metallic, scene.Texture):
            self._source.report(
                "KHR_materials_transmission without a volume, on what a texture makes metal in"
                " places: not supported; the metal transmits too"
            )
            metallic = 0.0
        weight = share(glass.transmission_factor * (1.0 - metallic))
        pane = {"ior": params.get("ior", 1.5), "transmittance": base}
        if weight == 1.0:
            return scene.Material("thin_dielectric", **pane, **common)
        return scene.Material(
            "blend",
            a=scene.Material("principled", color=base, **params),
            b=scene.Material("thin_dielectric", **pane),
            weight=weight,
            **common,
        )

    # Specular and glossiness

    def _glossiness(self, draft: _Draft, m: schema.SpecularGlossiness) -> dict[str, Any]:
        """The parameters of `principled` that reflect the same at normal incidence."""
        r, g, b, _ = self._base_factor(draft)
        diffuse = np.array([r, g, b], np.float32) * np.array(draft.tint, np.float32)
        specular = np.clip(np.array(m.specular_factor, np.float32), 0.0, 1.0)
        gloss = min(max(m.glossiness_factor, 0.0), 1.0)
        place = "extensions.KHR_materials_pbrSpecularGlossiness."
        first, second = m.diffuse_texture, m.specular_glossiness_texture
        where = [
            f"{draft.where}.{place}{n}" for n in ("diffuseTexture", "specularGlossinessTexture")
        ]
        if second is None or not self._lies_on(draft, second, where[1]):
            if first is not None and max(specular) <= _DIELECTRIC:  # the usual case: no metal
                color = self._color(draft, first, _triple(diffuse), f"{place}diffuseTexture")
                return {"color": color, "metallic": 0.0, "roughness": 1.0 - gloss}
            second = None
        if first is not None and not self._lies_on(draft, first, where[0]):
            first = None
        infos = [info for info in (first, second) if info is not None]
        if not infos:
            colors, metal = _metallic(diffuse[None], specular[None])
            return {
                "color": _triple(colors[0]),
                "metallic": float(metal[0]),
                "roughness": 1.0 - gloss,
            }
        sources = [self._images.source_of(i, f"{draft.where}.{place[:-1]}") for i in infos]
        if None in sources:
            return {"color": _triple(diffuse), "metallic": 0.0, "roughness": 1.0 - gloss}

        def texels(info: schema.TextureInfo | None, shape: tuple[int, int]) -> NDArray[Any]:
            """Linear texels, the nearest ones where another image has more."""
            if info is None:
                return np.ones((1, 1, 4), np.float32)
            index = self._images.source_of(info, draft.where)
            assert index is not None
            found = linear(self._images.pixels(index), True, 0, 1, 2, 3)
            rows, columns = (
                np.arange(n) * m // n for n, m in zip(shape, found.shape, strict=False)
            )
            return np.asarray(found[rows[:, None], columns])

        shapes = [self._images.pixels(i).shape[:2] for i in sources if i is not None]
        shape = max(shapes, key=lambda s: s[0] * s[1])

        def make(part: str, _: NDArray[Any]) -> NDArray[Any]:
            body, shine = texels(first, shape), texels(second, shape)
            if part == "roughness":
                return to_bytes(1.0 - gloss * shine[:, :, 3])
            color, metallic = _metallic(diffuse * body[:, :, :3], specular * shine[:, :, :3])
            color, metallic = np.broadcast_to(color, (*shape, 3)), np.broadcast_to(metallic, shape)
            return to_bytes(srgb_encoded(color)) if part == "color" else to_bytes(metallic)

        found: dict[str, Any] = {}
        key = (*sources, diffuse.tobytes(), specular.tobytes(), gloss)
        for part, space in (("color", "srgb"), ("metallic", "linear"), ("roughness", "linear")):
            if part == "roughness" and second is None:
                found[part] = 1.0 - gloss
                continue
            found[part] = self._images.image(
                infos[-1], draft.where, partial(make, part), (part, *key), color_space=space
            )
        return found


def _triple(values: NDArray[Any]) -> Color:
    r, g, b = (float(x) for x in values)
    return r, g, b


def _holes(alpha: float, cutoff: float, pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Opacity of a cutoff: 1 where alpha is above it, 0 below, and between texels of which one is
    above and the next below, a ramp that is one texel wide: so edges lie where interpolated alpha
    crosses the cutoff, not on texels' borders.
    """
    values = linear(pixels, False, 3)[:, :, 0] * np.float32(alpha)
    slope = np.zeros_like(values)
    for axis in (0, 1):
        if values.shape[axis] > 1:
            step = np.abs(np.diff(values, axis=axis))
            after = [(0, 1) if a == axis else (0, 0) for a in (0, 1)]
            before = [(1, 0) if a == axis else (0, 0) for a in (0, 1)]
            slope = np.maximum(slope, np.maximum(np.pad(step, after), np.pad(step, before)))
    ramp = (values - np.float32(cutoff)) / np.maximum(slope, np.float32(1e-4)) + np.float32(0.5)
    return to_bytes(np.where(slope > 0.0, ramp, values >= np.float32(cutoff)))


def _scaled_normals(scale: float, pixels: NDArray[Any]) -> NDArray[np.uint16]:
    """Normals whose slopes are `scale` times as steep (glTF 2.0, 3.9.3)."""
    normals = linear(pixels, False, 0, 1, 2) * np.float32(2.0) - np.float32(1.0)
    normals *= np.array([scale, scale, 1.0], np.float32)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), np.float32(1e-6))
    stored = (normals * np.float32(0.5) + np.float32(0.5)) * np.float32(65535.0)
    return np.asarray(stored + np.float32(0.5), np.uint16)


def _alphas(strength: Any, roughness: Any) -> tuple[Any, Any]:
    """Along and across the direction of anisotropy (KHR_materials_anisotropy, Implementation)."""
    across = np.maximum(roughness * roughness, np.float32(1e-4))
    return across + (1.0 - across) * strength * strength, across


def _stretched_roughness(strength: Any, roughness: Any) -> Any:
    """Ours: the square root of the geometric mean of both alphas."""
    along, across = _alphas(strength, roughness)
    return (along * across) ** 0.25


def _stretch(strength: Any, roughness: Any) -> Any:
    """Our anisotropy a: the alphas have the ratio (1 + a) / (1 - a)."""
    along, across = _alphas(strength, roughness)
    return np.minimum((along - across) / (along + across), np.float32(0.99))


def _angles(turned: float, pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Degrees from u of the directions that red and green tell."""
    directions = linear(pixels, False, 0, 1) * np.float32(2.0) - np.float32(1.0)
    angle = np.arctan2(directions[:, :, 1], directions[:, :, 0]) + np.float32(turned)
    return np.asarray(np.degrees(angle) % np.float32(360.0), np.float32)


def _metallic(
    diffuse: NDArray[np.float32], specular: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Base colour and metallic of a diffuse and a specular colour.

    A base colour b, metallic in the share m, reflects (1 - m) b diffusely and
    0.04 (1 - m) + m b at normal incidence. Of luminances, m solves a quadratic equation; b then
    follows from either colour, and the more m there is the more it is taken from the specular one.
    """
    weights = np.array([0.2126, 0.7152, 0.0722], np.float32)
    diffuse = diffuse * (1.0 - specular.max(axis=-1, keepdims=True))
    d, s = diffuse @ weights, specular @ weights
    half = 0.5 * (d + s) - _DIELECTRIC
    root = np.sqrt(np.maximum(half * half - _DIELECTRIC * (_DIELECTRIC - s), 0.0))
    m = np.where(s <= _DIELECTRIC, 0.0, np.clip((root - half) / _DIELECTRIC, 0.0, 1.0))
    m = m.astype(np.float32)[..., None]
    from_diffuse = diffuse / np.maximum(1.0 - m, np.float32(1e-4))
    from_specular = (specular - _DIELECTRIC * (1.0 - m)) / np.maximum(m, np.float32(1e-4))
    color = from_diffuse + m * m * (from_specular - from_diffuse)
    return np.clip(color, 0.0, 1.0).astype(np.float32), m[..., 0]
