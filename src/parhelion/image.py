"""A finished picture: its pixels, how it came about, and writing it to a file."""

from __future__ import annotations

import base64
import json
import logging
import math
import os
import struct
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime, timezone
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from . import arguments, cryptomatte
from .atomic import is_special, replacing
from .display import Display, WhiteBalance, to_rec709
from .errors import FormatError, ResourceError, SceneError, option, unknown_name
from .scene import Camera, ColorBar, Settings, Source, Swatches

if TYPE_CHECKING:
    from numpy.typing import NDArray


log = logging.getLogger("parhelion")

# ending -> bits a channel that it can hold, its default first
WRITABLE = {".png": (8, 16), ".jpg": (8,), ".jpeg": (8,), ".exr": (32, 16)}

# Of .exr, the default first
COMPRESSIONS = ("zip", "zips", "piz", "rle", "none", "b44", "b44a", "pxr24", "dwaa", "dwab")
# Those that change numbers of 32 bits, and so indices and the ids of Cryptomattes
_CHANGING = ("pxr24", "dwaa", "dwab")

_LETTERS = {
    "depth": "Z",
    "position": "XYZ",
    "normal": "XYZ",
    "shading_normal": "XYZ",
    "uv": "UV",
    "albedo": "RGB",
    "emission": "RGB",
    "direct": "RGB",
    "indirect": "RGB",
    "noisy": "RGB",
    "coverage": "A",
    "error": "V",
    "samples": "V",
    "variance": "V",
    "shape": "V",
    "material": "V",
}
# What the channels of a feature are called in an EXR file, "depth.Z" and so on, the names by which
# compositing programs know what they hold. Those of PRECISE are always stored in 32 bits.
CHANNELS = {name: tuple(f"{name}.{c}" for c in letters) for name, letters in _LETTERS.items()} | {
    layer: cryptomatte.channels(layer) for layer in cryptomatte.LAYERS
}
PRECISE = {
    *("depth", "position", "uv", "samples", "variance", "shape", "material"),
    *cryptomatte.LAYERS,
}

# Those whose numbers stand for names
_IDS = {"shape", "material", *cryptomatte.LAYERS}

# Bytes that any picture may unpack to, and how many times its file's size one may beyond that: a
# header is a few bytes that can claim any size.
_ALWAYS = 1 << 30
_RATIO = 20
# Of a JPEG, and bytes that fill gaps between them, to look for the header among
_SEGMENTS = 4096
# How numbers are read that are not read as float, and their bytes
_KINDS = {"uint8": ("uint8", 1), "uint16": ("uint16", 2)}

# Edge of a picture that tells how long a large one takes to write, in pixels
_TRIAL = 128

# Rows that the writer of EXR gets at a time: with features, a copy of a whole picture would be as
# large as all else together. Tiles are as high, and as wide.
_ROWS = 64


@dataclass(frozen=True)
class RenderStats:
    """seconds: of rendering, wall clock, without the tree's build. samples, rays: in all; those
    before a rendering was resumed included. isa: instruction set. ended: what ended it, "spp",
    "noise", "time" or "stopped", or "failed": on a cluster, and some pixels lack samples. error:
    how far pixels may be from what infinitely many samples would show: root mean square over the
    picture, within 95 % confidence, as a share of a pixel's brightness; None if it was not asked
    for, or samples are too few. build_seconds: checks and tree.
    """

    seconds: float
    samples: int
    rays: int
    threads: int
    isa: str
    ended: str
    error: float | None
    build_seconds: float

    @property
    def complete(self) -> bool:
        """False if it was stopped before what was asked for was reached."""
        return self.ended not in ("stopped", "failed")


