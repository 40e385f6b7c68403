"""`parhelion render`: a picture from a scene."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SceneError
from . import options

if TYPE_CHECKING:
    from ..image import Image
    from ..io.frames import Frames
    from ..progress import Progress, ProgressCallback
    from ..scene import Scene, Settings


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "render",
        help="render a picture",
        description="Renders a scene or particle file; the built-in scene if none is given."
        " Ctrl-C stops it and writes what there is.",
    )
    options.add_loading(p)
    p.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help=".png, .jpg (sRGB) or .exr (linear); of a sequence also .mp4, and %%04d where the"
        " number stands; default: the scene's name and .png",
    )
    p.add_argument("--bits", type=int, help="a channel: 8 or 16 for .png, 16 or 32 for .exr")
    p.add_argument(
        "--exposure",
        type=float,
        default=0.0,
        metavar="EV",
        help="stops brighter, or darker if negative; .exr files keep the linear values",
    )
    p.add_argument(
        "--features",
        action="store_true",
        help="also depth, position, normals, albedo, Cryptomattes and so on, as layers of the"
        " .exr file",
    )
    p.add_argument(
        "--legend",
        action="store_true",
        help="what colours stand for, at the right side of the picture, which becomes wider",
    )
    picture = p.add_argument_group("picture (default: what the scene says)")
    picture.add_argument("--width", type=int, metavar="N")
    picture.add_argument("--height", type=int, metavar="N")
    picture.add_argument("--spp", "--samples", type=int, metavar="N", help="samples per pixel")
    picture.add_argument("--max-depth", type=int, metavar="N", help="rays in a path, at most")
    picture.add_argument("--seed", type=int, metavar="N", help="of all random numbers")
    picture.add_argument("--sampler", metavar="NAME", help="sobol or independent")
    picture.add_argument("--filter", metavar="NAME", help="box, tent, gaussian or blackman-harris")
    picture.add_argument("--filter-radius", type=float, metavar="PIXELS")
    picture.add_argument(
        "--no-roulette",
        dest="roulette",
        action="store_false",
        default=None,
        help="follow every path to its maximal depth",
    )
    picture.add_argument(
        "--crop", type=_crop, metavar="X,Y,W,H", help="only this part, from the top left"
    )
    picture.add_argument(
        "--integrator",
        metavar="NAME",
        help="path: all light; direct: scattered once at most; ao: how open the surroundings are",
    )
    picture.add_argument(
        "--ao-distance",
        type=float,
        metavar="LENGTH",
        help="how far ao looks; default: any distance",
    )
    picture.add_argument(
        "--background",
        dest="backdrop",
        type=_color,
        metavar="COLOR",
        help="what is seen where there is nothing: a name such as white or #rrggbb; what"
        " lights the scene stays",
    )
    sequence = p.add_argument_group("sequences of pictures")
    sequence.add_argument(
        "--turntable",
        type=int,
        metavar="N",
        help="N pictures, the camera going once around: NAME.0001.png and so on, or a film",
    )
    sequence.add_argument(
        "--frames",
        metavar="A:B:STEP",
        help="a picture of each of these frames, as in Python's slices: of a trajectory counted"
        " from 0 (all, 100:, ::10, =-5: for the last five), of USD time codes, of glTF seconds",
    )
    sequence.add_argument(
        "--fps",
        type=float,
        metavar="RATE",
        help="pictures a second, of a film and of glTF's animations; default: the speed of the"
        " file, else 30",
    )
    work = p.add_argument_group("work (the picture does not depend on these)")
    work.add_argument(
        "-t", "--threads", type=int, default=0, metavar="N", help="default: all cores"
    )
    work.add_argument("--tree", default="bvh", help="bvh, or none to test every primitive")
    work.add_argument("--schedule", default="dynamic", help="OpenMP's: dynamic, static or guided")
    work.add_argument("--tile", type=int, default=16, metavar="PIXELS")
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Renders and writes; 130 if it was stopped."""
    from ..image import checked_exposure

    output = args.output if args.output is not None else f"{_stem(args.scene)}.png"
    names = (
        "width",
        "height",
        "spp",
        "max_depth",
        "seed",
        "sampler",
        "filter",
        "filter_radius",
        "roulette",
        "crop",
        "integrator",
        "ao_distance",
        "backdrop",
        "threads",
        "tree",
        "schedule",
        "tile",
        "features",
    )
    settings = {name: getattr(args, name) for name in names}
    if args.backdrop is not None:
        if args.ground is None:
            args.ground = False  # it would cover most of what was asked for
        if not output.lower().endswith(".exr"):  # the colour is to be seen as it was named
            factor = 2.0 ** -checked_exposure(args.exposure)
            settings["backdrop"] = tuple(factor * c for c in args.backdrop)
    if args.turntable is not None or args.frames is not None:
        return _sequence(args, output, settings)
    return _picture(args, output, settings)


