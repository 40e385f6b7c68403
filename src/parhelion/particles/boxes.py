"""The box of a simulation, and its copies side by side where it is periodic."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..scene import Cylinders, Material, Solid, Spheres

Floats = NDArray[np.floating[Any]]

# A box whose volume is less than this share of its edges' product is flat.
_FLAT = 1e-9
# A drawn box: the radius of its edges as a share of their mean length, and their grey.
_EDGE = 0.0035
_EDGE_ALBEDO = 0.08
# Particles this near to a face, as a share of the box, lie on it, so that those of a crystal do not
# come out on one face or its opposite by rounding; single precision has some 1e-7.
_ON_FACE = 1e-6
# Steps after which the search for shorter edges ends; simulations' boxes need a few.
_MOST_STEPS = 1000


@dataclass(frozen=True, eq=False)
class Box:
    """A simulation box: its edges a, b, c as the rows of (3, 3) `vectors`, and its (3,) corner.

    periodic: along which of the edges the box is repeated; an edge of no length, as the third one
    of a flat system, is not.
    """

    vectors: Floats
    origin: Floats
    periodic: tuple[bool, bool, bool] = (True, True, True)

    def lattice(self) -> NDArray[np.float64]:
        """(k, 3), the edges along which the box is repeated, k from 0 to 3.

        Raises SceneError if these are not finite, or lie in a plane, or two in a line.
        """
        edges = np.asarray(self.vectors, np.float64)
        if not np.isfinite(edges).all():
            raise SceneError("the box is not finite")
        lengths = np.linalg.norm(edges, axis=1)
        found = edges[np.array(self.periodic) & (lengths > 0)]
        unit = found / np.linalg.norm(found, axis=1, keepdims=True)
        if len(found) and np.linalg.svd(unit, compute_uv=False)[-1] < _FLAT:
            raise SceneError("the box is flat: its edges lie in a plane, or two in a line")
        return np.asarray(found)

    def wrapped(self, positions: Floats) -> NDArray[np.float64]:
        """The positions, (N, 3), each moved into the box along the edges that are repeated.

        Raises SceneError if none is.
        """
        lattice = self.lattice()
        if not len(lattice):
            raise SceneError("the box is not periodic; there is nothing to wrap")
        places = (positions - self.origin) @ _dual(lattice)
        return positions - np.floor(places + _ON_FACE) @ lattice

    def shortest(self, differences: Floats) -> NDArray[np.float64]:
        """(N, 3) differences of positions, each between the nearest two copies."""
        lattice = reduced(self.lattice())
        best = differences - np.round(differences @ _dual(lattice)) @ lattice
        # in a reduced lattice the nearest copy is at most one edge farther along each
        squares = np.sum(best**2, axis=1)
        center = best.copy()
        for steps in product((-1.0, 0.0, 1.0), repeat=len(lattice)):
            other = center + np.array(steps) @ lattice
            nearer = np.sum(other**2, axis=1) < squares * (1 - 1e-9)
            best[nearer] = other[nearer]
            squares = np.minimum(squares, np.sum(best**2, axis=1))
        return best


def outline(box: Box) -> list[Solid]:
    """The twelve edges as tubes, without those that are shorter than thick, and spheres at corners.

    Raises SceneError for a box that is not finite, or all of whose edges have no length.
    """
    edges, origin = np.asarray(box.vectors, np.float64), np.asarray(box.origin, np.float64)
    if not (np.isfinite(edges).all() and np.isfinite(origin).all()):
        raise SceneError("the box is not finite")
    lengths = np.linalg.norm(edges, axis=1)
    drawn = lengths > _EDGE * lengths.mean()
    if not drawn.any():
        raise SceneError("the box has no extent")
    edges, lengths = edges[drawn], lengths[drawn]
    steps = np.array(list(product((0.0, 1.0), repeat=len(edges))))
    corners = origin + steps @ edges
    starts = [corners[steps[:, axis] == 0] for axis in range(len(edges))]
    ends = [corners[steps[:, axis] == 1] for axis in range(len(edges))]
    radius = _EDGE * float(lengths.mean())
    material = Material("diffuse", color=(_EDGE_ALBEDO,) * 3)
    return [
        Cylinders(
            np.concatenate(starts), np.concatenate(ends), radius, None, material, None, "box"
        ),
        Spheres(corners, radius, material, None, "box"),
    ]


def widths(lattice: Floats) -> NDArray[np.float64]:
    """(k,) distances of the opposite faces of a lattice's (k, 3) cell."""
    return np.asarray(1.0 / np.linalg.norm(_dual(lattice), axis=0))


def fractions(lattice: Floats, positions: Floats) -> NDArray[np.float64]:
    """(N, k) positions as multiples of a lattice's (k, 3) edges."""
    return np.asarray(positions @ _dual(lattice))


def reduced(lattice: Floats) -> NDArray[np.float64]:
    """Edges of the same lattice, (k, 3), that are as short and as square as they can be.

    Each edge is shortened by others until none can be, after I. Semaev, "A 3-dimensional lattice
    reduction algorithm" (CaLC 2001), so that a copy of a point that is nearest to another is among
    those next to it.
    """
    edges = np.array(lattice, np.float64)
    count = len(edges)
    for _ in range(_MOST_STEPS):
        before = edges.copy()
        for i in range(count):
            others = np.delete(edges, i, axis=0)
            for other in others:
                edges[i] -= np.round(edges[i] @ other / (other @ other)) * other
            for signs in product((-1.0, 0.0, 1.0), repeat=count - 1):
                changed = edges[i] + np.array(signs) @ others
                if changed @ changed < (1 - 1e-9) * (edges[i] @ edges[i]):
                    edges[i] = changed
        if np.array_equal(before, edges):
            break
    return edges


def _dual(lattice: Floats) -> NDArray[np.float64]:
    """(3, k) matrix that makes multiples of the edges, (k, 3), of positions."""
    if not len(lattice):
        return np.zeros((3, 0))
    # by unit edges, so that those of very different lengths all count
    lengths = np.linalg.norm(lattice, axis=1)
    dual: NDArray[np.float64] = np.linalg.pinv(lattice / lengths[:, None]) / lengths
    return dual
