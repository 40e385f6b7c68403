"""pbrt's scenes: what is read is what pbrt means, and what cannot be read says so."""

from __future__ import annotations

import gzip
import logging
import math
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import parhelion as ph
from parhelion import spectra
from parhelion.errors import FormatError
from parhelion.image import read_pixels
from parhelion.io import LoadOptions, load, pbrt
from parhelion.scene import (
    Camera,
    Curves,
    Cylinders,
    Disks,
    Instances,
    Light,
    Material,
    Mesh,
    Scene,
    Shape,
    Spheres,
    Texture,
)

Read = Callable[..., Scene]

LEVELS = ' "integer levels" 100\n'
TRIANGLE = 'Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0] "integer indices" [0 1 2]\n'


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Reads a scene of the given world, written to a file of its own."""

    def scene(world: str, head: str = "", **options: Any) -> Scene:
        path = tmp_path / "scene.pbrt"
        path.write_text(f"{head}\nWorldBegin\n{world}\n", encoding="utf-8")
        return pbrt.load(path, LoadOptions(**options))  # load() adds light to dark scenes

    return scene


def camera(scene: Scene) -> Camera:
    assert isinstance(scene.camera, Camera)
    return scene.camera


def material(scene: Scene, index: int = 0) -> Material:
    found = scene.shapes[index].material  # type: ignore[union-attr]
    if isinstance(found, str):
        return scene.materials[found]
    assert isinstance(found, Material)
    return found


def mesh(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the triangles, and their normals times twice the area, as seen from the front."""
    assert isinstance(shape, Mesh)
    corners = np.asarray(shape.vertices, float)[np.asarray(shape.faces)]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners, -across if shape.inside_out else across


def write_image(path: Path, pixels: np.ndarray) -> None:
    height, width, channels = pixels.shape
    assert channels == 3
    # the portable float map: rows from the bottom, little-endian
    data = pixels[::-1].astype("<f4").tobytes()
    path.write_bytes(f"PF\n{width} {height}\n-1.0\n".encode() + data)


# Grammar


def test_values_with_and_without_brackets_comments_and_packed_text(read: Read) -> None:
    spheres = read(
        """
        Material "diffuse" "rgb reflectance" [ .1 .2 # not "the end" ]
            .3 ]
        Translate 1 # between numbers
            2 3
        Shape "sphere" "float radius" 2 "bool unused" true
        Shape "sphere""float radius"[3]"bool unused"["false"]
        """
    ).shapes[0]
    assert isinstance(spheres, Spheres)
    np.testing.assert_array_equal(spheres.centers, [[1, 2, 3]] * 2)
    np.testing.assert_allclose(spheres.radii, [2, 3])
    assert spheres.material == Material("diffuse", color=(0.1, 0.2, 0.3))


def test_included_imported_and_packed_files(read: Read, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    moving = "Translate 0 0 5\n" + 'Shape "sphere"\n'
    (tmp_path / "parts" / "one.pbrt").write_text(moving)
    (tmp_path / "two.pbrt.gz").write_bytes(gzip.compress(moving.encode()))
    scene = read('Import "two.pbrt.gz" Include "parts/one.pbrt" Shape "sphere"')
    (spheres,) = scene.shapes
    # what is imported changes nothing here; what is included does
    np.testing.assert_allclose(np.asarray(spheres.centers)[:, 2], [5, 5, 5])  # type: ignore[union-attr]
    whole = tmp_path / "whole.pbrt.gz"
    whole.write_bytes(gzip.compress(b'WorldBegin Shape "sphere"'))
    assert len(pbrt.load(whole, LoadOptions()).shapes) == 1


def test_a_large_mesh_parses_at_the_speed_of_arrays(read: Read) -> None:
    n = 100_000
    points = np.random.default_rng(1).random((n, 3)).round(6)
    faces = np.arange(n // 3 * 3).reshape(-1, 3)
    text = " ".join(map(str, points.ravel().tolist()))
    indices = " ".join(map(str, faces.ravel().tolist()))
    text = f'Shape "trianglemesh" "point3 P" [{text}] "integer indices" [{indices}]'
    begin = time.perf_counter()
    (found,) = read(text).shapes
    assert time.perf_counter() - begin < 2.0  # a Python loop takes as much for the numbers alone
    assert isinstance(found, Mesh)
    np.testing.assert_allclose(found.vertices, points.astype(np.float32))
    np.testing.assert_array_equal(found.faces, faces)


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ('Shape "sphere', "line 3: a text in quotes does not end"),
        ('Shape "sphere" "float radius" [1 2', "parameter 'float radius' has no ']'"),
        ('Shape "sphere" "float radius"', "has no value"),
        ('Shape "sphere" "float radius" [[1]]', "is no number"),
        ('Shape "sphere" "string x" [[1]]', "in the place of a value"),
        ('Shape "sphere" "flot radius" 1', "did you mean 'float'"),
        ('Shape "sphere" "radius" 1', "unknown parameter type 'radius'"),
        ('Shape "sphere" "float radius" [1 x]', "is no number"),
        ('Shape "sphere" "float radius" ["1"]', "needs numbers, not a text"),
        ('Shape "sphere" "float radius" nan', "holds nan as its number 0"),
        ('Shape "sphere" "float radius" -1', "radius is -1; must be above 0"),
        ('Shape "sphere" "float radius" []', "parameter 'radius' has no value"),
        ('Shape "sphere" "string radius" "1"', "radius' is a string; must be a float"),
        ('Shape "sphere" "bool x" [maybe]', "must be true or false"),
        ("Shape 12", "Shape needs 1 texts in quotes"),
        ('Shap "sphere"', "did you mean 'Shape'"),
        ('\n\n"sphere"', "line 5: a directive is needed, not '\"sphere\"'"),
        ("Translate 1 2", "Translate needs 3 finite numbers"),
        ("Translate 1 2 1e999", "Translate needs 3 finite numbers"),
        ("Rotate 10 0 0 0", "the axis has no direction"),
        ("LookAt 0 0 0 0 0 0 0 1 0", "the eye is the point looked at"),
        ("LookAt 0 0 0 0 1 0 0 1 0", "up lies along"),
        ("Transform [1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 0]", "last column"),
        ('Scale 0 1 1 Shape "sphere"', "the transformation has no inverse"),
        ("AttributeEnd", "AttributeEnd: no AttributeBegin comes before it"),
        ("AttributeBegin TransformEnd", "AttributeBegin is open"),
        ("AttributeBegin", "line 3: AttributeBegin has no AttributeEnd"),
        ("WorldBegin", "comes a second time"),
        ('Camera "perspective"', "belongs before WorldBegin"),
        ('Shape "trianglemesh" "integer indices" [0 1 2]', "needs 'P'"),
        (TRIANGLE.replace("[0 1 2]", "[0 1 3]"), "face 0 refers to vertex 3; it has 3"),
        (TRIANGLE.replace("[0 1 2]", "[0 1 -1]"), "face 0 refers to vertex -1"),
        (TRIANGLE.replace("[0 1 2]", "[0 1 2.5]"), "must hold whole numbers"),
        (TRIANGLE.replace("[0 1 2]", "[0 1]"), "must be a multiple of 3"),
        (TRIANGLE.replace("0 0 0 1", "0 0 1"), "has 7 numbers; must be a multiple of 3"),
        ('Shape "curve" "point3 P" [0 0 0 1 0 0]', "2 control points make no bezier"),
        ('Shape "plymesh"', "needs a text 'filename'"),
        ('Shape "plymesh" "string filename" "none.ply"', "'none.ply': no such file"),
        ('Shape "plymesh" "string filename" "../up.ply"', "not inside the scene's folder"),
        ('Include "/etc/passwd"', "not inside the scene's folder"),
        ('Include "scene.pbrt"', "includes itself"),
        ('ObjectBegin "a" ObjectBegin "b"', "object 'a' is open"),
        ('ObjectInstance "a"', "no object has that name"),
        ('ObjectBegin "a" ObjectInstance "b" ObjectEnd', "objects hold no instances"),
        ("ObjectEnd", "no ObjectBegin comes before it"),
        ('Texture "t" "spectral" "constant"', "is no kind of texture"),
        ('Material "diffuse" "texture reflectance" "t" Shape "sphere"', "unknown texture 't'"),
        ('Material "dielectric" "float eta" 50 Shape "sphere"', "eta is 50; must lie in"),
        ('Material "mix" "string materials" ["a"] Shape "sphere"', "has 1 materials; needs 2"),
        (
            'MakeNamedMaterial "m" "string type" "mix" "string materials" ["m" "m"] '
            'NamedMaterial "m" Shape "sphere"',
            "is a mixture of itself",
        ),
        ('LightSource "spot" "point3 to" [0 0 0]', "must be different points"),
        ('LightSource "point" "spectrum I" [400 1 500]', "must be a multiple of 2"),
        ('LightSource "point" "blackbody I" [-5]', "must be above 0 K"),
        ('Attribute "shapes" "float radius" 2', "must be one of shape, light"),
        ('Shape "sphere" "float zmin" 0\n' * 300, 'Shape "sphere": the surfaces before it take'),
    ],
)
def test_what_cannot_be_read_says_where_and_why(read: Read, world: str, message: str) -> None:
    with pytest.raises(FormatError) as caught:
        read(world)
    assert message in str(caught.value)
    assert "scene.pbrt: line " in str(caught.value)


