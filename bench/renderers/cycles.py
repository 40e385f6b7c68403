"""Cycles, Blender's renderer, as the module `bpy` from PyPI."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from math import radians, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np

import parhelion as ph
from parhelion.image import read_pixels

from ..gallery import Piece, of_job, pieces, pixels, surroundings, values
from ..scenes import BenchError
from . import Clock


def open(job: dict[str, Any]) -> tuple[dict[str, Any], Callable[[dict[str, Any]], dict[str, Any]]]:
    """A job has what gallery.of_job() takes."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    folder = tempfile.TemporaryDirectory(prefix="bench-cycles-")
    _settings(scene, job)
    _Conversion(bpy, scene, Path(folder.name)).all(of_job(job))

    def render(request: dict[str, Any]) -> dict[str, Any]:
        scene.cycles.samples = request["spp"]
        scene.cycles.seed = request["seed"]
        scene.update_tag()  # else, with persistent data, they are those of the picture before
        with Clock() as clock:
            bpy.ops.render.render()
        if request["save"]:
            picture = str(Path(folder.name) / "picture.exr")
            bpy.data.images["Render Result"].save_render(picture)
            np.save(request["save"], read_pixels(picture)[..., :3])
        return clock.times()

    # The first render builds the tree, which the next ones keep.
    first, again = (render({"spp": 1, "seed": 0, "save": None})["seconds"] for _ in range(2))
    known: dict[str, Any] = {
        "version": bpy.app.version_string,
        "prepare_seconds": max(0.0, first - again),
    }
    return known, render


def _settings(scene: Any, job: dict[str, Any]) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = job["width"], job["height"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", job["threads"]
    render.use_persistent_data = True
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.use_auto_tile = False
    cycles.pixel_filter_type = "BOX"
    # Nothing that makes light dimmer or softer than it is.
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, f"{kind}_bounces", job["depth"] - 1)


