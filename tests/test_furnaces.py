"""Scenes that give back all light, under an even sky."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import parhelion as ph
from floor_tools import FURNACES, box, scene_runs
from parhelion.tables import tables
from statistics_tools import mean_p, sidak

# What every material is that gives back all light; `emissive` scatters none.
WHITENESS: dict[str, dict[str, Any]] = {
    "diffuse": {"color": (1, 1, 1)},
    "metal": {"color": (1, 1, 1), "fuzz": 0.4},
    "dielectric": {"roughness": 0.0},
    "conductor": {"roughness": 0.4},
    "thin_dielectric": {},
    "plastic": {"color": (1, 1, 1)},
    "principled": {"color": (1, 1, 1), "specular": 0.0},
    "null": {},
    "diffuse_transmission": {"color": (0.3, 0.3, 0.3), "transmittance": (0.7, 0.7, 0.7)},
}


def test_the_furnaces_know_every_material() -> None:
    assert WHITENESS.keys() == tables()["materials"].keys() - {"emissive"}


@pytest.mark.parametrize("sky", FURNACES)
@pytest.mark.parametrize("name", WHITENESS)
def test_a_white_scene_in_a_white_sky_is_white(name: str, sky: str) -> None:
    """Spheres and a mesh that reflect one another, and one way or another all of the sky."""
    material = ph.Material(name, **WHITENESS[name])
    shapes = [
        ph.Spheres([[-0.5, 0, 0], [0.5, 0, 0], [0, 0.8, 0.2]], 0.45, material),
        box((-1, -0.8, -0.6), (1, -0.5, 0.6), material),
    ]
    camera = ph.Camera(eye=(0, 1, 4), target=(0, 0, 0), vfov=30)
    runs = scene_runs(
        ph.Scene(shapes, camera=camera, background=FURNACES[sky]),
        width=12,
        height=12,
        spp=64,
        max_depth=300,
    )[..., 0]
    assert mean_p(runs.mean(axis=(1, 2)), np.array(1.0), 1e-4) > sidak(2 * len(WHITENESS))
    np.testing.assert_allclose(runs.mean(), 1, atol=5e-3)
