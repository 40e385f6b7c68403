"""What the head of a .usdc file says, before the library believes it.

It makes room for as many tokens, paths and elements of a value as a file claims to have, be it
terabytes, follows paths wherever they lead, and looks up the kinds of specs in a table without end.
The layout is that of OpenUSD's pxr/usd/sdf/crateFile.h: a bootstrap with the version and the place
of the table of contents, which names sections; each begins with the number of its elements. Values
lie anywhere, and begin with a number too if they are lists.
"""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError

Bytes = NDArray[np.uint8]
Version = tuple[int, ...]

_MAGIC = b"PXR-USDC"
# LZ4 makes at most 255 bytes of one, and the coding of whole numbers at most four of a byte
_PACKED = 255
_NUMBERS = 4 * _PACKED
_MOST_SECTIONS = 64
# From here on sections are packed, arrays have no rank, and their lengths 64 bits
_PACKED_VERSION, _NO_RANK, _LONG = (0, 4, 0), (0, 5, 0), (0, 7, 0)
# Bytes of a spec before: path, fields and kind; the first version aligned them to 8
_SPEC, _FIRST_SPEC = 12, 16
# SdfSpecType: from attributes to variant sets
_KINDS = range(1, 12)

# A value is a word: flags, its type (crateDataTypes.h), and where it lies
_ARRAY, _INLINED, _COMPRESSED, _EDIT = 63, 62, 61, 60
_PLACE = (1 << 48) - 1
# Bytes of an array's element, by type; of others at least one
_ELEMENT = np.ones(256, np.int64)
_ELEMENT[1:31] = (
    1, 1, 4, 4, 8, 8, 2, 4, 8, 4, 4, 4, 32, 72, 128, 32, 16, 8,
    16, 8, 4, 8, 24, 12, 6, 12, 32, 16, 8, 16,
)  # fmt: skip
# Bytes of an item of types that are lists: of paths, tokens, doubles, offsets of layers, strings
_LISTS = {40: 4, 41: 4, 48: 8, 49: 16, 50: 4}
# Of several lists: of tokens, strings, paths, references, whole numbers, and payloads. References
# and payloads have no fixed length.
_LIST_OPS = {32: 4, 33: 4, 34: 4, 35: 32, 36: 4, 37: 8, 38: 4, 39: 8, 55: 8}
_UNEVEN = (35, 55)
_TIME_SAMPLES = 46


def check(path: Path, where: str) -> None:
    """Raises FormatError for what claims to have more than there is room for.

    Files of other kinds, and damage of other kinds, are left to the library.
    """
    try:
        with path.open("rb") as file:
            start = file.read(8)
        if start != _MAGIC and start[:2] != b"PK":
            return
        data = np.memmap(path, np.uint8, "r")
        if start == _MAGIC:
            _check(data, where)
            return
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                # the library takes no others
                if entry.compress_type == zipfile.ZIP_STORED:
                    names = struct.unpack_from("<HH", data.data, entry.header_offset + 26)
                    first = entry.header_offset + 30 + sum(names)
                    _check(data[first : first + entry.file_size], f"{where}: {entry.filename}")
    except FormatError:
        raise
    # cut short, or no archive: the library says where
    except (struct.error, OSError, ValueError, OverflowError, RuntimeError, zipfile.BadZipFile):
        return


def _check(data: Bytes, where: str) -> None:
    if data[:8].tobytes() != _MAGIC:
        return
    version = tuple(data[8:11].tolist())
    (at,) = struct.unpack_from("<Q", data.data, 16)
    (count,) = struct.unpack_from("<Q", data.data, at)
    if count > _MOST_SECTIONS:
        raise FormatError(f"{where}: its table of contents tells of {count} sections")
    sections: dict[str, bytes] = {}
    for k in range(count):
        title, start, size = struct.unpack_from("<16sqq", data.data, at + 8 + 32 * k)
        name = title.rstrip(b"\0").decode("latin-1")
        if start < 0 or not 0 <= size <= len(data) - start:
            raise FormatError(f"{where}: {name[:16]!r}: lies outside of the file")
        _section(name, data[start : start + 24].tobytes(), size, where)
        if name in ("FIELDS", "PATHS", "SPECS"):
            sections[name] = data[start : start + size].tobytes()
    if "PATHS" in sections and version >= _PACKED_VERSION:
        _check_paths(sections["PATHS"], where)
    if "SPECS" in sections:
        _check_kinds(sections["SPECS"], version, where)
    if "FIELDS" in sections:
        _check_values(data, _values(sections["FIELDS"], version, where), version, where)


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


def _values(section: bytes, version: Version, where: str) -> NDArray[np.uint64]:
    """The words of all values."""
    (count,) = struct.unpack_from("<Q", section)
    try:
        if version < _PACKED_VERSION:  # behind the number of the name
            return np.frombuffer(section, "<u8", 2 * count, 8)[1::2]
        (names,) = struct.unpack_from("<Q", section, 8)
        (size,) = struct.unpack_from("<Q", section, 16 + names)
        packed = section[24 + names : 24 + names + size]
        if packed[0]:  # more than 2 GiB, in parts
            raise ValueError
        return np.frombuffer(_unpacked(packed[1:], 8 * count), "<u8", count)
    except (struct.error, ValueError, IndexError):
        raise FormatError(f"{where}: FIELDS: its {count} values cannot be unpacked") from None


