"""The JSON scene format: what it means, what it refuses and in which words, and its schema."""

from __future__ import annotations

import bz2
import copy
import gzip
import json
import lzma
import os
import pickle
import re
import runpy
import struct
import time
from dataclasses import fields
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import parhelion as ph
from conftest import REPOSITORY
from parhelion import tables
from parhelion.flatten import flatten
from parhelion.io import LoadOptions, json_scene

VALID: dict[str, Any] = {
    "parhelion": 1,
    "$schema": "scene.schema.json",
    "name": "all there is",
    "camera": {
        "eye": [3, 2, 6],
        "target": [0, 1, 0],
        "up": [0, 1, 0],
        "vfov": 30,
        "aperture_radius": 0.1,
        "focus_distance": 6.5,
    },
    "background": {"type": "gradient", "horizon": [1, 1, 1], "zenith": [0.5, 0.7, 1]},
    "materials": {
        "brass": {"type": "metal", "color": [0.8, 0.6, 0.3], "fuzz": 0.25},
        "clear glass": {"type": "dielectric", "ior": 1.5},
        "lamp": {"type": "emissive", "radiance": [4, 5, 6]},
    },
    "shapes": [
        {"type": "spheres", "centers": [[0, -1000, 0]], "radii": 1000, "name": "ground"},
        {
            "type": "spheres",
            "centers": [[0, 1, 0], [2, 1, 0], [4, 1, 0.5]],
            "radii": [1, 0.5, 0.25],
            "material": ["clear glass", "brass", "clear glass"],
            "colors": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        },
        {"type": "spheres", "centers": [[0, 9, 0]], "material": "lamp"},
        {
            "type": "spheres",
            "centers": [[0, 0, 0]],
            "material": {"type": "diffuse", "color": [0, 0.5, 1]},
            "colors": None,
        },
    ],
    "settings": {
        "width": 320,
        "height": 180,
        "spp": 16,
        "max_depth": 8,
        "seed": 2**63 - 1,
        "sampler": "independent",
        "filter": "tent",
        "filter_radius": 1.25,
        "roulette": False,
        "crop": [0, 10, 100, 50],
    },
}
ONE = {"type": "spheres", "centers": [[0, 0, 0]]}


def read(folder: Path, document: Any, options: LoadOptions | None = None) -> ph.Scene:
    """Loads a document, or the bytes or text of one, as the file scene.json."""
    if isinstance(document, str):
        document = document.encode()
    if not isinstance(document, bytes):
        document = json.dumps(document).encode()
    file = folder / "scene.json"
    file.write_bytes(document)
    from parhelion.io import load

    return load(file, options)


def refusal(folder: Path, document: Any) -> str:
    """The error's text behind the path."""
    with pytest.raises(ph.FormatError) as caught:
        read(folder, document)
    start = f"{folder / 'scene.json'}: "
    assert str(caught.value).startswith(start)
    assert len(str(caught.value)) < len(start) + 1000
    return str(caught.value)[len(start) :]


