"""Velocities where a data set holds none: from position and attitude, or from specific forces and attitude.

Position: motion capture, and trackers on the ground. Specific forces: an IMU alone, by dead reckoning.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, POSITIONS, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.schema import ChannelSpec

HALF = 0.15
"""s to either side over which a cubic is fitted: a body's velocity changes below 3 Hz, which passes unchanged."""
FEW = 10
"""Identify flights that the noise is estimated from, at most."""
REFERENCE_SPEED = re.compile(r"(hover)|(\d+(?:\.\d*)?) ?(m/s|kt|kn|knots)", re.IGNORECASE)
"""What a declared reference may say of the speed at which flights start."""
KNOT = 0.514444
"""m/s of a nautical mile in an hour."""
SPACING = 1.0
"""s between the knots of a drift of dead reckoning."""
TILT, WANDER = math.radians(1.0), 60.0
"""rad and s: usual error of an attitude, and the time in which it changes; gravity makes a drift of it."""
SPEED, HELD = 5.0, 5.0
"""m/s and s: usual size of speeds that are flown about a reference, and the time for which one is held."""
UNSTEADY = 0.05
"""m/s2: usual acceleration of a vehicle that is trimmed."""
START = 0.5
"""m/s: usual error of the speed at which a flight starts."""


def with_velocities(dataset: Dataset) -> Dataset:
    """The data set with u v w in every flight, where none has any of them and all have what they can be made from.

    From position and attitude, or of a helicopter from specific forces, rates and attitude. `derived` tells that no
    score is to know these channels. Where they cannot be had although position is recorded, a warning says so.
    """
    flights_facts = dataset.facts.values()
    if any(facts.has(c) for facts in flights_facts for c in VELOCITIES):
        return dataset
    if all(facts.has(*POSITIONS, *ATTITUDES) for facts in flights_facts):
        return _from_position(dataset)
    inertial = all(facts.has(*SPECIFIC_FORCES, *RATES, *ATTITUDES[:2]) for facts in flights_facts)
    begins = reference_speed(dataset) is not None or all(facts.has("airspeed") for facts in flights_facts)
    return _from_forces(dataset) if inertial and begins and dataset.kind == "helicopter" else dataset


def reference_speed(dataset: Dataset) -> float | None:
    """Speed at which flights start by the declared reference ("hover", "30 m/s", "60 kt"), m/s; None where none is."""
    declared = REFERENCE_SPEED.fullmatch(dataset.settings.reference.strip())
    if declared is None:
        return None
    hover, number, unit = declared.groups()
    return 0.0 if hover else float(number) * (1.0 if unit.lower() == "m/s" else KNOT)


def _from_position(dataset: Dataset) -> Dataset:
    """By the slope of a cubic through each 0.3 s of position, turned into body axes.

    Source: Savitzky and Golay, Analytical Chemistry 36 (1964).
    """
    moving = dataset.changed(_differentiated)
    held = any(_held(flight) for flight in dataset.flights.values())
    if held or not all(one.has(*VELOCITIES) for one in moving.facts.values()):
        remark = "u v w are not measured, nor can they be had from position: it is held or missing for too long"
        return replace(dataset, warnings=tuple(dict.fromkeys((*dataset.warnings, remark))))
    noise = _noise(dataset, moving.flights)
    size = f"{noise['u']:.2g}, w to {noise['w']:.2g} m/s"
    return _completed(moving, noise, f"made from position and attitude, to about {size}")


def _completed(moving: Dataset, noise: Mapping[str, float], how: str) -> Dataset:
    """The data set that says how its u v w were made; noise : standard deviation of a sample, m/s."""
    specs = {c: ChannelSpec(noise=sd) for c, sd in noise.items()}
    return replace(
        moving,
        channel_specs=MappingProxyType({**moving.channel_specs, **specs}),
        warnings=(*moving.warnings, f"u v w are not measured: {how}, and not scored"),
        derived=frozenset(VELOCITIES),
    )


def _noise(dataset: Dataset, flights: Mapping[str, Flight]) -> dict[str, float]:
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


def _differentiated(flight: Flight) -> Flight:
    """A flight with u v w; missing in the first and last 0.15 s, and about missing positions."""
    half = _half(flight.dt)
    position = flight.stack(POSITIONS).numpy()
    moving = np.full_like(position, math.nan)
    if len(position) > 2 * half:
        moving[half:-half] = _pieces(position, half) @ _cubic(flight.dt, half)[1]
    return _with(flight, _in_body_axes(torch.from_numpy(moving), flight.stack(ATTITUDES)))


def _with(flight: Flight, velocity: Tensor) -> Flight:
    """The flight with u v w, m/s [T, 3]."""
    channels = {**flight.channels, **dict(zip(VELOCITIES, velocity.unbind(-1), strict=True))}
    return replace(flight, channels=MappingProxyType(channels))


def _in_body_axes(velocity: Tensor, attitude: Tensor) -> Tensor:
    """Velocity north, east and up [T, 3] in body axes, by phi theta psi [T, 3]."""
    axes = torch.eye(3, dtype=torch.float64)[:, None]
    turned = rigid.position_rates(axes, attitude)  # [3, T, 3]: what each body axis' unit speed does
    return torch.einsum("itk,tk->ti", turned, velocity)


