"""The sequences of pictures of `parhelion render`: turntables, frames, films."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SceneError
from . import options
from .render import CHECKPOINT, check_legend, finished, is_finished, rendering_seconds
from .watch import Watch

if TYPE_CHECKING:
    from ..image import Image
    from ..scene import Settings


@dataclass(frozen=True)
class _Series:
    """The pictures of a sequence: the numbers of their files, which one that at a place is, for its
    file's metadata, width and height, how many are shown a second, and what renders those at some
    places.
    """

    numbers: Sequence[int]
    part: Callable[[int], dict[str, Any]]
    size: tuple[int, int]
    fps: float
    images: Callable[[Sequence[int]], Iterable[Image]]


def run(args: argparse.Namespace, output: str, settings: dict[str, Any]) -> int:
    """Writes whole pictures only; 130 if it was stopped."""
    from ..io.frames import checked_fps
    from ..sequence import FILM, check_sequence, is_there, numbered, opened
    from ..shards import checked_shard

    film = output.lower().endswith(FILM)
    if args.turntable is not None and args.frames is not None:
        raise SceneError("--turntable and --frames are two sequences; give one of them")
    if args.checkpoint is not None or args.checkpoint_every is not None or args.resume:
        raise SceneError("--checkpoint and --resume are for one picture, not for a sequence")
    if film and args.shard is not None:
        raise SceneError(f"{output}: a film is made in one piece, so --shard is for pictures")
    if film and args.skip_existing:
        pictures = f"{Path(output).stem}.####.png"
        raise SceneError(
            f"{output}: a film is made in one piece, so --skip-existing is for pictures: write"
            f" -o {pictures}, and make the film of them with ffmpeg"
        )
    if args.fps is not None:
        checked_fps(args.fps)
    to_write = {name: getattr(args, name) for name in ("bits", "features", "legend")}
    to_write |= options.saving(args)
    check_sequence(output, **to_write)  # before the scene is read, which may take long
    make = _turntable if args.frames is None else _frames
    start, watch, image = time.perf_counter(), Watch(), None
    with options.naming(args):
        series = make(args, output, film, settings, watch)
    if args.time_limit is not None:  # of each picture
        settings["time_limit"] = rendering_seconds(args, output, series.size, time.perf_counter())

    def notes(k: int) -> dict[str, str]:
        return {"parhelion:sequence": _made_of(args, series.part(k))}

    def is_done(k: int) -> bool:
        file = numbered(output, series.numbers[k])
        return is_there(file, series.size, notes(k), args.legend)

    places: Sequence[int] = range(len(series.numbers))
    if args.shard is not None:
        index, count = checked_shard(args.shard)
        places = places[index - 1 :: count]
    asked = len(places)
    if args.skip_existing:
        places = [k for k in places if not is_done(k)]
    watch.count, there = len(places), asked - len(places)
    try:
        with (
            opened(output, fps=series.fps, **to_write) as taker,
            options.naming(args, "camera:"),
            watch.watching(args.quiet),
        ):
            for k, image in zip(places, series.images(places), strict=True):
                image = finished(args, image, watch)
                if not is_finished(args, image):
                    raise _Stopped(image.stats.ended)
                taker.add(replace(image, notes=notes(k)), series.numbers[k])
                watch.add(image)
    except _Stopped as why:
        failed = str(why) == "failed"
        said = "a part of the next failed" if failed else "stopped"
        done = f"{said} after {watch.done} of {watch.count} pictures"
        hint = f"{output} was not written" if film else "--skip-existing makes the others"
        print(f"parhelion: {done}; {hint}", file=sys.stderr)
        return 1 if failed else 130
    if not args.quiet:
        what = f"{watch.count} picture{'s' * (watch.count != 1)}"
        what += f" ({there} more {'was' if there == 1 else 'were'} there)" if there else ""
        if image is not None:
            height, width = image.pixels.shape[:2]
            seconds = time.perf_counter() - start
            what += f", {width}x{height}, {image.told_spp()} in {seconds:.2f} s"
        print(f"{output}: {what}", file=sys.stderr)
    return 0


class _Stopped(Exception):
    """Leaves a sequence in its middle; its text is what ended the picture there."""


def _turntable(
    args: argparse.Namespace, output: str, film: bool, settings: dict[str, Any], watch: Watch
) -> _Series:
    """The pictures of a turn."""
    from ..flatten import flatten
    from ..io.frames import FPS
    from ..orbit import checked_count, turntable

    _check_fps(args, output, film)
    count = checked_count(args.turntable)
    scene = options.load_scene(args)
    check_legend(args, scene)
    size = _size(output, film, scene.settings, settings)

    def images(places: Sequence[int]) -> Iterable[Image]:
        return turntable(scene, count, places=places, progress=watch, **settings)

    @cache
    def seen() -> str:
        return flatten(scene).sha256()

    def part(place: int) -> dict[str, Any]:
        return {"turntable": count, "picture": place + 1, "of": seen()}

    fps = FPS if args.fps is None else args.fps
    return _Series(range(1, count + 1), part, size, fps, images)


def _frames(
    args: argparse.Namespace, output: str, film: bool, settings: dict[str, Any], watch: Watch
) -> _Series:
    """The pictures of a file's frames."""
    from ..io.frames import load_frames
    from ..renderer import render

    if args.scene is None:
        raise SceneError("--frames needs a file")
    scenes = load_frames(args.scene, args.frames, options.load_options(args), fps=args.fps)
    _check_fps(args, output, film or scenes.sampled)
    size = _size(output, film, scenes.settings, settings)
    check_legend(args, scenes)

    def images(places: Sequence[int]) -> Iterable[Image]:
        return (render(s, progress=watch, **settings) for s in scenes.scenes(places))

    def part(place: int) -> dict[str, Any]:
        return {"frame": scenes.numbers[place], "look": scenes.look}

    return _Series(scenes.file_numbers, part, size, scenes.fps, images)


