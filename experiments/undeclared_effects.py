"""Does the closed loop name what is hidden, and nothing else? The confusion table, and errors before and after.

Aircraft are drawn at random (mass, inertia, rotor, speed, augmentation, noise), each declared truthfully. On each of
them every effect that the flight-test aircraft can have is hidden in turn; then pairs, two causes that no library
holds, and nothing at all. The loop is closed blind: it gets a data set folder without truth. One JSON line per run;
runs that have a line are not repeated. `--report` adds the lines to those of earlier studies, which are kept beside
this file with the version of the code that they came of, and turns all of them into the tables of docs/closed-loop.md.

Clean-aircraft floors are cached by vehicle and manoeuvres: effects that share an aircraft and its flights share them.

Expected: of identifiable effects at typical size 85 % named with nothing false beside them; false alarms on at most 5 %
of the aircraft that hide nothing; absorbed effects silent, named, or in a group, misnamed in at most 5 %.
"""

from __future__ import annotations

import json
import math
import random
import tempfile
import time
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from drawn_aircraft import Drawn, Flown, draw, fly_drawn, groups_of
from hidden_truth import true_parameters
from loop_lines import failure, loop_line, read_lines, record_lines, told_line, version
from loop_runs import keep, lines_of
from loop_tables import undeclared_tables, write_between
from outside_causes import CAUSES
from torch.utils.tensorboard import SummaryWriter

import rotorid_torch as rotorid
from rotorid_torch.effects.base import Showing
from rotorid_torch.effects.registry import registered
from rotorid_torch.fly.effects import EFFECT_CLASSES, HIDDEN
from rotorid_torch.run.closing import Loop

QUICK = (
    *("control.delay", "control.lag", "control.rate_limit", "rotor.lead_lag", "forces.quadratic_damping"),
    *("environment.turbulence", "mass.payload", "mass.slung_load", "sensors.bias", "sensors.delay"),
)
PAGE = Path(__file__).parents[1] / "docs" / "closed-loop.md"
RECORD = Path(__file__).parent / "records" / "undeclared_effects.jsonl"


@dataclass
class Args:
    """Which runs the study has."""

    effects: tuple[str, ...] = ()
    """Effects and outside causes that are hidden, each on every aircraft; without them all."""
    size: float = 1.0
    """Factor of the typical size of what is hidden."""
    aircraft: int = 3
    """Aircraft that are drawn for the effects."""
    seeds: int = 1
    """Draws of noise and gusts for each effect and aircraft."""
    clean: int = 12
    """Runs in which nothing is hidden."""
    clean_aircraft: int = 3
    """Aircraft that these are spread over: the same ones, and further ones."""
    flights: tuple[str, ...] = ("all",)
    """Names or groups that are flown where nothing is hidden; effects bring what they need."""
    pairs: int = 6
    """Runs in which two effects are hidden, drawn from the identifiable ones."""
    told: bool = True
    """Fit also the model that is told what is hidden."""
    quick: bool = False
    """10 effects, 3 clean flights, one aircraft, one seed."""
    report: bool = False
    """Run nothing; add the lines to the record, and turn that into tables."""
    record: Path = RECORD
    """Lines of all studies."""
    page: Path = PAGE
    """Page that holds the tables, between its markers."""
    processes: int = 1
    """Runs at the same time."""
    seed: int = 0
    out: Path = Path("runs/undeclared_effects")
    """Lines (runs.jsonl), drawn aircraft and TensorBoard records."""


@dataclass(frozen=True)
class Case:
    """One run: what is hidden (nothing: none) at which size, on which aircraft, its flights, the seed of the noise."""

    hidden: tuple[str, ...]
    size: float
    aircraft: int
    flights: tuple[str, ...]
    noise_seed: int

    @property
    def key(self) -> str:
        """What makes the run another one."""
        hidden, flights = "+".join(self.hidden) or "nothing", ",".join(self.flights)
        return f"{hidden} x{self.size:g} aircraft {self.aircraft} flights {flights} seed {self.noise_seed}"


