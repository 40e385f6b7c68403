"""Reading text files of columns: plain or compressed, forward, in blocks, without keeping them.

What the formats of particle trajectories share: lines of header between tables of numbers and
names that are too long for a Python loop over their lines.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import re
import warnings
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, cast

import numpy as np
from numpy.typing import NDArray

from .. import memory
from ..errors import FormatError, SceneError
from ..particles import Labels, Particles
from . import COLUMN_TAKES, ROW_TAKES

# Bytes read at once; a block takes some twenty times as much while its columns are parsed.
_BLOCK = 1 << 20
# The longest line in bytes; a table's are far shorter, so a longer one is no text of ours.
_LONGEST_LINE = 1 << 20
# Bytes in the longest word that is not a number.
_LONGEST_WORD = 64
# Text of this many bytes or more that was packed better than this many times is a decompression
# bomb: trajectories of numbers pack 3 to 30 times.
_BOMB_SIZE = 1 << 26
_BOMB_RATIO = 250

# Bytes of text before it, and lines
Place = tuple[int, int]

_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.I | re.A)


@contextmanager
def errors_name(path: Path) -> Iterator[None]:
    """Turns a SceneError about particles into a FormatError that begins with the file's path."""
    try:
        yield
    except FormatError:
        raise
    except SceneError as error:
        raise FormatError(f"{path}: {error}") from None


def _unpacking(file: IO[bytes], suffix: str) -> IO[bytes]:
    """The file's bytes, unpacked as the ending of its name says."""
    if suffix == ".gz":
        return cast("IO[bytes]", gzip.GzipFile(fileobj=file, mode="rb"))
    if suffix == ".bz2":
        return bz2.BZ2File(file)
    return lzma.LZMAFile(file) if suffix == ".xz" else file


def is_number(word: str) -> bool:
    """Whether a word is a decimal number, "nan" or "inf"."""
    return _NUMBER.fullmatch(word) is not None


def frame_index(path: Path, frame: int, count: int) -> int:
    """The frame counted from 0 of a file with `count` frames. Raises FormatError if it has none."""
    if not -count <= frame < count:
        frames = "1 frame: 0" if count == 1 else f"{count} frames: 0 to {count - 1}"
        raise FormatError(f"{path}: there is no frame {frame}; the file has {frames}")
    return frame % count


@dataclass(frozen=True)
class Trajectory:
    """The frames of an open file: how many there are, and what reads one, counted from 0."""

    count: int
    read: Callable[[int], Particles]


@dataclass(frozen=True)
class Table:
    """Columns by position: numbers as (N,) float64 arrays, the others as Labels."""

    columns: tuple[NDArray[np.float64] | Labels, ...]

    def numbers(self, column: int) -> NDArray[np.float64]:
        """A column that is known to be numbers."""
        found = self.columns[column]
        assert not isinstance(found, Labels)
        return found


