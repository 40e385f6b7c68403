"""Runs a study's plan: what is timed, in which order, and the check that no picture differs."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from .. import machine

if TYPE_CHECKING:
    from ..scene import Scene
    from .plan import Plan


@dataclass(frozen=True)
class Run:
    """One timed rendering.

    order: place in the study, from 0. seconds: of rendering alone, without the tree's build.
    cpu_seconds: processor time of all threads together. sha256: of the linear float32 pixels.
    """

    order: int
    repeat: int
    width: int
    height: int
    threads: int
    schedule: str
    oversubscribed: bool
    seconds: float
    cpu_seconds: float
    samples: int
    rays: int
    sha256: str


@dataclass(frozen=True)
class Picture:
    """One of the pair of pictures: few samples against many."""

    spp: int
    width: int
    height: int
    seconds: float
    png: bytes


@dataclass
class Study:
    """Everything measured so far.

    pair: low and high samples per pixel, or None when stopped before; pair_rms: root mean square
    difference of the two, over the mean of the high one. complete: False when stopped by Ctrl-C.
    """

    plan: Plan
    scene_name: str
    machine: dict[str, Any]
    runs: list[Run] = field(default_factory=list)
    pair: tuple[Picture, Picture] | None = None
    pair_rms: float | None = None
    complete: bool = False

    def hashes(self, width: int) -> dict[str, list[Run]]:
        """The runs of one width by their picture's hash; more than one hash is an error."""
        found: dict[str, list[Run]] = {}
        for run in self.runs:
            if run.width == width:
                found.setdefault(run.sha256, []).append(run)
        return found

    @property
    def mismatches(self) -> list[int]:
        """Widths whose pictures are not all the same."""
        return [width for width in self.plan.widths if len(self.hashes(width)) > 1]


def order(plan: Plan) -> Iterator[tuple[int, int, int, str]]:
    """(repeat, width, threads, schedule) of each run, in the order measured.

    All combinations once, then all again: a machine that grows slower while the study runs, hot
    or shared with others, so slows every thread count alike and not only the last one.
    """
    for repeat in range(plan.repeat):
        for width in plan.widths:
            for threads in plan.threads:
                for schedule in plan.schedules:
                    yield repeat, width, threads, schedule


def work(plan: Plan, width: int, threads: int) -> float:
    """The expected share of the time of one run, in any unit; for the progress bar."""
    return width * plan.height(width) * plan.spp / min(threads, plan.cores)


def measure(
    plan: Plan, scene: Scene, progress: Callable[[str, float], None] | None = None
) -> Study:
    """Measures a plan on a scene and returns what came out.

    progress: called before each run with its description and the share of the work done, 0 to 1.
    Ctrl-C ends the study early: what was measured is returned, with complete False.
    """
    import numpy as np

    import parhelion as ph

    study = Study(plan, scene.name, machine.describe())
    study.machine["load_average_before"] = machine.load_average()
    todo = list(order(plan))
    low, high = plan.low_high
    pair_work = work(plan, plan.pair_width, plan.cores) * (low + high) / plan.spp
    total = pair_work + sum(work(plan, width, threads) for _, width, threads, _ in todo)
    done = 0.0

    def tell(text: str) -> None:
        if progress is not None:
            progress(text, done / total)

    def render(width: int, threads: int, schedule: str, spp: int, tree: str) -> Any:
        image = ph.render(
            prepared,
            width=width,
            height=plan.height(width),
            spp=spp,
            max_depth=plan.max_depth,
            seed=plan.seed,
            sampler=plan.sampler,
            filter="box",  # as the classic program: uniform offsets in the pixel
            roulette=False,  # likewise: a path ends by itself or at max_depth
            reuse_paths=False,  # likewise: no pixel knows of another
            threads=threads,
            tree=tree,
            schedule=schedule,
            tile=plan.tile,
        )
        if not image.stats.complete:
            raise KeyboardInterrupt
        return image

    try:
        tell("preparing the scene")
        prepared = ph.prepare(scene)
        # Not timed: the first rendering starts threads and touches memory for the first time.
        tell("warm-up")
        render(plan.widths[0], max(plan.threads), plan.schedules[0], plan.spp, plan.tree)
        for number, (repeat, width, threads, schedule) in enumerate(todo):
            tell(f"{width} px, {threads} threads, {schedule}, repeat {repeat + 1}")
            cpu = time.process_time()
            image = render(width, threads, schedule, plan.spp, plan.tree)
            cpu = time.process_time() - cpu
            pixels = np.ascontiguousarray(image.pixels, dtype="<f4")
            study.machine["instruction_set"] = image.stats.isa
            study.runs.append(
                Run(
                    order=number,
                    repeat=repeat,
                    width=width,
                    height=plan.height(width),
                    threads=threads,
                    schedule=schedule,
                    oversubscribed=plan.oversubscribed(threads),
                    seconds=image.stats.seconds,
                    cpu_seconds=cpu,
                    samples=image.stats.samples,
                    rays=image.stats.rays,
                    sha256=hashlib.sha256(pixels.tobytes()).hexdigest(),
                )
            )
            done += work(plan, width, threads)

        # These two are looked at, not timed against each other, so they may use the tree.
        images = []
        for spp in plan.low_high:
            tell(f"picture with {spp} samples per pixel")
            images.append(render(plan.pair_width, plan.cores, plan.schedules[0], spp, "bvh"))
        few, many = (np.asarray(image.pixels, dtype=np.float64) for image in images)
        if (mean := float(many.mean())) > 0:
            study.pair_rms = float(np.sqrt(np.mean((few - many) ** 2))) / mean
        study.pair = (_picture(plan, low, images[0]), _picture(plan, high, images[1]))
        study.complete = True
    except KeyboardInterrupt:
        pass
    study.machine["load_average_after"] = machine.load_average()
    return study


def _picture(plan: Plan, spp: int, image: Any) -> Picture:
    width = plan.pair_width
    return Picture(spp, width, plan.height(width), image.stats.seconds, image.png_bytes())
