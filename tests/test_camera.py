"""The camera: which way round, which pixel looks where, the lens, and cameras without meaning."""

from __future__ import annotations

import math

import numpy as np
import pytest

import parhelion as ph

BLACK = ph.Background("constant", radiance=(0, 0, 0))
SHINING = ph.Material("emissive")


def render(scene: ph.Scene, **settings: object) -> np.ndarray:
    return ph.render(scene, **{"spp": 4, "threads": 1, **settings}).numpy()


def lamps(centers: object, radii: object, colors: object, camera: ph.Camera) -> ph.Scene:
    return ph.Scene([ph.Spheres(centers, radii, SHINING, colors)], camera=camera, background=BLACK)


# --- Which way round ---------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [{}, {"fov": 60.0}, {"vfov": 60.0}])
def test_not_mirrored(angle: dict[str, float]) -> None:
    """From +z with y up, +x is on the right and +y at the top; and so from every other side."""
    red, green, blue = np.eye(3)
    scene = lamps(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0]],
        0.3,
        [red, green, blue],
        ph.Camera(eye=(0, 0, 5), target=(0, 0, 0), **angle),
    )
    pixels = render(scene, width=60, height=60)
    columns, rows = np.arange(60), np.arange(60)[:, None]

    def middle(channel: int) -> tuple[float, float]:
        weight = pixels[..., channel] / pixels[..., channel].sum()
        return float(np.sum(weight * columns)) - 29.5, float(np.sum(weight * rows)) - 29.5

    assert middle(0)[0] > 5
    assert middle(1)[0] < -5
    assert middle(2)[1] < -5  # rows count from the top
    assert abs(middle(0)[1]) < 0.2
    assert abs(middle(2)[0]) < 0.2
    assert middle(0)[0] == pytest.approx(-middle(1)[0], abs=0.2)


@pytest.mark.parametrize(
    ("eye", "up", "right"),
    [
        ((0, 0, -5), (0, 1, 0), (-1, 0, 0)),
        ((5, 0, 0), (0, 1, 0), (0, 0, -1)),
        ((0, 0, 5), (0, -1, 0), (-1, 0, 0)),
        ((0, 0, 5), (1, 0, 0), (0, -1, 0)),
        ((0, 5, 0), (0, 0, 1), (-1, 0, 0)),
        ((0, 0, 5), (0, 3, 900), (1, 0, 0)),
    ],
)
def test_right_is_right_from_every_side(eye, up, right) -> None:
    scene = lamps([right], 0.3, [[1, 1, 1]], ph.Camera(eye=eye, target=(0, 0, 0), up=up))
    pixels = render(scene, width=40, height=40)[..., 0]
    assert pixels[:, 20:].sum() > 0
    assert pixels[:, :20].sum() == 0


# --- The published formula of pixel centres ----------------------------------------------------

EYE, TARGET, UP = np.array([1.0, 2.0, 3.0]), np.array([-0.5, 1.0, -4.0]), np.array([0.2, 1.0, 0.1])


def pixel_centers(k: int, m: int, fov: float, d: float) -> np.ndarray:
    """(m, k, 3) points E + p_ij in the order of the picture: from the top left, by rows.

    b = v x t points to the viewer's left, so the formula counts i from the right and j from the
    bottom of the picture.
    """
    t = TARGET - EYE
    t_n = t / np.linalg.norm(t)
    b = np.cross(UP, t)
    b_n = b / np.linalg.norm(b)
    v_n = np.cross(t_n, b_n)
    # with one column or row the formula has no steps: g is then half of one whole step
    g_x = d * np.tan(np.radians(fov) / 2)
    g_y = g_x * (m - 1) / max(k - 1, 1)
    q_x = 2 * g_x / max(k - 1, 1) * b_n
    q_y = (2 * g_y / (m - 1) if m > 1 else 0.0) * v_n
    p_1m = t_n * d - (g_x * b_n if k > 1 else 0.0) - g_y * v_n
    i, j = np.arange(k, 0, -1), np.arange(m, 0, -1)[:, None]
    offsets = q_x * (i - 1)[..., None] + q_y * (j - 1)[..., None]
    return EYE + p_1m + offsets


