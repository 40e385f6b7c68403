"""Pictures made again from what their files say."""

from __future__ import annotations

import base64
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import cli, image
from parhelion.renderer import prepare
from picture_tools import read_picture

REPOSITORY = Path(__file__).resolve().parent.parent
SIZE = {"width": 48, "height": 27}


def run(*words: object) -> int:
    return cli.main([str(word) for word in words])


_XYZ = '3\nLattice="2 0 0 0 2 0 0 0 2" Properties=species:S:1:pos:R:3:q:R:1\n'


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "scenes"
    folder.mkdir()
    return Path(shutil.copy(REPOSITORY / "scenes" / "three-spheres.json", folder))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.exr", "--spp 3"),
        ("a.exr", "--spp 3 --compression dwaa"),
        ("a.exr", "--noise 0.5 --bits 16 --features --compression piz --tiled"),
        ("a.exr", "--time-limit 0.4 --seed 7 --integrator ao --ao-distance 2"),
        ("a.png", "--noise 0.5 --exposure 0.5 --view-transform agx --white-balance 4000"),
        (
            "a.png",
            "--spp 2 --bits 16 --crop 3,4,20,11 --max-depth 3 --clamp-indirect 1 --reuse-paths",
        ),
        ("a.png", "--spp 2 --view top --ground --background orange --filter box"),
        ("a.jpg", "--spp 2 --sampler independent --no-roulette"),
        ("a.exr", "--spp 2 --denoise"),
        ("a.png", "--noise 0.5 --denoise"),
    ],
)
def test_it_is_the_same(
    tmp_path: Path, scene: Path, capsys: pytest.CaptureFixture[str], name: str, words: str
) -> None:
    if "--denoise" in words:
        pytest.importorskip("pyoidn")
    file, again = tmp_path / name, tmp_path / f"again{Path(name).suffix}"
    assert run("render", scene, "--width", 48, "-o", file, "-q", *words.split()) == 0
    assert run("rerender", file, "-o", again, "--threads", 1) == 0
    assert f"{file}: the same, " in capsys.readouterr().err
    (old, told), (new, told_again) = read_picture(file), read_picture(again)
    np.testing.assert_array_equal(old, new)
    for key in ("scene", "settings", "camera", "samples", "counts", "source"):
        assert told.get(f"parhelion:{key}") == told_again.get(f"parhelion:{key}")


def test_particles_are_read_as_they_were(tmp_path: Path) -> None:
    data = tmp_path / "a.xyz"
    data.write_text(_XYZ + "H 0 0 0 1\nO 1 0 0 2\nC 0 1 1 3\n")
    file = tmp_path / "a.png"
    words = "--color-by q --colormap plasma --color-range 0 4 --radius 0.4 --box --width 40 --spp 2"
    assert run("render", data, "-o", file, "-q", "--legend", *words.split()) == 0
    assert run("rerender", file, "-q") == 0


def test_of_a_stopped_picture_each_pixel_has_its_samples(tmp_path: Path) -> None:
    stopped = ph.render(
        ph.weekend(), progress=lambda s: s.samples > 9000, spp=10**6, width=96, height=54
    )
    assert not stopped.stats.complete
    for ending in (".exr", ".png"):
        stopped.save(tmp_path / f"a{ending}")
        again = ph.rerender(tmp_path / f"a{ending}")
        np.testing.assert_array_equal(again.counts, stopped.counts)
        np.testing.assert_array_equal(again.numpy(), stopped.numpy())
        assert run("rerender", tmp_path / f"a{ending}", "-q") == 0


def test_counts_by_pixel() -> None:
    spheres = prepare(ph.weekend())
    counts = np.random.default_rng(1).integers(0, 9, (27, 48))
    picture = ph.render(spheres, counts=counts, features=True, **SIZE)
    np.testing.assert_array_equal(picture.counts, counts)
    for n in range(1, 9):
        even = ph.render(spheres, spp=n, features=True, **SIZE)
        for name, values in {"": picture.numpy(), **picture.features}.items():
            expected = even.features[name] if name else even.numpy()
            np.testing.assert_array_equal(values[counts == n], expected[counts == n])
    again = ph.render(spheres, counts=picture.counts, threads=1, tile=3, **SIZE)
    np.testing.assert_array_equal(picture.numpy(), again.numpy())


