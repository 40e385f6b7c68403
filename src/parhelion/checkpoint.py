"""Files from which a rendering goes on where it was.

A ZIP archive, stored: checkpoint.json (what is rendered, and how far it is), and the core's memory
as it is in this build: `done`, `targets`, `pixels`, `features`, `prefixes`. ZIP's checksums tell a
damaged one.
"""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .atomic import replacing
from .errors import FormatError, SceneError, option
from .progressive import Spent
from .scene import Camera, Settings

if TYPE_CHECKING:
    from .flatten import Flat
    from .progressive import Rendering

_FORMAT = 1
_HEADER = "checkpoint.json"
# No header of ours is longer
_LONGEST = 1 << 20


def identity(flat: Flat, camera: Camera, settings: Settings, features: bool) -> dict[str, Any]:
    """All that the samples depend on, by what it is called in messages."""
    from . import __version__, _core

    of_samples = asdict(settings)
    for when_to_stop in ("spp", "noise"):
        del of_samples[when_to_stop]
    return {
        "version": __version__,
        "build": _core.sources,
        "scene": flat.sha256(),
        "camera": json.loads(json.dumps(asdict(camera), default=float)),
        "features": features,
        **json.loads(json.dumps(of_samples, default=float)),
    }


def save(path: str | os.PathLike[str], rendering: Rendering, made_of: dict[str, Any]) -> None:
    """Writes how far a rendering is. A file that was there stays whole until this one is complete.

    made_of: its identity(). Raises ResourceError for what the system refuses.
    """
    file = Path(path)
    header = {
        "format": _FORMAT,
        "identity": made_of,
        "spent": asdict(rendering.spent),
    }
    with replacing(file) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr(_HEADER, json.dumps(header))
        for name, values in _memory(rendering).items():
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(values.data)


def check_new(path: str | os.PathLike[str]) -> None:
    """Raises SceneError where there is a file already, which a new checkpoint would replace."""
    file = Path(path)
    if not file.exists():
        return
    try:
        with zipfile.ZipFile(file) as archive:
            archive.getinfo(_HEADER)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile):
        raise SceneError(f"{file}: is there already, and is no checkpoint") from None
    raise SceneError(
        f"{file}: is there already; {option('resume')} goes on from it, and without the file the"
        " picture begins anew"
    )


def resume(path: str | os.PathLike[str], rendering: Rendering, made_of: dict[str, Any]) -> None:
    """Sets a new rendering to where another one was.

    Raises FormatError for a file that is no checkpoint or a damaged one, and SceneError, naming
    what differs, for one of another picture.
    """
    file = Path(path)
    try:
        with zipfile.ZipFile(file) as archive:
            if archive.getinfo(_HEADER).file_size > _LONGEST:
                raise ValueError
            header = json.loads(archive.read(_HEADER))
            _check_identity(file, header, made_of)
            memory = _memory(rendering)
            for name, values in memory.items():
                if archive.getinfo(name).file_size != values.nbytes:
                    raise ValueError
                _fill(archive, name, values)
            rendering.spent = Spent(**header["spent"])
    except SceneError:
        raise
    except OSError as error:
        raise FormatError(f"{file}: cannot be read: {error.strerror or error}") from error
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError, EOFError, RuntimeError) as error:
        raise FormatError(f"{file}: is no checkpoint, or a damaged one") from error


def _check_identity(file: Path, header: Any, made_of: dict[str, Any]) -> None:
    """Raises SceneError for a checkpoint of another picture."""
    if header["format"] != _FORMAT:
        raise SceneError(f"{file}: is of another version of Parhelion")
    begun = header["identity"]
    differing = [name for name in made_of if begun[name] != made_of[name]]
    if not differing:
        return
    for name, text in (
        ("version", "{file}: was begun by version {was} of Parhelion, and this is {now}"),
        ("build", "{file}: was begun by another build of Parhelion"),
        ("scene", "{file}: was begun with another scene, or it has changed since"),
    ):
        if name in differing:
            raise SceneError(text.format(file=file, was=begun[name], now=made_of[name]))
    told = "; ".join(_difference(name, begun[name], made_of[name]) for name in differing)
    raise SceneError(f"{file}: was begun {told}")


def _difference(name: str, was: Any, now: Any) -> str:
    """What the picture was begun with, and is not to go on with, as the user writes it."""
    shown = option(name)
    if shown.startswith("--") and isinstance(was, bool):  # a flag is there or not
        given = was != shown.startswith("--no-")
        return f"with {shown}, not without it" if given else f"without {shown}, not with it"
    if was is None:
        return f"without {shown}, not with {_told(now)}"
    if now is None:
        return f"with {shown} {_told(was)}, not without it"
    return f"with {shown} {_told(was)}, not {_told(now)}"


def _told(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(map(str, value))
    return str(value) if not isinstance(value, dict) else json.dumps(value)


def _memory(rendering: Rendering) -> dict[str, Any]:
    """What is stored, as flat arrays of bytes that can be read and written, by name."""
    done, targets = (a.reshape(-1).view(np.uint8) for a in (rendering.done, rendering.targets))
    films = zip(("pixels", "features", "prefixes"), rendering.film.memory(), strict=True)
    return {"done": done, "targets": targets, **dict(films)}


def _fill(archive: zipfile.ZipFile, name: str, values: Any) -> None:
    """Reads a member to its end, where its checksum is looked at."""
    with archive.open(name) as member:
        at = 0
        while piece := member.read(1 << 24):
            values[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
            at += len(piece)
        if at != values.nbytes:
            raise ValueError