def with_shape(**members: Any) -> dict[str, Any]:
    return {"parhelion": 1, "shapes": [ONE | members]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


# ------------------------------------------------------------------------------- what it means


def test_every_field_arrives(folder: Path) -> None:
    scene = read(folder, VALID)
    assert scene.name == "all there is"
    assert scene.camera == ph.Camera(
        eye=(3, 2, 6),
        target=(0, 1, 0),
        vfov=30,
        aperture_radius=0.1,
        focus_distance=6.5,
    )
    assert scene.background == ph.Background("gradient", horizon=(1, 1, 1), zenith=(0.5, 0.7, 1))
    assert list(scene.materials) == ["brass", "clear glass", "lamp"]
    assert scene.materials["brass"] == ph.Material("metal", color=(0.8, 0.6, 0.3), fuzz=0.25)
    assert scene.settings == ph.Settings(
        width=320,
        height=180,
        spp=16,
        max_depth=8,
        seed=2**63 - 1,
        sampler="independent",
        filter="tent",
        filter_radius=1.25,
        roulette=False,
        crop=(0, 10, 100, 50),
    )
    ground, three, lamp, inline = scene.shapes
    assert (ground.name, ground.radii, ground.material) == ("ground", 1000, ph.Material("diffuse"))
    np.testing.assert_array_equal(three.centers, [[0, 1, 0], [2, 1, 0], [4, 1, 0.5]])
    np.testing.assert_array_equal(three.radii, [1, 0.5, 0.25])
    np.testing.assert_array_equal(three.material, [1, 0, 1])
    np.testing.assert_array_equal(three.colors, np.eye(3))
    assert lamp.material == "lamp"
    assert inline.material == ph.Material("diffuse", color=(0, 0.5, 1))
    assert inline.colors is None
    flatten(scene)


def test_defaults_are_those_of_the_dataclasses(folder: Path) -> None:
    scene = read(folder, {"parhelion": 1, "camera": {}, "shapes": [ONE]})
    assert scene.camera == ph.Camera()
    assert scene.settings == ph.Settings()
    assert scene.background == ph.Scene().background
    assert scene.name == "scene"  # the file's
    shape, plain = scene.shapes[0], ph.Spheres([[0, 0, 0]])
    assert (shape.radii, shape.material, shape.colors, shape.name) == (
        plain.radii,
        plain.material,
        plain.colors,
        plain.name,
    )
    assert read(folder, {"parhelion": 1}).camera is None


@pytest.mark.parametrize(
    ("block", "dataclass"),
    [
        (json_scene.Camera, ph.Camera),
        (json_scene.Settings, ph.Settings),
        (json_scene.Spheres, ph.Spheres),
        (json_scene.Document, ph.Scene),
    ],
)
def test_every_field_of_the_dataclasses_has_its_name_here(block: Any, dataclass: Any) -> None:
    missing = {f.name for f in fields(dataclass)} - set(block.__struct_encode_fields__)
    assert missing == set()


def test_numbers_arrive_as_written(folder: Path) -> None:
    scene = read(folder, with_shape(centers=[[0.1, 1e-300, -3e38]], radii=1e16))
    assert np.asarray(scene.shapes[0].centers).tolist() == [[0.1, 1e-300, -3e38]]
    assert scene.shapes[0].radii == 1e16


def test_a_byte_order_mark_is_skipped(folder: Path) -> None:
    assert read(folder, b'\xef\xbb\xbf{"parhelion": 1}').shapes == ()


@pytest.mark.parametrize(
    ("ending", "pack"), [("gz", gzip.compress), ("bz2", bz2.compress), ("xz", lzma.compress)]
)
def test_packed_scenes(tmp_path: Path, ending: str, pack: Any) -> None:
    file = tmp_path / f"small.json.{ending}"
    packed = pack(json.dumps(VALID | {"name": None}).encode())
    file.write_bytes(packed)
    assert len(ph.load(file).shapes) == 4
    assert ph.load(file).name == "small"
    for broken in (packed[:-12], packed[: len(packed) // 2], b"no", packed[:20] + packed[30:]):
        file.write_bytes(broken)
        with pytest.raises(ph.FormatError, match=rf"small\.json\.{ending}: "):
            ph.load(file)


def test_many_spheres_are_fast(folder: Path) -> None:
    rng = np.random.default_rng(1)
    names = np.array(["brass", "glass: clear"], dtype=object)[rng.integers(0, 2, 200_000)]
    document = {
        "parhelion": 1,
        "materials": {"brass": {"type": "metal"}, "glass: clear": {"type": "dielectric"}},
        "shapes": [ONE | {"centers": rng.normal(size=(200_000, 3)).tolist(), "material": [*names]}],
    }
    text = json.dumps(document)
    start = time.perf_counter()
    scene = read(folder, text)
    assert time.perf_counter() - start < 5  # some 0.2 s; a Python loop over numbers takes longer
    np.testing.assert_array_equal(scene.shapes[0].centers, document["shapes"][0]["centers"])
    np.testing.assert_array_equal(scene.shapes[0].material, names == "glass: clear")


def test_options_for_particles_are_refused(folder: Path) -> None:
    with pytest.raises(ph.FormatError, match="the option 'color_by' is for particle files"):
        read(folder, VALID, LoadOptions(color_by="charge"))


# ----------------------------------------------------------------------------- what it refuses

FIELD = "(choices: centers, colors, material, name, radii, type)"
BAD_TEXTS = {
    b"": "is empty",
    b" \n": "is empty",
    b"\xef\xbb\xbf": "is empty",
    b"{": "line 1, column 2: the JSON text is not complete",
    b'{"parhelion": 1,\n  "name": "a': "line 2, column 13: the JSON text is not complete",
    b'{"parhelion": 1,\n"name": "\xc3\xa9", x}': ("line 2, column 14: object keys must be strings"),
    b'{"parhelion": 1} x': "line 1, column 18: trailing characters",
    b'{"parhelion": 1,}': "line 1, column 17: trailing comma in object",
    b'{"parhelion": 1, "name": "\xe9"}': "line 1, column 27: is not UTF-8 text",
    b'\n{"parhelion": 1, "name": "\xed\xa0\x80"}': "line 2, column 27: is not UTF-8 text",
    '{"parhelion": 1}'.encode("utf-16"): "is UTF-16 text; save it as UTF-8",
    b'{"parhelion": 1, "name": NaN}': "line 1, column 26: NaN is no JSON number",
    b'{"parhelion": 1, "name": Infinity}': "line 1, column 26: Infinity is no JSON number",
    b'{"parhelion": 1, "camera": {"fov": -Infinity}}': "line 1, column 37: Infinity is no JSON",
    b'{"parhelion": 1, "camera": {"fov": 1e999}}': "$.camera.fov: a number is too large",
    b'{"parhelion": 1, "settings": {"spp": ' + b"9" * 5000 + b"}}": (
        "$.settings.spp: a number is too large"
    ),
    b'{"parhelion": 1, "materials": {"m": {"type": "metal", "fuzz": 1e999}}}': (
        "$.materials.m: parameter 'fuzz' is inf; must lie in [0, 1]"
    ),
    b'{"parhelion": 1, "settings": {"spp": "4", "seed": x}}': (
        "line 1, column 51: invalid character"
    ),
    b'{"parhelion": 1,\n "parhelion": 1}': (
        "line 2, column 2: the key 'parhelion' occurs twice in its object"
    ),
    b'{"parhelion": 1, "materials": {\n"a\xc3\xa9": {"type": "metal"},\n'
    b' "b": {"type": "metal"}, "\\u0061\xc3\xa9": {"type": "metal"}}}': (
        "line 3, column 26: the key 'aé' occurs twice"
    ),
    b"[" * 20_000: "is nested too deeply",
    b'{"parhelion": 1, "materials": {"a": ' + b"[" * 20_000: "is nested too deeply",
    b'{"parhelion": 1, "materials": {"a": ' + b"[" * 20_000 + b"]" * 20_000 + b"}}": (
        "is nested too deeply"
    ),
    b'{"a":' * 20_000: "$.a: unknown field 'a'",
    b"\0" * 100: "line 1, column 1: invalid character",
}
BAD_DOCUMENTS: list[tuple[Any, str]] = [
    ([1, 2], "$: is [1,2]; must be an object"),
    ({}, "$: the field 'parhelion' is missing"),
    ({"parhelion": 2}, "$.parhelion: is 2; this version of Parhelion reads format 1"),
    ({"parhelion": True}, "$.parhelion: is true; must be an integer"),
    ({"parhelion": 1, "$schema": 1}, "$.$schema: is 1; must be a string or null"),
    ({"parhelion": 1, "shape": []}, "$.shape: unknown field 'shape'; did you mean 'shapes'?"),
    ({"parhelion": 1, "a b": []}, "$['a b']: unknown field 'a b'"),
    ({"parhelion": 1, "name": "x" * 2000}, '$.name: is "xxx'),
    # camera
    ({"parhelion": 1, "camera": {"fov": 40, "vfov": 40}}, "$.camera: has both 'fov' and 'vfov'"),
    ({"parhelion": 1, "camera": {"fov": 180}}, "$.camera.fov: is 180; must be a number < 180"),
    ({"parhelion": 1, "camera": {"vfov": 0}}, "$.camera.vfov: is 0; must be a number > 0"),
    ({"parhelion": 1, "camera": {"fovv": 40}}, "$.camera.fovv: unknown field 'fovv'; did you mean"),
    ({"parhelion": 1, "camera": {"eye": [1, 2]}}, "$.camera.eye: is [1,2]; must be an array of"),
    ({"parhelion": 1, "camera": {"eye": [1, 2, 1e39]}}, "$.camera.eye[2]: is 1e39; must be a numb"),
    ({"parhelion": 1, "camera": {"aperture_radius": -1}}, "$.camera.aperture_radius: is -1; must"),
    ({"parhelion": 1, "camera": {"focus_distance": 0}}, "$.camera.focus_distance: is 0; must be"),
    # settings
    ({"parhelion": 1, "settings": {"width": 0}}, "$.settings.width: is 0; must be an integer >= 1"),
    ({"parhelion": 1, "settings": {"spp": 4.0}}, "$.settings.spp: is 4.0; must be an integer"),
    ({"parhelion": 1, "settings": {"spp": 2**31}}, "must be an integer <= 2147483647"),
    ({"parhelion": 1, "settings": {"spp": "4"}}, '$.settings.spp: is "4"; must be an integer'),
    ({"parhelion": 1, "settings": {"seed": -1}}, "$.settings.seed: is -1; must be an integer >= 0"),
    ({"parhelion": 1, "settings": {"roulette": 1}}, "must be true or false"),
    ({"parhelion": 1, "settings": {"crop": [0, 0, 0, 1]}}, "$.settings.crop[2]: is 0; must be an"),
    (
        {"parhelion": 1, "settings": {"sampler": "sobl"}},
        "$.settings.sampler: unknown sampler 'sobl'; did you mean 'sobol'?",
    ),
    (
        {"parhelion": 1, "settings": {"filter": "gauss"}},
        "$.settings.filter: unknown filter 'gauss'; did you mean 'gaussian'?",
    ),
    (
        {"parhelion": 1, "settings": {"max_dept": 1}},
        "$.settings.max_dept: unknown field 'max_dept'; did you mean 'max_depth'?",
    ),
    # materials and background
    ({"parhelion": 1, "background": None}, "$.background: must be an object with a 'type'"),
    (
        {"parhelion": 1, "background": {"type": "sky"}},
        "$.background: unknown background type 'sky'",
    ),
    (
        {"parhelion": 1, "background": {"type": "constant", "radiance": [1, -1, 1]}},
        "$.background: parameter 'radiance'[1] is -1; must lie in [0, 1e+12]",
    ),
    (
        {"parhelion": 1, "materials": {"old steel": "metal"}},
        "$.materials['old steel']: must be an object with a 'type'",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"color": [1, 1, 1]}}},
        "$.materials.steel: the field 'type' is missing",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": ["metal"]}}},
        "$.materials.steel: unknown material type",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "mettal"}}},
        "$.materials.steel: unknown material type 'mettal'; did you mean 'metal'?",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "fuz": 1}}},
        "$.materials.steel: unknown parameter 'fuz'; did you mean 'fuzz'? (choices: color, fuzz)",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "fuzz": 2}}},
        "$.materials.steel: parameter 'fuzz' is 2; must lie in [0, 1]",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "fuzz": [0.5]}}},
        "$.materials.steel: parameter 'fuzz' is [0.5]; must be a number",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "fuzz": True}}},
        "$.materials.steel: parameter 'fuzz' is True; must be a number",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "fuzz": 10**400}}},
        "$.materials.steel: parameter 'fuzz' is a huge integer; must lie in [0, 1]",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "color": 0.5}}},
        "$.materials.steel: parameter 'color' is 0.5; must be 3 numbers",
    ),
    (
        {"parhelion": 1, "materials": {"steel": {"type": "metal", "color": [1, 1]}}},
        "$.materials.steel: parameter 'color' has 2 values; must be 3 numbers",
    ),
    # shapes
    ({"parhelion": 1, "shapes": [{"centers": [[0, 0, 0]]}]}, "$.shapes[0]: the field 'type' is mi"),
    ({"parhelion": 1, "shapes": [{"type": "spheres"}]}, "$.shapes[0]: the field 'centers' is miss"),
    (with_shape(type="sphere"), "$.shapes[0].type: unknown shape type 'sphere'; did you mean 'sph"),
    (with_shape(type=5), "$.shapes[0].type: is 5; must be a string"),
    (
        with_shape(centres=[]),
        "$.shapes[0].centres: unknown field 'centres'; did you mean 'centers'",
    ),
    (with_shape(centers=[]), "$.shapes[0].centers: is []; must be an array of length >= 1"),
    (with_shape(centers=5), "$.shapes[0].centers: is 5; must be a string or an array"),
    (
        with_shape(centers=[[0, 0]]),
        "$.shapes[0].centers[0]: is [0,0]; must be an array of length 3",
    ),
    (with_shape(centers=[[0, 0, "1"]]), '$.shapes[0].centers[0][2]: is "1"; must be a number'),
    (with_shape(centers=[[0, 0, None]]), "$.shapes[0].centers[0][2]: is null; must be a number"),
    (with_shape(radii=-1), "$.shapes[0].radii: is -1; must be a number > 0"),
    (with_shape(radii=0), "$.shapes[0].radii: is 0; must be a number > 0"),
    (with_shape(radii=[]), "$.shapes[0].radii: has 0 values for 1 centers"),
    (with_shape(radii=[1, 2]), "$.shapes[0].radii: has 2 values for 1 centers"),
    (with_shape(radii=[1] * 17 + [-1]), "$.shapes[0].radii[17]: is -1; must be a number > 0"),
    (
        with_shape(radii="big"),
        "$.shapes[0].radii: is 'big'; must be an array or the name of a .npy",
    ),
    (with_shape(colors=[[0, 0, -1]]), "$.shapes[0].colors[0][2]: is -1; must be a number >= 0"),
    (with_shape(colors=[]), "$.shapes[0].colors: has 0 values for 1 centers"),
    (with_shape(material=[]), "$.shapes[0].material: has 0 values for 1 centers"),
    (with_shape(material={"type": "x"}), "$.shapes[0].material: unknown material type 'x'"),
    (
        with_shape(material="glss", name="bunny") | {"materials": {"glass": {"type": "diffuse"}}},
        "$.shapes[0].material: shape 'bunny': unknown material 'glss'; did you mean 'glass'?",
    ),
    (
        with_shape(centers=[[0, 0, 0]] * 3, material=["glass", "glss", "gls"])
        | {"materials": {"glass": {"type": "diffuse"}}},
        "$.shapes[0].material[1]: shape 'spheres': unknown material 'glss'; did you mean 'glass'?",
    ),
    (
        with_shape(material="z")
        | {"materials": {f"m{i}": {"type": "diffuse"} for i in range(3000)}},
        "unknown material 'z'; none of the 3000 is called that",
    ),
]


