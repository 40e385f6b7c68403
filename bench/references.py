"""The group `references`: scenes that others made, rendered by us, by Mitsuba and by Tungsten.

The same XML goes to both live renderers, with equal samples and a box filter: with others Mitsuba
spreads each sample over pixels, divides by the sum of weights, and takes no samples outside of the
picture. Each renders BATCHES pictures with seeds of their own; the test is the one of
tests/reference_tools.py, with both noises measured. Pictures and a table go to the folder
`references` in the cache.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .process import Worker
from .scenes import REPOSITORY, BenchError
from .summary import Row, markdown

SHARED = REPOSITORY.parent / "shared" / "scenes"

# Where scenes are looked for.
PATTERNS = (
    "mitsuba-data/tests/scenes/*/*.xml",
    "mitsuba-data/docs/scenes/*.xml",
    "mitsuba-data/scenes/*.xml",
    "mitsuba-data/scenes/cbox/*.xml",
    "mitsuba-data/scenes/matpreview/*.xml",
    "bitterli-*/mitsuba3/scene.xml",
    "bitterli-*/scene-v4.pbrt",
)

# What other than a file's own values makes it the scene of the reference; see the MANIFEST there.
DEFINES = {"bitterli-cornell-box": {"max_depth": "65"}, "bitterli-veach-mis": {"max_depth": "2"}}

# Independent pictures of each renderer, samples a pixel of each, and the longer side in pixels.
BATCHES, SPP, SIDE = 16, 16, 160

# Of Bitterli's scenes against Tungsten's pictures: a large picture, since FLIP sees noise too.
TUNGSTEN_SPP, TUNGSTEN_COARSER = 64, 2


def references(plan: Any, notes: Any) -> list[Row]:
    """Ratio of the means of the pictures, and FLIP, by scene."""
    if not SHARED.is_dir():
        raise BenchError(f"{SHARED}: no such folder")
    folder = plan.cache / "references"
    folder.mkdir(parents=True, exist_ok=True)
    peer = next((name for name in plan.peers if name.startswith("mitsuba")), None)
    if peer is None:
        notes.add("references: no Mitsuba to compare with; only Tungsten's pictures")
    found: list[dict[str, Any]] = []
    for name, path, defines in _scenes():
        print(f"  {name}", file=sys.stderr)
        try:
            size = _size(path, defines)
        except BenchError as problem:
            notes.add(f"references: {name} was not compared: {problem}")
            continue
        job = {"xml": str(path), "defines": defines, "allow": str(SHARED), "threads": plan.threads}
        try:
            if peer is not None and path.suffix == ".xml":
                found.append({"scene": name} | _live(notes, peer, job, size, folder))
            for above in (path.parent, path.parent.parent):
                picture = above / "TungstenRender.exr"
                if picture.exists():
                    found.append({"scene": name} | _tungsten(job, picture, folder))
        except BenchError as problem:
            notes.add(f"references: {name} was not compared: {problem}")
    (folder / "references.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (folder / "references.md").write_text(report(found) + "\n", encoding="utf-8")
    notes.add(f"references: pictures and tables are in {folder}")
    rows = []
    for one in found:
        what = f"{one['scene']} / {one['against']}"
        rows.append(Row("mean of", what, "x", one["ratio"]))
        rows.append(Row("FLIP of", what, "", [one["flip"]]))
        if one["p"] is not None and one["p"] < 0.01:
            notes.add(f"references: {what} differ: {one['verdict']}")
    return rows


def report(found: list[dict[str, Any]]) -> str:
    """A Markdown table, one line a comparison."""
    cells = [["scene", "against", "mean (R G B)", "p", "FLIP"]]
    for one in found:
        cells.append(
            [
                one["scene"],
                one["against"],
                " ".join(f"{ratio:.4f}" for ratio in one["ratio"]),
                "" if one["p"] is None else f"{one['p']:.2g}",
                f"{one['flip']:.4f}",
            ]
        )
    return markdown(cells)


def _scenes() -> Iterator[tuple[str, Path, dict[str, str]]]:
    """Name, file and defines of each."""
    for pattern in PATTERNS:
        for path in sorted(SHARED.glob(pattern)):
            set_name = path.relative_to(SHARED).parts[0]
            pbrt = path.suffix == ".pbrt"
            name = set_name if pbrt or set_name in DEFINES else path.stem
            yield name + " (pbrt)" * pbrt, path, {} if pbrt else DEFINES.get(set_name, {})


def _size(path: Path, defines: dict[str, str]) -> tuple[int, int]:
    """The size to render. Raises BenchError for a scene that asks for what we do not do, but for
    what stands for it in pbrt's conversions.
    """
    import parhelion as ph
    from parhelion.io import LoadOptions

    try:
        options = LoadOptions(
            defines=defines, allow_paths=(str(SHARED),), strict=path.suffix == ".xml"
        )
        settings = ph.load(path, options).settings
    except ph.ParhelionError as error:
        raise BenchError(str(error)) from error
    return smaller(settings.width, settings.height)


def smaller(width: int, height: int) -> tuple[int, int]:
    """A size of about SIDE pixels and of the same aspect ratio, or of the nearest there is.

    A picture of another ratio would be another view for a camera whose angle is that of one side.
    """
    if max(width, height) <= SIDE:
        return width, height
    sizes = [
        (round(width * n / height), n) if width >= height else (n, round(height * n / width))
        for n in range(SIDE * min(width, height) // (2 * max(width, height)), min(width, height))
    ]
    sizes = [size for size in sizes if max(size) <= SIDE]
    return min(reversed(sizes), key=lambda size: abs(size[0] * height / (size[1] * width) - 1.0))


def _live(
    notes: Any,
    peer: str,
    job: dict[str, Any],
    size: tuple[int, int],
    folder: Path,
) -> dict[str, Any]:
    """Ours against Mitsuba, each in a process of its own, one after the other."""
    import numpy as np
    from tests.reference_tools import Batches, compare, save_side_by_side

    from .measure import OURS, PEERS

    module, variant = PEERS[peer]
    pictures = {}
    for name, renderer, more in ((OURS, OURS, {}), (peer, module, variant)):
        worker = Worker(renderer, job | {"width": size[0], "height": size[1]} | more)
        notes.versions.setdefault(name, worker.known)
        try:
            path = folder / "part.npy"
            parts = []
            for seed in range(1, BATCHES + 1):
                worker.render(SPP, seed, path)
                parts.append(np.load(path)[..., :3].astype(np.float64))
            path.unlink()
        finally:
            worker.close()
        pictures[name] = Batches(np.stack(parts))
    ours, theirs = pictures[OURS], pictures[peer]
    verdict = compare(ours, theirs, SPP)
    name = "-".join(Path(job["xml"]).relative_to(SHARED).with_suffix("").parts)
    save_side_by_side(ours.mean, theirs.mean, folder / f"{name}.png")
    return {
        "against": peer,
        "ratio": [float(r) for r in verdict.ratio],
        "p": verdict.test.p,
        "verdict": str(verdict),
        "flip": seen(ours.mean, theirs.mean),
        "samples": BATCHES * SPP,
        "size": list(size),
    }


def _tungsten(job: dict[str, Any], path: Path, folder: Path) -> dict[str, Any]:
    """Ours against Tungsten's picture, which has no variance: means and FLIP."""
    import numpy as np
    from tests.reference_tools import read_linear, save_side_by_side

    from .measure import OURS

    picture = read_linear(path).astype(np.float64)
    n = TUNGSTEN_COARSER
    height, width = (side // n for side in picture.shape[:2])
    picture = picture.reshape(height, n, width, n, 3).mean(axis=(1, 3))
    worker = Worker(OURS, job | {"width": width, "height": height})
    part = folder / "part.npy"
    try:
        worker.render(TUNGSTEN_SPP, 0, part)
        ours = np.load(part).astype(np.float64)
        part.unlink()
    finally:
        worker.close()
    save_side_by_side(
        ours, picture, folder / f"{path.parent.name}-{Path(job['xml']).stem}-tungsten.png"
    )
    ratio = ours.mean(axis=(0, 1)) / picture.mean(axis=(0, 1))
    return {
        "against": "Tungsten",
        "ratio": [float(r) for r in ratio],
        "p": None,
        "verdict": None,
        "flip": seen(ours, picture),
        "samples": TUNGSTEN_SPP,
        "size": [width, height],
    }


def seen(ours: Any, reference: Any) -> float:
    """Mean HDR-FLIP (Andersson et al. 2021) of linear pictures."""
    import numpy as np

    from parhelion.flip import flip

    return float(flip(np.maximum(ours, 0.0), np.maximum(reference, 0.0), hdr=True).mean())
