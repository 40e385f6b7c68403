"""The charts of a study, drawn once and written twice: as a PNG, and as SVG inside the report.

Colours are the Okabe-Ito set, told apart with every common form of colour blindness; widths and
thread counts, which have an order, are shades of one of them, and markers differ as well. In the
SVG every colour becomes a CSS variable, so that the report follows the reader's light or dark
setting.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from . import original, words

if TYPE_CHECKING:
    from .measure import Study
    from .summary import Point, Summary

# name: (on white, on dark). Each colour on white is used for one thing only, as the SVG's
# variables are found by it.
COLORS = {
    "page": ("#ffffff", "#14171b"),
    "ink": ("#1b1f24", "#e6e9ec"),
    "muted": ("#5c6670", "#a4adb6"),
    "grid": ("#e3e6e9", "#2c3238"),
    "over": ("#f4f1ea", "#211f1a"),
    "ours": ("#0072b2", "#56b4e9"),
    "theirs": ("#c25400", "#f0934a"),
    "third": ("#00795a", "#3fc79f"),
}
SHADES = {
    "ours": (("#4a98cc", "#08304f"), ("#2f78a8", "#bfe2fb")),
    "theirs": (("#cb7233", "#6b2d00"), ("#b0622a", "#fbd3b4")),
}
STEPS = 7
"""Shades in a ramp; a longer list of widths or thread counts shares some of them."""
MARKERS = "osD^vPX"


def palette(dark: bool = False) -> dict[str, str]:
    """All colours by name, ramps as ours-0 ... theirs-6, from faint to strong."""
    colors = {name: both[dark] for name, both in COLORS.items()}
    for name, ramps in SHADES.items():
        first, last = ramps[dark]
        for step in range(STEPS):
            colors[f"{name}-{step}"] = _mix(first, last, step / (STEPS - 1))
    return colors


def _mix(first: str, last: str, share: float) -> str:
    pairs = [(int(first[k : k + 2], 16), int(last[k : k + 2], 16)) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(a + (b - a) * share):02x}" for a, b in pairs)


C = palette()


def shade(name: str, place: int, many: int) -> str:
    """The colour of entry `place` of `many`, the last one strongest."""
    return C[f"{name}-{round((STEPS - 1) * place / (many - 1)) if many > 1 else STEPS - 1}"]


End = tuple[float, float, str, str]
"""Where a line ends, in data coordinates; its name; its colour."""


class Chart(NamedTuple):
    """One chart: a short name, a title, what it shows in words, and how to draw it."""

    name: str
    title: str
    alt: str
    draw: Callable[[Any], None]


def charts(study: Study, summary: Summary) -> list[Chart]:
    """The charts this study has data for."""
    line = words.main_line(study, summary)
    if not line:
        return []
    found = [
        Chart(
            "speedup",
            "Speed-up",
            "Speed-up against threads. " + _told(line, "speedup"),
            lambda ax: draw_speedup(ax, study, summary),
        ),
        Chart(
            "efficiency",
            "Efficiency",
            "Efficiency against threads. " + _told(line, "efficiency"),
            lambda ax: draw_efficiency(ax, study, summary),
        ),
        Chart(
            "time",
            "Time",
            "Seconds against picture width, a line a thread count, both axes logarithmic. "
            + "; ".join(
                f"{p.width} px, {p.threads} threads: {words.seconds(p.median)}"
                for p in _corners(study, summary)
            ),
            lambda ax: draw_time(ax, study, summary),
        ),
        Chart(
            "original",
            "Beside the original",
            f"Speed-up of the original study against threads, reaching "
            f"{_best_of_original():.2f} at {original.BEST_THREADS} threads at 960 px, and of this "
            "study. " + _told(line, "speedup"),
            lambda ax: draw_original(ax, study, summary),
        ),
        Chart(
            "share",
            "Where the threads' time went",
            "Share of the threads' time: "
            + "; ".join(
                f"{p.threads} threads: {words.percent(p.useful)} useful, "
                f"{words.percent(p.extra)} extra, {words.percent(p.waiting)} waiting"
                for p in line
                if p.useful is not None and p.extra is not None and p.waiting is not None
            ),
            lambda ax: draw_share(ax, study, summary),
        ),
    ]
    if len(study.plan.schedules) > 1:
        found.append(
            Chart(
                "schedules",
                "Schedules",
                f"Seconds with each schedule relative to {study.plan.schedules[0]} with the same "
                "number of threads. The table holds the numbers.",
                lambda ax: draw_schedules(ax, study, summary),
            )
        )
    return found


def _told(line: Sequence[Point], what: str) -> str:
    values = [(p.threads, getattr(p, what)) for p in line]
    return f"At {line[0].width} px: " + "; ".join(
        f"{n} threads {value:.2f}" for n, value in values if value is not None
    )


def _corners(study: Study, summary: Summary) -> list[Point]:
    """Fewest and most threads at the least and the largest width."""
    widths = {summary.widths[0], summary.widths[-1]}
    counts = {study.plan.threads[0], study.plan.threads[-1]}
    schedule = study.plan.schedules[0]
    return [
        p
        for p in summary.points
        if p.schedule == schedule and p.width in widths and p.threads in counts
    ]


def _best_of_original() -> float:
    column = original.column(960)
    return column[0] / column[original.THREADS.index(original.BEST_THREADS)]


def draw_speedup(ax: Any, study: Study, summary: Summary) -> None:
    """Speed-up against threads: a line a width, Amdahl fits dotted, the ideal dashed."""
    _thread_axis(ax, study, list(study.plan.threads), note="bottom")
    ax.set_yscale("log", base=2)
    ax.set_ylabel("speed-up over one thread")
    _plain_ticks(ax.yaxis, _powers(max(study.plan.threads)))
    top = _ideal(ax, study, max(study.plan.threads))
    labels: list[End] = [top]
    schedule = study.plan.schedules[0]
    for place, width in enumerate(summary.widths):
        color = shade("ours", place, len(summary.widths))
        line = [p for p in summary.of(width, schedule) if p.speedup is not None]
        if not line:
            continue
        fit = summary.fits.get((width, schedule))
        if fit is not None:
            curve = _between(1, study.plan.cores)
            ax.plot(curve, [fit.speedup(n) for n in curve], ":", color=color, lw=1.2)
        one = next(p.median for p in line if p.threads == 1)
        _line(
            ax,
            [p.threads for p in line],
            [p.speedup for p in line],
            [(one / p.greatest, one / p.least) for p in line],
            [p.oversubscribed for p in line],
            color,
            MARKERS[place % len(MARKERS)],
        )
        text = f"{width} px"
        if fit is not None and width == summary.widths[-1]:
            text += f", s = {words.percent(fit.serial)}"
        labels.append((line[-1].threads, line[-1].speedup or 1.0, text, color))
    _label(ax, labels)


def draw_efficiency(ax: Any, study: Study, summary: Summary) -> None:
    """Speed-up per thread against threads: a line a width."""
    _thread_axis(ax, study, list(study.plan.threads))
    ax.set_ylabel("efficiency (speed-up per thread)")
    counts = _between(1, max(study.plan.threads))
    ideal = [min(n, study.plan.cores) / n for n in counts]
    ax.plot(counts, ideal, "--", color=C["muted"], lw=1)
    labels: list[End] = [(counts[-1], ideal[-1], "ideal", C["muted"])]
    highest = 1.0
    for place, width in enumerate(summary.widths):
        color = shade("ours", place, len(summary.widths))
        line = [p for p in summary.of(width, study.plan.schedules[0]) if p.efficiency is not None]
        if not line:
            continue
        values = [p.efficiency or 0.0 for p in line]
        highest = max(highest, *values)
        over = [p.oversubscribed for p in line]
        marker = MARKERS[place % len(MARKERS)]
        _line(ax, [p.threads for p in line], values, None, over, color, marker)
        labels.append((line[-1].threads, values[-1], f"{width} px", color))
    ax.set_ylim(0, 1.08 * highest)
    _percent_ticks(ax.yaxis)
    _label(ax, labels)


def draw_time(ax: Any, study: Study, summary: Summary) -> None:
    """Seconds against width: a line a thread count."""
    from matplotlib.ticker import LogLocator

    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("picture width (px)")
    ax.set_ylabel("seconds")
    _plain_ticks(ax.xaxis, summary.widths)
    labels: list[End] = []
    schedule = study.plan.schedules[0]
    for place, threads in enumerate(study.plan.threads):
        color = shade("ours", place, len(study.plan.threads))
        line = [p for p in summary.points if p.schedule == schedule and p.threads == threads]
        if not line:
            continue
        over = line[0].oversubscribed
        _line(
            ax,
            [p.width for p in line],
            [p.median for p in line],
            [(p.least, p.greatest) for p in line],
            [over] * len(line),
            color,
            MARKERS[place % len(MARKERS)],
            "--" if over else "-",
        )
        text = words.count(threads, "thread") if place == 0 else str(threads)
        labels.append((line[-1].width, line[-1].median, text + (" (over)" if over else ""), color))
    ax.set_xlim(summary.widths[0] / 1.15, summary.widths[-1] * 1.15)
    points = [p for p in summary.points if p.schedule == schedule]
    low, high = min(p.least for p in points) / 1.3, max(p.greatest for p in points) * 1.3
    ax.set_ylim(low, high)
    if high < 200 * low:  # too few powers of ten to read a value from
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.yaxis.set_minor_formatter(lambda *_: "")
    _label(ax, labels)


def draw_share(ax: Any, study: Study, summary: Summary) -> None:
    """Bars of the threads' time: useful, extra, waiting."""
    line = [p for p in words.main_line(study, summary) if p.useful is not None]
    rows = range(len(line))
    start = [0.0] * len(line)
    for what, label, color in (
        ("useful", "useful work", C["ours"]),
        ("extra", "extra processor time", C["theirs"]),
        ("waiting", "waiting", C["grid"]),
    ):
        parts = [getattr(p, what) for p in line]
        ax.barh(rows, parts, left=start, color=color, height=0.66, label=label, lw=0)
        start = [a + b for a, b in zip(start, parts, strict=True)]
    ax.set_yticks(
        rows, [f"{p.threads} (over)" if p.oversubscribed else str(p.threads) for p in line]
    )
    ax.set_ylim(max(len(line), 5) - 0.5, -0.5)  # first on top, and no bar thicker than a fifth
    ax.set_ylabel("threads")
    ax.set_xlim(0, 1)
    ax.grid(visible=False)
    _percent_ticks(ax.xaxis)
    if line:
        ax.set_xlabel(f"share of the threads' time, {line[0].width} px")
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1),
        ncols=3,
        frameon=False,
        fontsize=8.5,
        borderaxespad=0.2,
        handlelength=1,
        columnspacing=1.2,
        labelcolor=C["ink"],
    )


