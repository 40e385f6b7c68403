"""Colours and spectra of pbrt's parameters as linear Rec. 709.

Version 4 scales every light by one over the luminance of its spectrum, so that blackbodies and
tables say only a hue; RGB illuminants are relative to the white of their colour space and keep
their values. Version 3 takes what the table says, and the blackbody's with its peak at 1.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ... import spectra
from ...errors import FormatError, SceneError, unknown_name
from ..files import contents
from ..meshes.numbers import parse
from .grammar import Parameter

if TYPE_CHECKING:
    from .items import Item

Color = tuple[float, float, float]
Matrix = NDArray[np.float64]

# Chromaticities x, y of red, green and blue, of colour spaces whose white is D65: ITU-R BT.709-6,
# ITU-R BT.2020-2, SMPTE EG 432-1
_PRIMARIES = {
    "srgb": ((0.640, 0.330), (0.300, 0.600), (0.150, 0.060)),
    "rec2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    "dci-p3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}
_D65 = (0.3127, 0.3290)

# Chromaticities of illuminants (CIE 015:2018, tables T.3 and T.7; S-2008-001 for D60)
_ILLUMINANTS = {
    "stdillum-A": (0.44758, 0.40745),
    "stdillum-D50": (0.34567, 0.35851),
    "stdillum-F1": (0.3131, 0.3371),
    "stdillum-F2": (0.3721, 0.3751),
    "stdillum-F3": (0.4091, 0.3941),
    "stdillum-F4": (0.4402, 0.4031),
    "stdillum-F5": (0.3138, 0.3452),
    "stdillum-F6": (0.3779, 0.3882),
    "stdillum-F7": (0.3129, 0.3292),
    "stdillum-F8": (0.3458, 0.3586),
    "stdillum-F9": (0.3741, 0.3727),
    "stdillum-F10": (0.3458, 0.3588),
    "stdillum-F11": (0.3805, 0.3769),
    "stdillum-F12": (0.4370, 0.4042),
    "illum-acesD60": (0.32168, 0.33767),
}

# Indices of refraction of optical glass at 587.6 nm, and Abbe's numbers (Schott's data sheets)
_GLASSES = {
    "glass-BK7": (1.5168, 64.17),
    "glass-BAF10": (1.6700, 47.11),
    "glass-FK51A": (1.4866, 84.47),
    "glass-LASF9": (1.8503, 32.17),
    "glass-F5": (1.6034, 38.03),
    "glass-SF5": (1.6727, 32.21),
    "glass-SF10": (1.7283, 28.41),
    "glass-SF11": (1.7847, 25.76),
}
# Fraunhofer's lines C, d and F, nm, by which Abbe's number is measured
_LINES = (656.3, 587.6, 486.1)
# Indices of oxides that pbrt lists among the metals (magnesia: Stephens and Malitson 1952; rutile:
# DeVore 1951)
_INDICES = {
    "metal-MgO-eta": 1.7366,
    "metal-TiO2-eta": 2.6142,
    "metal-MgO-k": 0.0,
    "metal-TiO2-k": 0.0,
}

_METALS = ("Ag", "Al", "Au", "Cu")


def scaled(color: Color, by: float) -> Color:
    """The colour, so many times as bright."""
    return color[0] * by, color[1] * by, color[2] * by


def _triple(values: Matrix) -> Color:
    a, b, c = (float(x) for x in values)
    return a, b, c


def of_parameter(item: Item, parameter: Parameter, use: str) -> Color:
    """The colour that a parameter is.

    use: "share" of light that is reflected, "index" of refraction or another quantity that may be
    above 1, or "light". Raises SceneError.
    """
    values = parameter.values
    if not len(values):
        raise SceneError("has no value")
    if parameter.type in ("float", "integer"):
        value = float(values[0])
        return value, value, value
    if parameter.type in ("rgb", "color", "xyz"):
        color = _triple(np.asarray(values[:3], np.float64))
        if parameter.type == "xyz":
            color = spectra.from_xyz(*color)
        elif item.space != "srgb":
            color = _in_space(item, color)
        if min(color) < 0.0:
            item.report("a colour has parts below 0, which are cut off")
            color = _triple(np.maximum(color, 0.0))
        return color
    if parameter.type == "blackbody":
        numbers = np.asarray(values, np.float64)
        temperature = float(numbers[0])
        color = spectra.blackbody(temperature)
        if not item.reader.old:
            return _unit(color)
        scale = float(numbers[1]) if len(numbers) > 1 else 1.0
        return scaled(color, scale / _peak(temperature))
    if parameter.type == "spectrum":
        return _spectrum(item, parameter, use)
    raise SceneError(f"is a {parameter.type}; must be a colour or a texture")


def _in_space(item: Item, color: Color) -> Color:
    """Linear Rec. 709 of a colour in the current colour space."""
    if item.space not in _PRIMARIES:
        item.reader.report(f"ColorSpace {item.space!r}: not supported; colours are taken as sRGB")
        return color
    matrix = np.linalg.inv(_to_xyz("srgb")) @ _to_xyz(item.space)
    return _triple(matrix @ np.array(color))


def _to_xyz(space: str) -> Matrix:
    """Linear RGB to CIE XYZ, where white has Y = 1."""
    columns = np.array([(x / y, 1.0, (1.0 - x - y) / y) for x, y in _PRIMARIES[space]]).T
    x, y = _D65
    white = np.array([x / y, 1.0, (1.0 - x - y) / y])
    return np.asarray(columns * np.linalg.solve(columns, white))


def _unit(color: Color) -> Color:
    """The colour at luminance 1, which is what version 4 makes of every spectrum of a light."""
    light = spectra.luminance(color)
    return scaled(color, 1.0 / light) if light > 0.0 else color


def _peak(temperature: float) -> float:
    """The largest radiance of a blackbody, W / (m^2 sr nm): Planck's law at Wien's wavelength.

    Raises SceneError for a temperature at which that is beyond numbers.
    """
    waves = temperature / 2.897771955e-3  # per metre
    power = 1.191042972e-25 / math.expm1(1.438776877e-2 / 2.897771955e-3)
    for _ in range(5):  # as a power it would be an OverflowError
        power *= waves
    if not 0.0 < power < math.inf:
        raise SceneError(f"a black body of {temperature:g} K has no radiance that can be told")
    return power


def refraction(item: Item, parameter: Parameter) -> tuple[float, float]:
    """The index of refraction that a spectrum is, and the dispersion, 20 over Abbe's number."""
    name = parameter.values[0] if len(parameter.values) else ""
    if isinstance(name, str) and name in _GLASSES:
        ior, abbe = _GLASSES[name]
        return ior, 20.0 / abbe
    if isinstance(name, str) and (not name or named(item, name) is not None):
        return spectra.luminance(of_parameter(item, parameter, "index")), 0.0
    red, ior, blue = (float(n) for n in np.interp(_LINES, *_table(item, parameter)))
    # an index that grows with the wavelength is not that of glass
    return ior, 20.0 * max(blue - red, 0.0) / (ior - 1.0) if ior > 1.0 else 0.0


