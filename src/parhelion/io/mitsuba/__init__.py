"""Mitsuba's XML scenes: version 3, and of version 0.x what has the same meaning.

What maps to what, and what does not, is written in docs/mitsuba.md. `document` reads the XML into
objects with properties, knowing nothing of their meaning; `reader` walks over them; every kind of
plugin has a file (shapes, bsdfs, textures, emitters, sensors, integrators) with a table from the
type's name to the function that makes ours of it.
"""

from __future__ import annotations

from pathlib import Path

from ...scene import Scene
from .. import LoadOptions

NAME = "Mitsuba"
PACKED = False
OPTIONS = ("defines",)


def load(path: Path, options: LoadOptions) -> Scene:
    """The file as a scene. Raises FormatError.

    What it asks for and we do not do is logged as a warning, one line a feature; with
    options.strict it is an error.
    """
    import numpy as np

    from .reader import Reader

    with np.errstate(all="ignore"):  # what is not finite is looked for, and named
        return Reader(path, options).scene()
