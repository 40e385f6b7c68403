"""Paths that pixels close by share: as bright as without, less noisy, the same to the last bit."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from floor_tools import box
from parhelion import _core, sharing
from statistics_tools import SIGNIFICANCE, mean_p

SIZE = {"width": 37, "height": 27}
WHITE = ph.Material("diffuse", color=(0.7, 0.7, 0.7))
LAMP = ph.Material("emissive", radiance=(30, 30, 30))


@cache
def room(things: bool, walls: ph.Material = WHITE) -> ph.Prepared:
    """From within a closed box with a lamp; with things of other materials in it, or not."""
    shapes: list[Any] = [
        box((-1, 0, -1), (1, 2, 1), walls),
        box((-0.2, 1.9, -0.2), (0.2, 1.95, 0.2), LAMP),
    ]
    if things:
        red = ph.Material("diffuse", color=(0.8, 0.1, 0.001))
        gold = ph.Material("conductor", roughness=0.3, compensation="off")
        brushed = ph.Material("metal", color=(0.9, 0.8, 0.7), fuzz=0.6)
        ball = ph.Spheres([[0, 0.3, 0]], 0.3, ph.Material("dielectric", ior=1.5))
        block = box(
            (-0.7, 0, -0.7), (-0.3, 0.9, -0.2), ph.Material("plastic", color=(0.2, 0.4, 0.8))
        )
        shapes += [
            ball,
            block,
            ph.Spheres([[0.6, 0.25, -0.5], [0.5, 1.2, -0.6]], 0.25, red),
            ph.Spheres([[-0.6, 1.4, -0.6]], 0.2, gold),
            ph.Spheres([[0.2, 1.3, -0.7]], 0.2, brushed),
            ph.Instances(
                [ph.Spheres([[0, 0, 0]], 0.1, WHITE)],
                [
                    np.array([[1, 0, 0, x], [0, 2, 0, 0.2], [0, 0, 1, 0.2], [0, 0, 0, 1]])
                    for x in (-0.5, 0.5)
                ],
            ),
        ]
    camera = ph.Camera(eye=(0.1, 1.1, 0.95), target=(0, 0.9, -1), vfov=70)
    return ph.prepare(
        ph.Scene(shapes, camera=camera, background=ph.Light("constant", radiance=(0, 0, 0)))
    )


def picture(things: bool = True, scene: ph.Prepared | None = None, **settings: Any) -> np.ndarray:
    wanted = {"spp": 4, "reuse_paths": True, "seed": 5, **SIZE, **settings}
    return ph.render(scene or room(things), **wanted).numpy()


def test_a_room_of_one_colour_is_as_bright_as_without_to_the_last_digits() -> None:
    """All weights of a path's light add up to one, and here each weighs the same."""
    alone, shared = (picture(False, reuse_paths=reuse).astype(float) for reuse in (False, True))
    # almost all pixels have changed, but not their sum
    assert (alone != shared).mean() > 0.95
    np.testing.assert_allclose(shared.sum(), alone.sum(), rtol=2e-6)


def test_the_noise_is_less() -> None:
    truth = np.mean([picture(spp=256, seed=100 + seed).astype(float) for seed in range(2)], axis=0)
    errors = [
        np.mean([(picture(reuse_paths=reuse, seed=seed) - truth) ** 2 for seed in range(4)])
        for reuse in (False, True)
    ]
    assert errors[1] < 0.6 * errors[0]


def quad(corner: Any, u: Any, v: Any, material: ph.Material = WHITE, normal: Any = None) -> ph.Mesh:
    """A parallelogram, with one shading normal all over it."""
    a, b, c = (np.asarray(each, float) for each in (corner, u, v))
    normals = None if normal is None else np.tile(normal / np.linalg.norm(normal), (4, 1))
    faces = [[0, 1, 2], [0, 2, 3]]
    return ph.Mesh([a, a + b, a + b + c, a + c], faces, material=material, normals=normals)


