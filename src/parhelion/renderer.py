"""Rendering: a scene and settings in, an Image out."""

from __future__ import annotations

import logging
import operator
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

from . import machine
from .errors import ResourceError, SceneError, unknown_name
from .flatten import Flat, flatten
from .image import Image, RenderStats
from .scene import Camera, Scene, Settings, framed

log = logging.getLogger("parhelion")

# Seconds that one pass over the picture should take: it can be stopped in between, and each makes
# the whole picture a little better.
PASS_SECONDS = 0.25


@dataclass(frozen=True)
class Progress:
    """How far a picture is. samples and rays so far; seconds since the start."""

    samples: int
    total_samples: int
    rays: int
    seconds: float

    @property
    def fraction(self) -> float:
        """The share that is done, 0 to 1."""
        return self.samples / self.total_samples


ProgressCallback = Callable[[Progress], Any]


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene with its tree, for rendering more than once; made by prepare()."""

    scene: Scene
    flat: Flat
    core: Any
    seconds: float


def prepare(scene: Scene) -> Prepared:
    """Checks a scene and builds its tree.

    Raises SceneError, naming the object and the element, for a scene that has no meaning.
    """
    from . import _core

    start = time.perf_counter()
    flat = flatten(scene)
    try:
        core = _core.Scene(flat.groups, flat.materials, flat.background)
    except MemoryError as error:
        raise ResourceError("not enough memory for the scene's tree") from error
    seconds = time.perf_counter() - start
    log.debug("scene %s: %s in %.3f s", scene.name, core.stats(), seconds)
    return Prepared(scene, flat, core, seconds)


def render(
    scene: Scene | Prepared,
    *,
    camera: Camera | None = None,
    threads: int = 0,
    progress: ProgressCallback | bool | None = None,
    tree: str = "bvh",
    schedule: str = "dynamic",
    tile: int = 16,
    isa: str = "",
    **settings: Any,
) -> Image:
    """Renders a scene.

    camera: instead of the scene's own. settings: any field of Settings (width, height, spp,
    max_depth, seed, sampler, filter, filter_radius, roulette, crop) instead of the scene's; of
    width and height the one not given follows from the scene's aspect ratio.

    threads: 0 takes every core. progress: True shows a bar on stderr; a function is called with a
    Progress some times a second, and what it returns, if true, stops the rendering.

    The picture does not depend on these: threads; schedule, how OpenMP hands out tiles ("dynamic",
    "static", "guided"); tile, their edge in pixels; isa, the instruction set ("" for the best);
    tree, "none" tests every primitive against every ray.

    Returns an Image; stopped early, one whose stats.complete is False. Raises SceneError for a
    scene, camera or setting without meaning, ResourceError for a picture that memory cannot hold.
    """
    from . import _core

    prepared = scene if isinstance(scene, Prepared) else prepare(scene)
    wanted = merged(prepared.scene.settings, settings)
    view_camera = camera or prepared.scene.camera or framed(prepared.scene, wanted)
    if tree not in ("bvh", "none"):
        raise SceneError(unknown_name("tree", tree, ["bvh", "none"]))
    count = _whole("threads", threads, 0, 4096) or machine.cores_available()
    view = make_view(prepared, view_camera, wanted, tree=tree == "bvh")
    x, y, width, height = wanted.crop or (0, 0, wanted.width, wanted.height)
    try:
        film = _core.Film(x, y, width, height)
    except MemoryError as error:
        raise ResourceError(f"not enough memory for a picture of {width}x{height}") from error

    if progress is True:
        from .progress import bar

        with bar() as report:
            stats = _passes(film, prepared, view, wanted, count, report, schedule, tile, isa)
    else:
        callback = progress if callable(progress) else None
        stats = _passes(film, prepared, view, wanted, count, callback, schedule, tile, isa)
    pixels, counts, bad = film.arrays()
    if bad.any():
        _report_bad(prepared, view, wanted, bad)
    return Image(pixels, counts, stats, wanted, view_camera, prepared.flat)


def merged(base: Settings, changes: dict[str, Any]) -> Settings:
    """Settings with some fields changed, checked; None keeps the scene's own.

    Raises SceneError for an unknown name or a value without meaning.
    """
    names = {f.name for f in fields(Settings)}
    for name in changes:
        if name not in names:
            raise SceneError(unknown_name("setting", name, names))
    changes = {name: value for name, value in changes.items() if value is not None}
    s = replace(base, **changes)
    if "width" in changes and "height" not in changes:
        height = _whole("width", s.width, 1, 65536) * base.height / base.width
        s = replace(s, height=max(1, round(height)))
    elif "height" in changes and "width" not in changes:
        width = _whole("height", s.height, 1, 65536) * base.width / base.height
        s = replace(s, width=max(1, round(width)))
    s = replace(
        s,
        width=_whole("width", s.width, 1, 65536),
        height=_whole("height", s.height, 1, 65536),
        spp=_whole("spp", s.spp, 1, 2**31),
        max_depth=_whole("max_depth", s.max_depth, 1, 2**20),
        seed=_whole("seed", s.seed, 0, 2**64 - 1),
        roulette=bool(s.roulette),
    )
    if s.crop is not None:
        try:
            x, y, w, h = (_whole("crop", v, 0, 65536) for v in s.crop)
        except (TypeError, ValueError) as error:
            if isinstance(error, SceneError):
                raise
            raise SceneError("crop must be four numbers: x, y, width, height") from error
        if w < 1 or h < 1 or x + w > s.width or y + h > s.height:
            raise SceneError(
                f"crop {x},{y},{w},{h} (x, y, width, height) does not lie within the picture,"
                f" {s.width}x{s.height}"
            )
        s = replace(s, crop=(x, y, w, h))
    return s


def make_view(prepared: Prepared, camera: Camera, settings: Settings, tree: bool = True) -> Any:
    """The core's view of a camera and settings, checked."""
    from . import _core

    if camera.fov is not None and camera.vfov is not None:
        raise SceneError("camera: give fov or vfov, not both")
    fov, vfov = camera.fov, camera.vfov
    if fov is None and vfov is None:
        vfov = 40.0
    for name, angle in (("fov", fov), ("vfov", vfov)):
        if angle is not None and not 0 < angle < 180:
            raise SceneError(f"camera: {name} is {angle}; must lie between 0 and 180 degrees")
    if camera.focus_distance is not None and not camera.focus_distance > 0:
        raise SceneError(f"camera: focus_distance is {camera.focus_distance}; must be > 0")
    try:
        return _core.make_view(
            prepared.core,
            eye=[float(v) for v in camera.eye],
            target=[float(v) for v in camera.target],
            up=[float(v) for v in camera.up],
            fov=float(fov or 0.0),
            vfov=float(vfov or 0.0),
            aperture_radius=float(camera.aperture_radius),
            focus_distance=float(camera.focus_distance or 0.0),
            width=settings.width,
            height=settings.height,
            filter=settings.filter,
            filter_radius=float(settings.filter_radius or 0.0),
            sampler=settings.sampler,
            seed=settings.seed,
            max_depth=settings.max_depth,
            roulette=settings.roulette,
            tree=tree,
        )
    except (TypeError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"camera or settings: {str(error).splitlines()[0]}") from error


