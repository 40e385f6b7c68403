"""What a study measures: its settings, checked, and the lists they are typed as."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

from ..errors import SceneError, unknown_name
from .original import THREADS as CLASSIC_THREADS

ASPECTS = {"16:9": (16, 9), "4:3": (4, 3)}
SCHEDULES = ("static", "dynamic", "guided")
SAMPLERS = ("sobol", "independent")
TREES = ("bvh", "none")

MAX_THREADS = 1024
"""More would fail in the thread library of many systems, and not with an error."""
MAX_WIDTH = 32768


@dataclass(frozen=True)
class Plan:
    """The settings of a study.

    threads: thread counts, rising; 1 is among them, as speed-up is measured against it.
    widths: picture widths in pixels, rising. cores: hardware threads this process may use.
    low_high: samples per pixel of the pair of pictures. scene: path of a scene file, or None for
    the built-in one.
    """

    threads: tuple[int, ...]
    cores: int
    widths: tuple[int, ...] = (120, 240, 480, 960)
    aspect: str = "16:9"
    spp: int = 20
    max_depth: int = 50
    repeat: int = 3
    tree: str = "bvh"
    sampler: str = "sobol"
    schedules: tuple[str, ...] = ("dynamic",)
    tile: int = 16
    low_high: tuple[int, int] = (4, 200)
    seed: int = 0
    scene: str | None = None

    def __post_init__(self) -> None:
        for option, value, choices in (
            ("--aspect", self.aspect, tuple(ASPECTS)),
            ("--tree", self.tree, TREES),
            ("--sampler", self.sampler, SAMPLERS),
            *(("--schedule", schedule, SCHEDULES) for schedule in self.schedules),
        ):
            if value not in choices:
                raise SceneError(f"{option}: {unknown_name('value', value, choices)}")
        for option, number, high in (
            ("--spp", self.spp, 1_000_000),
            ("--max-depth", self.max_depth, 100_000),
            ("--repeat", self.repeat, 1000),
            ("--tile", self.tile, MAX_WIDTH),
            *(("--low-high-spp", spp, 1_000_000) for spp in self.low_high),
        ):
            if not 1 <= number <= high:
                raise SceneError(f"{option}: {number} is outside 1 to {high:,}")
        if not 0 <= self.seed < 2**64:
            raise SceneError(f"--seed: {self.seed} is outside 0 to 2**64 - 1")
        if self.low_high[0] >= self.low_high[1]:
            raise SceneError(
                f"--low-high-spp: the first number must be below the second, "
                f"not {self.low_high[0]},{self.low_high[1]}"
            )

    def height(self, width: int) -> int:
        """Height in pixels of the picture of this width."""
        across, down = ASPECTS[self.aspect]
        return max(1, round(width * down / across))

    def tiles(self, width: int) -> int:
        """How many square tiles, the units of work the threads share out, cover the picture."""
        return -(-width // self.tile) * -(-self.height(width) // self.tile)

    def oversubscribed(self, threads: int) -> bool:
        """Whether there are more threads than cores to run them."""
        return threads > self.cores

    @property
    def pair_width(self) -> int:
        """Width of the pair of pictures: the smallest of the study that shows the scene well."""
        return next((w for w in self.widths if w >= 240), self.widths[-1])

    def command(self) -> str:
        """The command that measures this again."""
        words = ["parhelion", "study"]
        if self.scene is not None:
            words += ["--scene", self.scene]
        for option, value in (
            ("--threads", ",".join(map(str, self.threads))),
            ("--widths", ",".join(map(str, self.widths))),
            ("--aspect", self.aspect),
            ("--spp", str(self.spp)),
            ("--max-depth", str(self.max_depth)),
            ("--repeat", str(self.repeat)),
            ("--tree", self.tree),
            ("--sampler", self.sampler),
            ("--schedule", ",".join(self.schedules)),
            ("--tile", str(self.tile)),
            ("--low-high-spp", ",".join(map(str, self.low_high))),
            ("--seed", str(self.seed)),
        ):
            words += [option, value]
        return shlex.join(words)


def thread_list(text: str | None, cores: int) -> tuple[int, ...]:
    """The thread counts of --threads, rising and each once.

    None gives 1, 2, 4, ... up to the cores, and the core count itself; "classic" gives those of
    the original study. 1 is added where a list lacks it. Raises SceneError.
    """
    if text is None:
        doubling = {2**k for k in range(cores.bit_length()) if 2**k <= cores}
        return tuple(sorted(doubling | {cores}))
    if text.strip() == "classic":
        return CLASSIC_THREADS
    return tuple(
        sorted({1, *numbers("--threads", text, MAX_THREADS, ", nor the one word 'classic'")})
    )


def width_list(text: str) -> tuple[int, ...]:
    """The widths of --widths, rising and each once. Raises SceneError."""
    return tuple(sorted(set(numbers("--widths", text, MAX_WIDTH))))


def schedule_list(text: str) -> tuple[str, ...]:
    """The names of --schedule in the order given, each once; Plan checks them."""
    return tuple(dict.fromkeys(word.strip() for word in text.split(",")))


def spp_pair(text: str) -> tuple[int, int]:
    """The two numbers of --low-high-spp. Raises SceneError."""
    both = numbers("--low-high-spp", text, 1_000_000)
    if len(both) != 2:
        raise SceneError(f"--low-high-spp: two numbers such as 4,200 are needed, not {text!r}")
    return both[0], both[1]


def numbers(option: str, text: str, high: int, nor: str = "") -> list[int]:
    """Whole numbers from 1 to high, separated by commas. SceneError names the option."""
    found = []
    for word in map(str.strip, text.split(",")):
        # isdecimal() alone would take digits of any script; the length keeps int() from long work.
        number = int(word) if word.isascii() and word.isdecimal() and len(word) < 10 else 0
        if not 1 <= number <= high:
            raise SceneError(f"{option}: {word[:40]!r} is not a whole number from 1 to {high}{nor}")
        found.append(number)
    return found
