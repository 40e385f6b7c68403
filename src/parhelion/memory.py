"""The memory this process may still take, and what is said where that is too little."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from .errors import ResourceError, SceneError, option
from .machine import cores_available, lines

# What the user allows the process to hold, in bytes
_LIMIT: ContextVar[int | None] = ContextVar("memory limit", default=None)

_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
# Address space that the C library sets aside for the small objects of each thread, mostly in vain
_HEAP = 2**26
# What NumPy's linear algebra takes when it is first used, and ends the process where there is none
_LIBRARY = 2**25
# A thread's stack where the system does not say how large it may be
_STACK = 2**23
# From here on the limit of a control group of the first kind is none
_NO_LIMIT = 2**62


# Threads that have run already
_started = 0

_P = ParamSpec("_P")
_R = TypeVar("_R")


@dataclass(frozen=True, order=True)
class Free:
    """Bytes that can be had, and of what they are the rest, as a sentence ends with it."""

    bytes: int
    of: str


def free(root: Path = Path("/"), threads: int = 0) -> Free | None:
    """What can be had before the system refuses more, or ends a process for want of it.

    Linux promises more memory than there is and ends whoever uses it, so one can not wait for an
    allocation to fail. None if nothing is known. root: where proc and sys are mounted. threads:
    that will run; 0 for one a core.
    """
    return min(_all(root, threads), default=None)


def available(root: Path = Path("/")) -> int | None:
    """The bytes of free()."""
    found = free(root)
    return None if found is None else found.bytes


@contextmanager
def limited(limit: Any) -> Iterator[None]:
    """In the block the process may hold no more than this, as checked() has it; None: no change."""
    token = _LIMIT.set(_LIMIT.get() if limit is None else checked(limit))
    try:
        yield
    finally:
        _LIMIT.reset(token)


def limit() -> int | None:
    """The bytes of the limited() block that this is in; None for no limit."""
    return _LIMIT.get()


def checked(limit: Any) -> int:
    """Bytes of a limit: a number, or a text such as "4G" in K, M, G or T of 1024.

    Raises SceneError for anything else.
    """
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([KMGT]?)(?:i?B)?\s*", str(limit).strip(), re.I)
    if found is None or isinstance(limit, bool) or not float(found[1]):
        raise SceneError(
            f"{option('memory_limit')} is {limit!r}; must be a number of bytes, or one of K, M, G"
            " or T as in 4G"
        )
    return int(min(float(found[1]) * _UNITS[found[2].upper()], 2.0**63))


def require(needed: int, what: str, helps: str, threads: int = 0) -> None:
    """Raises ResourceError if so many bytes are more than are free.

    what: needs them. helps: against that. threads: as for free().
    """
    found = free(threads=threads)
    if found is not None and needed > found.bytes:
        raise refusal(f"{what} takes {amount(needed)}", found, helps)


def refusal(takes: str, found: Free, helps: str) -> ResourceError:
    """The error for what takes more than is free."""
    return ResourceError(
        f"not enough memory: {takes}, and {amount(found.bytes)} {found.of}; {helps}"
    )


def amount(size: float) -> str:
    """A number of bytes to read."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def told(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """What finds no memory, however little it asks for, then raises ResourceError."""

    @wraps(function)
    def telling(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            return function(*args, **kwargs)
        except MemoryError as error:
            reason = f": {error}" if str(error) else ""
            raise ResourceError(f"not enough memory{reason}") from error
        except RuntimeError as error:
            if "start new thread" not in str(error):
                raise
            raise ResourceError(f"not enough memory: {error}") from error

    return telling


def note_threads(count: int) -> None:
    """Notes that so many threads have run, and need no more stacks."""
    global _started
    _started = max(count, _started) if count else 0


if hasattr(os, "register_at_fork"):  # they end before a fork
    os.register_at_fork(before=lambda: note_threads(0))


def _all(root: Path, threads: int) -> Iterator[Free]:
    # Paths are texts here, as making Path objects takes as long as reading the files.
    left = _field(lines(f"{root}/proc/meminfo"), "MemAvailable:", 1024)
    if left is not None:
        yield Free(left, "are free")
    for group in _groups(root):
        if group is not None:
            yield Free(group, "are left to the control group")
    status, limits = lines(f"{root}/proc/self/status"), lines(f"{root}/proc/self/limits")
    limit, held = _LIMIT.get(), _field(status, "VmRSS:", 1024)
    if limit is not None:
        yield Free(max(0, limit - (held or 0)), f"are left of {option('memory_limit')}")
    # a thread that cannot start ends the process
    stack = _limit(limits, "Max stack size") or _STACK
    for name, used, each, of in (
        (
            "Max address space",
            "VmSize:",
            stack + _HEAP,
            "are left of the address space (ulimit -v) beside threads' stacks",
        ),
        (
            "Max data size",
            "VmData:",
            stack,
            "are left of the data segment (ulimit -d) beside threads' stacks",
        ),
    ):
        most, taken = _limit(limits, name), _field(status, used, 1024)
        if most is not None and taken is not None:
            new = max(0, (threads or cores_available()) - _started)
            yield Free(max(0, most - taken - new * each - _LIBRARY), of)


def _limit(text: list[str], name: str) -> int | None:
    """A limit of the process's in bytes; None is no limit."""
    for line in text:
        if line.startswith(name):
            soft = line[len(name) :].split()[0]
            return int(soft) if soft.isdecimal() else None
    return None


def _groups(root: Path) -> Iterator[int | None]:
    """What this process's control groups, and those around them, have left; None is no limit."""
    v2, v1 = f"{root}/sys/fs/cgroup", f"{root}/sys/fs/cgroup/memory"
    for line in lines(f"{root}/proc/self/cgroup"):
        number, controllers, group = line.split(":", 2)
        if number != "0" and "memory" not in controllers.split(","):
            continue
        names = [name for name in group.split("/") if name]
        # the root last: seen from within a container, it is the group
        for depth in range(len(names), -1, -1):
            folder = "/".join(names[:depth])
            if number == "0":
                yield _free(f"{v2}/{folder}", "memory.max", "memory.current", "inactive_file")
            else:
                of = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"
                yield _free(f"{v1}/{folder}", *of)


def _free(folder: str, limit: str, usage: str, cached: str) -> int | None:
    most = " ".join(lines(f"{folder}/{limit}"))
    if not most.isdecimal() or int(most) >= _NO_LIMIT:  # "max" is none either
        return None
    used = " ".join(lines(f"{folder}/{usage}"))
    if not used.isdecimal():
        return None
    # files that the system keeps in memory count as used, and make room when asked to
    reclaimable = _field(lines(f"{folder}/memory.stat"), cached, 1) or 0
    return max(0, int(most) - int(used) + reclaimable)


def _field(text: list[str], name: str, unit: int) -> int | None:
    for line in text:
        words = line.split()
        if len(words) > 1 and words[0] == name:
            return int(words[1]) * unit
    return None
