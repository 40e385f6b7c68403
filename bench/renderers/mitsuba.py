"""Mitsuba 3, from PyPI. Its LLVM variants need LLVM's shared library; see bench/README.md."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from glob import glob
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..gallery import of_job
from ..scenes import BenchError
from . import Clock
from .mitsuba_scene import convert

# A wavefront of more samples a pixel than this takes gigabytes; more are rendered in parts.
PART_SPP = 64

LIBRARIES = (
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/opt/homebrew/opt/llvm/lib/libLLVM*.dylib",
)


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has "variant", and "xml", the path of a scene, or what gallery.of_job() takes."""
    if job["variant"].startswith("llvm") and "DRJIT_LIBLLVM_PATH" not in os.environ:
        found = sorted((p for pattern in LIBRARIES for p in glob(pattern)), key=_llvm_version)
        if not found:
            raise BenchError("no LLVM library, nor DRJIT_LIBLLVM_PATH; see bench/README.md")
        os.environ["DRJIT_LIBLLVM_PATH"] = found[-1]

    import drjit as dr
    import mitsuba as mi
    import numpy as np

    mi.set_variant(job["variant"])
    mi.set_log_level(mi.LogLevel.Error)
    # With fewer than 4 threads its pool has been seen to hang; the worker's affinity limits cores.
    dr.set_thread_count(max(4, job["threads"]))
    with Clock() as preparing:
        scene = _of_file(mi, job) if "xml" in job else mi.load_dict(convert(mi, of_job(job), job))

    def render(request: dict[str, Any]) -> dict[str, Any]:
        sizes = [PART_SPP] * (request["spp"] // PART_SPP)
        if request["spp"] % PART_SPP:
            sizes.append(request["spp"] % PART_SPP)
        total, times = 0.0, {"seconds": 0.0, "cpu_seconds": 0.0}
        for part, spp in enumerate(sizes):
            with Clock() as clock:
                image = mi.render(scene, spp=spp, seed=request["seed"] + part)
                dr.eval(image)
                dr.sync_thread()
            times = {key: times[key] + value for key, value in clock.times().items()}
            total = total + np.array(image, dtype=np.float64) * (spp / request["spp"])
        if request["save"]:
            np.save(request["save"], np.asarray(total, dtype=np.float32))
        return times

    known: dict[str, Any] = {"version": version("mitsuba"), "drjit": version("drjit")}
    known["prepare_seconds"] = preparing.times()["seconds"]
    if job["variant"].startswith("llvm"):
        known["llvm"] = ".".join(str(n) for n in dr.detail.llvm_version())
        known["library"] = Path(os.environ["DRJIT_LIBLLVM_PATH"]).name
    return known, render


def _llvm_version(path: str) -> list[int]:
    return [int(n) for n in re.findall(r"\d+", Path(path).name)]


def _of_file(mi: Any, job: dict[str, Any]) -> Any:
    """The scene of an XML file, its picture of the job's size and with a box filter."""
    path = Path(job["xml"])
    mi.file_resolver().prepend(str(path.parent))
    config = mi.parser.ParserConfig(job["variant"])
    state = mi.parser.parse_file(config, str(path), **job["defines"])
    mi.parser.transform_all(config, state)
    for node in state.nodes:
        if node.type == mi.ObjectType.ReconstructionFilter:
            for name in list(node.props.keys()):
                del node.props[name]
            node.props.set_plugin_name("box")
        elif node.type == mi.ObjectType.Film:
            node.props["width"], node.props["height"] = job["width"], job["height"]
    scene = mi.parser.instantiate(config, state)
    return scene[0] if isinstance(scene, list) else scene
