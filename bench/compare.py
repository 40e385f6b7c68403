"""What changed between two files that `python -m bench` wrote: `bench/compare.py A.json B.json`.

A median has changed if the runs of A and of B do not overlap at all and the medians differ by more
than 1 %. Ends with 1 if anything got worse, else 0. Needs no other module of ours.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

LEAST_CHANGE = 0.01


def verdict(before: dict[str, Any], after: dict[str, Any]) -> str:
    """better, worse, same; or unknown, where one run each says nothing of the spread."""
    if len(before["runs"]) < 2 or len(after["runs"]) < 2:
        return "unknown"
    apart = before["max"] < after["min"] or after["max"] < before["min"]
    if not apart or abs(change(before, after)) <= LEAST_CHANGE:
        return "same"
    return "better" if (after["median"] > before["median"]) == after["more"] else "worse"


def change(before: dict[str, Any], after: dict[str, Any]) -> float:
    """Relative change of the median."""
    return float(after["median"] / before["median"] - 1)


def compare(before: dict[str, Any], after: dict[str, Any]) -> tuple[list[str], bool]:
    """Lines to show, and whether anything got worse."""
    lines, worse = [], False
    for part in ("machine", "plan"):
        for name in sorted(before[part].keys() | after[part].keys()):
            a, b = before[part].get(name), after[part].get(name)
            if a != b:
                lines.append(f"note: {part}, {name}: {a} before, {b} after")
    for word, these, others in (("before", before, after), ("after", after, before)):
        lines += [f"note: {word}: {n}" for n in these["notes"] if n not in others["notes"]]
    old = {(row["group"], row["name"]): row for row in before["rows"]}
    new = {(row["group"], row["name"]): row for row in after["rows"]}
    for key, row in new.items():
        what = ": ".join(key)
        if key not in old:
            lines.append(f"{'new':8} {what}")
            continue
        word = verdict(old[key], row)
        worse = worse or word == "worse"
        a, b = old[key]["median"], row["median"]
        lines.append(
            f"{word:8} {what}: {a:.4g} -> {b:.4g} {row['unit']} ({change(old[key], row):+.1%})"
        )
    lines += [f"{'gone':8} {': '.join(key)}" for key in old if key not in new]
    return lines, worse


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("before", type=Path, metavar="A.json")
    parser.add_argument("after", type=Path, metavar="B.json")
    args = parser.parse_args()
    try:
        before, after = (json.loads(path.read_text()) for path in (args.before, args.after))
        lines, worse = compare(before, after)
    except (OSError, ValueError) as error:
        print(f"compare: {error}", file=sys.stderr)
        return 2
    except (KeyError, TypeError, AttributeError) as error:
        print(f"compare: not a file of python -m bench: {error!r}", file=sys.stderr)
        return 2
    print("\n".join(lines))
    return int(worse)


if __name__ == "__main__":
    sys.exit(main())
