"""The server of `parhelion view`, talked to by real clients."""

from __future__ import annotations

import http.client
import io
import json
import logging
import shlex
import signal
import socket
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

import parhelion as ph
from parhelion.image import read_pixels
from parhelion.view import messages
from parhelion.view.messages import (
    LARGEST,
    MOST_ANSWERS,
    MOST_MISTAKES,
    UNSEEN,
    Client,
    Packer,
)
from parhelion.view.server import Server
from parhelion.view.session import Session, resident
from test_view_session import scene, settled


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(scene(), spp=4) as s:
        yield s


@pytest.fixture
def server(session: Session) -> Iterator[Server]:
    with Server(session) as s:
        yield s


class Talker:
    """A client that shows every frame at once, and keeps the newest message of each type."""

    def __init__(self, ws: ClientConnection, acknowledges: bool = True) -> None:
        self.ws, self.acknowledges = ws, acknowledges
        self.newest: dict[str, dict[str, Any]] = {}
        self.data: dict[str, bytes] = {}
        self.frames = 0

    def send(self, type: str, **message: Any) -> None:
        self.ws.send(json.dumps({"type": type, **message}))

    def next(self, seconds: float = 10.0) -> str:
        raw = self.ws.recv(seconds)
        assert isinstance(raw, bytes)
        size = int.from_bytes(raw[:4], "little")
        header = json.loads(raw[4 : 4 + size])
        self.newest[header["type"]] = header
        self.data[header["type"]] = raw[4 + size :]
        if header["type"] == "frame":
            self.frames += 1
            if self.acknowledges:
                self.send("seen", frame=header["number"])
        return header["type"]

    def until(self, type: str, seconds: float = 10.0, **wanted: Any) -> dict[str, Any]:
        """The next message of that type whose header has these values."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.next() == type and wanted.items() <= self.newest[type].items():
                return self.newest[type]
        raise AssertionError(f"no {type} with {wanted} after {seconds} s")


@contextmanager
def talking(server: Server, acknowledges: bool = True, **options: Any) -> Iterator[Talker]:
    url = f"{server.url.replace('http', 'ws')}session"
    with connect(url, max_size=None, close_timeout=1, **options) as ws:
        yield Talker(ws, acknowledges)


def get(
    server: Server, path: str | None = None, headers: dict[str, str] | None = None
) -> tuple[int, dict[str, str], bytes]:
    there = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    there.request("GET", urlsplit(server.url).path if path is None else path, headers=headers or {})
    answer = there.getresponse()
    body = answer.read()
    there.close()
    return answer.status, dict(answer.getheaders()), body


def test_a_picture_comes_and_a_camera_changes_it(server: Server) -> None:
    with talking(server) as talk:
        first = talk.until("frame", scale=1.0, spp=4)
        assert (first["width"], first["height"], first["place"]) == (96, 64, [0, 0, 96, 64])
        assert first["memory"] > 1e6
        before = read_pixels(talk.data["frame"])
        exact = ph.render(scene(), spp=4).srgb()
        assert np.abs(before.astype(int) - exact).mean() < 3  # as a JPEG has it
        camera = {**talk.newest["state"]["camera"], "eye": [3, 2, 3]}
        talk.send("look", camera=camera, stamp=7)
        talk.until("state", stamp=7)
        assert talk.newest["state"]["camera"]["eye"] == [3, 2, 3]
        talk.until("frame", scale=1.0, spp=4, stamp=7)
        after = read_pixels(talk.data["frame"])
        assert np.abs(before.astype(int) - after).mean() > 5


def test_several_clients_see_the_same(server: Server) -> None:
    with talking(server) as one, talking(server) as other:
        one.until("frame", scale=1.0, spp=4)
        other.until("frame", scale=1.0, spp=4)
        assert server.clients == 2
        one.send("show", exposure=2.0, layer="normal")
        other.until("state", exposure=2.0, layer="normal")
        other.send("hide", object=0, visible=False)
        seen = one.until("scene")
        assert [o["visible"] for o in seen["objects"]] == [False, True, True, True]
        assert [m["name"] for m in seen["materials"].values()] == [
            "ball",
            "floor",
            "lamp",
            "diffuse",
        ]


def test_of_changed_parameters_only_those_are_told(server: Server) -> None:
    with talking(server) as one, talking(server) as other:
        one.until("scene")
        other.until("scene")
        one.send("change", kind="lights", index=0, name="radiance", value=[1, 2, 3])
        told = other.until("values")
        assert told["materials"] == {}
        assert told["lights"]["0"]["params"][0]["value"] == [1.0, 2.0, 3.0]
        one.send("change", kind="materials", index=2, name="emission", value=[1, 2, 3])
        told = other.until("values")
        assert (list(told["materials"]), told["lights"]) == (["2"], {})
        one.send("restore")
        told = other.until("values")
        assert (list(told["materials"]), list(told["lights"])) == (["2"], ["0"])


def test_parameters_picking_and_saving(server: Server) -> None:
    with talking(server) as talk:
        talk.send("change", kind="materials", index=0, name="color", value=[0.1, 0.9, 0.1])
        talk.until("values")  # it is done: until then a picture of before may be the newest
        talk.send("pick", x=0.5, y=0.5, id=3)
        pick = talk.until("pick", id=3)
        assert (pick["object"], pick["material"], pick["material_index"]) == ("ball", "ball", 0)
        settled(server.session)
        talk.send("show", exposure=1.0)
        expected = server.session.image()
        assert expected.pixels[32, 48, 1] > 2 * expected.pixels[32, 48, 0]
        for ending, start in (("png", b"\x89PNG"), ("exr", b"\x76\x2f\x31\x01")):
            talk.send("save", format=ending, id=5)
            file = talk.until("file", id=5)
            assert file["name"].startswith("scene-")
            assert file["name"].endswith(f".{ending}")
            assert talk.data["file"].startswith(start)
            pixels = read_pixels(talk.data["file"])
            if ending == "png":
                assert np.array_equal(pixels, expected.srgb(exposure=1.0))
            else:
                assert np.array_equal(pixels, expected.pixels)


def test_one_file_at_a_time_is_saved(server: Server) -> None:
    with talking(server) as talk:
        talk.send("save", format="png", id=1)
        talk.send("save", format="png", id=2)
        assert "being saved" in talk.until("error", id=2)["text"]
        if "file" not in talk.newest:
            talk.until("file", id=1)
        talk.send("save", format="png", id=3)
        assert talk.until("file", id=3)


def test_a_client_that_takes_nothing_keeps_one_file_and_is_sent_away(
    session: Session, caplog: pytest.LogCaptureFixture
) -> None:
    """Without a network, whose buffers hold some more."""
    client = Client(session, Packer(session), lambda: None)
    save = '{"type": "save", "format": "exr"}'
    later = client.receive(save)
    assert later is not None
    later()
    for _ in range(3):
        assert client.receive(save) is None
    assert "has not been taken yet" in caplog.text
    header, data = client.take() or ({}, b"")
    assert (header["type"], len(data) > 1000) == ("file", True)
    assert client.receive(save) is not None  # taken: the next one may come
    for _ in range(2 * MOST_ANSWERS):
        client.receive('{"type": "pick", "x": 0.01, "y": 0.01}')
    assert client.over
    assert len(client._answers) == MOST_ANSWERS
    client.close()
    session._memory_limit = resident()
    client = Client(session, Packer(session), lambda: None)
    later = client.receive(save)
    assert later is not None
    later()
    assert "saving the picture takes" in (client.take() or ({}, b""))[0]["text"]
    client.close()


def test_the_scene_as_it_is_now_can_be_saved(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with talking(server) as talk:
        talk.send("change", kind="materials", index=0, name="color", value=[0.1, 0.2, 0.9])
        talk.until("values")
        talk.send("save", format="json", id=1)
        name = talk.until("file", id=1)["name"]
        assert name.endswith(".json")
        (tmp_path / name).write_bytes(talk.data["file"])
        assert ph.load(tmp_path / name).materials["ball"].params["color"] == (0.1, 0.2, 0.9)
        many = scene().replace(shapes=[ph.Spheres(np.eye(3).repeat(50, 0), 0.1, "ball")])
        server.session.replace(many).result(10)
        talk.send("save", format="json", id=2)
        file = talk.until("file", id=2)
        assert (file["mime"], file["name"][-4:]) == ("application/zip", ".zip")
        with zipfile.ZipFile(io.BytesIO(talk.data["file"])) as archive:
            archive.extractall(tmp_path)
            (document,) = (n for n in archive.namelist() if n.endswith(".json"))
        assert len(ph.load(tmp_path / document).shapes[0].centers) == 150
        monkeypatch.setattr(messages, "LARGEST_SCENE", 1 << 10)
        talk.send("save", format="json", id=3)
        assert "a page gets at most 0 MiB" in talk.until("error", id=3)["text"]


def test_nothing_more_is_rendered_while_nobody_looks(server: Server) -> None:
    server.session.limit(64)
    assert server.session.finished().spp < 64
    time.sleep(0.4)
    assert server.session.finished().spp < 64
    with talking(server) as talk:
        talk.until("frame", spp=64)


def test_a_client_that_takes_nothing_gets_no_more_and_holds_up_nobody(server: Server) -> None:
    with talking(server, acknowledges=False) as slow, talking(server) as quick:
        for k in range(40):
            camera = {**scene().camera.__dict__, "eye": [0.1 * k, 1, 4]}
            quick.send("look", camera=camera, stamp=k + 1)
            quick.until("frame", stamp=k + 1)
        assert quick.frames >= 40
        while True:
            try:
                slow.next(0.3)
            except TimeoutError:
                break
        assert slow.frames == UNSEEN
        slow.send("seen", frame=slow.newest["frame"]["number"])
        newest = slow.until("frame")
        assert newest["number"] >= quick.newest["frame"]["number"] - 1  # the newest wins


def test_a_client_that_reads_nothing_at_all_holds_up_nobody(server: Server) -> None:
    with socket.create_connection(("127.0.0.1", server.port)) as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        path = urlsplit(server.url).path
        deaf.sendall(
            f"GET {path}session HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        with talking(server) as quick:
            for k in range(20):
                quick.send("look", camera={"eye": [0.1 * k, 1, 4]}, stamp=k + 1)
                quick.until("frame", stamp=k + 1)
            assert server.clients == 2
    with talking(server) as quick:
        quick.until("frame")


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        ("", "Input data was truncated"),
        ("{", "Input data was truncated"),
        ("[1]", "Expected `object`"),
        (b"\xff\x00\x01", "JSON is malformed"),
        ('{"type": "format_disk"}', "Invalid value 'format_disk'"),
        ('{"type": "pause"}', "missing required field `paused`"),
        ('{"type": "pause", "paused": 1}', "Expected `bool`"),
        ('{"type": "pause", "paused": true, "more": 1}', "unknown field"),
        ('{"type": "size", "width": -4, "height": 3}', "width is -4"),
        ('{"type": "size", "width": 100000, "height": 100000}', "width is 100000"),
        ('{"type": "look", "camera": {"eye": [0, 1]}}', "Expected `array` of length 3"),
        ('{"type": "look", "camera": {"projection": "cubist"}}', "cubist"),
        ('{"type": "show", "layer": "z"}', "unknown layer 'z'"),
        ('{"type": "show", "exposure": 1e9}', "exposure is 1000000000.0"),
        ('{"type": "crop", "part": [0, 0, 2, 2]}', "share"),
        ('{"type": "pick", "x": 2, "y": 0}', "share"),
        ('{"type": "change", "kind": "materials", "index": 0, "name": "x", "value": 1}', "'x'"),
        ('{"type": "change", "kind": "materials", "index": -1, "name": "color", "value": 1}', "-1"),
        ('{"type": "save", "format": "exe"}', "Invalid enum value 'exe'"),
        ('{"type": "hide", "object": 99, "visible": false}', r"objects[99]"),
    ],
)
def test_messages_without_meaning_are_refused_logged_and_harmless(
    server: Server, caplog: pytest.LogCaptureFixture, raw: str | bytes, reason: str
) -> None:
    with caplog.at_level(logging.WARNING, "parhelion"), talking(server) as talk:
        talk.ws.send(raw)
        end = time.monotonic() + 10
        told = ""
        while reason not in told and time.monotonic() < end:
            if talk.next() == "error":
                told = talk.newest["error"]["text"]
        assert reason in told
        assert "refused" in caplog.text
        assert server.session.state()["error"] is None
        talk.send("look", camera={"eye": [0, 1, 5]}, stamp=1)
        assert talk.until("frame", stamp=1, scale=1.0, spp=4)


def test_a_client_of_too_many_or_too_long_messages_is_sent_away(server: Server) -> None:
    def sent_away(messages: list[str]) -> None:
        with talking(server) as talk:
            for message in messages:
                talk.ws.send(message)
            while True:
                talk.next()

    with pytest.raises(ConnectionClosed):
        sent_away(["[" * (LARGEST + 1)])
    with pytest.raises(ConnectionClosed):
        sent_away(["{}"] * (MOST_MISTAKES + 1))
    with talking(server) as talk:
        talk.until("frame")


def test_only_the_address_with_the_token_is_served(server: Server) -> None:
    status, headers, body = get(server)
    assert status == 200
    assert b"data-parhelion" in body
    assert "default-src 'none'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"
    for name in ("view.js", "view.css", "icon.svg"):
        status, headers, body = get(server, urlsplit(server.url).path + name)
        assert (status, len(body) > 100) == (200, True)
    for path in ("/", "/wrong/", f"/{server.token[:-1]}/", f"/{server.token}x/", "/wrong/view.js"):
        assert get(server, path)[0] == 404
    for name in ("session.py", "../session.py", "%2e%2e/session.py", "../../../etc/passwd"):
        assert get(server, urlsplit(server.url).path + name)[0] == 404
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{server.port}/{'x' * 24}/session")


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "10.0.0.1", "", "[::2]"]
)
def test_other_hosts_are_refused(server: Server, host: str) -> None:
    """As of a site whose name was bound to this machine's address (DNS rebinding)."""
    assert get(server, headers={"Host": host})[0] == 404
    raw = socket.create_connection(("127.0.0.1", server.port))
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://{host or 'x'}/{server.token}/session", sock=raw)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "http://127.0.0.1:1", "null", "http://localhost", "https://x"]
)
def test_other_origins_are_refused(server: Server, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"{server.url.replace('http', 'ws')}session", origin=origin)
    assert get(server, headers={"Origin": origin})[0] == 404


