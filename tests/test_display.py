"""From light to a screen: view transforms, exposure and white balance."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from parhelion import display, machine
from parhelion.cli import main
from parhelion.display import VIEW_TRANSFORMS, Display, chromaticity
from parhelion.spectra import LUMINANCE, decode_srgb
from picture_tools import read_picture

GENTLE = [name for name in VIEW_TRANSFORMS if name != "srgb"]


def lights(count: int = 40000, seed: int = 1) -> np.ndarray:
    """(1, N, 3): colours of all hues and saturations over twenty stops, and greys."""
    rng = np.random.default_rng(seed)
    hue = rng.random((count, 3)) ** rng.uniform(0.1, 8, (count, 1))
    return (hue * 2.0 ** rng.uniform(-12, 8, (count, 1))).astype(np.float32)[None]


GREYS = np.float32([0.0, 0.001, 0.01, 0.18, 0.5, 1, 4, 16, 100])[None, :, None] * np.ones(
    3, np.float32
)


# --- View transforms -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["aces", "aces-1.3"])
def test_aces_is_what_another_program_s_library_makes(name: str) -> None:
    """OpenImageIO has an OpenColorIO of its own built in, with the same configurations."""
    import OpenImageIO as oiio

    config, view = display._CONFIGS[name]
    light = np.concatenate([lights(), GREYS], axis=1)
    theirs = oiio.ImageBufAlgo.ociodisplay(
        oiio.ImageBuf(light),
        "sRGB - Display",
        view,
        fromspace="Linear Rec.709 (sRGB)",
        unpremult=False,
        colorconfig=f"ocio://{config}",
    )
    assert not theirs.has_error, theirs.geterror()
    expected = 65535 * np.clip(theirs.get_pixels(), 0, 1)
    found = Display(name).encode(light, 16).astype(float)
    # both are single precision; its rounding in steps of the longest chain
    assert np.abs(found - expected).max() < 40


def test_aces_shows_middle_grey_where_the_academy_has_it() -> None:
    # ACES 2.0: 0.18 is 10 of 100 cd/m^2; ACES 1: 0.18 is 4.8 of 48, seen in a dim room
    seen = decode_srgb(Display("aces").encode(GREYS, 16)[0, 3] / 65535.0)
    np.testing.assert_allclose(seen, 0.100, atol=0.001)


def agx(light: np.ndarray) -> np.ndarray:
    """In double precision, from linear light to sRGB's code values."""
    # Sobotka's matrix, of primaries moved by a fifth to white, as his AgX has it
    inwards = np.array(
        [
            [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
            [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
            [0.0423756549057051, 0.0784336, 0.879142973793104],
        ]
    )
    stops = np.log2(np.maximum(light.astype(float) @ inwards.T, 1e-9) / 0.18)
    code = display.agx_curve(np.clip((stops + 10) / 16.5, 0, 1))
    x = np.clip(code**2.2 @ np.linalg.inv(inwards).T, 0, 1)
    return np.asarray(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055))


def test_agx_is_its_formula() -> None:
    light = np.concatenate([lights(), GREYS], axis=1)
    found = Display("agx").encode(light, 16) / 65535.0
    assert np.abs(found - agx(light)).max() < 0.004
    assert np.abs(found - agx(light)).mean() < 1e-4


def test_agx_keeps_grey_and_meets_black_and_white() -> None:
    curve = display.agx_curve(np.array([0.0, 10 / 16.5, 1.0]))
    np.testing.assert_allclose(curve, [0, 0.18 ** (1 / 2.2), 1], atol=1e-12)
    fine = display.agx_curve(np.linspace(0, 1, 5000))
    slope = np.diff(fine) * 4999
    assert slope.min() > 0
    assert slope.max() == pytest.approx(2.4, abs=0.01)
    seen = Display("agx").encode(GREYS, 16)
    np.testing.assert_allclose(seen[0, 3] / 65535.0, 0.4613, atol=2e-4)  # as sRGB has it
    assert np.ptp(seen.astype(int), axis=-1).max() <= 3  # grey stays grey


@pytest.mark.parametrize("name", GENTLE)
def test_bright_colours_go_towards_white(name: str) -> None:
    red = np.float32([1, 0.02, 0.01]) * 2.0 ** np.arange(-3, 15)[:, None]
    seen = Display(name).encode(red[None].astype(np.float32))[0].astype(int)
    assert (np.diff(seen, axis=0) >= -1).all()  # each stop is at least as bright
    assert np.ptp(seen[-1]) < 25
    assert np.ptp(seen[3]) > 100
    # what srgb cuts is still told apart
    assert len({tuple(c) for c in seen.tolist()[4:10]}) == 6
    assert len({tuple(c) for c in Display().encode(red[None])[0].tolist()[10:]}) == 1


@pytest.mark.parametrize("name", GENTLE)
def test_the_fast_way_is_nearly_the_same(name: str) -> None:
    rng = np.random.default_rng(4)
    # as pictures are: most colours are moderate
    light = np.exp(rng.normal(-1, 1.5, (200, 200, 3))).astype(np.float32)
    for bits in (8, 16):
        shown = Display(name, exposure=0.5)
        steps = 1 if bits == 8 else 257
        error = np.abs(shown.encode(light, bits).astype(int) - shown.encode(light, bits, fast=True))
        assert np.quantile(error, 0.99) <= 1.0 * steps
        assert np.quantile(error, 0.999) <= 3.0 * steps
        assert error.max() <= 25 * steps
        grey = shown.encode(GREYS, bits).astype(int) - shown.encode(GREYS, bits, fast=True)
        assert np.abs(grey).max() <= 1 * steps


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("name", VIEW_TRANSFORMS)
def test_what_is_no_light(name: str, fast: bool) -> None:
    x = np.float32([[[np.nan] * 3, [-np.inf] * 3, [-1] * 3, [0] * 3, [np.inf] * 3, [3e38] * 3]])
    before = x.copy()
    for balance in (None, 3200):
        shown = Display(name, exposure=2, white_balance=balance)
        seen = shown.encode(x, fast=fast)[0]
        assert seen[0].max() <= 1
        if balance is None:
            assert seen[:4].max() <= 1
            assert seen[4:].min() >= 254
    np.testing.assert_array_equal(x, before)


@pytest.mark.parametrize("name", GENTLE)
def test_threads_change_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    light = lights(331 * 997).reshape(997, 331, 3)
    found = []
    for count in (1, 4):
        monkeypatch.setattr(machine, "cores_available", lambda count=count: count)
        found.append(Display(name).encode(light, fast=True).tobytes())
    assert found[0] == found[1]
    flat = light.reshape(1, -1, 3)  # a row cannot be divided
    assert Display(name).encode(flat, fast=True).tobytes() == found[0]
    # nor does how the array lies in memory
    turned = np.asfortranarray(light[:50, :60])
    np.testing.assert_array_equal(
        Display(name).encode(turned), Display(name).encode(light[:50, :60].astype(float))
    )


# --- White balance -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kelvin", "x", "y"),
    [
        (2856, 0.44757, 0.40745),  # illuminant A, CIE 015:2018
        (5003, 0.34567, 0.35850),  # D50
        (6504, 0.31271, 0.32902),  # D65
        (7504, 0.29902, 0.31485),  # D75
    ],
)
def test_chromaticities_of_illuminants(kelvin: float, x: float, y: float) -> None:
    np.testing.assert_allclose(chromaticity(kelvin), (x, y), atol=1.5e-4)


