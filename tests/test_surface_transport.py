"""Scenes with known answers: lights of every kind, glass, normal maps, holes, textures, instances.

Most of them light a white floor that the camera sees from just above, so that nothing stands in
between, with paths of two rays. What the floor must show is computed from the lights' formulas, or
from a sum over their surfaces, in double precision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core
from parhelion.tables import tables
from statistics_tools import SIGNIFICANCE, mean_p, sidak

DARK = ph.Background("constant", radiance=(0, 0, 0))
WHITE = ph.Background("constant", radiance=(1, 1, 1))
BLACK = ph.Material("emissive", radiance=(0, 0, 0))
# What Floor.render takes that is no setting.
SCENE = {"material", "lights", "background", "height"}


def quad(
    corner: Sequence[float], u: Sequence[float], v: Sequence[float], material: Any, **more: Any
) -> ph.Mesh:
    """A parallelogram of two triangles whose front is where u x v points; uvs run along u and v."""
    c, a, b = (np.asarray(x, float) for x in (corner, u, v))
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices = c + uvs[:, :1] * a + uvs[:, 1:] * b
    return ph.Mesh(vertices, [[0, 1, 2], [0, 2, 3]], uvs=uvs, material=material, **more)


def box(low: Sequence[float], high: Sequence[float], material: Any, **more: Any) -> ph.Mesh:
    """A closed box of twelve triangles, its front outside."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    vertices = np.asarray(low) + corners * (np.asarray(high, float) - np.asarray(low))
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))]
    return ph.Mesh(vertices, faces, material=material, **more)


def sheet(height: float, material: ph.Material, front: str = "down") -> ph.Mesh:
    """Level, over a Floor, larger than it is seen."""
    side = {"down": 40.0, "up": -40.0}[front]
    return quad((-40, height, -0.9 * side), (80, 0, 0), (0, 0, 2 * side), material)


def ball(rows: int, columns: int, material: Any, **more: Any) -> ph.Mesh:
    """A unit sphere of flat faces with the true sphere's normals; u is longitude, v latitude."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    sine = np.sin(np.pi * v)
    points = np.stack(
        [sine * np.cos(2 * np.pi * u), sine * np.sin(2 * np.pi * u), -np.cos(np.pi * v)], axis=-1
    ).reshape(-1, 3)
    points = np.round(points, 12) + 0.0  # a seam's vertices, and a pole's, are the same ones
    i, j = (a.ravel() for a in np.indices((rows, columns)))
    a, b = i * (columns + 1) + j, (i + 1) * (columns + 1) + j
    # no degenerate faces at the poles
    faces = np.concatenate(
        [np.stack([a, b + 1, b], 1)[i < rows - 1], np.stack([a, a + 1, b + 1], 1)[i > 0]]
    )
    uvs = np.stack([u, v], axis=-1).reshape(-1, 2)
    return ph.Mesh(points, faces, normals=points, uvs=uvs, material=material, **more)


@dataclass(frozen=True)
class Floor:
    """A square floor around the origin in a picture of size x size pixels, x right and z down."""

    size: int = 6
    side: float = 2.0
    extent: float = 50.0

    def points(self) -> np.ndarray:
        """(size, size, 3) that the pixel centres see."""
        at = ((np.arange(self.size) + 0.5) / self.size - 0.5) * self.side
        x, z = np.meshgrid(at, at)
        return np.stack([x, 0 * x, z], axis=-1)

    def mesh(self, material: ph.Material | None = None) -> ph.Mesh:
        """uvs are 0 to 1 over what the picture shows: u to the right, v up in the picture."""
        e, s = self.extent, self.side
        # wider to the right, so that no pixel's centre lies on the two triangles' common edge
        plane = np.array([[-e, -e], [1.25 * e, -e], [1.25 * e, e], [-e, e]])
        vertices = np.stack([plane[:, 0], 0 * plane[:, 0], -plane[:, 1]], axis=1)
        uvs = plane / s + 0.5
        material = material or ph.Material("diffuse", color=(1, 1, 1))
        return ph.Mesh(vertices, [[0, 1, 2], [0, 2, 3]], uvs=uvs, material=material)

    def camera(self, height: float = 1e-2) -> ph.Camera:
        return ph.Camera(
            eye=(0, height, 0),
            target=(0, 0, 0),
            up=(0, 0, -1),
            projection="orthographic",
            height=self.side,
        )

    def scene(
        self,
        *shapes: Any,
        material: ph.Material | None = None,
        lights: Sequence[ph.Light] = (),
        background: ph.Light = DARK,
        height: float = 1e-2,
    ) -> ph.Prepared:
        """The floor, and the camera at some height above it."""
        scene = ph.Scene(
            [self.mesh(material), *shapes],
            camera=self.camera(height),
            background=background,
            lights=lights,
        )
        return ph.prepare(scene)

    def shown(self, prepared: ph.Prepared, **settings: Any) -> np.ndarray:
        return picture(prepared, width=self.size, height=self.size, **{"max_depth": 2, **settings})

    def render(self, *shapes: Any, **more: Any) -> np.ndarray:
        what = {k: more.pop(k) for k in SCENE & more.keys()}
        return self.shown(self.scene(*shapes, **what), **more)

    def runs(self, *shapes: Any, count: int = 8, **more: Any) -> np.ndarray:
        """(count, size, size): the red channel of pictures of as many seeds."""
        what = {k: more.pop(k) for k in SCENE & more.keys()}
        prepared = self.scene(*shapes, **what)
        return np.stack([self.shown(prepared, seed=s, **more)[..., 0] for s in range(count)])


def picture(scene: ph.Scene | ph.Prepared, **settings: Any) -> np.ndarray:
    """Pixel centres alone."""
    fixed = {"filter": "box", "filter_radius": 1e-6, "threads": 1, "spp": 16}
    return ph.render(scene, **{**fixed, **settings}).numpy()


def scene_runs(scene: ph.Scene, count: int = 8, first: int = 0, **settings: Any) -> np.ndarray:
    """(count, ...): pictures of as many seeds."""
    prepared = ph.prepare(scene)
    return np.stack([picture(prepared, seed=first + s, **settings) for s in range(count)])


def assert_lit(runs: np.ndarray, irradiance: np.ndarray, rounding: float = 1e-5) -> None:
    """A floor of albedo 1 under that irradiance."""
    expected = np.broadcast_to(irradiance / np.pi, runs.shape[1:])
    assert mean_p(runs, expected, rounding) > SIGNIFICANCE
    total = runs.mean(axis=(1, 2))
    assert mean_p(total, np.array(expected.mean()), rounding) > SIGNIFICANCE
    assert abs(total.mean() / expected.mean() - 1) < 0.02


def turned(axis: Sequence[float], degrees: float) -> np.ndarray:
    """(3, 3) rotation."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(degrees)
    return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k


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

