"""`ph.compare` and `parhelion compare`: what the measures are, and what scripts get of them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from math import erfc, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage, stats

import parhelion as ph
from parhelion.cli import main
from parhelion.comparison import SIGNIFICANCE, BlockTest, relative_mse, side_by_side, ssim, z_test
from parhelion.display import srgb_encoded
from parhelion.flip import blurred, exposures, flip
from parhelion.image import encoded
from picture_tools import read_picture


def pair(seed: int = 1, shape: tuple[int, int] = (40, 60)) -> tuple[np.ndarray, np.ndarray]:
    """A noisy picture, and what it should be: gradients, edges, and some that is bright."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] / max(shape)
    base = np.stack([x, y, 0.5 + 0.5 * np.sin(12 * x)], axis=-1)
    base[5:12, 10:30] = [0.9, 0.1, 0.2]
    base[20:24, 20:24] *= 6
    noisy = base * rng.gamma(20, 1 / 20, base.shape)
    return noisy.astype(np.float32), base.astype(np.float32)


# --- Measures ------------------------------------------------------------------------------------


def test_errors_in_light_by_hand() -> None:
    noisy, base = pair()
    found = ph.compare(noisy, base)
    gap = noisy.astype(float) - base
    assert found.mse == pytest.approx(np.mean(gap**2))
    assert found.relmse == pytest.approx(np.mean(gap**2 / (base**2.0 + (0.1 * base.mean()) ** 2)))
    assert found.largest == pytest.approx(np.abs(gap).max())
    np.testing.assert_allclose(found.ratio, noisy.mean((0, 1)) / base.mean((0, 1)), rtol=1e-5)
    seen = [srgb_encoded(p) for p in (noisy, base)]
    assert found.psnr == pytest.approx(-10 * np.log10(np.mean((seen[0] - seen[1]) ** 2.0)))
    darker = ph.compare(noisy, base, exposure=-3)
    assert darker.psnr > found.psnr + 3
    assert darker.mse == found.mse


def test_relative_error_by_hand() -> None:
    reference = np.ones((40, 25, 3))
    picture = reference.copy()
    picture[3, 4] = 3.0  # (3 - 1)^2 / (1^2 + 0.1^2), in one pixel of a thousand
    error, trimmed = relative_mse(picture, reference)
    assert error == pytest.approx(4 / 1.01 / 1000)
    assert trimmed == 0.0
    # the same in other units of light
    assert relative_mse(7 * picture, 7 * reference)[0] == pytest.approx(error)


def test_equal_pictures_are_equal() -> None:
    noisy, _ = pair()
    found = ph.compare(noisy, noisy.copy())
    assert (found.mse, found.relmse, found.flip, found.largest) == (0, 0, 0, 0)
    assert found.ssim == pytest.approx(1)
    assert found.psnr == np.inf
    black = np.zeros((4, 5, 3))
    assert ph.compare(black, black).numbers() | {"psnr": 0, "ssim": 0} == dict.fromkeys(
        found.numbers(), 0
    )


