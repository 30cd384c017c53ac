"""Ends of flights on the ground: all motors stand still, and nothing is to be learnt of how the vehicle flies."""

from types import MappingProxyType

import numpy as np

from rotorid_torch.consistency.records.excitation import motors_off
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

LEAST_S = 1.0
"""Shortest stretch, s: motors may stop for a moment."""
FLOWN_S = 4.0
"""Least time in the air, s, of a flight whose ends are left out."""


@once
def on_ground(dataset: Dataset) -> dict[str, tuple[float, float]]:
    """By flight the s at its beginning and at its end in which all motors are off, where these are long."""
    parts = {f.name: _ends(motors_off(dataset, f), f.dt) for f in dataset}
    return {name: ends for name, ends in parts.items() if max(ends) > 0.0}


def _ends(off: np.ndarray, dt: float) -> tuple[float, float]:
    flown = np.flatnonzero(~off)
    if not len(flown) or (flown[-1] - flown[0]) * dt < FLOWN_S:
        return 0.0, 0.0
    before, after = float(flown[0]) * dt, float(len(off) - 1 - flown[-1]) * dt
    return before if before > LEAST_S else 0.0, after if after > LEAST_S else 0.0


def in_the_air(dataset: Dataset) -> Dataset:
    """The data set without these ends of its flights; itself where there are none."""
    ends = on_ground(dataset)
    if not ends:
        return dataset
    return dataset.changed(lambda flight: _between(flight, *ends.get(flight.name, (0.0, 0.0))))


def _between(flight: Flight, before: float, after: float) -> Flight:
    flown = slice(round(before / flight.dt), flight.samples - round(after / flight.dt))
    channels = {name: values[flown] for name, values in flight.channels.items()}
    channels["time"] = channels["time"] - channels["time"][0]
    return Flight(flight.name, flight.dt, MappingProxyType(channels))
