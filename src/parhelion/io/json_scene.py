"""Parhelion's own scene format, JSON; docs/scene.md is its manual.

A document has the fields of the dataclasses in parhelion.scene, under the same names. msgspec
decodes it into the structs below. What a type cannot say (which materials there are, how long
the arrays must be) is checked where the structs become a Scene. All errors raised below load()
and dumps() begin with a place in the document, such as "$.shapes[0].radii[17]"; those two put the
file's path in front.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from importlib import import_module
from itertools import chain, repeat
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from .. import scene as model
from .. import tables
from ..errors import FormatError, SceneError, unknown_name
from ..framing import placed
from ..tables import LARGEST
from . import LoadOptions

NAME = "Parhelion scene"
SUFFIXES = (".json",)

# Bytes of text, unpacked; larger arrays than fit in here belong in .npy files.
LARGEST_TEXT = 2**30

# Those of the LoadOptions that say how particles look; here they would go unread.
_PARTICLE_OPTIONS = ("color_by", "colormap", "color_range", "radius", "ground", "frame")

_UNPACKERS = {".gz": "gzip", ".bz2": "bz2", ".xz": "lzma"}

# ---------------------------------------------------------------------------------------------
# The document. Defaults are those of the dataclasses.

Number = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Meta(gt=0, le=LARGEST)]
NotNegative = Annotated[float, Meta(ge=0, le=LARGEST)]
Count = Annotated[int, Meta(ge=1, le=2**31 - 1)]
# the limits of renderer.merged()
Side = Annotated[int, Meta(ge=1, le=65536)]
Depth = Annotated[int, Meta(ge=1, le=2**20)]
FilterRadius = Annotated[float, Meta(gt=0, le=32)]
Place = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Angle = Annotated[float, Meta(gt=0, lt=180)]
Vec3 = tuple[Number, Number, Number]
Color = tuple[NotNegative, NotNegative, NotNegative]
Name = Annotated[str, Meta(max_length=1000)]
File = Annotated[str, Meta(extra_json_schema={"pattern": r"\.npy$"})]
# The rest of these is checked against the core's tables, and so is their part of the schema.
Material = Annotated[Any, Meta(extra_json_schema={"$ref": "#/$defs/Material"})]
InlineMaterial = Annotated[dict[str, Any], Meta(extra_json_schema={"$ref": "#/$defs/Material"})]
Background = Annotated[Any, Meta(extra_json_schema={"$ref": "#/$defs/Background"})]
Sampler = Annotated[str, Meta(extra_json_schema={"$ref": "#/$defs/Sampler"})]
Filter = Annotated[str, Meta(extra_json_schema={"$ref": "#/$defs/Filter"})]


def _doc(description: str, default: Any = None) -> Meta:
    """default: for the schema, of a field whose default msgspec has from a factory."""
    return Meta(
        description=description,
        extra_json_schema=None if default is None else {"default": default},
    )


class Camera(Struct, forbid_unknown_fields=True):
    """A pinhole or thin-lens camera."""

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
        Angle | None,
        _doc(
            "vertical field of view in degrees, from edge to edge of the picture; "
            "40 if neither fov nor vfov is given"
        ),
    ] = model.Camera.vfov
    aperture_radius: Annotated[
        NotNegative, _doc("radius of the thin lens in scene units; 0 is a pinhole")
    ] = model.Camera.aperture_radius
    focus_distance: Annotated[
        Positive | None,
        _doc("from the eye to the plane in focus, in scene units; null focuses on the target"),
    ] = model.Camera.focus_distance


class Spheres(Struct, forbid_unknown_fields=True):
    """N spheres as arrays."""

    # To become the tag of a union with the second shape; msgspec asks for no tag in a single
    # struct, and a document without it would then be read today and refused later.
    type: Annotated[Literal["spheres"], _doc("the kind of shape")]
    centers: Annotated[
        Annotated[list[Vec3], Meta(min_length=1)] | File,
        _doc("N positions, or the name of a .npy file with an array of shape (N, 3)"),
    ]
    radii: Annotated[
        Positive | list[Positive] | File,
        _doc("one radius for all, or N, or the name of a .npy file with an array of shape (N,)"),
    ] = 1.0
    material: Annotated[
        Name | list[Name] | InlineMaterial,
        _doc("the name of a material, N names, or a material itself", {"type": "diffuse"}),
    ] = msgspec.field(default_factory=lambda: {"type": "diffuse"})
    colors: Annotated[
        list[Color] | File | None,
        _doc(
            "N linear RGB colours that replace the material's own, or the name of a .npy file "
            "with an array of shape (N, 3)"
        ),
    ] = None
    name: Annotated[Name, _doc("what error texts call this shape")] = model.Spheres.name


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


class Document(Struct, forbid_unknown_fields=True):
    """A Parhelion scene."""

    parhelion: Annotated[Literal[1], _doc("version of the format")]
    schema_file: Annotated[str | None, _doc("where the JSON Schema is, for editors; not read")] = (
        msgspec.field(default=None, name="$schema")
    )
    name: Annotated[Name | None, _doc("what the scene is called; the file's name if not given")] = (
        None
    )
    camera: Annotated[Camera | None, _doc("null or not given: all shapes, seen from the front")] = (
        None
    )
    background: Annotated[
        Background, _doc("the light from outside the scene", {"type": "gradient"})
    ] = msgspec.field(default_factory=lambda: {"type": "gradient"})
    materials: Annotated[dict[str, Material], _doc("by name, for shapes to refer to")] = {}
    shapes: Annotated[list[Spheres], _doc("what there is to see")] = []
    settings: Annotated[Settings, _doc("what to render", {})] = msgspec.field(
        default_factory=Settings
    )


# ---------------------------------------------------------------------------------------------
# Reading


def load(path: Path, options: LoadOptions) -> model.Scene:
    """The scene of a JSON file, which may be packed with gzip, bzip2 or xz.

    Raises FormatError where the file is no valid scene, or an option is given: the options are
    for particle files. A file that cannot be opened is the caller's OSError.
    """
    unset = LoadOptions()
    given = [x for x in _PARTICLE_OPTIONS if getattr(options, x) != getattr(unset, x)]
    if given:
        raise FormatError(
            f"{path}: the option {given[0]!r} is for particle files; a scene states its own shapes"
        )
    try:
        scene = _scene(_text(path), path.parent)
    except SceneError as error:
        raise FormatError(f"{path}: {error}") from None
    except RecursionError:
        raise FormatError(f"{path}: is nested too deeply") from None
    return scene.replace(name=path.name.partition(".")[0]) if scene.name == "" else scene


def _text(path: Path) -> bytes:
    """The file's text, unpacked: proper UTF-8 without a byte order mark, and not empty."""
    if not path.is_file():
        raise SceneError("is not a regular file")
    if path.suffix.lower() in _UNPACKERS:
        unpacker = import_module(_UNPACKERS[path.suffix.lower()])
        try:
            with unpacker.open(path) as file:
                data: bytes = file.read(LARGEST_TEXT + 1)
        except OSError:
            raise
        except Exception as error:  # zlib.error, EOFError, LZMAError: each module has its own
            raise SceneError(f"cannot be unpacked: {error}") from None
        size = len(data)
    else:
        size = path.stat().st_size
        data = path.read_bytes() if size <= LARGEST_TEXT else b""
    if size > LARGEST_TEXT:
        raise SceneError(
            f"is longer than {LARGEST_TEXT >> 20} MiB; keep large arrays in .npy files"
        )
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise SceneError("is UTF-16 text; save it as UTF-8")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if not data or data.isspace():
        raise SceneError("is empty")
    if not data.isascii():
        try:
            data.decode()
        except UnicodeDecodeError as error:
            raise SceneError(f"{_position(data, error.start)}: is not UTF-8 text") from None
    return data


