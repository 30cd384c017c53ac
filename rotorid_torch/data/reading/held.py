"""Stretches without new samples: the last one held, a straight line, or a cubic drawn on, in several channels at once.

So are rows filled after a radio stopped, or across a gap. They are taken as missing samples on reading, and so are the
rows between of a slower stream whose last sample is held.
"""

import numpy as np

from rotorid_torch.core import names
from rotorid_torch.core.statistics import stretches
from rotorid_torch.data.reading.read import Arrays

LEAST_S, LEAST = 0.5, 20
"""Shortest stretch, in s and in samples."""
AT_ONCE = 3
"""Channels that have none at once; one that stands still may be a sensor's fault, which `check` tells."""
ORDER = 4
"""Differences of this order are zero where a record follows a cubic."""
ROUNDED = 64.0 * float(np.finfo(np.float32).eps)
"""Share of the largest value that rounding leaves of such a difference."""
ROUGH = 100.0
"""Times that, and more, is what half of a record's differences come to, so that a cubic stretch is none by chance."""


SLOWER = (names.ATTITUDES, names.VELOCITIES, names.POSITIONS)
"""Vectors of an estimator, which is often slower than the sensors beside it."""
ALIKE, CHANGES = 0.9, 15
"""Share of the intervals between changes that are the usual one, and intervals at least, by which a rhythm is known.

Of changes at random, at most a quarter of the intervals have one and the same length above 1. By chance nine tenths of
n have it with a probability below exp(-0.95 n) (Chernoff): with 15, once in a million records.
"""


def without_repeats(arrays: Arrays) -> Arrays:
    """Vectors (T,) of a slower stream, of which each sample is repeated so many times, with new samples only."""
    result = dict(arrays)
    for vector in (tuple(c for c in some if c in arrays) for some in SLOWER):
        same = [(arrays[c][1:] == arrays[c][:-1]) | np.isnan(arrays[c][1:]) for c in vector]
        repeated = np.concatenate([[False], np.all(same, axis=0)]) if same else np.zeros(1, bool)
        apart = np.diff(np.flatnonzero(~repeated))
        if len(apart) >= CHANGES and (usual := int(np.median(apart))) > 1 and np.mean(apart == usual) > ALIKE:
            result |= {c: np.where(repeated, np.nan, arrays[c]) for c in vector}
    return result


def without_held(arrays: Arrays) -> tuple[Arrays, list[str]]:
    """Measured channels (T,) with held and extrapolated stretches as NaN, and a sentence on each stretch."""
    time = arrays["time"]
    least = max(LEAST, round(LEAST_S * (len(time) - 1) / max(float(time[-1] - time[0]), 1e-12)))
    measured = [c for c in arrays if c != "time" and names.channel(c) is not None and not names.is_control(c)]
    runs = {channel: _cubic(arrays[channel], least) for channel in measured}
    runs = {channel: held for channel, held in runs.items() if held.any()}
    if len(runs) < AT_ONCE:
        return arrays, []
    together = np.sum([*runs.values()], axis=0) >= AT_ONCE
    result, sentences = dict(arrays), list[str]()
    for first, last in _long(together, least):
        inside = [channel for channel, held in runs.items() if held[first:last].mean() > 0.5]
        for channel in inside:
            result[channel] = np.where(runs[channel] & _between(len(time), first, last), np.nan, result[channel])
        span = f"from {time[first] - time[0]:.2f} to {time[last - 1] - time[0]:.2f} s"
        held_or_drawn = "the last one is held, or a line or cubic drawn on"
        sentences.append(f"{' '.join(inside)}: no new samples {span} ({held_or_drawn}), taken as missing")
    return result, sentences


def _between(count: int, first: int, last: int) -> np.ndarray:
    at = np.arange(count)
    return (at >= first) & (at < last)


def _cubic(values: np.ndarray, least: int) -> np.ndarray:
    """Samples (T,) after the first of each stretch that follows one cubic, for so many samples at least.

    None at the beginning, where a vehicle may stand, nor in records that are smooth or coarse all along.
    """
    none = np.zeros(len(values), bool)
    if len(values) < 4 * least:
        return none
    away = np.abs(np.diff(values, ORDER))
    finite = away[np.isfinite(away)]
    rounded = ROUNDED * float(np.nanmax(np.abs(values))) if len(finite) else 0.0
    if not len(finite) or float(np.median(finite)) <= ROUGH * rounded:
        return none
    for first, last in _long(away <= rounded, least - ORDER):
        if first > 0:
            none[first + 1 : last + ORDER] = True
    return none


def _long(true: np.ndarray, least: int) -> list[tuple[int, int]]:
    """Stretches of a record (T,) that are true for so many samples at least."""
    return [(first, last) for first, last in stretches(true) if last - first >= least]
