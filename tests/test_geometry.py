"""Intersections: tree against brute force against double precision; scale and distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core

RAYS = 100_000

Cloud = tuple[np.ndarray, np.ndarray]


def random_cloud() -> Cloud:
    rng = np.random.default_rng(1)
    return rng.uniform(-1, 1, (3000, 3)), rng.uniform(0.01, 0.05, 3000)


def weekend() -> Cloud:
    shapes = ph.weekend().shapes
    centers = [np.asarray(s.centers) for s in shapes]
    radii = [np.broadcast_to(s.radii, len(s.centers)) for s in shapes]
    return np.concatenate(centers), np.concatenate(radii)


def heavy_overlap() -> Cloud:
    rng = np.random.default_rng(2)
    return rng.uniform(0, 1, (600, 3)), rng.uniform(0.5, 1.0, 600)


def duplicates() -> Cloud:
    rng = np.random.default_rng(3)
    return np.tile(rng.uniform(-1, 1, (60, 3)), (10, 1)), np.tile(rng.uniform(0.1, 0.3, 60), 10)


def wild_radii() -> Cloud:
    rng = np.random.default_rng(4)
    return rng.uniform(-1, 1, (1500, 3)), 10 ** rng.uniform(-7, 0.3, 1500)


def line() -> Cloud:
    x = np.arange(1000.0)
    return np.stack([x, 0 * x, 0 * x], axis=1), np.full(1000, 0.4)


def coincident() -> Cloud:
    rng = np.random.default_rng(5)
    return np.full((400, 3), 0.25), rng.choice(rng.uniform(0.1, 1.0, 50), 400)


def clusters() -> Cloud:
    # each a thousandth of the size of the one around it, so that grids find most of it in one cell
    rng = np.random.default_rng(6)
    levels = [rng.uniform(-1, 1, (2000, 3)) * 1e-3**k for k in range(3)]
    return np.concatenate(levels), np.repeat([0.02, 2e-5, 2e-8], 2000)


def sheet() -> Cloud:
    rng = np.random.default_rng(7)
    return rng.uniform(-1, 1, (6000, 3)) * (1, 0, 1), np.full(6000, 0.01)


def one() -> Cloud:
    return np.array([[3.0, -2.0, 1.0]]), np.array([1.5])


CLOUDS: list[Callable[[], Cloud]] = [
    random_cloud,
    weekend,
    heavy_overlap,
    duplicates,
    wild_radii,
    line,
    coincident,
    one,
    clusters,
    sheet,
]
by_cloud = pytest.mark.parametrize("cloud", CLOUDS, ids=lambda f: f.__name__)


def built(centers: np.ndarray, radii: np.ndarray) -> _core.Scene:
    return ph.prepare(ph.Scene([ph.Spheres(centers, radii)])).core


def random_rays(centers: np.ndarray, radii: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """Origins and unit directions within the bounds: any; at a sphere; along axes; at a limb."""
    rng = np.random.default_rng(9)
    low = (centers - radii[:, None]).min(axis=0)
    high = (centers + radii[:, None]).max(axis=0)
    o = rng.uniform(low, high, (count, 3))
    # a quarter starts on the bounds themselves, as camera rays do
    wall = np.arange(count) % 4 == 0
    o[wall, 0] = np.where(rng.random(wall.sum()) < 0.5, low[0], high[0])
    d = rng.normal(size=(count, 3))
    kind = np.arange(count) % 5
    aim = rng.integers(0, len(centers), count)
    toward = centers[aim] - o
    at = kind == 1
    d[at] = toward[at] + 0.7 * radii[aim[at], None] * d[at]
    limb = kind == 2
    side = np.cross(toward[limb], d[limb])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    d[limb] = toward[limb] + side * radii[aim[limb], None]
    axes = np.array([[1, 0, 0], [0, -1, 0], [-0.0, 0, 1], [0, -0.0, -1], [0, 1, 1], [-1, -1, 0.0]])
    along = kind == 3
    d[along] = axes[rng.integers(0, len(axes), along.sum())]
    o[along] = centers[aim[along]] + d[along] * 0.3  # on the planes of boxes
    o = np.clip(o, low, high)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-30)
    return o.astype(np.float32), d.astype(np.float32)


def found_as_by_brute_force(
    core: _core.Scene, o: np.ndarray, d: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The distances and ids that both find."""
    t, ids = core.intersect(o, d)
    all_t, all_ids = core.intersect(o, d, tree=False)
    np.testing.assert_array_equal(ids, all_ids)
    np.testing.assert_array_equal(t.view(np.uint32), all_t.view(np.uint32))
    assert np.mean(ids >= 0) > 0.05
    return t, ids