def _scene(data: bytes, folder: Path) -> model.Scene:
    """The scene that a text describes; its name is "" if the text gives none."""
    try:
        # Numbers too large for a float would be refused without a place where no type is known;
        # float() makes them infinite, and tables.check names them.
        document = msgspec.json.Decoder(Document, float_hook=float).decode(data)
    except msgspec.ValidationError as error:
        raise SceneError(_invalid(str(error), data)) from None
    except msgspec.DecodeError as error:
        raise SceneError(_malformed(str(error), data)) from None

    camera = None
    if document.camera is not None:
        if document.camera.fov is not None and document.camera.vfov is not None:
            raise SceneError("$.camera: has both 'fov' and 'vfov'; give one of them")
        camera = model.Camera(**msgspec.structs.asdict(document.camera))
    tables.entry("samplers", document.settings.sampler, "$.settings.sampler")
    tables.entry("filters", document.settings.filter, "$.settings.filter")
    materials = {
        name: _entry(model.Material, "materials", value, f"$.materials{_member(name)}")
        for name, value in document.materials.items()
    }
    scene = model.Scene(
        name=document.name or "",
        camera=camera,
        background=_entry(model.Background, "backgrounds", document.background, "$.background"),
        materials=materials,
        shapes=tuple(
            _spheres(block, materials, folder, f"$.shapes[{i}]")
            for i, block in enumerate(document.shapes)
        ),
        settings=model.Settings(**msgspec.structs.asdict(document.settings)),
    )
    _refuse_repeated_keys(data)
    return scene