def _passes(
    film: Any,
    prepared: Prepared,
    view: Any,
    settings: Settings,
    threads: int,
    report: ProgressCallback | None,
    schedule: str,
    tile: int,
    isa: str,
) -> RenderStats:
    """Samples in passes, the first of one sample a pixel, so that the whole picture is there early;
    all in one where nobody watches. Sums are exact: no split changes them.
    """
    from . import _core

    pixels = (settings.crop or (0, 0, settings.width, settings.height))[2:]
    total = pixels[0] * pixels[1] * settings.spp
    start = time.perf_counter()
    samples = rays = done = 0
    size, complete = (1 if report else settings.spp), True
    while done < settings.spp and complete:
        before = time.perf_counter()

        def tick(
            pass_samples: int, pass_rays: int, samples: int = samples, rays: int = rays
        ) -> bool:
            if report is None:
                return False
            seconds = time.perf_counter() - start
            return bool(report(Progress(samples + pass_samples, total, rays + pass_rays, seconds)))

        last = min(done + size, settings.spp)
        pass_samples, pass_rays, complete = film.render(
            prepared.core,
            view,
            done,
            last,
            threads=threads,
            tile=_whole("tile", tile, 1, 65536),
            schedule=schedule,
            isa=isa,
            tick=tick,
        )
        samples += pass_samples
        rays += pass_rays
        seconds = time.perf_counter() - before
        if complete:
            done = last
            complete = not tick(0, 0, samples, rays)
        size = max(1, min(8 * size, int(size * PASS_SECONDS / max(seconds, 1e-6))))
    return RenderStats(
        seconds=time.perf_counter() - start,
        samples=samples,
        rays=rays,
        threads=threads,
        isa=isa or _core.instruction_set(),
        complete=done == settings.spp,
        build_seconds=prepared.seconds,
    )


def _report_bad(prepared: Prepared, view: Any, settings: Settings, bad: Any) -> None:
    """Says where samples were not finite, and finds the first one again."""
    import numpy as np

    from . import _core

    row, column = (int(v[0]) for v in np.nonzero(bad))
    x0, y0 = (settings.crop or (0, 0, 0, 0))[:2]
    x, y = x0 + column, y0 + row
    sample = next(
        (
            s
            for s in range(settings.spp)
            if not np.all(np.isfinite(_core.one_sample(prepared.core, view, x, y, s)))
        ),
        None,
    )
    log.warning(
        "%d samples were not finite and count as black; the first is sample %s of pixel %d,%d"
        " (--crop %d,%d,1,1 --seed %d renders that pixel alone)",
        int(bad.sum()),
        sample,
        x,
        y,
        x,
        y,
        settings.seed,
    )


def _whole(name: str, value: Any, low: int, high: int) -> int:
    try:
        number = operator.index(value)
    except TypeError as error:
        raise SceneError(f"{name} is {value!r}; must be a whole number") from error
    if not low <= number <= high:
        raise SceneError(f"{name} is {number}; must lie in [{low}, {high}]")
    return number
