"""Which of a file's cameras a picture is of: LoadOptions.camera, and --camera."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import cli
from parhelion.io.frames import load_frames

LENS = {"type": "perspective", "perspective": {"yfov": 0.7, "aspectRatio": 1.0}}
# Distances of the cameras, by what they are called; of the last one the node alone has a name
GLTF = {"front": 5.0, "side": 6.0, "Node far": 7.0}
USD = {"/World/front": 5.0, "/World/side": 6.0, "/Other/side": 7.0}


def gltf(folder: Path, **more: Any) -> Path:
    """A triangle and the cameras of GLTF."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
    document = {
        "asset": {"version": "2.0"},
        "buffers": [
            {
                "byteLength": 36,
                "uri": f"data:application/octet-stream;base64,{base64.b64encode(corners).decode()}",
            }
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "cameras": [{**LENS, "name": "front"}, {**LENS, "name": "side"}, LENS],
        "nodes": [
            {"mesh": 0},
            *(
                {"camera": i, "name": name.replace("side", "Node side"), "translation": [0, 0, z]}
                for i, (name, z) in enumerate(GLTF.items())
            ),
        ],
        "scenes": [{"nodes": [0, 1, 2, 3]}],
        **more,
    }
    file = folder / "a.gltf"
    file.write_text(json.dumps(document))
    return file


def usd(folder: Path, head: str = "") -> Path:
    """A sphere and the cameras of USD, and some that are not to be seen by."""
    pytest.importorskip("pxr")

    def camera(name: str, z: float, more: str = "") -> str:
        return f"""def Camera "{name}" {{
            double3 xformOp:translate = (0, 0, {z})
            uniform token[] xformOpOrder = ["xformOp:translate"]
            {more}
        }}"""

    file = folder / "a.usda"
    file.write_text(
        f"""#usda 1.0
        ({head})
        def Sphere "s" {{ }}
        def Xform "World" {{
            {camera("front", 5)}
            {camera("guide", 1, 'uniform token purpose = "guide"')}
            {camera("hidden", 1, 'token visibility = "invisible"')}
            {camera("side", 6)}
        }}
        def Xform "Other" {{
            {camera("side", 7)}
        }}
        """
    )
    return file


def distance(file: Path, **options: Any) -> float:
    """How far the camera is from the origin."""
    camera = ph.load(file, ph.LoadOptions(strict=True, **options)).camera
    assert isinstance(camera, ph.Camera)
    return float(camera.eye[2])


def test_a_camera_of_a_gltf_file_by_its_name_or_its_nodes(tmp_path: Path) -> None:
    file = gltf(tmp_path)
    assert distance(file) == 5.0  # without a word of the others, which strict would refuse
    assert distance(file, camera="side") == distance(file, camera="Node side") == 6.0
    assert distance(file, camera="Node far") == 7.0
    with pytest.raises(
        ph.FormatError,
        match=r"a\.gltf: unknown camera 'sied'; did you mean 'side'\?"
        r" \(choices: Node far, Node side, front, side\)",
    ):
        distance(file, camera="sied")


def test_cameras_of_a_gltf_file_that_have_no_names_of_their_own(tmp_path: Path) -> None:
    one = [{"camera": 0, "translation": [0, 0, z]} for z in (5, 6)]
    scenes = [{"nodes": [0, 1]}, {"nodes": []}]  # several scenes are nothing that lacks either
    file = gltf(tmp_path, nodes=one, cameras=[{**LENS, "name": "main"}], scenes=scenes)
    assert distance(file, camera="main") == 5.0
    assert distance(file, camera="nodes[1]") == 6.0


def test_a_file_without_cameras_has_no_choices(tmp_path: Path) -> None:
    with pytest.raises(ph.FormatError, match=r"unknown camera 'front'; there are none$"):
        distance(gltf(tmp_path, scenes=[{"nodes": [0]}]), camera="front")


def test_a_camera_of_a_stage_by_its_name_or_path(tmp_path: Path) -> None:
    file = usd(tmp_path)
    assert distance(file) == 5.0
    for path, z in USD.items():
        assert distance(file, camera=path) == z
    assert distance(file, camera="side") == 6.0  # the first of the name
    with pytest.raises(
        ph.FormatError, match=r"a\.usda: unknown camera 'fornt'; did .* \(choices: front, side\)$"
    ):
        distance(file, camera="fornt")
    with pytest.raises(ph.FormatError, match=r"choices: /Other/side, /World/front, /World/side\)"):
        distance(file, camera="/World/hidden")


def test_a_camera_that_is_asked_for_goes_before_the_one_that_the_stage_names(
    tmp_path: Path,
) -> None:
    bound = 'dictionary cameraSettings = { string boundCamera = "/Other/side" }'
    file = usd(tmp_path, f"customLayerData = {{ {bound} }}")
    assert distance(file) == 7.0
    assert distance(file, camera="front") == 5.0


@pytest.mark.parametrize("make", [gltf, usd])
def test_info_lists_the_cameras(
    make: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = make(tmp_path)
    names = list(GLTF if make is gltf else USD)
    assert cli.main(["info", str(file), "--strict"]) == 0
    assert f"── cameras: names {', '.join(names)}; used {names[0]}\n" in capsys.readouterr().out
    assert cli.main(["info", str(file), "--camera", names[2], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["contents"]["cameras"] == {"names": names, "used": names[2]}
    assert found["camera"]["eye"] == [0.0, 0.0, 7.0]


def test_frames_are_of_the_camera_and_scenes_remember_it(tmp_path: Path) -> None:
    file = usd(tmp_path, "startTimeCode = 1\nendTimeCode = 2")
    frames = load_frames(file, options=ph.LoadOptions(camera="/Other/side"))
    assert [scene.camera.eye[2] for scene in frames] == [7.0, 7.0]  # type: ignore[union-attr]
    source = ph.load(file, ph.LoadOptions(camera="front")).source
    assert source is not None
    assert source.options == {"camera": "front"}


def test_files_that_have_no_choice_of_cameras_refuse_the_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a.xml", "a.pbrt", "a.json", "a.xyz"):
        (tmp_path / name).write_text("")
        assert cli.main(["info", str(tmp_path / name), "--camera", "front"]) == 2
        assert "the option '--camera' is not for" in capsys.readouterr().err
