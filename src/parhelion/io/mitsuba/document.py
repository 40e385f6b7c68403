"""Mitsuba's XML as objects with properties: parameters, includes and references resolved.

An element such as <bsdf type="diffuse" id="red"> is an Object; one such as <float name="alpha"
value="0.1"/> a Value of the object around it. What they mean is not known here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.parsers import expat

from ...errors import FormatError, SceneError, unknown_name
from ...spectra import decode_srgb
from ..files import Folders, Included
from . import transforms

# Elements that are objects of a type, and names that older versions called them by
KINDS = (
    "integrator", "sensor", "film", "sampler", "rfilter", "shape", "bsdf", "texture", "emitter",
    "medium", "phase", "volume", "spectrum", "subsurface",
)  # fmt: skip
_OLD_KINDS = {"camera": "sensor", "luminaire": "emitter", "light": "emitter"}
_CONTROL = ("default", "path", "include", "alias", "ref")

# Elements in elements; scenes need fewer than ten
_DEEPEST = 100
# Includes in includes
_DEEPEST_INCLUDE = 20
_MOST_INCLUDES = 1000
# Bytes of a scene file: text, of which the large parts lie in other files
_LARGEST = 1 << 28
# Characters of a value with its parameters put in: each may hold the one before many times over
_LONGEST = 1 << 16

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class Place:
    """A line of a file, for error texts."""

    file: Path
    line: int

    def __str__(self) -> str:
        return f"{self.file}: line {self.line}"


@dataclass
class _Node:
    """An XML element as it stands in its file."""

    tag: str
    attributes: dict[str, str]
    place: Place
    children: list[_Node] = field(default_factory=list)


@dataclass(frozen=True)
class Value:
    """A property that is no object. tag: of its element, such as "float".

    data: a float, int, bool or str; for point, vector and rgb three floats; for transform a (4, 4)
    matrix; for spectrum a float, or two lists: wavelengths and values.
    """

    tag: str
    data: Any
    place: Place


@dataclass(frozen=True)
class Ref:
    """The id of an object that is defined elsewhere."""

    id: str
    place: Place


@dataclass(eq=False)
class Object:
    """An element with a type. items: its properties in order, each with its name, "" for none.

    in_emitter: it is an emitter or stands in one, where a spectrum means light, not a share of it.
    read: names that somebody asked for; the others are unknown to us.
    """

    kind: str
    type: str
    id: str
    place: Place
    in_emitter: bool = False
    items: list[tuple[str, Value | Ref | Object]] = field(default_factory=list)
    read: set[str] = field(default_factory=set)

    def __str__(self) -> str:
        return f"{self.kind} {self.id!r} ({self.type})" if self.id else f"{self.kind} ({self.type})"

    def error(self, text: str) -> FormatError:
        """The error about this object."""
        return FormatError(f"{self.place}: {self}: {text}")


class Document:
    """A scene file and all that it includes.

    objects: those directly in the scene, in order. by_id: all that have an id. old: the file is of
    version 0.x. notes: where Mitsuba does something else. Raises FormatError, naming file and line.
    """

    def __init__(self, path: Path, defines: Mapping[str, str], allowed: Folders) -> None:
        self.path = path
        self.allowed = allowed
        self.folders = [allowed.own]
        self.objects: list[Object] = []
        self.by_id: dict[str, Object] = {}
        self.old = False
        self.notes: list[str] = []
        self._aliases: dict[str, Ref] = {}
        self._params = dict(defines)
        self._used: set[str] = set()
        self._including: list[Path] = []
        self._included = 0
        self._included_text = Included()
        root = self._parse(path)
        if root.tag != "scene":
            raise FormatError(
                f"{root.place}: begins with <{root.tag}>; a Mitsuba scene with <scene>"
            )
        self._version(root)
        self._collect(root, None)
        for name in defines:
            if name not in self._used:
                known = sorted(self._used | set(self._params) - set(defines))
                raise FormatError(f"{path}: {unknown_name('parameter of the scene', name, known)}")

    def resolve(self, item: Ref) -> Object:
        """The object that a reference means. Raises FormatError."""
        seen: set[str] = set()
        at = item
        while at.id not in self.by_id:
            if at.id in seen or at.id not in self._aliases:
                names = [*self.by_id, *self._aliases]
                raise FormatError(f"{item.place}: {unknown_name('id', item.id, names)}")
            seen.add(at.id)
            at = self._aliases[at.id]
        return self.by_id[at.id]

    def file(self, name: str, place: Place) -> Path:
        """The file that a scene means by a name, which lies in a folder that may be read.

        Raises FormatError if there is none; folders that may not be read are not looked into.
        """
        looked, refused = [], []
        for folder in self.folders:
            try:
                candidate = (folder / name).resolve()
            except (OSError, ValueError, RuntimeError):  # a NUL, a loop of links
                continue
            if not self.allowed.allows(candidate):
                refused.append(candidate)
            elif candidate.is_file():
                return candidate
            else:
                looked.append(candidate)
        if refused:
            raise FormatError(
                f"{place}: file {name!r} lies outside of the scene's folder: {refused[0]}; "
                f"to read it, allow its folder (--allow-path {refused[0].parent})"
            )
        where = ", ".join(str(p.parent) for p in looked) or "nowhere"
        raise FormatError(f"{place}: no file {name!r}; looked in {where}")

    # XML

    def _parse(self, path: Path) -> _Node:
        text = path.read_bytes() if path.stat().st_size <= _LARGEST else None
        if text is None:
            raise FormatError(f"{path}: is larger than {_LARGEST >> 20} MiB, which no scene is")
        count = 0
        parser = expat.ParserCreate()
        parser.buffer_text = True
        stack: list[_Node] = []
        roots: list[_Node] = []

        def place() -> Place:
            return Place(path, parser.CurrentLineNumber)

        def start(tag: str, attributes: dict[str, str]) -> None:
            nonlocal count
            count += 1
            if len(stack) >= _DEEPEST:
                raise FormatError(f"{place()}: more than {_DEEPEST} elements in each other")
            node = _Node(tag, attributes, place())
            (stack[-1].children if stack else roots).append(node)
            stack.append(node)

        def end(_: str) -> None:
            stack.pop()

        def refuse(*_: object) -> None:
            # entities can stand for gigabytes of text, or for other files
            raise FormatError(f"{place()}: a document type (DTD) is not allowed in a scene")

        def words(text: str) -> None:
            if text.strip():
                raise FormatError(f"{place()}: text between elements: {text.strip()[:40]!r}")

        parser.StartElementHandler = start
        parser.EndElementHandler = end
        parser.StartDoctypeDeclHandler = refuse
        parser.EntityDeclHandler = refuse
        parser.CharacterDataHandler = words
        try:
            parser.Parse(text, True)
        except FormatError:
            raise
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise FormatError(f"{path}: line {error.lineno}: is not XML: {reason}") from None
        except (LookupError, ValueError) as error:  # an unknown encoding
            raise FormatError(f"{path}: is not XML: {error}") from None
        self._included_text.add(path, len(text), count)
        return roots[0]

    def _version(self, root: _Node) -> None:
        text = root.attributes.get("version")
        match = re.fullmatch(r"(\d{1,4})\.(\d{1,4})(\.\d{1,4})?", text or "")
        if match is None:
            raise FormatError(f"{root.place}: <scene> needs a version such as 3.0.0, not {text!r}")
        self.old = match[1] == "0"
        if match[1] not in ("0", "2", "3"):
            self.notes.append(
                f"version {text}: not supported; read as version 3 (versions 0, 2 and 3 are known)"
            )

    def _attributes(self, node: _Node) -> dict[str, str]:
        """The attributes, with parameters ($name) put in."""
        if not any("$" in value for value in node.attributes.values()):
            return node.attributes
        return {key: self._substitute(value, node) for key, value in node.attributes.items()}

    def _substitute(self, text: str, node: _Node) -> str:
        def put(match: re.Match[str]) -> str:
            word = match[1]
            # "$width_2" may be the parameter "width" with something after it: the longest counts
            for end in range(len(word), 0, -1):
                if word[:end] in self._params:
                    self._used.add(word[:end])
                    return self._params[word[:end]] + word[end:]
            raise FormatError(
                f"{node.place}: {unknown_name('parameter', '$' + word, self._params)}; "
                f"give it by <default> or -D {word}=..."
            )

        made = re.sub(rf"\$({_NAME.pattern})", put, text)
        if len(made) > _LONGEST:
            raise FormatError(f"{node.place}: parameters make a text of {len(made)} characters")
        return made

    # Elements

    def _collect(self, node: _Node, into: Object | None) -> None:
        """The element's children, into an object, or into the scene."""
        for child in node.children:
            tag = _OLD_KINDS.get(child.tag, child.tag)
            attributes = self._attributes(child)
            if tag in _CONTROL:
                self._control(child, tag, attributes, into)
            elif tag in KINDS and "type" in attributes:
                made = self._object(child, tag, attributes, into)
                if into is None:
                    self.objects.append(made)
                else:
                    into.items.append((self._name(attributes), made))
            elif tag in _VALUES:
                if into is None:
                    raise FormatError(f"{child.place}: <{child.tag}> directly in the scene")
                name = self._name(attributes)
                if not name:
                    raise FormatError(f"{child.place}: <{child.tag}> of {into} has no name")
                into.items.append((name, self._value(child, tag, attributes, into)))
            elif tag in KINDS:
                raise FormatError(f"{child.place}: <{child.tag}> has no type")
            else:
                choices = [*KINDS, *_VALUES, *_CONTROL]
                raise FormatError(f"{child.place}: {unknown_name('element', child.tag, choices)}")

    def _control(
        self, node: _Node, tag: str, attributes: dict[str, str], into: Object | None
    ) -> None:
        def need(name: str) -> str:
            if name not in attributes:
                raise FormatError(f"{node.place}: <{tag}> has no {name!r}")
            return attributes[name]

        if tag == "default":
            name = need("name")
            if not _NAME.fullmatch(name):
                raise FormatError(f"{node.place}: a parameter cannot be called {name!r}")
            if name in self._params:
                self._used.add(name)  # the command line, or an earlier default, has said it
            else:
                self._params[name] = need("value")
        elif tag == "path":
            try:
                self.folders.insert(0, (node.place.file.parent / need("value")).resolve())
            except (OSError, ValueError, RuntimeError) as error:
                raise FormatError(f"{node.place}: path: {error}") from None
        elif tag == "include":
            self._include(node, need("filename"), into)
        elif tag == "alias":
            self._aliases[need("as")] = Ref(need("id"), node.place)
        elif into is None:
            raise FormatError(f"{node.place}: <ref> directly in the scene means nothing")
        else:
            into.items.append((self._name(attributes), Ref(need("id"), node.place)))

    def _include(self, node: _Node, name: str, into: Object | None) -> None:
        try:
            file = self.file(name, node.place)
        except FormatError:
            beside = (node.place.file.parent / name).resolve()
            if not self.allowed.allows(beside) or not beside.is_file():
                raise
            file = beside
        if file in self._including or file == self.path.resolve():
            raise FormatError(f"{node.place}: {name!r} includes itself")
        if len(self._including) >= _DEEPEST_INCLUDE:
            raise FormatError(
                f"{node.place}: more than {_DEEPEST_INCLUDE} files include each other"
            )
        self._included += 1
        if self._included > _MOST_INCLUDES:
            raise FormatError(f"{node.place}: more than {_MOST_INCLUDES} files are included in all")
        try:
            self._included_text.check("an instance shows one shapegroup many times")
        except SceneError as error:
            raise FormatError(f"{node.place}: {error}") from None
        root = self._parse(file)
        self._including.append(file)
        if root.tag != "scene":  # one object
            root = _Node("scene", {}, root.place, [root])
        self._collect(root, into)
        self._including.pop()

    def _object(
        self, node: _Node, kind: str, attributes: dict[str, str], into: Object | None
    ) -> Object:
        light = kind == "emitter" or (into is not None and into.in_emitter)
        made = Object(kind, attributes["type"], attributes.get("id", ""), node.place, light)
        if made.id:
            if made.id in self.by_id:
                before = self.by_id[made.id].place
                raise FormatError(f"{node.place}: id {made.id!r} is taken; see {before}")
            self.by_id[made.id] = made
        self._collect(node, made)
        return made

    def _name(self, attributes: dict[str, str]) -> str:
        name = attributes.get("name", "")
        if not self.old:
            return name
        name = name.replace("IOR", "Ior").replace("UV", "Uv")
        return re.sub(r"(?<=[a-z0-9])[A-Z]|[A-Z](?=[a-z])", lambda m: "_" + m[0], name).lower()

    def _value(self, node: _Node, tag: str, attributes: dict[str, str], into: Object) -> Value:
        def fail(text: str) -> FormatError:
            name = attributes.get("name", "")
            return FormatError(f"{node.place}: {into}: {tag} {name!r}: {text}")

        try:
            if tag == "transform":
                data: Any = transforms.matrix(self._steps(node))
            elif tag == "spectrum" and "filename" in attributes:
                data = _spectrum_file(self.file(attributes["filename"], node.place))
            else:
                data = _VALUES[tag](attributes)
        except KeyError as error:
            raise fail(f"needs {error}") from None
        except ValueError as error:
            raise fail(str(error)) from None
        if tag != "transform" and node.children:
            raise fail("has elements in it, which mean nothing there")
        return Value(tag, data, node.place)

    def _steps(self, node: _Node) -> Iterator[tuple[str, Mapping[str, str]]]:
        for child in node.children:
            name, attributes = child.tag.lower(), self._attributes(child)
            if name == "rotate" and not self.old:
                length = math.hypot(*transforms.triple(attributes, 0.0))
                if abs(length - 1.0) > 1e-3:
                    self.notes.append(
                        f"line {child.place.line}: rotate around an axis of length {length:.4g}: "
                        "it turns; Mitsuba 3 would shear"
                    )
            yield name, attributes


