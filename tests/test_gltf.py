"""glTF: files made here, of which every vertex and number is known, and files that are broken."""

from __future__ import annotations

import base64
import contextlib
import json
import logging
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import parhelion as ph
from parhelion.errors import FormatError, SceneError
from parhelion.framing import placed
from parhelion.image import encoded, is_encoded, read_pixels
from parhelion.io import LoadOptions, load
from parhelion.io.gltf import meshopt, schema

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class File:
    """A glTF document in the making: `json` and one buffer, to which arrays are added."""

    def __init__(self) -> None:
        self.binary = bytearray()
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}}

    def add(self, kind: str, **fields: Any) -> int:
        """Another object in a list of the document; its index."""
        things = self.json.setdefault(kind, [])
        things.append(fields)
        return len(things) - 1

    def view(self, data: bytes, **fields: Any) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        at = len(self.binary)
        self.binary += data
        return self.add("bufferViews", buffer=0, byteOffset=at, byteLength=len(data), **fields)

    def array(self, values: Any, **fields: Any) -> int:
        """An accessor of (N,) or (N, width) numbers."""
        array = np.asarray(values)
        if array.dtype == np.float64:
            array = array.astype(np.float32)
        width = array.shape[1] if array.ndim == 2 else 1
        fields = {"type": _TYPES[width], "count": len(array)} | fields
        code = _COMPONENTS[array.dtype.str[1:]]
        return self.add(
            "accessors", bufferView=self.view(array.tobytes()), componentType=code, **fields
        )

    def mesh(self, positions: Any = TRIANGLE, **fields: Any) -> int:
        """A mesh of one primitive; fields of the primitive, attributes as arrays."""
        attributes = {"POSITION": self.array(positions)}
        for name in [n for n in fields if n.isupper() or n[-1].isdigit()]:
            value = fields.pop(name)
            attributes[name] = value if isinstance(value, int) else self.array(value)
        return self.add("meshes", primitives=[{"attributes": attributes, **fields}])

    def picture(self, pixels: NDArray[Any], **sampler: Any) -> dict[str, int]:
        """A PNG in the buffer, as a textureInfo."""
        image = self.add("images", bufferView=self.view(encoded(pixels, {}, ".png")))
        fields = {"sampler": self.add("samplers", **sampler)} if sampler else {}
        return {"index": self.add("textures", source=image, **fields)}

    def material(self, **fields: Any) -> int:
        """A mesh of a triangle with texture coordinates is added for it, and a node."""
        made = self.add("materials", **fields)
        uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
        self.add("nodes", mesh=self.mesh(material=made, TEXCOORD_0=uv))
        return made

    def text(self) -> bytes:
        document = dict(self.json)
        if self.binary:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
            document["buffers"] = [{"byteLength": len(self.binary), "uri": uri}]
        return json.dumps(document).encode()

    def glb(self) -> bytes:
        document = dict(self.json) | {"buffers": [{"byteLength": len(self.binary)}]}
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + bytes(-len(self.binary) % 4)
        size = 12 + 8 + len(text) + 8 + len(binary)
        return (
            struct.pack("<4sII", b"glTF", 2, size)
            + struct.pack("<II", len(text), 0x4E4F534A)
            + text
            + struct.pack("<II", len(binary), 0x004E4942)
            + binary
        )


@pytest.fixture
def read(tmp_path: Path) -> Any:
    """Loads a File, or the bytes of one; the scene without what dark ones get."""

    def scene(file: File | bytes, **options: Any) -> ph.Scene:
        path = tmp_path / "scene.gltf"
        path.write_bytes(file.text() if isinstance(file, File) else file)
        return without_studio(load(path, LoadOptions(**options)))

    return scene


def without_studio(scene: ph.Scene) -> ph.Scene:
    added = ("key light", "ground")
    return scene.replace(shapes=tuple(s for s in scene.shapes if s.name not in added))


def triangles(shape: Any) -> NDArray[Any]:
    """(F, 3, 3) corners of a mesh."""
    return np.asarray(shape.vertices)[np.asarray(shape.faces)]


def only_material(scene: ph.Scene) -> ph.Material:
    (found,) = scene.materials.values()
    return found


# --- Geometry ------------------------------------------------------------------------------------


def test_a_triangle_is_where_its_nodes_put_it(read: Any) -> None:
    f = File()
    # a quarter turn about z, then doubled, then moved; within a parent that moves up
    turn = [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]
    f.add("nodes", children=[1], matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1])
    f.add("nodes", mesh=f.mesh(), rotation=turn, scale=[2, 2, 2], translation=[10, 0, 0])
    scene = read(f)
    (mesh,) = scene.shapes
    assert_allclose(triangles(mesh)[0], [[10, 0, 5], [10, 2, 5], [8, 0, 5]], atol=1e-6)
    assert mesh.normals is None
    assert isinstance(scene.camera, ph.Framing)


def test_a_rotation_of_nothing_but_zeros(read: Any) -> None:
    f = File()
    f.add("nodes", translation=[1, 0, 0])
    f.add("nodes", mesh=f.mesh(), rotation=[0, 0, 0, 0])
    with pytest.raises(FormatError, match=r"nodes\[1\].rotation: is 0 0 0 0, which is no rota"):
        read(f)


def test_a_glb_is_the_same_scene(read: Any, tmp_path: Path) -> None:
    f = File()
    f.add("nodes", mesh=f.mesh())
    path = tmp_path / "scene.GLB"
    path.write_bytes(f.glb())
    assert np.array_equal(triangles(load(path).shapes[0]), triangles(read(f).shapes[0]))


def test_mirrored_and_flattened_meshes_keep_their_outside(read: Any) -> None:
    f = File()
    normals = np.tile(np.array([[0, 0, 1]], np.float32), (3, 1))
    mesh = f.mesh(NORMAL=normals)
    f.add("nodes", mesh=mesh, scale=[-1, 1, 1])
    (mirrored,) = read(f).shapes
    corners = triangles(mirrored)[0]
    assert np.cross(corners[1] - corners[0], corners[2] - corners[0])[2] > 0
    assert np.asarray(mirrored.normals)[0, 2] > 0
    f.json["nodes"][0]["scale"] = [1, 1, 0]
    (flat,) = read(f).shapes
    assert np.asarray(flat.normals)[0, 2] > 0
    f.json["nodes"][0]["scale"] = [1, 0, 0]
    assert read(f).shapes == ()


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3], [[0, 1, 2], [1, 3, 2]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
    ],
)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
def test_triangles_strips_and_fans(
    read: Any, mode: int, indices: list[int], faces: list[list[int]], kind: Any
) -> None:
    f = File()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    f.add("nodes", mesh=f.mesh(corners, mode=mode, indices=f.array(np.array(indices, kind))))
    assert_allclose(triangles(read(f).shapes[0]), corners[np.array(faces)])


def test_points_are_spheres_and_lines_tubes(read: Any) -> None:
    f = File()
    corners = np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0]], np.float32)
    colors = np.eye(3, dtype=np.float32)
    f.add("nodes", mesh=f.mesh(corners, mode=0, COLOR_0=colors))
    f.add("nodes", mesh=f.mesh(corners, mode=2), scale=[2, 2, 2])
    spheres, curves = read(f).shapes
    assert_allclose(np.asarray(spheres.centers), corners)
    assert_allclose(spheres.radii, 0.001 * 10)  # of the diagonal of what is there
    assert_allclose(np.asarray(spheres.colors), colors)
    assert_allclose(np.asarray(curves.points), 2 * corners[[0, 1, 1, 2, 2, 0]])
    ph.prepare(read(f))


def test_sparse_accessors_replace_elements(read: Any) -> None:
    f = File()
    sparse = {
        "count": 1,
        "indices": {"bufferView": f.view(np.array([1], np.uint16).tobytes()),
                    "componentType": 5123},
        "values": {"bufferView": f.view(np.array([7, 8, 9], np.float32).tobytes())},
    }  # fmt: skip
    f.add("nodes", mesh=f.mesh())
    f.json["accessors"][0]["sparse"] = sparse
    expected = TRIANGLE.copy()
    expected[1] = (7, 8, 9)
    assert_allclose(triangles(read(f).shapes[0])[0], expected)
    del f.json["accessors"][0]["bufferView"]  # of zeros
    expected = np.zeros((3, 3))
    expected[1] = (7, 8, 9)
    assert_allclose(triangles(read(f).shapes[0])[0], expected)


