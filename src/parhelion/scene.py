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
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:  # NumPy takes longer to import than all of this package
    from numpy.typing import ArrayLike

    from .view.notebook import Viewer

Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """A camera: perspective (pinhole or thin lens), orthographic, 360 degrees or fisheye.

    eye, target, up: position, the point looked at, and the direction that is up in the picture.
    fov: horizontal field of view in degrees, from the first to the last pixel *centre* of a row.
    vfov: vertical field of view in degrees, from edge to edge of the picture, as in most tools.
        Give one of the two; with neither, vfov is 40. For "fisheye" vfov is the angle across the
        picture's circle and may be up to 360; "equirectangular" sees everything and has none.
    aperture_radius: radius of the thin lens in scene units; 0 is a pinhole. Perspective only.
    focus_distance: distance from the eye to the plane in focus, along the viewing direction;
        None focuses on the target.
    projection: "perspective", "orthographic", "equirectangular" or "fisheye", the names of
        core/cameras.def.
    height: of what an orthographic camera sees, in scene units.
    shift: (x, y) by which the picture's middle is moved, in picture widths and heights, to the
        right and down; perspective and orthographic only.
    mirrored: left and right exchanged.
    """

    eye: Vec3 = (0.0, 0.0, 5.0)
    target: Vec3 = (0.0, 0.0, 0.0)
    up: Vec3 = (0.0, 1.0, 0.0)
    fov: float | None = None
    vfov: float | None = None
    aperture_radius: float = 0.0
    focus_distance: float | None = None
    projection: str = "perspective"
    height: float | None = None
    shift: tuple[float, float] = (0.0, 0.0)
    mirrored: bool = False


@dataclass(frozen=True)
class Framing:
    """A camera yet to be placed: as near as shows shapes whole, whatever the picture's proportions.

    direction: from the shapes towards the camera, of any length but 0. up, vfov: as in Camera.
    fill: share of the picture's width or height that the shapes take. shapes: names of those to
    show, or shapes, which need not be in the scene; () for all of the scene.
    """

    direction: Vec3 = (0.0, 0.0, 1.0)
    up: Vec3 = (0.0, 1.0, 0.0)
    vfov: float = 40.0
    fill: float = 0.92
    shapes: tuple[str | Shape, ...] = ()


class _Entry:
    """A type's name and its parameters by name, as listed in one of the core's .def files.

    Equal entries compare equal; arrays, which may be large, are equal if they are the same object.
    Which names and ranges are allowed is the core's knowledge; see `parhelion info --materials` or
    docs/scene.md.
    """

    __slots__ = ("_hash", "params", "type")

    type: str
    params: Mapping[str, Any]
    _hash: int | None

    def __init__(self, type: str, **params: Any) -> None:
        object.__setattr__(self, "type", type)
        object.__setattr__(self, "params", MappingProxyType(dict(params)))
        object.__setattr__(self, "_hash", None)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} is frozen; make a new one")

    def __repr__(self) -> str:
        short = {k: f"<{len(v)} bytes>" for k, v in self.params.items() if isinstance(v, bytes)}
        shown = "".join(f", {k}={short.get(k) or repr(v)}" for k, v in self.params.items())
        return f"{type(self).__name__}({self.type!r}{shown})"

    def _key(self) -> tuple[object, tuple[tuple[str, object], ...]]:
        return _comparable(self.type), tuple(
            sorted((k, _comparable(v)) for k, v in self.params.items())
        )

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return (
            type(other) is type(self) and hash(self) == hash(other) and self._key() == other._key()
        )

    def __hash__(self) -> int:
        # Kept: what is a part of several others would be gone through again and again.
        if self._hash is None:
            object.__setattr__(self, "_hash", hash(self._key()))
        assert self._hash is not None
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (type(self), self.type, dict(self.params))


def _rebuild(cls: type[_Entry], name: str, params: dict[str, Any]) -> _Entry:
    return cls(name, **params)


def _comparable(value: Any) -> object:
    if value is None or isinstance(value, (str, bool, _Entry)):
        return value
    if hasattr(value, "__len__"):
        if len(value) > 16 or getattr(value, "ndim", 1) > 2:
            return id(value)
        return tuple(_comparable(x) for x in value)
    return float(value) if hasattr(value, "__float__") else value


