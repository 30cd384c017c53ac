"""Campaign of damaged inputs: logs of seven formats, data sets, models and reports, each damaged by a seed and judged.

    python experiments/studies/fuzz.py --out fuzz.jsonl            2000 logs, 500 data sets, 200 models and reports
    python experiments/studies/fuzz.py --out fuzz.jsonl --quick    a fiftieth of them

The file holds one line per case and is added to, so that a campaign that was stopped goes on; the table counts what it
holds. What counts as a fault is in `tests/fuzzing.py`; a case is repeated by its kind and seed.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.fuzzing import KINDS, LOGS, judged  # noqa: E402 - the checkout is found first

CASES = {**dict.fromkeys(LOGS, 286), "check": 400, "identify": 100, "model": 100, "report": 100}
"""Cases of each kind."""
BATCH = 20
"""Cases that a process judges before another takes its place: what a command leaves in memory does not add up."""


def batches(done: set[tuple[str, int]], share: float, first: int) -> Iterator[list[tuple[str, int]]]:
    """Cases that are still to be judged, by kinds."""
    for kind in KINDS:
        seeds = range(first, first + max(1, round(share * CASES[kind])))
        left = [(kind, seed) for seed in seeds if (kind, seed) not in done]
        yield from (left[at : at + BATCH] for at in range(0, len(left), BATCH))


def judge(cases: list[tuple[str, int]]) -> list[dict]:
    """Lines of the file for these cases."""
    lines = []
    for kind, seed in cases:
        begin = time.perf_counter()
        damage, answer = judged(kind, seed)
        seconds = round(time.perf_counter() - begin, 3)
        lines.append({"kind": kind, "seed": seed, "damage": damage.what, "impossible": damage.impossible})
        lines[-1] |= {"code": answer.code, "fault": answer.fault[:300], "seconds": seconds}
    return lines


def table(lines: list[dict]) -> str:
    """Counts by kind: cases, exit codes, values that no aircraft has, crashes, silent nonsense, other faults."""
    rows = [("kind", "cases", "exit 0", "exit 2", "exit 3", "impossible", "crashes", "silent", "others", "slowest, s")]
    for kind in (*KINDS, "all"):
        some = [line for line in lines if kind in (line["kind"], "all")]
        codes = Counter(line["code"] for line in some)
        faults = Counter(line["fault"].partition(":")[0] for line in some if line["fault"])
        crashes, silent = faults.pop("crash", 0), faults.pop("silent nonsense", 0)
        numbers = (len(some), codes[0], codes[2], codes[3], sum(line["impossible"] for line in some), crashes, silent)
        slowest = max((line["seconds"] for line in some), default=0.0)
        rows.append((kind, *map(str, numbers), str(sum(faults.values())), f"{slowest:.1f}"))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(row, widths, strict=True)) for row in rows)


def main() -> None:
    """Judge what is left to judge, then print the table and the faults."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="file of results, added to")
    parser.add_argument("--quick", action="store_true", help="a fiftieth of the cases")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first case of each kind (0)")
    parser.add_argument("--processes", type=int, default=1, help="processes that work side by side (1)")
    options = parser.parse_args()
    lines = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    todo = batches({(line["kind"], line["seed"]) for line in lines}, 0.02 if options.quick else 1.0, options.seed)
    spawn = multiprocessing.get_context("spawn")
    with options.out.open("a") as file, spawn.Pool(options.processes, maxtasksperchild=5) as pool:
        for some in pool.imap_unordered(judge, todo):
            file.writelines(json.dumps(line) + "\n" for line in some)
            file.flush()
            lines += some
    print(table(lines))
    for line in lines:
        if line["fault"]:
            print(f"{line['kind']} {line['seed']}: {line['damage']}: {line['fault']}")


if __name__ == "__main__":
    main()
