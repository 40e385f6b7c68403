"""<sensor> with its film, filter and sampler: our camera and settings."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ...scene import Camera, Settings
from .document import Object
from .reader import Matrix, Reader

# Pixel filters with ours and its radius in pixels, by default; None for those we do not have
_FILTERS: dict[str, str | None] = {
    "box": "box",
    "tent": "tent",
    "gaussian": "gaussian",
    "mitchell": None,
    "catmullrom": None,
    "lanczos": None,
}

# Pixels of a picture's side that can be rendered
_LARGEST_SIDE = 65536


def read(r: Reader, o: Object, settings: Settings) -> tuple[Camera | None, Settings]:
    """The camera, and the settings with size, samples and filter of its film."""
    settings = _film(r, o, _sampler(r, o, settings))
    r.ignore(o, "near_clip", "far_clip", "shutter_open", "shutter_close")
    # the functions of SENSORS need the proportions of the film, which `make` does not carry
    make = {name: _with_size(f, settings) for name, f in SENSORS.items()}
    return r.make(o, make, None), settings


_Make = Callable[[Reader, Object, float], Camera]


def _with_size(f: _Make, settings: Settings) -> Callable[[Reader, Object], Camera | None]:
    return lambda r, o: f(r, o, settings.width / settings.height)


# Cameras. In Mitsuba's own frame z is the viewing direction, y up and x the picture's left.


def _placed(r: Reader, o: Object) -> tuple[dict[str, Any], Matrix]:
    """Eye, target, up and mirrored; and the linear part of the transform."""
    matrix = r.matrix(o)
    linear = matrix[:3, :3]
    size = np.linalg.norm(linear, axis=0)
    if not (size > 0.0).all() or not np.isfinite(matrix).all():
        raise o.error("its transform cannot be inverted")
    axes = linear / size
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        r.report(
            f"{o}: its transform shears, which a camera cannot; what it does to angles is lost"
        )
    eye = matrix[:3, 3]
    found = {
        "eye": _triple(eye),
        "target": _triple(eye + axes[:, 2]),
        "up": _triple(axes[:, 1]),
        "mirrored": bool(np.linalg.det(axes) < 0.0),
    }
    return found, linear


def _triple(v: Matrix) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _vfov(r: Reader, o: Object, aspect: float) -> float:
    """The vertical field of view, in degrees; aspect: width over height."""
    if r.has(o, "fov"):
        axis = r.string(o, "fov_axis", "x")
        fov = r.number(o, "fov", 0.0)
        r.ignore(o, "focal_length")
    else:
        # of a lens for 35 mm film, whose picture is 36 by 24 mm
        text = r.string(o, "focal_length", "50mm").strip()
        try:
            focal = float(text.removesuffix("mm"))
        except ValueError:
            focal = 0.0
        if not 0.0 < focal < math.inf:
            raise o.error(f"focal_length is {text!r}; must be such as '50mm'")
        fov = math.degrees(2.0 * math.atan(0.5 * math.hypot(36.0, 24.0) / focal))
        axis = "diagonal"
        r.ignore(o, "fov_axis")
    if not 0.0 < fov < 180.0:
        raise o.error(f"fov is {fov:g}; must lie between 0 and 180")
    # the picture's height over the length that fov spans
    heights = {
        "x": 1.0 / aspect,
        "y": 1.0,
        "diagonal": 1.0 / math.hypot(1.0, aspect),
        "smaller": max(1.0, 1.0 / aspect),
        "larger": min(1.0, 1.0 / aspect),
    }
    if axis not in heights:
        raise o.error(f"fov_axis is {axis!r}; must be one of {', '.join(heights)}")
    share = heights[axis]
    return math.degrees(2.0 * math.atan(share * math.tan(0.5 * math.radians(fov))))


def _shift(r: Reader, o: Object) -> tuple[float, float]:
    x, y = (r.number(o, f"principal_point_offset_{axis}", 0.0) for axis in "xy")
    return x, y


def _perspective(r: Reader, o: Object, aspect: float) -> Camera:
    r.ignore(o, "focus_distance")  # of a pinhole, everything is in focus
    placed, _ = _placed(r, o)
    return Camera(vfov=_vfov(r, o, aspect), shift=_shift(r, o), **placed)


def _thin_lens(r: Reader, o: Object, aspect: float) -> Camera:
    placed, _ = _placed(r, o)
    return Camera(
        vfov=_vfov(r, o, aspect),
        shift=_shift(r, o),
        aperture_radius=r.number(o, "aperture_radius", 0.0),
        focus_distance=r.number(o, "focus_distance", r.number(o, "far_clip", 1e4)),
        **placed,
    )


def _orthographic(r: Reader, o: Object, aspect: float) -> Camera:
    """It sees from -1 to 1 along x over the picture's width, before its transform scales that."""
    placed, linear = _placed(r, o)
    width, height = (2.0 * float(np.linalg.norm(linear[:, axis])) for axis in (0, 1))
    if abs(width - height) > 1e-4 * height:
        r.report(f"{o}: scaled differently along x and y, which is not supported; y counts")
    return Camera(projection="orthographic", height=height / aspect, **placed)


