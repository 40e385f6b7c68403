"""Pictures: how pixels are encoded, what is written beside them, and that files stay whole."""

from __future__ import annotations

import errno
import json
import os
import stat
import tracemalloc
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from parhelion import atomic, cryptomatte
from parhelion.display import srgb_encoded
from parhelion.flatten import flatten
from parhelion.image import (
    CHANNELS,
    PRECISE,
    check_output,
    encoded,
    largest_file,
    picture_bytes,
    picture_shape,
    read_pixels,
    seconds_to_encode,
)
from picture_tools import read_picture

ENDINGS = ["png", "jpg", "exr"]


@pytest.fixture(scope="module")
def image() -> ph.Image:
    return ph.render(ph.weekend(), width=48, spp=2, seed=5, threads=2)


def painted(image: ph.Image, pixels: object) -> ph.Image:
    """The same picture with other pixels."""
    array = np.asarray(pixels, dtype=np.float32)
    return replace(image, pixels=array, counts=np.ones(array.shape[:2], np.uint32))


# --- Encoding ------------------------------------------------------------------------------------


def test_srgb_is_the_standard_s_formula() -> None:
    # IEC 61966-2-1, in double precision
    x = np.concatenate([np.linspace(0, 1, 5001), np.geomspace(1e-6, 1, 500), [0.0031308]])
    expected = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    got = srgb_encoded(x.astype(np.float32))
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, expected, atol=2e-7)


def test_srgb_cuts_what_a_screen_can_not_show() -> None:
    x = np.array([-np.inf, -1, -0.0, 1.0001, 1e30, np.inf, np.nan], np.float32)
    with np.errstate(all="raise"):
        np.testing.assert_allclose(srgb_encoded(x), [0, 0, 0, 1, 1, 1, 0], atol=1e-7)


def test_exposure_multiplies_light_by_powers_of_two(image: ph.Image, tmp_path: Path) -> None:
    x = np.array([[[0.0, 0.001, 0.1], [0.25, 0.7, 40.0], [np.inf, np.nan, 1e38]]], np.float32)
    shown = painted(image, x)
    for stops in (-3.0, 0.5, 1, 20):
        with np.errstate(all="raise"):
            found = shown.srgb(16, exposure=stops)
        finite = np.where(np.isfinite(x), x, 0).astype(np.float64)
        expected = painted(image, np.minimum(finite * 2.0**stops, 1e38)).srgb(16)
        np.testing.assert_allclose(found[0, :2].astype(int), expected[0, :2], atol=1)
        assert found[0, 2].tolist() == [65535, 0, 65535]
    shown.save(tmp_path / "a.png", exposure=1)
    pixels, told = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, shown.srgb(exposure=1))
    assert told["parhelion:exposure"] == "1"
    # linear values stay
    for ending in ("1.exr", "2.exr"):
        image.save(tmp_path / ending, exposure=-2 * (ending == "2.exr"))
    (plain, _), (exposed, told) = (read_picture(tmp_path / f"{i}.exr") for i in (1, 2))
    np.testing.assert_array_equal(plain, exposed)
    assert told["parhelion:exposure"] == "-2"


@pytest.mark.parametrize("exposure", [float("nan"), 33, -1e400, "bright", None])
def test_an_exposure_without_meaning(image: ph.Image, tmp_path: Path, exposure: object) -> None:
    with pytest.raises(ph.SceneError, match=r"exposure is .*; must be a number of stops, from -32"):
        image.save(tmp_path / "a.png", exposure=exposure)  # type: ignore[arg-type]
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16)])
def test_stored_numbers_are_rounded_to_the_nearest(image: ph.Image, bits: int, dtype: type) -> None:
    x = np.linspace(0, 1, 3 * 4096).reshape(64, 64, 3)
    stored = painted(image, x).srgb(bits)
    assert stored.dtype == dtype
    top = 2**bits - 1
    exact = top * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    # half a step, and the error of single precision
    assert np.max(np.abs(stored - exact)) < 0.5 + top * 3e-7
    assert (stored.min(), stored.max()) == (0, top)
    assert len(np.unique(stored[..., 0])) > 0.6 * min(top, 4096)


