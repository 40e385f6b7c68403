"""Renders docs/images/materials.jpg: every material on Mitsuba's preview object.

    python docs/materials.py .../scenes/matpreview/matpreview.xml

The scene is `matpreview` of mitsuba-renderer/mitsuba-data; it is not part of this repository.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

import parhelion as ph
from parhelion import spectra, tables

IMAGES = Path(__file__).parent / "images"
WIDTH, HEIGHT, LABEL = 192, 144, 36  # of a tile, in pixels, and of the text below it

EXPOSURE = 1.8  # factor on the panorama; the scene's own, 3, washes colours out

RED, TEAL, CREAM = (0.75, 0.07, 0.05), (0.03, 0.35, 0.4), (0.85, 0.75, 0.55)

Tile = tuple[str, str, ph.Material]  # what it shows, how, and the material


def metal(symbol: str, **params: Any) -> ph.Material:
    """A conductor with the measured index of refraction of a metal."""
    eta, k = spectra.metal(symbol)
    return ph.Material("conductor", eta=eta, k=k, **params)


def tiled(texture: str, times: float, **params: Any) -> ph.Texture:
    """A texture that is repeated."""
    return ph.Texture(texture, transform=[[times, 0, 0], [0, times, 0]], **params)


def dimples() -> np.ndarray:
    """Normals of a plate with a round hollow, in colours."""
    y, x = np.mgrid[1:-1:128j, -1:1:128j] * 1.25
    inside = np.hypot(x, y) < 1
    slope = np.where(inside, 0.9, 0.0)
    normal = np.stack([-x * slope, -y * slope, np.sqrt(1 - slope**2 * (x**2 + y**2) * inside)], -1)
    return (0.5 * normal + 0.5).astype(np.float32)


def letters() -> np.ndarray:
    """A picture that tells left from right and up from down: a lower-case h on bands of colour."""
    y, x = np.mgrid[1:0:64j, 0:1:64j]
    color = np.stack([0.35 + 0.6 * x, 0.55 * np.ones_like(x), 0.3 + 0.6 * y], -1)
    stem = (abs(x - 0.32) < 0.07) & (abs(y - 0.5) < 0.35)
    ring = np.hypot(x - 0.5, y - 0.4)
    arch = (abs(ring - 0.18) < 0.07) & (y > 0.4) | (abs(x - 0.68) < 0.07) & (y > 0.15) & (y < 0.4)
    color[stem | arch] = 0.05
    return np.round(255 * color).astype(np.uint8)


def tiles() -> list[Tile]:
    """All that the sheet shows, in its order."""
    material = ph.Material
    gold, silver = spectra.metal("Au"), spectra.metal("Ag")
    return [
        ("diffuse", "", material("diffuse", color=CREAM)),
        ("diffuse", "roughness 1", material("diffuse", color=CREAM, roughness=1)),
        ("metal", "fuzz 0", material("metal", color=(0.9, 0.6, 0.3))),
        ("metal", "fuzz 0.3", material("metal", color=(0.9, 0.6, 0.3), fuzz=0.3)),
        ("metal", "fuzz 1", material("metal", color=(0.9, 0.6, 0.3), fuzz=1)),
        ("emissive", "radiance 2, 1, 0.3", material("emissive", radiance=(2, 1, 0.3))),
        ("null", "", material("null")),
        ("null", "color 0.9, 0.5, 0.5", material("null", color=(0.9, 0.5, 0.5))),
        ("dielectric", "ior 1.5", material("dielectric")),
        ("dielectric", "ior 2.4", material("dielectric", ior=2.4)),
        ("dielectric", "roughness 0.3", material("dielectric", roughness=0.3)),
        ("dielectric", "roughness 0.6", material("dielectric", roughness=0.6)),
        (
            "dielectric",
            "roughness 0.35, anisotropy 0.8",
            material("dielectric", roughness=0.35, anisotropy=0.8),
        ),
        (
            "dielectric",
            "absorption 9, 2, 4",
            material("dielectric", priority=1, absorption=(9, 2, 4)),
        ),
        ("thin_dielectric", "ior 1.5", material("thin_dielectric")),
        (
            "thin_dielectric",
            "transmittance 0.3, 0.7, 0.9",
            material("thin_dielectric", transmittance=(0.3, 0.7, 0.9)),
        ),
        ("thin_dielectric", "roughness 0.3", material("thin_dielectric", roughness=0.3)),
        ("dielectric", "dispersion 2", material("dielectric", ior=1.8, dispersion=2)),
        (
            "diffuse_transmission",
            "",
            material("diffuse_transmission", color=(0.1, 0.3, 0.05), transmittance=(0.2, 0.6, 0.1)),
        ),
        *(("conductor", name, metal(name)) for name in ("Ag", "Al", "Au", "Cu", "Cr")),
        ("conductor", "Au, roughness 0.3", metal("Au", roughness=0.3)),
        ("conductor", "Au, roughness 0.6", metal("Au", roughness=0.6)),
        ("conductor", "Au, roughness 1", metal("Au", roughness=1)),
        (
            "conductor",
            "Au, rough. 1, compensation off",
            metal("Au", roughness=1, compensation="off"),
        ),
        (
            "conductor",
            "Cu, anisotropy 0.8",
            metal("Cu", roughness=0.35, anisotropy=0.8),
        ),
        (
            "conductor",
            "Cu, anisotropy -0.8",
            metal("Cu", roughness=0.35, anisotropy=-0.8),
        ),
        ("conductor", "Al, roughness 0.5, ggx", metal("Al", roughness=0.5)),
        (
            "conductor",
            "Al, roughness 0.5, beckmann",
            metal("Al", roughness=0.5, distribution="beckmann"),
        ),
        ("plastic", "", material("plastic", color=TEAL)),
        ("plastic", "nonlinear", material("plastic", color=TEAL, nonlinear="on")),
        ("plastic", "roughness 0.3", material("plastic", color=TEAL, roughness=0.3)),
        ("plastic", "roughness 0.6", material("plastic", color=TEAL, roughness=0.6)),
        ("plastic", "ior 2.2", material("plastic", color=TEAL, ior=2.2)),
        ("principled", "roughness 0.5", material("principled", color=RED)),
        ("principled", "roughness 0.15", material("principled", color=RED, roughness=0.15)),
        ("principled", "specular 0", material("principled", color=RED, specular=0)),
        ("principled", "metallic 1", material("principled", color=RED, metallic=1, roughness=0.3)),
        (
            "principled",
            "metal, anisotropy 0.8",
            material("principled", color=CREAM, metallic=1, roughness=0.35, anisotropy=0.8),
        ),
        (
            "principled",
            "metal, anisotropy_rotation 90",
            material(
                "principled",
                color=CREAM,
                metallic=1,
                roughness=0.35,
                anisotropy=0.8,
                anisotropy_rotation=90,
            ),
        ),
        (
            "principled",
            "clearcoat 1",
            material("principled", color=RED, metallic=0.6, roughness=0.6, clearcoat=1),
        ),
        (
            "principled",
            "clearcoat_roughness 0.3",
            material(
                "principled",
                color=RED,
                metallic=0.6,
                roughness=0.6,
                clearcoat=1,
                clearcoat_roughness=0.3,
            ),
        ),
        (
            "principled",
            "sheen, roughness 0.5",
            material("principled", color=(0.1, 0.02, 0.15), roughness=1, sheen_color=(1, 0.8, 1)),
        ),
        (
            "principled",
            "sheen, roughness 1",
            material(
                "principled",
                color=(0.1, 0.02, 0.15),
                roughness=1,
                sheen_color=(1, 0.8, 1),
                sheen_roughness=1,
            ),
        ),
        (
            "principled",
            "transmission, roughness 0.4",
            material("principled", color=(1, 1, 1), transmission=1, roughness=0.4),
        ),
        (
            "principled",
            "transmission, absorption",
            material(
                "principled",
                color=(1, 1, 1),
                transmission=1,
                roughness=0.1,
                priority=1,
                absorption=(2, 5, 9),
            ),
        ),
        (
            "principled",
            "iridescence 1, 400 nm",
            material("principled", color=(0.02, 0.02, 0.02), roughness=0.15, ior=2, iridescence=1),
        ),
        (
            "principled",
            "iridescence, metal, 600 nm",
            material(
                "principled",
                color=(0.7, 0.7, 0.75),
                metallic=1,
                roughness=0.2,
                iridescence=1,
                iridescence_ior=1.8,
                iridescence_thickness=600,
            ),
        ),
        (
            "blend",
            "gold and matte, by checker",
            material(
                "blend",
                a=metal("Au", roughness=0.2),
                b=material("diffuse", color=TEAL),
                weight=tiled("checker", 5, color0=(0, 0, 0), color1=(1, 1, 1)),
            ),
        ),
        (
            "opacity",
            "checker",
            material(
                "diffuse",
                color=CREAM,
                opacity=tiled("checker", 12, color0=(1, 1, 1), color1=(0, 0, 0)),
            ),
        ),
        (
            "normal_map",
            "hollows, on plastic",
            material(
                "plastic",
                color=TEAL,
                normal_map=tiled("image", 16, image=dimples(), color_space="linear"),
            ),
        ),
        (
            "bump_map",
            "noise, on a conductor",
            material(
                "conductor",
                eta=silver[0],
                k=silver[1],
                roughness=0.3,
                bump_map=ph.Texture("noise", size=0.15, color1=(0.06, 0.06, 0.06)),
            ),
        ),
        (
            "emission",
            "ramp, on plastic",
            material(
                "plastic",
                color=(0.1, 0.1, 0.1),
                emission=ph.Texture("ramp", color0=(0, 0, 0), color1=(2, 0.6, 0.1)),
            ),
        ),
        (
            "texture checker",
            "of roughness, on gold",
            material(
                "conductor",
                eta=gold[0],
                k=gold[1],
                roughness=tiled("checker", 8, color0=(0.1,) * 3, color1=(0.7,) * 3),
            ),
        ),
        (
            "texture noise",
            "turbulence, on plastic",
            material(
                "plastic",
                color=ph.Texture(
                    "noise",
                    size=0.5,
                    octaves=7,
                    shape="turbulence",
                    color0=(0.01, 0.03, 0.05),
                    color1=(0.95, 0.9, 0.8),
                ),
            ),
        ),
        (
            "texture image",
            "repeated 10 by 10",
            material("diffuse", color=tiled("image", 10, image=letters())),
        ),
    ]


def render(scene: ph.Scene, tile: Tile, spp: int) -> np.ndarray:
    """One tile as 8-bit sRGB; light behind glass takes more samples to find."""
    material = tile[2]
    glass = material.type in ("dielectric", "thin_dielectric", "null")
    if glass or "transmission" in material.params:
        spp *= 3
    shown = scene.replace(materials={**scene.materials, "bsdf-matpreview": material})
    return ph.render(shown, width=WIDTH, height=HEIGHT, spp=spp).srgb()


def sheet(pictures: Sequence[np.ndarray], labels: Iterable[tuple[str, str]], columns: int) -> Any:
    """A figure of pictures in rows, pixel by pixel, each with two lines of text below it."""
    matplotlib.use("agg")
    from matplotlib import pyplot

    rows = -(-len(pictures) // columns)
    gap = 8
    across, down = columns * (WIDTH + gap) + gap, rows * (HEIGHT + LABEL + gap) + gap
    figure = pyplot.figure(figsize=(across / 100, down / 100), dpi=100, facecolor="white")
    for i, (picture, (title, text)) in enumerate(zip(pictures, labels, strict=True)):
        x = gap + i % columns * (WIDTH + gap)
        y = gap + i // columns * (HEIGHT + LABEL + gap)
        figure.figimage(picture, x, down - y - HEIGHT)
        for line, (words, weight) in enumerate(((title, "bold"), (text, "normal"))):
            below = y + HEIGHT + 3 + 16 * line
            place = {"x": x / across, "y": 1 - below / down}
            figure.text(**place, s=words, va="top", fontsize=8, fontweight=weight)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scene", type=Path, help="matpreview.xml of mitsuba-data")
    parser.add_argument("--spp", type=int, default=40, help="samples per pixel")
    parser.add_argument("-o", "--output", type=Path, default=IMAGES / "materials.jpg")
    options = parser.parse_args()
    shown = tiles()
    if missing := tables.tables()["materials"].keys() - {m.type for _, _, m in shown}:
        sys.exit(f"no tile shows {', '.join(sorted(missing))}")
    scene = ph.load(options.scene)
    assert scene.background is not None
    light = {**scene.background.params, "scale": (EXPOSURE,) * 3}
    scene = scene.replace(background=ph.Background("envmap", **light))
    pictures = [render(scene, tile, options.spp) for tile in shown]
    figure = sheet(pictures, [tile[:2] for tile in shown], columns=8)
    figure.savefig(options.output, pil_kwargs={"quality": 85, "optimize": True})


if __name__ == "__main__":
    main()
