"""Particles as arrays: what files and other libraries' objects become before they are drawn.

The frame of the data is kept, right-handed, with z up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError
from . import elements
from .boxes import Box
from .glyphs import Glyphs
from .limits import FARTHEST, Floats, refuse


@dataclass(frozen=True, eq=False)
class Labels:
    """A name for each particle, stored once a kind: particle i is names[codes[i]].

    codes: (N,) integers. names: not each needs to be in use.
    """

    codes: NDArray[np.integer[Any]]
    names: tuple[str, ...]

    @staticmethod
    def of(values: ArrayLike) -> Labels:
        """The labels of N strings or numbers, which are shown as str() shows them."""
        names, codes = np.unique(np.asarray(values), return_inverse=True)
        return Labels(codes.reshape(-1), tuple(str(name) for name in names.tolist()))

    @staticmethod
    def of_numbers(values: NDArray[np.floating[Any]]) -> Labels:
        """The labels of N numbers, whole ones without a decimal point."""
        whole = np.trunc(values)
        if (values == whole).all() and (np.abs(values) < 2**31).all():
            numbers = whole.astype(np.int32)
            low = int(numbers.min(initial=0))
            if int(numbers.max(initial=0)) - low < 2**16:  # no need to sort them
                used = np.bincount(numbers - low) > 0
                names = tuple(str(low + k) for k in np.flatnonzero(used).tolist())
                return Labels((np.cumsum(used) - 1).astype(np.int32)[numbers - low], names)
            return Labels.of(numbers)
        return Labels.of(values)

    def each(self, values: NDArray[Any]) -> NDArray[Any]:
        """What belongs to each particle, (N, ...), of what belongs to each name."""
        return np.take(values, self.codes, axis=0)


def element_labels(labels: Labels) -> Labels | None:
    """The labels as symbols of elements, if every one in use says an element; else None.

    One that does not makes the others doubtful: "A" and "B" are types, not something and boron.
    """
    numbers = [elements.atomic_number(name) for name in labels.names]
    used = np.bincount(labels.codes, minlength=len(numbers)) > 0
    if any(number is None for number, use in zip(numbers, used, strict=True) if use):
        return None
    return Labels(labels.codes, tuple(elements.SYMBOLS[number or 0] for number in numbers))


def biomolecular_labels(names: Labels, residues: Labels) -> Labels:
    """The elements of atoms by their names in files of proteins and the like, "X" where a name says
    none. residues: the names of those, by which ions are told.
    """
    others = np.array([elements.biomolecular_number(name, ion=False) for name in names.names])
    ions = np.array([elements.biomolecular_number(name, ion=True) for name in names.names])
    numbers = names.each(others)
    for kind in np.flatnonzero(ions != others).tolist():
        letters = [c for c in names.names[kind].upper() if c.isalpha()]
        alone = [[c for c in name.upper() if c.isalpha()] == letters for name in residues.names]
        of_kind = (names.codes == kind) & residues.each(np.array(alone))
        numbers[of_kind] = ions[kind]
    return Labels(numbers, elements.SYMBOLS)


@dataclass(frozen=True, eq=False)
class Copies:
    """Copies of some of N particles: of those that are True in (N,) `chosen`, one for each of the
    (M, 3, 4) matrices, a rotation and a translation.
    """

    chosen: NDArray[np.bool_]
    transforms: Floats


@dataclass(frozen=True, eq=False)
class Particles:
    """N particles as arrays, N > 0. Units are the data's own, angstrom where elements are known.

    positions: (N, 3). elements: their symbols, "X" for a dummy. types: any other sort of kind.
    radii: (N,). colors: (N, 3) linear RGB. fields: by name, (N,) or (N, M) numbers, or Labels.
    bonds: (B, 2) indices of particles, from 0; bonds_complete: False if distances tell of the bonds
    of particles that have none of these. alternates: (N,) numbers; distances tell of no bonds
    between particles of different ones, 0 apart. glyphs: what particles are instead of spheres.
    copies: what is drawn in the place of the particles themselves, if any. None stands for what is
    not known.
    Raises SceneError for arrays whose lengths differ, a position that is not finite, a radius that
    is not positive and a bond of a particle that is not there, naming the particle or bond, from 0.
    """

    positions: Floats
    elements: Labels | None = None
    types: Labels | None = None
    radii: Floats | None = None
    colors: Floats | None = None
    fields: Mapping[str, NDArray[Any] | Labels] = field(default_factory=dict)
    box: Box | None = None
    bonds: NDArray[np.integer[Any]] | None = None
    bonds_complete: bool = True
    alternates: NDArray[np.integer[Any]] | None = None
    glyphs: Glyphs | None = None
    copies: Sequence[Copies] = ()

    def __post_init__(self) -> None:
        """Checks what a scene needs; see the class."""
        shape = self.positions.shape
        if len(shape) != 2 or shape[1] != 3:
            raise SceneError(f"positions have shape {shape}, not (N, 3)")
        if not len(self.positions):
            raise SceneError("there are no particles")
        _check(
            self.positions,
            lambda p: np.abs(p) <= FARTHEST,  # False for NaN
            "position {} is not finite, or beyond 1e30",
        )
        lengths: dict[str, NDArray[Any] | Labels | None] = {
            "elements": self.elements,
            "types": self.types,
            "radii": self.radii,
            "colors": self.colors,
            "alternates": self.alternates,
            "glyphs": None if self.glyphs is None else self.glyphs.codes,
            **{f"copies[{i}]": copies.chosen for i, copies in enumerate(self.copies)},
            **{f"field {name!r}": values for name, values in self.fields.items()},
        }
        for name, values in lengths.items():
            array = values.codes if isinstance(values, Labels) else values
            if array is not None and len(array) != len(self.positions):
                raise SceneError(f"{name}: {len(array)} values for {len(self.positions)} particles")
        if self.radii is not None:
            check_radii(self.radii)
        if self.colors is not None:
            _check(self.colors, lambda c: (c >= 0) & (c <= 1), "colour {} is not within [0, 1]")
        if self.bonds is not None:
            _check_bonds(self.bonds, len(self.positions))


def _check(values: Floats, good: Callable[[Floats], NDArray[np.bool_]], text: str) -> None:
    """Raises SceneError for the first particle whose values are not all good."""
    fine = good(values)
    refuse(np.asarray(fine.reshape(len(fine), -1).all(axis=1)), values, text)


def check_radii(radii: Floats) -> None:
    _check(
        radii,
        lambda r: (np.minimum(r, FARTHEST).astype(np.float32) > 0) & (r <= FARTHEST),
        "radius {} is not a positive number of single precision",
    )


def _check_bonds(bonds: NDArray[np.integer[Any]], count: int) -> None:
    if bonds.ndim != 2 or bonds.shape[1] != 2 or bonds.dtype.kind not in "iu":
        raise SceneError(
            f"bonds are {bonds.dtype} of shape {bonds.shape}, not (B, 2) indices of particles"
        )
    good = (bonds >= 0) & (bonds < count)
    if not good.all():
        bond, end = np.argwhere(~good)[0].tolist()
        raise SceneError(
            f"bond {bond} is of particle {bonds[bond, end]}; there are particles 0 to {count - 1}"
        )


def atomic_numbers(labels: Labels) -> NDArray[np.intp]:
    """Atomic numbers of the names (not the particles) of element labels."""
    return np.array([elements.atomic_number(name) or 0 for name in labels.names], np.intp)
