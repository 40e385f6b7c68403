"""`parhelion info`: what is in a scene, and what it takes to hold it."""

from __future__ import annotations

import argparse
import io
import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import options

if TYPE_CHECKING:
    from rich.tree import Tree

# Things of one kind that are listed; of more, the first ones and the sum of all others
_LISTED = 16
# Characters of a name
_LONGEST = 60


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "info",
        help="show what is in a scene",
        description="Shows what a scene or particle file holds, as a tree: what there is to choose"
        " from (fields, cameras, variants, ...), shapes, materials, images, lights, what is not"
        " supported, memory.",
    )
    options.add_loading(p)
    form = p.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="all of it, for programs")
    form.add_argument(
        "--all", action="store_true", help=f"list all things of a kind, not the first {_LISTED}"
    )
    form.add_argument(
        "--materials",
        action="store_true",
        help="instead: the types of materials, textures and lights, with their parameters",
    )
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints to stdout."""
    if args.materials:
        print(_materials())
        return 0
    found = _contents(args)
    if args.json:
        print(json.dumps(found, indent=1))
    else:
        print(_Text(found, None if args.all else _LISTED).tree())
    return 0


def _contents(args: argparse.Namespace) -> dict[str, Any]:
    """What there is to say of a file."""
    from ..contents import contents

    start = time.perf_counter()
    with _warnings() as unsupported:
        scene = options.load_scene(args)
    seconds = time.perf_counter() - start
    with options.naming(args):
        found = contents(scene)
    file = frames = choices = None
    if args.scene is not None:
        from .. import io as readers
        from ..io.frames import frames_in

        file = {"path": str(args.scene), "bytes": Path(args.scene).stat().st_size}
        read_as = options.load_options(args)
        extent = frames_in(args.scene, read_as)
        frames = None if extent is None else asdict(extent)
        choices = readers.contents(args.scene, read_as)
    of_file = {"file": file, "seconds": seconds, "frames": frames, "contents": choices}
    return {**of_file, **found, "unsupported": unsupported}


@contextmanager
def _warnings() -> Iterator[list[str]]:
    """What is warned of within the block, in the place of stderr."""
    log = logging.getLogger("parhelion")
    found: list[str] = []

    class Keep(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            # without the file's name
            args = record.args
            pair = isinstance(args, tuple) and len(args) == 2
            found.append(str(args[1]) if pair else record.getMessage())  # type: ignore[index]

    handler = Keep(logging.WARNING)
    level, propagates = log.level, log.propagate
    log.addHandler(handler)
    log.setLevel(min(level or logging.WARNING, logging.WARNING))
    log.propagate = False
    try:
        yield found
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        log.propagate = propagates


class _Text:
    """The tree of a scene's contents. most: things of a kind that are listed; None is all."""

    def __init__(self, found: dict[str, Any], most: int | None) -> None:
        self.found = found
        self.most = most

    def tree(self) -> str:
        """The text."""
        from rich.console import Console
        from rich.tree import Tree

        f = self.found
        root = Tree(_line(_clip(f["name"])))
        if f["file"]:
            size, seconds = _size(f["file"]["bytes"]), f["seconds"]
            root.add(_line(f"file: {f['file']['path']}, {size}, read in {seconds:.2f} s"))
        if f["frames"] and f["frames"]["first"] != f["frames"]["last"]:
            root.add(_line(_frames(**f["frames"])))
        for name, value in (f["contents"] or {}).items():
            self._choices(root, name.replace("_", " "), value)
        shapes = root.add(_line(f"shapes: {_count(len(f['shapes']))}{self._totals()}"))
        self._list(shapes, f["shapes"], self._shape, _others)
        if f["materials"]:
            self._list(
                root.add(_line(f"materials: {_count(len(f['materials']))}")),
                f["materials"],
                self._material,
                lambda rest: ", ".join(_kinds(rest)),
            )
        if f["images"]:
            total = sum(image["bytes"] for image in f["images"])
            self._list(
                root.add(_line(f"images: {_count(len(f['images']))}, {_size(total)}")),
                f["images"],
                self._image,
                lambda rest: _size(sum(image["bytes"] for image in rest)),
            )
        lights = ", ".join(_kinds(f["lights"])) or "none"
        shining = f"; {_count(f['emitters'])} with shapes that shine" if f["emitters"] else ""
        root.add(_line(f"lights: {lights}{shining}"))
        root.add(_line(f"background: {f['background'] or 'none'}"))
        root.add(_line(f"camera: {_camera(f['camera'])}"))
        s = f["settings"]
        root.add(_line(f"settings: {s['width']}x{s['height']}, {s['spp']} spp"))
        if f["unsupported"]:
            branch = root.add(_line(f"not supported: {_count(len(f['unsupported']))}"))
            self._list(branch, f["unsupported"], lambda t, x: t.add(_line(x)), lambda _: "")
        root.add(_line(f"memory: {self._memory()}"))
        root.add(_line(f"hash: {f['hash']}"))
        # what the terminal cannot show becomes escapes; lines of the tree, ASCII
        text = type("Text", (io.StringIO,), {"encoding": sys.stdout.encoding})()
        Console(file=text, soft_wrap=True, width=1000).print(root)
        return str(text.getvalue()).rstrip("\n")

    def _list(
        self,
        branch: Tree,
        things: Sequence[Any],
        show: Callable[[Tree, Any], object],
        rest: Callable[[Sequence[Any]], str],
    ) -> None:
        """The first things, and what the others are together."""
        most = len(things) if self.most is None or len(things) == self.most + 1 else self.most
        for thing in things[:most]:
            show(branch, thing)
        if len(things) > most:
            others = rest(things[most:])
            colon = ": " if others else ""
            branch.add(_line(f"... and {_count(len(things) - most)} more{colon}{others}"))

    def _choices(self, branch: Tree, name: str, value: Any) -> None:
        """A member of a file's contents: one line, or one for each of several of a kind."""
        if isinstance(value, Mapping) and any(isinstance(v, Mapping) for v in value.values()):
            inner = branch.add(_line(f"{name}: {_count(len(value))}"))
            self._list(inner, list(value.items()), lambda t, x: self._choices(t, *x), lambda _: "")
        else:
            branch.add(_line(f"{name}: {self._words(value)}"))

    def _words(self, value: Any) -> str:
        if isinstance(value, Mapping):
            most = len(value) if self.most is None else self.most
            shown = [(_clip(name), self._words(v)) for name, v in [*value.items()][:most]]
            more = [f"and {_count(len(value) - most)} more"] if len(value) > most else []
            if all(isinstance(v, (int, float)) for v in value.values()):
                return ", ".join([*(f"{name} ({number})" for name, number in shown), *more])
            return "; ".join([*(f"{name} {words}" for name, words in shown), *more])
        if isinstance(value, (list, tuple)):
            return ", ".join(map(self._words, value)) or "none"
        if isinstance(value, float):
            return f"{value:.6g}"
        return "none" if value is None else _count(value) if isinstance(value, int) else str(value)

    def _totals(self) -> str:
        f = self.found
        box = f["bounds"]
        text = f", {_count(f['primitives'])} primitives"
        if f["shown"] != f["primitives"]:
            text += f", {_count(f['shown'])} with all copies"
        return text + (f", {_box(box)}" if box else "")

    def _shape(self, branch: Tree, shape: dict[str, Any]) -> None:
        name, box = _clip(shape["name"]), shape["bounds"]
        place = f"; {_box(box)}" if box else ""
        if shape["type"] == "instances":
            text = f"{name}: {_count(shape['count'])} copies"
            inner = branch.add(_line(f"{text}, {_count(shape['shown'])} primitives{place}"))
            self._list(inner, shape["shapes"], self._shape, _others)
            return
        unit = shape["unit"].removesuffix("s") if shape["count"] == 1 else shape["unit"]
        parts = [f"{_count(shape['count'])} {unit}"]
        if "vertices" in shape:
            parts.append(f"{_count(shape['vertices'])} vertices")
            parts += [n for n in ("normals", "uvs", "tangents") if shape[n]]
            parts += [_clip(n) for n in shape["attributes"][:4]]
        if shape["colors"]:
            parts.append("colors")
        made = _names(shape["materials"])
        branch.add(_line(f"{name}: {', '.join(parts)}; of {made}{place}"))

    def _material(self, branch: Tree, material: dict[str, Any]) -> None:
        textures = [
            f"{t['parameter']} by {t['type']}"
            + (f" {_clip(Path(t['images'][0]).name)}" if t["images"] else "")
            for t in material["textures"]
        ]
        used = f"used by {_names(material['used_by'])}" if material["used_by"] else "not used"
        parts = [material["type"], *textures, used]
        branch.add(_line(f"{_clip(material['name'])}: {', '.join(parts)}"))

    def _image(self, branch: Tree, image: dict[str, Any]) -> None:
        size = f"{image['width']}x{image['height']}x{image['channels']} {image['type']}"
        used = _names(image["used_by"])
        name = _clip(Path(image["name"]).name)
        branch.add(_line(f"{name}: {size}, {_size(image['bytes'])}, used by {used}"))

    def _memory(self) -> str:
        tree, film = self.found["tree"], _size(self.found["film"])
        if tree is None:
            return f"{film} film; of so many primitives no tree is built here"
        return (
            f"{_size(tree['bytes'])} scene, {film} film; tree of {_count(tree['nodes'])} nodes,"
            f" {_count(tree['leaves'])} leaves in {tree['seconds']:.2f} s"
        )


