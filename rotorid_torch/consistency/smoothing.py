"""Records as streams are compared: through a Gaussian without phase, their rates of change, and moved in time."""

from __future__ import annotations

import numpy as np

Array = np.ndarray

WIDTH_S = 0.08
"""Standard deviation of the Gaussian that both sides pass, in s: half power at 1.7 Hz, no phase."""


def kernel(dt: float, width_s: float = WIDTH_S) -> tuple[Array, Array]:
    """Gaussian and its derivative as convolution kernels, 4 widths each way."""
    half = max(2, round(4 * width_s / dt))
    time = dt * np.arange(-half, half + 1)
    bell = np.exp(-0.5 * (time / width_s) ** 2)
    slope = -time * bell
    return bell / bell.sum(), slope / (slope @ -time)


def advanced(row: Array, by: float, margin: int) -> Array:
    """Samples (T - 2 margin,) of a row (T,), taken `by` samples later, between samples by a cubic through four."""
    whole = int(np.floor(by))
    s, start, count = by - whole, margin + whole, len(row) - 2 * margin
    if s == 0.0:
        return row[start : start + count]
    taps = (-s * (s - 1) * (s - 2), 3 * (s + 1) * (s - 1) * (s - 2), -3 * (s + 1) * s * (s - 2), (s + 1) * s * (s - 1))
    return np.convolve(row[start - 1 : start + count + 2], np.array(taps[::-1]) / 6.0, mode="valid")
