"""Bonds of particles: which there are, also across a periodic box, and how they are drawn."""

from __future__ import annotations

import logging
import time
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import io
from parhelion.io import LoadOptions
from parhelion.particles import Labels, Particles, to_scene
from parhelion.particles.bonds import by_distance
from parhelion.particles.boxes import Box, reduced
from parhelion.scene import Cylinders, Disks

BOXES = [
    np.diag([3.0, 4.0, 5.0]),
    np.array([[3, 0, 0], [1.4, 4, 0], [-1.3, 2.1, 3.3]]),
    np.array([[3, 0, 0], [7.5, 4, 0], [20, -9, 3.3]]),  # of the lattice below
]
SQUARER = np.array([[3, 0, 0], [1.5, 4, 0], [-1, -1, 3.3]])
DIAMOND = np.array(
    [[0, 0, 0], [0, 2, 2], [2, 0, 2], [2, 2, 0], [1, 1, 1], [1, 3, 3], [3, 1, 3], [3, 3, 1]]
)
EDGE = 3.567  # of diamond's cell, angstrom


def drawn(particles: Particles, **options: Any) -> list[Any]:
    options = {"style": "ball-and-stick"} | options
    scene = to_scene(particles, LoadOptions(**options), "test")
    ph.prepare(scene)
    return list(scene.shapes)


def carbons(positions: Any, **more: Any) -> Particles:
    positions = np.asarray(positions, float)
    return Particles(positions, Labels(np.zeros(len(positions), int), ("C",)), **more)


# ---------------------------------------------------------------------------------------------
# Boxes


@pytest.mark.parametrize("vectors", BOXES)
def test_the_nearest_copy_is_found_in_any_box(vectors: Any) -> None:
    differences = np.random.default_rng(0).normal(size=(50, 3)) * 10
    lattice = SQUARER if vectors[2, 0] == 20 else vectors
    all_copies = [
        np.linalg.norm(differences + np.array(n) @ lattice, axis=1)
        for n in product(range(-16, 17), repeat=3)
    ]
    found = Box(vectors, np.zeros(3)).shortest(differences)
    assert_allclose(np.linalg.norm(found, axis=1), np.min(all_copies, axis=0))
    steps = (found - differences) @ np.linalg.inv(vectors)
    assert_allclose(steps, np.round(steps), atol=1e-9)


def test_only_periodic_edges_count() -> None:
    box = Box(np.diag([3.0, 4, 0]), np.zeros(3), (True, False, True))
    assert_array_equal(box.lattice(), [[3, 0, 0]])
    assert_allclose(box.shortest(np.array([[2.0, 3, 9]])), [[-1, 3, 9]])
    nothing = Box(np.zeros((3, 3)), np.zeros(3))
    assert_array_equal(nothing.shortest(np.array([[2.0, 3, 9]])), [[2, 3, 9]])


def test_a_lattice_is_reduced() -> None:
    assert_allclose(np.abs(reduced(BOXES[2])), np.abs(SQUARER))
    fcc = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / 2
    skewed = np.array([[1, 0, 0], [40, 1, 0], [-7, 90, 1]]) @ fcc
    assert_allclose(np.linalg.norm(reduced(skewed), axis=1), np.sqrt(0.5))


@pytest.mark.parametrize(
    ("vectors", "words"),
    [
        ([[1, 0, 0], [2, 0, 0], [0, 0, 1]], "the box is flat"),
        ([[1, 0, 0], [0, 1, 0], [1, 1, 0]], "the box is flat"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, np.nan]], "the box is not finite"),
    ],
)
def test_boxes_without_volume_are_refused(vectors: Any, words: str) -> None:
    box = Box(np.array(vectors, float), np.zeros(3))
    with pytest.raises(ph.SceneError, match=words):
        drawn(carbons([[0, 0, 0], [0, 0, 1.5]], box=box))
    # but do not matter where nobody needs them
    to_scene(carbons([[0, 0, 0]], box=box), LoadOptions(), "test")


# ---------------------------------------------------------------------------------------------
# Which bonds there are


