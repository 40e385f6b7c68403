"""Whether it pays that pixels of a picture use each other's paths (Settings.reuse_paths)."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from math import inf, isfinite, isqrt
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .progressive import Work
    from .scene import Settings

log = logging.getLogger("parhelion")

# Squares of a picture below which looking at some would cost more than it may save
_FEWEST = 32
# Squares that are looked at, at least and at most, twice as many where these do not agree, and
# samples of each of their pixels
_LEAST, _MOST, _SAMPLES = 2, 24, 4
# Of two pictures whose difference tells the noise; whatever seed the picture itself has, so that
# pictures of other seeds are of one kind
_SEEDS = (0x5EED1, 0x5EED2)
# As a share of the mean, the brightness below which pixels count as that bright
_DARK = 0.02
# Noise times rays, over those without sharing, has to be below this
_GAIN = 0.95
# Multiples of one over the plastic number, and of its square, lie evenly in the unit square
_PLASTIC = 1.32471795724474602596


@dataclass(frozen=True)
class Look:
    """What sharing paths does to a picture: its noise, a square, and its rays, over those without,
    at as many samples.
    """

    noise: float
    rays: float

    @property
    def pays(self) -> bool:
        """Whether there is clearly less noise for as many rays. A ray takes 0.8 to 1.35 times as
        long as without: the most where nothing can be shared, as among mirrors.
        """
        return self.noise * self.rays < _GAIN


def pays(core: Any, view: Any, settings: Settings, work: Work) -> bool:
    """Whether it pays that a picture's pixels share their paths: see look()."""
    if samples(settings) == 0:
        return False
    found = look(core, view, settings, work)
    return found is not None and found.pays


def samples(settings: Settings) -> int:
    """How many look() takes of a picture at most; none where it would cost more than it may save,
    or where nothing can be shared.
    """
    from . import _core

    across, down = settings.width // _core.region, settings.height // _core.region
    if across * down < _FEWEST or settings.integrator != "path" or settings.max_depth < 3:
        return 0
    return 2 * len(_SEEDS) * len(squares(across, down)) * _core.region**2 * _SAMPLES


def look(core: Any, view: Any, settings: Settings, work: Work, tick: Any = None) -> Look | None:
    """Some squares of the whole picture, whatever its crop is, both ways with few samples.

    The answer depends on the scene, its camera and the settings alone, of which seed and number of
    samples do not matter. view: the core's, of settings, of which samples() tells that there is
    something to look at. tick: see Film.render; None if it stopped it.
    """
    from . import _core

    places = squares(settings.width // _core.region, settings.height // _core.region)
    half = len(places) // 2
    found = _both_ways(core, view, places[:half], work, tick)
    if found is not None and not _agree(*found):
        first, found = found, _both_ways(core, view, places[half:], work, tick)
        if found is not None:
            found = np.concatenate([first[0], found[0]], axis=2), first[1] + found[1]
    if found is None:
        return None
    answer = _look_of(noise(found[0]), found[1])
    log.debug("shared paths: of %d squares %s", found[0].shape[2], answer)
    return answer


def _both_ways(
    core: Any, view: Any, places: list[tuple[int, int]], work: Work, tick: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Without shared paths and with them: (2, seeds, squares, pixels, 3) and (2,), rays."""
    from . import _core

    pictures, rays = [], []
    for shared in (False, True):
        views = [view.but(seed, shared) for seed in _SEEDS]
        films = [(_square(*place), view) for view in views for place in places]
        _, traced, complete = _core.render_films(
            core,
            films,
            _SAMPLES,
            threads=work.threads,
            tile=_core.region,
            schedule=work.schedule,
            isa=work.isa,
            tick=tick,
        )
        if not complete:
            return None
        pictures.append([film.arrays()[0] for film, _ in films])
        rays.append(traced)
    shape = (2, len(_SEEDS), len(places), _core.region**2, 3)
    return np.array(pictures, np.float64).reshape(shape), np.array(rays, np.float64)


def _agree(pictures: NDArray[np.float64], rays: NDArray[np.float64]) -> bool:
    """Whether the answer would be the same without any one of the squares."""
    errors = noise(pictures)
    pays = _look_of(errors, rays).pays
    rest = (np.delete(errors, i, axis=1) for i in range(errors.shape[1]))
    return all(_look_of(some, rays).pays is pays for some in rest)


def _look_of(errors: NDArray[np.float64], rays: NDArray[np.float64]) -> Look:
    """errors: (2, squares), noise(); rays: (2,)."""
    alone, shared = errors.sum(axis=1)
    # where there is no noise there is nothing to gain
    told = alone > 0 and isfinite(shared)
    return Look(float(shared / alone) if told else inf, float(rays[1] / rays[0]))


def squares(across: int, down: int) -> list[tuple[int, int]]:
    """Which of so many squares are looked at: (column, row). Each half of them is spread all over
    the picture; the second is for where the first is not clear.
    """
    count = 2 * min(max(isqrt(across * down) // 3, _LEAST), _MOST)
    found: dict[tuple[int, int], None] = {}
    i = 0
    while len(found) < count:
        u, v = (0.5 + i / _PLASTIC) % 1.0, (0.5 + i / _PLASTIC**2) % 1.0
        found[int(u * across), int(v * down)] = None
        i += 1
    return list(found)


def noise(pictures: NDArray[np.float64]) -> NDArray[np.float64]:
    """How noisy each of some ways to render is: (ways, squares), squared differences of two
    pictures relative to the brightness.

    pictures: (ways, 2, squares, pixels, 3), with two seeds. The worst pixel of each square is left
    out: single bright ones tell nothing about the others.
    """
    bright = pictures.mean(axis=(0, 1, 4))
    scale = bright**2 + (_DARK * bright.mean()) ** 2
    differences = ((pictures[:, 0] - pictures[:, 1]) ** 2).sum(axis=-1)
    errors = np.divide(differences, scale, np.zeros_like(differences), where=scale > 0)
    errors.sort(axis=-1)
    of_squares: NDArray[np.float64] = errors[..., :-1].sum(axis=2)
    return of_squares


def _square(column: int, row: int) -> Any:
    from . import _core

    edge: int = _core.region
    return _core.Film(edge * column, edge * row, edge, edge)
