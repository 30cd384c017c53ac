"""Are sensor errors told apart on records that other people's simulators made? Named, in a group, silent or misnamed.

Every data set gets an error of every kind in turn, of each channel or unit in turn, size and sign drawn at random (0.5
to 2 times the typical size), put into its records by formulas of this file; then the sensors are compared with each
other and with the controls, which is the first thing that `rotorid close-loop` does. One JSON line per run; runs that
have a line are not repeated. `--report` writes the table into docs/closed-loop.md.

Expected: no false name; nothing on the sets as they are; silence only where an error is too small to show, as the
scale of accelerometers along which a hovering vehicle hardly accelerates; short filters in a group with delays.
"""

from __future__ import annotations

import json
import math
import os
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np
import torch
import tyro
from hidden.changed_records import Records, changed, smoothed
from recorded.lines import read_lines
from recorded.runs import over_sets, sets_left
from recorded.tables import OUTCOMES, markdown, share, write_between
from scipy.signal import cont2discrete, lfilter, lfilter_zi

import rotorid_torch as rotorid
from rotorid_torch.consistency.sensor_errors.clocks import sensor_findings
from rotorid_torch.data import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.one_rate import at_one_rate

ROOT = Path(__file__).parents[2]
RATES, FORCES, BODY_AXES = ("p", "q", "r"), ("ax", "ay", "az"), ("x", "y", "z")
UNITS = {"rates": RATES, "accelerations": FORCES, "attitude": ("phi", "theta", "psi"), "velocities": ("u", "v", "w")}
MEMBERS: dict[str, dict[str, float]] = {
    "bias": dict.fromkeys(RATES, 0.01) | dict.fromkeys(FORCES, 0.1),
    "scale": dict.fromkeys((*RATES, *FORCES), 0.03),
    "misalignment": dict.fromkeys(BODY_AXES, 0.015),
    "lever_arm": dict.fromkeys(BODY_AXES, 0.5),
    "delay": dict.fromkeys(UNITS, 0.05),
    "filter": dict.fromkeys(UNITS, 0.05),
    "second_order": dict.fromkeys(UNITS, 0.025),
}
"""What may be wrong, by kind of error, and its typical size: rad/s and m/s², 1, rad, m, s (1/natural frequency)."""
EFFECT = {kind: f"sensors.{kind}" for kind in MEMBERS} | {"second_order": "sensors.filter"}
ENDING = {"second_order": "_period"}
"""Behind the unit in the name of the parameter that the size is of."""
DAMPING = 0.7
"""Of filters of second order, as most have."""
ONE_SIGN = ("delay", "filter", "second_order")
WHOLE = ("misalignment", "lever_arm")  # three axes are told together
ROWS = {"nothing": "nothing", "second_order": "sensors.filter of second order"}
"""Titles of rows that are not called as their effect is."""
SMOOTHED_S = 0.1
"""Rates are smoothed over this before they are differentiated for an arm."""


