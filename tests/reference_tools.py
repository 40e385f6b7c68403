"""Comparing pictures with references of other renderers by a statistical test.

**The statistic.** Of a block of pixels and a channel, x is the mean over B of our pictures, each
with a seed of its own, and s^2 the variance among them; r is the reference's mean, of variance v:

    t = (x - r) / sqrt(u + v + (ROUNDING r)^2),    u = s^2 / B

Its p-value, two-sided, is Student's with B - 1 degrees of freedom. (Welch would grant a few more,
which costs nothing but a little power.) It is taken for every pixel, then for every block of 2x2
pixels, of 4x4 and so on up to the whole picture: single pixels find what is small and very wrong,
blocks what is wide and slightly wrong, the whole picture a factor. Each size of block gets the same
share of the significance, and within it each block and channel, by Sidak's correction both times: a
correct renderer fails with probability SIGNIFICANCE, or less, since the tests are not independent.

**Mitsuba's variance images.** Mitsuba's regression tests (Mitsuba 3, `test_renders.py` in
`src/render/tests`) keep with each reference the variance of ONE sample of a pixel, as its `moment`
integrator saw it over the 32000 samples that the script takes for a reference. Both moments are of
CIE XYZ, and both pictures are stored after the linear map from XYZ to sRGB's primaries, so that the
stored "variances" of red can be negative; mapped back they are the variances of X, Y and Z. So the
test is made in XYZ. Mitsuba itself trusts the stored variance for its own noise, z = |x - r|
sqrt(spp / variance), lets the reference's mean count as exact, and asks that 99.75 % of the pixels
pass. Here our noise is measured, the reference's own noise counts, and all pixels must pass. Where
the stored variance says that our samples must scatter more than ours did, the larger is taken for
u: a rare bright path that none of ours found is no evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

# Chance that a correct renderer fails one comparison.
SIGNIFICANCE = 0.01

# Independent pictures that our noise is measured by. With fewer, Student's tails are so wide at the
# significance of one pixel that single pixels tell nothing: 7.3 standard errors for 16, 5.9 for 32.
BATCHES = 32

# Relative error of a reference's mean that is no noise. Mitsuba adds up 32000 samples in float32:
# where all are equal, as in a constant sky, each sum is rounded the same way, and the mean is off
# by up to 4.7e-4, by 2.3e-4 in root mean square (measured over 2001 values in [0.5, 1.5]; the white
# sky of its references is off by 3.1e-4 in X and -2.4e-4 in Z, about what that predicts).
ROUNDING = 2.5e-4

# Samples of a pixel in Mitsuba's own references, the default of the script that makes them.
MITSUBA_SAMPLES = 32000

# Linear sRGB to CIE XYZ with Mitsuba's digits (IEC 61966-2-1; ITU-R BT.709 primaries, D65).
XYZ_OF_RGB = np.array(
    [
        [0.412453, 0.357580, 0.180423],
        [0.212671, 0.715160, 0.072169],
        [0.019334, 0.119193, 0.950227],
    ]
)


@dataclass(frozen=True)
class Batches:
    """Independent pictures of one scene, (B, H, W, C), float64."""

    pictures: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        return np.asarray(self.pictures.mean(axis=0))

    def blocks(self, weights: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """For each size of block: means, and the variances of those means."""
        for sums, counts in zip(levels(self.pictures * weights), levels(weights), strict=True):
            means = sums / np.maximum(counts, 1)
            yield means.mean(axis=0), means.var(axis=0, ddof=1) / len(means)


@dataclass(frozen=True)
class Reference:
    """A picture whose noise is known. variance: of one sample, (H, W, C); samples: a pixel's."""

    mean: np.ndarray
    variance: np.ndarray
    samples: int = MITSUBA_SAMPLES

    def blocks(self, weights: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """For each size of block: means, and variances for one sample in every pixel."""
        pictures = (self.mean * weights, self.variance * weights, weights)
        for mean, variance, counts in zip(*map(levels, pictures), strict=True):
            counts = np.maximum(counts, 1)
            yield mean / counts, variance / counts**2


@dataclass(frozen=True)
class Verdict:
    """What a comparison found.

    p: of the whole family of tests. size, block, channel: of its smallest. t: (H, W, C), of single
    pixels. accepted: share of the pixels whose p passes by itself (Mitsuba asks for 0.9975).
    ratio: of the mean of ours to the reference's, by channel.
    """

    p: float
    size: int
    block: tuple[int, int]
    channel: int
    largest_t: float
    t: np.ndarray
    accepted: float
    ratio: np.ndarray

    @property
    def agrees(self) -> bool:
        return self.p >= SIGNIFICANCE

    def __str__(self) -> str:
        y, x = (self.size * i for i in self.block)
        ratios = " ".join(f"{r:.4f}" for r in self.ratio)
        return (
            f"p = {self.p:.3g}; strongest in pixels {x},{y} {self.size}x{self.size}, channel"
            f" {self.channel}: {self.largest_t:+.1f} standard errors; means {ratios} of the"
            f" reference's; {100 * self.accepted:.2f} % of the pixels pass"
        )


def compare(
    ours: Batches,
    reference: Batches | Reference,
    spp: int,
    weights: np.ndarray | None = None,
) -> Verdict:
    """Tests that two renderers have the same mean in every block of pixels, of any size.

    spp: of one of our batches. weights: (H, W), 0 for pixels that do not count.
    """
    shape = ours.pictures.shape[1:]
    if reference.mean.shape != shape:
        raise ValueError(f"a picture of {shape}, a reference of {reference.mean.shape}")
    weights = (np.ones(shape[:2]) if weights is None else weights)[..., None]
    total = spp * len(ours.pictures)
    freedom = len(ours.pictures) - 1
    # of each size of block: its p, and t
    families: list[tuple[float, np.ndarray]] = []
    blocks = zip(ours.blocks(weights), reference.blocks(weights), levels(weights), strict=True)
    for (x, u), (r, v), counts in blocks:
        if isinstance(reference, Reference):
            u, v = np.maximum(u, v / total), v / reference.samples
        gap, error = x - r, np.sqrt(u + v + (ROUNDING * r) ** 2)
        t = np.divide(gap, error, out=np.where(gap != 0, np.inf, 0.0), where=error > 0)
        t[counts[..., 0] == 0] = 0.0
        p = 2.0 * float(stats.t.sf(np.abs(t).max(), freedom))
        families.append((_of_family(p, t.size), t))
    level = min(range(len(families)), key=lambda i: families[i][0])
    smallest, t = families[level]
    row, column, channel = (int(i) for i in np.unravel_index(np.argmax(np.abs(t)), t.shape))
    pixels = families[0][1]
    alpha = -np.expm1(np.log1p(-SIGNIFICANCE) / pixels.size)
    sums = [np.sum(m * weights, axis=(0, 1)) for m in (ours.mean, reference.mean)]
    return Verdict(
        p=_of_family(smallest, len(families)),
        size=2**level,
        block=(row, column),
        channel=channel,
        largest_t=float(t[row, column, channel]),
        t=pixels,
        accepted=float(np.mean(np.abs(pixels) <= stats.t.isf(alpha / 2, freedom))),
        ratio=np.divide(sums[0], sums[1], out=np.ones(shape[2]), where=sums[1] != 0),
    )


def _of_family(smallest: float, count: int) -> float:
    """Sidak's: the chance that the smallest p of `count` independent tests is this small."""
    return float(-np.expm1(count * np.log1p(-min(smallest, 1 - 1e-16))))


def levels(pictures: np.ndarray) -> Iterator[np.ndarray]:
    """Sums over blocks of 1, 2x2, 4x4 ... pixels of (..., H, W, C), up to one that holds all.

    Blocks at the right and the bottom may hold fewer.
    """
    yield pictures
    while max(pictures.shape[-3:-1]) > 1:
        for axis in (-3, -2):
            pairs = np.arange(0, pictures.shape[axis], 2)
            pictures = np.add.reduceat(pictures, pairs, axis=axis)
        yield pictures


def render_batches(
    render: Callable[[int], np.ndarray], batches: int = BATCHES, first_seed: int = 1
) -> Batches:
    """Pictures of `render(seed)`, (H, W, 3), for as many seeds."""
    seeds = range(first_seed, first_seed + batches)
    return Batches(np.stack([np.asarray(render(seed), np.float64) for seed in seeds]))


def read_linear(path: Path) -> np.ndarray:
    """(H, W, 3) float32, the R, G and B of a file that stores linear light."""
    import OpenImageIO as oiio

    buffer = oiio.ImageBuf(str(path))
    pixels = buffer.get_pixels(oiio.FLOAT)
    if buffer.has_error or pixels is None:
        raise OSError(f"{path}: {buffer.geterror()}")
    order = [buffer.spec().channelnames.index(name) for name in "RGB"]
    return np.asarray(pixels)[..., order]


def mitsuba_reference(scene: Path) -> Reference:
    """What lies beside a scene of Mitsuba's tests, in XYZ: refs/NAME_ref_rgb.exr and ..._var.exr.

    The scene's file is called NAME_INTEGRATOR.xml.
    """
    name = scene.stem.rpartition("_")[0]
    mean = read_linear(scene.parent / "refs" / f"{name}_ref_rgb.exr")
    variance = read_linear(scene.parent / "refs" / f"{name}_ref_rgb_var.exr")
    # a difference of two float32 moments may come out below 0
    return Reference(to_xyz(mean), np.maximum(to_xyz(variance), 0.0))


def to_xyz(rgb: np.ndarray) -> np.ndarray:
    return np.asarray(rgb.astype(np.float64) @ XYZ_OF_RGB.T)


def side_by_side(ours: np.ndarray, reference: np.ndarray, path: Path, scale: float = 5.0) -> None:
    """Writes a PNG: ours, the reference, and `scale` times their difference around middle grey.

    All are linear RGB, shown as sRGB with one exposure, which makes the reference's 99th percentile
    white.
    """
    import OpenImageIO as oiio

    exposure = 1.0 / max(float(np.quantile(reference.max(axis=-1), 0.99)), 1e-12)
    seen = [_srgb(exposure * np.asarray(p, np.float64)) for p in (ours, reference)]
    difference = np.clip(0.5 + 0.5 * scale * exposure * (ours - reference), 0.0, 1.0)
    gap = np.ones((ours.shape[0], 2, 3))
    row = np.concatenate([seen[0], gap, seen[1], gap, difference], axis=1)
    zoom = max(1, 320 // ours.shape[0])
    data = np.round(255 * np.kron(row, np.ones((zoom, zoom, 1)))).astype(np.uint8)
    out = oiio.ImageOutput.create(str(path))
    assert out is not None, oiio.geterror()
    out.open(str(path), oiio.ImageSpec(data.shape[1], data.shape[0], 3, oiio.UINT8))
    out.write_image(np.ascontiguousarray(data))
    out.close()


def _srgb(linear: np.ndarray) -> np.ndarray:
    from parhelion.image import srgb_encoded

    encoded: Any = srgb_encoded(np.ascontiguousarray(linear, np.float32))
    return np.asarray(encoded, np.float64)
