"""Error texts: where in the document, what is there, what should be."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from math import isfinite
from typing import Any, Literal, get_args, get_origin

import msgspec
from msgspec import Struct

from ...errors import SceneError, unknown_name
from .document import SHAPES, Arrays, Camera, Framing, Legend, Pixels, Settings, Stored

_WORDS = {
    "int": "an integer",
    "float": "a number",
    "str": "a string",
    "bool": "true or false",
    "bytes": "a string",
    "null": "null",
    "array": "an array",
    "object": "an object",
}
# objects by the name of the field that holds them; a shape tells its own type
_BLOCKS: dict[str, type[Struct]] = {
    **{f.name: Stored for shape in SHAPES.values() for f in msgspec.structs.fields(shape)},
    "arrays": Arrays,
    "camera": Camera,
    "framing": Framing,
    "settings": Settings,
    "legend": Legend,
    "image": Pixels,
}


def convert(value: Any, kind: Any, where: str) -> Any:
    """A value of the document as a struct, or what else msgspec knows. Raises SceneError."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        block = kind if isinstance(kind, type) and issubclass(kind, Struct) else Stored
        raise SceneError(invalid(str(error), lambda: value, where, block)) from None


def invalid(text: str, read: Callable[[], Any], start: str, block: type[Struct]) -> str:
    """Our text for msgspec's "Expected `int`, got `str` - at `$.settings.width`".

    read: gives what was to become a `block`; its own place in the document is `start`.
    """
    what, _, place = text.partition(" - at `")
    path = place.rstrip("`").partition("[...")[0].removeprefix("$")
    where = start + path
    if "out of range" in what:
        return f"{where}: a number is too large"
    if match := re.fullmatch("Object missing required field `(.*)`", what):
        return f"{where}: the field {match[1]!r} is missing"
    unknown = re.fullmatch("Object contains unknown field `(.*)`", what, re.DOTALL)
    value, key = None, ""
    if path or not unknown:
        try:
            value = read()
        except msgspec.ValidationError:  # an integer of more than 4300 digits
            return f"{where}: {what}"
        for name, index in re.findall(r"\.([\w$]+)|\[(\d+)\]", path):
            key = name
            value = value[name] if name else value[int(index)]
            if isinstance(value, dict):
                tag = value.get("type") if index else None
                block = SHAPES.get(str(tag)) or _BLOCKS.get(name, block)
    if unknown:
        known = [*(["type"] if block.__struct_config__.tag else []), *_fields(block)]
        return f"{where}{member(unknown[1])}: {unknown_choice('field', unknown[1], known)}"
    if what.startswith("Invalid value"):
        inner = path.count(".shapes") > 1
        choices = [name for name in SHAPES if not (inner and name == "instances")]
        return f"{where}: {unknown_choice('shape type', value, choices)}"
    if isinstance(value, float) and not isfinite(value):
        return f"{where}: a number is too large"
    if "base64" in what:
        return f"{where}: is no base64 text"
    shown = clip(msgspec.json.encode(value).decode())
    if allowed := _flag_or_word(_fields(block).get(key)):
        return f"{where}: is {shown}; must be {allowed}"
    if what.startswith("Invalid enum value"):
        if where == "$.parhelion":
            return f"{where}: is {shown}; this version of Parhelion reads format 1"
        words = get_args(get_args(_fields(block)[key])[0])  # Annotated[Literal[...], ...]
        return f"{where}: {unknown_choice(key, value, words)}"
    wanted = re.sub(
        "`([a-z |]+)`",
        lambda match: " or ".join(dict.fromkeys(_WORDS.get(w, w) for w in match[1].split(" | "))),
        what.partition(", got")[0].replace("Expected", "must be", 1),
    )
    return f"{where}: is {shown}; {wanted.removesuffix('.0')}"


def _fields(block: type[Struct]) -> dict[str, Any]:
    """The fields' names in a document, and their types."""
    return {f.encode_name: f.type for f in msgspec.structs.fields(block)}


def _flag_or_word(field: Any) -> str | None:
    """What a field may be that is a boolean or one of some words; None for any other field."""
    kinds = get_args(get_args(field)[0]) if get_args(field) else ()  # of an Annotated
    words = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
    if bool not in kinds or not words:
        return None
    return " or ".join(["true, false", *(f'"{word}"' for word in words)])


def malformed(text: str, data: bytes) -> str:
    """Our text for msgspec's "JSON is malformed: expected ':' (byte 12)"."""
    match = re.fullmatch(r"(?:JSON is malformed: )?(.*?)(?: \(byte (\d+)\))?", text, re.DOTALL)
    assert match is not None
    if match[2] is None:  # "Input data was truncated", at a half escape in a string too
        return f"{position(data, len(data))}: the JSON text is not complete"
    byte = int(match[2]) - (match[1] == "trailing characters")  # one past the first of them
    if literal := re.match(rb"-?(?:nan|inf(?:inity)?)\b", data[byte : byte + 9], re.IGNORECASE):
        return f"{position(data, byte)}: {literal[0].decode()} is no JSON number"
    return f"{position(data, byte)}: {match[1]}"


def position(data: bytes, byte: int) -> str:
    """Line and column, in characters, both from 1."""
    line = data.count(b"\n", 0, byte) + 1
    before = data[data.rfind(b"\n", 0, byte) + 1 : byte]
    return f"line {line}, column {len(before.decode(errors='replace')) + 1}"


def member(name: str) -> str:
    """A key as the last step of a JSON path: ".steel" or "['old steel']"."""
    return f".{clip(name)}" if re.fullmatch(r"\w+", name) else f"[{clip(name)!r}]"


def unknown_choice(what: str, name: object, choices: Iterable[str]) -> str:
    """unknown_name() of bounded cost and length, whatever the file holds."""
    known = [clip(choice) for choice in choices]
    if len(known) > 1000:
        return f"unknown {what} {clip(str(name))!r}; none of the {len(known)} is called that"
    return unknown_name(what, name, known)


def clip(text: str) -> str:
    """At most 60 characters of a text."""
    return text if len(text) <= 60 else text[:57] + "..."
