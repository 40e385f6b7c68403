"""Units of a picture, handed out to workers, and what they saw, added up.

Each tile has one unit under way at a time, which goes on where the film is, so that nothing has to
wait for its turn, and features, whose mattes depend on the order of samples, are right. What comes
twice is dropped: the film's sums are whole numbers, so the picture depends on nothing but which
samples are in it.
"""

from __future__ import annotations

import heapq
import itertools
import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ParhelionError, ResourceError
from ..progress import Crew
from .roster import LOOK, Roster
from .worker import Failed, Lacking, Picture, Seen, Unit, film_of, render_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..flatten import Flat
    from ..progressive import Tick
    from ..scene import Camera, Settings

# Seconds that a unit takes while there is much left to do
UNIT_SECONDS = 0.5
# Units that a worker has at a time: one to do while the next one travels
EACH = 2
# The last units are shorter, so that workers end at about the same time: each has at least so many
# units to come, until they would take less than this. Seconds.
_LAST, _SHORTEST = 4, 0.02
# Of the seconds between two answers, the share that may go into taking one in and handing out the
# next
_BUSY = 0.5
# Samples of a unit before any speed is known
_FIRST = 1 << 15
# Edge of a tile in pixels, at most, and tiles that there should be for each worker, at least
EDGE, TILES = 64, 8
# How often a unit is tried, by other workers if there are any, before the rest goes on without it;
# and how many units in a row a worker may fail at before others are preferred
_TRIES = 3
# A unit that takes so many times as long as the slowest that came back is given to another worker
# as well, and the first answer counts; before any came back, one that takes so many seconds.
_LATE, _LATE_FIRST = 3.0, 10.0
# Seconds between two looks at what came, when nothing did
_PAUSE = 0.01


@dataclass(eq=False)
class _Tile:
    """A tile of the film: its place there, how often its last unit has failed, and with whom."""

    x: int
    y: int
    width: int
    height: int
    failed: int = 0
    failed_with: set[str] = field(default_factory=set)

    @property
    def at(self) -> tuple[slice, slice]:
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


@dataclass(eq=False)
class _Task:
    """A unit that was handed out. samples: that it takes. futures: by those who do it, the first
    answer counts.
    """

    tile: _Tile
    unit: Unit
    samples: int
    since: float
    futures: list[Any]


