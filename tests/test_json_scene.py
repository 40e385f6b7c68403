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
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import parhelion as ph
from conftest import REPOSITORY
from parhelion import flatten as flattening
from parhelion import renderer, tables
from parhelion.flatten import flatten
from parhelion.io import LoadOptions, json_scene
from parhelion.io.json_scene import document as documents
from parhelion.io.json_scene import source

# two by two grey pixels: 0, 85, 170, 255
IMAGE = {"shape": [2, 2], "type": "uint8", "data": "AFWq/w=="}
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
        "projection": "perspective",
        "shift": [0.1, -0.2],
        "mirrored": True,
    },
    "background": {"type": "gradient", "horizon": [1, 1, 1], "zenith": [0.5, 0.7, 1]},
    "lights": [
        {"type": "point", "position": [0, 5, 0], "intensity": [10, 10, 9]},
        {"type": "sun", "transform": [[0, 0, 1], [1, 0, 0], [0, 1, 0]]},
        {"type": "projector", "fov_axis": "y", "image": IMAGE, "color_space": "linear"},
    ],
    "materials": {
        "brass": {"type": "metal", "color": [0.8, 0.6, 0.3], "fuzz": 0.25},
        "clear glass": {"type": "dielectric", "ior": 1.5},
        "lamp": {"type": "emissive", "radiance": [4, 5, 6]},
        "wall": {
            "type": "diffuse",
            "color": {"type": "image", "image": IMAGE, "wrap_u": "mirror", "channel": "r"},
            "roughness": {"type": "checker", "transform": [[4, 0, 0], [0, 4, 0]]},
            "emission": [0.5, 0, 0],
            "two_sided_emission": True,
            "opacity": {"type": "attribute", "name": "vertex_age"},
            "bump_map": {
                "type": "multiply",
                "color0": {"type": "noise", "size": 0.5},
                "uvs": "vertex_other",
            },
            "two_sided": False,
            "back": "brass",
            "priority": 3,
            "absorption": 0.25,
        },
        "both": {"type": "blend", "a": "brass", "b": {"type": "metal"}, "weight": 0.25},
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
            "rotation": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        },
        {
            "type": "mesh",
            "vertices": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
            "faces": [[0, 1, 2], [0, 2, 3]],
            "normals": "smooth",
            "uvs": [[0, 0], [1, 0], [1, 1], [0, 1]],
            "material": ["wall", "both"],
            "attributes": {"vertex_age": [0, 0.5, 1, 0.5], "face_hue": [[1, 0, 0], [0, 1, 0]]},
            "inside_out": True,
        },
        {
            "type": "disks",
            "centers": [[0, 3, 0]],
            "axis_u": [[1, 0, 0]],
            "axis_v": [[0, 0, 2]],
            "colors": [[0.5, 0.5, 0.5]],
        },
        {"type": "cylinders", "starts": [[0, 0, 2]], "ends": [[0, 1, 2]], "radii": [0.1]},
        {
            "type": "curves",
            "points": [[0, 0, 3], [0, 1, 3], [1, 1, 3], [2, 1, 3]],
            "radii": [0.1, 0.05, 0.025, 0.01],
            "counts": [2, 2],
            "basis": "linear",
            "style": "flat",
            "material": ["brass", "lamp"],
        },
        {
            "type": "instances",
            "shapes": [{"type": "spheres", "centers": [[0, 0, 0]], "name": "ball"}],
            "transforms": [[[1, 0, 0, 9], [0, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]],
            "name": "balls",
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
        "integrator": "direct",
        "ao_distance": 2.5,
    },
    "legend": {"label": "element", "kinds": [["C", [0.25, 0.25, 0.25]], ["O", [1, 0, 0]]]},
}
BAR = {"label": "pressure", "colormap": "viridis", "low": -1, "high": 2.5}
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


def mesh(**members: Any) -> dict[str, Any]:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    return other("mesh", **({"vertices": corners, "faces": [[0, 1, 2]]} | members))


def mesh_file(name: str, **members: Any) -> dict[str, Any]:
    return other("mesh", file=name, **members)


def other(kind: str, **members: Any) -> dict[str, Any]:
    return {"parhelion": 1, "shapes": [{"type": kind} | members]}


