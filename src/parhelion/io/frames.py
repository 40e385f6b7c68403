"""The frames of a file as scenes that make a film: of one view, light and set of colours."""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from math import ceil, floor, isfinite
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, SceneError, option
from ..framing import hull, placed, subject
from ..particles import Labels, Particles, neighbour_distance, swatches, to_scene
from ..scene import (
    Camera,
    ColorBar,
    Framing,
    Scene,
    Settings,
    Source,
    Spheres,
    Swatches,
    Vec3,
)
from ..studio import axis, dressed, framing, is_dark, up_of
from . import (
    FORMATS,
    LoadOptions,
    Timeline,
    options_of,
    reading,
    require_memory,
    resolved,
    source_of,
)
from .text import Trajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Pictures a second, unless the file or the user says otherwise, and those that a film can have
FPS = 30.0
_LEAST_FPS, _MOST_FPS = 0.01, 1000.0
# Pictures of a sequence of times; more are a slip of the pen.
_MOST = 1_000_000
# Times that are nearer to an end than this, in steps, are it: 0.1 is no binary number.
_NEAR = 1e-6
# Directions in which it is kept how far the frames reach; those between are off by 0.4 % at most.
_DIRECTIONS = 512
# Spheres whose distances along all directions are computed at a time; those that are sorted into
# cells, so many along each axis; and of these, neighbours that are left out together if none of
# them can be the farthest.
_BLOCK, _SORTED, _CELLS, _CLUSTER = 1 << 15, 1 << 18, 32, 16


def load_frames(
    path: str | os.PathLike[str],
    frames: str | slice = ":",
    options: LoadOptions | None = None,
    *,
    fps: float | None = None,
    **more: Any,
) -> Frames:
    """The frames of a trajectory, or of an animated scene, as scenes.

    frames: which, as a slice of Python's, or written as one: "10:", ":100:5", "::-1", or "all"; or
    as "1..240" or "1..240..2", with both ends. Of a trajectory frames are counted from 0. Of USD
    the numbers are time codes and of glTF seconds, which need not be whole nor positive; what is
    left out are the file's first and last time, both included, and steps of one time code, or of
    1 / fps seconds. options, more: as of load(), but for `frame` and `time`. fps: pictures a
    second; None for the file's speed, and 30 where it has none.

    The file is read once here, for what all frames have in common, and again when the scenes are
    asked for; one frame at a time is in memory.

    Raises FormatError for a file that is missing, broken or has no such frames.
    """
    file, module, chosen = resolved(path, options_of(options, more) if more else options)
    if not hasattr(module, "trajectory") and not hasattr(module, "timeline"):
        raise FormatError(
            f"{file}: frames of {module.NAME} files are not read (choices: {', '.join(_known())})"
        )
    for name, rest in (("frame", 0), ("time", None)):
        if getattr(chosen, name) != rest:
            one, many = option(name), option("frames")
            raise SceneError(f"the option {one!r} is of one frame; give {many} or {one}")
    rate = None if fps is None else checked_fps(fps)
    if not hasattr(module, "trajectory"):
        return _Animation(file, module, chosen, frames, rate)

    @contextmanager
    def opened() -> Iterator[Trajectory]:
        with reading(file), module.trajectory(file, chosen) as trajectory:
            yield trajectory

    return ParticleFrames(opened, file.name, chosen, frames, rate, source_of(file, chosen))


def frames_in(path: str | os.PathLike[str], options: LoadOptions | None = None) -> Extent | None:
    """Which frames load_frames() can take of a file; None if it has none or does not say.

    Raises FormatError for a file that is missing or a trajectory that is broken.
    """
    file, module, chosen = resolved(path, options)
    if hasattr(module, "trajectory"):
        with reading(file), module.trajectory(file, chosen) as trajectory:
            return Extent("frames", 0, trajectory.count - 1, None)
    if not hasattr(module, "timeline"):
        return None
    try:
        with reading(file):
            timeline: Timeline = module.timeline(file, chosen)
    except FormatError:  # nothing moves
        return None
    if timeline.ends is None:
        return None
    return Extent(timeline.unit, *timeline.ends, timeline.per_second)


