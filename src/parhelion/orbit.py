"""A camera that goes once around a scene, as if the scene turned on a table before it."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from math import cos, radians, sin, sqrt, tan
from typing import TYPE_CHECKING, Any

import numpy as np

from . import arguments
from .errors import SceneError
from .framing import placed, reach, subject
from .renderer import Prepared, merged, prepare, render
from .scene import Camera, Framing, Scene, Settings, Vec3
from .studio import turned_light, up_of, without_light

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .image import Image

    Array = NDArray[np.floating[Any]]

# Pictures of one turn: an hour of 30 a second.
_MOST = 108_000


@dataclass(frozen=True, eq=False)
class Turn:
    """One view of a turn: the camera, and the (3, 3) rotation about `pivot` that led there."""

    camera: Camera
    rotation: Array
    pivot: Array


def turntable(
    scene: Scene | Prepared | Any,
    count: int,
    *,
    up: Vec3 | None = None,
    camera: Camera | Framing | None = None,
    places: Sequence[int] | None = None,
    **options: Any,
) -> Iterator[Image]:
    """Renders pictures of a scene, one after the other, the camera going once around it.

    scene: as for render(). count: of pictures; the one after the last would be the first again.
    up: the axis that the camera turns about, as turns() has it. camera: of the first picture,
    instead of the scene's own. places: of the pictures that are made, from 0 on; None for all.
    options: of render().

    The light that files without light get goes around with the camera, so that things seem to turn
    before it. Light of the scene's own stays where it is, and then the tree is built once.

    Raises SceneError for a count, a scene or options without meaning.
    """
    if places is not None:
        number = checked_count(count)
        if isinstance(places, str) or not isinstance(places, Sequence):
            raise SceneError(f"places is {places!r}; must be a list of whole numbers")
        places = [arguments.whole("places", place, 0, number - 1) for place in places]
        if not places:
            return iter(())
    prepared = scene if isinstance(scene, Prepared) else _prepared(scene, options)
    shown = prepared.scene if camera is None else prepared.scene.replace(camera=camera)
    names = {f.name for f in fields(Settings)}
    settings = merged(shown.settings, {k: v for k, v in options.items() if k in names})
    around = turns(shown, count, settings.width / settings.height, up)
    wanted = around if places is None else [around[place] for place in places]
    return _rendered(prepared, shown, wanted, options)


def _rendered(
    prepared: Prepared, shown: Scene, around: Sequence[Turn], options: dict[str, Any]
) -> Iterator[Image]:
    for turn in around:
        lit = turned_light(shown, turn.rotation, turn.pivot)
        if lit is not shown:
            if lit.source is not None:  # which is told with the picture
                moved = turn.rotation.tolist(), turn.pivot.tolist()
                lit = lit.replace(source=replace(lit.source, turned=moved))
            del prepared  # two trees at a time would be one too many
            prepared = _prepared(lit, options)
        yield render(prepared, camera=turn.camera, **options)


def _prepared(scene: Scene | Any, options: dict[str, Any]) -> Prepared:
    own = arguments.own_threads(options.get("threads", 0), options.get("cluster"))
    return prepare(scene, threads=own, memory_limit=options.get("memory_limit"))


def turns(scene: Scene, count: int, aspect: float, up: Vec3 | None = None) -> list[Turn]:
    """The cameras of a turn, by equal angles, counterclockwise as seen from above.

    aspect: width over height of the pictures. up: None for the coordinate axis nearest to the
    camera's up.

    A scene's own camera is the first one as it is. The axis goes through the place on its line of
    sight that is nearest, seen along the axis, to the middle of the scene. For a Framing, the axis
    goes through the middle of the shapes that it shows, and the distance is the least that shows
    them whole from all around.
    """
    number = checked_count(count)
    first = placed(scene, aspect)
    axis = np.array(up_of(scene) if up is None else arguments.point("up", up), np.float64)
    if not np.all(np.isfinite(axis)) or not np.any(axis):
        raise SceneError(f"up is {up!r}; must be three finite numbers, not all 0")
    axis /= np.linalg.norm(axis)
    if isinstance(scene.camera, Camera):
        pivot = _ahead(scene, first, axis)
    else:
        pivot, first = _around(scene, first, aspect, axis)
    made = []
    for k in range(number):
        rotation = _rotation(axis, 360.0 * k / number)
        eye, target = (_moved(p, rotation, pivot) for p in (first.eye, first.target))
        turned_up = _moved(first.up, rotation, np.zeros(3))
        camera = replace(first, eye=eye, target=target, up=turned_up)
        made.append(Turn(camera, rotation, pivot))
    return made


def checked_count(count: int) -> int:
    """How many pictures a turn has. Raises SceneError for a number that is none."""
    try:
        number = operator.index(count)
    except TypeError:
        raise SceneError(f"pictures of a turn: {count!r}; must be a whole number") from None
    if not 1 <= number <= _MOST:
        raise SceneError(f"pictures of a turn: {number}; must lie in [1, {_MOST}]")
    return number


def _ahead(scene: Scene, camera: Camera, axis: Array) -> Array:
    """The place on a camera's line of sight that is nearest to the line through the scene's middle
    along the axis; the eye if that lies behind it.
    """
    eye = np.array(camera.eye, np.float64)
    along = np.subtract(camera.target, eye)
    away = reach(without_light(scene))[0] - eye
    flat = along - axis * (along @ axis)
    size = float(flat @ flat)
    # Straight down the axis every place will do.
    return eye + max(0.0, float(away @ flat) / size) * along if size > 0.0 else eye


def _around(scene: Scene, camera: Camera, aspect: float, axis: Array) -> tuple[Array, Camera]:
    """The pivot, and a camera that sees in the given one's direction, and as far from the axis as
    what the scene is about needs at every angle.

    A point at height h along the axis a and at distance q from it goes around in a circle. How far
    that reaches along a normal n of the picture's four planes is h n.a + q |n - a n.a|.
    """
    middle, radius = reach(scene)
    if not radius > 0.0:  # nothing to see, or a single point
        return middle, camera
    framing = scene.camera or Framing()
    assert isinstance(framing, Framing)
    towards = np.subtract(camera.eye, camera.target)
    towards /= np.linalg.norm(towards)
    above = np.array(camera.up, np.float64)
    right = np.cross(above, towards)
    half = tan(radians(0.5 * framing.vfov)) * framing.fill
    slopes = (half, half, half * aspect, half * aspect)
    planes = [v + s * towards for v, s in zip((above, -above, right, -right), slopes, strict=True)]
    most = [-np.inf] * 4
    for centers, radii in subject(scene):
        away = centers - middle
        heights = away @ axis
        distances = np.linalg.norm(away - heights[:, None] * axis, axis=1)
        for i, (n, slope) in enumerate(zip(planes, slopes, strict=True)):
            out = heights * (n @ axis) + distances * np.linalg.norm(n - axis * (n @ axis))
            most[i] = max(most[i], float(np.max(out + radii * sqrt(1.0 + slope**2))))
    # Moving the target along the axis leaves equal room above and below.
    level = float(above @ axis)
    shift = (most[0] - most[1]) / (2.0 * level) if level > 0.5 else 0.0
    room = zip(most, planes, slopes, strict=True)
    distance = max((m - shift * float(n @ axis)) / s for m, n, s in room)
    target = middle + shift * axis
    return middle, replace(camera, eye=_tuple(target + distance * towards), target=_tuple(target))


def _rotation(axis: Array, angle: float) -> Array:
    """The rotation by an angle in degrees about an axis of unit length; Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = sin(radians(angle)), cos(radians(angle))
    rotation: Array = np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    return rotation


def _moved(point: Vec3, rotation: Array, pivot: Array) -> Vec3:
    """The point turned about the pivot; without rotation, itself to the last bit."""
    start = np.array(point, np.float64)
    return _tuple(start + (rotation - np.eye(3)) @ (start - pivot))


def _tuple(vector: Array) -> Vec3:
    x, y, z = vector.tolist()
    return x, y, z