def test_ssim_is_its_definition() -> None:
    noisy, base = (srgb_encoded(p) for p in pair())
    found = ssim(noisy, base)
    at = np.arange(-5, 6)
    window = np.exp(-(at[:, None] ** 2 + at**2) / (2 * 1.5**2))
    window /= window.sum()
    for row, column in ((5, 5), (17, 40), (34, 54)):
        values = []
        for channel in range(3):
            patch = (slice(row - 5, row + 6), slice(column - 5, column + 6), channel)
            x, y = (p[patch].astype(float) for p in (noisy, base))
            mx, my = (window * x).sum(), (window * y).sum()
            vx, vy = (window * (x - mx) ** 2).sum(), (window * (y - my) ** 2).sum()
            cov = (window * (x - mx) * (y - my)).sum()
            c1, c2 = 0.01**2, 0.03**2
            values.append(
                (2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
            )
        assert found[row, column] == pytest.approx(np.mean(values), rel=1e-5)


@pytest.mark.parametrize("hdr", [False, True])
def test_flip_is_that_of_its_authors(hdr: bool) -> None:
    theirs = pytest.importorskip("flip_evaluator")
    rng = np.random.default_rng(2)
    noisy, base = pair(shape=(50, 70))
    pictures = [(noisy, base), (rng.random((30, 20, 3)), rng.random((30, 20, 3)))]
    pictures += [(np.roll(base, 2, axis=1), base), (0.5 * base, base)]
    for a, b in pictures:
        if hdr:
            a, b = 20 * a**2, 20 * b**2
        else:
            a, b = np.clip(a, 0, 1), np.clip(b, 0, 1)
        a, b = (np.ascontiguousarray(p, np.float32) for p in (a, b))
        kind = "HDR" if hdr else "LDR"
        expected, mean, told = theirs.evaluate(b, a, kind, inputsRGB=False, applyMagma=False)
        found = flip(a, b, hdr=hdr)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, np.squeeze(expected), atol=1e-3)
        assert found.mean() == pytest.approx(mean, abs=1e-4)
        if hdr:
            stops = exposures(b)
            assert len(stops) == told["numExposures"]
            assert stops[0] == pytest.approx(told["startExposure"], abs=1e-3)
            assert stops[-1] == pytest.approx(told["stopExposure"], abs=1e-2)


@pytest.mark.filterwarnings("error")
def test_flip_of_extremes() -> None:
    for value in (0.0, 1e-30, 1e30, 3e38):
        light = np.full((6, 7, 3), value, np.float32)
        assert flip(light, light, hdr=True).max() == 0
    black, bright = np.zeros((6, 7, 3)), np.full((6, 7, 3), 1e30)
    for a, b in ((black, bright), (bright, black)):
        assert flip(a, b, hdr=True).min() > 0.5
    with pytest.raises(ph.SceneError, match="must be finite"):
        flip(black * np.nan, black)


def test_blurring_is_a_convolution() -> None:
    values = np.random.default_rng(3).random((9, 12, 2))
    line, other = np.array([0.1, 0.2, 0.5]), np.array([1.0, -2, 0.5, 0.3, 0.1])
    found = blurred(values, line, other)
    expected = ndimage.correlate1d(values, line, axis=0, mode="nearest")
    expected = ndimage.correlate1d(expected, other, axis=1, mode="nearest")
    np.testing.assert_allclose(found, expected)


def test_pixels_that_are_not_finite_are_counted_and_left_out() -> None:
    noisy, base = pair()
    spoiled, lacking = noisy.copy(), base.copy()
    spoiled[3, 4, 1] = np.nan
    spoiled[30, 50] = np.inf
    lacking[3, 5, 0] = -np.inf
    found = ph.compare(spoiled, lacking)
    assert found.not_finite == (2, 1)
    keep = np.ones(noisy.shape[:2], bool)
    keep[[3, 30, 3], [4, 50, 5]] = False
    gap = noisy[keep].astype(float) - base[keep]
    assert found.mse == pytest.approx(np.mean(gap**2))
    plain = ph.compare(noisy, base)
    for name in ("relmse", "psnr", "ssim", "flip"):
        assert getattr(found, name) == pytest.approx(getattr(plain, name), rel=0.05)
    with pytest.raises(ph.SceneError, match="no pixel that is finite in both"):
        ph.compare(noisy * np.nan, base)


def test_images_and_files_are_taken_too(tmp_path: Path) -> None:
    image = ph.render(ph.weekend(), width=32, spp=2)
    other = ph.render(ph.weekend(), width=32, spp=2, seed=9)
    image.save(tmp_path / "a.exr")
    other.save(tmp_path / "b.png")
    found = ph.compare(image, other)
    assert ph.compare(tmp_path / "a.exr", other).numbers() == found.numbers()
    stored = ph.compare(str(tmp_path / "a.exr"), tmp_path / "b.png")
    assert stored.psnr == pytest.approx(found.psnr, abs=0.2)
    # both for screens: no other exposure counts
    image.save(tmp_path / "a.png")
    clipped = [np.clip(i.pixels, 0, 1) for i in (image, other)]
    low = ph.compare(tmp_path / "a.png", tmp_path / "b.png").flip
    assert low == pytest.approx(float(flip(*clipped).mean()), abs=0.01)