def test_black_bodies_beyond_numbers(read: Read) -> None:
    for temperature in ("1e-80", "1e80"):
        with pytest.raises(FormatError, match="K has no radiance that can be told"):
            read(f'LightSource "point" "blackbody I" [{temperature} 1]', 'Film "image"')


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ('Camera "perspective" "float fov" 180', "fov is 180; must lie between"),
        ('Camera "pinhole"', "must be one of perspective, orthographic"),
        ('Film "rgb" "integer xresolution" 0', "xresolution is 0; must be a whole number from 1"),
        ('Film "rgb" "float cropwindow" [0.5 0.5 0 1]', "is empty"),
        ('Film "rgb" "float iso" 0', "an exposure of 0"),
        ('PixelFilter "box" "float xradius" 0', "radii are 0 and 0.5"),
    ],
)
def test_options_that_cannot_be(read: Read, head: str, message: str) -> None:
    with pytest.raises(FormatError, match=message.replace("(", "[(]")):
        read("", head)


def test_a_scene_without_a_world(tmp_path: Path) -> None:
    path = tmp_path / "scene.pbrt"
    path.write_text("Translate 0 0 1")
    with pytest.raises(FormatError, match="has no WorldBegin"):
        load(path)


def test_attributes_twenty_thousand_deep(read: Read) -> None:
    n = 20_000
    body = "AttributeBegin Translate 0 0 1\n" * n
    scene = read(body + 'Shape "sphere"' + "AttributeEnd\n" * n)
    np.testing.assert_allclose(scene.shapes[0].centers, [[0, 0, n]])  # type: ignore[union-attr]
    with pytest.raises(FormatError, match="AttributeBegin has no AttributeEnd"):
        read(body)


def test_files_that_include_each_other_without_end(read: Read, tmp_path: Path) -> None:
    (tmp_path / "a.pbrt").write_text('Include "b.pbrt"')
    (tmp_path / "b.pbrt").write_text('Include "a.pbrt"')
    with pytest.raises(FormatError, match=r"b.pbrt: line 1: Include .*includes itself"):
        read('Include "a.pbrt"')
    for level in range(20):  # 10^20 inclusions, none of itself
        (tmp_path / f"{level}.pbrt").write_text(f'Include "{level + 1}.pbrt"\n' * 10)
    (tmp_path / "20.pbrt").write_text("Identity")
    with pytest.raises(FormatError, match="10000 in all"):
        read('Include "0.pbrt"')


