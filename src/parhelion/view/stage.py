"""What is looked at: a scene whose parameters change and whose objects may be hidden."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import ResourceError, SceneError
from ..flatten import Flat
from ..framing import placed
from ..renderer import Prepared, build, make_view, merged, plain_camera
from ..scene import Camera, Framing, Scene, Settings, Vec3
from .parameters import Parameters, changed

# Proportions of pictures for which the first camera is remembered: of 1e7 spheres it takes two
# seconds to place it.
MOST_HOMES = 32


@dataclass(frozen=True)
class Pick:
    """What is seen at a place of the picture.

    object, material: their names, and object_index, material_index in the outline; None where there
    is nothing. position, distance (from the camera), normal: in scene units. depth: the distance
    along the viewing direction. value: linear RGB of the picture there, None if it has none yet.
    """

    x: float
    y: float
    object: str | None = None
    object_index: int | None = None
    material: str | None = None
    material_index: int | None = None
    position: Vec3 | None = None
    normal: Vec3 | None = None
    distance: float | None = None
    depth: float | None = None
    value: Vec3 | None = None


class Stage:
    """A prepared scene as it is now.

    camera: instead of the scene's. changes: of its settings. One thread renders and changes it, and
    does not do both at once; any other may pick, or ask what is there.

    prepared: as it was given. core: what is rendered. flat: the same as arrays and records, in
    which hidden objects are made of nothing. hidden: their names, by indices. settings: without a
    crop. placing: seconds that it took to place the first camera, if it had to be. reach: about how
    large the scene is, in its units.
    """

    def __init__(
        self, prepared: Prepared, camera: Camera | Framing | None, changes: dict[str, Any]
    ) -> None:
        self._camera, self._changes = camera, changes
        self._lock = threading.RLock()  # held while the core changes or is picked in
        self.core: Any
        self.take(prepared)

    def take(self, prepared: Prepared) -> None:
        """Another scene. Raises SceneError if the settings mean nothing for it; nothing changes."""
        settings = merged(prepared.scene.settings, self._changes)
        with self._lock:
            self.prepared = prepared
            self.settings = replace(settings, crop=None)
            self.placing = 0.0
            self.core = prepared.core
            self.reach = float(1.0 / prepared.core.stats()["scale"])
            self.hidden: dict[int, str] = {}
            self._homes: dict[float, Camera] = {}
            self._parameters = Parameters(prepared)
            self._shown = prepared.flat  # what is not hidden, with parameters as they were given
            self._renew()

    def close(self) -> None:
        """Gives the scene its own parameters again, and lets go of its trees."""
        with self._lock:
            self._parameters.restore()
            self.core = self._parameters.core = None
            self.prepared = replace(self.prepared, core=None)

    # --- Changed ---------------------------------------------------------------------------------

    def change(self, kind: str, index: int, name: str, value: Any) -> None:
        """Another value for a parameter of a material or light; see Parameters.change."""
        with self._lock:
            self._parameters.change(kind, index, name, value)
            self._renew()

    def restore(self) -> None:
        """All parameters as they were given."""
        with self._lock:
            self._parameters.restore()
            self._renew()

    def hide(self, objects: Collection[int]) -> None:
        """Only these objects, by their indices in the outline, are not there; a tree is built.

        Raises SceneError for those that there are not, and ResourceError if memory is too small.
        """
        self.check_objects(objects)
        names = self.prepared.flat.object_names
        hidden = {i: names[i] for i in sorted(objects)}
        if hidden == self.hidden:
            return
        core, flat = self.prepared.core, self.prepared.flat
        if hidden:
            flat = flat.without(set(hidden))
            core = build(flat, "while it is made, the tree of all objects is there too")
        with self._lock:
            changes = self._parameters.changes()
            self._parameters.restore()
            self.core, self._shown, self.hidden = core, flat, hidden
            self._parameters = Parameters(replace(self.prepared, core=core))
            for change in changes:
                self._parameters.change(*change)
            self._renew()

    def check_objects(self, objects: Collection[int]) -> None:
        """Raises SceneError for objects that there are not."""
        count = len(self.prepared.flat.object_names)
        for i in objects:
            if not 0 <= i < count:
                raise SceneError(f"objects[{i}]: there are {count}")

    def _renew(self) -> None:
        self.flat: Flat = self._parameters.flat(self._shown)

    # --- Looked at -------------------------------------------------------------------------------

    def home(self, width: int, height: int) -> Camera:
        """The camera that nobody has moved, for a picture of these proportions."""
        prepared, aspect = self.prepared, width / height
        known = self._homes.get(aspect)
        if known is None:
            began = time.perf_counter()
            known = plain_camera(placed(self._seen(prepared.scene), aspect))
            self.placing = time.perf_counter() - began
            if len(self._homes) < MOST_HOMES and prepared is self.prepared:
                self._homes[aspect] = known
        return known

    @property
    def framed(self) -> bool:
        """Whether the camera is placed so that shapes fill pictures of any proportions."""
        return not isinstance(self._seen(self.prepared.scene).camera, Camera)

    def _seen(self, scene: Scene) -> Scene:
        return scene if self._camera is None else scene.replace(camera=self._camera)

    def view(self, camera: Camera, settings: Settings) -> Any:
        """The core's view; see make_view(). Raises ResourceError of a session that is closed."""
        with self._lock:
            if self.core is None:
                raise ResourceError("the session is closed")
            return make_view(self.core, camera, settings)

    def pick(self, camera: Camera, width: int, height: int, x: float, y: float) -> Pick:
        """What a camera sees at a place of its picture, in shares of width and height; no value."""
        from .. import _core

        column, row = min(int(x * width), width - 1), min(int(y * height), height - 1)
        # the middle of the pixel as a pinhole sees it
        size = {"width": width, "height": height, "filter": "box", "max_depth": 1}
        settings = merged(self.settings, size)
        with self._lock:
            view = self.view(replace(camera, aperture_radius=0.0), settings)
            flat = self.prepared.flat
            film = _core.Film(column, row, 1, 1, True)
            add_samples(film, self.core, view, 1)
            seen = film.features(1.0 / self.core.stats()["scale"])
        shape = int(seen["shape"][0, 0])
        if shape < 0:
            return Pick(x, y)
        material = int(seen["material"][0, 0])
        own = shape - (len(flat.shape_names) - len(flat.object_names))
        position = np.asarray(seen["position"][0, 0], np.float64)
        ahead = np.subtract(camera.target, camera.eye)
        return Pick(
            x,
            y,
            object=flat.shape_names[shape],
            object_index=own if own >= 0 else None,
            material=flat.material_names[material],
            material_index=material,
            position=triple(position),
            normal=triple(seen["normal"][0, 0]),
            distance=float(seen["depth"][0, 0, 0]),
            depth=float((position - camera.eye) @ (ahead / np.linalg.norm(ahead))),
        )

    # --- Told ------------------------------------------------------------------------------------

    def scene(self, camera: Camera, settings: Settings) -> Scene:
        """The scene with its materials and lights as they are now; what is hidden is not there."""
        with self._lock:
            hidden = self.hidden
            scene = changed(self.prepared, self._parameters.changes())
        shapes = [shape for i, shape in enumerate(scene.shapes) if i not in hidden]
        return scene.replace(shapes=shapes, camera=camera, settings=settings, source=None)

    def outline(self) -> dict[str, Any]:
        """The scene's objects, materials and lights, as plain values."""
        with self._lock:
            flat = self.prepared.flat
            shapes = flat.parts["groups"][-1]
            objects = [
                {
                    "name": name,
                    "kind": shape["kind"],
                    "count": shape["count"],
                    "visible": i not in self.hidden,
                    "material": shape["material"]
                    if "material_of" not in shape and shape["kind"] != "instance"
                    else None,
                }
                for i, (name, shape) in enumerate(zip(flat.object_names, shapes, strict=True))
            ]
            return {"objects": objects, **self._parameters.listed()}

    def values(self, since: int) -> dict[str, Any]:
        """The materials and lights that were changed after what was told with that serial."""
        with self._lock:
            return self._parameters.listed(since)

    def array_bytes(self) -> int:
        """What the scene's arrays and images take."""
        parts = self.prepared.flat.parts
        records = [*(shape for group in parts["groups"] for shape in group), *parts["images"]]
        arrays = (value for record in records for value in record.values())
        return sum(value.nbytes for value in arrays if isinstance(value, np.ndarray))


def add_samples(
    film: Any, core: Any, view: Any, spp: int, threads: int = 1, tick: Any = None
) -> tuple[int, int, bool]:
    """Brings all pixels to so many samples. Samples, rays, and whether tick did not stop it."""
    samples, rays, complete = film.render(
        core, view, spp, threads=threads, tile=16, schedule="dynamic", isa="", tick=tick
    )
    return samples, rays, complete


def triple(values: Any) -> Vec3:
    """Three numbers of Python's."""
    x, y, z = (float(v) for v in values)
    return x, y, z
