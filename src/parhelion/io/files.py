"""What readers share: contents of files, those that a scene may name, what it asks for in vain."""

from __future__ import annotations

import logging
import zlib
from collections.abc import Sequence
from pathlib import Path

from ..errors import FormatError, SceneError, plain
from . import require_memory

log = logging.getLogger("parhelion")

# Text and meshes pack some ten times, those that repeat themselves some hundred times more. What
# unpacks to more than so many times its size, and to more than so many bytes, is made to fill the
# memory.
_RATIO = 20
_ALWAYS = 1 << 26
# Bytes of one file
_LARGEST = 1 << 32
# Of integrators that follow light from its sources too, often chosen for caustics
PATH_TRACED = "rendered by path tracing, which finds caustics of small lights seldom or never"
# Lines about one scene that are told; of more, how many there are
_TOLD = 50


def contents(path: Path) -> bytes:
    """The file's bytes, unpacked if its name ends in .gz. Raises FormatError, OSError, and
    ResourceError if reading it would take more memory than is free.
    """
    size = path.stat().st_size
    if size > _LARGEST:
        raise FormatError(f"{path}: is larger than {_LARGEST >> 30} GiB")
    require_memory(path)
    data = path.read_bytes()
    if path.suffix.lower() != ".gz":
        return data
    most = max(_RATIO * size, _ALWAYS)
    unpacked: list[bytes] = []
    room = most
    while data:  # members, one after the other
        unpacker = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
        try:
            part = unpacker.decompress(data, room + 1)
        except zlib.error as error:
            raise FormatError(f"{path}: cannot be unpacked: {error}") from None
        if len(part) > room:
            raise FormatError(f"{path}: unpacks to more than {most} bytes, {_RATIO} times its size")
        if not unpacker.eof:
            raise FormatError(f"{path}: is cut short")
        unpacked.append(part)
        room -= len(part)
        data = unpacker.unused_data
    return unpacked[0] if len(unpacked) == 1 else b"".join(unpacked)


class Included:
    """What the files come to that a scene's files include. One may be included many times, each a
    few bytes that ask for as much again.
    """

    # So many bytes in all, or so many times the bytes of each once. A statement counts for more
    # than its bytes, since it takes as long as so much text.
    _ALWAYS, _TIMES, _STATEMENT = 1 << 26, 16, 512

    def __init__(self) -> None:
        self._once: dict[Path, int] = {}
        self._in_all = 0

    def add(self, path: Path, size: int, statements: int) -> None:
        """Counts a file that has been read."""
        self._once[path] = size + self._STATEMENT * statements
        self._in_all += self._once[path]

    def check(self, helps: str) -> None:
        """Raises SceneError where it is too much; helps: against that."""
        if self._in_all > max(self._ALWAYS, self._TIMES * sum(self._once.values())):
            raise SceneError(
                f"included files come to more than {self._TIMES} times what they hold, and to more"
                f" than {self._ALWAYS >> 20} MiB, of which {self._STATEMENT} bytes for each"
                f" statement; {helps}"
            )


class Folders:
    """The folder of a scene, and others that the user allows with --allow-path.

    Files elsewhere are not opened, nor is it said whether they exist.
    """

    def __init__(self, own: Path, allowed: Sequence[str] = ()) -> None:
        self.own = own.resolve()
        self.roots = (self.own, *(Path(folder).expanduser().resolve() for folder in allowed))

    def allows(self, file: Path) -> bool:
        """Whether a resolved path lies in one of the folders or below."""
        return any(file.is_relative_to(root) for root in self.roots)

    def file(self, name: str, where: str, beside: Path | None = None) -> Path:
        """The file of that name, by its path from the scene's folder or from `beside`.

        Raises SceneError, beginning with `where`, if it lies elsewhere or is not there.
        """
        shown = _shown(name)
        try:
            file = ((beside or self.own) / name).resolve()
            if not self.allows(file):
                raise self.outside(name, where)
            if not file.is_file():
                raise SceneError(f"{where}: {shown}: no such file")
        except SceneError:
            raise
        except (OSError, RuntimeError, ValueError) as error:  # too long, a loop of links, a NUL
            reason = getattr(error, "strerror", None) or error
            raise SceneError(f"{where}: {shown} cannot be read: {reason}") from None
        return file

    def outside(self, name: str, where: str) -> SceneError:
        """The error for a file that lies in none of the folders."""
        return SceneError(
            f"{where}: {_shown(name)} is not inside the scene's folder (--allow-path allows others)"
        )


def _shown(name: str) -> str:
    return repr(name if len(name) <= 80 else name[:77] + "...")


class Reports:
    """What a scene asks for and we do not do: one line a feature, in order, each once."""

    def __init__(self, path: Path, strict: bool) -> None:
        self.path = path
        self.strict = strict
        self.lines: dict[str, None] = {}
        self._told = 0

    def add(self, text: str) -> None:
        """Notes a feature; the text names it and says what is done instead."""
        self.lines.setdefault(plain(text))

    def tell(self) -> None:
        """Logs what is new as warnings. Raises FormatError about all if the user is strict."""
        if self.lines and self.strict:
            lines = "".join(f"\n  {text}" for text in _first(list(self.lines)))
            raise FormatError(f"{self.path}: strict, and not all of it is supported:{lines}")
        for text in _first(list(self.lines)[self._told :]):
            log.warning("%s: %s", self.path.name, text)
        self._told = len(self.lines)


def _first(lines: list[str]) -> list[str]:
    """As many as are told, then one about the rest."""
    rest = len(lines) - _TOLD
    return [*lines[:_TOLD], f"and {rest} more"] if rest > 0 else lines
