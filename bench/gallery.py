"""The scenes that are measured, as ours: what every renderer is given is made of these."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph
from parhelion import tables
from parhelion.framing import placed
from parhelion.image import is_encoded, read_pixels
from parhelion.io import LoadOptions
from parhelion.scene import Shape

from .scenes import LAMP_FLOOR, SHARED, WEEKEND, BenchError, Weekend, cloud, lamps, read_weekend

# Rays a path where a scene asks for more.
MOST_DEPTH = 50


def load(name: str, pixels: int) -> ph.Scene:
    """A scene of the gallery, with a camera, and settings for a picture of about so many pixels.

    Raises BenchError if it cannot be had.
    """
    try:
        scene = SCENES[name]()
    except ph.ParhelionError as error:
        raise BenchError(f"{name}: {error}") from error
    return fitted(scene, pixels)


def fitted(scene: ph.Scene, pixels: int) -> ph.Scene:
    """A scene with its camera placed, and settings for a picture of about so many pixels."""
    s = scene.settings
    height = round((pixels * s.height / s.width) ** 0.5)
    width = round(height * s.width / s.height)
    depth = min(s.max_depth, MOST_DEPTH)
    return scene.replace(
        camera=placed(scene, width / height),
        settings=replace(s, width=width, height=height, max_depth=depth),
    )


def picture_job(name: str, scene: ph.Scene, pixels: int, threads: int) -> dict[str, Any]:
    """What a worker is told that renders a scene of the gallery, which load() has given."""
    s = scene.settings
    job = {"scene": name, "pixels": pixels, "threads": threads}
    return job | {"width": s.width, "height": s.height, "depth": s.max_depth}


def of_job(job: dict[str, Any]) -> ph.Scene:
    """That of a job with "scene", a name of the gallery, and "pixels", how many its picture has, or
    with "spheres", the path of a weekend file.
    """
    if "scene" in job:
        return load(job["scene"], job["pixels"])
    return weekend_scene(read_weekend(Path(job["spheres"]), fuzz=job["fuzz"]))


# --- As they are given ---------------------------------------------------------------------------


def of_file(path: str) -> ph.Scene:
    """One of the shared scenes."""
    file = SHARED / path
    if not file.exists():
        raise BenchError(f"{file}: no such file")
    return ph.load(file, LoadOptions(allow_paths=(str(SHARED),)))


def helmet() -> ph.Scene:
    """The glTF helmet alone in a garden."""
    scene = of_file("gltf/DamagedHelmet/DamagedHelmet.glb")
    garden = ph.Background("envmap", image=str(SHARED / "hdr" / "chinese_garden_1k.hdr"))
    return scene.replace(shapes=scene.shapes[:1], background=garden, lights=())


def matpreview(material: ph.Material) -> ph.Scene:
    """Mitsuba's preview of materials, with another one."""
    scene = of_file("mitsuba-data/scenes/matpreview/matpreview.xml")
    return scene.replace(materials={**scene.materials, "bsdf-matpreview": material})


def lamp_room(count: int, kinds: int = 8) -> ph.Scene:
    """The floor under lamps, with balls on it; none of the lamps is seen, as they shine down only.

    kinds: how many different strengths they have.
    """
    vertices, radiance = lamps(count)
    vertices[:, :, 1] = vertices[:, :1, 1]
    a, b, c = (vertices[:, k] for k in range(3))
    upwards = np.cross(b - a, c - a)[:, 1] > 0
    vertices[upwards] = vertices[upwards][:, ::-1]
    white = ph.Material("diffuse", color=(0.7, 0.7, 0.7))
    grid = np.linspace(-0.8, 0.8, 5)
    balls = ph.Spheres([(x, 0.12, z) for x in grid for z in grid], 0.12, white)
    shapes: list[Shape] = [_floor(white), balls]
    for some in np.array_split(np.argsort(radiance), kinds):
        strength = (float(radiance[some].mean()),) * 3
        black = ph.Material("diffuse", color=(0.0, 0.0, 0.0), emission=strength)
        faces = np.arange(3 * some.size).reshape(-1, 3)
        shapes.append(ph.Mesh(vertices[some].reshape(-1, 3), faces, material=black, name="lamps"))
    camera = ph.Camera(eye=(0.0, 3.0, 3.2), target=(0.0, 0.1, 0.0), vfov=35.0)
    return ph.Scene(shapes, camera=camera, background=None, settings=ph.Settings(max_depth=5))


