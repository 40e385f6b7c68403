"""Images and textures: the pixels, and what has to be computed from them before rendering.

Factors are textures that multiply. Cutoffs and curves are applied to the texels once; whole numbers
go through a table of all their values, which costs no more than a copy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ... import scene
from ...errors import FormatError
from ...image import PictureBytes, picture_shape, read_pixels
from ...spectra import decode_srgb
from . import schema
from .source import Source

T = TypeVar("T")
Curve = Callable[[NDArray[Any]], NDArray[Any]]
Color = tuple[float, float, float]

# OpenGL's numbers for wrap modes and for the filter between texels
_WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
_NEAREST = 9728
# In glTF v runs down a picture, here up
_FLIP = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
# How the files of images begin that glTF and its extensions may have
_KINDS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"RIFF")
_KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"


class Images:
    """The images of a document, each read once."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._stored: dict[int, str | PictureBytes | None] = {}
        self._channels: dict[int, int] = {}
        self._pixels: dict[int, NDArray[Any]] = {}
        self._made: dict[tuple[Any, ...], NDArray[Any]] = {}

    # Textures

    def uv_set(self, info: schema.TextureInfo, where: str) -> int:
        """Which of a mesh's sets of texture coordinates it lies on."""
        moved = self._transform(info, where)
        return info.tex_coord if moved is None or moved.tex_coord is None else moved.tex_coord

    def color(
        self, info: schema.TextureInfo, factor: Color, where: str, uvs: str | None
    ) -> scene.Texture | None:
        """A texture of encoded colours, times a linear factor; None if its image cannot be read.

        uvs: here and below, as in scene.Texture.
        """
        image = self.source_of(info, where)
        if image is None:
            return None
        return times(self._texture(info, where, self._stored[image], "srgb", uvs), factor)

    def plain(self, info: schema.TextureInfo, where: str, uvs: str | None) -> scene.Texture | None:
        """A texture of linear values as they are."""
        image = self.source_of(info, where)
        if image is None:
            return None
        return self._texture(info, where, self._stored[image], "linear", uvs)

    def number(
        self,
        info: schema.TextureInfo,
        channel: int,
        factor: float,
        curve: Curve | None,
        where: str,
        uvs: str | None,
    ) -> scene.Texture | None:
        """A texture of numbers: a channel times a factor, or what a curve makes of that."""
        image = self.source_of(info, where)
        if image is None:
            return None
        if curve is None:
            name = "rgba"[channel]
            found = self._texture(info, where, self._stored[image], "linear", uvs, channel=name)
            return times(found, (factor,) * 3)

        def mapped() -> NDArray[Any]:
            def whole(x: NDArray[Any]) -> NDArray[Any]:
                return curve(np.float32(factor) * x)

            values = _mapped(_channel(self.pixels(image), channel), whole)
            return to_bytes(values) if values.min() >= 0.0 and values.max() <= 1.0 else values

        made = self._once(("number", image, channel, factor, curve), where, mapped)
        return self._texture(info, where, made, "linear", uvs, channel="r")

    def image(
        self,
        info: schema.TextureInfo,
        where: str,
        uvs: str | None,
        make: Callable[[NDArray[Any]], NDArray[Any]],
        key: Any,
        **params: Any,
    ) -> scene.Texture | None:
        """A texture of linear values that `make` computes from all pixels."""
        image = self.source_of(info, where)
        if image is None:
            return None
        made = self._once((image, key), where, lambda: make(self.pixels(image)))
        return self._texture(info, where, made, params.pop("color_space", "linear"), uvs, **params)

    def mean(self, info: schema.TextureInfo, channel: int, srgb: bool, where: str) -> float:
        """The mean of a channel's linear values."""
        image = self.source_of(info, where)
        if image is None:
            return 1.0
        curve = decode_srgb if srgb else np.asarray
        return float(_mapped(_channel(self.pixels(image), channel), curve).mean(dtype=np.float64))

    def has_alpha(self, info: schema.TextureInfo, where: str) -> bool:
        """Whether the image has transparency of its own."""
        image = self.source_of(info, where)
        return image is not None and self._channels[image] in (2, 4)

    def _texture(
        self,
        info: schema.TextureInfo,
        where: str,
        image: str | PictureBytes | NDArray[Any] | None,
        color_space: str,
        uvs: str | None,
        channel: str = "rgb",
        smooth: bool = True,
    ) -> scene.Texture:
        s = self._source
        texture = s.document.textures[info.index]
        sampler = schema.Sampler()
        if texture.sampler is not None:
            place = f"textures[{info.index}].sampler"
            sampler = s.item(s.document.samplers, "samplers", texture.sampler, place)
        place = f"samplers[{texture.sampler}]"
        for name, number in (("wrapS", sampler.wrap_s), ("wrapT", sampler.wrap_t)):
            if number not in _WRAPS:
                choices = ", ".join(f"{k} ({v})" for k, v in _WRAPS.items())
                raise s.error(f"{place}.{name} is {number}; must be one of {choices}")
        nearest = sampler.mag_filter == _NEAREST or not smooth
        params: dict[str, Any] = {} if uvs is None else {"uvs": uvs}
        moved = self._transform(info, where)
        if moved is not None:
            params["transform"] = _FLIP @ uv_matrix(moved) @ _FLIP
        return scene.Texture(
            "image",
            image=image,
            color_space=color_space,
            channel=channel,
            filter="nearest" if nearest else "mip",
            wrap_u=_WRAPS[sampler.wrap_s],
            wrap_v=_WRAPS[sampler.wrap_t],
            **params,
        )

    def _transform(self, info: schema.TextureInfo, where: str) -> schema.TextureTransform | None:
        return self._source.extension(info, "KHR_texture_transform", schema.TextureTransform, where)

    # Images

    def source_of(self, info: schema.TextureInfo, where: str) -> int | None:
        """The index of a texture's image; None if it has none that can be read."""
        s = self._source
        texture = s.item(s.document.textures, "textures", info.index, f"{where}.index")
        place = f"textures[{info.index}]"
        index = texture.source
        webp = s.extension(texture, "EXT_texture_webp", schema.TextureSource, place)
        if webp is not None:
            index = webp.source
        if index is None:
            kinds = ", ".join(texture.extensions) or "it names none"
            s.report(f"{place}: has no image that can be read ({kinds}); left out")
            return None
        s.item(s.document.images, "images", index, f"{place}.source")
        if index not in self._stored:
            self._stored[index] = self._open(index)
        return None if self._stored[index] is None else index

    def pixels(self, index: int) -> NDArray[Any]:
        """(H, W, channels) as stored, of an image that source_of() has found."""
        if index not in self._pixels:
            stored = self._stored[index]
            assert stored is not None
            pixels = self._told(lambda: read_pixels(stored), stored)
            self._source.spend(pixels.nbytes, f"images[{index}]")
            self._pixels[index] = pixels
        return self._pixels[index]

    def _open(self, index: int) -> str | PictureBytes | None:
        """The path of a picture file, or the bytes of one that the document holds."""
        s = self._source
        image = s.document.images[index]
        where = f"images[{index}]"
        data: bytes | None = None
        path = ""
        if image.buffer_view is not None:
            data = bytes(s.view(image.buffer_view, f"{where}.bufferView"))
        elif image.uri is None:
            raise s.error(f"{where}: has neither uri nor bufferView")
        elif image.uri.startswith("data:"):
            data = s.resource(image.uri, f"{where}.uri")
        else:
            path = str(s.file(image.uri, f"{where}.uri"))
        if data is None:
            with open(path, "rb") as file:
                head = file.read(12)
        else:
            head = data[:12]
        if head.startswith(_KTX2):
            s.report("KHR_texture_basisu: KTX2 images are not supported; left out")
            return None
        if not head.startswith(_KINDS):
            raise s.error(f"{where}: is none of PNG, JPEG and WebP")
        picture = path if data is None else PictureBytes(data, f"{s.path}: {where}")
        self._channels[index] = self._told(lambda: picture_shape(picture), picture)[2]
        return picture

    def _told(self, read: Callable[[], T], picture: str | PictureBytes) -> T:
        """What `read` returns; its errors name the document too."""
        try:
            return read()
        except FormatError as error:
            named = isinstance(picture, PictureBytes)  # of which the document is a part
            raise error if named else self._source.error(str(error)) from None

    def _once(
        self, key: tuple[Any, ...], where: str, make: Callable[[], NDArray[Any]]
    ) -> NDArray[Any]:
        if key not in self._made:
            made = np.ascontiguousarray(make())
            self._source.spend(made.nbytes, where)
            self._made[key] = made
        return self._made[key]


