"""The format as JSON Schema."""

from __future__ import annotations

from typing import Any

import msgspec

from ... import tables
from ...tables import LARGEST
from .document import SHAPES, Blend, CommonMaterial, CommonTexture, Document
from .entries import COMMON
from .reading import projections
from .shapes import VALUES

Schema = dict[str, Any]


def schema() -> Schema:
    """JSON Schema, draft 2020-12; docs/scene.schema.json holds its text."""
    shared = {block.__name__: block for pair in COMMON.values() for block in pair}
    (document, *_, blend, values), definitions = msgspec.json.schema_components(
        [Document, *shared.values(), CommonMaterial, Blend, VALUES],
        ref_template="#/$defs/{name}",
    )
    names = tables.tables()
    common = [_entry(e, CommonMaterial, definitions) for e in names["materials"].values()]
    blend = definitions.pop("Blend")
    blend["properties"] = {
        "type": {"const": "blend"},
        **blend["properties"],
        **_references(CommonMaterial, definitions),
    }
    blend["required"] = ["type", *blend["required"]]
    for shape in SHAPES.values():
        definitions[shape.__name__]["properties"]["type"]["description"] = "the kind of shape"
    definitions["Mesh"]["oneOf"] = [
        {"required": ["vertices", "faces"], "properties": {"file": {"type": "null"}}},
        {
            "required": ["file"],
            "properties": {"file": {"type": "string"}, "vertices": False, "faces": False},
        },
    ]
    definitions["Pixels"]["oneOf"] = [
        {
            "required": [given],
            "properties": {given: {"not": {"type": "null"}}, other: {"type": "null"}},
        }
        for given, other in (("data", "at"), ("at", "data"))
    ]
    definitions["Legend"]["oneOf"] = [
        {"required": ["kinds"], "properties": dict.fromkeys(("colormap", "low", "high"), False)},
        {"required": ["colormap", "low", "high"], "properties": {"kinds": False}},
    ]
    definitions |= {"Material": {"anyOf": [*common, blend]}}
    for name, kind in (("Texture", "textures"), ("Light", "lights"), ("Background", "backgrounds")):
        listed = [_entry(e, COMMON[kind][e.image], definitions) for e in names[kind].values()]
        definitions[name] = {"anyOf": listed}
    definitions |= {
        "Attribute": values,
        "Projection": {"enum": projections()},
        "Sampler": {"enum": list(names["samplers"])},
        "Filter": {"enum": list(names["filters"])},
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Parhelion scene",
        **document,
        "$defs": definitions,
    }


def _references(block: type[msgspec.Struct], definitions: Schema) -> Schema:
    """The fields of a shared block, by reference."""
    name = block.__name__
    return {
        field: {"$ref": f"#/$defs/{name}/properties/{field}"}
        for field in definitions[name]["properties"]
    }


def _entry(entry: tables.Entry, block: type[msgspec.Struct], definitions: Schema) -> Schema:
    textured = block is CommonMaterial or issubclass(block, CommonTexture)
    own = {p.name: _param(p, textured) for p in entry.params}
    required = ["type"]
    if entry.image:
        required.append("image")
    if entry.name == "attribute":  # the core knows attributes by number, users by name
        own["name"] = {"description": own["name"]["description"], "type": "string"}
        required.append("name")
    return {
        "description": entry.doc,
        "type": "object",
        "properties": {
            "type": {"const": entry.name},
            **own,
            **_references(block, definitions),
        },
        "required": required,
        "additionalProperties": False,
    }


def _param(param: tables.Param, textured: bool) -> Schema:
    if param.choices:
        preset = param.choices[int(param.default[0])]
        return {"description": param.doc, "enum": list(param.choices), "default": preset}
    number = {
        "type": "number",
        "minimum": max(param.low, -LARGEST),
        "maximum": min(param.high, LARGEST),
    }
    value: Schema = number
    default: Any = param.default[0]
    if param.size > 1:
        value = {
            "type": "array",
            "items": number,
            "minItems": param.size,
            "maxItems": param.size,
        }
        default = list(param.default)
    if textured:
        value = {"anyOf": [value, {"$ref": "#/$defs/Texture"}]}
    return {"description": param.doc, **value, "default": default}
