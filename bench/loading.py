"""The group `loading`: reading scenes, meshes and particles, ours beside others' readers.

The largest mesh at hand, 871,414 triangles, is read from each of the formats that the others know;
scenes are those of ../shared/scenes. Every program loads a file once before it is timed, so that
the file is in memory and modules are imported.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .process import Worker
from .scenes import SHARED, BenchError
from .summary import Row, ratios

OURS = "parhelion"
DRAGON = "mesh/dragon_vrip.ply.gz"

# Beside each file, those whose time ours is compared with. pbrt has no module for Python, and no
# other reads its scenes.
SCENES: dict[str, tuple[str, ...]] = {
    "gltf/DamagedHelmet/DamagedHelmet.glb": ("trimesh",),
    "gltf/khronos-small/CesiumMilkTruck.glb": ("trimesh",),
    "yocto/features1/shapes/bunny.ply": ("trimesh", "mitsuba"),
    "mitsuba-data/common/meshes/sphere.obj": ("trimesh", "mitsuba"),
    "mitsuba-data/scenes/matpreview/matpreview.xml": ("mitsuba",),
    "bitterli-coffee/scene-v4.pbrt": (),
    "bitterli-classroom/scene-v4.pbrt": (),
    "pbrt-v1v3/arcsphere-v3/arcsphere.pbrt": (),
    "particles/gro/bigbox.gro.bz2": ("MDAnalysis",),
}
DRAGONS: dict[str, tuple[str, ...]] = {
    "dragon.ply": ("trimesh", "mitsuba"),
    "dragon-binary.ply": ("trimesh", "mitsuba"),
    "dragon.obj": ("trimesh", "mitsuba"),
    "dragon.stl": ("trimesh",),
    "dragon.glb": ("trimesh",),
}
# Seconds that loading may take at most
MOST = {"particles/gro/bigbox.gro.bz2": 2.0}
TREES = (".ply", ".obj", ".glb", ".pbrt", ".xml", ".bz2")


def loading(plan: Any, notes: Any) -> Iterator[Row]:
    """Seconds to load, to load and build trees, and peak memory, by file."""
    files = [(SHARED / name, peers) for name, peers in SCENES.items()]
    files += [(path, DRAGONS[path.name]) for path in dragons(plan, notes)]
    for file, peers in files:
        if not file.is_file():
            notes.add(f"{file.name} is not there and was not measured")
            continue
        known = file.relative_to(SHARED).as_posix() if file.is_relative_to(SHARED) else ""
        for tree in (False, True):
            if not tree or file.suffix in TREES:
                others = [p for p in peers if not tree or p == "mitsuba"]
                yield from measured(plan, notes, file, others, tree, MOST.get(known))


def measured(
    plan: Any, notes: Any, file: Path, peers: list[str], tree: bool, most: float | None
) -> list[Row]:
    """The rows of one file: ours, and each peer in turn with it."""
    group = f"{file.name}, {'load and build' if tree else 'load'}"
    workers: dict[str, Worker] = {}
    seconds: dict[str, list[float]] = {}
    try:
        for name in (OURS, *peers):
            job = {"program": name, "file": str(file), "tree": tree, "threads": plan.threads}
            try:
                workers[name] = Worker("loading", job)
                workers[name].ask({})
            except BenchError as problem:
                if name == OURS:
                    raise
                notes.add(f"{name} was not measured with {file.name}: {problem}")
                if name in workers:
                    workers.pop(name).close()
                continue
            notes.versions[name] = workers[name].known
            seconds[name] = []
        for _ in range(plan.rounds):
            for name, worker in workers.items():
                answer = worker.ask({})
                seconds[name].append(answer["seconds"])
        peaks = {name: worker.ask({})["peak_bytes"] / 1e6 for name, worker in workers.items()}
    finally:
        for worker in workers.values():
            worker.close()
    rows = [Row(group, OURS, "s", seconds[OURS], most=None if tree else most)]
    for name in seconds:
        if name != OURS:
            pairs = ratios(seconds[name], seconds[OURS])
            rows.append(
                Row(group, name, "s", seconds[name], against=OURS, ratios=pairs, least_ratio=1.0)
            )
    if not tree:
        rows += [Row(f"{group}, peak", name, "MB", [peak]) for name, peak in peaks.items()]
    return rows


def dragons(plan: Any, notes: Any) -> list[Path]:
    """The large mesh in several formats, in the cache."""
    source = SHARED / DRAGON
    if not source.is_file():
        notes.add(f"{DRAGON} is not there and was not measured")
        return []
    plan.cache.mkdir(parents=True, exist_ok=True)
    paths = [plan.cache / name for name in DRAGONS]
    if not all(path.exists() for path in paths):
        try:
            import trimesh
        except ImportError:
            notes.add(f"{DRAGON} was not measured: trimesh writes it in other formats")
            return []
        paths[0].write_bytes(gzip.decompress(source.read_bytes()))
        mesh = trimesh.load(paths[0], process=False)
        for path in paths[1:]:
            mesh.export(path)
    return paths
