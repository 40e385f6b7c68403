"""Animations at a given time: what nodes' properties are then."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from . import accessors, schema
from .source import Source

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}
# Properties by node and path, such as (3, "rotation")
Properties = dict[tuple[int, str], NDArray[np.float64]]


def ends(s: Source) -> tuple[float, float]:
    """The first and the last time, in seconds, at which anything changes.

    Raises FormatError for a file without animations.
    """
    found = [own for i in range(len(s.document.animations)) if (own := _ends(s, i))]
    if not found:
        raise s.error("has no animations, and so no frames")
    return min(first for first, _ in found), max(last for _, last in found)


def seconds(s: Source) -> dict[str, float]:
    """The last time, in seconds, at which each animation changes anything, by their names.

    Raises FormatError.
    """
    found: dict[str, float] = {}
    for i, animation in enumerate(s.document.animations):
        name = animation.name
        if not name or name in found:
            name = f"animations[{i}]"
        found[name] = (_ends(s, i) or (0.0, 0.0))[1]
    return found


def _ends(s: Source, index: int) -> tuple[float, float] | None:
    """The first and the last time of one animation; None if it has no keys."""
    animation = s.document.animations[index]
    first, last = np.inf, -np.inf
    for k in dict.fromkeys(channel.sampler for channel in animation.channels):
        where = f"animations[{index}]"
        sampler = s.item(animation.samplers, f"{where}.samplers", k, f"{where}.channels")
        keys = accessors.floats(s, sampler.input, f"{where}.samplers[{k}].input")
        if len(keys):
            first, last = min(first, float(keys.min())), max(last, float(keys.max()))
    return (first, last) if first <= last else None


def at_time(s: Source, time: float) -> Properties:
    """What animations change, and to what, at a time in seconds.

    Files keep one motion in one animation, or an animation an object; so all of them are played,
    and where two change the same, the first one does.
    """
    found: Properties = {}
    for i, animation in enumerate(s.document.animations):
        for k, channel in enumerate(animation.channels):
            where = f"animations[{i}].channels[{k}]"
            target = channel.target
            if target.path == "pointer":
                s.report("KHR_animation_pointer: not supported; what it animates stays at rest")
                continue
            if target.path not in _WIDTHS:
                raise s.error(
                    f"{where}.target.path is {target.path[:20]!r}; must be one of"
                    f" {', '.join(_WIDTHS)}"
                )
            if target.node is None or (target.node, target.path) in found:
                continue
            s.item(s.document.nodes, "nodes", target.node, f"{where}.target.node")
            sampler = s.item(animation.samplers, "samplers", channel.sampler, f"{where}.sampler")
            found[target.node, target.path] = _sample(
                s, sampler, target.path, time, f"animations[{i}].samplers[{channel.sampler}]"
            )
    return found


def _sample(
    s: Source, sampler: schema.AnimationSampler, path: str, time: float, where: str
) -> NDArray[np.float64]:
    """The value at a time; before the first key and after the last it is theirs."""
    keys = accessors.floats(s, sampler.input, f"{where}.input")[:, 0]
    width = _WIDTHS[path]
    values = accessors.floats(s, sampler.output, f"{where}.output", (width,))
    if sampler.interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise s.error(
            f"{where}.interpolation is {sampler.interpolation[:20]!r}; must be one of LINEAR, STEP,"
            " CUBICSPLINE"
        )
    if (np.diff(keys) < 0).any():
        bad = int(np.argmax(np.diff(keys) < 0)) + 1
        raise s.error(f"{where}.input: time {bad} is less than the one before")
    cubic = sampler.interpolation == "CUBICSPLINE"
    rows = len(keys) * (3 if cubic else 1)
    # of weights, one for each target
    if len(values) % rows or (path != "weights" and len(values) != rows):
        raise s.error(f"{where}: has {len(keys)} times and {len(values)} values")
    table = values.astype(np.float64).reshape(len(keys), -1)
    if cubic:
        tangents_in, table, tangents_out = np.split(table, 3, axis=1)
    right = int(np.searchsorted(keys, time, side="right"))
    left = max(right - 1, 0)
    right = min(right, len(keys) - 1)
    span = float(keys[right]) - float(keys[left])
    share = (time - float(keys[left])) / span if span > 0.0 else 0.0
    a, b = table[left], table[right]
    if sampler.interpolation == "STEP" or left == right:
        value = a
    elif cubic:
        value = _hermite(a, span * tangents_out[left], b, span * tangents_in[right], share)
    elif path == "rotation":
        value = _slerp(a, b, share)
    else:
        value = a + share * (b - a)
    if path == "rotation":
        length = np.linalg.norm(value)
        if not length > 0.0:
            raise s.error(f"{where}.output: a rotation is 0 at {time:g} s")
        value = value / length
    return np.asarray(value)


def _hermite(
    a: NDArray[np.float64],
    leaving: NDArray[np.float64],
    b: NDArray[np.float64],
    arriving: NDArray[np.float64],
    t: float,
) -> NDArray[np.float64]:
    """The cubic through a and b with these derivatives there, over an interval of length 1."""
    s, t2, t3 = 1.0 - t, t * t, t * t * t
    return np.asarray(
        (1.0 - 3.0 * t2 + 2.0 * t3) * a
        + t * s * s * leaving
        + (3.0 * t2 - 2.0 * t3) * b
        - t2 * s * arriving
    )


def _slerp(a: NDArray[np.float64], b: NDArray[np.float64], t: float) -> NDArray[np.float64]:
    """Between two rotations as unit quaternions, the short way around."""
    a, b = (q / max(float(np.linalg.norm(q)), 1e-30) for q in (a, b))
    cosine = float(a @ b)
    if cosine < 0.0:
        b, cosine = -b, -cosine
    if cosine > 0.9995:  # so near that the chord is the arc
        return np.asarray(a + t * (b - a))
    angle = float(np.arccos(cosine))
    return np.asarray((np.sin((1.0 - t) * angle) * a + np.sin(t * angle) * b) / np.sin(angle))


def chosen(animated: Properties, node: int, path: str, rest: Sequence[float]) -> Sequence[float]:
    """A node's property: the animation's, else its own."""
    value = animated.get((node, path))
    return rest if value is None else value.tolist()
