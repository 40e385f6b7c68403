"""The command: python -m fuzz, from the folder tests. See the package's text."""

from __future__ import annotations

import argparse
import json
import re
import signal
import sys
import tempfile
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from .harness import Case, Worker, read_cases, run, shrunk, signature
from .seeds import OPTIONS, READERS


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fuzz", description="Fuzz the readers.")
    parser.add_argument("--reader", action="append", choices=list(READERS), help="default: all")
    parser.add_argument("--seconds", type=float, default=60, help="of the processor, for each")
    parser.add_argument("--seed", type=int, help="default: the time")
    parser.add_argument(
        "--seeds", type=Path, action="append", default=[], help="folders of more good files"
    )
    parser.add_argument("--learn", action="store_true", help="new kinds of refusal become seeds")
    parser.add_argument("--findings", type=Path, help="folder for what is found")
    parser.add_argument("--log", type=Path, help="JSON lines, one added a reader")
    parser.add_argument("--table", type=Path, metavar="LOG", help="prints what a log holds")
    args = parser.parse_args()
    if args.table:
        print(table(args.table))
        return 0
    failed = False
    # Whoever ends it keeps what was done so far
    ends: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: ends.append(number))
    with tempfile.TemporaryDirectory() as scratch, Worker(Path(scratch) / "worker") as worker:
        for reader in args.reader or READERS:
            if ends:
                break
            begun = time.monotonic()
            endings, make = READERS[reader]
            seeds = make()
            for folder in args.seeds:
                seeds += read_cases(folder, endings)

            def found(name: str, case: Case, said: dict[str, Any], reader: str = reader) -> None:
                print(f"{reader}: {name}\n  {said['text'][:300]}", file=sys.stderr, flush=True)
                if args.findings:
                    keep(args.findings / reader, name, case, said)

            seed = int(time.time()) if args.seed is None else args.seed
            tally = run(
                worker, reader, seeds, seed=seed, seconds=args.seconds, learn=args.learn,
                options=OPTIONS.get(reader, ({},)), found=found, ended=lambda: bool(ends),
            )  # fmt: skip
            line = {
                "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
                "reader": reader, "seed": seed, "cpu": round(tally.cpu, 1),
                "wall": round(time.monotonic() - begun, 1), "cases": tally.cases,
                "loaded": tally.loaded, "refused": tally.refused, "kinds": len(tally.kinds),
                "slowest": round(tally.slowest, 2), "most": tally.most,
                "findings": list(tally.findings),
            }  # fmt: skip
            print(json.dumps(line), flush=True)
            if args.log:
                with args.log.open("a") as file:
                    file.write(json.dumps(line) + "\n")
            failed |= bool(tally.findings)
            if args.findings:
                for name, (case, said) in tally.findings.items():
                    small = shrunk(case, lambda c, n=name: again(worker, c) == n, 20.0)
                    keep(args.findings / reader, name, small, said, "small")
    return int(failed)


def again(worker: Worker, case: Case) -> str:
    """The signature of what is found, or nothing."""
    said = worker.load(case)
    return signature(said) if said["outcome"] == "finding" else ""


def keep(folder: Path, name: str, case: Case, said: dict[str, Any], kind: str = "whole") -> None:
    """Writes a case and what was said of it."""
    at = folder / re.sub(r"\W+", "-", name)[:100] / kind
    case.write(at)
    (at.parent / "report.json").write_text(
        json.dumps({"main": case.main, "options": case.options} | said, indent=1)
    )


def table(log: Path) -> str:
    """Markdown: what all lines of a log say of each reader."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    rows = []
    for reader in READERS:
        own = [line for line in lines if line["reader"] == reader]
        if own:
            minutes, count = sum(n["cpu"] for n in own) / 60, sum(n["cases"] for n in own)
            loaded = sum(n["loaded"] for n in own) / count
            slowest, most = max(n["slowest"] for n in own), max(n["most"] for n in own)
            rows.append(
                f"| {reader} | {minutes:.1f} | {count:,} | {100 * loaded:.0f} % |"
                f" {slowest:.1f} | {most >> 20} |"
            )
    return "\n".join(
        ["| reader | CPU minutes | files | loaded | slowest, s | most memory, MiB |",
         "|---|---|---|---|---|---|", *rows]
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
