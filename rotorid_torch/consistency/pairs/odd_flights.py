"""Flights whose sensors contradict each other while those of the other flights agree: another mounting, unit or clock.

In records of all flights together a few wrong ones are only noise.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.imu_place import exact_pairs
from rotorid_torch.consistency.outliers import SURE, large_shares, outliers
from rotorid_torch.consistency.pairs.alignment import alignment
from rotorid_torch.consistency.pairs.time_base import LEAST
from rotorid_torch.consistency.sensor_pairs import (
    LAGS,
    Pair,
    agreement,
    attitude_pairs,
    difference_by_lag,
    position_pairs,
)
from rotorid_torch.consistency.smoothing import kernel
from rotorid_torch.core.statistics import weighted_mean
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

LISTS = ("identify", "validate", "acid")
ABOVE = 25.0
"""Power of the difference over that of the sensors' noise, from which on it is none."""
COMMON = 0.5
"""Share of what half of the flights leave that a lag of all leaves at most."""
MOTION = {"rad/s": 0.1, "m/s²": 0.5, "m/s": 0.2}
"""Rms of the two sides from which on one axis of a flight shows anything."""
MOTION_OF_ALL = {"rad/s": 0.02, "m/s²": 0.2, "m/s": 0.2}
"""The same of all axes together: what is small on one axis is then no share of the motion."""
SAME = 0.6
"""R² of attitude and rates from which on their ratio is looked at."""


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
    intervals = {name: np.log(dataset.facts[name].dt) for name in ratios}
    sampled = outliers(intervals, lambda name, _: (intervals[name], 0.0), LEAST)
    apart = outliers(ratios, lambda name, _: ratios[name], LEAST)
    paces = dict[str, Pace]()
    for name, (away, se) in ratios.items():
        faster, close = -sampled.get(name, 0.0), max(SURE * se, LEAST)
        if name in sampled and abs(away - faster) < min(close, 0.5 * abs(faster)):
            paces[name] = Pace(float(np.exp(away)), float(np.exp(faster)) * dataset.facts[name].dt)
        elif name in apart and abs(away) > close:
            paces[name] = Pace(float(np.exp(away)), 0.0)
    return paces


def _ratio(flight: Flight) -> tuple[float, float] | None:
    """Logarithm of the ratio of turns by attitude and by rates that axes share, its error; None where they differ."""
    results = [a for pair in attitude_pairs() if (a := agreement(pair, [flight])) and a.r2 > SAME and a.scale > 0.0]
    if not results:
        return None
    errors = [a.whole_scale_error for a in results]
    ratio, se = weighted_mean([a.scale for a in results], errors)
    alike = all(abs(a.scale - ratio) < SURE * error for a, error in zip(results, errors, strict=True))
    return (float(np.log(ratio)), se / ratio) if alike else None


@once
def odd_flights(dataset: Dataset) -> Mapping[str, tuple[str, ...]]:
    """Flights in which attitude and rates, or velocity and specific force, disagree; more flights agree in all.

    By flight the channels of the first comparison that disagrees: of all axes together, then of each.
    """
    wrong = dict[str, tuple[str, ...]]()
    differences = {flight.name: _differences(dataset, flight) for flight in dataset.flights.values()}
    for pairs, least in _comparisons(dataset):
        shares = {n: share for n, each in differences.items() if (share := _share(each, pairs, least)) is not None}
        if not shares:
            continue
        middle = np.median([left for left, _ in shares.values()], axis=0)
        best = int(np.argmin(middle))  # a lag of all flights is none of one
        lag = best if middle[best] < COMMON * middle[LAGS // 2] else LAGS // 2
        by = {n: float(left[lag]) if left[lag] > ABOVE * noise else 0.0 for n, (left, noise) in shares.items()}
        odd = large_shares(by, lambda name, _, by=by: (by[name], 0.0))
        channels = tuple(dict.fromkeys(c for pair in pairs for c in pair.channels))
        wrong = dict.fromkeys(odd, channels) | wrong
    return {name: ("time",) for name in other_paces(dataset)} | wrong


def _comparisons(dataset: Dataset) -> Iterator[tuple[tuple[Pair, ...], float]]:
    """Pairs that are compared together, and the rms from which on they show anything."""
    pairs = _pairs(dataset)
    for unit, least in MOTION_OF_ALL.items():
        if together := tuple(pair for pair in pairs if pair.unit == unit):
            yield together, least
    yield from (((pair,), MOTION[pair.unit]) for pair in pairs)


@dataclass(frozen=True)
class _Difference:
    """Mean squares of a pair in a flight: of left less right by lag, of both on average, and of noise of the first."""

    apart: np.ndarray
    power: float
    noise: float


def _differences(dataset: Dataset, flight: Flight) -> dict[str, _Difference]:
    """By the pair's left side; those pairs that the flight is long enough for."""
    bell, slope = kernel(flight.dt)
    differences = dict[str, _Difference]()
    for pair in _pairs(dataset):
        apart, power = difference_by_lag(pair, flight)
        noise = dataset.noise(pair.left_name) ** 2 * float((slope**2).sum())
        noise += max(dataset.noise(name) for name in pair.right_name.split()) ** 2 * float((bell**2).sum())
        if np.isfinite(power):
            differences[pair.left_name] = _Difference(apart, power, noise)
    return differences


def _share(each: Mapping[str, _Difference], pairs: Sequence[Pair], least: float) -> tuple[np.ndarray, float] | None:
    """Differences of the sides by lag, and that of noise, over their mean power; None where nothing moves."""
    some = [each[pair.left_name] for pair in pairs if pair.left_name in each]
    power = sum(d.power for d in some)
    if power < least**2:
        return None
    return np.sum([d.apart for d in some], axis=0) / power, sum(d.noise for d in some) / power


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
    each = (difference_by_lag(pair, f) for f in dataset.flights.values() for pair in _pairs(dataset))
    shares = [apart[LAGS // 2] / power for apart, power in each if np.isfinite(power) and power > 0.0]
    return float(np.mean(shares)) if shares else np.inf
