"""KHR_draco_mesh_compression, unpacked by DracoPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import schema
from .source import Source


@dataclass(frozen=True, eq=False)
class Unpacked:
    """faces: (F, 3). attributes: (V, width) arrays by glTF's names."""

    faces: NDArray[Any]
    attributes: dict[str, NDArray[Any]]


def decode(s: Source, packed: schema.Draco, where: str) -> Unpacked:
    """The mesh in a compressed view. Raises FormatError."""
    where = f"{where}.extensions.KHR_draco_mesh_compression"
    try:
        import DracoPy
    except ImportError:
        raise s.error(f"{where}: needs the package DracoPy: pip install DracoPy") from None
    data = bytes(s.view(packed.buffer_view, f"{where}.bufferView"))
    try:
        mesh = DracoPy.decode(data)
    except Exception as error:  # the library has several kinds
        raise s.error(f"{where}: cannot be unpacked: {error}") from None
    faces = getattr(mesh, "faces", None)
    if faces is None:
        raise s.error(f"{where}: is a point cloud; a mesh is needed")
    attributes = {}
    for name, number in packed.attributes.items():
        found = mesh.get_attribute_by_unique_id(number)
        if found is None:
            raise s.error(f"{where}.attributes.{name}: the data has no attribute {number}")
        values = np.asarray(found["data"])
        attributes[name] = values.reshape(len(values), -1)
        s.spend(values.nbytes, where)
    return Unpacked(np.asarray(faces).reshape(-1, 3), attributes)
