"""Scenes written to files: what comes back, and what becomes of older files."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import cli
from parhelion.flatten import flatten
from parhelion.image import encoded
from parhelion.io.meshes import ply

RANDOM = np.random.default_rng(7)


def picture(scene: ph.Scene, **settings: Any) -> np.ndarray:
    """A few samples of a few pixels."""
    chosen = {"width": 48, "height": 32, "spp": 2, "max_depth": 8} | settings
    return ph.render(scene, threads=2, **chosen).pixels


def torus(rings: int = 24, around: int = 12) -> ph.Mesh:
    """A torus around y with normals and texture coordinates, in two materials."""
    u, v = np.meshgrid(np.linspace(0, 1, rings + 1), np.linspace(0, 1, around + 1), indexing="ij")
    a, b = 2 * np.pi * u.ravel(), 2 * np.pi * v.ravel()
    normals = np.stack([np.cos(a) * np.cos(b), np.sin(b), -np.sin(a) * np.cos(b)], axis=1)
    middle = np.stack([np.cos(a), np.zeros_like(a), -np.sin(a)], axis=1)
    corner = np.arange(rings * (around + 1)).reshape(rings, around + 1)[:, :-1].ravel()
    right = corner + around + 1
    faces = np.stack([corner, right, right + 1, corner, right + 1, corner + 1], axis=1)
    return ph.Mesh(
        np.float32(middle + 0.4 * normals),
        faces.reshape(-1, 3),
        normals=np.float32(normals),
        uvs=np.float32(np.stack([u.ravel(), v.ravel()], axis=1)),
        material=np.repeat(["painted", "gold"], [rings * around, rings * around]),
        name="torus",
    )


def full_scene() -> ph.Scene:
    """Every kind of shape, and textures, lights and settings of many kinds."""
    pixels = RANDOM.integers(0, 256, (8, 8, 3), np.uint8)
    wood = ph.Texture("image", image=pixels, transform=[[2, 0, 0], [0, 2, 0]])
    age = ph.Texture("attribute", name="vertex_age")
    mesh = torus()
    mesh = ph.Mesh(
        mesh.vertices,
        mesh.faces,
        mesh.normals,
        mesh.uvs,
        mesh.material,
        attributes={"vertex_age": RANDOM.random(len(np.asarray(mesh.vertices)), np.float32)},
    )
    balls = ph.Spheres(
        RANDOM.normal(size=(60, 3)),
        RANDOM.uniform(0.02, 0.1, 60),
        material=np.arange(60) % 3,
        colors=RANDOM.random((60, 3), np.float32),
        rotation=np.eye(3)[[1, 2, 0]],
    )
    turns = np.tile(np.eye(4), (40, 1, 1))
    turns[:, :3] += RANDOM.normal(size=(40, 3, 4)) * 0.2
    part = ph.Cylinders([[0, 0, 0]], [[0, 0.3, 0]], 0.05, name="rod")
    strands = ph.Curves(
        RANDOM.normal(size=(50, 3)), np.full(50, 0.02, np.float32), np.full(10, 5), "bspline"
    )
    disks = ph.Disks([[0, -1, 0]], [[0, 0, 3]], [[3, 0, 0]], "painted", inside_out=False)
    return ph.Scene(
        [mesh, balls, disks, strands, ph.Instances([part], turns[:, :3])],
        {
            "painted": ph.Material("diffuse", color=wood, roughness=0.3),
            "gold": ph.Material("principled", metallic=1.0, color=(0.9, 0.7, 0.2), roughness=age),
            "two": ph.Material("blend", a="painted", b=ph.Material("dielectric"), weight=wood),
        },
        ph.Framing((1.0, 1.0, 2.0), shapes=("mesh",)),
        ph.Background("envmap", image=RANDOM.random((8, 16, 3), np.float32) * 3),
        ph.Settings(width=64, height=40, sampler="independent"),
        "everything",
        [ph.Light("point", position=(2, 3, 1), intensity=(5, 5, 5))],
    )


# --- JSON with a side file -----------------------------------------------------------------------


@pytest.mark.parametrize("make", [full_scene, ph.weekend])
def test_json_gives_the_same_picture_to_the_last_bit(
    tmp_path: Path, make: Callable[[], ph.Scene]
) -> None:
    scene = make()
    ph.save(scene, tmp_path / "a.json")
    again = ph.load(tmp_path / "a.json")
    assert flatten(again).sha256() == flatten(scene).sha256()
    assert (again.camera, again.settings, again.name) == (scene.camera, scene.settings, scene.name)
    assert np.array_equal(picture(again), picture(scene))
    document = json.loads((tmp_path / "a.json").read_text())
    side = tmp_path / document["arrays"]["file"]
    assert re.fullmatch(r"a\.[0-9a-f]{16}\.bin", side.name)
    assert side.stat().st_size == document["arrays"]["bytes"]
    assert (tmp_path / "a.json").stat().st_size < 12_000  # of weekend, which has 75 materials
    ph.save(again, tmp_path / "a.json")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["a.json", side.name])


@pytest.mark.parametrize(
    "name",
    [
        "pbrt-v1v3/arcsphere-v3/arcsphere.pbrt",
        "gltf/khronos-small/CesiumMilkTruck.glb",
        "particles/chemfiles/gro/1vln-triclinic.gro",
    ],
)
def test_scenes_of_others_as_json(tmp_path: Path, shared_scenes: Path, name: str) -> None:
    scene = ph.load(shared_scenes / name)
    ph.save(scene, tmp_path / "a.json")
    again = ph.load(tmp_path / "a.json")
    settings = {"width": 40, "height": 30, "spp": 1}
    assert np.array_equal(picture(again, **settings), picture(scene, **settings))


def test_the_side_file_is_as_the_manual_says(tmp_path: Path) -> None:
    centers = RANDOM.normal(size=(20, 3)).astype(np.float32)
    ph.save(ph.Scene([ph.Spheres(centers), ph.Spheres(centers)]), tmp_path / "a.json")
    document = json.loads((tmp_path / "a.json").read_text())
    places = [shape["centers"] for shape in document["shapes"]]
    assert places[0] == places[1] == {"shape": [20, 3], "type": "float32", "at": 0}
    side = tmp_path / document["arrays"]["file"]
    assert np.array_equal(np.fromfile(side, "<f4", count=60).reshape(20, 3), centers)
    one, other = ph.load(tmp_path / "a.json").shapes
    assert one.centers is other.centers
    assert one.centers.dtype == np.float32


def test_what_is_small_has_no_side_file_and_what_is_empty_is_left_out(tmp_path: Path) -> None:
    shapes = [ph.Spheres([[0, 0, 0]]), ph.Spheres(np.empty((0, 3)), name="none")]
    ph.save(ph.Scene(shapes), tmp_path / "a.json")
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
    assert [s.name for s in ph.load(tmp_path / "a.json").shapes] == ["spheres"]


def test_pictures_outside_of_the_folder_come_along(tmp_path: Path) -> None:
    pixels = RANDOM.integers(0, 256, (6, 5, 3), np.uint8)
    (tmp_path / "out").mkdir()
    for file in (tmp_path / "outside.png", tmp_path / "out" / "inside.png"):
        file.write_bytes(encoded(pixels, {}, ".png"))
        color = ph.Texture("image", image=str(file))
        scene = ph.Scene(materials={"a": ph.Material("diffuse", color=color)})
        ph.save(scene, tmp_path / "out" / "a.json")
        image = ph.load(tmp_path / "out" / "a.json").materials["a"].params["color"].params["image"]
        if file.name == "outside.png":
            assert np.array_equal(image, pixels)
        else:
            assert Path(image) == file


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """A document with a side file of 60 float32."""
    ph.save(ph.Scene([ph.Spheres(RANDOM.random((20, 3), np.float32))]), tmp_path / "a.json")
    return tmp_path / "a.json"


def side_of(document: Path) -> Path:
    return document.parent / json.loads(document.read_text())["arrays"]["file"]


def refusal(document: Path) -> str:
    with pytest.raises(ph.FormatError) as caught:
        ph.load(document)
    assert str(caught.value).startswith(f"{document}: $.")
    return str(caught.value)


def test_side_files_that_do_not_belong_are_refused(stored: Path) -> None:
    side = side_of(stored)
    data = side.read_bytes()
    side.write_bytes(data[:-4])
    assert "$.arrays.bytes: is 240, but" in refusal(stored)
    side.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert "$.arrays.sha256: is not that of" in refusal(stored)
    side.unlink()
    assert "no such file" in refusal(stored)
    side.symlink_to("/dev/zero")
    assert "is not inside the scene's folder" in refusal(stored)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (
            {"at": 64},
            "float32 of shape (20, 3) from byte 64 ends at byte 304; the side file has 240",
        ),
        ({"at": 4}, "$.shapes[0].centers.at: is 4; must be a multiple of 64"),
        ({"at": -64}, "$.shapes[0].centers.at: is -64; must be an integer >= 0"),
        ({"at": 2**63}, "must be an integer <= 9223372036854775807"),
        ({"shape": [60]}, "$.shapes[0].centers.shape: is [60]; must be [N, 3]"),
        ({"shape": [2**31 - 1, 3]}, "the side file has 240"),
        ({"shape": [0, 3]}, "must be an integer >= 1"),
        ({"type": "float64"}, "ends at byte 480; the side file has 240"),
        ({"type": "float16"}, "unknown type 'float16'"),
        ({"type": None}, "$.shapes[0].centers.type: is null; must be a string"),
        ({"size": 3}, "unknown field 'size' (choices: at, shape, type)"),
    ],
)
def test_places_in_side_files_are_checked(stored: Path, place: Any, words: str) -> None:
    document = json.loads(stored.read_text())
    document["shapes"][0]["centers"] |= place
    stored.write_text(json.dumps(document))
    assert words in refusal(stored)


def test_stored_numbers_are_checked_as_others_are(stored: Path) -> None:
    document = json.loads(stored.read_text())
    place = document["shapes"][0]["centers"]
    document["shapes"][0]["material"] = {"shape": [20], "type": "uint32", "at": 0}
    stored.write_text(json.dumps(document))
    assert "$.shapes[0].material: has index" in refusal(stored)
    document["shapes"][0] = {"type": "spheres", "centers": place, "colors": place, "radii": 1}
    document["arrays"] = None
    stored.write_text(json.dumps(document))
    assert "is in a side file, which $.arrays does not name" in refusal(stored)
    scene = ph.Scene([ph.Spheres(np.full((20, 3), np.nan))])
    with pytest.raises(ph.SceneError, match=re.escape("$.shapes[0].centers: [0][0] is nan")):
        ph.save(scene, stored)


def test_the_older_pair_is_whole_until_the_new_one_is(
    stored: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {p.name: p.read_bytes() for p in stored.parent.iterdir()}
    other = ph.Scene([ph.Spheres(RANDOM.random((30, 3)))])
    move = os.replace

    def fails(source: Any, target: Any) -> None:
        if str(target).endswith(".json"):
            raise OSError(28, "No space left on device")
        move(source, target)

    monkeypatch.setattr(os, "replace", fails)
    with pytest.raises(ph.ResourceError, match="No space left"):
        ph.save(other, stored)
    assert {p.name: p.read_bytes() for p in stored.parent.iterdir()} == before
    monkeypatch.undo()
    ph.save(other, stored)
    assert len(list(stored.parent.iterdir())) == 2
    assert len(ph.load(stored).shapes[0].centers) == 30


def test_an_older_side_file_stays_for_a_copy_of_its_document(stored: Path) -> None:
    copy = stored.parent / "copy.json"
    copy.write_bytes(stored.read_bytes())
    ph.save(ph.Scene([ph.Spheres(RANDOM.random((30, 3)))]), stored)
    assert len(ph.load(copy).shapes[0].centers) == 20


def test_what_cannot_be_saved(tmp_path: Path) -> None:
    with pytest.raises(ph.FormatError, match=r"unknown ending of a scene to write '\.xyz'"):
        ph.save(ph.Scene(), tmp_path / "a.xyz")
    with pytest.raises(ph.SceneError, match="a Scene is needed, not ndarray"):
        ph.save(np.eye(3), tmp_path / "a.json")  # type: ignore[arg-type]
    with pytest.raises(ph.ResourceError, match="cannot be written: No such file or directory"):
        ph.save(ph.Scene(), tmp_path / "none" / "a.json")
    assert list(tmp_path.iterdir()) == []


# --- PLY -----------------------------------------------------------------------------------------


def test_a_mesh_as_ply_is_the_same_to_the_last_bit(tmp_path: Path) -> None:
    mesh = replace(torus(), material=ph.Material("diffuse"))
    ph.save(ph.Scene([mesh], background=None), tmp_path / "a.ply", strict=True)
    (again, *_) = ph.load(tmp_path / "a.ply").shapes
    for name in ("vertices", "faces", "normals", "uvs"):
        assert np.array_equal(getattr(again, name), getattr(mesh, name)), name
    assert np.array_equal(picture(ph.load(tmp_path / "a.ply")), picture(ph.scene_of(mesh, up="y")))


def test_colours_of_meshes_as_ply(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = torus()
    names = {"painted": ph.Material("metal", color=(1, 0, 0)), "gold": ph.Material("diffuse")}
    ph.save(ph.Scene([mesh], names, background=None), tmp_path / "a.ply")
    assert caplog.messages == [
        "a.ply: materials: PLY has colours only; all else is left out",
    ]
    colors = ph.load(tmp_path / "a.ply").shapes[0].attributes["face_color"]
    assert np.array_equal(colors[0], [1, 0, 0])
    # half of a step of 8-bit sRGB next to white is 0.0045
    np.testing.assert_allclose(colors[-1], 0.8, atol=0.0045)
    by_vertex = np.linspace(0, 1, 3 * len(mesh.vertices)).reshape(-1, 3)
    shown = ph.Material("diffuse", color=ph.Texture("attribute", name="vertex_color"))
    fields = {"vertex_color": by_vertex, "vertex_wind": by_vertex, "face_age": np.arange(576)}
    mesh = replace(mesh, material=shown, attributes=fields)
    ph.save(ph.Scene([mesh], background=None), tmp_path / "a.ply", strict=True)
    again = ply.read(tmp_path / "a.ply").attributes
    np.testing.assert_allclose(again["vertex_color"], by_vertex, atol=0.0045)
    np.testing.assert_array_equal(again["vertex_wind"], np.float32(by_vertex))
    np.testing.assert_array_equal(again["face_age"], np.arange(576))


def test_copies_as_ply_are_multiplied_out(tmp_path: Path) -> None:
    flat = ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="flat")
    turns = np.stack([np.eye(4)[:3], np.diag([-1.0, 2.0, 1.0, 1.0])[:3]])
    turns[1, 2, 3] = 5.0
    scene = ph.Scene([ph.Instances([flat], turns), replace(flat, inside_out=True)], background=None)
    ph.save(scene, tmp_path / "a.ply", strict=True)
    found = ply.read(tmp_path / "a.ply")
    corners = found.vertices[found.faces]
    assert np.array_equal(corners[1], [[0, 2, 5], [-1, 0, 5], [0, 0, 5]])
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.array_equal(np.sign(normals[:, 2]), [1, 1, -1])
    assert found.normals is None
    # beside a mesh that has normals, flat faces get their own
    scene = ph.Scene([flat, replace(flat, normals=[[0, 0, 1]] * 3)], background=None)
    ph.save(scene, tmp_path / "a.ply", strict=True)
    assert np.array_equal(ply.read(tmp_path / "a.ply").normals, [[0, 0, 1]] * 6)


def test_spheres_as_ply_are_points(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    balls = full_scene().shapes[1]
    names = full_scene().materials
    ph.save(ph.Scene([balls], names, background=None), tmp_path / "a.ply")
    assert [m.split(":")[1] for m in caplog.messages] == [" textures", " materials"]
    again = ph.load(tmp_path / "a.ply").shapes[0]
    assert np.array_equal(again.centers, np.float32(balls.centers))
    assert np.array_equal(again.radii, np.float32(balls.radii))
    np.testing.assert_allclose(again.colors, balls.colors, atol=0.0045)


def test_what_ply_cannot_hold_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = full_scene()
    mesh, balls, disks, strands, _ = scene.shapes
    rest = scene.replace(shapes=(mesh, balls, disks, strands), camera=ph.Camera())
    ph.save(rest, tmp_path / "a.ply")
    assert [m.split(": ")[1] for m in caplog.messages] == [
        "curves",
        "disks",
        "spheres",
        "camera",
        "lights and background",
        "textures",
        "materials",
    ]
    before = (tmp_path / "a.ply").read_bytes()
    with pytest.raises(ph.FormatError, match=r"strict, and not all of it is supported:\n  curves"):
        ph.save(rest, tmp_path / "a.ply", strict=True)
    with pytest.raises(ph.SceneError, match="the scene has no mesh and no spheres"):
        ph.save(scene.replace(shapes=[strands]), tmp_path / "a.ply")
    with pytest.raises(ph.FormatError, match="has copies of cylinders"):
        ph.save(scene, tmp_path / "a.ply")
    many = ph.Instances([mesh], np.tile(np.eye(4), (200_000, 1, 1)))
    with pytest.raises(ph.FormatError, match="the copies make more than 100,000,000 triangles"):
        ph.save(scene.replace(shapes=[many]), tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_bytes() == before


# --- parhelion convert ---------------------------------------------------------------------------


def test_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "a.xyz", tmp_path / "b.json"
    source.write_text("3\nwater\nO 0 0 0.1\nH 0 0.76 -0.47\nH 0 -0.76 -0.47\n")
    assert cli.main(["convert", str(source), str(out), "--radius", "covalent"]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert re.fullmatch(rf"{re.escape(str(out))}: 2 shapes in \d+\.\d\d s\n", said.err)
    # JSON files get no light when they are read, so that of particles is written
    options = ph.LoadOptions(radius="covalent")
    assert np.array_equal(picture(ph.load(out)), picture(ph.load(source, options)))
    # PLY files do
    assert cli.main(["convert", str(source), str(tmp_path / "b.ply"), "-q"]) == 0
    assert capsys.readouterr().err == ""
    assert [s.name for s in ph.load(tmp_path / "b.ply").shapes] == ["particles", "key light"]


def test_convert_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "a.json"
    ph.save(full_scene(), source)
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    link = tmp_path / "same.json"
    link.symlink_to(source)
    for words, reason in (
        (["a.json", "same.json"], "same.json: is the file to convert; give the result another"),
        (["none.json", "b.json"], "none.json: no such file"),
        (["a.json", "b.png"], "b.png: unknown ending of a scene to write '.png' (choices: "),
        (["a.json", "b.ply"], "has copies of cylinders"),
        (["a.json", "x/b.json"], "b.json: cannot be written: No such file or directory"),
        (["a.json", "b.json", "--time", "3"], "the option 'time' is not for Parhelion scene"),
    ):
        paths = [str(tmp_path / w) for w in words[:2]]
        assert cli.main(["convert", *paths, *words[2:]]) == 2
        said = capsys.readouterr().err
        assert reason in said
        assert said.startswith("parhelion: error: ")
    link.unlink()
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before
    with pytest.raises(SystemExit):
        cli.main(["convert", str(source)])
