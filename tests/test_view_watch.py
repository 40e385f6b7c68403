"""Scenes that are read again when their files change."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import parhelion as ph
from parhelion.image import encoded
from parhelion.view import watch
from parhelion.view.session import Session
from parhelion.view.watch import Watch, recorded
from test_view_session import settled


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch, "POLL", 0.02)


def wait_for(true: Callable[[], object]) -> None:
    end = time.monotonic() + 10
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def write(file: Path, red: float, image: str | None = None) -> None:
    color: object = {"type": "image", "image": image} if image else [red, 0.1, 0.1]
    file.write_text(
        json.dumps(
            {
                "parhelion": 1,
                "camera": {"eye": [0, 0, 3], "target": [0, 0, 0]},
                "shapes": [{"type": "spheres", "centers": [[0, 0, 0]], "material": "ball"}],
                "materials": {"ball": {"type": "diffuse", "color": color}},
                "settings": {"width": 24, "height": 16},
            }
        )
    )


@contextmanager
def watched(file: Path) -> Iterator[Session]:
    def load() -> ph.Scene:
        return ph.load(file)

    scene, files = recorded(load)
    with Session(scene, spp=1) as session, Watch(session, load, files):
        settled(session, 1)
        yield session


def middle(session: Session) -> list[float]:
    pixels = settled(session, 1).pixels
    height, width = pixels.shape[:2]
    return [float(x) for x in pixels[height // 2, width // 2]]


def test_a_changed_file_is_shown_and_a_broken_one_told(tmp_path: Path) -> None:
    file = tmp_path / "ball.json"
    write(file, 0.9)
    with watched(file) as session:
        before = middle(session)
        write(file, 0.2)
        wait_for(lambda: middle(session)[0] < 0.5 * before[0])
        frame = session.frame
        file.write_text("{")
        wait_for(lambda: session.state()["error"])
        assert "ball.json" in session.state()["error"]
        assert session.frame is frame  # the old picture stays
        file.unlink()
        wait_for(lambda: "no such file" in (session.state()["error"] or ""))
        write(file, 0.9)
        wait_for(lambda: middle(session) == before)
        assert session.state()["error"] is None


def test_its_pictures_are_watched_too(tmp_path: Path) -> None:
    picture = tmp_path / "wood.png"

    def paint(blue: int) -> None:
        picture.write_bytes(encoded(np.full((4, 4, 3), (10, 10, blue), np.uint8), {}, ".png"))

    paint(10)
    file = tmp_path / "ball.json"
    write(file, 0.0, "wood.png")
    with watched(file) as session:
        before = middle(session)
        paint(250)
        wait_for(lambda: middle(session)[2] > 4 * before[2])


def test_layers_and_references_of_usd_are_watched(tmp_path: Path) -> None:
    pytest.importorskip("pxr")

    def ball(color: str) -> str:
        return (
            '#usda 1.0\n(defaultPrim = "ball")\ndef Sphere "ball" {\n double radius = 1\n'
            f" color3f[] primvars:displayColor = [({color})]\n}}\n"
        )

    def thin(width: float) -> str:
        return (
            '#usda 1.0\nover "world" {\n uniform token[] xformOpOrder = ["xformOp:scale"]\n'
            f" double3 xformOp:scale = ({width}, {width}, 1)\n}}\n"
        )

    (tmp_path / "ball.usda").write_text(ball("0.9, 0.1, 0.1"))
    (tmp_path / "layer.usda").write_text(thin(1.0))
    file = tmp_path / "all.usda"
    file.write_text(
        '#usda 1.0\n(subLayers = [@layer.usda@])\ndef "world" (references = @ball.usda@) {\n}\n'
    )
    with watched(file) as session:
        before = middle(session)
        (tmp_path / "ball.usda").write_text(ball("0.1, 0.1, 0.9"))
        wait_for(lambda: middle(session)[2] > 4 * before[2])
        eye = session.camera.eye
        (tmp_path / "layer.usda").write_text(thin(3.0))
        wait_for(lambda: session.camera.eye != eye)  # further away from what is wider


def test_which_files_a_scene_is_made_of(tmp_path: Path) -> None:
    (tmp_path / "ball.mtl").write_text("newmtl red\nKd 1 0 0\n")
    file = tmp_path / "ball.obj"
    file.write_text("mtllib ball.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    _, files = recorded(lambda: ph.load(file))
    assert files == {file, tmp_path / "ball.mtl"}
    other = tmp_path / "other.txt"
    other.write_text("not the scene's")
    other.read_text()
    assert other not in files
