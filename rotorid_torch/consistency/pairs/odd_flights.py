"""Flights whose sensors contradict each other while those of the other flights agree: another mounting, unit or clock.

In records of all flights together a few wrong ones are only noise.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.imu_place import exact_pairs
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.time_base import LEAST, SURE
from rotorid_torch.consistency.sensor_pairs import (
    Agreement,
    Pair,
    agreement,
    attitude_pairs,
    difference,
    position_pairs,
)
from rotorid_torch.consistency.smoothing import kernel
from rotorid_torch.core.statistics import student_quantile, weighted_mean
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

WRONG, RIGHT = 0.35, 0.1
"""Difference of two sides over their mean power, from and up to which a flight is odd, and is right."""
LISTS = ("identify", "validate", "acid")
APART = 4.0
"""Times the usual difference of the flights, from which on one is another kind."""
FEW = 2
"""Right flights for each odd one, at least: else what is wrong is wrong in all."""
ABOVE = 25.0
"""Power of the difference over that of the sensors' noise, from which on it is none."""
MOTION = {"rad/s": 0.1, "m/s²": 0.5, "m/s": 0.5}
"""Rms of the two sides from which on one axis of a flight shows anything."""
MOTION_OF_ALL = {"rad/s": 0.02, "m/s²": 0.2, "m/s": 0.2}
"""The same of all axes together: what is small on one axis is then no share of the motion."""
SAME = 0.6
"""R² of attitude and rates from which on their ratio is looked at."""
ENOUGH = 4
"""Flights from which on they tell how much their ratios differ."""


@dataclass(frozen=True)
class Pace:
    """How many times as fast as the body rates say the attitude of a flight turns, and as in the others it does not.

    usual_dt : interval of the other flights' samples, s, where this flight is sampled so many times as fast as they
    are; else 0.
    """

    ratio: float
    usual_dt: float


@once
def other_paces(dataset: Dataset) -> Mapping[str, Pace]:
    """Flights that turn faster or slower by the attitude than by the rates, each by itself and unlike the others."""
    ratios = {name: ratio for name, flight in dataset.flights.items() if (ratio := _ratio(flight))}
    logs = np.array([np.log(ratio) for ratio, _ in ratios.values()])
    usual = float(np.median(logs)) if len(logs) >= ENOUGH else 0.0
    # of normal errors the median deviation is 1/1.4826 of the standard deviation
    spread = 1.4826 * float(np.median(np.abs(logs - usual))) if len(logs) >= ENOUGH else np.inf
    paces = dict[str, Pace]()
    for name, (ratio, se) in ratios.items():
        dt = float(np.median([f.dt for n, f in dataset.facts.items() if n != name] or [dataset.facts[name].dt]))
        sampled, away = np.log(dt / dataset.facts[name].dt), np.log(ratio)
        close = max(SURE * se, LEAST)
        if abs(sampled) > LEAST and abs(away - sampled) < min(close, 0.5 * abs(sampled)):
            paces[name] = Pace(ratio, dt)
        elif min(abs(away - usual), abs(away)) > max(SURE * np.hypot(se, spread), LEAST):
            paces[name] = Pace(ratio, 0.0)
    return paces if FEW * len(paces) <= max(len(ratios) - len(paces), 0) else {}


def _ratio(flight: Flight) -> tuple[float, float] | None:
    """Ratio that all axes share of what a flight turns by attitude and by rates, its error; None where they differ."""
    results = [a for pair in attitude_pairs() if (a := agreement(pair, [flight])) and a.r2 > SAME and a.scale > 0.0]
    if not results:
        return None
    errors = [a.whole_scale_error for a in results]
    ratio, se = weighted_mean([a.scale for a in results], errors)
    alike = all(abs(a.scale - ratio) < SURE * error for a, error in zip(results, errors, strict=True))
    return (ratio, se / ratio) if alike else None


@once
def odd_flights(dataset: Dataset) -> Mapping[str, tuple[str, ...]]:
    """Flights in which attitude and rates, velocity and force, or position and velocity disagree; more agree in all.

    By flight the channels of the first comparison that disagrees: of all axes together, then of each.
    """
    if len(dataset.flights) <= FEW:  # none can be the odd one
        return {}
    wrong, shown, doubtful = dict[str, tuple[str, ...]](), set[str](), set[str]()
    differences = {flight.name: _differences(dataset, flight) for flight in dataset.flights.values()}
    for pairs, least in _comparisons(dataset):
        shares = {
            name: share for name, each in differences.items() if (share := _share(each, pairs, least)) is not None
        }
        usual = float(np.median(list(shares.values()))) if shares else 0.0
        channels = tuple(dict.fromkeys(c for pair in pairs for c in pair.channels))
        odd = (name for name, share in shares.items() if share > max(WRONG, APART * usual))
        wrong = wrong | {name: channels for name in odd if name not in wrong}
        shown |= set(shares)
        doubtful |= {name for name, share in shares.items() if share >= RIGHT}
    wrong = wrong if FEW * len(wrong) <= len(shown - doubtful) else {}
    return {name: ("time",) for name in other_paces(dataset)} | wrong


