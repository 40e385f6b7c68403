"""Shapes: arrays of the document or of files, as long as each other, and their materials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct
from numpy.typing import NDArray

from ... import scene as model
from ...errors import SceneError
from ...tables import LARGEST
from ..meshes import smooth_normals
from .document import (
    Curves,
    Cylinders,
    Disks,
    File,
    Instances,
    Mesh,
    Number,
    Numbers2or3,
    Spheres,
    Stored,
)
from .entries import Entries
from .messages import clip, convert, member, unknown_choice

_ABOVE_0 = 5e-324  # the smallest such number


@dataclass(frozen=True)
class _Array:
    """A field that holds an array: N of one of `shapes`, each number >= low.

    of: the field that has as many elements. whole: whole numbers.
    """

    shapes: tuple[tuple[int, ...], ...]
    low: float = -LARGEST
    of: str = ""
    whole: bool = False


_ONE, _TWO, _THREE, _FOUR = ((),), ((2,),), ((3,),), ((4,),)

_ARRAYS: dict[type[Struct], dict[str, _Array]] = {
    Spheres: {
        "centers": _Array(_THREE),
        "radii": _Array(_ONE, _ABOVE_0, "centers"),
        "colors": _Array(_THREE, 0.0, "centers"),
    },
    Mesh: {
        "vertices": _Array(_THREE),
        "faces": _Array(_THREE, 0, whole=True),
        "normals": _Array(_THREE, of="vertices"),
        "uvs": _Array(_TWO, of="vertices"),
        "tangents": _Array(_FOUR, of="vertices"),
        "colors": _Array(_THREE, 0.0, "faces"),
    },
    Disks: {
        "centers": _Array(_THREE),
        "axis_u": _Array(_THREE, of="centers"),
        "axis_v": _Array(_THREE, of="centers"),
        "colors": _Array(_THREE, 0.0, "centers"),
    },
    Cylinders: {
        "starts": _Array(_THREE),
        "ends": _Array(_THREE, of="starts"),
        "radii": _Array(_ONE, _ABOVE_0, "starts"),
        "axis_u": _Array(_THREE, of="starts"),
        "colors": _Array(_THREE, 0.0, "starts"),
    },
    # a curve's colours and materials are one a segment, which flatten counts
    Curves: {
        "points": _Array(_THREE),
        "radii": _Array(_ONE, _ABOVE_0, "points"),
        "counts": _Array(_ONE, 1, whole=True),
        "colors": _Array(_THREE, 0.0),
    },
    Instances: {
        "transforms": _Array(((3, 4), (4, 4))),
        "colors": _Array(_THREE, 0.0, "transforms"),
    },
}
ARRAY_FIELDS = {name for fields in _ARRAYS.values() for name in fields}
WHOLE_FIELDS = {name for f in _ARRAYS.values() for name, spec in f.items() if spec.whole}

# what a mesh's normals may be besides an array
_NORMALS = ("smooth", "flat")

# what a list of materials has one of
_MATERIALS_OF = {Spheres: "centers", Mesh: "faces", Disks: "centers", Cylinders: "starts"}


# the values of a mesh's attribute
VALUES = Annotated[list[Number | Numbers2or3], Meta(min_length=1)] | File | Stored


def read(block: Struct, entries: Entries, where: str) -> Any:
    """The shape of parhelion.scene that a block of the document describes."""
    members = {f.name: getattr(block, f.name) for f in msgspec.structs.fields(block)}
    if isinstance(block, Mesh):
        _take_file(members, entries, where)
    for name, spec in _ARRAYS[type(block)].items():
        value = members[name]
        if isinstance(value, (list, str, Stored)) and not (name == "normals" and value in _NORMALS):
            members[name] = value = _array(value, spec, entries, f"{where}.{name}")
        if spec.of and isinstance(value, np.ndarray):
            _check_count(len(value), members, spec.of, f"{where}.{name}")
    if isinstance(block, Mesh):
        _finish_mesh(members, where)
    if isinstance(block, Instances):
        members["shapes"] = tuple(
            read(part, entries, f"{where}.shapes[{i}]") for i, part in enumerate(block.shapes)
        )
    else:
        members["material"] = _material(block, members, entries, f"{where}.material")
    return getattr(model, type(block).__name__)(**members)


def _check_count(given: int, members: Mapping[str, Any], of: str, where: str) -> None:
    if given != len(members[of]):
        raise SceneError(f"{where}: has {given} values for {len(members[of])} {of}")


# ---------------------------------------------------------------------------------------------
# Meshes


def _take_file(members: dict[str, Any], entries: Entries, where: str) -> None:
    """Brings in the arrays of the mesh's file, if it has one, and its attributes."""
    file, index = members.pop("file"), members.pop("file_index")
    given = [name for name in ("vertices", "faces") if members[name] is not UNSET]
    attributes: dict[str, Any] = {}
    if file is None:
        if len(given) < 2:
            raise SceneError(f"{where}: needs 'vertices' and 'faces', or a 'file'")
        if index:
            raise SceneError(f"{where}.file_index: is {index}, and there is no 'file'")
    else:
        if given:
            raise SceneError(f"{where}: has both 'file' and {given[0]!r}; give one of them")
        data = entries.folders.mesh(file, index, f"{where}.file")
        members |= {"vertices": data.vertices, "faces": data.faces}
        if members["normals"] is None and not data.face_normals:
            members["normals"] = data.normals
        if members["uvs"] is None:
            members["uvs"] = data.uvs
        attributes |= data.attributes
    for name, value in members["attributes"].items():
        place = f"{where}.attributes{member(name)}"
        numbers = convert(value, VALUES, place)
        if (
            isinstance(numbers, list)
            and len({len(x) if isinstance(x, list) else 0 for x in numbers}) > 1
        ):
            raise SceneError(f"{place}: mixes numbers, pairs and arrays of 3")
        shapes: tuple[tuple[int, ...], ...] = (*_ONE, *_TWO, *_THREE)
        if isinstance(numbers, list):
            shapes = (np.shape(numbers[0]),)
        attributes[name] = _array(numbers, _Array(shapes), entries, place)
    members["attributes"] = attributes


