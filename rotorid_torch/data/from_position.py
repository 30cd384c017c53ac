"""Velocities from position and attitude, where a data set holds none: motion capture, and trackers on the ground."""

from __future__ import annotations

import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.data.schema import ChannelSpec

HALF = 0.15
"""s to either side over which a cubic is fitted: a body's velocity changes below 3 Hz, which passes unchanged."""
HELD = 0.5
"""Share of samples that repeat the one before, from which on a position is a slow one that was held."""


def with_velocities(dataset: Dataset) -> Dataset:
    """The data set with u v w in every flight, where none has any of them and all have position and attitude.

    The slope of a cubic through each 0.3 s of position (Savitzky and Golay, Analytical Chemistry 36, 1964), turned into
    body axes. Its noise follows from that of the position; `derived` tells that no score is to know these channels.
    """
    known = dataset.facts.values()
    measured = any(facts.has(c) for facts in known for c in VELOCITIES)
    if measured or not all(facts.has(*POSITIONS, *ATTITUDES) for facts in known):
        return dataset
    if any(_held(dataset.flights[name]) for name in dataset.flights):
        told = "u v w are not measured, and position is held for several samples: record it faster to have them from it"
        return replace(dataset, warnings=(*dataset.warnings, told))
    flights = OnDemand(dataset.flights, lambda name: _with_velocities(dataset.flights[name]))
    facts = {name: Facts.of(flight) for name, flight in flights.items()}
    gain = max(float(np.linalg.norm(_slope(f.dt, _half(f.dt)))) for f in known)
    level, upright = max(dataset.noise(c) for c in POSITIONS[:2]), dataset.noise(POSITIONS[2])
    noise = dict(zip(VELOCITIES, (gain * level, gain * level, gain * upright), strict=True))  # about level flight
    made = {c: ChannelSpec(noise=noise[c]) for c in VELOCITIES}
    size = f"{noise['u']:.2g}, w to {noise['w']:.2g} m/s"
    told = f"u v w are not measured: made from position and attitude, to about {size}, and not scored"
    return replace(
        dataset,
        flights=MappingProxyType(flights),
        facts=MappingProxyType(facts),
        channel_specs=MappingProxyType({**dataset.channel_specs, **made}),
        warnings=(*dataset.warnings, told),
        derived=frozenset(VELOCITIES),
    )


def _held(flight: Flight) -> bool:
    steps = np.diff(flight.stack(POSITIONS[:2]).numpy(), axis=0)
    moving = steps[~np.isnan(steps).any(axis=1)]
    return len(moving) > 0 and float((moving == 0.0).all(axis=1).mean()) > HELD


def _half(dt: float) -> int:
    """Samples to either side; a cubic needs two at least."""
    return max(2, round(HALF / dt))


def _slope(dt: float, half: int) -> np.ndarray:
    """Weights [2 half + 1] of the samples about one in the slope there of the cubic through them, 1/s."""
    time = dt * np.arange(-half, half + 1)
    return np.linalg.pinv(np.vander(time, 4, increasing=True))[1]


def _with_velocities(flight: Flight) -> Flight:
    """A flight with u v w; missing in the first and last 0.15 s, and about missing positions."""
    half = _half(flight.dt)
    position = flight.stack(POSITIONS).numpy()
    moving = np.full_like(position, math.nan)
    if len(position) > 2 * half:
        pieces = np.lib.stride_tricks.sliding_window_view(position, 2 * half + 1, axis=0)
        moving[half:-half] = pieces @ _slope(flight.dt, half)
    axes = torch.eye(3, dtype=torch.float64)[:, None]
    turned = rigid.position_rates(axes, flight.stack(ATTITUDES))  # [3, T, 3]: what each body axis' unit speed does
    velocity = torch.einsum("itk,tk->it", turned, torch.from_numpy(moving))
    channels = {**flight.channels, **dict(zip(VELOCITIES, velocity, strict=True))}
    return replace(flight, channels=MappingProxyType(channels))
