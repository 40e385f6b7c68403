"""What scenes get that bring no camera, no light or no ground, and what users ask for instead."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.framing import bounds, placed
from parhelion.studio import VIEWS, dressed, framing, up_of, with_up

Z_UP = ph.Framing((0, -1, 0), (0, 0, 1))
BALL = ph.Spheres([[0, 0, 0]], 1.0)


def axes(view: str, up: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right and up in the picture, and the way to the camera."""
    f = framing(up, view)
    towards, above = np.array(f.direction), np.array(f.up)
    return np.cross(above, towards), above, towards


@pytest.mark.parametrize(
    ("up", "right", "front"),
    [((0, 0, 1), (1, 0, 0), (0, -1, 0)), ((0, 1, 0), (1, 0, 0), (0, 0, 1))],
)
def test_views(up: Any, right: Any, front: Any) -> None:
    up, right, front = (np.array(v, float) for v in (up, right, front))
    for view, expected in {
        "front": (right, up, front),
        "back": (-right, up, -front),
        "right": (-front, up, right),
        "left": (front, up, -right),
        "top": (right, -front, up),
        "bottom": (right, front, -up),
    }.items():
        np.testing.assert_allclose(axes(view, tuple(up)), expected, atol=1e-9)
    towards = axes("iso", tuple(up))[2]
    np.testing.assert_allclose(towards, (right + up + front) / np.sqrt(3), atol=1e-6)
    assert all(np.isclose(np.linalg.norm(axes(v, tuple(up))[2]), 1) for v in VIEWS)


def test_unknown_view() -> None:
    with pytest.raises(ph.SceneError, match="unknown view 'frnt'; did you mean 'front'"):
        dressed(ph.Scene([BALL]), view="frnt")


def test_a_scene_that_is_complete_stays_as_it_is() -> None:
    for scene in (
        ph.Scene([BALL]),
        ph.Scene([BALL], camera=ph.Camera(), background=None),
        ph.Scene([BALL], background=None),
    ):
        assert dressed(scene) is scene


LAMP = ph.Spheres([[0, 0, 0]], 1, ph.Material("emissive"))


@pytest.mark.parametrize(
    "light",
    [
        {"background": ph.Background("constant")},
        {"lights": [ph.Light("point")]},
        {"materials": {"lamp": ph.Material("emissive")}},
        {"materials": {"lamp": ph.Material("diffuse", emission=(1, 1, 1))}},
        {"shapes": [ph.Instances([LAMP], [np.eye(4)])]},
    ],
)
def test_what_has_light_gets_no_more(light: dict[str, Any]) -> None:
    scene = ph.Scene(**{"shapes": [BALL], "background": None, **light})
    made = dressed(scene, bare=True)
    assert made.shapes == scene.shapes
    assert made.background == scene.background
    assert made.lights == scene.lights


@pytest.mark.parametrize(
    ("emission", "most"),
    [
        ((0.5, 2.0, 0.0), 2.0),
        (ph.Texture("image", image=np.full((1, 1, 3), 255, np.uint8)), 1.0),
        (ph.Texture("image", image=np.full((1, 1, 3), 3.0, np.float32)), 3.0),
        (ph.Texture("multiply", color0=ph.Texture("image", image="a.png"), color1=(4, 4, 4)), 4.0),
    ],
)
def test_what_glows_for_show_is_no_light(emission: Any, most: float) -> None:
    lamp = ph.Material("diffuse", emission=emission)
    scene = ph.Scene([BALL], {"lamp": lamp}, background=None)
    assert dressed(scene, bare=True, glow=0.9 * most).background is None
    assert dressed(scene, bare=True, glow=1.1 * most).background is not None


def test_what_is_dark_is_lit_from_beside_the_camera() -> None:
    for camera in (None, Z_UP, ph.Camera(eye=(0, -9, 3), target=(0, 0, 0), up=(0, 0, 1))):
        scene = dressed(ph.Scene([BALL], camera=camera, background=None), bare=True)
        image = ph.render(scene, width=48, height=48, spp=32).numpy()
        ball = image[18:30, 18:30]
        assert 0.2 < ball.mean() < 0.9
        # the key light is up and to the left
        assert image[18:22, 18:22].mean() > image[26:30, 26:30].mean()
        # the sky is bright behind the ball
        np.testing.assert_allclose(image[0, 0], 0.76, atol=0.04)