def _floor(material: ph.Material) -> ph.Mesh:
    corners = [[-50, 0, 50], [60, 0, 50], [60, 0, -50], [-50, 0, -50]]
    return ph.Mesh(corners, [[0, 1, 2], [0, 2, 3]], material=material, name="floor")


def weekend_scene(weekend: Weekend) -> ph.Scene:
    """The same spheres, camera and sky as all others are given."""
    diffuse, metal, glass = (list(weekend.of(kind)) for kind in ("diffuse", "metal", "glass"))
    materials = {
        f"metal {i}": ph.Material("metal", color=s["albedo"], fuzz=s["fuzz"])
        for i, s in enumerate(metal)
    }
    indices = {ior: len(materials) + i for i, ior in enumerate({s["ior"] for s in glass})}
    materials |= {f"glass {ior}": ph.Material("dielectric", ior=ior) for ior in indices}
    groups = (
        (diffuse, ph.Material("diffuse"), [s["albedo"] for s in diffuse]),
        (metal, np.arange(len(metal)), None),
        (glass, np.array([indices[s["ior"]] for s in glass]), None),
    )
    shapes = [
        ph.Spheres([s["center"] for s in spheres], [s["radius"] for s in spheres], material, colors)
        for spheres, material, colors in groups
        if spheres
    ]
    c = weekend.camera
    camera = ph.Camera(
        eye=tuple(c["lookfrom"]),
        target=tuple(c["lookat"]),
        up=tuple(c["vup"]),
        vfov=c["vfov"],
        aperture_radius=c["aperture_radius"],
        focus_distance=c["focus_distance"],
    )
    return ph.Scene(shapes, materials, camera, ph.Background("gradient", **weekend.sky))


def cloud_scene(count: int, glass: bool = False) -> ph.Scene:
    """A box of random diffuse spheres in white light; glass: every second one is of glass."""
    centers, radius = cloud(count)
    materials = {"diffuse": ph.Material("diffuse", color=(0.8, 0.8, 0.8))}
    material: str | np.ndarray = "diffuse"
    if glass:
        materials["glass"] = ph.Material("dielectric")
        material = np.arange(count, dtype=np.uint32) & 1
    # Radii of their own, as a user's spheres have.
    spheres = ph.Spheres(centers, np.full(count, radius, np.float32), material)
    camera = ph.Camera(eye=(0.5, 0.5, 3.0), target=(0.5, 0.5, 0.5), vfov=30.0)
    white = ph.Background("constant", radiance=(1.0, 1.0, 1.0))
    return ph.Scene([spheres], materials, camera, background=white)


def lamp_mesh(count: int) -> ph.Mesh:
    """Small lamps, each a triangle of its own radiance."""
    vertices, radiance = lamps(count)
    return ph.Mesh(
        vertices.reshape(-1, 3),
        np.arange(3 * count).reshape(-1, 3),
        material=ph.Material("emissive"),
        colors=np.repeat(radiance[:, None], 3, axis=1),
    )


def lamp_scene(count: int) -> ph.Scene:
    """A white floor under small lamps, seen from just above it, so that none is in the way."""
    floor = _floor(ph.Material("diffuse", color=(1.0, 1.0, 1.0)))
    camera = ph.Camera(
        eye=(0.0, 0.01, 0.0),
        target=(0.0, 0.0, 0.0),
        up=(0.0, 0.0, -1.0),
        projection="orthographic",
        height=LAMP_FLOOR,
    )
    return ph.Scene([floor, lamp_mesh(count)], camera=camera, background=None)


