"""The thread-scaling study: its arithmetic, its files, and the command through real processes."""

from __future__ import annotations

import argparse
import csv
import errno
import json
import re
import signal
import subprocess
import sys
import threading
import time
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import parhelion as ph
from parhelion import machine
from parhelion.cli import study as command
from parhelion.errors import ResourceError, SceneError
from parhelion.study import amdahl, charts, original, output, words
from parhelion.study.measure import Run, Study, order
from parhelion.study.plan import Plan, schedule_list, spp_pair, thread_list, width_list
from parhelion.study.summary import quartiles, summarize

FILES = ["chart.png", "report.html", "study.csv", "study.json"]


def study(*words: str) -> int:
    """Runs the command in this process and returns its exit code."""
    parser = argparse.ArgumentParser()
    command.add(parser.add_subparsers())
    return command.run(parser.parse_args(["study", *words]))


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """A renderer of known times on two cores: Amdahl's law, s = 0.1, one second a megasample.

    The list holds the arguments of each call.
    """
    calls: list[dict] = []

    def render(_scene: object, **options: object) -> SimpleNamespace:
        calls.append(options)
        pixels = np.full((options["height"], options["width"], 3), 0.5, np.float32)
        samples = pixels.size // 3 * options["spp"]
        busy = min(options["threads"], 2)
        return SimpleNamespace(
            pixels=pixels,
            png_bytes=lambda: b"\x89PNG",
            stats=SimpleNamespace(
                seconds=samples * 1e-6 * (0.1 + 0.9 / busy),
                samples=samples,
                rays=3 * samples,
                threads=options["threads"],
                isa="avx2",
                complete=True,
            ),
        )

    monkeypatch.setattr(ph, "render", render)
    monkeypatch.setattr(ph, "prepare", lambda scene: scene)
    monkeypatch.setattr(machine, "cores_available", lambda: 2)
    return calls


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """No charts, which take two seconds, where a test is about something else. Files of studies
    that are not the same differ all the same."""
    monkeypatch.setattr(charts, "png", lambda of, _: b"\x89PNG %d" % len(of.runs))
    monkeypatch.setattr(charts, "svg", lambda _: "<svg></svg>")


# ---- Amdahl and Karp-Flatt


@pytest.mark.parametrize("serial", [0.0, 0.013, 0.5, 1.0])
@pytest.mark.parametrize("threads", [(1, 2), (1, 2, 4, 6, 64), (2, 3, 16)])
def test_fit_finds_the_law_it_is_given(serial: float, threads: tuple[int, ...]) -> None:
    fit = amdahl.fit(threads, [7.5 * (serial + (1 - serial) / n) for n in threads])
    assert fit is not None
    assert fit.serial == pytest.approx(serial, abs=1e-12)
    assert fit.t1 == pytest.approx(7.5)
    assert fit.residual == pytest.approx(0, abs=1e-12)
    assert fit.seconds(5) == pytest.approx(7.5 / fit.speedup(5))
    assert fit.exact == (len(threads) == 2)


@pytest.mark.parametrize(
    ("seconds", "serial"),
    [([8.0, 3.0, 1.0], 0.0), ([1.0, 2.0, 3.0], 1.0)],  # faster than 1/n; slower with more threads
)
def test_fit_is_held_to_zero_and_one(seconds: list[float], serial: float) -> None:
    fit = amdahl.fit([1, 2, 4], seconds)
    assert fit is not None
    assert fit.serial == serial


def test_fit_is_the_least_squares_minimum_within_its_bounds() -> None:
    rng = np.random.default_rng(5)
    s, t1 = np.meshgrid(np.linspace(0, 1, 201), np.linspace(0.2, 12, 400))
    for _ in range(20):
        threads = np.array([1, 2, 3, 8])
        seconds = rng.uniform(0.5, 8, 4)
        fit = amdahl.fit(threads.tolist(), seconds.tolist())
        assert fit is not None
        curves = t1[..., None] * (s[..., None] + (1 - s[..., None]) / threads)
        best = np.sqrt(((curves - seconds) ** 2).mean(axis=-1).min())
        assert fit.residual <= best + 1e-9
        assert fit.residual == pytest.approx(best, rel=2e-2)


def test_no_fit_from_one_count() -> None:
    assert amdahl.fit([1], [3.0]) is None
    assert amdahl.fit([4, 4], [3.0, 3.1]) is None