class KnownScene(Protocol):
    """What a picture tells of its scene."""

    @property
    def shape_names(self) -> list[str]: ...
    @property
    def material_names(self) -> list[str]: ...
    @property
    def object_names(self) -> list[str]: ...
    def sha256(self) -> str: ...


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """pixels: (H, W, 3) float32, linear Rec. 709. counts: (H, W) samples in each pixel.

    features: what the first surfaces look like, if they were asked for: (H, W, 1 to 3) float32 by
    name, means over a pixel's samples: depth (distance from the camera), position, normal
    (geometric), shading_normal and uv, over those that hit something; albedo, emission, direct and
    indirect (parts of the radiance), coverage (share that hit something); error, of blocks of 8 x 8
    pixels (as RenderStats.error, or that of the 24 x 24 around), samples, as counts, and variance
    of the pixel's mean, estimated, the mean of its channels, if noise, a time limit or a checkpoint
    were asked for. shape and material, (H, W), are indices into flat.shape_names and
    flat.material_names of the first sample's, -1 for none. CryptoObject and CryptoMaterial,
    (H, W, 6, 2), are Cryptomattes: of the six shapes, or materials, that most samples of the pixel
    hit, the largest first, the id of the name and the share of the samples; matte() looks a name
    up. noisy, of a picture that is denoised(), is what was rendered.

    legend: what the scene's colours stand for, if they stand for something. source: where the scene
    came from, None for one that was made in Python. notes: what metadata() tells besides.

    NumPy takes it for its pixels; a notebook shows it.
    """

    pixels: NDArray[np.float32]
    counts: NDArray[np.uint32]
    stats: RenderStats
    settings: Settings
    camera: Camera
    flat: KnownScene
    features: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    legend: ColorBar | Swatches | None = None
    source: Source | None = None
    notes: Mapping[str, str] = field(default_factory=dict)

    def numpy(self) -> NDArray[np.float32]:
        """The linear pixels, (H, W, 3) float32."""
        return self.pixels

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False and dtype is not None and dtype != self.pixels.dtype:
            raise ValueError("another dtype needs a copy")
        return self.pixels.astype(dtype or self.pixels.dtype, copy=bool(copy))

    def __repr__(self) -> str:
        height, width = self.pixels.shape[:2]
        done = "" if self.stats.complete else ", stopped early"
        return f"<Image {width}x{height}, {self.told_spp()}{done}>"

    def told_spp(self) -> str:
        """The samples per pixel that there are: "64 spp", or "16 to 384 spp, 142.4 on average"."""
        least, most = int(self.counts.min()), int(self.counts.max())
        if least == most:
            return f"{most} spp"
        return f"{least} to {most} spp, {self.counts.mean():.1f} on average"

    def srgb(
        self,
        bits: int = 8,
        legend: bool = False,
        exposure: float = 0.0,
        *,
        view_transform: str = "srgb",
        white_balance: WhiteBalance | None = None,
    ) -> NDArray[Any]:
        """The picture as screens want it: sRGB, (H, W, 3) uint8 or uint16.

        legend: with what the colours stand for at its right side; raises SceneError if they stand
        for nothing. exposure: stops; light is multiplied by 2^exposure. view_transform: how light
        becomes colours of a screen, "srgb", which cuts at white, "agx", "aces" or "aces-1.3".
        white_balance: what shall be white, kelvin or CIE (x, y). See display.Display.
        """
        shown = Display(view_transform, exposure, white_balance)
        if bits not in (8, 16):
            raise SceneError(f"{option('bits')} is {bits!r}; must be 8 or 16")
        stored = shown.encode(self.pixels, bits)
        if not arguments.flag("legend", legend):
            return stored
        from .legend import panel

        beside = panel(checked_legend(self.legend), len(stored)).astype(stored.dtype)
        return np.concatenate([stored, beside * (1 if bits == 8 else 257)], axis=1)

    def denoised(
        self,
        quality: str = "high",
        prefilter: bool = True,
        *,
        progress: Callable[[float], Any] | None = None,
    ) -> Image:
        """The picture without its noise, by Open Image Denoise; noisy pixels are kept as a feature.

        The features albedo, shading_normal and coverage, if it was rendered with them, keep edges
        and textures sharp. quality: "high", "balanced" or "fast". prefilter: noise of the features
        is taken out first. Pixels that are not finite are counted, told of, and taken for black.
        progress: a function that is called with the share that is done, 0 to 1, some times a
        second; if it returns something true, the work ends, and the picture is returned as it is.
        Raises ResourceError without the extra `denoise`.
        """
        from . import denoise

        noisy = self.features.get(denoise.NOISY, self.pixels)
        albedo, normal = denoise.guides_of(self.features)
        clean = denoise.told(noisy, "picture")
        try:
            pixels = denoise.denoised(
                clean, albedo, normal, quality=quality, prefilter=prefilter, progress=progress
            )
        except denoise.Stopped:
            return self
        return replace(self, pixels=pixels, features={**self.features, denoise.NOISY: noisy})

    def matte(
        self, *, shape: str | None = None, material: str | None = None
    ) -> NDArray[np.float32]:
        """How much of each pixel a shape, or else a material, covers as the camera sees it.

        Its name in, (H, W) float32 from 0 to 1 out. Raises SceneError for a name that the scene
        does not have, and for a picture that was rendered without features.
        """
        asked = {"CryptoObject": shape, "CryptoMaterial": material}
        given = [(layer, name) for layer, name in asked.items() if name is not None]
        if len(given) != 1:
            raise SceneError("matte: give the name of a shape or of a material, one of the two")
        layer, name = given[0]
        choices = self._matte_names()[layer]
        if name not in choices:
            raise SceneError(
                f"matte: {unknown_name(cryptomatte.LAYERS[layer], name, set(choices))}"
            )
        if layer not in self.features:
            raise SceneError("matte: the picture must be rendered with features=True")
        ids, coverage = np.moveaxis(self.features[layer], -1, 0)
        its_own = ids.view(np.uint32) == cryptomatte.matte_id(name)
        matte: NDArray[np.float32] = np.where(its_own, coverage, np.float32(0)).sum(axis=-1)
        return matte

    def _matte_names(self) -> dict[str, list[str]]:
        """Whose mattes a layer can hold."""
        return {
            "CryptoObject": self.flat.object_names,
            "CryptoMaterial": self.flat.material_names,
        }

    def metadata(self) -> dict[str, str]:
        """What is written into a file beside the pixels."""
        from . import __version__, _core

        more: dict[str, str] = {}
        if "shape" in self.features:
            more["parhelion:shapes"] = json.dumps(self.flat.shape_names)
            more["parhelion:materials"] = json.dumps(self.flat.material_names)
        if self.stats.error is not None:
            more["parhelion:error"] = f"{self.stats.error:.6g}"
        if self.counts.min() != self.counts.max():
            more[COUNTS] = packed_counts(self.counts)
        if self.source is not None:
            more["parhelion:source"] = json.dumps(asdict(self.source), default=str)
        if "noisy" in self.features:
            from .denoise import version

            more["parhelion:denoised"] = version()
        return {
            "Software": f"Parhelion {__version__}",
            "parhelion:version": __version__,
            "parhelion:build": _core.sources,
            "parhelion:scene": self.flat.sha256(),
            "parhelion:seed": str(self.settings.seed),
            "parhelion:spp": str(self.settings.spp),
            "parhelion:samples": str(self.stats.samples),
            "parhelion:complete": str(self.stats.complete).lower(),
            "parhelion:ended": self.stats.ended,
            "parhelion:settings": json.dumps(asdict(self.settings)),
            "parhelion:camera": json.dumps(asdict(self.camera), default=float),
            "parhelion:time": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "parhelion:seconds": f"{self.stats.seconds:.3f}",
            "parhelion:threads": str(self.stats.threads),
            "parhelion:isa": self.stats.isa,
            **more,
            **self.notes,
        }

    def save(
        self,
        path: str | os.PathLike[str],
        bits: int | None = None,
        legend: bool = False,
        exposure: float = 0.0,
        *,
        view_transform: str = "srgb",
        white_balance: WhiteBalance | None = None,
        compression: str | None = None,
        tiled: bool = False,
    ) -> None:
        """Writes the picture; the ending of the name says how.

        .png (bits 8 or 16) and .jpg are sRGB; .exr is linear (bits 32 or 16) and holds the
        features, if there are any, as layers. A file that is there already stays whole until the
        new one is complete. legend: what the colours stand for is drawn at the right side of the
        picture, which becomes wider. exposure, view_transform, white_balance: as for srgb(); linear
        values stay, and their file says in its metadata how they are to be seen.

        compression: of .exr, one of COMPRESSIONS, "zip" unless given; those that are not exact are
        refused where they would change the ids of features. tiled: .exr in tiles of 64x64 pixels,
        not in rows.

        Raises SceneError for an unknown ending or number of bits, and a legend where there is none,
        ResourceError where the file cannot be written.
        """
        file = arguments.path("path", path)
        shown = Display(view_transform, exposure, white_balance)
        ending = file.suffix.lower()
        ids = ending == ".exr" and not _IDS.isdisjoint(self.features)
        check_output(file, bits, ids, legend, compression=compression, tiled=tiled)
        depth = bits or WRITABLE[ending][0]
        data: NDArray[Any]
        if ending == ".exr":
            data = _half(self.pixels) if depth == 16 else self.pixels
        else:
            data = self.srgb(
                depth, legend, exposure, view_transform=view_transform, white_balance=white_balance
            )
        layers = self.features if ending == ".exr" else {}
        told = self.metadata() | shown.metadata()
        if legend:
            told["parhelion:legend"] = "true"
        for layer, names in self._matte_names().items():
            if layer in layers:
                told |= cryptomatte.attributes(layer, names)
        with replacing(file) as temporary:
            temporary.write_bytes(encoded(data, told, ending, layers, compression, tiled))

    def png_bytes(self) -> bytes:
        """The picture as the bytes of an 8-bit sRGB PNG file."""
        return encoded(self.srgb(), self.metadata(), ".png")

    def _repr_png_(self) -> bytes:
        return self.png_bytes()