_E = TypeVar("_E", model.Material, model.Background)


def _entry(make: type[_E], kind: str, value: Any, where: str) -> _E:
    """A material or background from its JSON object."""
    if not isinstance(value, dict):
        raise SceneError(f"{where}: must be an object with a 'type'")
    if "type" not in value:
        raise SceneError(f"{where}: the field 'type' is missing")
    params = {name: x for name, x in value.items() if name != "type"}
    checked = tables.check(kind, value["type"], params, where)
    return make(
        value["type"],
        **{name: x if len(x := checked[name]) > 1 else x[0] for name in params},
    )


def _spheres(
    block: Spheres, materials: Mapping[str, model.Material], folder: Path, where: str
) -> model.Spheres:
    centers = _array(block.centers, 3, -LARGEST, folder, f"{where}.centers")

    def one_each(what: str, given: int) -> None:
        if given != len(centers):
            raise SceneError(f"{where}.{what}: has {given} values for {len(centers)} centers")

    radii: float | NDArray[Any]
    if isinstance(block.radii, float):
        radii = block.radii
    else:
        # the smallest number above 0: a radius of 0 is refused
        radii = _array(block.radii, 1, 5e-324, folder, f"{where}.radii")
        one_each("radii", len(radii))

    material: str | model.Material | NDArray[np.int32]
    if isinstance(block.material, dict):
        material = _entry(model.Material, "materials", block.material, f"{where}.material")
    elif isinstance(block.material, str):
        material = block.material
        if material not in materials:
            raise SceneError(_no_material(material, materials, block.name, f"{where}.material"))
    else:
        one_each("material", len(block.material))
        number = {name: i for i, name in enumerate(materials)}
        material = np.fromiter(
            map(number.get, block.material, repeat(-1)), np.int32, len(block.material)
        )
        first = int(np.argmin(material))  # -1 where there is no such name
        if material[first] < 0:
            name, place = block.material[first], f"{where}.material[{first}]"
            raise SceneError(_no_material(name, materials, block.name, place))

    colors = None
    if block.colors is not None:
        colors = _array(block.colors, 3, 0.0, folder, f"{where}.colors")
        one_each("colors", len(colors))
    return model.Spheres(
        centers=centers, radii=radii, material=material, colors=colors, name=block.name
    )


def _no_material(name: str, materials: Iterable[str], shape: str, where: str) -> str:
    return f"{where}: shape {_clip(shape)!r}: {_unknown('material', name, materials)}"


# ---------------------------------------------------------------------------------------------
# Arrays


def _array(
    value: list[Any] | str, columns: int, low: float, folder: Path, where: str
) -> NDArray[Any]:
    """An array of shape (N,), or (N, columns) for more than one column; N >= 1.

    Numbers of the document come as float64 and are in range. A file's float32 or float64 stay
    what they are; each must lie in [low, LARGEST].
    """
    if isinstance(value, str):
        return _npy(value, columns, low, folder, where)
    if columns == 1:
        return np.fromiter(value, np.float64, len(value))
    flat = np.fromiter(chain.from_iterable(value), np.float64, len(value) * columns)
    return flat.reshape(-1, columns)


