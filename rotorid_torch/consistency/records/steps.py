"""Steps of attitude, velocity and position that no motion makes: an estimator was reset, and no counter says so.

What a channel jumps by from one sample to the next beyond what its kinematics say, and does not take back: a spike
returns, a bias grows slowly.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from rotorid_torch.consistency.imu_place import placed_pairs
from rotorid_torch.consistency.sensor_pairs import Pair, attitude_pairs, position_pairs
from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, VELOCITIES
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand

LEAST = {"rad/s": 0.04, "m/s²": 0.3, "m/s": 0.5}
"""Least step by the unit of the channel's rate: rad, m/s, m."""
SURE = 12.0
"""Usual differences beyond kinematics, by their median, that a step exceeds."""
KEPT = 0.7
"""Share of the step by which the means before and after it differ."""
ALONE = 0.25
"""Share of the step that no difference near it reaches: what is rough all around is poorly measured, not reset."""
MEAN_S = 0.3
"""s before and after a step whose means are compared."""
AROUND_S = 0.08
"""s to either side of a step in which its channel counts as missing."""
NEAR = 3.0
"""Turns of a sample interval from the vertical, within which Euler rates change by their size in one interval."""
VECTORS = (ATTITUDES, VELOCITIES, POSITIONS)
"""Channels that an estimator sets together."""
MOST = 5
"""Steps of a channel in a flight; what jumps more often is renewed slowly, or broken."""


@dataclass(frozen=True)
class Step:
    """A channel of a flight that jumps by `size`, in its unit, `at` s from the flight's beginning."""

    flight: str
    channel: str
    at: float
    size: float


@once
def steps(dataset: Dataset) -> tuple[Step, ...]:
    """All steps of a data set, by flight, channel and time."""
    pairs = (*attitude_pairs(), *placed_pairs(dataset), *position_pairs())
    return tuple(step for flight in dataset.flights.values() for pair in pairs for step in _steps(flight, pair))


def without_steps(dataset: Dataset, jumps: Sequence[Step]) -> Dataset:
    """The data set with the samples around the steps missing in their vectors; itself where there are none.

    A reset is one of the whole vector: of another of its channels the step may be too small to be told.
    """
    if not jumps:
        return dataset
    at: dict[str, dict[str, list[float]]] = {}
    for step in jumps:
        (vector,) = (vector for vector in VECTORS if step.channel in vector)
        for channel in vector:
            at.setdefault(step.flight, {}).setdefault(channel, []).append(step.at)
    flights = OnDemand(dataset.flights, lambda name: _opened(dataset.flights[name], at.get(name, {})))
    return replace(dataset, flights=MappingProxyType(flights))


def _opened(flight: Flight, at: Mapping[str, Sequence[float]]) -> Flight:
    channels = dict(flight.channels)
    for name, times in ((name, times) for name, times in at.items() if name in channels):
        values = channels[name].clone()
        for time in times:
            first, last = (round((time + side * AROUND_S) / flight.dt) for side in (-1, 1))
            values[max(first, 0) : last + 1] = float("nan")
        channels[name] = values
    return Flight(flight.name, flight.dt, MappingProxyType(channels))


def _steps(flight: Flight, pair: Pair) -> Iterator[Step]:
    count = max(3, round(MEAN_S / flight.dt))
    if not flight.has(*pair.channels) or flight.samples < 4 * count:
        return
    values, rate = flight.channels[pair.left_name].numpy(), pair.right(flight)
    moved = np.diff(values) - 0.5 * flight.dt * (rate[1:] + rate[:-1])
    if pair.left_name in ATTITUDES:  # a flip through half a turn, or through the vertical, is none
        moved = np.where(_vertical(flight), np.nan, (moved + np.pi) % (2.0 * np.pi) - np.pi)
    if not np.isfinite(moved).any():
        return
    usual = float(np.nanmedian(np.abs(moved)))
    jumps = np.flatnonzero(np.abs(moved) > max(SURE * usual, LEAST[pair.unit]))
    if not 0 < len(jumps) <= MOST:
        return
    beyond = np.concatenate([[0.0], np.cumsum(np.nan_to_num(moved))])
    for k in jumps.tolist():
        before, after = beyond[max(k + 1 - count, 0) : k + 1], beyond[k + 1 : k + 1 + count]
        if min(len(before), len(after)) < count // 2:
            continue
        size = float(np.median(after) - np.median(before))
        near = np.delete(moved[max(k - count, 0) : k + count + 1], slice(min(k, count) - 1, min(k, count) + 2))
        if (
            np.nan_to_num(np.abs(near)).max(initial=0.0) < ALONE * abs(moved[k])
            and size * moved[k] > KEPT * moved[k] ** 2
        ):
            yield Step(flight.name, pair.left_name, (k + 1) * flight.dt, size)


def _vertical(flight: Flight) -> np.ndarray:
    """Intervals (T - 1,) so near the vertical that the body may turn through it: Euler angles jump there."""
    turn = flight.bridged(RATES).norm(dim=1).numpy() * flight.dt
    near = np.abs(np.cos(flight.bridged(["theta"])[:, 0].numpy())) < NEAR * turn
    return np.logical_or(near[1:], near[:-1])
