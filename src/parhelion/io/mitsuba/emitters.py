"""<emitter>: lights. One in a shape makes the shape's material shine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...scene import Background, Light, Texture
from .document import Object
from .reader import Color, Matrix, Reader


def read(r: Reader, o: Object) -> Sequence[Light]:
    """The lights that an object is; those of surfaces come with the shapes that refer to them."""
    if o.type in _AREAS:
        return ()
    return r.make(o, EMITTERS, ())


def area(r: Reader, o: Object) -> Color | Texture | None:
    """The radiance of the front of the shape that the emitter stands in."""
    return r.make(o, _AREAS, None)


def split(r: Reader, lights: Sequence[Light]) -> tuple[Light | None, list[Light]]:
    """The surroundings, of which there is one, and the other lights."""
    around = [light for light in lights if isinstance(light, Background)]
    others = [light for light in lights if not isinstance(light, Background)]
    if len(around) > 1:
        r.report("a second environment (constant, envmap, sky): only the first is used")
    return (around[0] if around else None), others


def _area(r: Reader, o: Object) -> Color | Texture:
    r.ignore(o, "sampling_weight")
    return r.color(o, "radiance", 1.0)


def _rigid(o: Object, matrix: Matrix) -> Matrix:
    """A rotation and a translation; a light's scale means nothing."""
    linear = matrix[:3, :3]
    size = np.linalg.norm(linear, axis=0)
    if not (size > 0.0).all():
        raise o.error("its transform cannot be inverted")
    result: Matrix = matrix.copy()
    result[:3, :3] = linear / size
    if np.abs(result[:3, :3].T @ result[:3, :3] - np.eye(3)).max() > 1e-3:
        raise o.error("its transform shears; a light's must be a rotation and a translation")
    return result


def _position(r: Reader, o: Object) -> Color:
    if r.has(o, "position"):
        return r.vector(o, "position", (0.0, 0.0, 0.0))
    x, y, z = (float(v) for v in r.matrix(o)[:3, 3])
    return x, y, z


def _point(r: Reader, o: Object) -> Sequence[Light]:
    r.ignore(o, "sampling_weight")
    intensity = r.plain(o, "intensity", 1.0)
    return [Light("point", position=_position(r, o), intensity=intensity)]


def _spot(r: Reader, o: Object) -> Sequence[Light]:
    r.ignore(o, "sampling_weight")
    if r.get(o, "texture") is not None:
        r.report(f"property 'texture' of {o}: not supported; ignored")
    cutoff = r.number(o, "cutoff_angle", 20.0)
    return [
        Light(
            "spot",
            intensity=r.plain(o, "intensity", 1.0),
            position=_position(r, o),
            direction=tuple(_rigid(o, r.matrix(o))[:3, 2].tolist()),
            cutoff_angle=cutoff,
            beam_width=r.number(o, "beam_width", 0.75 * cutoff),
        )
    ]


def _projector(r: Reader, o: Object) -> Sequence[Light]:
    r.ignore(o, "sampling_weight", "to_uv")
    picture = r.color(o, "irradiance", 1.0)
    scale = r.number(o, "scale", 1.0)
    params: dict[str, Any] = {"scale": (scale,) * 3}
    if isinstance(picture, Texture) and picture.type == "image":
        params["image"] = picture.params["image"]
        params["color_space"] = picture.params["color_space"]
    elif isinstance(picture, Texture):
        r.report(f"property 'irradiance' of {o}: only a bitmap or a colour is supported; white")
        params["image"] = np.ones((1, 1, 3), np.float32)
    else:
        params["image"] = np.array(picture, np.float32).reshape(1, 1, 3)
    if not r.has(o, "fov"):
        raise o.error("needs a fov; a focal_length is not supported")
    return [
        Light(
            "projector",
            fov=r.number(o, "fov", 45.0),
            fov_axis=r.choice(o, "fov_axis", "x", {"x": "x", "y": "y"}),
            transform=_rigid(o, r.matrix(o)),
            **params,
        )
    ]


def _directional(r: Reader, o: Object) -> Sequence[Light]:
    r.ignore(o, "sampling_weight")
    if r.has(o, "direction"):
        direction = r.vector(o, "direction", (0.0, 0.0, 1.0))
    else:
        x, y, z = (float(v) for v in r.matrix(o)[:3, 2])
        direction = (x, y, z)
    return [Light("directional", direction=direction, irradiance=r.plain(o, "irradiance", 1.0))]


def _constant(r: Reader, o: Object) -> Sequence[Light]:
    r.ignore(o, "sampling_weight", "to_world")
    return [Background("constant", radiance=r.plain(o, "radiance", 1.0))]


def _envmap(r: Reader, o: Object) -> Sequence[Light]:
    r.ignore(o, "sampling_weight", "mis_compensation")
    path = r.file(o)
    matrix = _rigid(o, r.matrix(o))
    linear = path.suffix.lower() in (".exr", ".hdr", ".rgbe", ".pfm")
    return [
        Background(
            "envmap",
            image=str(path),
            color_space="linear" if linear else "srgb",
            scale=(r.number(o, "scale", 1.0),) * 3,
            transform=matrix[:3, :3],
        )
    ]


EMITTERS: dict[str, Callable[[Reader, Object], Sequence[Light]]] = {
    "point": _point,
    "spot": _spot,
    "projector": _projector,
    "directional": _directional,
    "constant": _constant,
    "envmap": _envmap,
}

_AREAS: dict[str, Callable[[Reader, Object], Color | Texture | None]] = {"area": _area}