def with_holes() -> ph.Prepared:
    """The room behind and around a lattice, a veil and a sheet of coloured glass."""
    texels = np.full((16, 16, 4), 255, np.uint8)
    texels[::2, ::2, 3] = 0
    texels[1::4, 1::4, 3] = 100
    lattice = ph.Material(
        "diffuse", color=(0.6, 0.7, 0.5), opacity=ph.Texture("image", image=texels, channel="a")
    )
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
    screen = quad((-0.6, 0.1, 0.1), (1.2, 0, 0.2), (0, 1.4, 0), lattice)
    tinted = ph.Material("null", color=(0.9, 0.5, 0.3))
    return ph.prepare(
        room(True).scene.replace(
            shapes=[
                *room(True).scene.shapes,
                ph.Mesh(screen.vertices, screen.faces, material=lattice, uvs=uv),
                ph.Spheres([[0.4, 1.0, 0.3]], 0.2, ph.Material("diffuse", opacity=0.5)),
                quad((0.1, 0.5, -0.2), (0.6, 0, 0.1), (0, 0.9, 0), tinted),
            ]
        )
    )


def bright() -> ph.Prepared:
    """A yard of metal and varnish under a panorama, with many lamps: which of them is asked depends
    on where it is seen mirrored, but where others share it. Pipes have normals that some who look
    at them see turned away."""
    rng = np.random.default_rng(3)
    sky = rng.uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    sky[2, 5] = 40
    angles = np.linspace(0, 2 * np.pi, 7)[:-1]
    ring = np.stack([np.cos(angles), np.zeros(6), np.sin(angles)], axis=1)
    pipe = [*(0.15 * ring), *(0.15 * ring + (0, 1.4, 0))]
    faces = [
        f
        for k in range(6)
        for f in ([k, k + 6, (k + 1) % 6], [k + 6, (k + 1) % 6 + 6, (k + 1) % 6])
    ]
    steel = ph.Material("conductor", roughness=0.4, compensation="off")
    varnish = ph.Material("principled", color=(0.7, 0.4, 0.2), roughness=0.35)
    shapes: list[Any] = [
        quad((-2, 0, 2), (4, 0, 0), (0, 0, -4)),
        quad((-2, 0, -1.2), (4, 0, 0), (0, 2, 0), steel),
        quad((1.2, 0, 1), (0, 0, -2), (0, 1.5, 0), varnish),
    ]
    for x, z in ((-0.6, -0.6), (0.1, -0.9), (0.7, -0.3)):
        place = np.add(pipe, (x, 0, z))
        shapes.append(ph.Mesh(place, faces, material=steel, normals=np.concatenate([ring, ring])))
    places = rng.uniform((-1, 0.3, -1), (1, 1.4, 0.5), (12, 3))
    shapes += [ph.Spheres(places, 0.08, ph.Material("emissive", radiance=(20, 18, 12)))]
    camera = ph.Camera(eye=(-0.2, 1.3, 1.6), target=(0, 0.4, -0.6), vfov=60)
    return ph.prepare(
        ph.Scene(
            shapes,
            camera=camera,
            background=ph.Light("envmap", image=sky, scale=(0.01, 0.01, 0.01)),
        )
    )


def with_mirrors() -> ph.Prepared:
    """The empty room by way of a mirror, on the left, and through a pane, on the right."""
    mirror = quad((-0.95, 0.2, -0.6), (0.9, 0, 0), (0, 1.5, 0), ph.Material("conductor"))
    pane = quad((0.05, 0.2, 0), (0.9, 0, 0), (0, 1.5, 0), ph.Material("thin_dielectric"))
    shapes = [*room(False).scene.shapes, mirror, pane]
    return ph.prepare(room(False).scene.replace(shapes=shapes))


