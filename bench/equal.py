"""The group `equal`: seconds to the same error, by renderer, on each scene of the gallery.

Error is relative, `parhelion.comparison.relative_mse` against the renderer's own converged picture.
Nothing is clipped. As a few fireflies may be most of it, the trimmed error, without the worst
pixels, is measured too.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from math import exp, log
from pathlib import Path
from statistics import fmean, median
from typing import Any

from .process import Worker, in_turn
from .scenes import BenchError, by_scene
from .summary import Row, markdown, ratios

# The error to reach is that of ours at this many samples a pixel, each pixel by itself.
SPP = 32

# Seeds of references, far from those of the pictures that are compared with them.
REFERENCE_SEED = 1_000_000


@dataclass(frozen=True)
class Run:
    """One picture: samples a pixel, errors, and times in seconds."""

    spp: int
    error: float
    trimmed: float
    seconds: float
    cpu: float


def equal(plan: Any, notes: Any) -> Iterator[Row]:
    """Seconds and processor seconds to our error at SPP samples, ours and the peers', by scene."""
    folder = plan.cache / "equal"
    folder.mkdir(parents=True, exist_ok=True)
    lines: list[list[str]] = []
    for rows in by_scene(plan, notes, "equal", partial(_scene, folder, lines)):
        (folder / "equal.md").write_text(report(lines) + "\n", encoding="utf-8")
        yield from rows


def report(found: list[list[str]]) -> str:
    """A Markdown table, one line a scene and renderer. ~ marks what lies outside of the counts."""
    times = ["error", "s (processor)", "ratio", "slope"]
    head = ["scene", "renderer", *times, *(f"trimmed {word}" for word in times)]
    return markdown([[*head, "spp", "us a sample", "prepare, s", "mean (R G B)"], *found])


def seconds_at(error: float, few: tuple[float, float], many: tuple[float, float]) -> float:
    """Between two pictures' (error, seconds), on a straight line of their logarithms.

    Outside of the two, error times seconds is taken to be that of the nearer one.
    """
    if error > few[0] or many[0] >= few[0]:
        return few[1] * few[0] / error
    if error < many[0]:
        return many[1] * many[0] / error
    share = log(few[0] / error) / log(few[0] / many[0])
    return exp(log(few[1]) + share * log(many[1] / few[1]))


