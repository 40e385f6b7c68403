"""Ours."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph
from parhelion import _core
from parhelion.io import LoadOptions

from ..scenes import LAMP_FLOOR, Weekend, cloud, lamps, read_weekend


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has either "spheres", the path of a weekend file, or "cloud", a number of spheres, or
    "lamps", a number of small lights over a floor, or "xml", the path of a Mitsuba scene with
    "defines", and "allow", a folder its files may lie in.
    """
    if "xml" in job:
        scene = ph.load(
            job["xml"], LoadOptions(defines=job["defines"], allow_paths=(job["allow"],))
        )
    elif "cloud" in job:
        scene = cloud_scene(job["cloud"])
    elif "lamps" in job:
        scene = lamp_scene(job["lamps"])
    else:
        scene = weekend_scene(read_weekend(Path(job["spheres"]), fuzz=job["fuzz"]))
    prepared = ph.prepare(scene)

    def render(request: dict[str, Any]) -> dict[str, Any]:
        image = ph.render(
            prepared,
            width=job["width"],
            height=job["height"],
            filter="box",
            filter_radius=0.5,
            spp=request["spp"],
            seed=request["seed"],
            max_depth=job.get("depth"),
            **{"threads": job["threads"], **request["options"]},
        )
        if request["save"]:
            np.save(request["save"], image.numpy())
        return {"seconds": image.stats.seconds, "rays": image.stats.rays}

    library = hashlib.sha256(Path(_core.__file__).read_bytes()).hexdigest()
    return {
        "version": ph.__version__,
        "build": library[:16],
        "isa": _core.instruction_set(),
        "isas": _core.instruction_sets(),
        "build_seconds": prepared.seconds,
    }, render


def weekend_scene(weekend: Weekend) -> ph.Scene:
    """The same spheres, camera and sky as all others are given."""
    diffuse, metal, glass = (list(weekend.of(kind)) for kind in ("diffuse", "metal", "glass"))
    materials = {
        f"metal {i}": ph.Material("metal", color=s["albedo"], fuzz=s["fuzz"])
        for i, s in enumerate(metal)
    }
    indices = {ior: len(materials) + i for i, ior in enumerate({s["ior"] for s in glass})}
    materials |= {f"glass {ior}": ph.Material("dielectric", ior=ior) for ior in indices}
    groups = (
        (diffuse, ph.Material("diffuse"), [s["albedo"] for s in diffuse]),
        (metal, np.arange(len(metal)), None),
        (glass, np.array([indices[s["ior"]] for s in glass]), None),
    )
    shapes = [
        ph.Spheres([s["center"] for s in spheres], [s["radius"] for s in spheres], material, colors)
        for spheres, material, colors in groups
        if spheres
    ]
    c = weekend.camera
    camera = ph.Camera(
        eye=tuple(c["lookfrom"]),
        target=tuple(c["lookat"]),
        up=tuple(c["vup"]),
        vfov=c["vfov"],
        aperture_radius=c["aperture_radius"],
        focus_distance=c["focus_distance"],
    )
    return ph.Scene(shapes, materials, camera, ph.Background("gradient", **weekend.sky))


def cloud_scene(count: int) -> ph.Scene:
    """A box of random diffuse spheres in white light."""
    centers, radius = cloud(count)
    spheres = ph.Spheres(centers, radius, ph.Material("diffuse", color=(0.8, 0.8, 0.8)))
    camera = ph.Camera(eye=(0.5, 0.5, 3.0), target=(0.5, 0.5, 0.5), vfov=30.0)
    white = ph.Background("constant", radiance=(1.0, 1.0, 1.0))
    return ph.Scene([spheres], camera=camera, background=white)


def lamp_scene(count: int) -> ph.Scene:
    """A white floor under small lamps, seen from just above it, so that none is in the way."""
    vertices, radiance = lamps(count)
    shining = ph.Mesh(
        vertices.reshape(-1, 3),
        np.arange(3 * count).reshape(-1, 3),
        material=ph.Material("emissive"),
        colors=np.repeat(radiance[:, None], 3, axis=1),
    )
    corners = [[-50, 0, 50], [60, 0, 50], [60, 0, -50], [-50, 0, -50]]
    white = ph.Material("diffuse", color=(1.0, 1.0, 1.0))
    floor = ph.Mesh(corners, [[0, 1, 2], [0, 2, 3]], material=white)
    camera = ph.Camera(
        eye=(0.0, 0.01, 0.0),
        target=(0.0, 0.0, 0.0),
        up=(0.0, 0.0, -1.0),
        projection="orthographic",
        height=LAMP_FLOOR,
    )
    return ph.Scene([floor, shining], camera=camera, background=None)
