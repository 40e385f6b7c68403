"""Turntables, sequences of numbered pictures, and films."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import cli
from parhelion.atomic import clear, replacing
from parhelion.framing import placed
from parhelion.orbit import turns
from parhelion.sequence import is_there, numbered
from parhelion.studio import dressed, framing, turned_light
from picture_tools import read_picture

SMALL = ["--width", "32", "--spp", "1"]
XYZ = "3\nwater\nO 0 0 0.1\nH 0 0.76 -0.47\nH 0 -0.76 -0.47\n"
Z_UP = (0.0, 0.0, 1.0)


def cloud(**changes: Any) -> ph.Scene:
    rng = np.random.default_rng(5)
    balls = ph.Spheres(rng.normal(size=(60, 3)) * [1, 3, 6], rng.uniform(0.1, 1.0, 60))
    return ph.Scene([balls], camera=framing(Z_UP)).replace(**changes)


def extent(scene: ph.Scene, camera: ph.Camera, aspect: float) -> np.ndarray:
    """How far spheres reach to the left, right, bottom and top; 1 is the picture's edge."""
    balls = scene.shapes[0]
    assert isinstance(balls, ph.Spheres)
    eye, target, up = (np.array(v, float) for v in (camera.eye, camera.target, camera.up))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    seen = (np.asarray(balls.centers) - eye) @ np.stack(
        [right, np.cross(right, ahead), ahead], axis=1
    )
    slope = np.tan(np.radians(0.5 * camera.vfov)) * np.array([aspect, 1.0])
    # the cone around a sphere meets the picture plane where its tangent planes do
    found = []
    for axis in (0, 1):
        u, w, r = seen[:, axis], seen[:, 2], np.asarray(balls.radii)
        angle, half = np.arctan2(u, w), np.arcsin(r / np.hypot(u, w))
        found += [np.max(-np.tan(angle - half)), np.max(np.tan(angle + half))]
    return np.array(found) / np.repeat(slope, 2)


# --- The camera's way ----------------------------------------------------------------------------


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("view", ["default", "front", "top"])
def test_nothing_leaves_the_picture_and_no_picture_is_nearer(aspect: float, view: str) -> None:
    scene = cloud(camera=framing(Z_UP, view))
    around = turns(scene, 90, aspect)
    reached = np.array([extent(scene, t.camera, aspect) for t in around])
    fill = scene.camera.fill
    assert reached.max() <= fill * (1 + 1e-6)
    # somewhere on its way it fills the picture: 4 degrees miss less than a hundredth of it
    assert reached.max() >= 0.99 * fill
    distances = [np.linalg.norm(np.subtract(t.camera.eye, t.camera.target)) for t in around]
    np.testing.assert_allclose(distances, distances[0], rtol=1e-12)


def test_it_starts_in_the_direction_of_the_still_and_goes_counterclockwise() -> None:
    scene = cloud()
    around = turns(scene, 4, 1.0)
    still = placed(scene, 1.0)
    towards = [np.subtract(t.camera.eye, t.camera.target) for t in around]
    directions = [v / np.linalg.norm(v) for v in towards]
    still_towards = np.subtract(still.eye, still.target)
    np.testing.assert_allclose(
        directions[0], still_towards / np.linalg.norm(still_towards), atol=1e-12
    )
    x, y, z = directions[0]
    np.testing.assert_allclose(directions[1], (-y, x, z), atol=1e-12)
    np.testing.assert_allclose(directions[2], (-x, -y, z), atol=1e-12)
    x, y, z = around[0].camera.up
    np.testing.assert_allclose(around[1].camera.up, (-y, x, z), atol=1e-12)


def test_a_camera_of_the_scenes_own_turns_about_what_it_looks_at() -> None:
    # its target says only a direction, as in many files
    camera = ph.Camera(eye=(10, 0, 4), target=(9, 0, 3.6), up=(0.4, 0, 1), vfov=30)
    scene = ph.Scene([ph.Spheres([[0, 0, 0], [0.2, 0, 0]], 1.0)], camera=camera)
    first, second = turns(scene, 4, 1.0)[:2]
    assert first.camera == camera
    np.testing.assert_allclose(second.camera.eye, (0.1, 9.9, 4), atol=1e-9)
    np.testing.assert_allclose(second.camera.up, (0, 0.4, 1), atol=1e-12)
    # turned back to back to the scene, it looks around from where it is
    away = camera.__class__(eye=(10, 0, 4), target=(11, 0, 4), up=Z_UP)
    around = turns(scene.replace(camera=away), 4, 1.0)
    np.testing.assert_allclose([t.camera.eye for t in around], [away.eye] * 4, atol=1e-12)
    # the axis may be given
    tipped = turns(scene, 2, 1.0, up=(1, 0, 0))[1].camera
    np.testing.assert_allclose(tipped.eye[2], 2 * (4 - 0.4 * 10) - 4, atol=1e-9)