# What a picture of a sequence does not depend on, or what is told of each one by itself
_NOT_MADE_OF = {
    *CHECKPOINT,
    *("output", "threads", "tree", "schedule", "tile", "quiet", "log_level", "skip_existing"),
    *(
        "memory_limit",
        "turntable",
        "frames",
        "shard",
        "cluster",
        "fps",
        "allow_paths",
        "strict",
        "run",
        "flags",
        "default_of",
    ),
}


def _made_of(args: argparse.Namespace, part: dict[str, Any]) -> str:
    """What one picture of a sequence is made of, as JSON: what the user gave, files by their names.

    part: which of the sequence it is.
    """
    given = {
        name: value
        for name, value in vars(args).items()
        if name not in _NOT_MADE_OF and value != args.default_of(name)
    }
    for name in ("scene", "environment"):
        if given.get(name) is not None:
            given[name] = Path(given[name]).name
    return json.dumps({**given, **part}, sort_keys=True)


def _check_fps(args: argparse.Namespace, output: str, matters: bool) -> None:
    """Raises SceneError for a rate that nothing depends on."""
    from ..sequence import FILM

    if args.fps is not None and not matters:
        raise SceneError(f"{output}: --fps is for films: {FILM}")


def _size(output: str, film: bool, base: Settings, settings: dict[str, Any]) -> tuple[int, int]:
    """Width and height of the pictures; those of a film are made even where the user does not say.

    Raises SceneError for pictures that no film can be made of, before there are any.
    """
    from ..renderer import merged
    from ..sequence import check_film_size

    known = {f.name for f in fields(base)}
    wanted = merged(base, {k: v for k, v in settings.items() if k in known})
    if film and wanted.crop is None:
        for name in ("width", "height"):
            own = getattr(wanted, name)
            settings[name] = own + own % 2 if settings[name] is None else own
        wanted = merged(wanted, {name: settings[name] for name in ("width", "height")})
    if film:
        check_film_size(output, *wanted.size)
    return wanted.size