@by_cloud
def test_tree_finds_what_brute_force_finds(cloud: Callable[[], Cloud]) -> None:
    centers, radii = cloud()
    core = built(centers, radii)
    o, d = random_rays(centers, radii, RAYS)
    t, ids = found_as_by_brute_force(core, o, d)
    assert np.all(t[ids >= 0] > 0)
    assert np.all(np.isinf(t[ids < 0]))

    # up to well before, just before, at and just after the hit
    rng = np.random.default_rng(10)
    factor = rng.choice(np.float32([0.5, 1 - 2**-20, 1.0, 1 + 2**-20, 2.0]), RAYS)
    limits = np.where(ids >= 0, t, np.float32(1.0)) * factor
    limits[::7] = np.inf
    blocked = core.occluded(o, d, limits)
    np.testing.assert_array_equal(blocked, core.occluded(o, d, limits, tree=False))
    np.testing.assert_array_equal(blocked.astype(bool), (ids >= 0) & (t <= limits))


@pytest.mark.parametrize("count", [2**19, 2**19 + 1])
def test_groups_that_are_copied_whole_and_larger_ones(count: int) -> None:
    """kLargeJob in host/build.h, and one more, whose boxes are made whenever they are asked for."""
    rng = np.random.default_rng(12)
    centers, radii = rng.uniform(-1, 1, (count, 3)), np.full(count, 0.005)
    core = built(centers, radii)
    found_as_by_brute_force(core, *random_rays(centers, radii, 200))


@pytest.mark.parametrize("count", [100_000, 600_000])
def test_what_lies_too_unevenly_for_grids(count: int) -> None:
    """Large parts are divided in two by all threads (SharedForks in host/forks.h)."""
    rng = np.random.default_rng(13)
    centers, radii = rng.uniform(0, 1, (count, 3)) ** 6, rng.uniform(1e-4, 5e-3, count)
    found_as_by_brute_force(built(centers, radii), *random_rays(centers, radii, 200))


def test_more_spheres_around_one_point_than_a_grid_divides() -> None:
    centers, radii = np.zeros((6000, 3)), np.linspace(0.1, 1.0, 6000)
    found_as_by_brute_force(built(centers, radii), *random_rays(centers, radii, 2000))