def _from_forces(dataset: Dataset) -> Dataset:
    """By dead reckoning from level flight at the airspeed of the start; the drift is estimated and taken off.

    Over ground dV/dt = R f + g, with the specific force f at the IMU and R from body to level axes. Its mean before the
    pilot acts, where the vehicle is trimmed, is an error of sensors and attitude, and is taken off. The integral D is
    V + d, a velocity about that at the start and a drift: d = K_d (K_d + K_v)^-1 D, the mean of one Gaussian process
    beneath another, K_v = SPEED^2 exp(-|t - s| / HELD) and K_d that of START and the integral of an acceleration of
    covariance UNSTEADY^2 exp(-|t - s| / WANDER).

    Source: Titterton and Weston, Strapdown Inertial Navigation Technology (2nd ed.), ch. 3 and 12; Rasmussen and
    Williams, Gaussian Processes for Machine Learning, eq. 2.25.
    """
    gravity = dataset.vehicle.gravity
    arm = torch.tensor(dataset.vehicle.imu or (0.0, 0.0, 0.0), dtype=torch.float64)
    speed = reference_speed(dataset)

    def change(flight: Flight) -> Flight:
        return _dead_reckoned(flight, dataset.quiet(flight.name), speed, gravity, arm)

    longest = max(facts.samples * facts.dt for facts in dataset.facts.values())
    dt = max(facts.dt for facts in dataset.facts.values())
    force, tilt = (max(dataset.noise(c) for c in channels) for channels in (SPECIFIC_FORCES, ATTITUDES[:2]))
    noise = math.hypot(force, gravity * tilt) * math.sqrt(dt * min(longest, WANDER))
    start = "the airspeed" if speed is None else f"{speed:.3g} m/s"
    how = f"dead reckoned from specific forces and attitude, from {start} at the start of each flight"
    return replace(_completed(dataset.changed(change), dict.fromkeys(VELOCITIES, noise), how), dead_reckoned=True)


def _drift_filter(knots: np.ndarray) -> np.ndarray:
    """What makes of a dead-reckoned velocity [K, ...] its drift [K, K].

    knots : times [K], s, evenly spaced.
    """
    apart = np.abs(knots[:, None] - knots)
    summed = SPACING * (np.tril(np.ones_like(apart)) - 0.5 * np.eye(len(knots)))
    summed[:, 0] -= 0.5 * SPACING
    accelerations = UNSTEADY**2 * np.exp(-apart / WANDER)
    drift = START**2 + summed @ accelerations @ summed.T
    return np.linalg.solve(drift + SPEED**2 * np.exp(-apart / HELD), drift).T


def _at_trim(acceleration: Tensor, sd: float) -> Tensor:
    """Error [3] of accelerations [Q, 3] of a standard deviation, m/s2, where the vehicle is trimmed."""
    first, second = (half.mean(dim=0) for half in acceleration.tensor_split(2))
    unsteady = UNSTEADY**2 + (first - second).square() / 4.0
    return 0.5 * (first + second) * sd**2 / (sd**2 + unsteady)


def _dead_reckoned(flight: Flight, quiet: int, speed: float | None, gravity: float, arm: Tensor) -> Flight:
    """A flight with u v w of the reference point, from an IMU at an arm [3] from it, m.

    quiet : samples before the pilot acts, in which the vehicle is trimmed. speed : m/s then; None: the airspeed.
    """
    rates, attitude = flight.bridged(RATES), flight.bridged(ATTITUDES)
    if not flight.has(ATTITUDES[2]):
        turn = rigid.euler_rates(rates, attitude)[:, 2]
        attitude = torch.cat((attitude[:, :2], _integral(turn[:, None], flight.dt)), dim=-1)
    acceleration = rigid.position_rates(flight.bridged(SPECIFIC_FORCES), attitude)
    acceleration[:, 2] -= gravity
    acceleration -= _at_trim(acceleration[:quiet], gravity * TILT)
    velocity = _integral(acceleration, flight.dt).numpy()
    time = flight.dt * np.arange(len(velocity))
    knots = np.arange(0.0, time[-1] + SPACING, SPACING)
    at = np.minimum(np.round(knots / flight.dt).astype(int), len(velocity) - 1)
    drift = _drift_filter(knots) @ velocity[at]
    level = torch.from_numpy(velocity - CubicSpline(knots, drift)(time))
    start = flight.bridged(["airspeed"])[:quiet].mean() if speed is None else torch.tensor(speed)
    heading = attitude[:quiet, 2].mean()
    level += start * torch.stack((torch.cos(heading), torch.sin(heading), torch.zeros_like(heading)))
    return _with(flight, _in_body_axes(level, attitude) - rigid.cross(rates, arm))


def _integral(slope: Tensor, dt: float) -> Tensor:
    """Integral of [T, n] over time from zero, by the trapezoidal rule."""
    steps = 0.5 * dt * (slope[1:] + slope[:-1])
    return torch.cat((torch.zeros_like(slope[:1]), steps.cumsum(0)))
