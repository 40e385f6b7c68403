"""The group `rays`: hits of rays by the million a second on one thread, ours beside Embree's.

Two kinds of made scenes, from a thousand primitives to a million, or ten with --long: a sphere with
waves as triangles, and a box of random spheres. And the triangles of scenes as people make them,
large beside small, which trees find harder. Four kinds of rays: a camera's, neighbours side by
side; from where those hit, towards a sun, for any hit; what bounces from there in all directions,
for the nearest hit; and the same for any hit. All get them as arrays in one call, ours of distances
alone, and once more by `ph.intersect` and `ph.occluded`, which tell and check what users want.
Embree's one ray at a time, and of those that lie close together by packets of sixteen, too; its
triangles by default, and by its robust flag, which shall let no ray through between neighbours; how
many get out of the closed meshes at their edges and corners is told, too. What embreex itself has
for Python, one ray at a time, stands beside `ph.intersect` and `ph.occluded` by one thread, and
again where each of some rays is a call of its own. And how long the tree takes, from the arrays
that `_core.Scene` gets to the first ray and until the tree is gone, on one core of the processor;
and for ours the whole scene, as it is made in Python, with all checks and a look at how much memory
there is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph

from .process import Worker, in_turn
from .scenes import BenchError
from .summary import Row, ratios

SIDE = 512  # rays of a picture's side
SHAPES = ("triangles", "spheres")
SCENES = ("helmet", "sponza", "classroom", "coffee")  # of the gallery
BUILDS = ("tree", "scene")
RAYS = ("camera", "shadow", "bounce", "any hit")
ALONE = "one a call"  # of a camera's rays
ANY = ("shadow", "any hit")  # of RAYS: whether anything is hit, or else what is the nearest
SUN = np.float32([0.36, 0.8, 0.48])
CLOSE = ("camera", "shadow")  # of RAYS: neighbours go nearly the same way
OURS, PUBLIC, EMBREE, ROBUST = "parhelion", "parhelion public", "embreex", "embreex robust"
PACKETS, WRAPPED = "packets", "embreex public"
AGAINST = {WRAPPED: PUBLIC}  # what a program's figures are divided by, if not by OURS
PROGRAMS = {
    "triangles": (
        *(OURS, PUBLIC, EMBREE, ROBUST),
        *(f"{EMBREE} {PACKETS}", f"{ROBUST} {PACKETS}", WRAPPED),
    ),
    "spheres": (OURS, PUBLIC, EMBREE, f"{EMBREE} {PACKETS}"),
}
SAME = 1e-3  # of the hits, by which programs may differ
AMIDST = (0.01, 0.02, -0.03)  # of the closed meshes; off their axes, for rays of all kinds
MOST = {"triangles": 1.0, "spheres": 1 / 1.5}  # Embree's rays a second over ours, as asked


def rays(plan: Any, notes: Any) -> Iterator[Row]:
    """By the number of primitives: seconds to build, and rays of each kind."""
    for path, what, shape in loads(plan, notes, "rays"):
        yield from measured(plan, notes, path, what, shape)


def loads(plan: Any, notes: Any, group: str) -> Iterator[tuple[Path, str, str]]:
    """Made scenes and those of the gallery, one after the other in a file that write() makes: its
    path, the scene's name, and which of SHAPES it is of. group: which wants them.
    """
    plan.cache.mkdir(parents=True, exist_ok=True)
    path = plan.cache / "rays.npz"
    for shape in SHAPES:
        for count in (10**3, 10**4, 10**5, 10**6) + ((10**7,) if plan.long else ()):
            write(path, shape, count)
            yield path, f"{count:.0e} {shape}".replace("e+0", "e"), shape
    for name in SCENES:
        try:
            write_scene(path, name)
        except BenchError as problem:
            notes.add(f"{group}, {name}: not measured: {problem}")
            continue
        yield path, name, "triangles"
    path.unlink()


def measured(plan: Any, notes: Any, path: Path, what: str, shape: str) -> list[Row]:
    closed = shape == "triangles" and what not in SCENES
    workers: dict[str, Worker] = {}
    hits: dict[tuple[str, str], int] = {}
    try:
        for name in PROGRAMS[shape]:
            try:
                workers[name] = Worker("rays", {"program": name, "file": str(path), "threads": 1})
                notes.versions[name] = workers[name].known
            except BenchError as problem:
                if name == OURS:
                    raise
                notes.add(f"{name} was not measured with {what}: {problem}")
        kinds = (*BUILDS, *RAYS, ALONE)
        speed: dict[tuple[str, str], list[float]] = {
            (k, name): [] for k in kinds for name in workers if _measured(k, name)
        }
        for turn in range(plan.rounds + 1):
            for kind in kinds:
                asked = [pair for pair in workers.items() if (kind, pair[0]) in speed]
                for name, worker in in_turn(asked, turn):
                    answer = worker.ask({"rays": kind})
                    if kind not in BUILDS:
                        hits[kind, name] = answer["hits"]
                    if turn:  # the first is not counted: pages are touched
                        speed[kind, name].append(
                            answer["rays"] / answer["seconds"] / 1e6
                            if kind not in BUILDS
                            else answer["seconds"]
                        )
        if closed:
            lost = {
                name: worker.ask({"rays": "edges"})
                for name, worker in workers.items()
                if _measured("edges", name)
            }
    finally:
        for worker in workers.values():
            worker.close()
    rows = []
    for (kind, name), values in speed.items():
        more = kind not in BUILDS
        unit = "M/s" if more else "s"
        row = Row(f"{what}, {kind}", name, unit, values, more=more)
        base = AGAINST.get(name, OURS)
        if base != name and (kind, base) in speed:
            pairs = ratios(values, speed[kind, base])
            if more:
                ours, theirs = hits[kind, base], hits[kind, name]
                if abs(theirs - ours) > SAME * max(theirs, ours):
                    notes.add(f"{what}, {kind}: {name} has {theirs} hits, not {ours}")
            row = replace(row, against=base, ratios=pairs)
            if more and name in (EMBREE, ROBUST):
                row = replace(row, most_ratio=MOST[shape])
            elif kind == "tree":
                row = replace(row, least_ratio=1.0)
        rows.append(row)
    if closed:
        for name, answer in lost.items():
            share = 1.0 - answer["hits"] / answer["rays"]
            # as often as seconds, for compare.py: no run differs
            row = Row(f"{what}, lost at edges", name, "%", [100.0 * share] * plan.rounds)
            rows.append(replace(row, most=0.0) if name == OURS else row)
    return rows


def _measured(kind: str, program: str) -> bool:
    """Whether that kind is asked of a program."""
    if kind == ALONE:
        return program in (PUBLIC, WRAPPED)
    if kind in BUILDS:
        return program not in (PUBLIC, WRAPPED) and PACKETS not in program
    if program == WRAPPED:
        return kind in RAYS
    return kind in CLOSE or PACKETS not in program


def write(path: Path, shape: str, count: int) -> None:
    """Primitives and a camera's rays; those that bounce are made by the first who is asked."""
    if shape == "triangles":
        vertices, faces = wavy_sphere(count)
        arrays = {"vertices": vertices, "faces": faces}
    else:
        rng = np.random.default_rng(1)
        centers = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
        # as many as fill the same share of the box, whatever their number
        arrays = {"centers": centers, "radius": np.float32(0.5 * count ** (-1 / 3))}
    origins, directions = camera_rays()
    np.savez(path, origins=origins, directions=directions, **arrays)