# A surface: (points (N, 3), area times outward normal (N, 3), radiance (N,)) of small parts of it.
Parts = tuple[np.ndarray, np.ndarray, np.ndarray]


def parts(
    place: Callable[[np.ndarray, np.ndarray], np.ndarray],
    radiance: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    count: int = 200,
    matrix: np.ndarray | None = None,
) -> Parts:
    """Of the surface place(u, v) over the unit square, whose outward normal is dp/du x dp/dv."""
    u, v = (a.ravel() for a in np.meshgrid(*[(np.arange(count) + 0.5) / count] * 2))

    def at(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        p = place(u, v)
        return p if matrix is None else p @ matrix[:3, :3].T + matrix[:3, 3]

    h = 1e-5
    du = (at(u + h, v) - at(u - h, v)) / (2 * h)
    dv = (at(u, v + h) - at(u, v - h)) / (2 * h)
    shine = np.ones(u.size) if radiance is None else radiance(u, v)
    area = np.cross(du, dv) / count**2
    if matrix is not None and np.linalg.det(matrix[:3, :3]) < 0:
        area = -area  # the normal stays outside where the matrix mirrors
    return at(u, v), area, shine


def surface_irradiance(
    floor: Floor, *surfaces: Parts, both: bool = False, absorption: float = 0.0
) -> np.ndarray:
    """Of the floor's points, by parts that nothing hides and that shine from one side, or both."""
    total = np.zeros((floor.size, floor.size))
    for points, area, radiance in surfaces:
        for i, j in np.ndindex(total.shape):
            d = points - floor.points()[i, j]
            distance2 = np.sum(d * d, axis=1)
            facing = -np.sum(area * d, axis=1)
            facing = np.abs(facing) if both else np.maximum(facing, 0)
            factor = facing * np.maximum(d[:, 1], 0) / distance2**2
            total[i, j] += np.sum(radiance * factor * np.exp(-absorption * np.sqrt(distance2)))
    return total


def quad_surface(mesh: ph.Mesh, radiance: Any = None, matrix: np.ndarray | None = None) -> Parts:
    c, a, _, b = np.asarray(mesh.vertices)
    return parts(
        lambda u, v: c + u[:, None] * (a - c) + v[:, None] * (b - c), radiance, matrix=matrix
    )


def round_surface(ends: Sequence[float], radius: float = 1.0) -> Callable[..., np.ndarray]:
    """A unit sphere's zone between two heights, along z."""

    def place(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        z = ends[0] + (ends[1] - ends[0]) * v
        r, a = np.sqrt(np.maximum(1 - z * z, 0)), 2 * np.pi * u
        return radius * np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)

    return place


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


def moved(matrix: np.ndarray, offset: Sequence[float]) -> np.ndarray:
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = matrix, offset
    return m


# dark but for its own light; its back is dark altogether
LAMP = ph.Material("diffuse", color=(0, 0, 0), emission=(2, 2, 2))
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
PLACES = {
    "turned": moved(turned((1, 0.3, 0), 130), (0.2, 1.2, 0.1)),
    "stretched": moved(turned((1, 0.3, 0), 130) @ np.diag([1.5, 0.5, 0.8]), (0.2, 1.2, 0.1)),
    "sheared": moved(
        turned((1, 0.3, 0), 130) @ [[1, 0.6, 0], [0, 1, -0.3], [0, 0, 1]], (0.2, 1.4, 0.1)
    ),
    "mirrored": moved(turned((1, 0.3, 0), 130) @ np.diag([-1.0, 0.6, 1]), (0.2, 1.2, 0.1)),
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


def lamps(count: int, seed: int = 3) -> tuple[ph.Mesh, Parts]:
    """Triangles at random over the floor, each so small that its light is that of a point."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform((-1.5, 0.5, -1.5), (1.5, 1.5, 1.5), (count, 3))
    corners = rng.normal(size=(count, 3, 3)) * (2e-3 / np.sqrt(count))
    radiance = rng.uniform(0, 2e6, count)
    vertices = (centers[:, None] + corners).reshape(-1, 3)
    mesh = ph.Mesh(
        vertices,
        np.arange(3 * count).reshape(-1, 3),
        material=ph.Material("emissive"),
        colors=np.repeat(radiance[:, None], 3, axis=1),
    )
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return mesh, (centers + corners.mean(axis=1), area, radiance)


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


# --- Glass -------------------------------------------------------------------------------------

PANE = ph.Camera(eye=(0, 0, 4), target=(0, 0, 0), projection="orthographic", height=1.0)
ABSORPTION = np.array([0.1, 0.7, 3.0])


def fresnel(cosine: float, ior: float) -> float:
    """Reflectance of unpolarised light at the boundary to a body of that relative index."""
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    s = (cosine - ior * inside) / (cosine + ior * inside)
    p = (ior * cosine - inside) / (ior * cosine + inside)
    return float((s * s + p * p) / 2)


@pytest.mark.parametrize("priority", [0, 1])
@pytest.mark.parametrize("tilt", [0.0, 35.0])
@pytest.mark.parametrize("stretch", [1.0, 0.25])
def test_absorption_without_refraction(priority: int, tilt: float, stretch: float) -> None:
    """Beer and Lambert's law, in the scene's units where an instance is stretched."""
    clear = ph.Material("dielectric", ior=1.0, absorption=tuple(ABSORPTION), priority=priority)
    matrix = moved(turned((1, 0, 0), tilt) @ np.diag([1, 1, stretch]), (0, 0, 0))
    slab = ph.Instances([box((-9, -9, -0.5), (9, 9, 0.5), clear)], [matrix])
    scene = ph.Scene([slab], camera=PANE, background=WHITE)
    length = stretch / np.cos(np.radians(tilt))
    expected = np.broadcast_to(np.exp(-ABSORPTION * length), (3, 3, 3))
    pixels = picture(scene, width=3, height=3, spp=1, roulette=False)
    np.testing.assert_allclose(pixels, expected, rtol=2e-5)


@pytest.mark.parametrize("ior", [1.33, 2.0])
def test_a_pane_of_absorbing_glass(ior: float) -> None:
    """All orders of inner reflection, seen against a white wall behind and darkness in front."""
    glass = ph.Material("dielectric", ior=ior, absorption=tuple(ABSORPTION), priority=1)
    wall = quad((-9, -9, -2), (18, 0, 0), (0, 18, 0), ph.Material("emissive"))
    pane = box((-5, -7, -0.5), (6, 5, 0.5), glass)
    runs = np.stack(
        [
            picture(
                ph.Scene([pane, wall], camera=PANE, background=DARK),
                width=4,
                height=4,
                spp=256,
                seed=s,
            )
            for s in range(8)
        ]
    )
    r, through = fresnel(1.0, ior), np.exp(-ABSORPTION)
    expected = (1 - r) ** 2 * through / (1 - r**2 * through**2)
    assert mean_p(runs.mean(axis=(1, 2)), expected, 1e-5) > SIGNIFICANCE
    np.testing.assert_allclose(runs.mean(axis=(0, 1, 2)), expected, rtol=5e-3)


GLASS_VIEW = ph.Camera(eye=(0, 0, 4), target=(0, 0, 0), vfov=30)
STRIPES = ph.Background("gradient", horizon=(0, 0, 0), zenith=(1, 1, 1), up=(0.3, 1, 0.2))


def look_alike(a: Sequence[Any], b: Sequence[Any]) -> bool:
    """Whether shapes before a sky differ by no more than their noise."""
    runs = [
        scene_runs(
            ph.Scene(shapes, camera=GLASS_VIEW, background=STRIPES),
            first=100 * i,
            width=8,
            height=8,
            spp=128,
        )[..., 0]
        for i, shapes in enumerate((a, b))
    ]
    first, second = (r.mean(axis=(1, 2)) for r in runs)
    return (
        mean_p(runs[0] - runs[1], np.zeros((8, 8)), 0.0) > SIGNIFICANCE
        and mean_p(first - second, np.array(0.0)) > SIGNIFICANCE
        and abs(first.mean() / second.mean() - 1) < 0.01
    )


def glass(priority: int, ior: float, **more: Any) -> ph.Material:
    return ph.Material("dielectric", ior=ior, priority=priority, **more)


def sphere(radius: float, material: Any, **more: Any) -> ph.Spheres:
    return ph.Spheres([[0, 0, 0]], radius, material, **more)


@pytest.mark.parametrize(("inner", "outer"), [(2, 1), (1, 2), (1, 1)])
def test_glass_of_equal_index_inside_is_invisible(inner: int, outer: int) -> None:
    alone = [sphere(1, glass(outer, 1.5))]
    assert look_alike([*alone, sphere(0.5, glass(inner, 1.5))], alone)


def test_a_glass_full_of_water() -> None:
    """Its wall overlaps the water, which gives way; the same with interfaces that touch."""

    def filled(wall: int, water: int) -> list[ph.Spheres]:
        shell = glass(wall, 1.5)
        return [
            sphere(1, shell),
            sphere(0.8, shell, inside_out=True),
            sphere(0.87, glass(water, 1.33)),
        ]

    # From the wall into what it holds: the inner side of the wall faces outwards here.
    touching = [sphere(1, glass(0, 1.5)), sphere(0.8, glass(0, 1.33 / 1.5))]
    assert look_alike(filled(2, 1), touching)
    assert not look_alike(filled(1, 2), touching)
    # Where the water counts, the wall ends where the water begins.
    wider = [sphere(1, glass(0, 1.5)), sphere(0.87, glass(0, 1.33 / 1.5))]
    assert look_alike(filled(1, 2), wider)


def test_overlapping_bodies_take_light_where_they_count() -> None:
    """Slabs of no refraction: along their common part only the one of higher priority absorbs."""
    red = glass(2, 1.0, absorption=(1, 0, 0))
    green = glass(1, 1.0, absorption=(0, 1, 0))
    slabs = [box((-5, -7, -0.5), (6, 5, 0.75), red), box((-6, -5, 0.25), (5, 7, 1.5), green)]
    scene = ph.Scene(slabs, camera=PANE, background=WHITE)
    pixels = picture(scene, width=2, height=2, spp=1, roulette=False)
    expected = np.exp(-np.array([1.25, 0.75, 0]))
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, (2, 2, 3)), rtol=1e-5)


def drowned(*more: Any, absorption: float, height: float = 5.0) -> tuple[np.ndarray, np.ndarray]:
    """A floor and a round lamp within a body, seen from outside or, below a height of 2, inside:
    runs, and the irradiance that must seem to be there."""
    water = glass(2, 1.0, absorption=(absorption,) * 3)
    floor, depth = Floor(size=4, extent=9.0), 2.0
    # The camera sees past the lamp: no pixel's centre lies below it.
    lamp = ph.Spheres([[0, 1, 0]], 0.25, LAMP)
    sea = box((-20, -1, -20), (20, depth, 20), water)
    runs = floor.runs(sea, lamp, *more, height=height, spp=256, max_depth=20)
    # Light reaches the floor once; all that it scatters upwards is lost.
    surface = parts(lambda u, v: round_surface((-1, 1), 0.25)(u, v) + np.array([0, 1, 0]))
    lit = 2 * surface_irradiance(floor, surface, absorption=absorption)
    return runs, lit * np.exp(-absorption * min(depth, height))


@pytest.mark.parametrize("absorption", [0.0, 0.8])
def test_light_that_is_asked_for_is_absorbed_on_its_way(absorption: float) -> None:
    runs, expected = drowned(absorption=absorption)
    assert_lit(runs, expected, rounding=1e-3)


def test_light_in_the_body_that_the_camera_is_in() -> None:
    runs, expected = drowned(absorption=0.8, height=0.5)
    assert_lit(runs, expected, rounding=1e-3)


def water(priority: int, absorption: float) -> ph.Material:
    """That refracts nothing."""
    return glass(priority, 1.0, absorption=(absorption,) * 3)


@pytest.mark.parametrize(
    ("shapes", "height", "lost"),
    [
        ([sheet(2.0, water(1, 0.7), front="up")], 0.5, 0.35),
        ([sheet(2.0, water(1, 0.7), front="up")], 1.5, 1.05),
        ([sheet(2.0, water(1, 0.7), front="up")], 3.0, 1.4),
        ([box((-9, -1, -9), (9, 2, 9), water(1, 0.7))], 1.5, 1.05),
        # within two bodies, of which the one of higher priority, else the one entered last, counts
        *(
            (
                [
                    box((-9, -1, -9), (9, 2, 9), water(outer, 0.7)),
                    box((-8, 1, -8), (8, 1.8, 8), water(inner, 0.1)),
                ],
                1.5,
                lost,
            )
            for outer, inner, lost in ((1, 2, 0.75), (1, 1, 0.75), (2, 1, 1.05))
        ),
    ],
)
def test_a_camera_knows_the_bodies_that_it_is_in(
    shapes: list[ph.Mesh], height: float, lost: float
) -> None:
    shining = ph.Material("emissive", radiance=(1, 1, 1))
    seen = Floor().render(*shapes, material=shining, height=height, spp=1, max_depth=9)
    np.testing.assert_allclose(seen, np.exp(-lost), rtol=1e-5)


def test_a_body_that_gives_way_takes_no_light() -> None:
    """It lies between the floor and the lamp, within another of higher priority."""
    bubble = ph.Spheres([[0, 1, 0]], 0.3, glass(1, 1.7, absorption=(5, 5, 5)))
    runs, expected = drowned(bubble, absorption=0.3)
    assert_lit(runs, expected, rounding=1e-3)


# --- Normals -----------------------------------------------------------------------------------


def steep_normals(seed: int = 5, size: int = 16) -> ph.Texture:
    """A new normal in every texel, some lying in the surface and some below it."""
    rng = np.random.default_rng(seed)
    image = rng.uniform(0, 1, (size, size, 3)).astype(np.float32)
    return ph.Texture("image", image=image, filter="nearest")


FURNACES = {
    "scattering": WHITE,
    "light samples": ph.Background("envmap", image=np.ones((4, 8, 3), np.float32)),
}


@pytest.mark.parametrize("sky", FURNACES)
@pytest.mark.parametrize(
    "material",
    [
        {"type": "diffuse", "color": (1, 1, 1)},
        {"type": "conductor", "roughness": 0.3, "compensation": "off"},
        {"type": "metal", "color": (1, 1, 1), "fuzz": 0.5},
    ],
    ids=lambda m: m["type"],
)
def test_steep_normals_make_no_light(material: dict[str, Any], sky: str) -> None:
    body = ball(6, 8, ph.Material(**material, normal_map=steep_normals()))
    camera = ph.Camera(eye=(0, 4, 1), target=(0, 0, 0), vfov=35)
    scene = ph.Scene([body], camera=camera, background=FURNACES[sky])
    pixels = picture(scene, width=24, height=24, spp=256)
    assert pixels.min() >= 0
    # Of the noisiest of 576 pixels: paths of many weights where lights are asked for.
    assert pixels.max() < (1 + 1e-5 if sky == "scattering" else 1.1)
    assert pixels.mean() < 1 + 1e-5
    assert pixels[8:16, 8:16].min() < 0.95


@pytest.mark.parametrize("normal_map", [False, True])
def test_no_light_leaks_into_a_closed_room(normal_map: bool) -> None:
    bumps = {"normal_map": steep_normals()} if normal_map else {}
    material = ph.Material("diffuse", color=(1, 1, 1), **bumps)
    for room in (ball(6, 8, material), box((-1, -1, -1), (1, 1, 1), material)):
        scene = ph.Scene(
            [room, ph.Spheres([[3.0, 0, 0]], 1.0, LAMP)],
            camera=ph.Camera(eye=(0, 0, 0), target=(1, 2, 3), vfov=120),
            background=FURNACES["light samples"],
            lights=[
                ph.Light("point", position=(0, 2, 0), intensity=(9, 9, 9)),
                ph.Light("directional", irradiance=(9, 9, 9), direction=(1, -1, 1)),
                WHITE,
            ],
        )
        assert not np.any(picture(scene, width=16, height=16, spp=64))
        outside = scene.replace(camera=ph.Camera(eye=(0, 5, 5), target=(0, 0, 0)))
        assert np.any(picture(outside, width=8, height=8))


@pytest.mark.parametrize("sky", FURNACES)
def test_no_black_rims(sky: str) -> None:
    """Few faces, smooth shading: near the rim the interpolated normals turn away from the eye."""
    body = ball(5, 7, ph.Material("diffuse", color=(1, 1, 1)))
    camera = ph.Camera(eye=(0, 4, 1), target=(0, 0, 0), vfov=32)
    scene = ph.Scene([body], camera=camera, background=FURNACES[sky])
    image = ph.render(
        scene, width=48, height=48, spp=32, filter="box", filter_radius=1e-6, features=True
    )
    seen = image.features["coverage"].squeeze() == 1
    assert 500 < seen.sum() < 2000
    position = image.features["position"]
    away = np.sum((position - [0, 4, 1]) * position, axis=-1) > 0  # the interpolated normal
    assert np.sum(seen & away) > 10
    assert image.numpy()[seen].min() > 0.2
    assert image.numpy()[seen].max() < (1 + 1e-5 if sky == "scattering" else 1.2)


@pytest.mark.parametrize("sky", FURNACES)
@pytest.mark.parametrize("normals", ["smooth", "map"])
@pytest.mark.parametrize("material", ["metal", "conductor"])
def test_mirrors_of_few_faces_have_no_black_rims(material: str, normals: str, sky: str) -> None:
    """A white mirror in a white sky is white, wherever its normals point."""
    more: dict[str, Any] = {"normal_map": steep_normals()} if normals == "map" else {}
    body = ball(5, 7, ph.Material(material, color=(1, 1, 1), **more))
    camera = ph.Camera(eye=(0, 4, 1), target=(0, 0, 0), vfov=32)
    scene = ph.Scene([body], camera=camera, background=FURNACES[sky])
    pixels = picture(scene, width=32, height=32, spp=8, max_depth=9)
    np.testing.assert_allclose(pixels, 1, rtol=1e-4 if sky == "scattering" else 0.1)


@pytest.mark.parametrize(
    "turn", [np.eye(3), turned((1, 2, 3), 40.0), turned((-3, 1, 2), 77.0)], ids=["level", "a", "b"]
)
def test_no_shadow_along_the_seam_of_two_triangles(turn: np.ndarray) -> None:
    """Every sixth pixel's centre lies on the diagonal of a quad."""
    floor = Floor(size=12)
    white = ph.Material("diffuse", color=(1, 1, 1))
    flat = quad(*(turn @ np.array([(-9, 0, 9), (18, 0, 0), (0, 0, -18)]).T).T, white)
    level = floor.camera()
    camera = replace(level, eye=turn @ level.eye, up=turn @ level.up)
    scene = ph.Scene([flat], camera=camera, background=WHITE)
    np.testing.assert_allclose(floor.shown(ph.prepare(scene), spp=64), 1, rtol=1e-6)


SLANTED = ph.Light("directional", direction=(-1, -1.5, 0.7), irradiance=(np.pi,) * 3)
TOWARD_SLANTED = np.array([1, 1.5, -0.7]) / np.linalg.norm([1, 1.5, -0.7])


def constant_texture(value: Sequence[float]) -> ph.Texture:
    return ph.Texture("image", image=np.full((2, 2, 3), value, np.float32))


def test_a_flat_normal_map_changes_nothing() -> None:
    floor = Floor()
    flat = ph.Material("diffuse", color=(1, 1, 1), normal_map=constant_texture((0.5, 0.5, 1)))
    a, b = (floor.render(material=m, lights=[SLANTED], spp=1) for m in (None, flat))
    np.testing.assert_allclose(a, TOWARD_SLANTED[1], rtol=1e-6)
    np.testing.assert_allclose(b, a, rtol=1e-6)


@pytest.mark.parametrize("normal", [(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.2, 0.5, 0.7)])
def test_a_normal_map_turns_the_normal(normal: Sequence[float]) -> None:
    """Its red along u, which is x; its green along v, which is -z here."""
    n = np.array(normal) / np.linalg.norm(normal)
    material = ph.Material(
        "diffuse", color=(1, 1, 1), normal_map=constant_texture(tuple(0.5 + 0.5 * n))
    )
    expected = n[0] * TOWARD_SLANTED[0] + n[2] * TOWARD_SLANTED[1] - n[1] * TOWARD_SLANTED[2]
    pixels = Floor().render(material=material, lights=[SLANTED], spp=1)
    np.testing.assert_allclose(pixels, expected, rtol=1e-5)


@pytest.mark.parametrize("turns", [(3, 0), (0, 2), (2, -1)])
@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_a_bump_map_of_a_plane_wave(turns: tuple[int, int], scale: float) -> None:
    floor, size, height = Floor(size=16, side=2 * scale, extent=9 * scale), 256, 0.03 * scale
    at = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(at, at[::-1])
    image = (1 + np.sin(2 * np.pi * (turns[0] * u + turns[1] * v))).astype(np.float32)
    pixels = np.repeat(image[..., None], 3, -1) * height
    texture = ph.Texture("image", image=pixels, filter="bilinear")
    material = ph.Material("diffuse", color=(1, 1, 1), bump_map=texture)
    pixels = floor.render(material=material, lights=[SLANTED], spp=1, height=0.2 * scale)[..., 0]
    p = floor.points()
    x, y = p[..., 0] / floor.side + 0.5, -p[..., 2] / floor.side + 0.5
    slope = height * 2 * np.pi * np.cos(2 * np.pi * (turns[0] * x + turns[1] * y)) / floor.side
    n = np.stack([-slope * turns[0], np.ones_like(slope), slope * turns[1]], axis=-1)
    expected = np.maximum(n @ TOWARD_SLANTED / np.linalg.norm(n, axis=-1), 0)
    assert np.ptp(expected) > 0.1
    np.testing.assert_allclose(pixels, expected, atol=0.02)


# --- Holes, blends and sides -------------------------------------------------------------------


HALF = ph.Material("diffuse", color=(0, 0, 0), opacity=0.5)
FILTER = ph.Material("null", color=(0.5, 0.5, 0.5))


def test_half_a_sheet_lets_half_of_a_point_light_through() -> None:
    light = ph.Light("point", position=(0.2, 1.5, 0.1), intensity=(3, 3, 3))
    floor = Floor()
    free = floor.render(lights=[light], spp=1)
    np.testing.assert_array_equal(floor.render(sheet(0.5, HALF), lights=[light], spp=1), free / 2)
    two = floor.render(sheet(0.5, HALF), sheet(0.6, HALF), lights=[light], spp=1)
    np.testing.assert_array_equal(two, free / 4)


def test_clear_sheets_tint_what_goes_through() -> None:
    """To the light and to the camera, which counts neither as a bounce."""
    light = ph.Light("point", position=(0.2, 1.5, 0.1), intensity=(3, 3, 3))
    floor = Floor()
    free = floor.render(lights=[light], spp=1)
    blue = sheet(0.5, ph.Material("null", color=(0.5, 0.25, 1)))
    seen = floor.render(blue, sheet(0.6, blue.material), lights=[light], spp=1)
    np.testing.assert_allclose(seen, free * [0.25, 0.0625, 1], rtol=1e-6)
    own = replace(blue, colors=[[1, 0.5, 0.25]] * 2)
    above = floor.render(own, lights=[light], height=1.0, spp=1)
    np.testing.assert_allclose(above, free * [1, 0.25, 0.0625], rtol=1e-6)
    lit = replace(blue, material=ph.Material("null", emission=(1, 2, 3), two_sided_emission=True))
    above = floor.render(lit, lights=[light], height=1.0, spp=4096, max_depth=1)
    np.testing.assert_allclose(above, np.broadcast_to([1, 2, 3], above.shape), rtol=1e-6)


@pytest.mark.parametrize("sky", ["constant", "envmap", "lamp"])
@pytest.mark.parametrize("half", [HALF, FILTER], ids=["holes", "clear"])
def test_half_a_sheet_lets_half_of_the_light_through(half: ph.Material, sky: str) -> None:
    """Found by scattering, by asking, and by both."""
    floor = Floor()
    lamp = quad((-0.8, 1.5, -0.6), (1.6, 0, 0), (0, 0, 1.2), LAMP)
    background = {"constant": WHITE, "envmap": FURNACES["light samples"], "lamp": DARK}[sky]
    shapes = [lamp] if sky == "lamp" else []
    light = 2 * surface_irradiance(floor, quad_surface(lamp)) if shapes else np.array(np.pi)
    runs = floor.runs(sheet(0.4, half), *shapes, background=background, spp=256)
    # the sheet ends far away, where a floor sees 2e-4 of the sky
    assert_lit(runs, light / 2, rounding=1e-3)


def test_a_lamp_with_holes_gives_in_proportion() -> None:
    floor = Floor()
    lamp = quad(
        (-0.8, 1.0, -0.6),
        (1.6, 0, 0),
        (0, 0, 1.2),
        ph.Material("diffuse", color=(0, 0, 0), emission=(2, 2, 2), opacity=0.25),
    )
    expected = 0.5 * surface_irradiance(floor, quad_surface(lamp))
    assert_lit(floor.runs(lamp, spp=256), expected, rounding=1e-3)


def test_opacity_texture() -> None:
    """Seen from above, a sheet of four fields over a floor that shines."""
    image = np.array([[1.0, 0.25], [0.0, 0.75]], np.float32)
    texture = ph.Texture("image", image=image, filter="nearest")
    cut = quad(
        (-1, 0.5, 1),
        (2, 0, 0),
        (0, 0, -2),
        ph.Material("emissive", radiance=(1, 1, 1), opacity=texture),
    )
    floor = Floor(size=2)
    runs = floor.runs(cut, material=BLACK, height=1.0, spp=256)
    assert mean_p(runs, image, 0.0) > SIGNIFICANCE
    np.testing.assert_allclose(runs.mean(axis=0), image, atol=0.02)
    # and what it lets through of a sun, texel by texel
    sun = ph.Light("directional", irradiance=(np.pi,) * 3)
    lit = floor.render(
        quad((-1, 0.5, 1), (2, 0, 0), (0, 0, -2), ph.Material("diffuse", opacity=texture)),
        lights=[sun],
        spp=1,
    )[..., 0]
    np.testing.assert_allclose(lit, 1 - image, rtol=1e-6)


@pytest.mark.parametrize("weight", [0.0, 1.0, 0.3])
def test_blend(weight: float) -> None:
    floor = Floor(size=4)
    a, b = ph.Material("diffuse", color=(0.8, 0, 0)), ph.Material("diffuse", color=(0.2, 0, 0))
    both = ph.Material("blend", a=a, b=b, weight=weight)
    light = [ph.Light("directional", irradiance=(np.pi,) * 3)]
    runs = floor.runs(material=both, lights=light, spp=64, sampler="independent")
    expected = np.full((4, 4), 0.8 * (1 - weight) + 0.2 * weight)
    if weight in (0, 1):
        alone = floor.render(material=(a, b)[int(weight)], lights=light, spp=64)[..., 0]
        np.testing.assert_array_equal(runs, np.broadcast_to(alone, runs.shape))
    else:
        assert mean_p(runs, expected, 0.0) > SIGNIFICANCE
        np.testing.assert_allclose(runs.mean(), expected[0, 0], rtol=0.02)


def test_blend_by_a_texture_of_blends() -> None:
    floor = Floor(size=2)
    white, black = (ph.Material("diffuse", color=(c,) * 3) for c in (1.0, 0.0))
    half = ph.Material("blend", a=white, b=black, weight=0.5)
    image = np.array([[0.0, 1.0], [0.5, 0.2]], np.float32)
    texture = ph.Texture("image", image=image, filter="nearest")
    material = ph.Material("blend", a=white, b=half, weight=texture)
    runs = floor.runs(
        material=material, lights=[ph.Light("directional", irradiance=(np.pi,) * 3)], spp=256
    )
    assert mean_p(runs, 1 - image / 2, 1e-6) > SIGNIFICANCE
    np.testing.assert_allclose(runs.mean(axis=0), 1 - image / 2, atol=0.03)


def test_sides() -> None:
    """The floor's back, seen from below and lit from there."""
    light = ph.Light("directional", direction=(0, 1, 0), irradiance=(np.pi,) * 3)
    floor = Floor(size=2)

    def below(**more: Any) -> np.ndarray:
        camera = ph.Camera(
            eye=(0, -1, 0), target=(0, 0, 0), up=(0, 0, -1), projection="orthographic", height=2
        )
        shape = floor.mesh(ph.Material("diffuse", color=(0.5, 0.5, 0.5), **more))
        scene = ph.Scene([shape], camera=camera, background=DARK, lights=[light])
        return picture(scene, width=2, height=2, spp=1)

    np.testing.assert_allclose(below(), 0.5, rtol=1e-6)
    assert not np.any(below(two_sided=False))
    back = ph.Material("diffuse", color=(0.1, 0.2, 0.3))
    expected = np.broadcast_to(np.float32([0.1, 0.2, 0.3]), (2, 2, 3))
    np.testing.assert_allclose(below(back=back), expected, rtol=1e-6)
    # and neither lets light through
    above = floor.render(material=ph.Material("diffuse", back=back), lights=[light], spp=1)
    assert not np.any(above)


# --- Textures on meshes ------------------------------------------------------------------------


def colored(material: ph.Material, **more: Any) -> np.ndarray:
    """The floor's own colours: in a white sky, of albedo alone."""
    settings = {"spp": 1, **more}
    return Floor(size=4).render(material=material, background=WHITE, **settings)


def test_images_stand_upright() -> None:
    image = np.random.default_rng(6).uniform(0, 1, (4, 4, 3)).astype(np.float32)
    texture = ph.Texture("image", image=image, filter="nearest")
    np.testing.assert_allclose(colored(ph.Material("diffuse", color=texture)), image, rtol=1e-5)


@pytest.mark.parametrize(
    ("wrap", "order"),
    [
        ("repeat", [1, 0, 1, 0]),
        ("mirror", [0, 0, 1, 1]),
        ("clamp", [0, 0, 1, 1]),
        ("zero", [None, 0, 1, None]),
    ],
)
def test_wrap(wrap: str, order: list[int | None]) -> None:
    """Two texels over the middle half of the picture."""
    image = np.array([[0.2, 0.9]], np.float32)
    texture = ph.Texture(
        "image",
        image=image,
        filter="nearest",
        wrap_u=wrap,
        wrap_v="clamp",
        transform=[[2, 0, -0.5], [0, 2, -0.5]],
    )
    pixels = colored(ph.Material("diffuse", color=texture))[..., 0]
    expected = [0.0 if i is None else image[0, i] for i in order]
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, (4, 4)), rtol=1e-5)