def test_strides_and_quantised_numbers(read: Any) -> None:
    f = File()
    rows = np.zeros((3, 4), np.int16)  # padded to 8 bytes
    rows[:, :3] = TRIANGLE * 32767
    view = f.view(rows.tobytes(), byteStride=8)
    accessor = f.add("accessors", bufferView=view, componentType=5122, type="VEC3", count=3)
    f.add("meshes", primitives=[{"attributes": {"POSITION": accessor}}])
    f.add("nodes", mesh=0)
    assert_allclose(triangles(read(f).shapes[0])[0], 32767 * TRIANGLE)
    f.json["accessors"][0]["normalized"] = True
    f.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    assert_allclose(triangles(read(f).shapes[0])[0], TRIANGLE)


def test_primitives_take_only_the_vertices_they_use(read: Any) -> None:
    f = File()
    positions = f.array(np.arange(30, dtype=np.float32).reshape(10, 3) ** 2)
    parts = [f.array(np.array(i, np.uint16)) for i in ([9, 1, 4], [0, 1, 2])]
    f.add("meshes", primitives=[{"attributes": {"POSITION": positions}, "indices": i}
                                for i in parts])  # fmt: skip
    f.add("nodes", mesh=0)
    first, second = read(f).shapes
    assert len(first.vertices) == len(second.vertices) == 3
    assert_allclose(triangles(first)[0, :, 0], [27**2, 3**2, 12**2])


def test_meshes_that_are_seen_again_are_instances(read: Any) -> None:
    f = File()
    mesh = f.mesh()
    for x in (0, 5, 9):
        f.add("nodes", mesh=mesh, translation=[x, 0, 0])
    f.add("nodes", mesh=mesh, scale=[0, 0, 0])  # hidden
    (copies,) = read(f).shapes
    assert isinstance(copies, ph.Instances)
    assert_allclose(np.asarray(copies.transforms)[:, 0, 3], [0, 5, 9])
    ph.prepare(read(f))


def test_points_that_are_seen_again_keep_their_size(read: Any) -> None:
    f = File()
    corners = np.array([[0, 0, 0], [3, 4, 0]], np.float32)
    mesh = f.mesh(corners, mode=0)
    f.add("nodes", mesh=mesh, scale=[2, 2, 2])
    f.add("nodes", mesh=mesh, scale=[2, 2, 2])
    (copies,) = read(f).shapes
    assert_allclose(2 * copies.shapes[0].radii, 0.001 * 10)


def test_gpu_instancing(read: Any) -> None:
    f = File()
    places = np.array([[1, 0, 0], [0, 2, 0]], np.float32)
    many = {"TRANSLATION": f.array(places), "SCALE": f.array(np.full((2, 3), 3, np.float32))}
    f.add("nodes", mesh=f.mesh(), translation=[0, 0, 7],
          extensions={"EXT_mesh_gpu_instancing": {"attributes": many}})  # fmt: skip
    (copies,) = read(f).shapes
    expected = np.stack([np.diag([3.0, 3, 3, 1])] * 2)
    expected[:, :3, 3] = places + np.array([0, 0, 7])
    assert_allclose(np.asarray(copies.transforms), expected, atol=1e-6)


def test_morph_targets(read: Any) -> None:
    f = File()
    targets = [{"POSITION": f.array(np.full((3, 3), k, np.float32))} for k in (1.0, 10.0)]
    mesh = f.mesh(targets=targets)
    f.json["meshes"][mesh]["weights"] = [0.5, 0.0]
    f.add("nodes", mesh=mesh)
    assert_allclose(triangles(read(f).shapes[0])[0], TRIANGLE + 0.5)
    f.json["nodes"][0]["weights"] = [1.0, 0.25]
    assert_allclose(triangles(read(f).shapes[0])[0], TRIANGLE + 3.5)


def skinned() -> File:
    """A triangle whose first two corners hang on a joint at x = 1, the third on both alike. The
    joint is turned by a quarter around z; the other one stays.
    """
    f = File()
    bind = np.stack([np.eye(4, dtype=np.float32)] * 2)
    bind[0, 3, 0] = -1.0  # by columns: moves x by -1
    joints = np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0]], np.uint8)
    weights = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0]], np.float32)  # not normalised
    mesh = f.mesh(JOINTS_0=joints, WEIGHTS_0=weights)
    f.add("skins", joints=[1, 2], inverseBindMatrices=f.array(bind.reshape(2, 16)))
    f.add("nodes", mesh=mesh, skin=0, translation=[100, 0, 0])  # which a skin does not heed
    turn = [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]
    f.add("nodes", translation=[1, 0, 0], rotation=turn)
    f.add("nodes")
    return f


def test_a_skin_in_its_pose(read: Any) -> None:
    # (x - 1, y) turned is (-y, x - 1), and 1 is added to x again
    expected = [[1, -1, 0], [1, 0, 0], [(0 + 0) / 2, (-1 + 1) / 2, 0]]
    assert_allclose(triangles(read(skinned()).shapes[0])[0], expected, atol=1e-6)


def test_tangents(read: Any) -> None:
    """They go where the mesh goes; mirrored, their fourth number changes. They come only with
    normals, for materials that need them.
    """
    tangents = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [1, 0, 0, -1]], np.float32)
    normals = np.tile(np.array([[0, 0, 1]], np.float32), (3, 1))
    f = skinned()
    bumpy = f.add("materials", normalTexture=f.picture(np.full((1, 1, 3), 128, np.uint8)))
    f.add("materials", extensions={"KHR_materials_anisotropy": {"anisotropyStrength": 0.5}})
    f.add("materials")
    primitive = f.json["meshes"][0]["primitives"][0]
    primitive |= {"material": bumpy, "targets": [{"TANGENT": f.array(np.full((3, 3), 2.0))}]}
    primitive["attributes"] |= {"NORMAL": f.array(normals), "TANGENT": f.array(tangents)}
    # turned by a quarter, and that added to what is not
    expected = np.array([[0, 1, 0, 1], [-1, 0, 0, 1], [0.5, 0.5, 0, -1]])
    assert_allclose(read(f).shapes[0].tangents, expected, atol=1e-6)
    node = f.json["nodes"][0]
    del node["skin"]
    node["scale"] = [-2, 1, 1]
    expected = tangents * [-2, 1, 1, -1]
    assert_allclose(read(f).shapes[0].tangents, expected)
    node["weights"] = [1.0]
    expected = np.array([[-6, 2, 2, -1], [-4, 3, 2, -1], [-6, 2, 2, 1]])
    assert_allclose(read(f).shapes[0].tangents, expected)
    primitive["material"] = 1
    assert_allclose(read(f).shapes[0].tangents, expected)
    primitive["material"] = 2
    assert read(f).shapes[0].tangents is None
    primitive["material"] = 1
    del primitive["attributes"]["NORMAL"]
    assert read(f).shapes[0].tangents is None


@pytest.mark.parametrize(
    ("interpolation", "values", "at", "expected"),
    [
        ("LINEAR", [[0, 0, 0], [4, 0, 0], [4, 8, 0]], 0.5, [2, 0, 0]),
        ("LINEAR", [[0, 0, 0], [4, 0, 0], [4, 8, 0]], 2.5, [4, 6, 0]),
        ("LINEAR", [[0, 0, 0], [4, 0, 0], [4, 8, 0]], 99.0, [4, 8, 0]),
        ("STEP", [[0, 0, 0], [4, 0, 0], [4, 8, 0]], 2.9, [4, 0, 0]),
        # tangents in, value, tangents out: (2 t)^3 from 0 to 1 has slope 0 and, at 1, slope 3
        ("CUBICSPLINE", [[0, 0, 0], [0, 0, 0], [0, 0, 0], [3, 0, 0], [1, 0, 0], [0, 0, 0],
                         [0, 0, 0], [1, 0, 0], [0, 0, 0]], 0.5, [0.125, 0, 0]),
    ],
)  # fmt: skip
def test_animations_at_a_time(
    read: Any, interpolation: str, values: Any, at: float, expected: list[float]
) -> None:
    f = File()
    f.add("nodes", mesh=f.mesh(), translation=[50, 50, 50])
    sampler = {"input": f.array(np.array([0, 1, 3], np.float32)),
               "output": f.array(np.array(values, np.float32)),
               "interpolation": interpolation}  # fmt: skip
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    f.add("animations", samplers=[sampler], channels=[channel])
    assert_allclose(triangles(read(f).shapes[0])[0], TRIANGLE + 50)
    assert_allclose(triangles(read(f, time=at).shapes[0])[0], TRIANGLE + expected, atol=1e-6)