UNIT = np.eye(4).tolist()


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
        shift=(0.1, -0.2),
        mirrored=True,
    )
    assert scene.background == ph.Background("gradient", horizon=(1, 1, 1), zenith=(0.5, 0.7, 1))
    point, sun, projector = scene.lights
    assert point == ph.Light("point", position=(0, 5, 0), intensity=(10, 10, 9))
    assert sun == ph.Light("sun", transform=((0, 0, 1), (1, 0, 0), (0, 1, 0)))
    assert projector.params["fov_axis"] == "y"
    assert projector.params["color_space"] == "linear"
    assert list(scene.materials) == ["brass", "clear glass", "lamp", "wall", "both"]
    wall = scene.materials["wall"].params
    picture = wall["color"].params["image"]
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(picture, [[0, 85], [170, 255]])
    assert wall["color"] == ph.Texture("image", image=picture, wrap_u="mirror", channel="r")
    assert scene.materials["wall"] == ph.Material(
        "diffuse",
        color=wall["color"],
        roughness=ph.Texture("checker", transform=((4, 0, 0), (0, 4, 0))),
        emission=(0.5, 0, 0),
        two_sided_emission=True,
        opacity=ph.Texture("attribute", name="vertex_age"),
        bump_map=ph.Texture("multiply", color0=ph.Texture("noise", size=0.5), uvs="vertex_other"),
        two_sided=False,
        back="brass",
        priority=3,
        absorption=0.25,
    )
    assert scene.materials["both"] == ph.Material(
        "blend", a="brass", b=ph.Material("metal"), weight=0.25
    )
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
        integrator="direct",
        ao_distance=2.5,
    )
    ground, three, lamp, inline, mesh, disks, cylinders, curves, instances = scene.shapes
    assert (ground.name, ground.radii, ground.material) == ("ground", 1000, ph.Material("diffuse"))
    np.testing.assert_array_equal(three.centers, [[0, 1, 0], [2, 1, 0], [4, 1, 0.5]])
    np.testing.assert_array_equal(three.radii, [1, 0.5, 0.25])
    np.testing.assert_array_equal(three.material, [1, 0, 1])
    np.testing.assert_array_equal(three.colors, np.eye(3))
    assert lamp.material == "lamp"
    assert inline.material == ph.Material("diffuse", color=(0, 0.5, 1))
    assert inline.colors is None
    np.testing.assert_array_equal(inline.rotation, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert isinstance(mesh, ph.Mesh)
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(mesh.normals, [[0, 0, 1]] * 4)
    np.testing.assert_array_equal(mesh.uvs, [[0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_array_equal(mesh.material, [3, 4])
    np.testing.assert_array_equal(mesh.attributes["vertex_age"], [0, 0.5, 1, 0.5])
    np.testing.assert_array_equal(mesh.attributes["face_hue"], [[1, 0, 0], [0, 1, 0]])
    assert mesh.inside_out
    assert isinstance(disks, ph.Disks)
    np.testing.assert_array_equal(
        [disks.centers, disks.axis_u, disks.axis_v], [[[0, 3, 0]], [[1, 0, 0]], [[0, 0, 2]]]
    )
    np.testing.assert_array_equal(disks.colors, [[0.5, 0.5, 0.5]])
    assert isinstance(cylinders, ph.Cylinders)
    np.testing.assert_array_equal([cylinders.starts, cylinders.ends], [[[0, 0, 2]], [[0, 1, 2]]])
    assert cylinders.axis_u is None
    assert isinstance(curves, ph.Curves)
    assert (curves.basis, curves.style) == ("linear", "flat")
    np.testing.assert_array_equal(curves.counts, [2, 2])
    np.testing.assert_array_equal(curves.radii, [0.1, 0.05, 0.025, 0.01])
    np.testing.assert_array_equal(curves.material, [0, 2])
    assert isinstance(instances, ph.Instances)
    np.testing.assert_array_equal(
        instances.transforms, [[[1, 0, 0, 9], [0, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]]
    )
    assert [part.name for part in instances.shapes] == ["ball"]
    assert scene.legend == ph.Swatches("element", (("C", (0.25, 0.25, 0.25)), ("O", (1, 0, 0))))
    ph.prepare(scene)


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
        (documents.Camera, ph.Camera),
        (documents.Settings, ph.Settings),
        (documents.Document, ph.Scene),
        *((block, getattr(ph, block.__name__)) for block in documents.SHAPES.values()),
    ],
)
def test_every_field_of_the_dataclasses_has_its_name_here(block: Any, dataclass: Any) -> None:
    names = {f.name for f in fields(dataclass)} - {"source"}  # not of the scene, but of its file
    assert names <= set(block.__struct_encode_fields__)


def test_words_that_other_modules_list_are_all_known_here() -> None:
    assert {*documents.CommonMaterial.__struct_fields__} == flattening.COMMON
    definitions = json_scene.schema()["$defs"]
    integrators = definitions["Settings"]["properties"]["integrator"]["enum"]
    assert {*integrators} == {*renderer.INTEGRATORS}


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
    assert len(ph.load(file).shapes) == 9
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


def test_options_for_other_formats_are_refused(folder: Path) -> None:
    with pytest.raises(ph.FormatError, match="the option 'color_by' is not for Parhelion scene"):
        read(folder, VALID, LoadOptions(color_by="charge"))
    with pytest.raises(ph.FormatError, match="the option 'defines' is not for Parhelion scene"):
        read(folder, VALID, LoadOptions(defines={"spp": "4"}))
    read(folder, VALID, LoadOptions(strict=True))  # it always is


# ----------------------------------------------------------------------------- what it refuses

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
    (
        {"parhelion": 1, "settings": {"reuse_paths": "sometimes"}},
        '$.settings.reuse_paths: is "sometimes"; must be true, false or "auto"',
    ),
    (
        {"parhelion": 1, "settings": {"reuse_paths": 3}},
        '$.settings.reuse_paths: is 3; must be true, false or "auto"',
    ),
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
    ({"parhelion": 1, "background": 0}, "$.background: must be an object with a 'type'"),
    (
        {"parhelion": 1, "background": {"type": "skyy"}},
        "$.background: unknown background type 'skyy'; did you mean 'sky'?",
    ),
    ({"parhelion": 1, "background": {"type": "point"}}, "unknown background type 'point'"),
    (
        {"parhelion": 1, "background": {"type": "sky", "zenit": 1}},
        "$.background: unknown parameter 'zenit'",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap"}},
        "$.background: the field 'image' is missing",
    ),
    (
        {"parhelion": 1, "background": {"type": "sky", "image": "a.exr"}},
        "$.background: unknown parameter 'image'",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap", "image": "a.exr"}},
        "$.background.image: 'a.exr': no such file",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap", "image": "../a.exr"}},
        "$.background.image: '../a.exr' is not inside the scene's folder",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap", "image": IMAGE | {"type": "uint9"}}},
        "$.background.image.type: unknown type 'uint9'; did you mean 'uint8'?",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap", "image": IMAGE | {"shape": [2, 3]}}},
        "$.background.image.data: has 4 bytes; uint8 of shape (2, 3) has 6",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap", "image": IMAGE | {"data": "?"}}},
        "$.background.image.data: is no base64 text",
    ),
    (
        {"parhelion": 1, "background": {"type": "envmap", "image": IMAGE | {"width": 3}}},
        "$.background.image.width: unknown field 'width'",
    ),
    (
        {"parhelion": 1, "background": {"type": "sky", "transform": [[1, 0], [0, 1]]}},
        "$.background.transform: is [[1,0],[0,1]]; must be an array of length >= 3",
    ),
    (
        {"parhelion": 1, "background": {"type": "sky", "transform": [[1, 0, 0]] * 4}},
        "$.background.transform: has rows that make no matrix",
    ),
    # lights
    ({"parhelion": 1, "lights": {}}, "$.lights: is {}; must be an array"),
    ({"parhelion": 1, "lights": [5]}, "$.lights[0]: must be an object with a 'type'"),
    (
        {"parhelion": 1, "lights": [{"type": "point"}, {"type": "spto"}]},
        "$.lights[1]: unknown light type 'spto'; did you mean 'spot'?",
    ),
    (
        {"parhelion": 1, "lights": [{"type": "spot", "cutoff_angle": 181}]},
        "$.lights[0]: parameter 'cutoff_angle' is 181; must lie in [0, 180]",
    ),
    (
        {"parhelion": 1, "lights": [{"type": "projector", "image": IMAGE, "fov_axis": "z"}]},
        "$.lights[0]: unknown fov_axis 'z' (choices: x, y)",
    ),
    (
        {"parhelion": 1, "lights": [{"type": "spot", "intensity": {"type": "checker"}}]},
        "$.lights[0]: parameter 'intensity' is {'type': 'checker'}; must be 3 numbers",
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
        "$.materials.steel: unknown parameter 'fuz'; did you mean 'fuzz'? (choices: absorption, ",
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
    *(
        (
            {"parhelion": 1, "materials": {"steel": {"type": "metal"} | changes}},
            f"$.materials.{words}",
        )
        for changes, words in (
            ({"color": {}}, "steel.color: the field 'type' is missing"),
            ({"color": {"type": "wood"}}, "steel.color: unknown texture type 'wood'"),
            ({"color": {"type": "image"}}, "steel.color: the field 'image' is missing"),
            (
                {"color": {"type": "image", "image": "wood.jpg"}},
                "steel.color.image: 'wood.jpg': no such file",
            ),
            (
                {"color": {"type": "image", "image": IMAGE, "wrap_u": "tile"}},
                "steel.color: unknown wrap_u 'tile' (choices: clamp, mirror, repeat, zero)",
            ),
            (
                {"color": {"type": "image", "image": IMAGE, "color_space": "sRGB"}},
                "steel.color.color_space: unknown color_space 'sRGB' (choices: auto, linear, srgb)",
            ),
            (
                {"fuzz": {"type": "checker", "channel": "x"}},
                "steel.fuzz.channel: unknown channel 'x'",
            ),
            (
                {"fuzz": {"type": "checker", "transform": [[1, 0, 0]]}},
                "steel.fuzz.transform: is [[1,0,0]]; must be an array of length >= 2",
            ),
            (
                {"fuzz": {"type": "checker", "color0": {"type": "nose"}}},
                "steel.fuzz.color0: unknown texture type 'nose'; did you mean 'noise'?",
            ),
            (
                {"fuzz": {"type": "checker", "filter": {"type": "noise"}}},
                "steel.fuzz: unknown filter \"{'type': 'noise'}\"",
            ),
            ({"fuzz": {"type": "attribute"}}, "steel.fuzz: the field 'name', the attribute's, is"),
            ({"fuzz": {"type": "noise", "name": "a"}}, "steel.fuzz: unknown parameter 'name'"),
            ({"emission": -1}, "steel.emission: is -1; must be a number >= 0"),
            ({"emission": [1, 2]}, "steel.emission: is [1,2]; must be an array of length >= 3"),
            ({"emission": [1, 2, "3"]}, 'steel.emission[2]: is "3"; must be a number'),
            ({"emission": {"type": "x"}}, "steel.emission: unknown texture type 'x'"),
            ({"opacity": 1.5}, "steel.opacity: is 1.5; must be a number <= 1"),
            ({"normal_map": 0.5}, "steel.normal_map: is 0.5; must be an object or null"),
            ({"priority": 1.5}, "steel.priority: is 1.5; must be an integer"),
            ({"priority": -1}, "steel.priority: is -1; must be an integer >= 0"),
            ({"two_sided": 1}, "steel.two_sided: is 1; must be true or false"),
            ({"back": "steal"}, "steel.back: unknown material 'steal'; did you mean 'steel'?"),
            ({"back": {"type": "mtal"}}, "steel.back: unknown material type 'mtal'; did you mean"),
            ({"a": "steel"}, "steel: unknown parameter 'a'"),
            ({"type": "blend"}, "steel: the field 'a' is missing"),
            ({"type": "blend", "a": "steel"}, "steel: the field 'b' is missing"),
            ({"type": "blend", "a": "x", "b": "steel"}, "steel.a: unknown material 'x'"),
            (
                {"type": "blend", "a": "steel", "b": "steel", "weight": 2},
                "steel.weight: is 2; must be a number <= 1",
            ),
            ({"type": "blend", "a": "steel", "b": "steel", "fuzz": 1}, "steel: unknown parameter"),
        )
    ),
    # legends
    *(
        ({"parhelion": 1, "legend": legend}, f"$.legend{words}")
        for legend, words in (
            ({"kinds": []}, ": the field 'label' is missing"),
            ({"label": "a"}, ": the field 'colormap' is missing ('kinds' in the place of all thr"),
            (BAR | {"high": -2}, ": low is -1; must be at most high, -2"),
            ({"label": "a", "colormap": "gray", "low": 0}, ": the field 'high' is missing"),
            (BAR | {"kinds": []}, ": has both 'kinds' and 'colormap'; give one of them"),
            (BAR | {"low": None}, ".low: is null; must be a number"),
            (BAR | {"color_map": "gray"}, ".color_map: unknown field 'color_map'; did you mean"),
            ({"label": "a", "kinds": [["C", [1, 0]]]}, ".kinds[0][1]: is [1,0]; must be an array"),
            (
                {"label": "a", "kinds": [["C", [1, 0, -1]]]},
                ".kinds[0][1][2]: is -1; must be a number >= 0",
            ),
        )
    ),
    # shapes
    ({"parhelion": 1, "shapes": [{"centers": [[0, 0, 0]]}]}, "$.shapes[0]: the field 'type' is mi"),
    ({"parhelion": 1, "shapes": [{"type": "spheres"}]}, "$.shapes[0]: the field 'centers' is miss"),
    (with_shape(type="sphere"), "$.shapes[0].type: unknown shape type 'sphere'; did you mean 'sph"),
    (with_shape(type="mesh"), "$.shapes[0].centers: unknown field 'centers'"),
    (mesh(vertices=None), "$.shapes[0].vertices: is null; must be "),
    ({"parhelion": 1, "shapes": [{"type": "mesh"}]}, "$.shapes[0]: needs 'vertices' and 'faces'"),
    (
        {"parhelion": 1, "shapes": [{"type": "mesh", "faces": [[0, 1, 2]]}]},
        "$.shapes[0]: needs 'vertices' and 'faces', or a 'file'",
    ),
    (mesh(file="a.obj"), "$.shapes[0]: has both 'file' and 'vertices'; give one of them"),
    (mesh(file_index=1), "$.shapes[0].file_index: is 1, and there is no 'file'"),
    (mesh_file("a.stl"), "$.shapes[0].file: is 'a.stl'; must be a mesh file (choices: .obj, .ply"),
    (mesh_file("a.obj"), "$.shapes[0].file: 'a.obj': no such file"),
    (mesh_file("a.obj", file_index=1), "$.shapes[0].file_index: is 1; only .serialized files have"),
    (mesh_file("../a.obj"), "$.shapes[0].file: '../a.obj' is not inside the scene's folder"),
    (mesh(faces=[[0, 1]]), "$.shapes[0].faces[0]: is [0,1]; must be an array of length 3"),
    (mesh(faces=[[0, 1, 2.0]]), "$.shapes[0].faces[0][2]: is 2.0; must be an integer"),
    (mesh(faces=[[0, 1, -1]]), "$.shapes[0].faces[0][2]: is -1; must be an integer >= 0"),
    (
        mesh(faces=[[0, 1, 2], [0, 3, 1]]),
        "$.shapes[0].faces[1][1]: is 3; the mesh has vertices 0 to 2",
    ),
    (mesh(normals="round"), "$.shapes[0].normals: is 'round'; must be an array or the name of a"),
    (mesh(normals=[[0, 0, 1]]), "$.shapes[0].normals: has 1 values for 3 vertices"),
    (mesh(uvs=[[0, 0], [0, 1]]), "$.shapes[0].uvs: has 2 values for 3 vertices"),
    (mesh(uvs=[[0, 0, 1]] * 3), "$.shapes[0].uvs[0]: is [0,0,1]; must be an array of length 2"),
    (mesh(colors=[[0, 0, 1]] * 3), "$.shapes[0].colors: has 3 values for 1 faces"),
    (mesh(material=["a", "b"]), "$.shapes[0].material: has 2 values for 1 faces"),
    (mesh(attributes={"vertex_a": []}), "$.shapes[0].attributes.vertex_a: is []; must be an array"),
    (
        mesh(attributes={"vertex a": [0, "1", 2]}),
        "$.shapes[0].attributes['vertex a'][1]: is \"1\"; must be a number or an array",
    ),
    (
        mesh(attributes={"vertex_a": [0, [1, 2, 3], 2]}),
        "$.shapes[0].attributes.vertex_a: mixes numbers, pairs and arrays of 3",
    ),
    (
        other("disks", centers=[[0, 0, 0]], axis_u=[[1, 0, 0]]),
        "$.shapes[0]: the field 'axis_v' is missing",
    ),
    (
        other("disks", centers=[[0, 0, 0]], axis_u=[], axis_v=[[0, 1, 0]]),
        "$.shapes[0].axis_u: has 0 values for 1 centers",
    ),
    (
        other("cylinders", starts=[[0, 0, 0]], ends=[[0, 0, 1]] * 2),
        "$.shapes[0].ends: has 2 values for 1 starts",
    ),
    (
        other("curves", points=[[0, 0, 0]] * 4, basis="bezir"),
        "$.shapes[0].basis: unknown basis 'bezir'; did you mean 'bezier'?",
    ),
    (
        other("curves", points=[[0, 0, 0]] * 4, radii=[0.1] * 3),
        "$.shapes[0].radii: has 3 values for 4 points",
    ),
    (
        other("curves", points=[[0, 0, 0]] * 4, counts=[4.0]),
        "$.shapes[0].counts[0]: is 4.0; must be an integer",
    ),
    (
        other("instances", shapes=[ONE | {"radii": [1, 2]}], transforms=[UNIT]),
        "$.shapes[0].shapes[0].radii: has 2 values for 1 centers",
    ),
    (
        other("instances", shapes=[ONE | {"radius": 1}], transforms=[UNIT]),
        "$.shapes[0].shapes[0].radius: unknown field 'radius'; did you mean 'radii'?",
    ),
    (
        other("instances", shapes=[other("instances", shapes=[], transforms=[UNIT])["shapes"][0]])
        | {"name": "x"},
        "$.shapes[0].shapes[0].type: unknown shape type 'instances' (choices: curves, cylinders, ",
    ),
    (
        other("instances", shapes=[], transforms=[UNIT[:2]]),
        "$.shapes[0].transforms[0]: is [[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0]]; must be an array of",
    ),
    (
        other("instances", shapes=[], transforms=[UNIT, UNIT[:3]]),
        "$.shapes[0].transforms: mixes matrices of 3 and of 4 rows",
    ),
    (with_shape(type=5), "$.shapes[0].type: is 5; must be a string"),
    (
        with_shape(centres=[]),
        "$.shapes[0].centres: unknown field 'centres'; did you mean 'centers'? (choices: centers, "
        "colors, inside_out, material, name, radii, rotation, type)",
    ),
    (with_shape(centers=[]), "$.shapes[0].centers: is []; must be an array of length >= 1"),
    (with_shape(centers=5), "$.shapes[0].centers: is 5; must be a string or an object or an array"),
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
    monkeypatch.setattr(source, "LARGEST_TEXT", 2**20)
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
        outside = f"{name!r} is not inside the scene's folder (--allow-path allows others)"
        assert said == f"$.shapes[0].centers: {outside}"
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


def test_npy_of_every_shape(tmp_path: Path) -> None:
    corners, faces = np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.uint16)
    matrices = np.array([np.eye(4)[:3]] * 2)
    saved = {
        name: save(tmp_path, f"{name}.npy", array)
        for name, array in {"v": corners, "f": faces, "m": matrices, "uv": corners[:, :2]}.items()
    }
    part = mesh(
        vertices="v.npy",
        faces="f.npy",
        uvs="uv.npy",
        normals="v.npy",
        attributes={"vertex_a": "v.npy", "vertex_b": save(tmp_path, "b.npy", [1, 2, 3])},
    )["shapes"]
    (group,) = read(tmp_path, other("instances", shapes=part, transforms="m.npy")).shapes
    np.testing.assert_array_equal(group.transforms, matrices)
    (triangle,) = group.shapes
    np.testing.assert_array_equal(triangle.faces, faces)
    for values in (triangle.vertices, triangle.normals, triangle.attributes["vertex_a"]):
        np.testing.assert_array_equal(values, corners)
    np.testing.assert_array_equal(triangle.uvs, corners[:, :2])
    np.testing.assert_array_equal(triangle.attributes["vertex_b"], [1, 2, 3])
    ph.prepare(read(tmp_path, other("instances", shapes=part, transforms="m.npy")))
    for members, words in (
        ({"faces": saved["v"]}, "faces: 'v.npy' holds float32; must be whole numbers"),
        ({"faces": save(tmp_path, "n.npy", [[0, 1, -1]])}, "faces: 'n.npy': [0][2] is -1; must be"),
        ({"uvs": saved["v"]}, "uvs: 'v.npy' has shape (3, 3); must be (N, 2)"),
        (
            {"attributes": {"vertex_a": saved["m"]}},
            "attributes.vertex_a: 'm.npy' has shape (2, 3, 4); must be (N,) or (N, 2) or (N, 3)",
        ),
    ):
        assert refusal(tmp_path, mesh(**members)).startswith(f"$.shapes[0].{words}")
    said = refusal(tmp_path, other("instances", shapes=[], transforms=saved["v"]))
    assert said.endswith("'v.npy' has shape (3, 3); must be (N, 3, 4) or (N, 4, 4)")


OBJ = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 0 1
vt 0 0
vt 1 0
vt 1 1
vn 0 0.6 0.8
f 1/1/1 2/2/1 3/3/1
f 1/1/1 3/3/1 4/2/1
"""
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
property float heat
element face 1
property list uchar int vertex_indices
end_header
0 0 0 0.25
1 0 0 0.5
0 1 0 1
3 0 1 2
"""


def test_meshes_from_files(tmp_path: Path) -> None:
    (tmp_path / "fold.obj").write_text(OBJ)
    (tmp_path / "tri.ply").write_text(PLY)
    (fold,) = read(tmp_path, mesh_file("fold.obj", colors=[[1, 0, 0], [0, 1, 0]])).shapes
    assert np.shape(fold.faces) == (2, 3)
    np.testing.assert_allclose(fold.normals, [[0, 0.6, 0.8]] * len(fold.vertices))
    corners = np.asarray(fold.uvs)[np.asarray(fold.faces)[0]]
    np.testing.assert_array_equal(corners, [[0, 0], [1, 0], [1, 1]])
    (flat,) = read(tmp_path, mesh_file("fold.obj", normals="flat")).shapes
    assert flat.normals is None
    (smooth,) = read(tmp_path, mesh_file("tri.ply", normals="smooth")).shapes
    np.testing.assert_allclose(smooth.normals, [[0, 0, 1]] * 3)
    document = mesh_file("tri.ply", attributes={"face_id": [7]}, uvs=[[0, 0]] * 3)
    (both,) = read(tmp_path, document).shapes
    assert both.normals is None
    np.testing.assert_array_equal(both.attributes["face_id"], [7])
    heat = [np.ravel(v) for k, v in both.attributes.items() if "heat" in k]
    np.testing.assert_array_equal(heat, [[0.25, 0.5, 1]])
    (tmp_path / "tri.ply").write_text(PLY.replace("3 0 1 2", "3 0 1 9"))
    said = refusal(tmp_path, mesh_file("tri.ply"))
    assert said.startswith("$.shapes[0].file: ")
    assert "tri.ply" in said
    assert "9" in said
    said = refusal(tmp_path, mesh_file("fold.obj", colors=[[1, 0, 0]]))
    assert said == "$.shapes[0].colors: has 1 values for 2 faces"


def textured(image: Any) -> dict[str, Any]:
    return with_shape(material={"type": "diffuse", "color": {"type": "image", "image": image}})


def picture(file: Path) -> Path:
    """A small picture file."""
    file.parent.mkdir(exist_ok=True)
    ph.render(ph.Scene([ph.Spheres([[0, 0, 0]])]), width=4, spp=1).save(file)
    return file


def test_pictures_by_name(tmp_path: Path) -> None:
    file = picture(tmp_path / "maps" / "wood.png")
    scene = read(tmp_path, textured("maps/wood.png"))
    image = scene.shapes[0].material.params["color"].params["image"]
    assert Path(image) == file
    seen = flatten(scene).sha256()
    # written relative to the folder of the new file, and found again from there
    text = json_scene.dumps(scene, tmp_path)
    assert b'"maps/wood.png"' in text
    assert flatten(read(tmp_path, text)).sha256() == seen
    with pytest.raises(ph.SceneError, match=r"wood\.png' is not inside the folder"):
        json_scene.dumps(scene, tmp_path / "elsewhere")


def test_folders_that_the_user_allows(tmp_path: Path) -> None:
    picture(tmp_path / "maps" / "wood.png")
    picture(tmp_path / "private" / "wood.png")
    home = tmp_path / "home"
    home.mkdir()
    allowed = LoadOptions(allow_paths=(str(tmp_path / "maps"),))
    for name in ("../maps/wood.png", str(tmp_path / "maps" / "wood.png")):
        assert "is not inside the scene's folder" in refusal(home, textured(name))
        scene = read(home, textured(name), allowed)
        image = scene.shapes[0].material.params["color"].params["image"]
        assert Path(image) == tmp_path / "maps" / "wood.png"
    for name in ("../private/wood.png", "../maps/../private/wood.png"):
        with pytest.raises(ph.FormatError, match="is not inside the scene's folder"):
            read(home, textured(name), allowed)


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
    for kind, name in (
        ("materials", "Material"),
        ("textures", "Texture"),
        ("lights", "Light"),
        ("backgrounds", "Background"),
    ):
        known = {e["properties"]["type"]["const"]: e for e in definitions[name]["anyOf"]}
        assert known.keys() - tables.tables()[kind].keys() == ({"blend"} & known.keys())
        for entry in tables.tables()[kind].values():
            listed = list(known[entry.name]["properties"])
            params = [p.name for p in entry.params]
            assert listed[: len(params) + 1] == ["type", *params]
            assert ("image" in listed) == entry.image
            for p in entry.params:
                assert known[entry.name]["properties"][p.name].get("enum", []) == [*p.choices]
    assert definitions["Sampler"]["enum"] == list(tables.tables()["samplers"])


def test_schema_accepts_what_is_valid(validator: Any) -> None:
    validator.validate(VALID)
    validator.validate({"parhelion": 1})


# What no schema can say; every other error of BAD_DOCUMENTS is one that it finds too.
BEYOND_SCHEMA = re.compile(
    r"has both 'fov'|values for|unknown material '|no such file|is \d\.0; must be an integer"
    "|scene's folder|rows that make no|mixes |the mesh has vertices|file_index: is 1| bytes; "
    "|no base64|has both 'camera'|must be at most high|side file|multiple of 64"
)


@pytest.mark.parametrize(("document", "words"), BAD_DOCUMENTS, ids=str)
def test_schema_and_reader_refuse_the_same(
    folder: Path, validator: Any, document: Any, words: str
) -> None:
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
    st.sampled_from(["", "brass", "metal", "x.npy", "spheres", "mesh", "smooth", "blend"]),
    st.just([]),
    st.lists(st.sampled_from([0, 0.25, 1, -1, "a", None]), max_size=4),
    st.just({}),
    st.sampled_from(
        [{"type": "metal"}, {"type": "constant"}, {"type": "checker"}, {"parhelion": 1}, IMAGE]
    ),
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
            parent[
                draw(st.sampled_from(["type", "name", "radii", "fov", "image", "emission", "zz"]))
            ] = draw(REPLACEMENTS)
        else:
            parent.append(draw(REPLACEMENTS))
        if len(places(document)) == 1:
            break
    return document


QUICK = settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
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
        legend=draw(
            st.none()
            | st.builds(ph.ColorBar, NAMES, NAMES, st.floats(-5, 0), st.floats(0, 5))
            | st.builds(ph.Swatches, NAMES, st.lists(st.tuples(NAMES, COLOR)).map(tuple))
        ),
    )


def assert_equal(a: Any, b: Any) -> None:
    """Two scenes, or parts of them, are equal: arrays and lists of numbers by their numbers."""
    if is_dataclass(a):
        assert type(a) is type(b)
        for field in fields(a):
            if field.name != "source":
                assert_equal(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, (ph.Material, ph.Texture, ph.Light)):
        assert (type(a), a.type) == (type(b), b.type)
        assert_equal(a.params, b.params)
    elif isinstance(a, Mapping):
        assert list(a) == list(b)
        assert_equal(list(a.values()), list(b.values()))
    elif isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, (list, tuple)):
        for x, y in zip(a, b, strict=True):
            assert_equal(x, y)
    else:
        assert a == b


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


TRIANGLE = ph.Mesh(np.eye(3), [[0, 1, 2]])
GREY = np.float16([[0.25, 0.5], [0.75, 4]])
LAMP = ph.Light("projector", image=GREY, transform=np.eye(4, dtype=np.float32))


@pytest.mark.parametrize(
    "scene",
    [
        ph.Scene([TRIANGLE], background=None),
        ph.Scene([replace(TRIANGLE, uvs=np.eye(3, 2, dtype=np.float32), normals=np.eye(3))]),
        ph.Scene([replace(TRIANGLE, attributes={"vertex_a": np.ones(3), "face_b": [[1, 0, 0]]})]),
        ph.Scene(
            [replace(TRIANGLE, material=["b"])],
            {"a": ph.Material("metal"), "b": ph.Material("diffuse")},
        ),
        ph.Scene([ph.Disks([[0, 0, 0]], [[1, 0, 0]], [[0, 1, 0]], inside_out=True)]),
        ph.Scene([ph.Cylinders([[0, 0, 0]], [[0, 0, 1]], 0.5, [[1, 0, 0]])]),
        ph.Scene([ph.Curves(np.random.default_rng(1).random((9, 3)), counts=np.int8([4, 5]))]),
        ph.Scene([ph.Instances([TRIANGLE], np.eye(4)[None, :3])]),
        ph.Scene([ph.Spheres([[0, 0, 0]], rotation=np.eye(3)[[1, 2, 0]])]),
        ph.Scene(lights=[LAMP, ph.Light("spot", direction=(0, 1, 0))]),
        ph.Scene(background=ph.Background("envmap", image=np.full((2, 4, 3), 9, np.uint16))),
        ph.Scene(
            materials={
                "a": ph.Material(
                    "blend", a=ph.Material("plastic"), b=ph.Material("dielectric", roughness=0.5)
                ),
                "b": ph.Material(
                    "diffuse",
                    color=ph.Texture("image", image=np.eye(4) > 0, transform=np.eye(3)),
                    normal_map=ph.Texture("image", image=np.full((1, 1, 4), 128, np.uint8)),
                    emission=3.0,
                    back=ph.Material("metal", fuzz=ph.Texture("ramp", shape="smooth")),
                ),
            }
        ),
        ph.Scene(
            camera=ph.Camera(projection="orthographic", height=3, shift=(0.5, 0), mirrored=True),
            settings=ph.Settings(integrator="ao", ao_distance=2.5),
            legend=ph.ColorBar("pressure", "viridis", np.float32(-1), 2.5),  # type: ignore[arg-type]
        ),
    ],
)
def test_every_part_there_and_back(folder: Path, validator: Any, scene: ph.Scene) -> None:
    text = json_scene.dumps(scene)
    validator.validate(json.loads(text))
    again = read(folder, text)
    assert flatten(again).sha256() == flatten(scene).sha256()
    assert (again.camera, again.settings) == (scene.camera, scene.settings)
    assert again.legend == scene.legend


def test_an_attribute_of_one_column_is_one_of_numbers(folder: Path) -> None:
    column = replace(TRIANGLE, attributes={"vertex_a": [[1], [2], [3]]})
    (again,) = read(folder, json_scene.dumps(ph.Scene([column]))).shapes
    np.testing.assert_array_equal(again.attributes["vertex_a"], [1, 2, 3])


def test_all_there_is_there_and_back(folder: Path) -> None:
    scene = read(folder, VALID)
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
        (ph.Spheres([[0, 0, 0]], material=[0]), "must be names, or whole numbers below 0"),
        (ph.Spheres([[0, 0, 0]], material=[0.5]), "must be names, or whole numbers below 0"),
        (ph.Spheres("x.npy"), "centers must be numbers"),
        (replace(TRIANGLE, normals="smooth"), "normals must be numbers"),
        (replace(TRIANGLE, faces=[[0, 1, 5]]), "$.shapes[0].faces[0][2]: is 5; the mesh has vert"),
        (ph.Instances([5], np.eye(4)[None]), "int is no shape"),
        (
            ph.Spheres(
                [[0, 0, 0]],
                material=ph.Material("diffuse", color=ph.Texture("image", image=np.int32([[1]]))),
            ),
            "an image is int32; must be uint8, uint16 or floats",
        ),
        (ph.Spheres([[0, 0, object()]]), "object is not a number, text or array"),
    ],
)
def test_what_cannot_be_written(shape: Any, words: str) -> None:
    with pytest.raises(ph.SceneError, match=re.escape(words)):
        json_scene.dumps(ph.Scene(shapes=[shape]))