def test_temperatures_have_no_steps() -> None:
    found = np.array([chromaticity(k) for k in np.geomspace(1000, 25000, 600)])
    assert np.abs(np.diff(found, axis=0)).max() < 0.006
    assert (np.diff(found[:, 0]) < 0).all()


@pytest.mark.parametrize("white", [2000, 3200.0, 4500, 9000, (0.25, 0.36), np.array([0.4, 0.4])])
def test_the_white_becomes_neutral_and_keeps_its_luminance(white: object) -> None:
    shown = Display(white_balance=white)  # type: ignore[arg-type]
    at = shown.white_balance
    x, y = at if isinstance(at, tuple) else chromaticity(at)  # type: ignore[arg-type]
    light = np.linalg.solve(display._to_xyz(display._PRIMARIES), display._xyz((x, y)))
    np.testing.assert_allclose(shown.matrix() @ light, 1.0, atol=1e-9)
    # and the other way round, as a background's colour is found
    bright = replace(shown, exposure=2)
    np.testing.assert_allclose(bright.matrix() @ bright.before((0.5, 0.5, 0.5)), 0.5)


def test_white_balance_of_a_picture() -> None:
    candle = np.float32([[[0.9, 0.5, 0.2]]])
    # warm light looks less warm, daylight as before
    warm = Display(white_balance=3200).encode(candle)[0, 0].astype(int)
    plain = Display().encode(candle)[0, 0].astype(int)
    same = Display(white_balance=6504).encode(candle)[0, 0].astype(int)
    assert np.ptp(warm) < 0.6 * np.ptp(plain)
    assert np.abs(same - plain).max() <= 1
    luminance = [float(decode_srgb(c / 255.0) @ np.array(LUMINANCE)) for c in (plain, warm)]
    assert luminance[0] == pytest.approx(luminance[1], rel=0.12)


