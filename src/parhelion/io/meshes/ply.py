"""The Stanford polygon format, PLY: text, and binary of either byte order.

Vertices with x, y, z and, if there, nx, ny, nz; u, v (s, t; texture_u, texture_v); red, green,
blue (r, g, b). Faces are the list vertex_indices (vertex_index). Any other number of a vertex or
face becomes an attribute, three whose names end in _r _g _b, _x _y _z or _0 _1 _2 a colour.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...spectra import decode_srgb
from ..files import contents
from . import Floats, Indices, Integers, MeshData, check_corners, triangulate
from .numbers import parse

_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_LONGEST_HEADER = 1 << 16
_UV_NAMES = (("u", "v"), ("s", "t"), ("texture_u", "texture_v"))
_ENDINGS = (("r", "g", "b"), ("x", "y", "z"), ("0", "1", "2"))


@dataclass
class _Property:
    name: str
    item: str  # NumPy type of the value, or of a list's items
    count: str = ""  # of a list's count


@dataclass
class _Element:
    name: str
    size: int
    properties: list[_Property] = field(default_factory=list)


class _Body:
    """The data after the header, as bytes or, of a text file, as numbers."""

    def __init__(self, path: Path, data: bytes, form: str) -> None:
        self.path = path
        self.text = form == "ascii"
        self.order: Literal["<", ">"] = ">" if form == "binary_big_endian" else "<"
        self.data: NDArray[np.float64] | NDArray[np.uint8]
        if self.text:
            try:
                self.data = parse(data)
            except ValueError as error:
                raise FormatError(f"{path}: its data holds {error}") from None
        else:
            self.data = np.frombuffer(data, np.uint8)

    def width(self, item: str) -> int:
        return 1 if self.text else np.dtype(item).itemsize

    def column(self, item: str, at: int, step: int, size: int, width: int = 1) -> Any:
        """(size,) values, or (size, width), each `step` behind the last, from this place on."""
        one = np.dtype(np.float64 if self.text else item)
        stored = one.newbyteorder(self.order) if not self.text else one
        unit = one.itemsize if self.text else 1
        shape, strides = (size, width), (step * unit, one.itemsize)
        table: Any = np.ndarray(shape, stored, self.data, at * unit, strides)
        found = _within(table, item) if self.text else table.astype(item)
        return found[:, 0] if width == 1 else found

    def values(self, at: Integers, item: str) -> Floats | Integers:
        """The values at these places; past the end they are 0."""
        width = self.width(item)
        inside = np.minimum(at, len(self.data) - width)
        if self.text:
            return _within(np.where(at == inside, self.data[inside], 0.0), item)
        raw = self.data[inside[..., None] + np.arange(width)]
        found = np.ascontiguousarray(raw).view(np.dtype(item).newbyteorder(self.order))[..., 0]
        return np.where(at == inside, found, 0)


def _whole(items: Floats | Indices) -> Indices:
    """Items of a list that are indices, as they are stored if those are whole numbers."""
    whole: Indices = np.asarray(items, np.int64 if items.dtype.kind == "f" else items.dtype)
    return whole


def _within(numbers: Floats, item: str) -> Floats | Integers:
    """Numbers of a text as those of a type, whole ones cut to its range."""
    if item[0] == "f":
        return numbers
    most = np.iinfo(item)
    cut = np.clip(numbers, most.min, most.max)
    if cut.size and np.isnan(np.min(cut)):
        cut = np.nan_to_num(cut)
    return np.asarray(cut, item)


def read(path: Path, points: bool = False) -> MeshData:
    """The file as one mesh; points: which may have no faces. Raises FormatError, OSError."""
    data = contents(path)
    form, elements, begin = _header(path, data)
    body = _Body(path, data[begin:], form)
    at = 0
    columns: dict[str, dict[str, Floats | Integers]] = {}
    polygons: tuple[Integers, Indices] | None = None
    left_out: list[str] = []
    for element in elements:
        at, found, lists = _element(body, element, at)
        columns[element.name] = found
        if element.name == "face":
            polygons = lists.pop("vertex_indices", None) or lists.pop("vertex_index", None)
        elif element.name != "vertex" and element.size:
            left_out.append(f"element {element.name!r}: not supported; left out")
            continue
        left_out += [f"list {n!r} of {element.name!r}: not supported; left out" for n in lists]
    vertex = columns.get("vertex", {})
    if any(axis not in vertex for axis in "xyz"):
        raise FormatError(f"{path}: has no element 'vertex' with x, y and z")
    if polygons is None and "tristrips" in columns:
        raise FormatError(f"{path}: its faces are tristrips, which are not read")
    if polygons is None and points and not columns.get("face"):
        polygons = np.empty(0, np.int64), np.empty(0, np.int64)
        columns["face"] = {}
    if polygons is None:
        raise FormatError(f"{path}: has no element 'face' with a list vertex_indices")
    counts, corners = polygons
    if (counts < 3).any():
        raise FormatError(f"{path}: face {int(np.argmax(counts < 3))} has fewer than 3 corners")
    vertices = _take(vertex, "x", "y", "z")
    assert vertices is not None
    check_corners(str(path), counts, corners, len(vertices))
    triangles, polygon = triangulate(str(path), counts, corners, vertices)
    normals = _take(vertex, "nx", "ny", "nz")
    uvs = None
    for names in _UV_NAMES:
        uvs = _take(vertex, *names) if uvs is None else uvs
    attributes: dict[str, Floats] = {}
    for place, table in (("vertex", vertex), ("face", columns["face"])):
        fields, colors = _attributes(table)
        if colors is not None:
            if "color" in fields:
                left_out.append(f"field 'color' of {place!r}: there are colours too; left out")
            fields["color"] = colors
        for name, values in fields.items():
            attributes[f"{place}_{name}"] = values if place == "vertex" else values[polygon]
    return MeshData(vertices, triangles, normals, uvs, attributes, left_out=left_out)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    """The format's name, the elements, and where the data begin."""
    end = re.search(rb"(?m)^end_header[ \t]*\r?\n", data[:_LONGEST_HEADER])
    if not re.match(rb"ply[ \t]*\r?\n", data) or end is None:
        raise FormatError(f"{path}: is not a PLY file: no header from 'ply' to 'end_header'")
    form = ""
    elements: list[_Element] = []
    for number, line in enumerate(data[: end.start()].decode("latin-1").splitlines(), 1):
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info" | "ply", *_]:
                pass
            case [
                "format",
                ("ascii" | "binary_little_endian" | "binary_big_endian") as form,
                "1.0",
            ]:
                pass
            case ["element", name, size] if size.isascii() and size.isdigit():
                elements.append(_Element(name, int(size[:18])))
            case ["property", "list", count, item, name] if elements and {count, item} <= set(
                _TYPES
            ):
                elements[-1].properties.append(_Property(name, _TYPES[item], _TYPES[count]))
            case ["property", item, name] if elements and item in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[item]))
            case _:
                raise FormatError(f"{path}: line {number} of its header: {line[:60]!r}")
    if not form:
        raise FormatError(f"{path}: its header names no format (ascii 1.0, binary_... 1.0)")
    return form, elements, end.end()


