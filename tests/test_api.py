"""What a Python user touches: names, scenes from arrays, render() and its errors."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from conftest import REPOSITORY
from parhelion import _core, machine, memory, renderer
from parhelion.flatten import flatten
from parhelion.framing import bounds
from parhelion.progress import Progress
from parhelion.renderer import merged
from picture_tools import read_picture

ONE = ph.Scene([ph.Spheres([[0, 0, 0]])])
RED = ph.Material("diffuse", color=(0.8, 0.1, 0.1))
BLUE = ph.Material("diffuse", color=(0.1, 0.1, 0.8))
TINY = {"width": 16, "spp": 2}


def same(a: ph.Scene | ph.Prepared, b: ph.Scene | ph.Prepared) -> bool:
    """Whether two scenes look the same to the last bit."""
    one, other = ph.render(a, **TINY), ph.render(b, **TINY)
    return np.array_equal(one.numpy(), other.numpy())


def script(code: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, **options
    )


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")
def test_trees_take_little_memory_and_leave_none_behind() -> None:
    # 24 bytes a sphere are the tree's and 8 the build's; at 1e6, some are the imports' and threads'
    done = script(
        "import numpy as np, parhelion as ph\n"
        "def held(what):\n"
        "    lines = dict(line.split(':') for line in open('/proc/self/status'))\n"
        "    return int(lines[what].split()[0]) * 1024\n"
        "def cloud(n):\n"
        "    centers = np.random.default_rng(1).random((n, 3), dtype=np.float32)\n"
        "    return ph.Scene([ph.Spheres(centers, np.full(n, 0.25 * n ** (-1 / 3), np.float32))])\n"
        "ph.prepare(cloud(100))\n"
        "large, small = cloud(1_000_000), cloud(50_000)\n"
        "before = held('VmRSS')\n"
        "ph.prepare(large)\n"
        "print((held('VmHWM') - before) / 1e6)\n"
        "sizes = []\n"
        "for _ in range(40):\n"
        "    ph.prepare(small)\n"
        "    sizes.append(held('VmRSS'))\n"
        "print((sizes[-1] - sizes[9]) / 2**20)",
        env={**os.environ, "OMP_NUM_THREADS": "2"},
    )
    assert done.returncode == 0, done.stderr
    peak, grown = map(float, done.stdout.split())
    assert peak < 45.0  # bytes a sphere
    assert grown < 10.0  # MiB; a tree takes 1.2


# --- Names ---------------------------------------------------------------------------------------


def test_import_is_cheap() -> None:
    done = script(
        "import sys, parhelion\n"
        "dir(parhelion)\n"
        "print(*{m.partition('.')[0] for m in sys.modules} & {'numpy', 'msgspec', 'rich',"
        " 'matplotlib', 'OpenImageIO', 'chemfiles', 'gsd'})\n"
        "print(*sorted(m for m in sys.modules if m.startswith('parhelion')))\n"
    )
    assert done.stdout == "\nparhelion parhelion._core\n", done.stderr


WAITS = {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME"}


@pytest.mark.parametrize("said", [{}, {"GOMP_SPINCOUNT": "77"}, {"OMP_WAIT_POLICY": "active"}])
def test_threads_sleep_soon_unless_the_user_says_how_they_wait(said: dict[str, str]) -> None:
    done = script(
        "import os; before = dict(os.environ)\nimport parhelion; assert dict(os.environ) == before",
        env={k: v for k, v in os.environ.items() if k not in WAITS}
        | {"OMP_DISPLAY_ENV": "verbose", **said},
    )
    assert done.returncode == 0, done.stderr
    told = re.search(r"GOMP_SPINCOUNT = '(\d+)'", done.stderr)
    if told is None:
        pytest.skip("needs GCC's OpenMP, which tells how threads wait")
    if "OMP_WAIT_POLICY" in said:
        assert int(told[1]) > 10**9
    else:
        assert told[1] == said.get("GOMP_SPINCOUNT", "10000")


@pytest.mark.parametrize(
    "work",
    [
        "ph.render(scene, spp=10**6)",
        "ph.render(scene, spp=10**6, progress=lambda told: None)",
        "ph.render(scene, spp=10**6, progress=lambda told: time.sleep(0.05))",
        "while True: ph.intersect(scene, np.zeros((10**6, 3)), (0, 0, 1))",
        "while True: ph.prepare(ph.Scene([ph.Spheres(centers, 0.1)]))",
    ],
)
def test_python_may_end_while_another_thread_is_at_work(work: str) -> None:
    code = f"""
import threading, time
import numpy as np, parhelion as ph
centers = np.random.default_rng(1).normal(size=(10**5, 3))
scene = ph.prepare(ph.Scene([ph.Spheres(centers[:2000], 0.1)]))
def work():
    {work}
threading.Thread(target=work, daemon=True).start()
time.sleep(0.3)
print("whole")
"""
    done = script(code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "whole\n", "")


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads by Linux's /proc")
@pytest.mark.parametrize("count", [1, 3])
def test_no_more_threads_than_are_asked_for(count: int) -> None:
    """Not for trees, meshes, films and means of many pixels either."""
    code = f"""