def test_the_view_is_of_what_was_there() -> None:
    """Not of the light and ground that come with it."""
    plain = placed(ph.Scene([BALL], camera=framing(), background=None), 1.5)
    scene = dressed(ph.Scene([BALL], background=None), bare=True, ground=True)
    assert len(scene.shapes) == 3
    assert placed(scene, 1.5) == plain


@pytest.mark.parametrize("axis", [1, 2])
def test_ground_below_the_lowest_point(axis: int) -> None:
    corners = np.array(np.meshgrid([1, 2], [3, 4], [5, 6])).reshape(3, -1).T
    cube = ph.Mesh(corners, [[0, 1, 2]])
    camera = ph.Framing(up=tuple(np.eye(3)[axis]), direction=(1, 0, 0))
    scene = dressed(ph.Scene([cube], camera=camera), ground=True)
    ground = scene.shapes[-1]
    assert isinstance(ground, ph.Disks)
    center, u, v = (np.array(a)[0] for a in (ground.centers, ground.axis_u, ground.axis_v))
    assert center[axis] == 1 + 2 * axis
    np.testing.assert_allclose(np.cross(u, v) / np.linalg.norm(u) ** 2, np.eye(3)[axis])
    assert np.delete(center, axis) == pytest.approx(np.delete([1.5, 3.5, 5.5], axis))


def test_a_flat_bottom_lies_on_the_ground() -> None:
    """Neither flickers through the other, and no light is lost between them."""
    square = np.array([[-1, 0.37, -1], [-1, 0.37, 1], [1, 0.37, 1], [1, 0.37, -1]])
    white = ph.Material("diffuse", color=(0.85, 0.85, 0.85))
    plate = ph.Mesh(square, [[0, 1, 2], [0, 2, 3]], material=white)
    sky = ph.Background("constant")
    scene = dressed(ph.Scene([plate], background=sky), view="top", ground=True)
    image = ph.render(scene, width=32, height=32, spp=16).numpy()
    np.testing.assert_allclose(image, 0.85, rtol=1e-3)


TRIANGLE = "v 0 1 0\nv 1 1 0\nv 0 2 0.5\nf 1 2 3\n"
STAGE = '#usda 1.0\n(upAxis = "Z")\ndef Sphere "S" {}\ndef Camera "C" {\n%s\n}\n'


@pytest.mark.parametrize(
    ("name", "text", "lowest"),
    [
        ("a.obj", TRIANGLE, (1, 1.0)),
        ("a.off", "OFF\n3 1 0\n0 1 0\n1 1 0\n0 2 0.5\n3 0 1 2\n", (1, 1.0)),
        ("a.xyz", "2\n\nC 0 0 0\nC 0 0 2\n", None),
        ("a.pbrt", 'WorldBegin Shape "sphere"\n', None),
        ("a.usda", STAGE.partition("def Camera")[0], (2, -1.0)),
        # from 60 degrees above, where up in the picture is nearer to y, and from below
        (
            "a.usda",
            STAGE % "double3 xformOp:translate = (0, -5, 8.66)\ndouble xformOp:rotateX = 30\n"
            'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]',
            (2, -1.0),
        ),
        (
            "a.usda",
            STAGE % "double3 xformOp:translate = (0, 0, -9)\ndouble xformOp:rotateX = 180\n"
            'uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateX"]',
            None,
        ),
    ],
)
def test_meshes_and_scenes_without_light_stand_on_a_ground(
    tmp_path: Path, name: str, text: str, lowest: tuple[int, float] | None
) -> None:
    if name.endswith(".usda"):
        pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    path = tmp_path / name
    path.write_text(text)

    def grounds(**options: Any) -> list[Any]:
        shapes = ph.load(path, ph.LoadOptions(**options)).shapes
        return [shape for shape in shapes if shape.name == "ground"]

    assert len(grounds()) == (lowest is not None)
    if lowest is not None:
        axis, height = lowest
        assert grounds()[0].centers[0][axis] == pytest.approx(height)
    assert not grounds(view="bottom")
    assert len(grounds(view="bottom", ground=True)) == 1
    assert not grounds(environment=str(tmp_path / "sky.hdr"))
    assert not grounds(ground=False)
    assert len(grounds(ground=True)) == 1


