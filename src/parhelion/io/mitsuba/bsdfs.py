"""<bsdf>: what surfaces do with light.

Mitsuba's opaque materials are black from behind unless in a <bsdf type="twosided">; ours are so
with two_sided=False, which each of them gets.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from ... import spectra
from ...errors import unknown_name
from ...scene import Material, Texture
from . import pixels
from .document import Object, Value
from .reader import Color, Reader

_BLACK = Material("diffuse", color=(0.0, 0.0, 0.0))
_GREY = Material("diffuse", color=(0.5, 0.5, 0.5), two_sided=False)

# Indices of refraction by name, of Mitsuba 3's documentation ("dielectric"), at 589.3 nm
_IOR = {
    "vacuum": 1.0,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "air": 1.000277,
    "carbon dioxide": 1.00045,
    "water ice": 1.31,
    "water": 1.3330,
    "acetone": 1.36,
    "ethanol": 1.361,
    "fused quartz": 1.458,
    "carbon tetrachloride": 1.461,
    "pyrex": 1.470,
    "glycerol": 1.4729,
    "acrylic glass": 1.49,
    "polypropylene": 1.49,
    "benzene": 1.501,
    "bk7": 1.5046,
    "silicone oil": 1.52045,
    "sodium chloride": 1.544,
    "amber": 1.55,
    "pet": 1.5750,
    "bromine": 1.661,
    "diamond": 2.419,
}


def read(r: Reader, o: Object) -> Material:
    """The material that an object is."""
    return r.make(o, BSDFS, _GREY)


def one(r: Reader, o: Object) -> Material:
    """The single material in another."""
    inner = r.nested(o, "bsdf")
    if len(inner) != 1:
        raise o.error(f"has {len(inner)} bsdfs in it; needs 1")
    return read(r, inner[0])


def changed(material: Material, *without: str, **params: Any) -> Material:
    """The material with parameters replaced, and others taken away."""
    kept = {k: v for k, v in material.params.items() if k not in without}
    return Material(material.type, **{**kept, **params})


def _opaque(type: str, **params: Any) -> Material:
    return Material(type, two_sided=False, **params)


def _ior(r: Reader, o: Object, name: str, default: str) -> float:
    item = r.get(o, name)
    if item is None:
        return _IOR[default]
    if isinstance(item, Value) and item.tag == "string":
        if item.data.lower() not in _IOR:
            raise o.error(f"{name}: {unknown_name('substance', item.data, _IOR)}")
        return _IOR[item.data.lower()]
    if isinstance(item, Value) and item.tag in ("float", "integer"):
        return float(item.data)
    raise o.error(f"property {name!r} must be a number or a name: {', '.join(_IOR)}")


def _ratio(r: Reader, o: Object, inside: str) -> float:
    """Index of refraction, inside over outside."""
    outside = _ior(r, o, "ext_ior", "air")
    if not outside > 0.0:
        raise o.error(f"ext_ior is {outside:g}; must be above 0")
    return _ior(r, o, "int_ior", inside) / outside


def _roughness(r: Reader, o: Object) -> dict[str, Any]:
    """roughness, anisotropy and distribution, where alpha_u = roughness^2 / q, alpha_v = .. * q."""
    distributions = {"beckmann": "beckmann", "ggx": "ggx"}
    found: dict[str, Any] = {
        "distribution": r.choice(o, "distribution", "beckmann", distributions),
        "compensation": "off",  # Mitsuba has none
    }
    r.ignore(o, "sample_visible")
    if not (r.has(o, "alpha_u") or r.has(o, "alpha_v")):
        alpha = r.scalar(o, "alpha", 0.1)
        return found | {"roughness": _root(r, o, alpha)}
    u, v = (r.scalar(o, name, 0.1) for name in ("alpha_u", "alpha_v"))
    if isinstance(u, Texture) or isinstance(v, Texture):
        r.report(
            f"properties 'alpha_u', 'alpha_v' of {o}: no texture is supported there; 0.1 is used"
        )
        u = v = 0.1
    if not (u > 0.0 and v > 0.0):
        raise o.error(f"alpha_u and alpha_v are {u:g} and {v:g}; must be above 0")
    anisotropy = (u - v) / (u + v)
    return found | {"roughness": (u * v) ** 0.25, "anisotropy": anisotropy}


def _root(r: Reader, o: Object, alpha: float | Texture) -> float | Texture:
    """Roughness, whose square alpha is."""
    if not isinstance(alpha, Texture):
        if not alpha >= 0.0:
            raise o.error(f"alpha is {alpha:g}; must be 0 or above")
        return math.sqrt(alpha)
    if alpha.type == "checker":
        roots = {k: tuple(map(math.sqrt, alpha.params[k])) for k in ("color0", "color1")}
        return Texture("checker", **{**alpha.params, **roots})
    if alpha.type == "image":
        values = pixels.read(alpha.params["image"], alpha.params["color_space"])
        params = {
            **alpha.params,
            "image": np.sqrt(np.maximum(values, 0.0)),
            "color_space": "linear",
        }
        return Texture("image", **params)
    r.report(f"property 'alpha' of {o}: texture {alpha.type!r} is not supported there; 0.1 is used")
    return math.sqrt(0.1)


def _diffuse(r: Reader, o: Object) -> Material:
    return _opaque("diffuse", color=r.color(o, "reflectance", 0.5))


def _rough_diffuse(r: Reader, o: Object) -> Material:
    r.report(f"{o}: Oren-Nayar is rendered by another rough diffuse model")
    r.ignore(o, "use_fast_approx")
    # Oren and Nayar's sigma, in radians, is alpha / sqrt(2) there
    alpha = r.scalar(o, "alpha", 0.2)
    return _opaque(
        "diffuse",
        color=r.color(o, "reflectance", 0.5),
        roughness=alpha if isinstance(alpha, Texture) else min(alpha, 1.0),
    )


def _conductor(r: Reader, o: Object) -> Material:
    return _opaque("conductor", roughness=0.0, compensation="off", **_metal(r, o))


def _rough_conductor(r: Reader, o: Object) -> Material:
    return _opaque("conductor", **_roughness(r, o), **_metal(r, o))


def _metal(r: Reader, o: Object) -> dict[str, Any]:
    given = r.has(o, "eta") or r.has(o, "k")
    name = r.string(o, "material", "none")
    if given and r.has(o, "material"):
        raise o.error("has both a material and eta, k")
    eta, k = _named(o, name)
    if given:
        eta = r.plain(o, "eta", 0.0, index=True)
        k = r.plain(o, "k", 1.0, index=True)
    outside = 1.0
    if r.has(o, "ext_eta"):  # version 0.x
        outside = _ior(r, o, "ext_eta", "air")
        if not outside > 0.0:
            raise o.error(f"ext_eta is {outside:g}; must be above 0")
    return {
        "color": r.color(o, "specular_reflectance", 1.0),
        "eta": tuple(x / outside for x in eta),
        "k": tuple(x / outside for x in k),
    }


@cache
def _conductors() -> dict[str, tuple[Color, Color]]:
    text = (files(__package__) / "conductors.txt").read_text(encoding="ascii")
    rows = (line.split() for line in text.splitlines() if not line.startswith("#"))
    numbers = ((row[0], [float(x) for x in row[1:]]) for row in rows)
    return {name: ((a, b, c), (d, e, f)) for name, (a, b, c, d, e, f) in numbers}


def _named(o: Object, name: str) -> tuple[Color, Color]:
    """Eta and k by name: Mitsuba's own numbers, else ours."""
    if name in _conductors():
        return _conductors()[name]
    if name not in spectra.metals():
        raise o.error(unknown_name("material", name, {*_conductors(), *spectra.metals()}))
    return spectra.metal(name)


