"""Do named effects lower the error on real flights that were never used? Before and after, set by set.

Quadrotors and a model helicopter, measured by others. Before: the nominal model of the declared vehicle. After: the
model with the effects that the closed loop names, or, where that is asked for or fails, with those given. One JSON line
per set; sets that have a line are not run again. `--report` writes the table into docs/multirotor.md.

Expected: motor lag and delay bring roll and pitch acceleration of crazyflie-motors from nothing to 0.9 and its yaw
needs the rotors' inertia then; rotor drag explains ax and ay of nanodrone, voltage and lag its rotor speeds.
"""

from __future__ import annotations

import json
import os
import random
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
import tyro
from golden_study.closed_loop import summary
from recorded.lines import failure, read_lines
from recorded.runs import over_sets, sets_left
from recorded.tables import markdown, write_between
from scipy.signal import butter, sosfiltfilt

import rotorid_torch as rotorid
from rotorid_torch.consistency.correction import without_errors_of_flight
from rotorid_torch.data import Dataset
from rotorid_torch.model.accelerations import Accelerations
from rotorid_torch.model.model import Model
from rotorid_torch.run.result import Run
from rotorid_torch.simulation.drawn.multirotors import clean_balances
from rotorid_torch.trace.balance import DRAWS, ROWS, balances, going_with, standing
from rotorid_torch.validate.predictions import predictions
from rotorid_torch.validate.responses import measured_states, responses

ROOT = Path(__file__).parents[2]
MOTORS = ("propulsion.motor_lag", "control.delay")
GIVEN: dict[str, tuple[str, ...]] = {
    "crazyflie-motors": (*MOTORS, "propulsion.rotor_inertia"),
    "nanodrone": ("propulsion.rotor_drag", "propulsion.voltage", "propulsion.motor_lag"),
    "crazypad-normal": MOTORS,
    "crazypad-x1": MOTORS,
    "crazypad-x2": MOTORS,
    "trex550-rates": (),
    "trex550-translation": ("forces.drag",),
}
"""Effects that first looks with plain means found, where the closed loop is not asked."""
AZ_BAND = 0.3, 8.0
"""Hz, of crazypad's specific force."""
BALANCE = {
    "M": ("thrust centre along x, mm", 1e3),
    "L": ("thrust centre along y, mm", 1e3),
    "N": ("yaw balance, %", 100.0),
}
"""How the rows of balance are told."""
SLOW = {"trex550-rates": 3.0, "trex550-translation": 1.0}
"""Hz: upper edge of what is compared, Butterworth of second order, forward and backward."""


@dataclass
class Args:
    """Which sets, and where they lie."""

    data: Path = Path(os.environ.get("ROTORID_SHARED", str(ROOT.parent / "shared"))) / "flightdata"
    """Folder of the data sets."""
    sets: tuple[str, ...] = tuple(GIVEN)
    """Names of the sets; those that are not there are skipped."""
    given: bool = False
    """Take the effects from `effects` and not from the closed loop."""
    effects: dict[str, tuple[str, ...]] = field(default_factory=lambda: dict(GIVEN))
    """Effects by set, for `given` and for sets on which the closed loop fails."""
    quick: bool = False
    """The first of the sets that is there, with given effects."""
    report: bool = False
    """Run nothing; turn the lines into the table."""
    page: Path = ROOT / "docs" / "multirotor.md"
    """Page that holds the table, between its markers."""
    processes: int = 1
    """Sets at the same time."""
    seed: int = 0
    out: Path = Path("runs/measured_effects")
    """Lines (runs.jsonl) and TensorBoard records."""


def at_states(names: Mapping[str, str], flights: Sequence[str], smoothed: float) -> Callable[[Run, Dataset], dict]:
    """R2 at measured states, of each response on each flight; `names` by response."""

    def found(run: Run, data: Dataset) -> dict[str, list[float]]:
        told = [responses(run.model, data.flights[name], smoothed) for name in flights]
        return {f"R² of {text}": [one[name].r2 for one in told] for name, text in names.items()}

    return found


def rotor_speeds(run: Run, data: Dataset) -> dict[str, list[float]]:
    """R2 of all rotor speeds together from the commands, on each acid flight."""
    found = []
    for name in data.acid:
        told = [r for n, r in responses(run.model, data.flights[name], 0.0).items() if n.startswith("omega")]
        spread = sum(r.rmse**2 / (1.0 - r.r2) for r in told)
        found.append(1.0 - sum(r.rmse**2 for r in told) / spread)
    return {"R² of rotor speeds": found}


def benchmark(run: Run, data: Dataset) -> dict[str, list[float]]:
    """The benchmark's protocol: mean error over all samples of the acid flights, half a second ahead."""
    errors: dict[str, list[tuple[float, int]]] = {}
    for flight in (data.flights[name] for name in data.acid):
        for p in predictions(run.model, flight, starts=None):
            errors.setdefault(f"{p.quantity} after {p.seconds:g} s", []).append((p.error, flight.samples))
    return {n: [sum(e * k for e, k in found) / sum(k for _, k in found)] for n, found in errors.items()}


