"""Shards of a picture, made apart from each other, and the one picture of them."""

from __future__ import annotations

import json
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import parhelion as ph
from parhelion import _core, checkpoint, cli, shards
from parhelion.layers import PictureFile
from parhelion.renderer import prepare
from picture_tools import assert_same, read_picture

SIZE = {"width": 100, "height": 57, "spp": 12}


@pytest.fixture(scope="module")
def scene() -> Any:
    return prepare(ph.weekend())


@pytest.fixture(scope="module")
def whole(scene: Any, tmp_path_factory: pytest.TempPathFactory) -> ph.Image:
    kept = tmp_path_factory.mktemp("whole") / "whole.checkpoint"
    return ph.render(scene, checkpoint=kept, features=True, **SIZE)


def parts_of(scene: Any, folder: Path, count: int, **settings: Any) -> list[Path]:
    """Files of all shards."""
    files = [folder / f"{i}-of-{count}.part" for i in range(1, count + 1)]
    for i, file in enumerate(files, 1):
        ph.render(scene, shard=(i, count), checkpoint=file, **{**SIZE, **settings})
    return files


@pytest.fixture(scope="module")
def three(scene: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return parts_of(scene, tmp_path_factory.mktemp("three"), 3)


@given(st.integers(1, 90), st.integers(1, 90), st.booleans(), st.data())
def test_each_block_is_in_one_shard(
    width: int, height: int, reuse_paths: bool, data: st.DataObject
) -> None:
    edge = _core.region if reuse_paths else _core.block
    squares = -(-width // edge) * -(-height // edge)
    count = data.draw(st.integers(1, squares))
    own = [shards.blocks_of((i, count), width, height, reuse_paths) for i in range(1, count + 1)]
    np.testing.assert_array_equal(np.sum(own, axis=0), 1)
    assert own[0].size == shards.block_count(width, height)
    # those whose pixels share paths stay together
    per = edge // _core.block
    sizes = [int(blocks[::per, ::per].sum()) for blocks in own]
    assert max(sizes) - min(sizes) <= 1
    for blocks in own:
        whole = blocks[::per, ::per].repeat(per, axis=0).repeat(per, axis=1)
        np.testing.assert_array_equal(blocks, whole[: blocks.shape[0], : blocks.shape[1]])


@pytest.mark.parametrize("count", [4, 16, 30])  # 30 blocks across: rotated from row to row
def test_no_shard_is_a_few_columns_of_the_picture(count: int) -> None:
    for index in range(1, count + 1):
        own = shards.blocks_of((index, count), 240, 160)
        of_columns = own.sum(axis=0)
        assert of_columns.max() <= 5 * 20 / count + 1
        assert own.sum(axis=1).max() <= 30 / count + 2


def test_shards_have_as_much_to_do(scene: Any, tmp_path: Path) -> None:
    rays = [
        ph.render(scene, width=480, spp=1, shard=(i, 16), checkpoint=tmp_path / str(i)).stats.rays
        for i in range(1, 17)
    ]
    assert max(rays) < 1.1 * np.mean(rays)


@pytest.mark.parametrize("count", [1, 2, 7, 104])
def test_one_picture_of_shards_is_that_of_one_machine(
    scene: Any, whole: ph.Image, tmp_path: Path, count: int
) -> None:
    rng, files = random.Random(count), []
    for i in range(1, count + 1):
        files.append(tmp_path / f"{i}.part")
        part = ph.render(
            scene,
            shard=(i, count),
            checkpoint=files[-1],
            features=True,
            threads=rng.randrange(1, 4),
            tile=rng.randrange(1, 40),
            isa=rng.choice(["", "baseline"]),
            **SIZE,
        )
        own = part.counts > 0
        np.testing.assert_array_equal(part.numpy()[own], whole.numpy()[own])
        assert not part.numpy()[~own].any()
    rng.shuffle(files)
    merged = ph.merge(files)
    assert_same(merged, whole)
    assert merged.stats.samples == whole.stats.samples
    assert merged.stats.rays == whole.stats.rays
    assert merged.stats.error == whole.stats.error
    assert merged.stats.complete
    for file, image in (("one.exr", whole), ("merged.exr", merged)):
        image.save(tmp_path / file)
    one, other = (PictureFile(tmp_path / f) for f in ("one.exr", "merged.exr"))
    assert one.layers.keys() == other.layers.keys()
    of_the_work = {"threads", "seconds", "time", "isa"}
    for key, value in one.metadata.items():
        if key.removeprefix("parhelion:") not in of_the_work and "parhelion" in key:
            assert other.metadata[key] == value, key


@pytest.mark.parametrize(
    "settings",
    [
        {"crop": (13, 5, 61, 40)},
        {"filter": "gaussian", "sampler": "independent", "seed": 7, "integrator": "direct"},
        {"backdrop": (0.1, 0.2, 0.3), "clamp_indirect": 1.0, "max_depth": 3},
        {"reuse_paths": True},
        {"reuse_paths": True, "crop": (13, 5, 61, 40)},
    ],
)
def test_settings_are_those_of_the_shards(
    scene: Any, tmp_path: Path, settings: dict[str, Any]
) -> None:
    camera = ph.Camera(eye=(9, 3, 4), target=(0, 0.5, 0), vfov=30, aperture_radius=0.1)
    settings = {**settings, "camera": camera}
    one = ph.render(scene, checkpoint=tmp_path / "one", **{**SIZE, **settings})
    merged = ph.merge(parts_of(scene, tmp_path, 3, **settings))
    assert_same(merged, one)
    assert (merged.settings, merged.camera) == (one.settings, one.camera)
    plain = ph.render(scene, **{**SIZE, **settings})
    np.testing.assert_array_equal(plain.numpy(), merged.numpy())


@pytest.mark.parametrize("kinds", [False, True])
def test_what_is_known_of_the_scene_is_kept(tmp_path: Path, kinds: bool) -> None:
    atoms = "3\n\nO 0 0 0\nH 1 0 0\nH 0 1 0\n"
    (tmp_path / "water.xyz").write_text(atoms)
    options = ph.LoadOptions(color_by=None if kinds else "x")
    scene = prepare(ph.load(tmp_path / "water.xyz", options))
    one = ph.render(scene, **SIZE)
    merged = ph.merge(parts_of(scene, tmp_path, 2))
    assert merged.legend == one.legend is not None
    assert merged.metadata()["parhelion:source"] == one.metadata()["parhelion:source"]
    merged.save(tmp_path / "m.exr")
    again = ph.rerender(tmp_path / "m.exr")
    np.testing.assert_array_equal(again.numpy(), one.numpy())


def test_a_shard_goes_on_and_further(scene: Any, tmp_path: Path) -> None:
    files = parts_of(scene, tmp_path, 2)
    half = ph.render(
        scene, shard=(2, 2), checkpoint=files[1], resume=True, **{**SIZE, "spp": 4000},
        progress=lambda state: state.samples > 200_000,
    )  # fmt: skip
    assert not half.stats.complete
    with pytest.raises(ph.SceneError, match=r"1-of-2.part|spp is 4000, not 12"):
        ph.merge(files)
    aim = {**SIZE, "spp": 100}
    stopped = ph.render(
        scene,
        shard=(1, 2),
        checkpoint=files[0],
        resume=True,
        **aim,
        progress=lambda s: s.samples > 60_000,
    )
    assert not stopped.stats.complete
    files = [files[0], tmp_path / "other.part"]
    ph.render(scene, shard=(2, 2), checkpoint=files[1], **aim)
    with pytest.raises(ph.SceneError, match=r"1-of-2.part has \d+ of 100 samples .* resume goes"):
        ph.merge(files)
    ph.render(scene, shard=(1, 2), checkpoint=files[0], resume=True, **aim)
    np.testing.assert_array_equal(ph.merge(files).numpy(), ph.render(scene, **aim).numpy())


def test_shards_with_more_samples_than_the_others(
    scene: Any, three: list[Path], tmp_path: Path
) -> None:
    more = tmp_path / "more.part"
    ph.render(scene, shard=(2, 3), checkpoint=more, **{**SIZE, "spp": 20})
    ph.render(scene, shard=(2, 3), checkpoint=more, resume=True, **SIZE)
    with pytest.raises(ph.SceneError, match=r"more.part: .*spp is 20, not 12"):
        ph.merge([three[0], more, three[2]])


def test_what_is_missing_is_named(three: list[Path], scene: Any, tmp_path: Path) -> None:
    with pytest.raises(ph.SceneError, match="of 3 shards 1, 3 are missing"):
        ph.merge(three[1:2])
    with pytest.raises(ph.SceneError, match="of 3 shards 2 is missing"):
        ph.merge([three[2], three[0]])
    ph.render(scene, shard=(9, 50), checkpoint=tmp_path / "a.part", **SIZE)
    with pytest.raises(ph.SceneError, match="of 50 shards 1-8, 10-50 are missing"):
        ph.merge([tmp_path / "a.part"])
    with pytest.raises(ph.SceneError, match="there are none"):
        ph.merge([])


def test_a_shard_that_is_there_twice_is_told(
    three: list[Path], scene: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    merged = ph.merge([three[1], *three])
    assert "2-of-3.part: is given twice" in caplog.text
    other = shutil.copy(three[1], tmp_path / "other.part")
    ph.merge([*three, other])
    assert re.search(r"other\.part: is shard 2/3, as .*2-of-3\.part is", caplog.text)
    np.testing.assert_array_equal(merged.numpy(), ph.render(scene, **SIZE).numpy())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"spp": 13}, "spp is 13, not 12"),
        ({"seed": 3}, "seed is 3, not 0"),
        ({"width": 101}, "width is 101, not 100"),
        ({"features": True}, "features is true, not false"),
        ({"camera": ph.Camera(eye=(9, 3, 4), target=(0, 0, 0))}, "camera is {.*}, not {.*}"),
        ({"shard": (2, 4)}, "one of 4 shards, not of 3"),
    ],
)
def test_shards_of_two_pictures(
    three: list[Path], scene: Any, tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    other = tmp_path / "other.part"
    ph.render(scene, **{"shard": (2, 3), "checkpoint": other, **SIZE, **change})
    with pytest.raises(ph.SceneError, match=f"other.part: is not of the same .*1-of-3.*: .*{told}"):
        ph.merge([three[0], other, three[2]])


def test_shards_of_two_scenes_or_builds(three: list[Path], tmp_path: Path) -> None:
    other = tmp_path / "other.part"
    ph.render(ph.weekend(seed=3), shard=(2, 3), checkpoint=other, **SIZE)
    with pytest.raises(ph.SceneError, match=r"other.part: is not of .*: it is of another scene"):
        ph.merge([three[0], other, three[2]])
    rewritten(three[0], other, lambda header: header["identity"].update(build="x"))
    for parts in ([three[1], other], [other, three[1]]):
        with pytest.raises(ph.SceneError, match=r"other.part: was made by another build"):
            ph.merge(parts)


def rewritten(file: Path, to: Path, change: Any, member: str = "checkpoint.json") -> Path:
    """A copy of a file with another header."""
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(to, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == member:
                header = json.loads(data)
                change(header)
                data = json.dumps(header).encode()
            new.writestr(name, data)
    return to


def test_files_that_are_no_shards(three: list[Path], scene: Any, tmp_path: Path) -> None:
    other = tmp_path / "other.part"

    def refused(told: str) -> None:
        with pytest.raises(ph.SceneError, match=f"^{other}: .*{told}"):
            ph.merge([other, *three])

    with pytest.raises(ph.FormatError, match=r"other.part: cannot be read: No such file"):
        ph.merge([other])
    other.write_bytes(b"PK no")
    refused("is no checkpoint, or a damaged one")
    whole_file = three[0].read_bytes()
    other.write_bytes(whole_file[: len(whole_file) // 2])
    refused("is no checkpoint, or a damaged one")
    at = whole_file.index(b"pixels") + 5000
    other.write_bytes(whole_file[:at] + bytes([whole_file[at] ^ 1]) + whole_file[at + 1 :])
    refused("is no checkpoint, or a damaged one")
    other.unlink()
    ph.render(scene, checkpoint=other, **SIZE)
    refused("is the checkpoint of a whole picture, not of a shard")
    for change, told in (
        ({"shard": "0/3"}, "shard"),
        ({"shard": "1/-3"}, "shard"),
        ({"shard": "1"}, "shard"),
        ({"width": 10**9}, "width"),
        ({"width": 60000, "height": 60000}, "damaged"),
        ({"crop": [0, 0, 300, 300]}, "crop"),
        ({"filter": "mine"}, "unknown filter"),
        ({"camera": {"eye": 3}}, "eye"),
        ({"camera": {"lens": 3}}, "damaged"),
    ):
        rewritten(three[0], other, lambda header, c=change: header["identity"].update(c))
        refused(told)
    for wrong in (None, [], {"names": 3}):
        rewritten(three[0], other, lambda told, w=wrong: told.update(scale=w), "picture.json")
        refused("damaged")


@pytest.mark.parametrize(
    ("member", "change"),
    [
        ("checkpoint.json", lambda header: header["identity"].update(shard=5)),
        ("checkpoint.json", lambda header: header["spent"].update(seconds="x")),
        ("checkpoint.json", lambda header: header["spent"].update(seconds=float("nan"))),
        ("checkpoint.json", lambda header: header["spent"].update(samples=None)),
        ("checkpoint.json", lambda header: header["spent"].clear()),
        ("picture.json", lambda told: told["names"].update(shape_names=7)),
        ("picture.json", lambda told: told.update(scale="much")),
    ],
)
def test_values_of_wrong_kinds_are_damage(
    three: list[Path], tmp_path: Path, member: str, change: Any
) -> None:
    bad = rewritten(three[0], tmp_path / "bad.part", change, member)
    with pytest.raises(ph.FormatError, match=r"bad\.part: is no checkpoint, or a damaged one"):
        ph.merge([bad, *three[1:]])


def test_a_shard_that_cannot_be_written_is_no_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: Any) -> None:
        raise ph.ResourceError("x.part: cannot be written: No space left on device")

    monkeypatch.setattr(checkpoint, "save", full)
    words = ["--width", "32", "--spp", "1", "--shard", "1/2", "-o", str(tmp_path / "x.part")]
    assert cli.main(["render", *words]) == 2
    assert "x.part: cannot be written" in capsys.readouterr().err


def test_any_spoilt_file_is_refused_or_harmless(three: list[Path], tmp_path: Path) -> None:
    rng, good, file = random.Random(5), three[0].read_bytes(), tmp_path / "a.part"
    one = ph.merge(three).numpy()
    for _ in range(60):
        spoilt = bytearray(good)
        for _ in range(rng.randrange(1, 4)):
            at = rng.choice([rng.randrange(len(good)), len(good) - rng.randrange(1, 800)])
            spoilt[at] = rng.randrange(256)
        file.write_bytes(spoilt)
        try:
            np.testing.assert_array_equal(ph.merge([file, *three[1:]]).numpy(), one)
        except ph.SceneError as error:
            told = str(error)
            if str(file) not in told:
                raise


def test_what_cannot_be_asked_of_a_shard(scene: Any, tmp_path: Path) -> None:
    def refused(told: str, **asked: Any) -> None:
        given = {"shard": (1, 2), "checkpoint": tmp_path / "a.part", **SIZE, **asked}
        with pytest.raises(ph.SceneError, match=told):
            ph.render(scene, **given)
        assert not any(tmp_path.iterdir())

    refused("shard needs checkpoint", checkpoint=None)
    refused("noise: a shard does not know", noise=0.1)
    refused("counts: a shard", counts=np.ones((57, 100), np.int64))
    refused("no more shards", shard=(1, 105))
    refused(r"has 104 squares of 8x8 pixels", shard=(1, 105))
    for wrong in (3, (0, 2), (3, 2), (1, 2, 3), ("1", "2"), (1.0, 2), "1/2", (1, 0), (1, 10**9)):
        refused("shard", shard=wrong)
    with pytest.raises(ph.SceneError, match="parts: a list of files is needed, not str"):
        ph.merge("a.part")
    with pytest.raises(ph.SceneError, match=r"parts\[0\]: a path is needed"):
        ph.merge([3])  # type: ignore[list-item]


def test_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    size = ["--width", "64", "--spp", "4", "-q"]
    for i in (1, 2):
        assert cli.main(["render", *size, "--shard", f"{i}/2"]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "weekend.1-of-2.part",
        "weekend.2-of-2.part",
    ]
    parts = ["weekend.1-of-2.part", "weekend.2-of-2.part"]
    assert cli.main(["merge", *parts, "-o", "m.exr", "-q"]) == 0
    assert cli.main(["merge", *parts, "-o", "m.png", "--exposure", "1", "-q"]) == 0
    assert cli.main(["render", *size, "-o", "one.exr"]) == 0
    assert cli.main(["render", *size, "-o", "one.png", "--exposure", "1"]) == 0
    for ending in ("exr", "png"):
        one, merged = (read_picture(tmp_path / f"{n}.{ending}")[0] for n in ("one", "m"))
        np.testing.assert_array_equal(one[..., :3], merged[..., :3])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--shard", "2"], "I/N is needed, such as 1/4"),
        (["--shard", "3/2"], "must lie in [1, 2]"),
        (["--shard", "1/2", "-o", "a.png"], "a.png: --shard makes a file .part"),
        (["--shard", "1/2", "--checkpoint"], "--checkpoint is not for a shard"),
        (["--shard", "1/2", "--denoise"], "--denoise is for whole pictures"),
        (["--shard", "1/2", "--bits", "8"], "--bits is for whole pictures"),
        (["--shard", "1/2", "--exposure", "1"], "--exposure is for whole pictures"),
        (["--shard", "1/2", "--noise", "0.1"], "--noise: a shard does not know"),
        (["--shard", "1/2", "--turntable", "3", "-o", "a.mp4"], "so --shard is for pictures"),
    ],
)
def test_mistakes_of_the_command(
    arguments: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        code = cli.main(["render", "--width", "16", "--spp", "1", *arguments])
    except SystemExit as end:
        code = end.code
    assert code == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_merge_says_what_is_missing(
    three: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "a.exr"
    assert cli.main(["merge", str(three[0]), "-o", str(output)]) == 2
    assert "of 3 shards 2-3 are missing" in capsys.readouterr().err
    assert not output.exists()


def test_shards_of_sequences_are_every_nth_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ["--width", "16", "--spp", "1", "-q", "--turntable", "5", "-o", "t.##.png"]
    assert cli.main(["render", *asked, "--shard", "2/3"]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.02.png", "t.05.png"]
    assert cli.main(["render", *asked, "--shard", "1/3"]) == 0
    before = {p.name: p.stat().st_mtime_ns for p in tmp_path.iterdir()}
    assert cli.main(["render", *asked, "--skip-existing"]) == 0
    assert len(list(tmp_path.iterdir())) == 5
    assert all((tmp_path / n).stat().st_mtime_ns == t for n, t in before.items())


def test_a_killed_shard_goes_on(scene: Any, tmp_path: Path) -> None:
    aim = ["--width", "160", "--spp", "600", "-q", "--checkpoint-every", "0.1s"]
    file = tmp_path / "a.part"
    command = [*(sys.executable, "-m", "parhelion", "render", *aim), *("-o", str(file), "--resume")]
    rng = random.Random(3)
    for _ in range(3):
        process = subprocess.Popen([*command, "--shard", "1/2"])
        until = time.monotonic() + 60
        while not file.exists() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(rng.random())
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert subprocess.run([*command, "--shard", "1/2"], check=False).returncode == 0
    other = tmp_path / "b.part"
    ph.render(scene, width=160, spp=600, shard=(2, 2), checkpoint=other)
    merged = ph.merge([file, other])
    np.testing.assert_array_equal(merged.numpy(), ph.render(scene, width=160, spp=600).numpy())
