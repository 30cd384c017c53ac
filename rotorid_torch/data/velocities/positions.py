"""Velocities from position and attitude: motion capture, and trackers on the ground."""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

HALF = 0.15
"""s to either side over which a cubic is fitted: a body's velocity changes below 3 Hz, which passes unchanged."""
FEW = 10
"""Identify flights that the noise is estimated from, at most."""


def differentiated(flight: Flight) -> Flight:
    """A flight with u v w by the slope of a cubic through each 0.3 s of position.

    They are missing in the first and last 0.15 s, and about missing positions.

    Source: Savitzky and Golay, Analytical Chemistry 36 (1964).
    """
    half = _half(flight.dt)
    position = flight.stack(POSITIONS).numpy()
    moving = np.full_like(position, math.nan)
    if len(position) > 2 * half:
        moving[half:-half] = _pieces(position, half) @ _cubic(flight.dt, half)[1]
    return with_velocity(flight, rigid.velocity_in_body(torch.from_numpy(moving), flight.stack(ATTITUDES)))


def with_velocity(flight: Flight, velocity: Tensor) -> Flight:
    """The flight with u v w, m/s [T, 3]."""
    channels = {**flight.channels, **dict(zip(VELOCITIES, velocity.unbind(-1), strict=True))}
    return replace(flight, channels=MappingProxyType(channels))


def noise_of(dataset: Dataset, flights: Mapping[str, Flight]) -> dict[str, float]:
    """Standard deviation of u v w, m/s, about level flight: by the positions' noise, and by that of their axes.

    A position's noise is declared, or what the cubics leave of it: its spectrum shows the way that was flown.
    """
    gains, left, squares = [], [], []
    for flight in (flights[name] for name in dataset.some(FEW)):
        half = _half(flight.dt)
        fit = _cubic(flight.dt, half)
        pieces = _pieces(flight.stack(POSITIONS).numpy(), half)
        left.append(np.nanmean((pieces[..., half] - pieces @ fit[0]) ** 2, axis=0) / (1.0 - fit[0, half]))
        gains.append(float(np.linalg.norm(fit[1])))
        squares.append(float(flight.stack(VELOCITIES).square().sum(dim=-1).nanmean()))
    specs = [dataset.channel_specs.get(c) for c in POSITIONS]
    estimated = np.sqrt(np.mean(left, axis=0))
    north, east, height = (s.noise if s and s.noise else float(e) for s, e in zip(specs, estimated, strict=True))
    turned = math.sqrt(np.mean(squares)) * max(dataset.noise(c) for c in ATTITUDES)
    level, upright = (math.hypot(max(gains) * sd, turned) for sd in (max(north, east), height))
    return dict(zip(VELOCITIES, (level, level, upright), strict=True))


def held(flight: Flight) -> bool:
    """Whether a position that moves at all stays for longer than half the window before it changes, on average."""
    steps = np.diff(flight.stack(POSITIONS).numpy(), axis=0)
    measured = (~np.isnan(steps)).sum(axis=0)
    changes = (np.nan_to_num(steps) != 0.0).sum(axis=0)
    return bool(((changes > 0) & (measured * flight.dt > HALF * changes)).any())


def _half(dt: float) -> int:
    """Samples to either side; a cubic needs two at least."""
    return max(2, round(HALF / dt))


def _pieces(position: np.ndarray, half: int) -> np.ndarray:
    """Records [T, 3] about each sample that has as many on either side [T - 2 half, 3, 2 half + 1]."""
    return np.lib.stride_tricks.sliding_window_view(position, 2 * half + 1, axis=0)


def _cubic(dt: float, half: int) -> np.ndarray:
    """Weights [4, 2 half + 1] of the samples about one in the coefficients of the cubic through them: value, slope."""
    time = dt * np.arange(-half, half + 1)
    return np.linalg.pinv(np.vander(time, 4, increasing=True))
