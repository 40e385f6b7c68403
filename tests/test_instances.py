"""Instances with known answers: what they show, and where."""

from __future__ import annotations

import numpy as np
import pytest

import parhelion as ph
from floor_tools import (
    LAMP,
    PLACES,
    WHITE,
    Floor,
    ball,
    glass,
    lamps,
    moved,
    picture,
    quad,
    scene_runs,
    statue,
    steep_normals,
)
from parhelion import _core
from statistics_tools import SIGNIFICANCE, mean_p


def test_a_moved_copy_is_hit_where_the_moved_mesh_is() -> None:
    mesh = statue()
    offset = np.array([4.0, -2.0, 0.5])
    baked = ph.Mesh(np.asarray(mesh.vertices) + offset, mesh.faces)
    rng = np.random.default_rng(10)
    cores = [
        ph.prepare(ph.Scene([s])).core
        for s in (baked, ph.Instances([mesh], [moved(np.eye(3), offset)]))
    ]
    o = rng.uniform(-1.5, 1.5, (20_000, 3)) + offset
    d = rng.normal(size=o.shape)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o, d = o.astype(np.float32), d.astype(np.float32)
    (t, ids), (u, others) = (core.intersect(o, d) for core in cores)
    assert np.mean(ids >= 0) > 0.1
    same = ids == others
    assert np.mean(same) > 1 - 1e-3  # at edges rounding may decide
    np.testing.assert_allclose(u[same], t[same], rtol=1e-5, atol=1e-6)
    for core in cores:
        whole = core.intersect(o, d, tree=False)
        for a, b in zip(core.intersect(o, d), whole, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("size", [1e-17, 1e-40])
def test_instances_that_are_too_small_are_refused(size: float) -> None:
    """Rays in their frame would be too long for single precision."""
    shapes = [ph.Spheres([[1.0, 0, 0]], 0.5), ph.Spheres([[0.0, 0, 0]], 1.0)]
    placed = ph.Instances(shapes[1:], [np.eye(4), np.diag([size, 2 * size, size, 1])], name="dust")
    with pytest.raises(ph.SceneError, match=r"'dust': transforms\[1\] makes .* too small beside"):
        ph.prepare(ph.Scene([shapes[0], placed]))


def test_a_small_instance_far_from_the_ray_is_closed() -> None:
    """As seen from the camera's side of a scene a million times its size, and from near by."""
    closed = ball(12, 24, ph.Material("diffuse"))
    far = ph.Spheres([[1.0, 0, 0], [-1.0, 0, 0]], 0.01)
    rng = np.random.default_rng(12)
    for size in (1e-2, 1e-4, 1e-6):
        core = ph.prepare(
            ph.Scene([far, ph.Instances([closed], [np.eye(4) * [size, size, size, 1]])])
        ).core
        aim = rng.normal(size=(5000, 3))
        aim *= (
            0.5 * size * rng.uniform(0, 1, (5000, 1)) / np.linalg.norm(aim, axis=1, keepdims=True)
        )
        o = rng.normal(size=aim.shape)
        o *= rng.choice([0.9, 30 * size], (5000, 1)) / np.linalg.norm(o, axis=1, keepdims=True)
        o = o.astype(np.float32)
        d = aim - o
        d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
        near, ids = core.intersect(o, d)
        assert np.all((ids >= 0) & (ids < len(closed.faces)))
        whole = core.intersect(o, d, tree=False)
        np.testing.assert_array_equal(near, whole[0])
        np.testing.assert_array_equal(ids, whole[1])


def test_instances_have_colours_of_their_own() -> None:
    """What the camera sees of three copies, of which each has a part that keeps its colour."""
    gray, kept = ph.Material("diffuse", color=(0.5, 0.5, 0.5)), (0.9, 0.1, 0.4)
    parts = [
        ph.Spheres([[0, 0.5, 0]], 0.4, gray),
        ph.Spheres([[0, -0.5, 0]], 0.4, gray, [kept]),
    ]
    places = np.tile(np.eye(4), (3, 1, 1))
    places[:, 0, 3] = (-1, 0, 1)
    colors = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]], np.float32)
    camera = ph.Camera((0, 0, 9), (0, 0, 0), projection="orthographic", height=2.0)
    scene = ph.Scene(
        [ph.Instances(parts, places, colors=colors)],
        camera=camera,
        background=WHITE,
    )
    size = {"width": 3, "height": 2, "spp": 1, "filter_radius": 1e-6, "features": True}
    image = ph.render(scene, **size)
    albedo = image.features["albedo"]
    np.testing.assert_array_equal(albedo[0], colors)
    np.testing.assert_array_equal(albedo[1], np.float32([kept] * 3))
    plain = scene.replace(shapes=(ph.Instances(parts, places),))
    image = ph.render(plain, **size)
    np.testing.assert_array_equal(image.features["albedo"][0], np.float32(0.5))
    with pytest.raises(ph.SceneError, match=r"'red': colors\[1\].*colour of diffuse must lie in"):
        ph.prepare(scene.replace(shapes=(ph.Instances(parts, places, "red", 2 * colors),)))
    with pytest.raises(ph.SceneError, match=r"colors has shape \(2, 3\); must be \(3, 3\)"):
        ph.prepare(scene.replace(shapes=(ph.Instances(parts, places, "red", colors[:2]),)))


