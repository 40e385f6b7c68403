"""Which workers there are, and how each gets the scene of a picture.

A worker that has a scene keeps it, so units of work need none of Dask's own data, which is lost
with the worker that holds it. While some lack the scene, its arrays lie on one of them, for the
others to fetch; when all have it, they are let go of. A worker on another machine first looks
whether the scene's file is there too.
"""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from importlib import import_module
from threading import Thread
from typing import Any

from ..errors import ResourceError, SceneError
from . import worker as worker_module
from .places import is_here, reaches, workers_of
from .scenes import packed
from .worker import Absent, Picture, WrongBuild, greet, keep, read

log = logging.getLogger("parhelion")

# Seconds between two looks at which workers there are
LOOK = 1.0
# Seconds of waiting for the first worker before that is told, and that first answers may take
_ALONE = 10.0
# Bytes of a scene from which on workers on other machines try to read its file themselves
_READ = 1 << 24
# Seconds between two looks at whether it has come
_PAUSE = 0.005
# Workers that may end with the scene, one after the other, before it is taken to be the cause
_DEATHS = 5


@dataclass(eq=False)
class _Worker:
    """state: "unknown", "lacking" while it has no scene, "ready" or "refused". asked: the answer to
    come: of one that is unknown, whether it has this module, and then to the greeting; to the scene
    of one that lacks it. has: the module; whatever needs it ends the connection of a worker that
    does not, and with it the worker. reads: whether the scene comes by reading its file, which is
    tried once. failed: how often the scene could not be put there.
    """

    state: str = "unknown"
    asked: Any = None
    has: bool = False
    reads: bool = False
    failed: int = 0