@pytest.mark.parametrize("vectors", BOXES)
@pytest.mark.parametrize("periodic", [(True, True, True), (True, True, False), (False,) * 3])
def test_pairs_are_those_that_trying_all_finds(vectors: Any, periodic: Any) -> None:
    random = np.random.default_rng(1)
    positions, reach = random.uniform(-4, 8, (40, 3)), random.uniform(0.2, 0.9, 40)
    reach[::7] = 0.0
    lattice = vectors[list(periodic)]
    pairs, ways = by_distance(positions, reach, 0.3, Box(vectors, np.array([1, 2, -1]), periodic))
    found = {
        (i, j, *np.round(w, 6).tolist()) for (i, j), w in zip(pairs.tolist(), ways, strict=True)
    }
    found |= {
        (j, i, *np.round(-w, 6).tolist()) for (i, j), w in zip(pairs.tolist(), ways, strict=True)
    }
    if len(lattice) == 3 and vectors[2, 0] == 20:
        lattice = SQUARER
    expected = set()
    for steps in product(range(-9, 10), repeat=len(lattice)):
        all_ways = positions + np.array(steps) @ lattice - positions[:, None]
        lengths = np.linalg.norm(all_ways, axis=2)
        near = (lengths < reach[:, None] + reach) & (lengths > 0.3) & (reach[:, None] * reach > 0)
        for i, j in np.argwhere(near).tolist():
            expected.add((i, j, *np.round(all_ways[i, j], 6).tolist()))
    assert len(expected) > 5
    assert found == expected
    assert 2 * len(pairs) == len(found)  # each once


def test_carbons_of_diamond_have_four_bonds_each() -> None:
    cell = Box(EDGE * np.eye(3), np.zeros(3))
    _, tubes, caps = drawn(carbons(DIAMOND * EDGE / 4, box=cell))
    lengths = np.linalg.norm(np.subtract(tubes.ends, tubes.starts), axis=1)
    assert_allclose(lengths, EDGE * np.sqrt(3) / 8)
    assert_array_equal(np.unique(tubes.starts, axis=0, return_counts=True)[1], [4] * 8)
    # without copies those of (1, 1, 1) have theirs, and the others those that lie within
    _, alone = drawn(carbons(DIAMOND * EDGE / 4))
    assert len(alone.starts) == len(tubes.starts) - len(caps.centers)
    assert_array_equal(np.unique(alone.starts, axis=0, return_counts=True)[1].max(), 4)


def test_a_particle_is_bonded_to_its_own_copies() -> None:
    """Iron has one atom in its primitive cell, and 8 neighbours at sqrt(3) / 2 of the cube."""
    cell = 2.866 / 2 * np.array([[-1.0, 1, 1], [1, -1, 1], [1, 1, -1]])
    iron = Particles(np.ones((1, 3)), Labels(np.array([0]), ("Fe",)), box=Box(cell, np.zeros(3)))
    _, tubes, caps = drawn(iron, bond_length=2.6)
    assert len(tubes.starts) == len(caps.centers) == 8
    assert_allclose(np.linalg.norm(np.subtract(tubes.ends, 1), axis=1), 2.866 * np.sqrt(3) / 4)
    assert_array_equal(tubes.ends, caps.centers)


def test_elements_tell_of_bonds() -> None:
    """O-H is bonded up to 0.66 + 0.31 + 0.45 angstrom; dummy atoms never are."""
    names = ("O", "H", "X")
    water = np.array([[0, 0, 0], [0, 0.757, 0.587], [0, -0.757, 0.587], [0.0, 0, 0.15]])
    found = drawn(Particles(water, Labels(np.array([0, 1, 1, 2]), names)))
    assert len(found[1].starts) == 4
    for distance, bonded in ((0.39, False), (0.41, True), (1.41, True), (1.43, False)):
        pair = Particles(np.array([[0, 0, 0], [0, 0, distance]]), Labels(np.array([0, 1]), names))
        assert (len(drawn(pair)) == 2) == bonded


