"""An attitude that is drawn to the accelerometers, or made of them: then it is none where the vehicle accelerates.

What body rates leave of the attitude's rates follows the tilt of the specific force: its rate of change, and how far
it is away, as in a complementary filter.

Source: Mahony, Hamel and Pflimlin, IEEE Transactions on Automatic Control 53 (2008), 1203, eq. 48 (gravity as a
reference direction).
"""

from dataclasses import dataclass

import numpy as np
import torch

from rotorid_torch.consistency.pairs.alignment import LEAST
from rotorid_torch.consistency.smoothing import EVERY_S, smoothed
from rotorid_torch.core import names
from rotorid_torch.core.rigid import euler_rates
from rotorid_torch.core.statistics import regression
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

WORTH = 0.01
"""Share of the attitude's rates that body rates leave, from which on there is something to explain."""
EXPLAINED = 0.2
"""Share of that which the specific force leaves at most: filters leave 0.01, a turned IMU 0.3."""


@dataclass(frozen=True)
class Drawn:
    """Shares of the rates of roll and pitch angle that body rates leave, and that the specific force leaves beside."""

    by_rates: float
    by_both: float


@once
def drawn(dataset: Dataset) -> Drawn | None:
    """How the attitude follows the specific force; None where body rates explain it as well, or a sensor is missing."""
    flights = (dataset.flights[name] for name in dataset.identify)
    needs = (*names.RATES, *names.ATTITUDES[:2], *names.SPECIFIC_FORCES)
    rows = [part for flight in flights if flight.has(*needs) for part in _rows(flight)]
    if not rows:
        return None
    axes = [np.concatenate(rows[axis::2]) for axis in (0, 1)]
    products = [axis.T @ axis for axis in axes]
    power = np.array([p[0, 0] for p in products])
    left = [np.array([float(regression(p[:n, :n])[1][0]) for p in products]) for n in (3, 5)]
    by_rates, by_both = (float(power @ shares / power.sum()) for shares in left)
    return Drawn(by_rates, by_both) if by_rates > WORTH and by_both < EXPLAINED * by_rates else None


def _rows(flight: Flight) -> list[Array]:
    """Of roll and pitch angle each: rate, that by body rates, its change, change and distance of the force's tilt."""
    angles, changes, present = smoothed(flight, names.ATTITUDES[:2])
    rates, turning, rates_present = smoothed(flight, names.RATES)
    (ax, ay, az), forces_present = (parts := smoothed(flight, names.SPECIFIC_FORCES))[0].T, parts[2]
    whole = present & rates_present & forces_present
    if whole.sum() < LEAST:
        return []
    tilt = np.stack([np.unwrap(np.arctan2(-ay, -az)), np.arctan2(ax, np.hypot(ay, az))], axis=1)
    by_rates, later = (euler_rates(*map(torch.from_numpy, (x, angles))).numpy()[:, :2] for x in (rates, turning))
    tilting, away = np.gradient(tilt, EVERY_S, axis=0), tilt - angles
    each = [np.stack([c[:, axis] for c in (changes, by_rates, later, tilting, away)], axis=1)[whole] for axis in (0, 1)]
    return [rows - rows.mean(axis=0) for rows in each]
