"""Data sets with other records: what a study puts into all flights of a data set that somebody else made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import torch

from rotorid_torch.data import Dataset
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight

Records = Mapping[str, np.ndarray]


def changed(dataset: Dataset, change: Callable[[int, Flight], Records]) -> Dataset:
    """The data set with new records in each flight, told its number; the others stay."""
    flights = {}
    for k, (name, flight) in enumerate(dataset.flights.items()):
        new = {c: torch.from_numpy(np.ascontiguousarray(v)) for c, v in change(k, flight).items()}
        flights[name] = replace(flight, channels={**flight.channels, **new})
    return replace(dataset, flights=flights, facts={name: Facts.of(flight) for name, flight in flights.items()})


def smoothed(values: np.ndarray, samples: int) -> np.ndarray:
    """A record under a Hann window of so many samples to each side, its ends held."""
    window = np.hanning(2 * samples + 3)[1:-1]
    return np.convolve(np.pad(values, samples, mode="edge"), window / window.sum(), "valid")