def times(texture: scene.Texture, factor: Color | scene.Texture) -> scene.Texture:
    """The texture multiplied with a colour or another texture."""
    if factor == (1.0, 1.0, 1.0):
        return texture
    return scene.Texture("multiply", color0=texture, color1=factor)


def uv_matrix(moved: schema.TextureTransform) -> NDArray[np.float64]:
    """(3, 3), of coordinates whose v runs down: scales, turns against the clock, then moves."""
    c, s = np.cos(moved.rotation), np.sin(moved.rotation)
    turn = np.array([[c, s], [-s, c]])
    made = np.eye(3)
    made[:2, :2] = turn * moved.scale
    made[:2, 2] = moved.offset
    return made


def linear(pixels: NDArray[Any], srgb: bool, *channels: int) -> NDArray[np.float32]:
    """(H, W, N) float32 of some channels, 3 being alpha. srgb: the colours are encoded."""
    curves: list[Curve] = [decode_srgb if srgb and c < 3 else np.asarray for c in channels]
    parts = [_mapped(_channel(pixels, c), f) for c, f in zip(channels, curves, strict=True)]
    return np.stack(parts, axis=2)


def in_bands(make: Callable[[NDArray[Any]], NDArray[Any]], pixels: NDArray[Any]) -> NDArray[Any]:
    """make(pixels), some rows at a time: what it needs in between is many times an image's size."""
    return np.concatenate([make(pixels[row : row + 64]) for row in range(0, len(pixels), 64)])


def _channel(pixels: NDArray[Any], index: int) -> NDArray[Any]:
    """(H, W): red, green, blue or alpha of pixels that may be grey or without alpha."""
    count = pixels.shape[2]
    if index == 3:
        if count in (2, 4):
            return pixels[:, :, count - 1]
        top = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else 1.0
        return np.full(pixels.shape[:2], top, pixels.dtype)
    return pixels[:, :, index if count >= 3 else 0]


def _mapped(values: NDArray[Any], curve: Curve) -> NDArray[np.float32]:
    """A curve over [0, 1] applied to all values; whole numbers count from 0 to their largest."""
    if values.dtype.kind not in "iu":
        return np.asarray(curve(np.asarray(values, np.float32)), np.float32)
    top = np.iinfo(values.dtype).max
    table = curve(np.arange(top + 1, dtype=np.float32) / np.float32(top))
    found: NDArray[np.float32] = np.asarray(table, np.float32)[values]
    return found


def to_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Numbers from 0 to 1 in 8 bits."""
    scaled = np.clip(values, 0.0, 1.0) * np.float32(255.0) + np.float32(0.5)
    return np.asarray(scaled, np.uint8)
