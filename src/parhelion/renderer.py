"""Rendering: a scene and settings in, an Image out."""

from __future__ import annotations

import logging
import operator
import time
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from . import cryptomatte, machine, memory, tables
from .errors import ResourceError, SceneError, option, unknown_name
from .flatten import Flat, flatten
from .framing import placed
from .image import Image, RenderStats
from .progress import Progress, ProgressCallback
from .scene import Camera, Framing, Scene, Settings, Vec3

log = logging.getLogger("parhelion")

# Seconds that one pass over the picture should take: it can be stopped in between, and each makes
# the whole picture a little better.
PASS_SECONDS = 0.25

# Bytes a pixel: the film's sums, and the arrays that are made of them while they are still there.
PIXEL_BYTES = 56 + 20
FEATURE_BYTES = 480 + 220

LARGEST_SIDE = 65536
INTEGRATORS = ("path", "direct", "ao")
SCHEDULES = ("dynamic", "static", "guided")


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene with its tree, for rendering more than once; made by prepare()."""

    scene: Scene
    flat: Flat
    core: Any
    seconds: float


def prepare(scene: Scene | Any) -> Prepared:
    """Checks a scene, or anything that scene_of() makes one of, and builds its tree.

    Raises SceneError, naming the object and the element, for a scene that has no meaning.
    """
    from . import _core

    start = time.perf_counter()
    if not isinstance(scene, Scene):
        from .objects import scene_of

        scene = scene_of(scene)
    flat = flatten(scene)
    try:
        core = _core.Scene(flat.parts)
    except MemoryError as error:
        raise ResourceError("not enough memory for the scene's tree") from error
    seconds = time.perf_counter() - start
    log.debug("scene %s: %s in %.3f s", scene.name, core.stats(), seconds)
    return Prepared(scene, flat, core, seconds)


def render(
    scene: Scene | Prepared | Any,
    *,
    camera: Camera | Framing | None = None,
    threads: int = 0,
    progress: ProgressCallback | bool | None = None,
    features: bool = False,
    tree: str = "bvh",
    schedule: str = "dynamic",
    tile: int = 16,
    isa: str = "",
    **settings: Any,
) -> Image:
    """Renders a scene.

    scene: or anything that scene_of() knows: positions, meshes and atoms of other libraries.
    camera: instead of the scene's own. settings: any field of Settings (width, height, spp,
    max_depth, seed, sampler, filter, filter_radius, roulette, crop) instead of the scene's; of
    width and height the one not given follows from the scene's aspect ratio.

    threads: 0 takes every core. progress: True shows a bar on stderr; a function is called with a
    Progress some times a second, and what it returns, if true, stops the rendering.

    features: also depth, position, normals, albedo, mattes and so on; see Image.features.

    The picture does not depend on these: threads; schedule, how OpenMP hands out tiles ("dynamic",
    "static", "guided"); tile, their edge in pixels; isa, the instruction set ("" for the best);
    tree, "none" tests every primitive against every ray.

    Returns an Image; stopped early, one whose stats.complete is False. Raises SceneError for a
    scene, camera or setting without meaning, ResourceError for a picture that memory cannot hold.
    """
    from . import _core

    prepared = scene if isinstance(scene, Prepared) else prepare(scene)
    wanted = merged(prepared.scene.settings, settings)
    seen = prepared.scene if camera is None else prepared.scene.replace(camera=camera)
    view_camera = _plain(placed(seen, wanted.width / wanted.height))
    for what, name, choices in (
        ("tree", tree, ("bvh", "none")),
        ("schedule", schedule, SCHEDULES),
        ("instruction set", isa, ("", *_core.instruction_sets())),
    ):
        if name not in choices:
            raise SceneError(unknown_name(what, name, filter(None, choices)))
    features = _flag("features", features)
    if progress is not None and not isinstance(progress, bool) and not callable(progress):
        raise SceneError(f"progress is {progress!r}; must be a function, True or None")
    count = _whole("threads", threads, 0, 4096) or machine.cores_available()
    tile = _whole("tile", tile, 1, LARGEST_SIDE)
    view = make_view(prepared, view_camera, wanted, tree=tree == "bvh")
    x, y, width, height = wanted.crop or (0, 0, wanted.width, wanted.height)
    _check_memory(width, height, PIXEL_BYTES + (FEATURE_BYTES if features else 0))
    try:
        film = _core.Film(x, y, width, height, features)
        if progress is True:
            from .progress import bar

            with bar() as report:
                stats = _passes(film, prepared, view, wanted, count, report, schedule, tile, isa)
        else:
            callback = progress if callable(progress) else None
            stats = _passes(film, prepared, view, wanted, count, callback, schedule, tile, isa)
        pixels, counts, bad = film.arrays()
        seen_features = film.features(1.0 / prepared.core.stats()["scale"]) if features else {}
        if features:
            parts = seen_features["emission"] + seen_features["direct"]
            seen_features["indirect"] = np.maximum(pixels - parts, 0.0)
            named = prepared.flat.shape_names, prepared.flat.material_names
            ids = ([cryptomatte.matte_id(name) for name in names] for names in named)
            mattes = film.mattes(*(np.array(bits, np.uint32) for bits in ids))
            seen_features |= zip(cryptomatte.LAYERS, mattes, strict=True)
    except MemoryError as error:
        raise ResourceError(f"not enough memory for a picture of {width}x{height}") from error
    if bad.any():
        _report_bad(prepared, view, wanted, counts, bad)
    legend = prepared.scene.legend
    return Image(pixels, counts, stats, wanted, view_camera, prepared.flat, seen_features, legend)


def merged(base: Settings, changes: dict[str, Any]) -> Settings:
    """Settings with some fields changed, checked; None keeps the scene's own.

    Raises SceneError for an unknown name or a value without meaning.
    """
    names = {f.name for f in fields(Settings)}
    for name in changes:
        if name not in names:
            raise SceneError(unknown_name("setting", name, names))
    if not isinstance(base, Settings):
        raise SceneError(f"settings: Settings are needed, not {type(base).__name__}")
    changes = {name: value for name, value in changes.items() if value is not None}
    if ("width" in changes) != ("height" in changes):
        width, height = _side("width", base.width), _side("height", base.height)
        if "width" in changes:
            changes["height"] = max(1, round(_side("width", changes["width"]) * height / width))
        else:
            changes["width"] = max(1, round(_side("height", changes["height"]) * width / height))
    if "filter" in changes and changes["filter"] != base.filter:  # another's radius says nothing
        changes = {"filter_radius": None, **changes}
    s = replace(base, **changes)
    s = replace(
        s,
        width=_side("width", s.width),
        height=_side("height", s.height),
        spp=_whole("spp", s.spp, 1, 2**31),
        max_depth=_whole("max_depth", s.max_depth, 1, 2**20),
        seed=_whole("seed", s.seed, 0, 2**64 - 1),
        sampler=tables.entry("samplers", s.sampler).name,
        filter=tables.entry("filters", s.filter).name,
        filter_radius=_length("filter_radius", s.filter_radius),
        roulette=_flag("roulette", s.roulette),
        ao_distance=_length("ao_distance", s.ao_distance),
        backdrop=None if s.backdrop is None else _color("backdrop", s.backdrop),
    )
    if s.integrator not in INTEGRATORS:
        raise SceneError(unknown_name("integrator", s.integrator, INTEGRATORS))
    if s.crop is not None:
        try:
            x, y, w, h = (_whole("crop", v, 0, LARGEST_SIDE) for v in s.crop)
        except (TypeError, ValueError) as error:
            if isinstance(error, SceneError):
                raise
            raise SceneError(
                f"{option('crop')} must be four numbers: x, y, width, height"
            ) from error
        if w < 1 or h < 1 or x + w > s.width or y + h > s.height:
            raise SceneError(
                f"{option('crop')} {x},{y},{w},{h} (x, y, width, height) does not lie within the"
                f" picture, {s.width}x{s.height}"
            )
        s = replace(s, crop=(x, y, w, h))
    return s


def make_view(prepared: Prepared, camera: Camera, settings: Settings, tree: bool = True) -> Any:
    """The core's view of a camera and of settings as merged() returns them, checked."""
    from . import _core

    camera = _plain(camera)
    if camera.fov is not None and camera.vfov is not None:
        raise SceneError("camera: give fov or vfov, not both")
    fov, vfov = camera.fov, camera.vfov
    widest = 360 if camera.projection == "fisheye" else 180
    for name, angle in (("fov", fov), ("vfov", vfov)):
        if angle is not None and not 0 < angle < widest + (widest == 360):
            raise SceneError(f"camera: {name} is {angle}; must lie between 0 and {widest} degrees")
    return _core.make_view(
        prepared.core,
        camera={
            "projection": camera.projection,
            "eye": camera.eye,
            "target": camera.target,
            "up": camera.up,
            "fov": fov or 0.0,
            "vfov": vfov or 0.0,
            "aperture_radius": camera.aperture_radius,
            "focus_distance": camera.focus_distance or 0.0,
            "height": camera.height or 0.0,
            "shift": camera.shift,
            "mirrored": camera.mirrored,
        },
        width=settings.width,
        height=settings.height,
        filter=settings.filter,
        filter_radius=settings.filter_radius or 0.0,
        sampler=settings.sampler,
        seed=settings.seed,
        max_depth=settings.max_depth,
        roulette=settings.roulette,
        tree=tree,
        integrator=settings.integrator,
        ao_distance=settings.ao_distance or 0.0,
        backdrop=settings.backdrop,
    )


