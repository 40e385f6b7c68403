"""Units handed to workers, each to one by its address, and what comes back.

Dask's own choice would not do: it counts a worker's threads, and a unit takes all of its cores.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Set
from dataclasses import dataclass, field
from typing import Any

from .roster import LOOK, Roster
from .worker import Failed, Lacking, Seen, Unit, render_unit

# Units that a worker has at a time: one to do while the next one travels
EACH = 2
# A unit that takes so many times as long as the slowest that came back is given to another worker
# as well, and the first answer counts; before any came back, one that takes so many seconds.
_LATE, _LATE_FIRST = 3.0, 10.0
# Where there is no other worker, or each has it: one that takes so many times as long as that, then
# twice as long again, and so on. Its answer may be lost: Dask drops one that it fails to fetch.
_LOST = 5.0
# Units in a row that a worker may fail at before others are preferred
_FAILURES = 3


@dataclass(eq=False)
class Task:
    """A unit on its way. since: when it was last given to a worker, as of time.monotonic().
    futures: of those who have it, by Dask's keys. waits: see _LOST.
    """

    unit: Unit
    since: float = 0.0
    futures: dict[str, Any] = field(default_factory=dict)
    waits: float = _LOST


class Dispatcher:
    """Gives units to the workers of a roster. done: units that came back; again: how often one was
    given to another worker, or came back without a result.
    """

    def __init__(self, client: Any, roster: Roster, name: str) -> None:
        from distributed import as_completed

        self._client, self._roster, self._name = client, roster, name
        self.done = self.again = 0
        self._tasks: set[Task] = set()
        self._by_key: dict[str, tuple[Task, str]] = {}
        self._numbers = itertools.count()
        self._coming = as_completed(with_results=True, raise_errors=False)
        self._load: Counter[str] = Counter()  # units that a worker has
        self._failing: Counter[str] = Counter()  # units in a row at which it has failed
        self._standing: set[str] = set()  # workers that are late, or fail
        self._slowest = 0.0  # seconds

    def free(self) -> list[str]:
        """Workers that may get one more unit, those with the fewest first."""
        ready = self._roster.ready
        some = [w for w in (ready - self._standing or ready) if self._load[w] < EACH]
        return sorted(some, key=self._load.__getitem__)

    def all_but(self, workers: Set[str]) -> bool:
        """Whether there are others than these that work, or may soon."""
        return not (self._roster.ready - self._standing) | self._roster.coming <= workers

    def hand(self, task: Task, worker: str) -> None:
        """Gives a unit to a worker."""
        key = f"{self._name}-{task.unit.number}-{next(self._numbers)}"
        future = self._client.submit(render_unit, task.unit, key=key, pure=False, workers=[worker])
        task.since = time.monotonic()
        task.futures[key] = future
        self._tasks.add(task)
        self._by_key[key] = task, worker
        self._load[worker] += 1
        self._coming.add(future)

    def answers(self) -> list[tuple[Task, Seen | Failed | None]]:
        """What came of units since this was last called; None for one that nobody has any more,
        through no fault of its own.
        """
        self._roster.look()
        answers: dict[Task, Seen | Failed | None] = {}
        came = self._coming.next_batch(block=False) if self._by_key else ()
        for future, result in came:
            if future.key in self._by_key:
                task, worker = self._by_key[future.key]
                answers[task] = self._heard(task, worker, future, result)
        gone = self._load.keys() - self._roster.there
        for worker in gone:
            keys = [key for key, (_, who) in self._by_key.items() if who == worker]
            theirs = sorted({self._by_key[key][0] for key in keys}, key=lambda t: t.since)
            for key in keys:
                self._without(key)
            answers.update(dict.fromkeys(theirs))
            # A unit may have ended its worker if that was at it, and no other went as well.
            if theirs and len(gone) == 1:
                answers[theirs[0]] = Failed(worker, "its worker ended")
            del self._load[worker]
        self._help()
        return [(t, answer) for t, answer in answers.items() if t not in self._tasks]

    def drop(self) -> None:
        """Ends what is under way."""
        for task in list(self._tasks):
            self._forget(task)

    def _heard(self, task: Task, worker: str, future: Any, result: Any) -> Seen | Failed | None:
        """Takes an answer; the task is forgotten unless another worker is still at it."""
        if isinstance(result, Seen) and future.status == "finished":
            self._slowest = max(0.95 * self._slowest, time.monotonic() - task.since)
            self._standing.discard(worker)
            del self._failing[worker]
            self.done += 1
            self._forget(task)
            return result
        if future.status == "error":
            result = Failed(worker, str(future.exception()))
        elif isinstance(result, Lacking):
            self._roster.lacks(worker)
        elif not isinstance(result, Failed):
            result = Failed(worker, future.status)  # cancelled, or lost on its way
        if isinstance(result, Failed):
            self._failing[worker] += 1
            if self._failing[worker] >= _FAILURES:
                self._standing.add(worker)
        self._without(future.key)
        return result if isinstance(result, Failed) else None

    def _without(self, key: str) -> None:
        """Takes a unit from a worker."""
        self.again += 1
        task = self._release(key)
        if not task.futures:
            self._tasks.discard(task)

    def _forget(self, task: Task) -> None:
        for key in list(task.futures):
            self._release(key)
        self._tasks.discard(task)

    def _release(self, key: str) -> Task:
        task, worker = self._by_key.pop(key)
        self._load[worker] -= 1
        future = task.futures.pop(key)
        if not future.done():  # else it waits for ever for a worker that is gone
            future.cancel()
        return task

    def _help(self) -> None:
        """Gives what is late to other workers as well, and those who have it nothing more before
        they answer.
        """
        now = time.monotonic()
        late = max(_LATE * self._slowest, LOOK) if self._slowest else _LATE_FIRST
        tasks = [task for task in self._tasks if task.since < now - late]
        having = [{self._by_key[key][1] for key in task.futures} for task in tasks]
        self._standing.update(*having)
        for task, theirs in zip(tasks, having, strict=True):
            others = self._roster.ready - self._standing - theirs
            if not others and task.since < now - task.waits * late:
                others, task.waits = self._roster.ready, 2.0 * task.waits
            if others:
                self.again += 1
                self.hand(task, min(others, key=self._load.__getitem__))