class Texture(_Entry):
    """A colour or a number that varies over a surface: `Texture("image", image="wood.jpg")`.

    Each parameter of its type, as listed in core/textures.def, is a number, a colour or another
    Texture, as in `Texture("multiply", color0=wood, color1=dirt)`. Besides:

    image: the pixels of the types that have some: (H, W), (H, W, 3) or (H, W, 4) numbers, the first
        row at the top (v = 1), or the path of a picture file, or all of its bytes. Integers count
        from 0 to the largest of their type.
    color_space: of the image: "srgb" is decoded, "linear" taken as it is; "auto", the default, is
        srgb for the colours of 8-bit images and linear for all else, such as numbers and normals.
    transform: (2, 3) or (3, 3) matrix applied to a surface's (u, v, 1) before the lookup.
    channel: "rgb" (default), "luminance", "r", "g", "b" or "a": what to take; the last four are
        grey where a colour is wanted, and a number from "rgb" is the luminance.
    uvs: the name of an attribute of meshes, (V, 2) numbers, taken in the place of a surface's uvs.
    """


class Material(_Entry):
    """How a surface scatters or emits light: `Material("metal", color=(0.9, 0.6, 0.3), fuzz=0.1)`.

    Each parameter is a number, a colour or a Texture. The first parameter of every type is its
    colour, and a primitive's own colour replaces it. Besides the parameters of its type, as listed
    in core/materials.def, every material takes:

    emission: radiance that its front gives off, linear RGB or a Texture. two_sided_emission: its
        back does too.
    opacity: 1 where there is a surface, 0 where there is a hole; light passes in proportion.
    normal_map: a Texture of normals in tangent space, 0.5 being 0; the red axis along u, the green
        along v, as in glTF, or, with normal_map_frame="right_handed", along normal x u.
    bump_map: a Texture of heights in scene units.
    two_sided: both sides look as the front does; the default. False makes the back black, where the
        material lets no light through. back: the Material of the back.
    priority: a whole number from 1; of glass bodies that overlap, the one of the highest counts.
        0 is outside of that order: its `ior` is that of the inside over whatever is outside.
    absorption: light lost inside the body, 1 / scene unit, RGB.

    Material("blend", a=..., b=..., weight=...) is b in the share `weight`, else a.
    """


class Light(_Entry):
    """A light that is no shape: `Light("point", position=(0, 5, 0), intensity=(10, 10, 10))`.

    Besides the parameters of its type, as listed in core/lights.def, it takes

    image: of the types that have one: (H, W, 3) linear radiance or the path of a picture file.
    color_space: of that image, as in Texture.
    transform: (3, 3) or (4, 4) matrix, a rotation and a translation, from the light's own frame to
        the scene.
    """


