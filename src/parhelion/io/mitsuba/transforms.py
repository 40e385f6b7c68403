"""The <transform> element: steps, each applied to the result of those before it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ...errors import unknown_name

Matrix = NDArray[np.float64]

# The largest number allowed: about the largest of the core's arithmetic
_LARGEST = 1e38

_STEPS = ("translate", "scale", "rotate", "lookat", "matrix")


def number(text: str) -> float:
    """The number that a text is. Raises ValueError."""
    text = text.strip()
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if "_" in text or not abs(found) <= _LARGEST:  # Python allows 1_000
        raise ValueError(f"{text[:40]!r} is no number up to {_LARGEST:g}")
    return found


def numbers(text: str) -> list[float]:
    """The numbers of a text, separated by blanks or commas. Raises ValueError."""
    return [number(word) for word in re.split(r"[\s,]+", text.strip()) if word]


def triple(attributes: Mapping[str, str], missing: float) -> tuple[float, float, float]:
    """Three numbers: value="x y z", value="x" for all three, or x=, y= and z=."""
    if "value" not in attributes:
        x, y, z = (number(attributes[axis]) if axis in attributes else missing for axis in "xyz")
        return x, y, z
    values = numbers(attributes["value"])
    if len(values) == 1:
        values *= 3
    if len(values) != 3:
        raise ValueError(f"{attributes['value'][:40]!r}; must be three numbers")
    return values[0], values[1], values[2]


def matrix(steps: Iterable[tuple[str, Mapping[str, str]]]) -> Matrix:
    """All steps as one (4, 4) matrix. Raises ValueError, KeyError."""
    result = np.eye(4)
    for name, attributes in steps:
        if name not in _STEPS:
            raise ValueError(unknown_name("step", name, _STEPS))
        with np.errstate(all="ignore"):
            result = _step(name, attributes) @ result
    if not np.isfinite(result).all():
        raise ValueError("its numbers are not all finite")
    return result


def _step(name: str, attributes: Mapping[str, str]) -> Matrix:
    step = np.eye(4)
    if name == "translate":
        step[:3, 3] = triple(attributes, 0.0)
    elif name == "scale":
        step[[0, 1, 2], [0, 1, 2]] = triple(attributes, 1.0)
    elif name == "rotate":
        step[:3, :3] = rotation(triple(attributes, 0.0), number(attributes["angle"]))
    elif name == "lookat":
        step = look_at(*(_vector(attributes, key) for key in ("origin", "target", "up")))
    else:
        values = numbers(attributes["value"])
        if len(values) == 9:
            step[:3, :3] = np.reshape(values, (3, 3))
        elif len(values) == 16:
            step = np.reshape(values, (4, 4))
        else:
            raise ValueError(f"a matrix of {len(values)} numbers; must be 16 or 9")
        if (step[3] != (0.0, 0.0, 0.0, 1.0)).any() and not np.allclose(step[3], (0, 0, 0, 1)):
            raise ValueError("the last row of a matrix must be 0 0 0 1")
        step[3] = (0.0, 0.0, 0.0, 1.0)
    return step


def _vector(attributes: Mapping[str, str], key: str) -> tuple[float, float, float]:
    if key == "up" and key not in attributes:
        return 0.0, 1.0, 0.0
    return triple({"value": attributes[key]}, 0.0)


def rotation(axis: tuple[float, float, float], degrees: float) -> Matrix:
    """(3, 3) rotation by an angle around an axis of any length (Rodrigues' formula)."""
    x, y, z = axis
    length = math.hypot(x, y, z)
    if not 0.0 < length < math.inf:
        raise ValueError("rotate needs an axis: x, y, z or value")
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / length
    angle = math.radians(degrees)
    return np.asarray(
        np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    )


def look_at(
    origin: tuple[float, float, float],
    target: tuple[float, float, float],
    up: tuple[float, float, float],
) -> Matrix:
    """Camera to world: z looks from origin to target, y is up in the picture, x is its left."""
    forward = np.subtract(target, origin)
    left = np.cross(up, forward)
    if not np.linalg.norm(forward) > 0.0:
        raise ValueError("lookat: origin and target are the same point")
    if not np.linalg.norm(left) > 0.0:
        raise ValueError("lookat: up lies along the viewing direction")
    forward /= np.linalg.norm(forward)
    left /= np.linalg.norm(left)
    result = np.eye(4)
    result[:3, :4] = np.stack([left, np.cross(forward, left), forward, np.array(origin)], axis=1)
    return result