@dataclass
class Args:
    """Which sets, and where they lie."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", str(ROOT.parent / "shared"))) / "flightdata"
    """Folder of the data sets."""
    sets: tuple[str, ...] = ("uh60-hover", "uh60-60kt", "ah1-hover", "uh60b-hover")
    """Names of the sets; those that are not there are skipped."""
    draws: int = 10
    """Errors of each kind for each set."""
    quick: bool = False
    """One error of each kind, the first of the sets that is there."""
    report: bool = False
    """Run nothing; turn the lines into the table."""
    page: Path = ROOT / "docs" / "closed-loop.md"
    """Page that holds the table, between its markers."""
    processes: int = 1
    """Runs at the same time."""
    seed: int = 0
    out: Path = Path("runs/wrong_sensors")
    """Lines (runs.jsonl) and TensorBoard records."""


def _bias(records: Records, member: str, size: float, dt: float) -> Records:
    return {member: records[member] + size}


def _scale(records: Records, member: str, size: float, dt: float) -> Records:
    return {member: records[member] * (1.0 + size)}


def _misalignment(records: Records, member: str, size: float, dt: float) -> Records:
    """The unit turned by an angle about an axis of the body, which it shares; it reads along its own axes."""
    first, second = ((1, 2), (2, 0), (0, 1))[BODY_AXES.index(member)]
    c, s, out = math.cos(size), math.sin(size), {}
    for unit in (RATES, FORCES):
        a, b = unit[first], unit[second]
        out |= {a: c * records[a] + s * records[b], b: c * records[b] - s * records[a]}
    return out


def _lever_arm(records: Records, member: str, size: float, dt: float) -> Records:
    """Accelerometers displaced along an axis of the body."""
    arm = size * np.eye(3)[BODY_AXES.index(member)]
    rates = np.stack([smoothed(records[c], round(0.5 * SMOOTHED_S / dt)) for c in RATES], axis=-1)
    added = np.cross(np.gradient(rates, dt, axis=0), arm) + np.cross(rates, np.cross(rates, arm))
    return {c: records[c] + added[:, k] for k, c in enumerate(FORCES)}


def _delay(records: Records, member: str, size: float, dt: float) -> Records:
    own = {c: records[c] for c in UNITS[member] if c in records}
    when = dt * np.arange(len(next(iter(own.values()))))
    return {c: np.interp(when - size, when, values) for c, values in own.items()}


def _filter(records: Records, member: str, size: float, dt: float) -> Records:
    return _passed(records, UNITS[member], [size, 1.0], dt)


def _second_order(records: Records, member: str, size: float, dt: float) -> Records:
    return _passed(records, UNITS[member], [size * size, 2.0 * DAMPING * size, 1.0], dt)


def _passed(records: Records, channels: Sequence[str], denominator: Sequence[float], dt: float) -> Records:
    """Behind 1 / denominator(s), from rest, the record straight between samples."""
    (numerator,), divisor, _ = cont2discrete(([1.0], denominator), dt, "foh")
    still = lfilter_zi(numerator, divisor)
    present = {c: records[c] for c in channels if c in records}
    return {c: lfilter(numerator, divisor, values, zi=still * values[0])[0] for c, values in present.items()}


WRONG: dict[str, Callable[[Records, str, float, float], Records]] = {
    "bias": _bias,
    "scale": _scale,
    "misalignment": _misalignment,
    "lever_arm": _lever_arm,
    "delay": _delay,
    "filter": _filter,
    "second_order": _second_order,
}


def with_error(dataset: Dataset, kind: str, member: str, size: float) -> Dataset:
    """The data set with one sensor error in all its flights."""

    def change(number: int, flight: Flight) -> Records:
        return WRONG[kind]({c: values.numpy() for c, values in flight.channels.items()}, member, size, flight.dt)

    return changed(dataset, change)


def run_one(place: Path, kind: str, number: int, seed: int) -> dict:
    """Put one error into a set and ask the sensors; `kind` "nothing": the set as it is."""
    torch.set_num_threads(1)
    began, dataset = time.perf_counter(), rotorid.load(place)
    told = {"case": f"{place.name} {kind} {number} seed {seed}", "hidden": [], "set": place.name, "kind": kind}
    if kind != "nothing":
        rng = np.random.default_rng([seed, number, zlib.crc32(f"{place.name} {kind}".encode())])
        member = list(MEMBERS[kind])[number % len(MEMBERS[kind])]
        size = MEMBERS[kind][member] * float(2.0 ** rng.uniform(-1.0, 1.0))
        size *= 1.0 if kind in ONE_SIGN else float(rng.choice((-1.0, 1.0)))
        dataset = with_error(dataset, kind, member, size)
        told |= {"hidden": [EFFECT[kind]], "member": f"{EFFECT[kind]}.{member}{ENDING.get(kind, '')}", "size": size}
    found = sensor_findings(at_one_rate(dataset))
    named = [f.id for f in found.findings if f.verdict == "accepted"]
    group = [f.id for f in found.findings if f.verdict == "indistinguishable"]
    accepted = [p for f in found.findings for p in f.parameters if p.accepted]
    own = [p for p in accepted if p.name == told.get("member")]
    told |= {"named": named, "group": group, "accepted": [p.name for p in accepted]}
    told |= {"found": own[0].value, "se": own[0].se} if own else {}
    sentence = f"{', '.join(named) or 'nothing'}, {told.get('member', 'nothing')} hidden"
    return told | {"sentence": sentence, "seconds": round(time.perf_counter() - began, 1)}


def _units(parameters: Sequence[str]) -> set[str]:
    """Effect and unit of parameters, a filter's period and damping alike."""
    return {name.removesuffix("_damping").removesuffix("_period") for name in parameters}


def outcome(line: dict) -> str:
    """What a run's answer is worth; the right effect of another channel, unit or axis is a false name."""
    hidden, named, group = (set(line[key]) for key in ("hidden", "named", "group"))
    wrong = named and line["kind"] not in WHOLE and _units(line["accepted"]) != _units([line["member"]])
    if named - hidden or (group and not group & hidden) or wrong:
        return "false name"
    return "in a group" if group else "named" if named else "silent"


def table(lines: Sequence[dict]) -> str:
    """A row for each kind of error."""
    rows = []
    for kind in ("nothing", *MEMBERS):
        own = [line for line in lines if line["kind"] == kind]
        said = [outcome(line) for line in own]
        off = sorted(abs(line["found"] - line["size"]) / line["se"] for line in own if "found" in line)
        ratios = [line["found"] / line["size"] for line in own if "found" in line]
        sizes = (f"{median(ratios):.3f}", f"{median(off):.1f}", f"{off[-1]:.1f}") if off else ("", "", "")
        counts = [str(said.count(one)) if one in said else "" for one in OUTCOMES if one not in ("in part", "no name")]
        rows.append((ROWS.get(kind, f"sensors.{kind}"), str(len(own)), *counts, *sizes))
    hidden = [outcome(line) for line in lines if line["hidden"]]
    off = ("found / true, median", "standard errors off, median", "largest")
    head = ("wrong", "runs", "named", "in a group", "silent", "false name", *off)
    summary = f"Named alone: {share(hidden.count('named'), len(hidden))}."
    return markdown(head, rows) + f"\n\n{summary}"


def study(args: Args, file: Path) -> dict:
    """Run what has no line yet."""
    draws = [(kind, k) for kind in MEMBERS for k in range(1 if args.quick else args.draws)]
    given, skipped = [], {}
    for kind, k in (*draws, ("nothing", 0)):
        left, skipped = sets_left(args.data, args.sets, args.quick, file, f"{kind} {k} seed {args.seed}")
        given += [(args.data / name, kind, k, args.seed) for name in left]
    return {"runs": over_sets(run_one, given, args.processes, file, asdict(args)), "skipped": skipped}


def main(args: Args) -> None:
    """Run the study or write its table, and end with one JSON line."""
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "runs.jsonl"
    result = {} if args.report else study(args, file)
    lines = read_lines(file)
    if args.report:
        write_between(args.page, "wrong sensors", table(lines) if lines else "No runs yet.")
    said = {what: [outcome(line) for line in lines if bool(line["hidden"]) == what] for what in (True, False)}
    counts = {what: {one: own.count(one) for one in dict.fromkeys(own)} for what, own in said.items()}
    print(json.dumps(result | {"wrong": counts[True], "right": counts[False]}))


if __name__ == "__main__":
    main(tyro.cli(Args))
