"""The commands render and info, as a user runs them."""

from __future__ import annotations

import base64
import contextlib
import fcntl
import gzip
import json
import logging
import os
import pty
import re
import resource
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from parhelion import cli, contents, tables
from picture_tools import read_picture

COMMAND = [sys.executable, "-m", "parhelion"]
SMALL = ["--width", "32", "--spp", "1"]

XYZ = "3\nwater\nO 0 0 0.1\nH 0 0.76 -0.47\nH 0 -0.76 -0.47\n"
DUMP = """ITEM: TIMESTEP
0
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp pp pp
0 4
0 4
0 4
ITEM: ATOMS id type x y z
1 1 1 1 1
2 1 3 3 3
"""


def parhelion(*words: object, cwd: Path, **options: object) -> subprocess.CompletedProcess[str]:
    """Runs the command as a process of its own."""
    command = [*COMMAND, *map(str, words)]
    return subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, timeout=60, check=False, **options
    )


@pytest.fixture(autouse=True)
def _same_log_level() -> Iterator[None]:
    logger = logging.getLogger("parhelion")
    level = logger.level
    yield
    logger.setLevel(level)


def scene_text(**changes: object) -> str:
    scene = {
        "parhelion": 1,
        "shapes": [{"type": "spheres", "centers": [[0, 0, 0], [2, 0, 0]], "radii": [1, 0.5]}],
    }
    return json.dumps(scene | changes)


# --- What a user asks for ------------------------------------------------------------------------


def test_no_scene_renders_the_weekend_scene_and_says_so_on_stderr(tmp_path: Path) -> None:
    done = parhelion("render", *SMALL, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "")
    speed = r"\(\S+ \w?samples/s, \S+ \w?rays/s, \d+ threads?, \w+\)"
    line = rf"weekend\.png: 32x18, 1 spp in \S+ s {speed}\n"
    assert re.fullmatch(line, done.stderr), done.stderr
    assert os.listdir(tmp_path) == ["weekend.png"]
    pixels, _ = read_picture(tmp_path / "weekend.png")
    assert (pixels.shape, pixels.dtype) == ((18, 32, 3), np.uint8)
    assert pixels.max() > 100


@pytest.mark.parametrize("words", [["--quiet"], ["-q", "--log-level", "debug"]])
def test_quiet_says_nothing_at_all(tmp_path: Path, words: list[str]) -> None:
    done = parhelion("render", *SMALL, *words, "-o", "a.png", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / "a.png").exists()


def test_debug_log_is_ours_alone(tmp_path: Path) -> None:
    (tmp_path / "w.xyz").write_text(XYZ)
    words = ["render", "w.xyz", *SMALL, "--color-by", "z", "--log-level", "debug"]
    done = parhelion(*words, cwd=tmp_path)
    assert done.returncode == 0
    *log, summary = done.stderr.splitlines()
    assert summary.startswith("w.png: ")
    assert any("tree" in line or "nodes" in line for line in log)
    assert not re.search("matplotlib|font", done.stderr)


@pytest.mark.parametrize(
    ("name", "bits", "dtype"),
    [
        ("a.png", [], np.uint8),
        ("a.png", ["--bits", "16"], np.uint16),
        ("a.PNG", [], np.uint8),
        ("a.jpg", [], np.uint8),
        ("a.jpeg", ["--bits", "8"], np.uint8),
        ("a.exr", [], np.float32),
        ("a.exr", ["--bits", "16"], np.float16),
    ],
)
def test_the_ending_chooses_the_format(
    tmp_path: Path, name: str, bits: list[str], dtype: type
) -> None:
    assert cli.main(["render", *SMALL, "-q", "-o", str(tmp_path / name), *bits]) == 0
    pixels, _ = read_picture(tmp_path / name)
    assert (pixels.shape, pixels.dtype) == ((18, 32, 3), dtype)


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        ("--width 40", {"width": 40, "height": 22}),
        ("--height 18", {"width": 32, "height": 18}),
        ("--width 40 --height 40", {"width": 40, "height": 40}),
        ("--spp 3", {"spp": 3}),
        ("--samples 3", {"spp": 3}),
        ("--max-depth 2", {"max_depth": 2}),
        ("--seed 7", {"seed": 7}),
        ("--sampler independent", {"sampler": "independent"}),
        ("--filter box", {"filter": "box"}),
        ("--filter-radius 4", {"filter_radius": 4.0}),
        ("--spp 8 --no-roulette", {"spp": 8, "roulette": False}),
        ("--crop 10,5,20,8", {"crop": (10, 5, 20, 8)}),
        ("--integrator direct", {"integrator": "direct"}),
        ("--integrator ao --ao-distance 0.5", {"integrator": "ao", "ao_distance": 0.5}),
    ],
)
def test_each_setting_acts(tmp_path: Path, words: str, settings: dict) -> None:
    output = tmp_path / "a.exr"
    words = words if "--width" in words or "--height" in words else "--width 48 " + words
    words = words if "spp" in words or "samples" in words else "--spp 2 " + words
    assert cli.main(["render", "-q", "-o", str(output), *words.split()]) == 0
    pixels, attributes = read_picture(output)
    base = {"width": 48, "height": 27, "spp": 2}
    expected = ph.render(ph.weekend(), **(base | settings))
    np.testing.assert_array_equal(pixels, expected.numpy())
    used = json.loads(attributes["parhelion:settings"])
    for name, value in settings.items():
        assert used[name] == (list(value) if isinstance(value, tuple) else value)
    preset = base | {"spp": settings.get("spp", 2)} | {"sampler": "sobol", "roulette": True}
    if settings.keys() - {"width", "height", "spp"}:
        assert not np.array_equal(pixels, ph.render(ph.weekend(), **preset).numpy())


