"""Statistical tests of sampling routines: chi-square over binned samples, and t-tests of means.

Seeds are fixed everywhere, and so are the core's bits, so a test that passes once always passes.
The significance says how surprised one should be when a change of the code makes a test fail.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import stats

# Chance that a whole family of correct tests would fail for one choice of seeds.
SIGNIFICANCE = 0.01

# Cells per bin and axis over which a density is integrated.
QUADRATURE = 24


def sidak(count: int) -> float:
    """The significance of one of `count` tests that has the family fail with SIGNIFICANCE."""
    return 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / count)


def chi_square(observed: np.ndarray, expected: np.ndarray) -> float:
    """p-value of counts against expected counts, one entry a bin.

    Bins that expect fewer than 5 are pooled, since the statistic is chi-square only for many.
    """
    observed, expected = np.ravel(observed), np.ravel(expected)
    order = np.argsort(expected)
    observed, expected = observed[order].astype(float), expected[order]
    small = np.searchsorted(expected, 5.0)
    # the pool takes further bins until it expects 5 itself
    while small < expected.size and 0 < expected[:small].sum() < 5.0:
        small += 1
    if small:
        observed = np.append(observed[small:], observed[:small].sum())
        expected = np.append(expected[small:], expected[:small].sum())
    if expected[-1] == 0.0:
        if observed[-1] > 0:
            return 0.0
        observed, expected = observed[:-1], expected[:-1]
    statistic = np.sum((observed - expected) ** 2 / expected)
    return float(stats.chi2.sf(statistic, observed.size - 1))


def frame_around(axis: np.ndarray) -> np.ndarray:
    """(3, 3): rows are the axes of an orthonormal frame whose z is `axis`."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis])


def direction_chi_square(
    samples: np.ndarray,
    pdf: Callable[[np.ndarray], np.ndarray],
    axis: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 1.0),
    bins: tuple[int, int] = (8, 12),
    slack: float = 0.01,
    points: int = 2,
) -> float:
    """p-value of unit vectors, (N, 3), against a density per steradian.

    slack: how far from 1 the density's integral may be. points: at which a cell of the integral is
    looked at, along each side; thin streaks need more.

    The first tenth of the samples, no part of the counts, sets the bins: rings around the axis that
    hold equally many of them. Narrow lobes are so resolved like wide ones, and where a density has
    a pole, as at the limb of a projected sphere, the cells are thin.
    """
    pilot, rest = np.split(samples.astype(float), [len(samples) // 10])
    frame = frame_around(np.asarray(axis) / np.linalg.norm(axis))
    heights = _one_minus_cosine(pilot, frame[2])
    rings = np.quantile(heights, np.linspace(0, 1, bins[0] * QUADRATURE))
    rings[0] = 0.0
    # and one for what lies beyond the pilot's farthest
    farthest = max(rings[-1], _one_minus_cosine(rest, frame[2]).max())
    rings = np.append(rings, min(2.0, 1.1 * farthest))
    edges = [rings[::QUADRATURE], np.linspace(0, 1, bins[1] + 1)]

    turns = np.arctan2(rest @ frame[1], rest @ frame[0]) / (2 * np.pi) % 1.0
    observed = np.histogram2d(_one_minus_cosine(rest, frame[2]), turns, edges)[0]

    def density(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        radius, angle = np.sqrt(u * (2 - u)), 2 * np.pi * v
        local = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1 - u], axis=-1)
        return pdf((local @ frame).astype(np.float32))

    cuts = np.linspace(0, 1, bins[1] * QUADRATURE + 1)
    mass = _masses(density, rings, cuts, points) * 2 * np.pi
    return _p_of_masses(observed, mass, len(rest), slack)


def _one_minus_cosine(w: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return np.sum((w - axis) ** 2, axis=1) / 2


def _masses(
    density: Callable[[np.ndarray, np.ndarray], np.ndarray],
    u: np.ndarray,
    v: np.ndarray,
    points: int = 2,
) -> np.ndarray:
    """Integrals over each bin of a rectangle; a bin is QUADRATURE cells of edges u by as many of v.

    Densities may jump, or be infinite along a curve, so the points are random in strata, few in
    most cells and many where the few disagree the most.
    """
    rng = np.random.default_rng(7)
    low = np.stack([a.ravel() for a in np.meshgrid(u[:-1], v[:-1], indexing="ij")])
    size = np.stack([a.ravel() for a in np.meshgrid(np.diff(u), np.diff(v), indexing="ij")])

    def values(cells: np.ndarray, n: int) -> np.ndarray:
        """(len(cells), n * n) densities within the cells, times their areas."""
        strata = np.stack([a.ravel() for a in np.indices((n, n))])[:, None, :]
        places = (strata + rng.random((2, len(cells), n * n))) / n
        at = low[:, cells, None] + size[:, cells, None] * places
        f = density(at[0].ravel(), at[1].ravel()).astype(float)
        return f.reshape(len(cells), n * n) * np.prod(size[:, cells], axis=0)[:, None]

    first = values(np.arange(low.shape[1]), points)
    mass = first.mean(axis=1)
    rough = np.argsort(first.std(axis=1))[-low.shape[1] // 50 :]
    mass[rough] = values(rough, 12).mean(axis=1)
    bins = ((u.size - 1) // QUADRATURE, QUADRATURE, (v.size - 1) // QUADRATURE, QUADRATURE)
    return mass.reshape(bins).sum(axis=(1, 3))


def _p_of_masses(observed: np.ndarray, mass: np.ndarray, count: int, slack: float = 0.01) -> float:
    # Bins are integrated to about 1 %, all together to much less; a density whose integral is
    # not 1 is wrong whatever its shape.
    assert abs(mass.sum() - 1.0) < slack, f"the density integrates to {mass.sum():.4f}"
    outside = count - observed.sum()
    return chi_square(np.append(observed, outside), np.append(mass / mass.sum() * count, 0.0))


def point_chi_square(
    samples: np.ndarray,
    pdf: Callable[[np.ndarray, np.ndarray], np.ndarray],
    low: tuple[float, float],
    high: tuple[float, float],
    bins: tuple[int, int] = (10, 10),
) -> float:
    """p-value of points, (N, 2), against a density per unit area of a rectangle."""
    cuts = [np.linspace(low[k], high[k], bins[k] * QUADRATURE + 1) for k in range(2)]
    edges = [cut[::QUADRATURE] for cut in cuts]
    observed = np.histogram2d(samples[:, 0], samples[:, 1], edges)[0]
    return _p_of_masses(observed, _masses(pdf, cuts[0], cuts[1]), len(samples))


def proportion_p(hits: int, count: int, share: float) -> float:
    """p-value, two-sided, of a number of hits among independent trials."""
    return float(stats.binomtest(int(hits), count, min(max(share, 0.0), 1.0)).pvalue)


def mean_p(runs: np.ndarray, expected: np.ndarray, rounding: float = 1e-6) -> float:
    """Smallest p-value, made good for their number, of means against expected values.

    runs: (R, ...) independent estimates; expected: (...). rounding: relative error of float32
    that is no part of the scatter.
    """
    error = np.sqrt(runs.var(axis=0, ddof=1) / len(runs) + (rounding * np.abs(expected)) ** 2)
    gap = np.abs(runs.mean(axis=0) - expected)
    t = np.divide(gap, error, out=np.where(gap > 0, np.inf, 0.0), where=error > 0)
    smallest = float(2 * stats.t.sf(np.max(t), len(runs) - 1))
    return float(-np.expm1(t.size * np.log1p(-min(smallest, 1 - 1e-16))))