@pytest.mark.parametrize("n", [2, 7, 32])
def test_karp_flatt_turns_amdahl_around(n: int) -> None:
    assert amdahl.karp_flatt(1 / (0.07 + 0.93 / n), n) == pytest.approx(0.07)
    assert amdahl.karp_flatt(1.0, 1) is None


def test_published_figures() -> None:
    assert original.seconds(16, 960) == 174.61
    assert original.seconds(1, 120) == 9.75
    assert original.seconds(3, 960) is None
    # A computation by hand: numpy's own least squares on (1, 1/n), free of bounds.
    n = np.array(original.THREADS[:-1])
    (a, b), *_ = np.linalg.lstsq(
        np.stack([np.ones(7), 1 / n], axis=1), np.array(original.column(960)[:-1]), rcond=None
    )
    assert words.original_fit(960).serial == pytest.approx(a / (a + b))
    assert 0.22 < words.original_fit(960).serial < 0.23


# ---- lists and settings


def test_default_threads_double_up_to_the_cores() -> None:
    assert thread_list(None, 1) == (1,)
    assert thread_list(None, 2) == (1, 2)
    assert thread_list(None, 12) == (1, 2, 4, 8, 12)
    assert thread_list(None, 16) == (1, 2, 4, 8, 16)


def test_lists() -> None:
    assert thread_list("classic", 2) == (1, 2, 4, 6, 8, 12, 16, 32)
    assert thread_list(" 8, 4,4", 2) == (1, 4, 8)
    assert width_list("480,120,480") == (120, 480)
    assert schedule_list("static, dynamic,static") == ("static", "dynamic")
    assert spp_pair("4,200") == (4, 200)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--threads", "0"], "--threads: '0'"),
        (["--threads", "a,b"], "--threads: 'a'"),
        (["--threads", "1,,2"], "--threads: ''"),
        (["--threads", "-1"], "--threads: '-1'"),
        (["--threads", "1.5"], "--threads: '1.5'"),
        (["--threads", "٣"], "--threads: '٣'"),
        (["--threads", "100000"], "1 to 1024"),
        (["--threads", "9" * 10_000], "--threads"),
        (["--widths", ""], "--widths: ''"),
        (["--widths", "0"], "--widths: '0'"),
        (["--aspect", "16-9"], "16:9"),
        (["--spp", "0"], "--spp: 0"),
        (["--max-depth", "-3"], "--max-depth: -3"),
        (["--repeat", "0"], "--repeat: 0"),
        (["--tile", "0"], "--tile: 0"),
        (["--tree", "bhv"], "did you mean 'bvh'"),
        (["--sampler", "sobel"], "did you mean 'sobol'"),
        (["--schedule", "static,dynamite"], "did you mean 'dynamic'"),
        (["--schedule", ""], "--schedule"),
        (["--low-high-spp", "4"], "--low-high-spp"),
        (["--low-high-spp", "8,8"], "--low-high-spp"),
        (["--seed", "-1"], "--seed: -1"),
    ],
)
def test_a_wrong_option_is_named_and_nothing_is_written(
    options: list[str], part: str, tmp_path, engine: list[dict]
) -> None:
    with pytest.raises(SceneError) as error:
        study("-o", str(tmp_path / "out"), *options)
    assert part in str(error.value)
    assert len(str(error.value)) < 200
    assert not (tmp_path / "out").exists()
    assert engine == []


def test_height_follows_the_aspect() -> None:
    assert [Plan((1,), 1).height(w) for w in (120, 240, 480, 960)] == [68, 135, 270, 540]
    assert Plan((1,), 1, aspect="4:3").height(480) == 360
    assert Plan((1,), 1).height(1) == 1


def test_tiles_cover_the_picture() -> None:
    assert Plan((1,), 1).tiles(120) == 8 * 5
    assert Plan((1,), 1, tile=1).tiles(120) == 120 * 68


def test_command_measures_the_same_again() -> None:
    plan = Plan((1, 3), 4, (64, 128), "4:3", schedules=("guided", "static"), scene="a b.json")
    parser = argparse.ArgumentParser()
    command.add(parser.add_subparsers())
    import shlex

    args = parser.parse_args(shlex.split(plan.command())[1:])
    assert args.scene == "a b.json"
    assert (args.aspect, args.schedule, args.spp) == ("4:3", "guided,static", 20)
    assert thread_list(args.threads, 4) == plan.threads
    assert width_list(args.widths) == plan.widths


