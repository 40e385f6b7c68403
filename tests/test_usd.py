"""USD: subdivision against known limits, what each kind of prim becomes, and what is refused."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.image import encoded, read_pixels
from parhelion.io.frames import Extent, frames_in
from parhelion.subdivision import INFINITE, subdivide

# The corners of a cube, and its sides, counter-clockwise from outside
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SIDES = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)
EDGES = np.concatenate([SIDES[:, [k, (k + 1) % 4]] for k in range(4)])


def cube(levels: int, **more: Any) -> Any:
    return subdivide(CORNERS, np.full(6, 4), SIDES.ravel(), levels=levels, **more)


# --- Subdivision ---------------------------------------------------------------------------------


@pytest.mark.parametrize("levels", [1, 2, 4])
def test_the_limit_of_a_cube(levels: int) -> None:
    """Corner: (9 v + 4 sum e + sum f) / 24. Side: (16 f + 4 * 3 + 20 / 9) / 36, as its edge points
    are at 3/4 and its corners at 5/9 after one level.
    """
    made = cube(levels)
    np.testing.assert_allclose(made.points[:8], 0.5 * CORNERS, atol=1e-12)
    assert made.points.max() == pytest.approx(68 / 81)
    assert len(made.faces) == 6 * 4**levels
    np.testing.assert_allclose(np.linalg.norm(made.normals, axis=2), 1)
    outwards = np.einsum("fci,fci->fc", made.normals, made.points[made.faces])
    assert outwards.min() > 0.5


def test_creases() -> None:
    """Sharp for ever, a cube stays one. Of sharpness 1, it stays one for a level. Of 1/2, a corner
    goes to (1 + 5/9) / 2 and an edge to (1 + 3/4) / 2, so the limit is (7 + 7 + 1) / 24.
    """
    every = {"creases": EDGES, "sharpness": np.full(24, INFINITE)}
    box = cube(3, **every)
    np.testing.assert_allclose(np.abs(box.points).max(axis=1), 1)
    np.testing.assert_allclose(np.abs(box.normals).max(axis=2), 1)
    once = cube(4, creases=EDGES, sharpness=np.ones(24))
    split = cube(1, **every)
    then = subdivide(split.points, np.full(24, 4), split.faces.ravel(), levels=3)
    np.testing.assert_allclose(np.sort(once.points, axis=0), np.sort(then.points, axis=0))
    half = cube(3, creases=EDGES, sharpness=np.full(24, 0.5))
    np.testing.assert_allclose(half.points[:8], 0.625 * CORNERS, atol=1e-12)
    tip = cube(3, corner_vertices=[7], corner_sharpness=[INFINITE])
    np.testing.assert_allclose(tip.points[7], CORNERS[7])
    assert np.abs(tip.points[0]).max() < 0.6


def test_a_crease_around_a_side_is_a_b_spline() -> None:
    """A closed curve of four points: each goes to (4 v + a + b) / 6."""
    ring = SIDES[1]
    ends = np.stack([ring, np.roll(ring, -1)], axis=1)
    made = cube(3, creases=ends, sharpness=np.full(4, INFINITE))
    np.testing.assert_allclose(made.points[ring], CORNERS[ring] * [1, 2 / 3, 2 / 3])
    at = made.faces == ring[0]
    assert len(np.unique(made.normals[at].round(6), axis=0)) == 2


def test_boundaries_and_values() -> None:
    """A square of four keeps its corners, or not; linear functions are kept inside and along."""
    grid = np.array([[x, y, 0] for y in range(3) for x in range(3)], float)
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]])
    value, at = grid[:, :1], grid[quads.ravel()][:, :2]
    made = subdivide(
        grid, np.full(4, 4), quads.ravel(), levels=2, smooth=value, linear=value, corner=at
    )
    np.testing.assert_allclose(made.points[[0, 4]], grid[[0, 4]], atol=1e-12)
    np.testing.assert_allclose(made.smooth[:, 0], made.points[:, 0], atol=1e-12)
    np.testing.assert_allclose(made.linear[made.faces][:, :, 0], made.corner[:, :, 0])
    np.testing.assert_array_equal(np.bincount(made.parent), 16)
    free = subdivide(grid, np.full(4, 4), quads.ravel(), levels=2, sharp_boundary_corners=False)
    np.testing.assert_allclose(free.points[0], [1 / 6, 1 / 6, 0], atol=1e-12)
    flat = cube(2, scheme="bilinear")
    np.testing.assert_allclose(np.abs(flat.points).max(axis=1), 1)


def test_the_limit_of_a_tetrahedron_by_loop() -> None:
    """At three neighbours beta is 3/16, and the limit (2 v + sum of neighbours) / 5 = v / 5."""
    tips = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    made = subdivide(tips, np.full(4, 3), faces.ravel(), levels=3, scheme="loop")
    np.testing.assert_allclose(made.points[:4], 0.2 * tips, atol=1e-12)
    assert made.faces.shape == (256, 3)


# --- Stages --------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def _needs_usd(request: pytest.FixtureRequest) -> None:
    if "tmp_path" in request.fixturenames or "shared_scenes" in request.fixturenames:
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")


def write(folder: Path, body: str, meta: str = "", name: str = "a.usda") -> Path:
    path = folder / name
    path.write_text(f"#usda 1.0\n({meta}\n)\n{body.replace('}', chr(10) + '}' + chr(10))}")
    return path


def load(path: Path, **options: Any) -> Any:
    scene = ph.load(path, ph.LoadOptions(**options))
    ph.prepare(scene)
    return scene


def read(folder: Path, body: str, meta: str = "", **options: Any) -> Any:
    return load(write(folder, body, meta), **options)


def named(scene: Any) -> dict[str, Any]:
    return {shape.name: shape for shape in scene.shapes}


def rows(values: Any) -> str:
    return "[" + ", ".join("(" + ", ".join(f"{x:g}" for x in row) + ")" for row in values) + "]"


def ops(**kinds: str) -> str:
    """Transform operations in their order."""
    types = {"translate": "double3", "scale": "float3", "rotateX": "float", "rotateY": "float"}
    text = "".join(f"{types[k]} xformOp:{k} = {v}\n" for k, v in kinds.items())
    return text + f"uniform token[] xformOpOrder = {[f'xformOp:{k}' for k in kinds]}\n".replace(
        "'", '"'
    )


BOX = f"""
int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
int[] faceVertexIndices = {SIDES.ravel().tolist()}
point3f[] points = {rows(CORNERS)}
"""
FLAT = 'uniform token subdivisionScheme = "none"\n'
QUAD = """
int[] faceVertexCounts = [4]
int[] faceVertexIndices = [0, 1, 2, 3]
point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
"""


def volume(mesh: Any) -> float:
    """Of a closed mesh whose faces show outwards."""
    v = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]
    return float(np.einsum("fi,fi->", v[:, 0], np.cross(v[:, 1], v[:, 2])) / 6)


def test_meshes(tmp_path: Path) -> None:
    body = f"""
