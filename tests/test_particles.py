"""Particle files: what is read, the scene made of it, and what is refused in which words."""

from __future__ import annotations

import bz2
import gzip
import io as streams
import logging
import lzma
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import io
from parhelion.framing import placed
from parhelion.io import LoadOptions, lammps, npz, text, xyz
from parhelion.particles import (
    Labels,
    Particles,
    element_labels,
    elements,
    linear,
    map_colors,
    neighbour_distance,
    to_scene,
)
from parhelion.scene import Disks, Scene
from parhelion.studio import dressed

WATER = """3
water, in angstrom
O 0.0 0.0 0.1173
H 0.0 0.7572 -0.4692
H 0.0 -0.7572 -0.4692
"""

EXTENDED = """2
Lattice="4 0 0 1 5 0 0 0 6" Origin="-1 0 2" Properties=species:S:1:pos:R:3:forces:R:3:q:R:1:flag:L:1
Na 0 0 0 3 4 0 -1.5 T
Cl 1 2 3 0 0 2 1.5 F
"""

DUMP = """ITEM: TIMESTEP
7
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp pp pp
-1 3
0 10
0 20
ITEM: ATOMS id type xs ys zs radius c_pe[2]
2 3 0.5 0.5 0.25 0.75 -4
1 1 0 1 1 0.5 8
"""


def lit(particles: Particles, ground: bool = False) -> Scene:
    """As a file of particles is shown."""
    return dressed(to_scene(particles, LoadOptions(), "test"), ground=ground, bare=True)


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def save(folder: Path, name: str = "a.npz", **arrays: Any) -> Path:
    np.savez_compressed(folder / name, **arrays)
    return folder / name


def names_of(labels: Labels | None) -> list[str]:
    assert labels is not None
    return [labels.names[code] for code in labels.codes.tolist()]


# ---------------------------------------------------------------------------------------------
# XYZ


def test_xyz(tmp_path: Path) -> None:
    particles = xyz.read(write(tmp_path, "water.xyz", WATER))
    assert names_of(particles.elements) == ["O", "H", "H"]
    assert_array_equal(
        particles.positions, [[0, 0, 0.1173], [0, 0.7572, -0.4692], [0, -0.7572, -0.4692]]
    )
    assert particles.types is None
    assert particles.box is None
    assert not particles.fields


def test_extended_xyz(tmp_path: Path) -> None:
    particles = xyz.read(write(tmp_path, "salt.extxyz", EXTENDED))
    assert names_of(particles.elements) == ["Na", "Cl"]
    assert_array_equal(particles.positions, [[0, 0, 0], [1, 2, 3]])
    assert_array_equal(particles.fields["forces"], [[3, 4, 0], [0, 0, 2]])
    assert_array_equal(particles.fields["q"], [-1.5, 1.5])
    assert names_of(particles.fields["flag"]) == ["T", "F"]  # type: ignore[arg-type]
    assert particles.box is not None
    assert_array_equal(particles.box.vectors, [[4, 0, 0], [1, 5, 0], [0, 0, 6]])
    assert_array_equal(particles.box.origin, [-1, 0, 2])


def test_extended_xyz_radius_color_and_atomic_numbers(tmp_path: Path) -> None:
    content = (
        "1\nProperties=pos:R:3:Z:I:1:Radius:R:1:color:R:3:name:S:2\n1 2 3 26 0.5 1 0.5 0 a b\n"
    )
    particles = xyz.read(write(tmp_path, "a.xyz", content))
    assert names_of(particles.elements) == ["Fe"]
    assert particles.radii == [0.5]
    assert particles.colors is not None
    assert_allclose(particles.colors, [[1, 0.2140411, 0]], rtol=1e-6)  # sRGB 0.5, IEC 61966-2-1
    assert list(particles.fields) == ["name_1", "name_2"]


@pytest.mark.parametrize(
    ("labels", "symbols"),
    [
        (["C1", "H12", "O2-", "fe3+", "CL"], ["C", "H", "O", "Fe", "Cl"]),
        (["X", "D", "Bq"], ["X", "H", "X"]),
        (["A", "B"], None),  # B alone would be boron
        (["OW", "HW1"], None),
        (["1", "2"], None),
    ],
)
def test_labels_are_elements_only_if_all_are(
    tmp_path: Path, labels: list[str], symbols: list[str] | None
) -> None:
    rows = "".join(f"{label} {i} 0 0\n" for i, label in enumerate(labels))
    particles = xyz.read(write(tmp_path, "a.xyz", f"{len(labels)}\n\n{rows}"))
    if symbols is None:
        assert particles.elements is None
        assert names_of(particles.types) == labels
    else:
        assert names_of(particles.elements) == symbols


@pytest.mark.parametrize(
    "content",
    [
        WATER.replace("\n", "\r\n"),
        WATER.rstrip("\n"),
        WATER + "\n  \n\n",
        "\ufeff" + WATER,
        WATER.replace(" ", "\t\t"),
        WATER.replace("O 0.0", "  O  +0.0e0"),
    ],
)
def test_xyz_variants_of_writing(tmp_path: Path, content: str) -> None:
    particles = xyz.read(write(tmp_path, "a.xyz", content))
    assert_array_equal(particles.positions[:, 1], [0, 0.7572, -0.7572])
    with pytest.raises(ph.FormatError, match="there is no frame 1; the file has 1 frame: 0"):
        xyz.read(tmp_path / "a.xyz", 1)


def test_xyz_positions_alone_and_extra_columns(tmp_path: Path) -> None:
    assert_array_equal(xyz.read(write(tmp_path, "a.xyz", "1\n\n1 2 3\n")).positions, [[1, 2, 3]])
    extra = xyz.read(write(tmp_path, "b.xyz", "1\n\nC 1 2 3 -0.5 up\n"))
    assert_array_equal(extra.fields["column5"], [-0.5])
    assert names_of(extra.fields["column6"]) == ["up"]  # type: ignore[arg-type]


