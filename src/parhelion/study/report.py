"""The report: one HTML page that needs no network and no other file."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from . import charts, original, words
from .words import percent, seconds

if TYPE_CHECKING:
    from .charts import Chart
    from .measure import Picture, Study
    from .summary import Point, Summary


def html(study: Study, summary: Summary) -> str:
    """The whole page."""
    drawn = {chart.name: chart for chart in charts.charts(study, summary)}
    title = f"Thread-scaling study: {study.scene_name}"
    body = "\n".join(
        [
            f"<header><p class='kicker'>parhelion study</p><h1>{escape(title)}</h1>",
            f"<p class='lead'>{escape(words.headline(study, summary))}</p></header>",
            _alarms(study),
            _scaling(study, summary, drawn),
            _table(study, summary),
            _fits(summary),
            _share(drawn["share"]),
            _schedules(study, drawn),
            _pair(study),
            _beside(study, summary, drawn["original"]),
            _how(study),
        ]
    )
    # Seconds and percent signs stay on the line of their number.
    body = re.sub(r"(?<=\d) (?=%|s\b)", "&nbsp;", body)
    return (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        "<meta name='color-scheme' content='light dark'>"
        f"<title>{escape(title)}</title><style>{_css()}</style></head>\n"
        f"<body><main>\n{body}\n</main></body></html>\n"
    )


def _alarms(study: Study) -> str:
    parts = []
    for width in study.mismatches:
        groups = "; ".join(
            f"{digest[:12]}: " + ", ".join(sorted({f"{r.threads} {r.schedule}" for r in runs}))
            for digest, runs in study.hashes(width).items()
        )
        parts.append(
            f"<p class='alarm' role='alert'><strong>Error: the pictures of {width} px differ."
            "</strong> Every thread count and schedule must give the same picture to the last bit. "
            f"SHA-256 of the pixels, with the threads and schedules that gave it: {escape(groups)}."
            " Please report this with study.json.</p>"
        )
    if not study.complete:
        parts.append(
            f"<p class='alarm'><strong>Stopped early</strong> after "
            f"{words.count(len(study.runs), 'run')}. What follows was measured before that.</p>"
        )
    return "\n".join(parts)


def _scaling(study: Study, summary: Summary, drawn: dict[str, Chart]) -> str:
    over = (
        " In the shaded part there are more threads than cores; those points are hollow."
        if any(study.plan.oversubscribed(n) for n in study.plan.threads)
        else ""
    )
    notes = "".join(f"<li>{escape(note)}</li>" for note in words.notes(study, summary))
    before = f"<h3>Before you trust these numbers</h3><ul>{notes}</ul>" if notes else ""
    return f"""<section aria-labelledby='scaling'><h2 id='scaling'>How it scales</h2>
<div class='pair'>
{_figure(drawn["speedup"], _SPEEDUP + over)}
{_figure(drawn["efficiency"], _EFFICIENCY)}
</div>
{_figure(drawn["time"], _TIME)}
{before}</section>"""


def _table(study: Study, summary: Summary) -> str:
    several = len(study.plan.schedules) > 1
    head = (
        ["Threads"]
        + (["Schedule"] if several else [])
        + ["Median", "Least to greatest", "Quartiles", "Samples/s"]
        + ["Speed-up", "Efficiency", "Karp-Flatt", "Cores busy"]
    )
    parts = []
    for width in summary.widths:
        points = sorted(
            (p for p in summary.points if p.width == width),
            key=lambda p: (p.threads, study.plan.schedules.index(p.schedule)),
        )
        rows = "".join(
            _row(
                [_threads(p), *([p.schedule] if several else []), *_cells(p)], over=p.oversubscribed
            )
            for p in points
        )
        runs = min(p.runs for p in points), max(p.runs for p in points)
        each = words.count(runs[0], "run") if runs[0] == runs[1] else f"{runs[0]} to {runs[1]} runs"
        caption = f"{width} x {study.plan.height(width)} px, {each} each"
        parts.append(_grid(caption, head, rows))
    return f"""<section aria-labelledby='numbers'><h2 id='numbers'>The numbers</h2>
