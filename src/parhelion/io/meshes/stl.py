"""STL: triangles, binary or text, in which every corner is written out.

Corners at exactly the same place become one vertex. The normals of the file are those of the faces
and are not read; nor are the two bytes of each binary face that some programs use for colours.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...errors import FormatError
from ..files import contents
from . import MeshData
from .numbers import parse

_HEADER = 84  # bytes: 80 of text, and the number of faces
_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("color", "<u2")])


def read(path: Path) -> MeshData:
    """The file as one mesh. Raises FormatError, OSError."""
    data = contents(path)
    corners = _binary(path, data) if _is_binary(data) else _text(path, data)
    if not len(corners):
        raise FormatError(f"{path}: has no faces")
    bad = ~np.isfinite(corners).all(axis=(1, 2))
    if bad.any():
        raise FormatError(f"{path}: face {int(np.argmax(bad))} has a corner that is not finite")
    corners = corners.reshape(-1, 3) + np.float32(0.0)  # no -0
    which, first = _core.distinct_rows(corners.view(np.uint32))
    return MeshData(corners[first], which.reshape(-1, 3), face_normals=True)


def _is_binary(data: bytes) -> bool:
    """Binary files may begin with "solid" too, which only text should."""
    if len(data) >= _HEADER:
        count = int.from_bytes(data[80:84], "little")
        if len(data) == _HEADER + count * _FACE.itemsize:
            return True
    return not data[:512].lstrip().lower().startswith(b"solid")


def _binary(path: Path, data: bytes) -> NDArray[np.float32]:
    if len(data) < _HEADER:
        raise FormatError(f"{path}: is no STL file: it has {len(data)} bytes")
    count = int.from_bytes(data[80:84], "little")
    there = (len(data) - _HEADER) // _FACE.itemsize
    if count > there:
        raise FormatError(f"{path}: its header tells of {count} faces; there are {there}")
    faces = np.frombuffer(data, _FACE, count, _HEADER)
    return np.asarray(faces["corners"], np.float32)


def _text(path: Path, data: bytes) -> NDArray[np.float32]:
    lines = re.findall(rb"(?mi)^[ \t]*vertex[ \t]+([^\r\n]*)", data)
    try:
        numbers = parse(b" ".join(lines))
    except ValueError as error:
        raise FormatError(f"{path}: its vertices hold {error}") from None
    if len(lines) % 3 or len(numbers) != 3 * len(lines):
        raise FormatError(
            f"{path}: has {len(lines)} vertices with {len(numbers)} coordinates; a face has 3 of 3"
        )
    return numbers.reshape(-1, 3, 3).astype(np.float32)
