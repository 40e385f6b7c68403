"""Open Image Denoise: pictures come nearer to the truth, and what was rendered is kept."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import denoise
from parhelion.cli import main
from parhelion.denoise import denoised, finite, guides_of
from parhelion.image import encoded
from parhelion.layers import MAIN, PictureFile
from picture_tools import read_picture

pytest.importorskip("pyoidn")


@pytest.fixture(scope="module")
def truth() -> ph.Image:
    return ph.render(ph.weekend(), width=160, spp=400, seed=7)


@pytest.fixture(scope="module")
def noisy() -> ph.Image:
    return ph.render(ph.weekend(), width=160, spp=6, features=True)


# --- Pictures ------------------------------------------------------------------------------------


def test_the_error_falls(noisy: ph.Image, truth: ph.Image) -> None:
    before = ph.compare(noisy, truth)
    albedo, normal = guides_of(noisy.features)
    found = {
        "guided": noisy.denoised(),
        "noise of guides left": noisy.denoised(prefilter=False),
        "fast": noisy.denoised(quality="fast"),
        "albedo alone": denoised(noisy.pixels, albedo),
        "alone": replace(noisy, features={}).denoised(),
    }
    after = {name: ph.compare(picture, truth) for name, picture in found.items()}
    for name, measures in after.items():
        assert measures.relmse < 0.45 * before.relmse, name
        assert measures.ssim > before.ssim + 0.05, name
        assert measures.flip < before.flip, name
        # light is neither lost nor made
        np.testing.assert_allclose(measures.ratio, 1, atol=0.02, err_msg=name)
    # what each is for
    assert after["guided"].relmse < after["alone"].relmse
    assert after["guided"].relmse < after["noise of guides left"].relmse
    assert normal is not None


def test_progressive_pictures_get_better(truth: ph.Image) -> None:
    """A picture after 1, 3 and 9 samples, as a live view shows it."""
    prepared = ph.prepare(ph.weekend())
    errors = []
    for spp in (1, 3, 9):
        image = ph.render(prepared, width=160, spp=spp, features=True)
        clean = denoised(image.pixels, *guides_of(image.features), prefilter=False, quality="fast")
        errors.append(ph.compare(clean, truth).relmse)
        assert errors[-1] < 0.5 * ph.compare(image, truth).relmse
    assert errors[0] > errors[1] > errors[2]


def test_brightness_does_not_matter(noisy: ph.Image) -> None:
    plain = denoised(noisy.pixels)
    bright = denoised(1000 * noisy.pixels) / 1000
    assert np.abs(bright - plain).mean() < 0.01 * plain.mean()
    assert bright.max() > 0.5


def test_the_noise_is_kept(noisy: ph.Image) -> None:
    clean = noisy.denoised()
    np.testing.assert_array_equal(clean.features["noisy"], noisy.pixels)
    assert "noisy" not in noisy.features
    assert clean.pixels.dtype == np.float32
    assert np.isfinite(clean.pixels).all()
    assert clean.pixels.min() >= 0
    assert clean.metadata()["parhelion:denoised"].startswith("Open Image Denoise")
    assert "parhelion:denoised" not in noisy.metadata()
    # a second time begins with what was rendered
    np.testing.assert_array_equal(clean.denoised().pixels, clean.pixels)


def test_arrays_stay_and_pictures_do_not_mix(noisy: ph.Image) -> None:
    """What is kept between calls, of other sizes and from other threads, changes nothing."""
    albedo, normal = guides_of(noisy.features)
    assert albedo is not None
    given = [noisy.pixels.copy(), albedo.copy(), normal.copy()]  # type: ignore[union-attr]
    first = denoised(*given)
    for array, before in zip(given, (noisy.pixels, albedo, normal), strict=True):
        np.testing.assert_array_equal(array, before)
    small = denoised(noisy.pixels[:40, :50])
    again: list[np.ndarray] = []
    threads = [
        threading.Thread(target=lambda: again.append(denoised(*given))),
        threading.Thread(target=lambda: again.append(denoised(noisy.pixels[:40, :50]))),
        threading.Thread(target=lambda: again.append(denoised(*given, prefilter=False))),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(np.array_equal(a, first) for a in again) == 1
    assert sum(np.array_equal(a, small) for a in again) == 1
    np.testing.assert_array_equal(denoised(*given), first)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_has_a_device_of_its_own() -> None:
    light = np.random.default_rng(1).random((32, 32, 3), np.float32)
    expected = denoised(light)
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # rather than wait for ever
        os._exit(0 if np.array_equal(denoised(light), expected) else 1)
    # By then the library's threads are asleep.
    assert time.monotonic() - denoise._worker(os.getpid()).ended >= 0.1
    assert os.waitpid(child, 0)[1] == 0


# --- Progress, and ends before the end -----------------------------------------------------------


def test_progress_is_told_and_ends_it(noisy: ph.Image) -> None:
    shares: list[float] = []
    clean = noisy.denoised(progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert all(0 <= share <= 1 for share in shares)
    for most in (0.0, 0.3):
        assert noisy.denoised(progress=lambda share, most=most: share >= most) is noisy
        with pytest.raises(denoise.Stopped):
            denoised(noisy.pixels, progress=lambda share, most=most: share >= most)
    with pytest.raises(ZeroDivisionError):
        noisy.denoised(progress=lambda _: 1 / 0)
    np.testing.assert_array_equal(noisy.denoised().pixels, clean.pixels)


def test_ctrl_c_in_python(noisy: ph.Image) -> None:
    with pytest.raises(KeyboardInterrupt):
        noisy.denoised(progress=lambda _: os.kill(os.getpid(), signal.SIGINT))
    assert "noisy" in noisy.denoised().features


@pytest.fixture(params=["SIGINT", "SIGTERM"])
def signalled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal comes whenever denoising begins."""

    def begun(*arrays: Any, **how: Any) -> np.ndarray:
        os.kill(os.getpid(), getattr(signal, request.param))
        return denoised(*arrays, **how)

    monkeypatch.setattr(denoise, "denoised", begun)


