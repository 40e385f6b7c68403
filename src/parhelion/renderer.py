"""Rendering: a scene and settings in, an Image out."""

from __future__ import annotations

import logging
import os
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import arguments, cryptomatte, machine, memory, shards, sharing, tables
from . import checkpoint as checkpoints
from .atomic import clear
from .errors import ResourceError, SceneError, option, unknown_name
from .flatten import Flat, flatten
from .framing import placed
from .image import Image, KnownScene, RenderStats, check_place
from .progress import ProgressCallback, bar
from .progressive import (
    MOST_SAMPLES,
    Cores,
    Goal,
    Rendering,
    Sampler,
    Work,
    block_errors,
    picture_error,
)
from .scene import Camera, Framing, Scene, Settings

if TYPE_CHECKING:
    from numpy.typing import NDArray

log = logging.getLogger("parhelion")

# Bytes a pixel: the film's sums, and the arrays that are made of them while they are still there;
# of what tells the errors; of features.
PIXEL_BYTES = 56 + 20
ERROR_BYTES = 24 + 12
FEATURE_BYTES = 480 + 220

# Seconds between two checkpoints.
CHECKPOINT_SECONDS = 30.0

# Leaves of a tree that was surely built by all threads
_WITH_THREADS = 4096
# What a scene that is too large may be made of instead
_LESS = "copies take less as instances, as do fewer shapes and smaller images"

LARGEST_SIDE = 65536
INTEGRATORS = ("path", "direct", "ao")
TREES = ("bvh", "none")
SCHEDULES = ("dynamic", "static", "guided")


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene with its tree, for rendering more than once; made by prepare()."""

    scene: Scene
    flat: Flat
    core: Any
    seconds: float


@memory.told
def prepare(
    scene: Scene | Any, *, threads: int = 0, memory_limit: int | str | None = None
) -> Prepared:
    """Checks a scene, or anything that scene_of() makes one of, and builds its tree.

    threads: 0 takes every core, or as many as OMP_NUM_THREADS says. memory_limit: bytes, or a text
    such as "4G", that the process may hold.

    Raises SceneError, naming the object and the element, for a scene that has no meaning, and
    ResourceError for one that takes more memory than the limit or the system leave, before that is
    taken.
    """
    start = time.perf_counter()
    if not isinstance(scene, Scene):
        from .objects import scene_of

        scene = scene_of(scene)
    threads = arguments.own_threads(threads)
    with memory.limited(memory_limit), machine.threads(threads):
        flat = flatten(scene)
        core = build(flat)
    if core.stats()["leaves"] > _WITH_THREADS:
        memory.note_threads(threads or machine.cores_available())
    seconds = time.perf_counter() - start
    log.debug("scene %s: %s in %.3f s", scene.name, core.stats(), seconds)
    return Prepared(scene, flat, core, seconds)


def build(flat: Flat, helps: str = _LESS) -> Any:
    """The core's scene with its tree. helps: against too little memory. Raises as prepare()."""
    from . import _core

    free = memory.free()
    try:
        return _core.Scene(flat.parts, None if free is None else free.bytes)
    except ResourceError as error:
        assert free is not None
        raise memory.refusal(str(error), free, helps) from None
    except MemoryError as error:
        raise ResourceError(f"not enough memory for the scene's tree; {helps}") from error