def test_bonds_of_the_file_come_first() -> None:
    positions = [[0, 0, 0], [0, 0, 1.5], [0, 0, 3.0], [9, 0, 0], [9, 0, 1.5]]
    own = np.array([[0, 2]])
    assert_allclose(drawn(carbons(positions, bonds=own))[1].ends, [[0, 0, 1.5], [0, 0, 1.5]])
    # one that has a bond needs no other, as in residues whose bonds are known
    more = carbons(positions, bonds=np.array([[0, 1], [1, 2]], np.uint32), bonds_complete=False)
    assert len(drawn(more)[1].starts) == 2 * 3
    assert len(drawn(carbons(positions))[1].starts) == 2 * 3
    assert len(drawn(carbons(positions, bonds=own), bond_length=3.1)[1].starts) == 2 * 4
    nothing = carbons(positions, bonds=np.empty((0, 2), int))
    assert len(drawn(nothing)) == 1


def test_a_million_would_be_found_in_seconds() -> None:
    """Today's figure is 3.5 s for a million in a periodic box; a loop over atoms takes minutes."""
    positions = np.random.default_rng(0).uniform(0, 100, (100_000, 3))
    start = time.perf_counter()
    pairs, ways = by_distance(
        positions, np.full(100_000, 0.5), 0.0, Box(100 * np.eye(3), np.zeros(3))
    )
    assert time.perf_counter() - start < 4
    # an ideal gas of density 0.1 has 4/3 pi 0.1 neighbours within 1
    assert_allclose(2 * len(pairs) / 100_000, 4 / 3 * np.pi * 0.1, rtol=0.01)
    assert np.linalg.norm(ways, axis=1).max() < 1


# ---------------------------------------------------------------------------------------------
# How they are drawn


def test_each_half_has_its_atoms_colour() -> None:
    colors = np.array([[1.0, 0, 0], [0, 0, 1]])
    pair = carbons([[1, 2, 3], [1, 2, 4.5]], colors=colors)
    balls, tubes = drawn(pair)
    assert isinstance(tubes, Cylinders)
    assert_allclose(tubes.starts, [[1, 2, 3], [1, 2, 4.5]])
    assert_allclose(tubes.ends, [[1, 2, 3.75]] * 2)
    assert_array_equal(tubes.colors, colors)
    # a quarter of Bondi's 1.70, and sticks of 0.35 of that; or 0.6 of it all over
    assert_allclose(balls.radii, 0.425)
    assert_allclose(tubes.radii, 0.35 * 0.425)
    balls, tubes = drawn(pair, style="licorice")
    assert_allclose(balls.radii, 0.255)
    assert_allclose(tubes.radii, 0.255)


@pytest.mark.parametrize(
    ("options", "ball", "stick"),
    [
        ({"radius": 0.3}, 0.3, 0.105),
        ({"radius": "covalent"}, 0.38, 0.095),
        ({"radius": 0.3, "style": "licorice"}, 0.3, 0.3),
    ],
)
def test_radii_that_are_asked_for(options: Any, ball: float, stick: float) -> None:
    balls, tubes = drawn(carbons([[0, 0, 0], [0, 0, 1.5]]), **options)
    assert_allclose([*balls.radii, tubes.radii], [ball, ball, stick], rtol=1e-6)


def test_balls_hide_the_ends_of_their_sticks() -> None:
    radii = np.array([0.1, 2, 2])
    balls, tubes = drawn(carbons([[0, 0, 0], [0, 0, 1.5], [5, 0, 0]], radii=radii))
    assert_allclose(balls.radii, [0.25, 1, 1])
    assert_allclose(tubes.radii, 0.25)


@pytest.mark.parametrize("of_file", [True, False])
def test_a_bond_through_the_box_is_not_drawn_across_the_picture(of_file: bool) -> None:
    box = Box(np.diag([10.0, 10, 10]), np.zeros(3))
    bonds = np.array([[0, 1]]) if of_file else None
    pair = carbons([[0.5, 5, 5], [9.5, 5, 5]], box=box, bonds=bonds)
    _, tubes, caps = drawn(pair)
    assert_allclose(np.sort(np.ravel(tubes.ends)[::3]), [0, 10])
    assert_allclose(np.linalg.norm(np.subtract(tubes.ends, tubes.starts), axis=1), 0.5)
    assert isinstance(caps, Disks)
    front = np.cross(caps.axis_u, caps.axis_v)
    outwards = np.subtract(tubes.ends, tubes.starts)
    assert np.all(np.sum(front * outwards, axis=1) > 0)
    # a molecule that is whole, and sticks out of the box, is drawn whole
    _, tubes, *caps = drawn(carbons([[0.5, 5, 5], [-0.5, 5, 5]], box=box, bonds=bonds))
    assert_allclose(tubes.ends, [[0, 5, 5]] * 2)
    assert not caps