def test_its_own_origin_is_welcome_by_any_local_name(server: Server) -> None:
    for name in ("127.0.0.1", "localhost"):
        here = f"{name}:{server.port}"
        assert get(server, headers={"Host": here, "Origin": f"http://{here}"})[0] == 200
        url = f"ws://{here}/{server.token}/session"
        raw = socket.create_connection(("127.0.0.1", server.port))
        with connect(url, origin=f"http://{here}", sock=raw) as ws:
            assert isinstance(ws.recv(10), bytes)


def test_tokens_are_long_and_never_the_same() -> None:
    with Session(scene(), spp=1) as session, Server(session) as a, Server(session) as b:
        assert a.token != b.token
        assert len(a.token) >= 22  # 128 bits
        with pytest.raises(ph.ResourceError, match=f"port {a.port}: cannot listen"):
            Server(session, port=a.port)
    with Session(scene(), spp=1) as session, pytest.raises(ph.ResourceError, match="cannot listen"):
        Server(session, host="no.such.host.invalid")


def test_other_machines_may_come_where_the_user_says_so() -> None:
    with Session(scene(), spp=1) as session, Server(session, host="0.0.0.0") as server:
        assert get(server, headers={"Host": f"192.168.7.7:{server.port}"})[0] == 200
        assert get(server, headers={"Host": "evil.example"})[0] == 404


