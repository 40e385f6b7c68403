"""What a picture's colours stand for, drawn at its side: a bar of numbers or swatches of kinds."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from .display import srgb_stored
from .particles import mapped
from .scene import ColorBar, Swatches

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Pixels = NDArray[np.uint8]

# Lengths as shares of the height of a letter's line, which is this share of the picture's height,
# in pixels, but not less than can be read.
_LINE, _SMALLEST = 1 / 28, 9.0
_BAR_WIDTH = 1.2
_MARGIN = 1.0
# The bar's height as a share of the picture's; those of swatches and their distance in lines.
_BAR_HEIGHT = 0.8
_SWATCH, _STEP = 0.9, 1.5
# Around swatches, which may be white
_EDGE = 128
# At which a point of a font's size is a pixel
_DPI = 72


def panel(legend: ColorBar | Swatches, height: int) -> Pixels:
    """The legend on white, (height, any even width, 3) 8-bit sRGB."""
    line = _line(height)
    return (
        _bar(legend, height, line) if isinstance(legend, ColorBar) else _list(legend, height, line)
    )


def _line(height: int) -> float:
    return max(_SMALLEST, _LINE * height)


def bar_rows(height: int) -> range:
    """The rows of a panel that a colour bar takes, from its highest value to its lowest."""
    rows = max(2, round(_BAR_HEIGHT * height))
    top = (height - rows) // 2
    return range(top, top + rows)


def bar_values(legend: ColorBar, height: int) -> NDArray[np.float64]:
    """The value in the middle of each row of bar_rows()."""
    rows = len(bar_rows(height))
    if legend.low == legend.high:
        return np.full(rows, legend.low)
    share = (np.arange(rows)[::-1] + 0.5) / rows
    # not low + share * (high - low), which may overflow
    return (1.0 - share) * legend.low + share * legend.high


def bar_columns(height: int) -> range:
    """The columns of a panel that a colour bar takes."""
    line = _line(height)
    left = round(_MARGIN * line)
    return range(left, left + max(4, round(_BAR_WIDTH * line)))


def _bar(legend: ColorBar, height: int, line: float) -> Pixels:
    rows, columns = bar_rows(height), bar_columns(height)

    def draw(figure: Any, width: int) -> float:
        place = (columns.start / width, 1.0 - rows.stop / height)
        axes = figure.add_axes((*place, len(columns) / width, len(rows) / height))
        low, high = legend.low, legend.high
        axes.set_xticks([])
        if low < high and high - low < np.finfo(np.float64).max:
            axes.set_ylim(low, high)
            axes.ticklabel_format(axis="y", useOffset=False)
        else:  # one value, or more than differences can tell
            ticks = {0.5: 0.5 * low + 0.5 * high} | ({} if low == high else {0.0: low, 1.0: high})
            axes.set_yticks(list(ticks), [f"{value:.4g}" for value in ticks.values()])
        axes.yaxis.tick_right()
        axes.yaxis.set_label_position("right")
        axes.set_ylabel(legend.label, parse_math=False, fontsize=0.75 * line)
        axes.tick_params(labelsize=0.75 * line, width=0.06 * line, length=0.3 * line)
        axes.yaxis.get_offset_text().set_fontsize(0.75 * line)
        for spine in axes.spines.values():
            spine.set_linewidth(0.06 * line)
        figure.canvas.draw()
        box = axes.get_tightbbox()
        return float(box.x1)

    pixels = _drawn(draw, height, line)
    colors = mapped(bar_values(legend, height), legend.colormap, legend.low, legend.high)
    pixels[rows.start : rows.stop, columns.start : columns.stop] = srgb_stored(colors)[:, None]
    return pixels


def _list(legend: Swatches, height: int, line: float) -> Pixels:
    room = max(1, int((height / line - 2 * _MARGIN) / _STEP) - 1)
    kinds, rest = legend.kinds[:room], len(legend.kinds) - room
    if rest > 0:
        kinds, rest = kinds[:-1], rest + 1
    first = 0.5 * (height - _STEP * line * (len(kinds) + (rest > 0) - 1)) + 0.5 * _STEP * line
    left, size, edge = round(_MARGIN * line), round(_SWATCH * line), ceil(0.06 * line)

    def draw(figure: Any, width: int) -> float:
        words = {"fontsize": 0.8 * line, "va": "center_baseline", "parse_math": False}
        right = 0.0
        names = [name for name, _ in kinds] + ([f"and {rest} more"] if rest > 0 else [])
        for i, (indent, name) in enumerate([(0.0, legend.label), *((1.4, n) for n in names)]):
            x, y = left + indent * line, first + (i - 1) * _STEP * line
            text = figure.text(x / width, 1.0 - y / height, name, **words)
            right = max(right, float(text.get_window_extent().x1))
        return right

    pixels = _drawn(draw, height, line)
    colors = srgb_stored(np.array([color for _, color in kinds], np.float32))
    for i, color in enumerate(colors):
        top = max(0, round(first + i * _STEP * line - 0.5 * size))
        pixels[top : top + size, left : left + size] = _EDGE
        pixels[top + edge : top + size - edge, left + edge : left + size - edge] = color
    return pixels


def _drawn(draw: Callable[[Any, int], float], height: int, line: float) -> Pixels:
    """What is drawn on a white figure, which is cut, or widened, to an even width that holds it.

    draw: gets the figure and its width in pixels, and returns how far to the right it drew.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width = 2 * ceil(2 * line)
    for _ in range(2):  # to know the width, and to use it
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        canvas: Any = FigureCanvasAgg(figure)
        drawn = width
        width = 2 * ceil(0.5 * (draw(figure, width) + _MARGIN * line))
    canvas.draw()
    pixels: Pixels = np.array(canvas.buffer_rgba())[:, :, :3]
    assert pixels.shape[:2] == (height, drawn)
    return pixels