@pytest.mark.parametrize(
    ("count", "up", "told"),
    [
        (0, None, "pictures of a turn: 0; must lie in"),
        (2.5, None, "2.5; must be a whole number"),
        (3, (0, 0, 0), "must be three finite numbers, not all 0"),
        (3, (0, np.nan, 0), "must be three finite numbers"),
    ],
)
def test_a_turn_without_meaning(count: Any, up: Any, told: str) -> None:
    with pytest.raises(ph.SceneError, match=re.escape(told)):
        ph.turntable(cloud(), count, up=up)


# --- Light ---------------------------------------------------------------------------------------


def test_the_studios_light_goes_around_with_the_camera() -> None:
    ball = ph.Spheres([[3.0, 1.0, 2.0]], 1.0)
    scene = dressed(ph.Scene([ball], camera=framing(Z_UP), background=None), bare=True)
    pictures = list(ph.turntable(scene, 3, width=24, height=24, spp=64))
    # a ball looks the same from everywhere, if its light comes along; noise is some 0.01
    for picture in pictures[1:]:
        np.testing.assert_allclose(picture.numpy(), pictures[0].numpy(), atol=0.06)
    # it would not if the light stayed
    turn = turns(scene, 3, 1.0)[1]
    other = ph.render(scene, camera=turn.camera, width=24, height=24, spp=64)
    assert np.abs(other.numpy() - pictures[0].numpy()).max() > 0.2


def test_the_studios_ground_stays_below(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 1 0\nv 1 1 0\nv 0 2 3\nf 1 2 3\n")
    scene = ph.load(tmp_path / "a.obj")
    turn = turns(scene, 3, 1.0)[1]
    turned = turned_light(scene, turn.rotation, turn.pivot)
    assert turned.shapes[-1].name == "ground"
    assert turned.shapes[-1] is scene.shapes[-1]
    # its middle is below the axis
    np.testing.assert_allclose(np.delete(turned.shapes[-1].centers[0] - turn.pivot, 1), 0)


def test_a_camera_of_the_files_own_turns_about_the_things_and_not_their_lamp() -> None:
    camera = ph.Camera(eye=(0, 2, 9), target=(0, 0, 0))
    plain = ph.Scene([ph.Spheres([[0, 0, 0]], 1.0)], camera=camera, background=None)
    pivot = turns(dressed(plain, bare=True, ground=True), 4, 1.0)[0].pivot
    np.testing.assert_allclose(pivot, turns(plain, 4, 1.0)[0].pivot)


def test_light_of_the_scenes_own_stays_and_its_tree_is_built_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lit = cloud()
    turn = turns(lit, 3, 1.0)[1]
    assert turned_light(lit, turn.rotation, turn.pivot) is lit
    from parhelion import orbit

    built: list[object] = []
    prepare = orbit.prepare
    monkeypatch.setattr(orbit, "prepare", lambda s, **_: built.append(s) or prepare(s))
    pictures = list(ph.turntable(lit, 3, width=16, spp=1))
    assert len(built) == 1
    assert len(pictures) == 3
    expected = ph.render(lit, camera=turns(lit, 3, 16 / 9)[2].camera, width=16, spp=1)
    np.testing.assert_array_equal(pictures[2].numpy(), expected.numpy())


# --- Files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a.png", "a.0007.png"),
        ("a%d.exr", "a7.exr"),
        ("a-%03d.b.jpg", "a-007.b.jpg"),
        ("%%-%2d.png", "%- 7.png"),
        ("100%%.png", "100%.0007.png"),
        ("a.####.png", "a.0007.png"),
        ("#-100%%.png", "7-100%.png"),
        (os.path.join("50%", "a.png"), os.path.join("50%", "a.0007.png")),
    ],
)
def test_names_of_files(name: str, expected: str) -> None:
    assert numbered(name, 7) == expected


def test_numbers_that_need_more_digits_or_a_sign() -> None:
    assert numbered("a.##.png", 123) == "a.123.png"
    assert numbered("a.####.png", -12) == numbered("a.%04d.png", -12) == "a.-012.png"


