"""Our Scenes as Mitsuba's dictionaries."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

import parhelion as ph

from ..gallery import Piece, pieces, pixels, surroundings, values
from ..scenes import BenchError

# Each `sphere` takes 48 kB. `ellipsoids` takes 242 B, but its test loses small and distant ones to
# rounding: of radius 0.0025 at a distance of 3, Mitsuba 3.9.1 met one 60 times its radius away.
MANY = 20_000

Plugin = dict[str, Any]


def convert(mi: Any, scene: ph.Scene, job: dict[str, Any]) -> Plugin:
    """Raises BenchError for what cannot be given faithfully."""
    plugins: Plugin = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": job["depth"], "rr_depth": 5},
        "sensor": sensor(mi, scene.camera, job),
    }
    if scene.background is not None:
        plugins["background"] = _background(mi, scene.background)
    for i, light in enumerate(scene.lights):
        plugins[f"light{i}"] = _light(light)
    made: dict[Any, Any] = {}  # of each material, one, whatever has it
    for piece in pieces(scene):
        mesh = isinstance(piece.shape, ph.Mesh)
        key = piece.material, mesh
        if key not in made:
            made[key] = mi.load_dict(bsdf(mi, piece.material, closed=not mesh))
        if isinstance(piece.shape, ph.Mesh):
            plugins[piece.name] = _mesh(mi, piece, piece.shape, made[key])
        else:
            plugins |= _spheres(mi, piece, piece.shape, made[key])
    return plugins


def sensor(mi: Any, c: ph.Camera, job: dict[str, Any]) -> Plugin:
    """The camera and its film."""
    if c.projection != "perspective" or c.vfov is None:
        raise BenchError("only perspective cameras with a vfov are converted")
    lens: Plugin = {"type": "perspective"}
    if c.aperture_radius:
        focus = c.focus_distance or float(np.linalg.norm(np.subtract(c.target, c.eye)))
        lens = {
            "type": "thinlens",
            "aperture_radius": c.aperture_radius,
            "focus_distance": focus,
        }
    return lens | {
        "to_world": mi.ScalarTransform4f().look_at(c.eye, c.target, c.up),
        "fov": c.vfov,
        "fov_axis": "y",
        "near_clip": 1e-3,
        "sampler": {"type": "independent"},
        "film": {
            "type": "hdrfilm",
            "width": job["width"],
            "height": job["height"],
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
    }


def _background(mi: Any, background: ph.Light) -> Plugin:
    if background.type == "constant":
        radiance = background.params.get("radiance", (1.0, 1.0, 1.0))
        return {"type": "constant", "radiance": _color(radiance)}
    sky = surroundings(background, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
    return {"type": "envmap", "bitmap": mi.Bitmap(sky)}


def _light(light: ph.Light) -> Plugin:
    p = light.params
    if light.type != "directional" or p.get("angle"):
        raise BenchError(f"no conversion of lights of type {light.type!r}")
    return {
        "type": "directional",
        "direction": list(p["direction"]),
        "irradiance": _color(p["irradiance"]),
    }


def _mesh(mi: Any, piece: Piece, mesh: ph.Mesh, look: Any) -> Any:
    if mesh.colors is not None or mesh.inside_out:
        raise BenchError("no conversion of meshes with colors, or inside out")
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    props = mi.Properties()
    props["bsdf"] = look
    if piece.emission is not None:
        props["emitter"] = mi.load_dict(_area(mi, piece.emission))
    if mesh.normals is None:
        props["face_normals"] = True
    made = mi.Mesh(
        piece.name,
        len(vertices),
        len(faces),
        props=props,
        has_vertex_normals=mesh.normals is not None,
        has_vertex_texcoords=mesh.uvs is not None,
    )
    params = mi.traverse(made)
    params["vertex_positions"] = vertices.astype(np.float32).ravel()
    params["faces"] = faces.astype(np.uint32).ravel()
    if mesh.normals is not None:
        params["vertex_normals"] = np.asarray(mesh.normals, np.float32).ravel()
    if mesh.uvs is not None:
        params["vertex_texcoords"] = np.asarray(mesh.uvs, np.float32).ravel()
    params.update()
    return made


def _spheres(mi: Any, piece: Piece, spheres: ph.Spheres, look: Any) -> Plugin:
    centers = np.asarray(spheres.centers, np.float32)
    radii = np.broadcast_to(np.asarray(spheres.radii, np.float32), len(centers))
    if len(centers) > MANY:
        raise BenchError(f"more than {MANY} spheres: see MANY in bench/renderers/mitsuba_scene.py")
    made = {}
    for i, (center, radius) in enumerate(zip(centers.tolist(), radii.tolist(), strict=True)):
        if spheres.colors is not None:
            color = tuple(np.asarray(spheres.colors)[i].tolist())
            own = ph.Material(piece.material.type, **{**piece.material.params, "color": color})
            look = bsdf(mi, own, closed=True)
        sphere = {"type": "sphere", "center": center, "radius": radius, "bsdf": look}
        if piece.emission is not None:
            sphere["emitter"] = _area(mi, piece.emission)
        made[f"{piece.name}_{i}"] = sphere
    return made


def _area(mi: Any, radiance: Any) -> Plugin:
    return {"type": "area", "radiance": _texture(mi, radiance)}


def bsdf(mi: Any, material: ph.Material, closed: bool = False) -> Plugin:
    """closed: nobody sees the back, so that it need not look like the front, which takes time.

    Raises BenchError for what cannot be given faithfully.
    """
    common = material.params
    for key in ("opacity", "bump_map", "back", "absorption"):
        if key in common:
            raise BenchError(f"no conversion of {key}")
    plugin = _bsdf(mi, material.type, values(material))
    if common.get("normal_map") is not None:
        normals = _texture(mi, common["normal_map"])
        plugin = {"type": "normalmap", "normalmap": normals | {"raw": True}, "bsdf": plugin}
    clear = material.type == "dielectric"
    if common.get("two_sided", True) and not (closed or clear):
        plugin = {"type": "twosided", "bsdf": plugin}
    return plugin


def _bsdf(mi: Any, kind: str, p: dict[str, Any]) -> Plugin:
    roughness = p.get("roughness", 0.0)
    alpha = None if isinstance(roughness, ph.Texture) else roughness**2
    rough: Plugin = {"distribution": p.get("distribution", "ggx"), "alpha": alpha}
    if kind in ("diffuse", "emissive"):
        color = (0.0, 0.0, 0.0) if kind == "emissive" else p["color"]
        return {"type": "diffuse", "reflectance": _texture(mi, color)}
    if kind == "metal":
        mirror = {"material": "none", "specular_reflectance": _texture(mi, p["color"])}
        if p["fuzz"] == 0:
            return {"type": "conductor"} | mirror
        # There is no fuzz in Mitsuba. A point on a sphere of radius f shifts the mirrored direction
        # by f / sqrt(3) (standard deviation) along each axis; facets with Beckmann's distribution
        # tilt by alpha / sqrt(2), which turns the mirrored direction by twice that. At normal
        # incidence the two agree for alpha = f / sqrt(6).
        blurred = {"distribution": "beckmann", "alpha": p["fuzz"] / sqrt(6)}
        return {"type": "roughconductor"} | blurred | mirror
    if kind == "conductor":
        metal = {
            "eta": _color(p["eta"]),
            "k": _color(p["k"]),
            "specular_reflectance": _texture(mi, p["color"]),
        }
        return (
            {"type": "roughconductor"} | rough | metal if alpha else {"type": "conductor"} | metal
        )
    if kind == "dielectric":
        glass = {"int_ior": p["ior"], "ext_ior": 1.0}
        if p["color"] != (1.0, 1.0, 1.0):
            raise BenchError("no conversion of tinted glass")
        return (
            {"type": "roughdielectric"} | rough | glass if alpha else {"type": "dielectric"} | glass
        )
    if kind == "plastic":
        coated = {
            "diffuse_reflectance": _texture(mi, p["color"]),
            "specular_reflectance": _texture(mi, p["specular"]),
            "int_ior": p["ior"],
            "ext_ior": 1.0,
            "nonlinear": p["nonlinear"] == "on",
        }
        return {"type": "roughplastic"} | rough | coated if alpha else {"type": "plastic"} | coated
    if kind == "principled":
        return {
            "type": "principled",
            "base_color": _texture(mi, p["color"]),
            "metallic": _texture(mi, p["metallic"]),
            "roughness": _texture(mi, roughness),
            "eta": p["ior"],
        }
    raise BenchError(f"no conversion of materials of type {kind!r}")


def _texture(mi: Any, value: Any) -> Any:
    """A colour, number or texture as what Mitsuba takes in its place."""
    if not isinstance(value, ph.Texture):
        return _color(value) if isinstance(value, (tuple, list, np.ndarray)) else value
    to_uv = np.eye(4)
    matrix = np.asarray(value.params.get("transform", np.eye(3)))
    to_uv[:2, :2], to_uv[:2, 3] = matrix[:2, :2], matrix[:2, 2]
    moved: Plugin = {"to_uv": mi.ScalarTransform4f(to_uv)}
    if value.type == "checker":
        colors = {key: _color(value.params[key]) for key in ("color0", "color1")}
        return {"type": "checkerboard"} | colors | moved
    array, srgb = pixels(value)
    # Our v runs up a picture, Mitsuba's down.
    bitmap = mi.Bitmap(np.ascontiguousarray(array[::-1]))
    bitmap.set_srgb_gamma(srgb)
    return {"type": "bitmap", "bitmap": bitmap, "raw": not srgb} | moved


def _color(value: Any) -> Plugin:
    return {"type": "rgb", "value": [float(x) for x in value]}
