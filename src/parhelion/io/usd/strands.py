"""Points and BasisCurves prims."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom

from ...scene import Curves, Spheres
from . import materials, primvars
from .solids import add_sphere, similarity

if TYPE_CHECKING:
    from .reader import Group, Matrix, Reader

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# The width of what has none, as in Hydra
_WIDTH = 1.0


def _scale(r: Reader, prim: Any, matrix: Matrix) -> float:
    """By how much a transform makes widths larger."""
    scale = similarity(matrix)
    if scale is None:
        r.report(f"{prim.GetPath()}: scaled unevenly: its widths are scaled evenly")
        scale = float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    if not scale > 0.0:
        raise r.error(prim, "its transform makes it flat")
    return scale


def _points(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    source = UsdGeom.Points(prim)
    points = r.array(prim, source.GetPointsAttr(), 3)
    if points is None or not len(points):
        return
    count = len(points)
    sizes = {"constant": 1, "uniform": 1, "vertex": count, "varying": count, "faceVarying": count}
    widths = _widths(r, prim, sizes)
    if widths is None:
        widths = np.full(1, _WIDTH)
    made = materials.plain(r, prim, sizes)
    radii = np.broadcast_to(0.5 * widths, count)
    good = radii > 0.0  # what has no size is not seen
    if not good.all():
        lost = int(count - good.sum())
        r.report(f"{prim.GetPath()}: widths of {lost} of {count} points are not above 0; left out")
    if not good.any():
        return
    colors = None if made.colors is None else np.broadcast_to(made.colors, (count, 3))[good]
    if count == 1:
        moved = matrix.copy()
        moved[:3, 3] += matrix[:3, :3] @ points[0]
        add_sphere(group, moved, float(radii[0]), made.material, colors, str(prim.GetPath()))
        return
    group.shapes.append(
        Spheres(
            (points @ matrix[:3, :3].T + matrix[:3, 3])[good],
            (_scale(r, prim, matrix) * radii)[good],
            made.material,
            colors,
            str(prim.GetPath()),
        )
    )


def _widths(r: Reader, prim: Any, sizes: dict[str, int]) -> Floats | None:
    """Diameters, as many as their interpolation has: primvars:widths, else widths."""
    source = UsdGeom.Points(prim) if prim.IsA(UsdGeom.Points) else UsdGeom.Curves(prim)
    found = primvars.read(r, prim, "widths", sizes, 1)
    if found is not None:
        return found.values[:, 0]
    values = r.array(prim, source.GetWidthsAttr())
    if values is None or not len(values):
        return None
    interpolation = str(source.GetWidthsInterpolation())
    if len(values) not in (1, sizes.get(interpolation)):
        r.report(
            f"widths of {prim.GetPath()}: {len(values)} values ({interpolation}) do not fit;"
            " ignored"
        )
        return None
    return values


# --- Curves --------------------------------------------------------------------------------------


def _curves(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    source = UsdGeom.BasisCurves(prim)
    points = r.array(prim, source.GetPointsAttr(), 3)
    counts = r.integers(source.GetCurveVertexCountsAttr())
    if points is None or not len(points) or not len(counts):
        return
    if counts.min() < 0 or counts.sum() != len(points):
        raise r.error(
            prim, f"curveVertexCounts add up to {counts.sum()}; there are {len(points)} points"
        )
    cubic = r.get(source.GetTypeAttr(), "cubic") == "cubic"
    basis = str(r.get(source.GetBasisAttr(), "bezier")) if cubic else "linear"
    wrap = str(r.get(source.GetWrapAttr(), "nonperiodic"))
    if basis not in ("linear", "bezier", "bspline", "catmullRom"):
        raise r.error(prim, f"basis is {basis!r}")
    if len(r.get(source.GetNormalsAttr(), ())):
        r.report(f"{prim.GetPath()}: normals of curves: not supported; they are round")
    strands = _Strands(points, counts, basis, wrap)
    sizes = {
        "constant": 1, "uniform": len(counts), "vertex": len(points),
        "varying": int(strands.varying().sum()),
    }  # fmt: skip
    widths = _widths(r, prim, sizes)
    if widths is None:
        widths = np.full(1, _WIDTH)
    size = strands.at_points(widths, sizes)[:, None]
    made = materials.plain(r, prim, sizes)
    values = [points @ matrix[:3, :3].T + matrix[:3, 3], 0.5 * _scale(r, prim, matrix) * size]
    if made.colors is not None:
        values.append(np.stack([strands.at_points(c, sizes) for c in made.colors.T], axis=1))
    controls, lengths, ours = strands.controls(np.concatenate(values, axis=1))
    if not len(lengths):
        r.report(f"{prim.GetPath()}: its curves have too few points; left out")
        return
    colors = None
    if made.colors is not None:
        colors = _of_segments(controls[:, 4:], lengths, ours).clip(0.0, 1.0)
    thick = controls[:, 3]
    # what has no width is thinner than anything that is seen
    thick = np.maximum(thick, 1e-6 * max(float(thick.max()), 1e-30))
    group.shapes.append(
        Curves(
            controls[:, :3], thick, lengths, ours, "round", False, made.material, colors,
            str(prim.GetPath()),
        )
    )  # fmt: skip


def _of_segments(values: Floats, counts: Integers, basis: str) -> Floats:
    """The mean over the control points in the middle of each segment."""
    order, step = {"linear": (2, 1), "bezier": (4, 3), "bspline": (4, 1)}[basis]
    segments = (counts - order) // step + 1
    strand = np.repeat(np.arange(len(counts)), segments)
    within = np.arange(len(strand)) - (np.cumsum(segments) - segments)[strand]
    first = (np.cumsum(counts) - counts)[strand] + step * within
    inner = (0, 1) if order == 2 else (1, 2)
    return np.asarray(0.5 * (values[first + inner[0]] + values[first + inner[1]]))


class _Strands:
    """Curves of one prim: how many values of each kind they have, and our control points."""

    def __init__(self, points: Floats, counts: Integers, basis: str, wrap: str) -> None:
        self.points = len(points)
        self.counts = counts
        self.basis = basis
        self.wrap = wrap if basis != "bezier" or wrap == "periodic" else "nonperiodic"

    def segments(self) -> Integers:
        """Of each curve."""
        n = self.counts
        if self.wrap == "periodic":
            return n // 3 if self.basis == "bezier" else n
        if self.basis == "linear" or self.wrap == "pinned":
            return np.maximum(n - 1, 0)
        return np.maximum((n - 4) // 3 + 1 if self.basis == "bezier" else n - 3, 0)

    def varying(self) -> Integers:
        """Values at the joints of segments, of each curve."""
        return self.segments() + (0 if self.wrap == "periodic" else 1)

    def at_points(self, values: Floats, sizes: dict[str, int]) -> Floats:
        """(P,) values at points, of any interpolation."""
        if len(values) == self.points:
            return values
        if len(values) == 1:
            return np.repeat(values, self.points)
        curve = np.repeat(np.arange(len(self.counts)), self.counts)
        if len(values) == len(self.counts):
            return values[curve]
        assert len(values) == sizes["varying"]
        within = np.arange(self.points) - (np.cumsum(self.counts) - self.counts)[curve]
        joints = self.varying()
        # which joint a control point lies at
        place: Floats
        if self.basis == "bezier":
            place = within / 3.0
        elif self.wrap == "nonperiodic" and self.basis != "linear":
            place = within - 1.0
        else:
            place = within / 1.0
        first = np.cumsum(joints) - joints
        last = np.maximum(joints - 1, 0)[curve]
        along = first[curve] + np.clip(place, 0.0, last)
        return np.asarray(np.interp(along, np.arange(len(values)), values))

    def controls(self, values: Floats) -> tuple[Floats, Integers, str]:
        """Control points of a basis that we have, how many of each curve, and its name.

        Curves of too few points are left out.
        """
        fewest = {"linear": 2, "bezier": 4}.get(self.basis, 4)
        if self.wrap == "pinned":
            fewest = 2
        elif self.wrap == "periodic":
            fewest = 3
        whole = self.counts >= fewest
        first = (np.cumsum(self.counts) - self.counts)[whole]
        counts = self.counts[whole]
        if not len(counts):
            return values[:0], counts, self.basis
        cubic = self.basis in ("bspline", "catmullRom")
        if self.basis == "bezier":  # what does not make a whole segment is left out
            counts = counts // 3 * 3 if self.wrap == "periodic" else (counts - 1) // 3 * 3 + 1
        size = counts
        if self.wrap == "periodic":
            size = counts + (3 if cubic else 1)
        elif self.wrap == "pinned" and cubic:
            size = counts + 2
        curve = np.repeat(np.arange(len(counts)), size)
        within = np.arange(len(curve)) - (np.cumsum(size) - size)[curve]
        n, start = counts[curve], first[curve]
        if self.wrap == "pinned" and cubic:
            at = start + np.clip(within - 1, 0, n - 1)
            result = values[at]
            # points beyond the ends, which make the curve end in its last points
            for end, beside in ((within == 0, 1), (within == n + 1, -1)):
                result[end] = 2.0 * values[at[end]] - values[at[end] + beside]
        else:
            result = values[start + within % n]
        if self.basis != "catmullRom":
            return result, size, self.basis
        return _bezier(result, size)


def _bezier(values: Floats, counts: Integers) -> tuple[Floats, Integers, str]:
    """Bezier control points of Catmull-Rom strands: between two points, a third of the way to the
    next in the direction of the chord of the neighbours.
    """
    segments = counts - 3
    strand = np.repeat(np.arange(len(counts)), segments)
    within = np.arange(len(strand)) - (np.cumsum(segments) - segments)[strand]
    at = (np.cumsum(counts) - counts)[strand] + within
    a, b, c, d = (values[at + k] for k in range(4))
    inner = np.stack([b, b + (c - a) / 6.0, c - (d - b) / 6.0], axis=1).reshape(-1, values.shape[1])
    # each strand's last point follows its segments
    last = np.cumsum(3 * segments)
    ends = values[np.cumsum(counts) - 2]
    return np.insert(inner, last, ends, axis=0), 3 * segments + 1, "bezier"


SHAPES: dict[str, Callable[[Reader, Any, Matrix, Group], None]] = {
    "Points": _points,
    "BasisCurves": _curves,
}
