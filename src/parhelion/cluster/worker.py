"""What runs on a worker: units of a picture, whose scene and tree are kept for the next one."""

from __future__ import annotations

import atexit
import functools
import hashlib
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .. import machine, memory
from ..errors import ParhelionError, ResourceError
from .scenes import unpacked

log = logging.getLogger("parhelion")

# Of the memory that is free, the share that scenes of other pictures may hold, but for those that
# were used within so many seconds. All are let go of for a scene that would find no room otherwise.
_SHARE, _RECENT = 0.25, 60.0
# Pictures that are known; they are a kilobyte each, and a view.
_PICTURES = 64


class WrongBuild(ParhelionError):
    """A worker with another build of Parhelion, whose samples might differ."""


class Absent(Exception):
    """What a worker answers that has no scene. Dask brings errors with the word that a task has
    ended, and results later, when their worker may be gone. Its log passes over this one.
    """


def _unlogged(record: logging.LogRecord) -> bool:
    """Whether a record of Dask's may stand in the worker's log: not what is no failure."""
    return "Absent()" not in record.getMessage()


logging.getLogger("distributed.worker").addFilter(_unlogged)


@dataclass(frozen=True, eq=False)
class Picture:
    """What all units of a picture have in common. name: no other picture has it. scene: its hash;
    source: where it came from, as a dict, or None. threads: 0 for all cores.
    """

    name: str
    version: str
    build: str
    scene: str
    source: dict[str, Any] | None
    camera: dict[str, Any]
    settings: dict[str, Any]
    tree: bool
    features: bool
    threads: int
    isa: str


@dataclass(frozen=True, eq=False)
class Unit:
    """A rectangle of the whole picture's pixels, and how many samples each has and shall have, (H,
    W) uint32, or one number for all. picture: its name. samples: that are to come, of all pixels.
    errors: whether means for errors are to be kept. features: what the film has seen so far, as
    bytes.
    """

    number: int
    picture: str
    x: int
    y: int
    width: int
    height: int
    begun: Any
    targets: Any
    samples: int
    errors: bool
    features: bytes


@dataclass(frozen=True, eq=False)
class Seen:
    """What came of a unit: the film's memory; samples, rays; seconds that rendering took. worker:
    its address.
    """

    worker: str
    threads: int
    isa: str
    memory: tuple[bytes, bytes, bytes]
    samples: int
    rays: int
    seconds: float


@dataclass(frozen=True)
class Lacking:
    """What a worker without the scene answers to a unit."""

    worker: str


@dataclass(frozen=True)
class Failed:
    """What a worker answers to a unit that it cannot do."""

    worker: str
    why: str


# One unit at a time takes all cores, however many tasks the worker may run at once.
_busy = threading.Lock()
_scenes: OrderedDict[str, Any] = OrderedDict()
_used: dict[str, float] = {}  # when each was, as of time.monotonic()
# Each with its view of the scene, once there is one
_pictures: OrderedDict[str, tuple[Picture, Any]] = OrderedDict()
# Else the core tells people of what is left when the process ends.
atexit.register(_pictures.clear)
atexit.register(_scenes.clear)


@functools.cache
def build() -> str:
    """What made this program: a hash of its sources, those of the core and those in Python."""
    from .. import _core

    digest = hashlib.sha256(_core.sources.encode())
    root = Path(__file__).resolve().parent.parent
    for file in sorted(root.rglob("*.py")):
        digest.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()


def greet(picture: Picture) -> None:
    """Hears of a picture. Raises WrongBuild, and Absent where its scene is not there."""
    from .. import __version__

    if picture.build != build():
        what = f"version {__version__}" if __version__ != picture.version else "another build"
        raise WrongBuild(
            f"has {what} of Parhelion, and this is {picture.version}; samples might differ"
        )
    with _busy:
        _pictures[picture.name] = picture, None
        while len(_pictures) > _PICTURES:
            _pictures.popitem(last=False)
        if picture.scene not in _scenes:
            raise Absent


def read(picture: Picture) -> None:
    """Reads the scene from where it came from, and builds its tree. Raises Absent where it is not
    there, or another one is, as its hash tells.
    """
    from ..flatten import flatten
    from ..io.sources import scene_at
    from ..scene import Source

    assert picture.source is not None
    try:
        flat = flatten(scene_at(Source(**picture.source)))
    except Exception as error:  # whatever the file is here
        log.info("%s", error)
        raise Absent from None
    if flat.sha256() != picture.scene:
        raise Absent
    _keep(picture.scene, flat)


