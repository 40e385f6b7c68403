"""Material and MakeNamedMaterial: what surfaces do with light.

pbrt's microfacets are GGX without compensation of multiple scattering, with alpha from "roughness"
by a map of each version's own. Opaque materials look alike on both sides, as ours do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import unknown_name
from ...scene import Material, Texture
from ...spectra import luminance
from .colors import Color, scaled
from .items import Item
from .textures import mapped, multiplied

Values = NDArray[np.float32]

_GREY = Material("diffuse", color=(0.5, 0.5, 0.5))
# The range of our indices of refraction
_LEAST_IOR, _MOST_IOR = 0.1, 10.0
# and of its dispersion
_MOST_DISPERSION = 10.0

# Materials in mixtures of mixtures
_DEEPEST_MIX = 8


def read(item: Item, depth: int = 0) -> Material:
    """The material that a directive is."""
    if depth > _DEEPEST_MIX:
        raise item.error("is a mixture of itself, or too deep a one")
    if item.type == "mix":
        made = _mix(item, depth)
    else:
        function = MATERIALS.get(item.type)
        if function is None:
            item.reader.report(
                f"{unknown_name('material', item.type, filter(None, MATERIALS))}; 0.5 grey is used"
            )
            return _GREY
        made = function(item)
    made = _relief(item, _bounded(made))
    item.finish()
    return made


# Parameters between 0 and 1
_SHARES = (
    "color", "specular", "reflectance", "transmittance", "roughness", "metallic", "transmission",
    "clearcoat", "clearcoat_roughness", "opacity",
)  # fmt: skip


def _bounded(material: Material) -> Material:
    """With every share cut to [0, 1], as pbrt does."""
    cut: dict[str, Any] = {}
    for name in _SHARES:
        value = material.params.get(name)
        if isinstance(value, tuple):
            cut[name] = tuple(min(max(x, 0.0), 1.0) for x in value)
        elif isinstance(value, float):
            cut[name] = min(max(value, 0.0), 1.0)
    return changed(material, **cut)


def changed(material: Material, **params: Any) -> Material:
    """The material with parameters replaced."""
    return Material(material.type, **{**material.params, **params})


def _relief(item: Item, material: Material) -> Material:
    """With the normal map and the displacement, which bends normals only, in pbrt too."""
    item.ignore("type")
    for name in ("displacement", "bumpmap"):
        if item.has(name):
            heights = item.scalar(name, 0.0)
            if isinstance(heights, Texture):
                material = changed(material, bump_map=heights)
    if item.has("normalmap"):
        path = item.file("normalmap")
        picture = Texture("image", image=str(path), color_space="linear")
        material = changed(material, normal_map=picture)
    return material


# Roughness


def _old_alpha(x: Any) -> Any:
    """Version 3's map from roughness to alpha, a fit of its authors (microfacet.h)."""
    x = np.log(np.maximum(x, 1e-3))
    return 1.62142 + x * (0.819955 + x * (0.1734 + x * (0.0171201 + x * 0.000640711)))


def _roughness(
    item: Item, default: float, prefix: str = "", *, old: bool = False
) -> dict[str, Any]:
    """roughness, whose square is alpha, and anisotropy.

    old: by version 3's map. Alphas of u and v are ours as roughness^2 / q and roughness^2 * q.
    """
    remap = item.boolean("remaproughness", True)

    def alpha(x: Any) -> Any:
        if not remap:
            return np.clip(x, 0.0, 1.0)
        return np.clip(_old_alpha(x) if old else np.sqrt(np.maximum(x, 0.0)), 0.0, 1.0)

    both = item.scalar(f"{prefix}roughness", default)
    along = [
        item.scalar(f"{prefix}{axis}roughness", 0.0)
        if item.has(f"{prefix}{axis}roughness")
        else both
        for axis in "uv"
    ]
    found: dict[str, Any] = {"compensation": "off"}
    numbers = [x for x in along if not isinstance(x, Texture)]
    if len(numbers) == 2:
        if min(numbers) < 0.0:
            raise item.error(f"{prefix}roughness is {min(numbers):g}; must be 0 or above")
        # version 3 has no rough glass of roughness 0
        u, v = (float(alpha(x)) if x > 0.0 or not old else 0.0 for x in numbers)
        # below this pbrt takes the surface for smooth
        if max(u, v) <= 1e-3:
            return found | {"roughness": 0.0}
        u, v = max(u, 1e-4), max(v, 1e-4)
        found["roughness"] = (u * v) ** 0.25
        if u != v:
            found["anisotropy"] = min(max((u - v) / (u + v), -0.99), 0.99)
        return found
    texture = next(x for x in along if isinstance(x, Texture))
    if along[0] != along[1]:
        item.report("of two textures of roughness only one is supported; it is used for both axes")
    found["roughness"] = mapped(texture, lambda x: np.sqrt(alpha(x)).astype(np.float32))
    return found


