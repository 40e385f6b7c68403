"""Particles that are no spheres: ellipsoids, boxes, polyhedra and so on, turned by quaternions."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import io
from parhelion.framing import bounds
from parhelion.io import LoadOptions, lammps, npz, xyz
from parhelion.particles import Labels, Particles, glyphs, to_scene
from parhelion.scene import Instances

CUBE = np.array(list(product((-1.0, 1), repeat=3)))
TETRAHEDRON = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
# a third of a turn about (1, 1, 1): x to y, y to z, z to x
THIRD = np.array([1.0, 1, 1, 1])


def shown(positions: Any, drawn: glyphs.Glyphs, **more: Any) -> ph.Scene:
    scene = to_scene(
        Particles(np.asarray(positions, float), glyphs=drawn, **more), LoadOptions(), ""
    )
    ph.prepare(scene)
    return scene


def coverage(body: glyphs.Body, rays: int = 40) -> Any:
    """(rays, rays) depths along -z, from z = 10, over the square from -2 to 2."""
    scene = ph.Scene(
        list(body),
        camera=ph.Camera(eye=(0, 0, 10), target=(0, 0, 0), projection="orthographic", height=4),
    )
    image = ph.render(scene, width=rays, height=rays, spp=1, features=True, filter="box")
    return image.features["depth"]


# ---------------------------------------------------------------------------------------------
# Geometry


@pytest.mark.parametrize("count", [4, 8, 60, 500])
def test_hulls(count: int) -> None:
    spatial = pytest.importorskip("scipy.spatial")
    points = np.random.default_rng(count).normal(size=(count, 3)) * (1, 10, 0.1) + 50
    faces, edges, corners = glyphs.hull(points)
    expected = spatial.ConvexHull(points)
    assert_array_equal(np.sort(corners), np.sort(expected.vertices))
    a, b, c = (points[faces[:, k]] - 50 for k in range(3))
    assert_allclose(np.sum(a * np.cross(b, c)) / 6, expected.volume)  # outwards, all of them
    assert len(corners) - len(edges) + len(faces) == 2  # Euler


def test_hulls_of_solids_with_flat_faces() -> None:
    faces, edges, corners = glyphs.hull(np.concatenate([CUBE, 0.3 * CUBE, CUBE[:3]]))
    assert (len(faces), len(edges)) == (12, 12)
    assert_array_equal(np.sort(corners), np.arange(8))
    inner = np.array(list(product(range(4), repeat=3)), float)  # with points on faces and edges
    faces, edges, corners = glyphs.hull(inner)
    a, b, c = (inner[faces[:, k]] for k in range(3))
    assert_allclose(np.sum(a * np.cross(b, c)) / 6, 27)


def test_hulls_of_less_than_a_solid() -> None:
    square = np.array([[0, 0, 2], [0, 1, 2], [1, 1, 2], [1, 0, 2], [0.5, 0.5, 2]]) @ np.diag(
        [1, 2, 3]
    )
    faces, edges, corners = glyphs.hull(square)
    assert (len(faces), len(edges), len(corners)) == (4, 4, 4)  # two triangles on either side
    for points, expected in (
        ([[0, 0, 0], [1, 1, 1], [3, 3, 3]], (0, 1, 2)),
        ([[1, 2, 3]] * 3, (0, 0, 1)),
    ):
        assert tuple(map(len, glyphs.hull(np.array(points, float)))) == expected


def test_a_polygon_that_is_not_convex() -> None:
    corners = np.array([[0, 0], [4, 0], [4, 4], [2, 1], [0, 4], [0, 2], [0, 1]], float)
    (mesh,) = glyphs.polygon(corners)
    a, b, c = (corners[mesh.faces[:, k]] for k in range(3))
    areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (areas >= 0).all()
    assert_allclose(areas.sum() / 2, 16 - 4 * 3 / 2)
    backwards = glyphs.polygon(corners[::-1])[0]
    assert len(backwards.faces) == len(mesh.faces)
    random = np.random.default_rng(0)
    for count in range(5, 60):  # stars of uneven rays
        angles = np.sort(random.uniform(0, 2 * np.pi, count))
        star = random.uniform(0.2, 3, (count, 1)) * np.stack([np.cos(angles), np.sin(angles)], 1)
        assert len(glyphs.polygon(star)[0].faces) == count - 2
    with pytest.raises(ph.SceneError, match="sides cross"):
        glyphs.polygon([[2, 3], [3, 0], [4, 0], [4, 1], [2, 0]])


@pytest.mark.parametrize(
    ("vertices", "distance"),
    [
        (0.5 * CUBE, lambda p: np.linalg.norm(np.maximum(np.abs(p) - 0.5, 0), axis=1)),
        ([[0, 0, 0]], lambda p: np.linalg.norm(p, axis=1)),
        (
            [[-0.5, 0, 0], [0.5, 0, 0]],
            lambda p: np.linalg.norm(p - np.clip(p, -0.5, 0.5) * (1, 0, 0), axis=1),
        ),
        (
            [[0, -0.5, -0.5], [0, 0.5, -0.5], [0, 0.5, 0.5], [0, -0.5, 0.5]],
            lambda p: np.linalg.norm(p - np.clip(p, -0.5, 0.5) * (0, 1, 1), axis=1),
        ),
    ],
)
def test_rounded_polyhedra_are_what_is_near(vertices: Any, distance: Any) -> None:
    """Every point of the surface that is seen lies at the rounding radius from the polyhedron."""
    radius, rays = 0.4, 41
    depth = coverage(glyphs.polyhedron(vertices, radius), rays)[..., 0]
    middle = (np.arange(rays) + 0.5) / rays * 4 - 2
    x, y = np.meshgrid(middle, -middle)
    hit = np.isfinite(depth) & (depth > 0)
    points = np.stack([x[hit], y[hit], 10 - depth[hit]], axis=1)
    assert hit.sum() > 50
    assert_allclose(distance(points), radius, atol=0.07)  # a pixel holds rays 0.05 from its middle
    shadow = distance(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)).reshape(x.shape)
    assert_array_equal(
        hit[np.abs(shadow - radius) > 0.08], (shadow < radius)[np.abs(shadow - radius) > 0.08]
    )


# ---------------------------------------------------------------------------------------------
# Scenes


def test_quaternions_turn_from_the_body_to_the_scene() -> None:
    matrices = glyphs.rotations(
        np.array([[2.0, 0, 0, 0], [1e-200] * 4, [1, 0, 0, 1], [0, 1e300, 0, 0]])
    )
    assert_allclose(matrices[0], np.eye(3))
    assert_allclose(matrices[1] @ [1, 2, 3], [3, 1, 2], atol=1e-12)
    assert_allclose(matrices[2] @ [1, 2, 3], [-2, 1, 3], atol=1e-12)  # a quarter about z
    assert_allclose(matrices[3] @ [1, 2, 3], [1, -2, -3], atol=1e-12)  # half a turn about x


def test_ellipsoids_have_their_own_axes_turns_and_colours() -> None:
    axes = np.array([[1, 2, 3], [4, 1, 1], [0, 0, 0], [1, 1, 2.0]])
    turns = np.array([[1, 0, 0, 0], THIRD, [0, 0, 0, 0], [1, 0, 0, 0]])
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 0.0]])
    places = np.arange(12.0).reshape(4, 3) * 10
    scene = shown(places, glyphs.ellipsoids(axes, turns), colors=colors, radii=np.full(4, 0.5))
    *groups, spheres = scene.shapes
    assert_allclose(spheres.centers, places[2:3])
    assert_array_equal(spheres.colors, colors[2:3])
    found = {}
    for group in groups:
        assert isinstance(group, Instances)
        for matrix, color in zip(group.transforms, group.colors, strict=True):
            found[tuple(matrix[:, 3])] = matrix[:, :3], color
    assert len(groups) == 1
    for i, expected in ((0, np.diag(axes[0])), (1, np.roll(np.diag(axes[1]), 1, axis=0))):
        matrix, color = found[tuple(places[i])]
        assert_allclose(matrix, expected, atol=1e-12)
        assert_array_equal(color, colors[i])


def test_an_ellipsoid_is_seen_as_one() -> None:
    """The picture's shares are those of ellipses, 2 by 1 and, end on, 1 by 1."""
    for turn, area in (([1.0, 0, 0, 0], 2 * np.pi), (THIRD, 1 * np.pi)):
        # semi-axes 2, 1, 1 become 1, 2, 1 by a third of a turn; seen along y
        scene = shown([[0, 0, 0]], glyphs.ellipsoids(np.array([[2.0, 1, 1]]), np.array([turn])))
        camera = ph.Camera(
            eye=(0, -10, 0), target=(0, 0, 0), up=(0, 0, 1), projection="orthographic", height=6
        )
        image = ph.render(
            scene.replace(camera=camera, background=None),
            width=120,
            height=120,
            spp=4,
            features=True,
        )
        share = image.matte(shape="particles").mean()
        assert_allclose(share * 36, area, rtol=0.01)


