"""What changed between two files that `python -m bench` wrote: `bench/compare.py A.json B.json`.

Ours is compared with ours; of others, how they stand to ours, and where a ratio is asked for, that
ratio, which does not depend on how fast the machine was. Seconds to an error count times that
error, as another sampler has another to reach.

A median has changed if the runs of A and of B do not overlap at all and the medians differ by more
than 1 %. By chance alone, 3 runs each lie apart in 1 of 10 rows, 5 in 1 of 126: fewer than 3 say
nothing. Ends with 1 if anything got worse, else 0. Needs no other module of ours.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

OURS = "parhelion"
# What is looked at of a row
FIELDS = {"group", "name", "unit", "runs", "median", "min", "max", "more", "against", "ratios"}
FIELDS |= {"least_ratio", "most_ratio"}
LEAST_CHANGE = 0.01
LEAST_RUNS = 3

# In the order in which they are shown.
WORDS = ("worse", "better", "unknown", "new", "gone", "same")


class BenchFileError(ValueError):
    """Of a file that is none of `python -m bench`; says which."""


def read(path: Path) -> dict[str, Any]:
    """What `python -m bench` wrote. Raises BenchFileError."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise BenchFileError(f"{path}: {problem.strerror}") from None
    except ValueError:
        raise BenchFileError(f"{path}: is no JSON") from None
    sound = isinstance(found, dict) and isinstance(found.get("rows"), list)
    for part, kind in (("machine", dict), ("plan", dict), ("versions", dict), ("notes", list)):
        sound = sound and isinstance(found.get(part), kind)
    if not sound or not all(map(_is_row, found["rows"])):
        raise BenchFileError(f"{path}: is no file of python -m bench, or of an old one")
    return dict(found)


def _is_row(row: Any) -> bool:
    if not isinstance(row, dict) or not row.keys() >= FIELDS:
        return False
    numbers = [row["median"], row["min"], row["max"]]
    for several in ("runs", "ratios"):
        if not isinstance(row[several], list):
            return False
        numbers += row[several]
    return all(isinstance(number, (int, float)) for number in numbers)


def quantity(row: dict[str, Any]) -> dict[str, Any]:
    """What is compared of a row: median, min, max, unit, the number of runs, and more, whether more
    of it is better for ours.
    """
    asked = row["least_ratio"] is not None or row["most_ratio"] is not None
    theirs = row["against"] == OURS and not row["name"].startswith(OURS)
    if (asked or theirs) and "ratio" in row:
        # The other's seconds over ours, or its speed over ours; or of two of ours.
        more = row["least_ratio"] is not None if asked else not row["more"]
        count, unit = len(row["ratios"]), f"x {row['against']}"
        return row["ratio"] | {"unit": unit, "count": count, "more": more}
    error = row.get("error") or 1.0
    spread = {key: error * row[key] for key in ("median", "min", "max")}
    unit = f"{row['unit']} x error" if row.get("error") else row["unit"]
    return spread | {"unit": unit, "count": len(row["runs"]), "more": row["more"]}


def verdict(before: dict[str, Any], after: dict[str, Any]) -> str:
    """better, worse, same; or unknown, where the runs are too few to say anything of the spread, or
    what is compared is not the same.
    """
    a, b = quantity(before), quantity(after)
    if min(a["count"], b["count"]) < LEAST_RUNS or a["unit"] != b["unit"]:
        return "unknown"
    apart = a["max"] < b["min"] or b["max"] < a["min"]
    if not apart or abs(b["median"] - a["median"]) <= LEAST_CHANGE * abs(a["median"]):
        return "same"
    return "better" if (b["median"] > a["median"]) == b["more"] else "worse"


def compare(before: dict[str, Any], after: dict[str, Any]) -> tuple[list[str], bool]:
    """Lines to show, and whether anything got worse."""
    lines = []
    for part in ("machine", "plan"):
        for name in sorted(before[part].keys() | after[part].keys()):
            a, b = before[part].get(name), after[part].get(name)
            if a != b:
                lines.append(f"note: {part}, {name}: {a} before, {b} after")
    for name in sorted(before["versions"].keys() & after["versions"].keys()):
        for key in ("version", "isa", "llvm"):
            a, b = (side["versions"][name].get(key) for side in (before, after))
            if a != b:
                lines.append(f"note: {name}, {key}: {a} before, {b} after")
    for word, these, others in (("before", before, after), ("after", after, before)):
        lines += [f"note: {word}: {n}" for n in these["notes"] if n not in others["notes"]]
    old = {(row["group"], row["name"]): row for row in before["rows"]}
    new = {(row["group"], row["name"]): row for row in after["rows"]}
    found: dict[str, list[str]] = {word: [] for word in WORDS}
    for key, row in new.items():
        what = ": ".join(key)
        if key not in old:
            found["new"].append(what)
            continue
        a, b = quantity(old[key]), quantity(row)
        shown = f"{what}: {a['median']:.4g} -> {b['median']:.4g} {b['unit']}"
        if a["median"]:
            shown += f" ({b['median'] / a['median'] - 1:+.1%})"
        found[verdict(old[key], row)].append(shown)
    found["gone"] = [": ".join(key) for key in old if key not in new]
    lines += [f"{word:8} {line}" for word in WORDS for line in found[word]]
    lines.append(", ".join(f"{len(found[word])} {word}" for word in WORDS))
    return lines, bool(found["worse"])


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("before", type=Path, metavar="A.json")
    parser.add_argument("after", type=Path, metavar="B.json")
    args = parser.parse_args()
    try:
        lines, worse = compare(read(args.before), read(args.after))
    except BenchFileError as error:
        print(f"compare: {error}", file=sys.stderr)
        return 2
    print("\n".join(lines))
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
