"""A time base, or a unit of the body rates, that is wrong: the attitude turns too fast by one factor on all axes.

Stamps that run too slow scale whatever is differentiated, velocities too; rates in another unit scale no velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.pairs.frames import feels, velocity_frame
from rotorid_torch.consistency.pairs.sensor_pairs import Agreement, agreement, attitude_pairs
from rotorid_torch.core import names
from rotorid_torch.core.statistics import weighted_mean
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

AGREES = 0.8
"""R² of every axis, from which on a ratio is known."""
LEAST = 0.04
"""Ratio less one that is worth a word."""
SURE, ROUGHLY = 4.0, 0.03
"""Standard errors, or share, within which axes have one ratio."""


@dataclass(frozen=True)
class TimeBase:
    """Ratio of the attitudes' rates to the body rates, its standard error, and what is wrong by it, as far as known."""

    ratio: float
    se: float
    of: Literal["time", "rates", "either"]


@once
def time_base(dataset: Dataset) -> TimeBase | None:
    """The ratio that all axes share where it is not 1; None where it is, or where axes differ (a gyro's scale)."""
    results = [agreement(pair, dataset.flights.values()) for pair in attitude_pairs()]
    shared = shared_ratio([a for a in results if a is not None])
    if shared is None:
        return None
    frame = velocity_frame(dataset, feels(dataset))
    if frame is None:
        return TimeBase(*shared, "either")
    by_time = abs(np.log(frame.scale / shared[0])) < abs(np.log(frame.scale))
    return TimeBase(*shared, "time" if by_time else "rates")


def shared_ratio(agreeing: Sequence[Agreement]) -> tuple[float, float] | None:
    """Ratio of left to right and its standard error where all pairs share one that is not 1."""
    if len(agreeing) < 2 or min(a.r2 for a in agreeing) < AGREES:
        return None
    ratios, errors = np.array([a.scale for a in agreeing]), np.maximum([a.scale_se for a in agreeing], 0.005)
    mean, error = weighted_mean(ratios, errors)
    beyond = all((a.bounds[0] > 1.0 + LEAST) if mean > 1.0 else (a.bounds[1] < 1.0 - LEAST) for a in agreeing)
    alike = bool(np.all(np.abs(ratios - mean) < np.maximum(SURE * errors, ROUGHLY)))
    return (mean, error) if mean > 0.0 and beyond and alike and abs(mean - 1.0) > SURE * error else None


def on_right_base(dataset: Dataset, base: TimeBase | None) -> Dataset:
    """The data set with intervals, or body rates, times the ratio; itself without one."""
    if base is None:
        return dataset
    if base.of == "rates":
        return without_errors(dataset, {f"scale.{rate}": 1.0 / base.ratio - 1.0 for rate in names.RATES})
    times = {f.name: {**f.channels, "time": base.ratio * f.time} for f in dataset}
    return dataset.with_flights({f.name: Flight(f.name, base.ratio * f.dt, times[f.name]) for f in dataset})
