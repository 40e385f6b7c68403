"""Biological assemblies of PDB files: atoms copied by the rotations of REMARK 350."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import io
from parhelion.framing import bounds
from parhelion.io import LoadOptions
from parhelion.particles import Copies, Particles, to_scene
from parhelion.particles.glyphs import named
from parhelion.scene import Instances

pytest.importorskip("chemfiles")

IDENTITY = np.eye(3, 4)
HALF_TURN = np.array([[-1.0, 0, 0, 10], [0, -1, 0, 0], [0, 0, 1, 0]])  # about z, through (5, 0)


def biomt(*matrices: Any) -> str:
    return "".join(
        "REMARK 350   BIOMT{}{:4d}{:10.6f}{:10.6f}{:10.6f}    {:11.5f}\n".format(
            row + 1, n, *m[row]
        )
        for n, m in enumerate(matrices, start=1)
        for row in range(3)
    )


def atom(serial: int, chain: str, x: float, y: float, z: float) -> str:
    return (
        f"ATOM  {serial:5d}  C   LIG {chain}{serial:4d}    {x:8.3f}{y:8.3f}{z:8.3f}"
        "  1.00  0.00           C  \n"
    )


ATOMS = (
    atom(1, "A", 0, 0, 0) + atom(2, "A", 0, 0, 1.5) + atom(3, "B", 3, 0, 0) + atom(4, " ", 9, 9, 9)
)
APPLY = "REMARK 350 APPLY THE FOLLOWING TO CHAINS: "
TWO = (
    "REMARK 350 BIOMOLECULE: 1\n"
    f"{APPLY}A\n" + biomt(IDENTITY, HALF_TURN) + f"{APPLY}B\n" + biomt(IDENTITY)
    + "REMARK 350 BIOMOLECULE: 2, 7\n"
    f"{APPLY}A,\nREMARK 350                    AND CHAINS: B\n" + biomt(HALF_TURN)
    + "REMARK 350 BIOMOLECULE: 3\n" f"{APPLY}NULL\n" + biomt(HALF_TURN)
)  # fmt: skip


def written(folder: Path, *parts: str) -> Path:
    path = folder / "a.pdb"
    path.write_text("".join(parts) + "END\n")
    return path


def centers(scene: ph.Scene) -> Any:
    """Where all the copies of spheres are, sorted."""
    found = []
    for shape in scene.shapes:
        if isinstance(shape, Instances):
            (balls,) = (s for s in shape.shapes if isinstance(s, ph.Spheres))
            for matrix in shape.transforms:
                found.append(np.asarray(balls.centers) @ matrix[:, :3].T + matrix[:, 3])
    return np.array(sorted(np.round(np.concatenate(found), 5).tolist())) + 0.0


@pytest.mark.parametrize(
    ("assembly", "expected"),
    [
        (1, [[0, 0, 0], [0, 0, 1.5], [3, 0, 0], [10, 0, 0], [10, 0, 1.5]]),
        (2, [[7, 0, 0], [10, 0, 0], [10, 0, 1.5]]),
        (7, [[7, 0, 0], [10, 0, 0], [10, 0, 1.5]]),
        (3, [[1, -9, 9]]),
    ],
)
def test_chains_are_copied_by_their_own_rotations(
    tmp_path: Path, assembly: int, expected: Any
) -> None:
    path = written(tmp_path, TWO, ATOMS)
    scene = io.load(path, LoadOptions(assembly=assembly))
    ph.prepare(scene)
    assert_allclose(centers(scene), expected, atol=1e-5)
    plain = io.load(path).shapes[0]
    assert isinstance(plain, ph.Spheres)
    assert len(plain.centers) == 4  # as it is in the file, as in other programs


def test_bonds_and_colours_are_copied(tmp_path: Path) -> None:
    path = written(tmp_path, TWO, ATOMS)
    scene = io.load(path, LoadOptions(assembly=1, style="licorice", color_by="chain"))
    first, second = (s for s in scene.shapes if isinstance(s, Instances))
    assert [len(s.starts) for s in first.shapes if isinstance(s, ph.Cylinders)] == [2]
    assert not any(isinstance(s, ph.Cylinders) for s in second.shapes)
    assert np.any(first.shapes[0].colors[0] != second.shapes[0].colors[0])  # type: ignore[index]


def test_the_picture_holds_all_copies_and_no_more(tmp_path: Path) -> None:
    scene = io.load(written(tmp_path, TWO, ATOMS), LoadOptions(assembly=1))
    low, high = bounds(scene)
    assert_allclose([low, high], [[-1.7, -1.7, -1.7], [11.7, 1.7, 3.2]], atol=1e-5)


def test_haemoglobin_of_half_of_it(shared_scenes: Path, tmp_path: Path) -> None:
    """Two of its four chains and the file's own two-fold axis give the other two, within 1 A."""
    lines = (shared_scenes / "particles/chemfiles/pdb/4hhb.pdb").read_text().splitlines(True)
    rows = [line.split() for line in lines if line.startswith("MTRIX")]
    axis = np.array([[float(x) for x in row[2:6]] for row in rows])
    protein = [line for line in lines if line.startswith("ATOM")]
    half = "".join(line for line in protein if line[21] in "AB")
    start = "REMARK 350 BIOMOLECULE: 1\n" + f"{APPLY}A, B\n"
    scene = io.load(written(tmp_path, start, biomt(IDENTITY, axis), half), LoadOptions(assembly=1))
    group = scene.shapes[0]
    assert isinstance(group, Instances)
    copied = np.asarray(group.shapes[0].centers) @ axis[:, :3].T + axis[:, 3]  # type: ignore[union-attr]
    others = [line for line in protein if line[21] in "CD"]
    expected = [[float(line[a : a + 8]) for a in (30, 38, 46)] for line in others]
    assert copied.shape == np.shape(expected)
    assert np.median(np.linalg.norm(copied - expected, axis=1)) < 1


