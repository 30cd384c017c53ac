"""Clean data sets of drawn helicopters: the same manoeuvres, channels and noise as a data set, and nothing undeclared.

What a tracing method finds on them is what it finds where there is nothing: its floor for this kind of vehicle and
these manoeuvres. Every drawn aircraft (see `draws`) gets the recorded controls about its own trim, and in
addition whatever keeps it near the measured motion.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.core.names import SPECIFIC_FORCES
from rotorid_torch.data import Dataset
from rotorid_torch.data.schema import Vehicle
from rotorid_torch.data.velocities.dead_reckoning import TILT
from rotorid_torch.data.velocities.source import with_velocities
from rotorid_torch.data.write import declared_by
from rotorid_torch.errors import InputError
from rotorid_torch.simulation.drawn.draws import ALIKE, DrawnAircraft, Prior, draw, finish, prior
from rotorid_torch.simulation.drawn.resemblance import Evidence, look, mirrored, recorded
from rotorid_torch.simulation.drawn.resemblance import reference as trim_of
from rotorid_torch.simulation.drawn.tracking import Followed, Tapes, follow, tapes
from rotorid_torch.simulation.flight.sensors import MIRRORED, Channels
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES
from rotorid_torch.simulation.helicopter.atmosphere import Air, gusts_of
from rotorid_torch.simulation.multiblade.priors import KINDS
from rotorid_torch.simulation.rigid import Array

TRIES = 6  # aircraft drawn for one number, at most
TOGETHER = 1_300_000  # samples of all flights that fly side by side
AWAY = 1.0  # rms of the difference from the measured motion over its own, from which on an aircraft has flown away

AWAY_IN_GUSTS = 2.0  # the same, where gusts of either move them apart, each by up to the motion's own


class Untrimmable(InputError):
    """No drawn aircraft can be trimmed where the data set flies."""


@dataclass(frozen=True)
class Drawn:
    """One drawn aircraft's flights; `alike`: whether it resembles the data set, or comes nearest of those tried."""

    number: int
    dataset: Dataset
    alike: bool


def undrawable(dataset: Dataset) -> str | None:
    """Why no clean aircraft can be drawn for a data set, in words; None where they can."""
    recorded = set(dataset.controls)
    if dataset.kind != "helicopter":
        return f"aircraft are drawn for helicopters, not for a {dataset.kind}"
    missing = [name for name in CONTROL_NAMES if name not in recorded]
    if missing:
        return f"the controls lack {', '.join(missing)}"
    channels = ("u", "v", "w", "p", "q", "r", "phi", "theta")
    flights = dataset.facts.values()
    lacking = frozenset[str]() if dataset.dead_reckoned else dataset.derived
    missing = [name for name in channels if name in lacking or any(not facts.has(name) for facts in flights)]
    return f"flights lack {', '.join(missing)}" if missing else None


def clean_flights(dataset: Dataset, seed: int, draws: Sequence[int], air: Air | None = None) -> Iterator[Drawn]:
    """Clean aircraft of the data set's kind, flown through its manoeuvres, one data set in memory per draw number.

    Every number has random streams of its own: neither the other numbers nor their order change what it gives. One
    whose aircraft does not stay near the measured motion is left out.
    Controls are the recorded ones about the drawn aircraft's trim, with a feedback of its deviation from the measured
    motion; what controller and pilot did is in the recorded controls, so they go with the motion as they did in flight.

    air : gusts that they fly in, each draw and flight in its own; still air without.

    Raises InputError: `undrawable`. Untrimmable : no drawn aircraft can be trimmed where the data set flies.
    """
    why = undrawable(dataset)
    if why is not None:
        raise InputError(dataset.path or "arrays", "vehicle", why, "a helicopter with four controls")
    evidence = look(dataset)
    return _flown(dataset, seed, tuple(draws), prior(dataset, evidence), evidence, air)


