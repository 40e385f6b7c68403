"""A scene that is being looked at: a thread that renders what is asked for now, and better and
better while nothing else is asked for.

Nothing here knows of networks or pages. Whoever shows the pictures subscribes to be told of new
ones; requests may come from any thread and return at once.
"""

from __future__ import annotations

import atexit
import json
import logging
import math
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .. import arguments, machine, memory
from ..denoise import check_denoiser, denoised, finite, guides_of
from ..display import Display
from ..errors import ParhelionError, ResourceError, SceneError, unknown_name
from ..image import HIDDEN, Image, RenderStats
from ..progressive import Work
from ..renderer import Prepared, merged, plain_camera, prepare
from ..scene import Camera, Framing, Scene
from .drawing import LONGEST_PASS, Drawing, Frame, Rectangle, Request, draw, rectangle, require
from .layers import LAYERS, PICTURE, needs_features, shown
from .stage import Pick, Stage

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..cluster.places import Opened

log = logging.getLogger("parhelion")

# "frame": there is a new picture, or the same one is to be shown otherwise. "state": something that
# state() tells has changed. "values": parameters have changed. "scene": all that outline() tells.
Event = Literal["frame", "state", "values", "scene"]

# Seconds that the first, coarse picture after a change may take to render: of the 300 ms in which
# it is to be seen, the rest is for the one that was under way, for packing and for the way; and a
# camera that is dragged is seen to move some fifteen times a second.
FIRST_SECONDS = 0.05
# After so many it is given up for a coarser one: it shows something far more expensive than before.
LATE_SECONDS = 0.2
# Samples a second of a scene that nothing is known of yet: a few thousand pixels come first.
UNKNOWN_RATE = 5e4
# After so many a pass shows what it has come to, where each pixel has a sample already.
LATE_PASS = 3.0
# Seconds that placing the camera may take to be done at once: of 1e7 spheres it takes two.
QUICK = 0.05
# Sides of a picture, and pixels in all.
LARGEST_SIDE, MOST_PIXELS = 8192, 3840 * 2160
DEFAULT_SPP = 4096
# Changes that may wait.
MOST_JOBS = 1000

# Those that are open: Python must not end while their threads are within the core.
_running: weakref.WeakSet[Session] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    for session in list(_running):
        session.close()


