"""Rays of one's own: known answers, where they set off, and what is refused."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core, memory

RNG = np.random.default_rng


def directions(n: int, seed: int = 1) -> np.ndarray:
    d = RNG(seed).normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def globe(size: int, radius: float = 1.0, center: tuple[float, ...] = (0, 0, 0)) -> ph.Mesh:
    """A closed mesh around a centre, turned outwards."""
    across, down = 2 * size, size
    u = np.arange(across) * (2 * np.pi / across)
    v = np.arange(1, down) * (np.pi / down)
    ring = np.stack(
        [np.outer(np.sin(v), np.cos(u)), np.outer(np.sin(v), np.sin(u)),
         np.outer(np.cos(v), np.ones(across))], axis=-1,
    ).reshape(-1, 3)  # fmt: skip
    points = np.concatenate([ring, [[0, 0, 1], [0, 0, -1]]]) * radius + center
    faces = []
    for i in range(across):
        j = (i + 1) % across
        faces.append((len(ring), i, j))
        for k in range(down - 2):
            a, b = k * across + i, k * across + j
            faces += [(a, a + across, b + across), (a, b + across, b)]
        last = (down - 2) * across
        faces.append((len(ring) + 1, last + j, last + i))
    return ph.Mesh(points, faces, name="globe")


def test_what_is_met_and_where() -> None:
    """From the middle of a square of balls over a floor."""
    balls = ph.Spheres([(5, 0, 0), (0, 0, 5), (-5, 0, 0)], [1.0, 2.0, 0.5], name="balls")
    corners = [(-9, -2, -9), (9, -2, -9), (9, -2, 9), (-9, -2, 9)]
    floor = ph.Mesh(corners, [(0, 2, 1), (0, 3, 2)], name="floor")
    places = [np.eye(4), np.eye(4)]
    places[1][:3, 3] = (0, 0, -7)
    copies = ph.Instances([ph.Spheres([(0, 0, 90), (0, 0, 0)], 1.0, name="pearl")], places[1:] * 3)
    scene = ph.prepare(ph.Scene([balls, floor, copies]))
    towards = [(2, 0, 0), (0, 0, 0.1), (-1, 0, 0), (0, -3, 0), (0, 0, -1), (0, 1, 0)]
    hits = ph.intersect(scene, (0, 0, 0), towards)
    np.testing.assert_allclose(hits.distance, [4, 3, 4.5, 2, 6, np.inf], rtol=1e-6)
    assert [hits.shape_names[i] if i >= 0 else "" for i in hits.shape] == [
        *("balls", "balls", "balls", "floor", "pearl", "")
    ]
    np.testing.assert_array_equal(hits.primitive, [0, 1, 2, hits.primitive[3], 1, -1])
    assert hits.primitive[3] in (0, 1)
    assert hits.shape_names[hits.instances[4]] == copies.name
    np.testing.assert_array_equal(hits.instances >= 0, [False] * 4 + [True, False])
    assert hits.copy[4] in (0, 1, 2)
    np.testing.assert_array_equal(hits.copy[[0, 5]], -1)
    np.testing.assert_array_equal(hits.hit, [True] * 5 + [False])
    expected = [(4, 0, 0), (0, 0, 3), (-4.5, 0, 0), (0, -2, 0), (0, 0, -6), (np.nan,) * 3]
    np.testing.assert_allclose(hits.position, expected, atol=1e-6)
    normals = [(-1, 0, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (np.nan,) * 3]
    np.testing.assert_allclose(hits.normal, normals, atol=1e-6)
    assert len(hits) == 6
    few = hits[hits.distance < 4.2]
    np.testing.assert_array_equal(few.distance, hits.distance[[0, 1, 3]])
    np.testing.assert_array_equal(few.position, hits.position[[0, 1, 3]])
    # as far as is looked, and no farther
    for limits in (4.2, [4.2] * 6):
        near = ph.intersect(scene, (0, 0, 0), towards, limits)
        np.testing.assert_array_equal(near.hit, [True, True, False, True, False, False])
        np.testing.assert_array_equal(ph.occluded(scene, (0, 0, 0), towards, limits), near.hit)


@pytest.mark.parametrize("away", [3.0, 1e3, 1e9])
def test_rays_from_far_away_are_exact(away: float) -> None:
    """Aimed at a ball of radius 1 by what they pass its centre by, in double."""
    aside = np.repeat([0.0, 0.3, 0.6, 0.9, 0.999, 1.001, 1.5], 200)
    out = directions(len(aside))
    across = np.cross(out, directions(len(aside), 2))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    origins = out * away + across * aside[:, None]
    # of lengths that float has not
    lengths = 10.0 ** RNG(3).uniform(-150, 150, len(aside))
    hits = ph.intersect(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]), origins, -out * lengths[:, None])
    np.testing.assert_array_equal(hits.hit, aside < 1)
    met = hits.hit
    expected = away - np.sqrt(1 - aside[met] ** 2)
    blur = 1e-15 * away + np.where(aside[met] > 0.99, 1e-4, 2e-6)
    assert np.all(np.abs(hits.distance[met] - expected) < blur)
    at = origins[met] - out[met] * expected[:, None]
    assert np.all(np.abs(hits.position[met] - at) < blur[:, None])


@pytest.mark.parametrize("offset", [0.0, 1000.0])
@pytest.mark.parametrize("shape", ["sphere", "mesh", "ellipsoid", "tube", "strand", "disk"])
def test_rays_set_off_from_what_others_have_met(shape: str, offset: float) -> None:
    """From a convex body: those that go out meet nothing, those that go in meet its other side."""
    center = np.array([offset, -offset, offset / 3])
    ends = center + np.array([[(0, 0, 9)], [(0, 0, 3)], [(0, 0, -3)], [(0, 0, -9)]])
    stretch = np.diag([1.0, 2.0, 0.5, 1.0])
    stretch[:3, 3] = center
    of = {
        "sphere": ph.Spheres([center], 1.0),
        "mesh": globe(24, 1.0, center),
        "ellipsoid": ph.Instances([ph.Spheres([(0, 0, 0)], 1.0)], [stretch]),
        "tube": ph.Cylinders(ends[0], ends[3], 1.0),
        "strand": ph.Curves(ends[:, 0], 1.0, basis="bezier"),
        "disk": ph.Disks([center], [(1, 0, 0)], [(0, 1, 0)]),
    }[shape]
    scene = ph.prepare(ph.Scene([of]))
    n = 20_000
    eyes = center + np.array([0, 0, 0.5 if shape == "disk" else 0])
    hits = ph.intersect(scene, eyes, directions(n))
    hits = hits[hits.hit]
    n = len(hits)
    assert n > 900
    ways = directions(n, 5)
    # nearly along the surface, too
    ways[::4] += hits.normal[::4] * (1e-4 - np.sum(ways[::4] * hits.normal[::4], axis=1))[:, None]
    out = np.sum(ways.astype(np.float32) * hits.normal, axis=1) > 1e-5
    assert 0.3 < np.mean(out) < 0.8
    blocked = ph.occluded(scene, hits, ways)
    assert not np.any(blocked[out])
    again = ph.intersect(scene, hits, ways)
    np.testing.assert_array_equal(again.hit, blocked)
    into = np.sum(ways * hits.normal, axis=1) < -0.05
    if shape == "disk":
        assert not np.any(blocked)
        return
    # those of a tube may leave by its ends
    assert np.mean(blocked[into]) > (0.7 if shape == "tube" else 1 - 1e-9)
    into &= blocked
    to = again.position[into] - hits.position[into]
    size = np.linalg.norm(to, axis=1)
    np.testing.assert_allclose(size, again.distance[into], rtol=1e-3, atol=3e-6 * offset)
    long = size > 0.1
    to, size, ways = to[long], size[long], ways[into][long]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    np.testing.assert_allclose(to / size[:, None], ways, atol=2e-3 + 1e-5 * offset)


def test_how_much_of_the_sky_a_ball_hides() -> None:
    """Of a floor under a ball of radius r at height h, weighed by cosines, r^2 h / d^3."""
    r, h = 0.5, 1.3
    floor = ph.Mesh([(-9, 0, -9), (-9, 0, 9), (9, 0, 9), (9, 0, -9)], [(0, 1, 2), (0, 2, 3)])
    scene = ph.prepare(ph.Scene([floor, ph.Spheres([(0, h, 0)], r)]))
    x = np.array([1e-6, 0.5, 1.0, 2.0])
    each = 40_000
    eyes = np.stack([x, np.full(4, 0.1), 0 * x], axis=1)
    hits = ph.intersect(scene, eyes, (0, -1, 0))
    rng = RNG(7)
    u, angle = rng.random((4, each)), rng.random((4, each)) * 2 * np.pi
    ways = np.stack([np.sqrt(u) * np.cos(angle), np.sqrt(1 - u), np.sqrt(u) * np.sin(angle)], -1)
    found = ph.occluded(scene, hits[np.repeat(np.arange(4), each)], ways.reshape(-1, 3))
    share = found.reshape(4, each).mean(axis=1)
    expected = r**2 * h / np.hypot(x, h) ** 3
    assert np.all(np.abs(share - expected) < 4 * np.sqrt(expected / each))


def test_any_number_of_threads_and_all_instruction_sets_answer_alike() -> None:
    rng = RNG(9)
    copies = ph.Instances([ph.Spheres([(0, 0, 0)], 0.4), globe(5, 0.3)], [np.eye(4)] * 2)
    balls = ph.Spheres(rng.normal(size=(500, 3)), 0.1)
    ball = globe(9, 0.6)
    smooth = ph.Mesh(ball.vertices, ball.faces, normals=-np.asarray(ball.vertices))
    rods = ph.Cylinders(rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), 0.1)
    # some coincide
    scene = ph.prepare(ph.Scene([globe(30), balls, copies, balls, smooth, rods]))
    n = 20_000  # more than one thread would take alone
    o, d = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    limits = rng.uniform(0, 8, n)
    first = ph.intersect(scene, o, d, limits, threads=1)
    ways: list[dict[str, Any]] = [{"threads": 3}, {"tree": "none"}]
    ways += [{"isa": isa} for isa in _core.instruction_sets()]
    for way in ways:
        hits = ph.intersect(scene, o, d, limits, **way)
        for name in ("distance", "shape", "primitive", "instances", "copy", "position", "normal"):
            a, b = getattr(first, name), getattr(hits, name)
            assert a.tobytes() == b.tobytes(), (way, name)
        np.testing.assert_array_equal(ph.occluded(scene, o, d, limits, **way), first.hit)
    assert 0.2 < np.mean(first.hit) < 0.8


def test_neighbours_in_a_picture_meet_what_each_meets() -> None:
    """Rays in a picture's order go through the tree together, mixed ones by themselves."""
    rng = RNG(4)

    def box(n: int) -> np.ndarray:
        return rng.uniform(-9, 9, (n, 3))

    small = [ph.Spheres(box(3000), rng.uniform(0.02, 0.3, 3000)), globe(9)]
    places = np.tile(np.diag([0.1, 0.1, 0.1, 1.0]), (50, 1, 1))
    places[:, :3, 3] = box(50)
    strand = ph.Curves(2.0 * np.cumsum(rng.normal(size=(40, 3)), axis=0), 0.3)
    tubes = ph.Cylinders(box(50), box(50), 0.2)
    across = rng.normal(size=(50, 3))
    plates = ph.Disks(box(50), across, np.cross(across, box(50)) / 9)
    copies = ph.Instances(small, places)
    scene = ph.prepare(ph.Scene([*small, strand, tubes, plates, copies]))
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 160), np.linspace(-0.7, 0.7, 120))
    towards = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -1.0)])
    mixed = rng.permutation(len(towards))
    eyes = np.tile((1.0, 2.0, 30.0), (len(towards), 1))
    limits = rng.uniform(0.0, 60.0, len(towards))
    limits[::7], limits[5::11] = np.inf, 0.0
    for isa in _core.instruction_sets():
        first = ph.intersect(scene, eyes, towards, limits, isa=isa)
        met = np.unique(first.shape[first.hit])
        assert len(met) == len(first.shape_names) - 1  # all but the shape of copies itself
        on = first[first.hit]
        above = np.column_stack([10 * x.ravel(), 10 * y.ravel(), np.full(x.size, 12.0)])
        down = np.tile((0.0, 0.0, -1.0), (len(above), 1))
        down[::3, 0] = -0.0
        along = np.tile((0.0, 0.6, -0.8), (len(on), 1))
        sun = np.tile((0.3, 0.8, 0.52), (len(on), 1))
        turns = (above, down), (eyes, towards), (on, towards[first.hit]), (on, sun), (on, along)
        for origins, way in turns:
            n = len(origins)
            own = mixed[mixed < n]
            hits = ph.intersect(scene, origins, way, limits[:n], isa=isa)
            alone = ph.intersect(scene, origins[own], way[own], limits[own], isa=isa)
            for column in ("distance", "shape", "primitive", "instances", "copy", "position"):
                np.testing.assert_array_equal(getattr(hits, column)[own], getattr(alone, column))
            hidden = ph.occluded(scene, origins, way, limits[:n], isa=isa)
            np.testing.assert_array_equal(hidden, hits.hit)
            assert 0.05 < hidden.mean() < 0.95


