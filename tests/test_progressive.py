"""Rendering until the noise is low enough or the time is up, and how well the noise is known."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core
from parhelion.progressive import (
    CONFIDENCE,
    block_errors,
    cell_areas,
    errors_by_others,
    next_round,
    picture_error,
)
from parhelion.renderer import make_view, merged, prepare

SIZE = {"width": 48, "height": 27}


@pytest.fixture(scope="module")
def spheres() -> Any:
    return prepare(ph.weekend())


@pytest.fixture(scope="module")
def truth(spheres: Any) -> np.ndarray:
    return ph.render(spheres, spp=2048, seed=1000, **SIZE).numpy().astype(float)


def deviations(picture: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Of each pixel, the root mean square of three channels as a share of its brightness."""
    brightness = truth.mean(axis=2) + 0.01 * truth.mean()
    return np.sqrt(((picture - truth) ** 2).mean(axis=2)) / brightness


@pytest.mark.parametrize(
    ("sampler", "spp", "low", "high"),
    [
        ("independent", 96, 0.9, 1.1),  # unbiased
        ("independent", 113, 0.9, 1.1),
        ("sobol", 96, 1.0, 2.5),  # on the safe side
        ("sobol", 64, 1.0, 2.5),
    ],
)
def test_the_error_is_estimated_as_large_as_it_is(
    spheres: Any, truth: np.ndarray, sampler: str, spp: int, low: float, high: float
) -> None:
    estimated, true = [], []
    for seed in range(12):
        image = ph.render(spheres, sampler=sampler, spp=spp, noise=1e-6, seed=seed, **SIZE)
        assert image.stats.error is not None
        assert image.stats.ended == "spp"
        estimated.append((image.stats.error / CONFIDENCE) ** 2)
        true.append((deviations(image.numpy(), truth) ** 2).mean())
    assert low < np.mean(estimated) / np.mean(true) < high


def test_95_of_100_pixels_are_as_near_to_the_truth_as_was_asked_for(
    spheres: Any, truth: np.ndarray
) -> None:
    within = []
    for seed in range(6):
        image = ph.render(spheres, noise=0.15, seed=seed, **SIZE)
        assert image.stats.ended == "noise"
        assert image.stats.error <= 0.15
        within.append((deviations(image.numpy(), truth) <= 0.15).mean())
    assert min(within) > 0.93
    assert np.mean(within) > 0.95


def test_pixels_are_those_of_a_picture_with_as_many_samples(spheres: Any) -> None:
    image = ph.render(spheres, noise=0.15, **SIZE)
    counts = np.unique(image.counts)
    assert len(counts) > 2  # calm parts get fewer
    np.testing.assert_array_equal(image.features["samples"], image.counts)
    for count in counts:
        even = ph.render(spheres, spp=int(count), **SIZE).numpy()
        these = image.counts == count
        np.testing.assert_array_equal(image.numpy()[these], even[these])


def test_how_it_is_watched_changes_nothing(spheres: Any) -> None:
    alone = ph.render(spheres, noise=0.2, threads=1, **SIZE)
    seen: list[ph.Progress] = []
    watched = ph.render(spheres, noise=0.2, threads=3, tile=5, progress=seen.append, **SIZE)
    np.testing.assert_array_equal(alone.numpy(), watched.numpy())
    np.testing.assert_array_equal(alone.counts, watched.counts)
    assert seen[-1].error is not None
    assert seen[-1].fraction == 1.0
    assert all(0 <= state.fraction <= 1 for state in seen)
    assert seen[-1].samples == watched.counts.sum() == watched.stats.samples


def test_samples_are_the_ceiling_of_noise(spheres: Any) -> None:
    for spp in (1, 5, 20):
        image = ph.render(spheres, noise=0.01, spp=spp, **SIZE)
        assert (image.stats.ended, image.counts.max()) == ("spp", spp)
        assert image.stats.complete
        np.testing.assert_array_equal(image.numpy(), ph.render(spheres, spp=spp, **SIZE).numpy())


def test_noise_may_come_from_the_scene(spheres: Any) -> None:
    settings = ph.Settings(width=48, height=27, spp=32, noise=0.5)
    image = ph.render(spheres.scene.replace(settings=settings))
    assert image.settings.noise == 0.5
    assert image.counts.max() <= 32


def test_time_ends_it(spheres: Any) -> None:
    start = time.perf_counter()
    image = ph.render(spheres, time_limit=0.3, **SIZE)
    assert time.perf_counter() - start < 5
    assert (image.stats.ended, image.stats.complete) == ("time", True)
    assert image.counts.max() > 0
    assert image.stats.error is not None
    done = ph.render(spheres, time_limit=60, spp=4, **SIZE)
    assert (done.stats.ended, done.counts.min(), done.counts.max()) == ("spp", 4, 4)