def test_many_blocks_and_many_labels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is read does not depend on where blocks of the file end, nor on long words."""
    random = np.random.default_rng(3)
    names = ["C", "averylonglabel", "Fe", "He"]
    codes = random.integers(4, size=500)
    positions = random.normal(size=(500, 3)).round(4)
    rows = "".join(
        f"{names[code]} {x} {y} {z}\n" for code, (x, y, z) in zip(codes, positions, strict=True)
    )
    path = write(tmp_path, "a.xyz", f"500\n\n{rows}" * 3)
    for size in (7, 100, 4096, 1 << 20):
        monkeypatch.setattr(text, "_BLOCK", size)
        for frame in (0, 1, -1):
            particles = xyz.read(path, frame)
            assert_array_equal(particles.positions, positions)
            assert names_of(particles.types) == [names[code] for code in codes]


@pytest.mark.parametrize("ending", ["", ".gz", ".bz2", ".xz"])
def test_frames_of_plain_and_packed_files(tmp_path: Path, ending: str) -> None:
    packers = {"": bytes, ".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}
    content = "".join(f"{n}\nframe\n" + f"C {n} 0 0\n" * n + "\n" for n in (1, 2, 3, 4))
    path = write(tmp_path, f"a.xyz{ending}", packers[ending](content.encode()))
    for frame, count in enumerate((1, 2, 3, 4)):
        assert len(xyz.read(path, frame).positions) == count
        assert len(xyz.read(path, frame - 4).positions) == count
    for frame in (4, -5):
        with pytest.raises(
            ph.FormatError, match=f"no frame {frame}; the file has 4 frames: 0 to 3"
        ):
            xyz.read(path, frame)


# ---------------------------------------------------------------------------------------------
# LAMMPS


def test_lammps_scaled_positions_types_and_fields(tmp_path: Path) -> None:
    particles = lammps.read(write(tmp_path, "a.dump", DUMP))
    assert_array_equal(particles.positions, [[1, 5, 5], [-1, 10, 20]])
    assert names_of(particles.types) == ["3", "1"]
    assert particles.elements is None
    assert_array_equal(particles.radii, [0.75, 0.5])  # type: ignore[arg-type]
    assert_array_equal(particles.fields["c_pe[2]"], [-4, 8])
    assert_array_equal(particles.fields["id"], [2, 1])


def test_lammps_triclinic(tmp_path: Path) -> None:
    """Bounds are of the straight box around the tilted one: docs.lammps.org/Howto_triclinic."""
    xy, xz, yz = -2.0, 1.0, -3.0
    low, high = np.array([0.5, 1, 2]), np.array([10.5, 9, 8])
    bounds = (
        f"{low[0] + min(0, xy, xz, xy + xz)} {high[0] + max(0, xy, xz, xy + xz)} {xy}\n"
        f"{low[1] + min(0, yz)} {high[1] + max(0, yz)} {xz}\n{low[2]} {high[2]} {yz}\n"
    )
    content = DUMP.replace("BOX BOUNDS pp", "BOX BOUNDS xy xz yz pp").replace(
        "-1 3\n0 10\n0 20\n", bounds
    )
    particles = lammps.read(write(tmp_path, "a.lammpstrj", content))
    assert particles.box is not None
    assert_allclose(particles.box.vectors, [[10, 0, 0], [xy, 8, 0], [xz, yz, 6]])
    assert_allclose(particles.box.origin, low)
    a, b, c = particles.box.vectors
    assert_allclose(particles.positions, [low + 0.5 * a + 0.5 * b + 0.25 * c, low + b + c])


def test_lammps_general_triclinic(tmp_path: Path) -> None:
    content = DUMP.replace("BOX BOUNDS pp pp pp", "BOX BOUNDS abc origin pp pp pp").replace(
        "-1 3\n0 10\n0 20\n", "0 2 0 5\n-3 0 0 6\n0 0 4 7\n"
    )
    particles = lammps.read(write(tmp_path, "a.dump", content))
    assert_allclose(particles.positions, [[5 - 1.5, 6 + 1, 7 + 1], [5 - 3, 6, 7 + 4]])


@pytest.mark.parametrize("axes", ["x y z", "xu yu zu", "xsu ysu zsu"])
def test_lammps_kinds_of_positions(tmp_path: Path, axes: str) -> None:
    path = write(tmp_path, "a.dump", DUMP.replace("xs ys zs", axes))
    expected = [[1, 5, 5], [-1, 10, 20]] if "s" in axes else [[0.5, 0.5, 0.25], [0, 1, 1]]
    assert_array_equal(lammps.read(path).positions, expected)


def test_lammps_elements_type_names_and_diameters(tmp_path: Path) -> None:
    named = DUMP.replace("type", "element").replace("2 3 ", "2 Si ").replace("\n1 1 ", "\n1 O ")
    particles = lammps.read(write(tmp_path, "a.dump", named.replace("radius", "diameter")))
    assert names_of(particles.elements) == ["Si", "O"]
    assert_array_equal(particles.radii, [0.375, 0.25])  # type: ignore[arg-type]
    typed = DUMP.replace("2 3 ", "2 Si ").replace("\n1 1 ", "\n1 O ")
    assert names_of(lammps.read(write(tmp_path, "b.dump", typed)).elements) == ["Si", "O"]


# ---------------------------------------------------------------------------------------------
# NPZ


def test_npz_all_keys(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    positions = random.random((5, 3)).astype(">f4")
    particles = npz.read(
        save(
            tmp_path,
            centers=positions,
            radius=2,
            color=np.full((5, 3), 188, np.uint8),
            element=np.array([b"C", b"O", b"C", b"C", b"N"]),
            type=np.array([1, 2, 1, 1, 2]),
            box=np.array([3.0, 4, 5]),
            charge=np.arange(5),
            director=random.random((5, 3)),
            state=np.array(["on", "off", "on", "on", "on"]),
            other=np.arange(7),
        )
    )
    assert_array_equal(particles.positions, positions)
    assert_array_equal(particles.radii, [2.0] * 5)  # type: ignore[arg-type]
    assert particles.colors is not None
    assert_allclose(particles.colors, 0.5028865, rtol=1e-6)
    assert names_of(particles.elements) == ["C", "O", "C", "C", "N"]
    assert names_of(particles.types) == ["1", "2", "1", "1", "2"]
    assert particles.box is not None
    assert_array_equal(particles.box.vectors, np.diag([3, 4, 5]))
    assert sorted(particles.fields) == ["charge", "director", "state"]


# ---------------------------------------------------------------------------------------------
# Real files

COUNTS = [
    ("chemfiles/lammps/nacl.lammpstrj", 512, 6),
    ("chemfiles/lammps/properties.lammpstrj", 4000, 4),
    ("chemfiles/pdb/4hhb.pdb", 4779, 1),
    ("chemfiles/gro/1vln-triclinic.gro", 14520, 1),
    ("gro/bigbox.gro.bz2", 132303, 1),
    ("gsd/example.gsd", 5832, 2),
    ("gsd/lj.gsd", 1000, 10),
    ("gsd/molecules.gsd", 729, 1),
    ("xyz/2r9r-1b.xyz", 1284, 10),
    ("fresnel-gumballs/gumballs.npz", 1000, 1),
]


@pytest.mark.parametrize(("name", "count", "frames"), COUNTS)
def test_real_files(shared_scenes: Path, name: str, count: int, frames: int) -> None:
    path = shared_scenes / "particles" / name
    for module in {"chemfiles": ("gro", "pdb"), "gsd": ("gsd",)}.items():
        if path.suffixes[0].removeprefix(".") in module[1]:
            pytest.importorskip(module[0])
    scene = io.load(path, LoadOptions(frame=frames - 1))
    shape = scene.shapes[0]
    assert np.shape(shape.centers) == (count, 3)
    assert np.shape(shape.radii) == (count,)
    assert np.shape(shape.colors) == (count, 3)
    assert scene.name == path.name
    with pytest.raises(ph.FormatError, match=f"there is no frame {frames}"):
        io.load(path, LoadOptions(frame=frames))


def test_elements_of_biomolecules(shared_scenes: Path) -> None:
    """Haemoglobin has four irons, two tetramers of concanavalin A eight Ca and eight Mn."""
    pytest.importorskip("chemfiles")
    from parhelion.io import chemfiles_file

    folder = shared_scenes / "particles" / "chemfiles"
    expected = {
        "pdb/4hhb.pdb": {"C": 2954, "N": 780, "O": 1027, "P": 2, "S": 12, "Fe": 4},
        "gro/1vln-triclinic.gro": {
            "C": 9128,
            "N": 2416,
            "O": 2944,
            "S": 16,
            "Ca": 8,
            "Mn": 8,
        },
    }
    for name, counts in expected.items():
        labels = chemfiles_file.read(folder / name).elements
        assert labels is not None
        used, times = np.unique(labels.codes, return_counts=True)
        assert {labels.names[c]: n for c, n in zip(used, times.tolist(), strict=True)} == counts


def test_chemfiles_warnings_go_to_logging(
    shared_scenes: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("chemfiles")
    with caplog.at_level(logging.INFO, "parhelion"):
        io.load(shared_scenes / "particles/chemfiles/pdb/4hhb.pdb")
    assert "space group" in caplog.text
    assert capfd.readouterr().err == ""


def test_gsd_velocity_of_frame_zero_holds_for_later_frames(shared_scenes: Path) -> None:
    pytest.importorskip("gsd")
    from parhelion.io import gsd_file

    path = shared_scenes / "particles/gsd/lj.gsd"
    first, last = gsd_file.read(path), gsd_file.read(path, -1)
    assert_array_equal(first.fields["velocity"], last.fields["velocity"])
    assert np.abs(first.positions - last.positions).max() > 1
    assert last.box is not None
    assert_array_equal(last.box.origin, [-10, -10, -10])


@pytest.mark.parametrize(("name", "extra"), [("a.pdb", "chemfiles"), ("a.gsd", "gsd")])
def test_missing_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, extra: str
) -> None:
    monkeypatch.setitem(__import__("sys").modules, extra, None)
    with pytest.raises(ph.FormatError, match=f"pip install {extra}"):
        io.load(write(tmp_path, name, "x"))


# ---------------------------------------------------------------------------------------------
# The scene


def cloud(count: int = 200, **changes: Any) -> Particles:
    random = np.random.default_rng(1)
    return Particles(random.normal(size=(count, 3)) * (3, 2, 1) + (50, -20, 7), **changes)


@pytest.mark.parametrize("aspect", [0.25, 1.0, 16 / 9, 4.0])
@pytest.mark.parametrize("stretch", [(1, 1, 1), (30, 1, 1), (1, 1, 30), (1, 30, 0)])
def test_camera_frames_every_sphere_and_no_more(
    aspect: float, stretch: tuple[float, float, float]
) -> None:
    random = np.random.default_rng(2)
    positions = random.normal(size=(100, 3)) * stretch
    particles = Particles(positions, radii=random.uniform(0.1, 0.5, 100))
    camera = placed(lit(particles), aspect)
    assert camera.vfov is not None
    eye, target = np.array(camera.eye), np.array(camera.target)
    towards = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(camera.up, towards)
    slope_y = np.tan(np.radians(camera.vfov / 2))
    depth = (eye - positions) @ towards
    reach = []
    for axis, slope in ((right, slope_y * aspect), (np.array(camera.up), slope_y)):
        # half-angle of the cone of rays that touch a sphere, seen along this axis of the picture
        u = (positions - eye) @ axis
        distance = np.hypot(u, depth)
        angle = np.abs(np.arctan2(u, depth)) + np.arcsin(particles.radii / distance)
        reach.append(np.tan(angle).max() / slope)
    assert max(reach) <= 1
    assert max(reach) >= 0.85
    # the side that the picture's other direction is centred on
    assert depth.min() > 0


@pytest.mark.parametrize("aspect", [0.02, 0.2, 1.0, 5.0])
def test_light_is_outside_of_the_view(aspect: float) -> None:
    scene = lit(cloud())
    camera, key = placed(scene, aspect), scene.shapes[1]
    assert key.name == "key light"
    assert camera.vfov is not None
    towards = np.subtract(camera.eye, camera.target)
    towards /= np.linalg.norm(towards)
    place = np.array(key.centers)[0] - camera.eye
    slope = np.tan(np.radians(camera.vfov / 2))
    up, depth = np.array(camera.up), -place @ towards
    # above or left of a plane that bounds the view, by more than its radius
    outside = [
        (side - s * depth) / np.hypot(1, s)
        for side, s in ((place @ up, slope), (-place @ np.cross(up, towards), slope * aspect))
    ]
    assert max(outside) > float(key.radii)  # type: ignore[arg-type]


def test_brightness_of_a_white_particle() -> None:
    """A lone white particle is well lit, and its brightest point below the page's white."""
    particles = Particles(np.zeros((1, 3)), Labels(np.array([0]), ("H",)))
    scene = lit(particles)
    image = ph.render(scene, width=64, height=64, spp=64).numpy()
    ball = image[12:52, 12:52, :3]
    assert 0.75 < ball.max() < 1.0
    assert 0.4 < np.median(ball) < 0.75
    assert_allclose(image[0, 0, :3], 0.76, atol=0.04)  # the sky behind