def test_of_objects_meshes_stand_on_a_ground() -> None:
    mesh = ph.Mesh([[0, 0, 1], [1, 0, 1], [0, 1, 2]], [[0, 1, 2]])
    for thing, stands in ((mesh, True), (BALL, False), (np.eye(3), False)):
        assert (ph.scene_of(thing).shapes[-1].name == "ground") == stands
    assert ph.scene_of(mesh, ground=False).shapes[-1].name == "key light"
    with pytest.raises(ph.SceneError, match="ground is 'no'; must be True or False"):
        ph.scene_of(mesh, ground="no")


@pytest.mark.parametrize("view", ["default", "front"])
def test_the_ground_is_one_with_the_sky(view: str) -> None:
    """Away from the things, the picture is what it is without; below them, there is a shadow."""
    pictures = []
    for ground in (True, False):
        scene = dressed(ph.Scene([BALL], background=None), view=view, bare=True, ground=ground)
        # wide enough that the sky shows above the ground
        camera = replace(placed(scene, 1.0), vfov=50.0)
        image = ph.render(scene, camera=camera, width=32, height=32, spp=32).numpy()[..., 0]
        pictures.append(image.reshape(8, 4, 8, 4).mean(axis=(1, 3)))
    off = pictures[0] - pictures[1]
    assert np.abs(off[:, 0]).max() < 0.1  # at a horizon it would be 0.16 and more
    assert off[5:, 3:5].min() < -0.12


def test_the_ground_hides_nothing_from_below() -> None:
    scene = ph.scene_of(ph.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))
    assert scene.shapes[-1].name == "ground"
    below = ph.Camera(eye=(0.3, 0.3, -3), target=(0.3, 0.3, 0), up=(0, 1, 0), vfov=5)
    seen = ph.render(scene, camera=below, width=8, height=8, spp=4, features=True).features
    np.testing.assert_array_equal(seen["shape"], 0)


def test_the_ground_fits_the_things_before_a_camera_of_their_own() -> None:
    """Not the lamp, which is far away."""
    camera = ph.Camera(eye=(0, 2, 9), target=(0, 0, 0))
    plain = ph.Scene([BALL], background=None)
    both = [
        dressed(plain.replace(camera=c), bare=True, ground=True).shapes[-1]
        for c in (camera, framing())
    ]
    assert both[0].axis_u == both[1].axis_u
    assert both[0].centers == both[1].centers


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_camera_tells_which_axis_is_up_and_sees_the_same(up: Any) -> None:
    """Whether it is level, rolled or upside down, and however steeply it looks."""
    random = np.random.default_rng(5)
    right, above, front = np.eye(3)[[0, 1, 2]] if up[1] else np.eye(3)[[0, 2, 1]] * [[1], [1], [-1]]
    for elevation in (-90.0, -80.0, -30.0, 0.0, 30.0, 60.0, 80.0, 89.9999, 90.0):
        angle = np.radians(elevation)
        towards = np.cos(angle) * front + np.sin(angle) * above
        level = np.cos(angle) * above - np.sin(angle) * front
        for roll in (0.0, 0.02, -0.5, *random.uniform(-0.7, 0.7, 4)):
            own = np.cos(roll) * level + np.sin(roll) * right
            camera = ph.Camera(tuple(3 * towards), (0, 0, 0), tuple(own))
            told = with_up(camera, up)
            assert up_of(ph.Scene(camera=told)) == up
            wanted, found = np.cross(own, towards), np.cross(told.up, towards)
            np.testing.assert_allclose(found / np.linalg.norm(found), wanted, atol=2e-6)
            if roll == 0 and abs(elevation) < 75:
                assert told.up == up


def test_up_is_what_the_camera_says() -> None:
    assert up_of(ph.Scene()) == (0, 1, 0)
    assert up_of(ph.Scene(camera=Z_UP)) == (0, 0, 1)
    assert up_of(ph.Scene(camera=ph.Camera(up=(0.1, 0.2, -0.9)))) == (0, 0, -1)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1)])