def _isotropic(item: Item, found: dict[str, Any]) -> dict[str, Any]:
    """Without anisotropy, for materials that have none."""
    if found.pop("anisotropy", 0.0):
        item.report("roughness that differs along u and v is not supported; its mean is used")
    return found


def _refraction(item: Item, *names: str, default: float) -> dict[str, float]:
    """The index of refraction, by the first name that is given, and how it varies by wavelength."""
    name = next((n for n in names if item.has(n)), names[0])
    ior, dispersion = item.refraction(name, default)
    if not _LEAST_IOR <= ior <= _MOST_IOR:
        raise item.error(f"{name} is {ior:g}; must lie in [{_LEAST_IOR:g}, {_MOST_IOR:g}]")
    return {"ior": ior} | ({"dispersion": min(dispersion, _MOST_DISPERSION)} if dispersion else {})


def _ior(item: Item, *names: str, default: float) -> float:
    """The index of refraction of a coat or a pane, where its dispersion cannot be seen."""
    return _refraction(item, *names, default=default)["ior"]


# Version 4


def _diffuse(item: Item) -> Material:
    return Material("diffuse", color=item.color("reflectance", 0.5), **_oren_nayar(item))


def _oren_nayar(item: Item) -> dict[str, Any]:
    sigma = item.plain_scalar("sigma", 0.0)
    if not sigma > 0.0:
        return {}
    item.report("Oren-Nayar's surface is rendered by another rough diffuse model")
    # theirs is the slopes' deviation in degrees; sigma is roughness / sqrt(2), as Mitsuba has it
    return {"roughness": min(math.radians(sigma) * math.sqrt(2.0), 1.0)}


def _coated_diffuse(item: Item) -> Material:
    _coat(item)
    return Material(
        "plastic",
        color=item.color("reflectance", 0.5),
        ior=max(_ior(item, "eta", default=1.5), 1.0),
        nonlinear="on",
        **_isotropic(item, _roughness(item, 0.0)),
    )


def _coat(item: Item) -> None:
    """What a coat's random walk is told. Its thickness matters for a cloudy one only."""
    item.ignore("thickness", "maxdepth", "nsamples", "twosided", "g")
    if item.has("albedo") and max(item.plain("albedo", 0.0)) > 0.0:
        item.report("a coat that scatters (albedo) is not supported; it is clear")


def _coated_conductor(item: Item) -> Material:
    item.report("rendered as the conductor with a clear coat of our principled model")
    _coat(item)
    base = _roughness(item, 0.0, "conductor.")
    coat = _isotropic(item, _roughness(item, 0.0, "interface."))
    ior = max(_ior(item, "interface.eta", default=1.5), 1.0)
    eta, k = _eta_k(item, "conductor.")
    # glTF's metal is told by its colour at normal incidence: here that of the metal within the coat
    color = item.color("reflectance", _normal_reflectance(scaled(eta, 1 / ior), scaled(k, 1 / ior)))
    base.pop("compensation")
    return Material(
        "principled",
        color=color,
        metallic=1.0,
        clearcoat=1.0,
        clearcoat_ior=ior,
        clearcoat_roughness=coat["roughness"],
        **base,
    )