def Xform "W" {{ {ops(translate="(5, 0, 0)", scale="(1, 2, 1)")}
  def Mesh "Box" {{ {BOX}{FLAT} }} }}
def Mesh "Mirrored" {{ {BOX}{FLAT}{ops(scale="(-1, 1, 1)")} }}
def Mesh "Left" {{ {BOX}{FLAT}uniform token orientation = "leftHanded" }}
def Mesh "Hole" {{ {BOX}{FLAT}int[] holeIndices = [0] }}
def Mesh "Smooth" {{ {BOX} }}
"""
    shapes = named(read(tmp_path, body))
    assert volume(shapes["/W/Box"]) == pytest.approx(16)
    np.testing.assert_allclose(np.asarray(shapes["/W/Box"].vertices).mean(axis=0), [5, 0, 0])
    assert shapes["/W/Box"].normals is None
    assert volume(shapes["/Mirrored"]) == pytest.approx(8)
    assert volume(shapes["/Left"]) == pytest.approx(-8)
    assert len(shapes["/Hole"].faces) == 10
    smooth = shapes["/Smooth"]
    assert np.max(smooth.vertices) == pytest.approx(68 / 81)
    assert np.einsum("vi,vi->v", smooth.normals, smooth.vertices).min() > 0.5


def test_normals_and_uvs_are_shared_where_they_are_equal(tmp_path: Path) -> None:
    uvs = "texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)]"
    indices = f"int[] primvars:st:indices = {[0, 1, 2, 3] * 6}"
    normals = rows(np.repeat(np.repeat(np.eye(3), 2, axis=0), 4, axis=0))
    body = f"""
def Mesh "Box" {{ {BOX}{FLAT}rel material:binding = </M>
 {uvs} (interpolation = "faceVarying")
 {indices}
 normal3f[] normals = {normals} (interpolation = "faceVarying")
}}
def Mesh "Quad" {{ {QUAD}{FLAT}rel material:binding = </M>
 {uvs} (interpolation = "vertex") }}
{textured()}
"""
    picture(tmp_path)
    shapes = named(read(tmp_path, body))
    assert len(shapes["/Box"].vertices) == 24
    assert shapes["/Box"].uvs.shape == (24, 2)
    np.testing.assert_allclose(shapes["/Box"].normals.max(axis=1), 1)
    assert len(shapes["/Quad"].vertices) == 4


@pytest.mark.parametrize(
    ("interpolation", "values"),
    [("constant", 1), ("uniform", 6), ("vertex", 8), ("varying", 8), ("faceVarying", 24)],
)
@pytest.mark.parametrize("scheme", ["none", "bilinear"])
def test_display_color(tmp_path: Path, interpolation: str, values: int, scheme: str) -> None:
    ramp = np.linspace(0, 1, values)
    colors = rows(np.stack([ramp, 1 - ramp, 0 * ramp], axis=1))
    body = f"""def Mesh "Box" {{ {BOX}
uniform token subdivisionScheme = "{scheme}"
color3f[] primvars:displayColor = {colors} (interpolation = "{interpolation}")
float[] primvars:displayOpacity = [0.5] }}"""
    mesh = named(read(tmp_path, body))["/Box"]
    made = np.asarray(mesh.attributes["vertex_displayColor"])
    assert mesh.material.params["color"].params["name"] == "vertex_displayColor"
    np.testing.assert_allclose(made[:, 0] + made[:, 1], 1, atol=1e-6)
    assert len(np.unique(made[:, 0])) >= values
    np.testing.assert_allclose(mesh.attributes["vertex_displayOpacity"], 0.5)


def test_parts_of_a_mesh(tmp_path: Path) -> None:
    body = f"""
def Material "M" {{ token outputs:surface.connect = </M/S.outputs:surface>
 def Shader "S" {{ uniform token info:id = "UsdPreviewSurface"
  token outputs:surface }} }}
def Mesh "Box" {{ {BOX}{FLAT}
 color3f[] primvars:displayColor = [(1, 0, 0)]
 def GeomSubset "Top" {{ uniform token elementType = "face"
  uniform token familyName = "materialBind"
  int[] indices = [0, 5]
  rel material:binding = </M> }} }}
"""
    shapes = named(read(tmp_path, body))
    assert len(shapes["/Box"].faces) == 8
    assert len(shapes["/Box/Top"].faces) == 4
    assert shapes["/Box/Top"].material == "/M"


# --- Materials -----------------------------------------------------------------------------------


def picture(folder: Path, name: str = "p.png") -> Path:
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[:] = [255, 102, 0, 255]
    pixels[0, 0, 3] = 51
    path = folder / name
    path.write_bytes(encoded(pixels, {}, ".png"))
    return path


def textured(inputs: str = "", texture: str = "", file: str = "p.png") -> str:
    return f"""
def Material "M" {{ token outputs:surface.connect = </M/S.outputs:surface>
 def Shader "S" {{ uniform token info:id = "UsdPreviewSurface"
  color3f inputs:diffuseColor.connect = </M/T.outputs:rgb>
  {inputs}
  token outputs:surface }}
 def Shader "T" {{ uniform token info:id = "UsdUVTexture"
  asset inputs:file = @{file}@
  token inputs:wrapS = "repeat"
  {texture}
  float2 inputs:st.connect = </M/X.outputs:result>
  float outputs:r
  float outputs:a
  float3 outputs:rgb }}
 def Shader "X" {{ uniform token info:id = "UsdTransform2d"
  float2 inputs:in.connect = </M/R.outputs:result>
  float2 inputs:scale = (2, 3)
  float inputs:rotation = 90
  float2 inputs:translation = (0.5, 0)
  float2 outputs:result }}
 def Shader "R" {{ uniform token info:id = "UsdPrimvarReader_float2"
  string inputs:varname = "st"
  float2 outputs:result }} }}
