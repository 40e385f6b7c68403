"""<texture> and <spectrum type=...>."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ... import spectra
from ...scene import Texture
from . import transforms
from .document import Object
from .reader import Color, Matrix, Reader

# Mitsuba's v runs down a picture, ours up
_FLIP = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
# Files whose numbers are linear; those of all others are sRGB
_LINEAR = (".exr", ".hdr", ".rgbe", ".pfm")
_GREY: Color | Texture = (0.5, 0.5, 0.5)


def read(r: Reader, o: Object) -> Color | Texture:
    """The colour or texture that an object is."""
    if o.kind not in ("texture", "spectrum"):
        raise o.error("stands where a colour or a texture is needed")
    return r.make(o, TEXTURES, _GREY)


def _to_uv(r: Reader, o: Object) -> Matrix:
    """(3, 3): the part of a 4 by 4 matrix that moves (u, v)."""
    full = r.matrix(o, "to_uv")
    flat = np.eye(3)
    flat[:2, :2] = full[:2, :2]
    flat[:2, 2] = full[:2, 3]
    # version 0.x
    scale_u, scale_v = r.number(o, "uscale", 1.0), r.number(o, "vscale", 1.0)
    offset_u, offset_v = r.number(o, "uoffset", 0.0), r.number(o, "voffset", 0.0)
    return np.asarray(np.array([[scale_u, 0, offset_u], [0, scale_v, offset_v], [0, 0, 1]]) @ flat)


def _bitmap(r: Reader, o: Object) -> Texture:
    path = r.file(o)
    filters = {"bilinear": "bilinear", "nearest": "nearest", "trilinear": "mip", "ewa": "mip"}
    wraps = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp", "zero": "zero"}
    wrap = r.string(o, "wrap_mode", "repeat")
    wrap_u, wrap_v = (r.choice(o, f"wrap_mode_{axis}", wrap, wraps) for axis in "uv")
    linear = r.boolean(o, "raw", path.suffix.lower() in _LINEAR)
    if r.number(o, "gamma", 0.0) == 1.0:  # version 0.x
        linear = True
    r.ignore(o, "format", "accel")
    return Texture(
        "image",
        image=str(path),
        color_space="linear" if linear else "srgb",
        filter=r.choice(o, "filter_type", "bilinear", filters),
        wrap_u=wrap_u,
        wrap_v=wrap_v,
        transform=_FLIP @ _to_uv(r, o),
    )


def _checkerboard(r: Reader, o: Object) -> Texture:
    return Texture(
        "checker",
        color0=r.plain(o, "color0", 0.4),
        color1=r.plain(o, "color1", 0.2),
        filter="none",
        transform=_to_uv(r, o),
    )


def _mesh_attribute(r: Reader, o: Object) -> Texture:
    name = r.string(o, "name", "")
    if not name.startswith(("vertex_", "face_")):
        raise o.error(f"needs a name that begins with vertex_ or face_, not {name!r}")
    if r.number(o, "scale", 1.0) != 1.0:
        r.report(f"property 'scale' of {o}: not supported; ignored")
    return Texture("attribute", name=name)


def _uniform(r: Reader, o: Object) -> Color:
    value = r.number(o, "value", 1.0)
    r.ignore(o, "wavelength_min", "wavelength_max")
    return value, value, value


def _d65(r: Reader, o: Object) -> Color | Texture:
    color = r.plain(o, "color", 1.0)
    scale = r.number(o, "scale", 1.0)
    return color[0] * scale, color[1] * scale, color[2] * scale


def _srgb(r: Reader, o: Object) -> Color | Texture:
    r.ignore(o, "unbounded")
    return r.color(o, "color", 1.0)


def _regular(r: Reader, o: Object) -> Color:
    values = _numbers(r, o, "values")
    first, last = r.number(o, "wavelength_min", 360.0), r.number(o, "wavelength_max", 830.0)
    return _tabulated(o, np.linspace(first, last, max(len(values), 2)).tolist(), values)


def _irregular(r: Reader, o: Object) -> Color:
    return _tabulated(o, _numbers(r, o, "wavelengths"), _numbers(r, o, "values"))


def _tabulated(o: Object, wavelengths: list[float], values: list[float]) -> Color:
    convert = spectra.emission if o.in_emitter else spectra.reflectance
    return convert(wavelengths, values)


def _numbers(r: Reader, o: Object, name: str) -> list[float]:
    try:
        return transforms.numbers(r.string(o, name, ""))
    except ValueError as error:
        raise o.error(f"property {name!r}: {error}") from None


def _blackbody(r: Reader, o: Object) -> Color:
    color = spectra.blackbody(r.number(o, "temperature", 5000.0))
    scale = r.number(o, "scale", 1.0)
    return color[0] * scale, color[1] * scale, color[2] * scale


TEXTURES: dict[str, Callable[[Reader, Object], Color | Texture]] = {
    "bitmap": _bitmap,
    "checkerboard": _checkerboard,
    "mesh_attribute": _mesh_attribute,
    "uniform": _uniform,
    "d65": _d65,
    "srgb": _srgb,
    "regular": _regular,
    "irregular": _irregular,
    "blackbody": _blackbody,
}
