"""A white floor seen from just above, whose light is known, and shapes to put over it.

Nothing stands between the camera and the floor, and paths have two rays. What the floor must show
is computed from formulas, or from a sum over surfaces, in double precision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import parhelion as ph
from statistics_tools import SIGNIFICANCE, mean_p

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


def moved(matrix: np.ndarray, offset: Sequence[float]) -> np.ndarray:
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = matrix, offset
    return m


# dark but for its own light; its back is dark altogether
LAMP = ph.Material("diffuse", color=(0, 0, 0), emission=(2, 2, 2))

PLACES = {
    "turned": moved(turned((1, 0.3, 0), 130), (0.2, 1.2, 0.1)),
    "stretched": moved(turned((1, 0.3, 0), 130) @ np.diag([1.5, 0.5, 0.8]), (0.2, 1.2, 0.1)),
    "sheared": moved(
        turned((1, 0.3, 0), 130) @ [[1, 0.6, 0], [0, 1, -0.3], [0, 0, 1]], (0.2, 1.4, 0.1)
    ),
    "mirrored": moved(turned((1, 0.3, 0), 130) @ np.diag([-1.0, 0.6, 1]), (0.2, 1.2, 0.1)),
}


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


def glass(priority: int, ior: float, **more: Any) -> ph.Material:
    return ph.Material("dielectric", ior=ior, priority=priority, **more)


def steep_normals(seed: int = 5, size: int = 16) -> ph.Texture:
    """A new normal in every texel, some lying in the surface and some below it."""
    rng = np.random.default_rng(seed)
    image = rng.uniform(0, 1, (size, size, 3)).astype(np.float32)
    return ph.Texture("image", image=image, filter="nearest")


FURNACES = {
    "scattering": WHITE,
    "light samples": ph.Background("envmap", image=np.ones((4, 8, 3), np.float32)),
}


def statue() -> ph.Mesh:
    """Some triangles whose coordinates are short fractions."""
    vertices = np.round(np.random.default_rng(9).uniform(-1, 1, (60, 3)) * 256) / 256
    return ph.Mesh(vertices, np.arange(60).reshape(-1, 3), material=ph.Material("diffuse"))