def test_ground_touches_the_lowest_particle() -> None:
    particles = cloud(radii=np.linspace(0.1, 0.4, 200))
    scene = lit(particles, ground=True)
    ground = scene.shapes[-1]
    assert ground.name == "ground"
    assert isinstance(ground, Disks)
    lowest = np.min(particles.positions[:, 2] - particles.radii)
    assert_allclose(np.array(ground.centers)[0, 2], lowest, rtol=1e-6)
    assert len(lit(particles).shapes) == 2


def test_scale_and_place_do_not_matter() -> None:
    base = cloud(types=Labels(np.arange(200) % 3, ("a", "b", "c")))
    one = to_scene(base, LoadOptions(), "test")
    for scale in (1e-9, 1e16):
        moved = Particles((base.positions - 50) * scale, types=base.types)
        other = to_scene(moved, LoadOptions(), "test")
        assert_allclose(
            np.array(placed(other, 1.5).eye) / scale + 50, placed(one, 1.5).eye, rtol=1e-6
        )
        assert_allclose(np.array(other.shapes[0].radii) / scale, one.shapes[0].radii, rtol=1e-5)
        assert_array_equal(other.shapes[0].colors, one.shapes[0].colors)  # type: ignore[arg-type]


def test_radii() -> None:
    """H 1.20 and O 1.52 are Bondi's, 0.31 and 0.66 Cordero's; salts are drawn with the latter."""
    water = cloud(3, elements=Labels(np.array([0, 1, 1]), ("O", "H")))
    salt = cloud(2, elements=Labels(np.array([0, 1]), ("Na", "Cl")))

    def radii(particles: Particles, radius: float | str | None = None) -> Any:
        return to_scene(particles, LoadOptions(radius=radius), "test").shapes[0].radii

    assert_allclose(radii(water), [1.52, 1.2, 1.2])
    assert_allclose(radii(water, "covalent"), [0.66, 0.31, 0.31])
    assert_allclose(radii(salt), [1.66, 1.02])
    assert_allclose(radii(salt, "vdw"), [2.5, 1.75])
    assert_allclose(radii(water, 0.25), [0.25] * 3)
    assert_allclose(radii(water, "0.25"), [0.25] * 3)
    assert_allclose(radii(cloud(3, radii=np.array([1.0, 2, 3]))), [1, 2, 3])