def test_included_files_that_multiply(
    read: Read, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By directives, and by bytes; a few times is usual."""
    monkeypatch.setattr("parhelion.io.files.Included._ALWAYS", 1 << 16)
    (tmp_path / "many.pbrt").write_text("Identity\n" * 100)
    assert read('Include "many.pbrt"\n' * 10 + TRIANGLE).shapes
    with pytest.raises(
        FormatError, match=r'scene.pbrt: line 20: Include "many.pbrt": included files come to more'
    ):
        read('Include "many.pbrt"\n' * 1000)
    (tmp_path / "long.pbrt").write_text("#" + " " * 50_000)
    with pytest.raises(FormatError, match=r'line 20: Include "long.pbrt": .* than 16 times'):
        read('Include "long.pbrt"\n' * 100)


def test_packed_files_that_fill_the_memory_or_are_cut_short(read: Read, tmp_path: Path) -> None:
    (tmp_path / "bomb.pbrt.gz").write_bytes(gzip.compress(b" " * (1 << 27)))
    with pytest.raises(FormatError, match=r"unpacks to more than \d+ bytes, 20 times its size"):
        read('Include "bomb.pbrt.gz"')
    whole = gzip.compress(TRIANGLE.encode() * 9)
    (tmp_path / "short.pbrt.gz").write_bytes(whole[:-12])
    with pytest.raises(FormatError, match="is cut short"):
        read('Include "short.pbrt.gz"')
    (tmp_path / "plain.pbrt.gz").write_bytes(TRIANGLE.encode())
    with pytest.raises(FormatError, match="cannot be unpacked"):
        read('Include "plain.pbrt.gz"')


_SEED = """LookAt 0 0 5 0 0 0 0 1 0 Film "rgb" "integer xresolution" [8] Camera "perspective"
WorldBegin AttributeBegin Texture "t" "spectrum" "checkerboard" "float uscale" 2
Material "coateddiffuse" "texture reflectance" "t" "float roughness" .1 Rotate 30 0 1 0
Shape "sphere" "float radius" 2 "float zmin" -1 AttributeEnd LightSource "infinite" "rgb L" [1 1 1]
ObjectBegin "o" Shape "curve" "point3 P" [0 0 0 1 0 0 1 1 0 1 1 1] ObjectEnd ObjectInstance "o"
Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0] "integer indices" [0 1 2] "normal N" [0 0 1]
"""


@settings(
    max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_mutated_scenes_are_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    text = bytearray(_SEED.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text) - 1))
        size = data.draw(st.integers(0, 12))
        text[at : at + size] = data.draw(
            st.one_of(
                st.binary(max_size=3),
                st.sampled_from(
                    [b'"', b"[", b"]", b"#", b" -1 ", b" 1e38 ", b" 0 ", b"WorldBegin "]
                ),
            )
        )
    path = tmp_path / "mutated.pbrt"
    path.write_bytes(text)
    try:
        load(path)
        return
    except FormatError as error:
        text_of_error = str(error)
    assert text_of_error.startswith(str(path))


# Transformations and attributes


def places(scene: Scene) -> list[list[float]]:
    return [c for s in scene.shapes for c in np.asarray(s.centers).round(6).tolist()]  # type: ignore[union-attr]


def test_transformations_add_up_as_in_pbrt(read: Read) -> None:
    point = 'Shape "sphere"\n'
    scene = read(
        f"""
        TransformBegin Translate 1 0 0 Scale 2 2 2 Translate 0 1 0 {point} TransformEnd
        TransformBegin Rotate 90 0 0 2 Translate 3 0 0 {point} TransformEnd
        TransformBegin Translate 9 9 9 Transform [1 0 0 0  0 1 0 0  0 0 1 0  4 5 6 1] {point}
            ConcatTransform [1 0 0 0  0 1 0 0  0 0 1 0  0 0 1 1] {point}
            Transform [2 0 0 0  0 2 0 0  0 0 2 0  8 10 12 2] {point} TransformEnd
        AttributeBegin Translate 0 0 7 CoordinateSystem "there" AttributeEnd
        TransformBegin CoordSysTransform "there" {point} TransformEnd
        TransformBegin CoordSysTransform "camera" {point} TransformEnd
        Translate 1 1 1 Identity {point}
        """,
        'LookAt 1 2 3  1 2 9  0 1 0 Camera "perspective"',
    )
    expected = [
        [1, 2, 0],
        [0, 3, 0],
        [4, 5, 6],
        [4, 5, 7],
        [4, 5, 6],
        [0, 0, 7],
        [1, 2, 3],
        [0, 0, 0],
    ]
    assert places(scene) == expected


def test_attributes_are_kept_and_given_to_what_follows(read: Read) -> None:
    scene = read(
        """
        AttributeBegin
            Attribute "shape" "float radius" 3
            Attribute "material" "rgb reflectance" [.2 .2 .2]
            Material "diffuse" Translate 1 0 0 ReverseOrientation
            Shape "sphere" Shape "sphere" "float radius" 4
        AttributeEnd
        Shape "sphere"
        """
    )
    inner, outer = scene.shapes
    assert isinstance(inner, Spheres)
    assert isinstance(outer, Spheres)
    np.testing.assert_allclose(inner.radii, [3, 4])
    assert inner.inside_out
    assert material(scene).params["color"] == (0.2, 0.2, 0.2)
    np.testing.assert_allclose(outer.radii, [1])
    assert not outer.inside_out
    assert material(scene, 1).params["color"] == (0.5, 0.5, 0.5)


def test_only_the_start_of_a_motion_counts(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    scene = read('ActiveTransform EndTime Translate 1 0 0 ActiveTransform All Shape "sphere"')
    assert places(scene) == [[0, 0, 0]]
    assert "motion is not rendered" in caplog.text


# Shapes


@pytest.mark.parametrize("mirror", ["", "Scale -1 1 1"])
@pytest.mark.parametrize("reverse", ["", "ReverseOrientation"])
@pytest.mark.parametrize("normals", ["", '"normal N" [0 0 -2 0 0 -2 0 0 -2]'])
def test_the_front_of_a_mesh(read: Read, mirror: str, reverse: str, normals: str) -> None:
    """It is where its normals point, else where it is seen counter-clockwise before any mirror."""
    scene = read(f"{mirror} {reverse} {TRIANGLE} {normals}")
    _, across = mesh(scene.shapes[0])
    front = (-1.0 if normals else 1.0) * (-1.0 if reverse else 1.0)
    assert np.sign(across[0, 2]) == front
    if normals:
        (shape,) = scene.shapes
        assert isinstance(shape, Mesh)
        np.testing.assert_allclose(shape.normals, [[0, 0, front]] * 3)


_CONE_SIDE = math.pi * 2.0 * math.hypot(2.0, 3.0)


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        ('"sphere" "float radius" 2 "float zmin" -1', 2 * math.pi * 2 * 3),
        ('"sphere" "float radius" 2 "float phimax" 90', 4 * math.pi * 4 / 4),
        ('"disk" "float radius" 2 "float innerradius" 1', 3 * math.pi),
        ('"cylinder" "float radius" 2 "float phimax" 180', math.pi * 2 * 2),
        ('"cone" "float radius" 2 "float height" 3', _CONE_SIDE),
        # of z = r^2 up to 1: pi / 6 (5^1.5 - 1)
        ('"paraboloid"', math.pi / 6 * (5**1.5 - 1)),
        # a straight line along the axis makes a cylinder
        ('"hyperboloid" "point3 p1" [1 0 0] "point3 p2" [1 0 2]', 4 * math.pi),
        ('"bilinearmesh" "point3 P" [0 0 0 2 0 0 0 3 0 2 3 0]', 6.0),
        ('"heightfield" "integer nu" 3 "integer nv" 2 "float Pz" [0 0 0 0 0 0]', 1.0),
    ],
)
def test_areas_and_normals_of_surfaces(read: Read, shape: str, area: float) -> None:
    (found,) = read(f"Shape {shape}").shapes
    corners, across = mesh(found)
    assert 0.5 * np.linalg.norm(across, axis=1).sum() == pytest.approx(area, rel=2e-3)
    assert isinstance(found, Mesh)
    if found.normals is not None:
        at = np.asarray(found.normals)[np.asarray(found.faces)].mean(axis=1)
        unit = across / np.linalg.norm(across, axis=1, keepdims=True)
        assert np.einsum("fi,fi->f", at, unit).min() > 0.99
        middle = corners.mean(axis=1)
        if "paraboloid" not in shape and "disk" not in shape and "bilinear" not in shape:
            assert np.einsum("fi,fi->f", unit[:, :2], middle[:, :2]).min() > 0.0  # outwards


def test_whole_quadrics_are_exact(read: Read) -> None:
    scene = read(
        """
        Translate 1 2 3 Rotate 30 1 1 0 Scale 2 2 2
        Shape "sphere" "float radius" 1.5
        Shape "disk" "float radius" 1.5 "float height" 1
        Shape "cylinder" "float radius" 1.5 "float zmin" 0 "float zmax" 2
        Scale 1 1 3 Shape "sphere"
        """
    )
    disk, cylinder, ellipsoid, sphere = scene.shapes
    assert isinstance(sphere, Spheres)
    assert isinstance(disk, Disks)
    assert isinstance(cylinder, Cylinders)
    assert isinstance(ellipsoid, Instances)
    np.testing.assert_allclose(sphere.radii, [3.0])
    axis = (np.asarray(cylinder.ends) - cylinder.starts)[0] / 4.0
    np.testing.assert_allclose(np.linalg.norm(axis), 1.0)
    np.testing.assert_allclose(disk.centers, [[1, 2, 3] + 2.0 * axis])
    np.testing.assert_allclose(np.cross(disk.axis_u, disk.axis_v)[0], 9.0 * axis, atol=1e-12)
    assert not disk.inside_out
    np.testing.assert_allclose(np.asarray(ellipsoid.transforms)[0, :, 2], 6.0 * axis)


def test_spheres_that_follow_each_other_are_one_shape(read: Read) -> None:
    one = 'AttributeBegin Translate {i} 0 0 Shape "sphere" AttributeEnd\n'
    world = 'Material "diffuse"' + "".join(one.format(i=i) for i in range(100))
    scene = read(world + 'Material "mirror"' + one.format(i=7))
    assert [len(np.asarray(s.centers)) for s in scene.shapes] == [100, 1]  # type: ignore[union-attr]


def test_loop_subdivision(read: Read) -> None:
    corners = "1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 1 0 0 -1"
    faces = "0 2 4 2 1 4 1 3 4 3 0 4 2 0 5 1 2 5 3 1 5 0 3 5"
    head = f'Shape "loopsubdiv" "point P" [{corners}] "integer indices" [{faces}]'
    for levels, text in ((1, '"integer nlevels" 1'), (2, '"integer levels" 2'), (3, "")):
        (found,) = read(f"{head} {text}").shapes
        assert isinstance(found, Mesh)
        assert len(np.asarray(found.faces)) == 8 * 4**levels
        _, across = mesh(found)
        assert (np.einsum("fi,fi->f", across, mesh(found)[0].mean(axis=1)) > 0.0).all()


def test_an_unknown_material_is_told_with_those_there_are(
    read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    """One of the names is empty, which no list shows."""
    read('Material "foo" Shape "sphere"')
    assert "unknown material 'foo' (choices: coatedconductor, " in caplog.text


def test_all_loop_subdivision_shares_a_budget(
    read: Read, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("parhelion.io.pbrt.shapes._MOST_SUBDIVIDED", 1 << 13)
    scene = read(TRIANGLE.replace("trianglemesh", "loopsubdiv").replace("\n", LEVELS) * 20)
    counts = [len(shape.faces) for shape in scene.shapes if isinstance(shape, Mesh)]
    assert counts[:2] == [4096, 1024]
    assert sum(counts) < (1 << 13) + 20
    told = [r.getMessage() for r in caplog.records if "loopsubdiv" in r.getMessage()]
    assert len(told) == 1
    assert "20 meshes are subdivided up to" in told[0]
    assert "at most 8192 triangles" in told[0]


def test_curves(read: Read) -> None:
    points = '"point3 P" [0 0 0  1 0 0  2 0 0  3 0 0]'
    scene = read(
        f"""
        Scale 2 2 2
        Shape "curve" {points} "float width" .5
        Shape "curve" {points} "float width0" .5 "float width1" 0
        Shape "curve" {points} "string basis" "bspline" "string type" "cylinder" "float width" 1
        Shape "curve" "point3 P" [0 0 0 1 0 0 2 0 0] "integer degree" 2 "string type" "cylinder"
        """
    )
    flat, round = scene.shapes
    assert isinstance(flat, Curves)
    assert isinstance(round, Curves)
    assert (flat.basis, flat.style, round.style) == ("bezier", "flat", "round")
    np.testing.assert_array_equal(flat.counts, [4, 4])
    np.testing.assert_allclose(np.asarray(flat.radii)[:7], [0.5, 0.5, 0.5, 0.5, 0.5, 1 / 3, 1 / 6])
    assert np.asarray(flat.radii)[7] == pytest.approx(0.0, abs=1e-2)
    x = np.asarray(round.points)[:, 0]
    np.testing.assert_allclose(x[:4], [2, 2 + 2 / 3, 2 + 4 / 3, 4])  # the B-spline's one segment
    np.testing.assert_allclose(x[4:], [0, 4 / 3, 8 / 3, 4])


def test_objects_are_instances(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    scene = read(
        f"""
        ObjectBegin "pair" Translate 0 0 1 Shape "sphere" AreaLightSource "diffuse" {TRIANGLE}
            Scale 1 1 2 Shape "sphere" ObjectEnd
        ObjectBegin "unused" Shape "sphere" ObjectEnd
        Translate 5 0 0 ObjectInstance "pair" Scale 2 2 2 ObjectInstance "pair"
        """
    )
    group, ellipsoid = scene.shapes
    assert isinstance(group, Instances)
    assert isinstance(ellipsoid, Instances)
    assert sorted(type(shape).__name__ for shape in group.shapes) == ["Mesh", "Spheres"]
    np.testing.assert_allclose(np.asarray(ellipsoid.transforms)[:, 2], [[0, 0, 2, 1], [0, 0, 4, 2]])
    placed = np.asarray(group.transforms)
    np.testing.assert_allclose(placed[:, 0], [[1, 0, 0, 5], [2, 0, 0, 5]])
    sphere = next(shape for shape in group.shapes if isinstance(shape, Spheres))
    np.testing.assert_allclose(sphere.centers, [[0, 0, 1]])
    assert "AreaLightSource in an object" in caplog.text


def test_ply_files_plain_packed_and_lying(read: Read, tmp_path: Path) -> None:
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    body = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0) + struct.pack("<B3i", 3, 0, 1, 2)
    (tmp_path / "a.ply").write_bytes(head.format(3).encode() + body)
    (tmp_path / "b.ply.gz").write_bytes(gzip.compress(head.format(3).encode() + body))
    (tmp_path / "c.ply.gz").write_bytes(gzip.compress(head.format(4_000_000_000).encode() + body))
    one, two = read(
        'Shape "plymesh" "string filename" "a.ply" Shape "plymesh" "string filename" "b.ply.gz"'
    ).shapes
    assert (one.name, two.name) == ("a", "b")
    np.testing.assert_array_equal(mesh(one)[0], mesh(two)[0])
    with pytest.raises(FormatError, match=r"scene.pbrt: line 3: Shape .*c\.ply\.gz: is cut short"):
        read('Shape "plymesh" "string filename" "c.ply.gz"')


# Materials


def made(type: str, **params: Any) -> Material:
    return Material(type, **params)


_CLEAR: dict[str, Any] = {"compensation": "off", "roughness": 0.0}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('"diffuse" "rgb reflectance" [.1 .2 3]', made("diffuse", color=(0.1, 0.2, 1.0))),
        ('"diffuse" "float reflectance" .3', made("diffuse", color=(0.3,) * 3)),
        (
            '"coateddiffuse" "float eta" 1.4',
            made("plastic", color=(0.5,) * 3, ior=1.4, nonlinear="on", **_CLEAR),
        ),
        ('"dielectric"', made("dielectric", ior=1.5, **_CLEAR)),
        (
            '"dielectric" "spectrum eta" "glass-BK7"',
            made("dielectric", ior=1.5168, dispersion=20 / 64.17, **_CLEAR),
        ),
        (
            '"diffusetransmission" "rgb transmittance" [.1 .2 .3] "float scale" 2',
            made("diffuse_transmission", color=(0.5,) * 3, transmittance=(0.2, 0.4, 0.6)),
        ),
        (
            '"translucent" "rgb Kd" [.4 .4 .2] "rgb Ks" [0 0 0]',
            made("diffuse_transmission", color=(0.2, 0.2, 0.1), transmittance=(0.2, 0.2, 0.1)),
        ),
        ('"thindielectric" "float eta" 1.3', made("thin_dielectric", ior=1.3)),
        (
            '"conductor" "spectrum eta" "metal-Au-eta" "spectrum k" "metal-Au-k"',
            made("conductor", eta=spectra.metal("Au")[0], k=spectra.metal("Au")[1], **_CLEAR),
        ),
        ('"interface"', made("null")),
        ('""', made("null")),
        ('"matte" "color Kd" [.1 .2 .3]', made("diffuse", color=(0.1, 0.2, 0.3))),
        ('"mirror"', made("conductor", color=(0.9,) * 3, roughness=0.0)),
        (
            '"glass" "rgb Kr" [1 0 0] "float index" 1.7',
            made("dielectric", ior=1.7, reflectance=(1.0, 0.0, 0.0), **_CLEAR),
        ),
    ],
)
def test_materials(read: Read, text: str, expected: Material) -> None:
    assert material(read(f'Material {text} Shape "sphere"')) == expected


@pytest.mark.parametrize(
    ("text", "alpha"),
    [
        ('"dielectric" "float roughness" .25', (0.5, 0.5)),
        ('"dielectric" "float roughness" .25 "bool remaproughness" false', (0.25, 0.25)),
        ('"conductor" "float uroughness" .09 "float vroughness" .36', (0.3, 0.6)),
        ('"conductor" "float roughness" .25 "float vroughness" .01', (0.5, 0.1)),
        # version 3's polynomial: 1.62142 - 1.88802 + 0.91935 - 0.20900 + 0.01801 at 0.1
        ('"metal" "float roughness" .1', (0.4617600, 0.4617600)),
        ('"metal" "float roughness" 5', (1.0, 1.0)),
    ],
)
def test_roughness_becomes_alpha(read: Read, text: str, alpha: tuple[float, float]) -> None:
    """Ours are roughness^2 times and by q, with q^2 = (1 + a) / (1 - a)."""
    params = material(read(f'Material {text} Shape "sphere"')).params
    a = params.get("anisotropy", 0.0)
    q = math.sqrt((1.0 + a) / (1.0 - a))
    square = params["roughness"] ** 2
    assert (square * q, square / q) == pytest.approx(alpha, rel=1e-5)


def test_conductor_by_its_reflectance(read: Read) -> None:
    params = material(
        read('Material "conductor" "rgb reflectance" [.9 .5 .1] Shape "sphere"')
    ).params
    eta, k = np.array(params["eta"]), np.array(params["k"])
    at_normal = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    np.testing.assert_allclose(at_normal, [0.9, 0.5, 0.1], rtol=1e-9)


def test_mixtures_of_both_versions(read: Read) -> None:
    """Of version 4 the amount is the second's share, of version 3 the first's."""
    two = """
        MakeNamedMaterial "a" "string type" "diffuse" "rgb reflectance" [1 0 0]
        MakeNamedMaterial "b" "string type" "diffuse" "rgb reflectance" [0 1 0]
        """
    four = '"string materials" ["a" "b"] "float amount" .2'
    three = '"string namedmaterial1" "a" "string namedmaterial2" "b" "rgb amount" [.8 .8 .8]'
    for text in (four, three):
        found = material(read(f'{two} Material "mix" {text} Shape "sphere"')).params
        red = (1.0 - found["weight"]) * np.array(found["a"].params["color"])
        green = found["weight"] * np.array(found["b"].params["color"])
        np.testing.assert_allclose(red + green, [0.8, 0.2, 0.0], atol=1e-12)


def test_named_materials_keep_their_names(read: Read) -> None:
    named = 'MakeNamedMaterial "steel" "string type" "conductor" NamedMaterial "steel"'
    scene = read(named + TRIANGLE + 'AreaLightSource "diffuse"' + TRIANGLE)
    assert scene.shapes[0].material == "steel"  # type: ignore[union-attr]
    assert list(scene.materials) == ["steel"]
    assert material(scene, 1).params["emission"] == (1.0, 1.0, 1.0)
    # version 3 lets a name mean another material later
    again = named + TRIANGLE + named.replace("conductor", "diffuse") + TRIANGLE
    scene = read(again)
    assert [material(scene, i).type for i in range(2)] == ["conductor", "diffuse"]


def test_alpha_is_opacity(read: Read) -> None:
    scene = read(TRIANGLE + '"float alpha" .25')
    assert material(scene).params["opacity"] == 0.25


@pytest.mark.parametrize("text", ['"hair"', '"subsurface"', '"fourier"', '"disney"', '"felt"'])
def test_materials_that_are_not_supported_are_told(
    read: Read, caplog: pytest.LogCaptureFixture, text: str
) -> None:
    world = f'Material {text} Shape "sphere"'
    read(world)
    assert text.strip('"') in caplog.text
    with pytest.raises(FormatError, match="strict, and not all of it is supported"):
        read(world, strict=True)


def test_parameters_that_nobody_knows_are_told(
    read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    read('Shape "sphere" "float raduis" 2 Shape "sphere" "float raduis" 3')
    assert caplog.text.count('Shape "sphere": parameter "float raduis" is not known') == 1


def test_an_absorbing_medium_in_glass(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    """Surfaces around one medium are of one material, though each has its own index."""
    medium = (
        'MakeNamedMedium "{}" "string type" "homogeneous" "rgb sigma_a" [1 2 3] "rgb sigma_s" [{}]'
    )
    glass = 'Material "dielectric" "float eta" {} '
    scene = read(
        medium.format("tea", "0 0 0")
        + ' "float scale" 2 MediumInterface "tea" ""'
        + glass.format(1.25)
        + TRIANGLE
        + 'MediumInterface "" "tea"'
        + glass.format(1.6)
        + TRIANGLE,
        'Camera "perspective"',
    )
    first, second = scene.shapes
    assert isinstance(first, Mesh)
    assert isinstance(second, Mesh)
    assert first.material == second.material
    assert material(scene).params["absorption"] == (2.0, 4.0, 6.0)
    assert material(scene).params["ior"] == Texture("attribute", name="face_ior")
    np.testing.assert_allclose(first.attributes["face_ior"], [1.25])
    np.testing.assert_allclose(second.attributes["face_ior"], [1 / 1.6])
    assert (first.inside_out, second.inside_out) == (False, True)
    assert not caplog.records
    read(
        medium.format("milk", "1 1 1") + 'MediumInterface "milk" ""' + glass.format(1.3) + TRIANGLE
    )
    assert "medium 'milk' (homogeneous): participating media are not rendered yet" in caplog.text


def test_colour_spaces(read: Read, caplog: pytest.LogCaptureFixture) -> None:
    """Rec. 2020's red lies outside of ours; white is white in both."""
    one = 'Material "diffuse" "rgb reflectance" [{}] Shape "sphere"'
    assert material(read('ColorSpace "rec2020"' + one.format("1 1 1"))).params[
        "color"
    ] == pytest.approx((1.0, 1.0, 1.0), abs=1e-3)
    assert not any("below 0" in record.message for record in caplog.records)
    # ITU-R BT.2087's matrix: 1.6605 -0.1246 -0.0182
    red = material(read('ColorSpace "rec2020"' + one.format(".5 0 0"))).params["color"]
    assert red == pytest.approx((0.83025, 0.0, 0.0), abs=1e-3)
    assert "a colour has parts below 0, which are cut off" in caplog.text


