"""A finished picture: its pixels, how it came about, and writing it to a file."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .atomic import is_special, replacing
from .errors import ResourceError, SceneError, unknown_name
from .scene import Camera, Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .flatten import Flat

# ending -> bits a channel that it can hold, its default first
WRITABLE = {".png": (8, 16), ".jpg": (8,), ".jpeg": (8,), ".exr": (32, 16)}


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

    NumPy takes it for its pixels; a notebook shows it.
    """

    pixels: NDArray[np.float32]
    counts: NDArray[np.uint32]
    stats: RenderStats
    settings: Settings
    camera: Camera
    flat: Flat

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

    def srgb(self, bits: int = 8) -> NDArray[Any]:
        """The picture as screens want it: sRGB, (H, W, 3) uint8 or uint16, cut at white."""
        top = 2**bits - 1
        scaled = srgb_encoded(self.pixels) * np.float32(top) + np.float32(0.5)
        stored: NDArray[Any] = scaled.astype(np.uint8 if bits == 8 else np.uint16)
        return stored

    def metadata(self) -> dict[str, str]:
        """What is written into a file beside the pixels."""
        from . import __version__

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
        }

    def save(self, path: str | os.PathLike[str], bits: int | None = None) -> None:
        """Writes the picture; the ending of the name says how.

        .png (bits 8 or 16) and .jpg are sRGB; .exr is linear (bits 32 or 16). A file that is there
        already stays whole until the new one is complete.

        Raises SceneError for an unknown ending or number of bits, ResourceError where the file
        cannot be written.
        """
        file = Path(path)
        check_output(file, bits)
        ending = file.suffix.lower()
        depth = bits or WRITABLE[ending][0]
        data: NDArray[Any]
        if ending == ".exr":
            data = self.pixels
            if depth == 16:  # brighter than its largest number would become infinite
                data = np.minimum(data, np.finfo(np.float16).max).astype(np.float16)
        else:
            data = self.srgb(depth)
        with replacing(file) as temporary:
            temporary.write_bytes(encoded(data, self.metadata(), ending))

    def png_bytes(self) -> bytes:
        """The picture as the bytes of an 8-bit sRGB PNG file."""
        return encoded(self.srgb(), self.metadata(), ".png")

    def _repr_png_(self) -> bytes:
        return self.png_bytes()


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


def check_output(path: str | os.PathLike[str], bits: int | None = None) -> None:
    """Raises what save() would for a name that cannot be written, before the work is done."""
    file = Path(path)
    ending = file.suffix.lower()
    if ending not in WRITABLE:
        raise SceneError(f"{file}: {unknown_name('picture ending', ending, WRITABLE)}")
    if bits is not None and bits not in WRITABLE[ending]:
        choices = ", ".join(map(str, WRITABLE[ending]))
        raise SceneError(f"{file}: {ending} cannot hold {bits} bits a channel (choices: {choices})")
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


def encoded(data: NDArray[Any], metadata: dict[str, str], ending: str) -> bytes:
    """Pixels, (H, W, channels), as the bytes of a file with that ending.

    The library writes into memory, for where there is no room some of its writers report success
    and one ends the process.
    """
    import OpenImageIO as oiio

    height, width, channels = data.shape
    names = {"float32": "float", "float16": "half"}
    spec = oiio.ImageSpec(width, height, channels, names.get(str(data.dtype), str(data.dtype)))
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
    with _memory_file(largest_file(data, metadata)) as path:
        ok = output.open(path, spec) and output.write_image(np.ascontiguousarray(data))
        reason = output.geterror()
        if not (output.close() and ok):
            raise ResourceError(reason or output.geterror() or f"the writer of {ending} failed")
        return Path(path).read_bytes()


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
