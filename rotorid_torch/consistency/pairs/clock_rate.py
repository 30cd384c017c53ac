"""Body rates and attitude whose clocks do not run equally fast: a lag that grows over every flight."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.pairs.alignment import Sides, rates_by_attitude
from rotorid_torch.consistency.smoothing import EVERY_S, correlated
from rotorid_torch.core.statistics import jackknife_variance
from rotorid_torch.data.flight import Flight

Array = np.ndarray

PIECE_S = 40.0
"""Longer flights count as several, each with a constant lag of its own: what clocks differ by grows within each."""
LEAST = 100
"""Samples of a piece that is used, every `EVERY_S`."""
STARTS = (0.0, -0.02, 0.02, -0.05, 0.05)
"""Differences of the clocks from which the search begins."""
ITERATIONS = 8
MOST = 0.1
"""Largest difference of the clocks that is looked for: beyond it the records are not of one flight."""
LEAST_S = 0.06
"""Lag that the difference must grow by in the longest piece, to matter."""
SURE = 5.0
"""Standard errors."""
LEAVES = 0.9
"""Share of what constant lags leave that the difference may leave."""
EXPLAINED = 0.5
"""Share of the rates' power that the attitude must explain with it: what disagrees has no clock in common."""


@dataclass(frozen=True)
class ClockRate:
    """By how much faster the attitude's clock falls behind that of the rates, s for each s, and its standard error."""

    drift: float
    se: float
    grown_s: float
    """Lag that it grows by in the longest piece."""


def clock_rate(flights: Sequence[Flight]) -> ClockRate | None:
    """Difference of the clocks of attitude and rates; None where none is beyond doubt.

    flights : with large errors (`alignment`) taken out.

    Rates by the attitude, taken a + b t later, are those of the IMU: Gauss-Newton for a of each piece and one b. Its
    standard error is the larger of that of the residuals, correlated over the Gaussian's width, and the jackknife's.
    """
    channels = ("p", "q", "r", "phi", "theta", "psi")
    sides = [rates_by_attitude(flight) for flight in flights if flight.has(*channels)]
    pieces = [piece for side in sides for piece in _pieces(side)]
    if not pieces:
        return None
    constant = _fitted(pieces, 0.0, free=False)
    best = min((_fitted(pieces, start) for start in STARTS), key=lambda fit: fit.mean)
    power = sum(float((piece.right**2).sum()) for piece in pieces) / sum(piece.present[1].sum() for piece in pieces)
    if best.mean > min(LEAVES * constant.mean, (1.0 - EXPLAINED) * power) or abs(best.drift) >= MOST:
        return None
    longest = max(len(piece.left) for piece in pieces) * EVERY_S
    together = correlated(EVERY_S)
    samples = max(3 * best.samples - len(pieces) - 1, 1)
    says = float(best.power.sum())
    residual = float(np.sqrt(best.left / samples * together / max(says, np.finfo(float).tiny)))
    others = says - best.power
    without = best.drift - np.where(others > 0.0, best.along / np.where(others > 0.0, others, 1.0), 0.0)
    spread = float(np.sqrt(jackknife_variance(without))) if len(pieces) > 1 else 0.0
    se = max(residual, spread)
    sure = abs(best.drift) > SURE * se and abs(best.drift) * longest > LEAST_S
    return ClockRate(best.drift, se, best.drift * longest) if sure else None


def _pieces(side: Sides) -> list[Sides]:
    count = max(1, round(len(side.left) * EVERY_S / PIECE_S))
    parts = zip(np.array_split(side.left, count), np.array_split(side.right, count), strict=True)
    pieces = (Sides(left, right) for left, right in parts)
    return [piece for piece in pieces if piece.pairs >= LEAST]


@dataclass(frozen=True)
class _Fit:
    """The difference of the clocks, squares that are left, and of each piece (n,) what it says of the difference.

    samples : how many meet, of all pieces.
    """

    drift: float
    left: float
    samples: int
    power: Array
    along: Array

    @property
    def mean(self) -> float:
        """Squares that are left of each sample that is compared; infinite where none is."""
        return self.left / self.samples if self.samples else np.inf


def _fitted(pieces: Sequence[Sides], drift: float, free: bool = True) -> _Fit:
    """Gauss-Newton from a difference, the constant lag of each piece beside it; or with the difference held."""
    lags = np.zeros(len(pieces))
    for number in range(ITERATIONS):
        rows = [_row(piece, lag, drift) for piece, lag in zip(pieces, lags, strict=True)]
        aa, at, tt, ae, te, ee, inside = np.array(rows).T
        whole = np.maximum(aa, np.finfo(float).tiny)
        power, along = tt - at**2 / whole, te - at * ae / whole
        if number == ITERATIONS - 1:
            return _Fit(drift, float(ee.sum()), round(inside.sum()), power, along)
        change = float(along.sum() / max(power.sum(), np.finfo(float).tiny)) if free else 0.0
        lags, drift = lags + np.clip((ae - at * change) / whole, -0.2, 0.2), float(np.clip(drift + change, -MOST, MOST))
    raise AssertionError


def _row(piece: Sides, lag: float, drift: float) -> tuple[float, ...]:
    """Products of slope, slope times time, and residual of a piece where both sides are there; how many samples."""
    time = EVERY_S * (np.arange(len(piece.left)) - 0.5 * len(piece.left))
    at = time + lag + drift * time
    present = piece.present[:, :, None] > 0.0
    left, right = np.where(present[0], piece.left, np.nan), np.where(present[1], piece.right, np.nan)
    moved = np.stack([np.interp(at, time, column, left=np.nan, right=np.nan) for column in left.T], axis=1)
    slope = np.gradient(moved, EVERY_S, axis=0)
    inside = np.isfinite((slope + moved + right).sum(axis=1))
    slope, away = slope[inside], (right - moved)[inside]
    timed = slope * time[inside, None]
    pairs = ((slope, slope), (slope, timed), (timed, timed), (slope, away), (timed, away), (away, away))
    return (*(float((a * b).sum()) for a, b in pairs), float(inside.sum()))
