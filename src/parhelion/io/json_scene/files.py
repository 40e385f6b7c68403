"""The files that a scene is allowed to name: arrays, pictures and meshes beside it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import prod
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError, ResourceError, SceneError
from ...tables import LARGEST
from .. import files, require_memory
from ..meshes import MeshData
from .document import Pixels, Stored
from .messages import clip
from .sidefile import SideFile

MESH_READERS = {".obj": "obj", ".ply": "ply", ".serialized": "serialized"}


class Folders(files.Folders):
    """With readers of what JSON scenes name. side: the scene's side file, if it has one."""

    side: SideFile | None = None

    def file(self, name: str, where: str, beside: Path | None = None) -> Path:
        """As of any scene; but a path that leaves the folder, if only to return, on any system, is
        refused, so that a scene works wherever its folder goes.
        """
        parts = (*PurePosixPath(name).parts, *PureWindowsPath(name).parts)
        leaves = name.startswith("/") or PureWindowsPath(name).anchor or ".." in parts
        if leaves and self.roots == (self.own,):
            raise self.outside(name, where)
        return super().file(name, where, beside)

    def array(
        self, name: str, shapes: Sequence[tuple[int, ...]], low: float, whole: bool, where: str
    ) -> NDArray[Any]:
        """A .npy file's array, N of one of `shapes`; N >= 1.

        float32 and float64 stay what they are; each number must lie in [low, LARGEST]. whole: an
        array of whole numbers, which comes as int64.
        """
        shown = clip(name)
        if not name.endswith(".npy"):
            raise SceneError(f"{where}: is {shown!r}; must be an array or the name of a .npy file")
        file = self.file(name, where)
        try:
            # Mapping the file first checks its size against its header, before memory is asked for.
            # It is copied all the same: to write to a mapped file would end this process.
            array = np.lib.format.open_memmap(file, mode="r")
        except OSError as error:
            reason = error.strerror or error
            raise SceneError(f"{where}: {shown!r} cannot be read: {reason}") from None
        except Exception as error:  # a broken header may raise nearly anything
            raise SceneError(f"{where}: {shown!r} is no valid .npy file: {error}") from None
        require_memory(file, factor=1.0)
        if array.ndim == 0 or array.shape[1:] not in shapes:
            wanted = " or ".join(
                f"(N, {', '.join(map(str, shape))})" if shape else "(N,)" for shape in shapes
            )
            raise SceneError(f"{where}: {shown!r} has shape {array.shape}; must be {wanted}")
        single = array.dtype.kind == "f" and array.dtype.itemsize <= 4
        kind = np.int64 if whole else np.float32 if single else np.float64
        _check(array, low, whole, f"{where}: {shown!r}")
        return np.array(array, dtype=kind, order="C")

    def stored(
        self,
        place: Stored,
        shapes: Sequence[tuple[int, ...]],
        low: float,
        whole: bool,
        where: str,
    ) -> NDArray[Any]:
        """An array of the side file, N of one of `shapes`, of the type that it has there."""
        if tuple(place.shape[1:]) not in shapes:
            wanted = " or ".join(str(["N", *shape]).replace("'", "") for shape in shapes)
            raise SceneError(f"{where}.shape: is {place.shape}; must be {wanted}")
        array = self._from_side(place.shape, place.type, place.at, where)
        _check(array, low, whole, where)
        return array

    def _from_side(self, shape: list[int], kind: str, at: int, where: str) -> NDArray[Any]:
        if self.side is None:
            raise SceneError(f"{where}: is in a side file, which $.arrays does not name")
        return self.side.array(shape, kind, at, where)

    def image(self, value: str | Pixels, where: str) -> str | NDArray[Any]:
        """The path of a picture, or pixels that the document holds itself."""
        if isinstance(value, str):
            return str(self.file(value, where))
        if (value.data is None) == (value.at is None):
            raise SceneError(f"{where}: needs 'data' or 'at', one of them")
        if value.at is not None:
            return self._from_side(value.shape, value.type, value.at, where)
        assert value.data is not None
        size = prod(value.shape) * np.dtype(value.type).itemsize
        if len(value.data) != size:
            raise SceneError(
                f"{where}.data: has {len(value.data)} bytes; {value.type} of shape"
                f" {tuple(value.shape)} has {size}"
            )
        little = np.dtype(value.type).newbyteorder("<")
        return np.frombuffer(value.data, little).reshape(value.shape).astype(value.type)

    def mesh(self, name: str, index: int, where: str) -> MeshData:
        """What a mesh file holds."""
        shown, ending = clip(name), PurePosixPath(name).suffix
        if ending not in MESH_READERS:
            choices = ", ".join(MESH_READERS)
            raise SceneError(f"{where}: is {shown!r}; must be a mesh file (choices: {choices})")
        if index and ending != ".serialized":
            raise SceneError(f"{where}_index: is {index}; only .serialized files have several")
        file = self.file(name, where)
        reader = import_module(f"...meshes.{MESH_READERS[ending]}", __name__)
        try:
            data = reader.read(file, index) if ending == ".serialized" else reader.read(file)
        except FormatError as error:
            raise SceneError(f"{where}: {error}") from None
        except ResourceError:
            raise
        except OSError as error:
            reason = error.strerror or error
            raise SceneError(f"{where}: {shown!r} cannot be read: {reason}") from None
        assert isinstance(data, MeshData)
        return data


def _check(array: NDArray[Any], low: float, whole: bool, where: str) -> None:
    """Raises SceneError unless all are numbers in [low, LARGEST], and there are some."""
    kinds, noun = ("iu", "whole") if whole else ("fiu", "real")
    if array.dtype.kind not in kinds:
        raise SceneError(f"{where} holds {array.dtype}; must be {noun} numbers")
    if len(array) == 0:
        raise SceneError(f"{where} is empty")
    high = 2**31 - 1 if whole else LARGEST
    for extreme in (array.argmin(), array.argmax()):  # both find a NaN if there is one
        number = array.flat[extreme].item()
        if not low <= number <= high:
            place = "".join(f"[{i}]" for i in np.unravel_index(extreme, array.shape))
            rule = "> 0" if 0 < low < 1 else f">= {low:g}"
            raise SceneError(f"{where}: {place} is {number:g}; must be {rule} and <= {high:g}")
