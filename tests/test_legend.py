"""Legends, and whether their colours are those of what they stand for."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import cli
from parhelion.legend import bar_columns, bar_rows, bar_values, panel
from parhelion.particles import Labels, Particles, to_scene
from picture_tools import read_picture

# --- Differences of colours ----------------------------------------------------------------------


def lab(srgb: np.ndarray) -> np.ndarray:
    """CIELAB of 8-bit sRGB (IEC 61966-2-1), for the white of D65."""
    v = np.asarray(srgb, float) / 255
    linear = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    matrix = [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
    xyz = linear @ np.transpose(matrix) / np.sum(matrix, axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def delta_e(first: Any, second: Any) -> np.ndarray:
    """CIEDE2000 of CIELAB colours, equations 2 to 22 of G. Sharma, W. Wu and E. N. Dalal, "The
    CIEDE2000 color-difference formula", Color Research and Application 30 (2005).
    """
    l1, a1, b1 = np.moveaxis(np.asarray(first, float), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(second, float), -1, 0)
    mean_c = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(mean_c**7 / (mean_c**7 + 25.0**7)))
    c1, c2 = np.hypot((1 + g) * a1, b1), np.hypot((1 + g) * a2, b2)
    h1 = np.degrees(np.arctan2(b1, (1 + g) * a1)) % 360
    h2 = np.degrees(np.arctan2(b2, (1 + g) * a2)) % 360
    grey = c1 * c2 == 0
    dh = np.where(grey, 0.0, (h2 - h1 + 180) % 360 - 180)
    dh = np.where(~grey & (h2 - h1 == 180), 180.0, dh)
    dl, dc = l2 - l1, c2 - c1
    dhh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(dh / 2))
    ml, mc = (l1 + l2) / 2, (c1 + c2) / 2
    total = h1 + h2
    near = np.abs(h1 - h2) <= 180
    mh = np.where(near, total / 2, np.where(total < 360, (total + 360) / 2, (total - 360) / 2))
    mh = np.where(grey, total, mh)
    t = (
        1
        - 0.17 * np.cos(np.radians(mh - 30))
        + 0.24 * np.cos(np.radians(2 * mh))
        + 0.32 * np.cos(np.radians(3 * mh + 6))
        - 0.20 * np.cos(np.radians(4 * mh - 63))
    )
    theta = 30 * np.exp(-(((mh - 275) / 25) ** 2))
    rc = 2 * np.sqrt(mc**7 / (mc**7 + 25.0**7))
    sl = 1 + 0.015 * (ml - 50) ** 2 / np.sqrt(20 + (ml - 50) ** 2)
    sc, sh = 1 + 0.045 * mc, 1 + 0.015 * mc * t
    rt = -np.sin(np.radians(2 * theta)) * rc
    u, v, w = dl / sl, dc / sc, dhh / sh
    return np.sqrt(u**2 + v**2 + w**2 + rt * v * w)


@pytest.mark.parametrize(
    ("first", "second", "difference"),
    [  # of the paper's table 1
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 3.1571, -77.2803), (50, 0, -82.7485), 2.8615),
        ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0000),
        ((50, 0, 0), (50, -1, 2), 2.3669),
        ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
        ((50, 2.49, -0.001), (50, -2.49, 0.0011), 7.2195),
        ((50, -0.001, 2.49), (50, 0.0009, -2.49), 4.8045),
        ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((50, 2.5, 0), (61, -5, 29), 22.8977),
        ((50, 2.5, 0), (56, -27, -3), 31.9030),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((63.0109, -31.0961, -5.8663), (62.8187, -29.7946, -4.0864), 1.2630),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_formula(first: Any, second: Any, difference: float) -> None:
    assert_allclose(delta_e(first, second), difference, atol=5e-5)
    assert_allclose(delta_e(second, first), difference, atol=5e-5)


# --- Colours on particles and in the legend ------------------------------------------------------

HEIGHT = 720


def flat_lit(scene: ph.Scene) -> ph.Image:
    """The middle of a lone sphere under even white light.

    From all around comes radiance 1, and the sphere sees nothing of itself: what it scatters is its
    albedo, whichever way it faces.
    """
    scene = scene.replace(background=ph.Background("constant", radiance=(1, 1, 1)))
    return ph.render(scene, width=64, height=64, spp=1, crop=(24, 24, 16, 16))


def seen(image: ph.Image) -> np.ndarray:
    """The one colour of a sphere."""
    pixels = image.srgb()
    assert np.ptp(pixels.astype(int), axis=(0, 1)).max() == 0
    return pixels[0, 0]


@pytest.mark.parametrize(
    "colormap", ["viridis", "magma", "coolwarm", "twilight", "gray", "turbo", "jet"]
)
def test_a_flat_lit_particle_has_the_colour_of_its_value(colormap: str) -> None:
    options = ph.LoadOptions(color_by="speed", colormap=colormap, color_range=(-2.0, 5.0))
    rows = bar_rows(HEIGHT)
    legend = panel(ph.ColorBar("speed", colormap, -2.0, 5.0), HEIGHT)
    worst = 0.0
    values = (-2.0, -1.999, 0.0, 1.3, 3.14159, 4.99, 5.0)
    for value in values:
        lone = Particles(np.zeros((1, 3)), radii=np.ones(1), fields={"speed": np.array([value])})
        image = flat_lit(to_scene(lone, options, "one"))
        assert image.legend == ph.ColorBar("speed", colormap, -2.0, 5.0)
        # a reader's eye goes from the value on the axis straight to the bar
        row = rows.start + min(len(rows) - 1, int((5.0 - value) / 7.0 * len(rows)))
        shown = legend[row, bar_columns(HEIGHT)]
        assert_array_equal(shown, np.broadcast_to(shown[0], shown.shape))
        worst = max(worst, float(delta_e(lab(seen(image)), lab(shown[0]))))
    assert worst < 1.0


def test_flat_lit_kinds_have_the_colours_of_their_swatches() -> None:
    for element in ("H", "C", "O", "Fe"):
        lone = Particles(np.zeros((1, 3)), elements=Labels.of([element]))
        image = flat_lit(to_scene(lone, ph.LoadOptions(), "one"))
        assert image.legend is not None
        legend = panel(image.legend, HEIGHT)
        colors, counts = np.unique(legend.reshape(-1, 3), axis=0, return_counts=True)
        large = colors[counts > 40]  # but the white, the edge and some greys of letters
        assert delta_e(lab(seen(image)), lab(large)).min() < 1.0


def test_also_in_a_file(tmp_path: Path) -> None:
    options = ph.LoadOptions(color_by="q", color_range=(0.0, 1.0))
    lone = Particles(np.zeros((1, 3)), radii=np.ones(1), fields={"q": np.array([0.7])})
    scene = to_scene(lone, options, "one")
    scene = scene.replace(background=ph.Background("constant", radiance=(1, 1, 1)))
    ph.render(scene, width=200, height=200, spp=1).save(tmp_path / "a.png", legend=True)
    pixels, _ = read_picture(tmp_path / "a.png")
    rows = bar_rows(200)
    shown = pixels[rows.start + int(0.3 * len(rows)), 200 + bar_columns(200).start]
    assert delta_e(lab(pixels[100, 100]), lab(shown)) < 1.0


def test_colors_of_a_map_of_few_stay_apart() -> None:
    legend = ph.ColorBar("kind", "tab10", 0.0, 10.0)
    bar = panel(legend, HEIGHT)[bar_rows(HEIGHT), bar_columns(HEIGHT).start]
    assert len(np.unique(bar, axis=0)) == 10


def test_a_wrong_bar_would_be_seen() -> None:
    """The test above can fail: a bar upside down, and one twice encoded."""
    legend = ph.ColorBar("x", "viridis", 0.0, 1.0)
    bar = panel(legend, HEIGHT)[bar_rows(HEIGHT), bar_columns(HEIGHT).start]
    assert delta_e(lab(bar), lab(bar[::-1])).max() > 50
    assert delta_e(lab(bar), lab(255 * (bar / 255) ** 2.2)).max() > 10


# --- What is drawn -------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [16, 100, 1080])
@pytest.mark.parametrize(
    "legend",
    [
        ph.ColorBar("velocity", "viridis", -1e-3, 1e300),
        ph.ColorBar("$ _{", "magma", 1e6, 1e6 + 1e-3),
        ph.ColorBar("one", "magma", 3.0, 3.0),
        ph.ColorBar("huge", "gray", -1.7e308, 1.7e308),
        ph.Swatches("element", (("H", (0.85, 0.85, 0.85)), ("$C_{", (0.2, 0.2, 0.2)))),
        ph.Swatches("", tuple((str(k), (0.5, 0.1, 0.1)) for k in range(500))),
    ],
)
def test_panels_of_every_size(height: int, legend: Any) -> None:
    pixels = panel(legend, height)
    assert pixels.dtype == np.uint8
    assert pixels.shape[0] == height
    assert pixels.shape[1] % 2 == 0
    assert (pixels[:, -1] == 255).all()  # nothing is cut off
    assert_array_equal(panel(legend, height), pixels)


def test_the_bar_goes_up() -> None:
    legend = ph.ColorBar("x", "gray", 2.0, 6.0)
    values = bar_values(legend, 300)
    assert values[0] > values[-1]
    assert_allclose(values[[0, -1]], (6.0, 2.0), atol=4.0 / len(values))
    bar = panel(legend, 300)[bar_rows(300), bar_columns(300).start].astype(int)
    assert (np.diff(bar[:, 0]) <= 0).all()
    assert (bar[0, 0], bar[-1, 0]) == (255, 0)


def test_the_picture_beside_the_legend_is_the_picture(tmp_path: Path) -> None:
    scene = ph.scene_of(np.random.default_rng(0).random((20, 3)), color_by="z")
    image = ph.render(scene, width=60, spp=2)
    wide = image.srgb(legend=True)
    assert_array_equal(wide[:, :60], image.srgb())
    assert wide.shape[1] > 60
    image.save(tmp_path / "a.png", bits=16, legend=True)
    deep, _ = read_picture(tmp_path / "a.png")
    assert_array_equal(deep[:, :60], image.srgb(16))
    assert_array_equal(deep[:, 60:], wide[:, 60:].astype(np.uint16) * 257)


def test_legends_of_meshes(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float heat\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
        "0 0 0 1\n1 0 0 2\n0 1 0 4\n3 0 1 2\n"
    )
    scene = ph.load(tmp_path / "a.ply", ph.LoadOptions(color_by="heat", color_range=(1.0, 4.0)))
    assert scene.legend == ph.ColorBar("heat", "viridis", 1.0, 4.0)
    assert ph.load(tmp_path / "a.ply").legend is None


def test_kinds_in_the_legend() -> None:
    types = Labels.of(np.array([10, 2, 2, 1]))
    scene = to_scene(Particles(np.eye(4, 3), types=types), ph.LoadOptions(), "kinds")
    assert isinstance(scene.legend, ph.Swatches)
    assert [name for name, _ in scene.legend.kinds] == ["1", "2", "10"]
    assert_allclose(scene.shapes[0].colors[0], scene.legend.kinds[2][1])


# --- The command ---------------------------------------------------------------------------------


def test_a_legend_on_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("w.xyz").write_text("2\n\nO 0 0 0\nH 1 0 0\n1\n\nO 2 0 0\n")
    words = ["render", "w.xyz", "--width", "64", "--spp", "1", "-q", "--legend"]
    assert cli.main([*words, "-o", "a.png"]) == 0
    assert read_picture(Path("a.png"))[0].shape[1] > 64
    # all pictures of a sequence have the legend of all, and so the same size
    assert cli.main([*words, "--frames", "all", "-o", "f.png"]) == 0
    first, second = (read_picture(Path(f"f.000{k}.png"))[0] for k in (1, 2))
    assert_array_equal(first[:, 64:], second[:, 64:])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("w.xyz -o a.exr", "a.exr: .exr cannot hold a legend (choices: .png, .jpg, .jpeg)"),
        ("w.xyz -o a.exr --turntable 2", "a.0001.exr: .exr cannot hold a legend"),
        ("", "there is no legend: the scene's colours stand for nothing"),
        ("--turntable 2", "there is no legend"),
    ],
)
def test_a_legend_that_there_is_not(
    words: str,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("w.xyz").write_text("1\n\nO 0 0 0\n")
    assert cli.main(["render", *words.split(), "--legend", "--spp", "99999999"]) == 2
    assert re.search(re.escape(told), capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == [tmp_path / "w.xyz"]
