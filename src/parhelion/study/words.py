"""Sentences about a study, written from its numbers. All are plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from . import amdahl, original

if TYPE_CHECKING:
    from .measure import Study
    from .summary import Point, Summary

SHORT = 0.05
"""Seconds below which starting threads and the clock's own noise show in a timing."""


class Statement(NamedTuple):
    """One sentence or more, and how far to trust it."""

    kind: Literal["measured", "known", "hypothesis"]
    text: str


def seconds(value: float) -> str:
    """A time with three figures: 711 s, 9.75 s, 0.0123 s."""
    return f"{digits(value)} s"


def digits(value: float) -> str:
    """Three significant figures without an exponent: 1,234 12.3 0.0123."""
    if value == 0 or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:#.3g}" if abs(value) >= 1e-4 else f"{value:.1e}"


def percent(fraction: float) -> str:
    """A fraction as a percentage with at most one decimal."""
    return f"{100 * fraction:.1f} %" if abs(fraction) < 0.1 else f"{100 * fraction:.0f} %"


def times(factor: float) -> str:
    """A ratio: 3.94 times."""
    return f"{factor:.2f} times"


def count(number: int, noun: str) -> str:
    """1 core, 2 cores."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def listed(items: list[str]) -> str:
    """a, b and c."""
    return items[0] if len(items) == 1 else ", ".join(items[:-1]) + " and " + items[-1]


def main_line(study: Study, summary: Summary) -> list[Point]:
    """The points a reader looks at first: the largest width measured, the first schedule."""
    for width in reversed(summary.widths):
        if line := summary.of(width, study.plan.schedules[0]):
            return line
    return []


def idlest(points: list[Point]) -> Point | None:
    """The point with the fewest cores at work for its threads, if more than a fifth were not."""
    idle = [p for p in points if p.busy < 0.8 * p.threads]
    return min(idle, key=lambda p: p.busy / p.threads, default=None)


def headline(study: Study, summary: Summary) -> str:
    """The outcome in two sentences."""
    line = main_line(study, summary)
    if not line:
        return "Nothing was measured. The study was stopped before its first run ended."
    plan = study.plan
    within = [p for p in line if not p.oversubscribed] or line
    best = min(within, key=lambda p: p.median)
    quickest = min(line, key=lambda p: p.median)
    size = f"{best.width} x {best.height} px, {count(plan.spp, 'sample')} per pixel"
    if len(plan.schedules) > 1:
        size += f", {best.schedule} schedule"
    first = (
        f"With {count(best.threads, 'thread')} on {count(plan.cores, 'available core')}, "
        f"{study.scene_name} ({size}) took {seconds(best.median)}"
    )
    if best.threads > 1 and best.speedup and best.efficiency:
        first += (
            f", {times(best.speedup)} as fast as one thread, "
            f"an efficiency of {percent(best.efficiency)}"
        )
    if quickest is not best:
        first += (
            f"; {quickest.threads} threads, more than there are cores, took "
            f"{percent(1 - quickest.median / best.median)} less"
        )
    elif len(line) > 1:
        first += "; no other number of threads was faster"
    fitted = summary.fits.get((best.width, best.schedule))
    if fitted is None:
        law = "Amdahl's law could not be fitted, as that needs two thread counts within the cores"
    else:
        law = f"Amdahl's law fits with a serial fraction of {percent(fitted.serial)}"
        if fitted.exact:
            law += " (from two thread counts only)"
        worst = idlest(within)
        if worst is not None:
            law += (
                f", which says little as only {worst.busy:.1f} cores were at work "
                f"with {count(worst.threads, 'thread')}"
            )
    if study.mismatches:
        same = "but THE PICTURES ARE NOT ALL THE SAME, which is an error"
    elif len({(p.threads, p.schedule) for p in summary.points}) > 1:
        same = f"and all {len(study.runs)} runs gave the same picture of each size, to the last bit"
    else:
        same = f"and {count(len(study.runs), 'run')} gave one and the same picture of each size"
    return f"{first}. {law}, {same}."


def notes(study: Study, summary: Summary) -> list[str]:
    """What a careful reader has to know before believing the numbers."""
    plan, found = study.plan, []
    cores = study.machine.get("physical_cores_available")
    over = [n for n in plan.threads if plan.oversubscribed(n)]
    if over:
        found.append(
            f"Oversubscribed: {listed([str(n) for n in over])} threads share "
            f"{count(plan.cores, 'core')}. These counts show what too many threads cost, not how "
            "the program scales, and no fit uses them."
        )
    if isinstance(cores, int) and cores < plan.cores:
        found.append(
            f"The {plan.cores} cores counted are hardware threads of "
            f"{count(cores, 'physical core')}. Beyond {count(cores, 'thread')} two of them share "
            "one core's arithmetic units, so the curve bends there with any program."
        )
    load = study.machine.get("load_average_before")
    if isinstance(load, float) and load > 0.3 * plan.cores:
        found.append(
            f"In the minute before the study, {load:.1f} programs on average wanted a core. If "
            "they still ran, the timings share the machine with them: look at the spread."
        )
    worst = idlest([p for p in summary.points if not p.oversubscribed])
    if worst is not None:
        found.append(
            f"With {count(worst.threads, 'thread')} at {worst.width} px only {worst.busy:.1f} "
            "cores were at work on average: threads waited for work, or other programs took the "
            "cores. In the second case these figures describe the busy machine and not the "
            "program: measure again on an idle one."
        )
    short = sorted({p.width for p in summary.points if p.median < SHORT})
    if short:
        found.append(
            f"Some runs at {listed([f'{w} px' for w in short])} took less than {SHORT} s, where "
            "starting the threads shows. A larger --spp makes them comparable."
        )
    coarse = [w for w in summary.widths if plan.tiles(w) < 4 * max(plan.threads)]
    if coarse:
        width = coarse[-1]
        found.append(
            f"At {width} px there are {count(plan.tiles(width), 'tile')} for up to "
            f"{count(max(plan.threads), 'thread')}, so whole tiles can not be shared out evenly. "
            "A smaller --tile divides the work more finely."
        )
    if plan.repeat == 1:
        found.append(
            "Each combination was run once, so there is no spread: use --repeat 3 or more."
        )
    if any(fit is not None and fit.exact for fit in summary.fits.values()):
        found.append(
            "With two thread counts within the cores, Amdahl's law, which has two unknowns, goes "
            "through both exactly. Its residual is zero by construction and confirms nothing."
        )
    if any(fit is None for fit in summary.fits.values()):
        found.append(
            "No fit is possible with a single thread count within the available cores: one time "
            "does not determine the two unknowns of Amdahl's law."
        )
    return found


def settings_that_differ(study: Study) -> list[str]:
    """What the published figures were measured with and this study was not."""
    plan = study.plan
    theirs = (
        (plan.aspect == original.ASPECT, f"aspect {original.ASPECT}", plan.aspect),
        (plan.spp == original.SPP, f"{original.SPP} samples per pixel", str(plan.spp)),
        (plan.max_depth == original.MAX_DEPTH, f"depth {original.MAX_DEPTH}", str(plan.max_depth)),
    )
    return [f"{what} (here {ours})" for same, what, ours in theirs if not same]


def original_facts() -> list[Statement]:
    """What the published figures say by themselves."""
    width = original.WIDTHS[-1]
    column = dict(zip(original.THREADS, original.column(width), strict=True))
    fitted = original_fit(width)
    best, last = original.BEST_THREADS, original.THREADS[-1]
    metric = [
        karp
        for n in original.THREADS
        if 4 <= n <= 12 and (karp := amdahl.karp_flatt(column[1] / column[n], n)) is not None
    ]
    slower = [
        w
        for w in original.WIDTHS
        if (original.seconds(last, w) or 0) > (original.seconds(best, w) or 0)
    ]
    return [
        Statement(
            "measured",
            f"Original, {width} px: 2 threads were {times(column[1] / column[2])} as fast as the "
            f"serial program, {best} threads {times(column[1] / column[best])}. That is an "
            f"efficiency of {percent(column[1] / column[best] / best)}: three of four "
            "thread-seconds were spent on something else than the picture.",
        ),
        Statement(
            "measured",
            f"Original, {width} px: Amdahl's law fitted to 1 to {best} threads gives a serial "
            f"fraction of {percent(fitted.serial)}, so at best {times(fitted.limit)} with any "
            f"number of threads. The Karp-Flatt metric stays between {percent(min(metric))} and "
            f"{percent(max(metric))} from 4 to 12 threads: the loss behaves like a part of the "
            "work that only one thread at a time can do.",
        ),
        Statement(
            "measured",
            f"Original: from 8 to 12 threads it gained {percent(1 - column[12] / column[8])} at "
            f"{width} px, and {last} threads were slower than {best} at {len(slower)} of "
            f"{len(original.WIDTHS)} widths. Amdahl's law never predicts a slow-down, so "
            "something costs more with each thread.",
        ),
    ]


def original_fit(width: int) -> amdahl.Amdahl:
    """Amdahl's law fitted to the published seconds of one width, up to the count found best."""
    used = [n for n in original.THREADS if n <= original.BEST_THREADS]
    fitted = amdahl.fit(used, original.column(width)[: len(used)])
    assert fitted is not None  # the published table has more than two counts
    return fitted


