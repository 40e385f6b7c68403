"""The parameters of a scene's materials and lights, to be read and changed by name.

What is changed are the records of flatten.py, so neither arrays nor trees are made again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from .. import tables
from ..errors import SceneError, unknown_name
from ..flatten import Flat
from ..renderer import Prepared
from ..scene import Instances, Light, Material, Scene, Texture
from ..tables import Entry, Param

KINDS = ("materials", "lights")

# What every material has, as scene.py says it
_OPACITY = Param(
    "opacity", 1, (1.0,), 0.0, 1.0, "1 where there is a surface, 0 where there is a hole"
)
_EMISSION = Param("emission", 3, (0.0, 0.0, 0.0), 0.0, 1e12, "radiance that its front gives off")
_WEIGHT = Param("weight", 1, (0.5,), 0.0, 1.0, "share of the second of the two")


class Parameters:
    """Those of one prepared scene, as they are and as they were given.

    core: the scene's in the core, which is changed with them. Rendering and changing must not
    overlap: Session sees to that.
    """

    def __init__(self, prepared: Prepared) -> None:
        parts = prepared.flat.parts
        self._given = {kind: list(parts[kind]) for kind in KINDS}
        self._now = {kind: list(parts[kind]) for kind in KINDS}
        self.core = prepared.core
        self._serial = 0  # counts changes; below, which was the last of each
        self._changed = {kind: [0] * len(parts[kind]) for kind in KINDS}
        self._entries = {kind: list(tables.tables()[kind].values()) for kind in KINDS}
        lights = _lights(prepared.scene)
        self._made_of: dict[str, Sequence[Material | Light]] = {
            "materials": prepared.flat.materials,
            "lights": lights,
        }
        named = [f"light {i + 1}" for i in range(len(prepared.scene.lights))]
        named = [*["background"] * (len(lights) - len(named)), *named]
        self.names = {"materials": prepared.flat.material_names, "lights": named}

    def listed(self, since: int = -1) -> dict[str, Any]:
        """By kind and index, of each material or light: name, type, parameters and their values.

        Everything in it is plain, as JSON has it; "fixed" is true of what a texture says. since:
        only those that were changed after the list that had this "serial".
        """
        told: dict[str, Any] = {"serial": self._serial}
        for kind in KINDS:
            told[kind] = {
                i: {
                    "name": self.names[kind][i],
                    "type": self._type(kind, record),
                    "params": self._described(kind, i, record),
                }
                for i, record in enumerate(self._now[kind])
                if self._changed[kind][i] > since
            }
        return told

    def change(self, kind: str, index: int, name: str, value: Any) -> None:
        """Gives one parameter another value: a number, `size` numbers, or a word.

        Raises SceneError, and changes nothing, for one that is unknown, that a texture says, or a
        value without meaning.
        """
        if kind not in KINDS:
            raise SceneError(unknown_name("kind", kind, KINDS))
        if not 0 <= index < len(self._now[kind]):
            raise SceneError(f"{kind}[{index}]: there are {len(self._now[kind])}")
        where = f"{kind[:-1]} {self.names[kind][index]!r}"
        record = dict(self._now[kind][index])
        places = self._places(kind, index, record)
        if name not in places:
            raise SceneError(f"{where}: {unknown_name('parameter', name, places)}")
        param, key, offset = places[name]
        if self._is_fixed(kind, index, name):
            raise SceneError(f"{where}: parameter {name!r} is a texture's")
        values = list(tables.values_of(param, value, where))
        if key == "block":
            number, block = record["block"]
            record["block"] = number, [*block[:offset], *values, *block[offset + param.size :]]
        else:
            record[key] = values[0] if param.size == 1 else tuple(values)
        changed = list(self._now[kind])
        changed[index] = record
        if name == "anisotropy":  # directions on a surface now matter; blends and backs ask it too
            changed = [{**r, "uses_uv": True} for r in changed]
        if name in ("up", "direction", "sun_direction") and not any(values):
            raise SceneError(f"{where}: parameter {name!r} is 0; it must have a direction")
        self._apply(kind, changed)
        self._note(kind, [index])

    def _note(self, kind: str, indices: Iterable[int]) -> None:
        self._serial += 1
        for i in indices:
            self._changed[kind][i] = self._serial

    def restore(self) -> None:
        """Everything as it was given."""
        for kind in KINDS:
            pairs = enumerate(zip(self._now[kind], self._given[kind], strict=True))
            other = [i for i, (now, given) in pairs if now is not given]
            if other:
                self._apply(kind, list(self._given[kind]))
                self._note(kind, other)

    def flat(self, flat: Flat) -> Flat:
        """The same shapes with the materials and lights as they are now."""
        return replace(flat, parts={**flat.parts, **{k: list(self._now[k]) for k in KINDS}})

    def changes(self) -> list[tuple[str, int, str, Any]]:
        """What differs from what was given, as arguments of change()."""
        found: list[tuple[str, int, str, Any]] = []
        for kind in KINDS:
            for i, (now, given) in enumerate(zip(self._now[kind], self._given[kind], strict=True)):
                if now is given:
                    continue
                before = {p["name"]: p["value"] for p in self._described(kind, i, given)}
                for p in self._described(kind, i, now):
                    if p["value"] != before[p["name"]]:
                        found.append((kind, i, p["name"], p["value"]))
        return found

    def _apply(self, kind: str, records: list[dict[str, Any]]) -> None:
        (self.core.set_materials if kind == "materials" else self.core.set_lights)(records)
        self._now[kind] = records

    def _type(self, kind: str, record: Mapping[str, Any]) -> str:
        if "blend_first" in record:
            return "blend"
        entry: Entry = self._entries[kind][record["block"][0]]
        return entry.name

    def _places(
        self, kind: str, index: int, record: Mapping[str, Any]
    ) -> dict[str, tuple[Param, str, int]]:
        """Where each parameter lies: in a record's entry, from an offset."""
        places: dict[str, tuple[Param, str, int]] = {}
        entry: Entry = self._entries[kind][record["block"][0]]
        if "blend_first" in record:
            places["weight"] = (_WEIGHT, "blend_weight", 0)
        else:
            offset = 0
            for param in entry.params:
                if (entry.name, param.name) != ("attribute", "name"):
                    places[param.name] = (param, "block", offset)
                offset += param.size
        if kind == "materials":
            # what is dark now and shone at first may shine again; nothing else may begin to
            if "emission" in self._made_of[kind][index].params and any(
                self._given[kind][index]["emission"]
            ):
                places["emission"] = (_EMISSION, "emission", 0)
            places["opacity"] = (_OPACITY, "opacity", 0)
        return places

    def _is_fixed(self, kind: str, index: int, name: str) -> bool:
        """Whether a texture says a parameter's numbers."""
        return isinstance(self._made_of[kind][index].params.get(name), Texture)

    def _described(self, kind: str, index: int, record: Mapping[str, Any]) -> list[dict[str, Any]]:
        described = []
        for param, key, offset in self._places(kind, index, record).values():
            stored = record["block"][1][offset:] if key == "block" else record[key]
            values = list(stored)[: param.size] if hasattr(stored, "__len__") else [stored]
            value: Any = values[0] if param.size == 1 else [float(x) for x in values]
            if param.choices:
                value = param.choices[int(values[0])]
            described.append(
                {
                    "name": param.name,
                    "doc": param.doc,
                    "size": param.size,
                    "low": _finite(param.low),
                    "high": _finite(param.high),
                    "choices": list(param.choices),
                    "value": value,
                    "fixed": self._is_fixed(kind, index, param.name),
                }
            )
        return described