@pytest.mark.usefixtures("signalled")
@pytest.mark.parametrize("name", ["a.png", "a.exr"])
def test_a_picture_that_is_stopped_has_its_noise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    file = tmp_path / name
    assert run("render", *SMALL, "--denoise", "-o", file) == 130
    said = capsys.readouterr().err
    assert f"stopped; {file} has 4 spp and is not denoised; --checkpoint FILE would let" in said
    assert os.listdir(tmp_path) == [name]
    pixels, told = read_picture(file)
    plain = ph.render(ph.weekend(), width=48, spp=4)
    np.testing.assert_array_equal(pixels, plain.srgb() if name == "a.png" else plain.pixels)
    assert "parhelion:denoised" not in told
    assert list(PictureFile(file).layers) == [MAIN]


@pytest.mark.usefixtures("signalled")
def test_sequences_and_files_that_are_stopped(
    noisy: ph.Image, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["--turntable", 2, "--denoise", *SMALL]
    assert run("render", *flags, "-o", tmp_path / "a.png") == 130
    assert "stopped after 0 of 2 pictures" in capsys.readouterr().err
    noisy.save(tmp_path / "in.exr")
    assert run("image", tmp_path / "in.exr", "--denoise", "-o", tmp_path / "a.png") == 130
    assert os.listdir(tmp_path) == ["in.exr"]


def test_making_it_again_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("render", *SMALL, "--denoise", "-o", tmp_path / "a.exr") == 0
    assert run("rerender", tmp_path / "a.exr") == 0
    monkeypatch.setattr(denoise, "denoised", lambda *_, progress, **__: _ended(progress))
    again = tmp_path / "b.exr"
    assert run("rerender", tmp_path / "a.exr", "-o", again) == 130
    assert not again.exists()


def _ended(progress: Any) -> None:
    assert not progress(0.5)
    os.kill(os.getpid(), signal.SIGINT)
    assert progress(0.6)
    raise denoise.Stopped


@pytest.mark.parametrize(("needed", "most"), [(0.6, 0.9), (100.0, 0.75)])
def test_time_is_left_for_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    needed: float,
    most: float,
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(denoise, "seconds_for", lambda pixels: asked.append(pixels) or needed)
    words = ["--crop", "0,0,40,20", "--denoise", "--time-limit", "1.5", "-o", tmp_path / "a.exr"]
    assert main(["render", *map(str, words)]) == 0
    assert asked == [800]
    told = PictureFile(tmp_path / "a.exr").metadata
    assert told["parhelion:ended"] == "time"
    assert float(told["parhelion:seconds"]) < most + 0.3
    assert ("the picture will be late" in caplog.text) == (needed > 1)


@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_what_cannot_be_denoised_is_written_as_it_was_rendered(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
) -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise ph.ResourceError("Open Image Denoise failed: out of memory")

    words = ["render", "--crop", "0,0,40,20", "--spp", "2", "--denoise", "-o", str(tmp_path / name)]
    monkeypatch.setattr(denoise, "denoised", fails)
    assert main(words) == 2
    said = capsys.readouterr().err
    assert f"out of memory; {tmp_path / name} was written with its noise" in said
    plain = ph.render(ph.weekend(), crop=(0, 0, 40, 20), spp=2)
    plain.save(tmp_path / f"plain-{name}")
    seen, wanted = (PictureFile(tmp_path / n) for n in (name, f"plain-{name}"))
    np.testing.assert_array_equal(seen.read(seen.layer()), wanted.read(wanted.layer()))


def test_memory_for_denoising_is_asked_for_before_rendering(tmp_path: Path) -> None:
    size = ["--width", "1200", "--height", "800", "--spp", "100000"]
    limited = ["--denoise", "--memory-limit", "900M", "-o", str(tmp_path / "a.exr")]
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "parhelion", "render", *size, *limited],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "not enough memory: denoising 1200x800 pixels takes" in done.stderr
    assert time.monotonic() - begin < 60


