"""The group `surfaces`: each kind of material and shape, ours beside Mitsuba's LLVM variant.

The gallery has few kinds of materials, so what is slow of the others does not show there. Twenty
things of one kind stand on a matte floor, under an even sky or under one lamp; both renderers read
the same XML. "equal samples": others' time over ours. "equal error": the same, times their trimmed
error over ours, each against the renderer's own picture of `--reference-spp` samples.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

from .process import Worker, in_turn
from .scenes import BenchError
from .summary import Row, ratios

WIDTH, HEIGHT, SPP, DEPTH = 320, 180, 16, 12
REFERENCE_SEED = 1_000_000

SCENE = """<scene version="3.0.0">
<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/>
<transform name="to_world"><lookat origin="0,-8,4" target="0,0,0.8" up="0,0,1"/></transform>
<sampler type="independent"/><film type="hdrfilm"><integer name="width" value="{width}"/>
<integer name="height" value="{height}"/><rfilter type="box"/></film></sensor>
{light}
<shape type="rectangle"><transform name="to_world"><scale value="20"/></transform>
<bsdf type="diffuse"/></shape>
{things}
</scene>
"""

LIGHTS = {
    "sky": '<emitter type="constant"><rgb name="radiance" value="1"/></emitter>',
    "lamp": '<shape type="rectangle"><transform name="to_world"><scale value="1.5"/><rotate x="1"'
    ' angle="180"/><translate z="6"/></transform><emitter type="area"><rgb name="radiance"'
    ' value="12"/></emitter></shape>',
}


def _bsdf(kind: str, inside: str = "", **values: float | str) -> str:
    """One element; values: its parameters, numbers or names."""
    lines = [
        f'<string name="{name}" value="{value}"/>'
        if isinstance(value, str)
        else f'<float name="{name}" value="{value}"/>'
        for name, value in values.items()
    ]
    return f'<bsdf type="{kind}">{"".join(lines)}{inside}</bsdf>'


# Materials as Mitsuba has them. Its principled one differs from ours in its lobes.
MATERIALS = {
    "diffuse": _bsdf("diffuse"),
    "conductor": _bsdf("conductor", material="Au"),
    "rough conductor": _bsdf("roughconductor", material="Au", alpha=0.2),
    "brushed conductor": _bsdf("roughconductor", material="Au", alpha_u=0.1, alpha_v=0.4),
    "glass": _bsdf("dielectric"),
    "frosted glass": _bsdf("roughdielectric", alpha=0.2),
    "thin glass": _bsdf("thindielectric"),
    "plastic": _bsdf("plastic"),
    "rough plastic": _bsdf("roughplastic"),
    "principled": _bsdf("principled", roughness=0.3, metallic=0.3),
    "coated": _bsdf("principled", roughness=0.5, clearcoat=1.0, clearcoat_gloss=0.9),
    "sheen": _bsdf("principled", roughness=0.5, sheen=1.0),
    "principled glass": _bsdf("principled", roughness=0.2, spec_trans=1.0),
    "holes": _bsdf("mask", _bsdf("diffuse"), opacity=0.5),
    "blend": _bsdf("blendbsdf", _bsdf("diffuse") + _bsdf("roughconductor"), weight=0.5),
    "checker": _bsdf(
        "diffuse",
        '<texture type="checkerboard" name="reflectance"><transform name="to_uv"><scale value="8"/>'
        "</transform></texture>",
    ),
}

# Shapes around a place, all matte.
SHAPES = {
    "cylinders": '<shape type="cylinder"><point name="p0" x="{x}" y="{y}" z="0"/><point name="p1"'
    ' x="{x}" y="{y}" z="1.4"/><float name="radius" value="0.4"/></shape>',
    "disks": '<shape type="disk"><transform name="to_world"><scale value="0.7"/><rotate x="1"'
    ' angle="70"/><translate x="{x}" y="{y}" z="0.8"/></transform></shape>',
    "cubes": '<shape type="cube"><transform name="to_world"><scale value="0.5"/><rotate x="1"'
    ' angle="30"/><translate x="{x}" y="{y}" z="0.8"/></transform></shape>',
    "strands": '<shape type="bsplinecurve"><string name="filename" value="{strands}"/></shape>',
}

PLACES = [((i - 2) * 1.5, (j - 1.5) * 1.5) for i in range(5) for j in range(4)]


def surfaces(plan: Any, notes: Any) -> Iterator[Row]:
    """Seconds and trimmed errors of each, ours and Mitsuba's."""
    folder = plan.cache / "surfaces"
    folder.mkdir(parents=True, exist_ok=True)
    strands = folder / "strands.txt"
    strands.write_text(_strands(), encoding="utf-8")
    for name, things in _things(strands).items():
        for light in LIGHTS if name in MATERIALS else ("sky",):
            print(f"measuring: {name}, {light}", file=sys.stderr)
            path = folder / f"{name} {light}.xml"
            path.write_text(
                SCENE.format(
                    depth=DEPTH, width=WIDTH, height=HEIGHT, light=LIGHTS[light], things=things
                ),
                encoding="utf-8",
            )
            yield from _measured(plan, notes, f"{name}, {light}", path, folder)