# Textures


def color(scene: Scene) -> Any:
    return material(scene).params["color"]


def test_textures_of_numbers(read: Read) -> None:
    use = ' Material "diffuse" "texture reflectance" "t" Shape "sphere"'
    head = 'Texture "a" "spectrum" "constant" "rgb value" [.2 .4 .6] Texture "t" "spectrum" '
    scaled = read(head + '"scale" "texture tex" "a" "float scale" .5' + use)
    assert color(scaled) == pytest.approx((0.1, 0.2, 0.3), abs=1e-7)
    mixed = read(head + '"mix" "texture tex1" "a" "rgb tex2" [1 1 1] "float amount" .25' + use)
    assert color(mixed) == pytest.approx((0.4, 0.55, 0.7), abs=1e-7)
    checks = read(
        head + '"checkerboard" "float uscale" 4 "texture tex1" "a" "rgb tex2" [0 0 1]' + use
    )
    assert color(checks).type == "checker"
    assert color(checks).params["color0"] == (0.2, 0.4, 0.6)
    np.testing.assert_allclose(color(checks).params["transform"], np.diag([2.0, 0.5, 1.0]))
    dimmed = read(
        head.replace('"t"', '"c"')
        + '"checkerboard" "texture tex1" "a" Texture "t" "spectrum" "scale" "texture tex" "c" '
        '"float scale" .5' + use
    )
    checker = color(dimmed).params["color0"]
    assert checker.type == "checker"
    assert checker.params["color0"] == pytest.approx((0.2, 0.4, 0.6))
    assert color(dimmed) == Texture("multiply", color0=checker, color1=(0.5, 0.5, 0.5))


