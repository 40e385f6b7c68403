"""The file beside a scene that holds its large arrays: NAME.HASH.bin.

Arrays follow one another as they lie in memory: little-endian, row by row, each from a multiple of
64 bytes on, zeros between them. There is no header; what begins where stands in the document, and
so do the file's length and its SHA-256. Its name has the beginning of that hash, so that a scene
that is written again gets another one: the old document and the old arrays stay a pair until the
new document takes the old one's place.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...atomic import replacing
from ...errors import SceneError
from .. import require_memory
from .document import Arrays, Stored

# Bytes; what computers read at a time, and the widest vector registers hold
_ALIGNMENT = 64
# Bytes at a document's beginning in which the name of its side file is looked for. We write it into
# the first lines.
_HEAD = 1 << 16


class SideFile:
    """The side file of a document that is read. Arrays are views of it: one that is named twice is
    one object.
    """

    def __init__(self, data: NDArray[np.uint8]) -> None:
        self._data = data
        self._made: dict[tuple[Any, ...], NDArray[Any]] = {}

    def array(self, shape: list[int], kind: str, at: int, where: str) -> NDArray[Any]:
        """The array that begins there. Raises SceneError where there is none."""
        key = (at, kind, tuple(shape))
        if key not in self._made:
            dtype = np.dtype(kind)
            end = at + prod(shape) * dtype.itemsize
            if at % _ALIGNMENT:
                raise SceneError(f"{where}.at: is {at}; must be a multiple of {_ALIGNMENT}")
            if end > len(self._data):
                raise SceneError(
                    f"{where}: {kind} of shape {tuple(shape)} from byte {at} ends at byte {end};"
                    f" the side file has {len(self._data)}"
                )
            little = self._data[at:end].view(dtype.newbyteorder("<"))
            self._made[key] = little.astype(dtype, copy=False).reshape(shape)
        return self._made[key]


def read(file: Path, said: Arrays, where: str) -> SideFile:
    """Raises SceneError for a file that is not the one that the document was written with."""
    size = file.stat().st_size
    if size != said.bytes:
        raise SceneError(
            f"{where}.bytes: is {said.bytes}, but {file.name!r} has {size}; it is not the file that"
            " this scene was written with, or not all of it"
        )
    require_memory(file, factor=1.0)
    try:
        data = np.fromfile(file, np.uint8)
    except OSError as error:
        reason = error.strerror or error
        raise SceneError(f"{where}.file: {file.name!r} cannot be read: {reason}") from None
    if len(data) != size or hashlib.sha256(data.data).hexdigest() != said.sha256:
        raise SceneError(
            f"{where}.sha256: is not that of {file.name!r}; it is not the file that this scene was"
            " written with"
        )
    return SideFile(data)


class Packing(SideFile):
    """The arrays of a document that is written."""

    def __init__(self) -> None:
        super().__init__(np.empty(0, np.uint8))
        self._parts: list[NDArray[Any]] = []
        self._places: dict[int | str, Stored] = {}
        self._kept: list[Any] = []  # so that no id() is given twice
        self._size = 0

    def add(self, given: Any, array: NDArray[Any]) -> Stored:
        """A place for an array. given: the object it was made of, or a file's path; stored once
        however often it is added.
        """
        key = given if isinstance(given, str) else id(given)
        if key not in self._places:
            self._size += -self._size % _ALIGNMENT
            kind: Any = array.dtype.name
            place = Stored(list(array.shape), kind, self._size)
            little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
            self._parts.append(little)
            self._made[place.at, place.type, tuple(place.shape)] = array
            self._size += little.nbytes
            self._places[key] = place
            self._kept.append(given)
        return self._places[key]

    def _pieces(self) -> Iterator[Any]:
        """The file's bytes, an array or the zeros between two at a time."""
        at = 0
        for part in self._parts:
            yield bytes(-at % _ALIGNMENT)
            at += -at % _ALIGNMENT + part.nbytes
            yield part.reshape(-1).view(np.uint8)

    def arrays(self, document: Path) -> Arrays | None:
        """What a document of that name says of its side file; None if there is nothing to store."""
        if not self._parts:
            return None
        digest = hashlib.sha256()
        for piece in self._pieces():
            digest.update(piece)
        text = digest.hexdigest()
        return Arrays(f"{_stem(document)}.{text[:16]}.bin", self._size, text)

    def write(self, file: Path) -> None:
        """Writes the file, whole or not at all. Raises ResourceError."""
        with replacing(file) as temporary, open(temporary, "wb") as out:
            for piece in self._pieces():
                out.write(piece)


def of(document: Path) -> str | None:
    """The name of the side file that a document there names; None unless we named it so."""
    try:
        with open(document, "rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return None
    named = re.search(rb'"arrays"\s*:\s*\{\s*"file"\s*:\s*"([^"\\]*)"', head)
    name = named[1].decode(errors="replace") if named else ""
    ours = re.fullmatch(re.escape(_stem(document)) + r"\.[0-9a-f]{16}\.bin", name)
    return name if ours else None


def remove(name: str, document: Path) -> None:
    """Removes a side file that the document named before, unless a copy of that document is, or
    may be packed, in the folder.
    """
    try:
        if any(document.parent.glob("*.json.*z*")):
            return
        for other in document.parent.glob("*.json"):
            with open(other, "rb") as file:
                if name.encode() in file.read(_HEAD):
                    return
        (document.parent / name).unlink(missing_ok=True)
    except OSError:  # it stays, which harms nobody
        return


def _stem(document: Path) -> str:
    return document.name.removesuffix(".json")
