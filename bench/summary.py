"""Numbers from repeated runs: medians, spreads, ratios of pairs, and the table of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any


@dataclass(frozen=True)
class Row:
    """One measured quantity.

    runs: its values in unit, in the order measured; less is better unless more is set.
    against, ratios: what it was paired with, and value over value of the pairs (see ratios()).
    most: what the value shall be at most. least_ratio, most_ratio: what the ratio shall be at
    least, or at most.
    error: of a picture, which is reached in these seconds.
    """

    group: str
    name: str
    unit: str
    runs: Sequence[float]
    more: bool = False
    against: str | None = None
    ratios: Sequence[float] = ()
    most: float | None = None
    least_ratio: float | None = None
    most_ratio: float | None = None
    error: float | None = None

    def json(self) -> dict[str, Any]:
        """Plain values, the summaries among them."""
        row = asdict(self) | spread(self.runs)
        if self.ratios:
            row["ratio"] = spread(self.ratios)
        return row


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, least and greatest."""
    return {"median": median(values), "min": min(values), "max": max(values)}


def ratios(values: Sequence[float], base: Sequence[float]) -> list[float]:
    """Value over base, pair by pair: what disturbs both runs of a pair cancels."""
    return [value / b for value, b in zip(values, base, strict=True)]


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table, padded so that it also reads well in a terminal."""
    cells = [["what", "median", "min to max", "unit", "ratio (min to max)", "asked"]]
    return markdown(cells + [_cells(row) for row in rows])


def markdown(cells: Sequence[Sequence[str]]) -> str:
    """Lines of a Markdown table, the first its head."""
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    lines = [_line(line, widths) for line in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def _cells(row: Row) -> list[str]:
    values, pairs, asked, met = spread(row.runs), "", [], True
    if row.ratios:
        r = spread(row.ratios)
        pairs = f"{r['median']:.3g} x {row.against} ({r['min']:.3g} to {r['max']:.3g})"
        if row.least_ratio is not None:
            asked.append(f"at least {row.least_ratio:g} x")
            met = r["median"] >= row.least_ratio
        if row.most_ratio is not None:
            asked.append(f"at most {row.most_ratio:.3g} x")
            met = met and r["median"] <= row.most_ratio
    if row.most is not None:
        asked.append(f"at most {row.most:g}")
        met = met and values["median"] <= row.most
    if asked:
        asked.append("met" if met else "MISSED")
    return [
        f"{row.group}: {row.name}",
        f"{values['median']:.4g}",
        f"{values['min']:.4g} to {values['max']:.4g}",
        row.unit,
        pairs,
        ", ".join(asked),
    ]


def _line(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "| " + " | ".join(c.ljust(w) for c, w in zip(cells, widths, strict=True)) + " |"