@pytest.mark.parametrize(
    ("one", "two", "told"),
    [
        (np.zeros((4, 5, 3)), np.zeros((5, 4, 3)), "picture has 5x4 pixels, the reference 4x5"),
        (np.zeros((4, 5)), np.zeros((4, 5, 3)), r"ndarray of shape \(4, 5\)"),
        (np.zeros((0, 5, 3)), np.zeros((0, 5, 3)), "an Image, a path or an array of shape"),
        ("no.exr", np.zeros((4, 5, 3)), "no.exr: no such file"),
        ([["a"]], np.zeros((4, 5, 3)), "not list"),
    ],
)
def test_what_can_not_be_compared(one: object, two: object, told: str) -> None:
    with pytest.raises(ph.SceneError, match=told):
        ph.compare(one, two)  # type: ignore[arg-type]


# --- The z-test ----------------------------------------------------------------------------------


def trial(seed: int, shift: float = 0.0) -> BlockTest:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0.2, 2, (13, 18, 3))
    variances = rng.uniform(0.01, 0.1, truth.shape), rng.uniform(0.01, 0.1, truth.shape)
    a, b = (truth + rng.normal(size=truth.shape) * np.sqrt(v) for v in variances)
    return z_test(a + shift, b, *variances)


def test_noise_alone_passes_as_often_as_it_should() -> None:
    tests = [trial(seed) for seed in range(150)]
    failed = sum(not t.agrees for t in tests)
    assert stats.binomtest(failed, 150, SIGNIFICANCE, "greater").pvalue > 1e-3, failed
    assert min(t.p for t in tests) < 0.1  # it is no test that always passes


def test_differences_are_found_at_their_size() -> None:
    everywhere = trial(3, shift=0.06)
    assert not everywhere.agrees
    assert everywhere.size >= 8
    assert everywhere.strongest > 4
    base = np.zeros((16, 16, 3))
    one = base.copy()
    one[9, 6, 2] = 8
    variance = np.ones((16, 16, 1))
    spot = ph.compare(one, base, variances=(variance / 2, variance[..., 0] / 2)).test
    assert spot is not None
    assert (spot.size, spot.block, spot.channel, spot.strongest) == (1, (9, 6), 2, 8.0)
    # of 768 pixels, and of five sizes of block
    one_of = -np.expm1(768 * np.log1p(-erfc(8 / sqrt(2))))
    assert spot.p == pytest.approx(5 * one_of, rel=1e-3)
    # where nothing scatters, nothing may differ
    sure = z_test(one, base, base, base)
    assert sure.p == 0
    assert z_test(base, base, base, base).agrees


@pytest.mark.parametrize("bad", [np.ones((3, 3)), -np.ones((4, 5, 3)), np.full((4, 5, 1), np.nan)])
def test_variances_without_meaning(bad: np.ndarray) -> None:
    black = np.zeros((4, 5, 3))
    with pytest.raises(ph.SceneError, match="variances: "):
        ph.compare(black, black, variances=(bad, np.ones((4, 5, 1))))


# --- Pictures and pages --------------------------------------------------------------------------


