"""Renderings that go on where they were: after a stop, after SIGKILL, after a full disk."""

from __future__ import annotations

import fcntl
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import checkpoint, cli
from parhelion.renderer import prepare
from picture_tools import assert_same, read_picture

SIZE = {"width": 48, "height": 27}


@pytest.fixture(scope="module")
def spheres() -> Any:
    return prepare(ph.weekend())


@pytest.mark.parametrize("goal", [{"spp": 200}, {"noise": 0.2}, {"spp": 60, "features": True}])
def test_stops_anywhere_change_nothing(spheres: Any, tmp_path: Path, goal: dict[str, Any]) -> None:
    whole = ph.render(spheres, checkpoint=tmp_path / "whole", **goal, **SIZE)
    samples, rng, rounds = 0, random.Random(1), 0
    while True:
        more = rng.randrange(2000, 60000)
        image = ph.render(
            spheres,
            checkpoint=tmp_path / "a.checkpoint",
            checkpoint_every=0.02,
            resume=True,
            progress=lambda state, until=samples + more: state.samples >= until,
            threads=rng.randrange(1, 4),
            tile=rng.randrange(1, 20),
            **goal,
            **SIZE,
        )
        assert image.stats.samples >= samples
        samples, rounds = image.stats.samples, rounds + 1
        if image.stats.complete:
            break
    assert rounds > 1
    assert_same(whole, image)
    assert samples == whole.stats.samples == image.counts.sum()
    assert image.stats.ended == whole.stats.ended
    assert sorted(os.listdir(tmp_path)) == ["a.checkpoint", "whole"]


def test_what_is_done_can_be_taken_further(spheres: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.checkpoint"
    for goal in ({"spp": 6}, {"spp": 25}, {"spp": 20, "noise": 0.9}, {"spp": 64}):
        image = ph.render(spheres, checkpoint=file, resume=True, **goal, **SIZE)
    assert_same(image, ph.render(spheres, spp=64, checkpoint=tmp_path / "b", **SIZE))
    less = ph.render(spheres, checkpoint=file, resume=True, spp=3, **SIZE)  # nothing is lost
    assert (less.stats.complete, less.counts.min()) == (True, 64)
    finer = ph.render(spheres, checkpoint=file, resume=True, noise=0.15, **SIZE)
    assert finer.stats.ended == "noise"
    assert finer.counts.min() == 64


def test_only_checkpoints_are_replaced_and_only_by_what_goes_on(
    spheres: Any, tmp_path: Path
) -> None:
    file = tmp_path / "a.checkpoint"
    ph.render(spheres, checkpoint=file, spp=9, **SIZE)
    for content, said in (
        (file.read_bytes(), "is there already; resume goes on from it"),
        (b"{}", "is there already, and is no checkpoint"),
        (b"", "is there already, and is no checkpoint"),
    ):
        file.write_bytes(content)
        with pytest.raises(ph.SceneError, match=said):
            ph.render(spheres, checkpoint=file, spp=1, **SIZE)
        assert file.read_bytes() == content
    os.mkfifo(tmp_path / "pipe")
    for place in ("/dev/zero", tmp_path / "pipe"):  # which may never end
        for resume in (False, True):
            with pytest.raises(ph.FormatError, match=f"{place}: is not a regular file"):
                ph.render(spheres, checkpoint=place, resume=resume, spp=1, **SIZE)
    with pytest.raises(ph.SceneError, match="checkpoint: a path is needed, not int"):
        ph.render(spheres, checkpoint=3, spp=1, **SIZE)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 5}, "was begun with seed 0, not 5"),
        ({"width": 50}, "was begun with width 48, not 50"),
        (
            {"max_depth": 3, "sampler": "independent"},
            "max_depth 50, not 3; with sampler sobol, not ind",
        ),
        ({"crop": (0, 0, 4, 4)}, "was begun without crop, not with 0,0,4,4"),
        ({"features": True}, "was begun with features False, not True"),
        ({"camera": ph.Camera(eye=(9, 9, 9))}, 'was begun with camera {"eye": ['),
    ],
)
def test_another_picture_is_refused(
    spheres: Any, tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    file = tmp_path / "a.checkpoint"
    ph.render(spheres, checkpoint=file, spp=1, **SIZE)
    before = file.read_bytes()
    with pytest.raises(ph.SceneError) as caught:
        ph.render(spheres, checkpoint=file, resume=True, spp=2, **{**SIZE, **change})
    assert str(caught.value).startswith(f"{file}: was begun with")
    assert said in str(caught.value)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("begun", "now", "said"),
    [
        ("", "--features", "without --features, not with it"),
        ("--features", "", "with --features, not without it"),
        ("", "--no-roulette", "without --no-roulette, not with it"),
        ("--no-roulette", "", "with --no-roulette, not without it"),
        ("--crop 1,2,9,6", "", "with --crop 1,2,9,6, not without it"),
        (
            "--seed 3",
            "--ao-distance 2",
            "with --seed 3, not 0; without --ao-distance, not with 2.0",
        ),
    ],
)
def test_flags_are_told_as_they_are_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], begun: str, now: str, said: str
) -> None:
    words = ["render", "--width", "16", "--spp", "1", "-q", "-o", str(tmp_path / "a.exr")]
    words += ["--checkpoint", "--resume"]
    assert cli.main([*words, *begun.split()]) == 0
    assert cli.main([*words, *now.split()]) == 2
    assert f"a.exr.checkpoint: was begun {said}\n" in capsys.readouterr().err


