"""Lights with known answers: those without a surface, surfaces that shine, and many of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from floor_tools import (
    LAMP,
    PLACES,
    Floor,
    assert_lit,
    ball,
    lamps,
    parts,
    picture,
    quad,
    quad_surface,
    round_surface,
    scene_runs,
    surface_irradiance,
    turned,
)
from statistics_tools import SIGNIFICANCE, mean_p

# --- Lights without a surface ------------------------------------------------------------------


def from_point(floor: Floor, position: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Directions from a place to the floor's points, and cosine over squared distance there."""
    d = floor.points() - np.asarray(position)
    distance = np.linalg.norm(d, axis=-1, keepdims=True)
    return d / distance, -d[..., 1] / distance[..., 0] ** 3


def test_point() -> None:
    floor, position = Floor(), (0.3, 0.7, -0.2)
    light = ph.Light("point", position=position, intensity=(3, 2, 1))
    _, factor = from_point(floor, position)
    expected = factor[..., None] * [3, 2, 1] / np.pi
    np.testing.assert_allclose(floor.render(lights=[light], spp=1), expected, rtol=1e-5)


def test_a_point_is_moved_by_its_transform() -> None:
    floor = Floor()
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned((1, 2, 3), 40), (0.1, 0.6, 0.2)
    light = ph.Light("point", position=(0.1, 0.05, 0.2), transform=matrix)
    _, factor = from_point(floor, matrix[:3, :3] @ [0.1, 0.05, 0.2] + matrix[:3, 3])
    np.testing.assert_allclose(
        floor.render(lights=[light], spp=1)[..., 1], factor / np.pi, rtol=1e-5
    )


@pytest.mark.parametrize("beam", [-1.0, 10.0, 40.0])
def test_spot(beam: float) -> None:
    floor, position, axis = Floor(size=16), (0.2, 1.0, 0.1), np.array([0.1, -2.0, 0.3])
    light = ph.Light(
        "spot",
        position=position,
        direction=tuple(axis),
        cutoff_angle=40,
        beam_width=beam,
        intensity=(5, 5, 5),
    )
    d, factor = from_point(floor, position)
    angle = np.degrees(np.arccos(d @ axis / np.linalg.norm(axis)))
    full = 30.0 if beam < 0 else beam
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = np.where(angle <= full, 1.0, np.clip((40 - angle) / (40 - full), 0, 1))
    fall[angle >= 40] = 0
    assert 20 < np.sum(fall == 0) < 200
    pixels = floor.render(lights=[light], spp=1)[..., 0]
    np.testing.assert_allclose(pixels, 5 * factor * fall / np.pi, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.53, 30.0])
def test_directional(angle: float) -> None:
    """A disk wholly above the horizon lights a floor as its middle alone would."""
    direction = np.array([1.0, -2.0, 0.5])
    light = ph.Light("directional", direction=tuple(direction), irradiance=(4, 4, 4), angle=angle)
    runs = Floor().runs(lights=[light], spp=16)
    assert_lit(runs, np.array(4 * 2 / np.linalg.norm(direction)))
    if angle == 0:
        assert np.ptp(runs) < 1e-6


def test_projector_throws_its_image_upright() -> None:
    """+z of its frame points down here, the image's top at the picture's bottom."""
    floor, h = Floor(size=8), 1.5
    image = np.random.default_rng(1).uniform(0.2, 1, (8, 8, 3)).astype(np.float32)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned((1, 0, 0), 90), (0, h, 0)
    fov = 2 * np.degrees(np.arctan(1 / h))  # what the picture shows, and no more
    light = ph.Light("projector", image=image, fov=fov, transform=matrix, scale=(2, 2, 2))
    pixels = floor.render(lights=[light], spp=1)
    # On a screen at distance h: pi scale image / h^2, texel by texel at the pixels' centres.
    np.testing.assert_allclose(pixels, 2 * image[::-1, ::-1] / h**2, rtol=2e-5)
    wide = Floor(size=8, side=4.0)
    outside = np.abs(wide.points()[..., [0, 2]]).max(axis=-1) > 1
    lit = wide.render(lights=[light], spp=1)[..., 0] > 0
    np.testing.assert_array_equal(lit, ~outside)


