"""`parhelion rerender`: a picture made again from what its file says, and compared with it."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from . import options
from .watch import Watch

if TYPE_CHECKING:
    from ..image import Image
    from ..provenance import Record


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "rerender",
        help="make a picture again, and compare",
        description="Makes a picture again from what its file says of scene, camera, settings and"
        " samples, and tells whether it is the same to the last bit.",
    )
    p.add_argument("picture", metavar="FILE", help=".exr, .png or .jpg that Parhelion made")
    p.add_argument("-o", "--output", metavar="OUT", help="write it, too")
    p.add_argument(
        "--scene", metavar="SCENE", help="where the scene is now, read as it was; default: as then"
    )
    p.add_argument("-t", "--threads", type=int, default=0, metavar="N", help="default: all cores")
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """0 if all pixels are the same, 1 if not, 130 if it was stopped."""
    from dataclasses import replace

    from ..atomic import check_apart
    from ..image import check_output
    from ..provenance import record, remade
    from ..scene import Source

    made = record(args.picture)
    if args.output is not None:
        check_output(args.output, **made.for_file(args.output))
        check_apart(args.output, args.picture)
    if args.scene is not None:
        was = made.source
        if was is None or was.path is None:
            was = Source(None)
        made = replace(made, source=replace(was, path=args.scene))
    watch = Watch()
    with watch.watching(args.quiet):
        image = remade(made, threads=args.threads, progress=watch)
    if not image.stats.complete or (made.denoised and "noisy" not in image.features):
        print("parhelion: stopped", file=sys.stderr)
        return 130
    if args.output is not None:
        image.save(args.output, **made.for_file(args.output))
    different = _different(image, made)
    if different:
        print(f"{args.picture}: {different} pixels differ", file=sys.stderr)
        return 1
    if not args.quiet:
        height, width = image.counts.shape
        print(f"{args.picture}: the same, {width}x{height}, {image.told_spp()}", file=sys.stderr)
    return 0


def _different(image: Image, made: Record) -> int:
    """How many pixels of its file are not as they are in the one that the picture is now."""
    import numpy as np

    from ..layers import PictureFile

    with tempfile.TemporaryDirectory() as folder:
        again = Path(folder) / f"again{made.path.suffix}"
        image.save(again, **made.for_file(again))
        old, new = (PictureFile(path) for path in (made.path, again))
        a, b = (file.read(file.layer()) for file in (old, new))
    if a.shape != b.shape:
        return int(max(a.shape[0] * a.shape[1], b.shape[0] * b.shape[1]))
    return int((a.view(np.uint32) != b.view(np.uint32)).any(axis=2).sum())