def test_limits_are_kept_from_any_distance() -> None:
    """What is met at a limit, as a number of double's, is met; nothing farther is told."""
    scene = ph.prepare(ph.Scene([globe(20), ph.Spheres([(0, 0, 3)], 0.5)]))
    n = 20_000
    rng = RNG(12)
    at = rng.normal(size=(n, 3)) * 0.5
    away = directions(n, 3) * 10.0 ** rng.uniform(-1, 6, (n, 1))
    first = ph.intersect(scene, at + away, -away)
    limits = np.where(first.hit, first.distance, 1e7) * rng.choice([1 - 1e-6, 1 + 1e-9, 2], n)
    hits = ph.intersect(scene, at + away, -away, limits)
    assert np.all(hits.distance[hits.hit] <= limits[hits.hit])
    np.testing.assert_array_equal(ph.occluded(scene, at + away, -away, limits), hits.hit)
    longer = first.hit & (limits > first.distance * (1 + 1e-6))
    np.testing.assert_array_equal(hits.distance[longer], first.distance[longer])
    assert 0.2 < np.mean(longer) < 0.5
    again = ph.intersect(scene, at + away, -away, first.distance)
    np.testing.assert_array_equal(again.distance, first.distance)


@pytest.mark.parametrize("size", [1.0, 0.01])
def test_of_copies_in_one_place_the_first_is_met(size: float) -> None:
    """However small they are, in whatever company and up to whatever limit."""
    rng = RNG(7)
    places = np.tile(np.diag([size, size, size, 1.0]), (40, 1, 1))
    places[:, :3, 3] = rng.uniform(-5, 5, (40, 3))
    pearl = ph.Spheres([(0, 0, 0)], 1.0)
    scene = ph.prepare(ph.Scene([ph.Instances([pearl], [*places, *places])]))
    n = 16_000
    eyes = places[np.sort(rng.integers(0, 40, n)), :3, 3] + rng.normal(size=(n, 3)) * 0.5 * size
    origins = eyes + directions(n, 2) * 2.0
    towards = eyes - origins
    mixed = rng.permutation(n)
    for isa in _core.instruction_sets():
        hits = ph.intersect(scene, origins, towards, isa=isa)
        assert np.mean(hits.hit) > 0.5
        assert hits.copy.max() < 40
        for limits in (np.full(n, np.inf), hits.distance):
            other = ph.intersect(scene, origins[mixed], towards[mixed], limits[mixed], isa=isa)
            np.testing.assert_array_equal(other.copy, hits.copy[mixed])
            np.testing.assert_array_equal(other.distance, hits.distance[mixed])