@pytest.mark.parametrize(
    ("text", "words"),
    [*BAD_TEXTS.items(), *BAD_DOCUMENTS],
    ids=lambda value: value[:40] if isinstance(value, str) else "",
)
def test_refused_with_the_place_and_the_reason(folder: Path, text: Any, words: str) -> None:
    said = refusal(folder, text)
    assert said.startswith(words) if words[0] in "$l" else words in said, said


@pytest.mark.parametrize(
    ("before", "junk", "after"),
    [
        (b"", b"x", b""),
        (b"", b"9", b""),
        (b"", b"[", b""),
        (b'{"parhelion": 1, "', b"x", b'": 1}'),
        (b'{"parhelion": 1, "name": "', b":", b'"}'),
        (b'{"parhelion": 1, "camera": {"fov": 0.', b"1", b"}"),
        (b'{"parhelion": 1, "background": {"type": "', b"x", b'"}}'),
        (b'{"parhelion": 1, "background": {"type": "constant", "', b"x", b'": 1}}'),
    ],
    ids=["letters", "digits", "brackets", "key", "name", "fraction", "type", "parameter"],
)
def test_100_megabytes_of_junk_are_refused_soon(
    tmp_path: Path, before: bytes, junk: bytes, after: bytes
) -> None:
    start = time.perf_counter()
    refusal(tmp_path, before + junk * 100_000_000 + after)
    assert time.perf_counter() - start < 20  # about 1 s each on an idle machine
    (tmp_path / "scene.json").unlink()


