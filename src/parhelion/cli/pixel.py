"""`parhelion pixel`: one sample's path, vertex by vertex."""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from pathlib import Path

from . import options
from .render import add_picture


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "pixel",
        help="show one sample's path through a scene",
        description="Follows one sample of a pixel, and prints where its path goes, which lights"
        " it asks and what each vertex adds, up to the radiance that the picture gets. SCENE may"
        " be weekend, the built-in one. Give the options that the picture was rendered with.",
    )
    options.add_loading(p, required=True)
    p.add_argument("x", type=int, metavar="X", help="pixels from the left of the whole picture")
    p.add_argument("y", type=int, metavar="Y", help="pixels from its top")
    p.add_argument(
        "sample", type=int, nargs="?", default=0, metavar="SAMPLE", help="its number; default: 0"
    )
    p.add_argument("--json", action="store_true", help="for programs")
    add_picture(p)
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints to stdout."""
    from ..pixel import trace_pixel
    from ..scene import Settings

    if args.scene == "weekend" and not Path(args.scene).exists():
        args.scene = None
    settings = {f.name: getattr(args, f.name, None) for f in fields(Settings)}
    with options.naming(args):
        scene = options.load_scene(args)
        path = trace_pixel(scene, args.x, args.y, args.sample, **settings)
    print(json.dumps(path.as_dict(), indent=1) if args.json else path)
    return 0
