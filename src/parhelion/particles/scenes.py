"""The scene that particles make: spheres and other bodies, bonds, a box, and a view of them.

What is chosen when the user says nothing is described, with its reasons, in docs/particles.md.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError, option, unknown_name
from ..scene import Instances, Material, Scene, Shape, Spheres
from ..studio import framing
from . import elements
from .bonds import NEAREST, TOLERANCE, Indices, by_distance, sticks
from .boxes import outline
from .colors import colors_of
from .data import Particles, atomic_numbers
from .glyphs import drawn
from .limits import FARTHEST, SMALLEST, Floats

if TYPE_CHECKING:
    from ..io import LoadOptions

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
        raise SceneError(
            f"{option('bond_length')} needs a style with bonds: ball-and-stick or licorice"
        )
    if particles.box is None and (options.box or options.wrap):
        raise SceneError("there is no box to draw, or to wrap particles into")
    if particles.copies and options.wrap:
        raise SceneError(f"{option('wrap')} would tear apart what an assembly puts together")
    if particles.copies and particles.glyphs is not None:
        raise SceneError("copies are of spheres and bonds, not of other bodies")
    if particles.box is not None and options.wrap:
        particles = replace(particles, positions=particles.box.wrapped(particles.positions))
    with np.errstate(over="ignore"):
        radii, stick = _radii(particles, options.radius, options.style)
        colors, legend = colors_of(particles, options)
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
        others = particles.elements.each(~elements.MOLECULAR[atomic_numbers(particles.elements)])
        wanted = "covalent" if np.mean(others) > 0.25 else "vdw"
    tables = {"vdw": elements.VDW_RADII, "covalent": elements.COVALENT_RADII}
    ball, stick, licorice = _TOUCHING
    if wanted in tables:
        if particles.elements is None:
            raise SceneError(
                f"{option('radius')} {wanted!r} needs elements, which are not known; give a number"
            )
        table = tables[str(wanted)].astype(np.float32)
        radii: Floats = particles.elements.each(table[atomic_numbers(particles.elements)])
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
    if not (isinstance(value, (int, float)) and SMALLEST < value <= FARTHEST):
        raise SceneError(f"{option(what)} {value!r} is not a positive number of single precision")
    return value


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
            f"{option('style')} {options.style!r} needs bonds: there are none, and no elements that"
            f" tell of them; give {option('bond_length')}"
        )
    numbers = particles.elements.each(atomic_numbers(particles.elements))
    reach = np.where(numbers > 0, elements.COVALENT_RADII[numbers] + 0.5 * TOLERANCE, 0.0)
    more, more_ways = by_distance(positions, reach, NEAREST, box)
    known = np.zeros(count, bool)
    known[pairs.reshape(-1)] = True
    new = ~known[more].all(axis=1)
    if particles.alternates is not None:
        one, other = particles.alternates[more].T
        new &= (one == other) | (one == 0) | (other == 0)
    return np.concatenate([pairs, more[new]]), np.concatenate([ways, more_ways[new]])
