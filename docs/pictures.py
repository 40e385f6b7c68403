"""Renders docs/images/pictures.jpg: one scene in every view transform, balanced, and denoised."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from materials import HEIGHT, IMAGES, WIDTH, sheet

import parhelion as ph
from parhelion.display import VIEW_TRANSFORMS

EXPOSURE = 1.5  # stops, so that much is brighter than white


def scene() -> ph.Scene:
    """Coloured spheres in a row below a warm lamp and a dim blue sky."""
    hues = [(0.8, 0.02, 0.02), (0.85, 0.45, 0.02), (0.05, 0.6, 0.05), (0.02, 0.05, 0.8)]
    floor = ph.Material("diffuse", color=(0.5, 0.5, 0.5))
    lamp = ph.Material("emissive", radiance=(90, 60, 34))
    balls = [
        ph.Spheres([[1.1 * k - 1.65, 0.5, 0]], 0.5, ph.Material("plastic", color=hue))
        for k, hue in enumerate(hues)
    ]
    white = ph.Material("diffuse", color=(0.8, 0.8, 0.8))
    return ph.Scene(
        [
            ph.Disks([[0, 0, 0]], [[0, 0, 30]], [[30, 0, 0]], floor),
            ph.Spheres([[-3, 3.2, 2]], 0.5, lamp),
            *balls,
            ph.Spheres([[0, 0.9, -1.6]], 0.9, white),
        ],
        camera=ph.Camera(eye=(0, 1.8, 6.5), target=(0, 0.6, 0), vfov=33),
        background=ph.Background("constant", radiance=(0.1, 0.14, 0.25)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--spp", type=int, default=400, help="samples per pixel of what is clean")
    parser.add_argument("-o", "--output", type=Path, default=IMAGES / "pictures.jpg")
    options = parser.parse_args()
    prepared = ph.prepare(scene())
    size = {"width": WIDTH, "height": HEIGHT}
    clean = ph.render(prepared, spp=options.spp, **size)
    noisy = ph.render(prepared, spp=8, features=True, **size)
    tiles: list[tuple[str, str, np.ndarray]] = []
    for name in VIEW_TRANSFORMS:
        how = f"--view-transform {name}"
        tiles.append((name, how, clean.srgb(exposure=EXPOSURE, view_transform=name)))
    for white in (3500, 9000):
        shown = clean.srgb(exposure=EXPOSURE, view_transform="agx", white_balance=white)
        tiles.append((f"agx, {white} K", f"--white-balance {white}", shown))
    for title, how, image in (
        ("8 samples", "--spp 8", noisy),
        ("8 samples, denoised", "--spp 8 --denoise", noisy.denoised()),
    ):
        tiles.append((title, how, image.srgb(exposure=EXPOSURE, view_transform="agx")))
    if len(tiles) != 8:
        sys.exit("the sheet has room for eight pictures")
    figure = sheet([t[2] for t in tiles], [t[:2] for t in tiles], columns=4)
    figure.savefig(options.output, pil_kwargs={"quality": 88, "optimize": True})


if __name__ == "__main__":
    main()
