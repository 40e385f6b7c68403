"""From a file to a Scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from ... import scene as model
from ... import tables
from ...errors import FormatError, SceneError
from .. import LoadOptions
from . import shapes, sidefile, source
from .document import Document, Legend
from .entries import Entries
from .files import Folders
from .messages import invalid, malformed, member, unknown_choice


def load(path: Path, options: LoadOptions) -> model.Scene:
    """The scene of a JSON file, which may be packed with gzip, bzip2 or xz.

    Raises FormatError where the file is no valid scene. A file that cannot be opened is the
    caller's OSError.
    """
    try:
        scene = parse(source.text(path), Folders(path.parent, options.allow_paths))
    except SceneError as error:
        raise FormatError(f"{path}: {error}") from None
    except RecursionError:
        raise FormatError(f"{path}: is nested too deeply") from None
    return scene.replace(name=path.name.partition(".")[0]) if scene.name == "" else scene


def parse(data: bytes, folders: Folders) -> model.Scene:
    """The scene that a text describes; its name is "" if the text gives none.

    The side file is folders.side if there is one, else the one that the text names.
    """
    # Numbers too large for a float would be refused without a place where no type is known; float()
    # makes them infinite, and what reads them names them.
    decoder = msgspec.json.Decoder(float_hook=float)

    def plain() -> Any:
        return decoder.decode(data)

    try:
        document = msgspec.json.Decoder(Document, float_hook=float).decode(data)
    except msgspec.ValidationError as error:
        try:
            text = invalid(str(error), plain, "$", Document)
        except msgspec.DecodeError as other:  # broken behind the value that is wrong
            text = malformed(str(other), data)
        except (LookupError, TypeError):  # the place is in a value whose key comes again
            source.refuse_repeated_keys(data)
            raise
        raise SceneError(text) from None
    except msgspec.DecodeError as error:
        raise SceneError(malformed(str(error), data)) from None
    if document.arrays is not None and folders.side is None:
        file = folders.file(document.arrays.file, "$.arrays.file")
        folders.side = sidefile.read(file, document.arrays, "$.arrays")
    entries = Entries(document.materials, folders)
    scene = model.Scene(
        name=document.name or "",
        camera=_camera(document),
        background=entries.background(document.background, "$.background"),
        lights=tuple(
            entries.light(value, f"$.lights[{i}]") for i, value in enumerate(document.lights)
        ),
        materials={
            name: entries.material(value, f"$.materials{member(name)}")
            for name, value in document.materials.items()
        },
        shapes=tuple(
            shapes.read(block, entries, f"$.shapes[{i}]") for i, block in enumerate(document.shapes)
        ),
        settings=_settings(document),
        legend=None if document.legend is None else _legend(document.legend),
    )
    source.refuse_repeated_keys(data)
    return scene


def _camera(document: Document) -> model.Camera | model.Framing | None:
    camera, framing = document.camera, document.framing
    if camera is not None and framing is not None:
        raise SceneError("$: has both 'camera' and 'framing'; give one of them")
    if framing is not None:
        members = msgspec.structs.asdict(framing)
        return model.Framing(**members | {"shapes": tuple(framing.shapes)})
    if camera is None:
        return None
    if camera.fov is not None and camera.vfov is not None:
        raise SceneError("$.camera: has both 'fov' and 'vfov'; give one of them")
    known = projections()
    if camera.projection not in known:
        text = unknown_choice("projection", camera.projection, known)
        raise SceneError(f"$.camera.projection: {text}")
    return model.Camera(**msgspec.structs.asdict(camera))


def _legend(legend: Legend) -> model.ColorBar | model.Swatches:
    bar = {name: getattr(legend, name) for name in ("colormap", "low", "high")}
    given = [name for name, value in bar.items() if value is not msgspec.UNSET]
    if legend.kinds is not msgspec.UNSET:
        if given:
            raise SceneError(f"$.legend: has both 'kinds' and {given[0]!r}; give one of them")
        return model.Swatches(legend.label, tuple(legend.kinds))
    missing = [name for name in bar if name not in given]
    if missing:
        instead = " ('kinds' in the place of all three)" if not given else ""
        raise SceneError(f"$.legend: the field {missing[0]!r} is missing{instead}")
    if bar["low"] > bar["high"]:
        raise SceneError(f"$.legend: low is {bar['low']:g}; must be at most high, {bar['high']:g}")
    return model.ColorBar(legend.label, **bar)


def _settings(document: Document) -> model.Settings:
    settings = document.settings
    tables.entry("samplers", settings.sampler, "$.settings.sampler")
    tables.entry("filters", settings.filter, "$.settings.filter")
    return model.Settings(**msgspec.structs.asdict(settings))


def projections() -> list[str]:
    """The names of core/cameras.def."""
    from ... import _core

    return [str(name) for name in _core.tables()["cameras"]]
