"""Draws what the group `clouds` has measured, against the number of spheres, and what lies beyond.

    python -m bench.scale RESULT.json -o docs/images/scale.svg

A line through the two largest clouds goes on to ten times the largest: memory by its slope over the
number of spheres, speeds by theirs over its logarithm, as a tree has a level more for every sixteen
times the spheres.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

# row -> what the axis says, and the factor and the power of the number that bring it there
PANELS = {
    "checks and tree, processor": ("tree, ns of one core a sphere", 1e9, -1),
    "peak memory beyond the input": ("memory beyond the input, GB", 1e-9, 1),
    "whole paths": ("whole paths, M rays/s and core", 1.0, 0),
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


def beyond(count: np.ndarray, value: np.ndarray, *, linear: bool) -> tuple[float, float]:
    """Ten times the largest number, and what the line through the last two says of it."""
    far = 10 * count[-1]
    x = count if linear else np.log10(count)
    slope = (value[-1] - value[-2]) / (x[-1] - x[-2])
    return far, float(value[-1] + slope * ((far if linear else np.log10(far)) - x[-1]))


def main() -> None:
    p = argparse.ArgumentParser(prog="python -m bench.scale", description="Draw clouds by size.")
    p.add_argument("result", type=Path, metavar="RESULT.json")
    p.add_argument("-o", "--output", type=Path, default=Path("scale.svg"))
    args = p.parse_args()
    rows = json.loads(args.result.read_text())["rows"]

    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.hashsalt": "parhelion", "svg.fonttype": "none"})
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(PANELS), figsize=(11, 3.2), layout="constrained")
    for axis, (name, (label, factor, power)) in zip(axes, PANELS.items(), strict=True):
        count, value = measured(rows, name)
        value = value * factor * count**power
        far, there = beyond(count, value, linear=power == 1)
        print(f"{label}: {there:.3g} at {far:.0e}")
        axis.plot(count, value, "o-", color="C0", label="measured")
        axis.plot([count[-1], far], [value[-1], there], "o--", color="C1", label="by the slope")
        axis.set(xscale="log", xlabel="spheres", ylabel=label)
        if power == 1:
            axis.set_yscale("log")
        else:
            axis.set_ylim(0, None)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(args.output, metadata={"Date": None} if args.output.suffix == ".svg" else None)


if __name__ == "__main__":
    main()