def test_too_much_text_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_scene, "LARGEST_TEXT", 2**20)
    assert read(folder, b'{"parhelion": 1}'.ljust(2**20)).shapes == ()
    longer = b'{"parhelion": 1}'.ljust(2**20 + 1)
    assert refusal(folder, longer).startswith("is longer than 1 MiB")
    packed = folder / "packed.json.gz"
    packed.write_bytes(gzip.compress(longer))
    with pytest.raises(ph.FormatError, match=r"packed\.json\.gz: is longer than 1 MiB"):
        ph.load(packed)


def test_a_pipe_is_refused_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.json")
    with pytest.raises(ph.FormatError, match="is not a regular file"):
        ph.load(tmp_path / "pipe.json")


@pytest.mark.parametrize(
    "text",
    [
        '{"parhelion": 1, "name": "\\"parhelion\\": {", "materials": {"a:{}": {"type": "metal"}}}',
        '{"parhelion": 1, "name": ":", "materials": {"\\\\": {"type": "metal"}}}',
        '{"parhelion": 1, "materials": {"type": {"type": "metal"}, "name": {"type": "metal"}}}',
        '{"name": "\\\\\\"\\\\", "parhelion": 1, "materials": {"": {"type": "metal"}}}',
    ],
)
def test_keys_that_only_look_repeated(folder: Path, text: str) -> None:
    assert list(read(folder, text).materials) == list(json.loads(text)["materials"])