def thrust_in_band(run: Run, data: Dataset) -> dict[str, list[float]]:
    """Rms error of az and its R2 over all acid flights, in the band."""
    errors, truths = [], []
    for flight in (data.flights[name] for name in data.acid):
        sos = butter(2, AZ_BAND, "bandpass", fs=1.0 / flight.dt, output="sos")
        truth = flight.bridged(["az"])[:, 0].numpy()
        own = _rows(run.model, data, flight.name)["az"].numpy()
        truths.append(sosfiltfilt(sos, truth))
        errors.append(sosfiltfilt(sos, truth - own))
    error, truth = np.concatenate(errors), np.concatenate(truths)
    share = 1.0 - float((error**2).sum() / ((truth - truth.mean()) ** 2).sum())
    return {"az rms, m/s²": [float(np.sqrt((error**2).mean()))], "R² of az": [share]}


def balance(run: Run, data: Dataset) -> dict[str, tuple[float, float]]:
    """Rms on the acid flights of where thrusts balance: from the declared balance, and from what other flights told.

    Means over a second by the model's thrust curve; rows of which nothing was told are left out.
    """
    identified, new, acid = (
        balances(run.model, run.spec, data, names) for names in (data.identify, data.unseen, data.acid)
    )
    clean = torch.from_numpy(clean_balances(data, 0, range(DRAWS)))
    off, going = standing(run.spec, identified, new, clean), {g.row: g for g in going_with(identified, new)}
    found = {}
    for k, row in enumerate(ROWS):
        if off is None and row not in going:
            continue
        told = [going[row].explained(b) if row in going else off.centre[k] for b in acid]
        errors = [[b.centre[:, k], b.centre[:, k] - own] for b, own in zip(acid, told, strict=True)]
        without, rest = (float(torch.cat(part).square().mean().sqrt()) for part in zip(*errors, strict=True))
        name, scale = BALANCE[row]
        found[name] = (scale * without, scale * rest)
    return found


def turn_rates(run: Run, data: Dataset) -> dict[str, list[float]]:
    """R2 of the free runs of p and q, whole flights over 8 s, as the report tells them."""
    return {
        f"R² of {c} ({name}, free run)": [run.fit.flights[name].channels[c].r2 or float("nan")]
        for c, name in (("p", "roll_unseen"), ("q", "pitch_unseen"))
    }


def translation(run: Run, data: Dataset) -> dict[str, list[float]]:
    """R2 of du/dt and dv/dt on each acid flight, both sides below 1 Hz, half a second at the ends left out.

    As in the data's description, each axis has one constant, taken from the identify flights; without the errors of
    sensors that the model has.
    """
    found: dict[str, list[float]] = {}
    for k, axis in enumerate("uv"):
        known = [_axis_rate(run, data, name, k) for name in data.identify]
        constant = np.concatenate([truth - own for truth, own in known]).mean()
        sides = [_axis_rate(run, data, name, k) for name in data.acid]
        found[f"R² of d{axis}/dt"] = [
            1.0 - float(((y - m - constant) ** 2).sum() / ((y - y.mean()) ** 2).sum()) for y, m in sides
        ]
    return found


