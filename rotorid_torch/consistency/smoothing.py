"""Records as streams are compared: through a Gaussian without phase, their rates of change, and moved in time."""

from collections.abc import Sequence

import numpy as np

from rotorid_torch.data.flight import Flight

Array = np.ndarray

WIDTH_S = 0.08
"""Standard deviation of the Gaussian that both sides pass, in s: half power at 1.7 Hz, no phase."""
EVERY_S = 0.04
"""Interval of the samples that are compared: what has passed the Gaussian of 0.08 s loses little."""


ON_A_SAMPLE = 0.01
"""Samples by which the last of the samples that are compared may be off one of the record's."""


def kernel(dt: float, width_s: float = WIDTH_S) -> tuple[Array, Array]:
    """Gaussian and its derivative as convolution kernels, 4 widths each way."""
    half = max(2, round(4 * width_s / dt))
    time = dt * np.arange(-half, half + 1)
    bell = np.exp(-0.5 * (time / width_s) ** 2)
    slope = -time * bell
    return bell / bell.sum(), slope / (slope @ -time)


def correlated(interval: float) -> float:
    """Samples at this interval, s, that the Gaussian makes one: over its correlation in time, 2 sqrt(pi) widths."""
    return 2.0 * float(np.sqrt(np.pi)) * WIDTH_S / interval


def advanced(row: Array, by: float, margin: int) -> Array:
    """Samples (T - 2 margin,) of a row (T,), taken `by` samples later, between samples by a cubic through four."""
    whole = int(np.floor(by))
    s, start, count = by - whole, margin + whole, len(row) - 2 * margin
    if s == 0.0:
        return row[start : start + count]
    taps = (-s * (s - 1) * (s - 2), 3 * (s + 1) * (s - 1) * (s - 2), -3 * (s + 1) * s * (s - 2), (s + 1) * s * (s - 1))
    return np.convolve(row[start - 1 : start + count + 2], np.array(taps[::-1]) / 6.0, mode="valid")


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
    missing = flight.stack(channels).isnan().any(dim=1).numpy().astype(int)
    lost = np.concatenate([[0], np.cumsum(missing)])
    whole = lost[len(bell) :] == lost[: -len(bell)]
    at = np.arange(0.0, len(whole) - 1, EVERY_S / flight.dt)
    every = round(EVERY_S / flight.dt)
    if abs(at[-1] - (len(at) - 1) * every) < ON_A_SAMPLE:
        rows = [_through(column, np.stack([bell, slope]), every, len(at)) for column in raw.T]
    else:
        places = np.arange(len(whole))
        passed = ((np.convolve(column, taps, "valid") for taps in (bell, slope)) for column in raw.T)
        rows = [[np.interp(at, places, row) for row in both] for both in passed]
    smooth, changes = (_columns([both[i] for both in rows], len(at)) for i in (0, 1))
    return smooth, changes, whole[np.round(at).astype(int)]


def _through(row: Array, taps: Array, every: int, count: int) -> Array:
    """What a row (T,) is behind each of the taps (k, n), at so many places `every` samples apart, (k, count).

    In blocks of that many samples, of which each meets each part of the taps once.
    """
    blocks = -(-taps.shape[1] // every)
    parts = np.zeros((blocks * every, len(taps)))
    parts[: taps.shape[1]] = taps.T[::-1]
    padded = np.concatenate([row, np.zeros(blocks * every)])[: (count + blocks) * every].reshape(-1, every)
    each = (padded[b : b + count] @ parts[b * every : (b + 1) * every] for b in range(blocks))
    return sum(each, np.zeros((count, len(taps)))).T


def centred(values: Array, present: Array) -> Array:
    """Deviations (T, n) from the mean of what is known, zero where nothing is."""
    present = present & np.isfinite(values).all(axis=1)
    mean = values[present].mean(axis=0) if present.any() else 0.0
    return np.where(present[:, None], values - mean, 0.0)
