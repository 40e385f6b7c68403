"""Camera, Film, Sampler, PixelFilter and Integrator: our camera and settings.

In a camera's own frame x points right, y up and z forward, which is left-handed. Coordinates are
kept as they are, so that a scene without reflections in its camera's transformation is the mirror
image of what the same numbers mean to us: the camera is then `mirrored`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...scene import Camera, Settings
from ..files import PATH_TRACED
from .items import Item
from .transforms import Matrix

if TYPE_CHECKING:
    from .reader import Reader

# Of a picture whose film says nothing
_SIZE = (1280, 720)
# Diagonals of a 35 mm film, and of a lens that sees it as the eye does, millimetres
_FILM_DIAGONAL, _NORMAL_LENS = 35.0, 50.0
# The most bounces that we keep; what is lost is far below anything visible
_ENDLESS = 65536


def read(r: Reader) -> tuple[Camera | None, Settings]:
    """The camera and the settings, of directives that may have come in any order."""
    settings = _integrator(r, _sampler(r, _filter(r, _film(r, Settings()))))
    if "Camera" not in r.options:
        r.report("no Camera: all shapes are framed; left and right are exchanged")
        return None, settings
    item, to_camera = r.options["Camera"]
    item.ignore("shutteropen", "shutterclose", "hither", "yon")
    function = CAMERAS.get(item.type)
    if function is None:
        raise item.error(f"must be one of {', '.join(CAMERAS)}")
    camera = function(item, np.asarray(np.linalg.inv(to_camera)), settings)
    item.finish()
    return camera, settings


def exposure(r: Reader) -> float:
    """What pbrt multiplies all radiance by: of version 4 time times ISO over 100, else "scale"."""
    if "Film" not in r.options:
        return 1.0
    film, _ = r.options["Film"]
    if r.old:
        return max(film.number("scale", 1.0), 0.0)
    time = 1.0
    if "Camera" in r.options:
        camera, _ = r.options["Camera"]
        time = camera.number("shutterclose", 1.0) - camera.number("shutteropen", 0.0)
    factor = time * film.number("iso", 100.0) / 100.0
    if not factor > 0.0:
        raise film.error("an exposure of 0: see iso, shutteropen and shutterclose")
    return factor


# Cameras


def _placed(to_world: Matrix, r: Reader) -> tuple[dict[str, Any], float]:
    """Eye, target, up and mirrored; and the scale of the camera's frame."""
    linear = to_world[:3, :3]
    size = np.linalg.norm(linear, axis=0)
    axes = linear / size
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3 or np.ptp(size) > 1e-3 * size.max():
        r.report("Camera: its transformation shears or scales unevenly; what that does is lost")
    eye = to_world[:3, 3]
    # far from the origin a target one unit away would be lost to rounding
    reach = max(1.0, 1e-3 * float(np.abs(eye).max()))
    found = {
        "eye": _triple(eye),
        "target": _triple(eye + reach * axes[:, 2]),
        "up": _triple(axes[:, 1]),
        "mirrored": bool(np.linalg.det(axes) > 0.0),
    }
    return found, float(np.cbrt(abs(np.linalg.det(linear))))


def _triple(v: Matrix) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


_Window = tuple[float, float, float, float]


def _window(item: Item, settings: Settings) -> _Window:
    """X from, to, y from, to on the screen, whose shorter side is from -1 to 1 unless told."""
    given = settings.width / settings.height
    aspect = item.number("frameaspectratio", given)
    window = (-aspect, aspect, -1.0, 1.0) if aspect > 1 else (-1.0, 1.0, -1 / aspect, 1 / aspect)
    numbers = item.numbers("screenwindow", "float")
    if numbers is not None:
        if len(numbers) != 4 or not (numbers[1] > numbers[0] and numbers[3] > numbers[2]):
            raise item.error("screenwindow needs 4 numbers: x from, to, y from, to")
        a, b, c, d = (float(n) for n in numbers)
        window = (a, b, c, d)
    width, height = window[1] - window[0], window[3] - window[2]
    if abs(width / height - given) > 1e-3 * given:
        item.report("pixels that are not square are not supported; the picture's height counts")
    return window


def _shift(window: _Window) -> tuple[float, float]:
    x0, x1, y0, y1 = window
    x, y = 0.5 * (x0 + x1) / (x1 - x0), -0.5 * (y0 + y1) / (y1 - y0)
    return x or 0.0, y or 0.0


def _vfov(fov: float, window: _Window) -> float:
    """The picture's vertical field of view, where `fov` is of a window from -1 to 1."""
    half = 0.5 * (window[3] - window[2]) * math.tan(0.5 * math.radians(fov))
    return math.degrees(2.0 * math.atan(half))


