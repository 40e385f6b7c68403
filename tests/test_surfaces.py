"""What a surface is at a point, with known answers: normals, holes, blends, sides and textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from floor_tools import (
    BLACK,
    DARK,
    FURNACES,
    LAMP,
    WHITE,
    Floor,
    assert_lit,
    ball,
    box,
    picture,
    quad,
    quad_surface,
    sheet,
    steep_normals,
    surface_irradiance,
    turned,
)
from statistics_tools import SIGNIFICANCE, mean_p

# --- Normals -----------------------------------------------------------------------------------


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


@pytest.mark.parametrize(
    ("parameter", "value"), [("color", (0.5, 0.25, 0.75)), ("roughness", 0.25), ("ior", 1.25)]
)
def test_textures_of_one_value_are_that_value(parameter: str, value: Any) -> None:
    """Also where what parameters lead to is worked out once for all of a material."""
    image = np.broadcast_to(np.float32(value), (1, 1, 3))
    given: dict[str, Any] = {"color": (0.2, 0.3, 0.4), "roughness": 0.5, "ior": 1.5}
    plain = ph.Material("plastic", **{**given, parameter: value})
    textured = ph.Material("plastic", **{**given, parameter: ph.Texture("image", image=image)})
    np.testing.assert_allclose(colored(textured), colored(plain), rtol=1e-5)


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