def our_facts(study: Study, summary: Summary) -> list[Statement]:
    """What this study measured, beside the original where the two can be compared."""
    line = [p for p in main_line(study, summary) if p.speedup is not None]
    scaled = [p for p in line if p.threads > 1 and not p.oversubscribed]
    found = []
    if scaled:
        top = scaled[-1]
        assert top.speedup is not None
        assert top.efficiency is not None
        text = (
            f"Ours, {top.width} px: {count(top.threads, 'thread')} were {times(top.speedup)} as "
            f"fast as one, an efficiency of {percent(top.efficiency)}."
        )
        theirs = original.seconds(top.threads, original.WIDTHS[-1])
        if theirs is not None:
            published = original.column(original.WIDTHS[-1])[0] / theirs
            gap = top.speedup - published
            verdict = (
                "more than" if gap > 0.05 else "less than" if gap < -0.05 else "much the same as"
            )
            text += (
                f" That is {verdict} the {times(published)} the original reached with as many "
                f"threads at {original.WIDTHS[-1]} px."
            )
        if idlest([top]) is not None:
            text += (
                f" But only {top.busy:.1f} cores were at work on average; if others used the "
                "machine, this is not the program's own scaling."
            )
        found.append(Statement("measured", text))
        if top.useful is not None and top.extra is not None and top.waiting is not None:
            found.append(
                Statement(
                    "measured",
                    f"Ours, {top.width} px, {count(top.threads, 'thread')}: of the threads' time, "
                    f"{percent(top.useful)} went into work that one thread does as well, "
                    f"{percent(top.extra)} was processor time on top of that (shared caches, "
                    "lower clock, shared arithmetic units, waiting awake at the end) and "
                    f"{percent(top.waiting)} was waiting for work or for a core.",
                )
            )
    else:
        found.append(
            Statement(
                "measured",
                "Ours: no count above one thread was measured within the available cores, so this "
                "run says nothing about how the program scales.",
            )
        )
    over = [p for p in line if p.oversubscribed]
    within = [p for p in line if not p.oversubscribed]
    if over and within:
        best, worst = min(within, key=lambda p: p.median), max(over, key=lambda p: p.median)
        change = worst.median / best.median - 1
        if change > 0.02:
            outcome = f"{percent(change)} slower than"
        else:
            outcome = "no slower than" if change > -0.02 else f"{percent(-change)} faster than"
        text = (
            f"Ours, oversubscribed: the slowest such count, {worst.threads} threads on "
            f"{count(study.plan.cores, 'core')}, was {outcome} {best.threads}."
        )
        if change < -0.02 and best.schedule == "static":
            text += (
                " With a static division more threads get smaller shares, which evens out the work "
                "between the cores."
            )
        found.append(Statement("measured", text))
    found += _schedule_facts(study, summary)
    if not study.mismatches and line:
        rays = {run.rays for run in study.runs if run.width == line[0].width}
        found.append(
            Statement(
                "measured",
                "Ours: the picture is the same to the last bit for every thread count"
                + (" and schedule" if len(study.plan.schedules) > 1 else "")
                + (", and so is the number of rays" if len(rays) == 1 else "")
                + ". More threads do exactly the same work, only at the same time.",
            )
        )
    return found


