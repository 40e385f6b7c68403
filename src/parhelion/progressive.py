"""Sampling in rounds: until every pixel has its samples, the noise is low enough or time is up.

What a pixel shows is a function of how many samples it has. How many it gets is decided between
rounds, from sums that are the same on every machine: so are the decisions, and a rendering that was
killed and resumed ends with the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from .progress import Crew, Progress, ProgressCallback

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Told of samples and rays so far; true stops the work.
Tick = Callable[[int, int], bool]

# Seconds that one pass over the picture should take: it can be stopped in between, and each makes
# the whole picture a little better.
PASS_SECONDS = 0.25

# Standard errors on either side of the truth within which 95 of 100 means of many samples lie.
CONFIDENCE = 1.96

# Samples per pixel before anybody asks for noise: what shows none by then gets no more, so this has
# to be more than a glance.
FIRST_ROUND = 16

# Tiles that each thread should find, at least, so that all end at about the same time.
_TILES = 8

# Samples per pixel where the noise or the time alone is to end it: more than anybody waits for, and
# the film's sums have room for them.
MOST_SAMPLES = 1 << 24


@dataclass(frozen=True, eq=False)
class Goal:
    """When to stop, whichever is first. spp: samples per pixel. noise: what no cell's error may be
    above, or None. deadline: as of time.perf_counter(), or None. counts: samples of each pixel,
    (H, W) uint32, in the place of spp and noise. blocks: which of the film's are rendered, (blocks
    down, blocks across) bool, None for all; their noise cannot be told without the others.
    """

    spp: int
    noise: float | None = None
    deadline: float | None = None
    counts: NDArray[np.uint32] | None = None
    blocks: NDArray[np.bool_] | None = None

    @property
    def first_round(self) -> int:
        """Samples per pixel before the noise is looked at."""
        return self.spp if self.noise is None else min(FIRST_ROUND, self.spp)


@dataclass(frozen=True)
class Work:
    """How samples are taken; the picture does not depend on it."""

    threads: int
    tile: int
    schedule: str
    isa: str


class Sampler(Protocol):
    """What takes samples: the cores of this machine, or others."""

    # Whether a pass may be all there is to do: it can be stopped, and its film be read, meanwhile.
    at_once: bool
    # What it could not do, for people; take() has returned False then.
    failures: Sequence[str]

    @property
    def crew(self) -> Crew | None:
        """The workers of a cluster."""

    @property
    def threads(self) -> int:
        """How many take part."""

    @property
    def isa(self) -> str:
        """The instruction set they use."""

    def take(
        self, film: Any, targets: NDArray[np.uint32], pixels: int, tick: Tick
    ) -> tuple[int, int, bool]:
        """Brings a film to some targets, as Film.render() does; see there. pixels: that have less.

        Returns samples and rays that were added, and False if tick stopped it.
        """


class Cores:
    """The cores of this machine."""

    at_once = False
    failures: Sequence[str] = ()
    crew = None

    def __init__(self, core: Any, view: Any, work: Work) -> None:
        self._core, self._view, self._work = core, view, work
        self.threads, self.isa = work.threads, work.isa

    def take(
        self, film: Any, targets: NDArray[np.uint32], pixels: int, tick: Tick
    ) -> tuple[int, int, bool]:
        """As Sampler says."""
        work, edge = self._work, self._work.tile
        while edge > 1 and edge * edge * _TILES * work.threads > pixels:  # few are left
            edge //= 2
        samples, rays, complete = film.render(
            self._core,
            self._view,
            targets,
            threads=work.threads,
            tile=edge,
            schedule=work.schedule,
            isa=work.isa,
            tick=tick,
        )
        return samples, rays, bool(complete)


@dataclass
class Spent:
    """What a rendering took so far; seconds of the wall clock."""

    samples: int = 0
    rays: int = 0
    seconds: float = 0.0


class Rendering:
    """A film on its way to a goal.

    done, targets: samples per pixel that each cell of the film has, and is to have before the next
    decision, uint32; of each pixel, if the goal is. spent: what it took. A resumed one begins with
    what these were. error: of the picture, by the last look at it; None before.
    """

    def __init__(self, film: Any, goal: Goal, sampler: Sampler) -> None:
        self.film, self.goal, self._sampler = film, goal, sampler
        if goal.counts is None:
            self.areas = cell_areas(film)
            if goal.blocks is not None:
                self.areas *= np.repeat(goal.blocks, 2, axis=0)
            self.targets = np.zeros(self.areas.shape, np.uint32)
            self._aim(goal.first_round)
        else:
            self.areas = np.ones(goal.counts.shape, np.int64)
            self.targets = goal.counts
        self.done = np.zeros_like(self.targets)
        self.spent = Spent()
        self.error: float | None = None
        each = goal.spp if goal.counts is None else goal.counts
        self._expected = float((self.areas * each).sum())  # samples in all
        self._report: ProgressCallback | None = None
        self._save: Callable[[], None] | None = None
        self._interval = self._next_save = 0.0
        self._ended: str | None = None

    def save_every(self, seconds: float, save: Callable[[], None]) -> None:
        """Has `save` called now and then, when the film stands still and can be read."""
        self._save, self._interval = save, seconds
        self._next_save = time.perf_counter() + seconds

    def run(self, report: ProgressCallback | None) -> str:
        """Samples until the goal is reached, and returns what ended it: "spp", "noise", "time",
        "stopped", when the report returned something true, or "failed".
        """
        goal, self._report, self._ended = self.goal, report, None
        if goal.counts is None:  # a resumed one may have another goal than it began with
            self._aim(goal.spp)
        watched = bool(report or self._save or goal.deadline is not None)
        size = 1 if watched and not self._sampler.at_once else goal.spp
        while self._ended is None:
            while (self.done < self.targets).any() and self._ended is None:
                before = time.perf_counter()
                aims = np.minimum(self.targets, self.done + np.uint32(size))
                if self._pass(aims):
                    self.done, seconds = np.maximum(self.done, aims), time.perf_counter() - before
                    if not self._sampler.at_once:
                        fitting = max(1, int(size * PASS_SECONDS / max(seconds, 1e-6)))
                        size = min(fitting, 8 * size, goal.spp)
                if self._sampler.failures:
                    self._ended = "failed"
                if self._save is not None and time.perf_counter() >= self._next_save:
                    self._save()
                    self._next_save = time.perf_counter() + self._interval
            if goal.noise is None:
                self._ended = self._ended or "spp"
            else:
                self._look(goal.noise)
        return self._ended

    def _aim(self, most: int) -> None:
        """Sets targets at which the next decision can be made, none above `most`."""
        targets = np.clip(self.targets, self.goal.first_round, most).astype(np.uint32)
        if self.goal.blocks is not None:
            targets *= np.repeat(self.goal.blocks, 2, axis=0)
        self.targets = targets

    def _look(self, noise: float) -> None:
        """Tells the error, and sets new targets or, where nothing is left to do, ends it."""
        errors = errors_by_others(self.film.errors(), self.targets)
        self.error = picture_error(self.film)
        more = (errors > noise) & (self.targets < self.goal.spp)
        if self._ended is not None:
            return
        if not more.any():
            self._ended = "noise" if (errors <= noise).all() else "spp"
            return
        needed = np.where(more, self.targets * (errors / noise) ** 2, self.targets)
        self._expected = float((np.minimum(needed, self.goal.spp) * self.areas).sum())
        self.targets[more] = np.minimum(next_round(self.targets[more]), self.goal.spp)

    def _pass(self, targets: NDArray[np.uint32]) -> bool:
        """Brings the film to some targets; False if that was broken off."""
        start, before = time.perf_counter(), self.spent
        pixels = int(self.areas[targets > self.done].sum())

        def tick(samples: int, rays: int) -> bool:
            now = time.perf_counter()
            self.spent = Spent(
                before.samples + samples, before.rays + rays, before.seconds + now - start
            )
            if self._ended is None and self._report is not None:
                spent = self.spent
                expected = max(int(self._expected), spent.samples)
                left = None if self.goal.deadline is None else max(0.0, self.goal.deadline - now)
                state = Progress(
                    spent.samples,
                    expected,
                    spent.rays,
                    spent.seconds,
                    self.error,
                    left,
                    self._sampler.crew,
                )
                if self._report(state):
                    self._ended = "stopped"
            if self._ended is None and self.goal.deadline is not None and now > self.goal.deadline:
                self._ended = "time"
            due = self._save is not None and now >= self._next_save
            if due and self._sampler.at_once and self._save is not None:
                self._save()  # what is under way elsewhere goes on meanwhile
                self._next_save = time.perf_counter() + self._interval
                due = False
            return self._ended is not None or due

        samples, rays, complete = self._sampler.take(self.film, targets, pixels, tick)
        tick(samples, rays)
        return complete


def next_round(samples: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Samples per pixel after which the noise is looked at again: 16, 24, 32, 48, 64, 96, ..., by
    which no cell gets more than half as many again as it needs.
    """
    power = np.uint32(1) << (np.frexp(samples)[1] - 1).astype(np.uint32)  # the largest in it
    half = power + power // 2
    following: NDArray[np.uint32] = np.maximum(
        samples + np.uint32(1), np.where(samples < half, half, np.uint32(2) * power)
    )
    return following


