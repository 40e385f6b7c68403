"""Atoms of ASE and MDAnalysis, and their trajectories."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..io.text import Trajectory
from ..particles import Labels, Particles, biomolecular_labels, element_labels
from ..particles.boxes import Box
from .arrays import fields_of, floats

# What of MDAnalysis' attributes of atoms can be coloured by, by its names
_ATTRIBUTES = (
    "charges", "masses", "radii", "resids", "resnames", "segids", "chainIDs", "moltypes",
    "tempfactors", "occupancies", "record_types", "velocities", "forces",
)  # fmt: skip

# The share of atoms whose names must say elements for them to be names of a biomolecule's atoms;
# of some models of water a quarter are sites without any.
_MOSTLY = 0.5


def ase_atoms(thing: Any) -> Particles:
    """ASE's Atoms, with what its calculator has of each atom; or one Atom."""
    if not hasattr(thing, "get_positions"):
        return Particles(floats([thing.position]), elements=Labels.of([thing.symbol]))
    cell = np.asarray(thing.get_cell()[:], np.float64)
    x, y, z = (bool(flag) for flag in thing.get_pbc())
    corner = np.zeros(3)
    if hasattr(thing, "get_celldisp"):
        corner = np.asarray(thing.get_celldisp(), np.float64).reshape(3)
    box = Box(cell, corner, (x, y, z)) if cell.any() else None
    computed = getattr(getattr(thing, "calc", None), "results", None) or {}
    return Particles(
        floats(thing.get_positions()),
        elements=Labels.of(thing.get_chemical_symbols()),
        fields=fields_of({**computed, **dict(thing.arrays)}, len(thing), ("numbers", "positions")),
        box=box,
        bonds=_bonds_in_words(thing.arrays.get("bonds")),
    )


def ase_frames(thing: Any) -> Trajectory:
    """Atoms one after the other: a list of them, or what ASE reads from a file."""
    return Trajectory(len(thing), lambda number: ase_atoms(thing[number]))


def _bonds_in_words(words: Any) -> Any:
    """The bonds that ASE's reader of LAMMPS data files leaves: of each atom the indices of others
    and the types of bonds, "5(1),7(2)", or "_"; None where there are none.
    """
    if words is None or np.asarray(words).dtype.kind != "U":
        return None
    found = [
        (i, int(other))
        for i, word in enumerate(np.asarray(words).tolist())
        for other in re.findall(r"(\d{1,18})\(", word)
    ]
    return np.array(found, np.int64).reshape(-1, 2)


def mdanalysis_atoms(thing: Any) -> Particles:
    """MDAnalysis' Universe, AtomGroup, Residue, Segment ... at the frame where they are."""
    atoms = thing.atoms
    found = {name: getattr(atoms, name) for name in _ATTRIBUTES if hasattr(atoms, name)}
    # by the names that files have for these
    for name, theirs in (("chain", ("chainIDs", "segids")), ("residue", ("resnames",))):
        known = [found[key] for key in theirs if key in found and any(found[key])]
        if known:
            found[name] = known[0]
    names = getattr(atoms, "names", None)
    return Particles(
        floats(atoms.positions),
        elements=_elements(atoms),
        types=None if names is None else _words(names),
        fields=fields_of(found, len(atoms)),
        box=_triclinic(getattr(atoms, "dimensions", None)),
        bonds=_bonds_within(atoms),
    )


@contextmanager
def mdanalysis_frames(thing: Any) -> Iterator[Trajectory]:
    """The frames of a universe's trajectory, which is left where it was."""
    trajectory = thing.universe.trajectory
    before = trajectory.frame

    def read(number: int) -> Particles:
        trajectory[number]
        return mdanalysis_atoms(thing)

    try:
        yield Trajectory(len(trajectory), read)
    finally:
        trajectory[before]


def _words(values: Any) -> Labels:
    return Labels.of(np.asarray(values).astype(str))


def _elements(atoms: Any) -> Labels | None:
    """What the topology says; else what names say, those of residues' atoms as in files of them, of
    which CA is carbon; else types.
    """
    said = getattr(atoms, "elements", None)
    labels = None if said is None else element_labels(_words(said))
    names, residues = getattr(atoms, "names", None), getattr(atoms, "resnames", None)
    if labels is None and names is not None and residues is not None:
        found = biomolecular_labels(_words(names), _words(residues))
        labels = found if np.mean(found.codes > 0) > _MOSTLY else None
    for values in (names, getattr(atoms, "types", None)):
        if labels is None and values is not None:
            labels = element_labels(_words(values))
    return labels


def _triclinic(dimensions: Any) -> Box | None:
    """The box of three edges and the angles between them in degrees, as MDAnalysis has it: a along
    x, b in the xy plane.
    """
    if dimensions is None or not np.any(dimensions[:3]):
        return None
    a, b, c, *angles = np.asarray(dimensions, np.float64)
    alpha, beta, gamma = np.cos(np.radians(angles))
    sine = np.sqrt(1 - gamma**2)
    y = (alpha - beta * gamma) / sine
    z = np.sqrt(max(0.0, 1 - beta**2 - y**2))
    vectors = [[a, 0, 0], [b * gamma, b * sine, 0], [c * beta, c * y, c * z]]
    return Box(np.array(vectors), np.zeros(3))


def _bonds_within(atoms: Any) -> Any:
    """The bonds of MDAnalysis' atoms, of which both ends are among them, by their places; or None.

    A topology without bonds raises an AttributeError.
    """
    bonds = getattr(atoms, "bonds", None)
    if bonds is None or not len(bonds):
        return None
    pairs = np.asarray(bonds.indices if hasattr(bonds, "indices") else bonds)
    own = np.asarray(atoms.indices)
    places = np.full(max(int(own.max()), int(pairs.max())) + 1, -1)
    places[own] = np.arange(len(own))
    pairs = places[pairs]
    return pairs[(pairs >= 0).all(axis=1)]
