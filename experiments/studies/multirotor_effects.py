"""What does `close-loop` say of multirotors that hide an effect, or nothing? One line for each case.

Vehicles are drawn at random (27 g to 5 kg, 4 to 8 rotors) and flown by the flight-test multirotor; the data set that
the loop reads has no truth. A case is right where all hidden effects are named, or are members of the group that is
named, and nothing else is named that the vehicle does not have (wind and gusts bring what the rotors feel of the air).
Lines that the record holds for this version of the package are not run again.

    python multirotor_effects.py --clean 40 --draws 5 [--effects propulsion.motor_lag ...] [--size 1.0]
    python multirotor_effects.py --draws 5 --effects propulsion.motor_lag+propulsion.rotor_drag
    python multirotor_effects.py --draws 5 --effects propulsion.motor_lag+outside.wake
    python multirotor_effects.py --balance --draws 10 --effects propulsion.unequal --seconds 8
    python multirotor_effects.py --table

A case takes 1 to 4 minutes of a processor, 4 s where the balance of thrusts alone is judged; `--quick` flies one clean
vehicle in few short flights.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import tyro
from hidden.wakes import WAKE, wakes
from recorded.lines import append_line, failure, read_lines, version

from rotorid_torch.data import Dataset
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.run.close_loop import close_loop
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.multirotor.hidden import HIDDEN
from rotorid_torch.trace.balance import out_of_balance
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.terms.verdict import statement

ROOT = Path(__file__).parents[2]


@dataclass
class Args:
    """Which cases."""

    clean: int = 0
    """Vehicles that hide nothing."""
    draws: int = 0
    """Vehicles for each effect."""
    effects: tuple[str, ...] = tuple(HIDDEN)
    """Effects that are hidden, one at a time; those joined by + together. A cause of no library: outside.wake."""
    size: float = 1.0
    """Factor of their typical size."""
    seconds: float = 12.0
    """Of each flight."""
    first: int = 0
    """Number of the first vehicle."""
    quick: bool = False
    """One clean vehicle in two short flights."""
    balance: bool = False
    """Judge the balance of thrusts alone."""
    table: bool = False
    """Run nothing; print how many cases ended how."""
    record: Path = ROOT / "experiments" / "studies" / "records" / "multirotor.jsonl"
    """One line for each case and version."""


@dataclass(frozen=True)
class Case:
    """A vehicle, by number, and what it hides: effects, joined by +, at a factor of their typical size, or nothing."""

    number: int
    effect: str
    size: float
    seconds: float
    flights: tuple[str, ...]
    balance: bool = False

    @property
    def hidden(self) -> tuple[str, ...]:
        """The effects of the simulator one by one; what else is hidden is a cause of no library."""
        return tuple(one for one in self.effect.split("+") if one in HIDDEN)

    @property
    def name(self) -> str:
        """Of the case in the record."""
        judged = "/balance" if self.balance else ""
        hidden = f"{self.effect or 'clean'}x{self.size:g}"
        return f"{version()}/multirotor-{self.number}/{hidden}/{self.seconds:g}s{judged}"


def cases(args: Args) -> Iterator[Case]:
    """Clean vehicles, then those that hide an effect, every effect once before any twice."""
    if args.quick:
        yield Case(2, "", 0.0, 3.0, ("thrust_p", "roll_p", "pitch_p", "mixed_n", "random_a"))
        return
    for number in range(args.first, args.first + args.clean):
        yield Case(number, "", 0.0, args.seconds, ("all",), args.balance)
    for number in range(args.first, args.first + args.draws):
        for effect in args.effects:
            needed = {HIDDEN[one].flights for one in effect.split("+") if one in HIDDEN} - {""}
            yield Case(number, effect, args.size, args.seconds, ("all", *sorted(needed)), args.balance)


def run_case(case: Case) -> dict:
    """Fly a case, close the loop, and say what came of it."""
    hidden = [(effect, case.size) for effect in case.hidden]
    vehicle = f"multirotor-{case.number}"
    with wakes(case.seconds) if WAKE in case.effect else nullcontext():
        flown = fly(None, vehicle=vehicle, flights=case.flights, effects=hidden, seconds=case.seconds, seed=case.number)
    line: dict = {"case": case.name, "vehicle": vehicle, "hidden": case.effect, "size": case.size}
    before = time.process_time()
    try:
        report = balance_report(flown.dataset()) if case.balance else loop_report(flown.dataset())
    except Exception as error:  # a study goes on; the line tells
        return line | failure(error)
    verdict = report["verdict"]
    line |= {"kind": verdict["kind"], "named": verdict["effects"], "outcome": outcome(case, verdict)}
    line |= {"sizes": sizes(report, verdict["effects"]), "unknown": (report["unknown"] or {}).get("sentence")}
    return line | {"cpu_s": round(time.process_time() - before, 1)}


def loop_report(dataset: Dataset) -> dict:
    """What the closed loop reports."""
    with tempfile.TemporaryDirectory(prefix="rotorid-multirotor-") as folder:
        close_loop(dataset, out=Path(folder) / "run")
        return json.loads((Path(folder) / "run" / "report.json").read_text(encoding="utf-8"))


def balance_report(dataset: Dataset) -> dict:
    """Of the balance of thrusts alone, by the model that the loop begins with, in the form of a report."""
    reconstruction = reconstruct(dataset)
    fitted = FittedAtStates.of(propose(dataset, reconstruction, ()), Flights(dataset, reconstruction))
    finding, missing = out_of_balance(fitted.model, fitted.spec, dataset, dataset.unseen)
    findings = [] if finding is None else [finding]
    said = statement(findings, missing)
    effects = [
        {"id": f.id, "parameters": [dict(name=n, value=v, se=e) for n, (v, e) in f.values.items()]} for f in findings
    ]
    unknown = None if missing is None else {"sentence": missing.sentence}
    return {"verdict": {"kind": said.kind, "effects": list(said.effects)}, "effects": effects, "unknown": unknown}


def outcome(case: Case, verdict: dict) -> str:
    """One word: right, group, silent, unknown, or wrong."""
    named = set(verdict["effects"])
    present = {*case.hidden, *(brought for effect in case.hidden for brought in HIDDEN[effect].brings)}
    if verdict["kind"] == "group":
        return "group" if named & present else "wrong"
    if named - present:
        return "wrong"
    if case.hidden and named >= {*case.hidden}:
        return "right"
    return "unknown" if verdict["kind"] == "unknown" else "silent"


def sizes(report: dict, named: list[str]) -> dict[str, list[float]]:
    """Value and standard error of each parameter of the named effects."""
    rows = [p for e in report["effects"] if e["id"] in named for p in e["parameters"]]
    return {p["name"]: [p["value"], p["se"]] for p in rows}


def table(lines: list[dict]) -> str:
    """How many cases of each effect ended how, and how often which effect was named on clean vehicles."""
    rows = []
    for effect in dict.fromkeys(line["hidden"] for line in lines):
        some = [line for line in lines if line["hidden"] == effect]
        counts = Counter(line.get("outcome", "failed") for line in some)
        named = Counter(e for line in some for e in line.get("named", ()))
        words = ", ".join(f"{count} {word}" for word, count in counts.most_common())
        rows.append(f"{effect or 'clean'}: {len(some)} cases: {words}; named {dict(named.most_common())}")
    return "\n".join(rows)


def main() -> int:
    """Run the cases that the record lacks."""
    args = tyro.cli(Args)
    lines = [line for line in read_lines(args.record) if line["case"].startswith(version())]
    if args.table:
        sys.stdout.write(table(lines) + "\n")
        return 0
    done = {line["case"] for line in lines}
    for case in cases(args):
        if case.name in done:
            continue
        line = run_case(case)
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()
        if not args.quick:
            append_line(args.record, line)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
