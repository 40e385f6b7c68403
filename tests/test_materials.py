"""Every material of the core, by being listed: sampling, energy, symmetry and Fresnel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core, tables
from parhelion.flatten import Block, block
from statistics_tools import direction_chi_square, mean_p, proportion_p, sidak

# Where within its range each scalar parameter is tried, besides its default; fewer where there are
# many parameters.
SHARES = (0.0, 0.001, 0.01, 0.1, 0.5, 1.0)
FEW_SHARES = (0.0, 1.0)

# Values of other parameters without which a parameter has no effect.
CONTEXT: dict[tuple[str, str], dict[str, Any]] = {
    ("conductor", "anisotropy"): {"roughness": 0.6},
    ("conductor", "distribution"): {"roughness": 0.7},
    ("conductor", "compensation"): {"roughness": 0.7},
    ("dielectric", "anisotropy"): {"roughness": 0.6},
    ("dielectric", "distribution"): {"roughness": 0.7},
    ("dielectric", "compensation"): {"roughness": 0.7},
    ("plastic", "distribution"): {"roughness": 0.5},
    ("plastic", "compensation"): {"roughness": 0.5},
    ("principled", "anisotropy_rotation"): {"anisotropy": 0.6},
    ("principled", "specular"): {"roughness": 0.2},
    ("principled", "clearcoat_roughness"): {"clearcoat": 1.0},
    ("principled", "clearcoat_ior"): {"clearcoat": 1.0, "clearcoat_roughness": 0.4},
    ("principled", "sheen_roughness"): {"sheen_color": (1.0, 1.0, 1.0)},
    ("principled", "iridescence_ior"): {"iridescence": 1.0},
    ("principled", "iridescence_thickness"): {"iridescence": 1.0},
}
# Combinations worth a test besides.
ALSO: list[tuple[str, dict[str, Any]]] = [
    ("thin_dielectric", {"roughness": 0.5}),
    ("diffuse_transmission", {"transmittance": (0.7, 0.7, 0.7)}),
    *(
        (name, {"roughness": 0.9, "distribution": kind})
        for name in ("conductor", "dielectric", "plastic")
        for kind in ("ggx", "beckmann")
    ),
    *(
        (name, {"roughness": rough, "anisotropy": bend, "distribution": kind})
        for name in ("conductor", "dielectric")
        for rough, bend, kind in ((0.7, -0.5, "ggx"), (0.5, 0.7, "beckmann"))
    ),
    ("dielectric", {"roughness": 0.4, "ior": 1.05}),
    ("dielectric", {"roughness": 0.4, "ior": 1 / 1.5}),
    ("dielectric", {"roughness": 0.6, "ior": 2.4, "distribution": "beckmann"}),
    ("plastic", {"roughness": 0.4, "ior": 1.05}),
    ("principled", {"transmission": 1.0, "roughness": 0.3}),
    ("principled", {"metallic": 1.0, "anisotropy": 0.5, "anisotropy_rotation": 30.0}),
    ("principled", {"transmission": 1.0, "anisotropy": 0.5, "anisotropy_rotation": 30.0}),
    (
        "principled",
        {
            "metallic": 0.3,
            "transmission": 0.5,
            "clearcoat": 0.5,
            "clearcoat_roughness": 0.3,
            "sheen_color": (0.5, 0.5, 0.5),
            "iridescence": 0.5,
        },
    ),
]


def variants() -> list[tuple[str, dict[str, Any]]]:
    """Every material, with every scalar parameter over its range, one at a time."""
    found: list[tuple[str, dict[str, Any]]] = []
    for name, entry in tables.tables()["materials"].items():
        scalars = [p for p in entry.params[1:] if p.size == 1]
        if not scalars:
            found.append((name, {}))
        shares = SHARES if len(scalars) < 4 else FEW_SHARES
        for p in scalars:
            values: list[Any] = list(p.choices)
            if not values:
                spread = {p.low + share * (p.high - p.low) for share in shares}
                if len(scalars) < 8:
                    spread.add(p.default[0])
                values = sorted(round(v, 6) for v in spread)
            for v in values:
                found.append((name, {**CONTEXT.get((name, p.name), {}), p.name: v}))
    unique = {repr(v): v for v in found + ALSO}
    return list(unique.values())


VARIANTS = variants()
# towards the viewer: from above, from below, and close to the surface
OUTGOING = [np.array([np.sqrt(1 - z * z), 0, z]) for z in (1.0, 0.6, 0.03, -0.8, -0.1)]
OUTGOING = [v @ np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]) for v in OUTGOING]


def name_of(variant: tuple[str, dict[str, Any]]) -> str:
    return "-".join([variant[0], *(f"{k}={v}" for k, v in variant[1].items())])


by_variant = pytest.mark.parametrize(("name", "params"), VARIANTS, ids=map(name_of, VARIANTS))


def color_of(name: str) -> str:
    return tables.tables()["materials"][name].params[0].name


def white(name: str, params: Mapping[str, Any]) -> Block:
    """The parameter block with the colour 1."""
    return block("materials", name, {color_of(name): (1.0, 1.0, 1.0), **params}, "test")


def white_material(name: str, params: Mapping[str, Any]) -> ph.Material:
    return ph.Material(name, **{color_of(name): (1.0, 1.0, 1.0)}, **params)


def index_ratio(name: str, params: Mapping[str, Any], wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
    """Index of refraction on wi's side over that on wo's, (N,)."""
    if name in ("thin_dielectric", "diffuse_transmission"):  # both sides are outside
        return np.ones(len(wi))
    ior = float(params.get("ior", 1.5))
    if name == "principled":  # see scaled_index in principled.h
        root = (ior - 1) / (ior + 1) * np.sqrt(params.get("specular", 1.0))
        ior = max((1 + root) / (1 - root), 1.02)
    crosses = wo[2] * wi[:, 2] < 0
    return np.where(crosses, ior if wo[2] > 0 else 1 / ior, 1.0)


def gives_back(name: str, params: Mapping[str, Any]) -> bool:
    """Whether, white, it scatters all light: bounces that single-bounce models leave out count."""
    rough = params.get("roughness", 0.5 if name == "principled" else 0.0) > 0
    if name == "emissive" or (rough and params.get("compensation") == "off"):
        return False
    return not ("iridescence" in params and params.get("metallic", 0.0) > 0)


@by_variant
def test_samples_follow_their_density(name: str, params: dict[str, Any]) -> None:
    material = white(name, params)
    for i, wo in enumerate(OUTGOING):
        count = 30_000
        wi, weight, density, delta = _core.bsdf_sample(material, wo, 10 + i, count)
        alive = weight[:, 0] > 0
        if not alive.any():  # it reflects nothing
            assert not np.any(_core.bsdf_eval(material, wo, wi)[0])
            continue
        np.testing.assert_allclose(np.linalg.norm(wi[alive], axis=1), 1, atol=1e-5)
        smooth = alive & ~delta.astype(bool)
        if not smooth.any():
            # a mirror has no density: no light sample may count for it
            assert not np.any(_core.bsdf_eval(material, wo, wi)[1])
            continue
        w = wi[smooth]
        value, again = _core.bsdf_eval(material, wo, w)
        # the sample's weight comes without the squeezing of radiance in glass
        value = value * index_ratio(name, params, wo, w)[:, None] ** 2
        # Rounding may move a sample over the limb of a lobe, where its density has a pole.
        known = again > 0
        assert known.mean() > 0.98
        # One in 28,000 that leave a rough conductor, along the surface, is off by 1.4e-4.
        np.testing.assert_allclose(again[known], density[smooth][known], rtol=2e-4)
        np.testing.assert_allclose(
            weight[smooth][known] * density[smooth][known, None], value[known], rtol=2e-4
        )
        for side in (1.0, -1.0):
            w = wi[smooth & (wi[:, 2] * side > 0)]
            if len(w) < 2000:
                continue
            axis = np.array([-wo[0], -wo[1], wo[2]])
            if side * wo[2] < 0:
                axis = np.median(w, axis=0)
            share = len(w) / count

            def pdf(v: np.ndarray, wo=wo, side=side, share=share) -> np.ndarray:
                here = v[:, 2] * side > 0
                return _core.bsdf_eval(material, wo, v)[1] * here / share

            # the share is itself a count
            slack = 0.01 + 4 * np.sqrt((1 - share) / len(w))
            streak = abs(params.get("anisotropy", 0.0)) > 0.9
            p = direction_chi_square(
                w, pdf, axis, bins=(6, 10), slack=slack, points=5 if streak else 3
            )
            assert p > sidak(2 * len(VARIANTS) * len(OUTGOING)), (wo, side)


def test_a_wrong_density_is_found() -> None:
    wo = OUTGOING[1]
    wi = _core.bsdf_sample(white("metal", {"fuzz": 0.5}), wo, 1, 60_000)[0]
    other = white("metal", {"fuzz": 0.52})
    axis = np.array([-wo[0], -wo[1], wo[2]])
    assert direction_chi_square(wi, lambda v: _core.bsdf_eval(other, wo, v)[1], axis) < 1e-6


def share_scattered(material: Block, wo: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The albedo by Sobol' points, and five times its standard error, (3,) each.

    The points err far less than the weights scatter, so the error is that of independent runs.
    """
    runs = []
    for k in range(16):
        wi, weight, density, _ = _core.bsdf_sample(material, wo, 16 * seed + k, 1024, "sobol")
        assert np.all(np.isfinite(wi))
        assert np.all(np.isfinite(weight))
        assert np.all(np.isfinite(density))
        assert np.all(weight >= 0)
        runs.append(weight.mean(axis=0))
    return np.mean(runs, axis=0), 5 * np.std(runs, axis=0, ddof=1) / np.sqrt(len(runs))