@memory.told
def render(
    scene: Scene | Prepared | Any,
    *,
    camera: Camera | Framing | None = None,
    threads: int = 0,
    progress: ProgressCallback | bool | None = None,
    features: bool = False,
    time_limit: float | None = None,
    counts: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_every: float = CHECKPOINT_SECONDS,
    resume: bool = False,
    cluster: Any = None,
    shard: tuple[int, int] | None = None,
    tree: str = "bvh",
    schedule: str = "dynamic",
    tile: int = 16,
    isa: str = "",
    memory_limit: int | str | None = None,
    **settings: Any,
) -> Image:
    """Renders a scene.

    scene: or anything that scene_of() knows: positions, meshes and atoms of other libraries.
    camera: instead of the scene's own. settings: any field of Settings (width, height, spp, noise,
    max_depth, seed, sampler, filter, filter_radius, roulette, crop) instead of the scene's; of
    width and height the one not given follows from the scene's aspect ratio.

    The picture is done when all pixels have spp samples, when its noise is low enough, or after
    time_limit seconds, whichever is first; noise or time_limit without spp go on for as long as
    that takes. counts: instead of spp and noise, samples of each pixel, (H, W) whole numbers, such
    as another Image's; its pixels are the same then.

    checkpoint: a file that is written every checkpoint_every seconds and in the end, with a warning
    where it cannot be; one that is there already is an error without resume. With it rendering goes
    on from there, to the same bits that an uninterrupted one makes, and with a larger spp, less
    noise or more time further than that. It must be of the same scene, camera and settings, and of
    the same build of Parhelion.

    cluster: who renders: "local:4", four processes of this machine; the address of a scheduler of
    dask.distributed, such as "tcp://host:8786"; or a Client of that. threads are those of each
    worker then. The picture does not depend on it.

    shard: (1, 4) renders the first of four parts of the picture, which machines that know nothing
    of each other can make; its checkpoint is what merge() makes the picture of. Other pixels are
    black. It needs a checkpoint, and has no noise.

    threads: 0 takes every core. progress: True shows a bar on stderr; a function is called with a
    Progress some times a second, and what it returns, if true, stops the rendering.

    features: also depth, position, normals, albedo, mattes and so on; see Image.features. Those
    that tell of noise (error, samples, variance) come with noise, time_limit and checkpoint alone.
    memory_limit: bytes, or a text such as "4G", that the process may hold.

    The picture does not depend on these: threads; schedule, how OpenMP hands out tiles ("dynamic",
    "static", "guided"); tile, their edge in pixels; isa, the instruction set ("" for the best);
    tree, "none" tests every primitive against every ray.

    Returns an Image; stopped early, one whose stats.complete is False. Raises SceneError for a
    scene, camera or setting without meaning and a checkpoint of another picture, FormatError for a
    file that is none, ResourceError for a picture that memory cannot hold.
    """
    from . import _core

    start, limit = time.perf_counter(), memory_limit
    own = arguments.own_threads(threads, cluster)
    if isinstance(scene, Prepared):
        prepared = scene
    else:
        prepared = prepare(scene, threads=own, memory_limit=limit)
    endless = settings.get("noise") is not None or time_limit is not None
    if endless and shard is None and settings.get("spp") is None:
        settings = {**settings, "spp": MOST_SAMPLES}
    wanted = merged(prepared.scene.settings, settings)
    seen = prepared.scene if camera is None else prepared.scene.replace(camera=camera)
    view_camera = plain_camera(placed(seen, wanted.width / wanted.height))
    work = _work(threads, tile, schedule, isa)
    if tree not in TREES:
        raise SceneError(unknown_name("tree", tree, TREES))
    features, resume = arguments.flag("features", features), arguments.flag("resume", resume)
    if progress is not None and not isinstance(progress, bool) and not callable(progress):
        raise SceneError(f"progress is {progress!r}; must be a function, True or None")
    seconds = arguments.length("time_limit", time_limit)
    interval = arguments.length("checkpoint_every", checkpoint_every)
    if interval is None:
        raise SceneError(f"{option('checkpoint_every')} must be a number of seconds")
    if resume and checkpoint is None:
        raise SceneError(f"{option('resume')} needs {option('checkpoint')}")
    if checkpoint is not None:
        check_place(arguments.path("checkpoint", checkpoint))
    shard = _shard(shard, wanted, checkpoint, counts)
    view = make_view(prepared.core, view_camera, wanted, tree=tree == "bvh")
    x, y, width, height = wanted.crop or (0, 0, wanted.width, wanted.height)
    wanted_counts = None if counts is None else _counts(counts, height, width, checkpoint)
    errors = wanted.noise is not None or seconds is not None or checkpoint is not None
    pixel_bytes = PIXEL_BYTES + ERROR_BYTES * errors + FEATURE_BYTES * features
    with memory.limited(limit):
        _check_memory(width, height, pixel_bytes, work.threads)
    memory.note_threads(work.threads)
    looking = time.perf_counter()
    if wanted.reuse_paths == "auto":
        wanted = replace(wanted, reuse_paths=sharing.pays(prepared.core, view, wanted, work))
        view = view.but(wanted.seed, wanted.reuse_paths)
    looking = time.perf_counter() - looking
    shared = wanted.reuse_paths is True
    blocks = None if shard is None else shards.blocks_of(shard, *wanted.size, shared)
    deadline = None if seconds is None else start + seconds
    if wanted_counts is None:
        goal = Goal(wanted.spp, wanted.noise, deadline, blocks=blocks)
    else:
        goal = Goal(int(wanted_counts.max()), None, deadline, wanted_counts)
    try:
        with machine.threads(own):
            film = _core.Film(x, y, width, height, features, errors)
            with ExitStack() as stack:
                sampler: Sampler = Cores(prepared.core, view, work)
                if cluster is not None:
                    from .cluster import sampler_of

                    sampler = stack.enter_context(
                        sampler_of(
                            *(cluster, threads, prepared.flat, view_camera, wanted, film),
                            source=prepared.scene.source,
                            tree=tree == "bvh",
                            features=features,
                            errors=errors,
                            isa=isa,
                        )
                    )
                rendering = Rendering(film, goal, sampler)
                rendering.spent.seconds += looking
                report = stack.enter_context(bar()) if progress is True else progress or None
                if checkpoint is None:
                    ended = rendering.run(report)
                else:
                    made_of = checkpoints.identity(
                        prepared.flat, view_camera, wanted, features, shard
                    )
                    told = None if shard is None else _told_shard(prepared, features, work)
                    ended = _checkpointed(
                        rendering, report, checkpoint, interval, resume, made_of, told
                    )
            image, bad = _image(prepared, wanted, view_camera, rendering, sampler, ended)
    except MemoryError as error:
        raise ResourceError(f"not enough memory for a picture of {width}x{height}") from error
    most = int(image.counts.max())
    if most > wanted.spp and wanted_counts is None:
        log.warning("the checkpoint has up to %d spp already, more than %d", most, wanted.spp)
        image = replace(image, settings=replace(wanted, spp=most))
    missing = int((image.counts == 0).sum())
    if missing and wanted_counts is None and shard is None:
        log.warning("%d pixels have no sample yet, and are black", missing)
    if bad.any():
        _report_bad(prepared, view, image, bad)
    return image