def test_a_picture_of_the_difference() -> None:
    noisy, base = pair()
    row = side_by_side(noisy, base, exposure=0)
    assert row.shape == (40, 3 * 60 + 4, 3)
    np.testing.assert_array_equal(row[:, :60], np.round(255 * srgb_encoded(noisy)))
    middle = row[:, -60:].astype(float) / 255
    expected = np.clip(0.5 + 2.5 * (noisy.astype(float) - base), 0, 1)
    np.testing.assert_allclose(middle, expected, atol=0.003)
    # without an exposure the reference's brightest hundredth is white
    white = side_by_side(noisy, base)[:, 62:122]
    brightest = base.max(axis=-1)
    at_least = brightest >= np.quantile(brightest, 0.99)
    np.testing.assert_array_equal(white.max(axis=-1)[at_least], 255)
    assert white.max(axis=-1)[brightest < 0.9 * np.quantile(brightest, 0.99)].max() < 250
    whole = ph.compare(noisy, base).side_by_side()
    np.testing.assert_array_equal(whole[:, : 3 * 60 + 4], row)
    assert whole.shape == (40, 4 * 60 + 6, 3)


class Page(HTMLParser):
    """Tags that are open, and what pictures there are."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        if tag == "img":
            self.sources.append(given["src"] or "")
            assert given["alt"]
        if tag not in ("img", "meta", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_needs_no_other_file() -> None:
    noisy, base = pair()
    variance = np.ones((40, 60, 1))
    found = ph.compare(noisy, base, variances=(variance, variance))
    text = found.html(("a <b>.exr", "a <b>.exr"))
    page = Page()
    page.feed(text)
    assert page.open == []
    assert len(page.sources) == 6
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not re.search(r"(src|href)='(?!data:)", text)
    assert "a &lt;b&gt;.exr against" in text
    assert "<b>" not in text
    for value in (found.mse, found.flip, found.ssim):
        assert f"<td>{value:.6g}</td>" in text
    assert "no difference but noise" in text


# --- The command ---------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, np.ndarray]:
    monkeypatch.chdir(tmp_path)
    noisy, base = pair()
    for name, pixels in (("a.exr", noisy), ("b.exr", base), ("v.exr", 0.05 * np.ones_like(base))):
        Path(name).write_bytes(encoded(pixels, {}, ".exr"))
    return noisy, base


def run(*arguments: str) -> int:
    try:
        return main(["compare", *arguments])
    except SystemExit as end:
        return int(end.code or 0)


def test_the_command(
    files: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    found = ph.compare(*files)
    assert run("a.exr", "b.exr") == 0
    text = capsys.readouterr().out
    assert text.startswith("a.exr against b.exr, 60x40\n")
    assert re.search(rf"^  flip +{found.flip:.6g}  mean", text, re.MULTILINE)
    both = ["--html", "c.html", "--difference", "c.png", "--variance", "v.exr", "v.exr"]
    assert run("a.exr", "b.exr", "--json", *both) == 0
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["mse"] == found.mse
    assert numbers["p"] > 0.01
    np.testing.assert_array_equal(read_picture(Path("c.png"))[0], found.side_by_side())
    assert "a.exr against b.exr" in Path("c.html").read_text()
    assert run("a.exr", "a.exr", "--json") == 0
    assert json.loads(capsys.readouterr().out)["psnr"] is None  # infinite


def test_exit_codes_for_scripts(
    files: tuple[np.ndarray, np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    found = ph.compare(*files)
    low, high = f"flip={found.flip * 0.9}", f"flip={found.flip * 1.1}"
    assert run("a.exr", "b.exr", "-q", "--fail-above", high, "--fail-above", "MSE=1") == 0
    assert capsys.readouterr() == ("", "")
    assert run("a.exr", "b.exr", "-q", "--fail-above", low, "--fail-below", "psnr=90") == 1
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith(f"parhelion: a.exr: flip is {found.flip:.6g}, above 0.1")
    assert told[1].startswith("parhelion: a.exr: psnr is ")
    assert run("a.exr", "b.exr", "-q", "--fail-below", f"psnr={found.psnr - 1}") == 0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["a.exr", "no.exr"], "no.exr: no such file"),
        (["a.exr", "b.exr", "--fail-above", "flop=1"], "unknown measure 'flop'; did you mean 'fl"),
        (["a.exr", "b.exr", "--fail-above", "flip"], "'flip': MEASURE=VALUE is needed"),
        (["a.exr", "b.exr", "--fail-above", "flip=nan"], "MEASURE=VALUE is needed"),
        (
            ["a.exr", "b.exr", "--fail-below", "p=0.01"],
            "p is that of the z-test, which needs varia",
        ),
        (["a.exr", "b.exr", "--difference", "c.exr"], "c.exr: .png or .jpg is needed"),
        (["a.exr", "b.exr", "--html", "a.exr"], "a.exr: is what is to be read; give the result"),
        (["s.png", "b.exr", "--difference", "s.png"], "s.png: is what is to be read"),
        (["a.exr", "b.exr", "--html", "no/c.html"], "no/c.html: there is no folder"),
        (["a.exr", "b.exr", "--variance", "v.exr", "w.exr"], "w.exr: no such file"),
        (["a.exr", "small.exr"], "a.exr has 60x40 pixels, small.exr 7x6"),
        (["a.exr", "b.exr", "--exposure", "40"], "--exposure is 40.0; must be a number of stops"),
    ],
)
def test_mistakes(
    arguments: list[str],
    told: str,
    files: tuple[np.ndarray, np.ndarray],
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("small.exr").write_bytes(encoded(files[0][:6, :7], {}, ".exr"))
    Path("s.png").write_bytes(encoded(np.zeros((40, 60, 3), np.uint8), {}, ".png"))
    before = {file: file.read_bytes() for file in Path().iterdir()}
    assert run(*arguments) == 2
    assert told in capsys.readouterr().err
    assert {file: file.read_bytes() for file in Path().iterdir()} == before


def test_renderings_know_their_own_variance(tmp_path: Path) -> None:
    """What it is for: that a picture is the same scene's, or is not."""
    prepared = ph.prepare(ph.weekend())

    def rendered(scene: object, seed: int) -> ph.Image:
        # a noise that is out of reach, so that the errors are known and all pixels get as much
        return ph.render(scene, width=48, spp=32, seed=seed, noise=1e-6)

    first, second = rendered(prepared, 1), rendered(prepared, 2)
    same = ph.compare(second, first).test
    assert same is not None
    assert same.agrees
    assert same.each.shape == (4, 6, 1)  # blocks of 8 x 8
    light = ph.weekend().background
    assert light is not None
    brighter = {name: tuple(1.03 * c for c in v) for name, v in light.params.items()}
    other = ph.weekend().replace(background=ph.Background(light.type, **brighter))
    found = ph.compare(rendered(other, 3), first).test
    assert found is not None
    assert not found.agrees
    assert found.size >= 8
    # of files too, but not once noise was taken out
    first.save(tmp_path / "a.exr")
    second.save(tmp_path / "b.exr")
    stored = ph.compare(tmp_path / "b.exr", tmp_path / "a.exr").test
    assert stored is not None
    assert stored.p == pytest.approx(same.p, rel=1e-6)
    assert (
        main(
            [
                "compare",
                str(tmp_path / "b.exr"),
                str(tmp_path / "a.exr"),
                "-q",
                "--fail-below",
                "p=0.01",
            ]
        )
        == 0
    )
    smooth = replace(second, features={**second.features, "noisy": second.pixels})
    assert ph.compare(smooth, first).test is None


def test_the_variance_of_a_rendering_is_what_pictures_scatter() -> None:
    prepared = ph.prepare(ph.weekend())

    def pictures(count: int, **how: object) -> list[ph.Image]:
        return [ph.render(prepared, width=32, spp=24, seed=k, **how) for k in range(count)]

    images = pictures(32, sampler="independent", noise=1e-6)
    known = np.mean([i.features["variance"] for i in images])
    scatter = np.var([i.pixels for i in images], axis=0, ddof=1).mean()
    assert known == pytest.approx(scatter, rel=0.1)  # unbiased, with independent samples
    assert "variance" not in pictures(1)[0].features
    one = ph.render(prepared, width=8, spp=1, noise=1e-6)
    assert np.isinf(one.features["variance"]).all()  # of one sample, nothing is known
