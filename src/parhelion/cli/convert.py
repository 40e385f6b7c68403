"""`parhelion convert`: a scene in another format."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from . import options


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "convert",
        help="write a scene in another format",
        description="Reads a scene or particle file and writes it in the format that the ending of"
        " OUT names. What that cannot hold is told; with --strict it is an error.",
    )
    options.add_loading(p, required=True)
    p.add_argument("output", metavar="OUT", help="the file to write")
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Loads and writes."""
    from ..atomic import check_apart
    from ..io import load
    from ..saving import check_writable, is_bare, save

    output = Path(args.output)
    ending = check_writable(output)
    check_apart(output, args.scene)
    start = time.perf_counter()
    # Formats whose files get a view and light when they are read need none written.
    scene = load(args.scene, options.load_options(args), studio=not is_bare(ending))
    with options.naming(args):
        save(scene, output, strict=args.strict)
    if not args.quiet:
        seconds = time.perf_counter() - start
        print(f"{output}: {len(scene.shapes):,} shapes in {seconds:.2f} s", file=sys.stderr)
    return 0
