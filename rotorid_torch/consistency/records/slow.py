"""Channels that are sampled more slowly than the rows of their record, and missing in all rows between."""

import math
from collections.abc import Mapping

import numpy as np
import torch

from rotorid_torch.consistency.smoothing import WIDTH_S
from rotorid_torch.core import names
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

LEAST = 20
"""Samples of a channel whose rhythm can be told."""
ALIKE = 0.9
"""Share of its intervals that are the usual one."""
LOST = 0.05
"""Share of a motion at half the rate of the samples that the Gaussian of all comparisons lets pass, at most."""
SLOWEST = math.sqrt(2.0 * math.log(1.0 / LOST)) / (math.pi * WIDTH_S)
"""Hz: cubics through fewer samples hold other motion than what is compared, and stay missing. 9.7 Hz."""
GAP = 2.5
"""Usual intervals from which on a pause is a gap: what happened in it is not known."""


@once
def rhythms(dataset: Dataset) -> Mapping[str, float]:
    """Hz by measured channel that has one row in so many, in all flights with enough samples of the channel."""
    intervals: dict[str, list[float]] = {}
    for flight in dataset:
        for channel in filter(_measured, flight.channels):
            at = np.flatnonzero(np.isfinite(flight.channels[channel].numpy()))
            if len(at) > LEAST:
                intervals.setdefault(channel, []).append(_usual(at) * flight.dt)
    return {channel: 1.0 / float(np.median(some)) for channel, some in intervals.items() if min(some) > 0.0}


def slow_channels(dataset: Dataset) -> Mapping[str, float]:
    """Those of the rhythms whose samples tell what is between them, by channel."""
    return {channel: rate for channel, rate in rhythms(dataset).items() if rate > SLOWEST}


def _measured(channel: str) -> bool:
    return channel != "time" and names.channel(channel) is not None and not names.is_control(channel)


def _usual(at: np.ndarray) -> int:
    """Rows from sample to sample, which are at these; 0 where the rows are not alike, or none are between."""
    apart = np.diff(at)
    if 2 * np.count_nonzero(apart == 1) > len(apart):
        return 0
    usual = int(np.median(apart))
    return usual if float(np.mean(np.abs(apart - usual) <= max(1, 0.1 * usual))) > ALIKE else 0


def drawn_between(dataset: Dataset) -> Dataset:
    """The data set with these channels drawn by cubics from sample to sample; itself where there are none."""
    slow = slow_channels(dataset)
    if not slow:
        return dataset

    def of(flight: Flight) -> Flight:
        drawn = {c: torch.from_numpy(_drawn(v.numpy(), c)) for c, v in flight.channels.items() if c in slow}
        return Flight(flight.name, flight.dt, {**flight.channels, **drawn})

    return dataset.changed(of)


def _drawn(values: np.ndarray, channel: str) -> np.ndarray:
    """A record (T,) through its samples (Keys' cubics); missing before the first, after the last and in gaps.

    Source: Keys, Cubic convolution interpolation for digital image processing, IEEE Trans. ASSP 29 (1981), 1153.
    """
    at = np.flatnonzero(np.isfinite(values))
    if len(at) < LEAST:
        return values
    from scipy.interpolate import CubicHermiteSpline  # slow to import

    samples = np.unwrap(values[at]) if channel in names.ATTITUDES else values[at]
    rows, apart = np.arange(len(values)), np.diff(at)
    usual = float(np.median(apart))
    curve = CubicHermiteSpline(at, samples, np.gradient(samples, at))(rows)
    between = apart[np.clip(np.searchsorted(at, rows, side="right") - 1, 0, len(at) - 2)]
    inside = (rows >= at[0]) & (rows <= at[-1])
    return np.where(inside & ((between <= GAP * usual) | np.isfinite(values)), curve, np.nan)
