"""The group `memory`: whether a picture's memory grows with its samples, and what scenes leave."""

from __future__ import annotations

import json
from typing import Any

from .process import Worker, run
from .scenes import cloud
from .summary import Row, ratios
from .worker import status_bytes

FEW, MANY = 16, 4096  # samples a pixel
SCENES, FIRST = 1000, 10  # what the first leave is kept for the others


def memory(plan: Any, notes: Any) -> list[Row]:
    """Peak of a process by samples a pixel, and how much more is resident after many scenes."""
    peaks: dict[int, list[float]] = {FEW: [], MANY: []}
    for _ in range(min(plan.rounds, 3)):
        for spp, runs in peaks.items():
            job = plan.job(cloud=10**5, glass=False, width=64, height=36, depth=8)
            worker = Worker("parhelion", job)
            try:
                runs.append(worker.render(spp)["peak_bytes"] / 1e6)
            finally:
                worker.close()
            notes.versions["parhelion"] = worker.known
    few, many = f"{FEW} spp", f"{MANY:,} spp"
    pairs = ratios(peaks[MANY], peaks[FEW])
    rows = [
        Row("memory, peak", few, "MB", peaks[FEW]),
        Row("memory, peak", many, "MB", peaks[MANY], against=few, ratios=pairs, most_ratio=1.02),
    ]
    left = json.loads(run("-c", "from bench.memory import child; child()"))
    if left is None:
        notes.add("what scenes leave was not measured: only Linux tells what a process holds")
        return rows
    return [*rows, Row("memory", f"{SCENES:,} scenes leave", "MB", [left / 1e6], most=20.0)]


def child() -> None:
    """Builds and renders scenes of some 1e3 to 6e4 spheres; prints how many bytes more are resident
    after all of them than after the first few, or null where nothing tells.
    """
    import numpy as np

    import parhelion as ph

    rng = np.random.default_rng(2)
    camera = ph.Camera(eye=(0.5, 0.5, 3), target=(0.5, 0.5, 0.5), vfov=30)
    white = ph.Background("constant", radiance=(1.0, 1.0, 1.0))
    first = None
    for number in range(1, SCENES + 1):
        spheres = ph.Spheres(*cloud(int(rng.integers(1000, 60_000))))
        scene = ph.Scene([spheres], camera=camera, background=white)
        ph.render(scene, width=32, height=18, spp=1, max_depth=8)
        if number == FIRST:
            first = status_bytes("VmRSS")
    last = status_bytes("VmRSS")
    print(json.dumps(None if first is None or last is None else last - first))
