"""The objects of a glTF document as msgspec structs: those fields that change a picture.

Names and defaults are those of the glTF 2.0 specification (Khronos, 2021), section 5, and of its
extensions. Extensions stay raw until somebody asks for them.
"""

from __future__ import annotations

from math import pi
from typing import Annotated

import msgspec
from msgspec import Meta, Raw, Struct

Index = Annotated[int, Meta(ge=0, le=2**32)]
Size = Annotated[int, Meta(ge=0, le=2**53)]
Count = Annotated[int, Meta(ge=1, le=2**53)]
# Writers round: 1.0000001 is meant to be 1
Share = Annotated[float, Meta(ge=-1e-3, le=1.001)]
NotNegative = Annotated[float, Meta(ge=0, le=1e12)]
Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
Matrix = Annotated[list[float], Meta(min_length=16, max_length=16)]
Color = tuple[NotNegative, NotNegative, NotNegative]
Color4 = tuple[Share, Share, Share, Share]


class Thing(Struct, rename="camel", kw_only=True, gc=False):
    """What every object may have."""

    extensions: dict[str, Raw] = {}
    name: str = ""


# --- Arrays --------------------------------------------------------------------------------------


class Asset(Struct, rename="camel"):
    """version: of the format, "2.0"."""

    version: str
    min_version: str = ""


class Buffer(Thing):
    """uri: None is the binary chunk of a .glb file."""

    byte_length: Size
    uri: str | None = None


class BufferView(Thing):
    """A part of a buffer. byte_stride: None is packed."""

    buffer: Index
    byte_length: Size
    byte_offset: Size = 0
    byte_stride: Annotated[int, Meta(ge=4, le=252)] | None = None


class SparseIndices(Struct, rename="camel"):
    """Which elements differ."""

    buffer_view: Index
    component_type: int
    byte_offset: Size = 0


class SparseValues(Struct, rename="camel"):
    """What they are."""

    buffer_view: Index
    byte_offset: Size = 0


class Sparse(Struct, rename="camel"):
    """Elements of an accessor that differ from those in its view."""

    count: Count
    indices: SparseIndices
    values: SparseValues


class Accessor(Thing):
    """An array in a view."""

    component_type: int
    count: Count
    type: str
    buffer_view: Index | None = None
    byte_offset: Size = 0
    normalized: bool = False
    sparse: Sparse | None = None


class Meshopt(Struct, rename="camel"):
    """EXT_meshopt_compression of a view."""

    buffer: Index
    byte_length: Size
    byte_stride: Annotated[int, Meta(ge=1, le=256)]
    count: Size
    mode: str
    byte_offset: Size = 0
    filter: str = "NONE"


# --- Textures and materials ----------------------------------------------------------------------


class Image(Thing):
    """A picture file, beside the document or in a view."""

    uri: str | None = None
    buffer_view: Index | None = None
    mime_type: str = ""


class Sampler(Thing):
    """OpenGL's numbers for filters and wrap modes."""

    mag_filter: int | None = None
    wrap_s: int = 10497
    wrap_t: int = 10497


class Texture(Thing):
    """An image as it is sampled."""

    source: Index | None = None
    sampler: Index | None = None


class TextureInfo(Thing):
    """A texture as a material uses it. scale: of normals."""

    index: Index
    tex_coord: Index = 0
    scale: float = 1.0


class TextureTransform(Struct, rename="camel"):
    """KHR_texture_transform. rotation: radians."""

    offset: Vec2 = (0.0, 0.0)
    rotation: float = 0.0
    scale: Vec2 = (1.0, 1.0)
    tex_coord: Index | None = None


class TextureSource(Struct):
    """EXT_texture_webp, KHR_texture_basisu: another image in the place of `source`."""

    source: Index


class MetallicRoughness(Struct, rename="camel"):
    """pbrMetallicRoughness."""

    base_color_factor: Color4 = (1.0, 1.0, 1.0, 1.0)
    base_color_texture: TextureInfo | None = None
    metallic_factor: Share = 1.0
    roughness_factor: Share = 1.0
    metallic_roughness_texture: TextureInfo | None = None