@pytest.mark.parametrize("place", PLACES)
def test_an_instance_looks_as_the_moved_mesh_does(place: str) -> None:
    matrix = PLACES[place]
    lit = ph.Material("diffuse", color=(0.3, 0.3, 0.3), emission=(0.5, 0.5, 0.5))
    shapes = [statue(), quad((0, 0, 0), (0.5, 0, 0), (0.2, 0.4, 0), lit)]
    baked = []
    for s in shapes:
        vertices = np.asarray(s.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
        flip = np.linalg.det(matrix[:3, :3]) < 0
        baked.append(ph.Mesh(vertices, s.faces, material=s.material, inside_out=flip))
    camera = ph.Camera(eye=(0.2, 1.2, 6), target=(0.2, 1.2, 0), vfov=30)
    a, b = (
        scene_runs(
            ph.Scene([Floor().mesh(), *made], camera=camera, background=WHITE),
            first=100 * i,
            width=12,
            height=12,
            spp=64,
            max_depth=6,
        )[..., 0]
        for i, made in enumerate((baked, [ph.Instances(shapes, [matrix])]))
    )
    # Where a pixel's centre lies within rounding of an edge all samples may change sides.
    gap = a - b
    moved_over = np.abs(gap.mean(axis=0)) > 0.2
    assert moved_over.sum() <= 1
    assert mean_p(gap[:, ~moved_over], np.zeros((~moved_over).sum()), 0.0) > SIGNIFICANCE
    assert abs(a.mean() / b.mean() - 1) < 0.01


@pytest.mark.parametrize("basis", ["linear", "bspline"])
def test_ends_of_curves(basis: str) -> None:
    """Along their axis: half spheres close them, open ones let a ray through."""
    strand = np.stack([np.zeros(8), np.zeros(8), np.linspace(-2, 5, 8)], axis=1)
    start, end = (-1.0, 4.0) if basis == "bspline" else (-2.0, 5.0)
    o, d = np.float32([[0.03, 0.04, -9]]), np.float32([[0, 0, 1]])
    for capped in (True, False):
        curves = ph.Curves(strand, 0.1, basis=basis, capped=capped)
        core = ph.prepare(ph.Scene([curves])).core
        t, ids = core.intersect(o, d)
        if capped:
            np.testing.assert_allclose(t, start + 9 - np.sqrt(0.01 - 0.0025), rtol=1e-5)
        else:
            inner = basis == "linear"  # spheres at its joints
            assert (ids[0] >= 0) == inner
            aside = core.intersect(np.float32([[0.05, 3, end - 0.1]]), np.float32([[0, -1, 0]]))
            np.testing.assert_allclose(aside[0], 3 - np.sqrt(0.01 - 0.0025), rtol=1e-5)


def everything() -> ph.Scene:
    """Most of the above in one scene."""
    rng = np.random.default_rng(11)
    image = rng.uniform(0, 1, (8, 8, 3)).astype(np.float32)
    matrices = np.tile(np.eye(4), (12, 1, 1))
    matrices[:, :3, :3] = rng.normal(size=(12, 3, 3)) * 0.2
    matrices[:, :3, 3] = rng.uniform((-1, 0.3, -1), (1, 1.5, 1), (12, 3))
    bumpy = ph.Material(
        "principled",
        color=ph.Texture("image", image=image),
        normal_map=steep_normals(),
    )
    embossed = ph.Material("plastic", bump_map=ph.Texture("image", image=image))
    thin = ph.Material("principled", color=(0.5, 0.8, 0.9), opacity=0.8)
    group = [
        statue(),
        ball(6, 8, thin),
        quad((0, 0, 0), (0.5, 0, 0), (0.2, 0.4, 0), LAMP),
        ph.Cylinders([[0, 0, 0]], [[0, 0, 0.8]], 0.2, material=LAMP),
    ]
    water = glass(1, 1.33, absorption=(0.5, 0.1, 0.1))
    down = np.array([[1, 0, 0, 0], [0, 0, -1, 3], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    return ph.Scene(
        [
            Floor().mesh(ph.Material("blend", a=embossed, b=bumpy, weight=0.4)),
            ph.Instances(group, matrices),
            ph.Spheres(rng.uniform((-1, 0, -1), (1, 1, 1), (6, 3)), 0.4, water),
            ph.Spheres(rng.uniform((-1, 0, -1), (1, 1, 1), (6, 3)), 0.3, glass(2, 1.5)),
            lamps(50)[0],
        ],
        camera=ph.Camera(eye=(2, 2, 4), target=(0, 0.5, 0), vfov=35),
        background=ph.Background("envmap", image=image),
        lights=[
            ph.Light("point", position=(0, 3, 0), intensity=(4, 4, 4)),
            ph.Light("projector", image=image, transform=down, scale=(4, 4, 4)),
        ],
    )


def test_the_same_bits_however_it_is_made() -> None:
    prepared = ph.prepare(everything())
    size = {"width": 24, "height": 16, "spp": 2, "max_depth": 8}
    reference = picture(prepared, **size)
    assert np.all(np.isfinite(reference))
    assert len(np.unique(reference)) > 500
    for isa in _core.instruction_sets():
        assert picture(prepared, isa=isa, **size).tobytes() == reference.tobytes(), isa
    again = picture(ph.prepare(everything()), threads=2, tile=5, **size)
    assert again.tobytes() == reference.tobytes()
    assert picture(prepared, tree="none", **size).tobytes() == reference.tobytes()


@pytest.mark.parametrize("kind", ["spheres", "mesh", "disks", "cylinders", "curves", "instances"])
def test_a_pixel_that_shows_many_small_things(kind: str) -> None:
    """Camera rays go their own ways among what is narrow beside them (core/packet.h)."""
    rng = np.random.default_rng(17)
    centers = rng.uniform(-1, 1, (1500, 3))
    along, across = np.array([[0.03, 0, 0]]), np.array([[0, 0.03, 0.0]])
    ends = centers + along
    corners = np.stack([centers, ends, centers + across], axis=1).reshape(-1, 3)
    one = ph.Spheres([[0, 0, 0]], 1.0)
    shape = {
        "spheres": lambda: ph.Spheres(centers, 0.02),
        "mesh": lambda: ph.Mesh(corners, np.arange(len(corners)).reshape(-1, 3)),
        "disks": lambda: ph.Disks(centers, along + 0 * centers, across + 0 * centers),
        "cylinders": lambda: ph.Cylinders(centers, ends, 0.01),
        "curves": lambda: ph.Curves(
            np.stack([centers, ends], axis=1).reshape(-1, 3),
            0.01,
            counts=np.full(len(centers), 2),
            basis="linear",
        ),
        "instances": lambda: ph.Instances([one], [moved(0.02 * np.eye(3), c) for c in centers]),
    }[kind]()
    camera = ph.Camera(eye=(0.3, 0.2, 5), target=(0, 0, 0), vfov=30)
    prepared = ph.prepare(ph.Scene([shape], camera=camera))
    size = {"width": 6, "height": 6, "max_depth": 3, "filter_radius": 0.5}
    reference = picture(prepared, tree="none", **size)
    assert np.ptp(reference) > 0.05
    assert picture(prepared, **size).tobytes() == reference.tobytes()
