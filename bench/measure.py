"""What is measured, one function a group. Each adds to the notes and returns its rows, or yields
them as they are found, so that they are there if it is broken off.

Runs that are compared alternate: A B A B, so that a machine that slows down slows both.
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

from .equal import equal
from .lights import lights
from .loading import loading
from .memory import memory
from .noise import noise
from .overhead import overhead
from .process import Worker, in_turn, run, start_seconds
from .rays import rays
from .references import references
from .scenes import GALLERY, BenchError
from .sharing import sharing
from .summary import Row, ratios
from .surfaces import surfaces
from .threads import EFFICIENCY, threads
from .trajectories import trajectories
from .trees import trees

OURS = "parhelion"
# and without what is found to pay in rooms and halls; of the group `equal`
ALONE = f"{OURS}, no reuse_paths"

# name -> (module in renderers/, more for its job)
PEERS: dict[str, tuple[str, dict[str, Any]]] = {
    "mitsuba-llvm": ("mitsuba", {"variant": "llvm_ad_rgb"}),
    "mitsuba-scalar": ("mitsuba", {"variant": "scalar_rgb"}),
    "cycles": ("cycles", {}),
    "luxcore": ("luxcore", {}),
}

# Seeds of references, far from those of the pictures that are compared with them.
REFERENCE_SEED = 100_000


@dataclass(frozen=True)
class Plan:
    """Settings of all measurements. spheres: the weekend file. scenes: of `equal`, `sharing`,
    `threads` and `overhead`. long: clouds of 1e7 and 1e8 too. clouds: other numbers of spheres.
    """

    spheres: Path
    width: int = 480
    height: int = 270
    spp: int = 20
    depth: int = 50
    threads: int = 2
    rounds: int = 7
    peers: tuple[str, ...] = tuple(PEERS)
    reference_spp: int = 4096
    scenes: tuple[str, ...] = GALLERY
    long: bool = False
    clouds: tuple[int, ...] = ()
    cache: Path = Path(tempfile.gettempdir()) / "parhelion-bench"

    def job(self, **more: Any) -> dict[str, Any]:
        """What a worker is told of the scene and the picture."""
        return {
            "spheres": str(self.spheres.resolve()),
            "fuzz": True,
            "width": self.width,
            "height": self.height,
            "depth": self.depth,
            "threads": self.threads,
        } | more


class Notes:
    """versions: of each renderer that ran. lines: what else a reader must know."""

    def __init__(self) -> None:
        self.versions: dict[str, dict[str, Any]] = {}
        self.lines: list[str] = []

    def add(self, line: str) -> None:
        """Once, however often it is said."""
        if line not in self.lines:
            self.lines.append(line)


def weekend(plan: Plan, notes: Notes) -> list[Row]:
    """Seconds of rendering and peak memory of the same scene, ours beside the peers."""
    with _workers(plan, notes) as workers:
        runs: list[tuple[str, Callable[[], dict[str, Any]]]] = [
            (name, partial(worker.render, plan.spp)) for name, worker in workers.items()
        ]
        ours = workers[OURS]
        runs.insert(
            1, (f"{OURS}, independent", partial(ours.render, plan.spp, sampler="independent"))
        )
        answers = alternate(runs, plan.rounds)
        rows = _paired("weekend", "s", answers, "seconds", least=3.0)
        megabytes = {n: [a[-1]["peak_bytes"] / 1e6] for n, a in answers.items() if n in workers}
    rows += [Row("weekend, peak memory", name, "MB", runs) for name, runs in megabytes.items()]
    if len(workers) > 1:
        _check_agreement(plan, notes)
    return rows


def settings(plan: Plan, notes: Notes) -> list[Row]:
    """Ours against itself: threads, instruction sets, samplers, with a tree and without."""
    worker = Worker(OURS, plan.job())
    notes.versions[OURS] = worker.known
    try:

        def compare(group: str, choices: dict[str, dict[str, Any]], **asked: float) -> list[Row]:
            runs = [
                (n, partial(worker.render, plan.spp, **options)) for n, options in choices.items()
            ]
            answers = alternate(runs, plan.rounds)
            return _paired(group, "s", answers, "seconds", **asked)

        all_threads, one = f"{plan.threads} threads", {"threads": 1}
        choices = {all_threads: {"threads": plan.threads}, "1 thread": one}
        rows = compare("threads", choices, least=EFFICIENCY * plan.threads)
        isas = list(reversed(worker.known["isas"]))
        rows += compare("instruction set", {isa: {"isa": isa} for isa in isas})
        rows += compare("sampler", {name: {"sampler": name} for name in ("sobol", "independent")})
        return rows + compare("tree", {name: {"tree": name} for name in ("bvh", "none")})
    finally:
        worker.close()


def startup(plan: Plan, _notes: Notes) -> list[Row]:
    """Importing the package, and the command `parhelion render` up to its first pass."""
    imports = []
    for warm in range(2 * plan.rounds + 1):
        bare = start_seconds("-c", "pass")
        seconds = 1e3 * (start_seconds("-c", "import parhelion") - bare)
        if warm:
            imports.append(seconds)
    first = []
    with tempfile.TemporaryDirectory() as folder:
        for warm in range(plan.rounds + 1):
            start = time.monotonic()
            end = float(run("-m", "bench.first_pass", str(Path(folder) / "first.png")))
            if warm:
                first.append(end - start)
    return [
        Row("start", "import parhelion", "ms", imports, most=150.0),
        Row("start", "first pass of parhelion render", "s", first, most=0.5),
    ]


def clouds(plan: Plan, notes: Notes) -> Iterator[Row]:
    """Boxes of random spheres: tree build, rays a second, memory. A fresh process each time."""
    for count in plan.clouds or (10**5, 10**6) + ((10**7, 10**8) if plan.long else ()):
        # glass: every second sphere
        for glass in (False, True) if count <= 10**7 else (False,):
            yield from _cloud(plan, notes, count, glass)


def _cloud(plan: Plan, notes: Notes, count: int, glass: bool) -> list[Row]:
    runs: dict[str, list[float]] = {}
    for _ in range(min(plan.rounds, 3)):
        worker = Worker(OURS, plan.job(cloud=count, glass=glass, depth=8))
        try:
            whole = worker.render(16)
            single = worker.render(16, max_depth=1)
        finally:
            worker.close()
        known = worker.known
        for name, value in (
            ("build", known["prepare_seconds"]),
            ("build cpu", known["build_cpu_seconds"]),
            ("picture", whole["seconds"]),
            ("picture cpu", whole["cpu_seconds"]),
            ("altogether", known["prepare_seconds"] + whole["seconds"]),
            ("paths", whole["rays"] / whole["cpu_seconds"] / 1e6),
            ("camera", single["rays"] / single["cpu_seconds"] / 1e6),
            ("memory", (whole["peak_bytes"] - known["input_bytes"]) / count),
        ):
            runs.setdefault(name, []).append(value)
    notes.versions[OURS] = worker.known
    group = f"{Decimal(count).normalize():e} spheres".replace("e+", "e") + (
        ", half of glass" if glass else ""
    )
    large = count >= 10**8
    return [
        Row(group, "checks and tree", "s", runs["build"], most=60.0 if large else None),
        Row(group, "checks and tree, processor", "s", runs["build cpu"]),
        Row(group, "picture", "s", runs["picture"], most=120.0 if large else None),
        Row(group, "picture, processor", "s", runs["picture cpu"]),
        Row(
            group,
            "altogether",
            "s",
            runs["altogether"],
            most=5.0 if count == 10**7 else None,
        ),
        Row(group, "camera rays", "M/s and core", runs["camera"], more=True),
        Row(group, "whole paths", "M rays/s and core", runs["paths"], more=True),
        Row(
            group,
            "peak memory beyond the input",
            "B a sphere",
            runs["memory"],
            most=40.0 if large else None,
        ),
    ]


def error(plan: Plan, notes: Notes) -> list[Row]:
    """Mean squared error of the linear picture times seconds, each against its own reference."""
    import numpy as np

    with _workers(plan, notes, without="mitsuba-scalar") as workers:
        references = {name: np.load(_reference(plan, w)) for name, w in workers.items()}
        ours = workers[OURS]
        runs: list[tuple[str, Worker, Any, dict[str, str]]] = [
            (name, w, references[name], {}) for name, w in workers.items()
        ]
        runs.insert(1, (f"{OURS}, independent", ours, references[OURS], {"sampler": "independent"}))
        errors: dict[str, list[float]] = {name: [] for name, *_ in runs}
        products: dict[str, list[float]] = {name: [] for name, *_ in runs}
        path = plan.cache / "picture.npy"
        for seed in range(plan.rounds + 1):
            for name, worker, reference, options in in_turn(runs, seed):
                seconds = worker.render(plan.spp, seed, path, **options)["seconds"]
                if seed:  # the first is not counted: it may compile
                    mse = float(np.mean((np.load(path).astype(np.float64) - reference) ** 2))
                    errors[name].append(mse)
                    products[name].append(mse * seconds)
        path.unlink()
    rows = [Row("mean squared error", name, "", runs) for name, runs in errors.items()]
    base = products[OURS]
    for name, values in products.items():
        pairs = ratios(values, base) if name != OURS else ()
        rows.append(Row("error x time", name, "s", values, against=OURS, ratios=pairs))
    return rows


GROUPS: dict[str, Callable[[Plan, Notes], Iterable[Row]]] = {
    "weekend": weekend,
    "settings": settings,
    "startup": startup,
    "clouds": clouds,
    "error": error,
    "equal": equal,
    "threads": threads,
    "rays": rays,
    "trees": trees,
    "overhead": overhead,
    "memory": memory,
    "lights": lights,
    "surfaces": surfaces,
    "loading": loading,
    "trajectories": trajectories,
    "references": references,
    "noise": noise,
    "sharing": sharing,
}

# What is not measured unless it is asked for: whether pictures are right, and what takes long.
ASKED = ("references", "equal", "threads", "noise", "sharing", "surfaces")


def alternate(
    runs: Sequence[tuple[str, Callable[[], dict[str, Any]]]], rounds: int
) -> dict[str, list[dict[str, Any]]]:
    """Answers of each, in turns that begin with another each, after one that is not counted."""
    answers: dict[str, list[dict[str, Any]]] = {name: [] for name, _ in runs}
    for turn in range(rounds + 1):
        for name, call in in_turn(runs, turn):
            answer = call()
            if turn:
                answers[name].append(answer)
    return answers


def _paired(
    group: str,
    unit: str,
    answers: dict[str, list[dict[str, Any]]],
    key: str,
    least: float | None = None,
) -> list[Row]:
    """One row each; all but the first are paired with the first, and shall be slower than it."""
    values = {name: [a[key] for a in answered] for name, answered in answers.items()}
    base = next(iter(values))
    rows = []
    for name, runs in values.items():
        own = name.startswith(OURS)
        rows.append(
            Row(
                group,
                name,
                unit,
                runs,
                against=None if name == base else base,
                ratios=() if name == base else ratios(runs, values[base]),
                least_ratio=None if own or name == base else least,
            )
        )
    return rows


@contextmanager
def _workers(
    plan: Plan, notes: Notes, without: str = "", **more: Any
) -> Iterator[dict[str, Worker]]:
    """Ours and every peer that is to be had, ours first; a note says which is not."""
    with ExitStack() as stack:
        workers = {OURS: Worker(OURS, plan.job(**more))}
        stack.callback(workers[OURS].close)
        for name in plan.peers:
            if name == without:
                continue
            renderer, variant = PEERS[name]
            try:
                worker = Worker(renderer, plan.job(**variant, **more))
                stack.callback(worker.close)
                worker.render(1)
            except BenchError as problem:
                notes.add(f"{name} was not measured: {problem}")
                continue
            workers[name] = worker
        notes.versions |= {name: worker.known for name, worker in workers.items()}
        yield workers


def _check_agreement(plan: Plan, notes: Notes) -> None:
    """Notes how far mean colours differ, with every metal a mirror and as they are.

    As mirrors the models are the same; fuzz is not, so there a difference is no error.
    """
    import numpy as np

    plan.cache.mkdir(parents=True, exist_ok=True)
    path = plan.cache / "agreement.npy"
    for fuzz, words in ((False, "all metals mirrors"), (True, "fuzzy metals as given")):
        with _workers(plan, notes, without="mitsuba-scalar", fuzz=fuzz) as workers:
            means = {}
            for name, worker in workers.items():
                worker.render(max(64, plan.spp), 1, path)
                means[name] = np.load(path).mean(axis=(0, 1), dtype=np.float64)
        for name, mean in means.items():
            if name != OURS:
                percent = ", ".join(f"{100 * d:+.2f} %" for d in mean / means[OURS] - 1)
                notes.add(f"mean colour, {words}: {name} less ours: {percent} (R, G, B)")
    path.unlink()


def _reference(plan: Plan, worker: Worker) -> Path:
    """The converged picture of a renderer, from the cache if it has been made before."""
    identity = {k: v for k, v in worker.known.items() if isinstance(v, str)}
    key = repr((worker.name, sorted(identity.items()), plan.job(), plan.reference_spp))
    digest = hashlib.sha256(key.encode() + plan.spheres.read_bytes()).hexdigest()
    plan.cache.mkdir(parents=True, exist_ok=True)
    path = plan.cache / f"{worker.name}-{digest[:16]}.npy"
    if not path.exists():
        print(f"making the reference of {worker.name}, {plan.reference_spp} spp", file=sys.stderr)
        part = path.with_name("part.npy")
        worker.render(plan.reference_spp, REFERENCE_SEED, part)
        part.replace(path)
    return path
