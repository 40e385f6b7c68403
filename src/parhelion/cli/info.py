"""`parhelion info`: what is in a scene, and what it takes to hold it."""

from __future__ import annotations

import argparse

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
        help="instead: the types of materials and backgrounds, with their parameters",
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

    lines = [f"scene      {scene.name}"]
    for group in prepared.flat.groups:
        lines.append(f"  spheres  {len(group[1]):>12,}  {group[0]}")
    if stats["spheres"]:
        lines.append(f"bounds     {point(low)} to {point(high)}")
    lines += [
        f"materials  {len(prepared.flat.materials)}",
        f"lights     {stats['lights']}",
        f"background {scene.background.type}",
        f"camera     {chosen}eye {point(camera.eye)}, target {point(camera.target)}",
        f"settings   {settings.width}x{settings.height}, {settings.spp} spp",
        f"tree       {stats['nodes']:,} nodes, {stats['leaves']:,} leaves,"
        f" built in {prepared.seconds:.3f} s",
        f"memory     {mib(stats['bytes'])} scene,"
        f" {mib(settings.width * settings.height * 56)} film",
        f"hash       {prepared.flat.sha256()}",
    ]
    return "\n".join(lines)


def _materials() -> str:
    from ..tables import tables

    lines = []
    for kind in ("materials", "backgrounds"):
        lines.append(f"{kind}:")
        for entry in tables()[kind].values():
            lines.append(f"  {entry.name}: {entry.doc}")
            for p in entry.params:
                preset = " ".join(f"{x:g}" for x in p.default)
                lines.append(f"    {p.name} = {preset}  {p.doc} ({p.range()})")
    return "\n".join(lines)
