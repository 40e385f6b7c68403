"""Files that a scene was made of, and reading it again when they change."""

from __future__ import annotations

import contextvars
import logging
import os
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

from ..errors import ParhelionError
from ..scene import Instances, Light, Material, Scene, Texture
from .session import Session

log = logging.getLogger("parhelion")

# Seconds between two looks at the files.
POLL = 0.4
# A file that is still being written is read when it has been still for one look, or after so many
# seconds: one that a simulation writes without end shows where it is.
PATIENCE = 4.0

# What Python opens while a scene is read; None while nobody asks.
_opened: contextvars.ContextVar[set[Path] | None] = contextvars.ContextVar("opened", default=None)
_hooked = False

# (time of change, bytes), or None of a file that is not there
_Sign = tuple[int, int] | None


def recorded(load: Callable[[], Scene]) -> tuple[Scene, set[Path]]:
    """A scene, and the files that it was made of as far as they can be known: those that Python
    opened meanwhile, and the pictures that it names.
    """
    global _hooked
    if not _hooked:
        sys.addaudithook(_on_event)
        _hooked = True
    found: set[Path] = set()
    token = _opened.set(found)
    try:
        scene = load()
    finally:
        _opened.reset(token)
    own = Path(sysconfig.get_paths()["stdlib"]), Path(sysconfig.get_paths()["purelib"]), _PACKAGE
    files = {file for file in found if not any(file.is_relative_to(folder) for folder in own)}
    return scene, files | set(_pictures(scene))


_PACKAGE = Path(__file__).resolve().parent.parent


def _on_event(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open":
        return
    found = _opened.get()
    if found is None:
        return
    path, mode = arguments[:2]
    if isinstance(path, (str, os.PathLike)) and (mode is None or not set("wax+") & set(mode)):
        file = Path(path).absolute()
        if not file.is_relative_to("/proc") and file.is_file():
            found.add(file)


def _pictures(scene: Scene) -> Iterator[Path]:
    """The picture files that materials and lights name."""
    entries: list[Any] = [*scene.materials.values(), *scene.lights]
    if scene.background is not None:
        entries.append(scene.background)
    shapes = list(scene.shapes)
    while shapes:
        shape = shapes.pop()
        if isinstance(shape, Instances):
            shapes.extend(shape.shapes)
        elif isinstance(shape.material, Material):
            entries.append(shape.material)
    seen: set[int] = set()
    while entries:
        entry = entries.pop()
        if id(entry) in seen:
            continue
        seen.add(id(entry))
        params: Mapping[str, Any] = entry.params
        for name, value in params.items():
            if isinstance(value, (Texture, Material, Light)):
                entries.append(value)
            elif name == "image" and isinstance(value, (str, os.PathLike)):
                yield Path(value).absolute()


def _sign(file: Path) -> _Sign:
    try:
        status = file.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


class Watch:
    """Gives a session its scene anew whenever one of the files changes, until it is closed.

    load: reads the scene. What it raises is reported to the session, whose old picture stays.
    """

    def __init__(self, session: Session, load: Callable[[], Scene], files: set[Path]) -> None:
        self._session, self._load, self._files = session, load, files
        self._signs = {file: _sign(file) for file in files}
        self._end = threading.Event()
        context = contextvars.copy_context()  # in which options are called as the user knows them
        self._thread = threading.Thread(
            target=context.run, args=(self._run,), name="parhelion-watch", daemon=True
        )
        self._thread.start()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Looks no more. A scene that is being read is not waited for."""
        self._end.set()
        self._thread.join(0.1)

    @property
    def ended(self) -> bool:
        """Whether nothing is read any more."""
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._end.wait(POLL):
            if self._changed():
                self._settle()
                if not self._end.is_set():
                    self._read()

    def _changed(self) -> bool:
        signs = {file: _sign(file) for file in self._files}
        changed, self._signs = signs != self._signs, signs
        return changed

    def _settle(self) -> None:
        late = time.monotonic() + PATIENCE
        while time.monotonic() < late and not self._end.wait(0.5 * POLL) and self._changed():
            pass

    def _read(self) -> None:
        try:
            scene, files = recorded(self._load)
            self._session.replace(scene).result()
        except (ParhelionError, MemoryError) as error:
            text = str(error) or "not enough memory"
            log.warning("view: %s", text)
            self._session.report(text)
        except CancelledError:  # the session is closed
            self._end.set()
        except Exception as error:  # an error of a reader's: told, and the next change is read
            log.exception("view: reading again")
            self._session.report(f"{type(error).__name__}: {error}")
        else:
            self._session.report(None)
            if files != self._files:
                self._files = files | {f for f in self._files if _sign(f) is not None}
                self._changed()