def _scene(folder: Path, lines: list[list[str]], plan: Any, notes: Any, name: str) -> list[Row]:
    """Adds lines of the report, too."""
    import numpy as np
    from tests.reference_tools import save_side_by_side

    from parhelion.comparison import relative_mse

    from .gallery import load, picture_job
    from .measure import ALONE, OURS, PEERS

    pixels = plan.width * plan.height
    scene = load(name, pixels)
    job = picture_job(name, scene, pixels, plan.threads)
    path = folder / "part.npy"
    with ExitStack() as stack:
        workers: dict[str, Worker] = {}
        references: dict[str, Any] = {}
        ways = {OURS: (OURS, {}), ALONE: (OURS, {"reuse_paths": False}), **PEERS}
        for peer in (OURS, ALONE, *plan.peers):
            module, more = ways[peer]
            try:
                worker = Worker(module, job | more)
                stack.callback(worker.close)
                worker.render(1)
                references[peer] = reference(plan, worker, module, job, scene, folder)
            except BenchError as problem:
                if peer not in PEERS:
                    raise
                notes.add(f"equal, {name}: {peer} was not measured: {problem}")
                continue
            workers[peer] = worker
            notes.versions.setdefault(peer, worker.known)

        def measured(peer: str, spp: int, seed: int) -> Run:
            # a renderer may take further seeds for parts of a picture
            answer = workers[peer].render(spp, 1000 * seed, path)
            errors = relative_mse(np.load(path), references[peer])
            return Run(spp, *errors, answer["seconds"], answer["cpu_seconds"])

        first = [measured(ALONE, SPP, seed) for seed in (101, 102, 103)]
        targets = {e: fmean(getattr(run, e) for run in first) for e in ("error", "trimmed")}
        counts = {}
        for peer in workers:
            # error times samples is about constant: from half to twice of what it should take
            needed = SPP * measured(peer, SPP, 104).trimmed / targets["trimmed"]
            many = min(max(4, round(2 * needed)), plan.reference_spp // 8)
            counts[peer] = [many // 4, many]
        runs: dict[str, list[list[Run]]] = {peer: [[], []] for peer in workers}
        for turn in range(plan.rounds + 1):
            for peer, pair in in_turn(counts.items(), turn):
                for k, spp in enumerate(pair):
                    run = measured(peer, spp, turn)
                    if turn:  # the first is not counted: it may compile
                        runs[peer][k].append(run)
    path.unlink()

    rows = []
    for peer, (few, many) in runs.items():
        ours = runs[OURS]
        times = {
            (error, clock): _seconds(few, many, targets[error], error, clock)
            for error in targets
            for clock in ("seconds", "cpu")
        }
        pairs: dict[tuple[str, str], list[float]] = {}
        for (error, clock), values in times.items():
            base = _seconds(*ours, targets[error], error, clock)
            pairs[error, clock] = ratios(values, base) if peer != OURS else []
            words = f"equal {error}, {name}, {'clock' if clock == 'seconds' else 'processor'}"
            asked = 2.0 if peer in PEERS else None
            rows.append(
                Row(
                    *(words, peer, "s", values, False, OURS, pairs[error, clock]),
                    least_ratio=asked,
                    error=targets[error],
                )
            )
        for part in (few, many):
            at = f"{name}, at {part[0].spp} spp"
            rows += [
                Row(f"relative error, {at}", peer, "", [r.error for r in part]),
                Row(f"trimmed error, {at}", peer, "", [r.trimmed for r in part]),
                Row(f"clock, {at}", peer, "s", [r.seconds for r in part]),
                Row(f"processor, {at}", peer, "s", [r.cpu for r in part]),
            ]
        lines.append([name if peer == OURS else "", peer])
        for error, target in targets.items():
            first, last = (fmean(getattr(r, error) for r in part) for part in (few, many))
            outside = "" if last <= target <= first else "~"
            seconds, cpu = (times[error, clock] for clock in ("seconds", "cpu"))
            slope = log(last / first) / log(many[0].spp / few[0].spp)
            lines[-1] += [f"{target:.1e}", f"{outside}{median(seconds):.3g} ({median(cpu):.3g})"]
            if peer == OURS:
                lines[-1].append("")
            else:
                ratio = [median(pairs[error, clock]) for clock in ("seconds", "cpu")]
                lines[-1].append("{}{:.2f} ({:.2f})".format(outside, *ratio))
            lines[-1].append(f"{slope:.2f}")
        mean = references[peer].mean(axis=(0, 1)) / references[OURS].mean(axis=(0, 1))
        sample = 1e6 * median(r.cpu for r in many) / (many[0].spp * job["width"] * job["height"])
        lines[-1] += [
            f"{few[0].spp}, {many[0].spp}",
            f"{sample:.2f}",
            f"{workers[peer].known['prepare_seconds']:.2f}",
            " ".join(f"{ratio:.3f}" for ratio in mean),
        ]
        if peer in PEERS:
            save_side_by_side(references[OURS], references[peer], folder / f"{name}, {peer}.png")
    return rows


def _seconds(few: list[Run], many: list[Run], target: float, error: str, clock: str) -> list[float]:
    """Of each round, to the target, with the mean errors of all rounds."""
    errors = [fmean(getattr(run, error) for run in part) for part in (few, many)]
    return [
        seconds_at(target, (errors[0], getattr(a, clock)), (errors[1], getattr(b, clock)))
        for a, b in zip(few, many, strict=True)
    ]


def reference(
    plan: Any, worker: Worker, module: str, job: dict[str, Any], scene: Any, folder: Path
) -> Any:
    """The converged picture of a job's scene, from the cache if it has been made with the same code
    and scene.

    One for all variants of a renderer.
    """
    import numpy as np

    from parhelion.flatten import flatten

    seen = f"{flatten(scene).sha256()} {scene.camera} {job}"
    known = {k: worker.known.get(k) for k in ("version", "build")}
    key = hashlib.sha256(repr((known, seen, plan.reference_spp)).encode())
    for source in sorted((Path(__file__).parent / "renderers").glob(f"{module}*.py")):
        key.update(source.read_bytes())
    path = folder / f"{module}-{key.hexdigest()[:16]}.npy"
    if not path.exists():
        print(f"making the reference of {module}, {plan.reference_spp} spp", file=sys.stderr)
        part = path.with_name("reference.npy")
        worker.render(plan.reference_spp, REFERENCE_SEED, part)
        part.replace(path)
    return np.load(path)
