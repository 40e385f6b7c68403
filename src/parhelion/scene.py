"""The scene: plain, frozen dataclasses that hold numbers and NumPy arrays.

Nothing here knows of pixels, threads or devices, and nothing is checked here: flatten.py checks
that arrays fit together, and the core every number, once.

Units are the user's own (nanometres, metres, parsecs); colours are linear Rec. 709 RGB; angles
are degrees. The frame is right-handed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # NumPy takes longer to import than all of this package
    from numpy.typing import ArrayLike

Vec3 = tuple[float, float, float]
Value = float | Sequence[float]


@dataclass(frozen=True)
class Camera:
    """A pinhole or thin-lens camera.

    eye, target, up: position, the point looked at, and the direction that is up in the picture.
    fov: horizontal field of view in degrees, from the first to the last pixel *centre* of a row.
    vfov: vertical field of view in degrees, from edge to edge of the picture, as in most tools.
        Give one of the two; with neither, vfov is 40.
    aperture_radius: radius of the thin lens in scene units; 0 is a pinhole.
    focus_distance: distance from the eye to the plane in focus, along the viewing direction;
        None focuses on the target.
    """

    eye: Vec3 = (0.0, 0.0, 5.0)
    target: Vec3 = (0.0, 0.0, 0.0)
    up: Vec3 = (0.0, 1.0, 0.0)
    fov: float | None = None
    vfov: float | None = None
    aperture_radius: float = 0.0
    focus_distance: float | None = None


@dataclass(frozen=True)
class Framing:
    """A camera yet to be placed: as near as shows shapes whole, whatever the picture's proportions.

    direction: from the shapes towards the camera, of any length but 0. up, vfov: as in Camera.
    fill: share of the picture's width or height that the shapes take. shapes: names of those to
    show; () for all.
    """

    direction: Vec3 = (0.0, 0.0, 1.0)
    up: Vec3 = (0.0, 1.0, 0.0)
    vfov: float = 40.0
    fill: float = 0.92
    shapes: tuple[str, ...] = ()


class _Entry:
    """A type's name and its parameters by name, as listed in one of the core's .def files.

    Equal entries compare equal. Which names and ranges are allowed is the core's knowledge; see
    `parhelion info --materials` or docs/scene.md.
    """

    __slots__ = ("params", "type")

    type: str
    params: Mapping[str, Value]

    def __init__(self, type: str, **params: Value) -> None:
        object.__setattr__(self, "type", type)
        object.__setattr__(self, "params", MappingProxyType(dict(params)))

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is frozen; make a new one")

    def __repr__(self) -> str:
        shown = "".join(f", {k}={v!r}" for k, v in self.params.items())
        return f"{type(self).__name__}({self.type!r}{shown})"

    def _key(self) -> tuple[str, tuple[tuple[str, object], ...]]:
        def plain(v: Any) -> object:
            return tuple(float(x) for x in v) if hasattr(v, "__len__") else float(v)

        return self.type, tuple(sorted((k, plain(v)) for k, v in self.params.items()))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.type, dict(self.params))


def _rebuild(cls: type[_Entry], name: str, params: dict[str, Value]) -> _Entry:
    return cls(name, **params)


class Material(_Entry):
    """How a surface scatters or emits light: `Material("metal", color=(0.9, 0.6, 0.3), fuzz=0.1)`.

    The first parameter of every type is its colour, and a primitive's own colour replaces it.
    """


class Background(_Entry):
    """The light from outside the scene: `Background("gradient", zenith=(0.5, 0.7, 1.0))`."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """N spheres as arrays; one object however large N is.

    centers: (N, 3) numbers. radii: (N,), or one number for all; each > 0.
    material: the name of a material of the scene, a Material, or (N,) names or integers, which
        index the scene's materials in their order.
    colors: (N, 3) linear RGB that replaces the material's own colour, or None.
    """

    centers: ArrayLike
    radii: ArrayLike = 1.0
    material: str | Material | ArrayLike = field(default_factory=lambda: Material("diffuse"))
    colors: ArrayLike | None = None
    name: str = "spheres"


Shape = Spheres


@dataclass(frozen=True)
class Settings:
    """What to render: a scene file may set these, and every one is also an argument of render().

    width, height: the picture in pixels. spp: samples per pixel. max_depth: rays in the longest
    path, the camera's own included. seed: of all random numbers. sampler, filter: by name;
    filter_radius in pixels, None for the filter's own. roulette: end dim paths early, without
    bias. crop: (x, y, width, height) of the part to render, from the top left; None for all.
    """

    width: int = 640
    height: int = 360
    spp: int = 64
    max_depth: int = 50
    seed: int = 0
    sampler: str = "sobol"
    filter: str = "blackman-harris"
    filter_radius: float | None = None
    roulette: bool = True
    crop: tuple[int, int, int, int] | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything there is to see, and the camera that sees it.

    shapes: any number of Spheres. materials: named ones, for shapes to refer to.
    camera: None is Framing(), all shapes from the front. settings: defaults for render().
    name: what the scene calls itself; error texts and metadata use it.
    """

    shapes: Sequence[Shape] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    camera: Camera | Framing | None = None
    background: Background = field(default_factory=lambda: Background("gradient"))
    settings: Settings = field(default_factory=Settings)
    name: str = "scene"

    def replace(self, **changes: Any) -> Scene:
        """A copy with some fields changed, as dataclasses.replace."""
        return replace(self, **changes)
