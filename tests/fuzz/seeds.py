"""Good files of every format, small, with most of what the format has, made by a few lines each.

Where a library writes the format (gsd, OpenUSD, DracoPy, OpenImageIO) it does; where it is missing
there are no such seeds.
"""

from __future__ import annotations

import gzip
import io
import json
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from parhelion.image import encoded

from .harness import Case

POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.uint32)
UVS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)
PIXELS = np.arange(4 * 4 * 3, dtype=np.uint8).reshape(4, 4, 3) * 5
PNG = encoded(PIXELS, {}, ".png")


def one(name: str, data: bytes | str, **more: bytes) -> Case:
    """A case of one file, or of some more beside it, whose names have _ for the dot."""
    text = data.encode() if isinstance(data, str) else data
    others = {key.replace("_", "."): value for key, value in more.items()}
    return Case(name, {name: text, **others})


@contextmanager
def scratch(name: str) -> Iterator[Path]:
    """Where a library may write a file."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder) / name


# --- particles ------------------------------------------------------------------------------------


def xyz() -> list[Case]:
    plain = "3\nwater\nO 0 0 0.1\nH 0 0.76 -0.5\nH 0 -0.76 -0.5\n"
    extended = (
        '2\nLattice="4 0 0 0 5 0 1 0 6" Properties=species:S:1:pos:R:3:radius:R:1:color:R:3:id:I:1'
        ' pbc="T T F" energy=-1.5\nCu 0 0 0 0.7 1 0.5 0.2 1\nZn 1 2 3 0.9 0.1 0.5 1 2\n'
    )
    return [
        one("a.xyz", plain * 2),
        one("a.extxyz", extended),
        one("a.xyz.gz", gzip.compress(plain.encode(), 1)),
    ]


def lammps() -> list[Case]:
    head = "ITEM: TIMESTEP\n{0}\nITEM: NUMBER OF ATOMS\n3\n"
    orthogonal = "ITEM: BOX BOUNDS pp pp ff\n0 4\n0 5\n-1 6\n"
    tilted = "ITEM: BOX BOUNDS xy xz yz pp pp pp\n0 5 1\n0 5 0.5\n0 6 -0.25\n"
    plain = "ITEM: ATOMS id type x y z c_pe\n1 1 0 0 0 -1\n2 2 1 1 1 -2\n3 1 2 2 2 -3.5\n"
    scaled = "ITEM: ATOMS id element xs ys zs radius\n1 C 0 0 0 1\n2 O .5 .5 .5 1\n3 H 1 1 1 .5\n"
    return [
        one("a.dump", head.format(0) + orthogonal + plain + head.format(100) + orthogonal + plain),
        one("a.lammpstrj", head.format(5) + tilted + scaled),
    ]


def npz() -> list[Case]:
    cases = []
    arrays: dict[str, Any] = {
        "positions": POINTS.astype(float), "radii": np.full(4, 0.5), "colors": PIXELS[0, :4],
        "types": np.array(["A", "B", "A", "C"]), "box": np.eye(3) * 4, "origin": np.zeros(3),
        "energy": np.arange(4.0), "elements": np.array(["C", "O", "N", "H"]),
        "bonds": np.array([[0, 1], [2, 3]]), "periodic": np.array([True, False, True]),
    }  # fmt: skip
    bodies: dict[str, Any] = {
        "positions": POINTS, "shape": np.array(["ellipsoid", "box", "polyhedron", "sphere"]),
        "half_extents": np.full((4, 3), 0.25), "orientations": np.tile([0.8, 0, 0.6, 0], (4, 1)),
        "vertices": POINTS - 0.25, "rounding_radius": np.float64(0.1),
    }  # fmt: skip
    for save, kept in ((np.savez, arrays), (np.savez_compressed, arrays), (np.savez, bodies)):
        out = io.BytesIO()
        save(out, **kept)
        cases.append(one("a.npz", out.getvalue()))
    return cases


def pdb() -> list[Case]:
    lines = [
        "HEADER    TEST",
        "REMARK 350 BIOMOLECULE: 1",
        "REMARK 350 APPLY THE FOLLOWING TO CHAINS: A",
        "REMARK 350   BIOMT1   1  1.000000  0.000000  0.000000        0.00000",
        "REMARK 350   BIOMT2   1  0.000000  1.000000  0.000000        0.00000",
        "REMARK 350   BIOMT3   1  0.000000  0.000000  1.000000        0.00000",
        "REMARK 350   BIOMT1   2 -1.000000  0.000000  0.000000       10.00000",
        "REMARK 350   BIOMT2   2  0.000000 -1.000000  0.000000        0.00000",
        "REMARK 350   BIOMT3   2  0.000000  0.000000  1.000000        5.00000",
        "CRYST1   20.000   20.000   20.000  90.00  90.00  90.00 P 1           1",
    ]
    for number, name in enumerate(("N", "CA", "C", "O", "CB"), 1):
        lines.append(
            f"ATOM  {number:5d}  {name:<3s} ALA A   1    {number:8.3f}{2.5:8.3f}{-1.25:8.3f}"
            f"  1.00 20.00          {name[0]:>2s}"
        )
    water = "HETATM    6  O   HOH A   2       9.000   9.000   9.000  1.00 20.00           O"
    lines += [water, "TER", "CONECT    1    2    3", "ENDMDL", "END"]
    return [one("a.pdb", "\n".join(lines) + "\n")]


def gro() -> list[Case]:
    rows = ["    1WATER  OW1    1   0.126   1.624   1.679  0.1227 -0.0580  0.0434",
            "    1WATER  HW2    2   0.190   1.661   1.747  0.8085  0.3191 -0.7791",
            "    1WATER  HW3    3   0.177   1.568   1.613 -0.9045 -2.6469  1.3180"]  # fmt: skip
    return [
        one("a.gro", "\n".join(["water t= 0.0", "    3", *rows, "   1.8 1.8 1.8 0 0 .5 0 0 0", ""]))
    ]


def gsd() -> list[Case]:
    if not find_spec("gsd"):
        return []
    from gsd import hoomd

    corners = (POINTS - 0.25).tolist()
    with scratch("a.gsd") as path:
        with hoomd.open(str(path), "w") as file:
            for step in range(2):
                frame = hoomd.Frame()
                frame.configuration.step = step
                frame.configuration.box = [4, 5, 6, 0.1, 0, 0.2]
                frame.particles.N = 4
                frame.particles.position = POINTS + step
                frame.particles.types = ["A", "B"]
                frame.particles.typeid = [0, 1, 0, 1]
                frame.particles.diameter = [1, 2, 1, 0.5]
                frame.particles.velocity = POINTS
                frame.particles.orientation = np.tile([1.0, 0, 0, 0], (4, 1))
                frame.particles.type_shapes = [
                    {"type": "Ellipsoid", "a": 0.5, "b": 0.25, "c": 0.25},
                    {"type": "ConvexPolyhedron", "rounding_radius": 0, "vertices": corners},
                ]
                frame.bonds.N = 1
                frame.bonds.group = [[0, 1]]
                file.append(frame)
        return [one("a.gsd", path.read_bytes())]


# --- meshes ---------------------------------------------------------------------------------------


def ply_file(form: str = "binary_little_endian", extra: str = "") -> bytes:
    """A tetrahedron with normals, coordinates and colours."""
    head = (
        f"ply\nformat {form} 1.0\ncomment made\nelement vertex 4\n"
        + "".join(f"property float {n}\n" for n in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
        + "".join(f"property uchar {n}\n" for n in ("red", "green", "blue"))
        + f"element face 4\nproperty list uchar int vertex_indices\n{extra}end_header\n"
    ).encode()
    if form == "ascii":
        rows = [
            " ".join(map(str, [*p, 0, 0, 1, *t, 255, 128, 0]))
            for p, t in zip(POINTS, UVS, strict=True)
        ]
        rows += [f"3 {a} {b} {c}" for a, b, c in FACES]
        return head + "\n".join(rows).encode() + b"\n"
    order = "<" if "little" in form else ">"
    body = b"".join(
        struct.pack(order + "8f3B", *p, 0, 0, 1, *t, 255, 128, 0)
        for p, t in zip(POINTS, UVS, strict=True)
    )
    body += b"".join(struct.pack(order + "B3i", 3, *face) for face in FACES)
    return head + body


def ply() -> list[Case]:
    quads = (
        b"ply\nformat binary_big_endian 1.0\nelement vertex 4\nproperty double x\n"
        b"property double y\n"
        b"property double z\nproperty float heat\nelement face 2\nproperty list uint ushort "
        b"vertex_index\nproperty int material\nelement edge 1\nproperty int vertex1\nend_header\n"
        + struct.pack(
            ">dddfdddfdddfdddf", *(float(v) for v in np.append(POINTS, UVS[:, :1], 1).flat)
        )
        + struct.pack(">I4Hi", 4, 0, 1, 2, 3, 7)
        + struct.pack(">I3Hi", 3, 0, 1, 2, 7)
        + struct.pack(">i", 3)
    )
    return [
        one("a.ply", ply_file()),
        one("b.ply", ply_file("ascii")),
        one("c.ply", quads),
        one("d.ply.gz", gzip.compress(ply_file("binary_big_endian"), 1)),
        one("e.pbrt", 'WorldBegin\nLightSource "infinite"\n'
            'Shape "plymesh" "string filename" "a.ply"\n',
            a_ply=ply_file()),
    ]  # fmt: skip


def stl() -> list[Case]:
    text = "solid cube\n"
    body = b""
    for face in FACES:
        corners = POINTS[face]
        text += "facet normal 0 0 1\nouter loop\n"
        text += "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
        text += "endloop\nendfacet\n"
        body += struct.pack("<3f", 0, 0, 1) + corners.tobytes() + b"\0\0"
    binary = b"made".ljust(80, b"\0") + struct.pack("<I", len(FACES)) + body
    return [one("a.stl", binary), one("b.stl", text + "endsolid cube\n")]


def off() -> list[Case]:
    plain = "OFF\n4 4 6\n" + "".join(f"{x} {y} {z}\n" for x, y, z in POINTS)
    plain += "".join(f"3 {a} {b} {c} 255 0 {a * 50}\n" for a, b, c in FACES)
    coloured = "COFF # colours\n4 1 0\n" + "".join(f"{x} {y} {z} 1 .5 0 1\n" for x, y, z in POINTS)
    return [one("a.off", plain), one("b.off", coloured + "4 0 1 2 3\n")]


def obj() -> list[Case]:
    text = (
        "mtllib a.mtl\no tetra\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS)
        + "".join(f"vt {u} {v}\n" for u, v in UVS) + "vn 0 0 1\nvn 0 1 0\ng one\nusemtl red\ns 1\n"
        "f 1/1/1 3/3/1 2/2/1\nf 1//2 2//2 4//2\nusemtl shiny # comment\n"
        "f 2 3 4\nf -4 -1 -3 -2\nl 1 2\n"
    )  # fmt: skip
    mtl = (
        "newmtl red\nKd 0.8 0.1 0.1\nKs 0.5 0.5 0.5\nNs 100\nNi 1.5\nd 0.75\nillum 2\n"
        "map_Kd -s 2 2 1 -o 0.5 0 0 a.png\nbump -bm 0.5 a.png\nmap_d a.png\n"
        "newmtl shiny\nKd 0.5 0.5 0.5\nPr 0.3\nPm 1\nPc 0.5\nPcr 0.1\nKe 0.1 0 0\naniso 0.5\n"
        "Tf 1 1 1\nnorm a.png\nmap_Pr a.png\nmap_Ke a.png\n"
    )
    coloured = "".join(f"v {x} {y} {z} 1 0.5 0\n" for x, y, z in POINTS) + "f 1 2 3 4\n"
    return [one("a.obj", text, a_mtl=mtl.encode(), a_png=PNG), one("b.obj", coloured)]


def serialized_file(version: int = 4) -> bytes:
    """Two meshes, single and double precision, with normals, coordinates and colours."""
    data, offsets = b"", []
    for flags, kind in ((0x1 | 0x2 | 0x8 | 0x1000, "<f4"), (0x2 | 0x2000, "<f8")):
        offsets.append(len(data))
        body = struct.pack("<I", flags) + (b"name\0" if version == 4 else b"")
        body += struct.pack("<QQ", 4, 4) + POINTS.astype(kind).tobytes()
        if flags & 0x1:
            body += np.tile([0, 0, 1], (4, 1)).astype(kind).tobytes()
        body += UVS.astype(kind).tobytes()
        if flags & 0x8:
            body += np.full((4, 3), 0.5).astype(kind).tobytes()
        data += struct.pack("<HH", 0x041C, version) + zlib.compress(body + FACES.tobytes())
    form = "<Q" if version == 4 else "<I"
    return data + b"".join(struct.pack(form, o) for o in offsets) + struct.pack("<I", 2)


def serialized() -> list[Case]:
    scene = (
        '<scene version="3.0.0"><shape type="serialized">'
        '<string name="filename" value="a.serialized"/>'
        '<integer name="shape_index" value="{}"/></shape><emitter type="constant"/></scene>'
    )
    return [
        Case("a.xml", {"a.xml": scene.format(i).encode(), "a.serialized": serialized_file(v)},
             ("a.serialized",))
        for i, v in ((0, 4), (1, 4), (1, 3))
    ]  # fmt: skip


# --- scenes ---------------------------------------------------------------------------------------


def json_scene() -> list[Case]:
    document = {
        "parhelion": 1, "name": "seed",
        "camera": {"eye": [0, 1, 6], "target": [0, 0, 0], "up": [0, 1, 0], "vfov": 30,
                   "aperture_radius": 0.1, "focus_distance": 5},
        "background": {"type": "gradient", "horizon": [1, 1, 1], "zenith": [0.3, 0.5, 1]},
        "settings": {"width": 16, "height": 8, "spp": 1, "max_depth": 4},
        "materials": {"a": {"type": "diffuse", "color": {"type": "image", "image": "a.png"}},
                      "glass": {"type": "dielectric"},
                      "b": {"type": "metal", "fuzz": 0.1, "color": {
                          "type": "checker", "color0": [0, 0, 0], "color1": [1, 1, 1]}},
                      "p": {"type": "principled", "roughness": 0.4, "metallic": 0.5},
                      "lamp": {"type": "emissive", "radiance": [4, 4, 4]}},
        "shapes": [
            {"type": "spheres", "name": "s", "centers": [[0, 0, 0], [1, 1, 1]], "radii": [0.5, 0.2],
             "colors": [[1, 0, 0], [0, 1, 0]], "material": "a"},
            {"type": "spheres", "name": "n", "centers": "a.npy", "radii": 0.1, "material": "glass"},
            {"type": "mesh", "name": "m", "vertices": POINTS.tolist(), "faces": FACES.tolist(),
             "uvs": UVS.tolist(), "material": "a"},
            {"type": "mesh", "name": "f", "file": "a.ply", "material": "p"},
            {"type": "disks", "name": "d", "centers": [[0, 2, 0]], "axis_u": [[1, 0, 0]],
             "axis_v": [[0, 0, 1]],
             "material": "lamp"},
            {"type": "cylinders", "name": "c", "starts": [[0, 0, 0]], "ends": [[1, 1, 0]],
             "radii": 0.1, "material": "b"},
        ],
    }  # fmt: skip
    array = io.BytesIO()
    np.save(array, POINTS)
    return [
        one("a.json", json.dumps(document), a_npy=array.getvalue(), a_png=PNG, a_ply=ply_file())
    ]


def mitsuba() -> list[Case]:
    text = """<?xml version="1.0"?><scene version="3.0.0"><default name="spp" value="4"/>