def test_bonds_of_no_length_are_left_out() -> None:
    twins = carbons([[1, 1, 1], [1, 1, 1], [1, 1, 2.5]], bonds=np.array([[0, 1], [1, 1], [1, 2]]))
    assert len(drawn(twins)[1].starts) == 2


@pytest.mark.parametrize(
    ("particles", "options", "words"),
    [
        ({}, {"style": "sticks"}, "unknown style 'sticks'.*ball-and-stick, licorice, spheres"),
        ({}, {"style": "spheres", "bond_length": 2}, "bond_length needs a style with bonds"),
        ({}, {"bond_length": -1}, "bond_length -1 is not a positive"),
        ({}, {"bond_length": "long"}, "bond_length is 'long'; must be a number"),
        ({"elements": None}, {}, "'ball-and-stick' needs bonds: .* give bond_length"),
        ({"bonds": np.array([[0, 1], [1, 3]])}, {}, "bond 1 is of particle 3; .* 0 to 2"),
        ({"bonds": np.array([[0, -1]])}, {}, "bond 0 is of particle -1"),
        ({"bonds": np.array([[0.0, 1]])}, {}, "bonds are float64 of shape"),
        ({"bonds": np.array([0, 1])}, {}, r"not \(B, 2\) indices"),
        ({"box": Box(1e-3 * np.eye(3), np.zeros(3))}, {}, "the box is only 0.001 wide"),
    ],
)
def test_refused(particles: Any, options: Any, words: str) -> None:
    made = {"elements": Labels(np.zeros(3, int), ("C",))} | particles
    with pytest.raises(ph.SceneError, match=words):
        drawn(Particles(np.arange(9.0).reshape(3, 3), **made), **options)


@pytest.mark.parametrize("spread", [0.0, 1e-3, 8.0])
def test_dense_clouds_are_refused_early(spread: float) -> None:
    """Half a million particles at one place have 1e11 pairs, whether these are bonds or not."""
    cloud = np.random.default_rng(0).uniform(0, spread, (500_000, 3))
    start = time.perf_counter()
    with pytest.raises(ph.SceneError, match=r"too dense|more than 16 bonds a particle"):
        drawn(carbons(cloud))
    assert time.perf_counter() - start < 4


# ---------------------------------------------------------------------------------------------
# From files and other libraries' objects

PDB = (
    "CRYST1   10.000   10.000   10.000  90.00  90.00  90.00 {group}\n"
    "HETATM   11  C1  XYZ A   1       1.000   1.000   1.000  1.00  0.00           C  \n"
    "HETATM   12  C2  XYZ A   1       1.000   1.000   5.000  1.00  0.00           C  \n"
    "HETATM   15  C3  XYZ A   1       9.500   1.000   5.000  1.00  0.00           C  \n"
    "CONECT   11   12   99\n"
    "CONECT   12   11\n"
    "END\n"
)


@pytest.mark.parametrize(("group", "whole"), [("P 1", True), ("P 21 21 21", False), ("", True)])
def test_pdb(tmp_path: Path, caplog: pytest.LogCaptureFixture, group: str, whole: bool) -> None:
    pytest.importorskip("chemfiles")
    path = tmp_path / "a.pdb"
    text = PDB.format(group=f"{group:11}   4")
    lines = text.splitlines(keepends=True)
    for content in (text, "".join([lines[4], *lines[:4], *lines[5:]])):  # chemfiles would crash
        path.write_text(content)
        with caplog.at_level(logging.INFO, "parhelion"):
            shapes = io.load(path, LoadOptions(style="licorice")).shapes
        lengths = np.linalg.norm(np.subtract(shapes[1].ends, shapes[1].starts), axis=1)
        # what is 1.5 apart through the box is bonded if the box holds all that there is
        assert_allclose(np.unique(lengths.round(6)), [0.75, 2] if whole else [2])
        assert "1 bonds in CONECT are of atoms that are not there" in caplog.text


