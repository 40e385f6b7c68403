"""What a comparison found as one HTML page, with its pictures in it."""

from __future__ import annotations

import base64
import math
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from .comparison import flip_colors, side_by_side
from .display import Display
from .errors import plain
from .image import encoded

if TYPE_CHECKING:
    from .comparison import Comparison

# What each measure is called, and what it says
MEASURES = {
    "mse": ("MSE", "mean squared error of linear light"),
    "relmse": ("relMSE", "each squared error over r² + (0.1 m)², m the reference's mean"),
    "relmse_trimmed": ("relMSE, trimmed", "without the worst pixel of a thousand"),
    "largest": ("largest", "difference of a channel of a pixel"),
    "psnr": ("PSNR", "dB, as seen: sRGB from 0 to 1; more is better"),
    "ssim": ("SSIM", "as seen; 1 is the same"),
    "flip": ("FLIP", "mean difference that is seen when the two alternate; 0 is the same"),
    "p": ("p of the z-test", "chance of such differences if only noise differs"),
    "not_finite": ("not finite", "pixels of both, left out of all else"),
}


def page(found: Comparison, names: tuple[str, str]) -> str:
    """The whole page."""
    height, width = found.flip_map.shape
    shown = Display(exposure=found.exposure)
    pair = side_by_side(found.picture, found.reference, found.exposure)
    pictures = [
        (names[0], shown.encode(found.picture)),
        (names[1], shown.encode(found.reference)),
        ("difference, five times, around grey", pair[:, 2 * width + 4 :]),
        ("FLIP, from black to white", flip_colors(found.flip_map)),
    ]
    sources = [(name, _source(pixels)) for name, pixels in pictures]
    first, second = (escape(plain(name)) for name in names)
    rows = "".join(
        f"<tr><th scope='row'>{escape(MEASURES[name][0])}</th><td>{number(value)}</td>"
        f"<td>{escape(MEASURES[name][1])}</td></tr>"
        for name, value in found.numbers().items()
    )
    ratio = " ".join(f"{r:.4f}" for r in found.ratio)
    rows += (
        f"<tr><th scope='row'>means</th><td>{ratio}</td><td>R G B over the reference's</td></tr>"
    )
    test = ""
    if found.test is not None:
        word = "no difference but noise" if found.test.agrees else "they differ"
        test = f"<p>z-test at 1 %: {word}. {escape(str(found.test))}.</p>"
    figures = "".join(
        f"<figure><img src='{source}' alt='{escape(plain(name))}' width='{width}'"
        f" height='{height}'><figcaption>{escape(plain(name))}</figcaption></figure>"
        for name, source in sources
    )
    two = [source for _, source in sources]
    return f"""<!doctype html>
<html lang='en'><head><meta charset='utf-8'>
<meta name='viewport' content='width=device-width, initial-scale=1'>
<meta name='color-scheme' content='light dark'>
<title>{first} against {second}</title><style>{_CSS}</style></head><body><main>
<h1>{first} against {second}</h1>
<p>{width} x {height} pixels, exposure {found.exposure:g}</p>
<table>{rows}</table>{test}
<section aria-labelledby='turns'><h2 id='turns'>One over the other</h2>
<p><label>reference <input id='share' type='range' min='0' max='100' value='50'
 aria-label='share of the width that shows the picture'> picture</label>
 <button id='turn' type='button' aria-pressed='false'>alternate</button></p>
<div class='over' style='width:{width}px;aspect-ratio:{width}/{height}'>
<img src='{two[1]}' alt='{second}'><img id='top' src='{two[0]}' alt='{first}'></div></section>
<section aria-labelledby='all'><h2 id='all'>Pictures</h2>{figures}</section>
</main><script>{_SCRIPT}</script></body></html>
"""


def number(value: float) -> str:
    """A measure as text."""
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.6g}" if math.isfinite(value) else "infinite"


def _source(pixels: Any) -> str:
    data = encoded(np.ascontiguousarray(pixels), {}, ".png")
    return f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"


_CSS = """
body{font:16px/1.5 system-ui,sans-serif;margin:0;background:Canvas;color:CanvasText}
main{max-width:110rem;margin:auto;padding:1rem}
h1{font-size:1.4rem;overflow-wrap:anywhere}h2{font-size:1.1rem}
table{border-collapse:collapse}th,td{text-align:left;padding:.15rem 1rem .15rem 0}
td:nth-child(2){font-variant-numeric:tabular-nums;white-space:nowrap}
figure{display:inline-block;margin:0 1rem 1rem 0;max-width:100%}
figcaption{overflow-wrap:anywhere}
img{max-width:100%;height:auto;image-rendering:pixelated;display:block}
.over{position:relative;max-width:100%}
.over img{position:absolute;inset:0;width:100%;height:100%}
#top{clip-path:inset(0 50% 0 0)}
"""

_SCRIPT = """
const top_ = document.getElementById('top'), share = document.getElementById('share');
const turn = document.getElementById('turn');
let timer = 0;
const show = part => { top_.style.clipPath = `inset(0 ${100 - part}% 0 0)`; };
const stop = () => { clearInterval(timer); timer = 0; turn.setAttribute('aria-pressed', 'false'); };
share.oninput = () => { stop(); show(share.value); };
turn.onclick = () => {
  if (timer) { stop(); show(share.value); return; }
  let on = false;
  timer = setInterval(() => show((on = !on) ? 100 : 0), 600);
  turn.setAttribute('aria-pressed', 'true');
};
"""
