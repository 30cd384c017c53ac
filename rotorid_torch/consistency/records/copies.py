"""Stretches of flights that are there twice, sample by sample: copies, whole or in part.

Compared are controls and body rates, for nobody corrects them afterwards as headings or positions are. Two flights of
which one is a copy that was rounded, or that has other noise, are closer to each other than two sensors' noises are.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from rotorid_torch.core.names import RATES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.reading.noise import white_noise

Array = np.ndarray

SHORTEST_S, SHORTEST = 2.0, 40
"""Seconds, and samples, of the shortest stretch that counts."""
CHANNELS = 3
"""Channels that must agree at once; two that are stored in coarse steps may do so by chance."""
CLOSE, MOVES = 0.5, 25.0
"""Mean square between two records over that of the noise of both, up to which they are no two; power of the motion over
that of the noise, from which on they are compared."""
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
    rows = [_rows(dataset.flights[name], compared) for name in names]
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
    rates = [channel for channel in RATES if channel in common]
    turning = [_rates(dataset.flights[name], rates) for name in names] if rates else []
    for a, b in combinations(range(len(turning)), 2):
        if (a, b) not in longest and (copy := _near(turning[a], turning[b])):
            longest[a, b] = copy
    return tuple(longest.values())


class _Rates(NamedTuple):
    """Body rates (n, T) of a flight without gaps, and the variances (n,) of their white noise."""

    name: str
    dt: float
    values: Array
    noise: Array


def _rates(flight: Flight, channels: Sequence[str]) -> _Rates:
    noise = np.array([white_noise([flight.channels[channel].numpy()]) for channel in channels]) ** 2
    return _Rates(flight.name, flight.dt, flight.bridged(channels).numpy().T, noise)


def _near(one: _Rates, other: _Rates) -> Copy | None:
    """What one flight and another share, at one offset, but for less than the noise of both; None where they do not."""
    dt = max(one.dt, other.dt)
    x, y = (each.values[:, :: round(dt / each.dt)] for each in (one, other))
    noise = one.noise + other.noise
    count, least = min(x.shape[1], y.shape[1]), max(SHORTEST, round(SHORTEST_S / dt))
    moving = 2.0 * x.var(axis=1) > MOVES * noise  # NaN of short records is not
    if count < least or not (moving & (noise > 0.0)).any():
        return None
    best = int(np.argmax(x.var(axis=1) / np.maximum(noise, np.finfo(float).tiny) * moving))
    size = 1 << (x.shape[1] + y.shape[1]).bit_length()
    both = np.fft.irfft(np.fft.rfft(x[best], size) * np.fft.rfft(y[best], size).conj(), size)
    lags = np.concatenate([np.arange(x.shape[1] - least + 1), np.arange(least - y.shape[1], 0)])
    begin, end = np.maximum(lags, 0), np.minimum(x.shape[1], y.shape[1] + lags)
    squares = [np.concatenate([[0.0], np.cumsum(row[best] ** 2)]) for row in (x, y)]
    apart = squares[0][end] - squares[0][begin] + squares[1][end - lags] - squares[1][begin - lags] - 2.0 * both[lags]
    lag = int(lags[np.argmin(apart / (end - begin))])
    begin, end = max(lag, 0), min(x.shape[1], y.shape[1] + lag)
    left, right = x[:, begin:end], y[:, begin - lag : end - lag]
    close = ((left - right) ** 2).mean(axis=1) < CLOSE * noise
    if not close[noise > 0.0].all() or not (left.var(axis=1) > MOVES * noise)[moving].any():
        return None
    return Copy(other.name, (begin - lag) * dt, one.name, begin * dt, (end - begin) * dt)


def _rows(flight: Flight, channels: Sequence[str]) -> Array:
    """One number (T,) for each row of these channels: equal where all of them are; 0 where one is missing."""
    mixed = np.zeros(flight.samples, dtype=np.uint64)
    for k, name in enumerate(channels):
        values = (flight.channels[name].numpy().astype(np.float32) + 0.0).astype(np.float64)  # minus zero is zero
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
