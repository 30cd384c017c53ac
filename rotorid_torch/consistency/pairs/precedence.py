"""Does the response follow its control? By how much, and not the other way round, as misaligned streams make it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.sensor_pairs import LAGS, REACH_S, STEP_S, jackknife_error, lag_of_top, minutes
from rotorid_torch.consistency.smoothing import kernel
from rotorid_torch.core import names
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

WIDTH_S = 0.04
"""Standard deviation of the Gaussian that all signals pass, in s: half power at 3.3 Hz, no phase."""
SLOW_S = 0.3
"""The same of the motion that counts as slow, in s: what swings below some 0.5 Hz is little of what is left."""
EVERY = 3
"""Steps of `STEP_S` between the samples that are compared: what has passed the Gaussian loses nothing."""


@dataclass(frozen=True)
class Following:
    """By how many seconds an acceleration follows the controls (negative: precedes them), with its standard error.

    r2 : share of its variance that the controls at that lag and the states explain; gain : how much more that is than
    with the controls 0.4 s away, where nothing but slow motion is left.
    """

    channel: str
    lag_s: float
    lag_se: float
    r2: float
    gain: float

    @property
    def acceleration(self) -> str:
        """What is compared: the rate of a channel, or az itself."""
        return self.channel if self.channel == "az" else f"d{self.channel}/dt"


@once
def responses(dataset: Dataset) -> tuple[Following, ...]:
    """How each angular acceleration and the vertical force follow the controls in the identify flights.

    The vertical force is the specific force, or where no flight has it, the rate of w beside what turns into it.

    Sums of linear terms: all controls, shifted by one lag, and the body's rates and velocities where they are
    measured. The states stand for what feeds back into blade angles and motor commands; without them a controller's
    answer to the rate would count as its cause.
    """
    return _responses(dataset, fast=False)


@once
def fast_responses(dataset: Dataset) -> tuple[Following, ...]:
    """The same of what is left of all signals without slow motion, which other causes than the controls make too."""
    return _responses(dataset, fast=True)


def _responses(dataset: Dataset, fast: bool) -> tuple[Following, ...]:
    felt = any(dataset.facts[name].has("az") for name in dataset.identify)
    measured = (_response(dataset, channel, fast) for channel in (*names.RATES, "az" if felt else "w"))
    return tuple(response for response in measured if response is not None)


def _response(dataset: Dataset, channel: str, fast: bool) -> Following | None:
    flights = [dataset.flights[name] for name in dataset.identify if dataset.facts[name].has(channel)]
    states = [c for c in (*names.RATES, *names.VELOCITIES) if all(f.has(c) for f in flights)]
    if channel == "az":
        states = [c for c in states if c in names.VELOCITIES]
    parts = [moments for f in flights for moments in _moments(f, channel, dataset.controls, states, fast)]
    if not parts:
        return None
    total = np.sum(parts, axis=0)
    r2 = _r2(total)
    error = jackknife_error([lag_of_top(_r2(total - part)) for part in parts])
    if len(parts) < 2 or r2.max() <= 0.0:
        return None
    return Following(channel, lag_of_top(r2), error, float(r2.max()), float(r2.max() - max(r2[0], r2[-1])))


def _moments(flight: Flight, channel: str, controls: tuple[str, ...], states: list[str], fast: bool) -> Iterator[Array]:
    """Cross moments (lags, columns, columns) of each piece: the response, the controls at the lag, the states."""
    bell, slope = _without_slow(flight.dt) if fast else kernel(flight.dt, WIDTH_S)
    reach = int(np.ceil(REACH_S / flight.dt)) + 1
    if flight.samples < len(bell) + 2 * reach + 50:
        return
    columns = flight.bridged([channel, *controls, *states]).numpy().T
    left = np.convolve(columns[0], bell if channel == "az" else slope, "valid")
    smoothed = np.stack([np.convolve(column, bell, "valid") for column in columns[1:]])
    grid = np.arange(0.0, (len(left) - 1) * flight.dt, STEP_S) / flight.dt
    places, count = np.arange(len(left)), len(controls)
    left, *rows = (np.interp(grid, places, row) for row in (left, *smoothed))
    moved, states_rows = np.array(rows[:count]), np.array(rows[count:]).reshape(len(states), len(grid))
    for first, last in minutes(len(grid), STEP_S, LAGS // 2):
        fixed = _centred(np.concatenate([left[None, first:last:EVERY], states_rows[:, first:last:EVERY]]))
        lags = range(-(LAGS // 2), LAGS // 2 + 1)
        shifted = _centred(np.stack([moved[:, first - lag : last - lag : EVERY] for lag in lags]))
        turned = shifted.swapaxes(1, 2)
        across = fixed @ turned
        among = np.broadcast_to(fixed @ fixed.T, (len(lags), len(fixed), len(fixed)))
        yield np.block([[among, across], [across.swapaxes(1, 2), shifted @ turned]])


def _without_slow(dt: float) -> tuple[Array, Array]:
    """Gaussian and its derivative less those of slow motion, as convolution kernels."""
    wide = kernel(dt, SLOW_S)
    narrow = (np.pad(k, (len(wide[0]) - len(k)) // 2) for k in kernel(dt, WIDTH_S))
    bell, slope = (n - w for n, w in zip(narrow, wide, strict=True))
    return bell, slope


def _centred(rows: Array) -> Array:
    return rows - rows.mean(axis=-1, keepdims=True)


def _r2(moments: Array) -> Array:
    """Share (lags,) of the first column's variance that the others explain, from cross moments (lags, n, n)."""
    normal, slope, power = moments[:, 1:, 1:], moments[:, 1:, 0], moments[:, 0, 0]
    scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), np.finfo(float).tiny))
    inverse = np.linalg.pinv(normal / (scale[:, :, None] * scale[:, None, :]), rcond=1e-9, hermitian=True)
    along = slope / scale
    explained = np.einsum("ki,kij,kj->k", along, inverse, along)
    return np.where(power > 0.0, explained / np.maximum(power, np.finfo(float).tiny), 0.0)
