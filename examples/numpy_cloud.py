"""Renders a cloud of spheres that is nothing but two NumPy arrays: a spiral galaxy of 50,000."""

import argparse

import numpy as np

import parhelion as ph


def galaxy(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Centers, (count, 3), and radii, (count,), of spheres along two spiral arms."""
    random = np.random.default_rng(1)
    distance = random.exponential(2.0, count)
    turn = 1.2 * np.log1p(distance) * np.pi + np.pi * random.integers(0, 2, count)
    x, y = distance * np.cos(turn), distance * np.sin(turn)
    z = random.normal(0.0, 0.15, count)
    spread = random.normal(0.0, 0.25, (count, 2))
    centers = np.stack([x + spread[:, 0], z, y + spread[:, 1]], axis=1)
    return centers, random.uniform(0.01, 0.04, count)


def main() -> None:
    """Renders and saves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default="numpy_cloud.png")
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--spp", type=int, default=64)
    args = parser.parse_args()

    centers, radii = galaxy(50_000)
    scene = ph.Scene(
        [ph.Spheres(centers, radii, ph.Material("diffuse", color=(0.9, 0.7, 0.45)))],
        camera=ph.Camera(eye=(0, 11, 15), vfov=40),
        background=ph.Background("gradient", horizon=(0.02, 0.02, 0.05), zenith=(1.5, 1.5, 1.7)),
    )
    image = ph.render(scene, width=args.width, spp=args.spp, progress=True)
    image.save(args.output)


if __name__ == "__main__":
    main()