def test_animated_rotations_and_weights(read: Any) -> None:
    f = File()
    mesh = f.mesh(targets=[{"POSITION": f.array(np.full((3, 3), 1, np.float32))}])
    f.add("nodes", mesh=mesh)
    # from no turn to a half turn around z, the second one written with the other sign
    turns = np.array([[0, 0, 0, 1], [0, 0, -math.sqrt(0.5), -math.sqrt(0.5)]], np.float32)
    times = f.array(np.array([0, 2], np.float32))
    samplers = [{"input": times, "output": f.array(turns)},
                {"input": times, "output": f.array(np.array([0, 4], np.float32))}]  # fmt: skip
    channels = [{"sampler": k, "target": {"node": 0, "path": path}}
                for k, path in enumerate(("rotation", "weights"))]  # fmt: skip
    f.add("animations", samplers=samplers, channels=channels)
    c = math.sqrt(0.5)
    turned = (TRIANGLE + 2) @ np.array([[c, c, 0], [-c, c, 0], [0, 0, 1]])
    assert_allclose(triangles(read(f, time=1.0).shapes[0])[0], turned, atol=1e-6)


def moving() -> File:
    """A triangle that goes from x = 0 at 1 s to x = 4 at 2 s, and something that is not read."""
    f = File()
    f.add("nodes", mesh=f.mesh())
    sampler = {"input": f.array(np.array([1, 2], np.float32)),
               "output": f.array(np.array([[0, 0, 0], [4, 0, 0]], np.float32))}  # fmt: skip
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    f.add("animations", samplers=[sampler], channels=[channel])
    f.json["extensionsUsed"] = ["VENDOR_unheard_of"]
    return f


@pytest.mark.parametrize(
    ("which", "fps", "times", "rate"),
    [
        ("all", 4, [1, 1.25, 1.5, 1.75, 2], 4),
        (":", None, np.arange(31) / 30 + 1, 30),
        ("0:3:0.5", None, [0, 0.5, 1, 1.5, 2, 2.5], 2),
        ("1.9::0.1", 24, [1.9, 2.0], 24),
        ("::-0.5", None, [2, 1.5, 1], 2),
        (slice(None, 1.5), 8, [1, 1.125, 1.25, 1.375], 8),
        ("0..2", 2, [0, 0.5, 1, 1.5, 2], 2),
        ("1...5..-.25", None, [1, 0.75, 0.5], 4),
        ("0..3", 1, [0, 1, 2, 3], 1),
    ],
)
def test_frames_are_times(
    tmp_path: Path, which: Any, fps: float | None, times: Any, rate: float
) -> None:
    path = tmp_path / "a.gltf"
    path.write_bytes(moving().text())
    frames = ph.load_frames(path, which, fps=fps)
    assert_allclose(frames.numbers, times)
    assert frames.fps == pytest.approx(rate)
    first = 0 if which == "0..3" else 1  # whole numbers stand in files' names as they are
    assert list(frames.file_numbers) == list(range(first, first + len(frames)))
    for scene, time in zip(frames, times, strict=True):
        x = 4 * min(max(time - 1, 0), 1)
        assert_allclose(triangles(scene.shapes[0])[0] - [x, 0, 0], TRIANGLE, atol=1e-6)
        assert scene.name == f"a.gltf, time {time:g}"