def test_normals_point_outward_in_mirrored_copies_and_by_vertices() -> None:
    mesh = globe(12)
    turned = ph.Mesh(mesh.vertices, np.asarray(mesh.faces)[:, ::-1], name="turned")
    smooth = ph.Mesh(mesh.vertices, turned.faces, normals=mesh.vertices)
    sheared = np.array([[-1, 0.2, 0, 0], [0, 0.7, 0, 0], [0.1, 0, 1.3, 0.0]])
    for shape, side in (
        (mesh, 1),
        (turned, -1),
        (smooth, 1),
        (ph.Instances([mesh], [sheared]), 1),
        (ph.Instances([turned], [sheared]), -1),
        (ph.Instances([ph.Spheres([(0, 0, 0)], 1)], [sheared]), 1),
    ):
        hits = ph.intersect(ph.Scene([shape]), (0, 0, 0), directions(500))
        assert np.all(np.sum(hits.normal * hits.position, axis=1) * side > 0.1)
        np.testing.assert_allclose(np.linalg.norm(hits.normal, axis=1), 1, rtol=1e-6)


def test_arrays_of_all_kinds_are_the_same_rays() -> None:
    scene = ph.prepare(ph.Scene([globe(12)]))
    o, d = np.array([(0.25, 0.5, 3), (0.125, 0, 2)]), np.array([(0, 0, -2), (0.5, 0, -4)])
    expected = ph.intersect(scene, o, d).distance
    stored = np.zeros(2, [("a", "i1"), ("o", "f8", 3), ("d", "f8", 3)])
    stored["o"], stored["d"] = o, d  # neither aligned nor one after the other
    fixed = o.copy()
    fixed.flags.writeable = False
    for a, b in (
        (o.tolist(), d.tolist()),
        (o.astype(np.float32), d.astype(np.float16)),
        (o.astype(">f8"), d.astype(">f4")),
        (np.asfortranarray(o), d[::-1][::-1]),
        (stored["o"], stored["d"]),
        (fixed, d.astype(np.longdouble)),
    ):
        np.testing.assert_array_equal(ph.intersect(scene, a, b).distance, expected)
    whole = ph.intersect(scene, [(0, 0, 3)], np.array([(0, 0, -2)], np.int8))
    np.testing.assert_allclose(whole.distance, 2, rtol=1e-6)


