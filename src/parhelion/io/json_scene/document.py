"""The document as msgspec structs: the types, limits and words of every field.

Defaults are those of the dataclasses. Materials, textures and lights have parameters that the
core's tables list; here are the fields that they share, and `entries` checks the rest.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, Struct, UnsetType

from ... import scene as model
from ...tables import LARGEST

Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0, le=LARGEST)]
Share = Annotated[float, Meta(ge=0, le=1)]
Radiance = Annotated[float, Meta(ge=0, le=1e12)]
Count = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Place = Annotated[int, Meta(ge=0, le=2**31 - 1)]
# the limits of renderer.merged()
Offset = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Side = Annotated[int, Meta(ge=1, le=65536)]
Depth = Annotated[int, Meta(ge=1, le=2**20)]
FilterRadius = Annotated[float, Meta(gt=0, le=32)]
Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Angle = Annotated[float, Meta(gt=0, lt=180)]
WideAngle = Annotated[float, Meta(gt=0, le=360)]
Vec2 = tuple[Number, Number]
Vec3 = tuple[Number, Number, Number]
Vec4 = tuple[Number, Number, Number, Number]
Color = tuple[NotNegative, NotNegative, NotNegative]
# In a union with a number these are lists: msgspec 0.22 corrupts memory where a number with limits
# may be a tuple of fixed length too.
Numbers2or3 = Annotated[list[Number], Meta(min_length=2, max_length=3)]
Radiances = Annotated[list[Radiance], Meta(min_length=3, max_length=3)]
Face = tuple[Place, Place, Place]
Name = Annotated[str, Meta(max_length=1000)]
File = Annotated[str, Meta(extra_json_schema={"pattern": r"\.npy$"})]
Normals = Annotated[str, Meta(extra_json_schema={"pattern": r"^smooth$|^flat$|\.npy$"})]
MeshFile = Annotated[str, Meta(extra_json_schema={"pattern": r"\.(obj|ply|serialized)$"})]


def _listed(name: str) -> Meta:
    """What the core lists: checked against its tables, and so is its part of the schema."""
    return Meta(extra_json_schema={"$ref": f"#/$defs/{name}"})


Material = Annotated[Any, _listed("Material")]
InlineMaterial = Annotated[dict[str, Any], _listed("Material")]
InlineTexture = Annotated[dict[str, Any], _listed("Texture")]
# of a shape: a material, or Stored indices of the document's
ShapeMaterial = Annotated[
    dict[str, Any],
    Meta(extra_json_schema={"anyOf": [{"$ref": "#/$defs/Material"}, {"$ref": "#/$defs/Stored"}]}),
]
Light = Annotated[Any, _listed("Light")]
Background = Annotated[
    Any, Meta(extra_json_schema={"anyOf": [{"$ref": "#/$defs/Background"}, {"type": "null"}]})
]
Projection = Annotated[str, _listed("Projection")]
Sampler = Annotated[str, _listed("Sampler")]
Filter = Annotated[str, _listed("Filter")]
Attribute = Annotated[Any, _listed("Attribute")]


def _doc(description: str, default: Any = None) -> Meta:
    """default: for the schema, of a field whose default msgspec has from a factory."""
    return Meta(
        description=description,
        extra_json_schema=None if default is None else {"default": default},
    )


def _diffuse() -> dict[str, Any]:
    return {"type": "diffuse"}


# ---------------------------------------------------------------------------------------------
# What materials, textures and lights share


class CommonMaterial(Struct, forbid_unknown_fields=True):
    """What every material has besides the parameters of its type."""

    emission: Annotated[
        Radiance | Radiances | InlineTexture,
        _doc("radiance that its front gives off, linear RGB"),
    ] = 0.0
    two_sided_emission: Annotated[bool, _doc("its back gives it off too")] = False
    opacity: Annotated[
        Share | InlineTexture,
        _doc("1 where there is a surface, 0 where there is a hole; light passes in proportion"),
    ] = 1.0
    normal_map: Annotated[
        InlineTexture | None,
        _doc("of normals in tangent space, 0.5 being 0; red along u, green along v"),
    ] = None
    normal_map_frame: Annotated[
        Literal["uv", "right_handed"],
        _doc("where green points: along v, or along normal x u"),
    ] = "uv"
    bump_map: Annotated[InlineTexture | None, _doc("of heights in scene units")] = None
    two_sided: Annotated[
        bool,
        _doc("both sides look as the front does; false makes the back black, except of glass"),
    ] = True
    back: Annotated[Name | InlineMaterial | None, _doc("the material of the back")] = None
    priority: Annotated[
        Place,
        _doc("of glass bodies that overlap the one of the highest counts; 0 is outside that order"),
    ] = 0
    absorption: Annotated[
        Radiance | Radiances,
        _doc("light lost inside the body, 1 / scene unit, RGB"),
    ] = 0.0


class Blend(Struct, forbid_unknown_fields=True):
    """One material in places of another."""

    a: Annotated[Name | InlineMaterial, _doc("a material, or the name of one")]
    b: Annotated[Name | InlineMaterial, _doc("the other")]
    weight: Annotated[Share | InlineTexture, _doc("share of b")] = 0.5


class Arrays(Struct, forbid_unknown_fields=True):
    """The side file: arrays one after the other, as they lie in memory."""

    file: Annotated[Name, _doc("its name, relative to the scene's folder")]
    bytes: Annotated[Offset, _doc("how long it is")]
    sha256: Annotated[
        str,
        Meta(description="of all of it, in hexadecimal", pattern="^[0-9a-f]{64}$"),
    ]


class Stored(Struct, forbid_unknown_fields=True):
    """An array in the side file, row by row, little-endian."""

    shape: Annotated[list[Count], Meta(min_length=1, max_length=3, description="its size")]
    type: Annotated[Literal["float32", "float64", "uint32"], _doc("of its numbers")]
    at: Annotated[Offset, _doc("byte of the side file where it begins, a multiple of 64")]


class Pixels(Struct, forbid_unknown_fields=True):
    """An image that was an array: within the document, or in the side file."""

    shape: Annotated[
        list[Count],
        Meta(min_length=2, max_length=3, description="height, width and, if not 1, channels"),
    ]
    type: Annotated[Literal["uint8", "uint16", "float32"], _doc("of its numbers")]
    data: Annotated[
        bytes | None, _doc("the numbers row by row from the top, little-endian, in base64")
    ] = None
    at: Annotated[
        Offset | None, _doc("in the place of data: byte of the side file where they begin")
    ] = None


_IMAGE = _doc("a picture file, its name relative to the scene's folder, or the pixels themselves")
_COLOR_SPACE = _doc("of the image: auto is srgb for the colours of 8-bit images, else linear")


class CommonTexture(Struct, forbid_unknown_fields=True):
    """What every texture has besides the parameters of its type."""

    transform: Annotated[
        Annotated[list[Vec3], Meta(min_length=2, max_length=3)] | None,
        _doc("2x3 or 3x3 matrix, as its rows, applied to a surface's (u, v, 1)"),
    ] = None
    channel: Annotated[
        Literal["rgb", "luminance", "r", "g", "b", "a"],
        _doc("what to take; where the parameter is a number, of rgb the luminance"),
    ] = "rgb"
    uvs: Annotated[
        Name | None, _doc("an attribute of meshes, pairs of numbers, in the place of their uvs")
    ] = None


class ImageTexture(CommonTexture, forbid_unknown_fields=True):
    """What a texture with an image has."""

    image: Annotated[Name | Pixels | UnsetType, _IMAGE] = UNSET
    color_space: Annotated[Literal["auto", "srgb", "linear"], _COLOR_SPACE] = "auto"


class CommonLight(Struct, forbid_unknown_fields=True):
    """What every light has besides the parameters of its type."""

    transform: Annotated[
        Annotated[
            list[Annotated[list[Number], Meta(min_length=3, max_length=4)]],
            Meta(min_length=3, max_length=4),
        ]
        | None,
        _doc(
            "3x3, 3x4 or 4x4 matrix, a rotation and a translation, as its rows, "
            "from the light's own frame to the scene"
        ),
    ] = None


class ImageLight(CommonLight, forbid_unknown_fields=True):
    """What a light with an image has."""

    image: Annotated[Name | Pixels | UnsetType, _IMAGE] = UNSET
    color_space: Annotated[Literal["auto", "srgb", "linear"], _COLOR_SPACE] = "auto"


# ---------------------------------------------------------------------------------------------
# Shapes

_MATERIAL = _doc(
    "the name of a material, a list of one name each, or a material itself; a stored array has "
    "indices of the document's materials",
    {"type": "diffuse"},
)
_COLORS = _doc(
    "linear RGB of each that replaces the material's own, or a .npy file of shape (N, 3)"
)
_NAME = _doc("what error texts call this shape")
_INSIDE_OUT = _doc("normals point the other way")
_ROWS = "N x, y, z, or the name of a .npy file with an array of shape (N, 3)"
_ONE_OR_N = "one number for all, or N, or a .npy file of shape (N,)"


class Spheres(Struct, forbid_unknown_fields=True, tag_field="type", tag="spheres"):
    """N spheres as arrays."""

    centers: Annotated[
        Annotated[list[Vec3], Meta(min_length=1)] | File | Stored,
        _doc(f"positions: {_ROWS}"),
    ]
    radii: Annotated[Positive | list[Positive] | File | Stored, _doc(_ONE_OR_N)] = 1.0
    material: Annotated[Name | list[Name] | ShapeMaterial, _MATERIAL] = msgspec.field(
        default_factory=_diffuse
    )
    colors: Annotated[list[Color] | File | Stored | None, _COLORS] = None
    name: Annotated[Name, _NAME] = model.Spheres.name
    rotation: Annotated[
        tuple[Vec3, Vec3, Vec3] | None,
        _doc("matrix, as its rows, from each sphere's own frame to the scene, for textures"),
    ] = None
    inside_out: Annotated[bool, _INSIDE_OUT] = False


class Mesh(Struct, forbid_unknown_fields=True, tag_field="type", tag="mesh"):
    """Triangles over shared vertices."""

    vertices: Annotated[
        Annotated[list[Vec3], Meta(min_length=1)] | File | Stored | UnsetType, _doc(_ROWS)
    ] = UNSET
    faces: Annotated[
        Annotated[list[Face], Meta(min_length=1)] | File | Stored | UnsetType,
        _doc(
            "three indices of vertices each, from 0, counter-clockwise seen from the front; "
            "or a .npy file of shape (N, 3)"
        ),
    ] = UNSET
    file: Annotated[
        MeshFile | None,
        _doc("a .obj, .ply or .serialized file, in the place of vertices and faces"),
    ] = None
    file_index: Annotated[Place, _doc("which mesh of a .serialized file, from 0")] = 0
    normals: Annotated[
        list[Vec3] | Normals | Stored | None,
        _doc(
            '"flat"; "smooth" makes them from the faces; or one shading normal for each vertex; '
            "null is the file's own, and flat without a file"
        ),
    ] = None
    uvs: Annotated[
        list[Vec2] | File | Stored | None,
        _doc("u, v of each vertex, or a .npy file of shape (N, 2)"),
    ] = None
    tangents: Annotated[
        list[Vec4] | File | Stored | None,
        _doc(
            "of each vertex the direction of a normal map's red axis, and 1 if its green one is "
            "normal x that, -1 if it is the other way; null is that of the uvs"
        ),
    ] = None
    material: Annotated[Name | list[Name] | ShapeMaterial, _MATERIAL] = msgspec.field(
        default_factory=_diffuse
    )
    colors: Annotated[list[Color] | File | Stored | None, _COLORS] = None
    attributes: Annotated[
        dict[str, Attribute],
        _doc("numbers or colours of each vertex, vertex_NAME, or of each face, face_NAME"),
    ] = {}
    name: Annotated[Name, _NAME] = model.Mesh.name
    inside_out: Annotated[bool, _INSIDE_OUT] = False


class Disks(Struct, forbid_unknown_fields=True, tag_field="type", tag="disks"):
    """N flat disks, or ellipses."""

    centers: Annotated[
        Annotated[list[Vec3], Meta(min_length=1)] | File | Stored, _doc(f"positions: {_ROWS}")
    ]
    axis_u: Annotated[
        list[Vec3] | File | Stored,
        _doc(f"from the centre to the rim, perpendicular to axis_v: {_ROWS}"),
    ]
    axis_v: Annotated[
        list[Vec3] | File | Stored, _doc(f"likewise; the front is where u x v points: {_ROWS}")
    ]
    material: Annotated[Name | list[Name] | ShapeMaterial, _MATERIAL] = msgspec.field(
        default_factory=_diffuse
    )
    colors: Annotated[list[Color] | File | Stored | None, _COLORS] = None
    name: Annotated[Name, _NAME] = model.Disks.name
    inside_out: Annotated[bool, _INSIDE_OUT] = False


class Cylinders(Struct, forbid_unknown_fields=True, tag_field="type", tag="cylinders"):
    """N round tubes without caps."""

    starts: Annotated[
        Annotated[list[Vec3], Meta(min_length=1)] | File | Stored, _doc(f"of the axes: {_ROWS}")
    ]
    ends: Annotated[list[Vec3] | File | Stored, _doc(f"of the axes: {_ROWS}")]
    radii: Annotated[Positive | list[Positive] | File | Stored, _doc(_ONE_OR_N)] = 1.0
    axis_u: Annotated[
        list[Vec3] | File | Stored | None, _doc(f"direction where u is 0; null is any: {_ROWS}")
    ] = None
    material: Annotated[Name | list[Name] | ShapeMaterial, _MATERIAL] = msgspec.field(
        default_factory=_diffuse
    )
    colors: Annotated[list[Color] | File | Stored | None, _COLORS] = None
    name: Annotated[Name, _NAME] = model.Cylinders.name
    inside_out: Annotated[bool, _INSIDE_OUT] = False


class Curves(Struct, forbid_unknown_fields=True, tag_field="type", tag="curves"):
    """Strands such as hair or fibres."""

    points: Annotated[
        Annotated[list[Vec3], Meta(min_length=1)] | File | Stored,
        _doc(f"control points of all strands, one strand after the other: {_ROWS}"),
    ]
    radii: Annotated[Positive | list[Positive] | File | Stored, _doc(_ONE_OR_N)] = 0.01
    counts: Annotated[
        list[Count] | File | Stored | None,
        _doc("control points of each strand, or a .npy file of shape (N,); null: a single strand"),
    ] = None
    basis: Annotated[
        Literal["linear", "bezier", "bspline"],
        _doc("bezier has 3 k + 1 points a strand, bspline at least 4"),
    ] = "bspline"
    style: Annotated[
        Literal["round", "flat"], _doc("round: tubes; flat: ribbons that face the ray")
    ] = "round"
    capped: Annotated[bool, _doc("tubes end in half spheres; false: open")] = True
    material: Annotated[Name | list[Name] | ShapeMaterial, _MATERIAL] = msgspec.field(
        default_factory=_diffuse
    )
    colors: Annotated[list[Color] | File | Stored | None, _COLORS] = None
    name: Annotated[Name, _NAME] = model.Curves.name


class Instances(Struct, forbid_unknown_fields=True, tag_field="type", tag="instances"):
    """Copies of a group of shapes, which is kept once."""

    shapes: Annotated[
        list[Spheres | Mesh | Disks | Cylinders | Curves],
        _doc("the group: shapes of any other type"),
    ]
    transforms: Annotated[
        Annotated[list[Annotated[list[Vec4], Meta(min_length=3, max_length=4)]], Meta(min_length=1)]
        | File
        | Stored,
        _doc(
            "N matrices, as 3 or 4 rows of 4 numbers, from the group's frame to the scene; "
            "or a .npy file of shape (N, 3, 4) or (N, 4, 4)"
        ),
    ]
    colors: Annotated[
        list[Color] | File | Stored | None,
        _doc("(N, 3) linear RGB of the instances, where a primitive has no colour of its own"),
    ] = None
    name: Annotated[Name, _NAME] = model.Instances.name


Shape = Spheres | Mesh | Disks | Cylinders | Curves | Instances
SHAPES: dict[str, type[Struct]] = {
    "spheres": Spheres,
    "mesh": Mesh,
    "disks": Disks,
    "cylinders": Cylinders,
    "curves": Curves,
    "instances": Instances,
}


# ---------------------------------------------------------------------------------------------
# The rest of the document


class Camera(Struct, forbid_unknown_fields=True):
    """A camera."""

    eye: Annotated[Vec3, _doc("position")] = model.Camera.eye
    target: Annotated[Vec3, _doc("the point looked at")] = model.Camera.target
    up: Annotated[Vec3, _doc("the direction that is up in the picture")] = model.Camera.up
    fov: Annotated[
        Angle | None,
        _doc(
            "horizontal field of view in degrees, from the first to the last pixel centre of a row"
        ),
    ] = model.Camera.fov
    vfov: Annotated[
        WideAngle | None,
        _doc(
            "vertical field of view in degrees, from edge to edge of the picture, below 180; of "
            "fisheye across the picture's circle, up to 360. 40, of fisheye 180, if neither fov "
            "nor vfov is given"
        ),
    ] = model.Camera.vfov
    aperture_radius: Annotated[
        NotNegative, _doc("radius of the thin lens in scene units; 0 is a pinhole")
    ] = model.Camera.aperture_radius
    focus_distance: Annotated[
        Positive | None,
        _doc("from the eye to the plane in focus, in scene units; null focuses on the target"),
    ] = model.Camera.focus_distance
    projection: Annotated[Projection, _doc("how directions become places in the picture")] = (
        model.Camera.projection
    )
    height: Annotated[
        Positive | None, _doc("of what an orthographic camera sees, in scene units")
    ] = model.Camera.height
    shift: Annotated[
        Vec2,
        _doc(
            "by which the picture's middle is moved to the right and down, in picture widths and "
            "heights; of perspective and orthographic"
        ),
    ] = model.Camera.shift
    mirrored: Annotated[bool, _doc("left and right exchanged")] = model.Camera.mirrored


class Framing(Struct, forbid_unknown_fields=True):
    """A camera yet to be placed, as near as shows shapes whole."""

    direction: Annotated[Vec3, _doc("from the shapes towards the camera, of any length but 0")] = (
        model.Framing.direction
    )
    up: Annotated[Vec3, _doc("the direction that is up in the picture")] = model.Framing.up
    vfov: Annotated[Angle, _doc("vertical field of view in degrees, from edge to edge")] = (
        model.Framing.vfov
    )
    fill: Annotated[
        float,
        Meta(gt=0, le=1, description="share of the picture's width or height that they take"),
    ] = model.Framing.fill
    shapes: Annotated[list[Name], _doc("names of the shapes to show; none for all")] = []


class Legend(Struct, forbid_unknown_fields=True):
    """What the scene's colours stand for: numbers, or kinds."""

    label: Annotated[Name, _doc("what the numbers are, or of what these are the kinds")]
    colormap: Annotated[
        Name | UnsetType, _doc("of numbers: the name of a Matplotlib colour map")
    ] = UNSET
    low: Annotated[Number | UnsetType, _doc("the number at the map's lower end")] = UNSET
    high: Annotated[Number | UnsetType, _doc("the number at its upper end, not less")] = UNSET
    kinds: Annotated[
        list[tuple[Name, Color]] | UnsetType,
        _doc("in the place of these: the name and the linear RGB of each kind"),
    ] = UNSET


