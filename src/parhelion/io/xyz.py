"""XYZ and extended XYZ, one frame or many.

A frame is a line with the number of atoms, a line of comment, and a line for each atom: a label
and three coordinates, and maybe more columns. In extended XYZ the comment has key=value pairs;
Lattice="ax ay az bx by bz cx cy cz" is the box, pbc="T T F" along which edges it is repeated, and
Properties=species:S:1:pos:R:3:... names the columns (name, R real, I integer, S string or L
logical, number of columns).
"""

from __future__ import annotations

import re
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import particles
from ..errors import SceneError
from ..particles import Labels, Particles, element_labels, elements, linear, to_scene
from ..particles.boxes import Box
from ..particles.glyphs import ellipsoids
from ..scene import Scene
from . import LoadOptions
from .text import Table, TextFile, Trajectory, is_number, text_frame, text_trajectory

NAME = "XYZ"
OPTIONS = particles.OPTIONS
BARE = True
PARTS = True

# More columns than any program writes; a count beyond it is a broken file.
_MOST_COLUMNS = 1000

_PAIR = re.compile(r"""([\w.\-]+)\s*=\s*("[^"]*"|'[^']*'|\{[^}]*\}|\[[^\]]*\]|\S+)""")


def load(path: Path, options: LoadOptions) -> Scene:
    """One frame of the file as a scene. Raises FormatError, SceneError."""
    return to_scene(read(path, int(options.frame)), options, path.name)


def read(path: Path, frame: int = 0) -> Particles:
    """The particles of one frame, counted from 0, or from the end if negative.

    Raises FormatError for a file that is broken or has no such frame.
    """
    return text_frame(path, frame, _skip, _frame)


def contents(path: Path, options: LoadOptions) -> dict[str, Any]:
    """What one frame has, and can be coloured by. Raises FormatError."""
    return particles.contents(read(path, int(options.frame)))


def trajectory(path: Path, _: LoadOptions) -> AbstractContextManager[Trajectory]:
    """All frames. Raises FormatError for a file that is broken."""
    return text_trajectory(path, _skip, _frame)


def _frame(file: TextFile) -> Particles:
    """The particles of the frame that starts here."""
    count = _count(file)
    assert count is not None  # seek_frame sees to it
    if not count:
        raise file.error("there are no atoms")
    comment = file.readline()
    first = file.peek()
    if comment is None or first is None:
        raise file.error(f"the file ends after 0 of {count} atoms")
    pairs = {key.lower(): value.strip("\"'{}[]") for key, value in _PAIR.findall(comment)}
    words = first.split()
    if "properties" in pairs:
        columns = _properties(file, pairs["properties"])
    else:
        columns = _plain(file, words)
    box = _box(file, pairs)
    names = [name for name, _, size in columns for _ in range(size)]
    kinds = [kind for _, kind, size in columns for _ in range(size)]
    text = [i for i, kind in enumerate(kinds) if kind in "SL"]
    table = file.table(count, names, text)
    return _particles(table, columns, box)


def _count(file: TextFile) -> int | None:
    """The number of atoms, from the first line of a frame; None at the end of the file."""
    line = file.readline()
    while line == "":  # blank lines between frames, and at the end
        line = file.readline()
    if line is None:
        return None
    if not re.fullmatch(r"\d{1,18}", line):
        raise file.error(f"should be the number of atoms, not {line[:40]!r}")
    return int(line)


def _skip(file: TextFile) -> bool:
    count = _count(file)
    if count is None:
        return False
    if not file.skip(count + 1):
        raise file.error(f"the file ends within a frame of {count} atoms")
    return True


def _plain(file: TextFile, words: list[str]) -> list[tuple[str, str, int]]:
    """Columns by the first atom's line: a label and a position, or a position alone."""
    if len(words) == 3 and all(map(is_number, words)):
        return [("pos", "R", 3)]
    if not 4 <= len(words) <= _MOST_COLUMNS:
        raise file.error(f"has {len(words)} columns, not a label, x, y and z", file.line + 1)
    extra = [
        (f"column{i}", "R" if is_number(word) else "S", 1)
        for i, word in enumerate(words[4:], start=5)
    ]
    return [("species", "S", 1), ("pos", "R", 3), *extra]