"""


BOUND = f'def Mesh "Q" {{ {QUAD}rel material:binding = </M> }}'


def material(folder: Path, inputs: str = "", texture: str = "", **options: Any) -> Any:
    body = textured(inputs, texture) + BOUND
    return read(folder, body, **options).materials["/M"].params


def test_a_preview_surface(tmp_path: Path) -> None:
    picture(tmp_path)
    m = material(
        tmp_path,
        """float inputs:metallic = 0.25
        float inputs:roughness.connect = </M/T.outputs:r>
        float inputs:clearcoat = 2
        color3f inputs:emissiveColor = (3, 0, 0)
        float inputs:ior = 1.3""",
        'token inputs:sourceColorSpace = "raw"\nfloat4 inputs:scale = (0.5, 1, 1, 1)',
    )
    assert (m["metallic"], m["clearcoat"], m["ior"]) == (0.25, 1.0, pytest.approx(1.3))
    assert m["emission"] == (3.0, 0.0, 0.0)
    assert m["roughness"].type == "multiply"
    assert m["roughness"].params["color0"].params["channel"] == "r"
    assert m["color"].params["color1"] == (0.5, 1.0, 1.0)
    image = m["color"].params["color0"].params
    assert (image["wrap_u"], image["wrap_v"], image["color_space"]) == ("repeat", "zero", "linear")
    # (u, v) = (1, 0) is scaled to (2, 0), turned to (0, 2), moved to (0.5, 2)
    np.testing.assert_allclose(np.array(image["transform"]) @ [1, 0, 1], [0.5, 2], atol=1e-12)


def test_textures_that_are_computed(tmp_path: Path) -> None:
    picture(tmp_path)
    opacity = "float inputs:opacity.connect = </M/T.outputs:a>\n"
    m = material(tmp_path, opacity + "float inputs:opacityThreshold = 0.5")
    np.testing.assert_array_equal(m["opacity"].params["image"], [[0, 255], [255, 255]])
    normal = "normal3f inputs:normal.connect = </M/T.outputs:rgb>\n"
    usual = "float4 inputs:scale = (2, 2, 2, 1)\nfloat4 inputs:bias = (-1, -1, -1, 0)"
    m = material(tmp_path, normal, usual)
    assert m["normal_map"].params["image"].endswith("p.png")
    assert m["normal_map"].params["color_space"] == "linear"
    upside = "float4 inputs:scale = (2, -2, 2, 1)\nfloat4 inputs:bias = (-1, 1, -1, 0)"
    m = material(tmp_path, normal, upside)
    np.testing.assert_allclose(m["normal_map"].params["image"][1, 1], [1, 0.6, 0], atol=1e-6)


@pytest.mark.parametrize("f0", [0.04, 0.5])
def test_the_specular_workflow(tmp_path: Path, f0: float) -> None:
    picture(tmp_path)
    m = material(
        tmp_path,
        f"int inputs:useSpecularWorkflow = 1\ncolor3f inputs:specularColor = ({f0}, 0, 0)",
    )
    assert ((m["ior"] - 1) / (m["ior"] + 1)) ** 2 == pytest.approx(f0)
    assert m["specular_color"] == (1.0, 0.0, 0.0)
    assert "metallic" not in m


def test_primvars_of_other_names(tmp_path: Path) -> None:
    picture(tmp_path)
    body = textured().replace('"st"', '"map2"') + BOUND.replace(
        "rel material",
        'texCoord2f[] primvars:map2 = [(0, 0), (2, 0), (2, 2), (0, 2)] (interpolation = "vertex")\n'
        "rel material",
    )
    mesh = named(read(tmp_path, body))["/Q"]
    assert np.max(mesh.uvs) == 2
    assert not mesh.attributes


def test_pictures_in_an_archive(tmp_path: Path) -> None:
    path = tmp_path / "a.usdz"
    inner = write(tmp_path, textured() + BOUND)
    with zipfile.ZipFile(path, "w") as archive:  # not aligned, which readers do not need
        archive.write(inner, "a.usda")
        archive.write(picture(tmp_path), "p.png")
    (tmp_path / "p.png").unlink()
    image = load(path).materials["/M"].params["color"].params["image"]
    np.testing.assert_array_equal(read_pixels(image)[1, 1], [255, 102, 0, 255])


# --- Instances, points, curves -------------------------------------------------------------------


def test_instances_of_instances(tmp_path: Path) -> None:
    body = f"""
def Xform "Part" {{ def Sphere "S" {{ double radius = 0.5
 {ops(translate="(0, 0, 1)")} }} }}
def "Pair" {{
 def "A" (instanceable = true references = </Part>) {{ }}
 def "B" (instanceable = true references = </Part>) {{ {ops(translate="(0, 2, 0)")} }} }}
def PointInstancer "Many" {{
 int[] protoIndices = [0, 0, 0]
 int64[] invisibleIds = [1]
 point3f[] positions = [(10, 0, 0), (20, 0, 0), (30, 0, 0)]
 rel prototypes = </Pair> }}