# --- Files hold what the picture holds -----------------------------------------------------------


@pytest.mark.parametrize("bits", [8, 16])
def test_png_holds_the_srgb_numbers(image: ph.Image, tmp_path: Path, bits: int) -> None:
    image.save(tmp_path / "a.png", bits=bits)
    pixels, _ = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, image.srgb(bits))


def test_jpeg_is_near_the_srgb_numbers(image: ph.Image, tmp_path: Path) -> None:
    ramp = np.linspace(0, 1, 64)[None, :, None] * np.array([1, 0.5, 0.25])
    picture = painted(image, np.repeat(ramp, 32, axis=0))
    picture.save(tmp_path / "a.jpg")
    pixels, _ = read_picture(tmp_path / "a.jpg")
    assert np.mean(np.abs(pixels.astype(int) - picture.srgb())) < 3


def jpeg(path: Path, channels: int, progressive: bool) -> bytes:
    """A JPEG of 24 rows of 40 pixels, by another program's usual ways."""
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(40, 24, channels, "uint8")
    spec.attribute("jpeg:progressive", int(progressive))
    output = oiio.ImageOutput.create(str(path))
    noise = np.random.default_rng(1).integers(0, 256, (24, 40, channels), np.uint8)
    assert output.open(str(path), spec)
    assert output.write_image(noise)
    output.close()
    return path.read_bytes()


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("progressive", [False, True])
def test_the_header_of_a_jpeg_is_read_without_its_pixels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, channels: int, progressive: bool
) -> None:
    data = jpeg(tmp_path / "a.jpg", channels, progressive)
    assert data.count(b"\xff\xc2") == progressive
    padded = data[:2] + b"\xff\xff" + data[2:]  # as a marker may be
    tables_first = data[:2] + b"\xff\xc4\0\x02" + b"\xff\xdb\0\x02" + data[2:]
    extended = data.replace(b"\xff\xc0", b"\xff\xc1", 1)
    stored = read_pixels(padded)
    assert stored.shape == (24, 40, channels)
    monkeypatch.setattr("parhelion.image.opened", None)  # which decodes progressive ones
    path = tmp_path / "a.jpg"
    for source in (path, str(path), data, padded, tables_first, extended):
        assert picture_shape(source) == stored.shape
        assert picture_bytes(source) == stored.nbytes


def test_a_jpeg_whose_header_tells_too_little_is_left_to_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(*_: object) -> None:
        raise LookupError

    data = jpeg(tmp_path / "a.jpg", 3, False)
    frame = data.index(b"\xff\xc0")
    monkeypatch.setattr("parhelion.image.opened", asked)
    for broken in (
        *(data[:cut] for cut in range(2, frame + 10)),
        data[:frame] + b"\0" + data[frame + 1 :],  # no marker
        data[: frame + 4] + b"\x0c" + data[frame + 5 :],  # 12 bits
        data[: frame + 5] + b"\0\0" + data[frame + 7 :],  # rows
        data[: frame + 9] + b"\x02" + data[frame + 10 :],  # colours
        data[: frame + 9] + b"\x04" + data[frame + 10 :],  # four, which are read as three
        data[: frame + 1] + b"\xc4" + data[frame + 2 :],  # no frame
        data[:2] + b"\xff\xe1\0\0" + data[2:],  # a segment shorter than its length
        b"xx" + data[2:],
        data[:2] + b"\xff" * 10_000 + data[2:],
        data[: frame + 5] + b"\xff\xff\xff\xff" + data[frame + 9 :],  # 12 GB of pixels
    ):
        with pytest.raises(LookupError):
            picture_bytes(broken)
    for path in (tmp_path / "none.jpg", "a\0.jpg"):
        with pytest.raises(LookupError):
            picture_bytes(path)