class _Conversion:
    """Fills a Blender scene with ours; images go through files in folder."""

    def __init__(self, bpy: Any, scene: Any, folder: Path) -> None:
        self.bpy, self.scene, self.folder = bpy, scene, folder
        self.materials: dict[Any, Any] = {}

    def all(self, ours: ph.Scene) -> None:
        """Raises BenchError for what cannot be given faithfully."""
        self.camera(ours.camera)
        self.world(ours.background)
        for light in ours.lights:
            self.sun(light)
        for piece in pieces(ours):
            if isinstance(piece.shape, ph.Mesh):
                self.mesh(piece, piece.shape)
            elif piece.emission is not None:  # points are not sampled, lamps not seen
                self.round_meshes(piece, piece.shape, 4)
            elif piece.material.type == "dielectric":
                self.round_meshes(piece, piece.shape, 6)
            else:  # exact, but opaque
                self.points(piece, piece.shape)

    def place(self, name: str, data: Any, matrix: Any = None) -> Any:
        """A new object of the scene."""
        made = self.bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(made)
        if matrix is not None:
            from mathutils import Matrix

            made.matrix_world = Matrix(matrix.tolist())
        return made

    def camera(self, c: ph.Camera) -> None:
        if c.projection != "perspective" or c.vfov is None:
            raise BenchError("only perspective cameras with a vfov are converted")
        data = self.bpy.data.cameras.new("camera")
        data.sensor_fit = "VERTICAL"
        data.lens = 0.5 * data.sensor_height / tan(radians(0.5 * c.vfov))
        distance = float(np.linalg.norm(np.subtract(c.target, c.eye)))
        data.clip_start, data.clip_end = 1e-3 * distance, 1e4 * distance
        if c.aperture_radius:
            data.dof.use_dof = True
            data.dof.focus_distance = c.focus_distance or distance
            data.dof.aperture_fstop = 1e-3 * data.lens / (2 * c.aperture_radius)
        back = np.subtract(c.eye, c.target)
        self.scene.camera = self.place("camera", data, _frame(back, c.up, c.eye))

    def world(self, background: ph.Light | None) -> None:
        self.scene.world = world = self.bpy.data.worlds.new("world")
        world.use_nodes = True
        shader = world.node_tree.nodes["Background"]
        if background is None:
            shader.inputs["Strength"].default_value = 0.0
        elif background.type == "constant":
            radiance = background.params.get("radiance", (1.0, 1.0, 1.0))
            shader.inputs["Color"].default_value = (*radiance, 1.0)
        else:
            texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
            texture.image = self.image(surroundings(background, (1, 0, 0), (0, 0, 1)), False)
            world.node_tree.links.new(texture.outputs["Color"], shader.inputs["Color"])

    def sun(self, light: ph.Light) -> None:
        if light.type != "directional":
            raise BenchError(f"no conversion of lights of type {light.type!r}")
        data = self.bpy.data.lights.new("sun", "SUN")
        data.energy, data.color = _strength(light.params["irradiance"])
        data.angle = radians(light.params.get("angle", 0.0))
        direction = np.asarray(light.params["direction"], float)
        across = np.eye(3)[np.argmin(np.abs(direction))]
        self.place("sun", data, _frame(-direction, across, (0, 0, 0)))

    # --- Shapes ----------------------------------------------------------------------------------

    def mesh(self, piece: Piece, mesh: ph.Mesh) -> None:
        if mesh.colors is not None or mesh.inside_out:
            raise BenchError("no conversion of meshes with colors, or inside out")
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
        data = self.bpy.data.meshes.new(piece.name)
        data.vertices.add(len(vertices))
        data.vertices.foreach_set("co", vertices.ravel())
        data.loops.add(faces.size)
        data.loops.foreach_set("vertex_index", faces.ravel())
        data.polygons.add(len(faces))
        data.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
        smooth = mesh.normals is not None
        data.polygons.foreach_set("use_smooth", np.full(len(faces), smooth))
        if mesh.uvs is not None:
            uvs = np.asarray(mesh.uvs, np.float32)[faces.ravel()]
            data.uv_layers.new().data.foreach_set("uv", uvs.ravel())
        data.update(calc_edges=True)
        data.validate()
        if smooth:
            data.normals_split_custom_set_from_vertices(np.asarray(mesh.normals, float).tolist())
        data.materials.append(self.material(piece))
        self.place(piece.name, data)

    def points(self, piece: Piece, spheres: ph.Spheres) -> None:
        """A point cloud, which Blender makes of a mesh without faces."""
        centers = np.asarray(spheres.centers, np.float32)
        data = self.bpy.data.meshes.new(piece.name)
        data.vertices.add(len(centers))
        data.vertices.foreach_set("co", centers.ravel())
        radii = np.broadcast_to(np.asarray(spheres.radii, np.float32), len(centers))
        radius = data.attributes.new("radius", "FLOAT", "POINT")
        radius.data.foreach_set("value", np.ascontiguousarray(radii))
        if spheres.colors is not None:
            colors = np.ones((len(centers), 4), np.float32)
            colors[:, :3] = spheres.colors
            own = data.attributes.new("own", "FLOAT_COLOR", "POINT")
            own.data.foreach_set("color", colors.ravel())
        made = self.place(piece.name, data)
        with self.bpy.context.temp_override(active_object=made, selected_objects=[made]):
            self.bpy.context.view_layer.objects.active = made
            made.select_set(True)
            self.bpy.ops.object.convert(target="POINTCLOUD")
            made.select_set(False)
        made.data.materials.clear()
        made.data.materials.append(self.material(piece, own_colors=spheres.colors is not None))

    def round_meshes(self, piece: Piece, spheres: ph.Spheres, roundness: int) -> None:
        """One mesh of 20 * 4^roundness triangles, placed for each."""
        self.bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=roundness + 1, radius=1.0)
        first = self.bpy.context.object
        data = first.data
        self.bpy.data.objects.remove(first)
        data.polygons.foreach_set("use_smooth", np.full(len(data.polygons), True))
        data.materials.append(self.material(piece))
        centers = np.asarray(spheres.centers)
        radii = np.broadcast_to(spheres.radii, len(centers))
        for center, radius in zip(centers, radii, strict=True):
            matrix = np.diag([radius] * 3 + [1.0])
            matrix[:3, 3] = center
            self.place(piece.name, data, matrix)

    # --- Materials -------------------------------------------------------------------------------

    def material(self, piece: Piece, own_colors: bool = False) -> Any:
        key = piece.material, own_colors
        if key not in self.materials:
            made = self.bpy.data.materials.new(piece.name)
            made.use_nodes = True
            made.node_tree.nodes.clear()
            _Nodes(self, made).all(piece, own_colors)
            self.materials[key] = made
        return self.materials[key]

    def image(self, array: np.ndarray, srgb: bool) -> Any:
        """By way of a file, which is what Cycles reads textures from."""
        import OpenImageIO as oiio

        ending = "png" if array.dtype == np.uint8 else "exr"
        path = str(self.folder / f"{len(self.bpy.data.images)}.{ending}")
        array = np.ascontiguousarray(array if array.ndim == 3 else array[..., None])
        height, width, channels = array.shape
        output = oiio.ImageOutput.create(path)
        output.open(path, oiio.ImageSpec(width, height, channels, str(array.dtype)))
        output.write_image(array)
        output.close()
        image = self.bpy.data.images.load(path)
        image.colorspace_settings.name = "sRGB" if srgb else "Non-Color"
        return image


