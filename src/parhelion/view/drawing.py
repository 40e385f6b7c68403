"""A picture that is under way, and what is shown of it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import memory, sharing
from ..flatten import Flat
from ..progressive import Work, block_errors, picture_error
from ..renderer import ERROR_BYTES, FEATURE_BYTES, PIXEL_BYTES, merged, surface_features
from ..scene import Camera, Settings, Vec3
from .stage import Stage, add_samples, triple

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Seconds that a pass may take: in the beginning, and later, when pictures change less.
SHORTEST_PASS, LONGEST_PASS = 0.15, 1.5
# Seconds that a picture has been rendered for when it is found out whether its pixels shall share
# their paths, and the share of its time that this may take.
LOOK_SECONDS, LOOK_SHARE = 0.5, 0.25
# A picture that would be larger than this share of the one asked for is not worth being made first.
ALMOST_WHOLE = 0.7
# About the least side of a coarse picture, in pixels.
_LEAST = 8
# Bytes a pixel beside what render() takes, measured with some room: pictures that are kept until
# the next one is there, colours and their packing; and of features.
SHOWN_BYTES, SHOWN_FEATURE_BYTES = 80, 160

Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True)
class Request:
    """What is to be rendered; revision counts them.

    crop: x, y, width, height as shares of the picture. asked: when, by the clock of perf_counter.
    """

    revision: int
    camera: Camera
    width: int
    height: int
    crop: Rectangle | None
    features: bool
    asked: float


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture as far as it has come.

    number: counts frames. revision: of the request that it answers. pixels: (H, W, 3) linear light
    of the part x, y, W, H of a picture of width x height pixels. scale: 1 for the size that was
    asked for, below for a coarse one. spp: samples in each pixel, some may have more. seconds: of
    rendering it. latency: from the request to this picture. error: as RenderStats.error, and
    block_errors of blocks of 8x8 pixels; None for coarse ones and where samples are too few. flat:
    what is seen, in which the objects that are hidden, names by indices, are made of nothing.
    """

    number: int
    revision: int
    pixels: NDArray[np.float32]
    counts: NDArray[np.uint32]
    features: Mapping[str, NDArray[Any]]
    x: int
    y: int
    width: int
    height: int
    scale: float
    spp: int
    seconds: float
    latency: float
    samples: int
    rays: int
    camera: Camera
    settings: Settings
    flat: Flat
    hidden: Mapping[int, str]
    build_seconds: float
    error: float | None
    block_errors: NDArray[np.float64] | None

    @property
    def rate(self) -> float:
        """Samples a second."""
        return self.samples / max(self.seconds, 1e-9)

    def value(self, x: float, y: float) -> Vec3 | None:
        """Linear RGB at a place, in shares of the whole picture; None beside this part of it."""
        column, row = int(x * self.width) - self.x, int(y * self.height) - self.y
        height, width = self.pixels.shape[:2]
        if not (0 <= column < width and 0 <= row < height):
            return None
        return triple(self.pixels[row, column])