def test_neighbour_distance() -> None:
    lattice = np.stack(np.meshgrid(*[np.arange(30)] * 3), axis=-1).reshape(-1, 3) * 2.5
    random = np.random.default_rng(0)
    assert neighbour_distance(lattice) == 2.5
    assert neighbour_distance(lattice[:2]) == 2.5
    assert neighbour_distance(lattice[:1]) == 1
    assert neighbour_distance(np.zeros((100_000, 3))) == 1
    # twice each, and clustered in two far and tiny places
    twice = np.concatenate([lattice, lattice])
    assert neighbour_distance(twice) == 2.5
    clusters = np.concatenate([lattice, lattice + 1e6]) + random.normal(size=3)
    assert_allclose(neighbour_distance(clusters), 2.5, rtol=1e-6)
    # the mean distance of an ideal gas of density 1 is 0.554 (Chandrasekhar), its median 0.550
    gas = random.random((200_000, 3)) * 200_000 ** (1 / 3)
    assert_allclose(neighbour_distance(gas), (np.log(2) * 3 / (4 * np.pi)) ** (1 / 3), rtol=0.1)


def colors_of(particles: Particles, **options: Any) -> Any:
    return to_scene(particles, LoadOptions(**options), "test").shapes[0].colors


def test_colors_of_kinds() -> None:
    kinds = cloud(3, elements=Labels(np.array([0, 1, 1]), ("O", "H")))
    oxygen = 0.85 * linear(np.array([255, 13, 13], np.uint8))  # Jmol's FF0D0D
    assert_allclose(colors_of(kinds), [oxygen, [0.85] * 3, [0.85] * 3])
    types = cloud(4, types=Labels(np.array([0, 1, 2, 1]), ("b", "a", "c")))
    colors = colors_of(types)
    assert_array_equal(colors[1], colors[3])
    assert len(np.unique(colors, axis=0)) == 3
    # the colour of type number 2 is the same whether there is a type 1 or not
    numbered = cloud(2, types=Labels(np.array([0, 1]), ("2", "7")))
    others = cloud(2, types=Labels(np.array([0, 1]), ("1", "2")))
    assert_array_equal(colors_of(numbered)[0], colors_of(others)[1])
    own = cloud(2, colors=np.array([[1.0, 0, 0], [0, 1, 0]]), types=others.types)
    assert_array_equal(colors_of(own), [[1, 0, 0], [0, 1, 0]])
    assert_array_equal(colors_of(own, color_by="type"), colors_of(others))