@dataclass(frozen=True)
class Extent:
    """The frames of a file, by their numbers. per_second: of times, how many pass; else None."""

    unit: str
    first: float
    last: float
    per_second: float | None


def checked_fps(fps: Any) -> float:
    """A rate of pictures. Raises SceneError for one that no film can have."""
    try:
        rate = float(fps)
    except (TypeError, ValueError):
        rate = 0.0
    if not _LEAST_FPS <= rate <= _MOST_FPS:
        raise SceneError(f"{option('fps')} is {fps!r}; must lie in [{_LEAST_FPS:g}, {_MOST_FPS:g}]")
    return rate


class Frames(ABC):
    """Scenes of a file's frames, made one by one when they are asked for; load_frames() makes it.

    numbers: of a trajectory's frames, from 0, or an animation's times, in the order of the scenes.
    file_numbers: those that files of pictures have: of "1..240" the same, if they are whole, so
    that other ranges of the same frames give files that fit; else from 1 on. fps: pictures a second
    at which they have the file's speed, or that which was asked for. sampled: whether it is by that
    rate, rather than by the file, that there are so many. look: a hash of what was chosen for all
    of them, which more frames may change. settings: of the first scene, which all have. range:
    first, last and step as load_frames() takes them, which a file that has become longer has too.

    All have the camera that shows every one of them whole, unless the file has its own, and the
    light, ground and, unless the options say otherwise, radii and range of colours that go with it.
    """

    numbers: Sequence[Any]
    file_numbers: Sequence[int]
    fps: float
    look: str
    range: str
    sampled = False
    settings = Settings()
    legend: ColorBar | Swatches | None = None
    _file_source: Source | None = None

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Scene]:
        """The scenes, each read when it is asked for."""
        return self.scenes(range(len(self)))

    def __getitem__(self, place: int) -> Scene:
        """One of the scenes, from 0 on; -1 is the last. Raises IndexError."""
        count, at = len(self), index(place)
        if not -count <= at < count:
            raise IndexError(f"there are {count} frames")
        (scene,) = self.scenes([at % count])
        return scene

    def _source(self, place: int) -> Source | None:
        """Of one of the scenes; None for those that are of no file."""
        return self._file_source and replace(self._file_source, frames=(self.range, place))

    @abstractmethod
    def scenes(self, places: Iterable[int]) -> Iterator[Scene]:
        """Some of the scenes, by their places among all, from 0 on; the others are not read."""


