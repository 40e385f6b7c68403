"""How many instructions the hot kernels take, which other programs and the clock do not change.

    python -m bench.instructions            compares with bench/instructions.json, ends with 1 if a
                                            kernel takes over 2 % more
    python -m bench.instructions --renew    keeps what it counts there, for this compiler

Callgrind counts (valgrind must be installed). It knows no AVX-512, so kernels are AVX2's. Counts
depend on the compiler and are kept for each; they are the same from run to run to 0.1 %, and
say nothing of caches or of branches that are mispredicted.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from .process import environment
from .scenes import REPOSITORY, BenchError

KEPT = Path(__file__).with_name("instructions.json")
ISA = "avx2"

# What a kernel may take more without that being a failure.
TOLERANCE = 0.02

# A function of the C library that nothing else calls: callgrind writes down its counts, and begins
# anew, whenever it is entered.
MARK = "sched_get_priority_max"

# Rays of a query, and pixels of a side and samples of a picture.
RAYS, SIDE, SPP = 4096, 24, 16


def kernels() -> Iterator[tuple[str, int, Callable[[], Any]]]:
    """Name, number of rays or samples, and what is counted."""
    import numpy as np

    import parhelion as ph

    from .gallery import lamp_mesh
    from .rays import camera_rays, onwards, wavy_sphere

    vertices, faces = wavy_sphere(1000)
    rng = np.random.default_rng(1)
    some = rng.permutation(len(camera_rays()[0]))[: 2 * RAYS]
    eyes, views = (array[some] for array in camera_rays())
    shapes: dict[str, Any] = {
        "spheres": ph.Spheres(rng.uniform(-1.0, 1.0, (1000, 3)), 0.05),
        "triangles": ph.Mesh(vertices, faces),
    }
    for name, shape in shapes.items():
        core = ph.prepare(ph.Scene([shape])).core
        start, away = onwards(eyes, views, core.intersect(eyes, views)[0])["bounce"]
        o, d, far = start[:RAYS], away[:RAYS], np.full(RAYS, np.inf, np.float32)
        assert len(o) == RAYS, "too few of the camera's rays hit something"
        yield f"{name}, nearest hit", RAYS, lambda c=core, o=o, d=d: c.intersect(o, d, isa=ISA)
        yield f"{name}, any hit", RAYS, lambda c=core, o=o, d=d, f=far: c.occluded(o, d, f, isa=ISA)

    white = ph.Background("constant", radiance=(1.0, 1.0, 1.0))
    camera = ph.Camera(eye=(0, 1, 1), target=(0, 0, 0), vfov=40, aperture_radius=0.01)
    corners = [[-9, 0, 9], [9, 0, 9], [9, 0, -9], [-9, 0, -9]]
    uvs = [[0, 0], [9, 0], [9, 9], [0, 9]]

    def picture(name: str, scene: ph.Scene, depth: int) -> tuple[str, int, Callable[[], Any]]:
        prepared = ph.prepare(scene.replace(camera=camera))
        size = {"width": SIDE, "height": SIDE, "spp": SPP, "max_depth": depth}
        options = {"filter": "box", "filter_radius": 0.5, "threads": 1, "isa": ISA}
        return name, SIDE * SIDE * SPP, lambda: ph.render(prepared, **size, **options)

    def floor(material: ph.Material) -> ph.Mesh:
        return ph.Mesh(corners, [[0, 1, 2], [0, 2, 3]], uvs=uvs, material=material)

    yield picture("camera rays, sky and film", ph.Scene(background=white), 1)
    texels = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    materials = {
        "diffuse": ph.Material("diffuse"),
        "conductor": ph.Material("conductor", roughness=0.4),
        "glass": ph.Material("dielectric"),
        "plastic": ph.Material("plastic", roughness=0.3),
        "principled, textured": ph.Material(
            "principled", color=ph.Texture("image", image=texels), roughness=0.4, metallic=0.5
        ),
    }
    for name, material in materials.items():
        yield picture(f"a bounce, {name}", ph.Scene([floor(material)], background=white), 2)

    def lit(count: int) -> list[Any]:
        return [floor(ph.Material("diffuse")), lamp_mesh(count)]

    yield picture("light from 2 lamps", ph.Scene(lit(2), background=None), 2)
    yield picture("light from 1,000 lamps", ph.Scene(lit(1000), background=None), 2)
    panorama = rng.gamma(0.2, size=(32, 64, 3)).astype(np.float32)
    sky = ph.Background("envmap", image=panorama)
    diffuse = floor(ph.Material("diffuse"))
    yield picture("light from a panorama", ph.Scene([diffuse], background=sky), 2)
    dust = ph.Spheres(rng.uniform(-0.3, 0.3, (50_000, 3)), 0.002)  # some three across a pixel
    yield picture("camera rays, spheres smaller than a pixel", ph.Scene([dust]), 1)


def child() -> None:
    """Runs all kernels, each once before it is counted; prints their names and numbers."""
    found = []
    for name, number, call in kernels():
        call()
        os.sched_get_priority_max(0)
        call()
        os.sched_get_priority_max(0)
        found.append((name, number))
    print(json.dumps(found))


def count() -> dict[str, float]:
    """Instructions for each ray or sample, by kernel."""
    if shutil.which("valgrind") is None:
        raise BenchError("valgrind is not installed")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "counts"
        done = subprocess.run(
            [
                *("valgrind", "--tool=callgrind", f"--dump-before={MARK}"),
                *(f"--callgrind-out-file={out}", sys.executable),
                *("-c", "from bench.instructions import child; child()"),
            ],
            capture_output=True,
            text=True,
            cwd=REPOSITORY,
            env=environment() | {"PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1"},
        )
        if done.returncode:
            raise BenchError(f"callgrind: {done.stderr.strip()[-500:]}")
        found = json.loads(done.stdout)
        totals = [
            total(out.with_name(f"counts.{1 + part}").read_text()) for part in range(2 * len(found))
        ]
    # What comes before a mark is what ran before it, in turns a first call and the one to count.
    return {
        name: round(instructions / number, 1)
        for (name, number), instructions in zip(found, totals[1::2], strict=True)
    }


def total(dump: str) -> int:
    """Of what callgrind wrote."""
    found = re.search(r"^totals: (\d+)$", dump, re.MULTILINE)
    if found is None:
        raise BenchError("callgrind wrote no total")
    return int(found[1])


def compiler(library: bytes) -> str:
    """Name and major version of the one that made a shared library, as its .comment says."""
    # A library made by clang also names GCC, whose start-up files it has.
    for name, pattern in (("clang", rb"clang version (\d+)"), ("gcc", rb"GCC: \([^)]*\) (\d+)")):
        found = re.search(pattern, library)
        if found:
            return f"{name} {found[1].decode()}"
    raise BenchError("the compiled core does not say by which compiler it was made")


def verdict(before: float | None, after: float) -> str:
    """more, fewer or same; or new, where none is kept."""
    if before is None:
        return "new"
    if after > before * (1 + TOLERANCE):
        return "more"
    return "fewer" if after < before * (1 - TOLERANCE) else "same"


def compare(before: dict[str, float], after: dict[str, float]) -> tuple[list[str], bool]:
    """Lines to show, and whether a kernel takes more or is gone."""
    lines, failed = [], False
    for name, value in after.items():
        word = verdict(before.get(name), value)
        change = "" if word == "new" else f" ({value / before[name] - 1:+.1%})"
        lines.append(f"{word:6} {name}: {value:.1f}{change}")
        failed = failed or word == "more"
    gone = [name for name in before if name not in after]
    return lines + [f"gone   {name}" for name in gone], failed or bool(gone)


def main() -> int:
    p = argparse.ArgumentParser(prog="python -m bench.instructions", description="Count them.")
    p.add_argument("--renew", action="store_true", help=f"keep the counts in {KEPT.name}")
    args = p.parse_args()
    try:
        from parhelion import _core

        kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
        name = compiler(Path(_core.__file__).read_bytes())
        counts = count()
        lines, failed = compare(kept.get(name, {}), counts)
    except (BenchError, OSError, ValueError) as problem:
        print(f"instructions: {problem}", file=sys.stderr)
        return 2
    print(f"{name}, {ISA}: instructions a ray or sample", *lines, sep="\n")
    if args.renew:
        part = KEPT.with_suffix(".part")
        part.write_text(json.dumps(kept | {name: counts}, indent=1) + "\n", encoding="utf-8")
        part.replace(KEPT)
        return 0
    if name not in kept:
        print(f"instructions: none are kept for {name}; --renew keeps these", file=sys.stderr)
        return 2
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
