"""Glass with known answers: bodies, absorption, priorities, dispersion and sheets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from floor_tools import (
    DARK,
    LAMP,
    WHITE,
    Floor,
    assert_lit,
    box,
    glass,
    moved,
    parts,
    picture,
    quad,
    round_surface,
    scene_runs,
    sheet,
    surface_irradiance,
    turned,
)
from statistics_tools import SIGNIFICANCE, mean_p

PANE = ph.Camera(eye=(0, 0, 4), target=(0, 0, 0), projection="orthographic", height=1.0)
ABSORPTION = np.array([0.1, 0.7, 3.0])


def fresnel(cosine: float, ior: float) -> float:
    """Reflectance of unpolarised light at the boundary to a body of that relative index."""
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    s = (cosine - ior * inside) / (cosine + ior * inside)
    p = (ior * cosine - inside) / (ior * cosine + inside)
    return float((s * s + p * p) / 2)


@pytest.mark.parametrize("priority", [0, 1])
@pytest.mark.parametrize("tilt", [0.0, 35.0])
@pytest.mark.parametrize("stretch", [1.0, 0.25])
def test_absorption_without_refraction(priority: int, tilt: float, stretch: float) -> None:
    """Beer and Lambert's law, in the scene's units where an instance is stretched."""
    clear = ph.Material("dielectric", ior=1.0, absorption=tuple(ABSORPTION), priority=priority)
    matrix = moved(turned((1, 0, 0), tilt) @ np.diag([1, 1, stretch]), (0, 0, 0))
    slab = ph.Instances([box((-9, -9, -0.5), (9, 9, 0.5), clear)], [matrix])
    scene = ph.Scene([slab], camera=PANE, background=WHITE)
    length = stretch / np.cos(np.radians(tilt))
    expected = np.broadcast_to(np.exp(-ABSORPTION * length), (3, 3, 3))
    pixels = picture(scene, width=3, height=3, spp=1, roulette=False)
    np.testing.assert_allclose(pixels, expected, rtol=2e-5)


@pytest.mark.parametrize("ior", [1.33, 2.0])
def test_a_pane_of_absorbing_glass(ior: float) -> None:
    """All orders of inner reflection, seen against a white wall behind and darkness in front."""
    glass = ph.Material("dielectric", ior=ior, absorption=tuple(ABSORPTION), priority=1)
    wall = quad((-9, -9, -2), (18, 0, 0), (0, 18, 0), ph.Material("emissive"))
    pane = box((-5, -7, -0.5), (6, 5, 0.5), glass)
    runs = np.stack(
        [
            picture(
                ph.Scene([pane, wall], camera=PANE, background=DARK),
                width=4,
                height=4,
                spp=256,
                seed=s,
            )
            for s in range(8)
        ]
    )
    r, through = fresnel(1.0, ior), np.exp(-ABSORPTION)
    expected = (1 - r) ** 2 * through / (1 - r**2 * through**2)
    assert mean_p(runs.mean(axis=(1, 2)), expected, 1e-5) > SIGNIFICANCE
    np.testing.assert_allclose(runs.mean(axis=(0, 1, 2)), expected, rtol=5e-3)


GLASS_VIEW = ph.Camera(eye=(0, 0, 4), target=(0, 0, 0), vfov=30)
STRIPES = ph.Background("gradient", horizon=(0, 0, 0), zenith=(1, 1, 1), up=(0.3, 1, 0.2))


def look_alike(a: Sequence[Any], b: Sequence[Any]) -> bool:
    """Whether shapes before a sky differ by no more than their noise."""
    runs = [
        scene_runs(
            ph.Scene(shapes, camera=GLASS_VIEW, background=STRIPES),
            first=100 * i,
            width=8,
            height=8,
            spp=128,
        )[..., 0]
        for i, shapes in enumerate((a, b))
    ]
    first, second = (r.mean(axis=(1, 2)) for r in runs)
    return (
        mean_p(runs[0] - runs[1], np.zeros((8, 8)), 0.0) > SIGNIFICANCE
        and mean_p(first - second, np.array(0.0)) > SIGNIFICANCE
        and abs(first.mean() / second.mean() - 1) < 0.01
    )


def sphere(radius: float, material: Any, **more: Any) -> ph.Spheres:
    return ph.Spheres([[0, 0, 0]], radius, material, **more)


@pytest.mark.parametrize(("inner", "outer"), [(2, 1), (1, 2), (1, 1)])
def test_glass_of_equal_index_inside_is_invisible(inner: int, outer: int) -> None:
    alone = [sphere(1, glass(outer, 1.5))]
    assert look_alike([*alone, sphere(0.5, glass(inner, 1.5))], alone)


def test_a_glass_full_of_water() -> None:
    """Its wall overlaps the water, which gives way; the same with interfaces that touch."""

    def filled(wall: int, water: int) -> list[ph.Spheres]:
        shell = glass(wall, 1.5)
        return [
            sphere(1, shell),
            sphere(0.8, shell, inside_out=True),
            sphere(0.87, glass(water, 1.33)),
        ]

    # From the wall into what it holds: the inner side of the wall faces outwards here.
    touching = [sphere(1, glass(0, 1.5)), sphere(0.8, glass(0, 1.33 / 1.5))]
    assert look_alike(filled(2, 1), touching)
    assert not look_alike(filled(1, 2), touching)
    # Where the water counts, the wall ends where the water begins.
    wider = [sphere(1, glass(0, 1.5)), sphere(0.87, glass(0, 1.33 / 1.5))]
    assert look_alike(filled(1, 2), wider)


def test_overlapping_bodies_take_light_where_they_count() -> None:
    """Slabs of no refraction: along their common part only the one of higher priority absorbs."""
    red = glass(2, 1.0, absorption=(1, 0, 0))
    green = glass(1, 1.0, absorption=(0, 1, 0))
    slabs = [box((-5, -7, -0.5), (6, 5, 0.75), red), box((-6, -5, 0.25), (5, 7, 1.5), green)]
    scene = ph.Scene(slabs, camera=PANE, background=WHITE)
    pixels = picture(scene, width=2, height=2, spp=1, roulette=False)
    expected = np.exp(-np.array([1.25, 0.75, 0]))
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, (2, 2, 3)), rtol=1e-5)


def drowned(*more: Any, absorption: float, height: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """A floor and a round lamp within a body, seen from outside or, below a height of 2, inside:
    runs, and the irradiance that must seem to be there."""
    water = glass(2, 1.0, absorption=(absorption,) * 3)
    floor, depth = Floor(size=4, extent=9.0), 2.0
    # The camera sees past the lamp: no pixel's centre lies below it.
    lamp = ph.Spheres([[0, 1, 0]], 0.25, LAMP)
    sea = box((-20, -1, -20), (20, depth, 20), water)
    runs = floor.runs(sea, lamp, *more, height=height, spp=256, max_depth=20)
    # Light reaches the floor once; all that it scatters upwards is lost.
    surface = parts(lambda u, v: round_surface((-1, 1), 0.25)(u, v) + np.array([0, 1, 0]))
    lit = 2 * surface_irradiance(floor, surface, absorption=absorption)
    return runs, lit * np.exp(-absorption * min(depth, height))


@pytest.mark.parametrize("absorption", [0.0, 0.8])
def test_light_that_is_asked_for_is_absorbed_on_its_way(absorption: float) -> None:
    runs, expected = drowned(absorption=absorption)
    assert_lit(runs, expected, rounding=1e-3)


def test_light_in_the_body_that_the_camera_is_in() -> None:
    runs, expected = drowned(absorption=0.8, height=0.5)
    assert_lit(runs, expected, rounding=1e-3)


def water(priority: int, absorption: float) -> ph.Material:
    """That refracts nothing."""
    return glass(priority, 1.0, absorption=(absorption,) * 3)


@pytest.mark.parametrize(
    ("shapes", "height", "lost"),
    [
        ([sheet(2.0, water(1, 0.7), front="up")], 0.5, 0.35),
        ([sheet(2.0, water(1, 0.7), front="up")], 1.5, 1.05),
        ([sheet(2.0, water(1, 0.7), front="up")], 3.0, 1.4),
        ([box((-9, -1, -9), (9, 2, 9), water(1, 0.7))], 1.5, 1.05),
        # within two bodies, of which the one of higher priority, else the one entered last, counts
        *(
            (
                [
                    box((-9, -1, -9), (9, 2, 9), water(outer, 0.7)),
                    box((-8, 1, -8), (8, 1.8, 8), water(inner, 0.1)),
                ],
                1.5,
                lost,
            )
            for outer, inner, lost in ((1, 2, 0.75), (1, 1, 0.75), (2, 1, 1.05))
        ),
    ],
)
def test_a_camera_knows_the_bodies_that_it_is_in(
    shapes: list[ph.Mesh], height: float, lost: float
) -> None:
    shining = ph.Material("emissive", radiance=(1, 1, 1))
    seen = Floor().render(*shapes, material=shining, height=height, spp=1, max_depth=9)
    np.testing.assert_allclose(seen, np.exp(-lost), rtol=1e-5)


def test_a_body_that_gives_way_takes_no_light() -> None:
    """It lies between the floor and the lamp, within another of higher priority."""
    bubble = ph.Spheres([[0, 1, 0]], 0.3, glass(1, 1.7, absorption=(5, 5, 5)))
    runs, expected = drowned(bubble, absorption=0.3)
    assert_lit(runs, expected, rounding=1e-3)