class Roster:
    """The workers of a cluster, for one picture. there: their addresses; ready: of those that have
    the scene; coming: of those that may get it.

    Raises SceneError for workers whose samples might not be ours, and ResourceError where there are
    none, or none that can take the scene.
    """

    def __init__(self, client: Any, picture: Picture, parts: Mapping[str, Any]) -> None:
        self._client, self._picture = client, picture
        self._workers: dict[str, _Worker] = {}
        self._sent: list[Any] = []
        self._numbers = itertools.count()
        self._looked = -LOOK
        self._sending: Future[list[Any]] | None = None
        self._sent_to = ""  # whose it is to be first
        self._send_from = 0.0  # when the scene may be sent again
        self._begun = False
        self._packed = packed(parts)
        # of a small scene the arrays are there sooner
        size = sum(a.nbytes for bundle in self._packed[1] for _, a in bundle)
        self._may_read = picture.source is not None and size >= _READ
        self._died = 0  # with the scene, one after the other
        self.there: frozenset[str] = frozenset()
        self.ready: frozenset[str] = frozenset()
        self.coming: frozenset[str] = frozenset()

    def begin(self, stopped: Callable[[], bool]) -> bool:
        """Waits for workers, and for what the first say of themselves; False if it is stopped
        before, as the function tells, which is asked now and then.
        """
        asked = time.monotonic()
        told, since = False, 0.0  # when the first came
        while not self._begun:
            if stopped():
                return False
            self.look()
            now = time.monotonic()
            if self.there:
                since = since or now
                unknown = any(w.state == "unknown" for w in self._workers.values())
                self._begun = not unknown or now > since + _ALONE
            elif not told and now > asked + _ALONE:
                told = True
                log.warning("the cluster has no workers; waiting for some")
            time.sleep(_PAUSE)
        return True

    def look(self) -> None:
        """Sees, once in LOOK seconds, who came and who went; those that lack the scene get it."""
        now = time.monotonic()
        under_way = self._sending is not None or any(w.asked for w in self._workers.values())
        if now < self._looked + LOOK and not under_way:
            return
        if now >= self._looked + LOOK:
            self._looked = now
            self._call()
        for address, worker in self._workers.items():
            if worker.asked is not None and worker.asked.done():
                self._hear(address, worker)
        lacking = []
        for address, worker in self._workers.items():
            if worker.asked is None and worker.state == "unknown" and not worker.has:
                worker.asked = self._ask(address, import_module, worker_module.__name__)
            elif worker.asked is None and worker.state == "unknown":
                worker.asked = self._ask(address, greet, self._picture)
            elif worker.asked is None and worker.state == "lacking":
                if self._may_read and not worker.reads and not is_here(address):
                    worker.asked, worker.reads = self._ask(address, read, self._picture), True
                else:
                    lacking.append(address)
        if lacking and now >= self._send_from:
            self._send(lacking)
        elif not any(worker.state == "lacking" for worker in self._workers.values()):
            self._sent.clear()
        self.ready = frozenset(a for a, w in self._workers.items() if w.state == "ready")
        self.coming = frozenset(
            a for a, w in self._workers.items() if w.state in ("unknown", "lacking")
        )

    def lacks(self, address: str) -> None:
        """One that was ready has let go of the scene."""
        if address in self._workers and self._workers[address].asked is None:
            self._workers[address].state = "unknown"
            self.ready -= {address}
            self._looked = -LOOK

    def close(self) -> None:
        """Lets go of what lies on the workers."""
        self._workers.clear()
        self._sent.clear()
        self._sending = None

    def _refuse(self, address: str, error: BaseException) -> None:
        """Raises what a worker's answer means for the picture."""
        if isinstance(error, WrongBuild):
            raise SceneError(f"the worker {address} {error}") from error
        if isinstance(error, ImportError):
            raise SceneError(f"the worker {address} has no Parhelion: {error}") from error
        raise ResourceError(f"the worker {address} does not work: {error}") from error

    def _call(self) -> None:
        told = workers_of(self._client)
        # one that Dask has paused, for want of memory, does nothing
        there = frozenset(a for a, w in told.items() if w.get("status", "running") == "running")
        for address in self.there - there:
            worker = self._workers.pop(address)
            self._died += worker.state == "lacking"
        for address in there - self.there:
            self._workers[address] = _Worker()
        if not there and self.there:
            still = sum(w.get("status") == "paused" for w in told.values())
            paused = f" but {still} that Dask has paused for want of memory" if still else ""
            log.warning("the cluster has no workers any more%s; waiting for some", paused)
        self.there = there
        if there and all(w.state == "refused" for w in self._workers.values()):
            raise ResourceError("none of the cluster's workers can take the scene")
        if self._died > max(_DEATHS, len(there)):
            raise ResourceError(
                f"{self._died} workers ended when they got the scene; it may need more memory than"
                " they have"
            )

    def _hear(self, address: str, worker: _Worker) -> None:
        """Takes an answer."""
        future, worker.asked = worker.asked, None
        error = future.exception() if future.status == "error" else None
        if future.status == "finished" and not worker.has:
            worker.has = True
        elif future.status == "finished" or isinstance(error, Absent):
            worker.state = "lacking" if error else "ready"
            self._died = 0
        elif error is not None:
            worker.state = "refused"
            alone = all(w.state == "refused" for w in self._workers.values())
            if alone or (not self._begun and isinstance(error, (WrongBuild, ImportError))):
                self._refuse(address, error)
            log.warning("the worker %s is left out: %s", address, error)
        else:  # what it was to fetch was lost with the worker that had it
            worker.state = "unknown"
            self._sent.clear()

    def _send(self, lacking: list[str]) -> None:
        """Has workers fetch the scene and build its tree."""
        if not self._sent:
            if self._sending is None:
                self._sending = Future()
                self._sent_to = min(lacking, key=lambda address: self._workers[address].failed)
                Thread(
                    target=self._scatter, args=(self._sending, self._sent_to), daemon=True
                ).start()
            if not self._sending.done():
                return
            sending, self._sending = self._sending, None
            error = sending.exception()
            if error is not None:  # the worker is gone, as the next look tells, or has no room
                self._died += 1
                if self._client.status != "running" or self._died > _DEATHS:
                    raise error
                log.debug("%s: %s", self._sent_to, error)
                self._send_from = time.monotonic() + LOOK
                if self._sent_to in self._workers:
                    self._workers[self._sent_to].failed += 1
                return
            self._sent = sending.result()
        for address in lacking:
            self._workers[address].asked = self._ask(
                address, keep, self._picture.scene, self._sent[0], self._sent[1:]
            )

    def _scatter(self, sending: Future[list[Any]], address: str) -> None:
        """Puts the scene's arrays on a worker, in a thread of its own: it may take minutes."""
        skeleton, bundles = self._packed
        name = f"{self._picture.name}-scene-{next(self._numbers)}"
        named = {f"{name}-{i}": part for i, part in enumerate([skeleton, *bundles])}
        try:
            straight = reaches(address) or None  # not through the scheduler's memory
            sent = self._client.scatter(named, workers=[address], hash=False, direct=straight)
            sending.set_result(list(sent.values()))
        except BaseException as error:
            sending.set_exception(error)

    def _ask(self, address: str, function: Any, *arguments: Any) -> Any:
        key = f"{self._picture.name}-{function.__name__}-{next(self._numbers)}"
        return self._client.submit(function, *arguments, workers=[address], key=key, pure=False)