def write_scene(path: Path, name: str) -> None:
    """The meshes of a scene of the gallery and rays of a pinhole as its camera's, as write() does.

    Raises BenchError if they cannot be had.
    """
    from . import gallery  # which workers do not need

    scene = gallery.load(name, SIDE * SIDE)
    meshes = [shape for shape in scene.shapes if isinstance(shape, ph.Mesh)]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    camera = scene.camera
    if not isinstance(camera, ph.Camera) or camera.vfov is None:
        raise BenchError("its camera has no vfov")
    eye = np.array(camera.eye)
    towards = np.array(camera.target) - eye
    right = np.cross(towards, camera.up)
    up = np.cross(right, towards)
    towards, right, up = (v / np.linalg.norm(v) for v in (towards, right, up))
    half = np.tan(np.radians(camera.vfov) / 2)
    height, width = scene.settings.height, scene.settings.width
    x = half * width / height * ((np.arange(width) + 0.5) / width * 2 - 1)
    y = half * (1 - (np.arange(height) + 0.5) / height * 2)
    directions = (towards + x[:, None] * right + y[:, None, None] * up).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.savez(
        path,
        vertices=np.concatenate([mesh.vertices for mesh in meshes]).astype(np.float32),
        faces=np.concatenate(faces),
        origins=np.tile(np.float32(eye), (len(directions), 1)),
        directions=directions.astype(np.float32),
    )


