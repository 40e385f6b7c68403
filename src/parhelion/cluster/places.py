"""Clusters by name: that of a scheduler's address, or processes of this machine."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from .. import machine
from ..errors import ResourceError, SceneError, option

log = logging.getLogger("parhelion")

_MOST = 4096
# Seconds that a scheduler has to answer
_ANSWER = 10


@contextmanager
def opened(cluster: Any, threads: int) -> Iterator[tuple[Any, int]]:
    """A client of dask.distributed, and how many threads each of its workers is to use, 0 for all
    of its cores. What was started for the block ends with it.

    cluster: a client; "local:4", four processes of this machine; a scheduler's address. threads:
    of a worker, 0 for what is there. Raises SceneError for a name without meaning and ResourceError
    without the extra `cluster` or where nothing answers.
    """
    try:
        import distributed
    except ImportError:
        raise ResourceError(
            f"{option('cluster')} needs dask.distributed: pip install 'parhelion[cluster]'"
        ) from None
    if isinstance(cluster, distributed.Client):
        yield cluster, threads
        return
    if not isinstance(cluster, str):
        raise SceneError(
            f"{option('cluster')} is {cluster!r}; must be local:N, a scheduler's address such as"
            " tcp://HOST:8786, or a client of dask.distributed"
        )
    kind, _, rest = cluster.partition(":")
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        if kind == "local":
            count = _count(cluster, rest)
            processes = stack.enter_context(_processes(distributed, cluster, count))
            client = stack.enter_context(distributed.Client(processes, direct_to_workers=True))
            yield client, threads or max(1, machine.cores_available() // count)
        else:
            yield stack.enter_context(_connected(distributed, cluster)), threads


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


# What Dask watches of itself takes 2 % of two cores, and nobody looks.
_UNWATCHED = {
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
                memory_limit=None,  # ours is estimated before it is taken
                silence_logs="CRITICAL",
            )
    except RuntimeError as error:
        raise ResourceError(
            f"{cluster}: its processes do not start: {error} A script needs"
            ' `if __name__ == "__main__":` before what it does, as each process reads it'
        ) from error


def _connected(distributed: Any, cluster: str) -> Any:
    """A client of the scheduler at an address."""
    kind, _, rest = cluster.partition(":")
    if kind not in ("tcp", "tls", "ucx", "ws", "wss") or not rest.startswith("//"):
        raise SceneError(
            f"{option('cluster')} is {cluster!r}; must be local:N or a scheduler's address, such as"
            " tcp://HOST:8786"
        )
    if kind == "tcp" and not _is_here(cluster):
        log.warning(
            "%s: what is sent can be read and changed on the way; a scheduler with TLS has an"
            " address tls://HOST:PORT (docs/cluster.md)",
            cluster,
        )
    try:
        return distributed.Client(cluster, timeout=_ANSWER)
    except (OSError, TimeoutError) as error:
        raise ResourceError(f"{cluster}: no scheduler answers: {error}") from error
    except ValueError as error:
        raise SceneError(f"{option('cluster')} is {cluster!r}: {error}") from error


def _is_here(address: str) -> bool:
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
