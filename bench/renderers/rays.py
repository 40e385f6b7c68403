"""Rays against one scene by the program that the job names, on one thread; and trees, on all."""

from __future__ import annotations

import ctypes
import os
import shlex
import subprocess
import tempfile
import time
import weakref
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph
from parhelion import _core
from parhelion.flatten import flatten

from ..rays import ALONE, ANY, EMBREE, OURS, PACKETS, PUBLIC, ROBUST, WRAPPED, at_edges, onwards
from ..scenes import BenchError

# Of origins and directions, (n, 3) each, and whether any hit will do: which rays hit, or how far,
# infinity where they do not.
Query = Callable[[np.ndarray, np.ndarray, bool], np.ndarray]
CALLS = 4096  # of one ray each


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has "program" and "file", the scene and the camera's rays as bench.rays writes them."""
    with np.load(job["file"]) as arrays:
        scene = dict(arrays)
    package = job["program"].split()[0]
    known = getattr(import_module(package), "__version__", None) or version(package)
    program = PROGRAMS[job["program"]](scene)
    query = program.tree()
    camera = scene["origins"], scene["directions"]
    few = scene["origins"][:1], scene["directions"][:1]
    rays = {"camera": camera, **onwards(*camera, query(*camera, False))}
    spread = np.linspace(0, len(camera[0]) - 1, CALLS, dtype=np.int64)
    rays[ALONE] = camera[0][spread], camera[1][spread]
    builds = {"tree": program.tree, "scene": program.scene}

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        kind = request["rays"]
        if kind == "cost":
            return dict(zip(("nodes", "leaves"), program.cost(), strict=True))
        if kind in builds:
            start = time.perf_counter()  # of whatever threads there are
            builds[kind]()(*few, False)
            return {"seconds": time.perf_counter() - start}
        if kind == "edges":
            at = at_edges(scene["vertices"], scene["faces"])
            return {"rays": len(at[0]), "hits": int(np.isfinite(query(*at, False)).sum())}
        origins, directions = rays[kind]
        begin = time.process_time()  # of one thread; the wall clock also counts others
        if kind == ALONE:
            each = range(len(origins))
            found = np.concatenate(
                [query(origins[i : i + 1], directions[i : i + 1], False) for i in each]
            )
        else:
            found = query(origins, directions, kind in ANY)
        seconds = time.process_time() - begin
        hit = found if found.dtype == bool else np.isfinite(found)
        return {"seconds": seconds, "rays": len(origins), "hits": int(np.count_nonzero(hit))}

    return {"version": known}, answer


class _Ours:
    def __init__(self, arrays: dict[str, Any]) -> None:
        self.arrays = arrays
        self.flat = flatten(self._described())

    def tree(self) -> Query:
        """From what the core takes."""
        return self._query(_core.Scene(self.flat.parts, None))

    def scene(self) -> Query:
        """From arrays, as a user makes it."""
        return self._query(ph.prepare(self._described()).core)

    def cost(self) -> tuple[float, float]:
        """Nodes and leaves that a line through the tree meets."""
        return _core.Scene(self.flat.parts, None).tree_cost()

    def _described(self) -> ph.Scene:
        if "faces" in self.arrays:
            return ph.Scene([ph.Mesh(self.arrays["vertices"], self.arrays["faces"])])
        return ph.Scene([ph.Spheres(self.arrays["centers"], self.arrays["radius"])])

    @staticmethod
    def _query(core: Any) -> Query:
        def query(origins: np.ndarray, directions: np.ndarray, any_hit: bool) -> np.ndarray:
            if any_hit:
                limits = np.full(len(origins), np.inf, np.float32)
                return core.occluded(origins, directions, limits).view(np.bool_)
            return core.intersect(origins, directions)[0]

        return query


class _Public(_Ours):
    def tree(self) -> Query:
        prepared = ph.prepare(self._described())

        def query(origins: np.ndarray, directions: np.ndarray, any_hit: bool) -> np.ndarray:
            if any_hit:
                return ph.occluded(prepared, origins, directions, threads=1)
            return ph.intersect(prepared, origins, directions, threads=1).distance

        return query


