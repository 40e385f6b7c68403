"""Pictures by the workers of a cluster: real processes, compared bit by bit with one machine."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import logging
import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import cli
from parhelion.cluster import dispatch, places, roster, sampler, scenes
from parhelion.flatten import Flat
from parhelion.renderer import prepare
from parhelion.view.session import Session
from picture_tools import assert_same, read_picture
from test_reuse import room

distributed = pytest.importorskip("distributed")
cloudpickle, dask = pytest.importorskip("cloudpickle"), pytest.importorskip("dask")  # which it has

# What workers are to run goes to them as it is, as they would take seconds to import this file.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

SIZE = {"width": 150, "height": 85, "spp": 24}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with places.opened("local:2", 1) as (found, *_):
        yield found


@pytest.fixture(scope="module")
def scene() -> Any:
    return prepare(ph.weekend())


@pytest.fixture
def many_units(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small units, so that there are enough for something to happen meanwhile."""
    monkeypatch.setattr(sampler, "UNIT_SECONDS", 0.01)
    monkeypatch.setattr(sampler, "_SHORTEST", 0.002)
    monkeypatch.setattr(sampler, "_FIRST", 1 << 9)


def same(a: ph.Image, b: ph.Image) -> None:
    """The same picture, by as much work."""
    assert_same(a, b)
    assert a.stats.samples == b.stats.samples
    assert a.stats.rays == b.stats.rays
    assert (a.stats.error, a.stats.ended) == (b.stats.error, b.stats.ended)


@pytest.mark.usefixtures("many_units")
@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"features": True, "crop": (13, 7, 77, 40)},
        {"noise": 0.25, "spp": 200, "features": True},
        {"sampler": "independent", "filter": "box", "integrator": "ao", "seed": 5},
        {"camera": ph.Camera(eye=(9, 3, 4), target=(0, 0.5, 0), vfov=30, aperture_radius=0.1)},
        {"spp": None, "counts": np.arange(150 * 85).reshape(85, 150) % 40},
        {"tree": "none", "width": 24, "height": 9, "spp": 3},
    ],
)
def test_the_picture_is_that_of_one_machine(client: Any, scene: Any, asked: dict[str, Any]) -> None:
    asked = {**SIZE, **asked}
    made = ph.render(scene, cluster=client, threads=1, **asked)
    same(made, ph.render(scene, **asked))
    assert made.stats.threads <= 2


@pytest.mark.parametrize(("edge", "seconds"), [(8, 0.002), (16, 1.0), (64, 0.05)])
def test_units_of_any_size(
    client: Any, scene: Any, edge: int, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampler, "EDGE", edge)
    monkeypatch.setattr(sampler, "UNIT_SECONDS", seconds)
    monkeypatch.setattr(sampler, "_SHORTEST", seconds)
    asked = {**SIZE, "features": True, "noise": 0.3}
    same(ph.render(scene, cluster=client, threads=1, **asked), ph.render(scene, **asked))


