"""Signals of any rate on one grid: low-passed without phase where they are faster, gaps left missing."""

import math

import numpy as np
from scipy.interpolate import CubicHermiteSpline

GAP_S = 0.05
"""A pause longer than this and than 2.5 samples of either rate is a gap: what happened in it is not known."""
CUTOFF, HALF = 0.4, 6
"""Cut-off (half amplitude) in grid rates, and half length in grid intervals, of the low-pass: 1 % of amplitude lost at
a quarter of the grid's rate, less than 1 % left from 0.55 of it on."""
ROWS = 50_000
"""Grid points filtered at a time."""
FASTER = 1.2
"""A signal this much faster than the grid is low-passed."""
JUMP = 4.0
"""A step this many times as large as those to either side is a jump."""


def on_grid(time: np.ndarray, values: np.ndarray, grid: np.ndarray, smooth: bool = False) -> np.ndarray:
    """Values (T,) at the points of a uniform grid (n,), NaN outside the record and in gaps.

    A faster signal is interpolated to the next multiple of the grid's rate and averaged with a symmetric window of a
    sinc, so no phase is lost; missing samples have no weight. Others are interpolated linearly, or by cubics where the
    signal is `smooth` (an integral, such as a velocity): lines lose a tenth of what a record of 5 Hz has at 1 Hz.

    Source: Keys, Cubic convolution interpolation for digital image processing, IEEE Trans. ASSP 29 (1981), 1153.
    """
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    if len(time) < 2:
        return np.full(len(grid), np.nan)
    dt = float(grid[1] - grid[0]) if len(grid) > 1 else 1.0
    typical = float(np.median(np.diff(time)))
    gaps = np.diff(time) > max(GAP_S, 2.5 * typical, 2.5 * dt)
    multiple = math.ceil(dt / typical - 1e-3) if dt > FASTER * typical else 1
    if multiple == 1:
        inside = np.clip(grid, time[0], time[-1])
        between = np.interp(grid, time, values)
        if smooth:
            curve = CubicHermiteSpline(time, values, np.gradient(values, time))(inside)
            between = np.where(_near_jump(time, values, inside), between, curve)
        return np.where(_known(time, gaps, grid, 0.5 * min(typical, dt)), between, np.nan)
    kernel = lowpass(multiple)
    result = np.empty(len(grid))
    for first in range(0, len(grid), ROWS):
        part = slice(first, first + ROWS)
        result[part] = _filtered((time, values, gaps), grid[part], dt / multiple, kernel, multiple)
    return result


def _near_jump(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Whether times [n] lie next to a jump of a record, where a cubic would swing over: a position that is reset."""
    steps = np.pad(np.abs(np.diff(values)), 1)
    jumps = np.pad(steps[1:-1] > JUMP * np.maximum(steps[:-2], steps[2:]), 1)
    near = jumps[:-2] | jumps[1:-1] | jumps[2:]
    return near[np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(near) - 1)]


def lowpass(multiple: int) -> np.ndarray:
    """Weights of the low-pass at `multiple` samples per grid interval; their sum is 1.

    Source: Oppenheim and Schafer, Discrete-Time Signal Processing, ch. 7 (window method, Hamming).
    """
    reach = HALF * multiple
    at = np.arange(-reach, reach + 1)
    weights = np.sinc(2.0 * CUTOFF * at / multiple) * (0.54 + 0.46 * np.cos(np.pi * at / reach))
    return weights / weights.sum()


def _filtered(
    record: tuple[np.ndarray, np.ndarray, np.ndarray],
    grid: np.ndarray,
    fine_dt: float,
    kernel: np.ndarray,
    multiple: int,
) -> np.ndarray:
    """A record (time, values, gaps) through the low-pass `kernel`, one value in `multiple` fine ones."""
    time, values, gaps = record
    reach = len(kernel) // 2
    fine = grid[0] + fine_dt * np.arange(-reach, (len(grid) - 1) * multiple + reach + 1)
    present = _known(time, gaps, fine, fine_dt)
    held = np.where(present, np.interp(fine, time, values), 0.0)
    windows = (np.lib.stride_tricks.sliding_window_view(x, len(kernel))[::multiple] for x in (held, present * 1.0))
    total, weight = (window @ kernel for window in windows)
    usable = present[reach : len(fine) - reach : multiple] & (weight > 0.5)
    return np.where(usable, total / np.where(usable, weight, 1.0), np.nan)


def _known(time: np.ndarray, gaps: np.ndarray, at: np.ndarray, slack: float) -> np.ndarray:
    """Whether the record has something at these times: within its ends, and not inside a gap."""
    interval = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(gaps) - 1)
    near = np.minimum(at - time[interval], time[interval + 1] - at) <= slack
    return (at >= time[0] - slack) & (at <= time[-1] + slack) & (~gaps[interval] | near)
