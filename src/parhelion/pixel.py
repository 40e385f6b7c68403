"""One sample's path, vertex by vertex: where the light of a pixel comes from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from .errors import SceneError, option
from .framing import placed
from .renderer import Prepared, make_view, merged, prepare
from .scene import Camera, Framing, Scene, Vec3

if TYPE_CHECKING:
    from .flatten import Flat

# What the core's words for the ends of paths mean
_ENDS = {
    "leaves": "leaves the scene",
    "deep": "has as many rays as a path may have",
    "back": "meets the back of a material that has none",
    "absorbed": "is absorbed: the material sends nothing on",
    "dark": "carries no light any more",
    "roulette": "is ended by Russian roulette",
    "openness": "has found how open the surroundings are",
    "unseen": "does not begin: the camera sees nothing there",
}


@dataclass(frozen=True)
class LightSample:
    """Light that was asked for at a vertex.

    name: of the light, or of the shape that shines. primitive: of that shape; None for a light that
    is no shape. copy: of instances, which one shines. direction: towards it, unit. distance: in the
    scene's units, infinite from outside. pdf: per steradian, with the choice of the light; of one
    without extent (`delta`) the probability of its choice. radiance: as it leaves the light.
    scattered: whether the material, or the other one of a blend, sends some of it on. added: to
    the sample's radiance; 0 if something is in between.
    """

    name: str
    primitive: int | None
    copy: int | None
    direction: Vec3
    distance: float
    pdf: float
    delta: bool
    radiance: Vec3
    scattered: bool
    added: Vec3


@dataclass(frozen=True)
class PathVertex:
    """Where a path has met a surface, in the scene's units.

    depth: rays so far. shape: its name. primitive: its number in the shape, as in the arrays. copy:
    the name of the instances and the number of the copy, if it is one. material: its name; of a
    blend the part that was chosen. position: of the point; distance: from the last one. normal:
    of the surface itself, outward; shading_normal: that which scatters, bent towards the viewer.
    front: met from outside. emitted: what the surface gives off, as it is added to the sample's
    radiance. light: what was asked for, if some was.

    event: "reflects", "transmits", "passes" (a hole, a clear surface, or one within a body that
    takes precedence) or "ends". specular: sent in one direction, without a density. direction: in
    which the path goes on; pdf: of that, per steradian. throughput: what light that comes from
    there is multiplied by. For "ends" these three say nothing.
    """

    depth: int
    shape: str
    primitive: int
    copy: tuple[str, int] | None
    material: str
    position: Vec3
    distance: float
    normal: Vec3
    shading_normal: Vec3
    front: bool
    emitted: Vec3
    light: LightSample | None
    event: str
    specular: bool
    direction: Vec3
    pdf: float
    throughput: Vec3


@dataclass(frozen=True)
class PixelPath:
    """The path of one sample of one pixel; trace_pixel() makes it.

    origin, direction: of the camera's ray. end: why it ends. background: what the surroundings add
    where it leaves the scene. radiance: of the sample, exactly what the picture gets where pixels
    do not share paths (Settings.reuse_paths); `emitted` and `light.added` of all vertices and
    `background` add up to it.
    """

    x: int
    y: int
    sample: int
    origin: Vec3
    direction: Vec3
    vertices: tuple[PathVertex, ...]
    end: str
    background: Vec3
    radiance: Vec3

    def __str__(self) -> str:
        return "\n".join(_lines(self))

    def as_dict(self) -> dict[str, Any]:
        """For JSON, which has no infinite numbers and no NaN: these are text, "inf" and "nan"."""
        found: dict[str, Any] = _plain(asdict(self))
        return found


def trace_pixel(
    scene: Scene | Prepared | Any,
    x: int,
    y: int,
    sample: int = 0,
    *,
    camera: Camera | Framing | None = None,
    **settings: Any,
) -> PixelPath:
    """Follows one sample of a pixel and tells what happens on the way.

    x, y: of the pixel, from the top left of the whole picture. sample: its number, from 0. All
    else as for render(); the path is that of the sample in a picture of the same settings. Where
    pixels share paths, it is the pixel's own.

    Raises SceneError for a pixel outside of the picture and for what render() raises it.
    """
    from . import _core

    prepared = scene if isinstance(scene, Prepared) else prepare(scene)
    wanted = merged(prepared.scene.settings, settings)
    for name, value, limit in (
        ("x", x, wanted.width),
        ("y", y, wanted.height),
        ("sample", sample, 2**31),
    ):
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < limit:
            raise SceneError(f"{option(name)} is {value!r}; must be a whole number in [0, {limit})")
    seen = prepared.scene if camera is None else prepared.scene.replace(camera=camera)
    view = make_view(prepared.core, placed(seen, wanted.width / wanted.height), wanted)
    found = _core.trace_pixel(prepared.core, view, x, y, sample)
    vertices = tuple(_vertex(v, prepared.flat) for v in found.pop("vertices"))
    end = _ENDS[found.pop("end")]
    return PixelPath(x, y, sample, vertices=vertices, end=end, **found)


def _vertex(found: dict[str, Any], flat: Flat) -> PathVertex:
    shape, primitive, instances, number = found.pop("place")
    copy = None if instances is None else (flat.shape_names[instances], number)
    material = flat.material_names[found.pop("material")]
    light = found.pop("light")
    asked = None if light is None else _light(light, flat)
    name = flat.shape_names[shape]
    return PathVertex(
        shape=name, primitive=primitive, copy=copy, material=material, light=asked, **found
    )


def _light(found: dict[str, Any], flat: Flat) -> LightSample:
    shape, primitive, _, copy = found.pop("place")
    name = found.pop("name")
    if name is None:
        name = flat.shape_names[shape]
    return LightSample(name=name, primitive=primitive, copy=copy, **found)


def _plain(value: Any) -> Any:
    """Values as JSON can hold them."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"


