"""Every material of the core, by being listed: sampling, energy, symmetry and Fresnel."""

from __future__ import annotations

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core
from parhelion.flatten import Block, block
from statistics_tools import direction_chi_square, mean_p, proportion_p, sidak

# Where within its range each scalar parameter is tried, besides its default.
SHARES = (0.0, 0.001, 0.01, 0.1, 0.5, 1.0)


def variants() -> list[tuple[str, dict[str, float]]]:
    """Every material, with every scalar parameter over its range, one at a time."""
    found: list[tuple[str, dict[str, float]]] = []
    for row in _core.tables()["materials"]:
        scalars = [p for p in row["params"][1:] if p["size"] == 1]
        if not scalars:
            found.append((row["name"], {}))
        for p in scalars:
            values = {p["low"] + share * (p["high"] - p["low"]) for share in SHARES}
            values |= set(p["default"])
            found += [(row["name"], {p["name"]: round(v, 6)}) for v in sorted(values)]
    return found


VARIANTS = variants()
# towards the viewer: from above, from below, and close to the surface
OUTGOING = [np.array([np.sqrt(1 - z * z), 0, z]) for z in (1.0, 0.6, 0.03, -0.8, -0.1)]
OUTGOING = [v @ np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]) for v in OUTGOING]

by_variant = pytest.mark.parametrize(
    ("name", "params"), VARIANTS, ids=[f"{n}-{list(p.values())}" for n, p in VARIANTS]
)


def white(name: str, params: dict[str, float]) -> Block:
    """The parameter block with the colour 1."""
    color = next(r for r in _core.tables()["materials"] if r["name"] == name)["params"][0]["name"]
    return block("materials", name, {color: (1.0, 1.0, 1.0), **params}, "test")


def white_material(name: str, params: dict[str, float]) -> ph.Material:
    color = next(r for r in _core.tables()["materials"] if r["name"] == name)["params"][0]["name"]
    return ph.Material(name, **{color: (1.0, 1.0, 1.0)}, **params)


@by_variant
def test_samples_follow_their_density(name: str, params: dict[str, float]) -> None:
    material = white(name, params)
    for i, wo in enumerate(OUTGOING):
        wi, weight, density, delta = _core.bsdf_sample(material, wo, 10 + i, 60_000)
        alive = weight[:, 0] > 0
        if not alive.any():  # it reflects nothing
            assert not np.any(_core.bsdf_eval(material, wo, wi)[0])
            continue
        np.testing.assert_allclose(np.linalg.norm(wi[alive], axis=1), 1, atol=1e-5)
        assert np.all(delta[alive] == delta[alive][0])
        if delta[alive][0]:
            # a mirror has no density: no light sample may count for it
            assert not np.any(_core.bsdf_eval(material, wo, wi)[1])
            continue
        w = wi[alive]
        value, again = _core.bsdf_eval(material, wo, w)
        # Rounding may move a sample over the limb of a lobe, where its density has a pole.
        known = again > 0
        assert known.mean() > 0.98
        np.testing.assert_allclose(again[known], density[alive][known], rtol=1e-4)
        np.testing.assert_allclose(
            weight[alive][known] * density[alive][known, None], value[known], rtol=1e-4
        )
        mirrored = np.array([-wo[0], -wo[1], wo[2]])
        p = direction_chi_square(
            w, lambda v, wo=wo: _core.bsdf_eval(material, wo, v)[1], axis=mirrored
        )
        assert p > sidak(len(VARIANTS) * len(OUTGOING)), wo


def test_a_wrong_density_is_found() -> None:
    wo = OUTGOING[1]
    wi = _core.bsdf_sample(white("metal", {"fuzz": 0.5}), wo, 1, 60_000)[0]
    other = white("metal", {"fuzz": 0.52})
    axis = np.array([-wo[0], -wo[1], wo[2]])
    assert direction_chi_square(wi, lambda v: _core.bsdf_eval(other, wo, v)[1], axis) < 1e-6


@by_variant
def test_white_loses_and_gains_nothing(name: str, params: dict[str, float]) -> None:
    """The albedo, from any side: 1 within 0.1 % where all is reflected, never more."""
    material = white(name, params)
    for i, wo in enumerate(OUTGOING):
        wi, weight, density, _ = _core.bsdf_sample(material, wo, 30 + i, 100_000)
        assert np.all(np.isfinite(wi))
        assert np.all(np.isfinite(weight))
        assert np.all(np.isfinite(density))
        assert np.all(weight >= 0)
        albedo = weight.mean(axis=0)
        assert np.all(albedo <= 1 + 1e-5)
        if name != "emissive":  # which reflects nothing
            assert np.all(albedo > 1 - 1e-3), wo


@by_variant
def test_color_scales_what_is_scattered(name: str, params: dict[str, float]) -> None:
    kind, values = white(name, params)
    wo = OUTGOING[1]
    plain = _core.bsdf_sample((kind, values), wo, 5, 1000)
    tinted = _core.bsdf_sample((kind, [0.2, 0.5, 0.0, *values[3:]]), wo, 5, 1000)
    np.testing.assert_array_equal(plain[0], tinted[0])
    np.testing.assert_allclose(tinted[1], plain[1] * np.float32([0.2, 0.5, 0.0]), rtol=1e-6)


def test_diffuse_is_reciprocal() -> None:
    rng = np.random.default_rng(5)
    w = rng.normal(size=(200, 2, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    material = block("materials", "diffuse", {"color": (0.3, 0.6, 0.9)}, "test")
    for a, b in w.astype(np.float32):
        there = _core.bsdf_eval(material, a, b[None])[0][0] / abs(b[2])
        back = _core.bsdf_eval(material, b, a[None])[0][0] / abs(a[2])
        np.testing.assert_allclose(there, back, rtol=1e-6)
        same_side = a[2] * b[2] > 0
        np.testing.assert_allclose(
            there, np.float32([0.3, 0.6, 0.9]) / np.pi * same_side, rtol=1e-5
        )


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


@pytest.mark.parametrize("roulette", [False, True])
@by_variant
def test_white_furnace(name: str, params: dict[str, float], roulette: bool) -> None:
    sphere = ph.Spheres([[0, 0, 0]], 1.0, white_material(name, params))
    pixels = furnace(sphere, roulette=roulette)
    assert np.all(np.isfinite(pixels))
    assert abs(pixels.mean() - 1) < 1e-3
    assert pixels.max() < 1 + 1e-5


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
    shapes = heap([white_material(n, p) for n, p in VARIANTS if n != "emissive"])
    pixels = furnace(*shapes, roulette=roulette, vfov=24.0)
    assert np.all(np.isfinite(pixels))
    assert abs(pixels.mean() - 1) < 1e-3


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
