"""Sensors against each other: kinematics needs no aerodynamics; what disagrees is a sensor, a unit or a clock."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.consistency.smoothing import correlated, kernel
from rotorid_torch.core.names import ATTITUDES, RATES, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.core.rigid import euler_rates, position_rates, specific_force_at, velocity_rates
from rotorid_torch.core.statistics import jackknife_variance
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

REACH_S = 0.4
"""Largest lag that is looked for, in s."""
STEP_S = 0.01
WITHIN_S = REACH_S - 0.03
"""Lag beyond which it is that of another peak."""
CLOSELY = 0.9
"""R² from which on exact kinematics hold at no other lag."""
LEAST_SE = 0.005
"""Least standard error of a scale, as a share of it: attitudes that are smoothed or rounded differ by as much."""
STEEP = 0.2
"""Cosine of the pitch angle below which Euler rates are more than five times those of the body."""
PIECE_S = 60.0
"""Longer flights count as several: the spread between pieces gives the standard errors, and drift shows."""
LAGS = round(2 * REACH_S / STEP_S)
LAGS_S = np.linspace(-REACH_S, REACH_S, LAGS + 1)
TOGETHER = correlated(2.0 * STEP_S)
"""Samples of the left side over which the kernel correlates residuals."""


@dataclass(frozen=True)
class Pair:
    """Two signals (T,) that kinematics makes equal: `left` is smoothed or differentiated, `right` smoothed."""

    left_name: str
    right_name: str
    unit: str
    channels: tuple[str, ...]
    left: Callable[[Flight], Array]
    right: Callable[[Flight], Array]
    differentiate: bool = True
    exact: bool = True


class Side(NamedTuple):
    """Left every 2 `STEP_S` where every lag leaves samples, right every `STEP_S` and `REACH_S` longer at both ends."""

    left: Array
    right: Array

    def moved(self, lag: int) -> Array:
        """Right at the samples of left, taken so many steps earlier."""
        first = LAGS // 2 - lag
        return self.right[first : first + 2 * len(self.left) : 2]


@dataclass(frozen=True)
class Agreement:
    """How left = scale * right(t - lag) + bias holds, pooled over pieces of flights, the bias free in each.

    `scale` is the ratio of the two sides' rms, `bounds` has it for all errors on either side; `lag_s` above 0 means
    that left comes later; standard errors are the larger of that of the residuals and that of the jackknife over the
    pieces. `biases` has the constant of each piece, `lags_s` the lag and its standard error of each in which it can be
    seen. `power` has the mean squares of left and right.
    """

    pair: Pair
    scale: float
    scale_se: float
    bounds: tuple[float, float]
    lag_s: float
    lag_se: float
    r2: float
    biases: dict[str, float]
    lags_s: dict[str, tuple[float, float]]
    power: tuple[float, float]

    @property
    def bias(self) -> float:
        """Mean over the pieces of left less right."""
        return float(np.mean([*self.biases.values()]))

    @property
    def bias_se(self) -> float:
        """Standard error of the bias, from the spread between pieces."""
        return float(np.std([*self.biases.values()]) / np.sqrt(max(len(self.biases) - 1, 1)))

    @property
    def whole_scale_error(self) -> float:
        """Standard error of the scale, at least what noise on either side may bias it by."""
        return max(self.scale_se, 0.5 * (self.bounds[1] - self.bounds[0]), LEAST_SE * abs(self.scale))

    @property
    def misfit(self) -> float:
        """Mean square of left less right at the lag: a scale that is free hides noise of a side that hardly moves."""
        left, right = self.power
        return left + right - 2.0 * float(np.sign(self.scale) * np.sqrt(self.r2 * left * right))

    def noise_power(self, noise: tuple[float, float], dt: float) -> tuple[float, float]:
        """Power that the noise of the sensors' samples (standard deviations) has on the left and on the right."""
        bell, slope = kernel(dt)
        left, right = (slope if self.pair.differentiate else bell), bell
        return noise[0] ** 2 * float((left**2).sum()), noise[1] ** 2 * float((right**2).sum())


