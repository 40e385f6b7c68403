"""A finished picture: its pixels, how it came about, and writing it to a file."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import cryptomatte
from .atomic import is_special, replacing
from .errors import FormatError, ResourceError, SceneError, option, unknown_name
from .scene import Camera, ColorBar, Settings, Swatches

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .flatten import Flat

# ending -> bits a channel that it can hold, its default first
WRITABLE = {".png": (8, 16), ".jpg": (8,), ".jpeg": (8,), ".exr": (32, 16)}

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
    "coverage": "A",
    "shape": "V",
    "material": "V",
}
# What the channels of a feature are called in an EXR file, "depth.Z" and so on, the names by which
# compositing programs know what they hold. Those of PRECISE are always stored in 32 bits.
CHANNELS = {name: tuple(f"{name}.{c}" for c in letters) for name, letters in _LETTERS.items()} | {
    layer: cryptomatte.channels(layer) for layer in cryptomatte.LAYERS
}
PRECISE = {"depth", "position", "uv", "shape", "material", *cryptomatte.LAYERS}

# Bytes that any picture may unpack to, and how many times its file's size one may beyond that: a
# header is a few bytes that can claim any size.
_ALWAYS = 1 << 30
_RATIO = 20
# How numbers are read that are not read as float, and their bytes
_KINDS = {"uint8": ("uint8", 1), "uint16": ("uint16", 2)}

# Stops by which a picture may be made brighter or darker: beyond, all would be white or black.
_MOST_EXPOSURE = 32.0

# Rows that the writer of EXR gets at a time: with features, a copy of a whole picture would be as
# large as all else together.
_ROWS = 64


@dataclass(frozen=True)
class RenderStats:
    """seconds: of rendering, wall clock, without the tree's build. samples, rays: in all.
    isa: instruction set. complete: False if it was stopped early. build_seconds: checks and tree.
    """

    seconds: float
    samples: int
    rays: int
    threads: int
    isa: str
    complete: bool
    build_seconds: float


@dataclass(frozen=True, eq=False, repr=False)
class Image:
    """pixels: (H, W, 3) float32, linear Rec. 709. counts: (H, W) samples in each pixel.

    features: what the first surfaces look like, if they were asked for: (H, W, 1 to 3) float32 by
    name, means over a pixel's samples: depth (distance from the camera), position, normal
    (geometric), shading_normal and uv, over those that hit something; albedo, emission, direct and
    indirect (parts of the radiance), coverage (share that hit something). shape and material, (H,
    W), are indices into flat.shape_names and flat.material_names of the first sample's, -1 for
    none. CryptoObject and CryptoMaterial, (H, W, 6, 2), are Cryptomattes: of the six shapes, or
    materials, that most samples of the pixel hit, the largest first, the id of the name and the
    share of the samples; matte() looks a name up.

    legend: what the scene's colours stand for, if they stand for something.

    NumPy takes it for its pixels; a notebook shows it.
    """

    pixels: NDArray[np.float32]
    counts: NDArray[np.uint32]
    stats: RenderStats
    settings: Settings
    camera: Camera
    flat: Flat
    features: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    legend: ColorBar | Swatches | None = None

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
        return f"<Image {width}x{height}, {self.settings.spp} spp{done}>"

    def srgb(self, bits: int = 8, legend: bool = False, exposure: float = 0.0) -> NDArray[Any]:
        """The picture as screens want it: sRGB, (H, W, 3) uint8 or uint16, cut at white.

        legend: with what the colours stand for at its right side; raises SceneError if they stand
        for nothing. exposure: stops; light is multiplied by 2^exposure before it is encoded.
        """
        pixels, stops = self.pixels, checked_exposure(exposure)
        if stops:
            with np.errstate(over="ignore"):  # infinite is white as well
                pixels = pixels * np.float32(2.0**stops)
        stored = srgb_stored(pixels, bits)
        if not legend:
            return stored
        from .legend import panel

        beside = panel(checked_legend(self.legend), len(stored)).astype(stored.dtype)
        return np.concatenate([stored, beside * (1 if bits == 8 else 257)], axis=1)

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
        from . import __version__

        names: dict[str, str] = {}
        if self.features:
            names["parhelion:shapes"] = json.dumps(self.flat.shape_names)
            names["parhelion:materials"] = json.dumps(self.flat.material_names)
        return {
            "Software": f"Parhelion {__version__}",
            "parhelion:version": __version__,
            "parhelion:scene": self.flat.sha256(),
            "parhelion:seed": str(self.settings.seed),
            "parhelion:spp": str(self.settings.spp),
            "parhelion:samples": str(self.stats.samples),
            "parhelion:complete": str(self.stats.complete).lower(),
            "parhelion:settings": json.dumps(asdict(self.settings)),
            "parhelion:camera": json.dumps(asdict(self.camera), default=float),
            "parhelion:time": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "parhelion:seconds": f"{self.stats.seconds:.3f}",
            "parhelion:threads": str(self.stats.threads),
            "parhelion:isa": self.stats.isa,
            **names,
        }

    def save(
        self,
        path: str | os.PathLike[str],
        bits: int | None = None,
        legend: bool = False,
        exposure: float = 0.0,
    ) -> None:
        """Writes the picture; the ending of the name says how.

        .png (bits 8 or 16) and .jpg are sRGB; .exr is linear (bits 32 or 16) and holds the
        features, if there are any, as layers. A file that is there already stays whole until the
        new one is complete. legend: what the colours stand for is drawn at the right side of the
        picture, which becomes wider. exposure: stops by which what is sRGB is made brighter; linear
        values stay, and their file says in its metadata at which exposure they are to be seen.

        Raises SceneError for an unknown ending or number of bits, and a legend where there is none,
        ResourceError where the file cannot be written.
        """
        file = Path(path)
        check_output(file, bits, legend=legend, exposure=exposure)
        ending = file.suffix.lower()
        depth = bits or WRITABLE[ending][0]
        data: NDArray[Any]
        if ending == ".exr":
            data = _half(self.pixels) if depth == 16 else self.pixels
        else:
            data = self.srgb(depth, legend, exposure)
        layers = self.features if ending == ".exr" else {}
        told = self.metadata() | {"parhelion:exposure": f"{checked_exposure(exposure):g}"}
        for layer, names in self._matte_names().items():
            if layer in layers:
                told |= cryptomatte.attributes(layer, names)
        with replacing(file) as temporary:
            temporary.write_bytes(encoded(data, told, ending, layers))

    def png_bytes(self) -> bytes:
        """The picture as the bytes of an 8-bit sRGB PNG file."""
        return encoded(self.srgb(), self.metadata(), ".png")

    def _repr_png_(self) -> bytes:
        return self.png_bytes()


def checked_legend(legend: ColorBar | Swatches | None) -> ColorBar | Swatches:
    """The legend. Raises SceneError if there is none."""
    if legend is None:
        raise SceneError(
            "there is no legend: the scene's colours stand for nothing; particles and meshes may be"
            f" coloured by a field ({option('color_by')})"
        )
    return legend


def checked_exposure(exposure: Any) -> float:
    """A number of stops. Raises SceneError for anything else."""
    try:
        stops = float(exposure)
    except (TypeError, ValueError, OverflowError):
        stops = np.nan
    if not abs(stops) <= _MOST_EXPOSURE:
        raise SceneError(
            f"{option('exposure')} is {exposure!r}; must be a number of stops,"
            f" from {-_MOST_EXPOSURE:g} to {_MOST_EXPOSURE:g}"
        )
    return stops


def srgb_stored(linear: NDArray[np.float32], bits: int = 8) -> NDArray[Any]:
    """Linear light as sRGB in whole numbers, uint8 or uint16."""
    scaled = srgb_encoded(linear) * np.float32(2**bits - 1) + np.float32(0.5)
    stored: NDArray[Any] = scaled.astype(np.uint8 if bits == 8 else np.uint16)
    return stored


def srgb_encoded(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light to sRGB's encoding (IEC 61966-2-1), cut to [0, 1]; NaN becomes 0."""
    x = np.nan_to_num(linear, nan=0.0)
    np.clip(x, 0.0, 1.0, out=x)
    straight = np.float32(12.92) * x
    dark = x <= np.float32(0.0031308)
    np.power(x, np.float32(1 / 2.4), out=x)
    x *= np.float32(1.055)
    x -= np.float32(0.055)
    np.copyto(x, straight, where=dark)
    return x


