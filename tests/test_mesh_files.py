"""Meshes by themselves: STL, OFF, PLY and OBJ with materials, shading, and what is refused."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core
from parhelion.flatten import block
from parhelion.io.meshes import off, smooth_normals, split_at_creases, stl

# The corners of a cube, and its sides, counter-clockwise from outside
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))])


def write(folder: Path, name: str, text: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def binary_stl(triangles: np.ndarray, count: int | None = None, header: bytes = b"") -> bytes:
    record = np.zeros(
        len(triangles), np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    )
    record["v"] = triangles
    size = len(triangles) if count is None else count
    return header.ljust(80, b"\0") + size.to_bytes(4, "little") + record.tobytes()


def text_stl(triangles: np.ndarray) -> str:
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x} {y} {z}\n" for x, y, z in t)
        + " endloop\nendfacet\n"
        for t in triangles
    )
    return f"solid cube\n{facets}endsolid cube\n"


def the_mesh(path: Path, **options: Any) -> ph.Mesh:
    scene = ph.load(path, ph.LoadOptions(**options))
    mesh = scene.shapes[0]
    assert isinstance(mesh, ph.Mesh)
    ph.prepare(scene)
    return mesh


def volume(mesh: Any) -> float:
    """Of a closed mesh whose faces show outwards."""
    v = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]
    return float(np.einsum("fi,fi->", v[:, 0], np.cross(v[:, 1], v[:, 2])) / 6)


# --- Shading -------------------------------------------------------------------------------------


def test_a_cube_keeps_its_edges() -> None:
    faces, old, normals = split_at_creases(CORNERS, TRIANGLES, 40.0)
    assert len(old) == 24
    np.testing.assert_array_equal(old[faces], TRIANGLES)
    np.testing.assert_array_equal(normals, smooth_normals(CORNERS[old], faces))
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1)
    smooth, whole, _ = split_at_creases(CORNERS, TRIANGLES, 100.0)
    assert len(whole) == 8
    assert smooth.max() == 7


def test_creases_of_a_can() -> None:
    """Round walls are smooth; the lids' rims are edges, though all walls meet there."""
    n = 64
    a = 2 * np.pi * np.arange(n) / n
    ring = np.stack([np.cos(a), np.sin(a), 0 * a], axis=1)
    vertices = np.concatenate([ring, ring + np.eye(3)[2], [[0, 0, 0], [0, 0, 1]]])
    i, k = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate(
        [
            np.stack([i, k, k + n], 1),
            np.stack([i, k + n, i + n], 1),
            np.stack([k, i, i * 0 + 2 * n], 1),
            np.stack([i + n, k + n, i * 0 + 2 * n + 1], 1),
        ]
    )
    _, old, normals = split_at_creases(vertices, faces, 40.0)
    assert len(old) == 4 * n + 2
    side = np.abs(normals[:, 2]) < 0.5
    assert side.sum() == 2 * n
    outwards = vertices[old][side] * [1, 1, 0]
    np.testing.assert_allclose(normals[side], outwards, atol=0.01)


def test_sheets_that_meet_in_one_edge_and_a_fan_of_many() -> None:
    """Three sheets share an edge; a cone has one vertex for a thousand faces."""
    book = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, -1, 0]], float)
    faces = split_at_creases(book, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]), 40.0)[0]
    assert len(np.unique(faces)) == 9
    n = 1000
    a = 2 * np.pi * np.arange(n) / n
    cone = np.concatenate([np.stack([np.cos(a), np.sin(a), 0 * a], 1), [[0, 0, 0.2]]])
    fan = np.stack([np.arange(n), (np.arange(n) + 1) % n, np.full(n, n)], 1)
    _, old, _ = split_at_creases(cone, fan, 40.0)
    assert len(old) == n + 1