def cases(args: Args) -> list[Case]:
    """All runs of a study, in the order in which they are begun."""
    known = (*HIDDEN, *CAUSES)
    effects = args.effects or known
    for effect in effects:
        if effect not in known:
            raise SystemExit(f"there is no '{effect}' to hide; one of: {', '.join(known)}")
    made = [_case((), args, k % args.clean_aircraft, k // args.clean_aircraft) for k in range(args.clean)]
    made += [_case((e,), args, a, s) for a in range(args.aircraft) for s in range(args.seeds) for e in effects]
    identifiable = [e for e in effects if EFFECT_CLASSES.get(e) == "identifiable"]
    if len(identifiable) > 1:
        rng = np.random.default_rng([args.seed, args.aircraft])
        drawn = [rng.choice(identifiable, 2, replace=False) for _ in range(args.pairs)]
        made += [_case(tuple(map(str, pair)), args, k % args.aircraft, k) for k, pair in enumerate(drawn)]
    return made


def _case(hidden: tuple[str, ...], args: Args, aircraft: int, repeat: int) -> Case:
    """Runs with other things hidden have other noise."""
    seed = int(np.random.default_rng([args.seed, zlib.crc32("+".join(hidden).encode()), repeat]).integers(1_000_000))
    return Case(hidden, args.size if hidden else 0.0, aircraft, groups_of(hidden) if hidden else args.flights, seed)


def run_case(case: Case, drawn: Drawn, told: bool, seed: int) -> dict:
    """Fly, close the loop blind, and say what came of it."""
    torch.set_num_threads(1)
    began = time.perf_counter()
    line = {"case": case.key, "code": version(), "study": seed, **asdict(case), "drawn": _facts(drawn)}
    try:
        with tempfile.TemporaryDirectory() as folder:
            flown = fly_drawn(drawn, case.hidden, case.size, case.flights, case.noise_seed, Path(folder))
            data = rotorid.load(flown.write(Path(folder) / "flights"))
            loop = rotorid.close_loop(data, seed=seed)
            truth = true_parameters(flown.clean, case.hidden, case.size)
            line |= loop_line(loop, case.hidden, truth)
            if told and case.hidden:
                line |= told_line(*_told(loop, flown, case.hidden, Path(folder)), case.hidden)
    except (ValueError, RuntimeError) as error:
        line |= failure(error)
    return line | {"seconds": round(time.perf_counter() - began, 1)}


def _facts(drawn: Drawn) -> dict:
    vehicle = drawn.vehicle["vehicle"]
    told = {"mass": round(vehicle["mass"]), "blades": vehicle["rotor"]["blades"], "speed": drawn.speed}
    return told | {"augmentation": round(drawn.augmentation, 3), "noise": round(drawn.noise, 3)}


def _told(loop: Loop, flown: Flown, hidden: Sequence[str], folder: Path) -> tuple[rotorid.Run | None, str]:
    """The fit that was told what was hidden, or why there is none: the better one without or with the loop's structure.

    What sensors do wrong is told by taking it out of the records; gusts, vibration and outside causes have no such fit.
    """
    showing = {e: registered()[e].showing for e in hidden if e in registered()}
    if len(showing) < len(hidden) or Showing.INNOVATIONS in showing.values():
        return None, "there is no fit that knows this cause"
    structure = loop.tracing.structure if loop.tracing else ()
    acting = [e for e in hidden if showing[e] is not Showing.KINEMATICS]
    data = rotorid.load(flown.write(folder / "right", right=True))
    told = {tuple(acting), tuple(dict.fromkeys((*structure, *acting)))}
    try:
        runs = [rotorid.identify(data, effects=effects) for effects in sorted(told)]
    except rotorid.InputError as error:
        return None, str(error)
    return min(runs, key=lambda run: run.scores["validate"] or math.inf), ""


def to_run(args: Args, file: Path) -> list[list[Case]]:
    """Cases without a line: first those that find the floors of an aircraft and its flights, then the others."""
    done = {line["case"] for line in read_lines(file) if "failed" not in line}
    left = [case for case in dict.fromkeys(cases(args)) if case.key not in done]
    first = list({(case.aircraft, case.flights): case for case in reversed(left)}.values())
    return [first, [case for case in left if case not in first]]


def study(args: Args, file: Path) -> dict:
    """Run what has no line yet."""
    writer = SummaryWriter(str(args.out / "tensorboard"))
    writer.add_text("settings", json.dumps(asdict(args), default=str))
    batches, done = to_run(args, file), 0
    drawn = {n: draw(n, args.seed, args.out) for n in sorted({c.aircraft for b in batches for c in b})}
    for batch in batches:
        given = [(case, drawn[case.aircraft], args.told, args.seed) for case in batch]
        done += keep(lines_of(run_case, given, args.processes), file, len(batch), writer)
    writer.close()
    return {"runs": done}


def main(args: Args) -> None:
    """Run the study or write its tables, and end with one JSON line."""
    random.seed(args.seed)
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    if args.quick:
        args.effects = args.effects or QUICK
        args.aircraft = args.clean_aircraft = args.seeds = 1
        args.clean, args.pairs = min(args.clean, 3), 0
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "runs.jsonl"
    result = {} if args.report else study(args, file)
    lines = read_lines(file)
    tables, summary = undeclared_tables(record_lines(args.record, lines) if args.report else lines)
    if args.report:
        write_between(args.page, "undeclared effects", tables)
    print(json.dumps(result | summary))


if __name__ == "__main__":
    main(tyro.cli(Args))