def _flown(
    dataset: Dataset, seed: int, draws: Sequence[int], prior: Prior, evidence: Evidence, air: Air | None
) -> Iterator[Drawn]:
    """The draws in batches."""
    flights = [recorded(dataset, name) for name in dataset.flights]
    tape = tapes(flights, trim_of(dataset))
    size = max(1, TOGETHER // int(tape.samples.max() * len(flights)))
    for first in range(0, len(draws), size):
        some = draws[first : first + size]
        aircraft = _aircraft(dataset, seed, some, prior, evidence)
        record = follow(aircraft, tape, prior, _gusts(dataset, tape, [[seed, number] for number in some], air))
        away = record.away(tape)
        for k, number in enumerate(some):
            if away[k] > (AWAY if air is None else AWAY_IN_GUSTS):
                continue
            measured = _measured(dataset, record, k, [seed, number])
            clean = with_velocities(in_memory(dataset, measured, number, dataset.vehicle))
            yield Drawn(number, clean, bool(aircraft.misfit[k] <= ALIKE))


def _gusts(dataset: Dataset, tape: Tapes, streams: Sequence[Sequence[int]], air: Air | None) -> Array | None:
    """Gusts of every aircraft and flight [T, 3, aircraft, flight]."""
    if air is None:
        return None
    steps, names = len(tape.controls) - 1, list(dataset.flights)
    each = [[gusts_of(air, dt, steps, n, s) for n, dt in zip(names, tape.dt, strict=True)] for s in streams]
    return np.moveaxis(np.array(each), (3, 2), (0, 1))


def _aircraft(dataset: Dataset, seed: int, draws: Sequence[int], prior: Prior, evidence: Evidence) -> DrawnAircraft:
    """An aircraft for every number, drawn again where it does not resemble the data."""
    # Every number goes through the kinds of rotor in an order of its own until one of them suits.
    orders = [np.random.default_rng([seed, number]).permutation(len(KINDS)) for number in draws]
    kind = KINDS[[order[0] for order in orders]]
    normal, misfit = np.empty((len(draws), len(prior.numbers))), np.full(len(draws), np.inf)
    for attempt in range(TRIES):
        again = [k for k in range(len(draws)) if misfit[k] > ALIKE]
        if not again:
            break
        kinds = KINDS[[orders[k][attempt % len(KINDS)] for k in again]]
        other = draw(prior, evidence, kinds, [np.random.default_rng([seed, draws[k], attempt]) for k in again])
        nearer = np.flatnonzero(other.misfit < misfit[again])
        places = np.array(again, dtype=np.intp)[nearer]
        normal[places], misfit[places], kind[places] = other.normal[nearer], other.misfit[nearer], other.kind[nearer]
    if not np.isfinite(misfit).all():
        what = "no drawn helicopter can be trimmed, with a rotor speed that settles, where the data set flies"
        raise Untrimmable(dataset.path or "arrays", "vehicle", what, "mass, rotor and speed of one helicopter")
    return finish(prior, evidence, normal, kind)


def _measured(dataset: Dataset, record: Followed, k: int, streams: Sequence[int]) -> dict[str, Channels]:
    """Channels of all flights of one aircraft with the data set's noise and gaps, to float32's digits (time exact)."""
    out: dict[str, Channels] = {}
    flip = MIRRORED if mirrored(dataset) else ()
    for j, (name, flight) in enumerate(dataset.flights.items()):
        out[name] = {"time": flight.time.numpy()}
        for channel, values in record.channels(k, j).items():
            if channel not in flight.channels or channel in dataset.derived:
                continue
            stream = np.random.default_rng([*streams, zlib.crc32(f"{name}/{channel}".encode())])
            read = values + dataset.noise(channel) * stream.standard_normal(flight.samples)
            if dataset.dead_reckoned and channel in SPECIFIC_FORCES:
                read += dataset.vehicle.gravity * TILT * stream.standard_normal()  # else no drawn aircraft would drift
            read = np.where(flight.channels[channel].isnan().numpy(), np.nan, read)
            out[name][channel] = (-read if channel in flip else read).astype(np.float32).astype(np.float64)
    return out


def in_memory(dataset: Dataset, flights: Mapping[str, Mapping[str, Array]], number: int, vehicle: Vehicle) -> Dataset:
    """Flights of a clean vehicle in the likeness of a data set, declared as the original but for the vehicle."""
    recorded = {channel for channels in flights.values() for channel in channels}
    description = f"Clean {dataset.kind} drawn in the likeness of {dataset.name}. Nothing undeclared."
    other = {"name": f"{dataset.name}-clean-{number}", "description": description, "vehicle": vehicle}
    other["channels"] = {name: spec for name, spec in dataset.channel_specs.items() if name in recorded}
    return Dataset.from_arrays(flights, **declared_by(dataset) | other)
