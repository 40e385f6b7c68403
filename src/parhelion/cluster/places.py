"""Clusters by name: of a scheduler's address, processes of this machine, jobs of a batch system."""

from __future__ import annotations

import asyncio
import itertools
import logging
import shutil
import signal
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from .. import machine, memory
from ..errors import FormatError, ResourceError, SceneError, option

log = logging.getLogger("parhelion")

_NAMES = "local:N, slurm:FILE, or a scheduler's address such as tcp://HOST:8786"
_MOST = 4096
# Seconds that a scheduler has to answer
_ANSWER = 10
# Seconds that a worker has to be reached without its scheduler
_REACH = 2.0
# Before Python 3.11 asyncio's is another
TIMEOUTS = (TimeoutError, asyncio.TimeoutError)


@contextmanager
def opened(cluster: Any, threads: int) -> Iterator[tuple[Any, int]]:
    """A client of dask.distributed, and how many threads each of its workers is to use, 0 for all
    of its cores. What was started for the block ends with it.

    cluster: a client; "local:4", four processes of this machine; a scheduler's address;
    "slurm:FILE", jobs as a file says. threads: of a worker, 0 for what is there. Raises SceneError
    for a name without meaning, FormatError for such a file, and ResourceError without the extra
    `cluster` or where nothing answers.
    """
    try:
        import distributed
    except ImportError:
        raise ResourceError(
            f"{option('cluster')} needs dask.distributed: pip install 'parhelion[cluster]'"
        ) from None
    if isinstance(cluster, distributed.Client):
        if cluster.asynchronous or cluster.status != "running":
            raise SceneError(f"{option('cluster')} is {cluster!r}; must be one that waits and runs")
        _warn(cluster)
        yield cluster, threads
        return
    if not isinstance(cluster, str):
        raise SceneError(
            f"{option('cluster')} is {cluster!r}; must be {_NAMES}, or a client of dask.distributed"
        )
    kind, _, rest = cluster.partition(":")
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        if kind == "local":
            count = _count(cluster, rest)
            processes = stack.enter_context(_processes(distributed, cluster, count))
            client = stack.enter_context(distributed.Client(processes, direct_to_workers=True))
            yield client, threads or max(1, machine.cores_available() // count)
        elif kind == "slurm":
            jobs = stack.enter_context(_jobs(Path(rest)))
            client = stack.enter_context(distributed.Client(jobs))
            _warn(client)
            _wait_for_one(client, jobs)
            _go_direct(client)
            yield client, threads
        else:
            client = stack.enter_context(_connected(distributed, cluster))
            _warn(client)
            _go_direct(client)
            yield client, threads


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask says nothing of its own work but errors, unless all is to be said."""
    theirs = logging.getLogger("distributed")
    level = theirs.level
    if not log.isEnabledFor(logging.DEBUG):
        theirs.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        theirs.setLevel(level)


def _share(count: int) -> int | None:
    """Bytes that each of so many workers may hold, and as many for this process."""
    free = memory.available()
    return None if free is None else free // (count + 1)


# What Dask watches of itself takes 2 % of two cores, and nobody looks; the memory that we take is
# estimated before.
_UNWATCHED = {
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": False,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}


def _processes(distributed: Any, cluster: str, count: int) -> Any:
    """So many workers on this machine."""
    import dask.config

    try:
        with dask.config.set(_UNWATCHED):
            return distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                memory_limit=_share(count),
                silence_logs="CRITICAL",
            )
    except RuntimeError as error:
        raise ResourceError(
            f"{cluster}: its processes do not start: {error} A script needs"
            ' `if __name__ == "__main__":` before what it does, as each process reads it'
        ) from error


def _jobs(file: Path) -> Any:
    """Workers that are jobs of SLURM: a file's arguments of dask_jobqueue.SLURMCluster."""
    own = signal.getsignal(signal.SIGINT)
    try:
        import yaml
        from dask_jobqueue import SLURMCluster
    except ImportError:
        raise ResourceError(
            "slurm:FILE needs dask-jobqueue: pip install 'parhelion[cluster]'"
        ) from None
    except ValueError as error:  # of setting a signal
        raise ResourceError("slurm:FILE is for the main thread of a program") from error
    if signal.getsignal(signal.SIGINT) is not own:  # importing it takes Ctrl-C to end the process
        signal.signal(signal.SIGINT, own)
    try:
        told = yaml.safe_load(file.read_text("utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise FormatError(f"{file}: cannot be read as YAML: {error}") from error
    if not isinstance(told, dict):
        raise FormatError(f"{file}: must hold names and values, such as jobs: 4")
    jobs = told.pop("jobs", None)
    if not isinstance(jobs, int) or not 1 <= jobs <= _MOST:
        raise FormatError(f"{file}: jobs is {jobs!r}; must be how many to ask for, 1 to {_MOST}")
    missing = [name for name in ("cores", "memory") if name not in told]
    if missing:
        raise FormatError(f"{file}: lacks {' and '.join(missing)} of a job")
    if shutil.which("sbatch") is None:
        raise ResourceError(f"{file}: there is no sbatch here to hand jobs to SLURM")
    try:
        cluster = SLURMCluster(**{"processes": 1, "name": "parhelion", **told})
    except (TypeError, ValueError, OSError, RuntimeError) as error:
        raise FormatError(f"{file}: {error}") from error
    cluster.scale(jobs=jobs)
    return cluster


def _wait_for_one(client: Any, jobs: Any) -> None:
    """Until the first job runs, for as long as that takes."""
    for seconds in itertools.chain([_ANSWER], itertools.repeat(3600)):
        with suppress(*TIMEOUTS):
            client.wait_for_workers(1, timeout=seconds)
            return
        if not jobs.workers:
            raise ResourceError("SLURM took no job")
        log.warning("waiting for SLURM to begin the first of %d jobs", len(jobs.workers))


def _connected(distributed: Any, cluster: str) -> Any:
    """A client of the scheduler at an address."""
    kind, _, rest = cluster.partition(":")
    if kind not in ("tcp", "tls", "ucx", "ws", "wss") or not rest.startswith("//"):
        raise SceneError(f"{option('cluster')} is {cluster!r}; must be {_NAMES}")
    try:
        return distributed.Client(cluster, timeout=_ANSWER)
    except (OSError, *TIMEOUTS) as error:
        raise ResourceError(f"{cluster}: no scheduler answers: {error}") from error
    except ValueError as error:
        raise SceneError(f"{option('cluster')} is {cluster!r}: {error}") from error
    except TypeError as error:  # as Dask says it
        if kind != "tls":
            raise
        raise SceneError(
            f"{option('cluster')} is {cluster!r}, and Dask has no certificates for TLS"
            " (docs/cluster.md)"
        ) from error


def _go_direct(client: Any) -> None:
    """Has what is seen come straight from the workers, if they can be reached from here."""
    workers = list(client.scheduler_info(n_workers=-1)["workers"])
    if workers and client.direct_to_workers is None:
        client.direct_to_workers = reaches(workers[0]) or None


def reaches(address: str) -> bool:
    """Whether a worker takes connections of this machine: it may be behind its scheduler alone."""
    place = urlsplit(address)
    try:
        with socket.create_connection((place.hostname or "", place.port or 0), _REACH):
            return True
    except (OSError, ValueError):  # a port that is none
        return False


def _warn(client: Any) -> None:
    """Of a scheduler on another machine that anybody on the way can listen to."""
    address = str(client.scheduler_info(n_workers=0)["address"])
    if not address.startswith(("tls:", "wss:", "inproc:")) and not is_here(address):
        log.warning(
            "%s: what is sent can be read and changed on the way; a scheduler with TLS has an"
            " address tls://HOST:PORT (docs/cluster.md)",
            address,
        )


def is_here(address: str) -> bool:
    """Whether an address is one of this machine alone."""
    host = urlsplit(address).hostname or ""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _count(cluster: str, text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        count = 0
    if not 1 <= count <= _MOST:
        raise SceneError(
            f"{option('cluster')} is {cluster!r}; must be local:N, N processes from 1 to {_MOST}"
        )
    return count