<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
<lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform><film type="hdrfilm">
<integer name="width" value="16"/><integer name="height" value="8"/><rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler></sensor>
<bsdf type="twosided" id="wood"><bsdf type="roughplastic"><texture type="bitmap"
name="diffuse_reflectance">
<string name="filename" value="a.png"/><transform name="to_uv">
<scale x="2" y="2"/></transform></texture>
<float name="alpha" value="0.2"/></bsdf></bsdf><bsdf type="dielectric" id="glass">
<string name="int_ior" value="bk7"/></bsdf><bsdf type="roughconductor" id="metal">
<string name="material" value="Au"/></bsdf>
<shape type="sphere"><point name="center" x="1" y="0" z="0"/><float name="radius" value="0.5"/>
<ref id="glass"/></shape><shape type="cube"><transform name="to_world"><rotate y="1" angle="30"/>
<translate x="-1"/></transform><ref id="wood"/></shape><shape type="obj"><string name="filename"
value="a.obj"/><ref id="metal"/></shape><shape type="ply"><string name="filename" value="a.ply"/>
<boolean name="face_normals" value="true"/><bsdf type="diffuse">
<rgb name="reflectance" value="0.2, 0.5, 0.7"/>
</bsdf></shape><shape type="shapegroup" id="group"><shape type="rectangle"/></shape>
<shape type="instance"><ref id="group"/><transform name="to_world"><matrix
value="1 0 0 0 0 1 0 2 0 0 1 0 0 0 0 1"/></transform></shape><shape type="rectangle">
<emitter type="area">
<rgb name="radiance" value="4"/>
</emitter></shape><shape type="disk"/><shape type="cylinder"/>
<emitter type="envmap"><string name="filename" value="a.png"/></emitter>
<emitter type="point"><point name="position" x="0" y="4" z="0"/>
<spectrum name="intensity" value="400:1, 700:2"/>
</emitter><include filename="b.xml"/></scene>"""
    included = '<scene version="3.0.0"><bsdf type="mask" id="m"><float name="opacity" value="0.5"/>'
    included += '<bsdf type="diffuse"/></bsdf></scene>'
    mesh = obj()[1].files["b.obj"]
    return [one("a.xml", text, b_xml=included.encode(), a_png=PNG, a_obj=mesh, a_ply=ply_file())]


def pbrt() -> list[Case]:
    four = """Option "string renderingspace" "world"