@pytest.mark.parametrize(
    ("counts", "said"),
    [
        (np.ones((27, 47), int), r"whole numbers of shape \(27, 48\) are needed, not int64 of"),
        (np.ones((27, 48)), "not float64 of shape"),
        ("all", "are needed, not <U3"),
        (np.full((27, 48), -1), "must lie in"),
        (np.full((27, 48), 2**24 + 1), "must lie in"),
    ],
)
def test_counts_that_are_none(counts: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(ph.SceneError, match=said):
        ph.render(ph.weekend(), counts=counts, **SIZE)
    with pytest.raises(ph.SceneError, match="no checkpoints of samples by pixel"):
        ph.render(ph.weekend(), counts=np.ones((27, 48), int), checkpoint=tmp_path / "a", **SIZE)


def test_what_differs_is_told(
    tmp_path: Path, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.exr"
    picture = ph.render(ph.load(scene), spp=1, **SIZE)
    picture.pixels[3, 4] *= np.float32(1.0000001)
    picture.pixels[9, 9, 2] += np.float32(1e-3)
    picture.save(file)
    assert run("rerender", file) == 1
    assert capsys.readouterr().err == f"{file}: 2 pixels differ\n"


def test_a_scene_that_went_elsewhere(tmp_path: Path, scene: Path) -> None:
    file, moved = tmp_path / "a.png", tmp_path / "moved.json"
    assert run("render", scene, "--width", 48, "--spp", 2, "-o", file, "-q", "--no-ground") == 0
    scene.rename(moved)
    with pytest.raises(ph.FormatError, match=f"{scene.name}: no such file"):
        ph.rerender(file)
    assert run("rerender", file, "-q") == 2
    assert run("rerender", file, "-q", "--scene", moved) == 0
    moved.write_text(moved.read_text().replace("0.5", "0.51"))
    with pytest.raises(
        ph.SceneError, match=r"was made of another scene than .* or that has changed"
    ):
        ph.rerender(file, ph.load(moved))


def test_what_does_not_tell_how_it_was_made(tmp_path: Path, scene: Path) -> None:
    picture = ph.render(ph.load(scene), spp=2, noise=1e-3, **SIZE)
    file = tmp_path / "a.exr"
    for bad in ("settings", "camera", "samples", "scene"):
        for value in ("", "{", "[]", '{"eye": 3, "x": 1}', "null", "x"):
            metadata = picture.metadata()
            if bad == "scene" and value:
                continue
            metadata[f"parhelion:{bad}"] = value
            if not value:
                del metadata[f"parhelion:{bad}"]
            file.write_bytes(image.encoded(picture.numpy(), metadata, ".exr"))
            with pytest.raises(ph.FormatError, match=f"{file.name}: does not "):
                ph.rerender(file)
    for text in ("x", image.packed_counts(picture.counts[1:]), "eJwDAAAAAAE="):
        metadata = {**picture.metadata(), image.COUNTS: text}
        file.write_bytes(image.encoded(picture.numpy(), metadata, ".exr"))
        with pytest.raises(ph.FormatError, match="does not tell"):
            ph.rerender(file)
    for source in ('{"path": null, "options": {"x": 1}}', '{"path": "a", "options": []}', "3"):
        metadata = {**picture.metadata(), "parhelion:source": source}
        file.write_bytes(image.encoded(picture.numpy(), metadata, ".exr"))
        with pytest.raises(ph.FormatError, match=r"does not tell|options that there are not"):
            ph.rerender(file)
    with pytest.raises(ph.FormatError, match="no such file"):
        ph.rerender(tmp_path / "no.exr")
    uneven = ph.render(ph.load(scene), counts=np.arange(48 * 27).reshape(27, 48) % 3, **SIZE)
    uneven.save(tmp_path / "a.jpg")
    with pytest.raises(ph.FormatError, match="does not say how many samples each pixel has"):
        ph.rerender(tmp_path / "a.jpg")
    made = ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)])
    ph.render(made, spp=1, **SIZE).save(file)
    with pytest.raises(ph.FormatError, match="does not say where its scene is"):
        ph.rerender(file)
    np.testing.assert_array_equal(ph.rerender(file, made).numpy(), read_picture(file)[0])


