"""Parameters of a directive: what they say in our terms, and which of them anybody asked for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from ... import spectra
from ...errors import FormatError, SceneError, unknown_name
from ...scene import Texture
from . import colors
from .colors import Color
from .grammar import Directive, Parameter

if TYPE_CHECKING:
    from .reader import Reader

Array = NDArray[np.float64]
T = TypeVar("T")
# Textures by kind, "float" or "spectrum", and name. One that is constant is a colour.
Textures = Mapping[tuple[str, str], "Color | Texture"]


class Item:
    """A directive of some type, such as Shape "sphere", with its parameters.

    The methods named after a kind of value give that of a parameter, or what it is by default, and
    note that it was read: `finish` reports what nobody asked for. textures: those that had a name
    when the directive came.
    """

    def __init__(
        self,
        reader: Reader,
        directive: Directive,
        type: str,
        parameters: Mapping[str, Parameter],
        textures: Textures,
        space: str,
    ) -> None:
        self.reader = reader
        self.directive = directive
        self.type = type
        self.parameters = parameters
        self.textures = textures
        self.space = space
        self.read: set[str] = set()

    def __str__(self) -> str:
        return f'{self.directive.name} "{self.type}"'

    def error(self, text: str) -> FormatError:
        """The error about this directive."""
        return self.directive.error(text)

    def report(self, text: str) -> None:
        """Notes something about this type of directive that we do not do."""
        self.reader.report(f"{self}: {text}")

    def finish(self) -> None:
        """Reports parameters that nobody has asked for, and those that were given twice."""
        for name, parameter in self.parameters.items():
            if name not in self.read:
                self.report(f'parameter "{parameter.type} {name}" is not known; ignored')
        for name in self.directive.repeated:
            self.report(f"parameter {name!r} is given more than once; the last counts")

    def ignore(self, *names: str) -> None:
        """Notes parameters that change nothing in our pictures."""
        self.read.update(names)

    def has(self, name: str) -> bool:
        """Whether a parameter is given, without reading it."""
        return name in self.parameters

    # Plain values

    def _get(self, name: str, *types: str) -> Parameter | None:
        self.read.add(name)
        found = self.parameters.get(name)
        if found is not None and found.type not in types:
            wanted = " or ".join(types)
            raise self.error(f"parameter {name!r} is a {found.type}; must be a {wanted}")
        return found

    def numbers(self, name: str, *types: str) -> Array | None:
        """All numbers of a parameter, or None."""
        found = self._get(name, *types)
        return None if found is None else np.asarray(found.values, np.float64)

    def _one(self, name: str, *types: str) -> Array | None:
        values = self.numbers(name, *types)
        if values is not None and not len(values):
            raise self.error(f"parameter {name!r} has no value")
        return values

    def number(self, name: str, default: float) -> float:
        """A number."""
        values = self._one(name, "float", "integer")
        return default if values is None else float(values[0])

    def integer(self, name: str, default: int, least: int = 0) -> int:
        """A whole number, at least so large."""
        values = self._one(name, "integer", "float")
        if values is None:
            return default
        if not least <= values[0] < 2**31 or values[0] != int(values[0]):
            raise self.error(f"{name} is {values[0]:g}; must be a whole number from {least}")
        return int(values[0])

    def boolean(self, name: str, default: bool) -> bool:
        """True or false."""
        found = self._get(name, "bool")
        return default if found is None or not len(found.values) else bool(found.values[0])

    def string(self, name: str, default: str) -> str:
        """A text."""
        found = self._get(name, "string", "texture")
        return default if found is None or not len(found.values) else str(found.values[0])

    def strings(self, name: str) -> list[str]:
        """All texts of a parameter."""
        found = self._get(name, "string")
        return [] if found is None else [str(value) for value in found.values]

    def choice(self, name: str, default: str, choices: Mapping[str, T]) -> T:
        """What a text stands for, by a table."""
        found = self.string(name, default)
        if found not in choices:
            raise self.error(unknown_name(name, found, choices))
        return choices[found]

    def vector(self, name: str, default: Color) -> Array:
        """A point or a vector."""
        values = self._one(name, "point", "point3", "vector", "vector3", "normal", "normal3")
        return np.array(default) if values is None else values[:3]

    def rows(self, name: str, width: int, *types: str) -> Array | None:
        """(N, width) numbers, or None."""
        values = self.numbers(name, *types)
        if values is None:
            return None
        if len(values) % width:
            raise self.error(f"{name} has {len(values)} numbers; must be a multiple of {width}")
        return values.reshape(-1, width)

    def file(self, name: str) -> Path:
        """A file that must be there and may be read."""
        found = self.string(name, "")
        if not found:
            raise self.error(f"needs a text {name!r}, the name of a file")
        return self.file_at(found)

    def file_at(self, name: str) -> Path:
        """The file of that name."""
        return self.reader.file(name, self.directive)

    # Colours and textures

    def color(self, name: str, default: Color | float, use: str = "share") -> Color | Texture:
        """A colour or a texture. use: what a spectrum means, as in colors.of_spectrum."""
        self.read.add(name)
        found = self.parameters.get(name)
        if found is None:
            return default if isinstance(default, tuple) else (default, default, default)
        if found.type == "texture":
            return self._texture(name, str(found.values[0]) if len(found.values) else "")
        try:
            return colors.of_parameter(self, found, use)
        except SceneError as error:
            if isinstance(error, FormatError):
                raise
            raise self.error(f"parameter {name!r}: {error}") from None

    def _texture(self, name: str, texture: str) -> Color | Texture:
        for kind in ("spectrum", "float"):
            if (kind, texture) in self.textures:
                return self.textures[kind, texture]
        known = sorted({key for _, key in self.textures})
        raise self.error(f"parameter {name!r}: {unknown_name('texture', texture, known)}")

    def scalar(self, name: str, default: float) -> float | Texture:
        """A number that may vary over a surface; of a colour, the luminance."""
        found = self.color(name, default)
        return found if isinstance(found, Texture) else spectra.luminance(found)

    def plain(self, name: str, default: Color | float, use: str = "share") -> Color:
        """A colour where we take no texture: of one, what stands for it is reported."""
        found = self.color(name, default, use)
        if not isinstance(found, Texture):
            return found
        self.report(f"no texture is supported for {name!r}; its default is used")
        return default if isinstance(default, tuple) else (default, default, default)

    def refraction(self, name: str, default: float) -> tuple[float, float]:
        """An index of refraction, and its dispersion, 20 over Abbe's number."""
        found = self.parameters.get(name)
        if found is None or found.type != "spectrum":
            return spectra.luminance(self.plain(name, default, "index")), 0.0
        self.read.add(name)
        try:
            return colors.refraction(self, found)
        except SceneError as error:
            if isinstance(error, FormatError):
                raise
            raise self.error(f"parameter {name!r}: {error}") from None

    def plain_scalar(self, name: str, default: float) -> float:
        """As plain, of a number."""
        return spectra.luminance(self.plain(name, default))