# --- Where it is asked for -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def image() -> ph.Image:
    return ph.render(ph.weekend(), width=48, spp=4)


def test_pictures_are_saved_as_they_are_seen(image: ph.Image, tmp_path: Path) -> None:
    how = {"exposure": 0.5, "view_transform": "agx", "white_balance": (0.34, 0.36)}
    image.save(tmp_path / "a.png", **how)  # type: ignore[arg-type]
    pixels, told = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, image.srgb(**how))  # type: ignore[arg-type]
    assert np.mean(pixels != image.srgb(exposure=0.5)) > 0.9
    assert told["parhelion:view_transform"] == "agx"
    assert display.parsed_white_balance(told["parhelion:white_balance"]) == (0.34, 0.36)
    image.save(tmp_path / "a.exr", **how)  # type: ignore[arg-type]
    stored, told = read_picture(tmp_path / "a.exr")
    np.testing.assert_array_equal(stored, image.numpy())
    assert told["parhelion:exposure"] == "0.5"
    ph.save_sequence([image], tmp_path / "b.png", **how)  # type: ignore[arg-type]
    np.testing.assert_array_equal(read_picture(tmp_path / "b.0001.png")[0], pixels)


def test_the_command_line(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    small = ["render", "--width", "16", "--spp", "1", "-q", "-o", str(file)]
    look = ["--view-transform", "aces", "--white-balance", "3200", "--exposure", "1"]
    assert main([*small, *look]) == 0
    told = json.loads(read_picture(file)[1]["ImageDescription"])
    names = ("view_transform", "white_balance", "exposure")
    assert [told[f"parhelion:{name}"] for name in names] == ["aces", "3200.0", "1"]


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        (["--view-transform", "agz"], "unknown --view-transform 'agz'; did you mean 'agx'"),
        (["--white-balance", "500"], "must be a temperature from 1000 to 25000"),
        (["--white-balance", "0.3,0.9"], "or the chromaticity of a white"),
        (["--white-balance", "warm"], "is 'warm'; must be a temperature"),
        (["--exposure", "nan"], "--exposure is nan; must be a number of stops"),
    ],
)
def test_mistakes_are_told_before_there_is_a_picture(
    flags: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["render", "-o", str(tmp_path / "a.png"), *flags])
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert told in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "white", [True + 1j, "3200", 999, 1e9, np.nan, (0.3,), (0.3, 0.01), (0.3, 0.3, 0.3), (0.0, 1.0)]
)
def test_a_white_without_meaning(white: object) -> None:
    with pytest.raises(ph.SceneError, match=r"white_balance is .*; must be a temperature"):
        Display(white_balance=white)  # type: ignore[arg-type]


def test_a_named_background_is_seen_as_it_was_named(tmp_path: Path) -> None:
    file = tmp_path / "a.png"
    # nothing but background in the upper corner
    flags = ["--background", "#204060", "--white-balance", "4000", "--exposure", "1"]
    small = ["--width", "24", "--spp", "1", "-q", "-o", str(file)]
    assert main(["render", *flags, *small]) == 0
    assert np.abs(read_picture(file)[0][0, 0].astype(int) - [0x20, 0x40, 0x60]).max() <= 1
