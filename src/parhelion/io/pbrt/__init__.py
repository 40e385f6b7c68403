"""pbrt's scenes: version 4, version 3, and of versions 1 and 2 what version 3 has the like of.

What maps to what, and what does not, is written in docs/pbrt.md. `grammar` reads the text into
directives with parameters, knowing nothing of their meaning; `reader` walks over them and keeps the
graphics state; every kind of directive has a file (shapes, materials, textures, lights, cameras)
with a table from the type's name to the function that makes ours of it.
"""

from __future__ import annotations

from pathlib import Path

from ...scene import Scene
from .. import LoadOptions

NAME = "pbrt"
OPTIONS = ()
BARE = True


def load(path: Path, options: LoadOptions) -> Scene:
    """The file as a scene. Raises FormatError.

    What it asks for and we do not do is logged as a warning, one line a feature; with
    options.strict it is an error.
    """
    import numpy as np

    from .reader import Reader

    with np.errstate(all="ignore"):  # what is not finite is looked for, and named
        return Reader(path, options).scene()