def _npy(name: str, columns: int, low: float, folder: Path, where: str) -> NDArray[Any]:
    shown = _clip(name)
    file = _inside(name, folder, where)
    try:
        # Mapping the file first checks its size against its header, before memory is asked for.
        # It is copied all the same: to write to a mapped file would end this process.
        array = np.lib.format.open_memmap(file, mode="r")
    except OSError as error:
        raise SceneError(f"{where}: {shown!r} cannot be read: {error.strerror or error}") from None
    except Exception as error:  # a broken header may raise nearly anything
        raise SceneError(f"{where}: {shown!r} is no valid .npy file: {error}") from None
    shape = (len(array), columns) if array.ndim and columns > 1 else array.shape[:1]
    if array.ndim == 0 or array.shape != shape:
        wanted = "(N,)" if columns == 1 else f"(N, {columns})"
        raise SceneError(f"{where}: {shown!r} has shape {array.shape}; must be {wanted}")
    if array.dtype.kind not in "fiu":
        raise SceneError(f"{where}: {shown!r} holds {array.dtype}; must be real numbers")
    if len(array) == 0:
        raise SceneError(f"{where}: {shown!r} is empty")
    single = array.dtype.kind == "f" and array.dtype.itemsize <= 4
    numbers = np.array(array, dtype=np.float32 if single else np.float64, order="C")
    for extreme in (numbers.argmin(), numbers.argmax()):  # both find a NaN if there is one
        number = float(numbers.flat[extreme])
        if not low <= number <= LARGEST:
            place = "".join(f"[{i}]" for i in np.unravel_index(extreme, numbers.shape))
            rule = "> 0" if low > 0 else f">= {low:g}"
            raise SceneError(
                f"{where}: {shown!r}: {place} is {number:g}; must be {rule} and <= {LARGEST:g}"
            )
    return numbers


def _inside(name: str, folder: Path, where: str) -> Path:
    """The file of that name, which must be in the scene's folder or one below it."""
    shown = _clip(name)
    if not name.endswith(".npy"):
        raise SceneError(f"{where}: is {shown!r}; must be an array or the name of a .npy file")
    parts = (*PurePosixPath(name).parts, *PureWindowsPath(name).parts)
    rooted = name.startswith("/") or PureWindowsPath(name).anchor
    try:
        root = folder.resolve()
        file = (root / name).resolve()
        if rooted or ".." in parts or not file.is_relative_to(root):
            raise SceneError(f"{where}: {shown!r} is not inside the scene's folder")
        if not file.is_file():
            raise SceneError(f"{where}: {shown!r}: no such file")
    except SceneError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # too long, a loop of links, a NUL
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{where}: {shown!r} cannot be read: {reason}") from None
    return file


# ---------------------------------------------------------------------------------------------
# Error texts

_WORDS = {
    "int": "an integer",
    "float": "a number",
    "str": "a string",
    "bool": "true or false",
    "null": "null",
    "array": "an array",
    "object": "an object",
}
_BLOCKS: dict[str, type[Struct]] = {
    "": Document,
    "camera": Camera,
    "settings": Settings,
    "shapes": Spheres,
}