def panorama(image: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Radiance of a latitude-longitude image in directions of its own frame, in double."""
    rows, columns = image.shape
    y = np.arccos(np.clip(d[..., 1], -1, 1)) / np.pi * (rows - 1)
    x = np.arctan2(d[..., 0], -d[..., 2]) / (2 * np.pi) * columns - 0.5
    i = np.clip(np.floor(y).astype(int), 0, rows - 2)
    j = np.floor(x).astype(int)
    fy, fx = y - i, x - j
    j, k = j % columns, (j + 1) % columns
    upper = image[i, j] * (1 - fx) + image[i, k] * fx
    lower = image[i + 1, j] * (1 - fx) + image[i + 1, k] * fx
    return upper * (1 - fy) + lower * fy


def test_goniometric_shines_by_its_image() -> None:
    floor, position = Floor(size=16), (0.3, 0.7, -0.2)
    image = np.random.default_rng(2).uniform(0.1, 1, (8, 16, 1)).astype(np.float32)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned((1, 2, 3), 40), position
    light = ph.Light(
        "goniometric", image=image.repeat(3, axis=2), intensity=(3, 2, 1), transform=matrix
    )
    d, factor = from_point(floor, position)
    share = panorama(image[..., 0], d @ matrix[:3, :3])
    expected = (factor * share)[..., None] * [3, 2, 1] / np.pi
    np.testing.assert_allclose(floor.render(lights=[light], spp=1), expected, rtol=1e-4)


def test_goniometric_of_equal_area() -> None:
    """A square of 2 x 2: halves of the sphere by the sign of x and y."""
    floor, position = Floor(size=16), (0.0, 0.7, 0.0)
    image = np.array([[1, 2], [3, 4]], np.float32)[..., None].repeat(3, axis=2)
    light = ph.Light("goniometric", image=image, mapping="equal_area", position=position)
    d, factor = from_point(floor, position)
    share = 1.0 + (d[..., 0] > 0) + 2.0 * (d[..., 1] > 0)
    pixels = floor.render(lights=[light], spp=1)[..., 0]
    np.testing.assert_allclose(pixels, factor * share / np.pi, rtol=1e-5)


def test_diffuse_transmission_lets_light_through() -> None:
    """A lamp below the floor lights it by its transmittance, one above by its colour."""
    kind, position = "diffuse_transmission", (0.3, 0.7, -0.2)
    sheet = ph.Material(kind, color=(0.1, 0.2, 0.3), transmittance=(0.6, 0.5, 0.9))
    for side, share in ((1.0, (0.1, 0.2, 0.3)), (-1.0, (0.6, 0.5, 0.7))):  # 0.9 has no room
        floor = Floor(size=16)
        x, y, z = position
        light = ph.Light("point", position=(x, side * y, z))
        _, factor = from_point(floor, position)
        pixels = floor.render(material=sheet, lights=[light], spp=1)
        np.testing.assert_allclose(pixels, factor[..., None] * share / np.pi, rtol=1e-4)


def cosine_directions(count: int) -> np.ndarray:
    """Midpoints of count x count parts of the hemisphere above the floor, of equal cosine."""
    u, v = np.meshgrid((np.arange(count) + 0.5) / count, (np.arange(count) + 0.5) / count)
    r, a = np.sqrt(u), 2 * np.pi * v
    return np.stack([r * np.cos(a), np.sqrt(1 - u), r * np.sin(a)], axis=-1)


@pytest.mark.parametrize("sun", [1.0, 1e4])
@pytest.mark.parametrize("axis", [(0, 1, 0), (1, 1, 0.3)])
def test_envmap(axis: Sequence[float], sun: float) -> None:
    """Turned, with a texel of the sun's brightness or without."""
    image = np.random.default_rng(2).uniform(0.1, 1, (8, 16)).astype(np.float32)
    image[2, 11] = sun
    rotation = turned(axis, 50)
    sky = ph.Background("envmap", image=np.repeat(image[..., None], 3, -1), transform=rotation)
    expected = np.pi * panorama(image, cosine_directions(2000) @ rotation).mean()
    assert_lit(Floor().runs(background=sky, spp=64), expected, rounding=1e-3)


def seen_sky(sky: ph.Light, size: int = 256) -> float:
    """Irradiance of the floor by what a camera sees of the sky."""
    camera = ph.Camera(eye=(0, 0, 0), target=(0, 0, -1), up=(0, 1, 0), projection="equirectangular")
    scene = ph.Scene([], camera=camera, background=sky)
    pixels = picture(scene, width=2 * size, height=size, spp=1)[..., 0]
    polar = (np.arange(size) + 0.5) / size * np.pi
    weight = np.maximum(np.cos(polar), 0) * np.sin(polar) * np.pi / size * np.pi / size
    return float(np.sum(pixels * weight[:, None]))


@pytest.mark.parametrize(
    "sky",
    [
        ph.Background("constant", radiance=(0.7, 0.7, 0.7)),
        ph.Background("gradient", horizon=(0.2, 0.2, 0.2), zenith=(2, 2, 2)),
        ph.Background("sky", sun_direction=(1, 0.6, -0.4)),
        ph.Background("sky", sun_direction=(0.2, 1.0, 0.1), turbidity=6, albedo=0.8),
    ],
    ids=lambda sky: sky.type,
)
def test_a_floor_gathers_what_a_camera_sees_of_the_sky(sky: ph.Light) -> None:
    assert_lit(Floor().runs(background=sky, spp=64), np.array(seen_sky(sky)), rounding=2e-3)


@pytest.mark.parametrize("angle", [0.533, 5.0])
def test_sun(angle: float) -> None:
    """Its disk's radiance, as a camera sees it, over the disk's solid angle."""
    toward = np.array([1.0, 1.5, -0.5]) / np.linalg.norm([1.0, 1.5, -0.5])
    sun = ph.Background("sun", sun_direction=tuple(toward), angle=angle)
    camera = ph.Camera(eye=(0, 0, 0), target=tuple(toward), vfov=0.5 * angle)
    disk = picture(ph.Scene([], camera=camera, background=sun), width=4, height=4, spp=1)[..., 0]
    assert np.ptp(disk) == 0
    expected = disk[0, 0] * np.pi * np.sin(np.radians(angle / 2)) ** 2 * toward[1]
    assert_lit(Floor().runs(background=sun, spp=16), np.array(expected), rounding=1e-5)


def test_all_kinds_of_lights_add_up() -> None:
    """In one scene, from the tree, from outside and left to scattering: none is counted twice."""
    floor = Floor()
    image = np.full((4, 8, 3), 0.3, np.float32)
    lights = [
        ph.Light("point", position=(0.5, 1.0, 0.5), intensity=(1, 1, 1)),
        ph.Light("directional", direction=(0, -1, 0.5), irradiance=(1, 1, 1), angle=10),
        ph.Light("envmap", image=image),
        ph.Light("constant", radiance=(0.2, 0.2, 0.2)),
    ]
    lamp = quad((-0.3, 2, -0.3), (0.6, 0, 0), (0, 0, 0.6), LAMP)
    runs = floor.runs(lamp, lights=lights, spp=128)
    _, factor = from_point(floor, (0.5, 1.0, 0.5))
    # The lamp hides some of the sky; what it gives replaces that.
    hidden = surface_irradiance(floor, quad_surface(lamp))
    shine = (2 - 0.5) * hidden
    expected = factor + 2 / np.sqrt(5) + np.pi * 0.5 + shine
    clear = floor.points()[..., 2] < 0.2  # where the lamp hides the disk
    assert clear.sum() > 10
    assert mean_p(runs[:, clear], expected[clear] / np.pi, 1e-4) > SIGNIFICANCE


# --- Surfaces that shine -----------------------------------------------------------------------


def tube_surface(radius: float, length: float) -> Callable[..., np.ndarray]:
    """Along z from 0."""

    def place(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        a = 2 * np.pi * u
        return np.stack([radius * np.cos(a), radius * np.sin(a), length * v], axis=-1)

    return place


def disk_surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The unit disk in z = 0 that looks along z."""
    a = 2 * np.pi * v
    return np.stack([u * np.cos(a), u * np.sin(a), 0 * u], axis=-1)


# name -> the shape around the origin, at most 1 in size, and its surfaces
SHINING: dict[str, tuple[Any, list[Callable[..., np.ndarray]]]] = {
    "sphere": (ph.Spheres([[0, 0, 0]], 0.4, LAMP), [round_surface((-1, 1), 0.4)]),
    "disk": (ph.Disks([[0, 0, 0]], [[1, 0, 0]], [[0, 1, 0]], LAMP), [disk_surface]),
    "cylinder": (
        ph.Cylinders([[0, 0, 0]], [[0, 0, 0.8]], 0.2, material=LAMP),
        [tube_surface(0.2, 0.8)],
    ),
    "strand": (  # with round ends: half a sphere at each
        ph.Curves([[0, 0, 0], [0, 0, 0.8]], 0.2, basis="linear", material=LAMP),
        [
            tube_surface(0.2, 0.8),
            round_surface((-1, 0), 0.2),
            lambda u, v: round_surface((0, 1), 0.2)(u, v) + np.array([0, 0, 0.8]),
        ],
    ),
    "quad": (
        quad((0, 0, 0), (0.5, 0, 0), (0.2, 0.4, 0), LAMP),
        [lambda u, v: u[:, None] * [0.5, 0, 0] + v[:, None] * [0.2, 0.4, 0]],
    ),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", SHINING)
def test_floor_under_a_shape_that_shines(name: str, place: str) -> None:
    """As an instance, so that every shape can be turned, stretched and mirrored."""
    shape, surfaces = SHINING[name]
    floor, matrix = Floor(), PLACES[place]
    made = [parts(s, matrix=matrix) for s in surfaces]
    # All are convex, so parts that face a point are not hidden; the open tube's back is dark.
    expected = 2 * surface_irradiance(floor, *made)
    runs = floor.runs(ph.Instances([shape], [matrix]), spp=64)
    assert_lit(runs, expected, rounding=1e-3)


def test_front_and_back() -> None:
    floor = Floor()
    up = quad((-0.5, 1, 0.5), (1, 0, 0), (0, 0, -1), ph.Material("diffuse", emission=(3, 3, 3)))
    assert not np.any(floor.render(up))
    both = ph.Material("diffuse", emission=(3, 3, 3), two_sided_emission=True)
    lamp = quad((-0.5, 1, 0.5), (1, 0, 0), (0, 0, -1), both)
    expected = 3 * surface_irradiance(floor, quad_surface(lamp), both=True)
    assert_lit(floor.runs(lamp, spp=64), expected, rounding=1e-4)
    down = quad((-0.5, 1, 0.5), (1, 0, 0), (0, 0, -1), up.material, inside_out=True)
    assert_lit(floor.runs(down, spp=64), expected, rounding=1e-4)


@pytest.mark.parametrize("side", ["inside_out", "two_sided_emission", "mesh"])
def test_within_a_sphere_that_shines(side: str) -> None:
    """Of albedo 1/2: after one bounce there is half as much light again."""
    both = side == "two_sided_emission"
    glow = ph.Material("diffuse", color=(0.5,) * 3, emission=(1, 1, 1), two_sided_emission=both)
    shell: Any = ph.Spheres([[0, 0, 0]], 1, glow, inside_out=not both)
    if side == "mesh":
        shell = ball(24, 48, glow, inside_out=True)
    camera = ph.Camera(eye=(0.3, 0.2, 0.1), target=(1, 0, 0), vfov=90)
    scene = ph.Scene([shell], camera=camera, background=None)
    runs = scene_runs(scene, width=8, height=8, spp=64, max_depth=2, roulette=False)
    np.testing.assert_allclose(runs, 1.5, rtol=1e-4 if side != "mesh" else 0.2)
    np.testing.assert_allclose(runs.mean(), 1.5, rtol=1e-4 if side != "mesh" else 2e-3)


def test_the_far_side_of_a_lamp_through_a_hole_in_its_near_side() -> None:
    """The lower half is a hole; the floor sees the upper half's inside through it."""
    floor = Floor()
    v = np.linspace(0, 1, 64)[::-1]
    image = np.repeat((v > 0.5)[:, None], 4, axis=1).astype(np.float32)
    holes = ph.Texture("image", image=image, filter="nearest", wrap_v="clamp")
    glow = ph.Material(
        "diffuse", color=(0, 0, 0), emission=(2, 2, 2), two_sided_emission=True, opacity=holes
    )
    to_y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)  # the sphere's own pole is z
    lamp = ph.Spheres([[0, 1.0, 0]], 0.5, glow, rotation=to_y_up)
    disk = ph.Disks([[0, 1.0, 0]], [[0.5, 0, 0]], [[0, 0, 0.5]], LAMP)
    # half a sphere seen from below looks as its opening does
    a, b = (floor.runs(shape, spp=256).mean(axis=(1, 2)) for shape in (lamp, disk))
    assert b.mean() > 0.05
    np.testing.assert_allclose(a.mean(), b.mean(), rtol=0.04)


def test_textured_emission() -> None:
    image = np.array([[1.0, 6.0], [0.0, 3.0]], np.float32)  # the first row at v = 1
    texture = ph.Texture("image", image=image, filter="nearest")
    lamp = quad((-0.8, 0.7, -0.6), (1.6, 0, 0), (0, 0, 1.2), ph.Material("null", emission=texture))
    floor = Floor()

    def radiance(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return image[np.where(v < 0.5, 1, 0), np.where(u < 0.5, 0, 1)]

    expected = surface_irradiance(floor, quad_surface(lamp, radiance))
    assert_lit(floor.runs(lamp, spp=64, max_depth=3), expected, rounding=1e-3)


def test_light_that_is_asked_for_is_the_light_that_is_met() -> None:
    """A mirror shows the lamp by scattering alone; a nearly perfect one, by both."""
    lamp = quad((-0.8, 1.5, -0.6), (1.6, 0, 0), (0, 0, 1.2), LAMP)
    floor = Floor()
    mirror = floor.runs(lamp, material=ph.Material("metal", color=(1, 1, 1)), spp=16, count=2)
    np.testing.assert_array_equal(mirror[0], mirror[1])
    inside = (np.abs(floor.points()[..., 0]) < 0.8) & (np.abs(floor.points()[..., 2]) < 0.6)
    np.testing.assert_array_equal(mirror[0], np.where(inside, np.float32(2), 0))


# --- Many lights -------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 10, 100, 1000, 10_000, 100_000])
def test_floor_under_many_lamps(count: int) -> None:
    floor = Floor(size=4)
    mesh, surface = lamps(count)
    assert_lit(
        floor.runs(mesh, spp=256), surface_irradiance(floor, surface, both=True), rounding=1e-4
    )


@pytest.mark.parametrize("count", [10, 1000])
def test_floor_under_instances_of_lamps(count: int) -> None:
    floor = Floor(size=4)
    mesh, (points, area, radiance) = lamps(10)
    rng = np.random.default_rng(4)
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, :3, :3] = rng.normal(size=(count, 3, 3)) * 0.1
    matrices[:, :3, 3] = rng.uniform((-1, 0.9, -1), (1, 2, 1), (count, 3))
    copies = []
    for m in matrices:
        a = np.linalg.inv(m[:3, :3])
        flipped = np.abs(np.linalg.det(m[:3, :3])) * area @ a
        copies.append((points @ m[:3, :3].T + m[:3, 3], flipped, radiance))
    joined = tuple(np.concatenate(c) for c in zip(*copies, strict=True))
    runs = floor.runs(ph.Instances([mesh], matrices), spp=256)
    assert_lit(runs, surface_irradiance(floor, joined, both=True), rounding=1e-3)
