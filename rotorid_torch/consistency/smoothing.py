"""Records as streams are compared: through a Gaussian without phase, their rates of change, and moved in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorid_torch.data.flight import Flight

Array = np.ndarray

WIDTH_S = 0.08
"""Standard deviation of the Gaussian that both sides pass, in s: half power at 1.7 Hz, no phase."""
EVERY_S = 0.04
"""Interval of the samples that are compared: what has passed the Gaussian of 0.08 s loses little."""


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


def _smooth(values: Array, taps: Array) -> Array:
    return _columns([np.convolve(column, taps, "valid") for column in values.T], len(values) - len(taps) + 1)


def _columns(rows: Sequence[Array], samples: int) -> Array:
    """Rows (samples,) as columns of a table, which may have none."""
    return np.stack(rows, axis=1) if rows else np.empty((samples, 0))


def smoothed(flight: Flight, channels: Sequence[str]) -> tuple[Array, Array, Array]:
    """Channels (T, n) and their rates of change, smoothed, every `EVERY_S`; and where nothing was missing (T,)."""
    bell, slope = kernel(flight.dt)
    if flight.samples < 2 * len(bell):
        none = np.zeros((0, len(channels)))
        return none, none, np.zeros(0, bool)
    raw = flight.bridged(channels).numpy()
    missing = flight.stack(channels).isnan().any(dim=1).numpy().astype(float)
    whole = np.convolve(missing, np.ones(len(bell)), "valid") < 0.5
    at = np.arange(0.0, len(whole) - 1, EVERY_S / flight.dt)
    places = np.arange(len(whole))

    def picked(values: Array) -> Array:
        return _columns([np.interp(at, places, column) for column in values.T], len(at))

    return picked(_smooth(raw, bell)), picked(_smooth(raw, slope)), whole[np.round(at).astype(int)]


def centred(values: Array, present: Array) -> Array:
    """Deviations (T, n) from the mean of what is known, zero where nothing is."""
    present = present & np.isfinite(values).all(axis=1)
    mean = values[present].mean(axis=0) if present.any() else 0.0
    return np.where(present[:, None], values - mean, 0.0)