# The attribute of a file that names the objects that were hidden when it was made
HIDDEN = "parhelion:hidden"
# The attribute of a file that holds packed_counts(), where pixels differ in them
COUNTS = "parhelion:counts"


def packed_counts(counts: NDArray[np.uint32]) -> str:
    """Samples of each pixel as text."""
    return base64.b64encode(zlib.compress(counts.astype("<u4").tobytes(), 9)).decode()


def unpacked_counts(text: str, height: int, width: int) -> NDArray[np.uint32]:
    """(height, width) of what packed_counts() made. Raises ValueError for other text."""
    wanted = 4 * height * width
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(base64.b64decode(text, validate=True), wanted + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if len(data) != wanted:
        raise ValueError("of another size")
    return np.frombuffer(data, "<u4").reshape(height, width).astype(np.uint32)


def checked_legend(legend: ColorBar | Swatches | None) -> ColorBar | Swatches:
    """The legend. Raises SceneError if there is none."""
    if legend is None:
        raise SceneError(
            "there is no legend: the scene's colours stand for nothing; particles and meshes may be"
            f" coloured by a field ({option('color_by')})"
        )
    if not isinstance(legend, (ColorBar, Swatches)):
        kind = type(legend).__name__
        raise SceneError(f"legend: a ColorBar or Swatches are needed, not {kind}")
    arguments.text("legend: label", legend.label)
    if isinstance(legend, ColorBar):
        arguments.text("legend: colormap", legend.colormap)
        for name in ("low", "high"):
            arguments.number(f"legend: {name}", getattr(legend, name))
        return legend
    if not isinstance(legend.kinds, (tuple, list)):
        raise SceneError(f"legend: kinds is {legend.kinds!r}; must be a list of names and colours")
    for i, kind in enumerate(legend.kinds):
        if not isinstance(kind, (tuple, list)) or len(kind) != 2:
            raise SceneError(f"legend: kinds[{i}] is {kind!r}; must be a name and a colour")
        arguments.text(f"legend: kinds[{i}][0]", kind[0])
        arguments.color(f"legend: kinds[{i}][1]", kind[1])
    return legend


def _half(data: NDArray[Any]) -> NDArray[np.float16]:
    """In 16 bits; what is brighter than their largest number would become infinite."""
    half: NDArray[np.float16] = np.minimum(data, np.finfo(np.float16).max).astype(np.float16)
    return half


def reason_of(geterror: Callable[[], str]) -> str:
    """The first line of what OpenImageIO says, which may tell of one mistake many times over."""
    try:
        return str(geterror()).strip().partition("\n")[0]
    except UnicodeDecodeError:  # it quotes what it could not read
        return "it holds bytes that are no text"


def read_pixels(source: Encoded, where: str = "") -> NDArray[Any]:
    """A picture's pixels, (H, W, C) uint8, uint16 or float32, as they are stored in a file.

    source: the file's path, or all of its bytes. C is 1 to 4: grey, grey and alpha, RGB, RGB and
    alpha, which is not multiplied into the colours. Raises FormatError for one that cannot be read
    or whose header claims far more than the file can hold; `where`, if any, and the path begin its
    text.
    """
    with _file_of(source, where) as (path, start):
        return _read_pixels(path, start)


def picture_shape(source: Encoded, where: str = "") -> tuple[int, int, int]:
    """The shape of what read_pixels returns, by the picture's header alone.

    Raises what read_pixels would for a file that is no picture or too large a one; of a JPEG only
    the frame header is looked at.
    """
    return _header(source, where)[0]


def picture_bytes(source: Encoded, where: str = "") -> int:
    """How many bytes the array has that read_pixels returns, by the picture's header alone.

    Raises what picture_shape() does.
    """
    shape, size = _header(source, where)
    return math.prod(shape) * size


def _header(source: Encoded, where: str) -> tuple[tuple[int, int, int], int]:
    """(H, W, C) of what read_pixels returns, and the bytes of each of its numbers."""
    shape = _jpeg_shape(source)
    if shape is not None:
        return shape, 1
    with _file_of(source, where) as (path, start):
        reader = opened(path, start)
        spec = reader.spec()
        reader.close()
        size = _KINDS.get(str(spec.format), ("float", 4))[1]
        return (int(spec.height), int(spec.width), len(_channels(spec))), size


def _jpeg_shape(source: Encoded) -> tuple[int, int, int] | None:
    """(H, W, C) of a JPEG in grey or YCbCr, as its frame header says (ITU-T T.81, B.2.2); None for
    any other file, and for one of many pixels or in doubt, which the library shall look at.

    For the library to open a progressive one is to decode it.
    """
    if not isinstance(source, (bytes, PictureBytes)) and is_special(Path(source)):
        return None
    try:
        with _bytes_of(source) as file:
            if file.read(2) != b"\xff\xd8":
                return None
            for _ in range(_SEGMENTS):
                marker, code, size, precision, height, width, channels = struct.unpack(
                    ">BBHBHHB", file.read(10)
                )
                if marker == code == 0xFF:  # a marker may have any number of these before it
                    file.seek(-9, os.SEEK_CUR)
                    continue
                if marker != 0xFF or size < 2:
                    return None
                if code in (0xC0, 0xC1, 0xC2):  # by Huffman's code, as nearly all are
                    break
                file.seek(size - 8, os.SEEK_CUR)
            else:
                return None
    except (OSError, ValueError, struct.error):  # no such file or name; it ends before
        return None
    known = precision == 8 and channels in (1, 3) and 0 < height * width * channels <= _ALWAYS
    return (height, width, channels) if known else None


def _bytes_of(source: Encoded) -> IO[bytes]:
    if isinstance(source, (bytes, PictureBytes)):
        return BytesIO(encoded_bytes(source))
    return open(source, "rb")


def picture_metadata(source: Encoded, where: str = "") -> dict[str, str]:
    """What Image.metadata() was when a picture's file was written; empty for other programs' files.

    Raises what read_pixels would for a file that is no picture or too large a one.
    """
    with _file_of(source, where) as (path, start):
        reader = opened(path, start)
        told = reader.spec().get_string_attribute("ImageDescription")
        reader.close()
    try:
        found = json.loads(told)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


@dataclass(frozen=True, eq=False)
class PictureBytes:
    """The bytes of a picture file that lies within another; name: where, for messages."""

    data: bytes
    name: str

    def __repr__(self) -> str:
        return f"<{len(self.data)} bytes of {self.name}>"


def is_encoded(image: Any) -> bool:
    """Whether read_pixels is what makes pixels of it: a path, or a picture file's bytes."""
    return isinstance(image, (str, os.PathLike, bytes, PictureBytes))


# What is_encoded() is true of
Encoded: TypeAlias = str | os.PathLike[str] | bytes | PictureBytes


def encoded_bytes(image: Encoded) -> bytes:
    """All of a picture's file. Raises OSError."""
    if isinstance(image, bytes):
        return image
    return image.data if isinstance(image, PictureBytes) else Path(image).read_bytes()


@contextmanager
def _file_of(source: Encoded, where: str) -> Iterator[tuple[str, str]]:
    """A path for a picture, and how messages about it begin."""
    if isinstance(source, (bytes, PictureBytes)):
        name = "" if isinstance(source, bytes) else source.name
        data = encoded_bytes(source)
        with _memory_file(len(data)) as path:
            Path(path).write_bytes(data)
            yield path, ": ".join(x for x in (where, name) if x)
    else:
        path = os.fspath(source)
        yield path, f"{where}: {path}" if where else path


def opened(path: str, where: str) -> Any:
    """The library's reader of a picture. Raises FormatError; `where` begins its text."""
    import OpenImageIO as oiio

    start = f"{where}: " if where else ""
    if is_special(Path(path)):  # a pipe, say, which the library would wait for
        raise FormatError(f"{start}is not a regular file")
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, hints)
    if source is None:
        reason = reason_of(oiio.geterror).replace(f'"{path}"', "it")  # asked for even if not told
        if not os.path.isfile(path):
            raise FormatError(f"{start}no such file")
        raise FormatError(f"{start}cannot be read: {reason}")
    spec = source.spec()
    try:
        check_unpacked(spec, os.path.getsize(path), start)
    except FormatError:
        source.close()
        raise
    return source