def test_repeats_are_interleaved() -> None:
    plan = Plan((1, 2, 4), 2, (8, 16), repeat=3, schedules=("static", "dynamic"))
    runs = list(order(plan))
    once = len(runs) // 3
    assert len(set(runs)) == len(runs) == 3 * 2 * 3 * 2
    for repeat in range(3):
        part = runs[repeat * once : (repeat + 1) * once]
        assert {run[0] for run in part} == {repeat}
        assert [run[1:] for run in part] == [run[1:] for run in runs[:once]]


# ---- summary


def made_up(seconds: dict[int, list[float]], cores: int = 4) -> Study:
    """A study of one width with these seconds by thread count, and no time spent waiting."""
    plan = Plan(tuple(seconds), cores, (32,), repeat=len(seconds[1]))
    runs = [
        Run(k, k, 32, 18, n, "dynamic", n > cores, t, t * min(n, cores), 11520, 34560, "abc")
        for n, all_runs in seconds.items()
        for k, t in enumerate(all_runs)
    ]
    return Study(plan, "made up", machine.describe(), runs, complete=True)


def test_points_of_a_known_study() -> None:
    summary = summarize(made_up({1: [8.0, 9.0, 8.5], 4: [2.5, 2.0, 2.125], 8: [4.25, 4.25, 4.25]}))
    one, four, eight = summary.of(32, "dynamic")
    assert (one.median, one.least, one.greatest) == (8.5, 8.0, 9.0)
    assert one.speedup == one.efficiency == 1.0
    assert one.karp_flatt is None
    assert four.speedup == 4.0
    assert four.efficiency == 1.0
    assert four.karp_flatt == pytest.approx(0)
    assert four.samples_per_second == pytest.approx(11520 / 2.125)
    assert four.busy == pytest.approx(4)
    assert four.useful == pytest.approx(1)
    # 8 threads on 4 cores for 4.25 s: 34 thread-seconds, of which 8.5 needed, 8.5 extra, 17 idle.
    assert eight.oversubscribed
    assert (eight.useful, eight.extra, eight.waiting) == pytest.approx((0.25, 0.25, 0.5))
    fit = summary.fits[32, "dynamic"]
    assert fit is not None
    assert fit.threads == (1, 4)  # 8 has no core of its own


def test_csv_compares_each_run_with_the_median_on_one_thread() -> None:
    study = made_up({1: [8.0, 9.0, 8.5], 4: [2.5, 2.0, 2.125]})
    rows = list(csv.DictReader(output.runs_csv(study, summarize(study)).splitlines()))
    assert [float(row["speed_up"]) for row in rows[3:]] == pytest.approx([3.4, 4.25, 4.0])
    assert [float(row["efficiency"]) for row in rows[3:]] == pytest.approx([0.85, 1.0625, 1.0])
    study.runs = study.runs[3:]
    rows = list(csv.DictReader(output.runs_csv(study, summarize(study)).splitlines()))
    assert {(row["speed_up"], row["efficiency"]) for row in rows} == {("", "")}


def test_percent_ticks_are_not_rounded() -> None:
    ax = Figure().subplots()
    charts._percent_ticks(ax.yaxis)
    told = [ax.yaxis.get_major_formatter()(value) for value in (0.0, 0.925, 0.1 + 0.2, 1.0)]
    assert told == ["0 %", "92.5 %", "30 %", "100 %"]


def test_quartiles_are_numpys() -> None:
    rng = np.random.default_rng(3)
    for count in (1, 2, 3, 4, 7):
        values = rng.random(count)
        assert quartiles(values.tolist()) == pytest.approx(np.quantile(values, [0.25, 0.75]))


def test_headline_does_not_praise_noise() -> None:
    study = made_up({1: [8.0], 4: [2.0], 8: [1.96]})
    headline = words.headline(study, summarize(study))
    assert headline.startswith("With 4 threads on 4 available cores")
    assert "8 threads, more than there are cores, took 2.0 % less" in headline
    assert headline.count(". ") == 1  # two sentences


def test_notes_warn_of_what_a_fit_can_not_tell() -> None:
    two = made_up({1: [8.0] * 2, 2: [4.1] * 2}, cores=2)
    assert any("confirms nothing" in note for note in words.notes(two, summarize(two)))
    one = made_up({1: [8.0] * 2, 2: [8.1] * 2}, cores=1)
    told = " ".join(words.notes(one, summarize(one)))
    assert "No fit is possible" in told
    assert "Oversubscribed: 2 threads share 1 core." in told