class Background(Light):
    """A light from outside the scene: `Background("gradient", zenith=(0.5, 0.7, 1.0))`."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """N spheres as arrays; one object however large N is.

    centers: (N, 3) numbers. radii: (N,), or one number for all; each > 0.
    material: the name of a material of the scene, a Material, or (N,) names or integers, which
        index the scene's materials in their order.
    colors: (N, 3) linear RGB that replaces the material's own colour, or None.
    rotation: (3, 3) from each sphere's own frame to the scene, for textures. A sphere's u is its
        longitude, 0 at its x axis, over 360 degrees; v goes from 0 at its -z pole to 1 at +z.
    inside_out: normals point inwards.
    """

    centers: ArrayLike
    radii: ArrayLike = 1.0
    material: str | Material | ArrayLike = field(default_factory=lambda: Material("diffuse"))
    colors: ArrayLike | None = None
    name: str = "spheres"
    rotation: ArrayLike | None = None
    inside_out: bool = False


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles over shared vertices.

    vertices: (V, 3). faces: (F, 3) indices of vertices; counter-clockwise seen from the front.
    normals: (V, 3) shading normals, of any length, or None for flat faces. uvs: (V, 2) or None.
    material: as in Spheres; (F,) names or integers give each face its own.
    colors: (F, 3) linear RGB a face that replaces the material's own colour, or None.
    attributes: named arrays for Texture("attribute", name=...), (V,), (V, 3), (F,) or (F, 3), and
        for uvs of a Texture, (V, 2) or (F, 2); the name begins with "vertex_" or "face_".
    inside_out: normals point the other way.
    tangents: (V, 4), or None for the directions of the uvs. The first three lead along a normal
        map's red axis, and along that of anisotropy. The fourth is 1 where the green axis is that
        of the cross product normal x tangent, -1 on the other side.
    """

    vertices: ArrayLike
    faces: ArrayLike
    normals: ArrayLike | None = None
    uvs: ArrayLike | None = None
    material: str | Material | ArrayLike = field(default_factory=lambda: Material("diffuse"))
    colors: ArrayLike | None = None
    attributes: Mapping[str, ArrayLike] = field(default_factory=dict)
    name: str = "mesh"
    inside_out: bool = False
    tangents: ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Disks:
    """N flat disks, or ellipses: centre + a * axis_u + b * axis_v with a^2 + b^2 <= 1.

    centers, axis_u, axis_v: (N, 3); the axes perpendicular to each other. The front is where
    axis_u x axis_v points. u is the distance from the centre, 0 to 1, v the angle over 360 degrees.
    """

    centers: ArrayLike
    axis_u: ArrayLike
    axis_v: ArrayLike
    material: str | Material | ArrayLike = field(default_factory=lambda: Material("diffuse"))
    colors: ArrayLike | None = None
    name: str = "disks"
    inside_out: bool = False


@dataclass(frozen=True, eq=False)
class Cylinders:
    """N round tubes without caps.

    starts, ends: (N, 3) of the axes. radii: (N,), or one number for all. axis_u: (N, 3) direction
    in which u, the angle over 360 degrees, is 0, or None for any; v goes from start to end.
    """

    starts: ArrayLike
    ends: ArrayLike
    radii: ArrayLike = 1.0
    axis_u: ArrayLike | None = None
    material: str | Material | ArrayLike = field(default_factory=lambda: Material("diffuse"))
    colors: ArrayLike | None = None
    name: str = "cylinders"
    inside_out: bool = False


@dataclass(frozen=True, eq=False)
class Curves:
    """Strands such as hair or fibres, each a chain of segments of varying thickness.

    points: (P, 3) control points of all strands, one strand after the other. radii: (P,) or one
    number for all. counts: (S,) control points of each strand; None is a single strand.
    basis: "linear", "bezier" (3 k + 1 points a strand) or "bspline" (uniform cubic, at least 4).
    style: "round", tubes, or "flat", ribbons that face the ray. capped: half spheres close the ends
    of tubes; False leaves them open.
    material: as in Spheres; arrays have one element a segment.
    """

    points: ArrayLike
    radii: ArrayLike = 0.01
    counts: ArrayLike | None = None
    basis: str = "bspline"
    style: str = "round"
    capped: bool = True
    material: str | Material | ArrayLike = field(default_factory=lambda: Material("diffuse"))
    colors: ArrayLike | None = None
    name: str = "curves"


@dataclass(frozen=True, eq=False)
class Instances:
    """Copies of a group of shapes, which is kept once.

    shapes: what is copied; none of them Instances. transforms: (N, 3, 4) or (N, 4, 4) matrices from
    the group's frame to the scene; any affine ones that can be inverted. colors: (N, 3) linear RGB
    of the instances, None for the materials' own, which primitives with colours of their own keep.
    """

    shapes: Sequence[Spheres | Mesh | Disks | Cylinders | Curves]
    transforms: ArrayLike
    name: str = "instances"
    colors: ArrayLike | None = None


Solid = Spheres | Mesh | Disks | Cylinders | Curves
Shape = Solid | Instances


