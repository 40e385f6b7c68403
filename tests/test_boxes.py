"""The simulation box: drawn, and particles moved into it."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import io
from parhelion.framing import bounds, placed
from parhelion.io import LoadOptions
from parhelion.particles import Particles, to_scene
from parhelion.particles.boxes import Box
from parhelion.studio import dressed

TILTED = np.array([[6.0, 0, 0], [2, 5, 0], [-1, 3, 4]])
ORIGIN = np.array([10.0, -3, 1])


def scene(particles: Particles, **options: Any) -> ph.Scene:
    made = to_scene(particles, LoadOptions(**options), "test")
    ph.prepare(made)
    return made


def test_twelve_edges_of_a_tilted_box() -> None:
    particles = Particles(np.array([[11.0, 0, 2]]), box=Box(TILTED, ORIGIN))
    _, edges, corners = scene(particles, box=True).shapes
    assert {edges.name, corners.name} == {"box"}
    everywhere = [ORIGIN + np.array(n) @ TILTED for n in product((0, 1), repeat=3)]
    assert_allclose(np.sort(corners.centers, axis=0), np.sort(everywhere, axis=0))
    assert corners.radii == edges.radii == 0.0035 * np.linalg.norm(TILTED, axis=1).mean()
    ways = np.subtract(edges.ends, edges.starts)
    for vector in TILTED:
        assert np.isclose(ways, vector).all(axis=1).sum() == 4
    # each corner is the end of three
    ends = np.round(np.concatenate([edges.starts, edges.ends]), 9)
    assert_array_equal(np.unique(ends, axis=0, return_counts=True)[1], [3] * 8)
    assert len(np.unique(np.concatenate([edges.starts, edges.ends], axis=1), axis=0)) == 12


@pytest.mark.parametrize("thickness", [0.0, 1e-9, 1e-3])
def test_a_flat_box_has_four_edges(thickness: float) -> None:
    """Also one that is thinner than its edges are drawn."""
    flat = Box(np.diag([3.0, 2, thickness]), np.zeros(3))
    square = np.array([[0.0, 0, 0], [1, 1, 0]])
    made = scene(Particles(square, box=flat), box=True)
    _, edges, corners = made.shapes
    lengths = np.linalg.norm(np.subtract(edges.ends, edges.starts), axis=1)
    assert_array_equal(np.unique(lengths), [2, 3])
    assert len(corners.centers) == 4
    assert made.camera.direction == (0, 0, 1)  # type: ignore[union-attr]


def test_the_whole_box_is_in_the_picture() -> None:
    """And a box that particles fill changes the view little."""
    positions = np.random.default_rng(0).uniform(0, 9, (500, 3))
    box = Box(9 * np.eye(3), np.zeros(3))
    plain = dressed(scene(Particles(positions)), bare=True)
    boxed = dressed(scene(Particles(positions, box=box), box=True), bare=True)
    low, high = bounds(boxed)
    assert low.max() < 0
    assert high.min() > 9
    distances = [
        np.linalg.norm(np.subtract(c.eye, c.target))
        for c in (placed(s, 1.5) for s in (plain, boxed))
    ]
    assert 1 / 1.1 < distances[0] / distances[1] < 1.1


@pytest.mark.parametrize(
    "periodic", [(True, True, True), (True, False, True), (False, True, False)]
)
def test_wrapped_positions_are_copies_within_the_box(periodic: tuple[bool, bool, bool]) -> None:
    positions = np.random.default_rng(0).normal(size=(100, 3)) * 20
    positions[:8] = [ORIGIN + np.array(n) @ TILTED for n in product((0, 1), repeat=3)]
    box = Box(TILTED, ORIGIN, periodic)
    wrapped = np.asarray(scene(Particles(positions, box=box), wrap=True).shapes[0].centers)
    steps = (wrapped - positions) @ np.linalg.inv(TILTED)
    assert_allclose(steps, np.round(steps), atol=1e-9)
    assert_allclose(steps[:, ~np.array(periodic)], 0, atol=1e-9)
    if all(periodic):
        places = (wrapped - ORIGIN) @ np.linalg.inv(TILTED)
        assert places.min() > -1e-6
        assert places.max() < 1
        assert_allclose(wrapped[:8], np.tile(ORIGIN, (8, 1)), atol=1e-9)
    assert_array_equal(box.wrapped(wrapped), wrapped)


def test_bonds_follow_wrapped_particles() -> None:
    chain = np.column_stack([np.arange(9.0), np.zeros((9, 2))]) + 0.5
    box = Box(4 * np.eye(3), np.zeros(3))
    bonds = np.column_stack([np.arange(8), np.arange(1, 9)])
    options: Any = {"style": "licorice", "wrap": True}
    balls, tubes, caps = scene(Particles(chain, box=box, bonds=bonds), **options).shapes
    assert np.asarray(balls.centers).max() < 4
    assert_allclose(np.linalg.norm(np.subtract(tubes.ends, tubes.starts), axis=1), 0.5)
    assert_allclose(np.unique(np.asarray(caps.centers)[:, 0]), [0, 4])


@pytest.mark.parametrize(
    ("box", "options", "words"),
    [
        (None, {"box": True}, "there is no box to draw"),
        (None, {"wrap": True}, "there is no box to draw, or to wrap"),
        (Box(np.eye(3), np.zeros(3), (False,) * 3), {"wrap": True}, "the box is not periodic"),
        (Box(np.ones((3, 3)), np.zeros(3)), {"wrap": True}, "the box is flat"),
        (Box(np.zeros((3, 3)), np.zeros(3)), {"box": True}, "the box has no extent"),
        (Box(np.diag([1, 1, np.inf]), np.zeros(3)), {"box": True}, "the box is not finite"),
        (Box(np.eye(3) * np.nan, np.zeros(3)), {"wrap": True}, "the box is not finite"),
        (Box(np.eye(3), np.full(3, np.nan)), {"box": True}, "the box is not finite"),
    ],
)
def test_refused(box: Box | None, options: Any, words: str) -> None:
    with pytest.raises(ph.SceneError, match=words):
        scene(Particles(np.zeros((1, 3)), box=box), **options)


@pytest.mark.parametrize(
    ("name", "volume"),
    [
        ("chemfiles/lammps/nacl.lammpstrj", 22.560801**3),
        ("chemfiles/pdb/4hhb.pdb", 63.15 * 83.59 * 53.8 * np.sin(np.radians(99.34))),
        ("chemfiles/gro/1vln-triclinic.gro", None),
        ("gsd/lj.gsd", 20.0**3),
    ],
)
def test_boxes_of_real_files(shared_scenes: Path, name: str, volume: float | None) -> None:
    for package in {"pdb": ["chemfiles"], "gro": ["chemfiles"], "gsd": ["gsd"]}.get(
        name.rpartition(".")[2], []
    ):
        pytest.importorskip(package)
    path = shared_scenes / "particles" / name
    shapes = io.load(path, LoadOptions(box=True)).shapes
    (edges,) = (s for s in shapes if s.name == "box" and isinstance(s, ph.Cylinders))
    ways = np.subtract(edges.ends, edges.starts)
    found = abs(np.linalg.det(ways[[0, 4, 8]]))
    if volume is None:
        assert np.abs(ways[8, :2]).max() > 1  # triclinic
    else:
        assert_allclose(found, volume, rtol=1e-4)


def test_ase_and_mdanalysis() -> None:
    ase = pytest.importorskip("ase")
    atoms = ase.Atoms("C", positions=[[-1, 0, 0]], cell=TILTED, pbc=(True, False, False))
    shapes = ph.scene_of(atoms, box=True, wrap=True).shapes
    assert_allclose(shapes[0].centers, [[5, 0, 0]])
    assert len(shapes[1].starts) == 12
    mda = pytest.importorskip("MDAnalysis")
    universe = mda.Universe.empty(1, trajectory=True)
    universe.dimensions = [6, 5, 4, 80, 70, 60]
    edges = ph.scene_of(universe, box=True).shapes[1]
    expected = mda.lib.mdamath.triclinic_vectors(universe.dimensions)
    assert_allclose(
        np.subtract(edges.ends, edges.starts)[[0, 4, 8]], expected, rtol=1e-5, atol=1e-6
    )
