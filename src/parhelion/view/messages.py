"""What a front end and a session say to each other, whatever carries it.

To the session go JSON objects, one of the classes below each. From it come messages of a header,
a JSON object with a "type", and bytes, such as a picture's, which may be none.
"""

from __future__ import annotations

import io
import logging
import re
import tempfile
import threading
import time
import zipfile
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import msgspec

from .. import memory
from ..denoise import check_denoiser
from ..display import VIEW_TRANSFORMS
from ..errors import ParhelionError, ResourceError, SceneError
from ..image import encoded
from ..saving import save
from ..scene import Camera
from .drawing import Frame
from .layers import LAYERS, PICTURE
from .session import Event, Session, resident

log = logging.getLogger("parhelion")

# Bytes of one message to the session; the longest that makes sense hides many objects.
LARGEST = 1 << 20
# Frames that may be on their way to a front end that has not said that it shows them.
UNSEEN = 2
# Mistaken messages, and answers that wait to be taken, after which nobody listens any more.
MOST_MISTAKES, MOST_ANSWERS = 100, 1000
# Bytes of arrays of a scene that a page is given.
LARGEST_SCENE = 1 << 28

# What is told before pictures, in this order
_FIRST: tuple[Event, ...] = ("state", "scene", "values")

Header = dict[str, Any]


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    pass


class Look(_Message, tag="look"):
    """Another camera. stamp: told again with the state that it led to."""

    camera: Camera
    stamp: int = 0


class Home(_Message, tag="home"):
    """The camera with which it began. stamp: as of Look."""

    stamp: int = 0


class Size(_Message, tag="size"):
    """Another size of the picture, in pixels."""

    width: int
    height: int


class Show(_Message, tag="show"):
    """Another layer, exposure in stops, view transform, or whether noise is taken out."""

    layer: str | None = None
    exposure: float | None = None
    view_transform: str | None = None
    denoise: bool | None = None


class Crop(_Message, tag="crop"):
    """A part of the picture, in shares of it; null for all."""

    part: tuple[float, float, float, float] | None


class Pause(_Message, tag="pause"):
    """Rest, or go on."""

    paused: bool


class Limit(_Message, tag="limit"):
    """Samples a pixel after which it rests."""

    spp: int


class Change(_Message, tag="change"):
    """Another value of a parameter."""

    kind: Literal["materials", "lights"]
    index: int
    name: str
    value: float | str | list[float]


class Restore(_Message, tag="restore"):
    """All parameters as they were given."""


class Hide(_Message, tag="hide"):
    """Whether an object is there."""

    object: int
    visible: bool


class Pick(_Message, tag="pick"):
    """What is seen at a place, in shares of the picture. id: told again with the answer."""

    x: float
    y: float
    id: int = 0


class Save(_Message, tag="save"):
    """The picture, or the scene as it is now (json), as a file's bytes."""

    format: Literal["png", "exr", "json"]
    id: int = 0


class Seen(_Message, tag="seen"):
    """The frame of that number is shown."""

    frame: int


_decoder = msgspec.json.Decoder(
    Look | Home | Size | Show | Crop | Pause | Limit | Change | Restore | Hide | Pick | Save | Seen
)


