"""Scenes whose radiance is known in closed form, and the estimators that must agree on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core
from parhelion.flatten import block
from statistics_tools import SIGNIFICANCE, frame_around, mean_p, sidak

BLACK = ph.Background("constant", radiance=(0, 0, 0))
ALBEDO = np.array([0.9, 0.5, 0.2])


@dataclass(frozen=True)
class Look:
    """A square pinhole picture from (0, 0, distance) along -z, of pixel centres alone."""

    distance: float = 4.0
    vfov: float = 32.0
    size: int = 24

    def directions(self) -> np.ndarray:
        """(size, size, 3) unit directions of the pixel centres, in double."""
        step = 2 * np.tan(np.radians(self.vfov) / 2) / self.size
        at = (np.arange(self.size) - (self.size - 1) / 2) * step
        x, y = np.meshgrid(at, -at)
        d = np.stack([x, y, -np.ones_like(x)], axis=-1)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def unit_sphere(self) -> tuple[np.ndarray, np.ndarray]:
        """Which pixels see well within the unit sphere at the origin, and its normals there."""
        d = self.directions()
        b = d[..., 2] * -self.distance
        discriminant = b * b - (self.distance**2 - 1)
        seen = discriminant > 0.01
        t = b - np.sqrt(np.maximum(discriminant, 0))
        return seen, np.array([0, 0, self.distance]) + t[..., None] * d

    def render(self, *shapes: ph.Spheres, background=BLACK, lights=(), **settings):
        scene = ph.Scene(
            shapes,
            background=background,
            lights=lights,
            camera=ph.Camera(eye=(0, 0, self.distance), target=(0, 0, 0), vfov=self.vfov),
        )
        settings = {"spp": 16, "threads": 1, **settings}
        return ph.render(
            scene,
            width=self.size,
            height=self.size,
            filter="box",
            filter_radius=1e-6,
            **settings,
        ).numpy()

    def runs(self, *shapes: ph.Spheres, count: int = 8, **settings):
        """(count, size, size, 3): pictures of as many seeds."""
        return np.stack([self.render(*shapes, seed=s, **settings) for s in range(count)])


def diffuse_sphere() -> ph.Spheres:
    return ph.Spheres([[0, 0, 0]], 1.0, ph.Material("diffuse", color=tuple(ALBEDO)))


def lamp(center: tuple[float, float, float], radius: float, radiance: np.ndarray) -> ph.Spheres:
    return ph.Spheres([center], radius, ph.Material("emissive", radiance=tuple(radiance)))


def irradiance(normal: np.ndarray, center: np.ndarray, radius: float) -> tuple[np.ndarray, ...]:
    """Of points of the unit sphere by a spherical lamp of radiance 1: pi (R / d)^2 cos.

    Also says where it holds: where the whole lamp is above the horizon.
    """
    offset = center - normal
    d = np.linalg.norm(offset, axis=-1)
    cosine = np.sum(normal * offset, axis=-1) / d
    whole = np.arccos(np.clip(cosine, -1, 1)) + np.arcsin(radius / d) < np.pi / 2 - 1e-3
    return np.pi * (radius / d) ** 2 * cosine, whole


# centre and radius of the lamp: far, near and large, behind the viewer, a pinpoint
LAMPS = [
    ((3.0, 2.0, 3.0), 0.5),
    ((1.4, 0.6, 1.2), 0.6),
    ((-1.0, 1.0, 9.0), 3.0),
    ((-2.0, 2.5, 1.0), 0.01),
    ((0.0, 300.0, 300.0), 1.0),
]


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize(("center", "radius"), LAMPS)
def test_lit_sphere_against_the_closed_form(center, radius, sampler) -> None:
    radiance = np.array([5.0, 4.0, 3.0]) / min(radius, 1.0) ** 2
    look = Look()
    runs = look.runs(diffuse_sphere(), lamp(center, radius, radiance), spp=32, sampler=sampler)
    seen, normal = look.unit_sphere()
    e, whole = irradiance(normal, np.array(center), radius)
    # the near lamp stands in front of part of the sphere
    d, offset = look.directions(), np.array(center) - [0, 0, look.distance]
    beside = np.linalg.norm(np.cross(d, offset), axis=-1) > 1.01 * radius
    compared = seen & whole & (beside | (np.dot(d, offset) < 0))
    assert compared.sum() > 60
    expected = ALBEDO * radiance * e[compared, None] / np.pi
    # The three channels are one estimate, so one of them is tested; float32 adds some 1e-6.
    assert mean_p(runs[:, compared, 0], expected[:, 0], 1e-5) > sidak(2 * len(LAMPS))
    whole_picture = runs[:, compared, 0].mean(axis=1)
    assert mean_p(whole_picture, expected[:, 0].mean(), 1e-5) > sidak(2 * len(LAMPS))
    assert abs(whole_picture.mean() / expected[:, 0].mean() - 1) < 5e-3
    np.testing.assert_allclose(
        runs[:, compared] / runs[:, compared, :1],
        np.broadcast_to((ALBEDO * radiance / (ALBEDO * radiance)[0]), runs[:, compared].shape),
        rtol=1e-5,
    )


@pytest.mark.parametrize("samples", [1, 16])
def test_a_small_light_makes_no_fireflies(samples: int) -> None:
    """Every single sample of a pinpoint light is close to the mean: nothing else has the chance."""
    look = Look()
    center, radius = (-2.0, 2.5, 1.0), 0.002
    radiance = np.full(3, 1e6)
    pixels = look.render(diffuse_sphere(), lamp(center, radius, radiance), spp=samples)
    seen, normal = look.unit_sphere()
    e, whole = irradiance(normal, np.array(center), radius)
    expected = ALBEDO * radiance * e[..., None] / np.pi
    # The cosine varies by some R / d = 1e-3 over the light.
    assert np.all(np.abs(pixels / expected - 1)[seen & whole & (e > 1e-2 * e.max())] < 0.02)
    assert pixels.max() < 1.02 * expected[seen & whole].max()


def test_a_small_light_on_blurred_metal_makes_no_fireflies() -> None:
    look = Look(size=16)
    metal = ph.Spheres([[0, 0, 0]], 1.0, ph.Material("metal", color=(1, 1, 1), fuzz=0.5))
    light = lamp((-2.0, 2.5, 1.0), 0.02, np.full(3, 1e4))
    few = look.render(metal, light, spp=16)
    many = look.render(metal, light, spp=1024, seed=1)
    # The lobe has a pole at its limb, so single pixels may differ, none by much.
    assert few.max() < 3 * many.max()
    assert abs(few.mean() / many.mean() - 1) < 0.1


# --- Multiple importance sampling --------------------------------------------------------------


@cache
def strata(side: int) -> list[np.ndarray]:
    """Random points of a square, one in each of side x side parts: u, cos 2 pi v and sin 2 pi v.

    In arrays, (3, N), that the processor's caches hold.
    """
    rng = np.random.default_rng(1)
    i, j = np.indices((side, side)).reshape(2, -1)
    share = (i + rng.random(i.size)) / side
    angle = 2 * np.pi * (j + rng.random(i.size)) / side
    return np.array_split(np.stack([share, np.cos(angle), np.sin(angle)]), side // 8, axis=1)


def metal_radiance(
    fuzz: float, normal: np.ndarray, toward_eye: np.ndarray, center: np.ndarray, radius: float
) -> float:
    """The integral of the metal's f cos over the lamp's cone, by quadrature: 1000 x 1000 points."""
    offset = center - normal
    d = np.linalg.norm(offset)
    spread = 1 - np.sqrt(1 - (radius / d) ** 2)
    surface = frame_around(normal)
    material = block("materials", "metal", {"color": (1, 1, 1), "fuzz": fuzz}, "test")
    wo, turn = surface @ toward_eye, frame_around(offset / d) @ surface.T
    values = []
    for share, cos, sin in strata(1000):
        u = spread * share
        r = np.sqrt(u * (2 - u))
        wi = (np.stack([r * cos, r * sin, 1 - u], axis=1) @ turn).astype(np.float32)
        values.append(_core.bsdf_eval(material, wo, wi)[0][:, 0])
    return float(np.concatenate(values).mean() * 2 * np.pi * spread)


def metal_sphere(fuzz: float) -> ph.Spheres:
    return ph.Spheres([[0, 0, 0]], 1.0, ph.Material("metal", color=(1, 1, 1), fuzz=fuzz))


@pytest.mark.parametrize("fuzz", [0.3, 1.0])
@pytest.mark.parametrize(("center", "radius"), [((2.0, 1.5, 3.0), 1.2), ((3.0, 2.0, 3.0), 0.2)])
def test_metal_under_a_lamp_against_quadrature(center, radius, fuzz) -> None:
    look = Look(size=12)
    runs = look.runs(metal_sphere(fuzz), lamp(center, radius, np.ones(3)), spp=8192, count=6)[
        ..., 0
    ]
    seen, normal = look.unit_sphere()
    bright = seen & (runs.mean(axis=0) > 0.05 * runs.mean(axis=0)[seen].max())
    eye = -look.directions()
    expected = np.array(
        [
            metal_radiance(fuzz, n, w, np.array(center), radius)
            for n, w in zip(normal[bright], eye[bright], strict=True)
        ]
    )
    # the quadrature itself scatters, of single pixels by 0.5 to 2.5 %, where it meets the pole
    assert mean_p(runs[:, bright], expected, rounding=5e-3) > sidak(4)
    assert abs(runs[:, bright].mean() / expected.mean() - 1) < 1e-2


@pytest.mark.parametrize("fuzz", [0.02, 0.05, 0.3])
def test_metal_under_a_lamp_against_mirror_samples_alone(fuzz: float) -> None:
    """Where the lobe is sharp and the lamp large, light samples alone would be hopeless."""
    center, radius = np.array([2.0, 1.5, 3.0]), 1.2
    look = Look(size=12)
    light = lamp(tuple(center), radius, np.ones(3))
    runs = look.runs(metal_sphere(fuzz), light, spp=512, count=6)[..., 0]
    seen, normal = look.unit_sphere()
    bright = seen & (runs.mean(axis=0) > 1e-3)
    material = block("materials", "metal", {"color": (1, 1, 1), "fuzz": fuzz}, "test")
    count = 100_000
    shares = []
    for n, w in zip(normal[bright], -look.directions()[bright], strict=True):
        surface, offset = frame_around(n), center - n
        wi = _core.bsdf_sample(material, surface @ w, 1, count)[0] @ surface
        met = np.linalg.norm(np.cross(wi, offset), axis=1) < radius
        shares.append(np.mean(met & (wi @ offset > 0)))
    expected = np.array(shares)
    error = np.sqrt(expected * (1 - expected) / count) + 1e-4
    assert mean_p(runs[:, bright], expected, rounding=error / expected) > sidak(3)
    assert abs(runs[:, bright].mean() / expected.mean() - 1) < 5e-3


def test_roulette_and_light_sampling_change_no_mean() -> None:
    """Many dim bounces between spheres, with lights to sample and a sky that cannot be."""
    rng = np.random.default_rng(8)
    look = Look(size=12, vfov=25)
    shapes = [
        ph.Spheres(
            rng.uniform(-1, 1, (40, 3)),
            0.25,
            ph.Material("diffuse"),
            rng.uniform(0.1, 0.9, (40, 3)),
        ),
        ph.Spheres(rng.uniform(-1, 1, (10, 3)), 0.3, ph.Material("metal", fuzz=0.3)),
        ph.Spheres(rng.uniform(-1, 1, (10, 3)), 0.3, ph.Material("dielectric", color=(0.9,) * 3)),
        lamp((1.5, 1.5, 1.5), 0.3, np.full(3, 10.0)),
    ]
    sky = ph.Background("constant", radiance=(0.3, 0.4, 0.5))
    on, off = (
        look.runs(*shapes, background=sky, spp=64, roulette=r, count=12, max_depth=100)
        for r in (True, False)
    )
    assert not np.array_equal(on, off)
    a, b = on.mean(axis=(1, 2, 3)), off.mean(axis=(1, 2, 3))
    assert mean_p(a - b, np.array(0.0)) > SIGNIFICANCE
    assert abs(a.mean() / b.mean() - 1) < 0.01


def test_inside_a_lamp() -> None:
    """A lamp all around is a white furnace of its own; from inside, no light sample can find it."""
    look = Look(size=8)
    around = lamp((0, 0, 0), 50.0, np.ones(3))
    np.testing.assert_allclose(
        look.render(around, diffuse_sphere(), spp=4)[2:6, 2:6],
        np.broadcast_to(ALBEDO, (4, 4, 3)),
        rtol=1e-6,
    )


# --- Direct views ------------------------------------------------------------------------------


def test_a_lamp_is_as_bright_as_it_says() -> None:
    pixels = Look(size=8, vfov=10).render(lamp((0, 0, 0), 1.0, np.array([3.0, 0.25, 1e5])))
    np.testing.assert_array_equal(pixels, np.broadcast_to(np.float32([3, 0.25, 1e5]), (8, 8, 3)))


@pytest.mark.parametrize("up", [(0, 1, 0), (1.0, 0.5, -0.25)])
def test_gradient_background(up) -> None:
    horizon, zenith = np.array([1.0, 0.8, 0.2]), np.array([0.1, 0.4, 3.0])
    sky = ph.Background("gradient", horizon=tuple(horizon), zenith=tuple(zenith), up=up)
    look = Look(vfov=120)
    t = 0.5 * (1 + look.directions() @ (np.array(up) / np.linalg.norm(up)))[..., None]
    expected = horizon * (1 - t) + zenith * t
    np.testing.assert_allclose(look.render(background=sky, spp=1), expected, rtol=1e-5)


def test_gradient_seen_in_a_mirror_and_on_chalk() -> None:
    look = Look()
    seen, normal = look.unit_sphere()
    sky = ph.Background("gradient", horizon=(1, 1, 1), zenith=(0, 2, 4))
    d = look.directions()
    mirrored = d - 2 * np.sum(d * normal, axis=-1, keepdims=True) * normal
    ends = np.array([[1.0, 1.0, 1.0], [0.0, 2.0, 4.0]])

    def sky_at(height: np.ndarray) -> np.ndarray:
        t = (0.5 * (1 + height))[..., None]
        return ends[0] * (1 - t) + ends[1] * t

    metal = ph.Spheres([[0, 0, 0]], 1.0, ph.Material("metal", color=(1, 1, 1)))
    pixels = look.render(metal, background=sky, spp=1)
    np.testing.assert_allclose(pixels[seen], sky_at(mirrored[..., 1])[seen], rtol=2e-5, atol=2e-5)
    # the cosine-weighted mean of a direction's height over the hemisphere of n is 2/3 of n's
    runs = look.runs(diffuse_sphere(), background=sky, spp=64)
    expected = (ALBEDO * sky_at(2 / 3 * normal[..., 1]))[seen]
    assert mean_p(runs[:, seen, 2], expected[:, 2]) > SIGNIFICANCE


# --- Shadows and depth -------------------------------------------------------------------------


def test_a_blocked_light_is_black() -> None:
    look = Look(size=16)
    light = lamp((0, 6.0, 0), 0.5, np.full(3, 50.0))
    blocker = ph.Spheres([[0, 3.5, 0]], 1.2, ph.Material("emissive", radiance=(0, 0, 0)))
    seen, _ = look.unit_sphere()
    lit = look.render(diffuse_sphere(), light, max_depth=2)
    dark = look.render(diffuse_sphere(), light, blocker, max_depth=2)
    # Seen from the unit sphere, the blocker hides the lamp and all around it.
    assert lit[seen].max() > 0.1
    assert not np.any(dark[seen])


def test_a_shadow_ends_where_geometry_says() -> None:
    """On a floor below a lamp and a sphere: umbra, and the full light outside the penumbra."""
    floor = ph.Spheres([[0, -1000.0, 0]], 1000.0, ph.Material("diffuse", color=(0.5,) * 3))
    light = lamp((0, 4.0, 0), 0.1, np.full(3, 100.0))
    ball = ph.Spheres([[0, 2.0, 0]], 0.5, ph.Material("emissive", radiance=(0, 0, 0)))
    scene = ph.Scene(
        [floor, light, ball],
        background=BLACK,
        camera=ph.Camera(eye=(0, 1.2, 0), target=(0, 0, 0), up=(0, 0, 1), vfov=140.0),
    )
    size = 41
    pixels = ph.render(
        scene, width=size, height=size, spp=16, filter="box", filter_radius=1e-6, threads=1
    ).numpy()[..., 0]
    at = (np.arange(size) - (size - 1) / 2) * 2 * np.tan(np.radians(70)) / size * 1.2
    r = np.hypot(*np.meshgrid(at, at))
    # By similar triangles from the inner and the outer tangents of two spheres on one axis.
    reach = [4.0 * np.tan(np.arcsin((0.5 - s * 0.1) / 2.0)) - s * 0.1 for s in (1, -1)]
    umbra, penumbra = r < 0.9 * min(reach), (r > 1.15 * max(reach)) & (r < 3)
    assert umbra.sum() > 20
    assert penumbra.sum() > 100
    assert not np.any(pixels[umbra])
    d = np.hypot(4.0, r)
    expected = 0.5 * 100 * (0.1 / d) ** 2 * (4.0 / d)
    np.testing.assert_allclose(pixels[penumbra], expected[penumbra], rtol=0.02)


def test_max_depth_counts_rays() -> None:
    look = Look(size=8, vfov=20)
    light = lamp((3.0, 2.0, 3.0), 0.5, np.full(3, 5.0))
    sky = ph.Background("constant", radiance=(1, 1, 1))
    # the camera's ray alone sees what shines, not what is lit
    assert not np.any(look.render(diffuse_sphere(), light, background=sky, max_depth=1))
    np.testing.assert_array_equal(
        look.render(lamp((0, 0, 0), 1.0, np.ones(3)), max_depth=1), np.ones((8, 8, 3), np.float32)
    )
    # one more is one bounce
    pixels = look.render(diffuse_sphere(), background=sky, max_depth=2)
    np.testing.assert_allclose(pixels, np.broadcast_to(ALBEDO, pixels.shape), rtol=1e-6)
    glass = ph.Spheres([[0, 0, 0]], 1.0, ph.Material("dielectric", color=(1, 1, 1), ior=1.0))
    for depth, value in ((1, 0.0), (2, 0.0), (3, 1.0)):  # through both walls of nothing
        assert np.all(look.render(glass, background=sky, max_depth=depth) == value)


def test_colors_of_spheres_replace_the_material_s() -> None:
    look = Look(size=8, vfov=20)
    sky = ph.Background("constant", radiance=(1, 1, 1))
    green = [[0.25, 0.5, 0.125]]
    for material in (ph.Material("diffuse"), ph.Material("metal"), ph.Material("emissive")):
        sphere = ph.Spheres([[0, 0, 0]], 1.0, material, green)
        pixels = look.render(sphere, background=sky)
        np.testing.assert_allclose(pixels, np.broadcast_to(green[0], pixels.shape), rtol=1e-6)


def test_the_feature_direct_is_the_integrator_direct() -> None:
    # A lamp that scatters too, met by light samples and by scattering, and a sky.
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]])
    faces = [[0, 1, 2], [0, 2, 3]]
    lamp = ph.Material("diffuse", color=(0.5, 0.5, 0.5), emission=(8, 8, 8))
    shapes = [
        ph.Mesh(2 * corners, faces, material=ph.Material("diffuse", color=(0.7, 0.6, 0.5))),
        ph.Mesh(0.5 * corners + [0, 1.9, 0], faces, material=lamp),
        ph.Spheres([[0, 0.5, 0]], 0.5, ph.Material("conductor", roughness=0.3)),
    ]
    camera = ph.Camera(eye=(0, 1, 4), target=(0, 0.8, 0))
    sky = ph.Background("constant", radiance=(0.2, 0.2, 0.2))
    prepared = ph.prepare(ph.Scene(shapes, camera=camera, background=sky))
    size = {"width": 48, "height": 36, "spp": 8}
    seen = ph.render(prepared, features=True, **size)
    once = ph.render(prepared, integrator="direct", **size).numpy()[..., :3]
    parts = seen.features
    np.testing.assert_allclose(parts["emission"] + parts["direct"], once, atol=1e-5)
    assert parts["indirect"].max() > 0.01


def test_light_of_several_lights_is_the_sum_of_each() -> None:
    """A panorama of each mapping, one far brighter, a sun and a lamp: chosen by what they give."""
    rng = np.random.default_rng(3)
    look = Look(size=8)
    lights = [
        ph.Light("envmap", image=rng.gamma(0.3, size=(8, 16, 3)).astype(np.float32)),
        ph.Light("envmap", image=rng.gamma(0.3, 9.0, (8, 8, 3)), mapping="equal_area"),
        ph.Light("directional", direction=(-1, -2, -3), irradiance=(2, 3, 1), angle=2.0),
    ]
    ground = ph.Spheres([(0, -101, 0)], 100.0, ph.Material("metal", fuzz=0.5))

    def runs(shown: list[ph.Light], radiance: float) -> np.ndarray:
        ball = ph.Spheres([(0, 0, 0)], 1.0, ph.Material("diffuse", color=(0.5, 0.6, 0.7)))
        bulb = lamp((1.6, 1.6, 1.0), 0.2, np.full(3, radiance))
        return look.runs(ball, ground, bulb, lights=shown, spp=64, count=16, max_depth=5)

    together = runs(lights, 40.0)
    apart = sum(runs([light], 0.0) for light in lights) + runs([], 40.0)
    a, b = together.mean(axis=-1), apart.mean(axis=-1)
    expected = b.mean(axis=0)
    assert mean_p(a - b + expected, expected) > SIGNIFICANCE
    assert abs(a.mean() / b.mean() - 1) < 0.01


GLOSSY = {
    "gold": ph.Material("conductor", roughness=0.3, compensation="off"),
    "brushed": ph.Material("conductor", roughness=0.4, anisotropy=0.7, compensation="off"),
    "plastic": ph.Material("plastic", color=(0.2, 0.3, 0.4), roughness=0.3),
    "beckmann": ph.Material("plastic", roughness=0.5, distribution="beckmann"),
    "principled": ph.Material("principled", color=(0.9, 0.5, 0.2), roughness=0.25, metallic=0.5),
}


@pytest.mark.parametrize("kind", GLOSSY)
@pytest.mark.parametrize("count", [3, 20])
def test_lamps_seen_in_gloss_are_the_sum_of_each(kind: str, count: int) -> None:
    """A single lamp is asked whatever the gloss; of several those that it shows, more often."""
    rng = np.random.default_rng(4)
    around = rng.normal(size=(count, 3))
    centers = [tuple(3.0 * c / np.linalg.norm(c)) for c in around]
    glow = rng.uniform(5, 40, (count, 3))
    ball = ph.Spheres([(0, 0, 0)], 1.0, GLOSSY[kind])

    def runs(which: range, spp: int) -> np.ndarray:
        lamps = [lamp(centers[i], 0.2, glow[i]) for i in which]
        settings = {"spp": spp, "count": 24, "max_depth": 2, "sampler": "independent"}
        return Look(size=8).runs(ball, *lamps, **settings).astype(float).mean(axis=(2, 3))

    # of many lamps almost all of the noise is that of which lamp is asked
    spp, each = (256, 256) if count < 20 else (512, 64)
    together = runs(range(count), spp)
    apart = sum(runs(range(i, i + 1), each) for i in range(count))
    gap = together - apart
    # where a camera's rays begin depends on the scene's bounds, by a rounding
    gap[np.abs(gap) < 1e-5 * apart] = 0.0
    assert mean_p(gap, np.zeros(8)) > SIGNIFICANCE / 10  # of each row
    assert abs(gap.mean() / apart.mean()) < 0.01


CHALK = ph.Material("diffuse", color=(0.8, 0.6, 0.4))
# Bumps, so that the two see other normals; waves of a length that footprints do not smooth away.
BUMPY = ph.Material(
    "diffuse", color=(0.4, 0.6, 0.8), bump_map=ph.Texture("noise", size=0.5, color1=(0.2, 0.2, 0.2))
)


def blend(a: ph.Material, b: ph.Material, weight: float = 0.4) -> ph.Material:
    return ph.Material("blend", a=a, b=b, weight=weight)


def test_gloss_before_chalk_behind_a_veil_adds_up_too() -> None:
    """Paths go on from gloss to chalk, from chalk to gloss, and through half of a veil."""
    gold, veil = GLOSSY["gold"], ph.Material("diffuse", color=(0.6, 0.6, 0.6), opacity=0.5)
    things = [
        ph.Spheres([(0.5, 0, 0)], 0.6, gold),
        ph.Spheres([(-0.7, 0, 0)], 0.5, ph.Material("diffuse", color=(0.7, 0.7, 0.7))),
        ph.Spheres([(0, -51, 0)], 50.0, blend(GLOSSY["principled"], BUMPY)),
        ph.Spheres([(0, 0.2, 0.9)], 0.3, veil),
    ]
    centers = [(2.0, 1.5, 0.5), (-2.0, 1.0, 1.0), (0.3, 2.0, 1.0), (-0.5, 1.0, -2.0)]
    glow = [(30, 10, 5), (5, 20, 10), (3, 5, 20), (10, 10, 10)]

    def runs(shining: set[int]) -> np.ndarray:
        lamps = [
            lamp(c, 0.2, np.array(g if i in shining else (0, 0, 0), float))
            for i, (c, g) in enumerate(zip(centers, glow, strict=True))
        ]
        settings = {"spp": 256, "count": 24, "max_depth": 5, "sampler": "independent"}
        return Look(size=8).runs(*things, *lamps, **settings).astype(float).mean(axis=(2, 3))

    together, apart = runs({0, 1, 2, 3}), sum(runs({i}) for i in range(4))
    gap = together - apart
    assert mean_p(gap, np.zeros(8)) > SIGNIFICANCE / 10
    assert abs(gap.mean() / apart.mean()) < 0.01


# Both asked for light; one of them alone, as the other is a mirror, or sends colours apart.
BLENDS = {
    "chalk and gold": (CHALK, GLOSSY["gold"]),
    "bumps and brushed": (BUMPY, GLOSSY["brushed"]),
    "plastic and principled": (GLOSSY["plastic"], GLOSSY["principled"]),
    "frosted glass and chalk": (ph.Material("dielectric", roughness=0.5), CHALK),
    "mirror and gold": (ph.Material("metal", color=(0.9, 0.9, 0.9)), GLOSSY["gold"]),
    "prism and chalk": (ph.Material("dielectric", roughness=0.4, dispersion=0.5), CHALK),
    "blend and plastic": (blend(CHALK, GLOSSY["gold"]), GLOSSY["plastic"]),
}


@pytest.mark.parametrize("pair", BLENDS)
def test_a_blend_is_as_bright_as_both_by_their_shares(pair: str) -> None:
    """Under three lamps, which gloss chooses among; light that is scattered once."""
    places = [(2, 1.5, 2), (-2, 1, 2), (0, 3, 1)]
    lamps = [lamp(c, 0.3, 10.0 * np.array(g)) for c, g in zip(places, np.eye(3) + 1, strict=True)]

    def runs(material: ph.Material) -> np.ndarray:
        ball = ph.Spheres([(0, 0, 0)], 1.0, material)
        settings = {"spp": 256, "count": 24, "max_depth": 2, "sampler": "independent"}
        return Look(size=8).runs(ball, *lamps, **settings).astype(float).mean(axis=(2, 3))

    a, b = BLENDS[pair]
    both = runs(blend(a, b))
    gap = both - 0.6 * runs(a) - 0.4 * runs(b)
    assert mean_p(gap, np.zeros(8)) > SIGNIFICANCE / 10  # of each row
    assert abs(gap.mean() / both.mean()) < 0.01


def test_a_sheet_that_is_half_thin_is_as_bright_as_both() -> None:
    """One of the lamps stands behind it."""
    places = [(2, 1.5, 2), (-2, 1, -2), (0, 3, 1)]
    lamps = [lamp(c, 0.3, 10.0 * np.array(g)) for c, g in zip(places, np.eye(3) + 1, strict=True)]
    corners = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]

    def runs(material: ph.Material) -> np.ndarray:
        sheet = ph.Mesh(corners, [[0, 1, 2], [0, 2, 3]], material=material)
        settings = {"spp": 256, "count": 24, "max_depth": 2, "sampler": "independent"}
        return Look(size=8).runs(sheet, *lamps, **settings).astype(float).mean(axis=(2, 3))

    thin = ph.Material("diffuse_transmission")
    both = runs(blend(thin, CHALK))
    gap = both - 0.6 * runs(thin) - 0.4 * runs(CHALK)
    assert mean_p(gap, np.zeros(8)) > SIGNIFICANCE / 10
    assert abs(gap.mean() / both.mean()) < 0.01


@pytest.mark.parametrize("bodies", [False, True])
def test_light_on_a_blend_is_not_left_to_chance(bodies: bool) -> None:
    """Half black and half white is as little noisy as grey, also where paths know of bodies."""

    def noise(material: ph.Material) -> float:
        ball = ph.Spheres([(0, 0, 0)], 1.0, material)
        bulb = lamp((2, 1.5, 2), 0.3, np.full(3, 20.0))
        far = [ph.Spheres([(0, 0, -9)], 0.5, tinted)] if bodies else []
        settings = {"spp": 16, "count": 12, "max_depth": 2, "sampler": "independent"}
        return float(Look(size=8).runs(ball, bulb, *far, **settings).std(axis=0).mean())

    tinted = ph.Material("dielectric", absorption=(1, 2, 3))
    white, black, grey = (
        ph.Material("principled", color=(c, c, c), specular=0.0, roughness=1.0)
        for c in (0.8, 0.0, 0.4)
    )
    assert noise(blend(white, black, 0.5)) < 1.1 * noise(grey)
