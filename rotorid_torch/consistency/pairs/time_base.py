"""A time base, or a unit of the body rates, that is wrong: the attitude turns too fast by one factor on all axes.

Stamps that run too slow scale whatever is differentiated, velocities too; rates in another unit scale no velocity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.pairs.axes import Frame, feels, velocity_frame
from rotorid_torch.consistency.sensor_pairs import Agreement, agreement, attitude_pairs, position_pairs
from rotorid_torch.core import names
from rotorid_torch.core.statistics import weighted_mean
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

CLEAR = 0.5
"""Share of a ratio's logarithm that noise may move it by, for the ratio to be told."""
AGREES = 0.8
"""R² from which on positions agree with velocities."""
LEAST, LEAST_TIME = 0.04, 0.02
"""Ratio less one that is worth a word; and where velocities say that it is the time's: no sensor has that scale."""
SURE, ROUGHLY = 4.0, 0.03
"""Standard errors, or share, within which axes have one ratio."""
FILTERED_S = 0.1
"""Lag of a filter that attenuates the motion which is compared, below 1.7 Hz, by half."""
DEGREES = np.pi / 180.0
"""Ratio of attitudes in rad to rates in deg/s: no clock is that wrong."""
RIGHT = np.log(1.2)
"""Logarithm of the factor within which velocities agree with gravity and specific force."""


@dataclass(frozen=True)
class TimeBase:
    """Ratio of the attitudes' rates to the body rates, its standard error, and what is wrong by it, as far as known."""

    ratio: float
    se: float
    of: Literal["time", "rates", "either"]

    @property
    def in_degrees(self) -> bool:
        """Whether the body rates are in deg/s."""
        return self.ratio == DEGREES


@once
def time_base(dataset: Dataset) -> TimeBase | None:
    """The ratio that all axes share where it is not 1; None where it is, or where axes differ (a gyro's scale).

    Of time base and rates that one is wrong without whose error velocities agree with gravity and specific force.
    """
    results = [a for pair in attitude_pairs() if (a := agreement(pair, dataset.flights.values())) is not None]
    shared = shared_ratio(results)
    if shared is None or _filtered(results, shared[0]):
        return None
    ratio, se = shared
    time, rates = TimeBase(ratio, se, "time"), TimeBase(ratio, se, "rates")
    if abs(ratio / DEGREES - 1.0) < max(LEAST, SURE * se / ratio):
        return TimeBase(DEGREES, se, "rates")
    both = [(abs(np.log(frame.scale)), frame, base) for base in (time, rates) if (frame := _frame(dataset, base))]
    misfit, frame, base = min(both, key=lambda one: one[0], default=(np.inf, None, time))
    small = abs(ratio - 1.0) < LEAST
    if base is time and frame and misfit < RIGHT and not (small and SURE * frame.errors[0] > abs(np.log(ratio))):
        return TimeBase(*_by_paths(dataset, base), "time")
    if small or misfit > RIGHT:
        return None if small else TimeBase(ratio, se, "either")
    # a ratio of some axes alone is a scale, which the pairs of sensors show
    return base if abs(np.log(ratio)) > RIGHT or all(map(_clear_of_noise, results)) else None


def _filtered(results: Sequence[Agreement], ratio: float) -> bool:
    """Whether the smaller of attitude and rates is the late one too, on every axis: a filter does both, stamps none."""
    late = [-np.sign(np.log(ratio)) * a.lag_s for a in results if _clear_of_noise(a)]
    return min(late) > FILTERED_S and abs(np.log(ratio)) < RIGHT


def _frame(dataset: Dataset, base: TimeBase) -> Frame | None:
    righted = on_right_base(dataset, base)
    return velocity_frame(righted, feels(righted))


def _by_paths(dataset: Dataset, base: TimeBase) -> tuple[float, float]:
    """Ratio of a wrong time base and its standard error, by positions too where their rates say about the same."""
    paths = [a for pair in position_pairs() if (a := agreement(pair, dataset.flights.values())) is not None]
    alike = [a for a in paths if a.r2 >= AGREES and a.scale > 0.0 and abs(np.log(a.scale / base.ratio)) < RIGHT]
    return weighted_mean([base.ratio, *(a.scale for a in alike)], [base.se, *(a.whole_scale_error for a in alike)])


def shared_ratio(agreeing: Sequence[Agreement]) -> tuple[float, float] | None:
    """Ratio of left to right and its standard error where pairs share one that is not 1, and none excludes it.

    Pairs that noise hides tell no ratio; they may exclude one by the bounds that noise leaves.
    """
    clear = [*filter(_clear_of_noise, agreeing)]
    if len(clear) < 2:
        return None
    mean, error = weighted_mean(
        ratios := np.array([a.scale for a in clear]), errors := [a.whole_scale_error for a in clear]
    )
    low, high = 1.0 - LEAST_TIME, 1.0 + LEAST_TIME
    beyond = all((a.bounds[0] > high) if mean > 1.0 else (a.bounds[1] < low) for a in clear)
    alike = bool(np.all(np.abs(ratios - mean) < np.maximum(SURE * np.array(errors), ROUGHLY * mean)))
    possible = all(a.bounds[0] < mean * (1.0 + ROUGHLY) and a.bounds[1] > mean * (1.0 - ROUGHLY) for a in agreeing)
    sure = mean > 0.0 and abs(mean - 1.0) > SURE * error
    return (mean, error) if sure and beyond and alike and possible else None


def _clear_of_noise(a: Agreement) -> bool:
    """Whether noise, by R², moves a ratio by little of what it differs from one."""
    return a.scale > 0.0 and a.r2 > np.exp(-CLEAR * abs(np.log(a.scale)))


def on_right_base(dataset: Dataset, base: TimeBase | None) -> Dataset:
    """The data set with intervals, or body rates, times the ratio; itself without one."""
    if base is None:
        return dataset
    if base.of == "rates":
        return without_errors(dataset, {f"scale.{rate}": 1.0 / base.ratio - 1.0 for rate in names.RATES})
    ratio = base.ratio
    return dataset.changed(lambda f: Flight(f.name, ratio * f.dt, {**f.channels, "time": ratio * f.time}))