def test_another_scene_or_build_is_refused(
    spheres: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.checkpoint"
    ph.render(spheres, checkpoint=file, spp=1, **SIZE)
    with pytest.raises(ph.SceneError, match="was begun with another scene, or it has changed"):
        ph.render(ph.weekend(seed=2), checkpoint=file, resume=True, spp=2, **SIZE)
    for name, said in (
        ("parhelion._core.sources", "was begun by another build of Parhelion"),
        ("parhelion.__version__", "was begun by version .* of Parhelion, and this is other"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(name, "other")
            with pytest.raises(ph.SceneError, match=said):
                ph.render(spheres, checkpoint=file, resume=True, spp=2, **SIZE)


def test_builds_that_knew_fewer_settings_are_told(spheres: Any, tmp_path: Path) -> None:
    files = [tmp_path / "whole", tmp_path / "part"]
    for file, shard in zip(files, (None, (1, 2)), strict=True):
        ph.render(spheres, checkpoint=file, shard=shard, spp=1, **SIZE)
        with zipfile.ZipFile(file) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        header = json.loads(members[checkpoint.HEADER])
        del header["identity"]["roulette"]
        header["identity"]["build"] = "older"
        members[checkpoint.HEADER] = json.dumps(header).encode()
        with zipfile.ZipFile(file, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
    with pytest.raises(ph.SceneError, match="whole: was begun by another build of Parhelion"):
        ph.render(spheres, checkpoint=files[0], resume=True, spp=2, **SIZE)
    with pytest.raises(ph.SceneError, match="part: was made by another build of Parhelion"):
        ph.merge(files[1:])


def test_what_is_no_checkpoint_is_refused(spheres: Any, tmp_path: Path) -> None:
    file = tmp_path / "a.checkpoint"
    ph.render(spheres, checkpoint=file, spp=3, **SIZE)
    whole, rng = file.read_bytes(), random.Random(1)
    spoilt = [b"", b"PK", whole[:-1], whole[:100], whole[: len(whole) // 2], b"x" * 1000]
    for _ in range(40):  # one bit that is another
        at = rng.randrange(len(whole))
        spoilt.append(whole[:at] + bytes([whole[at] ^ (1 << rng.randrange(8))]) + whole[at + 1 :])
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name in members:
        for changed in (None, b"", members[name] + b"x", members[name][:-1], b"[]", b"{}", b"\xff"):
            with zipfile.ZipFile(tmp_path / "b", "w") as archive:
                for other, data in members.items():
                    if other != name:
                        archive.writestr(other, data)
                    elif changed is not None:
                        archive.writestr(other, changed)
            if changed != members[name]:
                spoilt.append((tmp_path / "b").read_bytes())
    header = json.loads(members["checkpoint.json"])
    strange = [{**header, "spent": {**header["spent"], "samples": "a"}}, {**header, "spent": 3}]
    strange += [{**header, "spent": {**header["spent"], "seconds": float("nan")}}]
    far = b"\xff" * len(members["done"])
    more = [{"checkpoint.json": json.dumps(h).encode()} for h in strange]
    for made in [*more, {"done": far}, {"targets": far}]:
        with zipfile.ZipFile(tmp_path / "b", "w") as archive:
            for name, data in {**members, **made}.items():
                archive.writestr(name, data)
        file.write_bytes((tmp_path / "b").read_bytes())
        with pytest.raises(ph.FormatError, match="is no checkpoint, or a damaged one"):
            ph.render(spheres, checkpoint=file, resume=True, spp=3, **SIZE)
    expected = ph.render(spheres, checkpoint=tmp_path / "c", spp=3, **SIZE)
    refused = 0
    for data in spoilt:
        file.write_bytes(data)
        try:
            image = ph.render(spheres, checkpoint=file, resume=True, spp=3, **SIZE)
        except ph.SceneError as error:
            refused += str(error).startswith(f"{file}: ")
            assert file.read_bytes() == data
        else:  # what was spoilt means nothing: the time within the archive, say
            assert_same(image, expected)
    assert refused > len(spoilt) - 10


@pytest.mark.parametrize(
    ("place", "error", "said"),
    [("no/a", ph.ResourceError, "there is no folder"), (".", ph.ResourceError, "is a folder")],
)
def test_places_that_cannot_be_written_are_told_before_the_work(
    spheres: Any, tmp_path: Path, place: str, error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        ph.render(spheres, checkpoint=tmp_path / place, spp=2**20, **SIZE)


def test_a_checkpoint_that_fails_is_told_and_the_picture_is_made(
    spheres: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    image = ph.render(spheres, checkpoint=tmp_path / "a", spp=2, **SIZE)
    assert image.stats.ended == "spp"
    assert f"{tmp_path / 'a'}: cannot be written: No space left on device" in caplog.text
    assert os.listdir(tmp_path) == []


def test_ctrl_c_in_a_program_keeps_what_there_is(spheres: Any, tmp_path: Path) -> None:
    def stop(state: ph.Progress) -> None:
        if state.samples > 48 * 27 * 6:
            raise KeyboardInterrupt

    file = tmp_path / "a"
    with pytest.raises(KeyboardInterrupt):
        ph.render(spheres, checkpoint=file, progress=stop, spp=10**6, **SIZE)
    image = ph.render(spheres, checkpoint=file, resume=True, spp=40, **SIZE)
    assert_same(image, ph.render(spheres, checkpoint=tmp_path / "b", spp=40, **SIZE))


# --- Faults --------------------------------------------------------------------------------------

RENDER = (sys.executable, "-m", "parhelion", "render")
COMMAND = "--width 96 --height 54 --noise 0.1 -q --checkpoint --checkpoint-every 0.1s --resume"


def command(folder: Path, *more: str) -> list[str]:
    return [*RENDER, *COMMAND.split(), "-o", str(folder / "a.exr"), *more]


def test_killed_and_resumed_it_is_the_same_picture(tmp_path: Path, long: bool) -> None:
    kills, wanted = 0, 50 if long else 4
    noise = "0.01" if long else "0.025"  # work enough to be killed so often in it
    (tmp_path / "whole").mkdir()
    subprocess.run(command(tmp_path / "whole", "--noise", noise), check=True)
    rng, file = random.Random(), tmp_path / "a.exr.checkpoint"
    while True:
        with subprocess.Popen(command(tmp_path, "--noise", noise)) as process:
            try:
                # from the start of Python to some passes later
                code = process.wait(0.1 + 0.7 * rng.random() if kills < wanted else None)
            except subprocess.TimeoutExpired:
                process.kill()
                code = process.wait()
        if code == 0:
            break
        assert code == -signal.SIGKILL
        kills += 1
        if file.exists():  # whole at every moment
            with zipfile.ZipFile(file) as archive:
                assert archive.testzip() is None
    assert kills >= wanted / 2
    (pixels, told), (expected, others) = (
        read_picture(folder / "a.exr") for folder in (tmp_path, tmp_path / "whole")
    )
    np.testing.assert_array_equal(pixels, expected)
    for name in ("samples", "scene", "error", "ended"):
        assert told[f"parhelion:{name}"] == others[f"parhelion:{name}"]


WATCHED = """
import sys
import parhelion as ph

def told(progress):
    print(progress.samples, progress.seconds, flush=True)

ph.render(ph.weekend(), width=160, height=90, spp=10**7, checkpoint=sys.argv[1],
          checkpoint_every=float(sys.argv[2]), progress=told)
"""


def test_no_more_than_one_interval_is_lost(tmp_path: Path) -> None:
    """And a pass, and the time to write it: a second here, for a machine that is busy."""
    interval, end = 0.4, 2.0 + random.Random().random()
    file = tmp_path / "a"
    words = [sys.executable, "-c", WATCHED, str(file), str(interval)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        samples = seconds = 0.0
        assert process.stdout is not None
        for line in process.stdout:
            samples, seconds = map(float, line.split())
            if seconds > end:
                process.kill()
        assert process.wait() == -signal.SIGKILL
    kept = ph.render(
        ph.weekend(), width=160, height=90, spp=10**7, checkpoint=file, resume=True,
        progress=lambda _: True,
    ).stats.samples  # fmt: skip
    assert (1.0 - kept / samples) * seconds < interval + 1.0


def test_the_command_goes_on_after_ctrl_c(tmp_path: Path) -> None:
    file = tmp_path / "a.exr.checkpoint"
    with subprocess.Popen(command(tmp_path, "--noise", "0.001"), stderr=subprocess.PIPE) as process:
        while not file.exists():
            assert process.poll() is None
            time.sleep(0.05)
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert b"error " in said
    assert said.endswith(f"; the same command with --resume goes on from {file}\n".encode())
    _, told = read_picture(tmp_path / "a.exr")
    assert told["parhelion:ended"] == "stopped"
    spp = str(int(told["parhelion:samples"]) // (96 * 54) + 5)
    subprocess.run(command(tmp_path, "--noise", "0.001", "--spp", spp), check=True)
    _, more = read_picture(tmp_path / "a.exr")
    assert int(more["parhelion:samples"]) >= int(told["parhelion:samples"])


def test_files_of_killed_writers_go(spheres: Any, tmp_path: Path) -> None:
    left, held = (tmp_path / f".parhelion-{name}.checkpoint" for name in ("left", "held"))
    left.write_bytes(b"half of it")
    with held.open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)  # another process is writing it
        ph.render(spheres, checkpoint=tmp_path / "a", spp=1, **SIZE)
        assert sorted(p.name for p in tmp_path.iterdir()) == [held.name, "a"]


def test_more_samples_than_asked_for_are_told(
    spheres: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "a"
    ph.render(spheres, checkpoint=file, spp=9, **SIZE)
    again = ph.render(spheres, checkpoint=file, resume=True, spp=4, **SIZE)
    assert "has up to 9 spp already, more than 4" in caplog.text
    assert again.settings.spp == 9
    assert again.metadata()["parhelion:spp"] == "9"
    assert_same(again, ph.render(spheres, checkpoint=tmp_path / "b", spp=9, **SIZE))


def test_time_limits_of_the_command(tmp_path: Path) -> None:
    begin = time.monotonic()
    done = subprocess.run(
        [*RENDER, "--width", "96", "--time-limit", "0.02m", "-o", str(tmp_path / "a.exr")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert time.monotonic() - begin < 6
    assert ", error " in done.stderr
    _, told = read_picture(tmp_path / "a.exr")
    assert told["parhelion:ended"] == "time"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--time-limit 0", "'0': a time such as 90, 90s, 15m or 2h is needed"),
        ("--time-limit soon", "'soon': a time such as 90, 90s, 15m or 2h is needed"),
        ("--checkpoint-every -3s", "expected one argument"),
        ("--checkpoint-every=infs", "'infs': a time such as"),
        ("--checkpoint-every 5", "--checkpoint-every needs --checkpoint"),
        ("--noise x", "invalid float value: 'x'"),
        ("--noise 0 --spp 1", "--noise is 0.0; must be > 0"),
        ("--turntable 3 --checkpoint", "--checkpoint and --resume are for one picture"),
        ("--turntable 3 --resume", "--checkpoint and --resume are for one picture"),
    ],
)
def test_mistakes_of_the_command(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: str, said: str
) -> None:
    from parhelion import cli

    try:
        code = cli.main(["render", "-o", str(tmp_path / "a.png"), *words.split()])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert said in capsys.readouterr().err


def test_the_picture_is_no_checkpoint(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from parhelion import cli

    for name in ("a.png", "a.noisy.png"):
        words = ["-o", str(tmp_path / "a.png"), "--checkpoint", str(tmp_path / name), "--spp", "1"]
        assert cli.main(["render", *words]) == 2
        assert "is what the picture is written to" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


SCRIPT = """
import ctypes, errno, io, os, sys, zipfile
import parhelion as ph
from parhelion.image import read_pixels
from parhelion.renderer import prepare

folder = sys.argv[1]
shim = ctypes.CDLL(None)
spheres, old, new = prepare(ph.weekend()), folder + "/old", folder + "/new"
size = {"width": 16, "height": 9}
images = [ph.render(spheres, spp=spp, **size) for spp in (1, 2)]

def same_pixels(a, b):
    return (read_pixels(a) == read_pixels(b)).all()

def checkpointed(spp):
    ph.render(spheres, checkpoint=folder + "/a.checkpoint", resume=True, spp=spp, **size)

def film(data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:  # all but what tells of seconds
        return {n: archive.read(n) for n in archive.namelist() if not n.endswith(".json")}

def saved(ending):
    def save(spp):
        images[spp - 1].save(folder + "/a" + ending)
    return save

for name, write in (
    ("a.checkpoint", checkpointed), ("a.png", saved(".png")), ("a.exr", saved(".exr"))
):
    file = os.path.join(folder, name)
    write(2)
    whole = open(file, "rb").read()
    calls = 0
    for number in (errno.ENOSPC, errno.EIO):
        for calls in range(1000):
            os.remove(file)
            write(1)
            old = open(file, "rb").read()
            shim.fail_at(folder.encode(), calls, number)
            try:
                write(2)
                error = None
            except ph.ResourceError as e:
                error = str(e)
            failed = shim.failed()
            shim.fail_at(b"", -1, 0)
            now = open(file, "rb").read()
            if not failed:
                break
            assert {*os.listdir(folder)} <= {"a.checkpoint", "a.png", "a.exr"}, calls
            if name == "a.checkpoint":  # only a warning
                assert now == old or film(now) == film(whole), (name, calls)
            else:  # an error, or the new one: it had taken its place when the call failed
                assert now == old or same_pixels(now, whole), (name, calls)
                assert now != old or os.strerror(number) in error, (name, calls, error)
        assert calls > 4, (name, calls)
    print(name, calls)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the shim reads /proc")
def test_at_every_failing_call_of_the_system_the_old_or_the_new_file_is_whole(
    tmp_path: Path,
) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    shim, folder = tmp_path / "failing_calls.so", tmp_path / "files"
    folder.mkdir()
    source = Path(__file__).with_name("failing_calls.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", shim, source, "-ldl"], check=True)
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT), folder],
        env={**os.environ, "LD_PRELOAD": str(shim)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert [line.split()[0] for line in done.stdout.splitlines()] == [
        "a.checkpoint",
        "a.png",
        "a.exr",
    ]


def test_a_checkpoint_takes_what_the_documentation_says(spheres: Any, tmp_path: Path) -> None:
    for features, bytes_a_pixel in ((False, 80), (True, 560)):
        file = tmp_path / f"{bytes_a_pixel}"
        ph.render(spheres, checkpoint=file, spp=1, features=features, width=200, height=200)
        assert file.stat().st_size == pytest.approx(bytes_a_pixel * 200 * 200, rel=0.01)


def test_the_identity_names_all_settings(spheres: Any) -> None:
    made_of = checkpoint.identity(spheres.flat, ph.Camera(), ph.Settings(), False)
    left_out = {"spp", "noise"}  # they say when to stop
    assert set(vars(ph.Settings())) - left_out <= set(made_of)
    assert not left_out & set(made_of)
