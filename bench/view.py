"""`parhelion view` under load.

python -m bench.view latency    from a key in a real page to the picture that it leads to
python -m bench.view noise      the error of what is shown, by how long it has been looked at
python -m bench.view soak       clients that come and go, and what memory is taken meanwhile
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import math
import os
import random
import shutil
import socket
import statistics
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from urllib.parse import urlsplit

import parhelion as ph
from parhelion.view.server import Server
from parhelion.view.session import Session, resident

from .scenes import GALLERY, cloud

# Milliseconds until something is to be seen after a camera moved
WANTED = 300.0
# Bytes that may be taken beyond what is taken in the first half of the time
SLACK = 32e6


def scene(spheres: int) -> ph.Scene:
    """Random spheres, as the bench's other clouds, or the built-in scene if there are none."""
    if not spheres:
        return ph.weekend()
    centers, radius = cloud(spheres)
    matte = ph.Material("diffuse", color=(0.7, 0.6, 0.5))
    return ph.Scene([ph.Spheres(centers, radius, matte)])


# --- Latency -------------------------------------------------------------------------------------

# Presses a key in the page; resolves to milliseconds until a picture of the new camera is drawn.
PRESS = """(key) => new Promise((resolve) => {
  const before = Number(document.body.dataset.stamp || 0);
  const start = performance.now();
  const observer = new MutationObserver(() => {
    if (Number(document.body.dataset.stamp) > before) {
      observer.disconnect();
      resolve(performance.now() - start);
    }
  });
  observer.observe(document.body, { attributes: true, attributeFilter: ["data-stamp"] });
  document.querySelector("[role=application]").dispatchEvent(
    new KeyboardEvent("keydown", { key, bubbles: true }));
})"""