"""
    shapes = named(read(tmp_path, body.replace("(instanceable = true ", "(instanceable = true\n")))
    assert len(shapes["/Part/S"].centers) == 1
    copies = [s for s in shapes.values() if isinstance(s, ph.Instances)]
    places = np.concatenate([c.transforms[:, :3, 3] for c in copies])
    expected = [[x, y, 0] for x in (0, 10, 30) for y in (0, 2)]
    assert sorted(places.tolist()) == expected
    np.testing.assert_array_equal(copies[0].shapes[0].centers, [[0, 0, 1]])


def test_an_ellipsoid_is_an_instance(tmp_path: Path) -> None:
    (copy,) = (
        s
        for s in read(tmp_path, f'def Sphere "S" {{ {ops(scale="(1, 2, 3)")} }}').shapes
        if s.name == "/S"
    )
    np.testing.assert_array_equal(np.diag(copy.transforms[0]), [1, 2, 3, 1])


def test_points(tmp_path: Path) -> None:
    body = f"""def Points "P" {{ point3f[] points = [(0, 0, 0), (1, 0, 0), (9, 0, 0)]
 float[] widths = [1, 2, 0] (interpolation = "vertex")
 color3f[] primvars:displayColor = [(1, 0, 0), (0, 2, 0), (0, 0, 1)] (interpolation = "vertex")
 {ops(scale="(2, 2, 2)")} }}"""
    points = named(read(tmp_path, body))["/P"]
    np.testing.assert_allclose(points.centers, [[0, 0, 0], [2, 0, 0]])
    np.testing.assert_allclose(points.radii, [1, 2])
    np.testing.assert_allclose(points.colors, [[1, 0, 0], [0, 1, 0]])


def curves(folder: Path, basis: str, wrap: str, points: Any, more: str = "") -> Any:
    cubic = "linear" if basis == "linear" else "cubic"
    text = f"""def BasisCurves "C" {{ int[] curveVertexCounts = [{len(points)}]
 point3f[] points = {rows(points)}
 uniform token type = "{cubic}"
 {f'uniform token basis = "{basis}"' if basis != "linear" else ""}
 uniform token wrap = "{wrap}"
 {more or "float[] widths = [0.2] (interpolation = 'constant')"} }}"""
    return named(read(folder, text.replace("'", '"')))["/C"]


def test_curves(tmp_path: Path) -> None:
    zigzag = np.array([[0, 0, 0], [1, 1, 0], [2, 0, 0], [3, 1, 0], [4, 0, 0]], float)
    through = curves(tmp_path, "catmullRom", "nonperiodic", zigzag)
    assert through.basis == "bezier"
    np.testing.assert_allclose(through.points[::3], zigzag[1:-1])
    # at a point, the direction of the chord between its neighbours, a sixth of it long
    np.testing.assert_allclose(through.points[4] - through.points[3], (zigzag[3] - zigzag[1]) / 6)
    pinned = curves(tmp_path, "bspline", "pinned", zigzag)
    first = np.array([1, 4, 1]) @ pinned.points[:3] / 6
    np.testing.assert_allclose(first, zigzag[0], atol=1e-12)
    ring = curves(tmp_path, "bspline", "periodic", zigzag)
    np.testing.assert_allclose(ring.points[5:], zigzag[:3])
    line = curves(tmp_path, "linear", "periodic", zigzag)
    assert line.counts.tolist() == [6]
    np.testing.assert_allclose(line.radii, 0.1)
    more = "float[] widths = [2, 4] (interpolation = 'varying')"
    tapered = curves(tmp_path, "bezier", "nonperiodic", zigzag[:4], more)
    np.testing.assert_allclose(tapered.radii, [1, 4 / 3, 5 / 3, 2])


@pytest.mark.parametrize(
    ("kind", "inputs", "expected"),
    [
        ("Cube", "double size = 3", 27),
        ("Cylinder", "double height = 3\ndouble radius = 2", 12 * np.pi),
        ("Cone", 'double height = 3\ndouble radius = 2\nuniform token axis = "X"', 4 * np.pi),
        ("Capsule", "double height = 3\ndouble radius = 1", 13 / 3 * np.pi),
        (
            "Cylinder_1",
            "double height = 3\ndouble radiusTop = 1\ndouble radiusBottom = 2",
            7 * np.pi,
        ),
    ],
)
def test_solids(tmp_path: Path, kind: str, inputs: str, expected: float) -> None:
    solid = named(read(tmp_path, f'def {kind} "S" {{ {inputs} }}'))["/S"]
    assert volume(solid) == pytest.approx(expected, rel=2e-3)
    if solid.normals is not None:
        v, n = (
            np.asarray(a, float)[np.asarray(solid.faces)] for a in (solid.vertices, solid.normals)
        )
        across = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
        size = np.linalg.norm(across, axis=1)
        thick = size > 1e-9
        cosine = np.einsum("fi,fci->fc", across[thick] / size[thick, None], n[thick])
        assert cosine.min() > 0.99


# --- Cameras and lights --------------------------------------------------------------------------


def test_cameras(tmp_path: Path) -> None:
    body = f"""def Sphere "S" {{ }}
def Camera "C" {{ float focalLength = 50
 float horizontalAperture = 40
 float verticalAperture = 20
 float horizontalApertureOffset = 4
 float fStop = 2
 float focusDistance = 7
 {ops(translate="(0, 0, 5)", rotateY="90")} }}"""
    scene = read(tmp_path, body)
    c = scene.camera
    assert c.eye == (0, 0, 5)
    np.testing.assert_allclose(np.subtract(c.target, c.eye), [-5, 0, 0], atol=1e-9)
    assert c.vfov == pytest.approx(2 * np.degrees(np.arctan(0.2)))
    assert c.shift == pytest.approx((0.1, 0))
    assert c.aperture_radius == pytest.approx(50 / 10 / 2 / 2)
    assert c.focus_distance == 7
    assert (scene.settings.width, scene.settings.height) == (640, 320)
    flat = body.replace("float fStop", 'token projection = "orthographic"\nfloat fStop')
    assert read(tmp_path, flat).camera.height == pytest.approx(2)
    bare = read(tmp_path, 'def Sphere "S" {}', 'upAxis = "Z"')
    assert bare.camera.up == (0, 0, 1)
    assert bare.background.type == "gradient"


def test_lights_with_a_shape(tmp_path: Path) -> None:
    common = "float inputs:intensity = 3\nfloat inputs:exposure = 1\n"
    body = f"""
def SphereLight "S" {{ {common}bool inputs:normalize = 1
 float inputs:radius = 2 }}