def test_named_bodies_fill_their_half_extents() -> None:
    half, place = np.array([0.5, 0.5, 1.5]), np.array([1.0, 2, 3])
    for name in ("ellipsoid", "box", "cylinder", "spherocylinder"):
        scene = shown([place], glyphs.named(1, name, half))
        low, high = bounds(scene.replace(camera=None))
        slack = 1.13 if name in ("ellipsoid", "cylinder") else 1.0
        assert (high >= half + place - 1e-9).all()
        assert (low <= place - half + 1e-9).all()
        if name in ("box", "spherocylinder"):
            assert_allclose([low, high], [place - half, half + place])
        elif name == "ellipsoid":
            assert (high <= slack * half + place).all()
    kinds = glyphs.named(
        4, np.array(["box", "sphere", "box", "polyhedron"]), half, None, TETRAHEDRON
    )
    assert_array_equal(kinds.spheres(), [False, True, False, False])
    assert len(shown(np.eye(4)[:, :3] * 9, kinds, radii=np.ones(4)).shapes) == 3


def test_colours_by_a_field_stay() -> None:
    count = 500
    random = np.random.default_rng(0)
    drawn = glyphs.ellipsoids(random.uniform(0.2, 1, (count, 3)), random.normal(size=(count, 4)))
    values = np.arange(count) % 7.0
    particles = Particles(random.uniform(0, 20, (count, 3)), glyphs=drawn, fields={"v": values})
    scene = to_scene(particles, LoadOptions(color_by="v", color_range=(0, 6)), "")
    (group,) = scene.shapes
    assert isinstance(group, Instances)
    assert len(group.transforms) == count
    expected = Particles(particles.positions, radii=np.ones(count), fields={"v": values})
    plain = to_scene(expected, LoadOptions(color_by="v", color_range=(0, 6)), "").shapes[0]
    assert_array_equal(group.colors, plain.colors)  # type: ignore[arg-type, union-attr]


