"""Statistics of candidates on clean drawn aircraft: flown, identified and scored as the data set was; kept one by one.

Draws are spread over ranks, and at each over processes of their own. They stop when the answer is clear. Statistics
stay on disk by vehicle, manoeuvres and model structure, so that the same vehicle's next data set finds them there.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import InfiniteCost
from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.processes.pool import NO_ROOM, results
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.core.storage import cache
from rotorid_torch.core.storage.atomic import Unwritable, atomic_file, scratch_folder
from rotorid_torch.data.dataset import Dataset, load
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.one_rate import at_one_rate
from rotorid_torch.data.write import declared_by, write_dataset
from rotorid_torch.effects.base import Frame, Values
from rotorid_torch.effects.families.environment import Wind
from rotorid_torch.effects.registry import of_scripts, registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.reconstruct.reconstruction import reconstruct
from rotorid_torch.identification.structure import propose
from rotorid_torch.model.gusts import GUSTS
from rotorid_torch.trace.air import in_moving_air
from rotorid_torch.trace.evidence.critical_values import Draws, Null
from rotorid_torch.trace.evidence.family import Family, family
from rotorid_torch.trace.evidence.fits import FittedT, Flights, refit
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.terms.settings import SETTINGS

if TYPE_CHECKING:
    from rotorid_torch.simulation.drawn.data_sets import Drawn

MULTIROTOR = "multirotor"
"""Kind of vehicle whose model is scored by accelerations at measured states."""
SPARE = 5
"""Clean aircraft that are drawn beside those needed: some fly away, and are no draws."""
NUMBERS = range(SETTINGS.draws + SPARE)
"""Of all draws."""
WIND, TURNING = Wind.id, ("q", "r", "phi", "theta")
DRAWS = "draws"
"""Folder of the draws."""
NO_FIT = (InfiniteCost, torch.linalg.LinAlgError)  # pyright: ignore[reportPrivateImportUsage]
"""How the identification of a drawn aircraft may fail; anything else is a fault of the code."""
SAME = ("flapping", "flapping_doubtful", "patterns", "inflow", "cyclic_inflow", "effects", "screening_sizes")
"""Structure that a drawn aircraft's model shares with the data's."""


def statistics_on(clean: Dataset, null: Null, effects: Sequence[str]) -> dict[str, dict[str, float]]:
    """Statistics of the family of effects on a clean aircraft's flights, its model having the structure of the null.

    Beside them the sizes that effects seem to have there, whatever their bounds.
    """
    flown = at_one_rate(clean)
    reconstruction = reconstruct(flown)
    spec = propose(flown, reconstruction, ())
    spec = msgspec.structs.replace(spec, **{name: getattr(null.spec, name) for name in SAME})
    flights = Flights(flown, reconstruction)
    if spec.motors:
        candidates = _at_states(spec, flights, null, effects)
    else:
        if null.weather is not None:
            spec, flights = in_moving_air(spec, null.values, flights, null.weather)
        # an aircraft in the data's likeness lies near the data's values; few fits from its own regression converge
        candidates = family(refit(spec, flights, null.values, null.held), effects)
    return {"statistics": candidates.statistics, "sizes": candidates.sizes()}


def _at_states(spec: ModelSpec, flights: Flights, null: Null, effects: Sequence[str]) -> Family[FittedAtStates]:
    """The family beside the model of a drawn multirotor; beside effects that joined, as `Search.back` tests one."""
    scored, joined = MeasuredAccelerations(flights), null.joined
    sizes = {f"{effect}.{n}": v for effect, values in null.sizes.items() for n, v in values.items()}
    model = scored.fitted(msgspec.structs.replace(spec, values=sizes))
    if joined.candidate:
        whole = scored.refitted(model.spec.with_effects(joined.candidate), model)
        model = dataclasses.replace(model, origin=whole)
    return scored.family(model, effects, joined.effects)


@dataclass(frozen=True, eq=False)
class Request:
    """What is drawn: clean aircraft in the likeness of a data set, for models of the structure of a null, and effects.

    seed : of the draws. say : hears of their progress, a line at a time. ranks : processes that share the draws, each
    of which asks for them; what the first one has cached counts for all.
    """

    dataset: Dataset
    null: Null
    effects: Sequence[str]
    seed: int = 0
    say: Callable[[str], None] = lambda line: None
    ranks: Ranks = ALONE


def clean_draws(request: Request, observed: Family[FittedT]) -> Draws | str:
    """Statistics of effects on clean aircraft; or, in words, why none can be drawn.

    observed : the data's statistics; draws stop when they are clearly no larger than those of clean aircraft.
    """
    alone = [e for e in of_scripts() if e in (*request.effects, *request.null.spec.effects)]
    if alone:
        return f"{alone[0]} is an effect of a script, which the processes that fly clean aircraft do not know"
    only = request.null.joined.candidate
    key = f"draws/{_fingerprint(request.dataset, request.null, request.seed)}"
    cached = request.ranks.from_first(_read(key, NUMBERS))
    drawn = {number: draw for number, draw in cached.items() if set(request.effects) <= set(draw["effects"])}
    if _chosen(drawn, observed, only) is None:
        why = _undrawable(request.dataset)
        if why is not None:
            return why
        missing = [n for n in NUMBERS if n not in drawn]
        joined = request.null.joined.effects
        nothing = f"with {' and '.join(joined)} and nothing else missing" if joined else "with nothing missing"
        clean = f"at most {SETTINGS.draws} clean aircraft like this one, {nothing},"
        request.say(f"{clean} are flown and identified: what they show is chance; they are kept for next time")
        drawn |= _fly(request, missing, key, lambda new: _chosen({**drawn, **new}, observed, only))
    flown = _chosen(drawn, observed, only) or []
    if len(flown) < min(SETTINGS.draws, len(drawn)) and not _clear(flown, observed, only):
        for number in [n for n, draw in drawn.items() if not draw["statistics"]] if request.ranks.first else ():
            cache.discard(_name(key, number))  # what cannot follow these records may follow the next ones
        return f"{len(flown)} of {len(drawn)} drawn aircraft could be flown"
    note, sizes = _note(request.null, flown), _table(flown, "sizes")
    return Draws(_table(flown, "statistics"), note, clean=True, least=observed.least, sizes=sizes)


def _chosen(draws: Mapping[int, Any], observed: Family[FittedT], only: str) -> list[Mapping[str, Any]] | None:
    """The first draws with which the search may stop; None where more are needed.

    only : the effect whose p is asked for, if not that of all.
    """
    flown: list[Mapping[str, Any]] = []
    for number in NUMBERS:
        if number not in draws:
            return None
        if draws[number]["statistics"]:
            flown.append(draws[number])
            if len(flown) == SETTINGS.draws or _clear(flown, observed, only):
                return flown
    return flown


def _clear(flown: Sequence[Mapping[str, Any]], observed: Family[FittedT], only: str) -> bool:
    """Whether further draws can make no p small."""
    return Draws(_table(flown, "statistics"), least=observed.least).clear(observed.contest, only)


def _note(null: Null, flown: Sequence[Mapping[str, Any]]) -> str:
    """What was drawn, for the report."""
    alike = sum(bool(draw["alike"]) for draw in flown)
    note = f"critical values come from {len(flown)} clean aircraft drawn in the likeness of this one"
    if null.joined.effects:
        note = f"{note}, with {' and '.join(null.joined.effects)}"
    if null.weather is not None:
        note = f"{note}, in gusts of the intensity and length that this one met"
    if alike < len(flown):
        resemble = "resembles" if alike == 1 else "resemble"
        note = f"{note}, of which {alike} {resemble} it and the others are as near as the drawn aircraft come"
    return note


def _undrawable(dataset: Dataset) -> str | None:
    """Why no clean vehicle can be drawn for a data set, in words; None where they can."""
    from rotorid_torch.simulation.drawn.data_sets import undrawable
    from rotorid_torch.simulation.drawn.multirotors import undrawable_multirotor

    return undrawable_multirotor(dataset) if dataset.kind == MULTIROTOR else undrawable(dataset)


def _drawn(dataset: Dataset, seed: int, numbers: Sequence[int], null: Null) -> Iterator[Drawn]:
    """Clean vehicles in a data set's likeness; helicopters in the null's weather, multirotors with what joined it."""
    from rotorid_torch.simulation.drawn.data_sets import clean_flights
    from rotorid_torch.simulation.drawn.multirotors import clean_multirotors
    from rotorid_torch.simulation.helicopter.atmosphere import Air

    if dataset.kind == MULTIROTOR:
        return clean_multirotors(dataset, seed, numbers, null.sizes)
    weather = null.weather
    air = None if weather is None else Air(weather.intensity, weather.length, weather.speed)
    return clean_flights(dataset, seed, numbers, air=air)


def _table(draws: Sequence[Mapping[str, Any]], kind: str) -> dict[str, Tensor]:
    """One kind of number of all draws [D], by its key."""
    first = draws[0][kind] if draws else {}
    return {key: torch.tensor([draw[kind].get(key, 0.0) for draw in draws], dtype=torch.float64) for key in first}


def _name(key: str, number: int) -> str:
    return f"{key}/{number}.json"


def _read(key: str, numbers: Iterable[int]) -> dict[int, Any]:
    """What the cache holds of these draws."""
    contents = {number: cache.read(_name(key, number)) for number in numbers}
    return {number: json.loads(content) for number, content in contents.items() if content is not None}


def _fingerprint(dataset: Dataset, null: Null, seed: int) -> str:
    """What the draws depend on: vehicle, manoeuvres (in coarse steps of their size), model structure, the code.

    The null's values are left out: fits only start there. So are the effects: the statistic of one does not depend on
    the others, and a draw says which effects it has statistics of.
    """
    spec, weather = null.spec, null.weather
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
        "joined": [null.sizes, null.joined.candidate],
        "weather": [round(2.0 * math.log2(one)) for one in (*weather.intensity, *weather.length)] if weather else [],
        "wind": {n: round(v) for n, v in null.values.items() if n.startswith(f"{WIND}.")},
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
    request: Request, numbers: Sequence[int], key: str, enough: Callable[[Mapping[int, Any]], object]
) -> dict[int, Any]:
    """The draws in as many processes as there are processors, each kept as soon as it is made, until there are enough.

    Raises Unwritable, RuntimeError: as `results`.
    """
    ranks, drawn, began = request.ranks, dict[int, Any](), time.monotonic()
    if enough(drawn) is not None:
        return drawn
    with scratch_folder() as place:
        files = _tasks(request, ranks.mine(numbers), place)
        with closing(results("rotorid_torch.trace", files, place / DRAWS, ranks)) as coming:
            for new in filter(None, coming):
                draws = {int(number): draw for number, draw in new.items()}
                drawn |= draws
                for number, draw in draws.items() if ranks.first else ():
                    cache.keep(_name(key, number), json.dumps(draw).encode())
                if enough(drawn) is not None:
                    break
                left = (time.monotonic() - began) / len(drawn) * max(SETTINGS.draws - len(drawn), 0)
                done = min(len(drawn), SETTINGS.draws)
                request.say(f"clean aircraft {done} of at most {SETTINGS.draws}, {left:.0f} s to go at most")
    return drawn


class Task(msgspec.Struct, frozen=True):
    """What one process does: draws of these numbers in the likeness of a data set, into a folder."""

    dataset: str
    null: Null
    effects: list[str]
    seed: int
    numbers: list[int]
    folder: str


def _tasks(request: Request, numbers: Sequence[int], place: Path) -> list[Path]:
    """Files of what each process does; the flights, and a folder for the draws, lie beside them."""
    likeness, folder = place / "likeness", place / DRAWS
    _written(request.dataset, request.null, likeness)
    folder.mkdir()
    count = min(threads(), max(len(numbers), 1))
    files = [place / f"request-{k}.json" for k in range(count)]
    for k, file in enumerate(files):
        task = Task(str(likeness), request.null, [*request.effects], request.seed, list(numbers[k::count]), str(folder))
        file.write_text(json.dumps(msgspec.to_builtins(task)))
    return files


def _through_air(flight: Flight, null: Null) -> dict[str, Tensor]:
    """Velocities of a flight through the air of the wind that the null's values tell; nothing where they tell none.

    Nor where the drawn vehicles fly in that wind.
    """
    wind = {n.removeprefix(f"{WIND}."): v for n, v in null.values.items() if n.startswith(f"{WIND}.")}
    if not wind or WIND in null.joined.effects or not flight.has("psi", *TURNING, *VELOCITIES):
        return {}
    values = Values(torch.tensor(list(wind.values()), dtype=torch.float64), tuple(wind))
    signals = dict(zip(("psi", *TURNING), flight.bridged(("psi", *TURNING)).unbind(-1), strict=True))
    frame = Frame(signals | {n: flight.channels[n] for n in VELOCITIES})
    through, _ = registered()[WIND].from_spec(null.spec)(frame, signals["psi"].unsqueeze(-1), values)
    return {n: through.signals[n] for n in VELOCITIES}


def _written(dataset: Dataset, null: Null, place: Path) -> None:
    """The flights that drawn aircraft resemble, in still air: it is the motion through the air that they repeat."""
    moving = {name: {"time": f.time, **f.channels, **_through_air(f, null)} for name, f in dataset.flights.items()}
    flights = {name: {c: v.numpy() for c, v in of.items() if c not in GUSTS} for name, of in moving.items()}
    write_dataset(place, flights, **declared_by(dataset))


def work(task: Task) -> None:
    """Draws of one process: one file for each, whole or absent."""
    from rotorid_torch.simulation.drawn.data_sets import Untrimmable

    numbers = [*task.numbers]

    def write(number: int, draw: Mapping[str, Any]) -> None:
        with atomic_file(Path(task.folder) / f"{number}.json") as file:
            file.write_text(json.dumps(draw))

    away = {"statistics": {}, "alike": False, "effects": task.effects}
    with suppress(Untrimmable):  # none flies
        for drawn in _drawn(load(task.dataset), task.seed, tuple(numbers), task.null):
            while numbers and numbers[0] < drawn.number:  # aircraft that flew away are not flown again next time
                write(numbers.pop(0), away)
            numbers.remove(drawn.number)
            try:
                statistics = statistics_on(drawn.dataset, task.null, task.effects)
            except NO_FIT:
                statistics = away
            write(drawn.number, away | statistics | {"alike": drawn.alike})
    for number in numbers:
        write(number, away)


def work_on(request: str) -> None:
    """What a process of its own does with the file of a request."""
    torch.set_num_threads(1)
    try:
        work(msgspec.convert(json.loads(Path(request).read_text()), Task))
    except Unwritable:
        sys.exit(NO_ROOM)
