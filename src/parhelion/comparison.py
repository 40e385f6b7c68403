"""How far a picture is from another: errors in light, in what is seen, and by statistics.

Pixels that are not finite in one of the two are counted first and take no part in anything else.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from math import erfc, expm1, log1p, log10, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import arguments
from .denoise import NOISY
from .display import Display, srgb_encoded
from .errors import SceneError, option
from .flip import flip
from .image import Image

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Picture: TypeAlias = Image | str | os.PathLike[str] | ArrayLike

# In relMSE, this share of the reference's mean is added to each of its values, in squares: a black
# pixel would count without bound.
_FLOOR = 0.1
# Share of the worst pixels that the trimmed error leaves out: a few fireflies may be most of it
TRIM = 1e-3

# Wang et al. 2004, section III: a Gaussian window of 11x11, and the constants K1 and K2
_WINDOW, _SIGMA, _K1, _K2 = 5, 1.5, 0.01, 0.03

# Edge, in pixels, of the smallest blocks of which variances that a rendering has estimated for
# itself say enough, as each is made of three numbers
_ESTIMATED = 8

# Chance that the z-test finds a difference where there is none
SIGNIFICANCE = 0.01


@dataclass(frozen=True)
class BlockTest:
    """What a test of means in blocks of pixels found, of single pixels up to the whole picture.

    p: chance of what was found, or stronger, anywhere, if both pictures are right. size, block,
    channel: where it is strongest: edge of the block in pixels, its row and column in blocks.
    strongest: there, in standard errors. each: (rows, columns, channels), of the smallest blocks.
    """

    p: float
    size: int
    block: tuple[int, int]
    channel: int
    strongest: float
    each: NDArray[np.float64] = field(repr=False, compare=False)

    @property
    def agrees(self) -> bool:
        """Whether the pictures may be equal but for noise, at a significance of 1 %."""
        return self.p >= SIGNIFICANCE

    def __str__(self) -> str:
        y, x = (self.size * i for i in self.block)
        return (
            f"p = {self.p:.3g}; strongest in the block of {self.size} pixels at {x},{y}, channel"
            f" {self.channel}: {self.strongest:+.1f} standard errors"
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """A picture against a reference.

    mse: mean of squared differences of linear light, over pixels and channels; relmse: of each over
    r^2 + (0.1 m)^2, where r is the reference and m its mean; relmse_trimmed: without the worst
    pixel of a thousand. largest: difference of a channel. ratio: of the means, by channel.

    psnr, in dB, and ssim: of what is seen, sRGB from 0 to 1 at `exposure`. flip: mean of the
    differences that are seen when the two alternate; of linear light, at all exposures.

    not_finite: pixels of each that are not. test: the z-test, where variances were given.
    pictures, reference: (H, W, 3) linear, 0 where one is not finite; flip_map: (H, W), 0 to 1.
    """

    mse: float
    relmse: float
    relmse_trimmed: float
    largest: float
    psnr: float
    ssim: float
    flip: float
    ratio: tuple[float, ...]
    not_finite: tuple[int, int]
    exposure: float
    test: BlockTest | None
    picture: NDArray[np.float32] = field(repr=False)
    reference: NDArray[np.float32] = field(repr=False)
    flip_map: NDArray[np.float32] = field(repr=False)

    def numbers(self) -> dict[str, float]:
        """All measures by name; not_finite is the sum of both."""
        names = ("mse", "relmse", "relmse_trimmed", "largest", "psnr", "ssim", "flip")
        found: dict[str, float] = {name: getattr(self, name) for name in names}
        found["not_finite"] = sum(self.not_finite)
        if self.test is not None:
            found["p"] = self.test.p
        return found

    def side_by_side(self, scale: float = 5.0) -> NDArray[np.uint8]:
        """Both, `scale` times their difference around grey, and the FLIP map; sRGB, uint8."""
        factor = arguments.number("scale", scale)
        pair = side_by_side(self.picture, self.reference, self.exposure, factor)
        gap = np.full((pair.shape[0], 2, 3), 255, np.uint8)
        return np.concatenate([pair, gap, flip_colors(self.flip_map)], axis=1)

    def html(self, names: tuple[str, str] = ("picture", "reference")) -> str:
        """A page with numbers and pictures that needs no other file."""
        from .comparison_report import page

        if (
            not isinstance(names, (tuple, list))
            or len(names) != 2
            or not all(isinstance(name, str) for name in names)
        ):
            raise SceneError(f"names is {names!r}; must be two texts")
        return page(self, names)


def compare(
    picture: Picture,
    reference: Picture,
    *,
    variances: tuple[ArrayLike, ArrayLike] | None = None,
    exposure: float = 0.0,
) -> Comparison:
    """Compares a picture with a reference.

    Each is an Image, the path of a picture file, or linear light, (H, W, 3). Files of 8 and 16 bits
    are taken for sRGB. variances: of the mean in each pixel of both, (H, W, 3) or (H, W, 1); makes
    a z-test of all blocks of pixels, from single ones to the whole picture. Without them, two
    renderings that have the feature or layer `variance` are tested by it, from 8 x 8 pixels up, in
    brightness. exposure: stops, for what is seen.

    Raises SceneError for pictures of different sizes, FormatError for files that are none.
    """
    (a, a_screen, a_variance), (b, b_screen, b_variance) = (_light(p) for p in (picture, reference))
    if a.shape != b.shape:
        raise SceneError(
            f"{_name(picture, 'the picture')} has {a.shape[1]}x{a.shape[0]} pixels,"
            f" {_name(reference, 'the reference')} {b.shape[1]}x{b.shape[0]}"
        )
    shown = Display(exposure=exposure)
    finite = [np.asarray(np.isfinite(p).all(axis=2)) for p in (a, b)]
    both = finite[0] & finite[1]
    if not both.all():
        a, b = (np.where(both[..., None], p, np.float32(0)) for p in (a, b))
    if not both.any():
        raise SceneError("there is no pixel that is finite in both pictures")
    x, r = a[both].astype(np.float64), b[both].astype(np.float64)
    plain, trimmed = relative_mse(x, r)
    seen = [srgb_encoded(p * np.float32(2.0**shown.exposure)) for p in (a, b)]
    squares = (seen[0].astype(np.float64) - seen[1])[both] ** 2
    noise = float(squares.mean())
    if a_screen and b_screen:
        seen_errors = flip(*(np.clip(p, 0, 1) for p in (a, b)))
    else:
        seen_errors = flip(*(np.maximum(p, 0) for p in (a, b)), hdr=True)
    test = None
    if variances is not None:
        if not isinstance(variances, (tuple, list)) or len(variances) != 2:
            raise SceneError(
                f"{option('variances')}: two arrays are needed, of the picture and the reference,"
                f" not {type(variances).__name__}"
            )
        va, vb = (_variance(v, a.shape) for v in variances)
        test = z_test(a, b, va, vb, both)
    elif a_variance is not None and b_variance is not None:
        grey = [p.mean(axis=2, keepdims=True, dtype=np.float64) for p in (a, b)]
        known = [v.reshape(*both.shape, 1) for v in (a_variance, b_variance)]
        test = z_test(grey[0], grey[1], known[0], known[1], both, smallest=_ESTIMATED)
    means = x.mean(axis=0), r.mean(axis=0)
    return Comparison(
        mse=float(np.mean((x - r) ** 2)),
        relmse=plain,
        relmse_trimmed=trimmed,
        largest=float(np.abs(x - r).max()),
        psnr=-10.0 * log10(noise) if noise else np.inf,
        ssim=float(ssim(*seen)[both].mean()),
        flip=float(seen_errors[both].mean(dtype=np.float64)),
        ratio=tuple(
            np.divide(
                *means, out=np.where(means[0] != 0, np.inf, 1.0), where=means[1] != 0
            ).tolist()
        ),
        not_finite=(int((~finite[0]).sum()), int((~finite[1]).sum())),
        exposure=shown.exposure,
        test=test,
        picture=np.ascontiguousarray(a),
        reference=np.ascontiguousarray(b),
        flip_map=seen_errors,
    )


def _name(picture: Any, otherwise: str) -> str:
    return os.fspath(picture) if isinstance(picture, (str, os.PathLike)) else otherwise


def _light(picture: Any) -> tuple[NDArray[np.float32], bool, NDArray[np.float32] | None]:
    """Linear light, (H, W, 3); whether it was stored for a screen, so that none exceeds 1; and the
    variance that it has estimated for itself.
    """
    if isinstance(picture, Image):
        known = None if NOISY in picture.features else picture.features.get("variance")
        return picture.pixels, False, known
    if isinstance(picture, (str, os.PathLike)):
        from .layers import MAIN, PictureFile

        file = PictureFile(Path(picture))
        layer = file.layer()
        light, alpha = file.light(layer)
        if alpha is not None:
            light = light * alpha
        estimate = file.layers.get("variance")
        if NOISY in file.layers or layer.name != MAIN:
            estimate = None
        known = None if estimate is None else file.read(estimate)[..., 0]
        return light, layer.kinds[0] in ("uint8", "uint16"), known
    try:
        pixels = np.asarray(picture, np.float32)
    except (TypeError, ValueError):
        pixels = np.empty(0, np.float32)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or not pixels.size:
        raise SceneError(
            "compare: an Image, a path or an array of shape (height, width, 3) is needed, not"
            f" {type(picture).__name__}"
            + (f" of shape {pixels.shape}" if isinstance(picture, np.ndarray) else "")
        )
    return pixels, False, None


def _variance(values: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Of every pixel and channel. Raises SceneError for an array that is none."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise SceneError(
            f"{option('variances')}: numbers are needed, not {type(values).__name__}"
        ) from None
    if array.shape == shape[:2]:
        array = array[..., None]
    if array.ndim != 3 or array.shape[:2] != shape[:2] or array.shape[2] not in (1, shape[2]):
        raise SceneError(f"{option('variances')}: shape {array.shape} for pixels of {shape}")
    if not (array >= 0).all() or not np.isfinite(array).all():
        raise SceneError(f"{option('variances')}: must be finite numbers >= 0")
    return np.asarray(np.broadcast_to(array, shape))


# --- Errors --------------------------------------------------------------------------------------


def relative_mse(picture: NDArray[Any], reference: NDArray[Any]) -> tuple[float, float]:
    """Mean of (x - r)^2 / (r^2 + (0.1 m)^2), m the mean of r, of (..., channels); and the same
    without the share TRIM of pixels that have the largest.
    """
    r = np.asarray(reference, np.float64)
    scale = r**2 + (_FLOOR * r.mean()) ** 2
    squares = (picture - r) ** 2
    black = np.where(squares > 0, np.inf, 0.0)  # of a black reference
    error = np.divide(squares, scale, out=black, where=scale > 0)
    each = np.sort(error.mean(axis=-1), axis=None)
    return float(each.mean()), float(each[: each.size - int(TRIM * each.size)].mean())


def ssim(picture: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W): structural similarity around each pixel (Wang, Bovik, Sheikh and Simoncelli, 2004),
    the mean over channels of values from 0 to 1. Edges are continued.
    """
    from .flip import blurred

    at = np.arange(-_WINDOW, _WINDOW + 1, dtype=np.float64)
    window = np.exp(-(at**2) / (2 * _SIGMA**2))
    window /= window.sum()
    x, y = (p.astype(np.float64) for p in (picture, reference))
    mx, my, xx, yy, xy = (blurred(v, window, window) for v in (x, y, x * x, y * y, x * y))
    c1, c2 = _K1**2, _K2**2
    top = (2 * mx * my + c1) * (2 * (xy - mx * my) + c2)
    bottom = (mx**2 + my**2 + c1) * (xx - mx**2 + yy - my**2 + c2)
    return np.asarray((top / bottom).mean(axis=2), np.float32)