def test_legends_that_cannot_be_written() -> None:
    with pytest.raises(ph.SceneError, match=r"\$.legend.high: is null; must be a number"):
        json_scene.dumps(ph.Scene(legend=ph.ColorBar("a", "gray", 0.0, float("inf"))))
    with pytest.raises(ph.SceneError, match="legend: a ColorBar or Swatches is needed, not 'red'"):
        json_scene.dumps(ph.Scene(legend="red"))  # type: ignore[arg-type]


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


def with_shapes(text: str) -> str:
    return f'{{"parhelion": 1, "shapes": [{text}]}}'


def test_examples_of_the_manual(folder: Path, validator: Any) -> None:
    manual = (REPOSITORY / "docs" / "scene.md").read_text(encoding="utf-8")
    scene, model, copies, arrays, rust, hollow, floor, legend = re.findall(
        r"```json\n(.*?)```", manual, re.DOTALL
    )
    flatten(read(folder, scene))
    validator.validate(json.loads(scene))
    for shape, file in ((model, "teapot.ply"), (arrays, "centers.npy")):
        assert refusal(folder, with_shapes(shape)).endswith(f"{file!r}: no such file")
    flatten(read(folder, with_shapes(copies)))
    validator.validate(json.loads(with_shapes(copies)))
    flatten(read(folder, '{"parhelion": 1, ' + hollow + "}"))
    picture(folder / "maps" / "wood.jpg")
    text = f'{{"parhelion": 1, "materials": {{"steel": {{"type": "metal"}}, {rust}, {floor}}}}}'
    flatten(read(folder, text))
    validator.validate(json.loads(text))
    text = f'{{"parhelion": 1, {legend}}}'
    assert isinstance(read(folder, text).legend, ph.Swatches)
    validator.validate(json.loads(text))
    text = scene.replace('"brass": {', '"brass": {"type": "metal"},\n    "brass": {')
    assert "the key 'brass' occurs twice in its object" in refusal(folder, text)
    assert "the key 'brass' occurs twice in its object" in manual
