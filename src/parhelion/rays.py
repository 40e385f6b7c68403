"""Rays of one's own against a scene: what they meet, and whether anything is in the way."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from . import arguments, machine, memory
from .errors import SceneError, unknown_name
from .renderer import TREES, Prepared, prepare
from .scene import Scene

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Bytes of what is told of a ray, and of the point that it meets
_HIT_BYTES, _POINT_BYTES = 72, 44
# Shape of what belongs to one ray
_ROW: dict[str, tuple[int, ...]] = {"origins": (3,), "directions": (3,), "limits": ()}


@dataclass(frozen=True, eq=False)
class Hits:
    """What n rays have met first; intersect() makes it.

    distance: (n,) float64, from where the ray set off, in the scene's units; infinite where nothing
    is met, and there the numbers are -1. shape: (n,) int32, its number, by which shape_names has
    its name. primitive: (n,) int64, its number in the shape, as in the arrays. instances: (n,)
    int32, of what is seen in a copy, the number of the shape of instances, else -1; copy: (n,)
    int64, which of them. scene: what was asked, whose hits these remain: they cannot be pickled.

    hits[index], by a mask, numbers or a slice, are those of some rays. Points are worked out when
    they are first asked for, as by rays that set off from there, by the threads and instruction set
    that found the hits, and take 44 bytes a ray then: ResourceError where memory does not suffice.
    """

    scene: Prepared
    distance: NDArray[np.float64]
    shape: NDArray[np.int32]
    primitive: NDArray[np.int64]
    instances: NDArray[np.int32]
    copy: NDArray[np.int64]
    _rays: NDArray[np.uint32]
    _threads: int
    _isa: str

    def __repr__(self) -> str:
        return f"<Hits: {np.count_nonzero(self.hit)} of {len(self)} rays>"

    __iter__ = None  # though there is __getitem__

    def __len__(self) -> int:
        return len(self.distance)

    def __getitem__(self, index: Any) -> Hits:
        try:
            of = np.arange(len(self))[index]
        except (IndexError, TypeError) as error:
            raise SceneError(f"no such hits of {len(self)}: {error}") from None
        if of.ndim != 1:
            raise SceneError("hits are selected by a mask, a list of numbers or a slice")
        own = {f.name: getattr(self, f.name) for f in fields(self)}
        some = replace(self, **{k: a[of] for k, a in own.items() if isinstance(a, np.ndarray)})
        # of what is repeated they are worked out once
        if "_points" in self.__dict__ or len(of) > len(self):
            some.__dict__["_points"] = self._points[of]
        return some

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(n,), whether something was met."""
        return self.shape >= 0

    @property
    def position(self) -> NDArray[np.float64]:
        """(n, 3), of the points, in the scene's units; NaN where nothing is met."""
        scale: float = self.scene.core.stats()["scale"]
        return self._vectors("point").astype(np.float64) / scale

    @property
    def normal(self) -> NDArray[np.float32]:
        """(n, 3), of the surfaces themselves, outward, unit; NaN where nothing is met."""
        return self._vectors("normal")

    @cached_property
    def _points(self) -> NDArray[np.uint32]:
        """As the core keeps them."""
        return _points(self)

    def _vectors(self, name: str) -> NDArray[np.float32]:
        """Of the points; a copy, since rays set off by these."""
        from . import _core

        first = _core.met_columns[name]
        vectors: NDArray[np.float32] = self._points[:, first : first + 3].view(np.float32).copy()
        return vectors

    @property
    def shape_names(self) -> list[str]:
        """Of the scene's shapes, by `shape` and `instances`."""
        return self.scene.flat.shape_names


