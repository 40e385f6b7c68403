"""One model as glTF, OBJ, USD and PLY gives one picture.

A torus with normals and texture coordinates, half of it painted with an image, half of it metal.
Its numbers are written so that none is rounded: coordinates of single precision with the digits of
double precision, which OBJ is read in, and texture coordinates in steps of 1/16, for glTF has
1 - v. What the readers make of them is the same, and so is the picture, to the last bit.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.image import encoded
from test_save import picture, torus

TORUS = torus(32, 16)
HALF = len(np.asarray(TORUS.faces)) // 2
PIXELS = np.random.default_rng(3).integers(0, 256, (8, 8, 3), np.uint8)


def numbers(values: Any) -> list[list[str]]:
    """As text, in as many digits as double precision needs."""
    return [[str(float(x)) for x in row] for row in np.asarray(values)]


def lines(start: str, rows: list[list[str]]) -> str:
    return "".join(f"{start} {' '.join(row)}\n" for row in rows)


def gltf(folder: Path) -> Path:
    image = ph.Texture("image", image=str(folder / "paint.png"))
    materials = {
        "painted": ph.Material("principled", color=image, roughness=0.5),
        "gold": ph.Material("principled", color=(0.75, 0.5, 0.25), metallic=1.0, roughness=0.25),
    }
    ph.save(ph.Scene([TORUS], materials, background=None), folder / "torus.glb", strict=True)
    return folder / "torus.glb"


def obj(folder: Path) -> Path:
    corners = np.asarray(TORUS.faces) + 1
    faces = [[f"{i}/{i}/{i}" for i in face] for face in corners.tolist()]
    (folder / "torus.mtl").write_text(
        "newmtl painted\nmap_Kd paint.png\nKd 1 1 1\nPr 0.5\nPm 0\n"
        "newmtl gold\nKd 0.75 0.5 0.25\nPr 0.25\nPm 1\n"
    )
    (folder / "torus.obj").write_text(
        "mtllib torus.mtl\n"
        + lines("v", numbers(TORUS.vertices))
        + lines("vt", numbers(TORUS.uvs))
        + lines("vn", numbers(TORUS.normals))
        + "usemtl painted\n"
        + lines("f", faces[:HALF])
        + "usemtl gold\n"
        + lines("f", faces[HALF:])
    )
    return folder / "torus.obj"


def usd(folder: Path) -> Path:
    pytest.importorskip("pxr")

    def tuples(values: Any) -> str:
        return ", ".join(f"({', '.join(row)})" for row in numbers(values))

    def subset(name: str, first: int, last: int) -> str:
        return f"""
        def GeomSubset "{name}_faces" (prepend apiSchemas = ["MaterialBindingAPI"]) {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [{", ".join(map(str, range(first, last)))}]
            rel material:binding = </torus/{name}>
        }}"""

    faces = np.asarray(TORUS.faces)
    (folder / "torus.usda").write_text(f"""#usda 1.0
(defaultPrim = "torus"
 upAxis = "Y")
def Xform "torus" {{
    def Mesh "mesh" {{
        uniform token subdivisionScheme = "none"
        point3f[] points = [{tuples(TORUS.vertices)}]
        normal3f[] normals = [{tuples(TORUS.normals)}] (interpolation = "vertex")
        texCoord2f[] primvars:st = [{tuples(TORUS.uvs)}] (interpolation = "vertex")
        int[] faceVertexCounts = [{", ".join(["3"] * len(faces))}]
        int[] faceVertexIndices = [{", ".join(map(str, faces.ravel().tolist()))}]
        {subset("painted", 0, HALF)}
        {subset("gold", HALF, len(faces))}
    }}
    def Material "painted" {{
        token outputs:surface.connect = </torus/painted/shader.outputs:surface>
        def Shader "shader" {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </torus/painted/paint.outputs:rgb>
            float inputs:roughness = 0.5
            token outputs:surface
        }}
        def Shader "paint" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @paint.png@
            token inputs:wrapS = "repeat"
            token inputs:wrapT = "repeat"
            float2 inputs:st.connect = </torus/painted/st.outputs:result>
            float3 outputs:rgb
        }}
        def Shader "st" {{
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }}
    }}
    def Material "gold" {{
        token outputs:surface.connect = </torus/gold/shader.outputs:surface>
        def Shader "shader" {{
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0.75, 0.5, 0.25)
            float inputs:roughness = 0.25
            float inputs:metallic = 1
            token outputs:surface
        }}
    }}
}}
""")
    return folder / "torus.usda"


def ply(folder: Path) -> Path:
    plain = replace(TORUS, material=ph.Material("diffuse"))
    ph.save(ph.Scene([plain], background=None), folder / "torus.ply", strict=True)
    return folder / "torus.ply"


@pytest.mark.parametrize("write", [obj, usd])
def test_one_model_in_several_formats_gives_one_picture(tmp_path: Path, write: Any) -> None:
    (tmp_path / "paint.png").write_bytes(encoded(PIXELS, {}, ".png"))
    wanted = ph.load(gltf(tmp_path), ph.LoadOptions(strict=True))
    found = ph.load(write(tmp_path), ph.LoadOptions(strict=True))
    size = {"width": 96, "height": 64, "spp": 4}
    assert np.array_equal(picture(found, **size), picture(wanted, **size))


@pytest.mark.parametrize("write", [gltf, obj, usd])
def test_its_geometry_alone_gives_one_picture(tmp_path: Path, write: Any) -> None:
    """PLY has no materials: all others are shown in grey."""
    (tmp_path / "paint.png").write_bytes(encoded(PIXELS, {}, ".png"))
    scene = ph.load(write(tmp_path))
    shapes = [
        replace(s, material=ph.Material("diffuse")) if isinstance(s, ph.Mesh) else s
        for s in scene.shapes
    ]
    wanted = picture(ph.load(ply(tmp_path)))
    assert np.array_equal(picture(scene.replace(shapes=shapes)), wanted)