def test_environment_stands_upright_behind_things(up: Any) -> None:
    """Red at the top, green in the middle of the panorama, and blue to the right of that."""
    panorama = np.zeros((32, 64, 3), np.float32)
    panorama[:8, :, 0] = 1
    panorama[12:20, 28:36, 1] = 1
    panorama[12:20, 44:52, 2] = 1
    scene = ph.Scene([BALL], camera=ph.Framing(up=up, direction=(1, 0.1, 0.2)), background=None)
    made = dressed(scene, environment=panorama)  # type: ignore[arg-type]
    for view, color in (("front", 1), ("left", 2), ("bottom", 0)):
        camera = placed(made.replace(camera=framing(up, view)), 1.0)
        away = np.subtract(camera.target, camera.eye)
        looking = ph.Camera(eye=(0, 0, 0), target=tuple(away), up=camera.up, vfov=5)
        seen = ph.render(made.replace(shapes=[]), camera=looking, width=4, height=4, spp=4).numpy()
        np.testing.assert_allclose(seen, np.broadcast_to(np.eye(3)[color], seen.shape), atol=1e-3)


def test_every_format_takes_view_and_ground(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text("2\n\nC 0 0 0\nC 0 0 2\n")
    top = ph.load(path, ph.LoadOptions(view="top", ground=True))
    assert [s.name for s in top.shapes] == ["particles", "key light", "ground"]
    assert isinstance(top.camera, ph.Framing)
    assert top.camera.direction == (0, 0, 1)
    low, high = bounds(top)
    assert high[2] - low[2] < 6


def test_backdrop_is_seen_and_lights_nothing() -> None:
    """Nor do mirrors and glass show it: what is around is there."""
    for material in (ph.Material("diffuse"), ph.Material("metal"), ph.Material("dielectric")):
        ball = ph.Spheres([[0, 0, 0]], 1.0, material)
        camera = ph.Camera(eye=(0, 0, 8), target=(0, 0, 0), vfov=20)
        scene = ph.Scene([ball], camera=camera, background=ph.Background("gradient"))
        prepared = ph.prepare(scene)
        plain, red = (
            ph.render(prepared, width=32, height=32, spp=16, filter="box", backdrop=b).numpy()
            for b in (None, (0.5, 0, 0))
        )
        corner, middle = (slice(0, 4), slice(0, 4)), (slice(12, 20), slice(12, 20))
        np.testing.assert_array_equal(red[corner], np.broadcast_to([0.5, 0, 0], (4, 4, 3)))
        np.testing.assert_array_equal(red[middle], plain[middle])
    hidden = ph.render(prepared, integrator="ao", width=32, height=32, spp=4, backdrop=(0.5, 0, 0))
    np.testing.assert_array_equal(hidden.numpy()[corner], red[corner])
    with pytest.raises(ph.SceneError, match=r"backdrop is 'red'; must be three numbers >= 0"):
        ph.render(prepared, backdrop="red")
    with pytest.raises(ph.SceneError, match=r"backdrop is \(1, 0, -1\)"):
        ph.render(prepared, backdrop=(1, 0, -1))


def test_a_ground_is_the_users_to_decide(tmp_path: Path) -> None:
    """With --background there is none, which would hide most of it, unless asked for."""
    from parhelion.cli import main
    from parhelion.image import read_pixels

    path, out = tmp_path / "a.obj", tmp_path / "a.png"
    path.write_text(TRIANGLE)
    flags = ["--width", "16", "--spp", "16", "--view", "iso", "-q", "-o", str(out)]
    red = ["--background", "red"]
    for words, covered in (
        ([*red], False),
        ([*red, "--ground"], True),
        ([*red, "--no-ground"], False),
    ):
        assert main(["render", str(path), *words, *flags]) == 0
        assert (tuple(read_pixels(out)[-1, 0, :3]) != (255, 0, 0)) == covered
    assert main(["render", str(path), *flags]) == 0
    with_ground = read_pixels(out)
    assert main(["render", str(path), "--no-ground", *flags]) == 0
    assert not np.array_equal(with_ground, read_pixels(out))


def test_background_flag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from parhelion.cli import main
    from parhelion.image import read_pixels

    path, out = tmp_path / "a.xyz", tmp_path / "a.png"
    path.write_text("1\n\nC 0 0 0\n")
    flags = ["--width", "16", "--height", "16", "--spp", "1", "-q", "-o", str(out)]
    assert main(["render", str(path), "--background", "#204060", *flags]) == 0
    np.testing.assert_array_equal(read_pixels(out, "test")[0, 0, :3], [0x20, 0x40, 0x60])
    with pytest.raises(SystemExit):
        main(["render", str(path), "--background", "whit", *flags])
    assert "'whit': a colour is needed, such as white or #rrggbb" in capsys.readouterr().err
