"""The renderer's compiled half; use the parhelion package instead."""

from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray

class Scene:
    """Spheres, checked, in a tree."""

    def __init__(
        self,
        arg0: Sequence[
            tuple[
                str,
                Annotated[NDArray, dict(order="C", device="cpu", writable=False)],
                Annotated[NDArray, dict(order="C", device="cpu", writable=False)],
                int,
                Annotated[
                    NDArray[numpy.uint32],
                    dict(shape=(None,), order="C", device="cpu", writable=False),
                ]
                | None,
                Annotated[
                    NDArray[numpy.float32],
                    dict(shape=(None, 3), order="C", device="cpu", writable=False),
                ]
                | None,
            ]
        ],
        arg1: Sequence[tuple[int, Sequence[float]]],
        arg2: tuple[int, Sequence[float]],
        /,
    ) -> None: ...
    def stats(self) -> dict: ...
    def intersect(
        self,
        origins: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        directions: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        tree: bool = True,
        isa: str = "",
    ) -> tuple[object, object]: ...
    def occluded(
        self,
        origins: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        directions: Annotated[
            NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
        ],
        limits: Annotated[
            NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
        ],
        tree: bool = True,
        isa: str = "",
    ) -> object: ...
    def light_sample(
        self, origin: Sequence[float], seed: int, n: int
    ) -> tuple[object, object, object]: ...

class View:
    """A camera and settings, checked."""

def make_view(
    scene: Scene,
    *,
    eye: Sequence[float],
    target: Sequence[float],
    up: Sequence[float],
    fov: float,
    vfov: float,
    aperture_radius: float,
    focus_distance: float,
    width: int,
    height: int,
    filter: str,
    filter_radius: float,
    sampler: str,
    seed: int,
    max_depth: int,
    roulette: bool,
    tree: bool,
) -> View: ...

class Film:
    """The sums of a rectangle of the picture."""

    def __init__(self, x: int, y: int, width: int, height: int) -> None: ...
    def render(
        self,
        scene: Scene,
        view: View,
        first: int,
        last: int,
        *,
        threads: int,
        tile: int,
        schedule: str,
        isa: str,
        tick: object | None,
    ) -> tuple[int, int, bool]: ...
    def arrays(self) -> tuple[object, object, object]: ...

def one_sample(
    scene: Scene, view: View, x: int, y: int, sample: int, isa: str = ""
) -> list[float]: ...
def tables() -> dict: ...
def instruction_sets() -> list[str]: ...
def instruction_set() -> str: ...
def release_threads() -> None: ...
def warp(
    name: str,
    parameter: float,
    u: Annotated[
        NDArray[numpy.float32], dict(shape=(None, 2), order="C", device="cpu", writable=False)
    ],
) -> object: ...
def warp_pdf(
    name: str,
    parameter: float,
    w: Annotated[
        NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
    ],
) -> object: ...
def bsdf_sample(
    material: tuple[int, Sequence[float]], wo: Sequence[float], seed: int, n: int
) -> tuple[object, object, object, object]: ...
def bsdf_eval(
    material: tuple[int, Sequence[float]],
    wo: Sequence[float],
    wi: Annotated[
        NDArray[numpy.float32], dict(shape=(None, 3), order="C", device="cpu", writable=False)
    ],
) -> tuple[object, object]: ...
def draws(
    sampler: str, x: int, y: int, first: int, n: int, dimension: int, seed: int
) -> object: ...
def filter_offsets(
    filter: str,
    radius: float,
    u: Annotated[
        NDArray[numpy.float32], dict(shape=(None,), order="C", device="cpu", writable=False)
    ],
) -> object: ...
def filter_values(filter: str, radius: float, x: Sequence[float]) -> list[float]: ...
