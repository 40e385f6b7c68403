"""LuxCore, as the module `pyluxcore` from PyPI."""

from __future__ import annotations

import atexit
import os
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph

from ..gallery import Piece, of_job, pieces, pixels, surroundings, values
from ..scenes import BenchError
from . import Clock

# Each sphere is an object of 5 kB; 1e5 of them took 19 s to define, 2e4 took 2.7 s.
MANY = 20_000

# Subdivisions of spheres: 20 * 4^n triangles.
OPAQUE, CLEAR = 4, 6

# With more, light is chosen from a cache, which takes seconds to make. Of a thousand lamps it takes
# the error at equal samples to 0.29, and the time of a sample to 1.17.
FEW_LIGHTS = 100

# How often it is asked whether it has all samples, in seconds.
PATIENCE = 0.002

Properties = dict[str, Any]
Ball = tuple[np.ndarray, np.ndarray]  # of unit radius: vertices, which are the normals too; faces


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has what gallery.of_job() takes."""
    with Clock() as converting:
        scene = _Conversion(of_job(job), job["width"], job["height"])
    # After all that imports: its allocator takes the place of the system's, and what other modules
    # bring later ends the process (pyluxcore 2.11.2).
    import pyluxcore as lux

    lux.Init(lambda _message: None)
    # It crashes where Python takes it down. Errors are told through the pipe, not by the status.
    atexit.register(os._exit, 0)
    settings = _settings(job)
    if scene.lights > FEW_LIGHTS:
        folder = tempfile.TemporaryDirectory(prefix="bench-luxcore-")
        atexit.register(folder.cleanup)  # before it ends as above
        settings["lightstrategy.type"] = "DLS_CACHE"
        settings["lightstrategy.persistent.file"] = str(Path(folder.name) / "lights")
    with Clock() as making:
        config = lux.RenderConfig(_properties(lux, settings), scene.made(lux))

    def render(request: dict[str, Any]) -> dict[str, Any]:
        changed = {"batch.haltspp": [request["spp"], 0], "renderengine.seed": request["seed"] + 1}
        config.Parse(_properties(lux, changed))
        session = lux.RenderSession(config)
        with Clock() as starting:
            session.Start()  # builds the tree, again for each picture
        with Clock() as clock:
            while not session.HasDone():
                time.sleep(PATIENCE)
                session.UpdateStats()
        session.Stop()
        if request["save"]:
            picture = np.empty((job["height"], job["width"], 3), np.float32)
            kind = lux.FilmOutputType.RGB_IMAGEPIPELINE
            session.GetFilm().GetOutputFloat(kind, picture, 0, True)
            np.save(request["save"], picture[::-1])
        return clock.times() | {"prepare_seconds": starting.times()["seconds"]}

    built = render({"spp": 1, "seed": 0, "save": None})["prepare_seconds"]
    prepare = built + sum(part.times()["seconds"] for part in (converting, making))
    return {"version": version("pyluxcore"), "prepare_seconds": prepare}, render


def _properties(lux: Any, values: Properties) -> Any:
    made = lux.Properties()
    for name, value in values.items():
        made.Set(lux.Property(name, value))
    return made


def _settings(job: dict[str, Any]) -> Properties:
    depth = job["depth"]
    return {
        "renderengine.type": "PATHCPU",
        "native.threads.count": job["threads"],
        "sampler.type": "SOBOL",
        "sampler.sobol.adaptive.strength": 0.0,
        "path.pathdepth.total": depth,
        "path.pathdepth.diffuse": depth,
        "path.pathdepth.glossy": depth,
        "path.pathdepth.specular": depth,
        # Nothing that makes light dimmer or softer than it is.
        "path.clamping.variance.maxvalue": 0.0,
        "path.forceblackbackground.enable": False,
        "film.width": job["width"],
        "film.height": job["height"],
        "film.filter.type": "NONE",
        "film.imagepipelines.0.0.type": "NOP",
    }


class _Conversion:
    """A scene of ours as LuxCore's properties, meshes and images.

    Raises BenchError for what cannot be given faithfully.
    """

    def __init__(self, ours: ph.Scene, width: int, height: int) -> None:
        self.properties: Properties = {}
        self.meshes: dict[str, tuple[Any, ...]] = {}
        self.images: list[np.ndarray] = []
        self.materials: dict[Any, str] = {}
        self.textures = self.lights = 0
        if ours.lights:
            raise BenchError(f"no conversion of lights of type {ours.lights[0].type!r}")
        self.camera(ours.camera, width, height)
        if ours.background is not None:
            self.background(ours.background)
        for piece in pieces(ours):
            if isinstance(piece.shape, ph.Mesh):
                self.mesh(piece, piece.shape)
                number = len(piece.shape.faces)
            else:
                self.spheres(piece, piece.shape, ours.camera)
                number = len(piece.shape.centers)
            self.lights += number if piece.emission is not None else 0

    def made(self, lux: Any) -> Any:
        """The scene of a pyluxcore."""
        scene = lux.Scene()
        for number, texels in enumerate(self.images):
            height, width, channels = texels.shape
            scene.DefineImageMap(f"image{number}", texels.ravel(), 1.0, channels, width, height)
        for name, arrays in self.meshes.items():
            scene.DefineMeshExt(name, *arrays)
        scene.Parse(_properties(lux, self.properties))
        return scene

    def put(self, group: str, properties: Properties) -> None:
        self.properties |= {f"scene.{group}.{key}": value for key, value in properties.items()}

    def camera(self, c: ph.Camera, width: int, height: int) -> None:
        if c.projection != "perspective" or c.vfov is None:
            raise BenchError("only perspective cameras with a vfov are converted")
        distance = float(np.linalg.norm(np.subtract(c.target, c.eye)))
        aspect, pixel = width / height, 2 / height
        self.put(
            "camera",
            {
                "type": "perspective",
                "lookat.orig": list(c.eye),
                "lookat.target": list(c.target),
                "up": list(c.up),
                "fieldofview": c.vfov,
                # Its rows begin one pixel off.
                "screenwindow": [-aspect, aspect, -1.0 - pixel, 1.0 - pixel],
                "lensradius": c.aperture_radius or 0.0,
                "focaldistance": c.focus_distance or distance,
                "autofocus.enable": False,
                "cliphither": 1e-3 * distance,
                "clipyon": 1e6 * distance,
            },
        )

    def background(self, background: ph.Light) -> None:
        if background.type == "constant":
            radiance = background.params.get("radiance", (1.0, 1.0, 1.0))
            sky: Properties = {"type": "constantinfinite", "color": list(radiance)}
        else:
            # In its middle is -x, and y to the left of that.
            image = self.image(surroundings(background, (-1, 0, 0), (0, 0, 1))[:, ::-1])
            sky = {"type": "infinite", "file": image, "gamma": 1.0}
        self.put("lights.sky", sky)

    # --- Shapes ----------------------------------------------------------------------------------

    def mesh(self, piece: Piece, mesh: ph.Mesh) -> None:
        if mesh.colors is not None or mesh.inside_out:
            raise BenchError("no conversion of meshes with colors, or inside out")
        self.define(piece.name, mesh.vertices, mesh.faces, mesh.normals, mesh.uvs)
        look = {"shape": piece.name, "material": self.material(piece.material, piece.emission)}
        self.put(f"objects.{piece.name}", look)

    def define(self, name: str, points: Any, faces: Any, normals: Any, uvs: Any = None) -> None:
        points, normals, uvs = (
            None if array is None else np.ascontiguousarray(array, np.float32)
            for array in (points, normals, uvs)
        )
        faces = np.ascontiguousarray(faces, np.uint32)
        self.meshes[name] = points, faces, normals, None if uvs is None else [uvs]

    def spheres(self, piece: Piece, spheres: ph.Spheres, camera: ph.Camera) -> None:
        """There are none in LuxCore: a mesh of one, placed for each."""
        centers = np.asarray(spheres.centers, float)
        radii = np.broadcast_to(np.asarray(spheres.radii, float), len(centers))
        if len(centers) > MANY:
            raise BenchError(f"more than {MANY} spheres: see MANY in bench/renderers/luxcore.py")
        objects: Properties = {}
        for i, (center, radius) in enumerate(zip(centers, radii, strict=True)):
            look = piece.material
            if spheres.colors is not None:
                color = tuple(np.asarray(spheres.colors)[i].tolist())
                look = ph.Material(look.type, **{**look.params, "color": color})
            name = f"{piece.name}_{i}"
            objects[f"{name}.material"] = self.material(look, piece.emission, closed=True)
            away = np.subtract(camera.eye, center)
            divided = CLEAR if look.type == "dielectric" else OPAQUE
            if radius > 10 * abs(np.linalg.norm(away) - radius):
                # Placed, it would shade itself: points on a unit sphere are too coarse for it.
                points, faces = _ball_towards(away)
                self.define(f"{name}_ball", center + radius * points, faces, points)
                objects[f"{name}.shape"] = f"{name}_ball"
            else:
                matrix = np.diag([radius] * 3 + [1.0])
                matrix[:3, 3] = center
                objects[f"{name}.shape"] = self.ball(divided)
                objects[f"{name}.transformation"] = matrix.T.ravel().tolist()
        self.put("objects", objects)

    def ball(self, subdivisions: int) -> str:
        """A unit sphere's mesh."""
        name = f"ball{subdivisions}"
        if name not in self.meshes:
            points, faces = _ball(subdivisions)
            self.define(name, points, faces, points)
        return name

    # --- Materials -------------------------------------------------------------------------------

    def material(self, material: ph.Material, emission: Any, closed: bool = False) -> str:
        """The name of one, made if there is none yet. closed: nobody sees the back."""
        key = material, closed
        if key not in self.materials:
            name = self.materials[key] = f"material{len(self.materials)}"
            for word in ("opacity", "bump_map", "normal_map", "back", "absorption"):
                if word in material.params:
                    raise BenchError(f"no conversion of {word}")
            look = self.look(material.type, values(material))
            black = not material.params.get("two_sided", True) and not closed
            if emission is not None:
                # Of what has two materials, light is not sampled.
                if black or material.type == "emissive" or isinstance(emission, ph.Texture):
                    raise BenchError("no conversion of such emission: unlike, or of a black back")
                look["emission"] = [float(x) for x in emission]
                # By itself, it is left to chance hits where a mesh has many triangles.
                look["emission.directlightsampling.type"] = "ENABLED"
            if black and material.type != "dielectric":
                self.put(f"materials.{name}_front", look)
                self.put(f"materials.{name}_back", {"type": "matte", "kd": [0.0, 0.0, 0.0]})
                sides = {"frontmaterial": f"{name}_front", "backmaterial": f"{name}_back"}
                look = {"type": "twosided"} | sides
            self.put(f"materials.{name}", look)
        return self.materials[key]

    def look(self, kind: str, p: dict[str, Any]) -> Properties:
        if kind == "diffuse":
            if p["roughness"]:
                raise BenchError("no conversion of rough diffuse surfaces")
            return {"type": "matte", "kd": self.texture(p["color"])}
        if kind == "metal" and p["fuzz"] == 0:
            return {"type": "mirror", "kr": self.texture(p["color"])}
        if kind == "metal":
            # Its distribution is that of GGX; a colour is what it reflects at right angles.
            # As of Mitsuba's: alpha = f / sqrt(6) blurs as much where light comes from above.
            alpha = p["fuzz"] / sqrt(6)
            fresnel = self.named({"type": "fresnelcolor", "kr": list(p["color"])})
            return {
                "type": "metal2",
                "fresnel": fresnel,
                "uroughness": alpha,
                "vroughness": alpha,
            }
        if kind == "conductor":
            # Its masking and Fresnel terms are other approximations: of rough gold, green is 5 %
            # brighter.
            raise BenchError("no faithful conversion of conductors")
        if kind == "dielectric":
            if tuple(p["color"]) != (1.0, 1.0, 1.0) or p["roughness"]:
                raise BenchError("no conversion of tinted or rough glass")
            return {
                "type": "glass",
                "kr": [1.0, 1.0, 1.0],
                "kt": [1.0, 1.0, 1.0],
                "interiorior": p["ior"],
                "exteriorior": 1.0,
            }
        raise BenchError(f"no conversion of materials of type {kind!r}")

    def texture(self, value: Any) -> Any:
        """A colour, or the name of a texture."""
        if not isinstance(value, ph.Texture):
            return [float(x) for x in value]
        matrix = np.asarray(value.params.get("transform", np.eye(3)), float)
        if matrix[0, 1] or matrix[1, 0]:
            raise BenchError("no conversion of textures that are turned")
        mapping: Properties = {
            "mapping.type": "uvmapping2d",
            "mapping.uvscale": np.diag(matrix)[:2].tolist(),
            "mapping.uvdelta": matrix[:2, 2].tolist(),
        }
        if value.type == "checker":
            colors = {f"texture{1 + i}": self.texture(value.params[f"color{i}"]) for i in (0, 1)}
            mapping["mapping.uvscale"] = (2 * np.diag(matrix)[:2]).tolist()
            mapping["mapping.uvdelta"] = (2 * matrix[:2, 2]).tolist()
            return self.named({"type": "checkerboard2d"} | colors | mapping)
        array, srgb = pixels(value)
        texels = array.astype(np.float32) / (255 if array.dtype == np.uint8 else 1)
        if srgb:  # exactly, where "gamma" is a power
            texels = np.where(texels <= 0.04045, texels / 12.92, ((texels + 0.055) / 1.055) ** 2.4)
        image = self.image(texels[::-1])  # our v runs up a picture, LuxCore's down
        return self.named({"type": "imagemap", "file": image, "gamma": 1.0} | mapping)

    def named(self, texture: Properties) -> str:
        name = f"texture{self.textures}"
        self.textures += 1
        self.put(f"textures.{name}", texture)
        return name

    def image(self, texels: np.ndarray) -> str:
        """The name of one of linear texels."""
        array = texels if texels.ndim == 3 else texels[..., None]
        self.images.append(np.ascontiguousarray(array, np.float32))
        return f"image{len(self.images) - 1}"


