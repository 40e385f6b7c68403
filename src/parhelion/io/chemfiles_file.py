"""PDB and GRO files through chemfiles (an extra). Lengths are in angstrom, also those of GRO.

Elements are those that a PDB file gives; where it, or GRO, has only names of atoms, they are
told by these, see elements.biomolecular_number. Warnings of chemfiles go to logging. Of PDB files
we read what concerns bonds ourselves.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import elements, particles
from ..boxes import Box
from ..errors import FormatError, SceneError
from ..particles import Labels, Particles, to_scene
from ..scene import Scene
from . import COMPRESSED, LoadOptions
from .text import TextFile, errors_name, frame_index

NAME = "PDB, GRO"
SUFFIXES = (".pdb", ".gro")
OPTIONS = particles.OPTIONS
BARE = True

_logger = logging.getLogger(__name__)
# Names of atoms, residues or chains that are told apart; the rest are called "X".
_MOST_NAMES = 500
# Warnings of one file that are logged, few of which concern a picture; files may have one a line.
_MOST_WARNINGS = 5

_BONDS = re.compile(rb"^CONECT(.*)\n", re.MULTILINE)
# The serial number of an atom, five characters; and the end of the first of several models
_SERIAL = re.compile(rb"^(?:ATOM  |HETATM)(.{5})|^(ENDMDL)", re.MULTILINE)
# Lengths of a box's edges, and the rest; a cube of 1 angstrom stands for none
_BOX = re.compile(rb"^CRYST1(.{9})(.{9})(.{9})(.*)\n", re.MULTILINE)


def load(path: Path, options: LoadOptions) -> Scene:
    """One frame of the file as a scene. Raises FormatError, SceneError."""
    return to_scene(read(path, options.frame), options, path.name)


def read(path: Path, frame: int = 0) -> Particles:
    """The particles of one frame, counted from 0, or from the end if negative.

    Raises FormatError for a file that is broken or has no such frame, or without chemfiles.
    """
    try:
        import chemfiles
    except ImportError:
        raise FormatError(
            f"{path}: PDB and GRO files need chemfiles: pip install chemfiles"
        ) from None
    # chemfiles hands its warnings to Python's, and its errors are no Exception
    records = _Records()
    with (
        errors_name(path),
        _plain_copy(path, records) as copy,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        try:
            with chemfiles.Trajectory(str(copy), "r", copy.suffix[1:].upper()) as trajectory:
                index = frame_index(path, frame, trajectory.nsteps)
                return _particles(chemfiles, trajectory.read_step(index), records, path)
        except chemfiles.ChemfilesError as error:
            reason = str(error).replace(str(copy), path.name)
            raise SceneError(f"chemfiles says: {reason[:200]}") from None
        except UnicodeDecodeError:
            raise SceneError("is not UTF-8 text") from None
        finally:
            for warning in caught[:_MOST_WARNINGS]:
                _logger.info("%s: %s", path, warning.message)
            if len(caught) > _MOST_WARNINGS:
                more = len(caught) - _MOST_WARNINGS
                _logger.info("%s: and %d more warnings of chemfiles", path, more)


class _Records:
    """What we read of a PDB file ourselves: bonds, by the atoms' serial numbers, which chemfiles
    does not keep, and whether its box is one and holds all that is in it.
    """

    def __init__(self) -> None:
        self.serials: list[bytes] = []  # of the first model
        self.conect: list[bytes] = []
        self.no_box = False
        self.symmetric = False  # the file has but a part of what is in the box
        self._whole = False

    def add(self, lines: bytes) -> None:
        """Whole lines of the file."""
        for *edges, rest in _BOX.findall(lines):
            self.no_box = all(edge.strip().rstrip(b"0") == b"1." for edge in edges)
            group = rest[22:33].split()
            self.symmetric = bool(group) and group not in ([b"P", b"1"], [b"P1"])
        self.conect += _BONDS.findall(lines)
        for serial, end in _SERIAL.findall(lines) if not self._whole else ():
            if end:
                self._whole = True
                break
            self.serials.append(serial)

    def bonds(self, path: Path, count: int) -> NDArray[np.intp]:
        """The bonds of `count` atoms that CONECT records tell of, (B, 2).

        Records of atoms that are not there, as in files that were cut to a part, go to logging.
        """
        if not self.conect:
            return np.empty((0, 2), np.intp)
        indices: dict[bytes, int | None] = {}
        for i, serial in enumerate(self.serials[:count]):
            # serial numbers start anew after 99999 in some files: those say nothing
            indices[serial.strip()] = None if serial.strip() in indices else i
        found: list[tuple[int, int]] = []
        missing = 0
        for record in self.conect:
            first, *others = (indices.get(record[i : i + 5].strip()) for i in range(0, 25, 5))
            named = sum(1 for i in range(5, 25, 5) if record[i : i + 5].strip())
            good = [o for o in others if o is not None and first is not None and o != first]
            missing += named - len(good)
            found += [(first, o) for o in good if first is not None]
        if missing:
            _logger.info("%s: %d bonds in CONECT are of atoms that are not there", path, missing)
        return np.array(found, np.intp).reshape(-1, 2)


@contextmanager
def _plain_copy(path: Path, records: _Records) -> Iterator[Path]:
    """A temporary copy that chemfiles 0.10 reads safely, whatever the file holds.

    It is not compressed, as chemfiles unpacks any bomb to memory, and has no CONECT records, as
    one that comes before the first atom crashes the process.
    """
    kind = next(s.lower() for s in reversed(path.suffixes) if s.lower() not in COMPRESSED)
    with TemporaryDirectory() as folder, TextFile(path) as file:
        if file.peek() is None:
            raise FormatError(f"{path}: is empty")
        copy = Path(folder, f"copy{kind}")
        with copy.open("wb") as plain:
            for block in file.blocks():
                if kind == ".pdb":
                    records.add(block)
                    block = _BONDS.sub(b"", block)
                plain.write(block)
        yield copy


def _particles(chemfiles: Any, frame: Any, records: _Records, path: Path) -> Particles:
    atoms, topology = frame.atoms, frame.topology
    count = len(atoms)
    if not count:
        raise SceneError("there are no atoms")

    def name_of_residue(atom: int) -> str:
        residue = topology.residue_for_atom(atom)
        return "" if residue is None else str(residue.name)

    def name_of_chain(atom: int) -> str:
        residue = topology.residue_for_atom(atom)
        known = residue is not None and "chainname" in residue.list_properties()
        return str(residue["chainname"]) if known else ""

    def labels(selector: str, of_atom: Callable[[int], str]) -> Labels:
        """Labels of all atoms, by one selection a name: chemfiles has no arrays of names."""
        codes = np.full(count, -1)
        names: list[str] = []
        while len(names) < _MOST_NAMES and (codes < 0).any():
            first = int(np.argmin(codes))
            name = of_atom(first)
            if '"' in name:  # cannot be asked for
                break
            same = chemfiles.Selection(f'{selector} "{name}"').evaluate(frame)
            codes[np.asarray(same, np.intp)] = len(names)
            if codes[first] < 0:  # has no name
                break
            names.append(name)
        codes[codes < 0] = len(names)
        return Labels(codes, (*names, "X"))

    types = labels("type", lambda atom: str(atoms[atom].type))
    residues = labels("resname", name_of_residue)
    fields: dict[str, NDArray[Any] | Labels] = {"residue": residues}
    if name_of_chain(0):
        fields["chain"] = labels("[chainname] ==", name_of_chain)
    if frame.has_velocities():
        fields["velocity"] = np.array(frame.velocities)
    matrix = np.array(frame.cell.matrix)  # its columns are the edges
    known = matrix.any() and np.isfinite(matrix).all() and not records.no_box
    repeated = not records.symmetric  # else atoms would meet copies where their like are not drawn
    box = Box(matrix.T, np.zeros(3), (repeated,) * 3) if known else None
    numbers = _numbers(types, residues)
    symbols = Labels(numbers, elements.SYMBOLS)
    positions = np.array(frame.positions)
    # chemfiles knows those of standard residues, which a PDB file does not list
    bonds = np.concatenate(
        [records.bonds(path, count), topology.bonds.astype(np.intp).reshape(-1, 2)]
    )
    bonds = np.unique(np.sort(bonds, axis=1), axis=0)
    return Particles(
        positions, symbols, types, None, None, fields, box, bonds, bonds_complete=False
    )


def _numbers(types: Labels, residues: Labels) -> NDArray[np.intp]:
    """(N,) atomic numbers by the names of atoms, and of residues where these are ions."""
    others = np.array([elements.biomolecular_number(name, ion=False) for name in types.names])
    ions = np.array([elements.biomolecular_number(name, ion=True) for name in types.names])
    numbers = types.each(others)
    for kind in np.flatnonzero(ions != others).tolist():
        letters = [c for c in types.names[kind].upper() if c.isalpha()]
        alone = [[c for c in name.upper() if c.isalpha()] == letters for name in residues.names]
        of_kind = (types.codes == kind) & residues.each(np.array(alone))
        numbers[of_kind] = ions[kind]
    return numbers
