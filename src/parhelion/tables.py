"""What the core can do, by name: its materials, textures, lights, samplers and filters.

The lists are written once, in the core's .def files; everything here is read from there.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import inf, isfinite
from numbers import Real
from typing import Any

from .errors import SceneError, unknown_name

# The largest number of the core's arithmetic, IEEE 754 single precision.
LARGEST = 3.4028234e38

# kind of table -> what error texts call one of its entries
_NOUNS = {
    "materials": "material type",
    "textures": "texture type",
    "lights": "light type",
    "backgrounds": "background type",
    "samplers": "sampler",
    "filters": "filter",
}


@dataclass(frozen=True)
class Param:
    """A parameter: `size` numbers, each within [low, high]; high may be infinite."""

    name: str
    size: int
    default: tuple[float, ...]
    low: float
    high: float
    doc: str
    choices: tuple[str, ...] = ()  # words that stand for 0, 1, ...

    def range(self) -> str:
        """The allowed values in words: "must lie in [0, 1]", "must be >= 0" or "must be finite"."""
        if self.low > -inf and self.high < inf:
            return f"must lie in [{self.low:g}, {self.high:g}]"
        if self.low > -inf:
            return f"must be >= {self.low:g}"
        return f"must be <= {self.high:g}" if self.high < inf else "must be finite"


@dataclass(frozen=True)
class Entry:
    """One line of a .def file.

    radius: a filter's own, in pixels; None for everything else. image: a texture or light that has
    an image. outside: a light from infinitely far away. transmits: a material that lets light
    through.
    """

    name: str
    doc: str
    params: tuple[Param, ...] = ()
    radius: float | None = None
    image: bool = False
    outside: bool = False
    transmits: bool = False


@cache
def tables() -> Mapping[str, Mapping[str, Entry]]:
    """All entries by kind ("materials", "textures", "lights", "samplers", "filters"), then by name.

    "backgrounds" are the lights from outside.
    """
    from . import _core

    listed = _core.tables()
    listed["backgrounds"] = [row for row in listed["lights"] if row["outside"]]
    return {kind: {row["name"]: _entry(row) for row in listed[kind]} for kind in _NOUNS}


def _entry(row: Mapping[str, Any]) -> Entry:
    radius = row.get("radius")
    return Entry(
        name=row["name"],
        doc=row["doc"],
        params=tuple(_param(p) for p in row.get("params", ())),
        radius=None if radius is None else _decimal(radius),
        image=row.get("image", False),
        outside=row.get("outside", False),
        transmits=row.get("transmits", False),
    )


def _param(row: Mapping[str, Any]) -> Param:
    default = row["default"]
    return Param(
        name=row["name"],
        size=row["size"],
        default=tuple(map(_decimal, default if hasattr(default, "__len__") else [default])),
        low=_decimal(row["low"]),
        high=_decimal(row["high"]),
        doc=row["doc"],
        choices=tuple(filter(None, row["choices"].split("|"))),
    )


def _decimal(x: float) -> float:
    """The number that the .def file says: 0.8, where single precision holds 0.800000011920929."""
    return float(f"{x:.7g}")


def entry(kind: str, name: object, where: str = "") -> Entry:
    """The entry of that name.

    Raises SceneError, with the nearest name, where there is none; `where`, if any, begins its text.
    """
    entries = tables()[kind]
    if not isinstance(name, str) or name not in entries:
        raise SceneError(
            (f"{where}: " if where else "") + unknown_name(_NOUNS[kind], name, entries)
        )
    return entries[name]


def check(
    kind: str, type: object, params: Mapping[str, object], where: str
) -> dict[str, tuple[float, ...]]:
    """Every parameter of a material or background in the table's order, defaults filled in.

    kind, type: "materials" and "metal", say. params: the values by name; a number where the
    parameter's size is 1, else a sequence of `size` numbers. where: begins the error texts, e.g.
    "material 'steel'".

    Raises SceneError for an unknown type or parameter, a wrong number of values, and a value that
    is no number, not finite or outside its range.
    """
    listed = entry(kind, type, where).params
    known = {p.name: p for p in listed}
    for name in params:
        if name not in known:
            raise SceneError(f"{where}: {unknown_name('parameter', name, known)}")
    return {
        p.name: values_of(p, params[p.name], where) if p.name in params else p.default
        for p in listed
    }


def values_of(param: Param, value: Any, where: str) -> tuple[float, ...]:
    """The numbers that a value of a parameter stands for. Raises SceneError, as check() does."""
    what = f"{where}: parameter {param.name!r}"
    if param.choices:
        if not isinstance(value, str) or value not in param.choices:
            raise SceneError(f"{where}: {unknown_name(param.name, value, param.choices)}")
        return (float(param.choices.index(value)),)
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        value = value.tolist()
    if param.size == 1:
        return (_value(param, value, what),)
    if not isinstance(value, (list, tuple)):
        raise SceneError(f"{what} is {_show(value)}; must be {param.size} numbers")
    if len(value) != param.size:
        raise SceneError(f"{what} has {len(value)} values; must be {param.size} numbers")
    return tuple(_value(param, x, f"{what}[{i}]") for i, x in enumerate(value))


def _value(param: Param, value: object, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise SceneError(f"{what} is {_show(value)}; must be a number")
    try:
        number = float(value)
    except OverflowError:  # an integer of more than 308 digits
        number = inf
    if not param.low <= number <= param.high:
        raise SceneError(f"{what} is {_show(value)}; {param.range()}")
    if not isfinite(number) or abs(number) > LARGEST:
        raise SceneError(f"{what} is {_show(value)}; must be finite and at most {LARGEST:.2g}")
    return number


def _show(value: object) -> str:
    if isinstance(value, int) and abs(value) > 10**40:  # Python refuses to print the longest
        return "a huge integer"
    return reprlib.repr(value)
