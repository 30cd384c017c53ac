#!/usr/bin/env python
"""Every figure of speed in one command: scripts/bench.py --anchors DIR [--only ROW...] [--json FILE] [--profile].

Ratios are of medians over repeats in turn, in this process, at this load; see docs/speed.md.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[1]
PLACES = [str(ROOT), str(ROOT / "scripts")]
sys.path[:0] = PLACES
os.environ["PYTHONPATH"] = os.pathsep.join(PLACES + os.environ.get("PYTHONPATH", "").split(os.pathsep)).strip(
    os.pathsep
)

import torch  # noqa: E402  (after the number of threads)
from benchmark import models, problems, processes  # noqa: E402
from benchmark.rows import ROWS, Figure, NotMeasured, Result, judged, plain, table  # noqa: E402
from benchmark.setting import Measured, Setting  # noqa: E402
from rich.console import Console  # noqa: E402

DATA = Path(os.environ.get("ROTORID_SHARED", ROOT.parent / "shared")) / "flightdata" / "uh60-hover"
QUICK = (
    *("A-1", "A-10", "A-10-threads", "B-10", "B-10-threads", "accuracy-A-cpp", "accuracy-B-cpp"),
    *("import", "help", "help-torch"),
)
"""Rows of the smoke run."""
WIDTH = 150
"""Of the table where no terminal says otherwise."""


@dataclass(frozen=True)
class Measurement:
    """Rows that are measured together."""

    rows: tuple[str, ...]
    measure: Callable[[Setting], Measured]


def _race(problem: str, flights: int) -> Measurement:
    rows = tuple(f"{problem}-{flights}{end}" for end in problems.RACES)
    return Measurement(rows, partial(problems.race, problem=problem, flights=flights))


MEASUREMENTS = (
    _race("A", 1),
    _race("A", 10),
    _race("A", 100),
    _race("B", 10),
    Measurement(("accuracy-A", "accuracy-A-cpp"), partial(problems.agreement, problem="A")),
    Measurement(("accuracy-B", "accuracy-B-cpp"), partial(problems.agreement, problem="B")),
    Measurement(("gauss-newton", "accuracy-gauss-newton"), models.gauss_newton),
    Measurement(("engine-new", "engine-cached"), models.engine),
    Measurement(("reconstruct",), models.step1),
    Measurement(("import", "import-identify", "help", "help-torch"), processes.imports),
    Measurement(("identify-first", "identify-warm"), processes.identify),
    Measurement(("close-loop-cold", "close-loop"), processes.close_loop),
    *(
        Measurement((f"flights-{n}-time", f"flights-{n}-memory"), partial(processes.many_flights, count=n))
        for n in (100, 1000)
    ),
    Measurement(("ranks",), processes.ranks),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table, write JSON; exit code 0, 1 where something failed or missed its bar, 2 for usage."""
    options = parser().parse_args(arguments)
    known = [row.name for row in ROWS]
    wrong = _wrong(options, known)
    if wrong:
        print(f"bench.py: {wrong}", file=sys.stderr)
        return 2
    wanted = options.only or (QUICK if options.quick else known)
    torch.set_num_threads(1)
    console = Console(width=None if sys.stdout.isatty() else WIDTH)
    with tempfile.TemporaryDirectory(prefix="rotorid-bench-") as folder:
        setting = Setting(
            anchors=options.anchors,
            data=options.data,
            repeats=1 if options.quick else options.repeats,
            quick=options.quick,
            full=options.full,
            profile=options.profile,
            wanted=frozenset(wanted),
            folder=Path(folder),
            tell=lambda text: console.print(text, markup=False, highlight=False),
        )
        results, reasons = measured(setting, lambda rows: console.print(f"measuring {rows} ...", style="dim"))
    console.print(table(results, reasons, f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"))
    if options.json:
        options.json.write_text(json.dumps(plain(results), indent=1) + "\n")
    return int(any(r.met is False for r in results) or any(r.startswith("failed") for r in reasons.values()))


def _wrong(options: argparse.Namespace, known: Sequence[str]) -> str | None:
    """What is wrong with the options; better told before minutes of measuring than after."""
    strange = [name for name in options.only or () if name not in known]
    if strange:
        return f"there is no row '{strange[0]}'; expected {', '.join(known)}"
    if options.repeats < 1:
        return f"--repeats is {options.repeats}; expected one round or more"
    if options.json and (options.json.is_dir() or not options.json.absolute().parent.is_dir()):
        return f"--json {options.json} cannot be written; expected a file in an existing folder"
    return None


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="bench.py", description=__doc__, allow_abbrev=False)
    made.add_argument("--anchors", type=Path, metavar="DIR", help="folder with harness.py, problems.py and peers_*.py")
    made.add_argument("--data", type=Path, default=DATA, metavar="DIR", help="data set of the product's own rows")
    made.add_argument("--only", nargs="+", metavar="ROW", help="measure these rows")
    made.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    made.add_argument("--repeats", type=int, default=9, metavar="N", help="rounds of programs in turn (9)")
    made.add_argument("--profile", action="store_true", help="also tell where the time went")
    made.add_argument("--quick", action="store_true", help="short records, one round, only rows that take seconds")
    made.add_argument("--full", action="store_true", help="also 1000 flights")
    return made


def measured(setting: Setting, begins: Callable[[str], None]) -> tuple[list[Result], dict[str, str]]:
    """Results in the order of the table, and why some rows have none."""
    found: dict[str, Figure] = {}
    reasons: dict[str, str] = {}
    for measurement in MEASUREMENTS:
        chosen = [name for name in measurement.rows if name in setting.wanted]
        if not chosen:
            continue
        begins(", ".join(chosen))
        try:
            got = measurement.measure(setting)
        except NotMeasured as reason:
            got = dict.fromkeys(chosen, f"not measured: {reason}")
        except Exception as reason:  # one row that fails must not cost the others, which took minutes
            got = dict.fromkeys(chosen, f"failed: {type(reason).__name__}: {reason}")
        for name in chosen:
            figure = got[name]
            if isinstance(figure, Figure):
                found[name] = figure
            else:
                reasons[name] = figure
    return [judged(row, found.get(row.name)) for row in ROWS if row.name in setting.wanted], reasons


if __name__ == "__main__":
    sys.exit(main())