class Session:
    """Renders a scene again and again, as it is looked at.

    scene: a Scene, what prepare() makes of one, or anything that scene_of() knows. camera: instead
    of the scene's. width, height: of the picture in pixels; None for the scene's. spp: samples a
    pixel after which it rests. threads: 0 for all cores. memory_limit: bytes, or a text such as
    "4G", that the process may hold. settings: any other field of Settings.

    Raises SceneError and ResourceError as render() does. Must be closed; a `with` block does.
    """

    def __init__(
        self,
        scene: Scene | Prepared | Any,
        *,
        camera: Camera | Framing | None = None,
        width: int | None = None,
        height: int | None = None,
        spp: int = DEFAULT_SPP,
        threads: int = 0,
        cluster: Any = None,
        memory_limit: int | str | None = None,
        **settings: Any,
    ) -> None:
        self._own_threads = arguments.own_threads(threads, cluster)
        # kept, as what the user allows is known to the thread alone that says it
        with memory.limited(memory_limit):
            self._memory_limit = memory.limit()
        with self.limited():
            prepared = self._prepared(scene)
        changes = {k: v for k, v in settings.items() if v is not None and k != "crop"}
        self._condition = threading.Condition()
        self._threads = self._own_threads or machine.cores_available()
        self._listeners: list[Callable[[Event], None]] = []
        self._jobs: deque[tuple[Callable[[], None], Future[None]]] = deque()
        self._closing = False
        self._paused = self._resting = False
        self._moved = False
        self._error: str | None = None  # of what was reported, and of the picture
        self._failure: ParhelionError | None = None
        self._busy: str | None = None
        self._layer, self._display, self._denoise = PICTURE, Display(), False
        self._frame: Frame | None = None
        self._full: Frame | None = None
        self._rate = UNKNOWN_RATE
        self._shared = False  # as it paid for the last picture of which it was found out
        self._spp = arguments.whole("spp", spp, 1, 2**23)
        self._drawing: Drawing | None = None
        self._number = 0
        self._hides = 0  # that were asked for
        self._hiding: set[int] = set()  # by the last of them
        self._stage = Stage(prepared, camera, changes)
        size = merged(self._stage.settings, {"width": width, "height": height})
        _check_size(size.width, size.height)
        self._check_memory(size.width, size.height, False)
        crop = settings.get("crop")
        home = self._stage.home(size.width, size.height)
        self._request = Request(0, home, size.width, size.height, None, False, _now())
        if crop is not None:
            x, y, w, h = merged(size, {"crop": crop}).crop or (0, 0, size.width, size.height)
            part = (x / size.width, y / size.height, w / size.width, h / size.height)
            self._request = replace(self._request, crop=part)
        self._stage.view(self._request.camera, size)  # whose errors are the caller's
        self._opened = ExitStack()
        self._cluster: Opened | None = None
        if cluster is not None:
            from ..cluster.places import opened

            self._cluster = self._opened.enter_context(opened(cluster, threads))
        self._thread = threading.Thread(target=self._run, name="parhelion-session", daemon=True)
        self._thread.start()
        _running.add(self)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- Asked from outside ----------------------------------------------------------------------

    def close(self) -> None:
        """Stops rendering; a prepared scene that was given has its own parameters again.

        The newest picture can still be asked for.
        """
        with self._condition:
            if self._closing:
                return
            self._closing = True
            self._condition.notify_all()
        self._thread.join()
        self._opened.close()
        for _, future in self._jobs:
            future.cancel()
        # whoever still holds the session, as a notebook does until Python ends, holds no trees
        self._drawing = None
        self._stage.close()

    def subscribe(self, listener: Callable[[Event], None]) -> Callable[[], None]:
        """Calls the listener after changes, from whatever thread; it must return at once.

        Returns what ends that.
        """
        self._listeners.append(listener)

        def end() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)

        return end

    def look(self, camera: Camera) -> int:
        """Another camera. Returns the revision that frames of it have, or a later one.

        Raises SceneError for one without meaning; the one before stays.
        """
        camera = plain_camera(camera)
        now = self._request
        # the box filter, as the table of another takes 5 ms
        size = {"width": now.width, "height": now.height, "filter": "box"}
        self._stage.view(camera, merged(self._stage.settings, size))
        self._moved = True
        return self._ask(camera=camera)

    def look_home(self) -> int:
        """The camera with which it began; returns what look() does."""
        self._moved = False
        now = self._request
        return self._ask(camera=self._stage.home(now.width, now.height))

    def resize(self, width: int, height: int) -> None:
        """Another size, in pixels. Raises SceneError, and ResourceError if memory is too small."""
        width = arguments.whole("width", width, 1, LARGEST_SIDE)
        height = arguments.whole("height", height, 1, LARGEST_SIDE)
        _check_size(width, height)
        now = self._request
        if (width, height) == (now.width, now.height):
            return
        self._check_memory(width, height, _wants_features(self._layer, self._denoise))
        changes: dict[str, Any] = {"width": width, "height": height}
        quick = self._stage.placing <= QUICK
        if not self._moved and quick:
            changes["camera"] = self._stage.home(width, height)
        self._ask(**changes)
        if not self._moved and not quick:
            threading.Thread(target=self._place, args=(width, height), daemon=True).start()

    def crop(self, part: Rectangle | None) -> None:
        """Only a part: x, y, width, height as shares of the picture, from the top left; None for
        all.
        """
        if part is not None:
            if not isinstance(part, (tuple, list)) or len(part) != 4:
                raise SceneError(f"crop is {part!r}; must be four shares: x, y, width, height")
            x, y, w, h = (_share(v) for v in part)
            w, h = min(w, 1.0 - x), min(h, 1.0 - y)
            if w * self._request.width < 1.0 or h * self._request.height < 1.0:
                raise SceneError(f"crop: {part} holds no pixel")
            part = x, y, w, h
        self._ask(crop=part)

    def show(
        self,
        *,
        layer: str | None = None,
        exposure: float | None = None,
        view_transform: str | None = None,
        denoise: bool | None = None,
    ) -> None:
        """What is shown of the picture, a name in LAYERS, and how: see Display.

        denoise: without its noise, by Open Image Denoise; raises ResourceError where there is none.
        """
        if denoise is not None and arguments.flag("denoise", denoise):
            check_denoiser()
        changes: dict[str, Any] = {"exposure": exposure, "view_transform": view_transform}
        display = replace(self._display, **{k: v for k, v in changes.items() if v is not None})
        if layer is not None and arguments.text("layer", layer) not in LAYERS:
            raise SceneError(unknown_name("layer", layer, LAYERS))
        layer = layer or self._layer
        denoise = self._denoise if denoise is None else denoise
        now = self._request
        # those that are there do no harm, as the picture itself does not change; the next drawing
        # goes without them
        lacking = _wants_features(layer, denoise) and not now.features
        if lacking:
            self._check_memory(now.width, now.height, True)
        self._layer, self._denoise = layer, denoise
        self._display = display
        if lacking:
            self._ask()
        self._tell("frame")
        self._tell("state")

    def pause(self, paused: bool = True) -> None:
        """Whether it rests after the first picture of full size of whatever is asked for."""
        with self._condition:
            self._paused = bool(paused)
            self._condition.notify_all()
        self._tell("state")

    def rest(self, resting: bool) -> None:
        """The same, of who shows the pictures: nobody looks at them."""
        with self._condition:
            self._resting = resting
            self._condition.notify_all()

    def limit(self, spp: int) -> None:
        """Samples a pixel after which it rests."""
        with self._condition:
            self._spp = arguments.whole("spp", spp, 1, 2**23)
            self._condition.notify_all()
        self._tell("state")

    def change(self, kind: str, index: int, name: str, value: Any) -> Future[None]:
        """Another value for a parameter of a material or light; see Parameters.change. index: as
        in the outline.

        What is returned holds the SceneError, if there is one, when it has been done.
        """
        kind, name = arguments.text("kind", kind), arguments.text("name", name)
        index = arguments.whole("index", index, 0, 2**32)
        return self._do(lambda: self._stage.change(kind, index, name, value), "values")

    def restore(self) -> Future[None]:
        """All parameters as they were given."""
        return self._do(self._stage.restore, "values")

    def hide(self, objects: Collection[int]) -> Future[None]:
        """Which objects, by their indices in the outline, are not there: their tree is made again.

        Raises SceneError for those that there are not. What is returned holds the error, if there
        is one, when it has been done, or left to what was asked for later.
        """
        if isinstance(objects, (str, bytes)) or not isinstance(objects, Collection):
            raise SceneError(f"objects is {objects!r}; must be a list of indices")
        hidden = {arguments.whole(f"objects[{i}]", o, 0, 2**32) for i, o in enumerate(objects)}
        self._stage.check_objects(hidden)
        with self._condition:
            self._hiding = hidden
            self._hides += 1
            number = self._hides

        def job() -> None:
            self._stage.check_objects(hidden)  # of another scene by now, perhaps
            # a tree of 1e7 spheres takes seconds, and is not made for what the next one ends
            if number == self._hides:
                self._stage.hide(hidden)

        return self._do(job, "scene", "building the scene")

    def show_object(self, index: int, visible: bool) -> Future[None]:
        """Whether one object is there; the others stay as was asked last. As hide() otherwise."""
        change = self._hiding.difference if visible else self._hiding.union
        return self.hide(change({index}))

    def replace(self, scene: Scene | Prepared | Any) -> Future[None]:
        """Another scene, as of a file that was changed. The camera stays if the user moved it.

        Checks it and builds its tree in the calling thread. Raises SceneError; the old one stays.
        """
        with self.limited():
            prepared = self._prepared(scene)

        def job() -> None:
            self._stage.take(prepared)
            self._error, self._hiding = None, set()
            while True:
                now = self._request
                home = self._stage.home(now.width, now.height)  # which may take seconds
                with self._condition:
                    if self._moved:
                        return
                    if (now.width, now.height) == (self._request.width, self._request.height):
                        self._request = replace(self._request, camera=home)
                        return

        return self._do(job, "scene")

    def report(self, error: str | None) -> None:
        """An error to be told with the state, until it is None."""
        self._error = error
        self._tell("state")

    def _prepared(self, scene: Scene | Prepared | Any) -> Prepared:
        if isinstance(scene, Prepared):
            return scene
        return prepare(scene, threads=self._own_threads)

    def limited(self) -> AbstractContextManager[None]:
        """A block in which the memory is limited as the session's is."""
        return memory.limited(self._memory_limit)

    # --- Told ------------------------------------------------------------------------------------

    @property
    def frame(self) -> Frame | None:
        """The newest picture; None before the first."""
        return self._frame

    @property
    def camera(self) -> Camera:
        """The camera that was asked for last."""
        return self._request.camera

    def picture(self, frame: Frame) -> NDArray[np.uint8]:
        """(H, W, 3) sRGB of a frame, of the layer that is shown, or of the picture until it is
        there.
        """
        layer = self._layer
        if needs_features(layer) and not frame.features:
            layer = PICTURE
        if layer == PICTURE and self._denoise and frame.features:
            light, guides = finite(frame.pixels)[0], guides_of(frame.features)
            # the guides' own noise takes four times as long: not while the camera moves
            whole = frame.scale == 1.0
            with self.limited():
                light = denoised(light, *guides, quality="fast", prefilter=whole)
            frame = replace(frame, pixels=light)
        return shown(layer, frame, self._display)

    def scene(self) -> Scene:
        """The scene as it is now: its camera, size, part, materials and lights; what is hidden is
        not there.
        """
        now = self._request
        crop = None if now.crop is None else rectangle(now.crop, now.width, now.height)
        size = {"width": now.width, "height": now.height, "crop": crop}
        return self._stage.scene(now.camera, merged(self._stage.settings, size))

    def array_bytes(self) -> int:
        """What the scene's arrays and images take."""
        return self._stage.array_bytes()

    def state(self) -> dict[str, Any]:
        """What front ends show, as plain values."""
        now, stage = self._request, self._stage
        return {
            "scene": stage.prepared.scene.name,
            "camera": now.camera,
            "width": now.width,
            "height": now.height,
            "aspect": None if stage.framed else stage.settings.width / stage.settings.height,
            "crop": now.crop,
            "layer": self._layer,
            "exposure": self._display.exposure,
            "view_transform": self._display.view_transform,
            "denoise": self._denoise,
            "paused": self._paused,
            "spp": self._spp,
            "moved": self._moved,
            "error": self._error if self._failure is None else str(self._failure),
            "busy": self._busy,
            "reach": stage.reach,
        }

    def outline(self) -> dict[str, Any]:
        """The scene's objects, materials and lights, as plain values."""
        return self._stage.outline()

    def finished(self, timeout: float = 60.0) -> Frame:
        """The picture as far as it has come, once it is there in its full size.

        Raises why it cannot be made, a SceneError or ResourceError, and ResourceError if it is not
        there after so many seconds.
        """
        end = time.monotonic() + arguments.number("timeout", timeout)
        with self._condition:
            while self._full is None or self._full.revision != self._request.revision:
                if self._failure is not None:
                    raise type(self._failure)(str(self._failure))
                left = end - time.monotonic()
                if left <= 0 or self._closing:
                    raise ResourceError("the picture is not there yet in its full size")
                self._condition.wait(min(left, 0.2))
            return self._full

    def values(self, since: int) -> dict[str, Any]:
        """The materials and lights that were changed after what was told with that serial."""
        return self._stage.values(since)

    def image(self, timeout: float = 60.0) -> Image:
        """The same as an Image. Raises what finished() does."""
        frame, spp = self.finished(timeout), self._spp
        from .. import _core

        stats = RenderStats(
            seconds=frame.seconds,
            samples=frame.samples,
            rays=frame.rays,
            threads=self._threads,
            isa=_core.instruction_set(),
            ended="spp" if frame.spp >= spp else "stopped",
            error=frame.error,
            build_seconds=frame.build_seconds,
        )
        settings = replace(frame.settings, spp=frame.spp)
        scene = self._stage.prepared.scene
        return Image(
            pixels=frame.pixels,
            counts=frame.counts,
            stats=stats,
            settings=settings,
            camera=frame.camera,
            flat=frame.flat,
            features=frame.features,
            legend=scene.legend,
            source=scene.source,
            notes={HIDDEN: json.dumps(frame.hidden)} if frame.hidden else {},
        )

    def pick(self, x: float, y: float) -> Pick:
        """What is seen at a place of the picture, in shares of its width and height.

        Raises SceneError for one beside it, ResourceError of a session that is closed.
        """
        x, y = _share(x), _share(y)
        now, frame = self._request, self._frame
        seen = self._stage.pick(now.camera, now.width, now.height, x, y)
        return seen if frame is None else replace(seen, value=frame.value(x, y))

    # --- The thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        with self.limited(), machine.threads(self._own_threads):
            self._work()

    def _work(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closing or self._jobs or self._unfinished())
                if self._closing:
                    return
            try:
                self._work_off()
                if self._unfinished():
                    self._step()
            except ParhelionError as error:
                self._fail(error)
            except MemoryError:
                self._fail(ResourceError("not enough memory"))
            except Exception as error:  # an error of ours: told, and the session goes on
                log.exception("the session's thread")
                self._fail(ParhelionError(f"{type(error).__name__}: {error}"))

    def _unfinished(self) -> bool:
        drawing = self._drawing
        if drawing is None or drawing.request is not self._request:
            return True
        if drawing.failed:
            return False
        if not drawing.seen:
            return True
        due = drawing.done < self._spp or not drawing.looked or drawing.withheld
        return due and not (self._paused or self._resting)

    def _fail(self, error: ParhelionError) -> None:
        request = self._request if self._drawing is None else self._drawing.request
        self._drawing = Drawing(request, 1.0, failed=True)
        if request is not self._request:  # nobody waits for it any more
            return
        self._failure = error
        self._tell("state")

    def _step(self) -> None:
        """One pass."""
        request = self._request
        drawing = self._drawing
        if drawing is None or drawing.request is not request:
            drawing = self._drawing = draw(request, self._rate * FIRST_SECONDS, self._shared)
        began = time.perf_counter()
        if drawing.film is None:
            drawing.begin(self._stage)
        elsewhere = self._cluster is not None and drawing.whole and drawing.done > 0
        if drawing.worth_a_look(at_once=elsewhere or drawing.done >= self._spp):
            self._find_out(drawing)
            return
        if elsewhere:
            self._step_elsewhere(drawing)
            return
        first, seen = drawing.first, drawing.seen
        end = began + (LATE_SECONDS if first else LATE_PASS)

        def tick(_samples: int, _rays: int) -> bool:
            if self._closing:
                return True
            other = bool(self._jobs) or self._request is not request
            late = time.perf_counter() > end
            if first:  # what is asked for next does not stop it: a moving camera would show nothing
                return late and (other or not drawing.coarsest)
            return other or (seen and (late or self._paused or self._resting))

        last = min(drawing.done + drawing.size, max(self._spp, 1))
        seconds, samples, complete = drawing.add(self._stage, last, self._threads, tick, began)
        if first:
            measured = max(samples, 1) / seconds
            # slower is believed at once, faster by and by
            self._rate = min(measured, math.sqrt(measured * self._rate))
            if self._rate == UNKNOWN_RATE or self._frame is None:
                self._rate = measured
        if not complete:
            if first:  # too much for the time: coarser
                self._drawing = None
            elif drawing.done > 0 and self._request is request and not self._closing:
                self._publish(drawing)  # some of it has more samples
            return
        self._publish(drawing)
        if not drawing.whole:
            self._drawing = drawing.finer()

    def _find_out(self, drawing: Drawing) -> None:
        """Whether pixels shall share their paths, unless something else is due."""
        request = self._request

        def tick(_samples: int, _rays: int) -> bool:
            other = bool(self._jobs) or self._request is not request
            return self._closing or other or self._paused or self._resting

        try:
            drawing.find_out(self._stage, Work(self._threads, 16, "dynamic", ""), tick)
        except (MemoryError, ResourceError):
            if drawing.film is None:
                raise
            drawing.looked = True  # it goes on as it is
        self._shared = drawing.shared

    def _step_elsewhere(self, drawing: Drawing) -> None:
        """All that is left of a picture, by the cluster, told as it comes."""
        from ..cluster.sampler import Workers

        request, before = self._request, replace(drawing)
        began = told = time.perf_counter()

        def tell(samples: int, rays: int) -> None:
            drawing.samples, drawing.rays = before.samples + samples, before.rays + rays
            drawing.seconds = before.seconds + time.perf_counter() - began
            drawing.done = int(drawing.film.arrays()[1].min())
            self._publish(drawing)

        def tick(samples: int, rays: int) -> bool:
            nonlocal told
            if self._closing or self._jobs or self._paused or self._resting:
                return True
            if self._request is not request or drawing.done >= self._spp:
                return True
            if time.perf_counter() > told + LONGEST_PASS:
                tell(samples, rays)
                told = time.perf_counter()
            return False

        _, _, w, h = drawing.place
        targets = np.full((h, w), self._spp, np.uint32)
        try:
            if drawing.workers is None:
                assert drawing.settings is not None
                assert self._cluster is not None
                drawing.workers = Workers(
                    self._cluster,
                    self._stage.flat,
                    request.camera,
                    drawing.settings,
                    drawing.film,
                    tree=True,
                    features=request.features,
                    errors=True,
                    isa="",
                )
            samples, rays, complete = drawing.workers.take(drawing.film, targets, w * h, tick)
        except ResourceError as error:  # the scheduler is gone: this machine goes on
            self._cluster = None
            self.report(str(error))
            return
        finally:
            gone = self._cluster is None or self._closing or self._request is not request
            if gone and drawing.workers is not None:
                drawing.workers.close()
        if drawing.workers.failures:
            raise ResourceError(drawing.workers.failures[0])
        if complete or self._request is request:
            tell(samples, rays)

    def _publish(self, drawing: Drawing) -> None:
        drawing.withheld = drawing.done < min(drawing.shown_from, self._spp)
        if drawing.withheld:
            return
        self._number += 1
        frame = drawing.frame(self._number, self._stage)
        with self._condition:
            self._frame = frame
            if drawing.whole:
                self._full = frame
                drawing.seen = True
            self._condition.notify_all()
        if self._failure is not None:
            self._failure = None
            self._tell("state")
        self._tell("frame")

    # --- What is asked for ------------------------------------------------------------------------

    def _ask(self, **changes: Any) -> int:
        with self._condition:
            now = self._request
            features = _wants_features(self._layer, self._denoise)
            self._request = replace(
                now, revision=now.revision + 1, features=features, asked=_now(), **changes
            )
            revision = self._request.revision
            self._condition.notify_all()
        self._tell("state")
        return revision

    def _do(self, job: Callable[[], None], event: Event, busy: str | None = None) -> Future[None]:
        """Has something done by the thread, between passes; the picture then begins anew."""
        future: Future[None] = Future()

        def run() -> None:
            self._busy = busy
            if busy:
                self._tell("state")
            try:
                job()
            finally:
                self._busy = None
            self._ask()
            self._tell(event)

        with self._condition:
            if self._closing:
                future.cancel()
                return future
            if len(self._jobs) >= MOST_JOBS:
                future.set_exception(ResourceError(f"more than {MOST_JOBS} changes wait"))
                return future
            self._jobs.append((run, future))
            self._condition.notify_all()
        return future

    def _work_off(self) -> None:
        for _ in range(len(self._jobs)):  # not those that come meanwhile: a picture is due
            run, future = self._jobs.popleft()
            if not future.set_running_or_notify_cancel():
                continue
            try:
                run()
            except (ParhelionError, MemoryError) as error:
                future.set_exception(error)
                self._tell("state")
            except BaseException as error:
                future.set_exception(error)
                raise
            else:
                future.set_result(None)

    def _place(self, width: int, height: int) -> None:
        """Brings the camera to other proportions, in a thread of its own."""
        camera = self._stage.home(width, height)
        now = self._request
        if not self._moved and (now.width, now.height) == (width, height):
            self._ask(camera=camera)

    def _check_memory(self, width: int, height: int, features: bool) -> None:
        """Raises ResourceError for a size that memory is too small for. What is under way now, and
        makes room for it, counts as free.
        """
        drawing = self._drawing
        film = drawing.film if drawing is not None else None
        room = 0 if film is None else sum(part.nbytes for part in film.memory())
        with self.limited():
            require(width, height, features, room)

    def _tell(self, event: Event) -> None:
        for listener in tuple(self._listeners):
            listener(event)


def _check_size(width: int, height: int) -> None:
    """Raises SceneError for a picture that is too large to be looked at."""
    if width * height > MOST_PIXELS or max(width, height) > LARGEST_SIDE:
        raise SceneError(f"a picture of {width}x{height} is too large to look at")


def _wants_features(layer: str, denoise: bool) -> bool:
    return needs_features(layer) or denoise


def resident() -> int | None:
    """Bytes of memory that this process takes now; None where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    import resource

    return pages * resource.getpagesize()


def _share(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value <= 1:
        raise SceneError(f"{value!r} is no share of the picture; must lie in [0, 1]")
    return float(value)


def _now() -> float:
    return time.perf_counter()