def _line(text: str) -> Any:
    from rich.text import Text

    return Text(text.replace("\n", " "), no_wrap=True)


def _clip(name: str) -> str:
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 3]}..."


def _count(number: int) -> str:
    return f"{number:,}"


def _size(count: int) -> str:
    return f"{count / 2**20:,.2f} MiB" if count >= 2**17 else f"{count / 2**10:,.1f} KiB"


def _point(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in values) + ")"


def _box(box: Sequence[Sequence[float]]) -> str:
    return f"{_point(box[0])} to {_point(box[1])}"


def _names(names: Sequence[str]) -> str:
    """At most four names."""
    shown = ", ".join(_clip(name) for name in names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4:,} more"


def _kinds(things: Sequence[dict[str, Any]]) -> list[str]:
    """How many there are of each type."""
    counts: dict[str, int] = {}
    for thing in things:
        counts[thing["type"]] = counts.get(thing["type"], 0) + 1
    return [f"{_count(n)} {kind}" for kind, n in counts.items()]


def _others(shapes: Sequence[dict[str, Any]]) -> str:
    shown = sum(shape["shown"] for shape in shapes)
    return f"{', '.join(_kinds(shapes))}, {_count(shown)} primitives"


def _camera(camera: dict[str, Any]) -> str:
    chosen = "automatic, " if camera["framed"] else ""
    kind = "" if camera["projection"] == "perspective" else f"{camera['projection']}, "
    return f"{chosen}{kind}eye {_point(camera['eye'])}, target {_point(camera['target'])}"


