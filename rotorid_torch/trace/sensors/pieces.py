"""Pieces of flights in which kinematics is compared: gaps left out, one moderate rate, clocks and filters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.trace.sensors.equations import EQUATIONS, unit_of, usable

Array = np.ndarray

HIGHEST_HZ = 5.0
"""Upper end of the compared band; motion that controls cause ends below it, and white noise is weighed anyway."""
PER_CYCLE = 12
"""Samples kept per period of the highest frequency."""
REACH_S = 0.3
"""Largest delay either way."""
LONGEST_S, SHORTEST_S = 15.1, 4.0
"""Length of a piece: sensors' constants hold at least so long; below, a constant and a trend eat what there is."""
BRIDGED_S = 0.05
"""Gaps up to this are bridged by straight lines."""
PIECES = 16
"""Pieces that are looked at, at most: sensor errors are the same in all, and these make them certain."""
STILL = 1e-3
"""Least noise, as a share of a channel's rms deviation: what is integrated and stored in steps is no more exact."""


@dataclass(frozen=True)
class Piece:
    """Samples of one piece of a flight and their rates of change, (channels, N + 2 margin), and their noise.

    `readings` covers `margin` samples beyond both ends, so that a clock can be moved; `noise` is the standard
    deviation of one of the N samples, per channel.
    """

    flight: str
    dt: float
    margin: int
    channels: tuple[str, ...]
    readings: Array
    slopes: Array
    noise: Array
    equations: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Samples that are compared."""
        return self.readings.shape[1] - 2 * self.margin

    def on_time(self, errors: Mapping[str, Array | float]) -> dict[str, Array]:
        """Readings (N) of each channel with delays and lags taken out: x = y(t + delay) + lag dy/dt(t + delay).

        Where its delay or lag is an array of several values, (values, N).
        """
        return {name: self._on_time(i, unit_of(name) or "positions", errors) for i, name in enumerate(self.channels)}

    def _on_time(self, row: int, unit: str, errors: Mapping[str, Array | float]) -> Array:
        clocks = np.broadcast_arrays(errors.get(f"delay.{unit}", 0.0), errors.get(f"filter.{unit}", 0.0))
        each = list(zip(*(clock.reshape(-1).tolist() for clock in clocks), strict=True))
        readings = {clock: self._read(row, *clock) for clock in dict.fromkeys(each)}
        return readings[each[0]] if clocks[0].ndim == 0 else np.stack([readings[clock] for clock in each])

    def _read(self, row: int, delay: float, lag: float) -> Array:
        values = self.readings[row] + lag * self.slopes[row] if lag else self.readings[row]
        return advanced(values, delay / self.dt, self.margin)


def advanced(row: Array, by: float, margin: int) -> Array:
    """Samples (T - 2 margin,) of a row (T,), taken `by` samples later, between samples by a cubic through four."""
    whole = int(np.floor(by))
    s, start, count = by - whole, margin + whole, len(row) - 2 * margin
    if s == 0.0:
        return row[start : start + count]
    taps = (-s * (s - 1) * (s - 2), 3 * (s + 1) * (s - 1) * (s - 2), -3 * (s + 1) * s * (s - 2), (s + 1) * s * (s - 1))
    return np.convolve(row[start - 1 : start + count + 2], np.array(taps[::-1]) / 6.0, mode="valid")


def pieces(dataset: Dataset) -> list[Piece]:
    """Pieces of the identify flights, long ones cut, at most `PIECES` of them, spread over the list."""
    cut: list[Piece] = []
    for name in dataset.some(PIECES):
        cut += _cut(dataset, dataset.flights[name])
    step = max(1.0, len(cut) / PIECES)
    return [cut[int(i * step)] for i in range(min(len(cut), PIECES))]


def _cut(dataset: Dataset, flight: Flight) -> Iterator[Piece]:
    equations = usable([name for name in flight.channels if flight.has(name)])
    if not equations:
        return
    channels = tuple(dict.fromkeys(c for name in equations for c in EQUATIONS[name]))
    stride = max(1, int(1.0 / (PER_CYCLE * HIGHEST_HZ * flight.dt)))
    dt = stride * flight.dt
    margin = int(np.ceil(REACH_S / dt)) + 4
    values = flight.bridged(channels).numpy().T
    for start, stop in _whole(_missing(flight, channels), round(BRIDGED_S / flight.dt)):
        count = (stop - start) // stride
        seconds = (count - 2 * margin) * dt
        if seconds < SHORTEST_S:
            continue
        parts = int(np.ceil(seconds / LONGEST_S))
        mean = values[:, start : start + count * stride].reshape(len(channels), count, stride).mean(-1)
        noise = np.array([sigma(dataset, channel) for channel in channels]) / np.sqrt(stride)
        length = _quick((count - 2 * margin) // parts - 1) + 1
        for k in range(parts):
            part = mean[:, k * length : (k + 1) * length + 2 * margin]
            yield Piece(flight.name, dt, margin, channels, part, _slopes(part, dt), noise, equations)


def _quick(intervals: int) -> int:
    """Largest number up to this one whose only factors are 2, 3 and 5: its transform is quick."""
    while intervals > 1:
        remaining = intervals
        for factor in (2, 3, 5):
            while remaining % factor == 0:
                remaining //= factor
        if remaining == 1:
            break
        intervals -= 1
    return intervals


def sigma(dataset: Dataset, channel: str) -> float:
    """Noise of a sample of a channel, at least a thousandth of what the channel does."""
    return max(dataset.noise(channel), STILL * dataset.scales().get(channel, 0.0), 1e-12)


def _missing(flight: Flight, channels: tuple[str, ...]) -> Array:
    return np.asarray(np.isnan(flight.stack(channels).numpy()).any(axis=1))


def _whole(missing: Array, bridged: int) -> Iterator[tuple[int, int]]:
    """First and last + 1 of the stretches between gaps longer than `bridged` samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(int), [0]])))
    start = 0
    for begin, end in edges.reshape(-1, 2):
        if end - begin > bridged or begin == 0 or end == len(missing):
            yield start, int(begin)
            start = int(end)
    yield start, len(missing)


def _slopes(rows: Array, dt: float) -> Array:
    """Rates of change by the central formula of fourth order, by that of second order next to the ends.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions, eq. 25.3.21 ff.
    """
    slopes = np.gradient(rows, dt, axis=1)
    slopes[:, 2:-2] = (8.0 * (rows[:, 3:-1] - rows[:, 1:-3]) - (rows[:, 4:] - rows[:, :-4])) / (12.0 * dt)
    return slopes