# --- Statistics ----------------------------------------------------------------------------------


def z_test(
    picture: NDArray[Any],
    reference: NDArray[Any],
    variance: NDArray[Any],
    reference_variance: NDArray[Any],
    weights: NDArray[Any] | None = None,
    smallest: int = 1,
) -> BlockTest:
    """Whether both have the same mean in every block of pixels, given the variances of their means.

    All (H, W, C). weights: (H, W), 0 for pixels that do not count. smallest: edge of a block, a
    power of two.
    """
    w = np.ones(picture.shape[:2]) if weights is None else np.asarray(weights, np.float64)
    w = w[..., None]
    gaps = block_sums((np.asarray(picture, np.float64) - reference) * w)
    both = np.asarray(variance, np.float64) + reference_variance
    errors = block_sums(np.where(w > 0, both, 0.0))
    scores = [standard_errors(gap, np.sqrt(e)) for gap, e in zip(gaps, errors, strict=True)]
    skipped = min(smallest.bit_length() - 1, len(scores) - 1)
    return block_test(scores[skipped:], lambda z: erfc(z / sqrt(2.0)), 2**skipped)


def standard_errors(gap: NDArray[Any], error: NDArray[Any]) -> NDArray[np.float64]:
    """How many errors wide a gap is; infinite where there is a gap and no error."""
    at_most = np.where(gap != 0, np.inf, 0.0)
    return np.asarray(np.divide(gap, error, out=at_most, where=error > 0))


