"""Stretches of flights that are there twice, sample by sample: copies, whole or in part.

Compared are controls and body rates, for nobody corrects them afterwards as headings or positions are, to the decimals
of the record that has fewest.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorid_torch.core.names import RATES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

SHORTEST_S, SHORTEST = 2.0, 40
"""Seconds, and samples, of the shortest stretch that counts."""
CHANNELS = 3
"""Channels that must agree at once; two that are stored in coarse steps may do so by chance."""
DECIMALS, VALUES = 6, 20
"""Decimals from which on rounding is no matter, and different values of a record that has a resolution."""
HELD = 0.5
"""Share of a stretch's rows that differ from the row before; rows that stand still are alike without being copies."""
ODD = 0x9E3779B97F4A7C15
"""A large odd number, by which the bits of a row's channels are mixed."""


@dataclass(frozen=True)
class Copy:
    """A stretch of `seconds` that begins at `at` s of a flight and is `of_at` s into another one, or the same."""

    flight: str
    at: float
    of: str
    of_at: float
    seconds: float


def copies(dataset: Dataset) -> tuple[Copy, ...]:
    """Stretches that repeat an earlier one, the longest of each pair of flights."""
    names = list(dataset.flights)
    common = set.intersection(*({*dataset.facts[name].spreads} for name in names)) - {"time"}
    raw = {name for name in common if name in dataset.controls or name in RATES}
    compared = sorted(raw if len(raw) >= CHANNELS else common)
    if len(compared) < CHANNELS:
        return ()
    digits = {channel: min(_decimals(dataset.flights[name], channel) for name in names) for channel in compared}
    rows = [_rows(dataset.flights[name], digits) for name in names]
    flight = np.repeat(np.arange(len(rows)), [len(one) for one in rows])
    finest = min(dataset.facts[name].dt for name in names)
    steps = [round(dataset.facts[name].dt / finest) for name in names]  # a copy may have every second row
    place = np.concatenate([step * np.arange(len(one)) for step, one in zip(steps, rows, strict=True)])
    every = np.concatenate(rows)
    order = np.lexsort((place, flight, every))
    twice = every[order][1:] == every[order][:-1]
    first, second = order[:-1][twice], order[1:][twice]
    moving = np.concatenate([np.concatenate([[True], np.diff(one.astype(np.int64)) != 0]) for one in rows])
    keep = moving[first] & moving[second] & (every[first] != 0)
    first, second = first[keep], second[keep]
    offsets = place[second] - place[first]
    counts = Counter(zip(flight[first].tolist(), flight[second].tolist(), offsets.tolist(), strict=True))
    longest: dict[tuple[int, int], Copy] = {}
    for (a, b, offset), count in counts.most_common(64):
        step = max(steps[a], steps[b])
        dt = step * finest
        if count < max(SHORTEST, SHORTEST_S / dt) or (a, b) in longest:
            continue
        here = (flight[first] == a) & (flight[second] == b) & (offsets == offset)
        begin, end = _longest_run(np.sort(place[first][here]) // step, round(SHORTEST_S / dt))
        if end - begin >= max(SHORTEST, SHORTEST_S / dt):
            longest[a, b] = Copy(names[b], begin * dt + offset * finest, names[a], begin * dt, (end - begin) * dt)
    return tuple(longest.values())


def _decimals(flight: Flight, channel: str) -> int:
    """Decimals with which a channel is stored, `DECIMALS` where it has that many or hardly moves."""
    values = flight.channels[channel].numpy()
    finite = np.unique(values[np.isfinite(values)])
    if len(finite) < VALUES:
        return DECIMALS
    single = 2.0**-23 * np.abs(finite)  # what single precision leaves of it
    fitting = (d for d in range(DECIMALS) if (np.abs(np.round(finite, d) - finite) <= single).all())
    return next(fitting, DECIMALS)


def _rows(flight: Flight, digits: Mapping[str, int]) -> Array:
    """One number (T,) for each row of these channels: equal where all of them are; 0 where one is missing."""
    mixed = np.zeros(flight.samples, dtype=np.uint64)
    for k, (name, decimals) in enumerate(digits.items()):
        values = flight.channels[name].numpy()
        values = (np.round(values, decimals) if decimals < DECIMALS else values.astype(np.float32)) + 0.0
        values = values.astype(np.float64)  # minus zero is zero
        with np.errstate(over="ignore"):
            mixed = (mixed ^ (values.view(np.uint64) + np.uint64(k))) * np.uint64(ODD)
            mixed ^= mixed >> np.uint64(29)
        mixed = np.where(np.isnan(values), 0, mixed)
    return mixed


def _longest_run(places: Array, bridged: int) -> tuple[int, int]:
    """First and last + 1 of the longest stretch of places in which at least every second one is there."""
    breaks = np.flatnonzero(np.diff(places) > max(bridged // 4, 1))
    edges = np.concatenate([[0], breaks + 1, [len(places)]])
    spans = [(int(places[i]), int(places[j - 1]) + 1, j - i) for i, j in pairwise(edges)]
    begin, end, count = max(spans, key=lambda span: span[2])
    return (begin, end) if count >= HELD * (end - begin) else (0, 0)