def check_unpacked(spec: Any, stored: int, start: str) -> None:
    """Raises FormatError for pixels that are more than a file of `stored` bytes can hold."""
    unpacked = spec.width * spec.height * spec.nchannels
    unpacked *= _KINDS.get(str(spec.format), ("float", 4))[1]
    if unpacked > max(_ALWAYS, _RATIO * stored):
        raise FormatError(
            f"{start}has {spec.width} x {spec.height} pixels, {unpacked:,} bytes, in a file of"
            f" {stored:,}; beyond {_ALWAYS >> 30} GiB at most {_RATIO} times the file are read"
        )


def _read_pixels(path: str, where: str) -> NDArray[Any]:
    start = f"{where}: " if where else ""
    source = opened(path, where)
    try:
        spec = source.spec()
        kind = _KINDS.get(str(spec.format), ("float", 4))[0]
        pixels = source.read_image(0, 0, 0, spec.nchannels, kind)
        if pixels is None:
            raise FormatError(f"{start}cannot be read: {reason_of(source.geterror)}")
    finally:
        source.close()
    chosen = _channels(spec)
    if chosen != list(range(spec.nchannels)):
        pixels = pixels[:, :, chosen]
    pixels = np.ascontiguousarray(pixels)
    if kind == "float" and pixels.shape[2] >= 3:
        in_rec709(pixels, primaries_of(spec, start))
    return pixels


