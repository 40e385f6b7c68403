"""UsdPreviewSurface, its textures and primvar readers: our principled material.

The UsdPreviewSurface specification (openusd.org/release/spec_usdpreviewsurface.html) is the
reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf, UsdGeom, UsdShade

from ...scene import Material, Texture
from . import primvars
from .primvars import Need

if TYPE_CHECKING:
    from .reader import Reader

Value = float | tuple[float, ...] | Texture

_WRAPS = {"black": "zero", "clamp": "clamp", "repeat": "repeat", "mirror": "mirror"}
# Reflectance at normal incidence of the largest index of refraction that a principled material has
_MOST_REFLECTANCE = (9.0 / 11.0) ** 2
# Numbers of what a primvar reader's type ends in
_WIDTHS = {"float": 1, "float2": 2, "float3": 3, "float4": 3, "int": 1, "normal": 3, "point": 3,
           "vector": 3}  # fmt: skip


@dataclass
class Look:
    """What a surface is made of.

    material: the name of one of the scene's, or one. needs: the primvars it reads. uvs: the one of
    them that is a mesh's uvs; the others are attributes.
    """

    material: str | Material
    needs: dict[str, Need] = field(default_factory=dict)
    uvs: str | None = None


@dataclass
class Plain:
    """A material, and colours of primitives in its place, or None."""

    material: str | Material
    colors: Any


def report_missing(r: Reader, prim: Any) -> None:
    """Tells of materials that a prim is bound to and that are not there."""
    for binding in prim.GetAuthoredRelationships():
        parts = binding.GetName().split(":")
        if parts[:2] != ["material", "binding"] or "full" in parts:  # which we do not read
            continue
        for target in binding.GetForwardedTargets():
            if target.IsPrimPath() and not r.stage.GetPrimAtPath(target):
                r.report(f"{prim.GetPath()}: its material {target} is not there; ignored")


def look(r: Reader, prim: Any, double_sided: bool, owner: Any = None) -> Look:
    """Of the material bound to a prim, else of its displayColor. owner: the mesh of a subset."""
    bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(UsdShade.Tokens.preview)
    made = _bound(r, bound, double_sided) if bound else None
    return made or _display(owner or prim)


def plain(r: Reader, prim: Any, sizes: dict[str, int] | None = None) -> Plain:
    """For what has no uvs nor attributes. sizes: how many values each interpolation has.

    Colours are (1, 3) if constant, else as many as their interpolation has.
    """
    bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(UsdShade.Tokens.preview)
    made = _bound(r, bound, False) if bound else None
    if made is not None:
        if made.needs:
            r.report(
                f"{prim.GetTypeName()} prims, such as {prim.GetPath()}: textures by primvar"
                f" ({', '.join(made.needs)}): not supported there"
            )
        return Plain(made.material, None)
    sizes = sizes or dict.fromkeys(("constant", "uniform", "vertex", "varying", "faceVarying"), 1)
    color = primvars.display_color(r, prim, sizes)
    opacity = primvars.read(r, prim, "displayOpacity", sizes, 1)
    params: dict[str, Any] = {}
    if opacity is not None:
        params["opacity"] = float(opacity.values.mean().clip(0.0, 1.0))
        if np.ptp(opacity.values) > 0.0:
            r.report(f"displayOpacity of each part of {prim.GetPath()}: their mean is used")
    return Plain(Material("diffuse", **params), None if color is None else color.values)


def _display(prim: Any) -> Look:
    """DisplayColor and displayOpacity, which are primvars like others."""
    known = UsdGeom.PrimvarsAPI(prim)

    def there(name: str) -> bool:
        primvar = known.FindPrimvarWithInheritance(name)
        return bool(primvar) and bool(primvar.HasValue())

    params: dict[str, Any] = {}
    needs = {}
    if there("displayColor"):
        params["color"] = Texture("attribute", name="vertex_displayColor")
        needs["displayColor"] = Need(3, (0.5, 0.5, 0.5))
    if there("displayOpacity"):
        params["opacity"] = Texture("attribute", name="vertex_displayOpacity")
        needs["displayOpacity"] = Need(1, (1.0,))
    return Look(Material("diffuse", **params), needs)


def _bound(r: Reader, material: Any, double_sided: bool) -> Look | None:
    """A Material prim's look, made once; None if it has no surface that we know."""
    key = (str(material.GetPath()), double_sided)
    if key not in r.looks:
        r.looks[key] = _read(r, material, double_sided)
    found: Look | None = r.looks[key]
    return found


