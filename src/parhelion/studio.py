"""A view, light and a ground for what brings none of its own.

`dressed` is what every loaded file goes through.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import cos, radians, sin
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import SceneError, unknown_name
from .framing import reach, subject
from .scene import (
    Background,
    Camera,
    Disks,
    Framing,
    Instances,
    Material,
    Scene,
    Shape,
    Spheres,
    Texture,
    Vec3,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.floating[Any]]

# Where the camera stands, seen from the middle: degrees from the front towards the right, and
# degrees above the horizon.
VIEWS: Mapping[str, tuple[float, float]] = {
    "default": (30.0, 22.0),
    "front": (0.0, 0.0),
    "back": (180.0, 0.0),
    "left": (-90.0, 0.0),
    "right": (90.0, 0.0),
    "top": (0.0, 90.0),
    "bottom": (0.0, -90.0),
    "iso": (45.0, 35.264390),  # the cube's diagonal: asin(1 / sqrt(3))
}

# The camera: vertical field of view in degrees, and the share of the picture's half that is filled.
_VFOV = 30.0
_FILL = 0.92

# The light, as radiances. A white diffuse thing (albedo 0.85) comes out near 0.35 in the shade and
# 0.85 where it faces the key, so no colour clips and shapes stay readable. The sky is bright behind
# the things and dim behind the camera: a bright page to look at that does not wash out the side we
# see.
_SKY_BEHIND_THINGS = 0.78
_SKY_BEHIND_CAMERA = 0.28
# The key light: the irradiance/pi it gives a surface that faces it, its half-angle in degrees as
# the things see it (a wide one casts soft shadows), its direction in the camera's frame (right, up,
# towards the camera), and its distance in units of the things' bounding radius.
_KEY_STRENGTH = 0.58
_KEY_HALF_ANGLE = 15.0
_KEY_DIRECTION = (-0.6, 0.8, 0.7)
_KEY_DISTANCE = 24.0
_KEY_NAME = "key light"
_KEY_SIZE = sin(radians(_KEY_HALF_ANGLE))  # radius over distance
_KEY = Material("emissive", radiance=(_KEY_STRENGTH / _KEY_SIZE**2,) * 3)
_SKY = {"horizon": (_SKY_BEHIND_THINGS,) * 3, "zenith": (_SKY_BEHIND_CAMERA,) * 3}

# The ground is a disk that lies exactly as low as the lowest point: a flat bottom neither floats
# nor sinks. It is this many times larger than the things' bounding sphere: without an end, to the
# eye.
_GROUND_SIZE = 200.0
_GROUND_ALBEDO = 0.85
_GROUND_NAME = "ground"
# In the studio's light it is as bright as the sky behind it, as far as an albedo can make it so,
# and becomes one with it, all clear at this many radii: no horizon crosses the picture.
_FADE_SIZE = 12.0
_MOST_ALBEDO = 0.9
_FADE = Texture("ramp", color0=(1.0,) * 3, color1=(0.0,) * 3, shape="smooth")


def dressed(
    scene: Scene,
    *,
    view: str | None = None,
    environment: str | PathLike[str] | None = None,
    ground: bool | None = None,
    bare: bool = False,
    glow: float = 0.0,
    standing: tuple[type[Shape], ...] = (),
) -> Scene:
    """The scene with what the user asks for.

    view: one of VIEWS, instead of the scene's own camera. environment: a picture of all that is
    around, instead of the scene's background, its middle behind the things as seen from the front.
    ground: below the lowest point; None for one where there are shapes of the kinds in `standing`,
    light is added, and the camera is not below. bare: the scene may lack what makes a picture of
    it: a view, if it has no camera, and a soft sky and a key light, placed by the camera, if it has
    no light. glow: radiance up to which surfaces that emit are no light, but glow for show.

    Raises SceneError for an unknown view.
    """
    up = up_of(scene)
    about = tuple(shape.name for shape in scene.shapes)
    if view is not None:
        scene = scene.replace(camera=framing(up, view))
    elif scene.camera is None and bare:
        scene = scene.replace(camera=framing(up))
    if isinstance(scene.camera, Framing) and not scene.camera.shapes:
        # What is added here is not what the picture is about.
        scene = scene.replace(camera=replace(scene.camera, shapes=about))
    if environment is not None:
        # A panorama's y axis is up, and z, in its middle, points away from the camera's front.
        turn = upright(up) * [-1.0, 1.0, -1.0]
        scene = scene.replace(
            background=Background("envmap", image=environment, transform=turn.tolist())
        )
    dark = bare and is_dark(scene, glow)
    if ground is None:
        stands = any(isinstance(shape, standing) for shape in scene.shapes)
        ground = dark and stands and _above(scene, up)
    things = without_light(scene)
    middle, radius = reach(things) if dark or ground else (np.zeros(3), 0.0)
    if dark:
        scene = _lit(scene, middle, radius)
    if ground and radius > 0.0:
        level = _lowest(things, up)
        scene = scene.replace(shapes=(*scene.shapes, _ground(scene, up, middle, radius, level)))
    return scene


def framing(up: Vec3 = (0.0, 1.0, 0.0), view: str = "default") -> Framing:
    """A camera that looks at everything from one of VIEWS.

    The front is towards -y where z is up, as in CAD, else towards +z, as in glTF.
    """
    if view not in VIEWS:
        raise SceneError(unknown_name("view", view, VIEWS))
    right, above, front = upright(up).T
    azimuth, elevation = (radians(angle) for angle in VIEWS[view])
    level = cos(azimuth) * front + sin(azimuth) * right
    if abs(VIEWS[view][1]) == 90.0:
        return Framing(
            _tuple(sin(elevation) * above), _tuple(-sin(elevation) * front), _VFOV, _FILL
        )
    towards = cos(elevation) * level + sin(elevation) * above
    return Framing(_tuple(towards), _tuple(above), _VFOV, _FILL)


def axis(name: str) -> Vec3:
    """The direction of "x", "y" or "z", or of "-x" and so on. Raises SceneError for others."""
    names = ("x", "y", "z", "-x", "-y", "-z")
    if name not in names:
        raise SceneError(unknown_name("axis", name, names))
    x, y, z = np.eye(3)[names.index(name) % 3] * (-1.0 if name[0] == "-" else 1.0) + 0.0
    return float(x), float(y), float(z)


def up_of(scene: Scene) -> Vec3:
    """The axis that the scene's camera holds to be up, roughly; y if there is no camera."""
    camera = scene.camera
    if camera is None or not np.all(np.isfinite(camera.up)) or not np.any(camera.up):
        return (0.0, 1.0, 0.0)
    axis = int(np.argmax(np.abs(camera.up)))
    return _tuple(np.eye(3)[axis] * np.sign(camera.up[axis]))


