"""What there is in a set of particles to choose from, as `parhelion info` shows it."""

from __future__ import annotations

from typing import Any

import numpy as np

from .boxes import Box
from .colors import field_names, in_order
from .data import Labels, Particles


def contents(particles: Particles) -> dict[str, Any]:
    """Numbers of particles, elements and types, all fields, bonds and the box; without what is not
    known. Lengths are in the data's units, angles in degrees.
    """
    found: dict[str, Any] = {"particles": len(particles.positions)}
    kinds = {"elements": particles.elements, "types": particles.types}
    counted = {name: _counts(labels) for name, labels in kinds.items() if labels is not None}
    if "elements" in counted and _capitals(counted.get("types", {})) == counted["elements"]:
        counted.pop("types", None)
    found |= counted
    found["fields"] = field_names(particles)
    if particles.bonds is not None:
        found["bonds"] = len(particles.bonds)
    if particles.box is not None:
        found["box"] = _box(particles.box)
    return found


def _capitals(counts: dict[str, int]) -> dict[str, int]:
    """As symbols of elements are written."""
    return {name.capitalize(): count for name, count in counts.items()}


def _counts(labels: Labels) -> dict[str, int]:
    counts = np.bincount(labels.codes, minlength=len(labels.names)).tolist()
    found: dict[str, int] = {}
    for name, count in zip(labels.names, counts, strict=True):
        found[name] = found.get(name, 0) + count
    return {name: found[name] for name in sorted(found, key=in_order) if found[name]}


def _box(box: Box) -> dict[str, Any]:
    edges = np.asarray(box.vectors, np.float64)
    lengths = np.linalg.norm(edges, axis=1)
    a, b, c = edges / np.where(lengths > 0, lengths, 1.0)[:, None]
    cosines = np.clip([b @ c, c @ a, a @ b], -1.0, 1.0)
    return {
        "lengths": lengths.tolist(),
        "angles": np.degrees(np.arccos(cosines)).tolist(),
        "corner": np.asarray(box.origin, np.float64).tolist(),
        "periodic": [edge for edge, repeats in zip("abc", box.periodic, strict=True) if repeats],
    }
