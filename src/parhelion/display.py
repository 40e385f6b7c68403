"""Light as a screen shows it: exposure, white balance, and a view transform.

A view transform says how light, which has no upper limit, becomes what a screen can show. "srgb"
cuts what is brighter than white. The others bring it down to white gently, so that bright things
keep their shape and lose their saturation on the way there, and run through OpenColorIO:

- "aces" and "aces-1.3": the output transforms of ACES 2.0 and 1.3 for screens of 100 cd/m^2, from
  the configurations of _CONFIGS, which OpenColorIO has built in.
- "agx": after AgX by Troy Sobotka (github.com/sobotka/AgX, 2022), of which OpenColorIO has no
  configuration. Colours are moved towards white, a sigmoid of its logarithm bends each channel, and
  they are moved back. His are the share of the first move and the range of stops. That colours are
  moved back, so that dim ones stay what they were, that middle grey stays too, and the slope and
  powers of the sigmoid are ours.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import machine
from .errors import SceneError, option, unknown_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Name -> OpenColorIO's configuration, and the view in it
_CONFIGS = {
    "aces": ("cg-config-v4.0.0_aces-v2.0_ocio-v2.5", "ACES 2.0 - SDR 100 nits (Rec.709)"),
    "aces-1.3": ("cg-config-v2.2.0_aces-v1.3_ocio-v2.4", "ACES 1.0 - SDR Video"),
}
_FROM, _TO = "Linear Rec.709 (sRGB)", "sRGB - Display"
VIEW_TRANSFORMS = ("srgb", "agx", *_CONFIGS)

# Kelvin in, or the chromaticity of what shall be white: CIE x and y
WhiteBalance: TypeAlias = float | tuple[float, float]

# Stops by which a picture may be made brighter or darker: beyond, all would be white or black.
_MOST_EXPOSURE = 32.0
# Light that is brighter than any screen's white after any view transform
_BRIGHTEST = 65504.0

# Kelvin: below, a black body has next to no blue; the daylight locus ends above
_WARMEST, _COLDEST = 1000.0, 25000.0
# Between these the white point goes over from the black body's to daylight's.
_CROSSOVER = (4000.0, 5000.0)
# Linearised Bradford cone responses (Lam 1985; ICC.1:2022, annex E.3)
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
# Rec. 709 primaries and white, CIE x and y (ITU-R BT.709-6)
_PRIMARIES = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
_WHITE = (0.3127, 0.3290)

# AgX: how far towards white; stops below and above middle grey; the curve's slope there, in code
# values of a display of this gamma, and how sharply it bends; entries of its table
_INSET = 0.2
_GREY, _STOPS = 0.18, (-10.0, 6.5)
_GAMMA, _SLOPE, _BEND = 2.2, 2.4, 1.5
_CURVE = 4096

# A view transform as a table, which is fast: entries along an edge, and stops that they span
_EDGE, _SPAN = 65, (-12.0, 10.0)

# Pixels that are worth a thread of their own
_STRIPE = 1 << 16


@dataclass(frozen=True)
class Display:
    """How linear light becomes a picture for a screen.

    view_transform: one of VIEW_TRANSFORMS. exposure: stops; light is multiplied by 2^exposure.
    white_balance: what light shall look white, as a temperature in kelvin or CIE x and y; None for
    that of sRGB, D65. Colours are adapted to it by the linear Bradford transform.

    Raises SceneError for values without meaning.
    """

    view_transform: str = "srgb"
    exposure: float = 0.0
    white_balance: WhiteBalance | None = None

    def __post_init__(self) -> None:
        if self.view_transform not in VIEW_TRANSFORMS:
            name, choices = self.view_transform, VIEW_TRANSFORMS
            raise SceneError(unknown_name(option("view_transform"), name, choices))
        object.__setattr__(self, "exposure", checked_exposure(self.exposure))
        object.__setattr__(self, "white_balance", _checked_white(self.white_balance))

    def matrix(self) -> NDArray[np.float64]:
        """(3, 3): linear Rec. 709 to the same, exposed and balanced."""
        return np.asarray(2.0**self.exposure * _adaptation(self.white_balance))

    def before(self, color: tuple[float, float, float]) -> tuple[float, float, float]:
        """The linear colour that exposure and white balance make `color`; nothing below 0."""
        r, g, b = np.maximum(np.linalg.solve(self.matrix(), color), 0.0).tolist()
        return r, g, b

    def encode(
        self, linear: NDArray[np.float32], bits: int = 8, *, fast: bool = False
    ) -> NDArray[Any]:
        """Linear Rec. 709, (H, W, 3), as sRGB in whole numbers, uint8 or uint16.

        NaN becomes black. fast: by a table, a few levels of 255 off in rare colours, for pictures
        that are made many times a second; nothing else depends on it.
        """
        seen = linear = np.ascontiguousarray(linear, np.float32)
        if self.white_balance is not None:
            with np.errstate(over="ignore", invalid="ignore"):  # told of as black or white
                seen = linear @ self.matrix().T.astype(np.float32)
        elif self.exposure:
            with np.errstate(over="ignore"):
                seen = linear * np.float32(2.0**self.exposure)
        if self.view_transform == "srgb":
            return srgb_stored(seen, bits)
        kind = np.uint8 if bits == 8 else np.uint16
        seen = np.nan_to_num(seen, copy=seen is linear, nan=0.0)
        np.clip(seen, -_BRIGHTEST, _BRIGHTEST, out=seen)
        stored = np.empty(seen.shape, kind)
        _each_stripe(_processor(self.view_transform, bits, fast), seen, stored)
        return stored

    def metadata(self) -> dict[str, str]:
        """What a file says of how it is to be seen."""
        told = {
            "parhelion:exposure": f"{self.exposure:g}",
            "parhelion:view_transform": self.view_transform,
        }
        if self.white_balance is not None:
            told["parhelion:white_balance"] = white_balance_text(self.white_balance)
        return told


def told_display(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """What a file's metadata say of how it is to be seen, as Display takes it.

    What has no meaning counts as not said.
    """
    found: dict[str, Any] = {}
    for name in ("view_transform", "exposure", "white_balance"):
        text = metadata.get(f"parhelion:{name}")
        with suppress(SceneError, TypeError, ValueError):
            if text is not None:
                value: Any = str(text)
                if name == "exposure":
                    value = float(value)
                elif name == "white_balance":
                    value = parsed_white_balance(value)
                Display(**{name: value})
                found[name] = value
    return found


def checked_exposure(exposure: Any) -> float:
    """A number of stops. Raises SceneError for anything else."""
    try:
        stops = float(exposure)
    except (TypeError, ValueError, OverflowError):
        stops = np.nan
    if not abs(stops) <= _MOST_EXPOSURE:
        raise SceneError(
            f"{option('exposure')} is {exposure!r}; must be a number of stops,"
            f" from {-_MOST_EXPOSURE:g} to {_MOST_EXPOSURE:g}"
        )
    return stops


def parsed_white_balance(text: str) -> WhiteBalance:
    """What white_balance_text() writes: "3200" or "0.3457,0.3585". Raises SceneError."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise SceneError(_white_error(text))
    white = _checked_white(numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1]))
    assert white is not None
    return white


