"""The session that renders what is looked at, without any network."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import parhelion as ph
from parhelion import memory, renderer, sharing
from parhelion.view import drawing, stage
from parhelion.view import session as views
from parhelion.view.drawing import Frame
from parhelion.view.layers import LAYERS
from parhelion.view.session import Session, resident
from test_memory import LINUX, child
from test_reuse import room

WHITE = ph.Material("diffuse", color=(0.8, 0.8, 0.8))


def scene() -> ph.Scene:
    """Two balls on a floor under an even sky and a lamp."""
    return ph.Scene(
        [
            ph.Spheres([[0, 0.5, 0]], 0.5, "ball", name="ball"),
            ph.Spheres([[1.2, 0.3, 0]], 0.3, WHITE, name="small ball"),
            ph.Spheres([[0, -100, 0]], 100, "floor", name="floor"),
            ph.Spheres([[0, 4, 0]], 0.4, "lamp", name="lamp"),
        ],
        {
            "ball": ph.Material("diffuse", color=(0.9, 0.1, 0.1)),
            "floor": ph.Material("diffuse", color=(0.5, 0.5, 0.5)),
            "lamp": ph.Material("diffuse", emission=(5.0, 5.0, 5.0)),
        },
        camera=ph.Camera((0, 1, 4), (0, 0.5, 0)),
        background=ph.Background("constant", radiance=(0.5, 0.5, 0.5)),
        settings=ph.Settings(width=96, height=64, max_depth=4),
    )


@pytest.fixture
def session() -> Iterator[Session]:
    with Session(scene(), spp=4) as s:
        yield s


def settled(session: Session, spp: int = 4, seconds: float = 20.0) -> Frame:
    """The newest picture once it has so many samples and answers what was asked for last."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        frame = session.frame
        if (
            frame is not None
            and frame.revision == session._request.revision
            and frame.scale == 1.0
            and frame.spp >= spp
        ):
            return frame
        time.sleep(0.005)
    raise AssertionError(f"no picture of {spp} samples after {seconds} s")


def test_the_picture_is_that_of_render(session: Session) -> None:
    frame = settled(session)
    assert np.array_equal(frame.pixels, ph.render(scene(), spp=4).pixels)
    assert np.array_equal(session.image().pixels, frame.pixels)
    assert session.image().stats.complete


def test_a_coarse_picture_comes_first_and_the_newest_camera_last(session: Session) -> None:
    settled(session)
    seen: list[Frame] = []
    session.subscribe(lambda event: seen.append(session.frame) if event == "frame" else None)
    with session._condition:  # it begins when the last one is there, and has not been quicker
        session._rate = 5000.0  # so slow that not all pixels can come first
        for x in range(5):
            session.look(ph.Camera((x, 1, 4), (0, 0.5, 0)))
    frame = settled(session)
    assert frame.camera.eye[0] == 4
    mine = [f for f in seen if f.revision == frame.revision]
    assert mine[0].scale < 0.5
    assert mine[0].pixels.shape[0] < 32
    assert [f.scale for f in mine] == sorted(f.scale for f in mine)


def test_crop_and_size(session: Session) -> None:
    session.crop((0.5, 0.25, 0.25, 0.5))
    frame = settled(session)
    assert (frame.x, frame.y, frame.pixels.shape) == (48, 16, (32, 24, 3))
    whole = ph.render(scene(), spp=4).pixels
    assert np.array_equal(frame.pixels, whole[16:48, 48:72])
    session.crop(None)
    session.resize(30, 20)
    assert settled(session).pixels.shape == (20, 30, 3)
    with pytest.raises(ph.SceneError, match="width is 0"):
        session.resize(0, 20)
    with pytest.raises(ph.SceneError, match="too large"):
        session.resize(8000, 8000)
    with pytest.raises(ph.SceneError, match="share"):
        session.crop((0.5, 0.5, 2.0, 0.1))


LARGE = {"width": 192, "height": 160}  # enough for paths that are shared


