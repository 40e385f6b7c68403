"""The harness of bench/: its arithmetic, and that it runs."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import fmean

import numpy as np
import pytest

import parhelion as ph

REPOSITORY = Path(__file__).resolve().parent.parent
if not (REPOSITORY / "bench").is_dir():
    pytest.skip("bench/ is not part of a source distribution", allow_module_level=True)
sys.path.insert(0, str(REPOSITORY))

from bench import __main__ as main  # noqa: E402
from bench import charts, instructions, memory, rays, trees  # noqa: E402
from bench.compare import compare, verdict  # noqa: E402
from bench.equal import seconds_at  # noqa: E402
from bench.gallery import SCENES  # noqa: E402
from bench.measure import Notes, Plan, alternate  # noqa: E402
from bench.renderers import luxcore  # noqa: E402
from bench.scenes import GALLERY, BenchError, by_scene, read_weekend  # noqa: E402
from bench.summary import Row, ratios, spread, table  # noqa: E402
from bench.threads import counts  # noqa: E402

# A file without rows, and one of these
FRAME = {"machine": {}, "plan": {}, "versions": {}, "notes": []}
ROW = Row("g", "n", "s", [1.0]).json()


def written(rows: list[dict]) -> dict:
    return {**FRAME, "rows": rows}


def weekend() -> dict:
    names = ("center", "radius", "type", "albedo", "fuzz", "ior")
    spheres = [
        ([0, -1000, 0], 1000, "diffuse", [0.5, 0.5, 0.5], 0, 0),
        ([0, 1, 0], 1, "glass", [1, 1, 1], 0, 1.5),
        ([4, 1, 0], 1, "metal", [0.7, 0.6, 0.5], 0.3, 0),
    ]
    return {
        "camera": {
            "lookfrom": [13, 2, 3],
            "lookat": [0, 0, 0],
            "vup": [0, 1, 0],
            "vfov": 20,
            "focus_dist": 10,
            "lens_radius": 0.05,
        },
        "sky": {"horizon": [1, 1, 1], "zenith": [0.5, 0.7, 1]},
        "spheres": [dict(zip(names, s, strict=True)) for s in spheres],
    }


@pytest.fixture
def spheres(tmp_path: Path) -> Path:
    path = tmp_path / "spheres.json"
    path.write_text(json.dumps(weekend()))
    return path


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_spread_and_ratios():
    assert spread([3.0, 1.0, 2.0]) == {"median": 2.0, "min": 1.0, "max": 3.0}
    # pair by pair: the machine was half as fast in the second round
    assert ratios([2.0, 4.0], [1.0, 2.0]) == [2.0, 2.0]
    with pytest.raises(ValueError, match="longer"):
        ratios([1.0], [1.0, 2.0])


def test_runs_alternate_and_the_first_round_is_not_counted():
    order: list[str] = []

    def runner(name: str):
        return lambda: order.append(name) or {"turn": len(order)}

    answers = alternate([(name, runner(name)) for name in "abc"], 3)
    assert order == [*"abc", *"acb", *"cab", *"cba"]
    assert answers["a"] == [{"turn": 4}, {"turn": 8}, {"turn": 12}]
    # none always comes after the same one
    for name in "abc":
        assert len({before for before, after in pairwise(order) if after == name}) > 1


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (Row("g", "n", "s", [1.0], most=1.0), "at most 1, met"),
        (Row("g", "n", "s", [1.1], most=1.0), "at most 1, MISSED"),
        (Row("g", "n", "s", [2.0], ratios=[1.9], against="b", least_ratio=1.9), "met"),
        (Row("g", "n", "s", [2.0], ratios=[1.8], against="b", least_ratio=1.9), "MISSED"),
        (
            Row("g", "n", "M/s", [2.0], ratios=[1.0], against="b", most_ratio=1.0),
            "at most 1 x, met",
        ),
        (Row("g", "n", "M/s", [2.0], ratios=[1.1], against="b", most_ratio=1.0), "MISSED"),
        (Row("g", "n", "s", [2.0], ratios=[1, 3, 5], against="b"), "3 x b (1 to 5)"),
    ],
)
def test_table_says_what_was_asked(row: Row, words: str):
    lines = table([row]).splitlines()
    assert len(lines) == 3
    assert len({len(line) for line in lines}) == 1
    assert words in lines[2]


def row(*runs: float, more: bool = False, **others: object) -> dict:
    return Row("g", "n", "s", runs, more=more, **others).json()


def peer(*ratios: float, more: bool = False) -> dict:
    return row(*ratios, more=more, against="parhelion", ratios=ratios)


def asked(*ratios: float, **ratio: float) -> dict:
    """Of seconds that fall as the ratio rises."""
    return row(*(7.0 / r for r in ratios), against="traversal", ratios=ratios, **ratio)


@pytest.mark.parametrize(
    ("before", "after", "word"),
    [
        (row(1.0, 1.1, 1.1), row(1.2, 1.3, 1.2), "worse"),
        (row(1.2, 1.3, 1.3), row(1.0, 1.1, 1.0), "better"),
        (row(1.0, 1.1, 1.0, more=True), row(1.2, 1.3, 1.2, more=True), "better"),
        (row(1.2, 1.3, 1.2, more=True), row(1.0, 1.1, 1.0, more=True), "worse"),
        (row(1.0, 1.2, 1.1), row(1.1, 1.3, 1.2), "same"),  # overlap
        (row(1.0, 1.0, 1.0), row(1.005, 1.005, 1.005), "same"),  # apart, but by too little
        (row(1.0, 1.0), row(2.0, 2.0, 2.0), "unknown"),
        (row(0.0, 0.0, 0.0), row(1.0, 1.0, 1.0), "worse"),
        # another's seconds over ours, and its speed over ours
        (peer(2.0, 2.1, 2.1), peer(1.5, 1.6, 1.6), "worse"),
        (peer(1.2, 1.3, 1.3, more=True), peer(1.0, 1.1, 1.1, more=True), "better"),
        # where a ratio is asked for, that, however fast the machine was
        (asked(2.0, 2.1, 2.1, most_ratio=1.6), asked(2.3, 2.3, 2.4, most_ratio=1.6), "worse"),
        (asked(1.8, 1.8, 1.8, least_ratio=1.9), asked(1.9, 2.0, 1.9, least_ratio=1.9), "better"),
        (row(7.0, 7.0, 7.0), asked(2.0, 2.0, 2.0, most_ratio=1.6), "unknown"),
        # twice the time, but to a third of the error
        (row(1.0, 1.1, 1.0, error=0.3), row(2.0, 2.2, 2.0, error=0.1), "better"),
    ],
)
def test_verdict(before: dict, after: dict, word: str):
    assert verdict(before, after) == word


def test_a_slower_machine_does_not_change_how_others_stand_to_ours():
    before = row(2.0, 2.0, 2.0, against="parhelion", ratios=[2.0, 2.1, 2.0])
    after = row(9.0, 9.0, 9.0, against="parhelion", ratios=[2.0, 2.1, 2.0])
    assert verdict(before, after) == "same"


def test_compare_lists_every_row_and_what_differs_around_them():
    rest = {"machine": {"cpu": "x"}, "plan": {"spp": 20}, "notes": []}
    same = row(1, 1, 1)
    before = {
        **rest,
        "versions": {"parhelion": {"version": "1", "isa": "avx2", "build": "a"}},
        "rows": [{**same, "name": "kept"}, row(1, 1, 1), {**same, "name": "old"}],
    }
    after = {
        "machine": {"cpu": "y"},
        "plan": {"spp": 20},
        "versions": {"parhelion": {"version": "2", "isa": "avx2", "build": "b"}},
        "notes": ["busy"],
        "rows": [{**same, "name": "kept"}, row(2, 2, 2), {**same, "name": "new"}],
    }
    lines, worse = compare(before, after)
    assert worse
    assert "machine, cpu: x before, y after" in lines[0]
    assert lines[1:3] == ["note: parhelion, version: 1 before, 2 after", "note: after: busy"]
    assert [line.split()[0] for line in lines[3:-1]] == ["worse", "new", "gone", "same"]
    assert "(+100.0%)" in lines[3]
    assert lines[-1] == "1 worse, 0 better, 0 unknown, 1 new, 1 gone, 1 same"
    assert compare(before, before)[1] is False


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "--spheres"),
        ("{", "Expecting"),
        ("{}", "camera"),
        (json.dumps(weekend()).replace('"glass"', '"glas"'), "unknown type 'glas'"),
    ],
)
def test_a_bad_scene_file_is_one_clear_error(tmp_path: Path, text: str | None, words: str):
    path = tmp_path / "s.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BenchError, match=words):
        read_weekend(path)


def test_the_whole_harness_runs_and_its_files_compare(tmp_path: Path, spheres: Path):
    output = tmp_path / "b.json"
    size = ("--width", 16, "--height", 9, "--spp", 1, "--rounds", 1, "--reference-spp", 4)
    done = command(
        *("-m", "bench", "--spheres", spheres, "--peers", "none", "--cache", tmp_path / "cache"),
        *("--only", "weekend,settings,startup,error", "-o", output),
        *size,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(output.read_text())
    assert {r["group"] for r in result["rows"]} >= {"weekend", "threads", "tree", "start"}
    assert all(value > 0 for r in result["rows"] for value in r["runs"] if r["group"] != "start")
    assert result["versions"]["parhelion"]["version"]
    assert "| weekend: parhelion " in done.stdout

    same = command("bench/compare.py", output, output)
    assert same.returncode == 0, same.stderr
    assert len(same.stdout.splitlines()) == len(result["rows"]) + 1


@pytest.mark.parametrize(
    ("error", "seconds"),
    [(0.4, 1.0), (0.1, 4.0), (0.2, 2.0), (0.8, 0.5), (0.01, 40.0)],
)
def test_seconds_to_an_error_lie_on_the_line_through_both_measurements(
    error: float, seconds: float
):
    assert seconds_at(error, (0.4, 1.0), (0.1, 4.0)) == pytest.approx(seconds)


def test_the_command_offers_every_scene_of_the_gallery():
    assert tuple(SCENES) == GALLERY


def test_clouds_of_any_number_of_spheres(tmp_path: Path):
    output = tmp_path / "b.json"
    done = command(
        *("-m", "bench", "--only", "clouds", "--clouds", "1e3,2500", "--rounds", 1),
        *("--width", 16, "--height", 9, "-o", output),
    )
    assert done.returncode == 0, done.stderr
    groups = {r["group"] for r in json.loads(output.read_text())["rows"]}
    plain = {"1e3 spheres", "2.5e3 spheres"}
    assert groups == plain | {f"{name}, half of glass" for name in plain}
    done = command("-m", "bench", "--only", "clouds", "--clouds", "1.5,-2")
    assert done.returncode == 2
    assert "'1.5,-2': whole numbers from 1 are needed" in done.stderr


def test_equal_error_of_a_cloud_without_peers(tmp_path: Path):
    output = tmp_path / "b.json"
    done = command(
        *("-m", "bench", "--only", "equal", "--scenes", "cloud-1e4", "--peers", "none"),
        *("--width", 24, "--height", 18, "--rounds", 1, "--reference-spp", 256),
        *("--cache", tmp_path, "-o", output),
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(output.read_text())
    rows = {r["group"]: r["runs"] for r in result["rows"]}
    few, many = (rows[f"relative error, cloud-1e4, at {spp} spp"][0] for spp in (8, 32))
    assert many < few
    assert rows["equal error, cloud-1e4, clock"][0] > 0
    assert (tmp_path / "equal" / "equal.md").read_text().count("cloud-1e4") == 1

    # to twice the error in the same time
    for each in result["rows"]:
        each["runs"] *= 3
        each["error"] = 2 * each["error"] if each["error"] else None
    worse = tmp_path / "worse.json"
    worse.write_text(json.dumps(result))
    for each in result["rows"]:
        each["error"] = each["error"] / 2 if each["error"] else None
    output.write_text(json.dumps(result))
    done = command("bench/compare.py", output, worse)
    assert done.returncode == 1, done.stderr
    # both ways of ours, all pixels and trimmed, by two clocks
    assert done.stdout.count("worse    equal") == 8


def test_sharing_beside_each_pixel_by_itself(tmp_path: Path):
    output = tmp_path / "b.json"
    done = command(
        *("-m", "bench", "--only", "sharing", "--scenes", "lamps-1e3", "--spp", 4),
        *("--width", 32, "--height", 24, "--rounds", 2, "--reference-spp", 128),
        *("--cache", tmp_path, "-o", output),
    )
    assert done.returncode == 0, done.stderr
    rows = {(r["group"], r["name"]): r for r in json.loads(output.read_text())["rows"]}

    def runs(what: str, way: str) -> list[float]:
        return rows[f"sharing, lamps-1e3, {what}", way]["runs"]

    for what in ("error", "trimmed error"):
        for way in ("alone", "shared", "by default"):
            error = fmean(runs(what, way))
            seconds = runs("processor", way)
            assert runs(f"mean {what} x time", way) == [error * s for s in seconds]
        assert runs(what, "shared") != runs(what, "alone")
        assert runs(what, "by default") == runs(what, "alone")  # the picture is small


def test_threads_by_clock_and_processor(tmp_path: Path):
    assert counts(1) == [1]
    assert counts(6) == [6, 4, 2, 1]
    assert counts(8) == [8, 4, 2, 1]
    output = tmp_path / "b.json"
    done = command(
        *("-m", "bench", "--only", "threads", "--scenes", "cloud-1e4", "--threads", 2),
        *("--width", 16, "--height", 9, "--spp", 4, "--rounds", 1, "-o", output),
        *("--charts", tmp_path),
    )
    assert done.returncode == 0, done.stderr
    assert "cloud-1e4" in (tmp_path / "threads.svg").read_text()
    rows = {(r["group"], r["name"]): r for r in json.loads(output.read_text())["rows"]}
    both, one = (rows["threads, cloud-1e4, clock", n]["runs"][0] for n in ("2 threads", "1 thread"))
    assert rows["threads, cloud-1e4, clock", "1 thread"]["ratios"] == [one / both]
    assert rows["threads, cloud-1e4, processor", "1 thread"]["least_ratio"] == 0.97


def test_a_scene_that_cannot_be_measured_is_a_note():
    def measure(_plan: Plan, _notes: Notes, name: str) -> list[str]:
        if name == "coffee":
            raise BenchError("its files are not here")
        return [name]

    notes, plan = Notes(), Plan(Path(), scenes=("weekend", "coffee", "sponza"))
    assert list(by_scene(plan, notes, "threads", measure)) == [["weekend"], ["sponza"]]
    assert notes.lines == ["threads, coffee: not measured: its files are not here"]


def test_overhead_is_the_whole_over_traversal(tmp_path: Path):
    output = tmp_path / "b.json"
    done = command(
        *("-m", "bench", "--only", "overhead", "--scenes", "cloud-1e4", "--rounds", 3),
        *("--width", 128, "--height", 72, "--spp", 8, "-o", output),
    )
    assert done.returncode == 0, done.stderr
    walks, whole = json.loads(output.read_text())["rows"]
    pairs = zip(whole["runs"], walks["runs"], strict=True)
    assert whole["ratios"] == [seconds / traversal for seconds, traversal in pairs]
    assert whole["most_ratio"] == 1.6
    # one of the few walks that are timed may wait for another program
    assert 1.0 < max(whole["ratios"]) < 20.0


def test_trees_on_all_threads_and_what_they_cost(tmp_path: Path):
    path = tmp_path / "rays.npz"
    rays.write(path, "spheres", 1000)
    rows = {row.name: row for row in trees._measured(Plan(path, rounds=1), Notes(), path, "few")}
    assert rows["parhelion"].runs[0] > 0
    if "embreex" in rows:
        assert rows["embreex"].ratios == [rows["embreex"].runs[0] / rows["parhelion"].runs[0]]
    # a line through the box meets the root, and of a thousand spheres' leaves at least a few
    assert rows["nodes that a line meets"].runs[0] > 1
    assert 1 < rows["leaves that a line meets"].runs[0] < 1000 / 16


def test_rays_and_how_many_get_out_of_a_closed_mesh(tmp_path: Path):
    path = tmp_path / "rays.npz"
    rays.write(path, "triangles", 1000)
    measured = rays.measured(Plan(path, rounds=1), Notes(), path, "few triangles", "triangles")
    of = {(row.group.split(", ")[1], row.name): row for row in measured}
    assert of["bounce", "parhelion"].runs[0] > 0
    assert of["lost at edges", "parhelion"].runs == [0.0]
    assert of["lost at edges", "parhelion public"].runs == [0.0]
    assert of["any hit", "parhelion public"].ratios[0] > 0
    assert of["one a call", "parhelion public"].runs[0] > 0
    assert ("tree", "parhelion public") not in of
    assert ("one a call", "parhelion") not in of
    assert of["shadow", "parhelion"].runs[0] > 0
    if ("camera", "embreex") in of:
        asked = [row.most_ratio for row in measured if row.name == "embreex packets"]
        assert asked == [None, None]  # a camera's rays and towards the sun, as a figure alone
        assert of["shadow", "embreex"].most_ratio == 1.0
    if ("bounce", "embreex public") in of:
        one, other = of["bounce", "embreex public"], of["bounce", "parhelion public"]
        assert one.against == other.name
        assert one.ratios == [one.runs[0] / other.runs[0]]
        assert ("tree", "embreex public") not in of
        assert of["one a call", "embreex public"].against == other.name
    if ("bounce", "embreex robust") in of:
        # that these are rays which can get lost
        default = of["lost at edges", "embreex"].runs[0]
        assert of["lost at edges", "embreex robust"].runs[0] < default < 50.0


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what a process holds")
def test_memory_that_scenes_leave(monkeypatch: pytest.MonkeyPatch):
    rendered = []
    monkeypatch.setattr(memory, "SCENES", 12)
    monkeypatch.setattr(memory, "FIRST", 2)
    monkeypatch.setattr(ph, "render", lambda scene, **_: rendered.append(scene))
    monkeypatch.setattr(memory, "status_bytes", lambda _field: 1000 * len(rendered))
    assert memory.left() == 10_000


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what a process holds")
def test_memory_by_samples_forgets_what_the_tree_took(monkeypatch: pytest.MonkeyPatch):
    asked = []
    monkeypatch.setattr(memory, "_asked", lambda call: asked.append(call) or 2e6 * len(asked))
    few, many, left = memory.memory(Plan(Path(), rounds=1), Notes())
    assert asked == ["peak(16)", "peak(4096)", "left()"]
    assert (few.runs, many.runs, many.ratios, left.runs) == ([2.0], [4.0], [2.0], [6.0])
    before = "import numpy; numpy.ones(25_000_000)"  # 200 MB, given back at once
    done = command("-c", f"from bench.memory import peak; {before}; print(peak(1))")
    assert 1e7 < int(done.stdout) < 2e8


@pytest.mark.parametrize("ball", [luxcore._ball(3), luxcore._ball_towards(np.array([1, 9, 2.0]))])
def test_balls_of_luxcore_are_closed_and_turned_outwards(ball: luxcore.Ball):
    points, faces = ball
    assert np.allclose(np.linalg.norm(points, axis=1), 1.0)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edges, back = start * len(points) + end, end * len(points) + start
    edges.sort()
    assert (np.diff(edges) > 0).all()
    assert np.array_equal(edges, np.sort(back))  # each way once: all are turned alike
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(axis=1)
    assert (np.einsum("ij,ij->i", normals, middle) > 0).all()


def test_a_ground_of_luxcore_is_fine_where_it_is_seen():
    direction = np.array([0.0, 1.0, 0.0])
    points, faces = luxcore._ball_towards(direction)
    middle = points[faces].mean(axis=1)
    far = np.hypot(middle[:, 0], middle[:, 2])
    seen = (far > 1e-3) & (far < 0.1) & (middle[:, 1] > 0)
    assert seen.sum() > 100_000
    assert (1 - np.linalg.norm(middle[seen], axis=1) < 1e-4 * far[seen] ** 2).all()


def test_luxcore_is_given_nothing_unlike():
    ball = ph.Spheres([(0, 0, 0)], 1.0, ph.Material("diffuse", color=(0.1, 0.2, 0.3)))
    camera = ph.Camera(eye=(0, 0, 5), target=(0, 0, 0), vfov=40)
    made = luxcore._Conversion(ph.Scene([ball], camera=camera, background=None), 32, 16)
    assert made.properties["scene.materials.material0.kd"] == [0.1, 0.2, 0.3]
    assert made.properties["scene.camera.screenwindow"] == [-2.0, 2.0, -1.125, 0.875]
    assert list(made.meshes) == ["ball4"]
    for material, words in (
        (ph.Material("plastic"), "'plastic'"),
        (ph.conductor("Au", roughness=0.4), "conductors"),
        (ph.Material("diffuse", opacity=0.5), "opacity"),
    ):
        spheres = ph.Spheres([(0, 0, 0)], 1.0, material)
        scene = ph.Scene([spheres], camera=camera, background=None)
        with pytest.raises(BenchError, match=words):
            luxcore._Conversion(scene, 32, 16)


def test_charts_are_drawn_of_what_the_files_have(tmp_path: Path, capsys: pytest.CaptureFixture):
    def of(group: str, name: str, *runs: float) -> dict:
        return {**row(*runs), "group": group, "name": name}

    sizes = (10**5, 10**6, 10**7)
    clouds = [
        of(f"{n:.0e} spheres".replace("e+0", "e"), name, value)
        for n in sizes
        for name, value in (
            ("checks and tree, processor", 5e-7 * n),
            ("peak memory beyond the input", 40.0 + 1e7 / n),
            ("whole paths", 5.0 - 0.3 * np.log10(n)),
        )
    ]
    equal = [
        of(f"{what}, weekend, at {spp} spp", name, value)
        for name in ("parhelion", "luxcore")
        for spp in (16, 64)
        for what, value in (("trimmed error", 1 / spp), ("processor", spp / 10))
    ]
    (tmp_path / "a.json").write_text(json.dumps(written(clouds)))
    (tmp_path / "b.json").write_text(json.dumps(written(equal)))
    files = [str(tmp_path / name) for name in ("a.json", "b.json")]
    folder = tmp_path / "charts" / "of it"  # is made
    assert charts.main([*files, "-o", str(folder)]) == 0
    assert sorted(path.stem for path in folder.glob("*.svg")) == ["error", "scale"]
    drawn = (folder / "error.svg").read_text()
    assert all(word in drawn for word in ("weekend", "Parhelion", "LuxCore"))
    assert "Cycles" not in drawn
    # memory by its slope over the number: 40 bytes each and 1e7 altogether; speed by each tenfold
    said = capsys.readouterr().out
    assert "memory beyond the input, GB: 4.01 at 1e+08" in said
    assert "whole paths, M rays/s and core: 2.6 at 1e+08" in said

    # so few spheres that a line through the largest two would come to less than nothing
    few = {"1e5": "1e2", "1e6": "1e3", "1e7": "1e4"}
    for line in clouds:
        line["group"] = few[line["group"].split()[0]] + " spheres"
        if "tree" in line["name"]:
            line["median"] = 0.01
    (tmp_path / "few.json").write_text(json.dumps(written(clouds)))
    assert charts.main([str(tmp_path / "few.json"), "-o", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "a sphere: what was measured tells nothing of 1e+05\n" in said
    assert "whole paths, M rays/s and core: 2.6 at 1e+05" in said

    (tmp_path / "c.json").write_text(json.dumps(written([])))
    assert charts.main([str(tmp_path / "c.json"), "-o", str(folder)]) == 2
    none = "nothing measured that charts show: error, rays, scale, threads\n"
    assert capsys.readouterr().err == none
    assert charts.main([*files, "-o", files[0]]) == 2
    assert "a.json: can not write into this folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file"),
        ("{", "is no JSON"),
        ("\x00\xff", "is no JSON"),
        ("[]", "is no file of python -m bench"),
        ('{"rows": []}', "is no file of python -m bench"),
        (json.dumps({**FRAME, "rows": "x"}), "is no file of python -m bench"),
        (json.dumps({**FRAME, "rows": [{"what": 3}]}), "is no file of python -m bench"),
        (json.dumps(written([{**ROW, "median": "x"}])), "is no file of python -m bench"),
    ],
)
def test_what_is_no_file_of_ours_is_named(tmp_path: Path, text: str | None, words: str):
    path = tmp_path / "x.json"
    if text is not None:
        path.write_text(text, encoding="latin-1")
    good = tmp_path / "good.json"
    good.write_text(json.dumps(written([row(1.0)])))
    for arguments in (
        ("bench/compare.py", good, path),
        ("-m", "bench.charts", path, "-o", tmp_path),
    ):
        done = command(*arguments)
        assert done.returncode == 2
        (line,) = done.stderr.splitlines()
        assert f"{path}: " in line
        assert words in line


def test_instructions_that_became_more_are_a_failure():
    before = {"a": 100.0, "b": 100.0, "c": 100.0}
    lines, failed = instructions.compare(before, {"a": 101.9, "b": 98.1, "c": 97.0, "d": 5.0})
    assert [line.split()[0] for line in lines] == ["same", "same", "fewer", "new"]
    assert not failed
    lines, failed = instructions.compare(before, {"a": 102.1, "b": 100.0, "c": 100.0})
    assert failed
    assert lines[0] == "more   a: 102.1 (+2.1%)"
    lines, failed = instructions.compare(before, {"a": 100.0, "b": 100.0})
    assert failed
    assert lines[-1] == "gone   c"


@pytest.mark.parametrize(
    ("library", "name"),
    [
        (b"\0GCC: (Debian 12.2.0-14+deb12u1) 12.2.0\0", "gcc 12"),
        (b"\0Debian clang version 14.0.6\0GCC: (GNU) 11.3.0\0", "clang 14"),
    ],
)
def test_counts_are_kept_by_compiler(library: bytes, name: str):
    assert instructions.compiler(library) == name
    with pytest.raises(BenchError, match="by which compiler"):
        instructions.compiler(b"\0")


def test_every_kernel_that_is_counted_has_a_count():
    kept = json.loads(instructions.KEPT.read_text())
    names = [name for name, _, _ in instructions.kernels()]
    assert all(list(counts) == names for counts in kept.values())


def test_mistakes_end_with_2_and_one_line(tmp_path: Path):
    done = command("-m", "bench", "--spheres", tmp_path / "none.json", "--only", "settings")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("bench: ")
    assert "--spheres" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    # before anything is measured
    for option, place in (
        ("-o", tmp_path),
        ("-o", tmp_path / "none" / "x.json"),
        ("--charts", __file__),
    ):
        done = command("-m", "bench", "--only", "settings", option, place)
        assert done.returncode == 2
        (line,) = done.stderr.splitlines()
        assert line.startswith(f"bench: {place}: ")


def test_what_was_measured_is_kept(monkeypatch: pytest.MonkeyPatch):
    def group(problem: BaseException | None, *found: Row):
        def measured(_plan: Plan, _notes: Notes) -> Iterator[Row]:
            yield from found
            if problem:
                raise problem

        return measured

    groups = {
        "good": group(None, Row("good", "n", "s", [1.0])),
        "half": group(BenchError("it ended"), Row("half", "n", "s", [1.0])),
        "none": group(None),
        "wrong": group(OSError("no place"), Row("wrong", "n", "s", [1.0])),
        "long": group(KeyboardInterrupt(), Row("long", "n", "s", [1.0])),
    }
    monkeypatch.setattr(main, "GROUPS", groups)

    def measured(*only: str) -> tuple[int, list[str], list[str]]:
        rows: list[Row] = []
        notes = Notes()
        status = main.measure_groups(only, Plan(Path()), notes, rows)
        return status, [r.group for r in rows], notes.lines

    assert measured("good") == (0, ["good"], [])
    assert measured("half", "good") == (
        *(1, ["half", "good"]),
        ["half was not measured to the end: it ended"],
    )
    assert measured("wrong", "good") == (
        *(1, ["wrong", "good"]),
        ["wrong was not measured to the end: no place"],
    )
    assert measured("none", "good") == (1, ["good"], ["none: nothing was measured"])
    assert measured("good", "long", "half") == (
        *(130, ["good", "long"]),
        ["stopped by Ctrl-C while long was measured"],
    )


def test_a_played_cluster_loses_what_things_cost() -> None:
    """Without costs and differences all workers are busy to the end; each cost shows."""
    from bench.cluster import MEASURED, play

    free = replace(
        MEASURED, spread=0.0, desk=1e-9, desk_byte=0.0, unit=0.0, unit_byte=0.0, head=0.0,
        pixel=0.0, latency=0.0, pause=1e-6,
    )  # fmt: skip
    assert play(4, 10.0, (512, 512), free).efficiency > 0.99
    for dear in ({"desk": 1.0}, {"unit": 0.5}, {"pixel": 1e4, "bandwidth": 1e7}, {"latency": 1.0}):
        assert play(4, 10.0, (512, 512), replace(free, **dear)).efficiency < 0.9