def _table(item: Item, parameter: Parameter) -> tuple[Matrix, Matrix]:
    """Wavelengths in nm, increasing, and values, of a file or of pairs."""
    first = parameter.values[0]
    if isinstance(first, str):
        table = spectrum_file(item.file_at(first))
    else:
        table = np.asarray(parameter.values, np.float64).reshape(-1, 2)
    wavelengths, values = table[np.argsort(table[:, 0], kind="stable")].T
    return wavelengths, values


def _spectrum(item: Item, parameter: Parameter, use: str) -> Color:
    first = parameter.values[0]
    known = named(item, first) if isinstance(first, str) else None
    if known is not None:
        return known
    wavelengths, values = _table(item, parameter)
    if len(values) == 1:
        wavelengths, values = np.array([360.0, 830.0]), np.repeat(values, 2)
    if use == "light":
        color = spectra.emission(wavelengths, values)
        return color if item.reader.old else _unit(color)
    if use == "index":
        # beyond its ends a table goes on as it ends, as pbrt has it for measured metals
        wavelengths = np.concatenate([[min(0.0, wavelengths[0] - 1.0)], wavelengths, [1e5]])
        values = np.concatenate([values[:1], values, values[-1:]])
        return spectra.unbounded(wavelengths, values)
    return spectra.reflectance(wavelengths, values)


def named(item: Item, name: str) -> Color | None:
    """A spectrum that pbrt knows by name, or None."""
    if name == "stdillum-D65":
        return 1.0, 1.0, 1.0
    if name in _ILLUMINANTS:
        x, y = _ILLUMINANTS[name]
        return spectra.from_xyz(x / y, 1.0, (1.0 - x - y) / y)
    if name in _GLASSES:
        return (_GLASSES[name][0],) * 3
    if name in _INDICES:
        return (_INDICES[name],) * 3
    metal, _, quantity = name.removeprefix("metal-").partition("-")
    if not name.startswith("metal-") or quantity not in ("eta", "k"):
        return None
    if metal == "CuZn":
        item.reader.report("spectrum 'metal-CuZn': not known; that of copper is used")
        metal = "Cu"
    if metal not in _METALS:
        raise SceneError(unknown_name("metal", metal, (*_METALS, "CuZn", "MgO", "TiO2")))
    return spectra.metal(metal)[quantity == "k"]


def spectrum_file(path: Path) -> Matrix:
    """(N, 2) wavelengths in nm and values; # begins a comment. Raises FormatError."""
    lines = (line.partition(b"#")[0] for line in contents(path).split(b"\n"))
    text = b" ".join(lines).replace(b",", b" ")
    try:
        values = parse(text) if text.strip() else np.empty(0)
    except ValueError as error:
        raise FormatError(f"{path}: holds {error}") from None
    if not len(values) or len(values) % 2 or not np.isfinite(values).all():
        raise FormatError(f"{path}: must hold pairs of a wavelength and a value")
    return values.reshape(-1, 2)