def _image(
    prepared: Prepared,
    settings: Settings,
    camera: Camera,
    rendering: Rendering,
    sampler: Sampler,
    ended: str,
) -> tuple[Image, NDArray[np.uint32]]:
    """What a rendering has come to, and how many samples of each pixel were not finite."""
    film, scene, flat = rendering.film, prepared.scene, prepared.flat
    error = picture_error(film) if film.has_errors else None
    stats = RenderStats(
        seconds=rendering.spent.seconds,
        samples=rendering.spent.samples,
        rays=rendering.spent.rays,
        threads=sampler.threads,
        isa=sampler.isa,
        ended=ended,
        error=error if error is not None and np.isfinite(error) else None,
        build_seconds=prepared.seconds,
    )
    pixels, counts, bad, seen = developed(film, flat, prepared.core.stats()["scale"])
    image = Image(pixels, counts, stats, settings, camera, flat, seen, scene.legend, scene.source)
    return image, bad


def developed(
    film: Any, names: KnownScene, scale: float
) -> tuple[NDArray[np.float32], NDArray[np.uint32], NDArray[np.uint32], dict[str, Any]]:
    """What a film has seen: Image.pixels, Image.counts, how many samples of each pixel were not
    finite, Image.features.

    names: of the scene. scale: of the core's lengths over the scene's.
    """
    pixels, counts, bad = film.arrays()
    seen = _features(film, names, scale, pixels) if film.has_features else {}
    if film.has_errors:
        seen |= _noise(film, counts)
    return pixels, counts, bad, seen


def merged(base: Settings, changes: dict[str, Any]) -> Settings:
    """Settings with some fields changed, checked; None keeps the scene's own.

    Raises SceneError for an unknown name or a value without meaning.
    """
    names = {f.name for f in fields(Settings)}
    for name in changes:
        if name not in names:
            from .io import LoadOptions

            if name in {f.name for f in fields(LoadOptions)}:
                raise SceneError(
                    f"{name} is an option of reading a scene: ph.load(path, {name}=...) or"
                    f" ph.scene_of(thing, {name}=...)"
                )
            raise SceneError(unknown_name("setting", name, names))
    arguments.instance("settings", base, Settings)
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
        spp=arguments.whole("spp", s.spp, 1, 2**31),
        max_depth=arguments.whole("max_depth", s.max_depth, 1, 2**20),
        seed=arguments.whole("seed", s.seed, 0, 2**64 - 1),
        sampler=tables.entry("samplers", s.sampler).name,
        filter=tables.entry("filters", s.filter).name,
        filter_radius=arguments.length("filter_radius", s.filter_radius),
        roulette=arguments.flag("roulette", s.roulette),
        ao_distance=arguments.length("ao_distance", s.ao_distance),
        backdrop=None if s.backdrop is None else arguments.color("backdrop", s.backdrop),
        noise=arguments.length("noise", s.noise),
        clamp_indirect=arguments.length("clamp_indirect", s.clamp_indirect),
        reuse_paths=arguments.automatic("reuse_paths", s.reuse_paths),
    )
    if s.integrator not in INTEGRATORS:
        raise SceneError(unknown_name("integrator", s.integrator, INTEGRATORS))
    if s.crop is not None:
        try:
            x, y, w, h = (arguments.whole("crop", v, 0, LARGEST_SIDE) for v in s.crop)
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


