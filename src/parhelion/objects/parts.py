"""What objects are made of, surfaces, lines and points, and the scene that several of them make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import particles
from ..errors import SceneError, option, unknown_name
from ..framing import bounds
from ..io import LoadOptions
from ..io.mesh_file import colored, legend_of, numbers_of, shaded
from ..io.meshes import MeshData, check_indices
from ..particles import Labels, Particles
from ..scene import ColorBar, Curves, Material, Scene, Shape, Swatches
from ..studio import axis, framing

# Up in the meshes of simulations and CAD, unless told otherwise
_UP = "z"
# The radius of lines, and of points among surfaces and lines, in parts of the diagonal of it all:
# some three pixels wide in a picture of usual size, as visualization programs draw them.
_THIN = 0.004
# What is asked of points alone
_OF_POINTS = tuple(
    name for name in particles.OPTIONS if name not in ("color_by", "colormap", "color_range")
)
_DEFAULT = LoadOptions()


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh. material: None for its colours, or white."""

    data: MeshData
    name: str
    material: Material | None = None

    @property
    def points(self) -> NDArray[Any]:
        return self.data.vertices

    def fields(self) -> list[str]:
        """What it can be coloured by."""
        return _names(self.data.attributes)

    def values(self, name: str) -> NDArray[Any]:
        """The numbers of a field."""
        return numbers_of(self.data.attributes, name)[1]

    def made(
        self, options: LoadOptions, _: Any
    ) -> tuple[Sequence[Shape], ColorBar | Swatches | None]:
        """The shapes, and what their colours stand for; likewise of the other parts.

        The second argument is the radius of what has none of its own.
        """
        data = self.data
        check_indices(self.name, data.faces, len(data.vertices))
        options = replace(options, **{name: getattr(_DEFAULT, name) for name in _OF_POINTS})
        material = self.material if options.color_by is None else None
        mesh = shaded(colored(data, options), self.name, material)
        return [mesh], legend_of(data, options)


@dataclass(frozen=True, eq=False)
class Lines:
    """Chains of straight lines: points (P, 3), one chain after the other, counts (S,) of each.

    attributes: "vertex_NAME", (P,) or (P, M), and "face_NAME", (S,) or (S, M), as of a mesh.
    colors: (S, 3) linear RGB or None.
    """

    points: NDArray[Any]
    counts: NDArray[np.integer[Any]]
    name: str
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    colors: NDArray[Any] | None = None

    def fields(self) -> list[str]:
        return _names(self.attributes)

    def values(self, name: str) -> NDArray[Any]:
        return numbers_of(self.attributes, name)[1]

    def made(
        self, options: LoadOptions, radius: Any
    ) -> tuple[Sequence[Shape], ColorBar | Swatches | None]:
        if not isinstance(radius, (int, float)) or not radius > 0.0:
            raise SceneError(f"radius is {radius!r}; of lines it must be a positive number")
        counts = np.asarray(self.counts)
        colors = None if self.colors is None else np.repeat(self.colors, counts - 1, axis=0)
        legend = None
        if options.color_by is not None:
            key, values = numbers_of(self.attributes, options.color_by)
            if key.startswith("vertex_"):
                # lines begin at all points but the last of each chain
                begins = np.ones(len(self.points), bool)
                begins[np.cumsum(counts) - 1] = False
                at = np.flatnonzero(begins)
                values = 0.5 * (values[at] + values[at + 1])
            else:
                values = np.repeat(values, counts - 1)
            limits = particles.color_range(values, options.color_range)
            colors = particles.mapped(values, options.colormap, *limits)
            legend = ColorBar(options.color_by, options.colormap, *limits)
        tubes = Curves(self.points, radius, counts, "linear", colors=colors, name=self.name)
        return [tubes], legend