@memory.told
def intersect(
    scene: Scene | Prepared | Any,
    origins: ArrayLike | Hits,
    directions: ArrayLike,
    limits: ArrayLike = math.inf,
    *,
    threads: int = 0,
    tree: str = "bvh",
    isa: str = "",
) -> Hits:
    """The nearest surface that each of n rays meets, whatever its material, holes included.

    scene: one that prepare() has made, or anything that it makes one of. origins: (n, 3), where
    rays set off, or (3,) for all, in the scene's units; or Hits of the same scene, from whose
    surfaces they set off, each on the side that it goes to, without meeting the same point again.
    directions: (n, 3) or (3,), of any length but 0. limits: (n,) or one, how far is looked.
    threads: 0 takes every core; tree ("none" tests every primitive) and isa, the instruction set,
    are as of render(). The answer depends on none of the three.

    Arithmetic is float32 from where a ray enters the scene's bounds, and double before; nothing
    gets through between triangles that share an edge.

    Raises SceneError for a scene without a meaning and rays that are none, naming the first, and
    ResourceError where memory does not suffice; hits take 72 bytes a ray.
    """
    from . import _core

    prepared, asked = _asked(scene, origins, directions, limits, tree, isa)
    own = arguments.own_threads(threads)
    with _means(asked[1], own, _HIT_BYTES, "what {} rays meet"):
        return Hits(prepared, *_core.intersect_rays(*asked), own, isa)


@memory.told
def _points(hits: Hits) -> NDArray[np.uint32]:
    """What rays set off from, and Hits.position and Hits.normal tell."""
    from . import _core

    with _means(len(hits), hits._threads, _POINT_BYTES, "the points of {} hits"):
        return _core.points_met(hits.scene.core, hits._rays, hits._isa)


@memory.told
def occluded(
    scene: Scene | Prepared | Any,
    origins: ArrayLike | Hits,
    directions: ArrayLike,
    limits: ArrayLike = math.inf,
    *,
    threads: int = 0,
    tree: str = "bvh",
    isa: str = "",
) -> NDArray[np.bool_]:
    """Whether anything is in the way of each of n rays, (n,): faster than which is the nearest.

    Arguments and errors are those of intersect().
    """
    from . import _core

    _, asked = _asked(scene, origins, directions, limits, tree, isa)
    with _means(asked[1], arguments.own_threads(threads), 1, "an answer for {} rays"):
        return _core.occluded_rays(*asked).view(np.bool_)


def _means(n: int, threads: int, each: int, what: str) -> AbstractContextManager[None]:
    """For what the block asks of n rays: so many threads, and bytes for each ray.

    Few rays are one thread's, and take as little memory as any program does now and then: to see
    to both would take several times as long. Raises ResourceError where memory does not suffice.
    """
    from . import _core

    if n <= _core.few_rays:
        return nullcontext()
    memory.require(n * each, what.format(n), "ask for fewer at a time")
    return machine.threads(threads)


def _asked(
    scene: Any, origins: Any, directions: Any, limits: Any, tree: str, isa: str
) -> tuple[Prepared, tuple[Any, ...]]:
    """The scene, and the core's other arguments."""
    if tree not in TREES:
        raise SceneError(unknown_name("tree", tree, TREES))
    given = {"directions": directions, "limits": limits}
    counts = {}
    met = None
    if isinstance(origins, Hits):
        if not isinstance(scene, Prepared) or origins.scene.core is not scene.core:
            raise SceneError("origins are hits of another scene; prepare() it once, and ask that")
        met = origins._points
        counts["origins"] = len(met)
    else:
        given["origins"] = origins
    arrays = {name: _numbers(name, value) for name, value in given.items()}
    counts |= {name: len(a) for name, a in arrays.items() if a.ndim > len(_ROW[name])}
    if len(set(counts.values())) > 1:
        said = ", ".join(f"{counts[name]} {name}" for name in _ROW if name in counts)
        raise SceneError(f"as many of each are needed, or one for all; these are {said}")
    n = max(counts.values(), default=1)
    prepared = scene if isinstance(scene, Prepared) else prepare(scene)
    rays = n, arrays.get("origins", met), arrays["directions"], arrays["limits"]
    return prepared, (prepared.core, *rays, tree == "bvh", arguments.text("isa", isa))


def _numbers(name: str, value: Any) -> NDArray[Any]:
    """One row, or an array of rows, in float32 or double."""
    if isinstance(value, Hits):
        raise SceneError(f"{name} are hits; only origins can be")
    array: NDArray[Any] = arguments.floats(name, value)
    row = _ROW[name]
    if array.shape not in (row, array.shape[:1] + row):
        wanted = "(n, 3) or (3,)" if row else "(n,) or one number"
        raise SceneError(f"{name} has shape {array.shape}; must be {wanted}")
    return array if array.flags.aligned else array.copy()