<dl class='terms'>
<div><dt>Speed-up S(n)</dt><dd>T(1) / T(n), from the medians.</dd></div>
<div><dt>Efficiency</dt><dd>S(n) / n.</dd></div>
<div><dt>Karp-Flatt</dt><dd>(1/S - 1/n) / (1 - 1/n): the serial fraction that would explain this one
speed-up. Level over n: a fixed serial part. Rising: a cost that grows with the threads.</dd></div>
<div><dt>Cores busy</dt><dd>processor seconds per second.</dd></div>
</dl>
{"".join(parts)}</section>"""


def _cells(point: Point) -> list[str]:
    return [
        seconds(point.median),
        f"{words.digits(point.least)} to {seconds(point.greatest)}",
        f"{words.digits(point.q1)} to {seconds(point.q3)}",
        f"{words.digits(point.samples_per_second / 1e6)} M",
        "" if point.speedup is None else f"{point.speedup:.2f}",
        "" if point.efficiency is None else percent(point.efficiency),
        "" if point.karp_flatt is None else percent(point.karp_flatt),
        f"{point.busy:.2f}",
    ]


def _fits(summary: Summary) -> str:
    head = ["Width", "Schedule", "Serial fraction s", "Limit 1/s", "Fitted T(1)"]
    head += ["Residual", "Thread counts fitted"]
    rows = ""
    for (width, schedule), fit in summary.fits.items():
        if fit is None:
            cells = [f"{width} px", schedule, "no fit possible", "", "", "", "fewer than two"]
        else:
            cells = [
                f"{width} px",
                schedule,
                percent(fit.serial),
                f"{fit.limit:.1f}" if fit.serial > 0 else "none",
                seconds(fit.t1),
                "0 by construction"
                if fit.exact
                else f"{seconds(fit.residual)} ({percent(fit.residual / fit.t1)})",
                ", ".join(map(str, fit.threads)),
            ]
        rows += _row(cells)
    return f"""<section aria-labelledby='amdahl'><h2 id='amdahl'>Amdahl's law</h2>
<p>T(n) = T(1) (s + (1 - s) / n), fitted by least squares to the medians of the thread counts that
have a core each, with s held between 0 and 1. The residual is the root mean square difference of
measured and fitted seconds, and in brackets its share of T(1). A small s is an extrapolation: it
holds for the counts measured and promises nothing about ten times as many.</p>
{_grid("Fitted serial fractions", head, rows)}</section>"""


def _share(chart: Chart) -> str:
    return f"""<section aria-labelledby='share'><h2 id='share'>Where the threads' time went</h2>
<p>Threads times seconds is the time the program had. Processor time that one thread needs as well
is useful work. Processor time beyond that comes from cores that share a cache, a clock limit or an
arithmetic unit, and from threads that wait awake at the end. The rest is
waiting: for work, or for a core.</p>
{_figure(chart, _SHARE, heading=False)}
</section>"""


def _schedules(study: Study, drawn: dict[str, Chart]) -> str:
    if "schedules" not in drawn:
        return ""
    caption = (
        f"Time relative to {study.plan.schedules[0]} with as many threads; lower is faster. Bars "
        "reach from the fastest to the slowest run: where they overlap, the schedules do not "
        "differ as far as this study can tell."
    )
    return f"""<section aria-labelledby='schedules'><h2 id='schedules'>OpenMP schedules</h2>
<p><b>static</b> divides the tiles between the threads before the start, <b>dynamic</b> hands out
the next tile to whoever is free, <b>guided</b> hands out large batches first and small ones at the
end. With one thread they must take the same time: what differs there is noise.</p>
{_figure(drawn["schedules"], caption, heading=False)}
</section>"""


def _pair(study: Study) -> str:
    if study.pair is None:
        return ""
    low, high = study.pair
    rms = (
        ""
        if study.pair_rms is None
        else f" The root mean square difference of the two is {percent(study.pair_rms)} of the "
        "mean radiance, almost all of it the noise of the first."
    )
    return f"""<section aria-labelledby='noise'><h2 id='noise'>What samples buy</h2>
<p>Threads change the time and nothing else; samples per pixel change the picture. With independent
random numbers the noise falls with the square root of their number: {high.spp / low.spp:.3g} times
the samples for {(high.spp / low.spp) ** 0.5:.3g} times less noise. A Sobol' sampler does better
where the picture is smooth.{rms}</p>
<div class='pair'>{_picture(low)}{_picture(high)}</div></section>"""


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode()
    text = f"{picture.spp} samples per pixel, {seconds(picture.seconds)}"
    return (
        f"<figure><img width='{picture.width}' height='{picture.height}' "
        f"alt='The scene rendered with {picture.spp} samples per pixel' "
        f"src='data:image/png;base64,{data}'><figcaption>{text}</figcaption></figure>"
    )


def _beside(study: Study, summary: Summary, chart: Chart) -> str:
    schedule = study.plan.schedules[0]
    shared = [w for w in original.WIDTHS if w in summary.widths]
    head = ["Threads", *(f"{w} px" for w in original.WIDTHS)]
    head += [f"ours {w} px" for w in shared]
    rows = ""
    for threads in sorted({*original.THREADS, *study.plan.threads}):
        # A published count says nothing of our cores unless we ran it too.
        over = threads in study.plan.threads and study.plan.oversubscribed(threads) and shared
        if threads == 1:
            cells = ["serial (ours: 1 thread)" if shared else "serial"]
        else:
            cells = [f"{threads} (ours over)" if over else str(threads)]
        for width in original.WIDTHS:
            theirs = original.seconds(threads, width)
            base = original.column(width)[0]
            cells.append("" if theirs is None else f"{theirs:.2f} ({base / theirs:.2f})")
        for width in shared:
            point = summary.point(width, schedule, threads)
            cells.append("" if point is None else _both(point))
        rows += _row(cells)
    differing = words.settings_that_differ(study)
    unlike = (
        f" The published figures were measured with {words.listed(differing)}." if differing else ""
    )
    fits = _row(
        ["Amdahl s"]
        + [percent(words.original_fit(w).serial) for w in original.WIDTHS]
        + [
            "no fit" if (fit := summary.fits.get((w, schedule))) is None else percent(fit.serial)
            for w in shared
        ]
    )
    explained = "".join(
        f"<li><span class='tag {kind}'>{kind}</span> {escape(text)}</li>"
        for kind, text in [
            *words.original_facts(),
            *words.our_facts(study, summary),
            *words.causes(study),
        ]
    )
    return f"""<section aria-labelledby='beside'><h2 id='beside'>Beside the original study</h2>