@pytest.mark.parametrize("isa", _core.instruction_sets())
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_rays_that_are_no_numbers_meet_nothing(isa: str, bad: float) -> None:
    rng = np.random.default_rng(12)
    core = built(rng.uniform(-1, 1, (300, 3)), np.full(300, 0.2))
    axes = [list(np.flatnonzero([k & 1, k & 2, k & 4])) for k in range(8)]  # none, x, ..., all
    o, d = np.zeros((64, 3), np.float32), np.full((64, 3), 3**-0.5, np.float32)
    for k in range(64):
        o[k, axes[k // 8]] = bad
        d[k, axes[k % 8]] = bad
    limits = np.full(64, np.inf, np.float32)
    for tree in (True, False):
        met = core.intersect(o, d, tree=tree, isa=isa)[1] >= 0
        assert met[0]
        assert not met[1:].any()
        assert np.array_equal(core.occluded(o, d, limits, tree=tree, isa=isa), met)


@by_cloud
def test_instruction_sets_find_the_same_bits(cloud: Callable[[], Cloud]) -> None:
    centers, radii = cloud()
    core = built(centers, radii)
    o, d = random_rays(centers, radii, 20_000)
    limits = np.random.default_rng(11).uniform(0, 2, len(o)).astype(np.float32)
    expected = [*core.intersect(o, d, isa="baseline"), core.occluded(o, d, limits, isa="baseline")]
    for isa in _core.instruction_sets():
        found = [*core.intersect(o, d, isa=isa), core.occluded(o, d, limits, isa=isa)]
        for a, b in zip(expected, found, strict=True):
            assert a.tobytes() == b.tobytes(), isa


def exact_hits(o: np.ndarray, d: np.ndarray, c: np.ndarray, r: np.ndarray) -> np.ndarray:
    """(rays, spheres) distances in double; infinite for a miss."""
    f = c[None] - o[:, None]
    b = np.einsum("rsk,rk->rs", f, d)
    discriminant = r**2 - np.sum((f - b[..., None] * d[:, None]) ** 2, axis=-1)
    s = np.sqrt(np.maximum(discriminant, 0))
    q = np.where(b > 0, b + s, b - s)
    other = np.divide(np.sum(f * f, axis=-1) - r**2, q, out=np.zeros_like(q), where=q != 0)
    near, far = np.minimum(q, other), np.maximum(q, other)
    t = np.where(near > 0, near, far)
    return np.where((discriminant >= 0) & (t > 0) & (r > 0), t, np.inf)


@by_cloud
def test_hits_against_double_precision(cloud: Callable[[], Cloud]) -> None:
    """Every ray that spheres a little larger and a little smaller answer alike is answered so."""
    centers, radii = cloud()
    core = built(centers, radii)
    o, d = random_rays(centers, radii, 1000)
    t, ids = core.intersect(o, d)
    c, r = centers.astype(np.float32).astype(float), radii.astype(np.float32).astype(float)
    o, d = o.astype(float), d.astype(float)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # a few roundings of the largest coordinate, in which distances between points are measured
    blur = 8 * 2**-24 * np.max(np.abs(c) + r[:, None])
    larger, smaller = exact_hits(o, d, c, r + blur), exact_hits(o, d, c, r - blur)
    first, second = larger.argmin(axis=1), smaller.argmin(axis=1)
    rows = np.arange(len(o))
    bracket = np.sort(np.stack([larger[rows, first], smaller[rows, second]]), axis=0)
    misses = np.isinf(bracket[0])
    assert np.all(ids[misses] == -1)
    # of spheres that coincide the first in the arrays counts, as argmin has it
    clear = (first == second) & np.isfinite(bracket[1])
    assert np.mean(clear | misses) > (0.2 if cloud is coincident else 0.6)
    np.testing.assert_array_equal(ids[clear], first[clear])
    slack = 4 * blur + 1e-6 * bracket[1][clear]
    assert np.all(t[clear] >= bracket[0][clear] - slack)
    assert np.all(t[clear] <= bracket[1][clear] + slack)


def test_of_equal_hits_the_first_sphere_counts() -> None:
    centers, radii = duplicates()
    o, d = random_rays(centers, radii, 10_000)
    ids = built(centers, radii).intersect(o, d)[1]
    assert ids.max() < 60  # the other 540 are copies


def test_instances_among_other_shapes() -> None:
    ball = ph.Spheres([[0.0, 0.0, 0.0]], 0.3)
    others = ph.Spheres([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], 0.3)
    moves = [np.array([[1.0, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0]]) for x in (-1.0, 1.0)]
    apart = [ph.Instances([ball], move[None]) for move in moves]
    camera = ph.Camera(eye=(0, 0, 5), vfov=40)

    def seen(*shapes: ph.Instances | ph.Spheres) -> np.ndarray:
        return ph.render(ph.Scene(shapes, camera=camera), width=48, height=27, spp=4).pixels

    together = seen(ph.Instances([ball], np.stack(moves)), others)
    np.testing.assert_array_equal(seen(apart[0], others, apart[1]), together)


def test_no_spheres() -> None:
    core = ph.prepare(ph.Scene()).core
    o, d = np.zeros((2, 3), np.float32), np.eye(3, dtype=np.float32)[:2]
    for tree in (True, False):
        assert np.all(core.intersect(o, d, tree=tree)[1] == -1)
        assert not np.any(core.occluded(o, d, np.full(2, np.inf, np.float32), tree=tree))


# --- Scale and distance ------------------------------------------------------------------------


def chalk(*, far: bool, scale: float) -> ph.Scene:
    """Spheres on a ground a thousand times as large; or one from 1e5 radii away."""
    grey = ph.Material("diffuse", color=(0.5, 0.5, 0.5))
    if far:
        shapes = [ph.Spheres([[0, 0, 0]], scale, grey)]
        camera = ph.Camera(eye=(0, 0, 1e5 * scale), target=(0, 0, 0), vfov=0.00115)
    else:
        x, z = (a.ravel() for a in np.meshgrid(np.arange(-4, 5, 2.5), np.arange(-4, 5, 2.5)))
        centers = np.stack([x, 1 + 0 * x, z], axis=1)
        shapes = [
            ph.Spheres(np.array([[0, -1000.0, 0]]) * scale, 1000.0 * scale, grey),
            ph.Spheres(centers[::2] * scale, scale, grey),
            ph.Spheres(centers[1::2] * scale, scale, ph.Material("dielectric", ior=1.5)),
        ]
        camera = ph.Camera(
            eye=(13 * scale, 3 * scale, 5 * scale),
            target=(0, 0, 0),
            vfov=35,
            aperture_radius=0.05 * scale,
            focus_distance=12 * scale,
        )
    return ph.Scene(shapes, camera=camera, background=ph.Background("gradient"))


def picture(scene: ph.Scene, **settings: object) -> np.ndarray:
    arguments = {"width": 48, "height": 48, "spp": 8, "threads": 1, **settings}
    return ph.render(scene, **arguments).numpy()


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("exponent", [-30, 10, 53])
def test_powers_of_two_change_no_bit(far: bool, exponent: int) -> None:
    expected = picture(chalk(far=far, scale=1.0))
    np.testing.assert_array_equal(picture(chalk(far=far, scale=2.0**exponent)), expected)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("scale", [1e-9, 1e16])
def test_any_scale_gives_the_same_picture(far: bool, scale: float) -> None:
    expected, scaled = picture(chalk(far=far, scale=1.0)), picture(chalk(far=far, scale=scale))
    assert np.all(np.isfinite(scaled))
    # Coordinates round differently, so some paths meet another sphere at an edge; most do not.
    moved = np.abs(scaled - expected).max(axis=-1) > 1e-3
    assert moved.sum() <= (0 if far else 0.005 * moved.size), moved.sum()
    assert abs(scaled.mean() / expected.mean() - 1) < 2e-3


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e16])
def test_no_acne(scale: float) -> None:
    """Light that leaves a convex surface meets it no more: of a grey one in a white sky, half."""
    grey = ph.Material("diffuse", color=(0.5, 0.5, 0.5))
    white = ph.Background("constant", radiance=(1, 1, 1))
    ground = ph.Scene(
        [ph.Spheres([[0, -1000 * scale, 0]], 1000 * scale, grey)],
        background=white,
        camera=ph.Camera(eye=(0, 2 * scale, 0), target=(0, 0, -3 * scale), vfov=60),
    )
    pixels = picture(ground, spp=64)
    assert np.all(np.isclose(pixels, 0.5, atol=1e-6) | (pixels > 0.5))  # the horizon is brighter
    assert np.mean(np.isclose(pixels, 0.5, atol=1e-6)) > 0.9
    far = picture(chalk(far=True, scale=scale).replace(background=white), spp=64)
    assert far.min() > 0.5 - 1e-6
    assert np.all(np.isclose(far[20:28, 20:28], 0.5, atol=1e-6))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e16])
