"""`parhelion compare`: how far a picture is from another."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SceneError, plain, unknown_name
from . import options

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..comparison import Comparison

# A picture is beyond a limit that was given
EXIT_BEYOND = 1


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "compare",
        help="how far a picture is from another",
        description="Compares a picture with a reference: errors in light and in what is seen."
        " Ends with 1 if a measure is beyond a limit that was given, else with 0.",
    )
    p.add_argument("picture", metavar="A", help="picture: .exr, .png, .jpg, .hdr, .tif ...")
    p.add_argument("reference", metavar="B", help="what it should be")
    p.add_argument(
        "--variance",
        nargs=2,
        metavar=("FILE_A", "FILE_B"),
        help="variances of the means in all pixels, for a z-test; default: the layers `variance`",
    )
    p.add_argument(
        "--exposure",
        type=float,
        default=0.0,
        metavar="EV",
        help="stops brighter, for what is seen: PSNR, SSIM and pictures",
    )
    for word in ("above", "below"):
        p.add_argument(
            f"--fail-{word}",
            type=_limit,
            action="append",
            default=[],
            metavar="MEASURE=VALUE",
            help=f"end with 1 if it is {word}; may be given again",
        )
    p.add_argument("--html", metavar="FILE", help="a page with numbers and pictures")
    p.add_argument(
        "--difference",
        metavar="FILE",
        help=".png or .jpg: both, five times their difference around grey, and the FLIP map",
    )
    p.add_argument("--json", action="store_true", help="numbers for programs")
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints to stdout; 1 if a limit is exceeded."""
    from ..atomic import check_apart
    from ..comparison import compare, limits_exceeded
    from ..comparison_report import MEASURES
    from ..image import check_output, check_place

    above, below = dict(args.fail_above), dict(args.fail_below)
    for name in (*above, *below):
        if name not in MEASURES:
            raise SceneError(unknown_name("measure", name, MEASURES))
    for output in filter(None, (args.html, args.difference)):
        check_apart(output, args.picture, args.reference, *(args.variance or ()))
    if args.html is not None:
        check_place(Path(args.html))
    if args.difference is not None:
        if Path(args.difference).suffix.lower() == ".exr":
            raise SceneError(f"{args.difference}: .png or .jpg is needed")
        check_output(args.difference)
    variances = None
    if args.variance is not None:
        variances = _variance(args.variance[0]), _variance(args.variance[1])
    found = compare(args.picture, args.reference, variances=variances, exposure=args.exposure)
    if found.test is None and "p" in (*above, *below):
        raise SceneError(
            "p is that of the z-test, which needs variances: --variance, or layers of both pictures"
        )
    if args.html is not None:
        from ..atomic import replacing

        with replacing(Path(args.html)) as temporary:
            text = found.html((args.picture, args.reference))
            temporary.write_text(text, encoding="utf-8", errors="replace")
    if args.difference is not None:
        _write(Path(args.difference), found.side_by_side())
    numbers = found.numbers()
    beyond = limits_exceeded(numbers, above, below)
    if args.json:
        finite = {k: v if math.isfinite(v) else None for k, v in numbers.items()}
        print(json.dumps({**finite, "ratio": found.ratio, "beyond": beyond}, indent=1))
    elif not args.quiet:
        print(_text(args, found))
    for sentence in beyond:
        print(f"parhelion: {args.picture}: {sentence}", file=sys.stderr)
    return EXIT_BEYOND if beyond else 0


def _text(args: argparse.Namespace, found: Comparison) -> str:
    from ..comparison_report import MEASURES, number

    height, width = found.flip_map.shape
    lines = [f"{args.picture} against {args.reference}, {width}x{height}"]
    for name, value in found.numbers().items():
        lines.append(f"  {name:15}{number(value):>12}  {MEASURES[name][1]}")
    ratio = " ".join(f"{r:.4f}" for r in found.ratio)
    lines.append(f"  means, R G B, over the reference's: {ratio}")
    if found.test is not None:
        word = "no difference but noise" if found.test.agrees else "they differ"
        lines.append(f"  z-test at 1 %: {word}; {found.test}")
    return plain("\n".join(lines))


def _variance(path: str) -> NDArray[Any]:
    from ..layers import PictureFile

    file = PictureFile(path)
    layer = file.layer()
    if layer.kinds[0] in ("uint8", "uint16"):
        raise SceneError(f"{path}: whole numbers cannot be variances")
    return file.read(layer)[..., :3]


def _write(path: Path, pixels: NDArray[Any]) -> None:
    from ..atomic import replacing
    from ..image import encoded

    with replacing(path) as temporary:
        temporary.write_bytes(encoded(pixels, {}, path.suffix.lower()))


def _limit(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    try:
        if equals:
            limit = float(value)
            if not math.isnan(limit):
                return name.lower(), limit
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r}: MEASURE=VALUE is needed, such as flip=0.05")