def _plain(camera: Any) -> Camera:
    """The camera with Python's numbers in the place of arrays, as it is kept with the picture."""
    if not isinstance(camera, Camera):
        raise SceneError(f"camera: a Camera is needed, not {type(camera).__name__}")
    fov, vfov = (
        None if angle is None else _number(f"camera: {name}", angle)
        for name, angle in (("fov", camera.fov), ("vfov", camera.vfov))
    )
    return Camera(
        eye=_point("camera: eye", camera.eye),
        target=_point("camera: target", camera.target),
        up=_point("camera: up", camera.up),
        fov=fov,
        vfov=vfov,
        aperture_radius=_number("camera: aperture_radius", camera.aperture_radius),
        focus_distance=_length("camera: focus_distance", camera.focus_distance),
        projection=camera.projection,
        height=_length("camera: height", camera.height),
        shift=_pair("camera: shift", camera.shift),
        mirrored=_flag("camera: mirrored", camera.mirrored),
    )


def _check_memory(width: int, height: int, pixel_bytes: int) -> None:
    """Raises ResourceError for a picture that would not fit; trying it could end the process."""
    needed, free = width * height * pixel_bytes, memory.available()
    if free is not None and needed > free:
        raise ResourceError(
            f"not enough memory for a picture of {width}x{height}: it takes"
            f" {needed / 2**30:.1f} GiB, and {free / 2**30:.1f} GiB are free;"
            f" {option('crop')} renders parts"
        )


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
            tile=tile,
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


