"""PDB and GRO files through chemfiles (an extra). Lengths are in angstrom, also those of GRO.

Elements are those that a PDB file gives; where it, or GRO, has only names of atoms, they are
told by these, see elements.biomolecular_number. Warnings of chemfiles go to logging. Of PDB files
we read what concerns bonds and biological assemblies ourselves:
https://www.wwpdb.org/documentation/file-format-content/format33/v3.3.html
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import particles
from ..errors import FormatError, SceneError
from ..particles import FARTHEST, Copies, Labels, Particles, biomolecular_labels, to_scene
from ..particles.boxes import Box
from ..scene import Scene
from . import COMPRESSED, LoadOptions, require_memory
from .text import TextFile, Trajectory, errors_name, frame_index

NAME = "PDB, GRO"
OPTIONS = (*particles.OPTIONS, "assembly")
BARE = True
PARTS = True

_logger = logging.getLogger(__name__)
# Names of atoms, residues or chains that are told apart; the rest are called "X".
_MOST_NAMES = 500
# Warnings of one file that are logged, few of which concern a picture; files may have one a line.
_MOST_WARNINGS = 5

_BONDS = re.compile(rb"^CONECT(.*)\n", re.MULTILINE)
# Of an atom the serial number, five characters, the alternate location and the chain, one each; the
# end of the first model
_ATOM = re.compile(rb"^(?:ATOM  |HETATM)(.{5})(?:.{5}(.).{4}(.))?|^(ENDMDL)", re.MULTILINE)
# Biological assemblies
_ASSEMBLY = re.compile(rb"^REMARK 350(.*)\n", re.MULTILINE)
# How far the product of a rotation and its transpose may be off from 1; files have six decimals.
_ROTATION = 1e-3
# Lengths of a box's edges, and the rest; a cube of 1 angstrom stands for none
_BOX = re.compile(rb"^CRYST1(.{9})(.{9})(.{9})(.*)\n", re.MULTILINE)


def load(path: Path, options: LoadOptions) -> Scene:
    """One frame of the file as a scene. Raises FormatError, SceneError."""
    return to_scene(read(path, int(options.frame), options.assembly), options, path.name)


def read(path: Path, frame: int = 0, assembly: int | None = None) -> Particles:
    """The particles of one frame, counted from 0, or from the end if negative.

    assembly: the number of a biological assembly, by which they are copied; None for what is in the
    file. Raises FormatError for a file that is broken or has no such frame or assembly, or without
    chemfiles.
    """
    with _opened(path, assembly, _Records()) as frames:
        return frames.read(frame_index(path, frame, frames.count))


def contents(path: Path, options: LoadOptions) -> dict[str, Any]:
    """What one frame has, and can be coloured by, and assemblies. Raises FormatError."""
    records = _Records()
    with _opened(path, None, records) as frames:
        found = frames.read(frame_index(path, int(options.frame), frames.count))
    assemblies = records.contents()
    return particles.contents(found) | ({"assemblies": assemblies} if assemblies else {})


def trajectory(path: Path, options: LoadOptions) -> AbstractContextManager[Trajectory]:
    """All frames. Raises FormatError as read() does."""
    return _opened(path, options.assembly, _Records())


@contextmanager
def _opened(path: Path, assembly: int | None, records: _Records) -> Iterator[Trajectory]:
    """The file's frames; records: what is filled with the rest that is read of it."""
    try:
        import chemfiles
    except ImportError:
        raise FormatError(
            f"{path}: PDB and GRO files need chemfiles: pip install chemfiles"
        ) from None
    with ExitStack() as stack:
        copy = stack.enter_context(_plain_copy(path, records))
        errors = _Errors(path, copy, chemfiles)
        with errors.named():
            opened = chemfiles.Trajectory(str(copy), "r", copy.suffix[1:].upper())
            file = stack.enter_context(opened)

        def at(frame: int) -> Particles:
            with errors.named():
                found = _particles(chemfiles, file.read_step(frame), records, path)
                if assembly is None:
                    return found
                return replace(found, copies=records.copies(assembly, len(found.positions)))

        if file.nsteps:
            require_memory(path, copy.stat().st_size // file.nsteps)
        yield Trajectory(file.nsteps, at)


class _Errors:
    """What chemfiles says about a file: warnings, which are logged, and errors."""

    def __init__(self, path: Path, copy: Path, chemfiles: Any) -> None:
        self._path, self._copy, self._chemfiles = path, copy, chemfiles
        self._told = 0

    @contextmanager
    def named(self) -> Iterator[None]:
        """Raises FormatErrors for errors in the block."""
        path = self._path
        # chemfiles hands its warnings to Python's, and its errors are no Exception
        with errors_name(path), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                yield
            except self._chemfiles.ChemfilesError as error:
                reason = str(error).replace(str(self._copy), path.name)
                raise SceneError(f"chemfiles says: {reason[:200]}") from None
            except UnicodeDecodeError:
                raise SceneError("is not UTF-8 text") from None
            finally:
                room = max(0, _MOST_WARNINGS - self._told)
                for warning in caught[:room]:
                    _logger.info("%s: %s", path, warning.message)
                if self._told <= _MOST_WARNINGS < self._told + len(caught):
                    _logger.info("%s: and more warnings of chemfiles", path)
                self._told += len(caught)


class _Records:
    """What we read of a PDB file ourselves: bonds, by the atoms' serial numbers, which chemfiles
    does not keep, biological assemblies, and whether its box is one and holds all that is in it.
    """

    def __init__(self) -> None:
        self.atoms: list[tuple[bytes, bytes, bytes]] = []  # as in _ATOM, of the first model
        self.conect: list[bytes] = []
        self.remarks: list[bytes] = []
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
        self.remarks += _ASSEMBLY.findall(lines)
        for *atom, end in _ATOM.findall(lines) if not self._whole else ():
            if end:
                self._whole = True
                break
            serial, place, chain = atom
            self.atoms.append((serial, place, chain))

    def bonds(self, path: Path, count: int) -> NDArray[np.intp]:
        """The bonds of `count` atoms that CONECT records tell of, (B, 2).

        Records of atoms that are not there, as in files that were cut to a part, go to logging.
        """
        if not self.conect:
            return np.empty((0, 2), np.intp)
        indices: dict[bytes, int | None] = {}
        for i, (serial, _, _) in enumerate(self.atoms[:count]):
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

    def alternates(self, count: int) -> NDArray[np.intp] | None:
        """Numbers of the atoms' alternate locations, 0 for none; None if no atom has any."""
        places = [place.strip() for _, place, _ in self.atoms]
        if len(places) != count or not any(places):
            return None
        return np.unique([b"", *places], return_inverse=True)[1][1:].astype(np.intp)

    def copies(self, assembly: int, count: int) -> list[Copies]:
        """By which `count` atoms become a biological assembly. Raises SceneError."""
        known = self._assemblies()
        if assembly not in known:
            has = ", ".join(map(str, known)) or "none"
            raise SceneError(f"has no assembly {assembly} in REMARK 350; it has {has}")
        if len(self.atoms) != count:
            raise SceneError("assemblies need models of the same atoms")
        names, codes = np.unique([chain for _, _, chain in self.atoms], return_inverse=True)
        found = []
        for chains, rows in known[assembly]:
            chosen = np.isin(names, list(chains))[codes.reshape(-1)]
            transforms = [
                _rotation(parts, f"assembly {assembly}: BIOMT {serial}")
                for serial, parts in rows.items()
            ]
            found.append(Copies(chosen, np.array(transforms).reshape(-1, 3, 4)))
        if not any(len(copies.transforms) and copies.chosen.any() for copies in found):
            raise SceneError(f"assembly {assembly} has no chain that is in the file, or no BIOMT")
        return found

    def contents(self) -> dict[str, dict[str, Any]]:
        """Of each assembly, by its number: the chains, and how many copies it has of them."""
        return {
            str(number): {
                "chains": sorted({c.decode("latin-1") for chains, _ in parts for c in chains}),
                "copies": sum(len(rows) for _, rows in parts),
            }
            for number, parts in self._assemblies().items()
        }

    def _assemblies(self) -> dict[int, list[tuple[set[bytes], dict[str, list[bytes]]]]]:
        """Of each assembly, by its number: chains, and of these the three rows of each matrix."""
        known: dict[int, list[tuple[set[bytes], dict[str, list[bytes]]]]] = {}
        numbers: list[int] = []
        for remark in self.remarks:
            key, colon, value = remark.partition(b":")
            if colon and key.strip() == b"BIOMOLECULE":
                numbers = [
                    int(n)
                    for n in value.replace(b",", b" ").split()
                    if re.fullmatch(rb"\d{1,9}", n)
                ]
                known.update({n: [] for n in numbers})
            elif colon and key.strip().endswith((b"APPLY THE FOLLOWING TO CHAINS", b"AND CHAINS")):
                chains = {b" " if c == b"NULL" else c for c in value.replace(b",", b" ").split()}
                for n in numbers:
                    if key.strip() == b"AND CHAINS" and known[n]:
                        known[n][-1][0].update(chains)
                    else:
                        known[n].append((set(chains), {}))
            elif remark[3:8] == b"BIOMT":
                for n in numbers:
                    if known[n]:
                        serial = remark[9:13].decode("ascii", "replace").strip()
                        known[n][-1][1].setdefault(serial, []).append(remark)
        return known


def _rotation(rows: list[bytes], where: str) -> NDArray[np.float64]:
    """The (3, 4) matrix of BIOMT's three rows. Raises SceneError for one that is no rotation."""
    if [row[8:9] for row in rows] != [b"1", b"2", b"3"]:
        raise SceneError(f"{where} has not three rows, 1 to 3")
    try:
        matrix = np.array(
            [[float(row[a:b]) for a, b in ((13, 23), (23, 33), (33, 43), (43, 58))] for row in rows]
        )
    except ValueError:
        raise SceneError(f"{where} does not hold numbers") from None
    turn = matrix[:, :3]
    off = np.abs(turn @ turn.T - np.eye(3)).max() if np.isfinite(matrix).all() else np.inf
    if not (off <= _ROTATION and np.linalg.det(turn) > 0 and np.abs(matrix).max() <= FARTHEST):
        raise SceneError(f"{where} is no rotation and translation")
    return matrix


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
    symbols = biomolecular_labels(types, residues)
    positions = np.array(frame.positions)
    # chemfiles knows those of standard residues, which a PDB file does not list
    bonds = np.concatenate(
        [records.bonds(path, count), topology.bonds.astype(np.intp).reshape(-1, 2)]
    )
    bonds = np.unique(np.sort(bonds, axis=1), axis=0)
    return Particles(
        positions,
        symbols,
        types,
        None,
        None,
        fields,
        box,
        bonds,
        bonds_complete=False,
        alternates=records.alternates(count),
    )