def draw_schedules(ax: Any, study: Study, summary: Summary) -> None:
    """Median seconds of each schedule over those of the first one, least to greatest as bars."""
    plan = study.plan
    width = summary.widths[-1]
    _thread_axis(ax, study, list(plan.threads))
    ax.set_ylabel(f"time over {plan.schedules[0]}, {width} px")
    labels: list[End] = []
    colors = dict(zip(plan.schedules, (C["ours"], C["theirs"], C["third"]), strict=False))
    base = {p.threads: p.median for p in summary.of(width, plan.schedules[0])}
    for place, schedule in enumerate(plan.schedules):
        line = [p for p in summary.of(width, schedule) if p.threads in base]
        if not line:
            continue
        # Side by side, or the bars would hide each other.
        aside = 1.06 ** (place - (len(plan.schedules) - 1) / 2)
        values = [p.median / base[p.threads] for p in line]
        _line(
            ax,
            [p.threads * aside for p in line],
            values,
            [(p.least / base[p.threads], p.greatest / base[p.threads]) for p in line],
            [p.oversubscribed for p in line],
            colors[schedule],
            MARKERS[place],
        )
        labels.append((line[-1].threads, values[-1], schedule, colors[schedule]))
    _percent_ticks(ax.yaxis)
    _label(ax, labels)