# What the albedo of white may differ from 1 by, for others 1e-3; see docs/materials.md.
ROOM = {"conductor": 2e-3, "dielectric": 2e-3, "principled": 2e-3}
ROOM_OF_STRETCHED_GLASS = 1.5e-2  # whose albedo is a quadrature


def room_of(name: str, params: Mapping[str, Any]) -> float:
    glass = name == "dielectric" or params.get("transmission", 0.0) > 0
    if glass and params.get("anisotropy", 0.0) != 0:
        return ROOM_OF_STRETCHED_GLASS
    return ROOM.get(name, 1e-3)


@by_variant
def test_white_loses_and_gains_nothing(name: str, params: dict[str, Any]) -> None:
    """The albedo, from any side: 1 where all is scattered, never more."""
    material, room = white(name, params), room_of(name, params)
    for i, wo in enumerate(OUTGOING):
        share, noise = share_scattered(material, wo, 30 + i)
        assert np.all(share <= 1 + room + noise), wo
        if gives_back(name, params):
            assert np.all(share > 1 - room - noise), wo


def albedo(material: Block, wo: np.ndarray, name: str, params: Mapping[str, Any]) -> float:
    """Integral of what is scattered over the sphere, to about 1e-4 for lobes that are not narrow.

    By Gauss and Legendre over the cosine of either side, through a substitution that crowds the
    grazing angles and the poles, and evenly around.
    """
    x, w = np.polynomial.legendre.leggauss(160)
    x, w = (x + 1) / 2, w / 2
    z, w = x**2, w * 2 * x
    turns = (np.arange(320) + 0.5) / 320 * 2 * np.pi
    z, turns = (a.ravel() for a in np.meshgrid(np.concatenate([z, -z]), turns, indexing="ij"))
    w = np.repeat(np.concatenate([w, w]), 320) * 2 * np.pi / 320
    r = np.sqrt(1 - z * z)
    wi = np.stack([r * np.cos(turns), r * np.sin(turns), z], axis=1).astype(np.float32)
    value = _core.bsdf_eval(material, wo, wi)[0][:, 0].astype(float)
    return float(np.sum(value * index_ratio(name, params, wo, wi) ** 2 * w))


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("anisotropy", [0.0, 0.5])
def test_values_of_rough_metal_add_up(anisotropy: float, distribution: str) -> None:
    params = {"roughness": 0.8, "anisotropy": anisotropy, "distribution": distribution}
    material = white("conductor", params)
    for wo in OUTGOING[:2]:
        assert abs(albedo(material, wo, "conductor", params) - 1) < 1e-3, wo