@pytest.mark.parametrize(("k", "m"), [(7, 5), (5, 8), (2, 2), (1, 5), (6, 1), (1, 1)])
@pytest.mark.parametrize("fov", [20.0, 100.0])
def test_pixels_look_along_the_published_formula(k: int, m: int, fov: float) -> None:
    d = 2.5
    points = pixel_centers(k, m, fov, d)
    # A pinhead of its own colour in every pixel's line of sight, 1e-3 of a pixel wide, at another
    # distance each.
    rng = np.random.default_rng(1)
    away = rng.uniform(0.5, 4.0, (m, k, 1))
    pitch = 2 * d * np.tan(np.radians(fov) / 2) / max(k - 1, 1)
    colors = rng.uniform(0.1, 1, (m, k, 3)).astype(np.float32)
    camera = ph.Camera(
        eye=tuple(EYE), target=tuple(TARGET), up=tuple(UP), fov=fov, focus_distance=d
    )
    radii = np.ravel(1e-3 * pitch * away)
    scene = lamps(
        (EYE + (points - EYE) * away).reshape(-1, 3), radii, colors.reshape(-1, 3), camera
    )
    pixels = render(scene, width=k, height=m, spp=2, filter="box", filter_radius=1e-6)
    np.testing.assert_allclose(pixels, colors, rtol=1e-6)


def test_samples_fill_the_pixel_around_its_centre() -> None:
    """With the box of half a pixel, neighbours meet without a gap and without overlap."""
    # The edge between the left and right half of an even picture falls between two columns.
    wall = [[-1000.1, 0, 0], [1000.1, 0, 0]]
    camera = ph.Camera(eye=(0, 0, 5), target=(0, 0, 0), vfov=30)
    scene = lamps(wall, 1000.0, [[1, 0, 0], [0, 1, 0]], camera)
    pixels = render(scene, width=8, height=8, spp=256, filter="box")
    step = 2 * 5 * math.tan(math.radians(15)) / 8
    # a line from the eye touches such a sphere at this angle from the middle
    limb = math.atan2(1000.1, 5) - math.asin(1000 / math.hypot(1000.1, 5))
    gap = 5 * math.tan(limb) / step  # of a pixel, on each side of the middle
    np.testing.assert_allclose(pixels[:, :3, 0], 1)
    np.testing.assert_allclose(pixels[:, 5:, 1], 1)
    np.testing.assert_allclose(pixels[3:5, 3, 0], 1 - gap, atol=0.01)
    np.testing.assert_allclose(pixels[3:5, 4, 1], 1 - gap, atol=0.01)
    assert not np.any(pixels[:, :4, 1])


def test_fov_and_vfov_name_the_same_picture() -> None:
    """fov spans a row from centre to centre; vfov spans the picture from edge to edge."""
    width, height, vfov = 24, 16, 35.0
    step = 2 * math.tan(math.radians(vfov) / 2) / height
    fov = math.degrees(2 * math.atan(step * (width - 1) / 2))
    pictures = [
        render(ph.weekend(), camera=camera, width=width, height=height)
        for camera in (
            ph.Camera(eye=(13, 2, 3), target=(0, 0, 0), vfov=vfov),
            ph.Camera(eye=(13, 2, 3), target=(0, 0, 0), fov=fov),
        )
    ]
    # the last bit of an angle may take a path another way, hardly ever
    assert np.mean(np.abs(pictures[0] - pictures[1]) > 1e-3) < 0.01


# --- The lens ----------------------------------------------------------------------------------


def blurred(distance: float, *, focus: float, aperture: float, radius: float) -> tuple[float, ...]:
    """Sum, root mean square radius and greatest radius, in pixels, of the image of a small lamp."""
    size = 65
    camera = ph.Camera(
        eye=(0, 0, 0),
        target=(0, 0, -1),
        vfov=40,
        aperture_radius=aperture,
        focus_distance=focus,
    )
    scene = lamps([[0, 0, -distance]], radius, [[1, 1, 1]], camera)
    pixels = render(scene, width=size, height=size, spp=256, filter="box", filter_radius=1e-6)
    image = pixels[..., 0].astype(float)
    at = np.arange(size) - (size - 1) / 2
    r2 = at**2 + at[:, None] ** 2
    # same in x as in y: a round lens
    assert np.sum(image * at**2) == pytest.approx(np.sum(image * at[:, None] ** 2), rel=0.1)
    return (
        float(image.sum()),
        float(np.sqrt(np.sum(image * r2) / image.sum())),
        float(np.sqrt(r2[image > 0].max())),
    )