def _invalid(text: str, data: bytes) -> str:
    """Our text for msgspec's "Expected `int`, got `str` - at `$.settings.width`"."""
    what, _, place = text.partition(" - at `")
    where = place.rstrip("`").partition("[...")[0] or "$"
    if "out of range" in what:
        return f"{where}: a number is too large"
    if match := re.fullmatch("Object contains unknown field `(.*)`", what, re.DOTALL):
        block = _BLOCKS[(re.findall(r"\w+", where) or [""])[0]]
        known = block.__struct_encode_fields__
        return f"{where}{_member(match[1])}: {_unknown('field', match[1], known)}"
    if match := re.fullmatch("Object missing required field `(.*)`", what):
        return f"{where}: the field {match[1]!r} is missing"
    try:
        value = msgspec.json.Decoder(float_hook=float).decode(data)
    except msgspec.ValidationError:  # an integer of more than 4300 digits
        return f"{where}: {what}"
    except msgspec.DecodeError as error:  # broken behind the value that is wrong
        return _malformed(str(error), data)
    for key, index in re.findall(r"\.([\w$]+)|\[(\d+)\]", where):
        value = value[key] if key else value[int(index)]
    shown = _clip(msgspec.json.encode(value).decode())
    if what.startswith("Invalid enum value"):
        if where == "$.parhelion":
            return f"{where}: is {shown}; this version of Parhelion reads format 1"
        return f"{where}: {_unknown('shape type', value, ['spheres'])}"
    wanted = re.sub(
        "`([a-z |]+)`",
        lambda match: " or ".join(_WORDS.get(word, word) for word in match[1].split(" | ")),
        what.partition(", got")[0].replace("Expected", "must be", 1),
    )
    return f"{where}: is {shown}; {wanted.removesuffix('.0')}"


def _malformed(text: str, data: bytes) -> str:
    """Our text for msgspec's "JSON is malformed: expected ':' (byte 12)"."""
    match = re.fullmatch(r"(?:JSON is malformed: )?(.*?)(?: \(byte (\d+)\))?", text, re.DOTALL)
    assert match is not None
    if match[2] is None:  # "Input data was truncated", at a half escape in a string too
        return f"{_position(data, len(data))}: the JSON text is not complete"
    byte = int(match[2]) - (match[1] == "trailing characters")  # one past the first of them
    if literal := re.match(rb"-?(?:nan|inf(?:inity)?)\b", data[byte : byte + 9], re.IGNORECASE):
        return f"{_position(data, byte)}: {literal[0].decode()} is no JSON number"
    return f"{_position(data, byte)}: {match[1]}"


def _position(data: bytes, byte: int) -> str:
    """Line and column, in characters, both from 1."""
    line = data.count(b"\n", 0, byte) + 1
    before = data[data.rfind(b"\n", 0, byte) + 1 : byte]
    return f"line {line}, column {len(before.decode(errors='replace')) + 1}"


def _member(name: str) -> str:
    """A key as the last step of a JSON path: ".steel" or "['old steel']"."""
    return f".{_clip(name)}" if re.fullmatch(r"\w+", name) else f"[{_clip(name)!r}]"


def _unknown(what: str, name: object, choices: Iterable[str]) -> str:
    """unknown_name() of bounded cost and length, whatever the file holds."""
    known = [_clip(choice) for choice in choices]
    if len(known) > 1000:
        return f"unknown {what} {_clip(str(name))!r}; none of the {len(known)} is called that"
    return unknown_name(what, name, known)


