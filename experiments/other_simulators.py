"""Does the closed loop hold on aircraft that it was not made with? Errors before and after on others' simulators.

Data sets of helicopters flown by J-GenHel, JSBSim and helisim: some hide nothing, one has its controls recorded early,
some do not tell. One JSON line per set; sets that have a line are not run again. `--report` writes the table into
docs/closed-loop.md. `--hide` puts a cause into the records of each of them (see `hidden_in_records`).

Expected: nothing undeclared on uh60-hover, uh60-60kt, ah1-hover, uh60b-hover; on uh60-delay control.delay, alone or in
a group with control.lag, 60 ms within three of its standard errors.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro
from hidden_in_records import CAUSES
from loop_lines import failure, loop_line, read_lines
from loop_runs import over_sets, sets_left
from loop_tables import markdown, number, write_between

import rotorid_torch as rotorid

ROOT = Path(__file__).parents[1]
HIDES: dict[str, tuple[str, ...] | None] = {
    "uh60-hover": (),
    "uh60-60kt": (),
    "uh60-delay": ("control.delay",),
    "ah1-hover": (),
    "uh60b-hover": (),
    "uh60-x1": None,
    "uh60-x2": None,
    "uh60-x3": None,
    "ah1-x1": None,
}
"""What the sets are known to hide; None: not told."""
TRUE = {"uh60-delay": {"control.delay.common": 0.06}}


@dataclass
class Args:
    """Which sets, and where they lie."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", str(ROOT.parent / "shared"))) / "flightdata"
    """Folder of the data sets."""
    sets: tuple[str, ...] = tuple(HIDES)
    """Names of the sets; those that are not there are skipped."""
    quick: bool = False
    """The first of the sets that is there."""
    report: bool = False
    """Run nothing; turn the lines into the table."""
    page: Path = ROOT / "docs" / "closed-loop.md"
    """Page that holds the table, between its markers."""
    hide: tuple[str, ...] = ()
    """Causes that are put into the records, each of each set; their lines are in a table of their own."""
    processes: int = 1
    """Sets at the same time."""
    seed: int = 0
    out: Path = Path("runs/other_simulators")
    """Lines (runs.jsonl), one RUN per set, and TensorBoard records."""


def run_set(place: Path, out: Path, seed: int, hide: str = "") -> dict:
    """Close the loop on one set, a cause put into its records where one is told; its RUN stays, with the report."""
    torch.set_num_threads(1)
    name, began = place.name, time.perf_counter()
    hides, true = HIDES.get(name), TRUE.get(name, {})
    if hide and hides is not None:
        hides = tuple(dict.fromkeys((*hides, hide)))
    line = {"case": f"{name} {hide}".strip(), "hidden": hides}
    out.mkdir(parents=True, exist_ok=True)
    try:
        dataset = rotorid.load(place)
        if hide:
            made = CAUSES[hide](dataset)
            dataset, true = made.dataset, {**true, **{n: v + true.get(n, 0.0) for n, v in made.true.items()}}
        loop = rotorid.close_loop(dataset, out=out / line["case"].replace(" ", "-"), seed=seed)
        line |= loop_line(loop, hides or (), true) | {"true": dict(true)}
    except (ValueError, RuntimeError) as error:
        line |= failure(error)
    return line | {"seconds": round(time.perf_counter() - began, 1)}


def table(lines: Sequence[dict]) -> str:
    """Verdict, and J on unseen flights before and after, beside that of the noise."""
    order = list(HIDES)
    rows = []

    def place(line: dict) -> tuple[int, str]:
        return order.index(_set(line)) if _set(line) in order else len(order), line["case"]

    for line in sorted(lines, key=place):
        hides = "not told" if line["hidden"] is None else ", ".join(line["hidden"]) or "nothing"
        if "failed" in line:
            rows.append((_set(line), hides, line["failed"], *[""] * 7))
            continue
        true = [f"{n.rpartition('.')[2]} {v:.3g}" for n, v in line.get("true", {}).items()]
        hides += f" ({', '.join(true)})" if true else ""
        j = line["J"]
        scores = [number(j[when][flights]) for flights in ("validate", "acid") for when in ("before", "after", "noise")]
        rows.append((_set(line), hides, line["sentence"], *scores, f"{line['seconds']:.0f}"))
    head = ("validate before", "after", "noise", "acid before", "after", "noise", "s")
    return markdown(("set", "hides", "what the loop says", *head), rows)


def _set(line: dict) -> str:
    """Name of the set that a line is of."""
    return line["case"].split(" ")[0]


def study(args: Args, file: Path) -> dict:
    """Run the sets that are there and have no line yet; those that are not are named with the reason."""
    given, skipped = [], {}
    for hide in args.hide or ("",):
        if hide and hide not in CAUSES:
            raise SystemExit(f"there is no '{hide}' to put into records; one of: {', '.join(CAUSES)}")
        left, skipped = sets_left(args.data, args.sets, args.quick, file, hide)
        given += [(args.data / name, args.out / "runs", args.seed, hide) for name in left]
    return {"runs": over_sets(run_set, given, args.processes, file, asdict(args)), "skipped": skipped}


def main(args: Args) -> None:
    """Run the sets or write the table, and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "runs.jsonl"
    result = {} if args.report else study(args, file)
    lines = [line for line in read_lines(file) if (" " in line["case"]) == bool(args.hide)]
    if args.report:
        marker = "other simulators, with a cause" if args.hide else "other simulators"
        write_between(args.page, marker, table(lines) if lines else "No runs yet.")
    verdicts = {one["case"]: one.get("verdict", "failed") for one in lines}
    print(json.dumps(result | {"verdicts": verdicts}))


if __name__ == "__main__":
    main(tyro.cli(Args))