def wavy_sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Some `count` triangles around the origin, of radius 0.8 to 1.2: (V, 3) and (F, 3)."""
    rows = max(4, round((count / 4) ** 0.5))
    columns = 2 * rows
    theta = np.pi * np.arange(rows + 1)[:, None] / rows
    phi = 2.0 * np.pi * np.arange(columns)[None, :] / columns
    radius = (
        1.0
        + 0.1 * np.sin(9.0 * theta) * np.sin(7.0 * phi)
        + 0.1 * np.sin(23.0 * phi) * np.sin(theta) ** 2
    )
    around = np.stack(
        [np.sin(theta) * np.cos(phi), np.cos(theta) + 0.0 * phi, np.sin(theta) * np.sin(phi)], 2
    )
    at = np.arange(rows * columns).reshape(rows, columns)
    right = np.roll(at, -1, axis=1)
    below, across = at + columns, right + columns
    faces = np.concatenate([np.stack([at, across, below], 2), np.stack([at, right, across], 2)])
    return (radius[..., None] * around).reshape(-1, 3).astype(np.float32), faces.reshape(-1, 3)


def camera_rays() -> tuple[np.ndarray, np.ndarray]:
    """From (0, 0, 3) over a square that the scenes fill, row after row."""
    s = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    x, y = np.meshgrid(0.7 * s, -0.7 * s)
    directions = np.stack([x, y, np.full_like(x, -1.0)], axis=2).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.tile(np.float32([0, 0, 3]), (len(directions), 1)), directions.astype(np.float32)


def at_edges(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays from the middle of a closed mesh around it to its corners and points of its edges."""
    rng = np.random.default_rng(4)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = vertices[edges[rng.integers(len(edges), size=SIDE * SIDE)]].astype(np.float64)
    part = rng.uniform(size=(len(ends), 1))
    part[::2] = 0.0  # half of them at corners
    directions = ends[:, 0] + (ends[:, 1] - ends[:, 0]) * part - AMIDST
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.tile(np.float32(AMIDST), (len(directions), 1)), directions.astype(np.float32)


def onwards(
    origins: np.ndarray, directions: np.ndarray, distances: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of RAYS those from where the camera's hit, a little before the surface."""
    hit = np.isfinite(distances) & (distances < 1e30)
    there = origins[hit] + directions[hit] * (distances[hit, None] * np.float32(0.9999))
    there = there.astype(np.float32)
    rng = np.random.default_rng(2)
    away = rng.normal(size=origins.shape)[hit]  # the same whoever misses one
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    # half of all are turned back to the side that they come from
    away = np.where(np.einsum("ij,ij->i", away, directions[hit])[:, None] > 0, -away, away)
    bounce = there, away.astype(np.float32)
    return {"shadow": (there, np.tile(SUN, (len(there), 1))), "bounce": bounce, "any hit": bounce}
