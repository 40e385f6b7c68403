"""KHR_lights_punctual and cameras: what stands at nodes and has no shape."""

from __future__ import annotations

from math import degrees, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene import Camera, Light, Settings
from ...studio import with_up
from . import schema
from .source import Source

# Luminous efficacy by which tools turn watts into lumens for glTF, lm / W: that of light of 555 nm,
# where it is largest; Blender's exporter for one.
LUMENS_PER_WATT = 683.0
# A white surface in less light than this, in lux, would be darker than 1 % of white if lux were
# taken as such: the file has lights without units, 1 being enough, as many games and viewers do.
_DARK = 0.01 * pi * LUMENS_PER_WATT
_KINDS = ("directional", "point", "spot")


def read(
    s: Source, seen: list[int], world: NDArray[np.float64], middle: NDArray[np.float64]
) -> list[Light]:
    """The lights of the scene. middle: of its shapes, where their brightness is judged."""
    document = s.extension(s.document, "KHR_lights_punctual", schema.Lights, "$")
    found: list[tuple[schema.Light, NDArray[np.float64], str]] = []
    for i in seen:
        node = s.document.nodes[i]
        where = f"nodes[{i}].extensions.KHR_lights_punctual"
        index = s.extension(node, "KHR_lights_punctual", schema.LightIndex, f"nodes[{i}]")
        if index is not None:
            lights = document.lights if document else []
            light = s.item(lights, "lights", index.light, f"{where}.light")
            if light.type not in _KINDS:
                raise s.error(
                    f"lights[{index.light}].type is {light.type[:20]!r}; must be one of"
                    f" {', '.join(_KINDS)}"
                )
            found.append((light, world[i], f"extensions.KHR_lights_punctual.lights[{index.light}]"))
    brightest = sum(_lux(light, matrix, middle) for light, matrix, _ in found)
    scale = 1.0 if 0.0 < brightest < _DARK else 1.0 / LUMENS_PER_WATT
    return [_light(s, light, matrix, scale, where) for light, matrix, where in found]


def _lux(light: schema.Light, matrix: NDArray[np.float64], middle: NDArray[np.float64]) -> float:
    """The illuminance that a light has at a point that faces it and lies in its beam."""
    if light.type == "directional":
        return light.intensity
    distance2 = float(np.sum((matrix[:3, 3] - middle) ** 2))
    return light.intensity / distance2 if distance2 > 0.0 else np.inf


def _light(
    s: Source, light: schema.Light, matrix: NDArray[np.float64], scale: float, where: str
) -> Light:
    r, g, b = (min(scale * light.intensity * c, 1e12) for c in light.color)
    position = tuple(matrix[:3, 3].tolist())
    if light.type == "point":
        return Light("point", intensity=(r, g, b), position=position)
    direction = tuple(_direction(s, -matrix[:3, 2], where).tolist())
    if light.type == "directional":
        return Light("directional", irradiance=(r, g, b), direction=direction)
    inner, outer = light.spot.inner_cone_angle, light.spot.outer_cone_angle
    if not 0.0 <= inner <= outer <= pi / 2 + 1e-3:
        raise s.error(
            f"{where}.spot: its cone angles are {inner:g} and {outer:g}; must be 0 <= inner <="
            " outer <= pi / 2"
        )
    return Light(
        "spot",
        intensity=(r, g, b),
        position=position,
        direction=direction,
        beam_width=degrees(inner),
        cutoff_angle=degrees(outer),
    )


def _direction(s: Source, vector: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    length = np.linalg.norm(vector)
    if not length > 0.0:
        raise s.error(f"{where}: its node is scaled to nothing; it has no direction")
    return np.asarray(vector / length)


def camera(
    s: Source, seen: list[int], world: NDArray[np.float64]
) -> tuple[Camera | None, Settings]:
    """The camera of these nodes, the first of several, and a picture of its proportions."""
    nodes = [i for i in seen if s.document.nodes[i].camera is not None]
    if not nodes:
        return None, Settings()
    index = s.document.nodes[nodes[0]].camera
    assert index is not None
    found = s.item(s.document.cameras, "cameras", index, f"nodes[{nodes[0]}].camera")
    where = f"cameras[{index}]"
    matrix = world[nodes[0]]
    towards, up = (_direction(s, v, where) for v in (-matrix[:3, 2], matrix[:3, 1]))
    params: dict[str, Any] = {
        "eye": tuple(matrix[:3, 3].tolist()),
        "target": tuple((matrix[:3, 3] + towards).tolist()),
        "up": tuple(up.tolist()),
        "mirrored": bool(np.linalg.det(matrix[:3, :3]) < 0.0),
    }
    if found.type == "perspective" and found.perspective is not None:
        aspect = found.perspective.aspectRatio
        params["vfov"] = degrees(found.perspective.yfov)
    elif found.type == "orthographic" and found.orthographic is not None:
        width, height = abs(found.orthographic.xmag), abs(found.orthographic.ymag)
        if not (width > 0.0 and height > 0.0):
            raise s.error(f"{where}.orthographic: xmag and ymag must not be 0")
        aspect = min(max(width / height, 1e-3), 1e3)
        params |= {"projection": "orthographic", "height": 2.0 * height}
    else:
        raise s.error(
            f"{where}.type is {found.type[:20]!r}; must be 'perspective' or 'orthographic', with"
            " the object of that name"
        )
    return with_up(Camera(**params), (0.0, 1.0, 0.0)), _size(aspect)


def _size(aspect: float | None) -> Settings:
    """A picture of these proportions whose longer side is as long as by default."""
    longer = Settings.width
    if aspect is None:
        return Settings()
    width = longer if aspect >= 1.0 else max(1, round(longer * aspect))
    height = longer if aspect < 1.0 else max(1, round(longer / aspect))
    return Settings(width=width, height=height)
