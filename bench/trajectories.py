"""The group `trajectories`: reading LAMMPS dumps, one large frame or a hundred, in bounded memory.

Each run is a process of its own: `python -m bench.trajectories HOW FILE` prints JSON. Times are CPU
seconds, the system's included: all of it is work of one thread, and other programs count for less.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from .process import run
from .summary import Row, ratios
from .worker import peak_bytes

LINES, LONG = 10**6, 10**7
FRAMES = 100
COLUMNS = "id type x y z vx vy vz"
# Bytes that the parser alone gets at a time, as the reader does
BLOCK = 1 << 20


def trajectories(plan: Any, notes: Any) -> list[Row]:
    """Lines a second, ours and of NumPy's parser alone; memory; and looking for frames."""
    lines = LONG if plan.long else LINES
    plan.cache.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for frames in (1, FRAMES):
        path = plan.cache / f"{frames}.lammpstrj"
        write(path, frames, lines // frames)
        group = f"dump of {frames} x {lines // frames:.0e} lines".replace("e+0", "e")
        found: dict[str, list[dict[str, float]]] = {"read": [], "loadtxt": []}
        for _ in range(plan.rounds):
            for how, results in found.items():
                results.append(json.loads(run("-m", "bench.trajectories", how, str(path))))
        speed = {how: [1e-6 * lines / r["seconds"] for r in found[how]] for how in found}
        against = ratios(speed["loadtxt"], speed["read"])
        ours = found["read"]
        rows += [
            Row(group, "read", "M lines/s", speed["read"], more=True),
            Row(group, "numpy.loadtxt alone", "M lines/s", speed["loadtxt"], True, "read", against),
            Row(group, "looking for frames", "s", [r["index"] for r in ours]),
            Row(group, "arrays of a frame", "MB", [1e-6 * r["arrays"] for r in ours[:1]]),
            Row(group, "peak memory beyond imports", "MB", [1e-6 * r["peak"] for r in ours]),
        ]
        notes.add(f"{group}: {path.stat().st_size / 1e6:.0f} MB")
        path.unlink()
    return rows


def write(path: Path, frames: int, atoms: int) -> None:
    """A dump of random positions and velocities."""
    import numpy as np

    random = np.random.default_rng(0)
    with path.open("w") as file:
        for step in range(frames):
            file.write(
                f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{atoms}\n"
                f"ITEM: BOX BOUNDS pp pp pp\n0 100\n0 100\n0 100\nITEM: ATOMS {COLUMNS}\n"
            )
            for start in range(0, atoms, 10**5):
                count = min(10**5, atoms - start)
                ids, types = np.arange(start, start + count) + 1, random.integers(1, 4, count)
                numbers = np.hstack(
                    [100 * random.random((count, 3)), random.normal(size=(count, 3))]
                )
                line = "%d %d %.5f %.5f %.5f %.5f %.5f %.5f\n"
                rows = zip(ids.tolist(), types.tolist(), *numbers.T.tolist(), strict=True)
                file.write("".join(line % row for row in rows))


def read(path: Path) -> dict[str, float]:
    """Our reader, frame after frame."""
    from parhelion.io import LoadOptions, lammps

    before = peak_bytes()
    start = time.process_time()
    with lammps.trajectory(path, LoadOptions()) as trajectory:
        index = time.process_time() - start
        for frame in range(trajectory.count):
            particles = trajectory.read(frame)
    seconds = time.process_time() - start
    kept = [particles.positions, *particles.fields.values()]
    if particles.types is not None:
        kept.append(particles.types.codes)
    size = sum(getattr(array, "nbytes", 0) for array in kept)
    return {"seconds": seconds, "index": index, "arrays": size, "peak": peak_bytes() - before}


def loadtxt(path: Path) -> dict[str, float]:
    """NumPy's parser of text, on the lines of atoms alone; what it returns is thrown away."""
    import numpy as np

    seconds = 0.0
    with path.open() as file:
        while lines := file.readlines(BLOCK):
            numbers = [line for line in lines if line.count(" ") == COLUMNS.count(" ")]
            numbers = [line for line in numbers if not line.startswith("ITEM")]
            start = time.process_time()
            np.loadtxt(numbers, comments=None)
            seconds += time.process_time() - start
    return {"seconds": seconds}


if __name__ == "__main__":
    how = {"read": read, "loadtxt": loadtxt}[sys.argv[1]]
    print(json.dumps(how(Path(sys.argv[2]))))
