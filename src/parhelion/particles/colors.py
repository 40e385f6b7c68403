"""Colours of particles: of their kinds, or of a field by a colour map; and what they stand for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import SceneError, unknown_name
from ..scene import ColorBar, Swatches, Vec3
from ..spectra import decode_srgb
from . import elements
from .data import Labels, Particles, atomic_numbers

if TYPE_CHECKING:
    from ..io import LoadOptions

# Fields that every set of particles has, besides "element" and "type" where they are known.
_COORDINATES = ("x", "y", "z")

# M. Okabe and K. Ito's colours for readers of all kinds of colour vision, 8-bit sRGB, in an order
# that keeps the first ones apart in lightness too; the black is a grey here, to show its shading.
_PALETTE = np.array(
    [
        (86, 180, 233),
        (230, 159, 0),
        (0, 158, 115),
        (204, 121, 167),
        (213, 94, 0),
        (0, 114, 178),
        (240, 228, 66),
        (120, 120, 120),
    ],
    np.uint8,
)
# Colours from which on a colour map is meant to be smooth, and steps that it then gets.
_SMOOTH, _STEPS = 256, 4096
# A value that is not a number is shown in this linear grey.
_GREY = 0.25
# Albedo of a colour of 255 among elements and types; 1 would be whiter than any material.
_WHITEST = 0.85


def linear(srgb: ArrayLike) -> NDArray[np.float32]:
    """Linear Rec. 709 RGB of sRGB values: 8-bit integers, or numbers within [0, 1]."""
    values = np.asarray(srgb)
    return decode_srgb(values / 255.0 if values.dtype == np.uint8 else values.astype(np.float64))


def colors_of(
    particles: Particles, options: LoadOptions
) -> tuple[NDArray[np.float32], ColorBar | Swatches | None]:
    """(N, 3) linear RGB: of the field that the user names, else the file's, else of the kinds; and
    what they stand for.
    """
    if options.color_by is not None:
        values = field_of(particles, options.color_by)
        if values is particles.elements:
            return _element_colors(particles.elements)
        if isinstance(values, Labels):
            return _label_colors(values, options.color_by)
        low, high = color_range(values, options.color_range)
        colors = mapped(values, options.colormap, low, high)
        return colors, ColorBar(options.color_by, options.colormap, low, high)
    if particles.colors is not None:
        return particles.colors.astype(np.float32, copy=False), None
    if particles.elements is not None:
        return _element_colors(particles.elements)
    if particles.types is not None:
        return _label_colors(particles.types, "type")
    return np.tile(_WHITEST * linear(_PALETTE[:1]), (len(particles.positions), 1)), None


_Kinds = tuple[NDArray[np.float32], Swatches]


def _element_colors(labels: Labels) -> _Kinds:
    return _kinds(labels, _WHITEST * linear(elements.COLORS[atomic_numbers(labels)]), "element")


def _label_colors(labels: Labels, what: str) -> _Kinds:
    """Type number k always has the k-th colour; other names have theirs in alphabetical order."""
    names = labels.names
    if all(name.isdecimal() for name in names):
        order = np.array([(int(name) - 1) % len(_PALETTE) for name in names], np.intp)
    else:
        order = np.argsort(np.argsort(np.array(names))) % len(_PALETTE)
    return _kinds(labels, _WHITEST * linear(_PALETTE[order]), what)


def _kinds(labels: Labels, colors: NDArray[np.float32], what: str) -> _Kinds:
    """The colours of particles by those of the names, and what they stand for."""
    used = np.bincount(labels.codes, minlength=len(labels.names)) > 0
    kinds = zip(labels.names, colors.tolist(), used, strict=True)
    return labels.each(colors), swatches(what, {name: tuple(c) for name, c, use in kinds if use})


def swatches(label: str, kinds: Mapping[str, Vec3]) -> Swatches:
    """In the order of their numbers or names."""
    return Swatches(label, tuple((name, kinds[name]) for name in sorted(kinds, key=in_order)))


def in_order(name: str) -> tuple[int, str]:
    """The key by which kinds are sorted: others by name, then numbers by value."""
    return len(name) * name.isdecimal(), name


def field_of(particles: Particles, name: str) -> NDArray[Any] | Labels:
    """A field by name: (N,) numbers or Labels. Of an (N, M) field f, "f" is its length and
    "f_x", "f_y", "f_z" (where M = 3) or "f_1" ... "f_M" are its components.

    Raises SceneError for a name of none.
    """
    known = _fields(particles)
    if name not in known:
        raise SceneError(unknown_name("field to colour by", name, known))
    found, column = known[name]
    if isinstance(found, Labels) or found.ndim == 1:
        return found
    return np.asarray(np.linalg.norm(found, axis=1) if column is None else found[:, column])


def field_names(particles: Particles) -> list[str]:
    """What particles can be coloured by."""
    return list(_fields(particles))


def _fields(particles: Particles) -> dict[str, tuple[NDArray[Any] | Labels, int | None]]:
    """Arrays by the names that field_of() knows, and of one with rows the column."""
    known: dict[str, tuple[NDArray[Any] | Labels, int | None]] = {
        "index": (np.arange(len(particles.positions)), None),
        **{axis: (particles.positions, column) for column, axis in enumerate(_COORDINATES)},
    }
    for kind, labels in (("element", particles.elements), ("type", particles.types)):
        if labels is not None:
            known[kind] = labels, None
    for key, values in particles.fields.items():
        known[key] = values, None
        if not isinstance(values, Labels) and values.ndim == 2:
            size = values.shape[1]
            suffixes: Sequence[object] = _COORDINATES if size == 3 else range(1, size + 1)
            known.update({f"{key}_{s}": (values, column) for column, s in enumerate(suffixes)})
    return known


def map_colors(
    values: NDArray[Any], colormap: str, limits: tuple[float, float] | None
) -> NDArray[np.float32]:
    """(N, 3) linear RGB of N numbers by a Matplotlib colour map.

    limits: the values at the map's two ends; None for the 1st and 99th percentile of the finite
    values. What is outside has the colour of the nearer end; NaN is grey.
    Raises SceneError for an unknown colour map, and limits that are not finite and increasing.
    """
    return mapped(values, colormap, *color_range(values, limits))


def color_range(
    values: NDArray[Any], limits: tuple[float, float] | None = None
) -> tuple[float, float]:
    """The values at the ends of a colour map, as map_colors() has them. Raises SceneError."""
    if limits is not None:
        low, high = (float(v) for v in limits)
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise SceneError(f"colour range {low:g} {high:g} is not two finite, increasing numbers")
        return low, high
    numbers = values.astype(np.float64)
    finite = numbers[np.isfinite(numbers)]
    if not len(finite):
        return 0.0, 1.0
    low, high = np.percentile(finite, (1, 99))
    if low == high:  # as in a field of rare ones among zeros
        low, high = finite.min(), finite.max()
    return float(low), float(high)


def mapped(values: NDArray[Any], colormap: str, low: float, high: float) -> NDArray[np.float32]:
    """As map_colors(), between two values, which may be the same. Raises SceneError."""
    table = _table(colormap)
    numbers = values.astype(np.float64)
    # halves, as the difference of two large numbers may overflow
    span = 0.5 * high - 0.5 * low
    place = (
        (0.5 * numbers - 0.5 * low) / span if span > 0 else np.where(numbers == low, 0.5, numbers)
    )
    known = ~np.isnan(place)
    index = np.clip(np.where(known, place, 0.0) * len(table), 0, len(table) - 1).astype(np.intp)
    colors: NDArray[np.float32] = np.take(table, index, axis=0)
    colors[~known] = _GREY
    return colors


def _table(colormap: str) -> NDArray[np.float32]:
    """(M, 3) linear RGB of a colour map from its lower end to its upper, in equal steps.

    Between a map's own colours, of which it has 256 mostly, there are more: of some maps they lie
    so far apart that a colour bar and a particle on two sides of a step would look different. Maps
    of fewer colours mean these.
    """
    from matplotlib import colormaps

    if colormap not in colormaps:
        raise SceneError(unknown_name("colour map", colormap, colormaps))
    own = colormaps[colormap](np.arange(colormaps[colormap].N))[:, :3]
    if len(own) < _SMOOTH:
        return linear(own)
    at = (np.arange(_STEPS) + 0.5) * len(own) / _STEPS - 0.5
    return linear(np.stack([np.interp(at, np.arange(len(own)), c) for c in own.T], axis=1))
