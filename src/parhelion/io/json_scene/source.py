"""The text of a scene file: unpacked, proper UTF-8, no key twice in an object."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import msgspec

from ...errors import SceneError
from .messages import clip, position

# Bytes of text, unpacked; larger arrays than fit in here belong in .npy files.
LARGEST_TEXT = 2**30
# Of a packed file, bytes that any may unpack to, and how many times its size one may beyond that
_ALWAYS = 2**26
_RATIO = 20

_UNPACKERS = {".gz": "gzip", ".bz2": "bz2", ".xz": "lzma"}


def text(path: Path) -> bytes:
    """The file's text, unpacked: proper UTF-8 without a byte order mark, and not empty."""
    if not path.is_file():
        raise SceneError("is not a regular file")
    if path.suffix.lower() in _UNPACKERS:
        unpacker = import_module(_UNPACKERS[path.suffix.lower()])
        most = min(LARGEST_TEXT, max(_ALWAYS, _RATIO * path.stat().st_size))
        try:
            with unpacker.open(path) as file:
                data: bytes = file.read(most + 1)
        except OSError:
            raise
        except Exception as error:  # zlib.error, EOFError, LZMAError: each module has its own
            raise SceneError(f"cannot be unpacked: {error}") from None
        size = len(data)
        if most < size <= LARGEST_TEXT:
            raise SceneError(f"unpacks to more than {most} bytes, {_RATIO} times its size")
    else:
        size = path.stat().st_size
        data = path.read_bytes() if size <= LARGEST_TEXT else b""
    if size > LARGEST_TEXT:
        raise SceneError(
            f"is longer than {LARGEST_TEXT >> 20} MiB; keep large arrays in .npy files"
        )
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise SceneError("is UTF-16 text; save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if not data or data.isspace():
        raise SceneError("is empty")
    if not data.isascii():
        try:
            data.decode()
        except UnicodeDecodeError as error:
            raise SceneError(f"{position(data, error.start)}: is not UTF-8 text") from None
    return data


_ALL_BUT_BRACES = bytes(set(range(256)) - set(b"{}"))


def refuse_repeated_keys(data: bytes) -> None:
    """JSON readers keep the last of two equal keys; here a material would be lost in silence.

    The text is known to be well formed. A Python loop over its keys only: what lies between two
    colons, long arrays included, is handled by the methods of bytes.
    """
    # Hide what would mislead a search for quotes. Control characters cannot be part of a string.
    hidden = data.replace(b"\\\\", b"\1\1").replace(b'\\"', b"\2\2")
    keys_of: list[set[bytes]] = []  # of every object that is open
    at = 0
    pending: list[bytes] = []
    quotes = 0
    *before_colons, _ = hidden.split(b":")
    for piece in before_colons:
        at += len(piece) + 1
        pending.append(piece)
        quotes += piece.count(b'"')
        if quotes % 2:  # a colon inside a string
            continue
        parts = b":".join(pending).split(b'"')
        pending.clear()
        for brace in b"".join(parts[::2]).translate(None, _ALL_BUT_BRACES):
            if brace == ord("{"):
                keys_of.append(set())
            else:
                keys_of.pop()
        end = hidden.rindex(b'"', 0, at)
        start = hidden.rindex(b'"', 0, end)
        key = msgspec.json.decode(data[start : end + 1])
        if key in keys_of[-1]:
            where = position(data, start)
            raise SceneError(f"{where}: the key {clip(key)!r} occurs twice in its object")
        keys_of[-1].add(key)