def with_up(camera: Camera, up: Vec3) -> Camera:
    """A camera that sees the same, and whose `up` is as near to the scene's as that allows.

    For up_of() to find the latter: what is up in the picture of a camera that looks down steeply
    may be nearer to another axis. Any sum of that and of the line of sight makes the same picture.
    """
    right, towards = _towards(camera)
    above, wanted = np.cross(towards, right), np.array(up)
    along, rise = float(wanted @ towards), float(wanted @ above)
    # never so much of the line of sight that the rest would be lost
    new = above + along / max(rise, abs(along) / 4.0) * towards if along else above
    new /= np.linalg.norm(new)
    return replace(camera, up=up if np.allclose(new, wanted, rtol=0.0, atol=1e-6) else _tuple(new))


def upright(up: Vec3) -> NDArray[np.float64]:
    """(3, 3), its columns right, up and front, of unit length."""
    above = np.array(up, np.float64) / np.linalg.norm(up)
    front = np.array([0.0, -1.0, 0.0] if abs(above[2]) > 0.7 else [0.0, 0.0, 1.0])
    front -= above * (front @ above)
    front /= np.linalg.norm(front)
    return np.stack([np.cross(above, front), above, front], axis=1)


def _materials(scene: Scene, shapes: Iterable[Shape]) -> Iterable[Material]:
    yield from scene.materials.values()
    for shape in shapes:
        if isinstance(shape, Instances):
            yield from _materials(Scene(), shape.shapes)
        elif isinstance(shape.material, Material):
            yield shape.material


