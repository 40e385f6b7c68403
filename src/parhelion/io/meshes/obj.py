"""Wavefront OBJ: v, vt, vn and f lines, and which material each face has.

Each different corner v/vt/vn becomes a vertex. Polygons are split into fans. Colours after the
coordinates of a vertex, as many programs write them, are the attribute vertex_color, sRGB decoded.
Groups, smoothing, lines, points and free-form surfaces are passed over.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ... import _core
from ...errors import FormatError
from ...spectra import decode_srgb
from ..files import contents
from . import Floats, Integers, MeshData, triangulate


@dataclass(frozen=True)
class Groups:
    """Which material each triangle has.

    names: of the materials, in the order of their first use; "" is none. of_face: (F,) indices.
    libraries: names of the files that define them. left_out: what else the file asks for, in words.
    """

    names: list[str]
    of_face: Integers
    libraries: list[str]
    left_out: list[str]


def read(path: Path) -> MeshData:
    """The file as one mesh. Raises FormatError, naming the line, and OSError."""
    return read_groups(path)[0]


def read_groups(path: Path) -> tuple[MeshData, Groups]:
    """The file as one mesh, and its faces' materials. Raises FormatError and OSError."""
    try:
        data = contents(path)
        if b"\n" not in data:  # lines as of old Macintoshes
            data = data.replace(b"\r", b"\n")
        text = _core.obj(data)
    except _core.ObjError as error:
        raise FormatError(f"{path}: {error}") from None
    left_out = [f"statement {word!r}: not supported; left out" for word in text["unknown"]]
    if not len(text["sizes"]):
        others = f"; of {', '.join(text['unknown'])} nothing is made" if left_out else ""
        raise FormatError(f"{path}: has no faces ('f' lines){others}")
    mesh, polygon = _indexed(path, text)
    uses, libraries = (
        [
            (at, rest.decode("utf-8", "replace"))
            for at, word, rest in text["statements"]
            if word == w
        ]
        for w in (b"usemtl", b"mtllib")
    )
    names = list(dict.fromkeys(["", *(name for _, name in uses)]))
    number = np.array([0, *(names.index(name) for _, name in uses)])
    use = np.searchsorted([at for at, _ in uses], polygon, "right")  # how many came before
    return mesh, Groups(names, number[use], [name for _, name in libraries], left_out)


def _indexed(path: Path, text: dict[str, Any]) -> tuple[MeshData, Integers]:
    """The mesh, corners that differ in anything as different vertices in the order of the file; and
    the polygon of each triangle.
    """
    corners = text["corners"]
    uv = normal = None
    if corners.shape[1] == 1:
        used = np.zeros(len(text["positions"]), bool)
        used[corners[:, 0]] = True
        at, which = np.flatnonzero(used), corners[:, 0]
        if not used.all():
            which = (np.cumsum(used) - 1)[which]
    else:
        which, first = _core.distinct_rows(corners.view(np.uint32))
        at, uv, normal = corners[first].T
    vertices = text["positions"][at]
    faces, polygon = triangulate(str(path), text["sizes"].astype(np.int64), which, vertices)
    colors = text["colors"]
    if len(colors):
        colors = np.clip(colors / (255.0 if np.any(colors > 1.0) else 1.0), 0.0, 1.0)
    mesh = MeshData(
        vertices=vertices,
        faces=faces,
        normals=_of(text["normals"], normal),
        uvs=_of(text["uvs"], uv),
        attributes={"vertex_color": decode_srgb(colors[at])} if len(colors) else {},
    )
    return mesh, polygon


def _of(values: Floats, places: Integers | None) -> Floats | None:
    """The values at these places; None where some vertex has none."""
    return None if places is None or (places < 0).any() else values[places]