def test_colors_by_fields() -> None:
    from matplotlib import colormaps

    values = np.array([0.0, 1.0, 2.0, np.nan, 4.0, np.inf])
    forces = np.zeros((6, 3))
    forces[:, 1] = values
    particles = cloud(6, fields={"q": values, "f": forces, "tensor": np.ones((6, 6))})
    colors = colors_of(particles, color_by="q", colormap="magma", color_range=(1, 2))
    ends = linear(colormaps["magma"](np.array([0.0, 1.0]))[:, :3])
    assert_allclose(colors[[0, 1, 2, 4, 5]], ends[[0, 0, 1, 1, 1]], rtol=1e-6)
    assert_allclose(colors[3], 0.25)
    for name in ("f", "f_y"):
        by_vector = colors_of(particles, color_by=name, colormap="magma", color_range=(1, 2))
        assert_array_equal(by_vector, colors)
    by_y = colors_of(particles, color_by="y")
    assert_array_equal(
        np.argsort(particles.positions[:, 1])[[0, -1]],
        [np.argmin(by_y[:, 1]), np.argmax(by_y[:, 0])],  # viridis begins dark, ends yellow
    )
    assert len(np.unique(colors_of(particles, color_by="index"), axis=0)) == 6
    assert len(np.unique(colors_of(particles, color_by="tensor_6"), axis=0)) == 1


def test_color_range_is_by_percentiles() -> None:
    values = np.arange(1001.0)
    values[-1] = 1e12  # one outlier does not hide the rest
    colors = map_colors(values, "gray", None)
    low, high = np.percentile(values, (1, 99))
    assert_array_equal(colors, map_colors(values, "gray", (low, high)))
    assert len(np.unique(colors, axis=0)) > 256
    assert len(np.unique(map_colors(np.full(5, 7.0), "gray", None))) == 1
    rare = np.zeros(1000)
    rare[5] = 3.0
    assert len(np.unique(map_colors(rare, "gray", None))) == 2
    assert_allclose(map_colors(np.full(3, np.nan), "gray", None), 0.25)
    huge = map_colors(np.array([-1e308, 0, 1e308]), "gray", (-1e308, 1e308))
    assert (np.diff(huge[:, 0]) > 0).all()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"color_by": "chrage"}, "unknown field to colour by 'chrage'; did you mean 'charge'"),
        ({"color_by": "charge", "colormap": "virdis"}, "did you mean 'viridis'"),
        ({"color_by": "charge", "color_range": (2, 1)}, "colour range 2 1"),
        ({"color_by": "charge", "color_range": (0, float("nan"))}, "colour range"),
        ({"color_by": "element"}, "unknown field to colour by 'element'"),
        ({"radius": "vwd"}, "unknown radius 'vwd'; did you mean 'vdw'.*or a number"),
        ({"radius": "vdw"}, "needs elements"),
        ({"radius": 0}, "not a positive"),
        ({"radius": -1.0}, "not a positive"),
        ({"radius": "nan"}, "not a positive"),
    ],
)
def test_options_refused(options: dict[str, Any], words: str) -> None:
    particles = cloud(4, fields={"charge": np.arange(4.0)})
    with pytest.raises(ph.SceneError, match=words):
        to_scene(particles, LoadOptions(**options), "test")


def test_elements_table() -> None:
    assert len(elements.SYMBOLS) == 119
    assert [elements.SYMBOLS.index(s) for s in ("X", "H", "Fe", "Xe", "U", "Og")] == [
        0,
        1,
        26,
        54,
        92,
        118,
    ]
    assert (elements.VDW_RADII > 0.9).all()
    assert (elements.COVALENT_RADII < elements.VDW_RADII).all()
    assert elements.COLORS[8].tolist() == [255, 13, 13]
    symbols = [elements.atomic_number(symbol) for symbol in elements.SYMBOLS]
    assert symbols == list(range(119))
    # names of atoms in residues, and alone
    for name, inside, alone in [
        ("CA", "C", "Ca"),
        ("HG1", "H", "Hg"),
        ("NA", "N", "Na"),
        ("NH1", "N", "N"),
        ("1HB", "H", "H"),
        ("CL", "Cl", "Cl"),
        ("SOD", "S", "Na"),
        ("MW", "X", "X"),
        ("FE", "Fe", "Fe"),
    ]:
        for ion, symbol in ((False, inside), (True, alone)):
            number = elements.biomolecular_number(name, ion=ion)
            assert elements.SYMBOLS[number] == symbol, (name, ion)


def test_unused_names_do_not_count() -> None:
    labels = Labels(np.array([1, 1]), ("solvent", "C"))
    assert names_of(element_labels(labels)) == ["C", "C"]


# ---------------------------------------------------------------------------------------------
# Refused, in one error