# --- STL -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["binary", "text", "binary that begins with solid"])
def test_stl(tmp_path: Path, kind: str) -> None:
    triangles = CORNERS[TRIANGLES]
    header = b"solid" if "begins" in kind else b""
    data = text_stl(triangles) if kind == "text" else binary_stl(triangles, header=header)
    mesh = the_mesh(write(tmp_path, "cube.STL", data))
    assert len(mesh.faces) == 12
    assert volume(mesh) == pytest.approx(1)
    camera = ph.load(tmp_path / "cube.STL").camera
    assert isinstance(camera, ph.Framing)
    assert camera.up == (0, 0, 1)
    assert ph.load(tmp_path / "cube.STL", ph.LoadOptions(up="-x")).camera.up == (-1, 0, 0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is no STL file: it has 0 bytes"),
        (binary_stl(np.zeros((1, 3, 3)), 4_000_000_000), "4000000000 faces; there are 1"),
        (binary_stl(np.zeros((0, 3, 3))), "has no faces"),
        (binary_stl(np.full((2, 3, 3), np.nan)), "face 0 has a corner that is not finite"),
        (b"solid a\nvertex 0 0 0\nvertex 1 0 0\nendsolid", "has 2 vertices with 6 coordinates"),
        (b"solid a\nvertex 0 0 x\nvertex 1 0 0\nvertex 1 0 0\n", "something that is no number"),
    ],
)
def test_bad_stl(tmp_path: Path, data: bytes, words: str) -> None:
    path = write(tmp_path, "a.stl", data)
    with pytest.raises(ph.FormatError, match=words) as error:
        stl.read(path)
    assert str(error.value).startswith(str(path))


# --- OFF -----------------------------------------------------------------------------------------


def off_text(kind: str = "OFF", vertex: str = "", face: str = "") -> str:
    vertices = "".join(f"{x:g} {y:g} {z:g}{vertex}\n" for x, y, z in CORNERS)
    faces = "".join(f"4 {a} {b} {c} {d}{face}\n" for a, b, c, d in SIDES)
    return f"{kind}\n# a cube\n8 6 12\n{vertices}{faces}"


def test_off(tmp_path: Path) -> None:
    for text in (off_text(), off_text().replace("OFF\n", "OFF ", 1).replace("12\n", "12\n\n")):
        mesh = the_mesh(write(tmp_path, "cube.off", text))
        assert volume(mesh) == pytest.approx(1)
        assert len(mesh.vertices) == 24
    mixed = off_text().replace("4 0 1 3 2\n", "3 0 1 3\n3 0 3 2\n").replace("8 6", "8 7")
    assert volume(the_mesh(write(tmp_path, "mixed.off", mixed))) == pytest.approx(1)


def test_off_with_colours_normals_and_uvs(tmp_path: Path) -> None:
    data = off.read(write(tmp_path, "a.off", off_text("COFF", " 255 0 51 255")))
    np.testing.assert_allclose(data.attributes["vertex_color"][0], [1, 0, 0.0331], atol=1e-4)
    data = off.read(write(tmp_path, "a.off", off_text("NOFF", " 0 0 1")))
    assert data.normals is not None
    np.testing.assert_array_equal(data.normals[3], [0, 0, 1])
    data = off.read(write(tmp_path, "a.off", off_text("STCNOFF", " 0 0 1 0.5 0.5 0.5 0.25 0.75")))
    assert data.uvs is not None
    np.testing.assert_array_equal(data.uvs[5], [0.25, 0.75])
    data = off.read(write(tmp_path, "a.off", off_text(face=" 0.5 1 0")))
    np.testing.assert_allclose(data.attributes["face_color"][11], [0.2140, 1, 0], atol=1e-4)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is no OFF file"),
        ("PLY\n", "is no OFF file"),
        ("OFF\n1 2", "needs the numbers of vertices"),
        ("OFF\n4000000000 1 0\n0 0 0\n3 0 0 0\n", "its header tells of 4000000000 vertices"),
        ("OFF\n1 4000000000 0\n0 0 0\n3 0 0 0\n", "4000000000 faces"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0 9\n", "face 0 refers to vertex 9; it has 1"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0 0.5\n", "something that is no index"),
        ("OFF\n1 1 0\n0 0 0\n9 0 0 0\n", "face 0 has 9 corners and a line of 4 numbers"),
        ("OFF\n1 0 0\n0 0 0\n", "has no faces"),
        ("OFF\n1 1 0\n0 0 zero\n3 0 0 0\n", "something that is no number"),
    ],
)
def test_bad_off(tmp_path: Path, text: str, words: str) -> None:
    path = write(tmp_path, "a.off", text)
    with pytest.raises(ph.FormatError, match=words) as error:
        ph.load(path)
    assert str(error.value).startswith(str(path))


# --- PLY -----------------------------------------------------------------------------------------

PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
"""
POINTS = "0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n"


def test_ply_with_colours_packed(tmp_path: Path) -> None:
    text = PLY + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = tmp_path / "a.ply.gz"
    path.write_bytes(gzip.compress((text + POINTS + "3 0 1 2\n").encode()))
    mesh = the_mesh(path)
    np.testing.assert_array_equal(mesh.attributes["vertex_color"], np.eye(3))
    assert mesh.material == ph.Material(
        "diffuse", color=ph.Texture("attribute", name="vertex_color")
    )
    with pytest.raises(ph.FormatError, match="the option 'radius' is for particles"):
        ph.load(path, ph.LoadOptions(radius=2.0))


FIELDS = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
property float quality
property float color
property uchar red
property uchar green
property uchar blue
property float flow_x
property float flow_y
property float flow_z
element face 1
property list uchar int vertex_indices
property short part
end_header
0 0 0 1 7 255 0 0 1 2 3
1 0 0 2 7 0 255 0 4 5 6
0 1 0 HERE 7 0 0 255 7 8 9
3 0 1 2 5
"""


def test_ply_keeps_its_fields(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path, "a.ply", FIELDS.replace("HERE", "3"))
    for _ in range(2):  # the second time as we write it
        found = the_mesh(path).attributes
        assert set(found) == {"vertex_color", "vertex_quality", "vertex_flow", "face_part"}
        np.testing.assert_array_equal(found["vertex_color"], np.eye(3))
        np.testing.assert_array_equal(found["vertex_quality"], [1, 2, 3])
        np.testing.assert_array_equal(found["vertex_flow"], np.arange(1, 10).reshape(3, 3))
        np.testing.assert_array_equal(found["face_part"], [5])
        ph.save(ph.load(path), tmp_path / "b.ply")
        path = tmp_path / "b.ply"
    assert "field 'color' of 'vertex': there are colours too; left out" in caplog.text
    caplog.clear()
    found = the_mesh(write(tmp_path, "a.ply", FIELDS.replace("HERE", "nan"))).attributes
    assert "vertex_quality" not in found
    assert "'quality' of 'vertex': not finite everywhere; left out" in caplog.text


