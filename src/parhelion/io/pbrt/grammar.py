"""The text of a pbrt scene as directives: a name, its arguments, and parameters with types.

Nothing here knows what a directive means, only how its arguments look. Numbers in brackets, which
may be millions, are parsed at once.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError, unknown_name
from ..meshes.numbers import parse

# Arguments before the parameters: so many numbers, or texts; whether parameters follow
_NUMBERS = {
    "Identity": 0,
    "Translate": 3,
    "Scale": 3,
    "Rotate": 4,
    "LookAt": 9,
    "Transform": 16,
    "ConcatTransform": 16,
    "TransformTimes": 2,
}
_TEXTS = {
    "ActiveTransform": -1,  # a bare word
    "AttributeBegin": 0,
    "AttributeEnd": 0,
    "ColorSpace": 1,
    "CoordSysTransform": 1,
    "CoordinateSystem": 1,
    "Import": 1,
    "Include": 1,
    "MediumInterface": 2,
    "NamedMaterial": 1,
    "ObjectBegin": 1,
    "ObjectEnd": 0,
    "ObjectInstance": 1,
    "ReverseOrientation": 0,
    "SearchPath": 1,
    "TransformBegin": 0,
    "TransformEnd": 0,
    "WorldBegin": 0,
    "WorldEnd": 0,
}
_WITH_PARAMETERS = {
    "Accelerator": 1,
    "AreaLightSource": 1,
    "Attribute": 1,
    "Camera": 1,
    "Film": 1,
    "Integrator": 1,
    "LightSource": 1,
    "MakeNamedMaterial": 1,
    "MakeNamedMedium": 1,
    "Material": 1,
    "Option": 0,
    "PixelFilter": 1,
    "Renderer": 1,
    "Sampler": 1,
    "Shape": 1,
    "SurfaceIntegrator": 1,
    "Texture": 3,
    "Volume": 1,
    "VolumeIntegrator": 1,
}
_DIRECTIVES = {*_NUMBERS, *_TEXTS, *_WITH_PARAMETERS}

# Parameter types, with the numbers that one value has; None for texts and truths
TYPES: dict[str, int | None] = {
    "float": 1, "integer": 1, "point": 3, "point2": 2, "point3": 3, "vector": 3, "vector2": 2,
    "vector3": 3, "normal": 3, "normal3": 3, "rgb": 3, "color": 3, "xyz": 3, "blackbody": 1,
    "bool": None, "string": None, "texture": None, "spectrum": None,
}  # fmt: skip

_SPACE = re.compile(rb"(?:\s+|#[^\n]*)+")
_COMMENT = re.compile(rb"#[^\n]*")
_WORD = re.compile(rb'[^\s"\[\]#]+')
_STRING = re.compile(rb'"([^"\n]*)"')
# Numbers in brackets without strings and comments between them
_PLAIN = re.compile(rb'\[([^\]\["#]*)\]')
_DECLARATION = re.compile(r"\s*(\S+)\s+(.*\S)\s*")
# Numbers without brackets, as many as there are
_ROW = re.compile(rb"[-+.\deE\s]+")
# Up to so many bytes, Python's own float() is faster than NumPy's parser
_SHORT = 400

Values = NDArray[np.float64] | list[str] | list[bool]


@dataclass(eq=False)
class Source:
    """A file and its text."""

    path: Path
    data: bytes


@dataclass(frozen=True)
class Place:
    """Where something begins, for error texts."""

    source: Source
    at: int

    def __str__(self) -> str:
        line = self.source.data.count(b"\n", 0, self.at) + 1
        return f"{self.source.path}: line {line}"


@dataclass(frozen=True, eq=False)
class Parameter:
    """A declared parameter: "float radius" [1] has type "float" and one value.

    A spectrum is texts, the names of spectra or of their files, or wavelengths and values.
    """

    type: str
    values: Values


@dataclass(frozen=True, eq=False)
class Directive:
    """name: such as "Shape". numbers, texts: its arguments. parameters: by name.

    repeated: names of parameters given more than once; the last one counts.
    """

    name: str
    place: Place
    numbers: NDArray[np.float64] | None = None
    texts: tuple[str, ...] = ()
    parameters: dict[str, Parameter] = field(default_factory=dict)
    repeated: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " ".join((self.name, *(f'"{text}"' for text in self.texts)))

    def error(self, text: str) -> FormatError:
        """The error about this directive."""
        return FormatError(f"{self.place}: {self}: {text}")


def directives(source: Source) -> Iterator[Directive]:
    """All of a file. Raises FormatError, naming file and line, for text that is none."""
    return _Scanner(source).all()


class _Scanner:
    """A place in a file that moves forward."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.data = source.data
        self.at = 3 if source.data.startswith(b"\xef\xbb\xbf") else 0

    def fail(self, text: str, at: int | None = None) -> FormatError:
        return FormatError(f"{Place(self.source, self.at if at is None else at)}: {text}")

    def skip(self) -> bool:
        """Moves past white space and comments; whether anything is left."""
        found = _SPACE.match(self.data, self.at)
        if found:
            self.at = found.end()
        return self.at < len(self.data)

    def all(self) -> Iterator[Directive]:
        while self.skip():
            place = Place(self.source, self.at)
            found = _WORD.match(self.data, self.at)
            if not found:
                raise self.fail(f"a directive is needed, not {_shown(self.data[self.at :])}")
            name = found[0].decode("utf-8", "replace")
            if name not in _DIRECTIVES:
                raise self.fail(unknown_name("directive", name, _DIRECTIVES))
            self.at = found.end()
            if name in _NUMBERS:
                yield Directive(name, place, numbers=self.row(name, _NUMBERS[name]))
            elif name in _TEXTS:
                yield Directive(name, place, texts=self.texts(name, _TEXTS[name]))
            else:
                texts = self.texts(name, _WITH_PARAMETERS[name])
                parameters, repeated = self.parameters(name)
                yield Directive(name, place, texts=texts, parameters=parameters, repeated=repeated)

    # Arguments

    def row(self, name: str, count: int) -> NDArray[np.float64]:
        """So many numbers, in brackets or not."""
        if not count:
            return np.empty(0)
        begin = self.at
        self.skip()
        plain = _PLAIN.match(self.data, self.at)
        found = plain or _ROW.match(self.data, self.at)
        words = (plain[1] if plain else found[0] if found else b"").split()
        if not found or len(words) != count:  # comments between them, or what is wrong
            words = self.words(count)
        else:
            self.at = found.end()
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            values = np.array([np.nan])
        if len(values) != count or not np.isfinite(values).all():
            raise self.fail(f"{name} needs {count} finite numbers", begin)
        return values

    def words(self, count: int) -> list[bytes]:
        """Up to so many words, and the brackets around them."""
        bracket = self.skip() and self.data[self.at : self.at + 1] == b"["
        self.at += bracket
        words: list[bytes] = []
        while self.skip() and len(words) < count:
            found = _WORD.match(self.data, self.at)
            if not found:
                break
            words.append(found[0])
            self.at = found.end()
        if bracket:
            if self.data[self.at : self.at + 1] != b"]":
                raise self.fail("a ']' is missing")
            self.at += 1
        return words

    def texts(self, name: str, count: int) -> tuple[str, ...]:
        """So many texts in quotes; MediumInterface may have only one of its two."""
        texts: list[str] = []
        for index in range(abs(count)):
            if self.skip() and self.data[self.at : self.at + 1] == b'"':
                texts.append(self.string())
                continue
            found = _WORD.match(self.data, self.at) if count < 0 else None
            if found:
                texts.append(found[0].decode("utf-8", "replace"))
                self.at = found.end()
            elif name == "MediumInterface" and index == 1:
                texts.append(texts[0])
            else:
                raise self.fail(f"{name} needs {abs(count)} texts in quotes; it has {index}")
        return tuple(texts)

    def string(self) -> str:
        found = _STRING.match(self.data, self.at)
        if not found:
            raise self.fail("a text in quotes does not end on its line")
        self.at = found.end()
        return found[1].decode("utf-8", "replace")

    # Parameters

    def parameters(self, name: str) -> tuple[dict[str, Parameter], tuple[str, ...]]:
        """Those that follow, by name, and the names that come again."""
        found: dict[str, Parameter] = {}
        repeated: list[str] = []
        while self.skip() and self.data[self.at : self.at + 1] == b'"':
            begin = self.at
            declaration = self.string()
            match = _DECLARATION.fullmatch(declaration)
            if not match or match[1] not in TYPES:
                wanted = unknown_name("parameter type", declaration.split(" ")[0], TYPES)
                raise self.fail(f"{name}: parameter {declaration[:60]!r}: {wanted}", begin)
            kind, key = match[1], match[2]
            try:
                values = self.values(kind)
            except ValueError as error:
                raise self.fail(f"{name}: parameter {declaration!r} {error}", begin) from None
            if key in found:
                repeated.append(key)
            found[key] = Parameter(kind, values)
        return found, tuple(repeated)

    def values(self, kind: str) -> Values:
        """The values of a parameter of this type. Raises ValueError."""
        if not self.skip():
            raise ValueError("has no value")
        if kind not in ("bool", "string", "texture") and self.data[self.at : self.at + 1] == b"[":
            end = self.data.find(b"]", self.at)
            if end < 0:
                raise ValueError("has no ']' at its end")
            text = self.data[self.at + 1 : end]
            if b"#" in text:
                ends_in_one = b"#" in text.rpartition(b"\n")[2]
                text = b'"' if ends_in_one else _COMMENT.sub(b" ", text)
            if b'"' not in text:  # else item by item: texts and comments may hold anything
                self.at = end + 1
                return _numbers(text, kind)
        items = self.items()
        texts = [item[1:] for item in items if item[:1] == b'"']
        words = [item for item in items if item[:1] != b'"']
        if kind == "bool":
            truths = {b"true": True, b"false": False}
            wrong = [item for item in items if item.lstrip(b'"') not in truths]
            if wrong:
                raise ValueError("must be true or false")
            return [truths[item.lstrip(b'"')] for item in items]
        if kind in ("string", "texture") or (kind == "spectrum" and texts):
            if words:
                raise ValueError("needs texts in quotes")
            return [text.decode("utf-8", "replace") for text in texts]
        if texts:
            raise ValueError("needs numbers, not a text")
        return _numbers(b" ".join(words), kind)

    def items(self) -> list[bytes]:
        """One value, or all in brackets; texts keep the quote before them."""
        if self.data[self.at : self.at + 1] != b"[":
            return [self.item()]
        self.at += 1
        items: list[bytes] = []
        while self.skip() and self.data[self.at : self.at + 1] != b"]":
            items.append(self.item())
        if self.at >= len(self.data):
            raise ValueError("has no ']' at its end")
        self.at += 1
        return items

    def item(self) -> bytes:
        if self.data[self.at : self.at + 1] == b'"':
            return b'"' + self.string().encode()
        found = _WORD.match(self.data, self.at)
        if not found:
            raise ValueError(f"has {_shown(self.data[self.at :])} in the place of a value")
        self.at = found.end()
        return found[0]


def _numbers(text: bytes, kind: str) -> NDArray[np.float64]:
    if len(text) > _SHORT:
        values = parse(text)
    else:
        try:
            values = np.array([float(word) for word in text.split()], np.float64)
        except ValueError:
            raise ValueError("holds something that is no number") from None
    if not np.isfinite(values).all():
        bad = int(np.argmin(np.isfinite(values)))
        raise ValueError(f"holds {values[bad]} as its number {bad}; all must be finite")
    size = TYPES[kind] or 2  # a spectrum's wavelengths and values
    if len(values) % size:
        raise ValueError(f"has {len(values)} numbers; must be a multiple of {size}")
    if kind == "integer" and (values != np.trunc(values)).any():
        raise ValueError("must hold whole numbers")
    return values


def _shown(data: bytes) -> str:
    return repr(data[:20].split(b"\n")[0].decode("utf-8", "replace"))
