"""`parhelion render`: a picture from a scene."""

from __future__ import annotations

import argparse
import logging
import math
import os
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import memory
from ..errors import ResourceError, SceneError, option
from . import options
from .watch import Watch

if TYPE_CHECKING:
    from ..image import Image
    from ..io.frames import Frames
    from ..scene import Scene

log = logging.getLogger("parhelion")


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
        help=".png, .jpg (sRGB) or .exr (linear); of a sequence also .mp4, and #### or %%04d where"
        " the number stands; default: the scene's name and .png",
    )
    p.add_argument("--bits", type=int, help="a channel: 8 or 16 for .png, 16 or 32 for .exr")
    options.add_exr(p)
    p.add_argument(
        "--features",
        action="store_true",
        help="also depth, position, normals, albedo, Cryptomattes and so on, as layers of the"
        " .exr file",
    )
    p.add_argument(
        "--denoise",
        action="store_true",
        help="take out the noise; what was rendered stays as a layer of the .exr file, or beside"
        " it as NAME.noisy.png",
    )
    p.add_argument(
        "--legend",
        action="store_true",
        help="what colours stand for, at the right side of the picture, which becomes wider",
    )
    add_picture(p)
    _add_work(p)


def add_picture(p: argparse.ArgumentParser) -> None:
    """What a picture is like, beside its scene: the fields of Settings."""
    picture = p.add_argument_group("picture (default: what the scene says)")
    picture.add_argument("--width", type=int, metavar="N")
    picture.add_argument("--height", type=int, metavar="N")
    picture.add_argument("--spp", "--samples", type=int, metavar="N", help="samples per pixel")
    picture.add_argument(
        "--noise",
        type=float,
        metavar="EPS",
        help="go on until the pixels are within this share of what endlessly many samples would"
        " show, with 95 %% confidence: 0.05, say; --spp is then the most",
    )
    picture.add_argument(
        "--clamp-indirect",
        type=float,
        metavar="RADIANCE",
        help="the most that light brings to a sample after more than one scattering: fewer bright"
        " specks, and a picture that is darker than the truth (biased); default: any",
    )
    picture.add_argument(
        "--reuse-paths",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="pixels use the light that paths of others close by have found beyond what is seen:"
        " much less noise in rooms and halls, for more time a sample; default: where that pays",
    )
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


