"""Options that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..display import WhiteBalance
    from ..io import LoadOptions
    from ..scene import Scene


def add_loading(parser: argparse.ArgumentParser, required: bool = False) -> None:
    """What a file is and how its particles should look. required: there is no built-in one."""
    if required:
        parser.add_argument("scene", metavar="IN", help="scene or particle file")
    else:
        parser.add_argument(
            "scene",
            nargs="?",
            metavar="SCENE",
            help="scene or particle file; without one, the built-in scene `weekend`",
        )
    group = parser.add_argument_group("scene files")
    group.add_argument(
        "-D",
        dest="defines",
        type=_define,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="the value of a parameter of a Mitsuba scene; may be given again",
    )
    group.add_argument(
        "--strict",
        action="store_true",
        help="what a scene asks for and is not supported is an error, not a warning",
    )
    group.add_argument(
        "--allow-path",
        dest="allow_paths",
        action="append",
        default=[],
        metavar="DIR",
        help="a folder, besides the scene's own, that its files may lie in; may be given again",
    )
    group.add_argument(
        "--time", type=float, metavar="SECONDS", help="of a scene's animations; else its rest pose"
    )
    group.add_argument(
        "--variant",
        metavar="NAME",
        help="which of a glTF scene's sets of materials it has; of a USD stage SET=NAME,...",
    )
    group.add_argument(
        "--camera",
        metavar="NAME",
        help="of a glTF or USD file's cameras this one; of USD a path too; `info` lists them",
    )
    group = parser.add_argument_group("view and light")
    group.add_argument(
        "--view",
        metavar="NAME",
        help="instead of the file's camera: front, back, left, right, top, bottom, iso or default",
    )
    group.add_argument(
        "--up", metavar="AXIS", help="of a file that does not say: x, y, z, -x, -y or -z"
    )
    group.add_argument(
        "--environment", metavar="FILE", help="a panorama, instead of the file's background"
    )
    group.add_argument(
        "--ground",
        action=argparse.BooleanOptionalAction,
        help="a ground for shadows to fall on, or none; default: below meshes and scenes that bring"
        " no light, without --background",
    )
    group = parser.add_argument_group("particle files")
    group.add_argument("--color-by", metavar="FIELD", help="colour by this field of the particles")
    group.add_argument("--colormap", default="viridis", metavar="NAME", help="a Matplotlib name")
    group.add_argument(
        "--color-range",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        help="values at the ends of the map; default: the 1st and 99th percentile",
    )
    group.add_argument(
        "--radius", type=_radius, metavar="R", help="of all particles: a number, vdw or covalent"
    )
    group.add_argument(
        "--style",
        default="spheres",
        metavar="STYLE",
        help="spheres, or with bonds: ball-and-stick or licorice",
    )
    group.add_argument(
        "--bond-length",
        type=float,
        metavar="L",
        help="particles nearer to each other are bonded; default: the file's bonds, or by element",
    )
    group.add_argument("--box", action="store_true", help="draw the simulation box")
    group.add_argument(
        "--wrap", action="store_true", help="move particles into the box, where it is periodic"
    )
    group.add_argument(
        "--assembly",
        type=int,
        metavar="N",
        help="of a PDB file: the biological assembly of this number, not the atoms as they are",
    )
    group.add_argument(
        "--frame",
        type=float,
        default=0,
        metavar="K",
        help="of a trajectory, from 0; negative counts from the end; of USD, the time code",
    )


def add_display(parser: argparse.ArgumentParser, *more: str) -> None:
    """How light is shown on a screen. more: other flags for the view transform."""
    group = parser.add_argument_group("how it is shown (.exr files keep the linear values)")
    group.add_argument(
        "--exposure",
        type=float,
        metavar="EV",
        help="stops brighter, or darker if negative",
    )
    group.add_argument(
        "--view-transform",
        *more,
        metavar="NAME",
        help="srgb cuts at white; agx, aces and aces-1.3 go towards it gently; default: srgb",
    )
    group.add_argument(
        "--white-balance",
        type=_white_balance,
        metavar="WHITE",
        help="what light shall look white: its colour temperature in kelvin, or CIE x,y",
    )


def add_exr(parser: argparse.ArgumentParser) -> None:
    """How .exr files are written."""
    parser.add_argument(
        "--compression",
        metavar="NAME",
        help="of .exr: zip (default), zips, piz, rle, none; inexact: b44, b44a, pxr24, dwaa, dwab",
    )
    parser.add_argument(
        "--tiled", action="store_true", default=None, help=".exr in tiles of 64x64, not in rows"
    )


def display(args: argparse.Namespace) -> dict[str, Any]:
    """What add_display() was given, as Display takes it."""
    return _given(args, "exposure", "view_transform", "white_balance")


def saving(args: argparse.Namespace) -> dict[str, Any]:
    """The same with add_exr(), as Image.save() takes it."""
    return display(args) | _given(args, "compression", "tiled")


def _given(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    found = {name: getattr(args, name) for name in names}
    return {name: value for name, value in found.items() if value is not None}


def add_logging(parser: argparse.ArgumentParser) -> None:
    """How much is said."""
    parser.add_argument("--quiet", "-q", action="store_true", help="say nothing but errors")
    parser.add_argument(
        "--log-level", default="warning", choices=["debug", "info", "warning", "error"]
    )


def load_options(args: argparse.Namespace) -> LoadOptions:
    """The loader's share of the arguments."""
    from ..io import LoadOptions

    return LoadOptions(
        color_by=args.color_by,
        colormap=args.colormap,
        color_range=tuple(args.color_range) if args.color_range else None,
        radius=args.radius,
        ground=args.ground,
        frame=args.frame,
        style=args.style,
        bond_length=args.bond_length,
        box=args.box,
        wrap=args.wrap,
        assembly=args.assembly,
        defines=dict(args.defines),
        strict=args.strict,
        allow_paths=tuple(args.allow_paths),
        view=args.view,
        up=args.up,
        environment=args.environment,
        time=args.time,
        variant=args.variant,
        camera=args.camera,
    )


def load_scene(args: argparse.Namespace) -> Scene:
    """The scene that the arguments name."""
    from ..io import check_options, load

    read_as = load_options(args)
    if args.scene is None:
        from ..builtin import weekend

        check_options(read_as, None, "the built-in scene, but for files")
        return weekend()
    return load(args.scene, read_as)


@contextmanager
def naming(args: argparse.Namespace, start: str = "") -> Iterator[None]:
    """Errors about the scene begin with its file; only those that begin with `start`, if given."""
    from ..errors import SceneError

    try:
        yield
    except SceneError as error:
        text = str(error)
        if args.scene is None or not text.startswith(start) or text.startswith(str(args.scene)):
            raise
        raise SceneError(f"{args.scene}: {text}") from error


def _define(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not name or not equals:
        raise argparse.ArgumentTypeError(f"{text!r}: NAME=VALUE is needed")
    return name, value


def _white_balance(text: str) -> WhiteBalance:
    from ..display import parsed_white_balance
    from ..errors import SceneError, spelled

    try:
        with spelled({"white_balance": "it"}):
            return parsed_white_balance(text)
    except SceneError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _radius(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        if text in ("vdw", "covalent"):
            return text
        raise argparse.ArgumentTypeError(f"{text!r}: a number, vdw or covalent is needed") from None