def test_nothing_to_see_has_no_error() -> None:
    image = ph.render(ph.Scene([], background=None, camera=ph.Camera()), noise=0.1, **SIZE)
    assert (image.stats.ended, image.stats.error) == ("noise", 0.0)
    assert image.counts.max() == 16


def test_a_film_says_where_its_noise_is() -> None:
    # The left half is one colour; the right half is lit by a lamp that paths find by chance.
    lamp = ph.Spheres([(0.8, 1.5, 0.0)], 0.3, material="lamp")
    wall = ph.Mesh(
        [(0, -1, 0), (2, -1, 0), (2, 1, 0), (0, 1, 0)],
        [(0, 1, 2), (0, 2, 3)],
        material=ph.Material("diffuse"),
    )
    camera = ph.Camera((0, 0, 3), (0, 0, 0), projection="orthographic", height=1.6)
    shining = {"lamp": ph.Material("emissive", radiance=(5.0, 5.0, 5.0))}
    scene = ph.Scene([lamp, wall], shining, camera, background=ph.Background("constant"))
    image = ph.render(scene, noise=1e-3, spp=16, width=64, height=32)
    error = image.features["error"]
    assert error[:, :16].max() < 1e-6
    assert error[:, 48:].min() > 1e-3


def test_errors_are_of_every_other_row_of_blocks(spheres: Any) -> None:
    settings = merged(ph.Settings(), {"width": 20, "height": 11, "filter": "box"})
    assert spheres.scene.camera is not None
    view = make_view(spheres.core, spheres.scene.camera, settings)
    with pytest.raises(ValueError, match="without errors"):
        _core.Film(0, 0, 20, 11).errors()
    film = _core.Film(0, 0, 20, 11, False, True)
    work = {"threads": 1, "tile": 16, "schedule": "dynamic", "isa": "", "tick": None}
    film.render(spheres.core, view, 1, **work)
    assert np.isinf(film.errors()).all()  # one sample tells nothing
    targets = np.full((4, 3), 7, np.uint32)
    targets[0, 1], targets[3, 2] = 12, 9
    film.render(spheres.core, view, targets, **work)
    assert film.errors().shape == (4, 3)
    areas = np.array([[32, 32, 16], [32, 32, 16], [16, 16, 8], [8, 8, 4]])
    np.testing.assert_array_equal(cell_areas(film), areas)
    # What they are by their definition, from samples one by one
    expected = np.zeros((4, 3))
    pixels, counts, _ = film.arrays()
    dark = 0.01 * pixels.astype(float).mean(axis=2).mean()
    for y in range(11):
        for x in range(20):
            cell = y // 8 * 2 + y % 2, x // 8
            n = int(counts[y, x])
            assert n == targets[cell]
            samples = np.array([_core.one_sample(spheres.core, view, x, y, s) for s in range(n)])
            power = 1 << (n.bit_length() - 1)
            parts = [samples[: power // 2], samples[power // 2 : power], samples[power:]]
            mean = samples.mean(axis=0)
            variance = sum(len(p) * (p.mean(axis=0) - mean) ** 2 for p in parts) / (2 * n)
            expected[cell] += variance.mean() / (mean.mean() + dark) ** 2 / areas[cell]
    np.testing.assert_allclose(film.errors(), expected, rtol=1e-4)
    # a block is as noisy as it is itself or as its surroundings are, whichever is more
    both = (expected * areas).reshape(2, 2, 3).sum(1) / areas.reshape(2, 2, 3).sum(1)
    around = [both[np.ix_(rows, columns)].mean() for rows, columns in _NEIGHBOURS]
    told = CONFIDENCE * np.sqrt(np.maximum(both.ravel(), around))
    np.testing.assert_allclose(block_errors(film).ravel(), told, rtol=1e-4)
    overall = CONFIDENCE * math.sqrt((expected * areas).sum() / 220)
    assert picture_error(film) == pytest.approx(overall, rel=1e-4)


# Rows and columns around each of 2 x 3 blocks; those beyond the edge count as the nearest.
_NEIGHBOURS = [
    ([0, 0, 1] if down == 0 else [0, 1, 1], [max(across - 1, 0), across, min(across + 1, 2)])
    for down in range(2)
    for across in range(3)
]


def test_rows_that_are_alone_in_their_block_tell_of_themselves(spheres: Any) -> None:
    image = ph.render(spheres, noise=0.3, width=24, height=9, spp=4096)
    assert image.stats.ended == "noise"
    assert image.counts[8].max() > 16


def test_a_cells_own_samples_have_no_say() -> None:
    rng = np.random.default_rng(1)
    squares, counts = rng.random((6, 4)), np.full((6, 4), 64, np.uint32)
    told = errors_by_others(squares, counts)
    for row in range(6):
        for column in range(4):
            others = squares.copy()
            others[row % 2 :: 2] = rng.random((3, 4))  # its own rows, and all like them
            assert errors_by_others(others, counts)[row, column] == told[row, column]
    # those of the same block, or those all around, whichever tell more
    beside = squares.reshape(3, 2, 4)[1, 1, 1:3]
    around = squares.reshape(3, 2, 4)[:, 1].copy()
    means = np.array([around[:, i : i + 3].mean() for i in range(2)])
    np.testing.assert_allclose(told[2, 1:3], CONFIDENCE * np.sqrt(np.maximum(beside, means)))


def test_more_samples_than_the_others_have_are_nearer_to_the_truth() -> None:
    squares, counts = np.full((2, 3), 0.04), np.full((2, 3), 64, np.uint32)
    counts[0] = 256
    told = errors_by_others(squares, counts)
    np.testing.assert_allclose(told[0], CONFIDENCE * 0.1)
    np.testing.assert_allclose(told[1], CONFIDENCE * 0.2)


def ended_at_noise(samples: np.ndarray, others: bool, noise: float) -> list[float]:
    """The means of two cells, (cells, pixels, samples), when others, or they themselves, say so."""
    counts = np.full((2, 1), 16, np.uint32)
    while True:
        squares = np.zeros((2, 1))
        for cell, n in enumerate(counts[:, 0]):
            parts = samples[cell, :, :n].reshape(samples.shape[1], -1, n // 8).mean(axis=2)
            squares[cell] = (parts.var(axis=1, ddof=1) / 8 / parts.mean(axis=1) ** 2).mean()
        told = errors_by_others(squares if others else squares[::-1], counts)
        more = (told > noise) & (counts < samples.shape[2])
        if not more.any():
            return [samples[cell, :, :n].mean() for cell, n in enumerate(counts[:, 0])]
        counts[more] *= 2


def test_when_others_decide_rare_light_is_not_lost() -> None:
    """Pixels that are 30 with a chance of 1 in 50, and 1 otherwise."""
    rng = np.random.default_rng(2)
    expected, others, own = 1.58, [], []
    for _ in range(400):
        samples = np.where(rng.random((2, 32, 4096)) < 0.02, 30.0, 1.0)
        others += ended_at_noise(samples, True, 0.4)
        own += ended_at_noise(samples, False, 0.4)
    spread = np.std(others) / math.sqrt(len(others))
    assert np.mean(others) == pytest.approx(expected, abs=3 * spread)
    difference = np.subtract(others, own)
    assert difference.mean() > 3 * difference.std() / math.sqrt(len(own))


def test_rounds_overshoot_by_half_at_most() -> None:
    counts = np.arange(1, 5000, dtype=np.uint32)
    following = next_round(counts)
    assert (following > counts).all()
    assert (following[1:] <= counts[1:] * 1.5).all()
    assert set(next_round(following[50:])) <= {
        *(2**k for k in range(20)),
        *(3 * 2**k for k in range(20)),
    }


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"noise": 0}, "noise is 0.0; must be > 0"),
        ({"noise": -0.1}, "noise is -0.1; must be > 0"),
        ({"noise": math.nan}, "noise is nan; must be > 0"),
        ({"noise": "low"}, "noise is 'low'; must be a number"),
        ({"time_limit": 0}, "time_limit is 0.0; must be > 0"),
        ({"time_limit": "60"}, "time_limit is '60'; must be a number"),
        ({"checkpoint_every": None}, "checkpoint_every must be a number of seconds"),
        ({"checkpoint_every": 0}, "checkpoint_every is 0.0; must be > 0"),
        ({"resume": True}, "resume needs checkpoint"),
        ({"resume": 1}, "resume is 1; must be True or False"),
    ],
)
def test_mistakes_are_told(spheres: Any, options: dict[str, Any], said: str) -> None:
    with pytest.raises(ph.SceneError) as caught:
        ph.render(spheres, **options, **SIZE)
    assert str(caught.value) == said


def test_clamped_light_is_that_of_more_than_one_scattering(spheres: Any) -> None:
    free, clamped = (
        ph.render(spheres, spp=8, features=True, clamp_indirect=most, **SIZE)
        for most in (None, 0.05)
    )
    for name in ("direct", "emission", "albedo"):
        np.testing.assert_array_equal(free.features[name], clamped.features[name])
    assert (clamped.numpy() <= free.numpy()).all()
    assert clamped.features["indirect"].mean() < 0.9 * free.features["indirect"].mean()
    sharp = ph.render(spheres, spp=8, clamp_indirect=1e30, **SIZE)
    np.testing.assert_array_equal(sharp.numpy(), free.numpy())
    with pytest.raises(ph.SceneError, match=r"clamp_indirect is -1\.0; must be > 0"):
        ph.render(spheres, clamp_indirect=-1, **SIZE)
