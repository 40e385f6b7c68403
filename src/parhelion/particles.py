"""Particles, and the scene made of them: colours, radii, camera, light and ground.

Every particle format ends here, so that a file and a NumPy array give the same picture. What is
chosen when the user says nothing is described, with its reasons, in docs/particles.md.

The frame of the data is kept, right-handed, with z up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import elements
from .bonds import NEAREST, TOLERANCE, Indices, by_distance, sticks
from .boxes import Box, outline
from .errors import SceneError, unknown_name
from .glyphs import Glyphs, drawn
from .scene import ColorBar, Instances, Material, Scene, Shape, Spheres, Swatches, Vec3
from .spectra import decode_srgb
from .studio import framing

if TYPE_CHECKING:
    from .io import LoadOptions

Floats = NDArray[np.floating[Any]]

# Coordinates and radii stay below this, so that the light, some hundred times farther away than
# the particles, stays within single precision.
FARTHEST = 1e30

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


@dataclass(frozen=True, eq=False)
class Labels:
    """A name for each particle, stored once a kind: particle i is names[codes[i]].

    codes: (N,) integers. names: not each needs to be in use.
    """

    codes: NDArray[np.integer[Any]]
    names: tuple[str, ...]

    @staticmethod
    def of(values: ArrayLike) -> Labels:
        """The labels of N strings or numbers, which are shown as str() shows them."""
        names, codes = np.unique(np.asarray(values), return_inverse=True)
        return Labels(codes.reshape(-1), tuple(str(name) for name in names.tolist()))

    @staticmethod
    def of_numbers(values: NDArray[np.floating[Any]]) -> Labels:
        """The labels of N numbers, whole ones without a decimal point."""
        whole = np.trunc(values)
        if (values == whole).all() and (np.abs(values) < 2**31).all():
            numbers = whole.astype(np.int32)
            low = int(numbers.min(initial=0))
            if int(numbers.max(initial=0)) - low < 2**16:  # no need to sort them
                used = np.bincount(numbers - low) > 0
                names = tuple(str(low + k) for k in np.flatnonzero(used).tolist())
                return Labels((np.cumsum(used) - 1).astype(np.int32)[numbers - low], names)
            return Labels.of(numbers)
        return Labels.of(values)

    def each(self, values: NDArray[Any]) -> NDArray[Any]:
        """What belongs to each particle, (N, ...), of what belongs to each name."""
        return np.take(values, self.codes, axis=0)


def element_labels(labels: Labels) -> Labels | None:
    """The labels as symbols of elements, if every one in use says an element; else None.

    One that does not makes the others doubtful: "A" and "B" are types, not something and boron.
    """
    numbers = [elements.atomic_number(name) for name in labels.names]
    used = np.bincount(labels.codes, minlength=len(numbers)) > 0
    if any(number is None for number, use in zip(numbers, used, strict=True) if use):
        return None
    return Labels(labels.codes, tuple(elements.SYMBOLS[number or 0] for number in numbers))


@dataclass(frozen=True, eq=False)
class Copies:
    """Copies of some of N particles: of those that are True in (N,) `chosen`, one for each of the
    (M, 3, 4) matrices, a rotation and a translation.
    """

    chosen: NDArray[np.bool_]
    transforms: Floats


@dataclass(frozen=True, eq=False)
class Particles:
    """N particles as arrays, N > 0. Units are the data's own, angstrom where elements are known.

    positions: (N, 3). elements: their symbols, "X" for a dummy. types: any other sort of kind.
    radii: (N,). colors: (N, 3) linear RGB. fields: by name, (N,) or (N, M) numbers, or Labels.
    bonds: (B, 2) indices of particles, from 0; bonds_complete: False if distances tell of the bonds
    of particles that have none of these. alternates: (N,) numbers; distances tell of no bonds
    between particles of different ones, 0 apart. glyphs: what particles are instead of spheres.
    copies: what is drawn in the place of the particles themselves, if any. None stands for what is
    not known.
    Raises SceneError for arrays whose lengths differ, a position that is not finite, a radius that
    is not positive and a bond of a particle that is not there, naming the particle or bond, from 0.
    """

    positions: Floats
    elements: Labels | None = None
    types: Labels | None = None
    radii: Floats | None = None
    colors: Floats | None = None
    fields: Mapping[str, NDArray[Any] | Labels] = field(default_factory=dict)
    box: Box | None = None
    bonds: NDArray[np.integer[Any]] | None = None
    bonds_complete: bool = True
    alternates: NDArray[np.integer[Any]] | None = None
    glyphs: Glyphs | None = None
    copies: Sequence[Copies] = ()

    def __post_init__(self) -> None:
        """Checks what a scene needs; see the class."""
        shape = self.positions.shape
        if len(shape) != 2 or shape[1] != 3:
            raise SceneError(f"positions have shape {shape}, not (N, 3)")
        if not len(self.positions):
            raise SceneError("there are no particles")
        _check(
            self.positions,
            lambda p: np.abs(p) <= FARTHEST,  # False for NaN
            "position {} is not finite, or beyond 1e30",
        )
        lengths: dict[str, NDArray[Any] | Labels | None] = {
            "elements": self.elements,
            "types": self.types,
            "radii": self.radii,
            "colors": self.colors,
            "alternates": self.alternates,
            "glyphs": None if self.glyphs is None else self.glyphs.codes,
            **{f"copies[{i}]": copies.chosen for i, copies in enumerate(self.copies)},
            **{f"field {name!r}": values for name, values in self.fields.items()},
        }
        for name, values in lengths.items():
            array = values.codes if isinstance(values, Labels) else values
            if array is not None and len(array) != len(self.positions):
                raise SceneError(f"{name}: {len(array)} values for {len(self.positions)} particles")
        if self.radii is not None:
            _check_radii(self.radii)
        if self.colors is not None:
            _check(self.colors, lambda c: (c >= 0) & (c <= 1), "colour {} is not within [0, 1]")
        if self.bonds is not None:
            _check_bonds(self.bonds, len(self.positions))


def _check(values: Floats, good: Callable[[Floats], NDArray[np.bool_]], text: str) -> None:
    """Raises SceneError for the first particle whose values are not all good."""
    fine = good(values)
    if not fine.all():
        first = int(np.flatnonzero(~(fine if fine.ndim == 1 else fine.all(axis=1)))[0])
        shown = " ".join(f"{v:g}" for v in np.atleast_1d(values[first]).tolist())
        raise SceneError(f"particle {first}: {text.format(f'({shown})')}")


def _check_radii(radii: Floats) -> None:
    _check(
        radii,
        lambda r: (r.astype(np.float32, copy=False) > 0) & (r <= FARTHEST),
        "radius {} is not a positive number of single precision",
    )


def _check_bonds(bonds: NDArray[np.integer[Any]], count: int) -> None:
    if bonds.ndim != 2 or bonds.shape[1] != 2 or bonds.dtype.kind not in "iu":
        raise SceneError(
            f"bonds are {bonds.dtype} of shape {bonds.shape}, not (B, 2) indices of particles"
        )
    good = (bonds >= 0) & (bonds < count)
    if not good.all():
        bond, end = np.argwhere(~good)[0].tolist()
        raise SceneError(
            f"bond {bond} is of particle {bonds[bond, end]}; there are particles 0 to {count - 1}"
        )


# What to_scene, and the readers of files, ask of LoadOptions
OPTIONS = (
    "color_by", "colormap", "color_range", "radius", "style", "bond_length", "box", "wrap", "frame",
)  # fmt: skip

# How particles are drawn; the last two show bonds.
STYLES = ("spheres", "ball-and-stick", "licorice")
# The balls of ball-and-stick as a share of the spheres, and its sticks and those of licorice as a
# share of the median ball: of van der Waals radii the usual quarter, so that sticks among carbons
# are 0.15 and 0.25 angstrom; of covalent radii, and others with which neighbours touch, half; and
# of a number that the user gives.
_VDW = (0.25, 0.35, 0.6)
_TOUCHING = (0.5, 0.25, 0.45)
_GIVEN = (1.0, 0.35, 1.0)


def to_scene(particles: Particles, options: LoadOptions, name: str) -> Scene:
    """The particles as spheres, and a view of them.

    Raises SceneError for an option that these particles or Matplotlib do not have.
    """
    if options.color_by is None and (options.color_range or options.colormap != "viridis"):
        raise SceneError("a colour map or its range needs a field to colour by")
    if options.style not in STYLES:
        raise SceneError(unknown_name("style", options.style, STYLES))
    if options.style == "spheres" and options.bond_length is not None:
        raise SceneError("bond_length needs a style with bonds: ball-and-stick or licorice")
    if particles.box is None and (options.box or options.wrap):
        raise SceneError("there is no box to draw, or to wrap particles into")
    if particles.copies and options.wrap:
        raise SceneError("wrap would tear apart what an assembly puts together")
    if particles.copies and particles.glyphs is not None:
        raise SceneError("copies are of spheres and bonds, not of other bodies")
    if particles.box is not None and options.wrap:
        particles = replace(particles, positions=particles.box.wrapped(particles.positions))
    with np.errstate(over="ignore"):
        radii, stick = _radii(particles, options.radius, options.style)
        colors, legend = _colors(particles, options)
    # two-dimensional systems are looked at from straight above
    flat = np.ptp(particles.positions, axis=0)
    view = "top" if flat[2] == 0 and flat.max() > 0 else "default"
    bonds = None if options.style == "spheres" else (*_bonds(particles, options), stick)
    shapes: list[Shape] = []
    for copies in particles.copies:
        if copies.chosen.any() and len(copies.transforms):
            copied = _shapes(particles, copies.chosen, radii, colors, bonds)
            solids = [shape for shape in copied if not isinstance(shape, Instances)]
            shapes.append(Instances(solids, copies.transforms, "particles"))
    if not particles.copies:
        shapes += _shapes(particles, np.ones(len(radii), bool), radii, colors, bonds)
    if particles.box is not None and options.box:
        shapes += outline(particles.box)
    camera = framing((0.0, 0.0, 1.0), view)
    return Scene(shapes, camera=camera, background=None, name=name, legend=legend)


def _shapes(
    particles: Particles,
    chosen: NDArray[np.bool_],
    radii: Floats,
    colors: Floats,
    bonds: tuple[Indices, Floats, float] | None,
) -> list[Shape]:
    """What is drawn of the chosen particles, and of the bonds between them."""
    places = particles.positions
    shapes: list[Shape] = []
    balls = chosen
    if particles.glyphs is not None:
        shapes += drawn(particles.glyphs, places, colors, chosen)
        balls = chosen & particles.glyphs.spheres()
    if balls.any():
        own = slice(None) if balls.all() else balls  # not copied where that is not needed
        shapes.append(
            Spheres(places[own], radii[own], Material("diffuse"), colors[own], "particles")
        )
    if bonds is not None:
        pairs, ways, stick = bonds
        kept = chosen[pairs].all(axis=1)
        shapes += sticks(places, pairs[kept], ways[kept], colors, stick)
    return shapes


# ---------------------------------------------------------------------------------------------
# Radii


def _radii(particles: Particles, wanted: float | str | None, style: str) -> tuple[Floats, float]:
    """(N,) radii: the user's, the file's, the elements', or half the distance of neighbours; and
    that of sticks. Styles with bonds shrink all but a number that the user gives.
    """
    count = len(particles.positions)
    if wanted is None and particles.radii is None and particles.elements is not None:
        others = particles.elements.each(~elements.MOLECULAR[_numbers(particles.elements)])
        wanted = "covalent" if np.mean(others) > 0.25 else "vdw"
    tables = {"vdw": elements.VDW_RADII, "covalent": elements.COVALENT_RADII}
    ball, stick, licorice = _TOUCHING
    if wanted in tables:
        if particles.elements is None:
            raise SceneError(
                f"radius {wanted!r} needs elements, which are not known; give a number"
            )
        table = tables[str(wanted)].astype(np.float32)
        radii: Floats = particles.elements.each(table[_numbers(particles.elements)])
        ball, stick, licorice = _VDW if wanted == "vdw" else _TOUCHING
    elif wanted is not None:
        try:
            number = float(wanted)
        except ValueError:
            raise SceneError(f"{unknown_name('radius', wanted, tables)}, or a number") from None
        radii = np.full(count, _positive("radius", number), np.float32)
        ball, stick, licorice = _GIVEN
    elif particles.radii is not None:
        radii = particles.radii
    else:
        radii = np.full(count, 0.5 * neighbour_distance(particles.positions), np.float32)
    if style == "spheres":
        return radii, 0.0
    balls = ball * radii
    middle = float(np.median(balls))
    if style == "licorice":
        return np.full(count, licorice * middle, np.float32), licorice * middle
    # a ball hides the ends of its sticks
    return np.maximum(balls, stick * middle), stick * middle


def _positive(what: str, value: float) -> float:
    """A length that the user gave. Raises SceneError."""
    if not (isinstance(value, (int, float)) and 1e-37 < value <= FARTHEST):
        raise SceneError(f"{what} {value!r} is not a positive number of single precision")
    return value


def _numbers(labels: Labels) -> NDArray[np.intp]:
    """Atomic numbers of the names (not the particles) of element labels."""
    return np.array([elements.atomic_number(name) or 0 for name in labels.names], np.intp)


def neighbour_distance(positions: Floats) -> float:
    """The median distance from a particle to its nearest neighbour, estimated from a sample.

    Regions around a few particles, of some thousand particles each, are searched, so that the
    time grows with N only by a few passes over the coordinates. Coincident particles do not
    count. 1 where there are no two places.
    """
    random = np.random.default_rng(0)
    count = len(positions)
    regions, probes, most = 8, 64, 4096
    distances: list[NDArray[np.float64]] = []
    for center in positions[random.integers(count, size=regions)].astype(np.float64):
        near = positions
        if count > most:
            # the region's half-width, from a sparse look at all particles
            sparse = positions[random.integers(count, size=16384)] - center
            width = np.sort(np.abs(sparse).max(axis=1))[max(8, 16384 * most // count)]
            for axis in range(3):
                near = near[np.abs(near[:, axis] - center[axis]) <= width]
            if len(near) > 4 * most:  # many at one place
                near = near[random.integers(len(near), size=4 * most)]
        near = near.astype(np.float64)
        # the region's own centre has all of its neighbours in it, as has what is close to it
        away = np.abs(near - center).max(axis=1)
        chosen = np.argpartition(away, min(probes, len(near) - 1))[:probes]
        squares = np.zeros((len(chosen), len(near)))
        for axis in range(3):
            squares += (near[chosen, axis, None] - near[None, :, axis]) ** 2
        squares[squares == 0] = np.inf
        distances.append(np.sqrt(squares.min(axis=1)))
    found = np.concatenate(distances)
    found = found[np.isfinite(found)]
    return float(np.median(found)) if len(found) else 1.0


# ---------------------------------------------------------------------------------------------
# Bonds


def _bonds(particles: Particles, options: LoadOptions) -> tuple[Indices, Floats]:
    """(B, 2) pairs and the way from the first to the second of each, (B, 3): all that are nearer
    than the user says; else the file's, and what the elements' covalent radii tell.
    """
    positions, box = particles.positions, particles.box
    count = len(positions)
    if options.bond_length is not None:
        length = _positive("bond_length", options.bond_length)
        return by_distance(positions, np.full(count, 0.5 * length), 0.0, box)
    pairs, ways = np.empty((0, 2), np.intp), np.empty((0, 3))
    if particles.bonds is not None:
        pairs = particles.bonds.astype(np.intp)
        ways = np.subtract(positions[pairs[:, 1]], positions[pairs[:, 0]], dtype=np.float64)
        if box is not None:
            ways = box.shortest(ways)
        if particles.bonds_complete:
            return pairs, ways
    if particles.elements is None:
        raise SceneError(
            f"style {options.style!r} needs bonds: there are none, and no elements that tell of"
            " them; give bond_length"
        )
    numbers = particles.elements.each(_numbers(particles.elements))
    reach = np.where(numbers > 0, elements.COVALENT_RADII[numbers] + 0.5 * TOLERANCE, 0.0)
    more, more_ways = by_distance(positions, reach, NEAREST, box)
    known = np.zeros(count, bool)
    known[pairs.reshape(-1)] = True
    new = ~known[more].all(axis=1)
    if particles.alternates is not None:
        one, other = particles.alternates[more].T
        new &= (one == other) | (one == 0) | (other == 0)
    return np.concatenate([pairs, more[new]]), np.concatenate([ways, more_ways[new]])


# ---------------------------------------------------------------------------------------------
# Colours


def linear(srgb: ArrayLike) -> NDArray[np.float32]:
    """Linear Rec. 709 RGB of sRGB values: 8-bit integers, or numbers within [0, 1]."""
    values = np.asarray(srgb)
    return decode_srgb(values / 255.0 if values.dtype == np.uint8 else values.astype(np.float64))


def _colors(
    particles: Particles, options: LoadOptions
) -> tuple[NDArray[np.float32], ColorBar | Swatches | None]:
    """(N, 3) linear RGB: of the field that the user names, else the file's, else of the kinds; and
    what they stand for.
    """
    if options.color_by is not None:
        values = _field(particles, options.color_by)
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
    return _kinds(labels, _WHITEST * linear(elements.COLORS[_numbers(labels)]), "element")


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
    return Swatches(
        label, tuple(sorted(kinds.items(), key=lambda k: (len(k[0]) * k[0].isdecimal(), k[0])))
    )


def _field(particles: Particles, name: str) -> NDArray[Any] | Labels:
    """A field by name: (N,) numbers or Labels. Of an (N, M) field f, "f" is its length and
    "f_x", "f_y", "f_z" (where M = 3) or "f_1" ... "f_M" are its components.
    """
    # name -> array and, of one with rows, the column
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
    if name not in known:
        raise SceneError(unknown_name("field to colour by", name, known))
    found, column = known[name]
    if isinstance(found, Labels) or found.ndim == 1:
        return found
    return np.asarray(np.linalg.norm(found, axis=1) if column is None else found[:, column])


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