@dataclass(frozen=True)
class Settings:
    """What to render: a scene file may set these, and every one is also an argument of render().

    width, height: the picture in pixels. spp: samples per pixel; with noise, the most. noise: how
    far pixels may be from what infinitely many samples would show, within 95 % confidence and as a
    share of their brightness; each part of the picture gets the samples that it needs for that.
    None: all pixels get spp samples. max_depth: rays in the longest path, the camera's own
    included. seed: of all random numbers. sampler, filter: by name; filter_radius in pixels, None
    for the filter's own. roulette: end dim paths early, without bias. crop: (x, y, width, height)
    of the part to render, from the top left; None for all.
    integrator: "path" (all light), "direct" (light that was scattered once at most), or "ao" (how
    much of the surroundings within ao_distance, in scene units, None for any, is open; white is
    all). backdrop: linear RGB that the camera sees where there is nothing, None for the light that
    comes from there; things are lit by that light all the same. clamp_indirect: the largest
    radiance that light may bring to a sample after it was scattered more than once, None for any;
    it takes fireflies away, and the picture is darker than the truth then. reuse_paths: pixels use
    the light that paths of others close by have found, on the second surface and from there on
    (Bekaert, Sbert and Halton, "Accelerating Path Tracing by Re-Using Paths", 2002): much less
    noise where light has been around, for more time a sample; the mean is the same. "auto" looks
    at parts of the picture for whether that pays; pictures of less than 32 squares of 16x16 pixels
    are not looked at, and share none.
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
    integrator: str = "path"
    ao_distance: float | None = None
    backdrop: Vec3 | None = None
    noise: float | None = None
    clamp_indirect: float | None = None
    reuse_paths: bool | Literal["auto"] = "auto"

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of what is rendered: of the crop, if there is one."""
        return self.crop[2:] if self.crop else (self.width, self.height)


@dataclass(frozen=True)
class ColorBar:
    """Colours stand for numbers: those of a Matplotlib colour map from one value to another.

    label: what the numbers are.
    """

    label: str
    colormap: str
    low: float
    high: float


@dataclass(frozen=True)
class Swatches:
    """Colours stand for kinds, such as elements: (name, linear RGB) of each. label: of what."""

    label: str
    kinds: tuple[tuple[str, Vec3], ...]


@dataclass(frozen=True)
class Source:
    """Where a scene came from: a file's absolute path and those fields of LoadOptions that were not
    left as they are; path None is the built-in scene, with its arguments. frames: of one of the
    scenes of load_frames(), its range, with both ends, and the place in it. turned: rotation (3, 3)
    and pivot (3,) by which a turntable has moved the light that the file got.
    """

    path: str | None
    options: Mapping[str, Any] = field(default_factory=dict)
    frames: tuple[str, int] | None = None
    turned: tuple[Sequence[Sequence[float]], Sequence[float]] | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything there is to see, and the camera that sees it.

    shapes: Spheres, Mesh, Disks, Cylinders, Curves and Instances, any number of each.
    materials: named ones, for shapes to refer to. camera: None is Framing(), all shapes from the
    front. background: the light from outside, None for darkness. lights: further ones; emissive
    materials need no mention here. settings: defaults for render().
    name: what the scene calls itself; error texts and metadata use it. legend: what its colours
    stand for, if they stand for something. source: where it came from, for pictures to tell; what
    was changed since does not show there.
    """

    shapes: Sequence[Shape] = ()
    materials: Mapping[str, Material] = field(default_factory=dict)
    camera: Camera | Framing | None = None
    background: Light | None = field(default_factory=lambda: Background("gradient"))
    settings: Settings = field(default_factory=Settings)
    name: str = "scene"
    lights: Sequence[Light] = ()
    legend: ColorBar | Swatches | None = None
    source: Source | None = None

    def replace(self, **changes: Any) -> Scene:
        """A copy with some fields changed, as dataclasses.replace."""
        return replace(self, **changes)

    def view(self, *, height: int = 560, **settings: Any) -> Viewer:
        """Shows the scene in a notebook's cell, rendered while it is looked at.

        height: of the cell, in pixels of the page. settings: as Session takes them, such as camera,
        spp, max_depth, cluster and memory_limit. Raises SceneError, and ResourceError for too
        little memory and without the package anywidget.
        """
        from .view.notebook import view

        return view(self, height, **settings)