ONE = np.ones((1, 3))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: glyphs.ellipsoids(ONE, np.zeros((1, 4))), "particle 0: orientation (0 0 0 0) is"),
        (lambda: glyphs.ellipsoids(ONE, np.full((1, 4), np.nan)), "particle 0: orientation (nan"),
        (lambda: glyphs.ellipsoids(ONE, np.full((1, 4), np.inf)), "particle 0: orientation (inf"),
        (lambda: glyphs.ellipsoids(ONE * (1, 1, 0)), "particle 0: size (1 1 0) is not three"),
        (lambda: glyphs.ellipsoids(ONE * [[1] * 3, [1, -1, 1]]), "particle 1: size (1 -1 1)"),
        (lambda: glyphs.ellipsoids(ONE * (1, np.nan, 1)), "particle 0: size (1 nan 1)"),
        (lambda: glyphs.ellipsoids(ONE * (1, 1e35, 1)), "particle 0: size (1 1e+35 1)"),
        (lambda: glyphs.named(2, "elipsoid", ONE[0]), "did you mean 'ellipsoid'"),
        (lambda: glyphs.named(2, "box"), "'box' need half extents"),
        (lambda: glyphs.named(2, "box", [1, 1]), "numbers of shape (2, 3) are needed, not (2,)"),
        (lambda: glyphs.named(2, "polyhedron"), "need vertices"),
        (lambda: glyphs.named(1, "spherocylinder", [1, 1, 0.5]), "half extents (1 1 0.5) must be"),
        (lambda: glyphs.named(1, "spherocylinder", [0, 0, 0]), "size (0 0 0)"),
        (lambda: glyphs.polyhedron([[0, 0, 0], [1, 1, 1]]), "lie in a line"),
        (lambda: glyphs.polyhedron([[0, 0, 0], [1, 1, np.nan]], 1.0), "a vertex is not finite"),
        (lambda: glyphs.polyhedron(np.ones((5000, 3)), 1.0), "4096 are the most"),
        (lambda: glyphs.polyhedron(CUBE, -1.0), "rounding radius -1.0"),
        (lambda: glyphs.polyhedron(CUBE, float("nan")), "rounding radius nan"),
        (lambda: glyphs.polygon([[0, 0], [1, 1]]), "has 2 corners, and no area"),
        (lambda: glyphs.polygon(np.zeros((2000, 2))), "1000 are the most"),
        (lambda: glyphs.union([[0, 0, 0]], [0.0]), "radii, which are positive"),
        (lambda: glyphs.faceted(CUBE, [[0, 1, 8]]), "face [0, 1, 8] is not three or more of"),
        (lambda: glyphs.faceted(CUBE, [[0, 1, -1]]), "is not three or more"),
        (lambda: glyphs.faceted(CUBE, [[0, 1]]), "is not three or more"),
        (lambda: glyphs.faceted(CUBE, []), "has no faces"),
    ],
)
def test_refused(make: Any, words: str) -> None:
    with np.errstate(all="raise"), pytest.raises(ph.SceneError) as caught:
        make()
    assert words in str(caught.value)


