"""The same picture to the last bit, however the work is divided and wherever it is done."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

import parhelion as ph
from parhelion import _core
from parhelion.progressive import cell_areas
from parhelion.renderer import make_view, merged

# Seconds after which a process counts as hung; the pictures here take a few hundredths of one.
PATIENCE = 30
SIZE = (48, 30)


@cache
def prepared() -> ph.Prepared:
    """The weekend scene with a lamp in it, so that light samples are drawn too."""
    scene = ph.weekend()
    lamp = ph.Spheres([[4.0, 3.0, 1.5]], 0.5, ph.Material("emissive", radiance=(8, 7, 6)))
    return ph.prepare(scene.replace(shapes=[*scene.shapes, lamp]))


def picture(**settings: object) -> np.ndarray:
    return ph.render(
        prepared(),
        **{"width": SIZE[0], "height": SIZE[1], "spp": 4, "threads": 1, "seed": 3, **settings},
    ).numpy()


@cache
def reference() -> np.ndarray:
    pixels = picture()
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 1000
    return pixels


def assert_same(pixels: np.ndarray) -> None:
    assert pixels.dtype == np.float32
    assert pixels.tobytes() == reference().tobytes()


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_threads(threads: int) -> None:
    assert_same(picture(threads=threads))


@pytest.mark.parametrize("tile", [1, 5, 16, 64])
@pytest.mark.parametrize("schedule", ["dynamic", "static", "guided"])
def test_tiles_and_schedules(tile: int, schedule: str) -> None:
    assert_same(picture(threads=3, tile=tile, schedule=schedule))


@pytest.mark.parametrize("isa", _core.instruction_sets())
@pytest.mark.parametrize("tree", ["bvh", "none"])
def test_instruction_sets_and_trees(isa: str, tree: str) -> None:
    assert_same(picture(isa=isa, tree=tree, threads=2))


def test_again() -> None:
    assert_same(picture())
    again = ph.prepare(prepared().scene)  # a tree built anew
    pixels = ph.render(again, width=SIZE[0], height=SIZE[1], spp=4, threads=2, seed=3).numpy()
    assert_same(pixels)


def test_what_must_change_the_picture_does() -> None:
    for other in ({"seed": 4}, {"spp": 5}, {"sampler": "independent"}, {"filter": "box"}):
        assert not np.array_equal(picture(**other), reference())


@pytest.mark.parametrize("sampler", ["sobol", "independent"])
@pytest.mark.parametrize("crop", [(0, 0, 1, 1), (5, 3, 20, 11), (47, 29, 1, 1), (0, 10, 48, 3)])
def test_a_crop_is_a_piece_of_the_picture(sampler: str, crop: tuple[int, ...]) -> None:
    x, y, width, height = crop
    whole = picture(sampler=sampler)
    part = picture(sampler=sampler, crop=crop, tile=7, threads=2)
    np.testing.assert_array_equal(part, whole[y : y + height, x : x + width])


@pytest.mark.parametrize("levels", [(12,), (1, 12), (3, 7, 12), tuple(range(13))])
@pytest.mark.parametrize("by_part", [False, True])
def test_passes_to_any_targets_add_up_to_the_same_bits(
    levels: tuple[int, ...], by_part: bool
) -> None:
    scene = prepared()
    settings = merged(
        scene.scene.settings, {"width": SIZE[0], "height": SIZE[1], "spp": 12, "seed": 3}
    )
    assert scene.scene.camera is not None
    view = make_view(scene.core, scene.scene.camera, settings)
    film, rng = _core.Film(0, 0, *SIZE), np.random.default_rng(1)
    shapes = [cell_areas(film).shape, SIZE[::-1]]
    for i, level in enumerate(levels):
        targets = rng.integers(0, level + 1, shapes[i % 2], np.uint32) if by_part else level
        for each in (targets, level if level == 12 else 0):  # 0 takes nothing away
            film.render(
                scene.core,
                view,
                each,
                threads=1 + i % 2,
                tile=3 + i,
                schedule="dynamic",
                isa="",
                tick=None,
            )
    pixels, counts, bad = film.arrays()
    assert np.all(counts == 12)
    assert not np.any(bad)
    np.testing.assert_array_equal(pixels, picture(spp=12))


def test_targets_are_of_the_films_cells() -> None:
    scene = prepared()
    assert scene.scene.camera is not None
    view = make_view(scene.core, scene.scene.camera, merged(scene.scene.settings, {"width": 20}))
    film = _core.Film(0, 0, 20, 11)
    for shape in ((3, 4), (2, 3), (4, 2)):
        with pytest.raises(ValueError, match="4 by 3, for cells, or 11 by 20"):
            film.render(
                scene.core,
                view,
                np.ones(shape, np.uint32),
                threads=1,
                tile=16,
                schedule="dynamic",
                isa="",
                tick=None,
            )


def test_a_sample_alone_is_the_sample_in_the_picture() -> None:
    scene = prepared()
    settings = merged(
        scene.scene.settings, {"width": SIZE[0], "height": SIZE[1], "spp": 4, "seed": 3}
    )
    assert scene.scene.camera is not None
    view = make_view(scene.core, scene.scene.camera, settings)
    for x, y in ((0, 0), (20, 17), (47, 29)):
        samples = np.array([_core.one_sample(scene.core, view, x, y, s) for s in range(4)])
        for isa in _core.instruction_sets():
            assert _core.one_sample(scene.core, view, x, y, 2, isa=isa) == list(samples[2])
        np.testing.assert_allclose(samples.mean(axis=0), reference()[y, x], rtol=1e-6)


def test_a_stopped_render_is_the_start_of_the_whole() -> None:
    calls = []

    def stop(progress: ph.Progress) -> bool:
        calls.append(progress.samples)
        return len(calls) == 2

    image = ph.render(prepared(), width=48, height=30, spp=4096, threads=2, seed=3, progress=stop)
    assert not image.stats.complete
    assert calls == sorted(calls)


# --- Other processes ---------------------------------------------------------------------------

PROGRAM = """
import sys
import numpy as np
import parhelion as ph
from parhelion import _core
image = ph.render(ph.weekend(), width=24, height=14, spp=2, threads=2)
np.save(sys.stdout.buffer, image.numpy())
print(_core.instruction_set(), image.stats.isa, file=sys.stderr)
"""


def run_python(program: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, **environment},
        capture_output=True,
        timeout=PATIENCE,
        check=False,
    )


@pytest.mark.parametrize("isa", ["", *_core.instruction_sets()])
def test_instruction_set_from_the_environment(isa: str) -> None:
    done = run_python(PROGRAM, PARHELION_ISA=isa)
    assert done.returncode == 0, done.stderr.decode()
    expected = ph.render(ph.weekend(), width=24, height=14, spp=2, threads=1, isa="baseline")
    assert done.stdout.endswith(expected.numpy().tobytes())
    assert done.stderr.decode().split() == [isa or _core.instruction_sets()[-1]] * 2


def test_unknown_instruction_sets() -> None:
    with pytest.raises(ph.SceneError, match=r"'sse9'.*baseline"):
        picture(isa="sse9")
    done = run_python(PROGRAM, PARHELION_ISA="sse9")
    assert done.returncode == 1
    assert b"SceneError: unknown instruction set 'sse9'" in done.stderr
    # what is asked for by name goes before the environment
    named = PROGRAM.replace("threads=2", "isa='baseline'").replace("_core.instruction_set(), ", "")
    assert run_python(named, PARHELION_ISA="sse9").returncode == 0


def in_child(connection: object) -> None:
    connection.send_bytes(picture(threads=2).tobytes())


@pytest.fixture
def no_stragglers() -> Iterator[list[multiprocessing.process.BaseProcess]]:
    started: list[multiprocessing.process.BaseProcess] = []
    yield started
    for process in started:
        if process.is_alive():
            process.kill()
        process.join(PATIENCE)


# The fork of a process with threads is what is tested; Python 3.12 and later warn of it.
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_child_processes(method: str, no_stragglers: list) -> None:
    """A child renders after its parent has used OpenMP; and so does the parent after the fork."""
    assert_same(picture(threads=2))
    context = multiprocessing.get_context(method)
    for _ in range(2):
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=in_child, args=(sender,))
        process.start()
        no_stragglers.append(process)
        sender.close()
        assert receiver.poll(PATIENCE), f"a process started by {method} hangs"
        assert receiver.recv_bytes() == reference().tobytes()
        process.join(PATIENCE)
        assert process.exitcode == 0
        assert_same(picture(threads=2))