def block_test(
    scores: Iterable[NDArray[np.float64]], tail: Callable[[float], float], smallest: int = 1
) -> BlockTest:
    """Of the scores of all blocks, (rows, columns, channels) for each size from the smallest up.

    tail: the chance of a score at least as far from 0, on either side. Each size of block gets the
    same share of the significance, and within it each block and channel (Sidak's correction both
    times): pictures that agree are found to differ with probability SIGNIFICANCE or less.
    """
    levels = list(scores)
    families = [of_family(tail(float(np.abs(s).max())), s.size) for s in levels]
    level = min(range(len(levels)), key=lambda i: families[i])
    found = levels[level]
    row, column, channel = (int(i) for i in np.unravel_index(np.argmax(np.abs(found)), found.shape))
    return BlockTest(
        p=of_family(families[level], len(levels)),
        size=smallest * 2**level,
        block=(row, column),
        channel=channel,
        strongest=float(found[row, column, channel]),
        each=levels[0],
    )


def of_family(smallest: float, count: int) -> float:
    """Sidak's: the chance that the smallest p of `count` independent tests is this small."""
    return -expm1(count * log1p(-min(smallest, 1 - 1e-16)))


def block_sums(pictures: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Sums over blocks of 1, 2x2, 4x4 ... pixels of (..., H, W, C), up to one that holds all.

    Blocks at the right and the bottom may hold fewer.
    """
    yield pictures
    while max(pictures.shape[-3:-1]) > 1:
        for axis in (-3, -2):
            pairs = np.arange(0, pictures.shape[axis], 2)
            pictures = np.add.reduceat(pictures, pairs, axis=axis)
        yield pictures


# --- Pictures ------------------------------------------------------------------------------------


def side_by_side(
    picture: NDArray[Any],
    reference: NDArray[Any],
    exposure: float | None = None,
    scale: float = 5.0,
) -> NDArray[np.uint8]:
    """Both, and `scale` times their difference around middle grey, as sRGB, (H, 3 W + 4, 3).

    All are linear. exposure: stops; None makes the reference's 99th percentile white.
    """
    pair = [np.asarray(p, np.float64) for p in (picture, reference)]
    if exposure is None:
        factor = 1.0 / max(float(np.quantile(pair[1].max(axis=-1), 0.99)), 1e-12)
    else:
        factor = 2.0**exposure
    seen = [np.asarray(srgb_encoded((factor * p).astype(np.float32))) for p in pair]
    difference = np.clip(0.5 + 0.5 * scale * factor * (pair[0] - pair[1]), 0.0, 1.0)
    gap = np.ones((pair[0].shape[0], 2, 3))
    row = np.concatenate([seen[0], gap, seen[1], gap, np.nan_to_num(difference)], axis=1)
    return np.asarray(np.round(255 * row), np.uint8)


def flip_colors(errors: NDArray[np.float32]) -> NDArray[np.uint8]:
    """A FLIP map in the colours that its authors show it in, (H, W, 3)."""
    from matplotlib import colormaps

    return np.asarray(colormaps["magma"](np.asarray(errors), bytes=True)[..., :3])


def limits_exceeded(
    numbers: Mapping[str, float], above: Mapping[str, float], below: Mapping[str, float]
) -> list[str]:
    """Sentences on the measures that are above or below their limits; nan is both."""
    found = [
        f"{name} is {numbers[name]:.6g}, above {most:g}"
        for name, most in above.items()
        if not numbers[name] <= most
    ]
    return found + [
        f"{name} is {numbers[name]:.6g}, below {least:g}"
        for name, least in below.items()
        if not numbers[name] >= least
    ]