def test_what_frames_have_in_common(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.gltf"
    f = moving()
    path.write_bytes(f.text())
    scenes = list(ph.load_frames(path, "::0.5", LoadOptions(ground=True)))
    assert len(caplog.records) == 1  # not once a frame
    assert [s.name for s in scenes[0].shapes] == ["mesh 0", "key light", "ground"]
    assert len({placed(scene, 1.5) for scene in scenes}) == 1
    view = scenes[0].camera
    assert isinstance(view, ph.Framing)
    alone = ph.Framing(view.direction, view.up, view.vfov, view.fill)
    best = placed(ph.Scene([scene.shapes[0] for scene in scenes], camera=alone), 1.5)
    assert_allclose(placed(scenes[0], 1.5).eye, best.eye, atol=0.05)
    for scene in scenes[1:]:
        assert scene.shapes[1:] == scenes[0].shapes[1:]
        assert scene.materials == scenes[0].materials
    f.add("cameras", type="perspective", perspective={"yfov": 0.5, "znear": 0.1})
    f.add("nodes", camera=0)
    f.json["animations"][0]["channels"][0]["target"]["node"] = 1
    path.write_bytes(f.text())
    eyes = [scene.camera.eye[0] for scene in ph.load_frames(path, "::0.5")]
    assert_allclose(eyes, [0, 2, 4])
    framed = list(ph.load_frames(path, "::0.5", LoadOptions(view="top")))
    assert framed[0].camera == framed[1].camera


def test_frames_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.gltf"
    path.write_bytes(moving().text())
    for which, told in (
        ("3:", "no seconds are in 3:; there are 1 to 2"),
        ("5", "frames '5': a range of seconds such as 1..240, 10:, :100:5 or 1:2:0.5 is"),
        ("1:2:0", "a range of seconds"),
        ("1:b", "a range of seconds"),
        ("0:inf", "a range of seconds"),
        ("0:1:1e-9", r"a\.gltf: 0:1:1e-9 is more than 1,000,000 frames, and no more can be made"),
        ("0:1000001:1", "0:1000001:1 is more than 1,000,000 frames"),
        ("-1e308:1e308:1", "is more than 1,000,000 frames"),
        ("1e308:-1e308:1", "no seconds are in"),
        (slice("a"), "a range of seconds"),
        (slice(None, None, 0), "a range of seconds"),
    ):
        with pytest.raises(SceneError, match=told):
            ph.load_frames(path, which)
    from parhelion.errors import spelled

    with (
        spelled({"frames": "--frames"}),
        pytest.raises(SceneError, match=r"^--frames '5': a range"),
    ):
        ph.load_frames(path, "5")
    with monkeypatch.context() as fewer:
        fewer.setattr("parhelion.io.frames._MOST", 2)
        assert len(ph.load_frames(path, "1:2:0.5")) == 2  # as many as there may be
        with pytest.raises(SceneError, match=r"1:2:0\.4 is more than 2 frames"):
            ph.load_frames(path, "1:2:0.4")
    with pytest.raises(SceneError, match="the option 'time' is of one frame"):
        ph.load_frames(path, ":", LoadOptions(time=1.0))
    with pytest.raises(SceneError, match=r"fps is 0; must lie in \[0.01, 1000\]"):
        ph.load_frames(path, fps=0)
    still = moving()
    del still.json["animations"]
    path.write_bytes(still.text())
    with pytest.raises(FormatError, match=r"a\.gltf: has no animations, and so no frames"):
        ph.load_frames(path)


def test_nodes_outside_of_the_scene_are_not_seen(read: Any) -> None:
    f = File()
    mesh = f.mesh()
    f.add("nodes", mesh=mesh, name="a")
    f.add("nodes", mesh=mesh, name="b", translation=[3, 0, 0])
    hidden = {"KHR_node_visibility": {"visible": False}}
    f.add("nodes", mesh=mesh, name="c", extensions=hidden)
    f.add("scenes", nodes=[0])
    f.add("scenes", nodes=[1, 2])
    f.json["scene"] = 1
    (mesh_seen,) = read(f).shapes
    assert_allclose(triangles(mesh_seen)[0, 0], [3, 0, 0])


def test_draco(read: Any) -> None:
    draco = pytest.importorskip("DracoPy")
    f = File()
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    data = draco.encode(points, np.array([[0, 1, 2], [2, 1, 3]]), quantization_bits=14)
    positions = f.add("accessors", componentType=5126, type="VEC3", count=6)
    packed = {"bufferView": f.view(data), "attributes": {"POSITION": 0}}
    primitive = {"attributes": {"POSITION": positions},
                 "extensions": {"KHR_draco_mesh_compression": packed}}  # fmt: skip
    f.add("meshes", primitives=[primitive])
    f.add("nodes", mesh=0)
    f.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    found = triangles(read(f).shapes[0])
    assert sorted(found.sum(axis=1)[:, 0].tolist()) == pytest.approx([1, 2], abs=1e-3)
    f.json["bufferViews"][0]["byteLength"] -= 20
    with pytest.raises(FormatError, match=r"meshes\[0\].primitives\[0\].extensions.KHR_draco_mesh"):
        read(f)


# --- EXT_meshopt_compression ---------------------------------------------------------------------


def compressed(values: NDArray[np.uint8]) -> bytes:
    """A stream of attributes, (N, stride) bytes: every group in the fewest bits."""
    count, stride = values.shape
    block = min(8192 // stride // 16 * 16, 256)
    signed = np.diff(values, axis=0, prepend=values[:1]).view(np.int8).astype(int)
    zigzag = np.where(signed < 0, -2 * signed - 1, 2 * signed)
    out = bytearray([0xA0])
    for first in range(0, count, block):
        part = zigzag[first : first + block]
        part = np.pad(part, ((0, -len(part) % 16), (0, 0)))
        for column in part.T:
            modes, body = [], bytearray()
            for group in column.reshape(-1, 16):
                choices = {0: b"" if not group.any() else None, 3: bytes(group.tolist())}
                for mode, bits in ((1, 2), (2, 4)):
                    top, size = 2**bits - 1, 8 // bits
                    small = np.minimum(group, top).reshape(-1, size)
                    weights = 2 ** (bits * np.arange(size)[::-1])
                    own = bytes(group[group >= top].tolist())
                    choices[mode] = bytes((small @ weights).tolist()) + own
                mode = min((len(c), m) for m, c in choices.items() if c is not None)[1]
                modes.append(mode)
                body += choices[mode] or b""
            modes += [0] * (-len(modes) % 4)
            out += bytes(sum(m << 2 * k for k, m in enumerate(modes[i : i + 4]))
                         for i in range(0, len(modes), 4))  # fmt: skip
            out += body
    return bytes(out) + bytes(max(32 - stride, 0)) + values[0].tobytes()


def packed_view(f: File, data: bytes, size: int, **fields: Any) -> int:
    """A view of `size` bytes that lie compressed in the buffer."""
    place = f.view(data)
    extension = {**f.json["bufferViews"][place], **fields}
    return f.add("bufferViews", buffer=1, byteLength=size,
                 extensions={"EXT_meshopt_compression": extension})  # fmt: skip


def unpacked(data: bytes, count: int, stride: int, mode: str, filter: str = "NONE") -> bytes:
    return meshopt.decode(
        memoryview(data),
        schema.Meshopt(buffer=0, byte_length=len(data), byte_stride=stride, count=count, mode=mode,
                       filter=filter),
    )  # fmt: skip


@pytest.mark.parametrize(("count", "stride"), [(1, 4), (16, 12), (300, 16), (513, 64), (70, 256)])
def test_meshopt_attributes(count: int, stride: int) -> None:
    rng = np.random.default_rng(count)
    steps = rng.integers(0, 256, (count, stride)) * (rng.random((count, stride)) < 0.1)
    steps += rng.integers(-1, 2, (count, stride)) * (np.arange(stride) % 3)
    values = np.cumsum(steps, axis=0).astype(np.uint8)
    data = compressed(values)
    assert unpacked(data, count, stride, "ATTRIBUTES") == values.tobytes()
    for short in range(len(data) - 1, 0, -7):
        with contextlib.suppress(SceneError):
            unpacked(data[:short], count, stride, "ATTRIBUTES")


def test_meshopt_triangles() -> None:
    codes = [0xF0, 0x10, 0x02, 0x0F, 0x0E, 0x0D, 0xFF, 0xFE]
    # +7; an index, another, the newest vertex: +93 and -50; begin anew at 0
    data = bytes([0xE1, *codes, 14, 0xF1, 0xBA, 0x01, 99, 0x00]) + bytes(16)
    expected = [0, 1, 2, 2, 1, 3, 2, 3, 1, 2, 1, 7, 2, 7, 8, 2, 8, 7, 100, 50, 7, 0, 1, 2]
    found = np.frombuffer(unpacked(data, 24, 4, "TRIANGLES"), np.uint32)
    assert found.tolist() == expected
    with pytest.raises(SceneError, match="more bytes than"):
        unpacked(data[:-16] + bytes(17), 24, 4, "TRIANGLES")
    with pytest.raises(SceneError, match="ends too early"):
        unpacked(data[:10] + bytes([0xFF]) * 2 + bytes(16), 24, 4, "TRIANGLES")


def test_meshopt_indices() -> None:
    # by turns +5 of the first line of indices and +1000 and -1 of the second
    numbers = [5 << 2, 1000 << 2 | 1, 5 << 2, 3]
    body = b"".join(
        bytes([n & 127 | 128] * (n > 127) + [n >> 7 if n > 127 else n]) for n in numbers
    )
    data = b"\xd1" + body + bytes(4)
    assert np.frombuffer(unpacked(data, 4, 2, "INDICES"), np.uint16).tolist() == [5, 1000, 10, 999]
    with pytest.raises(SceneError, match="has 4 indices; count is 5"):
        unpacked(data, 5, 2, "INDICES")


@pytest.mark.parametrize(
    ("filter", "stored", "expected"),
    [
        ("OCTAHEDRAL", np.array([[0, 0, 127, 9], [127, 127, 127, 9], [127, 0, 127, 9],
                                 [0, -7, 7, 9]], np.int8),
         np.array([[0, 0, 127, 9], [0, 0, -127, 9], [127, 0, 0, 9], [0, -127, 0, 9]], np.int8)),
        ("QUATERNION", np.array([[0, 0, 0, 32767], [32767, 0, 0, 32764]], np.int16),
         np.array([[0, 0, 0, 32767], [23170, 23170, 0, 0]], np.int16)),
        ("EXPONENTIAL", np.array([[0xFF000003], [0x02FFFFFF]], np.uint32),
         np.array([[1.5], [-4.0]], np.float32)),
    ],
)  # fmt: skip
def test_meshopt_filters(filter: str, stored: NDArray[Any], expected: NDArray[Any]) -> None:
    rows = stored.view(np.uint8).reshape(len(stored), -1)
    data = unpacked(compressed(rows), len(rows), rows.shape[1], "ATTRIBUTES", filter)
    found = np.frombuffer(data, expected.dtype).reshape(expected.shape)
    assert_allclose(found, expected, atol=1 if expected.dtype.kind == "i" else 0)


def test_a_mesh_in_compressed_views(read: Any) -> None:
    f = File()
    rows = TRIANGLE.view(np.uint8).reshape(3, 12)
    view = packed_view(f, compressed(rows), 36, byteStride=12, count=3, mode="ATTRIBUTES")
    positions = f.add("accessors", bufferView=view, componentType=5126, type="VEC3", count=3)
    f.add("meshes", primitives=[{"attributes": {"POSITION": positions}}])
    f.add("nodes", mesh=0)
    f.json["extensionsRequired"] = ["EXT_meshopt_compression"]
    assert_allclose(triangles(read(f).shapes[0])[0], TRIANGLE)
    extension = f.json["bufferViews"][view]["extensions"]["EXT_meshopt_compression"]
    extension["mode"] = "MAGIC"
    with pytest.raises(FormatError, match=r"bufferViews\[1\].extensions.*unknown mode 'MAGIC'"):
        read(f)
    extension |= {"mode": "ATTRIBUTES", "count": 2**40}
    with pytest.raises(FormatError, match=r"are not the 36 of the view"):
        read(f)


# --- Materials -----------------------------------------------------------------------------------


def test_the_default_material_is_rough_metal(read: Any) -> None:
    f = File()
    f.add("nodes", mesh=f.mesh())
    assert only_material(read(f)) == ph.Material(
        "principled", color=(1.0, 1.0, 1.0), metallic=1.0, roughness=1.0
    )


@pytest.mark.parametrize(
    ("extensions", "expected"),
    [
        ({"clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.25}},
         {"clearcoat": 0.5, "clearcoat_roughness": 0.25}),
        ({"sheen": {"sheenColorFactor": [1, 0.5, 0], "sheenRoughnessFactor": 0.75}},
         {"sheen_color": (1, 0.5, 0), "sheen_roughness": 0.75}),
        ({"iridescence": {"iridescenceFactor": 1, "iridescenceIor": 1.5}},
         {"iridescence": 1, "iridescence_ior": 1.5, "iridescence_thickness": 400}),
        ({"ior": {"ior": 2}, "specular": {"specularFactor": 0.5}},
         {"ior": 2, "specular": 0.5, "specular_color": (1, 1, 1)}),
        # reflects 4 times as much: 0.16 at normal incidence, as an index of 1.4 / 0.6 does
        ({"specular": {"specularColorFactor": [4, 2, 0]}},
         {"ior": 1.4 / 0.6, "specular": 1, "specular_color": (1, 0.5, 0)}),
        ({"emissive_strength": {"emissiveStrength": 5}}, {"emission": (5, 2.5, 0)}),
        ({"transmission": {"transmissionFactor": 1},
          "volume": {"thicknessFactor": 1, "attenuationDistance": 2,
                     "attenuationColor": [0.25, 1, 1]}},
         {"transmission": 1, "absorption": (math.log(2), 0, 0)}),
        # alphas 0.25 across, 0.25 + 0.75 * 0.25 along
        ({"anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": math.pi / 2}},
         {"anisotropy": 0.1875 / 0.6875, "anisotropy_rotation": 90,
          "roughness": (0.25 * 0.4375) ** 0.25}),
        # as metallic as its reflectance is above 0.04: a metal
        ({"pbrSpecularGlossiness": {"diffuseFactor": [0, 0, 0, 1],
                                    "specularFactor": [1, 0.5, 0.25], "glossinessFactor": 0.25}},
         {"color": (1, 0.5, 0.25), "metallic": 1, "roughness": 0.75}),
        ({"pbrSpecularGlossiness": {"diffuseFactor": [0.5, 0.25, 1, 1],
                                    "specularFactor": [0.04, 0.04, 0.04]}},
         {"color": (0.48, 0.24, 0.96), "metallic": 0, "roughness": 0}),
    ],
)  # fmt: skip
def test_extensions_of_materials(
    read: Any, extensions: dict[str, Any], expected: dict[str, Any]
) -> None:
    f = File()
    f.material(
        emissiveFactor=[1, 0.5, 0],
        pbrMetallicRoughness={"metallicFactor": 0, "roughnessFactor": 0.5},
        extensions={f"KHR_materials_{name}": value for name, value in extensions.items()},
    )
    scene = read(f, strict=True)
    found = only_material(scene)
    for name, value in expected.items():
        assert_allclose(found.params[name], value, rtol=1e-4, atol=1e-6, err_msg=name)
    ph.prepare(scene)


def test_specular_and_glossy_textures(read: Any) -> None:
    f = File()
    mirror = np.array([[[255, 255, 255, 51], [0, 0, 0, 255]]], np.uint8)
    glossy = {"diffuseTexture": f.picture(FOUR), "specularGlossinessTexture": f.picture(mirror)}
    f.material(extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    scene = read(f, strict=True)
    params = only_material(scene).params
    # left half a white mirror, right half the diffuse colour, green above white
    assert texels(params["metallic"]).tolist() == [[255, 0], [255, 0]]
    assert texels(params["roughness"]).tolist() == [[204, 0], [204, 0]]
    assert texels(params["color"]).tolist() == [[[255] * 3, [0, 255, 0]], [[255] * 3, [255] * 3]]
    ph.prepare(scene)


def test_panes_without_volume_are_thin(read: Any) -> None:
    f = File()
    glass = {"KHR_materials_transmission": {"transmissionFactor": 1.0}}
    smooth = {"metallicFactor": 0, "roughnessFactor": 0, "baseColorFactor": [1, 0, 0, 1]}
    f.material(extensions=glass, pbrMetallicRoughness=smooth)
    smooth["roughnessFactor"] = 0.25
    found = only_material(read(f, strict=True))
    pane = {"ior": 1.5, "transmittance": (1.0, 0.0, 0.0)}
    assert found == ph.Material("thin_dielectric", roughness=0.25, **pane)
    glass["KHR_materials_transmission"]["transmissionFactor"] = 0.25
    found = only_material(read(f, strict=True))
    assert (found.type, found.params["weight"]) == ("blend", 0.25)
    ph.prepare(read(f))


def test_diffuse_transmission(read: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Of what does not shine a sheet, (1 - f) base back and f color through; else a blend."""
    f = File()
    name = "KHR_materials_diffuse_transmission"
    thin = {"diffuseTransmissionFactor": 0.25, "diffuseTransmissionColorFactor": [0.5, 1, 0.25]}
    dull = {"KHR_materials_specular": {"specularFactor": 0}}
    pbr = {"baseColorFactor": [0.5, 0.25, 1, 1], "metallicFactor": 0}
    f.material(pbrMetallicRoughness=pbr, extensions={name: thin, **dull})
    material = f.json["materials"][0]
    found = only_material(read(f))
    assert found.type == "diffuse_transmission"
    assert_allclose(found.params["color"], [0.375, 0.1875, 0.75])
    assert_allclose(found.params["transmittance"], [0.125, 0.25, 0.0625])
    assert not caplog.messages
    # a texture of the share, in alpha, and one of the colour
    alpha, paint = np.full((1, 1, 4), [0, 0, 0, 51], np.uint8), np.full((1, 1, 3), 255, np.uint8)
    textures = {"diffuseTransmissionTexture": f.picture(alpha),
                "diffuseTransmissionColorTexture": f.picture(paint)}  # fmt: skip
    material["extensions"][name] = thin | textures
    found = only_material(read(f))
    assert found.type == "blend"
    assert found.params["b"].type == "diffuse_transmission"
    assert found.params["b"].params["color"] == (0.0, 0.0, 0.0)
    share, through = found.params["weight"].params, found.params["b"].params["transmittance"].params
    assert share["color0"].params["channel"] == "a"
    assert texels(share["color0"])[0, 0, 3] == 51
    assert share["color1"] == (0.25, 0.25, 0.25)
    assert texels(through["color0"])[0, 0, 0] == 255
    assert through["color1"] == (0.5, 1.0, 0.25)
    assert not caplog.messages
    # what shines, in part metal
    material["extensions"] = {name: thin}
    pbr["metallicFactor"] = 0.5
    found = only_material(read(f))
    assert found.params["weight"] == 0.125
    assert found.params["a"].params["metallic"] == 0.5
    assert "the share that passes light is matte" in caplog.messages[-1]
    pbr["metallicFactor"] = 1
    assert only_material(read(f)).type == "principled"
    pbr["metallicFactor"] = 0
    material["extensions"]["KHR_materials_transmission"] = {"transmissionFactor": 1}
    assert only_material(read(f)).type == "thin_dielectric"
    assert "only the latter is used" in caplog.messages[-1]


def test_glass_with_volume_disperses(read: Any) -> None:
    f = File()
    f.material(
        extensions={
            "KHR_materials_transmission": {"transmissionFactor": 1.0},
            "KHR_materials_volume": {"thicknessFactor": 1.0},
            "KHR_materials_dispersion": {"dispersion": 0.36},
        },
        pbrMetallicRoughness={"metallicFactor": 0, "roughnessFactor": 0},
    )
    assert only_material(read(f, strict=True)).params["dispersion"] == 0.36


def test_unlit_surfaces_are_as_bright_as_their_colour(read: Any) -> None:
    f = File()
    f.material(
        extensions={"KHR_materials_unlit": {}},
        pbrMetallicRoughness={"baseColorFactor": [0.5, 0.25, 0.125, 1]},
    )
    image = ph.render(read(f), width=9, height=9, spp=1, filter="box")
    assert_allclose(image.pixels[5, 4], [0.5, 0.25, 0.125])


def texels(texture: Any) -> NDArray[Any]:
    image = texture.params["image"]
    return read_pixels(image) if is_encoded(image) else np.asarray(image)


def test_factors_are_multiplied_into_textures(read: Any) -> None:
    f = File()
    pixels = np.array([[[255, 128, 0], [64, 200, 100]]], np.uint8)
    info = f.picture(pixels)
    f.material(
        emissiveFactor=[1, 1, 1],
        emissiveTexture=info,
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
        pbrMetallicRoughness={
            "baseColorTexture": info,
            "baseColorFactor": [1, 0.5, 0.25, 1],
            "metallicRoughnessTexture": info,
            "metallicFactor": 1,
            "roughnessFactor": 0.5,
        },
    )
    scene = read(f)
    found = only_material(scene).params
    color, emission, roughness = (found[k] for k in ("color", "emission", "roughness"))
    for texture, space, factor in (
        (color, "srgb", (1.0, 0.5, 0.25)),
        (emission, "srgb", (8.0, 8.0, 8.0)),
        (roughness, "linear", (0.5, 0.5, 0.5)),
    ):
        assert texture.type == "multiply"
        assert texture.params["color0"].params["color_space"] == space
        assert texture.params["color1"] == factor
    assert roughness.params["color0"].params["channel"] == "g"
    assert found["metallic"].params["channel"] == "b"
    assert found["metallic"].params["image"] is color.params["color0"].params["image"]
    ph.prepare(scene)


def test_normals_are_scaled(read: Any) -> None:
    f = File()
    tilted = np.array([0.6, 0.0, 0.8])
    pixels = np.round((tilted * 0.5 + 0.5) * 255).astype(np.uint8).reshape(1, 1, 3)
    f.material(normalTexture={**f.picture(pixels), "scale": 0.5})
    found = texels(only_material(read(f)).params["normal_map"]) / 65535 * 2 - 1
    expected = np.array([0.3, 0.0, 0.8]) / np.hypot(0.3, 0.8)
    assert_allclose(found[0, 0], expected, atol=0.01)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [("OPAQUE", None), ("BLEND", [[51, 102, 204]]), ("MASK", [[0, 0, 255]])],
)
def test_alpha_modes(read: Any, mode: str, expected: Any) -> None:
    f = File()
    pixels = np.full((1, 3, 4), 255, np.uint8)
    pixels[0, :, 3] = (51, 102, 204)
    pbr = {"baseColorTexture": f.picture(pixels)}
    f.material(alphaMode=mode, alphaCutoff=0.75, pbrMetallicRoughness=pbr)
    opacity = only_material(read(f)).params.get("opacity")
    if expected is None:
        assert opacity is None
    elif mode == "BLEND":
        assert opacity.params["channel"] == "a"
        assert_allclose(texels(opacity)[:, :, 3], expected)
    else:
        # halfway between 0.4 and 0.8 lies 0.6; 0.75 is nearer to the last texel
        assert texels(opacity)[0, 0] == 0
        assert 0 < texels(opacity)[0, 2] < 255
    pbr.pop("baseColorTexture")
    pbr["baseColorFactor"] = [1, 1, 1, 0.25]  # type: ignore[assignment]
    wanted = {"OPAQUE": None, "BLEND": 0.25, "MASK": 0.0}[mode]
    assert only_material(read(f)).params.get("opacity") == wanted


def test_a_picture_that_is_cut_short_is_named_when_it_is_decoded(read: Any) -> None:
    f = File()
    f.material(
        pbrMetallicRoughness={"baseColorTexture": f.picture(np.zeros((64, 64, 3), np.uint8))}
    )
    scene = read(f)
    texture = only_material(scene).params["color"]
    whole = texture.params["image"]
    cut = type(whole)(whole.data[:-30], whole.name)
    broken = ph.Material("diffuse", color=ph.Texture("image", image=cut))
    with pytest.raises(FormatError, match=r"shape 'mesh': .*scene.*: images\[0\]: cannot be read"):
        ph.prepare(ph.Scene([ph.Mesh(np.eye(3), [[0, 1, 2]], material=broken)]))


def quad(f: File, info: dict[str, Any]) -> None:
    """A square of 2 x 2 in the middle, unlit, straight before an orthographic camera."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # v runs down
    material = f.add(
        "materials",
        extensions={"KHR_materials_unlit": {}},
        pbrMetallicRoughness={"baseColorTexture": info},
    )
    indices = f.array(np.array([0, 1, 2, 0, 2, 3], np.uint16))
    f.add("nodes", mesh=f.mesh(corners, TEXCOORD_0=uv, indices=indices, material=material))
    f.add(
        "cameras", type="orthographic", orthographic={"xmag": 1, "ymag": 1, "zfar": 9, "znear": 1}
    )
    f.add("nodes", camera=0, translation=[0, 0, 3])


# red, green / blue, white
FOUR = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)


@pytest.mark.parametrize(
    ("transform", "corners"),
    [
        ({}, "RGBW"),
        ({"offset": [0.5, 0]}, "GRWB"),
        ({"offset": [0, 0.5]}, "BWRG"),
        # coordinates turned against the clock turn the picture with it
        ({"rotation": math.pi / 2}, "BRWG"),
        ({"scale": [0.5, 0.5]}, "RRRR"),
        # first scaled, then turned, then moved
        ({"scale": [0.5, 0.5], "rotation": math.pi / 2, "offset": [0.5, 1.0]}, "WWWW"),
    ],
)
def test_texture_transforms(read: Any, transform: dict[str, Any], corners: str) -> None:
    f = File()
    info: dict[str, Any] = f.picture(FOUR, magFilter=9728)
    quad(f, {**info, "extensions": {"KHR_texture_transform": transform}})
    scene = read(f)
    assert scene.settings.width == scene.settings.height
    image = ph.render(scene, width=2, height=2, spp=4, filter="box").pixels
    letters = {(1, 0, 0): "R", (0, 1, 0): "G", (0, 0, 1): "B", (1, 1, 1): "W"}
    got = "".join(letters[tuple(np.round(p).astype(int).tolist())] for p in image.reshape(-1, 3))
    assert got == corners


def test_wrap_modes_and_filters(read: Any) -> None:
    f = File()
    quad(f, f.picture(FOUR, wrapS=33071, wrapT=33648))
    found = only_material(read(f)).params["emission"].params
    assert (found["wrap_u"], found["wrap_v"], found["filter"]) == ("clamp", "mirror", "mip")


def test_further_sets_of_texture_coordinates(read: Any) -> None:
    f = File()
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    made = f.add("materials", pbrMetallicRoughness={
        "baseColorTexture": {**f.picture(FOUR), "texCoord": 1},
        "metallicRoughnessTexture": {**f.picture(FOUR), "texCoord": 0}})  # fmt: skip
    f.add("nodes", mesh=f.mesh(TEXCOORD_0=uv, TEXCOORD_1=uv / 2, material=made))
    scene = read(f, strict=True)
    (mesh,) = scene.shapes
    up = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)  # v runs up here
    assert_allclose(np.asarray(mesh.uvs), np.stack([uv[:, 0] / 2, 1 - uv[:, 1] / 2], axis=1))
    assert_allclose(mesh.attributes["vertex_uv0"], up)
    params = only_material(scene).params
    assert params["roughness"].params["uvs"] == "vertex_uv0"
    assert "uvs" not in params["color"].params
    ph.prepare(scene)
    # a normal map takes its tangents from the mesh's own
    f.json["materials"][0]["normalTexture"] = {"index": 0}
    assert_allclose(np.asarray(read(f).shapes[0].uvs), up)
    del f.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"]
    with pytest.raises(FormatError, match="has no TEXCOORD_1, which its material's textures need"):
        read(f, strict=True)


def test_vertex_colours(read: Any) -> None:
    f = File()
    colors = np.array([[1, 0, 0, 0.5], [0, 1, 0, 1], [0, 0, 1, 1]], np.float32)
    pbr: dict[str, Any] = {"baseColorFactor": [0.5, 0.5, 0.5, 0.5]}
    made = f.add("materials", alphaMode="BLEND", pbrMetallicRoughness=pbr)
    f.add("nodes", mesh=f.mesh(COLOR_0=colors, TEXCOORD_0=TRIANGLE[:, :2], material=made))
    scene = read(f, strict=True)
    params = only_material(scene).params
    assert params["color"] == ph.Texture("attribute", name="vertex_color")
    assert params["opacity"] == ph.Texture("attribute", name="vertex_alpha")
    attributes = scene.shapes[0].attributes
    assert_allclose(attributes["vertex_color"], 0.5 * colors[:, :3])
    assert_allclose(attributes["vertex_alpha"], [0.25, 0.5, 0.5])
    ph.prepare(scene)
    pixels = np.full((1, 1, 4), 128, np.uint8)
    pbr["baseColorTexture"] = f.picture(pixels)
    scene = read(f, strict=True)
    found = only_material(scene).params
    assert found["color"].params["color0"] == params["color"]
    assert found["opacity"].params["color1"] == params["opacity"]
    assert found["opacity"].params["color0"].params["channel"] == "a"
    assert_allclose(scene.shapes[0].attributes["vertex_color"], 0.5 * colors[:, :3])
    ph.prepare(scene)


def test_vertex_colours_that_are_all_the_same_are_a_factor(read: Any) -> None:
    f = File()
    half = np.full((3, 3), 128, np.uint8)
    accessor = f.array(half, normalized=True)
    made = f.add("materials", pbrMetallicRoughness={"baseColorFactor": [1, 0.5, 1, 1]})
    f.add("nodes", mesh=f.mesh(COLOR_0=accessor, material=made))
    assert only_material(read(f)).params["color"] == pytest.approx((128 / 255, 64 / 255, 128 / 255))


def test_variants(read: Any) -> None:
    f = File()
    red, blue = (f.add("materials", name=n) for n in ("red", "blue"))
    mappings = {"KHR_materials_variants": {"mappings": [{"material": blue, "variants": [1]}]}}
    f.add("nodes", mesh=f.mesh(material=red, extensions=mappings))
    names = {"variants": [{"name": "day"}, {"name": "night"}]}
    f.json["extensions"] = {"KHR_materials_variants": names}
    assert list(read(f).materials) == ["red"]
    assert list(read(f, variant="day").materials) == ["red"]
    assert list(read(f, variant="night").materials) == ["blue"]
    with pytest.raises(FormatError, match=r"unknown variant 'dusk'.*choices: day, night"):
        read(f, variant="dusk")


# --- Lights and cameras --------------------------------------------------------------------------


def lamps(f: File, *lights: dict[str, Any]) -> None:
    f.json["extensions"] = {"KHR_lights_punctual": {"lights": list(lights)}}
    down = [-math.sqrt(0.5), 0, 0, math.sqrt(0.5)]  # -z becomes -y
    for i in range(len(lights)):
        extension = {"KHR_lights_punctual": {"light": i}}
        f.add("nodes", translation=[0, 4, 0], rotation=down, extensions=extension)


def test_what_has_no_light_gets_some(tmp_path: Path) -> None:
    f = File()
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 1.0}}
    f.material(emissiveFactor=[1, 1, 1], emissiveTexture=f.picture(FOUR), extensions=strength)
    path = tmp_path / "scene.gltf"
    for value, lit in ((1.0, True), (2.0, False)):  # glows for show, or is a lamp
        strength["KHR_materials_emissive_strength"]["emissiveStrength"] = value
        path.write_bytes(f.text())
        scene = load(path)
        assert (scene.background is not None) == lit
        names = [s.name for s in scene.shapes]
        assert ("key light" in names) == ("ground" in names) == lit


