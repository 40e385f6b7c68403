"""What runs on a worker: units of a picture, whose scene and tree are kept for the next one."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import machine
from ..errors import ParhelionError, ResourceError
from .scenes import unpacked

# Scenes with their trees that a worker keeps: that of the picture, and of the ones before. Those
# that are not in use are let go of when memory is short.
_KEPT = 3


class WrongBuild(ParhelionError):
    """A worker with another build of Parhelion, whose samples might differ."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What all units of a picture have in common. scene: its hash. threads: 0 for all cores."""

    build: str
    scene: str
    skeleton: bytes
    camera: dict[str, Any]
    settings: dict[str, Any]
    tree: bool
    features: bool
    threads: int
    isa: str


@dataclass(frozen=True, eq=False)
class Unit:
    """A rectangle of the whole picture's pixels, and how many samples each has and shall have, (H,
    W) uint32, or one number for all. errors: whether means for errors are to be kept. features:
    what the film has seen so far, as bytes.
    """

    number: int
    x: int
    y: int
    width: int
    height: int
    begun: Any
    targets: Any
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


# One unit at a time takes all cores, however many tasks the worker may run at once.
_busy = threading.Lock()
_scenes: OrderedDict[str, Any] = OrderedDict()


def versions() -> dict[str, str]:
    """What a worker runs."""
    from .. import __version__, _core

    return {"version": __version__, "build": _core.sources}


def film_of(unit: Unit, features: bool, memory: Sequence[bytes] = ()) -> Any:
    """The film of a unit, before it is rendered or, with the film's memory, as it was seen."""
    from .. import _core

    film = _core.Film(unit.x, unit.y, unit.width, unit.height, features, unit.errors)
    for values, stored in zip(film.memory(), memory, strict=False):
        if values.nbytes != len(stored):
            raise ValueError("a unit's memory is not as long as that of its film")
        values[:] = np.frombuffer(stored, np.uint8)
    return film


def counts_of(unit: Unit, counts: Any) -> Any:
    """Unit.begun or Unit.targets as an array."""
    whole = np.broadcast_to(np.asarray(counts, np.uint32), (unit.height, unit.width))
    return np.ascontiguousarray(whole)


def render_unit(picture: Picture, unit: Unit, bundles: Sequence[Any]) -> Seen:
    """Renders a unit. Raises WrongBuild, ResourceError, and whatever may happen on a machine."""
    from distributed import get_worker

    from .. import _core

    if picture.build != _core.sources:
        raise WrongBuild("a worker has another build of Parhelion")
    with _busy:
        core, view = _prepared(picture, bundles)
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
    worker = get_worker().address
    return Seen(worker, threads, isa, (pixels, features, prefixes), samples, rays, seconds)


def _prepared(picture: Picture, bundles: Sequence[Any]) -> tuple[Any, Any]:
    """The core's scene and view of a picture."""
    from ..flatten import Flat
    from ..renderer import build, make_view
    from ..scene import Camera, Settings

    core = _scenes.get(picture.scene)
    if core is None:
        while len(_scenes) >= _KEPT:
            _scenes.popitem(last=False)
        flat = Flat(unpacked(picture.skeleton, bundles), [], [], [])
        if flat.sha256() != picture.scene:
            raise ResourceError("the scene did not arrive as it was sent")
        try:
            core = build(flat)
        except ResourceError:
            _scenes.clear()  # what is kept of other pictures may be what lacks
            core = build(flat)
        _scenes[picture.scene] = core
    _scenes.move_to_end(picture.scene)
    view = make_view(core, Camera(**picture.camera), Settings(**picture.settings), picture.tree)
    return core, view