def _dielectric(r: Reader, o: Object) -> Material:
    return Material("dielectric", ior=_ratio(r, o, "bk7"), **_tints(r, o))


def _rough_dielectric(r: Reader, o: Object) -> Material:
    return Material("dielectric", ior=_ratio(r, o, "bk7"), **_roughness(r, o), **_tints(r, o))


def _thin_dielectric(r: Reader, o: Object) -> Material:
    return Material("thin_dielectric", ior=_ratio(r, o, "bk7"), **_tints(r, o))


def _tints(r: Reader, o: Object) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, ours in (
        ("specular_reflectance", "reflectance"),
        ("specular_transmittance", "transmittance"),
    ):
        if r.has(o, name):
            found[ours] = r.color(o, name, 1.0)
    return found


def _plastic(r: Reader, o: Object) -> Material:
    return _opaque("plastic", roughness=0.0, compensation="off", **_coat(r, o))


def _rough_plastic(r: Reader, o: Object) -> Material:
    return _opaque("plastic", **_roughness(r, o), **_coat(r, o))


def _coat(r: Reader, o: Object) -> dict[str, Any]:
    return {
        "color": r.color(o, "diffuse_reflectance", 0.5),
        "specular": r.color(o, "specular_reflectance", 1.0),
        "ior": _ratio(r, o, "polypropylene"),
        "nonlinear": "on" if r.boolean(o, "nonlinear", False) else "off",
    }