class ParticleFrames(Frames):
    """Of particles, all dressed alike. opened: what opens the trajectory. name: of its scenes.
    source: of a file.
    """

    def __init__(
        self,
        opened: Callable[[], AbstractContextManager[Trajectory]],
        name: str,
        options: LoadOptions,
        frames: str | slice,
        fps: float | None,
        source: Source | None = None,
    ) -> None:
        self._file_source = source
        choose = _chooser(frames)
        self.fps = FPS if fps is None else fps
        self._opened, self._name = opened, name
        self._radius: float | None = None
        self._names: dict[str, list[str]] = {}
        self._options = options
        reach, low, high = _Reach(), np.inf, -np.inf
        kinds: dict[str, Vec3] = {}
        first: Scene | None = None
        with opened() as trajectory:
            self.numbers = choose(trajectory.count)
            if not self.numbers:
                raise SceneError(f"of {trajectory.count} frames none is in {_written(frames)}")
            self.file_numbers = self.numbers if _inclusive(frames) else _from_one(self)
            self.range = _both_ends(self.numbers, self.numbers.step)
            for number in sorted(self.numbers):
                particles = trajectory.read(number)
                if first is None and _touching(particles, options):
                    self._radius = 0.5 * neighbour_distance(particles.positions)
                self._note_names(particles)
                scene = to_scene(self._alike(particles), options, name)
                first = first or scene
                if isinstance(scene.legend, ColorBar):
                    low, high = min(low, scene.legend.low), max(high, scene.legend.high)
                elif scene.legend is not None:
                    kinds.update(scene.legend.kinds)
                reach.add(pair for shape in scene.shapes for pair in hull(shape))
        assert first is not None
        if options.up is not None:
            first = first.replace(camera=framing(axis(options.up)))
        if options.color_by is not None and low < high:
            self._options = replace(options, color_range=(low, high))
        legend = first.legend
        if isinstance(legend, ColorBar):
            legend = replace(legend, low=low, high=high)
        elif legend is not None:
            legend = swatches(legend.label, kinds)
        self.legend = legend
        self._stage = _stage(first, reach, options, lit=True).replace(legend=legend)
        self.look = _hash(self._stage, self._options.color_range, self._radius, self._names)

    def scenes(self, places: Iterable[int]) -> Iterator[Scene]:
        with self._opened() as trajectory:
            for place in places:
                number = self.numbers[place]
                if number >= trajectory.count:
                    raise SceneError("has become shorter while it was read")
                particles = self._alike(trajectory.read(number))
                scene = to_scene(particles, self._options, f"{self._name}, frame {number}")
                shapes = (*scene.shapes, *self._stage.shapes)
                source = self._source(place)
                yield self._stage.replace(shapes=shapes, name=scene.name, source=source)

    def _note_names(self, particles: Particles) -> None:
        for key, labels in _labels(particles).items():
            known = self._names.setdefault(key, [])
            known += [name for name in labels.names if name not in known]

    def _alike(self, particles: Particles) -> Particles:
        """The particles with the first frame's radius, and with all frames' names of kinds, by
        whose order these have their colours.
        """
        if self._radius is not None:
            radii = np.full(len(particles.positions), self._radius, np.float32)
            particles = replace(particles, radii=radii)
        changes: dict[str, Any] = {}
        fields = dict(particles.fields)
        for key, labels in _labels(particles).items():
            more = [name for name in self._names[key] if name not in labels.names]
            if more:
                labels = Labels(labels.codes, (*labels.names, *more))
                if key == "types":
                    changes["types"] = labels
                else:
                    fields[key.removeprefix("field ")] = labels
        return replace(particles, fields=fields, **changes) if self._names else particles


class _Animation(Frames):
    """Of a scene that has a pose at every time."""

    def __init__(
        self,
        file: Path,
        module: Any,
        options: LoadOptions,
        frames: str | slice,
        fps: float | None,
    ) -> None:
        self._file, self._file_source = file, source_of(file, options)
        require_memory(file)
        with reading(file):
            self._timeline: Timeline = module.timeline(file, options)
        step, self.numbers = _times(file, self._timeline, frames, FPS if fps is None else fps)
        by_rate = self._timeline.per_second / (FPS if fps is None else fps)
        self.range = _both_ends(self.numbers, by_rate if step is None else step)
        whole = [round(time) for time in self.numbers]
        exact = all(abs(a - b) < _NEAR for a, b in zip(whole, self.numbers, strict=True))
        self.file_numbers = whole if exact and _inclusive(frames) else _from_one(self)
        self.sampled = step is None
        seconds = 1.0 / FPS if step is None else abs(step) / self._timeline.per_second
        self.fps = fps if fps is not None else min(max(1.0 / seconds, _LEAST_FPS), _MOST_FPS)
        bare, glow = getattr(module, "BARE", False), getattr(module, "GLOW", 0.0)
        kinds, stands = getattr(module, "GROUND", ()), False
        first = self._read(self.numbers[0])
        self.settings = first.settings
        lit = bare and options.environment is None and is_dark(first, glow)
        self._own_camera = options.view is None
        self._own_background = options.environment is None
        reach = _Reach()
        if lit or options.ground or not self._own_camera or not isinstance(first.camera, Camera):
            for time in self.numbers:
                scene = self._read(time)
                reach.add(subject(scene))
                lit = lit and is_dark(scene, glow)
                stands = stands or any(isinstance(shape, kinds) for shape in scene.shapes)
        if lit:
            self._own_background = False
        if first.camera is None and bare:
            first = first.replace(camera=framing(up_of(first)))
        stage = self._stage = _stage(first, reach, options, lit, glow, stands)
        if self._own_camera and isinstance(first.camera, Camera):
            stage = stage.replace(camera=None)
        self.look = _hash(stage.replace(background=None) if self._own_background else stage)

    def scenes(self, places: Iterable[int]) -> Iterator[Scene]:
        stage = self._stage
        for place in places:
            time = self.numbers[place]
            scene = self._read(time)
            own = self._own_camera and isinstance(scene.camera, Camera)
            yield scene.replace(
                shapes=(*scene.shapes, *stage.shapes),
                camera=scene.camera if own else stage.camera,
                background=scene.background if self._own_background else stage.background,
                settings=self.settings,
                name=f"{self._file.name}, {self._timeline.option} {time:g}",
                source=self._source(place),
            )

    def _read(self, time: float) -> Scene:
        with reading(self._file):
            return self._timeline.read(time)