def RectLight "R" {{ {common}float inputs:width = 2 }}
def DiskLight "D" {{ {common}bool inputs:normalize = 1 }}
def CylinderLight "C" {{ {common}float inputs:length = 4 }}
def Sphere "Thing" {{}}
"""
    scene = read(tmp_path, body)
    shapes = named(scene)

    def shine(name: str) -> Any:
        return np.array(shapes[name].material.params["emission"])

    np.testing.assert_allclose(shine("/S"), 6 / (16 * np.pi))
    np.testing.assert_allclose(shine("/R"), 6)
    np.testing.assert_allclose(shine("/D"), 6 / (np.pi * 0.25))
    np.testing.assert_allclose(np.ptp(shapes["/R"].vertices, axis=0), [2, 1, 0])
    v = np.asarray(shapes["/R"].vertices)[shapes["/R"].faces[0]]
    assert np.cross(v[1] - v[0], v[2] - v[0])[2] < 0
    assert np.cross(shapes["/D"].axis_u, shapes["/D"].axis_v)[0, 2] < 0
    np.testing.assert_allclose(shapes["/C"].ends, [[2, 0, 0]])
    assert scene.camera.shapes == ("/Thing",)
    assert scene.background is None


def test_lights_without_one(tmp_path: Path) -> None:
    body = f"""
def DistantLight "Sun" {{ float inputs:angle = 2
 float inputs:intensity = 10
 {ops(rotateX="-90")} }}
def DistantLight "Hard" {{ float inputs:angle = 0
 float inputs:intensity = 10 }}
def SphereLight "Spot" (prepend apiSchemas = ["ShapingAPI"]) {{
 float inputs:shaping:cone:angle = 30
 float inputs:shaping:cone:softness = 0.5
 bool inputs:normalize = 1
 float inputs:radius = 0
 float inputs:intensity = 8 }}
def DomeLight "Sky" {{ color3f inputs:color = (0.5, 0, 0) }}
def DomeLight "Off" {{ token visibility = "invisible" }}
def SphereLight "Warm" {{ bool inputs:enableColorTemperature = 1
 float inputs:colorTemperature = 3000 }}
"""
    scene = read(
        tmp_path,
        body.replace(
            '(prepend apiSchemas = ["ShapingAPI"])', '(\nprepend apiSchemas = ["ShapingAPI"]\n)'
        ),
    )
    sun, hard, spot = scene.lights
    share = np.pi * np.sin(np.radians(1)) ** 2
    np.testing.assert_allclose(sun.params["irradiance"], 10 * share)
    np.testing.assert_allclose(sun.params["direction"], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(hard.params["irradiance"], 10)
    assert spot.type == "spot"
    np.testing.assert_allclose(spot.params["intensity"], 2)
    assert (spot.params["cutoff_angle"], spot.params["beam_width"]) == (30, 15)
    assert scene.background.params["radiance"] == (0.5, 0, 0)
    warm = named(scene)["/Warm"].material.params["emission"]
    assert warm[0] > warm[1] > warm[2]


def test_a_dome_turns_with_its_pole(tmp_path: Path) -> None:
    picture(tmp_path)
    body = 'def DomeLight_1 "Sky" { asset inputs:texture:file = @p.png@ }\ndef Sphere "S" {}'
    turn = np.asarray(read(tmp_path, body, 'upAxis = "Z"').background.params["transform"])
    np.testing.assert_allclose(turn @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    turn = np.asarray(read(tmp_path, body).background.params["transform"])
    np.testing.assert_allclose(turn, np.eye(3))


# --- Composition and time ------------------------------------------------------------------------


def test_what_is_shown(tmp_path: Path) -> None:
    body = """
def Sphere "Shown" { token purpose = "render" }
def Sphere "Guide" { token purpose = "guide" }
def Xform "Proxy" { token purpose = "proxy"
 def Sphere "Inner" { } }
def Xform "Off" { token visibility = "invisible"
 def Sphere "Inner" { token visibility = "inherited" } }
over "Over" { def Sphere "Inner" { } }
class "Class" { def Sphere "Inner" { } }
def Volume "Smoke" { }
"""
    scene = read(tmp_path, body)
    assert {s.name for s in scene.shapes} == {"/Shown", "key light", "ground"}
    with pytest.raises(ph.FormatError, match="Volume prims, such as /Smoke: not supported"):
        read(tmp_path, body, strict=True)


def test_layers_variants_and_time(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    part = """def Xform "Part" (variants = {string size = "large"}
 prepend variantSets = "size") {
 variantSet "size" = {
  "large" { def Sphere "S" { double radius = 3 } }
  "small" { def Sphere "S" { double radius = 1 } } } }"""
    write(tmp_path / "parts", part.replace("(variants", "(\nvariants"), 'defaultPrim = "Part"')
    body = """def "A" (prepend payload = @./parts/a.usda@) {
 double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 10: (10, 0, 0) }
 uniform token[] xformOpOrder = ["xformOp:translate"] }