def _add_work(p: argparse.ArgumentParser) -> None:
    """What is made of the scene, and how."""
    long = p.add_argument_group("long renderings")
    long.add_argument(
        "--time-limit",
        type=seconds,
        metavar="TIME",
        help="stop after so many seconds, or 90s, 15m, 2h, since the command began; of a sequence,"
        " since each picture began",
    )
    long.add_argument(
        "--checkpoint",
        metavar="FILE",
        nargs="?",
        const="",
        help="a file that --resume goes on from; default: the output's name and .checkpoint",
    )
    long.add_argument(
        "--checkpoint-every",
        type=seconds,
        metavar="TIME",
        help="default: 30s",
    )
    long.add_argument(
        "--resume",
        action="store_true",
        help="go on from the checkpoint, if it is there; also with a larger --spp, less --noise or"
        " more time than before",
    )
    long.add_argument(
        "--shard",
        type=_shard,
        metavar="I/N",
        help="only the I-th of N parts of the picture, which as many machines make that know"
        " nothing of each other: a file NAME.part, which --resume goes on from and `parhelion"
        " merge` takes; of a sequence, every N-th picture, from the I-th on",
    )
    options.add_display(p)
    sequence = p.add_argument_group("sequences of pictures")
    sequence.add_argument(
        "--turntable",
        type=int,
        metavar="N",
        help="N pictures, the camera going once around: NAME.0001.png and so on, or a film",
    )
    sequence.add_argument(
        "--frames",
        metavar="A..B..STEP",
        help="a picture of each of these frames, both ends included, whose numbers the files have;"
        " or as in Python's slices (all, 100:, ::10, =-5: for the last five), with files counted"
        " from 1; of a trajectory counted from 0, of USD time codes, of glTF seconds",
    )
    sequence.add_argument(
        "--skip-existing",
        action="store_true",
        help="make only pictures that are not there yet, or not whole, or of other options",
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
    work.add_argument(
        "--memory-limit",
        metavar="SIZE",
        help="bytes, or 4G, 500M: what would take more is an error; default: what there is",
    )
    work.add_argument(
        "--cluster",
        metavar="WHERE",
        help="who renders: local:N, as many processes; the address of a scheduler of"
        " dask.distributed, such as tcp://HOST:8786; or slurm:FILE, jobs as a file says; --threads"
        " are those of each worker then",
    )
    work.add_argument("--tree", default="bvh", help="bvh, or none to test every primitive")
    work.add_argument("--schedule", default="dynamic", help="OpenMP's: dynamic, static or guided")
    work.add_argument("--tile", type=int, default=16, metavar="PIXELS")
    options.add_logging(p)
    p.set_defaults(run=run, default_of=p.get_default)


def run(args: argparse.Namespace) -> int:
    """Renders and writes; 130 if it was stopped."""
    from ..display import Display

    begun = time.perf_counter()
    output = args.output if args.output is not None else f"{_stem(args.scene)}.png"
    names = (
        "width",
        "height",
        "spp",
        "noise",
        "clamp_indirect",
        "reuse_paths",
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
        if args.ground is None and args.scene is not None:
            args.ground = False  # it would cover most of what was asked for
        if not output.lower().endswith(".exr"):  # the colour is to be seen as it was named
            settings["backdrop"] = Display(**options.display(args)).before(args.backdrop)
    if args.denoise:
        from ..denoise import check_denoiser

        check_denoiser()
        settings["features"] = True  # albedo and normals guide it
    with memory.limited(args.memory_limit), ExitStack() as stack:
        settings["cluster"] = args.cluster
        if args.turntable is not None or args.frames is not None:
            from . import sequences

            if args.cluster is not None:  # one for all pictures
                from ..cluster.places import opened

                settings["cluster"] = stack.enter_context(opened(args.cluster, args.threads))
            return sequences.run(args, output, settings)
        if args.shard is not None:
            return _part(args, settings, begun)
        return _picture(args, output, settings, begun)


# Bytes a second that a disk takes of checkpoints, with its cache written out: a slow one.
_CHECKPOINT_RATE = 3e8

CHECKPOINT = ("checkpoint", "checkpoint_every", "resume")


def _picture(args: argparse.Namespace, output: str, settings: dict[str, Any], begun: float) -> int:
    from ..image import check_output
    from ..renderer import merged, prepare, render

    for flag, given in (("--fps", args.fps is not None), ("--skip-existing", args.skip_existing)):
        if given:
            raise SceneError(f"{flag} needs a sequence of pictures: --turntable or --frames")
    how = options.saving(args)
    check_output(output, args.bits, args.features, args.legend, **how)
    file = Path(output)
    beside = file.with_name(f"{file.stem}.noisy{file.suffix}")
    if args.denoise:
        check_output(beside, args.bits, args.features, args.legend, **how)
    with options.naming(args):
        scene = prepare(options.load_scene(args))
        check_legend(args, scene.scene)
    if args.checkpoint is not None or args.resume:
        args.checkpoint = args.checkpoint or f"{output}.checkpoint"
        for written in (file, beside):
            if os.path.realpath(args.checkpoint) == os.path.realpath(written):
                raise SceneError(
                    f"--checkpoint {args.checkpoint}: is what the picture is written to"
                )
        given = {name: getattr(args, name) for name in CHECKPOINT}
        settings |= {name: value for name, value in given.items() if value is not None}
    elif args.checkpoint_every is not None:
        raise SceneError("--checkpoint-every needs --checkpoint")
    size = merged(scene.scene.settings, {k: settings[k] for k in ("width", "height", "crop")}).size
    if args.time_limit is not None:
        settings["time_limit"] = rendering_seconds(args, output, size, begun)
    if args.denoise:
        from ..denoise import check_memory
        from ..renderer import FEATURE_BYTES, PIXEL_BYTES

        check_memory(*size, (PIXEL_BYTES + FEATURE_BYTES) * size[0] * size[1])
    watch = Watch()
    problem: ResourceError | None = None
    # The camera can only be the file's own.
    with options.naming(args, "camera:"), watch.watching(args.quiet):
        image = clean = render(scene, progress=watch, **settings)
        if watch.stopped and not image.stats.samples and not image.counts.any():
            print(f"parhelion: stopped before the first sample; no {output}", file=sys.stderr)
            return 130
        if watch.stopped and args.features:  # packing all layers of 1920x1080 takes three seconds
            replace(image, features={}).save(output, bits=args.bits, **how)
            if not args.quiet:
                print(f"parhelion: {output} is there, its layers follow", file=sys.stderr)
        try:
            clean = finished(args, image, watch)
        except ResourceError as refused:  # the picture is there, and is not to be lost
            problem = refused
        if "noisy" in clean.features and file.suffix.lower() != ".exr":
            image.save(beside, bits=args.bits, legend=args.legend, **how)
        clean.save(output, bits=args.bits, legend=args.legend, **how)
    if problem is not None:
        raise ResourceError(f"{problem}; {output} was written with its noise") from problem
    if is_finished(args, clean):
        if not args.quiet:
            print(f"{output}: {_summary(image)}", file=sys.stderr)
        return 0
    if image.stats.ended == "failed":
        print(f"parhelion: {output} has {image.told_spp()}: a part failed", file=sys.stderr)
        return 1
    hint = "--checkpoint FILE would let it go on another time"
    if args.checkpoint is not None and os.path.exists(args.checkpoint):
        hint = f"the same command with --resume goes on from {args.checkpoint}"
    error = "" if image.stats.error is None else f", error {100 * image.stats.error:.2g} %"
    noise = " and is not denoised" if image.stats.complete else ""
    has = f"{output} has {image.told_spp()}{error}{noise}"
    print(f"parhelion: stopped; {has}; {hint}", file=sys.stderr)
    return 130


# What is decided when there is a whole picture
_OF_PICTURES = ("bits", "compression", "tiled", "exposure", "view_transform", "white_balance")


def _part(args: argparse.Namespace, settings: dict[str, Any], begun: float) -> int:
    """Renders a shard of a picture to a file for `parhelion merge`."""
    from ..renderer import prepare, render
    from ..shards import ENDING

    index, count = args.shard
    output = args.output or f"{_stem(args.scene)}.{index}-of-{count}{ENDING}"
    if not output.lower().endswith(ENDING):
        raise SceneError(
            f"{output}: {option('shard')} makes a file {ENDING}, of which `parhelion merge` makes"
            " the picture"
        )
    for name in ("fps", "skip_existing", "checkpoint"):
        if getattr(args, name) != args.default_of(name):
            raise SceneError(f"{option(name)} is not for a shard, whose file is its checkpoint")
    for name in ("denoise", "legend", *_OF_PICTURES):
        if getattr(args, name) != args.default_of(name):
            then = "image" if name == "denoise" else "merge"
            raise SceneError(f"{option(name)} is for whole pictures; give it to `parhelion {then}`")
    if args.checkpoint_every is not None:
        settings["checkpoint_every"] = args.checkpoint_every
    if args.time_limit is not None:
        settings["time_limit"] = rendering_seconds(args, output, (0, 0), begun)
    watch = Watch()
    with options.naming(args):
        scene = prepare(options.load_scene(args))
    with options.naming(args, "camera:"), watch.watching(args.quiet):
        image = render(
            scene,
            progress=watch,
            shard=args.shard,
            checkpoint=output,
            resume=args.resume,
            **settings,
        )
    if image.stats.ended == "failed":
        print(f"parhelion: {output} has {image.told_spp()}: a part failed", file=sys.stderr)
        return 1
    own = image.counts[image.counts > 0]
    least = int(own.min()) if own.size else 0
    if image.stats.ended == "spp":
        if not args.quiet:
            print(f"{output}: shard {index}/{count}, {_took(image)}", file=sys.stderr)
        return 0
    print(
        f"parhelion: stopped; {output} has {least} of {image.settings.spp} spp; the same command"
        " with --resume goes on from it",
        file=sys.stderr,
    )
    return 130


def rendering_seconds(
    args: argparse.Namespace, output: str, size: tuple[int, int], begun: float
) -> float:
    """What is left of --time-limit for rendering: the rest is for denoising, for writing and for
    the last checkpoint.

    size: of the picture. begun: when the time began. The rest gets no more than half of what is
    left, with a warning, as a picture of no samples is worth nothing.
    """
    from ..image import WRITABLE, seconds_to_encode

    pixels, needed = size[0] * size[1], 0.0
    if Path(output).suffix.lower() in WRITABLE:
        needed += seconds_to_encode(output, args.features, pixels)
    if args.denoise:
        from ..denoise import seconds_for

        needed += seconds_for(pixels)
    if args.checkpoint is not None or args.resume:
        each = 560 if args.features or args.denoise else 80  # bytes of a pixel in a checkpoint
        needed += pixels * each / _CHECKPOINT_RATE
    left: float = args.time_limit - (time.perf_counter() - begun)
    if needed > 0.5 * left:
        log.warning(
            "what follows on rendering takes some %.0f s, and %.0f s are left; the picture will be"
            " late",
            needed,
            max(left, 0.0),
        )
        needed = 0.5 * left
    return max(left - needed, 1e-3)  # loading took it all; 0 would be a mistake


def finished(args: argparse.Namespace, image: Image, watch: Watch) -> Image:
    """The picture as it is to be written; one that was stopped, at once and as it is."""
    from ..denoise import without_guides

    if not args.denoise:
        return image
    if image.stats.complete:
        image = image.denoised(progress=lambda _: watch.stopped)
    if not args.features:
        image = replace(image, features=without_guides(image.features))
    return image


def is_finished(args: argparse.Namespace, image: Image) -> bool:
    """Whether finished() has done all that was asked for."""
    return image.stats.complete and (not args.denoise or "noisy" in image.features)


def check_legend(args: argparse.Namespace, scene: Scene | Frames) -> None:
    """Raises SceneError for a legend that there is not, before there is a picture."""
    from ..image import checked_legend

    if args.legend:
        checked_legend(scene.legend)


def _stem(scene: str | None) -> str:
    """The scene's name without its ending, and without that of a compressed file."""
    if scene is None:
        return "weekend"
    from ..io import COMPRESSED

    name = Path(scene)
    return Path(name.stem).stem if name.suffix.lower() in COMPRESSED else name.stem


def _summary(image: Image) -> str:
    stats, (height, width) = image.stats, image.pixels.shape[:2]
    error = "" if stats.error is None else f", error {100 * stats.error:.2g} %"
    return f"{width}x{height}, {image.told_spp()}{error} in {_took(image)}"


def _took(image: Image) -> str:
    from ..progress import si

    stats = image.stats
    seconds = max(stats.seconds, 1e-6)
    return (
        f"{stats.seconds:.2f} s"
        f" ({si(stats.samples / seconds)}samples/s, {si(stats.rays / seconds)}rays/s,"
        f" {stats.threads} thread{'s' * (stats.threads != 1)}, {stats.isa})"
    )


def seconds(text: str) -> float:
    """Seconds of 90, 90s, 1.5m or 2h."""
    unit = {"s": 1.0, "m": 60.0, "h": 3600.0}.get(text[-1:])
    try:
        number = float(text if unit is None else text[:-1]) * (unit or 1.0)
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}: a time such as 90, 90s, 15m or 2h is needed")
    return number


def _shard(text: str) -> tuple[int, int]:
    index, slash, count = text.partition("/")
    try:
        if slash:
            return int(index), int(count)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r}: I/N is needed, such as 1/4 for the first of four")


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