def _schedule_facts(study: Study, summary: Summary) -> list[Statement]:
    first, *others = study.plan.schedules
    line = [p for p in main_line(study, summary) if not p.oversubscribed and p.threads > 1]
    if not line or not others:
        return []
    base = line[-1]
    parts = []
    for name in others:
        point = summary.point(base.width, name, base.threads)
        if point is None:
            continue
        ratio = point.median / base.median
        clear = point.least > base.greatest or point.greatest < base.least
        parts.append(
            f"{name} took {times(ratio)} as long as {first}"
            + ("" if clear else ", a difference within the spread of the runs")
        )
    if not parts:
        return []
    where = f"with {count(base.threads, 'thread')} at {base.width} px"
    return [Statement("measured", f"Ours, schedules, {where}: {listed(parts)}.")]


def causes(study: Study) -> list[Statement]:
    """Why the two scale differently: first what is known, then what can only be supposed."""
    plan = study.plan
    tree = (
        "a bounding-volume hierarchy, so a ray meets a few dozen boxes and spheres"
        if plan.tree == "bvh"
        else "no tree either (--tree none)"
    )
    hand_out = {
        "dynamic": "a thread takes the next one when it is done, so none waits for another's hard "
        "part of the picture until the last tiles",
        "static": "each thread gets its share before the start (--schedule static), so the one "
        "with the hardest part of the picture decides the time",
        "guided": "threads take large batches of them first and ever smaller ones towards the end",
    }[plan.schedules[0]]
    return [
        Statement(
            "known",
            "The cost of a pixel varies: a path that meets the sky at once is one ray, a path "
            "between glass spheres may be dozens. Any division of the picture in equal areas is "
            "an unequal division of the work.",
        ),
        Statement(
            "known",
            f"Ours is one parallel loop over tiles of {plan.tile} x {plan.tile} pixels; "
            f"{hand_out}. All threads wait for each other once, at its end.",
        ),
        Statement(
            "known",
            "Ours writes nothing that two threads share: a pixel belongs to one thread, and each "
            "random number is computed from (pixel, sample, dimension, seed) instead of being "
            "drawn from a state that all threads advance.",
        ),
        Statement(
            "known",
            f"The original tests each ray against every sphere. Ours, in this run, uses {tree}.",
        ),
        Statement(
            "hypothesis",
            "Shared random numbers: the C library's rand() keeps one state for the whole program, "
            "in common libraries behind a lock. If the original called it for every sample and "
            "bounce, its threads queued for that lock and passed its memory from core to core. "
            "That looks just like the fixed serial fraction fitted above.",
        ),
        Statement(
            "hypothesis",
            "Static division: if each thread was given a block of rows at the start, the thread "
            "with the most glass and the least sky ended last and all others waited for it. The "
            "curve this gives can look much like the first one, so the fit alone can not tell "
            "them apart.",
        ),
        Statement(
            "hypothesis",
            "Memory: reference counts of shared objects that all threads change at every hit, "
            "small allocations, or neighbouring pixels in one cache line. Each makes a core wait "
            "for data that another core has just written, the more cores the more often.",
        ),
        Statement(
            "hypothesis",
            "The machine: its core count was not published. Little gain from 8 to 12 threads and "
            "a slow-down at 32 would fit a machine of 8 cores with 16 hardware threads; then "
            "some of the published counts were oversubscribed, and no program could have scaled "
            "there.",
        ),
    ]