BROKEN = [
    # XYZ
    ("a.xyz", "", "is empty"),
    ("a.xyz", "\n\n", "is empty"),
    ("a.xyz", "hello", "line 1: should be the number of atoms, not 'hello'"),
    ("a.xyz", "-3\n\n", "should be the number of atoms"),
    ("a.xyz", "0\n\n", "line 1: there are no atoms"),
    ("a.xyz", "3", "the file ends after 0 of 3 atoms"),
    ("a.xyz", "3\ncomment", "the file ends after 0 of 3 atoms"),
    ("a.xyz", "3\n\nC 1 2 3\nC 1 2 3\n", "line 4: the file ends after 2 of 3 atoms"),
    ("a.xyz", "4000000000\n\nC 1 2 3\n", "ends after 1 of 4000000000 atoms"),
    ("a.xyz", "9" * 30 + "\n\nC 1 2 3\n", "should be the number of atoms"),
    ("a.xyz", "2\n\nC 1 2 3\nC 1 2\n", "line 4: has 3 columns, not 4 (species pos pos pos)"),
    ("a.xyz", "2\n\nC 1 2 3\n\n", "line 4: has 0 columns"),
    ("a.xyz", "2\n\nC 1 2\n C 3 4 5 6 7\n", "line 3: has 3 columns, not a label, x, y and z"),
    ("a.xyz", "1\n\nC 1\n", "line 3: has 2 columns"),
    ("a.xyz", "2\n\nC 1 2 3\nC 1 2 three\n", "line 4: column 4 (pos): 'three' is not a number"),
    ("a.xyz", "1\n\nC 1 2 0x10\n", "'0x10' is not a number"),
    ("a.xyz", "1\n\nC 1.0-2.0 2 3\n", "'1.0-2.0' is not a number"),
    ("a.xyz", "2\n\nC 1 2 3\nC 1 nan 3\n", "particle 1: position (1 nan 3) is not finite"),
    ("a.xyz", "1\n\nC 1 inf 3\n", "particle 0: position (1 inf 3) is not finite"),
    ("a.xyz", "1\n\nC 1 2 1e999\n", "is not finite"),
    ("a.xyz", "1\n\nC 1 2 1e35\n", "beyond 1e30"),
    ("a.xyz", b"1\n\xff\xfe\nC 1 2 3\n", "line 2: is not UTF-8 text"),
    ("a.xyz", b"1\n\n\xff 1 2 3\n", "is not UTF-8 text"),
    ("a.xyz", b"1\n\nC 1 2 \xe9\n", "is not UTF-8 text"),
    ("a.xyz", bytes(range(256)) * 20, "line 1: "),
    ("a.xyz", b"\0" * 3_000_000, "is longer than a line of text can be"),
    ("a.xyz", b"1\n\n" + b"C" * 100 + b" 1 2 3\n", "line 3: has a word of 100 characters"),
    ("a.xyz", "1\nProperties=species:S:1:pos:R\nC 1 2 3\n", "not a list of name:kind:columns"),
    ("a.xyz", "1\nProperties=species:S:1\nC 1 2 3\n", "has no pos:R:3"),
    ("a.xyz", "1\nProperties=pos:S:3\n1 2 3\n", "has no pos:R:3"),
    ("a.xyz", "1\nProperties=pos:R:3:Pos:R:1\n1 2 3 4\n", "has pos twice"),
    ("a.xyz", "1\nProperties=pos:Q:3\n1 2 3\n", "of kind 'Q', not R, I, S or L"),
    ("a.xyz", "1\nProperties=pos:R:3:q:R:0\n1 2 3\n", "q cannot have '0' columns"),
    ("a.xyz", "1\nProperties=pos:R:3:q:R:9999999\n1 2 3\n", "cannot have"),
    ("a.xyz", '1\nLattice="1 2 3"\nC 1 2 3\n', "line 2: Lattice='1 2 3' is not 9 numbers"),
    ("a.xyz", "1\nProperties=pos:R:3:radius:R:1\n1 2 3 -1\n", "radius (-1) is not a positive"),
    ("a.xyz", "1\nProperties=pos:R:3:radius:R:1\n1 2 3 0\n", "radius (0) is not a positive"),
    (
        "a.xyz",
        "1\nProperties=pos:R:3:color:R:3\n1 2 3 9 0 0\n",
        "0 0) is not within [0, 1]",
    ),
    ("a.xyz", "1\nProperties=pos:R:3:Z:I:1\n1 2 3 150\n", "not atomic numbers"),
    ("a.xyz.gz", WATER, "broken .gz data"),
    ("a.xyz.gz", gzip.compress(WATER.encode(), mtime=0)[:-12], "broken .gz data"),
    ("a.xyz.bz2", b"BZh9junkjunk", "broken .bz2 data"),
    ("a.xyz.xz", b"\xfd7zXZ\0junkjunk", "broken .xz data"),
    # LAMMPS
    ("a.dump", "", "is empty"),
    ("a.dump", "hello\n", "line 1: should be an ITEM of a LAMMPS dump, not 'hello'"),
    ("a.dump", DUMP[:40], "the file ends before ITEM: ATOMS"),
    ("a.dump", DUMP.replace("ATOMS\n2", "ATOMS\n3"), "the file ends after 2 of 3 atoms"),
    ("a.dump", DUMP.replace("ATOMS\n2", "ATOMS\n4000000000"), "ends after 2 of 4000000000"),
    ("a.dump", DUMP.replace("ATOMS\n2", "ATOMS\nmany"), "should be the number of atoms"),
    ("a.dump", DUMP.replace("ATOMS\n2", "ATOMS\n0"), "there are no particles"),
    ("a.dump", "ITEM: ATOMS x y z\n1 2 3\n", "ITEM: ATOMS comes before ITEM: NUMBER OF ATOMS"),
    ("a.dump", DUMP.replace("-1 3", "-1"), "line 6: should be 2 numbers"),
    ("a.dump", DUMP.replace("-1 3", "3 -1"), "the box ends before it begins"),
    ("a.dump", DUMP.replace("-1 3", "nan 3"), "the box is not finite"),
    ("a.dump", DUMP.replace("-1 3", "-1 three"), "should be 2 numbers"),
    ("a.dump", DUMP.replace(" zs", " q"), "ITEM: ATOMS has no columns x y z"),
    ("a.dump", DUMP.replace("xs ys zs", "x y c_pe"), "has no columns x y z"),
    ("a.dump", DUMP.replace("0.5 0.5", "a 0.5"), "column xs does not hold numbers"),
    ("a.dump", DUMP.replace("1 1 0 1", "1 1 zero 1"), "line 11: column 3 (xs): 'zero' is not"),
    ("a.dump", DUMP.replace("1 1 0 1", "1 1 0"), "line 11: has 6 columns, not 7"),
    ("a.dump", DUMP.replace("1 1 0 1", "1 1 nan 1"), "particle 1: position (nan"),
    ("a.dump", DUMP.replace("0.75", "-0.75"), "particle 0: radius (-0.75) is not a positive"),
    ("a.dump", DUMP.encode().replace(b"c_pe", b"\xff"), "line 9: is not UTF-8 text"),
    (
        "a.dump",
        "".join(DUMP.splitlines(keepends=True)[:4] + DUMP.splitlines(keepends=True)[8:]),
        "need ITEM: BOX BOUNDS",
    ),
    # NPZ
    ("a.npz", "", "is not a NumPy archive"),
    ("a.npz", b"\x80\x04junk", "is not a NumPy archive"),
    ("a.npz", b"PK\x03\x04" + b"\0" * 100, "is not a NumPy archive"),
]


