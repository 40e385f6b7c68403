"""The group `noise`: whether pictures are as near to the truth as `--noise` was asked for.

Each scene is rendered RUNS times with different seeds until its noise is EPS. The truth is a
picture with other seeds and, in every pixel, REFERENCE times the samples that these took on
average; it comes in BATCHES parts, whose spread tells what noise is left in it.

- "within": the share of pixels within EPS, as a run has it; 0.95 is asked of 95 of 100 runs.
- "error": what a run says, over what it is: root mean squares over the picture.
- "mean": of all runs' pictures, over that of the truth. Deciding by the samples that are averaged
  would make it less than 1.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

from .scenes import REPOSITORY, SHARED, BenchError
from .summary import Row

EPS, SIZE, RUNS = 0.15, 64 * 36, 10
# Samples of the truth over the average number of samples of the runs, and parts that it is made in.
REFERENCE, BATCHES = 16, 4
# Seconds for a run, at most: what takes longer is left out, and told.
LIMIT = 60.0


def scenes() -> dict[str, Callable[[], Any]]:
    """The gallery, the repository's own scenes, and files that others made."""
    import parhelion as ph
    from parhelion.io import LoadOptions

    from .gallery import SCENES, of_file

    own = {
        path.stem: partial(ph.load, path) for path in sorted((REPOSITORY / "scenes").glob("*.json"))
    }
    files = {
        "teapot": "bitterli-teapot-full/scene-v4.pbrt",
        "killeroo": "pbrt-v1v3/killeroo-v3/killeroo-simple.pbrt",
        "sphereflake": "pbrt-v1v3/sphereflake-v1/balls.pbrt",
        "cbox": "mitsuba-data/scenes/cbox/cbox-rgb.xml",
        "duck": "gltf/khronos-small/Duck.glb",
        "truck": "gltf/khronos-small/CesiumMilkTruck.glb",
        "spot": "mesh/spot.obj",
        "haemoglobin": "particles/chemfiles/pdb/4hhb.pdb",
        "salt": "particles/chemfiles/lammps/nacl.lammpstrj",
    }
    environment = LoadOptions(
        environment=str(SHARED / "hdr" / "studio.hdr"), allow_paths=(str(SHARED),)
    )
    found = {
        name: partial(of_file, path) for name, path in files.items() if (SHARED / path).exists()
    }
    lit = {"suzanne": partial(ph.load, SHARED / "mesh" / "suzanne.obj", environment)}
    return {**SCENES, **own, **found, **lit}


def noise(plan: Any, notes: Any) -> list[Row]:
    """Rows of each scene, and in how many runs 95 of 100 pixels are near enough."""
    rows, within = [], []
    for name, make in scenes().items():
        print(f"  {name}", file=sys.stderr)
        try:
            of_scene = _scene(plan, notes, name, make)
        except BenchError as problem:
            notes.add(f"noise: {name} was not measured: {problem}")
            continue
        rows += of_scene
        within += [share >= 0.95 for share in of_scene[0].runs]
    if within:
        notes.add(
            f"noise: in {sum(within)} of {len(within)} runs of {len(rows) // 4} scenes at least 95"
            f" of 100 pixels are within {EPS:g}"
        )
    return rows


def _scene(plan: Any, notes: Any, name: str, make: Callable[[], Any]) -> list[Row]:
    import numpy as np

    import parhelion as ph
    from parhelion.progressive import CONFIDENCE

    from .gallery import fitted

    try:
        scene = fitted(make(), SIZE)
    except ph.ParhelionError as error:
        raise BenchError(str(error)) from error
    prepared = ph.prepare(scene)
    run = partial(ph.render, prepared, threads=plan.threads)
    images = [run(noise=EPS, seed=seed, time_limit=LIMIT) for seed in range(RUNS)]
    if any(image.stats.ended != "noise" for image in images):
        raise BenchError(f"a run took more than {LIMIT:g} s")
    spp = int(np.mean([image.counts.mean() for image in images]) * REFERENCE / BATCHES)
    parts = [run(spp=spp, seed=RUNS + batch).numpy().astype(float) for batch in range(BATCHES)]
    truth = np.mean(parts, axis=0)
    brightness = truth.mean(axis=2) + 0.01 * truth.mean()
    away = [np.sqrt(((image.numpy() - truth) ** 2).mean(axis=2)) / brightness for image in images]
    errors = [CONFIDENCE * np.sqrt((pixels**2).mean()) for pixels in away]
    means = np.array([image.numpy().astype(float).mean() for image in images]) / truth.mean()
    of_parts = np.array([part.mean() for part in parts]) / truth.mean()
    spread = np.sqrt(means.var(ddof=1) / RUNS + of_parts.var(ddof=1) / BATCHES)
    if abs(means.mean() - 1.0) > 3.0 * spread:
        notes.add(
            f"noise: {name}: the mean is off by {(means.mean() - 1) / spread:.1f} times its spread"
        )
    group = f"noise, {name}"
    return [
        Row(group, "within", "", [float((a <= EPS).mean()) for a in away], more=True),
        Row(
            group,
            "error told / true",
            "x",
            [i.stats.error / e for i, e in zip(images, errors, strict=True)],
        ),
        Row(group, "mean / true", "x", means.tolist()),
        Row(group, "spp", "", [float(image.counts.mean()) for image in images]),
    ]