def noon() -> ph.Prepared:
    """Lights without extent, and two from outside, over metal with a map of its normals and over
    varnish that is seen from behind and has a mirror and a pane before it."""
    rng = np.random.default_rng(4)
    bumps = np.concatenate([rng.uniform(0.4, 0.6, (8, 8, 2)), np.ones((8, 8, 1))], axis=2)
    image = ph.Texture("image", image=bumps.astype(np.float32), filter="nearest")
    steel = ph.Material("conductor", roughness=0.5, compensation="off", normal_map=image)
    varnish = ph.Material("principled", color=(0.7, 0.4, 0.2), roughness=0.4)
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
    wall = quad((-1.5, 0, -1), (3, 0, 0), (0, 1.5, 0))
    shapes: list[Any] = [
        quad((-2, 0, 2), (4, 0, 0), (0, 0, -4)),
        ph.Mesh(wall.vertices, wall.faces, material=steel, uvs=uv),
        quad((1.2, 0, -1), (0, 0, 2), (0, 1.2, 0), varnish),  # its normal points away
        quad((-1.3, 0.1, 0.3), (0.3, 0, -1), (0, 1, 0), ph.Material("conductor")),
        quad((-0.2, 0.1, 0.5), (1, 0, 0), (0, 0.8, 0), ph.Material("thin_dielectric")),
    ]
    lights = [
        ph.Light("point", position=(0.5, 0.9, -0.2), intensity=(1, 1, 1)),
        ph.Light("directional", direction=(-0.4, -1, -0.3), irradiance=(1, 0.9, 0.8)),
        ph.Light("directional", direction=(-0.2, -1, 0.5), irradiance=(1, 1, 1), angle=20.0),
    ]
    camera = ph.Camera(eye=(-0.2, 1.1, 1.8), target=(0, 0.4, -0.6), vfov=60)
    sky = ph.Light("constant", radiance=(0.2, 0.3, 0.4))
    return ph.prepare(ph.Scene(shapes, camera=camera, background=sky, lights=lights))


SCENES = {
    "empty": lambda: room(False),
    "mirrors": with_mirrors,
    "things": lambda: room(True),
    "holes": with_holes,
    "bright": bright,
    "noon": noon,
}
# Rays of the longest path, where it matters that not all share who see the same
DEPTHS = {"mirrors": 4}


def from_above(*shapes: Any) -> ph.Prepared:
    """Seen from y = 3, x to the right; lit by what shines among them alone."""
    camera = ph.Camera(eye=(0, 3, 0), target=(0, 0, 0), up=(0, 0, -1), vfov=40)
    dark = ph.Light("constant", radiance=(0, 0, 0))
    return ph.prepare(ph.Scene(list(shapes), camera=camera, background=dark))


def columns(scene: ph.Prepared, count: int, reuse: bool) -> np.ndarray:
    """Of pictures with other seeds, the means of eight columns: (count, 8)."""
    size = {"width": 32, "height": 32, "spp": 16, "sampler": "independent", "max_depth": 3}
    runs = [
        ph.render(scene, reuse_paths=reuse, seed=1000 * reuse + k, **size).numpy()
        for k in range(count)
    ]
    return np.array(runs, float).reshape(count, 32, 8, 4, 3).mean(axis=(1, 3, 4))


def test_what_an_open_tube_hides_stays_dark() -> None:
    """A ray passes the primitive that it is on its way to, so one point of it would see another."""
    tube = ph.Cylinders([[0, 0, 0]], [[0, 0.8, 0]], 0.4, material=WHITE)
    lamp = ph.Spheres([[0, 0.4, 0]], 0.05, material=LAMP)
    scene = from_above(quad((-2, 0, 2), (4, 0, 0), (0, 0, -4)), tube, lamp)
    size = {"width": 32, "height": 32, "spp": 16, "max_depth": 3}
    alone, shared = (ph.render(scene, reuse_paths=reuse, **size).numpy() for reuse in (False, True))
    assert (alone == 0).mean() > 0.3
    np.testing.assert_array_equal(shared[alone == 0], 0)