SENSORS: dict[str, _Make] = {
    "perspective": _perspective,
    "thinlens": _thin_lens,
    "orthographic": _orthographic,
}


# Film and sampler


def _film(r: Reader, o: Object, settings: Settings) -> Settings:
    films = r.nested(o, "film")
    if len(films) > 1:
        raise o.error(f"has {len(films)} films; needs 1")
    if not films:
        return replace(settings, width=768, height=576, filter="gaussian", filter_radius=2.0)
    film = films[0]
    width, height = r.integer(film, "width", 768), r.integer(film, "height", 576)
    if width < 1 or height < 1:
        raise film.error(f"its size is {width} by {height}; must be 1 by 1 or more")
    if max(width, height) > _LARGEST_SIDE:
        raise film.error(
            f"its size is {width} by {height}; must be {_LARGEST_SIDE} by {_LARGEST_SIDE} or less"
        )
    left, top = r.integer(film, "crop_offset_x", 0), r.integer(film, "crop_offset_y", 0)
    part = (
        left,
        top,
        r.integer(film, "crop_width", width - left),
        r.integer(film, "crop_height", height - top),
    )
    if (
        left < 0
        or top < 0
        or part[2] < 1
        or part[3] < 1
        or left + part[2] > width
        or top + part[3] > height
    ):
        raise film.error(f"its crop {part} does not lie in a picture of {width} by {height}")
    settings = replace(
        settings,
        width=width,
        height=height,
        crop=None if part == (0, 0, width, height) else part,
        filter="gaussian",
        filter_radius=2.0,
    )
    filters = r.nested(film, "rfilter")
    if len(filters) > 1:
        raise film.error(f"has {len(filters)} filters; needs 1")
    if filters:
        settings = _filter(r, filters[0], settings)
    r.ignore(film, "file_format", "pixel_format", "component_format", "sample_border", "compensate")
    r.ignore(
        film, "banner", "high_quality_edges", "attach_log", "gamma", "exposure", "tonemap_method"
    )
    r.finish(film)
    return settings


def _filter(r: Reader, o: Object, settings: Settings) -> Settings:
    if o.type not in _FILTERS:
        raise o.error(f"filter {o.type!r}; must be one of {', '.join(_FILTERS)}")
    ours = _FILTERS[o.type]
    radius: float | None = None
    if o.type == "gaussian":
        deviation = r.number(o, "stddev", 0.5)
        radius = 4.0 * deviation
        if deviation != 0.5:
            r.report(
                f"{o}: a standard deviation of {deviation:g} pixels is not supported; 0.5 is used"
            )
            radius = 2.0
    elif o.type in ("tent", "box"):
        radius = r.number(o, "radius", 1.0 if o.type == "tent" else 0.5)
    else:
        r.ignore(o, "B", "C", "lobes", "radius")
        r.report(f"pixel filter {o.type!r}: not supported; a gaussian is used")
        ours, radius = "gaussian", 2.0
    r.finish(o)
    assert ours is not None
    return replace(settings, filter=ours, filter_radius=radius)


def _sampler(r: Reader, o: Object, settings: Settings) -> Settings:
    """How samples are drawn is our own affair; how many is the scene's."""
    samplers = r.nested(o, "sampler")
    if len(samplers) > 1:
        raise o.error(f"has {len(samplers)} samplers; needs 1")
    if not samplers:
        return replace(settings, spp=4)
    sampler = samplers[0]
    spp = r.integer(sampler, "sample_count", 4)
    seed = r.integer(sampler, "seed", settings.seed)
    if spp < 1:
        raise sampler.error(f"sample_count is {spp}; must be 1 or more")
    r.ignore(sampler, "dimension", "scramble", "jitter", "strength")
    r.finish(sampler)
    return replace(settings, spp=spp, seed=seed)
