"""The group `memory`: whether a picture's memory grows with its samples, and what scenes leave.

Only Linux tells what a process holds, and lets it forget what it once held.
"""

from __future__ import annotations

import sys
from typing import Any

from .process import run
from .scenes import BenchError, cloud
from .summary import Row, ratios
from .worker import status_bytes

FEW, MANY = 16, 4096  # samples a pixel
SCENES, FIRST = 1000, 10  # what the first leave is kept for the others


def memory(plan: Any, _notes: Any) -> list[Row]:
    """The peak while a picture is rendered, by samples a pixel, and how much more is resident after
    many scenes.
    """
    if sys.platform != "linux":
        raise BenchError("only Linux tells what a process holds")
    peaks: dict[int, list[float]] = {FEW: [], MANY: []}
    for _ in range(min(plan.rounds, 3)):
        for spp, runs in peaks.items():
            runs.append(_asked(f"peak({spp})") / 1e6)
    few, many = f"{FEW} spp", f"{MANY:,} spp"
    pairs = ratios(peaks[MANY], peaks[FEW])
    left = _asked("left()") / 1e6
    return [
        Row("memory, peak", few, "MB", peaks[FEW]),
        Row("memory, peak", many, "MB", peaks[MANY], against=few, ratios=pairs, most_ratio=1.02),
        Row("memory", f"{SCENES:,} scenes leave", "MB", [left], most=20.0),
    ]


def _asked(call: str) -> int:
    """Of a process of its own."""
    code = f"from bench.memory import left, peak; print({call})"
    return int(run("-c", code))


def peak(spp: int) -> int:
    """The most bytes that this process holds while it renders a cloud of 1e5 spheres. What it held
    while it made the tree, which is more, does not count.
    """
    import parhelion as ph

    from .gallery import cloud_scene

    prepared = ph.prepare(cloud_scene(10**5))
    with open("/proc/self/clear_refs", "w") as forget:
        forget.write("5")  # the peak so far
    ph.render(prepared, width=64, height=36, spp=spp, max_depth=8)
    return _bytes("VmHWM")


def left() -> int:
    """How many bytes more are resident after scenes of some 1e3 to 6e4 spheres, each of which was
    made and rendered, than after the first few.
    """
    import numpy as np

    import parhelion as ph

    rng = np.random.default_rng(2)
    camera = ph.Camera(eye=(0.5, 0.5, 3), target=(0.5, 0.5, 0.5), vfov=30)
    white = ph.Background("constant", radiance=(1.0, 1.0, 1.0))
    first = 0
    for number in range(1, SCENES + 1):
        spheres = ph.Spheres(*cloud(int(rng.integers(1000, 60_000))))
        scene = ph.Scene([spheres], camera=camera, background=white)
        ph.render(scene, width=32, height=18, spp=1, max_depth=8)
        if number == FIRST:
            first = _bytes("VmRSS")
    return _bytes("VmRSS") - first


def _bytes(field: str) -> int:
    held = status_bytes(field)
    assert held is not None  # on Linux
    return held