@pytest.mark.usefixtures("many_units")
def test_what_comes_twice_counts_once(
    client: Any, scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All units go to two workers."""
    twice, once = [], dispatch.Dispatcher.hand

    def hand(self: Any, task: Any, worker: str) -> None:
        once(self, task, worker)
        for other in self._roster.ready - {worker}:
            once(self, task, other)
            twice.append(task)

    monkeypatch.setattr(dispatch.Dispatcher, "hand", hand)
    same(ph.render(scene, cluster=client, threads=1, **SIZE), ph.render(scene, **SIZE))
    assert len(twice) > 10


@pytest.mark.usefixtures("many_units")
def test_answers_that_are_lost_are_asked_for_again(
    client: Any, scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask drops an answer that it fails to fetch: of every tenth unit those of both workers."""
    lost, once = Counter[int](), distributed.as_completed.add

    def add(self: Any, future: Any) -> None:
        unit = int(future.key.split("-")[-2])
        if unit % 10 or lost[unit] == 2:
            once(self, future)
        else:
            lost[unit] += 1

    monkeypatch.setattr(distributed.as_completed, "add", add)
    monkeypatch.setattr(dispatch, "LOOK", 0.02)
    monkeypatch.setattr(dispatch, "_FETCH", 0.3)
    made = ph.render(scene, cluster=client, threads=1, time_limit=60, **SIZE)
    assert made.stats.ended == "spp"
    assert len(lost) >= 5
    assert 2 in lost.values()
    np.testing.assert_array_equal(made.numpy(), ph.render(scene, **SIZE).numpy())


@pytest.mark.usefixtures("many_units")
def test_answers_come_by_the_clients_own_thread(
    client: Any, scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever clients there are beside it, of which Dask would take the newest."""
    threads, once = set[int](), distributed.as_completed._track_future

    async def track(self: Any, future: Any) -> None:
        threads.add(threading.get_ident())
        await once(self, future)

    monkeypatch.setattr(distributed.as_completed, "_track_future", track)
    with places._processes(distributed, "local:1", 1) as other, distributed.Client(other) as newest:
        assert distributed.default_client() is newest
        assert newest.loop is not client.loop
        same(ph.render(scene, cluster=client, threads=1, **SIZE), ph.render(scene, **SIZE))
    assert threads == {client.sync(current_thread)}


async def current_thread() -> int:
    return threading.get_ident()


@pytest.mark.usefixtures("many_units")
def test_units_that_all_workers_lose_are_given_to_others(
    client: Any, scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask tells nothing of a unit that it loses: from the sixth on of each, when first handed."""
    handed, once = Counter[int](), dispatch.Dispatcher.hand
    add = distributed.as_completed.add

    def hand(self: Any, task: Any, worker: str) -> None:
        keys = set(task.keys)
        once(self, task, worker)
        number = task.unit.number
        handed[number] += 1
        if number > 5 and handed[number] == 1:
            (key,) = task.keys - keys
            silent = SimpleNamespace(done=lambda: False, cancel=lambda: None)
            self._by_key[key].future = silent

    def heard(self: Any, future: Any) -> None:
        number = int(future.key.split("-")[-2])
        if number <= 5 or handed[number]:
            add(self, future)

    monkeypatch.setattr(dispatch.Dispatcher, "hand", hand)
    monkeypatch.setattr(distributed.as_completed, "add", heard)
    monkeypatch.setattr(dispatch, "LOOK", 0.02)
    made = ph.render(scene, cluster=client, threads=1, time_limit=60, **SIZE)
    assert made.stats.ended == "spp"
    assert min(handed[number] for number in range(6, max(handed) + 1)) > 1
    np.testing.assert_array_equal(made.numpy(), ph.render(scene, **SIZE).numpy())


@pytest.mark.usefixtures("many_units")
def test_checkpoints_go_from_machines_to_clusters_and_back(
    client: Any, scene: Any, tmp_path: Path
) -> None:
    asked = {**SIZE, "spp": 70, "features": True}
    whole = ph.render(scene, checkpoint=tmp_path / "whole", **asked)
    kept: dict[str, Any] = {"checkpoint": tmp_path / "kept", "resume": True}
    ends = [150 * 85 * 7.3, 150 * 85 * 20.6, 150 * 85 * 41.7]
    for i, end in enumerate(ends):
        where = {"cluster": client, "threads": 1} if i % 2 else {}
        stopped = ph.render(
            scene, progress=lambda s, e=end: s.samples > e, **where, **kept, **asked
        )
        assert stopped.stats.ended == "stopped"
    made = ph.render(scene, cluster=client, threads=1, **kept, **asked)
    same(made, whole)


def during(
    client: Any, scene: Any, act: Callable[[int], None], shares: Sequence[float], **asked: Any
) -> ph.Image:
    """A picture by a cluster, while something is done when these shares of it are there."""
    done = 0

    def progress(state: ph.Progress) -> None:
        nonlocal done
        if done < len(shares) and state.samples > shares[done] * state.total_samples:
            done += 1
            act(done)

    image = ph.render(scene, cluster=client, threads=1, progress=progress, **asked)
    assert done == len(shares)
    return image


def pids(client: Any) -> list[int]:
    return list(client.run(os.getpid, on_error="ignore").values())  # one may just have ended


@pytest.mark.usefixtures("many_units")
def test_killed_workers_cost_nothing_but_time(scene: Any, long: bool) -> None:
    """One of three, whichever, at any instant, three times in a picture."""
    asked = {**SIZE, "spp": 100, "features": True}
    expected = ph.render(scene, **asked)
    seed = time.time_ns()
    print("seed", seed)
    chance = random.Random(seed)

    def kill(_: int) -> None:
        os.kill(chance.choice(pids(client)), signal.SIGKILL)

    with places.opened("local:3", 1) as (client, *_):
        for _ in range(10 if long else 1):
            shares = sorted(chance.uniform(0.0, 0.95) for _ in range(3))
            same(during(client, scene, kill, shares, **asked), expected)


@pytest.mark.usefixtures("many_units")
def test_workers_that_join_and_ones_that_stand_still(scene: Any) -> None:
    asked = {**SIZE, "spp": 100}
    stopped: list[int] = []
    with places.opened("local:2", 1) as (client, *_):

        def act(which: int) -> None:
            if which == 1:
                client.cluster.scale(3)
            else:
                stopped.append(pids(client)[0])
                os.kill(stopped[0], signal.SIGSTOP)

        try:
            made = during(client, scene, act, (0.33, 0.67), **asked)
        finally:
            for pid in stopped:
                os.kill(pid, signal.SIGCONT)
    same(made, ph.render(scene, **asked))


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@pytest.fixture
def cable() -> Iterator[Callable[..., Any]]:
    """Runs a command in a network of its own, at the other end of a cable from 198.51.100.1."""
    try:
        ip("link", "add", "parhelion0", "type", "veth", "peer", "name", "parhelion1")
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("making network devices is not allowed here")
    processes: list[subprocess.Popen[bytes]] = []

    def run(*command: str) -> None:
        wait = ["unshare", "-n", "sh", "-c", 'read go && exec "$@"', "sh"]
        process = subprocess.Popen([*wait, *command], stdin=subprocess.PIPE)
        processes.append(process)
        own, other = os.readlink("/proc/self/ns/net"), f"/proc/{process.pid}/ns/net"
        while os.readlink(other) == own:
            time.sleep(0.01)
        ip("link", "set", "parhelion1", "netns", str(process.pid))
        enter = ["nsenter", f"--net={other}", "ip"]
        for words in ("link set lo up", "addr add 198.51.100.2/24 dev parhelion1"):
            subprocess.run([*enter, *words.split()], check=True)
        subprocess.run([*enter, "link", "set", "parhelion1", "up"], check=True)
        assert process.stdin is not None
        process.stdin.write(b"go\n")
        process.stdin.flush()

    try:
        ip("addr", "add", "198.51.100.1/24", "dev", "parhelion0")
        ip("link", "set", "parhelion0", "up")
        yield run
    finally:
        for process in processes:
            process.kill()
            process.communicate()
        subprocess.run(["ip", "link", "del", "parhelion0"], capture_output=True)


@pytest.mark.usefixtures("many_units")
def test_a_cut_cable(scene: Any, cable: Callable[..., Any]) -> None:
    asked = {**SIZE, "spp": 200}
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, host="198.51.100.1", dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        there = "tcp://198.51.100.2:9000"
        program = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-nanny"]
        cable(*program, "--nthreads", "1", "--contact-address", there, "--listen-address", there,
              "--no-dashboard", cluster.scheduler_address)  # fmt: skip
        client.wait_for_workers(2, timeout=30)

        def act(_: int) -> None:
            ip("link", "set", "parhelion0", "down")

        made = during(client, scene, act, (0.5,), **asked)
        assert made.stats.threads == 2  # it was at work
    same(made, ph.render(scene, **asked))


def spoil() -> None:
    """Makes a worker fail at the tile in the corner."""
    from parhelion.cluster import worker

    own = worker.film_of

    def film_of(unit: Any, *more: Any) -> Any:
        if unit.x == 0 and unit.y == 0:
            raise MemoryError("no room")
        return own(unit, *more)

    worker.film_of = film_of


@contextlib.contextmanager
def mended(client: Any) -> Iterator[None]:
    """Puts back what the block replaces in three of the workers' modules."""

    def keep() -> None:
        import parhelion
        from parhelion import _core
        from parhelion.cluster import worker

        worker.before = [(module, dict(vars(module))) for module in (parhelion, _core, worker)]

    def mend() -> None:
        from parhelion.cluster import worker

        for module, values in vars(worker).pop("before", ()):
            vars(module).update(values)

    client.run(keep)
    try:
        yield
    finally:
        client.run(mend)


@pytest.mark.usefixtures("many_units")
def test_a_unit_that_always_fails_is_told_and_the_rest_is_kept(
    client: Any, scene: Any, caplog: pytest.LogCaptureFixture
) -> None:
    with mended(client):
        client.run(spoil)
        made = ph.render(scene, cluster=client, threads=1, **SIZE)
    assert made.stats.ended == "failed"
    assert not made.stats.complete
    told = [r.getMessage() for r in caplog.records if r.levelno == logging.ERROR]
    assert any("--crop 0,0," in text and "no room" in text for text in told)
    there = made.counts == 24
    assert there.sum() > 0.7 * there.size
    assert (made.counts[~there] == 0).all()
    np.testing.assert_array_equal(made.numpy()[there], ph.render(scene, **SIZE).numpy()[there])


def test_a_command_of_which_a_part_failed_ends_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with (
        places._processes(distributed, "local:1", 1) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.run(spoil)
        words = ["render", "--width", "64", "--spp", "4", "--cluster", cluster.scheduler_address]
        for more, told in (
            (["-o", "a.png"], "a.png has .* spp.*: a part failed"),
            (["--shard", "1/2", "-o", "a.part"], "a.part has .* spp.*: a part failed"),
            (["--turntable", "2", "-o", "b.png"], "a part of the next failed"),
        ):
            place = more[-1]
            assert cli.main([*words, *more[:-1], str(tmp_path / place)]) == 1
            assert re.search(told, capsys.readouterr().err)
    assert (tmp_path / "a.png").exists()
    assert not list(tmp_path.glob("b*"))


def be(status: str, dask_worker: Any) -> None:
    from distributed.core import Status

    dask_worker.status = Status[status]


@pytest.mark.usefixtures("many_units")
def test_paused_workers_are_done_without(client: Any, scene: Any) -> None:
    workers = one_of(client)
    client.run(be, "paused", workers=workers)
    try:
        made = ph.render(scene, cluster=client, threads=1, **SIZE)
    finally:
        client.run(be, "running", workers=workers)
    same(made, ph.render(scene, **SIZE))
    assert made.stats.threads == 1


def one_of(client: Any) -> list[str]:
    return [min(places.workers_of(client))]


@pytest.mark.usefixtures("many_units")
def test_the_scene_goes_to_each_worker_once(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = prepare(ph.weekend(2))  # which none of them has
    sent: list[str] = []
    ask = roster.Roster._ask

    def told(self: Any, address: str, function: Any, *more: Any) -> Any:
        if function.__name__ == "keep":
            sent.append(address)
        return ask(self, address, function, *more)

    def let_go() -> None:
        from parhelion.cluster import worker

        with worker._busy:
            while worker._scenes:
                worker._let_go()

    monkeypatch.setattr(roster.Roster, "_ask", told)
    before = set(client.futures)
    for seed in (0, 1):
        made = ph.render(scene, cluster=client, threads=1, seed=seed, **SIZE)
        same(made, ph.render(scene, seed=seed, **SIZE))
    assert len(sent) == len(set(sent)) == 2
    assert client.futures.keys() <= before  # nothing of ours is left with Dask
    made = during(client, scene, lambda _: client.run(let_go), (0.5,), **SIZE)
    same(made, ph.render(scene, **SIZE))
    assert 3 <= len(sent) <= 4  # both get it again, unless one had nothing to do any more


@pytest.mark.parametrize("reached", [True, False])
def test_data_goes_past_the_scheduler_where_it_can(
    scene: Any, monkeypatch: pytest.MonkeyPatch, reached: bool
) -> None:
    if not reached:
        monkeypatch.setattr(places, "reaches", lambda _address: False)
        monkeypatch.setattr(roster, "reaches", lambda _address: False)
    asked: Counter[str] = Counter()
    with places._processes(distributed, "local:1", 1) as cluster:
        handlers = cluster.scheduler.handlers
        for name in ("scatter", "gather"):

            def noted(*words: Any, name: str = name, do: Any = handlers[name], **more: Any) -> Any:
                asked[name] += 1
                return do(*words, **more)

            monkeypatch.setitem(handlers, name, noted)
        made = ph.render(scene, cluster=cluster.scheduler_address, threads=1, **SIZE)
    same(made, ph.render(scene, **SIZE))
    assert asked.keys() == (set() if reached else {"scatter", "gather"})


def test_workers_that_see_the_file_read_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, asked = tmp_path / "a.xyz", []
    file.write_text("2\n\nC 0 0 0\nO 1 0 0\n")
    ask = roster.Roster._ask

    def heard(self: Any, address: str, function: Any, *more: Any) -> Any:
        asked.append(function.__name__)
        return ask(self, address, function, *more)

    monkeypatch.setattr(roster.Roster, "_ask", heard)
    monkeypatch.setattr(roster, "is_here", lambda _: False)
    monkeypatch.setattr(roster, "_READ", 1)
    scene = ph.load(file)
    with places.opened("local:1", 1) as (client, *_):
        same(ph.render(scene, cluster=client, threads=1, **SIZE), ph.render(scene, **SIZE))
        assert asked == ["import_module", "greet", "read"]
        other = scene.replace(shapes=scene.shapes[:1])  # is not what the file holds
        same(ph.render(other, cluster=client, threads=1, **SIZE), ph.render(other, **SIZE))
        assert asked[3:] == ["import_module", "greet", "read", "keep"]
        file.unlink()
        third = scene.replace(shapes=scene.shapes[1:])
        same(ph.render(third, cluster=client, threads=1, **SIZE), ph.render(third, **SIZE))
        assert asked[7:] == ["import_module", "greet", "read", "keep"]


@pytest.mark.usefixtures("many_units")
@pytest.mark.parametrize(("when", "radius"), [("scene", 0.7), ("unit", 0.71), ("disk", 0.72)])
def test_a_worker_without_room_leaves_it_to_others(
    when: str, radius: float, client: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Of a scene that no worker has yet."""

    def spoil(when: str = when) -> None:
        import resource

        from parhelion.cluster import worker
        from parhelion.errors import ResourceError

        def refuse(*_: Any) -> Any:
            raise ResourceError("not enough memory here")

        if when == "scene":
            worker._built = refuse
        elif when == "unit":
            worker._rendered = refuse
        else:  # any file that it would write to is full
            most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.setrlimit(resource.RLIMIT_FSIZE, (0, most))

    def mend() -> None:
        import resource

        most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    scene = prepare(ph.Scene([ph.Spheres([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]], radius)]))
    asked = {**SIZE, "spp": 60}
    with contextlib.ExitStack() as stack:
        stack.enter_context(mended(client))
        stack.callback(client.run, mend)
        client.run(spoil, workers=one_of(client))
        made = ph.render(scene, cluster=client, threads=1, **asked)
        if when == "scene":
            assert "is left out: not enough memory here" in caplog.text
            client.run(spoil)
            other = ph.Scene([ph.Spheres([[0.0, 0.0, 0.0]], 0.5)])
            with pytest.raises(ph.ResourceError, match="does not work: not enough memory here"):
                ph.render(other, cluster=client, threads=1, **SIZE)
    same(made, ph.render(scene, **asked))


def tighten(room: int) -> None:
    """Leaves a process so many bytes more than it has."""
    import resource

    from parhelion.cluster import worker

    worker.build()  # loads the core, as another picture has done before
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + room
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not keep such limits")
def test_workers_whose_memory_runs_out_leave_it_to_others(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """While the arrays come, or while the tree is built."""
    centers = np.random.default_rng(1).uniform(-1.0, 1.0, (400_000, 3)).astype(np.float32)
    scene = prepare(ph.Scene([ph.Spheres(centers, 0.01)]))
    asked = {**SIZE, "spp": 8}
    with places.opened("local:4", 1) as (client, *_):
        workers = sorted(places.workers_of(client))
        for worker, room in zip(workers, (1 << 20, 8 << 20, 16 << 20), strict=False):
            client.run(tighten, room, workers=[worker])
        made = ph.render(scene, cluster=client, threads=1, **asked)
    assert "is left out: not enough memory" in caplog.text
    same(made, ph.render(scene, **asked))


def test_units_are_short_in_the_end_and_long_for_many() -> None:
    def seconds(left: float, workers: int, cost: float) -> float:
        return sampler.unit_seconds(left, 1.0, 1000, workers, cost)

    assert seconds(1e6, 4, 0.001) == sampler.UNIT_SECONDS
    lengths = []
    left = 40.0  # of two workers
    while left > 0:
        lengths.append(seconds(left, 2, 0.001))
        left -= lengths[-1]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[-1] == sampler._SHORTEST
    # no small rests
    assert [sampler.even_part(100, about) for about in (7.0, 60.0, 99.0, 1e9, 0.1)] == [
        *(8, 50, 100, 100, 1)
    ]
    # a thousand workers: this process can hand out as many units as they do
    assert 1000 / seconds(1e9, 1000, 0.005) * 0.005 <= sampler._BUSY + 1e-9


def test_the_first_tiles_lie_all_over_the_picture() -> None:
    film = SimpleNamespace(x=0, y=0, width=1900, height=1080)
    first = sampler._tiles(film, 2)[:8]
    assert len({tile.y // 180 for tile in first}) >= 5
    assert len({tile.x // 320 for tile in first}) >= 4


def test_a_build_is_told_by_its_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    from parhelion import _core
    from parhelion.cluster.worker import build

    of_sources = build.__wrapped__
    assert of_sources() == build()
    monkeypatch.setattr(_core, "sources", "x")
    assert of_sources() != build()


def test_workers_with_another_build_are_refused(client: Any, scene: Any) -> None:
    def change() -> None:
        import parhelion
        from parhelion.cluster import worker

        # Not what it is made of: a worker that is late would keep that for the tests to come.
        parhelion.__version__, worker.build = "0.0.9", lambda: "another"

    with mended(client):
        client.run(change)
        with pytest.raises(ph.SceneError, match=r"the worker tcp://.* has version 0.0.9 of Parhel"):
            ph.render(scene, cluster=client, **SIZE)


def test_a_picture_that_is_ended_early_is_about_even(client: Any, scene: Any) -> None:
    """The first units of 48 tiles are short, and later ones bring each to four times as many."""
    seen: list[ph.Progress] = []

    def ended(state: ph.Progress) -> bool:
        seen.append(state)
        return state.crew is not None and state.crew.units >= 100

    size = {"width": 512, "height": 384, "spp": 100_000}
    image = ph.render(scene, cluster=client, threads=1, time_limit=40, progress=ended, **size)
    assert image.stats.ended == "stopped", seen[-1]
    least, most = np.percentile(image.counts, [0, 100])
    assert least > 0, seen[-1]
    assert most / least < 12, seen[-1]


@pytest.mark.usefixtures("many_units")
def test_workers_that_end_together_are_nobodys_fault(
    scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of two workers, more often than a unit is tried."""
    monkeypatch.setattr(sampler, "_TRIES", 2)
    asked = {**SIZE, "spp": 100}

    def kill(_: int) -> None:
        dead = set(pids(client))
        for pid in dead:
            os.kill(pid, signal.SIGKILL)
        # Dask begins no worker again that dies as it begins: all must be there first.
        end = time.monotonic() + 30
        while time.monotonic() < end:
            time.sleep(0.1)
            with contextlib.suppress(OSError, TimeoutError):
                if len(set(pids(client)) - dead) == 2:
                    return
        pytest.skip("Dask did not begin its workers again within half a minute")

    # Dask gives up those that are not there 15 s after they were killed, were it a second time.
    waits = dask.config.set({"distributed.deploy.lost-worker-timeout": "100s"})
    with waits, places.opened("local:2", 1) as (client, *_):
        image = during(client, scene, kill, (0.1, 0.3, 0.5), **asked)
    same(image, ph.render(scene, **asked))


def test_processes_that_do_not_begin_again_are_not_waited_for(
    scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(places, "_GONE", 2.0)
    asked = {**SIZE, "spp": 1_000, "checkpoint": tmp_path / "kept"}
    with places.opened("local:1", 1) as opened:

        def end(_: int) -> None:
            opened.client.cluster.scale(0)

        with pytest.raises(ph.ResourceError, match="local:1: its processes have ended, and none"):
            during(opened, scene, end, [0.1], **asked)
    gone_on = ph.render(scene, time_limit=0.1, resume=True, **asked)
    assert gone_on.counts.sum() > 0.1 * 1_000 * gone_on.counts.size


def test_time_without_processes_counts_from_when_they_were_last_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    there: dict[str, Any] = {}
    now = 0.0
    monkeypatch.setattr(places, "workers_of", lambda _: there)
    monkeypatch.setattr(places.time, "monotonic", lambda: now)
    absence = places._Absence()

    def look(until: float) -> None:
        nonlocal now
        while now < until:
            now += 0.5
            places._check_processes(None, "local:1", absence)

    look(59.0)
    now = 70.0  # some are there, and nobody looks
    look(129.0)
    there["one"] = {}
    look(300.0)
    there.clear()
    look(359.0)
    with pytest.raises(ph.ResourceError, match="local:1: its processes have ended"):
        look(362.0)


@contextlib.contextmanager
def started(*words: str, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program of Dask's in a process of its own."""
    run = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]],
        env={**os.environ, **environment},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield run
    finally:
        run.kill()
        run.wait()


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """That of a scheduler without workers."""
    file = tmp_path / "scheduler.json"
    words = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    with started("dask_scheduler", *words, "--scheduler-file", str(file)):
        while True:
            with contextlib.suppress(OSError, ValueError):
                yield json.loads(file.read_text())["address"]
                break
            time.sleep(0.1)


def worker_of(address: str, **environment: str) -> Any:
    words = [address, "--no-nanny", "--nthreads", "1", "--no-dashboard"]
    return started("dask_worker", *words, **environment)


def test_a_worker_without_parhelion_is_told_before_work(
    address: str, scene: Any, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nsys.modules['parhelion'] = None  # as if it were not there\n"
    )
    with worker_of(address, PYTHONPATH=str(tmp_path)) as worker:
        with pytest.raises(ph.SceneError, match=r"the worker tcp:.* has no Parhelion"):
            ph.render(scene, cluster=address, **SIZE)
        time.sleep(0.5)
        assert worker.poll() is None  # others may use it


def test_a_worker_is_no_scheduler(address: str, scene: Any) -> None:
    with worker_of(address), distributed.Client(address) as other:
        other.wait_for_workers(1, timeout=30)
        worker = next(iter(places.workers_of(other)))
        with pytest.raises(ph.SceneError, match="a worker's address; must be its scheduler's"):
            ph.render(scene, cluster=worker, **SIZE)


def test_a_cluster_without_workers_is_waited_for(
    address: str, scene: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(roster, "_ALONE", 0.1)
    image = ph.render(scene, cluster=address, time_limit=2.0, **SIZE)
    assert (image.stats.ended, image.stats.samples) == ("time", 0)
    assert caplog.text.count("the cluster has no workers; waiting for some") == 1


@pytest.mark.usefixtures("many_units")
def test_a_scheduler_that_goes_leaves_the_checkpoint(scene: Any, tmp_path: Path) -> None:
    asked = {**SIZE, "spp": 100, "checkpoint": tmp_path / "kept"}
    with (
        places.opened("local:2", 1) as (client, *_),
        pytest.raises(ph.ResourceError, match=r"scheduler is gone|does not answer"),
    ):
        during(client, scene, lambda _: client.cluster.close(), (0.5,), **asked)
    made = ph.render(scene, resume=True, **asked)
    same(made, ph.render(scene, **{**asked, "checkpoint": tmp_path / "other"}))


def test_a_scene_is_the_same_after_its_way() -> None:
    rng = np.random.default_rng(1)
    cloud = ph.Spheres(rng.random((5000, 3)), radii=0.01, colors=rng.random((5000, 3)))
    mesh = ph.Mesh(rng.random((30, 3)), rng.integers(0, 30, (20, 3)))
    copies = ph.Instances([mesh, cloud], rng.random((4, 3, 4)))
    wood = ph.Material("diffuse", color=ph.Texture("image", image=rng.random((16, 16, 3))))
    for scene in (
        ph.weekend(),
        ph.Scene(
            [cloud, copies, mesh],
            {"wood": wood},
            background=ph.Background("constant", radiance=(1, 2, 3)),
        ),
    ):
        flat = prepare(scene).flat
        skeleton, bundles = scenes.packed(flat.parts)
        again = Flat(scenes.unpacked(skeleton, bundles), [], [], [])
        assert again.sha256() == flat.sha256()
        sent = {id(array) for bundle in bundles for _, array in bundle}
        held: list[Any] = []

        def arrays(value: Any, held: list[Any] = held) -> None:
            if isinstance(value, np.ndarray):
                held.append(value)
            elif isinstance(value, dict):
                [arrays(v) for v in value.values()]
            elif isinstance(value, (list, tuple)):
                [arrays(v) for v in value]

        arrays(flat.parts)
        assert all(id(array) in sent for array in held)  # none was copied


@pytest.mark.parametrize(
    ("cluster", "told"),
    [
        ("local", "must be local:N"),
        ("local:0", "must be local:N, N processes from 1"),
        ("local:x", "must be local:N"),
        ("host:8786", "must be local:N, slurm:FILE"),
        ("http://host", "must be local:N, slurm:FILE"),
        (3, "cluster is 3; must be local:N, .* or a client of dask.distributed"),
    ],
)
def test_clusters_that_are_none(scene: Any, cluster: Any, told: str) -> None:
    with pytest.raises(ph.SceneError, match=told):
        ph.render(scene, cluster=cluster, **SIZE)


@pytest.mark.parametrize(
    ("address", "warned"),
    [
        ("tcp://192.0.2.1:8786", True),
        ("ws://host:80", True),
        ("tls://192.0.2.1:8786", False),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://[::1]:8786", False),
    ],
)
def test_who_may_listen_is_told(
    address: str, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    class Client:
        def scheduler_info(self, **_: Any) -> dict[str, str]:
            return {"address": address}

    places._warn(Client())
    assert ("can be read and changed on the way" in caplog.text) == warned


def test_workers_that_an_answer_left_out_are_not_gone() -> None:
    """Dask's client asks now and then for no workers, and shows the last answer to whoever asks."""
    two = {"tcp://a:1": {}, "tcp://b:2": {}}
    answers = [{"n_workers": 2, "workers": {}}, {"n_workers": 2, "workers": two}]
    asked = SimpleNamespace(status="running", scheduler_info=lambda **_: answers.pop(0))
    assert places.workers_of(asked) == two
    answers = [{"n_workers": 2, "workers": {}}] * 9  # what a scheduler that is gone leaves
    assert places.workers_of(asked) == {}
    asked.status = "closed"
    with pytest.raises(ph.ResourceError, match="scheduler is gone"):
        places.workers_of(asked)


def test_nobody_answers(scene: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "_ANSWER", 0.2)
    with pytest.raises(ph.ResourceError, match=r"tcp://127.0.0.1:1: no scheduler answers"):
        ph.render(scene, cluster="tcp://127.0.0.1:1", **SIZE)
    with pytest.raises(ph.SceneError, match=r"cluster is 'tcp://\[x'"):
        ph.render(scene, cluster="tcp://[x", **SIZE)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ph.ResourceError, match=r"pip install 'parhelion\[cluster\]'"):
        ph.render(scene, cluster="local:2", **SIZE)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(tmp_path / f"{name}.png") for name in ("one", "many")]
    size = ["--width", "64", "--spp", "4"]
    assert cli.main(["render", *size, "-o", files[0], "-q"]) == 0
    assert cli.main(["render", *size, "-o", files[1], "--cluster", "local:2"]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "64x36, 4 spp in" in said
    one, many = (read_picture(Path(file))[0] for file in files)
    np.testing.assert_array_equal(one, many)
    assert cli.main(["render", "--cluster", "local:none", "-o", files[0]]) == 2
    assert "--cluster is 'local:none'; must be local:N" in capsys.readouterr().err


def test_workers_end_without_a_word(tmp_path: Path) -> None:
    words = ["--cluster", "local:2", "--width", "64", "--spp", "4", "-q", "-o", "x.png"]
    command = [sys.executable, "-m", "parhelion", "render", *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=True, timeout=60)
    assert done.stdout + done.stderr == b""


def with_samples(session: Session, spp: int) -> Any:
    """The session's picture, once each pixel has so many."""
    end = time.monotonic() + 60
    while (frame := session.finished()).spp < spp:
        assert time.monotonic() < end, (frame.spp, session.state()["error"], under_way(session))
        time.sleep(0.01)
    return frame


def under_way(session: Session) -> Any:
    """What a picture that stands still waits for."""
    drawing: Any = session._drawing
    if drawing is None or drawing.workers is None:
        return drawing
    crew, units = drawing.workers._roster, drawing.workers._dispatcher
    given = {key: (g.worker, g.future.status, g.done) for key, g in list(units._by_key.items())}
    asked = {address: (w.state, w.asked, w.has) for address, w in crew._workers.items()}
    return given, units._standing, units._load, asked, crew._sending, crew._sent


@pytest.mark.usefixtures("many_units")
def test_the_live_view_by_a_cluster(client: Any, scene: Any) -> None:
    size = {"width": 90, "height": 50, "spp": 40}
    told: list[int] = []
    with Session(scene, cluster=client, threads=1, **size) as session:
        session.subscribe(lambda _: told.append(session.frame.spp if session.frame else 0))
        for act in (
            lambda: None,
            lambda: session.look(ph.Camera(eye=(9, 3, 4), target=(0, 0.5, 0))),
            lambda: session.change("materials", 0, "color", [0.1, 0.5, 0.2]).result(20),
            lambda: session.hide({0}).result(20),
        ):
            act()
            frame = with_samples(session, 40)
            now = session.scene()
            np.testing.assert_array_equal(frame.pixels, ph.render(now, spp=40).numpy())
        session.limit(60)
        with_samples(session, 60)
    assert max(told) == 60


def test_the_live_view_by_a_cluster_shares_paths_where_that_pays(client: Any) -> None:
    size = {"width": 192, "height": 160, "spp": 5}
    with Session(room(True), cluster=client, threads=1, **size) as session:
        for _ in range(2):
            frame = with_samples(session, 5)
            expected = ph.render(room(True), camera=frame.camera, **size)
            assert frame.settings.reuse_paths is expected.settings.reuse_paths is True
            np.testing.assert_array_equal(frame.pixels, expected.numpy())
            session.look(ph.Camera(eye=(0.2, 1.1, 0.95), target=(0, 0.9, -1), vfov=70))


def test_the_live_view_goes_on_where_the_scheduler_ends(scene: Any) -> None:
    with places._processes(distributed, "local:1", 1) as cluster:
        address = cluster.scheduler_address
        session = Session(scene, cluster=address, threads=1, width=90, height=50, spp=1 << 20)
        with session:
            with_samples(session, 8)
            cluster.close()
            end = time.monotonic() + 60
            while "scheduler is gone" not in (session.state()["error"] or ""):
                assert time.monotonic() < end
                time.sleep(0.05)
            session.limit(session.finished().spp + 40)
            frame = with_samples(session, session.state()["spp"])
            counts = frame.counts
            expected = ph.render(session.scene(), counts=counts).numpy()
            np.testing.assert_array_equal(frame.pixels, expected)


@pytest.fixture
def slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder that tells what was handed to SLURM, whose commands begin a job at once."""
    if importlib.util.find_spec("dask_jobqueue") is None:  # importing it is not without effect
        pytest.skip("no dask-jobqueue")
    programs, told = tmp_path / "bin", tmp_path / "told"
    programs.mkdir()
    told.mkdir()
    (programs / "sbatch").write_text(
        # a copy, as what it is given is gone when it has answered
        f"#!/bin/sh\ncp $1 {told}/$$.copy\nsetsid sh {told}/$$.copy > {told}/out 2>&1 &\n"
        f"cp $1 {told}/$!.sh\necho Submitted batch job $!\n"
    )
    (programs / "scancel").write_text(
        f"#!/bin/sh\nfor job; do kill -- -$job; touch {told}/$job.ended; done\n"
    )
    for program in programs.iterdir():
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    yield told
    for script in told.glob("*.sh"):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(script.stem), signal.SIGKILL)


def test_jobs_of_slurm(slurm: Path, tmp_path: Path) -> None:
    file, one, many = tmp_path / "jobs.yaml", tmp_path / "one.png", tmp_path / "many.png"
    file.write_text(
        "jobs: 2\ncores: 1\nmemory: 1GB\ninterface: lo\nwalltime: '00:10:00'\nqueue: short\n"
    )
    size = ["--width", "64", "--spp", "4", "-q", "-o"]
    assert cli.main(["render", *size, str(one)]) == 0
    assert cli.main(["render", *size, str(many), "--cluster", f"slurm:{file}"]) == 0
    np.testing.assert_array_equal(read_picture(one)[0], read_picture(many)[0])
    jobs = list(slurm.glob("*.sh"))
    assert len(jobs) == 2
    assert "#SBATCH -p short" in jobs[0].read_text()
    assert len(list(slurm.glob("*.ended"))) == 2
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_slurm_refuses_is_told(slurm: Path, tmp_path: Path, scene: Any) -> None:
    (slurm.parent / "bin" / "sbatch").write_text(
        "#!/bin/sh\necho sbatch: error: invalid partition specified: short >&2\nexit 1\n"
    )
    file = tmp_path / "jobs.yaml"
    file.write_text("jobs: 2\ncores: 1\nmemory: 1GB\ninterface: lo\n")
    with pytest.raises(ph.ResourceError, match=r"SLURM took no job: .*invalid partition"):
        ph.render(scene, cluster=f"slurm:{file}", **SIZE)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_wait_for_a_cluster(number: int, tmp_path: Path) -> None:
    """Of a server that is none of Dask's and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        cluster = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        words = ["--cluster", cluster, "--width", "64", "-o", str(tmp_path / "x.png")]
        run = subprocess.Popen([sys.executable, "-m", "parhelion", "render", *words])
        silent, _ = server.accept()
        time.sleep(0.5)
        run.send_signal(number)
        assert run.wait(10) == 130
        silent.close()
    assert not (tmp_path / "x.png").exists()


@pytest.mark.usefixtures("slurm")
@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "cannot be read as YAML"),
        ("{", "cannot be read as YAML"),
        ("[1]", "must hold names and values"),
        ("cores: 1\nmemory: 1GB", "jobs is None; must be how many to ask for"),
        ("jobs: 0", "jobs is 0"),
        ("jobs: 2\ncores: 1", "lacks memory of a job"),
        ("jobs: 2\ncores: 1\nmemory: 1GB\nqueues: a", "queues"),
        ("jobs: 2\ncores: 1\nmemory: much", "much"),
    ],
)
def test_wrong_files_for_slurm(
    text: str | None, told: str, tmp_path: Path, scene: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "jobs.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ph.FormatError, match=rf"jobs\.yaml: .*{told}"):
        ph.render(scene, cluster=f"slurm:{file}", **SIZE)
    monkeypatch.setenv("PATH", "/nowhere")
    file.write_text("jobs: 2\ncores: 1\nmemory: 1GB")
    with pytest.raises(ph.ResourceError, match="there is no sbatch here"):
        ph.render(scene, cluster=f"slurm:{file}", **SIZE)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here")
def test_tls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As docs/cluster.md sets it: one certificate for all, by Dask's own settings."""
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "cert.pem")
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=a",
         "-keyout", key, "-out", certificate], check=True, capture_output=True,
    )  # fmt: skip
    both = (("CERT", certificate), ("KEY", key))
    tls = {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": certificate}
    for who in ("CLIENT", "SCHEDULER", "WORKER"):
        tls |= {f"DASK_DISTRIBUTED__COMM__TLS__{who}__{k}": v for k, v in both}
    file, one, many = tmp_path / "scheduler.json", tmp_path / "one.png", tmp_path / "many.png"
    size = ["--width", "64", "--spp", "4", "-q", "-o"]
    found = ["--scheduler-file", str(file), "--no-dashboard"]
    with contextlib.ExitStack() as stack:
        for name, *more in (
            ("dask_scheduler", "--protocol", "tls", "--port", "0", "--host", "127.0.0.1"),
            ("dask_worker", "--nthreads", "1"),
        ):
            words = [sys.executable, "-m", f"distributed.cli.{name}", *found, *more]
            process = subprocess.Popen(words, env={**os.environ, **tls}, stderr=subprocess.DEVNULL)
            stack.enter_context(process)
            stack.callback(process.terminate)
            end = time.monotonic() + 30
            while not file.exists():
                assert time.monotonic() < end
                time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        assert address.startswith("tls://")
        words = ["render", *size, str(many), "--cluster", address]
        assert cli.main(words) == 2
        assert "no certificates for TLS" in capsys.readouterr().err
        program = [sys.executable, "-m", "parhelion", *words]
        subprocess.run(program, env={**os.environ, **tls}, check=True)
    assert cli.main(["render", *size, str(one)]) == 0
    np.testing.assert_array_equal(read_picture(one)[0], read_picture(many)[0])
