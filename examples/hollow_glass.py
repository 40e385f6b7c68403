"""A hollow glass sphere between a matte and a metal one: a bubble of air within a ball of glass."""

import argparse

import parhelion as ph


def main() -> None:
    """Renders and saves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", default="hollow_glass.png")
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--spp", type=int, default=256)
    args = parser.parse_args()

    glass = ph.Material("dielectric", ior=1.5)
    # ior is inside over outside: from the bubble's air to the glass around it
    bubble = ph.Material("dielectric", ior=1 / 1.5)
    scene = ph.Scene(
        [
            ph.Spheres([[0, -1000, 0]], 1000, ph.Material("diffuse", color=(0.5, 0.6, 0.4))),
            ph.Spheres([[0, 1, 0]], 1.0, glass),
            ph.Spheres([[0, 1, 0]], 0.9, bubble),
            ph.Spheres([[-2.2, 1, -0.6]], 1.0, ph.Material("diffuse", color=(0.7, 0.2, 0.15))),
            ph.Spheres([[2.2, 1, -0.6]], 1.0, ph.Material("metal", color=(0.9, 0.7, 0.4))),
        ],
        camera=ph.Camera(eye=(0, 2, 8), target=(0, 1, 0), vfov=30),
        background=ph.Background("gradient", horizon=(1, 1, 1), zenith=(0.3, 0.5, 1)),
    )
    ph.render(scene, width=args.width, spp=args.spp, progress=True).save(args.output)


if __name__ == "__main__":
    main()