def primaries_of(spec: Any, start: str) -> NDArray[np.float64] | None:
    """What makes linear Rec. 709 of the colours of a file, (3, 3); None if they are that already.

    start: of a warning about primaries that are none.
    """
    told = spec.getattribute("chromaticities")
    try:
        return None if told is None else to_rec709(told)
    except SceneError as error:
        log.warning("%s%s; its colours are taken for Rec. 709", start, error)
        return None


def in_rec709(pixels: NDArray[np.float32], matrix: NDArray[np.float64] | None) -> None:
    """Changes colours, the first three of (H, W, C) channels, by primaries_of() their file."""
    if matrix is not None:
        with np.errstate(invalid="ignore", over="ignore"):  # infinite ones stay no numbers
            pixels[..., :3] = pixels[..., :3] @ matrix.T.astype(np.float32)


def _channels(spec: Any) -> list[int]:
    """Which channels of a file count; the library reorders them."""
    names = [n.upper() for n in spec.channelnames]
    for wanted in (("R", "G", "B", "A"), ("R", "G", "B"), ("Y", "A"), ("Y",)):
        if all(n in names for n in wanted):
            return [names.index(n) for n in wanted]
    return list(range({1: 1, 2: 1, 3: 3}.get(spec.nchannels, 4)))


def check_output(
    path: str | os.PathLike[str],
    bits: int | None = None,
    features: bool = False,
    legend: bool = False,
    exposure: float = 0.0,
    view_transform: str = "srgb",
    white_balance: WhiteBalance | None = None,
    compression: str | None = None,
    tiled: bool = False,
) -> None:
    """Raises what save() would for a name that cannot be written, before the work is done."""
    file = arguments.path("path", path)
    legend, tiled = arguments.flag("legend", legend), arguments.flag("tiled", tiled)
    ending = file.suffix.lower()
    if ending not in WRITABLE:
        raise SceneError(f"{file}: {unknown_name('picture ending', ending, WRITABLE)}")
    if bits is not None and bits not in WRITABLE[ending]:
        choices = ", ".join(map(str, WRITABLE[ending]))
        raise SceneError(f"{file}: {ending} cannot hold {bits} bits a channel (choices: {choices})")
    if features and ending != ".exr":
        raise SceneError(f"{file}: {ending} cannot hold features (choices: .exr)")
    if legend and ending == ".exr":
        choices = ", ".join(e for e in WRITABLE if e != ".exr")
        raise SceneError(f"{file}: {ending} cannot hold a legend (choices: {choices})")
    if compression is not None:
        _check_compression(file, compression, features)
    if tiled and ending != ".exr":
        raise SceneError(f"{file}: {ending} has no tiles (choices: .exr)")
    Display(view_transform, exposure, white_balance)
    check_place(file)


