"""`parhelion image`: a picture file as another one, or what is in it."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SceneError, option, plain
from . import options

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..layers import Layer, PictureFile

log = logging.getLogger("parhelion")

# Characters of a value of the metadata
_LONGEST = 100


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "image",
        help="convert a picture, or show what is in it",
        description="Converts a picture: an .exr file as others can show it, one of its layers, or"
        " with other compression.",
    )
    p.add_argument("input", metavar="IN", help="picture: .exr, .png, .jpg, .hdr, .tif ...")
    p.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        help=".png, .jpg or .exr; default: the name of IN and .png",
    )
    p.add_argument(
        "--layer", metavar="NAME", help="of an .exr file; --info lists them; default: the picture"
    )
    p.add_argument(
        "--range",
        dest="limits",
        nargs=2,
        type=float,
        metavar=("LOW", "HIGH"),
        help="of a layer of data: what is black and what is white; default: its least and most",
    )
    p.add_argument("--bits", type=int, help="a channel: 8 or 16 for .png, 16 or 32 for .exr")
    p.add_argument(
        "--denoise",
        action="store_true",
        help="take out the noise, guided by the layers albedo, shading_normal and coverage",
    )
    options.add_exr(p)
    options.add_display(p, "--view")
    form = p.add_mutually_exclusive_group()
    form.add_argument("--info", action="store_true", help="instead: layers and metadata")
    form.add_argument("--json", action="store_true", help="the same for programs")
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Converts, or prints to stdout."""
    from ..layers import PictureFile

    if args.denoise:
        from ..denoise import check_denoiser

        check_denoiser()
    if args.info or args.json:
        found = _contents(PictureFile(args.input))
        print(json.dumps(found, indent=1) if args.json else _text(found))
        return 0
    from ..atomic import check_apart
    from ..image import check_output

    default = f"{Path(args.input).stem}.png"
    output = Path(default if args.output is None else args.output)
    check_output(output, args.bits, **options.saving(args))
    file = PictureFile(args.input)
    check_apart(output, args.input)
    if output.suffix.lower() == ".exr":
        said = _linear(args, file, output)
    else:
        said = _seen(args, file, output)
    if not args.quiet:
        print(f"{output}: {file.width}x{file.height}, {said} of {args.input}", file=sys.stderr)
    return 0


def _seen(args: argparse.Namespace, file: PictureFile, output: Path) -> str:
    """Writes a picture for screens."""
    import numpy as np

    from ..atomic import replacing
    from ..display import Display, told_display
    from ..image import WRITABLE, encoded

    layer = file.layer(args.layer)
    ending = output.suffix.lower()
    bits = args.bits or WRITABLE[ending][0]
    told = _carried(args, file)
    if layer.is_light:
        if args.limits is not None:
            raise SceneError(f"{args.input}: layer {layer.name} is light, and --range is for data")
        shown = Display(**(told_display(told) | options.display(args)))
        light, alpha = _light(args, file, layer)
        if alpha is not None and ending != ".png":  # what has no alpha is on black
            light, alpha = light * alpha, None
        stored = shown.encode(light, bits)
        if alpha is not None:
            share = np.clip(np.nan_to_num(alpha), 0.0, 1.0) * (2**bits - 1) + 0.5
            stored = np.concatenate([stored, share.astype(stored.dtype)], axis=2)
        told |= shown.metadata()
        if args.denoise:
            told |= _denoised_by()
    else:
        given = options.display(args) | ({"denoise": True} if args.denoise else {})
        if given:
            name = option(next(iter(given)))
            raise SceneError(
                f"{args.input}: layer {layer.name} is data, not light, and {name} is for light"
            )
        stored = _data(file.read(layer), args.limits, bits)
    with replacing(output) as temporary:
        temporary.write_bytes(encoded(stored, told, ending))
    return f"layer {layer.name}"


def _data(
    values: NDArray[Any], limits: tuple[float, float] | list[float] | None, bits: int
) -> NDArray[Any]:
    """Numbers between the limits as code values; of more than three channels the first three."""
    import numpy as np

    if limits is None:
        finite = values[np.isfinite(values)]
        low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    else:
        low, high = limits
        if not (np.isfinite(low) and np.isfinite(high) and low != high):
            raise SceneError(f"--range is {low:g} {high:g}; must be two numbers that differ")
    if values.shape[2] == 2:
        values = np.concatenate([values, np.full_like(values[..., :1], low)], axis=2)
    seen = values[..., :3] if values.shape[2] > 1 else np.repeat(values, 3, axis=2)
    span = float(high) - float(low) or 1.0
    share = np.nan_to_num((seen.astype(np.float64) - float(low)) / span, nan=0.0)
    kind = np.uint8 if bits == 8 else np.uint16
    return np.asarray((np.clip(share, 0.0, 1.0) * (2**bits - 1) + 0.5).astype(kind))