def test_image_textures(read: Read, tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((3, 5, 3)).astype(np.float32)
    write_image(tmp_path / "a.pfm", values)
    scene = read(
        'Texture "t" "spectrum" "imagemap" "string filename" "a.pfm" "float uscale" 2 '
        '"string wrap" "black" "float scale" 2 '
        'Texture "r" "float" "imagemap" "string filename" "a.pfm"'
        'Material "coateddiffuse" "texture reflectance" "t" "texture roughness" "r" Shape "sphere"'
    )
    params = material(scene).params
    assert params["color"].type == "multiply"
    assert params["color"].params["color1"] == (2.0, 2.0, 2.0)
    image = params["color"].params["color0"].params
    assert image["image"] == str(tmp_path / "a.pfm")
    assert (image["wrap_u"], image["color_space"]) == ("zero", "linear")
    np.testing.assert_allclose(image["transform"], np.diag([2.0, 1.0, 1.0]))
    # alpha is the root, and our roughness the root of that
    np.testing.assert_allclose(params["roughness"].params["image"], values**0.25, rtol=1e-5)


# Light


def only_light(scene: Scene) -> Light:
    (found,) = [*scene.lights, *([scene.background] if scene.background else [])]
    return found


def luminance(rgb: Any) -> float:
    return float(np.dot((0.212671, 0.715160, 0.072169), rgb))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            '"point" "rgb I" [1 2 3] "float scale" 2 "point3 from" [0 0 1]',
            Light("point", intensity=(2.0, 4.0, 6.0), position=(1.0, 0.0, 1.0)),
        ),
        (
            '"point" "float power" 1000',
            Light("point", intensity=(1000 / (4 * math.pi),) * 3, position=(1.0, 0.0, 0.0)),
        ),
        (
            '"distant" "point3 from" [0 5 0] "point3 to" [0 2 0] "rgb L" [1 2 3]',
            Light("directional", irradiance=(1.0, 2.0, 3.0), direction=(0.0, -1.0, 0.0)),
        ),
        (
            '"distant" "float illuminance" 7',
            Light("directional", irradiance=(7.0,) * 3, direction=(0.0, 0.0, 1.0)),
        ),
    ],
)
def test_lights(read: Read, text: str, expected: Light) -> None:
    found = only_light(read(f"Translate 1 0 0 LightSource {text}"))
    assert found.type == expected.type
    assert found.params.keys() == expected.params.keys()
    for name, value in expected.params.items():
        assert found.params[name] == pytest.approx(value), name