def test_alternate_locations_are_not_bonded_to_each_other(tmp_path: Path) -> None:
    """A serine whose side chain is in one of two places: chemfiles knows the bonds of one."""
    pytest.importorskip("chemfiles")
    places = {
        "N   ": (10, 10, 10), "CA  ": (11.458, 10, 10), "C   ": (12.009, 11.42, 10),
        "CB A": (11.986, 9.231, 11.212), "CB B": (11.9, 9.3, 11.3),
        "OG A": (11.522, 7.891, 11.172), "OG B": (13.3, 9.2, 11.35),
    }  # fmt: skip
    path = tmp_path / "a.pdb"
    path.write_text(
        "".join(
            f"ATOM  {i:5d}  {name}SER A   1    {x:8.3f}{y:8.3f}{z:8.3f}  0.50  0.00{name[0]:>12}\n"
            for i, (name, (x, y, z)) in enumerate(places.items(), start=1)
        )
    )
    tubes: Any = io.load(path, LoadOptions(style="licorice")).shapes[1]
    names = {tuple(np.round(place, 3)): name for name, place in places.items()}
    half = len(tubes.starts) // 2
    found = {
        frozenset((names[tuple(np.round(a, 3))], names[tuple(np.round(b, 3))]))
        for a, b in zip(tubes.starts[:half], tubes.starts[half:], strict=True)
    }
    assert found == {
        frozenset(pair)
        for pair in [
            ("N   ", "CA  "), ("CA  ", "C   "), ("CA  ", "CB A"), ("CA  ", "CB B"),
            ("CB A", "OG A"), ("CB B", "OG B"),
        ]
    }  # fmt: skip


def test_a_box_of_one_angstrom_is_none(tmp_path: Path) -> None:
    pytest.importorskip("chemfiles")
    from parhelion.io import chemfiles_file

    path = tmp_path / "a.pdb"
    path.write_text(PDB.replace("10.000", " 1.000").format(group="P 1"))
    assert chemfiles_file.read(path).box is None


def test_haemoglobin_and_molecules(shared_scenes: Path) -> None:
    """Bonds of residues are known; each haem's iron has four nitrogens, and one of a histidine."""
    pytest.importorskip("chemfiles")
    pytest.importorskip("gsd")
    from parhelion.io import chemfiles_file, gsd_file

    found = chemfiles_file.read(shared_scenes / "particles/chemfiles/pdb/4hhb.pdb")
    assert found.bonds is not None
    assert found.elements is not None
    irons = np.flatnonzero(found.elements.codes == 26)
    assert np.all(np.isin(found.bonds, irons).any(axis=1).sum() >= 4 * 4)
    _, tubes = drawn(found)
    assert np.linalg.norm(np.subtract(tubes.ends, tubes.starts), axis=1).max() < 1.5
    path = shared_scenes / "particles/gsd/molecules.gsd"
    assert np.shape(gsd_file.read(path).bonds) == (486, 2)
    shapes = io.load(path, LoadOptions(style="ball-and-stick")).shapes
    lengths = np.linalg.norm(np.subtract(shapes[1].ends, shapes[1].starts), axis=1)
    assert len(lengths) == 2 * 486
    assert lengths.max() < 1  # the box is 9 wide


