"""The group `lights`: what choosing among many lights costs, and how well it is done.

A white floor under a cloud of small triangles that shine, from ten of them to a million. What the
floor must show is a sum over them, so errors are true ones.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from .process import Worker
from .scenes import LAMP_FLOOR, lamps
from .summary import Row

if TYPE_CHECKING:
    import numpy as np

COUNTS = (10, 100, 10**3, 10**4, 10**5, 10**6)

# Pixels of a side, every how manieth a sum is made for, and samples a pixel.
SIDE, STEP, SPP = 128, 8, 64


def lights(plan: Any, notes: Any) -> list[Row]:
    """By the number of lamps: preparing the scene, time a sample, error at equal samples."""
    import numpy as np

    rows = []
    plan = replace(plan, width=SIDE, height=SIDE, depth=2)
    plan.cache.mkdir(parents=True, exist_ok=True)
    path = plan.cache / "lights.npy"
    for count in COUNTS:
        expected = radiance(count)
        build, cost, error = [], [], []
        worker = Worker("parhelion", plan.job(lamps=count))
        try:
            worker.render(1)
            for seed in range(min(plan.rounds, 5)):
                seconds = worker.render(SPP, seed, path)["seconds"]
                cost.append(1e9 * seconds * plan.threads / (SIDE * SIDE * SPP))
                picture = np.load(path)[STEP // 2 :: STEP, STEP // 2 :: STEP, 0]
                error.append(float(np.sqrt(np.mean((picture / expected - 1) ** 2))))
        finally:
            worker.close()
        build.append(worker.known["prepare_seconds"])
        group = f"{count:.0e} lamps".replace("e+0", "e")
        rows += [
            Row(group, "checks and trees", "s", build),
            Row(group, "a sample, on one thread", "ns", cost),
            Row(group, f"relative error at {SPP} samples", "", error),
        ]
    path.unlink()
    notes.versions["parhelion"] = worker.known
    return rows


def radiance(count: int) -> np.ndarray:
    """Of the floor where it is compared, in double: the lamps are small enough for points, and so
    are pixels, over which it varies by some 1e-4.
    """
    import numpy as np

    vertices, shine = lamps(count)
    a, b, c = (vertices[:, k].astype(float) for k in range(3))
    area = 0.5 * np.cross(b - a, c - a)
    at = ((np.arange(STEP // 2, SIDE, STEP) + 0.5) / SIDE - 0.5) * LAMP_FLOOR
    total = np.zeros((at.size, at.size))
    # No array of more than some megabytes.
    for part in np.array_split(np.arange(count), max(1, count // 10**5)):
        middle = (a[part] + b[part] + c[part]) / 3
        for row, column in np.ndindex(total.shape):
            d = middle - [at[column], 0.0, at[row]]
            facing = np.abs(np.einsum("ij,ij->i", area[part], d))  # both sides shine
            distance2 = np.einsum("ij,ij->i", d, d)
            total[row, column] += np.sum(shine[part] * facing * d[:, 1] / distance2**2)
    return total / np.pi
