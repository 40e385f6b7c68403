"""Spectra reduced to linear Rec. 709 colours: tables of values by wavelength, and metals by name.

Integrals are the sums that Mitsuba 3 makes in its rgb variants, so that a scene means the same
colours in both: a thousand steps from 360 to 830 nm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from .errors import SceneError, unknown_name
from .scene import Material

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

Color = tuple[float, float, float]

_FIRST, _LAST = 360.0, 830.0  # nm, of the CIE's tables
_STEPS = 1000
# The observer's integral of y in nm, and the mean of D65 as it sees it: Mitsuba 3's constants,
# which leave a white surface at 0.9989.
_OBSERVER_Y = 106.7502593994140625
_D65_MEAN = 98.997418
# ITU-R BT.709-6's primaries and white point, D65: CIE XYZ to linear RGB
_FROM_XYZ = (
    (3.240479, -1.537150, -0.498535),
    (-0.969256, 1.875991, 0.041556),
    (0.055648, -0.204043, 1.057311),
)


# Weights of linear Rec. 709 red, green and blue in luminance: the row of y in the inverse of that
LUMINANCE = (0.212671, 0.715160, 0.072169)


def luminance(color: Color) -> float:
    """The luminance of a linear colour; of a grey exactly its value."""
    if color[0] == color[1] == color[2]:
        return color[0]
    return sum(w * c for w, c in zip(LUMINANCE, color, strict=True))


def decode_srgb(encoded: ArrayLike) -> NDArray[np.float32]:
    """Linear values of sRGB ones, numbers within [0, 1] of any shape (IEC 61966-2-1)."""
    import numpy as np

    v = np.asarray(encoded)
    curve = ((np.maximum(v, 0) + 0.055) / 1.055) ** 2.4
    return np.where(v <= 0.04045, v / 12.92, curve).astype(np.float32)


def _rows(name: str) -> Iterator[list[str]]:
    text = (files(__package__) / "data" / name).read_text(encoding="ascii")
    return (line.split() for line in text.splitlines() if line and not line.startswith("#"))


@cache
def _weights() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths, and (3, N) weights of equal energy and of D65 at each: values to XYZ."""
    import numpy as np

    table = np.array([[float(x) for x in row] for row in _rows("cie.txt")])
    nm = np.linspace(_FIRST, _LAST, _STEPS)
    x, y, z, d65 = (np.interp(nm, table[:, 0], column) for column in table.T[1:])
    observer = np.stack([x, y, z]) * ((_LAST - _FIRST) / _STEPS / _OBSERVER_Y)
    return nm, observer, observer * d65 / _D65_MEAN


def reflectance(wavelengths: ArrayLike, values: ArrayLike) -> Color:
    """The colour, in [0, 1], of a surface with these values under D65.

    wavelengths: rising, in nm. Between them values run straight, outside of them they are 0.
    """
    r, g, b = _color(wavelengths, values, lit=True)
    return min(max(r, 0.0), 1.0), min(max(g, 0.0), 1.0), min(max(b, 0.0), 1.0)


def unbounded(wavelengths: ArrayLike, values: ArrayLike) -> Color:
    """As reflectance, of a quantity that may be above 1, such as an index of refraction."""
    r, g, b = _color(wavelengths, values, lit=True)
    return max(r, 0.0), max(g, 0.0), max(b, 0.0)


def emission(wavelengths: ArrayLike, values: ArrayLike) -> Color:
    """The colour of light with this power at each wavelength. One even over all is not white."""
    r, g, b = _color(wavelengths, values, lit=False)
    return max(r, 0.0), max(g, 0.0), max(b, 0.0)


def equal_energy(power: float) -> Color:
    """The colour of light with the same power at all wavelengths: CIE XYZ are all `power`."""
    return from_xyz(power, power, power)


def from_xyz(x: float, y: float, z: float) -> Color:
    """The colour of CIE XYZ tristimulus values; parts of one that lies outside are below 0."""
    r, g, b = (row[0] * x + row[1] * y + row[2] * z for row in _FROM_XYZ)
    return r, g, b


def _color(wavelengths: ArrayLike, values: ArrayLike, *, lit: bool) -> Color:
    import numpy as np

    at = np.asarray(wavelengths, np.float64)
    value = np.asarray(values, np.float64)
    if at.ndim != 1 or at.shape != value.shape or len(at) < 2 or not (np.diff(at) > 0).all():
        raise SceneError("a spectrum needs two or more wavelengths that rise, each with a value")
    nm, even, white = _weights()
    inside = np.interp(nm, at, value, left=0.0, right=0.0)
    rgb = np.array(_FROM_XYZ) @ ((white if lit else even) @ inside)
    return float(rgb[0]), float(rgb[1]), float(rgb[2])


def blackbody(temperature: float) -> Color:
    """Radiance of a black body, W / (m^2 sr nm) (Planck's law), as a colour; temperature in K."""
    nm, power = _planck(temperature)
    return emission(nm, power)


def planckian(temperature: float) -> tuple[float, float]:
    """CIE x and y of a black body; temperature in K."""
    _, power = _planck(temperature)
    x, y, z = (float(v) for v in _weights()[1] @ power)
    return x / (x + y + z), y / (x + y + z)


def _planck(temperature: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wavelengths, in nm, and the radiance of a black body at each."""
    import numpy as np

    if not temperature > 0.0:
        raise SceneError(f"a black body's temperature is {temperature:g}; must be above 0 K")
    nm = _weights()[0]
    metres = nm * 1e-9
    # first and second radiation constants, CODATA 2018
    with np.errstate(over="ignore"):
        power = 1.191042972e-16 / metres**5 / np.expm1(1.438776877e-2 / (metres * temperature))
    return nm, power * 1e-9


@cache
def _metals() -> dict[str, tuple[list[float], list[float], list[float]]]:
    found: dict[str, tuple[list[float], list[float], list[float]]] = {}
    names: Sequence[str] = ()
    for row in _rows("metals.txt"):
        if row[0] == "nm":
            names = row[1:]
            for name in names:
                found[name] = ([], [], [])
            continue
        for i, name in enumerate(names):
            nm, n, k = found[name]
            nm.append(float(row[0]))
            n.append(float(row[1 + 2 * i]))
            k.append(float(row[2 + 2 * i]))
    return found


def metals() -> tuple[str, ...]:
    """The names that metal() knows."""
    return (*sorted(_metals()), "none")


def metal(name: str) -> tuple[Color, Color]:
    """Index of refraction and extinction coefficient of a metal by its symbol, as colours.

    "none" reflects everything. Raises SceneError for an unknown name.
    """
    if name == "none":
        return (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    table = _metals().get(name) if isinstance(name, str) else None
    if table is None:
        raise SceneError(unknown_name("metal", name, metals()))
    nm, n, k = table
    return unbounded(nm, n), unbounded(nm, k)


def conductor(metal_name: str, **params: Any) -> Material:
    """A conducting Material with the measured eta and k of a metal, by its symbol: "Au", say.

    Raises SceneError for an unknown name.
    """
    eta, k = metal(metal_name)
    return Material("conductor", eta=eta, k=k, **params)
