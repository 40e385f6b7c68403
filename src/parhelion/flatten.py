"""From a Scene to what the core takes: contiguous arrays and fixed-size parameter blocks.

Big arrays pass through uncopied where their type and layout already fit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import tables
from .errors import SceneError, unknown_name
from .scene import Background, Material, Scene, Spheres

# (index of the entry in its table, its parameters one after the other)
Block = tuple[int, list[float]]


@dataclass(frozen=True)
class Flat:
    """groups: (name, centers, radii, material, materials or None, colors or None) a shape, as
    _core.Scene takes them. materials, background: parameter blocks.
    """

    groups: list[tuple[Any, ...]]
    materials: list[Block]
    background: Block

    def sha256(self) -> str:
        """Hash of everything that is seen: geometry, materials and background, not the camera."""
        h = hashlib.sha256(b"parhelion scene 1")
        for name, *parts in self.groups:
            h.update(repr(name).encode())
            for part in parts:
                if isinstance(part, np.ndarray):
                    h.update(f"{part.dtype} {part.shape}".encode())
                    h.update(np.ascontiguousarray(part).data)
                else:
                    h.update(repr(part).encode())
        h.update(repr((self.materials, self.background)).encode())
        return h.hexdigest()


def flatten(scene: Scene) -> Flat:
    """Raises SceneError for arrays that do not fit together and for unknown names."""
    if not isinstance(scene, Scene):
        raise SceneError(f"a Scene is needed, not {type(scene).__name__}")
    if not isinstance(scene.materials, Mapping):
        raise SceneError(f"materials: a dict is needed, not {type(scene.materials).__name__}")
    if not isinstance(scene.shapes, Sequence):
        raise SceneError(f"shapes: a list is needed, not {type(scene.shapes).__name__}")
    for name, named in scene.materials.items():
        if not isinstance(named, Material):
            raise SceneError(f"material {name!r}: a Material is needed, not {named!r}")
    if not isinstance(scene.background, Background):
        raise SceneError(f"background: a Background is needed, not {scene.background!r}")
    names = {name: i for i, name in enumerate(scene.materials)}
    materials = [
        block("materials", m.type, m.params, f"material {name!r}")
        for name, m in scene.materials.items()
    ]
    groups = []
    for shape in scene.shapes:
        if not isinstance(shape, Spheres):
            raise SceneError(f"shapes: Spheres are needed, not {type(shape).__name__}")
        groups.append(_group(shape, names, materials))
    background = block("backgrounds", scene.background.type, scene.background.params, "background")
    return Flat(groups, materials, background)


def block(kind: str, name: str, params: Mapping[str, Any], where: str) -> Block:
    """The parameter block of a material or background, checked against its table."""
    values = tables.check(kind, name, params, where)
    floats = [x for value in values.values() for x in value]
    if kind == "backgrounds" and name == "gradient" and not any(values["up"]):
        raise SceneError(f"{where}: parameter 'up' is 0; it must have a direction")
    return list(tables.tables()[kind]).index(name), floats


def _group(shape: Spheres, names: dict[str, int], materials: list[Block]) -> tuple[Any, ...]:
    where = f"shape {shape.name!r}"
    centers = _floats(shape.centers, f"{where}: centers")
    if centers.size == 0:
        centers = centers.reshape(0, 3)
    if centers.ndim != 2 or centers.shape[1] != 3:
        raise SceneError(f"{where}: centers has shape {centers.shape}; must be (N, 3)")
    count = len(centers)
    radii = _floats(shape.radii, f"{where}: radii")
    if radii.ndim != 0 and radii.shape != (count,):
        raise SceneError(
            f"{where}: radii has shape {radii.shape}; must be ({count},), one for each center, or"
            " a single number"
        )
    colors = None
    if shape.colors is not None:
        colors = _floats(shape.colors, f"{where}: colors")
        with np.errstate(over="ignore"):  # the core names the one that became infinite
            colors = colors.astype(np.float32, copy=False)
        if colors.size == 0:
            colors = colors.reshape(0, 3)
        if colors.shape != (count, 3):
            raise SceneError(f"{where}: colors has shape {colors.shape}; must be ({count}, 3)")

    index, material_of = 0, None
    if isinstance(shape.material, Material):
        made = block("materials", shape.material.type, shape.material.params, where)
        if made not in materials:
            materials.append(made)
        index = materials.index(made)
    elif isinstance(shape.material, str):
        if shape.material not in names:
            raise SceneError(f"{where}: {unknown_name('material', shape.material, names)}")
        index = names[shape.material]
    else:
        material_of = _indices(shape.material, count, names, where)
    name = str(shape.name).encode(errors="backslashreplace").decode()  # of any file's name
    return name, centers, radii, index, material_of, colors


def _floats(values: Any, what: str) -> Any:
    """A C-contiguous array of float32 or float64."""
    if np.ma.is_masked(values):
        raise SceneError(
            f"{what} has masked elements; choose what they should be, or leave them out"
        )
    try:
        array = np.asarray(values)
        if array.dtype not in (np.float32, np.float64):
            if array.dtype.kind not in "iuf" and array.size:
                raise ValueError(f"its elements are {array.dtype}, not numbers")
            array = array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{what} is not an array of numbers: {error}") from error
    # not np.ascontiguousarray, which makes a single number an array of one
    return np.asarray(array, order="C")


def _indices(values: Any, count: int, names: dict[str, int], where: str) -> Any:
    """Indices of materials from indices or from names, one a primitive."""
    array = np.asarray(values)
    known = len(names)
    if array.dtype.kind == "U" and array.ndim == 1:
        used, first, inverse = np.unique(array, return_index=True, return_inverse=True)
        for name, i in zip(used.tolist(), first.tolist(), strict=True):
            if name not in names:
                raise SceneError(f"{where}: material[{i}]: {unknown_name('material', name, names)}")
        array = np.array([names[name] for name in used.tolist()], np.uint32)[inverse]
    if array.dtype.kind not in "iu" and array.size:
        raise SceneError(
            f"{where}: material must be a name, a Material, or (N,) whole numbers or names,"
            f" not {array.dtype}"
        )
    if array.shape != (count,):
        raise SceneError(f"{where}: material has shape {array.shape}; must be ({count},)")
    bad = np.flatnonzero((array < 0) | (array >= known))
    if bad.size:
        raise SceneError(
            f"{where}: material[{bad[0]}] is {array[bad[0]]}; the scene has {known} named materials"
        )
    return np.ascontiguousarray(array, dtype=np.uint32)