def _read(r: Reader, material: Any, double_sided: bool) -> Look | None:
    path = str(material.GetPath())
    surface = material.ComputeSurfaceSource()[0]
    if not surface:
        r.report(f"material {path}: has no surface for all renderers; displayColor is used")
        return None
    kind = str(surface.GetIdAttr().Get())
    if kind != "UsdPreviewSurface":
        r.report(f"surface {kind!r}, such as {surface.GetPath()}: not supported; displayColor used")
        return None
    for what in ("displacement", "volume"):
        output = material.GetOutput(what)
        if output and output.HasConnectedSource() and what == "volume":
            r.report(f"material {path}: volume: not supported; ignored")
    made = _Surface(r, surface)
    params = made.params()
    if double_sided and "emission" in params:
        params["two_sided_emission"] = True
        if (path, False) in r.looks:
            path += " (double-sided)"
    r.materials[path] = Material("principled", **params)
    return Look(path, made.needs, made.uvs)


class _Surface:
    """One UsdPreviewSurface on its way to the parameters of a principled material."""

    def __init__(self, r: Reader, shader: Any) -> None:
        self.r = r
        self.shader = shader
        self.needs: dict[str, Need] = {}
        self.uvs: str | None = None

    def params(self) -> dict[str, Any]:
        found: dict[str, Any] = {}
        # first, for normals are relative to the directions of a mesh's own uvs
        normal = self.value("normal", (0.0, 0.0, 1.0), normals=True)
        if isinstance(normal, Texture):
            found["normal_map"] = normal
        elif normal != (0.0, 0.0, 1.0):
            self.r.report(f"{self.shader.GetPath()}: a constant normal: not supported; ignored")
        found["color"] = self.color("diffuseColor", 0.18)
        emission = self.color("emissiveColor", 0.0, 1e12)
        if isinstance(emission, Texture) or any(emission):
            found["emission"] = emission
        found["roughness"] = self.number("roughness", 0.5)
        found["ior"] = self.constant("ior", 1.5, 1.0, 10.0)
        found["clearcoat"] = self.number("clearcoat", 0.0)
        found["clearcoat_roughness"] = self.number("clearcoatRoughness", 0.01)
        if self.constant("useSpecularWorkflow", 0.0, 0.0, 1.0):
            found |= _specular(self.color("specularColor", 0.0))
        else:
            found["metallic"] = self.number("metallic", 0.0)
        opacity = self.opacity()
        if opacity != 1.0:
            found["opacity"] = opacity
        displacement = self.value("displacement", 0.0)
        if isinstance(displacement, Texture) or displacement != 0.0:
            self.r.report(f"displacement of {self.shader.GetPath()}: not supported; ignored")
        return found

    # Inputs

    def color(self, name: str, default: float, most: float = 1.0) -> Any:
        """A colour within range, or a texture."""
        value = self.value(name, (default,) * 3)
        if isinstance(value, Texture):
            return value
        wide = (value,) * 3 if isinstance(value, float) else (*value, *value, *value)[:3]
        return tuple(min(max(v, 0.0), most) for v in wide)

    def number(self, name: str, default: float) -> Any:
        """A number from 0 to 1, or a texture."""
        value = self.value(name, default)
        if isinstance(value, Texture):
            return value
        first = value if isinstance(value, float) else value[0]
        return min(max(first, 0.0), 1.0)

    def constant(self, name: str, default: float, low: float, high: float) -> float:
        """A number that no texture may stand for."""
        value = self.value(name, default)
        if isinstance(value, Texture):
            self.r.report(f"{name} of {self.shader.GetPath()}: no texture is supported there")
            value = default
        first = value if isinstance(value, float) else value[0]
        return min(max(first, low), high)

    def opacity(self) -> Any:
        """Holes; with a threshold, all or nothing."""
        threshold = self.constant("opacityThreshold", 0.0, 0.0, 1.0)
        value = self.value("opacity", 1.0, threshold=threshold)
        if isinstance(value, Texture):
            if threshold == 0.0:
                self.clear()
            return value
        number = min(max(value if isinstance(value, float) else value[0], 0.0), 1.0)
        if threshold > 0.0:
            return float(number >= threshold)
        if number < 1.0:
            self.clear()
        return number

    def clear(self) -> None:
        """Reports what holes lack of clear parts, unless they are asked for."""
        mode = self.shader.GetInput("opacityMode")
        if not mode or self.r.get(mode.GetAttr()) != "presence":
            self.r.report("opacityMode 'transparent': clear parts have no highlights")

    def value(
        self, name: str, default: Value, *, normals: bool = False, threshold: float = 0.0
    ) -> Value:
        """An input's constant, or the texture that it is connected to."""
        sources = self.sources(self.shader, name)
        if not sources:
            return default
        source = sources[0]
        if UsdShade.Utils.GetType(source.GetName()) != UsdShade.AttributeType.Output:
            plain: Value = self.plain(source, default)
            return plain
        node = UsdShade.Shader(source.GetPrim())
        kind = str(node.GetIdAttr().Get()) if node else "?"
        if kind == "UsdUVTexture":
            output = UsdShade.Output(source).GetBaseName()
            return self.image(node, str(output), default, normals, threshold)
        if kind.startswith("UsdPrimvarReader_"):
            return self.attribute(node, kind.partition("_")[2], default)
        self.r.report(f"{kind} as {name} of {self.shader.GetPath()}: not supported; ignored")
        return default

    def sources(self, shader: Any, name: str) -> list[Any]:
        """Attributes that an input gets its value from, through node graphs and interfaces."""
        value = shader.GetInput(name)
        return list(value.GetValueProducingAttributes()) if value else []

    def plain(self, attribute: Any, default: Any) -> Any:
        """A number or several; of what is none or not finite, the default."""
        value = self.r.get(attribute)
        if isinstance(value, (bool, int, float)):
            numbers: Any = float(value)
        else:
            try:
                numbers = tuple(float(v) for v in value)
            except (TypeError, ValueError):
                numbers = default
        if not np.isfinite(np.asarray(numbers, np.float64)).all():
            raise self.r.error(attribute.GetPrim(), f"{attribute.GetName()} is not finite")
        return numbers

    def setting(self, shader: Any, name: str, default: Any) -> Any:
        """What an input that is no number says."""
        found = self.sources(shader, name)
        return self.r.get(found[0], default) if found else default

    def numbers(self, shader: Any, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
        found = self.sources(shader, name)
        value: Any = self.plain(found[0], default) if found else default
        return value if isinstance(value, tuple) and len(value) == len(default) else default

    # Textures

    def attribute(self, node: Any, kind: str, default: Value) -> Value:
        """A primvar: an attribute of meshes."""
        name = str(self.setting(node, "varname", ""))
        width = _WIDTHS.get(kind)
        if not name or width is None:
            self.r.report(f"{node.GetPath()}: a primvar reader of {kind} {name!r}: not supported")
            return default
        fallback = self.sources(node, "fallback")
        self.need(name, width, self.plain(fallback[0], 0.0) if fallback else 0.0)
        return Texture("attribute", name=f"vertex_{name}")

    def need(self, name: str, width: int, fallback: Any) -> None:
        values = (fallback,) * width if isinstance(fallback, float) else tuple(fallback)[:width]
        values += (0.0,) * (width - len(values))
        if name not in self.needs or self.needs[name].width < width:
            self.needs[name] = Need(width, values)

    def coordinates(self, node: Any) -> dict[str, Any]:
        """Uvs and transform of a texture; without a reader, of the primvar st."""
        matrix = np.eye(3)
        found = self.sources(node, "st")
        for _ in range(8):  # transforms of transforms
            reader = UsdShade.Shader(found[0].GetPrim()) if found else None
            kind = str(reader.GetIdAttr().Get()) if reader else ""
            if kind != "UsdTransform2d":
                break
            matrix = matrix @ self.transform(reader)
            found = self.sources(reader, "in")
        name = "st"
        if kind == "UsdPrimvarReader_float2":
            name = str(self.setting(reader, "varname", "")) or name
            fallback = self.sources(reader, "fallback")
            self.need(name, 2, self.plain(fallback[0], 0.0) if fallback else 0.0)
        else:
            if kind:
                self.r.report(f"{kind} as st of {node.GetPath()}: not supported; st is used")
            self.need(name, 2, 0.0)
        params: dict[str, Any] = {}
        if self.uvs is None:
            self.uvs = name
        if self.uvs != name:
            params["uvs"] = f"vertex_{name}"
        if not np.array_equal(matrix, np.eye(3)):
            params["transform"] = tuple(map(tuple, matrix[:2].tolist()))
        return params

    def transform(self, node: Any) -> Any:
        """(3, 3) of UsdTransform2d: scaled, then turned counter-clockwise, then moved."""
        angle = np.radians(
            self.plain(self.sources(node, "rotation")[0], 0.0)
            if self.sources(node, "rotation")
            else 0.0
        )
        scale = self.numbers(node, "scale", (1.0, 1.0))
        shift = self.numbers(node, "translation", (0.0, 0.0))
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        matrix = np.eye(3)
        matrix[:2, :2] = turned * scale
        matrix[:2, 2] = shift
        return matrix

    def image(
        self, node: Any, output: str, default: Value, normals: bool, threshold: float
    ) -> Value:
        """UsdUVTexture: the output rgb, r, g, b or a of a picture, times scale, plus bias."""
        fallback = self.numbers(node, "fallback", (0.0, 0.0, 0.0, 1.0))
        place = "rgba".find(output) if len(output) == 1 else -1
        missing: Value = fallback[:3] if place < 0 else fallback[place]
        asset = self.setting(node, "file", None)
        if not isinstance(asset, Sdf.AssetPath) or not asset.path:
            return missing
        if "<UDIM>" in asset.path:
            self.r.report(f"UDIM textures, such as {asset.path}: not supported; ignored")
            return default
        where = self.r.where(node.GetPrim())
        picture = self.r.images.image(asset, where)
        if picture is None:
            self.r.report(f"{node.GetPath()}: {asset.path!r}: no such file; its fallback is used")
            return missing
        srgb = self.encoded(node, asset, normals, where)
        params: dict[str, Any] = {
            "image": picture,
            "color_space": "srgb" if srgb else "linear",
            **self.wrapping(node),
            **self.coordinates(node),
        }
        if place >= 0:
            params["channel"] = output
        scale = np.array(self.numbers(node, "scale", (1.0,) * 4))
        bias = np.array(self.numbers(node, "bias", (0.0,) * 4))
        chosen = slice(0, 3) if place < 0 else slice(place, place + 1)
        scale, bias = scale[chosen], bias[chosen]
        if normals:
            # a texel of 0 to 1 holds what lies from -1 to 1
            scale, bias = 0.5 * scale, 0.5 * bias + 0.5
        if threshold > 0.0:
            values = self.r.images.linear(asset, srgb, where)[:, :, chosen] * scale + bias
            params["image"] = self.made(
                asset,
                srgb,
                ("mask", place, threshold, *scale, *bias),
                lambda: (values.mean(axis=2) >= threshold).astype(np.uint8) * np.uint8(255),
            )
            return Texture("image", **params | {"color_space": "linear", "channel": "rgb"})
        if (scale == 1.0).all() and (bias == 0.0).all():
            return Texture("image", **params)
        if (bias == 0.0).all() and (scale >= 0.0).all() and not normals:
            color = tuple(scale.tolist()) if place < 0 else (float(scale[0]),) * 3
            return Texture("multiply", color0=Texture("image", **params), color1=color)
        params["image"] = self.made(
            asset,
            srgb,
            ("linear", place, *scale, *bias),
            lambda: (
                (self.r.images.linear(asset, srgb, where)[:, :, chosen] * scale + bias)
                .clip(0.0, None)
                .astype(np.float32)
            ),
        )
        return Texture("image", **params | {"color_space": "linear", "channel": "rgb"})

    def made(self, asset: Any, srgb: bool, how: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        """Pixels that are computed once for all materials."""
        key = (asset.resolvedPath, srgb, *how)
        if key not in self.r.looks:
            pixels = make()
            self.r.looks[key] = pixels[:, :, 0] if pixels.shape[2:] == (1,) else pixels
        return self.r.looks[key]

    def encoded(self, node: Any, asset: Any, normals: bool, where: str) -> bool:
        """Whether the picture is sRGB. Normals never are, whatever a file forgets to say."""
        space = str(self.setting(node, "sourceColorSpace", "auto"))
        if space == "auto":
            return not normals and self.r.images.has_colors(asset, where)
        return space == "sRGB"

    def wrapping(self, node: Any) -> dict[str, str]:
        """What lies beside the picture; by default it is black."""
        found = {}
        for key, name in (("wrap_u", "wrapS"), ("wrap_v", "wrapT")):
            mode = str(self.setting(node, name, "useMetadata"))
            found[key] = _WRAPS.get(mode, "zero")
        return found


def _specular(color: Any) -> dict[str, Any]:
    """SpecularColor is what is reflected at normal incidence: an index times a tint."""
    if isinstance(color, Texture):
        tint: Any = Texture("multiply", color0=color, color1=(1.0 / _MOST_REFLECTANCE,) * 3)
        return {"ior": 10.0, "specular_color": tint}
    most = max(color)
    if most == 0.0:
        return {"specular": 0.0}
    most = min(most, _MOST_REFLECTANCE)
    root = most**0.5
    return {
        "ior": min((1.0 + root) / (1.0 - root), 10.0),
        "specular_color": tuple(min(c / most, 1.0) for c in color),
    }
