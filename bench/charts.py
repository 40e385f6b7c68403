"""Draws what the bench has measured, in one style: each chart for which the files have rows.

    python -m bench.charts RESULT.json... -o docs/images

error.svg     error against time by scene and renderer, of the group `equal`
rays.svg      rays a second against primitives, ours and Embree's, of `rays`
scale.svg     tree, memory and rays a second against spheres, of `clouds`, and what lies beyond: a
              line through the two largest goes on to ten times the largest; memory by its slope
              over the number of spheres, speeds by theirs over its logarithm, as a tree has a level
              more for every sixteen times the spheres
threads.svg   speed-up against threads, of `threads`
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from parhelion.atomic import replacing
from parhelion.errors import ResourceError
from parhelion.study.output import prepare_folder

from .compare import BenchFileError, read
from .measure import ALONE, OURS, PEERS
from .rays import EMBREE, PACKETS, RAYS, ROBUST
from .scenes import GALLERY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = {
    "svg.hashsalt": "parhelion",  # the same file for the same numbers
    "svg.fonttype": "none",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.markersize": 4,
}

# Each program has one colour wherever it is drawn.
COLORS = {name: f"C{i}" for i, name in enumerate((OURS, *PEERS, EMBREE, ALONE, ROBUST))}
LABELS = {OURS: "Parhelion", "mitsuba-llvm": "Mitsuba, LLVM", "mitsuba-scalar": "Mitsuba, scalar"}
LABELS |= {"cycles": "Cycles", "luxcore": "LuxCore", EMBREE: "Embree", ROBUST: "Embree, robust"}
LABELS[ALONE] = "Parhelion, own paths"

Rows = list[dict[str, Any]]


def found(rows: Rows, pattern: str) -> dict[tuple[str, ...], dict[str, Any]]:
    """By what the groups of a pattern match in "GROUP: NAME"; the last where there are several."""
    matches = ((re.fullmatch(pattern, f"{row['group']}: {row['name']}"), row) for row in rows)
    return {match.groups(): row for match, row in matches if match}


def grid(count: int, columns: int, height: float) -> tuple[Figure, list[Any]]:
    """A figure of small multiples, and the axes of as many."""
    from matplotlib.figure import Figure

    rows = -(-count // columns)
    figure = Figure(figsize=(2.75 * columns, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat[count:]:
        axis.remove()
    return figure, list(axes.flat[:count])


def error(rows: Rows) -> Figure | None:
    """A line for each renderer from half to twice the samples of equal error, in logarithms."""
    errors = found(rows, r"trimmed error, (.+), at (\d+) spp: (.+)")
    times = found(rows, r"processor, (.+), at (\d+) spp: (.+)")
    scenes = [name for name in GALLERY if any(name == scene for scene, *_ in errors)]
    if not scenes:
        return None
    figure, axes = grid(len(scenes), 4, 2.3)
    drawn: dict[str, Any] = {}
    for axis, scene in zip(axes, scenes, strict=True):
        for name in (OURS, ALONE, *PEERS):
            points = sorted(
                (times[key]["median"], row["median"])
                for key, row in errors.items()
                if key[0] == scene and key[2] == name
            )
            if points:
                (drawn[name],) = axis.loglog(*zip(*points, strict=True), "o-", color=COLORS[name])
        axis.set_title(scene, fontsize="medium")
    for axis in axes[-4:]:
        axis.set_xlabel("processor, s")
    for axis in axes[::4]:
        axis.set_ylabel("relative error")
    labels = [LABELS[name] for name in drawn]
    figure.legend(drawn.values(), labels, loc="outside upper center", ncols=len(drawn))
    return figure


def rays(rows: Rows) -> Figure | None:
    """By the kind of rays, triangles and spheres, ours and Embree's."""
    what = rf"(\S+) (triangles|spheres), ({'|'.join(RAYS)}): (.+)"
    speeds = found(rows, what)
    if not speeds:
        return None
    figure, axes = grid(len(RAYS), 2, 2.6)
    for axis, kind in zip(axes, RAYS, strict=True):
        for program, shape, line in (
            (OURS, "triangles", "o-"),
            (OURS, "spheres", "s--"),
            (EMBREE, "triangles", "o-"),
            (ROBUST, "triangles", "o-"),
            (EMBREE, "spheres", "s--"),
            (f"{EMBREE} {PACKETS}", "triangles", "o:"),
            (f"{ROBUST} {PACKETS}", "triangles", "o:"),
            (f"{EMBREE} {PACKETS}", "spheres", "s:"),
        ):
            points = sorted(
                (float(key[0]), row["median"])
                for key, row in speeds.items()
                if key[1:] == (shape, kind, program)
            )
            if points:
                own = program.removesuffix(f" {PACKETS}")
                label = f"{LABELS[own]}{program.replace(own, '')}, {shape}"
                axis.semilogx(*zip(*points, strict=True), line, color=COLORS[own], label=label)
        axis.set(title=kind, xlabel="primitives", ylim=(0, None))
        axis.set_ylabel("M rays/s, one thread")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


# row -> what the axis says, and the factor and the power of the number that bring it there
SCALE = {
    "checks and tree, processor": ("tree, ns of one core a sphere", 1e9, -1),
    "peak memory beyond the input": ("memory beyond the input, GB", 1e-9, 1),
    "whole paths": ("whole paths, M rays/s and core", 1.0, 0),
}