@pytest.mark.parametrize("distance", [2.0, 4.0, 12.0])
def test_out_of_focus_points_become_circles_of_confusion(distance: float) -> None:
    focus, aperture = 6.0, 0.4
    pixel = 2 * focus * math.tan(math.radians(20)) / 65  # in the plane of focus
    radius = 3 * pixel * distance / focus
    total, spread, reach = blurred(distance, focus=focus, aperture=aperture, radius=radius)
    # By similar triangles from the lens through the point to the plane of focus.
    circle = aperture * abs(distance - focus) / distance / pixel
    # A disk's mean square radius is half its radius squared; those of the lens and of the lamp, of
    # radius 3 pixels, add. Pixels look from their centres: that rounds by half a pixel's diagonal.
    assert spread == pytest.approx(math.sqrt((circle**2 + 3**2) / 2), rel=0.03)
    assert reach == pytest.approx(circle + 3, abs=1.0)
    assert reach < circle + 3.1
    # and the light is spread, not lost
    assert total == pytest.approx(math.pi * 3**2, rel=0.05)


def test_points_in_focus_stay_sharp() -> None:
    pixel = 2 * 6 * math.tan(math.radians(20)) / 65
    _, spread, reach = blurred(6.0, focus=6.0, aperture=0.4, radius=3 * pixel)
    assert spread == pytest.approx(3 / math.sqrt(2), rel=0.05)
    assert reach < 3.3  # the lamp is a ball: a little of it lies before the plane


def test_focus_is_on_the_target_unless_told() -> None:
    given = ph.Camera(eye=(13, 2, 3), aperture_radius=0.3, vfov=20, focus_distance=math.sqrt(182))
    target = ph.Camera(eye=(13, 2, 3), aperture_radius=0.3, vfov=20)
    pictures = [render(ph.weekend(), camera=c, width=16, height=9) for c in (given, target)]
    np.testing.assert_array_equal(*pictures)


# --- The other projections ---------------------------------------------------------------------


def picture_frame() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, right and down of the picture that EYE, TARGET and UP make."""
    forward = (TARGET - EYE) / np.linalg.norm(TARGET - EYE)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    return forward, right, np.cross(forward, right)


def places(k: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """(m, k, 1) centres of pixels from the picture's top left corner, in pixels."""
    x, y = np.meshgrid(np.arange(k) + 0.5, np.arange(m) + 0.5)
    return x[..., None], y[..., None]


def rays(projection: str, k: int, m: int, **told: float) -> tuple[np.ndarray, np.ndarray]:
    """(m, k, 3) origins and unit directions of the pixels' rays, as docs/camera.md says."""
    forward, right, down = picture_frame()
    x, y = places(k, m)
    x, y = x + told.get("shift_x", 0) * k, y + told.get("shift_y", 0) * m
    if projection == "orthographic":
        step = told["height"] / m
        origins = EYE + right * (x - k / 2) * step + down * (y - m / 2) * step
        return origins, np.broadcast_to(forward, origins.shape)
    if projection == "equirectangular":
        longitude, latitude = (x / k - 0.5) * 2 * np.pi, (0.5 - y / m) * np.pi
        level = forward * np.cos(longitude) + right * np.sin(longitude)
        directions = level * np.cos(latitude) - down * np.sin(latitude)
    elif projection == "fisheye":
        dx, dy = x - k / 2, y - m / 2
        r = np.hypot(dx, dy)
        angle = r * np.radians(told["vfov"]) / m
        across = np.where(r > 0, np.sin(angle) / np.maximum(r, 1e-9), 0)
        directions = forward * np.cos(angle) + (right * dx + down * dy) * across
    else:
        step = 2 * np.tan(np.radians(told["vfov"]) / 2) / m
        directions = forward + right * (x - k / 2) * step + down * (y - m / 2) * step
        directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.broadcast_to(EYE, directions.shape), directions


PROJECTIONS = [
    ("perspective", {"vfov": 50.0}),
    ("orthographic", {"height": 3.0}),
    ("equirectangular", {}),
    ("fisheye", {"vfov": 100.0}),
    ("fisheye", {"vfov": 360.0}),
]


def camera_of(projection: str, told: dict[str, float], **more: object) -> ph.Camera:
    return ph.Camera(
        eye=tuple(EYE), target=tuple(TARGET), up=tuple(UP), projection=projection, **told, **more
    )