def latency(spheres: int, moves: int, width: int, height: int) -> int:
    """Prints the milliseconds; 1 if more than one move in twenty takes longer than wanted."""
    from playwright.sync_api import sync_playwright

    names = ("chromium", "chromium-browser", "google-chrome")
    path = os.environ.get("PARHELION_CHROMIUM") or next(filter(None, map(shutil.which, names)))
    rng = random.Random(1)
    with Session(scene(spheres)) as session, Server(session) as server, sync_playwright() as p:
        browser = p.chromium.launch(executable_path=path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": width, "height": height})
        page.goto(server.url)
        page.wait_for_selector('body[data-scale="1"]', timeout=120_000)
        taken = []
        for k in range(moves):
            time.sleep(rng.uniform(0.0, 0.6))  # in the middle of whatever is under way
            key = ("ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "+", "-")[k % 6]
            taken.append(page.evaluate(PRESS, key))
        size = session.state()
        browser.close()
    taken.sort()
    late = sum(t > WANTED for t in taken)
    print(
        f"{spheres or 'weekend'} spheres, {size['width']}x{size['height']}, {moves} moves:"
        f" median {statistics.median(taken):.0f} ms, 95 % {taken[int(0.95 * moves)]:.0f} ms,"
        f" longest {taken[-1]:.0f} ms; {late} over {WANTED:.0f} ms"
    )
    return int(late > moves / 20)


# --- Noise ---------------------------------------------------------------------------------------

MARKS = (0.1, 0.3, 1.0, 3.0, 10.0)  # seconds


def noise(name: str, pixels: int, spp: int) -> int:
    """Prints trimmed errors (parhelion.comparison.relative_mse) by seconds since a scene of the
    gallery was opened, and since its camera was moved a little; each pixel by itself, and as it is
    by default. spp: of the references.
    """
    from parhelion.comparison import relative_mse

    from .gallery import load

    prepared = ph.prepare(load(name, pixels))
    first = prepared.scene.camera
    assert isinstance(first, ph.Camera)
    aside = 0.02 * math.dist(first.eye, first.target)
    moved = replace(first, eye=(first.eye[0] + aside, *first.eye[1:]))
    truths = [ph.render(prepared, camera=c, spp=spp, seed=999).numpy() for c in (first, moved)]
    print("|", name, "|", " | ".join(f"{mark:g} s" for mark in MARKS), "|")
    for ways, words in ((False, "each pixel by itself"), ("auto", "by default")):
        with Session(prepared, reuse_paths=ways) as session:
            for k, (what, truth) in enumerate(zip(("opened", "moved"), truths, strict=True)):
                began, errors = time.perf_counter(), []
                revision = session.look(moved) if k else 0
                for mark in MARKS:
                    time.sleep(max(0.0, began + mark - time.perf_counter()))
                    frame = session.frame
                    is_it = frame is not None and frame.revision == revision and frame.scale == 1.0
                    errors.append(f"{relative_mse(frame.pixels, truth)[1]:.3g}" if is_it else "")
                print(f"| {what}, {words} | {' | '.join(errors)} |")
    return 0


# --- Soak ----------------------------------------------------------------------------------------


class _Info(ctypes.Structure):
    """glibc's struct mallinfo2."""

    _fields_ = [
        ("before", 4 * ctypes.c_size_t),
        ("hblkhd", ctypes.c_size_t),  # bytes of large blocks
        ("between", 2 * ctypes.c_size_t),
        ("uordblks", ctypes.c_size_t),  # bytes of all others
        ("after", 2 * ctypes.c_size_t),
    ]


def allocated() -> int:
    """Bytes that the C library has given out and that were not given back, as opposed to those that
    it keeps for what comes; 0 where it does not tell.
    """
    try:
        ask = ctypes.CDLL(None).mallinfo2
    except (AttributeError, OSError):
        return 0
    ask.restype = _Info
    info = ask()
    return int(info.uordblks + info.hblkhd)


def soak(minutes: float, clients: int, spheres: int, every: float) -> int:
    """Prints what is taken, by time; 1 if it grows."""
    rows: list[tuple[float, int, int, int]] = []  # minutes, resident, allocated, objects
    # small pictures, so that what is kept by mistake is not lost among what they take
    with Session(scene(spheres), width=320, height=180) as session, Server(session) as server:
        command = [sys.executable, "-m", "bench.view", "clients", server.url, str(clients)]
        visitors = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        print("  minutes    MB  given  threads  files  objects  clients  frames", flush=True)
        start = time.monotonic()
        try:
            while time.monotonic() - start < 60 * minutes:
                time.sleep(every)
                passed = (time.monotonic() - start) / 60
                gc.collect()
                rows.append((passed, resident() or 0, allocated(), len(gc.get_objects())))
                _, taken, given, objects = rows[-1]
                files = len(os.listdir("/proc/self/fd"))
                number = session.frame.number if session.frame else 0
                print(
                    f"{passed:9.1f} {taken / 1e6:5.0f} {given / 1e6:6.1f}"
                    f" {threading.active_count():8d} {files:6d} {objects:8d}"
                    f" {server.clients:8d} {number:7d}",
                    flush=True,
                )
                if visitors.poll() is not None:
                    print("the clients ended")
                    return 1
        finally:
            visitors.terminate()
            visitors.wait()
        end = time.monotonic() + 60
        while server.clients and time.monotonic() < end:
            time.sleep(0.1)
        left = server.clients
    # medians: what is taken for a moment, to save a file say, is no leak
    early = statistics.median(row[1] for row in rows if 0.25 < row[0] / minutes <= 0.5)
    late = statistics.median(row[1] for row in rows if row[0] / minutes > 0.75)
    print(f"second quarter {early / 1e6:.0f} MB, last {late / 1e6:.0f} MB, {left} clients left")
    warm = [row for row in rows if row[0] / minutes > 0.25]
    hours = [row[0] / 60 for row in warm]
    for name, values in (
        ("MB resident", [row[1] / 1e6 for row in warm]),
        ("MB given out by malloc", [row[2] / 1e6 for row in warm]),
        ("objects of Python", [float(row[3]) for row in warm]),
    ):
        slope = statistics.linear_regression(hours, values).slope
        print(f"{name}: median {statistics.median(values):.0f}, {slope:+.1f} an hour")
    return int(late > early + SLACK or left > 0)


def visit(url: str, clients: int) -> None:
    """Many clients, each for some seconds and then another one, until the process is ended."""
    for k in range(clients):
        threading.Thread(target=_come_and_go, args=(url, k), daemon=True).start()
    while True:
        time.sleep(60)


def _come_and_go(url: str, seed: int) -> None:
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import connect

    rng = random.Random(seed)
    target = f"{url.replace('http', 'ws')}session"
    while True:
        with suppress(WebSocketException, OSError, TimeoutError):
            kind = rng.random()
            if kind < 0.1:
                _deaf(url, rng)
            else:
                with connect(target, max_size=None, close_timeout=1) as ws:
                    _use(ws, rng, answers=kind < 0.9)
                    if rng.random() < 0.3:
                        ws.socket.close()  # gone without a word
        time.sleep(rng.uniform(0.0, 1.0))


def _deaf(url: str, rng: random.Random) -> None:
    """One that never reads."""
    parts = urlsplit(url)
    with socket.create_connection((parts.hostname, parts.port)) as raw:
        raw.sendall(
            f"GET {parts.path}session HTTP/1.1\r\nHost: {parts.netloc}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        time.sleep(rng.uniform(0.0, 30.0))


def _use(ws: object, rng: random.Random, answers: bool) -> None:
    end = time.monotonic() + rng.uniform(0.0, 20.0)
    while time.monotonic() < end:
        raw = ws.recv(5.0)  # type: ignore[attr-defined]
        header = json.loads(raw[4 : 4 + int.from_bytes(raw[:4], "little")])
        if header["type"] == "frame" and answers:
            ws.send(json.dumps({"type": "seen", "frame": header["number"]}))  # type: ignore[attr-defined]
        if rng.random() < 0.4:
            ws.send(_message(rng))  # type: ignore[attr-defined]


def _message(rng: random.Random) -> str:
    eye = [rng.uniform(-9, 9), rng.uniform(1, 4), rng.uniform(-9, 9)]
    choices = [
        *[{"type": "look", "camera": {"eye": eye}, "stamp": 1}] * 12,
        {"type": "home"},
        {"type": "size", "width": rng.randrange(160, 320), "height": rng.randrange(90, 180)},
        {"type": "show", "exposure": rng.uniform(-2, 2)},
        {"type": "show", "layer": rng.choice(["picture", "picture", "normal", "depth", "error"])},
        {"type": "show", "view_transform": rng.choice(["srgb", "agx", "aces"])},
        {"type": "crop", "part": rng.choice([None, [0.2, 0.2, 0.5, 0.5]])},
        {"type": "change", "kind": "materials", "index": 0, "name": "color",
         "value": [rng.random() for _ in range(3)]},
        {"type": "hide", "objects": rng.choice([[], [0]])},
        {"type": "restore"},
        {"type": "pick", "x": rng.random(), "y": rng.random()},
        {"type": "save", "format": rng.choice(["png", "exr", "json"])},
        {"type": "nonsense"},
    ]  # fmt: skip
    return json.dumps(rng.choice(choices))


def main() -> int:
    """One of the measurements; its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    whats = ("latency", "noise", "soak", "clients")
    parser.add_argument("what", choices=whats, help="clients: soak's own")
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    parser.add_argument("--spheres", type=float, default=0, help="default: the built-in scene")
    parser.add_argument("--moves", type=int, default=60)
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800), help="of the window")
    parser.add_argument("--scene", choices=GALLERY, default="sponza", help="of noise")
    parser.add_argument("--reference-spp", type=int, default=512, help="of noise")
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--clients", type=int, default=6)
    parser.add_argument("--every", type=float, default=15, help="seconds between two rows")
    args = parser.parse_args()
    if args.what == "clients":
        visit(args.rest[0], int(args.rest[1]))
    if args.what == "latency":
        return latency(int(args.spheres), args.moves, *args.size)
    if args.what == "noise":
        return noise(args.scene, math.prod(args.size), args.reference_spp)
    import logging

    logging.getLogger("parhelion").setLevel("ERROR")  # of what is refused there is much
    return soak(args.minutes, args.clients, int(args.spheres), args.every)


if __name__ == "__main__":
    sys.exit(main())