def test_the_assembly_of_a_real_file(shared_scenes: Path) -> None:
    path = shared_scenes / "particles/chemfiles/pdb/4hhb.pdb"
    scene = io.load(path, LoadOptions(assembly=1))
    group = scene.shapes[0]
    assert isinstance(group, Instances)
    assert_array_equal(group.transforms, [IDENTITY])
    assert len(group.shapes[0].centers) == 4779  # type: ignore[union-attr, arg-type]


MIRROR = np.diag([1.0, 1, -1]) @ IDENTITY


@pytest.mark.parametrize(
    ("remarks", "assembly", "words"),
    [
        (TWO, 4, "has no assembly 4 in REMARK 350; it has 1, 2, 7, 3"),
        ("", 1, "has no assembly 1 in REMARK 350; it has none"),
        (
            TWO.replace(" A\n", " Z\n").replace(" B\n", " Y\n"),
            1,
            "assembly 1 has no chain that is in",
        ),
        ("REMARK 350 BIOMOLECULE: 1\n" + biomt(IDENTITY), 1, "assembly 1 has no chain that is in"),
        (
            TWO.split("REMARK 350   BIOMT")[0],
            1,
            "assembly 1 has no chain that is in the file, or no",
        ),
        (TWO.replace("BIOMT2   2", "BIOMT2   3"), 1, "assembly 1: BIOMT 2 has not three rows"),
        (TWO.replace("-1.000000", "-1.00x000"), 1, "BIOMT 2 does not hold numbers"),
        (TWO.replace("-1.000000", "      nan"), 1, "BIOMT 2 is no rotation"),
        (TWO.replace("-1.000000", "-1.200000"), 1, "BIOMT 2 is no rotation"),
        (TWO.replace("   10.00000", "        inf"), 1, "BIOMT 2 is no rotation"),
        (f"REMARK 350 BIOMOLECULE: 1\n{APPLY}A\n{biomt(MIRROR)}", 1, "assembly 1: BIOMT 1 is no"),
        ("REMARK 350 BIOMOLECULE: " + "9" * 5000 + "\n", 9, "it has none"),
    ],
)
def test_refused(tmp_path: Path, remarks: str, assembly: int, words: str) -> None:
    path = written(tmp_path, remarks, ATOMS)
    with pytest.raises(ph.FormatError) as caught:
        io.load(path, LoadOptions(assembly=assembly))
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    io.load(path)  # nobody asked


def test_models_of_other_atoms_are_refused(tmp_path: Path) -> None:
    models = f"MODEL        1\n{ATOMS}ENDMDL\nMODEL        2\n{atom(1, 'A', 1, 1, 1)}ENDMDL\n"
    path = written(tmp_path, TWO, models)
    assert len(centers(io.load(path, LoadOptions(assembly=1)))) == 5
    with pytest.raises(ph.FormatError, match="assemblies need models of the same atoms"):
        io.load(path, LoadOptions(assembly=1, frame=1))


@pytest.mark.parametrize(
    ("more", "options", "words"),
    [
        ({}, {"wrap": True}, "wrap would tear apart"),
        ({"glyphs": named(2, "box", (1, 1, 1))}, {}, "not of other bodies"),
    ],
)
def test_what_copies_do_not_go_with(more: Any, options: Any, words: str) -> None:
    from parhelion.particles.boxes import Box

    everything = Copies(np.ones(2, bool), IDENTITY[None])
    box = Box(np.eye(3), np.zeros(3))
    pair = Particles(np.eye(3)[:2], box=box, copies=[everything], **more)
    with pytest.raises(ph.SceneError, match=words):
        to_scene(pair, LoadOptions(**options), "test")
    with pytest.raises(ph.SceneError, match=r"copies\[0\]: 3 values for 2 particles"):
        Particles(np.eye(3)[:2], copies=[Copies(np.ones(3, bool), IDENTITY[None])])