BENT = (-0.9, 0.9)
DRAWN: list[tuple[str, dict[str, tuple[float, float]], dict[str, str]]] = [
    ("principled", {"ior": (1.1, 2.5), "anisotropy": BENT}, {}),
    ("principled", {"metallic": (1.0, 1.0), "anisotropy": BENT}, {}),
    *(
        (name, ranges, {"distribution": kind})
        for kind in ("ggx", "beckmann")
        for name, ranges in (
            ("conductor", {}),
            ("conductor", {"anisotropy": BENT}),
            ("plastic", {"ior": (1.1, 2.5)}),
            ("dielectric", {"ior": (1.1, 2.5)}),
            ("dielectric", {"ior": (1.1, 2.5), "anisotropy": BENT}),
        )
    ),
]


@pytest.mark.parametrize(("name", "ranges", "choice"), DRAWN, ids=str)
def test_rough_white_is_white(
    name: str, ranges: dict[str, tuple[float, float]], choice: dict[str, str]
) -> None:
    """At roughnesses, angles and other parameters at which no table has a node."""
    rng = np.random.default_rng(8)
    for k in range(24):
        params: dict[str, Any] = {p: rng.uniform(*ends) for p, ends in ranges.items()} | choice
        params["roughness"] = rng.uniform(0.05, 1)
        z, turn = rng.uniform(0.02, 1) * (-1) ** k, rng.uniform(0, 2 * np.pi)
        wo = np.array([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z])
        share, noise = share_scattered(white(name, params), wo, 90 + k)
        assert np.all(np.abs(share - 1) < room_of(name, params) + noise), (params, wo)