def test_the_power_of_a_spot_is_that_of_its_cone(read: Read) -> None:
    text = '"spot" "float power" 10 "float coneangle" 40 "float conedeltaangle" 10 "rgb I" [1 1 1]'
    found = only_light(read(f"LightSource {text}")).params
    assert (found["cutoff_angle"], found["beam_width"]) == (40.0, 30.0)
    full, end = (math.cos(math.radians(a)) for a in (30, 40))
    whole = 2 * math.pi * (1 - full) + 2 * math.pi * (full - end) / 2
    assert found["intensity"][0] * whole == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("text", "factor"),
    [("", 1.0), ('"float illuminance" 5', 5 / math.pi), ('"float scale" 3', 3.0)],
)
def test_uniform_surroundings(read: Read, text: str, factor: float) -> None:
    found = only_light(read(f'LightSource "infinite" "rgb L" [1 2 1] {text}'))
    assert found.type == "constant"
    assert found.params["radiance"] == pytest.approx((factor, 2 * factor, factor))


def test_spectra_of_lights_have_luminance_one_in_version_4_only(read: Read) -> None:
    table = '"spectrum L" [400 3 500 5 600 9 700 2]'
    for text in (table, '"blackbody L" 3000', '"spectrum L" "stdillum-A"'):
        found = only_light(read(f'LightSource "infinite" {text} "float scale" 4')).params[
            "radiance"
        ]
        assert luminance(found) == pytest.approx(4.0, rel=1e-5)
        assert found[0] > found[2]
    old = 'Film "image"'
    found = only_light(read(f'LightSource "infinite" {table}', old)).params["radiance"]
    assert found == pytest.approx(spectra.emission([400, 500, 600, 700], [3, 5, 9, 2]))
    # its blackbody has a peak of the factor that follows the temperature; at 6504 K that lies at
    # 446 nm, and at 555 nm, where the eye is at its best, Planck's law gives 0.8985 of it
    found = only_light(read('LightSource "infinite" "blackbody L" [6504 3]', old)).params[
        "radiance"
    ]
    assert luminance(found) == pytest.approx(3.0 * 0.8985, rel=0.03)


def test_exposure_is_in_all_light(read: Read) -> None:
    lamps = f'LightSource "point" AreaLightSource "diffuse" {TRIANGLE}'
    slow = 'Camera "perspective" "float shutterclose" .5 Film "rgb" "float iso" 800'
    for head, factor in ((slow, 4.0), ('Film "image" "float scale" 3', 3.0)):
        scene = read(lamps, head)
        assert only_light(scene).params["intensity"] == (factor,) * 3
        assert material(scene).params["emission"] == (factor,) * 3


