"""A height field as a mesh, contour lines as its texture, in the light of a panorama of numbers."""

import argparse

import numpy as np

import parhelion as ph


def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Hills: waves in random directions, the shorter the lower."""
    random = np.random.default_rng(4)
    total = np.zeros_like(x)
    for octave in range(16):
        size, angle, phase = 1.25**octave, *random.uniform(0, 2 * np.pi, 2)
        total += np.sin(size * (x * np.cos(angle) + y * np.sin(angle)) + phase) / size**1.7
    return 0.6 * total


def panorama() -> np.ndarray:
    """(256, 512, 3) radiance from all directions: a pale sky and a low sun over dark ground."""
    v, u = np.mgrid[0.5:256, 0.5:512] / [[[256]], [[512]]]
    up = np.cos(np.pi * v)[:, :, None]
    sky = np.array([0.2, 0.35, 0.75]) + 0.6 * (1 - np.abs(up)) ** 4
    distance = np.hypot(np.pi * (v - 0.39), 2 * np.pi * (u - 0.2) * np.sin(np.pi * v))
    sun = np.where(distance < 0.05, 600.0, 0.0)[:, :, None] * np.array([1, 0.8, 0.55])
    return np.where(up > 0, sky + sun, 0.05)


def main() -> None:
    """Renders and saves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default="terrain.png")
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--spp", type=int, default=64)
    args = parser.parse_args()

    side, n = np.linspace(-6, 6, 600), 600
    x, y = np.meshgrid(side, side)
    z = heights(x, y)
    vertices = np.stack([x, z, y], axis=-1).reshape(-1, 3)
    slope_y, slope_x = np.gradient(z, side, side)
    normals = np.stack([-slope_x, np.ones_like(z), -slope_y], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).reshape(-1, 1)
    faces = np.concatenate([corner + np.array(turn) for turn in ([0, n + 1, 1], [0, n, n + 1])])
    uvs = np.stack([x, y], axis=-1).reshape(-1, 2) / 12 + 0.5
    paint = np.where((z % 0.2 < 0.02)[..., None], (0.12, 0.06, 0.04), (0.45, 0.42, 0.3))
    # an image's first row is at the top, where v is 1
    ground = ph.Material("diffuse", color=ph.Texture("image", image=paint[::-1], wrap_v="clamp"))
    scene = ph.Scene(
        [ph.Mesh(vertices, faces, normals, uvs, ground)],
        camera=ph.Camera(eye=(0, 6, 10), target=(0, -0.3, 0), vfov=30),
        background=ph.Background("envmap", image=panorama()),
    )
    ph.render(scene, width=args.width, spp=args.spp, progress=True).save(args.output)


if __name__ == "__main__":
    main()