import os, numpy as np, parhelion as ph
from parhelion import _core
threads = lambda: len(os.listdir("/proc/self/task"))
before, most = threads(), _core.max_threads()
corners = np.random.default_rng(1).random((30_000, 3)).astype(np.float32)
mesh = ph.Mesh(corners, np.arange(30_000).reshape(-1, 3), normals=corners + 1)
balls = ph.Spheres(corners, 0.001)
size = dict(width=320, height=320, spp=1, max_depth=2)
ph.render(ph.Scene([mesh, balls]), threads={count}, features=True, time_limit=60, **size)
assert threads() - before == {count} - 1, threads() - before
assert _core.max_threads() == most
"""
    done = script(code, env=os.environ | {"OMP_NUM_THREADS": "5"})
    assert done.returncode == 0, done.stderr


def test_a_quota_of_processor_time_counts_for_trees(monkeypatch: pytest.MonkeyPatch) -> None:
    most = _core.max_threads()
    monkeypatch.setattr(machine, "cores_available", lambda: 1)
    with machine.threads():
        assert _core.max_threads() == 1
    with machine.threads(7):
        assert _core.max_threads() == 7
        with pytest.raises(KeyError), machine.threads(2):
            raise KeyError
        assert _core.max_threads() == 7
    assert _core.max_threads() == most


def test_dir_lists_every_name_once() -> None:
    listed = dir(ph)
    assert sorted(set(listed)) == listed
    assert set(ph.__all__) <= set(listed)
    for name in ph.__all__:
        assert getattr(ph, name).__name__ == name


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="module 'parhelion' has no attribute 'rendr'"):
        ph.rendr  # noqa: B018
    assert not hasattr(ph, "Sphere")


# --- Scenes from arrays --------------------------------------------------------------------------

CENTERS = [[0, 0, 0], [2, 0, 0], [0, 2, 0]]
RADII = [1, 0.5, 0.25]
READ_ONLY = np.array(CENTERS, float)
READ_ONLY.flags.writeable = False


MIX = ph.Texture("mix")
WHITE, LAMP = ph.Material("diffuse", color=(1, 1, 1)), ph.Material("emissive")


def blend(a: str | ph.Material, b: str | ph.Material) -> ph.Material:
    return ph.Material("blend", a=a, b=b)


def deep_texture(depth: int) -> ph.Texture:
    texture = MIX
    for _ in range(depth):
        texture = ph.Texture("mix", color0=texture)
    return texture


@pytest.mark.parametrize(
    "centers",
    [
        tuple(map(tuple, CENTERS)),
        np.array(CENTERS, np.float16),
        np.array(CENTERS, np.float32),
        np.array(CENTERS, np.longdouble),
        np.array(CENTERS, np.int8),
        np.array(CENTERS, np.uint64),
        np.array(CENTERS, ">f8"),
        np.array(CENTERS, float, order="F"),
        np.array(CENTERS * 2, float)[::2][[0, 2, 1]],
        np.repeat(np.array(CENTERS, float), 2, axis=0)[::2],
        np.array([[*c, 7] for c in CENTERS], float)[:, :3],
        np.array(CENTERS, float)[::-1][::-1],
        READ_ONLY,
    ],
)
def test_centers_of_any_kind_of_number_and_layout(centers: object) -> None:
    expected = ph.Scene([ph.Spheres(np.array(CENTERS, np.float64), np.array(RADII))])
    assert same(ph.Scene([ph.Spheres(centers, RADII)]), expected)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.uint8, np.int64])
def test_a_single_radius_of_any_kind(kind: type) -> None:
    expected = ph.Scene([ph.Spheres(CENTERS, 1.0)])
    for radius in (kind(1), np.array(1, kind), np.ones(3, kind)):
        assert same(ph.Scene([ph.Spheres(CENTERS, radius)]), expected)


def test_unsigned_numbers_do_not_wrap_around() -> None:
    scene = ph.Scene([ph.Spheres(np.zeros((1, 3), np.uint8), np.uint8(1))])
    low, high = bounds(scene)
    np.testing.assert_array_equal([low, high], [[-1, -1, -1], [1, 1, 1]])


def test_arrays_are_left_as_they_were() -> None:
    centers, radii = np.array(CENTERS, np.float32), np.array(RADII, np.float32)
    copies = centers.copy(), radii.copy()
    ph.render(ph.Scene([ph.Spheres(centers, radii)]), **TINY)
    np.testing.assert_array_equal(centers, copies[0])
    np.testing.assert_array_equal(radii, copies[1])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "shapes",
    [
        [],
        [ph.Spheres([])],
        [ph.Spheres(np.zeros((0, 3)), np.zeros(0), colors=np.zeros((0, 3)))],
        [ph.Spheres([], [], [], [])],
        [ph.Spheres([], material="a")],
    ],
)
def test_no_spheres_show_the_background(shapes: list) -> None:
    sky = ph.Background("constant", radiance=(0.25, 0.5, 1))
    image = ph.render(ph.Scene(shapes, {"a": RED}, background=sky), **TINY)
    np.testing.assert_array_equal(image.numpy(), np.broadcast_to([0.25, 0.5, 1], (9, 16, 3)))


def test_colors_replace_the_material_s_own() -> None:
    x = np.array([[-1.5, 0, 0], [1.5, 0, 0]])
    camera = ph.Camera(eye=(0, 0, 6))
    two = [ph.Spheres(x[:1], material=RED), ph.Spheres(x[1:], material=BLUE)]
    one = [ph.Spheres(x, colors=[RED.params["color"], BLUE.params["color"]])]
    assert same(ph.Scene(two, camera=camera), ph.Scene(one, camera=camera))
    pixels = ph.render(ph.Scene(one, camera=camera), width=32, height=18, spp=16).numpy()
    left, right = pixels[9, 8], pixels[9, 24]
    assert left[0] > 3 * left[2]
    assert right[2] > 3 * right[0]


def test_a_material_by_name_by_itself_and_by_index() -> None:
    materials = {"red": RED, "blue": BLUE}
    x = np.array([[-1.5, 0, 0], [1.5, 0, 0]])
    ways = [
        [ph.Spheres(x[:1], material="red"), ph.Spheres(x[1:], material="blue")],
        [ph.Spheres(x[:1], material=RED), ph.Spheres(x[1:], material=BLUE)],
        [ph.Spheres(x, material=[0, 1])],
        [ph.Spheres(x, material=np.array([0, 1], np.uint8))],
    ]
    first, *others = (ph.Scene(shapes, materials) for shapes in ways)
    for other in others:
        assert same(first, other)
    assert not same(first, ph.Scene([ph.Spheres(x, material=[1, 0])], materials))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("scene", "told"),
    [
        (5, "an object of type builtins.int cannot be rendered"),
        (ph.Scene(ph.Spheres([[0, 0, 0]])), "shapes: a list is needed, not Spheres"),
        (ph.Scene([5]), "shapes: one of Spheres, Mesh, .* and Instances is needed, not int"),
        (ph.Scene(materials=[RED]), "materials: a dict is needed, not list"),
        (ph.Scene(materials={"a": "red"}), "material 'a': a Material is needed, not 'red'"),
        (ph.Scene(background="sky"), "background: a Background is needed, not 'sky'"),
        (
            ph.Scene(background=ph.Background("spot")),
            r"background: unknown background type 'spot'.* \(choices: constant, ",
        ),
        (ph.Scene(lights=ph.Light("spot")), "lights: a list is needed, not Light"),
        (ph.Scene(lights=["spot"]), r"lights\[0\]: a Light is needed, not 'spot'"),
        (ph.Scene(lights=[ph.Light("lamp")]), r"lights\[0\]: unknown light type 'lamp'"),
        (
            ph.Scene([ph.Mesh(np.eye(3), [[0, 1, 2], [0, 1, 3]])]),
            r"shape 'mesh': faces\[1\] has vertex 3; the mesh has vertices 0 to 2",
        ),
        (ph.Scene([ph.Mesh(np.eye(3), [[0.0, 1, 2]])]), "faces is float64 .* whole numbers"),
        (
            ph.Scene([ph.Mesh(np.eye(3), [[0, 1, 2]], uvs=[[0, 0]])]),
            r"shape 'mesh': uvs has shape \(1, 2\); must be \(3, 2\), one for each vertex",
        ),
        (
            ph.Scene([ph.Disks([[0, 0, 0]], [[1, 0, 0]], [[1, 1, 0]], name="lid")]),
            r"shape 'lid': axis_u\[0\] and axis_v\[0\] must be .* perpendicular",
        ),
        (
            ph.Scene([ph.Cylinders([[0, 0, 0]], [[0, 0, 0]])]),
            r"starts\[0\] and ends\[0\] are the same point",
        ),
        (  # in single precision; more than one leaf of the tree, which crashed once
            ph.Scene(
                [ph.Cylinders(np.ones((20, 3)), [[2, 1, 1]] * 7 + [[1, 1, 1 + 1e-9]] * 13, 0.1)]
            ),
            r"starts\[7\] and ends\[7\] are the same point",
        ),
        (  # and where only the scene's extent makes them one
            ph.Scene(
                [ph.Cylinders(np.zeros((20, 3)), [[1e9, 0, 0]] * 7 + [[1e-40, 0, 0]] * 13, 0.1)]
            ),
            r"'cylinders': primitive 7 is too small or too thin for single precision",
        ),
        (
            ph.Scene([ph.Curves(np.eye(3), basis="bspline")]),
            r"counts\[0\] is 3; a bspline strand has at least 4 control points",
        ),
        (
            ph.Scene([ph.Curves(np.ones((5, 3)), [1, 1, -2, 1, 1])]),
            r"shape 'curves': radii\[2\] is -2.0; must be finite and greater than 0",
        ),
        (
            ph.Scene([ph.Curves([[0, 0, 0]] * 3 + [[0, np.nan, 0]])]),
            r"shape 'curves': points\[3\] is \[.*\]; must be finite",
        ),
        (
            ph.Scene([ph.Instances([ph.Spheres([[0, 0, 0]])], np.eye(4))]),
            r"transforms has shape \(4, 4\); must be \(N, 3, 4\) or \(N, 4, 4\)",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", color=ph.Texture("image"))}),
            "material 'a': parameter 'color': texture: parameter 'image' is missing",
        ),
        (
            ph.Scene(materials={"a": blend("b", "b"), "b": blend("a", "c"), "c": WHITE}),
            "material 'a': is a blend of itself, by way of its parts",
        ),
        (
            ph.Scene(materials={"a": blend("lamp", "c"), "lamp": LAMP, "c": WHITE}),
            "material 'a': a shines; give the emission to the whole material",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", back=LAMP)}),
            "material 'a': back shines; give the emission to the whole material",
        ),
        (
            ph.Scene([ph.Spheres([[0, 0, 0]], 1, blend(WHITE, ph.Material("metal", opacity=0.5)))]),
            "shape 'spheres': b has holes; give the opacity to the whole material",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", normal_map_frame="uvw")}),
            "material 'a': unknown normal_map_frame 'uvw'; did you mean 'uv'?",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", color=deep_texture(17))}),
            "material 'a': parameter 'color': texture: is made of textures more than 16 deep",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", color=ph.Texture("mix", wight=MIX))}),
            "material 'a': parameter 'color': texture: unknown parameter 'wight'; did you mean",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", color=ph.Texture("ramp", shape=MIX))}),
            "material 'a': parameter 'color': texture: parameter 'shape' cannot be a Texture",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", color=ph.Texture("mix", uvs=2))}),
            "material 'a': parameter 'color': texture: uvs must be the name of an attribute",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", emission=-1)}),
            "material 'a': emission is -1; must be three numbers",
        ),
        (
            ph.Scene(materials={"a": ph.Material("diffuse", back="b")}),
            "material 'a': back: unknown material 'b'",
        ),
        (ph.Scene(settings=None), "settings: Settings are needed, not NoneType"),
        (ph.Scene(settings=ph.Settings(width=0)), "width is 0; must lie in"),
        (ph.Scene(settings=ph.Settings(height="9")), "height is '9'; must be a whole number"),
        (ph.Scene(camera=(0, 0, 5)), "camera: a Camera or a Framing is needed"),
        (
            ph.Scene([ph.Spheres([[0, 0]], name="dots")]),
            r"shape 'dots': centers has shape \(1, 2\)",
        ),
        (ph.Scene([ph.Spheres([0, 0, 0])]), r"centers has shape \(3,\); must be \(N, 3\)"),
        (ph.Scene([ph.Spheres([[0, 0, 0], [1, 1]])]), "centers is not an array of numbers"),
        (ph.Scene([ph.Spheres([["a", "b", "c"]])]), "centers is not an array of numbers"),
        (ph.Scene([ph.Spheres([[1j, 0, 0]])]), "centers is not an array of numbers"),
        (ph.Scene([ph.Spheres([[0, 0, 0]], [1, 2])]), r"radii has shape \(2,\); must be \(1,\)"),
        (ph.Scene([ph.Spheres(CENTERS, [1, 1, -2])]), r"radii\[2\] is -2"),
        (ph.Scene([ph.Spheres(CENTERS, 0)]), "is 0; a radius must be"),
        (ph.Scene([ph.Spheres(CENTERS, [1, np.inf, 1])]), r"radii\[1\] is inf"),
        (
            ph.Scene([ph.Spheres([[0, 0, 0], [0, np.nan, 0]])]),
            r"centers\[1\] is not finite: y = nan",
        ),
        (ph.Scene([ph.Spheres(CENTERS, colors=[[1, 0, 0]])]), r"colors has shape \(1, 3\)"),
        (ph.Scene([ph.Spheres(CENTERS[:1], colors=[[0, -1, 0]])]), r"colors\[0\] is -1 in g"),
        (ph.Scene([ph.Spheres(CENTERS[:1], colors=[[0, 0, 1e300]])]), r"colors\[0\] is inf in b"),
        (ph.Scene([ph.Spheres(CENTERS, material="rd")], {"red": RED}), "did you mean 'red'"),
        (ph.Scene([ph.Spheres(CENTERS, material=[0, 1, 0])], {"red": RED}), r"material\[1\] is 1"),
        (
            ph.Scene([ph.Spheres(CENTERS, material=[0, -1, 0])], {"red": RED}),
            r"material\[1\] is -1",
        ),
        (ph.Scene([ph.Spheres(CENTERS, material=[0.0, 0, 0])], {"red": RED}), "not float64"),
        (ph.Scene([ph.Spheres(CENTERS, material=[0])], {"red": RED}), r"material has shape \(1,\)"),
        (ph.Scene([ph.Spheres(CENTERS, material=None)]), "material must be a name"),
        (ph.Scene([ph.Spheres(CENTERS, material=ph.Material("mettal"))]), "did you mean 'metal'"),
        (ph.Scene(materials={"a": ph.Material("metal", fuz=1)}), "did you mean 'fuzz'"),
        (ph.Scene(materials={"a": ph.Material("metal", fuzz=2)}), "'fuzz' is 2; must lie in"),
        (ph.Scene(background=ph.Background("gradient", up=(0, 0, 0))), "'up' is 0"),
    ],
)
def test_a_scene_without_meaning(scene: object, told: str) -> None:
    with pytest.raises(ph.SceneError, match=told):
        ph.render(scene, **TINY)


def test_options_of_reading_by_name(tmp_path: Path) -> None:
    file = tmp_path / "a.xyz"
    file.write_text("2\n\nH 0 0 0\nH 5 0 0\n")
    radius = 0.25
    for scene in (
        ph.load(file, radius=radius),
        ph.load(file, ph.LoadOptions(ground=True), radius=radius, ground=False),
        ph.scene_of(file, radius=radius),
    ):
        assert np.all(scene.shapes[0].radii == np.float32(radius))
        assert len(scene.shapes) == 2  # and a light, no ground
    for read in (ph.load, ph.scene_of):
        with pytest.raises(ph.SceneError, match="unknown option 'radios'; did you mean 'radius'"):
            read(file, radios=1)
        with pytest.raises(ph.SceneError, match="radius is True; must be a number"):
            read(file, radius=True)


@pytest.mark.parametrize("kind", [bool, complex])
def test_positions_are_numbers(kind: type) -> None:
    with pytest.raises(ph.SceneError, match=r"positions must be \(N, 3\) numbers"):
        ph.scene_of(np.ones((4, 3), kind))


# --- render() ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"widht": 5}, "unknown setting 'widht'; did you mean 'width'"),
        ({"color_by": "id"}, "color_by is an option of reading a scene: ph.load"),
        ({"width": 0}, "width is 0"),
        ({"width": 70000}, r"width is 70000; must lie in \[1, 65536\]"),
        ({"width": 64.0}, "width is 64.0; must be a whole number"),
        ({"width": 1, "height": 10**30}, "height is 10*; must lie in"),
        ({"spp": 0}, "spp is 0"),
        ({"spp": True}, "spp is True; must be a whole number"),
        ({"spp": "many"}, "spp is 'many'; must be a whole number"),
        ({"max_depth": 0}, "max_depth is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 2**64}, "seed is 18446744073709551616"),
        ({"sampler": "sobel"}, "unknown sampler 'sobel'; did you mean 'sobol'"),
        ({"sampler": 5}, "unknown sampler '5'"),
        ({"filter": "gaussien"}, "unknown filter 'gaussien'; did you mean 'gaussian'"),
        ({"filter_radius": 0}, "filter_radius is 0.0; must be > 0"),
        ({"filter_radius": 100}, "filter_radius is 100"),
        ({"filter_radius": "1"}, "filter_radius is '1'; must be a number"),
        ({"roulette": "no"}, "roulette is 'no'; must be True or False"),
        ({"crop": (0, 0, 17, 1)}, "crop 0,0,17,1 .* does not lie within the picture, 16x9"),
        ({"crop": (0, 0, 1)}, "crop must be four numbers"),
        ({"crop": 5}, "crop must be four numbers"),
        ({"crop": (0, 0, 1, 1.5)}, "crop is 1.5; must be a whole number"),
        ({"crop": (-1, 0, 1, 1)}, "crop is -1"),
        ({"integrator": "Path"}, "unknown integrator 'Path'; did you mean 'path'"),
        ({"ao_distance": 0}, "ao_distance is 0.0; must be > 0"),
        ({"threads": -1}, "threads is -1"),
        ({"threads": 1.5}, "threads is 1.5"),
        ({"tile": 0}, "tile is 0"),
        ({"tree": "bhv"}, "unknown tree 'bhv'; did you mean 'bvh'"),
        ({"schedule": "dynmic"}, "unknown schedule 'dynmic'; did you mean 'dynamic'"),
        ({"schedule": 5}, "unknown schedule '5'"),
        ({"isa": "avx1024"}, "unknown instruction set 'avx1024'"),
        ({"isa": None}, "unknown instruction set 'None'"),
        ({"progress": 5}, "progress is 5; must be a function, True or None"),
        ({"camera": "front"}, "camera: a Camera or a Framing is needed, not 'front'"),
        ({"camera": ph.Camera(eye=(1, 2))}, r"camera: eye is \(1, 2\); must be three numbers"),
        ({"camera": ph.Camera(eye=None)}, "camera: eye is None; must be three numbers"),
        ({"camera": ph.Camera(up="xyz")}, "camera: up is 'xyz'; must be three numbers"),
        ({"camera": ph.Camera(eye=(np.nan, 0, 0))}, "camera: eye is not finite"),
        ({"camera": ph.Camera(eye=(0, 0, 0))}, "camera: eye and target are the same point"),
        ({"camera": ph.Camera(up=(0, 0, 2))}, "camera: up is parallel"),
        ({"camera": ph.Camera(fov=30, vfov=30)}, "camera: give fov or vfov, not both"),
        ({"camera": ph.Camera(fov=180)}, "camera: fov is 180.0; must lie between 0 and 180"),
        ({"camera": ph.Camera(vfov="wide")}, "camera: vfov is 'wide'; must be a number"),
        ({"camera": ph.Camera(aperture_radius=-1)}, "camera: aperture_radius is -1"),
        ({"camera": ph.Camera(aperture_radius=None)}, "aperture_radius is None; must be a number"),
        ({"camera": ph.Camera(focus_distance=0)}, "camera: focus_distance is 0.0; must be > 0"),
        (
            {"camera": ph.Camera(focus_distance="near")},
            "focus_distance is 'near'; must be a number",
        ),
    ],
)
def test_a_request_without_meaning(arguments: dict, told: str) -> None:
    with pytest.raises(ph.SceneError, match=told):
        ph.render(ONE, **(TINY | arguments))


def test_settings_of_the_call_win_over_those_of_the_scene() -> None:
    base = ph.Settings(width=100, height=50, spp=3, seed=9, crop=(0, 0, 10, 10))
    assert merged(base, {}) == base
    assert merged(base, {"spp": None, "crop": None}) == base
    assert merged(base, {"spp": np.int64(5)}).spp == 5
    wide = merged(base, {"width": 51})
    assert (wide.width, wide.height) == (51, 26)
    tall = merged(base, {"height": 100})
    assert (tall.width, tall.height) == (200, 100)
    both = merged(base, {"width": 30, "height": 30})
    assert (both.width, both.height, both.seed) == (30, 30, 9)
    assert merged(ph.Settings(width=1000, height=10), {"width": 20}).height == 1


def test_a_crop_is_that_part_of_the_picture() -> None:
    whole = ph.render(ph.weekend(), width=40, spp=2).numpy()
    part = ph.render(ph.weekend(), width=40, spp=2, crop=(7, 3, 21, 11)).numpy()
    np.testing.assert_array_equal(part, whole[3:14, 7:28])


def test_a_prepared_scene_is_rendered_again_and_again() -> None:
    scene = ph.weekend()
    prepared = ph.prepare(scene)
    assert prepared.scene is scene
    assert same(prepared, scene)
    other = ph.Camera(eye=(3, 9, 13))
    np.testing.assert_array_equal(
        ph.render(prepared, camera=other, **TINY).numpy(),
        ph.render(scene, camera=other, **TINY).numpy(),
    )
    assert same(prepared, scene)


def test_statistics_of_a_picture() -> None:
    image = ph.render(ONE, width=16, height=9, spp=3, threads=2)
    stats = image.stats
    assert (image.numpy().shape, image.numpy().dtype) == ((9, 16, 3), np.float32)
    assert image.counts.tolist() == [[3] * 16] * 9
    assert stats.samples == 16 * 9 * 3
    assert stats.rays >= stats.samples
    assert stats.threads == 2
    assert stats.complete
    assert 0 < stats.seconds < 60


@pytest.mark.parametrize(("width", "height"), [(64, 64), (448, 64), (64, 448), (64, 1), (1, 64)])
@pytest.mark.parametrize("where", [(0, 0, 0), (500, -300, 20)])
def test_no_camera_shows_all_of_the_scene(
    width: int, height: int, where: tuple[int, int, int]
) -> None:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    light = ph.Material("emissive", radiance=(1, 1, 1))
    dark = ph.Background("constant", radiance=(0, 0, 0))
    scene = ph.Scene([ph.Spheres(corners * 2.0 + where, 0.5, light)], background=dark)
    lit = ph.render(scene, width=width, height=height, spp=16, filter="box").numpy()[..., 0] > 0
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert rows.size
    if min(width, height) > 1:
        # within the picture, and not small in it
        assert not any(edge.any() for edge in (lit[0], lit[-1], lit[:, 0], lit[:, -1]))
        narrow = columns if width < height else rows
        assert np.ptp(narrow) + 1 > 0.5 * min(width, height)
    centre = np.array([rows[0] + rows[-1], columns[0] + columns[-1]]) / 2
    assert np.all(np.abs(centre - (np.array([height, width]) - 1) / 2) <= 1)


# --- Progress, stopping, threads -----------------------------------------------------------------


def test_progress_is_told_in_order_to_the_end() -> None:
    seen: list[Progress] = []
    threads = set()

    def progress(state: Progress) -> None:
        seen.append(state)
        threads.add(threading.get_ident())

    image = ph.render(ph.weekend(), width=160, spp=32, progress=progress)
    assert len(seen) >= 3
    assert threads == {threading.get_ident()}
    for name in ("samples", "rays", "seconds", "fraction"):
        values = [getattr(state, name) for state in seen]
        assert values == sorted(values)
    assert seen[-1].samples == seen[-1].total_samples == image.stats.samples == 160 * 90 * 32
    assert seen[-1].rays == image.stats.rays
    assert seen[-1].fraction == 1
    assert seen[0].fraction < 0.5


def test_who_watches_does_not_change_a_bit(capsys: pytest.CaptureFixture[str]) -> None:
    plain = ph.render(ph.weekend(), width=64, spp=20)
    for progress in (True, False, lambda _: False):
        watched = ph.render(ph.weekend(), width=64, spp=20, progress=progress)
        np.testing.assert_array_equal(watched.numpy(), plain.numpy())
    assert capsys.readouterr() == ("", "")  # no bar where there is no terminal


def test_progress_can_stop_it() -> None:
    image = ph.render(ph.weekend(), width=160, spp=10**8, progress=lambda p: p.seconds > 0.2)
    assert not image.stats.complete
    assert image.stats.seconds < 2
    assert image.counts.min() >= 1
    assert image.counts.sum() == image.stats.samples < 160 * 90 * 10**8
    # each pixel is the mean of the samples it has
    row, column = 45, 80
    count = int(image.counts[row, column])
    one = ph.render(ph.weekend(), width=160, spp=count, crop=(column, row, 1, 1))
    np.testing.assert_array_equal(one.numpy()[0, 0], image.numpy()[row, column])


def test_stopped_at_the_first_word_is_still_a_picture(tmp_path: Path) -> None:
    image = ph.render(ph.weekend(), width=640, spp=4, progress=lambda _: True)
    assert not image.stats.complete
    assert np.isfinite(image.numpy()).all()
    assert np.all(image.numpy()[image.counts == 0] == 0)
    image.save(tmp_path / "a.png")


def test_an_error_of_the_callback_comes_back() -> None:
    class OwnError(Exception):
        pass

    def progress(state: Progress) -> None:
        if state.seconds > 0.1:
            raise OwnError("enough")

    begin = time.monotonic()
    with pytest.raises(OwnError, match="enough"):
        ph.render(ph.weekend(), width=160, spp=10**8, progress=progress)
    assert time.monotonic() - begin < 5
    assert ph.render(ONE, **TINY).stats.complete


@pytest.mark.parametrize("arguments", ["", ", tree='none', threads=1", ", progress=lambda p: None"])
def test_ctrl_c_in_a_program(arguments: str) -> None:
    done = script(
        "import os, signal, threading, time\n"
        "import parhelion as ph\n"
        "def interrupt():\n"
        "    global sent\n"
        "    time.sleep(0.4)\n"
        "    sent = time.monotonic()\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "scene = ph.prepare(ph.weekend())\n"
        "threading.Thread(target=interrupt).start()\n"
        "try:\n"
        f"    ph.render(scene, width=160, spp=10**8{arguments})\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', time.monotonic() - sent < 0.8)\n"
        "print(ph.render(scene, width=16, spp=1).stats.complete)\n"
    )
    assert done.stdout == "interrupted True\nTrue\n", done.stderr


def test_other_threads_run_while_it_renders() -> None:
    laps: list[float] = []
    over = threading.Event()

    def run() -> None:
        while not over.wait(0.005):
            laps.append(time.monotonic())

    thread = threading.Thread(target=run)
    thread.start()
    begin = time.monotonic()
    image = ph.render(ph.weekend(), width=240, spp=96, threads=1)
    end = time.monotonic()
    over.set()
    thread.join()
    within = [t for t in laps if begin < t < end]
    assert image.stats.seconds > 0.2
    # it could run some 200 times a second; were the lock held, only 20 times, between two looks
    assert len(within) > 50 * image.stats.seconds


def test_two_renderings_at_once_do_not_disturb_each_other() -> None:
    scene = ph.prepare(ph.weekend())
    expected = [ph.render(scene, width=96, spp=8, seed=seed).numpy() for seed in range(3)]
    got: dict[int, np.ndarray] = {}

    def work(seed: int) -> None:
        got[seed] = ph.render(scene, width=96, spp=8, seed=seed, threads=2).numpy()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in range(3):
        np.testing.assert_array_equal(got[seed], expected[seed])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_child_renders_too() -> None:
    done = script(
        "import os, parhelion as ph\n"
        "scene = ph.weekend()\n"
        "before = ph.render(scene, width=32, spp=2, threads=2).numpy().tobytes()\n"
        "if os.fork() == 0:\n"
        "    after = ph.render(scene, width=32, spp=2, threads=2).numpy().tobytes()\n"
        "    os._exit(0 if after == before else 1)\n"
        "print(os.wait()[1])\n"
        "print(ph.render(scene, width=32, spp=2, threads=2).numpy().tobytes() == before)\n"
    )
    assert done.stdout == "0\nTrue\n", done.stderr


# --- Memory --------------------------------------------------------------------------------------


def test_a_picture_larger_than_memory_is_refused_before_any_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from parhelion import _core

    def film(*_: int) -> None:
        pytest.fail("memory was asked for")

    monkeypatch.setattr(memory, "free", lambda **_: memory.Free(2**30, "are free"))
    with monkeypatch.context() as patch:
        patch.setattr(_core, "Film", film)
        with pytest.raises(ph.ResourceError, match=r"65536x65536 takes 304\.0 GiB, and 1\.0"):
            ph.render(ONE, width=65536, height=65536, spp=1)
    # a part of it fits
    image = ph.render(ONE, width=65536, height=65536, spp=1, crop=(40000, 30000, 8, 8))
    assert image.numpy().shape == (8, 8, 3)
    prepared = ph.prepare(ONE)
    little = memory.Free(8 * 8 * renderer.PIXEL_BYTES - 1, "are free")
    monkeypatch.setattr(memory, "free", lambda **_: little)
    with pytest.raises(ph.ResourceError, match="not enough memory: a picture of 8x8 takes"):
        ph.render(prepared, width=8, height=8, spp=1)
    monkeypatch.setattr(memory, "free", lambda **_: None)
    ph.render(ONE, width=8, height=8, spp=1)


def system(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


MEMINFO = "MemTotal:   9000 kB\nMemFree:   10 kB\nMemAvailable:    4000 kB\n"


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, None),
        ({"proc/meminfo": MEMINFO}, 4000 * 1024),
        (
            {  # control groups, version 2: the one around it has the limit
                "proc/meminfo": MEMINFO,
                "proc/self/cgroup": "0::/outer/inner\n",
                "sys/fs/cgroup/outer/inner/memory.max": "max\n",
                "sys/fs/cgroup/outer/inner/memory.current": "500000\n",
                "sys/fs/cgroup/outer/memory.max": "1000000\n",
                "sys/fs/cgroup/outer/memory.current": "900000\n",
                "sys/fs/cgroup/outer/memory.stat": "anon 7\ninactive_file 30000\n",
            },
            130000,
        ),
        (
            {  # within a container: its own group is mounted as the root
                "proc/meminfo": MEMINFO,
                "proc/self/cgroup": "0::/docker/abc\n",
                "sys/fs/cgroup/memory.max": "1000000\n",
                "sys/fs/cgroup/memory.current": "1000001\n",
            },
            0,
        ),
        (
            {  # version 1
                "proc/meminfo": MEMINFO,
                "proc/self/cgroup": "4:cpu,memory:/job\n1:cpuset:/\n0::/\n",
                "sys/fs/cgroup/memory/job/memory.limit_in_bytes": "2000000\n",
                "sys/fs/cgroup/memory/job/memory.usage_in_bytes": "500000\n",
                "sys/fs/cgroup/memory/job/memory.stat": "total_inactive_file 100\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712\n",
                "sys/fs/cgroup/memory/memory.usage_in_bytes": "9000000\n",
            },
            1500100,
        ),
        (
            {  # version 1, as where there is no limit
                "proc/self/cgroup": "4:memory:/\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": "9223372036854771712\n",
                "sys/fs/cgroup/memory/memory.usage_in_bytes": "9000000\n",
            },
            None,
        ),
    ],
)
def test_memory_that_may_be_taken(
    tmp_path: Path, files: dict[str, str], expected: int | None
) -> None:
    assert memory.available(system(tmp_path, files)) == expected


# --- The built-in scene, pickles, examples -------------------------------------------------------


def test_the_weekend_scene_is_always_the_same() -> None:
    flat = flatten(ph.weekend())
    assert flat.sha256() == "ee5cb4a1928c330269e69edfac49f9059f58648fe796fd099474722d32fd8d11"
    assert flatten(ph.weekend(seed=2)).sha256() != flat.sha256()
    centers = {shape["name"]: shape["centers"] for shape in flat.parts["groups"][-1]}
    small = np.concatenate([centers[name] for name in ("matte", "metal", "glass")])
    assert 470 <= len(small) <= 490
    large = np.concatenate([c for name, c in centers.items() if name.startswith("large")])
    assert len(large) == 3
    distances = np.linalg.norm(small[:, None] - large, axis=2)
    assert distances.min() > 1 + 0.2
    names = [m.type for m in ph.weekend().materials.values()]
    assert {"diffuse", "metal", "dielectric"} == set(names)


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_scenes_and_pictures_survive_a_pickle(protocol: int) -> None:
    scene = ph.weekend()
    copy = pickle.loads(pickle.dumps(scene, protocol))
    assert flatten(copy).sha256() == flatten(scene).sha256()
    assert copy.materials == scene.materials
    assert (copy.camera, copy.settings, copy.name) == (scene.camera, scene.settings, scene.name)
    assert same(copy, scene)
    image = ph.render(scene, **TINY)
    again = pickle.loads(pickle.dumps(image, protocol))
    np.testing.assert_array_equal(again.numpy(), image.numpy())
    assert again.metadata().keys() == image.metadata().keys()


def test_materials_are_values() -> None:
    glass = ph.Material("dielectric", ior=1.5)
    assert glass == ph.Material("dielectric", ior=1.5)
    assert glass != ph.Material("dielectric", ior=1.6)
    assert glass != ph.Background("dielectric", ior=1.5)
    assert len({glass, ph.Material("dielectric", ior=1.5), RED}) == 2
    assert ph.Material("diffuse", color=[1, 0, 0]) == ph.Material("diffuse", color=(1.0, 0, 0))
    assert pickle.loads(pickle.dumps(glass)) == glass
    assert repr(glass) == "Material('dielectric', ior=1.5)"
    with pytest.raises(AttributeError, match="frozen"):
        glass.type = "metal"
    with pytest.raises(TypeError):
        glass.params["ior"] = 2


EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example: Path, tmp_path: Path) -> None:
    assert len(example.read_text().splitlines()) < 60
    done = subprocess.run(
        [sys.executable, str(example), "--width", "32", "--spp", "4", "-o", "a.exr"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    pixels, _ = read_picture(tmp_path / "a.exr")
    assert pixels.shape == (18, 32, 3)
    assert np.isfinite(pixels).all()
    assert pixels.std() > 0.05


def test_there_are_examples() -> None:
    assert {"numpy_cloud", "color_by_field", "hollow_glass", "terrain"} <= {
        path.stem for path in EXAMPLES
    }


# --- What a scene refuses, and what it takes ------------------------------------------------------


def test_colors_must_be_those_that_their_material_may_have() -> None:
    """The likeliest slip: 0 to 255 where 0 to 1 is meant."""
    bytes_ = np.full((3, 3), 200, np.uint8)
    said = r"shape 'spheres': colors\[0\] is 200 in r; the colour of diffuse must lie in \[0, 1\]"
    with pytest.raises(ph.SceneError, match=said):
        ph.prepare(ph.Scene([ph.Spheres(np.eye(3), 0.1, colors=bytes_)]))
    lamps = ph.Spheres(np.eye(3), 0.1, ph.Material("emissive"), colors=bytes_)
    assert ph.prepare(ph.Scene([lamps])).core.stats()["lights"] == 3


def test_a_sphere_too_small_for_its_scene_is_refused() -> None:
    stray = ph.Spheres([[0, 0, 0], [1e17, 0, 0]], 1.0)
    with pytest.raises(
        ph.SceneError, match=r"radii\[0\] is 1, but the scene reaches out to 1e\+17"
    ):
        ph.prepare(ph.Scene([stray]))


@pytest.mark.parametrize("material", ["diffuse", "metal", "dielectric"])
def test_spheres_that_coincide_are_one(material: str) -> None:
    def picture(copies: int) -> np.ndarray:
        spheres = ph.Spheres([[0.1, 0.2, 0.1]] * copies, 0.7, ph.Material(material))
        scene = ph.Scene([spheres], background=ph.Background("constant"))
        return ph.render(scene, width=32, height=32, spp=4).pixels

    np.testing.assert_array_equal(picture(1), picture(2))
    np.testing.assert_array_equal(picture(1), picture(5))


def test_spheres_that_coincide_are_one_among_others_that_cross_them() -> None:
    others = np.random.default_rng(1).uniform(1, 1.8, (960, 3))  # so that the tree has forks
    material = ph.Material("diffuse")

    def picture(twin: bool) -> np.ndarray:
        ball = ph.Spheres([[0, 0, 0]], 0.1, material)
        rods = [
            ph.Cylinders([[-x for x in end]], [end], 0.03, material=material)
            for end in ([0.5, 0, 0], [0, 0.5, 0])
        ]
        shapes = [ball, rods[0], *[ball] * twin, rods[1]]
        far = ph.Spheres(others, 0.01)
        camera = ph.Camera(eye=(0.3, 0.25, 2), target=(0, 0, 0), vfov=8)
        background = ph.Background("constant")
        scene = ph.Scene([*shapes, far], camera=camera, background=background)
        return ph.render(scene, width=32, height=32, spp=4).pixels

    np.testing.assert_array_equal(picture(False), picture(True))


def test_material_names_for_each_sphere() -> None:
    materials = {
        "a": ph.Material("diffuse"),
        "b": ph.Material("metal"),
        "c": ph.Material("emissive"),
    }
    named = ph.Spheres(np.eye(3), 0.1, ["c", "a", "c"])
    counted = ph.Spheres(np.eye(3), 0.1, [2, 0, 2])
    one, two = (ph.prepare(ph.Scene([s], materials)) for s in (named, counted))
    assert one.flat.sha256() == two.flat.sha256()
    with pytest.raises(ph.SceneError, match=r"material\[1\]: unknown material 'aa'; did you mean"):
        ph.prepare(ph.Scene([ph.Spheres(np.eye(3), 0.1, ["a", "aa", "b"])], materials))


def test_masked_elements_are_refused() -> None:
    centers = np.ma.masked_greater(np.eye(3), 0.5)
    with pytest.raises(ph.SceneError, match="centers has masked elements"):
        ph.prepare(ph.Scene([ph.Spheres(centers)]))


def test_an_image_is_an_array_to_numpy() -> None:
    image = ph.render(ONE, width=8, height=6, spp=1)
    np.testing.assert_array_equal(np.asarray(image), image.pixels)
    assert np.asarray(image, np.float64).dtype == np.float64
    assert repr(image) == "<Image 8x6, 1 spp>"


def test_materials_made_of_materials_without_end() -> None:
    deep = WHITE
    for _ in range(5000):
        deep = blend(deep, WHITE)
    with pytest.raises(ph.SceneError, match="materials are made of materials too deeply"):
        ph.prepare(ph.Scene(materials={"a": deep}))


def test_arguments_that_would_be_taken_for_something_else() -> None:
    with pytest.raises(ph.SceneError, match="allow_paths is one path; must be a sequence"):
        ph.LoadOptions(allow_paths="/usr")  # type: ignore[arg-type]
    with pytest.raises(ph.SceneError, match="defines is 3; must be a dict"):
        ph.LoadOptions(defines=3)  # type: ignore[arg-type]
    with pytest.raises(ph.SceneError, match="a path is needed, not int"):
        ph.load(3)  # type: ignore[arg-type]
    with pytest.raises(ph.SceneError, match="features is 'yes'; must be True or False"):
        ph.render(ph.weekend(), features="yes")  # type: ignore[arg-type]
    with pytest.raises(ph.SceneError, match="camera: mirrored is 'no'; must be True or False"):
        ph.render(ph.weekend(), camera=ph.Camera(mirrored="no"))  # type: ignore[arg-type]


def test_an_image_that_is_not_finite() -> None:
    image = np.full((1, 1), np.nan, np.float32)
    color = ph.Texture("image", image=image)
    with pytest.raises(ph.SceneError, match="the pixel in row 0, column 0 is not finite"):
        ph.prepare(ph.Scene(materials={"a": ph.Material("diffuse", color=color)}))
