"""Loads one file, again and again, by the program that the job names; it renders nothing."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from ..scenes import BenchError

Load = Callable[[], Any]


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has "program", "file", and "tree": whether to build what rays are traced with too."""
    load = PROGRAMS[job["program"]](Path(job["file"]), job["tree"])

    def render(_: dict[str, Any]) -> dict[str, Any]:
        start = time.perf_counter()
        kept = load()
        seconds = time.perf_counter() - start
        del kept
        return {"seconds": seconds}

    return {"version": import_module(job["program"]).__version__}, render


def _ours(file: Path, tree: bool) -> Load:
    import parhelion as ph

    logging.getLogger("parhelion").setLevel(logging.ERROR)
    options = ph.LoadOptions(allow_paths=(str(file.parent),))
    if tree:
        return lambda: ph.prepare(ph.load(file, options))
    return lambda: ph.load(file, options)


def _trimesh(file: Path, tree: bool) -> Load:
    import trimesh

    if tree:
        raise BenchError("trimesh builds no tree of its own")

    def load() -> Any:
        # process=False: without merging equal vertices, which takes several times as long
        loaded = trimesh.load(file, process=False)
        # A renderer needs normals, which it computes when they are asked for
        parts = loaded.geometry.values() if isinstance(loaded, trimesh.Scene) else [loaded]
        return loaded, [part.vertex_normals for part in parts]

    return load


def _mitsuba(file: Path, tree: bool) -> Load:
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    if file.suffix == ".xml":
        return lambda: mi.load_file(str(file))
    mesh = {"type": file.suffix[1:], "filename": str(file)}
    return lambda: mi.load_dict({"type": "scene", "mesh": mesh} if tree else mesh)


def _mdanalysis(file: Path, tree: bool) -> Load:
    import warnings

    import MDAnalysis

    if tree:
        raise BenchError("MDAnalysis builds no tree")
    warnings.simplefilter("ignore")
    return lambda: MDAnalysis.Universe(str(file)).atoms.positions


PROGRAMS: dict[str, Callable[[Path, bool], Load]] = {
    "parhelion": _ours,
    "trimesh": _trimesh,
    "mitsuba": _mitsuba,
    "MDAnalysis": _mdanalysis,
}