def test_lights_are_in_candela_and_lux(read: Any) -> None:
    f = File()
    f.add("nodes", mesh=f.mesh())
    lamps(
        f,
        {"type": "point", "intensity": 6830.0, "color": [1, 0.5, 0]},
        {"type": "directional", "intensity": 683.0},
        {"type": "spot", "intensity": 6830.0,
         "spot": {"innerConeAngle": math.pi / 6, "outerConeAngle": math.pi / 3}},
    )  # fmt: skip
    scene = read(f)
    assert scene.background is None
    point, sun, spot = scene.lights
    assert_allclose(point.params["intensity"], (10, 5, 0))
    assert_allclose(point.params["position"], (0, 4, 0))
    assert_allclose(sun.params["irradiance"], (1, 1, 1))
    assert_allclose(sun.params["direction"], (0, -1, 0), atol=1e-6)
    assert_allclose(spot.params["direction"], (0, -1, 0), atol=1e-6)
    assert_allclose((spot.params["beam_width"], spot.params["cutoff_angle"]), (30, 60))
    ph.prepare(scene)


def test_lights_too_dim_for_lux_are_taken_as_radiometric(read: Any) -> None:
    f = File()
    f.add("nodes", mesh=f.mesh())
    lamps(f, {"type": "directional", "intensity": 3.0})
    assert_allclose(read(f).lights[0].params["irradiance"], (3, 3, 3))