def test_boundaries_of_boxes(tmp_path: Path) -> None:
    from parhelion.io import lammps, npz, xyz

    dump = (
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\nITEM: BOX BOUNDS{}\n0 1{}\n0 1{}\n0 1{}\n"
        "ITEM: ATOMS x y z\n0 0 0\n"
    )
    cases = [
        ("", "", (True,) * 3),
        (" pp ff ps", "", (True, False, False)),
        (" xy xz yz ss pp fm", " 0", (False, True, False)),
        (" xy xz yz", " 0", (True,) * 3),
    ]
    for i, (flags, tilt, periodic) in enumerate(cases):
        path = tmp_path / f"{i}.dump"
        path.write_text(dump.format(flags, tilt, tilt, tilt))
        box = lammps.read(path).box
        assert box is not None
        assert box.periodic == periodic
    path = tmp_path / "a.xyz"
    for pbc, periodic in [("", (True,) * 3), ('pbc="T F F"', (True, False, False))]:
        path.write_text(f'1\nLattice="1 0 0 0 1 0 0 0 1" {pbc}\nC 0 0 0\n')
        box = xyz.read(path).box
        assert box is not None
        assert box.periodic == periodic
    path.write_text('1\nLattice="1 0 0 0 1 0 0 0 1" pbc="T maybe F"\nC 0 0 0\n')
    with pytest.raises(ph.FormatError, match="line 2: pbc='T maybe F' is not three of T and F"):
        xyz.read(path)
    np.savez(
        tmp_path / "a.npz",
        positions=np.arange(9.0).reshape(3, 3),
        box=np.ones(3),
        periodic=np.array([True, True, False]),
        bonds=np.array([[0, 2]]),
    )
    found = npz.read(tmp_path / "a.npz")
    assert found.box is not None
    assert found.box.periodic == (True, True, False)
    assert_array_equal(found.bonds, [[0, 2]])  # type: ignore[arg-type]


def test_ase_and_mdanalysis() -> None:
    class Atoms(SimpleNamespace):
        def __len__(self) -> int:
            return len(self.positions)

    atoms = Atoms(
        positions=np.array([[0.5, 5, 5], [9.5, 5, 5], [5, 5, 5]], np.float32),
        elements=np.array(["C", "C", "C"], object),
        dimensions=np.array([10, 10, 10, 90, 90, 60], np.float32),
        indices=np.array([7, 3, 5]),
        bonds=np.array([[3, 7], [5, 9]]),
    )
    atoms.atoms = atoms
    tubes = ph.scene_of(atoms, style="ball-and-stick").shapes[1]
    assert_allclose(np.linalg.norm(np.subtract(tubes.ends, tubes.starts), axis=1), 0.5)
    ase = pytest.importorskip("ase")
    crystal = ase.Atoms("C8", scaled_positions=DIAMOND / 4, cell=[EDGE] * 3, pbc=(True, True, True))
    assert len(ph.scene_of(crystal, style="licorice").shapes[1].starts) == 32
    crystal.pbc = False
    assert len(ph.scene_of(crystal, style="licorice").shapes[1].starts) < 32


def test_bonds_of_ases_lammps_data(tmp_path: Path) -> None:
    ase_io = pytest.importorskip("ase.io")
    path = tmp_path / "a.data"
    path.write_text(
        "x\n\n3 atoms\n1 bonds\n1 atom types\n1 bond types\n0 10 xlo xhi\n0 10 ylo yhi\n"
        "0 10 zlo zhi\n\nMasses\n\n1 12.0\n\nAtoms # molecular\n\n1 1 1 1 5 5\n2 1 1 9 5 5\n"
        "3 1 1 2 5 5\n\nBonds\n\n1 1 1 2\n"
    )
    atoms = ase_io.read(path, format="lammps-data")
    tubes = ph.scene_of(atoms, style="ball-and-stick").shapes[1]
    assert_allclose(np.sort(np.ravel(tubes.ends)[::3]), [0, 10])  # through the box


def test_mdanalysis() -> None:
    mda = pytest.importorskip("MDAnalysis")
    universe = mda.Universe.empty(4, trajectory=True)
    universe.add_TopologyAttr("names", ["C1", "C2", "C3", "C4"])
    universe.atoms.positions = [[0, 0, 0], [0, 0, 1], [9, 0, 0], [0, 0, 2]]
    universe.add_TopologyAttr("bonds", [(0, 1), (0, 2), (1, 3)])
    universe.dimensions = [10, 10, 10, 90, 90, 120]
    chosen = universe.atoms[[3, 1, 0]]
    shapes = ph.scene_of(chosen, style="ball-and-stick").shapes
    assert len(shapes[1].starts) == 4
    assert len(ph.scene_of(universe, style="ball-and-stick").shapes[1].starts) == 6
    universe.atoms[0].position = [9.5, 0, 0]
    lengths = np.subtract(
        *(getattr(ph.scene_of(chosen, style="licorice").shapes[1], k) for k in ("ends", "starts"))
    )
    assert np.linalg.norm(lengths, axis=1).max() < 0.6
