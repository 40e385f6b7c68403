"""Renders docs/images/sun.jpg: a landscape by how long the sun reaches each place of it."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import parhelion as ph
from parhelion.particles.colors import mapped

IMAGES = Path(__file__).parent / "images"
SIDE, SIZE = 400, 10.0  # points along a side, and its length in km
LATITUDE, LOOKS = np.radians(46.0), 72  # at an equinox, and how often a day it is looked


def landscape() -> tuple[np.ndarray, np.ndarray]:
    """Points (SIDE, SIDE, 3) in km, y up, z to the south; and triangles."""
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, SIDE), np.linspace(-0.5, 0.5, SIDE))
    rng, y = np.random.default_rng(8), np.zeros_like(x)
    for octave in range(6):
        for _ in range(6):
            way, phase = rng.normal(size=2), rng.uniform(0, 2 * np.pi)
            wave = np.sin(2.0**octave * 3.0 * (way[0] * x + way[1] * z) + phase)
            y += 0.45**octave * (1 - np.abs(wave)) ** 2  # with ridges
    points = np.stack([x * SIZE, 0.45 * y, z * SIZE], axis=-1)
    i = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    faces = np.concatenate(
        [np.stack([i, i + SIDE, i + 1], 1), np.stack([i + 1, i + SIDE, i + SIDE + 1], 1)]
    )
    return points, faces


def sunshine(land: ph.Mesh, points: np.ndarray) -> np.ndarray:
    """(n,), hours of a day in which the sun reaches points of a surface, seen from above."""
    scene = ph.prepare(ph.Scene([land]))
    ground = ph.intersect(scene, points + np.array([0, 10, 0]), (0, -1, 0))
    hours = np.zeros(len(points))
    for angle in (np.arange(LOOKS) + 0.5) * (np.pi / LOOKS):  # from sunrise in the east
        sun = (np.cos(angle), np.sin(angle) * np.cos(LATITUDE), np.sin(angle) * np.sin(LATITUDE))
        hours += ~ph.occluded(scene, ground, sun) * (12 / LOOKS)
    return hours


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("-o", "--output", type=Path, default=IMAGES / "sun.jpg")
    options = parser.parse_args()
    points, faces = landscape()
    vertices = points.reshape(-1, 3)
    hours = sunshine(ph.Mesh(vertices, faces), vertices[faces].mean(axis=1))
    shown = ph.ColorBar("sunshine a day at an equinox, hours", "inferno", 0, 12)
    colors = mapped(hours, shown.colormap, shown.low, shown.high)  # of each triangle
    scene = ph.Scene(
        [ph.Mesh(vertices, faces, colors=colors)],
        camera=ph.Camera(eye=(0, 6.5, -9.5), target=(0, 0.9, -0.6), vfov=36),
        background=ph.Background("constant", radiance=(1, 1, 1)),
        legend=shown,
    )
    image = ph.render(scene, width=860, height=480, spp=options.spp)
    image.save(options.output, legend=True)
    print(f"{hours.min():.1f} to {hours.max():.1f} hours")


if __name__ == "__main__":
    main()