def "B" (prepend references = @./parts/a.usda@
 variants = {string size = "small"}) { }"""
    body = body.replace("(prepend", "(\nprepend")
    shapes = named(read(tmp_path, body, frame=5))
    assert shapes["/A/S"].radii == 3
    assert shapes["/B/S"].radii == 1
    np.testing.assert_allclose(shapes["/A/S"].centers, [[5, 0, 0]])
    shapes = named(read(tmp_path, body, frame=2.5))
    np.testing.assert_allclose(shapes["/A/S"].centers, [[2.5, 0, 0]])
    shapes = named(read(tmp_path, body, variant="size = small"))
    assert (shapes["/A/S"].radii, shapes["/B/S"].radii) == (1, 1)
    with pytest.raises(
        ph.FormatError, match=r"unknown variant 'size=tiny'.*size=large, size=small"
    ):
        read(tmp_path, body, variant="size=tiny")


# --- Refused -------------------------------------------------------------------------------------


def deep(count: int) -> str:
    return 'def Xform "a" {\n' * count + "}" * count


def bomb() -> str:
    """Ten copies of ten copies of ..."""
    places = ", ".join(f"({k}, 0, 0)" for k in range(10))
    text = 'over "P0" { def Sphere "S" { } }\n'
    for level in range(12):
        text += f"""over "P{level + 1}" {{ def PointInstancer "I" {{
 int[] protoIndices = {[0] * 10}
 point3f[] positions = [{places}]
 rel prototypes = </P{level}> }} }}\n"""
    return (
        text
        + """def PointInstancer "T" { int[] protoIndices = [0]
 point3f[] positions = [(0, 0, 0)]
 rel prototypes = </P12> }"""
    )


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (f'def Mesh "M" {{ {QUAD.replace("3]", "9]")} }}', "/M: face 0 refers to vertex 9"),
        (f'def Mesh "M" {{ {QUAD.replace("[4]", "[5]")} }}', "add up to 5; faceVertexIndices has"),
        (f'def Mesh "M" {{ {QUAD.replace("(1, 1, 0)", "(nan, 1, 0)")} }}', "points.2. is not fin"),
        (f'def Mesh "M" {{ {QUAD}int[] creaseIndices = [0, 9]\nint[] creaseLengths = [2]\n'
         "float[] creaseSharpnesses = [1] }", "creaseIndices refer to vertices beyond the 4"),
        (f'def Mesh "M" {{ {QUAD}uniform token subdivisionScheme = "loop" }}', "takes triangles"),
        (f'def Sphere "S" {{ {ops(translate="(nan, 0, 0)")} }}', "/S: its transform is not fin"),
        ('def Sphere "S" { double radius = -1 }', "/S: radius is -1; must be above 0"),
        ('def Points "P" { point3f[] points = [(0, 0, inf)] }', r"/P: points\[0\] is not finite"),
        ('def SphereLight "L" { float inputs:intensity = inf }', "inputs:intensity is inf"),
        ('def Camera "C" { float focalLength = 0 }', "/C: aperture .* focal length 0: not > 0"),
        ('def Camera "C" { typo focalLength = 0 }', "/C: has a value of another type"),
        ('def RenderSettings "R" { string resolution = "9" }', "/R: has a value of another type"),
        ('def "A" (\nreferences = </A>\n) { }', "Cycle detected"),
        ('def "A" (\nreferences = @/etc/hosts@\n) { }', "is not inside the scene's folder"),
        ('def "A" (\nreferences = @../x.usda@\n) { }', "is not inside the scene's folder"),
        ('def DomeLight "D" { asset inputs:texture:file = @/etc/hosts@ }', "/D: .* is not inside"),
        ('def DomeLight "D" { asset inputs:texture:file = @b.png@ }', r"/D: .*b\.png: cannot"),
        ('def PointInstancer "P" { int[] protoIndices = [1]\npoint3f[] positions = [(0, 0, 0)]\n'
         "rel prototypes = </P> }", r"protoIndices\[0\] is 1; there are 1 prototypes"),
        ('def PointInstancer "P" { int[] protoIndices = [0]\npoint3f[] positions = [(0, 0, 0)]\n'
         "rel prototypes = </P> }", "/P: is in its own prototype /P"),
        ('def PointInstancer "P" { int[] protoIndices = [0]\nfloat[] positions = [0]\n'
         "rel prototypes = </P> }", "/P: its instances have no places"),
        (bomb(), "has more than 4194304 instances"),
        (deep(20_000), "prims in prims, more than 2000 deep"),
        ("hello", "cannot be read as USD"),
    ],
)  # fmt: skip
def test_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str], body: str, words: str) -> None:
    path = write(tmp_path, body, 'renderSettingsPrimPath = "/R"')
    (tmp_path / "b.png").write_text("no picture")
    with pytest.raises(ph.FormatError, match=words) as error:
        load(path)
    assert str(error.value).startswith(str(path))
    assert str(error.value).count(str(path)) == 1
    assert capfd.readouterr().err == ""


def refer(names: list[tuple[str, list[str]]], more: str = "") -> str:
    """Prims, each with children that refer to others of these."""
    return "".join(
        f'def Xform "{name}"\n{{\n'
        + "".join(f'def "c{i}" ({more}references = </{t}>)\n{{\n}}\n' for i, t in enumerate(others))
        + "}\n"
        for name, others in names
    )


def test_stages_that_grow_without_end(tmp_path: Path) -> None:
    """The library would compose them for hours."""
    path = tmp_path / "a.usda"
    last = 'def Sphere "z"\n{\n}\n'
    tree = [(f"a{i}", [f"a{i + 1}"] * 4) for i in range(12)] + [("a12", ["z"])]
    path.write_text("#usda 1.0\n" + refer(tree) + last)
    with pytest.raises(ph.FormatError, match=r"/a\d stands for more than 2097152 prims"):
        ph.load(path)
    path.write_text("#usda 1.0\n" + refer([(f"a{i}", [f"a{i + 1}"]) for i in range(300)]) + last)
    with pytest.raises(
        ph.FormatError, match=r"a\.usda: /a\d+ refers to a prim .* more than 250 times"
    ):
        ph.load(path)
    # in two layers, the second named by the first
    (tmp_path / "b.usda").write_text("#usda 1.0\n" + refer(tree) + last)
    text = 'def "r" (references = @b.usda@</a0>)\n{\n}\n'
    path.write_text("#usda 1.0\n(subLayers = [@b.usda@])\n" + text)
    with pytest.raises(ph.FormatError, match="stands for more than 2097152 prims"):
        ph.load(path)
    # of instances, the first counts
    shallow = [(f"a{i}", [f"a{i + 1}"] * 4) for i in range(3)] + [("a3", ["z"])]
    path.write_text("#usda 1.0\n" + refer(shallow, "instanceable = true\n") + last)
    assert ph.load(path).shapes


def test_broken_files(tmp_path: Path) -> None:
    from pxr import Usd

    whole = tmp_path / "a.usdc"
    Usd.Stage.Open(str(write(tmp_path, f'def Mesh "M" {{ {BOX} }}'))).Export(str(whole))
    assert len(named(load(whole))["/M"].faces) == 12288
    data = whole.read_bytes()
    cut = tmp_path / "cut.usdc"
    for size in (0, 40, len(data) // 2, len(data) - 5):
        cut.write_bytes(data[:size])
        with pytest.raises(ph.FormatError, match="cannot be read as USD"):
            load(cut)
    lying = bytearray(data)
    contents = int.from_bytes(data[16:24], "little")
    tables = {data[contents + 8 + 32 * k :][:5]: contents + 24 + 32 * k for k in range(6)}
    specs = int.from_bytes(data[tables[b"SPECS"] :][:8], "little")
    lying[specs : specs + 8] = (1 << 40).to_bytes(8, "little")
    cut.write_bytes(lying)
    with pytest.raises(ph.FormatError, match=r"SPECS: [0-9]+ bytes cannot hold 1099511627776"):
        load(cut)
    # the kinds of specs come last; the library looks them up without asking
    size = int.from_bytes(data[tables[b"SPECS"] + 8 :][:8], "little")
    lying = bytearray(data)
    lying[specs + size - 1] ^= 0x40
    cut.write_bytes(lying)
    with pytest.raises(ph.FormatError, match=r"SPECS: spec [0-9]+ is of kind -?[0-9]+; must be 1"):
        load(cut)
    lying[specs + 17] = 0xFF  # more plain bytes than there are
    cut.write_bytes(lying)
    with pytest.raises(ph.FormatError, match=r"SPECS: its [0-9]+ specs cannot be unpacked"):
        load(cut)
    # ways that meet take the library time and memory without end
    paths, size = (int.from_bytes(data[tables[b"PATHS"] + k :][:8], "little") for k in (0, 8))
    said = set()
    for back in range(1, 12):
        lying = bytearray(data)
        lying[paths + size - back] ^= 0x03
        cut.write_bytes(lying)
        try:
            load(cut)
        except ph.FormatError as error:
            said.add(re.sub("[0-9]+", "N", str(error).partition("PATHS: ")[2]))
    assert "its N rows are no tree of N paths" in said
    for name in ("b.usdz", "b.usd"):
        (tmp_path / name).write_bytes(b"PK\x03\x04 no archive")
        with pytest.raises(ph.FormatError, match="cannot be read as USD"):
            load(tmp_path / name)


def test_lists_of_what_is_not_there(tmp_path: Path) -> None:
    """The library ends the process when a .usdc file lists a child that it does not have.

    The lists are numbers of tokens, uncompressed, between head and tables. One after the other
    becomes another.
    """
    from pxr import Sdf

    path = tmp_path / "a.usdc"
    body = (
        'def "A" (prepend variantSets = "look") {\nvariantSet "look" = {\n'
        '"a" {\ndef Sphere "S" {}\n}\n"b" {\ndef Cube "C" {}\n}\n}\n}\ndef Sphere "S" {}'
    )
    Sdf.Layer.FindOrOpen(str(write(tmp_path, body))).Export(str(path))
    data = path.read_bytes()
    contents = int.from_bytes(data[16:24], "little")
    tokens = int.from_bytes(data[contents + 24 :][:8], "little")
    told = set()
    for at in range(88, tokens):
        spoilt = bytearray(data)
        if not spoilt[at]:  # a byte that would make a number large
            continue
        spoilt[at] += 1
        path.write_bytes(spoilt)
        try:
            ph.load(path)
        except ph.FormatError as error:
            told.update(re.findall("its ([a-z ]*) [0-9]+ is listed, but is not there", str(error)))
    assert told == {"child", "variant set", "variant"}


def test_values_that_claim_more_than_there_is(tmp_path: Path) -> None:
    """The library makes room for them first: a GB for a few bytes here, tens of them for others."""
    from pxr import Sdf

    path = tmp_path / "a.usdc"
    body = (
        f'def Mesh "M" (prepend apiSchemas = ["MaterialBindingAPI"]) {{ {QUAD}\n'
        "point3f[] velocities.timeSamples = { 0: [(0, 0, 0)], 1: [(1, 0, 0)] } }\n"
        'def "N" (references = </M>) { }'
    )
    Sdf.Layer.FindOrOpen(str(write(tmp_path, body))).Export(str(path))
    assert ph.load(path).shapes
    data = path.read_bytes()
    contents = int.from_bytes(data[16:24], "little")
    tokens = int.from_bytes(data[contents + 24 :][:8], "little")
    told = set()
    for at in range(88, tokens - 8):
        spoilt = bytearray(data)
        if not 0 < int.from_bytes(data[at : at + 8], "little") < 64:
            continue
        spoilt[at + 3] = 4
        path.write_bytes(spoilt)
        try:
            ph.load(path)
        except ph.FormatError as error:
            told.update(re.findall("a value at byte ([0-9]+) claims 67[0-9]+ elements", str(error)))
    assert len(told) == 11  # lists of children, schemas, properties, arrays, times and samples


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    body = 'def Sphere "S" { }\ndef "A" (\nreferences = @./none.usda@\n) { }'
    assert "/S" in named(read(tmp_path, body))
    with pytest.raises(ph.FormatError, match=r"/A: './none.usda': no such file; left out"):
        read(tmp_path, body, strict=True)
    with pytest.raises(ph.FormatError, match=r"sublayer 'b.usda': no such file; left out"):
        read(tmp_path, body, "subLayers = [@b.usda@]", strict=True)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ('def SphereLight "L" { rel collection:lightLink:includes = [</S>] }',
         "light linking, such as that of /L: not supported"),
        ('def DistantLight "L" { uniform bool collection:lightLink:includeRoot = 0 }',
         "light linking, such as that of /L: not supported"),
        ('def RectLight "L" { rel collection:shadowLink:excludes = [</S>] }',
         "shadow linking, such as that of /L: not supported"),
        ('def Cube "C" ( prepend apiSchemas = ["MaterialBindingAPI"]\n)'
         " { rel material:binding = </nope> }", "/C: its material /nope is not there; ignored"),
        ('def Points "P" { point3f[] points = [(0, 0, 0), (1, 1, 1), (2, 2, 2)]\n'
         "float[] widths = [0.1, -1, 0] }", "/P: widths of 2 of 3 points are not above 0; left"),
        (f'def Mesh "M" {{ {BOX} uniform token triangleSubdivisionRule = "smooth" }}',
         "triangleSubdivisionRule 'smooth': not supported; triangles are subdivided as other"),
    ],
)  # fmt: skip
def test_told(tmp_path: Path, caplog: pytest.LogCaptureFixture, body: str, words: str) -> None:
    read(tmp_path, body + '\ndef Sphere "S" { }')
    assert sum(words in record.getMessage() for record in caplog.records) == 1


def test_what_changes_nothing_is_not_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A link to all there is, and a rule for triangles of a scheme that has no other."""
    read(
        tmp_path,
        'def SphereLight "L" { uniform bool collection:lightLink:includeRoot = 1 }'
        'def Mesh "M" { uniform token subdivisionScheme = "loop"\n'
        'uniform token triangleSubdivisionRule = "smooth"\nint[] faceVertexCounts = [3]\n'
        "int[] faceVertexIndices = [0, 1, 2]\npoint3f[] points = [(0,0,0), (1,0,0), (0,1,0)] }",
    )
    assert not [r for r in caplog.records if "link" in r.getMessage() or "Rule" in r.getMessage()]