def _materials() -> str:
    from ..tables import tables

    lines = []
    for kind in ("materials", "textures", "lights"):
        lines.append(f"{kind}:")
        for entry in tables()[kind].values():
            notes = [" (takes an image)"] * entry.image + [" (may be a background)"] * entry.outside
            lines.append(f"  {entry.name}: {entry.doc}{''.join(notes)}")
            for p in entry.params:
                if (entry.name, p.name) == ("attribute", "name"):
                    lines.append(f"    name  {p.doc} (text)")
                    continue
                if p.choices:
                    preset, range = p.choices[int(p.default[0])], " or ".join(p.choices)
                else:
                    preset, range = " ".join(f"{x:g}" for x in p.default), p.range()
                lines.append(f"    {p.name} = {preset}  {p.doc} ({range})")
        if kind == "materials":
            from ..flatten import COMMON

            lines.append("  blend: material `b` in the share `weight`, else `a`")
            lines.append(f"  every material also takes: {', '.join(sorted(COMMON))}")
    return "\n".join(lines)


def _frames(unit: str, first: float, last: float, per_second: float | None) -> str:
    what = "frames" if unit == "frames" else f"frames: {unit}"
    speed = f", {per_second:g} a second" if per_second not in (None, 1.0) else ""
    return f"{what}{'' if what != unit else ':'} {first:g} to {last:g}{speed}"