def _half(data: NDArray[Any]) -> NDArray[np.float16]:
    """In 16 bits; what is brighter than their largest number would become infinite."""
    half: NDArray[np.float16] = np.minimum(data, np.finfo(np.float16).max).astype(np.float16)
    return half


def _reason(geterror: Callable[[], str]) -> str:
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

    Raises what read_pixels would for a file that is no picture or too large a one.
    """
    with _file_of(source, where) as (path, start):
        opened = _opened(path, start)
        spec = opened.spec()
        opened.close()
        return int(spec.height), int(spec.width), len(_channels(spec))


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


def _opened(path: str, where: str) -> Any:
    """The library's reader of a picture."""
    import OpenImageIO as oiio

    start = f"{where}: " if where else ""
    hints = oiio.ImageSpec()
    hints.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(path, hints)
    if source is None:
        reason = _reason(oiio.geterror).replace(f'"{path}"', "it")  # asked for even if not told
        if not os.path.isfile(path):
            what = "is no file" if os.path.exists(path) else "no such file"
            raise FormatError(f"{start}{what}")
        raise FormatError(f"{start}cannot be read: {reason}")
    spec = source.spec()
    width, height, stored = spec.width, spec.height, os.path.getsize(path)
    unpacked = width * height * spec.nchannels * _KINDS.get(str(spec.format), ("float", 4))[1]
    if unpacked > max(_ALWAYS, _RATIO * stored):
        source.close()
        raise FormatError(
            f"{start}has {width} x {height} pixels, {unpacked:,} bytes, in a file of {stored:,};"
            f" beyond {_ALWAYS >> 30} GiB at most {_RATIO} times the file are read"
        )
    return source


