"""Paths that pixels close by share: as bright as without, less noisy, the same to the last bit."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from floor_tools import box
from statistics_tools import SIGNIFICANCE, mean_p

SIZE = {"width": 37, "height": 27}


@cache
def room(things: bool, wall: Any = (0.7, 0.7, 0.7)) -> ph.Prepared:
    """From within a closed box with a lamp; with things of other materials in it, or not."""
    walls = ph.Material("diffuse", color=wall)
    lamp = ph.Material("emissive", radiance=(30, 30, 30))
    shapes: list[Any] = [
        box((-1, 0, -1), (1, 2, 1), walls),
        box((-0.2, 1.9, -0.2), (0.2, 1.95, 0.2), lamp),
    ]
    if things:
        red = ph.Material("diffuse", color=(0.8, 0.1, 0.001))
        gold = ph.Material("conductor", roughness=0.3)
        ball = ph.Spheres([[0, 0.3, 0]], 0.3, ph.Material("dielectric", ior=1.5))
        block = box(
            (-0.7, 0, -0.7), (-0.3, 0.9, -0.2), ph.Material("plastic", color=(0.2, 0.4, 0.8))
        )
        shapes += [
            ball,
            block,
            ph.Spheres([[0.6, 0.25, -0.5], [0.5, 1.2, -0.6]], 0.25, red),
            ph.Spheres([[-0.6, 1.4, -0.6]], 0.2, gold),
            ph.Instances(
                [ph.Spheres([[0, 0, 0]], 0.1, walls)],
                [
                    np.array([[1, 0, 0, x], [0, 2, 0, 0.2], [0, 0, 1, 0.2], [0, 0, 0, 1]])
                    for x in (-0.5, 0.5)
                ],
            ),
        ]
    camera = ph.Camera(eye=(0.1, 1.1, 0.95), target=(0, 0.9, -1), vfov=70)
    return ph.prepare(
        ph.Scene(shapes, camera=camera, background=ph.Light("constant", radiance=(0, 0, 0)))
    )


def picture(things: bool = True, **settings: Any) -> np.ndarray:
    wanted = {"spp": 4, "reuse_paths": True, "seed": 5, **SIZE, **settings}
    return ph.render(room(things), **wanted).numpy()


def test_a_room_of_one_colour_is_as_bright_as_without_to_the_last_digits() -> None:
    """All weights of a path's light add up to one, and here each weighs the same."""
    alone, shared = (picture(False, reuse_paths=reuse).astype(float) for reuse in (False, True))
    # almost all pixels have changed, but not their sum
    assert (alone != shared).mean() > 0.95
    np.testing.assert_allclose(shared.sum(), alone.sum(), rtol=2e-6)


def test_the_noise_is_less() -> None:
    truth = np.mean([picture(spp=256, seed=100 + seed).astype(float) for seed in range(2)], axis=0)
    errors = [
        np.mean([(picture(reuse_paths=reuse, seed=seed) - truth) ** 2 for seed in range(4)])
        for reuse in (False, True)
    ]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("things", [False, True])
@pytest.mark.parametrize("sampler", ["sobol", "independent"])
def test_every_part_of_the_picture_has_the_same_mean(things: bool, sampler: str) -> None:
    """Of glass, metal, plastic, instances, and what lies in the corners between."""
    means = []
    for reuse in (False, True):
        runs = [
            picture(things, sampler=sampler, reuse_paths=reuse, seed=1000 * reuse + k, spp=16)
            for k in range(40)
        ]
        blocks = np.array(runs)[:, :24, :36].reshape(40, 6, 4, 6, 6, 3).mean(axis=(2, 4))
        means.append(blocks)
    # single paths that glass focuses leave means of few pictures unlike a normal distribution
    kept = np.median(means[0].std(axis=0)) * 6 > means[0].std(axis=0)
    assert kept.mean() > 0.9
    gap = np.where(kept, means[1] - means[0], 0.0)
    assert mean_p(gap, np.zeros(gap.shape[1:])) > SIGNIFICANCE / 4


