"""Attitudes and rates that are written in another way: angles in another order of turns, rates of angles for p q r.

Source: Diebel, Representing Attitude: Euler Angles, Unit Quaternions, and Rotation Vectors (Stanford, 2006), section 8.
"""

from dataclasses import dataclass

import numpy as np
import torch

from rotorid_torch.consistency.pairs.alignment import (
    BETTER,
    FLIGHTS,
    LEAST,
    MOVES,
    STEEP,
    SURE,
    Sides,
    body_rates,
    share_left,
    turned,
)
from rotorid_torch.consistency.smoothing import EVERY_S, centred, correlated, smoothed
from rotorid_torch.core import names
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

USUAL = "ZYX"
"""Axes of the turns from north-east-down to body axes, the first turn first."""
ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY")
"""The other orders of three turns about three axes."""
OF_ANGLES = "rates of angles"
"""Attitude as usual, but rates of its angles in place of body rates."""


@dataclass(frozen=True)
class Convention:
    """An order of turns, or `OF_ANGLES`; shares of the rates' variance left as recorded, and so taken."""

    form: str
    before: float
    after: float


@once
def convention(dataset: Dataset) -> Convention | None:
    """How rates and attitude are written, where that is beyond doubt not the usual way; no turn of sensors says it."""
    flights = [dataset.flights[name] for name in dataset.some(FLIGHTS)]
    records = [_smoothed(f) for f in flights if f.has(*names.RATES, *names.ATTITUDES)]
    records = [one for one in records if one.present.sum() > LEAST]
    if not records:
        return None
    sides = {form: [one.sides(form) for one in records] for form in (USUAL, *ORDERS, OF_ANGLES)}
    shares = {form: share_left(some) for form, some in sides.items()}
    by_turn = turned(dataset, sides[USUAL])
    best = min(shares, key=lambda form: shares[form])
    independent = 3.0 * sum(one.present.sum() for one in records) / correlated(EVERY_S)
    better = min(BETTER, 1.0 - SURE * 2.0 / np.sqrt(independent))  # two variances of so many samples
    sure = by_turn.strength > MOVES and shares[best] < better * min(shares[USUAL], by_turn.after)
    return Convention(best, shares[USUAL], shares[best]) if sure else None


@dataclass(frozen=True)
class _Records:
    """Angles, their rates of change and body rates (T, 3), smoothed, and where all are known."""

    angles: Array
    changes: Array
    rates: Array
    present: Array

    def sides(self, form: str) -> Sides:
        """Rates by the attitude, and as recorded, where both are known."""
        left = self.changes if form == OF_ANGLES else body_rates(self.angles, self.changes, form)
        whole = np.ones(int(self.present.sum()), bool)
        return Sides(*(centred(side[self.present], whole) for side in (left, self.rates)))


def _smoothed(flight: Flight) -> _Records:
    angles, changes, taken = smoothed(flight, names.ATTITUDES)
    rates, _, measured = smoothed(flight, names.RATES)
    present = taken & measured & (np.abs(angles[:, 1]) < STEEP)
    return _Records(angles, changes, rates, present)


def in_usual_convention(dataset: Dataset, other: Convention | None) -> Dataset:
    """The data set with attitude 3-2-1 and body rates; itself where it has these."""
    if other is None:
        return dataset
    return dataset.changed(lambda flight: _of_flight(flight, other.form))


def _of_flight(flight: Flight, form: str) -> Flight:
    from scipy.spatial.transform import Rotation  # slow to import

    channels, recorded = (names.RATES if form == OF_ANGLES else names.ATTITUDES), (*names.RATES, *names.ATTITUDES)
    if not flight.has(*recorded):
        return flight
    values = flight.stack(recorded).numpy()
    whole = np.isfinite(values).all(axis=1)
    rates, angles = values[whole, :3], values[whole, 3:]
    if form == OF_ANGLES:
        usual = body_rates(angles, rates, USUAL)
    else:
        turns = Rotation.from_euler(form, angles[:, ["XYZ".index(letter) for letter in form]])
        usual = np.unwrap(turns.as_euler(USUAL)[:, ::-1], axis=0)
    columns = {name: flight.channels[name].clone() for name in channels}
    for column, name in zip(usual.T, channels, strict=True):
        columns[name][torch.from_numpy(whole)] = torch.from_numpy(column)
    return Flight(flight.name, flight.dt, {**flight.channels, **columns})