def _picture(args: argparse.Namespace, output: str, settings: dict[str, Any]) -> int:
    from ..image import check_output
    from ..renderer import prepare, render

    if args.fps is not None:
        raise SceneError("--fps needs a sequence of pictures: --turntable or --frames")
    check_output(output, args.bits, args.features, args.legend, args.exposure)
    with options.naming(args):
        scene = prepare(options.load_scene(args))
        _check_legend(args, scene.scene)
    watch = _Watch()
    # The camera can only be the file's own.
    with options.naming(args, "camera:"), watch.watching(args.quiet):
        image = render(scene, progress=watch, **settings)
        image.save(output, bits=args.bits, legend=args.legend, exposure=args.exposure)
    if image.stats.complete:
        if not args.quiet:
            print(f"{output}: {_summary(image)}", file=sys.stderr)
        return 0
    wanted = image.settings.spp
    least, most = int(image.counts.min()), int(image.counts.max())
    got = f"{most}" if least == most else f"{least} to {most}"
    print(f"parhelion: stopped; {output} has {got} of {wanted} samples per pixel", file=sys.stderr)
    return 130


def _sequence(args: argparse.Namespace, output: str, settings: dict[str, Any]) -> int:
    """Writes whole pictures only; 130 if it was stopped."""
    from ..io.frames import checked_fps
    from ..sequence import FILM, check_sequence, opened

    film = output.lower().endswith(FILM)
    if args.turntable is not None and args.frames is not None:
        raise SceneError("--turntable and --frames are two sequences; give one of them")
    if args.fps is not None:
        checked_fps(args.fps)
    names = ("bits", "features", "legend", "exposure")
    to_write = {name: getattr(args, name) for name in names}
    check_sequence(output, **to_write)  # before the scene is read, which may take long
    make = _turntable if args.frames is None else _frames
    start, watch, image = time.perf_counter(), _Watch(), None
    with options.naming(args):
        images, fps = make(args, output, film, settings, watch)
    try:
        with (
            opened(output, fps=fps, **to_write) as taker,
            options.naming(args, "camera:"),
            watch.watching(args.quiet),
        ):
            for image in images:
                if not image.stats.complete:
                    raise _Stopped
                taker.add(image)
                watch.add(image)
    except _Stopped:
        done = f"stopped after {watch.done} of {watch.count} pictures"
        left = f"; {output} was not written" if film else ""
        print(f"parhelion: {done}{left}", file=sys.stderr)
        return 130
    if not args.quiet and image is not None:
        height, width = image.pixels.shape[:2]
        seconds = time.perf_counter() - start
        what = f"{watch.count} picture{'s' * (watch.count != 1)}, {width}x{height}"
        print(f"{output}: {what}, {image.settings.spp} spp in {seconds:.2f} s", file=sys.stderr)
    return 0


class _Stopped(Exception):
    """Leaves a sequence in its middle."""


def _turntable(
    args: argparse.Namespace, output: str, film: bool, settings: dict[str, Any], watch: _Watch
) -> tuple[Iterable[Image], float]:
    """The pictures of a turn, and how many are shown a second."""
    from ..io.frames import FPS
    from ..orbit import turntable

    _check_fps(args, output, film)
    scene = options.load_scene(args)
    _check_legend(args, scene)
    _check_film(output, film, scene.settings, settings)
    watch.count = args.turntable
    fps = FPS if args.fps is None else args.fps
    return turntable(scene, args.turntable, progress=watch, **settings), fps


def _frames(
    args: argparse.Namespace, output: str, film: bool, settings: dict[str, Any], watch: _Watch
) -> tuple[Iterable[Image], float]:
    """The pictures of a file's frames, and how many are shown a second."""
    from ..io.frames import load_frames
    from ..renderer import render

    if args.scene is None:
        raise SceneError("--frames needs a file")
    scenes = load_frames(args.scene, args.frames, options.load_options(args), fps=args.fps)
    _check_fps(args, output, film or scenes.sampled)
    _check_film(output, film, scenes.settings, settings)
    _check_legend(args, scenes)
    watch.count = len(scenes)
    return (render(scene, progress=watch, **settings) for scene in scenes), scenes.fps


