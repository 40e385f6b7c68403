"""Picture files as they are: their layers by name, and what they say of themselves."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import FormatError, unknown_name
from .image import (
    PRECISE,
    check_unpacked,
    file_bytes,
    in_rec709,
    lay_out,
    opened,
    primaries_of,
    reason_of,
)
from .spectra import decode_srgb

if TYPE_CHECKING:
    from numpy.typing import NDArray

# What the channels that belong to no layer are called together
MAIN = "main"

# In which order channels count, where all of a layer's are of one row
_ORDERS = ("RGBA", "YA", "XYZ", "UV")
# Colours; all else are data
_LIGHT = frozenset("RGBAYI")
# Whole numbers in a file, and the largest of each
_WHOLE = {"uint8": 255, "uint16": 65535}


@dataclass(frozen=True)
class Layer:
    """channels: names without the layer's; kinds: of their numbers. Where they are in the file."""

    name: str
    channels: tuple[str, ...]
    kinds: tuple[str, ...]
    width: int
    height: int
    part: int
    places: tuple[int, ...]

    @property
    def is_light(self) -> bool:
        """Whether it holds colours or grey, not data such as depth."""
        letters = set(self.channels)
        return letters <= _LIGHT and letters != {"A"} and not is_matte(self.name)

    @property
    def is_linear_rgb(self) -> bool:
        """Whether it holds linear light of three colours, in the primaries of the file."""
        rgb = self.channels[:3] == tuple("RGB")
        return rgb and self.is_light and self.kinds[0] not in _WHOLE


class PictureFile:
    """A picture file. Raises FormatError for one that cannot be read."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self.layers: dict[str, Layer] = {}
        self.metadata: dict[str, Any] = {}
        self.parts = 0
        self._primaries: list[NDArray[np.float64] | None] = []  # of each part
        stored = os.path.getsize(self.path) if os.path.isfile(self.path) else 0
        with self._opened() as source:
            while source.seek_subimage(self.parts, 0):
                spec = source.spec()
                check_unpacked(spec, stored, f"{self.path}: ")
                if self.parts == 0:
                    self.metadata = {a.name: a.value for a in spec.extra_attribs}
                    self.width, self.height = int(spec.width), int(spec.height)
                self._primaries.append(primaries_of(spec, f"{self.path}: "))
                self._add(spec)
                self.parts += 1

    def layer(self, name: str | None = None) -> Layer:
        """By its name; None: the picture itself, else the first one of colours, else the first.

        Raises FormatError for one that the file does not have.
        """
        if name is None:
            layers = list(self.layers.values())
            lit = [layer for layer in layers if layer.is_light]
            return next((layer for layer in lit if layer.name == MAIN), (lit or layers)[0])
        if name not in self.layers:
            raise FormatError(f"{self.path}: {unknown_name('layer', name, self.layers)}")
        return self.layers[name]

    def read(self, layer: Layer) -> NDArray[np.float32]:
        """(H, W, channels), numbers as they are stored; whole ones as shares of their largest, and
        linear colours in Rec. 709, whatever the primaries of the file are.
        """
        first, last = min(layer.places), max(layer.places) + 1
        pixels = self._pixels(layer.part, first, last)
        order = [place - first for place in layer.places]
        if order != list(range(last - first)):
            pixels = np.ascontiguousarray(pixels[..., order])
        if layer.is_linear_rgb:
            in_rec709(pixels, self._primaries[layer.part])
        return pixels

    def light(self, layer: Layer) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Linear light of a layer of colours, (H, W, 3), and its alpha, (H, W, 1), if it has some.

        Colours are not multiplied by alpha. Whole numbers are sRGB unless the file says otherwise.
        """
        values = self.read(layer)
        alpha = None
        if "A" in layer.channels:
            place = layer.channels.index("A")
            alpha = values[..., place : place + 1]
            values = np.delete(values, place, axis=2)
        if layer.kinds[0] in _WHOLE and "lin" not in str(self.metadata.get("oiio:ColorSpace")):
            values = decode_srgb(values)
        elif alpha is not None:  # .exr has them multiplied
            with np.errstate(divide="ignore", invalid="ignore"):
                values = np.where(alpha > 0, values / alpha, values).astype(np.float32)
        if values.shape[2] != 3:
            values = np.repeat(values[..., :1], 3, axis=2)
        return np.ascontiguousarray(values), alpha

    def everything(self) -> tuple[list[str], list[str], NDArray[np.float32]]:
        """Names and kinds of all channels, and their numbers, (H, W, channels), as of read().

        Raises FormatError for a file of several parts.
        """
        if self.parts > 1:
            raise FormatError(
                f"{self.path}: has {self.parts} parts; choose one of its layers"
                f" ({', '.join(self.layers)})"
            )
        known = {
            place: (channel if layer.name == MAIN else f"{layer.name}.{channel}", kind)
            for layer in self.layers.values()
            for place, channel, kind in zip(layer.places, layer.channels, layer.kinds, strict=True)
        }
        names, kinds = zip(*(known[place] for place in sorted(known)), strict=True)
        pixels = self._pixels(0, 0, len(known))
        if self._primaries[0] is not None:
            for layer in self.layers.values():
                if layer.is_linear_rgb:
                    pixels[..., list(layer.places)] = self.read(layer)
        return list(names), list(kinds), pixels

    def _add(self, spec: Any) -> None:
        """The layers of one part."""
        part = str(spec.getattribute("oiio:subimagename") or f"part {self.parts + 1}")
        kinds = [str(k) for k in spec.channelformats] or [str(spec.format)] * spec.nchannels
        found: dict[str, list[int]] = {}
        for place, channel in enumerate(spec.channelnames):
            prefix = channel.rpartition(".")[0]
            found.setdefault(prefix, []).append(place)
        for prefix, places in found.items():
            name = prefix or (MAIN if self.parts == 0 else part)
            if name in self.layers:
                name = f"{part}.{name}"
            short = {place: spec.channelnames[place].rpartition(".")[2] for place in places}
            letters = {letter.upper() for letter in short.values()}
            for order in _ORDERS:
                if letters <= set(order) and len(letters) == len(places):
                    by_letter = {short[place].upper(): place for place in places}
                    places = [by_letter[letter] for letter in order if letter in by_letter]
                    break
            self.layers[name] = Layer(
                name,
                tuple(short[p] for p in places),
                tuple(kinds[p] for p in places),
                int(spec.width),
                int(spec.height),
                self.parts,
                tuple(places),
            )

    def _pixels(self, part: int, first: int, last: int) -> NDArray[np.float32]:
        with self._opened() as source:
            source.seek_subimage(part, 0)
            pixels = source.read_image(part, 0, first, last, "float")
            if pixels is None:
                raise FormatError(f"{self.path}: cannot be read: {reason_of(source.geterror)}")
        return np.ascontiguousarray(pixels)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        source = opened(self.path, self.path)
        try:
            yield source
        finally:
            source.close()