class TextFile:
    """A text file that is read forward; its errors are FormatErrors that name the line.

    line: the number of lines read so far.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.line = 0
        self._packed = path.open("rb")
        self._suffix = path.suffix.lower()
        self._file = _unpacking(self._packed, self._suffix)
        self._unpacked = 0  # bytes read of _file
        self._text = b""  # read but not yet used from _at on
        self._at = 0

    def __enter__(self) -> TextFile:
        """The file itself; it is closed at the end of the block."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        """Closes the file."""
        self._file.close()
        self._packed.close()

    def error(self, text: str, line: int | None = None) -> FormatError:
        """The error about a line; the last one read unless another is given."""
        return FormatError(f"{self.path}: line {self.line if line is None else line}: {text}")

    def decode(self, text: bytes, line: int | None = None) -> str:
        """Bytes of a line as text."""
        try:
            return text.decode("utf-8")
        except UnicodeDecodeError:
            raise self.error("is not UTF-8 text", line) from None

    def readline(self) -> str | None:
        """The next line without blanks at its ends; None at the end of the file."""
        if not self._fill():
            return None
        end = self._text.index(b"\n", self._at)
        text, self._at = self._text[self._at : end], end + 1
        self.line += 1
        return self.decode(text).strip()

    def peek(self) -> str | None:
        """The line that readline() reads next."""
        if not self._fill():
            return None
        before = self._at, self.line
        line = self.readline()
        self._at, self.line = before
        return line

    def skip(self, lines: int) -> bool:
        """Passes over lines; False if the file has fewer."""
        while lines > 0:
            _, count = self._take(lines)
            if not count:
                return False
            lines -= count
        return True

    def blocks(self) -> Iterator[bytes]:
        """The rest of the file in blocks of whole lines."""
        while block := self._take(_BLOCK)[0]:
            yield block

    def table(
        self, rows: int, names: Sequence[str], words: Sequence[int], what: str = "atoms"
    ) -> Table:
        """Reads a table of so many rows of so many columns, separated by blanks.

        words: columns, by position, that are not numbers. Raises FormatError naming the line and
        the column for one that does not fit.
        """
        known: dict[int, dict[bytes, int]] = {column: {} for column in words}
        numeric = [column for column in range(len(names)) if column not in known]
        room = min(rows, self._most_rows(len(names)))
        memory.require(
            room * (ROW_TAKES + COLUMN_TAKES * len(names)),
            f"reading {rows:,} {what} of {self.path.name}",
            "fewer take less",
        )
        numbers = {column: np.empty(room) for column in numeric}
        codes = {column: np.empty(room, np.int32) for column in words}
        read = 0
        while read < rows:
            first = self.line + 1
            text, count = self._take(rows - read)
            if not count:
                raise self.error(f"the file ends after {read} of {rows} {what}")
            if read + count > room:
                raise self.error("the file has grown while it was read")
            if known:
                data = np.frombuffer(text, np.uint8).copy()
                starts, ends = self._split(data, count, names, first)
                for column in words:
                    at = starts[:, column], ends[:, column]
                    found = self._encode(data, *at, known[column], first)
                    codes[column][read : read + count] = found
                text = data.tobytes()
            values = self._parse(text, count, names, numeric, first)
            for i, column in enumerate(numeric):
                numbers[column][read : read + count] = values[:, i]
            read += count
        labels = {
            column: Labels(codes[column], tuple(self.decode(word) for word in known[column]))
            for column in words
        }
        return Table(tuple(labels[i] if i in labels else numbers[i] for i in range(len(names))))

    # -----------------------------------------------------------------------------------------

    def _most_rows(self, columns: int) -> int:
        """More rows of numbers than the file can hold, whatever a count in it says."""
        size = os.fstat(self._packed.fileno()).st_size
        if self._file is not self._packed:
            size = max(_BOMB_SIZE, _BOMB_RATIO * size) + _BLOCK
        return size // (2 * columns) + 1  # a digit and what separates it from the next

    def _fill(self) -> bool:
        """Makes sure that a whole line is at hand; False at the end of the file."""
        if self._text.find(b"\n", self._at) >= 0:
            return True
        parts = [self._text[self._at :]]
        size = len(parts[0])
        while True:
            part = self._read()
            parts.append(part if part or not size else b"\n")  # the last line may lack its end
            size += len(part)
            if not part or b"\n" in part:
                break
            if size > _LONGEST_LINE:
                raise self.error("is longer than a line of text can be", self.line + 1)
        self._text, self._at = b"".join(parts), 0
        if self.line == 0 and self._text.startswith(b"\xef\xbb\xbf"):
            self._at = 3  # byte order mark
        return bool(self._text)

    def _read(self) -> bytes:
        try:
            part = self._file.read(_BLOCK)
        except (EOFError, OSError, zlib.error, lzma.LZMAError) as error:
            if self._file is self._packed:
                raise
            raise FormatError(f"{self.path}: broken {self._suffix} data: {error}") from None
        self._unpacked += len(part)
        if self._unpacked > max(_BOMB_SIZE, _BOMB_RATIO * self._packed.tell()):
            raise FormatError(
                f"{self.path}: unpacks to more than {_BOMB_RATIO} times its size, "
                "which no file of particles does"
            )
        return part

    def _take(self, most: int) -> tuple[bytes, int]:
        """Whole lines that are at hand, up to a number; none at the end of the file."""
        if not self._fill():
            return b"", 0
        # no farther than so many lines are likely to reach, as frames may be small
        reach = self._at + 256 * most
        end = self._text.rfind(b"\n", self._at, reach) + 1
        if end <= self._at or len(self._text) <= reach:
            end = self._text.rindex(b"\n") + 1
        newlines = np.frombuffer(self._text, np.uint8)[self._at : end] == ord("\n")
        count = int(np.count_nonzero(newlines))
        if count > most:
            end = self._at + int(np.flatnonzero(newlines)[most - 1]) + 1
            count = most
        text, self._at = self._text[self._at : end], end
        self.line += count
        return text, count

    def _split(
        self, data: NDArray[np.uint8], rows: int, names: Sequence[str], first: int
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """(rows, columns) positions where words start and end in whole lines of text."""
        blank = data <= ord(" ")
        edges = np.flatnonzero(blank[1:] != blank[:-1]) + 1
        if not blank[0]:
            edges = np.concatenate(([0], edges))
        starts, ends = edges[0::2], edges[1::2]
        newlines = np.flatnonzero(data == ord("\n"))
        if len(starts) == rows * len(names):
            starts, ends = starts.reshape(rows, -1), ends.reshape(rows, -1)
            if (starts[1:, 0] > newlines[:-1]).all() and (ends[:, -1] <= newlines).all():
                return starts, ends
        found = np.diff(np.searchsorted(starts.reshape(-1), newlines), prepend=0)
        row = int(np.flatnonzero(found != len(names))[0])
        raise self.error(
            f"has {found[row]} columns, not {len(names)} ({' '.join(names[:20])})", first + row
        )

    def _encode(
        self,
        data: NDArray[np.uint8],
        starts: NDArray[np.intp],
        ends: NDArray[np.intp],
        known: dict[bytes, int],
        first: int,
    ) -> NDArray[np.int32]:
        """Codes of one column's words, which are then made blank; `known` grows."""
        width = int((ends - starts).max())
        if width > _LONGEST_WORD:
            row = int(np.argmax(ends - starts))
            raise self.error(f"has a word of {width} characters", first + row)
        width = max(8, width)
        at = starts[:, None] + np.arange(width)
        inside = at < ends[:, None]
        chars = np.where(inside, data[np.minimum(at, len(data) - 1)], np.uint8(0))
        data[at[inside]] = ord(" ")
        # words of up to eight bytes sort much faster as integers
        packed = chars.reshape(-1).view(np.uint64 if width == 8 else f"S{width}")
        words, codes = np.unique(packed, return_inverse=True)
        table = [known.setdefault(word, len(known)) for word in words.view(f"S{width}").tolist()]
        return np.array(table, np.int32)[codes.reshape(-1)]

    def _parse(
        self, text: bytes, rows: int, names: Sequence[str], numeric: Sequence[int], first: int
    ) -> NDArray[np.float64]:
        """The numbers of whole lines of text in which words are blank: (rows, columns)."""
        if not numeric:
            return np.empty((rows, 0))
        try:
            lines = text.decode("ascii").split("\n")
            lines.pop()  # after the last line's end
            with warnings.catch_warnings():
                warnings.simplefilter("error", UserWarning)  # of no data
                values = np.loadtxt(lines, comments=None, ndmin=2)
            if values.shape == (rows, len(numeric)):
                return values
        except (ValueError, UserWarning):
            pass
        if len(numeric) == len(names):
            self._split(np.frombuffer(text, np.uint8), rows, names, first)
        for line, row in enumerate(text.split(b"\n"), first):
            for column, word in zip(numeric, row.split(), strict=False):
                shown = self.decode(word, line)
                if not is_number(shown):
                    place = f"column {column + 1} ({names[column]})"
                    raise self.error(f"{place}: {shown[:40]!r} is not a number", line)
        raise self.error("holds something that is not a number", first)

    # -----------------------------------------------------------------------------------------

    def seek_frame(self, frame: int, skip: Callable[[], bool]) -> None:
        """Goes to the start of a frame, counted from 0, or from the end if negative.

        skip: reads from the start of a frame to its end; returns False where there is none.
        Raises FormatError if there is no such frame.
        """
        marks: deque[Place] = deque(maxlen=max(1, -frame))
        count = 0
        while frame < 0 or count < frame:
            place = self.place()
            if not skip():
                break
            marks.append(place)
            count += 1
        if count and frame < 0:
            frame_index(self.path, frame, count)
            self.go(marks[0])
            return
        while self.peek() == "":
            self.readline()
        if self.peek() is None:
            if not count:
                raise FormatError(f"{self.path}: is empty")
            frame_index(self.path, frame, count)

    def frames(self, skip: Callable[[], bool]) -> list[Place]:
        """Where each frame starts; see seek_frame(). Raises FormatError for a file without any."""
        places = [self.place()]
        while skip():
            places.append(self.place())
        if len(places) == 1:
            raise FormatError(f"{self.path}: is empty")
        return places[:-1]

    def place(self) -> Place:
        """Where readline() reads next."""
        return self._unpacked - len(self._text) + self._at, self.line

    def go(self, place: Place) -> None:
        """Goes back or on to a place(). Of a packed file, going back is unpacking it anew."""
        at, line = place
        start = self._unpacked - len(self._text)
        if start <= at <= self._unpacked and line:  # a byte order mark is passed over anew
            self._at, self.line = at - start, line
            return
        self._file.seek(at)
        self._unpacked, self._text, self._at, self.line = at, b"", 0, line


def text_frame(
    path: Path,
    frame: int,
    skip: Callable[[TextFile], bool],
    make: Callable[[TextFile], Particles],
) -> Particles:
    """One frame of a file, counted from 0, or from the end if negative. Raises FormatError."""
    with errors_name(path), TextFile(path) as file:
        file.seek_frame(frame, lambda: skip(file))
        return make(file)


@contextmanager
def text_trajectory(
    path: Path, skip: Callable[[TextFile], bool], read: Callable[[TextFile], Particles]
) -> Iterator[Trajectory]:
    """All frames of a text file: an index of where they start, made in one pass over it.

    skip, read: pass over, and parse, the frame that starts where the file is; see seek_frame().
    """
    with TextFile(path) as file:
        with errors_name(path):
            places = file.frames(lambda: skip(file))

        def at(frame: int) -> Particles:
            with errors_name(path):
                file.go(places[frame])
                return read(file)

        yield Trajectory(len(places), at)