def test_exposure_of_a_sequence_and_its_background(tmp_path: Path) -> None:
    """The background is as it was named."""
    (tmp_path / "w.xyz").write_text(XYZ)
    words = ["render", str(tmp_path / "w.xyz"), *SMALL, "--turntable", "1", "-q"]
    for name, more in (("a", []), ("b", ["--exposure", "-2"])):
        more = [*more, "--background", "#204060", "-o", str(tmp_path / f"{name}.png")]
        assert cli.main([*words, *more]) == 0
    bright, dark = (read_picture(tmp_path / f"{name}.0001.png")[0].astype(int) for name in "ab")
    assert bright[0, 0].tolist() == dark[0, 0].tolist() == [0x20, 0x40, 0x60]
    assert dark[7:11, 14:18].mean() < 0.7 * bright[7:11, 14:18].mean()


def test_a_turntable_of_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "w.xyz").write_text(XYZ)
    words = ["render", str(tmp_path / "w.xyz"), *SMALL, "--turntable", "3"]
    assert cli.main([*words, "-o", str(tmp_path / "t.png")]) == 0
    said = capsys.readouterr().err
    assert re.fullmatch(r".*t\.png: 3 pictures, 32x18, 1 spp in \S+ s\n", said)
    assert sorted(os.listdir(tmp_path)) == ["t.0001.png", "t.0002.png", "t.0003.png", "w.xyz"]
    pictures = [read_picture(tmp_path / f"t.000{k}.png")[0] for k in (1, 2, 3)]
    assert len({p.tobytes() for p in pictures}) == 3
    images = ph.turntable(ph.load(tmp_path / "w.xyz"), 3, width=32, spp=1)
    assert ph.save_sequence(images, tmp_path / "u%d.png") == 3
    for k in (1, 2, 3):
        assert np.array_equal(read_picture(tmp_path / f"u{k}.png")[0], pictures[k - 1])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("-o a%d%d.png", "a%d%d.png: one number such as %04d or #### may stand in the name"),
        ("-o a%s.png", "a%s.png: one number"),
        ("-o a%09999d.png", "too many digits"),
        ("-o a.tiff", "a.0001.tiff: unknown picture ending '.tiff'"),
        ("-o no/such.png", "there is no folder"),
        ("-o a.png --fps 5", "--fps is for films"),
        ("-o a##-##.png", "a##-##.png: one number such as %04d or #### may stand in the name"),
        ("-o a#-%d.png", "one number such as %04d or ####"),
        (f"-o {'#' * 21}.png", "# has too many digits; #### has four"),
        ("-o a.mp4 --skip-existing", "a film is made in one piece, so --skip-existing is for"),
        ("-o a.mp4 --fps 0", "fps is 0.0; must lie in"),
        ("-o a.mp4 --bits 16", ".mp4 cannot hold 16 bits"),
        ("-o a.mp4 --features", ".mp4 cannot hold features"),
        ("-o no/such.mp4", "there is no folder"),
        ("-o a.png --features", "cannot hold features"),
        ("-o a.png --turntable 0", "pictures of a turn: 0"),
    ],
)
def test_a_sequence_without_meaning(
    words: str,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["render", *SMALL, "--turntable", "2", *words.split()]) == 2
    assert told in capsys.readouterr().err
    assert os.listdir() == []


@pytest.mark.parametrize("words", [["--fps", "5"], ["--skip-existing"]])
def test_what_needs_a_sequence(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["render", *SMALL, *words]) == 2
    assert f"{words[0]} needs a sequence of pictures" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["a.png", "a.mp4"])