def test_levels_of_an_image_have_its_mean() -> None:
    image = np.random.default_rng(7).uniform(0, 1, (64, 64, 3)).astype(np.float32)
    means = []
    for choice in ("mip", "bilinear", "nearest"):
        texture = ph.Texture("image", image=image, filter=choice)
        pixels = colored(ph.Material("diffuse", color=texture), spp=256, filter_radius=0.5)
        means.append(pixels.mean(axis=(0, 1)))
    for mean in means:
        np.testing.assert_allclose(mean, image.mean(axis=(0, 1)), rtol=0.02)


def test_attributes() -> None:
    rng = np.random.default_rng(8)
    corner, face = rng.uniform(0, 1, (3, 3)), rng.uniform(0, 1, (1, 3))
    vertices = np.array([[-3.0, 0, 2], [3, 0, 2], [0, 0, -4]])
    floor = Floor(size=4)
    p = floor.points()
    # barycentric weights in x and z
    m = np.stack([vertices[:, 0], vertices[:, 2], np.ones(3)])
    weights = np.einsum(
        "ij,...j->...i", np.linalg.inv(m), p[..., [0, 2, 2]] * [1, 1, 0] + [0, 0, 1]
    )
    for name, expected in (
        ("vertex_tint", weights @ corner),
        ("face_tint", np.broadcast_to(face[0], p.shape)),
        ("vertex_grey", np.repeat((weights @ corner[:, 0])[..., None], 3, -1)),
        ("missing", np.zeros_like(p)),
    ):
        mesh = ph.Mesh(
            vertices,
            [[0, 1, 2]],
            material=ph.Material("diffuse", color=ph.Texture("attribute", name=name)),
            attributes={
                "vertex_tint": corner,
                "face_tint": face,
                "vertex_grey": corner[:, 0],
            },
        )
        scene = ph.Scene([mesh], camera=floor.camera(), background=WHITE)
        pixels = picture(scene, width=4, height=4, spp=1, max_depth=2)
        np.testing.assert_allclose(pixels, expected, atol=1e-5)


