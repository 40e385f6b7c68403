"""The group `sharing`: what it gains and costs that pixels use each other's paths (`reuse_paths`).

Each scene of the gallery, in turns: each pixel by itself, all of them shared, and as it is by
default, where a look at a few squares of the picture decides and takes its time. Errors are as in
the group `equal`, against one picture of `--reference-spp`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from itertools import chain
from statistics import fmean
from typing import Any

from .equal import reference
from .process import Worker
from .scenes import by_scene
from .summary import Row, ratios

# name -> Settings.reuse_paths; the first is what the others are compared with
WAYS: dict[str, bool | str] = {"alone": False, "shared": True, "by default": "auto"}


def sharing(plan: Any, notes: Any) -> Iterator[Row]:
    """Processor seconds, errors, and errors times seconds, by scene and way."""
    return chain.from_iterable(by_scene(plan, notes, "sharing", _scene))


def _scene(plan: Any, notes: Any, name: str) -> list[Row]:
    import numpy as np

    from parhelion.comparison import relative_mse

    from .gallery import load, picture_job
    from .measure import OURS, alternate

    pixels = plan.width * plan.height
    scene = load(name, pixels)
    job = picture_job(name, scene, pixels, plan.threads)
    folder = plan.cache / "equal"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "sharing.npy"
    with ExitStack() as stack:
        worker = Worker(OURS, job)
        stack.callback(worker.close)
        notes.versions[OURS] = worker.known
        stack.callback(path.unlink, missing_ok=True)
        truth = reference(plan, worker, OURS, job, scene, folder)
        seeds = dict.fromkeys(WAYS, 0)

        def measured(way: str) -> dict[str, Any]:
            seeds[way] += 1  # of the same seeds by each
            answer = worker.render(plan.spp, seeds[way], path, reuse_paths=WAYS[way])
            return answer | {"errors": relative_mse(np.load(path), truth)}

        answers = alternate([(way, partial(measured, way)) for way in WAYS], plan.rounds)
    seconds = {way: [a["cpu_seconds"] for a in answered] for way, answered in answers.items()}
    rows = _rows(f"sharing, {name}, processor", "s", seconds)
    for k, words in enumerate(("error", "trimmed error")):
        errors = {way: [a["errors"][k] for a in answered] for way, answered in answers.items()}
        rows += _rows(f"sharing, {name}, {words}", "", errors)
        # of all rounds, as a few pixels may decide one's: so their spread is that of the times
        product = {way: [fmean(errors[way]) * s for s in seconds[way]] for way in WAYS}
        rows += _rows(f"sharing, {name}, mean {words} x time", "s", product)
    return rows


def _rows(group: str, unit: str, values: dict[str, list[float]]) -> list[Row]:
    """One of each way, all but the first over the first."""
    first = next(iter(values))
    return [
        Row(group, way, unit, runs)
        if way == first
        else Row(group, way, unit, runs, against=first, ratios=ratios(runs, values[first]))
        for way, runs in values.items()
    ]
