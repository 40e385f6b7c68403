"""The walk over a stage's prims, and what all kinds of them need: transforms, values, reports."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, UsdShade

from ...errors import FormatError, SceneError
from ...scene import Framing, Instances, Light, Material, Scene, Settings, Shape, Vec3
from ...studio import axis, framing
from ...subdivision import Budget
from ..files import Reports
from .images import Images

Matrix = NDArray[np.float64]

# Purposes that pictures like ours are about
_SHOWN = ("default", "render")
# Copies of all groups in all: so many, or so many times those that the stage has, for each of
# what is copied in copies; and levels of groups in groups
_MOST_COPIES = 1 << 22
_MOST_TIMES = 16
_DEEPEST = 100
# Prims below which nothing is seen
_UNSEEN = {"Material", "Shader", "NodeGraph", "GeomSubset", "SkelAnimation", "Skeleton"}


@dataclass(eq=False)
class Group:
    """Shapes in one frame, and copies of other groups: the group and (N, 4, 4) places of it."""

    name: str
    shapes: list[Any] = field(default_factory=list)
    copies: list[tuple[Group, Matrix]] = field(default_factory=list)


class Reader:
    """One stage, at one time code, on its way to a Scene."""

    def __init__(
        self, path: Path, stage: Any, images: Images, reports: Reports, time: float
    ) -> None:
        self.path = path
        self.stage = stage
        self.time = Usd.TimeCode(time)
        self.images = images
        self.materials: dict[str, Material] = {}
        self.lights: list[Light] = []
        self.lamps: set[str] = set()  # names of shapes that are lights
        self.cameras: list[tuple[Any, Matrix]] = []
        self.scene_group = Group(path.name)
        self.looks: dict[Any, Any] = {}
        self.budget = Budget(0)
        self._reports = reports
        self._groups: dict[Any, Group] = {}
        self._making: set[str] = set()

    def scene(self) -> Scene:
        """The whole scene. Raises SceneError."""
        from . import cameras, lights, meshes

        self.budget = meshes.budget(self.stage, self.time)
        self._walk(self.scene_group, [(self.stage.GetPseudoRoot(), np.eye(4), "default")])
        shapes = [*self.scene_group.shapes, *self._instances()]
        chosen, settings = cameras.chosen(self)
        background, others = lights.split(self.lights)
        if cut := self.budget.report():
            self.report(f"subdivision surfaces: {cut}")
        self._reports.tell()
        return Scene(
            shapes=tuple(shapes),
            materials=self.materials,
            camera=chosen or self._framing(shapes),
            background=background,
            lights=tuple(others),
            settings=settings or Settings(),
            name=self.path.name,
        )

    @property
    def up(self) -> Vec3:
        """The axis that is up in the stage."""
        return axis(str(UsdGeom.GetStageUpAxis(self.stage)).lower())

    def _framing(self, shapes: list[Shape]) -> Framing:
        """Shows everything but the lights."""
        view = framing(self.up)
        names = tuple(s.name for s in shapes if s.name not in self.lamps)
        return Framing(view.direction, view.up, view.vfov, view.fill, names)

    # What is not supported, and errors

    def report(self, text: str) -> None:
        """Notes something that the stage asks for and we do not do; the same text once."""
        self._reports.add(text)

    def where(self, prim: Any) -> str:
        """The beginning of an error's text."""
        return f"{self.path}: {prim.GetPath()}"

    def error(self, prim: Any, text: str) -> FormatError:
        """What to raise for a prim that has no meaning."""
        return FormatError(f"{self.where(prim)}: {text}")

    # Values

    def get(self, attribute: Any, default: Any = None) -> Any:
        """An attribute's value at the time; `default` if it has none, or is none."""
        value = attribute.Get(self.time) if attribute else None
        return default if value is None else value

    def array(self, prim: Any, attribute: Any, width: int = 1) -> NDArray[np.float64] | None:
        """(N,) or (N, width) numbers, or None. Raises FormatError for those that are not finite."""
        value = self.get(attribute)
        if value is None:
            return None
        array = np.array(value, np.float64).reshape((-1,) if width == 1 else (-1, width))
        good = np.isfinite(array) if width == 1 else np.isfinite(array).all(axis=1)
        if not good.all():
            at = int(np.argmin(good))
            raise self.error(prim, f"{attribute.GetName()}[{at}] is not finite")
        return array

    def integers(self, attribute: Any) -> NDArray[np.int64]:
        """(N,) whole numbers; none if there is no value."""
        return np.array(self.get(attribute, ()), np.int64).reshape(-1)

    def number(self, prim: Any, attribute: Any, default: float = 0.0) -> float:
        """A finite number."""
        value = float(self.get(attribute, default))
        if not np.isfinite(value):
            raise self.error(prim, f"{attribute.GetName()} is {value}")
        return value

    @contextmanager
    def naming(self, prim: Any) -> Iterator[None]:
        """Errors of what is read within name the prim and are FormatErrors."""
        try:
            yield
        except FormatError:
            raise
        except SceneError as error:
            text = str(error)
            named = text.startswith(str(self.path))
            raise FormatError(text if named else f"{self.where(prim)}: {text}") from None
        except (TypeError, ValueError) as error:  # a file may give a radius as text
            text = f"has a value of another type than it may have: {error}"
            raise self.error(prim, text) from None

    # The walk

    def _walk(self, group: Group, start: list[tuple[Any, Matrix, str]]) -> None:
        """Adds what is at and below prims, with their parents' matrices and purposes."""
        wanted = Usd.PrimIsActive & Usd.PrimIsLoaded
        if all(prim.IsDefined() and not prim.IsAbstract() for prim, _, _ in start):
            wanted = wanted & Usd.PrimIsDefined & ~Usd.PrimIsAbstract
        shown = Usd.TraverseInstanceProxies(wanted)
        stack = start[::-1]
        while stack:
            prim, matrix, purpose = stack.pop()
            with self.naming(prim):
                stack.extend(reversed(self._visit(prim, matrix, purpose, group, shown)))

    def _visit(
        self, prim: Any, matrix: Matrix, purpose: str, group: Group, shown: Any
    ) -> list[tuple[Any, Matrix, str]]:
        """Adds what a prim is; returns its children, of those wanted, to visit next."""
        from . import materials

        kind = str(prim.GetTypeName())
        materials.report_missing(self, prim)
        if kind in _UNSEEN:
            return []
        image = UsdGeom.Imageable(prim)
        if image:
            if self.get(image.GetVisibilityAttr()) == "invisible":
                return []
            authored = image.GetPurposeAttr()
            if authored.HasAuthoredValue():
                purpose = str(authored.Get())
        matrix = self._local(prim, matrix)
        if purpose in _SHOWN and not self._shape(prim, kind, matrix, group):
            return []
        children = prim.GetFilteredChildren(shown)
        if not prim.IsInstance():
            return [(child, matrix, purpose) for child in children]
        key = self._instance_key(prim, purpose)
        if key not in self._groups:
            inner = self._groups[key] = Group(str(prim.GetPath()))
            self._below(prim, inner, [(child, np.eye(4), purpose) for child in children])
        group.copies.append((self._groups[key], matrix[None]))
        return []

    def _below(self, prim: Any, group: Group, start: list[tuple[Any, Matrix, str]]) -> None:
        path = str(prim.GetPath())
        if len(self._making) >= _DEEPEST:
            raise self.error(prim, f"lies in instances of instances, more than {_DEEPEST} deep")
        self._making.add(path)
        self._walk(group, start)
        self._making.remove(path)

    def _local(self, prim: Any, parent: Matrix) -> Matrix:
        """The matrix from a prim's own frame; USD's multiply rows from the left."""
        xform = UsdGeom.Xformable(prim)
        if not xform:
            return parent
        own = np.array(xform.GetLocalTransformation(self.time), np.float64).T
        if not np.isfinite(own).all():
            raise self.error(prim, "its transform is not finite")
        placed: Matrix = own if xform.GetResetXformStack() else parent @ own
        return placed

    def _shape(self, prim: Any, kind: str, matrix: Matrix, group: Group) -> bool:
        """Adds what a prim itself is; says whether to look at its children."""
        from . import cameras, lights, meshes, solids, strands

        if kind == "PointInstancer":
            self._point_instancer(prim, matrix, group)
            return False
        for table in (meshes.SHAPES, solids.SHAPES, strands.SHAPES, lights.LIGHTS):
            if kind in table:
                table[kind](self, prim, matrix, group)
                return True
        if kind == "Camera":
            if group is self.scene_group:
                self.cameras.append((prim, matrix))
        elif kind in cameras.UNSEEN:
            pass
        elif UsdGeom.Boundable(prim) or lights.is_light(prim):
            self.report(f"{kind} prims, such as {prim.GetPath()}: not supported; left out")
        return True

    # Instances

    def _instance_key(self, prim: Any, purpose: str) -> Any:
        """What instances that look alike share: the prototype, and what it inherits from them."""
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(
            UsdShade.Tokens.preview
        )
        inherited = tuple(
            (str(p.GetName()), str(p.Get(self.time)))
            for p in UsdGeom.PrimvarsAPI(prim).FindInheritablePrimvars()
        )
        path = prim.GetPrototype().GetPath()
        return str(path), str(material.GetPath()) if material else "", inherited, purpose

    def _point_instancer(self, prim: Any, matrix: Matrix, group: Group) -> None:
        instancer = UsdGeom.PointInstancer(prim)
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        which = self.integers(instancer.GetProtoIndicesAttr())
        bad = (which < 0) | (which >= len(targets))
        if bad.any():
            at = int(np.argmax(bad))
            raise self.error(
                prim, f"protoIndices[{at}] is {which[at]}; there are {len(targets)} prototypes"
            )
        count = len(which)
        positions = self.get(instancer.GetPositionsAttr(), ())
        for attribute in (
            instancer.GetPositionsAttr(),
            instancer.GetScalesAttr(),
            instancer.GetOrientationsAttr(),
        ):
            size = len(self.get(attribute, ()))
            if size != count and (size or attribute == instancer.GetPositionsAttr()):
                raise self.error(
                    prim, f"{attribute.GetName()} has {size} elements; protoIndices has {count}"
                )
        if not len(positions):
            return
        for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues():
            if primvar.GetInterpolation() != "constant":
                self.report(
                    f"primvars of each instance, such as {primvar.GetPrimvarName()} of"
                    f" {prim.GetPath()}: not supported; ignored"
                )
        places = instancer.ComputeInstanceTransformsAtTime(
            self.time,
            self.time,
            UsdGeom.PointInstancer.ExcludeProtoXform,
            UsdGeom.PointInstancer.IgnoreMask,
        )
        local = np.array(places, np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        mask = np.array(instancer.ComputeMaskAtTime(self.time), bool)
        shown = mask if len(mask) else np.ones(count, bool)
        if len(local) != count or len(shown) != count:  # as of attributes of other types
            raise self.error(prim, "its instances have no places; positions must be a point3f[]")
        if not np.isfinite(local).all():
            at = int(np.argmin(np.isfinite(local).all(axis=(1, 2))))
            raise self.error(prim, f"instance {at} has a transform that is not finite")
        for index, target in enumerate(targets):
            chosen = (which == index) & shown
            if chosen.any():
                group.copies.append((self._prototype(prim, target), matrix @ local[chosen]))

    def _prototype(self, instancer: Any, target: Any) -> Group:
        """What a prim of an instancer's prototypes holds, whether or not it is shown itself."""
        key = str(target)
        if key in self._making:
            raise self.error(instancer, f"is in its own prototype {key}")
        if key not in self._groups:
            prim = self.stage.GetPrimAtPath(Sdf.Path(key))
            group = Group(key)
            if prim:
                self._below(prim, group, [(prim, np.eye(4), "default")])
            else:
                self.report(f"{instancer.GetPath()}: there is no prototype {key}; left out")
            self._groups[key] = group
        return self._groups[key]

    def _instances(self) -> list[Instances]:
        """Copies of groups, one object a group; those in groups by all ways that lead there."""
        placed: dict[int, tuple[Group, list[Matrix]]] = {}
        groups = (self.scene_group, *self._groups.values())
        own = sum(len(matrices) for group in groups for _, matrices in group.copies)
        most, count = max(_MOST_COPIES, _MOST_TIMES * own), 0
        stack = [(self.scene_group, np.eye(4)[None])]
        while stack:
            group, places = stack.pop()
            for inner, matrices in group.copies:
                count += len(places) * len(matrices)
                if count > most:
                    raise FormatError(f"{self.path}: has more than {most} instances")
                both = (places[:, None] @ matrices[None]).reshape(-1, 4, 4)
                if inner.shapes:
                    placed.setdefault(id(inner), (inner, []))[1].append(both)
                stack.append((inner, both))
        return [
            instances
            for group, parts in placed.values()
            for instances in self._copies(group, np.concatenate(parts))
        ]

    def _copies(self, group: Group, places: Matrix) -> list[Instances]:
        size = np.linalg.norm(places[:, :3, :3], axis=1)
        scaled = places[:, :3, :3] / np.where(size > 0.0, size, 1.0)[:, None]
        solid = (size > 0.0).all(axis=1) & (np.abs(np.linalg.det(scaled)) > 1e-9)
        if not solid.all():
            self.report(f"instances of {group.name} that are scaled to nothing: left out")
        return [Instances(tuple(group.shapes), places[solid], group.name)] if solid.any() else []