def make_view(core: Any, camera: Camera, settings: Settings, tree: bool = True) -> Any:
    """The core's view of a camera and of settings as merged() returns them, checked. Where nobody
    has found out whether paths are to be shared, they are not.
    """
    from . import _core

    camera = plain_camera(camera)
    if camera.fov is not None and camera.vfov is not None:
        raise SceneError("camera: give fov or vfov, not both")
    fov, vfov = camera.fov, camera.vfov
    widest = 360 if camera.projection == "fisheye" else 180
    for name, angle in (("fov", fov), ("vfov", vfov)):
        if angle is not None and not 0 < angle < widest + (widest == 360):
            raise SceneError(f"camera: {name} is {angle}; must lie between 0 and {widest} degrees")
    return _core.make_view(
        core,
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
        clamp_indirect=settings.clamp_indirect or 0.0,
        reuse_paths=settings.reuse_paths is True,
    )


def plain_camera(camera: Any) -> Camera:
    """The camera with Python's numbers in the place of arrays, as it is kept with the picture.

    Raises SceneError for what are no numbers.
    """
    arguments.instance("camera", camera, Camera)
    fov, vfov = (
        None if angle is None else arguments.number(f"camera: {name}", angle)
        for name, angle in (("fov", camera.fov), ("vfov", camera.vfov))
    )
    return Camera(
        eye=arguments.point("camera: eye", camera.eye),
        target=arguments.point("camera: target", camera.target),
        up=arguments.point("camera: up", camera.up),
        fov=fov,
        vfov=vfov,
        aperture_radius=arguments.number("camera: aperture_radius", camera.aperture_radius),
        focus_distance=arguments.length("camera: focus_distance", camera.focus_distance),
        projection=arguments.text("camera: projection", camera.projection),
        height=arguments.length("camera: height", camera.height),
        shift=arguments.pair("camera: shift", camera.shift),
        mirrored=arguments.flag("camera: mirrored", camera.mirrored),
    )


def _check_memory(width: int, height: int, pixel_bytes: int, threads: int) -> None:
    """Raises ResourceError for a picture that would not fit; trying it could end the process."""
    what = f"a picture of {width}x{height}"
    helps = f"{option('crop')} renders parts"
    memory.require(width * height * pixel_bytes, what, helps, threads)


def _work(threads: Any, tile: Any, schedule: str, isa: str) -> Work:
    """How to render. Raises SceneError for what has no meaning."""
    from . import _core

    for what, name, choices in (
        ("schedule", schedule, SCHEDULES),
        ("instruction set", isa, ("", *_core.instruction_sets())),
    ):
        if name not in choices:
            raise SceneError(unknown_name(what, name, filter(None, choices)))
    return Work(
        threads=arguments.own_threads(threads) or machine.cores_available(),
        tile=arguments.whole("tile", tile, 1, LARGEST_SIDE),
        schedule=schedule,
        isa=isa or _core.instruction_set(),
    )


def _counts(counts: Any, height: int, width: int, checkpoint: Any) -> NDArray[np.uint32]:
    """Samples of each pixel. Raises SceneError for what is none."""
    try:
        array = np.asarray(counts)
    except ValueError:  # rows of different lengths
        array = np.empty(0, object)
    if array.shape != (height, width) or array.dtype.kind not in "iu":
        raise SceneError(
            f"counts: whole numbers of shape {(height, width)} are needed, not {array.dtype} of"
            f" shape {array.shape}"
        )
    if array.min() < 0 or array.max() > MOST_SAMPLES:
        raise SceneError(f"counts: must lie in [0, {MOST_SAMPLES}]")
    if checkpoint is not None:
        raise SceneError("counts: there are no checkpoints of samples by pixel")
    return np.ascontiguousarray(array, np.uint32)