def _lens(item: Item, scale: float) -> dict[str, Any]:
    radius = item.number("lensradius", 0.0)
    distance = item.number("focaldistance", 1e6)
    if radius <= 0.0:
        return {}
    return {"aperture_radius": radius * scale, "focus_distance": distance * scale}


def _perspective(item: Item, to_world: Matrix, settings: Settings) -> Camera:
    fov = item.number("fov", 2.0 * item.number("halffov", 45.0))
    if not 0.0 < fov < 180.0:
        raise item.error(f"fov is {fov:g}; must lie between 0 and 180")
    placed, scale = _placed(to_world, item.reader)
    window = _window(item, settings)
    return Camera(vfov=_vfov(fov, window), shift=_shift(window), **_lens(item, scale), **placed)


def _orthographic(item: Item, to_world: Matrix, settings: Settings) -> Camera:
    placed, scale = _placed(to_world, item.reader)
    window = _window(item, settings)
    if _lens(item, scale):
        item.report("an orthographic camera with a lens is not supported; all is in focus")
    height = (window[3] - window[2]) * scale
    return Camera(projection="orthographic", height=height, shift=_shift(window), **placed)


def _spherical(item: Item, to_world: Matrix, settings: Settings) -> Camera:
    """Its picture's middle is at -x, and to the right of it -z, of the camera's frame."""
    _lens(item, 1.0)
    _window(item, settings)
    if item.type == "spherical" and item.string("mapping", "equalarea") != "equirectangular":
        item.report("an equal-area picture is not supported; it is equirectangular")
    placed, _ = _placed(to_world, item.reader)
    forward = to_world[:3, 0] / np.linalg.norm(to_world[:3, 0])
    reach = np.linalg.norm(np.subtract(placed["target"], placed["eye"]))
    placed["target"] = _triple(to_world[:3, 3] - reach * forward)
    placed["mirrored"] = not placed["mirrored"]
    return Camera(projection="equirectangular", **placed)


def _realistic(item: Item, to_world: Matrix, settings: Settings) -> Camera:
    item.report(f"lenses are not supported; a pinhole that sees as a {_NORMAL_LENS:g} mm lens does")
    item.ignore("lensfile", "aperturediameter", "focusdistance", "simpleweighting", "aperture")
    placed, _ = _placed(to_world, item.reader)
    diagonal = _FILM_DIAGONAL
    if "Film" in item.reader.options:
        diagonal = item.reader.options["Film"][0].number("diagonal", _FILM_DIAGONAL)
    height = diagonal * settings.height / math.hypot(settings.width, settings.height)
    return Camera(vfov=math.degrees(2.0 * math.atan(0.5 * height / _NORMAL_LENS)), **placed)


CAMERAS: dict[str, Callable[[Item, Matrix, Settings], Camera]] = {
    "perspective": _perspective,
    "orthographic": _orthographic,
    "spherical": _spherical,
    "environment": _spherical,
    "realistic": _realistic,
}


# Film, filter, sampler


def _film(r: Reader, settings: Settings) -> Settings:
    width, height = _SIZE
    crop = None
    if "Film" in r.options:
        film, _ = r.options["Film"]
        width = film.integer("xresolution", width, 1)
        height = film.integer("yresolution", height, 1)
        if max(width, height) > 65536:
            raise film.error(f"its size is {width} by {height}; at most 65536 each")
        crop = _crop(film, width, height)
        if film.type not in ("rgb", "gbuffer", "image", "spectral"):
            film.report("not known; taken for 'rgb'")
        if film.string("sensor", "cie1931") != "cie1931" or film.has("whitebalance"):
            film.ignore("whitebalance")
            film.report(
                "the colours of a camera's sensor, and its white balance, are not supported"
            )
        film.ignore("filename", "savefp16", "diagonal", "maxcomponentvalue", "maxsampleluminance")
        film.ignore("coordinatesystem", "exposuretime", "iso", "scale", "display", "writefrequency")
        film.ignore("nbuckets", "lambdamin", "lambdamax", "premultiplyalpha")
        film.finish()
    return replace(settings, width=width, height=height, crop=crop)


def _crop(film: Item, width: int, height: int) -> tuple[int, int, int, int] | None:
    window = film.numbers("cropwindow", "float")
    bounds = film.numbers("pixelbounds", "integer")
    if window is None and bounds is None:
        return None
    given = window if bounds is None else bounds
    if given is None or len(given) != 4:
        raise film.error("a crop needs 4 numbers: x from, to, y from, to")
    if bounds is None:
        given = np.ceil(np.clip(given, 0.0, 1.0) * (width, width, height, height))
    x0, x1, y0, y1 = (int(v) for v in given)
    x0, x1, y0, y1 = max(x0, 0), min(x1, width), max(y0, 0), min(y1, height)
    if x1 <= x0 or y1 <= y0:
        raise film.error(f"its crop, x {x0} to {x1} and y {y0} to {y1}, is empty")
    return None if (x0, x1, y0, y1) == (0, width, 0, height) else (x0, y0, x1 - x0, y1 - y0)


