"""Strands of curves as chains of cubic Bezier segments, which is what the core takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import arguments
from .errors import SceneError, unknown_name
from .scene import Curves

# Flags of a segment, as in core/shapes/curve.h.
FLAT, CAP_START, CAP_END = 1, 2, 4

# Rows: a segment's four Bezier control points from four uniform B-spline ones (L. Piegl and W.
# Tiller, The NURBS Book, 2nd edition, section 5.3: knots inserted to full multiplicity).
_BSPLINE = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0
# A straight piece, its control points evenly spaced.
_LINEAR = np.array([[3, 0], [2, 1], [1, 2], [0, 3]]) / 3.0

# basis -> (control points of a segment, points from one segment to the next, matrix)
_BASES: dict[str, tuple[int, int, Any]] = {
    "linear": (2, 1, _LINEAR),
    "bezier": (4, 3, np.eye(4)),
    "bspline": (4, 1, _BSPLINE),
}


def bezier_segments(curves: Curves, points: Any, radii: Any, where: str) -> tuple[Any, ...]:
    """(S, 4, 3) control points, (S, 4) radii, (S, 2) shares along the strand, (S,) flags.

    points: (P, 3), radii: (P,). Raises SceneError for counts that do not fit the basis, and for
    bad numbers by their control point, which segments no longer show.
    """
    for name, values, sound, must in (
        ("points", points, np.isfinite(points).all(axis=1), "be finite"),
        ("radii", radii, np.isfinite(radii) & (radii > 0), "be finite and greater than 0"),
    ):
        if not sound.all():
            at = int(np.argmin(sound))
            raise SceneError(f"{where}: {name}[{at}] is {values[at]}; must {must}")
    if not isinstance(curves.basis, str) or curves.basis not in _BASES:
        raise SceneError(f"{where}: {unknown_name('basis', curves.basis, _BASES)}")
    if curves.style not in ("round", "flat"):
        raise SceneError(f"{where}: {unknown_name('style', curves.style, ('round', 'flat'))}")
    order, step, matrix = _BASES[curves.basis]
    given = [len(points)] if curves.counts is None else curves.counts
    counts = arguments.array(f"{where}: counts", given)
    if counts.ndim != 1 or counts.dtype.kind not in "iu" or counts.sum() != len(points):
        raise SceneError(
            f"{where}: counts must be (S,) whole numbers whose sum is that of the points,"
            f" {len(points)}"
        )
    counts = counts.astype(np.int64)
    if len(points) == 0:
        counts = counts[:0]
    bad = np.flatnonzero((counts < order) | ((counts - order) % step != 0))
    if bad.size:
        rule = {"linear": "at least 2", "bezier": "3 k + 1", "bspline": "at least 4"}
        raise SceneError(
            f"{where}: counts[{bad[0]}] is {counts[bad[0]]}; a {curves.basis} strand has"
            f" {rule[curves.basis]} control points"
        )
    segments = (counts - order) // step + 1
    strand = np.repeat(np.arange(len(counts)), segments)
    within = np.arange(len(strand)) - np.repeat(np.cumsum(segments) - segments, segments)
    first = np.repeat(np.cumsum(counts) - counts, segments) + step * within
    window = first[:, None] + np.arange(order)
    controls = np.einsum("ij,sjk->sik", matrix, points.astype(np.float64)[window])
    widths = np.einsum("ij,sj->si", matrix, radii.astype(np.float64)[window])
    total = segments[strand]
    along = np.stack([within / total, (within + 1) / total], axis=1)
    if curves.style == "flat":
        flags = np.full(len(strand), FLAT)
    else:
        # A linear strand has a corner at each joint, which a sphere fills.
        corner = curves.basis == "linear"
        starts, ends = within == 0, within == total - 1
        flags = np.where(np.where(starts, curves.capped, corner), CAP_START, 0)
        flags = flags + np.where(np.where(ends, curves.capped, corner), CAP_END, 0)
    return controls, widths, along, flags.astype(np.float64)