def _check_compression(file: Path, compression: str, features: bool) -> None:
    """Raises SceneError for one that the file cannot have."""
    if file.suffix.lower() != ".exr":
        raise SceneError(f"{file}: {option('compression')} is for .exr")
    if compression not in COMPRESSIONS:
        raise SceneError(f"{file}: {unknown_name('compression', compression, COMPRESSIONS)}")
    if features and compression in _CHANGING:
        choices = ", ".join(c for c in COMPRESSIONS if c not in _CHANGING)
        raise SceneError(
            f"{file}: {compression} would change the ids of Cryptomattes (choices: {choices})"
        )


def check_place(file: Path) -> None:
    """Raises ResourceError for a file that cannot be written where it is to be."""
    try:
        target = Path(os.path.realpath(file))
        if target.is_dir():
            raise ResourceError(f"{file}: is a folder")
        if not target.parent.is_dir():
            raise ResourceError(f"{file}: there is no folder {target.parent}")
    except (OSError, ValueError) as error:  # too long a name; a null character in it
        if isinstance(error, ResourceError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise ResourceError(f"{file}: cannot be written: {reason}") from error
    needed = target if is_special(target) else target.parent
    if not os.access(needed, os.W_OK):
        raise ResourceError(f"{file}: no permission to write {needed}")


def seconds_to_encode(path: str | os.PathLike[str], features: bool, pixels: int) -> float:
    """Seconds that a picture of so many pixels will take to become a file's bytes, by a small one
    of noise, which is as hard to pack as any.
    """
    ending = Path(path).suffix.lower()
    exr = ending == ".exr"
    noise = np.random.default_rng(0).random((_TRIAL, _TRIAL, 3), np.float32)
    data = noise if exr else (255 * noise).astype(np.uint8)
    # Estimates of noise come with a limit of time, whatever is asked for.
    names = CHANNELS if features else ("error", "samples", "variance")
    wide = {name: noise[..., np.arange(len(CHANNELS[name])) % 3] for name in names}
    encoded(data[:1, :1], {}, ending)  # loads the library
    start = time.perf_counter()
    encoded(data, {}, ending, wide if exr else None)
    return (time.perf_counter() - start) * max(1.0, pixels / _TRIAL**2)


def encoded(
    data: NDArray[Any],
    metadata: dict[str, str],
    ending: str,
    layers: Mapping[str, NDArray[Any]] | None = None,
    compression: str | None = None,
    tiled: bool = False,
) -> bytes:
    """Pixels, (H, W, channels), as the bytes of a file with that ending.

    layers: features by name, for .exr, in as many bits as the pixels or, where that would tell too
    little, in 32. compression, tiled: of .exr.

    The library writes into memory, for where there is no room some of its writers report success
    and one ends the process.
    """
    import OpenImageIO as oiio

    height, width, channels = data.shape
    names = {"float32": "float", "float16": "half"}
    kind = names.get(str(data.dtype), str(data.dtype))
    parts = {
        name: values.reshape(height, width, -1)
        for name, values in (layers or {}).items()
        if name in CHANNELS
    }
    spec = oiio.ImageSpec(width, height, channels, kind)
    if parts:
        kinds = [kind] * channels
        listed = list(spec.channelnames)
        for name, values in parts.items():
            kinds += ["float" if name in PRECISE else kind] * values.shape[2]
            listed += CHANNELS[name]
        spec.nchannels = len(kinds)
        spec.channelnames = tuple(listed)
        spec.channelformats = tuple(oiio.TypeDesc(k) for k in kinds)
    for key, value in metadata.items():
        spec.attribute(key, value)
    # JPEG keeps only what it knows, so everything that it has room for is told in the description
    described = metadata | ({COUNTS: ""} if COUNTS in metadata else {})
    spec.attribute("ImageDescription", json.dumps(described))
    if ending == ".exr":
        spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
        lay_out(spec, compression, tiled)
    else:
        spec.attribute("oiio:ColorSpace", "sRGB")
        spec.attribute("oiio:UnassociatedAlpha", 1)
        spec.attribute("CompressionQuality", 95)
        spec.attribute("png:compressionLevel", 3)  # a noisy picture: 0.6 of 6's time, no larger
    if parts:

        def write(output: Any) -> bool:
            for row in range(0, height, _ROWS):
                below = min(row + _ROWS, height)
                rows = _stacked(data, parts, row)
                done = (
                    output.write_tiles(0, width, row, below, 0, 1, rows)
                    if tiled
                    else output.write_scanlines(row, below, 0, rows)
                )
                if not done:
                    return False
            return True

    else:

        def write(output: Any) -> bool:
            return bool(output.write_image(np.ascontiguousarray(data)))

    size = largest_file(data, metadata) + sum(2 * 4 * v.size for v in parts.values())
    return file_bytes(spec, ending, size, write)


def lay_out(spec: Any, compression: str | None, tiled: bool) -> None:
    """How the library is to write an .exr file of this description."""
    spec.attribute("compression", compression or COMPRESSIONS[0])
    edge = _ROWS if tiled else 0
    spec.tile_width, spec.tile_height, spec.tile_depth = edge, edge, int(tiled)


def file_bytes(spec: Any, ending: str, size: int, write: Callable[[Any], bool]) -> bytes:
    """The file that the library's writer of an ending makes, in memory.

    write: is given the opened writer, and returns whether all went well. size: that the file will
    not exceed. Raises ResourceError where the writer fails.
    """
    import OpenImageIO as oiio

    output = oiio.ImageOutput.create(f"image{ending}")
    if output is None:
        raise ResourceError(oiio.geterror() or f"no writer for {ending}")
    with _memory_file(size) as path:
        ok = output.open(path, spec) and write(output)
        reason = output.geterror()
        if not (output.close() and ok):
            raise ResourceError(reason or output.geterror() or f"the writer of {ending} failed")
        return Path(path).read_bytes()


def _stacked(
    data: NDArray[Any], parts: Mapping[str, NDArray[Any]], row: int
) -> NDArray[np.float32]:
    """Some rows, from `row`, of all channels; the writer rounds those of 16 bits."""
    rows = slice(row, row + _ROWS)
    half = data.dtype == np.float16
    return np.concatenate(
        [
            data[rows].astype(np.float32),
            *(
                (_half(v[rows]) if half and name not in PRECISE else v[rows]).astype(np.float32)
                for name, v in parts.items()
            ),
        ],
        axis=2,
    )


def largest_file(data: NDArray[Any], metadata: dict[str, str]) -> int:
    """Bytes that no picture file is larger than, however badly it can be compressed."""
    return data.nbytes + data.nbytes // 4 + 64 * len(data) + 8 * len(str(metadata)) + 65536


@contextmanager
def _memory_file(size: int) -> Iterator[str]:
    """The path of a file in memory; where there is no such thing, of a temporary one.

    Raises OSError where the process may not write files of that size (`ulimit -f`).
    """
    if hasattr(os, "memfd_create"):
        handle = os.memfd_create("parhelion")
        try:
            os.ftruncate(handle, size)  # takes no memory; the writer begins at 0 again
            yield f"/proc/self/fd/{handle}"
        finally:
            os.close(handle)
    else:
        with tempfile.TemporaryDirectory() as folder:
            yield os.path.join(folder, "image")