def draw_original(ax: Any, study: Study, summary: Summary) -> None:
    """Speed-up of the original study at its four widths, and ours at the largest one."""
    line = [p for p in words.main_line(study, summary) if p.speedup is not None]
    counts = sorted({*original.THREADS, *(p.threads for p in line)})
    _thread_axis(ax, study, counts, shaded=False)
    ax.set_yscale("log", base=2)
    ax.set_ylabel("speed-up over one thread")
    _plain_ticks(ax.yaxis, _powers(counts[-1]))
    ax.plot([1, counts[-1]], [1, counts[-1]], "--", color=C["muted"], lw=1)
    labels: list[End] = [(counts[-1], float(counts[-1]), "ideal", C["muted"])]
    for place, width in enumerate(original.WIDTHS):
        color = shade("theirs", place, len(original.WIDTHS))
        column = original.column(width)
        values = [column[0] / t for t in column]
        last = width == original.WIDTHS[-1]
        _line(
            ax,
            original.THREADS,
            values,
            None,
            [False] * len(values),
            color,
            MARKERS[place],
            lw=1.8 if last else 1.0,
        )
        labels.append((original.THREADS[-1], values[-1], f"original {width}", color))
        if last:
            curve = _between(1, original.THREADS[-1])
            fit = words.original_fit(width)
            ax.plot(curve, [fit.speedup(n) for n in curve], ":", color=color, lw=1.4)
            labels.append(
                (curve[-1], fit.speedup(curve[-1]), f"fit s = {words.percent(fit.serial)}", color)
            )
    if line:
        values = [p.speedup or 1.0 for p in line]
        over = [p.oversubscribed for p in line]
        _line(ax, [p.threads for p in line], values, None, over, C["ours"], "o", lw=2.4)
        labels.append((line[-1].threads, values[-1], f"ours {line[-1].width}", C["ours"]))
    _label(ax, labels)