class Settings(Struct, forbid_unknown_fields=True):
    """Defaults for rendering; options of the command and arguments of render() override them."""

    width: Annotated[Side, _doc("of the picture, in pixels")] = model.Settings.width
    height: Annotated[Side, _doc("of the picture, in pixels")] = model.Settings.height
    spp: Annotated[Count, _doc("samples per pixel")] = model.Settings.spp
    max_depth: Annotated[Depth, _doc("rays in the longest path, the camera's own included")] = (
        model.Settings.max_depth
    )
    seed: Annotated[Seed, _doc("of all random numbers")] = model.Settings.seed
    sampler: Annotated[Sampler, _doc("where in pixel, lens and path samples lie")] = (
        model.Settings.sampler
    )
    filter: Annotated[Filter, _doc("how a pixel weighs its surroundings")] = model.Settings.filter
    filter_radius: Annotated[FilterRadius | None, _doc("in pixels; null is the filter's own")] = (
        model.Settings.filter_radius
    )
    roulette: Annotated[bool, _doc("end dim paths early, without bias")] = model.Settings.roulette
    crop: Annotated[
        tuple[Place, Place, Count, Count] | None,
        _doc("x, y, width, height of the part to render, from the top left; null is all of it"),
    ] = model.Settings.crop
    integrator: Annotated[
        Literal["path", "direct", "ao"],
        _doc(
            "path: all light; direct: light that was scattered once at most; ao: how much of the "
            "surroundings is open"
        ),
    ] = "path"
    ao_distance: Annotated[
        Positive | None, _doc("how far ao looks, in scene units; null is any distance")
    ] = model.Settings.ao_distance
    backdrop: Annotated[
        Color | None,
        _doc("linear RGB that the camera sees where there is nothing; null: the light"),
    ] = model.Settings.backdrop
    noise: Annotated[
        Positive | None,
        _doc("how far pixels may be off, as a share of their brightness; spp is then the most"),
    ] = model.Settings.noise
    clamp_indirect: Annotated[
        Positive | None,
        _doc("the most that light brings to a sample after more than one scattering; darkens"),
    ] = model.Settings.clamp_indirect
    reuse_paths: Annotated[
        bool | Literal["auto"],
        _doc(
            "pixels use the light that paths of others close by have found beyond what is seen; "
            "auto: where that pays"
        ),
    ] = model.Settings.reuse_paths