def test_area_lights(read: Read) -> None:
    lamp = 'AreaLightSource "diffuse" "rgb L" [1 2 3] "bool twosided" true'
    scene = read(f'Scale 2 2 2 {lamp} {TRIANGLE} {lamp} "float power" 100 Shape "sphere"')
    params = material(scene).params
    assert params["emission"] == (1.0, 2.0, 3.0)
    assert params["two_sided_emission"] is True
    # of both sides of a sphere of radius 2: the power is pi times radiance and area
    found = material(scene, 1).params["emission"]
    assert found[0] * math.pi * 2 * 4 * math.pi * 4 == pytest.approx(100.0)


_AXES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def seen(scene: Scene, direction: tuple[float, float, float]) -> Any:
    up = (0.0, 0.0, 1.0) if direction[2] == 0 else (0.0, 1.0, 0.0)
    looking = Camera(eye=(0.0, 0.0, 0.0), target=direction, up=up, vfov=2.0)
    image = ph.render(scene.replace(camera=looking), width=1, height=1, spp=4, filter="box")
    return image.numpy()[0, 0, :3]


def test_surroundings_of_version_3_by_latitude_and_longitude(read: Read, tmp_path: Path) -> None:
    """u is the angle from x to y over 360 degrees, and the first row is +z."""
    values = np.zeros((32, 64, 3), np.float32)
    values[:8], values[24:] = 5.0, 6.0
    for quarter, value in enumerate((1.0, 2.0, 3.0, 4.0)):  # +x, +y, -x, -y
        columns = (np.arange(-8, 8) + 16 * quarter) % 64
        values[8:24, columns] = value
    write_image(tmp_path / "sky.pfm", values)
    scene = read('LightSource "infinite" "string mapname" "sky.pfm"', 'Film "image"')
    found = [float(seen(scene, axis)[0]) for axis in _AXES]
    np.testing.assert_allclose(found, [1.0, 3.0, 2.0, 4.0, 5.0, 6.0], rtol=1e-4)
    turned = read(
        'Rotate 90 0 0 1 Scale 1 1 -1 LightSource "infinite" "string mapname" "sky.pfm"',
        'Film "image"',
    )
    found = [float(seen(turned, axis)[0]) for axis in _AXES]
    np.testing.assert_allclose(found, [4.0, 2.0, 1.0, 3.0, 6.0, 5.0], rtol=1e-4)


def test_surroundings_of_version_4_by_equal_area(
    read: Read, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """In the square's middle is +z, in its corners -z; x to the right, y down."""
    n = 64
    y, x = ((np.indices((n, n)) + 0.5) * 2 / n) - 1
    values = np.zeros((n, n, 3), np.float32)
    values[np.abs(x) + np.abs(y) < 0.3] = 5.0
    values[np.abs(x) + np.abs(y) > 1.7] = 6.0
    for value, (a, b) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1)), 1):
        values[np.hypot(x - a, y - b) < 0.3] = value
    write_image(tmp_path / "sky.pfm", values)
    lit = '"string filename" "sky.pfm" "float illuminance" {}'
    scene = read(f'LightSource "infinite" {lit.format(-1)}', 'Camera "perspective"')
    found = [float(seen(scene, axis)[0]) for axis in _AXES]
    np.testing.assert_allclose(found, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], rtol=1e-4)
    assert not caplog.records
    # a constant square of radiance 1 gives an illuminance of pi
    write_image(tmp_path / "sky.pfm", np.ones((n, n, 3), np.float32))
    scene = read(f'LightSource "infinite" {lit.format(2)}')
    assert only_light(scene).params["scale"][0] == pytest.approx(2 / math.pi, rel=2e-3)
    write_image(tmp_path / "sky.pfm", np.ones((n, 2 * n, 3), np.float32))
    scene = read(f'LightSource "infinite" {lit.format(2)}')
    assert only_light(scene).params["scale"][0] == pytest.approx(2 / math.pi, rel=2e-3)
    assert "its image is not square" in caplog.text


def test_a_projection_is_as_bright_at_its_corners_as_pbrt_has_it(
    read: Read, tmp_path: Path
) -> None:
    """Intensity is the image's value: at an angle, a screen gets cos^3 of what its middle does."""
    write_image(tmp_path / "slide.pfm", np.full((64, 64, 3), 3.0, np.float32))
    scene = read(
        """
        LightSource "projection" "string filename" "slide.pfm" "float fov" 90
        Material "diffuse" "rgb reflectance" [1 1 1] Translate 0 0 2
        Shape "disk" "float radius" 9
        """
    )
    for x in (0.0, 1.5):
        looking = Camera(eye=(x, 0.0, 1.0), target=(x, 0.0, 2.0), vfov=1.0)
        found = ph.render(scene.replace(camera=looking), width=1, height=1, spp=4, max_depth=2)
        distance = math.hypot(x, 2.0)
        expected = 3.0 / distance**2 * (2.0 / distance) / math.pi
        assert float(found.numpy()[0, 0, 0]) == pytest.approx(expected, rel=0.01)


def test_dispersion_of_a_table(read: Read) -> None:
    """Between the lines F and C, 486.1 and 656.3 nm, this index falls by 0.01702."""
    found = material(read('Material "dielectric" "spectrum eta" [400 1.6 800 1.56] Shape "sphere"'))
    assert found.params["ior"] == pytest.approx(1.58124)
    assert found.params["dispersion"] == pytest.approx(20 * 0.01702 / 0.58124)


@pytest.mark.parametrize("old", [False, True])
def test_a_goniometric_light_shines_by_its_picture(read: Read, tmp_path: Path, old: bool) -> None:
    """A picture that is 1 towards +y of the lamp's frame, and else 0.25."""
    values = np.full((64, 64, 3), 0.25, np.float32)
    if old:  # rows are latitudes
        values[:32] = 1.0
    else:  # y grows with the row of the octahedron's unfolding
        values[32:] = 1.0
    write_image(tmp_path / "ies.pfm", values)
    name = "mapname" if old else "filename"
    light = f"""
        Translate 0 1 0 Rotate 90 1 0 0
        LightSource "goniometric" "string {name}" "ies.pfm" "rgb I" [2 2 2]"""
    head = 'Film "image"' if old else ""
    scene = read(f'{light} Identity Translate 0 1 2 Shape "sphere"', head=head)
    for z, share in ((2.0, 1.0), (-2.0, 0.25)):  # the rotation takes +y to +z
        wall = ph.Mesh(
            [[-9, -9, z], [9, -9, z], [9, 9, z], [-9, 9, z]],
            [[0, 1, 2], [0, 2, 3]],
            material=ph.Material("diffuse", color=(1, 1, 1)),
        )
        looking = Camera(eye=(0.1, 1.0, 0.0), target=(0.1, 1.0, z), vfov=1.0)
        found = ph.render(
            scene.replace(shapes=(wall,), camera=looking), width=1, height=1, spp=4, max_depth=2
        )
        assert found.numpy()[0, 0, 0] == pytest.approx(2.0 * share / 4.0 / math.pi, rel=0.01)
    if not old:
        found = only_light(read(light + '"float power" 8')).params["intensity"][0]
        assert found * 4 * math.pi * 0.625 == pytest.approx(16.0)