def _lines(path: PixelPath) -> Iterator[str]:
    """The path for people."""
    yield f"sample {path.sample} of pixel {path.x},{path.y}: radiance {_numbers(path.radiance)}"
    yield f"camera at {_numbers(path.origin)}, towards {_numbers(path.direction)}"
    for k, v in enumerate(path.vertices, 1):
        of = f" of copy {v.copy[1]} of {v.copy[0]!r}" if v.copy else ""
        side = "front" if v.front else "back"
        yield f"{k}. {v.shape!r}, primitive {v.primitive}{of}, {side} of material {v.material!r}"
        yield f"   at {_numbers(v.position)}, after {v.distance:.6g}"
        yield f"   normal {_numbers(v.normal)}, of shading {_numbers(v.shading_normal)}"
        if any(v.emitted):
            yield f"   gives off light: adds {_numbers(v.emitted)}"
        if v.light is not None:
            yield from _light_lines(v.light)
        if v.event != "ends":
            how = " as a mirror" if v.specular else f", pdf {v.pdf:.6g}" if v.pdf else ""
            how = "" if v.event == "passes" else how
            yield f"   {v.event} towards {_numbers(v.direction)}{how}"
            yield f"   throughput {_numbers(v.throughput)}"
    if any(path.background):
        yield f"the surroundings add {_numbers(path.background)}"
    yield f"the path {path.end}"


def _light_lines(light: LightSample) -> Iterator[str]:
    what = "" if light.primitive is None else f", primitive {light.primitive}"
    what += "" if light.copy is None else f" of copy {light.copy}"
    chance = "chosen with" if light.delta else "pdf"
    yield (
        f"   light {light.name!r}{what}: towards {_numbers(light.direction)},"
        f" {light.distance:.6g} away, {chance} {light.pdf:.6g}, radiance {_numbers(light.radiance)}"
    )
    if any(light.added):
        yield f"      adds {_numbers(light.added)}"
    else:
        yield f"      {'something is in between' if light.scattered else 'none is scattered here'}"
