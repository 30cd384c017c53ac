"""Standard deviation of white measurement noise, from what a channel holds above the band of the motion."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

SEGMENT = 64
"""Samples of a segment: short, so that a control's edge spoils few of them."""
BAND = (0.6, 0.96)
"""Part of the Nyquist frequency that is read: above motion and its filters, below the edge."""


def white_noise(records: Iterable[np.ndarray]) -> float:
    """Standard deviation of a sample of the white noise in these records, each (T,); NaN where they are too short.

    Power in the upper band of short detrended Hann segments, median over segments (edges and spikes fall out) and then
    over frequencies (vibration lines fall out), scaled to the whole band. Missing samples leave out their segments.

    Source: Welch, IEEE Trans. Audio Electroacoustics 15 (1967); the median of a periodogram is ln 2 times its mean
    (chi-squared, two degrees of freedom).
    """
    segments = np.concatenate([_segments(record) for record in records] or [np.empty((0, SEGMENT))])
    if not len(segments):
        return math.nan
    ramp = np.linspace(-1.0, 1.0, SEGMENT)
    centred = segments - segments.mean(axis=1, keepdims=True)
    centred -= (centred @ ramp / (ramp @ ramp))[:, None] * ramp
    window = np.hanning(SEGMENT + 1)[:-1]
    power = np.abs(np.fft.rfft(centred * window, axis=1)) ** 2 / (window**2).sum()
    low, high = (round(share * SEGMENT / 2) for share in BAND)
    floor = np.median(np.median(power[:, low:high], axis=0)) / math.log(2.0)
    return float(math.sqrt(floor))


def _segments(record: np.ndarray) -> np.ndarray:
    if len(record) < SEGMENT:
        return np.empty((0, SEGMENT))
    cut = np.lib.stride_tricks.sliding_window_view(record, SEGMENT)[:: SEGMENT // 2]
    return cut[~np.isnan(cut).any(axis=1)]
