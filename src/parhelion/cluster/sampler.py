"""Units of a picture, handed out to workers, and what they saw, added up.

Each tile has one unit under way at a time, which goes on where the film is, so that nothing has to
wait for its turn, and features, whose mattes depend on the order of samples, are right. What comes
twice is dropped: the film's sums are whole numbers, so the picture depends on nothing but which
samples are in it.
"""

from __future__ import annotations

import heapq
import itertools
import math
import os
import shlex
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ParhelionError, ResourceError
from ..progress import Crew
from .dispatch import Dispatcher, Task
from .places import Opened
from .roster import Roster
from .worker import Failed, Picture, Seen, Unit, build, film_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..flatten import Flat
    from ..progressive import Tick
    from ..scene import Camera, Settings, Source

# Seconds that a unit takes while there is much left to do
UNIT_SECONDS = 0.5
# The last units are shorter, so that workers end at about the same time: each has at least so many
# units to come, until they would take less than this. Seconds.
_LAST, _SHORTEST = 4, 0.02
# Of the seconds between two answers, the share that may go into taking one in and handing out the
# next
_BUSY = 0.7
# Samples of a unit before any speed is known
_FIRST = 1 << 15
# Edge of a tile in pixels, at most and at least, and tiles that there should be for each worker
EDGE, _LEAST_EDGE, TILES = 64, 16, 8
# Multiples of it, without their whole parts, lie evenly however many there are
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
# Units that are handed out before what came is looked at
_AT_ONCE = 64
# A picture that is ended early is to be about even: seconds that the first units of all tiles take
# together, and how many times as many samples a tile may have after a unit as before. More units
# cost a smaller share of a long picture than of a short one, whose first round may take longer: of
# one of a minute all of that, of one of ten minutes a tenth of a minute.
_FIRST_ROUND, _SHORT, _GROWTH = 2.0, 60.0, 4.0
# How often a unit is tried, by other workers if there are any, before the rest goes on without it
_TRIES = 5
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