_Found = tuple[int, dict[str, Floats | Integers], dict[str, tuple[Integers, Indices]]]


def _element(body: _Body, element: _Element, begin: int) -> _Found:
    """Where the next element begins; numbers by name; and lists by name: counts, and all items."""
    smallest = sum(body.width(p.count or p.item) for p in element.properties)
    if element.size * smallest > len(body.data) - begin:
        raise FormatError(f"{body.path}: is cut short: {element.size} of element {element.name!r}")
    numbers: dict[str, Floats | Integers] = {}
    lists: dict[str, tuple[Integers, Indices]] = {}
    if element.size == 0:
        for p in element.properties:
            if p.count:
                lists[p.name] = (np.empty(0, np.int64), np.empty(0, np.int64))
            else:
                numbers[p.name] = np.empty(0)
        return begin, numbers, lists
    if not smallest:
        return begin, numbers, lists
    even = _even(body, element, begin)
    if even is not None:
        return even

    def sizes(at: Integers, count: str) -> Integers:
        """Of lists; what reaches beyond the end does so by a little, lest places overflow."""
        with np.errstate(invalid="ignore"):  # what is no number is negative then
            return np.minimum(body.values(at, count).astype(np.int64), len(body.data) + 1)

    def step(at: Integers) -> Integers:
        """Where the records end that begin at these places."""
        for p in element.properties:
            if p.count:
                counts = sizes(at, p.count)
                at = at + body.width(p.count) + np.maximum(counts, 0) * body.width(p.item)
            else:
                at = at + body.width(p.item)
        return at

    at = _records(step, begin, element.size, len(body.data))
    place = at
    for p in element.properties:
        if not p.count:
            numbers[p.name] = body.values(place, p.item)
            place = place + body.width(p.item)
            continue
        counts = sizes(place, p.count)
        if (counts < 0).any():
            bad = int(np.argmax(counts < 0))
            raise FormatError(
                f"{body.path}: {element.name} {bad}: list {p.name!r} of negative size"
            )
        place = place + body.width(p.count)
        after = place + counts * body.width(p.item)
        if int(after.max()) > len(body.data):
            raise FormatError(
                f"{body.path}: is cut short: list {p.name!r} of element {element.name!r}"
            )
        own = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
        items = body.values(np.repeat(place, counts) + own * body.width(p.item), p.item)
        lists[p.name] = (counts, _whole(items))
        place = after
    if int(place[-1]) > len(body.data):
        raise FormatError(f"{body.path}: is cut short: element {element.name!r}")
    return int(place[-1]), numbers, lists


