"""Camera and RenderSettings prims."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdRender

from ...errors import SceneError, unknown_name
from ...scene import Camera, Settings
from ...studio import with_up

if TYPE_CHECKING:
    from .reader import Matrix, Reader

# Prims that are boundable or describe what is rendered, but are not seen
UNSEEN = ("SkelRoot", "RenderSettings", "RenderProduct", "RenderVar", "RenderPass")

# Purposes of prims that the reader shows
_SHOWN = ("default", "render")

# Focal lengths and apertures are in tenths of the stage's unit
_TENTH = 0.1


# Where the session layer, which is not part of the file, has the name that the user asked for
_ASKED = "parhelion:camera"


def ask_for(stage: Any, name: str) -> None:
    """Has choice() take the camera of this name or path."""
    layer = stage.GetSessionLayer()
    layer.customLayerData = {**layer.customLayerData, _ASKED: name}


def choice(stage: Any, known: Sequence[Any]) -> Any:
    """Which of the cameras at these paths is used: the one that was asked for, of several of a name
    the first; else the one that the stage names; else the first of all; None if there are none.

    Raises SceneError for a name of none.
    """
    wanted = stage.GetSessionLayer().customLayerData.get(_ASKED)
    if wanted is not None:
        found = [path for path in known if wanted in (path.name, str(path))]
        if not found:
            choices = {str(path) if wanted.startswith("/") else path.name for path in known}
            raise SceneError(unknown_name("camera", wanted, choices))
        return found[0]
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    named = settings.GetCameraRel().GetForwardedTargets() if settings else []
    bound = stage.GetRootLayer().customLayerData.get("cameraSettings", {})
    if not named and isinstance(bound, dict) and bound.get("boundCamera"):
        text = str(bound["boundCamera"])
        named = [Sdf.Path(text)] if Sdf.Path.IsValidPathString(text) else []
    return next((path for path in (*(p for p in known if p in named), *known)), None)


def paths(stage: Any, time: float) -> list[Any]:
    """Where the cameras are that can be used at a time code: those that are not hidden nor in
    instances.
    """
    found = []
    prims = iter(Usd.PrimRange.Stage(stage))
    for prim in prims:
        image = UsdGeom.Imageable(prim)
        hidden = image and image.GetVisibilityAttr().Get(time) == "invisible"
        if hidden or prim.IsA(UsdGeom.PointInstancer):
            prims.PruneChildren()
        elif prim.IsA(UsdGeom.Camera) and image.ComputePurpose() in _SHOWN:
            found.append(prim.GetPath())
    return found


def chosen(r: Reader) -> tuple[Camera | None, Settings | None]:
    """The camera that choice() takes, and the size of the picture. Raises SceneError."""
    settings = UsdRender.Settings.GetStageRenderSettings(r.stage)
    size = None
    if settings:
        with r.naming(settings.GetPrim()):
            size = _size(settings.GetResolutionAttr().Get(r.time))
    placed = {prim.GetPath(): (prim, matrix) for prim, matrix in r.cameras}
    path = choice(r.stage, list(placed))
    if path is None:
        return None, _settings(size, None)
    prim, matrix = placed[path]
    with r.naming(prim):
        camera, aspect = _camera(r, prim, matrix)
    return with_up(camera, r.up), _settings(size, aspect)


def _size(resolution: Any) -> tuple[int, int] | None:
    """Of RenderSettings; None where it says none, or one that no picture has."""
    if resolution is None:
        return None
    width, height = (int(side) for side in resolution)
    return (width, height) if 1 <= width <= 65536 and 1 <= height <= 65536 else None


def _settings(size: tuple[int, int] | None, aspect: float | None) -> Settings | None:
    """size: of RenderSettings. aspect: the camera's width over its height."""
    if size is not None:
        return Settings(width=size[0], height=size[1])
    if aspect is None:
        return None
    width = Settings().width
    return Settings(width=width, height=int(min(max(round(width / aspect), 1), 65536)))


def _camera(r: Reader, prim: Any, matrix: Matrix) -> tuple[Camera, float]:
    camera = UsdGeom.Camera(prim)
    width = r.number(prim, camera.GetHorizontalApertureAttr())
    height = r.number(prim, camera.GetVerticalApertureAttr())
    focal = r.number(prim, camera.GetFocalLengthAttr())
    if not (width > 0.0 and height > 0.0 and focal > 0.0):
        raise r.error(prim, f"aperture {width:g} x {height:g} and focal length {focal:g}: not > 0")
    linear = matrix[:3, :3]
    size = np.linalg.norm(linear, axis=0)
    if not (size > 0.0).all() or abs(np.linalg.det(linear / size)) < 1e-9:
        raise r.error(prim, "its transform cannot be inverted")
    axes = linear / size
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        r.report(f"{prim.GetPath()}: its transform shears, which a camera cannot")
    eye = matrix[:3, 3]
    placed: dict[str, Any] = {
        "eye": _triple(eye),
        "up": _triple(axes[:, 1]),
        "mirrored": bool(np.linalg.det(axes) < 0.0),
        "shift": (
            r.number(prim, camera.GetHorizontalApertureOffsetAttr()) / width,
            -r.number(prim, camera.GetVerticalApertureOffsetAttr()) / height,
        ),
    }
    brightness = float(camera.ComputeLinearExposureScale(r.time))
    if brightness != 1.0:
        r.report(f"{prim.GetPath()}: exposure, a factor of {brightness:.3g}: not supported")
    focus = r.number(prim, camera.GetFocusDistanceAttr())
    stop = r.number(prim, camera.GetFStopAttr())
    # far enough that the direction survives the subtraction of the eye
    target = eye - axes[:, 2] * max(float(np.abs(eye).max()), 1.0)
    if camera.GetProjectionAttr().Get(r.time) == "orthographic":
        made = Camera(
            projection="orthographic", height=_TENTH * height, target=_triple(target), **placed
        )
        return made, width / height
    lens: dict[str, Any] = {}
    if stop > 0.0 and focus > 0.0:
        lens = {"aperture_radius": 0.5 * _TENTH * focal / stop, "focus_distance": focus}
    vfov = math.degrees(2.0 * math.atan(0.5 * height / focal))
    return Camera(vfov=vfov, target=_triple(target), **lens, **placed), width / height


def _triple(v: Matrix) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