def _read_pixels(path: str, where: str) -> NDArray[Any]:
    start = f"{where}: " if where else ""
    source = _opened(path, where)
    try:
        spec = source.spec()
        kind = _KINDS.get(str(spec.format), ("float", 4))[0]
        pixels = source.read_image(0, 0, 0, spec.nchannels, kind)
        if pixels is None:
            raise FormatError(f"{start}cannot be read: {_reason(source.geterror)}")
    finally:
        source.close()
    chosen = _channels(spec)
    if chosen == list(range(spec.nchannels)):
        return np.ascontiguousarray(pixels)
    return np.ascontiguousarray(pixels[:, :, chosen])


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
) -> None:
    """Raises what save() would for a name that cannot be written, before the work is done."""
    file = Path(path)
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
    checked_exposure(exposure)
    check_place(file)


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


def encoded(
    data: NDArray[Any],
    metadata: dict[str, str],
    ending: str,
    layers: Mapping[str, NDArray[Any]] | None = None,
) -> bytes:
    """Pixels, (H, W, channels), as the bytes of a file with that ending.

    layers: features by name, for .exr, in as many bits as the pixels or, where that would tell too
    little, in 32.

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
    # JPEG keeps only what it knows, so everything is also told in the description
    spec.attribute("ImageDescription", json.dumps(metadata))
    if ending == ".exr":
        spec.attribute("oiio:ColorSpace", "lin_rec709_scene")
        spec.attribute("compression", "zip")
    else:
        spec.attribute("oiio:ColorSpace", "sRGB")
        spec.attribute("CompressionQuality", 95)
        spec.attribute("png:compressionLevel", 3)  # a noisy picture: 0.6 of 6's time, no larger
    output = oiio.ImageOutput.create(f"image{ending}")
    if output is None:
        raise ResourceError(oiio.geterror() or f"no writer for {ending}")
    size = largest_file(data, metadata) + sum(2 * 4 * v.size for v in parts.values())
    with _memory_file(size) as path:
        ok = output.open(path, spec)
        if ok and parts:
            ok = all(
                output.write_scanlines(row, min(row + _ROWS, height), 0, _stacked(data, parts, row))
                for row in range(0, height, _ROWS)
            )
        elif ok:
            ok = output.write_image(np.ascontiguousarray(data))
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
