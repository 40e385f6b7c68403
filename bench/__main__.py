"""The command: measures, prints a table and writes JSON. See bench/README.md."""

from __future__ import annotations

import argparse
import json
import sys
import traceback
from collections.abc import Iterable
from dataclasses import asdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from parhelion.atomic import replacing
from parhelion.errors import ResourceError
from parhelion.image import check_place
from parhelion.machine import describe, load_average
from parhelion.study.output import prepare_folder

from .charts import draw_all
from .measure import ASKED, GROUPS, PEERS, Notes, Plan
from .scenes import GALLERY, WEEKEND, BenchError, read_weekend
from .summary import Row, table

# A load average from which on a note says that the machine was not free.
BUSY = 0.3
SPHERES_NEEDED = {"weekend", "settings", "error"}


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(
        prog="python -m bench",
        description="Measure Parhelion. What each group measures, and what options mean to it, is"
        " in bench/README.md. Ctrl-C keeps what was measured until then.",
    )
    d = Plan(WEEKEND)
    p.add_argument(
        "--spheres", type=Path, default=WEEKEND, metavar="FILE", help="the weekend scene"
    )
    timed = tuple(name for name in GROUPS if name not in ASKED)
    p.add_argument(
        "--only",
        type=_names(GROUPS),
        default=timed,
        metavar="GROUP,...",
        help=f"of {', '.join(timed)}, which is the default; and {', '.join(ASKED)}, which are"
        " measured only where they are named here",
    )
    p.add_argument(
        "--peers",
        type=_names(PEERS),
        default=tuple(PEERS),
        metavar="NAME,...|none",
        help=f"of {', '.join(PEERS)}; default: all, of which those count that are installed",
    )
    p.add_argument(
        "--scenes",
        type=_names(GALLERY),
        default=GALLERY,
        metavar="NAME,...",
        help="of the groups equal, sharing, threads and overhead; default: all, which are"
        f" {', '.join(GALLERY)}",
    )
    for name, words in {
        "rounds": "how often each is measured",
        "width": "of pictures, in pixels; overhead takes a quarter of the pixels",
        "height": "the same",
        "spp": "samples a pixel",
        "depth": "rays of a path, at most",
        "threads": "of everybody; overhead and rays take one",
        "reference-spp": "samples a pixel of what errors are against",
    }.items():
        default = getattr(d, name.replace("-", "_"))
        p.add_argument(
            f"--{name}", type=_count, default=default, help=f"{words}; default {default}"
        )
    p.add_argument(
        "--long",
        action="store_true",
        help="clouds of 1e7 and 1e8 spheres, rays and trees of 1e7, too",
    )
    p.add_argument(
        "--clouds",
        type=_counts,
        default=d.clouds,
        metavar="COUNT,...",
        help="of how many spheres the group clouds is, such as 3e6,1e9, whatever --long says",
    )
    p.add_argument(
        "--cache",
        type=Path,
        default=d.cache,
        help="folder of converged references, and of what the group references writes",
    )
    p.add_argument(
        "-o", "--output", type=Path, metavar="FILE.json", help="default: bench-TIME.json"
    )
    p.add_argument(
        "--charts", type=Path, metavar="FOLDER", help="draw what was measured there, as SVG"
    )
    return p


def main() -> int:
    args = vars(parser().parse_args())
    only, output, folder = (args.pop(name) for name in ("only", "output", "charts"))
    plan, notes = Plan(**args), Notes()
    rows: list[Row] = []
    date = datetime.now(timezone.utc).isoformat(timespec="seconds")
    path = output or Path(f"bench-{date[:19].replace(':', '')}.json")
    load = load_average()
    if load is not None and load > BUSY:
        notes.add(f"the machine was busy at the start: load average {load:.1f}")
    try:
        check_place(path)
        for one in (plan.cache, folder):
            if one is not None:
                prepare_folder(one)
        if set(only) & SPHERES_NEEDED:
            read_weekend(plan.spheres)
    except (BenchError, ResourceError) as problem:
        print(f"bench: {problem}", file=sys.stderr)
        return 2
    status = measure_groups(only, plan, notes, rows)
    result = report(plan, notes, rows, date)
    print(text(result, rows))
    try:
        with replacing(path) as part:
            part.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        print(f"{path} written", file=sys.stderr)
        if folder is not None:
            draw_all(result["rows"], folder)
    except ResourceError as problem:
        print(f"bench: {problem}", file=sys.stderr)
        return 2
    return status


def measure_groups(only: Iterable[str], plan: Plan, notes: Notes, rows: list[Row]) -> int:
    """Adds the rows of the groups `only`, as they are found: what was measured is not lost by what
    is not, nor by Ctrl-C. Returns the exit code: 0; 1 if a group failed or found nothing; 130.
    """
    status = 0
    for name in only:
        print(f"measuring: {name}", file=sys.stderr)
        before = len(rows)
        try:
            for row in GROUPS[name](plan, notes):
                rows.append(row)
        except Exception as problem:
            if not isinstance(problem, BenchError):  # a mistake of ours
                traceback.print_exc()
            said = str(problem) or type(problem).__name__
            notes.add(f"{name} was not measured{' to the end' * (len(rows) > before)}: {said}")
            status = 1
        except KeyboardInterrupt:
            notes.add(f"stopped by Ctrl-C while {name} was measured")
            return 130
        else:
            if len(rows) == before:
                notes.add(f"{name}: nothing was measured")
                status = 1
    return status


def report(plan: Plan, notes: Notes, rows: list[Row], date: str) -> dict[str, Any]:
    """What is written as JSON."""
    shown = {k: v for k, v in asdict(plan).items() if k not in ("spheres", "cache")}
    return {
        "date": date,
        "machine": describe(),
        "versions": notes.versions,
        "plan": shown,
        "notes": notes.lines,
        "rows": [row.json() for row in rows],
    }


def text(result: dict[str, Any], rows: list[Row]) -> str:
    """Markdown, as docs/performance.md takes it."""
    m, p = result["machine"], result["plan"]
    versions = []
    for name, known in result["versions"].items():
        more = [f"{k} {known[k]}" for k in ("isa", "llvm", "drjit") if k in known]
        versions.append(f"{name} {known['version']}" + (f" ({', '.join(more)})" if more else ""))
    lines = [
        f"{result['date']}; {m['cpu']}, {m['cores_available']} cores; Python {m['python']};"
        f" {', '.join(versions)}.",
        f"Where a group has no settings of its own: {p['width']}x{p['height']}, {p['spp']} spp,"
        f" depth {p['depth']}, {p['threads']} threads, {p['rounds']} rounds.",
        "",
        table(rows),
        "",
        *(f"- {line}" for line in result["notes"]),
    ]
    return "\n".join(lines)


def _count(value: str) -> int:
    if not value.isdecimal() or int(value) < 1:
        raise argparse.ArgumentTypeError(f"{value!r}: a whole number from 1 is needed")
    return int(value)


def _counts(value: str) -> tuple[int, ...]:
    try:
        counts = tuple(float(part) for part in value.split(","))
    except ValueError:
        counts = ()
    if not counts or not all(c >= 1 and c.is_integer() for c in counts):
        raise argparse.ArgumentTypeError(f"{value!r}: whole numbers from 1 are needed, as 3e6,1e9")
    return tuple(dict.fromkeys(map(int, counts)))


def _names(known: Iterable[str]) -> Any:
    def read(value: str) -> tuple[str, ...]:
        names = () if value == "none" else tuple(value.split(","))
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name!r}: choose from {', '.join(known)}")
        return names

    return read


if __name__ == "__main__":
    sys.exit(main())
