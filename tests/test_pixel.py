"""One sample's path: its numbers, and that they are those of the picture."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import parhelion as ph
from parhelion import _core, cli, renderer
from parhelion.framing import placed
from parhelion.renderer import make_view, merged

DIFFUSE = ph.Material("diffuse", color=(0.8, 0.6, 0.4))


def everything() -> ph.Scene:
    """Something of all that a path can do: glass in glass, a prism, holes, clear surfaces, blends,
    all ways in which materials are worked out, copies, lamps of several shapes, lights without
    extent, a panorama.
    """
    rng = np.random.default_rng(4)
    checker = ph.Texture("checker", color0=(0.0, 0.0, 0.0), color1=(1.0, 1.0, 1.0))
    materials = [
        DIFFUSE,
        ph.Material("metal", color=(0.9, 0.9, 0.8), fuzz=0.2),
        ph.Material("dielectric", ior=1.5, dispersion=0.5),
        ph.Material("dielectric", ior=1.33, priority=2, absorption=(0.1, 0.4, 0.2)),
        ph.Material("diffuse", color=(0.5, 0.9, 0.5), opacity=0.5, emission=(0.2, 0.1, 0.0)),
        ph.Material("null", color=(0.9, 0.5, 0.9)),
        ph.Material("blend", a=DIFFUSE, b=ph.Material("principled", transmission=0.5), weight=0.5),
        ph.Material("plastic", color=checker),
        ph.Material("plastic", roughness=0.4, compensation="off"),
        ph.Material("conductor", roughness=0.4, anisotropy=0.5, compensation="off"),
        ph.Material("conductor", roughness=0.3, distribution="beckmann", compensation="off"),
        ph.Material("conductor", roughness=0.5, color=checker),
        ph.Material("dielectric", roughness=0.4, priority=1, dispersion=0.3),
        ph.Material("principled", metallic=0.5, clearcoat=0.5, color=checker),
        ph.Material("principled", metallic=0.5, color=checker),
        ph.Material("principled", priority=3, color=(0.5, 0.6, 0.7)),
        ph.Material("dielectric", roughness=0.01),  # as good as smooth, but no plain form
    ]

    def image(high: int, channels: int, channel: str = "rgb") -> ph.Texture:
        texels = rng.integers(0, high, (5, 7, channels)).astype(np.uint8)
        return ph.Texture("image", image=texels, channel=channel)

    painted = ph.Material(
        "principled",
        color=image(256, 3),
        metallic=(several := image(256, 4, "b")),
        roughness=ph.Texture("image", image=several.params["image"], channel="g"),
        specular=checker,
        normal_map=image(256, 3),
        emission=image(40, 3),
    )
    corners = [[-9, -9, -3], [9, -9, -3], [9, 9, -3], [-9, 9, -3]]
    uvs = [[-1, -1], [2, -1], [2, 2], [-1, 2]]
    shapes: list[Any] = [
        ph.Spheres(rng.uniform(-2, 2, (7, 3)), rng.uniform(0.3, 0.7, 7), material=m, name=f"s{i}")
        for i, m in enumerate(materials)
    ]
    shapes.append(ph.Mesh(corners, [[0, 1, 2], [0, 2, 3]], uvs=uvs, material=painted, name="wall"))
    lamp = ph.Material("emissive", radiance=(4.0, 3.0, 2.0))
    face = ph.Mesh([[-3, 4, -3], [3, 4, -3], [0, 4, 3]], [[0, 1, 2]], material=lamp, name="lamp")
    copied = [ph.Spheres([[0, 0, 0]], 0.4, material=lamp, name="bulb"), *shapes[:1]]
    matrices = np.zeros((3, 3, 4))
    matrices[:, :, :3], matrices[:, :, 3] = 0.5 * np.eye(3), rng.uniform(-3, 3, (3, 3))
    panorama = rng.uniform(0, 1, (8, 16, 3)).astype(np.float32)
    return ph.Scene(
        [*shapes, face, ph.Instances(copied, matrices, name="copies")],
        camera=ph.Camera(eye=(0, 1, 9), target=(0, 0, 0), aperture_radius=0.05),
        background=ph.Background("envmap", image=panorama),
        lights=[ph.Light("point", position=(0, 0, 4), intensity=(5.0, 5.0, 5.0))],
    )


def core_view(prepared: ph.Prepared, **settings: Any) -> Any:
    wanted = merged(prepared.scene.settings, settings)
    return make_view(prepared.core, placed(prepared.scene, wanted.width / wanted.height), wanted)


@pytest.mark.parametrize("scene", [ph.weekend(), everything()], ids=["weekend", "everything"])
@pytest.mark.parametrize("more", [{}, {"integrator": "direct"}, {"integrator": "ao"}])
def test_the_path_is_that_of_the_picture(scene: ph.Scene, more: dict[str, Any]) -> None:
    prepared = ph.prepare(scene)
    settings = {"width": 12, "height": 8, "seed": 3, **more}
    view = core_view(prepared, **settings)
    events, ends, lights = set(), set(), set()
    for y in range(8):
        for x in range(12):
            for sample in (0, 5, 31, 77) if scene.lights and not more else (5,):
                path = ph.trace_pixel(prepared, x, y, sample, **settings)
                alone = _core.one_sample(prepared.core, view, x, y, sample)
                assert path.radiance == tuple(alone)
                parts = [v.emitted for v in path.vertices] + [path.background]
                parts += [v.light.added for v in path.vertices if v.light]
                if "ao" not in more.values():
                    assert_allclose(np.sum(parts, axis=0), path.radiance, rtol=1e-6, atol=1e-12)
                events |= {v.event for v in path.vertices}
                ends.add(path.end)
                lights |= {v.light.name for v in path.vertices if v.light}
    picture = ph.render(prepared, spp=1, **settings).numpy()
    ours = [
        [ph.trace_pixel(prepared, x, y, **settings).radiance for x in range(12)] for y in (3, 6)
    ]
    assert_allclose(picture[[3, 6]], ours, rtol=0, atol=2.0**-52)
    if more or len(scene.lights) == 0:
        return
    assert events == {"reflects", "transmits", "passes", "ends"}
    assert lights >= {"background", "lights[0]", "lamp", "bulb"}
    assert {"leaves the scene", "is ended by Russian roulette"} <= ends
    assert "is absorbed: the material sends nothing on" in ends


def test_the_numbers_of_a_vertex() -> None:
    """A ball under a lamp without extent, seen through the middle of the picture."""
    lamp = ph.Light("point", position=(0, 4, 3), intensity=(10.0, 20.0, 30.0))
    balls = ph.Spheres([[50, 0, 0], [0, 0, 0]], [1.0, 2.0], material=DIFFUSE, name="balls")
    camera = ph.Camera(eye=(0, 0, 12), target=(0, 0, 0), vfov=1e-3)
    scene = ph.Scene([balls], camera=camera, background=None, lights=[lamp])
    path = ph.trace_pixel(scene, 1, 1, 5, width=3, height=3)
    assert (path.x, path.y, path.sample) == (1, 1, 5)
    assert_allclose(path.origin, (0, 0, 12), atol=1e-4)
    assert_allclose(path.direction, (0, 0, -1), atol=1e-4)
    first = path.vertices[0]
    assert (first.shape, first.primitive, first.copy, first.depth) == ("balls", 1, None, 1)
    assert (first.material, first.front) == ("diffuse", True)
    assert_allclose(first.position, (0, 0, 2), atol=1e-3)
    assert_allclose(first.distance, 10, rtol=1e-5)
    assert_allclose(first.normal, (0, 0, 1), atol=1e-3)
    assert_allclose(first.shading_normal, first.normal, atol=1e-6)
    assert first.emitted == (0, 0, 0)
    light = first.light
    assert light is not None
    assert (light.name, light.primitive, light.copy, light.delta) == ("lights[0]", None, None, True)
    towards = np.array((0, 4, 1)) / np.sqrt(17)
    assert_allclose(light.direction, towards, atol=1e-3)
    assert_allclose(light.distance, np.sqrt(17), rtol=1e-3)
    assert_allclose(light.pdf, 1)
    expected = np.array((10, 20, 30)) / 17
    assert_allclose(light.radiance, expected, rtol=1e-3)
    assert light.scattered
    assert_allclose(light.added, expected * (0.8, 0.6, 0.4) / np.pi * towards[2], rtol=2e-3)
    assert first.event == "reflects"
    assert not first.specular
    assert_allclose(first.pdf, np.dot(first.direction, first.normal) / np.pi, rtol=1e-3)
    assert_allclose(first.throughput, (0.8, 0.6, 0.4), rtol=1e-5)
    assert path.end == "leaves the scene"
    assert path.background == (0, 0, 0)


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("diffuse", {}),
        ("conductor", {"roughness": 0.4}),
        ("dielectric", {"dispersion": 0.3}),
        ("dielectric", {"roughness": 0.4, "priority": 1}),
        ("thin_dielectric", {}),
        ("plastic", {"roughness": 0.4}),
        ("principled", {"metallic": 0.5}),
        ("principled", {"transmission": 0.5, "roughness": 0.4}),
        ("principled", {"iridescence": 1.0}),
        ("diffuse_transmission", {}),
        ("null", {}),
        ("blend", {"b": {"metallic": 0.5, "transmission": 0.5}}),
    ],
    ids=str,
)
def test_a_colour_of_its_own_is_as_good_as_the_material_s(name: str, params: dict) -> None:
    """In pictures, features and paths; whether sixteen are worked out together or one by one."""

    def material(color: Any) -> ph.Material:
        if name != "blend":
            return ph.Material(name, **params, **color)
        parts = (ph.Material("plastic", **color), ph.Material("principled", **params["b"], **color))
        return ph.Material("blend", a=parts[0], b=parts[1], weight=0.4)

    centers, color = np.random.default_rng(7).uniform(-1, 1, (12, 3)), (0.9, 0.5, 0.25)
    sky = ph.Background("gradient", horizon=(0.1, 0.2, 0.3), zenith=(1.0, 0.9, 0.8))
    lamp = ph.Light("point", position=(0, 4, 3), intensity=(10.0, 20.0, 30.0))
    pictures, features, paths = [], [], []
    for balls in (
        ph.Spheres(centers, 0.5, material({"color": color}), name="balls"),
        ph.Spheres(centers, 0.5, material({}), [color] * 12, name="balls"),
    ):
        scene = ph.Scene([balls], camera=ph.Camera(eye=(0, 1, 5)), background=sky, lights=[lamp])
        prepared = ph.prepare(scene)
        picture = ph.render(prepared, width=24, height=16, spp=8, features=True)
        pictures.append(picture.numpy())
        features.append(picture.features["albedo"])
        told = [ph.trace_pixel(prepared, 12, y, width=24, height=16) for y in range(2, 14)]
        paths.append([[(v.pdf, v.specular, v.throughput) for v in p.vertices] for p in told])
    assert_array_equal(*pictures)
    assert_array_equal(*features)
    assert paths[0] == paths[1]
    assert any(paths[0])


def test_mirrors_copies_and_ends() -> None:
    mirror = ph.Material("metal", color=(0.9, 0.9, 0.9), fuzz=0.0)
    ball = ph.Spheres([[0, 0, 0]], 1.0, material=mirror, name="ball")
    matrices = np.stack([np.eye(4), np.eye(4)])[:, :3]
    matrices[0, 0, 3] = 40.0
    camera = ph.Camera(eye=(0, 0, 12), target=(0, 0, 0), vfov=1e-3)
    scene = ph.Scene([ph.Instances([ball], matrices, name="two")], camera=camera)
    path = ph.trace_pixel(scene, 1, 1, width=3, height=3)
    assert [v.copy for v in path.vertices] == [("two", 1)]
    assert path.vertices[0].shape == "ball"
    assert path.vertices[0].specular
    assert_allclose(path.vertices[0].direction, (0, 0, 1), atol=1e-3)
    assert_allclose(path.background, path.radiance)
    short = ph.trace_pixel(scene, 1, 1, width=3, height=3, max_depth=1)
    assert short.end == "has as many rays as a path may have"
    assert short.vertices[0].event == "ends"
    assert short.radiance == (0, 0, 0)
    # a fisheye's picture is round
    around = camera.__class__(eye=(0, 0, 12), target=(0, 0, 0), projection="fisheye", vfov=180)
    corner = ph.trace_pixel(scene, 0, 0, width=64, height=64, camera=around)
    assert corner.end == "does not begin: the camera sees nothing there"
    assert corner.vertices == ()


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["pixel", "weekend", "160", "120", "7", "--width", "320", "--seed", "2"]
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    path = ph.trace_pixel(ph.weekend(), 160, 120, 7, width=320, seed=2)
    assert said == f"{path}\n"
    assert re.match(r"sample 7 of pixel 160,120: radiance \([\d., e-]+\)\ncamera at \(", said)
    assert f"1. {path.vertices[0].shape!r}, primitive {path.vertices[0].primitive}, " in said
    assert said.endswith(f"the path {path.end}\n")
    assert cli.main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["radiance"] == list(path.radiance)
    assert len(found["vertices"]) == len(path.vertices)
    assert found["vertices"][0]["position"] == list(path.vertices[0].position)
    assert found == path.as_dict()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("weekend 640 3", "x is 640; must be a whole number in [0, 640)"),
        ("weekend 3 -1", "y is -1; must be a whole number in [0, 360)"),
        ("weekend 3 3 -2", "sample is -2; must be a whole number in [0, 2147483648)"),
        ("nowhere.json 3 3", "nowhere.json: no such file"),
        ("weekend 3 3 --sampler best", "unknown sampler 'best'"),
    ],
)
def test_a_pixel_without_meaning(words: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["pixel", *words.split()]) == 2
    assert told in capsys.readouterr().err


def test_the_warning_about_samples_that_are_not_finite_names_it(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared, settings = ph.prepare(ph.weekend()), merged(ph.Settings(), {"crop": (10, 20, 4, 4)})
    counts, bad = np.full((4, 4), 8), np.zeros((4, 4), int)
    bad[2, 3] = 1
    view = core_view(prepared)
    wrong = (float("nan"), 0.0, 0.0)
    monkeypatch.setattr(_core, "one_sample", lambda *a: wrong if a[4] == 5 else (0.0, 0.0, 0.0))
    image = SimpleNamespace(settings=settings, counts=counts)
    renderer._report_bad(prepared, view, image, bad)
    assert "1 samples were not finite" in caplog.text
    assert "the first is sample 5 of pixel 13,22 (`parhelion pixel SCENE 13 22 5 " in caplog.text


def test_json_holds_what_is_not_finite() -> None:
    sky = ph.Background("constant", radiance=(1e12, 1.0, 1.0))
    path = ph.trace_pixel(ph.Scene([ph.Spheres([[0, 0, 0]], 1.0)], background=sky), 0, 0)
    assert json.loads(json.dumps(path.as_dict(), allow_nan=False))["end"] == path.end
    from dataclasses import replace

    broken = replace(path, radiance=(float("nan"), float("inf"), 0.5))
    assert broken.as_dict()["radiance"] == ["nan", "inf", 0.5]
    assert_array_equal(broken.as_dict()["direction"], path.direction)
