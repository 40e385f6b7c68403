"""The scenes that are measured, as plain lists and arrays that every renderer can be given."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")

REPOSITORY = Path(__file__).resolve().parent.parent
SHARED = REPOSITORY.parent / "shared" / "scenes"
WEEKEND = SHARED / "weekend" / "spheres.json"

# Names of what bench/gallery.py makes, which takes more imports than a command's options should.
GALLERY = (
    "weekend",
    "cornell-box",
    "veach-mis",
    "plastic",
    "rough-gold",
    "helmet",
    "sponza",
    "coffee",
    "classroom",
    "lamps-1e3",
    "cloud-1e4",
    "cloud-1e6",
)


class BenchError(Exception):
    """Something that the person who runs the measurement can mend; its text says what."""


def by_scene(
    plan: Any, notes: Any, group: str, measure: Callable[[Any, Any, str], list[T]]
) -> Iterator[list[T]]:
    """What a group measures on each of the plan's scenes that can be measured, one after the other;
    notes say of the others why not. measure: gets plan, notes and the scene's name.
    """
    for name in plan.scenes:
        print(f"measuring: {name}", file=sys.stderr)
        try:
            found = measure(plan, notes, name)
        except BenchError as problem:
            notes.add(f"{group}, {name}: not measured: {problem}")
            continue
        yield found


@dataclass(frozen=True)
class Weekend:
    """camera, sky and spheres as in the file; lengths in its own unit, colours linear RGB."""

    camera: dict[str, Any]
    sky: dict[str, Any]
    spheres: list[dict[str, Any]]

    def of(self, kind: str) -> Iterator[dict[str, Any]]:
        """The spheres of one kind: diffuse, metal or glass."""
        return (s for s in self.spheres if s["type"] == kind)


def read_weekend(path: Path, *, fuzz: bool = True) -> Weekend:
    """Reads a spheres.json. Without fuzz every metal is a mirror.

    Raises BenchError if there is no such file, or not of this form.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BenchError(f"{path}: no such file; name a spheres.json with --spheres") from None
    except (OSError, ValueError) as error:
        raise BenchError(f"{path}: {error}") from error
    try:
        camera = {k: data["camera"][k] for k in ("lookfrom", "lookat", "vup", "vfov")}
        camera["focus_distance"] = data["camera"]["focus_dist"]
        camera["aperture_radius"] = data["camera"]["lens_radius"]
        sky = {k: data["sky"][k] for k in ("horizon", "zenith")}
        names = ("center", "radius", "type", "albedo", "fuzz", "ior")
        spheres = [{k: s[k] for k in names} for s in data["spheres"]]
    except (KeyError, TypeError) as error:
        raise BenchError(f"{path}: not a list of spheres with camera and sky: {error}") from error
    unknown = {s["type"] for s in spheres} - {"diffuse", "metal", "glass"}
    if unknown:
        raise BenchError(f"{path}: unknown type {min(unknown)!r}; diffuse, metal or glass")
    if not fuzz:
        for sphere in spheres:
            sphere["fuzz"] = 0.0
    return Weekend(camera, sky, spheres)


def cloud(count: int) -> tuple[np.ndarray, float]:
    """Centres, (count, 3) float32 at random in the unit box, and the radius of all.

    The radius shrinks so that the share of the box that is filled does not depend on count.
    """
    import numpy as np

    centers = np.random.default_rng(1).random((count, 3), dtype=np.float32)
    return centers, 0.25 * count ** (-1 / 3)


# Side of the floor's part that a picture of lamps shows.
LAMP_FLOOR = 2.0


def lamps(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles over a floor, (count, 3, 3) of vertices, and the radiance of each, (count,).

    All together are as large however many there are, and so small that none hides another.
    """
    import numpy as np

    rng = np.random.default_rng(3)
    centers = rng.uniform((-1.5, 0.5, -1.5), (1.5, 1.5, 1.5), (count, 3))
    corners = rng.normal(size=(count, 3, 3)) * (2e-3 / np.sqrt(count))
    return centers[:, None] + corners, rng.uniform(0, 2e6, count)
