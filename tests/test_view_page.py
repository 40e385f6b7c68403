"""The page of `parhelion view`, driven in a real browser."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion.image import read_pixels
from parhelion.view.server import Server
from parhelion.view.session import Session
from test_view_session import scene, settled

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SECONDS = 20.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    path = os.environ.get("PARHELION_CHROMIUM") or next(
        filter(None, map(shutil.which, NAMES)), None
    )
    if path is None:
        pytest.skip("there is no Chromium")
    with playwright.sync_playwright() as p:
        launched = p.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield launched
        launched.close()


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(scene(), spp=4) as s:
        yield s


@pytest.fixture
def server(session: Session) -> Iterator[Server]:
    with Server(session) as s:
        yield s


@pytest.fixture
def page(browser: Any, server: Server) -> Iterator[Any]:
    """The page of the session, in which no error may occur."""
    yield from opened(browser, server, viewport={"width": 900, "height": 600})


def opened(browser: Any, server: Server, **options: Any) -> Iterator[Any]:
    context = browser.new_context(accept_downloads=True, **options)
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    made = context.new_page()
    errors: list[str] = []
    made.on("pageerror", lambda error: errors.append(str(error)))
    made.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    made.goto(server.url)
    made.wait_for_selector('body[data-scale="1"][data-spp="4"]')
    # the first picture has the scene's size; the page asks for its own, which may come much later
    canvas = made.locator("canvas")
    wait_for(
        lambda: abs(canvas.bounding_box()["width"] - server.session.state()["width"]) <= 1,
        "a picture that fits",
    )
    yield made
    context.close()
    # a connection that a test cuts is told by the browser
    assert [e for e in errors if "WebSocket" not in e] == []


def wait_for(true: Callable[[], Any], what: str) -> None:
    end = time.monotonic() + SECONDS
    while not true():
        assert time.monotonic() < end, f"{what}: not after {SECONDS} s"
        time.sleep(0.01)


def shown(page: Any) -> np.ndarray:
    """The pixels of the canvas, (H, W, 3) of 0 to 255."""
    url = page.evaluate("() => document.querySelector('canvas').toDataURL('image/png')")
    return read_pixels(base64.b64decode(url.partition(",")[2]))[:, :, :3].astype(int)


def is_finished(page: Any, session: Session) -> None:
    """Waits until the page shows the session's last picture of what was asked for last."""
    frame = settled(session)
    wait_for(
        lambda: page.evaluate("() => +document.body.dataset.frame") >= frame.number, "the picture"
    )


def middle(page: Any) -> tuple[float, float]:
    box = page.locator("canvas").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_the_picture_appears_as_rendered_and_fits(page: Any, session: Session) -> None:
    is_finished(page, session)
    state = session.state()
    assert state["width"] / state["height"] == pytest.approx(1.5, abs=0.01)  # as the scene says
    box = page.locator("canvas").bounding_box()
    assert abs(box["width"] - state["width"]) <= 1
    seen = shown(page)
    expected = session.image().srgb()
    assert seen.shape == expected.shape
    assert np.abs(seen - expected.astype(int)).mean() < 4  # a JPEG
    assert page.title() == "scene - Parhelion"
    assert "4 of 4 spp" in page.locator("footer").inner_text()
    assert "Done" in page.locator("footer").inner_text()


def test_mouse_turns_moves_and_comes_nearer(page: Any, session: Session) -> None:
    is_finished(page, session)
    before, first = shown(page), session.camera
    x, y = middle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y - 20, steps=4)
    page.mouse.up()
    wait_for(lambda: session.camera.eye != first.eye, "a turn")
    wait_for(lambda: page.evaluate("() => +document.body.dataset.spp") == 4, "a picture")
    is_finished(page, session)
    turned = session.camera
    assert turned.target == first.target
    distance = np.linalg.norm(np.subtract(first.eye, first.target))
    assert np.linalg.norm(np.subtract(turned.eye, turned.target)) == pytest.approx(distance)
    assert turned.eye[0] < 0  # what is dragged to the right is seen from farther left
    assert np.abs(shown(page) - before).mean() > 5
    page.keyboard.down("Shift")
    page.mouse.down()
    page.mouse.move(x, y, steps=3)
    page.mouse.up()
    page.keyboard.up("Shift")
    wait_for(lambda: session.camera.target != first.target, "a move")
    moved = session.camera
    assert np.allclose(np.subtract(moved.eye, turned.eye), np.subtract(moved.target, turned.target))
    page.mouse.wheel(0, -200)
    nearer = 0.99 * distance
    wait_for(
        lambda: np.linalg.norm(np.subtract(session.camera.eye, session.camera.target)) < nearer,
        "coming nearer",
    )
    page.get_by_role("button", name="First camera (H)").click()
    wait_for(lambda: session.camera == first, "the first camera")