# ------------------------------------------------------------------------------------- arrays


def save(folder: Path, name: str, array: Any) -> str:
    np.save(folder / name, np.asarray(array))
    return name


@pytest.mark.parametrize(
    ("array", "dtype"),
    [
        (np.arange(6, dtype=np.float32).reshape(2, 3), np.float32),
        (np.arange(6, dtype=np.float64).reshape(2, 3), np.float64),
        (np.arange(6, dtype=">f8").reshape(2, 3), np.float64),
        (np.arange(6, dtype=np.float16).reshape(2, 3), np.float32),
        (np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.float64),
        (np.arange(6).reshape(2, 3), np.float64),
        (np.arange(6, dtype=np.uint8).reshape(2, 3), np.float64),
    ],
    ids=str,
)
def test_npy_centers(tmp_path: Path, array: Any, dtype: Any) -> None:
    (tmp_path / "data").mkdir()
    save(tmp_path, "data/c.npy", array)
    scene = read(tmp_path, with_shape(centers="data/c.npy"))
    centers = scene.shapes[0].centers
    assert isinstance(centers, np.ndarray)
    assert centers.dtype == dtype
    assert centers.flags.c_contiguous
    np.testing.assert_array_equal(centers, np.arange(6).reshape(2, 3))
    # the scene has its own copy: what happens to the file afterwards does not matter
    (tmp_path / "data/c.npy").write_bytes(b"")
    assert centers.sum() == 15


def test_npy_radii_and_colors(tmp_path: Path) -> None:
    document = with_shape(
        centers=[[0, 0, 0], [1, 1, 1]],
        radii=save(tmp_path, "r.npy", [1.0, 2.0]),
        colors=save(tmp_path, "c.npy", [[0, 0.5, 1], [1, 0, 0.25]]),
    )
    shape = read(tmp_path, document).shapes[0]
    np.testing.assert_array_equal(shape.radii, [1, 2])
    np.testing.assert_array_equal(shape.colors, [[0, 0.5, 1], [1, 0, 0.25]])


def npy_header(text: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


BAD_NPY = {
    "empty file": (b"", "is no valid .npy file"),
    "junk": (b"junk" * 100, "is no valid .npy file"),
    "header cut off": (npy_header("{'descr': '<f8', 'fortran_")[:-9], "is no valid .npy file"),
    "header broken": (npy_header("{'descr': '<f8', (((\n"), "is no valid .npy file"),
    "header of no array": (npy_header("[" * 500 + "\n"), "is no valid .npy file"),
    "more promised than there is": (
        npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3)}\n"),
        "is no valid .npy file",
    ),
    "negative size": (
        npy_header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3)}\n") + b"\0" * 24,
        "'x.npy' ",
    ),
    "a number": (np.float64(1.0), "'x.npy' has shape (); must be (N, 3)"),
    "one row": (np.zeros(3), "'x.npy' has shape (3,); must be (N, 3)"),
    "two columns": (np.zeros((4, 2)), "'x.npy' has shape (4, 2); must be (N, 3)"),
    "no rows": (np.zeros((0, 3)), "'x.npy' "),
    "truth values": (np.zeros((2, 3), bool), "'x.npy' holds bool; must be real numbers"),
    "complex": (np.zeros((2, 3), complex), "'x.npy' holds complex128; must be real numbers"),
    "text": (np.full((2, 3), "1"), "'x.npy' holds <U1; must be real numbers"),
    "fields": (np.zeros((2, 3), [("x", "f4")]), "must be real numbers"),
    "objects": (np.full((2, 3), {}), "is no valid .npy file"),
    "pickle": (pickle.dumps([1, 2, 3]), "is no valid .npy file"),
    "NaN": (np.array([[0, 0, 0], [0, np.nan, 0]]), "'x.npy': [1][1] is nan; must be >= -3.40282e"),
    "infinity": (np.array([[0, 0, np.inf]], "f4"), "'x.npy': [0][2] is inf; must be"),
    "too large": (np.array([[0, 0, -1e39]]), "'x.npy': [0][2] is -1e+39; must be"),
}