@pytest.mark.parametrize("seconds", [1.0, 1e-9, 8.7e-4, 0.5, 3600.0])
def test_charts_of_a_single_point(seconds: float, monkeypatch: pytest.MonkeyPatch) -> None:
    study = made_up({1: [seconds]})
    summary = summarize(study)
    drawn = charts.charts(study, summary)
    if seconds != 1.0:  # ratios, which all but one show, are those of one second
        drawn = [chart for chart in drawn if chart.name == "time"]
        monkeypatch.setattr(charts, "charts", lambda *_: drawn)
    assert drawn
    assert charts.png(study, summary).startswith(b"\x89PNG")
    assert all("nan" not in charts.svg(c).lower() for c in drawn)


def test_every_color_of_the_charts_is_told_apart() -> None:
    light, dark = charts.palette(), charts.palette(dark=True)
    assert light.keys() == dark.keys()
    assert len(set(light.values())) == len(light)  # the SVG finds its variables by colour

    def luminance(color: str) -> float:
        rgb = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    for colors in light, dark:
        for name, color in colors.items():
            if name in ("page", "grid", "over"):
                continue
            a, b = sorted([luminance(color), luminance(colors["page"])])
            assert (b + 0.05) / (a + 0.05) >= 3, name  # WCAG's least contrast for graphics


# ---- the command, on a renderer with known times


