"""The group `overhead`: the time of whole pictures over what of it is traversal, one thread's.

Traversal is whatever walks a tree, tests of boxes and of primitives, of the picture's own rays as
they are traced for it. The kernels tell what it takes, by a clock that they look at for one of some
sixty walks (`timed` in core/paths.h). The rest is everything else that is between a scene and its
picture: finding what is met, materials, textures, lights, numbers, the film.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

from .process import Worker
from .scenes import BenchError, by_scene
from .summary import Row, ratios

MOST = 1.6


def overhead(plan: Any, notes: Any) -> Iterator[Row]:
    """Seconds of each scene's picture, and of traversal."""
    return chain.from_iterable(by_scene(plan, notes, "overhead", _scene))


def _scene(plan: Any, notes: Any, name: str) -> list[Row]:
    from .gallery import load, picture_job

    pixels = plan.width * plan.height // 4  # one thread has to do them all
    worker = Worker("parhelion", picture_job(name, load(name, pixels), pixels, 1))
    try:
        worker.render(1)
        answers = [worker.render(plan.spp, seed) for seed in range(plan.rounds)]
    finally:
        worker.close()
    notes.versions["parhelion"] = worker.known
    whole = [a["seconds"] for a in answers]
    walks = [a["traversal_seconds"] for a in answers]
    if min(walks) == 0.0:
        raise BenchError("no walk was timed: the picture is too small, or there is no clock here")
    group = f"overhead, {name}"
    return [
        Row(group, "traversal", "s", walks),
        Row(
            group,
            "whole",
            "s",
            whole,
            against="traversal",
            ratios=ratios(whole, walks),
            most_ratio=MOST,
        ),
    ]
