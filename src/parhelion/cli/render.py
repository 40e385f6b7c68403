"""`parhelion render`: a picture from a scene."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import options

if TYPE_CHECKING:
    from ..image import Image
    from ..progress import Progress


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
        help=".png, .jpg (sRGB) or .exr (linear); default: the scene's name and .png",
    )
    p.add_argument("--bits", type=int, help="a channel: 8 or 16 for .png, 16 or 32 for .exr")
    p.add_argument(
        "--features",
        action="store_true",
        help="also depth, position, normals, albedo, Cryptomattes and so on, as layers of the"
        " .exr file",
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
    from ..image import check_output
    from ..renderer import prepare, render

    output = args.output if args.output is not None else f"{_stem(args.scene)}.png"
    check_output(output, args.bits, args.features)
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
    )
    settings = {name: getattr(args, name) for name in names}
    with options.naming(args):
        scene = prepare(options.load_scene(args))
    # The camera can only be the file's own.
    with options.naming(args, "camera:"), ExitStack() as stack:
        stop = stack.enter_context(_interrupts())
        report = None
        if not args.quiet:
            from ..progress import bar

            report = stack.enter_context(bar())

        def progress(state: Progress) -> bool:
            if report is not None:
                report(state)
            return bool(stop)

        image = render(
            scene,
            threads=args.threads,
            tree=args.tree,
            schedule=args.schedule,
            tile=args.tile,
            progress=progress,
            features=args.features,
            **settings,
        )
        image.save(output, bits=args.bits)
    if image.stats.complete:
        if not args.quiet:
            print(f"{output}: {_summary(image)}", file=sys.stderr)
        return 0
    wanted = image.settings.spp
    least, most = int(image.counts.min()), int(image.counts.max())
    got = f"{most}" if least == most else f"{least} to {most}"
    print(f"parhelion: stopped; {output} has {got} of {wanted} samples per pixel", file=sys.stderr)
    return 130


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