def _ball(subdivisions: int) -> Ball:
    """An icosahedron whose triangles are divided in four, again and again."""
    golden = (1 + sqrt(5)) / 2
    corners = [np.roll([0.0, s, t * golden], k) for k in range(3) for s in (-1, 1) for t in (-1, 1)]
    points = np.array(corners) / np.linalg.norm(corners[0])
    near = points @ points.T > 0.4
    triples = np.array([(a, b, c) for a in range(12) for b in range(a, 12) for c in range(a, 12)])
    a, b, c = triples.T
    outside = np.linalg.det(points[triples]) > 0.1  # in the order that is seen from there
    faces = triples[near[a, b] & near[b, c] & near[c, a] & outside]
    for _ in range(subdivisions):
        a, b, c = faces.T
        edges = np.sort(np.concatenate([np.stack(e, 1) for e in ((a, b), (b, c), (c, a))]), axis=1)
        each, where = np.unique(edges, axis=0, return_inverse=True)
        middle = points[each].sum(axis=1)
        ab, bc, ca = len(points) + where.reshape(3, -1)
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
        parts = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
        faces = np.concatenate([np.stack(part, 1) for part in parts])
    return points, faces


def _ball_towards(direction: np.ndarray) -> Ball:
    """Of a sphere much larger than what is seen of it, the finer the nearer to a direction.

    Rings around that, each 2.5 % further from it than the one before, so that at a distance d along
    the surface triangles lie below it by 1e-4 d^2 / radius at most.
    """
    rings, around = 512, 512
    angle = 3.0 * np.exp(np.linspace(-0.025 * rings, 0.0, rings))[:, None]
    turn = 2 * np.pi * np.arange(around)[None, :] / around
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    parts = np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle) + 0 * turn
    ring = np.stack(parts, axis=2).reshape(-1, 3) @ np.stack([x, np.cross(z, x), z])
    at = np.arange(rings * around).reshape(rings, around)
    following = np.roll(at, -1, axis=1)
    a, b, c, d = (part.ravel() for part in (at[:-1], following[:-1], at[1:], following[1:]))
    top, bottom = (np.full(around, at.size + k) for k in (0, 1))
    caps = (top, at[0], following[0]), (bottom, following[-1], at[-1])
    faces = np.concatenate([np.stack(side, 1) for side in ((a, c, d), (a, d, b), *caps)])
    return np.concatenate([ring, [z, -z]]), faces
