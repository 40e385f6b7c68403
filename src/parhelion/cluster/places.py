"""Clusters by name: of a scheduler's address, processes of this machine, jobs of a batch system."""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import math
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple
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
# How often in a row a scheduler is asked for its workers
_ASKED = 3
# Seconds after which processes of this machine that have all ended are taken not to begin again, as
# Dask gives up one that ends while it begins; and between two looks at that.
_GONE, _LOOK = 60.0, 1.0
# Before Python 3.11 asyncio's is another
TIMEOUTS = (TimeoutError, asyncio.TimeoutError, concurrent.futures.TimeoutError)


class Opened(NamedTuple):
    """client: of dask.distributed. threads: that each of its workers is to use, 0 for all of its
    cores. look: to be called while the first workers are waited for, and once they are there. gone:
    to be called while there are none any more. Both raise ResourceError where none can come.
    """

    client: Any
    threads: int
    look: Callable[[], None] = lambda: None
    gone: Callable[[], None] = lambda: None


@contextmanager
def opened(cluster: Any, threads: int) -> Iterator[Opened]:
    """A cluster. What was started for the block ends with it.

    cluster: one that is open, or a client; "local:4", four processes of this machine; a scheduler's
    address; "slurm:FILE", jobs as a file says. threads: of a worker, 0 for what is there. Raises
    SceneError for a name without meaning, FormatError for such a file, and ResourceError without
    the extra `cluster` or where nothing answers.
    """
    if isinstance(cluster, Opened):
        yield cluster
        return
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
        yield Opened(cluster, threads)
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
            each = threads or max(1, machine.cores_available() // count)
            check = partial(_check_processes, client, cluster, _Absence())
            yield Opened(client, each, check, check)
        elif kind == "slurm":
            jobs, refused = _jobs(cluster, rest)
            stack.enter_context(jobs)
            client = stack.enter_context(distributed.Client(jobs))
            _warn(client)

            def look() -> None:
                _check_jobs(client, refused)
                _go_direct(client)

            yield Opened(client, threads, look)
        else:
            client = stack.enter_context(_connected(distributed, cluster))
            _warn(client)
            yield Opened(client, threads, partial(_go_direct, client))


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask says nothing of its own work but errors, unless all is to be said."""
    theirs = [logging.getLogger(name) for name in ("distributed", "distributed.client", "asyncio")]
    levels = [logger.level for logger in theirs]
    if not log.isEnabledFor(logging.DEBUG):
        for logger in theirs:
            logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(theirs, levels, strict=True):
            logger.setLevel(level)


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


@dataclass
class _Absence:
    """Of all workers: since when, and when that was last looked at, as of time.monotonic()."""

    since: float = math.inf
    looked: float = -math.inf


def _check_processes(client: Any, cluster: str, absence: _Absence) -> None:
    """Raises ResourceError where none is there, nor will be."""
    now = time.monotonic()
    if now < absence.looked + _LOOK:
        return
    if now > absence.looked + 2.0 * _LOOK:  # nobody asked: some were there, or all else waited
        absence.since = math.inf
    absence.looked = now
    absence.since = math.inf if workers_of(client) else min(absence.since, now)
    if now > absence.since + _GONE:
        raise ResourceError(
            f"{cluster}: its processes have ended, and none began again for {_GONE:g} s"
        )


def _jobs(cluster: str, name: str) -> tuple[Any, Sequence[Exception]]:
    """Workers that are jobs of SLURM: a file's arguments of dask_jobqueue.SLURMCluster. And why
    jobs were refused, as that comes to be known.
    """
    file = Path(name)
    if not name:
        raise SceneError(f"{option('cluster')} is {cluster!r}; must be {_NAMES}")
    own = signal.getsignal(signal.SIGINT)
    try:
        import yaml
        from dask_jobqueue.slurm import SLURMCluster, SLURMJob
        from distributed import Status
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
    refused: list[Exception] = []

    # What batch systems say of a job comes to nobody otherwise.
    class Job(SLURMJob):
        async def start(self) -> None:
            try:
                await super().start()  # type: ignore[no-untyped-call]
            except Exception as error:
                refused.append(error)
                self.status = Status.failed
                raise

    class Jobs(SLURMCluster):
        job_cls = Job

    try:
        found = Jobs(**{"processes": 1, "name": "parhelion", **told})
    except (TypeError, ValueError, OSError, RuntimeError) as error:
        raise FormatError(f"{file}: {error}") from error
    found.scale(jobs=jobs)  # type: ignore[no-untyped-call]
    return found, refused


def _check_jobs(client: Any, refused: Sequence[Exception]) -> None:
    """Raises ResourceError where the batch system has taken no job."""
    if refused and not workers_of(client):
        said = [line.strip() for line in str(refused[0]).splitlines() if line.strip()]
        raise ResourceError(f"SLURM took no job: {said[-1] if said else repr(refused[0])}")


def _connected(distributed: Any, cluster: str) -> Any:
    """A client of the scheduler at an address."""
    kind, _, rest = cluster.partition(":")
    if kind not in ("tcp", "tls", "ucx", "ws", "wss") or not rest.startswith("//"):
        raise SceneError(f"{option('cluster')} is {cluster!r}; must be {_NAMES}")
    try:
        place = urlsplit(cluster)
        socket.getaddrinfo(place.hostname, place.port)
        return _within(_ANSWER + _REACH, lambda: _client(distributed, cluster))
    except (OSError, *TIMEOUTS) as error:
        why = str(error) or f"nothing that it says within {_ANSWER} s is of Dask"
        raise ResourceError(f"{cluster}: no scheduler answers: {why}") from error
    except ValueError as error:
        raise SceneError(f"{option('cluster')} is {cluster!r}: {error}") from error
    except TypeError as error:  # as Dask says it
        told = f"{option('cluster')} is {cluster!r}"
        if "identity()" in str(error):
            raise SceneError(f"{told}, a worker's address; must be its scheduler's") from error
        if kind == "tls":
            raise SceneError(
                f"{told}, and Dask has no certificates for TLS (docs/cluster.md)"
            ) from error
        raise ResourceError(f"{cluster}: Dask cannot connect by {kind}: {error}") from error


def _client(distributed: Any, address: str) -> Any:
    client = distributed.Client(address, timeout=_ANSWER)
    try:
        client.scheduler_info(n_workers=0)  # workers do not take that argument
    except TypeError:
        client.close()
        raise
    return client


def _within(seconds: float, make: Callable[[], Any]) -> Any:
    """What a function returns, in a thread that is left where it takes longer: Dask's own limit
    does not hold where something answers that is no scheduler. Raises one of TIMEOUTS.
    """
    made: concurrent.futures.Future[Any] = concurrent.futures.Future()

    def run() -> None:
        try:
            made.set_result(make())
        except BaseException as error:
            made.set_exception(error)

    Thread(target=run, daemon=True).start()
    return made.result(seconds)


def _go_direct(client: Any) -> None:
    """Has what is seen come straight from the workers, if they can be reached from here."""
    if client.direct_to_workers is not None:
        return
    worker = next(iter(workers_of(client)), None)
    if worker is not None:
        client.direct_to_workers = reaches(worker) or None


def workers_of(client: Any) -> dict[str, Any]:
    """What Dask tells of a cluster's workers, by their addresses. Raises ResourceError where the
    scheduler is gone.
    """
    workers: dict[str, Any] = {}
    # The client's own watch, which asks for few workers or none, may put its answer over ours.
    for _ in range(_ASKED):
        if client.status != "running":
            raise ResourceError("the cluster's scheduler is gone")
        told = client.scheduler_info(n_workers=-1)
        workers = told.get("workers", {})
        if len(workers) >= told.get("n_workers", 0):
            break
    return workers


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