LookAt 0 1 6  0 0 0  0 1 0
Camera "perspective" "float fov" 40 "float lensradius" [ 0.1 ] "float focaldistance" 5
Film "rgb" "integer xresolution" 16 "integer yresolution" 8 "string filename" "a.exr"
Sampler "halton" "integer pixelsamples" 4
Integrator "volpath" "integer maxdepth" 4
PixelFilter "gaussian" "float xradius" 1.5
Scale -1 1 1
WorldBegin
LightSource "infinite" "string filename" "a.png" "float scale" 0.5
LightSource "distant" "point3 from" [ 0 4 0 ] "blackbody L" 5000
AttributeBegin
  AreaLightSource "diffuse" "rgb L" [ 4 4 4 ] "bool twosided" true
  Translate 0 2 0 Rotate 90 1 0 0
  Shape "disk" "float radius" 0.5
AttributeEnd
Texture "checks" "spectrum" "checkerboard" "float uscale" 4 "rgb tex1" [ 1 0 0 ]
  "rgb tex2" [ 0 0 1 ]
Texture "picture" "spectrum" "imagemap" "string filename" "a.png" "string wrap" "clamp"
Texture "mixed" "float" "scale" "float tex" 0.5 "float scale" 0.2
MakeNamedMaterial "metal" "string type" "conductor" "spectrum eta" "metal-Cu-eta"
  "spectrum k" "metal-Cu-k" "float roughness" 0.1