def test_a_bomb(tmp_path: Path) -> None:
    path = tmp_path / "a.ply.gz"
    path.write_bytes(gzip.compress(b"ply\n" + b" " * 2**27))
    with pytest.raises(ph.FormatError, match="unpacks to more than"):
        ph.load(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(ph.FormatError, match="is cut short"):
        ph.load(path)


def test_points(tmp_path: Path) -> None:
    text = PLY + "property float radius\nproperty float age\nend_header\n"
    rows = "".join(f"{line} 0.25 {i}\n" for i, line in enumerate(POINTS.splitlines()))
    path = write(tmp_path, "a.ply", text + rows)
    scene = ph.load(path)
    cloud = scene.shapes[0]
    assert isinstance(cloud, ph.Spheres)
    np.testing.assert_array_equal(np.asarray(cloud.colors), np.eye(3))
    np.testing.assert_array_equal(np.broadcast_to(cloud.radii, 3), 0.25)
    by_age = ph.load(path, ph.LoadOptions(color_by="age", radius=0.5)).shapes[0]
    assert isinstance(by_age, ph.Spheres)
    assert len(np.unique(np.asarray(by_age.colors), axis=0)) == 3


# --- OBJ -----------------------------------------------------------------------------------------

QUAD = """mtllib a.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
"""


def obj_scene(folder: Path, faces: str, mtl: str | None, **options: Any) -> ph.Scene:
    if mtl is not None:
        write(folder, "a.mtl", mtl)
    scene = ph.load(write(folder, "a.obj", QUAD + faces), ph.LoadOptions(**options))
    ph.prepare(scene)
    return scene


def test_faces_have_their_materials(tmp_path: Path) -> None:
    mtl = "newmtl red one\nKd 1 0 0\n# other\nnewmtl green\nKd 0 0.5 0\nnewmtl unused\n"
    faces = "f 1 2 3\nusemtl green\nf 1 3 4\nusemtl red one\nf 1 2 3 4\nusemtl green\nf 2 3 4\n"
    scene = obj_scene(tmp_path, faces, mtl)
    mesh = scene.shapes[0]
    assert isinstance(mesh, ph.Mesh)
    names = [list(scene.materials)[i] for i in np.asarray(mesh.material)]
    assert names == ["no material", "green", "red one", "red one", "green"]
    assert scene.materials["red one"] == ph.Material("diffuse", color=(1, 0, 0))
    assert scene.materials["green"] == ph.Material("diffuse", color=(0, 0.5, 0))
    assert set(scene.materials) == {"no material", "green", "red one"}


def material(folder: Path, statements: str, **options: Any) -> ph.Material:
    scene = obj_scene(folder, "usemtl m\nf 1/1 2/2 3/3 4/4\n", f"newmtl m\n{statements}", **options)
    return scene.materials["m"]


def test_statements(tmp_path: Path) -> None:
    pixels = np.full((2, 2, 3), 128, np.uint8)
    write_png(tmp_path / "wood fine.png", pixels)
    image = str(tmp_path / "wood fine.png")
    m = material(tmp_path, "Kd 0.5 0.5 0.5\nmap_Kd -s 2 3 1 -clamp on wood fine.png\nd 0.25")
    assert m.type == "diffuse"
    color = m.params["color"]
    assert color.type == "multiply"
    assert color.params["color1"] == (0.5, 0.5, 0.5)
    assert color.params["color0"] == ph.Texture(
        "image", image=image, wrap_u="clamp", wrap_v="clamp", transform=((2, 0, 0), (0, 3, 0))
    )
    assert m.params["opacity"] == 0.25
    m = material(tmp_path, "Kd 0.1 0.2 0.3\nKs 0.04 0.04 0.04\nNs 98\nillum 2\nNi 1.4")
    assert m.type == "principled"
    assert m.params["roughness"] == pytest.approx((2 / 100) ** 0.25)
    m = material(tmp_path, "Pr 0.3\nPm 1\nPc 0.5\nPcr 0.1\naniso 0.2\nnorm wood fine.png\nKe 2 1 0")
    assert (m.params["roughness"], m.params["metallic"], m.params["clearcoat"]) == (0.3, 1, 0.5)
    assert m.params["emission"] == (2, 1, 0)
    assert m.params["normal_map"].params["image"] == image
    m = material(tmp_path, "illum 7\nTf 0.9 1 1\nNi 1.33\nd 0.1")
    assert (m.params["transmission"], m.params["ior"], m.params["color"]) == (1, 1.33, (0.9, 1, 1))
    assert not {"opacity", "specular"} & set(m.params)  # it bends light, without any Ks too
    m = material(tmp_path, "bump -bm 0.5 wood fine.png")
    assert m.params["bump_map"].params["color1"] == (0.5, 0.5, 0.5)
    m = material(tmp_path, "d 0.5\nmap_d wood fine.png")
    assert m.params["opacity"].params["color0"].params["image"] == image
    assert m.params["opacity"].params["color1"] == (0.5, 0.5, 0.5)


@pytest.mark.parametrize(
    ("diffuse", "specular", "wanted"),
    [
        ((0.6, 0.1, 0.1), (0.04, 0.04, 0.04), (0.04, 0.04, 0.04)),
        ((0.6, 0.1, 0.1), (0.01, 0.02, 0.02), (0.01, 0.02, 0.02)),
        ((0.0, 0.0, 0.0), (0.05, 0.05, 0.05), (0.05, 0.05, 0.05)),
        ((1.0, 1.0, 1.0), (1.0, 0.5, 0.5), (0.08, 0.04, 0.04)),  # a highlight for show
        ((0.0, 0.0, 0.0), (1.0, 0.8, 0.3), (1.0, 0.8, 0.3)),  # gold
        ((0.05, 0.05, 0.0), (1.0, 0.8, 0.3), (1.0, 0.8, 0.3)),
    ],
)
def test_ks_is_reflected_at_normal_incidence(
    tmp_path: Path, diffuse: Any, specular: Any, wanted: Any
) -> None:
    def words(name: str, color: Any) -> str:
        return " ".join((name, *map(str, color)))

    m = material(tmp_path, f"{words('Kd', diffuse)}\n{words('Ks', specular)}\nNs 100000\nNi 1\n")
    made = block("materials", m.type, dict(m.params), "test")
    straight = (0.0, 0.0, 1.0)
    wi, weight, *_ = _core.bsdf_sample(made, straight, 3, 100_000)
    glossy = wi[:, 2] > 0.9
    # what is matte sends a fifth of its light, 1 - 0.9^2, into this cone too
    metal = m.params.get("metallic", 0.0) == 1.0
    matte = 0.0 if metal else np.array(diffuse) * (1 - max(wanted)) * 0.19
    found = (weight * glossy[:, None]).mean(axis=0) - matte
    np.testing.assert_allclose(found, wanted, atol=0.006)
    assert (weight.mean(axis=0) < 1.0 + 1e-3).all()


def test_comments_behind_statements(tmp_path: Path) -> None:
    for name, comment in (("wood.png", " # it's oak"), ("wood #3.png", "")):
        write_png(tmp_path / name, np.full((2, 2, 3), 128, np.uint8))
        m = material(tmp_path, f"Kd 1 1 1 # white\nd 0.5 #half\nmap_Kd {name}{comment}")
        assert m.params["opacity"] == 0.5
        assert m.params["color"].params["image"] == str(tmp_path / name)


def write_png(path: Path, pixels: np.ndarray) -> None:
    import OpenImageIO as oiio

    buffer = oiio.ImageBuf(oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8"))
    buffer.set_pixels(oiio.ROI.All, pixels)
    assert buffer.write(str(path))


def test_what_is_missing_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scene = obj_scene(tmp_path, "usemtl m\nf 1 2 3\nusemtl n\nf 1 3 4\n", None)
    assert scene.materials["m"] == ph.Material("diffuse")
    text = caplog.text
    assert "mtllib: 'a.mtl': no such file; its materials are grey" in text
    assert "material 'm' is not defined; it is grey" in text
    with pytest.raises(ph.FormatError, match="strict, and not all of it is supported"):
        obj_scene(tmp_path, "usemtl m\nf 1 2 3\n", None, strict=True)
    caplog.clear()
    material(tmp_path, "map_Kd gone.png\nwobble 3\nmap_Kd -mm 0 1 ../b.png")
    assert "'gone.png': no such file; ignored" in caplog.text
    assert "statement 'wobble': not known; ignored" in caplog.text
    assert "'../b.png' is not inside the scene's folder" in caplog.text
    caplog.clear()
    write_png(tmp_path / "bumps.png", np.full((2, 2, 3), 128, np.uint8))
    material(tmp_path, "bump -bm nan bumps.png")
    assert "the multiplier of a bump map is nan, and must be above 0" in caplog.text


def test_of_many_faults_the_first_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    faces = "".join(f"usemtl m{k}\nf 1 2 3\n" for k in range(1000))
    obj_scene(tmp_path, faces, "newmtl m\nKd 1 1 1\n")
    assert len(caplog.messages) == 51
    assert caplog.messages[-1] == "a.obj: and 950 more"
    with pytest.raises(ph.FormatError, match=r"\n  and 950 more$") as error:
        obj_scene(tmp_path, faces, None, strict=True)
    assert len(str(error.value).splitlines()) == 52


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        ("Kd 1 x 1", "line 2: '1 x 1' is not a list of numbers"),
        ("Kd", "line 2: needs finite numbers"),
        ("Ns nan", "line 2: needs finite numbers"),
        ("map_Kd", "line 2: needs a file"),
        ("map_Kd # none", "line 2: needs a file"),
    ],
)
def test_bad_mtl(tmp_path: Path, statements: str, words: str) -> None:
    with pytest.raises(ph.FormatError, match=words) as error:
        material(tmp_path, statements)
    assert "a.mtl" in str(error.value)


def test_mtl_before_any_material(tmp_path: Path) -> None:
    with pytest.raises(ph.FormatError, match="'Kd' comes before any 'newmtl'"):
        obj_scene(tmp_path, "usemtl m\nf 1 2 3\n", "Kd 1 1 1\n")


def test_vertex_colours(tmp_path: Path) -> None:
    text = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n"
    mesh = the_mesh(write(tmp_path, "a.obj", text))
    np.testing.assert_array_equal(mesh.attributes["vertex_color"], np.eye(3))


def test_not_finite(tmp_path: Path) -> None:
    for name, text in {
        "a.obj": "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n",
        "a.off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 inf 0\n3 0 1 2\n",
    }.items():
        with pytest.raises(ph.FormatError, match=f"{name}: vertex 2 is not finite"):
            ph.load(write(tmp_path, name, text))


def test_shared_meshes(shared_scenes: Path) -> None:
    spot = the_mesh(shared_scenes / "mesh" / "spot.obj")
    assert len(spot.faces) == 5856
    box = ph.load(shared_scenes / "embree-models" / "cornell_box.obj")
    assert len(box.materials) == len(np.unique(np.asarray(box.shapes[0].material)))  # type: ignore[union-attr]
