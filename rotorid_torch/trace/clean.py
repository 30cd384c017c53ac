"""Gains of candidates on clean drawn aircraft: flown, identified and screened as the data set was; cached one by one.

Draws are spread over ranks, and at each over processes of their own. What was found stays on disk by vehicle,
manoeuvres and model structure, so that the same vehicle's next data set finds its floors there.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core import cache
from rotorid_torch.core.atomic import TEMPORARY, Unwritable, atomic_file, scratch_folder
from rotorid_torch.core.children import child
from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.ranks import ALONE, Ranks
from rotorid_torch.data.dataset import Dataset, load
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.data.write import write_dataset
from rotorid_torch.effects.base import Frame, Values
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.gauss_newton import InfiniteCost
from rotorid_torch.identification.reconstruct import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.trace.candidates import of_control_path
from rotorid_torch.trace.decide import TIMES
from rotorid_torch.trace.fits import Flights, refit
from rotorid_torch.trace.floor import Floors, Null, flight_by_flight
from rotorid_torch.trace.forces import seen_in_forces
from rotorid_torch.trace.residual import left_over, scan
from rotorid_torch.trace.screen import Screen, both_screens

DRAWS = 24
"""Clean aircraft that are drawn: one of them may pass a floor that 5 % may pass."""
CHANCES = 4
"""Shuffled residuals of each: a candidate of which clean aircraft show nothing has the floor that chance gives."""
FEWEST = 20
"""Draws below which no quantile of 5 % is told."""
WIND, TURNING = "environment.wind", ("q", "r", "phi", "theta")
NO_ROOM = 2
"""Exit code of a process that finds no room for temporary files."""
WATCH_S = 0.5
"""s between two looks at the processes that draw, at each of which ranks tell each other that they are there."""
NO_FIT = (InfiniteCost, torch.linalg.LinAlgError)  # pyright: ignore[reportPrivateImportUsage]
"""How the identification of a drawn aircraft may fail; anything else is a fault of the code."""
SAME = ("flapping", "flapping_doubtful", "patterns", "inflow", "cyclic_inflow", "effects", "screening_sizes")
"""Structure that a drawn aircraft's model shares with the data's."""


def gains_on(clean: Dataset, null: Null, effects: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Gain of each effect on a clean aircraft's flights, its model having the structure of the null.

    Beside it what those that are looked for in forces explain there, the weight in each equation of what looks most
    like something unknown, by kind, and the sizes that delays and lags of the controls seem to have, which may be
    below nothing.
    """
    flown = at_one_rate(clean)
    reconstruction = reconstruct(flown)
    spec = propose(flown, reconstruction, ())
    spec = msgspec.structs.replace(spec, **{name: getattr(null.spec, name) for name in SAME})
    # an aircraft in the data's likeness lies near the data's values: from its own regression few fits find their end
    fitted = refit(spec, Flights(flown, reconstruction), null.values, null.held)
    screened, apart = both_screens(fitted, effects, shuffles=CHANCES)
    traces = scan(left_over(fitted.model, flown, reconstruction, flown.identify))
    path = of_control_path(effects)
    in_forces = seen_in_forces(fitted, (), effects, 0)
    return {
        "gains": _gains(screened, effects),
        "each_control": _gains(apart, path),
        "sizes": {n: v for s in (screened, apart) for e in path if e in TIMES for n, v in s.unbounded(e).items()},
        "forces": {e: one.gain for e, one in in_forces.items()},
        "traces": {key: t.weight for key, t in traces.items()},
        "evidence": {k: d.tolist() for k, d in flight_by_flight(screened, apart).items()},
    }


def _gains(screened: Screen, effects: Sequence[str]) -> dict[str, float]:
    """Gain of each effect, at least what chance gives."""
    return {e: max(screened.gain([e]), float(screened.by_chance(e).max())) for e in effects}