def test_features_are_layers_of_an_exr_file(tmp_path: Path) -> None:
    output = tmp_path / "a.exr"
    assert cli.main(["render", *SMALL, "-q", "--features", "-o", str(output)]) == 0
    expected = ph.render(ph.weekend(), width=32, spp=1, features=True)
    pixels, attributes = read_picture(output)
    np.testing.assert_array_equal(pixels, expected.numpy())
    depth, _ = read_picture(output, ["depth.Z"])
    np.testing.assert_array_equal(depth, expected.features["depth"])
    coverage, _ = read_picture(output, ["CryptoObject00.G"])
    np.testing.assert_array_equal(coverage[..., 0], expected.features["CryptoObject"][..., 0, 1])
    assert json.loads(attributes["parhelion:shapes"]) == expected.flat.shape_names


XML = """<scene version="3.0.0">
  <default name="size" value="40"/>
  <default name="kind" value="diffuse"/>
  <sensor type="perspective">
    <film type="hdrfilm">
      <integer name="width" value="$size"/> <integer name="height" value="20"/>
    </film>
  </sensor>
  <shape type="obj"> <string name="filename" value="../shapes/one.obj"/>
    <bsdf type="$kind"/>
  </shape>
</scene>
"""


def test_parameters_strictness_and_folders_reach_the_reader(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("scene", "shapes", "other"):
        (tmp_path / folder).mkdir()
    (tmp_path / "shapes" / "one.obj").write_text("v 0 0 5\nv 1 0 5\nv 0 1 5\nf 1 2 3\n")
    (tmp_path / "scene" / "a.xml").write_text(XML)
    monkeypatch.chdir(tmp_path / "scene")
    allow = ["--allow-path", "../other", "--allow-path", "../shapes"]
    assert cli.main(["info", "a.xml"]) == 2
    assert "--allow-path" in capsys.readouterr().err
    assert cli.main(["info", "a.xml", *allow]) == 0
    assert "settings: 40x20" in capsys.readouterr().out
    assert cli.main(["info", "a.xml", *allow, "-D", "size=50", "-Dsize=60"]) == 0
    assert "settings: 60x20" in capsys.readouterr().out
    strange = [*allow, "-D", "kind=velvet"]
    assert cli.main(["info", "a.xml", *strange, "--strict"]) == 2
    assert "velvet" in capsys.readouterr().err
    assert cli.main(["render", "a.xml", *strange, "-q", "--spp", "1", "-o", "a.png"]) == 0


@pytest.mark.parametrize(
    "words",
    ["--threads 1", "-t 3", "--tile 7", "--schedule static --threads 2", "--tree none"],
)
def test_how_the_work_is_done_does_not_change_a_bit(tmp_path: Path, words: str) -> None:
    output = tmp_path / "a.exr"
    line = ["render", "--width", "48", "--spp", "2", "-q", "-o", str(output), *words.split()]
    assert cli.main(line) == 0
    pixels, attributes = read_picture(output)
    np.testing.assert_array_equal(pixels, ph.render(ph.weekend(), width=48, spp=2).numpy())
    if "thread" in words or "-t " in words:
        assert attributes["parhelion:threads"] == words.split()[-1]


@pytest.mark.parametrize(
    ("scene", "picture"),
    [
        ("water.xyz", "water.png"),
        ("melt.1000.dump", "melt.1000.png"),
        ("melt.1000.dump.gz", "melt.1000.png"),
    ],
)
def test_the_picture_is_named_after_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scene: str, picture: str
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (XYZ if scene.endswith(".xyz") else DUMP).encode()
    Path(scene).write_bytes(gzip.compress(text) if scene.endswith(".gz") else text)
    assert cli.main(["render", scene, *SMALL, "-q"]) == 0
    assert sorted(os.listdir()) == sorted([scene, picture])


def test_an_empty_output_name_is_not_the_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["render", *SMALL, "-o", ""]) == 2
    assert "picture ending" in capsys.readouterr().err
    assert os.listdir() == []


