"""Ours."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph
from parhelion import _core
from parhelion.io import LoadOptions

from ..gallery import cloud_scene, lamp_scene, of_job
from . import Clock


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has "cloud", a number of spheres, or "lamps", a number of small lights over a floor, or
    "xml", the path of a Mitsuba scene with "defines", and "allow", a folder its files may lie in,
    or what gallery.of_job() takes.
    """
    if "xml" in job:
        scene = ph.load(
            job["xml"], LoadOptions(defines=job["defines"], allow_paths=(job["allow"],))
        )
    elif "cloud" in job:
        scene = cloud_scene(job["cloud"], job["glass"])
    elif "lamps" in job:
        scene = lamp_scene(job["lamps"])
    else:
        scene = of_job(job)
    start = time.process_time()
    prepared = ph.prepare(scene)
    build_cpu_seconds = time.process_time() - start

    def render(request: dict[str, Any]) -> dict[str, Any]:
        traversal = _core.traversal_seconds()
        with Clock() as clock:
            image = ph.render(
                prepared,
                width=job["width"],
                height=job["height"],
                filter="box",
                filter_radius=0.5,
                spp=request["spp"],
                seed=request["seed"],
                **{
                    "threads": job["threads"],
                    "max_depth": job.get("depth"),
                    "reuse_paths": job.get("reuse_paths", "auto"),
                    **request["options"],
                },
            )
        if request["save"]:
            np.save(request["save"], image.numpy())
        return clock.times() | {
            "seconds": image.stats.seconds,
            "rays": image.stats.rays,
            "traversal_seconds": _core.traversal_seconds() - traversal,
        }

    library = hashlib.sha256(Path(_core.__file__).read_bytes()).hexdigest()
    return {
        "version": ph.__version__,
        "build": library[:16],
        "isa": _core.instruction_set(),
        "isas": _core.instruction_sets(),
        "prepare_seconds": prepared.seconds,
        "build_cpu_seconds": build_cpu_seconds,
        "input_bytes": sum(
            a.nbytes for s in scene.shapes for a in vars(s).values() if isinstance(a, np.ndarray)
        ),
    }, render
