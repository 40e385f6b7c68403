"""What a cluster costs, and how far it goes: python -m bench.cluster measure|simulate.

`measure` renders the weekend scene with one and two local workers of a thread each. "threads": the
seconds of as many threads of one process, alternating, "ratio" theirs; "processor": the same of the
processor's time, of all processes together; "busy": the share of its
time that a worker renders, and as the simulation tells it from the same speed. Then what a unit
costs by the edge of its tile: bytes on the wire, and seconds of the processor in the process that
hands out and adds up, and in the worker beside rendering; a line through them is what the
simulation takes.

`simulate` plays frames on 2 to 1,024 workers with those costs: each event that a unit is handed
out, travels, is rendered, comes back and is added up, by the rules of parhelion.cluster.sampler.
Efficiency is the time that the work takes without any of that over the time it took. What comes in
and goes out shares one wire, and what one process does, one after the other. With `-o FILE.svg` it
draws the chart of docs/cluster.md.
"""

from __future__ import annotations

import argparse
import heapq
import math
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from parhelion.cluster import dispatch, sampler

SIZE = {"width": 960, "height": 540}
WORKERS = (2, 4, 8, 16, 32, 64, 128, 256, 512, 1024)
# Seconds of a frame without any overhead, and the efficiency that is asked of 256 workers
FRAMES = {60.0: 0.9, 600.0: 0.95}
FRAME_SIZE = (1920, 1080)
LENGTHS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)


@dataclass(frozen=True)
class Costs:
    """speed: samples a second of a worker; spread: standard deviation of the logarithm of how much
    longer a tile's samples take than the mean's. desk, desk_byte: seconds that a unit and each byte
    of it keep busy the process which hands out; unit, unit_byte: the worker, beside rendering.
    head, pixel: bytes of a unit and of each of its pixels. bandwidth: of the wire of that process,
    bytes a second; latency: seconds of a message; pause: between two looks at what came.
    """

    speed: float
    spread: float
    desk: float
    desk_byte: float
    unit: float
    unit_byte: float
    head: float
    pixel: float
    bandwidth: float = 1.25e9
    latency: float = 0.0005
    pause: float = sampler._PAUSE


# As `measure` told them; docs/cluster.md has the day and the machine.
MEASURED = Costs(2.2e6, 0.36, 0.0069, 9.8e-9, 0.0039, 11.6e-9, 5900.0, 52.3)


@dataclass(frozen=True)
class Played:
    """efficiency; units handed out; bytes that went over the wire; the share of the time that the
    process which hands out was busy.
    """

    efficiency: float
    units: int
    bytes: float
    busy: float


def play(workers: int, seconds: float, size: tuple[int, int], costs: Costs) -> Played:
    """A frame that takes so many seconds on so many workers if nothing but rendering takes time."""
    film = _Film(*size)
    tiles = sampler._tiles(film, workers)
    areas = [tile.width * tile.height for tile in tiles]
    random = np.random.default_rng(1)
    dear = np.exp(costs.spread * random.standard_normal(len(tiles)))
    dear /= np.average(dear, weights=areas)
    spp = max(1, round(workers * costs.speed * seconds / sum(areas)))
    ideal = spp * sum(areas) / costs.speed / workers
    left = float(spp * sum(areas))
    waiting = [(0, i) for i in range(len(tiles))]
    free = deque([w for _ in range(dispatch.EACH) for w in range(workers)])
    ends: list[tuple[float, int, int, int]] = []  # when, worker, tile, samples of a pixel
    coming: deque[tuple[float, int, int, int]] = deque()  # as they come off the wire
    idle = np.zeros(workers)  # from when on a worker is
    desk = wire = moved = used = 0.0
    each = costs.desk
    speed = 0.0  # as far as it is known
    units = 0

    def bytes_of(tile: int) -> float:
        return costs.head + costs.pixel * areas[tile]

    while waiting or ends or coming:
        may_hand = bool(waiting and free)
        while ends and (ends[0][0] <= desk or not (coming or may_hand)):
            end, *what = heapq.heappop(ends)
            wire = max(wire, end) + bytes_of(what[1]) / costs.bandwidth
            moved += bytes_of(what[1])
            coming.append((wire + costs.latency, *what))
        if coming and (coming[0][0] <= desk or not may_hand):
            came, worker, tile, done = coming.popleft()
            if came > desk:  # it looks only now and then
                came = math.ceil(came / costs.pause) * costs.pause
            each = costs.desk + costs.desk_byte * bytes_of(tile)
            used += 0.5 * each
            desk = max(desk, came) + 0.5 * each
            speed = costs.speed
            free.append(worker)
            if done < spp:
                heapq.heappush(waiting, (done, tile))
        elif may_hand:
            done, tile = heapq.heappop(waiting)
            worker = free.popleft()
            samples = float(sampler._FIRST)
            if speed:
                had = done * areas[tile] / speed
                samples = speed * sampler.unit_seconds(left / speed, had, len(areas), workers, each)
            step = sampler.even_part(spp - done, samples / areas[tile])
            left -= step * areas[tile]
            units += 1
            used += 0.5 * each
            desk += 0.5 * each
            begin = max(desk + costs.latency, idle[worker])
            rendering = step * areas[tile] * dear[tile] / costs.speed
            idle[worker] = begin + costs.unit + costs.unit_byte * bytes_of(tile) + rendering
            heapq.heappush(ends, (idle[worker], worker, tile, done + step))
    return Played(ideal / desk, units, moved, used / desk)


