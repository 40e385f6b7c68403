"""Scenes from where they came from, as Scene.source tells it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..builtin import weekend
from ..errors import FormatError
from ..scene import Scene, Source
from ..studio import turned_light
from . import LoadOptions, load
from .frames import load_frames


def scene_at(source: Source) -> Scene:
    """The scene from where it came from; options may be lists, as JSON has them.

    Raises FormatError as load() does, for a picture of a sequence that is not there, too, and
    TypeError or ValueError for options that there are not.
    """
    options = tuples(source.options)
    if source.path is None:
        return weekend(**options)
    read_as = LoadOptions(**options)
    which, place = source.frames or ("", 0)
    turn, pivot = (np.array(v, np.float64) for v in source.turned or (np.eye(3), [0] * 3))
    if turn.shape != (3, 3) or pivot.shape != (3,) or not isinstance(place, int):
        raise TypeError("turned is a rotation and a pivot, a frame's place a whole number")
    if not which:
        return turned_light(load(source.path, read_as), turn, pivot)
    frames = load_frames(source.path, which, read_as)
    if not 0 <= place < len(frames):
        raise FormatError(f"{source.path}: there is no picture {place} in frames {which}")
    (scene,) = frames.scenes([place])
    return turned_light(scene, turn, pivot)


def tuples(values: Any) -> dict[str, Any]:
    """A JSON object with tuples in the place of lists. Raises TypeError for anything else."""
    if not isinstance(values, dict):
        raise TypeError
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
