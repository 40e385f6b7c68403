"""The frames of trajectories as sequences of scenes and pictures."""

from __future__ import annotations

import gzip
import os
import re
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import cli
from parhelion.framing import placed
from parhelion.io import lammps, text
from parhelion.io.frames import Extent, _Reach, frames_in, load_frames
from parhelion.particles import Labels

SMALL = ["--width", "32", "--spp", "1"]


def xyz(frames: list[np.ndarray], label: str = "A") -> str:
    parts = []
    for rows in frames:
        parts.append(f"{len(rows)}\n\n")
        parts += [f"{label} {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in rows]
    return "".join(parts)


def dump(frames: list[np.ndarray]) -> str:
    parts = []
    for step, rows in enumerate(frames):
        head = f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{len(rows)}\n"
        parts.append(f"{head}ITEM: BOX BOUNDS pp pp pp\n0 1\n0 1\n0 1\nITEM: ATOMS type x y z\n")
        parts += [f"1 {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in rows]
    return "".join(parts)


def moving(count: int = 6, atoms: int = 40) -> list[np.ndarray]:
    """Frames of a cloud that moves and grows."""
    start = np.random.default_rng(2).normal(size=(atoms, 3)).round(3)
    return [start * (1 + 0.5 * k) + [k, 0, -k] for k in range(count)]


def centers(scene: ph.Scene) -> np.ndarray:
    return np.asarray(scene.shapes[0].centers)  # type: ignore[union-attr]


# --- Which frames --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("which", "numbers"),
    [
        (":", range(6)),
        ("all", range(6)),
        ("1:5:2", [1, 3]),
        ("-2:", [4, 5]),
        ("::-2", [5, 3, 1]),
        (" 2 : 99 ", [2, 3, 4, 5]),
        (slice(1, 3), [1, 2]),
        ("1..4", [1, 2, 3, 4]),
        ("0..5..2", [0, 2, 4]),
        ("..", range(6)),
        (" 4 .. ", [4, 5]),
        ("-2..", [4, 5]),
        ("5..1..-2", [5, 3, 1]),
        ("....-3", [5, 2]),
    ],
)
@pytest.mark.parametrize("name", ["a.xyz", "a.xyz.gz", "a.lammpstrj"])
def test_slices(tmp_path: Path, name: str, which: Any, numbers: Any) -> None:
    content = (dump if "lammps" in name else xyz)(moving()).encode()
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    frames = load_frames(tmp_path / name, which)
    assert list(frames.numbers) == list(numbers)
    assert len(frames) == len(list(numbers))
    inclusive = isinstance(which, str) and ".." in which
    assert list(frames.file_numbers) == list(numbers if inclusive else range(1, len(frames) + 1))
    for scene, number in zip(frames, numbers, strict=True):
        assert_allclose(centers(scene), moving()[number], atol=1e-9)
        assert scene.name == f"{name}, frame {number}"


@pytest.mark.parametrize(
    ("which", "told"),
    [
        ("5", "frames '5': a range such as 1..240 or 1..240..2, a slice such as 10:"),
        ("1:2:0", "a slice such as"),
        ("1:b", "a slice such as"),
        (slice(None, None, 0), r"frames slice\(None, None, 0\): a range such as"),
        (slice("a"), "a slice such as"),
        (slice(0.5), "a slice such as"),
        ("::::", "a slice such as"),
        ("1..2..3..4", "a slice such as"),
        ("1..2..0", "a slice such as"),
        ("1..6", r"a\.xyz: frames 1\.\.6: there is no frame 6; there are 0 to 5"),
        ("-7..", "there is no frame -7; there are 0 to 5"),
        ("4..2", "of 6 frames none is in 4..2"),
        ("6:", r"a\.xyz: of 6 frames none is in 6:"),
        ("4:2:1", "of 6 frames none is in 4:2:1"),
    ],
)
def test_frames_that_are_not_there(tmp_path: Path, which: Any, told: str) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    with pytest.raises(ph.SceneError, match=told):
        load_frames(tmp_path / "a.xyz", which)


def test_single_frames(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    frames = load_frames(tmp_path / "a.xyz", "1:5")
    scenes = list(frames)
    for place, scene in ((0, frames[0]), (2, frames[2]), (3, frames[-1])):
        np.testing.assert_array_equal(scene.shapes[0].centers, scenes[place].shapes[0].centers)
    for place in (4, -5):
        with pytest.raises(IndexError, match="there are 4 frames"):
            frames[place]


def test_a_format_without_frames(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    known = r"choices: \.xyz, .*\.gro, \.gltf, \.glb, \.usd, \.usda, \.usdc, \.usdz"
    with pytest.raises(ph.FormatError, match=rf"frames of .* files are not read \({known}\)"):
        load_frames(tmp_path / "a.json")
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    with pytest.raises(ph.SceneError, match="the option 'frame' is of one frame"):
        load_frames(tmp_path / "a.xyz", ":", ph.LoadOptions(frame=1))


def test_a_later_frame_that_is_broken_is_told_at_once(tmp_path: Path) -> None:
    content = xyz(moving()).splitlines()
    content[42 * 4 + 5] = "A 1 2 three"
    (tmp_path / "a.xyz").write_text("\n".join(content))
    with pytest.raises(ph.FormatError, match=r"a\.xyz: line 174: .*'three' is not a number"):
        load_frames(tmp_path / "a.xyz")
    assert len(load_frames(tmp_path / "a.xyz", ":4")) == 4


@pytest.mark.parametrize("name", ["gsd/lj.gsd", "xyz/2r9r-1b.xyz"])
def test_real_trajectories(shared_scenes: Path, name: str) -> None:
    if name.endswith(".gsd"):
        pytest.importorskip("gsd")
    path = shared_scenes / "particles" / name
    frames = load_frames(path, "::-1")
    assert len(frames) > 1
    for scene, number in zip(frames, range(len(frames) - 1, -1, -1), strict=True):
        alone = ph.load(path, ph.LoadOptions(frame=number))
        assert_array_equal(centers(scene), centers(alone))


def test_models_of_a_pdb_file(tmp_path: Path) -> None:
    pytest.importorskip("chemfiles")
    atom = "HETATM{:5d}  O   HOH A   1    {:8.3f}{:8.3f}{:8.3f}  1.00  0.00           O\n"
    models = [
        f"MODEL     {k + 1:4d}\n" + atom.format(1, k, 0, 0) + atom.format(2, k, 2, 0) + "ENDMDL\n"
        for k in range(3)
    ]
    (tmp_path / "a.pdb").write_text("".join(models) + "END\n")
    for scene, number in zip(load_frames(tmp_path / "a.pdb", "::-1"), (2, 1, 0), strict=True):
        assert_allclose(centers(scene), [(number, 0, 0), (number, 2, 0)])


def test_which_frames_there_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    assert frames_in(tmp_path / "a.xyz") == Extent("frames", 0, 5, None)
    assert cli.main(["info", str(tmp_path / "a.xyz")]) == 0
    assert "frames: 0 to 5\n" in capsys.readouterr().out
    (tmp_path / "a.xyz").write_text(xyz(moving(1)))
    assert cli.main(["info", str(tmp_path / "a.xyz")]) == 0
    assert "frames:" not in capsys.readouterr().out
    (tmp_path / "a.json").write_text('{"parhelion": 1}')
    assert frames_in(tmp_path / "a.json") is None


# --- What frames have in common ------------------------------------------------------------------


@pytest.mark.parametrize("aspect", [0.6, 1.0, 16 / 9])
def test_the_camera_stays_and_shows_every_frame_whole(tmp_path: Path, aspect: float) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    scenes = list(load_frames(tmp_path / "a.xyz", ":", ph.LoadOptions(radius=0.4)))
    cameras = [placed(scene, aspect) for scene in scenes]
    assert len(set(cameras)) == 1
    everything = ph.Spheres(np.concatenate(moving()), 0.4)
    view = scenes[0].camera
    assert isinstance(view, ph.Framing)
    alone = ph.Framing(view.direction, view.up, view.vfov, view.fill)
    whole = ph.Scene([everything], camera=alone)
    best = placed(whole, aspect)
    size = np.linalg.norm(np.subtract(best.eye, best.target))
    assert_allclose(cameras[0].eye, best.eye, atol=0.01 * size)


def test_none_of_many_spheres_reaches_beyond_those_that_are_kept() -> None:
    random = np.random.default_rng(5)
    parts = [
        (random.normal(size=(5000, 3)).astype(np.float32), random.uniform(0, 0.5, 5000)),
        (random.uniform(-3, 3, (777, 3)) * [1, 1, 0], np.float64(0.0)),
        (np.array([[9.0, 0, 0]]), np.float64(0.25)),
    ]
    reach = _Reach()
    reach.add(parts)
    kept = reach.spheres()
    assert len(kept.centers) < 400
    for direction in reach._directions:
        most = max(float((c @ direction + r).max()) for c, r in parts)
        ours = (kept.centers @ direction + kept.radii).max()  # type: ignore[operator]
        assert ours == pytest.approx(most, rel=1e-6)


def test_light_and_ground_stay(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    scenes = list(load_frames(tmp_path / "a.xyz", ":", ph.LoadOptions(ground=True)))
    for scene in scenes:
        assert [shape.name for shape in scene.shapes] == ["particles", "key light", "ground"]
        assert scene.shapes[1:] == scenes[0].shapes[1:]
        assert scene.background == scenes[0].background
    radius = scenes[0].shapes[0].radii[0]
    lowest = min(frame[:, 2].min() for frame in moving()) - radius
    assert_allclose(scenes[0].shapes[2].centers[0][2], lowest, rtol=1e-6)


def test_a_frame_written_as_a_scene_has_the_camera_of_all(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    scene = next(iter(load_frames(tmp_path / "a.xyz")))
    ph.save(scene, tmp_path / "a.json")
    again = ph.load(tmp_path / "a.json")
    assert again.camera == placed(scene, 640 / 360)


def test_one_frame_is_nearly_the_still(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    (scene,) = load_frames(tmp_path / "a.xyz", "3:4")
    alone = ph.load(tmp_path / "a.xyz", ph.LoadOptions(frame=3))
    ours, theirs = placed(scene, 1.5), placed(alone, 1.5)
    size = np.linalg.norm(np.subtract(theirs.eye, theirs.target))
    assert_allclose(ours.eye, theirs.eye, atol=0.01 * size)
    assert_array_equal(scene.shapes[0].colors, alone.shapes[0].colors)
    assert_array_equal(scene.shapes[0].radii, alone.shapes[0].radii)


def test_estimated_radii_are_those_of_the_first_frame(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    first = ph.load(tmp_path / "a.xyz").shapes[0].radii[0]
    last = ph.load(tmp_path / "a.xyz", ph.LoadOptions(frame=-1)).shapes[0].radii[0]
    assert last > 2 * first
    for scene in load_frames(tmp_path / "a.xyz", "::-1"):
        assert_array_equal(scene.shapes[0].radii, np.full(40, first))


def test_colours_mean_the_same_in_every_frame(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    options = ph.LoadOptions(color_by="x")
    scenes = list(load_frames(tmp_path / "a.xyz", ":", options))
    ends = np.array([np.percentile(frame[:, 0], (1, 99)) for frame in moving()])
    low, high = ends[:, 0].min(), ends[:, 1].max()
    for scene in scenes:
        assert scene.legend == scenes[0].legend
        assert isinstance(scene.legend, ph.ColorBar)
        assert_allclose((scene.legend.low, scene.legend.high), (low, high), atol=1e-6)
    given = ph.LoadOptions(color_by="x", color_range=(scenes[0].legend.low, scenes[0].legend.high))
    for number, scene in enumerate(load_frames(tmp_path / "a.xyz", ":", given)):
        assert_array_equal(scene.shapes[0].colors, scenes[number].shapes[0].colors)
    # one value in all frames is no range
    still = [frame * [1, 1, 0] for frame in moving()]
    (tmp_path / "b.xyz").write_text(xyz(still))
    flat = load_frames(tmp_path / "b.xyz", ":", ph.LoadOptions(color_by="z"))
    assert len({tuple(scene.shapes[0].colors[0]) for scene in flat}) == 1


def test_kinds_keep_their_colours_when_others_come_and_go(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(
        "1\n\nbead 0 0 0\n2\n\nbead 0 0 0\nanchor 1 0 0\n1\n\nanchor 2 0 0\n"
    )
    first, second, third = load_frames(tmp_path / "a.xyz")
    assert_array_equal(first.shapes[0].colors[0], second.shapes[0].colors[0])
    assert_array_equal(third.shapes[0].colors[0], second.shapes[0].colors[1])
    assert (second.shapes[0].colors[0] != second.shapes[0].colors[1]).any()


# --- Reading -------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["", ".gz"])
def test_the_time_to_read_grows_with_the_file_alone(
    tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = xyz(moving(60)).encode()
    path = tmp_path / f"a.xyz{ending}"
    path.write_bytes(gzip.compress(content) if ending else content)
    monkeypatch.setattr(text, "_BLOCK", 1 << 10)
    read: list[int] = []
    plain = text.TextFile._read

    def counted(self: text.TextFile) -> bytes:
        part = plain(self)
        read.append(len(part))
        return part

    monkeypatch.setattr(text.TextFile, "_read", counted)
    assert len(list(load_frames(path))) == 60
    # an index and a pass over the frames, twice; a block is read again for a frame in its middle
    assert 4 * len(content) <= sum(read) < 4.5 * len(content) + 60 * (1 << 11)


@pytest.mark.parametrize("content", ["", "\n\n", "junk\n", "2\n\nA 0 0 0\n"])
def test_broken_trajectories(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.xyz").write_text(content)
    with pytest.raises(ph.FormatError, match=r"a\.xyz: "):
        load_frames(tmp_path / "a.xyz")


def test_a_byte_order_mark(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("\ufeff" + xyz(moving(2)), encoding="utf-8")
    assert [len(centers(scene)) for scene in load_frames(tmp_path / "a.xyz", "::-1")] == [40, 40]


def test_a_large_frame_takes_little_more_memory_than_its_arrays(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).normal(size=(60_000, 3))
    (tmp_path / "a.dump").write_text(dump([rows]))
    tracemalloc.start()
    try:
        particles = lammps.read(tmp_path / "a.dump")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert particles.types is not None
    size = particles.positions.nbytes + particles.types.codes.nbytes
    # besides the columns that the positions are made of, a block of text, as lines, and its numbers
    assert peak < size + rows.nbytes + 8 * (1 << 20)


def test_a_count_that_lies_asks_for_no_memory(tmp_path: Path) -> None:
    lie = dump([np.zeros((3, 3))]).replace("OF ATOMS\n3", "OF ATOMS\n900000000000000000")
    (tmp_path / "a.dump").write_text(lie)
    with pytest.raises(ph.FormatError, match="the file ends after 3 of 900000000000000000 atoms"):
        lammps.read(tmp_path / "a.dump")


@pytest.mark.parametrize(
    ("values", "names", "codes"),
    [
        ([3, 1, 3], ("1", "3"), [1, 0, 1]),
        ([-1, 5, 0], ("-1", "0", "5"), [0, 2, 1]),
        ([2e9, 1, 1], ("1", "2000000000"), [1, 0, 0]),
        ([1.5, 1, 1], ("1.0", "1.5"), [1, 0, 0]),
        ([], (), []),
    ],
)
def test_types_by_number(values: list[float], names: tuple[str, ...], codes: list[int]) -> None:
    labels = Labels.of_numbers(np.array(values, np.float64))
    assert labels.names == names
    assert_array_equal(labels.codes, codes)


def test_lines_that_do_not_fit_are_named(tmp_path: Path) -> None:
    lines = dump([np.zeros((30, 3))]).splitlines()
    for line, told in {
        "1 0 0": "line 20: has 3 columns, not 4",
        "1 0 0 0 0": "line 20: has 5 columns, not 4",
        "1 0 x 0": r"line 20: column 3 \(y\): 'x' is not a number",
        "1 0 1_0 0": r"line 20: column 3 \(y\): '1_0' is not a number",
        "1 0 0 \u0661": r"line 20: column 4 \(z\): '\u0661' is not a number",
        "1 0\xa00 0": "line 20: has 3 columns, not 4",
        "": "line 20: has 0 columns, not 4",
    }.items():
        lines[19] = line
        (tmp_path / "a.dump").write_text("\n".join(lines), encoding="utf-8")
        with pytest.raises(ph.FormatError, match=told):
            lammps.read(tmp_path / "a.dump")


# --- The command ---------------------------------------------------------------------------------


def test_pictures_of_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(xyz(moving()))
    words = ["render", str(path), *SMALL, "--frames=-4::2", "-o", str(tmp_path / "f.png")]
    assert cli.main(words) == 0
    said = capsys.readouterr().err
    assert re.fullmatch(r".*f\.png: 2 pictures, 32x18, 1 spp in \S+ s\n", said)
    assert sorted(os.listdir(tmp_path)) == ["a.xyz", "f.0001.png", "f.0002.png"]
    scenes = ph.load_frames(path, "2::2")
    count = ph.save_sequence(
        (ph.render(scene, width=32, spp=1) for scene in scenes), tmp_path / "g.png"
    )
    assert count == 2
    from picture_tools import read_picture

    for k in (1, 2):
        ours, theirs = (read_picture(tmp_path / f"{n}.000{k}.png")[0] for n in "fg")
        assert_array_equal(ours, theirs)


def test_ranges_of_the_same_frames_give_files_that_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.xyz"
    start = moving(1)[0]
    path.write_text(xyz([start * size for size in (1.0, 0.5, 0.4, 0.3, 1.0)]))
    words = ["render", str(path), *SMALL, "-o", str(tmp_path / "f-##.png"), "--frames"]
    assert cli.main([*words, "0..4..4"]) == 0
    assert sorted(os.listdir(tmp_path)) == ["a.xyz", "f-00.png", "f-04.png"]
    before = (tmp_path / "f-04.png").stat().st_ino
    capsys.readouterr()
    assert cli.main([*words, "0..4", "--skip-existing"]) == 0
    assert "f-##.png: 3 pictures (2 more were there), 32x18" in capsys.readouterr().err
    assert len(os.listdir(tmp_path)) == 6
    assert (tmp_path / "f-04.png").stat().st_ino == before
    # seen from elsewhere, or another frame: slices count from 1
    for which in ("1..3", "0:3"):
        assert cli.main([*words, which, "--skip-existing"]) == 0
        assert "f-##.png: 3 pictures, 32x18" in capsys.readouterr().err


def test_frames_whose_pictures_are_there_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(xyz(moving()))
    frames = load_frames(path, "1..5")
    path.write_text(xyz(moving(5)))  # the last frame is gone
    scenes = list(frames.scenes([3, 1]))
    assert [scene.name for scene in scenes] == ["a.xyz, frame 4", "a.xyz, frame 2"]
    with pytest.raises(ph.SceneError, match="has become shorter"):
        list(frames)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("a.xyz --frames 9:", "a.xyz: of 6 frames none is in 9:"),
        ("a.xyz --frames 9", "a.xyz: --frames '9': a range such as"),
        ("a.xyz --frames : --turntable 3", "--turntable and --frames are two sequences"),
        ("a.xyz --frames : --frame 2", "the option '--frame' is of one frame; give --frames or"),
        ("a.xyz --frames : --color-by speed", "unknown field to colour by 'speed'"),
        ("--frames :", "--frames needs a file"),
    ],
)
def test_frames_without_meaning(
    words: str,
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.xyz").write_text(xyz(moving()))
    assert cli.main(["render", *SMALL, *words.split(), "-o", "f.png"]) == 2
    assert told in capsys.readouterr().err
    assert os.listdir() == ["a.xyz"]
