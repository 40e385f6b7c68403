"""LightSource: lights that are no shapes. AreaLightSource: what shapes emit.

Of version 4, "scale" is a factor, and "power" and "illuminance" say how much light there is in all;
both are measured before the RGB values, which only colour them (see colors.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...image import picture_shape
from ...scene import Background, Light, Texture
from ...spectra import LUMINANCE, luminance
from .colors import Color, scaled
from .items import Item
from .textures import Pixels, changed, multiplied, pixels
from .transforms import Matrix, invertible, nearest_rotation

# Our latitude-longitude frame, whose +y is up and whose left border is -z, from pbrt's, where +z is
# up and the left border +x
_LATLONG = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
# And from that of version 3's lamps, where +y is up, the left border +x, and +z a quarter on
_GONIOMETRIC = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def read(item: Item, to_world: Matrix) -> list[Light]:
    """The lights that a directive is."""
    function = LIGHTS.get(item.type)
    if function is None:
        item.report("not supported; ignored")
        return []
    if not invertible(to_world):
        raise item.error("the transformation has no inverse")
    made = function(item, to_world)
    item.ignore("samples", "nsamples", "shadowepsilon")
    item.finish()
    return made


def _scale(item: Item) -> Color:
    """The factor on what a light gives: a number, or a colour in version 3; and the exposure."""
    return scaled(item.plain("scale", 1.0, "light"), item.reader.exposure)


def _strength(item: Item, name: str, whole: float) -> Color:
    """Intensity or radiance; "power" says how much `whole` times it must give in all."""
    color = _times(item.plain(name, 1.0, "light"), _scale(item))
    power = item.number("power", -1.0)
    return scaled(color, power / whole) if power > 0.0 else color


def _times(a: Color, b: Color) -> Color:
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


def _point_of(item: Item, to_world: Matrix, name: str, default: Color) -> Color:
    x, y, z = (float(v) for v in to_world[:3, :3] @ item.vector(name, default) + to_world[:3, 3])
    return x, y, z


def _point(item: Item, to_world: Matrix) -> list[Light]:
    intensity = _strength(item, "I", 4.0 * math.pi)
    position = _point_of(item, to_world, "from", (0.0, 0.0, 0.0))
    return [Light("point", position=position, intensity=intensity)]


def _ends(item: Item, to_world: Matrix) -> tuple[Color, Color]:
    """Where a light is, and in which direction it shines."""
    start = _point_of(item, to_world, "from", (0.0, 0.0, 0.0))
    end = _point_of(item, to_world, "to", (0.0, 0.0, 1.0))
    x, y, z = (b - a for a, b in zip(start, end, strict=True))
    length = math.hypot(x, y, z)
    if not 0.0 < length < math.inf:
        raise item.error("'from' and 'to' must be different points")
    return start, (x / length, y / length, z / length)


def _spot(item: Item, to_world: Matrix) -> list[Light]:
    start, direction = _ends(item, to_world)
    cutoff = item.number("coneangle", 30.0)
    edge = item.number("conedeltaangle", 5.0)
    if not 0.0 < cutoff < 180.0 or not 0.0 <= edge <= cutoff:
        raise item.error(f"coneangle {cutoff:g} and conedeltaangle {edge:g} make no cone")
    item.report("the soft edge falls linearly with the angle")
    full, end = (math.cos(math.radians(a)) for a in (cutoff - edge, cutoff))
    whole = 2.0 * math.pi * ((1.0 - full) + 0.5 * (full - end))
    return [
        Light(
            "spot",
            intensity=_strength(item, "I", whole),
            position=start,
            direction=direction,
            cutoff_angle=cutoff,
            beam_width=cutoff - edge,
        )
    ]


def _distant(item: Item, to_world: Matrix) -> list[Light]:
    """Its "L" is what a surface that faces it receives."""
    _, direction = _ends(item, to_world)
    color = _times(item.plain("L", 1.0, "light"), _scale(item))
    illuminance = item.number("illuminance", -1.0)
    if illuminance > 0.0:
        color = scaled(color, illuminance)
    return [Light("directional", direction=direction, irradiance=color)]


def _image_file(item: Item) -> Texture:
    """The picture of a light, which each version calls by another name."""
    name = "mapname" if item.has("mapname") else "filename"
    path = item.file(name)
    linear = path.suffix.lower() in (".exr", ".hdr", ".pfm")
    return Texture("image", image=str(path), color_space="linear" if linear else "srgb")


def _infinite(item: Item, to_world: Matrix) -> list[Light]:
    if item.has("portal"):
        item.ignore("portal")
        item.report("a portal is not needed: all of the surroundings shine")
    if not item.has("filename") and not item.has("mapname"):
        color = _times(item.plain("L", 1.0, "light"), _scale(item))
        illuminance = item.number("illuminance", -1.0)
        if illuminance > 0.0:  # of one half of the surroundings
            color = scaled(color, illuminance / math.pi)
        return [Background("constant", radiance=color)]
    picture = _image_file(item)
    scale = _times(item.plain("L", 1.0, "light"), _scale(item))
    rotation, rigid = nearest_rotation(to_world[:3, :3])
    if not rigid:
        item.report(
            "its transformation shears, which a light's cannot; the nearest rotation is used"
        )
    square = item.has("filename") and not item.reader.old
    height, width, _ = picture_shape(picture.params["image"])
    if square and width != height:
        item.report(
            "its image is not square, which pbrt-v4's equal-area maps are: latitude and longitude"
        )
        square = False
    illuminance = item.number("illuminance", -1.0)
    if illuminance > 0.0:
        scale = scaled(scale, illuminance / _upper_illuminance(pixels(picture), square))
    return [
        Background(
            "envmap",
            image=picture.params["image"],
            color_space=picture.params["color_space"],
            scale=scale,
            mapping="equal_area" if square else "latlong",
            transform=rotation if square else rotation @ _LATLONG.T,
        )
    ]


def _upper_illuminance(values: Pixels, square: bool) -> float:
    """What a panorama at scale 1 sends on a horizontal surface, from where z is above 0."""
    height, width = values.shape[:2]
    light = values[:, :, :3] @ np.array(LUMINANCE)
    if square:
        # |z| of Clarberg's map is 1 - r^2, r being the distance from the middle or from the corners
        y, x = ((np.arange(n) + 0.5) * (2.0 / n) - 1.0 for n in (height, width))
        fold = 1.0 - np.add.outer(np.abs(y), np.abs(x))
        z = np.copysign(1.0 - (1.0 - np.abs(fold)) ** 2, fold)
        cell = np.full((height, width), 4.0 * math.pi / (height * width))
    else:
        theta = (np.arange(height) + 0.5) * (math.pi / height)
        z = np.broadcast_to(np.cos(theta)[:, None], (height, width))
        cell = np.broadcast_to(np.sin(theta)[:, None], (height, width))
        cell = cell * (2.0 * math.pi**2 / (height * width))
    return max(float((light * np.maximum(z, 0.0) * cell).sum()), 1e-30)


def _goniometric(item: Item, to_world: Matrix) -> list[Light]:
    """By a square of version 4, as its surroundings, else by latitude and longitude."""
    picture = _image_file(item)
    values = pixels(picture)[:, :, :3]
    square = not item.reader.old and values.shape[0] == values.shape[1]
    if square:
        share = luminance_of(values)
    else:
        theta = (np.arange(len(values)) + 0.5) * (math.pi / len(values))
        weight = np.sin(theta)[:, None, None] / np.sin(theta).mean()
        share = luminance_of(values * weight)
    frame = to_world.copy()
    rotation, _ = nearest_rotation(to_world[:3, :3])
    frame[:3, :3] = rotation if square else rotation @ _GONIOMETRIC
    frame[:3, 3] = _point_of(item, to_world, "from", (0.0, 0.0, 0.0))
    return [
        Light(
            "goniometric",
            image=picture.params["image"],
            color_space=picture.params["color_space"],
            intensity=_strength(item, "I", 4.0 * math.pi * share if share > 0.0 else 1.0),
            mapping="equal_area" if square else "latlong",
            transform=frame,
        )
    ]


def luminance_of(values: Any) -> float:
    """The luminance of an image's mean."""
    a, b, c = (float(x) for x in np.broadcast_to(values.mean(axis=(0, 1), dtype=np.float64), 3))
    return luminance((a, b, c))