def test_what_is_done_to_arrays_does_not_change_where_rays_set_off() -> None:
    scene = ph.prepare(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]))
    hits = ph.intersect(scene, (0, 0, 0), directions(100))
    first = ph.intersect(scene, hits, -hits.position)
    normal, position = hits.normal, hits.position
    normal *= -1
    position += 5
    again = ph.intersect(scene, hits, -hits.position)
    np.testing.assert_array_equal(again.distance, first.distance)
    np.testing.assert_allclose(first.distance, 2, rtol=1e-5)
    several = hits[np.repeat(np.arange(100), 3)]
    again = ph.intersect(scene, several, np.repeat(-hits.position, 3, axis=0))
    np.testing.assert_array_equal(again.distance, np.repeat(first.distance, 3))
    with pytest.raises(TypeError, match="iter"):
        list(hits)  # type: ignore[call-overload]
    with pytest.raises(ph.SceneError, match="directions are hits; only origins can be"):
        ph.occluded(scene, hits, hits)  # type: ignore[arg-type]


def test_several_threads_of_python_ask_at_once() -> None:
    rng = RNG(4)
    scene = ph.prepare(ph.Scene([ph.Spheres(rng.normal(size=(300, 3)), 0.1)]))
    rays = [(rng.normal(size=(10_000, 3)), rng.normal(size=(10_000, 3))) for _ in range(6)]
    expected = [ph.intersect(scene, *r).distance for r in rays]
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda r: ph.intersect(scene, *r).distance, rays))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize("threads", [1, 2])
def test_ctrl_c_is_heard_however_slow_rays_are(threads: int) -> None:
    rng = RNG(5)
    scene = ph.prepare(ph.Scene([ph.Spheres(rng.normal(size=(20_000, 3)), 0.01)]))
    n = 1_000_000
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        ph.intersect(scene, rng.normal(size=(n, 3)), (0, 0, 1), tree="none", threads=threads)
    assert time.perf_counter() - began < 5  # all would take a minute