MakeNamedMaterial "mixed" "string type" "mix" "string materials" [ "metal" "glass" ]
  "float amount" 0.3
MakeNamedMaterial "glass" "string type" "dielectric" "float eta" 1.5
Material "coateddiffuse" "texture reflectance" "checks" "texture roughness" "mixed"
Shape "sphere" "float radius" 0.5 "float zmin" -0.3 "float phimax" 270
Attribute "shape" "float radius" 0.2
NamedMaterial "mixed"
Shape "trianglemesh" "integer indices" [ 0 1 2 0 2 3 ] "point3 P" [ 0 0 0 1 0 0 1 1 0 0 1 0 ]
  "point2 uv" [ 0 0 1 0 1 1 0 1 ] "normal N" [ 0 0 1 0 0 1 0 0 1 0 0 1 ]
Shape "plymesh" "string filename" "a.ply"
Shape "loopsubdiv" "integer levels" 2 "integer indices" [ 0 1 2 0 2 3 0 3 1 1 3 2 ]
  "point3 P" [ 0 0 0 1 0 0 0 1 0 0 0 1 ]
Shape "curve" "point3 P" [ 0 0 0 1 0 0 1 1 0 0 1 0 ] "float width0" 0.1
  "float width1" 0.02 "string type" "cylinder"