def test_counts_must_fit() -> None:
    with pytest.raises(ph.SceneError, match="glyphs: 2 values for 3 particles"):
        shown(np.zeros((3, 3)), glyphs.named(2, "box", np.ones(3)))


# ---------------------------------------------------------------------------------------------
# Files


def first_matrix(scene: Any) -> Any:
    return scene.shapes[0].transforms[0]


def test_extended_xyz_in_ovitos_names(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text(
        "2\nProperties=species:S:1:pos:R:3:orientation:R:4:aspherical_shape:R:3\n"
        "C 1 2 3 0 0 1 1 4 5 6\nC 9 9 9 0 0 0 0 0 0 0\n"
    )
    # a quarter of a turn about z: the real part comes last
    scene = io.load(path)
    assert_allclose(first_matrix(scene), [[0, -5, 0, 1], [4, 0, 0, 2], [0, 0, 6, 3]], atol=1e-12)
    assert_allclose(scene.shapes[1].centers, [[9, 9, 9]])  # no axes at all: a sphere
    assert_array_equal(xyz.read(path).fields["orientation"], [[0, 0, 1, 1], [0, 0, 0, 0]])


@pytest.mark.parametrize(
    "columns",
    [
        "quatw quati quatj quatk shapex shapey shapez",
        "c_q[1] c_q[2] c_q[3] c_q[4] c_shape[1] c_shape[2] c_shape[3]",
        "c_orient[1] c_orient[2] c_orient[3] c_orient[4] c_diameter[1] c_diameter[2] c_diameter[3]",
    ],
)
def test_lammps(tmp_path: Path, columns: str) -> None:
    path = tmp_path / "a.dump"
    path.write_text(
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp pp\n0 9\n0 9\n0 9\n"
        f"ITEM: ATOMS id type x y z {columns}\n"
        "1 1 1 2 3 1 0 0 1 8 10 12\n2 1 9 9 9 0 0 0 0 0 0 0\n"
    )
    scene = io.load(path)
    assert_allclose(first_matrix(scene), [[0, -5, 0, 1], [4, 0, 0, 2], [0, 0, 6, 3]], atol=1e-12)
    assert lammps.read(path).fields[columns.split()[0]][0] == 1  # type: ignore[index]
    path.write_text(path.read_text().replace("1 0 0 1 8", "0 0 0 0 8"))
    with pytest.raises(ph.FormatError, match=r"a.dump: particle 0: orientation \(0 0 0 0\)"):
        io.load(path)


def test_npz(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    positions = np.array([[1.0, 2, 3], [9, 9, 9]])
    np.savez(path, positions=positions, semi_axes=[4, 5, 6], orientations=[[1, 0, 0, 1]] * 2)
    expected = [[0, -5, 0, 1], [4, 0, 0, 2], [0, 0, 6, 3]]
    assert_allclose(first_matrix(io.load(path)), expected, atol=1e-12)
    assert np.shape(npz.read(path).fields["orientations"]) == (2, 4)
    np.savez(path, positions=positions, vertices=TETRAHEDRON, rounding_radius=0.25)
    group = io.load(path).shapes[0]
    assert [len(s.centers) for s in group.shapes if isinstance(s, ph.Spheres)] == [4]
    np.savez(path, positions=positions, shape=np.array(["box", "sphere"]), half_extents=np.ones(3))
    found = npz.read(path).glyphs
    assert found is not None
    assert_array_equal(found.spheres(), [False, True])
    for bad, words in (
        ({"shape": "cube", "half_extents": np.ones(3)}, "unknown shape of particles 'cube'"),
        ({"shape": np.ones(2)}, "shape: one name"),
        ({"half_extents": np.ones((3, 3))}, "half_extents: numbers of shape (2, 3) or (3,)"),
        ({"vertices": np.array(["a"])}, "vertices are not (M, 3) numbers"),
    ):
        np.savez(path, positions=positions, **bad)  # type: ignore[arg-type]
        with pytest.raises(ph.FormatError) as caught:
            io.load(path)
        assert words in str(caught.value)


SHAPES: list[tuple[Any, list[str]]] = [
    ({}, ["Spheres"]),
    ({"type": "Sphere", "diameter": 3.0}, ["Spheres"]),
    ({"type": "Ellipsoid", "a": 4, "b": 5, "c": 6}, ["Instances", "Spheres"]),
    ({"type": "ConvexPolyhedron", "vertices": CUBE.tolist()}, ["Instances", "Mesh"]),
    (
        {"type": "ConvexPolyhedron", "vertices": CUBE.tolist(), "rounding_radius": 0.1},
        ["Instances", "Mesh", "Cylinders", "Spheres"],
    ),
    ({"type": "Polygon", "vertices": [[0, 0], [1, 0], [0, 1]]}, ["Instances", "Mesh"]),
    (
        {"type": "Mesh", "vertices": CUBE.tolist(), "indices": [[0, 1, 3, 2], [4, 5, 7]]},
        ["Instances", "Mesh"],
    ),
    (
        {"type": "SphereUnion", "centers": CUBE.tolist(), "diameters": [2.0] * 8},
        ["Instances", "Spheres"],
    ),
]


def gsd_file(path: Path, shapes: list[Any], orientation: Any = None, **more: Any) -> Path:
    """Two particles of each type, by texts or objects that are their shapes."""
    fl = pytest.importorskip("gsd.fl")
    texts = [s if isinstance(s, str) else json.dumps(s) for s in shapes]
    width = max(len(t) for t in texts) + 1
    count = 2 * len(shapes)
    with fl.open(str(path), "w", application="test", schema="hoomd", schema_version=[1, 4]) as file:
        file.write_chunk("configuration/box", np.array([9, 9, 9, 0, 0, 0], np.float32))
        file.write_chunk("particles/N", np.array([count], np.uint32))
        positions = np.arange(3.0 * count).reshape(count, 3)
        file.write_chunk("particles/position", positions.astype(np.float32))
        ids = np.arange(count, dtype=np.uint32) // 2
        file.write_chunk("particles/typeid", np.asarray(more.get("typeid", ids)))
        names = np.array([[ord("A") + i, 0] for i in range(len(shapes))], np.int8)
        file.write_chunk("particles/types", names)
        rows = np.array([list(t.encode().ljust(width, b"\0")) for t in texts], np.int8)
        file.write_chunk("particles/type_shapes", rows)
        if orientation is not None:
            turns = np.tile(np.asarray(orientation, np.float32), (count, 1))
            file.write_chunk("particles/orientation", turns)
        file.end_frame()
    return path


@pytest.mark.parametrize(("shape", "expected"), SHAPES)
def test_gsd(tmp_path: Path, shape: Any, expected: list[str]) -> None:
    scene = io.load(gsd_file(tmp_path / "a.gsd", [shape], [1, 0, 0, 1]))
    thing: Any = scene.shapes[0]
    kinds = [type(thing).__name__] + [type(s).__name__ for s in getattr(thing, "shapes", ())]
    assert kinds == expected
    ph.prepare(scene)
    if shape.get("type") == "Sphere":
        assert_allclose(thing.radii, 1.5)
    if shape.get("type") == "Ellipsoid":
        turned = [[0, -5, 0, 0], [4, 0, 0, 1], [0, 0, 6, 2]]
        assert_allclose(thing.transforms[0], turned, atol=1e-6)


def test_gsd_of_all_shapes_at_once(tmp_path: Path) -> None:
    scene = io.load(gsd_file(tmp_path / "a.gsd", [shape for shape, _ in SHAPES]))
    assert len(scene.shapes) == 6 + 1 + 1  # groups, spheres and the lamp
    (spheres,) = (s for s in scene.shapes if s.name == "particles" and isinstance(s, ph.Spheres))
    assert_allclose(spheres.radii, [0.5, 0.5, 1.5, 1.5])  # the schema's default diameter is 1


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ("{", "particles/type_shapes of 'A': Expecting"),
        ("[" * 900, "particles/type_shapes of 'A': "),
        ("[" * 100_000, "particles/type_shapes of 'A': "),
        ("[]", "is not an object of JSON"),
        ({"type": "Torus"}, "unknown shape 'Torus'"),
        ({"type": "Sphere"}, "lacks 'diameter'"),
        ({"type": "Sphere", "diameter": -1}, "diameter -1 is not positive"),
        ({"type": "Ellipsoid", "a": 1, "b": 1}, "lacks 'c'"),
        ({"type": "Ellipsoid", "a": 1, "b": 1, "c": float("nan")}, "is not positive"),
        (
            {"type": "ConvexPolyhedron", "vertices": [[1, 2], [3]]},
            "vertices are not (M, 3) numbers",
        ),
        ({"type": "ConvexPolyhedron", "vertices": [[10**400, 0, 0]]}, "vertices are not (M, 3)"),
        ({"type": "Sphere", "diameter": 10**400}, "type_shapes of 'A': "),
        ({"type": "ConvexPolyhedron", "vertices": []}, "vertices have shape (0,)"),
        ({"type": "ConvexPolyhedron", "vertices": 7}, "vertices have shape ()"),
        ({"type": "ConvexPolyhedron", "vertices": [[1, 2, 3]]}, "lie in a line"),
        ({"type": "Polygon", "vertices": [[1, 2, 3]]}, "corners of a polygon have shape (1, 3)"),
        ({"type": "Polygon", "vertices": [[0, 0], [1]]}, "type_shapes of 'A'"),
        ({"type": "Mesh", "vertices": [[1, 2, 3]], "indices": [[0, 0, 1]]}, "is not three or more"),
        ({"type": "Mesh", "vertices": [[1, 2, 3]], "indices": 5}, "type_shapes of 'A'"),
        ({"type": "SphereUnion", "centers": [[0, 0, 0]], "diameters": "x"}, "type_shapes of 'A'"),
    ],
)
def test_bad_shapes_in_gsd(tmp_path: Path, shape: Any, words: str) -> None:
    path = gsd_file(tmp_path / "a.gsd", [shape])
    with pytest.raises(ph.FormatError) as caught:
        io.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)