def test_the_inside_of_a_ball_with_holes_is_seen_past_its_near_side() -> None:
    """Both sides of it are one primitive, which rays to it pass: the near one must not be."""
    texels = np.full((32, 32, 4), 255, np.uint8)
    texels[:16, :, 3] = 0  # open towards one end of z
    hollow = ph.Material(
        "diffuse", color=(0.8, 0.8, 0.8), opacity=ph.Texture("image", image=texels, channel="a")
    )
    scene = from_above(
        quad((-2, -0.6, 2), (4, 0, 0), (0, 0, -4)),
        ph.Spheres([[0, 0.4, 0]], 0.6, hollow),
        ph.Spheres([[0, 0.4, 0]], 0.1, LAMP),
    )
    size = {"width": 32, "height": 32, "spp": 16, "max_depth": 4}
    rows = [
        np.array(
            [
                ph.render(scene, reuse_paths=reuse, seed=1000 * reuse + k, **size).numpy()
                for k in range(40)
            ],
            float,
        )
        .reshape(40, 8, 4, 32, 3)
        .mean(axis=(2, 3, 4))
        for reuse in (False, True)
    ]
    gap = rows[1] - rows[0]
    assert mean_p(gap, np.zeros(8)) > SIGNIFICANCE


def test_normals_that_are_turned_away_weigh_as_much() -> None:
    """Of a first surface some directions lie below it, which end the path and not the sharing; of a
    second one the normal is bent towards some that look at it, and its light is another then."""
    lean = (np.sin(0.9), np.cos(0.9), 0)
    strips = [
        quad((x, 0, 1), (0.25, 0, 0), (0, 0, -2), normal=lean if k % 2 else None)
        for k, x in enumerate(np.arange(-1, 1, 0.25))
    ]
    wall = quad((-1, 0, 1), (0, 0, -2), (0, 2, 0), normal=(np.cos(1.0), np.sin(1.0), 0))
    other = quad((1, 0, -1), (0, 0, 2), (0, 2, 0))
    lamp = ph.Spheres([[0.7, 1.8, 0]], 0.15, material=LAMP)  # out of the picture
    scene = from_above(*strips, wall, other, lamp)
    alone, shared = (columns(scene, 60, reuse) for reuse in (False, True))
    assert mean_p(shared - alone, np.zeros(8)) > SIGNIFICANCE
    # it would see two hundredths
    assert np.all(np.std(shared - alone, axis=0) / 60**0.5 < 0.008 * alone.mean(axis=0))


def test_what_is_shared_is_bounded_too() -> None:
    """Dark pixels' light, which is below the bound, is not above it for bright ones."""
    texels = np.full((64, 64, 3), 45, np.uint8)
    texels[::16] = 240
    color = ph.Texture("image", image=texels, filter="nearest")
    floor = quad((-1, 0, 1), (2, 0, 0), (0, 0, -2), ph.Material("diffuse", color=color))
    uv = [[0, 0], [1, 0], [1, 1], [0, 1]]
    floor = ph.Mesh(floor.vertices, floor.faces, material=floor.material, uvs=uv)
    shining = ph.Material(
        "diffuse", color=(0, 0, 0), emission=(300, 300, 300), two_sided_emission=False
    )
    lamp = quad((-0.1, 1.0, -0.9), (0.2, 0, 0), (0, -0.2, 0), shining)
    scene = from_above(floor, quad((-1, 0, -1), (2, 0, 0), (0, 2, 0)), lamp)
    # of the floor alone, which sees the lamp by way of the wall
    size = {"width": 32, "height": 32, "crop": (4, 8, 24, 20), "spp": 1, "max_depth": 3}
    size |= {"reuse_paths": True}
    free, bounded = (ph.render(scene, clamp_indirect=most, **size).numpy() for most in (None, 1.0))
    # little comes more than once; unbounded it is up to 25 times as much for bright ones
    assert free.max() > 3
    assert bounded.max() < 1.5