@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize("threads", [1, 2])
def test_ctrl_c_is_heard_where_something_is_no_ray(threads: int) -> None:
    rng = RNG(6)
    scene = ph.prepare(ph.Scene([ph.Spheres(rng.normal(size=(20_000, 3)), 0.01)]))
    way = rng.random((8_000_000, 3), np.float32)
    way[100] = 0
    timer = threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    # before the arrays are through, or after the error: but never another
    try:
        with pytest.raises((ph.SceneError, KeyboardInterrupt)):
            ph.occluded(scene, rng.normal(size=3), way, threads=threads)
        timer.join()
        time.sleep(0.01)
    except KeyboardInterrupt:
        pass


def test_rays_that_memory_cannot_hold_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ph.prepare(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]))
    monkeypatch.setattr(memory, "free", lambda **_: memory.Free(350_000, "free"))
    o = np.zeros((5000, 3))
    with pytest.raises(ph.ResourceError, match=r"what 5000 rays meet .* fewer at a time"):
        ph.intersect(scene, o, (0, 0, 1))
    assert len(ph.occluded(scene, o, (0, 0, 1))) == 5000
    some = ph.intersect(scene, o[:4500], (0, 0, 1))
    with monkeypatch.context() as scarce:
        scarce.setattr(memory, "free", lambda **_: memory.Free(150_000, "free"))
        for points in (
            lambda: some.position,
            lambda: some.normal,
            lambda: ph.occluded(scene, some, -o[:4500] + (0, 0, 1)),
        ):
            with pytest.raises(ph.ResourceError, match=r"the points of 4500 hits .* fewer at"):
                points()
    np.testing.assert_allclose(some.normal, np.tile((0, 0, 1), (4500, 1)))