class _Film:
    """What sampler._tiles() asks of a film."""

    def __init__(self, width: int, height: int) -> None:
        self.x, self.y, self.width, self.height = 0, 0, width, height


@contextmanager
def of_length(seconds: float, edge: int = sampler.EDGE) -> Iterator[None]:
    """In the block units take so long, whatever they cost, and their tiles are as large."""
    with mock.patch.multiple(
        sampler,
        UNIT_SECONDS=seconds,
        _SHORTEST=min(seconds, sampler._SHORTEST),
        _FIRST_ROUND=math.inf,
        _BUSY=math.inf,
        EDGE=edge,
    ):
        yield


@dataclass
class Run:
    """What one rendering by local workers took. wall, desk, workers: seconds, of the clock, and of
    the processor here and there; rendering: of all units; wire: bytes.
    """

    wall: float
    desk: float
    workers: float
    rendering: float
    samples: int
    units: int
    wire: float


def render_with(client: Any, scene: Any, spp: int, size: dict[str, int]) -> Run:
    """A picture by the workers of a client, one thread each."""
    import psutil

    import parhelion as ph

    seconds: list[float] = []
    add = sampler.Workers._add

    def adding(self: Any, tile: Any, unit: Any, seen: Any) -> None:
        seconds.append(seen.seconds)
        add(self, tile, unit, seen)

    def wire() -> float:
        return float(psutil.net_io_counters(pernic=True)["lo"].bytes_sent)

    def there() -> float:
        return float(sum(client.run(time.process_time).values()))

    sampler.Workers._add = adding
    try:
        workers, sent, here, start = there(), wire(), time.process_time(), time.perf_counter()
        image = ph.render(scene, cluster=client, threads=1, spp=spp, **size)
        wall = time.perf_counter() - start
        here, sent = time.process_time() - here, wire() - sent
        workers = there() - workers
    finally:
        sampler.Workers._add = add
    return Run(wall, here, workers, sum(seconds), image.stats.samples, len(seconds), sent)


def measure(rounds: int, spp: int) -> Costs:
    """Prints the tables, and returns what the simulation takes."""
    import parhelion as ph
    from parhelion.cluster import places

    scene = ph.prepare(ph.weekend())
    print("| workers | threads, s | cluster, s | ratio | processor | busy | simulated |")
    print("|---|---|---|---|---|---|---|")
    line = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for count in (1, 2):
        with places.opened(f"local:{count}", 1) as (client, *_):
            render_with(client, scene, 4, SIZE)  # the scene goes there
            if count == 1:
                line = _line(client, scene)
            runs, ratios, plain, processor = [], [], [], []
            for _ in range(rounds):
                start, used = time.perf_counter(), time.process_time()
                ph.render(scene, threads=count, spp=spp, **SIZE)
                plain.append(time.perf_counter() - start)
                used = time.process_time() - used
                runs.append(render_with(client, scene, spp, SIZE))
                ratios.append(runs[-1].wall / plain[-1])
                processor.append((runs[-1].desk + runs[-1].workers) / used)
        busy = float(np.median([r.rendering / (count * r.wall) for r in runs]))
        speed = float(np.median([r.samples / r.rendering for r in runs]))
        costs = Costs(speed, _spread(scene), *line)
        wall = float(np.median([r.wall for r in runs]))
        size = (SIZE["width"], SIZE["height"])
        played = play(count, runs[0].samples / speed / count, size, costs)
        print(
            f"| {count} | {np.median(plain):.2f} | {wall:.2f} | {np.median(ratios):.3f}"
            f" ({min(ratios):.3f} to {max(ratios):.3f}) | {np.median(processor):.3f}"
            f" ({min(processor):.3f} to {max(processor):.3f}) | {busy:.3f}"
            f" | {played.efficiency:.3f} |",
            flush=True,
        )
    print()
    print(costs)
    return costs