def test_exr_holds_single_precision_exactly(image: ph.Image, tmp_path: Path) -> None:
    wide = np.float32([1e-40, 1e-30, 0.1, 1, 70000, 3e38])
    picture = painted(image, np.stack([wide, wide[::-1], wide * 0.5], axis=-1)[None])
    picture.save(tmp_path / "a.exr")
    pixels, attributes = read_picture(tmp_path / "a.exr")
    assert pixels.dtype == np.float32
    np.testing.assert_array_equal(pixels, picture.numpy())
    assert attributes["oiio:ColorSpace"] == "lin_rec709_scene"


@pytest.mark.filterwarnings("error")
def test_exr_of_16_bits_is_rounded_and_never_infinite(image: ph.Image, tmp_path: Path) -> None:
    x = np.float32([[[0.1, 1 / 3, 2000.5], [65504, 65519, 1e6], [3e38, 0, 6e-8]]])
    painted(image, x).save(tmp_path / "a.exr", bits=16)
    pixels, _ = read_picture(tmp_path / "a.exr")
    assert pixels.dtype == np.float16
    np.testing.assert_array_equal(pixels, np.minimum(x, 65504).astype(np.float16))


def test_numbers_that_are_not_finite_survive_where_a_file_can_hold_them(
    image: ph.Image, tmp_path: Path
) -> None:
    picture = painted(image, [[[np.nan, np.inf, 1], [0.5, 0.5, 0.5]]])
    picture.save(tmp_path / "a.exr")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr")[0], picture.numpy())
    picture.save(tmp_path / "a.png")
    pixels, _ = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, [[[0, 255, 255], [188, 188, 188]]])


@pytest.fixture(scope="module")
def featured() -> ph.Image:
    # more rows than are written at a time; noise adds what tells of it
    seen = ph.render(ph.weekend(), width=40, height=150, spp=2, noise=1e-3, features=True)
    return replace(seen, features={**seen.features, "noisy": 0.75 * seen.pixels})


def test_an_exr_file_has_a_layer_for_every_feature(featured: ph.Image, tmp_path: Path) -> None:
    file = tmp_path / "a.exr"
    featured.save(file)
    assert featured.features.keys() == CHANNELS.keys()
    for name, channels in CHANNELS.items():
        stored, _ = read_picture(file, channels)
        assert stored.dtype == np.float32
        values = featured.features[name]
        np.testing.assert_array_equal(stored, values.reshape(stored.shape), err_msg=name)
    pixels, told = read_picture(file)
    np.testing.assert_array_equal(pixels, featured.numpy())
    shapes, materials = (json.loads(told[f"parhelion:{x}"]) for x in ("shapes", "materials"))
    assert (shapes, materials) == (featured.flat.shape_names, featured.flat.material_names)
    # what the indices mean: the lower half of the picture shows little but the ground
    lowest = featured.features["shape"][-1]
    assert shapes[np.bincount(lowest.astype(int)).argmax()] == "ground"


@pytest.mark.filterwarnings("error")
def test_16_bits_spare_the_features_that_need_more(featured: ph.Image, tmp_path: Path) -> None:
    bright = dict(featured.features) | {"direct": featured.features["direct"] * np.float32(1e9)}
    replace(featured, features=bright).save(tmp_path / "a.exr", bits=16)
    data = {"depth", "position", "uv", "samples", "variance", "shape", "material"}
    assert {*data, *cryptomatte.LAYERS} == PRECISE
    for name, channels in CHANNELS.items():
        stored, _ = read_picture(tmp_path / "a.exr", channels)
        values = bright[name].reshape(stored.shape).astype(np.float32)
        if name not in PRECISE:
            values = np.minimum(values, 65504).astype(np.float16).astype(np.float32)
        np.testing.assert_array_equal(stored, values, err_msg=name)
    assert np.float16(read_picture(tmp_path / "a.exr")[0]).max() > 0.5