Shape "bilinearmesh" "point3 P" [ 0 0 0 1 0 0 0 1 0 1 1 1 ] "integer indices" [ 0 1 2 3 ]
ObjectBegin "thing"
  Material "diffuse" "texture reflectance" "picture"
  Shape "cylinder" "float radius" 0.2
ObjectEnd
TransformBegin CoordinateSystem "here" ConcatTransform [ 1 0 0 0 0 1 0 0 0 0 1 0 2 0 0 1 ]
ObjectInstance "thing" CoordSysTransform "here" TransformEnd
ObjectInstance "thing"
Include "b.pbrt"
"""
    three = """LookAt 0 1 6  0 0 0  0 1 0
Camera "perspective" "float fov" [ 40 ]
Film "image" "integer xresolution" [ 16 ] "integer yresolution" [ 8 ]
WorldBegin
LightSource "point" "rgb I" [ 4 4 4 ] "point from" [ 0 4 0 ]
MakeNamedMaterial "u" "string type" "uber" "rgb Kd" [ 0.5 0.5 0.5 ] "rgb opacity" [ 0.5 0.5 0.5 ]
Texture "t" "color" "imagemap" "string filename" "a.png"
AttributeBegin NamedMaterial "u" Shape "paraboloid" AttributeEnd
Material "matte" "texture Kd" "t" Shape "hyperboloid"
Material "metal" "float roughness" 0.01 Shape "cone"
Material "plastic" Shape "heightfield" "integer nu" 2 "integer nv" 2 "float Pz" [ 0 1 1 0 ]
WorldEnd
"""
    included = 'AttributeBegin\nMaterial "thindielectric"\nShape "sphere"\nAttributeEnd\n'
    return [
        one("a.pbrt", four, b_pbrt=included.encode(), a_png=PNG, a_ply=ply_file()),
        one("c.pbrt", three, a_png=PNG),
    ]


def usd() -> list[Case]:
    text = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Z"
    timeCodesPerSecond = 24
)
def Xform "World" (
    variants = { string look = "a" }
    prepend variantSets = "look"
)
{
    double3 xformOp:translate.timeSamples = { 0: (0, 0, 0), 10: (1, 2, 3) }
    float xformOp:rotateZ = 30
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
    variantSet "look" = {
        "a" {
            def Sphere "S" {
                double radius = 0.5
            }
        }
        "b" {
            def Cube "C" {
                double size = 1
            }
        }
    }
    def Mesh "M" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        normal3f[] normals = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "faceVarying")
        int[] primvars:st:indices = [0, 1, 2, 3]
        color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = "constant")
        uniform token subdivisionScheme = "catmullClark"
        int[] creaseIndices = [0, 1]
        int[] creaseLengths = [2]
        float[] creaseSharpnesses = [2]
        rel material:binding = </World/Look>
    }
    def Points "P" {
        point3f[] points = [(0, 0, 1)]
        float[] widths = [0.2]
    }
    def BasisCurves "B" {
        int[] curveVertexCounts = [4]
        point3f[] points = [(0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 2)]
        float[] widths = [0.1] (interpolation = "constant")
        uniform token type = "cubic"
        uniform token basis = "bspline"
    }
    def PointInstancer "I" {
        rel prototypes = [</World/I/A>]
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 2), (0, 0, 3)]
        quath[] orientations = [(1, 0, 0, 0), (0, 1, 0, 0)]
        float3[] scales = [(1, 1, 1), (2, 2, 2)]
        def Cone "A" {
            double height = 1
        }
    }
    def Camera "Cam" {
        float focalLength = 35
        double3 xformOp:translate = (0, -8, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def DomeLight "Dome" {
        asset inputs:texture:file = @a.png@
        float inputs:intensity = 0.5
    }
    def RectLight "Rect" {
        float inputs:width = 2
        float inputs:height = 2
    }
    def SphereLight "Bulb" {
        float inputs:radius = 0.1
        color3f inputs:color = (1, 0.5, 0.2)
    }
    def Material "Look" {
        token outputs:surface.connect = </World/Look/S.outputs:surface>
        def Shader "S" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Look/T.outputs:rgb>
            float inputs:roughness = 0.3
            float inputs:metallic = 0.1
            float inputs:opacity = 0.9
            token outputs:surface
        }
        def Shader "T" {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @a.png@
            float2 inputs:st.connect = </World/Look/R.outputs:result>
            token inputs:wrapS = "repeat"
            float3 outputs:rgb
        }
        def Shader "R" {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }
    }
    def "Other" (prepend references = @b.usda@</Thing>) { }
}
"""
    other = '#usda 1.0\ndef Xform "Thing" {\n def Cylinder "C" {\n double radius = 0.2\n }\n}\n'
    cases = [one("a.usda", text, b_usda=other.encode(), a_png=PNG)]
    if not find_spec("pxr"):
        return []
    from pxr import Sdf, UsdUtils

    with scratch("a.usda") as path:
        for name, data in cases[0].files.items():
            (path.parent / name).write_bytes(data)
        binary = path.with_suffix(".usdc")
        Sdf.Layer.FindOrOpen(str(path)).Export(str(binary))
        flat = binary.read_bytes()
        packed = path.with_suffix(".usdz")
        if UsdUtils.CreateNewUsdzPackage(str(path), str(packed)):
            cases.append(one("a.usdz", packed.read_bytes()))
        cases.append(one("a.usdc", flat, b_usda=other.encode(), a_png=PNG))
    return cases


