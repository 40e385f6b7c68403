"""LAMMPS dump files in text, style atom or custom, one frame or many.

A frame is a series of items, each a line "ITEM: ..." and its values; the last one, "ITEM: ATOMS",
names the columns. https://docs.lammps.org/dump.html is the reference.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import particles
from ..errors import SceneError
from ..particles import Labels, Particles, element_labels, to_scene
from ..particles.boxes import Box
from ..particles.glyphs import ellipsoids
from ..scene import Scene
from . import LoadOptions
from .text import Table, TextFile, Trajectory, is_number, text_frame, text_trajectory

NAME = "LAMMPS dump"
OPTIONS = particles.OPTIONS
BARE = True
PARTS = True

# Columns of positions, best first: wrapped, unwrapped, and both as fractions of the box's edges.
_POSITIONS = (("x", "y", "z"), ("xu", "yu", "zu"), ("xs", "ys", "zs"), ("xsu", "ysu", "zsu"))

# The axes of ellipsoids, as full lengths, and their quaternions, the real part first: as LAMMPS
# calls them, and computes of them by names in use.
_DIAMETERS = (
    ("shapex", "shapey", "shapez"),
    *(tuple(f"c_{name}[{i}]" for i in (1, 2, 3)) for name in ("shape", "diameter")),
)
_QUATERNIONS = (
    ("quatw", "quati", "quatj", "quatk"),
    *(tuple(f"c_{name}[{i}]" for i in (1, 2, 3, 4)) for name in ("q", "quat", "orient")),
)


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
    header = _header(file)
    assert header is not None  # seek_frame sees to it
    count, box, names = header
    words = (file.peek() or "").split()
    # whatever is no number in the first row is a column of names
    text = [
        i
        for i, name in enumerate(names)
        if name == "element" or (i < len(words) and not is_number(words[i]))
    ]
    axes = _axes(file, names, text)
    return _particles(file.table(count, names, text), names, axes, box)


def _skip(file: TextFile) -> bool:
    header = _header(file)
    if header is None:
        return False
    if not file.skip(header[0]):
        raise file.error(f"the file ends within a frame of {header[0]} atoms")
    return True


def _header(file: TextFile) -> tuple[int, Box | None, list[str]] | None:
    """The number of atoms, the box and the names of columns; None at the end of the file.

    Reads on to the first row of atoms.
    """
    count: int | None = None
    box: Box | None = None
    line = file.readline()
    while line == "":  # blank lines at the end
        line = file.readline()
    if line is None:
        return None
    while line is not None:
        if not line.startswith("ITEM:"):
            raise file.error(f"should be an ITEM of a LAMMPS dump, not {line[:40]!r}")
        item = line[len("ITEM:") :].strip()
        if item.startswith("NUMBER OF ATOMS"):
            value = file.readline() or ""
            if not re.fullmatch(r"\d{1,18}", value):
                raise file.error(f"should be the number of atoms, not {value[:40]!r}")
            count = int(value)
        elif item.startswith("BOX BOUNDS"):
            box = _box(file, item)
        elif item.startswith("ATOMS"):
            if count is None:
                raise file.error("ITEM: ATOMS comes before ITEM: NUMBER OF ATOMS")
            return count, box, item.split()[1:]
        else:  # TIMESTEP, TIME, UNITS: a line each, of no use here
            file.readline()
        line = file.readline()
    raise file.error("the file ends before ITEM: ATOMS")


def _box(file: TextFile, item: str) -> Box:
    """The box from three lines: lo hi, or lo hi tilt, or a vector and a part of the origin.

    The item may end in the axes' boundary conditions, of which "pp" is periodic.
    """
    ends = re.search(r"(?:\s+([pfsm]{2})){3}$", item)
    x, y, z = (flag == "pp" for flag in (ends.group().split() if ends else ["pp"] * 3))
    general = "abc origin" in item
    triclinic = not general and item.split()[2:5] == ["xy", "xz", "yz"]
    size = 4 if general else 3 if triclinic else 2
    rows = []
    for _ in range(3):
        words = (file.readline() or "").split()
        if len(words) != size or not all(map(is_number, words)):
            raise file.error(
                f"should be {size} numbers of {item[:40]}, not {' '.join(words)[:60]!r}"
            )
        rows.append([float(word) for word in words])
    values = np.array(rows)
    if not np.isfinite(values).all():
        raise file.error("the box is not finite")
    if general:
        return Box(values[:, :3], values[:, 3], (x, y, z))
    low, high = values[:, 0].copy(), values[:, 1].copy()
    xy, xz, yz = values[:, 2] if triclinic else (0.0, 0.0, 0.0)
    # what the file bounds is the box that is straight and holds the tilted one
    low[0] -= min(0.0, xy, xz, xy + xz)
    high[0] -= max(0.0, xy, xz, xy + xz)
    low[1] -= min(0.0, yz)
    high[1] -= max(0.0, yz)
    if (high < low).any():
        raise file.error("the box ends before it begins")
    vectors = np.diag(high - low)
    vectors[1, 0], vectors[2, 0], vectors[2, 1] = xy, xz, yz
    return Box(vectors, low, (x, y, z))


def _axes(file: TextFile, names: list[str], text: list[int]) -> tuple[str, str, str]:
    """The three columns of positions."""
    for axes in _POSITIONS:
        if set(axes) <= set(names):
            for axis in axes:
                if names.index(axis) in text:
                    raise file.error(f"column {axis} does not hold numbers", file.line + 1)
            return axes
    raise file.error(
        "ITEM: ATOMS has no columns x y z, nor xu yu zu, xs ys zs or xsu ysu zsu; "
        f"it has {' '.join(names)[:200] or 'none'}"
    )


def _particles(
    table: Table, names: list[str], axes: tuple[str, str, str], box: Box | None
) -> Particles:
    columns = dict(zip(names, table.columns, strict=True))
    positions = np.stack([table.numbers(names.index(axis)) for axis in axes], axis=1)
    del table  # a large frame's columns of positions are not kept
    for axis in axes:
        del columns[axis]
    if axes[0] in ("xs", "xsu"):
        if box is None:
            raise SceneError(f"columns {' '.join(axes)} need ITEM: BOX BOUNDS, which is not there")
        with np.errstate(invalid="ignore", over="ignore"):  # to be refused, by particle, below
            positions = positions @ box.vectors + box.origin
    radii: NDArray[np.float64] | None = None
    for name, scale in (("radius", 1.0), ("diameter", 0.5)):
        values = columns.get(name)
        if radii is None and values is not None and not isinstance(values, Labels):
            radii = scale * values
    element, types = columns.get("element"), columns.get("type")
    assert not isinstance(element, np.ndarray)  # _frame() makes it one of names
    if isinstance(types, np.ndarray):
        types = Labels.of_numbers(types)
    # types may be given by names of elements too
    symbols = element_labels(element) if element else None
    if symbols is None and types:
        symbols = element_labels(types)
    fields = {k: v for k, v in columns.items() if k not in ("element", "type")}
    glyphs = None
    if (diameters := _numbers(columns, _DIAMETERS)) is not None:
        glyphs = ellipsoids(0.5 * diameters, _numbers(columns, _QUATERNIONS))
    kinds = types or element
    return Particles(positions, symbols, kinds, radii, None, fields, box, glyphs=glyphs)


def _numbers(
    known: Mapping[str, NDArray[np.float64] | Labels], choices: tuple[tuple[str, ...], ...]
) -> NDArray[np.float64] | None:
    """(N, M) of the first choice of M columns that are all there and numbers."""
    for columns in choices:
        parts = [known.get(column) for column in columns]
        found = [part for part in parts if isinstance(part, np.ndarray)]
        if len(found) == len(columns):
            return np.stack(found, axis=1)
    return None