def read_by_openexr(path: Path) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """Channels by name, and the header, as the format's own library reads them."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: c.pixels.copy() for name, c in file.channels().items()}, dict(file.header())


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("compression", ["zip", "zips", "piz", "rle", "none", "b44", "b44a"])
def test_exr_files_in_another_reader(
    featured: ph.Image, tmp_path: Path, compression: str, tiled: bool
) -> None:
    file = tmp_path / "a.exr"
    bits = 32 if compression in ("piz", "b44") else 16
    featured.save(file, bits=bits, compression=compression, tiled=tiled)
    channels, header = read_by_openexr(file)
    assert (
        str(header["compression"])
        == f"Compression.{compression.upper().replace('NONE', 'NO')}_COMPRESSION"
    )
    tiles = header.get("tiles")
    assert (tiles is not None) == tiled
    if tiled:
        assert (tiles.xSize, tiles.ySize) == (64, 64)  # type: ignore[attr-defined]
    assert set(channels) == {*"RGB", *(name for names in CHANNELS.values() for name in names)}
    for layer, names in {"": tuple("RGB"), **CHANNELS}.items():
        values = featured.features[layer] if layer else featured.pixels
        values = values.reshape(150, 40, -1)
        for k, name in enumerate(names):
            exact = bits == 32 or layer in PRECISE
            assert channels[name].dtype == (np.float32 if exact else np.float16)
            expected = values[..., k].astype(channels[name].dtype)
            if compression == "b44a" and not exact:  # blocks of 4x4 share an exponent
                assert np.abs(channels[name] - expected).mean() < 0.02
            else:
                np.testing.assert_array_equal(channels[name], expected, err_msg=name)
    for layer in cryptomatte.LAYERS:
        key = f"cryptomatte/{cryptomatte.matte_id(layer):08x}"[:-1]
        assert header[f"{key}/name"] == layer
        assert "ground" in json.loads(str(header[f"{key}/manifest"]))


@pytest.mark.parametrize(("compression", "most"), [("pxr24", 1e-4), ("dwaa", 0.05), ("dwab", 0.05)])
def test_exr_files_that_are_not_exact(
    image: ph.Image, tmp_path: Path, compression: str, most: float
) -> None:
    for tiled in (False, True):
        image.save(tmp_path / "a.exr", compression=compression, tiled=tiled)
        channels, header = read_by_openexr(tmp_path / "a.exr")
        assert compression.upper() in str(header["compression"])
        error = np.stack([channels[c] for c in "RGB"], axis=-1) - image.pixels
        assert 0 < np.abs(error).max() < most
    told = f"{compression} would change the ids of Cryptomattes .choices: zip, zips"
    with pytest.raises(ph.SceneError, match=told):
        check_output(tmp_path / "b.exr", features=True, compression=compression)


@pytest.mark.parametrize(
    ("name", "how", "told"),
    [
        ("a.png", {"compression": "zip"}, "compression is for .exr"),
        ("a.exr", {"compression": "zpi"}, "unknown compression 'zpi'; did you mean 'zip'"),
        ("a.jpg", {"tiled": True}, r"\.jpg has no tiles"),
    ],
)
def test_what_only_exr_files_have(
    image: ph.Image, tmp_path: Path, name: str, how: dict[str, object], told: str
) -> None:
    with pytest.raises(ph.SceneError, match=told):
        image.save(tmp_path / name, **how)  # type: ignore[arg-type]
    with pytest.raises(ph.SceneError, match=r"is for \.exr"):
        ph.save_sequence([image], tmp_path / "a.mp4", compression="zip")
    assert not list(tmp_path.iterdir())


def test_other_files_have_no_room_for_features(featured: ph.Image, tmp_path: Path) -> None:
    featured.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png")[0], featured.srgb())
    check_output(tmp_path / "a.exr", features=True)
    with pytest.raises(ph.SceneError, match=r"\.png cannot hold features \(choices: \.exr\)"):
        check_output(tmp_path / "a.png", features=True)


def test_features_are_written_a_few_rows_at_a_time() -> None:
    noise = np.random.default_rng(5)
    data = noise.random((700, 300, 3), np.float32)
    layers = {name: noise.random((700, 300, len(c)), np.float32) for name, c in CHANNELS.items()}
    tracemalloc.start()
    content = encoded(data, {}, ".exr", layers)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    stacked = data.nbytes + sum(values.nbytes for values in layers.values())
    assert len(content) > 0.5 * stacked
    assert most < len(content) + 0.4 * stacked


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 1)])
@pytest.mark.parametrize("ending", ENDINGS)
def test_the_smallest_pictures(
    image: ph.Image, tmp_path: Path, ending: str, size: tuple[int, int]
) -> None:
    picture = painted(image, np.full((*size, 3), 0.25))
    picture.save(tmp_path / f"a.{ending}")
    assert read_picture(tmp_path / f"a.{ending}")[0].shape == (*size, 3)


@pytest.mark.parametrize(
    ("ending", "dtype"),
    [
        ("png", np.uint8),
        ("png", np.uint16),
        ("jpg", np.uint8),
        ("exr", np.float32),
        ("exr", np.float16),
    ],
)
def test_noise_that_can_not_be_compressed(tmp_path: Path, ending: str, dtype: type) -> None:
    # whether a file of this size may be written is found out before the writer begins
    size = np.dtype(dtype).itemsize
    noise = np.random.default_rng(3).bytes(400 * 300 * 3 * size)
    data = np.frombuffer(noise, dtype).reshape(300, 400, 3)
    metadata = {"key": "value" * 1000}
    content = encoded(data, metadata, f".{ending}")
    assert len(content) <= largest_file(data, metadata)
    (tmp_path / f"a.{ending}").write_bytes(content)
    pixels, _ = read_picture(tmp_path / f"a.{ending}")
    if ending == "jpg":
        assert np.corrcoef(pixels.ravel(), data.ravel())[0, 1] > 0.5
    else:
        assert pixels.tobytes() == noise


def test_a_notebook_gets_a_png(image: ph.Image, tmp_path: Path) -> None:
    content = image._repr_png_()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    (tmp_path / "a.png").write_bytes(content)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png")[0], image.srgb())


# --- Metadata ------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ENDINGS)
def test_metadata(image: ph.Image, tmp_path: Path, ending: str) -> None:
    image.save(tmp_path / f"a.{ending}")
    _, attributes = read_picture(tmp_path / f"a.{ending}")
    told = json.loads(attributes["ImageDescription"])
    if ending != "jpg":  # JPEG has room for the description alone
        for key, value in told.items():
            assert attributes[key] == value, key
    assert attributes["Software"] == f"Parhelion {ph.__version__}"
    assert told["parhelion:version"] == ph.__version__
    assert told["parhelion:scene"] == flatten(ph.weekend()).sha256()
    assert told["parhelion:seed"] == "5"
    assert told["parhelion:spp"] == "2"
    assert told["parhelion:samples"] == str(48 * 27 * 2)
    assert told["parhelion:complete"] == "true"
    assert told["parhelion:threads"] == "2"
    assert float(told["parhelion:seconds"]) == pytest.approx(image.stats.seconds, abs=6e-4)
    age = datetime.now(timezone.utc) - datetime.fromisoformat(told["parhelion:time"])
    assert timedelta(seconds=-1) <= age < timedelta(minutes=5)
    camera = json.loads(told["parhelion:camera"])
    assert camera == {
        "eye": [13, 2, 3],
        "target": [0, 0, 0],
        "up": [0, 1, 0],
        "fov": None,
        "vfov": 20,
        "aperture_radius": 0.0523604,
        "focus_distance": 10,
        "projection": "perspective",
        "height": None,
        "shift": [0, 0],
        "mirrored": False,
    }
    settings = json.loads(told["parhelion:settings"])
    assert (settings["width"], settings["height"], settings["sampler"]) == (48, 27, "sobol")


def test_the_metadata_make_the_same_picture_again(tmp_path: Path) -> None:
    scene = ph.weekend().replace(camera=None)
    flat = ph.Camera(
        (3, 4, 9), projection="orthographic", height=np.float32(6), shift=np.ones(2), mirrored=True
    )
    for camera in (None, flat):
        first = ph.render(
            scene,
            camera=camera,
            width=40,
            spp=3,
            filter_radius=np.float32(1.25),
            crop=[3, 2, 30, 9],
            integrator="ao",
            ao_distance=2.5,
        )
        first.save(tmp_path / "a.exr")
        pixels, told = read_picture(tmp_path / "a.exr")
        camera = ph.Camera(**json.loads(told["parhelion:camera"]))
        again = ph.render(scene, camera=camera, **json.loads(told["parhelion:settings"]))
        np.testing.assert_array_equal(again.numpy(), pixels)


def test_arrays_in_a_camera_are_written_too(tmp_path: Path) -> None:
    camera = ph.Camera(eye=np.array([0, 0, 4], np.float32), vfov=np.float64(30))
    ph.render(ph.weekend(), camera=camera, width=8, spp=1).save(tmp_path / "a.png")
    _, told = read_picture(tmp_path / "a.png")
    assert json.loads(told["parhelion:camera"])["eye"] == [0, 0, 4]


SPHERES = ph.Spheres([[0, 0, 0], [3, 0, 0]], [1.0, 2.0], "a", [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
SEEN = ph.Scene(
    [SPHERES],
    {"a": ph.Material("metal", fuzz=0.5), "b": ph.Material("diffuse")},
    background=ph.Background("gradient", zenith=(0.1, 0.2, 0.3)),
)


@pytest.mark.parametrize(
    "other",
    [
        SEEN.replace(shapes=[replace(SPHERES, centers=[[0, 0, 0], [3, 0, 1e-7]])]),
        SEEN.replace(shapes=[replace(SPHERES, centers=[[3, 0, 0], [0, 0, 0]])]),
        SEEN.replace(shapes=[replace(SPHERES, radii=[1.0, 2.5])]),
        SEEN.replace(shapes=[replace(SPHERES, radii=1.0)]),
        SEEN.replace(shapes=[replace(SPHERES, material="b")]),
        SEEN.replace(shapes=[replace(SPHERES, material=[0, 1])]),
        SEEN.replace(shapes=[replace(SPHERES, colors=None)]),
        SEEN.replace(shapes=[replace(SPHERES, colors=np.full((2, 3), 0.5))]),
        SEEN.replace(shapes=[SPHERES, SPHERES]),
        SEEN.replace(shapes=[]),
        SEEN.replace(materials=SEEN.materials | {"a": ph.Material("metal", fuzz=0.25)}),
        SEEN.replace(materials=SEEN.materials | {"a": ph.Material("dielectric")}),
        SEEN.replace(background=ph.Background("gradient", zenith=(0.1, 0.2, 0.4))),
        SEEN.replace(background=ph.Background("constant")),
    ],
)
def test_the_scene_hash_tells_what_is_seen_apart(other: ph.Scene) -> None:
    assert flatten(other).sha256() != flatten(SEEN).sha256()


@pytest.mark.parametrize(
    "same",
    [
        SEEN.replace(camera=ph.Camera(eye=(9, 9, 9))),
        SEEN.replace(settings=ph.Settings(width=7, seed=8)),
        SEEN.replace(name="another name"),
        SEEN.replace(shapes=[replace(SPHERES, centers=np.array(SPHERES.centers, float))]),
        SEEN.replace(shapes=(replace(SPHERES, radii=np.array([1, 2], np.int8)),)),
    ],
)
def test_the_scene_hash_looks_at_nothing_else(same: ph.Scene) -> None:
    assert flatten(same).sha256() == flatten(SEEN).sha256()


# --- Files stay whole ----------------------------------------------------------------------------


def full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    "broken", [(Path, "write_bytes"), (os, "replace"), (os, "fsync"), (os, "chmod")]
)
@pytest.mark.parametrize("ending", ENDINGS)
def test_the_old_file_is_whole_when_writing_fails(
    image: ph.Image,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    ending: str,
    broken: tuple[object, str],
) -> None:
    file = tmp_path / f"a.{ending}"
    image.save(file)
    before = file.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(*broken, full)
        with pytest.raises(ph.ResourceError, match="cannot be written: No space left") as error:
            image.save(file)
    assert str(error.value).startswith(str(file))
    assert file.read_bytes() == before
    assert os.listdir(tmp_path) == [file.name]


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_writer_s_own_failure_is_told(
    image: ph.Image, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    import OpenImageIO as oiio

    file = tmp_path / f"a.{ending}"
    file.write_bytes(b"old")
    monkeypatch.setattr(oiio.ImageOutput, "write_image", lambda *_: False)
    monkeypatch.setattr(oiio.ImageOutput, "geterror", lambda *_: "out of ink")
    with pytest.raises(ph.ResourceError, match="cannot be written: out of ink"):
        image.save(file)
    assert file.read_bytes() == b"old"
    assert os.listdir(tmp_path) == [file.name]


def test_ctrl_c_while_writing_leaves_the_old_file(
    image: ph.Image, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    file = tmp_path / "a.png"
    file.write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        image.save(file)
    assert file.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.png"]


def test_a_link_is_followed(image: ph.Image, tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "real.png").write_bytes(b"old")
    (tmp_path / "link.png").symlink_to(folder / "real.png")
    (tmp_path / "new.png").symlink_to(folder / "not yet.png")
    for link, target in (("link.png", "real.png"), ("new.png", "not yet.png")):
        image.save(tmp_path / link)
        assert (tmp_path / link).is_symlink()
        assert read_picture(folder / target)[0].shape == (27, 48, 3)
    assert sorted(os.listdir(folder)) == ["not yet.png", "real.png"]


def test_permissions_are_kept_and_new_files_have_the_usual_ones(
    image: ph.Image, tmp_path: Path
) -> None:
    file = tmp_path / "a.png"
    old_mask = os.umask(0o027)
    try:
        image.save(file)
        assert stat.S_IMODE(file.stat().st_mode) == 0o640
        file.chmod(0o604)
        image.save(file)
        assert stat.S_IMODE(file.stat().st_mode) == 0o604
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(old_mask)


def test_a_device_is_written_to_not_replaced(image: ph.Image, tmp_path: Path) -> None:
    link = tmp_path / "null.png"
    link.symlink_to(os.devnull)
    image.save(link)
    assert not stat.S_ISREG(os.stat(os.devnull).st_mode)
    assert os.listdir(tmp_path) == ["null.png"]


def test_replacing_writes_nothing_when_the_block_fails(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("old")

    def fail() -> None:
        with atomic.replacing(file) as temporary:
            assert (temporary.parent, temporary.suffix) == (tmp_path, ".txt")
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert file.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize(
    ("name", "bits", "error", "told"),
    [
        ("a.png", 32, ph.SceneError, r"\.png cannot hold 32 bits a channel \(choices: 8, 16\)"),
        ("a.jpg", 16, ph.SceneError, r"\.jpg cannot hold 16 bits"),
        ("a.exr", 8, ph.SceneError, r"\.exr cannot hold 8 bits a channel \(choices: 32, 16\)"),
        ("a.pgn", None, ph.SceneError, r"unknown picture ending '\.pgn'; did you mean '\.png'\?"),
        ("a", None, ph.SceneError, r"unknown picture ending ''"),
        ("no/a.png", None, ph.ResourceError, "there is no folder"),
        ("folder.png", None, ph.ResourceError, "is a folder"),
        ("a\0.png", None, ph.ResourceError, "cannot be written: embedded null"),
        ("a" * 300 + ".png", None, ph.ResourceError, "cannot be written: File name too long"),
    ],
)
def test_names_that_can_not_be_written(
    image: ph.Image, tmp_path: Path, name: str, bits: int | None, error: type, told: str
) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(error, match=told):
        image.save(tmp_path / name, bits=bits)
    assert os.listdir(tmp_path) == ["folder.png"]


def test_how_long_writing_will_take() -> None:
    few, many = (seconds_to_encode("a.exr", True, pixels) for pixels in (1, 10**7))
    assert 0 < few < many < 1000
    assert 0 < seconds_to_encode("a.png", False, 10**6) < 100