def _clip(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


# ---------------------------------------------------------------------------------------------
# Repeated keys

_ALL_BUT_BRACES = bytes(set(range(256)) - set(b"{}"))


def _refuse_repeated_keys(data: bytes) -> None:
    """JSON readers keep the last of two equal keys; here a material would be lost in silence.

    The text is known to be well formed. A Python loop over its keys only: what lies between two
    colons, long arrays included, is handled by the methods of bytes.
    """
    # Hide what would mislead a search for quotes. Control characters cannot be part of a string.
    text = data.replace(b"\\\\", b"\1\1").replace(b'\\"', b"\2\2")
    keys_of: list[set[bytes]] = []  # of every object that is open
    position = 0
    pending: list[bytes] = []
    quotes = 0
    *before_colons, _ = text.split(b":")
    for piece in before_colons:
        position += len(piece) + 1
        pending.append(piece)
        quotes += piece.count(b'"')
        if quotes % 2:  # a colon inside a string
            continue
        parts = b":".join(pending).split(b'"')
        pending.clear()
        for brace in b"".join(parts[::2]).translate(None, _ALL_BUT_BRACES):
            if brace == ord("{"):
                keys_of.append(set())
            else:
                keys_of.pop()
        end = text.rindex(b'"', 0, position)
        start = text.rindex(b'"', 0, end)
        key = msgspec.json.decode(data[start : end + 1])
        if key in keys_of[-1]:
            where = _position(data, start)
            raise SceneError(f"{where}: the key {_clip(key)!r} occurs twice in its object")
        keys_of[-1].add(key)


# ---------------------------------------------------------------------------------------------
# The schema


def schema() -> dict[str, Any]:
    """The format as JSON Schema, draft 2020-12; docs/scene.schema.json holds its text."""
    generated = msgspec.json.schema(Document)
    names = tables.tables()
    generated["$defs"] |= {
        "Material": {"anyOf": [_entry_schema(e) for e in names["materials"].values()]},
        "Background": {"anyOf": [_entry_schema(e) for e in names["backgrounds"].values()]},
        "Sampler": {"enum": list(names["samplers"])},
        "Filter": {"enum": list(names["filters"])},
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": NAME,
        **generated,
    }


def _entry_schema(entry: tables.Entry) -> dict[str, Any]:
    return {
        "description": entry.doc,
        "type": "object",
        "properties": {
            "type": {"const": entry.name},
            **{p.name: _param_schema(p) for p in entry.params},
        },
        "required": ["type"],
        "additionalProperties": False,
    }


def _param_schema(param: tables.Param) -> dict[str, Any]:
    number = {"type": "number", "minimum": max(param.low, -LARGEST)}
    number["maximum"] = min(param.high, LARGEST)
    if param.size == 1:
        return {"description": param.doc, **number, "default": param.default[0]}
    return {
        "description": param.doc,
        "type": "array",
        "items": number,
        "minItems": param.size,
        "maxItems": param.size,
        "default": list(param.default),
    }


# ---------------------------------------------------------------------------------------------
# Writing


def dumps(scene: model.Scene) -> bytes:
    """The text of a JSON file that loads as an equal scene, all arrays within it.

    Raises SceneError for a scene that the format cannot hold, or that load() would refuse.
    """

    def plain(value: Any) -> Any:
        if not hasattr(value, "tolist"):
            raise TypeError(f"{type(value).__name__} is not a number, text or array")
        return value.tolist()

    def entry(value: model.Material | model.Background) -> dict[str, Any]:
        return {"type": value.type, **value.params}

    def spheres(shape: model.Spheres) -> dict[str, Any]:
        block = members(shape)
        for name in ("centers", "radii", "colors"):
            if isinstance(block[name], str):  # load() would take it for a file's name
                raise SceneError(f"shape {shape.name!r}: {name} must be numbers")
        if isinstance(shape.material, model.Material):
            block["material"] = entry(shape.material)
        elif not isinstance(shape.material, str):
            names = np.array([*scene.materials], dtype=object)
            numbers = np.asarray(shape.material)
            if numbers.dtype.kind not in "iu" or np.any((numbers < 0) | (numbers >= len(names))):
                raise SceneError(
                    f"shape {shape.name!r}: material must be whole numbers below {len(names)}"
                )
            block["material"] = names[numbers]
        return {"type": "spheres", **block}

    def members(instance: Any) -> dict[str, Any]:
        return {f.name: getattr(instance, f.name) for f in fields(instance)}

    aspect = scene.settings.width / scene.settings.height
    document = {
        "parhelion": 1,
        "name": scene.name,
        "camera": None if scene.camera is None else members(placed(scene, aspect)),
        "background": entry(scene.background),
        "materials": {name: entry(m) for name, m in scene.materials.items()},
        "shapes": [spheres(shape) for shape in scene.shapes],
        "settings": members(scene.settings),
    }
    try:
        lines = [
            f'"{key}": {msgspec.json.encode(value, enc_hook=plain).decode()}'
            for key, value in document.items()
        ]
        text = ("{\n" + ",\n".join(lines) + "\n}\n").encode()
        _scene(text, Path())
    except (TypeError, ValueError, RecursionError) as error:
        hint = " (as NaN and infinity are written)" if "is null;" in str(error) else ""
        raise SceneError(f"scene {scene.name!r} cannot be written: {error}{hint}") from None
    return text
