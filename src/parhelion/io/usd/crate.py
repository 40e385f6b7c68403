"""What the head of a .usdc file says, before the library believes it.

It makes room for as many tokens and paths as a file claims to have, be it terabytes, and looks up
the kinds of specs in a table without end. The layout is that of OpenUSD's pxr/usd/sdf/crateFile.h:
a bootstrap with the version and the place of the table of contents, which names sections; each
begins with the number of its elements.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError

_MAGIC = b"PXR-USDC"
# LZ4 makes at most 255 bytes of one, and the coding of whole numbers at most four of a byte
_PACKED = 255
_NUMBERS = 4 * _PACKED
_MOST_SECTIONS = 64
# From here on sections are packed
_PACKED_VERSION = (0, 4, 0)
# Bytes of a spec before: path, fields and kind; the first version aligned them to 8
_SPEC, _FIRST_SPEC = 12, 16
# SdfSpecType: from attributes to variant sets
_KINDS = range(1, 12)


def check(path: Path, where: str) -> None:
    """Raises FormatError for a table that claims more than its section can hold.

    Files of other kinds, and damage of other kinds, are left to the library.
    """
    try:
        with path.open("rb") as file:
            _check(file, where)
            if file.seek(0) == 0 and file.read(2) == b"PK":
                with zipfile.ZipFile(file) as archive:
                    for entry in archive.infolist():
                        if entry.filename.lower().endswith((".usdc", ".usd")):
                            with archive.open(entry) as inner:
                                _check(inner, f"{where}: {entry.filename}")
    except FormatError:
        raise
    # cut short, or no archive: the library says where
    except (struct.error, OSError, ValueError, OverflowError, RuntimeError, zipfile.BadZipFile):
        return


def _check(file: IO[bytes], where: str) -> None:
    head = file.read(24)
    if head[:8] != _MAGIC:
        return
    file.seek(struct.unpack("<q", head[16:])[0])
    count = struct.unpack("<Q", file.read(8))[0]
    if count > _MOST_SECTIONS:
        raise FormatError(f"{where}: its table of contents tells of {count} sections")
    for _ in range(count):
        name, start, size = struct.unpack("<16sqq", file.read(32))
        back = file.tell()
        file.seek(start)
        section = name.rstrip(b"\0").decode("latin-1")
        _section(section, file.read(24), size, where)
        if section == "SPECS":
            file.seek(start)
            _check_kinds(file.read(size), tuple(head[8:11]), where)
        file.seek(back)


def _section(name: str, head: bytes, size: int, where: str) -> None:
    if name not in ("TOKENS", "STRINGS", "FIELDS", "FIELDSETS", "PATHS", "SPECS"):
        return
    (count,) = struct.unpack("<Q", head[:8])
    most = size * _NUMBERS
    if name == "TOKENS":
        unpacked, packed = struct.unpack("<QQ", head[8:])
        if packed > size or unpacked > packed * _PACKED:
            raise FormatError(f"{where}: {name}: {packed} bytes cannot hold {unpacked}")
        most = unpacked
    if count > most:
        raise FormatError(f"{where}: {name}: {size} bytes cannot hold {count} elements")


def _check_kinds(section: bytes, version: tuple[int, ...], where: str) -> None:
    """Raises FormatError for a spec of a kind that is none; the library ends the process."""
    (count,) = struct.unpack_from("<Q", section)
    kinds: NDArray[Any] = np.zeros(0)
    try:
        if version < _PACKED_VERSION:
            words = (_FIRST_SPEC if version == (0, 0, 1) else _SPEC) // 4
            rows = np.frombuffer(section, "<u4", count * words, 8).reshape(count, words)
            kinds = rows[:, 2]
        else:
            at = 8
            for _ in range(3):  # paths, fields, kinds; what cannot be unpacked is never set
                (size,) = struct.unpack_from("<Q", section, at)
                kinds = _integers(section[at + 8 : at + 8 + size], count)
                at += 8 + size
    except (struct.error, ValueError, IndexError):
        raise FormatError(f"{where}: SPECS: its {count} specs cannot be unpacked") from None
    wrong = np.flatnonzero((kinds < _KINDS.start) | (kinds >= _KINDS.stop))
    if wrong.size:
        raise FormatError(
            f"{where}: SPECS: spec {wrong[0]} is of kind {kinds[wrong[0]]}; must be 1 to 11"
        )


def _integers(packed: bytes, count: int) -> NDArray[np.int32]:
    """Whole numbers as pxr/usd/sdf/integerCoding.cpp packs them: differences, of which the usual
    one takes no bytes, and others one, two or four; two bits each say which.
    """
    if packed[0]:  # more than 2 GiB, in parts
        raise ValueError
    codes = -(-count // 4)
    data = np.frombuffer(_unpacked(packed[1:], 4 + codes + 4 * count), np.uint8)
    usual = data[:4].view("<i4")[0]
    code = (data[4 : 4 + codes, None] >> np.array([0, 2, 4, 6], np.uint8) & 3).ravel()[:count]
    sizes = np.array([0, 1, 2, 4])[code]
    starts = 4 + codes + np.cumsum(sizes) - sizes
    found = np.full(count, usual, np.int32)
    for number, kind in ((1, "<i1"), (2, "<i2"), (3, "<i4")):
        at = starts[code == number]
        size = np.dtype(kind).itemsize
        found[code == number] = data[at[:, None] + np.arange(size)].view(kind)[:, 0]
    return np.cumsum(found, dtype=np.int32)


def _unpacked(data: bytes, most: int) -> bytearray:
    """A block of LZ4 (its block format's specification). Raises ValueError, IndexError."""
    made, at = bytearray(), 0

    def length(count: int) -> int:
        nonlocal at
        while count >= 15:
            count += data[at]
            at += 1
            if data[at - 1] != 255:
                break
        return count

    while at < len(data):
        token = data[at]
        at += 1
        plain = length(token >> 4)
        made += data[at : at + plain]
        at += plain
        if at == len(data):
            break
        back = data[at] | data[at + 1] << 8
        at += 2
        count = length(token & 15) + 4
        if not 0 < back <= len(made) or len(made) + count > most:
            raise ValueError
        start = len(made) - back
        made += (
            (made[start:] * -(-count // back))[:count]
            if back < count
            else made[start : start + count]
        )
    return made
