"""From a Scene to the text of a file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ... import scene as model
from ...atomic import is_special, replacing
from ...errors import SceneError
from ...framing import placed
from ...image import is_encoded, read_pixels
from ..files import Reports
from . import sidefile
from .document import SHAPES, Arrays, Pixels
from .files import Folders
from .reading import parse
from .shapes import ARRAY_FIELDS, WHOLE_FIELDS
from .sidefile import Packing

_TAGS = {block.__name__: tag for tag, block in SHAPES.items()}


# Numbers; shorter arrays stand in the text.
_LARGE = 32


def save(scene: model.Scene, path: Path, reports: Reports) -> None:
    """Writes a JSON file, and beside it what is large in it: docs/scene.md, Large arrays.

    Pictures that lie in the file's folder or below are written by name, others as their pixels.
    The side file comes first, under a name that no older one has; then the document takes the place
    of the old one, whose side file goes last. Raises SceneError, ResourceError.
    """
    packing: Packing | None
    arrays: Arrays | None
    if is_special(path):  # nothing can lie beside it
        packing, arrays, text = None, None, dumps(scene, path.parent)
    else:
        packing = Packing()
        text, arrays = _encoded(scene, path, packing)
    reports.tell()
    before = sidefile.of(path)
    side = path.parent / arrays.file if arrays else None
    new = side is not None and not side.exists()
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(text)
            if packing is not None and side is not None:
                packing.write(side)
    except BaseException:
        if new and side is not None:
            side.unlink(missing_ok=True)
        raise
    if before is not None and (side is None or side.name != before):
        sidefile.remove(before, path)


def dumps(scene: model.Scene, folder: str | os.PathLike[str] = ".") -> bytes:
    """The text of a JSON file that loads as an equal scene, all arrays within it.

    folder: where the file is to lie; picture files that the scene names are written relative to it,
    and must be within it. Shapes made of nothing are left out.

    Raises SceneError for a scene that the format cannot hold, or that load() would refuse.
    """
    try:
        return _encoded(scene, Path(folder) / "scene.json", None)[0]
    except SceneError as error:
        raise SceneError(f"scene {scene.name!r} cannot be written: {error}") from None


def _encoded(
    scene: model.Scene, path: Path, packing: Packing | None
) -> tuple[bytes, Arrays | None]:
    """The text of the document at that path, and its side file, if that is wanted and needed.

    Raises SceneError.
    """
    home = path.parent
    writer = _Writer(scene.materials, home, packing)
    camera = scene.camera
    framed = isinstance(camera, model.Framing)
    if isinstance(camera, model.Framing) and not all(isinstance(s, str) for s in camera.shapes):
        # of shapes that are not the scene's own, for which there is no place in the file
        camera, framed = placed(scene, scene.settings.width / scene.settings.height), False
    try:
        document = {
            "parhelion": 1,
            "name": scene.name,
            "arrays": None,  # its place; what is in them comes with the rest
            "framing" if framed else "camera": _members(camera) if camera else None,
            "background": writer.entry(scene.background),
            "lights": [writer.entry(light) for light in scene.lights],
            "materials": {name: writer.entry(m) for name, m in scene.materials.items()},
            "shapes": writer.shapes(scene.shapes),
            "settings": _members(scene.settings),
            "legend": _legend(scene.legend),
        }
        folders = Folders(home)
        folders.side = packing
        arrays = document["arrays"] = packing.arrays(path) if packing else None
        if arrays is None:
            del document["arrays"]
        lines = [
            f'"{key}": {msgspec.json.encode(value, enc_hook=_plain).decode()}'
            for key, value in document.items()
        ]
        text = ("{\n" + ",\n".join(lines) + "\n}\n").encode()
        parse(text, folders)
    except (TypeError, ValueError, RecursionError) as error:
        hint = " (as NaN and infinity are written)" if "is null;" in str(error) else ""
        raise SceneError(f"{error}{hint}") from None
    return text, arrays


def _members(instance: Any) -> dict[str, Any]:
    return {f.name: getattr(instance, f.name) for f in fields(instance)}


def _legend(legend: Any) -> dict[str, Any] | None:
    if legend is not None and not isinstance(legend, (model.ColorBar, model.Swatches)):
        raise SceneError(f"legend: a ColorBar or Swatches is needed, not {legend!r}")
    return None if legend is None else _members(legend)


def _plain(value: Any) -> Any:
    """NumPy's arrays and numbers as Python's."""
    if not hasattr(value, "tolist"):
        raise TypeError(f"{type(value).__name__} is not a number, text or array")
    return value.tolist()


class _Writer:
    """packing: for arrays of more than _LARGE numbers, if there is to be a side file."""

    def __init__(self, materials: Mapping[str, Any], folder: Path, packing: Packing | None) -> None:
        self.names = np.array([*materials], dtype=object)
        self.folder = folder
        self.packing = packing

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
        given: Any = image
        if isinstance(image, (str, os.PathLike)):
            file, root = Path(image).resolve(), self.folder.resolve()
            if file.is_relative_to(root):
                return file.relative_to(root).as_posix()
            if self.packing is None:
                raise SceneError(f"image {os.fspath(image)!r} is not inside the folder {root}")
            image, given = read_pixels(file), str(file)
        elif is_encoded(image):
            image = read_pixels(image)
        pixels = np.asarray(image)
        if pixels.dtype.kind == "b":
            pixels = pixels.astype(np.uint8) * np.uint8(255)
        if pixels.dtype.kind == "f":
            pixels = pixels.astype(np.float32)
        if pixels.dtype not in (np.uint8, np.uint16, np.float32):
            raise SceneError(f"an image is {pixels.dtype}; must be uint8, uint16 or floats")
        kind: Any = pixels.dtype.name
        if self.packing is not None and pixels.size > _LARGE:
            return Pixels(list(pixels.shape), kind, at=self.packing.add(given, pixels).at)
        little = pixels.astype(pixels.dtype.newbyteorder("<"))
        return Pixels(list(pixels.shape), kind, little.tobytes())

    def shapes(self, shapes: Iterable[Any]) -> list[dict[str, Any]]:
        """Those that have something to show."""
        return [self.shape(shape) for shape in shapes if not _empty(shape)]

    def shape(self, shape: Any) -> dict[str, Any]:
        """A shape as a JSON object."""
        if type(shape).__name__ not in _TAGS:
            raise SceneError(f"{type(shape).__name__} is no shape")
        block = _members(shape)
        for name in ARRAY_FIELDS & block.keys():
            if isinstance(block[name], str):  # load() would take it for a file's name
                raise SceneError(f"shape {shape.name!r}: {name} must be numbers")
            block[name] = self.array(block[name], name in WHOLE_FIELDS)
        if isinstance(shape, model.Instances):
            block["shapes"] = self.shapes(shape.shapes)
        else:
            block["material"] = self.material(shape)
        if isinstance(shape, model.Mesh):
            block["attributes"] = {
                name: self.array(
                    np.squeeze(values, 1) if np.shape(values)[1:] == (1,) else values, False
                )
                for name, values in shape.attributes.items()
            }
        return {"type": _TAGS[type(shape).__name__], **block}

    def array(self, values: Any, whole: bool) -> Any:
        """Numbers for the text, or their place in the side file."""
        if self.packing is None or values is None:
            return values
        array = np.asarray(values)
        if array.size <= _LARGE or array.dtype.kind not in "iuf" or np.ma.is_masked(values):
            return values
        if whole:  # what is negative, or beyond 32 bits, is found where it is read in text
            if array.dtype.kind == "f" or array.min() < 0 or array.max() >= 2**32:
                return values
            return self.packing.add(values, array.astype(np.uint32, copy=False))
        kind = np.float32 if array.dtype == np.float32 else np.float64
        return self.packing.add(values, array.astype(kind, copy=False))

    def material(self, shape: Any) -> Any:
        """A name, an object, a list of names, or the place of stored indices."""
        if isinstance(shape.material, (str, model.Material)):
            return self.entry(shape.material)
        values = np.asarray(shape.material)
        if values.dtype.kind == "U":
            if self.packing is None or values.size <= _LARGE:
                return values
            names, index = np.unique(values, return_inverse=True)
            number = {name: i for i, name in enumerate(self.names)}
            known = np.array([number.get(name, -1) for name in names.tolist()])
            if known.min() < 0:
                return values  # the one that is unknown is named where they are read
            return self.packing.add(shape.material, known[index].astype(np.uint32))
        count = len(self.names)
        if values.dtype.kind not in "iu" or np.any((values < 0) | (values >= count)):
            raise SceneError(
                f"shape {shape.name!r}: material must be names, or whole numbers below {count}"
            )
        if self.packing is not None and values.size > _LARGE:
            return self.packing.add(shape.material, values.astype(np.uint32, copy=False))
        return self.names[values]


def _empty(shape: Any) -> bool:
    """Whether a shape is made of nothing, which a document cannot say."""
    names = {model.Mesh: "faces", model.Cylinders: "starts", model.Curves: "points"}
    names |= {model.Instances: "transforms"}
    values = getattr(shape, names.get(type(shape), "centers"), None)
    return values is not None and not isinstance(values, str) and np.size(values) == 0