def test_how_long_it_will_take() -> None:
    one, many = denoise.seconds_for(1), denoise.seconds_for(100 * denoise._TRIAL**2)
    assert 0 < one < many < 1000


# --- What is not finite --------------------------------------------------------------------------


def test_what_is_not_finite_is_counted(noisy: ph.Image, caplog: pytest.LogCaptureFixture) -> None:
    spoiled = noisy.pixels.copy()
    spoiled[3, 4] = np.nan
    spoiled[20, 60, 1] = np.inf
    clean, count = finite(spoiled)
    assert count == 2
    assert not clean[[3, 20], [4, 60]].any()
    assert finite(noisy.pixels)[1] == 0
    with caplog.at_level(logging.WARNING, "parhelion"):
        found = replace(noisy, pixels=spoiled).denoised()
    assert "2 pixels are not finite and count as black" in caplog.text
    assert np.isfinite(found.pixels).all()
    # the rest of the picture is as it was
    far = np.ones(noisy.pixels.shape[:2], bool)
    far[:40, :20] = far[:50, 30:90] = False
    whole = noisy.denoised().pixels
    assert np.abs(found.pixels - whole)[far].mean() < 0.01


@pytest.mark.parametrize(
    ("arrays", "how", "told"),
    [
        ((np.zeros((4, 5)),), {}, r"light of shape \(height, width, 3\) is needed, not \(4, 5\)"),
        ((np.zeros((0, 5, 3)),), {}, "light of shape"),
        ((np.zeros((4, 5, 3)), np.zeros((4, 4, 3))), {}, r"albedo has shape \(4, 4, 3\), light"),
        ((np.zeros((4, 5, 3)), None, np.zeros((4, 5, 3))), {}, "a normal needs an albedo too"),
        ((np.zeros((4, 5, 3)),), {"quality": "hihg"}, "unknown quality 'hihg'; did you mean 'high"),
    ],
)
def test_what_can_not_be_denoised(
    arrays: tuple[np.ndarray, ...], how: dict[str, str], told: str
) -> None:
    with pytest.raises(ph.SceneError, match=told):
        denoised(*arrays, **how)  # type: ignore[arg-type]


# --- The command line ----------------------------------------------------------------------------


def run(*arguments: object) -> int:
    return main([*map(str, arguments), "-q"])


SMALL = ["--width", 48, "--spp", 4]