def test_a_picture_that_is_none(read: Read, tmp_path: Path) -> None:
    (tmp_path / "sky.png").write_text("hello")
    with pytest.raises(FormatError, match=r"scene.pbrt: line 3: LightSource .*sky.png: cannot be"):
        read('LightSource "infinite" "string filename" "sky.png"')


# Camera and settings


def test_the_picture_is_not_mirrored(read: Read) -> None:
    """Of a left-handed frame, +x is to the right of a camera that looks along +z."""
    scene = read(
        """
        Material "diffuse" "rgb reflectance" [0 0 0] AreaLightSource "diffuse" "rgb L" [1 0 0]
        TransformBegin Translate 1 1 5 Shape "sphere" "float radius" .5 TransformEnd
        AreaLightSource "diffuse" "rgb L" [0 1 0] Translate -1 -1 5 Shape "sphere" "float radius" .5
        """,
        'PixelFilter "box" LookAt 0 0 0 0 0 1 0 1 0 Camera "perspective" "float fov" 60',
    )
    image = ph.render(scene, width=16, height=16, spp=16).numpy()
    assert image[:8, 8:, 0].sum() > 5.0  # red at the top right
    assert image[8:, :8, 1].sum() > 5.0  # green at the bottom left
    assert image[:, :8, 0].sum() == image[:8, :, 1].sum() == 0.0
    flipped = read("", 'Scale -1 1 1 LookAt 0 0 0 0 0 1 0 1 0 Camera "perspective"')
    assert camera(flipped).mirrored != camera(scene).mirrored


def test_the_field_of_view_is_of_the_shorter_side(read: Read) -> None:
    film = 'Film "rgb" "integer xresolution" {} "integer yresolution" {} Camera "perspective" {}'
    wide, high = (
        camera(read("", film.format(*size, '"float fov" 60'))) for size in ((200, 100), (100, 200))
    )
    assert wide.vfov == pytest.approx(60.0)
    assert math.tan(math.radians(high.vfov / 2)) == pytest.approx(2 * math.tan(math.radians(30)))  # type: ignore[operator]
    window = '"float fov" 90 "float screenwindow" [0 2 -.5 .5]'
    part = camera(read("", film.format(200, 100, window)))
    assert part.vfov == pytest.approx(2 * math.degrees(math.atan(0.5)))
    assert part.shift == (0.5, 0.0)


def test_lens_orthographic_and_spherical_cameras(read: Read) -> None:
    look = "Scale .5 .5 .5 LookAt 1 2 3 1 2 9 0 1 0 "
    lens = camera(
        read("", look + 'Camera "perspective" "float lensradius" .1 "float focaldistance" 4')
    )
    assert (lens.aperture_radius, lens.focus_distance) == pytest.approx((0.2, 8.0))
    np.testing.assert_allclose(lens.eye, (1, 2, 3))
    flat = camera(read("", look + 'Camera "orthographic" "float screenwindow" [-3 3 -2 2]'))
    assert flat.projection == "orthographic"
    assert flat.height == pytest.approx(8.0)
    round = camera(read("", 'Camera "environment"'))
    assert round.projection == "equirectangular"
    np.testing.assert_allclose(np.subtract(round.target, round.eye), (-1, 0, 0))
    assert not round.mirrored  # to the right of -x is -z


def test_settings(read: Read) -> None:
    found = read(
        "",
        """
        Film "rgb" "integer xresolution" 100 "integer yresolution" 50
            "float cropwindow" [.1 .5 0 .5]
        Sampler "stratified" "integer xsamples" 3 "integer ysamples" 5
        PixelFilter "triangle" "float xradius" 1 "float yradius" 1
        Integrator "path" "integer maxdepth" 7
        """,
    ).settings
    assert (found.width, found.height, found.crop) == (100, 50, (10, 0, 40, 25))
    assert (found.spp, found.filter, found.filter_radius) == (15, "tent", 1.0)
    assert found.max_depth == 8  # pbrt counts bounces, we rays
    assert (read("").settings.width, read("").settings.max_depth) == (1280, 6)
    assert read("", 'Film "image"').settings.filter == "box"
    assert read("", 'Integrator "ao" "float maxdistance" 3').settings.ao_distance == 3.0


def test_integrators_that_follow_light_are_told(
    read: Read, caplog: pytest.LogCaptureFixture
) -> None:
    for kind in ("path", "volpath", "simplepath", "simplevolpath"):
        read("", f'Integrator "{kind}"')
    assert "Integrator" not in caplog.text
    for kind in ("sppm", "bdpt", "mlt", "lightpath"):
        read("", f'Integrator "{kind}"')
        assert f'Integrator "{kind}": rendered by path tracing, which finds' in caplog.text


@pytest.mark.parametrize("bounces", [0, 1, 2])
def test_depth_counts_what_pbrt_counts(read: Read, bounces: int) -> None:
    """In a closed sphere that shines with 1 and reflects a half, each bounce adds its share."""
    scene = read(
        """
        Material "diffuse" "rgb reflectance" [.5 .5 .5]
        AreaLightSource "diffuse" "bool twosided" true Shape "sphere"
        """,
        f'Integrator "path" "integer maxdepth" {bounces} Camera "perspective"',
    )
    image = ph.render(scene, width=8, height=8, spp=64).numpy()
    assert float(image.mean()) == pytest.approx(sum(0.5**k for k in range(bounces + 1)), rel=0.02)


# Scenes that others made


@pytest.mark.parametrize(
    ("name", "shapes", "told"),
    [
        ("bitterli-classroom/scene-v4.pbrt", 79, 0),
        ("bitterli-coffee/scene-v4.pbrt", 23, 0),
        ("bitterli-cornell-box/scene-v4.pbrt", 8, 0),
        ("bitterli-teapot-full/scene-v4.pbrt", 5, 1),
        ("bitterli-veach-mis/scene-v4.pbrt", 9, 0),
        ("bitterli-water-caustic/scene-v4.pbrt", 10, 1),
        ("pbrt-v1v3/arcsphere-v3/arcsphere.pbrt", 7, 0),
        ("pbrt-v1v3/hairblock-v3/sphere-hairblock.pbrt", 3, 1),
        ("pbrt-v1v3/killeroo-v3/killeroo-simple.pbrt", 5, 1),
        ("pbrt-v1v3/sphereflake-v1/balls.pbrt", 2, 3),
    ],
)
def test_shared_scenes_load(
    shared_scenes: Path, caplog: pytest.LogCaptureFixture, name: str, shapes: int, told: int
) -> None:
    with caplog.at_level(logging.WARNING):
        scene = load(shared_scenes / name)
    assert len(scene.shapes) == shapes
    assert len(caplog.records) == told


def test_the_cornell_box_agrees_with_its_reference(shared_scenes: Path) -> None:
    """Tungsten's converged picture; the file is the same scene in pbrt's terms."""
    folder = shared_scenes / "bitterli-cornell-box"
    reference = read_pixels(folder / "TungstenRender.exr")[:, :, :3].astype(np.float64)
    scene = load(folder / "scene-v4.pbrt")
    image = ph.render(scene, width=64, height=64, spp=64, filter="box").numpy()[:, :, :3]
    np.testing.assert_allclose(image.mean((0, 1)), reference.mean((0, 1)), rtol=0.01)
