"""What of a picture is shown, and in which colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..display import Display, srgb_stored

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .drawing import Frame

PICTURE = "picture"
# layer -> what it is called. All but the first are features, rendered when asked for.
LAYERS = {
    PICTURE: "Picture",
    "direct": "Direct light",
    "indirect": "Indirect light",
    "emission": "Emission",
    "albedo": "Albedo",
    "normal": "Normal, geometric",
    "shading_normal": "Normal, shading",
    "depth": "Depth",
    "position": "Position",
    "uv": "UV",
    "coverage": "Coverage",
    "shape": "Objects",
    "material": "Materials",
    "samples": "Samples per pixel",
    "error": "Noise",
}
# Light is brighter or darker with the exposure; all else is not.
_LIGHT = (PICTURE, "direct", "indirect", "emission")

# From the square root of linear light to sRGB in 8 bits: twice as fast as the formula (15 ms for
# 1280 x 720 pixels, not 30), and the same but for a last bit.
_STEPS = 8191
_SRGB = srgb_stored((np.arange(_STEPS + 1, dtype=np.float32) / np.float32(_STEPS)) ** 2)


def needs_features(layer: str) -> bool:
    """Whether a layer is more than the picture and its counts."""
    return layer not in (PICTURE, "samples", "error")


def shown(layer: str, frame: Frame, display: Display) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB of a layer of a frame."""
    features = frame.features
    if layer in _LIGHT:
        return seen(frame.pixels if layer == PICTURE else features[layer], display)
    if layer == "samples":
        counts = frame.counts
        return _grey(counts.astype(np.float32) / max(1, int(counts.max(initial=1))))
    if layer == "error":
        return _noise(frame)
    values = features[layer]
    covered = features["coverage"] > 0
    if layer == "albedo":
        return seen(values, Display())
    if layer == "coverage":
        return _grey(values)
    if layer in ("normal", "shading_normal"):
        colors = 0.5 + 0.5 * values
    elif layer == "uv":
        colors = np.concatenate([np.mod(values, 1.0), np.zeros_like(values[..., :1])], axis=-1)
    elif layer == "depth":
        return _grey(np.where(covered, 1.0 - _stretched(values[..., 0], covered), 0.0))
    elif layer == "position":
        parts = [_stretched(values[..., k], covered) for k in range(3)]
        colors = np.stack(parts, axis=-1)
    else:
        return _told_apart(values)
    colors = np.where(covered[..., None], colors, 0.0)
    return _bytes(colors)


def seen(light: NDArray[np.float32], display: Display) -> NDArray[np.uint8]:
    """Linear light as a screen shows it, 8-bit sRGB; NaN is black."""
    if display.view_transform != "srgb":
        made: NDArray[np.uint8] = display.encode(light, fast=True)
        return made
    with np.errstate(over="ignore", invalid="ignore"):
        x = light * np.float32(2.0**display.exposure)
        np.nan_to_num(x, copy=False, nan=0.0)
        np.clip(x, 0.0, 1.0, out=x)
    np.sqrt(x, out=x)
    x *= _STEPS
    x += np.float32(0.5)
    stored: NDArray[np.uint8] = _SRGB[x.astype(np.uint16)]
    return stored


def _noise(frame: Frame) -> NDArray[np.uint8]:
    """Black for none, white for errors of as much as the light itself, or where none is known."""
    height, width = frame.pixels.shape[:2]
    errors = frame.block_errors
    if errors is None:
        return np.full((height, width, 3), 255, np.uint8)
    from .. import _core

    blocks = np.sqrt(np.minimum(errors, 1.0))  # the root, as most are far below 1
    return _grey(np.repeat(np.repeat(blocks, _core.block, 0), _core.block, 1)[:height, :width])


def _bytes(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Numbers from 0 to 1 as they are, not as light."""
    scaled = np.clip(np.nan_to_num(colors), 0.0, 1.0) * 255.0 + 0.5
    stored: NDArray[np.uint8] = scaled.astype(np.uint8)
    return stored


def _grey(values: NDArray[Any]) -> NDArray[np.uint8]:
    return np.repeat(_bytes(values.reshape(*values.shape[:2], 1)), 3, axis=2)


def _stretched(values: NDArray[Any], where: NDArray[np.bool_]) -> NDArray[Any]:
    """From 0 to 1 over the values that count, but for the outermost hundredth at both ends."""
    some = values[where]
    if some.size == 0:
        return np.zeros_like(values)
    low, high = np.percentile(some, (1, 99))
    stretched: NDArray[Any] = np.clip((values - low) / max(float(high - low), 1e-30), 0.0, 1.0)
    return stretched


def _told_apart(indices: NDArray[Any]) -> NDArray[np.uint8]:
    """A colour for each index: hues a golden ratio apart, black for none."""
    hue = np.mod(indices * 0.61803398875, 1.0)[..., None]
    turns = np.mod(hue + np.array([0.0, 2.0 / 3.0, 1.0 / 3.0]), 1.0)
    colors = 0.25 + 0.7 * np.clip(np.abs(6.0 * turns - 3.0) - 1.0, 0.0, 1.0)
    return _bytes(np.where(indices[..., None] < 0, 0.0, colors))