def changed(prepared: Prepared, changes: Iterable[tuple[str, int, str, Any]]) -> Scene:
    """The scene with other values for parameters; changes: as Parameters.changes() has them."""
    scene, flat = prepared.scene, prepared.flat
    new: dict[tuple[str, int], dict[str, Any]] = defaultdict(dict)
    for kind, index, name, value in changes:
        new[kind, index][name] = value
    named = len(scene.materials)
    unnamed = {m: i for i, m in enumerate(flat.materials) if i >= named}

    def material(given: Material, index: int | None = None) -> Material:
        parts = {k: material(v) if isinstance(v, Material) else v for k, v in given.params.items()}
        own = new.get(("materials", unnamed[given] if index is None else index), {})
        return Material(given.type, **{**parts, **own})

    groups: dict[int, list[Any]] = {}  # what Instances share they share again

    def shape(given: Any) -> Any:
        if isinstance(given, Instances):
            if id(given.shapes) not in groups:
                groups[id(given.shapes)] = [shape(s) for s in given.shapes]
            return replace(given, shapes=groups[id(given.shapes)])
        if isinstance(given.material, Material):
            return replace(given, material=material(given.material))
        return given

    lights = [
        type(light)(light.type, **{**light.params, **new.get(("lights", i), {})})
        for i, light in enumerate(_lights(scene))
    ]
    background = None if scene.background is None else lights.pop(0)
    return scene.replace(
        shapes=[shape(s) for s in scene.shapes],
        materials={k: material(m, i) for i, (k, m) in enumerate(scene.materials.items())},
        background=background,
        lights=lights,
    )


def _lights(scene: Scene) -> list[Light]:
    """The lights, the background first, by the indices that they have as records."""
    return [*([] if scene.background is None else [scene.background]), *scene.lights]


def _finite(x: float) -> float | None:
    return x if abs(x) < tables.LARGEST else None
