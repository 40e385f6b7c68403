"""Files from which a rendering goes on where it was.

A ZIP archive, stored: checkpoint.json (what is rendered, and how far it is), and the core's memory
as it is in this build: `done`, `targets`, `pixels`, `features`, `prefixes`. ZIP's checksums tell a
damaged one. Of a shard there are the pixels of its own blocks alone, row by row, and picture.json:
what merge() has to know of the scene besides.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .atomic import is_special, replacing
from .errors import FormatError, SceneError, option
from .progressive import Spent
from .scene import Camera, Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .flatten import Flat
    from .progressive import Rendering

FORMAT = 2
HEADER, PICTURE = "checkpoint.json", "picture.json"
# Of a pixel, that a rendering may be asked for
_MOST_SAMPLES = 1 << 31
# No header of ours is longer; names of a million shapes are not
_LONGEST = {HEADER: 1 << 20, PICTURE: 1 << 28}


def identity(
    flat: Flat,
    camera: Camera,
    settings: Settings,
    features: bool,
    shard: tuple[int, int] | None = None,
) -> dict[str, Any]:
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
        "shard": None if shard is None else "{}/{}".format(*shard),
        **json.loads(json.dumps(of_samples, default=float)),
    }


def save(
    path: str | os.PathLike[str],
    rendering: Rendering,
    made_of: dict[str, Any],
    picture: dict[str, Any] | None = None,
) -> None:
    """Writes how far a rendering is. A file that was there stays whole until this one is complete.

    made_of: its identity(). picture: of a shard, what else there is to know; JSON. Raises
    ResourceError for what the system refuses.
    """
    file = Path(path)
    header = {
        "format": FORMAT,
        "identity": made_of,
        "spent": asdict(rendering.spent),
        "spp": max(rendering.goal.spp, int(rendering.done.max())),
    }
    own = own_pixels(rendering.film, rendering.goal.blocks)
    with replacing(file) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr(HEADER, json.dumps(header))
        if picture is not None:
            archive.writestr(PICTURE, json.dumps(picture))
        for name, values in _memory(rendering, own).items():
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(values.data)


def check_new(path: str | os.PathLike[str]) -> None:
    """Raises SceneError where there is a file already, which a new checkpoint would replace."""
    file = Path(path)
    if not file.exists():
        return
    _check_regular(file)
    try:
        with zipfile.ZipFile(file) as archive:
            archive.getinfo(HEADER)
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
    with reading(file) as archive:
        header = text(archive, HEADER)
        _check_identity(file, header, made_of)
        own = own_pixels(rendering.film, rendering.goal.blocks)
        for name, values in _cells(rendering).items():
            fill(archive, name, values)
        for name, values in of_film(rendering.film).items():
            fill(archive, name, values, own)
        told = spent(header)
        if max(rendering.done.max(), rendering.targets.max()) > _MOST_SAMPLES:
            raise ValueError
        rendering.spent = told


def spent(header: Any) -> Spent:
    """What a rendering took, as a header tells it. Raises TypeError, KeyError or ValueError."""
    told = Spent(*(header["spent"][field.name] for field in fields(Spent)))
    numbers = Spent(int(told.samples), int(told.rays), float(told.seconds))
    if numbers != told or not math.isfinite(numbers.seconds):
        raise ValueError
    return numbers


# What reading values of the wrong kinds, or a file that is cut off, may raise
_DAMAGE = (
    zipfile.BadZipFile,
    AttributeError,
    KeyError,
    TypeError,
    ValueError,
    EOFError,
    RuntimeError,
)


@contextmanager
def reading(file: Path) -> Iterator[zipfile.ZipFile]:
    """A checkpoint to read from. What goes wrong in the block, as with a file that is none or a
    damaged one, is a FormatError that names it; a SceneError stays what it is.
    """
    _check_regular(file)
    try:
        with zipfile.ZipFile(file) as archive:
            yield archive
    except SceneError:
        raise
    except OSError as error:
        raise FormatError(f"{file}: cannot be read: {error.strerror or error}") from error
    except _DAMAGE as error:
        raise FormatError(f"{file}: is no checkpoint, or a damaged one") from error


def _check_regular(file: Path) -> None:
    """Raises FormatError for a device or a pipe, which may never end."""
    if is_special(file):
        raise FormatError(f"{file}: is not a regular file")


def text(archive: zipfile.ZipFile, name: str) -> Any:
    """A member that is JSON."""
    if archive.getinfo(name).file_size > _LONGEST[name]:
        raise ValueError
    return json.loads(archive.read(name))


def _check_identity(file: Path, header: Any, made_of: dict[str, Any]) -> None:
    """Raises SceneError for a checkpoint of another picture."""
    if header["format"] != FORMAT:
        raise SceneError(f"{file}: is of another version of Parhelion")
    begun = header["identity"]
    for name, text in (  # another version or build may not know the same names after these
        ("version", "{file}: was begun by version {was} of Parhelion, and this is {now}"),
        ("build", "{file}: was begun by another build of Parhelion"),
        ("scene", "{file}: was begun with another scene, or it has changed since"),
    ):
        if begun[name] != made_of[name]:
            raise SceneError(text.format(file=file, was=begun[name], now=made_of[name]))
    differing = [name for name in made_of if begun[name] != made_of[name]]
    if not differing:
        return
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


def own_pixels(film: Any, blocks: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Which pixels of a film lie in some blocks, row by row; None for all."""
    from . import _core

    if blocks is None:
        return None
    by_pixel = blocks.repeat(_core.block, axis=0).repeat(_core.block, axis=1)
    return by_pixel[: film.height, : film.width].reshape(-1)


def _memory(rendering: Rendering, own: NDArray[np.bool_] | None) -> dict[str, Any]:
    """What is stored, as flat arrays of bytes, by name; of the film, some pixels only."""
    seen = of_film(rendering.film)
    if own is not None:
        seen = {name: _by_pixel(values, own)[own].reshape(-1) for name, values in seen.items()}
    return _cells(rendering) | seen


def _cells(rendering: Rendering) -> dict[str, Any]:
    """How far the cells are, as flat arrays of bytes."""
    done, targets = (a.reshape(-1).view(np.uint8) for a in (rendering.done, rendering.targets))
    return {"done": done, "targets": targets}


def of_film(film: Any) -> dict[str, Any]:
    """A film's memory, as flat arrays of bytes that can be written to, by name."""
    return dict(zip(("pixels", "features", "prefixes"), film.memory(), strict=True))


def _by_pixel(values: Any, own: NDArray[np.bool_]) -> Any:
    """The same array with a row for each pixel."""
    return values.reshape(own.size, values.size // own.size)


def fill(
    archive: zipfile.ZipFile, name: str, values: Any, own: NDArray[np.bool_] | None = None
) -> None:
    """Reads a member to its end, where its checksum is looked at. own: it has those pixels only."""
    if own is not None:
        rows = _by_pixel(values, own)
        some = np.empty((int(own.sum()), rows.shape[1]), np.uint8)
        fill(archive, name, some.reshape(-1))
        rows[own] = some
        return
    if archive.getinfo(name).file_size != values.nbytes:
        raise ValueError
    with archive.open(name) as member:
        at = 0
        while piece := member.read(1 << 24):
            values[at : at + len(piece)] = np.frombuffer(piece, np.uint8)
            at += len(piece)
        if at != values.nbytes:
            raise ValueError
