"""One picture of shards: files that machines made of parts of it, which know nothing of each other.

Such a file is a checkpoint of some of the picture's blocks; see shards.py and checkpoint.py.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from . import arguments, checkpoint, memory, shards
from .errors import FormatError, ResourceError, SceneError, option
from .image import Image, RenderStats
from .io.sources import tuples
from .progressive import Spent, picture_error
from .renderer import (
    ERROR_BYTES,
    FEATURE_BYTES,
    PIXEL_BYTES,
    developed,
    merged,
    plain_camera,
)
from .scene import Camera, ColorBar, Settings, Source, Swatches

log = logging.getLogger("parhelion")


@dataclass(frozen=True, eq=False)
class _Names:
    """What a merged picture tells of a scene that is not there."""

    shape_names: list[str]
    material_names: list[str]
    object_names: list[str]
    scene: str

    def sha256(self) -> str:
        return self.scene


@dataclass(frozen=True, eq=False)
class _Part:
    """A file of a shard, but for what it has seen. samples: the fewest of its pixels."""

    file: Path
    shard: tuple[int, int]
    identity: dict[str, Any]
    spp: int
    samples: int
    spent: Spent
    settings: Settings
    camera: Camera
    names: _Names
    legend: ColorBar | Swatches | None
    source: Source | None
    scale: float
    threads: int
    isa: str
    build_seconds: float


@memory.told
def merge(
    parts: Iterable[str | os.PathLike[str]], *, memory_limit: int | str | None = None
) -> Image:
    """The picture whose shards these files are; see render(). The same bits as of one machine.

    stats.seconds, of what is known of the work: of the shard that took longest; stats.threads: of
    all. memory_limit: bytes, or a text such as "4G", that the process may hold.

    Raises FormatError for a file that is no shard or a damaged one; SceneError, naming the files
    and what differs, for shards of several pictures, and for shards that are missing or not
    complete; ResourceError for a picture that memory cannot hold. A shard that is there twice is
    told of, and one of them is taken.
    """
    if isinstance(parts, (str, bytes)) or not isinstance(parts, Iterable):
        raise SceneError(f"parts: a list of files is needed, not {type(parts).__name__}")
    found = [_read(arguments.path(f"parts[{i}]", part)) for i, part in enumerate(parts)]
    if not found:
        raise SceneError("parts: there are none")
    ours = _checked(found)
    first = ours[0]
    features = bool(first.identity["features"])
    width, height = first.settings.size
    with memory.limited(memory_limit):
        pixel_bytes = PIXEL_BYTES + ERROR_BYTES + FEATURE_BYTES * features
        memory.require(width * height * pixel_bytes, f"a picture of {width}x{height}", "")
    try:
        film = _film(ours, features)
        pixels, counts, bad, seen = developed(film, first.names, first.scale)
        error = picture_error(film)
    except MemoryError as problem:
        raise ResourceError(f"not enough memory for a picture of {width}x{height}") from problem
    if bad.any():
        log.warning("%d samples were not finite and count as black", int(bad.sum()))
    stats = RenderStats(
        seconds=max(part.spent.seconds for part in ours),
        samples=sum(part.spent.samples for part in ours),
        rays=sum(part.spent.rays for part in ours),
        threads=sum(part.threads for part in ours),
        isa=", ".join(sorted({part.isa for part in ours})),
        ended="spp",
        error=error if np.isfinite(error) else None,
        build_seconds=max(part.build_seconds for part in ours),
    )
    return Image(
        pixels,
        counts,
        stats,
        first.settings,
        first.camera,
        first.names,
        seen,
        first.legend,
        first.source,
    )


def _read(file: Path) -> _Part:
    """What a file says that it is. Raises FormatError, which begins with its name."""
    try:
        return _told(file)
    except SceneError as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(f"{file}: {error}") from error


def _told(file: Path) -> _Part:
    from . import _core

    with checkpoint.reading(file) as archive:
        header = checkpoint.text(archive, checkpoint.HEADER)
        identity = header["identity"]
        if header["format"] != checkpoint.FORMAT:
            raise SceneError("is of another version of Parhelion")
        if identity["build"] != _core.sources:  # which may not know the same settings
            raise SceneError("was made by another build of Parhelion")
        if identity["shard"] is None:
            raise SceneError(
                "is the checkpoint of a whole picture, not of a shard, as"
                f" {option('shard')} makes them"
            )
        told = checkpoint.text(archive, checkpoint.PICTURE)
        known = {field.name for field in fields(Settings)} - {"spp", "noise"}
        settings = merged(
            Settings(), {**tuples({k: identity[k] for k in known}), "spp": header["spp"]}
        )
        width, height = settings.size
        shard = shards.checked_shard([int(n) for n in identity["shard"].split("/")])
        done = np.frombuffer(archive.read("done"), np.uint32)
        if done.size != 2 * shards.block_count(width, height):
            raise ValueError
        blocks = shards.blocks_of(shard, width, height, settings.reuse_paths is True)
        cells = blocks.repeat(2, axis=0)
        return _Part(
            file=file,
            shard=shard,
            identity=identity,
            spp=header["spp"],
            samples=int(done[cells.reshape(-1)].min()),
            spent=checkpoint.spent(header),
            settings=settings,
            camera=plain_camera(Camera(**tuples(identity["camera"]))),
            names=_names(told["names"], identity["scene"]),
            legend=_legend(told["legend"]),
            source=None if told["source"] is None else Source(**told["source"]),
            scale=float(told["scale"]),
            threads=int(told["threads"]),
            isa=str(told["isa"]),
            build_seconds=float(told["build_seconds"]),
        )


def _checked(parts: list[_Part]) -> list[_Part]:
    """One file of each shard, in their order. Raises SceneError as merge() does."""
    first = parts[0]
    count = first.shard[1]
    for part in parts[1:]:
        differing = _differing(first, part)
        if differing:
            raise SceneError(
                f"{part.file}: is not of the same picture as {first.file}: {differing}"
            )
    by_index: dict[int, _Part] = {}
    for part in parts:
        index = part.shard[0]
        if index in by_index:
            taken = by_index[index].file
            if taken == part.file:
                log.warning("%s: is given twice", part.file)
            else:
                log.warning(
                    "%s: is shard %d/%d, as %s is, which is taken", part.file, index, count, taken
                )
        by_index.setdefault(index, part)
    short = [part for part in by_index.values() if part.samples < part.spp]
    missing = [i for i in range(1, count + 1) if i not in by_index]
    said = []
    if missing:
        said.append(f"of {count} shards {_numbers(missing)} {_are(missing)} missing")
    said += [
        f"{part.file} has {part.samples} of {part.spp} samples per pixel, and"
        f" {option('resume')} goes on from it"
        for part in short[:10]
    ]
    if len(short) > 10:
        said.append(f"{len(short) - 10} more are not complete")
    if said:
        raise SceneError("; ".join(said))
    return [by_index[i] for i in range(1, count + 1)]


def _differing(first: _Part, other: _Part) -> str:
    """What other has that first has not, as a user calls it; nothing if they are of one picture."""
    if first.shard[1] != other.shard[1]:
        return f"it is one of {other.shard[1]} shards, not of {first.shard[1]}"
    if first.spp != other.spp:
        return f"{option('spp')} is {other.spp}, not {first.spp}"
    for name, was in first.identity.items():
        now = other.identity.get(name)
        if name == "shard" or was == now:
            continue
        if name == "scene":
            return "it is of another scene"
        return f"{option(name)} is {json.dumps(now)}, not {json.dumps(was)}"
    return ""


def _numbers(values: list[int]) -> str:
    """Numbers to read, runs of them as 3-17."""
    runs: list[list[int]] = []
    for value in values:
        if runs and value == runs[-1][1] + 1:
            runs[-1][1] = value
        else:
            runs.append([value, value])
    told = [f"{a}" if a == b else f"{a}-{b}" for a, b in runs[:20]]
    return ", ".join(told) + (", ..." if len(runs) > 20 else "")


def _are(values: list[int]) -> str:
    return "is" if len(values) == 1 else "are"


def _film(parts: list[_Part], features: bool) -> Any:
    """The film of the whole picture."""
    from . import _core

    x, y = (parts[0].settings.crop or (0, 0))[:2]
    width, height = parts[0].settings.size
    film = _core.Film(x, y, width, height, features, True)
    for part in parts:
        blocks = shards.blocks_of(part.shard, width, height, part.settings.reuse_paths is True)
        own = checkpoint.own_pixels(film, blocks)
        with checkpoint.reading(part.file) as archive:
            for name, values in checkpoint.of_film(film).items():
                checkpoint.fill(archive, name, values, own)
    return film


def _names(told: dict[str, list[str]], scene: str) -> _Names:
    if not all(isinstance(name, str) for names in told.values() for name in names):
        raise TypeError
    return _Names(**{kind: list(names) for kind, names in told.items()}, scene=scene)


def _legend(told: Any) -> ColorBar | Swatches | None:
    if told is None:
        return None
    if "kinds" in told:
        return Swatches(told["label"], tuple((name, tuple(rgb)) for name, rgb in told["kinds"]))
    return ColorBar(**told)
