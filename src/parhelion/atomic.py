"""Writing a file so that the old one is whole until the new one is complete."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import ResourceError, SceneError

if sys.platform != "win32":
    import fcntl

_PREFIX = ".parhelion-"


@contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """A temporary path with the same ending; when the block ends well it takes the file's place.

    A link is followed: what it points to is replaced, not the link. A device or a pipe, which
    cannot be replaced, is written to. Raises ResourceError for whatever the system refuses, in the
    block too; the temporary file is gone then and the old one untouched.
    """
    with taking_place(file) as temporary, _refusals(file):
        yield temporary


@contextmanager
def taking_place(file: Path) -> Iterator[Path]:
    """As replacing(), but errors of the block, which may do other work too, stay what they are."""
    with _refusals(file):
        target = Path(os.path.realpath(file))
        special = is_special(target)
        folder = None if special else target.parent
        handle, temporary = _held(file.suffix, folder)
    try:
        yield temporary
        with _refusals(file):
            if special:
                with open(target, "wb") as device:
                    device.write(temporary.read_bytes())
            else:
                os.chmod(temporary, _mode(target))
                _sync(temporary)
                os.replace(temporary, target)
                _sync(target.parent)
    finally:
        temporary.unlink(missing_ok=True)
        with suppress(OSError):  # nothing was written through it
            os.close(handle)


def clear(folder: Path) -> None:
    """Removes temporary files that processes left in a folder when they were killed.

    A file that is being written is locked by its process, whose end ends the lock; where files
    cannot be locked, none is removed.
    """
    if sys.platform == "win32":
        return
    for file in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):  # another process's, who may do as it likes
            handle = os.open(file, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                file.unlink()
            finally:
                os.close(handle)


def _held(suffix: str, folder: Path | None) -> tuple[int, Path]:
    """An open, locked temporary file and its path."""
    while True:
        handle, name = tempfile.mkstemp(suffix=suffix, prefix=_PREFIX, dir=folder)
        if sys.platform != "win32":
            with suppress(OSError):  # this file system knows no locks
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.fstat(handle).st_nlink or sys.platform == "win32":
            return handle, Path(name)
        os.close(handle)  # clear() of another process came in between


@contextmanager
def _refusals(file: Path) -> Iterator[None]:
    """Turns what the system refuses into a ResourceError about the file."""
    try:
        yield
    except ResourceError as error:
        raise ResourceError(f"{file}: cannot be written: {error}") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise ResourceError(f"{file}: cannot be written: {reason}") from error


def check_apart(output: str | os.PathLike[str], *sources: str | os.PathLike[str]) -> None:
    """Raises SceneError for a file to be written that is one of those to be read."""
    for source in sources:
        same = False
        with suppress(OSError, ValueError):  # one is not there, or has no name that may be
            same = os.path.samefile(source, output)
        if same:
            raise SceneError(f"{output}: is what is to be read; give the result another name")


def is_special(path: Path) -> bool:
    """Something that is there but no regular file."""
    try:
        return not stat.S_ISREG(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def _mode(target: Path) -> int:
    """The permissions of the old file, or those of any new one."""
    try:
        return stat.S_IMODE(target.stat().st_mode)
    except OSError:
        umask = os.umask(0)
        os.umask(umask)
        return 0o666 & ~umask


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