@dataclass
class Drawing:
    """A request's picture under way, made by draw(). failed: it cannot be made; the old one stays.

    scale: of its size; 1 for the size that was asked for. shared: whether pixels share their paths
    where the settings leave that open: a guess until `looked`. first: of this request. seen: it has
    been shown in the size that was asked for. done: samples that each pixel has. shown_from: of
    them, so that it is better than what is shown; withheld: until then. size: samples a pixel of
    the next pass. workers: of a cluster that goes on with it.
    """

    request: Request
    scale: float
    shared: bool = False
    looked: bool = True
    first: bool = True
    failed: bool = False
    film: Any = None
    view: Any = None
    settings: Settings | None = None
    place: tuple[int, int, int, int] = (0, 0, 0, 0)
    done: int = 0
    seen: bool = False
    shown_from: int = 0
    withheld: bool = False
    size: int = 1
    seconds: float = 0.0
    samples: int = 0
    rays: int = 0
    workers: Any = None

    @property
    def whole(self) -> bool:
        """Whether it has the size that was asked for."""
        return self.scale == 1.0

    @property
    def coarsest(self) -> bool:
        """Whether there is no coarser one to take its place."""
        return self.place[2] * self.place[3] <= 2 * _LEAST**2

    def begin(self, stage: Stage) -> None:
        """Makes the film. Raises SceneError, and ResourceError if memory is too small."""
        request = self.request
        width = max(1, round(request.width * self.scale))
        height = max(1, round(request.height * self.scale))
        x, y, w, h = rectangle(request.crop or (0.0, 0.0, 1.0, 1.0), width, height)
        crop = None if request.crop is None else (x, y, w, h)
        wanted = merged(stage.settings, {"width": width, "height": height, "crop": crop})
        shared = wanted.reuse_paths is True
        if wanted.reuse_paths == "auto" and self.whole and sharing.samples(wanted) > 0:
            self.looked, shared = False, self.shared
        self.settings = replace(wanted, reuse_paths=shared)
        self.place = x, y, w, h
        self.view = stage.view(request.camera, self.settings)
        if self.whole:
            require(w, h, request.features)
        self._clear()

    def _clear(self) -> None:
        from .. import _core

        self.film = None  # there is no room for two
        self.film = _core.Film(*self.place, self.request.features, self.whole)

    def worth_a_look(self, at_once: bool) -> bool:
        """Whether it is time to find out if pixels shall share their paths."""
        if self.looked or self.done == 0 or self.settings is None:
            return False
        if at_once:
            return True
        takes = sharing.samples(self.settings) * self.seconds / self.samples
        return self.seconds > max(LOOK_SECONDS, takes / LOOK_SHARE)

    def find_out(self, stage: Stage, work: Work, tick: Any) -> None:
        """Whether they shall, and begins anew if it is not as was guessed; tick, which may stop it:
        see Film.render.
        """
        assert self.settings is not None
        found = sharing.look(stage.core, self.view, self.settings, work, tick)
        if found is None:
            return
        self.looked = True
        if found.pays is self.settings.reuse_paths:
            return
        self._clear()
        self.shared = found.pays
        self.settings = replace(self.settings, reuse_paths=found.pays)
        self.view = self.view.but(self.settings.seed, found.pays)
        self.shown_from = math.ceil(self.done * (found.noise if found.pays else 1 / found.noise))
        self.done, self.size = 0, 1
        self.seconds, self.samples, self.rays = 0.0, 0, 0

    def add(
        self, stage: Stage, spp: int, threads: int, tick: Any, began: float
    ) -> tuple[float, int, bool]:
        """Brings all pixels to so many samples; tick: see Film.render.

        Returns the seconds since it began, its samples, and whether it was not stopped.
        """
        samples, rays, complete = add_samples(self.film, stage.core, self.view, spp, threads, tick)
        seconds = time.perf_counter() - began
        memory.note_threads(threads)
        self.seconds += seconds
        self.samples += samples
        self.rays += rays
        if complete:
            self.first, self.done = False, spp
            wanted = min(max(0.25 * self.seconds, SHORTEST_PASS), LONGEST_PASS)
            self.size = max(1, min(4 * self.size, int(self.size * wanted / max(seconds, 1e-6))))
        return seconds, samples, complete

    def finer(self) -> Drawing:
        """The picture that follows on a coarse one."""
        scale = 2.0 * self.scale
        scale = 1.0 if scale > ALMOST_WHOLE else scale
        return Drawing(self.request, scale, self.shared, first=False)

    def frame(self, number: int, stage: Stage) -> Frame:
        """The picture as far as it has come."""
        request = self.request
        pixels, counts, _bad = self.film.arrays()
        features: dict[str, Any] = {}
        if request.features:
            features = surface_features(self.film, stage.core.stats()["scale"], pixels)
        error, of_blocks = None, None
        if self.whole and self.done > 1:
            of_blocks = block_errors(self.film)
            error = picture_error(self.film)
        assert self.settings is not None
        return Frame(
            number=number,
            revision=request.revision,
            pixels=pixels,
            counts=counts,
            features=features,
            x=self.place[0],
            y=self.place[1],
            width=self.settings.width,
            height=self.settings.height,
            scale=self.scale,
            spp=self.done,
            seconds=self.seconds,
            latency=time.perf_counter() - request.asked,
            samples=self.samples,
            rays=self.rays,
            camera=request.camera,
            settings=self.settings,
            flat=stage.flat,
            hidden=stage.hidden,
            build_seconds=stage.prepared.seconds,
            error=error if error is not None and math.isfinite(error) else None,
            block_errors=of_blocks,
        )


def draw(request: Request, most: float, shared: bool) -> Drawing:
    """A request's first picture, as large as one of so many samples, one a pixel, may be.

    shared: see Drawing.
    """
    w, h = (request.crop or (0.0, 0.0, 1.0, 1.0))[2:]
    pixels = max(request.width * w * request.height * h, 1.0)
    scale = math.sqrt(most / pixels)
    scale = 1.0 if scale > ALMOST_WHOLE else max(scale, _LEAST / math.sqrt(pixels))
    return Drawing(request, scale, shared)


def rectangle(part: Rectangle, width: int, height: int) -> tuple[int, int, int, int]:
    """x, y, width, height in pixels of a part of a picture: all that it touches, at least one."""
    left, top, w, h = part
    x, y = min(int(left * width), width - 1), min(int(top * height), height - 1)
    right = min(max(math.ceil((left + w) * width - 1e-6), x + 1), width)
    bottom = min(max(math.ceil((top + h) * height - 1e-6), y + 1), height)
    return x, y, right - x, bottom - y


def require(width: int, height: int, features: bool, room: int = 0) -> None:
    """Raises ResourceError for a picture that is too large for memory of which so much is free and
    `room` bytes more.
    """
    each = PIXEL_BYTES + ERROR_BYTES + SHOWN_BYTES
    each += (FEATURE_BYTES + SHOWN_FEATURE_BYTES) * features
    what = f"looking at {width}x{height} pixels"
    memory.require(width * height * each - room, what, "a smaller window takes less")