def check_pinheads(
    camera: ph.Camera, origins: np.ndarray, directions: np.ndarray, seen: np.ndarray
) -> None:
    """Every pixel sees the pinhead of its own colour on its ray, each at another distance; those
    that are not `seen` have none and see nothing."""
    m, k, _ = directions.shape
    rng = np.random.default_rng(2)
    points = origins + directions * rng.uniform(0.5, 4.0, (m, k, 1))
    colors = rng.uniform(0.1, 1, (m, k, 3)).astype(np.float32)
    scene = lamps(points[seen], 1e-5, colors[seen], camera)
    pixels = render(scene, width=k, height=m, spp=2, filter="box", filter_radius=1e-6)
    np.testing.assert_allclose(pixels, np.where(seen[..., None], colors, 0), rtol=1e-6)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(("k", "m"), [(7, 5), (4, 6), (1, 1)])
@pytest.mark.parametrize(("projection", "told"), PROJECTIONS)
def test_pixels_look_where_the_manual_says(projection, told, k, m, mirrored) -> None:
    seen = np.ones((m, k), bool)
    if projection == "fisheye":
        x, y = places(k, m)
        seen = np.hypot(x - k / 2, y - m / 2)[..., 0] <= m / 2
    origins, directions = rays(projection, k, m, **told)
    if mirrored:
        origins, directions = origins[:, ::-1], directions[:, ::-1]
    check_pinheads(camera_of(projection, told, mirrored=mirrored), origins, directions, seen)


@pytest.mark.parametrize(("projection", "told"), PROJECTIONS[:2])
def test_shift_moves_the_window(projection, told) -> None:
    """By a quarter of its width to the right and half of its height up."""
    k, m = 6, 4
    camera = camera_of(projection, told, shift=(0.25, -0.5))
    shifted = rays(projection, k, m, shift_x=0.25, shift_y=-0.5, **told)
    check_pinheads(camera, *shifted, np.ones((m, k), bool))


def test_nothing_is_seen_around_the_fisheyes_circle() -> None:
    sky = ph.Background("constant", radiance=(1, 1, 1))
    scene = ph.Scene([ph.Spheres([[0, 0, 0]])], background=sky)
    camera = ph.Camera(eye=(0, 3, 9), projection="fisheye")
    pixels = render(scene, camera=camera, width=48, height=32, filter="box", filter_radius=1e-6)
    x, y = places(48, 32)
    inside = np.hypot(x - 24, y - 16)[..., 0] <= 16
    assert np.all(pixels[~inside] == 0)
    assert np.all(pixels[inside] > 0)


def test_orthographic_sizes_do_not_depend_on_distance() -> None:
    camera = ph.Camera(eye=(0, 0, 0), target=(0, 0, -1), projection="orthographic", height=4)
    areas = []
    for distance in (2.0, 50.0, 4000.0):
        scene = lamps([[0.3, -0.2, -distance]], 1.0, [[1, 1, 1]], camera)
        pixels = render(scene, width=64, height=64, spp=16, filter="box")
        areas.append(pixels[..., 0].mean() * 4**2)
    np.testing.assert_allclose(areas, math.pi, rtol=5e-3)


@pytest.mark.parametrize("height", [0.0, 0.3])
@pytest.mark.parametrize("told", [{"projection": "orthographic", "height": 1.0}, {"vfov": 20.0}])
@pytest.mark.parametrize("eye", [(0, 0, 3), (0.4, 0.3, 3.1)])
def test_a_disk_is_seen_in_which_all_of_the_scene_lies(
    eye: tuple[float, ...], told: dict[str, object], height: float
) -> None:
    """Nor does anything else get lost that lies in a side of the scene's bounds."""
    camera = ph.Camera(eye=eye, target=(eye[0] / 4, eye[1] / 4, height), up=(0, 1, 0), **told)
    at = ph.Disks([[0, 0, height]], [[2, 0, 0]], [[0, 2, 0]], SHINING)
    for disk in (at, ph.Instances([at], [np.eye(4)])):
        pixels = render(ph.Scene([disk], camera=camera, background=BLACK), width=24, height=24)
        assert np.all(pixels == 1.0)