def test_a_camera_and_its_proportions(read: Any) -> None:
    f = File()
    perspective = {"yfov": math.radians(50), "aspectRatio": 2.0, "znear": 0.1}
    f.add("cameras", type="perspective", perspective=perspective)
    turn = [0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)]  # -z becomes -x
    f.add("nodes", camera=0, translation=[9, 1, 0], rotation=turn)
    scene = read(f)
    camera = scene.camera
    assert camera.vfov == pytest.approx(50)
    assert_allclose(camera.eye, (9, 1, 0))
    assert_allclose(np.subtract(camera.target, camera.eye), (-1, 0, 0), atol=1e-6)
    assert_allclose(camera.up, (0, 1, 0), atol=1e-6)
    assert (scene.settings.width, scene.settings.height) == (640, 320)


# --- What is broken or not supported -------------------------------------------------------------


def broken(change: Any) -> File:
    """A good file with a triangle, normals, indices and a picture, which `change` spoils."""
    f = File()
    normals = np.tile(np.array([[0, 0, 1]], np.float32), (3, 1))
    indices = f.array(np.array([0, 1, 2], np.uint16))  # accessors 0, 1: normals, 2: positions
    uv = np.zeros((3, 2), np.float32)
    mesh = f.mesh(NORMAL=f.array(normals), indices=indices, TEXCOORD_0=uv)
    f.json["meshes"][mesh]["primitives"][0]["material"] = f.material(
        pbrMetallicRoughness={"baseColorTexture": f.picture(FOUR)}
    )
    f.add("nodes", mesh=mesh)
    change(f.json)
    return f