def test_of_a_few_rays_memory_is_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which takes several times as long as they do."""
    scene = ph.prepare(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]))
    monkeypatch.setattr(memory, "free", lambda **_: pytest.fail("asked"))
    hits = ph.intersect(scene, np.zeros((_core.few_rays, 3)), (0, 0, 1))
    np.testing.assert_allclose(hits.position, np.tile((0, 0, 1), (len(hits), 1)))
    assert np.all(ph.occluded(scene, hits, (0, 0, -1)))


def test_points_of_some_are_those_of_all() -> None:
    """Whether they were asked for before the hits were selected, or not."""
    rng = RNG(8)
    scene = ph.prepare(ph.Scene([ph.Spheres(rng.normal(size=(50, 3)), 0.3), globe(8, 2.0)]))
    hits = ph.intersect(scene, rng.normal(size=(9000, 3)), directions(9000), 1.0)
    some = rng.integers(0, 9000, 7000)
    many = hits[np.repeat(some, 3)]
    before, apart = hits[some], ph.intersect(scene, hits[hits.hit], (0, 0, 1))
    position, normal = hits.position, hits.normal
    assert 0.2 < np.mean(np.isnan(normal[:, 0])) < 0.8
    np.testing.assert_array_equal(np.isnan(position), np.isnan(normal))
    np.testing.assert_array_equal(np.isnan(normal[:, 0]), ~hits.hit)
    for selected in (before, hits[some]):
        np.testing.assert_array_equal(selected.position, position[some])
        np.testing.assert_array_equal(selected.normal, normal[some])
    np.testing.assert_array_equal(many.normal, np.repeat(normal[some], 3, axis=0))
    again = ph.intersect(scene, hits[hits.hit], (0, 0, 1))
    np.testing.assert_array_equal(again.distance, apart.distance)


@pytest.mark.parametrize("threads", [1, 3])
def test_of_many_that_are_no_rays_the_first_is_named(threads: int) -> None:
    rng = RNG(9)
    scene = ph.prepare(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]))
    n = 50_000
    origins, way, limits = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), np.ones(n)
    for last in (40_000, 20_011, 20_005, 777, 0):
        bad = rng.integers(last, n, 40)
        origins[bad[:13], 1], limits[bad[13:25]], way[bad[25:]] = np.inf, -1, 0
        origins[last, 0] = np.nan
        for ask in (ph.intersect, ph.occluded):
            with pytest.raises(ph.SceneError, match=rf"origins\[{last}\] is \(nan"):
                ask(scene, origins, way, limits, threads=threads)


def test_one_ray_and_none() -> None:
    scene = ph.prepare(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]))
    for origins, way in (((0, 0, 3), (0, 0, -1)), ([(0, 0, 3)], [(0, 0, -1)])):
        assert ph.intersect(scene, origins, way).distance == pytest.approx([2.0], rel=1e-6)
        assert ph.occluded(scene, origins, way).tolist() == [True]
    none = np.zeros((0, 3))
    hits = ph.intersect(scene, none, none)
    assert len(hits) == 0
    assert hits.position.shape == hits.normal.shape == (0, 3)
    assert len(ph.occluded(scene, hits, none)) == 0
    empty = ph.intersect(ph.Scene(), (0, 0, 0), np.eye(3))
    assert not np.any(empty.hit)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            {"origins": [(0, 0, 0), (0, np.nan, 0)]},
            r"origins\[1\] is \(0, nan, 0\); must be",
        ),
        (
            {"directions": [(1, 0, 0), (0, 0, 0)]},
            r"directions\[1\] is \(0, 0, 0\), which is no",
        ),
        ({"directions": [(1, 0, 0), (0, np.inf, 0)]}, r"directions\[1\] is \(0, inf, 0\); must be"),
        ({"limits": [1, -1]}, r"limits\[1\] is -1; must be >= 0"),
        ({"limits": np.nan}, r"limits\[0\] is nan; must be >= 0"),
        ({"limits": [1, 2, 3]}, r"as many of each are needed, .* 2 origins, 3 limits"),
        ({"directions": [(1, 0)]}, r"directions has shape \(1, 2\); must be \(n, 3\) or"),
        ({"origins": "here"}, r"origins is not an array of numbers: its elements are <U4"),
        ({"origins": [[(0, 0, 0)]]}, r"origins has shape \(1, 1, 3\); must be \(n, 3\)"),
        ({"limits": [[1.0]]}, r"limits has shape \(1, 1\); must be \(n,\) or one num"),
        ({"directions": [(1, 0, 0), (0, 1)]}, r"directions is not an array"),
        ({"directions": np.ma.masked_equal([(1, 0, 0)], 0)}, r"directions has masked elements"),
        ({"tree": "oak"}, r"bvh"),
        ({"isa": "mmx"}, r"baseline"),
        ({"threads": -1}, r"threads is -1"),
    ],
)
def test_what_is_no_ray_is_named(more: dict[str, Any], words: str) -> None:
    scene = ph.prepare(ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)]))
    asked: dict[str, Any] = {"origins": [(0, 0, 3), (0, 0, 2)], "directions": (0, 0, 1)} | more
    for ask in (ph.intersect, ph.occluded):
        with pytest.raises(ph.SceneError, match=words):
            ask(scene, **asked)


def test_rays_do_not_set_off_from_nothing_or_another_scene() -> None:
    shapes = ph.Scene([ph.Spheres([(0, 0, 0)], 1.0)])
    scene, other = ph.prepare(shapes), ph.prepare(shapes)
    hits = ph.intersect(scene, (0, 0, 3), [(0, 0, -1), (0, 0, 1)])
    with pytest.raises(ph.SceneError, match=r"origins\[1\] has met nothing; .*hits\[hits.hit\]"):
        ph.occluded(scene, hits, (0, 0, 1))
    assert ph.occluded(scene, hits[hits.hit], (0, 0, 1)).tolist() == [False]
    for one in (other, shapes):
        with pytest.raises(ph.SceneError, match="hits of another scene"):
            ph.intersect(one, hits, (0, 0, 1))
    for index in ("nothing", 0, [7], [[0]]):
        with pytest.raises(ph.SceneError, match="hits"):
            hits[index]
