"""The built-in scene: a ground, some 480 small spheres at random, three large ones, a sky.

In the manner of the cover of P. Shirley's "Ray Tracing in One Weekend" (CC0), drawn from random
numbers of our own, so that it is the same on every machine and for every version of NumPy.
"""

from __future__ import annotations

import numpy as np

from . import arguments
from .scene import Background, Camera, Material, Scene, Settings, Source, Spheres


def _uniform(count: int, columns: int, seed: int) -> np.ndarray:
    """(count, columns) numbers in [0, 1): a counter through a 64-bit mixer (SplitMix64)."""
    with np.errstate(over="ignore"):
        x = np.arange(1, count * columns + 1, dtype=np.uint64) + np.uint64(seed << 32)
        x *= np.uint64(0x9E3779B97F4A7C15)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        x ^= x >> np.uint64(31)
    numbers: np.ndarray = (x >> np.uint64(11)).astype(np.float64) * 2.0**-53
    return numbers.reshape(count, columns)


def weekend(seed: int = 1) -> Scene:
    """The scene that `parhelion render` shows when given none.

    seed: of its places and colours. Raises SceneError for one that is no whole number in 32 bits.
    """
    seed = arguments.whole("seed", seed, 0, 2**32 - 1)
    a, b = (g.ravel() for g in np.meshgrid(np.arange(-11, 11), np.arange(-11, 11), indexing="ij"))
    u = _uniform(a.size, 9, seed)
    centers = np.stack([a + 0.9 * u[:, 0], np.full(a.size, 0.2), b + 0.9 * u[:, 1]], axis=1)
    # a place is left around each of the three large ones
    large = np.array([[0.0, 1.0, 0.0], [-4.0, 1.0, 0.0], [4.0, 1.0, 0.0]])
    free = np.all(np.linalg.norm(centers[:, None] - large, axis=2) > 1.2, axis=1)
    kind = np.digitize(u[:, 2], [0.8, 0.95])  # matte, metal, glass
    matte, metal, glass = (np.flatnonzero(free & (kind == k)) for k in range(3))

    materials = {
        "ground": Material("diffuse", color=(0.5, 0.5, 0.5)),
        "matte": Material("diffuse"),
        "glass": Material("dielectric", ior=1.5),
        "brown": Material("diffuse", color=(0.4, 0.2, 0.1)),
        "mirror": Material("metal", color=(0.7, 0.6, 0.5)),
    }
    first_metal = len(materials)
    for i in metal:
        color = tuple(float(x) for x in 0.5 + 0.5 * u[i, 3:6])
        materials[f"metal {i}"] = Material("metal", color=color, fuzz=float(0.5 * u[i, 6]))
    shapes = (
        Spheres([[0.0, -1000.0, 0.0]], 1000.0, "ground", name="ground"),
        Spheres(centers[matte], 0.2, "matte", u[matte, 3:6] * u[matte, 6:9], name="matte"),
        Spheres(centers[metal], 0.2, first_metal + np.arange(metal.size), name="metal"),
        Spheres(centers[glass], 0.2, "glass", name="glass"),
        Spheres(large[0:1], 1.0, "glass", name="large glass"),
        Spheres(large[1:2], 1.0, "brown", name="large matte"),
        Spheres(large[2:3], 1.0, "mirror", name="large mirror"),
    )
    camera = Camera(
        eye=(13.0, 2.0, 3.0),
        target=(0.0, 0.0, 0.0),
        vfov=20.0,
        aperture_radius=0.0523604,  # a cone of 0.6 degrees at the plane in focus
        focus_distance=10.0,
    )
    sky = Background("gradient", horizon=(1.0, 1.0, 1.0), zenith=(0.5, 0.7, 1.0))
    return Scene(
        shapes,
        materials,
        camera,
        sky,
        Settings(),
        name="weekend",
        source=Source(None, {"seed": seed}),
    )