class Material(Thing):
    """A surface, without its extensions."""

    pbr_metallic_roughness: MetallicRoughness = msgspec.field(default_factory=MetallicRoughness)
    normal_texture: TextureInfo | None = None
    emissive_texture: TextureInfo | None = None
    emissive_factor: Color = (0.0, 0.0, 0.0)
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False


class SpecularGlossiness(Struct, rename="camel"):
    """KHR_materials_pbrSpecularGlossiness."""

    diffuse_factor: Color4 = (1.0, 1.0, 1.0, 1.0)
    diffuse_texture: TextureInfo | None = None
    specular_factor: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)
    glossiness_factor: Share = 1.0
    specular_glossiness_texture: TextureInfo | None = None


class Clearcoat(Struct, rename="camel"):
    """KHR_materials_clearcoat."""

    clearcoat_factor: Share = 0.0
    clearcoat_texture: TextureInfo | None = None
    clearcoat_roughness_factor: Share = 0.0
    clearcoat_roughness_texture: TextureInfo | None = None
    clearcoat_normal_texture: TextureInfo | None = None


class Transmission(Struct, rename="camel"):
    """KHR_materials_transmission."""

    transmission_factor: Share = 0.0
    transmission_texture: TextureInfo | None = None


class DiffuseTransmission(Struct, rename="camel"):
    """KHR_materials_diffuse_transmission."""

    diffuse_transmission_factor: Share = 0.0
    diffuse_transmission_texture: TextureInfo | None = None
    diffuse_transmission_color_factor: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)
    diffuse_transmission_color_texture: TextureInfo | None = None


class Volume(Struct, rename="camel"):
    """KHR_materials_volume. attenuation_distance: None is infinite."""

    thickness_factor: NotNegative = 0.0
    attenuation_distance: Annotated[float, Meta(gt=0)] | None = None
    attenuation_color: tuple[Share, Share, Share] = (1.0, 1.0, 1.0)


class Ior(Struct):
    """KHR_materials_ior; 0 reflects everything."""

    ior: NotNegative = 1.5


class Specular(Struct, rename="camel"):
    """KHR_materials_specular."""

    specular_factor: Share = 1.0
    specular_texture: TextureInfo | None = None
    specular_color_factor: Color = (1.0, 1.0, 1.0)
    specular_color_texture: TextureInfo | None = None


class Sheen(Struct, rename="camel"):
    """KHR_materials_sheen."""

    sheen_color_factor: tuple[Share, Share, Share] = (0.0, 0.0, 0.0)
    sheen_color_texture: TextureInfo | None = None
    sheen_roughness_factor: Share = 0.0
    sheen_roughness_texture: TextureInfo | None = None


class Iridescence(Struct, rename="camel"):
    """KHR_materials_iridescence; thickness in nanometres."""

    iridescence_factor: Share = 0.0
    iridescence_texture: TextureInfo | None = None
    iridescence_ior: NotNegative = 1.3
    iridescence_thickness_minimum: NotNegative = 100.0
    iridescence_thickness_maximum: NotNegative = 400.0
    iridescence_thickness_texture: TextureInfo | None = None


class Anisotropy(Struct, rename="camel"):
    """KHR_materials_anisotropy; rotation in radians."""

    anisotropy_strength: Share = 0.0
    anisotropy_rotation: float = 0.0
    anisotropy_texture: TextureInfo | None = None


class EmissiveStrength(Struct, rename="camel"):
    """KHR_materials_emissive_strength."""

    emissive_strength: NotNegative = 1.0


class Dispersion(Struct):
    """KHR_materials_dispersion."""

    dispersion: float = 0.0


class VariantName(Thing):
    """The name is in Thing."""


class Variants(Struct):
    """KHR_materials_variants of the document."""

    variants: list[VariantName]


