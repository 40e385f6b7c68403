"""OFF, the Object File Format: text with vertices and polygons, both maybe coloured.

The first word tells what follows each vertex: OFF nothing, COFF a colour, NOFF a normal, STOFF a
texture coordinate, and their combinations in the order STCNOFF. Colours are 0 to 255 if any is
above 1, sRGB; of an opacity nothing is made.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...spectra import decode_srgb
from ..files import contents
from . import Floats, MeshData, check_corners, triangulate
from .numbers import parse, words_per_line

_HEADER = re.compile(rb"\s*(ST)?(C)?(N)?OFF\b")


def read(path: Path) -> MeshData:
    """The file as one mesh. Raises FormatError, naming the face, and OSError."""
    text = re.sub(rb"#[^\n]*", b"", contents(path))
    header = _HEADER.match(text)
    if header is None:
        raise FormatError(f"{path}: is no OFF file: it does not begin with OFF, COFF or NOFF")
    try:
        numbers = parse(text[header.end() :])
    except ValueError as error:
        raise FormatError(f"{path}: holds {error}") from None
    sizes = numbers[:3]
    if len(sizes) < 3 or not np.all((sizes >= 0) & (sizes < 2**53) & (sizes == np.floor(sizes))):
        raise FormatError(f"{path}: needs the numbers of vertices, faces and edges")
    vertex_count, face_count = int(sizes[0]), int(sizes[1])
    with_uvs, with_colors, with_normals = (part is not None for part in header.groups())
    # A vertex's line tells whether a colour has an opacity; so does what is left for the faces.
    width = 3 + 3 * with_normals + 2 * with_uvs
    if with_colors:
        width += _color_width(text, header.end(), width)
    # Faces have a line each, vertices need not.
    words = words_per_line(np.frombuffer(text[header.end() :] + b"\n", np.uint8))
    words = words[words > 0]
    rest = len(numbers) - 3
    if vertex_count * width > rest or face_count > len(words):
        raise FormatError(
            f"{path}: its header tells of {vertex_count} vertices and {face_count} faces; it has"
            f" {rest} numbers in {len(words)} lines"
        )
    vertex = numbers[3 : 3 + vertex_count * width].reshape(vertex_count, width)
    faces, face_colors = _faces(path, numbers, words[len(words) - face_count :], vertex[:, :3])
    at = 3
    normals = uvs = None
    attributes: dict[str, Floats] = {}
    if with_normals:
        normals, at = vertex[:, at : at + 3], at + 3
    if with_colors:
        attributes["vertex_color"] = _color(vertex[:, at : at + 3])
        at = width - 2 * with_uvs
    if with_uvs:
        uvs = vertex[:, at : at + 2]
    if face_colors is not None:
        attributes["face_color"] = face_colors
    return MeshData(vertex[:, :3], faces, normals, uvs, attributes)


def _color_width(text: bytes, begin: int, width: int) -> int:
    """3 or 4, by the first vertex's line: the second one of numbers."""
    lines = [line for line in text[begin : begin + 4096].split(b"\n") if line.strip()]
    return 4 if len(lines) > 1 and len(lines[1].split()) - width >= 4 else 3


def _color(rgb: Floats) -> Floats:
    scale = 255.0 if np.any(rgb > 1.0) else 1.0
    return decode_srgb(np.clip(rgb / scale, 0.0, 1.0))


def _faces(
    path: Path, numbers: Floats, words: NDArray[np.int64], vertices: Floats
) -> tuple[NDArray[np.int64], Floats | None]:
    """(F, 3) corners of triangles, and (F, 3) colours where all faces have one.

    words: how many numbers each face's line has, the last line's being the last.
    """
    if not len(words):
        raise FormatError(f"{path}: has no faces")
    starts = len(numbers) - words[::-1].cumsum()[::-1]
    counts = numbers[starts]
    bad = ~((counts >= 3) & (counts == np.floor(counts)) & (counts < words))
    if bad.any():
        face = int(np.argmax(bad))
        raise FormatError(
            f"{path}: face {face} has {counts[face]:g} corners and a line of {words[face]} numbers"
        )
    sizes = counts.astype(np.int64)
    within = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    corners = numbers[np.repeat(starts + 1, sizes) + within]
    if not np.all((corners == np.floor(corners)) & (np.abs(corners) < 2**53)):
        raise FormatError(f"{path}: its faces hold something that is no index")
    indices = corners.astype(np.int64)
    check_corners(str(path), sizes, indices, len(vertices))
    triangles, polygon = triangulate(str(path), sizes, indices, vertices)
    colors = None
    if np.all(words - 1 - sizes >= 3):
        colors = _color(numbers[(starts + 1 + sizes)[:, None] + np.arange(3)])[polygon]
    return triangles, colors
