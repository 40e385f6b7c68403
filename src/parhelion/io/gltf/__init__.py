"""glTF 2.0, as .gltf with files beside it or as one .glb.

What maps to what, and what does not, is written in docs/gltf.md. `schema` has the document's
objects, `source` the file, its buffers and its errors, `accessors` the arrays; `nodes` places what
`meshes` makes, at a time of the animations if one is asked for; `materials`, `images` and `lights`
make the rest, and `reader` puts it all together. `writing` goes the other way, with `building`,
`out_materials` and `solids`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...scene import Instances, Mesh, Scene
from .. import LoadOptions, Timeline
from ..files import Reports

NAME = "glTF"
PACKED = False
OPTIONS = ("time", "variant", "camera")
BARE = True
GLOW = 1.0  # brighter needs KHR_materials_emissive_strength
GROUND = (Mesh, Instances)


def load(path: Path, options: LoadOptions) -> Scene:
    """The file as a scene. Raises FormatError.

    What it asks for and we do not do is logged as a warning, one line a feature; with
    options.strict it is an error.
    """
    import numpy as np

    from .reader import Reader

    with np.errstate(all="ignore"):  # what is not finite is looked for, and named
        return Reader(path, options).scene(options.time)


def timeline(path: Path, options: LoadOptions) -> Timeline:
    """Seconds, from the first key of all animations to the last. Raises FormatError."""
    import numpy as np

    from . import animation
    from .reader import Reader

    reader = Reader(path, options)

    def read(time: float) -> Scene:
        with np.errstate(all="ignore"):
            return reader.scene(time)

    return Timeline("time", "seconds", 1.0, None, animation.ends(reader.source), read)


def contents(path: Path, options: LoadOptions) -> dict[str, Any]:
    """Variants, cameras and animations by name. Raises FormatError."""
    from .reader import Reader

    return Reader(path, options).contents()


def save(scene: Scene, path: Path, reports: Reports) -> None:
    """Writes a .glb or .gltf file. Raises SceneError, ResourceError."""
    from . import writing

    writing.save(scene, path, reports)