@pytest.mark.parametrize(("content", "words"), BAD_NPY.values(), ids=BAD_NPY)
def test_bad_npy(tmp_path: Path, content: Any, words: str) -> None:
    if isinstance(content, bytes):
        (tmp_path / "x.npy").write_bytes(content)
    else:
        np.save(tmp_path / "x.npy", content)
    said = refusal(tmp_path, with_shape(centers="x.npy"))
    assert said.startswith("$.shapes[0].centers: 'x.npy'")
    assert words in said


def test_bad_npy_radii_and_colors(tmp_path: Path) -> None:
    for zero in (np.array([1, 0.0]), np.array([1, 0], "f4"), np.array([1, 0])):
        np.save(tmp_path / "r.npy", zero)
        said = refusal(tmp_path, with_shape(centers=[[0, 0, 0]] * 2, radii="r.npy"))
        assert said.startswith("$.shapes[0].radii: 'r.npy': [1] is 0; must be > 0")
    np.save(tmp_path / "r.npy", np.ones((2, 1)))
    said = refusal(tmp_path, with_shape(radii="r.npy"))
    assert said.endswith("'r.npy' has shape (2, 1); must be (N,)")
    np.save(tmp_path / "r.npy", np.ones(2))
    assert "radii: has 2 values for 1 centers" in refusal(tmp_path, with_shape(radii="r.npy"))
    np.save(tmp_path / "c.npy", [[0, 0, -0.5]])
    said = refusal(tmp_path, with_shape(colors="c.npy"))
    assert said.startswith("$.shapes[0].colors: 'c.npy': [0][2] is -0.5; must be >= 0")


def test_npy_files_outside_the_folder_are_refused(tmp_path: Path) -> None:
    outside = tmp_path / "outside.npy"
    np.save(outside, np.zeros((1, 3)))
    inside = tmp_path / "scene"
    (inside / "sub").mkdir(parents=True)
    np.save(inside / "own.npy", np.zeros((1, 3)))
    (inside / "link.npy").symlink_to(outside)
    (inside / "up").symlink_to(tmp_path)
    (inside / "loop.npy").symlink_to("loop.npy")
    (inside / "folder.npy").mkdir()
    os.mkfifo(inside / "pipe.npy")
    for name in (
        "../outside.npy",
        "/outside.npy",
        "sub/../own.npy",
        "..\\outside.npy",
        "C:\\outside.npy",
        "C:outside.npy",
        "\\\\host\\share\\outside.npy",
        "link.npy",
        "up/outside.npy",
    ):
        said = refusal(inside, with_shape(centers=name))
        assert said == f"$.shapes[0].centers: {name!r} is not inside the scene's folder"
    for path in (outside, inside / "own.npy"):
        assert "is not inside the scene's folder" in refusal(inside, with_shape(centers=str(path)))
    for name in ("none.npy", "folder.npy", "pipe.npy", "sub/none.npy", "Own.npy"):
        said = refusal(inside, with_shape(centers=name))
        assert said == f"$.shapes[0].centers: {name!r}: no such file"
    for name in ("loop.npy", "a\0.npy", "x" * 5000 + ".npy"):
        said = refusal(inside, with_shape(centers=name))
        assert said.startswith("$.shapes[0].centers: ")
    # a link that stays inside is as good as a file, and the scene itself may be reached by a link
    (inside / "sub" / "same.npy").symlink_to(inside / "own.npy")
    read(inside, with_shape(centers="sub/same.npy"))
    (tmp_path / "elsewhere").symlink_to(inside)
    read(tmp_path / "elsewhere", with_shape(centers="own.npy"))


# ------------------------------------------------------------------------------------ the schema


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json_scene.schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_generated_documentation_is_up_to_date() -> None:
    outputs = runpy.run_path(str(REPOSITORY / "docs" / "generate.py"))["outputs"]()
    assert REPOSITORY / "docs" / "scene.schema.json" in outputs
    for path, text in outputs.items():
        assert path.read_text(encoding="utf-8") == text, f"run: python docs/generate.py ({path})"


def test_schema_knows_the_tables() -> None:
    definitions = json_scene.schema()["$defs"]
    for kind, name in (("materials", "Material"), ("backgrounds", "Background")):
        for entry, listed in zip(
            tables.tables()[kind].values(), definitions[name]["anyOf"], strict=True
        ):
            assert listed["properties"]["type"] == {"const": entry.name}
            assert list(listed["properties"])[1:] == [p.name for p in entry.params]
    assert definitions["Sampler"]["enum"] == list(tables.tables()["samplers"])


def test_schema_accepts_what_is_valid(validator: Any) -> None:
    validator.validate(VALID)
    validator.validate({"parhelion": 1})


# What no schema can say; every other error of BAD_DOCUMENTS is one that it finds too.
BEYOND_SCHEMA = re.compile(
    "has both 'fov'|values for|unknown material '|must be an array or the name|no such file|4.0"
)