class Mapping(Struct):
    """The material that a primitive has in some variants."""

    material: Index
    variants: list[Index]


class Mappings(Struct):
    """KHR_materials_variants of a primitive."""

    mappings: list[Mapping]


# --- Meshes --------------------------------------------------------------------------------------


class Primitive(Thing):
    """A part of a mesh that has one material."""

    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: int = 4
    targets: list[dict[str, Index]] = []


class Mesh(Thing):
    """weights: of its primitives' morph targets."""

    primitives: list[Primitive]
    weights: list[float] = []


class Draco(Struct, rename="camel"):
    """KHR_draco_mesh_compression of a primitive. attributes: their ids in the compressed data."""

    buffer_view: Index
    attributes: dict[str, Index]


# --- The scene -----------------------------------------------------------------------------------


class Node(Thing):
    """A place in the tree. matrix: by columns, in the stead of the three others."""

    camera: Index | None = None
    children: list[Index] = []
    skin: Index | None = None
    matrix: Matrix | None = None
    mesh: Index | None = None
    rotation: Vec4 = (0.0, 0.0, 0.0, 1.0)
    scale: Vec3 = (1.0, 1.0, 1.0)
    translation: Vec3 = (0.0, 0.0, 0.0)
    weights: list[float] | None = None


class Instancing(Struct):
    """EXT_mesh_gpu_instancing of a node."""

    attributes: dict[str, Index]


class Visibility(Struct):
    """KHR_node_visibility."""

    visible: bool = True


class Skin(Thing):
    """Joints are nodes."""

    joints: list[Index]
    inverse_bind_matrices: Index | None = None


class SceneNodes(Thing):
    """The roots of what is seen."""

    nodes: list[Index] = []


class Perspective(Struct):
    """Angles in radians."""

    yfov: Annotated[float, Meta(gt=0, lt=pi)]
    aspectRatio: Annotated[float, Meta(gt=1e-3, lt=1e3)] | None = None


class Orthographic(Struct):
    """Half of the width and height of what is seen."""

    xmag: float
    ymag: float


class Camera(Thing):
    """One of the two is there."""

    type: str
    perspective: Perspective | None = None
    orthographic: Orthographic | None = None


class Spot(Struct, rename="camel"):
    """Angles from the axis, in radians."""

    inner_cone_angle: float = 0.0
    outer_cone_angle: float = pi / 4


class Light(Thing):
    """Of KHR_lights_punctual: intensity in candela, of a directional one in lux."""

    type: str
    color: Color = (1.0, 1.0, 1.0)
    intensity: NotNegative = 1.0
    spot: Spot = msgspec.field(default_factory=Spot)


class Lights(Struct):
    """KHR_lights_punctual of the document."""

    lights: list[Light]


class LightIndex(Struct):
    """KHR_lights_punctual of a node."""

    light: Index


class Target(Thing):
    """What a channel of an animation changes."""

    path: str
    node: Index | None = None


class Channel(Thing):
    """A sampler and what it changes."""

    sampler: Index
    target: Target


class AnimationSampler(Thing):
    """Accessors of times and of values."""

    input: Index
    output: Index
    interpolation: str = "LINEAR"


class Animation(Thing):
    """Some channels that belong together."""

    channels: list[Channel]
    samplers: list[AnimationSampler]


class Document(Thing):
    """A whole glTF file's JSON."""

    asset: Asset
    accessors: list[Accessor] = []
    animations: list[Animation] = []
    buffers: list[Buffer] = []
    buffer_views: list[BufferView] = []
    cameras: list[Camera] = []
    extensions_required: list[str] = []
    extensions_used: list[str] = []
    images: list[Image] = []
    materials: list[Material] = []
    meshes: list[Mesh] = []
    nodes: list[Node] = []
    samplers: list[Sampler] = []
    scene: Index | None = None
    scenes: list[SceneNodes] = []
    skins: list[Skin] = []
    textures: list[Texture] = []