class Packer:
    """Frames as picture files, each made once for however many front ends."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._lock = threading.Lock()
        self._key: tuple[Any, ...] = ()
        self._bytes = b""

    def packed(self, frame: Frame, shown: tuple[Any, ...]) -> bytes:
        """A JPEG file of a frame, made in a twentieth of the time of a PNG one (1280 x 720 pixels:
        10 ms for 206). shown: what of it is shown, and how.
        """
        key = (frame.number, *shown)
        with self._lock:
            if key != self._key:
                self._bytes = encoded(self._session.picture(frame), {}, ".jpg")
                self._key = key
            return self._bytes


class Client:
    """One front end: what it has asked for, and what is still to be told to it.

    wake: called, from whatever thread, when take() may have something. A front end that is slow or
    gone holds up nobody: of pictures and states there is only the newest to take.
    """

    def __init__(self, session: Session, packer: Packer, wake: Callable[[], None]) -> None:
        self._session, self._packer, self._wake = session, packer, wake
        self._lock = threading.Lock()
        self._look = threading.Lock()  # held while camera and stamp change or are told, together
        self._due: set[Event] = {"state", "scene", "frame"}
        self._serial = -1  # of the parameters that were told
        self._answers: deque[tuple[Header, bytes]] = deque()
        self._sent: deque[int] = deque()  # numbers of frames on their way
        self._shown: tuple[Any, ...] = ()
        self._stamp = self._revision = 0  # of the newest camera from here
        self._saving = False  # until the file is taken
        self._mistakes = 0
        self._end = session.subscribe(self._on)

    def close(self) -> None:
        """Is told no more."""
        self._end()

    @property
    def over(self) -> bool:
        """Whether nobody listens any more: it made too many mistakes, or asks and takes nothing."""
        return self._mistakes >= MOST_MISTAKES or len(self._answers) >= MOST_ANSWERS

    def _on(self, event: Event) -> None:
        with self._lock:
            self._due.add(event)
        self._wake()

    def _answer(self, header: Header, data: bytes = b"") -> None:
        with self._lock:
            self._answers.append((header, data))
        self._wake()

    # --- From the session ------------------------------------------------------------------------

    def take(self) -> tuple[Header, bytes] | None:
        """The next message, or None if there is none for now; packing a picture takes some time."""
        with self._lock:
            if self._answers:
                header, data = self._answers.popleft()
                self._saving = self._saving and header["type"] != "file"
                return header, data
            event: Event
            for event in _FIRST:
                if event in self._due:
                    self._due.discard(event)
                    break
            else:
                event = "frame"
                if "frame" not in self._due or len(self._sent) >= UNSEEN:
                    return None
                self._due.discard("frame")
        if event == "state":
            with self._look:
                return {"type": "state", "stamp": self._stamp, **self._session.state()}, b""
        if event == "scene":
            lists = {
                "layers": LAYERS,
                "view_transforms": VIEW_TRANSFORMS,
                "denoises": _can_denoise(),
            }
            outline = self._session.outline()
            self._serial = outline["serial"]
            return {"type": "scene", **lists, **outline}, b""
        if event == "values":
            values = self._session.values(self._serial)
            self._serial = values["serial"]
            return {"type": "values", **values}, b""
        frame, state = self._session.frame, self._session.state()
        display = tuple(state[k] for k in ("layer", "exposure", "view_transform", "denoise"))
        shown = (frame and frame.number, *display)
        if frame is None or shown == self._shown:
            return None
        try:
            data = self._packer.packed(frame, display)
        except (ParhelionError, MemoryError) as error:
            self._shown = shown  # not again before something changes
            text = " ".join(str(error).split()) or "not enough memory for the picture"
            log.warning("view: %s", text)
            return {"type": "error", "text": text, "id": 0}, b""
        with self._lock:
            self._shown = shown
            self._sent.append(frame.number)
        height, width = frame.pixels.shape[:2]
        header = {
            "type": "frame",
            "mime": "image/jpeg",
            "number": frame.number,
            "revision": frame.revision,
            "place": [frame.x, frame.y, width, height],
            "width": frame.width,
            "height": frame.height,
            "scale": frame.scale,
            "spp": frame.spp,
            "seconds": frame.seconds,
            "rate": frame.rate,
            "latency": frame.latency,
            "error": frame.error,
            "memory": resident(),
            "stamp": self._stamp if frame.revision >= self._revision else None,
        }
        return header, data

    # --- To the session --------------------------------------------------------------------------

    def receive(self, raw: bytes | str) -> Callable[[], None] | None:
        """Does what a message asks for; what may take long is returned, to be called elsewhere.

        One that is no such message, or asks for what has no meaning, is logged and answered with an
        error, and changes nothing.
        """
        if self.over:
            return None
        message: Any = None
        try:
            if len(raw) > LARGEST:
                raise SceneError(f"a message of more than {LARGEST} bytes")
            message = _decoder.decode(raw)
            return self._done(message)
        except (msgspec.DecodeError, UnicodeDecodeError, ParhelionError) as error:
            self._refuse(error, getattr(message, "id", 0))
        return None

    def _refuse(self, error: BaseException, request: int = 0) -> None:
        self._mistakes += not isinstance(error, ResourceError)
        text = " ".join(str(error).split())
        log.warning("view: refused: %s", text)
        self._answer({"type": "error", "text": text, "id": request})
        self._on("state")  # what it may have taken for done

    def _done(self, message: Any) -> Callable[[], None] | None:
        session = self._session
        match message:
            case Look():
                with self._look:
                    self._stamp = message.stamp  # also of one that is refused: it led to none
                    self._revision = session.look(message.camera)
            case Home():
                with self._look:
                    self._stamp = message.stamp
                    self._revision = session.look_home()
            case Size():
                session.resize(message.width, message.height)
            case Show():
                session.show(
                    layer=message.layer,
                    exposure=message.exposure,
                    view_transform=message.view_transform,
                    denoise=message.denoise,
                )
            case Crop():
                session.crop(message.part)
            case Pause():
                session.pause(message.paused)
            case Limit():
                session.limit(message.spp)
            case Change():
                future = session.change(message.kind, message.index, message.name, message.value)
                future.add_done_callback(self._told)
            case Restore():
                session.restore().add_done_callback(self._told)
            case Hide():
                session.show_object(message.object, message.visible).add_done_callback(self._told)
            case Seen():
                with self._lock:
                    while self._sent and self._sent[0] <= message.frame:
                        self._sent.popleft()
                self._wake()
            case Pick():
                seen = asdict(session.pick(message.x, message.y))
                self._answer({"type": "pick", "id": message.id, **seen})
            case Save():
                if self._saving:
                    raise ResourceError(
                        "the picture is being saved already, or has not been taken yet"
                    )
                self._saving = True
                return lambda: self._save(message)
        return None

    def _told(self, future: Any) -> None:
        if not future.cancelled() and future.exception() is not None:
            self._refuse(future.exception())

    def _save(self, message: Save) -> None:
        try:
            with self._session.limited():
                name, data = saved(self._session, message.format)
        except BaseException as error:
            self._saving = False
            if not isinstance(error, (ParhelionError, MemoryError, OSError)):
                raise
            self._refuse(error, message.id)
            return
        mime = _MIME[Path(name).suffix]
        self._answer({"type": "file", "id": message.id, "name": name, "mime": mime}, data)


def _can_denoise() -> bool:
    try:
        check_denoiser()
    except ResourceError:
        return False
    return True


_MIME = {
    ".png": "image/png",
    ".exr": "image/x-exr",
    ".json": "application/json",
    ".zip": "application/zip",
}


def saved(session: Session, ending: str) -> tuple[str, bytes]:
    """A file's name and bytes: .png as it is shown, .exr linear, with features if some are there,
    .json the scene as it is now, in a .zip with its arrays where they lie in a file of their own.

    Raises ResourceError if the picture is not there in time, or the scene too large.
    """
    state = session.state()
    name = re.sub(r"[^\w.-]+", "-", Path(state["scene"]).stem).strip("-.") or "parhelion"
    name = f"{name}-{time.strftime('%Y%m%d-%H%M%S')}.{ending}"
    if ending == "json":
        return _packed(session, name)
    image = session.image()
    needed = 4 * image.pixels.nbytes + 3 * sum(part.nbytes for part in image.features.values())
    memory.require(needed, "saving the picture", "a smaller one takes less")
    if ending == "png" and state["layer"] != PICTURE:
        return name, encoded(session.picture(session.finished()), image.metadata(), ".png")
    if state["denoise"]:
        image = image.denoised()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"picture.{ending}"
        image.save(file, exposure=state["exposure"], view_transform=state["view_transform"])
        return name, file.read_bytes()


def _packed(session: Session, name: str) -> tuple[str, bytes]:
    """The file of a scene as it is now, in a .zip if there is another one beside it."""
    size = session.array_bytes()
    if size > LARGEST_SCENE:
        raise ResourceError(
            f"the scene's arrays take {memory.amount(size)}, a page gets at most"
            f" {memory.amount(LARGEST_SCENE)}; in Python, ph.save(session.scene(), FILE) writes it"
        )
    # arrays as they are checked, and a file that may have them in 64 bits, packed, on its way
    memory.require(8 * size, "saving the scene", "ph.save(session.scene(), FILE) takes less")
    with tempfile.TemporaryDirectory() as folder:
        save(session.scene(), Path(folder) / name)
        files = sorted(Path(folder).iterdir())
        if len(files) == 1:
            return name, files[0].read_bytes()
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for file in files:
                archive.write(file, file.name)
        return f"{name.removesuffix('.json')}.zip", packed.getvalue()


def joined(header: Header, data: bytes) -> bytes:
    """A message as bytes: the header's length, 4 bytes little-endian, the header, the rest."""
    head = msgspec.json.encode(header)
    return len(head).to_bytes(4, "little") + head + data