def _shines(material: Material, glow: float) -> bool:
    return material.type == "emissive" or _most(material.params.get("emission", 0.0)) > glow


def _most(value: object) -> float:
    """The largest number that a colour or a texture may have, of a picture file 1."""
    if not isinstance(value, Texture):
        return float(np.max(np.asarray(value, np.float64)))
    image = value.params.get("image")
    if image is not None:
        stored = hasattr(image, "dtype") and image.dtype.kind == "f" and image.size
        return float(image.max()) if stored else 1.0
    parts = [_most(v) for k, v in value.params.items() if k in ("color0", "color1", "color")]
    return float(np.prod(parts)) if value.type == "multiply" else max(parts, default=1.0)


def is_dark(scene: Scene, glow: float = 0.0) -> bool:
    """Whether it has no light; glow: as of dressed()."""
    if scene.lights or scene.background is not None:
        return False
    return not any(_shines(m, glow) for m in _materials(scene, scene.shapes))


def _towards(camera: Camera | Framing | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors to the right of the picture and towards the camera."""
    assert camera is not None
    if isinstance(camera, Framing):
        towards = np.array(camera.direction, np.float64)
    else:
        towards = np.subtract(camera.eye, camera.target, dtype=np.float64)
    right = np.cross(camera.up, towards)
    if not (np.linalg.norm(right) > 0):  # a camera that will be refused
        return np.eye(3)[0], np.eye(3)[2]
    return right / np.linalg.norm(right), towards / np.linalg.norm(towards)


def _lit(scene: Scene, middle: Array, radius: float) -> Scene:
    """A sky that is bright behind the things, and a sphere that shines, up and to the side, behind
    or far outside of what the camera sees. middle, radius: of the things.
    """
    right, towards = _towards(scene.camera)
    sky = Background("gradient", **_SKY, up=_tuple(towards))
    if not radius > 0.0:
        return scene.replace(background=sky)
    distance = _KEY_DISTANCE * radius
    direction = np.array(_KEY_DIRECTION) @ (right, np.cross(towards, right), towards)
    place = middle + distance / np.linalg.norm(direction) * direction
    key = Spheres([_tuple(place)], distance * _KEY_SIZE, _KEY, None, _KEY_NAME)
    return scene.replace(background=sky, shapes=(*scene.shapes, key))


def turned_light(scene: Scene, rotation: Array, pivot: Array) -> Scene:
    """The scene with the light that dressed() gave it turned about a place; others stay.

    rotation: (3, 3). The scene itself if there is nothing to turn.
    """
    up = _studio_up(scene)
    if up is None or np.array_equal(rotation, np.eye(3)):
        return scene
    turned = Background("gradient", **_SKY, up=_tuple(rotation @ np.array(up)))
    shapes = []
    for shape in scene.shapes:
        if _is_key(shape):
            assert isinstance(shape, Spheres)
            place = pivot + (np.asarray(shape.centers) - pivot) @ rotation.T
            shape = replace(shape, centers=place)
        shapes.append(shape)
    return scene.replace(background=turned, shapes=shapes)


def without_light(scene: Scene) -> Scene:
    """The scene without the light that dressed() gave it, and the ground in that light; the scene
    itself if there is none.
    """
    if _studio_up(scene) is None:
        return scene
    kept = [shape for shape in scene.shapes if not (_is_key(shape) or _is_ground(shape))]
    return scene.replace(background=None, shapes=kept)


def _studio_up(scene: Scene) -> Vec3 | None:
    """Where the sky that dressed() gave the scene is dim; None if it has another one."""
    sky = scene.background
    up = None if sky is None else sky.params.get("up")
    return up if up is not None and sky == Background("gradient", **_SKY, up=up) else None


def _is_key(shape: Shape) -> bool:
    return isinstance(shape, Spheres) and shape.name == _KEY_NAME and shape.material == _KEY


def _ground(scene: Scene, up: Vec3, middle: Array, radius: float, level: float) -> Disks:
    """A disk at a coordinate along the axis that is up. middle, radius: of the things."""
    center = middle.astype(np.float64)
    center[int(np.argmax(np.abs(up)))] = level
    fades = _studio_up(scene) is not None
    right, _, front = upright(up).T * ((_FADE_SIZE if fades else _GROUND_SIZE) * radius)
    look = _fading(_even_albedo(scene, up)) if fades else _gray(_GROUND_ALBEDO)
    return Disks([_tuple(center)], [_tuple(front)], [_tuple(right)], look, None, _GROUND_NAME)


def _is_ground(shape: Shape) -> bool:
    """Whether it is the ground in the studio's light."""
    look = getattr(shape, "material", None)
    if not (isinstance(shape, Disks) and shape.name == _GROUND_NAME and isinstance(look, Material)):
        return False
    color = look.params.get("color")
    return isinstance(color, tuple) and look == _fading(color[0])


def _gray(albedo: float, **common: Any) -> Material:
    return Material("diffuse", color=(albedo,) * 3, **common)


def _fading(albedo: float) -> Material:
    """Of a disk: grey at its middle, nothing at its rim, and nothing from below, so that it hides
    nothing from cameras that come later.
    """
    return _gray(albedo, opacity=_FADE, back=Material("null"))


def _even_albedo(scene: Scene, up: Vec3) -> float:
    """With which the ground, where nothing shades it, is as bright as the sky behind the things."""
    right, towards = _towards(scene.camera)
    key = np.array(_KEY_DIRECTION) @ (right, np.cross(towards, right), towards)
    sine = float(key @ up) / float(np.linalg.norm(key))
    # Radiance a + b cos of the angle to an axis gives a plane the irradiance pi (a + 2/3 b cos of
    # the angle between its normal and that axis).
    a = 0.5 * (_SKY_BEHIND_CAMERA + _SKY_BEHIND_THINGS)
    b = 0.5 * (_SKY_BEHIND_CAMERA - _SKY_BEHIND_THINGS)
    light = _KEY_STRENGTH * max(sine, 0.0) + a + 2.0 / 3.0 * b * float(towards @ np.array(up))
    return min(_SKY_BEHIND_THINGS / light, _MOST_ALBEDO)


def _above(scene: Scene, up: Vec3) -> bool:
    """Whether the camera stands above the lowest point, or looks down where it is yet to stand."""
    if isinstance(scene.camera, Camera):
        axis = int(np.argmax(np.abs(up)))
        return bool((scene.camera.eye[axis] - _lowest(scene, up)) * up[axis] > 0.0)
    return bool(_towards(scene.camera)[1] @ np.array(up) >= 0.0)


def _lowest(scene: Scene, up: Vec3) -> float:
    """The coordinate, along the axis that is up, of the lowest point."""
    axis = int(np.argmax(np.abs(up)))
    sign = float(np.sign(up[axis]))
    ends = [float(np.min(sign * c[:, axis] - r)) for c, r in subject(scene)]
    return sign * min(ends, default=np.inf)


def _tuple(vector: NDArray[np.float64]) -> Vec3:
    x, y, z = (float(v) + 0.0 for v in vector)  # no -0.0
    return x, y, z
