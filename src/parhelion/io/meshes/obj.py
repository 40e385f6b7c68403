"""Wavefront OBJ: v, vt, vn and f lines, and which material each face has.

Each different corner v/vt/vn becomes a vertex. Polygons are split into fans. Colours after the
coordinates of a vertex, as many programs write them, are the attribute vertex_color, sRGB decoded.
Groups, smoothing, lines, points and free-form surfaces are passed over.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...spectra import decode_srgb
from ..files import contents
from . import Floats, Integers, MeshData, distinct, triangulate
from .numbers import parse, words_per_line

_KINDS = {b"v ": 1, b"vt": 2, b"vn": 3, b"f ": 4, b"us": 5, b"mt": 6}
_NOUNS = {1: "vertex", 2: "texture coordinate", 3: "normal"}


class _Lines:
    """The lines of a file as NumPy arrays: where they start, and what they hold by their kind."""

    def __init__(self, path: Path, text: bytes) -> None:
        self.path = path
        text = text.replace(b"\\\n", b"  ").replace(b"\\\r\n", b"   ")
        text = text.translate(bytes.maketrans(b"\r\t\v\f", b"    "))
        if b"#" in text:
            text = re.sub(rb"#[^\n]*", b"", text)
        if b"\n " in text or text[:1] == b" ":
            text = re.sub(rb"(?m)^ +", b"", text)
        self.bytes = np.frombuffer(text + b"\n\0", np.uint8)
        ends = np.flatnonzero(self.bytes == 10)
        self.starts = np.concatenate([[0], ends[:-1] + 1])
        self.sizes = ends + 1 - self.starts
        first = self.bytes[self.starts].astype(np.uint16)
        second = self.bytes[self.starts + 1].astype(np.uint16)
        self.kinds = np.zeros(len(ends), np.uint8)
        for key, kind in _KINDS.items():
            self.kinds[(first == key[0]) & (second == key[1])] = kind

    def text(self, kind: int) -> NDArray[np.uint8]:
        """The lines of a kind, each with blanks for the word it begins with."""
        chosen = self.kinds == kind
        text: NDArray[np.uint8] = self.bytes[:-1][np.repeat(chosen, self.sizes)]
        sizes = self.sizes[chosen]
        starts = np.cumsum(sizes) - sizes
        text[starts] = 32
        text[starts[sizes > 1] + 1] = 32
        return text

    def rows(self, kind: int, width: int) -> NDArray[np.float64]:
        """(N, width) numbers of the lines of a kind; numbers that follow on a line are dropped."""
        text = self.text(kind)
        if not len(text):
            return np.empty((0, width))
        counts = words_per_line(text)
        if (counts < width).any():
            raise self._error(
                kind, int(np.argmax(counts < width)), f"has fewer than {width} numbers"
            )
        try:
            numbers = parse(text.tobytes())
            if len(numbers) != counts.sum():
                raise ValueError("something that is no number")
        except ValueError as error:
            raise FormatError(f"{self.path}: the {_NOUNS[kind]} lines hold {error}") from None
        starts = np.cumsum(counts) - counts
        return np.asarray(numbers[starts[:, None] + np.arange(width)])

    def names(self, kind: int, word: bytes) -> list[tuple[int, str]]:
        """What follows the word that lines begin with, and the number of such a line from 0."""
        found = []
        for at in np.flatnonzero(self.kinds == kind):
            line = self.bytes[self.starts[at] : self.starts[at] + self.sizes[at]].tobytes()
            first, _, rest = line.strip().partition(b" ")
            if first == word:
                found.append((int(at), rest.strip().decode("utf-8", "replace")))
        return found

    def line(self, kind: int, row: int) -> int:
        """The number, from 1, of the line that is the row-th of its kind."""
        return int(np.flatnonzero(self.kinds == kind)[row]) + 1

    def _error(self, kind: int, row: int, text: str) -> FormatError:
        return FormatError(f"{self.path}: line {self.line(kind, row)} {text}")


@dataclass(frozen=True)
class Groups:
    """Which material each triangle has.

    names: of the materials, in the order of their first use; "" is none. of_face: (F,) indices.
    libraries: names of the files that define them.
    """

    names: list[str]
    of_face: Integers
    libraries: list[str]


def read(path: Path) -> MeshData:
    """The file as one mesh. Raises FormatError, naming the line, and OSError."""
    return read_groups(path)[0]


def read_groups(path: Path) -> tuple[MeshData, Groups]:
    """The file as one mesh, and its faces' materials. Raises FormatError and OSError."""
    lines = _Lines(path, contents(path))
    arrays: dict[int, Floats] = {1: lines.rows(1, 3), 2: lines.rows(2, 2), 3: lines.rows(3, 3)}
    text = lines.text(4)
    counts = words_per_line(text)
    if not len(counts):
        raise FormatError(f"{path}: has no faces ('f' lines)")
    if (counts < 3).any():
        line = lines.line(4, int(np.argmax(counts < 3)))
        raise FormatError(f"{path}: line {line}: a face needs at least 3 corners")
    corners = _corners(lines, text, counts, arrays)
    faces, polygon = triangulate(counts, corners)
    uses = lines.names(5, b"usemtl")
    names = list(dict.fromkeys(["", *(name for _, name in uses)]))
    number = np.array([0, *(names.index(name) for _, name in uses)])
    face_lines = np.flatnonzero(lines.kinds == 4)
    use = np.searchsorted([at for at, _ in uses], face_lines)  # how many came before
    groups = Groups(names, number[use][polygon], [name for _, name in lines.names(6, b"mtllib")])
    return _indexed(faces, arrays, _colors(lines)), groups


