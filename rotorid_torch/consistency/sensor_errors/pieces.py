"""Pieces of flights in which kinematics is compared: gaps left out, one moderate rate, clocks and filters."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from rotorid_torch.consistency.equations import EQUATIONS, of_part_of_a_vector, undoing, unit_of, usable
from rotorid_torch.consistency.smoothing import advanced
from rotorid_torch.core.statistics import stretches
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

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
KERNEL_S, SMALL = 0.12, 1e-5
"""Half-width of the kernels that differentiate, and how much the size of their taps counts."""
STILL = 1e-3
"""Least noise, as a share of a channel's rms deviation: what is integrated and stored in steps is no more exact."""


@dataclass(frozen=True)
class Piece:
    """Samples of one piece of a flight, their rates of change and the rates of these, and their noise.

    Each (channels, N + 2 margin).

    `readings` covers `margin` samples beyond both ends, so that a clock can be moved; `noise` is the standard
    deviation of one of the N samples, per channel.
    """

    flight: str
    dt: float
    margin: int
    channels: tuple[str, ...]
    readings: Array
    slopes: Array
    bends: Array
    noise: Array
    equations: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Samples that are compared."""
        return self.readings.shape[1] - 2 * self.margin

    def on_time(self, errors: Mapping[str, Array | float]) -> dict[str, Array]:
        """Readings (N) of each channel with delays and filters taken out: y + a dy/dt + b d²y/dt² at t + delay.

        Where its delay or a filter is an array of several values, (values, N).
        """
        return {name: self._on_time(i, unit_of(name) or "positions", errors) for i, name in enumerate(self.channels)}

    def _on_time(self, row: int, unit: str, errors: Mapping[str, Array | float]) -> Array:
        clocks = np.broadcast_arrays(errors.get(f"delay.{unit}", 0.0), *undoing(errors, unit))
        each = list(zip(*(clock.reshape(-1).tolist() for clock in clocks), strict=True))
        readings = {clock: self._read(row, *clock) for clock in dict.fromkeys(each)}
        return readings[each[0]] if clocks[0].ndim == 0 else np.stack([readings[clock] for clock in each])

    def _read(self, row: int, delay: float, first: float, second: float) -> Array:
        values = self.readings[row] + first * self.slopes[row] if first else self.readings[row]
        values = values + second * self.bends[row] if second else values
        return advanced(values, delay / self.dt, self.margin)


def pieces(dataset: Dataset, turned: bool = False) -> list[Piece]:
    """Pieces of the identify flights, long ones cut, at most `PIECES` of them, spread over the list.

    turned : the IMU is; what reads a vector of which an axis is not recorded is left out then.
    """
    cut: list[Piece] = []
    for name in dataset.some(PIECES):
        cut += _cut(dataset, dataset.flights[name], turned)
    step = max(1.0, len(cut) / PIECES)
    return [cut[int(i * step)] for i in range(min(len(cut), PIECES))]


def _cut(dataset: Dataset, flight: Flight, turned: bool) -> Iterator[Piece]:
    recorded = {name for name in flight.channels if flight.has(name)}
    equations = usable(recorded - of_part_of_a_vector(recorded) if turned else recorded)
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
            slopes, bends = (_filtered(part, kernel) for kernel in _differentiators(round(dt, 9)))
            yield Piece(flight.name, dt, margin, channels, part, slopes, bends, noise, equations)


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
    start = 0
    for begin, end in stretches(missing):
        if end - begin > bridged or begin == 0 or end == len(missing):
            yield start, begin
            start = end
    yield start, len(missing)


@cache
def _differentiators(dt: float) -> tuple[Array, Array]:
    """Kernels of the first and the second rate of change that are exact in the compared band and deaf above it.

    Differences of neighbours would carry the noise of all frequencies to both ends of a piece. The taps (2 n + 1) are
    those whose response comes closest to j w and -w² in the band, of small size elsewhere.

    Source: Oppenheim and Schafer, Discrete-Time Signal Processing, 3rd ed., sec. 7.7 (least-squares design).
    """
    taps = np.arange(1, max(4, round(KERNEL_S / dt)) + 1)
    omega = 2.0 * np.pi * np.linspace(0.02, 1.05, 60) * min(HIGHEST_HZ, 0.25 / dt)
    angles = np.outer(omega, taps) * dt

    def closest(response: Array, wanted: Array) -> Array:
        rows = response / wanted[:, None]
        small = SMALL * np.sqrt(len(omega)) * np.linalg.norm(rows, 2) * np.eye(len(taps))
        right = np.concatenate([np.ones(len(omega)), np.zeros(len(taps))])
        return np.linalg.lstsq(np.concatenate([rows, small]), right, rcond=None)[0]

    odd, even = closest(2.0 * np.sin(angles), omega), closest(2.0 * (np.cos(angles) - 1.0), -(omega**2))
    return np.concatenate([odd[::-1], [0.0], -odd]), np.concatenate([even[::-1], [-2.0 * even.sum()], even])


def _filtered(rows: Array, kernel: Array) -> Array:
    """Records (channels, T) through a kernel, straight on beyond both ends."""
    half = len(kernel) // 2
    held = np.pad(rows, ((0, 0), (half, half)), mode="reflect", reflect_type="odd")
    return np.stack([np.convolve(row, kernel, "valid") for row in held])
