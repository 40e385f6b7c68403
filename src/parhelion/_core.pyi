"""Types of the compiled module; bindings/ is its source."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Block = tuple[int, list[float]]

class Scene:
    def __init__(self, parts: dict[str, Any], memory_limit: int | None = None) -> None: ...
    def stats(self) -> dict[str, Any]: ...
    def tree_cost(self) -> tuple[float, float]: ...
    def intersect(
        self, origins: Floats, directions: Floats, tree: bool = True, isa: str = ""
    ) -> tuple[Floats, NDArray[np.int64]]: ...
    def occluded(
        self, origins: Floats, directions: Floats, limits: Floats, tree: bool = True, isa: str = ""
    ) -> NDArray[np.uint8]: ...
    def light_sample(
        self, origin: Sequence[float], seed: int, n: int
    ) -> tuple[Floats, Floats, Floats, Floats]: ...

met_columns: dict[str, int]
few_rays: int

def intersect_rays(
    scene: Scene,
    n: int,
    origins: NDArray[Any],
    directions: NDArray[Any],
    limits: NDArray[Any],
    tree: bool,
    isa: str,
) -> tuple[
    NDArray[np.float64],
    NDArray[np.int32],
    NDArray[np.int64],
    NDArray[np.int32],
    NDArray[np.int64],
    NDArray[np.uint32],
]: ...
def occluded_rays(
    scene: Scene,
    n: int,
    origins: NDArray[Any],
    directions: NDArray[Any],
    limits: NDArray[Any],
    tree: bool,
    isa: str,
) -> NDArray[np.uint8]: ...
def points_met(scene: Scene, rays: NDArray[np.uint32], isa: str) -> NDArray[np.uint32]: ...

class View:
    def but(self, seed: int, reuse_paths: bool) -> View: ...

class Film:
    x: int
    y: int
    width: int
    height: int
    has_features: bool
    has_errors: bool
    def __init__(
        self,
        x: int,
        y: int,
        width: int,
        height: int,
        features: bool = False,
        errors: bool = False,
    ) -> None: ...
    def begin(self, counts: NDArray[np.uint32]) -> None: ...
    def add(self, part: Film, begun: NDArray[np.uint32]) -> None: ...
    def render(
        self,
        scene: Scene,
        view: View,
        targets: int | NDArray[np.uint32],
        *,
        threads: int,
        tile: int,
        schedule: str,
        isa: str,
        tick: Callable[[int, int], bool] | None,
    ) -> tuple[int, int, bool]: ...
    def errors(self) -> NDArray[np.float64]: ...
    def variances(self) -> Floats: ...
    def memory(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]: ...
    def features(self, unit: float) -> dict[str, NDArray[Any]]: ...
    def mattes(
        self, shape_ids: NDArray[np.uint32], material_ids: NDArray[np.uint32]
    ) -> tuple[Floats, Floats]: ...
    def arrays(self) -> tuple[Floats, NDArray[np.uint32], NDArray[np.uint32]]: ...

sources: str
block: int
region: int

def make_view(scene: Scene, **settings: Any) -> View: ...
def render_films(
    scene: Scene,
    films: Sequence[tuple[Film, View]],
    samples: int,
    *,
    threads: int,
    tile: int,
    schedule: str,
    isa: str,
    tick: Callable[[int, int], bool] | None,
) -> tuple[int, int, bool]: ...
def one_sample(
    scene: Scene, view: View, x: int, y: int, sample: int, isa: str = ""
) -> list[float]: ...
def trace_pixel(scene: Scene, view: View, x: int, y: int, sample: int) -> dict[str, Any]: ...
def tables() -> dict[str, list[Any]]: ...
def traversal_seconds() -> float: ...
def max_threads() -> int: ...
def set_max_threads(count: int) -> None: ...
def instruction_sets() -> list[str]: ...
def instruction_set() -> str: ...
def warp(name: str, parameter: float, u: Floats) -> Floats: ...
def warp_pdf(name: str, parameter: float, w: Floats) -> Floats: ...
def bsdf_sample(
    material: Block, wo: Sequence[float], seed: int, n: int, sampler: str = "independent"
) -> tuple[Floats, Floats, Floats, NDArray[np.uint8]]: ...
def bsdf_eval(material: Block, wo: Sequence[float], wi: Floats) -> tuple[Floats, Floats]: ...
def draws(
    sampler: str, x: int, y: int, first: int, n: int, dimension: int, seed: int
) -> Floats: ...
def filter_offsets(filter: str, radius: float, u: Floats) -> Floats: ...
def filter_values(filter: str, radius: float, x: Sequence[float]) -> list[float]: ...

class ObjError(ValueError): ...

def numbers(text: bytes | NDArray[np.uint8]) -> NDArray[np.float64]: ...
def distinct_rows(rows: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]: ...
def shading(
    vertices: NDArray[np.floating[Any]], faces: NDArray[np.uint32], crease: float | None
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32]]: ...
def polygons(
    vertices: NDArray[np.float64], counts: NDArray[np.uint32], corners: NDArray[np.uint32]
) -> NDArray[np.uint32]: ...
def obj(text: bytes) -> dict[str, Any]: ...