class Workers:
    """The workers of a cluster, as a progressive.Sampler for one film.

    failures: of tiles that were given up, what to tell of each.
    """

    at_once = True

    def __init__(
        self,
        place: Opened,
        flat: Flat,
        camera: Camera,
        settings: Settings,
        film: Any,
        *,
        source: Source | None = None,
        tree: bool,
        features: bool,
        errors: bool,
        isa: str,
    ) -> None:
        from .. import __version__

        self._place, self._client = place, place.client
        self._errors, self._film = errors, film
        self.failures: Sequence[str] = ()
        self._took_part: dict[str, Seen] = {}
        self._picture = Picture(
            name=f"parhelion-{os.urandom(8).hex()}",
            version=__version__,
            build=build(),
            scene=flat.sha256(),
            source=None if source is None else asdict(source),
            camera=asdict(camera),
            settings=asdict(settings),
            tree=tree,
            features=features,
            threads=place.threads,
            isa=isa,
        )
        self._roster = Roster(self._client, self._picture, flat.parts)
        self._dispatcher = Dispatcher(self._client, self._roster, self._picture.name)
        self._counts = np.zeros((0, 0), np.uint32)
        self._tiles: list[_Tile] = []
        self._under_way: dict[Task, _Tile] = {}
        self._numbers = itertools.count()
        self._units, self._seconds = 0.0, 0.0  # the last ones, and what their samples took, each
        self._largest = 0  # samples of the largest unit that came back
        self._left = 0  # samples that no unit has yet
        self._cost = 0.0  # seconds that a unit keeps this process busy

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
        if not self._roster.begin(lambda: self._place.look() or tick(0, 0)):
            return 0, 0, False
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
        while (waiting or self._under_way) and not stopped:
            begun = time.perf_counter()
            aside = []
            free = self._dispatcher.free()
            for _ in range(_AT_ONCE):
                if not waiting or not free:
                    break
                place = heapq.heappop(waiting)
                tile = self._tiles[place[1]]
                worker = next((w for w in free if w not in tile.failed_with), free[0])
                if worker in tile.failed_with and self._dispatcher.all_but(tile.failed_with):
                    aside.append(place)  # till one of the others is free
                    continue
                free.remove(worker)
                self._hand_out(tile, wanted[tile.at], worker)
            for place in aside:
                heapq.heappush(waiting, place)
            came = self._dispatcher.answers()
            if not self._roster.there:
                self._place.gone()
            for task, answer in came:
                tile = self._under_way.pop(task)
                if isinstance(answer, Seen):
                    self._add(tile, task.unit, answer)
                    samples, rays = samples + answer.samples, rays + answer.rays
                else:
                    self._left += task.unit.samples
                    if answer is not None:
                        self._failed(tile, task.unit, answer)
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
        units = self._dispatcher
        return Crew(len(self._roster.ready), units.done, units.again)

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

    def _hand_out(self, tile: _Tile, wanted: NDArray[np.uint32], worker: str) -> None:
        """Has a worker begin the next unit of a tile."""
        begun = self._counts[tile.at].copy()
        samples = float(_FIRST)
        if self._seconds:
            speed, workers = self._units / self._seconds, max(1, len(self._roster.ready))
            had, left = int(begun.sum(dtype=np.int64)) / speed, self._left / speed
            samples = speed * unit_seconds(left, had, len(self._tiles), workers, self._cost)
            samples = min(samples, _GROWTH * self._largest)  # the first may be of the sky
        most = int((np.maximum(wanted, begun) - begun).max())
        step = even_part(most, samples / max(1, int(np.count_nonzero(wanted > begun))))
        to = np.minimum(wanted, begun + np.uint32(step))
        if self._errors:  # means are kept of powers of two, which only the whole film knows
            powers = np.uint32(1) << np.ceil(np.log2(begun + 1.0)).astype(np.uint32)
            to = np.where(begun == 0, to, np.minimum(to, powers))
        to = np.maximum(to, begun)
        unit = Unit(
            number=next(self._numbers),
            picture=self._picture.name,
            x=self._film.x + tile.x,
            y=self._film.y + tile.y,
            width=tile.width,
            height=tile.height,
            begun=_shortened(begun),
            targets=_shortened(to),
            samples=int((to - begun).sum(dtype=np.int64)),
            errors=self._errors and not begun.all(),
            features=self._features_of(tile) if self._picture.features else b"",
        )
        self._left -= unit.samples
        task = Task(unit)
        self._under_way[task] = tile
        self._dispatcher.hand(task, worker)

    def _add(self, tile: _Tile, unit: Unit, seen: Seen) -> None:
        """Adds to the film what a unit saw."""
        begun = np.broadcast_to(np.asarray(unit.begun, np.uint32), (tile.height, tile.width))
        self._film.add(
            film_of(unit, self._picture.features, seen.memory), np.ascontiguousarray(begun)
        )
        self._counts[tile.at] = np.maximum(begun, unit.targets)
        tile.failed = 0
        tile.failed_with.clear()
        self._took_part[seen.worker] = seen
        if seen.samples:
            # The same weight for each: those of the sky have many times as many samples.
            self._units = 0.9 * self._units + 1.0
            self._seconds = 0.9 * self._seconds + seen.seconds / seen.samples
            self._largest = max(self._largest, seen.samples)

    def _failed(self, tile: _Tile, unit: Unit, failed: Failed) -> None:
        """Counts a failure, and after the last tells of it."""
        tile.failed += 1
        tile.failed_with.add(failed.worker)
        if tile.failed < _TRIES:
            return
        crop = f"{unit.x},{unit.y},{unit.width},{unit.height}"
        first, last = int(np.min(unit.begun)), int(np.max(unit.targets))
        scene = (self._picture.source or {}).get("path") or "SCENE"
        told = (
            f"samples {first} to {last - 1} of the pixels {crop} (x, y, width, height) failed"
            f" {_TRIES} times: {failed.why}; `parhelion render {shlex.quote(scene)} --crop {crop}"
            f" --spp {last}` with the picture's other options tries them here"
        )
        self.failures = (*self.failures, told)

    def _features_of(self, tile: _Tile) -> bytes:
        """What the film has seen in a tile."""
        height, width = self._counts.shape
        values = self._film.memory()[1]
        rows = values.reshape(height, width, values.size // (height * width))
        return bytes(np.ascontiguousarray(rows[tile.at]).data)

    def _drop(self) -> None:
        """Ends what is under way."""
        self._dispatcher.drop()
        self._under_way.clear()


def unit_seconds(left: float, had: float, tiles: int, workers: int, cost: float) -> float:
    """Seconds that the next unit should take. left: that all units to come take together; had: that
    its tile has had; cost: that each keeps the process which hands them out.
    """
    shortest = max(_SHORTEST, workers * cost / _BUSY)
    first_round = max(_FIRST_ROUND, _SHORT**2 * workers / max(left, 1e-9))
    even = max(first_round * workers / tiles, (_GROWTH - 1.0) * had)
    return max(shortest, min(UNIT_SECONDS, left / (_LAST * workers), even))


def even_part(left: int, about: float) -> int:
    """Samples of a pixel that its next unit takes, of those that are left: parts of about a size,
    none of which is a small rest, as each unit costs something.
    """
    return math.ceil(left / max(1, round(left / max(about, 1.0))))


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
    """The tiles of a film: large ones, if there are enough of them for all workers. In an order
    whose first few lie all over the picture, as they tell how long those to come will take.
    """
    edge = EDGE
    while edge > _LEAST_EDGE and (film.width * film.height) / edge**2 < TILES * workers:
        edge //= 2
    # as they lie in the whole picture, whose pixels may share paths (reuse_paths)
    sides = [
        [
            (max(0, at), min(at + edge, size) - max(0, at))
            for at in range(-(first % edge), size, edge)
        ]
        for first, size in ((film.x, film.width), (film.y, film.height))
    ]
    tiles = [_Tile(x, y, width, height) for y, height in sides[1] for x, width in sides[0]]
    order = sorted(range(len(tiles)), key=lambda i: i * _GOLDEN % 1.0)
    return [tiles[i] for i in order]


def _shortened(counts: NDArray[np.uint32]) -> Any:
    """A number for all, if they are the same."""
    first = int(counts.flat[0])
    return first if (counts == first).all() else counts