def _even(body: _Body, element: _Element, begin: int) -> _Found | None:
    """What _element() returns, of one whose records are all as long as the first, as in most files;
    None of others.
    """
    sizes: list[int] = []  # of the lists
    length = 0
    for p in element.properties:
        if p.count:
            at = begin + length
            if at + body.width(p.count) > len(body.data):
                return None
            size = float(body.column(p.count, at, 1, 1)[0])
            if not 0 <= size <= len(body.data):
                return None
            sizes.append(int(size))
            length += body.width(p.count) + sizes[-1] * body.width(p.item)
        else:
            length += body.width(p.item)
    if element.size * length > len(body.data) - begin:
        return None
    numbers: dict[str, Floats | Integers] = {}
    lists: dict[str, tuple[Integers, Indices]] = {}
    at = begin
    for p in element.properties:
        if not p.count:
            numbers[p.name] = body.column(p.item, at, length, element.size)
            at += body.width(p.item)
            continue
        size = sizes.pop(0)
        counts = body.column(p.count, at, length, element.size)
        if (counts != size).any():
            return None
        at += body.width(p.count)
        items = body.column(p.item, at, length, element.size, size) if size else np.empty(0)
        lists[p.name] = (np.asarray(counts, np.int64), _whole(items.ravel()))
        at += size * body.width(p.item)
    return begin + element.size * length, numbers, lists


def _records(step: Callable[[Integers], Integers], begin: int, size: int, end: int) -> Integers:
    """Where each of `size` records begins, the first at `begin`, none past `end`.

    It is known only from the one before. The table "next" of every place, followed to twice as many
    records each time, gives them all in log2(size) steps.
    """
    jump = np.append(np.minimum(step(np.arange(begin, end, dtype=np.int64)), end), end) - begin
    places = np.zeros(1, np.int64)
    while len(places) < size:
        places = np.concatenate([places, jump[places]])
        jump = jump[jump]
    return places[:size] + begin


def _take(columns: dict[str, Floats | Integers], *names: str) -> Floats | None:
    """These columns side by side, taken out; None unless all are there."""
    if any(name not in columns for name in names):
        return None
    return np.stack([columns.pop(name) for name in names], axis=1).astype(np.float32)


def _attributes(columns: dict[str, Floats | Integers]) -> tuple[dict[str, Floats], Floats | None]:
    """What else there is by name, and the colours."""
    colors: Floats | None = None
    for names in (("red", "green", "blue"), ("r", "g", "b")):
        whole = names[0] in columns and columns[names[0]].dtype == np.uint8
        given = _take(columns, *names)
        if given is not None:
            colors = decode_srgb(given / 255.0) if whole else given
    found: dict[str, Floats] = {}
    for name in list(columns):
        for endings in _ENDINGS:
            stem, _, ending = name.rpartition("_")
            if stem and ending == endings[0]:
                grouped = _take(columns, *(f"{stem}_{e}" for e in endings))
                if grouped is not None:
                    found[stem] = grouped
    return found | {k: np.asarray(v, np.float32) for k, v in columns.items()}, colors