def _check_values(
    data: Bytes, words: NDArray[np.uint64], version: Version, where: str, inner: bool = False
) -> None:
    """Raises FormatError for a value with more elements than bytes follow for."""

    def refuse(claimed: int, at: int) -> None:
        follow = f"{len(data) - at} bytes follow"
        raise FormatError(f"{where}: a value at byte {at} claims {claimed} elements; {follow}")

    def flag(bit: int) -> NDArray[np.bool_]:
        return np.asarray(words >> np.uint64(bit) & np.uint64(1), bool)

    places = (words & np.uint64(_PLACE)).astype(np.int64)
    kinds = (words >> np.uint64(48) & np.uint64(0xFF)).astype(np.int64)
    away = ~flag(_INLINED) & ~flag(_EDIT) & (places > 0)
    arrays = away & flag(_ARRAY)
    wide = 8 if version >= _LONG else 4
    at = places[arrays] + (0 if version >= _NO_RANK else 4)
    there = at + wide <= len(data)
    at, kind, packed = at[there], kinds[arrays][there], flag(_COMPRESSED)[arrays][there]
    claimed = data[at[:, None] + np.arange(wide)].view(f"<u{wide}")[:, 0].astype(np.uint64)
    room = len(data) - at - wide
    most = np.where(packed, room * _NUMBERS, room // _ELEMENT[kind])
    wrong = np.flatnonzero(claimed > most.astype(np.uint64))
    if wrong.size:
        refuse(int(claimed[wrong[0]]), int(at[wrong[0]]))
    for value in np.flatnonzero(away & ~arrays):
        kind, place = int(kinds[value]), int(places[value])
        if kind in _LISTS or kind in _LIST_OPS:
            for begin, size, claims in _lists(data, kind, place):
                if claims > (len(data) - begin - 8) // size:
                    refuse(claims, begin)
        elif kind == _TIME_SAMPLES and not inner:
            _check_values(data, _samples(data, place, refuse), version, where, inner=True)


def _lists(data: Bytes, kind: int, at: int) -> Iterator[tuple[int, int, int]]:
    """Of each list of a value: where it is, the bytes of its items, and how many it claims."""
    count = 1
    if kind in _LIST_OPS:  # the bits of a byte tell which lists there are
        if at >= len(data):
            return
        count, at = (int(data[at]) & 0x7E).bit_count(), at + 1
    size = _LISTS.get(kind) or _LIST_OPS[kind]
    for _ in range(count):
        if at + 8 > len(data):
            return
        (claims,) = struct.unpack_from("<Q", data.data, at)
        yield at, size, claims
        if kind in _UNEVEN:
            return
        at += 8 + size * claims


def _samples(data: Bytes, at: int, refuse: Any) -> NDArray[np.uint64]:
    """The words of the times and values of time samples, each behind an offset."""
    words = []
    for several in (False, True):
        if not 0 <= at <= len(data) - 8:
            break
        at += struct.unpack_from("<q", data.data, at)[0]
        if not 0 <= at <= len(data) - 8:
            break
        count = 1
        if several:
            (count,) = struct.unpack_from("<Q", data.data, at)
            if count > (len(data) - at - 8) // 8:
                refuse(count, at)
            at += 8
        words.append(np.frombuffer(data[at : at + 8 * count].tobytes(), "<u8"))
        at += 8
    return np.concatenate(words) if words else np.zeros(0, np.uint64)


def _check_paths(section: bytes, where: str) -> None:
    """Raises FormatError for paths that are no tree: the library follows each way to one anew, and
    ways that meet double until memory ends.

    Row by row, in the order of a walk: which path it is, the last name in it, and a jump. -2: it
    has neither child nor sibling; -1: the next row is its child; 0: its sibling; else its child,
    and the row so many further is its sibling.
    """
    room, rows = struct.unpack_from("<QQ", section)
    if rows > len(section) * _NUMBERS:
        raise FormatError(f"{where}: PATHS: {len(section)} bytes cannot hold {rows} rows")
    columns = []
    try:
        at = 16
        for _ in range(3):
            (size,) = struct.unpack_from("<Q", section, at)
            columns.append(_integers(section[at + 8 : at + 8 + size], rows).astype(np.int64))
            at += 8 + size
    except (struct.error, ValueError, IndexError):
        raise FormatError(f"{where}: PATHS: its {rows} rows cannot be unpacked") from None
    which, _, jumps = columns
    if not rows:
        return
    own = np.arange(rows)
    reached = np.concatenate([own[jumps != -2] + 1, (own + jumps)[jumps > 0]])
    once = reached.max(initial=0) < rows and np.bincount(reached, minlength=1).max(initial=0) <= 1
    if not once or jumps.min() < -2 or which.min() < 0 or which.max() >= room:
        raise FormatError(f"{where}: PATHS: its {rows} rows are no tree of {room} paths")


def _check_kinds(section: bytes, version: Version, where: str) -> None:
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
