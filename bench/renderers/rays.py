"""Rays against one scene by the program that the job names, on one thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np

from ..rays import bounces

Query = Callable[[np.ndarray, np.ndarray, bool], Any]


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has "program" and "file", the scene and the camera's rays as bench.rays writes them."""
    with np.load(job["file"]) as arrays:
        scene = dict(arrays)
    module = import_module(job["program"])
    known = getattr(module, "__version__", None) or version(job["program"])
    query, distances = PROGRAMS[job["program"]](scene)
    rays = {"camera": (scene["origins"], scene["directions"])}
    few = scene["origins"][:1], scene["directions"][:1]
    rays["bounce"] = rays["any hit"] = bounces(*rays["camera"], distances(*rays["camera"]))

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        if request["rays"] == "build":
            start = time.perf_counter()  # of all threads
            PROGRAMS[job["program"]](scene)[0](*few, False)  # Embree builds at the first ray
            return {"seconds": time.perf_counter() - start}
        origins, directions = rays[request["rays"]]
        begin = time.process_time()  # of one thread; the wall clock also counts others
        query(origins, directions, request["rays"] == "any hit")
        return {"seconds": time.process_time() - begin, "rays": len(origins)}

    return {"version": known}, answer


def _ours(scene: dict[str, Any]) -> tuple[Query, Callable[..., np.ndarray]]:
    import parhelion as ph

    shape: Any
    if "faces" in scene:
        shape = ph.Mesh(scene["vertices"], scene["faces"])
    else:
        shape = ph.Spheres(scene["centers"], scene["radius"])
    core = ph.prepare(ph.Scene([shape])).core

    def query(origins: np.ndarray, directions: np.ndarray, any_hit: bool) -> Any:
        if any_hit:
            return core.occluded(origins, directions, np.full(len(origins), np.inf, np.float32))
        return core.intersect(origins, directions)

    return query, lambda o, d: core.intersect(o, d)[0]


def _embree(scene: dict[str, Any]) -> tuple[Query, Callable[..., np.ndarray]]:
    rtcore = import_module("embreex.rtcore_scene")
    meshes = import_module("embreex.mesh_construction")
    made = rtcore.EmbreeScene()
    meshes.TriangleMesh(made, scene["vertices"], scene["faces"].astype(np.int32))

    def query(origins: np.ndarray, directions: np.ndarray, any_hit: bool) -> Any:
        return made.run(origins, directions, query="OCCLUDED" if any_hit else "DISTANCE")

    return query, lambda o, d: made.run(o, d, query="DISTANCE")


PROGRAMS: dict[str, Callable[[dict[str, Any]], tuple[Query, Callable[..., np.ndarray]]]] = {
    "parhelion": _ours,
    "embreex": _embree,
}
