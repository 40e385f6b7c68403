"""FLIP: how large the differences are that one sees when two pictures alternate in one place.

P. Andersson, J. Nilsson, T. Akenine-Moller, M. Oskarsson, K. Astrom and M. D. Fairchild, "FLIP: A
Difference Evaluator for Alternating Images", HPG 2020; for light without an upper limit, P.
Andersson, J. Nilsson, P. Shirley and T. Akenine-Moller, "Visualizing Errors in Rendered High
Dynamic Range Images", Eurographics 2021 short papers. Constants are theirs. Their own package is no
dependency, as it is not there for every Python that we run on; the tests compare with it.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from . import machine
from .errors import SceneError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float32]
    Planes = tuple[Array, Array, Array]

# Pixels in a degree: a screen of 3840 pixels and 0.7 m, seen from 0.7 m (section 6 of 2020)
_DEGREE = 0.7 * 3840 / 0.7 * np.pi / 180

# Contrast sensitivity: sums of Gaussians a sqrt(pi / b) exp(-pi^2 x^2 / b), of x in degrees, for
# luminance, red-green and blue-yellow (section 4.1)
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
# Redistribution of colour differences, and of features (sections 4.1.3 and 4.2)
_QC, _PC, _PT = 0.7, 0.4, 0.95
_QF, _SIGMA = 0.5, 0.5 * 0.082 * _DEGREE

# Rows that are compared at a time
_ROWS = 64

# Linear RGB to CIE XYZ, and the white of it (IEC 61966-2-1)
_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
_TO_WHITE = _XYZ / _XYZ.sum(axis=1, keepdims=True)
_LUMINANCE = np.array([0.2126729, 0.7151522, 0.0721750])

# The curve by which light is shown at each exposure, and the value that the brightest shall have
# (2021, section 3): (a x^2 + b x) / (c x^2 + d x + e)
_CURVE = (0.6 * 0.6 * 2.51, 0.6 * 0.03, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14)
_TOP = 0.85


def flip(picture: Any, reference: Any, *, hdr: bool = False) -> Array:
    """(H, W): the error that is seen in each pixel, 0 to 1, of two linear pictures, (H, W, 3).

    hdr: the largest of those at all exposures that the reference asks for, of light of any
    brightness; else of pictures between 0 and 1. Raises SceneError for numbers that are not finite.
    """
    test, base = (np.ascontiguousarray(p, np.float32) for p in (picture, reference))
    if not (np.isfinite(test).all() and np.isfinite(base).all()):
        raise SceneError("flip: pictures must be finite")
    stops = exposures(base) if hdr else [None]
    height = len(base)
    # parts that stay in a processor's cache, with the pixels around them that they depend on
    tops = range(0, height, _ROWS)

    def at(job: tuple[float | None, int]) -> Array:
        exposure, top = job
        first, last = max(top - _reach(), 0), min(top + _ROWS + _reach(), height)
        pair = test[first:last], base[first:last]
        if exposure is not None:
            pair = _toned(pair[0], exposure), _toned(pair[1], exposure)
        return _flip(*pair)[top - first : top - first + _ROWS]

    with ThreadPoolExecutor(machine.cores_available()) as pool:
        parts = pool.map(at, ((exposure, top) for top in tops for exposure in stops))
        rows = [np.maximum.reduce([next(parts) for _ in stops]) for _ in tops]
    return np.concatenate(rows)


def exposures(reference: Array) -> list[float]:
    """Stops, at least two, from where the brightest pixel can be told to where the median can."""
    luminance = reference.astype(np.float64) @ _LUMINANCE
    a, b, c, d, e = _CURVE
    quadratic = np.array([a - _TOP * c, b - _TOP * d, -_TOP * e])
    brightest = float(max(np.roots(quadratic).real))
    tiny = float(np.finfo(np.float32).tiny)
    first, last = (
        float(np.log2(brightest / max(float(f(luminance)), tiny))) for f in (np.max, np.median)
    )
    count = max(2, int(np.ceil(last - first)))
    return [float(stops) for stops in np.linspace(first, last, count)]


def _toned(light: Array, stops: float) -> Array:
    a, b, c, d, e = _CURVE
    # beyond, the curve is flat and squares of light would overflow
    with np.errstate(over="ignore"):
        x = np.minimum(light * np.float32(2.0**stops), np.float32(1e15))
    return np.asarray(np.clip((a * x + b) * x / ((c * x + d) * x + e), 0, 1), np.float32)


def _flip(test: Array, base: Array) -> Array:
    opponents = [_opponent(p) for p in (test, base)]
    colors = [_hunt(_lab(_filtered(o))) for o in opponents]
    error = _hyab(*colors) ** np.float32(_QC)
    most = _most()
    low = np.float32(_PC * most)
    error = np.where(
        error < low,
        error * (np.float32(_PT) / low),
        np.float32(_PT) + (error - low) * np.float32((1 - _PT) / (most - low)),
    )
    edges, points = zip(*(_features((o[0] + 16) / 116) for o in opponents), strict=True)
    feature = np.maximum(np.abs(edges[0] - edges[1]), np.abs(points[0] - points[1]))
    feature = np.minimum(feature / np.float32(np.sqrt(2)), 1) ** np.float32(_QF)
    return np.asarray(np.minimum(error, 1) ** (1 - feature), np.float32)


def _mixed(matrix: NDArray[np.float64], planes: Planes) -> Planes:
    """A matrix times what three planes hold of each pixel."""
    x, y, z = (
        np.float32(r[0]) * planes[0] + np.float32(r[1]) * planes[1] + np.float32(r[2]) * planes[2]
        for r in matrix
    )
    return x, y, z


def _opponent(linear: Array) -> Planes:
    """Luminance, red-green and blue-yellow: CIELAB without its root."""
    x, y, z = _mixed(_TO_WHITE, (linear[..., 0], linear[..., 1], linear[..., 2]))
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def _filtered(opponent: Planes) -> Planes:
    """What of it the eye resolves, as linear RGB between 0 and 1."""
    luminance, red_green, blue_yellow = (
        sum(np.float32(w) * blurred(plane, g, g) for w, g in sums)
        for plane, sums in zip(opponent, _kernels(), strict=True)
    )
    y = (luminance + 16) / 116
    r, g, b = _mixed(np.linalg.inv(_TO_WHITE), (red_green / 500 + y, y, y - blue_yellow / 200))
    return np.clip(r, 0, 1), np.clip(g, 0, 1), np.clip(b, 0, 1)


def _reach() -> int:
    """Pixels around one that its error depends on."""
    return max(_radius(), int(np.ceil(3 * _SIGMA)))


def _radius() -> int:
    widest = max(b for sums in _SENSITIVITY for _, b in sums)
    return int(np.ceil(3 * np.sqrt(widest / (2 * np.pi**2)) * _DEGREE))


@cache
def _kernels() -> list[list[tuple[float, NDArray[np.float64]]]]:
    """For each channel: weights, and Gaussians for rows and columns that sum up to 1."""
    at = np.arange(-_radius(), _radius() + 1) / _DEGREE
    found = []
    for sums in _SENSITIVITY:
        parts = []
        for a, b in sums:
            line = np.exp(-(np.pi**2) * at**2 / b)
            parts.append((a * np.sqrt(np.pi / b) * line.sum() ** 2, line / line.sum()))
        total = sum(weight for weight, _ in parts)
        found.append([(float(weight / total), line) for weight, line in parts])
    return found


def _lab(linear: Planes) -> Planes:
    x, y, z = (_root(plane) for plane in _mixed(_TO_WHITE, linear))
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def _root(t: Array) -> Array:
    """CIELAB's: cubic, with a straight end."""
    delta = 6 / 29
    straight = t * np.float32(1 / (3 * delta**2)) + np.float32(4 / 29)
    return np.asarray(np.where(t > delta**3, np.cbrt(t), straight))


