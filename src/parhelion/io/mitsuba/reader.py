"""The walk over a Mitsuba scene's objects, and what all kinds of them need: properties, reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ... import spectra
from ...errors import FormatError, SceneError, unknown_name
from ...scene import Camera, Light, Material, Scene, Settings, Shape, Texture
from .. import LoadOptions
from ..files import Folders, Reports
from .document import Document, Object, Ref, Value

Color = tuple[float, float, float]
Matrix = NDArray[np.float64]
T = TypeVar("T")

# Objects in each other, or behind each other's references; scenes need fewer than ten
_DEEPEST = 100


class Reader:
    """One scene file on its way to a Scene.

    The methods named after a type of property (`number`, `color`, ...) give that property of an
    object, or what it is by default, and note that it was read: what nobody reads is reported.
    """

    def __init__(self, path: Path, options: LoadOptions) -> None:
        self.path = path
        self.document = Document(path, options.defines, Folders(path.parent, options.allow_paths))
        self.materials: dict[str, Material] = {}
        self._made: dict[int, Any] = {}
        self._making: list[Object] = []
        self._reports = Reports(path, options.strict)
        self._unread: set[tuple[str, str, str]] = set()
        self._names: dict[str, int] = {}
        self._files: dict[tuple[Path, int], Any] = {}
        # groups of shapes that have instances, by their identity, and the instances' transforms
        self.groups: dict[int, tuple[Object, list[Matrix]]] = {}
        # the group that is being read, and the instances in groups: what they copy, and where to
        self.group: int | None = None
        self.inner: dict[int, list[tuple[Object, Matrix]]] = {}

    def scene(self) -> Scene:
        """The whole scene. Raises FormatError."""
        from . import emitters, integrators, sensors, shapes

        camera: Camera | None = None
        settings = Settings()
        shown: list[Shape] = []
        lights: list[Light] = []
        seen: set[str] = set()
        for o in self.document.objects:
            if o.kind in ("sensor", "integrator"):
                if o.kind in seen:
                    self.report(f"{o.kind} {o.id or o.type!r}: only the first {o.kind} is used")
                    continue
                seen.add(o.kind)
            if o.kind == "sensor":
                camera, settings = sensors.read(self, o, settings)
            elif o.kind == "integrator":
                settings = integrators.read(self, o, settings)
            elif o.kind == "shape":
                shown.extend(shapes.read(self, o))
            elif o.kind == "emitter":
                lights.extend(emitters.read(self, o))
        shown.extend(shapes.instances(self))
        background, lights = emitters.split(self, lights)
        for note in self.document.notes:
            self.report(note)
        self._reports.tell()
        return Scene(
            shapes=tuple(shown),
            materials=self.materials,
            camera=camera,
            background=background,
            lights=tuple(lights),
            settings=settings,
            name=self.path.name,
        )

    # What is not supported

    def report(self, text: str) -> None:
        """Notes something that the scene asks for and we do not do; the same text once."""
        self._reports.add(text)

    def unique(self, name: str) -> str:
        """The name, with a number if another shape has it."""
        count = self._names[name] = self._names.get(name, 0) + 1
        return name if count == 1 else f"{name} {count}"

    def once(self, key: tuple[Path, int], read: Callable[[], T]) -> T:
        """What `read` returns, kept: scenes use one file again and again."""
        if key not in self._files:
            self._files[key] = read()
        found: T = self._files[key]
        return found

    # Objects

    def make(
        self, o: Object, table: Mapping[str, Callable[[Reader, Object], T]], otherwise: T
    ) -> T:
        """What the table's function makes of an object, once; `otherwise` for unknown types."""
        if id(o) in self._made:
            made: T = self._made[id(o)]
            return made
        if o in self._making:
            raise o.error("refers to itself")
        if len(self._making) >= _DEEPEST:
            raise o.error(f"is in or behind more than {_DEEPEST} others, by reference")
        function = table.get(o.type)
        if function is None:
            self.report(f"{unknown_name(f'{o.kind} type', o.type, table)}; ignored")
            return otherwise
        self._making.append(o)
        try:
            made = function(self, o)
        except FormatError:
            raise
        except SceneError as error:
            raise o.error(str(error)) from None
        self._making.pop()
        self.finish(o)
        self._made[id(o)] = made
        return made

    def finish(self, o: Object) -> None:
        """Reports what nobody has asked for; called when all of an object has been read."""
        for index, (name, item) in enumerate(o.items):
            if (name or f"#{index}") in o.read:
                continue
            what = f"property {name!r}" if name else "an element"
            if isinstance(item, (Object, Ref)):
                inner = self._object(item)
                if inner.kind == "medium":
                    self.report(
                        f"medium {inner.type!r}: participating media are not rendered yet; ignored"
                    )
                    continue
                what += f" ({inner.kind} {inner.type!r})"
            key = (o.kind, o.type, what)
            if key not in self._unread:
                self._unread.add(key)
                self.report(f"{what} of {o}: not known; ignored")

    def _object(self, item: Ref | Object) -> Object:
        return self.document.resolve(item) if isinstance(item, Ref) else item

    def nested(self, o: Object, *kinds: str) -> list[Object]:
        """All objects of these kinds in an object, by whatever name."""
        found = []
        for index, (name, item) in enumerate(o.items):
            if isinstance(item, Value):
                continue
            inner = self._object(item)
            if inner.kind in kinds:
                o.read.add(name or f"#{index}")
                found.append(inner)
        return found

    def ignore(self, o: Object, *names: str) -> None:
        """Notes properties that change nothing in our pictures."""
        o.read.update(names)

    # Properties

    def get(self, o: Object, name: str) -> Value | Object | None:
        """The property of that name, references resolved."""
        o.read.add(name)
        found = [item for key, item in o.items if key == name]
        if len(found) > 1:
            raise o.error(f"property {name!r} is given {len(found)} times")
        if not found:
            return None
        return found[0] if isinstance(found[0], Value) else self._object(found[0])

    def has(self, o: Object, name: str) -> bool:
        """Whether a property is given, without reading it."""
        return any(key == name for key, _ in o.items)

    def _value(self, o: Object, name: str, tags: tuple[str, ...]) -> Any:
        item = self.get(o, name)
        if item is None:
            return None
        if isinstance(item, Object) or item.tag not in tags:
            has = item.kind if isinstance(item, Object) else item.tag
            raise o.error(f"property {name!r} is a {has}; must be a {' or '.join(tags)}")
        return item.data

    def number(self, o: Object, name: str, default: float) -> float:
        """A float, or an integer used as one."""
        found = self._value(o, name, ("float", "integer"))
        return default if found is None else float(found)

    def integer(self, o: Object, name: str, default: int) -> int:
        """A whole number."""
        found = self._value(o, name, ("integer",))
        return default if found is None else int(found)

    def boolean(self, o: Object, name: str, default: bool) -> bool:
        """True or false."""
        found = self._value(o, name, ("boolean",))
        return default if found is None else bool(found)

    def string(self, o: Object, name: str, default: str) -> str:
        """A text."""
        found = self._value(o, name, ("string",))
        return default if found is None else str(found)

    def choice(self, o: Object, name: str, default: str, choices: Mapping[str, T]) -> T:
        """What a text stands for, by a table."""
        found = self.string(o, name, default)
        if found not in choices:
            raise o.error(unknown_name(name, found, choices))
        return choices[found]

    def vector(self, o: Object, name: str, default: Color) -> Color:
        """A point or a vector."""
        found = self._value(o, name, ("point", "vector"))
        return default if found is None else (found[0], found[1], found[2])

    def matrix(self, o: Object, name: str = "to_world") -> Matrix:
        """A transform; none is the identity."""
        found = self._value(o, name, ("transform",))
        return np.eye(4) if found is None else np.asarray(found)

    def file(self, o: Object, name: str = "filename") -> Path:
        """A file that must be there and may be read."""
        item = self.get(o, name)
        if not isinstance(item, Value) or item.tag != "string":
            raise o.error(f"needs a string {name!r}")
        return self.document.file(item.data, item.place)

    def color(
        self, o: Object, name: str, default: Color | float, *, index: bool = False
    ) -> Color | Texture:
        """A colour or a texture. index: of refraction, which may be above 1."""
        item = self.get(o, name)
        if item is None:
            return default if isinstance(default, tuple) else (default, default, default)
        return self.color_of(o, name, item, index=index)

    def color_of(
        self, o: Object, name: str, item: Value | Object, *, index: bool = False
    ) -> Color | Texture:
        """The colour that a property is, or the texture."""
        if isinstance(item, Object):
            from . import textures

            return textures.read(self, item)
        data: Any = item.data
        if item.tag in ("float", "integer"):
            return float(data), float(data), float(data)
        # three values in a spectrum are RGB in version 0.x
        if item.tag in ("rgb", "srgb") or (item.tag == "spectrum" and np.size(data) == 3):
            return data[0], data[1], data[2]
        try:
            if item.tag == "spectrum" and isinstance(data, float):
                if o.in_emitter:  # even over all wavelengths, which is not white
                    return spectra.equal_energy(data)
                return data, data, data
            if item.tag == "spectrum":
                if o.in_emitter:
                    return spectra.emission(*data)
                return spectra.unbounded(*data) if index else spectra.reflectance(*data)
            if item.tag == "blackbody":
                return spectra.blackbody(data)
        except SceneError as error:
            raise o.error(f"property {name!r}: {error}") from None
        raise o.error(f"property {name!r} is a {item.tag}; must be a colour or a texture")

    def scalar(self, o: Object, name: str, default: float) -> float | Texture:
        """A number that may vary over a surface; of a colour, the luminance."""
        found = self.color(o, name, default)
        return found if isinstance(found, Texture) else spectra.luminance(found)

    def plain(self, o: Object, name: str, default: Color | float, *, index: bool = False) -> Color:
        """A colour where we take no texture: of one, what stands for it is reported."""
        found = self.color(o, name, default, index=index)
        if not isinstance(found, Texture):
            return found
        self.report(f"property {name!r} of {o}: no texture is supported there; its default is used")
        return default if isinstance(default, tuple) else (default, default, default)