class _Nodes:
    """The shader of one material."""

    def __init__(self, conversion: _Conversion, material: Any) -> None:
        self.conversion, self.tree, self.settings = conversion, material.node_tree, material.cycles

    def all(self, piece: Piece, own_colors: bool) -> None:
        material = piece.material
        for key in ("opacity", "bump_map", "back", "absorption"):
            if key in material.params:
                raise BenchError(f"no conversion of {key}")
        p = values(material)
        if own_colors:
            p["color"] = self.new("ShaderNodeAttribute", attribute_name="own").outputs["Color"]
        shader = None
        if material.type != "emissive" and np.any(p["color"] != (0.0, 0.0, 0.0)):
            shader = self.surface(material.type, p)
        if material.params.get("normal_map") is not None:
            normals = self.new("ShaderNodeNormalMap")
            self.give(normals.inputs["Color"], material.params["normal_map"])
            self.tree.links.new(normals.outputs["Normal"], shader.inputs["Normal"])
        result = shader.outputs[0] if shader else None
        both = material.params.get("two_sided", True) or material.type == "dielectric"
        if shader and not both:
            result = self.front(result)
        if piece.emission is not None:
            result = self.shining(piece, result)
        output = self.new("ShaderNodeOutputMaterial")
        self.tree.links.new(result, output.inputs["Surface"])

    def shining(self, piece: Piece, surface: Any) -> Any:
        """Emission of the front, added to the surface."""
        emission = self.new("ShaderNodeEmission")
        if isinstance(piece.emission, ph.Texture):
            self.give(emission.inputs["Color"], piece.emission)
        else:
            emission.inputs["Strength"].default_value, color = _strength(piece.emission)
            self.give(emission.inputs["Color"], color)
        result = emission.outputs[0]
        if piece.material.type != "emissive":
            self.settings.emission_sampling = "FRONT"
            result = self.front(result)
        if surface is None:
            return result
        both = self.new("ShaderNodeAddShader")
        self.tree.links.new(surface, both.inputs[0])
        self.tree.links.new(result, both.inputs[1])
        return both.outputs[0]

    def front(self, shader: Any) -> Any:
        """Black on the back."""
        mix = self.new("ShaderNodeMixShader")
        geometry = self.new("ShaderNodeNewGeometry")
        self.tree.links.new(geometry.outputs["Backfacing"], mix.inputs["Fac"])
        self.tree.links.new(shader, mix.inputs[1])
        return mix.outputs[0]

    def surface(self, kind: str, p: dict[str, Any]) -> Any:
        """The node of a BSDF. Our roughness is Cycles' too: the square root of alpha."""
        ggx = {"ggx": "GGX", "beckmann": "BECKMANN"}.get(p.get("distribution", "ggx"))
        roughness = p.get("roughness", 0.0)
        if kind == "diffuse":
            return self.bsdf("Diffuse", {"Color": p["color"], "Roughness": 0.0})
        if kind == "metal":
            # As of Mitsuba's: alpha = f / sqrt(6) blurs as much where light comes from above.
            blur = sqrt(p["fuzz"] / sqrt(6))
            inputs = {"Color": p["color"], "Roughness": blur}
            return self.bsdf("Anisotropic", inputs, distribution="BECKMANN")
        if kind == "conductor":
            inputs = {"IOR": p["eta"], "Extinction": p["k"], "Roughness": roughness}
            made = self.bsdf(
                "Metallic", inputs, fresnel_type="PHYSICAL_CONDUCTOR", distribution=ggx
            )
            return self.dimmed(made, p["color"])
        if kind == "dielectric":
            inputs = {"Color": p["color"], "IOR": p["ior"], "Roughness": roughness}
            return self.bsdf("Glass", inputs, distribution=ggx)
        if kind in ("plastic", "principled"):
            inputs = {"Base Color": p["color"], "IOR": p["ior"], "Roughness": roughness}
            inputs["Metallic"] = p.get("metallic", 0.0)
            if p.get("nonlinear") == "on":
                inputs["Base Color"] = self.under_coat(p["color"], p["ior"])
            return self.bsdf("Principled", inputs, distribution="GGX")
        raise BenchError(f"no conversion of materials of type {kind!r}")

    def bsdf(self, kind: str, inputs: dict[str, Any], **settings: Any) -> Any:
        made = self.new(f"ShaderNodeBsdf{kind}", **settings)
        for name, value in inputs.items():
            self.give(made.inputs[name], value)
        return made

    def under_coat(self, color: Any, ior: float) -> Any:
        """A base's colour with what the coat throws back onto it again and again, which Cycles'
        "Principled" leaves out: c (1 - f) / (1 - c f), f being reflected at the coat from within.
        """
        if isinstance(color, ph.Texture):
            raise BenchError("no conversion of nonlinear plastic with a texture")
        cosine = (np.arange(1000) + 0.5) / 1000
        inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
        s = (cosine - ior * inside) / (cosine + ior * inside)
        p = (ior * cosine - inside) / (ior * cosine + inside)
        outer = np.mean((s**2 + p**2) * cosine)  # of even light from outside
        f = 1 - (1 - outer) / ior**2
        return tuple(c * (1 - f) / (1 - c * f) for c in color)

    def dimmed(self, node: Any, color: Any) -> Any:
        """Times a grey factor: mixed with nothing."""
        if min(color) != max(color):
            raise BenchError("no conversion of conductors with a coloured tint")
        if color[0] == 1.0:
            return node
        mix = self.new("ShaderNodeMixShader")
        mix.inputs["Fac"].default_value = color[0]
        self.tree.links.new(node.outputs[0], mix.inputs[2])
        return mix

    def new(self, kind: str, **settings: Any) -> Any:
        made = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(made, name, value)
        return made

    def give(self, socket: Any, value: Any) -> None:
        """A number, colour, texture or another node's output to an input."""
        if isinstance(value, ph.Texture):
            value = self.texture(value)
        if hasattr(value, "links"):
            self.tree.links.new(value, socket)
        elif isinstance(value, (tuple, list, np.ndarray)):
            size = len(socket.default_value)
            socket.default_value = [*map(float, value), 1.0][:size]
        else:
            socket.default_value = float(value)

    def texture(self, texture: ph.Texture) -> Any:
        """Its output."""
        matrix = np.asarray(texture.params.get("transform", np.eye(3)))
        mapping = self.new("ShaderNodeMapping")
        mapping.inputs["Location"].default_value = (*matrix[:2, 2], 0.0)
        mapping.inputs["Scale"].default_value = (matrix[0, 0], matrix[1, 1], 1.0)
        if matrix[0, 1] or matrix[1, 0]:
            raise BenchError("no conversion of textures that are turned")
        uvs = self.new("ShaderNodeTexCoord").outputs["UV"]
        self.tree.links.new(uvs, mapping.inputs["Vector"])
        if texture.type == "checker":
            made = self.new("ShaderNodeTexChecker")
            made.inputs["Scale"].default_value = 2.0
            for i in (0, 1):  # Blender's first colour is that of fields where one of u, v is odd
                self.give(made.inputs[f"Color{2 - i}"], texture.params[f"color{i}"])
        else:
            made = self.new("ShaderNodeTexImage")
            made.image = self.conversion.image(*pixels(texture))
        self.tree.links.new(mapping.outputs["Vector"], made.inputs["Vector"])
        return made.outputs["Color"]


def _strength(color: Any) -> tuple[float, tuple[float, ...]]:
    """The largest of a colour's numbers, and the colour over that."""
    most = float(max(color))
    return most, tuple(float(x) / most for x in color)


def _frame(back: Any, up: Any, origin: Any) -> np.ndarray:
    """(4, 4): of something that looks along -z, with y up."""
    z = np.asarray(back, float) / np.linalg.norm(back)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, np.cross(z, x), z, np.asarray(origin, float)], axis=1)
    return matrix