class Workers:
    """The workers of a cluster, as a progressive.Sampler for one film.

    failures: of tiles that were given up, what to tell of each.
    """

    at_once = True

    def __init__(
        self,
        client: Any,
        flat: Flat,
        camera: Camera,
        settings: Settings,
        film: Any,
        *,
        tree: bool,
        features: bool,
        errors: bool,
        threads: int,
        isa: str,
    ) -> None:
        from distributed import as_completed

        from .. import __version__, _core

        self._client, self._errors, self._film = client, errors, film
        self.failures: Sequence[str] = ()
        self._units = self._again = 0
        self._took_part: dict[str, Seen] = {}
        self._standing: set[str] = set()  # workers that are late, or fail
        self._failing: Counter[str] = Counter()  # units in a row at which a worker has failed
        self._picture = Picture(
            name=f"parhelion-{os.urandom(8).hex()}",
            version=__version__,
            build=_core.sources,
            scene=flat.sha256(),
            camera=asdict(camera),
            settings=asdict(settings),
            tree=tree,
            features=features,
            threads=threads,
            isa=isa,
        )
        self._roster = Roster(client, self._picture, flat.parts)
        self._counts = np.zeros((0, 0), np.uint32)
        self._tiles: list[_Tile] = []
        self._tasks: dict[int, _Task] = {}
        self._by_key: dict[str, int] = {}
        self._numbers = itertools.count()
        self._coming = as_completed(with_results=True, raise_errors=False)
        self._samples, self._seconds = 0.0, 0.0  # of the last units, whose ratio is the speed
        self._left = 0  # samples that no unit has yet
        self._cost = 0.0  # seconds that a unit keeps this process busy
        self._slowest = 0.0

    def take(
        self, film: Any, targets: NDArray[np.uint32], pixels: int, tick: Tick
    ) -> tuple[int, int, bool]:
        """As progressive.Sampler says. What is under way when it is stopped is dropped.

        Raises ResourceError where the scheduler is gone.
        """
        del pixels
        try:
            return self._take(film, targets, tick)
        except ParhelionError:
            raise
        except Exception as error:
            if self._client.status == "running":
                raise
            raise ResourceError(f"the cluster's scheduler is gone: {error}") from error

    def _take(self, film: Any, targets: NDArray[np.uint32], tick: Tick) -> tuple[int, int, bool]:
        wanted = _by_pixel(film, targets)
        samples = rays = 0
        if not self._tiles:  # a checkpoint was read, if there is one
            self._counts = film.arrays()[1]
            self._tiles = _tiles(film, len(self._roster.there))
        waiting = [
            (int(self._counts[tile.at].min()), i)
            for i, tile in enumerate(self._tiles)
            if tile.failed < _TRIES and (self._counts[tile.at] < wanted[tile.at]).any()
        ]
        heapq.heapify(waiting)
        places = {id(tile): i for i, tile in enumerate(self._tiles)}
        self._left = int(np.maximum(wanted, self._counts).sum(dtype=np.int64) - self._counts.sum())
        stopped = False
        while (waiting or self._tasks) and not stopped:
            begun = time.perf_counter()
            self._roster.look()
            self._help()
            while waiting and len(self._tasks) < EACH * len(self._roster.ready):
                tile = self._tiles[heapq.heappop(waiting)[1]]
                self._hand_out(tile, wanted[tile.at])
            came = [a for f, seen in self._arrived() if (a := self._answered(f, seen)) is not None]
            for task, seen in came:
                tile = task.tile
                if seen is not None:
                    self._add(task, seen)
                    samples, rays = samples + seen.samples, rays + seen.rays
                else:
                    self._left += task.samples
                if tile.failed < _TRIES and (self._counts[tile.at] < wanted[tile.at]).any():
                    heapq.heappush(waiting, (int(self._counts[tile.at].min()), places[id(tile)]))
            stopped = tick(samples, rays)
            if came:
                each = (time.perf_counter() - begun) / len(came)
                self._cost = 0.9 * self._cost + 0.1 * each if self._cost else each
            else:
                time.sleep(_PAUSE)
        self._drop()
        return samples, rays, not stopped and not self.failures

    @property
    def crew(self) -> Crew:
        """Who is at it, and how far they are."""
        return Crew(len(self._roster.ready), self._units, self._again)

    @property
    def threads(self) -> int:
        """Of all workers that took part."""
        return sum(seen.threads for seen in self._took_part.values())

    @property
    def isa(self) -> str:
        """Instruction sets of all workers that took part."""
        return ", ".join(sorted({seen.isa for seen in self._took_part.values()}))

    def close(self) -> None:
        """Lets go of what the workers hold."""
        self._drop()
        self._roster.close()

    def _hand_out(self, tile: _Tile, wanted: NDArray[np.uint32]) -> None:
        """Begins the next unit of a tile."""
        begun = self._counts[tile.at].copy()
        samples = float(_FIRST)
        if self._seconds:
            speed, workers = self._samples / self._seconds, max(1, len(self._roster.ready))
            samples = speed * unit_seconds(self._left / speed, workers, self._cost)
        step = max(1, int(samples / (tile.width * tile.height)))
        to = np.minimum(wanted, begun + np.uint32(step))
        if self._errors:  # means are kept of powers of two, which only the whole film knows
            powers = np.uint32(1) << np.ceil(np.log2(begun + 1.0)).astype(np.uint32)
            to = np.where(begun == 0, to, np.minimum(to, powers))
        unit = Unit(
            number=next(self._numbers),
            picture=self._picture.name,
            x=self._film.x + tile.x,
            y=self._film.y + tile.y,
            width=tile.width,
            height=tile.height,
            begun=_shortened(begun),
            targets=_shortened(np.maximum(to, begun)),
            errors=self._errors and not begun.all(),
            features=self._features_of(tile) if self._picture.features else b"",
        )
        handed = int((np.maximum(to, begun) - begun).sum(dtype=np.int64))
        self._left -= handed
        task = _Task(tile, unit, handed, time.monotonic(), [])
        self._tasks[unit.number] = task
        self._submit(task)

    def _submit(self, task: _Task) -> None:
        ready = self._roster.ready
        good = (
            ready - self._standing - task.tile.failed_with or ready - task.tile.failed_with or ready
        )
        key = f"{self._picture.name}-{task.unit.number}-{len(task.futures)}"
        future = self._client.submit(
            render_unit,
            task.unit,
            key=key,
            pure=False,
            workers=None if good == self._roster.there else list(good),
        )
        self._again += bool(task.futures)
        task.futures.append(future)
        self._by_key[key] = task.unit.number
        self._coming.add(future)

    def _help(self) -> None:
        """Gives what is late to other workers as well, and those who have it nothing more before
        they answer.
        """
        now = time.monotonic()
        late = now - (max(_LATE * self._slowest, LOOK) if self._slowest else _LATE_FIRST)
        tasks = [task for task in self._tasks.values() if task.since < late]
        if not tasks or not self._roster.ready:
            return
        keys = {future.key for task in tasks for future in task.futures}
        for worker, theirs in self._client.processing().items():
            if not keys.isdisjoint(theirs):
                self._standing.add(worker)
        for task in tasks:
            task.since = now
            self._submit(task)

    def _arrived(self) -> list[tuple[Any, Any]]:
        return list(self._coming.next_batch(block=False)) if self._by_key else []

    def _answered(self, future: Any, result: Any) -> tuple[_Task, Seen | None] | None:
        """The task that a future answers, and what was seen; None for one that is answered."""
        number = self._by_key.pop(future.key, None)
        task = None if number is None else self._tasks.get(number)
        if number is None or task is None:
            return None
        if future.status == "finished" and isinstance(result, Seen):
            self._forget(task)
            self._units += 1
            return task, result
        if any(f is not future and not f.done() for f in task.futures):
            return None  # another worker is still at it
        self._forget(task)
        self._again += 1
        tile = task.tile
        if isinstance(result, Lacking):
            self._roster.lacks(result.worker)
            return task, None
        tile.failed += 1
        if isinstance(result, Failed):
            why = result.why
            tile.failed_with.add(result.worker)
            self._failing[result.worker] += 1
            if self._failing[result.worker] >= _TRIES:
                self._standing.add(result.worker)
        elif future.status == "error":  # it has ended several workers
            why, tile.failed = str(future.exception()), _TRIES
        else:
            why = "cancelled"
        if tile.failed >= _TRIES:
            self._give_up(task, why)
        return task, None

    def _forget(self, task: _Task) -> None:
        del self._tasks[task.unit.number]
        for future in task.futures:
            self._by_key.pop(future.key, None)
            if not future.done():
                future.cancel()

    def _add(self, task: _Task, seen: Seen) -> None:
        """Adds to the film what a unit saw."""
        unit, tile = task.unit, task.tile
        begun = np.broadcast_to(np.asarray(unit.begun, np.uint32), (tile.height, tile.width))
        self._film.add(
            film_of(unit, self._picture.features, seen.memory), np.ascontiguousarray(begun)
        )
        self._counts[tile.at] = np.maximum(begun, unit.targets)
        tile.failed = 0
        tile.failed_with.clear()
        del self._failing[seen.worker]
        self._took_part[seen.worker] = seen
        if seen.samples:
            self._samples = 0.9 * self._samples + seen.samples
            self._seconds = 0.9 * self._seconds + seen.seconds
            self._slowest = max(0.95 * self._slowest, time.monotonic() - task.since)
        self._standing.discard(seen.worker)

    def _features_of(self, tile: _Tile) -> bytes:
        """What the film has seen in a tile."""
        height, width = self._counts.shape
        values = self._film.memory()[1]
        rows = values.reshape(height, width, values.size // (height * width))
        return bytes(np.ascontiguousarray(rows[tile.at]).data)

    def _give_up(self, task: _Task, why: str) -> None:
        unit = task.unit
        crop = f"{unit.x},{unit.y},{unit.width},{unit.height}"
        first, last = int(np.min(unit.begun)), int(np.max(unit.targets))
        told = (
            f"samples {first} to {last - 1} of the pixels {crop} (x, y, width, height) failed"
            f" {_TRIES} times: {why}; `parhelion render SCENE --crop {crop} --spp"
            f" {last}` with the picture's other options tries them here"
        )
        self.failures = (*self.failures, told)

    def _drop(self) -> None:
        """Ends what is under way."""
        for task in list(self._tasks.values()):
            self._forget(task)


def unit_seconds(left: float, workers: int, cost: float) -> float:
    """Seconds that the next unit should take. left: that all units to come take together; cost:
    that each keeps the process which hands them out.
    """
    shortest = max(_SHORTEST, workers * cost / _BUSY)
    return max(shortest, min(UNIT_SECONDS, left / (_LAST * workers)))


def _by_pixel(film: Any, targets: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Targets of pixels, of those of cells; see Film."""
    from .. import _core

    if targets.shape == (film.height, film.width):
        return targets
    rows = np.arange(film.height)
    cells = 2 * (rows // _core.block) + rows % 2
    wide: NDArray[np.uint32] = targets[cells].repeat(_core.block, axis=1)[:, : film.width]
    return wide


def _tiles(film: Any, workers: int) -> list[_Tile]:
    """The tiles of a film: large ones, if there are enough of them for all workers."""
    from .. import _core

    edge = EDGE
    while edge > _core.block and (film.width * film.height) / edge**2 < TILES * workers:
        edge //= 2
    return [
        _Tile(x, y, min(edge, film.width - x), min(edge, film.height - y))
        for y in range(0, film.height, edge)
        for x in range(0, film.width, edge)
    ]


def _shortened(counts: NDArray[np.uint32]) -> Any:
    """A number for all, if they are the same."""
    first = int(counts.flat[0])
    return first if (counts == first).all() else counts