class Document:
    """A glTF file in the making: JSON, and one buffer that arrays are added to."""

    def __init__(self) -> None:
        self.binary = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "bufferViews": [],
            "accessors": [],
        }

    def view(self, data: bytes, **fields: Any) -> int:
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **fields}
        self.binary += data
        self.json["bufferViews"].append(view)
        return len(self.json["bufferViews"]) - 1

    def array(self, values: Any, **fields: Any) -> int:
        array = np.asarray(values)
        code = {"|u1": 5121, "<u2": 5123, "<u4": 5125, "<f4": 5126}[array.dtype.str]
        width = array.shape[1] if array.ndim == 2 else 1
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[width]
        self.json["accessors"].append(
            {"bufferView": self.view(array.tobytes()), "componentType": code, "type": kind,
             "count": len(array), **fields}
        )  # fmt: skip
        return len(self.json["accessors"]) - 1

    def separate(self) -> Case:
        """A .gltf with its buffer in a file beside it."""
        self.json["buffers"] = [{"byteLength": len(self.binary), "uri": "a.bin"}]
        return one("a.gltf", json.dumps(self.json), a_bin=self.binary)

    def glb(self) -> Case:
        self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + bytes(-len(self.binary) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text
        body += struct.pack("<II", len(binary), 0x004E4942) + binary
        return one("a.glb", struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def gltf_document() -> Document:
    """Most of what glTF has, in one document."""
    d = Document()
    attributes = {
        "POSITION": d.array(POINTS), "NORMAL": d.array(np.tile(np.float32([0, 0, 1]), (4, 1))),
        "TANGENT": d.array(np.tile(np.float32([1, 0, 0, -1]), (4, 1))),
        "TEXCOORD_0": d.array(UVS),
        "COLOR_0": d.array(np.full((4, 4), 200, np.uint8), normalized=True),
        "JOINTS_0": d.array(np.zeros((4, 4), np.uint8)),
        "WEIGHTS_0": d.array(np.tile(np.float32([1, 0, 0, 0]), (4, 1))),
    }  # fmt: skip
    indices = d.array(FACES.reshape(-1).astype(np.uint16))
    half = d.array(POINTS * np.float32(0.5))
    target = {"POSITION": half, "TANGENT": half}
    sparse = d.array(POINTS)
    d.json["accessors"][sparse]["sparse"] = {
        "count": 1, "indices": {"bufferView": d.view(b"\1\0"), "componentType": 5123},
        "values": {"bufferView": d.view(np.float32([2, 0, 0]).tobytes())},
    }  # fmt: skip
    d.json["images"] = [{"bufferView": d.view(PNG), "mimeType": "image/png"}]
    d.json["samplers"] = [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 10497}]
    d.json["textures"] = [{"source": 0, "sampler": 0}]
    moved = {"KHR_texture_transform": {"offset": [0.1, 0], "scale": [2, 2], "rotation": 0.5}}
    info = {"index": 0, "extensions": moved}
    d.json["materials"] = [
        {"pbrMetallicRoughness": {"baseColorTexture": info,
                                  "metallicRoughnessTexture": {"index": 0},
                                  "baseColorFactor": [1, 0.5, 0.5, 1], "metallicFactor": 0.5},
         "normalTexture": {"index": 0, "scale": 0.5}, "emissiveTexture": {"index": 0},
         "emissiveFactor": [0.1, 0.1, 0.1], "alphaMode": "MASK", "alphaCutoff": 0.4,
         "doubleSided": True,
         "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5},
                        "KHR_materials_sheen": {"sheenColorFactor": [1, 0, 0]},
                        "KHR_materials_specular": {"specularFactor": 0.5},
                        "KHR_materials_iridescence": {"iridescenceFactor": 1},
                        "KHR_materials_anisotropy": {"anisotropyStrength": 0.5},
                        "KHR_materials_emissive_strength": {"emissiveStrength": 5}}},
        {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1},
                        "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationDistance": 1},
                        "KHR_materials_ior": {"ior": 1.4},
                        "KHR_materials_dispersion": {"dispersion": 1}}},
        {"pbrMetallicRoughness": {"metallicFactor": 0.5},
         "extensions": {"KHR_materials_diffuse_transmission": {
             "diffuseTransmissionFactor": 0.5, "diffuseTransmissionTexture": {"index": 0},
             "diffuseTransmissionColorTexture": {"index": 0}}}},
        {"extensions": {"KHR_materials_unlit": {}}},
        {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"glossinessFactor": 0.3}}},
    ]  # fmt: skip
    d.json["meshes"] = [
        {"primitives": [{"attributes": attributes, "indices": indices, "material": 0,
                         "targets": [target]}], "weights": [0.5]},
        {"primitives": [{"attributes": {"POSITION": sparse}, "material": 1, "mode": 5},
                        {"attributes": {"POSITION": sparse}, "mode": 0},
                        {"attributes": {"POSITION": sparse}, "mode": 3, "extensions": {
                            "KHR_materials_variants": {
                                "mappings": [{"material": 2, "variants": [0]}]}}}]},
    ]  # fmt: skip
    d.json["skins"] = [
        {"joints": [1], "inverseBindMatrices": d.array(np.eye(4, dtype=np.float32).reshape(1, 16))}
    ]
    times, moves = d.array(np.float32([0, 1])), d.array(POINTS[:2])
    d.json["animations"] = [
        {
            "samplers": [{"input": times, "output": moves}],
            "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
        }
    ]
    d.json["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.1}}]
    d.json["nodes"] = [
        {"mesh": 0, "skin": 0, "children": [1]},
        {"mesh": 1, "translation": [1, 0, 0], "rotation": [0, 0.6, 0, 0.8], "scale": [1, 2, 1]},
        {"camera": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 6, 1]},
        {"extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"mesh": 1, "extensions": {"EXT_mesh_gpu_instancing": {
            "attributes": {"TRANSLATION": d.array(POINTS), "SCALE": d.array(POINTS + 1)}}}},
    ]  # fmt: skip
    d.json["scenes"], d.json["scene"] = [{"nodes": [0, 2, 3, 4]}], 0
    d.json["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [{"type": "spot", "intensity": 9, "spot": {"outerConeAngle": 0.5}}]},
        "KHR_materials_variants": {"variants": [{"name": "a"}]},
    }  # fmt: skip
    d.json["extensionsUsed"] = [
        "KHR_lights_punctual",
        "KHR_materials_variants",
        "EXT_mesh_gpu_instancing",
    ]
    return d