def clean_floors(
    dataset: Dataset,
    null: Null,
    effects: Sequence[str],
    seed: int = 0,
    say: Callable[[str], None] = lambda line: None,
    draws: int = DRAWS,
    ranks: Ranks = ALONE,
) -> Floors:
    """Gains of effects on clean aircraft drawn in the likeness of a data set, for models of the structure of a null.

    Where none can be drawn the note says why, and the data's own shuffled residual is all that floors are made of.
    ranks : processes that share the draws, each of which calls this; what the first one has cached counts for all.
    """
    from rotorid_torch.fly.drawn import undrawable

    why = undrawable(dataset)
    if why is not None:
        return Floors({}, f"floors come from shuffled residuals alone: no clean aircraft can be drawn, {why}")
    key = f"floors/{_fingerprint(dataset, null, effects, seed)}"
    drawn = ranks.from_first(_read(key, range(draws)))
    missing = [n for n in range(draws) if n not in drawn]
    if missing:
        say(f"floors: {len(missing)} of {draws} clean aircraft to be flown and identified; they are kept for next time")
        mine = _fly(dataset, null, effects, seed, ranks.mine(missing), key, ranks)
        for part in ranks.gather(mine):
            drawn |= part
        for number in drawn.keys() & set(missing) - mine.keys() if ranks.first else ():
            _keep(key, number, drawn[number])
    flown = [drawn[n] for n in range(draws) if n in drawn and set(drawn[n]["gains"]) >= set(effects)]
    alike = [draw for draw in flown if draw["alike"]]
    chosen, note = alike, f"floors come from {len(alike)} clean aircraft drawn in the likeness of this one"
    if len(alike) < FEWEST:  # those that come nearest are other aircraft of the kind, and as clean
        few = f"only {len(alike)} of {draws} drawn aircraft resemble the data"
        chosen = sorted(flown, key=lambda draw: draw["misfit"])[:FEWEST]
        note = f"{few}: floors come from the {len(chosen)} that come nearest"
    if len(chosen) < FEWEST:
        for number in [n for n, draw in drawn.items() if draw not in flown] if ranks.first else ():
            cache.discard(_name(key, number))  # what cannot follow these records may follow the next ones
        flew = f"{len(chosen)} of {draws} drawn aircraft could be flown"
        return Floors({}, f"floors come from shuffled residuals alone: {flew}")
    tables = (_table(chosen, kind) for kind in ("gains", "traces", "forces", "each_control", "sizes", "evidence"))
    gains, *others = tables
    return Floors(gains, note, *others)


def _table(draws: Sequence[Mapping[str, Any]], kind: str) -> dict[str, Tensor]:
    """One kind of number of all draws [D, ...], by its key."""
    return {key: torch.tensor([draw[kind][key] for draw in draws], dtype=torch.float64) for key in draws[0][kind]}


def _name(key: str, number: int) -> str:
    return f"{key}/{number}.json"


def _read(key: str, numbers: Iterable[int]) -> dict[int, Any]:
    """What the cache holds of these draws."""
    contents = {number: cache.read(_name(key, number)) for number in numbers}
    return {number: json.loads(content) for number, content in contents.items() if content is not None}


def _keep(key: str, number: int, draw: Mapping[str, Any]) -> None:
    cache.keep(_name(key, number), json.dumps(draw).encode())


def _fingerprint(dataset: Dataset, null: Null, effects: Sequence[str], seed: int) -> str:
    """What the draws depend on: vehicle, manoeuvres (in coarse steps of their size), model structure, the code.

    The null's values are left out: fits only start there.
    """
    spec = null.spec
    facts = {name: dataset.facts[name] for name in dataset.flights}
    scales = dataset.scales()
    facts_of_draws = {
        "seed": seed,
        "kind": dataset.kind,
        "vehicle": msgspec.to_builtins(dataset.vehicle),
        "lists": [dataset.identify, dataset.validate, dataset.acid],
        "flights": {name: [f.samples, round(f.dt, 6), _speed(dataset, name)] for name, f in facts.items()},
        "noise": {c: f"{dataset.noise(c):.1g}" for c in spec.outputs},
        "controls": {c: round(math.log2(max(scales[c], 1e-9))) for c in dataset.controls},
        "reference": {c: round(0.5 * spec.reference.get(c, 0.0)) for c in ("u", "v", "w")},
        "structure": {name: msgspec.to_builtins(getattr(spec, name)) for name in SAME},
        "held": sorted(null.held),
        "wind": {n: round(v) for n, v in null.values.items() if n.startswith(f"{WIND}.")},
        "effects": list(effects),
        "code": _code(),
    }
    return hashlib.sha256(json.dumps(facts_of_draws, sort_keys=True).encode()).hexdigest()[:24]


def _speed(dataset: Dataset, name: str) -> list[int]:
    """Velocity that a flight starts with, in coarse steps: clean aircraft are trimmed there. Zero where unmeasured."""
    flight = dataset.flights[name]
    start = flight.bridged(VELOCITIES)[flight.lead()].mean(dim=0).nan_to_num(0.0)
    return [round(0.5 * float(v)) for v in start]


def _code(package: Path = Path(__file__).parents[1]) -> str:
    """Digest of the whole package, and of the files of effects that others have registered."""
    modules = (sys.modules.get(effect.__module__) for effect in registered().values())
    others = {Path(m.__file__) for m in modules if m is not None and m.__file__}
    files = {f for f in package.rglob("*") if f.suffix in (".py", ".h", ".toml")}
    digest = hashlib.sha256()
    for file in sorted(files | others):
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _fly(
    dataset: Dataset,
    null: Null,
    effects: Sequence[str],
    seed: int,
    numbers: Sequence[int],
    key: str,
    ranks: Ranks,
) -> dict[int, Any]:
    """The draws in as many processes as there are processors for this one, each kept as soon as it is made.

    Ends when all ranks' processes have ended.

    Raises
    ------
    Unwritable : one of them has found no room for temporary files.
    RuntimeError : one of them has failed; with the last line of what it said.
    """
    count = min(threads(), len(numbers))
    drawn: dict[int, Any] = {}
    with scratch_folder() as place, ExitStack() as stack:
        likeness, results = place / "likeness", place / "draws"
        _written(dataset, null, likeness)
        results.mkdir()
        request = {
            "dataset": str(likeness),
            "spec": null.spec.plain(),
            "values": dict(null.values),
            "held": list(null.held),
            "effects": list(effects),
            "seed": seed,
            "folder": str(results),
        }
        files = [place / f"request-{k}.json" for k in range(count)]
        for k, file in enumerate(files):
            file.write_text(json.dumps({**request, "numbers": list(numbers[k::count])}))
        workers = [stack.enter_context(_worker(file)) for file in files]
        at_work = True
        while at_work:
            at_work = any(ranks.gather(any(worker.poll() is None for worker in workers)))
            for number in {int(file.stem) for file in results.glob("*.json")} - drawn.keys():
                drawn[number] = json.loads((results / f"{number}.json").read_text())
                _keep(key, number, drawn[number])
            time.sleep(WATCH_S if at_work else 0.0)
        for worker, file in zip(workers, files, strict=True):
            _refuse_failure(worker.returncode, file)
    return drawn


