"""Gyros whose zero drifts over a flight: what they read beside the attitude's rates grows in proportion to time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.pairs.alignment import LEAST, rates_by_attitude
from rotorid_torch.consistency.smoothing import EVERY_S, WIDTH_S
from rotorid_torch.core import names
from rotorid_torch.core.statistics import student_quantile
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

LEAST_DRIFT = 0.004
"""rad/s over a flight that are worth a word, as of a constant."""
SURE = 5.0
"""Standard errors, of a normal distribution; more where a flight has few independent samples."""


@dataclass(frozen=True)
class Drift:
    """A body rate that reads `grown` rad/s (± se) more at the end of a flight of so many seconds than at its start."""

    flight: str
    rate: str
    grown: float
    se: float
    seconds: float


@once
def drifts(dataset: Dataset) -> tuple[Drift, ...]:
    """Drifts of all flights that have body rates and attitude; only those beyond chance."""
    flights = (f for f in dataset if f.has(*names.RATES, *names.ATTITUDES))
    return tuple(drift for flight in flights for drift in _of(flight))


def _of(flight: Flight) -> Iterator[Drift]:
    """Slope over time of rates less those of the attitude, beside what goes with these: a turned IMU, a wrong scale.

    Neighbours share the Gaussian that both have passed.
    """
    sides = rates_by_attitude(flight)
    both = sides.present.prod(axis=0) > 0.0
    if both.sum() < LEAST:
        return
    time = EVERY_S * np.flatnonzero(both)
    away = (sides.right - sides.left)[both]
    columns = np.column_stack([time, sides.right[both]])  # gyros: noise of the attitude's would stand on both sides
    columns, away = columns - columns.mean(axis=0), away - away.mean(axis=0)
    free = len(time) * EVERY_S / (2.0 * np.sqrt(np.pi) * WIDTH_S) - 1.0 - columns.shape[1]
    fitted = np.linalg.lstsq(columns, away, rcond=None)[0]
    slopes, left = fitted[0], ((away - columns @ fitted) ** 2).mean(axis=0)
    inverse = np.linalg.pinv(columns.T @ columns / len(time), hermitian=True)[0, 0]
    errors = np.sqrt(left / max(free, 1.0) * inverse)
    seconds = (flight.samples - 1) * flight.dt
    sure = student_quantile(SURE, max(int(free), 1))
    for rate, slope, error in zip(names.RATES, slopes.tolist(), errors.tolist(), strict=True):
        if abs(slope) * seconds > LEAST_DRIFT and abs(slope) > sure * error:
            yield Drift(flight.name, rate, slope * seconds, error * seconds, seconds)


def without_drifts(dataset: Dataset, drifts: Sequence[Drift]) -> Dataset:
    """The data set with rates as they read at the beginning of each flight; itself without drifts."""
    if not drifts:
        return dataset
    by_flight: dict[str, list[Drift]] = {}
    for one in drifts:
        by_flight.setdefault(one.flight, []).append(one)

    def of(flight: Flight) -> Flight:
        some = by_flight.get(flight.name, [])
        rates = {one.rate: flight.channels[one.rate] - one.grown / one.seconds * flight.time for one in some}
        return Flight(flight.name, flight.dt, {**flight.channels, **rates})

    return dataset.changed(of)