def _null(_: Reader, __: Object) -> Material:
    return Material("null")


def _mask(r: Reader, o: Object) -> Material:
    inside = one(r, o)
    opacity = r.scalar(o, "opacity", 0.5)
    if "opacity" in inside.params:  # a mask of a mask
        opacity = _product(opacity, inside.params["opacity"])
    return changed(inside, opacity=opacity)


def _product(a: float | Texture, b: float | Texture) -> float | Texture:
    if not isinstance(a, Texture) and not isinstance(b, Texture):
        return a * b
    colors = [x if isinstance(x, Texture) else (x, x, x) for x in (a, b)]
    return Texture("multiply", color0=colors[0], color1=colors[1])


def _two_sided(r: Reader, o: Object) -> Material:
    sides = [read(r, inner) for inner in r.nested(o, "bsdf")]
    if not 1 <= len(sides) <= 2:
        raise o.error(f"has {len(sides)} bsdfs in it; needs 1 or 2")
    if len(sides) == 1:
        return _both(sides[0], {})
    return changed(_both(sides[0], {}), "two_sided", back=_both(sides[1], {}))


def _both(material: Material, made: dict[int, Material]) -> Material:
    """The material with both sides, and those of its parts, alike.

    made: by identity, as blends may share parts that share parts.
    """
    if id(material) not in made:
        parts = {k: _both(v, made) for k, v in material.params.items() if k in ("a", "b")}
        made[id(material)] = changed(material, "back", two_sided=True, **parts)
    return made[id(material)]


def _blend(r: Reader, o: Object) -> Material:
    parts = [read(r, inner) for inner in r.nested(o, "bsdf")]
    if len(parts) != 2:
        raise o.error(f"has {len(parts)} bsdfs in it; needs 2")
    params: dict[str, Any] = {"weight": r.scalar(o, "weight", 0.5)}
    sides = [part.params.get("two_sided", True) for part in parts]
    if not any(sides):
        params["back"] = _BLACK
    elif not all(sides):
        r.report(f"{o}: of one bsdf with and one without a back both backs are shown")
    opacities = [part.params.get("opacity", 1.0) for part in parts]
    parts = [changed(part, "opacity") for part in parts]
    if any(x != 1.0 for x in opacities):
        params |= _holes(r, o, params["weight"], opacities)
    return Material("blend", a=parts[0], b=parts[1], **params)


def _holes(
    r: Reader, o: Object, weight: float | Texture, opacities: list[float | Texture]
) -> dict[str, Any]:
    """Opacity of a blend of masks, and the share of the second where there is no hole."""
    a, b = opacities
    if isinstance(weight, Texture) or isinstance(a, Texture) or isinstance(b, Texture):
        r.report(f"{o}: masks in a blend, where any of it is textured, are not supported; no holes")
        return {}
    solid = (1.0 - weight) * a + weight * b
    return {"opacity": solid, "weight": weight * b / solid if solid > 0.0 else 0.0}


def _bump(r: Reader, o: Object) -> Material:
    heights = _texture_in(r, o)
    scale = r.number(o, "scale", 1.0)
    material = one(r, o)
    if not isinstance(heights, Texture):
        return material
    if scale != 1.0:
        heights = _scaled(heights, scale)
    return changed(material, bump_map=heights)


def _scaled(heights: Texture, scale: float) -> Texture:
    """A texture of heights, each times `scale`."""
    if heights.type == "image":
        values = pixels.read(heights.params["image"], heights.params["color_space"])
        return Texture(
            "image", **{**heights.params, "image": values * scale, "color_space": "linear"}
        )
    colors = {k: tuple(scale * x for x in heights.params[k]) for k in ("color0", "color1")}
    return Texture(heights.type, **{**heights.params, **colors})