def test_ctrl_c_leaves_whole_pictures_and_the_old_film(tmp_path: Path, name: str) -> None:
    fake_ffmpeg(tmp_path / "bin")
    path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
    (tmp_path / "a.mp4").write_bytes(b"old")
    command = [sys.executable, "-m", "parhelion", "render", "--turntable", "10000", "--width"]
    process = subprocess.Popen(
        [*command, "64", "--spp", "4", "-o", name],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PATH": path},
    )
    try:
        there = tmp_path / ("a.0002.png" if name == "a.png" else "bin/started")
        begin = time.monotonic()
        while not there.exists():
            assert time.monotonic() - begin < 50
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 130
    told = re.fullmatch(
        r"parhelion: stopped after (\d+) of 10000 pictures"
        r"; (?:(a\.mp4 was not written)|--skip-existing makes the others)\n",
        said,
    )
    assert told, said
    assert bool(told[2]) == (name == "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes() == b"old"
    left = sorted(set(os.listdir(tmp_path)) - {"a.mp4", "bin"})
    assert left == ([numbered(name, k + 1) for k in range(int(told[1]))] if not told[2] else [])
    for file in left:
        assert read_picture(tmp_path / file)[0].shape == (36, 64, 3)


# --- Going on ------------------------------------------------------------------------------------


def test_an_animation_that_is_killed_goes_on_where_it_was(tmp_path: Path, long: bool) -> None:
    rng = np.random.default_rng(3)
    count, kills = (200, 50) if long else (24, 3)
    words = ["render", "--turntable", str(count), "--width", "64", "--spp", "4", "--skip-existing"]
    command = [sys.executable, "-m", "parhelion", *words, "-q", "-o", "a.###.png"]
    (tmp_path / "killed").mkdir()

    def files() -> dict[str, os.stat_result]:
        shown = [f for f in (tmp_path / "killed").iterdir() if not f.name.startswith(".")]
        return {f.name: f.stat() for f in shown}

    for goal in np.linspace(3, count - 8, kills, dtype=int):
        process = subprocess.Popen(command, cwd=tmp_path / "killed")
        try:
            begin, there = time.monotonic(), files()
            while len(files()) < goal:
                assert time.monotonic() - begin < 50
                assert process.poll() is None
                time.sleep(0.001)
            time.sleep(rng.uniform(0.0, 0.02))
        finally:
            process.kill()
            process.wait()
        after = files()
        assert len(after) < count
        assert {name: after[name] for name in there} == there  # none is made twice
        for name in after:
            assert read_picture(tmp_path / "killed" / name)[0].shape == (36, 64, 3)
    stale = tmp_path / "killed" / ".parhelion-left.png"
    stale.write_bytes(b"half a picture")
    assert subprocess.run(command, cwd=tmp_path / "killed", check=False).returncode == 0
    whole = [f"a.{k:03}.png" for k in range(1, count + 1)]
    assert sorted(os.listdir(tmp_path / "killed")) == whole
    images = ph.turntable(ph.weekend(), count, width=64, spp=4)
    ph.save_sequence(images, tmp_path / "b.###.png")
    for k in range(1, count + 1):
        ours = read_picture(tmp_path / "killed" / f"a.{k:03}.png")[0]
        assert np.array_equal(ours, read_picture(tmp_path / f"b.{k:03}.png")[0])


def test_what_is_made_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is not whole, of another program or of other options; nothing is read where all is."""
    scene = tmp_path / "w.xyz"
    scene.write_text(XYZ)
    words = ["render", str(scene), *SMALL, "--turntable", "3", "--skip-existing"]
    words += ["-o", str(tmp_path / "t.png")]
    files = [tmp_path / f"t.000{k}.png" for k in (1, 2, 3)]

    def said(*more: str) -> str:
        assert cli.main([*words, *more]) == 0
        return capsys.readouterr().err.partition("t.png: ")[2].strip()

    assert said().startswith("3 pictures, 32x18")
    whole = [file.read_bytes() for file in files]
    assert said("--threads", "1") == "0 pictures (3 more were there)"
    files[0].write_bytes(whole[0][:-40])
    assert said().startswith("1 picture (2 more were there), 32x18")
    damaged = bytearray(whole[1])
    damaged[damaged.index(b"IDAT") + 40] ^= 0xFF
    files[1].write_bytes(damaged)
    files[2].unlink()
    assert said().startswith("2 pictures (1 more was there), 32x18")
    files[0].write_bytes(whole[1])  # the picture of another frame
    assert said().startswith("1 picture (2 more were there), 32x18")
    assert said("--seed", "4").startswith("3 pictures, 32x18")
    assert said("--seed", "4") == "0 pictures (3 more were there)"
    ph.render(ph.load(scene), width=32, spp=1).save(files[1])  # not of a sequence
    assert said("--seed", "4").startswith("1 picture (2 more were there), 32x18")


@pytest.mark.parametrize("ending", ["jpg", "exr"])
def test_all_formats_are_known_again(tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"a.{ending}"
    image = ph.render(cloud(), width=32, height=18, spp=1)
    replace(image, notes={"parhelion:sequence": "one"}).save(file)
    assert is_there(str(file), (32, 18), {"parhelion:sequence": "one"})
    assert not is_there(str(file), (32, 17), {"parhelion:sequence": "one"})
    assert not is_there(str(file), (32, 18), {"parhelion:sequence": "two"})
    assert not is_there(str(tmp_path), (32, 18), {})
    file.write_bytes(file.read_bytes()[:-20])
    assert not is_there(str(file), (32, 18), {"parhelion:sequence": "one"})


def test_temporary_files_that_are_being_written_stay(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.png") as temporary:
        (tmp_path / ".parhelion-old.png").touch()
        clear(tmp_path)
        assert os.listdir(tmp_path) == [temporary.name]
        temporary.write_bytes(b"new")
    assert os.listdir(tmp_path) == ["a.png"]
    clear(tmp_path / "nowhere")


# --- Films ---------------------------------------------------------------------------------------


def fake_ffmpeg(folder: Path, script: str = "") -> None:
    """A program that lists our encoder, and keeps what it is sent as the film."""
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text(
        f"""#!{sys.executable}
import pathlib, sys
if "-encoders" in sys.argv:
    print(" V....D libx264  libx264 H.264")
    sys.exit()
pathlib.Path({str(folder / "started")!r}).touch()
{script}
pathlib.Path(sys.argv[-1]).write_bytes(sys.stdin.buffer.read())
pathlib.Path({str(folder / "words")!r}).write_text("\\n".join(sys.argv))
"""
    )
    program.chmod(0o755)


def film(images: Any, path: Path) -> int:
    return ph.save_sequence(images, path, fps=12.5)


@pytest.fixture
def only_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder that programs are looked for in."""
    folder = tmp_path / "bin"
    monkeypatch.setenv("PATH", str(folder))
    return folder


def test_a_film_plays_at_the_speed_of_its_file(
    tmp_path: Path, only_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_ffmpeg(only_path)
    keys = np.array([0, 1, 0, 0, 5, 0, 0, 9], "<f4").tobytes()
    number = {"bufferView": 0, "componentType": 5126, "count": 2}
    lens = {"yfov": 1, "znear": 1, "aspectRatio": 2}
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"camera": 0}],
        "cameras": [{"type": "perspective", "perspective": lens}],
        "buffers": [
            {"byteLength": 32, "uri": f"data:;base64,{base64.b64encode(keys).decode()}"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 32}],
        "accessors": [
            number | {"type": "SCALAR"},
            number | {"type": "VEC3", "byteOffset": 8},
        ],
        "animations": [{"samplers": [{"input": 0, "output": 1}], "channels": [channel]}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    assert cli.main(["info", str(tmp_path / "a.gltf")]) == 0
    assert "frames: seconds 0 to 1\n" in capsys.readouterr().out
    words = ["render", str(tmp_path / "a.gltf"), "--width", "32", "--spp", "1"]
    film = str(tmp_path / "a.mp4")
    assert cli.main([*words, "--frames", "::0.25", "-o", film]) == 0
    assert "-framerate\n4\n" in (only_path / "words").read_text()
    assert len(Path(film).read_bytes()) == 5 * 32 * 16 * 3
    # as many pictures a second as are asked for, of a film or not
    assert cli.main([*words, "--frames", "all", "--fps", "2", "-o", film]) == 0
    assert len(Path(film).read_bytes()) == 3 * 32 * 16 * 3
    png = str(tmp_path / "a.png")
    assert cli.main([*words, "--frames", "all", "--fps", "2", "-o", png]) == 0
    assert sorted(tmp_path.glob("*.png")) == [tmp_path / f"a.000{k}.png" for k in (1, 2, 3)]
    capsys.readouterr()
    assert cli.main([*words, "--frames", "::0.5", "--fps", "2", "-o", png]) == 2
    assert "a.png: --fps is for films: .mp4" in capsys.readouterr().err


def turn_of(count: int, width: int = 16, height: int = 16) -> Any:
    return ph.turntable(cloud(), count, width=width, height=height, spp=1)


def test_a_film_gets_every_picture(tmp_path: Path, only_path: Path) -> None:
    fake_ffmpeg(only_path)
    assert film(turn_of(3), tmp_path / "a.mp4") == 3
    frames = np.concatenate([image.srgb() for image in turn_of(3)])
    assert (tmp_path / "a.mp4").read_bytes() == frames.tobytes()
    words = (only_path / "words").read_text().split("\n")
    for option, value in (("-s", "16x16"), ("-framerate", "12.5"), ("-pix_fmt", "rgb24")):
        assert words[words.index(option) + 1] == value
    ph.save_sequence(turn_of(1), tmp_path / "b.mp4", exposure=-1)
    darker = next(turn_of(1)).srgb(exposure=-1)
    assert (tmp_path / "b.mp4").read_bytes() == darker.tobytes()
    with pytest.raises(ph.SceneError, match="exposure is inf"):
        ph.save_sequence(turn_of(1), tmp_path / "c.mp4", exposure=np.inf)


def test_without_ffmpeg_nothing_is_rendered(tmp_path: Path, only_path: Path) -> None:
    only_path.mkdir()
    asked: list[int] = []
    images = (asked.append(1) for _ in range(3))
    with pytest.raises(ph.ResourceError, match="the program ffmpeg is needed"):
        film(images, tmp_path / "a.mp4")
    program = only_path / "ffmpeg"
    program.write_text("#!/bin/sh\necho V mpeg4\n")
    program.chmod(0o755)
    with pytest.raises(ph.ResourceError, match="has no encoder libx264"):
        film(images, tmp_path / "a.mp4")
    assert not asked
    assert os.listdir(tmp_path) == ["bin"]


def test_a_film_that_fails_leaves_the_old_one(tmp_path: Path, only_path: Path) -> None:
    fake_ffmpeg(only_path, "sys.exit('No space left on device')")
    (tmp_path / "a.mp4").write_bytes(b"old")
    with pytest.raises(ph.ResourceError, match=r"a\.mp4: ffmpeg failed: No space left on device"):
        film(turn_of(2), tmp_path / "a.mp4")
    # errors of who makes the pictures are theirs
    (only_path / "ffmpeg").unlink()
    (only_path / "started").unlink()
    only_path.rmdir()
    fake_ffmpeg(only_path)

    def broken() -> Any:
        yield from turn_of(1)
        raise ValueError("mine")

    with pytest.raises(ValueError, match=r"^mine$"):
        film(broken(), tmp_path / "a.mp4")
    with pytest.raises(ph.SceneError, match="a film needs a picture"):
        film([], tmp_path / "a.mp4")
    with pytest.raises(ph.SceneError, match=r"even width and height, and pictures are 16x15"):
        film(turn_of(1, 16, 15), tmp_path / "a.mp4")
    with pytest.raises(ph.SceneError, match="a picture of 18x16 in a film of 16x16"):
        film([*turn_of(1), *turn_of(1, 18)], tmp_path / "a.mp4")
    assert (tmp_path / "a.mp4").read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["a.mp4", "bin"]


@pytest.mark.usefixtures("only_path")
def test_the_size_of_a_film_is_checked_before_rendering(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fake_ffmpeg(tmp_path / "bin")
    # what the user does not say is made even: 30 x 16.875
    words = ["render", "--turntable", "2", "--width", "30", "--spp", "1", "-q"]
    assert cli.main([*words, "-o", str(tmp_path / "b.mp4")]) == 0
    assert len((tmp_path / "b.mp4").read_bytes()) == 2 * 30 * 18 * 3
    words = ["render", "--turntable", "2", "--width", "32", "--height", "17"]
    assert cli.main([*words, "--spp", "100000000", "-o", str(tmp_path / "a.mp4")]) == 2
    assert "a film needs an even width and height, and pictures are 32x17" in (
        capsys.readouterr().err
    )


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the program ffmpeg is not here")
def test_a_real_film_has_the_colours_of_the_pictures(tmp_path: Path) -> None:
    colors = [(0.8, 0.1, 0.1), (0.1, 0.7, 0.1), (0.1, 0.1, 0.6), (1, 1, 1), (0, 0, 0)]
    scenes = [ph.Scene(background=ph.Background("constant", radiance=c)) for c in colors]
    images = [ph.render(s, width=64, height=32, spp=1) for s in scenes]
    assert ph.save_sequence(images, tmp_path / "a.mp4", fps=25) == 5
    shown = subprocess.run(
        ["ffmpeg", "-hide_banner", "-i", "a.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        cwd=tmp_path,
        capture_output=True,
        check=True,
    )
    told = shown.stderr.decode()
    assert re.search(r"h264 .*yuv420p\(tv, bt709/bt709/iec61966-2-1.* 64x32.* 25 fps", told)
    frames = np.frombuffer(shown.stdout, np.uint8).reshape(5, 32, 64, 3)
    for frame, image in zip(frames, images, strict=True):
        # of 255: the rounding of Y, Cb and Cr, and the codec
        assert np.abs(frame.astype(int) - image.srgb()).max() <= 4
