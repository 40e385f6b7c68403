"""Wavefront OBJ with the materials of its MTL files.

Of MTL, both the old statements (Kd, Ks, Ns, d, Ke, map_Kd, bump ...) and those for physically
based shading that programs have added (Pr, Pm, Ps, Pc, aniso, norm ...) become a `principled`
material, or `diffuse` where nothing shines.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, SceneError
from ..scene import Material, Mesh, Scene, Texture
from ..studio import axis, framing
from . import LoadOptions
from .files import Folders, Reports, contents
from .mesh_file import finite, shaded
from .meshes import obj
from .text import is_number

NAME = "OBJ"
OPTIONS = ("up",)
BARE = True
GROUND = (Mesh,)

# Statement -> how many numbers
_NUMBERS = {
    "Ka": 3, "Kd": 3, "Ks": 3, "Ke": 3, "Tf": 3, "Ns": 1, "Ni": 1, "d": 1, "Tr": 1, "illum": 1,
    "Pr": 1, "Pm": 1, "Ps": 1, "Pc": 1, "Pcr": 1, "aniso": 1, "anisor": 1, "sharpness": 1,
}  # fmt: skip
# Statement of a texture -> the name it is kept by
_MAPS = {
    "map_Kd": "Kd", "map_Ke": "Ke", "map_d": "d", "map_Pr": "Pr", "map_Pm": "Pm",
    "map_Bump": "bump", "map_bump": "bump", "bump": "bump", "norm": "norm", "map_Kn": "norm",
}  # fmt: skip
# Without effect on pictures like ours
_IGNORED = ("map_Ka", "map_aat")
# Option of a map -> how many words follow, at most
_FLAGS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1,
    "-mm": 2, "-o": 3, "-s": 3, "-t": 3, "-texres": 1, "-type": 1,
}  # fmt: skip
# Paint and plastic reflect no more than this at normal incidence: an index of 1.8. What has more is
# a metal if its Kd is no more than this share of Ks; else Ks is the strength of a highlight, which
# programs like to set to 0.5 or 1.
_MOST_CLEAR, _MOST_MATTE = 0.08, 0.1
_COMMENT = re.compile(r"(?:^|\s)#.*")


@dataclass
class _Definition:
    """What an MTL file says of a material: numbers and textures by the names above."""

    numbers: dict[str, list[float]] = field(default_factory=dict)
    maps: dict[str, Texture] = field(default_factory=dict)
    bump: float = 1.0


def load(path: Path, options: LoadOptions) -> Scene:
    """The file as a scene. Raises FormatError."""
    reports = Reports(path, options.strict)
    with np.errstate(all="ignore"):  # what is not finite is looked for, and named
        data, groups = obj.read_groups(path)
        finite(path, data)
        known: dict[str, Material] = {}
        folders = Folders(path.parent, options.allow_paths)
        for name in groups.libraries:
            try:
                file = folders.file(name, f"{path}: mtllib")
            except SceneError as error:
                reports.add(f"{str(error).removeprefix(f'{path}: ')}; its materials are grey")
                continue
            known |= _materials(file, folders, reports)
        plain = shaded(data, path.stem)
        present = np.bincount(groups.of_face, minlength=len(groups.names)) > 0
        used = [name for name, there in zip(groups.names, present, strict=True) if there]
        material: Any = plain.material
        if used != [""]:
            for name in used:
                if name and name not in known:
                    reports.add(f"material {name!r} is not defined; it is grey")
            table = {name: known.get(name, Material("diffuse")) for name in used}
            if "" in table:
                table[""] = material
            names = {name: name or "no material" for name in used}
            materials: Mapping[str, Material] = {names[n]: m for n, m in table.items()}
            indices = (np.cumsum(present) - 1)[groups.of_face] if len(used) > 1 else None
            material = names[used[0]] if indices is None else indices
        else:
            materials = {}
        mesh = replace(plain, material=material)
    for text in groups.left_out:
        reports.add(text)
    reports.tell()
    up = framing(axis(options.up or "y"))
    return Scene([mesh], materials=materials, camera=up, background=None, name=path.name)


def _materials(path: Path, folders: Folders, reports: Reports) -> dict[str, Material]:
    """The materials of an MTL file by their names. Raises FormatError, naming the line."""
    found: dict[str, _Definition] = {}
    at: _Definition | None = None
    text = contents(path).decode("utf-8", "replace").replace("\\\n", " ")
    for number, line in enumerate(text.split("\n"), 1):
        words = _COMMENT.sub("", line).split()
        if not words:
            continue
        place = f"{path}: line {number}"
        if words[0] == "newmtl":
            at = found[" ".join(words[1:])] = _Definition()
        elif at is None:
            raise FormatError(f"{place}: {words[0]!r} comes before any 'newmtl'")
        elif words[0] in _MAPS:
            _map(at, _MAPS[words[0]], line, place, folders, reports)
        elif words[0] in _NUMBERS:
            numbers = _numbers(words[1:], place, reports)
            if numbers:
                at.numbers[words[0]] = numbers
        elif words[0] not in _IGNORED:
            reports.add(f"{path.name}: statement {words[0]!r}: not known; ignored")
    return {name: _material(d, reports) for name, d in found.items()}


def _numbers(words: list[str], place: str, reports: Reports) -> list[float]:
    """The numbers of a statement; of a colour given as one, three."""
    if words and words[0] in ("spectral", "xyz"):
        reports.add(f"a colour given as {words[0]!r} is not supported; ignored")
        return []
    if words and words[0] == "-halo":
        words = words[1:]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise FormatError(f"{place}: {' '.join(words)[:40]!r} is not a list of numbers") from None
    if not numbers or not all(math.isfinite(x) for x in numbers):
        raise FormatError(f"{place}: needs finite numbers")
    return numbers


def _map(
    at: _Definition, kind: str, line: str, place: str, folders: Folders, reports: Reports
) -> None:
    """A texture's file and its options, which come before it."""
    try:
        words = shlex.split(line.replace("\\", "/"))[1:]
    except ValueError:
        words = line.split()[1:]
    scale, offset, wrap, channel = [1.0, 1.0], [0.0, 0.0], "repeat", "rgb"
    while words and words[0] in _FLAGS:
        flag, most = words[0], _FLAGS[words[0]]
        count = 1
        while count <= most and count < len(words) - 1 and (count == 1 or is_number(words[count])):
            count += 1
        values = words[1:count]
        words = words[count:]
        if flag in ("-s", "-o"):
            given = [float(v) for v in values[:2] if is_number(v)]
            (scale if flag == "-s" else offset)[: len(given)] = given
        elif flag == "-clamp" and values == ["on"]:
            wrap = "clamp"
        elif flag == "-imfchan" and values:
            channel = {"r": "r", "g": "g", "b": "b", "m": "a", "l": "luminance"}.get(
                values[0], "rgb"
            )
        elif flag == "-bm" and values and is_number(values[0]):
            at.bump = float(values[0])
        elif flag not in ("-blendu", "-blendv", "-texres"):
            reports.add(f"option {flag!r} of a texture: not supported; ignored")
    name = " ".join(words)
    bare = _COMMENT.sub("", name)
    if not bare:
        raise FormatError(f"{place}: needs a file")
    try:
        try:
            file = folders.file(name, place)
        except SceneError:
            if bare == name:
                raise
            file = folders.file(bare, place)  # what looked like part of its name is a comment
    except SceneError as error:
        reports.add(f"{str(error).removeprefix(str(reports.path.parent) + '/')}; ignored")
        return
    params: dict[str, Any] = {"image": str(file), "wrap_u": wrap, "wrap_v": wrap}
    if scale != [1.0, 1.0] or offset != [0.0, 0.0]:
        params["transform"] = ((scale[0], 0.0, offset[0]), (0.0, scale[1], offset[1]))
    if channel != "rgb":
        params["channel"] = channel
    at.maps[kind] = Texture("image", **params)