class Document(Struct, forbid_unknown_fields=True):
    """A Parhelion scene."""

    parhelion: Annotated[Literal[1], _doc("version of the format")]
    schema_file: Annotated[str | None, _doc("where the JSON Schema is, for editors; not read")] = (
        msgspec.field(default=None, name="$schema")
    )
    name: Annotated[Name | None, _doc("what the scene is called; the file's name if not given")] = (
        None
    )
    arrays: Annotated[Arrays | None, _doc("the side file that stored arrays are in")] = None
    camera: Annotated[Camera | None, _doc("null or not given: as `framing` says")] = None
    framing: Annotated[
        Framing | None,
        _doc("a camera yet to be placed; null or not given: all shapes, seen from the front"),
    ] = None
    background: Annotated[
        Background, _doc("the light from outside the scene, or null", {"type": "gradient"})
    ] = msgspec.field(default_factory=lambda: {"type": "gradient"})
    lights: Annotated[list[Light], _doc("further lights that are no shapes")] = []
    materials: Annotated[dict[str, Material], _doc("by name, for shapes to refer to")] = {}
    shapes: Annotated[list[Shape], _doc("what there is to see")] = []
    settings: Annotated[Settings, _doc("what to render", {})] = msgspec.field(
        default_factory=Settings
    )
    legend: Annotated[
        Legend | None, _doc("what colours stand for, to be drawn beside the picture; null: nothing")
    ] = None