def odd_constant(a: Agreement) -> tuple[str, float]:
    """Piece of a pair whose constant is not that of the others by chance, and by how much; 0 where there is none.

    By the t of the farthest of several values, which is left out of the mean and spread that it is compared with.
    """
    values = np.array([*a.biases.values()])
    if len(values) < ENOUGH:
        return "", 0.0
    k = int(np.argmax(np.abs(values - np.median(values))))
    others = np.delete(values, k)
    size, spread = values[k] - others.mean(), others.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(others))
    odd = abs(size) > student_quantile(SURE, len(others) - 1) * spread
    return (list(a.biases)[k], float(size)) if odd else ("", 0.0)


def _comparisons(dataset: Dataset) -> Iterator[tuple[tuple[Pair, ...], float]]:
    """Pairs that are compared together, and the rms from which on they show anything."""
    pairs = _pairs(dataset)
    for unit, least in MOTION_OF_ALL.items():
        if together := tuple(pair for pair in pairs if pair.unit == unit):
            yield together, least
    yield from (((pair,), MOTION[pair.unit]) for pair in pairs)


@dataclass(frozen=True)
class _Difference:
    """Mean squares of a pair in a flight: of left less right, of both on average, of what noise makes of the first."""

    apart: float
    power: float
    noise: float


def _differences(dataset: Dataset, flight: Flight) -> dict[str, _Difference]:
    """By the pair's left side; those pairs that the flight is long enough for."""
    bell, slope = kernel(flight.dt)
    differences = dict[str, _Difference]()
    for pair in _pairs(dataset):
        apart, power = difference(pair, flight)
        noise = dataset.noise(pair.left_name) ** 2 * float((slope**2).sum())
        noise += max(dataset.noise(name) for name in pair.right_name.split()) ** 2 * float((bell**2).sum())
        if np.isfinite(power):
            differences[pair.left_name] = _Difference(apart, power, noise)
    return differences


def _share(each: Mapping[str, _Difference], pairs: Sequence[Pair], least: float) -> float | None:
    """Difference of the sides over their mean power; 0 where noise may make it, None where nothing moves."""
    some = [each[pair.left_name] for pair in pairs if pair.left_name in each]
    apart, power = sum(d.apart for d in some), sum(d.power for d in some)
    if power < least**2:
        return None
    return apart / power if apart > ABOVE * sum(d.noise for d in some) else 0.0


def with_only(dataset: Dataset, names: Collection[str]) -> Dataset:
    """The data set with these flights only; as identify flights where none of the list is among them."""
    flights = {name: flight for name, flight in dataset.flights.items() if name in names}
    lists = {word: tuple(n for n in getattr(dataset, word) if n in flights) for word in LISTS}
    if not lists["identify"]:
        lists = {"identify": tuple(flights), "validate": (), "acid": ()}
    facts = {name: dataset.facts[name] for name in flights}
    return replace(dataset, flights=MappingProxyType(flights), facts=MappingProxyType(facts), **lists)


def without_odd_flights(dataset: Dataset) -> Dataset:
    """The data set without them; itself where there are none, or where one error of all flights explains more."""
    odd = odd_flights(dataset)
    others = with_only(dataset, [name for name in dataset.flights if name not in odd]) if odd else dataset
    errors = alignment(dataset).errors if odd else {}
    in_all = bool(errors) and disagreement(without_errors(dataset, errors)) < disagreement(others)
    return dataset if in_all else others


def _pairs(dataset: Dataset) -> tuple[Pair, ...]:
    return (*exact_pairs(dataset), *position_pairs())


def disagreement(dataset: Dataset) -> float:
    """Mean difference of two sides over their mean power, of all pairs and flights."""
    each = (difference(pair, f) for f in dataset.flights.values() for pair in _pairs(dataset) if f.has(*pair.channels))
    shares = [apart / power for apart, power in each if np.isfinite(power) and power > 0.0]
    return float(np.mean(shares)) if shares else np.inf
