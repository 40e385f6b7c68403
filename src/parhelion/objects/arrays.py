"""Arrays of other libraries' objects as ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import SceneError
from ..particles import Labels


def floats(values: Any) -> Any:
    """As an array of single or double precision. Raises SceneError for anything else."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "bc":  # True is no place, and what is imaginary would be lost
            raise TypeError
        if array.dtype not in (np.float32, np.float64):
            array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise SceneError("positions must be (N, 3) numbers") from None
    return array


def fields_of(found: dict[str, Any], count: int, without: Sequence[str] = ()) -> dict[str, Any]:
    """Those of numbers or words that there are `count` of."""
    fields: dict[str, Any] = {}
    for name, values in found.items():
        array = np.asarray(values)
        if name in without or array.ndim not in (1, 2) or len(array) != count:
            continue
        if array.dtype.kind in "iufb":
            fields[name] = array.astype(np.float32) if array.dtype.kind in "iub" else array
        elif array.ndim == 1:
            fields[name] = Labels.of(array.astype(str))
    return fields


def numbers(of: str, found: dict[str, Any], count: int) -> dict[str, Any]:
    """Fields of numbers as attributes of a mesh's vertices or faces."""
    fields = fields_of(found, count)
    return {f"{of}_{name}": x for name, x in fields.items() if not isinstance(x, Labels)}
