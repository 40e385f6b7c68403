"""Noise taken out of pictures by Intel's Open Image Denoise, the extra `denoise`.

A. T. Afra, "Intel Open Image Denoise", openimagedenoise.org: a network that is trained on rendered
pictures, guided by what the first surfaces look like.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from functools import cache
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from . import machine, memory
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


def denoised(
    light: NDArray[Any],
    albedo: NDArray[Any] | None = None,
    normal: NDArray[Any] | None = None,
    *,
    quality: str = "high",
    prefilter: bool = True,
) -> NDArray[np.float32]:
    """Linear light, (H, W, 3), without its noise.

    albedo, normal: of the first surfaces, (H, W, 3), 0 where there is none, in [0, 1] and [-1, 1];
    they keep edges and textures sharp. A normal needs an albedo too. prefilter: their own noise is
    taken out first, which takes as long again for each; without it, what they have stays in the
    picture. quality: "high", "balanced" or "fast".

    What is not finite, or below 0, counts as black; finite() tells how much there is. What is
    needed between calls is kept for the next picture of the same size. Raises ResourceError without
    Open Image Denoise or where it fails, SceneError for arrays that do not fit together.
    """
    if quality not in QUALITIES:
        raise SceneError(unknown_name("quality", quality, QUALITIES))
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
    memory.require(
        _PIXEL_BYTES * shape[0] * shape[1], f"denoising {shape[1]}x{shape[0]} pixels", _SMALLER
    )
    worker = _worker(os.getpid())
    with worker.lock:
        return worker.run(light, guides, quality, prefilter)


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


class _Worker:
    """A device, and filters with their pictures, which are kept for the next run."""

    def __init__(self) -> None:
        import pyoidn

        self.lock = Lock()
        self._oidn = pyoidn
        self._device = pyoidn.Device()
        # threads that stay on one core each would keep a render's away from there
        self._device.set_bool("setAffinity", False)
        self._device.set_int("numThreads", machine.cores_available())
        self._device.commit()
        self._check()
        self._filters: dict[tuple[str, ...], Any] = {}
        self._pictures: dict[str, NDArray[np.float32]] = {}

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
            if prefilter:
                for name in given.keys() - {"color"}:
                    self._execute((name,), name, _PREFILTER, {})
            numbers = {"hdr": True, "cleanAux": prefilter and len(given) > 1}
            self._execute(tuple(given), "output", quality, numbers)
        except ResourceError:
            self._forget()
            raise
        return np.array(self._pictures["output"])

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
            made.set_image("output", self._pictures[output], self._oidn.OIDN_FORMAT_FLOAT3)
        for name, value in numbers.items():
            made.set_bool(name, value)
        made.set_quality(getattr(self._oidn, f"OIDN_QUALITY_{quality.upper()}"))
        made.commit()
        self._check()
        made.execute()
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
    return _Worker()