def test_a_far_sphere_has_no_rings(scale: float) -> None:
    """A mirror shows every error of the normal twice over, and here its answer is known."""
    size, distance = 129, 1e5
    scene = chalk(far=True, scale=scale)
    mirror = ph.Spheres([[0, 0, 0]], scale, ph.Material("metal", color=(1, 1, 1)))
    # looking along z, with the sky's gradient along z too: the picture depends on the radius alone
    sky = ph.Background("gradient", horizon=(0, 0, 0), zenith=(1, 1, 1), up=(0, 0, 1))
    pixels = picture(
        scene.replace(shapes=[mirror], background=sky),
        width=size,
        height=size,
        spp=1,
        filter="box",
        filter_radius=1e-6,
    )[..., 0]
    step = 2 * np.tan(np.radians(0.00115) / 2) / size * distance
    at = (np.arange(size) - (size - 1) / 2) * step
    radius = np.hypot(*np.meshgrid(at, at))
    inside = radius < 0.999
    # The view is parallel to 1e-5: a normal's height: sqrt(1 - r^2), the mirrored one's: 1 - 2 r^2
    expected = 0.5 * (1 + (1 - 2 * radius**2))
    assert np.max(np.abs(pixels - expected)[inside]) < 1e-4
    order = np.argsort(radius[inside])
    assert np.all(np.diff(pixels[inside][order]) < 1e-4)  # darker outwards, without a step back