def test_render_keeps_the_noisy_picture(tmp_path: Path) -> None:
    plain = ph.render(ph.weekend(), width=48, spp=4, features=True)
    assert run("render", *SMALL, "--denoise", "-o", tmp_path / "a.png") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.noisy.png", "a.png"]
    clean = plain.denoised()
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png")[0], clean.srgb())
    np.testing.assert_array_equal(read_picture(tmp_path / "a.noisy.png")[0], plain.srgb())
    assert (
        run("render", *SMALL, "--denoise", "--compression", "dwaa", "-o", tmp_path / "a.exr") == 0
    )
    assert list(PictureFile(tmp_path / "a.exr").layers) == [MAIN, "noisy"]
    assert run("render", *SMALL, "--denoise", "--features", "-o", tmp_path / "a.exr") == 0
    file = PictureFile(tmp_path / "a.exr")
    assert {"noisy", "albedo", "CryptoObject00"} < file.layers.keys()
    np.testing.assert_array_equal(file.read(file.layer()), clean.pixels)
    np.testing.assert_array_equal(file.read(file.layer("noisy")), plain.pixels)


def test_sequences_are_denoised(tmp_path: Path) -> None:
    flags = ["--turntable", 2, "--denoise", *SMALL]
    assert run("render", *flags, "-o", tmp_path / "a.exr") == 0
    for number in (1, 2):
        file = PictureFile(tmp_path / f"a.{number:04}.exr")
        assert list(file.layers) == [MAIN, "noisy"]
        assert np.abs(file.read(file.layer()) - file.read(file.layer("noisy"))).mean() > 1e-3


def test_files_are_denoised_later(noisy: ph.Image, tmp_path: Path) -> None:
    noisy.save(tmp_path / "in.exr")
    clean = noisy.denoised()
    assert run("image", tmp_path / "in.exr", "--denoise", "-o", tmp_path / "a.png") == 0
    pixels, told = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(pixels, clean.srgb())
    assert told["parhelion:denoised"].startswith("Open Image Denoise")
    assert run("image", tmp_path / "in.exr", "--denoise", "-o", tmp_path / "b.exr") == 0
    file = PictureFile(tmp_path / "b.exr")
    assert file.layers.keys() == {MAIN, "noisy", *PictureFile(tmp_path / "in.exr").layers}
    np.testing.assert_array_equal(file.read(file.layer()), clean.pixels)
    np.testing.assert_array_equal(file.read(file.layer("noisy")), noisy.pixels)
    # and again, from the noise that it has kept
    assert run("image", tmp_path / "b.exr", "--denoise", "-o", tmp_path / "c.exr") == 0
    file = PictureFile(tmp_path / "c.exr")
    np.testing.assert_array_equal(file.read(file.layer()), clean.pixels)


def test_pictures_without_features(
    noisy: ph.Image, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pixels = noisy.pixels.copy()
    pixels[5, 5] = np.nan
    (tmp_path / "in.exr").write_bytes(encoded(pixels, {}, ".exr"))
    with caplog.at_level(logging.WARNING, "parhelion"):
        assert (
            main(["image", str(tmp_path / "in.exr"), "--denoise", "-o", str(tmp_path / "a.png")])
            == 0
        )
    assert "has no features; nothing guides" in caplog.text
    assert "in.exr: 1 pixels are not finite" in caplog.text


def test_without_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(ph.ResourceError, match=r'pip install "parhelion\[denoise\]"'):
        denoised(np.zeros((4, 5, 3)))
    assert run("render", "--denoise", "-o", tmp_path / "a.png") == 2
    assert run("image", tmp_path / "no.exr", "--denoise") == 2
    assert capsys.readouterr().err.count("denoising needs Open Image Denoise") == 2
    assert not list(tmp_path.iterdir())


def test_a_failure_is_told_and_the_next_picture_works(monkeypatch: pytest.MonkeyPatch) -> None:
    light = np.random.default_rng(2).random((24, 24, 3), np.float32)
    expected = denoised(light)
    worker = denoise._worker(os.getpid())
    with monkeypatch.context() as patch:
        patch.setattr(worker._device, "get_error", lambda: "out of memory")
        with pytest.raises(ph.ResourceError, match="Open Image Denoise failed: out of memory"):
            denoised(light)
    np.testing.assert_array_equal(denoised(light), expected)
