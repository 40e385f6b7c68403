"""The files that a scene is allowed to name: arrays, pictures and meshes beside it."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import prod
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError, SceneError
from ...tables import LARGEST
from .. import files
from ..meshes import MeshData
from .document import Pixels
from .messages import clip

MESH_READERS = {".obj": "obj", ".ply": "ply", ".serialized": "serialized"}


class Folders(files.Folders):
    """With readers of what JSON scenes name."""

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
        if array.ndim == 0 or array.shape[1:] not in shapes:
            wanted = " or ".join(
                f"(N, {', '.join(map(str, shape))})" if shape else "(N,)" for shape in shapes
            )
            raise SceneError(f"{where}: {shown!r} has shape {array.shape}; must be {wanted}")
        kinds, noun = ("iu", "whole") if whole else ("fiu", "real")
        if array.dtype.kind not in kinds:
            raise SceneError(f"{where}: {shown!r} holds {array.dtype}; must be {noun} numbers")
        if len(array) == 0:
            raise SceneError(f"{where}: {shown!r} is empty")
        single = array.dtype.kind == "f" and array.dtype.itemsize <= 4
        kind = np.int64 if whole else np.float32 if single else np.float64
        high = 2**31 - 1 if whole else LARGEST
        for extreme in (array.argmin(), array.argmax()):  # both find a NaN if there is one
            number = array.flat[extreme].item()
            if not low <= number <= high:
                place = "".join(f"[{i}]" for i in np.unravel_index(extreme, array.shape))
                rule = "> 0" if 0 < low < 1 else f">= {low:g}"
                raise SceneError(
                    f"{where}: {shown!r}: {place} is {number:g}; must be {rule} and <= {high:g}"
                )
        return np.array(array, dtype=kind, order="C")

    def image(self, value: str | Pixels, where: str) -> str | NDArray[Any]:
        """The path of a picture, or pixels that the document holds itself."""
        if isinstance(value, str):
            return str(self.file(value, where))
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
        except OSError as error:
            reason = error.strerror or error
            raise SceneError(f"{where}: {shown!r} cannot be read: {reason}") from None
        assert isinstance(data, MeshData)
        return data