@pytest.mark.parametrize(("name", "content", "words"), BROKEN)
def test_broken_files(tmp_path: Path, name: str, content: str | bytes, words: str) -> None:
    path = write(tmp_path, name, content)
    with pytest.raises(ph.FormatError) as caught:
        io.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


POINTS = np.arange(12.0).reshape(4, 3)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"places": POINTS}, "has no array 'positions' (position, centers); its arrays: places"),
        ({"positions": POINTS[:, :2]}, "positions: (N, 3) numbers are needed, not (4, 2)"),
        ({"positions": POINTS[0]}, "(N, 3) numbers are needed, not (3,)"),
        ({"positions": POINTS[:0]}, "there are no particles"),
        ({"positions": POINTS + 1j}, "(N, 3) numbers are needed"),
        ({"positions": np.array([["a", "b", "c"]])}, "(N, 3) numbers are needed"),
        ({"positions": np.array([[None, 1, 2]])}, "(N, 3) numbers are needed"),
        ({"positions": POINTS * np.nan}, "particle 0: position (nan nan nan)"),
        ({"positions": POINTS, "radii": np.ones(3)}, "radii: numbers of shape (4,) or () are"),
        ({"positions": POINTS, "radii": -1.0}, "particle 0: radius (-1) is not a positive"),
        ({"positions": POINTS, "radii": 1e-60}, "radius (1e-60) is not a positive"),
        ({"positions": POINTS, "colors": np.ones(4)}, "colors: numbers of shape (4, 3)"),
        ({"positions": POINTS, "colors": POINTS}, "particle 0: colour (0 1 2) is not within"),
        ({"positions": POINTS, "elements": np.array(["C"] * 3)}, "elements: 3 values for 4"),
        ({"positions": POINTS, "elements": np.array(["Unobtainium"] * 4)}, "not all are symbols"),
        ({"positions": POINTS, "types": POINTS}, "types: (N,) strings or numbers are needed"),
        ({"positions": POINTS, "types": np.array([b"\xff"] * 4)}, "is not a NumPy archive, or"),
        ({"positions": POINTS, "box": np.eye(2)}, "box: numbers of shape (3, 3) or (3,)"),
        ({"positions": POINTS, "box": np.full((3, 3), np.inf)}, "box or origin is not finite"),
    ],
)
def test_broken_arrays(tmp_path: Path, arrays: dict[str, Any], words: str) -> None:
    path = save(tmp_path, **arrays)
    with pytest.raises(ph.FormatError) as caught:
        io.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)


def test_npz_with_a_header_that_lies(tmp_path: Path) -> None:
    array = streams.BytesIO()
    np.lib.format.write_array_header_1_0(
        array, {"descr": "<f8", "fortran_order": False, "shape": (4_000_000_000, 3)}
    )
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("positions.npy", array.getvalue() + b"\0" * 240)
    with pytest.raises(ph.FormatError, match="240 bytes of data for"):
        io.load(path)