COLORS = {"color": (0.8, 0.6, 0.3)}
GLOSSY = {
    "smooth": ph.Material("plastic", **COLORS),
    "deep": ph.Material("plastic", **COLORS, nonlinear="on", ior=1.8),
    "ggx": ph.Material("plastic", **COLORS, roughness=0.4),
    "beckmann": ph.Material("plastic", **COLORS, roughness=0.5, distribution="beckmann"),
    "principled": ph.Material("principled", **COLORS, roughness=0.5, metallic=0.3, ior=1.7),
    "steel": ph.Material("conductor", **COLORS, roughness=0.6, compensation="off"),
    "brass": ph.Material(
        "conductor", **COLORS, roughness=0.6, compensation="off", distribution="beckmann"
    ),
    "silver": ph.Material("conductor", **COLORS, roughness=0.6),
    "fuzzy": ph.Material("metal", **COLORS, fuzz=0.7),
    "coated": ph.Material("principled", **COLORS, clearcoat=1, clearcoat_roughness=0.5),
    "velvet": ph.Material("principled", **COLORS, sheen_color=(0.5, 0.5, 0.5)),
    "gilt": ph.Material("principled", **COLORS, roughness=0.5, metallic=1.0),
    "scratched": ph.Material("conductor", **COLORS, roughness=0.6, anisotropy=0.6),
    "turned": ph.Material(
        "principled",
        **COLORS,
        roughness=0.6,
        metallic=1.0,
        anisotropy=-0.5,
        anisotropy_rotation=30,
    ),
    "plaster": ph.Material("diffuse", **COLORS, roughness=1.0),
    "mixed": ph.Material("blend", a=WHITE, b=ph.Material("conductor", **COLORS, roughness=0.5)),
}


def means_of_parts(scene: ph.Prepared, count: int = 26, **settings: Any) -> list[np.ndarray]:
    """Of so many pictures each, without sharing and with: (count, 6, 6, 3).

    Both have the same seeds, so that much of their noise is the same and their difference has less:
    as little of 26 as of 40 with seeds of their own.
    """
    means = []
    for reuse in (False, True):
        runs = [
            picture(scene=scene, reuse_paths=reuse, seed=1000 + k, spp=16, **settings)
            for k in range(count)
        ]
        means.append(np.array(runs)[:, :24, :36].reshape(count, 6, 4, 6, 6, 3).mean(axis=(2, 4)))
    return means


# Of the variance of parts of the picture, what is left at most. Smooth coats' mirror images stay
# with their paths; of the other plastics 0.37 is left where only their matte part is shared.
LEFT = {"smooth": 0.9, "deep": 0.9, "ggx": 0.33, "beckmann": 0.35, "principled": 0.5, "steel": 0.6}


@pytest.mark.parametrize("kind", GLOSSY)
def test_the_light_of_glossy_walls_is_shared_and_means_stay(kind: str) -> None:
    # ggx and beckmann are nearest to their bounds, past which fewer pictures may be by chance
    count = 40 if LEFT.get(kind, 0.75) < 0.37 else 26
    alone, shared = means_of_parts(room(False, GLOSSY[kind]), count, max_depth=5)
    gap = shared - alone
    assert mean_p(gap, np.zeros(gap.shape[1:])) > SIGNIFICANCE / len(GLOSSY)
    assert np.median(shared.var(axis=0)) < LEFT.get(kind, 0.75) * np.median(alone.var(axis=0))


