"""Cryptomattes: ids of names, exact coverage, and what an EXR file says of them."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core, cryptomatte
from parhelion.flatten import flatten
from parhelion.renderer import make_view, merged
from picture_tools import read_picture

# --- Ids -----------------------------------------------------------------------------------------

# The specification's examples of manifests, and the floats of its reference implementation's tests
# (github.com/Psyop/Cryptomatte: nuke/cryptomatte_utilities_tests.py)
MANIFEST = {"bunny": "13851a76", "default": "42c9679f", "bunny_porcelain_mat": "b24b26d4"}
FLOATS = {
    "hello": 6.0705627102400005616e-17,
    "cube": -4.08461912519e15,
    "sphere": 2.79018604383e15,
    "plane": 3.66557617593e-11,
    "равнина": -1.3192631212399999468e-25,
    "mädchen": 6.2361298211599995797e25,
}


def as_float(bits: int) -> np.float32:
    return np.uint32(bits).view(np.float32)


def test_ids_are_those_of_the_specification() -> None:
    assert {name: f"{cryptomatte.matte_id(name):08x}" for name in MANIFEST} == MANIFEST
    for name, value in FLOATS.items():
        assert as_float(cryptomatte.matte_id(name)) == np.float32(value), name


def test_every_id_is_a_normal_float() -> None:
    names = [str(i) for i in range(4000)]
    hashes = np.array([cryptomatte._murmur3(name.encode()) for name in names], np.uint32)
    ids = np.array([cryptomatte.matte_id(name) for name in names], np.uint32)
    floats = np.abs(ids.view(np.float32))
    assert np.all(np.isfinite(floats) & (floats >= np.finfo(np.float32).tiny))
    bare = np.abs(hashes.view(np.float32))
    changed = ~np.isfinite(bare) | (bare < np.finfo(np.float32).tiny)
    assert 10 < changed.sum() < 80  # one of 128
    np.testing.assert_array_equal(ids ^ hashes, np.where(changed, 1 << 23, 0))


# --- Coverage ------------------------------------------------------------------------------------


def rectangle(x0: float, x1: float, z: float = 0.0, **more: object) -> ph.Mesh:
    """From x0 to x1, across the whole picture in y."""
    corners = [[x0, -9, z], [x1, -9, z], [x1, 9, z], [x0, 9, z]]
    return ph.Mesh(corners, [[0, 1, 2], [0, 2, 3]], **more)


# Pixels of 1 x 1 from x = -4 to 4, seen from +z
FLAT = ph.Scene(
    camera=ph.Camera(eye=(0, 0, 5), projection="orthographic", height=1.0),
    settings=ph.Settings(width=8, height=1, spp=256, filter="box", max_depth=1),
)


def test_coverage_is_the_share_of_the_pixel() -> None:
    scene = FLAT.replace(
        shapes=[rectangle(-9, 0.3, name="left"), rectangle(0.3, 1.75, -1, name="right")]
    )
    image = ph.render(scene, features=True)
    left, right = image.matte(shape="left")[0], image.matte(shape="right")[0]
    assert left.dtype == np.float32
    np.testing.assert_array_equal(left[[0, 1, 2, 3, 5, 6, 7]], [1, 1, 1, 1, 0, 0, 0])
    np.testing.assert_array_equal(right[[0, 1, 2, 3, 6, 7]], 0)
    # 256 samples of a (0,2)-sequence lie one in each 256th of the pixel
    assert abs(left[4] - 0.3) <= 1 / 256
    assert abs(right[5] - 0.75) <= 1 / 256
    assert left[4] + right[4] == 1
    # the sky has no entry
    ranks = image.features["CryptoObject"]
    assert ranks.shape == (1, 8, 6, 2)
    assert not ranks[0, 6:].any()
    assert not ranks[0, 5, 1:].any()
    # the largest comes first
    expected = [as_float(cryptomatte.matte_id(name)) for name in ("right", "left")]
    np.testing.assert_array_equal(ranks[0, 4, :2, 0], expected)
    np.testing.assert_array_equal(ranks[0, 4, :2, 1], [right[4], left[4]])


def crowd(count: int) -> ph.Scene:
    """Stripes, each of a shape and a material of its own, the narrowest in the middle."""
    edges = 4 * np.linspace(-1, 1, count + 1) ** 3
    materials = {f"material {k}": ph.Material("diffuse") for k in range(count)}
    shapes = [
        rectangle(edges[k], edges[k + 1], name=f"stripe {k}", material=f"material {k}")
        for k in range(count)
    ]
    return FLAT.replace(shapes=shapes, materials=materials)


def test_counts_are_those_of_the_samples_one_by_one() -> None:
    """Up to eight shapes a pixel, all are counted; of more, the eight that come first."""
    prepared = ph.prepare(crowd(40))
    spp = 48
    settings = merged(prepared.scene.settings, {"spp": spp})
    assert isinstance(prepared.scene.camera, ph.Camera)
    view = make_view(prepared.core, prepared.scene.camera, settings)
    ids = np.array([cryptomatte.matte_id(n) for n in prepared.flat.shape_names], np.uint32)
    seen = []
    for sample in range(spp):
        film = _core.Film(0, 0, 8, 1, True)
        film.begin(np.full((1, 8), sample, np.uint32))
        film.render(
            prepared.core,
            view,
            sample + 1,
            threads=1,
            tile=16,
            schedule="dynamic",
            isa="",
            tick=None,
        )
        shapes, _ = film.mattes(ids, np.zeros(40, np.uint32))
        seen.append(shapes[0, :, 0, 0].copy().view(np.uint32).tolist())
    ranks = ph.render(prepared, spp=spp, features=True).features["CryptoObject"][0]
    many = 0
    for pixel, met in enumerate(zip(*seen, strict=True)):
        counts = Counter(met)
        many += len(counts) > 8
        first = list(dict.fromkeys(met))[:8]
        order = sorted(first, key=lambda i, counts=counts: (-counts[i], i))[:6]
        expected = [(as_float(i), np.float32(counts[i]) / np.float32(spp)) for i in order]
        expected += [(np.float32(0), np.float32(0))] * (6 - len(expected))
        np.testing.assert_array_equal(ranks[pixel], expected)
    assert 1 <= many < 8  # both cases were there


def test_mattes_do_not_depend_on_how_the_work_is_divided() -> None:
    prepared = ph.prepare(crowd(40))

    def ranks(**how: object) -> bytes:
        seen = ph.render(prepared, features=True, spp=64, width=24, height=9, **how).features
        return b"".join(seen[layer].tobytes() for layer in cryptomatte.LAYERS)

    expected = ranks(threads=1)
    assert ranks(threads=3, tile=5) == expected
    assert ranks(threads=2, schedule="static", tile=1) == expected
    assert ranks(threads=2, progress=lambda _: None) == expected  # in passes
    for isa in _core.instruction_sets():
        assert ranks(threads=2, isa=isa) == expected


def test_instances_holes_glass_and_sky() -> None:
    """The mattes of all shapes and the sky sum up to 1, and each is where its shape is seen."""
    grey, net = ph.Material("diffuse"), ph.Material("diffuse", opacity=0.25)
    ball = ph.Spheres([[0, 0, 0]], 0.4, ph.Material("metal"), name="ball")
    moves = np.tile(np.eye(3, 4), (2, 1, 1))
    moves[:, 0, 3] = [-3.5, -0.5]
    scene = FLAT.replace(
        materials={"glass": ph.Material("dielectric"), "net": net, "grey": grey},
        shapes=[
            ph.Instances([ball, replace(ball, name="copied", centers=[[1, 0, 0]])], moves),
            ph.Spheres([[2.5, 0, 1]], 1.0, "glass", name="lens"),
            rectangle(1, 4, -2, material="grey", name="wall"),
            rectangle(-4, 0, 2, material="net", name="net"),
            rectangle(-9, 9, -3, material="net", name="net"),
        ],
        background=None,
    )
    image = ph.render(scene, features=True, integrator="ao", width=32, height=4, spp=64)
    objects = {name: image.matte(shape=name) for name in ("instances", "lens", "wall", "net")}
    things = {name: image.matte(material=name) for name in ("metal", "glass", "grey", "net")}
    hit = image.features["coverage"].reshape(4, 32)
    for mattes in (objects, things):
        np.testing.assert_allclose(sum(mattes.values()), hit, atol=1e-6)
        assert 0.01 < mattes["net"][:, 16:20].mean() < 0.99
    np.testing.assert_array_equal(objects["instances"], things["metal"])
    np.testing.assert_array_equal(objects["lens"], things["glass"])
    # glass hides what is behind it, holes let it through
    assert objects["lens"][1:3, 24:28].min() == 1
    assert objects["wall"][:, 20:22].min() == 1
    assert objects["wall"][1:3, 24:28].max() == 0
    middle = objects["instances"][1:3, 1:3]  # a ball behind a net of a quarter
    assert abs(middle.mean() - 0.75) < 0.1
    # two shapes of one name are one: a quarter, and a quarter of the rest
    nets = objects["net"][:, 8:12]
    assert abs(nets.mean() - (1 - 0.75**2)) < 0.03
    ids = image.features["CryptoObject"][:, 8:12, :, 0]
    assert np.count_nonzero(ids == as_float(cryptomatte.matte_id("net"))) == nets.size
    # what instances copy has no matte of its own
    with pytest.raises(ph.SceneError, match=r"unknown shape 'ball'.*\(choices: instances, lens,"):
        image.matte(shape="ball")


# --- Names ---------------------------------------------------------------------------------------


def test_what_has_no_name_is_told_apart_by_a_number() -> None:
    metal = ph.Material("metal", fuzz=0.5)
    scene = FLAT.replace(
        materials={"diffuse": metal},
        shapes=[
            rectangle(-4, -3),
            rectangle(-3, -2, name="mesh 2", material="diffuse"),
            rectangle(-2, -1, material=ph.Material("diffuse", color=(0.1, 0.1, 0.1))),
            rectangle(-1, 0, name="twin", material=ph.Material("metal")),
            rectangle(0, 1, name="twin"),
        ],
    )
    flat = flatten(scene)
    assert flat.object_names == ["mesh", "mesh 2", "mesh 3", "twin", "twin"]
    assert flat.material_names == ["diffuse", "diffuse 2", "diffuse 3", "metal"]
    image = ph.render(scene, features=True, spp=1)
    for names, place in (
        ({"shape": "mesh 3", "material": "diffuse 3"}, [2]),
        ({"shape": "mesh 2", "material": "diffuse"}, [1]),
        ({"shape": "twin"}, [3, 4]),
        ({"material": "diffuse 2"}, [0, 4]),
    ):
        for kind, name in names.items():
            assert np.flatnonzero(image.matte(**{kind: name})).tolist() == place


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"shape": "groud"}, "unknown shape 'groud'; did you mean 'ground'.*choices: glass, gro"),
        ({"material": "glas"}, "unknown material 'glas'; did you mean 'glass'"),
        ({}, "the name of a shape or of a material"),
        ({"shape": "ground", "material": "ground"}, "one of the two"),
        ({"shape": "ground"}, "must be rendered with features=True"),
    ],
)
def test_mattes_that_are_not_there(asked: dict[str, str], told: str) -> None:
    image = ph.render(ph.weekend(), width=8, spp=1)
    with pytest.raises(ph.SceneError, match=f"^matte: .*{told}"):
        image.matte(**asked)


# --- Files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [32, 16])
def test_an_exr_file_is_a_cryptomatte(bits: int, tmp_path: Path) -> None:
    names = ["mädchen", 'with "quotes", a\\ and a\nline', "hello"]
    materials = {name: ph.Material("diffuse") for name in names}
    shapes = [
        rectangle(-4 + 2.3 * k, -4 + 2.3 * (k + 1), material=name, name=name[::-1])
        for k, name in enumerate(names)
    ]
    image = ph.render(FLAT.replace(shapes=shapes, materials=materials), features=True, spp=16)
    image.save(tmp_path / "a.exr", bits=bits)
    _, told = read_picture(tmp_path / "a.exr")
    found = {
        told[key]: key.removesuffix("/name")
        for key in told
        if key.startswith("cryptomatte/") and key.endswith("/name")
    }
    assert set(found) == {"CryptoObject", "CryptoMaterial"}
    for layer, key in found.items():
        assert len(key) == len("cryptomatte/") + 7
        assert told[f"{key}/hash"] == "MurmurHash3_32"
        assert told[f"{key}/conversion"] == "uint32_to_float32"
        manifest = json.loads(told[f"{key}/manifest"])
        kind = {"CryptoObject": "shape", "CryptoMaterial": "material"}[layer]
        assert list(manifest) == [n[::-1] if kind == "shape" else n for n in names]
        # as a compositor reads it: no more than the manifest and the channels in their order
        channels = [f"{layer}{i:02d}.{c}" for i in range(3) for c in "RGBA"]
        stored, _ = read_picture(tmp_path / "a.exr", channels)
        for name, digits in manifest.items():
            its_own = stored[..., 0::2].view(np.uint32) == int(digits, 16)
            matte = (stored[..., 1::2] * its_own).sum(axis=-1)
            np.testing.assert_array_equal(matte, image.matte(**{kind: name}))
            assert 0 < matte.sum() < 8


def test_other_pictures_say_nothing_of_mattes(tmp_path: Path) -> None:
    seen = ph.render(ph.weekend(), width=8, spp=1, features=True)
    seen.save(tmp_path / "a.png")
    ph.render(ph.weekend(), width=8, spp=1).save(tmp_path / "b.exr")
    for name in ("a.png", "b.exr"):
        _, told = read_picture(tmp_path / name)
        assert not [key for key in told if key.startswith("cryptomatte")]
        assert "CryptoObject" not in told["ImageDescription"]