def test_bombs_are_refused_early(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows and zeros that pack a thousand times are neither unpacked whole nor waited for."""
    for module in (text, npz):
        monkeypatch.setattr(module, "_BOMB_SIZE", 1 << 22)
    zeros = save(tmp_path, positions=np.zeros((1_000_000, 3)))
    rows = write(tmp_path, "a.xyz.xz", lzma.compress(b"9999999\n\n" + b"C 0 0 0\n" * 2_000_000))
    for path in (zeros, rows):
        with pytest.raises(ph.FormatError, match="unpacks to more than 250 times its size"):
            io.load(path)


def test_npz_has_one_frame(tmp_path: Path) -> None:
    path = save(tmp_path, positions=POINTS)
    assert len(io.load(path, LoadOptions(frame=-1)).shapes) == 2
    with pytest.raises(ph.FormatError, match="there is no frame 1; the file has 1 frame: 0"):
        io.load(path, LoadOptions(frame=1))


PDB = "ATOM      1  N   VAL A   1       6.204  16.869   4.854  1.00 49.05           N  \n"
GRO = "x\n1\n    1ALA      N    1   0.891   1.147   3.386\n   1.0   1.0   1.0\n"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.pdb", "", "is empty"),
        ("a.pdb", "junk\n", "there are no atoms"),
        ("a.pdb", "CONECT    1    2\n", "there are no atoms"),  # crashes chemfiles 0.10.4
        ("a.pdb", b"\x00\xff\x80" * 1000, ""),
        ("a.pdb", PDB[:40] + "\n", "too small"),
        ("a.pdb", PDB.replace("  6.204", "    nan"), "could not read positions"),
        ("a.pdb", PDB.encode().replace(b"N  ", b"\xe9  "), "is not UTF-8 text"),
        ("a.pdb.gz", PDB, "broken .gz data"),
        ("a.gro", "", "is empty"),
        ("a.gro", GRO.replace("\n1\n", "\n4000000000\n"), "not enough lines"),
        ("a.gro", "x\n0\n   1.0   1.0   1.0\n", "there are no atoms"),
        ("a.gro", GRO.replace("0.891", "  nan"), ""),
        ("a.gro", GRO[:40], "too small"),
        ("a.gsd", "", "cannot be read"),
        ("a.gsd", b"junk" * 100, "Not a GSD file"),
    ],
)
def test_broken_files_of_the_extras(
    tmp_path: Path, name: str, content: str | bytes, words: str
) -> None:
    pytest.importorskip("gsd" if "gsd" in name else "chemfiles")
    path = write(tmp_path, name, content)
    with pytest.raises(ph.FormatError) as caught:
        io.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)


def test_pdb_and_gro_in_small(tmp_path: Path) -> None:
    """Also that a GRO file's nanometres become angstrom, and a packed file is read."""
    pytest.importorskip("chemfiles")
    pdb = io.load(write(tmp_path, "a.PDB.gz", gzip.compress((PDB + "END\n").encode())))
    assert_allclose(pdb.shapes[0].centers, [[6.204, 16.869, 4.854]])
    assert_allclose(pdb.shapes[0].radii, [1.55])
    gro = io.load(write(tmp_path, "a.gro", GRO))
    assert_allclose(gro.shapes[0].centers, [[8.91, 11.47, 33.86]])


# ---------------------------------------------------------------------------------------------
# Any input at all gives a scene or one error

SEEDS = {
    "a.xyz": (WATER + EXTENDED).encode(),
    "a.dump": (DUMP + DUMP).encode(),
    "a.xyz.gz": gzip.compress((WATER * 3).encode(), mtime=0),
}


def load_or_refuse(path: Path, options: LoadOptions | None = None) -> ph.Scene | None:
    """The scene; None if the file was refused, which must be by an error that names it."""
    try:
        return io.load(path, options)
    except ph.FormatError as error:
        if not str(error).startswith(f"{path}: "):
            raise
        return None


@st.composite
def mutated(draw: st.DrawFn) -> tuple[str, bytes]:
    """One of the seeds with a few spans replaced, removed or repeated."""
    name = draw(st.sampled_from(sorted(SEEDS)))
    content = SEEDS[name]
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(content)))
        end = draw(st.integers(at, min(len(content), at + 20)))
        piece = draw(
            st.one_of(
                st.binary(max_size=8),
                st.sampled_from([b"nan", b"-1", b"4000000000", b"\n", b" ", b"1e400", b"ITEM:"]),
                st.just(content[at:end] * 2),
            )
        )
        content = content[:at] + piece + content[end:]
    return name, content


@given(mutated(), st.integers(-2, 2))
@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_text(tmp_path: Path, case: tuple[str, bytes], frame: int) -> None:
    path = write(tmp_path, *case)
    scene = load_or_refuse(path, LoadOptions(frame=frame))
    if scene is not None:
        assert np.isfinite(np.asarray(scene.shapes[0].centers)).all()
        assert (np.asarray(scene.shapes[0].radii) > 0).all()


@given(st.data())
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_archive(tmp_path: Path, data: st.DataObject) -> None:
    path = save(tmp_path, positions=POINTS, radii=np.ones(4), state=np.array(["a"] * 4))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(len(content) // 2, len(content)))])
    load_or_refuse(path)


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["H", "He", "Fe", "U"]),
            *[st.floats(-1e29, 1e29, allow_subnormal=False)] * 3,
        ),
        min_size=1,
        max_size=20,
    )
)
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_round_trip(tmp_path: Path, rows: list[tuple[str, float, float, float]]) -> None:
    """Numbers are read to the last bit, whatever they are."""
    content = f"{len(rows)}\n\n" + "".join(f"{s} {x!r} {y!r} {z!r}\n" for s, x, y, z in rows)
    particles = xyz.read(write(tmp_path, "a.xyz", content))
    assert_array_equal(particles.positions, [row[1:] for row in rows])
    assert names_of(particles.elements) == [row[0] for row in rows]


def test_a_hundred_thousand_atoms_are_read_in_no_time(tmp_path: Path) -> None:
    """Ten times slower than today's half a second for a million would be a loop over atoms."""
    rows = "".join(f"C {i % 97}.25 {i % 89}.5 {i % 83}.75\n" for i in range(100_000))
    path = write(tmp_path, "a.xyz", f"100000\n\n{rows}")
    start = time.perf_counter()
    xyz.read(path)
    assert time.perf_counter() - start < 1


@pytest.mark.parametrize("option", [{"colormap": "magma"}, {"color_range": (0.0, 1.0)}])
def test_a_colour_map_needs_a_field(option: dict[str, Any]) -> None:
    with pytest.raises(ph.SceneError, match="needs a field to colour by"):
        to_scene(cloud(), LoadOptions(**option), "test")


@pytest.mark.parametrize("point", [0xD800, 0x110000, 0xFFFFFFFF])
def test_text_in_an_archive_that_is_no_unicode(tmp_path: Path, point: int) -> None:
    names = np.array([point, 65], np.uint32).view("U1")
    np.savez(tmp_path / "a.npz", positions=np.eye(3)[:2], types=names)
    with pytest.raises(ph.FormatError, match=r"a.npz: types: holds text that is no Unicode"):
        ph.load(tmp_path / "a.npz")