# Materials whose colour is a factor of all that they scatter.
TINTED = ("diffuse", "metal", "dielectric", "thin_dielectric", "conductor", "null", "emissive")


@pytest.mark.parametrize(
    ("name", "params"),
    [v for v in VARIANTS if v[0] in TINTED and (v[0] != "diffuse" or v[1]["roughness"] == 0)],
    ids=str,
)
def test_color_scales_what_is_scattered(name: str, params: dict[str, Any]) -> None:
    kind, values = white(name, params)
    wo = OUTGOING[1]
    plain = _core.bsdf_sample((kind, values), wo, 5, 1000)
    tinted = _core.bsdf_sample((kind, [0.2, 0.5, 0.0, *values[3:]]), wo, 5, 1000)
    np.testing.assert_array_equal(plain[0], tinted[0])
    np.testing.assert_allclose(tinted[1], plain[1] * np.float32([0.2, 0.5, 0.0]), rtol=1e-6)


def reciprocal(name: str, params: Mapping[str, Any]) -> bool:
    """Layers scaled by albedo are not, nor is rough glass that is made good for lost bounces."""
    rough_glass = name == "dielectric" and params.get("roughness", 0) > 0
    return name != "principled" and (not rough_glass or params.get("compensation") == "off")


@pytest.mark.parametrize(
    ("name", "params"), [v for v in VARIANTS if reciprocal(*v) and v[0] != "metal"], ids=str
)
def test_scattering_is_reciprocal(name: str, params: dict[str, Any]) -> None:
    """f n^2, n being the index on the side that the light comes from, is the same both ways."""
    rng = np.random.default_rng(5)
    w = rng.normal(size=(100, 2, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    color = {color_of(name): (0.3, 0.6, 0.9)}
    material = block("materials", name, {**color, **params}, "test")
    for a, b in w.astype(np.float32):
        there = _core.bsdf_eval(material, a, b[None])[0][0] / abs(b[2])
        back = _core.bsdf_eval(material, b, a[None])[0][0] / abs(a[2])
        ratio = index_ratio(name, params, a, b[None])[0]
        np.testing.assert_allclose(there * ratio**2, back, rtol=2e-3, atol=1e-6)


def test_lambert() -> None:
    rng = np.random.default_rng(5)
    w = rng.normal(size=(200, 2, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    material = block("materials", "diffuse", {"color": (0.3, 0.6, 0.9)}, "test")
    for a, b in w.astype(np.float32):
        f = _core.bsdf_eval(material, a, b[None])[0][0] / abs(b[2])
        same_side = a[2] * b[2] > 0
        np.testing.assert_allclose(f, np.float32([0.3, 0.6, 0.9]) / np.pi * same_side, rtol=1e-5)


# --- Against Mitsuba --------------------------------------------------------------------------


def alphas(u: float, v: float) -> dict[str, float]:
    """Our roughness and anisotropy for Mitsuba's two alphas."""
    return {"roughness": (u * v) ** 0.25, "anisotropy": (u - v) / (u + v)}


MITSUBA_PLASTIC = {"diffuse_reflectance": 0.7, "int_ior": 1.49, "ext_ior": 1.0}
PLASTIC = {"color": (0.7, 0.7, 0.7), "ior": 1.49, "compensation": "off"}
# Ours, Mitsuba's, and the largest relative difference of values. Mitsuba's G1 of Beckmann is a fit
# good to 0.4 %, and what its roughplastic lets through comes from a table of 64 cosines.
PAIRS: list[tuple[str, dict[str, Any], dict[str, Any], float]] = [
    ("plastic", PLASTIC, {"type": "plastic", **MITSUBA_PLASTIC}, 3e-3),
    (
        "plastic",
        {**PLASTIC, "nonlinear": "on"},
        {"type": "plastic", "nonlinear": True, **MITSUBA_PLASTIC},
        3e-3,
    ),
]
for kind, room in (("ggx", 1e-4), ("beckmann", 7e-3)):
    for u, v in ((0.3, 0.3), (0.1, 0.5)):
        rough = {**alphas(u, v), "distribution": kind, "compensation": "off"}
        theirs = {"alpha_u": u, "alpha_v": v, "distribution": kind}
        PAIRS += [
            (
                "conductor",
                {"eta": (0.2, 0.2, 0.2), "k": (3.9, 3.9, 3.9), **rough},
                {"type": "roughconductor", "eta": 0.2, "k": 3.9, **theirs},
                room,
            ),
            (
                "dielectric",
                {"ior": 1.5, **rough},
                {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0, **theirs},
                room,
            ),
        ]
    PAIRS += [
        (
            "plastic",
            {**PLASTIC, "roughness": alpha**0.5, "distribution": kind},
            {"type": "roughplastic", "alpha": alpha, "distribution": kind, **MITSUBA_PLASTIC},
            1e-2,
        )
        for alpha in (0.1, 0.3, 0.6)
    ]


@pytest.mark.parametrize(("name", "params", "theirs", "room"), PAIRS, ids=str)
def test_agrees_with_mitsuba(
    name: str, params: dict[str, Any], theirs: dict[str, Any], room: float
) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    bsdf, context = mi.load_dict(theirs), mi.BSDFContext()
    at = mi.SurfaceInteraction3f()
    at.sh_frame = mi.Frame3f([0, 0, 1])
    material = block("materials", name, params, "test")
    rng = np.random.default_rng(2)
    wi = rng.normal(size=(300, 3))
    wi /= np.linalg.norm(wi, axis=1, keepdims=True)
    if name != "dielectric":  # Mitsuba's opaque ones are black from behind
        wi[:, 2] = np.abs(wi[:, 2])
    for cosine in (0.9, 0.3) + ((-0.8, -0.2) if name == "dielectric" else ()):
        wo = np.array([0.6, 0.8, 0]) * np.sqrt(1 - cosine**2) + np.array([0, 0, cosine])
        at.wi = mi.Vector3f(*wo)
        values, densities = _core.bsdf_eval(material, wo, wi.astype(np.float32))
        expected = [bsdf.eval_pdf(context, at, mi.Vector3f(*w)) for w in wi]
        for ours, other in (
            (values[:, 0], np.array([e[0][0] for e in expected])),
            (densities, np.array([e[1] for e in expected])),
        ):
            # a few half vectors of refraction cancel to single precision's last digits
            known = other > 1e-4
            np.testing.assert_allclose(ours[~known], other[~known], atol=2e-4)
            gap = np.abs(ours[known] / other[known] - 1)
            assert np.quantile(gap, 0.98) < room, (cosine, gap.max())


# --- Fresnel -----------------------------------------------------------------------------------


def fresnel(cosine: float, eta: float) -> float:
    """Reflected share of unpolarised light, eta being the far index over the near one.

    In the form of M. Born and E. Wolf, Principles of Optics, 1.5.2, by sines and tangents.
    """
    i = np.arccos(cosine)
    sine = np.sin(i) / eta
    if sine >= 1:
        return 1.0
    if i < 1e-6:
        return float(((eta - 1) / (eta + 1)) ** 2)
    t = np.arcsin(sine)
    s = np.sin(i - t) / np.sin(i + t)
    p = np.tan(i - t) / np.tan(i + t)
    return float((s * s + p * p) / 2)


ANGLES = [0.0, 20.0, 40.0, 56.309932, 75.0, 88.0]


@pytest.mark.parametrize(
    ("params", "share"),
    [
        # seen straight on, where Schlick's formula gives the colour itself
        ({"metallic": 1.0, "roughness": 0.05}, 1.0),
        # half of it, and 0.96 of the colour and the 0.04 of the interface of the other half
        ({"metallic": 0.5, "roughness": 0.05}, None),
        ({"transmission": 1.0, "roughness": 0.05}, None),
    ],
)
def test_principled_has_the_colour_that_it_is_given(
    params: dict[str, Any], share: float | None
) -> None:
    color = np.array([0.9, 0.5, 0.2])
    material = block("materials", "principled", {"color": tuple(color), **params}, "test")
    found, noise = share_scattered(material, np.array([0.0, 0.0, 1.0]), 7)
    clear = 0.04 + 0.96 * color
    expected = color if share else clear if "transmission" in params else (color + clear) / 2
    np.testing.assert_allclose(found, expected, atol=5e-3 + noise.max())


@pytest.mark.parametrize("ior", [1.5, 1.0003, 2.4, 1 / 1.5, 1 / 1.33])
@pytest.mark.parametrize("inside", [False, True])
def test_dielectric_reflects_by_fresnel_and_refracts_by_snell(ior: float, inside: bool) -> None:
    material = block("materials", "dielectric", {"ior": ior}, "test")
    count = 40_000
    eta = 1 / ior if inside else ior
    for i, angle in enumerate(np.radians(ANGLES)):
        side = -1.0 if inside else 1.0
        wo = np.array([np.sin(angle) * 0.6, np.sin(angle) * 0.8, side * np.cos(angle)])
        wi, weight, _, delta = _core.bsdf_sample(material, wo, 50 + i, count)
        assert np.all(delta)
        np.testing.assert_allclose(weight, 1, atol=2e-6)
        reflected = wi[:, 2] * side > 0
        share = fresnel(np.cos(angle), eta)
        if share in (0.0, 1.0):
            assert reflected.mean() == share
        assert proportion_p(reflected.sum(), count, share) > sidak(10 * len(ANGLES))
        mirrored = np.array([-wo[0], -wo[1], wo[2]])
        np.testing.assert_allclose(
            wi[reflected], np.tile(mirrored, (reflected.sum(), 1)), atol=1e-6
        )
        passed = wi[~reflected]
        if len(passed):
            sine = np.sin(angle) / eta
            expected = np.array([-wo[0] / eta, -wo[1] / eta, -side * np.sqrt(1 - sine**2)])
            # close to the critical angle the cosine is the root of a small difference
            np.testing.assert_allclose(passed, np.tile(expected, (len(passed), 1)), atol=2e-4)


def test_normal_incidence_and_total_reflection() -> None:
    glass = block("materials", "dielectric", {"ior": 1.5}, "test")
    count = 400_000
    reflected = _core.bsdf_sample(glass, (0, 0, 1), 1, count)[0][:, 2] > 0
    assert proportion_p(reflected.sum(), count, 0.04) > 0.01
    critical = np.arcsin(1 / 1.5)
    for angle, total in ((critical - 0.02, False), (critical + 0.001, True), (1.5, True)):
        wo = (np.sin(angle), 0, -np.cos(angle))
        wi = _core.bsdf_sample(glass, wo, 1, 10_000)[0]
        assert bool(np.all(wi[:, 2] < 0)) is total


# --- White furnace -----------------------------------------------------------------------------


def furnace(*shapes: ph.Spheres, roulette: bool, vfov: float = 19.0, seed: int = 0) -> np.ndarray:
    """Pixels of a scene in a white sky. At 19 degrees only the unit sphere in the middle shows."""
    scene = ph.Scene(
        shapes,
        background=ph.Background("constant", radiance=(1, 1, 1)),
        camera=ph.Camera(eye=(0, 0, 4), target=(0, 0, 0), vfov=vfov),
    )
    image = ph.render(
        scene,
        width=32,
        height=32,
        spp=64,
        max_depth=1000,  # light that stays within glass for long counts too
        roulette=roulette,
        seed=seed,
        threads=1,
    )
    return image.numpy()


@by_variant
def test_white_furnace(name: str, params: dict[str, Any]) -> None:
    sphere = ph.Spheres([[0, 0, 0]], 1.0, white_material(name, params))
    pixels, room = furnace(sphere, roulette=True), room_of(name, params)
    assert np.all(np.isfinite(pixels))
    noise = 4 * pixels.std() / np.sqrt(pixels.size / 3)
    assert pixels.mean() < 1 + room + noise
    if gives_back(name, params) or name == "emissive":
        assert pixels.mean() > 1 - room - noise


@pytest.mark.parametrize("roulette", [False, True])
@pytest.mark.parametrize(
    "inner",
    [
        ph.Material("dielectric", color=(1, 1, 1), ior=1 / 1.5),  # hollow: air in glass
        ph.Material("dielectric", color=(1, 1, 1), ior=2.0),
        ph.Material("diffuse", color=(1, 1, 1)),
        ph.Material("metal", color=(1, 1, 1), fuzz=0.0),
        ph.Material("metal", color=(1, 1, 1), fuzz=0.3),
    ],
    ids=repr,
)
def test_white_furnace_within_glass(inner: ph.Material, roulette: bool) -> None:
    glass = ph.Spheres([[0, 0, 0]], 1.0, ph.Material("dielectric", color=(1, 1, 1), ior=1.5))
    pixels = furnace(glass, ph.Spheres([[0.1, 0, 0]], 0.8, inner), roulette=roulette)
    assert np.all(np.isfinite(pixels))
    assert abs(pixels.mean() - 1) < 1e-3


def heap(materials: list[ph.Material]) -> list[ph.Spheres]:
    """Six spheres of each material, mixed, none within another.

    Glass that overlaps glass is no solid, and a light in glass is dimmer than the sky by the square
    of the index: such places are not in equilibrium with a white sky.
    """
    rng = np.random.default_rng(3)
    edge = int(np.ceil((6 * len(materials)) ** (1 / 3)))
    places = np.stack(np.unravel_index(np.arange(edge**3), (edge,) * 3), axis=1)
    centers = rng.permutation(2 * (places + 0.5) / edge - 1)
    return [
        ph.Spheres(centers[6 * i : 6 * i + 6], rng.uniform(0.7, 0.99, 6) / edge, m)
        for i, m in enumerate(materials)
    ]


@pytest.mark.parametrize("roulette", [False, True])
def test_white_furnace_of_a_heap(roulette: bool) -> None:
    steady = ("diffuse", "metal", "thin_dielectric", "null")
    noisy = ("roughness", "dispersion")  # weights that are 1 only on average
    shapes = heap(
        [
            white_material(n, p)
            for n, p in VARIANTS
            if n == "dielectric" or n in steady
            if gives_back(n, p) and (n == "diffuse" or not any(p.get(k) for k in noisy))
        ]
    )
    pixels = furnace(*shapes, roulette=roulette, vfov=24.0)
    assert np.all(np.isfinite(pixels))
    assert abs(pixels.mean() - 1) < 1e-3


@pytest.mark.parametrize("name", ["dielectric", "principled"])
def test_dispersion_gives_each_colour_its_own_index(name: str) -> None:
    """Red, green and blue are those of three glasses, at indices that Abbe's number says."""
    ior, abbe = 1.7, 3.0
    glass = {"transmission": 1.0, "roughness": 0.1} if name == "principled" else {}
    rng = np.random.default_rng(1)
    sky = ph.Background("envmap", image=rng.uniform(0, 1, (4, 8, 3)).astype(np.float32))

    def blocks(seed: int, **params: float) -> np.ndarray:
        """(4, 4, 3) means over parts of the picture."""
        ball = ph.Spheres([[0, 0, 0]], 1.0, white_material(name, {**glass, **params}))
        camera = ph.Camera(eye=(0, 0, 5), target=(0, 0, 0), vfov=24.0)
        scene = ph.Scene([ball], camera=camera, background=sky)
        pixels = ph.render(scene, width=32, height=32, spp=64, seed=seed).pixels
        return pixels.reshape(4, 8, 4, 8, 3).mean(axis=(1, 3))

    count = 12
    split = np.array([blocks(seed, ior=ior, dispersion=20 / abbe) for seed in range(count)])
    plain = np.array([blocks(seed, ior=ior) for seed in range(count)])
    for channel, step in enumerate((-0.5, 0.0, 0.5)):
        own = (
            np.array([blocks(seed, ior=ior + step * (ior - 1) / abbe) for seed in range(count)])
            if step
            else plain
        )
        there, here = own[..., channel], split[..., channel]
        error = np.sqrt((there.var(axis=0, ddof=1) + here.var(axis=0, ddof=1)) / count)
        z = (here.mean(axis=0) - there.mean(axis=0)) / error
        assert np.abs(z).max() < 5, (channel, z)  # 22 degrees of freedom, 48 blocks
        if step:  # the plain glass is told apart
            wrong = plain[..., channel].mean(axis=0) - here.mean(axis=0)
            assert np.abs(wrong / error).max() > 9


def test_white_furnace_with_lights() -> None:
    """Lights as bright as the sky vanish in it, however direct light is sampled and weighed."""
    kinds = ["diffuse", "metal", "metal", "metal", "dielectric", "emissive", "emissive"]
    fuzz = {1: 0.4, 2: 1.0, 3: 0.0}
    shapes = heap(
        [
            white_material(kind, {"fuzz": fuzz[i]} if kind == "metal" else {})
            for i, kind in enumerate(kinds)
        ]
    )
    runs = np.array([furnace(*shapes, roulette=True, vfov=24.0, seed=s) for s in range(6)])
    assert np.all(np.isfinite(runs))
    means = runs.mean(axis=(1, 2, 3))
    assert mean_p(means, np.array(1.0)) > 0.01
    assert abs(means.mean() - 1) < 1e-3
    assert runs.std() > 1e-3  # there was something to weigh
