"""Accessors: arrays of numbers, as views into buffers, with some elements replaced (sparse)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import schema
from .source import Source

Floats = NDArray[np.float32]

_COMPONENTS: dict[int, str] = {
    5120: "int8",
    5121: "uint8",
    5122: "int16",
    5123: "uint16",
    5125: "uint32",
    5126: "float32",
}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def count(s: Source, index: int, where: str) -> int:
    """The number of elements, before any is read."""
    return s.item(s.document.accessors, "accessors", index, where).count


def floats(s: Source, index: int, where: str, widths: tuple[int, ...] = (1,)) -> Floats:
    """(N, width) float32, all finite; normalised whole numbers in [0, 1] or [-1, 1]."""
    accessor = s.item(s.document.accessors, "accessors", index, where)
    return finite(s, scaled(read(s, index, where, widths), accessor.normalized), where)


def scaled(values: NDArray[Any], normalized: bool) -> Floats:
    """Whole numbers as the numbers they stand for (glTF 2.0, 3.6.2.2)."""
    kind = values.dtype
    numbers = np.asarray(values, np.float32)
    if normalized and kind.kind in "iu":
        numbers = np.maximum(numbers / np.float32(np.iinfo(kind).max), np.float32(-1.0))
    return numbers


def finite(s: Source, values: Floats, where: str) -> Floats:
    """The array. Raises FormatError for the first element that is not finite."""
    good = np.isfinite(values)
    if not good.all():
        bad = int(np.argmin(good.all(axis=1)))
        raise s.error(f"{where}: element {bad} is not finite")
    return values


def integers(s: Source, index: int, where: str, widths: tuple[int, ...] = (1,)) -> NDArray[Any]:
    """(N, width) unsigned whole numbers, of the type in which they are stored."""
    values = read(s, index, where, widths)
    if values.dtype.kind != "u":
        raise s.error(f"{where}: accessor {index} holds {values.dtype}; must be unsigned integers")
    return values


def read(s: Source, index: int, where: str, widths: tuple[int, ...]) -> NDArray[Any]:
    """(N, width) numbers as they are stored; a view of the file where nothing is replaced."""
    accessor = s.item(s.document.accessors, "accessors", index, where)
    place = f"accessors[{index}]"
    width = _WIDTHS.get(accessor.type, 0)
    if width not in widths or accessor.type in ("MAT2", "MAT3"):
        wanted = [t for t, w in _WIDTHS.items() if w in widths and t not in ("MAT2", "MAT3")]
        raise s.error(
            f"{where}: {place} is of type {accessor.type[:20]!r}; must be {' or '.join(wanted)}"
        )
    kind = _dtype(s, accessor.component_type, f"{place}.componentType")
    if accessor.buffer_view is None:
        # zeros, of which a few bytes may ask for any number
        if accessor.count > s.bytes:
            raise s.error(
                f"{place}: has {accessor.count} elements without data; more than the file has bytes"
            )
        s.spend(accessor.count * width * kind.itemsize, place)
        values: NDArray[Any] = np.zeros((accessor.count, width), kind)
    else:
        values = _strided(s, accessor, place, kind, width)
    if accessor.sparse is not None:
        values = _replaced(s, accessor.sparse, f"{place}.sparse", values)
    return values


def _dtype(s: Source, component: int, where: str) -> np.dtype[Any]:
    if component not in _COMPONENTS:
        choices = ", ".join(f"{k} ({v})" for k, v in _COMPONENTS.items())
        raise s.error(f"{where}: is {component}; must be one of {choices}")
    kind: np.dtype[Any] = np.dtype(_COMPONENTS[component]).newbyteorder("<")
    return kind


def _strided(
    s: Source, accessor: schema.Accessor, where: str, kind: np.dtype[Any], width: int
) -> NDArray[Any]:
    assert accessor.buffer_view is not None
    data = s.view(accessor.buffer_view, f"{where}.bufferView")
    size = width * kind.itemsize
    stride = s.document.buffer_views[accessor.buffer_view].byte_stride or size
    if stride < size:
        raise s.error(f"{where}: an element has {size} bytes, but the view's stride is {stride}")
    end = accessor.byte_offset + (accessor.count - 1) * stride + size
    if end > len(data):
        raise s.error(
            f"{where}: {accessor.count} elements need {end} bytes; bufferViews"
            f"[{accessor.buffer_view}] has {len(data)}"
        )
    return np.asarray(
        np.ndarray(
            (accessor.count, width), kind, data, accessor.byte_offset, (stride, kind.itemsize)
        )
    )


def _replaced(s: Source, sparse: schema.Sparse, where: str, values: NDArray[Any]) -> NDArray[Any]:
    if sparse.count > len(values):
        raise s.error(f"{where}: replaces {sparse.count} of {len(values)} elements")
    kind = _dtype(s, sparse.indices.component_type, f"{where}.indices.componentType")
    if kind.kind != "u":
        raise s.error(f"{where}.indices: are {kind}; must be unsigned integers")
    made = [
        _packed(s, part, f"{where}.{name}", (sparse.count, columns), dtype)
        for name, part, columns, dtype in (
            ("indices", sparse.indices, 1, kind),
            ("values", sparse.values, values.shape[1], values.dtype),
        )
    ]
    places = made[0].ravel()
    wrong = places >= len(values)
    if wrong.any():
        bad = int(np.argmax(wrong))
        raise s.error(
            f"{where}.indices: number {bad} is {places[bad]}; there are {len(values)} elements,"
            " from 0"
        )
    s.spend(values.nbytes, where)
    result: NDArray[Any] = values.copy()
    result[places] = made[1]
    return result


def _packed(
    s: Source,
    part: schema.SparseIndices | schema.SparseValues,
    where: str,
    shape: tuple[int, int],
    kind: np.dtype[Any],
) -> NDArray[Any]:
    data = s.view(part.buffer_view, f"{where}.bufferView")
    need = shape[0] * shape[1] * kind.itemsize
    if part.byte_offset + need > len(data):
        raise s.error(
            f"{where}: needs {part.byte_offset + need} bytes; bufferViews[{part.buffer_view}] has"
            f" {len(data)}"
        )
    return np.asarray(np.ndarray(shape, kind, data, part.byte_offset))
