"""The frames of a trajectory as scenes that make a film: of one view, light and set of colours."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import FormatError, SceneError, option
from ..framing import hull
from ..particles import Labels, Particles, neighbour_distance, swatches, to_scene
from ..scene import ColorBar, Framing, Scene, Shape, Spheres, Swatches, Vec3
from ..studio import dressed
from . import FORMATS, LoadOptions, reading, resolved

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Directions in which it is kept how far the frames reach; those between are off by 0.4 % at most.
_DIRECTIONS = 512
# Spheres whose distances along all directions are computed at a time.
_BLOCK = 1 << 15


def load_frames(
    path: str | os.PathLike[str],
    frames: str | slice = ":",
    options: LoadOptions | None = None,
) -> Frames:
    """The frames of a trajectory as scenes.

    frames: which, as a slice of Python's, or written as one: "10:", ":100:5", "::-1", or "all".
    options: as of load(), but for `frame`. The file is read once here, for what all frames have in
    common, and again when the scenes are asked for; one frame at a time is in memory.

    Raises FormatError for a file that is missing, broken or has no such frames.
    """
    file, module, chosen = resolved(path, options)
    if not hasattr(module, "trajectory"):
        raise FormatError(
            f"{file}: frames of {module.NAME} files are not read (choices: {', '.join(_known())})"
        )
    if chosen.frame != 0:
        one, many = option("frame"), option("frames")
        raise SceneError(f"the option {one!r} is of one frame; give {many} or {one}")
    return Frames(file, module, chosen, _slice(frames))


class Frames:
    """Scenes of a trajectory, made one by one when they are asked for; load_frames() makes it.

    numbers: of the frames in the file, from 0, in the order of the scenes.

    All have the camera that shows every one of them whole, and the light, ground and, unless the
    options say otherwise, radii and range of colours that go with it.
    """

    def __init__(self, file: Any, module: Any, options: LoadOptions, which: slice) -> None:
        self._file, self._module = file, module
        self._radius: float | None = None
        self._names: dict[str, list[str]] = {}
        self._options = options
        reach, low, high = _Reach(), np.inf, -np.inf
        kinds: dict[str, Vec3] = {}
        first: Scene | None = None
        with reading(file), module.trajectory(file, options) as trajectory:
            self.numbers = range(trajectory.count)[which]
            if not self.numbers:
                raise FormatError(
                    f"{file}: of {trajectory.count} frames none is in {_written(which)}"
                )
            for number in sorted(self.numbers):
                particles = trajectory.read(number)
                if first is None and _touching(particles, options):
                    self._radius = 0.5 * neighbour_distance(particles.positions)
                self._note_names(particles)
                scene = to_scene(self._alike(particles), options, file.name)
                first = first or scene
                if isinstance(scene.legend, ColorBar):
                    low, high = min(low, scene.legend.low), max(high, scene.legend.high)
                elif scene.legend is not None:
                    kinds.update(scene.legend.kinds)
                for shape in scene.shapes:
                    reach.add(shape)
        assert first is not None
        if options.color_by is not None and low < high:
            self._options = replace(options, color_range=(low, high))
        legend = first.legend
        if isinstance(legend, ColorBar):
            legend = replace(legend, low=low, high=high)
        elif legend is not None:
            legend = swatches(legend.label, kinds)
        about = reach.spheres()
        stage = dressed(
            first.replace(shapes=(about,)),
            view=options.view,
            environment=options.environment,
            ground=options.ground,
            bare=True,
        )
        assert isinstance(stage.camera, Framing)
        self._stage = stage.replace(
            legend=legend,
            camera=replace(stage.camera, shapes=(about,)),
            shapes=tuple(shape for shape in stage.shapes if shape is not about),
        )

    @property
    def legend(self) -> ColorBar | Swatches | None:
        """What the colours of all scenes stand for."""
        return self._stage.legend

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Scene]:
        with reading(self._file), self._module.trajectory(self._file, self._options) as trajectory:
            for number in self.numbers:
                if number >= trajectory.count:
                    raise FormatError(f"{self._file}: has become shorter while it was read")
                particles = self._alike(trajectory.read(number))
                scene = to_scene(particles, self._options, f"{self._file.name}, frame {number}")
                shapes = (*scene.shapes, *self._stage.shapes)
                yield self._stage.replace(shapes=shapes, name=scene.name)

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

    def add(self, shape: Shape) -> None:
        for centers, radii in hull(shape):
            around = np.broadcast_to(radii, len(centers))
            for start in range(0, len(centers), _BLOCK):
                self._add(centers[start : start + _BLOCK], around[start : start + _BLOCK])

    def _add(self, centers: NDArray[Any], radii: NDArray[Any]) -> None:
        out = centers.astype(np.float64) @ self._directions.T + radii[:, None]
        best = np.argmax(out, axis=0)
        most = out[best, np.arange(len(best))]
        new = most > self._most
        self._most[new] = most[new]
        self._centers[new], self._radii[new] = centers[best[new]], radii[best[new]]

    def spheres(self) -> Spheres:
        found = np.unique(np.column_stack([self._centers, self._radii]), axis=0)
        return Spheres(found[:, :3], found[:, 3], name="frames")


def _known() -> list[str]:
    """Endings of formats with frames."""
    from importlib import import_module

    modules = {suffix: import_module(f".{name}", __package__) for suffix, name in FORMATS.items()}
    return [suffix for suffix, module in modules.items() if hasattr(module, "trajectory")]


def _slice(frames: str | slice) -> slice:
    """The slice that is written. Raises SceneError for anything else."""
    if isinstance(frames, slice):
        return frames
    parts = (":" if frames == "all" else str(frames)).split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or numbers[2:] == [0]:
        raise SceneError(
            f"{option('frames')} {frames!r}: a slice such as 10:, :100:5 or ::-1 is needed, or all"
        )
    return slice(*numbers)


def _written(which: slice) -> str:
    parts = [which.start, which.stop] + ([which.step] if which.step is not None else [])
    return ":".join("" if part is None else str(part) for part in parts)