def _things(strands: Path) -> dict[str, str]:
    ball = '<shape type="sphere"><point name="center" x="{}" y="{}" z="0.7"/>{}{}</shape>'
    radius = '<float name="radius" value="0.7"/>'
    found = {
        name: "\n".join(ball.format(x, y, radius, bsdf) for x, y in PLACES)
        for name, bsdf in MATERIALS.items()
    }
    for name, shape in SHAPES.items():
        once = PLACES[:1] if name == "strands" else PLACES
        found[name] = "\n".join(shape.format(x=x, y=y, strands=strands) for x, y in once)
    return found


def _strands() -> str:
    """3,000 of five control points each, two segments, as Mitsuba's text files have them."""
    import numpy as np

    rng = np.random.default_rng(1)
    lines = []
    for _ in range(3000):
        at = np.append(rng.uniform(-4, 4, 2), 0.0)
        for _ in range(5):
            lines.append("{:g} {:g} {:g} 0.02".format(*at))
            at = at + np.append(rng.normal(0, 0.12, 2), 0.35)
        lines.append("")
    return "\n".join(lines) + "\n"


def _measured(plan: Any, notes: Any, name: str, path: Path, folder: Path) -> list[Row]:
    import numpy as np

    from parhelion.comparison import relative_mse

    from .measure import ALONE, OURS, PEERS

    job = {
        "xml": str(path),
        "defines": {},
        "allow": str(folder),
        "width": WIDTH,
        "height": HEIGHT,
        "depth": DEPTH,
        "threads": plan.threads,
    }
    ways = {OURS: (OURS, {}), ALONE: (OURS, {"reuse_paths": False})}
    ways |= {peer: PEERS[peer] for peer in plan.peers if peer.startswith("mitsuba")}
    times: dict[str, list[float]] = {}
    errors: dict[str, list[float]] = {}
    part = folder / "part.npy"
    with ExitStack() as stack:
        workers: dict[str, tuple[Worker, Any]] = {}
        for way, (module, more) in ways.items():
            try:
                worker = Worker(module, job | more)
                stack.callback(worker.close)
                worker.render(plan.reference_spp, REFERENCE_SEED, part)
            except BenchError as problem:
                notes.add(f"surfaces, {name}: {way} was not measured: {problem}")
                continue
            workers[way] = worker, np.load(part)
            times[way], errors[way] = [], []
            notes.versions.setdefault(way, worker.known)
        for turn in range(plan.rounds + 1):
            for way, (worker, truth) in in_turn(workers.items(), turn):
                seconds = worker.render(SPP, turn, part)["seconds"]
                if turn:  # the first is not counted: it may compile
                    times[way].append(seconds)
                    errors[way].append(relative_mse(np.load(part), truth)[1])
    part.unlink(missing_ok=True)
    rows = []
    for way, seconds in times.items():
        pairs = ratios(seconds, times[OURS]) if way != OURS else ()
        less = median(errors[way]) / median(errors[OURS])
        equal = [pair * less for pair in pairs]
        group = f"surfaces, {name}"
        rows += [
            Row(f"{group}, equal samples", way, "s", seconds, against=OURS, ratios=pairs),
            Row(f"{group}, equal error", way, "", errors[way], against=OURS, ratios=equal),
        ]
    return rows
