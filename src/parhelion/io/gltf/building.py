"""A glTF document in the making, with its one buffer."""

from __future__ import annotations

import base64
import struct
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...errors import SceneError

_COMPONENTS = {"uint8": 5121, "uint16": 5123, "uint32": 5125, "float32": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
# what a bufferView is for
VERTICES, INDICES = 34962, 34963
# a file's length is a whole number of 32 bits
_LONGEST = 2**32 - 1


def text(name: Any) -> str:
    """A name that can be written; one that comes from a file's may be no text."""
    return str(name).encode(errors="backslashreplace").decode()


class Builder:
    """`json`: the document; its lists are made when something is added to them."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"Parhelion {__version__}"}
        }
        self._parts: list[Any] = []
        self._size = 0
        self._extensions: dict[str, bool] = {}
        self._made: dict[Any, int] = {}
        self._kept: list[Any] = []  # so that no id() is given twice

    def add(self, kind: str, thing: dict[str, Any]) -> int:
        """Another object in a list of the document; its index."""
        things = self.json.setdefault(kind, [])
        things.append(thing)
        return len(things) - 1

    def once(self, kind: str, thing: dict[str, Any]) -> int:
        """As add(), but the index of an equal one if there is one."""
        key = (kind, msgspec.json.encode(thing))
        if key not in self._made:
            self._made[key] = self.add(kind, thing)
        return self._made[key]

    def uses(self, extension: str, required: bool = False) -> None:
        """Notes an extension; required: a file without it makes no sense."""
        self._extensions[extension] = self._extensions.get(extension, False) or required

    def view(self, data: Any, target: int | None = None) -> int:
        """A bufferView of an array or of bytes."""
        self._pad()
        size = data.nbytes if isinstance(data, np.ndarray) else len(data)
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": size}
        if target is not None:
            view["target"] = target
        self._parts.append(data)
        self._size += size
        return self.add("bufferViews", view)

    def _pad(self) -> None:
        gap = -self._size % 4
        if gap:
            self._parts.append(bytes(gap))
            self._size += gap

    def accessor(self, array: NDArray[Any], target: int | None = None, bounds: bool = False) -> int:
        """An accessor of (N,) or (N, width) numbers."""
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        made: dict[str, Any] = {
            "bufferView": self.view(little, target),
            "componentType": _COMPONENTS[array.dtype.name],
            "type": _TYPES[array.shape[1] if array.ndim == 2 else 1],
            "count": len(array),
        }
        if bounds:
            made |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        return self.add("accessors", made)

    def shared(self, given: Any, part: Any, array: NDArray[Any], **options: Any) -> int:
        """An accessor that is made once of each object `given`, as its `part`."""
        key = ("accessor", id(given), part)
        if key not in self._made:
            self._kept.append(given)
            self._made[key] = self.accessor(array, **options)
        return self._made[key]

    def pieces(self, binary: bool) -> Iterator[Any]:
        """The bytes of the file: of a .glb, or of a .gltf that holds its buffer itself."""
        self._pad()
        document = dict(self.json)
        if self._extensions:
            document["extensionsUsed"] = sorted(self._extensions)
        required = sorted(name for name, needed in self._extensions.items() if needed)
        if required:
            document["extensionsRequired"] = required
        if self._parts:
            document["buffers"] = [{"byteLength": self._size}]
        if not binary:
            if self._parts:
                data = base64.b64encode(b"".join(bytes(memoryview(p)) for p in self._parts))
                uri = "data:application/octet-stream;base64," + data.decode()
                document["buffers"][0]["uri"] = uri
            yield msgspec.json.format(msgspec.json.encode(document), indent=1)
            return
        text = msgspec.json.encode(document)
        text += b" " * (-len(text) % 4)
        size = 12 + 8 + len(text) + (8 + self._size if self._parts else 0)
        if size > _LONGEST:
            raise SceneError(f"a .glb file has at most 4 GiB; this scene needs {size / 2**30:.1f}")
        yield struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
        yield text
        if self._parts:
            yield struct.pack("<II", self._size, 0x004E4942)
            yield from self._parts
