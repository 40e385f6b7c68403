"""Mitsuba's "serialized" meshes, versions 3 and 4: several of them in one file, each packed.

W. Jakob, "Mitsuba Documentation", version 0.5.0, section 8.2.3.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import FormatError
from . import Floats, MeshData, check_indices

_MAGIC = 0x041C
_NORMALS, _UVS, _COLORS, _FACE_NORMALS, _SINGLE, _DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x1000, 0x2000
# Bytes that any mesh may unpack to, and how many times its packed size one may beyond that: meshes
# pack some three times
_ALWAYS = 1 << 26
_RATIO = 20
# The longest name of a mesh, in bytes
_LONGEST_NAME = 1 << 12


def read(path: Path, index: int = 0) -> MeshData:
    """The index-th mesh of the file, from 0. Raises FormatError, OSError."""
    with path.open("rb") as file:
        version, begin, end = _find(path, file, index)
        file.seek(begin + 4)
        packed = file.read(end - begin - 4)
    try:
        return _unpack(f"{path}: mesh {index}", version, packed)
    except (zlib.error, struct.error) as error:
        raise FormatError(f"{path}: mesh {index} is broken: {error}") from None


def _find(path: Path, file: BinaryIO, index: int) -> tuple[int, int, int]:
    """The format's version, and the mesh's first byte and the one after its last."""
    head = file.read(4)
    if len(head) < 4 or struct.unpack("<H", head[:2])[0] != _MAGIC:
        raise FormatError(f"{path}: is not a serialized mesh: it does not begin with 1C 04")
    version = struct.unpack("<H", head[2:])[0]
    if version not in (3, 4):
        raise FormatError(f"{path}: version {version} of the serialized format; must be 3 or 4")
    size = file.seek(0, 2)
    entry = 4 if version == 3 else 8
    if size < 8 + entry:
        raise FormatError(f"{path}: is cut short")
    file.seek(size - 4)
    count = struct.unpack("<I", file.read(4))[0]
    if count == 0 or 4 + count * entry > size:
        raise FormatError(f"{path}: its list of meshes is broken; cut short?")
    if not 0 <= index < count:
        raise FormatError(f"{path}: has no mesh {index}; it has {count} (0 to {count - 1})")
    listed = size - 4 - count * entry
    file.seek(listed)
    offsets = np.frombuffer(file.read(count * entry), "<u4" if version == 3 else "<u8")
    begin = int(offsets[index])
    end = int(offsets[index + 1]) if index + 1 < count else listed
    if not 0 <= begin < end - 4 <= listed:
        raise FormatError(f"{path}: its list of meshes is broken: mesh {index} at byte {begin}")
    return version, begin, end


def _unpack(name: str, version: int, packed: bytes) -> MeshData:
    unpacker = zlib.decompressobj()
    head = unpacker.decompress(packed, 4 + 16 + _LONGEST_NAME)
    flags = struct.unpack_from("<I", head)[0]
    at = 4
    if version == 4:
        at = head.find(b"\0", 4) + 1
        if at == 0:
            raise FormatError(f"{name}: its name is longer than {_LONGEST_NAME} bytes")
    vertex_count, face_count = struct.unpack_from("<QQ", head, at)
    at += 16
    number = np.dtype("<f8" if flags & _DOUBLE else "<f4")
    widths = {"vertices": 3}
    if flags & _NORMALS:
        widths["normals"] = 3
    if flags & _UVS:
        widths["uvs"] = 2
    if flags & _COLORS:
        widths["colors"] = 3
    index = np.dtype("<u4" if vertex_count <= 0xFFFFFFFF else "<u8")
    numbers = vertex_count * sum(widths.values()) * number.itemsize
    total = at + numbers + face_count * 3 * index.itemsize
    if total > max(_RATIO * len(packed), _ALWAYS):
        raise FormatError(
            f"{name}: {vertex_count} vertices and {face_count} faces cannot fit in it"
        )
    data = head
    if total > len(head):
        data += unpacker.decompress(unpacker.unconsumed_tail, total - len(head))
    if len(data) < total:
        raise FormatError(f"{name}: is cut short: {len(data)} of {total} bytes")
    arrays: dict[str, Floats] = {}
    for what, width in widths.items():
        size = vertex_count * width
        arrays[what] = np.frombuffer(data, number, size, at).reshape(-1, width)
        at += size * number.itemsize
    faces = np.frombuffer(data, index, face_count * 3, at).reshape(-1, 3).astype(np.int64)
    check_indices(name, faces, vertex_count)
    colors = arrays.pop("colors", None)
    return MeshData(
        arrays["vertices"],
        faces,
        arrays.get("normals"),
        arrays.get("uvs"),
        attributes={} if colors is None else {"vertex_color": colors},
        face_normals=bool(flags & _FACE_NORMALS),
    )
