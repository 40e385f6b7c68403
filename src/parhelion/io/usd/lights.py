"""UsdLux: lights with a shape are shapes that shine; those at infinity, lights.

A light's intensity, times 2^exposure, its colour and that of its temperature, is a radiance; with
`normalize` it is divided by the area that shines (openusd.org/release/user_guides/schemas/usdLux).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdLux

from ...scene import (
    Background,
    Cylinders,
    Disks,
    Light,
    Material,
    Mesh,
    Spheres,
    Texture,
)
from .solids import similarity

if TYPE_CHECKING:
    from .reader import Group, Matrix, Reader

Color = tuple[float, float, float]

_LINEAR = (".exr", ".hdr", ".rgbe", ".pfm")


def is_light(prim: Any) -> bool:
    """Whether a prim of any type is a light."""
    return bool(prim.HasAPI(UsdLux.LightAPI))


def split(lights: list[Light]) -> tuple[Light | None, list[Light]]:
    """The first of the surroundings, and all others."""
    around = next((light for light in lights if light.type in ("envmap", "constant")), None)
    return around, [light for light in lights if light is not around]


# --- What lights share ---------------------------------------------------------------------------


def _input(r: Reader, prim: Any, name: str, default: Any = None) -> Any:
    """An input; files older than USD 21.02 have them without the prefix."""
    attribute = prim.GetAttribute(f"inputs:{name}")
    if not (attribute and attribute.HasAuthoredValue()):
        old = prim.GetAttribute(name)
        attribute = old if old and old.HasAuthoredValue() else attribute
    return r.get(attribute, default)


def _number(r: Reader, prim: Any, name: str, default: float = 0.0) -> float:
    value = float(_input(r, prim, name, default))
    if not np.isfinite(value):
        raise r.error(prim, f"inputs:{name} is {value}")
    return value


def _power(r: Reader, prim: Any) -> Color:
    """Radiance, before it is normalised."""
    color = np.array(_input(r, prim, "color", (1.0, 1.0, 1.0)), np.float64)
    if _input(r, prim, "enableColorTemperature", False):
        kelvin = _number(r, prim, "colorTemperature", 6500.0)
        color = color * UsdLux.BlackbodyTemperatureAsRgb(min(max(kelvin, 1000.0), 10000.0))
    color = color * _number(r, prim, "intensity", 1.0) * np.exp2(_number(r, prim, "exposure"))
    if not np.isfinite(color).all() or color.max() > 1e12:
        raise r.error(prim, "its intensity is not finite, or above 1e12")
    for name, usual in (("diffuse", 1.0), ("specular", 1.0)):
        if _number(r, prim, name, usual) != usual:
            r.report(f"inputs:{name} of lights, such as {prim.GetPath()}: not supported; ignored")
    if _input(r, prim, "shadow:enable", True) is False:
        r.report(f"lights without shadows, such as {prim.GetPath()}: they have shadows")
    if prim.GetRelationship("light:filters") and prim.GetRelationship("light:filters").GetTargets():
        r.report(f"light filters, such as those of {prim.GetPath()}: not supported; ignored")
    for link, what in (("lightLink", "light linking"), ("shadowLink", "shadow linking")):
        if _linked(prim, link):
            r.report(f"{what}, such as that of {prim.GetPath()}: not supported; ignored")
    return _triple(color.clip(0.0, None))


def _linked(prim: Any, link: str) -> bool:
    """Whether a collection of a light says that it is about some things only."""
    for own in prim.GetAuthoredPropertiesInNamespace(f"collection:{link}"):
        if isinstance(own, Usd.Relationship):
            if own.GetTargets():
                return True
        elif own.GetBaseName() == "includeRoot":
            if own.Get() is False:
                return True
        elif own.GetBaseName() == "membershipExpression" and own.Get():
            return True
    return False


def _triple(v: Any) -> Color:
    return float(v[0]), float(v[1]), float(v[2])


def _shines(r: Reader, prim: Any, area: float, normalized: float | None = None) -> Color:
    """The radiance of a surface of that area in the scene."""
    power = np.array(_power(r, prim))
    if _input(r, prim, "normalize", False):
        power /= area if normalized is None else normalized
    return _triple(power.clip(0.0, 1e12))


def _cone(r: Reader, prim: Any) -> tuple[float, float] | None:
    """Degrees from -z at which a shaped light ends, and begins to fade; None if not shaped."""
    shaped = prim.HasAPI(UsdLux.ShapingAPI)
    if not shaped:
        return None
    if _input(r, prim, "shaping:ies:file", None):
        r.report(f"IES profiles, such as that of {prim.GetPath()}: not supported; ignored")
    if _number(r, prim, "shaping:focus") != 0.0:
        r.report(f"shaping:focus, such as that of {prim.GetPath()}: not supported; ignored")
    angle = min(_number(r, prim, "shaping:cone:angle", 90.0), 180.0)
    if angle >= 180.0:
        return None
    softness = min(max(_number(r, prim, "shaping:cone:softness"), 0.0), 1.0)
    return angle, angle * (1.0 - softness)


def _flat_cone(r: Reader, prim: Any) -> None:
    """A flat light reaches 90 degrees anyway."""
    cone = _cone(r, prim)
    if cone is not None and cone[0] < 90.0:
        r.report(f"shaping:cone of flat lights, such as {prim.GetPath()}: not supported; ignored")


def _lamp(radiance: Color | Texture) -> Material:
    return Material("diffuse", color=(0.0, 0.0, 0.0), emission=radiance, two_sided=False)


def _add(r: Reader, group: Group, shape: Any) -> None:
    r.lamps.add(shape.name)
    group.shapes.append(shape)


def _copied(r: Reader, group: Group, matrix: Matrix, shape: Any) -> None:
    """A shape that its transform would make another kind of one: a copy of what it was."""
    from .reader import Group

    r.lamps.add(shape.name)
    group.copies.append((Group(shape.name, [shape]), matrix[None]))


def _size(r: Reader, prim: Any, name: str, default: float) -> float:
    value = _number(r, prim, name, default)
    if not value > 0.0:
        raise r.error(prim, f"inputs:{name} is {value:g}; must be above 0")
    return value


def _at_infinity(r: Reader, prim: Any, group: Group) -> bool:
    """Whether a light without a place may stand here."""
    if group is r.scene_group:
        return True
    r.report(f"{prim.GetTypeName()} prims in instances, such as {prim.GetPath()}: left out")
    return False


# --- Lights with a shape -------------------------------------------------------------------------


def _sphere(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    cone = _cone(r, prim)
    radius = _number(r, prim, "radius", 0.5)
    point = bool(r.get(prim.GetAttribute("treatAsPoint"), False)) and radius <= 0.0
    if cone is not None or point:
        _point(r, prim, matrix, group, radius, cone)
        return
    radius = _size(r, prim, "radius", 0.5)
    axes = radius * np.linalg.svd(matrix[:3, :3], compute_uv=False)
    # K. Thomsen's formula of an ellipsoid's surface, within 1.1 %; exact for a sphere
    p = 1.6075
    pairs = np.array([axes[0] * axes[1], axes[0] * axes[2], axes[1] * axes[2]]) ** p
    area = float(4.0 * np.pi * pairs.mean() ** (1.0 / p))
    name, lamp = str(prim.GetPath()), _lamp(_shines(r, prim, area))
    scale = similarity(matrix)
    if scale is None:
        _copied(r, group, matrix, Spheres(np.zeros((1, 3)), radius, lamp, None, name))
    else:
        _add(r, group, Spheres(matrix[None, :3, 3], scale * radius, lamp, None, name))


def _point(
    r: Reader, prim: Any, matrix: Matrix, group: Group, radius: float,
    cone: tuple[float, float] | None,
) -> None:  # fmt: skip
    """A light of radiance L and radius r looks from afar like a point of intensity L pi r^2."""
    if not _at_infinity(r, prim, group):
        return
    scale = float(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    across = np.pi * (scale * max(radius, 0.0)) ** 2
    # normalised, L is divided by 4 pi r^2
    share = 0.25 if _input(r, prim, "normalize", False) else across
    intensity = _triple(share * np.array(_power(r, prim)))
    if not any(intensity):
        r.report(f"{prim.GetPath()}: of radius 0, without normalize, it gives no light")
        return
    position = _triple(matrix[:3, 3])
    if cone is None:
        r.lights.append(Light("point", position=position, intensity=intensity))
        return
    if radius > 0.0:
        r.report(f"shaped sphere lights, such as {prim.GetPath()}: shine from their middle")
    r.lights.append(
        Light(
            "spot",
            position=position,
            intensity=intensity,
            direction=_triple(-_unit(r, prim, matrix[:3, 2])),
            cutoff_angle=max(cone[0], 0.0),
            beam_width=max(min(cone[1], cone[0]), 0.0),
        )
    )


def _unit(r: Reader, prim: Any, vector: Any) -> Any:
    length = float(np.linalg.norm(vector))
    if not length > 0.0:
        raise r.error(prim, "its transform cannot be inverted")
    return vector / length


def _disk(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    _flat_cone(r, prim)
    radius = _size(r, prim, "radius", 0.5)
    u, v = radius * matrix[:3, 1], radius * matrix[:3, 0]  # y x x is -z
    area = float(np.pi * np.linalg.norm(np.cross(u, v)))
    if not area > 0.0:
        raise r.error(prim, "its transform makes it a line")
    name, lamp = str(prim.GetPath()), _lamp(_shines(r, prim, area))
    if abs(u @ v) > 1e-5 * np.linalg.norm(u) * np.linalg.norm(v):
        x, y, _ = radius * np.eye(3)[:, None]
        _copied(r, group, matrix, Disks(np.zeros((1, 3)), y, x, lamp, None, name))
        return
    back = bool(np.linalg.det(matrix[:3, :3]) < 0.0)
    _add(r, group, Disks(matrix[None, :3, 3], u[None], v[None], lamp, None, name, back))


def _rectangle(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    _flat_cone(r, prim)
    width, height = (_size(r, prim, key, 1.0) for key in ("width", "height"))
    area = width * height * float(np.linalg.norm(np.cross(matrix[:3, 0], matrix[:3, 1])))
    if not area > 0.0:
        raise r.error(prim, "its transform makes it a line")
    # a picture's top left corner is at (+x, +y): it is seen from the front, which is -z
    uvs = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners = np.column_stack([width * (0.5 - uvs[:, 0]), height * (uvs[:, 1] - 0.5), np.zeros(4)])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        faces = faces[:, [0, 2, 1]]
    radiance: Color | Texture = _shines(r, prim, area)
    picture = _picture(r, prim)
    if picture:
        texture = Texture("image", **picture, wrap_u="clamp", wrap_v="clamp")
        radiance = Texture("multiply", color0=texture, color1=radiance)
    points = corners @ matrix[:3, :3].T + matrix[:3, 3]
    name = str(prim.GetPath())
    _add(r, group, Mesh(points, faces, uvs=uvs, material=_lamp(radiance), name=name))


def _cylinder(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    cone = _cone(r, prim)
    if cone is not None:
        r.report(f"shaping:cone of CylinderLight, such as {prim.GetPath()}: not supported; ignored")
    radius, length = _size(r, prim, "radius", 0.5), _size(r, prim, "length", 1.0)
    linear = matrix[:3, :3]
    along = float(np.linalg.norm(linear[:, 0]))
    around = float(np.sqrt(np.linalg.norm(np.cross(linear[:, 1], linear[:, 2]))))
    if not along * around > 0.0:
        raise r.error(prim, "its transform makes it flat")
    name = str(prim.GetPath())
    lamp = _lamp(_shines(r, prim, 2.0 * np.pi * radius * around * length * along))
    tip = 0.5 * length * np.eye(3)[[0]]
    if similarity(matrix) is None:
        _copied(r, group, matrix, Cylinders(-tip, tip, radius, None, lamp, None, name))
        return
    ends = [side * tip @ linear.T + matrix[:3, 3] for side in (-1.0, 1.0)]
    tube = Cylinders(ends[0], ends[1], radius * around, None, lamp, None, name)
    _add(r, group, tube)


# --- Lights at infinity --------------------------------------------------------------------------


def _distant(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    """A disk of the sky; its radiance times pi sin^2 of half its angle is an irradiance."""
    if not _at_infinity(r, prim, group):
        return
    angle = min(max(_number(r, prim, "angle", 0.53), 0.0), 180.0)
    share = float(np.pi * np.sin(np.radians(0.5 * angle)) ** 2) or 1.0
    irradiance = share * np.array(_shines(r, prim, share))
    direction = -_unit(r, prim, matrix[:3, 2])
    r.lights.append(
        Light(
            "directional",
            irradiance=_triple(irradiance),
            direction=_triple(direction),
            angle=angle,
        )
    )


def _picture(r: Reader, prim: Any) -> dict[str, Any] | None:
    """Image and colour space of a light's texture, if it has one that is there."""
    asset = _input(r, prim, "texture:file")
    if not isinstance(asset, Sdf.AssetPath) or not asset.path:
        return None
    picture = r.images.image(asset, r.where(prim))
    if picture is None:
        r.report(f"{prim.GetPath()}: {asset.path!r}: no such file; it is white")
        return None
    linear = asset.path.rstrip("]").lower().endswith(_LINEAR)
    return {"image": picture, "color_space": "linear" if linear else "srgb"}


