"""Scenes as plain data: a worker gets what `Flat.parts` holds, never an object with code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np

# Arrays of fewer bytes travel together, larger ones each by itself.
_SMALL = 1 << 16
_ARRAY = 1  # the kind of MessagePack's extension that stands for an array, by its number


def packed(parts: Mapping[str, Any]) -> tuple[bytes, list[list[Any]]]:
    """Flat.parts as MessagePack, with the numbers of arrays, and these arrays, in bundles.

    The first bundle has all small ones; the arrays are not copied.
    """
    arrays: list[Any] = []

    def number(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            arrays.append(value)
            return msgspec.msgpack.Ext(_ARRAY, str(len(arrays) - 1).encode())
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, Mapping):
            return dict(value)
        raise TypeError(f"{type(value).__name__} in a scene")

    skeleton = msgspec.msgpack.encode(parts, enc_hook=number)
    small = [i for i, array in enumerate(arrays) if array.nbytes < _SMALL]
    large = [i for i, array in enumerate(arrays) if array.nbytes >= _SMALL]
    return skeleton, [[(i, arrays[i]) for i in small], *([(i, arrays[i])] for i in large)]


def unpacked(skeleton: bytes, bundles: Sequence[Sequence[tuple[int, Any]]]) -> dict[str, Any]:
    """What was packed, with lists for tuples."""
    arrays = {i: array for bundle in bundles for i, array in bundle}

    def at(code: int, data: memoryview) -> Any:
        if code != _ARRAY:
            raise ValueError(code)
        return arrays[int(bytes(data))]

    parts: dict[str, Any] = msgspec.msgpack.decode(skeleton, ext_hook=at)
    return parts
