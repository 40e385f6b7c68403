"""Pictures against the references that Mitsuba keeps for its own tests, and Bitterli's.

The statistic is in reference_tools.py; figures and what was found are in docs/validation.md.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import parhelion as ph
from parhelion.io import LoadOptions
from reference_tools import (
    BATCHES,
    MITSUBA_SAMPLES,
    SIGNIFICANCE,
    XYZ_OF_RGB,
    Batches,
    Reference,
    compare,
    mitsuba_reference,
    read_linear,
    render_batches,
    save_side_by_side,
    to_xyz,
)

# Samples in all of a row; Mitsuba's tests take as many.
SAMPLES = 2_000_000

# scene -> samples, and the error in the brightness of its shapes that the row is shown to find.
ROWS: dict[str, tuple[int, float]] = {
    # 1 % was found with some random numbers and not with others (p 0.026)
    "bsdf_spheres/test_arealight_path": (8_000_000, 0.015),
    "bsdf_spheres/test_constant_path": (SAMPLES, 0.003),
    "bsdf_spheres/test_envmap_path": (2 * SAMPLES, 0.015),
    "bsdf_spheres/test_pointlight_path": (SAMPLES, 0.01),
    # light that rough glass focuses: rare and bright
    "bsdf_spheres/test_roughdielectric_path": (2 * SAMPLES, 0.03),
    "bsdf_spheres/test_roughplastic_linear_path": (SAMPLES, 0.01),
    "bsdf_spheres/test_roughplastic_nonlinear_path": (SAMPLES, 0.01),
    "instancing/test_instancing_path": (SAMPLES, 0.003),
    "orthographic_sensor/test_orthographic_path": (SAMPLES, 0.01),
    "participating_media/test_surf_area_light_volpath": (SAMPLES, 0.01),
    # one sample a pixel in each batch
    "various_shapes/test_various_shapes_path": (BATCHES * 480 * 480, 0.01),
}

# Scenes that have participating media.
MEDIA = (
    "participating_media/test_hetero_sigmat_volpath",
    "participating_media/test_homo_area_light_volpath",
    "participating_media/test_homo_dielectric_envmap_volpath",
    "participating_media/test_homo_emitter_inside_medium_volpath",
    "participating_media/test_homo_null_envmap_volpath",
    "participating_media/test_homo_obj_inside_medium_volpath",
    "participating_media/test_homo_roughdielectric_spot_volpath",
)


def mitsuba_scene(shared_scenes: Path, row: str) -> tuple[Path, ph.Scene]:
    data = shared_scenes / "mitsuba-data"
    path = data / "tests" / "scenes" / f"{row}.xml"
    options = LoadOptions(allow_paths=(str(data),), strict=True)
    return path, ph.load(path, options)


@pytest.mark.parametrize("row", ROWS)
def test_scene_matches_mitsuba(
    row: str, shared_scenes: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    path, scene = mitsuba_scene(shared_scenes, row)
    reference = mitsuba_reference(path)
    height, width = reference.mean.shape[:2]
    assert (scene.settings.height, scene.settings.width) == (height, width)
    samples, found = ROWS[row]
    spp = samples // (height * width * BATCHES)
    prepared = ph.prepare(scene)
    with caplog.at_level(logging.WARNING, "parhelion"):
        ours = render_batches(
            lambda seed: ph.render(prepared, spp=spp, seed=seed, sampler="independent").pixels
        )
    # samples that are not finite count as black and are told of
    assert "not finite" not in caplog.text
    assert np.isfinite(ours.pictures).all()

    xyz = to_xyz(ours.pictures)
    verdict = compare(Batches(xyz), reference, spp)
    picture = tmp_path / f"{path.stem}.png"
    save_side_by_side(ours.mean, reference.mean @ np.linalg.inv(XYZ_OF_RGB).T, picture)
    assert verdict.agrees, f"{verdict}; ours, Mitsuba's and 5 x their difference: {picture}"

    # and it would not, were the shapes a little too dark or too bright
    features = ph.render(prepared, spp=4, features=True).features
    covered = features["coverage"].reshape(height, width, 1) > 0
    for factor in (1.0 - found, 1.0 + found):
        wrong = xyz * np.where(covered, factor, 1.0)
        assert not compare(Batches(wrong), reference, spp).agrees, factor


@pytest.mark.parametrize("row", MEDIA)
def test_media_are_told_of(row: str, shared_scenes: Path):
    """Not rows yet: what they are about is not rendered, and --strict says so."""
    with pytest.raises(ph.FormatError, match="participating media"):
        mitsuba_scene(shared_scenes, row)


def test_every_scene_is_a_row(shared_scenes: Path):
    folder = shared_scenes / "mitsuba-data" / "tests" / "scenes"
    found = {p.relative_to(folder).with_suffix("").as_posix() for p in folder.glob("*/*.xml")}
    assert found == {*ROWS, *MEDIA}


# --- The statistic itself -----------------------------------------------------------------------

SHAPE = (16, 16, 3)
SPP = 27

# How a pixel's samples may scatter: name -> (mean of n samples of mean 1, variance of one).
Scatter = tuple[Callable[[np.random.Generator, int, tuple[int, ...]], np.ndarray], float]
SCATTERS: dict[str, Scatter] = {
    "exponential": (lambda rng, n, shape: rng.gamma(n, 1 / n, shape), 1.0),
    # one sample in a thousand brings all the light, so that most batches are black
    "rare": (lambda rng, n, shape: rng.poisson(n / 1000, shape) * (1000 / n), 1000.0),
    # every sample the same
    "none": (lambda _rng, _n, shape: np.ones(shape), 0.0),
}


def trial(kind: str, seed: int, truth: np.ndarray) -> tuple[Batches, Reference]:
    """Our batches and a reference, all with the same mean."""
    means, variance = SCATTERS[kind]
    rng = np.random.default_rng(seed)
    ours = truth * means(rng, SPP, (BATCHES, *truth.shape))
    reference = truth * means(rng, MITSUBA_SAMPLES, truth.shape)
    return Batches(ours), Reference(reference, variance * truth**2)


@pytest.mark.parametrize("kind", SCATTERS)
def test_correct_pictures_pass(kind: str):
    truth = np.random.default_rng(0).random(SHAPE)
    trials = 200
    failed = sum(not compare(*trial(kind, seed, truth), SPP).agrees for seed in range(trials))
    assert stats.binomtest(failed, trials, SIGNIFICANCE, "greater").pvalue > 1e-3, failed


def test_correct_batches_pass():
    """Two renderers of which neither's noise is known."""
    truth = np.random.default_rng(0).random(SHAPE)
    trials = 200
    failed = 0
    for seed in range(trials):
        pair = [trial("exponential", 2 * seed + i, truth)[0] for i in range(2)]
        failed += not compare(pair[0], pair[1], SPP).agrees
    assert stats.binomtest(failed, trials, SIGNIFICANCE, "greater").pvalue > 1e-3, failed


