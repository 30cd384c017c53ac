"""Velocities from position and attitude, where a data set holds none: motion capture, and trackers on the ground."""

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.schema import ChannelSpec

HALF = 0.15
"""s to either side over which a cubic is fitted: a body's velocity changes below 3 Hz, which passes unchanged."""
FEW = 10
"""Identify flights that the noise is estimated from, at most."""


def with_velocities(dataset: Dataset) -> Dataset:
    """The data set with u v w in every flight, where none has any of them and all have position and attitude.

    The slope of a cubic through each 0.3 s of position (Savitzky and Golay, Analytical Chemistry 36, 1964), turned into
    body axes. Where positions are held or missing so often that this cannot be, a warning says so. `derived` tells that
    no score is to know these channels.
    """
    flights_facts = dataset.facts.values()
    measured = any(facts.has(c) for facts in flights_facts for c in VELOCITIES)
    if measured or not all(facts.has(*POSITIONS, *ATTITUDES) for facts in flights_facts):
        return dataset
    moving = dataset.changed(_with_velocities)
    held = any(_held(flight) for flight in dataset.flights.values())
    if held or not all(one.has(*VELOCITIES) for one in moving.facts.values()):
        remark = "u v w are not measured, nor can they be had from position: it is held or missing for too long"
        return replace(dataset, warnings=tuple(dict.fromkeys((*dataset.warnings, remark))))
    noise = _noise(dataset, moving.flights)
    size = f"{noise['u'].noise:.2g}, w to {noise['w'].noise:.2g} m/s"
    remark = f"u v w are not measured: made from position and attitude, to about {size}, and not scored"
    return replace(
        moving,
        channel_specs=MappingProxyType({**dataset.channel_specs, **noise}),
        warnings=(*dataset.warnings, remark),
        derived=frozenset(VELOCITIES),
    )


def _noise(dataset: Dataset, flights: Mapping[str, Flight]) -> dict[str, ChannelSpec]:
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
    return {c: ChannelSpec(noise=sd) for c, sd in zip(VELOCITIES, (level, level, upright), strict=True)}


def _held(flight: Flight) -> bool:
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


def _with_velocities(flight: Flight) -> Flight:
    """A flight with u v w; missing in the first and last 0.15 s, and about missing positions."""
    half = _half(flight.dt)
    position = flight.stack(POSITIONS).numpy()
    moving = np.full_like(position, math.nan)
    if len(position) > 2 * half:
        moving[half:-half] = _pieces(position, half) @ _cubic(flight.dt, half)[1]
    axes = torch.eye(3, dtype=torch.float64)[:, None]
    turned = rigid.position_rates(axes, flight.stack(ATTITUDES))  # [3, T, 3]: what each body axis' unit speed does
    velocity = torch.einsum("itk,tk->it", turned, torch.from_numpy(moving))
    channels = {**flight.channels, **dict(zip(VELOCITIES, velocity, strict=True))}
    return replace(flight, channels=MappingProxyType(channels))