def _axis_rate(run: Run, data: Dataset, name: str, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Rate of change of u or v of a flight as measured and by the model at measured states, both low-passed."""
    errors = {n.removeprefix("sensors."): v for n, v in run.spec.values.items() if n.startswith("sensors.")}
    # the model reads late controls ahead by itself
    errors.pop("delay.controls", None)
    flight = without_errors_of_flight(data.flights[name], errors) if errors else data.flights[name]
    known = np.flatnonzero(~flight.stack(run.model.body.states).isnan().any(dim=1).numpy())
    inner = slice(known[0], known[-1] + 1)
    sos, ends = butter(2, SLOW[data.name], fs=1.0 / flight.dt, output="sos"), round(0.5 / flight.dt)
    with torch.no_grad():
        taped = run.model.tape(flight.bridged(run.model.body.controls), flight.dt)
        own = run.model.rates(run.model.theta, measured_states(run.model, flight), taped)[:, k].numpy()
    truth = np.gradient(flight.bridged(["uv"[k]])[inner, 0].numpy(), flight.dt)
    return sosfiltfilt(sos, truth)[ends:-ends], sosfiltfilt(sos, own[inner])[ends:-ends]


def _rows(model: Model, data: Dataset, name: str) -> dict[str, torch.Tensor]:
    flight = data.flights[name]
    with torch.no_grad():
        taped = model.tape(flight.bridged(model.body.controls), flight.dt)
        return Accelerations(model)(model.theta, measured_states(model, flight), taped, flight.dt)


QUANTITIES: dict[str, tuple[Callable[[Run, Dataset], dict], ...]] = {
    "crazyflie-motors": (
        at_states({"pdot": "p'", "qdot": "q'"}, ("roll_pitch_unseen_1", "roll_pitch_unseen_2"), 0.03),
        at_states({"rdot": "r'"}, ("yaw_unseen",), 0.03),
        at_states({"az": "az"}, ("thrust_unseen",), 0.03),
    ),
    "nanodrone": (
        at_states({"ax": "ax", "ay": "ay", "az": "az"}, ("melon_1", "melon_2", "melon_3"), 0.0),
        rotor_speeds,
        benchmark,
    ),
    **dict.fromkeys(("crazypad-normal", "crazypad-x1", "crazypad-x2"), (thrust_in_band,)),
    "trex550-rates": (turn_rates,),
    "trex550-translation": (translation,),
}
"""What is told of each set, on its acid flights: definitions as where the data are described."""


def run_set(place: Path, given: Sequence[str] | None, fallback: Sequence[str], seed: int) -> dict:
    """Before and after on one set; the effects are the loop's own where none are given."""
    torch.set_num_threads(1)
    began, data = time.perf_counter(), rotorid.load(place)
    line: dict = {"case": place.name}
    try:
        effects, source, loop = _effects(data, given, fallback, seed)
        nominal = rotorid.identify(data, seed=seed)
        richer = loop or (rotorid.identify(data, effects=effects, seed=seed) if effects else nominal)
        line |= {"effects": list(effects), "source": source, "before": {}, "after": {}}
        for quantity in QUANTITIES[place.name]:
            line["before"] |= quantity(nominal, data)
            line["after"] |= quantity(richer, data)
        for name, pair in (balance(richer, data) if richer.spec.motors else {}).items():
            line["before"][name], line["after"][name] = ([v] for v in pair)
        own = tuple(f"{e}." for e in effects)
        line["parameters"] = {
            p.name: (p.value, p.se) for p in richer.parameters if p.name.startswith(own) and p.status == "free"
        }
        line["sentence"] = f"{source}: {', '.join(effects) or 'nothing'}"
    except (ValueError, RuntimeError) as error:
        line |= failure(error)
    return line | {"seconds": round(time.perf_counter() - began, 1)}


def _effects(
    data: Dataset, given: Sequence[str] | None, fallback: Sequence[str], seed: int
) -> tuple[tuple[str, ...], str, Run | None]:
    """Effects that join the model, who says so, and the loop's own run where sensors err: no `identify` finds these."""
    if given is not None:
        return tuple(given), "given", None
    try:
        loop = rotorid.close_loop(data, seed=seed)
    except (ValueError, RuntimeError) as error:
        return tuple(fallback), f"given, for the closed loop failed ({type(error).__name__})", None
    line = summary(loop, {})
    effects = (*line["named"], *line["structure"], *line["group"][:1])
    source = f"{line['verdict']} of {' or '.join(line['group'])}" if line["group"] else line["verdict"]
    return effects, f"closed loop ({source})", loop if any(e.startswith("sensors.") for e in effects) else None


def table(lines: Sequence[dict]) -> str:
    """Quantities before and after, set by set."""
    rows = []
    for line in sorted(lines, key=lambda one: list(GIVEN).index(one["case"])):
        if "failed" in line:
            rows.append((line["case"], line["failed"], "", "", ""))
            continue
        who = f"{', '.join(line['effects']) or 'none'} ({line['source']})"
        for k, (name, before) in enumerate(line["before"].items()):
            rows.append(
                (*((line["case"], who) if k == 0 else ("", "")), name, _text(before), _text(line["after"][name]))
            )
    return markdown(("set", "effects (by)", "on unseen flights", "before", "after"), rows)


def _text(values: Sequence[float]) -> str:
    return "; ".join(f"{v:.3g}" if abs(v) >= 0.0995 else f"{v:.3f}" for v in values)


def study(args: Args, file: Path) -> dict:
    """Run the sets that are there and have no line yet; those that are not are named with the reason."""
    left, skipped = sets_left(args.data, args.sets, args.quick, file)
    own = args.given or args.quick
    calls = [
        (args.data / n, args.effects.get(n, ()) if own else None, args.effects.get(n, ()), args.seed) for n in left
    ]
    return {"runs": over_sets(run_set, calls, args.processes, file, asdict(args)), "skipped": skipped}


def main(args: Args) -> None:
    """Run the sets or write the table, and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "runs.jsonl"
    result = {} if args.report else study(args, file)
    lines = read_lines(file)
    if args.report:
        write_between(args.page, "measured effects", table(lines) if lines else "No runs yet.")
    print(json.dumps(result | {"sets": {one["case"]: one.get("after", one.get("failed")) for one in lines}}))


if __name__ == "__main__":
    main(tyro.cli(Args))