@pytest.mark.parametrize("frame", ["uv", "right_handed"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_green_of_a_normal_map(frame: str, mirrored: bool) -> None:
    """Along v, or along normal x u, which are opposites where uv are mirrored."""
    floor, normal = Floor(), np.array([0.0, 0.6, 0.8])
    mesh = floor.mesh()
    uvs = np.asarray(mesh.uvs) * ([1, -1] if mirrored else [1, 1])
    material = ph.Material(
        "diffuse",
        color=(1, 1, 1),
        normal_map=constant_texture((normal + 1) / 2),
        normal_map_frame=frame,
    )
    scene = ph.Scene(
        [replace(mesh, uvs=uvs, material=material)],
        camera=floor.camera(),
        background=DARK,
        lights=[SLANTED],
    )
    # v is -z in the picture's plane, unless mirrored; normal x u is -z always
    along_v = 1.0 if mirrored and frame == "uv" else -1.0
    expected = np.array([0, normal[2], along_v * normal[1]]) @ TOWARD_SLANTED
    pixels = picture(scene, width=4, height=4, spp=1, max_depth=2)
    np.testing.assert_allclose(pixels, expected, rtol=1e-5)


@pytest.mark.parametrize("degrees", [0.0, 50.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("way", ["plain", "instance", "mirrored", "inside out", "no uvs"])
def test_tangents_of_a_mesh(degrees: float, side: float, way: str) -> None:
    """They do to a normal map what uvs of that direction do, and have that known result."""
    floor, normal = Floor(), np.array([0.6, 0.3, 0.742])
    normal /= np.linalg.norm(normal)
    mesh = floor.mesh()
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    material = ph.Material(
        "diffuse", color=(1, 1, 1), normal_map=constant_texture((normal + 1) / 2)
    )
    # u along (c, 0, -s); the mesh's normal is y, so y x u is (-s, 0, -c)
    corners = np.asarray(mesh.vertices)
    along, across = np.array([c, 0, -s]), side * np.array([-s, 0, -c])
    turned = replace(
        mesh, material=material, uvs=np.stack([corners @ along, corners @ across], axis=1)
    )
    given = replace(
        mesh,
        material=material,
        uvs=None if way == "no uvs" else mesh.uvs,
        tangents=np.tile([*(3.0 * along), side], (len(corners), 1)),
    )
    expected = (along * normal[0] + across * normal[1] + [0, normal[2], 0]) @ TOWARD_SLANTED
    shapes: list[Any] = [turned, given]
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    if way == "inside out":  # turned around twice
        faces = np.asarray(mesh.faces)[:, ::-1]
        shapes = [replace(m, faces=faces, inside_out=True) for m in shapes]
        shapes[1] = replace(shapes[1], tangents=shapes[1].tangents * [1, 1, 1, -1])
    elif way in ("instance", "mirrored"):
        matrix = mirror if way == "mirrored" else np.eye(4)
        shapes = [ph.Instances((m,), [matrix]) for m in shapes]
        if way == "mirrored":
            along, across = along * [-1, 1, 1], across * [-1, 1, 1]
            expected = (along * normal[0] + across * normal[1] + [0, normal[2], 0]) @ TOWARD_SLANTED
    for shape in shapes:
        scene = ph.Scene([shape], camera=floor.camera(), background=DARK, lights=[SLANTED])
        pixels = picture(scene, width=4, height=4, spp=1, max_depth=2)
        np.testing.assert_allclose(pixels, max(expected, 0.0), rtol=1e-5, atol=1e-6)


def test_tangents_turn_anisotropy() -> None:
    """As uvs of that direction do."""
    floor = Floor()
    metal = ph.Material("principled", metallic=1.0, roughness=0.4, anisotropy=0.9)
    mesh = replace(floor.mesh(), material=metal)
    corners = np.asarray(mesh.vertices)
    along, across = np.array([0.8, 0, -0.6]), np.array([-0.6, 0, -0.8])
    turned = replace(mesh, uvs=np.stack([corners @ along, corners @ across], axis=1))
    given = replace(mesh, tangents=np.tile([*along, 1.0], (len(corners), 1)))
    pixels = [
        picture(
            ph.Scene([m], camera=floor.camera(), background=DARK, lights=[SLANTED]),
            width=4, height=4, spp=1, max_depth=2,
        )
        for m in (mesh, turned, given)
    ]  # fmt: skip
    np.testing.assert_allclose(pixels[2], pixels[1], rtol=1e-4)
    assert np.abs(pixels[1] / pixels[0] - 1).min() > 0.05


def test_textures_are_cut_to_their_parameters_range() -> None:
    image = np.array([[[5.0, 0.5, -1.0]]], np.float32)
    texture = ph.Texture("image", image=image, filter="nearest")
    pixels = colored(ph.Material("diffuse", color=texture))
    np.testing.assert_allclose(pixels, np.broadcast_to([1, 0.5, 0], pixels.shape), rtol=1e-5)
    lamp = Floor(size=2).render(material=ph.Material("diffuse", color=(0, 0, 0), emission=texture))
    np.testing.assert_allclose(lamp, np.broadcast_to([5, 0.5, 0], lamp.shape), rtol=1e-5)
    dim = ph.Background("envmap", image=np.full((2, 4, 3), -1, np.float32))
    assert not np.any(picture(ph.Scene([], camera=ph.Camera(), background=dim), width=2, height=2))


def test_textured_radiance() -> None:
    """Of an emissive material, seen and asked for from both sides."""
    image = np.array([[1.0, 3.0]], np.float32)
    texture = ph.Texture("image", image=image, filter="nearest")
    lamp = ph.Material("emissive", radiance=texture)
    seen = Floor(size=2).render(material=lamp, spp=1)
    np.testing.assert_allclose(seen[..., 0], np.broadcast_to([1, 3], (2, 2)), rtol=1e-5)
    floor = Floor()
    for front in (1.0, -1.0):
        shape = quad((-0.5 * front, 1.0, -0.5), (front, 0, 0), (0, 0, 1), lamp)
        light = floor.runs(shape, spp=64).mean()
        twice = replace(shape, material=ph.Material("emissive", radiance=(2, 2, 2)))
        np.testing.assert_allclose(light, floor.runs(twice, spp=64).mean(), rtol=0.02)


def test_textures_of_textures() -> None:
    rng = np.random.default_rng(13)
    a, b, w = (rng.uniform(0, 1, (4, 4, n)).astype(np.float32) for n in (3, 3, 1))
    one, other, share = (ph.Texture("image", image=x, filter="nearest") for x in (a, b, w))
    red = ph.Texture("image", image=a, filter="nearest", channel="r")
    turned_over = ph.Texture(
        "image", image=a, filter="nearest", transform=[[1, 0, 0], [0, -1, 1]], wrap_v="clamp"
    )
    for texture, expected in (
        (ph.Texture("multiply", color0=one, color1=other), a * b),
        (ph.Texture("multiply", color0=one, color1=(0.5, 1, 0.25)), a * [0.5, 1, 0.25]),
        (ph.Texture("mix", color0=one, color1=other, weight=share), a + (b - a) * w),
        (ph.Texture("mix", color0=one, color1=other, weight=red), a + (b - a) * a[..., :1]),
        (ph.Texture("mix", color0=one, color1=turned_over, weight=0.25), 0.75 * a + 0.25 * a[::-1]),
        (red, np.repeat(a[..., :1], 3, -1)),
        (
            ph.Texture(
                "multiply", color0=ph.Texture("multiply", color0=one, color1=one), color1=b[0, 0]
            ),
            a * a * b[0, 0],
        ),
    ):
        np.testing.assert_allclose(
            colored(ph.Material("diffuse", color=texture)), expected, rtol=1e-5
        )


def test_bump_map_of_textures() -> None:
    """Heights times a number are those of a map that is that much higher."""
    image = np.random.default_rng(14).uniform(0, 0.2, (16, 16)).astype(np.float32)
    plain = ph.Texture("image", image=image / 2, filter="bilinear")
    twice = ph.Texture("image", image=image, filter="bilinear")
    halved = ph.Texture("multiply", color0=twice, color1=(0.5, 0.5, 0.5))
    pictures = [
        Floor(size=16).render(
            material=ph.Material("diffuse", color=(1, 1, 1), bump_map=t), lights=[SLANTED], spp=1
        )
        for t in (plain, halved)
    ]
    assert np.ptp(pictures[0]) > 0.1
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-4, atol=1e-5)


def test_uvs_of_an_attribute() -> None:
    """A second set of uvs, a quarter turn from the first, and one by vertex times an image."""
    image = np.random.default_rng(15).uniform(0, 1, (4, 4, 3)).astype(np.float32)
    floor = Floor(size=4)
    mesh = floor.mesh()
    uvs = np.asarray(mesh.uvs)
    other = np.stack([uvs[:, 1], 1 - uvs[:, 0]], axis=1)
    tint = np.tile([0.5, 0.25, 1.0], (4, 1))
    texture = ph.Texture("image", image=image, filter="nearest", uvs="vertex_other")
    for color, expected in (
        (texture, np.rot90(image)),
        (
            ph.Texture(
                "multiply", color0=texture, color1=ph.Texture("attribute", name="vertex_tint")
            ),
            np.rot90(image) * tint[0],
        ),
    ):
        material = ph.Material("diffuse", color=color)
        turned_mesh = replace(
            mesh, material=material, attributes={"vertex_other": other, "vertex_tint": tint}
        )
        scene = ph.Scene([turned_mesh], camera=floor.camera(), background=WHITE)
        pixels = picture(scene, width=4, height=4, spp=1, max_depth=2)
        np.testing.assert_allclose(pixels, expected, rtol=1e-5)


# --- Instances ---------------------------------------------------------------------------------


def statue() -> ph.Mesh:
    """Some triangles whose coordinates are short fractions."""
    vertices = np.round(np.random.default_rng(9).uniform(-1, 1, (60, 3)) * 256) / 256
    return ph.Mesh(vertices, np.arange(60).reshape(-1, 3), material=ph.Material("diffuse"))


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
    thin = ph.Material("principled", color=(0.5, 0.8, 0.9), opacity=0.8)
    group = [
        statue(),
        ball(6, 8, thin),
        quad((0, 0, 0), (0.5, 0, 0), (0.2, 0.4, 0), LAMP),
        ph.Cylinders([[0, 0, 0]], [[0, 0, 0.8]], 0.2, material=LAMP),
    ]
    water = glass(1, 1.33, absorption=(0.5, 0.1, 0.1))
    return ph.Scene(
        [
            Floor().mesh(ph.Material("blend", a=ph.Material("plastic"), b=bumpy, weight=0.4)),
            ph.Instances(group, matrices),
            ph.Spheres(rng.uniform((-1, 0, -1), (1, 1, 1), (6, 3)), 0.4, water),
            ph.Spheres(rng.uniform((-1, 0, -1), (1, 1, 1), (6, 3)), 0.3, glass(2, 1.5)),
            lamps(50)[0],
        ],
        camera=ph.Camera(eye=(2, 2, 4), target=(0, 0.5, 0), vfov=35),
        background=ph.Background("envmap", image=image),
        lights=[ph.Light("point", position=(0, 3, 0), intensity=(4, 4, 4))],
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


# --- White furnaces ----------------------------------------------------------------------------

# What every material is that gives back all light; `emissive` scatters none.
WHITENESS: dict[str, dict[str, Any]] = {
    "diffuse": {"color": (1, 1, 1)},
    "metal": {"color": (1, 1, 1), "fuzz": 0.4},
    "dielectric": {"roughness": 0.0},
    "conductor": {"roughness": 0.4},
    "thin_dielectric": {},
    "plastic": {"color": (1, 1, 1)},
    "principled": {"color": (1, 1, 1), "specular": 0.0},
    "null": {},
    "diffuse_transmission": {"color": (0.3, 0.3, 0.3), "transmittance": (0.7, 0.7, 0.7)},
}


def test_the_furnaces_know_every_material() -> None:
    assert WHITENESS.keys() == tables()["materials"].keys() - {"emissive"}


@pytest.mark.parametrize("sky", FURNACES)
@pytest.mark.parametrize("name", WHITENESS)
def test_a_white_scene_in_a_white_sky_is_white(name: str, sky: str) -> None:
    """Spheres and a mesh that reflect one another, and one way or another all of the sky."""
    material = ph.Material(name, **WHITENESS[name])
    shapes = [
        ph.Spheres([[-0.5, 0, 0], [0.5, 0, 0], [0, 0.8, 0.2]], 0.45, material),
        box((-1, -0.8, -0.6), (1, -0.5, 0.6), material),
    ]
    camera = ph.Camera(eye=(0, 1, 4), target=(0, 0, 0), vfov=30)
    runs = scene_runs(
        ph.Scene(shapes, camera=camera, background=FURNACES[sky]),
        width=12,
        height=12,
        spp=64,
        max_depth=300,
    )[..., 0]
    assert mean_p(runs.mean(axis=(1, 2)), np.array(1.0), 1e-4) > sidak(2 * len(WHITENESS))
    np.testing.assert_allclose(runs.mean(), 1, atol=5e-3)