# what is wrong -> the size of the blocks that find it
WRONG: dict[str, tuple[Callable[[np.ndarray], np.ndarray], set[int]]] = {
    "all 1 % brighter": (lambda p: 1.01 * p, {16}),
    "one channel 2 % darker": (lambda p: p * np.array([1.0, 0.98, 1.0]), {16}),
    "a quarter 3 % brighter": (lambda p: p * quarter(p.shape, 1.03), {8}),
    "one pixel twice as bright": (lambda p: p * one_pixel(p.shape, 2.0), {1}),
    "moved by a pixel": (lambda p: np.roll(p, 1, axis=-2), {1, 2}),
}


def quarter(shape: tuple[int, ...], factor: float) -> np.ndarray:
    weights = np.ones(shape[-3:])
    weights[8:, :8] = factor
    return weights


def one_pixel(shape: tuple[int, ...], factor: float) -> np.ndarray:
    weights = np.ones(shape[-3:])
    weights[5, 11] = factor
    return weights


@pytest.mark.parametrize("name", WRONG)
def test_wrong_pictures_fail(name: str):
    spoil, sizes = WRONG[name]
    # 2, 1, 2, 1 ... from column to column
    truth = np.ones(SHAPE) + (np.arange(SHAPE[1]) % 2 == 0)[None, :, None]
    ours, reference = trial("exponential", 1, truth)
    assert compare(ours, reference, SPP).agrees
    verdict = compare(Batches(spoil(ours.pictures)), reference, SPP)
    assert not verdict.agrees
    assert verdict.test.size in sizes


def test_pixels_that_do_not_count():
    truth = np.ones((13, 9, 3))
    ours, reference = trial("exponential", 3, truth)
    wrong = ours.pictures.copy()
    wrong[:, 2:5, 3:6] *= 3.0
    weights = np.ones((13, 9))
    assert not compare(Batches(wrong), reference, SPP, weights).agrees
    weights[2:5, 3:6] = 0.0
    verdict = compare(Batches(wrong), reference, SPP, weights)
    assert verdict.agrees
    np.testing.assert_allclose(verdict.ratio, 1.0, atol=0.02)


def test_pictures_of_different_sizes():
    ours, reference = trial("none", 1, np.ones(SHAPE))
    with pytest.raises(ValueError, match="a picture of"):
        compare(ours, Reference(reference.mean[:8], reference.variance[:8]), SPP)


# --- Bitterli's scenes, rendered by Tungsten ------------------------------------------------------

# Pixels of the reference, along an edge, to one of ours.
COARSER = 8

# folder -> longest path; parts of our small picture, (x, y, width, height), that are noisy. The
# reference of veach-mis has direct light only. The smallest lamp fills 2 pixels and gives 22 % of
# the mean; the other part is its mirror image.
BITTERLI: dict[str, tuple[int, tuple[tuple[int, int, int, int], ...]]] = {
    "bitterli-cornell-box": (65, ()),
    "bitterli-veach-mis": (2, ((50, 14, 10, 8), (50, 34, 14, 12))),
}


@pytest.mark.parametrize("folder", BITTERLI)
def test_bitterli_mean(folder: str, shared_scenes: Path, tmp_path: Path):
    depth, noisy = BITTERLI[folder]
    tungsten = read_linear(shared_scenes / folder / "TungstenRender.exr")
    height, width = (n // COARSER for n in tungsten.shape[:2])
    small = tungsten.reshape(height, COARSER, width, COARSER, 3).mean(axis=(1, 3))
    scene = ph.load(shared_scenes / folder / "mitsuba3" / "scene.xml", LoadOptions(strict=True))
    prepared = ph.prepare(scene)
    # a box: so each pixel is the mean of as many of the reference's
    asked: dict[str, Any] = {"width": width, "height": height, "max_depth": depth}
    asked |= {"filter": "box", "filter_radius": 0.5}
    ours = ph.render(prepared, spp=64, **asked).pixels
    for x, y, w, h in noisy:
        part = ph.render(prepared, spp=4096, crop=(x, y, w, h), **asked)
        ours[y : y + h, x : x + w] = part.pixels
    picture = tmp_path / f"{folder}.png"
    save_side_by_side(ours, small, picture)
    ratio = ours.mean(axis=(0, 1), dtype=np.float64) / small.mean(axis=(0, 1), dtype=np.float64)
    np.testing.assert_allclose(ratio, 1.0, atol=0.01, err_msg=str(picture))
