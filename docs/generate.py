"""Writes the parts of the documentation that are made from the program's own tables.

    python docs/generate.py

makes docs/scene.schema.json, and the tables between the `<!-- generated -->` marks of
docs/scene.md. A test fails where the files are not what this writes.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from parhelion import tables
from parhelion.io import json_scene

DOCS = Path(__file__).parent


def outputs() -> dict[Path, str]:
    """The text of every generated file."""
    schema = json_scene.schema()
    manual = (DOCS / "scene.md").read_text(encoding="utf-8")
    definitions = schema["$defs"]
    for mark, table in {
        **{name: _fields(definitions[name]) for name in ("Document", *_SECTIONS)},
        **{kind: _entries(kind) for kind in ("materials", "textures", "lights")},
        "Blend": _fields(_blend(definitions)),
        "projections": ", ".join(f"`{name}`" for name in definitions["Projection"]["enum"]) + "\n",
        "backgrounds": ", ".join(f"`{name}`" for name in tables.tables()["backgrounds"]) + "\n",
        "samplers": _names("samplers"),
        "filters": _names("filters"),
    }.items():
        start, end = f"<!-- generated: {mark} -->\n", "<!-- end -->"
        pattern = f"{re.escape(start)}.*?{end}"
        if len(re.findall(pattern, manual, re.DOTALL)) != 1:
            raise ValueError(f"docs/scene.md must have one part between {start!r} and {end!r}")
        text = f"{start}{table}{end}"
        manual = re.sub(pattern, lambda _, text=text: text, manual, flags=re.DOTALL)
    return {
        DOCS / "scene.schema.json": json.dumps(schema, indent=2) + "\n",
        DOCS / "scene.md": manual,
    }


# definitions of the schema whose fields are a table of the manual -> the anchor of their section
_SECTIONS = {
    "Camera": "camera",
    "Spheres": "spheres",
    "Mesh": "mesh",
    "Disks": "disks",
    "Cylinders": "cylinders",
    "Curves": "curves",
    "Instances": "instances",
    "CommonMaterial": "materials",
    "ImageTexture": "textures",
    "ImageLight": "lights",
    "Pixels": "pixels",
    "Arrays": "large-arrays",
    "Stored": "large-arrays",
    "Framing": "camera",
    "Settings": "settings",
    "Legend": "legend",
}
_ANCHORS = {
    **_SECTIONS,
    "Material": "materials",
    "Texture": "textures",
    "Light": "lights",
    "Background": "backgrounds",
    "Attribute": "mesh",
    "Projection": "camera",
    "Sampler": "samplers",
    "Filter": "filters",
}


def _blend(definitions: dict[str, Any]) -> dict[str, Any]:
    """The blend of two materials, its own fields only."""
    (block,) = (
        m
        for m in definitions["Material"]["anyOf"]
        if m["properties"]["type"].get("const") == "blend"
    )
    own = {k: v for k, v in block["properties"].items() if "description" in v}
    return {"properties": own, "required": block["required"]}


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line).replace("\n", " ") + " |\n" for line in lines)


def _fields(block: dict[str, Any]) -> str:
    rows = []
    for name, field in block["properties"].items():
        needed = name in block.get("required", ()) and "default" not in field
        default = f"`{json.dumps(field['default'])}`" if "default" in field else ""
        if needed:
            default = "required"
        rows.append([f"`{name}`", _values(field), default, field.get("description", "")])
    return _table(["field", "values", "default", "meaning"], rows)


def _values(schema: dict[str, Any]) -> str:
    """What a schema allows, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name.lower()}](#{_ANCHORS[name]})"
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(map(_values, schema["anyOf"])))
    if "enum" in schema:
        return " or ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    kind = schema["type"]
    if "prefixItems" in schema:
        each = [_values(item) for item in schema["prefixItems"]]
        return f"[{', '.join(each)}]"
    if kind == "array":
        least, most = schema.get("minItems", 0), schema.get("maxItems")
        count = "" if most is None else f"{most} " if least == most else f"{least} to {most} "
        return f"array of {count}{_values(schema['items'])}"
    if kind == "object":
        return f"object of {_values(schema['additionalProperties'])} by name"
    if kind == "string":
        return _TEXTS[schema.get("pattern", "")]
    limits = []
    for key, sign in _SIGNS.items():
        # the limits of single and of 32- and 64-bit numbers are told in the text
        if key in schema and abs(schema[key]) < 2**31 - 1:
            limits.append(f"{sign} {schema[key]:g}")
    return " ".join([kind, ", ".join(limits)]).strip()


# what texts of a pattern are
_TEXTS = {
    "": "text",
    "^[0-9a-f]{64}$": "64 digits",
    r"\.npy$": "name of a `.npy` file",
    r"^smooth$|^flat$|\.npy$": '`"smooth"` or `"flat"` or name of a `.npy` file',
    r"\.(obj|ply|serialized)$": "name of a mesh file",
}

_SIGNS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}


def _entries(kind: str) -> str:
    rows = []
    for entry in tables.tables()[kind].values():
        for i, param in enumerate(entry.params):
            rows.append(
                [
                    f"`{entry.name}`" if i == 0 else "",
                    entry.doc if i == 0 else "",
                    f"`{param.name}`",
                    *_range(entry, param),
                    param.doc,
                ]
            )
        if entry.image:
            rows.append(["", "", "`image`", "image", "", "required", "the pixels"])
        elif not entry.params:
            rows.append([f"`{entry.name}`", entry.doc, "", "", "", "", ""])
    return _table(["type", "", "parameter", "values", "range", "default", "meaning"], rows)


def _range(entry: tables.Entry, param: tables.Param) -> list[str]:
    """Three cells: what values there are, their range, and the default."""
    if entry.name == "attribute":  # the core knows attributes by number, users by name
        return ["text", "", "required"]
    if param.choices:
        words = " or ".join(f'`"{word}"`' for word in param.choices)
        return [words, "", f'`"{param.choices[int(param.default[0])]}"`']
    default = list(param.default) if param.size > 1 else param.default[0]
    return [
        "number" if param.size == 1 else f"{param.size} numbers",
        f"{param.low:g} to {param.high:g}",
        f"`{json.dumps(default)}`",
    ]


def _names(kind: str) -> str:
    entries = tables.tables()[kind].values()
    if any(entry.radius is not None for entry in entries):
        rows = [[f"`{e.name}`", f"{e.radius:g}", e.doc] for e in entries]
        return _table(["name", "radius in pixels", ""], rows)
    return _table(["name", ""], [[f"`{e.name}`", e.doc] for e in entries])


if __name__ == "__main__":
    for path, text in outputs().items():
        path.write_text(text, encoding="utf-8")
