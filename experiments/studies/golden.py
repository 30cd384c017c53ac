"""How often is the closed loop right, and how often wrong? One line for each case, by version of the package.

Cases: sets of other people with known answers, and drawn aircraft that hide nothing, an effect at its typical and at
half its size, a pair, a cause that no library has, or an effect whose own entry is taken out of the library. Drawn
aircraft come in a tuning half and a judging half. Lines that the record holds for this version are not run again;
delete a line to repeat it.

Another version of the package is measured by the same cases with

    PYTHONPATH=CHECKOUT python experiments/studies/golden.py --half judging

where CHECKOUT is a work tree of the project. The loop as it was before its redesign is commit dd0228f, the git tag
`loop-of-rules`: `git worktree add CHECKOUT loop-of-rules`. `--table` prints the rates of all versions in the record
side by side.

Statistics of clean aircraft are kept in a folder of each version, so that a vehicle's second data set finds those of
its first, as a user's would; cases of one aircraft therefore share the luck of their clean aircraft. A case takes 60 to
400 s of a processor.
"""

from __future__ import annotations

import json
import os
import random
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

import torch
import tyro
from golden_study.cases import ANSWERS, SEEDS, Case, Half, Kind, drawn_cases, shared_cases
from golden_study.closed_loop import key, run_case
from golden_study.table import golden_table
from hidden.drawn_aircraft import draw
from recorded.lines import read_lines, version
from recorded.runs import keep, lines_of
from torch.utils.tensorboard import SummaryWriter

ROOT = Path(__file__).parents[2]


@dataclass
class Args:
    """Which cases."""

    half: tuple[Half, ...] = (Half.SHARED, Half.TUNING)
    """Sets of other people, and halves of the drawn aircraft."""
    only: tuple[Kind, ...] = ()
    """Kinds of cases; without them all."""
    sets: tuple[str, ...] = tuple(ANSWERS)
    """Sets of other people; those that are not there are skipped."""
    aircraft: int = 20
    """Aircraft that are drawn in each half."""
    clean: int = 100
    """Cases of a half in which nothing is hidden."""
    rounds: int = 2
    """Over everything that can be hidden in a half: about 100 cases each."""
    most: int | None = None
    """Cases that are run now, at most."""
    jobs: int = 1
    """Cases at the same time."""
    quick: bool = False
    """One clean case of few short flights and a library of one effect."""
    table: bool = False
    """Run nothing; print the tables."""
    data: Path = Path(os.environ.get("ROTORID_SHARED", str(ROOT.parent / "shared"))) / "flightdata"
    """Folder of the sets of other people."""
    record: Path = ROOT / "experiments" / "studies" / "records" / "golden.jsonl"
    """One line for each case and version."""
    out: Path = Path("runs/golden")
    """Drawn aircraft, statistics of clean aircraft by version of the package, TensorBoard records."""


def cases(args: Args) -> list[Case]:
    """All cases that are asked for and can be run, in their order."""
    if args.quick:
        return [Case(Half.TUNING, Kind.QUICK)]
    selected = [case for case in shared_cases() if case.half in args.half and case.dataset in args.sets]
    selected = [case for case in selected if (args.data / case.dataset / "dataset.toml").exists()]
    for half in (half for half in args.half if half in SEEDS):
        selected += drawn_cases(half, args.aircraft, args.clean, args.rounds)
    return [case for case in selected if not args.only or case.kind in args.only]


def study(args: Args) -> int:
    """Run the cases that have no line of this version; returns how many."""
    recorded = {line["case"] for line in read_lines(args.record)}
    remaining = list(islice((case for case in cases(args) if key(case) not in recorded), args.most))
    os.environ["PYTHONSAFEPATH"] = "1"  # processes of the package load this version, not one in the working folder
    os.environ.setdefault("ROTORID_CACHE", str((args.out / "cache" / version()).resolve()))
    Path(os.environ["ROTORID_CACHE"]).mkdir(parents=True, exist_ok=True)
    aircraft = args.out / "aircraft"
    aircraft.mkdir(parents=True, exist_ok=True)
    args.record.parent.mkdir(parents=True, exist_ok=True)
    for half, number in dict.fromkeys((case.half, case.aircraft) for case in remaining if not case.dataset):
        draw(number, SEEDS[half], aircraft)
    writer = SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    arguments = [(case, args.data, aircraft) for case in remaining]
    runs = keep(lines_of(run_case, arguments, args.jobs), args.record, len(arguments), writer)
    writer.close()
    return runs


def main(args: Args) -> None:
    """Run the study or print its tables, and end with one JSON line."""
    random.seed(0)
    torch.manual_seed(0)
    torch.set_num_threads(1)
    if args.table:
        lines = [line for line in read_lines(args.record) if line["half"] in args.half]
        print(golden_table([line for line in lines if not args.only or line["kind"] in args.only]))
    runs = 0 if args.table else study(args)
    lines = read_lines(args.record)
    print(json.dumps({"version": version(), "runs": runs, "lines": len(lines)}))


if __name__ == "__main__":
    main(tyro.cli(Args, config=(tyro.conf.EnumChoicesFromValues,)))
