"""Telemetry spikes: single samples far beyond everything else in their channel, taken as missing samples on reading."""

import math

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.data.reading.read import Arrays

LONGEST = 3
"""Samples of a spike, at most; what lasts longer is motion, or a sensor's fault that a person should see."""
LONGEST_S = 0.03
"""The same of a control in s: a pilot's tap is no spike, however far it goes."""
BEYOND = 6.0
"""How many times the channel's whole range a spike is away: no motion leaves that and comes back in three samples."""
STEPS = 30.0
"""How many steps of the record's resolution it is away at least, so that a channel's last digit is none."""
RARE = 0.01
"""Share of a record that can be spikes; where there are more, the unit or the sensor is wrong."""
TURN = 2.2 * math.pi
"""Angles that wrap jump by a turn: a spike of theirs is larger."""


def without_spikes(arrays: Arrays) -> tuple[Arrays, list[str]]:
    """Channels (T,) with spikes as NaN, and a sentence on each channel that had any; "time" is left alone."""
    smooth, sentences = dict(arrays), []
    for channel, values in arrays.items():
        at = spikes(channel, values, arrays["time"]) if channel != "time" else np.empty(0, int)
        if len(at):
            smooth[channel] = values.copy()
            smooth[channel][at] = np.nan
            sentences.append(_sentence(channel, values, at, arrays["time"]))
    return smooth, sentences


def spikes(channel: str, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Indices of the spikes of one channel (T,): out and back within `LONGEST` samples, far beyond its whole range.

    The range is that of a running median over twice as many samples and one, which spikes do not enter.

    Source: Tukey, Exploratory Data Analysis (1977), ch. 7, for running medians.
    """
    index = np.flatnonzero(np.isfinite(values))
    x = values[index]
    longest = LONGEST
    if names.is_control(channel):
        longest = min(longest, round(LONGEST_S * (len(time) - 1) / max(float(time[-1] - time[0]), 1e-12)))
    if len(x) < 8 * LONGEST or longest < 1 or not _jumps(x):
        return np.empty(0, int)
    middle = running_median(x, longest)
    away, steps = np.abs(x - middle), np.abs(np.diff(x))
    least = TURN if channel in ("phi", "psi") else 0.0
    bound = max(BEYOND * float(np.ptp(middle)), STEPS * float(steps[steps > 0.0].min()), least)
    at = np.flatnonzero(away > bound)
    return index[at] if len(at) <= RARE * len(x) else np.empty(0, int)


def _jumps(x: np.ndarray) -> bool:
    """Whether any sample is far enough from the next to be worth the medians: beyond the range of the block means."""
    blocks = np.median(x[: len(x) // 16 * 16].reshape(-1, 16), axis=1)
    return float(np.abs(np.diff(x)).max(initial=0.0)) > BEYOND * float(np.ptp(blocks))


def running_median(x: np.ndarray, half: int) -> np.ndarray:
    """Median (T,) of each sample and `half` neighbours on either side; at the ends of what the record begins with."""
    edge = 4 * half  # so many that a spike is not their median
    padded = np.concatenate([np.full(half, np.median(x[:edge])), x, np.full(half, np.median(x[-edge:]))])
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)


def _sentence(channel: str, values: np.ndarray, at: np.ndarray, time: np.ndarray) -> str:
    others = np.delete(values, at)
    worst = values[at[np.argmax(np.abs(values[at] - np.nanmedian(others)))]]
    many = "a spike" if len(at) == 1 else f"{len(at)} spike samples"
    unit = names.unit(channel)
    span = f"{np.nanmin(others):.4g} to {np.nanmax(others):.4g}{f' {unit}' if unit else ''} otherwise"
    first = time[at[0]] - time[0]
    return f"{channel} has {many} of up to {worst:.4g} ({span}) from {first:.2f} s on: taken as missing samples"
