"""`parhelion merge`: the picture whose shards were rendered apart from each other."""

from __future__ import annotations

import argparse
import sys

from .. import memory
from . import options


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "merge",
        help="make one picture of its shards",
        description="Makes the picture whose shards `parhelion render --shard I/N` has made: the"
        " same bits as of one machine. Names what is missing, and what is not of the same picture.",
    )
    p.add_argument("parts", metavar="PART", nargs="+", help=".part files, of all shards")
    p.add_argument(
        "-o", "--output", metavar="FILE", required=True, help=".png, .jpg (sRGB) or .exr (linear)"
    )
    p.add_argument("--bits", type=int, help="a channel: 8 or 16 for .png, 16 or 32 for .exr")
    options.add_exr(p)
    p.add_argument(
        "--legend",
        action="store_true",
        help="what colours stand for, at the right side of the picture, which becomes wider",
    )
    p.add_argument(
        "--memory-limit",
        metavar="SIZE",
        help="bytes, or 4G, 500M: what would take more is an error; default: what there is",
    )
    options.add_display(p)
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """0 if the picture was written."""
    from ..image import check_output
    from ..merging import merge

    how = options.saving(args)
    check_output(args.output, args.bits, False, args.legend, **how)
    with memory.limited(args.memory_limit):
        image = merge(args.parts)
        image.save(args.output, bits=args.bits, legend=args.legend, **how)
    if not args.quiet:
        height, width = image.counts.shape
        error = "" if image.stats.error is None else f", error {100 * image.stats.error:.2g} %"
        print(f"{args.output}: {width}x{height}, {image.told_spp()}{error}", file=sys.stderr)
    return 0