# Values: from the attributes of an element to its data; KeyError names an attribute that is missing


def _float(attributes: Mapping[str, str]) -> float:
    return transforms.number(attributes["value"])


def _integer(attributes: Mapping[str, str]) -> int:
    text = attributes["value"].strip()
    if not re.fullmatch(r"[+-]?\d{1,18}", text, re.ASCII):
        raise ValueError(f"{text[:40]!r} is no whole number")
    return int(text)


def _boolean(attributes: Mapping[str, str]) -> bool:
    text = attributes["value"].strip().lower()
    if text not in ("true", "false"):
        raise ValueError(f"{text[:40]!r}; must be true or false")
    return text == "true"


def _point(attributes: Mapping[str, str]) -> tuple[float, ...]:
    return transforms.triple(attributes, 0.0)


def _rgb(attributes: Mapping[str, str]) -> tuple[float, ...]:
    text = attributes["value"].strip()
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return tuple(int(text[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    values = transforms.numbers(text)
    if len(values) not in (1, 3):
        raise ValueError(f"{text[:40]!r}; must be one number or three")
    return tuple(values * 3 if len(values) == 1 else values)


def _srgb(attributes: Mapping[str, str]) -> tuple[float, ...]:
    return tuple(decode_srgb(_rgb(attributes)).tolist())


def _spectrum(attributes: Mapping[str, str]) -> object:
    text = attributes["value"].strip()
    if ":" not in text:
        values = transforms.numbers(text)
        if len(values) not in (1, 3):
            raise ValueError(f"{text[:40]!r}; must be one number or wavelength:value pairs")
        return values[0] if len(values) == 1 else tuple(values)  # three: version 0.x, RGB
    pairs = [pair.split(":") for pair in text.replace(",", " ").split()]
    if any(len(pair) != 2 for pair in pairs):
        raise ValueError("must be wavelength:value pairs")
    return _rising([(transforms.number(a), transforms.number(b)) for a, b in pairs])


def _rising(pairs: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    wavelengths = [a for a, _ in pairs]
    if len(pairs) < 2 or any(b <= a for a, b in pairwise(wavelengths)):
        raise ValueError("needs two or more wavelengths, each above the one before")
    return wavelengths, [b for _, b in pairs]


def _spectrum_file(path: Path) -> tuple[list[float], list[float]]:
    """An .spd file: lines of wavelength and value."""
    pairs = []
    for line in path.read_text(encoding="latin-1").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            values = transforms.numbers(line)
            if len(values) != 2:
                raise ValueError(f"{path}: a line is no pair of numbers: {line[:40]!r}")
            pairs.append((values[0], values[1]))
    return _rising(pairs)


def _blackbody(attributes: Mapping[str, str]) -> float:
    text = attributes["temperature"].strip().lower().removesuffix("k")
    return transforms.number(text)


_VALUES: dict[str, Callable[[Mapping[str, str]], Any]] = {
    "float": _float,
    "integer": _integer,
    "boolean": _boolean,
    "string": lambda attributes: attributes["value"],
    "point": _point,
    "vector": _point,
    "rgb": _rgb,
    "srgb": _srgb,
    "spectrum": _spectrum,
    "blackbody": _blackbody,
    "transform": lambda _: None,
}
