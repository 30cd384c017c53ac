"""Lines of rotor vibration in a record's spectrum, and where its content ends."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LOWEST_HZ = 5.0
"""Vibration is looked for above this; below it the aircraft flies."""
SEGMENT_S = 3.0
SPAN_HZ = 2.5
"""A line wanders with the rotor's speed: what lies this near belongs to it."""


@dataclass(frozen=True)
class Line:
    """One line: frequency in Hz, rms in the channel's unit, share of the channel's variance."""

    hertz: float
    rms: float
    share: float


def spectrum(records: Sequence[np.ndarray], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and mean power per line of Hann segments without mean.

    The powers sum to the variance.
    """
    length = min(round(SEGMENT_S / dt), *(len(r) for r in records))
    window = np.hanning(length + 1)[:-1]
    segments = [
        part - part.mean()
        for record in records
        for part in np.lib.stride_tricks.sliding_window_view(record, length)[:: max(1, length // 2)]
        if np.isfinite(part).all()
    ]
    hertz = np.fft.rfftfreq(length, dt)
    if not segments:
        return hertz, np.zeros(len(hertz))
    power = (
        np.mean(np.abs(np.fft.rfft(np.array(segments) * window, axis=1)) ** 2, axis=0)
        * 2.0
        / ((window**2).sum() * length)
    )
    return hertz, power


def lines(hertz: np.ndarray, power: np.ndarray, largest: int = 3) -> list[Line]:
    """Strongest lines above 5 Hz that stand 10 times above the median of their surroundings, strongest first."""
    total, reach = power.sum(), max(5, int(np.searchsorted(hertz, 5.0)))
    peaks: list[Line] = []
    for index in np.argsort(power)[::-1]:
        if hertz[index] < LOWEST_HZ or total <= 0.0 or len(peaks) == largest:
            continue
        near = power[max(0, index - reach) : index + reach + 1]
        if power[index] < 10.0 * np.median(near) or any(abs(hertz[index] - line.hertz) < SPAN_HZ for line in peaks):
            continue
        strength = float(power[np.abs(hertz - hertz[index]) <= SPAN_HZ].sum())
        peaks.append(Line(float(hertz[index]), float(np.sqrt(strength)), strength / float(total)))
    return peaks


def content_ends(hertz: np.ndarray, power: np.ndarray, share: float = 0.999) -> float:
    """Frequency below which this share of the variance lies, Hz."""
    return float(hertz[int(np.searchsorted(np.cumsum(power), share * power.sum()).clip(max=len(hertz) - 1))])