def agreement(pair: Pair, flights: Iterable[Flight]) -> Agreement | None:
    """Scale, lag and bias between the two sides of a pair; None where the flights are too short or nothing moves."""
    sides = {name: side for f in flights if f.has(*pair.channels) for name, side in sides_of(pair, f)}
    if not sides:
        return None
    moments = {name: _moments(side) for name, side in sides.items()}
    total = np.sum(list(moments.values()), axis=0)
    if total[:, :2].min() <= 0.0:
        return None
    best = int(np.argmax(_r2(total)))
    lag, lag_se = _lag(total, list(sides.values()))
    without = [total - one for one in moments.values()]
    measured = sum(int(np.isfinite(side.left).sum()) for side in sides.values())
    return Agreement(
        pair=pair,
        scale=_scale(total),
        scale_se=_scale_error(total[best], np.stack([one[best] for one in moments.values()]), measured),
        bounds=_ordered(float(total[best, 2] / total[best, 0]), float(total[best, 1] / total[best, 2])),
        lag_s=lag,
        lag_se=max(lag_se, jackknife_error([lag_of_top(_r2(part)) for part in without])),
        r2=float(_r2(total)[best]),
        biases={name: float(np.nanmean(side.left) - np.nanmean(side.moved(0))) for name, side in sides.items()},
        lags_s={name: _lag(m, [sides[name]]) for name, m in moments.items() if _r2(m).max() > 0.6},
        power=(float(total[best, 1]) / max(measured, 1), float(total[best, 0]) / max(measured, 1)),
    )