<p>This command grew out of a study in which a sphere path tracer was written as a serial program,
parallelised with OpenMP and timed. Its figures: seconds at {original.SPP} samples per pixel, depth
{original.MAX_DEPTH}, {original.ASPECT}. Its speed-up is measured against the serial program, so
what OpenMP itself costs counts against it; ours is measured against one thread. Seconds compare two
programs on two machines and two scenes, so compare the speed-ups.{escape(unlike)}</p>
{_figure(chart, _ORIGINAL, heading=False)}
{_grid("Seconds, and speed-up in brackets", head, rows + fits)}
<h3>Why they scale differently</h3>
<p>Each statement says what it rests on: <span class='tag measured'>measured</span> in one of the
two studies, <span class='tag known'>known</span> from how the programs are built, or
<span class='tag hypothesis'>hypothesis</span>, plausible and not tested here.</p>
<ul class='explained'>{explained}</ul></section>"""


def _how(study: Study) -> str:
    plan, machine = study.plan, study.machine
    physical = machine.get("physical_cores_available")
    loads = [machine.get("load_average_before"), machine.get("load_average_after")]
    packages = machine["packages"].items()
    openmp = machine["openmp_environment"].items()
    facts: list[tuple[str, object]] = [
        ("Processor", machine["cpu"]),
        (
            "Cores",
            f"{plan.cores} available to this process"
            + (f" ({physical} physical)" if physical is not None else "")
            + f", {machine['hardware_threads']} in the machine",
        ),
        ("Instruction set", machine.get("instruction_set", "not known")),
        ("System", f"{machine['os']}, {machine['architecture']}"),
        (
            "Software",
            ", ".join([f"Python {machine['python']}", *(f"{k} {v}" for k, v in packages)]),
        ),
        ("OpenMP variables", ", ".join(f"{k}={v}" for k, v in openmp) or "none set"),
        (
            "Load average",
            " before, ".join("?" if x is None else f"{x:.2f}" for x in loads) + " after",
        ),
        (
            "Order",
            f"one untimed warm-up, then {words.count(plan.repeat, 'round')} over all combinations, "
            "so that a drift of the machine meets all thread counts alike",
        ),
        ("Timed", "rendering only: reading the scene, building the tree and writing are left out"),
        ("Filter, roulette", "box filter, no Russian roulette, as the classic program"),
    ]
    hashes = "".join(
        f"<dt>{width} px</dt><dd><code>{'</code> <code>'.join(found)}</code></dd>"
        for width in plan.widths
        if (found := study.hashes(width))
    )
    return f"""<section aria-labelledby='how'><h2 id='how'>How this was measured</h2>
