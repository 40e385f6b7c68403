"""Materials: glTF's metallic-roughness with its extensions is our `principled`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from math import degrees, log
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ... import scene
from ...display import srgb_encoded
from . import schema
from .images import Color, Images, in_bands, linear, times, to_bytes
from .source import Source

T = TypeVar("T")
Value = float | scene.Texture
Colors = Color | scene.Texture

WHITE = (1.0, 1.0, 1.0)
# Reflectance at normal incidence of an index of 1.5, glTF's default
_DIELECTRIC = 0.04
# The largest index that `principled` takes
_MOST_IOR = 10.0
_MOST_DISPERSION = 10.0
# The largest anisotropy that `principled` takes is 0.99; in single precision that is above it.
_MOST_STRETCH = np.nextafter(np.float32(0.99), np.float32(0.0))


@dataclass(frozen=True)
class Surface:
    """The material of a primitive: its name in the scene, the sets of texture coordinates that its
    textures lie on, and what the primitive's vertex colours add to its attributes.

    uv_set: of the mesh's uvs. others: those that become attributes, by `uv_name`. textured: some
    texture lies on the mesh's uvs. oriented: it needs tangents.
    """

    name: str
    uv_set: int
    others: tuple[int, ...]
    textured: bool
    oriented: bool
    attributes: dict[str, NDArray[np.float32]]


def uv_name(uv_set: int) -> str:
    """The attribute of a mesh that has a further set of texture coordinates."""
    return f"vertex_uv{uv_set}"


@dataclass
class _Draft:
    """A material on its way, by the extensions of its document's."""

    source: schema.Material
    where: str
    uv_set: int = 0
    others: set[int] = field(default_factory=set)
    textured: bool = False
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
        self._names: dict[str, int] = {}
        self._surfaces: dict[tuple[Any, ...], tuple[str, _Draft]] = {}

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
            # tangents, which normal maps need, come from a mesh's own uvs if it has none
            first = source.normal_texture or self._base_texture(draft)
            if first is not None:
                draft.uv_set = self._images.uv_set(first, draft.where)
            material = self._material(draft)
            name = self._name(source.name or ("default" if index is None else f"material {index}"))
            self.made[name] = material
            self._surfaces[key] = (name, draft)
        name, made = self._surfaces[key]
        attributes = self._attributes(draft, colors)
        return Surface(
            name=name,
            uv_set=made.uv_set,
            others=tuple(made.others),
            textured=made.textured,
            oriented=source.normal_texture is not None
            or "KHR_materials_anisotropy" in source.extensions,
            attributes=attributes,
        )

    def _name(self, name: str) -> str:
        """The name, with a number if another material has it."""
        chosen = name
        while chosen in self.made:
            self._names[name] = self._names.get(name, 1) + 1
            chosen = f"{name} {self._names[name]}"
        return chosen

    # Vertex colours

    def _take_colors(self, draft: _Draft, colors: NDArray[np.float32]) -> None:
        """Decides how vertex colours come in: as a factor where all are the same, as they often
        are, else as an attribute.
        """
        if len(colors) and bool((colors == colors[:1]).all()):
            red, green, blue = (float(x) for x in np.clip(colors[0, :3], 0.0, 1.0))
            draft.tint = (red, green, blue)
            if colors.shape[1] == 4:
                draft.alpha = float(np.clip(colors[0, 3], 0.0, 1.0))
            return
        draft.vertex_color = True
        if colors.shape[1] == 3 or draft.source.alpha_mode == "OPAQUE":
            return
        draft.vertex_alpha = bool((colors[:, 3] < 1.0).any())
        if draft.source.alpha_mode == "MASK" and self._base_texture(draft) is not None:
            self._source.report(
                "alphaMode MASK with a texture and vertex colours: the vertices' alpha is ignored"
            )
            draft.vertex_alpha = False

    def _base_texture(self, draft: _Draft) -> schema.TextureInfo | None:
        glossy = self._extension(draft, "pbrSpecularGlossiness", schema.SpecularGlossiness)
        if glossy is not None:
            return glossy.diffuse_texture or glossy.specular_glossiness_texture
        return draft.source.pbr_metallic_roughness.base_color_texture

    def _attributes(
        self, draft: _Draft, colors: NDArray[np.float32] | None
    ) -> dict[str, NDArray[np.float32]]:
        """Vertex colours, with their material's factor unless that is part of its textures."""
        if colors is None:
            return {}
        factor = np.array(self._base_factor(draft), np.float32)
        if "KHR_materials_pbrSpecularGlossiness" in draft.source.extensions:
            factor[:3] = 1.0
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

    def _uvs(self, draft: _Draft, info: schema.TextureInfo, where: str) -> str | None:
        """The attribute with the coordinates of a texture, if those are not the mesh's uvs."""
        uv_set = self._images.uv_set(info, where)
        if uv_set == draft.uv_set:
            draft.textured = True
            return None
        draft.others.add(uv_set)
        return uv_name(uv_set)

    def _color(
        self, draft: _Draft, info: schema.TextureInfo | None, factor: Color, name: str
    ) -> Colors:
        """A colour, of which glTF multiplies an encoded texture with a linear factor."""
        where = f"{draft.where}.{name}"
        if info is None or max(factor) == 0.0:
            return factor
        return self._images.color(info, factor, where, self._uvs(draft, info, where)) or factor

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
        made = None
        if info is not None and factor > 0.0:
            uvs = self._uvs(draft, info, where)
            made = self._images.number(info, channel, factor, curve, where, uvs)
        if made is not None:
            return made
        return factor if curve is None else float(curve(np.float32(factor)))

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
            if draft.vertex_color:  # they have it
                factor = WHITE
            base = self._color(draft, alpha_info, factor, "pbrMetallicRoughness.baseColorTexture")
            info = pbr.metallic_roughness_texture
            name = "pbrMetallicRoughness.metallicRoughnessTexture"
            params["metallic"] = self._number(draft, info, 2, pbr.metallic_factor, name)
            params |= self._roughness(draft, info, pbr.roughness_factor, name)
        if draft.vertex_color:
            base = times(scene.Texture("attribute", name="vertex_color"), base)
        common = self._common(draft, alpha_info, min(max(alpha, 0.0), 1.0) * draft.alpha)
        if "KHR_materials_unlit" in m.extensions:
            common.pop("normal_map", None)
            common |= {"emission": base, "two_sided_emission": True}
            return scene.Material("diffuse", color=(0.0, 0.0, 0.0), **common)
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
        name = "pbrMetallicRoughness.baseColorTexture"
        where = f"{draft.where}.{name}"
        if info is not None and not self._images.has_alpha(info, where):
            info = None
        if draft.vertex_alpha:  # which has the factor
            own = scene.Texture("attribute", name="vertex_alpha")
            share = self._number(draft, info, 3, 1.0, name)
            return times(share, own) if isinstance(share, scene.Texture) else own
        if mode == "BLEND":
            return self._number(draft, info, 3, alpha, name)
        if info is None:
            return 1.0 if alpha >= cutoff else 0.0
        uvs, make = self._uvs(draft, info, where), partial(_holes, alpha, cutoff)
        return self._images.image(info, where, uvs, make, ("mask", alpha, cutoff)) or 1.0

    def _normals(self, draft: _Draft, info: schema.TextureInfo) -> scene.Texture | None:
        where = f"{draft.where}.normalTexture"
        uvs = self._uvs(draft, info, where)
        if info.scale == 1.0:
            return self._images.plain(info, where, uvs)
        make = partial(in_bands, partial(_scaled_normals, info.scale))
        return self._images.image(info, where, uvs, make, ("normals", info.scale))

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
        uvs, make = self._uvs(draft, texture, where), partial(in_bands, partial(_angles, turned))
        angles = self._images.image(
            texture, where, uvs, make, ("angles", turned), smooth=False, channel="r"
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
        sheet = self._extension(draft, "diffuse_transmission", schema.DiffuseTransmission)
        if sheet is not None and (sheet.diffuse_transmission_factor <= 0.0 or metallic == 1.0):
            sheet = None
        if glass is None or glass.transmission_factor <= 0.0 or metallic == 1.0:
            return opaque if sheet is None else self._sheet(draft, sheet, base, params, common)
        if sheet is not None:
            self._source.report(
                "KHR_materials_diffuse_transmission with KHR_materials_transmission: not supported"
                " together; only the latter is used"
            )

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
            rainbow = self._extension(draft, "dispersion", schema.Dispersion)
            if rainbow is not None:
                params["dispersion"] = min(max(rainbow.dispersion, 0.0), _MOST_DISPERSION)
            return scene.Material("principled", color=base, **params, **common)
        if isinstance(metallic, scene.Texture):
            self._source.report(
                "KHR_materials_transmission without a volume, on what a texture makes metal in"
                " places: not supported; the metal transmits too"
            )
            metallic = 0.0
        weight = share(glass.transmission_factor * (1.0 - metallic))
        pane = {"ior": params.get("ior", 1.5), "transmittance": base, "roughness": roughness}
        if weight == 1.0:
            return scene.Material("thin_dielectric", **pane, **common)
        return scene.Material(
            "blend",
            a=scene.Material("principled", color=base, **params),
            b=scene.Material("thin_dielectric", **pane),
            weight=weight,
            **common,
        )

    def _sheet(
        self,
        draft: _Draft,
        sheet: schema.DiffuseTransmission,
        base: Colors,
        params: dict[str, Any],
        common: dict[str, Any],
    ) -> scene.Material:
        """A surface that lets some of the light through that it would scatter back."""
        place = "extensions.KHR_materials_diffuse_transmission."
        share = self._number(
            draft,
            sheet.diffuse_transmission_texture,
            3,
            sheet.diffuse_transmission_factor,
            f"{place}diffuseTransmissionTexture",
        )
        r, g, b = sheet.diffuse_transmission_color_factor
        through = self._color(
            draft,
            sheet.diffuse_transmission_color_texture,
            (r, g, b),
            f"{place}diffuseTransmissionColorTexture",
        )
        volume = self._extension(draft, "volume", schema.Volume)
        if volume is not None and volume.thickness_factor > 0.0:
            self._source.report(
                "KHR_materials_diffuse_transmission with a volume: not supported; light passes as"
                " through a sheet"
            )
        metallic = params["metallic"]
        matte = metallic == 0.0 and params.get("specular", 1.0) == 0.0
        matte = matte and not {"clearcoat", "sheen_color", "iridescence"} & params.keys()
        if matte and not isinstance(share, scene.Texture):
            return scene.Material(
                "diffuse_transmission",
                color=_scaled(base, 1.0 - share),
                transmittance=_scaled(through, share),
                **common,
            )
        if not matte:
            self._source.report(
                "KHR_materials_diffuse_transmission of what shines: not supported in full; the"
                " share that passes light is matte"
            )
        if isinstance(metallic, scene.Texture):
            self._source.report(
                "KHR_materials_diffuse_transmission on what a texture makes metal in places: not"
                " supported; the metal lets light through too"
            )
            metallic = 0.0
        kept = 1.0 - metallic
        weight = times(share, (kept,) * 3) if isinstance(share, scene.Texture) else share * kept
        return scene.Material(
            "blend",
            a=scene.Material("principled", color=base, **params),
            b=scene.Material("diffuse_transmission", color=(0.0,) * 3, transmittance=through),
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
        if first is not None and second is not None and not self._alike(first, second, where):
            self._source.report(
                "KHR_materials_pbrSpecularGlossiness with two textures that lie differently: the"
                " mean of the specular one is used"
            )
            specular *= [self._images.mean(second, c, True, where[1]) for c in range(3)]
            gloss *= self._images.mean(second, 3, False, where[1])
            second = None
        if second is None and first is not None and max(specular) <= _DIELECTRIC:  # no metal
            color = self._color(draft, first, _triple(diffuse), f"{place}diffuseTexture")
            return {"color": color, "metallic": 0.0, "roughness": 1.0 - gloss}
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

        stored = [self._images.pixels(i) for i in sources if i is not None]
        height, width = max((p.shape[:2] for p in stored), key=lambda s: s[0] * s[1])
        body, shine = stored[0] if first else None, stored[-1] if second else None

        def texels(pixels: NDArray[Any] | None, rows: NDArray[Any]) -> NDArray[Any]:
            """Linear texels of some rows, the nearest ones where another image has more."""
            if pixels is None:
                return np.ones((len(rows), width, 4), np.float32)
            y = rows * len(pixels) // height
            x = np.arange(width) * pixels.shape[1] // width
            return linear(pixels[y[:, None], x], True, 0, 1, 2, 3)

        def make(part: str, rows: NDArray[Any]) -> NDArray[Any]:
            matte, mirror = texels(body, rows), texels(shine, rows)
            if part == "roughness":
                return to_bytes(1.0 - gloss * mirror[:, :, 3])
            color, metallic = _metallic(diffuse * matte[:, :, :3], specular * mirror[:, :, :3])
            return to_bytes(srgb_encoded(color)) if part == "color" else to_bytes(metallic)

        def bands(part: str, _: NDArray[Any]) -> NDArray[Any]:
            return in_bands(partial(make, part), np.arange(height))

        found: dict[str, Any] = {}
        uvs = self._uvs(draft, infos[-1], where[-1])
        key = (*sources, diffuse.tobytes(), specular.tobytes(), gloss)
        for part, space in (("color", "srgb"), ("metallic", "linear"), ("roughness", "linear")):
            if part == "roughness" and second is None:
                found[part] = 1.0 - gloss
                continue
            found[part] = self._images.image(
                infos[-1], draft.where, uvs, partial(bands, part), (part, *key), color_space=space
            )
        return found

    def _alike(
        self, first: schema.TextureInfo, second: schema.TextureInfo, where: list[str]
    ) -> bool:
        """Whether two textures lie on a surface in the same way."""
        sets = [self._images.uv_set(i, w) for i, w in zip((first, second), where, strict=True)]
        moves = [bytes(i.extensions.get("KHR_texture_transform", b"")) for i in (first, second)]
        return sets[0] == sets[1] and moves[0] == moves[1]


def _triple(values: NDArray[Any]) -> Color:
    r, g, b = (float(x) for x in values)
    return r, g, b


def _scaled(color: Colors, factor: float) -> Colors:
    if isinstance(color, scene.Texture):
        return times(color, (factor, factor, factor))
    r, g, b = color
    return r * factor, g * factor, b * factor


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
    return np.minimum((along - across) / (along + across), _MOST_STRETCH)


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
