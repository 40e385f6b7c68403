"""The machine: processor, cores that this process may and does use, versions, load."""

from __future__ import annotations

import functools
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any


def cores_available() -> int:
    """Hardware threads this process may use: its affinity, and no more than its CPU quota."""
    quota = _cpu_quota()
    return min(_affinity(), max(1, math.ceil(quota))) if quota else _affinity()


@contextmanager
def threads(count: int = 0) -> Iterator[None]:
    """What the calling thread asks of the core meanwhile is done by so many threads.

    0: by as many as before, but no more than cores_available(), which knows of quotas.
    """
    from . import _core

    before = _core.max_threads()
    _core.set_max_threads(count or min(before, cores_available()))
    try:
        yield
    finally:
        _core.set_max_threads(before)


def describe() -> dict[str, Any]:
    """What a reader needs to judge the timings, as plain values for JSON."""
    return {
        "cpu": _cpu_model(),
        "architecture": platform.machine(),
        "cores_available": cores_available(),
        "physical_cores_available": _physical_cores(),
        "hardware_threads": os.cpu_count(),
        "cpu_quota": _cpu_quota(),
        "os": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "packages": {
            name: _version(name) for name in ("parhelion", "numpy", "matplotlib", "OpenImageIO")
        },
        "openmp_environment": {
            name: value
            for name, value in sorted(os.environ.items())
            if name.startswith(("OMP_", "GOMP_", "KMP_"))
        },
    }


def lines(path: str | os.PathLike[str]) -> list[str]:
    """Of one of the system's files; none where it cannot be read."""
    # By the system's calls: some nine files are read for each scene and picture, however small.
    try:
        file = os.open(path, os.O_RDONLY)
    except OSError:
        return []
    try:
        text = b"".join(iter(lambda: os.read(file, 2**16), b""))
    except OSError:
        return []
    finally:
        os.close(file)
    return text.decode(errors="replace").splitlines()


def load_average() -> float | None:
    """Programs that wanted a core, averaged over the last minute; None where not known."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return None


def _affinity() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _cpu_quota() -> float | None:
    """Cores' worth of CPU time a Linux control group grants, as containers set it, or None.

    Looked up once: a change while the process runs is not seen.
    """
    group = "/"
    for line in lines("/proc/self/cgroup"):
        if line.startswith("0::/"):
            group = line[3:]
    limits = []
    for folder in (Path(group), *Path(group).parents):
        words = " ".join(lines(f"/sys/fs/cgroup{folder}/cpu.max")).split()
        if len(words) == 2 and words[0].isdecimal() and words[1].isdecimal():
            limits.append(int(words[0]) / int(words[1]))
    return min(limits, default=None)


def _cpu_model() -> str:
    for line in lines("/proc/cpuinfo"):
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            return value.strip()
    if sys.platform == "darwin":
        command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
        try:
            return subprocess.run(command, capture_output=True, text=True, timeout=5).stdout.strip()
        except (OSError, subprocess.SubprocessError):
            pass
    return platform.processor() or "unknown processor"


def _physical_cores() -> int | None:
    """Cores that do not share their arithmetic units with another one counted; None if unknown."""
    if not hasattr(os, "sched_getaffinity"):
        return None
    siblings = {
        tuple(lines(f"/sys/devices/system/cpu/cpu{n}/topology/thread_siblings_list"))
        for n in os.sched_getaffinity(0)
    }
    return None if () in siblings else len(siblings)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