# --- Cameras without a meaning -----------------------------------------------------------------

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"eye": (1, 2, 3), "target": (1, 2, 3)}, "same point"),
        ({"eye": (0, 5, 0), "target": (0, 0, 0)}, "parallel"),
        ({"eye": (0, 0, 0), "target": (2, -4, 6), "up": (-1, 2, -3)}, "parallel"),
        ({"up": (0, 0, 0)}, "up has no direction"),
        ({"fov": 0.0}, "fov is 0"),
        ({"fov": 180.0}, "fov is 180"),
        ({"fov": -20.0}, "fov is -20"),
        ({"fov": NAN}, "fov is nan"),
        ({"vfov": 0.0}, "vfov is 0"),
        ({"vfov": 200.0}, "vfov is 200"),
        ({"vfov": INF}, "vfov is inf"),
        ({"fov": 40.0, "vfov": 40.0}, "not both"),
        ({"eye": (NAN, 0, 0)}, "eye is not finite"),
        ({"target": (0, INF, 0)}, "target is not finite"),
        ({"up": (0, NAN, 0)}, "up is not finite"),
        ({"aperture_radius": -1.0}, "aperture_radius is -1"),
        ({"aperture_radius": NAN}, "aperture_radius is nan"),
        ({"focus_distance": 0.0}, "focus_distance is 0"),
        ({"focus_distance": -2.0}, "focus_distance is -2"),
        ({"focus_distance": NAN}, "focus_distance is nan"),
        ({"focus_distance": INF}, "focus_distance is inf"),
        ({"eye": (0, 0)}, "eye"),
        ({"eye": ("a", "b", "c")}, "camera"),
        ({"target": None}, "camera"),
        ({"fov": "wide"}, "fov"),
        ({"projection": "fish"}, "'fish'.*perspective, orthographic, equirectangular, fisheye"),
        ({"projection": "orthographic"}, "'orthographic' needs a height"),
        ({"projection": "orthographic", "height": 0.0}, "height is 0"),
        ({"projection": "orthographic", "height": -2.0}, "height is -2"),
        ({"projection": "orthographic", "height": NAN}, "height is nan"),
        ({"projection": "orthographic", "height": 1.0, "vfov": 40.0}, "'orthographic' has no vfov"),
        ({"height": 1.0}, "'perspective' has no height"),
        ({"projection": "equirectangular", "vfov": 40.0}, "'equirectangular' has no vfov"),
        ({"projection": "equirectangular", "shift": (0.1, 0)}, "'equirectangular' has no shift"),
        ({"projection": "fisheye", "fov": 40.0}, "'fisheye' has no fov"),
        ({"projection": "fisheye", "vfov": 361.0}, "vfov is 361"),
        ({"projection": "fisheye", "aperture_radius": 0.1}, "'fisheye' has no aperture_radius"),
        ({"shift": (0, NAN)}, "shift is nan"),
        ({"shift": (1,)}, "shift"),
    ],
)
def test_cameras_without_meaning(camera: dict[str, object], message: str) -> None:
    with pytest.raises(ph.SceneError, match=message):
        ph.render(ph.weekend(), camera=ph.Camera(**camera), width=4, height=4, spp=1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width": 0}, "width is 0"),
        ({"height": 0}, "height is 0"),
        ({"width": -5, "height": 5}, "width is -5"),
        ({"width": 10**9}, "width is 1000000000"),
        ({"width": 4.5}, "width is 4.5"),
        ({"spp": 0}, "spp is 0"),
        ({"max_depth": 0}, "max_depth is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"threads": -1}, "threads is -1"),
        ({"tile": 0}, "tile is 0"),
        ({"crop": (0, 0, 0, 1)}, "crop"),
        ({"crop": (3, 0, 2, 1), "width": 4, "height": 4}, "crop"),
        ({"crop": (1, 2)}, "crop"),
        ({"filter": "boxx"}, "boxx.*box"),
        ({"filter_radius": -1.0}, "filter_radius"),
        ({"filter_radius": NAN}, "filter_radius"),
        ({"sampler": "sobl"}, "sobl.*sobol"),
        ({"schedule": "random"}, "random.*static"),
        ({"tree": "kd"}, "kd.*bvh"),
        ({"isa": "mmx"}, "mmx.*baseline"),
        ({"sppp": 4}, "sppp.*spp"),
    ],
)
def test_settings_without_meaning(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ph.SceneError, match=message):
        ph.render(ph.weekend(), **{"spp": 1, **settings})


@pytest.mark.parametrize("size", [(1, 1), (1, 3), (3, 1)])
def test_smallest_pictures(size: tuple[int, int]) -> None:
    for angle in ({"fov": 60.0}, {"vfov": 60.0}):
        camera = ph.Camera(eye=(13, 2, 3), target=(0, 0, 0), **angle)
        pixels = render(ph.weekend(), camera=camera, width=size[0], height=size[1])
        assert pixels.shape == (size[1], size[0], 3)
        assert np.all(pixels > 0)