def put(*path: Any) -> Any:
    """A change: the last of the path is put where the others lead."""

    def change(document: Any) -> None:
        *place, key, value = path
        for step in place:
            document = document[step]
        document[key] = value

    return change


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (put("asset", {}), r"asset: Object missing required field version"),
        (put("asset", "version", "1.0"), r"asset.version is '1.0'"),
        (put("extensionsRequired", ["EXT_new"]), r"requires the extension 'EXT_new'"),
        (put("nodes", 1, "mesh", 9), r"nodes\[1\].mesh is 9; the file has 2, from 0, in 'meshes'"),
        (put("nodes", 1, "mesh", -1), r"nodes\[1\].mesh: Expected int >= 0"),
        (put("nodes", 1, "children", [1]), r"nodes\[1\].children\[0\] is the node itself"),
        (put("nodes", 1, "children", [7]), r"nodes\[1\].children\[0\] is 7; the file has 2"),
        (put("nodes", 1, "translation", [1, 2]), r"nodes\[1\].translation: Expected array of"),
        (put("nodes", 1, "scale", [1e39] * 3), r"nodes\[1\]: its place in the scene is not finite"),
        (put("nodes", 1, "matrix", [0] * 15 + [2]), r"nodes\[1\].matrix: its last row"),
        (put("scenes", [{"nodes": [8]}]), r"scenes\[0\].nodes\[0\] is 8"),
        (put("scene", 3), None),
        (put("accessors", 2, "count", 4_000_000_000), r"accessors\[2\]: 4000000000 elements need"),
        (put("accessors", 1, "count", 2), r"attributes.NORMAL: has another number of elements"),
        (put("accessors", 0, "count", 4_000_000_000), r"accessors\[0\]: 4000000000 elements need"),
        (put("accessors", 0, "componentType", 5122), r"accessor 0 holds int16; must be unsigned"),
        (put("accessors", 0, "componentType", 1), r"accessors\[0\].componentType: is 1; must be"),
        (put("accessors", 0, "type", "VEC9"), r"accessors\[0\] is of type 'VEC9'; must be SCALAR"),
        (put("accessors", 0, "bufferView", 99), r"accessors\[0\].bufferView is 99; the file has"),
        (put("accessors", 0, "byteOffset", 2**40), r"accessors\[0\]: 3 elements need"),
        (put("bufferViews", 0, "byteLength", 2**40), r"bufferViews\[0\]: bytes 0 to 1099511627776"),
        (put("bufferViews", 0, "buffer", 5), r"bufferViews\[0\].buffer is 5; the file has 1"),
        (put("bufferViews", 0, "byteStride", 0), r"bufferViews\[0\].byteStride: Expected int >= 4"),
        (put("meshes", 0, "primitives", 0, "mode", 9), r"primitives\[0\].mode is 9"),
        (put("meshes", 0, "primitives", 0, "material", 9), r"primitives\[0\].material is 9"),
        (put("materials", 0, "alphaMode", "HAZE"), r"materials\[0\].alphaMode is 'HAZE'; must be"),
        (put("materials", 0, "pbrMetallicRoughness", {"metallicFactor": 7}),
         r"materials\[0\].pbrMetallicRoughness.metallicFactor: Expected float <="),
        (put("materials", 0, "extensions", {"KHR_materials_ior": {"ior": "x"}}),
         r"materials\[0\].extensions.KHR_materials_ior.ior: Expected float"),
        (put("textures", 0, "source", 4), r"textures\[0\].source is 4"),
        (put("images", 0, {"uri": "http://example.com/a.png"}), r"images\[0\].uri: is a http: URI"),
        (put("images", 0, {"uri": "../../etc/a.png"}), r"images\[0\].uri: .* not inside the scene"),
        (put("images", 0, {"uri": "a.png"}), r"images\[0\].uri: 'a.png': no such file"),
        (put("images", 0, {"bufferView": 0}), r"images\[0\]: is none of PNG, JPEG and WebP"),
        (put("images", 0, {}), r"images\[0\]: has neither uri nor bufferView"),
        (put("images", 0, {"uri": "data:image/png,x"}), r"images\[0\].uri: is a data: URI without"),
        (put("images", 0, {"uri": "data:;base64,%%"}), r"images\[0\].uri: is no base64 text"),
    ],
)  # fmt: skip
def test_what_is_broken_is_named(read: Any, change: Any, text: str | None) -> None:
    f = broken(change)
    if text is None:  # a default scene that says nothing where there are no scenes
        read(f)
        return
    with pytest.raises(FormatError, match=r"scene\.gltf: .*" + text):
        ph.prepare(read(f))


