"""Noise taken out of pictures by Intel's Open Image Denoise, the extra `denoise`.

A. T. Afra, "Intel Open Image Denoise", openimagedenoise.org: a network that is trained on rendered
pictures, guided by what the first surfaces look like.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import cache
from threading import Lock, Thread
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import arguments, machine, memory
from .errors import ResourceError, SceneError, unknown_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

log = logging.getLogger("parhelion")

QUALITIES = ("high", "balanced", "fast")

# Of the guides' own noise; "high" takes three times as long, and the picture's error is 2 % less
_PREFILTER = "fast"

# Bytes that it takes for a pixel, measured with guides, and what helps where there are fewer
_PIXEL_BYTES = 860
_SMALLER = "a smaller picture takes less"

# Edge in pixels of a picture that tells how fast it is, and seconds between two looks at signals
_TRIAL, _TICK = 192, 0.05

# Called with the share that is done; what it returns, if true, ends the work
ProgressCallback: TypeAlias = Callable[[float], Any]

# The function of Open Image Denoise that has others watch, and cancel, a filter
_WATCH = """void oidnSetFilterProgressMonitorFunction(
    OIDNFilter filter, OIDNProgressMonitorFunction function, void *user);"""

# Seconds after a picture in which the library's threads go to sleep, one after the other by a lock.
# A process that is forked meanwhile may have it locked by a thread that it has not, for ever.
_SETTLES = 0.1

# What a picture's own noisy light is called among its features
NOISY = "noisy"


def check_denoiser() -> None:
    """Raises ResourceError where there is no Open Image Denoise."""
    try:
        import pyoidn  # noqa: F401
    except (ImportError, OSError) as error:
        raise ResourceError(
            'denoising needs Open Image Denoise: pip install "parhelion[denoise]"'
            + ("" if isinstance(error, ImportError) else f" ({error})")
        ) from error


@memory.told
def denoised(
    light: NDArray[Any],
    albedo: NDArray[Any] | None = None,
    normal: NDArray[Any] | None = None,
    *,
    quality: str = "high",
    prefilter: bool = True,
    progress: ProgressCallback | None = None,
) -> NDArray[np.float32]:
    """Linear light, (H, W, 3), without its noise.

    albedo, normal: of the first surfaces, (H, W, 3), 0 where there is none, in [0, 1] and [-1, 1];
    they keep edges and textures sharp. A normal needs an albedo too. prefilter: their own noise is
    taken out first, which takes as long again for each; without it, what they have stays in the
    picture. quality: "high", "balanced" or "fast". progress: a function that is called with the
    share that is done, 0 to 1, some times a second; what it returns, if true, ends the work at once
    with Stopped, as Ctrl-C does with KeyboardInterrupt; the processor is free somewhat later.

    What is not finite, or below 0, counts as black; finite() tells how much there is. What is
    needed between calls is kept for the next picture of the same size. A fork soon after waits up
    to a tenth of a second, or denoising there could wait for ever; so it may in a process that is
    forked while a picture is denoised. Raises ResourceError without Open Image Denoise or where it
    fails, SceneError for arrays that do not fit together.
    """
    if quality not in QUALITIES:
        raise SceneError(unknown_name("quality", quality, QUALITIES))
    arguments.flag("prefilter", prefilter)
    if progress is not None and not callable(progress):
        raise SceneError(f"progress is {progress!r}; must be a function or None")
    if normal is not None and albedo is None:
        raise SceneError("denoise: a normal needs an albedo too")
    shape = np.shape(light)
    if len(shape) != 3 or shape[2] != 3 or 0 in shape:
        raise SceneError(f"denoise: light of shape (height, width, 3) is needed, not {shape}")
    guides = {"albedo": albedo, "normal": normal}
    for name, guide in guides.items():
        if guide is not None and np.shape(guide) != shape:
            raise SceneError(f"denoise: {name} has shape {np.shape(guide)}, light {shape}")
    check_denoiser()
    check_memory(shape[1], shape[0])
    worker = _worker(os.getpid())
    with worker.lock:
        return worker.waited(lambda: worker.run(light, guides, quality, prefilter), progress)


def check_memory(width: int, height: int, besides: int = 0) -> None:
    """Raises ResourceError where a picture of that size cannot be denoised.

    besides: bytes that will be taken by then.
    """
    needed = _PIXEL_BYTES * width * height + besides
    memory.require(needed, f"denoising {width}x{height} pixels", _SMALLER)


def seconds_for(pixels: int) -> float:
    """Seconds that denoised(), with guides and as it is left, will take for so many pixels.

    By a small picture that is denoised for that, so that it tells of this machine and of what else
    it does. Raises as denoised() does.
    """
    guide = np.full((_TRIAL, _TRIAL, 3), 0.5, np.float32)
    denoised(guide[:1, :1], guide[:1, :1], guide[:1, :1])  # loads the networks
    start = time.perf_counter()
    denoised(guide, guide, guide)
    return (time.perf_counter() - start) * max(1.0, pixels / _TRIAL**2)


def finite(light: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Light with black pixels in the place of those that are not finite, and how many they are."""
    bad = ~np.isfinite(light).all(axis=-1)
    count = int(bad.sum())
    return (np.where(bad[..., None], np.float32(0), light) if count else light), count


