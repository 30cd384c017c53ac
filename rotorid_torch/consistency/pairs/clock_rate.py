"""Body rates and attitude whose clocks do not run equally fast: a lag that grows over every flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.pairs.alignment import Alignment, Sides, rates_by_attitude, rotation
from rotorid_torch.consistency.smoothing import EVERY_S, WIDTH_S
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
LEAST_S = 0.06
"""Lag that the difference must grow by in the longest piece, to matter."""
SURE = 5.0
"""Standard errors."""
LEAVES = 0.9
"""Share of what constant lags leave that the difference may leave."""


@dataclass(frozen=True)
class ClockRate:
    """By how much faster the attitude's clock falls behind that of the rates, s for each s, and its standard error."""

    drift: float
    se: float
    grown_s: float
    """Lag that it grows by in the longest piece."""


def clock_rate(flights: Sequence[Flight], by: Alignment) -> ClockRate | None:
    """Difference of the clocks of attitude and rates; None where none is beyond doubt.

    Rates by the attitude, taken a + b t later, are those of the IMU: Gauss-Newton for a of each piece and one b. Its
    standard error is the larger of that of the residuals, correlated over the Gaussian's width, and the jackknife's.
    """
    channels = ("p", "q", "r", "phi", "theta", "psi")
    sides = [rates_by_attitude(flight) for flight in flights if flight.has(*channels)]
    turned = [Sides(side.left @ rotation(by.turn), side.right) for side in sides]
    pieces = [piece for side in turned for piece in _pieces(side)]
    if not pieces:
        return None
    constant = _fitted(pieces, 0.0, free=False)
    best = min((_fitted(pieces, start) for start in STARTS), key=lambda fit: fit.left)
    if best.left > LEAVES * constant.left:
        return None
    longest = max(len(piece.left) for piece in pieces) * EVERY_S
    together = 2.0 * np.sqrt(np.pi) * WIDTH_S / EVERY_S
    samples = max(sum(piece.left.size for piece in pieces) - len(pieces) - 1, 1)
    power = float(best.power.sum())
    residual = float(np.sqrt(best.left / samples * together / max(power, np.finfo(float).tiny)))
    others = power - best.power
    without = best.drift - np.where(others > 0.0, best.along / np.where(others > 0.0, others, 1.0), 0.0)
    spread = float(np.sqrt(jackknife_variance(without))) if len(pieces) > 1 else 0.0
    se = max(residual, spread)
    sure = abs(best.drift) > SURE * se and abs(best.drift) * longest > LEAST_S
    return ClockRate(best.drift, se, best.drift * longest) if sure else None


def _pieces(side: Sides) -> list[Sides]:
    count = max(1, round(len(side.left) * EVERY_S / PIECE_S))
    parts = zip(np.array_split(side.left, count), np.array_split(side.right, count), strict=True)
    return [Sides(left, right) for left, right in parts if len(left) >= LEAST]


@dataclass(frozen=True)
class _Fit:
    """The difference of the clocks, squares that are left, and of each piece (n,) what it says of the difference."""

    drift: float
    left: float
    power: Array
    along: Array


def _fitted(pieces: Sequence[Sides], drift: float, free: bool = True) -> _Fit:
    """Gauss-Newton from a difference, the constant lag of each piece beside it; or with the difference held."""
    lags = np.zeros(len(pieces))
    for number in range(ITERATIONS):
        rows = [_row(piece, lag, drift) for piece, lag in zip(pieces, lags, strict=True)]
        aa, at, tt, ae, te, ee = np.array(rows).T
        whole = np.maximum(aa, np.finfo(float).tiny)
        power, along = tt - at**2 / whole, te - at * ae / whole
        if number == ITERATIONS - 1:
            return _Fit(drift, float(ee.sum()), power, along)
        change = float(along.sum() / max(power.sum(), np.finfo(float).tiny)) if free else 0.0
        lags, drift = lags + np.clip((ae - at * change) / whole, -0.2, 0.2), drift + change
    raise AssertionError


def _row(piece: Sides, lag: float, drift: float) -> tuple[float, ...]:
    """Products of slope, slope times time, and residual of a piece."""
    time = EVERY_S * (np.arange(len(piece.left)) - 0.5 * len(piece.left))
    at = time + lag + drift * time
    moved = np.stack([np.interp(at, time, column, left=np.nan, right=np.nan) for column in piece.left.T], axis=1)
    inside = np.isfinite(moved.sum(axis=1))
    moved = np.where(inside[:, None], moved, 0.0)
    right = np.where(inside[:, None], piece.right, 0.0)
    slope = np.gradient(moved, EVERY_S, axis=0)
    away, timed = right - moved, slope * time[:, None]
    pairs = ((slope, slope), (slope, timed), (timed, timed), (slope, away), (timed, away), (away, away))
    return tuple(float((a * b).sum()) for a, b in pairs)
