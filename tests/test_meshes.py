"""Mesh files: known meshes written in every way a format allows, and broken ones."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import parhelion as ph
from parhelion.errors import FormatError
from parhelion.io.meshes import (
    MeshData,
    levelset,
    obj,
    off,
    ply,
    serialized,
    smooth_normals,
    split_at_creases,
    triangulate,
)

# A pyramid of a square and four triangles
_POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 2]], np.float32)
_POLYGONS = [[0, 1, 2, 3], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
_TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]


def corners(mesh: MeshData) -> list[list[list[float]]]:
    return np.asarray(mesh.vertices, float)[mesh.faces].tolist()


_PYRAMID = _POINTS.astype(float)[_TRIANGLES].tolist()


def test_polygons_become_fans() -> None:
    counts = np.array([3, 5, 4])
    turns = np.concatenate([np.arange(n) / n for n in counts]) * 2 * np.pi
    around = np.stack([np.cos(turns), 0 * turns, np.sin(turns)], axis=1)
    faces, polygon = triangulate("it", counts, np.arange(12), around)
    assert faces.tolist() == [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 7], [8, 9, 10], [8, 10, 11]]
    assert polygon.tolist() == [0, 1, 1, 1, 2, 2]


def area(vertices: Any, faces: Any) -> Any:
    """(F, 3) vectors as long as each triangle is large."""
    a, b, c = (np.asarray(vertices)[np.asarray(faces)[:, k]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


@pytest.mark.parametrize("corners", [4, 5, 8, 40, 600])
def test_polygons_that_are_not_convex(corners: int) -> None:
    """Stars: their triangles cover them once, all turned the same way, wherever the first is."""
    rng = np.random.default_rng(corners)
    turns = 2 * np.pi * (np.arange(corners) + 0.8 * rng.random(corners)) / corners
    radius = rng.uniform(0.2, 1.0, corners)
    radius[0] = 0.05
    flat = np.stack([radius * np.cos(turns), radius * np.sin(turns), 0 * turns], axis=1)
    lean = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    outline = flat @ lean.T + rng.normal(size=3)
    ends = np.roll(outline, -1, axis=0)
    whole = 0.5 * np.cross(outline, ends).sum(axis=0)
    for first in range(0, corners, max(1, corners // 5)):
        order = np.roll(np.arange(corners), first)
        faces, polygon = triangulate("it", np.array([corners]), order, outline)
        assert len(faces) == corners - 2 == len(polygon)
        parts = area(outline, faces)
        assert (parts @ whole > -1e-9).all()
        np.testing.assert_allclose(parts.sum(axis=0), whole, atol=1e-9)


def test_polygons_that_cannot_be_cut_well() -> None:
    """One that crosses itself, one without an area, and one that is too large to be looked at."""
    bow = np.array([[0.0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 2, 0], [-1, 1, 0]])
    assert len(triangulate("it", np.array([5]), np.arange(5), bow)[0]) == 3
    assert len(triangulate("it", np.array([5]), np.zeros(5, int), bow)[0]) == 3
    n = 20_000
    turns = 2 * np.pi * np.arange(n) / n
    star = np.stack([np.cos(turns), np.sin(turns), 0 * turns], 1)
    assert len(triangulate("it", np.array([n]), np.arange(n), star)[0]) == n - 2
    rounded = np.add(star, [100, 0, 0]).astype(np.float32)
    assert len(triangulate("it", np.array([n]), np.arange(n), rounded)[0]) == n - 2
    star[::2] *= 0.5
    with pytest.raises(
        ValueError, match="face 0 has 20000 corners and is not convex; at most 16384"
    ):
        triangulate("it", np.array([n]), np.arange(n), star)


def test_a_dent_in_every_format(tmp_path: Path) -> None:
    points = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 0.5, 0), (0, 2, 0)]
    lines = "".join("{} {} {}\n".format(*p) for p in points)
    head = "ply\nformat ascii 1.0\nelement vertex 5\n"
    head += "".join(f"property float {a}\n" for a in "xyz")
    texts = {
        "a.obj": "".join(f"v {line}\n" for line in lines.splitlines()) + "f 1 2 3 4 5\n",
        "a.off": f"OFF\n5 1 0\n{lines}5 0 1 2 3 4\n",
        "a.ply": f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{lines}5 0 1 2 3 4\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        found = {"obj": obj, "off": off, "ply": ply}[name[2:]].read(tmp_path / name)
        np.testing.assert_allclose(area(found.vertices, found.faces).sum(axis=0), [0, 0, 2.5])
        assert (area(found.vertices, found.faces)[:, 2] > 0).all()


def test_what_obj_files_may_have(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """UTF-8's mark, a comment that ends in a backslash, one texture coordinate, old line ends; and
    what nothing is made of is told.
    """
    path = tmp_path / "a.obj"
    text = "\ufeffv 0 0 0\n# C:\\a\\\nv 1 0 0\nv 0 1 0\nvt 0.5\nl 1 2\nvp 0\nf 1/1 2/1 3/1\n"
    for ends in ("\n", "\r\n", "\r"):
        path.write_bytes(text.replace("\n", ends).encode())
        mesh = obj.read(path)
        assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
        assert mesh.uvs is not None
        assert mesh.uvs[0].tolist() == [0.5, 0.0]
    ph.load(path)
    assert [m.partition(": ")[2] for m in caplog.messages] == [
        f"statement {word!r}: not supported; left out" for word in ("l", "vp")
    ]
    path.write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
    with pytest.raises(FormatError, match=r"has no faces \('f' lines\); of l nothing is made"):
        obj.read(path)


def test_what_ply_files_may_have(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.ply"
    vertices = "element vertex 3\n" + "".join(f"property float {a}\n" for a in "xyz")
    faces = (
        "element face 1\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nelement edge 1\nproperty int vertex1\n"
    )
    body = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 2 0.5 0.5\n0\n"
    path.write_text(f"ply\nformat ascii 1.0\n{vertices}{faces}end_header\n{body}")
    ph.load(path)
    assert [m.partition(": ")[2] for m in caplog.messages] == [
        "list 'texcoord' of 'face': not supported; left out",
        "element 'edge': not supported; left out",
    ]
    strips = "element tristrips 1\nproperty list int int vertex_indices\n"
    path.write_text(
        f"ply\nformat ascii 1.0\n{vertices}{strips}end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    with pytest.raises(FormatError, match="its faces are tristrips, which are not read"):
        ph.load(path)


@pytest.mark.parametrize("size", ["nan", "inf", "-1", "1e30", "2.5e9"])
def test_lists_of_odd_sizes(tmp_path: Path, size: str) -> None:
    path = tmp_path / "a.ply"
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    head += "".join(f"property float {a}\n" for a in "xyz")
    head += "element face 1\nproperty list float float vertex_indices\nend_header\n"
    numbers = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, float(size), 0, 1, 2], "<f4")
    path.write_bytes(head.encode() + numbers.tobytes())
    with pytest.raises(FormatError, match=r"negative size|cut short"):
        ply.read(path)


def test_a_face_without_area_makes_no_edge() -> None:
    """A roof whose ridge has a vertex on one side only, closed by a sliver."""
    up = np.tan(np.radians(10.0))
    points = np.array([[0, 0, up], [2, 0, up], [1, 0, up], [1, 1, 0], [0, -1, 0], [2, -1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 3], [0, 4, 1], [4, 5, 1]])
    _, old, normals = split_at_creases(points, faces, 40.0)
    assert len(old) == 6
    assert (normals[old < 2, 2] > 0.99).all()
    steep = points * [1, 1, 10]
    assert len(split_at_creases(steep, faces, 40.0)[1]) == 8


def test_smooth_normals_weigh_by_angle() -> None:
    """At a cube's corner the three sides count alike, though one is of two triangles there."""
    cube = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    quads = np.array(
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    faces, _ = triangulate("it", np.full(6, 4), quads.ravel(), cube)
    expected = (2.0 * cube - 1.0) / np.sqrt(3.0)
    np.testing.assert_allclose(smooth_normals(cube, faces), expected, atol=1e-7)


def test_smooth_normals_of_vertices_without_a_face() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5], [2, 0, 0]])
    normals = smooth_normals(points, np.array([[0, 1, 2], [0, 1, 4]]))  # the second has no area
    assert normals[:3].tolist() == [[0.0, 0.0, 1.0]] * 3
    assert normals[3:].tolist() == [[1.0, 0.0, 0.0]] * 2