def _normal_map(r: Reader, o: Object) -> Material:
    normals = _texture_in(r, o)
    r.ignore(o, "flip_invalid_normals", "use_shadowing_function")
    material = one(r, o)
    if not isinstance(normals, Texture):
        return material
    return changed(material, normal_map=normals, normal_map_frame="right_handed")


def _texture_in(r: Reader, o: Object) -> Color | Texture:
    from . import textures

    inner = r.nested(o, "texture")
    if len(inner) != 1:
        raise o.error(f"has {len(inner)} textures in it; needs 1")
    return textures.read(r, inner[0])


def _principled(r: Reader, o: Object) -> Material:
    params: dict[str, Any] = {
        "color": r.color(o, "base_color", 0.5),
        "roughness": r.scalar(o, "roughness", 0.5),
        "metallic": r.scalar(o, "metallic", 0.0),
        "transmission": r.scalar(o, "spec_trans", 0.0),
        "clearcoat": r.scalar(o, "clearcoat", 0.0),
    }
    if r.has(o, "eta"):
        params["ior"] = r.number(o, "eta", 1.5)
    else:
        # Burley 2012: F0 = 0.08 specular
        root = math.sqrt(0.08 * min(max(r.number(o, "specular", 0.5), 0.0), 1.0))
        params["ior"] = (1.0 + root) / (1.0 - root)
    aspect = r.scalar(o, "anisotropic", 0.0)
    if not isinstance(aspect, Texture):
        # Burley 2012: alpha_u = roughness^2 / q, alpha_v = roughness^2 q, q = sqrt(1 - 0.9 aspect)
        q = 1.0 - 0.9 * min(max(aspect, 0.0), 1.0)
        params["anisotropy"] = (1.0 - q) / (1.0 + q)
    gloss = r.scalar(o, "clearcoat_gloss", 0.0)
    if not isinstance(gloss, Texture):
        # Burley 2012: alpha from 0.1 to 0.001
        params["clearcoat_roughness"] = math.sqrt(0.1 + (0.001 - 0.1) * gloss)
    sheen = r.scalar(o, "sheen", 0.0)
    tint = r.scalar(o, "sheen_tint", 0.0)
    color = params["color"]
    if not isinstance(sheen, Texture) and sheen > 0.0:
        params["sheen_color"] = _tinted(color, 0.0 if isinstance(tint, Texture) else tint, sheen)
    for name in ("spec_tint", "flatness", "diff_trans"):
        found = r.scalar(o, name, 0.0)
        if isinstance(found, Texture) or found != 0.0:
            r.report(f"property {name!r} of {o}: not supported; ignored")
    r.ignore(
        o,
        "main_specular_sampling_rate",
        "diffuse_reflectance_sampling_rate",
        "clearcoat_sampling_rate",
        "diff_refl_sampling_rate",
        "diff_trans_sampling_rate",
        "spec_reflect_sampling_rate",
        "spec_trans_sampling_rate",
    )
    r.report(f"bsdf type {o.type!r}: rendered by our principled model, whose lobes differ")
    if params["transmission"] == 0.0:
        params["two_sided"] = False
    return Material("principled", **params)


def _tinted(color: Color | Texture, tint: float, strength: float) -> Color:
    """White, or in the share `tint` the colour's hue, times `strength`."""
    if isinstance(color, Texture):
        return strength, strength, strength
    light = spectra.luminance(color)
    hue = tuple(x / light for x in color) if light > 0.0 else (1.0, 1.0, 1.0)
    a, b, c = (min(strength * ((1.0 - tint) + tint * x), 1.0) for x in hue)
    return a, b, c


BSDFS: dict[str, Callable[[Reader, Object], Material]] = {
    "diffuse": _diffuse,
    "roughdiffuse": _rough_diffuse,
    "conductor": _conductor,
    "roughconductor": _rough_conductor,
    "dielectric": _dielectric,
    "roughdielectric": _rough_dielectric,
    "thindielectric": _thin_dielectric,
    "plastic": _plastic,
    "roughplastic": _rough_plastic,
    "principled": _principled,
    "null": _null,
    "mask": _mask,
    "twosided": _two_sided,
    "blendbsdf": _blend,
    "bumpmap": _bump,
    "normalmap": _normal_map,
}
