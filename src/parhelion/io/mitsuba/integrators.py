"""<integrator>: which light is gathered, and how far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ...scene import Settings
from ..files import PATH_TRACED
from .document import Object
from .reader import Reader

# Ours for Mitsuba's "no limit"; the share of light that is lost is far below anything visible
_ENDLESS = 65536

# Wrappers that pass on what another integrator gathers
_WRAPPERS = ("moment", "aov", "adaptive", "irrcache")
# Others that gather the same light as "path", in other ways
_SAME_LIGHT = (
    "path", "volpath", "volpathmis", "volpath_simple", "ptracer", "bdpt", "pssmlt", "mlt", "erpt",
    "prb", "prb_basic", "prbvolpath", "photonmapper", "sppm", "ppm",
)  # fmt: skip
# Those among them that follow light from its sources too, often chosen for caustics
_FROM_LIGHTS = ("ptracer", "bdpt", "pssmlt", "mlt", "erpt", "photonmapper", "sppm", "ppm")


def read(r: Reader, o: Object, settings: Settings) -> Settings:
    """The settings with the integrator's."""
    if o.type in _WRAPPERS:
        inner = r.nested(o, "integrator")
        if len(inner) != 1:
            raise o.error(f"has {len(inner)} integrators in it; needs 1")
        if r.has(o, "aovs"):
            r.report(f"property 'aovs' of {o}: choose them when rendering; ignored")
            r.ignore(o, "aovs")
        r.finish(o)
        return read(r, inner[0], settings)
    names: dict[str, Callable[[Reader, Object], Settings]] = {
        **{name: lambda r, o: _path(r, o, settings) for name in _SAME_LIGHT},
        "direct": lambda r, o: _direct(r, o, settings),
        "ao": lambda r, o: _ao(r, o, settings),
    }
    return r.make(o, names, settings)


def _common(r: Reader, o: Object) -> None:
    r.ignore(
        o, "rr_depth", "samples_per_pass", "block_size", "timeout", "version", "strict_normals"
    )
    if r.boolean(o, "hide_emitters", False):
        r.report(f"property 'hide_emitters' of {o}: not supported; they are shown")


def _path(r: Reader, o: Object, settings: Settings) -> Settings:
    """Both count rays, the camera's own included: at 2, light that was scattered once."""
    _common(r, o)
    if o.type in _FROM_LIGHTS:
        r.report(f"{o}: {PATH_TRACED}")
    depth = r.integer(o, "max_depth", -1)
    if depth < -1:
        raise o.error(f"max_depth is {depth}; must be -1, for no limit, or 0 and above")
    if depth == 0:
        raise o.error("max_depth is 0, which makes every picture black")
    return replace(settings, max_depth=_ENDLESS if depth == -1 else min(depth, _ENDLESS))


def _direct(r: Reader, o: Object, settings: Settings) -> Settings:
    _common(r, o)
    r.ignore(o, "shading_samples", "emitter_samples", "bsdf_samples")
    return replace(settings, integrator="direct")


def _ao(r: Reader, o: Object, settings: Settings) -> Settings:
    _common(r, o)
    r.ignore(o, "shading_samples")
    length = r.number(o, "ray_length", -1.0)
    return replace(settings, integrator="ao", ao_distance=length if length > 0.0 else None)