def _report_bad(prepared: Prepared, view: Any, settings: Settings, counts: Any, bad: Any) -> None:
    """Says where samples were not finite, and finds the first one again."""
    from . import _core

    row, column = (int(v[0]) for v in np.nonzero(bad))
    x0, y0 = (settings.crop or (0, 0, 0, 0))[:2]
    x, y = x0 + column, y0 + row
    sample = next(
        (
            s
            for s in range(int(counts[row, column]))
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
        raise SceneError(f"{option(name)} is {value!r}; must be a whole number") from error
    if not low <= number <= high:
        raise SceneError(f"{option(name)} is {number}; must lie in [{low}, {high}]")
    return number


def _side(name: str, value: Any) -> int:
    return _whole(name, value, 1, LARGEST_SIDE)


def _number(name: str, value: Any) -> float:
    try:
        if not isinstance(value, (str, bytes)):
            return float(value)
    except (TypeError, ValueError, OverflowError):
        pass
    raise SceneError(f"{option(name)} is {value!r}; must be a number")


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise SceneError(f"{option(name)} is {value!r}; must be True or False")
    return bool(value)


def _color(name: str, value: Any) -> Vec3:
    """Three numbers, finite and not negative."""
    try:
        color = tuple(float(c) for c in value)
    except (TypeError, ValueError):
        color = ()
    if len(color) != 3 or not all(0 <= c <= tables.LARGEST for c in color):
        raise SceneError(f"{option(name)} is {value!r}; must be three numbers >= 0, linear RGB")
    return color[0], color[1], color[2]


def _length(name: str, value: Any) -> float | None:
    """A number above 0, or None."""
    if value is None:
        return None
    number = _number(name, value)
    if not number > 0:
        raise SceneError(f"{option(name)} is {number}; must be > 0")
    return number


def _pair(name: str, value: Any) -> tuple[float, float]:
    try:
        x, y = (_number(name, v) for v in value)
    except (TypeError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{option(name)} is {value!r}; must be two numbers") from error
    return x, y


def _point(name: str, value: Any) -> Vec3:
    try:
        x, y, z = (_number(name, v) for v in value)
    except (TypeError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{option(name)} is {value!r}; must be three numbers") from error
    return x, y, z