@dataclass(frozen=True, eq=False)
class Points:
    """Points or atoms."""

    found: Particles
    name: str

    @property
    def points(self) -> NDArray[Any]:
        return self.found.positions

    def fields(self) -> list[str]:
        return particles.field_names(self.found)

    def values(self, name: str) -> NDArray[Any] | Labels:
        return particles.field_of(self.found, name)

    def made(
        self, options: LoadOptions, radius: Any
    ) -> tuple[Sequence[Shape], ColorBar | Swatches | None]:
        if self.found.elements is None and self.found.radii is None:
            options = replace(options, radius=radius)
        scene = particles.to_scene(self.found, options, self.name)
        return scene.shapes, scene.legend if options.color_by else None


@dataclass(frozen=True, eq=False)
class Own:
    """A shape of this package, which stays as it is."""

    shape: Shape

    @property
    def points(self) -> NDArray[Any]:
        """The corners of its box, (2, 3)."""
        return np.array(bounds(Scene([self.shape])))

    def fields(self) -> list[str]:
        return []

    def values(self, name: str) -> NDArray[Any]:
        raise KeyError(name)

    def made(self, _: LoadOptions, __: Any) -> tuple[Sequence[Shape], None]:
        return [self.shape], None


Part = Surface | Lines | Points | Own


def scene_of_parts(parts: Sequence[Part], options: LoadOptions, name: str) -> Scene:
    """One scene of them all, with one range of colours.

    Raises SceneError for what the parts cannot be, for a field that none of them has, and for
    options that are for others.
    """
    if not parts:
        raise SceneError(f"the {name} holds nothing that can be seen")
    if len(parts) == 1 and isinstance(parts[0], Points):
        scene = particles.to_scene(parts[0].found, options, name)
        return scene if options.up is None else scene.replace(camera=framing(axis(options.up)))
    _check_options(parts, options)
    limits = _limits(parts, options)
    radius = options.radius
    if radius is None:
        corners = np.array([[p.points.min(axis=0), p.points.max(axis=0)] for p in parts])
        low, high = corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        radius = _THIN * float(np.linalg.norm(high - low)) or _THIN
    shapes: list[Shape] = []
    legend: ColorBar | Swatches | None = None
    for part in parts:
        own = replace(options, color_range=limits)
        if options.color_by not in part.fields():
            own = replace(own, color_by=None, color_range=None, colormap=_DEFAULT.colormap)
        made, meaning = part.made(own, radius)
        shapes += made
        legend = legend or meaning
    camera = framing(axis(options.up or _UP))
    return Scene(shapes, camera=camera, background=None, name=name, legend=legend)


def _check_options(parts: Sequence[Part], options: LoadOptions) -> None:
    """Raises SceneError for what is asked of points where there are none."""
    kinds = {type(part) for part in parts}
    for name in _OF_POINTS:
        if getattr(options, name) == getattr(_DEFAULT, name) or Points in kinds:
            continue
        if Lines not in kinds:
            raise SceneError(f"the option {option(name)!r} is for particles; this is a mesh")
        if name != "radius":
            raise SceneError(f"the option {option(name)!r} is for particles; these are lines")


def _limits(parts: Sequence[Part], options: LoadOptions) -> tuple[float, float] | None:
    """The range of colours: what the user says, or that of the numbers of all parts that have the
    field.
    """
    name = options.color_by
    if name is None:
        if options.color_range is not None or options.colormap != _DEFAULT.colormap:
            raise SceneError("a colour map or its range needs a field to colour by")
        return None
    having = [part for part in parts if name in part.fields()]
    if not having:
        known = dict.fromkeys(field for part in parts for field in part.fields())
        raise SceneError(unknown_name("field to colour by", name, known))
    found = [part.values(name) for part in having]
    numbers = [values for values in found if not isinstance(values, Labels)]
    if options.color_range is not None or not numbers:
        return options.color_range
    low, high = particles.color_range(np.concatenate(numbers))
    return (low, high) if low < high else None  # one value is no range


def _names(attributes: Mapping[str, Any]) -> list[str]:
    """Of fields, without where they are, "vertex_" or "face_"."""
    return [key.partition("_")[2] for key in attributes]