def guides_of(
    features: Mapping[str, NDArray[Any]],
) -> tuple[NDArray[np.float32], NDArray[np.float32]] | tuple[None, None]:
    """Albedo and normal, as denoised() takes them, of a picture's features; None if they lack."""
    names = ("albedo", "shading_normal", "coverage")
    if any(name not in features for name in names):
        return None, None
    albedo, normal, coverage = (np.asarray(features[name], np.float32) for name in names)
    # a mean over samples that hit something: at edges it has steps that the picture has not
    normal = normal * coverage.reshape(*coverage.shape[:2], 1)
    return finite(albedo)[0], finite(normal)[0]


def without_guides(features: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Those that tell of noise, of a picture that was to have no others."""
    kept = (NOISY, "error", "samples", "variance")
    return {name: features[name] for name in kept if name in features}


def told(light: NDArray[Any], where: str) -> NDArray[Any]:
    """finite(), with a warning where pixels are not."""
    clean, count = finite(light)
    if count:
        log.warning("%s: %d pixels are not finite and count as black", where, count)
    return clean


def version() -> str:
    """Of the library, for a file's metadata."""
    from importlib.metadata import version as of

    return f"Open Image Denoise (pyoidn {of('pyoidn')})"


class Stopped(Exception):
    """Whoever was told of the progress has asked to end it."""


class _Worker:
    """A device, and filters with their pictures, which are kept for the next run."""

    def __init__(self) -> None:
        import pyoidn
        from pyoidn import capi

        self.lock = Lock()
        self.ended = -_SETTLES  # when a filter last did, by the clock of time.monotonic()
        self._thread: Thread | None = None
        self._oidn = pyoidn
        self._share, self._runs, self._stop = 0.0, (0, 1), False
        capi.oidn_ffi.cdef(_WATCH, override=True)  # pyoidn leaves it out
        self._watch = capi.oidn_Capi.oidnSetFilterProgressMonitorFunction
        self._nobody = capi.oidn_ffi.NULL
        self._watcher = capi.oidn_ffi.callback("bool(void *, double)", self._goes_on)
        self._device = pyoidn.Device()
        # threads that stay on one core each would keep a render's away from there
        self._device.set_bool("setAffinity", False)
        self._device.set_int("numThreads", machine.cores_available())
        self._device.commit()
        self._check()
        self._filters: dict[tuple[str, ...], Any] = {}
        self._pictures: dict[str, NDArray[np.float32]] = {}

    def waited(
        self, run: Callable[[], NDArray[np.float32]], progress: ProgressCallback | None
    ) -> NDArray[np.float32]:
        """What run() returns in a thread of its own, while this one tells of it and hears signals.

        Ended early, it does not wait for the library, which looks up ten times in a picture's time.
        """
        if self._thread is not None:
            self._thread.join()
        self._share, self._stop = 0.0, False
        done: Future[NDArray[np.float32]] = Future()

        def work() -> None:
            try:
                done.set_result(run())
            except BaseException as error:
                done.set_exception(error)

        self._thread = Thread(target=work, name="denoising")
        try:
            self._thread.start()
            while not done.done():
                if progress is not None and progress(self._share):
                    raise Stopped
                self._thread.join(_TICK)
            result = done.result()
            if progress is not None and progress(1.0):  # small pictures are done before a tick
                raise Stopped
        except BaseException:
            self._stop = True
            raise
        return result

    def settle(self) -> None:
        """Waits until the threads of a run that has ended are asleep."""
        time.sleep(max(0.0, self.ended + _SETTLES - time.monotonic()))

    def run(
        self,
        light: NDArray[Any],
        guides: Mapping[str, NDArray[Any] | None],
        quality: str,
        prefilter: bool,
    ) -> NDArray[np.float32]:
        given = {"color": light, **{k: v for k, v in guides.items() if v is not None}}
        if any(p.shape != light.shape for p in self._pictures.values()):
            self._forget()
        for name, values in given.items():
            self._picture(name, light.shape)[...] = values
        np.maximum(self._pictures["color"], 0, out=self._pictures["color"])
        self._picture("output", light.shape)
        try:
            cleaned = sorted(given.keys() - {"color"}) if prefilter else []
            for done, name in enumerate(cleaned):
                self._runs = done, len(cleaned) + 1
                self._execute((name,), name, _PREFILTER, {})
            self._runs = len(cleaned), len(cleaned) + 1
            numbers = {"hdr": True, "cleanAux": prefilter and len(given) > 1}
            self._execute(tuple(given), "output", quality, numbers)
        except (ResourceError, Stopped):
            self._forget()
            raise
        return np.array(self._pictures["output"])

    def _goes_on(self, _: Any, share: float) -> bool:
        """What the library calls with the share of one run of a filter."""
        before, count = self._runs
        self._share = (before + share) / count
        return not self._stop

    def _picture(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        if name not in self._pictures:
            self._pictures[name] = np.zeros(shape, np.float32)
        return self._pictures[name]

    def _execute(
        self, names: tuple[str, ...], output: str, quality: str, numbers: Mapping[str, bool]
    ) -> None:
        made = self._filters.get(names)
        if made is None:
            made = self._oidn.Filter(self._device, self._oidn.OIDN_FILTER_TYPE_RT)
            self._filters[names] = made
            for name in names:
                made.set_image(name, self._pictures[name], self._oidn.OIDN_FORMAT_FLOAT3)
            self._watch(made._filter, self._watcher, self._nobody)
            made.set_image("output", self._pictures[output], self._oidn.OIDN_FORMAT_FLOAT3)
        for name, value in numbers.items():
            made.set_bool(name, value)
        made.set_quality(getattr(self._oidn, f"OIDN_QUALITY_{quality.upper()}"))
        made.commit()
        self._check()
        made.execute()
        self.ended = time.monotonic()
        if self._stop:
            self._device.get_error()  # that it was cancelled
            raise Stopped
        self._check()

    def _forget(self) -> None:
        for made in self._filters.values():
            made.release()
        self._filters.clear()
        self._pictures.clear()

    def _check(self) -> None:
        reason = self._device.get_error()
        if reason is not None:
            raise ResourceError(f"Open Image Denoise failed: {reason}")


@cache
def _worker(_process: int) -> _Worker:
    """One for each process: its threads do not survive a fork."""
    worker = _Worker()
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=worker.settle)
    return worker