def scale(rows: Rows) -> Figure | None:
    """Of diffuse spheres; says what lies beyond."""
    quantities: dict[str, list[tuple[float, float]]] = {}
    for name in SCALE:
        clouds = found(rows, f"(.+) spheres: {name}").items()
        quantities[name] = sorted((float(count), row["median"]) for (count,), row in clouds)
    if min(len(points) for points in quantities.values()) < 2:
        return None
    figure, axes = grid(len(SCALE), 3, 2.8)
    for axis, (name, (label, factor, power)) in zip(axes, SCALE.items(), strict=True):
        count, value = np.array(quantities[name]).T
        value = value * factor * count**power
        far, there = beyond(count, value, linear=power == 1)
        axis.semilogx(count, value, "o-", color=COLORS[OURS], label="measured")
        if there > 0.0:
            print(f"{label}: {there:.3g} at {far:.0e}")
            line, words = ([count[-1], far], [value[-1], there]), "by the slope"
            axis.plot(*line, "o:", color=COLORS[OURS], mfc="white", markevery=[1], label=words)
        else:  # of so few spheres that what each picture takes is most of it
            print(f"{label}: what was measured tells nothing of {far:.0e}")
        axis.set(xlabel="spheres", ylabel=label)
        if power == 1:
            axis.set_yscale("log")
        else:
            axis.set_ylim(0, None)
    axes[0].legend()
    return figure


def beyond(count: np.ndarray, value: np.ndarray, *, linear: bool) -> tuple[float, float]:
    """Ten times the largest number, and what the line through the last two says of it."""
    far = 10 * count[-1]
    x = count if linear else np.log10(count)
    slope = (value[-1] - value[-2]) / (x[-1] - x[-2])
    return far, float(value[-1] + slope * ((far if linear else np.log10(far)) - x[-1]))


def threads(rows: Rows) -> Figure | None:
    """By the clock, one line a scene, beside the line of as many times the speed as threads."""
    times = found(rows, r"threads, (.+), clock: (\d+) threads?")
    scenes = [name for name in GALLERY if (name, "1") in times]
    if not scenes:
        return None
    figure, (axis,) = grid(1, 1, 3.4)
    figure.set_figwidth(5.5)
    most = max(int(count) for _, count in times)
    axis.plot([1, most], [1, most], color="0.6", linewidth=1, label="as many times as threads")
    for number, scene in enumerate(scenes):
        one = times[scene, "1"]["runs"]
        points = sorted(
            (int(count), float(np.median(np.divide(one, row["runs"]))))
            for (name, count), row in times.items()
            if name == scene
        )
        # more scenes than colours
        axis.plot(*zip(*points, strict=True), "o-" if number < 10 else "s--", label=scene)
    axis.set(xlabel="threads", ylabel="times the speed of one thread", ylim=(0, None))
    axis.set_xticks(sorted({int(count) for _, count in times}))
    figure.legend(loc="outside right upper")
    return figure


CHARTS: dict[str, Callable[[Rows], Any]] = {
    "error": error,
    "rays": rays,
    "scale": scale,
    "threads": threads,
}


def _ticks(axis: Any) -> None:
    """Few ticks of logarithms: at powers of ten, and at some between where there are few."""
    from matplotlib.ticker import LogLocator, NullLocator

    for one in (axis.xaxis, axis.yaxis):
        if one.get_scale() == "log":
            low, high = one.get_view_interval()
            subs = (
                (1.0, 2.0, 5.0) if high < 10 * low else (1.0, 3.0) if high < 100 * low else (1.0,)
            )
            one.set_major_locator(LogLocator(subs=subs, numticks=8))
            one.set_minor_locator(NullLocator())
            if len(subs) > 1:
                one.set_major_formatter("{x:g}")


def main(arguments: Sequence[str] | None = None) -> int:
    p = argparse.ArgumentParser(prog="python -m bench.charts", description="Draw measurements.")
    p.add_argument("results", type=Path, nargs="+", metavar="RESULT.json")
    p.add_argument("-o", "--output", type=Path, default=Path(), metavar="FOLDER")
    args = p.parse_args(arguments)
    try:
        rows = [row for path in args.results for row in read(path)["rows"]]
        prepare_folder(args.output)
        written = draw_all(rows, args.output)
    except (BenchFileError, ResourceError) as problem:
        print(f"charts: {problem}", file=sys.stderr)
        return 2
    return 0 if written else 2


def draw_all(rows: Rows, folder: Path) -> list[Path]:
    """Writes each chart for which there are rows. Raises ResourceError."""
    import matplotlib

    written = []
    for name, draw in CHARTS.items():
        with matplotlib.rc_context(STYLE):
            figure = draw(rows)
            if figure is None:
                continue
            for axis in figure.axes:
                _ticks(axis)
            path = folder / f"{name}.svg"
            with replacing(path) as part:
                figure.savefig(part, format="svg", metadata={"Date": None})
        print(f"{path} written", file=sys.stderr)
        written.append(path)
    if not written:
        print(f"nothing measured that charts show: {', '.join(CHARTS)}", file=sys.stderr)
    return written


if __name__ == "__main__":
    sys.exit(main())
