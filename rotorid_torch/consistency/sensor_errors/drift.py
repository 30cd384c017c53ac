"""Gyros and accelerometers whose zero drifts: what they read beside attitude, velocity and gravity grows with time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.pairs.alignment import LEAST, alignment, forces_of, rates_by_attitude
from rotorid_torch.consistency.smoothing import EVERY_S, correlated
from rotorid_torch.core import names
from rotorid_torch.core.statistics import student_quantile
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

LEAST_DRIFT = dict.fromkeys(names.RATES, 0.004) | dict.fromkeys(names.SPECIFIC_FORCES, 0.15)
"""rad/s and m/s² over a flight that are worth a word, as of a constant."""
LINE = 0.3
"""Share of the slope that each half of a flight must have: a step has none in one of them, and a sensor that warms up
with a time constant of 0.27 of the flight has just so much in the second (least squares on 1 - exp(-t / 0.27))."""
SURE = 5.0
"""Standard errors, of a normal distribution; more where a flight has few independent samples."""


@dataclass(frozen=True)
class Drift:
    """A sensor that reads `grown` (± se), rad/s or m/s², more at the end of a flight of so many seconds than before."""

    flight: str
    channel: str
    grown: float
    se: float
    seconds: float


@once
def drifts(dataset: Dataset) -> tuple[Drift, ...]:
    """Drifts of all flights that have what is needed; only those beyond chance.

    Accelerometers have none beside an attitude that is turned, mirrored or late.
    """
    drifting, by = list[Drift](), alignment(dataset)
    felt = not by.errors and not by.mirror
    for flight in dataset:
        if flight.has(*names.RATES, *names.ATTITUDES):
            sides = rates_by_attitude(flight)
            present = sides.present.prod(axis=0) > 0.0
            drifting += _of(flight, names.RATES, (sides.right, sides.right - sides.left), present)
        if felt and flight.has(*names.RATES, *names.ATTITUDES, *names.VELOCITIES, *names.SPECIFIC_FORCES):
            forces = forces_of(flight, dataset.vehicle.gravity)
            away = forces.felt - forces.fallen - forces.pushed
            drifting += _of(flight, names.SPECIFIC_FORCES, (forces.felt, away), forces.present)
    return tuple(drifting)


def _of(
    flight: Flight, channels: Sequence[str], sides: tuple[np.ndarray, np.ndarray], present: np.ndarray
) -> Iterator[Drift]:
    """Slope over time of what a sensor reads (T, 3) less what it should, beside a turned sensor and a wrong scale.

    `sides` are the sensor and what is left of it. Neighbours share the Gaussian that both have passed.
    """
    if present.sum() < LEAST:
        return
    time = EVERY_S * np.flatnonzero(present)
    read, away = (side[present] for side in sides)
    columns = np.column_stack([time, read])  # not the other side: its noise would stand on both sides
    slopes, errors, free = _slopes(columns, away)
    half = len(time) // 2
    first, last = _slopes(columns[:half], away[:half])[0], _slopes(columns[half:], away[half:])[0]
    line = np.minimum(first * np.sign(slopes), last * np.sign(slopes)) > LINE * np.abs(slopes)
    seconds = (flight.samples - 1) * flight.dt
    sure = student_quantile(SURE, max(int(free), 1))
    for channel, slope, error, is_line in zip(channels, slopes.tolist(), errors.tolist(), line, strict=True):
        if is_line and abs(slope) * seconds > LEAST_DRIFT[channel] and abs(slope) > sure * error:
            yield Drift(flight.name, channel, slope * seconds, error * seconds, seconds)


def _slopes(columns: np.ndarray, away: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Factors (3,) of the first column (T, n) in what is left (T, 3), their errors and the degrees of freedom."""
    columns, away = columns - columns.mean(axis=0), away - away.mean(axis=0)
    free = len(away) / correlated(EVERY_S) - 1.0 - columns.shape[1]
    fitted = np.linalg.lstsq(columns, away, rcond=None)[0]
    left = ((away - columns @ fitted) ** 2).mean(axis=0)
    inverse = np.linalg.pinv(columns.T @ columns / len(away), hermitian=True)[0, 0]
    return fitted[0], np.sqrt(left / max(free, 1.0) * inverse), free


def without_drifts(dataset: Dataset, drifts: Sequence[Drift]) -> Dataset:
    """The data set with sensors as they read at the beginning of each flight; itself without drifts."""
    if not drifts:
        return dataset
    by_flight: dict[str, list[Drift]] = {}
    for one in drifts:
        by_flight.setdefault(one.flight, []).append(one)

    def of(flight: Flight) -> Flight:
        some = by_flight.get(flight.name, [])
        steady = {one.channel: flight.channels[one.channel] - one.grown / one.seconds * flight.time for one in some}
        return Flight(flight.name, flight.dt, {**flight.channels, **steady})

    return dataset.changed(of)
