"""How evenly shards of a picture share its work, and what they cost: python -m bench.shards.

Work is counted in rays, which are the same on every machine. "largest": the shard with the most
rays over the mean of all, for numbers of shards. "seconds": those of rendering all shards one after
another, over those of the whole picture, alternating; "merge": seconds to make one picture of
MERGED shards, "part": bytes of a file for each of its pixels.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from .scenes import SHARED

COUNTS = (4, 16, 64, 256)
MERGED = 4
SIZE = {"width": 960, "height": 540}
FILES = {
    "sphereflake": "pbrt-v1v3/sphereflake-v1/balls.pbrt",
    "cbox": "mitsuba-data/scenes/cbox/cbox-rgb.xml",
    "suzanne": "mesh/suzanne.obj",
    "haemoglobin": "particles/chemfiles/pdb/4hhb.pdb",
}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.shards")
    parser.add_argument("--rounds", type=int, default=3, help="of the timing")
    parser.add_argument("--threads", type=int, default=0)
    args = parser.parse_args()
    import numpy as np

    import parhelion as ph

    print("| scene | " + " | ".join(f"largest of {n}" for n in COUNTS), end="")
    print(" | seconds | merge, s | part |")
    print("|---" * (len(COUNTS) + 4) + "|")
    found = {name: SHARED / path for name, path in FILES.items() if (SHARED / path).exists()}
    for name, file in {"weekend": None, **found}.items():
        scene = ph.prepare(ph.weekend() if file is None else ph.load(file))
        with tempfile.TemporaryDirectory() as folder:
            largest = []
            for count in COUNTS:
                rays = [
                    ph.render(
                        scene,
                        spp=1,
                        threads=args.threads,
                        shard=(i + 1, count),
                        checkpoint=Path(folder) / f"{i}-of-{count}",
                        **SIZE,
                    ).stats.rays
                    for i in range(count)
                ]
                largest.append(max(rays) / np.mean(rays))
            shares = []
            for k in range(args.rounds):
                parts = [Path(folder) / f"{k}.{i}.part" for i in range(MERGED)]
                whole = ph.render(scene, spp=16, threads=args.threads, **SIZE).stats.seconds
                seconds = sum(
                    ph.render(
                        scene,
                        spp=16,
                        threads=args.threads,
                        shard=(i + 1, MERGED),
                        checkpoint=part,
                        **SIZE,
                    ).stats.seconds
                    for i, part in enumerate(parts)
                )
                shares.append(seconds / whole)
            start = time.perf_counter()
            ph.merge(parts)
            merging = time.perf_counter() - start
            size = sum(part.stat().st_size for part in parts) / (SIZE["width"] * SIZE["height"])
        cells = [f"{value:.2f}" for value in (*largest, float(np.median(shares)), merging)]
        print(f"| {name} | " + " | ".join(cells) + f" | {size:.0f} |", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