def white_balance_text(white: WhiteBalance) -> str:
    """As it is written on the command line and in files."""
    return ",".join(f"{v!r}" for v in white) if isinstance(white, tuple) else f"{white!r}"


def _checked_white(white: Any) -> WhiteBalance | None:
    if white is None:
        return None
    try:
        if isinstance(white, (str, bytes)):
            raise TypeError
        if np.ndim(white) == 0:
            kelvin = float(white)
            if _WARMEST <= kelvin <= _COLDEST:
                return kelvin
        else:
            x, y = (float(v) for v in white)
            # within the triangle of all chromaticities, and not so near its lower edge, where
            # light has no luminance, that adapting to it would divide by nearly nothing
            if 0 < x < 1 and 0.02 <= y < 1 and x + y < 1:
                cones = _BRADFORD @ _xyz((x, y))
                if cones.min() > 0:
                    return x, y
    except (TypeError, ValueError, OverflowError):
        pass
    raise SceneError(_white_error(white))


def _white_error(white: Any) -> str:
    return (
        f"{option('white_balance')} is {white!r}; must be a temperature from {_WARMEST:g} to"
        f" {_COLDEST:g} (kelvin), or the chromaticity of a white: CIE x and y"
    )


# --- White balance -------------------------------------------------------------------------------


@cache
def _adaptation(white: WhiteBalance | None) -> NDArray[np.float64]:
    """(3, 3) on linear Rec. 709: light of this white becomes neutral, of the same luminance."""
    if white is None:
        return np.eye(3)
    at = white if isinstance(white, tuple) else chromaticity(white)
    to_xyz = _to_xyz(_PRIMARIES)
    return np.asarray(np.linalg.solve(to_xyz, _to_d65(at) @ to_xyz))