def gltf_draco() -> list[Case]:
    if not find_spec("DracoPy"):
        return []
    import DracoPy

    d = Document()
    packed = {"bufferView": d.view(DracoPy.encode(POINTS, FACES, quantization_bits=14)),
              "attributes": {"POSITION": 0}}  # fmt: skip
    d.json["accessors"] = [{"componentType": 5126, "count": 4, "type": "VEC3"},
                           {"componentType": 5123, "count": 12, "type": "SCALAR"}]  # fmt: skip
    d.json["meshes"] = [
        {
            "primitives": [
                {
                    "attributes": {"POSITION": 0},
                    "indices": 1,
                    "extensions": {"KHR_draco_mesh_compression": packed},
                }
            ]
        }
    ]
    d.json |= {"nodes": [{"mesh": 0}], "extensionsRequired": ["KHR_draco_mesh_compression"]}
    return [d.separate(), d.glb()]


def gltf_meshopt() -> list[Case]:
    """Blocks of EXT_meshopt_compression that hold nothing but zeros, in the three modes."""
    d = Document()
    d.json["accessors"] = [
        {"bufferView": 0, "componentType": 5126, "count": 16, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
    ]
    zeros = b"\xa0" + bytes(12) + bytes(32)  # no block has bytes of its own
    triangles = b"\xe1" + b"\xf0\x00" + bytes(16)
    sequence = b"\xd1" + bytes(6) + bytes(4)
    for data, stride, count, mode in (
        (zeros, 12, 16, "ATTRIBUTES"), (triangles, 2, 6, "TRIANGLES"), (sequence, 2, 6, "INDICES"),
    ):  # fmt: skip
        d.view(data)
        view = d.json["bufferViews"][-1]
        packed = dict(view) | {"byteStride": stride, "count": count, "mode": mode}
        view |= {"buffer": 1, "byteOffset": 0, "byteLength": stride * count,
                 "extensions": {"EXT_meshopt_compression": packed}}  # fmt: skip
    d.json["meshes"] = [
        {"primitives": [{"attributes": {"POSITION": 0}, "indices": i} for i in (1, 2)]}
    ]
    d.json |= {"nodes": [{"mesh": 0}], "extensionsUsed": ["EXT_meshopt_compression"]}
    case = d.separate()
    d.json["buffers"].append(
        {"byteLength": 192, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
    )
    return [one("a.gltf", json.dumps(d.json), a_bin=case.files["a.bin"])]


def gltf() -> list[Case]:
    d = gltf_document()
    return [d.separate(), d.glb(), *gltf_draco(), *gltf_meshopt()]


def images() -> list[Case]:
    """Pictures as textures and around the scene."""
    import OpenImageIO as oiio

    scene = {
        "parhelion": 1, "background": {"type": "envmap", "image": "NAME"},
        "materials": {"a": {"type": "diffuse", "color": {"type": "image", "image": "NAME"}}},
        "shapes": [{"type": "spheres", "centers": [[0, 0, 0]], "radii": 1, "material": "a"}],
    }  # fmt: skip
    cases = []
    for ending in ("png", "jpg", "exr", "hdr", "tga", "tif", "bmp", "pfm", "ppm", "gif", "webp"):
        with scratch(f"a.{ending}") as path:
            buffer = oiio.ImageBuf(np.tile(PIXELS, (8, 8, 1)).astype(np.float32) / 255)
            if not buffer.write(str(path), "float" if ending in ("exr", "hdr", "pfm") else "uint8"):
                continue
            name = path.name
            text = json.dumps(scene).replace("NAME", name).encode()
            cases.append(Case("a.json", {"a.json": text, name: path.read_bytes()}, (name,)))
    return cases


# reader -> endings of its files elsewhere, and its seeds
READERS: dict[str, tuple[tuple[str, ...], Callable[[], list[Case]]]] = {
    "json": ((".json",), json_scene),
    "gltf": ((".gltf", ".glb"), gltf),
    "pbrt": ((".pbrt", ".pbrt.gz"), pbrt),
    "usd": ((".usd", ".usda", ".usdc", ".usdz"), usd),
    "mitsuba": ((".xml",), mitsuba),
    "serialized": ((), serialized),
    "obj": ((".obj", ".obj.gz"), obj),
    "ply": ((".ply", ".ply.gz"), ply),
    "stl": ((".stl",), stl),
    "off": ((".off",), off),
    "xyz": ((".xyz", ".extxyz", ".xyz.gz"), xyz),
    "lammps": ((".dump", ".lammpstrj", ".dump.gz"), lammps),
    "npz": ((".npz",), npz),
    "gsd": ((".gsd",), gsd),
    "pdb": ((".pdb",), pdb),
    "gro": ((".gro",), gro),
    "images": ((), images),
}

_PARTICLES: tuple[dict[str, Any], ...] = (
    {}, {}, {"style": "ball-and-stick", "box": True, "wrap": True}, {"style": "licorice"},
    {"bond_length": 1.5, "style": "ball-and-stick"}, {"frame": -1}, {"radius": "covalent"},
    {"color_by": "energy"}, {"color_by": "mass", "color_range": (0.0, 1.0)}, {"wrap": True},
)  # fmt: skip
# reader -> options with which its files are loaded, one after the other's turn by chance
OPTIONS: dict[str, tuple[dict[str, Any], ...]] = {
    **dict.fromkeys(("xyz", "lammps", "npz", "gsd", "gro"), _PARTICLES),
    "pdb": (*_PARTICLES, {"assembly": 1}, {"assembly": 1, "style": "licorice"}),
    "gltf": ({}, {}, {"time": 0.5}, {"variant": "a"}),
    "usd": ({}, {}, {"frame": 5}),
    "obj": ({}, {"up": "-z"}),
    "ply": ({}, {}, {"color_by": "heat"}),
}
