"""Units handed to workers, each to one by its address, and what comes back.

Dask's own choice would not do: it counts a worker's threads, and a unit takes all of its cores.
"""

from __future__ import annotations

import itertools
import math
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
# Seconds after which a unit is done again that Dask tells to be done, but whose answer does not
# come: it drops one that it fails to fetch.
_FETCH = 10.0
# Units in a row that a worker may fail at before others are preferred
_FAILURES = 3


@dataclass(eq=False)
class Task:
    """A unit on its way. since: when it was last given to a worker, as of time.monotonic(). keys:
    Dask's, of those who have it.
    """

    unit: Unit
    since: float = 0.0
    keys: set[str] = field(default_factory=set)


@dataclass(eq=False)
class _Given:
    """A unit that a worker has, since when, and since when Dask tells it to be done."""

    task: Task
    worker: str
    future: Any
    since: float
    done: float = math.inf


class Dispatcher:
    """Gives units to the workers of a roster. done: units that came back; again: how often one was
    given to another worker, or is to be done once more.
    """

    def __init__(self, client: Any, roster: Roster, name: str) -> None:
        from distributed import as_completed

        self._client, self._roster, self._name = client, roster, name
        self.done = self.again = 0
        self._tasks: set[Task] = set()
        self._by_key: dict[str, _Given] = {}
        self._numbers = itertools.count()
        # by the client's own thread: of several clients Dask takes the newest, and a connection
        # that two threads use breaks
        self._coming = as_completed(loop=client.loop, with_results=True, raise_errors=False)
        self._load: Counter[str] = Counter()  # units that a worker has
        self._failing: Counter[str] = Counter()  # units in a row at which it has failed
        self._standing: set[str] = set()  # workers that are late, or fail
        self._slowest = 0.0  # seconds
        self._swept = 0.0  # when what is lost was last looked for

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
        task.keys.add(key)
        self._tasks.add(task)
        self._by_key[key] = _Given(task, worker, future, task.since)
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
                given = self._by_key[future.key]
                answers[given.task] = self._heard(given, result)
        gone = self._load.keys() - self._roster.there
        for worker in gone:
            keys = [key for key, given in self._by_key.items() if given.worker == worker]
            theirs = [self._without(key).task for key in keys]
            answers.update(dict.fromkeys(theirs))
            # A unit may have ended its worker if that was at it, and no other went as well.
            if theirs and len(gone) == 1:
                answers[theirs[0]] = Failed(worker, "its worker ended")
            del self._load[worker]
        answers.update(dict.fromkeys(self._lost()))
        self._help()
        return [(t, answer) for t, answer in answers.items() if t not in self._tasks]

    def drop(self) -> None:
        """Ends what is under way."""
        for task in list(self._tasks):
            self._forget(task)

    def _heard(self, given: _Given, result: Any) -> Seen | Failed | None:
        """Takes an answer; the task is forgotten unless another worker is still at it."""
        worker, future = given.worker, given.future
        if isinstance(result, Seen) and future.status == "finished":
            self._slowest = max(0.95 * self._slowest, time.monotonic() - given.since)
            del self._failing[worker]
            self.done += 1
            self._forget(given.task)
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

    def _without(self, key: str) -> _Given:
        """Takes a unit from a worker."""
        self.again += 1
        given = self._release(key)
        if not given.task.keys:
            self._tasks.discard(given.task)
        return given

    def _forget(self, task: Task) -> None:
        for key in list(task.keys):
            self._release(key)
        self._tasks.discard(task)

    def _release(self, key: str) -> _Given:
        given = self._by_key.pop(key)
        given.task.keys.remove(key)
        self._load[given.worker] -= 1
        if not given.future.done():  # else it waits for ever for a worker that is gone
            given.future.cancel()
        elif given.future.status == "finished" and self._failing[given.worker] < _FAILURES:
            self._standing.discard(given.worker)
        return given

    def _lost(self) -> list[Task]:
        """Takes units whose answers Dask has lost from those who had them."""
        now = time.monotonic()
        if now < self._swept + LOOK:
            return []
        self._swept = now
        lost = []
        for key, given in list(self._by_key.items()):
            if given.future.done():
                given.done = min(given.done, now)
            if now > given.done + _FETCH:
                lost.append(self._without(key).task)
                given.future.release()  # Dask's as_completed keeps it
        return lost

    def _help(self) -> None:
        """Gives what is late to other workers as well, and those who have it nothing more before
        they answer.
        """
        late = time.monotonic() - (
            max(_LATE * self._slowest, LOOK) if self._slowest else _LATE_FIRST
        )
        tasks = [task for task in self._tasks if task.since < late]
        having = [{self._by_key[key].worker for key in task.keys} for task in tasks]
        self._standing.update(*having)
        for task, theirs in zip(tasks, having, strict=True):
            others = self._roster.ready - self._standing - theirs
            if not others and len(theirs) == 1:  # all are late: one may have lost what it had
                others = self._roster.ready - theirs
            if others:
                self.again += 1
                self.hand(task, min(others, key=self._load.__getitem__))