def test_far_ground_is_smooth() -> None:
    """The normals of a ground of radius 1000 near the viewer, by the sky in it as in a mirror."""
    size = 65
    sky = ph.Background("gradient", horizon=(0, 0, 0), zenith=(1, 1, 1))
    camera = ph.Camera(eye=(0, 2, 0), target=(0, 0, -3), vfov=40)
    mirror = ph.Spheres([[0, -1000.0, 0]], 1000.0, ph.Material("metal", color=(1, 1, 1)))
    pixels = picture(
        ph.Scene([mirror], background=sky, camera=camera),
        width=size,
        height=size,
        spp=1,
        filter="box",
        filter_radius=1e-6,
    )[..., 0]
    forward = np.array([0, -2, -3]) / np.sqrt(13)
    right, up = np.array([1.0, 0, 0]), np.array([0, 3, -2]) / np.sqrt(13)
    at = (np.arange(size) - (size - 1) / 2) * 2 * np.tan(np.radians(20)) / size
    x, y = np.meshgrid(at, -at)
    d = forward + x[..., None] * right + y[..., None] * up
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    f = np.array([0, 1002.0, 0])
    b = -(d @ f)
    t = b - np.sqrt(b * b - (1002.0**2 - 1000.0**2))
    normal = (f + t[..., None] * d) / 1000
    height = (d - 2 * np.sum(d * normal, axis=-1, keepdims=True) * normal)[..., 1]
    np.testing.assert_allclose(pixels, 0.5 * (1 + height), atol=2e-6)


def test_a_sphere_far_smaller_than_the_scene_is_seen() -> None:
    centers = np.array([[0.0, 0.0, 0.0], [1e6, 0.0, 0.0]])
    core = built(centers, np.array([1e-3, 1.0]))
    o = np.array([[0.0, 0.0, 10.0], [1e6, 0.0, 10.0], [0.0, 2e-3, 10.0]], np.float32)
    d = np.tile(np.float32([0, 0, -1]), (3, 1))
    t, ids = core.intersect(o, d)
    np.testing.assert_array_equal(ids, [0, 1, -1])
    np.testing.assert_allclose(t[:2], [9.999, 9.0], rtol=1e-6)
