"""What readers of scenes share: files that a scene may name, and what it asks for in vain."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from ..errors import FormatError, SceneError

log = logging.getLogger("parhelion")


class Folders:
    """The folder of a scene, and others that the user allows with --allow-path.

    Files elsewhere are not opened, nor is it said whether they exist.
    """

    def __init__(self, own: Path, allowed: Sequence[str] = ()) -> None:
        self.own = own.resolve()
        self.roots = (self.own, *(Path(folder).expanduser().resolve() for folder in allowed))

    def allows(self, file: Path) -> bool:
        """Whether a resolved path lies in one of the folders or below."""
        return any(file.is_relative_to(root) for root in self.roots)

    def file(self, name: str, where: str, beside: Path | None = None) -> Path:
        """The file of that name, by its path from the scene's folder or from `beside`.

        Raises SceneError, beginning with `where`, if it lies elsewhere or is not there.
        """
        shown = _shown(name)
        try:
            file = ((beside or self.own) / name).resolve()
            if not self.allows(file):
                raise self.outside(name, where)
            if not file.is_file():
                raise SceneError(f"{where}: {shown}: no such file")
        except SceneError:
            raise
        except (OSError, RuntimeError, ValueError) as error:  # too long, a loop of links, a NUL
            reason = getattr(error, "strerror", None) or error
            raise SceneError(f"{where}: {shown} cannot be read: {reason}") from None
        return file

    def outside(self, name: str, where: str) -> SceneError:
        """The error for a file that lies in none of the folders."""
        return SceneError(
            f"{where}: {_shown(name)} is not inside the scene's folder (--allow-path allows others)"
        )


def _shown(name: str) -> str:
    return repr(name if len(name) <= 80 else name[:77] + "...")


class Reports:
    """What a scene asks for and we do not do: one line a feature, in order, each once."""

    def __init__(self, path: Path, strict: bool) -> None:
        self.path = path
        self.strict = strict
        self.lines: dict[str, None] = {}

    def add(self, text: str) -> None:
        """Notes a feature; the text names it and says what is done instead."""
        self.lines.setdefault(text)

    def tell(self) -> None:
        """Logs all as warnings. Raises FormatError instead if the user is strict."""
        if self.lines and self.strict:
            lines = "".join(f"\n  {text}" for text in self.lines)
            raise FormatError(f"{self.path}: strict, and not all of it is supported:{lines}")
        for text in self.lines:
            log.warning("%s: %s", self.path.name, text)