def _linear(args: argparse.Namespace, file: PictureFile, output: Path) -> str:
    """Writes an .exr file: all layers, or one alone."""
    from ..atomic import replacing
    from ..display import Display, told_display
    from ..image import check_output
    from ..layers import exr_bytes, is_matte, kinds_of

    if args.limits is not None:
        raise SceneError(f"{output}: --range is for pictures of 8 and 16 bits; .exr has no limits")
    bits = args.bits or 32
    told = _carried(args, file)
    shown = Display(**(told_display(told) | options.display(args)))
    told |= {"oiio:ColorSpace": "lin_rec709_scene", **shown.metadata()}
    if args.denoise:
        told |= _denoised_by()
    if args.layer is None and not any(k in ("uint8", "uint16") for k in _kinds(file)):
        names, kinds, pixels = file.everything()
        ids = any(is_matte(name) for name in names)
        check_output(output, bits, ids, compression=args.compression)
        told |= {k: v for k, v in file.metadata.items() if k.startswith("cryptomatte/")}
        if args.denoise:
            names, kinds, pixels = _with_noisy(args, file, names, kinds, pixels)
        if args.bits is not None or not set(kinds) <= {"float", "half"}:
            kinds = kinds_of(names, bits)
        said = f"{len(file.layers)} layer{'s' * (len(file.layers) != 1)}"
    else:
        layer = file.layer(args.layer)
        if layer.is_light:
            pixels, alpha = _light(args, file, layer)
            names = list("RGB")
            if alpha is not None:
                import numpy as np

                pixels, names = np.concatenate([pixels * alpha, alpha], axis=2), list("RGBA")
        else:
            pixels, names = file.read(layer), list(layer.channels)
        kinds, said = kinds_of(names, bits), f"layer {layer.name}"
    data = exr_bytes(names, kinds, pixels, told, args.compression, bool(args.tiled))
    with replacing(output) as temporary:
        temporary.write_bytes(data)
    return said


def _denoised_by() -> dict[str, str]:
    from ..denoise import version

    return {"parhelion:denoised": version()}


def _light(
    args: argparse.Namespace, file: PictureFile, layer: Layer
) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """What file.light() returns, without noise if that is asked for."""
    from ..denoise import NOISY, denoised, guides_of, told
    from ..layers import MAIN

    if not args.denoise:
        return file.light(layer)
    noisy = file.layers.get(NOISY, layer) if layer.name == MAIN else layer
    light, alpha = file.light(noisy)
    found = {
        name: file.read(guide)
        for name, guide in file.layers.items()
        if (guide.width, guide.height) == (layer.width, layer.height)
        and name in ("albedo", "shading_normal", "coverage")
    }
    albedo, normal = guides_of(found)
    if albedo is None:
        log.warning("%s: has no features; nothing guides the denoising", file.path)
    return denoised(told(light, file.path), albedo, normal), alpha


def _with_noisy(
    args: argparse.Namespace,
    file: PictureFile,
    names: list[str],
    kinds: list[str],
    pixels: NDArray[Any],
) -> tuple[list[str], list[str], NDArray[Any]]:
    """All channels, the picture's without noise; what it was is a layer."""
    import numpy as np

    from ..denoise import NOISY

    layer = file.layer()
    if layer.channels != ("R", "G", "B"):
        raise SceneError(
            f"{file.path}: layer {layer.name} has channels {' '.join(layer.channels)}; of"
            " all layers only R G B can be denoised; choose one: --layer"
        )
    light, _ = _light(args, file, layer)
    if NOISY not in file.layers:
        names = names + [f"{NOISY}.{c}" for c in "RGB"]
        kinds = kinds + [kinds[place] for place in layer.places]
        pixels = np.concatenate([pixels, pixels[..., list(layer.places)]], axis=2)
    pixels[..., list(layer.places)] = light
    return names, kinds, pixels


def _kinds(file: PictureFile) -> set[str]:
    return {kind for layer in file.layers.values() for kind in layer.kinds}


def _carried(args: argparse.Namespace, file: PictureFile) -> dict[str, str]:
    """What is said of the picture that is also true of what is made of it."""
    from ..layers import MAIN

    same = file.layer(args.layer).name == MAIN
    if args.denoise:  # a render would have had guides
        same = same and "albedo" in file.layers
    # from these `parhelion rerender` would make another picture
    left_out = set() if same else {"parhelion:settings", "parhelion:camera"}
    return {
        key: value
        for key, value in file.metadata.items()
        if isinstance(value, str)
        and (key == "Software" or key.startswith("parhelion:"))
        and key not in left_out
    }


def _contents(file: PictureFile) -> dict[str, Any]:
    """What there is to say of a picture file."""
    metadata = {
        key: value if isinstance(value, (str, int, float)) else str(value)
        for key, value in file.metadata.items()
    }
    return {
        "file": {"path": file.path, "bytes": os.path.getsize(file.path)},
        "width": file.width,
        "height": file.height,
        "parts": file.parts,
        "layers": [_described(file, layer) for layer in file.layers.values()],
        "metadata": metadata,
    }


def _described(file: PictureFile, layer: Layer) -> dict[str, Any]:
    import numpy as np

    values = file.read(layer)
    finite = values[np.isfinite(values)]
    found = [float(f(finite)) for f in (np.min, np.max)] if finite.size else [None, None]
    return {
        "name": layer.name,
        "channels": list(layer.channels),
        "types": list(layer.kinds),
        "least": found[0],
        "most": found[1],
        "mean": float(finite.mean(dtype=np.float64)) if finite.size else None,
        "not_finite": int(values.size - finite.size),
    }


def _text(found: dict[str, Any]) -> str:
    """The same as lines."""
    size = found["file"]["bytes"] / 1024
    lines = [f"{found['file']['path']}: {found['width']}x{found['height']}, {size:,.1f} KiB"]
    lines.append(f"layers: {len(found['layers'])}")
    for layer in found["layers"]:
        kinds = ", ".join(dict.fromkeys(layer["types"]))
        line = f"  {layer['name']}: {' '.join(layer['channels'])}, {kinds}"
        if layer["mean"] is not None:
            line += f"; {layer['least']:.6g} to {layer['most']:.6g}, mean {layer['mean']:.6g}"
        if layer["not_finite"]:
            line += f"; {layer['not_finite']:,} numbers are not finite"
        lines.append(line)
    if found["metadata"]:
        lines.append("metadata:")
    for key, value in found["metadata"].items():
        text = " ".join(str(value).split())
        lines.append(f"  {key}: {text if len(text) <= _LONGEST else text[: _LONGEST - 3] + '...'}")
    return plain("\n".join(lines))
