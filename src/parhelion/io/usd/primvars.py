"""Primvars: numbers that a prim has by vertex, face or corner, and what they are for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom

if TYPE_CHECKING:
    from .reader import Reader


@dataclass(frozen=True)
class Need:
    """A primvar that a material reads: its numbers, and what stands for them where it has none."""

    width: int
    fallback: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Primvar:
    """values (N, width), one for each of what `interpolation` says."""

    values: NDArray[np.float64]
    interpolation: str


def read(r: Reader, prim: Any, name: str, sizes: dict[str, int], width: int) -> Primvar | None:
    """The prim's own primvar or an inherited one, or None; reports those that do not fit.

    sizes: how many values each interpolation has on this prim.
    """
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    return _checked(r, prim, primvar, sizes, width)


def _checked(
    r: Reader, prim: Any, primvar: Any, sizes: dict[str, int], width: int
) -> Primvar | None:
    interpolation = str(primvar.GetInterpolation())
    what = f"primvar {primvar.GetPrimvarName()} of {prim.GetPath()}"
    indices = r.integers(primvar.GetIndicesAttr()) if primvar.IsIndexed() else None
    try:
        values = np.array(r.get(primvar.GetAttr(), ()), np.float64)
    except (TypeError, ValueError):
        r.report(f"{what}: is no numbers; ignored")
        return None
    values = values.reshape(1) if values.ndim == 0 else values
    if primvar.GetElementSize() != 1:
        r.report(f"{what}: arrays of an elementSize above 1: not supported; ignored")
        return None
    if values.ndim == 1:  # one value, or one number each
        values = values.reshape(1, -1) if not _is_array(primvar) else values[:, None]
    if values.shape[1] < width:
        values = np.repeat(values[:, :1], width, axis=1)
    values = values[:, :width]
    if indices is not None:
        bad = (indices < 0) | (indices >= len(values))
        if bad.any():
            at = int(np.argmax(bad))
            raise r.error(
                prim,
                f"{primvar.GetPrimvarName()}:indices[{at}] is {indices[at]}; there are"
                f" {len(values)} values",
            )
        values = values[indices]
    if interpolation not in sizes or len(values) != sizes[interpolation]:
        wanted = sizes.get(interpolation, 0)
        r.report(f"{what}: has {len(values)} values, not {wanted} ({interpolation}); ignored")
        return None
    good = np.isfinite(values).all(axis=1)
    if not good.all():
        at = int(np.argmin(good))
        raise r.error(prim, f"{primvar.GetPrimvarName()}[{at}] is not finite")
    return Primvar(values, interpolation)


def _is_array(primvar: Any) -> bool:
    return bool(primvar.GetTypeName().isArray)


def display_color(r: Reader, prim: Any, sizes: dict[str, int]) -> Primvar | None:
    """displayColor, within what a surface can reflect."""
    found = read(r, prim, "displayColor", sizes, 3)
    return None if found is None else Primvar(found.values.clip(0.0, 1.0), found.interpolation)