# OBJ

_V = "".join("v {} {} {}\n".format(*p) for p in _POINTS)
_OBJ = {
    "plain": _V + "".join("f " + " ".join(str(i + 1) for i in p) + "\n" for p in _POLYGONS),
    "negative": _V + "".join("f " + " ".join(str(i - 5) for i in p) + "\n" for p in _POLYGONS),
    "slashes": _V
    + "vn 0 0 1\nvt 0.5 0.25\n"
    + "".join("f " + " ".join(f"{i + 1}//1" for i in p) + "\n" for p in _POLYGONS),
    "all": _V
    + "vn 0 0 1\nvt 0.5 0.25\n"
    + "".join("f " + " ".join(f"{i + 1}/1/1" for i in p) + "\n" for p in _POLYGONS),
    "wild": "# a pyramid\r\nmtllib x.mtl\r\no p\r\n"
    + _V.replace("\n", " 1.0 0.5 0.5 0.5 # grey\r\n").replace("v ", "  v\t")
    + "g side\r\ns off\r\nf 1 2 \\\r\n 3 4\r\n"
    + "".join("f " + " ".join(str(i + 1) for i in p) + "\r\n" for p in _POLYGONS[1:]),
}


@pytest.mark.parametrize("case", _OBJ)
def test_obj(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.obj"
    path.write_bytes(_OBJ[case].encode())
    mesh = obj.read(path)
    assert corners(mesh) == _PYRAMID
    assert len(mesh.vertices) == 5
    assert (mesh.normals is not None) == (case in ("slashes", "all"))
    assert (mesh.uvs is not None) == (case == "all")
    if mesh.normals is not None:
        assert mesh.normals.tolist() == [[0.0, 0.0, 1.0]] * 5


def test_obj_splits_vertices_that_differ_in_anything(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(_V + "vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 1/2 3/3 4/1\n")
    mesh = obj.read(path)
    assert mesh.uvs is not None
    assert len(mesh.vertices) == 5
    assert mesh.uvs[mesh.faces].tolist() == [[[0, 0], [1, 0], [1, 1]], [[1, 0], [1, 1], [0, 0]]]


_BAD_OBJ = {
    "empty": ("", "has no faces"),
    "no faces": (_V, "has no faces"),
    "two corners": (_V + "f 1 2\n", "line 6: a face needs at least 3 corners"),
    "index 0": (_V + "f 1 2 0\n", "line 6: face 0 refers to vertex 0; there are 5"),
    "too large": (_V + "\nf 1 2 3\nf 1 2 6\n", "line 8: face 1 refers to vertex 6; there are 5"),
    "too negative": (_V + "f 1 2 -6\n", "refers to vertex -6"),
    "before its vertex": ("v 0 0 0\nf -1 -2 -3\n" + _V, "line 2: face 0 refers to vertex -2"),
    "no normal": (_V + "f 1//1 2//1 3//1\n", "face 0 refers to normal 1; there are 0"),
    "a word": (_V + "f 1 2 x\n", "line 6: 'x' is no corner v/vt/vn"),
    "a fraction": (_V + "f 1 2 3.5\n", "no corner v/vt/vn"),
    "four parts": (_V + "f 1/1/1/1 2 3\n", "no corner v/vt/vn"),
    "short vertex": ("v 1 2\n", "line 1: has fewer than 3 numbers"),
    "no number": ("v 1 2 x\nf 1 1 1\n", "line 1: the vertex holds something that is no number"),
}


@pytest.mark.parametrize("case", _BAD_OBJ)
def test_bad_obj(tmp_path: Path, case: str) -> None:
    text, error = _BAD_OBJ[case]
    path = tmp_path / "bad.obj"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        obj.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert error in str(caught.value)


# PLY


def _ply(form: str, polygons: list[list[int]], *, extra: bool) -> bytes:
    """The pyramid; `extra`: with lists and numbers that a reader has to step over."""
    header = f"ply\nformat {form} 1.0\ncomment made here\nelement vertex {len(_POINTS)}\n"
    header += "property float x\nproperty float y\nproperty float z\n"
    header += "property uchar red\nproperty uchar green\nproperty uchar blue\n" if extra else ""
    header += f"element face {len(polygons)}\nproperty list uchar int vertex_indices\n"
    header += "property float heat\nproperty list ushort float texcoord\n" if extra else ""
    header += "end_header\n"
    order = ">" if form == "binary_big_endian" else "<"
    rows: list[bytes] = []

    def put(kinds: str, *values: float) -> None:
        if form == "ascii":
            rows.append((" ".join(f"{v:g}" for v in values) + "\n").encode())
        else:
            rows.append(struct.pack(order + kinds, *values))

    for i, point in enumerate(_POINTS):
        put("fffBBB" if extra else "fff", *point.tolist(), *([0, 255, 10 * i] if extra else []))
    for i, polygon in enumerate(polygons):
        kinds, values = f"B{len(polygon)}i", [len(polygon), *polygon]
        if extra:
            kinds, values = kinds + f"fH{i}f", [*values, 0.5 * i, i, *([0.25] * i)]
        put(kinds, *values)
    return header.encode() + b"".join(rows)


@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize("polygons", [_POLYGONS, _TRIANGLES], ids=["mixed", "triangles"])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(tmp_path: Path, form: str, polygons: list[list[int]], extra: bool) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(_ply(form, polygons, extra=extra))
    mesh = ply.read(path)
    assert corners(mesh) == _PYRAMID
    assert mesh.normals is None
    if extra:
        heat = np.repeat(0.5 * np.arange(len(polygons)), [len(p) - 2 for p in polygons])
        assert mesh.attributes["face_heat"].tolist() == heat.tolist()
        colors = mesh.attributes["vertex_color"]
        assert colors.shape == (5, 3)
        np.testing.assert_allclose(colors[4], (0.0, 1.0, 0.0212), atol=1e-4)  # sRGB 40 / 255
    else:
        assert not mesh.attributes


def test_ply_normals_uvs_and_attributes(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    names = ["x", "y", "z", "nx", "ny", "nz", "s", "t", "heat", "flow_x", "flow_y", "flow_z"]
    header = "ply\nformat ascii 1.0\nelement vertex 3\n"
    header += "".join(f"property double {name}\n" for name in names)
    header += "element face 1\nproperty list uint8 uint32 vertex_index\nend_header\n"
    rows = "".join(" ".join(str(10 * i + j) for j in range(12)) + "\n" for i in range(3))
    path.write_text(header + rows + "3 0 1 2\n")
    mesh = ply.read(path)
    assert mesh.normals is not None
    assert mesh.uvs is not None
    assert mesh.normals[1].tolist() == [13.0, 14.0, 15.0]
    assert mesh.uvs[1].tolist() == [16.0, 17.0]
    assert mesh.attributes["vertex_heat"].tolist() == [8.0, 18.0, 28.0]
    assert mesh.attributes["vertex_flow"].tolist()[2] == [29.0, 30.0, 31.0]


_WHOLE = _ply("binary_little_endian", _POLYGONS, extra=True)
_TEXT = _ply("ascii", _POLYGONS, extra=False)
_BAD_PLY = {
    "empty": (b"", "is not a PLY file"),
    "no end": (b"ply\nformat ascii 1.0\n", "is not a PLY file"),
    "no format": (b"ply\nend_header\n", "names no format"),
    "a word": (b"ply\nformat ascii 1.0\nhello\nend_header\n", "line 3 of its header: 'hello'"),
    "a type": (_WHOLE.replace(b"float x", b"fluat x"), "line 5 of its header: 'property fluat x'"),
    "no z": (_TEXT.replace(b"float z", b"float w"), "no element 'vertex' with x, y and z"),
    "no faces": (_TEXT.replace(b"vertex_indices", b"indices_of"), "with a list vertex_indices"),
    "index": (_TEXT.replace(b"3 3 0 4", b"3 3 0 5"), "face 4 refers to vertex 5; it has 5"),
    "two corners": (_TEXT.replace(b"3 3 0 4", b"2 3 0 0"), "face 4 has fewer than 3 corners"),
    "negative count": (
        _TEXT.replace(b"list uchar", b"list char").replace(b"3 3 0 4", b"-3 3 0 4"),
        "list 'vertex_indices' of negative size",
    ),
    "many": (_WHOLE.replace(b"vertex 5", b"vertex 900000000000"), "is cut short"),
    "no number": (_TEXT.replace(b"0.5 0.5 2", b"0.5 zero 2"), "is no number"),
    **{f"cut at -{n}": (_WHOLE[:-n], "is cut short") for n in (1, 4, 8, 30, 90, 140)},
    **{f"text cut at -{n}": (_TEXT[:-n], "is cut short") for n in (3, 8, 30)},
}


@pytest.mark.parametrize("case", _BAD_PLY)
def test_bad_ply(tmp_path: Path, case: str) -> None:
    data, error = _BAD_PLY[case]
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        ply.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert error in str(caught.value)


# Serialized


def _serialized(version: int, flags: int, count: int = 1) -> bytes:
    """The pyramid, moved along x by its number in the file."""
    number = "<f8" if flags & 0x2000 else "<f4"
    parts, offsets = b"", []
    for i in range(count):
        data = struct.pack("<I", flags) + (b"part\0" if version == 4 else b"")
        data += struct.pack("<QQ", len(_POINTS), len(_TRIANGLES))
        arrays: list[NDArray[np.float32]] = [_POINTS + np.float32([i, 0, 0])]
        arrays += [2.0 * _POINTS] if flags & 0x1 else []
        arrays += [_POINTS[:, :2]] if flags & 0x2 else []
        arrays += [0.1 * _POINTS] if flags & 0x8 else []
        data += b"".join(a.astype(number).tobytes() for a in arrays)
        data += np.array(_TRIANGLES, "<u4").tobytes()
        offsets.append(len(parts))
        parts += struct.pack("<HH", 0x041C, version) + zlib.compress(data)
    table = np.array(offsets, "<u4" if version == 3 else "<u8").tobytes()
    return parts + table + struct.pack("<I", count)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("flags", [0x1000, 0x2000, 0x1001, 0x2003, 0x100B, 0x1010])
def test_serialized(tmp_path: Path, version: int, flags: int) -> None:
    path = tmp_path / "a.serialized"
    path.write_bytes(_serialized(version, flags, 3))
    mesh = serialized.read(path, 2)
    assert corners(mesh) == (np.array(_PYRAMID) + np.array([2.0, 0.0, 0.0])).tolist()
    assert (mesh.normals is not None) == bool(flags & 0x1)
    assert (mesh.uvs is not None) == bool(flags & 0x2)
    assert list(mesh.attributes) == (["vertex_color"] if flags & 0x8 else [])
    assert mesh.face_normals == bool(flags & 0x10)
    if mesh.normals is not None:
        assert mesh.normals.tolist() == (2.0 * _POINTS).tolist()


_GOOD = _serialized(4, 0x1003, 2)


def _claiming(vertices: int) -> bytes:
    data = struct.pack("<I", 0x1000) + b"\0" + struct.pack("<QQ", vertices, 1)
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(data) + struct.pack("<QI", 0, 1)


_BAD_SERIALIZED = {
    "empty": (b"", 0, "does not begin with 1C 04"),
    "other": (b"hello, world, how are you", 0, "does not begin with 1C 04"),
    "version": (struct.pack("<HH", 0x041C, 9) + b"0" * 20, 0, "version 9"),
    "no such mesh": (_GOOD, 2, "has no mesh 2; it has 2 (0 to 1)"),
    "negative": (_GOOD, -1, "has no mesh -1"),
    "cut": (_GOOD[:-4], 0, "broken"),
    "no zlib": (_GOOD[:8] + b"\0" * 20 + _GOOD[28:], 0, "mesh 0 is broken"),
    "too many": (_claiming(10**12), 0, "cannot fit in it"),
    "short": (_claiming(100), 0, "is cut short"),
}


@pytest.mark.parametrize("case", _BAD_SERIALIZED)
def test_bad_serialized(tmp_path: Path, case: str) -> None:
    data, index, error = _BAD_SERIALIZED[case]
    path = tmp_path / "bad.serialized"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        serialized.read(path, index)
    assert str(caught.value).startswith(f"{path}: ")
    assert error in str(caught.value)


def test_serialized_index_out_of_range(tmp_path: Path) -> None:
    data = struct.pack("<I", 0x1000) + b"\0" + struct.pack("<QQ", 3, 1) + bytes(36)
    data += np.array([0, 1, 3], "<u4").tobytes()
    path = tmp_path / "a.serialized"
    path.write_bytes(struct.pack("<HH", 0x041C, 4) + zlib.compress(data) + struct.pack("<QI", 0, 1))
    with pytest.raises(FormatError, match="mesh 0: face 0 refers to vertex 3; it has 3, from 0"):
        serialized.read(path)


# Grids of signed distances


def _sphere_grid(side: int) -> NDArray[np.float64]:
    z, y, x = np.meshgrid(*[np.linspace(0.0, 1.0, side)] * 3, indexing="ij")
    return np.sqrt((x - 0.5) ** 2 + (y - 0.45) ** 2 + (z - 0.55) ** 2) - 0.3


def test_level_set_of_a_sphere_is_closed_and_near_it() -> None:
    mesh = levelset.surface(_sphere_grid(33))
    corner = np.asarray(mesh.vertices)[mesh.faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, shared = np.unique(edges, axis=0, return_counts=True)
    assert (shared == 2).all()
    assert len(mesh.vertices) - len(shared) + len(mesh.faces) == 2  # Euler's number of a sphere
    volume = np.einsum("fi,fi->", corner[:, 0], across) / 6.0  # above 0 if the front is outside
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.01)
    out = np.asarray(mesh.vertices) - (0.5, 0.45, 0.55)
    distance = np.linalg.norm(out, axis=1)
    np.testing.assert_allclose(distance, 0.3, atol=0.0015)
    assert mesh.normals is not None
    normals = mesh.normals / np.linalg.norm(mesh.normals, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, out / distance[:, None], atol=0.03)


def test_vol_files(tmp_path: Path) -> None:
    path = tmp_path / "a.vol"
    values = np.arange(24, dtype="<f4").reshape(4, 3, 2)
    header = struct.pack("<3sB5i6f", b"VOL", 3, 1, 2, 3, 4, 1, *[0.0] * 6)
    path.write_bytes(header + values.tobytes())
    assert (levelset.read_vol(path) == values).all()
    for data, error in (
        (b"", "is not a .vol grid"),
        (header + bytes(92), "is cut short: 2 by 3 by 4"),
        (header.replace(b"\2\0\0\0", b"\0\0\0\x7f", 1) + values.tobytes(), "must be 2 to 2048"),
        (header[:4] + b"\2" + header[5:] + values.tobytes(), "type 2, 1 channels"),
    ):
        path.write_bytes(data)
        with pytest.raises(FormatError, match=error):
            levelset.read_vol(path)


# Any damage is an error or another mesh, never a crash

_READERS: dict[str, tuple[Callable[[Path], MeshData], bytes]] = {
    "obj": (obj.read, _OBJ["all"].encode()),
    "ply": (ply.read, _WHOLE),
    "text ply": (ply.read, _TEXT),
    "serialized": (serialized.read, _GOOD),
}


@pytest.mark.parametrize("kind", _READERS)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_files_do_not_crash(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    read, whole = _READERS[kind]
    broken = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        broken[data.draw(st.integers(0, len(broken) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged"
    path.write_bytes(bytes(broken[: data.draw(st.integers(0, len(broken)))]))
    try:
        mesh = read(path)
    except FormatError:
        return
    assert mesh.faces.size == 0 or (mesh.faces >= 0).all()
    assert mesh.faces.size == 0 or mesh.faces.max() < len(mesh.vertices)