def _stage(
    first: Scene,
    reach: _Reach,
    options: LoadOptions,
    lit: bool,
    glow: float = 0.0,
    stands: bool = False,
) -> Scene:
    """The first scene with a view, light and a ground for all frames, and no shapes but these.

    lit: what has no light gets some. stands: and a ground then, unless the options say otherwise.
    """
    about = reach.spheres()
    stage = dressed(
        first.replace(shapes=(about,)),
        view=options.view,
        environment=options.environment,
        ground=options.ground,
        bare=lit,
        glow=glow,
        standing=(Spheres,) if stands else (),  # what stands for them
    )
    camera = stage.camera
    if isinstance(camera, Framing):
        camera = replace(camera, shapes=(about,))
    shapes = tuple(shape for shape in stage.shapes if shape is not about)
    return stage.replace(camera=camera, shapes=shapes)


def _hash(stage: Scene, *others: Any) -> str:
    """Of a scene for all frames: its camera for pictures of its settings, light and ground."""
    settings = stage.settings
    camera = stage.camera and placed(stage, settings.width / settings.height)
    seen = camera, stage.background, stage.shapes, settings, *others
    return hashlib.sha256(repr(seen).encode()).hexdigest()


def _labels(particles: Particles) -> dict[str, Labels]:
    """Names of kinds that are no elements, whose colours are always the same."""
    found = {"types": particles.types} if particles.types is not None else {}
    for key, values in particles.fields.items():
        if isinstance(values, Labels):
            found[f"field {key}"] = values
    return found


def _touching(particles: Particles, options: LoadOptions) -> bool:
    """Whether radii are estimated from the distances of neighbours."""
    return options.radius is None and particles.radii is None and particles.elements is None