def _material(d: _Definition, reports: Reports) -> Material:
    """Ours for it. Numbers beyond their range are cut to it."""

    def color(name: str, default: float, most: float = 1.0) -> tuple[float, ...]:
        values = d.numbers.get(name, [default])
        values = (values * 3)[:3] if len(values) < 3 else values[:3]
        return tuple(min(max(v, 0.0), most) for v in values)

    def number(name: str, default: float, most: float = 1.0) -> float:
        return min(max(d.numbers.get(name, [default])[0], 0.0), most)

    base: Any = color("Kd", 0.8)
    if "Kd" in d.maps:
        base = _times(d.maps["Kd"], base if "Kd" in d.numbers else (1.0,) * 3)
    params: dict[str, Any] = {"color": base}
    emission: Any = color("Ke", 0.0, 1e12)
    if "Ke" in d.maps:
        emission = _times(d.maps["Ke"], emission if any(emission) else (1.0,) * 3)
    if isinstance(emission, Texture) or any(emission):
        params["emission"] = emission
    opacity: Any = number("d", 1.0 - number("Tr", 0.0))
    if "d" in d.maps:
        opacity = _times(d.maps["d"], (opacity,) * 3)
    illum = int(number("illum", 2.0, 10.0))
    clear = illum in (4, 6, 7, 9) and not isinstance(opacity, Texture)
    if not clear and (isinstance(opacity, Texture) or opacity < 1.0):
        params["opacity"] = opacity
    if "norm" in d.maps:
        params["normal_map"] = d.maps["norm"]
    if "bump" in d.maps:
        if d.bump == 1.0:
            params["bump_map"] = d.maps["bump"]
        elif d.bump > 0.0 and math.isfinite(d.bump):
            params["bump_map"] = _times(d.maps["bump"], (d.bump,) * 3)
        else:
            reports.add(
                f"the multiplier of a bump map is {d.bump:g}, and must be above 0 and finite;"
                " the map is ignored"
            )
    reflected = color("Ks", 0.0)
    shine = max(reflected)
    modern = d.numbers.keys() & {"Pr", "Pm", "Ps", "Pc"} or d.maps.keys() & {"Pr", "Pm"}
    if not modern and not clear and (shine == 0.0 or illum < 2) and illum not in (3, 5):
        return Material("diffuse", **params)
    if modern:
        params["roughness"] = d.maps.get("Pr", number("Pr", 0.5))
        params["metallic"] = d.maps.get("Pm", number("Pm", 0.0))
        params["clearcoat"] = number("Pc", 0.0)
        params["clearcoat_roughness"] = number("Pcr", 0.0)
        params["sheen_color"] = (number("Ps", 0.0),) * 3
        params["anisotropy"] = min(number("aniso", 0.0), 0.99)
        params["anisotropy_rotation"] = 360.0 * (number("anisor", 0.0) % 1.0)
    else:
        # The width of Blinn's lobe: B. Walter et al., "Microfacet Models for Refraction through
        # Rough Surfaces", EGSR 2007, section 5.2; ours is the root of their alpha.
        exponent = number("Ns", 10.0, 1e6)
        params["roughness"] = (2.0 / (exponent + 2.0)) ** 0.25
    if clear:
        params |= {"transmission": 1.0, "color": color("Tf", 1.0), "roughness": 0.0}
    if clear or modern:
        params["ior"] = max(number("Ni", 1.5, 10.0), 1.0)
    elif illum in (3, 5):  # a mirror, of the colour Ks
        params |= {"metallic": 1.0, "color": color("Ks", 1.0), "roughness": 0.0}
    else:
        params |= _reflection(base, reflected)
    return Material("principled", **params)


def _reflection(base: Any, reflected: tuple[float, ...]) -> dict[str, Any]:
    """What reflects this colour at normal incidence: a metal, or an interface over the base."""
    most = max(reflected)
    matte = 1.0 if isinstance(base, Texture) else max(base)
    if most > _MOST_CLEAR and matte <= _MOST_MATTE * most:
        return {"metallic": 1.0, "color": reflected}
    # Ni has no say: many files have 1 there, which would reflect nothing.
    root = math.sqrt(min(most, _MOST_CLEAR))
    tint = tuple(share / most for share in reflected)
    return {"ior": (1.0 + root) / (1.0 - root), "specular_color": tint}


def _times(texture: Texture, color: tuple[float, ...]) -> Texture:
    if color == (1.0, 1.0, 1.0):
        return texture
    return Texture("multiply", color0=texture, color1=color)
