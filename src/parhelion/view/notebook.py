"""A session in a notebook's cell: the page of `parhelion view` as a widget (anywidget)."""

from __future__ import annotations

import atexit
import json
import logging
import threading
import weakref
from collections.abc import Callable
from typing import Any

import msgspec

from .. import arguments
from ..errors import ResourceError
from ..scene import Scene
from .messages import Client, Packer
from .server import PAGE
from .session import LARGEST_SIDE, Session

try:
    import anywidget
    import traitlets
except ImportError:
    raise ResourceError(
        "views in notebooks need the package anywidget: pip install anywidget"
    ) from None

log = logging.getLogger("parhelion")

# Those that are open: Python must not end while their threads are within a library.
_open: weakref.WeakSet[Viewer] = weakref.WeakSet()


@atexit.register
def _end_all() -> None:
    for viewer in list(_open):
        viewer.end()


def view(scene: Scene, height: int, **settings: Any) -> Viewer:
    """See Scene.view()."""
    # before there is a session that nobody would end
    arguments.whole("height", height, 1, LARGEST_SIDE)
    return Viewer(Session(scene, **settings), height=height)


class Viewer(anywidget.AnyWidget):
    """Shows a session. It rests while no cell shows it; close() ends it, as does a front end that
    closes the widget, and the end of Python.

    session: whose camera, parameters and picture are there to be read and changed from Python too.
    height: of the cell, in pixels of the page.
    """

    # as text: the files themselves anywidget would watch, and hold every widget that shows them
    _esm = (PAGE / "view.js").read_text()
    _css = (PAGE / "view.css").read_text()
    height = traitlets.Int(560).tag(sync=True)

    def __init__(self, session: Session, *, height: int = 560) -> None:
        super().__init__(height=height)
        self.session = session
        session.rest(True)
        self._due = threading.Event()
        self._over = False
        self._cells = 0
        self._packer = Packer(session)
        self._client: Client | None = None
        self.on_msg(self._hear)
        if self.comm is not None:
            self.comm.on_close(lambda _message: self.close())
        self._threads: list[threading.Thread] = []
        self._start(self._tell)
        _open.add(self)

    def close(self) -> None:
        """Ends the session, and takes the widget out of its cells."""
        self.end()
        super().close()

    def end(self) -> None:
        """Ends the session and all threads."""
        self._over = True
        self._due.set()
        if self._client is not None:
            self._client.close()
        self.session.close()
        for thread in self._threads:
            thread.join()

    def _start(self, work: Callable[[], None]) -> None:
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        self._threads.append(threading.Thread(target=work, name="parhelion-notebook", daemon=True))
        self._threads[-1].start()

    def _hear(self, _widget: Any, message: Any, _buffers: Any) -> None:
        kind = message.get("type") if isinstance(message, dict) else None
        if kind == "hello":
            # a cell more: told everything again, as each message goes to all cells
            if self._client is not None:
                self._client.close()
            self._client = Client(self.session, self._packer, self._due.set)
            self._cells += 1
            self.session.rest(False)
            self._due.set()
        elif kind == "goodbye":
            self._cells = max(0, self._cells - 1)
            self.session.rest(self._cells == 0)
        elif self._client is not None and not self._over:
            later = self._client.receive(json.dumps(message))
            if later is not None:
                self._start(later)

    def _tell(self) -> None:
        while True:
            self._due.wait()
            self._due.clear()
            while not self._over and self._client is not None:
                message = self._client.take()
                if message is None:
                    break
                header, data = message
                try:
                    self.send(msgspec.to_builtins(header), [data] if data else [])
                except Exception as error:  # of whatever carries it: the kernel is going down
                    log.debug("view: a cell was not told: %r", error)
            if self._over:
                return