def test_many_small_meshes_share_what_subdivision_makes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Five hundred cubes of 12,288 triangles each would be 6 million; 3072 each are enough."""
    scene = ph.load(write(tmp_path, "".join(f'def Mesh "M{i}" {{ {BOX} }}' for i in range(500))))
    assert {len(s.faces) for s in scene.shapes if s.name.startswith("/M")} == {3072}
    told = [r.getMessage() for r in caplog.records if "subdivi" in r.getMessage()]
    assert len(told) == 1
    assert "500 meshes are subdivided once less" in told[0]


@pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc", ".usdz"])
def test_files_that_are_none_of_usd(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(b"")
    with pytest.raises(ph.FormatError, match="cannot be read as USD: it is empty"):
        ph.load(path)
    path.write_bytes(bytes(range(200)))
    with pytest.raises(ph.FormatError, match=r"neither as text \(#usda\), nor as a crate"):
        ph.load(path)


def test_errors_name_the_layer_once(tmp_path: Path) -> None:
    outside = 'def "A" (\nreferences = @/etc/hosts@\n) { }'
    path = write(tmp_path, outside)
    with pytest.raises(ph.FormatError, match="is not inside") as error:
        ph.load(path)
    assert str(error.value).count("a.usda") == 1
    write(tmp_path, outside, name="b.usda")
    path = write(tmp_path, 'def "B" (\nreferences = @b.usda@</A>\n) { }', name="c.usda")
    with pytest.raises(ph.FormatError, match=r"c\.usda: b\.usda: '/etc/hosts'"):
        ph.load(path)


# --- Sequences -----------------------------------------------------------------------------------

RANGE = "startTimeCode = -2\nendTimeCode = 2\ntimeCodesPerSecond = 12\n"
MOVING = """
def Sphere "S" { double radius = 0.5
double3 xformOp:translate.timeSamples = { -2: (-2, 0, 0), 2: (2, 0, 0) }
uniform token[] xformOpOrder = ["xformOp:translate"] }
"""


@pytest.mark.parametrize(
    ("which", "times", "rate"),
    [
        ("all", [-2, -1, 0, 1, 2], 12),
        ("::2", [-2, 0, 2], 6),
        ("-1:1:0.5", [-1, -0.5, 0, 0.5], 24),
        ("::-4", [2, -2], 3),
    ],
)
def test_frames_are_time_codes(tmp_path: Path, which: str, times: Any, rate: float) -> None:
    path = write(tmp_path, MOVING, RANGE)
    frames = ph.load_frames(path, which)
    assert (frames.numbers, frames.fps) == (times, rate)
    for scene, time in zip(frames, times, strict=True):
        np.testing.assert_allclose(named(scene)["/S"].centers, [(time, 0, 0)])
        assert scene.camera == next(iter(frames)).camera
        assert scene.name == f"a.usda, frame {time:g}"
    assert ph.load_frames(path, which, fps=5).fps == 5


def test_frames_with_a_camera_and_light(tmp_path: Path) -> None:
    camera = """def Camera "C" {
double3 xformOp:translate.timeSamples = { 0: (0, 0, 5), 2: (0, 0, 9) }
uniform token[] xformOpOrder = ["xformOp:translate"] }
def DomeLight "D" { float inputs:intensity.timeSamples = { 0: 1, 2: 3 } }
"""
    scenes = list(ph.load_frames(write(tmp_path, MOVING + camera, RANGE), "0:3:2"))
    assert [scene.camera.eye[2] for scene in scenes] == [5, 9]
    first, second = (scene.background for scene in scenes)
    assert first is not None
    assert second is not None
    assert first != second
    assert [list(named(scene)) for scene in scenes] == [["/S"], ["/S"]]


def test_a_light_that_comes_later_is_no_reason_for_another(tmp_path: Path) -> None:
    lamp = """def SphereLight "L" {
token visibility.timeSamples = { -2: "invisible", 0: "inherited" } }
"""
    scenes = list(ph.load_frames(write(tmp_path, MOVING + lamp, RANGE), "::2"))
    assert [len(scene.shapes) for scene in scenes] == [1, 2, 2]
    assert {scene.background for scene in scenes} == {None}


def test_stages_that_do_not_say_their_range(tmp_path: Path) -> None:
    path = write(tmp_path, MOVING, RANGE)
    assert frames_in(path) == Extent("time codes", -2, 2, 12)
    path = write(tmp_path, MOVING)
    assert frames_in(path) is None
    with pytest.raises(ph.FormatError, match="its first and last time; frames needs both, as in"):
        ph.load_frames(path)
    assert ph.load_frames(path, "0:3").numbers == [0, 1, 2]
    with pytest.raises(ph.FormatError, match=r"a\.usda: no time codes are in 3:0"):
        ph.load_frames(path, "3:0")


# --- Scenes of others ----------------------------------------------------------------------------


def test_shared_scenes(shared_scenes: Path) -> None:
    folder = shared_scenes / "usd"
    pyramids = load(folder / "SubdivisionSurfaces/Creases_SpinningPyramids.usda", frame=10)
    assert [len(s.shapes[0].faces) for s in pyramids.shapes[:3]] == [12288] * 3
    roughness = load(folder / "RoughnessTest/RoughnessTest.usdz")
    assert len(roughness.shapes) == 8  # six, and the light and ground that are added
    blocks = ph.load(folder / "McUsd/McUsd.usda")
    assert len(blocks.shapes) == 23
    # 440 quads, as its own header says
    assert sum(len(s.faces) for s in blocks.shapes) == 880
    assert blocks.background.type == "envmap"
