"""Mitsuba 3, from PyPI. Its LLVM variants need LLVM's shared library; see bench/README.md."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from glob import glob
from importlib.metadata import version
from math import sqrt
from pathlib import Path
from typing import Any

from ..scenes import BenchError, Weekend, read_weekend

# A wavefront of more samples a pixel than this takes gigabytes; more are rendered in parts.
PART_SPP = 64

LIBRARIES = (
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib/*/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/opt/homebrew/opt/llvm/lib/libLLVM*.dylib",
)


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has "variant", and "spheres", the path of a weekend file, or "xml", that of a scene."""
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
    if "xml" in job:
        scene = _of_file(mi, job)
    else:
        weekend = read_weekend(Path(job["spheres"]), fuzz=job["fuzz"])
        scene = mi.load_dict(_weekend(mi, np, weekend, job))

    def render(request: dict[str, Any]) -> dict[str, Any]:
        sizes = [PART_SPP] * (request["spp"] // PART_SPP)
        if request["spp"] % PART_SPP:
            sizes.append(request["spp"] % PART_SPP)
        total, seconds = 0.0, 0.0
        for part, spp in enumerate(sizes):
            start = time.perf_counter()
            image = mi.render(scene, spp=spp, seed=request["seed"] + part)
            dr.eval(image)
            dr.sync_thread()
            seconds += time.perf_counter() - start
            total = total + np.array(image, dtype=np.float64) * (spp / request["spp"])
        if request["save"]:
            np.save(request["save"], np.asarray(total, dtype=np.float32))
        return {"seconds": seconds}

    known = {"version": version("mitsuba"), "drjit": version("drjit")}
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


def _weekend(mi: Any, np: Any, weekend: Weekend, job: dict[str, Any]) -> dict[str, Any]:
    c = weekend.camera
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": job["depth"], "rr_depth": 5},
        "sensor": {
            "type": "thinlens",
            "to_world": mi.ScalarTransform4f().look_at(c["lookfrom"], c["lookat"], c["vup"]),
            "fov": c["vfov"],
            "fov_axis": "y",
            "aperture_radius": c["aperture_radius"],
            "focus_distance": c["focus_distance"],
            "sampler": {"type": "independent"},
            "film": {
                "type": "hdrfilm",
                "width": job["width"],
                "height": job["height"],
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        },
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(_sky(np, weekend.sky))},
    }
    for i, s in enumerate(weekend.spheres):
        scene[f"sphere{i}"] = {
            "type": "sphere",
            "center": s["center"],
            "radius": s["radius"],
            "bsdf": _bsdf(s),
        }
    return scene


def _bsdf(s: dict[str, Any]) -> dict[str, Any]:
    color = {"type": "rgb", "value": s["albedo"]}
    if s["type"] == "diffuse":
        return {"type": "diffuse", "reflectance": color}
    if s["type"] == "glass":
        return {"type": "dielectric", "int_ior": s["ior"], "ext_ior": 1.0}
    if s["fuzz"] == 0:
        return {"type": "conductor", "material": "none", "specular_reflectance": color}
    # There is no fuzz in Mitsuba. A point on a sphere of radius f shifts the mirrored direction by
    # f / sqrt(3) (standard deviation) along each axis; facets with Beckmann's distribution tilt by
    # alpha / sqrt(2), which turns the mirrored direction by twice that. At normal incidence the two
    # agree for alpha = f / sqrt(6).
    return {
        "type": "roughconductor",
        "distribution": "beckmann",
        "alpha": s["fuzz"] / sqrt(6),
        "material": "none",
        "specular_reflectance": color,
    }


def _sky(np: Any, sky: dict[str, Any]) -> Any:
    """(256, 512, 3) float32: the gradient as a map of directions, +y at the top row."""
    rows, columns = 256, 512
    height = np.cos(np.pi * (np.arange(rows) + 0.5) / rows)
    t = 0.5 * (height + 1.0)
    colors = np.outer(1.0 - t, sky["horizon"]) + np.outer(t, sky["zenith"])
    return np.repeat(colors[:, None, :], columns, axis=1).astype(np.float32)