NUMBERS = st.one_of(
    st.floats(-3, 3), st.sampled_from([0, -1, 1e300, float("nan"), float("inf"), 10**400, True])
)
ANYTHING = st.one_of(NUMBERS, st.none(), st.text(max_size=3), st.lists(NUMBERS, max_size=3))
ROWS = st.lists(st.one_of(st.lists(NUMBERS, min_size=2, max_size=3), ANYTHING), max_size=6)


@given(
    st.fixed_dictionaries(
        {"type": st.sampled_from([s["type"] for s, _ in SHAPES if s])},
        optional={
            **dict.fromkeys(("a", "b", "c", "diameter", "rounding_radius"), ANYTHING),
            **dict.fromkeys(("vertices", "indices", "centers", "diameters"), ROWS),
        },
    )
)
@example({"type": "Sphere", "diameter": 1e300})
@settings(max_examples=100, deadline=None)
def test_any_shape_is_a_body_or_one_error(shape: dict[str, Any]) -> None:
    pytest.importorskip("gsd")
    from parhelion.io import gsd_file

    kinds = Labels(np.zeros(2, int), ("A",))
    try:
        drawn, radii = gsd_file._glyphs([json.dumps(shape)], kinds, None)
    except ph.SceneError as error:
        if not str(error).startswith("particles/type_shapes of 'A': "):
            raise
        return
    assert (radii >= 0).all()
    radii = np.maximum(radii, 0.5)
    try:
        particles = Particles(np.eye(3)[:2], glyphs=drawn, radii=radii)
    except ph.SceneError as error:
        assert radii[0] > 1e30
        assert "particle 0: radius" in str(error)  # noqa: PT017
        return
    for thing in to_scene(particles, LoadOptions(), "").shapes:
        for solid in getattr(thing, "shapes", [thing]):
            for key in ("vertices", "centers", "starts", "ends", "radii"):
                assert np.isfinite(np.asarray(getattr(solid, key, 0.0))).all()


