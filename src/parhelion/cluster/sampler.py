"""Units of a picture, handed out to workers, and what they saw, added up.

Each tile has one unit under way at a time, which goes on where the film is, so that nothing has to
wait for its turn, and features, whose mattes depend on the order of samples, are right. What comes
twice is dropped: the film's sums are whole numbers, so the picture depends on nothing but which
samples are in it.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ParhelionError, ResourceError, SceneError
from .scenes import packed
from .worker import Picture, Seen, Unit, WrongBuild, film_of, render_unit, versions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..flatten import Flat
    from ..progressive import Tick
    from ..scene import Camera, Settings

log = logging.getLogger("parhelion")

# Seconds that a unit should take: enough that handing it out costs next to nothing, and little
# enough that the last ones end at about the same time.
UNIT_SECONDS = 0.5
# Units that a worker has at a time: one to do while the next one travels.
_EACH = 2
# Samples of a unit before any speed is known
_FIRST = 1 << 15
# Edge of a tile in pixels, at most, and tiles that there should be for each worker, at least.
_EDGE, _TILES = 64, 8
# How often a unit is tried, on other workers if there are any, before the rest goes on without it
_TRIES = 3
# A unit that takes so many times as long as the slowest that came back is given to another worker
# as well, and the first answer counts.
_LATE = 3.0
# Seconds between two looks at what came, when nothing did; and at which workers there are.
_PAUSE, _LOOK = 0.005, 1.0
# Seconds without any worker after which that is told
_ALONE = 10.0


@dataclass(eq=False)
class _Tile:
    """A tile of the film: its place there, and how often its last unit has failed."""

    x: int
    y: int
    width: int
    height: int
    failed: int = 0

    @property
    def at(self) -> tuple[slice, slice]:
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)


@dataclass(eq=False)
class _Task:
    """A unit that was handed out. futures: by those who do it, the first answer counts."""

    tile: _Tile
    unit: Unit
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

        from .. import _core

        self._client, self._errors = client, errors
        self.failures: Sequence[str] = ()
        self._took_part: dict[str, Seen] = {}
        self._fetching: dict[str, Any] = {}
        self._standing: set[str] = set()  # workers that are late
        _check(self._told(client))
        skeleton, bundles = packed(flat.parts)
        scene = flat.sha256()
        self._picture = Picture(
            build=_core.sources,
            scene=scene,
            skeleton=skeleton,
            camera=asdict(camera),
            settings=asdict(settings),
            tree=tree,
            features=features,
            threads=threads,
            isa=isa,
        )
        # Its content names each bundle, so that workers that have it already get nothing.
        self._named = {f"parhelion-{scene}-{i}": bundle for i, bundle in enumerate(bundles)}
        self._name = f"parhelion-{os.urandom(8).hex()}"
        self._sent: list[Any] = []
        self._workers: set[str] = set()
        self._looked = 0.0
        self._counts = np.zeros((0, 0), np.uint32)
        self._film = film
        self._tiles: list[_Tile] = []
        self._tasks: dict[int, _Task] = {}
        self._by_key: dict[str, int] = {}
        self._numbers = itertools.count()
        self._coming = as_completed(with_results=True, raise_errors=False)
        self._samples, self._seconds = 0.0, 0.0  # of the last units, whose ratio is the speed
        self._slowest = 0.0

    @staticmethod
    def _told(client: Any) -> dict[str, Any]:
        from distributed.comm.core import CommClosedError

        try:
            client.wait_for_workers(1, timeout=_ALONE)
            found: dict[str, Any] = client.run(versions, on_error="return")
        except TimeoutError as error:
            raise ResourceError("the cluster has no workers") from error
        except (OSError, CommClosedError) as error:
            raise ResourceError(f"the cluster does not answer: {error}") from error
        return found

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
        self._look()
        if not self._tiles:  # a checkpoint was read, if there is one
            self._counts = film.arrays()[1]
            self._tiles = _tiles(film, len(self._workers))
        waiting = [
            (int(self._counts[tile.at].min()), i)
            for i, tile in enumerate(self._tiles)
            if tile.failed < _TRIES and (self._counts[tile.at] < wanted[tile.at]).any()
        ]
        heapq.heapify(waiting)
        places = {id(tile): i for i, tile in enumerate(self._tiles)}
        stopped = False
        while (waiting or self._tasks) and not stopped:
            self._look()
            while waiting and len(self._tasks) < _EACH * max(1, len(self._workers)):
                tile = self._tiles[heapq.heappop(waiting)[1]]
                self._hand_out(tile, wanted[tile.at])
            came = [a for f, seen in self._arrived() if (a := self._answered(f, seen)) is not None]
            for task, seen in came:
                tile = task.tile
                if seen is not None:
                    self._add(task, seen)
                    samples, rays = samples + seen.samples, rays + seen.rays
                if tile.failed < _TRIES and (self._counts[tile.at] < wanted[tile.at]).any():
                    heapq.heappush(waiting, (int(self._counts[tile.at].min()), places[id(tile)]))
            stopped = tick(samples, rays)
            if not came:
                time.sleep(_PAUSE)
        self._drop()
        return samples, rays, not stopped and not self.failures

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
        self._sent.clear()
        self._fetching.clear()

    def _look(self) -> None:
        """Which workers there are; new ones get the scene."""
        now = time.monotonic()
        if now < self._looked + _LOOK:
            return
        self._looked = now
        if self._client.status != "running":
            raise ResourceError("the cluster's scheduler is gone")
        there = set(self._client.scheduler_info(n_workers=-1)["workers"])
        if there and there.isdisjoint(self._workers):  # none has it, or they are gone
            named = {**self._named, self._name: self._picture}
            self._sent = list(self._client.scatter(named, broadcast=True, hash=False).values())
        else:
            for worker in there - self._workers:  # Dask gives work to those that have the scene
                self._fetching[worker] = self._client.submit(
                    len, self._sent, workers=[worker], key=f"{self._name}-{worker}", pure=False
                )
        if not there and self._workers:
            log.warning("the cluster has no workers any more; waiting for some")
        self._workers = there
        self._help()

    def _hand_out(self, tile: _Tile, wanted: NDArray[np.uint32]) -> None:
        """Begins the next unit of a tile."""
        begun = self._counts[tile.at].copy()
        area = tile.width * tile.height
        samples = self._samples * UNIT_SECONDS / self._seconds if self._seconds else _FIRST
        step = max(1, int(samples / area))
        to = np.minimum(wanted, begun + np.uint32(step))
        if self._errors:  # means are kept of powers of two, which only the whole film knows
            powers = np.uint32(1) << np.ceil(np.log2(begun + 1.0)).astype(np.uint32)
            to = np.where(begun == 0, to, np.minimum(to, powers))
        unit = Unit(
            number=next(self._numbers),
            x=self._film.x + tile.x,
            y=self._film.y + tile.y,
            width=tile.width,
            height=tile.height,
            begun=_shortened(begun),
            targets=_shortened(np.maximum(to, begun)),
            errors=self._errors and not begun.all(),
            features=self._features_of(tile) if self._picture.features else b"",
        )
        task = _Task(tile, unit, time.monotonic(), [])
        self._tasks[unit.number] = task
        self._submit(task)

    def _submit(self, task: _Task) -> None:
        others = list(self._workers - self._standing) if self._standing else []
        key = f"{self._name}-{task.unit.number}-{len(task.futures)}"
        future = self._client.submit(
            render_unit,
            self._sent[-1],
            task.unit,
            self._sent[:-1],
            key=key,
            pure=False,
            workers=others or None,
            allow_other_workers=bool(others),
        )
        task.futures.append(future)
        self._by_key[key] = task.unit.number
        self._coming.add(future)

    def _help(self) -> None:
        """Gives what is late to other workers as well, and those who have it nothing more before
        they answer.
        """
        now = time.monotonic()
        late = now - max(_LATE * self._slowest, _LOOK)
        tasks = [task for task in self._tasks.values() if task.since < late]
        if not tasks or not self._slowest:
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
        if future.status == "finished":
            self._forget(task)
            return task, result
        error = future.exception() if future.status == "error" else None
        if isinstance(error, WrongBuild):
            raise SceneError(str(error)) from error
        if any(f is not future and not f.done() for f in task.futures):
            return None  # another worker is still at it
        self._forget(task)
        task.tile.failed += 1
        if task.tile.failed >= _TRIES:
            self._give_up(task, error)
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

    def _give_up(self, task: _Task, error: BaseException | None) -> None:
        unit = task.unit
        crop = f"{unit.x},{unit.y},{unit.width},{unit.height}"
        first, last = int(np.min(unit.begun)), int(np.max(unit.targets))
        told = (
            f"samples {first} to {last - 1} of the pixels {crop} (x, y, width, height) failed"
            f" {_TRIES} times: {error or 'cancelled'}; `parhelion render SCENE --crop {crop} --spp"
            f" {last}` with the picture's other options tries them here"
        )
        self.failures = (*self.failures, told)

    def _drop(self) -> None:
        """Ends what is under way."""
        for task in list(self._tasks.values()):
            self._forget(task)


def _check(told: dict[str, Any]) -> None:
    """Raises SceneError for workers whose samples might not be ours."""
    from .. import __version__

    ours = versions()
    for worker, theirs in sorted(told.items()):
        if isinstance(theirs, ModuleNotFoundError):
            raise SceneError(f"the worker {worker} has no Parhelion: {theirs}")
        if isinstance(theirs, BaseException):
            raise ResourceError(f"the worker {worker} does not work: {theirs}")
        if theirs != ours:
            version = theirs.get("version")
            what = "another build" if version == __version__ else f"version {version}"
            raise SceneError(
                f"the worker {worker} has {what} of Parhelion, and this is {__version__};"
                " samples might differ"
            )


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

    edge = _EDGE
    while edge > _core.block and (film.width * film.height) / edge**2 < _TILES * workers:
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