def _dome(r: Reader, prim: Any, matrix: Matrix, group: Group) -> None:
    if not _at_infinity(r, prim, group):
        return
    radiance = _power(r, prim)
    if prim.GetRelationship("portals") and prim.GetRelationship("portals").GetTargets():
        r.report(f"portals of {prim.GetPath()}: not needed; ignored")
    form = str(_input(r, prim, "texture:format", "automatic"))
    picture = _picture(r, prim)
    if picture and form not in ("automatic", "latlong"):
        r.report(f"texture:format {form!r} of {prim.GetPath()}: not supported; it is white")
        picture = None
    if picture is None:
        r.lights.append(Background("constant", radiance=radiance))
        return
    axes = np.stack([_unit(r, prim, matrix[:3, k]) for k in range(3)], axis=1)
    if np.abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        raise r.error(prim, "its transform shears; a dome's must be a rotation")
    pole = str(r.get(prim.GetAttribute("poleAxis"), "Y"))
    if pole == "scene":
        pole = str(UsdGeom.GetStageUpAxis(r.stage))
    if pole == "Z":  # turned about x until the picture's top, y, is z
        axes = axes @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    r.lights.append(Background("envmap", **picture, scale=radiance, transform=axes))


LIGHTS: dict[str, Callable[[Reader, Any, Matrix, Group], None]] = {
    "SphereLight": _sphere,
    "DiskLight": _disk,
    "RectLight": _rectangle,
    "CylinderLight": _cylinder,
    "DistantLight": _distant,
    "DomeLight": _dome,
    "DomeLight_1": _dome,
}