def _check_legend(args: argparse.Namespace, scene: Scene | Frames) -> None:
    """Raises SceneError for a legend that there is not, before there is a picture."""
    from ..image import checked_legend

    if args.legend:
        checked_legend(scene.legend)


def _check_fps(args: argparse.Namespace, output: str, matters: bool) -> None:
    """Raises SceneError for a rate that nothing depends on."""
    from ..sequence import FILM

    if args.fps is not None and not matters:
        raise SceneError(f"{output}: --fps is for films: {FILM}")


def _check_film(output: str, film: bool, base: Settings, settings: dict[str, Any]) -> None:
    """Makes the size of a film's pictures even where the user does not say it.

    Raises SceneError for pictures that no film can be made of, before there are any.
    """
    from ..renderer import merged
    from ..sequence import check_film_size

    if film:
        known = {f.name for f in fields(base)}
        wanted = merged(base, {k: v for k, v in settings.items() if k in known})
        if wanted.crop is None:
            for name in ("width", "height"):
                own = getattr(wanted, name)
                settings[name] = own + own % 2 if settings[name] is None else own
            wanted = merged(wanted, {name: settings[name] for name in ("width", "height")})
        size = wanted.crop[2:] if wanted.crop else (wanted.width, wanted.height)
        check_film_size(output, *size)


class _Watch:
    """A progress function for one or more pictures: shows a bar, and stops at a signal.

    count: of pictures in all. done: how many of them there are.
    """

    def __init__(self) -> None:
        self.count, self.done = 1, 0
        self._samples = self._rays = 0
        self._seconds = 0.0
        self._report: ProgressCallback | None = None
        self._stop: list[int] = []

    def __call__(self, state: Progress) -> bool:
        if self._report is not None:
            self._report(
                replace(
                    state,
                    samples=self._samples + state.samples,
                    total_samples=self.count * state.total_samples,
                    rays=self._rays + state.rays,
                    seconds=self._seconds + state.seconds,
                )
            )
        return bool(self._stop)

    def add(self, image: Image) -> None:
        """Counts a picture that is there."""
        self.done += 1
        self._samples += image.stats.samples
        self._rays += image.stats.rays
        self._seconds += image.stats.seconds

    @contextmanager
    def watching(self, quiet: bool) -> Iterator[None]:
        """Shows a bar and minds signals in the block."""
        with ExitStack() as stack:
            self._stop = stack.enter_context(_interrupts())
            if not quiet:
                from ..progress import bar

                self._report = stack.enter_context(bar())
            yield


def _stem(scene: str | None) -> str:
    """The scene's name without its ending, and without that of a compressed file."""
    if scene is None:
        return "weekend"
    from ..io import COMPRESSED

    name = Path(scene)
    return Path(name.stem).stem if name.suffix.lower() in COMPRESSED else name.stem


def _summary(image: Image) -> str:
    from ..progress import si

    stats, (height, width) = image.stats, image.pixels.shape[:2]
    seconds = max(stats.seconds, 1e-6)
    return (
        f"{width}x{height}, {image.settings.spp} spp in {stats.seconds:.2f} s"
        f" ({si(stats.samples / seconds)}samples/s, {si(stats.rays / seconds)}rays/s,"
        f" {stats.threads} thread{'s' * (stats.threads != 1)}, {stats.isa})"
    )


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """A list that is no longer empty once SIGINT or SIGTERM has come; a second one ends at once."""
    stop: list[int] = []

    def note(number: int, _frame: Any) -> None:
        stop.append(number)
        if len(stop) > 1:
            raise KeyboardInterrupt

    old = {s: signal.signal(s, note) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _color(text: str) -> tuple[float, float, float]:
    """Linear RGB of a colour as the web and Matplotlib write it."""
    from matplotlib.colors import to_rgb

    from ..particles import linear

    try:
        red, green, blue = linear(to_rgb(text)).tolist()
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: a colour is needed, such as white or #rrggbb"
        ) from None
    return red, green, blue


def _crop(text: str) -> tuple[int, int, int, int]:
    try:
        x, y, w, h = (int(v) for v in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: four whole numbers X,Y,W,H are needed"
        ) from None
    return x, y, w, h
