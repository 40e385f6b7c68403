"""Every sampling routine of the core against its own density, by being listed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import parhelion as ph
from parhelion import _core, tables
from statistics_tools import (
    SIGNIFICANCE,
    chi_square,
    direction_chi_square,
    point_chi_square,
    proportion_p,
    sidak,
)

COUNT = 200_000

WARPS = [
    (row["name"], parameter)
    for row in _core.tables()["warps"]
    for parameter in ((1e-4, 0.05, 0.5, 0.9, 0.999) if row["parameter"] else (0.0,))
]


def uniform_pairs(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 2)).astype(np.float32) * np.float32(
        1 - 2**-24
    )


def warp_p(name: str, parameter: float, wrong: float = 0.0) -> float:
    """p-value of a mapping; `wrong` is added to the parameter of its density alone."""
    w = _core.warp(name, parameter, uniform_pairs(COUNT, 1))
    if np.all(w[:, 2] == 0):  # points of a plane

        def area_pdf(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            p = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
            return _core.warp_pdf(name, parameter + wrong, p)

        return point_chi_square(w[:, :2], area_pdf, (-1, -1), (1, 1))
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1, atol=1e-6)
    return direction_chi_square(w, lambda v: _core.warp_pdf(name, parameter + wrong, v))


@pytest.mark.parametrize(("name", "parameter"), WARPS)
def test_warp_follows_its_density(name: str, parameter: float) -> None:
    assert warp_p(name, parameter) > sidak(len(WARPS))


def test_a_wrong_density_is_found() -> None:
    # 2 % off in one parameter of a lobe: no plot would show it
    assert warp_p("fuzzy_lobe", 0.5, wrong=0.01) < 1e-6
    # normalised, and quite another shape
    w = _core.warp("cosine_hemisphere", 0.0, uniform_pairs(COUNT, 1))
    uniform = 1 / (2 * np.pi)
    assert direction_chi_square(w, lambda v: uniform * (v[:, 2] > 0)) < 1e-6
    # not normalised at all
    with pytest.raises(AssertionError, match="integrates to"):
        direction_chi_square(w, lambda v: 1.1 * _core.warp_pdf("cosine_hemisphere", 0.0, v))


@pytest.mark.parametrize("edge", [0.0, 1 - 2**-24])
@pytest.mark.parametrize(("name", "parameter"), WARPS)
def test_warp_at_the_ends_of_the_unit_interval(name: str, parameter: float, edge: float) -> None:
    u = np.array([[edge, 0.3], [0.3, edge], [edge, edge]], np.float32)
    assert np.all(np.isfinite(_core.warp(name, parameter, u)))


# --- Pixel filters ---------------------------------------------------------------------------

FILTERS = [
    (row["name"], radius) for row in _core.tables()["filters"] for radius in (0.0, 0.25, 3.0)
]


@pytest.mark.parametrize(("name", "radius"), FILTERS)
def test_filter_offsets_follow_the_filter(name: str, radius: float) -> None:
    u = uniform_pairs(COUNT, 2)[:, 0].copy()
    offsets = _core.filter_offsets(name, radius, u)
    edge = radius or tables.tables()["filters"][name].radius
    assert np.all(np.abs(offsets) <= np.float32(edge))
    assert np.all(np.diff(offsets[np.argsort(u, kind="stable")]) >= 0)

    bins, fine = 40, 100
    x = -edge + 2 * edge * (np.arange(bins * fine) + 0.5) / (bins * fine)
    values = np.array(_core.filter_values(name, radius, list(x)))
    assert np.all(values >= 0)
    np.testing.assert_allclose(values, values[::-1], atol=1e-12)
    mass = values.reshape(bins, fine).sum(axis=1) / values.sum()
    observed = np.histogram(offsets, bins, (-edge, edge))[0]
    assert chi_square(observed, mass * COUNT) > sidak(len(FILTERS))


def test_filter_values_against_their_formulas() -> None:
    x = np.linspace(-1.4, 1.4, 29)
    t = x / 1.5
    window = 0.35875 + sum(
        a * np.cos(k * np.pi * t) for k, a in ((1, 0.48829), (2, 0.14128), (3, 0.01168))
    )
    bell = np.exp(-2 * x**2) - np.exp(-2 * 1.5**2)
    for name, expected in (("blackman-harris", window), ("gaussian", bell)):
        np.testing.assert_allclose(_core.filter_values(name, 1.5, list(x)), expected, atol=1e-9)
    np.testing.assert_allclose(_core.filter_values("tent", 1.0, [-0.25, 0.5, 2.0]), [0.75, 0.5, 0])
    np.testing.assert_allclose(_core.filter_values("box", 0.5, [-0.5, 0.5, 0.51]), [1, 1, 0])


# --- Lights ------------------------------------------------------------------------------------

# centre, radius, radiance: from a pin far off to a lamp that fills half the sky
LIGHTS = [
    ((0.0, 3.0, 0.0), 0.5, (4.0, 2.0, 1.0)),
    ((3.0, -1.0, 0.0), 1.5, (0.1, 0.2, 0.3)),
    ((-200.0, 10.0, 30.0), 0.2, (100.0, 100.0, 100.0)),
    ((0.3, 0.0, -1.1), 1.1, (0.0, 0.4, 0.0)),
]


def lit_scene() -> _core.Scene:
    shapes = [
        ph.Spheres([c], r, ph.Material("emissive", radiance=e), name=f"light {i}")
        for i, (c, r, e) in enumerate(LIGHTS)
    ]
    shapes.append(ph.Spheres([[9.0, 9.0, 9.0]], 2.0, ph.Material("diffuse")))
    shapes.append(ph.Spheres([[1.0, 1.0, 1.0]], 0.1, ph.Material("emissive", radiance=(0, 0, 0))))
    return ph.prepare(ph.Scene(shapes)).core


def test_light_sample_follows_its_density() -> None:
    core = lit_scene()
    assert core.stats()["lights"] == len(LIGHTS)  # a black one is none
    origin = np.array([0.2, 0.5, 0.3])
    directions, distances, densities, seen = (
        np.asarray(a, float) for a in core.light_sample(list(origin), 3, COUNT)
    )
    centers, radii, radiances = (np.array(column) for column in zip(*LIGHTS, strict=True))
    offsets = centers - origin
    far = np.linalg.norm(offsets, axis=1)
    sine2 = (radii / far) ** 2
    spread = sine2 / (1 + np.sqrt(1 - sine2))

    light = np.argmin(np.abs(seen[:, None] - radiances).sum(axis=2), axis=1)
    # what is left of the density is the choice of the light, the same for all samples of one
    shares = densities * (2 * np.pi * spread[light])
    share = np.array([np.median(shares[light == i]) for i in range(len(LIGHTS))])
    np.testing.assert_allclose(shares, share[light], rtol=1e-5)
    assert share.sum() == pytest.approx(1, abs=1e-5)
    counts = np.bincount(light, minlength=len(LIGHTS))
    assert chi_square(counts, share * COUNT) > SIGNIFICANCE
    scale = core.stats()["scale"]
    for i in range(len(LIGHTS)):
        w = directions[light == i]
        axis = offsets[i] / far[i]

        def cone(v: np.ndarray, axis: np.ndarray = axis, spread: float = spread[i]) -> np.ndarray:
            inside = np.sum((v - axis) ** 2, axis=1) / 2 <= spread
            return inside / (2 * np.pi * spread)

        if spread[i] > 1e-5:
            assert direction_chi_square(w, cone, axis) > sidak(len(LIGHTS))
        # Where the direction enters the sphere. Near its limb the root is known to the square root
        # of float's precision, in units of the radius.
        unit = w / np.linalg.norm(w, axis=1, keepdims=True)
        b = unit @ offsets[i]
        perpendicular2 = np.sum((offsets[i] - b[:, None] * unit) ** 2, axis=1)
        half = np.sqrt(np.maximum(radii[i] ** 2 - perpendicular2, 0))
        np.testing.assert_allclose(
            distances[light == i] / scale, b - half, rtol=1e-5, atol=2e-2 * radii[i]
        )


def test_a_wrong_light_density_is_found() -> None:
    core = lit_scene()
    directions, _, _, seen = core.light_sample([0.2, 0.5, 0.3], 3, COUNT)
    # all lights as if each were as likely: what a sampler that forgets the power would claim
    counts = np.unique(seen, axis=0, return_counts=True)[1]
    assert chi_square(counts, np.full(len(counts), COUNT / len(counts))) < 1e-6
    assert directions.shape == (COUNT, 3)


def test_no_light_is_sampled_from_inside_of_it() -> None:
    core = ph.prepare(
        ph.Scene([ph.Spheres([[0, 0, 0]], 2.0, ph.Material("emissive", radiance=(1, 1, 1)))])
    ).core
    assert not np.any(core.light_sample([0.5, 0.5, 0.5], 0, 100)[2])


# --- Random numbers ----------------------------------------------------------------------------

SAMPLERS = [row["name"] for row in _core.tables()["samplers"]]
PIXELS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1919, 1079, 0), (0, 0, 1), (7, 3, 2**63)]


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_draws_are_uniform_over_pixels(sampler: str) -> None:
    # one sample of one dimension, over many pixels: where the randomness of both samplers lies
    points = np.concatenate(
        [_core.draws(sampler, i % 200, i // 200, 5, 1, 3, 9) for i in range(20_000)]
    )
    assert np.all((points >= 0) & (points < 1))
    observed = np.histogram2d(*points.T, 12, [(0, 1), (0, 1)])[0]
    assert chi_square(observed, np.full(144, len(points) / 144)) > sidak(len(SAMPLERS))


@pytest.mark.parametrize("dimension", [0, 1, 17])
def test_independent_draws_are_uniform_over_samples(dimension: int) -> None:
    points = _core.draws("independent", 3, 4, 0, COUNT, dimension, 11)
    for size in (16, 64):
        observed = np.histogram2d(*points.T, size, [(0, 1), (0, 1)])[0]
        assert chi_square(observed, np.full(size**2, COUNT / size**2)) > sidak(6)
    # and each says nothing of the next
    observed = np.histogram2d(points[:-1, 0], points[1:, 0], 16, [(0, 1), (0, 1)])[0]
    assert chi_square(observed, np.full(256, (COUNT - 1) / 256)) > sidak(3)


@pytest.mark.parametrize("dimension", [0, 1, 2, 30])
@pytest.mark.parametrize(("x", "y", "seed"), PIXELS)
def test_sobol_is_stratified_over_powers_of_two(x: int, y: int, seed: int, dimension: int) -> None:
    """Every elementary interval of 2^-k holds one of every 2^k samples that stand together."""
    points = _core.draws("sobol", x, y, 0, 1024, dimension, seed)
    for k in range(11):
        for first in (0, 1024 - 2**k):
            part = points[first : first + 2**k].astype(float)
            for a in range(k + 1):
                cell = np.floor(part * [2**a, 2 ** (k - a)]).astype(int)
                index = cell[:, 0] * 2 ** (k - a) + cell[:, 1]
                assert np.unique(index).size == 2**k, (k, a, first)


def test_sobol_is_stratified_far_into_the_sequence() -> None:
    points = _core.draws("sobol", 5, 5, 2**31 - 256, 256, 1, 3).astype(float)
    for a in range(9):
        cell = np.floor(points * [2**a, 2 ** (8 - a)]).astype(int)
        assert np.unique(cell[:, 0] * 2 ** (8 - a) + cell[:, 1]).size == 256


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_dimensions_are_not_correlated(sampler: str) -> None:
    # 256 samples of 64 pixels in 6 dimensions: every pair, joint over a 8 x 8 grid
    drawn = np.stack(
        [
            np.concatenate([_core.draws(sampler, p, 2, 0, 256, d, 0)[:, 0] for p in range(64)])
            for d in range(6)
        ]
    )
    pairs = [(a, b) for a in range(6) for b in range(a)]
    for a, b in pairs:
        correlation = np.corrcoef(drawn[a], drawn[b])[0, 1]
        # Stratified draws scatter less than independent ones, whose bound this is.
        assert abs(correlation) < stats.norm.isf(sidak(len(pairs)) / 2) / np.sqrt(drawn.shape[1])
        joint = np.histogram2d(drawn[a], drawn[b], 8, [(0, 1), (0, 1)])[0]
        assert chi_square(joint, np.full(64, drawn.shape[1] / 64)) > sidak(len(pairs))


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_pixels_seeds_and_dimensions_differ(sampler: str) -> None:
    sets = [_core.draws(sampler, x, y, 0, 64, d, seed) for x, y, seed in PIXELS for d in (0, 1, 40)]
    for i, a in enumerate(sets):
        for b in sets[:i]:
            assert np.mean(a == b) < 0.05
    np.testing.assert_array_equal(sets[0][7:20], _core.draws(sampler, 0, 0, 7, 13, 0, 0))


@pytest.mark.parametrize(("samples", "gain"), [(16, 3.0), (64, 8.0), (256, 20.0)])
def test_sobol_integrates_better_than_independent(samples: int, gain: float) -> None:
    """Of a smooth integrand the error falls like n^-1.5 and not like n^-0.5."""

    def errors(sampler: str) -> np.ndarray:
        p = np.stack(
            [_core.draws(sampler, x, 0, 0, samples, 0, 5).astype(float) for x in range(400)]
        )
        f = np.exp(p[..., 0]) * np.cos(p[..., 1])
        return f.mean(axis=1) - (np.e - 1) * np.sin(1)

    sobol, independent = errors("sobol"), errors("independent")
    assert np.sqrt(np.mean(independent**2) / np.mean(sobol**2)) > gain
    for e in (sobol, independent):  # and neither is biased
        assert stats.ttest_1samp(e, 0.0).pvalue > sidak(6)


def test_chi_square_of_known_tables() -> None:
    assert chi_square(np.array([50, 50]), np.array([50.0, 50.0])) == 1.0
    # 60 of 100: chi-square 4 with one degree of freedom
    assert chi_square(np.array([60, 40]), np.array([50.0, 50.0])) == pytest.approx(0.0455, abs=1e-4)
    # pooled: the four rare bins count as one
    rare = chi_square(np.array([96, 1, 1, 1, 1]), np.array([92.0, 2.0, 2.0, 2.0, 2.0]))
    assert rare == pytest.approx(stats.chi2.sf(16 / 92 + 16 / 8, 1))
    assert chi_square(np.array([99, 1]), np.array([100.0, 0.0])) == 0.0
    assert proportion_p(500, 1000, 0.5) == pytest.approx(1.0)
    assert proportion_p(600, 1000, 0.5) < 1e-9