def _properties(file: TextFile, text: str) -> list[tuple[str, str, int]]:
    """Name, kind and number of columns of each property."""
    parts = text.split(":")
    shown = f"Properties={text[:60]}"
    if len(parts) % 3:
        raise file.error(f"{shown} is not a list of name:kind:columns")
    columns: list[tuple[str, str, int]] = []
    for name, kind, size in zip(parts[0::3], parts[1::3], parts[2::3], strict=True):
        if kind not in ("R", "I", "S", "L"):
            raise file.error(f"{shown}: {name} is of kind {kind!r}, not R, I, S or L")
        if not re.fullmatch(r"[1-9]\d{0,3}", size) or int(size) > _MOST_COLUMNS:
            raise file.error(f"{shown}: {name} cannot have {size!r} columns")
        if name.lower() == "pos" and any(other.lower() == "pos" for other, _, _ in columns):
            raise file.error(f"{shown} has pos twice")
        columns.append((name, kind, int(size)))
    if not any(name.lower() == "pos" and kind in "RI" and n == 3 for name, kind, n in columns):
        raise file.error(f"{shown} has no pos:R:3")
    if sum(size for _, _, size in columns) > _MOST_COLUMNS:
        raise file.error(f"{shown} has more than {_MOST_COLUMNS} columns")
    return columns


def _box(file: TextFile, pairs: dict[str, str]) -> Box | None:
    if "lattice" not in pairs:
        return None
    words = pairs["lattice"].replace(",", " ").split()
    origin = pairs.get("origin", "0 0 0").replace(",", " ").split()
    if len(words) != 9 or len(origin) != 3 or not all(map(is_number, words + origin)):
        raise file.error(f"Lattice={pairs['lattice'][:60]!r} is not 9 numbers, or Origin not 3")
    flags = pairs.get("pbc", "T T T").replace(",", " ").split()
    if len(flags) != 3 or not all(re.fullmatch("[TtFf10]|true|false", f, re.I) for f in flags):
        raise file.error(f"pbc={pairs['pbc'][:60]!r} is not three of T and F")
    x, y, z = (flag[0] in "Tt1" for flag in flags)
    vectors = np.array(words, np.float64).reshape(3, 3)
    return Box(vectors, np.array(origin, np.float64), (x, y, z))


def _particles(table: Table, columns: list[tuple[str, str, int]], box: Box | None) -> Particles:
    """What the columns mean, by the names that ASE, OVITO and QUIP write; the rest are fields."""
    fields: dict[str, NDArray[np.float64] | Labels] = {}
    at = 0
    for name, kind, size in columns:
        parts = table.columns[at : at + size]
        at += size
        if size == 1:
            fields[name] = parts[0]
        elif kind in "SL":
            fields.update({f"{name}_{i}": part for i, part in enumerate(parts, start=1)})
        else:
            fields[name] = np.stack([table.numbers(i) for i in range(at - size, at)], axis=1)

    def numbers(name: str, width: int = 1) -> NDArray[np.float64] | None:
        """Takes numbers of one name, in any case, out of the fields."""
        for key, values in fields.items():
            if key.lower() == name and not isinstance(values, Labels):
                if (values.shape[1] if values.ndim == 2 else 1) != width:
                    continue
                del fields[key]
                return values
        return None

    def labels(name: str) -> Labels | None:
        for key, values in fields.items():
            if key.lower() == name and isinstance(values, Labels):
                del fields[key]
                return values
        return None

    positions = numbers("pos", 3)
    assert positions is not None  # _plain and _properties see to it
    radii = numbers("radius")
    colors = numbers("color", 3)
    # OVITO's names; its quaternions end in their real part
    glyphs = None
    if (semi_axes := numbers("aspherical_shape", 3)) is not None:
        turns = numbers("orientation", 4)
        glyphs = ellipsoids(semi_axes, None if turns is None else turns[:, [3, 0, 1, 2]])
        if turns is not None:  # may be of use for colours too
            fields["orientation"] = turns
    types = labels("type")
    if types is None and (codes := numbers("type")) is not None:
        types = Labels.of(codes)
    species = labels("species") or labels("element")
    if species is not None:
        symbols = element_labels(species)
        if symbols is None and types is None:
            types = species
    elif (atomic := numbers("z")) is not None:
        if not np.isin(atomic, np.arange(len(elements.SYMBOLS))).all():
            raise SceneError("Z has values that are not atomic numbers, 0 to 118")
        symbols = Labels(atomic.astype(np.int32), elements.SYMBOLS)
    else:
        symbols = element_labels(types) if types is not None else None
    srgb = None if colors is None else linear(colors)
    return Particles(positions, symbols, types, radii, srgb, fields, box, glyphs=glyphs)