def _normal_reflectance(eta: Color, k: Color) -> Color:
    n, x = np.array(eta), np.array(k)
    a, b, c = (float(r) for r in ((n - 1) ** 2 + x**2) / ((n + 1) ** 2 + x**2))
    return a, b, c


def _eta_k(item: Item, prefix: str = "") -> tuple[Color, Color]:
    """Of a metal; copper's, unless given."""
    from ... import spectra

    eta, k = spectra.metal("Cu")
    eta = item.plain(f"{prefix}eta", eta, "index")
    k = item.plain(f"{prefix}k", k, "index")
    for name, values in (("eta", eta), ("k", k)):
        if not all(0.0 <= x <= 100.0 for x in values):
            raise item.error(f"{prefix}{name} is {values}; must lie in [0, 100]")
    return eta, k


def _conductor(item: Item) -> Material:
    rough = _roughness(item, 0.0)
    if item.has("reflectance"):
        color = item.color("reflectance", 1.0)
        if isinstance(color, Texture):
            return Material("conductor", color=color, **rough)
        # pbrt's own inverse: an index of 1 and the k that reflects so much at normal incidence
        share = np.clip(color, 0.0, 0.9999)
        like = tuple(float(x) for x in 2.0 * np.sqrt(share / (1.0 - share)))
        return Material("conductor", eta=(1.0,) * 3, k=like, **rough)
    eta, k = _eta_k(item)
    return Material("conductor", eta=eta, k=k, **rough)


def _dielectric(item: Item) -> Material:
    return Material("dielectric", **_refraction(item, "eta", default=1.5), **_roughness(item, 0.0))


def _thin_dielectric(item: Item) -> Material:
    return Material("thin_dielectric", ior=_ior(item, "eta", default=1.5))


def _diffuse_transmission(item: Item) -> Material:
    scale = item.number("scale", 1.0)
    color, through = (
        multiplied(item.color(name, 0.25), (scale, scale, scale))
        for name in ("reflectance", "transmittance")
    )
    return Material("diffuse_transmission", color=color, transmittance=through)


def _hair(item: Item) -> Material:
    item.report("the scattering of hair is not supported; it is diffuse, with the hair's colour")
    item.ignore("beta_m", "beta_n", "alpha", "eta")
    for name in ("reflectance", "color"):
        if item.has(name):
            return Material("diffuse", color=item.color(name, 0.5))
    # E. d'Eon et al., "An Energy-Conserving Hair Reflectance Model", EGSR 2011: absorption of the
    # two pigments, by concentration
    dark, red = item.plain_scalar("eumelanin", 0.0), item.plain_scalar("pheomelanin", 0.0)
    if not item.has("eumelanin") and not item.has("pheomelanin"):
        dark = 1.3
    pigments = dark * np.array([0.419, 0.697, 1.37]) + red * np.array([0.187, 0.4, 1.05])
    x, y, z = (float(p) for p in pigments)
    sigma = np.array(item.plain("sigma_a", (x, y, z), "index"))
    # Chiang et al., "A Practical and Controllable Hair and Fur Model", EGSR 2016, eq. 9, at an
    # azimuthal roughness of 0.3, inverted
    n = 0.3
    slope = 5.969 - 0.215 * n + 2.532 * n**2 - 10.73 * n**3 + 5.574 * n**4 + 0.245 * n**5
    a, b, c = (float(x) for x in np.exp(-slope * np.sqrt(np.maximum(sigma, 0.0))))
    return Material("diffuse", color=(a, b, c))


def _subsurface(item: Item) -> Material:
    item.report("light that wanders below the surface is not supported; it is a coated diffuse one")
    item.ignore("name", "mfp", "sigma_a", "sigma_s", "sigma_prime_s", "scale", "g")
    item.ignore("meanfreepath")
    name = "Kd" if item.has("Kd") else "reflectance"
    color = item.color(name, 0.5)
    for other in ("Kr", "Kt"):
        item.color(other, 1.0)
    rough = _isotropic(item, _roughness(item, 0.0, old=item.reader.old))
    ior = max(_ior(item, "eta", "index", default=1.33), 1.0)
    return Material("plastic", color=color, ior=ior, **rough)


