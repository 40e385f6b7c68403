"""Pictures that a stage names, in files or in the .usdz archive."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Ar

from ...errors import SceneError
from ...image import PictureBytes, picture_shape, read_pixels
from ...spectra import decode_srgb
from ..files import Folders

# Bytes of a picture in an archive
_LARGEST = 1 << 31


class Images:
    """The pictures of one stage, each read once."""

    def __init__(self, folders: Folders) -> None:
        self._folders = folders
        self._packed: dict[str, PictureBytes] = {}
        self._read: dict[str, NDArray[Any]] = {}
        self._linear: dict[tuple[str, bool], NDArray[np.float32]] = {}

    def image(self, asset: Any, where: str) -> str | PictureBytes | None:
        """The file's path, or the bytes of one in an archive; None if it is not there.

        Raises SceneError if it lies elsewhere or its header cannot be read.
        """
        found = self._found(asset, where)
        if found is None:
            return None
        if not Ar.IsPackageRelativePath(found):
            picture_shape(found, where)
            return found
        if found not in self._packed:
            self._packed[found] = PictureBytes(_packed(found, where), found)
            picture_shape(self._packed[found], where)
        return self._packed[found]

    def has_colors(self, asset: Any, where: str) -> bool:
        """Whether it has 8 bits and 3 or 4 channels, which USD holds to be sRGB."""
        pixels = self._pixels(self._found(asset, where) or "", where)
        return pixels.dtype == np.uint8 and pixels.shape[2] >= 3

    def linear(self, asset: Any, srgb: bool, where: str) -> NDArray[np.float32]:
        """(H, W, 4) numbers to compute with; grey is in all three colours, and alpha 1 by default.

        The array is shared; change a copy.
        """
        name = self._found(asset, where) or ""
        if (name, srgb) not in self._linear:
            pixels = self._pixels(name, where)
            values = pixels.astype(np.float32)
            if pixels.dtype.kind in "iu":
                values /= np.float32(np.iinfo(pixels.dtype).max)
            channels = values.shape[2]
            full = np.ones((*values.shape[:2], 4), np.float32)
            full[:, :, :3] = values[:, :, :3] if channels >= 3 else values[:, :, :1]
            if channels in (2, 4):
                full[:, :, 3] = values[:, :, -1]
            if srgb:
                full[:, :, :3] = decode_srgb(full[:, :, :3])
            self._linear[name, srgb] = full
        return self._linear[name, srgb]

    def _found(self, asset: Any, where: str) -> str | None:
        """The resolved name of a file that may be read."""
        name = asset.resolvedPath or asset.path
        outer = Ar.SplitPackageRelativePathOuter(name)[0]
        try:
            file = (self._folders.own / outer).resolve()
            if not self._folders.allows(file):
                raise self._folders.outside(asset.path, where)
            if not asset.resolvedPath or not file.is_file():
                return None
        except SceneError:
            raise
        except (OSError, RuntimeError, ValueError):  # too long, a loop of links, a NUL
            return None
        return str(asset.resolvedPath)

    def _pixels(self, name: str, where: str) -> NDArray[Any]:
        if name not in self._read:
            if Ar.IsPackageRelativePath(name):
                data = _packed(name, where)
                self._read[name] = read_pixels(data, f"{where}: {name!r}")
            else:
                self._read[name] = read_pixels(name, where)
        return self._read[name]


def _packed(name: str, where: str) -> bytes:
    """The bytes of archive.usdz[picture.png]; archives may lie in archives."""
    outer, inner = Ar.SplitPackageRelativePathOuter(name)
    source: Any = outer
    while True:
        entry, inner = Ar.SplitPackageRelativePathOuter(inner)
        try:
            with zipfile.ZipFile(source) as archive:
                information = archive.getinfo(entry)
                if information.compress_type != zipfile.ZIP_STORED:
                    raise SceneError(f"{where}: {name!r} is compressed; a .usdz's files are not")
                if information.file_size > _LARGEST:
                    raise SceneError(f"{where}: {name!r} is larger than {_LARGEST >> 30} GiB")
                data = archive.read(information)
        except (KeyError, OSError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
            raise SceneError(f"{where}: {name!r} cannot be read: {error}") from None
        if not inner:
            return data
        source = io.BytesIO(data)
