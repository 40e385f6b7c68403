"""Colours particles by a field of theirs: a standing wave on a lattice, in Matplotlib's colours."""

import argparse

import matplotlib
import numpy as np

import parhelion as ph


def linear(srgb: np.ndarray) -> np.ndarray:
    """Colours for a screen, sRGB, as shares of reflected light, which are linear."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def main() -> None:
    """Renders and saves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default="color_by_field.png")
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--colormap", default="coolwarm")
    args = parser.parse_args()

    side = np.arange(24.0)
    x, y, z = (c.ravel() for c in np.meshgrid(side, side, side, indexing="ij"))
    field = np.cos(4 * np.pi * x / 23) * np.cos(2 * np.pi * y / 23) * np.cos(3 * np.pi * z / 23)

    share = (field - field.min()) / np.ptp(field)
    colors = linear(matplotlib.colormaps[args.colormap](share)[:, :3])
    scene = ph.Scene(
        [ph.Spheres(np.stack([x, y, z], axis=1), 0.48, colors=colors)],
        camera=ph.Camera(eye=(55, 45, 60), target=(11.5, 11.0, 11.5), vfov=28),
        background=ph.Background("gradient", horizon=(0.3, 0.3, 0.3), zenith=(1.6, 1.6, 1.6)),
    )
    ph.render(scene, width=args.width, spp=args.spp, progress=True).save(args.output)


if __name__ == "__main__":
    main()
