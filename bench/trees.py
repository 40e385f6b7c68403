"""The group `trees`: how long trees take on all threads, ours beside Embree's, and how good ours
are.

As in the group `rays`, where it is one core: from arrays to the first ray, and until the tree is
gone. Both rest before each, since threads go on spinning for a while after their work.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from .process import Worker, in_turn
from .rays import EMBREE, OURS, loads
from .scenes import BenchError
from .summary import Row, ratios

REST = 0.05  # seconds


def trees(plan: Any, notes: Any) -> Iterator[Row]:
    """Seconds a tree by program, and what a line through ours is expected to visit."""
    for path, what, _ in loads(plan, notes, "trees"):
        yield from _measured(plan, notes, path, what)


def _measured(plan: Any, notes: Any, path: Path, what: str) -> list[Row]:
    with ExitStack() as stack:
        workers = {}
        for name in (OURS, EMBREE):
            job = {"program": name, "file": str(path), "threads": plan.threads}
            try:
                workers[name] = Worker("rays", job)
            except BenchError as problem:
                if name == OURS:
                    raise
                notes.add(f"{name} was not measured with {what}: {problem}")
                continue
            stack.callback(workers[name].close)
            notes.versions[name] = workers[name].known
        seconds: dict[str, list[float]] = {name: [] for name in workers}
        for turn in range(plan.rounds + 1):
            for name, worker in in_turn(workers.items(), turn):
                time.sleep(REST)
                answer = worker.ask({"rays": "tree"})
                if turn:  # the first is not counted: pages are touched
                    seconds[name].append(answer["seconds"])
        cost = workers[OURS].ask({"rays": "cost"})
    group = f"trees, {what}"
    rows = [Row(group, OURS, "s", seconds.pop(OURS))]
    for name, runs in seconds.items():
        pairs = ratios(runs, rows[0].runs)
        rows.append(Row(group, name, "s", runs, against=OURS, ratios=pairs, least_ratio=1.0))
    for what in ("nodes", "leaves"):  # as often as seconds, for compare.py: no run differs
        rows.append(Row(group, f"{what} that a line meets", "", [cost[what]] * plan.rounds))
    return rows
