"""The widget of notebooks: in a kernel, and its module in a real browser."""

from __future__ import annotations

import base64
import gc
import json
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.image import read_pixels
from parhelion.view.server import PAGE
from test_view_page import browser  # noqa: F401
from test_view_session import scene, settled

pytest.importorskip("anywidget", reason="anywidget is not installed")

from parhelion.view.notebook import Viewer


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    made = scene().view(spp=4, height=400)
    made.sent = []
    made.send = lambda header, buffers: made.sent.append((header, buffers))
    yield made
    made.close()


def wait_for(true: Callable[[], Any], meanwhile: Callable[[], None] = lambda: None) -> Any:
    end = time.monotonic() + 20
    while not (value := true()):
        assert time.monotonic() < end
        meanwhile()
        time.sleep(0.01)
    return value


def hear(viewer: Viewer, type: str, **message: Any) -> None:
    viewer._handle_custom_msg({"type": type, **message}, [])


def test_a_cell_is_told_everything_and_changes_it(viewer: Viewer) -> None:
    session = viewer.session
    time.sleep(0.2)
    assert viewer.sent == []  # nobody looks yet
    hear(viewer, "hello")
    frames = wait_for(lambda: [m for m in viewer.sent if m[0]["type"] == "frame"])
    assert {m[0]["type"] for m in viewer.sent} >= {"state", "scene", "frame"}
    header, (data,) = frames[0]
    assert read_pixels(bytes(data)).shape == (header["place"][3], header["place"][2], 3)
    json.dumps([m[0] for m in viewer.sent])  # as the kernel sends it
    hear(viewer, "look", camera={"eye": [2, 1, 4]}, stamp=1)
    assert session.camera.eye == (2, 1, 4)
    hear(viewer, "pick", x=0.5, y=0.5, id=8)
    wait_for(lambda: [m for m in viewer.sent if m[0].get("id") == 8])
    hear(viewer, "nonsense")
    wait_for(lambda: [m for m in viewer.sent if m[0]["type"] == "error"])
    settled(session)
    hear(viewer, "goodbye")
    session.limit(64)
    time.sleep(0.3)
    assert session.frame.spp == 4  # nobody looks any more
    assert np.array_equal(session.image().pixels, session.frame.pixels)


def test_the_module_in_a_browser(viewer: Viewer, browser: Any) -> None:  # noqa: F811
    """What anywidget does: the module's render(), with a model that carries messages."""
    context = browser.new_context(viewport={"width": 900, "height": 600})
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    html = """<!doctype html><link rel="stylesheet" href="view.css"><div id="cell"></div>
      <script type="module">
        import widget from "./view.js";
        const listeners = [];
        const model = {
          on: (name, f) => listeners.push(f),
          off: (name, f) => listeners.splice(listeners.indexOf(f), 1),
          get: (name) => ({ height: 400 })[name],
          send: (message) => hear(message),
        };
        window.tell = ([header, data]) => {
          const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
          for (const f of listeners) f(header, data ? [new DataView(bytes.buffer)] : []);
        };
        window.end = widget.render({ model, el: document.querySelector("#cell") });
      </script>"""

    def serve(route: Any) -> None:
        name = route.request.url.rpartition("/")[2]
        if name:
            route.fulfill(path=PAGE / name)
        else:
            route.fulfill(body=html, content_type="text/html")

    page.route("http://cell.test/*", serve)
    page.expose_function("hear", lambda message: viewer._handle_custom_msg(message, []))
    page.goto("http://cell.test/")

    def carry() -> None:
        while viewer.sent:
            header, buffers = viewer.sent.pop(0)
            data = base64.b64encode(bytes(buffers[0])).decode() if buffers else ""
            page.evaluate("(message) => tell(message)", [header, data])
        page.wait_for_timeout(20)

    wait_for(lambda: page.locator(".parhelion[data-spp='4'][data-scale='1']").count(), carry)
    box = page.locator(".parhelion").bounding_box()
    assert box["height"] == 400
    before = viewer.session.camera
    page.get_by_role("application").press("ArrowLeft")
    wait_for(lambda: viewer.session.camera.eye != before.eye, carry)
    page.evaluate("() => end()")
    wait_for(lambda: viewer._cells == 0, carry)
    assert page.locator(".parhelion canvas").count() == 0
    context.close()
    assert errors == []


def test_a_notebook_runs(tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    cells = [
        "import parhelion as ph\n"
        "scene = ph.Scene([ph.Spheres([[0, 0, 0]])], settings=ph.Settings(width=48, height=32))\n"
        "viewer = scene.view(spp=2, max_depth=3)\n"
        "viewer",
        "viewer.session.image()",
        "ph.render(scene, spp=1)",
        "viewer.close()",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(c) for c in cells])
    client = nbclient.NotebookClient(
        notebook, timeout=60, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    shown = [cell.outputs[0]["data"] for cell in notebook.cells[:3]]
    assert "application/vnd.jupyter.widget-view+json" in shown[0]
    for picture in shown[1:]:
        pixels = read_pixels(base64.b64decode(picture["image/png"]))
        assert pixels.shape == (32, 48, 3)
        assert pixels.std() > 5


def test_python_ends_while_a_session_renders() -> None:
    code = (
        "import parhelion as ph, time\n"
        "from parhelion.view.session import Session\n"
        "session = Session(ph.weekend(), width=1600, height=900)\n"
        "time.sleep(0.5)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (0, "")


def test_python_ends_while_a_viewer_is_open() -> None:
    """No thread is within a library, and nothing of the core is left for nanobind to tell of."""
    code = (
        "import parhelion as ph, time\n"
        "viewer = ph.weekend().view(width=320, height=200)\n"
        "viewer._handle_custom_msg({'type': 'hello'}, [])\n"
        "time.sleep(0.5)\n"
        "viewer._handle_custom_msg({'type': 'save', 'format': 'exr'}, [])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    said = [line for line in done.stderr.splitlines() if "view: refused" not in line]  # the file
    assert (done.returncode, done.stdout, said) == (0, "", [])


@pytest.mark.parametrize("ends", ["close", "comm"])
def test_a_viewer_that_is_closed_ends_its_session(ends: str) -> None:
    viewer = scene().view(spp=2**20)
    hear(viewer, "hello")
    if ends == "close":
        viewer.close()
    else:  # as when the front end closes the widget
        viewer.comm.handle_close({})
    assert not viewer.session._thread.is_alive()
    assert not any(thread.is_alive() for thread in viewer._threads)
    hear(viewer, "pick", x=0.5, y=0.5)  # one that was on its way
    viewer.close()
    session = weakref.ref(viewer.session)
    del viewer
    gc.collect()
    assert session() is None


def test_settings_of_a_view_are_checked() -> None:
    before = threading.active_count()
    with pytest.raises(ph.SceneError, match="max_depht"):
        scene().view(max_depht=3)
    with pytest.raises(ph.SceneError, match="height is 'x'"):
        scene().view(height="x")
    with pytest.raises(ph.ResourceError, match="memory_limit"):
        scene().view(memory_limit="1M")
    assert threading.active_count() == before
