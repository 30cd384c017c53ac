"""Flights whose sensors contradict each other while those of the other flights agree: another mounting, unit or clock.

In records of all flights together a few wrong ones are only noise.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from rotorid_torch.consistency.pairs.sensor_pairs import Pair, difference, exact_pairs
from rotorid_torch.consistency.smoothing import kernel
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
MOTION = {"rad/s": 0.1, "m/s²": 0.5}
"""Rms of the two sides from which on a flight shows anything."""


@once
def odd_flights(dataset: Dataset) -> Mapping[str, tuple[str, ...]]:
    """Flights in which attitude and rates, or velocity and specific force, disagree; more flights agree in all.

    By flight the channels of the first pair that disagrees.
    """
    wrong, shown, doubtful = dict[str, tuple[str, ...]](), set[str](), set[str]()
    if len(dataset.flights) <= FEW:  # none can be the odd one
        return {}
    for pair in exact_pairs(dataset):
        flights = [f for f in dataset.flights.values() if f.has(*pair.channels)]
        shares = {f.name: share for f in flights if (share := _share(dataset, f, pair)) is not None}
        usual = float(np.median(list(shares.values()))) if shares else 0.0
        odd = (name for name, share in shares.items() if share > max(WRONG, APART * usual))
        wrong = dict.fromkeys(odd, pair.channels) | wrong
        shown |= set(shares)
        doubtful |= {name for name, share in shares.items() if share >= RIGHT}
    return wrong if FEW * len(wrong) <= len(shown - doubtful) else {}


def with_only(dataset: Dataset, names: Collection[str]) -> Dataset:
    """The data set with these flights only; as identify flights where none of the list is among them."""
    flights = {name: flight for name, flight in dataset.flights.items() if name in names}
    lists = {word: tuple(n for n in getattr(dataset, word) if n in flights) for word in LISTS}
    if not lists["identify"]:
        lists = {"identify": tuple(flights), "validate": (), "acid": ()}
    facts = {name: dataset.facts[name] for name in flights}
    return replace(dataset, flights=MappingProxyType(flights), facts=MappingProxyType(facts), **lists)


def without_odd_flights(dataset: Dataset) -> Dataset:
    """The data set without them; itself where there are none."""
    odd = odd_flights(dataset)
    return with_only(dataset, [name for name in dataset.flights if name not in odd]) if odd else dataset


def _share(dataset: Dataset, flight: Flight, pair: Pair) -> float | None:
    """Difference of the sides over their mean power; None where nothing moves, or where noise may make it."""
    apart, power = difference(pair, flight)
    bell, slope = kernel(flight.dt)
    noise = dataset.noise(pair.left_name) ** 2 * float((slope**2).sum())
    noise += max(dataset.noise(name) for name in pair.right_name.split()) ** 2 * float((bell**2).sum())
    if not np.isfinite(power) or power < MOTION[pair.unit] ** 2:
        return None
    return apart / power if apart > ABOVE * noise else 0.0