def test_gsd_orientations_of_nothing(tmp_path: Path) -> None:
    path = gsd_file(
        tmp_path / "a.gsd", [{"type": "Ellipsoid", "a": 1, "b": 2, "c": 3}], [0, 0, 0, 0]
    )
    with pytest.raises(ph.FormatError, match=r"particle 0: orientation \(0 0 0 0\)"):
        io.load(path)
    # spheres need none
    io.load(gsd_file(path, [{}], [0, 0, 0, 0]))
    with pytest.raises(ph.FormatError, match=r"particles/orientation has shape \(2, 3\)"):
        io.load(gsd_file(path, [{}], [0, 0, 0]))


@pytest.mark.parametrize("ids", [[0, 1], [-1, 0], [0.0, 0.5], [[0, 0]]])
def test_gsd_types_that_are_not_there(tmp_path: Path, ids: Any) -> None:
    path = gsd_file(tmp_path / "a.gsd", [{}], typeid=ids)
    with pytest.raises(ph.FormatError, match="particles/typeid has a type that"):
        io.load(path)


def test_labels_of_types_choose_shapes() -> None:
    """As GSD has them: by type, with the colour of the type."""
    types = Labels(np.array([0, 1, 1]), ("A", "B"))
    drawn = glyphs.Glyphs([None, glyphs.cube()], types.codes)
    *groups, spheres = shown(np.eye(3), drawn, types=types, radii=np.full(3, 0.1)).shapes
    assert len(spheres.centers) == 1
    assert [len(group.transforms) for group in groups] == [2]