SCENES: dict[str, Callable[[], ph.Scene]] = {
    "weekend": lambda: weekend_scene(read_weekend(WEEKEND)),
    "cornell-box": partial(of_file, "bitterli-cornell-box/mitsuba3/scene.xml"),
    "veach-mis": partial(of_file, "bitterli-veach-mis/mitsuba3/scene.xml"),
    "plastic": partial(of_file, "mitsuba-data/scenes/matpreview/matpreview.xml"),
    "rough-gold": lambda: matpreview(
        ph.Material(
            "conductor",
            eta=(0.143, 0.375, 1.442),  # Mitsuba's "Au"
            k=(3.983, 2.386, 1.603),
            roughness=0.4,
            compensation="off",
        )
    ),
    "helmet": helmet,
    "sponza": partial(of_file, "lajolla/sponza/sponza.xml"),
    "coffee": partial(of_file, "bitterli-coffee/scene-v4.pbrt"),
    "classroom": partial(of_file, "bitterli-classroom/scene-v4.pbrt"),
    "lamps-1e3": partial(lamp_room, 1000),
    "cloud-1e4": lambda: cloud_scene(10**4).replace(settings=ph.Settings(max_depth=8)),
    "cloud-1e6": lambda: cloud_scene(10**6).replace(settings=ph.Settings(max_depth=8)),
}


# --- For those who convert them ------------------------------------------------------------------


@dataclass(frozen=True)
class Piece:
    """A mesh or spheres, all of one material; name: another for each piece."""

    name: str
    shape: ph.Mesh | ph.Spheres
    material: ph.Material

    @property
    def emission(self) -> Any:
        """Radiance, three numbers or a Texture, or None where the material does not shine."""
        key = "radiance" if self.material.type == "emissive" else "emission"
        radiance = self.material.params.get(key)
        return radiance if isinstance(radiance, ph.Texture) or np.any(radiance or 0.0) else None


def pieces(scene: ph.Scene) -> Iterator[Piece]:
    """Raises BenchError for what the conversions do not know."""
    materials = list(scene.materials.values())
    for number, shape in enumerate(scene.shapes):
        if not isinstance(shape, (ph.Mesh, ph.Spheres)):
            raise BenchError(f"no conversion of {type(shape).__name__}")
        name, material = f"shape{number}", shape.material
        if isinstance(material, str):
            yield Piece(name, shape, scene.materials[material])
        elif isinstance(material, ph.Material):
            yield Piece(name, shape, material)
        elif isinstance(shape, ph.Spheres) and shape.colors is None:
            indices, radii = np.asarray(material), np.broadcast_to(shape.radii, len(shape.centers))
            for index in np.unique(indices).tolist():
                some = indices == index
                part = replace(shape, centers=np.asarray(shape.centers)[some], radii=radii[some])
                yield Piece(f"{name}_{index}", part, materials[index])
        else:
            raise BenchError(f"no conversion of {shape.name} with a material for each primitive")


def values(material: ph.Material) -> dict[str, Any]:
    """All parameters of a material's own type, those not given too; not what all types have."""
    listed = tables.entry("materials", material.type, material.type).params
    defaults = {
        p.name: p.choices[int(p.default[0])]
        if p.choices
        else (p.default if p.size > 1 else p.default[0])
        for p in listed
    }
    return {name: material.params.get(name, default) for name, default in defaults.items()}


def pixels(texture: ph.Texture) -> tuple[np.ndarray, bool]:
    """An image texture's array, its first row at the top, and whether that is sRGB.

    Raises BenchError for another type.
    """
    if texture.type != "image":
        raise BenchError(f"no conversion of textures of type {texture.type!r}")
    image = texture.params["image"]
    array = read_pixels(image) if is_encoded(image) else np.asarray(image)
    space = texture.params.get("color_space", "auto")
    srgb = space == "srgb" or (space == "auto" and array.dtype == np.uint8)
    channel = texture.params.get("channel", "rgb")
    if channel in "rgba" and channel != "rgb":
        array = array[..., "rgba".index(channel)]
    return array, srgb


def surroundings(background: ph.Light, forwards: Any, up: Any) -> np.ndarray:
    """(512, 1024, 3) radiance: the background as a map of directions, `forwards` in its middle."""
    camera = ph.Camera((0.0,) * 3, tuple(forwards), tuple(up), projection="equirectangular")
    size = {"width": 1024, "height": 512, "filter": "box", "filter_radius": 0.5}
    return ph.render(ph.Scene(camera=camera, background=background), spp=16, **size).numpy()