def test_the_file_that_is_spoilt_is_good(read: Any) -> None:
    ph.prepare(read(broken(lambda _: None), strict=True))


def test_bad_numbers_in_arrays_are_named(read: Any) -> None:
    f = File()
    positions = TRIANGLE.copy()
    positions[1, 2] = np.nan
    f.add("nodes", mesh=f.mesh(positions))
    with pytest.raises(FormatError, match=r"attributes.POSITION: element 1 is not finite"):
        read(f)
    f = File()
    f.add("nodes", mesh=f.mesh(indices=f.array(np.array([0, 1, 77], np.uint8))))
    with pytest.raises(
        FormatError, match=r"indices: element 0 refers to vertex 77; .* has 3, from"
    ):
        read(f)
    f = skinned()
    f.json["skins"][0]["joints"] = [1]
    with pytest.raises(FormatError, match=r"vertex 2 refers to joint 1; the skin has 1, from 0"):
        read(f)


def test_cycles_of_nodes(read: Any) -> None:
    f = File()
    f.add("nodes", mesh=f.mesh())
    for child in (2, 3, 1):
        f.add("nodes", children=[child])
    with pytest.raises(FormatError, match=r"nodes\[1\]: is its own ancestor"):
        read(f)
    f.json["nodes"][3]["children"] = []
    f.json["nodes"][0]["children"] = [2]
    with pytest.raises(FormatError, match=r"nodes\[1\].children\[0\] is nodes\[0\]'s too"):
        read(f)


def test_deep_trees_and_deep_json(read: Any) -> None:
    f = File()
    mesh = f.mesh()
    depth = 20_000
    for i in range(depth):
        f.add("nodes", translation=[0, 0, 1], **({"children": [i + 1]} if i < depth - 1 else {}))
    f.json["nodes"][-1]["mesh"] = mesh
    assert np.asarray(read(f).shapes[0].vertices)[0, 2] == depth
    deep = b'{"asset": {"version": "2.0"}, "extras": ' + b"[" * depth + b"]" * depth + b"}"
    with pytest.raises(FormatError, match="nested too deeply"):
        read(deep)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "is empty"),
        (b"  \n", "is empty"),
        (b'{"asset": {"version": "2.0"}', "its JSON is not complete"),
        (b'{"asset": {"version": "2.0"}, "nodes": [1e999]}', r"nodes\[0\]: "),
        (b'{"asset": {"version": "2.0"}, "scene": NaN}', "malformed"),
        (b"\x00\xff\x00\xff", "malformed"),
        (b'{"asset": {"version": "2.0"}, "nodes": [{"name": "\xff"}]}', "scene.gltf: "),
        (b"glTF", "has 4 bytes"),
        (b"glTF" + struct.pack("<IIII", 1, 20, 0, 0), "version 1 of the .glb format"),
        (b"glTF" + struct.pack("<IIII", 2, 4_000_000_000, 0, 0), "is cut off"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 2**31, 0x4E4F534A), "reaches beyond the end"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 0, 7), "has no JSON chunk"),
    ],
)
def test_no_documents(read: Any, data: bytes, text: str) -> None:
    with pytest.raises(FormatError, match=text):
        read(data)


def test_memory_stays_in_proportion(read: Any) -> None:
    f = File()
    mesh = f.mesh()
    # 100,000 vertices in 1.2 MB, ten thousand times over
    big = f.array(np.zeros((100_000, 3), np.float32))
    f.json["meshes"][mesh]["primitives"] = [{"attributes": {"POSITION": big}}] * 10_000
    f.add("nodes", mesh=mesh)
    with pytest.raises(FormatError, match=r"asks for more than .* bytes of memory"):
        read(f)
    f = File()
    zeros = f.add("accessors", componentType=5126, type="VEC3", count=4_000_000_000)
    f.add("meshes", primitives=[{"attributes": {"POSITION": zeros}}])
    f.add("nodes", mesh=0)
    with pytest.raises(FormatError, match="4000000000 elements without data"):
        read(f)


def test_pictures_of_too_many_pixels_are_refused(read: Any) -> None:
    png = bytearray(encoded(FOUR, {}, ".png"))
    png[16:24] = struct.pack(">II", 2**15, 2**15)  # what its header says
    f = File()
    image = f.add("images", bufferView=f.view(bytes(png)))
    texture = {"index": f.add("textures", source=image)}
    f.material(pbrMetallicRoughness={"baseColorTexture": texture})
    with pytest.raises(
        FormatError, match=r"images\[0\]: (has 32768 x 32768 pixels|cannot be read)"
    ):
        read(f)


def test_what_is_not_supported_is_told(read: Any, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "parhelion")  # the command line changes it
    f = File()
    f.material(
        extensions={
            "KHR_materials_clearcoat": {
                "clearcoatFactor": 1,
                "clearcoatNormalTexture": f.picture(FOUR),
            },
        },
    )
    f.json["extensionsUsed"] = ["EXT_magic"]
    read(f)
    for name in ("clearcoatNormalTexture", "EXT_magic"):
        assert name in caplog.text
    with pytest.raises(FormatError, match="strict, and not all of it is supported"):
        read(f, strict=True)


def test_ktx2_images_are_left_out(read: Any, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "parhelion")  # the command line changes it
    f = File()
    ktx = f.add("images", bufferView=f.view(b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(64)))
    basis = {"KHR_texture_basisu": {"source": ktx}}
    texture = f.add("textures", extensions=basis)
    f.material(pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    f.json["extensionsRequired"] = ["KHR_texture_basisu"]
    assert only_material(read(f)).params["color"] == (1.0, 1.0, 1.0)
    assert "has no image that can be read (KHR_texture_basisu)" in caplog.text
    f.json["textures"][texture] = {"source": ktx}
    read(f)
    assert "KTX2 images are not supported" in caplog.text


def test_a_time_without_animations(read: Any) -> None:
    with pytest.raises(FormatError, match="the file has no animations"):
        read(File(), time=1.0)


def test_mutated_files_raise_only_format_errors(tmp_path: Path) -> None:
    """A thousand files, some bytes of each changed: no crash, and one kind of error."""
    f = skinned()
    f.material(pbrMetallicRoughness={"baseColorTexture": f.picture(FOUR)}, alphaMode="MASK")
    whole = np.frombuffer(f.glb(), np.uint8)
    rng = np.random.default_rng(1)
    path = tmp_path / "scene.glb"
    failed = 0
    for _ in range(1000):
        data = whole.copy()
        places = rng.integers(0, len(data), rng.integers(1, 6))
        data[places] = rng.integers(0, 256, len(places))
        path.write_bytes(data.tobytes())
        try:
            load(path)
        except FormatError as error:
            assert str(error).startswith(str(path))  # noqa: PT017
            failed += 1
    assert 0 < failed < 1000


# --- Files of others -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "shapes", "faces", "materials"),
    [
        ("DamagedHelmet/DamagedHelmet.glb", 1, 15452, 1),
        ("khronos-small/BoxTextured.glb", 1, 12, 1),
        ("khronos-small/Duck.glb", 1, 4212, 1),
        ("khronos-small/CesiumMilkTruck.glb", 4, 2856, 4),
        ("blender-io-roundtrip/01_alpha_mask/01_alpha_mask.gltf", 1, 2, 1),
        ("blender-io-roundtrip/04_lights/04_lights.gltf", 1, 2, 1),
        ("blender-io-roundtrip/05_metallic_sphere_light/05_metallic_sphere_light.gltf", 2, 962, 2),
        ("blender-io-roundtrip/09_texture_transform/09_texture_transform.gltf", 1, 2, 1),
        ("blender-io-roundtrip/14_emission_strength/14_emission_strength.gltf", 18, 17280, 18),
        ("blender-io-roundtrip/15_transmission/15_transmission.gltf", 5, 4800, 5),
        ("blender-io-roundtrip/16_volume/16_volume.gltf", 20, 236, 20),
        ("blender-io-roundtrip/17_ior/17_ior.gltf", 5, 60, 5),
        ("blender-io-roundtrip/19_sheen/19_sheen.gltf", 7, 6720, 7),
    ],
)
def test_shared_scenes(
    shared_scenes: Path, name: str, shapes: int, faces: int, materials: int
) -> None:
    scene = without_studio(load(shared_scenes / "gltf" / name))
    meshes = [m for s in scene.shapes for m in getattr(s, "shapes", [s])]
    assert len(scene.shapes) == shapes
    assert sum(len(np.asarray(m.faces)) for m in meshes) == faces
    assert len(scene.materials) == materials
    ph.prepare(scene)
