"""The files of a study: study.csv, study.json, chart.png and report.html."""

from __future__ import annotations

import csv
import io
import json
import math
import tempfile
from contextlib import ExitStack
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..atomic import replacing
from ..errors import ResourceError
from . import original, words

if TYPE_CHECKING:
    from .measure import Study
    from .summary import Summary


def prepare_folder(folder: Path) -> None:
    """Makes the folder, and a file in it to see that that works. Raises ResourceError.

    Called before anything is measured: an hour of timing must not end at a folder that can not
    be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".parhelion-"):
            pass
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise ResourceError(f"{folder}: can not write into this folder: {reason}") from error


def write(folder: Path, study: Study, summary: Summary) -> list[Path]:
    """Writes the four files and returns their paths.

    All are written in full before the first takes its place, so a full disk leaves an old study
    whole. A study that was stopped does not replace a complete one: its files then go into the
    sub-folder `stopped`. Other files of the folder are left alone. Raises ResourceError.
    """
    from . import charts, report

    if not study.complete and _holds_complete(folder):
        folder = folder / "stopped"
        prepare_folder(folder)
    contents = {
        "study.csv": runs_csv(study, summary).encode(),
        "study.json": (json.dumps(document(study, summary), indent=1) + "\n").encode(),
        "chart.png": charts.png(study, summary),
        "report.html": report.html(study, summary).encode(),
    }
    try:
        with ExitStack() as stack:
            for name, content in contents.items():
                stack.enter_context(replacing(folder / name)).write_bytes(content)
    except ResourceError as error:
        # Every open file adds its name on the way out; the innermost is the one that failed.
        first: BaseException = error
        while isinstance(first.__cause__, ResourceError):
            first = first.__cause__
        raise first from first.__cause__
    return [folder / name for name in contents]


def _holds_complete(folder: Path) -> bool:
    """Whether the folder's study.json is that of a complete study."""
    try:
        found = json.loads((folder / "study.json").read_bytes())
    except (OSError, ValueError, RecursionError):  # none, or not ours
        return False
    return isinstance(found, dict) and found.get("complete") is True


def runs_csv(study: Study, summary: Summary) -> str:
    """One line a run, in the order measured.

    speed_up and efficiency are those of this one run against the median of the one-thread runs
    of its width and schedule, empty where there is none.
    """
    from .measure import Run

    plan = study.plan
    out = io.StringIO()
    names = [field.name for field in fields(Run)]
    names += ["spp", "tree", "sampler", "samples_per_second", "speed_up", "efficiency"]
    writer = csv.DictWriter(out, names, lineterminator="\n")
    writer.writeheader()
    for run in study.runs:
        one = summary.point(run.width, run.schedule, 1)
        seconds = max(run.seconds, 1e-9)  # a clock may tick too coarsely for a small picture
        speed_up = None if one is None else one.median / seconds
        writer.writerow(
            {
                **asdict(run),
                "spp": plan.spp,
                "tree": plan.tree,
                "sampler": plan.sampler,
                "samples_per_second": run.samples / seconds,
                "speed_up": speed_up,
                "efficiency": None if speed_up is None else speed_up / run.threads,
            }
        )
    return out.getvalue()


def document(study: Study, summary: Summary) -> dict[str, Any]:
    """Everything the study knows, as plain values for JSON."""
    plan = study.plan
    return {
        "format": "parhelion-study",
        "version": 1,
        "complete": study.complete,
        "command": plan.command(),
        "scene": study.scene_name,
        "settings": {**asdict(plan), "filter": "box", "roulette": False},
        "machine": study.machine,
        "headline": words.headline(study, summary),
        "notes": words.notes(study, summary),
        "pictures": [
            {
                "width": width,
                "height": plan.height(width),
                "tiles": plan.tiles(width),
                "identical": len(study.hashes(width)) == 1,
                "sha256": sorted(study.hashes(width)),
            }
            for width in summary.widths
        ],
        "runs": [asdict(run) for run in study.runs],
        "summary": [asdict(point) for point in summary.points],
        "amdahl": [
            {
                "width": width,
                "schedule": schedule,
                "fit": None
                if fit is None
                else {
                    **asdict(fit),
                    "limit": fit.limit if math.isfinite(fit.limit) else None,
                },
            }
            for (width, schedule), fit in summary.fits.items()
        ],
        "pair": None
        if study.pair is None
        else {
            "spp": [picture.spp for picture in study.pair],
            "width": study.pair[0].width,
            "height": study.pair[0].height,
            "seconds": [picture.seconds for picture in study.pair],
            "relative_rms_difference": study.pair_rms,
        },
        "original": {
            "threads": original.THREADS,
            "widths": original.WIDTHS,
            "seconds": original.SECONDS,
            "amdahl": {str(w): asdict(words.original_fit(w)) for w in original.WIDTHS},
        },
    }