def to_rec709(chromaticities: Any) -> NDArray[np.float64] | None:
    """(3, 3): linear RGB of other primaries to Rec. 709, white to white (linear Bradford).

    chromaticities: CIE x and y of red, green, blue and white, 8 numbers as EXR files have them.
    None for those of Rec. 709. Raises SceneError for what are no primaries.
    """
    own = [*_PRIMARIES.ravel(), *_WHITE]
    try:
        values = np.array(chromaticities, np.float64).reshape(4, 2)
        if np.allclose(values.ravel(), own, atol=1e-3):
            return None
        white = float(values[3, 0]), float(values[3, 1])
        with np.errstate(all="ignore"):
            light = _to_d65(white) @ _to_xyz(values[:3], white)
        if not np.isfinite(light).all():
            raise ValueError
    except (TypeError, ValueError, ZeroDivisionError) as error:  # ValueError: LinAlgError too
        raise SceneError(f"there are no primaries {chromaticities!r}") from error
    return np.asarray(np.linalg.solve(_to_xyz(_PRIMARIES), light))


def _to_d65(white: tuple[float, float]) -> NDArray[np.float64]:
    """(3, 3) on CIE XYZ: light of this white becomes sRGB's white, of the same luminance."""
    scale = (_BRADFORD @ _xyz(_WHITE)) / (_BRADFORD @ _xyz(white))
    return np.asarray(np.linalg.solve(_BRADFORD, scale[:, None] * _BRADFORD))


def chromaticity(kelvin: float) -> tuple[float, float]:
    """CIE x and y of light of a colour temperature, 1000 to 25000 K.

    Below 4000 K a black body's (Planck), above 5000 K daylight's (CIE 015:2018, 4.1.2), and in
    between a mixture, linear in the temperature.
    """
    from .spectra import planckian

    low, high = _CROSSOVER
    share = min(max((kelvin - low) / (high - low), 0.0), 1.0)
    body = planckian(kelvin) if share < 1.0 else (0.0, 0.0)
    day = _daylight(kelvin) if share > 0.0 else (0.0, 0.0)
    x, y = ((1.0 - share) * b + share * d for b, d in zip(body, day, strict=True))
    return x, y


def _daylight(kelvin: float) -> tuple[float, float]:
    t = 1e3 / kelvin
    if kelvin <= 7000.0:
        x = 0.244063 + t * (0.09911 + t * (2.9678 - 4.6070 * t))
    else:
        x = 0.237040 + t * (0.24748 + t * (1.9018 - 2.0064 * t))
    return x, -3.000 * x * x + 2.870 * x - 0.275


def _xyz(at: tuple[float, float]) -> NDArray[np.float64]:
    """CIE XYZ of a chromaticity, of luminance 1."""
    x, y = at
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def _to_xyz(
    primaries: NDArray[np.float64], white: tuple[float, float] = _WHITE
) -> NDArray[np.float64]:
    """(3, 3): RGB of these primaries, (3, 2) CIE x and y, and of this white, to CIE XYZ."""
    columns = np.stack([_xyz((float(x), float(y))) for x, y in primaries], axis=1)
    return np.asarray(columns * np.linalg.solve(columns, _xyz(white)))


# --- View transforms -----------------------------------------------------------------------------


def srgb_stored(linear: NDArray[np.float32], bits: int = 8) -> NDArray[Any]:
    """Linear light as sRGB in whole numbers, uint8 or uint16."""
    scaled = srgb_encoded(linear) * np.float32(2**bits - 1) + np.float32(0.5)
    stored: NDArray[Any] = scaled.astype(np.uint8 if bits == 8 else np.uint16)
    return stored


def srgb_encoded(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear light to sRGB's encoding (IEC 61966-2-1), cut to [0, 1]; NaN becomes 0."""
    x = np.nan_to_num(linear, nan=0.0)
    np.clip(x, 0.0, 1.0, out=x)
    straight = np.float32(12.92) * x
    dark = x <= np.float32(0.0031308)
    np.power(x, np.float32(1 / 2.4), out=x)
    x *= np.float32(1.055)
    x -= np.float32(0.055)
    np.copyto(x, straight, where=dark)
    return x


@cache
def _transform(name: str) -> Any:
    """OpenColorIO's Processor."""
    import PyOpenColorIO as ocio

    if name == "agx":
        return ocio.Config.CreateRaw().getProcessor(ocio.GroupTransform(_agx()))
    config, view = _CONFIGS[name]
    built_in = ocio.Config.CreateFromBuiltinConfig(config)
    return built_in.getProcessor(_FROM, _TO, view, ocio.TRANSFORM_DIR_FORWARD)


@cache
def _processor(name: str, bits: int, fast: bool) -> Any:
    """OpenColorIO's CPUProcessor from float to whole numbers."""
    import PyOpenColorIO as ocio

    stored = ocio.BIT_DEPTH_UINT8 if bits == 8 else ocio.BIT_DEPTH_UINT16
    made, quality = _transform(name), ocio.OPTIMIZATION_LOSSLESS
    if fast:
        table = ocio.GroupTransform(_table(made))
        made, quality = ocio.Config.CreateRaw().getProcessor(table), ocio.OPTIMIZATION_DRAFT
    return made.getOptimizedCPUProcessor(ocio.BIT_DEPTH_F32, stored, quality)


def _table(made: Any) -> list[Any]:
    """A transform's values on a grid of logarithms, and how to look them up."""
    import PyOpenColorIO as ocio

    low, high = _SPAN
    darkest = 2.0**low  # added to all light, so that black has a logarithm
    axis = (2.0 ** np.linspace(low, high, _EDGE) - darkest).astype(np.float32)
    grid = np.ascontiguousarray(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1))
    made.getDefaultCPUProcessor().applyRGB(grid)
    cube = ocio.Lut3DTransform(_EDGE)
    cube.setInterpolation(ocio.INTERP_TETRAHEDRAL)
    cube.setData(grid.ravel())
    scale = 1.0 / (high - low)
    log = ocio.LogAffineTransform([scale] * 3, [-low * scale] * 3, [1.0] * 3, [darkest] * 3)
    return [log, cube]