def test_version_and_help(tmp_path: Path) -> None:
    done = parhelion("--version", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, f"parhelion {ph.__version__}\n")
    done = parhelion("--help", cwd=tmp_path)
    for name in ("render", "convert", "info", "study"):
        assert re.search(rf"^ +{name} ", done.stdout, re.M), name


@pytest.mark.parametrize("command", ["render", "convert", "info", "study"])
def test_every_option_has_its_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main([command, "--help"])
    text = capsys.readouterr().out
    assert stop.value.code == 0
    assert text.startswith(f"usage: parhelion {command}")
    asked = {
        "render": "--output --bits --width --height --spp --max-depth --threads --seed --sampler"
        " --crop --quiet --log-level --color-by --colormap --radius --tree --schedule --features"
        " --integrator --ao-distance --strict --allow-path",
        "convert": "--strict --allow-path --up --view --quiet",
        "info": "--materials --strict --allow-path --variant --camera",
        "study": "--threads --widths --aspect --spp --scene --repeat --tree --sampler --schedule",
    }
    assert not set(asked[command].split()) - set(re.findall(r"--[a-z-]+", text))


# --- info ----------------------------------------------------------------------------------------


def test_info_of_a_scene_file(tmp_path: Path) -> None:
    (tmp_path / "two.json").write_text(scene_text(settings={"width": 100, "height": 50, "spp": 3}))
    done = parhelion("info", "two.json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    text = done.stdout
    assert text.startswith("two\n├── file: two.json, 0.2 KiB, read in ")
    box = re.escape("(-1, -1, -1) to (2.5, 1, 1)")
    assert re.search(rf"^├── shapes: 1, 2 primitives, {box}$", text, re.M)
    assert re.search(rf"^│   └── spheres: 2 spheres; of diffuse; {box}$", text, re.M)
    assert "── camera: automatic, eye" in text
    assert "── settings: 100x50, 3 spp\n" in text
    assert "0.27 MiB film; tree of " in text
    assert re.search(r"^└── hash: [0-9a-f]{64}$", text, re.M)


def test_info_of_particles_and_of_the_built_in_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "water.xyz").write_text(XYZ)
    assert cli.main(["info", str(tmp_path / "water.xyz")]) == 0
    assert "── particles: 3 spheres, colors; of diffuse; " in capsys.readouterr().out
    assert cli.main(["info"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("weekend\n├── shapes: 7, ")
    assert "primitives, (-1000, -2000, -1000) to (1000, 2, 1000)\n" in text


def test_info_lists_every_material_and_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", "--materials"]) == 0
    text = capsys.readouterr().out
    for kind in ("materials", "textures", "lights"):
        part = text[text.index(f"{kind}:\n") :]
        for entry in tables.tables()[kind].values():
            notes = (r" \(takes an image\)" * entry.image) + (
                r" \(may be a background\)" * entry.outside
            )
            assert re.search(rf"^  {entry.name}: {re.escape(entry.doc)}{notes}$", part, re.M)
            for p in entry.params:
                if (entry.name, p.name) == ("attribute", "name"):
                    assert re.search(r"^    name  .* \(text\)$", part, re.M)
                    continue
                values = " or ".join(p.choices) if p.choices else p.range()
                assert re.search(rf"    {p.name} = .*\({re.escape(values)}\)$", part, re.M)
    assert "every material also takes: absorption, back, bump_map, emission" in text


def test_info_lists_every_kind_of_shape(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball = {"type": "spheres", "centers": [[0, 0, 0]], "name": "ball"}
    corners = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    shapes = [
        {"type": "mesh", **corners, "material": {"type": "diffuse", "color": {"type": "ramp"}}},
        {"type": "disks", "centers": [[0, 0, 1]], "axis_u": [[1, 0, 0]], "axis_v": [[0, 1, 0]]},
        {"type": "cylinders", "starts": [[0, 0, 0]], "ends": [[0, 0, 1]]},
        {"type": "curves", "points": [[0, 0, 0], [1, 0, 0], [1, 1, 0]], "basis": "linear"},
        {"type": "instances", "shapes": [ball], "transforms": [np.eye(4).tolist()] * 3},
    ]
    scene = tmp_path / "a.json"
    scene.write_text(scene_text(shapes=shapes, lights=[{"type": "point"}], background=None))
    assert cli.main(["info", str(scene)]) == 0
    text = capsys.readouterr().out
    for line in (
        "│   ├── mesh: 1 triangle, 3 vertices; of diffuse; (0, 0, 0) to (1, 1, 0)",
        "│   ├── disks: 1 disk; of diffuse 2; (-1, -1, 0) to (1, 1, 2)",
        "│   ├── cylinders: 1 cylinder; of diffuse 2; (-1, -1, -1) to (1, 1, 2)",
        "│   ├── curves: 2 segments; of diffuse 2; (-0.01, -0.01, -0.01) to (1.01, 1.01, 0.01)",
        "│   └── instances: 3 copies, 3 primitives; (-1, -1, -1) to (1, 1, 1)",
        "│       └── ball: 1 sphere; of diffuse 2; (-1, -1, -1) to (1, 1, 1)",
        "│   ├── diffuse: diffuse, color by ramp, used by mesh",
        "│   └── diffuse 2: diffuse, used by disks, cylinders, curves, ball",
        "├── lights: 1 point; 1 with shapes that shine",
        "├── background: none",
    ):
        assert f"{line}\n" in text, line
    assert "images" not in text


def test_info_of_images_and_of_what_is_not_supported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pixels = {"shape": [4, 8, 3], "type": "uint8", "data": base64.b64encode(bytes(96)).decode()}
    wood = {"type": "image", "image": pixels}
    color = {"type": "multiply", "color0": wood, "color1": [0.5, 0.5, 0.5]}
    named = {
        "floor": {"type": "diffuse", "color": color, "normal_map": wood, "back": "spare"},
        "spare": {"type": "metal"},
        "unused": {"type": "blend", "a": "spare", "b": "spare", "weight": 0.25},
    }
    (tmp_path / "a.json").write_text(scene_text(materials=named))
    assert cli.main(["info", str(tmp_path / "a.json")]) == 0
    text = capsys.readouterr().out
    for line in (
        "│   ├── floor: diffuse, color by multiply image, normal_map by image image, not used",
        "│   ├── spare: metal, used by material floor, material unused",
        "│   ├── unused: blend, not used",
        "├── images: 2, 0.2 KiB",
        "│   ├── image: 8x4x3 uint8, 0.1 KiB, used by floor",
    ):
        assert f"{line}\n" in text, line
    (tmp_path / "a.xml").write_text(
        '<scene version="3.0.0"><shape type="sphere"><bsdf type="hair"/></shape></scene>'
    )
    assert cli.main(["info", str(tmp_path / "a.xml")]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert re.search(r"├── not supported: 1\n│   └── .*hair", said.out)


def test_info_of_many_things_stays_short(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = {"type": "spheres", "centers": [[0, 0, 0], [1, 0, 0]], "name": "b" * 100}
    tube = {"type": "cylinders", "starts": [[0, 0, 0]], "ends": [[0, 0, 1]]}
    (tmp_path / "a.json").write_text(scene_text(shapes=[ball, tube] * 500))
    assert cli.main(["info", str(tmp_path / "a.json")]) == 0
    text = capsys.readouterr().out
    assert len(text.splitlines()) < 32
    assert "│   └── ... and 984 more: 492 spheres, 492 cylinders, 1,476 primitives\n" in text
    assert f"── {'b' * 57}...: 2 spheres" in text
    assert cli.main(["info", str(tmp_path / "a.json"), "--all"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 1000
    monkeypatch.setattr(contents, "MOST_FOR_A_TREE", 1000)
    assert cli.main(["info", str(tmp_path / "a.json")]) == 0
    assert "film; of so many primitives no tree is built here" in capsys.readouterr().out


def test_info_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    triangle = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}
    shape = {"type": "mesh", **triangle, "attributes": {"face_age": [3]}}
    copies = {"type": "instances", "shapes": [shape], "transforms": [np.eye(4).tolist()] * 3}
    (tmp_path / "a.json").write_text(scene_text(shapes=[copies], lights=[{"type": "point"}]))
    assert cli.main(["info", str(tmp_path / "a.json"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    page = Path(__file__).parent.parent / "docs" / "reference.md"
    table = page.read_text(encoding="utf-8").partition("### parhelion info")[2]
    listed = re.findall(r"^\| `(\w+)` \|", table.partition("\n### ")[0], re.M)
    assert list(found) == listed
    assert found["file"]["bytes"] == (tmp_path / "a.json").stat().st_size
    assert (found["primitives"], found["shown"]) == (1, 3)
    assert found["shapes"] == [
        {
            "type": "instances",
            "name": "instances",
            "count": 3,
            "shown": 3,
            "bounds": [[0, 0, 0], [1, 1, 0]],
            "shapes": [
                {
                    "type": "mesh",
                    "name": "mesh",
                    "count": 1,
                    "unit": "triangles",
                    "shown": 1,
                    "bounds": [[0, 0, 0], [1, 1, 0]],
                    "materials": ["diffuse"],
                    "colors": False,
                    "vertices": 3,
                    "normals": False,
                    "uvs": False,
                    "tangents": False,
                    "attributes": ["face_age"],
                }
            ],
        }
    ]
    assert found["materials"] == [
        {"name": "diffuse", "type": "diffuse", "textures": [], "used_by": ["mesh"]}
    ]
    assert found["lights"] == [{"type": "point"}]
    assert found["camera"]["framed"]
    assert found["settings"]["spp"] == 64
    assert cli.main(["info", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["file"] is None


def test_info_shows_a_name_that_the_terminal_can_not(tmp_path: Path) -> None:
    (tmp_path / "é.xyz").write_text(XYZ)
    # The name is read as UTF-8, wherever the tests run, and written as ASCII.
    names = {"LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    done = parhelion("info", "é.xyz", cwd=tmp_path, env=os.environ | names)
    assert (done.returncode, done.stderr) == (0, "")
    assert "xe9.xyz" in done.stdout


def test_info_to_a_full_disk_and_to_nobody() -> None:
    if not os.path.exists("/dev/full"):
        pytest.skip("there is no /dev/full here")
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*COMMAND, "info"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60
        )
    assert done.returncode == 2
    assert re.fullmatch(r"parhelion: error: output: No space left on device\n", done.stderr)
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*COMMAND, "info"], stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


# --- Stopping ------------------------------------------------------------------------------------

ENDLESS = ["render", "--width", "160", "--spp", "100000000", "--log-level", "debug"]


@contextlib.contextmanager
def started(*words: object, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """A running command; one that is still there at the end is killed."""
    command = [*COMMAND, *map(str, words)]
    process = subprocess.Popen(command, cwd=cwd, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for(process: subprocess.Popen[str], text: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if text in line:
            return
    pytest.fail(f"the command ended without saying {text!r}")


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (signal.SIGINT, ""),
        (signal.SIGTERM, ""),
        (signal.SIGINT, "--threads 1"),
        (signal.SIGINT, "--tree none --threads 3"),
        (signal.SIGTERM, "--tree none --threads 1 --schedule static"),
    ],
)
def test_a_signal_ends_it_soon_with_what_there_is(tmp_path: Path, number: int, words: str) -> None:
    with started(*ENDLESS, "-o", "a.exr", *words.split(), cwd=tmp_path) as process:
        wait_for(process, "shared paths")  # what is known before the rendering begins
        time.sleep(0.7)
        assert process.poll() is None
        begin = time.monotonic()
        process.send_signal(number)
        _, said = process.communicate(timeout=30)
        seconds = time.monotonic() - begin
    assert process.returncode == 130
    assert seconds < 5.0  # 0.1 to 0.3 on an idle machine
    got = r"(\d+)(?: to (\d+))? spp(?:, [\d.]+ on average)?"
    line = rf"parhelion: stopped; a\.exr has {got}; --checkpoint FILE would let it .*\n"
    told = re.fullmatch(line, said)
    assert told, said
    assert int(told[1]) >= 1
    pixels, attributes = read_picture(tmp_path / "a.exr")
    assert os.listdir(tmp_path) == ["a.exr"]
    assert attributes["parhelion:complete"] == "false"
    samples = int(attributes["parhelion:samples"])
    assert int(told[1]) * 160 * 90 <= samples <= int(told[2] or told[1]) * 160 * 90
    # it is the picture it would have become, only noisier
    expected = ph.render(ph.weekend(), width=160, spp=16).numpy()
    assert np.isfinite(pixels).all()
    assert np.mean(pixels > 0) > 0.97
    np.testing.assert_allclose(pixels.mean((0, 1)), expected.mean((0, 1)), rtol=0.05)


def test_stopped_it_writes_the_picture_before_its_layers(tmp_path: Path) -> None:
    with started(*ENDLESS, "--features", "-o", "a.exr", cwd=tmp_path) as process:
        wait_for(process, "shared paths")
        time.sleep(0.7)
        process.send_signal(signal.SIGINT)
        wait_for(process, "a.exr is there, its layers follow")
        before, _ = read_picture(tmp_path / "a.exr")
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said.startswith("parhelion: stopped; a.exr has ")
    read_picture(tmp_path / "a.exr", ["depth.Z"])
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr")[0], before)
    assert os.listdir(tmp_path) == ["a.exr"]


def test_ctrl_c_while_the_program_is_loaded(tmp_path: Path) -> None:
    program = (
        "import sys, parhelion.__main__ as program\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'parhelion.cli': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.exit(program.main())\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (130, "parhelion: stopped\n")


def test_a_second_signal_ends_it_at_once(tmp_path: Path) -> None:
    # no one reads this pipe, so that writing the picture never ends
    os.mkfifo(tmp_path / "a.png")
    with started(*ENDLESS, "-o", "a.png", cwd=tmp_path) as process:
        wait_for(process, "shared paths")
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        time.sleep(1.0)
        assert process.poll() is None
        begin = time.monotonic()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
        assert time.monotonic() - begin < 5.0
    assert process.returncode == 130
    assert said == "parhelion: stopped\n"
    assert os.listdir(tmp_path) == ["a.png"]


def test_devices_and_pipes_are_no_scenes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "endless.ply").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.xyz")
    os.mkfifo(tmp_path / "pipe.exr")
    for words in (["render", "endless.ply"], ["info", "pipe.xyz"], ["image", "pipe.exr"]):
        file = tmp_path / words[1]
        assert cli.main([words[0], str(file)]) == 2
        assert capsys.readouterr().err.endswith(f"{file}: is not a regular file\n")


def test_ctrl_c_while_a_scene_is_read(tmp_path: Path) -> None:
    program = (
        "import sys, time\n"
        "import parhelion.io.xyz as reader\n"
        "from parhelion.__main__ import main\n"
        "def load(*_):\n"
        "    print('reading', file=sys.stderr, flush=True)\n"
        "    time.sleep(60)\n"
        "reader.load = load\n"
        "sys.exit(main())\n"
    )
    (tmp_path / "scene.xyz").write_text("1\n\nH 0 0 0\n")
    (tmp_path / "a.png").write_bytes(b"old")
    words = ["-c", program, "render", "scene.xyz", "-o", "a.png"]
    with subprocess.Popen(
        [sys.executable, *words], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_for(process, "reading")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said == "parhelion: stopped\n"
    assert (tmp_path / "a.png").read_bytes() == b"old"


# --- The progress bar ----------------------------------------------------------------------------


def test_a_terminal_sees_a_progress_bar(tmp_path: Path) -> None:
    terminal, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 140, 0, 0))
    hidden = {"NO_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE", "TTY_INTERACTIVE"}
    environment = {k: v for k, v in os.environ.items() if k not in hidden} | {"TERM": "xterm"}
    words = ["render", "--width", "240", "--spp", "40", "-o", "a.png"]
    process = subprocess.Popen(
        [*COMMAND, *words], cwd=tmp_path, env=environment, stderr=theirs, stdin=theirs
    )
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # Linux's way to say that the other end is closed
        while block := os.read(terminal, 65536):
            shown += block
    os.close(terminal)
    assert process.wait(timeout=30) == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    bar = r"rendering .*?(\d+)% +\S+ [kMG]?samples/s +\S+ [kMG]?rays/s +[-\d]+:[-\d]+:[-\d]+"
    percents = [int(p) for p in re.findall(bar, text)]
    assert len(percents) >= 3
    assert percents == sorted(percents)
    assert 0 < percents[-1] <= 100
    assert re.search(r"a\.png: 240x135, 40 spp in ", text)


# --- Bad input -----------------------------------------------------------------------------------


def npz(path: Path, **arrays: object) -> None:
    np.savez(path, **{name: np.asarray(a) for name, a in arrays.items()})


def truncated_npz(path: Path) -> None:
    npz(path, positions=np.zeros((1000, 3)))
    path.write_bytes(path.read_bytes()[:9000])


def huge_npz(path: Path) -> None:
    # a header that promises 2.4e16 bytes
    npz(path, positions=np.zeros((10, 3)))
    text = path.read_bytes()
    assert text.count(b"(10, 3)") == 1
    path.write_bytes(text.replace(b"(10, 3), }         ", b"(999999999999999, 3), }"[:19], 1))


def text(content: str | bytes) -> Callable[[Path], None]:
    data = content.encode() if isinstance(content, str) else content
    return lambda path: path.write_bytes(data) and None


def spheres(**changes: object) -> str:
    return scene_text(shapes=[{"type": "spheres", "centers": [[0, 0, 0]]} | changes])


BAD_FILES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "missing": ("a.json", lambda _: None),
    "missing particles": ("a.xyz", lambda _: None),
    "folder": ("a.json", Path.mkdir),
    "unknown ending": ("a.blend", text("x")),
    "no ending": ("a", text("x")),
    "json empty": ("a.json", text("")),
    "json truncated": ("a.json", text(scene_text()[:-20])),
    "json not UTF-8": ("a.json", text(b'{"parhelion": 1, "name": "\xff\xfe"}')),
    "json binary": ("a.json", text(bytes(range(256)) * 40)),
    "json list": ("a.json", text("[1, 2]")),
    "json wrong type": ("a.json", text(spheres(radii="large"))),
    "json NaN": ("a.json", text(spheres(centers=[[0, 0, float("nan")]]))),
    "json infinite": ("a.json", text(spheres(centers=[[0, 0, 1]]).replace("0, 1]", "0, 1e999]"))),
    "json negative radius": ("a.json", text(spheres(radii=-1))),
    "json unknown key": ("a.json", text(spheres(radius=1))),
    "json unknown material": ("a.json", text(spheres(material="glss"))),
    "json huge integer": ("a.json", text(scene_text(settings={"width": 10**30}))),
    "json deep": ("a.json", text("[" * 100000)),
    "xyz empty": ("a.xyz", text("")),
    "xyz truncated": ("a.xyz", text(XYZ[:30])),
    "xyz not UTF-8": ("a.xyz", text(b"1\n\n\xff\xfe\x00 0 0 0\n")),
    "xyz wrong type": ("a.xyz", text("1\n\nO 0 zero 0\n")),
    "xyz NaN": ("a.xyz", text("1\n\nO 0 nan 0\n")),
    "xyz infinite": ("a.xyz", text("1\n\nO 0 inf 0\n")),
    "xyz huge count": ("a.xyz", text("999999999999\n\nO 0 0 0\n")),
    "xyz negative count": ("a.xyz", text("-3\n\nO 0 0 0\n")),
    "xyz negative radius": (
        "a.xyz",
        text("1\nProperties=species:S:1:pos:R:3:radius:R:1\nO 0 0 0 -1\n"),
    ),
    "gz truncated": ("a.xyz.gz", lambda path: path.write_bytes(gzip.compress(XYZ.encode())[:-12])),
    "gz not packed": ("a.xyz.gz", text(XYZ)),
    "dump empty": ("a.dump", text("")),
    "dump truncated": ("a.dump", text(DUMP[:-10])),
    "dump wrong type": ("a.dump", text(DUMP.replace("1 1 1 1 1", "1 1 x y z"))),
    "dump NaN": ("a.dump", text(DUMP.replace("3 3 3", "3 nan 3"))),
    "dump huge count": ("a.dump", text(DUMP.replace("ATOMS\n2", "ATOMS\n99999999999999"))),
    "dump not UTF-8": ("a.dump", text(DUMP.encode().replace(b"TIMESTEP", b"\xff\xfe"))),
    "npz empty": ("a.npz", text("")),
    "npz no archive": ("a.npz", text("PK\x03\x04 and no more")),
    "npz truncated": ("a.npz", truncated_npz),
    "npz huge count": ("a.npz", huge_npz),
    "npz without positions": ("a.npz", lambda path: npz(path, charge=[1.0])),
    "npz wrong type": ("a.npz", lambda path: npz(path, positions=[["a", "b", "c"]])),
    "npz NaN": ("a.npz", lambda path: npz(path, positions=[[0, 0, np.nan]])),
    "npz infinite": ("a.npz", lambda path: npz(path, positions=[[0, np.inf, 0]])),
    "npz negative radius": (
        "a.npz",
        lambda path: npz(path, positions=[[0.0, 0, 0]], radius=[-1.0]),
    ),
    "npz wrong shape": ("a.npz", lambda path: npz(path, positions=np.zeros((2, 2)))),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_one_clear_error(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    name, make = BAD_FILES[case]
    make(tmp_path / name)
    (tmp_path / "out.png").write_bytes(b"the old picture")
    before = sorted(os.listdir())
    for command in (["render", name, *SMALL, "-o", "out.png"], ["info", name]):
        assert cli.main(command) == 2, case
        said = capsys.readouterr()
        assert said.out == ""
        assert re.fullmatch(rf"parhelion: error: .*{re.escape(name)}.*\n", said.err), said.err
        assert len(said.err) < 700
    assert sorted(os.listdir()) == before
    assert (tmp_path / "out.png").read_bytes() == b"the old picture"


def test_a_camera_without_direction(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "a.json"
    scene.write_text(scene_text(camera={"eye": [0, 0, 0], "target": [0, 0, 0]}))
    assert cli.main(["render", str(scene), *SMALL, "-o", str(tmp_path / "a.png")]) == 2
    said = f"parhelion: error: {scene}: camera: eye and target are the same point\n"
    assert capsys.readouterr().err == said
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("case", ["json truncated", "npz huge count", "xyz NaN", "dump not UTF-8"])
def test_a_bad_file_in_a_process_of_its_own(case: str, tmp_path: Path) -> None:
    name, make = BAD_FILES[case]
    make(tmp_path / name)
    done = parhelion("render", name, *SMALL, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(rf"parhelion: error: {re.escape(name)}.*\n", done.stderr), done.stderr
    assert os.listdir(tmp_path) == [name]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--width 0", "width is 0"),
        ("--width 70000", "width is 70000; must lie in"),
        ("--height -5", "height is -5"),
        ("--width 999999999999999999999999", "must lie in"),
        ("--spp 0", "spp is 0"),
        ("--max-depth 0", "--max-depth is 0"),
        ("--seed -1", "seed is -1"),
        ("--threads -2", "threads is -2"),
        ("--threads 1000000", "threads is 1000000"),
        ("--tile 0", "tile is 0"),
        ("--sampler sobel", "did you mean 'sobol'"),
        ("--filter gausian", "did you mean 'gaussian'"),
        ("--filter-radius 0", "--filter-radius is 0"),
        ("--filter-radius nan", "--filter-radius is nan"),
        ("--schedule dynmic", "did you mean 'dynamic'"),
        ("--tree oct", "unknown tree 'oct'"),
        ("--integrator bdpt", "unknown integrator 'bdpt' (choices: ao, direct, path)"),
        ("--ao-distance 0", "--ao-distance is 0"),
        ("--features", ".png cannot hold features (choices: .exr)"),
        ("--crop 0,0,64,1", "crop 0,0,64,1"),
        ("--crop 0,0,0,0", "does not lie within the picture, 32x18"),
        ("--bits 12", "cannot hold 12 bits"),
        ("-o a.tiff", "unknown picture ending '.tiff'"),
        ("-o picture", "unknown picture ending ''"),
        ("-o " + 300 * "a" + ".png", "File name too long"),
        ("-o no/such/folder.png", "there is no folder"),
        (300 * "a" + ".xyz", "File name too long"),
    ],
)
def test_a_request_without_meaning(
    words: str,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["render", "-o", "a.png", *SMALL, *words.split()]) == 2
    said = capsys.readouterr().err
    assert re.fullmatch(r"parhelion: error: .*\n", said)
    assert told in said
    assert os.listdir() == []


@pytest.mark.parametrize(
    "words",
    [
        "",
        "rendr",
        "render --width wide",
        "render --spp 1.5",
        "render --crop 1,2,3",
        "render --crop 1,2,3,x",
        "render --log-level loud",
        "render --radius big",
        "render --colour-by z",
        "render -D size",
        "render -D =5",
        "render a.json b.json",
        "info --width 3",
    ],
)
def test_a_command_line_that_can_not_be_parsed(
    words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(words.split())
    assert stop.value.code == 2
    said = capsys.readouterr().err
    assert re.fullmatch(r"parhelion( \w+)?: error: .* \(see parhelion( \w+)? --help\)\n", said)


# --- Output that can not be written --------------------------------------------------------------


def test_output_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    done = parhelion("render", *SMALL, "-o", "a.png", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "parhelion: error: a.png: is a folder\n"


def test_output_folder_without_permission(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("the superuser may write anywhere")
    folder = tmp_path / "locked"
    folder.mkdir()
    (folder / "a.png").write_bytes(b"old")
    folder.chmod(0o555)
    try:
        done = parhelion("render", *SMALL, "-o", "locked/a.png", cwd=tmp_path)
    finally:
        folder.chmod(0o755)
    assert done.returncode == 2
    assert re.fullmatch(r"parhelion: error: locked/a\.png: no permission .*\n", done.stderr)
    assert (folder / "a.png").read_bytes() == b"old"


@pytest.mark.parametrize("ending", ["png", "jpg", "exr"])
def test_a_full_device(tmp_path: Path, ending: str) -> None:
    if not os.path.exists("/dev/full"):
        pytest.skip("there is no /dev/full here")
    (tmp_path / f"a.{ending}").symlink_to("/dev/full")
    done = parhelion("render", *SMALL, "-o", f"a.{ending}", cwd=tmp_path)
    assert done.returncode == 2
    reason = "cannot be written: No space left on device"
    assert done.stderr == f"parhelion: error: a.{ending}: {reason}\n"
    assert os.listdir(tmp_path) == [f"a.{ending}"]
    assert os.readlink(tmp_path / f"a.{ending}") == "/dev/full"


@pytest.mark.parametrize("ending", ["png", "jpg", "exr"])
def test_no_room_for_the_picture_leaves_the_old_one_whole(tmp_path: Path, ending: str) -> None:
    # a limit on the size of files is the full disk that needs no privileges
    old = tmp_path / f"a.{ending}"
    old.write_bytes(b"the old picture")
    done = parhelion(
        *["render", "--width", "160", "--spp", "1", "-o", old.name],
        cwd=tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000)),
    )
    assert done.returncode == 2
    reason = "cannot be written: File too large"
    assert done.stderr == f"parhelion: error: a.{ending}: {reason}\n"
    assert old.read_bytes() == b"the old picture"
    assert os.listdir(tmp_path) == [old.name]


def test_a_picture_larger_than_memory(tmp_path: Path) -> None:
    # the limit keeps this from being tried on a machine that could
    done = parhelion(
        *["render", "--width", "65536", "--height", "65536", "--spp", "1", "-o", "a.png"],
        cwd=tmp_path,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33)),
    )
    assert done.returncode == 2
    said = r"parhelion: error: not enough memory: a picture of 65536x65536 takes .*\n"
    assert re.fullmatch(said, done.stderr), done.stderr
    assert os.listdir(tmp_path) == []


def test_options_of_files_are_not_for_the_scene_without_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.png"
    for words in (["--view", "front"], ["--environment", "a.exr"], ["--frame", "3"]):
        assert cli.main(["render", *words, "-o", str(file)]) == 2
        said = capsys.readouterr().err
        assert f"the option {words[0]!r} is not for the built-in scene, but for files" in said
    assert not file.exists()
    assert (
        cli.main(["render", "--background", "white", "--width", "16", "-o", str(file), "-q"]) == 0
    )
