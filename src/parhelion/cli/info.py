"""`parhelion info`: what is in a scene, and what it takes to hold it."""

from __future__ import annotations

import argparse
from typing import Any

from . import options


def add(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds the command."""
    p = commands.add_parser(
        "info",
        help="print counts, bounds and memory of a scene",
        description="Prints what a scene or particle file holds: counts, bounds, memory.",
    )
    options.add_loading(p)
    p.add_argument(
        "--materials",
        action="store_true",
        help="instead: the types of materials, textures and lights, with their parameters",
    )
    options.add_logging(p)
    p.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints to stdout."""
    print(_materials() if args.materials else _scene(args))
    return 0


def _scene(args: argparse.Namespace) -> str:
    import numpy as np

    from ..framing import bounds, placed
    from ..renderer import prepare
    from ..scene import Camera

    scene = options.load_scene(args)
    with options.naming(args):
        prepared = prepare(scene)
    stats = prepared.core.stats()
    low, high = bounds(scene)
    settings = scene.settings
    chosen = "" if isinstance(scene.camera, Camera) else "automatic: "
    camera = placed(scene, settings.width / settings.height)

    def point(v: object) -> str:
        return "(" + ", ".join(f"{float(x):.6g}" for x in np.asarray(v)) + ")"

    def mib(size: float) -> str:
        return f"{size / 2**20:,.2f} MiB"

    parts = prepared.flat.parts
    lines = [f"scene      {scene.name}"]
    for record in parts["groups"][-1]:  # the scene itself; before it is what instances copy
        lines.append(_shape(record, "  "))
        if "group" in record:
            lines += [_shape(part, "    ") for part in parts["groups"][record["group"]]]
    if np.all(np.isfinite(high - low)):
        lines.append(f"bounds     {point(low)} to {point(high)}")
    lines += [
        f"materials  {len(parts['materials'])}",
        f"textures   {len(parts['textures'])}, {len(parts['images'])} images",
        f"lights     {stats['lights']:,}",
        f"background {'none' if scene.background is None else scene.background.type}",
        f"camera     {chosen}eye {point(camera.eye)}, target {point(camera.target)}",
        f"settings   {settings.width}x{settings.height}, {settings.spp} spp",
        f"tree       {stats['nodes']:,} nodes, {stats['leaves']:,} leaves,"
        f" built in {prepared.seconds:.3f} s",
        f"memory     {mib(stats['bytes'])} scene,"
        f" {mib(settings.width * settings.height * 56)} film",
        f"hash       {prepared.flat.sha256()}",
    ]
    return "\n".join(lines)


def _shape(record: dict[str, Any], indent: str) -> str:
    kind = "copies" if record["kind"] == "instance" else f"{record['kind']}s"
    return f"{indent}{kind:<{12 - len(indent)}} {record['count']:>10,}  {record['name']}"


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
