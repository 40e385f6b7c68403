"""The walk over a pbrt scene's directives: graphics state, named things, what is reported."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from ...errors import FormatError, SceneError
from ...scene import Background, Light, Scene, Solid
from .. import LoadOptions
from ..files import Folders, Included, Reports, contents
from . import transforms
from .grammar import Directive, Parameter, Source, directives
from .items import Item, Textures
from .transforms import Matrix

T = TypeVar("T")

# Files that include each other; and inclusions of a scene in all, which two lines in each of some
# files could otherwise make endless
_DEEPEST_INCLUDE = 50
_MOST_INCLUDES = 10_000

# Parameters that Attribute gives to all of a kind, each of which has them all
_MOST_ATTRIBUTES = 1000

# Directives of versions 1 and 2
_ANCIENT = ("Renderer", "SearchPath", "SurfaceIntegrator", "Volume", "VolumeIntegrator")
# Directives that choose how a picture is made, and are gathered before it is known of what
_OPTIONS = ("Camera", "Film", "Integrator", "PixelFilter", "Sampler", "SurfaceIntegrator")
# Parameters of Option that change nothing in a picture
_HARMLESS = (
    "disablewavelengthjitter", "msereferenceimage", "msereferenceout", "pixelstats",
    "rendercoordsys", "wavefront",
)  # fmt: skip
# What Attribute may give parameters to, and the directives that have them then
_ATTRIBUTES = {
    "shape": ("Shape",),
    "light": ("LightSource", "AreaLightSource"),
    "material": ("Material", "MakeNamedMaterial"),
    "medium": ("MakeNamedMedium",),
    "texture": ("Texture",),
}


@dataclass
class State:
    """What AttributeBegin keeps and AttributeEnd brings back.

    to_world: the current transformation. material: the item, or the name, of the current material.
    lamp: the current area light. inside, outside: names of the media, "" for none.
    """

    to_world: Matrix = field(default_factory=lambda: np.eye(4))
    active: bool = True
    reverse: bool = False
    material: Item | str | None = None
    lamp: Item | None = None
    inside: str = ""
    outside: str = ""
    attributes: Mapping[str, Mapping[str, Parameter]] = field(default_factory=dict)
    space: str = "srgb"


@dataclass
class Group:
    """A named object: its shapes, and where instances of it stand.

    uneven: shapes that only an instance can hold, such as an ellipsoid, each with its matrix.
    """

    shapes: list[Solid] = field(default_factory=list)
    uneven: list[tuple[Solid, Matrix]] = field(default_factory=list)
    transforms: list[Matrix] = field(default_factory=list)


class Reader:
    """One scene file on its way to a Scene."""

    def __init__(self, path: Path, options: LoadOptions) -> None:
        from .shapes import Shapes

        self.path = path
        self.folders = Folders(path.parent, options.allow_paths)
        self.reports = Reports(path, options.strict)
        # Version 3 or before: its film is called "image". See colors.py for what that changes.
        self.old = False
        # Version 1 or 2
        self.ancient = False
        # What all light is multiplied by: the film's exposure
        self.exposure = 1.0
        self.state = State()
        self.options: dict[str, tuple[Item, Matrix]] = {}
        self.textures: Textures = {}
        self.named_materials: dict[str, Item] = {}
        self.media: dict[str, Item] = {}
        self.lights: list[Light] = []
        self.shapes = Shapes(self)
        self._search: list[Path] = []
        self._spaces: dict[str, Matrix] = {}
        self._saved: list[tuple[str, State, Directive]] = []
        self._in_world = False
        self._groups: dict[str, Group] = {}
        self._group: tuple[str, Group] | None = None
        self._placed: list[tuple[Directive, Matrix]] = []
        self._including: list[Path] = []
        self._included = 0
        self._included_text = Included()
        self._texts: set[str] = set()
        self._files: dict[Path, object] = {}

    def scene(self) -> Scene:
        """The whole scene. Raises FormatError."""
        from . import cameras

        self._read(self.path)
        if self._saved:
            name, _, directive = self._saved[-1]
            raise FormatError(
                f"{directive.place}: {directive} has no {name.replace('Begin', 'End')}"
            )
        if not self._in_world:
            raise FormatError(f"{self.path}: has no WorldBegin")
        camera, settings = cameras.read(self)
        shown = self.shapes.finish(self._instances())
        around = [light for light in self.lights if isinstance(light, Background)]
        self.reports.tell()
        return Scene(
            shapes=tuple(shown),
            materials=self.shapes.named,
            camera=camera,
            background=around[0] if around else None,
            lights=tuple(light for light in self.lights if not around or light is not around[0]),
            settings=settings,
            name=self.path.name,
        )

    def report(self, text: str) -> None:
        """Notes something that the scene asks for and we do not do; the same text once."""
        self.reports.add(text)

    # Files

    def file(self, name: str, directive: Directive) -> Path:
        """A file that must be there and may be read, by its path from the scene's folder.

        pbrt looks beside the scene file only; a file that is not there is looked for beside the
        one that names it, and in the folders of SearchPath.
        """
        where = f"{directive.place}: {directive}"
        folders = [self.folders.own, directive.place.source.path.parent, *self._search]
        failed: SceneError | None = None
        for folder in dict.fromkeys(folders):
            try:
                return self.folders.file(name, where, folder)
            except SceneError as error:
                failed = failed or error
        raise FormatError(str(failed)) from None

    def once(self, path: Path, read: Callable[[], T]) -> T:
        """What `read` returns, kept: scenes use one file again and again."""
        if path not in self._files:
            self._files[path] = read()
        found: T = self._files[path]  # type: ignore[assignment]
        return found

    def _read(self, path: Path) -> None:
        """All directives of a file, and of those that it includes."""
        self._including.append(path.resolve())
        self._texts.add(str(path))
        data = contents(path)
        count = 0
        for directive in directives(Source(path, data)):
            count += 1
            try:
                self._obey(directive)
            except (SceneError, ValueError) as error:
                # of a mesh or a picture, which does not say who asked for it
                if str(error).partition(": line ")[0] not in self._texts:
                    raise directive.error(str(error)) from None
                raise
        self._including.pop()
        self._included_text.add(path, len(data), count)

    # Directives

    def _obey(self, d: Directive) -> None:
        if d.numbers is not None and d.name != "TransformTimes":
            self._transform(d)
        elif d.name in _OPTIONS:
            self._option(d)
        elif d.name in _ANCIENT:
            self._old_directive(d)
        else:
            method = getattr(self, f"_{d.name}", None)
            if method is not None:
                method(d)
            # what is left says how pbrt works, such as Accelerator

    def _transform(self, d: Directive) -> None:
        if not self.state.active:
            self.report("ActiveTransform EndTime: motion is not rendered; the start counts")
            return
        assert d.numbers is not None
        if d.name == "Identity":
            self.state.to_world = np.eye(4)
            return
        matrix = transforms.step(d.name, d.numbers)
        self.state.to_world = matrix if d.name == "Transform" else self.state.to_world @ matrix

    def item(self, d: Directive, type: str | None = None) -> Item:
        """The directive's parameters, with those that Attribute gives to all of its kind."""
        parameters: Mapping[str, Parameter] = d.parameters
        for target, names in _ATTRIBUTES.items():
            if d.name in names and target in self.state.attributes:
                parameters = {**self.state.attributes[target], **d.parameters}
        return Item(
            self,
            d,
            d.texts[0] if type is None else type,
            parameters,
            self.textures,
            self.state.space,
        )

    def _option(self, d: Directive) -> None:
        if self._in_world:
            raise d.error("belongs before WorldBegin")
        name = d.name.removeprefix("Surface")
        if d.name == "SurfaceIntegrator":
            self.old = self.ancient = True
        self.options[name] = (self.item(d), self.state.to_world)
        if d.name == "Film":
            self.old = self.old or d.texts[0] == "image"
        elif d.name == "Camera":
            if not transforms.invertible(self.state.to_world):
                raise d.error("the transformation has no inverse")
            if self.state.outside:
                self.report(f"medium {self.state.outside!r} around the camera: ignored")
            self._spaces["camera"] = np.asarray(np.linalg.inv(self.state.to_world))

    def _old_directive(self, d: Directive) -> None:
        self.old = self.ancient = True
        if d.name == "SearchPath":
            self._search += [self.folders.own / part for part in d.texts[0].split(":") if part]
        elif d.name == "Volume":
            self.report("Volume: participating media are not rendered yet; ignored")

    def _Option(self, d: Directive) -> None:
        for name in d.parameters:
            if name not in _HARMLESS:
                self.report(f"Option {name!r}: not supported; ignored")

    def _ColorSpace(self, d: Directive) -> None:
        self.state.space = d.texts[0].lower()

    def _Attribute(self, d: Directive) -> None:
        target = d.texts[0]
        if target not in _ATTRIBUTES:
            raise d.error(f"must be one of {', '.join(_ATTRIBUTES)}")
        merged = {**self.state.attributes.get(target, {}), **d.parameters}
        if len(merged) > _MOST_ATTRIBUTES:
            raise d.error(f"more than {_MOST_ATTRIBUTES} parameters for each {target}")
        self.state.attributes = {**self.state.attributes, target: merged}

    def _ActiveTransform(self, d: Directive) -> None:
        choices = {"StartTime": True, "EndTime": False, "All": True}
        if d.texts[0] not in choices:
            raise d.error(f"must be one of {', '.join(choices)}")
        self.state.active = choices[d.texts[0]]

    def _CoordinateSystem(self, d: Directive) -> None:
        self._spaces[d.texts[0]] = self.state.to_world

    def _CoordSysTransform(self, d: Directive) -> None:
        if d.texts[0] not in self._spaces:
            self.report(f"{d}: no coordinate system has that name; ignored")
            return
        self.state.to_world = self._spaces[d.texts[0]]

    def _WorldBegin(self, d: Directive) -> None:
        from . import cameras

        if self._in_world:
            raise d.error("comes a second time")
        self._in_world = True
        self.exposure = cameras.exposure(self)
        self.state.to_world = np.eye(4)
        self.state.active = True
        self._spaces["world"] = np.eye(4)

    def _AttributeBegin(self, d: Directive) -> None:
        self._saved.append((d.name, copy.copy(self.state), d))

    _TransformBegin = _AttributeBegin

    def _AttributeEnd(self, d: Directive) -> None:
        begin = d.name.replace("End", "Begin")
        if not self._saved or self._saved[-1][0] != begin:
            open_one = f"; {self._saved[-1][2]} is open" if self._saved else ""
            raise d.error(f"no {begin} comes before it{open_one}")
        _, state, _ = self._saved.pop()
        if d.name == "TransformEnd":
            self.state.to_world, self.state.active = state.to_world, state.active
        else:
            self.state = state

    _TransformEnd = _AttributeEnd

    def _ReverseOrientation(self, _: Directive) -> None:
        self.state.reverse = not self.state.reverse

    def _Include(self, d: Directive) -> None:
        path = self.file(d.texts[0], d)
        self._included += 1
        if path in self._including:
            raise d.error("includes itself")
        if len(self._including) >= _DEEPEST_INCLUDE or self._included > _MOST_INCLUDES:
            raise d.error(
                f"more than {_DEEPEST_INCLUDE} files in each other, or {_MOST_INCLUDES} in all"
            )
        self._included_text.check("ObjectInstance shows one object many times")
        depth, state = len(self._saved), copy.copy(self.state)
        self._read(path)
        if d.name == "Import":
            if len(self._saved) != depth:
                raise d.error("the file begins or ends more attributes than it ends")
            self.state = state

    _Import = _Include

    # The world

    def _need_world(self, d: Directive) -> None:
        if not self._in_world:
            raise d.error("belongs after WorldBegin")

    def _Texture(self, d: Directive) -> None:
        from . import textures

        name, kind, type = d.texts
        kind = {"color": "spectrum"}.get(kind, kind)
        if kind not in ("float", "spectrum"):
            raise d.error(f"{kind!r} is no kind of texture; must be float or spectrum")
        made = textures.read(self.item(d, type), kind, self.state.to_world)
        if (kind, name) in self.textures:  # materials before this one keep the one before
            self.textures = dict(self.textures)
        self.textures[kind, name] = made  # type: ignore[index]

    def _Material(self, d: Directive) -> None:
        self.state.material = self.item(d)

    def _MakeNamedMaterial(self, d: Directive) -> None:
        item = self.item(d)
        item.type = item.string("type", "")
        if not item.type:
            raise d.error("needs a text 'type'")
        self.named_materials[d.texts[0]] = item

    def _NamedMaterial(self, d: Directive) -> None:
        self.state.material = d.texts[0]

    def _MakeNamedMedium(self, d: Directive) -> None:
        self.media[d.texts[0]] = self.item(d)

    def _MediumInterface(self, d: Directive) -> None:
        self.state.inside, self.state.outside = d.texts

    def _AreaLightSource(self, d: Directive) -> None:
        self._need_world(d)
        self.state.lamp = self.item(d)

    def _LightSource(self, d: Directive) -> None:
        from . import lights

        self._need_world(d)
        self.lights += lights.read(self.item(d), self.state.to_world)

    def _Shape(self, d: Directive) -> None:
        self._need_world(d)
        self.shapes.add(self.item(d), self.state, None if self._group is None else self._group[1])

    def _ObjectBegin(self, d: Directive) -> None:
        self._need_world(d)
        if self._group is not None:
            raise d.error(f"object {self._group[0]!r} is open")
        self._AttributeBegin(d)
        self.shapes.flush(None)
        self._group = (d.texts[0], Group())

    def _ObjectEnd(self, d: Directive) -> None:
        if self._group is None:
            raise d.error("no ObjectBegin comes before it")
        name, group = self._group
        self.shapes.flush(group)
        self._groups[name] = group
        self._group = None
        self._AttributeEnd(d)

    def _ObjectInstance(self, d: Directive) -> None:
        self._need_world(d)
        if self._group is not None:
            raise d.error(f"object {self._group[0]!r} is open; objects hold no instances")
        if not transforms.invertible(self.state.to_world):
            raise d.error("the transformation has no inverse")
        self._placed.append((d, self.state.to_world))

    def _instances(self) -> dict[str, Group]:
        """Groups with the places of their instances, which may come before their objects."""
        for directive, matrix in self._placed:
            name = directive.texts[0]
            if name not in self._groups:
                raise directive.error("no object has that name")
            self._groups[name].transforms.append(matrix)
        return self._groups

    def material(self, name: str, directive: Directive) -> Item:
        """The named material's item."""
        from ...errors import unknown_name

        if name not in self.named_materials:
            raise directive.error(unknown_name("material", name, self.named_materials))
        return self.named_materials[name]