class Page(HTMLParser):
    """The ids and outward references of a page; fails on tags closed out of order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href"):
                self.links.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in ("meta", "img", "br"):
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.usefixtures("engine")
def test_files_of_a_study(tmp_path, capsys) -> None:
    (tmp_path / "mine.txt").write_text("kept")
    (tmp_path / "study.csv").write_text("of an earlier study")
    assert (
        study(
            "--threads", "1,2,4", "--widths", "160,320", "--schedule", "static,dynamic",
            "--repeat", "2", "-o", str(tmp_path),
        )
        == 0
    )  # fmt: skip
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*FILES, "mine.txt"])
    assert (tmp_path / "mine.txt").read_text() == "kept"

    rows = list(csv.DictReader((tmp_path / "study.csv").read_text().splitlines()))
    assert len(rows) == 2 * 2 * 3 * 2
    assert [int(row["order"]) for row in rows] == list(range(24))
    assert {row["oversubscribed"] for row in rows if row["threads"] == "4"} == {"True"}
    assert {row["oversubscribed"] for row in rows if row["threads"] == "2"} == {"False"}

    for row in rows:
        assert (row["spp"], row["tree"], row["sampler"]) == ("20", "bvh", "sobol")
        speed_up = 1 if row["threads"] == "1" else 1 / 0.55
        assert float(row["samples_per_second"]) == pytest.approx(1e6 * speed_up)
        assert float(row["speed_up"]) == pytest.approx(speed_up)
        assert float(row["efficiency"]) == pytest.approx(speed_up / int(row["threads"]))

    document = json.loads((tmp_path / "study.json").read_text())
    assert document["complete"] is True
    assert document["machine"]["instruction_set"] == "avx2"
    assert [p["identical"] for p in document["pictures"]] == [True, True]
    for entry in document["amdahl"]:
        assert entry["fit"]["serial"] == pytest.approx(0.1)
        assert entry["fit"]["threads"] == [1, 2]
    for point in document["summary"]:
        if point["threads"] == 2:
            assert point["speedup"] == pytest.approx(1 / 0.55)
            assert point["median"] == pytest.approx(point["width"] * point["height"] * 11e-6)
    assert document["original"]["seconds"][6][3] == 174.61

    assert (tmp_path / "chart.png").read_bytes().startswith(b"\x89PNG\r\n")

    text = (tmp_path / "report.html").read_text()
    page = Page(text)
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    for link in page.links:
        assert link.startswith(("data:image/png;base64,", "#"))
        if link.startswith("#"):
            assert link[1:] in page.ids
    assert set(re.findall(r"url\(#(.*?)\)", text)) <= set(page.ids)
    assert not re.search(r"@import|url\((?!#)|<script|<link", text)
    for digits in (
        "711.46 (1.00)",
        "174.61 (4.07)",
        ">serial<",
        "4 (oversubscribed)",
        "serial fraction",
    ):
        assert digits in text
    assert "var(--ours-6)" in text
    assert text.count('role="img"') == 6
    assert all(f"<span class='tag {kind}'>" in text for kind in ("measured", "known", "hypothesis"))

    out = capsys.readouterr().out
    assert "4*" in out
    assert "serial fraction of 10 %" in out


@pytest.mark.usefixtures("undrawn")
def test_what_is_asked_of_the_renderer(tmp_path, engine: list[dict]) -> None:
    study(
        "--threads", "1,2", "--widths", "64,320", "--tree", "none", "--sampler", "independent",
        "--schedule", "static", "--repeat", "1", "--aspect", "4:3", "--seed", "9", "--tile", "8",
        "--low-high-spp", "3,6", "-o", str(tmp_path), "--quiet",
    )  # fmt: skip
    warm_up, *timed, low, high = engine
    assert [(c["width"], c["height"], c["threads"]) for c in timed] == [
        (64, 48, 1), (64, 48, 2), (320, 240, 1), (320, 240, 2),
    ]  # fmt: skip
    assert warm_up["width"] == 64
    for call in [warm_up, *timed]:
        assert call["tree"] == "none"
        assert call["spp"] == 20
    for call in engine:
        assert call["sampler"] == "independent"
        assert call["filter"] == "box"
        assert call["roulette"] is False
        assert (call["schedule"], call["max_depth"], call["seed"], call["tile"]) == (
            "static", 50, 9, 8,
        )  # fmt: skip
    assert (low["spp"], high["spp"], low["width"]) == (3, 6, 320)


@pytest.mark.usefixtures("engine", "undrawn")
def test_quiet_prints_nothing(tmp_path, capsys) -> None:
    assert study("--widths", "32", "-o", str(tmp_path), "--quiet") == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


@pytest.mark.usefixtures("engine", "undrawn")
def test_a_picture_that_differs_is_an_error(tmp_path, monkeypatch, capsys) -> None:
    honest = ph.render

    def render(scene: object, **options: object) -> SimpleNamespace:
        image = honest(scene, **options)
        if options["threads"] == 2 and options["width"] == 64:
            image.pixels[3, 5, 1] = np.nextafter(np.float32(0.5), np.float32(1))
        return image

    monkeypatch.setattr(ph, "render", render)
    assert study("--threads", "1,2", "--widths", "32,64", "-o", str(tmp_path)) == 1
    assert "pictures of width 64 differ" in capsys.readouterr().err
    document = json.loads((tmp_path / "study.json").read_text())
    assert [p["identical"] for p in document["pictures"]] == [True, False]
    assert len(document["pictures"][1]["sha256"]) == 2
    text = (tmp_path / "report.html").read_text()
    assert "Error: the pictures of 64 px differ" in text
    assert "PICTURES ARE NOT ALL THE SAME" in text


@pytest.mark.parametrize(("after", "raised"), [(2, True), (9, False), (13, True)])
def test_ctrl_c_writes_what_was_measured(
    after: int, raised: bool, tmp_path, engine, monkeypatch, capsys, request
) -> None:
    if after > 2:  # all widths and threads were measured, as in a complete study
        request.getfixturevalue("undrawn")
    honest = ph.render

    def render(scene: object, **options: object) -> SimpleNamespace:
        stopped = len(engine) == after
        if stopped and raised:
            raise KeyboardInterrupt
        image = honest(scene, **options)
        image.stats.complete = not stopped
        return image

    monkeypatch.setattr(ph, "render", render)
    options = ["--threads", "1,2", "--widths", "32,64", "-o", str(tmp_path)]
    assert study(*options) == 130
    document = json.loads((tmp_path / "study.json").read_text())
    assert document["complete"] is False
    assert len(document["runs"]) == min(after - 1, 12)  # the first call is the warm-up
    assert "Stopped early" in (tmp_path / "report.html").read_text()
    assert "stopped after" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_stopped_study_leaves_a_complete_one_alone(tmp_path, engine, monkeypatch, capsys) -> None:
    options = ["--threads", "1,2", "--widths", "32", "--repeat", "1", "-o", str(tmp_path)]
    assert study(*options) == 0
    before = {name: (tmp_path / name).read_bytes() for name in FILES}
    honest, measured = ph.render, len(engine)

    def render(scene: object, **options: object) -> SimpleNamespace:
        if len(engine) == measured + 2:  # after the warm-up and one run
            raise KeyboardInterrupt
        return honest(scene, **options)

    monkeypatch.setattr(ph, "render", render)
    assert study(*options) == 130
    assert str(tmp_path / "stopped") in capsys.readouterr().err
    assert {name: (tmp_path / name).read_bytes() for name in FILES} == before
    assert sorted(p.name for p in (tmp_path / "stopped").iterdir()) == FILES
    document = json.loads((tmp_path / "stopped" / "study.json").read_text())
    assert document["complete"] is False
    assert len(document["runs"]) == 1


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("full", FILES)
def test_a_full_disk_leaves_the_old_study_whole(full: str, tmp_path, monkeypatch) -> None:
    for name in FILES:
        (tmp_path / name).write_text("old")
    write = Path.write_bytes

    def write_bytes(path: Path, content: bytes) -> int:
        if path.suffix == Path(full).suffix:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    measured = made_up({1: [8.0], 4: [2.5]})
    with pytest.raises(ResourceError) as caught:
        output.write(tmp_path, measured, summarize(measured))
    assert str(caught.value) == f"{tmp_path / full}: cannot be written: No space left on device"
    assert sorted(p.name for p in tmp_path.iterdir()) == FILES
    assert {(tmp_path / name).read_text() for name in FILES} == {"old"}


@pytest.mark.usefixtures("engine")
def test_ctrl_c_before_the_first_run_writes_nothing(tmp_path, monkeypatch) -> None:
    def render(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ph, "render", render)
    assert study("-o", str(tmp_path)) == 130
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_can_not_be_written_is_told_before_measuring(tmp_path, engine) -> None:
    (tmp_path / "file").write_text("kept")
    for folder in (tmp_path / "file", tmp_path / "file" / "inside"):
        with pytest.raises(ResourceError, match="file"):
            study("-o", str(folder))
    assert engine == []
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.usefixtures("engine")
def test_one_core_and_one_width(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(machine, "cores_available", lambda: 1)
    assert study("--widths", "48", "--repeat", "1", "-o", str(tmp_path)) == 0
    document = json.loads((tmp_path / "study.json").read_text())
    assert document["amdahl"][0]["fit"] is None
    assert "no fit possible" in (tmp_path / "report.html").read_text()


# ---- the command, for real


def parhelion(*options: str) -> list[str]:
    return [sys.executable, "-m", "parhelion", *options]


def test_real_study(tmp_path) -> None:
    options = [
        "study", "--threads", "1,2,3", "--widths", "48,96", "--spp", "4", "--repeat", "2",
        "--schedule", "static,dynamic,guided", "--low-high-spp", "2,8", "-o", str(tmp_path),
    ]  # fmt: skip
    done = subprocess.run(parhelion(*options), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "study.json").read_text())
    assert all(p["identical"] for p in document["pictures"])
    assert len(document["runs"]) == 2 * 2 * 3 * 3
    assert all(run["seconds"] > 0 and run["rays"] >= run["samples"] for run in document["runs"])
    assert document["pair"]["relative_rms_difference"] > 0


@pytest.mark.usefixtures("undrawn")
def test_real_brute_force_gives_the_same_picture_as_the_tree(tmp_path) -> None:
    hashes = []
    for tree in ("bvh", "none"):
        options = ["--threads", "1", "--widths", "32", "--spp", "2", "--repeat", "1"]
        options += ["--low-high-spp", "1,2", "--tree", tree, "-o", str(tmp_path / tree), "--quiet"]
        assert study(*options) == 0
        document = json.loads((tmp_path / tree / "study.json").read_text())
        hashes.append(document["pictures"][0]["sha256"])
    assert hashes[0] == hashes[1]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to another process")
def test_real_ctrl_c(tmp_path) -> None:
    options = ["study", "--widths", "64", "--repeat", "1000", "--spp", "64", "-o", str(tmp_path)]
    options += ["--log-level", "debug"]
    process = subprocess.Popen(
        parhelion(*options), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    late = threading.Timer(60, process.kill)
    late.start()
    while "scene weekend" not in process.stderr.readline():  # told when the first run begins
        assert process.poll() is None, process.communicate()
    late.cancel()
    time.sleep(0.5)
    assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130, err
    assert "stopped" in err
    assert "Traceback" not in err
    if (tmp_path / "study.json").exists():  # a slow start may leave nothing to write
        assert json.loads((tmp_path / "study.json").read_text())["complete"] is False


@pytest.mark.parametrize("options", [["--threads", "0"], ["--aspect", "1:1"], ["-o", "/dev/null"]])
def test_real_mistakes_exit_with_2_and_one_line(options: list[str], tmp_path) -> None:
    done = subprocess.run(
        parhelion("study", *options), capture_output=True, text=True, timeout=60, cwd=tmp_path
    )
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