def _projection(item: Item, to_world: Matrix) -> list[Light]:
    """Its image is intensity; ours is on a screen, where 1 / cos^3 makes up for the angle."""
    values = pixels(_image_file(item))[:, :, :3]
    fov = item.number("fov", 45.0 if item.reader.old else 90.0)
    if not 0.0 < fov < 180.0:
        raise item.error(f"fov is {fov:g}; must lie between 0 and 180")
    height, width = values.shape[:2]
    half = math.tan(math.radians(0.5 * fov)) / min(height, width)  # fov is of the shorter side
    y, x = (half * (2.0 * np.arange(n) + 1.0 - n) for n in (height, width))
    cosine = 1.0 / np.sqrt(1.0 + np.add.outer(y * y, x * x))
    # pbrt's first row is at -y and its first column at -x, ours at +y and +x
    image = np.broadcast_to(values, (height, width, 3)) * (cosine**3 / math.pi)[:, :, None]
    rotation, _ = nearest_rotation(to_world[:3, :3])
    frame = to_world.copy()
    frame[:3, :3] = rotation
    if item.number("power", -1.0) > 0.0:
        item.report("the power of a projection is not supported; its scale counts")
    return [
        Light(
            "projector",
            image=image[::-1, ::-1].astype(np.float32),
            color_space="linear",
            scale=_times(item.plain("I", 1.0, "light"), _scale(item)),
            fov=fov,
            fov_axis="y" if width > height else "x",
            transform=frame,
        )
    ]


LIGHTS: dict[str, Callable[[Item, Matrix], list[Light]]] = {
    "point": _point,
    "spot": _spot,
    "distant": _distant,
    "infinite": _infinite,
    "infinitesample": _infinite,
    "exinfinite": _infinite,
    "goniometric": _goniometric,
    "projection": _projection,
}


# Of shapes


def emission(item: Item, area: Callable[[], float]) -> tuple[Color | Texture, bool]:
    """Radiance, and whether the back shines too; area: of the shape, for what says its power."""
    if item.type not in ("diffuse", "area"):
        item.report("not supported; taken for diffuse")
    both = item.boolean("twosided", False)
    scale = _scale(item)
    radiance: Color | Texture
    mean = 1.0
    if item.has("filename"):
        picture = _image_file(item)
        mean = luminance_of(pixels(picture)[:, :, :3])
        # pbrt's image lies on the surface with its first row at v = 0
        upright = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]])
        picture = changed(picture, transform=upright, wrap_u="clamp", wrap_v="clamp")
        radiance = multiplied(picture, scale)
    else:
        radiance = _times(item.plain("L", 1.0, "light"), scale)
    power = item.number("power", -1.0)
    if power > 0.0:
        factor = power / max(mean * (2.0 if both else 1.0) * area() * math.pi, 1e-30)
        radiance = multiplied(radiance, (factor, factor, factor))
    item.ignore("samples", "nsamples", "shadowepsilon")
    item.finish()
    return radiance, both
