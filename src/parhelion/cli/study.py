"""`parhelion study`: the thread-scaling study."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from . import options

if TYPE_CHECKING:
    from ..study.plan import Plan
    from ..study.summary import Summary

_DESCRIPTION = """\
Times a scene over numbers of threads and picture widths, and writes study.csv, study.json,
chart.png and report.html: seconds, speed-up, efficiency and the serial fraction of Amdahl's law,
beside the published figures of the study this program grew out of. Every picture must come out
the same to the last bit; if one does not, that is an error and the exit code is 1.
"""

_EPILOG = """\
The classic set-up: brute force, independent random numbers, static schedule.
  parhelion study --threads classic --tree none --sampler independent --schedule static
A first look in seconds:
  parhelion study --widths 120,240 --low-high-spp 4,64
"""


def add(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command to the parser of `parhelion`."""
    parser = subparsers.add_parser(
        "study",
        help="time a scene over thread counts and widths, with charts and a report",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    option = parser.add_argument
    option(
        "-t",
        "--threads",
        metavar="LIST",
        help="thread counts, such as 1,2,4; 'classic' is 1,2,4,6,8,12,16,32; 1 is always "
        "measured (default: 1,2,4,... and the number of cores)",
    )
    option(
        "--widths",
        metavar="LIST",
        default="120,240,480,960",
        help="picture widths in pixels (default: %(default)s)",
    )
    option("--aspect", default="16:9", help="16:9 or 4:3, width to height (default: %(default)s)")
    option("--spp", "--samples", type=int, default=20, help="samples per pixel (default: 20)")
    option("--max-depth", type=int, default=50, help="rays in the longest path (default: 50)")
    option("--scene", metavar="PATH", help="any scene file (default: the built-in weekend scene)")
    option(
        "--repeat", type=int, default=3, metavar="N", help="timed runs of each case (default: 3)"
    )
    option("--tree", default="bvh", help="bvh, or none for brute force (default: bvh)")
    option("--sampler", default="sobol", help="sobol or independent (default: sobol)")
    option(
        "--schedule",
        metavar="LIST",
        default="dynamic",
        help="OpenMP schedules: static, dynamic, guided; several are compared (default: dynamic)",
    )
    option("--tile", type=int, default=16, help="side in pixels of a unit of work (default: 16)")
    option(
        "--low-high-spp",
        metavar="LOW,HIGH",
        default="4,200",
        help="samples per pixel of the pair of pictures (default: %(default)s)",
    )
    option("--seed", type=int, default=0, help="of all random numbers (default: 0)")
    option(
        "-o",
        "--output",
        metavar="DIR",
        default="parhelion-study",
        help="folder for the four files (default: %(default)s)",
    )
    options.add_logging(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measures and writes; 0, or 1 when pictures differ, or 130 after Ctrl-C."""
    from pathlib import Path

    import parhelion as ph

    from ..study import output
    from ..study.measure import measure
    from ..study.summary import summarize

    plan = _plan(args)
    scene = ph.weekend() if plan.scene is None else ph.load(plan.scene)
    folder = Path(args.output)
    output.prepare_folder(folder)

    with _bar(shown=not args.quiet and sys.stderr.isatty()) as progress:
        study = measure(plan, scene, progress)
    if not study.runs:
        print(
            "parhelion study: stopped before the first run ended; nothing written", file=sys.stderr
        )
        return 130
    summary = summarize(study)
    paths = output.write(folder, study, summary)
    written = paths[0].parent

    if not args.quiet:
        print(_text(plan, summary))
        from ..study import words

        print(f"\n{words.headline(study, summary)}")
        for note in words.notes(study, summary):
            print(f"- {note}")
        print("\nwrote " + ", ".join(map(str, paths)))
    if study.mismatches:
        widths = ", ".join(map(str, study.mismatches))
        print(
            f"parhelion study: error: the pictures of width {widths} differ between runs; "
            f"see {written / 'report.html'}",
            file=sys.stderr,
        )
    if not study.complete:
        kept = (
            ""
            if written == folder
            else f"; {folder} keeps its complete study, this is in {written}"
        )
        print(f"parhelion study: stopped after {len(study.runs)} runs{kept}", file=sys.stderr)
        return 130
    return 1 if study.mismatches else 0


def _plan(args: argparse.Namespace) -> Plan:
    from .. import machine
    from ..study.plan import Plan, schedule_list, spp_pair, thread_list, width_list

    cores = machine.cores_available()
    return Plan(
        threads=thread_list(args.threads, cores),
        cores=cores,
        widths=width_list(args.widths),
        aspect=args.aspect,
        spp=args.spp,
        max_depth=args.max_depth,
        repeat=args.repeat,
        tree=args.tree,
        sampler=args.sampler,
        schedules=schedule_list(args.schedule),
        tile=args.tile,
        low_high=spp_pair(args.low_high_spp),
        seed=args.seed,
        scene=args.scene,
    )


@contextlib.contextmanager
def _bar(shown: bool) -> Iterator[Callable[[str, float], None] | None]:
    """A progress bar on the terminal. It redraws between runs and sleeps while one is timed."""
    if not shown:
        yield None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, auto_refresh=False, transient=True) as bar:
        task = bar.add_task("", total=1.0)

        def tell(text: str, share: float) -> None:
            bar.update(task, description=text, completed=share, refresh=True)

        yield tell


def _text(plan: Plan, summary: Summary) -> str:
    """The table for the terminal."""
    lines = [
        f"{'width':>6} {'threads':>8} {'schedule':>9} {'median s':>10} {'least':>10} "
        f"{'greatest':>10} {'Msamples/s':>11} {'speed-up':>9} {'efficiency':>11}"
    ]
    for p in summary.points:
        speedup = "" if p.speedup is None else f"{p.speedup:.2f}"
        efficiency = "" if p.efficiency is None else f"{100 * p.efficiency:.0f} %"
        mark = "*" if p.oversubscribed else ""
        lines.append(
            f"{p.width:>6} {f'{p.threads}{mark}':>8} {p.schedule:>9} {p.median:>10.4f} "
            f"{p.least:>10.4f} {p.greatest:>10.4f} {p.samples_per_second / 1e6:>11.3f} "
            f"{speedup:>9} {efficiency:>11}"
        )
    if any(p.oversubscribed for p in summary.points):
        lines.append(f"* oversubscribed: more threads than the {plan.cores} available cores")
    return "\n".join(lines)
