"""Materials, textures and lights: what the core's tables list, and what all of them share."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from msgspec import Struct

from ... import scene as model
from ... import tables
from ...errors import SceneError
from .document import (
    Blend,
    CommonLight,
    CommonMaterial,
    CommonTexture,
    ImageLight,
    ImageTexture,
)
from .files import Folders
from .messages import convert, unknown_choice

# what a light or texture has besides its own parameters, by whether it has an image
COMMON: dict[str, tuple[type[Struct], type[Struct]]] = {
    "textures": (CommonTexture, ImageTexture),
    "lights": (CommonLight, ImageLight),
    "backgrounds": (CommonLight, ImageLight),
}


class Entries:
    """Reads the entries of one document, which has materials of these names."""

    def __init__(self, names: Mapping[str, Any], folders: Folders) -> None:
        self.names = names
        self.folders = folders

    def material(self, value: Any, where: str) -> model.Material:
        """A material from its JSON object."""
        kind, params = _typed(value, where)
        blend = kind == "blend"
        listed = () if blend else tables.entry("materials", kind, where).params
        blocks: tuple[type[Struct], ...] = (CommonMaterial, Blend) if blend else (CommonMaterial,)
        known = [p.name for p in listed] + [name for b in blocks for name in b.__struct_fields__]
        _refuse_unknown(params, known, where)
        textures = {
            p.name for p in listed if isinstance(params.get(p.name), dict) and not p.choices
        }
        made: dict[str, Any] = {n: self.texture(params[n], f"{where}.{n}") for n in textures}
        if not blend:
            own = {p.name for p in listed if p.name in params} - textures
            made |= _checked("materials", kind, {n: params[n] for n in own}, where)
        for block in blocks:
            given = {n: params[n] for n in block.__struct_fields__ if n in params}
            found = convert(given, block, where)
            made |= {n: self._shared(n, getattr(found, n), f"{where}.{n}") for n in given}
        return model.Material(kind, **{name: made[name] for name in params})

    def _shared(self, name: str, value: Any, where: str) -> Any:
        if name in ("a", "b", "back") and isinstance(value, str):
            if value not in self.names:
                raise SceneError(f"{where}: {unknown_choice('material', value, self.names)}")
            return value
        if isinstance(value, dict):
            make = self.material if name in ("a", "b", "back") else self.texture
            return make(value, where)
        return tuple(value) if isinstance(value, list) else value

    def texture(self, value: Any, where: str) -> model.Texture:
        """A texture from its JSON object."""
        kind, params = _typed(value, where)
        name = params.pop("name", None) if kind == "attribute" else None
        made = self._with_common("textures", kind, params, where)
        if kind == "attribute":
            if not isinstance(name, str):
                raise SceneError(f"{where}: the field 'name', the attribute's, is missing")
            made["name"] = name
        return model.Texture(kind, **made)

    def light(self, value: Any, where: str) -> model.Light:
        """A light from its JSON object."""
        kind, params = _typed(value, where)
        return model.Light(kind, **self._with_common("lights", kind, params, where))

    def background(self, value: Any, where: str) -> model.Background | None:
        """A background from its JSON object; None for null."""
        if value is None:
            return None
        kind, params = _typed(value, where)
        return model.Background(kind, **self._with_common("backgrounds", kind, params, where))

    def _with_common(
        self, table: str, kind: str, params: dict[str, Any], where: str
    ) -> dict[str, Any]:
        entry = tables.entry(table, kind, where)
        block = COMMON[table][entry.image]
        known = {p.name for p in entry.params} | {*block.__struct_fields__}
        _refuse_unknown(params, known, where)
        shared = {n: x for n, x in params.items() if n in block.__struct_fields__}
        nested = {
            p.name: self.texture(params[p.name], f"{where}.{p.name}")
            for p in entry.params
            if table == "textures" and isinstance(params.get(p.name), dict) and not p.choices
        }
        plain = {n: x for n, x in params.items() if n not in shared and n not in nested}
        made = _checked(table, kind, plain, where) | nested
        found = convert(shared, block, where)
        if entry.image and "image" not in shared:
            raise SceneError(f"{where}: the field 'image' is missing")
        for name in shared:
            x = getattr(found, name)
            if name == "image":
                x = self.folders.image(x, f"{where}.image")
            elif name == "transform" and x is not None:
                sizes = {(len(x), len(row)) for row in x}
                if sizes not in ({(2, 3)}, {(3, 3)}, {(3, 4)}, {(4, 4)}):
                    raise SceneError(f"{where}.transform: has rows that make no matrix")
            made[name] = x
        return made


def _typed(value: Any, where: str) -> tuple[str, dict[str, Any]]:
    """The type of an entry, and its other fields."""
    if not isinstance(value, dict):
        raise SceneError(f"{where}: must be an object with a 'type'")
    if "type" not in value:
        raise SceneError(f"{where}: the field 'type' is missing")
    return value["type"], {name: x for name, x in value.items() if name != "type"}


def _refuse_unknown(params: Iterable[str], known: Collection[str], where: str) -> None:
    for name in params:
        if name not in known:
            raise SceneError(f"{where}: {unknown_choice('parameter', name, known)}")


def _checked(table: str, kind: str, params: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The parameters of the type's own, as they are given, each in its range."""
    checked = tables.check(table, kind, params, where)
    choices = {p.name for p in tables.entry(table, kind).params if p.choices}
    made: dict[str, Any] = {}
    for name, value in params.items():
        x = checked[name]
        made[name] = value if name in choices else x if len(x) > 1 else x[0]
    return made