<p>The same study again:</p><pre><code>{escape(plan.command())}</code></pre>
<dl class='facts'>{"".join(f"<dt>{escape(k)}</dt><dd>{escape(str(v))}</dd>" for k, v in facts)}</dl>
<h3>SHA-256 of the pictures</h3>
<p>Of the linear float32 pixels, row by row; one for each width if all runs agree.</p>
<dl class='facts'>{hashes}</dl>
<p>All runs are in <code>study.csv</code>; <code>study.json</code> holds everything on this
page.</p></section>"""


# ---- captions

_SPEEDUP = """Speed-up: time on one thread over time on n threads. The dashed line is what n cores
can give at best, the dotted lines are Amdahl's law with the serial fraction s fitted to each width.
Vertical bars reach from the fastest to the slowest run."""

_EFFICIENCY = """Efficiency: speed-up over the number of threads. 100 % means that no thread ever
waited and none slowed another one down."""

_TIME = """Time against resolution, both axes logarithmic. A picture twice as wide has four times
the pixels: where the lines are straight and climb two decades for one decade of width, time is
proportional to pixels. Where they flatten to the left, starting the threads costs more than the
picture. Dashed and marked "over": more threads than cores."""

_SHARE = """Orange points to the hardware; grey points to the division of work, to locks, or to a
machine that others use too."""

_ORIGINAL = f"""Orange: the original's speed-up at its four widths, and, dotted, Amdahl's law fitted
to its 960 px column up to {original.BEST_THREADS} threads, the count it found best. Blue: ours at
the largest width measured, hollow where there are more threads than cores."""


# ---- pieces


def _figure(chart: Chart, caption: str, heading: bool = True) -> str:
    title = f"<h3>{escape(chart.title)}</h3>" if heading else ""
    svg = charts.svg(chart).replace(
        "<svg ", f'<svg role="img" aria-label="{escape(chart.alt)}" ', 1
    )
    return f"<figure>{title}{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def _grid(caption: str, head: Sequence[str], rows: str) -> str:
    columns = "".join(f"<th scope='col'>{escape(name)}</th>" for name in head)
    return (
        f"<div class='scroll' tabindex='0' role='region' aria-label='{escape(caption)}'>"
        f"<table><caption>{escape(caption)}</caption>"
        f"<thead><tr>{columns}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _row(cells: Iterable[str], over: bool = False) -> str:
    first, *rest = cells
    data = "".join(f"<td>{escape(cell)}</td>" for cell in rest)
    mark = " class='over'" if over else ""
    return f"<tr{mark}><th scope='row'>{escape(first)}</th>{data}</tr>"


def _threads(point: Point) -> str:
    return f"{point.threads} (oversubscribed)" if point.oversubscribed else str(point.threads)


def _both(point: Point) -> str:
    return words.digits(point.median) + ("" if point.speedup is None else f" ({point.speedup:.2f})")


def _css() -> str:
    return f""":root {{ {charts.css(dark=False)} }}
@media (prefers-color-scheme: dark) {{ :root {{ {charts.css(dark=True)} }} }}
{_CSS}"""


_CSS = """
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 68rem; margin: 0 auto; padding: 1.5rem 1.1rem 4rem; }
h1 { font-size: clamp(1.5rem, 4vw, 2.1rem); line-height: 1.2; margin: 0 0 .6rem; }
h2 { font-size: 1.3rem; margin: 0 0 .5rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; }
section { margin-top: 2.2rem; padding-top: 1.4rem; border-top: 1px solid var(--grid); }
p, ul, .terms { max-width: 46rem; }
.kicker { margin: 0; color: var(--muted); font-size: .85rem; letter-spacing: .04em; }
.lead { font-size: 1.12rem; }
.alarm { border-left: 4px solid var(--theirs); padding: .6rem .9rem; background: var(--over); }
.pair { display: grid; gap: 1.4rem;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 22rem), 1fr)); }
figure { margin: .6rem 0; max-width: 38rem; }
figure h3 { margin-top: 0; }
figure svg, figure img { display: block; width: 100%; height: auto; }
svg text { font-family: inherit; }
figcaption { color: var(--muted); font-size: .87rem; margin-top: .4rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; }
th, td { padding: .28rem .5rem; text-align: right; vertical-align: baseline;
  border-bottom: 1px solid var(--grid); }
thead th { color: var(--muted); font-weight: 500; }
th:first-child { text-align: left; position: sticky; left: 0; background: var(--page); }
tr.over td, tr.over th { color: var(--muted); background: var(--over); }
dl { margin: .6rem 0; }
.terms div { margin: .2rem 0; }
.terms dt { display: inline; font-weight: 600; }
.terms dd { display: inline; margin: 0 0 0 .3rem; }
.facts { display: grid; grid-template-columns: minmax(7rem, max-content) 1fr; gap: .25rem 1rem; }
.facts dt { color: var(--muted); } .facts dd { margin: 0; overflow-wrap: anywhere; }
pre { overflow-x: auto; padding: .7rem .9rem; background: var(--over); font-size: .85rem; }
.explained { list-style: none; padding: 0; } .explained li { margin: .7rem 0; }
.tag { display: inline-block; padding: 0 .5em; border: 1px solid currentColor; border-radius: 1em;
  font-size: .75rem; }
.measured { color: var(--ours); } .known { color: var(--third); }
.hypothesis { color: var(--theirs); border-style: dashed; }
@media (max-width: 70rem) { table { font-size: .8rem; } th, td { padding: .28rem .3rem; } }
@media print { section { break-inside: avoid; } .scroll { overflow: visible; } }
"""
