"""What the head of a .usdc file says, before the library believes it.

It makes room for as many tokens and paths as a file claims to have, be it terabytes. The layout is
that of OpenUSD's pxr/usd/sdf/crateFile.h: a bootstrap with the place of the table of contents,
which names sections; each begins with the number of its elements.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import IO

from ...errors import FormatError

_MAGIC = b"PXR-USDC"
# LZ4 makes at most 255 bytes of one, and the coding of whole numbers at most four of a byte
_PACKED = 255
_NUMBERS = 4 * _PACKED
_MOST_SECTIONS = 64


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
        _section(name.rstrip(b"\0").decode("latin-1"), file.read(24), size, where)
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
