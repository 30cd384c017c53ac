"""Flights of different sample rates on one rate, for steps that take all flights as one batch."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch

from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

SAME = 5e-4
"""Relative difference of two sample intervals up to which they are one."""


def at_one_rate(dataset: Dataset) -> Dataset:
    """The data set with every flight at the slowest flight's rate; itself where the rates are the same.

    Faster flights are averaged over one interval of the slow grid and interpolated linearly, all channels alike, so
    that what relates them stays; a sentence in `warnings` says so.
    """
    intervals = [facts.dt for facts in dataset.facts.values()]
    slow = max(intervals)
    if slow - min(intervals) <= SAME * slow:
        return dataset
    remark = (
        f"flights are recorded at {1.0 / slow:.4g} to {1.0 / min(intervals):.4g} Hz: the three steps see all of them at"
        f" {1.0 / slow:.4g} Hz, free runs are judged as recorded; record at one rate if fast dynamics matter"
    )
    return replace(dataset.changed(lambda flight: _slowed(flight, slow)), warnings=(*dataset.warnings, remark))


def _slowed(flight: Flight, dt: float) -> Flight:
    if dt - flight.dt <= SAME * dt:
        return flight
    time = flight.time.numpy()
    grid = dt * np.arange(max(2, int(time[-1] / dt + 1e-6) + 1))
    half = int(round(dt / flight.dt) - 1) // 2
    channels = {name: _averaged(values.numpy(), half) for name, values in flight.channels.items() if name != "time"}
    slowed = {name: torch.from_numpy(np.interp(grid, time, values)) for name, values in channels.items()}
    return Flight(flight.name, dt, MappingProxyType({"time": torch.from_numpy(grid), **slowed}))


def _averaged(values: np.ndarray, half: int) -> np.ndarray:
    """Centred mean over 2 half + 1 samples, of fewer at the ends; a missing sample makes its neighbours missing."""
    padded = np.concatenate([np.full(half, np.inf), values, np.full(half, np.inf)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    return np.mean(windows, axis=1, where=~np.isinf(windows))