def test_keys(page: Any, session: Session) -> None:
    is_finished(page, session)
    first = session.camera
    stage = page.get_by_role("application")
    stage.press("ArrowLeft")
    wait_for(lambda: session.camera.eye != first.eye, "a turn")
    stage.press("]")
    wait_for(lambda: (session.camera.vfov or 40) > 41, "a wider view")
    stage.press("w")
    wait_for(lambda: session.camera.target != first.target, "a walk")
    stage.press("Space")
    wait_for(lambda: session.state()["paused"], "a pause")
    page.get_by_role("button", name="Go on (Space)").wait_for()
    stage.press("Space")
    wait_for(lambda: not session.state()["paused"], "going on")
    stage.press(".")
    wait_for(lambda: session.state()["exposure"] == 0.25, "a brighter picture")
    stage.press("l")
    wait_for(lambda: session.state()["layer"] == "direct", "another layer")
    stage.press("?")
    page.get_by_role("dialog", name="Keys and gestures").wait_for()
    page.keyboard.press("Escape")
    stage.press("p")
    wait_for(
        lambda: "ph.Camera(" in page.evaluate("() => navigator.clipboard.readText()"), "a copy"
    )
    copied = page.evaluate("() => navigator.clipboard.readText()")
    assert eval(copied, {"ph": ph}) == session.camera
    stage.press("j")
    wait_for(lambda: "{" in page.evaluate("() => navigator.clipboard.readText()"), "a copy")
    copied = json.loads(page.evaluate("() => navigator.clipboard.readText()"))
    assert copied["camera"]["eye"] == list(session.camera.eye)


