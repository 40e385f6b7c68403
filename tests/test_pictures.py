"""`parhelion image`: picture files into others, their layers, and what is told of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.cli import main
from parhelion.display import Display
from parhelion.image import CHANNELS, encoded, read_pixels
from parhelion.layers import MAIN, PictureFile, exr_bytes
from parhelion.spectra import decode_srgb
from picture_tools import read_picture


@pytest.fixture(scope="module")
def image() -> ph.Image:
    return ph.render(ph.weekend(), width=60, spp=2, features=True)


@pytest.fixture
def exr(image: ph.Image, tmp_path: Path) -> Path:
    image.save(tmp_path / "in.exr", exposure=0.5, view_transform="agx", white_balance=5000)
    return tmp_path / "in.exr"


def run(*arguments: object) -> int:
    try:
        return main(["image", *map(str, arguments), "-q"])
    except SystemExit as end:
        return int(end.code or 0)


def foreign(path: Path, parts: list[tuple[str, dict[str, np.ndarray]]]) -> None:
    """An .exr file of parts, each of channels by name, as OpenEXR itself writes it."""
    import OpenEXR

    OpenEXR.File(
        [
            OpenEXR.Part(
                {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage},
                dict(channels),
                name=name,
            )
            for name, channels in parts
        ]
    ).write(str(path))


# --- Layers --------------------------------------------------------------------------------------


def test_layers_are_those_of_the_features(image: ph.Image, exr: Path) -> None:
    file = PictureFile(exr)
    layers = {c.rpartition(".")[0] for name in image.features for c in CHANNELS[name]}
    assert file.layers.keys() == {MAIN, *layers}
    np.testing.assert_array_equal(file.read(file.layer()), image.pixels)
    assert file.layer("normal").channels == ("X", "Y", "Z")
    np.testing.assert_array_equal(file.read(file.layer("normal")), image.features["normal"])
    np.testing.assert_array_equal(
        file.read(file.layer("CryptoObject01")).reshape(34, 60, 2, 2),
        image.features["CryptoObject"][:, :, 2:4],
    )
    lit = {name for name, layer in file.layers.items() if layer.is_light}
    assert lit == {MAIN, "albedo", "emission", "direct", "indirect"}


def test_parts_and_names_of_other_programs(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    plane = {name: rng.random((5, 7), np.float32) for name in "abcdefgh"}
    foreign(
        tmp_path / "a.exr",
        [
            ("first", {"View.Combined.B": plane["a"], "View.Combined.R": plane["b"],
                       "View.Combined.G": plane["c"], "View.Depth.Z": plane["d"]}),
            ("second", {"Y": plane["e"]}),
            ("third", {"View.Combined.R": plane["f"], "A": plane["g"], "R": plane["h"]}),
        ],
    )  # fmt: skip
    file = PictureFile(tmp_path / "a.exr")
    assert list(file.layers) == [
        "View.Combined", "View.Depth", "second", "third", "third.View.Combined"
    ]  # fmt: skip
    chosen = file.layer()
    assert (chosen.name, chosen.channels) == ("View.Combined", ("R", "G", "B"))
    expected = np.stack([plane[k] for k in "bca"], axis=-1)
    np.testing.assert_array_equal(file.read(chosen), expected)
    np.testing.assert_array_equal(file.read(file.layer("second"))[..., 0], plane["e"])
    assert file.layer("third").channels == ("R", "A")
    with pytest.raises(ph.FormatError, match=r"a.exr: has 3 parts; choose one of its layers"):
        file.everything()
    assert run(tmp_path / "a.exr", "-o", tmp_path / "b.png", "--layer", "second") == 0
    grey = np.repeat(plane["e"][..., None], 3, axis=2)
    np.testing.assert_array_equal(read_picture(tmp_path / "b.png")[0], Display().encode(grey))


# --- Pictures for screens ------------------------------------------------------------------------


def test_a_picture_looks_as_its_file_says(image: ph.Image, exr: Path) -> None:
    out = exr.with_name("out.png")
    assert run(exr, "-o", out) == 0
    pixels, told = read_picture(out)
    expected = image.srgb(exposure=0.5, view_transform="agx", white_balance=5000)
    np.testing.assert_array_equal(pixels, expected)
    assert told["parhelion:scene"] == image.flat.sha256()  # whose picture it is, is kept
    assert told["parhelion:view_transform"] == "agx"
    # flags come first
    flags = ["--view", "aces-1.3", "--exposure", "-1", "--white-balance", "6000", "--bits", "16"]
    assert run(exr, "-o", out, *flags) == 0
    pixels, _ = read_picture(out)
    shown = Display("aces-1.3", -1, 6000)
    np.testing.assert_array_equal(pixels, shown.encode(image.pixels, 16))
    assert run(exr, "-o", out, "--view-transform", "srgb", "--layer", "albedo") == 0
    shown = Display("srgb", 0.5, 5000)
    np.testing.assert_array_equal(read_picture(out)[0], shown.encode(image.features["albedo"]))


def test_layers_of_data(image: ph.Image, exr: Path) -> None:
    out = exr.with_name("out.png")
    assert run(exr, "-o", out, "--layer", "depth", "--range", 5, 15) == 0
    depth = image.features["depth"].reshape(34, 60, 1).astype(float)
    expected = np.repeat(np.floor(255 * np.clip((depth - 5) / 10, 0, 1) + 0.5), 3, axis=2)
    np.testing.assert_allclose(read_picture(out)[0], expected, atol=1)
    # backwards: near is white; all of it, if nothing is said
    assert run(exr, "-o", out, "--layer", "depth", "--range", 15, 5) == 0
    np.testing.assert_allclose(read_picture(out)[0], 255 - expected, atol=1)
    assert run(exr, "-o", out, "--layer", "uv", "--bits", 16) == 0
    pixels, _ = read_picture(out)
    assert (pixels.min(), pixels.max()) == (0, 65535)
    assert (pixels[..., 2] == 0).all()


def test_alpha(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    color, alpha = rng.random((6, 8, 3), np.float32), rng.random((6, 8, 1), np.float32)
    alpha[0] = 0
    data = exr_bytes(list("RGBA"), ["float"] * 4, np.concatenate([color * alpha, alpha], 2), {})
    (tmp_path / "a.exr").write_bytes(data)
    assert run(tmp_path / "a.exr", "-o", tmp_path / "a.png", "--bits", 16) == 0
    pixels, _ = read_picture(tmp_path / "a.png", "RGBA")
    import OpenImageIO as oiio

    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    reader = oiio.ImageInput.open(str(tmp_path / "a.png"), hints)
    stored = reader.read_image(0, 0, 0, 4, "uint16")
    reader.close()
    np.testing.assert_allclose(stored[..., 3:], 65535 * alpha, atol=1)
    seen = alpha[..., 0] > 0.05
    expected = Display().encode(color, 16)
    assert np.abs(stored[..., :3][seen].astype(int) - expected[seen]).max() <= 2
    assert pixels.shape == (6, 8, 4)
    # back again, and where there is no alpha, on black
    assert run(tmp_path / "a.png", "-o", tmp_path / "b.exr") == 0
    back, _ = read_picture(tmp_path / "b.exr", "RGBA")
    np.testing.assert_allclose(back[..., :3], color * alpha, atol=1e-3)
    assert run(tmp_path / "a.exr", "-o", tmp_path / "c.jpg") == 0
    assert read_picture(tmp_path / "c.jpg")[0][0].max() < 60


# CIE x and y of red, green, blue and white, and what makes linear Rec. 709 of ACES' two spaces, as
# the Academy's transforms have it (linear Bradford)
ACES = {
    "AP0": (
        (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767),
        [
            [2.52169, -1.13413, -0.38756],
            [-0.27648, 1.37272, -0.09624],
            [-0.01538, -0.15298, 1.16835],
        ],
    ),
    "AP1": (
        (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
        [
            [1.70505, -0.62179, -0.08326],
            [-0.13026, 1.14080, -0.01055],
            [-0.02400, -0.12897, 1.15297],
        ],
    ),
}


def with_primaries(path: Path, names: list[str], pixels: np.ndarray, primaries: Any) -> None:
    import OpenImageIO as oiio

    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, "float")
    spec.channelnames = tuple(names)
    spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), primaries)
    out = oiio.ImageOutput.create(str(path))
    assert out.open(str(path), spec)
    assert out.write_image(pixels.astype(np.float32))
    out.close()


@pytest.mark.parametrize("space", list(ACES))
def test_other_primaries_become_rec_709(tmp_path: Path, space: str) -> None:
    primaries, rows = ACES[space]
    names = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "depth.Z", "grey.Y"]
    colors = np.concatenate([np.eye(3), [[1, 1, 1], [0.2, 0.4, 0.6]]])[None]  # (1, 5, 3)
    stored = np.concatenate([colors, 0.5 * colors, 7 + colors[..., :2]], axis=2)
    with_primaries(tmp_path / "in.exr", names, stored, primaries)
    expected = colors @ np.transpose(rows)
    np.testing.assert_allclose(expected[0, 3], 1, atol=2e-5)  # white stays white
    file = PictureFile(tmp_path / "in.exr")
    light, _ = file.light(file.layer())
    np.testing.assert_allclose(light, expected, atol=2e-5)
    np.testing.assert_allclose(file.read(file.layer("albedo")), 0.5 * expected, atol=2e-5)
    np.testing.assert_array_equal(file.read(file.layer("depth")), np.float32(stored[..., 6:7]))
    np.testing.assert_array_equal(file.read(file.layer("grey")), np.float32(stored[..., 7:8]))
    np.testing.assert_allclose(read_pixels(tmp_path / "in.exr"), expected, atol=2e-5)
    # as pictures for screens, and as files that say nothing of primaries, whole or one layer
    assert run(tmp_path / "in.exr", "-o", tmp_path / "a.png") == 0
    shown = Display().encode(np.float32(expected))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png")[0], shown)
    for words in ((), ("--layer", "albedo")):
        assert run(tmp_path / "in.exr", *words, "-o", tmp_path / "b.exr") == 0
        written = PictureFile(tmp_path / "b.exr")
        assert "chromaticities" not in written.metadata
        again = written.read(written.layer())
        np.testing.assert_allclose(again, (0.5 if words else 1) * expected, atol=2e-5)
    assert list(PictureFile(tmp_path / "in.exr").layers) == [MAIN, "albedo", "depth", "grey"]


def test_primaries_that_are_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pixels = np.arange(12.0).reshape(2, 2, 3)
    for primaries in ((0.0,) * 8, (0.3,) * 8, (np.nan,) * 8):
        caplog.clear()
        with_primaries(tmp_path / "in.exr", list("RGB"), pixels, primaries)
        file = PictureFile(tmp_path / "in.exr")
        np.testing.assert_array_equal(file.read(file.layer()), np.float32(pixels))
        assert "in.exr: there are no primaries (" in caplog.text
    rec709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
    caplog.clear()
    with_primaries(tmp_path / "in.exr", list("RGB"), pixels, rec709)
    file = PictureFile(tmp_path / "in.exr")
    np.testing.assert_array_equal(file.read(file.layer()), np.float32(pixels))
    assert not caplog.text


def test_pictures_that_are_for_screens_already(image: ph.Image, tmp_path: Path) -> None:
    image.save(tmp_path / "a.png", bits=16)
    assert run(tmp_path / "a.png", "-o", tmp_path / "b.png", "--bits", 16) == 0
    stored = image.srgb(16)
    assert np.abs(read_picture(tmp_path / "b.png")[0].astype(int) - stored).max() <= 1
    assert run(tmp_path / "a.png", "-o", tmp_path / "a.exr") == 0
    linear, _ = read_picture(tmp_path / "a.exr")
    np.testing.assert_allclose(linear, decode_srgb(stored / 65535.0), atol=1e-6)


# --- EXR files -----------------------------------------------------------------------------------


def test_all_layers_in_another_compression(image: ph.Image, exr: Path) -> None:
    out = exr.with_name("out.exr")
    assert run(exr, "-o", out, "--compression", "piz", "--tiled") == 0
    first, second = PictureFile(exr), PictureFile(out)
    assert first.layers == second.layers
    for name, layer in first.layers.items():
        np.testing.assert_array_equal(second.read(second.layer(name)), first.read(layer))
    assert second.metadata["compression"] == "piz"
    keys = {k for k in first.metadata if k.startswith(("cryptomatte/", "parhelion:"))}
    assert {k: second.metadata[k] for k in keys} == {k: first.metadata[k] for k in keys}
    assert run(exr, "-o", out, "--bits", 16) == 0
    kinds = {name: layer.kinds[0] for name, layer in PictureFile(out).layers.items()}
    colors = {MAIN, "albedo", "emission", "direct", "indirect", "coverage"}
    assert {name for name, kind in kinds.items() if kind == "half"} == colors
    assert run(exr, "-o", out, "--layer", "direct", "--compression", "dwaa") == 0
    alone = PictureFile(out)
    assert list(alone.layers) == [MAIN]
    assert np.abs(alone.read(alone.layer()) - image.features["direct"]).max() < 0.05


# --- What is told --------------------------------------------------------------------------------


def test_info(image: ph.Image, exr: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(exr, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["width"], found["height"], found["parts"]) == (60, 34, 1)
    layers = {layer["name"]: layer for layer in found["layers"]}
    assert layers["depth"]["most"] == pytest.approx(float(image.features["depth"].max()))
    assert layers[MAIN]["mean"] == pytest.approx(float(image.pixels.mean()), rel=1e-5)
    assert found["metadata"]["parhelion:spp"] == "2"
    assert run(exr, "--info") == 0
    text = capsys.readouterr().out
    assert f"  depth: Z, float; 0 to {image.features['depth'].max():.6g}, mean" in text
    assert "  parhelion:view_transform: agx\n" in text


def test_numbers_that_are_not_finite_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pixels = np.full((3, 4, 3), 0.5, np.float32)
    pixels[1, 2] = [np.nan, np.inf, 1]
    (tmp_path / "a.exr").write_bytes(encoded(pixels, {"key": "bell \a"}, ".exr"))
    assert run(tmp_path / "a.exr", "--info") == 0
    text = capsys.readouterr().out
    assert "main: R G B, float; 0.5 to 1, mean 0.514706; 2 numbers are not finite" in text
    assert "\a" not in text


def test_broken_files_are_told_of(exr: Path) -> None:
    """Bytes that were changed, mostly in the header, or cut off: an error of ours, or a picture."""
    whole = exr.read_bytes()
    rng = np.random.default_rng(6)
    outcomes = set()
    for _ in range(60):
        data = bytearray(whole)
        for place in rng.integers(0, rng.choice([3000, len(data)]), 4):
            data[place] = rng.integers(256)
        exr.write_bytes(data[: rng.integers(len(data)) if rng.random() < 0.2 else None])
        try:
            file = PictureFile(exr)
            for layer in file.layers.values():
                file.read(layer)
            outcomes.add("read")
        except ph.FormatError as error:
            outcomes.add("told" if str(error).startswith(str(exr)) else str(error))
    assert outcomes == {"read", "told"}


# --- Mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["no.exr"], "no.exr: no such file"),
        (["folder.exr"], "folder.exr: is not a regular file"),
        (["text.exr"], "text.exr: cannot be read"),
        (["cut.exr", "-o", "a.png"], "cut.exr: cannot be read"),
        (["in.exr", "--layer", "alpedo"], "in.exr: unknown layer 'alpedo'; did you mean 'albedo'"),
        (["in.exr", "-o", "in.exr"], "in.exr: is what is to be read"),
        (["in.exr", "-o", "a.gif"], "unknown picture ending '.gif'"),
        (["in.exr", "-o", "a.png", "--bits", "32"], ".png cannot hold 32 bits"),
        (["in.exr", "-o", "a.exr", "--compression", "dwaa"], "would change the ids"),
        (["in.exr", "-o", "a.exr", "--range", "0", "1"], "--range is for pictures of 8 and 16"),
        (["in.exr", "--range", "0", "1"], "layer main is light, and --range is for data"),
        (["in.exr", "--layer", "depth", "--view", "agx"], "is data, not light, and --view-tr"),
        (["in.exr", "--layer", "depth", "--range", "2", "2"], "--range is 2 2; must be two"),
        (["in.exr", "--view", "agz"], "unknown --view-transform 'agz'; did you mean 'agx'"),
    ],
)
def test_mistakes(
    arguments: list[str],
    told: str,
    exr: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(exr.parent)
    Path("folder.exr").mkdir()
    Path("text.exr").write_text("no picture")
    whole = exr.read_bytes()
    Path("cut.exr").write_bytes(whole[: len(whole) // 2])
    before = sorted(Path().iterdir())
    assert run(*arguments) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert sorted(Path().iterdir()) == before
    assert exr.read_bytes() == whole