def _agx() -> list[Any]:
    """The transforms, one after the other."""
    import PyOpenColorIO as ocio

    inset = _to_xyz(np.asarray(_WHITE) + (1.0 - _INSET) * (_PRIMARIES - _WHITE))
    outer = _to_xyz(_PRIMARIES)
    low, high = _STOPS
    scale = 1.0 / (high - low)
    darkest = _GREY * 2.0**low
    curve = ocio.Lut1DTransform(_CURVE, False)
    for i, value in enumerate(agx_curve(np.linspace(0.0, 1.0, _CURVE)).tolist()):
        curve.setValue(i, value, value, value)
    return [
        _matrix(np.linalg.solve(outer, inset)),
        ocio.RangeTransform(darkest, _BRIGHTEST, darkest, _BRIGHTEST),
        ocio.LogAffineTransform(
            [scale] * 3, [-scale * (low + float(np.log2(_GREY)))] * 3, [1.0] * 3, [0.0] * 3
        ),
        curve,
        ocio.ExponentTransform([_GAMMA, _GAMMA, _GAMMA, 1.0]),
        _matrix(np.linalg.solve(inset, outer)),
        ocio.RangeTransform(0.0, 1.0, 0.0, 1.0),
        ocio.ExponentWithLinearTransform(
            [2.4, 2.4, 2.4, 1.0],
            [0.055, 0.055, 0.055, 0.0],
            ocio.NEGATIVE_LINEAR,
            ocio.TRANSFORM_DIR_INVERSE,
        ),
    ]


def agx_curve(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Stops, 0 to 1 for the range of AgX, to code values of the display.

    To both sides of middle grey a line is bent by s / (1 + s^p)^(1/p), so that it meets the ends.
    """
    x0, y0 = -_STOPS[0] / (_STOPS[1] - _STOPS[0]), _GREY ** (1.0 / _GAMMA)

    def side(distance: NDArray[np.float64], end: float, top: float) -> NDArray[np.float64]:
        # where the line would go on to without an end, for the curve to be at `top` at `end`
        limit = (top**-_BEND - (_SLOPE * end) ** -_BEND) ** (-1.0 / _BEND)
        line = _SLOPE * np.maximum(distance, 0.0)
        return np.asarray(line / (1.0 + (line / limit) ** _BEND) ** (1.0 / _BEND))

    y = y0 - side(x0 - x, x0, y0) + side(x - x0, 1.0 - x0, 1.0 - y0)
    return np.asarray(np.clip(y, 0.0, 1.0))  # rounding


def _matrix(rows: NDArray[Any]) -> Any:
    import PyOpenColorIO as ocio

    square = np.eye(4)
    square[:3, :3] = rows
    return ocio.MatrixTransform(square.ravel().tolist())


def _each_stripe(processor: Any, linear: NDArray[np.float32], stored: NDArray[Any]) -> None:
    """Runs a processor over rows, by all threads where there is enough to do."""
    import PyOpenColorIO as ocio

    height, width = linear.shape[:2]
    depth = ocio.BIT_DEPTH_UINT8 if stored.itemsize == 1 else ocio.BIT_DEPTH_UINT16

    def described(rows: NDArray[Any], kind: Any) -> Any:
        return ocio.PackedImageDesc(
            rows, width, len(rows), 3, kind, rows.itemsize, rows.strides[1], rows.strides[0]
        )

    def run(rows: slice) -> None:
        processor.apply(described(linear[rows], ocio.BIT_DEPTH_F32), described(stored[rows], depth))

    count = max(1, min(machine.cores_available(), height, height * width // _STRIPE))
    edges = [height * i // count for i in range(count + 1)]
    stripes = [slice(a, b) for a, b in pairwise(edges)]
    if count == 1:
        run(stripes[0])
    else:
        with ThreadPoolExecutor(count) as pool:
            list(pool.map(run, stripes))