def _line(client: Any, scene: Any) -> tuple[float, float, float, float, float, float]:
    """desk, desk_byte, unit, unit_byte, head, pixel of Costs, from units of three sizes."""
    rest = time.process_time()
    time.sleep(2.0)
    idle = (time.process_time() - rest) / 2.0
    rows = []
    for edge in (16, 32, 64):
        with of_length(0.02 * (edge / 16), edge):
            run = render_with(client, scene, 24, SIZE)
        here = (run.desk - idle * run.wall) / run.units
        there = (run.workers - run.rendering) / run.units
        rows.append((edge, run.wire / run.units, here, max(0.0, there)))
    print("| edge | bytes | desk, ms | worker, ms |\n|---|---|---|---|")
    for edge, wire, here, there in rows:
        print(f"| {edge} | {wire:.0f} | {1e3 * here:.2f} | {1e3 * there:.2f} |")
    print()
    edges, wires, heres, theres = (np.array(column) for column in zip(*rows, strict=True))
    pixel, head = np.polyfit(edges**2.0, wires, 1)
    desk_byte, desk = np.polyfit(wires, heres, 1)
    unit_byte, unit = np.polyfit(wires, theres, 1)
    told = (desk, desk_byte, unit, unit_byte, head, pixel)
    return tuple(max(0.0, float(v)) for v in told)  # type: ignore[return-value]


def _spread(scene: Any) -> float:
    """Of the logarithm of the rays that tiles need."""
    import parhelion as ph

    rays = []
    for x in range(0, SIZE["width"], 96):
        for y in range(0, SIZE["height"], 60):
            rays.append(ph.render(scene, crop=(x, y, 96, 60), spp=1, **SIZE).stats.rays)
    return float(np.std(np.log(rays)))


def simulate(costs: Costs, file: Path | None) -> None:
    """Prints efficiencies, and draws them."""
    found: dict[tuple[float, float], list[float]] = {}
    for bandwidth, name in ((1.25e9, "10 Gbit/s"), (1.25e8, "1 Gbit/s")):
        wire = replace(costs, bandwidth=bandwidth)
        print(f"| workers, {name} | " + " | ".join(f"{s:g} s" for s in FRAMES), end=" | ")
        print("units | MB/s | desk |\n|---" + "|---" * (len(FRAMES) + 3) + "|")
        for workers in WORKERS:
            played = [play(workers, s, FRAME_SIZE, wire) for s in FRAMES]
            for seconds, p in zip(FRAMES, played, strict=True):
                found.setdefault((bandwidth, seconds), []).append(p.efficiency)
            cells = " | ".join(f"{p.efficiency:.3f}" for p in played)
            rate = played[0].bytes / (next(iter(FRAMES)) / played[0].efficiency) / 1e6
            print(f"| {workers} | {cells} | {played[0].units} | {rate:.0f} |", end="")
            print(f" {played[0].busy:.2f} |", flush=True)
        print()
    columns = [(workers, seconds) for workers in (16, 256) for seconds in FRAMES]
    print("| a unit, s | " + " | ".join(f"{w} workers, {s:g} s" for w, s in columns) + " |")
    print("|---" * (1 + len(columns)) + "|")

    def row(name: str) -> None:
        cells = [f"{play(w, s, FRAME_SIZE, costs).efficiency:.3f}" for w, s in columns]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)

    for length in LENGTHS:
        with of_length(length):
            row(f"{length:g}")
    row("by the rule")
    if file is not None:
        _draw(found, file)


def _draw(found: dict[tuple[float, float], list[float]], file: Path) -> None:
    import matplotlib as mpl

    from parhelion.atomic import replacing

    from .charts import STYLE, grid

    with mpl.rc_context(STYLE):
        figure, (axis,) = grid(1, 1, 3.0)
        figure.set_size_inches(5.5, 3.0)
        for (bandwidth, seconds), efficiencies in found.items():
            fast = bandwidth > 1e9
            label = f"{seconds / 60:g} min, {'10' if fast else '1'} Gbit/s"
            color = f"C{list(FRAMES).index(seconds)}"
            axis.semilogx(WORKERS, efficiencies, "o-" if fast else "o--", color=color, label=label)
        for i, (seconds, goal) in enumerate(FRAMES.items()):
            axis.plot([256], [goal], "x", color=f"C{i}", markersize=8)
            del seconds
        axis.set_xticks(WORKERS, [str(w) for w in WORKERS])
        axis.minorticks_off()
        axis.set(xlabel="workers", ylabel="efficiency", ylim=(0.5, 1.0))
        axis.legend(frameon=False, fontsize="small", handlelength=3)
        with replacing(file) as temporary:
            figure.savefig(temporary, format="svg", metadata={"Date": None})


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.cluster")
    parser.add_argument("what", choices=["measure", "simulate"])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--spp", type=int, default=128)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.svg")
    args = parser.parse_args(arguments)
    if args.what == "measure":
        measure(args.rounds, args.spp)
    else:
        simulate(MEASURED, args.output)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