def test_sliders_and_lists_act(page: Any, session: Session) -> None:
    is_finished(page, session)
    before = shown(page)
    page.get_by_label("Exposure", exact=True).fill("2")
    wait_for(lambda: session.state()["exposure"] == 2.0, "the exposure")
    wait_for(lambda: shown(page).mean() > 1.2 * before.mean(), "a brighter picture")
    page.get_by_label("Exposure, number").fill("0")
    page.keyboard.press("Enter")
    wait_for(lambda: session.state()["exposure"] == 0.0, "the exposure")
    page.get_by_label("Material", exact=True).select_option(label="ball  (diffuse)")
    page.get_by_label("Color", exact=True).fill("#2040ff")
    wait_for(
        lambda: session.outline()["materials"][0]["params"][0]["value"][2] == 1.0, "the colour"
    )
    is_finished(page, session)
    height, width = before.shape[:2]
    wait_for(lambda: (lambda c: c[2] > c[0])(shown(page)[height // 2, width // 2]), "a blue ball")
    page.get_by_label("Opacity", exact=True).fill("0.5")
    wait_for(lambda: session.outline()["materials"][0]["params"][-1]["value"] == 0.5, "a hole")
    page.get_by_text("Lights", exact=True).click()
    page.get_by_label("Radiance, strength", exact=True).fill("0.3")
    wait_for(
        lambda: session.outline()["lights"][0]["params"][0]["value"][0] == pytest.approx(2.0, 0.01),
        "light",
    )
    page.get_by_role("button", name="Restore materials and lights").click()
    wait_for(
        lambda: session.outline()["lights"][0]["params"][0]["value"] == [0.5, 0.5, 0.5], "as given"
    )
    wait_for(lambda: page.get_by_label("Opacity", exact=True).input_value() == "1", "the slider")
    page.get_by_label("Layer").select_option("normal")
    wait_for(lambda: session.state()["layer"] == "normal", "the layer")
    is_finished(page, session)
    page.get_by_role("button", name="Hide ball", exact=True).click()
    page.get_by_role("button", name="Show ball", exact=True).wait_for()
    assert not session.outline()["objects"][0]["visible"]


def test_fields_and_keys_that_are_left_half_done(page: Any, session: Session) -> None:
    is_finished(page, session)
    # hidden one after the other, before the page has heard of the first
    page.evaluate(
        """() => document.querySelectorAll('.ph-eye')
          .forEach((eye, i) => i % 2 === 0 && eye.click())"""
    )
    wait_for(
        lambda: [o["visible"] for o in session.outline()["objects"]] == [False, True, False, True],
        "both are hidden",
    )
    is_finished(page, session)
    before = session.camera.vfov
    page.locator("summary", has_text="Camera").click()
    field = page.get_by_label("Field of view, number")
    shown = field.input_value()
    field.fill("")
    field.press("Tab")
    assert field.input_value() == shown
    number = page.get_by_label("Opacity, number")
    number.fill("7")
    number.press("Tab")
    page.locator(".ph-toast").get_by_text("must lie in [0, 1]").wait_for()
    wait_for(lambda: page.get_by_label("Opacity, number").input_value() == "1", "what it still is")
    slider = page.get_by_label("Exposure", exact=True)
    slider.focus()
    page.keyboard.press("Space")
    wait_for(lambda: session.state()["paused"], "a pause")
    page.keyboard.press("ArrowRight")
    wait_for(lambda: session.state()["exposure"] > 0, "the slider")
    page.keyboard.press("?")
    page.get_by_role("dialog").wait_for()
    page.keyboard.press("Escape")
    page.keyboard.press("L")  # as with Caps Lock: without Shift
    wait_for(lambda: session.state()["layer"] == "direct", "the next layer")
    assert session.camera.vfov == before


def test_what_is_under_the_pointer(page: Any, session: Session) -> None:
    is_finished(page, session)
    x, y = middle(page)
    page.mouse.move(x, y)
    page.locator(".ph-tip").get_by_text("ball (diffuse)").wait_for()
    page.mouse.click(x, y)
    page.locator(".ph-card").get_by_text("ball (diffuse)").wait_for()
    assert page.get_by_label("Material", exact=True).input_value() == "0"
    page.get_by_role("button", name="Focus on a place (F)").click()
    page.mouse.click(x, y)
    wait_for(lambda: session.camera.focus_distance is not None, "a focus")
    assert session.camera.focus_distance == pytest.approx(3.53, abs=0.1)
    page.get_by_role("button", name="Render a part only (C)").click()
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 0.9 * box["height"], steps=3)
    page.mouse.up()
    wait_for(lambda: session.state()["crop"] is not None, "a part")
    assert session.state()["crop"] == pytest.approx((0.25, 0.5, 0.5, 0.4), abs=0.02)
    page.get_by_role("button", name="Render all").click()
    wait_for(lambda: session.state()["crop"] is None, "all")


@pytest.mark.parametrize(("item", "ending"), [("PNG, as shown", "png"), ("EXR", "exr")])
def test_saving_gives_the_picture(
    page: Any, session: Session, tmp_path: Path, item: str, ending: str
) -> None:
    is_finished(page, session)
    page.get_by_role("button", name="Save the picture").click()
    with page.expect_download() as download:
        page.get_by_role("menuitem", name=re.compile(item)).click()
    file = tmp_path / download.value.suggested_filename
    download.value.save_as(file)
    assert file.suffix == f".{ending}"
    image = session.image()
    expected = image.srgb() if ending == "png" else image.pixels
    assert np.array_equal(read_pixels(str(file)), expected)


def test_saving_gives_the_scene_as_it_is_now(page: Any, session: Session, tmp_path: Path) -> None:
    is_finished(page, session)
    page.get_by_role("application").press("ArrowLeft")
    wait_for(lambda: session.camera.eye != scene().camera.eye, "a turn")
    page.get_by_role("button", name="Save the picture").click()
    with page.expect_download() as download:
        page.get_by_role("menuitem", name="JSON, the scene").click()
    file = tmp_path / download.value.suggested_filename
    download.value.save_as(file)
    assert ph.load(file).camera == session.camera


def test_reloading_and_a_server_that_comes_back(
    page: Any, session: Session, server: Server
) -> None:
    session.look(ph.Camera((2, 1, 4), (0, 0.5, 0)))
    page.reload()
    page.wait_for_selector('body[data-scale="1"][data-spp="4"]')
    is_finished(page, session)
    assert session.camera.eye == (2, 1, 4)  # the session's, not the page's
    server.close()
    page.get_by_text("Connection lost").wait_for()
    with Server(session, port=server.port) as again:
        again.token = server.token
        page.get_by_text("Connection lost").wait_for(state="hidden")
        page.get_by_role("application").press("ArrowLeft")
        wait_for(lambda: session.camera.eye != (2, 1, 4), "a turn")
        is_finished(page, session)


def test_two_pages_turn_one_camera(
    browser: Any, server: Server, page: Any, session: Session
) -> None:
    is_finished(page, session)
    for other in opened(browser, server, viewport={"width": 600, "height": 400}):
        is_finished(other, session)
        for turned, key in ((page, "ArrowLeft"), (other, "ArrowUp"), (page, "ArrowRight")):
            before = np.subtract(session.camera.eye, session.camera.target)
            turned.get_by_role("application").press(key)
            wait_for(lambda before=before: not np.allclose(_away(session), before), "a turn")
            is_finished(page, session)
            is_finished(other, session)
        assert np.arctan2(*_away(session)[[0, 2]]) == pytest.approx(0.0, abs=1e-6)  # and back
        assert _away(session)[1] > 0.6  # where the second page has brought it


def _away(session: Session) -> np.ndarray:
    return np.subtract(session.camera.eye, session.camera.target)


def test_on_a_phone(browser: Any, server: Server, session: Session) -> None:
    sizes = {"viewport": {"width": 360, "height": 640}, "has_touch": True, "is_mobile": True}
    for page in opened(browser, server, **sizes):
        is_finished(page, session)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 360
        for b in page.get_by_role("button").all():
            box = b.bounding_box()
            if box is not None:
                assert box["x"] >= 0
                assert box["x"] + box["width"] <= 360
        assert page.locator("canvas").bounding_box()["width"] > 300
        x, y = middle(page)
        page.touchscreen.tap(x, y)
        page.locator(".ph-card").get_by_text("ball (diffuse)").wait_for()
        first = session.camera
        touch = page.context.new_cdp_session(page)

        def fingers(kind: str, *places: tuple[float, float], touch: Any = touch) -> None:
            points = [{"x": px, "y": py, "id": i} for i, (px, py) in enumerate(places)]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        fingers("touchStart", (x, y))
        fingers("touchMove", (x + 30, y))
        fingers("touchMove", (x + 60, y))
        fingers("touchEnd")
        wait_for(lambda first=first: session.camera.eye[0] < first.eye[0] - 0.1, "a turn")
        before = np.linalg.norm(np.subtract(session.camera.eye, session.camera.target))
        fingers("touchStart", (x - 20, y), (x + 20, y))
        fingers("touchMove", (x - 40, y), (x + 40, y))
        fingers("touchMove", (x - 60, y), (x + 60, y))
        fingers("touchEnd")
        wait_for(
            lambda before=before: (
                np.linalg.norm(np.subtract(session.camera.eye, session.camera.target))
                < 0.7 * before
            ),
            "a pinch",
        )


def test_everything_that_can_be_used_has_a_name(page: Any) -> None:
    nameless = page.evaluate(
        "() => [...document.querySelectorAll('button, input, select, [role]')]"
        ".filter(e => !e.closest('[hidden], [aria-hidden=true]'))"
        ".filter(e => !(e.getAttribute('aria-label') || e.labels?.length || e.textContent.trim()))"
        ".filter(e => !['status', 'alert', 'menu'].includes(e.getAttribute('role')))"
        ".map(e => e.outerHTML.slice(0, 120))"
    )
    assert nameless == []
    assert page.get_by_role("application").count() == 1


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_light_and_dark(browser: Any, server: Server, scheme: str) -> None:
    for page in opened(browser, server, color_scheme=scheme):
        color = "() => getComputedStyle(document.querySelector('header')).backgroundColor"
        numbers = [int(n) for n in re.findall(r"\d+", page.evaluate(color))[:3]]
        assert (sum(numbers) > 384) == (scheme == "light")
        page.get_by_role("button", name="Light or dark").click()
        numbers = [int(n) for n in re.findall(r"\d+", page.evaluate(color))[:3]]
        assert (sum(numbers) > 384) == (scheme == "dark")


def test_errors_are_shown_and_the_picture_stays(page: Any, session: Session) -> None:
    is_finished(page, session)
    before = shown(page)
    session.report("water.xyz:3: two numbers are missing")
    page.get_by_role("alert").get_by_text("two numbers are missing").wait_for()
    assert np.array_equal(shown(page), before)
    session.report(None)
    page.get_by_role("alert").get_by_text("two numbers are missing").wait_for(state="hidden")
