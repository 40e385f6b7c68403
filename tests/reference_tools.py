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

import numpy as np
from scipy import stats

from parhelion.comparison import (
    SIGNIFICANCE,
    BlockTest,
    block_sums,
    block_test,
    side_by_side,
    standard_errors,
)
from parhelion.image import encoded
from parhelion.layers import PictureFile

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
        for sums, counts in zip(
            block_sums(self.pictures * weights), block_sums(weights), strict=True
        ):
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
        for mean, variance, counts in zip(*map(block_sums, pictures), strict=True):
            counts = np.maximum(counts, 1)
            yield mean / counts, variance / counts**2


@dataclass(frozen=True)
class Verdict:
    """What a comparison found.

    test: of all blocks; its scores are t. accepted: share of the pixels whose p passes by itself
    (Mitsuba asks for 0.9975). ratio: of the mean of ours to the reference's, by channel.
    """

    test: BlockTest
    accepted: float
    ratio: np.ndarray

    @property
    def agrees(self) -> bool:
        return self.test.p >= SIGNIFICANCE

    def __str__(self) -> str:
        ratios = " ".join(f"{r:.4f}" for r in self.ratio)
        return (
            f"{self.test}; means {ratios} of the reference's; {100 * self.accepted:.2f} % of the"
            " pixels pass"
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
    scores = []
    blocks = zip(ours.blocks(weights), reference.blocks(weights), block_sums(weights), strict=True)
    for (x, u), (r, v), counts in blocks:
        if isinstance(reference, Reference):
            u, v = np.maximum(u, v / total), v / reference.samples
        t = standard_errors(x - r, np.sqrt(u + v + (ROUNDING * r) ** 2))
        t[counts[..., 0] == 0] = 0.0
        scores.append(t)
    test = block_test(scores, lambda t: 2.0 * float(stats.t.sf(t, freedom)))
    alpha = -np.expm1(np.log1p(-SIGNIFICANCE) / test.each.size)
    sums = [np.sum(m * weights, axis=(0, 1)) for m in (ours.mean, reference.mean)]
    return Verdict(
        test=test,
        accepted=float(np.mean(np.abs(test.each) <= stats.t.isf(alpha / 2, freedom))),
        ratio=np.divide(sums[0], sums[1], out=np.ones(shape[2]), where=sums[1] != 0),
    )


def render_batches(
    render: Callable[[int], np.ndarray], batches: int = BATCHES, first_seed: int = 1
) -> Batches:
    """Pictures of `render(seed)`, (H, W, 3), for as many seeds."""
    seeds = range(first_seed, first_seed + batches)
    return Batches(np.stack([np.asarray(render(seed), np.float64) for seed in seeds]))


def read_linear(path: Path) -> np.ndarray:
    """(H, W, 3) float32, the R, G and B of a file that stores linear light."""
    file = PictureFile(path)
    return file.light(file.layer())[0]


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


def save_side_by_side(ours: np.ndarray, reference: np.ndarray, path: Path) -> None:
    """Writes a PNG: ours, the reference, and five times their difference around middle grey.

    All are linear RGB, shown with one exposure, which makes the reference's 99th percentile white.
    """
    row = side_by_side(ours, reference)
    zoom = max(1, 320 // row.shape[0])
    path.write_bytes(encoded(np.kron(row, np.ones((zoom, zoom, 1), np.uint8)), {}, ".png"))