def _finish_mesh(members: dict[str, Any], where: str) -> None:
    """Checks the faces, and makes the normals that are asked for."""
    vertices, faces = members["vertices"], members["faces"]
    beyond = np.argwhere(faces >= len(vertices))
    if beyond.size:
        face, corner = beyond[0].tolist()
        raise SceneError(
            f"{where}.faces[{face}][{corner}]: is {faces[face, corner]}; the mesh has vertices"
            f" 0 to {len(vertices) - 1}"
        )
    if isinstance(members["normals"], str):
        smooth = members["normals"] == "smooth"
        members["normals"] = smooth_normals(vertices, faces) if smooth else None


# ---------------------------------------------------------------------------------------------
# Arrays and materials


def _array(
    value: list[Any] | str | Stored, spec: _Array, entries: Entries, where: str
) -> NDArray[Any]:
    """Numbers of the document come as float64 or int64, and their types have checked them."""
    if isinstance(value, Stored):
        return entries.folders.stored(value, spec.shapes, spec.low, spec.whole, where)
    if isinstance(value, str):
        return entries.folders.array(value, spec.shapes, spec.low, spec.whole, where)
    kind = np.int64 if spec.whole else np.float64
    shape = spec.shapes[0]
    if len(shape) == 0:
        return np.fromiter(value, kind, len(value))
    if len(shape) == 1:
        numbers = np.fromiter(chain.from_iterable(value), kind, len(value) * shape[0])
        return numbers.reshape(-1, shape[0])
    if len(set(map(len, value))) > 1:
        raise SceneError(f"{where}: mixes matrices of 3 and of 4 rows")
    return np.array(value, kind)


def _material(
    block: Struct, members: Mapping[str, Any], entries: Entries, where: str
) -> str | model.Material | NDArray[Any]:
    value, shape = members["material"], clip(members["name"])
    if isinstance(value, dict) and "at" in value:
        indices = _array(convert(value, Stored, where), _Array(_ONE, 0, whole=True), entries, where)
        most = int(indices.max())
        if most >= len(entries.names):
            raise SceneError(
                f"{where}: has index {most}; the document has {len(entries.names)} materials"
            )
        value = indices
    if isinstance(value, dict):
        return entries.material(value, where)
    if isinstance(value, (list, np.ndarray)) and type(block) in _MATERIALS_OF:
        _check_count(len(value), members, _MATERIALS_OF[type(block)], where)
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, list):
        number = {name: i for i, name in enumerate(entries.names)}
        indices = np.fromiter(map(number.get, value, repeat(-1)), np.int32, len(value))
        first = int(np.argmin(indices)) if len(value) else 0  # -1 where there is no such name
        if not len(value) or indices[first] >= 0:
            return indices
        value, where = value[first], f"{where}[{first}]"
    elif value in entries.names:
        return str(value)
    problem = unknown_choice("material", value, entries.names)
    raise SceneError(f"{where}: shape {shape!r}: {problem}")