def _colors(lines: _Lines) -> Floats | None:
    """(V, 3) linear RGB, if every vertex has one behind its coordinates."""
    counts = words_per_line(lines.text(1))
    if not len(counts) or counts.min() < 6 or counts.max() > 7:
        return None
    rgb = lines.rows(1, 6)[:, 3:]
    return decode_srgb(np.clip(rgb / (255.0 if np.any(rgb > 1.0) else 1.0), 0.0, 1.0))


def _corners(
    lines: _Lines, text: NDArray[np.uint8], counts: Integers, arrays: dict[int, Floats]
) -> Integers:
    """(C, 3) indices from 0 of vertex, texture coordinate and normal; -1 where there is none."""
    filled = text.tobytes()
    if b"/" in filled:
        blank = text <= 32
        last = np.flatnonzero(~blank & np.append(blank[1:], True))  # of each word
        parts = np.diff(np.searchsorted(np.flatnonzero(text == 47), last), prepend=0) + 1
        # an index that is left out, as in 1//3, becomes 0
        filled = re.sub(rb"/(?=[/\s]|$)", b"/0", filled).replace(b"/", b" ")
    else:
        parts = np.ones(int(counts.sum()), np.int64)
    try:
        numbers = parse(filled)
        indices = numbers.astype(np.int64)
        if len(numbers) != parts.sum() or (parts > 3).any() or (indices != numbers).any():
            raise ValueError("something that is no corner v/vt/vn")
    except ValueError as error:
        raise FormatError(f"{lines.path}: the 'f' lines hold {error}") from None
    face = np.repeat(np.arange(len(counts)), counts)
    starts = np.cumsum(parts) - parts
    corners = np.full((len(parts), 3), -1, np.int64)
    face_lines = np.flatnonzero(lines.kinds == 4)
    for column, kind in enumerate((1, 2, 3)):
        given = parts > column
        if not given.any():
            break
        index = indices[np.minimum(starts + column, len(indices) - 1)]
        given &= (index != 0) | (column == 0)
        absolute = index - 1
        if (index < 0).any():  # these count back from the last that was defined before the face
            seen = np.cumsum(lines.kinds == kind)[face_lines][face]
            absolute = np.where(index < 0, seen + index, absolute)
        bad = given & ((absolute < 0) | (absolute >= len(arrays[kind])))
        if bad.any():
            at = int(np.argmax(bad))
            raise FormatError(
                f"{lines.path}: line {lines.line(4, int(face[at]))}: face {int(face[at])} refers "
                f"to {_NOUNS[kind]} {int(index[at])}; there are {len(arrays[kind])}"
            )
        corners[given, column] = absolute[given]
    return corners


def _indexed(faces: Integers, arrays: dict[int, Floats], colors: Floats | None) -> MeshData:
    """Corners that differ in anything become different vertices, in the order of the file."""
    flat = faces.reshape(-1, 3)
    sizes = [len(arrays[kind]) + 1 for kind in (1, 2, 3)]
    keys = ((flat[:, 0] + 1) * sizes[1] + flat[:, 1] + 1) * sizes[2] + flat[:, 2] + 1
    inverse, first = distinct(keys)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    chosen = flat[first[order]]
    uvs = normals = None
    if len(arrays[2]) and (chosen[:, 1] >= 0).all():
        uvs = arrays[2][chosen[:, 1]]
    if len(arrays[3]) and (chosen[:, 2] >= 0).all():
        normals = arrays[3][chosen[:, 2]]
    return MeshData(
        vertices=arrays[1][chosen[:, 0]],
        faces=rank[inverse].reshape(-1, 3),
        normals=normals,
        uvs=uvs,
        attributes={} if colors is None else {"vertex_color": colors[chosen[:, 0]]},
    )