def _checkpointed(
    rendering: Rendering,
    report: ProgressCallback | None,
    file: str | os.PathLike[str],
    interval: float,
    resume: bool,
    made_of: dict[str, Any],
    picture: dict[str, Any] | None,
) -> str:
    """Runs a rendering that others can go on with. Returns what ended it. See checkpoint.save()."""

    def save() -> None:
        try:
            checkpoints.save(file, rendering, made_of, picture)
        except ResourceError as error:  # the disk may have room again before the next one
            log.error("%s; rendering goes on", error)

    clear(Path(os.path.realpath(file)).parent)
    if not resume:
        checkpoints.check_new(file)
    elif os.path.exists(file):
        checkpoints.resume(file, rendering, made_of)
    rendering.save_every(interval, save)
    try:
        ended = rendering.run(report)
    except KeyboardInterrupt:  # a user who has enough
        save()
        raise
    except ResourceError as error:  # a cluster that is gone
        save()
        if rendering.spent.samples and os.path.exists(file):
            raise ResourceError(
                f"{error}; {os.fspath(file)} has what was rendered, and {option('resume')} goes on"
                " from it"
            ) from error
        raise
    if picture is None:
        save()
    else:  # a shard, of which nothing else is kept
        checkpoints.save(file, rendering, made_of, picture)
    return ended


def _shard(shard: Any, wanted: Settings, checkpoint: Any, counts: Any) -> tuple[int, int] | None:
    """A shard, checked. Raises SceneError for what cannot be a shard's."""
    if shard is None:
        return None
    if counts is not None:
        raise SceneError("counts: a shard has as many samples in all its pixels")
    if checkpoint is None:
        raise SceneError(f"{option('shard')} needs {option('checkpoint')}, the file to merge")
    if wanted.noise is not None:
        raise SceneError(
            f"{option('noise')}: a shard does not know the noise of the others; give"
            f" {option('spp')}"
        )
    return shards.checked_shard(shard)


def _told_shard(prepared: Prepared, features: bool, work: Work) -> dict[str, Any]:
    """What a shard's file tells besides what its samples depend on, as JSON; merge() reads it."""
    scene, flat = prepared.scene, prepared.flat
    names = ("shape_names", "material_names", "object_names")
    return {
        "names": {name: getattr(flat, name) if features else [] for name in names},
        "scale": prepared.core.stats()["scale"],
        "legend": None if scene.legend is None else asdict(scene.legend),
        "source": None if scene.source is None else asdict(scene.source),
        "threads": work.threads,
        "isa": work.isa,
        "build_seconds": prepared.seconds,
    }


def surface_features(film: Any, scale: float, pixels: Any) -> dict[str, Any]:
    """Image.features of a film and its means, without Cryptomattes."""
    seen: dict[str, Any] = film.features(1.0 / scale)
    seen["indirect"] = np.maximum(pixels - (seen["emission"] + seen["direct"]), 0.0)
    return seen


def _features(film: Any, names: KnownScene, scale: float, pixels: Any) -> dict[str, Any]:
    """What the film of a picture has seen besides its light; see Image.features."""
    seen = surface_features(film, scale, pixels)
    named = names.shape_names, names.material_names
    ids = ([cryptomatte.matte_id(name) for name in names] for names in named)
    mattes = film.mattes(*(np.array(bits, np.uint32) for bits in ids))
    return seen | dict(zip(cryptomatte.LAYERS, mattes, strict=True))


def _noise(film: Any, counts: NDArray[np.uint32]) -> dict[str, Any]:
    """What a film with errors knows of its noise; see Image.features."""
    from . import _core

    height, width = counts.shape
    of_pixels = np.repeat(np.repeat(block_errors(film), _core.block, 0), _core.block, 1)
    return {
        "error": of_pixels[:height, :width].astype(np.float32),
        "samples": counts,
        "variance": film.variances(),
    }


def _report_bad(prepared: Prepared, view: Any, image: Image, bad: NDArray[np.uint32]) -> None:
    """Says where samples were not finite, and finds the first one again."""
    from . import _core

    row, column = (int(v[0]) for v in np.nonzero(bad))
    x0, y0 = (image.settings.crop or (0, 0, 0, 0))[:2]
    x, y = x0 + column, y0 + row
    sample = next(
        (
            s
            for s in range(int(image.counts[row, column]))
            if not np.all(np.isfinite(_core.one_sample(prepared.core, view, x, y, s)))
        ),
        None,
    )
    if sample is None:
        first = f"in pixel {x},{y}; none of its paths is so alone, but they share what they find"
    else:
        first = (
            f"sample {sample} of pixel {x},{y} (`parhelion pixel SCENE {x} {y} {sample} --seed "
            f"{image.settings.seed}`, with the picture's other options, shows its path)"
        )
    log.warning(
        "%d samples were not finite and count as black; the first is %s", int(bad.sum()), first
    )


def _side(name: str, value: Any) -> int:
    return arguments.whole(name, value, 1, LARGEST_SIDE)
