"""Renders docs/images/lights.jpg: three spheres in the light of every kind."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from materials import HEIGHT, IMAGES, WIDTH, letters, sheet

import parhelion as ph
from parhelion import tables

CAMERA = ph.Camera(eye=(0, 2.2, 7), target=(0, 0.75, 0), vfov=31)

Lit = tuple[str, str, ph.Light | None, Sequence[ph.Light | ph.Spheres]]


def panorama() -> np.ndarray:
    """(64, 128, 3) radiance from all directions: a dim room with two windows, one warm."""
    y, x = np.mgrid[0.5:64, 0.5:128]
    room = np.full((64, 128, 3), 0.08)
    room[(abs(y - 22) < 8) & (abs(x - 50) < 6)] = (2, 4, 8)
    room[(abs(y - 20) < 8) & (abs(x - 10) < 5)] = (14, 7, 3)
    return room


def lights() -> list[Lit]:
    """What the sheet shows: title, how, the background, and further lights or lamps."""
    light, background = ph.Light, ph.Background
    sun = {"sun_direction": (-1, 0.7, 0.8), "scale": (0.08,) * 3}
    slide = {
        "image": letters(),
        "scale": (20,) * 3,
        "fov": 34,
        "transform": turned(eye=(0, 3, 5), target=(0, 0.6, 0)),
    }
    aim = {"position": (-2, 4, 3), "direction": (2.2, -3.6, -3)}
    lamp = ph.Spheres([[-1.6, 2.6, 1.5]], 0.35, ph.Material("emissive", radiance=(35, 28, 20)))
    return [
        ("constant", "", background("constant", radiance=(0.8,) * 3), ()),
        ("gradient", "", background("gradient"), ()),
        ("envmap", "a room with two windows", background("envmap", image=panorama()), ()),
        ("sky", "without the sun", background("sky", **sun), ()),
        ("sky and sun", "", background("sky", **sun), [light("sun", **sun)]),
        (
            "directional",
            "",
            None,
            [light("directional", irradiance=(3,) * 3, direction=(1, -1, -1))],
        ),
        (
            "directional",
            "angle 15",
            None,
            [light("directional", irradiance=(3,) * 3, direction=(1, -1, -1), angle=15)],
        ),
        ("point", "", None, [light("point", intensity=(50, 40, 30), position=(-2, 4, 3))]),
        (
            "spot",
            "cutoff_angle 15",
            None,
            [light("spot", intensity=(90,) * 3, cutoff_angle=15, **aim)],
        ),
        ("projector", "", None, [light("projector", **slide)]),
        ("emissive", "a sphere of radius 0.35", None, [lamp]),
        (
            "emissive",
            "60 small spheres",
            None,
            [
                ph.Spheres(
                    np.random.default_rng(2).uniform((-2.5, 0.1, -1), (2.5, 2, 2), (60, 3)),
                    0.04,
                    ph.Material("emissive"),
                    colors=25 * np.random.default_rng(3).dirichlet((0.6,) * 3, 60),
                )
            ],
        ),
    ]


def turned(eye: Sequence[float], target: Sequence[float]) -> np.ndarray:
    """(4, 4) matrix that puts a light at `eye`, its +z towards `target` and its +y upwards."""
    z = np.subtract(target, eye)
    x = np.cross((0, 1, 0), z)
    frame = np.stack([x, np.cross(z, x), z], axis=1)
    matrix = np.eye(4)
    matrix[:3, :3] = frame / np.linalg.norm(frame, axis=0)
    matrix[:3, 3] = eye
    return matrix


def render(lit: Lit, spp: int) -> np.ndarray:
    """One tile as 8-bit sRGB."""
    _, _, background, others = lit
    grey = ph.Material("diffuse", color=(0.5, 0.5, 0.5))
    scene = ph.Scene(
        [
            ph.Disks([[0, 0, 0]], [[0, 0, 30]], [[30, 0, 0]], grey),
            ph.Spheres([[0, 0.7, 0]], 0.7, grey),
            ph.Spheres([[-1.5, 0.7, 0]], 0.7, ph.Material("conductor", roughness=0.3)),
            ph.Spheres([[1.5, 0.7, 0]], 0.7, ph.Material("dielectric")),
            *(x for x in others if isinstance(x, ph.Spheres)),
        ],
        camera=CAMERA,
        background=background,
        lights=[x for x in others if isinstance(x, ph.Light)],
    )
    return ph.render(scene, width=WIDTH, height=HEIGHT, spp=spp).srgb()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel")
    parser.add_argument("-o", "--output", type=Path, default=IMAGES / "lights.jpg")
    options = parser.parse_args()
    shown = lights()
    kinds = {x.type for _, _, a, b in shown for x in (a, *b) if isinstance(x, ph.Light)}
    if missing := tables.tables()["lights"].keys() - kinds:
        sys.exit(f"no tile shows {', '.join(sorted(missing))}")
    pictures = [render(lit, options.spp) for lit in shown]
    figure = sheet(pictures, [lit[:2] for lit in shown], columns=4)
    figure.savefig(options.output, pil_kwargs={"quality": 88, "optimize": True})


if __name__ == "__main__":
    main()