@pytest.fixture
def early(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether paths are to be shared is found out after the first pass."""
    monkeypatch.setattr(drawing, "LOOK_SECONDS", 0.0)
    monkeypatch.setattr(drawing, "LOOK_SHARE", 1e9)


@pytest.mark.usefixtures("early")
def test_paths_are_shared_where_that_pays_and_the_picture_is_that_of_render() -> None:
    seen: list[Frame] = []
    with Session(room(True), spp=8, **LARGE) as session:
        session.subscribe(lambda event: seen.append(session.frame) if event == "frame" else None)
        frame = settled(session, 8)
        assert frame.settings.reuse_paths is True
        expected = ph.render(room(True), spp=8, **LARGE)
        assert expected.settings.reuse_paths is True
        assert np.array_equal(frame.pixels, expected.pixels)
        # at first each pixel by itself, until what is shared has less noise
        ways = [f.settings.reuse_paths for f in seen if f.revision == frame.revision]
        assert ways[0] is False
        assert ways == sorted(ways)
        numbers = [f.number for f in seen]
        assert numbers == sorted(numbers)
        # what comes next begins with it
        session.look(ph.Camera((0.2, 1.1, 0.95), (0, 0.9, -1), vfov=70))
        settled(session, 1)
        mine = [f for f in seen if f.revision == session.frame.revision and f.scale == 1.0]
        assert all(f.settings.reuse_paths for f in mine)
        assert session.image().settings.reuse_paths is True


@pytest.mark.usefixtures("early")
def test_paths_are_not_shared_any_more_where_it_does_not_pay() -> None:
    plain = scene().replace(settings=ph.Settings(**LARGE, max_depth=4))
    with Session(plain, spp=12) as session:
        session._shared = True  # as the last picture was
        frame = settled(session, 12)
        assert frame.settings.reuse_paths is False
        assert np.array_equal(frame.pixels, ph.render(plain, spp=12).pixels)
        assert not session._shared
    for asked in (True, False):  # who says it is obeyed
        with Session(room(True), spp=3, reuse_paths=asked, **LARGE) as session:
            assert settled(session, 3).settings.reuse_paths is asked


@pytest.mark.parametrize("spp", [1, 3])
def test_the_last_picture_is_that_of_render_however_soon_it_is_there(spp: int) -> None:
    expected = ph.render(room(True), spp=spp, **LARGE)
    assert expected.settings.reuse_paths is True
    with Session(room(True), spp=spp, **LARGE) as session:
        end = time.monotonic() + 20
        while session.frame is None or session.frame.settings.reuse_paths is False:
            assert time.monotonic() < end
            time.sleep(0.005)
        assert np.array_equal(settled(session, spp).pixels, expected.pixels)
        # what follows on a lower limit, too
        session.limit(8)
        settled(session, 8)
        session.limit(spp)
        session.look(ph.Camera((0.2, 1.1, 0.95), (0, 0.9, -1), vfov=70))
        again = settled(session, spp)
        there = ph.render(room(True), spp=spp, camera=again.camera, **LARGE)
        assert np.array_equal(again.pixels, there.pixels)


@pytest.mark.usefixtures("early")
def test_a_pause_is_heard_while_samples_begin_anew() -> None:
    anew = threading.Event()
    find_out = drawing.Drawing.find_out

    def noted(own: drawing.Drawing, *arguments: Any) -> None:
        find_out(own, *arguments)
        if own.done == 0:
            anew.set()

    size = {"width": 1280, "height": 1066}  # a pass takes a second
    with pytest.MonkeyPatch.context() as patch, Session(room(True), spp=8, **size) as session:
        patch.setattr(drawing.Drawing, "find_out", noted)
        assert anew.wait(60)
        session.pause()
        began = time.process_time()
        time.sleep(1.5)
        assert time.process_time() - began < 0.9
        frame = session.frame
        assert frame is not None
        assert frame.settings.reuse_paths is False
        assert np.all(frame.counts > 0)


@pytest.mark.usefixtures("early")
def test_what_finds_no_memory_to_find_out_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def too_large(*_: Any) -> Any:
        raise MemoryError

    monkeypatch.setattr(sharing, "look", too_large)
    with Session(room(True), spp=3, **LARGE) as session:
        assert settled(session, 3).settings.reuse_paths is False
        assert session.state()["error"] is None


@pytest.mark.usefixtures("early")
def test_a_pause_comes_before_finding_out(monkeypatch: pytest.MonkeyPatch) -> None:
    looked, stopped = threading.Event(), threading.Event()
    look = sharing.look

    def never_ending(*arguments: Any) -> Any:
        looked.set()
        while not arguments[-1](0, 0):
            time.sleep(0.001)
        stopped.set()

    monkeypatch.setattr(sharing, "look", never_ending)
    with Session(room(True), spp=8, **LARGE) as session:
        assert looked.wait(20)
        session.pause()
        assert stopped.wait(20)
        assert settled(session, 1).settings.reuse_paths is False
        monkeypatch.setattr(sharing, "look", look)
        session.pause(False)
        assert settled(session, 8).settings.reuse_paths is True


def test_pause_rests_after_one_picture_of_full_size(session: Session) -> None:
    session.pause()
    session.limit(64)
    session.look(ph.Camera((1, 1, 4), (0, 0.5, 0)))
    settled(session, 1)
    time.sleep(0.3)
    before = session.frame
    time.sleep(0.2)
    assert session.frame is before
    session.pause(False)
    assert settled(session, 64).spp == 64


def test_exposure_shows_the_same_samples(session: Session) -> None:
    frame = settled(session)
    darker = session.picture(frame)
    session.show(exposure=2.0)
    assert session.frame is frame
    lighter = session.picture(frame)
    assert np.all(lighter >= darker)
    assert lighter.mean() > 1.2 * darker.mean()
    exact = session.image().srgb(exposure=2.0)
    assert np.abs(lighter.astype(int) - exact).max() <= 1


@pytest.mark.parametrize("name", ["agx", "aces"])
def test_view_transforms_are_those_of_saved_pictures(session: Session, name: str) -> None:
    frame = settled(session)
    session.show(view_transform=name, exposure=1.0)
    exact = session.image().srgb(view_transform=name, exposure=1.0).astype(int)
    assert np.abs(session.picture(frame) - exact).mean() < 1.0  # by a table
    assert np.abs(session.image().srgb(exposure=1.0) - exact).mean() > 4.0
    with pytest.raises(ph.SceneError, match="view_transform 'x'"):
        session.show(view_transform="x")


def test_the_picture_without_its_noise(session: Session) -> None:
    pytest.importorskip("pyoidn", reason="Open Image Denoise is not installed")
    truth = ph.render(scene(), spp=256).srgb().astype(int)
    noisy = np.abs(session.picture(settled(session)) - truth).mean()
    session.show(denoise=True)
    assert np.abs(session.picture(settled(session)) - truth).mean() < 0.8 * noisy
    assert session.image().pixels.shape == (64, 96, 3)


def test_noise_is_told_and_falls(session: Session) -> None:
    first = settled(session).error
    session.limit(64)
    last = settled(session, 64).error
    assert first is not None
    assert last is not None
    assert 0.0 < last < 0.5 * first
    assert session.image().stats.error == last


@pytest.mark.parametrize("layer", LAYERS)
def test_every_layer_is_a_picture(session: Session, layer: str) -> None:
    session.show(layer=layer)
    frame = settled(session)
    shown = session.picture(frame)
    assert shown.shape == (64, 96, 3)
    assert shown.dtype == np.uint8
    if layer not in ("emission", "samples", "indirect"):  # the first is dark here, the others even
        assert shown.std() > 5


def test_what_is_picked(session: Session) -> None:
    settled(session)
    pick = session.pick(0.5, 0.5)
    assert (pick.object, pick.object_index, pick.material) == ("ball", 0, "ball")
    assert pick.depth == pytest.approx(3.53, abs=0.05)
    assert pick.position is not None
    assert np.linalg.norm(np.subtract(pick.position, (0, 0.5, 0))) == pytest.approx(0.5, abs=1e-4)
    assert pick.value is not None
    nothing = session.pick(0.01, 0.01)
    assert (nothing.object, nothing.material, nothing.depth) == (None, None, None)


def changed(**materials: ph.Material) -> ph.Scene:
    base = scene()
    return base.replace(materials={**base.materials, **materials})


@pytest.mark.parametrize(
    ("kind", "index", "name", "value", "same"),
    [
        ("materials", 0, "color", [0.1, 0.2, 0.9],
         changed(ball=ph.Material("diffuse", color=(0.1, 0.2, 0.9)))),
        ("materials", 0, "opacity", 0.5,
         changed(ball=ph.Material("diffuse", color=(0.9, 0.1, 0.1), opacity=0.5))),
        ("materials", 2, "emission", [20.0, 1.0, 1.0],
         changed(lamp=ph.Material("diffuse", emission=(20.0, 1.0, 1.0)))),
        ("lights", 0, "radiance", [0.1, 0.1, 3.0],
         scene().replace(background=ph.Background("constant", radiance=(0.1, 0.1, 3.0)))),
    ],
)  # fmt: skip
def test_a_changed_parameter_gives_the_picture_of_the_changed_scene(
    session: Session, kind: str, index: int, name: str, value: object, same: ph.Scene
) -> None:
    session.change(kind, index, name, value).result(10)
    assert np.array_equal(settled(session).pixels, ph.render(same, spp=4).pixels)
    session.restore().result(10)
    assert np.array_equal(settled(session).pixels, ph.render(scene(), spp=4).pixels)


def test_what_is_worked_out_of_a_material_follows_its_changes() -> None:
    with Session(changed(ball=ph.Material("plastic", ior=1.3)), spp=4) as session:
        now: dict[str, float] = {"ior": 1.3}
        for name, value in (("ior", 2.2), ("roughness", 0.4), ("ior", 1.5), ("roughness", 0.0)):
            session.change("materials", 0, name, value).result(10)
            now[name] = value
            same = changed(ball=ph.Material("plastic", **now))
            assert np.array_equal(settled(session).pixels, ph.render(same, spp=4).pixels)


def test_changes_without_end_do_not_stall_the_picture(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled(session)
    change = stage.Parameters.change

    def slow(*arguments: Any) -> None:
        time.sleep(0.01)
        change(*arguments)

    monkeypatch.setattr(stage.Parameters, "change", slow)
    frames: list[Frame] = []
    session.subscribe(lambda event: frames.append(session.frame) if event == "frame" else None)
    end, refused = time.monotonic() + 20, 0
    while len(frames) < 3 or not refused:  # faster than they can be done
        assert time.monotonic() < end
        future = session.change("materials", 0, "color", [len(frames) % 10 / 10, 0.5, 0.5])
        if len(session._jobs) < 1000:
            time.sleep(0.001)
        refused += future.done() and "changes wait" in str(future.exception())


def test_light_from_an_image_can_be_changed() -> None:
    rng = np.random.default_rng(1)
    image = rng.random((8, 16, 3)).astype(np.float32) ** 4

    def lit(strength: float) -> ph.Scene:
        sky = ph.Background("envmap", image=image, scale=(strength,) * 3)
        sun = ph.Light("sun", sun_direction=(1.0, 1.0, 0.5))
        return scene().replace(background=sky, lights=[sun])

    with Session(lit(1.0), spp=2) as session:
        session.change("lights", 0, "scale", [3.0] * 3).result(10)
        assert np.array_equal(settled(session, 2).pixels, ph.render(lit(3.0), spp=2).pixels)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("materials", 0, "colour", 1.0), "material 'ball': unknown parameter 'colour'; did you"),
        (("materials", 0, "color", [2.0, 0.0, 0.0]), r"color'\[0\] is 2.0; must lie in \[0, 1\]"),
        (("materials", 0, "color", "red"), "must be 3 numbers"),
        (("materials", 0, "emission", [1.0, 1.0, 1.0]), "unknown parameter 'emission'"),
        (("materials", 99, "color", [1.0, 1.0, 1.0]), r"materials\[99\]: there are 4"),
        (("lights", 0, "radiance", [1.0]), "has 1 values; must be 3"),
        (("shapes", 0, "color", [1.0]), "unknown kind"),
    ],
)
def test_a_change_without_meaning_changes_nothing(
    session: Session, arguments: tuple, message: str
) -> None:
    with pytest.raises(ph.SceneError, match=message):
        session.change(*arguments).result(10)
    assert np.array_equal(settled(session).pixels, ph.render(scene(), spp=4).pixels)


def test_hidden_objects_are_not_there_and_changes_stay(session: Session) -> None:
    session.change("materials", 1, "color", [0.2, 0.8, 0.2]).result(10)
    session.hide([0]).result(10)
    shapes = list(scene().shapes)
    green = changed(floor=ph.Material("diffuse", color=(0.2, 0.8, 0.2)))
    expected = ph.render(green.replace(shapes=shapes[1:]), spp=4).pixels
    assert np.array_equal(settled(session).pixels, expected)
    assert [o["visible"] for o in session.outline()["objects"]] == [False, True, True, True]
    assert session.pick(0.5, 0.5).object != "ball"
    session.hide([]).result(10)
    assert np.array_equal(settled(session).pixels, ph.render(green, spp=4).pixels)
    with pytest.raises(ph.SceneError, match=r"objects\[7\]: there are 4"):
        session.hide([7]).result(10)


def test_objects_hidden_one_after_the_other_stay_hidden(session: Session) -> None:
    """Also where the tree of the first is still to be built."""
    asked = [session.show_object(0, False), session.show_object(2, False)]
    asked.append(session.show_object(0, True))
    for future in asked:
        future.result(10)
    assert [o["visible"] for o in session.outline()["objects"]] == [True, True, False, True]


def test_what_is_asked_for_while_a_scene_is_replaced_stays(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled(session)
    begun, go = threading.Event(), threading.Event()
    home = stage.Stage.home

    def slow(self: Any, width: int, height: int) -> ph.Camera:
        found = home(self, width, height)
        begun.set()
        go.wait(10)
        return found

    monkeypatch.setattr(stage.Stage, "home", slow)
    done = session.replace(changed(floor=WHITE))
    assert begun.wait(10)
    camera = replace(session.camera, eye=(0.0, 1.0, 5.0))
    session.look(camera)
    session.crop((0.0, 0.0, 0.5, 0.5))
    go.set()
    done.result(10)
    assert session.camera.eye == (0.0, 1.0, 5.0)
    assert session.state()["crop"] == (0.0, 0.0, 0.5, 0.5)


def test_a_picture_that_cannot_be_made_says_nothing_of_the_next(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled(session)
    begun, go = threading.Event(), threading.Event()
    begin = drawing.Drawing.begin

    def failing(self: Any, on: Any) -> None:
        if self.request.camera.eye == (0.0, 1.0, 9.0):
            begun.set()
            go.wait(10)
            raise ph.ResourceError("no room")
        begin(self, on)

    monkeypatch.setattr(drawing.Drawing, "begin", failing)
    session.look(replace(session.camera, eye=(0.0, 1.0, 9.0)))
    assert begun.wait(10)
    session.look(replace(session.camera, eye=(0.0, 1.0, 5.0)))
    go.set()
    assert settled(session).camera.eye == (0.0, 1.0, 5.0)


def test_the_coarsest_picture_is_shown_however_long_it_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(views, "LATE_SECONDS", 0.0)
    with Session(scene(), spp=1) as session:
        assert settled(session, 1).scale == 1.0


def test_changes_that_were_taken_back_are_not_made(session: Session) -> None:
    go = threading.Event()

    def wait() -> None:
        go.wait(10)

    session._do(wait, "values")
    taken_back = session.hide([0])
    assert taken_back.cancel()
    go.set()
    assert settled(session).hidden == {}


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (lambda s: s.crop(3), "crop is 3; must be four shares"),
        (lambda s: s.show(layer=[]), r"layer is \[\]; must be text"),
        (lambda s: s.show(denoise="no"), "denoise is 'no'; must be True or False"),
        (lambda s: s.hide("ab"), "objects is 'ab'; must be a list"),
        (lambda s: s.hide(3), "objects is 3; must be a list"),
        (lambda s: s.hide([0.5]), r"objects\[0\] is 0.5; must be a whole number"),
        (lambda s: s.change("materials", "0", "color", 1.0), "index is '0'; must be a whole"),
        (lambda s: s.change(["a"], 0, "color", 1.0), r"kind is \['a'\]; must be text"),
        (lambda s: s.image("a"), "timeout is 'a'; must be a number"),
        (lambda s: Session(s.scene(), threads=-1), r"threads is -1; must lie in \[0, 4096\]"),
    ],
)
def test_what_is_of_a_wrong_type_is_told(session: Session, asked: Any, told: str) -> None:
    with pytest.raises(ph.SceneError, match=told):
        asked(session)
    assert settled(session).scale == 1.0


def test_of_many_hidings_the_last_is_built(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled(session)
    built: list[object] = []
    go = threading.Event()

    def build(*arguments: Any) -> Any:
        go.wait(10)
        built.append(arguments)
        return renderer.build(*arguments)

    monkeypatch.setattr(stage, "build", build)
    asked = [session.hide([k % 3]) for k in range(20)]
    # meanwhile others look, and pick in what is still there
    assert session.pick(0.5, 0.5).object == "ball"
    session.look(replace(session.camera, eye=(0.0, 1.0, 5.0)))
    go.set()
    for future in asked:
        future.result(10)
    assert len(built) <= 2
    assert [o["visible"] for o in session.outline()["objects"]] == [True, False, True, True]
    assert settled(session).hidden == {1: "small ball"}


def test_objects_of_every_kind_can_be_hidden() -> None:
    quad = ([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], [[0, 1, 2], [0, 2, 3]])
    red = ph.Material("diffuse", color=ph.Texture("attribute", name="face_color"))
    mesh = ph.Mesh(
        *quad,
        uvs=[[0, 0], [1, 0], [1, 1], [0, 1]],
        material=red,
        attributes={"face_color": [[1, 0, 0], [0, 1, 0]]},
    )
    shapes = [
        mesh,
        ph.Spheres([[0, 1, 0], [1, 1, 0]], [0.2, 0.3], colors=[[1, 0, 0], [0, 1, 0]]),
        ph.Disks([[0, 0.5, 0]], [[1, 0, 0]], [[0, 0, 1]]),
        ph.Cylinders([[0, 0, 0]], [[0, 1, 0]], 0.1),
        ph.Curves([[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 2, 0]], 0.05),
        ph.Instances([mesh], np.eye(4)[None]),
    ]
    with Session(ph.Scene(shapes), width=32, height=24, spp=1) as session:
        for i in range(len(shapes)):
            session.hide([i]).result(10)
        session.hide(range(len(shapes))).result(10)
        assert settled(session, 1).features == {}
        assert session.pick(0.5, 0.5).object is None


def test_another_scene_takes_its_place(session: Session) -> None:
    settled(session)
    events: list[str] = []
    session.subscribe(events.append)
    session.replace(changed(ball=ph.Material("diffuse", color=(0.1, 0.9, 0.1)))).result(10)
    green = settled(session).pixels
    assert "scene" in events
    assert green[32, 48, 1] > green[32, 48, 0]
    session.look(ph.Camera((2, 1, 4), (0, 0.5, 0)))
    session.replace(scene()).result(10)
    assert session.camera.eye == (2, 1, 4)  # that of someone who looks around stays
    with pytest.raises(ph.SceneError):
        session.replace(scene().replace(materials={}))
    assert settled(session).camera.eye == (2, 1, 4)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (ph.Camera((0, 0, 0), (0, 0, 0)), "camera: eye"),
        (ph.Camera((0, 0, float("nan")), (0, 0, 0)), "camera"),
        (ph.Camera((0, 0, 4), (0, 0, 0), vfov=180.0), "camera: vfov is 180"),
        (ph.Camera((0, 0, 4), (0, 0, 0), projection="cubist"), "cubist"),
        (ph.Camera(("x", 0, 4), (0, 0, 0)), r"camera: eye is \('x', 0, 4\); must be three"),
        (None, "a Camera is needed, not NoneType"),
    ],
)
def test_a_camera_without_meaning_is_refused_and_the_one_before_stays(
    session: Session, camera: ph.Camera, message: str
) -> None:
    before = settled(session)
    with pytest.raises(ph.SceneError, match=message):
        session.look(camera)
    assert session.camera == before.camera
    assert session.state()["error"] is None
    assert not session.state()["moved"]
    session.look(replace(before.camera, eye=np.array([0, 1, 5])))  # kept as Python's own numbers
    assert settled(session).camera.eye == (0.0, 1.0, 5.0)
    assert type(session.state()["camera"].eye[0]) is float


def test_features_go_with_the_layer_that_needed_them(session: Session) -> None:
    session.show(layer="normal")
    assert "normal" in settled(session).features
    session.show(layer="picture")
    seen = settled(session)
    assert "normal" in seen.features  # the same picture: it does not begin anew
    session.look(replace(session.camera, eye=(0.0, 1.0, 5.0)))
    without = settled(session)
    assert without.features == {}
    session.show(layer="depth")
    assert "depth" in settled(session).features
    session.resize(48, 32)
    assert settled(session).features["depth"].shape[:2] == (32, 48)


def test_the_scene_as_it_is_now_gives_the_same_picture(session: Session, tmp_path: Path) -> None:
    session.change("materials", 0, "color", [0.1, 0.2, 0.9]).result(10)
    session.change("materials", 3, "color", [0.9, 0.9, 0.1]).result(10)  # the one without a name
    session.change("lights", 0, "radiance", [0.1, 0.5, 1.0]).result(10)
    session.hide([3]).result(10)
    session.look(ph.Camera((1, 1, 4), (0, 0.5, 0)))
    session.resize(60, 40)
    session.crop((0.25, 0.0, 0.5, 1.0))
    frame = settled(session)
    made = session.scene()
    assert [shape.name for shape in made.shapes] == ["ball", "small ball", "floor"]
    assert made.materials["floor"] == scene().materials["floor"]
    ph.save(made, tmp_path / "changed.json")
    again = ph.load(tmp_path / "changed.json")
    assert again.camera == session.camera
    assert np.array_equal(ph.render(again, spp=4).pixels, frame.pixels)


def test_what_materials_are_made_of_stays_in_the_changed_scene() -> None:
    image = np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3)
    inner = ph.Material("diffuse", color=(0.2, 0.4, 0.6))
    outer = ph.Material(
        "blend",
        a=inner,
        b=ph.Material("metal", color=ph.Texture("image", image=image)),
        weight=ph.Texture("image", image=image),
    )
    lamp = ph.Material("emissive", radiance=ph.Texture("image", image=image))
    ball = ph.Spheres([[0, 0, 0]], 1.0, outer)
    shapes = [
        ball,
        ph.Spheres([[2, 0, 0]], 1.0, lamp),
        ph.Instances([ball], [np.eye(4)]),
        ph.Spheres([[0, 2, 0]], 1.0, inner),
    ]
    given = ph.Scene(shapes, {"same": inner}, background=None)
    with Session(given, width=32, height=24, spp=1) as session:
        outline = session.outline()
        by_name = {m["name"]: (i, m) for i, m in outline["materials"].items()}
        fixed = {
            name: [p["name"] for p in m["params"] if p["fixed"]] for name, (_, m) in by_name.items()
        }
        assert fixed["blend"] == ["weight"]
        assert fixed["emissive"] == ["radiance"]
        session.change("materials", by_name["diffuse"][0], "color", [0.9, 0.1, 0.1]).result(10)
        made = session.scene()
        assert made.materials["same"] == inner  # equal, but another
        red = ph.Material("diffuse", color=(0.9, 0.1, 0.1))
        assert made.shapes[0].material.params["a"] == red
        assert made.shapes[2].shapes[0].material.params["a"] == red
        assert made.shapes[3].material == red
        assert made.shapes[1].material == lamp
        assert np.array_equal(ph.render(made, spp=1).pixels, settled(session, 1).pixels)


def test_a_picture_tells_what_was_hidden_and_is_made_again(tmp_path: Path) -> None:
    ph.save(scene(), tmp_path / "scene.json")
    with Session(ph.load(tmp_path / "scene.json"), spp=2) as session:
        session.hide([0, 3]).result(10)
        settled(session, 2)
        image = session.image()
        session.change("materials", 0, "color", [0.0, 0.0, 1.0]).result(10)
        settled(session, 2)
        session.image().save(tmp_path / "changed.exr")
    image.save(tmp_path / "hidden.exr")
    assert '{"0": "ball", "3": "lamp"}' in image.metadata().values()
    assert image.metadata()["parhelion:scene"] != ph.prepare(scene()).flat.sha256()
    assert np.array_equal(ph.rerender(tmp_path / "hidden.exr").pixels, image.pixels)
    with pytest.raises(ph.SceneError, match="was made of another scene"):
        ph.rerender(tmp_path / "changed.exr")


def test_what_memory_cannot_hold_is_refused_and_the_picture_stays(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = settled(session)
    held = resident()
    assert held is not None
    session._memory_limit = held + 100 * 2**20
    with pytest.raises(
        ph.ResourceError, match=r"looking at 2000x1500 pixels takes .* memory_limit"
    ):
        session.resize(2000, 1500)
    assert session.frame is before
    session.resize(192, 128)
    assert settled(session).pixels.shape == (128, 192, 3)
    with monkeypatch.context() as patch:  # as if others had taken all since
        patch.setattr(memory, "free", lambda *_, **__: memory.Free(0, "are free"))
        session.look(replace(session.camera, eye=(0.0, 1.0, 5.0)))
        with pytest.raises(ph.ResourceError, match="not enough memory"):
            session.image()
        assert "not enough memory" in session.state()["error"]
    session.look(replace(session.camera, eye=(0.0, 1.0, 6.0)))
    assert settled(session).camera.eye == (0.0, 1.0, 6.0)
    assert session.state()["error"] is None
    with pytest.raises(ph.ResourceError, match="memory_limit"):
        Session(scene(), width=2000, height=1500, memory_limit=held + 2**26)
    with pytest.raises(ph.ResourceError, match="memory_limit"):
        Session(scene(), memory_limit="1M")
    with pytest.raises(ph.SceneError, match="memory_limit is 'much'"):
        Session(scene(), memory_limit="much")


@LINUX
@pytest.mark.parametrize("extra", [100, 280, 2000])
def test_under_a_limit_of_the_system_there_are_errors_and_no_signals(extra: int) -> None:
    """Address space beyond that taken, in MiB: too little for a picture, for its files, enough."""
    said = child(
        f"""
        import resource
        import parhelion as ph
        from parhelion.machine import lines
        from parhelion.memory import _field
        from parhelion.view.messages import Client, Packer, saved
        from parhelion.view.session import Session

        def look(scene, **size):
            with Session(scene, spp=1, **size) as session:
                client = Client(session, Packer(session), lambda: None)
                for layer in ("picture", "normal"):
                    session.show(layer=layer)
                    session.finished()
                    while client.take():
                        pass
                    for ending in ("png", "exr", "json"):
                        saved(session, ending)

        scene = ph.Scene([ph.Spheres([[0, 0, 0]], 1.0)])
        look(scene, width=32, height=24)  # loads what it needs
        most = _field(lines("/proc/self/status"), "VmSize:", 1024) + {extra} * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        try:
            look(scene, width=800, height=600)
        except ph.ResourceError as error:
            print(error)
        else:
            print("seen")
        """
    )
    wanted = "seen" if extra == 2000 else "not enough memory: "
    assert said.startswith(wanted) or (extra == 280 and said == "seen\n")


def test_a_prepared_scene_gets_its_parameters_back() -> None:
    prepared = ph.prepare(scene())
    with Session(prepared, spp=1) as session:
        session.change("materials", 0, "color", [0.0, 0.0, 1.0]).result(10)
        settled(session, 1)
    assert np.array_equal(ph.render(prepared, spp=1).pixels, ph.render(scene(), spp=1).pixels)


def test_closing_stops_a_long_pass_and_its_thread() -> None:
    session = Session(scene(), width=2000, height=1500)
    time.sleep(0.1)
    start = time.monotonic()
    session.close()
    assert time.monotonic() - start < 1.0
    assert not any(
        t.name == "parhelion-session" and t is session._thread for t in threading.enumerate()
    )
    session.close()
    assert session.change("materials", 0, "color", [0.0, 0.0, 1.0]).cancelled()
    with pytest.raises(ph.ResourceError, match="the session is closed"):
        session.look(ph.Camera())
    with pytest.raises(ph.ResourceError, match="the session is closed"):
        session.pick(0.5, 0.5)
