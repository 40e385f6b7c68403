"""What arguments must be: each check returns the value as it is meant, or raises SceneError.

Every text names the argument as the user knows it, says what it is and what it must be.
"""

from __future__ import annotations

import operator
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from .errors import SceneError, option
from .scene import Vec3
from .tables import LARGEST

if TYPE_CHECKING:
    from numpy.typing import NDArray

_T = TypeVar("_T")

MOST_THREADS = 4096


def whole(name: str, value: Any, low: int, high: int) -> int:
    """A whole number in [low, high]."""
    try:
        if _is_flag(value):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise _wrong(name, value, "a whole number") from None
    if not low <= number <= high:
        raise SceneError(f"{option(name)} is {number}; must lie in [{low}, {high}]")
    return number


def own_threads(threads: Any, cluster: Any = None) -> int:
    """Those of this process that are asked for, 0 for all: with a cluster they are each worker's.

    Raises SceneError for what is no number of threads.
    """
    asked = whole("threads", threads, 0, MOST_THREADS)
    return asked if cluster is None else 0


def number(name: str, value: Any) -> float:
    """Any number."""
    try:
        if not isinstance(value, (str, bytes)) and not _is_flag(value):
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise _wrong(name, value, "a number")


def length(name: str, value: Any) -> float | None:
    """A number above 0, or None."""
    if value is None:
        return None
    found = number(name, value)
    if not found > 0:
        raise SceneError(f"{option(name)} is {found}; must be > 0")
    return found


def flag(name: str, value: Any) -> bool:
    """True or False, Python's or NumPy's."""
    if not _is_flag(value):
        raise _wrong(name, value, "True or False")
    return bool(value)


def automatic(name: str, value: Any) -> bool | Literal["auto"]:
    """A flag, or "auto" for what is found out."""
    if isinstance(value, str) and value == "auto":
        return "auto"
    if not _is_flag(value):
        raise _wrong(name, value, 'True, False or "auto"')
    return bool(value)


def text(name: str, value: Any) -> str:
    """A name or the like."""
    if not isinstance(value, str):
        raise _wrong(name, value, "text")
    return value


def color(name: str, value: Any) -> Vec3:
    """Three numbers, finite and not negative."""
    what = "three numbers >= 0, linear RGB"
    r, g, b = _numbers(name, value, 3, what)
    if not all(0 <= c <= LARGEST for c in (r, g, b)):
        raise _wrong(name, value, what)
    return r, g, b


def pair(name: str, value: Any) -> tuple[float, float]:
    """Two numbers."""
    x, y = _numbers(name, value, 2, "two numbers")
    return x, y


def point(name: str, value: Any) -> Vec3:
    """Three numbers."""
    x, y, z = _numbers(name, value, 3, "three numbers")
    return x, y, z


def array(name: str, value: Any) -> NDArray[Any]:
    """Any array; rows of different lengths are none."""
    import numpy as np

    try:
        return np.asarray(value)
    except ValueError as error:
        raise SceneError(f"{option(name)} is no array: {error}") from error


def floats(what: str, values: Any) -> Any:
    """A C-contiguous array of float32 or float64. what: the argument, or a field of an object."""
    import numpy as np

    if np.ma.is_masked(values):
        raise SceneError(
            f"{what} has masked elements; choose what they should be, or leave them out"
        )
    try:
        array = np.asarray(values)
        if array.dtype not in (np.float32, np.float64):
            if array.dtype.kind not in "iuf" and array.size:
                raise ValueError(f"its elements are {array.dtype}, not numbers")
            array = array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{what} is not an array of numbers: {error}") from error
    # not np.ascontiguousarray, which makes a single number an array of one
    return np.asarray(array, order="C")


def path(name: str, value: Any) -> Path:
    """The path of a file."""
    if isinstance(value, (str, os.PathLike)):
        try:
            return Path(value)
        except TypeError:  # one of bytes
            pass
    raise SceneError(f"{option(name)}: a path is needed, not {type(value).__name__}")


def instance(name: str, value: Any, kind: type[_T]) -> _T:
    """An object of one of this package's types."""
    if not isinstance(value, kind):
        word = kind.__name__
        needed = f"{'an' if word[0] in 'AEIOU' else 'a'} {word} is"
        if word.endswith("s"):
            needed = f"{word} are"
        raise SceneError(f"{option(name)}: {needed} needed, not {type(value).__name__}")
    return value


def _is_flag(value: Any) -> bool:
    """Whether it is True or False, Python's or NumPy's."""
    return type(value).__name__ in ("bool", "bool_")


def _numbers(name: str, value: Any, count: int, what: str) -> list[float]:
    try:
        found = [number(name, v) for v in value]
    except (TypeError, SceneError):
        found = []
    if len(found) != count:
        raise _wrong(name, value, what)
    return found


def _wrong(name: str, value: Any, what: str) -> SceneError:
    return SceneError(f"{option(name)} is {value!r}; must be {what}")