def test_what_is_next_to_nothing_in_one_colour_tells_nothing_of_others(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Beckmann's slopes end: beside its gloss such a surface has no blue that could be compared."""
    red = ph.Material("plastic", color=(0.8, 0.1, 0.0), roughness=0.3, distribution="beckmann")
    walls = box((-1, 0, -1), (1, 2, 1), red)
    floor = quad((-0.99, 0.01, 0.99), (1.98, 0, 0), (0, 0, -1.98))
    scene = ph.prepare(
        room(False).scene.replace(shapes=[walls, floor, room(False).scene.shapes[1]])
    )
    alone, shared = means_of_parts(scene, max_depth=4, sampler="independent")
    assert not caplog.records  # no samples that are not finite
    gap = shared - alone
    assert mean_p(gap, np.zeros(gap.shape[1:])) > SIGNIFICANCE


def test_densities_may_be_next_to_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """A floor sees balls from where Beckmann's slopes send next to nothing of what they mirror."""
    gold = ph.Material(
        "conductor", roughness=0.45, distribution="beckmann", compensation="off", color=(1, 0.7, 0)
    )
    places = [(x, y, 0.5) for x in (-1.2, 0, 1.2) for y in (-1.2, 0, 1.2)]
    balls = ph.Spheres(np.array(places), 0.5, gold)
    floor = quad((-4, -4, 0), (8, 0, 0), (0, 8, 0))
    camera = ph.Camera(eye=(0, -6, 3), target=(0, 0, 0.3), up=(0, 0, 1), vfov=30)
    scene = ph.prepare(ph.Scene(shapes=[balls, floor], camera=camera))
    alone, shared = means_of_parts(scene, max_depth=8)
    assert not caplog.records
    gap = shared - alone
    assert mean_p(gap, np.zeros(gap.shape[1:])) > SIGNIFICANCE


RUNS = [(scene, "sobol") for scene in SCENES] + [("things", "independent")]


@pytest.mark.parametrize(("scene", "sampler"), RUNS)
def test_every_part_of_the_picture_has_the_same_mean(scene: str, sampler: str) -> None:
    """Of glass, metal, plastic, instances, and what lies in the corners between; past holes."""
    depth = DEPTHS.get(scene, 50)
    means = means_of_parts(SCENES[scene](), sampler=sampler, max_depth=depth)
    # single paths that glass focuses leave means of few pictures unlike a normal distribution
    kept = np.median(means[0].std(axis=0)) * 6 > means[0].std(axis=0)
    assert kept.mean() > 0.9
    gap = np.where(kept, means[1] - means[0], 0.0)
    assert mean_p(gap, np.zeros(gap.shape[1:])) > SIGNIFICANCE / len(RUNS)


def test_what_mirrors_and_panes_show_is_shared_as_if_it_was_seen_at_once() -> None:
    alone, shared = (
        np.array([picture(scene=with_mirrors(), reuse_paths=reuse, seed=k) for k in range(30)])
        for reuse in (False, True)
    )
    left = np.median(shared.var(axis=0), axis=-1) / np.median(alone.var(axis=0), axis=-1)
    for columns in (slice(8, 14), slice(23, 29)):  # well within the mirror and the pane
        assert np.median(left[8:18, columns]) < 0.85


@pytest.mark.parametrize("scene", ["things", "holes"])
def test_threads_tiles_and_instruction_sets(scene: str) -> None:
    prepared = SCENES[scene]()
    same = picture(scene=prepared)
    for settings in ({"threads": 1}, {"threads": 3, "tile": 5, "schedule": "static"}):
        np.testing.assert_array_equal(picture(scene=prepared, **settings), same)
    for isa in _core.instruction_sets():
        np.testing.assert_array_equal(picture(scene=prepared, isa=isa), same)
    np.testing.assert_array_equal(picture(scene=prepared, tree="none"), same)
    assert (same != picture(scene=prepared, reuse_paths=False)).mean() > 0.9


@pytest.mark.parametrize("crop", [(0, 0, 5, 3), (15, 14, 3, 4), (30, 20, 7, 7), (17, 3, 1, 1)])
def test_a_part_is_the_same_part(crop: tuple[int, int, int, int]) -> None:
    x, y, width, height = crop
    for spp in (4, 19):  # groups change every sixteen samples
        part = picture(crop=crop, spp=spp)
        np.testing.assert_array_equal(part, picture(spp=spp)[y : y + height, x : x + width])


def test_samples_may_differ_from_pixel_to_pixel() -> None:
    spps = [1, 2, 5, 16, 19, 33]
    counts = np.random.default_rng(1).choice(spps, (SIZE["height"], SIZE["width"]))
    counted = ph.render(room(True), counts=counts, reuse_paths=True, seed=5, **SIZE).numpy()
    for spp in spps:
        np.testing.assert_array_equal(counted[counts == spp], picture(spp=spp)[counts == spp])


def test_going_on_and_shards(tmp_path: Any) -> None:
    file = tmp_path / "a.checkpoint"
    picture(spp=3, checkpoint=file)
    np.testing.assert_array_equal(picture(spp=35, checkpoint=file, resume=True), picture(spp=35))
    with pytest.raises(ph.SceneError, match="reuse_paths"):
        picture(spp=36, checkpoint=file, resume=True, reuse_paths=False)
    parts = [tmp_path / f"{k}.checkpoint" for k in (1, 2, 3)]
    for k, part in enumerate(parts):
        picture(shard=(k + 1, 3), checkpoint=part)
    np.testing.assert_array_equal(ph.merge(parts).numpy(), picture())


def test_what_the_camera_sees_is_told_as_without() -> None:
    alone, shared = (
        ph.render(room(True), spp=4, features=True, reuse_paths=reuse, **SIZE)
        for reuse in (False, True)
    )
    for name in ("albedo", "normal", "depth", "position", "direct", "emission", "shape"):
        np.testing.assert_array_equal(alone.features[name], shared.features[name])
    np.testing.assert_array_equal(
        shared.numpy(), ph.render(room(True), spp=4, reuse_paths=True, **SIZE).numpy()
    )


def test_pixels_that_are_noisier_get_more_samples() -> None:
    image = ph.render(room(True), noise=0.3, spp=256, reuse_paths=True, **SIZE)
    samples = image.features["samples"]
    assert len(np.unique(samples)) > 2
    again = ph.render(room(True), counts=samples.astype(int), reuse_paths=True, **SIZE)
    np.testing.assert_array_equal(image.numpy(), again.numpy())


def test_without_effect_on_light_that_was_scattered_once() -> None:
    for settings in ({"integrator": "direct"}, {"integrator": "ao"}, {"max_depth": 2}):
        np.testing.assert_array_equal(picture(**settings), picture(reuse_paths=False, **settings))


LARGE = {"width": 192, "height": 160, "spp": 1, "seed": 5}


def plain() -> ph.Prepared:
    """A matte ball under a white sky, whose light comes straight to all that is seen."""
    return ph.prepare(ph.Scene([ph.Spheres([[0, 0, 0]], 1, WHITE)]))


@pytest.mark.parametrize("shared", [False, True])
def test_what_pays_is_found_out(shared: bool) -> None:
    scene = room(True) if shared else plain()
    found = ph.render(scene, **LARGE)
    assert found.settings.reuse_paths is shared
    asked = ph.render(scene, reuse_paths=shared, **LARGE)
    np.testing.assert_array_equal(found.numpy(), asked.numpy())


def test_what_is_gained_has_to_be_more_than_rounding() -> None:
    """Mirrors under a lamp share nothing; their noise was 0.9999999993 of that without."""
    assert not sharing.Look(noise=0.9999999993, rays=1.0).pays
    assert not sharing.Look(noise=0.72, rays=1.35).pays
    assert sharing.Look(noise=0.5, rays=1.6).pays


@pytest.mark.parametrize(
    ("first", "second", "pays"),
    [
        # without, and with shared paths; the same for all squares, either way
        (([9, 9], [3, 4]), None, True),
        (([9, 9], [9, 8.8]), None, False),
        # one of two decides, so as many more are asked
        (([90, 1], [40, 2]), ([1, 1], [1, 1]), True),
        (([9, 1], [4, 2]), ([9, 9], [9, 10]), False),
        (([9, 9], [3, 9]), ([9, 9], [3, 3]), True),
        # no noise at all, and pictures that are not finite
        (([0, 0], [0, 0]), None, False),
        (([9, 9], [np.nan, 3]), ([9, 9], [3, 3]), False),
    ],
)
def test_squares_that_do_not_agree_ask_as_many_more(
    first: Any, second: Any, pays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def both_ways(*arguments: Any) -> Any:
        places = arguments[2]
        asked.extend(places)
        errors = second if len(asked) > 2 else first
        return np.array(errors, np.float64)[:, None, :, None, None], np.array([10.0, 11.0])

    monkeypatch.setattr(sharing, "_both_ways", both_ways)
    monkeypatch.setattr(sharing, "noise", lambda pictures: pictures[:, 0, :, 0, 0])
    found = sharing.look(None, None, ph.Settings(width=128, height=64), None)
    assert found.pays is pays
    assert found.rays == 1.1
    places = sharing.squares(8, 4)
    assert asked == (places[:2] if second is None else places)


@pytest.mark.parametrize("stopped", [1, 2])
def test_a_look_that_is_stopped_tells_nothing(
    stopped: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def both_ways(*_: Any) -> Any:
        calls.append(None)
        pictures = np.zeros((2, 2, 2, 256, 3))
        return None if len(calls) == stopped else (pictures, np.array([10.0, 11.0]))

    monkeypatch.setattr(sharing, "_both_ways", both_ways)
    monkeypatch.setattr(sharing, "_agree", lambda *_: False)
    assert sharing.look(None, None, ph.Settings(width=128, height=64), None) is None
    assert len(calls) == stopped


def test_what_is_found_out_is_so_for_every_part_and_way_to_render(tmp_path: Any) -> None:
    """Threads, seeds, crops, shards and samples later on make parts of one picture."""
    whole = ph.render(room(True), **LARGE).numpy()
    for settings in ({"threads": 1}, {"isa": "baseline"}, {"tree": "none"}):
        np.testing.assert_array_equal(ph.render(room(True), **LARGE, **settings).numpy(), whole)
    part = ph.render(room(True), crop=(40, 50, 9, 7), **LARGE)
    np.testing.assert_array_equal(part.numpy(), whole[50:57, 40:49])
    parts = [tmp_path / f"{k}.part" for k in (1, 2)]
    for k, file in enumerate(parts):
        ph.render(room(True), shard=(k + 1, 2), checkpoint=file, **LARGE)
    np.testing.assert_array_equal(ph.merge(parts).numpy(), whole)
    more = {**LARGE, "spp": 3}
    file = tmp_path / "a.checkpoint"
    ph.render(room(True), checkpoint=file, **LARGE)
    later = ph.render(room(True), checkpoint=file, resume=True, **more)
    np.testing.assert_array_equal(later.numpy(), ph.render(room(True), **more).numpy())
    for seed in range(5):
        assert ph.render(room(True), **{**LARGE, "seed": seed}).settings.reuse_paths is True


@pytest.mark.parametrize(
    "settings",
    [
        {"width": 128, "height": 63},
        {"integrator": "direct"},
        {"integrator": "ao"},
        {"max_depth": 2},
    ],
)
def test_what_is_not_looked_at(settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any) -> Any:
        raise AssertionError

    monkeypatch.setattr(sharing, "noise", never)
    image = ph.render(room(True), **{**LARGE, **settings})
    assert image.settings.reuse_paths is False
    with pytest.raises(AssertionError):  # what is just large enough
        ph.render(room(True), **{**LARGE, "width": 128, "height": 64})


def test_squares_lie_all_over_the_picture() -> None:
    for across, down in ((8, 4), (8, 8), (64, 1), (1, 64), (40, 22), (256, 135)):
        found = np.array(sharing.squares(across, down))
        few = max(2, int((across * down) ** 0.5 / 3))
        assert len(np.unique(found, axis=0)) == len(found) == 2 * min(24, few)
        assert (found >= 0).all()
        assert (found < (across, down)).all()
        for half in np.split(found, 2):
            if len(half) >= 8 and min(across, down) > 1:  # every quarter has its share
                quarters = np.unique(half * 2 // (across, down), axis=0, return_counts=True)[1]
                assert len(quarters) == 4
                assert quarters.min() >= len(half) // 8


def test_noise_is_told_relative_to_brightness_and_without_the_worst_pixels() -> None:
    rng = np.random.default_rng(1)
    bright = rng.uniform(0.1, 10, (3, 256, 1))
    spread = np.array([0.1, 0.3])[:, None, None, None, None]
    pictures = bright * (1 + spread * rng.normal(size=(2, 2, 3, 256, 3)))
    pictures[1, 0, 1, 17] = 1e6
    alone, noisier = sharing.noise(pictures)
    assert 7 < noisier.sum() / alone.sum() < 10
    assert ((noisier / alone > 4) & (noisier / alone < 18)).all()
    assert not sharing.noise(np.zeros((2, 2, 3, 256, 3))).any()


def test_mistakes_are_told() -> None:
    with pytest.raises(ph.SceneError, match='reuse_paths is 3; must be True, False or "auto"'):
        picture(reuse_paths=3)