# ---- shared by the charts


def _line(
    ax: Any,
    x: Sequence[float],
    y: Sequence[float | None],
    spread: Sequence[tuple[float, float]] | None,
    hollow: Sequence[bool],
    color: str,
    marker: str,
    style: str = "-",
    lw: float = 1.6,
) -> None:
    """A line with markers, hollow where oversubscribed, and bars from least to greatest."""
    ax.plot(x, y, style, color=color, lw=lw)
    if spread is not None:
        ax.vlines(x, [low for low, _ in spread], [high for _, high in spread], color=color, lw=1)
    for u, v, empty in zip(x, y, hollow, strict=True):
        ax.plot(u, v, marker, ms=5, mec=color, mew=1.3, color=C["page"] if empty else color)


def _thread_axis(
    ax: Any, study: Study, counts: Sequence[int], shaded: bool = True, note: str = "top"
) -> None:
    """The axis of thread counts; what lies beyond the cores is shaded, and noted at this end."""
    ax.set_xscale("log", base=2)
    ax.set_xlabel("threads")
    _plain_ticks(ax.xaxis, counts)
    ax.set_xlim(counts[0] / 1.12, counts[-1] * 1.12)
    cores = study.plan.cores
    if shaded and counts[-1] > cores:
        edge = cores * 1.12
        ax.axvspan(edge, counts[-1] * 1.12, color=C["over"], lw=0, zorder=0)
        ax.text(
            0.985,
            0.985 if note == "top" else 0.02,
            "more threads\nthan cores",
            transform=ax.transAxes,
            color=C["muted"],
            fontsize=8,
            ha="right",
            va=note,
        )


def _ideal(ax: Any, study: Study, last: int) -> End:
    """Draws speed-up = threads up to the cores, level beyond, and returns its label."""
    cores = min(study.plan.cores, last)
    x, y = ([1, cores, last], [1, cores, cores]) if last > cores else ([1, last], [1, last])
    ax.plot(x, y, "--", color=C["muted"], lw=1)
    return x[-1], y[-1], "ideal", C["muted"]


def _between(first: int, last: int) -> list[float]:
    steps = 64
    return [first * (last / first) ** (k / steps) for k in range(steps + 1)]


def _powers(last: int) -> list[float]:
    return [2.0**k for k in range(-4, last.bit_length() + 1)]


def _plain_ticks(axis: Any, values: Sequence[float]) -> None:
    """Ticks at these values and no others, written out, thinned where they would collide."""
    axis.set_major_locator(_fixed(values))
    axis.set_minor_locator(_fixed([]))
    shown: list[float] = []
    for value in values:
        if not shown or value >= 1.24 * shown[-1]:
            shown.append(value)
    axis.set_major_formatter(lambda value, _: f"{value:g}" if value in shown else "")


def _percent_ticks(axis: Any) -> None:
    """Fractions as percentages, with the decimals that the ticks have and no more."""
    axis.set_major_formatter(lambda value, _: f"{round(100 * value, 6):g} %")


def _fixed(values: Sequence[float]) -> Any:
    from matplotlib.ticker import FixedLocator

    return FixedLocator(values)