def compared(a: Agreement, flight: Flight) -> tuple[Array, Array, Array, Array]:
    """Time, left side, right side as recorded and with lag, scale and constant taken out, (n,) each, of one flight."""
    bell, slope = kernel(flight.dt)
    left = np.convolve(a.pair.left(flight), slope if a.pair.differentiate else bell, "valid")
    right = np.convolve(a.pair.right(flight), bell, "valid")
    time = flight.dt * (np.arange(len(left)) + len(bell) // 2)
    moved = a.scale * np.interp(time - a.lag_s, time, right)
    return time, left, right, moved + np.nanmean(left - moved)


def jackknife_error(without_one: Sequence[float]) -> float:
    """Standard error of an estimate from its values with each of the pieces left out; 0 where there is one piece."""
    return float(np.sqrt(jackknife_variance(np.asarray(without_one, dtype=float)))) if len(without_one) > 1 else 0.0


def _scale(moments: Array) -> float:
    right, left, both = moments[int(np.argmax(_r2(moments)))]
    return float(np.sqrt(left / right) * np.sign(both)) if right > 0.0 else 0.0


def _scale_error(total: Array, parts: Array, samples: int) -> float:
    """Standard error of the scale by sums of squares and products (3,) of all pieces (n, 3), lag held.

    The larger of that of the residuals and that of the jackknife, linear in each piece: without the one piece in which
    an axis moves there is no scale at all.
    """
    right, left, both = np.maximum(np.abs(total), np.finfo(float).tiny)
    residual = max(right * left / both**2 - 1.0, 0.0) / max(samples, 1) * TOGETHER
    apart = 0.5 * (parts[:, 1] / left - parts[:, 0] / right)
    spread = float((apart**2).sum()) * (1.0 - 1.0 / len(parts))
    return float(np.sqrt(left / right * max(residual, spread)))


def difference(pair: Pair, flight: Flight) -> tuple[float, float]:
    """Mean squares of left less right, and of both on average, about their means; NaN where the flight is too short."""
    if not flight.has(*pair.channels) or not (sides := [side for _, side in sides_of(pair, flight)]):
        return float("nan"), float("nan")
    right, left, both = np.sum([_moments(side)[LAGS // 2] for side in sides], axis=0)
    samples = sum(len(side.left) for side in sides)
    return float(right + left - 2.0 * both) / samples, 0.5 * float(right + left) / samples


def _ordered(a: float, b: float) -> tuple[float, float]:
    return (a, b) if a < b else (b, a)


def _r2(moments: Array) -> Array:
    power = np.maximum(moments[:, 0] * moments[:, 1], np.finfo(float).tiny)
    return moments[:, 2] ** 2 / power


def sides_of(pair: Pair, flight: Flight) -> Iterator[tuple[str, Side]]:
    """The two sides of a flight, or of each of its pieces of a minute, with the names of these."""
    bell, slope = kernel(flight.dt)
    reach = int(np.ceil(REACH_S / flight.dt)) + 1
    if flight.samples < len(bell) + 2 * reach + 20:
        return
    towards = pair.right(flight)
    missing = np.isnan(flight.stack(pair.channels).numpy()).any(axis=1) | np.isnan(towards)
    gaps = np.convolve(missing.astype(float), np.ones(len(bell)), "valid") > 0.5
    left = np.where(gaps, np.nan, np.convolve(pair.left(flight), slope if pair.differentiate else bell, "valid"))
    right = np.where(gaps, np.nan, np.convolve(np.nan_to_num(towards), bell, "valid"))
    grid = np.arange(0.0, (len(left) - 1) * flight.dt, STEP_S) / flight.dt
    places = np.arange(len(left))
    left, right = np.interp(grid, places, left), np.interp(grid, places, right)
    for first, last in minutes(len(grid), STEP_S, LAGS // 2):
        part = left[first:last:2]
        if np.isfinite(part).sum() > 20:
            whole = last - first + LAGS == len(grid)
            where = flight.name if whole else f"{flight.name} from {first * STEP_S:.0f} s"
            yield where, Side(part, right[first - LAGS // 2 : last + LAGS // 2 + 1])


def minutes(samples: int, dt: float, margin: int) -> Iterator[tuple[int, int]]:
    """First and last + 1 sample of equal parts of a record, `margin` samples at both ends left out."""
    parts = max(1, round((samples - 2 * margin) * dt / PIECE_S))
    edges = np.linspace(margin, samples - margin, parts + 1).astype(int)
    yield from zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)


def _moments(side: Side) -> Array:
    """Sums (LAGS + 1, 3) of right², left² and right * left about their means, by the lag of right against left."""
    moved = np.stack([side.moved(k - LAGS // 2) for k in range(LAGS + 1)])
    present = np.isfinite(moved) & np.isfinite(side.left)
    samples = np.maximum(present.sum(axis=1, keepdims=True), 1)

    def beside_mean(values: Array) -> Array:
        filled = np.where(present, values, 0.0)
        return np.where(present, filled - filled.sum(axis=1, keepdims=True) / samples, 0.0)

    x, y = beside_mean(moved), beside_mean(side.left)
    return np.stack([np.einsum("kt,kt->k", *pair) for pair in ((x, x), (y, y), (x, y))], axis=1)


def lag_of_top(values: Array) -> float:
    """Lag of the highest of values [LAGS], s, by a parabola through the best three."""
    best = int(np.argmax(values))
    if best in (0, len(values) - 1):
        return float(LAGS_S[best])
    below, at, above = values[best - 1 : best + 2]
    bend = below - 2.0 * at + above
    return float(LAGS_S[best] + (0.5 * STEP_S * (below - above) / bend if bend < 0.0 else 0.0))


def _lag(moments: Array, sides: list[Side]) -> tuple[float, float]:
    """Lag of the best agreement and its standard error, for residuals that are correlated over the kernel's width."""
    r2 = _r2(moments)
    best = int(np.argmax(r2))
    slope = moments[best, 2] / moments[best, 0]
    steep = sum(float(np.nansum(np.gradient(s.moved(0), 2.0 * STEP_S) ** 2)) for s in sides)
    samples = sum(int(np.isfinite(s.left).sum()) for s in sides)
    spread = max(moments[best, 1] * (1.0 - r2[best]), 0.0) / samples * TOGETHER
    error = float(np.sqrt(spread / max(slope**2 * steep, np.finfo(float).tiny)))
    return lag_of_top(r2), error


def attitude_pairs() -> tuple[Pair, ...]:
    """Rate of each Euler angle against the body rates."""

    def rate(axis: int) -> Callable[[Flight], Array]:
        return lambda f: _steep_as_missing(f, euler_rates(f.bridged(RATES), f.bridged(ATTITUDES[:2]))[:, axis].numpy())

    channels = (*RATES, "phi", "theta")
    return (
        Pair("phi", "p", "rad/s", channels, _column("phi"), rate(0)),
        Pair("theta", "q", "rad/s", channels, _column("theta"), rate(1)),
        Pair("psi", "r", "rad/s", (*channels, "psi"), _column("psi"), rate(2)),
    )


def acceleration_pairs() -> tuple[Pair, ...]:
    """Rate of each body rate against the angular acceleration that is recorded beside it."""
    pairs = ((rate, f"{rate}dot") for rate in RATES)
    return tuple(Pair(p, pdot, "rad/s²", (p, pdot), _column(p), _column(pdot)) for p, pdot in pairs)


def _steep_as_missing(flight: Flight, values: Array) -> Array:
    """Values (T,), missing where the attitude is so steep that Euler angles jump and their rates have no size."""
    return np.where(np.abs(np.cos(flight.bridged(["theta"])[:, 0].numpy())) < STEEP, np.nan, values)


def _column(name: str) -> Callable[[Flight], Array]:
    return lambda flight: flight.bridged([name])[:, 0].numpy()


def velocity_pairs(dataset: Dataset, imu: Tensor) -> tuple[Pair, ...]:
    """Rate of each body velocity against specific force, gravity and rotation, the lever arm of an IMU (3) taken out.

    Without the axis's accelerometer only gravity and rotation are compared: enough to see a clock, not a scale.
    """
    gravity = dataset.vehicle.gravity
    base = (*VELOCITIES, *RATES, "phi", "theta")
    pairs = []
    for axis, (velocity, sensor) in enumerate(zip(VELOCITIES, SPECIFIC_FORCES, strict=True)):
        felt = any(facts.has(sensor) for facts in dataset.facts.values())
        if not felt and axis == 2:
            continue
        channels = (*base, sensor) if felt else base
        right = _acceleration(axis, sensor if felt else None, gravity, imu)
        pairs.append(
            Pair(velocity, sensor if felt else "phi theta", "m/s²", channels, _column(velocity), right, exact=felt)
        )
    return tuple(pairs)


def _acceleration(axis: int, sensor: str | None, gravity: float, imu: Tensor) -> Callable[[Flight], Array]:
    def right(f: Flight) -> Array:
        velocity, rates, attitude = (f.bridged(c) for c in (VELOCITIES, RATES, ATTITUDES[:2]))
        without = velocity_rates(velocity, rates, attitude, torch.zeros_like(rates), gravity)[:, axis].numpy()
        return without if sensor is None else without + _column(sensor)(f) - arm(f)

    arm = arm_of_imu(axis, imu)
    return right


def arm_of_imu(axis: int, imu: Tensor) -> Callable[[Flight], Array]:
    """What an IMU feels along an axis because it is away from the reference point."""

    def felt(f: Flight) -> Array:
        if not imu.any():
            return np.zeros(f.samples)
        rates = f.bridged(RATES)  # their rate of change is smoothed with all else, once
        turning = torch.from_numpy(np.gradient(rates.numpy(), f.dt, axis=0))
        return specific_force_at(imu, torch.zeros_like(rates), rates, turning)[:, axis].numpy()

    return felt


def force_pairs(dataset: Dataset, imu: Tensor) -> tuple[Pair, ...]:
    """Each accelerometer against what velocity, rotation, attitude and gravity say: `velocity_pairs` turned about.

    Late accelerometers shift all of one side here, late velocities all of one side there.
    """
    pairs = []
    for axis, pair in enumerate(velocity_pairs(dataset, imu)):
        if pair.exact:
            without = _acceleration(axis, None, dataset.vehicle.gravity, torch.zeros(3))
            right = _felt(pair.left_name, without, arm_of_imu(axis, imu))
            sensor = _column(pair.right_name)
            pairs.append(Pair(pair.right_name, pair.left_name, "m/s²", pair.channels, sensor, right, False, False))
    return tuple(pairs)


def _felt(velocity: str, falling: Callable[[Flight], Array], arm: Callable[[Flight], Array]) -> Callable[..., Array]:
    return lambda f: np.gradient(_column(velocity)(f), f.dt) - falling(f) + arm(f)


def position_pairs() -> tuple[Pair, ...]:
    """Rate of each position against the velocity, turned by the attitude."""

    def rate(axis: int) -> Callable[[Flight], Array]:
        return lambda f: position_rates(f.bridged(VELOCITIES), f.bridged(ATTITUDES))[:, axis].numpy()

    channels = (*VELOCITIES, "phi", "theta")
    return (
        Pair("north", "u v w", "m/s", (*channels, "psi", "north"), _column("north"), rate(0)),
        Pair("east", "u v w", "m/s", (*channels, "psi", "east"), _column("east"), rate(1)),
        Pair("height", "u v w", "m/s", (*channels, "height"), _column("height"), rate(2)),
    )


def stick_pairs(dataset: Dataset) -> tuple[Pair, ...]:
    """Body rate against the pilot's stick of its axis: a stick that comes after its rate has late stamps.

    Only sticks (unit "norm" or "m"): recorded blade angles and motor commands hold a controller's answer to the
    rates, which rightly follows them.
    """
    axes = (("lat", "p"), ("lon", "q"), ("ped", "r"))
    sticks = [(s, r) for s, r in axes if s in dataset.controls and dataset.control_specs[s].unit != "rad"]
    return tuple(
        Pair(rate, stick, "rad/s", (rate, stick), _column(rate), _column(stick), differentiate=False, exact=False)
        for stick, rate in sticks
    )