@contextmanager
def _worker(request: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that makes the draws of a request by this very package, whatever the working folder holds."""
    root = str(Path(__file__).parents[2])
    places = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    alone = {"OMP_NUM_THREADS": "1", "ROTORID_THREADS": "1", "PYTHONPATH": places, "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "rotorid_torch.trace.clean", str(request)]
    with request.with_suffix(".log").open("w") as log, child(command, env=os.environ | alone, stderr=log) as worker:
        yield worker


def _refuse_failure(code: int, request: Path) -> None:
    """Raise what a worker's exit code says, with the last line of its log."""
    if code == NO_ROOM:
        raise Unwritable(request.parents[1], "", "cannot be written to", TEMPORARY)
    if code:
        lines = request.with_suffix(".log").read_text().splitlines() or [f"code {code}"]
        raise RuntimeError(f"a process that identifies clean aircraft has failed: {lines[-1]}")


def _through_air(flight: Flight, null: Null) -> dict[str, Tensor]:
    """Velocities of a flight through the air of the wind that the null's values tell; nothing where they tell none."""
    told = {n.removeprefix(f"{WIND}."): v for n, v in null.values.items() if n.startswith(f"{WIND}.")}
    if not told or not flight.has("psi", *TURNING, *VELOCITIES):
        return {}
    values = Values(torch.tensor(list(told.values()), dtype=torch.float64), tuple(told))
    signals = dict(zip(("psi", *TURNING), flight.bridged(("psi", *TURNING)).unbind(-1), strict=True))
    frame = Frame(signals | {n: flight.channels[n] for n in VELOCITIES})
    through, _ = registered()[WIND].from_spec(null.spec)(frame, signals["psi"].unsqueeze(-1), values)
    return {n: through.signals[n] for n in VELOCITIES}


def _written(dataset: Dataset, null: Null, place: Path) -> None:
    """The flights that drawn aircraft resemble, in still air: it is the motion through the air that they repeat."""
    flights = {
        name: {c: v.numpy() for c, v in {"time": f.time, **f.channels, **_through_air(f, null)}.items()}
        for name, f in dataset.flights.items()
    }
    write_dataset(
        place,
        flights,
        identify=dataset.identify,
        validate=dataset.validate,
        acid=dataset.acid,
        name=dataset.name,
        kind=dataset.kind,
        description=dataset.description,
        vehicle=dataset.vehicle,
        controls=dataset.control_specs,
        channels=dataset.channel_specs,
        model=dataset.settings,
    )


def _work(request: Mapping[str, object]) -> None:
    """Draws of one process: one file for each, whole or absent."""
    from rotorid_torch.fly.drawn import Untrimmable, clean_flights

    dataset, folder = load(str(request["dataset"])), Path(str(request["folder"]))
    values, held = msgspec.convert(request["values"], dict[str, float]), msgspec.convert(request["held"], list[str])
    null = Null(ModelSpec.from_plain(request["spec"]), values, held)
    effects = msgspec.convert(request["effects"], list[str])
    numbers = msgspec.convert(request["numbers"], list[int])

    def write(number: int, draw: Mapping[str, Any]) -> None:
        with atomic_file(folder / f"{number}.json") as file:
            file.write_text(json.dumps(draw))

    with suppress(Untrimmable):  # none flies
        for drawn in clean_flights(dataset, msgspec.convert(request["seed"], int), tuple(numbers)):
            numbers.remove(drawn.number)
            with suppress(*NO_FIT):  # from here; the next data set of the vehicle starts elsewhere
                likeness = {"alike": drawn.alike, "misfit": drawn.misfit, "rotor": drawn.rotor}
                write(drawn.number, gains_on(drawn.dataset, null, effects) | likeness)
    for number in numbers:  # aircraft that flew away are not flown again next time
        write(number, {"gains": {}, "alike": False})


if __name__ == "__main__":
    torch.set_num_threads(1)
    try:
        _work(json.loads(Path(sys.argv[1]).read_text()))
    except Unwritable:
        sys.exit(NO_ROOM)
