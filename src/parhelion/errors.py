"""The one family of errors that Parhelion raises.

Every text says what was wrong, where (file, object, element) and what the choices are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from difflib import get_close_matches

# What options are called where they are not called as in Python
_SPELLED: ContextVar[Mapping[str, str] | None] = ContextVar("spelled", default=None)

# Names that a message lists; of more it tells how many
_LISTED = 40
# Characters in a line of a message: beyond that it quotes a file at length
_LONGEST = 1000


class ParhelionError(Exception):
    """Base of all errors of this package; catch it to catch them all."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(plain(arg) if isinstance(arg, str) else arg for arg in args))


class SceneError(ParhelionError, ValueError):
    """A scene, or a request to render one, that has no meaning: a NaN radius, eye = target."""


class FormatError(SceneError):
    """A file that cannot be read as what it claims to be; the text begins with its path."""


class ResourceError(ParhelionError, OSError):
    """The machine said no: no memory, a full disk, a folder that cannot be written."""


def plain(text: str) -> str:
    """Text that may quote a file, as it is safe to print: control characters as they are escaped in
    Python, and the middle of endless lines left out.
    """
    lines = text.split("\n")
    if not text.isprintable():
        lines = [
            line
            if line.isprintable()
            else "".join(c if c.isprintable() else repr(c)[1:-1] for c in line)
            for line in lines
        ]
    half = _LONGEST // 2
    return "\n".join(n if len(n) <= _LONGEST else f"{n[:half]}...{n[-half:]}" for n in lines)


def option(name: str) -> str:
    """An option's name as the user knows it: that of Python or, on the command line, the flag."""
    return (_SPELLED.get() or {}).get(name, name)


@contextmanager
def spelled(names: Mapping[str, str]) -> Iterator[None]:
    """Errors that are made in the block call options by these names."""
    token = _SPELLED.set(names)
    try:
        yield
    finally:
        _SPELLED.reset(token)


def unknown_name(what: str, name: object, choices: Iterable[str]) -> str:
    """The sentence for a name that is not in a list: the nearest one, then all of them, or 40 and
    how many more there are.

    >>> unknown_name("material type", "mettal", ["diffuse", "metal"])
    "unknown material type 'mettal'; did you mean 'metal'? (choices: diffuse, metal)"
    >>> unknown_name("variant", "night", [])
    "unknown variant 'night'; there are none"
    """
    known = sorted(choices)
    name = str(name)
    if len(name) > 60:  # a file may hold anything
        name = name[:57] + "..."
    if not known:
        return f"unknown {what} {name!r}; there are none"
    near = get_close_matches(name, known, n=1)
    guess = f"; did you mean {near[0]!r}?" if near else ""
    more = f" and {len(known) - _LISTED} more" if len(known) > _LISTED else ""
    return f"unknown {what} {name!r}{guess} (choices: {', '.join(known[:_LISTED])}{more})"