def _label(ax: Any, labels: list[End]) -> None:
    """Names lines at their right end, moved apart where they would overlap."""
    ax.autoscale_view()
    to_axes = ax.transData + ax.transAxes.inverted()
    ends = sorted((*to_axes.transform((x, y)), text, color) for x, y, text, color in labels)
    ends.sort(key=lambda end: end[1])
    gap = min(0.066, 1.05 / len(ends))
    places = _apart([float(end[1]) for end in ends], gap)
    for (x, y, text, color), place in zip(ends, places, strict=True):
        ax.annotate(
            text,
            (x, y),
            (1.03, place),
            xycoords="axes fraction",
            textcoords="axes fraction",
            color=color,
            fontsize=8.5,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": color, "lw": 0.6, "alpha": 0.5, "shrinkB": 4},
        )


def _apart(wanted: Sequence[float], gap: float) -> list[float]:
    """Rising places at least a gap apart, as near as can be to the rising ones wanted.

    Least squares: with the gaps taken off, neighbours in the wrong order are pooled at their mean.
    """
    blocks: list[tuple[float, int]] = []
    for k, place in enumerate(wanted):
        mean, many = place - k * gap, 1
        while blocks and blocks[-1][0] > mean:
            before, count = blocks.pop()
            mean, many = (before * count + mean * many) / (count + many), count + many
        blocks.append((mean, many))
    highest = 1.02 - (len(wanted) - 1) * gap
    level = [min(mean, highest) for mean, many in blocks for _ in range(many)]
    return [mean + k * gap for k, mean in enumerate(level)]


# ---- files


def png(study: Study, summary: Summary) -> bytes:
    """The charts on one sheet of two columns, as the bytes of a PNG."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = charts(study, summary)
    if len(drawn) % 2:  # the one that says least without the report's words
        drawn = [chart for chart in drawn if chart.name != "share"]
    rows = -(-len(drawn) // 2)
    with rc_context(_STYLE):
        figure = Figure(figsize=(12.4, 4.3 * rows + 0.7), layout="constrained", dpi=150)
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, 2, squeeze=False).flat
        for chart, ax in zip(drawn, axes, strict=False):
            ax.set_title(chart.title, loc="left", pad=22 if chart.name == "share" else 8)
            chart.draw(ax)
        for ax in list(figure.axes)[len(drawn) :]:
            ax.axis("off")
        plan, machine = study.plan, study.machine
        figure.suptitle(
            f"{study.scene_name}, {plan.spp} spp, depth {plan.max_depth}, tree {plan.tree}, "
            f"{plan.sampler} sampler, {plan.schedules[0]} schedule; {machine['cpu']}, "
            f"{words.count(plan.cores, 'core')}" + ("" if study.complete else "; stopped early"),
            x=0.01,
            ha="left",
            fontsize=10,
            color=C["muted"],
        )
        out = io.BytesIO()
        figure.savefig(out, format="png")
    return out.getvalue()


def svg(chart: Chart) -> str:
    """One chart as an <svg> element for HTML, its colours as the variables of `css`."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context({**_STYLE, "svg.fonttype": "none", "svg.hashsalt": chart.name}):
        figure = Figure(figsize=(5.4, 3.7), layout="constrained")
        FigureCanvasSVG(figure)
        chart.draw(figure.subplots())
        out = io.StringIO()
        figure.savefig(out, format="svg", transparent=True, metadata={"Date": None})
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Several charts share one page: names must differ between them.
    text = re.sub(r'(id="|url\(#|href="#)', rf"\g<1>{chart.name}-", text)
    text = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", text)
    for name, color in C.items():
        text = text.replace(color, f"var(--{name})")
    return text


def css(dark: bool) -> str:
    """The declarations of all colour variables."""
    return " ".join(f"--{name}: {color};" for name, color in palette(dark).items())


_STYLE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.edgecolor": C["muted"],
    "axes.labelcolor": C["ink"],
    "axes.titlesize": 12,
    "axes.titleweight": "bold",
    "axes.titlecolor": C["ink"],
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": C["grid"],
    "grid.linewidth": 0.8,
    "xtick.color": C["muted"],
    "ytick.color": C["muted"],
    "text.color": C["ink"],
    "figure.facecolor": C["page"],
}