class _Embree:
    def __init__(self, arrays: dict[str, Any], robust: bool = False, packets: bool = False) -> None:
        self.library, self.robust = _library(), robust
        self.ask = [
            getattr(self.library, f"embree_{name}{16 if packets else ''}")
            for name in ("nearest", "any")
        ]
        if "faces" in arrays:
            points, faces = arrays["vertices"], arrays["faces"].astype(np.uint32)
            self.make, self.of = self.library.embree_triangles, [points, faces]
        else:
            radius = np.broadcast_to(arrays["radius"], len(arrays["centers"]))
            spheres = np.column_stack([arrays["centers"], radius]).astype(np.float32)
            self.make, self.of = self.library.embree_spheres, [spheres]

    def tree(self) -> Query:
        arrays = (value for array in self.of for value in (_at(array), len(array)))
        made = self.make(*arrays, self.robust)

        def query(origins: np.ndarray, directions: np.ndarray, any_hit: bool) -> np.ndarray:
            found = np.empty(len(origins), bool if any_hit else np.float32)
            self.ask[any_hit](made, _at(origins), _at(directions), len(origins), _at(found))
            return found

        weakref.finalize(query, self.library.embree_release, made)
        return query

    scene = tree  # there is nothing more to one


class _Wrapped:
    """By what embreex has for Python: all that it tells of hits, as ph.intersect tells all."""

    def __init__(self, arrays: dict[str, Any]) -> None:
        self.arrays = arrays

    def tree(self) -> Query:
        made = import_module("embreex.rtcore_scene").EmbreeScene()
        mesh = import_module("embreex.mesh_construction").TriangleMesh
        mesh(made, self.arrays["vertices"], self.arrays["faces"].astype(np.int32))

        def query(origins: np.ndarray, directions: np.ndarray, any_hit: bool) -> np.ndarray:
            if any_hit:
                return made.run(origins, directions, query="OCCLUDED") >= 0
            told = made.run(origins, directions, output=True)
            return np.where(told["primID"] >= 0, told["tfar"], np.inf)

        return query

    scene = tree


def _at(array: np.ndarray) -> int:
    assert array.flags.c_contiguous
    assert array.dtype in (np.float32, np.uint32, bool)
    return array.ctypes.data


@cache
def _library() -> ctypes.CDLL:
    """embree.cpp, compiled for this run. Raises BenchError without a compiler."""
    home = Path(import_module("embreex").__file__ or "").parents[1] / "embreex.libs"
    embree = next(home.glob("libembree4*"), None)
    if embree is None:
        raise BenchError(f"no Embree in {home}")
    compiler = shlex.split(os.environ.get("CXX", "c++"))
    source = Path(__file__).with_name("embree.cpp")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "embree.so"
        command = [*compiler, "-O3", "-std=c++20", "-shared", "-fPIC", source, embree]
        try:
            subprocess.run([*command, f"-Wl,-rpath,{home}", "-o", made], check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise BenchError(f"{source.name} could not be compiled: {error}") from error
        library = ctypes.CDLL(str(made))
    array, count, flag = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_bool
    for name, result, arguments in (
        ("triangles", ctypes.c_void_p, [array, count, array, count, flag]),
        ("spheres", ctypes.c_void_p, [array, count, flag]),
        ("release", None, [ctypes.c_void_p]),
        ("nearest", None, [ctypes.c_void_p, array, array, count, array]),
        ("any", None, [ctypes.c_void_p, array, array, count, array]),
        ("nearest16", None, [ctypes.c_void_p, array, array, count, array]),
        ("any16", None, [ctypes.c_void_p, array, array, count, array]),
    ):
        function = getattr(library, f"embree_{name}")
        function.restype, function.argtypes = result, arguments
    return library


PROGRAMS: dict[str, Any] = {
    OURS: _Ours,
    PUBLIC: _Public,
    EMBREE: _Embree,
    ROBUST: partial(_Embree, robust=True),
    f"{EMBREE} {PACKETS}": partial(_Embree, packets=True),
    f"{ROBUST} {PACKETS}": partial(_Embree, robust=True, packets=True),
    WRAPPED: _Wrapped,
}