def keep(scene: str, skeleton: bytes, bundles: Sequence[Any]) -> None:
    """Takes a scene, by its hash, and builds its tree. Raises ResourceError."""
    from ..flatten import Flat

    flat = Flat(unpacked(skeleton, bundles), [], [], [])
    if flat.sha256() != scene:
        raise ResourceError("the scene did not arrive as it was sent")
    _keep(scene, flat)


def _keep(scene: str, flat: Any) -> None:
    with _busy:
        if scene not in _scenes:
            asked = (p.threads for p, _ in _pictures.values() if p.scene == scene)
            _scenes[scene] = _built(flat, next(asked, 0))
        _used[scene] = time.monotonic()


def _built(flat: Any, threads: int) -> Any:
    """The core's scene, with room made for it. threads: 0 for all cores."""
    from distributed import get_worker

    limit = get_worker().memory_manager.memory_limit or None
    with memory.limited(limit), machine.threads(threads):
        return _built_within(flat)


def _built_within(flat: Any) -> Any:
    from .. import renderer

    held = sum(core.stats()["bytes"] for core in _scenes.values())
    room = memory.available()
    while _scenes and room is not None and held > _SHARE * (room + held):
        if time.monotonic() < _used[next(iter(_scenes))] + _RECENT:
            break
        held -= _let_go()
    while True:
        try:
            return renderer.build(flat)
        except ResourceError:
            if not _scenes:
                raise
            _let_go()


def _let_go() -> int:
    """Of the scene that was not used for longest; the bytes that it held."""
    scene, core = _scenes.popitem(last=False)
    for name, (picture, _) in _pictures.items():
        if picture.scene == scene:
            _pictures[name] = picture, None
    return int(core.stats()["bytes"])


def film_of(unit: Unit, features: bool, stored: Sequence[bytes] = ()) -> Any:
    """The film of a unit, before it is rendered or, with the film's memory, as it was seen."""
    from .. import _core

    film = _core.Film(unit.x, unit.y, unit.width, unit.height, features, unit.errors)
    for values, part in zip(film.memory(), stored, strict=False):
        if values.nbytes != len(part):
            raise ValueError("a unit's memory is not as long as that of its film")
        values[:] = np.frombuffer(part, np.uint8)
    return film


def counts_of(unit: Unit, counts: Any) -> Any:
    """Unit.begun or Unit.targets as an array."""
    whole = np.broadcast_to(np.asarray(counts, np.uint32), (unit.height, unit.width))
    return np.ascontiguousarray(whole)


def render_unit(unit: Unit) -> Seen | Lacking | Failed:
    """Renders a unit."""
    from distributed import get_worker

    address = get_worker().address
    try:
        with _busy:
            prepared = _prepared(unit.picture)
            if prepared is None:
                return Lacking(address)
            with machine.threads(prepared[0].threads):
                return _rendered(unit, address, *prepared)
    except Exception as error:  # whatever may happen on a machine
        return Failed(address, f"{type(error).__name__}: {error}")


def _rendered(unit: Unit, address: str, picture: Picture, core: Any, view: Any) -> Seen:
    from .. import _core

    film = film_of(unit, picture.features)
    film.begin(counts_of(unit, unit.begun))
    if picture.features:
        film.memory()[1][:] = np.frombuffer(unit.features, np.uint8)
    threads = picture.threads or machine.cores_available()
    isa = picture.isa or _core.instruction_set()
    start = time.perf_counter()
    samples, rays, _ = film.render(
        core,
        view,
        counts_of(unit, unit.targets),
        threads=threads,
        tile=8,
        schedule="dynamic",
        isa=isa,
        tick=None,
    )
    seconds = time.perf_counter() - start
    pixels, features, prefixes = (values.tobytes() for values in film.memory())
    return Seen(address, threads, isa, (pixels, features, prefixes), samples, rays, seconds)


def _prepared(name: str) -> tuple[Picture, Any, Any] | None:
    """A picture, the core's scene of it, and the view; None where it is not known here."""
    from ..renderer import make_view
    from ..scene import Camera, Settings

    picture, view = _pictures.get(name, (None, None))
    if picture is None or picture.scene not in _scenes:
        return None
    core = _scenes[picture.scene]
    _scenes.move_to_end(picture.scene)
    _pictures.move_to_end(name)
    _used[picture.scene] = time.monotonic()
    if view is None:
        camera, settings = Camera(**picture.camera), Settings(**picture.settings)
        view = make_view(core, camera, settings, picture.tree)
        _pictures[name] = picture, view
    return picture, core, view
