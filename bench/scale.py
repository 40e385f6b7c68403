"""Draws what the group `clouds` has measured, against the number of spheres, and what lies beyond.

    python -m bench.scale RESULT.json -o docs/images/scale.svg

A line through the two largest clouds goes on to ten times the largest: seconds and bytes a sphere
by their slope over the logarithm of the number, as a tree has a level more for every sixteen times
the spheres.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

# row -> (what the axis says, factor, whether it is taken by the sphere)
PANELS = {
    "checks and tree, processor": ("ns of one core a sphere, tree", 1e9, True),
    "peak memory beyond the input": ("peak memory beyond the input, B a sphere", 1.0, False),
    "whole paths": ("M rays/s and core, whole paths", 1.0, False),
}


def measured(rows: list[dict[str, Any]], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of spheres, ascending, and the medians of one row of diffuse clouds."""
    found = {
        float(row["group"].removesuffix(" spheres")): row["median"]
        for row in rows
        if row["name"] == name and row["group"].endswith(" spheres")
    }
    if len(found) < 2:
        raise SystemExit(f"two clouds or more are needed, not {len(found)}")
    return np.array(sorted(found)), np.array([found[n] for n in sorted(found)])


def beyond(count: np.ndarray, value: np.ndarray) -> tuple[float, float]:
    """Ten times the largest number, and what the line through the last two says of it."""
    slope = (value[-1] - value[-2]) / np.log10(count[-1] / count[-2])
    return 10 * count[-1], float(value[-1] + slope)


def main() -> None:
    p = argparse.ArgumentParser(prog="python -m bench.scale", description="Draw clouds by size.")
    p.add_argument("result", type=Path, metavar="RESULT.json")
    p.add_argument("-o", "--output", type=Path, default=Path("scale.svg"))
    args = p.parse_args()
    rows = json.loads(args.result.read_text())["rows"]

    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "parhelion"
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(PANELS), figsize=(11, 3.2), layout="constrained")
    for axis, (name, (label, factor, by_sphere)) in zip(axes, PANELS.items(), strict=True):
        count, value = measured(rows, name)
        value = value * factor / (count if by_sphere else 1.0)
        far, there = beyond(count, value)
        print(f"{label}: {there:.3g} at {far:.0e}")
        axis.plot(count, value, "o-", color="C0", label="measured")
        axis.plot([count[-1], far], [value[-1], there], "o--", color="C1", label="by the slope")
        axis.set(xscale="log", xlabel="spheres", ylabel=label, ylim=(0, None))
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(args.output, metadata={"Date": None})


if __name__ == "__main__":
    main()
