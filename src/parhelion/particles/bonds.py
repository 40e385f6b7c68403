"""Bonds: those that distances tell of, and the sticks that show them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, option
from ..scene import Cylinders, Disks, Material, Solid
from .boxes import Box, fractions, reduced, widths

Floats = NDArray[np.floating[Any]]
Indices = NDArray[np.intp]

# Atoms are bonded that are nearer than the sum of their covalent radii and this, but not nearer
# than that, in angstrom: the figures of Jmol, Open Babel and OEChem.
TOLERANCE = 0.45
NEAREST = 0.4

# Bonds a particle, on average, beyond which a cutoff is a mistake: closest packings, with second
# neighbours, have 9, and every pair of a dense cloud would fill the memory.
_MOST_BONDS = 16
# Pairs a particle that are looked at, for the same reason; liquids and proteins have some 30.
_MOST_PAIRS = 1000
# Pairs that any cloud may have, so that small ones are never refused.
_FREE_PAIRS = 10_000_000
# Pairs that are looked at in one go
_CHUNK = 1 << 21
# Copies of a box that bonds may reach into; those of a primitive cell of iron are 26.
_MOST_COPIES = 1000


def by_distance(
    positions: Floats, reach: Floats, nearest: float, box: Box | None
) -> tuple[Indices, NDArray[np.float64]]:
    """Pairs of particles, (B, 2), and the way from the first to the second of each, (B, 3).

    Two particles are a pair where they are nearer than the sum of their reaches, (N,), and farther
    than `nearest`; a reach of 0 is none. Where the box is periodic the second may be a copy, also
    of the first. Raises SceneError where there are far more pairs than bonds can be.
    """
    able = np.flatnonzero(reach > 0)
    count, reach = len(able), reach[able]
    if not count:
        return np.empty((0, 2), np.intp), np.empty((0, 3))
    cutoff = 2.0 * float(reach.max())
    points, of, shifts = _with_copies(positions[able].astype(np.float64), cutoff, box)
    found: list[tuple[Indices, Indices]] = []
    total = 0
    for i, j in _near(points, cutoff, _FREE_PAIRS + _MOST_PAIRS * count):
        way = points[j] - points[i]
        squares = np.einsum("ij,ij->i", way, way)
        good = (squares < (reach[of[i]] + reach[of[j]]) ** 2) & (squares > nearest**2)
        # each bond to a copy is met from both of its sides, and of two copies elsewhere
        mine, other = (i < count) & (j < count), (i < count) != (j < count)
        first, second = np.where(i < count, i, j), np.where(i < count, j, i)
        once = (first < of[second]) | ((first == of[second]) & _positive(shifts[second]))
        good &= mine | (other & once)
        found.append((first[good], second[good]))
        total += len(found[-1][0])
        if total > _MOST_BONDS * count + 1000:
            raise SceneError(
                f"there are more than {_MOST_BONDS} bonds a particle within {cutoff:g}; are the"
                f" positions in angstrom, or should {option('bond_length')} be shorter?"
            )
    first = np.concatenate([a for a, _ in found]) if found else np.empty(0, np.intp)
    second = np.concatenate([b for _, b in found]) if found else np.empty(0, np.intp)
    return able[np.stack([first, of[second]], axis=1)], points[second] - points[first]


def _with_copies(
    positions: NDArray[np.float64], cutoff: float, box: Box | None
) -> tuple[NDArray[np.float64], Indices, NDArray[np.float64]]:
    """The particles, moved into the box, and after them the copies within a distance of it.

    Of each its place, whose copy it is, and by how many edges it was moved, (M, k).
    """
    of = np.arange(len(positions))
    lattice = reduced(box.lattice()) if box is not None else np.empty((0, 3))
    if not len(lattice):
        return positions, of, np.zeros((len(positions), 0))
    margin = cutoff / widths(lattice)
    steps = np.ceil(margin)
    if np.prod(2 * steps + 1) > _MOST_COPIES:
        raise SceneError(
            f"the box is only {widths(lattice).min():g} wide and bonds may be {cutoff:g} long"
        )
    places = fractions(lattice, positions)
    positions = positions - np.floor(places) @ lattice
    places -= np.floor(places)
    found, whose, by = [positions], [of], [np.zeros((len(of), len(lattice)))]
    outer = np.flatnonzero(((places < margin) | (places > 1 - margin)).any(axis=1))
    places = places[outer]
    for shift in product(*(np.arange(-n, n + 1) for n in steps)):
        if any(shift):
            moved = places + shift
            near = outer[((moved > -margin) & (moved < 1 + margin)).all(axis=1)]
            found.append(positions[near] + np.array(shift) @ lattice)
            whose.append(near)
            by.append(np.tile(shift, (len(near), 1)))
    return np.concatenate(found), np.concatenate(whose), np.concatenate(by)


def _positive(shifts: Floats) -> NDArray[np.bool_]:
    """Whether the first number of each row that is not 0 is positive."""
    sign = np.zeros(len(shifts))
    for column in shifts.T[::-1]:
        sign = np.where(column != 0, column, sign)
    return sign > 0


def _near(
    points: NDArray[np.float64], cutoff: float, most: int
) -> Iterator[tuple[Indices, Indices]]:
    """Pairs of points that are nearer than the cutoff, as two arrays of indices at a time.

    The points are sorted by cells as large as the cutoff, first by x, then y, then z. So the
    neighbours of a point that come after it are in five runs: the rest of its own cell and the next
    one, and three cells each of four other columns.
    """
    cells = np.empty((len(points), 3), np.int64)
    for axis in range(3):
        where = np.floor((points[:, axis] - points[:, axis].min()) / cutoff)
        # cells that hold nothing are left out, so that few numbers do for points far apart
        used, inverse = np.unique(where, return_inverse=True)
        ranks = np.cumsum(np.minimum(np.diff(used, prepend=used[0]), 2.0))
        cells[:, axis] = ranks.astype(np.int64)[inverse.reshape(-1)]
    sizes = [int(n) + 3 for n in cells.max(axis=0)]
    if sizes[0] * sizes[1] * sizes[2] >= 1 << 62:
        raise SceneError("the particles are too many and too far apart for bonds by distance")
    keys = ((cells[:, 0] + 1) * sizes[1] + cells[:, 1] + 1) * sizes[2] + cells[:, 2] + 1
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    axes = np.ascontiguousarray(points[order].T)  # neighbours lie near each other in memory too
    del cells
    column, slab = sizes[2], sizes[1] * sizes[2]
    runs = [(np.arange(1, len(keys) + 1), np.searchsorted(keys, keys + 1, "right"))]
    for offset in (column, slab - column, slab, slab + column):
        runs.append(
            (
                np.searchsorted(keys, keys + (offset - 1), "left"),
                np.searchsorted(keys, keys + (offset + 1), "right"),
            )
        )
    total = sum(int((end - start).sum()) for start, end in runs)
    if total > most:
        raise SceneError(
            f"the particles are too dense for bonds within {cutoff:g}: there are {total} pairs to"
            " look at; are the positions in angstrom, or should"
            f" {option('bond_length')} be shorter?"
        )
    for start, end in runs:
        counts = end - start
        ends = np.cumsum(counts)
        low = 0
        while low < len(counts):
            done = int(ends[low - 1]) if low else 0
            high = max(low + 1, int(np.searchsorted(ends, done + _CHUNK, "right")))
            n = counts[low:high]
            i = np.repeat(np.arange(low, high), n)
            j = np.arange(len(i)) + np.repeat(start[low:high] - (ends[low:high] - n - done), n)
            squares = np.zeros(len(i))
            for x in axes:
                squares += (x[j] - x[i]) ** 2
            near = np.flatnonzero(squares < cutoff**2)
            yield order[i[near]], order[j[near]]
            low = high


def sticks(
    positions: Floats, pairs: Indices, ways: Floats, colors: Floats, radius: float
) -> list[Solid]:
    """Two tubes a bond, each from a particle halfway to the other, in the particle's colour.

    ways: (B, 3), from the first to the second of each pair, whichever copy that is. Tubes that end
    in the air, as the second is drawn elsewhere, are closed by a disk.
    """
    places = np.asarray(positions, np.float64)
    first, second = pairs[:, 0], pairs[:, 1]
    starts = np.concatenate([places[first], places[second]])
    halves = 0.5 * np.concatenate([ways, -ways])
    whose = np.concatenate([first, second])
    size = np.linalg.norm(ways, axis=1)
    gap = np.linalg.norm(places[first] + ways - places[second], axis=1)
    cut = np.tile(gap > 1e-3 * size, 2)
    ends = starts + halves
    # what has no length in single precision is hidden by the particles anyway
    kept = (starts.astype(np.float32) != ends.astype(np.float32)).any(axis=1)
    if not kept.any():
        return []
    material = Material("diffuse")
    shapes: list[Solid] = [
        Cylinders(starts[kept], ends[kept], radius, None, material, colors[whose[kept]], "bonds")
    ]
    cut &= kept
    if cut.any():
        along = halves[cut] / np.linalg.norm(halves[cut], axis=1, keepdims=True)
        side = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)])
        side *= radius / np.linalg.norm(side, axis=1, keepdims=True)
        other = np.cross(along, side)
        shapes.append(Disks(ends[cut], side, other, material, colors[whose[cut]], "bonds"))
    return shapes
