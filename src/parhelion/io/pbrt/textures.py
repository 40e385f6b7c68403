"""Texture: colours and numbers that vary over a surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ...image import read_pixels
from ...scene import Texture
from ...spectra import decode_srgb, luminance
from .colors import Color
from .items import Item
from .transforms import Matrix

Value = Color | Texture
Pixels = NDArray[np.float32]

# Files whose numbers are linear; those of all others are sRGB
_LINEAR = (".exr", ".hdr", ".pfm")
_GREY: Color = (0.5, 0.5, 0.5)
_WHITE: Color = (1.0, 1.0, 1.0)
_BLACK: Color = (0.0, 0.0, 0.0)


def read(item: Item, kind: str, to_world: Matrix) -> Value:
    """The colour or texture that a Texture directive defines; kind: "float" or "spectrum"."""
    function = TEXTURES.get(item.type)
    if function is None:
        item.report("not supported; its mean or 0.5 is used")
        return _GREY
    made = function(item, to_world)
    item.ignore("displacement")
    item.finish()
    if kind == "float" and not isinstance(made, Texture):
        return (luminance(made),) * 3
    return made


# Computing with textures


def changed(texture: Texture, **params: object) -> Texture:
    """The texture with parameters replaced."""
    return Texture(texture.type, **{**texture.params, **params})


def pixels(texture: Texture) -> Pixels:
    """(H, W, C) linear values of an image texture."""
    image = texture.params["image"]
    if not isinstance(image, str):
        return np.asarray(image, np.float32)
    found = read_pixels(image)
    values = np.asarray(found, np.float32)
    if found.dtype.kind in "iu":
        values = values / np.float32(np.iinfo(found.dtype).max)
    if texture.params["color_space"] == "srgb":
        values[:, :, :3] = decode_srgb(values[:, :, :3])
    return values


def mapped(value: Value, function: Callable[[Pixels], Pixels]) -> Value:
    """The texture with a function applied to its pixels and colours.

    Of a product, that is right for powers; of a mixture, where the weight is 0 or 1.
    """
    if not isinstance(value, Texture):
        a, b, c = (float(x) for x in function(np.array(value, np.float32)))
        return a, b, c
    if value.type == "image":
        values = pixels(value)
        values = np.concatenate([function(values[:, :, :3]), values[:, :, 3:]], axis=2)
        return changed(value, image=values.astype(np.float32), color_space="linear")
    return changed(value, **{k: mapped(value.params[k], function) for k in ("color0", "color1")})


def multiplied(a: Value, b: Value) -> Value:
    """The product of two."""
    if isinstance(a, Texture) or isinstance(b, Texture):
        one = ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
        if (a, b)[isinstance(a, Texture)] in one:  # by 1
            return (b, a)[isinstance(a, Texture)]
        return Texture("multiply", color0=a, color1=b)
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


def mixed(a: Value, b: Value, weight: Value) -> Value:
    """Both, of the second so much as `weight` says."""
    if isinstance(weight, Texture):
        return Texture("mix", color0=a, color1=b, weight=weight)
    share = min(max(luminance(weight), 0.0), 1.0)
    if isinstance(a, Texture) or isinstance(b, Texture):
        return Texture("mix", color0=a, color1=b, weight=share)
    x, y, z = ((1.0 - share) * p + share * q for p, q in zip(a, b, strict=True))
    return x, y, z


# Where on a surface


def _to_uv(item: Item) -> Matrix:
    """(3, 3): what is applied to (u, v, 1)."""
    mapping = item.string("mapping", "uv")
    if mapping != "uv":
        item.ignore("v1", "v2")
        item.report(f"mapping {mapping!r} is not supported; uv is used")
    result = np.eye(3)
    result[0, 0], result[1, 1] = item.number("uscale", 1.0), item.number("vscale", 1.0)
    result[0, 2], result[1, 2] = item.number("udelta", 0.0), item.number("vdelta", 0.0)
    return result


# The types


def _constant(item: Item, _: Matrix) -> Value:
    return item.color("value", _WHITE)


def _image(item: Item, _: Matrix) -> Value:
    path = item.file("filename")
    wraps = {"repeat": "repeat", "black": "zero", "clamp": "clamp", "octahedralsphere": "clamp"}
    wrap = item.choice("wrap", "repeat", wraps)
    filters = {"point": "nearest", "bilinear": "mip", "trilinear": "mip", "ewa": "mip"}
    # all of them but "point" choose a level of detail, as our "mip" does
    filter = item.choice("filter", "bilinear", {**filters, "EWA": "mip"})
    item.ignore("maxanisotropy", "trilinear")
    linear = path.suffix.lower() in _LINEAR
    encoding = item.string("encoding", "linear" if linear else "sRGB")
    if item.has("gamma"):  # version 3: whether to decode; before, an exponent
        gamma = item.parameters["gamma"]
        item.ignore("gamma")
        linear = not gamma.values[0] if gamma.type == "bool" else float(gamma.values[0]) == 1.0
    elif encoding.lower() in ("linear", "srgb"):
        linear = linear or encoding == "linear"
    texture: Value = Texture(
        "image",
        image=str(path),
        color_space="linear" if linear or encoding.startswith("gamma") else "srgb",
        filter=filter,
        wrap_u=wrap,
        wrap_v=wrap,
        transform=_to_uv(item),
    )
    if encoding.startswith("gamma"):
        try:
            exponent = float(encoding.removeprefix("gamma"))
        except ValueError:
            raise item.error(f"encoding {encoding!r}; must be such as 'gamma 2.2'") from None
        texture = mapped(texture, lambda x: np.power(x, exponent))
    elif encoding.lower() not in ("linear", "srgb"):
        raise item.error(f"encoding {encoding!r}; must be linear, sRGB or gamma and a number")
    scale, invert = item.number("scale", 1.0), item.boolean("invert", False)
    if invert:
        texture = mapped(texture, lambda x: np.maximum(1.0 - x, 0.0))
    return multiplied(texture, (scale, scale, scale))


def _checkerboard(item: Item, _: Matrix) -> Value:
    parts = item.color("tex1", _WHITE), item.color("tex2", _BLACK)
    item.ignore("aamode")
    if item.integer("dimension", 2) != 2:
        item.report("three dimensions are not supported; the mean of both is used")
        return mixed(*parts, (0.5, 0.5, 0.5))
    # our unit square of uv has two fields along each side, pbrt's one
    halved = np.diag([0.5, 0.5, 1.0]) @ _to_uv(item)
    return Texture("checker", color0=parts[0], color1=parts[1], transform=halved)


def _scale(item: Item, _: Matrix) -> Value:
    names = ("tex", "scale") if item.has("tex") or item.has("scale") else ("tex1", "tex2")
    return multiplied(*(item.color(name, _WHITE) for name in names))


def _mix(item: Item, _: Matrix) -> Value:
    return mixed(item.color("tex1", _BLACK), item.color("tex2", _WHITE), item.color("amount", 0.5))


def _direction_mix(item: Item, _: Matrix) -> Value:
    item.ignore("dir")
    item.report("a mixture by direction is not supported; half of each is used")
    return mixed(item.color("tex1", _BLACK), item.color("tex2", _WHITE), (0.5, 0.5, 0.5))


def _bilerp(item: Item, _: Matrix) -> Value:
    """An image of two by two texels, whose centres are moved to the corners of uv."""
    corners = [
        item.plain(f"v{c}", d) for c, d in (("01", 1.0), ("11", 1.0), ("00", 0.0), ("10", 0.0))
    ]
    return _corners(item, corners)


def _uv(item: Item, _: Matrix) -> Value:
    return _corners(item, [(0.0, 1.0, 0.0), (1.0, 1.0, 0.0), _BLACK, (1.0, 0.0, 0.0)])


def _corners(item: Item, colors: Sequence[Color]) -> Texture:
    """colors: at the top left, top right, bottom left and bottom right."""
    inwards = np.array([[0.5, 0.0, 0.25], [0.0, 0.5, 0.25], [0.0, 0.0, 1.0]])
    return Texture(
        "image",
        image=np.array(colors, np.float32).reshape(2, 2, 3),
        color_space="linear",
        filter="bilinear",
        wrap_u="clamp",
        wrap_v="clamp",
        transform=inwards @ _to_uv(item),
    )


def _dots(item: Item, _: Matrix) -> Value:
    item.report("dots are not supported; what is outside of them is used")
    item.color("inside", _WHITE)
    _to_uv(item)
    return item.color("outside", _BLACK)


def _noise(shape: str, octaves: int) -> Callable[[Item, Matrix], Value]:
    def make(item: Item, to_world: Matrix) -> Value:
        item.report("rendered by our noise, which looks alike and is another")
        size = float(np.cbrt(abs(np.linalg.det(to_world[:3, :3])))) / item.number("scale", 1.0)
        if not 0.0 < size < np.inf:
            raise item.error("its scale, or the transformation's, is 0 or not finite")
        item.ignore("variation")
        return Texture(
            "noise",
            color0=_BLACK,
            color1=_WHITE,
            size=size,
            octaves=min(item.integer("octaves", octaves, 1), 16),
            gain=min(max(item.number("roughness", 0.5), 0.0), 1.0),
            shape=shape,
        )

    return make


def _marble(item: Item, to_world: Matrix) -> Value:
    veins = _noise("turbulence", 8)(item, to_world)
    assert isinstance(veins, Texture)
    return changed(veins, color0=(0.58, 0.58, 0.6), color1=(0.3, 0.28, 0.4))


def _ptex(item: Item, _: Matrix) -> Value:
    item.ignore("filename", "encoding", "gamma", "scale")
    item.report("Ptex files are not supported; 0.5 is used")
    return _GREY


TEXTURES: dict[str, Callable[[Item, Matrix], Value]] = {
    "constant": _constant,
    "imagemap": _image,
    "checkerboard": _checkerboard,
    "scale": _scale,
    "mix": _mix,
    "directionmix": _direction_mix,
    "bilerp": _bilerp,
    "uv": _uv,
    "dots": _dots,
    "fbm": _noise("fbm", 8),
    "wrinkled": _noise("turbulence", 8),
    "windy": _noise("fbm", 6),
    "marble": _marble,
    "ptex": _ptex,
}
