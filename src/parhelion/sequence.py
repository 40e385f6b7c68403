"""Sequences of pictures: numbered files, or a film through the program ffmpeg."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Protocol

from . import arguments
from .atomic import clear, taking_place
from .display import Display
from .errors import FormatError, ResourceError, SceneError, option
from .image import Image, check_output, check_place, picture_metadata, read_pixels
from .io.frames import FPS, checked_fps

FILM = ".mp4"
# What only files of that kind are told
_EXR = ("compression", "tiled")

# %d or %04d as printf has it, and %% for a single one; or #### for four digits
_NUMBER = re.compile(r"%(0?\d*)d")
_HASHES = re.compile(r"#+")
_JPEG_END = b"\xff\xd9"

# Of numbers in names
_LARGEST = 2**63 - 1
# Digits of numbers where the name does not say
_DIGITS = 4

# H.264 at a quality where no block is seen. Pictures are sRGB, which the tags say: Rec. 709
# primaries, sRGB's curve, and Rec. 709's matrix and range for the conversion to Y'CbCr.
_ENCODER = "libx264"
_QUALITY = ("-crf", "17", "-preset", "medium")
_COLOR = (
    "-vf",
    "scale=flags=accurate_rnd+full_chroma_int:in_range=pc:out_range=tv:out_color_matrix=bt709,"
    "format=yuv420p,setparams=color_primaries=bt709:color_trc=iec61966-2-1:colorspace=bt709"
    ":range=tv",
)


class Taker(Protocol):
    """What takes the pictures of a sequence, one after the other."""

    def add(self, image: Image, number: int | None = None) -> None:
        """Takes the next one. number: that its file has; None for one more than the last."""


def save_sequence(
    images: Iterable[Image],
    path: str | os.PathLike[str],
    *,
    fps: float = FPS,
    bits: int | None = None,
    numbers: Iterable[int] | None = None,
    **how: Any,
) -> int:
    """Writes pictures as they come, and returns how many.

    path: "turn.png" makes turn.0001.png, turn.0002.png and so on; "turn-%03d.exr" or "turn-###.exr"
    says where the number stands and how many digits it has. "turn.mp4" makes a film of fps pictures
    a second, for which the program ffmpeg is needed; it appears when it is complete. numbers: those
    of the files, as Frames.file_numbers has them; None for 1, 2, 3 and so on. bits, and legend,
    exposure and so on: as for Image.save(), of a film as for Image.srgb().

    Raises what Image.save() does, and ResourceError without ffmpeg, before the first picture is
    asked for.
    """
    for name, values in (("images", images), ("numbers", () if numbers is None else numbers)):
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise SceneError(f"{name}: a list is needed, not {type(values).__name__}")
    count, left = 0, itertools.count(1) if numbers is None else iter(numbers)
    with opened(path, fps=fps, bits=bits, **how) as taker:
        for image in images:
            number = next(left, None)
            if number is None:
                raise SceneError(f"numbers: there are {count}, and more pictures than that")
            taker.add(
                arguments.instance(f"images[{count}]", image, Image),
                arguments.whole(f"numbers[{count}]", number, -_LARGEST, _LARGEST),
            )
            count += 1
    return count


@contextmanager
def opened(
    path: str | os.PathLike[str],
    *,
    fps: float = FPS,
    bits: int | None = None,
    features: bool = False,
    **how: Any,
) -> Iterator[Taker]:
    """What takes the pictures of one sequence; a film is whole, and there, after the block.

    If the block ends with an exception, files of pictures stay, and a film does not appear.
    Temporary files that killed processes left beside them are removed. Raises as save_sequence()
    does.
    """
    name, rate = str(arguments.path("path", path)), checked_fps(fps)
    program = check_sequence(path, bits=bits, features=features, **how)
    clear(Path(os.path.realpath(name)).parent)
    if program is None:
        yield _Files(name, {"bits": bits, **how})
        return
    how = {name: value for name, value in how.items() if name not in _EXR}
    with tempfile.TemporaryFile() as said, taking_place(Path(name)) as temporary:
        film = _Film(name, program, rate, temporary, said, how)
        try:
            yield film
            film.finish()
        finally:
            film.stop()


def check_sequence(
    path: str | os.PathLike[str],
    *,
    bits: int | None = None,
    features: bool = False,
    legend: bool = False,
    **how: Any,
) -> str | None:
    """Raises what opened() does for what cannot be written there.

    Returns the program that makes the film, None for files of pictures.
    """
    name = str(arguments.path("path", path))
    arguments.flag("legend", legend)
    if Path(name).suffix.lower() != FILM:
        check_output(numbered(name, 1), bits, features, legend, **how)
        return None
    if bits not in (None, 8):
        raise SceneError(f"{name}: {FILM} cannot hold {bits} bits a channel (choices: 8)")
    if features:
        raise SceneError(f"{name}: {FILM} cannot hold features (choices: .exr)")
    for key in _EXR:
        if how.pop(key, None):
            raise SceneError(f"{name}: {option(key)} is for .exr")
    Display(**how)
    check_place(Path(name))
    return _ffmpeg(name)


def numbered(name: str, number: int) -> str:
    """The name of one file of a sequence: with its number in the place that the name gives to it,
    or before the ending. Raises SceneError for a name with more than one such place.
    """
    folder, base = os.path.split(name)
    plain = base.replace("%%", "")
    places, hashes = _NUMBER.findall(plain), _HASHES.findall(plain)
    if len(places) + len(hashes) > 1 or "%" in _NUMBER.sub("", plain):
        raise SceneError(
            f"{name}: one number such as %04d or #### may stand in the name, and %% for %"
        )
    if places:
        if len(places[0]) > 3 or int(places[0] or 0) > 20:
            raise SceneError(f"{name}: %{places[0]}d has too many digits; %04d has four")
        base = base % number
    elif hashes:
        if len(hashes[0]) > 20:
            raise SceneError(f"{name}: {hashes[0]} has too many digits; #### has four")
        base = _HASHES.sub(f"{number:0{len(hashes[0])}}", base.replace("%%", "%"))
    else:
        stem, ending = os.path.splitext(base.replace("%%", "%"))
        base = f"{stem}.{number:0{_DIGITS}}{ending}"
    return os.path.join(folder, base)


def is_there(
    file: str, size: tuple[int, int], notes: Mapping[str, str], legend: bool = False
) -> bool:
    """Whether a file is a whole picture that a sequence with these notes would have made.

    size: width and height without the legend, which makes a picture wider. notes: as Image.notes.
    All of the picture is read, so a damaged one, or one of another program, is none; of JPEG only
    what is missing is noticed. What the picture shows is not compared with anything.
    """
    if not os.path.isfile(file):
        return False
    from . import __version__

    wanted = {**notes, "parhelion:version": __version__, "parhelion:complete": "true"}
    try:
        told = picture_metadata(file)
        if any(told.get(key) != value for key, value in wanted.items()):
            return False
        height, width, _ = map(int, read_pixels(file).shape)
        if file.lower().endswith((".jpg", ".jpeg")):  # the library fills up what is missing
            with open(file, "rb") as stored:
                stored.seek(-len(_JPEG_END), os.SEEK_END)
                if stored.read() != _JPEG_END:
                    return False
    except (FormatError, OSError):
        return False
    fits = width > size[0] if legend else width == size[0]
    return fits and height == size[1]


class _Files:
    """A file for each picture, each whole or not there."""

    def __init__(self, name: str, looks: dict[str, Any]) -> None:
        self._name, self._looks, self._last = name, looks, 0

    def add(self, image: Image, number: int | None = None) -> None:
        self._last = self._last + 1 if number is None else number
        image.save(numbered(self._name, self._last), **self._looks)


class _Film:
    """ffmpeg, which is sent the pictures; it starts with the first one, which says the size."""

    def __init__(
        self,
        name: str,
        program: str,
        fps: float,
        file: Path,
        said: IO[bytes],
        looks: dict[str, Any],
    ) -> None:
        self._name, self._program, self._fps, self._looks = name, program, fps, looks
        self._file, self._said = file, said
        self._process: subprocess.Popen[bytes] | None = None
        self._size = (0, 0)

    def add(self, image: Image, number: int | None = None) -> None:
        del number  # a film has no files to tell apart
        pixels = image.srgb(**self._looks)
        size = pixels.shape[1], pixels.shape[0]
        if self._process is None:
            self._start(*size)
        elif size != self._size:
            raise SceneError(
                f"{self._name}: a picture of {size[0]}x{size[1]} in a film of"
                f" {self._size[0]}x{self._size[1]}"
            )
        assert self._process is not None
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(pixels.tobytes())
            self._process.stdin.flush()
        except OSError:  # it is gone
            self._fail()

    def finish(self) -> None:
        """Waits until the film is written."""
        if self._process is None:
            raise SceneError(f"{self._name}: a film needs a picture")
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        if self._process.wait() != 0:
            self._fail()

    def stop(self) -> None:
        """Ends what is still running."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _start(self, width: int, height: int) -> None:
        check_film_size(self._name, width, height)
        self._size = width, height
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
        command = [
            *(self._program, "-y", "-nostdin", "-loglevel", "error"),
            *(*raw, "-framerate", f"{self._fps:g}", "-i", "pipe:0"),
            *("-c:v", _ENCODER, *_QUALITY, *_COLOR, "-movflags", "+faststart"),
            *("-f", "mp4", os.fspath(self._file)),
        ]
        try:
            # In a group of its own: Ctrl-C is ours to act on.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._said,
                start_new_session=True,
            )
        except OSError as error:
            raise ResourceError(f"{self._name}: ffmpeg does not start: {error.strerror}") from error

    def _fail(self) -> None:
        """Raises what ffmpeg said."""
        assert self._process is not None
        code = self._process.wait()
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit code {code}"
        raise ResourceError(f"{self._name}: ffmpeg failed: {reason[:300]}")


def check_film_size(name: str, width: int, height: int) -> None:
    """Raises SceneError for pictures that do not consist of 2x2 pixels, which share a colour."""
    if width % 2 or height % 2:
        raise SceneError(
            f"{name}: a film needs an even width and height, and pictures are {width}x{height}"
        )


def _ffmpeg(name: str) -> str:
    """The program. Raises ResourceError where there is none that can encode H.264."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise ResourceError(
            f"{name}: the program ffmpeg is needed for films and is not on the PATH;"
            " install it, or write pictures: .png, .jpg or .exr"
        )
    try:
        done = subprocess.run(
            [program, "-hide_banner", "-encoders"], capture_output=True, timeout=60, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ResourceError(f"{name}: {program} does not run: {error}") from error
    if _ENCODER.encode() not in done.stdout:
        raise ResourceError(f"{name}: {program} has no encoder {_ENCODER}, for H.264")
    return program
