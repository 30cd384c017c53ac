"""Velocities whose clock differs from that of attitude and rates, where no accelerometer says what pushed the aircraft.

Gravity turned by the attitude, and the body's rotation, make up most of what changes u and v; what is left is taken as
a constant and as drag in proportion to each velocity, both free. Drag and a time shift partly stand for each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency import sensor_pairs
from rotorid_torch.consistency.imu_place import placed_pairs
from rotorid_torch.consistency.sensor_pairs import LAGS, REACH_S, STEP_S, jackknife_error, lag_of_top
from rotorid_torch.consistency.smoothing import kernel
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

CHANNELS = ("u", "v", "w", "p", "q", "r", "phi", "theta")
IMITATED_S = 0.06
"""Time shift that a rotor's tilt behind the body's rates imitates: so much on clean helicopters of 4 and 7 t."""
SURE = 3.0
"""Standard errors."""
EXPLAINED = 0.6
"""R² from which on a lag is known."""
WIDEST_S = 0.3
"""Largest shift that is a clock's."""


@dataclass(frozen=True)
class VelocityClock:
    """Time by which u and v are late (early where negative) against attitude and rates, s, and its standard error.

    drag, drag_se : 1/s, of u and v, estimated with it. r2 : of du/dt and dv/dt with neither, drag alone, the shift
    alone, both.
    """

    seconds: float
    se: float
    drag: tuple[float, float]
    drag_se: tuple[float, float]
    r2: tuple[float, float, float, float]


def velocity_clock(dataset: Dataset) -> VelocityClock | None:
    """The velocities' shift where it is beyond chance, beyond what a rotor imitates, and the same on both axes.

    None too where accelerometers are there: then exact kinematics says it, and more.
    """
    flights = [dataset.flights[name] for name in dataset.identify]
    felt = any(facts.has(sensor) for facts in dataset.facts.values() for sensor in ("ax", "ay"))
    if felt or not all(flight.has(*CHANNELS) for flight in flights):
        return None
    parts = [part for flight in flights for part in _moments(dataset, flight)]
    if len(parts) < 2:
        return None
    whole, without = _fit(np.sum(parts, axis=0)), _each_left_out(parts)
    se = max(jackknife_error([f.lag for f in without]), STEP_S / 2.0)
    beyond = IMITATED_S + SURE * se < abs(whole.lag) < WIDEST_S
    steady = all(f.lag * whole.lag > 0.0 for f in map(_fit, parts) if f.r2[3] > EXPLAINED)
    if not (beyond and steady and _alike(parts) and whole.r2[3] > EXPLAINED):
        return None
    u, v = whole.drag
    u_se, v_se = (jackknife_error([f.drag[axis] for f in without]) for axis in (0, 1))
    return VelocityClock(whole.lag, se, (u, v), (u_se, v_se), whole.r2)


def _alike(parts: Sequence[Array]) -> bool:
    """Whether both axes shift by the same: a clock does that, a rotor's tilt need not."""
    axes = [[part[axis : axis + 1] for part in parts] for axis in (0, 1)]
    u, v = (_fit(np.sum(axis, axis=0)).lag for axis in axes)
    u_se, v_se = (jackknife_error([f.lag for f in _each_left_out(axis)]) for axis in axes)
    return abs(u - v) < max(SURE * float(np.hypot(u_se, v_se)), IMITATED_S)


@dataclass(frozen=True)
class _Fit:
    lag: float
    drag: tuple[float, ...]
    r2: tuple[float, float, float, float]


def _each_left_out(parts: Sequence[Array]) -> list[_Fit]:
    total = np.sum(parts, axis=0)
    return [_fit(total - part) for part in parts]


def _fit(moments: Array) -> _Fit:
    """Lag and drag of least misfit from cross moments (axes, lags, 3, 3) of rate of change, kinematics and velocity."""
    change, both, moved = moments[..., 0, 0], moments[..., 0, 1], moments[..., 1, 1]
    power = np.maximum(moments[..., 2, 2], np.finfo(float).tiny)
    misfit = change - 2.0 * both + moved
    along = moments[..., 0, 2] - moments[..., 1, 2]
    plain, dragged = misfit.sum(0), (misfit - along**2 / power).sum(0)
    total = max(float(change[:, 0].sum()), np.finfo(float).tiny)
    best, none = int(np.argmin(dragged)), LAGS // 2
    misfits = plain[none], dragged[none], plain.min(), dragged[best]
    drag = tuple((-along[:, best] / power[:, best]).tolist())
    r2 = tuple(1.0 - float(part) / total for part in misfits)
    return _Fit(lag_of_top(-dragged), drag, (r2[0], r2[1], r2[2], r2[3]))


def _moments(dataset: Dataset, flight: Flight) -> Iterator[Array]:
    """Cross moments (2, lags, 3, 3) of each piece, for u and v: rate of change, kinematics at each lag, velocity.

    Pieces of which less than half was measured are left out.
    """
    bell, slope = kernel(flight.dt)
    if flight.samples < len(bell) + 2 * int(np.ceil(REACH_S / flight.dt)) + 50:
        return
    present = ~np.isnan(flight.stack(CHANNELS).numpy()).any(axis=1)
    whole = np.convolve(present, np.ones(len(bell)), "valid") > len(bell) - 0.5
    grid = np.arange(0.0, (len(whole) - 1) * flight.dt, STEP_S) / flight.dt
    places = np.arange(len(whole))
    sure = np.interp(grid, places, whole.astype(float)) > 0.999
    rows = [
        [np.interp(grid, places, np.convolve(x, k, "valid")) for x, k in zip(three, (slope, bell, bell), strict=True)]
        for three in _sides(dataset, flight)
    ]
    for first, last in sensor_pairs.minutes(len(grid), STEP_S, LAGS // 2):
        if sure[first:last].mean() > 0.5:
            yield np.array([_over_lags(axis, sure, first, last) for axis in rows])


def _sides(dataset: Dataset, flight: Flight) -> list[tuple[Array, Array, Array]]:
    """Of u and v: what is differentiated, what kinematics makes of gravity and rotation, and the velocity again."""
    pairs = [pair for pair in placed_pairs(dataset) if pair.left_name in ("u", "v")]
    return [(pair.left(flight), pair.right(flight), pair.left(flight)) for pair in pairs]


def _over_lags(rows: list[Array], sure: Array, first: int, last: int) -> Array:
    change, kinematics, velocity = rows
    products = []
    for lag in range(-(LAGS // 2), LAGS // 2 + 1):
        inside = sure[first:last] & sure[first - lag : last - lag]
        three = np.stack([change[first:last], kinematics[first - lag : last - lag], velocity[first:last]])[:, inside]
        three = three - three.mean(axis=1, keepdims=True) if inside.any() else three
        products.append(three @ three.T)
    return np.array(products)