@pytest.mark.parametrize(("document", "words"), BAD_DOCUMENTS, ids=str)
def test_schema_and_reader_refuse_the_same(
    folder: Path, validator: Any, document: Any, words: str
) -> None:
    if isinstance(document, dict) and document.get("shapes") == [ONE | {"radii": "big"}]:
        assert not validator.is_valid(document)
    else:
        beyond = BEYOND_SCHEMA.search(refusal(folder, document)) is not None
        assert validator.is_valid(document) == beyond, words


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path of every value inside a document, itself included."""
    items: Any = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    return [path, *(place for key, x in items for place in places(x, (*path, key)))]


# drawn as copies: a later mutation may reach into one
REPLACEMENTS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([0.5, -0.5, 181.5, 1e39, 10**30]),
    st.sampled_from(["", "brass", "metal", "x.npy", "spheres"]),
    st.just([]),
    st.lists(st.sampled_from([0, 0.25, 1, -1, "a", None]), max_size=4),
    st.just({}),
    st.sampled_from([{"type": "metal"}, {"type": "constant"}, {"parhelion": 1}]),
).map(copy.deepcopy)


@st.composite
def mutations(draw: st.DrawFn) -> Any:
    """VALID with one to three of its values replaced, removed or given a new member."""
    document = copy.deepcopy(VALID)
    for _ in range(draw(st.integers(1, 3))):
        *inner, last = draw(st.sampled_from(places(document)[1:]))
        parent = document
        for key in inner:
            parent = parent[key]
        what = draw(st.sampled_from(["replace", "replace", "remove", "add"]))
        if what == "replace":
            parent[last] = draw(REPLACEMENTS)
        elif what == "remove":
            del parent[last]
        elif isinstance(parent, dict):
            parent[draw(st.sampled_from(["type", "name", "radii", "fov", "zz"]))] = draw(
                REPLACEMENTS
            )
        else:
            parent.append(draw(REPLACEMENTS))
        if len(places(document)) == 1:
            break
    return document


QUICK = settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@QUICK
@given(document=mutations())
def test_mutated_documents(folder: Path, validator: Any, document: Any) -> None:
    """The reader loads or refuses them, and the schema judges alike."""
    try:
        read(folder, document)
        refused = ""
    except ph.FormatError as error:
        refused = str(error)
    if validator.is_valid(document):
        assert not refused or BEYOND_SCHEMA.search(refused), refused
    else:
        assert refused


# ---------------------------------------------------------------------------------- any text

TEXT = json.dumps(VALID).encode()
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.text() | st.sampled_from([*VALID, *VALID["camera"], *VALID["settings"], *ONE]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=20,
)


def loads_or_refuses(folder: Path, text: bytes) -> None:
    """Anything but a Scene or a FormatError fails the test."""
    try:
        said = read(folder, text)
    except ph.FormatError as error:
        said = str(error)
    assert isinstance(said, ph.Scene) or said.startswith(str(folder / "scene.json: "))


@QUICK
@given(st.data())
def test_damaged_text(folder: Path, data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(TEXT)))
    gone = data.draw(st.integers(0, 20))
    new = data.draw(
        st.binary(max_size=4)
        | st.sampled_from([b"NaN", b"1e999", b"-", b'"', b"{", b"}", b"[", b"\\", b"\\ud800", b":"])
    )
    loads_or_refuses(folder, TEXT[:at] + new + TEXT[at + gone :])
    loads_or_refuses(folder, TEXT[:at])


@QUICK
@given(st.binary())
def test_any_bytes(folder: Path, text: bytes) -> None:
    loads_or_refuses(folder, text)


@QUICK
@given(document=JSON, field=st.sampled_from([*VALID]))
def test_any_json(folder: Path, document: Any, field: str) -> None:
    loads_or_refuses(folder, json.dumps(document).encode())
    if isinstance(document, dict):
        loads_or_refuses(folder, json.dumps({"parhelion": 1} | document).encode())
    loads_or_refuses(folder, json.dumps(VALID | {field: document}).encode())


# ------------------------------------------------------------------------------- there and back

NUMBER = st.floats(-1e30, 1e30)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
LENGTH = st.floats(1e-30, 1e30)
SHARE = st.floats(0, 1)
COLOR = st.tuples(SHARE, SHARE, SHARE)
MATERIALS = st.one_of(
    st.builds(lambda c: ph.Material("diffuse", color=c), COLOR),
    st.builds(lambda c, f: ph.Material("metal", color=c, fuzz=f), COLOR, SHARE),
    st.builds(lambda i: ph.Material("dielectric", ior=i), st.floats(0.5, 3)),
    st.just(ph.Material("emissive")),
)
NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)


@st.composite
def scenes(draw: st.DrawFn) -> ph.Scene:
    materials = draw(st.dictionaries(NAMES, MATERIALS, min_size=1, max_size=3))
    dtype = draw(st.sampled_from([np.float32, np.float64]))

    def array(items: Any, count: int) -> Any:
        values = draw(st.lists(items, min_size=count, max_size=count))
        return draw(st.sampled_from([values, np.array(values, dtype)]))

    shapes = []
    for _ in range(draw(st.integers(0, 3))):
        count = draw(st.integers(1, 4))
        indices = st.integers(0, len(materials) - 1)
        shapes.append(
            ph.Spheres(
                centers=array(VECTOR, count),
                radii=draw(LENGTH) if draw(st.booleans()) else array(LENGTH, count),
                material=draw(
                    st.one_of(
                        st.sampled_from([*materials]),
                        MATERIALS,
                        st.lists(indices, min_size=count, max_size=count).map(np.array),
                    )
                ),
                colors=array(COLOR, count) if draw(st.booleans()) else None,
                name=draw(NAMES),
            )
        )
    angle = st.floats(0.1, 179)
    views = st.sampled_from([{}, {"fov": draw(angle)}, {"vfov": draw(angle)}])
    return ph.Scene(
        shapes=shapes,
        materials=materials,
        camera=draw(
            st.none()
            | st.builds(
                lambda eye, focus, view: ph.Camera(eye=eye, focus_distance=focus, **view),
                VECTOR,
                st.none() | LENGTH,
                views,
            )
        ),
        background=draw(
            st.builds(lambda c: ph.Background("gradient", zenith=c), COLOR)
            | st.just(ph.Background("constant"))
        ),
        settings=draw(
            st.builds(
                ph.Settings,
                width=st.integers(1, 65536),
                seed=st.integers(0, 2**63 - 1),
                sampler=st.sampled_from(["sobol", "independent"]),
                filter_radius=st.none() | st.floats(1e-30, 32),
                roulette=st.booleans(),
                crop=st.none() | st.just((1, 2, 3, 4)),
            )
        ),
        name=draw(NAMES.filter(bool)),
    )


def assert_equal(a: ph.Scene, b: ph.Scene) -> None:
    for field in ("name", "camera", "background", "settings"):
        assert getattr(a, field) == getattr(b, field)
    assert list(a.materials.items()) == list(b.materials.items())
    assert len(a.shapes) == len(b.shapes)
    for x, y in zip(a.shapes, b.shapes, strict=True):
        assert x.name == y.name
        for field in ("centers", "radii", "colors"):
            if getattr(x, field) is None:
                assert getattr(y, field) is None
            else:
                np.testing.assert_array_equal(getattr(x, field), getattr(y, field), strict=False)
        if isinstance(x.material, (str, ph.Material)):
            assert x.material == y.material
        else:
            np.testing.assert_array_equal(x.material, y.material)


@QUICK
@given(scene=scenes())
def test_a_written_scene_loads_as_the_same(folder: Path, validator: Any, scene: ph.Scene) -> None:
    text = json_scene.dumps(scene)
    again = read(folder, text)
    assert_equal(scene, again)
    assert validator.is_valid(json.loads(text))
    assert json_scene.dumps(again) == text


def test_the_built_in_scene_there_and_back(folder: Path) -> None:
    scene = ph.weekend()
    again = read(folder, json_scene.dumps(scene))
    assert_equal(scene, again)
    assert flatten(again).sha256() == flatten(scene).sha256()


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (
            ph.Spheres([[0, 0, np.nan]]),
            "is null; must be a number (as NaN and infinity are written)",
        ),
        (ph.Spheres([[0, 0, 0]], -1.0), "$.shapes[0].radii: is -1.0; must be a number > 0"),
        (ph.Spheres([[0, 0, 0]], [1.0, 2.0]), "has 2 values for 1 centers"),
        (ph.Spheres([[0, 0, 0]], material="a"), "unknown material 'a'"),
        (ph.Spheres([[0, 0, 0]], material=[0]), "must be whole numbers below 0"),
        (ph.Spheres([[0, 0, 0]], material=[0.5]), "must be whole numbers below 0"),
        (ph.Spheres("x.npy"), "centers must be numbers"),
        (ph.Spheres([[0, 0, object()]]), "object is not a number, text or array"),
    ],
)
def test_what_cannot_be_written(shape: Any, words: str) -> None:
    with pytest.raises(ph.SceneError, match=re.escape(words)):
        json_scene.dumps(ph.Scene(shapes=[shape]))


# -------------------------------------------------------------------------------- what we show


@pytest.mark.parametrize(
    "file", sorted((REPOSITORY / "scenes").glob("*.json")), ids=lambda f: f.name
)
def test_example_scenes(file: Path, validator: Any) -> None:
    scene = ph.load(file)
    flatten(scene)
    assert len(scene.shapes) >= 2
    assert scene.camera is not None
    validator.validate(json.loads(file.read_text(encoding="utf-8")))


def test_examples_of_the_manual(folder: Path, validator: Any) -> None:
    manual = (REPOSITORY / "docs" / "scene.md").read_text(encoding="utf-8")
    scene, shape, hollow = re.findall(r"```json\n(.*?)```", manual, re.DOTALL)
    flatten(read(folder, scene))
    validator.validate(json.loads(scene))
    assert refusal(folder, with_shape(**json.loads(shape))).endswith("'centers.npy': no such file")
    flatten(read(folder, '{"parhelion": 1, ' + hollow + "}"))
    text = scene.replace('"brass": {', '"brass": {"type": "metal"},\n    "brass": {')
    assert "the key 'brass' occurs twice in its object" in refusal(folder, text)
    assert "the key 'brass' occurs twice in its object" in manual