def _hunt(lab: Planes) -> Planes:
    """Colours are told apart less where it is dark."""
    share = np.float32(0.01) * lab[0]
    return lab[0], share * lab[1], share * lab[2]


def _hyab(one: Planes, two: Planes) -> Array:
    lightness, a, b = (p - q for p, q in zip(one, two, strict=True))
    return np.asarray(np.abs(lightness) + np.hypot(a, b))


@cache
def _most() -> float:
    """The largest redistributed difference: between green and blue."""
    none, full = np.zeros(1, np.float32), np.ones(1, np.float32)
    green, blue = (_hunt(_lab(c)) for c in ((none, full, none), (none, none, full)))
    return float(_hyab(green, blue)[0] ** _QC)


def _features(luminance: Any) -> tuple[Array, Array]:
    """How strong edges and points are in each pixel."""
    radius = int(np.ceil(3 * _SIGMA))
    at = np.arange(-radius, radius + 1, dtype=np.float64)
    bell = np.exp(-(at**2) / (2 * _SIGMA**2))
    bell /= bell.sum()
    found = []
    for line in (-at * bell, (at**2 / _SIGMA**2 - 1) * bell):
        # weights above 0 sum up to 1, those below to -1
        line = np.where(line > 0, line / line[line > 0].sum(), line / -line[line < 0].sum())
        along = blurred(luminance, line, bell), blurred(luminance, bell, line)
        found.append(np.hypot(*along))
    return found[0], found[1]


def blurred(values: Any, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> Any:
    """(H, W, ...) convolved with a kernel down the columns, and one along the rows; edges go on."""
    for axis, kernel in ((0, rows), (1, columns)):
        radius = len(kernel) // 2
        pad = [(0, 0)] * values.ndim
        pad[axis] = (radius, radius)
        padded = np.pad(values, pad, mode="edge")
        size = values.shape[axis]
        total = np.zeros_like(values)
        for k, weight in enumerate(kernel):
            part = padded[k : k + size] if axis == 0 else padded[:, k : k + size]
            total += values.dtype.type(weight) * part
        values = total
    return values
