"""Arguments of a wrong type: one clear error of ours, which names the argument, for each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.io import LoadOptions

THING = object()
BAD = {"None": None, "3": 3, "'x'": "x", "[]": [], "object()": THING}
TINY = {"width": 8, "height": 6, "spp": 1}


@cache
def prepared() -> ph.Prepared:
    return ph.prepare(ph.weekend())


@cache
def image() -> ph.Image:
    return ph.render(prepared(), features=True, **TINY)


def render(name: str) -> Callable[[Any], object]:
    return lambda value: ph.render(prepared(), **{**TINY, name: value})


def camera(**given: Any) -> ph.Image:
    return ph.render(prepared(), camera=replace(prepared().scene.camera, **given), **TINY)


def scene(**given: Any) -> ph.Image:
    return ph.render(ph.weekend().replace(**given), **TINY)


def spheres(**given: Any) -> ph.Image:
    return ph.render(ph.Scene([ph.Spheres(**{"centers": np.eye(3), **given})]), **TINY)


def shape(kind: Any, **given: Any) -> Callable[[str], Callable[[Any], object]]:
    return lambda name: lambda value: ph.prepare(ph.Scene([kind(**{**given, name: value})]))


def compared(**given: Any) -> ph.Comparison:
    return ph.compare(image(), image(), **given)


def sequence(path: Any = "a.png", **given: Any) -> int:
    return ph.save_sequence([image()], path, **given)


# Argument, what is called with it, what is said of it, and what of BAD it may be
CASES: list[tuple[str, Callable[[Any], object], str, tuple[str, ...]]] = [
    ("compare picture", lambda v: ph.compare(v, image()), "an Image, a path or an array", ("'x'",)),
    ("compare reference", lambda v: ph.compare(image(), v), "an Image, a path or", ("'x'",)),
    ("compare variances", lambda v: compared(variances=v), "variances: two arrays", ("None",)),
    ("compare a variance", lambda v: compared(variances=(v, v)), "variances: ", ()),
    ("compare exposure", lambda v: compared(exposure=v), "exposure is .*; must be a num", ("3",)),
    ("side_by_side scale", lambda v: compared().side_by_side(v), "scale is .*; must be", ("3",)),
    ("html names", lambda v: compared().html(v), "names is .*; must be two texts", ()),
    ("conductor metal_name", ph.conductor, "unknown metal", ()),
    ("frames_of thing", ph.frames_of, "an object of type .* has no frames", ()),
    ("load path", ph.load, "path: a path is needed, not", ("'x'",)),
    ("load options", lambda v: ph.load("x", v), "options: LoadOptions are needed, not", ("None",)),
    ("load_frames path", ph.load_frames, "path: a path is needed, not", ("'x'",)),
    ("load_frames options", lambda v: ph.load_frames("x", options=v), "options: LoadO", ("None",)),
    ("prepare scene", ph.prepare, "an object of type|no such file|particle|positions", ()),
    ("prepare memory_limit", lambda v: ph.prepare(ph.weekend(), memory_limit=v),
     "memory_limit is .*; must be a number of bytes", ("None", "3")),
    ("scene_of thing", ph.scene_of, "an object of type|no such file|particle|positions", ()),
    ("merge parts", ph.merge, "parts: there are none|parts: a list of files is needed", ()),
    ("render shard", render("shard"), "shard needs checkpoint", ("None",)),
    ("rerender path", ph.rerender, "path: a path is needed, not", ("'x'",)),
    ("save scene", lambda v: ph.save(v, "a.glb"), "scene: a Scene is needed, not", ()),
    ("save path", lambda v: ph.save(ph.weekend(), v), "path: a path is needed, not", ("'x'",)),
    ("save strict", lambda v: ph.save(ph.weekend(), "a.glb", strict=v), "strict is .*; must", ()),
    ("save_sequence images", lambda v: ph.save_sequence(v, "a.png"), "images: a list is", ("[]",)),
    ("save_sequence image", lambda v: ph.save_sequence([v], "a.png"), r"images\[0\]: an Image", ()),
    ("save_sequence path", sequence, "path: a path is needed, not", ("'x'",)),
    ("save_sequence fps", lambda v: sequence(fps=v), "fps is .*; must lie in", ("3",)),
    ("save_sequence numbers", lambda v: sequence(numbers=v), "numbers: ", ("None",)),
    ("save_sequence number", lambda v: sequence(numbers=[v]), "numbers", ("3",)),
    ("save_sequence bits", lambda v: sequence(bits=v), "cannot hold .* bits", ("None",)),
    ("trace_pixel scene", lambda v: ph.trace_pixel(v, 1, 1), "object of type|no such|part|pos", ()),
    ("trace_pixel x", lambda v: ph.trace_pixel(prepared(), v, 1), "x is .*; must be", ("3",)),
    ("trace_pixel y", lambda v: ph.trace_pixel(prepared(), 1, v), "y is .*; must be", ("3",)),
    ("trace_pixel sample", lambda v: ph.trace_pixel(prepared(), 1, 1, v), "sample is", ("3",)),
    ("trace_pixel camera", lambda v: ph.trace_pixel(prepared(), 1, 1, camera=v), "camera: a Camera",
     ("None",)),
    ("turntable count", lambda v: ph.turntable(prepared(), v), "pictures of a turn", ("3",)),
    ("turntable up", lambda v: ph.turntable(prepared(), 2, up=v), "up is .*; must be", ("None",)),
    ("turntable places", lambda v: ph.turntable(prepared(), 2, places=v), "places", ("None", "[]")),
    ("turntable camera", lambda v: ph.turntable(prepared(), 2, camera=v), "camera: a C", ("None",)),
    ("weekend seed", ph.weekend, "seed is .*; must be a whole number", ("3",)),
    ("srgb bits", lambda v: image().srgb(v), "bits is .*; must be 8 or 16", ()),
    ("srgb legend", lambda v: image().srgb(legend=v), "legend is .*; must be True or False", ()),
    ("srgb exposure", lambda v: image().srgb(exposure=v), "exposure is .*; must be a num", ("3",)),
    ("srgb view_transform", lambda v: image().srgb(view_transform=v), "unknown view_transform", ()),
    ("srgb white_balance", lambda v: image().srgb(white_balance=v), "white_balance is", ("None",)),
    ("denoised quality", lambda v: image().denoised(v), "unknown quality", ()),
    ("denoised prefilter", lambda v: image().denoised(prefilter=v), "prefilter is .*; must be", ()),
    ("denoised progress", lambda v: image().denoised(progress=v), "progress is .*; must be a func",
     ("None",)),
    ("matte shape", lambda v: image().matte(shape=v), "matte: ", ()),
    ("matte material", lambda v: image().matte(material=v), "matte: ", ()),
    ("Image.save path", lambda v: image().save(v), "path: a path is needed, not", ("'x'",)),
    ("Image.save bits", lambda v: image().save("a.png", v), "cannot hold .* bits", ("None",)),
    ("Image.save legend", lambda v: image().save("a.png", legend=v), "legend is .*; must be", ()),
    ("Image.save exposure", lambda v: image().save("a.png", exposure=v), "exposure is", ("3",)),
    ("Image.save view_transform", lambda v: image().save("a.png", view_transform=v), "unknown v",
     ()),
    ("Image.save compression", lambda v: image().save("a.exr", compression=v), "unknown compressi",
     ("None",)),
    ("Image.save tiled", lambda v: image().save("a.exr", tiled=v), "tiled is .*; must be True", ()),
    ("a legend", lambda v: replace(image(), legend=v).srgb(legend=True), "there is no legend|legend"
     ": a ColorBar or Swatches are needed", ()),
    *((f"render {name}", render(name), said, accepted) for name, said, accepted in [
        ("camera", "camera: a Camera or a Framing is needed", ("None",)),
        ("threads", "threads is .*; must be a whole number", ("3",)),
        ("progress", "progress is .*; must be a function, True or None", ("None",)),
        ("features", "features is .*; must be True or False", ()),
        ("time_limit", "time_limit is .*; must be a number", ("None", "3")),
        ("counts", "counts: whole numbers of shape", ("None",)),
        ("checkpoint", "checkpoint: a path is needed, not", ("None", "'x'")),
        ("checkpoint_every", "checkpoint_every .*must be a number", ("3",)),
        ("resume", "resume is .*; must be True or False", ()),
        ("tree", "unknown tree", ()),
        ("schedule", "unknown schedule", ()),
        ("tile", "tile is .*; must be a whole number", ("3",)),
        ("isa", "unknown instruction set", ()),
        ("memory_limit", "memory_limit is .*; must be a number of bytes", ("None", "3")),
        ("width", "width is .*; must be a whole number", ("None", "3")),
        ("height", "height is .*; must be a whole number", ("None", "3")),
        ("spp", "spp is .*; must be a whole number", ("None", "3")),
        ("max_depth", "max_depth is .*; must be a whole number", ("None", "3")),
        ("seed", "seed is .*; must be a whole number", ("None", "3")),
        ("sampler", "unknown sampler", ("None",)),
        ("filter", "unknown filter", ("None",)),
        ("filter_radius", "filter_radius is .*; must be a number", ("None", "3")),
        ("roulette", "roulette is .*; must be True or False", ("None",)),
        ("reuse_paths", "reuse_paths is .*; must be True, False or \"auto\"", ("None",)),
        ("crop", "crop (must be four numbers|is 'x')", ("None",)),
        ("integrator", "unknown integrator", ("None",)),
        ("ao_distance", "ao_distance is .*; must be a number", ("None", "3")),
        ("backdrop", "backdrop is .*; must be three numbers", ("None",)),
        ("noise", "noise is .*; must be a number", ("None", "3")),
        ("clamp_indirect", "clamp_indirect is .*; must be a number", ("None", "3")),
    ]),
    *((f"Camera.{name}", lambda v, name=name: camera(**{name: v}), f"{name}", accepted)
      for name, accepted in [
        ("eye", ()), ("target", ()), ("up", ()), ("fov", ("None",)), ("vfov", ("None", "3")),
        ("aperture_radius", ("3",)), ("focus_distance", ("None", "3")), ("projection", ()),
        ("height", ("None",)), ("shift", ()), ("mirrored", ()),
    ]),
    *((f"Framing.{name}", lambda v, name=name: scene(camera=ph.Framing(**{name: v})),
       f"camera: .*{name}", accepted)
      for name, accepted in [
        ("direction", ()), ("up", ()), ("vfov", ("3",)), ("fill", ()), ("shapes", ("[]",)),
    ]),
    *((f"Scene.{name}", lambda v, name=name: scene(**{name: v}), said, accepted)
      for name, said, accepted in [
        ("shapes", "shapes: ", ("[]",)),
        ("materials", "materials: a dict is needed", ()),
        ("camera", "camera: a Camera or a Framing is needed", ("None",)),
        ("background", "background: a Background is needed", ("None",)),
        ("settings", "settings: Settings are needed", ()),
        ("lights", "lights", ("[]",)),
        ("source", "source: a Source is needed", ("None",)),
    ]),
    *((f"Spheres.{name}", lambda v, name=name: spheres(**{name: v}), said, accepted)
      for name, said, accepted in [
        ("centers", "centers", ("[]",)), ("radii", "radii", ("3",)), ("material", "material", ()),
        ("colors", "colors", ("None",)), ("rotation", "rotation", ("None",)),
    ]),
    *((f"Mesh.{name}", shape(ph.Mesh, vertices=np.eye(3), faces=[[0, 1, 2]])(name), name, accepted)
      for name, accepted in [
        ("vertices", ()), ("faces", ("[]",)), ("normals", ("None",)), ("uvs", ("None",)),
        ("tangents", ("None",)), ("attributes", ()),
    ]),
    *((f"Curves.{name}", shape(ph.Curves, points=np.eye(4, 3))(name), name, accepted)
      for name, accepted in [
        ("points", ("[]",)), ("radii", ("3",)), ("counts", ("None",)), ("basis", ()), ("style", ()),
    ]),
    *((f"Instances.{name}", shape(ph.Instances, shapes=[ph.Spheres(np.eye(3))],
                                  transforms=np.eye(4)[None])(name), said, accepted)
      for name, said, accepted in [
        ("shapes", "shapes", ("[]",)), ("transforms", "transforms", ("[]",)),
        ("colors", "colors", ("None",)),
    ]),
    *((f"{kind.__name__} type", lambda v, make=make: ph.prepare(make(v)), "unknown|needed", ())
      for kind, make in [
        (ph.Material, lambda v: ph.Scene([ph.Spheres(np.eye(3), material=ph.Material(v))])),
        (ph.Light, lambda v: ph.Scene(lights=[ph.Light(v)])),
        (ph.Background, lambda v: ph.Scene(background=ph.Background(v))),
        (ph.Texture, lambda v: ph.Scene([ph.Spheres(np.eye(3), material=ph.Material(
            "diffuse", color=ph.Texture(v)))])),
    ]),
    *((f"LoadOptions.{name}", lambda v, name=name: LoadOptions(**{name: v}), f"{name}.* must be|"
       f"{name}.*: a path is needed", accepted)
      for name, accepted in {
        "color_by": ("None", "'x'"), "colormap": ("'x'",), "color_range": ("None",),
        "radius": ("None", "3", "'x'"), "ground": ("None",), "frame": ("3",), "style": ("'x'",),
        "bond_length": ("None", "3"), "box": (), "wrap": (), "assembly": ("None", "3"),
        "defines": (), "strict": (), "allow_paths": ("[]",), "view": ("None", "'x'"),
        "environment": ("None", "'x'"), "up": ("None", "'x'"), "time": ("None", "3"),
        "variant": ("None", "'x'"), "camera": ("None", "'x'"),
    }.items()),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "said", "value"),
    [
        pytest.param(call, said, value, id=f"{name}={shown}")
        for name, call, said, accepted in CASES
        for shown, value in BAD.items()
        if shown not in accepted
    ],
)
def test_a_wrong_type_is_one_clear_error(
    call: Callable[[Any], object],
    said: str,
    value: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ph.SceneError, match=said):
        call(value)
    assert list(tmp_path.iterdir()) == []


def test_every_option_and_setting_has_a_case() -> None:
    names = {name for name, *_ in CASES}
    assert {f"LoadOptions.{f.name}" for f in fields(LoadOptions)} <= names
    assert {f"render {f.name}" for f in fields(ph.Settings)} <= names
    assert {f"Camera.{f.name}" for f in fields(ph.Camera)} <= names
    assert {f"Framing.{f.name}" for f in fields(ph.Framing)} <= names
