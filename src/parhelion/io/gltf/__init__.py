"""glTF 2.0, as .gltf with files beside it or as one .glb.

What maps to what, and what does not, is written in docs/gltf.md. `schema` has the document's
objects, `source` the file, its buffers and its errors, `accessors` the arrays; `nodes` places what
`meshes` makes, at a time of the animations if one is asked for; `materials`, `images` and `lights`
make the rest, and `reader` puts it all together. `writing` goes the other way, with `building`,
`out_materials` and `solids`.
"""

from __future__ import annotations

from pathlib import Path

from ...scene import Instances, Mesh, Scene
from .. import LoadOptions
from ..files import Reports

NAME = "glTF"
SUFFIXES = (".gltf", ".glb")
PACKED = False
OPTIONS = ("time", "variant")
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
        return Reader(path, options).scene()


def save(scene: Scene, path: Path, reports: Reports) -> None:
    """Writes a .glb or .gltf file. Raises SceneError, ResourceError."""
    from . import writing

    writing.save(scene, path, reports)
