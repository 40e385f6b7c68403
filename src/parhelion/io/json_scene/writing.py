"""From a Scene to the text of a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ... import scene as model
from ...errors import SceneError
from ...framing import placed
from .document import SHAPES, Pixels
from .files import Folders
from .reading import parse
from .shapes import ARRAY_FIELDS

_TAGS = {block.__name__: tag for tag, block in SHAPES.items()}


def dumps(scene: model.Scene, folder: str | os.PathLike[str] = ".") -> bytes:
    """The text of a JSON file that loads as an equal scene, all arrays within it.

    folder: where the file is to lie; picture files that the scene names are written relative to it,
    and must be within it.

    Raises SceneError for a scene that the format cannot hold, or that load() would refuse.
    """
    home = Path(folder)
    writer = _Writer(scene.materials, home)
    aspect = scene.settings.width / scene.settings.height
    try:
        document = {
            "parhelion": 1,
            "name": scene.name,
            "camera": None if scene.camera is None else _members(placed(scene, aspect)),
            "background": writer.entry(scene.background),
            "lights": [writer.entry(light) for light in scene.lights],
            "materials": {name: writer.entry(m) for name, m in scene.materials.items()},
            "shapes": [writer.shape(shape) for shape in scene.shapes],
            "settings": _members(scene.settings),
        }
        lines = [
            f'"{key}": {msgspec.json.encode(value, enc_hook=_plain).decode()}'
            for key, value in document.items()
        ]
        text = ("{\n" + ",\n".join(lines) + "\n}\n").encode()
        parse(text, Folders(home))
    except (TypeError, ValueError, RecursionError) as error:
        hint = " (as NaN and infinity are written)" if "is null;" in str(error) else ""
        raise SceneError(f"scene {scene.name!r} cannot be written: {error}{hint}") from None
    return text


def _members(instance: Any) -> dict[str, Any]:
    return {f.name: getattr(instance, f.name) for f in fields(instance)}


def _plain(value: Any) -> Any:
    """NumPy's arrays and numbers as Python's."""
    if not hasattr(value, "tolist"):
        raise TypeError(f"{type(value).__name__} is not a number, text or array")
    return value.tolist()


class _Writer:
    def __init__(self, materials: Mapping[str, Any], folder: Path) -> None:
        self.names = np.array([*materials], dtype=object)
        self.folder = folder

    def entry(self, value: Any) -> Any:
        """A material, texture or light as a JSON object; anything else as it is."""
        if not isinstance(value, (model.Material, model.Texture, model.Light)):
            return value
        params = {name: self.entry(x) for name, x in value.params.items()}
        if not isinstance(value, model.Material) and params.get("image") is not None:
            params["image"] = self.image(params["image"])
        return {"type": value.type, **params}

    def image(self, image: Any) -> str | Pixels:
        """A picture's name relative to the folder, or its pixels."""
        if isinstance(image, (str, os.PathLike)):
            file, root = Path(image).resolve(), self.folder.resolve()
            if not file.is_relative_to(root):
                raise SceneError(f"image {os.fspath(image)!r} is not inside the folder {root}")
            return file.relative_to(root).as_posix()
        pixels = np.asarray(image)
        if pixels.dtype.kind == "b":
            pixels = pixels.astype(np.uint8) * np.uint8(255)
        if pixels.dtype.kind == "f":
            pixels = pixels.astype(np.float32)
        if pixels.dtype not in (np.uint8, np.uint16, np.float32):
            raise SceneError(f"an image is {pixels.dtype}; must be uint8, uint16 or floats")
        little = pixels.astype(pixels.dtype.newbyteorder("<"))
        return Pixels(list(pixels.shape), pixels.dtype.name, little.tobytes())

    def shape(self, shape: Any) -> dict[str, Any]:
        """A shape as a JSON object."""
        if type(shape).__name__ not in _TAGS:
            raise SceneError(f"{type(shape).__name__} is no shape")
        block = _members(shape)
        for name in ARRAY_FIELDS & block.keys():
            if isinstance(block[name], str):  # load() would take it for a file's name
                raise SceneError(f"shape {shape.name!r}: {name} must be numbers")
        if isinstance(shape, model.Instances):
            block["shapes"] = [self.shape(part) for part in shape.shapes]
        else:
            block["material"] = self.material(shape)
        if isinstance(shape, model.Mesh):
            block["attributes"] = {
                name: np.squeeze(values, 1) if np.shape(values)[1:] == (1,) else values
                for name, values in shape.attributes.items()
            }
        return {"type": _TAGS[type(shape).__name__], **block}

    def material(self, shape: Any) -> Any:
        """A name, an object or a list of names."""
        if isinstance(shape.material, (str, model.Material)):
            return self.entry(shape.material)
        values = np.asarray(shape.material)
        if values.dtype.kind == "U":
            return values
        count = len(self.names)
        if values.dtype.kind not in "iu" or np.any((values < 0) | (values >= count)):
            raise SceneError(
                f"shape {shape.name!r}: material must be names, or whole numbers below {count}"
            )
        return self.names[values]
