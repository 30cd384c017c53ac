"""Streams that are far off against others which only a model ties to them: linear regression at every lag.

Velocities without accelerometers follow gravity and drag; angular accelerations follow
controls and motion. The lag is where least is left, over the whole record.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from rotorid_torch.consistency.sensor_pairs import (
    CLOSELY,
    REACH_S,
    WITHIN_S,
    Pair,
    agreement,
    position_pairs,
)
from rotorid_torch.consistency.smoothing import EVERY_S, kernel, smoothed
from rotorid_torch.core import names
from rotorid_torch.core.rigid import gravity_in_body
from rotorid_torch.core.statistics import jackknife_variance, regression, without_line
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray
Blocks = tuple[Array, Array]
"""Columns of a flight (T, n), NaN where unknown: of the stream that is moved, and of the others."""
Columns = Callable[[Array, Array], Array]
"""Regression of two blocks at the same times: what is explained, then what explains it, (T, n)."""

LONGEST_S, REACHED = 6.0, 0.65
"""Largest lag, in s, and as a share of the shortest flight that is looked at."""
FLIGHTS, SAMPLES = 8, 3000
"""Flights that are looked at, at most, and samples of each, every `EVERY_S`: two minutes."""
LEAST = 100
"""Samples of a flight that is used."""
ANSWER_S = 1.0
"""About as long as a vehicle answers: lags that are closer explain the same."""
EXPLAINED = 0.5
"""Share of a response that is explained at its best lag, at least, for it to count."""
SURE = 4.0
"""Standard errors."""


@dataclass(frozen=True)
class FarLag:
    """Time in s by which a stream comes after the others, its standard error, the share that is left there.

    left_near : the least share that is left at the lags that need no other clock. elsewhere : the same at lags further
    than `ANSWER_S` from this one.
    """

    seconds: float
    se: float
    left: float
    left_near: float
    elsewhere: float

    @property
    def alone(self) -> bool:
        """Whether no other lag explains as much as counts: what swings alike for long fits at several."""
        return self.elsewhere > 1.0 - EXPLAINED


def lag_of_velocities(flights: Sequence[Flight], gravity: float) -> FarLag | None:
    """Lag of u v w against attitude and rates, drag beside; None where it cannot be known.

    Rates and controls are no terms: with them the tilt a moment ago is a sum of theirs, and any lag fits.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., eq. 3.35.
    """
    needs = (*names.VELOCITIES, *names.RATES, *names.ATTITUDES[:2])

    def blocks(flight: Flight) -> Blocks:
        velocity, change, present = smoothed(flight, names.VELOCITIES)
        others, _, others_present = smoothed(flight, names.RATES)
        tilt, _, tilt_present = smoothed(flight, names.ATTITUDES[:2])
        fall = gravity_in_body(torch.from_numpy(tilt), gravity).numpy()[:, :2] if len(tilt) else tilt
        moved = np.where(present[:, None], np.concatenate([velocity, change[:, :2]], axis=1), np.nan)
        whole = (others_present & tilt_present)[:, None]
        return moved, np.where(whole, np.concatenate([fall, others], axis=1), np.nan)

    def columns(moved: Array, fixed: Array) -> Array:
        z, changed, w = moved[:, 0] + 1j * moved[:, 1], moved[:, 3] + 1j * moved[:, 4], moved[:, 2]
        fall, (p, q, r) = fixed[:, 0] + 1j * fixed[:, 1], fixed[:, 2:5].T
        terms = [fall, 1j * w * (p + 1j * q), z, z.conj(), w]
        return np.stack([changed + 1j * r * z, *terms], axis=1)

    return _scanned([blocks(f) for f in flights[:FLIGHTS] if f.has(*needs)], columns, 1, (0.0, 0.0))


def lag_of_positions(flights: Sequence[Flight], pair: Pair) -> FarLag | None:
    """Lag of a position, by its rate of change, against the velocity; None where it cannot be known."""

    def blocks(flight: Flight) -> Blocks:
        _, change, present = smoothed(flight, [pair.left_name])
        whole = flight.stack(pair.channels).isnan().any(dim=1).logical_not().numpy()
        bell = kernel(flight.dt)[0]
        along = np.convolve(pair.right(flight), bell, "valid")
        missing = np.convolve(~whole, np.ones(len(bell)), "valid") > 0.5
        at = np.arange(0.0, len(along) - 1, EVERY_S / flight.dt)[: len(change)]
        fixed = np.interp(at, np.arange(len(along)), np.where(missing, np.nan, along))
        return np.where(present[:, None], change, np.nan), fixed[:, None]

    chosen = [blocks(f) for f in flights[:FLIGHTS] if f.has(*pair.channels)]
    return _scanned(chosen, lambda moved, fixed: np.concatenate([moved, fixed], axis=1), 1, (-REACH_S, REACH_S))


@once
def late_positions(dataset: Dataset) -> Mapping[str, FarLag]:
    """Positions whose clock differs from that of velocity and attitude by more than pairs are searched for, by name.

    What swings alike for long fits at several lags: one is known where others leave twice as much, or it leaves little.
    """
    flights, late = [dataset.flights[name] for name in dataset.identify], dict[str, FarLag]()
    for pair in position_pairs():
        near = agreement(pair, flights)
        if near is None or (near.r2 >= CLOSELY and abs(near.lag_s) <= WITHIN_S):
            continue
        far = lag_of_positions(flights, pair)
        distinct = far and (far.alone or far.left < max(0.5 * far.elsewhere, 1.0 - CLOSELY))
        if far and distinct and abs(far.seconds) > WITHIN_S + SURE * far.se:
            late[pair.left_name] = far
    return late


def lag_of_controls(
    flights: Sequence[Flight], controls: Sequence[str], near: tuple[float, float], *, alone: bool = False
) -> FarLag | None:
    """Lag of the controls against the angular accelerations that follow them; None without these.

    Motion stands beside them, but not beside motors: little else turns a multirotor, and a controller makes motors of
    motion, at any lag.

    near : lags in s that a vehicle's answer, or what other examinations find, may have. alone : no motion beside them.
    """
    flights = [flight for flight in flights[:FLIGHTS] if flight.has(*names.RATES, *controls)]
    others = (*names.RATES, *names.ATTITUDES[:2], *names.VELOCITIES)
    alone = alone or all(map(names.is_motor, controls))
    motion = [] if alone else [c for c in others if all(f.has(c) for f in flights)]

    def blocks(flight: Flight) -> Blocks:
        moved, _, present = smoothed(flight, controls)
        _, turning, _ = smoothed(flight, names.RATES)
        states, _, whole = smoothed(flight, [*names.RATES, *motion])
        fixed = np.concatenate([turning, states[:, len(names.RATES) :]], axis=1)
        return np.where(present[:, None], moved, np.nan), np.where(whole[:, None], fixed, np.nan)

    def columns(moved: Array, fixed: Array) -> Array:
        return np.concatenate([fixed[:, :3], moved, fixed[:, 3:]], axis=1)

    return _scanned([blocks(flight) for flight in flights], columns, len(names.RATES), near)


def _scanned(flights: Sequence[Blocks], columns: Columns, responses: int, near: tuple[float, float]) -> FarLag | None:
    """The lag of least misfit; None where it is at the end of the range, or too little is explained."""
    flights = [(moved[:SAMPLES], fixed[:SAMPLES]) for moved, fixed in flights if len(moved) >= LEAST]
    if not flights:
        return None
    most = int(min(LONGEST_S / EVERY_S, REACHED * min(len(moved) for moved, _ in flights)))
    lags = np.arange(-most, most + 1)
    measured = [(np.isfinite(moved.sum(axis=1)), np.isfinite(fixed.sum(axis=1))) for moved, fixed in flights]
    pieces = list(zip(flights, measured, strict=True))
    products = np.array([[_products(*piece, int(lag), columns) for piece in pieces] for lag in lags])

    def unexplained(whole: Array) -> Array:
        return regression(whole, responses)[1]

    each = np.array([unexplained(whole) for whole in products.sum(axis=1)])
    shown = each.min(axis=0) < 1.0 - EXPLAINED  # what nothing explains has no lag
    if not shown.any():
        return None
    left = each[:, shown].mean(axis=1)
    inside = (lags * EVERY_S >= near[0] - 0.5 * EVERY_S) & (lags * EVERY_S <= near[1] + 0.5 * EVERY_S)
    best = int(np.argmin(left))
    if best in (0, len(lags) - 1) or not inside.any():
        return None

    def peak(around: Array) -> float:
        below, at, above = around
        bend = below - 2.0 * at + above
        return float(lags[best] + (0.5 * (below - above) / bend if bend > 0.0 else 0.0)) * EVERY_S

    three = products[best - 1 : best + 2]
    others = [np.array([unexplained(p.sum(axis=0) - p[k])[shown].mean() for p in three]) for k in range(len(flights))]
    spread = float(np.sqrt(jackknife_variance(np.array([peak(o) for o in others])))) if len(flights) > 1 else EVERY_S
    se = max(spread, 0.1 * EVERY_S)
    elsewhere = float(left[np.abs(lags - lags[best]) * EVERY_S > ANSWER_S].min(initial=1.0))
    return FarLag(peak(left[best - 1 : best + 2]), se, float(left[best]), float(left[inside].min()), elsewhere)


def _products(blocks: Blocks, measured: Blocks, lag: int, columns: Columns) -> Array:
    """Products (n, n) of the columns of a flight, the moved stream taken so many samples later.

    measured : rows (T,) of the blocks in which nothing is missing.
    """
    count, starts = len(blocks[0]) - abs(lag), (max(lag, 0), max(-lag, 0))
    whole = np.logical_and(*(rows[at : at + count] for rows, at in zip(measured, starts, strict=True)))
    both = without_line(columns(*(block[at : at + count][whole] for block, at in zip(blocks, starts, strict=True))))
    return both.conj().T @ both / max(len(both), 1)
