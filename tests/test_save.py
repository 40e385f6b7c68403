"""Scenes written to files: what comes back, and what becomes of older files."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core, cli, tables
from parhelion.flatten import block, flatten
from parhelion.framing import bounds
from parhelion.image import encoded, read_pixels
from parhelion.io.gltf import solids
from parhelion.io.meshes import ply
from parhelion.spectra import decode_srgb
from parhelion.studio import dressed, framing

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
    slanted = np.stack([-np.sin(a), np.sin(b), -np.cos(a), np.copysign(1.0, np.sin(a))], axis=1)
    return ph.Mesh(
        np.float32(middle + 0.4 * normals),
        faces.reshape(-1, 3),
        normals=np.float32(normals),
        uvs=np.float32(np.stack([u.ravel(), v.ravel()], axis=1)),
        material=np.repeat(["painted", "gold"], [rings * around, rings * around]),
        name="torus",
        tangents=np.float32(slanted),
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
        tangents=mesh.tangents,
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
            "painted": ph.Material("diffuse", color=wood, roughness=0.3, normal_map=wood),
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
        "bitterli-cornell-box/scene-v4.pbrt",
        "gltf/khronos-small/BoxTextured.glb",
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
    with pytest.raises(ph.SceneError, match=r"shape 'spheres': centers\[0\] is not finite"):
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


def test_copies_of_spheres_as_ply_are_points(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    balls = ph.Spheres([[0, 0, 0], [1, 0, 0]], [0.25, 0.5], colors=[[1, 0, 0], [0, 0, 1]])
    plain = ph.Spheres([[0, 0, 1]], 2.0)
    turns = np.tile(np.eye(4), (3, 1, 1))
    turns[1, :3, :3] = 2 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    turns[1, :3, 3] = (5, 6, 7)
    turns[2] = np.diag([1, 1, -1, 1])
    green = np.tile([0, 1, 0], (3, 1))
    copies = ph.Instances([balls, plain], turns, "copies", green)
    ph.save(ph.Scene([copies], background=None), tmp_path / "a.ply", strict=True)
    again = ph.load(tmp_path / "a.ply").shapes[0]
    pairs = [[0, 0, 0], [1, 0, 0], [5, 6, 7], [5, 8, 7], [0, 0, 0], [1, 0, 0]]
    singles = [[0, 0, 1], [5, 6, 9], [0, 0, -1]]
    np.testing.assert_array_equal(again.centers, [*pairs, *singles])
    np.testing.assert_array_equal(again.radii, [0.25, 0.5, 0.5, 1, 0.25, 0.5, 2, 4, 2])
    np.testing.assert_array_equal(again.colors, [[1, 0, 0], [0, 0, 1]] * 3 + [[0, 1, 0]] * 3)
    # of several materials, and stretched
    mixed = ph.Spheres([[0, 0, 0], [1, 0, 0]], material=["a", "b"])
    names = {k: ph.Material("diffuse", color=(1.0 * (k == "a"), 0, 0)) for k in "ab"}
    turns[1, 0] *= 1.5
    copies = ph.Instances([mixed], turns, "mixed")
    ph.save(ph.Scene([copies], names, background=None), tmp_path / "a.ply")
    np.testing.assert_array_equal(ph.load(tmp_path / "a.ply").shapes[0].colors[:, 0], [1, 0, 1, 0])
    assert caplog.messages == [
        "a.ply: shape 'mixed': copies of spheres that are ellipsoids: PLY has none; left out"
    ]
    stretched = ph.Scene([replace(copies, transforms=turns[1:2])], names, background=None)
    with pytest.raises(ph.SceneError, match="no mesh and no spheres; shape 'mixed': copies of sph"):
        ph.save(stretched, tmp_path / "a.ply")


def test_attributes_that_some_meshes_lack_are_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    flat = ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], attributes={"face_age": [1]})
    scene = ph.Scene([flat, replace(flat, attributes={})], background=None)
    ph.save(scene, tmp_path / "a.ply")
    assert caplog.messages == [
        "a.ply: attribute 'face_age': not of all meshes, or no name for PLY; left out"
    ]
    assert ply.read(tmp_path / "a.ply").attributes == {}


def test_colours_and_holes_by_attributes_that_are_not_there_as_gltf(tmp_path: Path) -> None:
    none = ph.Texture("attribute", name="face_none")
    hole = ph.Material("diffuse", color=none, opacity=none)
    turned = ph.Material("diffuse", color=ph.Texture("image", image=GREY, uvs="face_none"))
    shapes = [ph.Spheres([[0, 0, 0]], material=hole), replace(torus(), material=turned)]
    ph.save(ph.Scene(shapes, **LIT), tmp_path / "a.glb")
    again = ph.load(tmp_path / "a.glb")
    # as in the scene, where what is not there is black; the same everywhere, so no attribute
    params = again.materials[alone(again)[0].material].params
    assert (params["color"], params["opacity"]) == ((0.0, 0.0, 0.0), 0.0)


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
    with pytest.raises(ph.FormatError, match="cylinders: PLY has triangles or points; left out"):
        ph.save(scene, tmp_path / "a.ply", strict=True)  # copies of them
    many = ph.Instances([mesh], np.tile(np.eye(4), (200_000, 1, 1)))
    with pytest.raises(ph.SceneError, match="the copies make more than 100,000,000 triangles"):
        ph.save(scene.replace(shapes=[many]), tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_bytes() == before


# --- glTF ----------------------------------------------------------------------------------------

LIT = {"background": None, "camera": ph.Camera((0.5, 3.0, 5.0), (0.0, 0.0, 0.0), vfov=35.0)}


def alone(scene: ph.Scene) -> list[Any]:
    """The shapes of a scene without what dark ones get."""
    return [s for s in scene.shapes if s.name not in ("key light", "ground")]


def triangles(shapes: Sequence[Any]) -> np.ndarray:
    """(N, 3, 3) corners of all meshes, copies included."""
    found = []
    for shape in shapes:
        parts = shape.shapes if isinstance(shape, ph.Instances) else [shape]
        turns = shape.transforms if isinstance(shape, ph.Instances) else np.eye(4)[None]
        for part in parts:
            corners = np.asarray(part.vertices, np.float64)[np.asarray(part.faces)]
            for turn in np.asarray(turns):
                found.append(corners @ turn[:3, :3].T + turn[:3, 3])
    return np.concatenate(found)


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_a_mesh_as_gltf_gives_the_same_picture(tmp_path: Path, ending: str) -> None:
    pixels = RANDOM.integers(0, 256, (8, 8, 3), np.uint8)
    image = ph.Texture("image", image=pixels, transform=[[0, 2, 0.1], [-3, 0, 0.2], [0, 0, 1]])
    materials = {
        "painted": ph.Material("principled", color=image, normal_map=image),
        "gold": ph.Material("principled", metallic=1.0, color=(0.9, 0.7, 0.2), roughness=0.3),
    }
    scene = ph.Scene([torus()], materials, **LIT)
    ph.save(scene, tmp_path / f"a.{ending}", strict=True)
    again = ph.load(tmp_path / f"a.{ending}", ph.LoadOptions(ground=False))
    # v runs down in glTF, and 1 - (1 - v) is v but for 2^-25: so are texture coordinates
    shown = np.abs(picture(again, spp=8) - picture(dressed(scene, bare=True), spp=8))
    assert np.quantile(shown, 0.99) < 1e-5
    assert shown.max() < 2e-3
    assert np.array_equal(triangles(alone(again)), triangles([torus()]))
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.load(tmp_path / f"a.{ending}")
    assert sorted(len(g.faces) for g in mesh.geometry.values()) == [288, 288]
    names = {g.visual.material.name for g in mesh.geometry.values()}
    assert names == set(materials)


GREY = np.full((2, 2), 128, np.uint8)
NUMBER = ph.Texture("image", image=RANDOM.integers(0, 256, (4, 4), np.uint8), channel="g")
COLOR = ph.Texture("image", image=RANDOM.integers(0, 256, (4, 4, 3), np.uint8), color_space="srgb")
EVERYTHING = ph.Material(
    "principled",
    color=(0.5, 0.25, 0.125),
    metallic=0.5,
    roughness=0.25,
    ior=1.4,
    specular=0.75,
    specular_color=(0.5, 1.0, 1.0),
    transmission=0.5,
    absorption=(0.5, 1.0, 2.0),
    clearcoat=0.5,
    clearcoat_roughness=0.125,
    sheen_color=(0.5, 0.5, 0.25),
    sheen_roughness=0.75,
    iridescence=0.5,
    iridescence_ior=1.5,
    iridescence_thickness=300.0,
    dispersion=0.25,
    emission=(4.0, 2.0, 1.0),
    opacity=0.5,
)


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (EVERYTHING, EVERYTHING),
        (
            ph.Material("principled", anisotropy=0.5, anisotropy_rotation=30.0, roughness=0.5),
            {"anisotropy": 0.5, "anisotropy_rotation": 30.0, "roughness": 0.5},
        ),
        (ph.Material("principled", anisotropy=0.99, roughness=0.2), {"anisotropy": 0.99}),
        (
            ph.Material("diffuse", color=(0.5, 0.5, 0.5)),
            {"color": (0.5, 0.5, 0.5), "metallic": 0.0, "specular": 0.0},
        ),
        (
            ph.Material("dielectric", ior=1.25, color=(0.5, 0.5, 1.0), roughness=0.5),
            {"transmission": 1.0, "ior": 1.25, "color": (0.5, 0.5, 1.0), "roughness": 0.5},
        ),
        (ph.Material("dielectric", ior=0.8), {"ior": 1.25, "transmission": 1.0}),
        (
            ph.Material("thin_dielectric", transmittance=(0.5, 1, 1)),
            ph.Material("thin_dielectric", ior=1.5, transmittance=(0.5, 1.0, 1.0)),
        ),
        (
            ph.Material(
                "thin_dielectric", roughness=0.5, color=(0.5, 1, 1), transmittance=(1, 1, 0)
            ),
            ph.Material("thin_dielectric", roughness=0.5, transmittance=(0.5, 1.0, 0.0)),
        ),
        (
            ph.Material("plastic", color=(0.5, 0, 0), ior=1.6),
            {"color": (0.5, 0.0, 0.0), "ior": 1.6, "metallic": 0.0},
        ),
        (
            ph.Material("emissive", radiance=(2, 4, 8)),
            {"emission": (2.0, 4.0, 8.0), "two_sided_emission": True, "color": (0.0, 0.0, 0.0)},
        ),
        (ph.Material("null"), {"opacity": 0.0}),
        (
            ph.Material(
                "blend",
                a=ph.Material("principled", color=(0.5, 0.5, 0.5)),
                b=ph.Material("thin_dielectric", transmittance=(0.5, 0.5, 0.5)),
                weight=0.25,
            ),
            {"weight": 0.25},
        ),
    ],
)
def test_materials_as_gltf(tmp_path: Path, given: ph.Material, read: Any) -> None:
    ph.save(ph.Scene([replace(torus(), material=given)], **LIT), tmp_path / "a.glb")
    (found,) = ph.load(tmp_path / "a.glb").materials.values()
    wanted = read.params if isinstance(read, ph.Material) else read
    assert isinstance(read, dict) or found.type == read.type
    for name, value in wanted.items():
        # as float32, if not exactly
        np.testing.assert_allclose(found.params[name], value, rtol=3e-4, err_msg=name)


@pytest.mark.parametrize("roughness", [0.0, 0.3])
def test_a_nonlinear_plastic_as_gltf_is_as_bright(tmp_path: Path, roughness: float) -> None:
    whole = np.full((2, 2, 3), (243, 188, 89), np.uint8)
    linear = np.float32(decode_srgb(whole / 255.0))
    color = tuple(linear[0, 0].tolist())
    for given in (color, *(ph.Texture("image", image=image) for image in (whole, linear))):
        params: dict[str, Any] = {"nonlinear": "on", "ior": 1.5, "roughness": roughness}
        material = ph.Material("plastic", color=given, **params)
        ph.save(ph.Scene([replace(torus(), material=material)], **LIT), tmp_path / "a.glb")
        (found,) = ph.load(tmp_path / "a.glb").materials.values()
        texture = found.params["color"]
        if isinstance(texture, ph.Texture):
            stored = read_pixels(texture.params["image"])[0, 0]
            again = tuple(decode_srgb(stored / np.iinfo(stored.dtype).max))
            found = ph.Material("principled", **{**found.params, "color": again})
        material = ph.Material("plastic", color=color, **params)
        one, other = (scattered(m, 20_000, False)[0] for m in (material, found))
        np.testing.assert_allclose(other, one, atol=6e-3)


def variants(kind: str) -> Iterator[dict[str, Any]]:
    """A material as it is, and with each parameter at another value; smooth and rough."""
    listed = tables.tables()["materials"][kind].params
    # what others are nothing without
    whole: dict[str, Any] = {}
    if kind == "principled":
        whole = {"clearcoat": 0.5, "iridescence": 0.5, "sheen_color": (0.5, 0.4, 0.3)}
    for param in (None, *listed):
        made = dict(whole)
        if param is not None and param.choices:
            made[param.name] = param.choices[1 - int(param.default[0])]
        elif param is not None:
            low, high = max(param.low, 0.0), min(param.high, 4.0)
            values = [low + (high - low) * x for x in (0.25, 0.4, 0.6)]
            made[param.name] = values[0] if param.size == 1 else tuple(values)
        yield made
        if any(p.name == "roughness" for p in listed):
            yield {"roughness": 0.5} | made


def scattered(material: ph.Material, count: int, rough: bool) -> tuple[list[Any], list[Any]]:
    """From two sides, by so many samples, the shares of light that come back and that pass; and, of
    what is rough, the densities of both over directions.
    """
    listed = tables.tables()["materials"][material.type].params
    plain = {p.name: material.params[p.name] for p in listed if p.name in material.params}
    made = block("materials", material.type, plain, "test")
    towards = np.random.default_rng(1).normal(size=(200, 3))
    towards = np.float32(towards / np.linalg.norm(towards, axis=1, keepdims=True))
    shares, densities = [], []
    for out in ((0.3, 0.2, 0.933), (0.97, -0.1, -0.222)):
        wi, weight, _, _ = _core.bsdf_sample(made, out, 3, count)
        back = (wi[:, 2] * out[2] > 0.0)[:, None]
        shares += [(weight * back).mean(axis=0), (weight * ~back).mean(axis=0)]
        if rough:
            densities.append(_core.bsdf_eval(made, out, towards)[0])
    return shares, densities


@pytest.mark.parametrize("kind", sorted(tables.tables()["materials"]))
def test_what_gltf_changes_of_a_material_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    """Read again, it scatters the same, or there was a warning that names it."""
    exact = 0
    for params in variants(kind):
        material = ph.Material(kind, **params)
        caplog.clear()
        ph.save(ph.Scene([replace(torus(), material=material)], **LIT), tmp_path / "a.glb")
        told = [m for m in caplog.messages if f": {kind}" in m]
        assert len(told) == len(caplog.messages)
        if told:
            continue
        (found,) = ph.load(tmp_path / "a.glb").materials.values()
        rough = found.params.get("roughness", 1.0) >= 0.2
        count = 1_000 if found.type == kind else 20_000  # of the same kind, the same samples
        given, again = (scattered(m, count, rough) for m in (material, found))
        np.testing.assert_allclose(again[0], given[0], atol=6e-3, err_msg=str(material))
        np.testing.assert_allclose(again[1], given[1], atol=1e-3, err_msg=str(material))
        exact += 1
    assert exact or kind in ("conductor", "metal", "plastic")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"material": ph.Material("principled", two_sided=False)}, "two_sided"),
        ({"material": ph.Material("principled", roughness=1.0, anisotropy=0.9)}, "anisotropy of"),
        ({"material": ph.Material("diffuse", normal_map=ph.Texture("multiply", color0=COLOR,
          color1=(0.5, 1, 1)))}, "products of a normal map"),
        ({"material": ph.Material("diffuse", color=ph.Texture("multiply", color0=COLOR,
          color1=(2, 1, 1)))}, "textures times more than 1"),
        ({"material": ph.Material("blend", a=ph.Material("principled"), weight=0.5,
          b=ph.Material("thin_dielectric", roughness=0.5))}, "blend with a pane of another color"),
        ({"material": ph.Material("blend", a=ph.Material("principled", color=(1, 1, 1)),
          b=ph.Material("thin_dielectric", ior=1.3, roughness=0.5))}, "of another ior"),
        ({"material": ph.Material("blend", a=ph.Material("diffuse"), b=ph.Material("diffuse")),
          "colors": np.full((576, 3), 0.5)}, "colours of what is made of a blend"),
        ({"material": ph.Material("diffuse"), "normals": None}, "tangents without normals"),
    ],
)  # fmt: skip
def test_what_else_gltf_changes_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, change: dict[str, Any], words: str
) -> None:
    ph.save(ph.Scene([replace(torus(), **change)], **LIT), tmp_path / "a.glb")
    assert any(words in m for m in caplog.messages), caplog.messages


def test_a_sheet_as_gltf(tmp_path: Path) -> None:
    sheet = ph.Material(
        "diffuse_transmission", color=(0.3, 0.2, 0.1), transmittance=(0.1, 0.2, 0.5)
    )
    ph.save(ph.Scene([replace(torus(), material=sheet)], **LIT), tmp_path / "a.gltf", strict=True)
    (made,) = json.loads((tmp_path / "a.gltf").read_text())["materials"]
    found = made["extensions"]["KHR_materials_diffuse_transmission"]
    factor = found["diffuseTransmissionFactor"]
    through = np.array(found["diffuseTransmissionColorFactor"])
    back = np.array(made["pbrMetallicRoughness"]["baseColorFactor"][:3])
    np.testing.assert_allclose(factor * through, sheet.params["transmittance"])
    np.testing.assert_allclose((1 - factor) * back, sheet.params["color"])


def test_images_as_gltf_are_stored_as_they_are(tmp_path: Path) -> None:
    wide = ph.Texture("image", image=RANDOM.random((4, 4, 3), np.float32), color_space="linear")
    given = ph.Material(
        "principled",
        color=COLOR,
        roughness=NUMBER,
        metallic=ph.Texture("multiply", color0=NUMBER, color1=(0.5, 0.5, 0.5)),
        opacity=ph.Texture("checker", color0=(1, 1, 1), color1=(0.25, 0.25, 0.25)),
        emission=ph.Texture("multiply", color0=wide, color1=(8.0, 8.0, 8.0)),
        clearcoat=0.5,
        clearcoat_roughness=NUMBER,
    )
    ph.save(ph.Scene([replace(torus(), material=given)], **LIT), tmp_path / "a.glb")
    (found,) = ph.load(tmp_path / "a.glb").materials.values()
    p = found.params
    grey = NUMBER.params["image"][:, :, None]
    assert np.array_equal(read_pixels(p["roughness"].params["image"])[:, :, 1:2], grey)
    assert np.array_equal(
        read_pixels(p["metallic"].params["color0"].params["image"])[:, :, 2:], grey
    )
    assert p["metallic"].params["color1"] == (0.5, 0.5, 0.5)
    assert np.array_equal(read_pixels(p["clearcoat_roughness"].params["image"]), grey)
    light = read_pixels(p["emission"].params["color0"].params["image"]) / 65535.0
    assert p["emission"].params["color1"] == (8.0, 8.0, 8.0)
    np.testing.assert_allclose(decode_srgb(light), wide.params["image"], atol=4e-5)


def test_colours_of_faces_and_vertices_as_gltf(tmp_path: Path) -> None:
    mesh = torus()
    shown = ph.Material("diffuse", color=ph.Texture("attribute", name="vertex_color"))
    by_vertex = RANDOM.random((len(mesh.vertices), 3), np.float32)
    by_face = RANDOM.random((len(mesh.faces), 3), np.float32)
    ph.save(
        ph.Scene(
            [
                replace(mesh, material=shown, attributes={"vertex_color": by_vertex}),
                replace(mesh, material=ph.Material("metal"), colors=by_face, inside_out=True),
            ],
            **LIT,
        ),
        tmp_path / "a.glb",
    )
    one, other = alone(ph.load(tmp_path / "a.glb"))
    assert np.array_equal(one.attributes["vertex_color"], by_vertex)
    corners = np.asarray(other.faces)
    assert np.array_equal(other.attributes["vertex_color"][corners[:, 1]], by_face)
    assert np.array_equal(np.asarray(other.vertices)[corners], triangles([mesh])[:, ::-1])
    assert np.array_equal(np.asarray(other.normals)[corners][:, ::-1], -mesh.normals[mesh.faces])


def test_round_things_as_gltf_are_meshes(tmp_path: Path) -> None:
    """Their silhouettes are polygons of 64 sides, 0.12 % of the radius within the circle."""
    checker = ph.Texture("checker", transform=[[4, 0, 0], [0, 2, 0]])
    names = {"c": ph.Material("diffuse", color=checker), "p": ph.Material("principled")}
    scene = ph.Scene(
        [
            ph.Spheres(
                [[0, 0, 0], [1.5, 0, 0], [-1.5, 0, 0]],
                [1, 0.5, 0.5],
                ["c", "p", "p"],
                [[0.5, 0.5, 0.5], [1, 0, 0], [0, 1, 0]],
                rotation=np.eye(3)[[1, 2, 0]],
            ),
            ph.Disks([[0, -1, 0]], [[0, 0, 2]], [[3, 0, 0]], "c"),
            ph.Cylinders([[-1, -1, 1]], [[1.5, 1, 1]], 0.2, [[0, 0, 1]], "c"),
        ],
        names,
        **LIT,
    )
    # the first sphere's own colour replaces the checker
    ph.save(scene, tmp_path / "a.glb")
    again = ph.load(tmp_path / "a.glb", ph.LoadOptions(ground=False))
    both = [picture(s, spp=16, width=96, height=64) for s in (dressed(scene, bare=True), again)]
    assert np.abs(both[0].mean(axis=(0, 1)) - both[1].mean(axis=(0, 1))).max() < 4e-3
    assert np.abs(both[0] - both[1]).mean() < 0.02
    low, high = bounds(again.replace(shapes=alone(again), camera=None))
    np.testing.assert_allclose([low, high], [[-3, -1.0, -2], [3, 1.0, 2]], atol=0.19)


def test_large_spheres_have_more_sides() -> None:
    radii = [0.1, 0.2, 0.3, 1.0, 1000.0]
    assert solids.sides(radii, 0.2).tolist() == [64, 64, 128, 256, 1024]


def test_colours_of_copies_are_kept(tmp_path: Path) -> None:
    part = ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="part")
    own = replace(part, colors=[[0, 0, 1]], name="own")
    ball = ph.Spheres([[0, 0, 0]], material=["grey"])
    turns = np.tile(np.eye(4), (3, 1, 1))
    turns[:, 0, 3] = [0, 2, 4]
    colors = [[1, 0, 0], [0, 1, 0], [1, 0, 0]]
    grey = {"grey": ph.Material("diffuse")}
    scene = ph.Scene([ph.Instances([part, own, ball], turns, colors=colors)], grey, **LIT)
    ph.save(scene, tmp_path / "a.glb")
    again = ph.load(tmp_path / "a.glb")
    found = {}
    for shape in alone(again):
        parts = shape.shapes if isinstance(shape, ph.Instances) else [shape]
        for p in parts:
            color = again.materials[p.material].params["color"]
            name = p.name.split(" ")[0], color if isinstance(color, tuple) else "vertex"
            found[name] = len(shape.transforms) if isinstance(shape, ph.Instances) else 1
    red, green, blue = np.eye(3).tolist()
    counts = {(n, tuple(c)): k for n in ("part", "spheres") for c, k in ((red, 2), (green, 1))}
    blues = {k: v for k, v in found.items() if k[0] == "own"}
    assert {k: v for k, v in found.items() if k[0] != "own"} == counts
    assert sum(blues.values()) == 3
    assert {c for _, c in blues} == {tuple(blue)}
    scene = ph.Scene([ph.Instances([part, own], turns, colors=colors)], **LIT)
    ph.save(scene, tmp_path / "a.ply")
    rows = ply.read(tmp_path / "a.ply").attributes["face_color"]
    assert np.array_equal(rows, [*colors, blue, blue, blue])


@pytest.mark.parametrize("count", [3, 1500])
def test_copies_as_gltf_are_nodes_or_instances(tmp_path: Path, count: int) -> None:
    turns = np.tile(np.eye(4), (count, 1, 1))
    angle = RANDOM.uniform(0, 6, count)
    turns[:, 0, 0] = turns[:, 2, 2] = np.cos(angle)
    turns[:, 0, 2], turns[:, 2, 0] = np.sin(angle), -np.sin(angle)
    turns[:, :3, :3] *= RANDOM.uniform(0.5, 2, (count, 1, 3))
    turns[1, :, 0] *= -1.0  # one is mirrored
    turns[2, :3, :3] += RANDOM.normal(size=(3, 3)) * 0.3  # and one skewed
    turns[:, :3, 3] = RANDOM.normal(size=(count, 3))
    part = ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]], [[0, 1, 2]], name="part")
    ph.save(ph.Scene([ph.Instances([part], turns)], **LIT), tmp_path / "a.glb", strict=True)
    found = triangles(alone(ph.load(tmp_path / "a.glb")))
    wanted = triangles([ph.Instances([part], turns)])
    assert len(found) == count
    # in float32, and in another order
    order = [np.lexsort(np.round(x[:, 0], 4).T) for x in (found, wanted)]
    np.testing.assert_allclose(found[order[0]], wanted[order[1]], atol=2e-5)


def test_copies_of_all_shapes_as_gltf(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    parts = (
        (ph.Spheres([[0, 0, 0], [2, 0, 0]], 0.5), solids.sphere(64)),
        (ph.Disks([[0, 0, 0]], [[2, 0, 0]], [[0, 1, 0]]), solids.disk()),
        (ph.Cylinders([[0, 0, 0]], [[0, 0, 3]], 0.5), solids.cylinder()),
    )
    hair = ph.Curves([[0, 0, 0], [1, 0, 0]], 0.1, basis="linear")
    turns = np.tile(np.eye(4), (2, 1, 1))
    turns[1, :3, :3] = [[0, -1, 0.5], [1, 0, 0], [0, 0, 2]]  # turned, stretched and skewed
    turns[1, :3, 3] = (9, 8, 7)
    for part, unit in parts:
        ph.save(ph.Scene([ph.Instances([part], turns)], **LIT), tmp_path / "a.glb")
        (told,) = caplog.messages
        assert "written as meshes of 64 sides or more" in told
        caplog.clear()
        found = triangles(alone(ph.load(tmp_path / "a.glb")))
        where = [turn @ own for turn in turns for own in solids.matrices(part)]
        wanted = triangles([ph.Instances([unit], where)])
        for axis in range(3):  # in another order
            ours, theirs = (np.sort(x[:, :, axis].ravel()) for x in (found, wanted))
            np.testing.assert_allclose(ours, theirs, atol=1e-5)
    ph.save(ph.Scene([ph.Instances([hair], turns)], **LIT), tmp_path / "a.glb")
    assert caplog.messages == ["a.glb: curves: glTF has none; left out"]


@pytest.mark.parametrize(
    ("ending", "added"), [("glb", ["key light", "ground"]), ("ply", ["key light"])]
)
def test_light_and_ground_of_the_studio_are_not_written_where_they_are_added(
    tmp_path: Path, ending: str, added: list[str]
) -> None:
    """As JSON a scene has all that it was given; from there it goes on without."""
    (tmp_path / "w.xyz").write_text("2\n\nO 0 0 0\nH 1 0 0\n")
    ph.save(ph.load(tmp_path / "w.xyz", ph.LoadOptions(ground=True)), tmp_path / "w.json")
    dressed = ph.load(tmp_path / "w.json")
    assert [s.name for s in dressed.shapes] == ["particles", "key light", "ground"]
    ph.save(dressed, tmp_path / f"w.{ending}")
    again = ph.load(tmp_path / f"w.{ending}", ph.LoadOptions(ground=False))
    assert sum(s.name in ("key light", "ground") for s in again.shapes) == 1
    names = [s.name for s in ph.load(tmp_path / f"w.{ending}").shapes]
    assert names[-len(added) :] == added  # as meshes; points have no ground unless asked for
    assert names.count("ground") == added.count("ground")


@pytest.mark.parametrize("ending", ["glb", "ply"])
def test_copies_of_their_own_colours(tmp_path: Path, ending: str) -> None:
    places = np.tile(np.eye(4), (3, 1, 1))
    places[:, 0, 3] = (0, 3, 6)
    colors = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    part = ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], name="part")
    copies = ph.Instances([part], places, "copies", colors)
    ph.save(ph.Scene([copies], **LIT), tmp_path / f"a.{ending}")
    again = ph.load(tmp_path / f"a.{ending}", ph.LoadOptions(view="front"))
    image = ph.render(again, width=70, height=10, spp=1, filter="box", features=True)
    albedo = image.features["albedo"]
    for column, color in ((2, colors[0]), (32, colors[1]), (62, colors[2])):
        seen = albedo[:, column - 2 : column + 6].reshape(-1, 3)
        assert (np.abs(seen - color).max(axis=1) < 0.01).any(), column


def test_lights_and_cameras_as_gltf(tmp_path: Path) -> None:
    lights = (
        ph.Light("point", intensity=(20, 30, 40), position=(1, 2, 3)),
        ph.Light(
            "spot",
            intensity=(9, 9, 9),
            position=(0, 5, 0),
            direction=(1, -2, 0),
            cutoff_angle=40.0,
            beam_width=20.0,
        ),
        ph.Light("directional", irradiance=(3, 2, 1), direction=(0, -1, 0)),
    )
    for camera in (
        ph.Camera((4, 5, 6), (1, 1, 0), vfov=33.0, mirrored=True),
        ph.Camera((4, 5, 6), (1, 1, 0), (0, 1, 0.1), fov=33.0),
        ph.Camera((4, 5, 6), (1, 1, 0), projection="orthographic", height=3.0),
    ):
        size = ph.Settings(width=320, height=240)
        scene = ph.Scene([torus()], full_scene().materials, camera, None, size, lights=lights)
        ph.save(scene, tmp_path / "a.glb")
        again = ph.load(tmp_path / "a.glb")
        assert (again.settings.width, again.settings.height) == (640, 480)
        found = again.camera
        np.testing.assert_allclose(found.eye, camera.eye, rtol=1e-6)
        back = np.subtract(camera.eye, camera.target)
        towards = np.subtract(found.eye, found.target)
        np.testing.assert_allclose(towards, back / np.linalg.norm(back), atol=1e-6)
        assert (found.projection, found.mirrored) == (camera.projection, camera.mirrored)
        if camera.projection == "orthographic":
            assert found.height == pytest.approx(3.0)
        else:
            # between the first and last pixel's centres: docs/camera.md
            slope = np.tan(np.radians(33 / 2)) * (240 / 319 if camera.fov else 1.0)
            assert found.vfov == pytest.approx(2 * np.degrees(np.arctan(slope)))
        for light, other in zip(lights, again.lights, strict=True):
            assert light.type == other.type
            for name, value in light.params.items():
                value = np.asarray(value) / (np.sqrt(5) if value == (1, -2, 0) else 1)
                np.testing.assert_allclose(other.params[name], value, atol=1e-6, err_msg=name)


def test_up_is_y_in_gltf(tmp_path: Path) -> None:
    mesh = ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 0, 2]], [[0, 1, 2]])
    mesh = replace(mesh, material=ph.Material("principled"))
    scene = ph.Scene([mesh], camera=framing((0.0, 0.0, 1.0)), background=None)
    ph.save(scene, tmp_path / "a.glb", strict=True)
    again = ph.load(tmp_path / "a.glb", ph.LoadOptions(ground=False))
    assert np.array_equal(triangles(alone(again))[0], [[0, 0, 0], [1, 0, 0], [0, 2, 0]])
    assert replace(again.camera, shapes=()) == framing()  # which is not written
    # random directions are turned with the scene, but not all into those of before
    shown = [picture(s, spp=64) for s in (again, dressed(scene, bare=True))]
    np.testing.assert_allclose(*shown, atol=0.03)
    assert abs(shown[0].mean() - shown[1].mean()) < 1e-3


def test_what_gltf_cannot_hold_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = full_scene()
    camera = ph.Camera(aperture_radius=0.1, shift=(0.1, 0.0))
    glass = ph.Material("dielectric", priority=2, back="gold", bump_map=COLOR)
    names = scene.materials | {"gold": glass}
    lights = (ph.Light("directional", angle=0.5), ph.Light("sky"))
    scene = scene.replace(camera=camera, materials=names, lights=lights)
    ph.save(scene, tmp_path / "a.glb")
    assert sorted(m.removeprefix("a.glb: ").split(":")[0] for m in caplog.messages) == [
        "another material of the back",
        "attribute 'vertex_age'",
        "background 'envmap'",
        "blend",
        "bump maps",
        "camera",
        "camera",
        "colours of what is made of a blend",
        "curves",
        "diffuse",
        "directional lights of some width",
        "light 'sky'",
        "priorities of glass in glass",
        "spheres, disks and cylinders",
        "textures of what glTF has a number for",
    ]
    before = (tmp_path / "a.glb").read_bytes()
    with pytest.raises(ph.FormatError, match="strict, and not all of it is supported"):
        ph.save(scene, tmp_path / "a.glb", strict=True)
    scene = scene.replace(camera=ph.Camera(projection="fisheye"))
    with pytest.raises(ph.FormatError, match="camera 'fisheye': not in glTF"):
        ph.save(scene, tmp_path / "a.glb", strict=True)
    assert (tmp_path / "a.glb").read_bytes() == before


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
        (["a.json", "same.json"], "same.json: is what is to be read; give the result another"),
        (["none.json", "b.json"], "none.json: no such file"),
        (["a.json", "b.png"], "b.png: unknown ending of a scene to write '.png' (choices: "),
        (["a.json", "b.ply", "--strict"], "cylinders: PLY has triangles or points; left out"),
        (["a.json", "x/b.json"], "b.json: cannot be written: No such file or directory"),
        (
            ["a.json", "b.json", "-D", "a=b"],
            "'-D' is not for Parhelion scene files (choices: --strict",
        ),
        (["a.json", "b.json", "--time", "3"], "the option '--time' is not for Parhelion scene"),
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