def test_threads_tiles_and_instruction_sets() -> None:
    same = picture()
    for settings in ({"threads": 1}, {"threads": 3, "tile": 5, "schedule": "static"}):
        np.testing.assert_array_equal(picture(**settings), same)
    for isa in ph._core.instruction_sets():
        np.testing.assert_array_equal(picture(isa=isa), same)
    np.testing.assert_array_equal(picture(tree="none"), same)


@pytest.mark.parametrize("crop", [(0, 0, 5, 3), (15, 14, 3, 4), (30, 20, 7, 7), (17, 3, 1, 1)])
def test_a_part_is_the_same_part(crop: tuple[int, int, int, int]) -> None:
    x, y, width, height = crop
    part = picture(crop=crop)
    np.testing.assert_array_equal(part, picture()[y : y + height, x : x + width])


def test_samples_may_differ_from_pixel_to_pixel() -> None:
    counts = np.random.default_rng(1).integers(1, 6, (SIZE["height"], SIZE["width"]))
    counted = ph.render(room(True), counts=counts, reuse_paths=True, seed=5, **SIZE).numpy()
    for spp in range(1, 6):
        np.testing.assert_array_equal(counted[counts == spp], picture(spp=spp)[counts == spp])


def test_going_on_and_shards(tmp_path: Any) -> None:
    file = tmp_path / "a.checkpoint"
    picture(spp=3, checkpoint=file)
    np.testing.assert_array_equal(picture(spp=8, checkpoint=file, resume=True), picture(spp=8))
    with pytest.raises(ph.SceneError, match="reuse_paths"):
        picture(spp=9, checkpoint=file, resume=True, reuse_paths=False)
    parts = [tmp_path / f"{k}.checkpoint" for k in (1, 2, 3)]
    for k, part in enumerate(parts):
        picture(shard=(k + 1, 3), checkpoint=part)
    np.testing.assert_array_equal(ph.merge(parts).numpy(), picture())


def test_what_the_camera_sees_is_told_as_without() -> None:
    alone, shared = (
        ph.render(room(True), spp=4, features=True, reuse_paths=reuse, **SIZE)
        for reuse in (False, True)
    )
    for name in ("albedo", "normal", "depth", "position", "direct", "emission", "shape"):
        np.testing.assert_array_equal(alone.features[name], shared.features[name])
    np.testing.assert_array_equal(
        shared.numpy(), ph.render(room(True), spp=4, reuse_paths=True, **SIZE).numpy()
    )


def test_pixels_that_are_noisier_get_more_samples() -> None:
    image = ph.render(room(True), noise=0.3, spp=256, reuse_paths=True, **SIZE)
    samples = image.features["samples"]
    assert len(np.unique(samples)) > 2
    again = ph.render(room(True), counts=samples.astype(int), reuse_paths=True, **SIZE)
    np.testing.assert_array_equal(image.numpy(), again.numpy())


def test_without_effect_where_there_are_holes_and_on_light_that_was_scattered_once() -> None:
    veil = ph.Spheres([[0, 1, 0]], 0.2, ph.Material("diffuse", opacity=0.5))
    scene = ph.prepare(room(True).scene.replace(shapes=[*room(True).scene.shapes, veil]))
    pictures = [ph.render(scene, spp=2, reuse_paths=reuse, **SIZE) for reuse in (False, True)]
    np.testing.assert_array_equal(*(p.numpy() for p in pictures))
    for settings in ({"integrator": "direct"}, {"integrator": "ao"}, {"max_depth": 2}):
        np.testing.assert_array_equal(picture(**settings), picture(reuse_paths=False, **settings))


def test_mistakes_are_told() -> None:
    with pytest.raises(ph.SceneError, match="reuse_paths is 3; must be True or False"):
        picture(reuse_paths=3)
