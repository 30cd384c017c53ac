"""White measurement noise, from what a channel holds above the motion; and the time before controls leave theirs."""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from rotorid_torch.data.flight import Flight

SEGMENT = 64
"""Samples of a segment: short, so that a control's edge spoils few of them."""
BAND = (0.6, 0.96)
"""Part of the Nyquist frequency that is read: above motion and its filters, below the edge."""
LEAST_S = 0.5
"""Shortest quiet time, s."""
SMOOTH_S = 0.1
"""Mean of a control that is compared, s."""


def white_noise(records: Iterable[np.ndarray], band: tuple[float, float] = BAND) -> float:
    """Standard deviation of a sample of the white noise in these records, each (T,); NaN where they are too short.

    Power in an upper `band` (shares of the Nyquist frequency) of short detrended Hann segments, median over segments
    (edges and spikes fall out) and then over frequencies (vibration lines fall out), scaled to the whole band. Missing
    samples leave out their segments.

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
    low, high = (round(share * SEGMENT / 2) for share in band)
    floor = np.median(np.median(power[:, low:high], axis=0)) / math.log(2.0)
    return float(math.sqrt(floor))


def _segments(record: np.ndarray) -> np.ndarray:
    if len(record) < SEGMENT:
        return np.empty((0, SEGMENT))
    cut = np.lib.stride_tricks.sliding_window_view(record, SEGMENT)[:: SEGMENT // 2]
    return cut[~np.isnan(cut).any(axis=1)]


def quiet_samples(flight: Flight, noise: Mapping[str, float], spread: Mapping[str, float]) -> int:
    """Samples before any control moves; at least 0.5 s.

    A control moves where it leaves its mean over the first 0.5 s by 5 standard deviations of its noise and by 5 % of
    its usual excursion, both smoothed over 0.1 s; the second leaves room for a controller that answers sensor noise.
    """
    width = max(1, round(SMOOTH_S / flight.dt))
    least = max(1, min(flight.samples, round(LEAST_S / flight.dt)))
    end = flight.samples
    for control, sigma in noise.items():
        values = flight.bridged([control])[:, 0].numpy()
        smooth = running_mean(values, width)
        bound = max(5.0 * sigma / np.sqrt(width), 0.05 * spread[control])
        moved = np.abs(smooth - values[:least].mean()) > bound
        if moved.any():
            end = min(end, int(moved.argmax()) - width // 2)
    return max(least, end)


def running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Centred mean over `width` samples, over what there is at the ends."""
    total, count = (np.convolve(x, np.ones(width), "same")[: len(values)] for x in (values, np.ones_like(values)))
    return total / count