def _measured(item: Item) -> Material:
    item.ignore("filename", "bsdffile")
    item.report("measured materials are not supported; 0.5 grey is used")
    return _GREY


def _interface(_: Item) -> Material:
    return Material("null")


def _mix(item: Item, depth: int) -> Material:
    """Amount is the share of the second, and in version 3 of the first."""
    reader = item.reader
    if item.has("materials"):
        names = item.strings("materials")
        if len(names) != 2:
            raise item.error(f"has {len(names)} materials; needs 2")
        first, second = names
        amount = item.scalar("amount", 0.5)
    else:
        first, second = (item.string(f"namedmaterial{i}", "") for i in (1, 2))
        found = item.color("amount", 0.5)
        amount = found if isinstance(found, Texture) else luminance(found)
        first, second = second, first
    parts = [read(reader.material(name, item.directive), depth + 1) for name in (first, second)]
    if not isinstance(amount, Texture):
        amount = min(max(amount, 0.0), 1.0)
    return Material("blend", a=parts[0], b=parts[1], weight=amount)


# Version 3 and before


def _matte(item: Item) -> Material:
    return Material("diffuse", color=item.color("Kd", 0.5), **_oren_nayar(item))


def _plastic(item: Item) -> Material:
    _told_coat(item)
    return Material(
        "plastic",
        color=item.color("Kd", 0.25),
        specular=item.color("Ks", 0.25),
        ior=1.5,
        **_isotropic(item, _roughness(item, 0.1, old=True)),
    )


def _told_coat(item: Item) -> None:
    item.report("its matte part is rendered below a clear coat, which dims it a little")


def _metal(item: Item) -> Material:
    eta, k = _eta_k(item)
    return Material("conductor", eta=eta, k=k, **_roughness(item, 0.01, old=True))


def _mirror(item: Item) -> Material:
    return Material("conductor", color=item.color("Kr", 0.9), roughness=0.0)


def _shiny_metal(item: Item) -> Material:
    """Version 1's: a mirror of one colour and a blurred one of another, both metals."""
    mirror, blurred = item.plain("Kr", 1.0), item.plain("Ks", 1.0)
    rough = _roughness(item, 0.1, old=True)
    item.report("its two lobes are rendered as a blend")
    weight = luminance(blurred) / max(luminance(blurred) + luminance(mirror), 1e-6)
    parts = []
    for color, share, kind in (
        (mirror, 1.0 - weight, {"roughness": 0.0}),
        (blurred, weight, rough),
    ):
        tint = np.clip(np.array(color) / max(share, 1e-6), 0.0, 1.0)
        params = {**kind, "color": tuple(float(x) for x in tint)}
        parts.append(Material("conductor", **params))
    return Material("blend", a=parts[0], b=parts[1], weight=weight)


def _glass(item: Item) -> Material:
    params = _roughness(item, 0.0, old=True)
    for name, ours in (("Kr", "reflectance"), ("Kt", "transmittance")):
        if item.has(name):
            params[ours] = item.color(name, 1.0)
    return Material("dielectric", ior=_ior(item, "eta", "index", default=1.5), **params)


def _uber(item: Item) -> Material:
    """A coated diffuse part, a mirror and glass, blended by how much each sends on."""
    rough = _isotropic(item, _roughness(item, 0.1, old=True))
    ior = max(_ior(item, "eta", "index", default=1.5), 1.0)
    _told_coat(item)
    made = Material(
        "plastic", color=item.color("Kd", 0.25), specular=item.color("Ks", 0.25), ior=ior, **rough
    )
    mirror, passed = item.plain("Kr", 0.0), item.plain("Kt", 0.0)
    clear = max(luminance(mirror), luminance(passed))
    if clear > 0.0:
        item.report("its mirror and its glass are rendered as a blend with the rest")
        glass = Material("dielectric", ior=ior, reflectance=mirror, transmittance=passed)
        made = Material("blend", a=made, b=glass, weight=0.5 * min(clear, 1.0))
    if item.has("opacity"):
        made = changed(made, opacity=item.scalar("opacity", 1.0))
    return made