def test_the_command_serves_until_ctrl_c(tmp_path: Path) -> None:
    file = tmp_path / "water.xyz"
    file.write_text("3\nwater\nO 0 0 0.1\nH 0 0.76 -0.47\nH 0 -0.76 -0.47\n")
    command = [sys.executable, "-m", "parhelion", "view", "--no-browser", "--spp", "1", str(file)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url.startswith("http://127.0.0.1:")
        with connect(f"{url.replace('http', 'ws')}session", max_size=None) as ws:
            assert isinstance(ws.recv(10), bytes)
            process.send_signal(signal.SIGINT)
            start = time.monotonic()
            assert process.wait(10) == 0
        assert time.monotonic() - start < 3
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()


def test_ctrl_c_while_a_file_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "one.xyz"
    file.write_text("1\n\nO 0 0 0\n")
    code = (
        "import sys, time, numpy as np, parhelion as ph\n"
        "from parhelion.cli import main, options\n"
        "load, times = options.load_scene, []\n"
        "def slow(args):\n"
        "    times.append(1)\n"
        "    if len(times) > 1:\n"
        "        print('reading', flush=True)\n"
        "        end = time.monotonic() + 20\n"
        "        while time.monotonic() < end:\n"
        "            ph.prepare(ph.Scene([ph.Spheres(np.random.rand(100_000, 3), 0.01)]))\n"
        "    return load(args)\n"
        "options.load_scene = slow\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command = [sys.executable, "-c", code, "view", "--no-browser", "--quiet", str(file)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith("http")
        file.write_text("2\n\nO 0 0 0\nO 0 0 3\n")
        assert process.stdout.readline() == "reading\n"
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
        assert process.stderr.read() == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no.xyz"], "no.xyz: no such file"),
        (["--port", "70000"], "port is 70000; must lie in [0, 65535]"),
        (["--spp", "0"], "--spp is 0"),
        (["--sampler", "x"], "unknown sampler 'x'"),
        (["--memory-limit", "much"], "--memory-limit is 'much'; must be a number of bytes"),
        (["--memory-limit", "200M", "--width", "3840"], "are left of --memory-limit"),
    ],
)
def test_mistakes_of_the_command(words: list[str], message: str) -> None:
    command = [sys.executable, "-m", "parhelion", "view", "--no-browser", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="of Linux")
def test_too_little_address_space_is_an_error_and_no_signal() -> None:
    command = [sys.executable, "-m", "parhelion", "view", "--no-browser"]
    shell = f"ulimit -v 1500000; exec {shlex.join(command)} --width 3840 --height 2160"
    shell = f"export OPENBLAS_NUM_THREADS=1; {shell}"  # NumPy's own would take as much on 64 cores
    done = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, timeout=30)
    assert done.returncode == 2
    assert "not enough memory: looking at 3840x2160 pixels takes 1." in done.stderr
    assert "address space" in done.stderr


def test_what_looks_at_nothing_imports_no_server() -> None:
    code = (
        "import sys, parhelion, parhelion.cli; parhelion.cli.parser(); parhelion.render;"
        "print({'starlette', 'uvicorn', 'websockets', 'anywidget'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