def cell_areas(film: Any) -> NDArray[np.int64]:
    """Pixels in each cell of a film, (cells down, cells across): the even rows of blocks, and the
    odd ones, in turn.
    """
    from . import _core

    heights, widths = (
        np.minimum(_core.block, side - np.arange(0, side, _core.block))
        for side in (film.height, film.width)
    )
    rows = np.stack([(heights + 1) // 2, heights // 2], axis=1).reshape(-1)
    areas: NDArray[np.int64] = np.outer(rows, widths)
    return areas


def errors_by_others(
    squares: NDArray[np.float64], counts: NDArray[np.uint32]
) -> NDArray[np.float64]:
    """How far the pixels of each cell may be from what infinitely many samples would show, as those
    tell it that are like them: the other rows of the block.

    squares: mean squares of the standard errors, as Film.errors(); counts: samples per pixel, both
    (cells down, cells across). Within 95 % confidence, as a share of a pixel's brightness. Where it
    is more, those rows of the block and of the eight around it together tell: they know what the
    few pixels of one may not have seen yet, such as the rare and bright.

    A mean whose own samples decide when there are enough of them ends too low, for it ends where
    the bright ones have not come (D. Kirk, J. Arvo, "Unbiased sampling techniques for image
    synthesis", SIGGRAPH 1991); so a cell's own samples have no say here.
    """
    down, across = squares.shape
    own = counts.reshape(down // 2, 2, across)
    others = np.pad(squares.reshape(own.shape)[:, ::-1], [(1, 1), (0, 0), (1, 1)], mode="edge")
    theirs = np.pad(own[:, ::-1], [(1, 1), (0, 0), (1, 1)], mode="edge")
    around = np.zeros(own.shape)
    for i in range(3):
        for j in range(3):
            at = np.s_[i : i + down // 2, :, j : j + across]
            # with more samples than they have, it is nearer to the truth than they are
            told = others[at] * np.minimum(theirs[at] / own, 1.0)
            around += told / 9
            if i == j == 1:
                beside = told
    errors: NDArray[np.float64] = CONFIDENCE * np.sqrt(np.maximum(beside, around))
    return errors.reshape(down, across)


def block_errors(film: Any) -> NDArray[np.float64]:
    """How far the pixels of each block may be from the truth, by its own samples and, where these
    tell less, by those of the eight around it too; otherwise as errors_by_others().

    (blocks down, blocks across).
    """
    areas = cell_areas(film)
    down, across = areas.shape
    by_rows = (down // 2, 2, across)
    own = _weighted(film, areas).reshape(by_rows).sum(axis=1)
    own /= areas.reshape(by_rows).sum(axis=1)
    padded = np.pad(own, 1, mode="edge")
    around = sum(padded[i : i + down // 2, j : j + across] for i in range(3) for j in range(3)) / 9
    errors: NDArray[np.float64] = CONFIDENCE * np.sqrt(np.maximum(own, around))
    return errors


def picture_error(film: Any) -> float:
    """The root mean square of block_errors() without the surroundings, over all pixels."""
    areas = cell_areas(film)
    return float(CONFIDENCE * np.sqrt(_weighted(film, areas).sum() / areas.sum()))


def _weighted(film: Any, areas: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean squared errors times areas; cells without pixels have none, not even an infinite one."""
    told = film.errors()
    weighted: NDArray[np.float64] = np.multiply(told, areas, np.zeros_like(told), where=areas > 0)
    return weighted