def _substrate(item: Item) -> Material:
    """Ashikhmin and Shirley's: a base below a glossy coat that reflects Ks at normal incidence."""
    item.report("rendered by our principled model, whose lobes differ")
    gloss = item.plain("Ks", 0.5)
    most = min(max(gloss), 0.6)  # above it the index of refraction leaves our range
    root = math.sqrt(max(most, 1e-4))
    rough = _roughness(item, 0.1, old=True)
    rough.pop("compensation")
    tint = tuple(min(x / most, 1.0) for x in gloss) if most > 0.0 else (0.0, 0.0, 0.0)
    return Material(
        "principled",
        color=item.color("Kd", 0.5),
        ior=(1.0 + root) / (1.0 - root),
        specular_color=tint,
        **rough,
    )


def _translucent(item: Item) -> Material:
    if max(item.plain("Ks", 0.25)) > 0.0:
        item.report("its gloss (Ks) is not supported; its matte part is")
    item.ignore("roughness", "remaproughness")
    body = item.color("Kd", 0.25)
    color, through = (multiplied(body, item.plain(name, 0.5)) for name in ("reflect", "transmit"))
    return Material("diffuse_transmission", color=color, transmittance=through)


def _disney(item: Item) -> Material:
    item.report("rendered by our principled model, whose lobes differ")
    color = item.color("color", 0.5)
    params: dict[str, Any] = {
        "color": color,
        "metallic": item.scalar("metallic", 0.0),
        "roughness": item.scalar("roughness", 0.5),
        "transmission": item.scalar("spectrans", 0.0),
        "ior": max(_ior(item, "eta", default=1.5), 1.0),
        "clearcoat": item.scalar("clearcoat", 0.0),
    }
    aspect = math.sqrt(1.0 - 0.9 * min(max(item.plain_scalar("anisotropic", 0.0), 0.0), 1.0))
    # B. Burley, "Physically Based Shading at Disney", 2012: alphas roughness^2 / aspect and
    # roughness^2 * aspect
    params["anisotropy"] = (1.0 - aspect**2) / (1.0 + aspect**2)
    # and a clear coat's alpha from 0.1 to 0.001
    gloss = min(max(item.plain_scalar("clearcoatgloss", 1.0), 0.0), 1.0)
    params["clearcoat_roughness"] = math.sqrt(0.1 + (0.001 - 0.1) * gloss)
    sheen = min(max(item.plain_scalar("sheen", 0.0), 0.0), 1.0)
    tint = min(max(item.plain_scalar("sheentint", 0.5), 0.0), 1.0)
    if sheen > 0.0:
        hue = (1.0, 1.0, 1.0)
        if not isinstance(color, Texture) and luminance(color) > 0.0:
            hue = scaled(color, 1.0 / luminance(color))
        params["sheen_color"] = tuple(
            min(max(sheen * ((1.0 - tint) + tint * x), 0.0), 1.0) for x in hue
        )
    for name in ("speculartint", "flatness", "scatterdistance"):
        if item.has(name) and max(item.plain(name, 0.0)) > 0.0:
            item.report(f"parameter {name!r} is not supported; ignored")
    if item.boolean("thin", False):
        item.report("a thin surface is not supported; it is a solid one")
    item.ignore("difftrans")
    return Material("principled", **params)


MATERIALS: dict[str, Callable[[Item], Material]] = {
    "diffuse": _diffuse,
    "coateddiffuse": _coated_diffuse,
    "coatedconductor": _coated_conductor,
    "conductor": _conductor,
    "dielectric": _dielectric,
    "thindielectric": _thin_dielectric,
    "diffusetransmission": _diffuse_transmission,
    "hair": _hair,
    "subsurface": _subsurface,
    "measured": _measured,
    "interface": _interface,
    "none": _interface,
    "": _interface,
    "matte": _matte,
    "plastic": _plastic,
    "metal": _metal,
    "mirror": _mirror,
    "shinymetal": _shiny_metal,
    "glass": _glass,
    "uber": _uber,
    "substrate": _substrate,
    "translucent": _translucent,
    "disney": _disney,
    "kdsubsurface": _subsurface,
    "fourier": _measured,
}