def test_another_build_is_told(
    tmp_path: Path, scene: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    ph.render(ph.load(scene), spp=1, **SIZE).save(tmp_path / "a.png")
    monkeypatch.setattr("parhelion._core.sources", "other")
    ph.rerender(tmp_path / "a.png")
    assert "was made by another build of Parhelion; bits may differ" in caplog.text


def test_its_own_file_is_not_overwritten(tmp_path: Path, scene: Path) -> None:
    file = tmp_path / "a.png"
    ph.render(ph.load(scene), spp=1, **SIZE).save(file)
    before = file.read_bytes()
    assert run("rerender", file, "-o", file, "-q") == 2
    assert file.read_bytes() == before


# --- Sequences -----------------------------------------------------------------------------------


def frame(*rows: str) -> str:
    return f"{len(rows)}" + _XYZ[1:] + "".join(f"{row}\n" for row in rows)


FRAMES = [
    frame("H 0 0 0 1", "O 1 0 0 2", "C 0 1 1 3"),
    frame("H 0 0 1 4", "O 1 2 0 2"),
    frame("H 0 0 0 1", "O 1 0 3 9", "C 0 1 1 0"),
]


@pytest.mark.parametrize("which", ["all", "::-1", "1..2", "=-1:"])
def test_frames_of_particles(tmp_path: Path, which: str) -> None:
    data = tmp_path / "a.xyz"
    data.write_text("".join(FRAMES))
    words = ["--color-by", "q", "--view", "iso", "--legend", "--width", "40", "--spp", "2", "-q"]
    frames = ["--frames", which] if which[0] != "=" else [f"--frames{which}"]
    assert run("render", data, *words, *frames, "-o", tmp_path / "b.png") == 0
    files = sorted(tmp_path.glob("b.*.png"))
    assert len(files) == {"all": 3, "::-1": 3, "1..2": 2}.get(which, 1)
    # a file that has become longer, with particles where no view of the others shows them
    data.write_text("".join(FRAMES) + frame("H 90 0 0 50"))
    for file in files:
        assert run("rerender", file, "-q") == 0
    data.write_text("".join(FRAMES[:1]))
    assert run("rerender", files[-1], "-q") == 2


def test_a_turntable_in_the_studios_light(tmp_path: Path) -> None:
    data = tmp_path / "a.xyz"
    data.write_text(FRAMES[0])
    words = ["--width", "40", "--spp", "2", "--ground", "-q"]
    assert run("render", data, *words, "--turntable", "3", "-o", tmp_path / "b.exr") == 0
    moved = data.rename(tmp_path / "c.xyz")
    for k in (1, 2, 3):
        assert run("rerender", tmp_path / f"b.000{k}.exr", "-q", "--scene", moved) == 0
    # of the built-in scene, whose light is its own
    assert run("render", *words[:4], "-q", "--turntable", "2", "-o", tmp_path / "w.png") == 0
    assert run("rerender", tmp_path / "w.0002.png", "-q") == 0


def test_an_animation(tmp_path: Path) -> None:
    """Two triangles, one of which moves, for a second; light and view are found for all frames."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    keys = np.array([0, 1, 0, 0, 0, 2, 1, 3], "<f4").tobytes()
    view, number = {"buffer": 0}, {"componentType": 5126}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [
            {"byteLength": 68, "uri": f"data:;base64,{base64.b64encode(corners + keys).decode()}"}
        ],
        "bufferViews": [
            view | {"byteLength": 36},
            view | {"byteOffset": 36, "byteLength": 32},
        ],
        "accessors": [
            number | {"bufferView": 0, "count": 3, "type": "VEC3", "min": [0] * 3, "max": [1] * 3},
            number | {"bufferView": 1, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            number | {"bufferView": 1, "byteOffset": 8, "count": 2, "type": "VEC3"},
        ],
        "animations": [
            {
                "samplers": [{"input": 1, "output": 2}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
            }
        ],
    }
    data = tmp_path / "a.gltf"
    data.write_text(json.dumps(document))
    words = ["--width", "32", "--spp", "1", "-q", "-o", tmp_path / "b.png"]
    for frames, count in (("all", 4), ("0..0.7..0.1", 8)):
        fps = ["--fps", "3"] if frames == "all" else []
        assert run("render", data, "--frames", frames, *fps, *words) == 0
        files = sorted(tmp_path.glob("b.*.png"))
        assert len(files) == count
        for file in files[:: count - 1]:
            assert run("rerender", file, "-q") == 0


@pytest.mark.parametrize(
    "source",
    [
        {"frames": ["1..2", 7]},
        {"frames": ["x", 0]},
        {"frames": ["1..2", "1"]},
        {"frames": 3},
        {"turned": [[1, 0, 0], [0, 0, 0]]},
        {"turned": 3},
        {"turned": ["x", "y"]},
    ],
)
def test_sources_of_sequences_that_are_none(tmp_path: Path, source: dict[str, Any]) -> None:
    data, file = tmp_path / "a.xyz", tmp_path / "a.png"
    data.write_text("".join(FRAMES))
    picture = ph.render(ph.load(data), spp=1, **SIZE)
    told = {"path": str(data), "options": {}, **source}
    metadata = {**picture.metadata(), "parhelion:source": json.dumps(told)}
    file.write_bytes(image.encoded(picture.srgb(), metadata, ".png"))
    with pytest.raises(
        ph.SceneError, match=r"tells of options|no picture 7 in|frames 'x': a range"
    ):
        ph.rerender(file)