def exr_bytes(
    names: list[str],
    kinds: list[str],
    pixels: NDArray[np.float32],
    metadata: Mapping[str, Any],
    compression: str | None = None,
    tiled: bool = False,
) -> bytes:
    """An .exr file of channels, (H, W, channels); kinds: "float" or "half" of each."""
    import OpenImageIO as oiio

    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, "float")
    spec.channelnames = tuple(names)
    spec.channelformats = tuple(oiio.TypeDesc(k) for k in kinds)
    for key, value in metadata.items():
        spec.attribute(key, value)
    lay_out(spec, compression, tiled)
    size = 2 * pixels.nbytes + 64 * height + 8 * len(str(metadata)) + 65536
    whole = np.ascontiguousarray(pixels)
    for place, kind in enumerate(kinds):
        if kind == "half":  # what is brighter than their largest number would become infinite
            np.minimum(whole[..., place], np.finfo(np.float16).max, out=whole[..., place])
    return file_bytes(spec, ".exr", size, lambda output: bool(output.write_image(whole)))


def kinds_of(names: list[str], bits: int) -> list[str]:
    """How the channels of an .exr file are stored: layers of colours in `bits`, data in 32."""
    letters: dict[str, set[str]] = {}
    for name in names:
        layer, _, letter = name.rpartition(".")
        letters.setdefault(layer, set()).add(letter)
    colors = {layer for layer, found in letters.items() if found <= _LIGHT and layer not in PRECISE}
    return [
        "half"
        if bits == 16 and name.rpartition(".")[0] in colors and not is_matte(name)
        else "float"
        for name in names
    ]


def is_matte(name: str) -> bool:
    """Whether a layer or channel is one of a Cryptomatte, by its name."""
    return name.lower().startswith("crypto")
