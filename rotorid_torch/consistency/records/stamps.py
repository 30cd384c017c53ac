"""The stamps of a record as they were written, before they were put on a uniform grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rotorid_torch.core.storage.files import open_file
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.reading import npz
from rotorid_torch.data.reading.grid import UNIFORM
from rotorid_torch.data.reading.read import CHANNELS, find_flight, parse_flight, read_flight


@dataclass(frozen=True)
class Clock:
    """Sample intervals of a flight in s: median, shortest, longest, and the share over 1 % off the median."""

    median: float
    shortest: float
    longest: float
    uneven: float

    @classmethod
    def of(cls, steps: np.ndarray) -> Clock:
        """Figures of intervals (T - 1,) in s."""
        median = float(np.median(steps))
        uneven = float(np.mean(np.abs(steps - median) > UNIFORM * median))
        return cls(median, float(steps.min()), float(steps.max()), uneven)


def clocks(dataset: Dataset) -> Mapping[str, Clock]:
    """Clock of every flight that lies in a file; none for arrays in memory, whose stamps are gone once resampled."""
    return {name: Clock.of(intervals(dataset.path, name)) for name in dataset.flights} if dataset.path else {}


def intervals(folder: Path, flight: str) -> np.ndarray:
    """Sample intervals (T - 1,) of a flight as recorded, s."""
    file = find_flight(folder, flight)
    if file.suffix == ".npz":
        with open_file(file, "a flight") as stream, npz.opened(file, stream, CHANNELS) as archive:
            return np.diff(np.asarray(archive.array("time"), dtype=np.float64))
    return np.diff(np.asarray(parse_flight(file, read_flight(file))["time"], dtype=np.float64))
