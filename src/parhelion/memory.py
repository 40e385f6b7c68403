"""The memory this process may still take."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path


def available(root: Path = Path("/")) -> int | None:
    """Bytes that can be had before the system ends a process for want of them; None if unknown.

    Linux promises more memory than there is and ends whoever uses it, so one can not wait for an
    allocation to fail. root: where proc and sys are mounted.
    """
    free = [_field(root / "proc/meminfo", "MemAvailable:", 1024), *_groups(root)]
    return min((n for n in free if n is not None), default=None)


def _groups(root: Path) -> Iterator[int | None]:
    """What this process's control groups, and those around them, have left; None is no limit."""
    v2, v1 = root / "sys/fs/cgroup", root / "sys/fs/cgroup/memory"
    for line in _lines(root / "proc/self/cgroup"):
        number, controllers, group = line.split(":", 2)
        path = Path(group.lstrip("/"))
        # the root last: seen from within a container, it is the group
        for folder in (path, *path.parents):
            if number == "0":
                yield _free(v2 / folder, "memory.max", "memory.current", "inactive_file")
            elif "memory" in controllers.split(","):
                names = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"
                yield _free(v1 / folder, *names)


def _free(folder: Path, limit: str, usage: str, cached: str) -> int | None:
    most, used = " ".join(_lines(folder / limit)), " ".join(_lines(folder / usage))
    if not (most.isdecimal() and used.isdecimal()):  # "max" is no limit
        return None
    # files that the system keeps in memory count as used, and make room when asked to
    reclaimable = _field(folder / "memory.stat", cached, 1) or 0
    return max(0, int(most) - int(used) + reclaimable)


def _field(path: Path, name: str, unit: int) -> int | None:
    for line in _lines(path):
        words = line.split()
        if len(words) > 1 and words[0] == name:
            return int(words[1]) * unit
    return None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(errors="replace").splitlines()
    except OSError:
        return []