def _filter(r: Reader, settings: Settings) -> Settings:
    """Radii are half of what the filter spans, as ours are."""
    if "PixelFilter" not in r.options:
        if r.old:
            return replace(settings, filter="box", filter_radius=0.5)
        return replace(settings, filter="gaussian", filter_radius=1.5)
    item, _ = r.options["PixelFilter"]
    old = "xwidth" if item.has("xwidth") or item.has("ywidth") else "xradius"
    defaults = {"box": 0.5, "triangle": 2.0, "gaussian": 2.0 if r.old else 1.5}
    x, y = (item.number(old.replace("x", axis, 1), defaults.get(item.type, 2.0)) for axis in "xy")
    if not (0.0 < x <= 32.0 and 0.0 < y <= 32.0):
        raise item.error(f"its radii are {x:g} and {y:g}; must lie between 0 and 32 pixels")
    if x != y:
        item.report("radii that differ along x and y are not supported; their mean is used")
    ours = {"box": "box", "triangle": "tent", "gaussian": "gaussian"}.get(item.type)
    if ours is None:
        item.report("negative lobes cannot be sampled; a gaussian is used")
        item.ignore("B", "C", "tau")
    elif ours == "gaussian":
        # exp(-alpha x^2), or by the standard deviation; ours is exp(-2 x^2)
        alpha = item.number("alpha", 2.0)
        sigma = item.number("sigma", math.sqrt(0.5 / alpha) if alpha > 0.0 else 0.0)
        if abs(sigma - 0.5) > 1e-3:
            item.report(f"a standard deviation of {sigma:g} pixels is not supported; 0.5 is used")
    item.finish()
    radius = 1.5 if ours is None else 0.5 * (x + y)
    return replace(settings, filter=ours or "gaussian", filter_radius=radius)


def _sampler(r: Reader, settings: Settings) -> Settings:
    """How samples are drawn is our own affair; how many is the scene's."""
    if "Sampler" not in r.options:
        return replace(settings, spp=16)
    item, _ = r.options["Sampler"]
    if item.type == "stratified":
        spp = item.integer("xsamples", 4, 1) * item.integer("ysamples", 4, 1)
        item.ignore("jitter", "dimensions")
    else:
        spp = item.integer("pixelsamples", 16, 1)
        item.ignore("randomization", "samplepixelcenter", "dimensions", "minsamples", "maxsamples")
    seed = item.integer("seed", settings.seed)
    item.finish()
    return replace(settings, spp=spp, seed=seed)


# Integrators that gather all light, each in its own way
_ALL_LIGHT = (
    "path", "volpath", "simplepath", "simplevolpath", "randomwalk", "lightpath", "bdpt", "mlt",
    "sppm", "function", "photonmap", "exphotonmap", "irradiancecache", "igi", "metropolis",
    "diffuseprt", "glossyprt", "dipolesubsurface", "useprobes",
)  # fmt: skip
# Those among them that follow light from its sources too, often chosen for caustics
_FROM_LIGHTS = (
    "lightpath", "bdpt", "mlt", "sppm", "photonmap", "exphotonmap", "metropolis"
)  # fmt: skip


def _integrator(r: Reader, settings: Settings) -> Settings:
    """Pbrt counts bounces; we count rays, the camera's own included: one more."""
    if "Integrator" not in r.options:
        return replace(settings, max_depth=6)  # version 4's and 3's default, 5 bounces
    item, _ = r.options["Integrator"]
    if item.type in ("ao", "ambientocclusion"):
        distance = item.number("maxdistance", item.number("maxdist", math.inf))
        item.ignore("cossample", "nsamples", "illuminant")
        item.finish()
        return replace(settings, integrator="ao", ao_distance=distance if distance < 1e30 else None)
    depth = item.integer("maxdepth", 5)
    if item.type not in _ALL_LIGHT:
        item.report("rendered by path tracing, with all light")
    else:
        if item.type in _FROM_LIGHTS:
            item.report(PATH_TRACED)
        # what is particular to a method changes how light is found, not which
        item.ignore(*item.parameters)
    item.ignore("regularize", "lightsampler", "lightsamplestrategy", "rrthreshold", "pixelbounds")
    item.ignore("strategy", "samplelights", "samplebsdf")
    item.finish()
    return replace(settings, max_depth=min(depth + 1, _ENDLESS))