class _Reach:
    """The spheres that reach farthest in each of many directions."""

    def __init__(self) -> None:
        # on a spiral from pole to pole, evenly spread (R. Swinbank and R. J. Purser, "Fibonacci
        # grids", 2006); the axes are among them, for what is to stand on the ground
        k = np.arange(_DIRECTIONS) + 0.5
        z = 1.0 - 2.0 * k / _DIRECTIONS
        angle = k * np.pi * (3.0 - np.sqrt(5.0))
        r = np.sqrt(1.0 - z * z)
        spiral = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
        self._directions = np.concatenate([np.eye(3), -np.eye(3), spiral])
        self._most = np.full(len(self._directions), -np.inf)
        self._centers = np.zeros((len(self._directions), 3))
        self._radii = np.zeros(len(self._directions))

    def add(self, pairs: Iterable[tuple[NDArray[Any], NDArray[Any]]]) -> None:
        for centers, radii in pairs:
            around = np.broadcast_to(radii, len(centers))
            for start in range(0, len(centers), _SORTED):
                part = slice(start, start + _SORTED)
                self._add_part(centers[part], around[part])

    def _add_part(self, centers: NDArray[Any], radii: NDArray[Any]) -> None:
        order = _by_cells(centers)
        centers, radii = centers[order], radii[order]
        whole = len(centers) // _CLUSTER * _CLUSTER
        clusters = centers[:whole].reshape(-1, _CLUSTER, 3).astype(np.float64)
        sizes = radii[:whole].reshape(-1, _CLUSTER)
        low, high = clusters.min(axis=1), clusters.max(axis=1)
        size = 0.5 * np.linalg.norm(high - low, axis=1) + sizes.max(axis=1)
        out = 0.5 * (low + high) @ self._directions.T + size[:, None]
        self._add(centers[whole:], radii[whole:])
        # those that may reach farthest come first, and tell most of the others
        chosen = np.unique(np.argmax(out[:, ::16], axis=0)) if len(out) else np.empty(0, np.intp)
        for _ in range(2):
            for start in range(0, len(chosen), _BLOCK // _CLUSTER):
                own = chosen[start : start + _BLOCK // _CLUSTER]
                self._add(clusters[own].reshape(-1, 3), sizes[own].ravel())
            out[chosen] = -np.inf
            chosen = np.flatnonzero((out > self._most).any(axis=1))

    def _add(self, centers: NDArray[Any], radii: NDArray[Any]) -> None:
        if not len(centers):
            return
        out = centers.astype(np.float64) @ self._directions.T + radii[:, None]
        best = np.argmax(out, axis=0)
        most = out[best, np.arange(len(best))]
        new = most > self._most
        self._most[new] = most[new]
        self._centers[new], self._radii[new] = centers[best[new]], radii[best[new]]

    def spheres(self) -> Spheres:
        known = np.isfinite(self._most)  # of nothing, nothing
        found = np.unique(np.column_stack([self._centers, self._radii])[known], axis=0)
        return Spheres(found[:, :3], found[:, 3], name="frames")


def _by_cells(points: NDArray[Any]) -> NDArray[np.intp]:
    """An order in which points that follow each other are near each other, mostly."""
    low = points.min(axis=0)
    extent = points.max(axis=0).astype(np.float64) - low
    scale = (_CELLS - 0.5) / np.where(extent > 0.0, extent, 1.0)
    x, y, z = ((points - low) * scale).astype(np.uint16).T
    return np.argsort((x * _CELLS + y) * _CELLS + z, kind="stable")


def _known() -> list[str]:
    """Endings of formats with frames."""
    from importlib import import_module

    modules = {suffix: import_module(f".{name}", __package__) for suffix, name in FORMATS.items()}
    return [
        suffix
        for suffix, module in modules.items()
        if hasattr(module, "trajectory") or hasattr(module, "timeline")
    ]


def _inclusive(frames: str | slice) -> bool:
    """Whether a range is written with both its ends: 1..240 or 1..240..2."""
    return isinstance(frames, str) and ".." in frames


def _both_ends(numbers: Sequence[Any], step: Any) -> str:
    """A range as it may be asked for, exactly."""
    ends = f"{numbers[0]!r}..{numbers[-1]!r}"
    return ends if len(numbers) == 1 else f"{ends}..{step!r}"


def _from_one(frames: Frames) -> range:
    return range(1, len(frames) + 1)


def _parts(frames: str | slice) -> list[Any]:
    """First, last and, if it is given, step of a range, None where one is left out."""
    if isinstance(frames, slice):
        return [frames.start, frames.stop, frames.step]
    text = ":" if frames == "all" else str(frames)
    return [part.strip() or None for part in text.split(".." if _inclusive(text) else ":")]


def _chooser(frames: str | slice) -> Callable[[int], range]:
    """What makes numbers of frames of how many there are. Raises SceneError for no range."""
    whole = index if isinstance(frames, slice) else int
    try:
        numbers = [None if part is None else whole(part) for part in _parts(frames)]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in (2, 3) or numbers[2:] == [0]:
        raise SceneError(
            f"{option('frames')} {frames!r}: a range such as 1..240 or 1..240..2, a slice such as"
            " 10:, :100:5 or ::-1, or all is needed"
        )
    if not _inclusive(frames):
        return lambda count: range(count)[slice(*numbers)]
    first, last, step = (*numbers, None)[:3]
    step = 1 if step is None else step

    def chosen(count: int) -> range:
        ends = [0, count - 1] if step > 0 else [count - 1, 0]
        for k, end in enumerate((first, last)):
            if end is not None:
                ends[k] = end if end >= 0 else count + end
                if not 0 <= ends[k] < count:
                    raise SceneError(
                        f"{option('frames')} {frames}: there is no frame {end}; there are 0 to"
                        f" {count - 1}"
                    )
        return range(ends[0], ends[1] + (1 if step > 0 else -1), step)

    return chosen


def _times(
    file: Path, timeline: Timeline, frames: str | slice, fps: float
) -> tuple[float | None, list[float]]:
    """The step that is given, by the user or the file, and the times.

    Raises SceneError for what is no range, and FormatError for one without times.
    """
    begin, end, given = _range(frames, timeline.unit)
    given = timeline.step if given is None else given
    step = timeline.per_second / fps if given is None else given
    if timeline.ends is None and (begin is None or end is None):
        raise FormatError(
            f"{file}: does not say its first and last time; {option('frames')} needs both, as in"
            " 1:25"
        )
    whole = end is None or _inclusive(frames)  # the last one of the file's is among them
    if timeline.ends is not None:
        first, last = timeline.ends if step > 0.0 else timeline.ends[::-1]
        begin, end = first if begin is None else begin, last if end is None else end
    assert begin is not None
    assert end is not None
    shown = _written(frames)
    for name, number in (("first time", begin), ("last time", end), ("step of time", step)):
        if not isfinite(number):
            raise FormatError(f"{file}: its {name} is {number}")
    steps = min(max((end - begin) / step, -1.0), _MOST + 1.0)  # it may be infinite
    count = floor(steps + _NEAR) + 1 if whole else ceil(steps - _NEAR)
    if count > _MOST:
        raise FormatError(f"{file}: {shown} is more than {_MOST:,} frames, and no more can be made")
    if count < 1:
        known = "" if timeline.ends is None else "; there are {:g} to {:g}".format(*timeline.ends)
        raise FormatError(f"{file}: no {timeline.unit} are in {shown}{known}")
    return given, [begin + k * step for k in range(count)]


def _range(frames: str | slice, unit: str) -> tuple[float | None, float | None, float | None]:
    """First, last and step of a range of times. Raises SceneError for anything else."""
    numbers: list[float | None] = []
    for part in _parts(frames):
        try:
            numbers.append(None if part is None else float(part))
        except (TypeError, ValueError, OverflowError):
            numbers.append(float("nan"))
    wrong = [x for x in numbers if x is not None and not isfinite(x)]
    if wrong or len(numbers) not in (2, 3) or numbers[2:] == [0.0]:
        raise SceneError(
            f"{option('frames')} {frames!r}: a range of {unit} such as 1..240, 10:, :100:5 or"
            " 1:2:0.5 is needed, or all"
        )
    begin, end, step = (*numbers, None)[:3]
    return begin, end, step


def _written(which: str | slice) -> str:
    if not isinstance(which, slice):
        return ":" if which == "all" else which
    parts = [which.start, which.stop] + ([which.step] if which.step is not None else [])
    return ":".join("" if part is None else str(part) for part in parts)
