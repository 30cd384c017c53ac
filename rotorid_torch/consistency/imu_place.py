"""Where the IMU is: declared, or estimated beside lags and scales of the velocities; pairs that know it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.consistency.sensor_pairs import (
    STEP_S,
    TOGETHER,
    WITHIN_S,
    Agreement,
    Pair,
    Side,
    arm_of_imu,
    attitude_pairs,
    sides_of,
    velocity_pairs,
)
from rotorid_torch.core.names import ATTITUDES, VELOCITIES
from rotorid_torch.core.rigid import gravity_in_body
from rotorid_torch.core.storage.once import once
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Array = np.ndarray

PLACED, PLACED_S, ROUNDS = 8, 1200.0, 3
"""Flights and seconds at most from which the place of an IMU is estimated, and how often weights and lags are renewed.

Two renewals of the weights are enough: what further ones change is small beside the standard errors.

Source: Carroll and Ruppert, Transformation and Weighting in Regression (1988), ch. 2.
"""
NEAR_M, MOST_M = 1.0, 3.0
"""m within which an IMU is of the centre of gravity, as one standard deviation, and at most."""
MOST_SCALE = 0.5
"""Relative error of a velocity's scale from which on it is no scale: specific force and velocity are not alike."""
LEAST, ARM = 50, slice(-4, -1)
"""Samples from which on an arm is estimated, and where it stands among what is."""


@dataclass(frozen=True)
class Place:
    """Where the IMU is, m from the centre of gravity.

    An arm that is not declared can stand in for a lag, a scale or gravity: these are known no better than beside it.
    velocity_errors : standard errors of lag (s) and scale of each velocity. gravity_se : of gravity, m/s².
    """

    point: tuple[float, ...] = (0.0, 0.0, 0.0)
    velocity_errors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    gravity_se: float = 0.0

    @property
    def tensor(self) -> Tensor:
        """The point as a tensor (3)."""
        return torch.tensor(self.point, dtype=torch.float64)

    def doubted(self, a: Agreement, velocity: str) -> Agreement:
        """An agreement of a velocity, its lag and scale known no better than beside the arm."""
        lag_se, scale_se = self.velocity_errors.get(velocity, (0.0, 0.0))
        return replace(a, lag_se=max(a.lag_se, lag_se), scale_se=max(a.scale_se, scale_se))


@once
def place_of_imu(dataset: Dataset) -> Place:
    """As declared; else from where specific force is that of the velocities, by least squares along all axes.

    A lag and a scale of each velocity, and gravity, stand beside the arm where the record asks for them; constants are
    free in each piece. That an IMU is within metres of the centre of gravity is known beforehand.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., eq. 10.9.
    """
    if dataset.vehicle.imu is not None:
        return Place(tuple(dataset.vehicle.imu))
    pairs = [pair for pair in velocity_pairs(dataset, torch.zeros(3, dtype=torch.float64)) if pair.exact]
    flights = [_middle(dataset.flights[name], PLACED_S / PLACED) for name in dataset.identify[:PLACED]]
    sides = [[part for flight in flights for part in _with_arms(pair, flight)] for pair in pairs]
    if not sides or min(sum(len(part[0].left) for part in some) for some in sides) < LEAST:
        return Place()
    solution, covariance = _beside_lags(sides)
    if float(np.abs(solution[len(pairs) : 2 * len(pairs)]).max()) > MOST_SCALE:
        return Place()
    errors, others = np.sqrt(np.diag(covariance)), [*range(2 * len(pairs)), -1]
    if not _sure(solution[others], covariance[np.ix_(others, others)]):  # one cause: the arm
        solution, covariance = _solved_arm([_of_arm(some, 0) for some in sides], alone=True)
    arm, near = solution[ARM], float(np.abs(solution[ARM]).max()) < MOST_M
    arm = arm if near and _sure(arm, covariance[ARM, ARM]) else np.zeros(3)
    velocity_errors = {p.left_name: (float(errors[j]), float(errors[len(pairs) + j])) for j, p in enumerate(pairs)}
    return Place(tuple(arm.tolist()), velocity_errors, float(errors[-1]))


def _beside_lags(sides: Sequence[Sequence[tuple[Side, ...]]]) -> tuple[Array, Array]:
    """Lags, scales and the arm as `_solved_arm` gives them, each lag about the one before."""
    count = len(sides)
    solution, covariance = _solved_arm([_of_arm(some, 0) for some in sides])
    for _ in range(ROUNDS):
        steps = np.round(np.clip(solution[:count], -WITHIN_S, WITHIN_S) / STEP_S).astype(int)
        solution, covariance = _solved_arm([_of_arm(some, int(step)) for some, step in zip(sides, steps, strict=True)])
        solution[:count] += STEP_S * steps
    return solution, covariance


def _sure(values: Array, covariance: Array) -> bool:
    """Whether values (n,) with this covariance differ from zero more than chance gives once in a thousand."""
    from scipy.special import chdtri  # slow to import

    size = float(values @ np.linalg.pinv(covariance, hermitian=True) @ values)
    return size > float(chdtri(len(values), 1e-3))


def _middle(flight: Flight, seconds: float) -> Flight:
    """So many seconds of a flight, its middle; all of a shorter one."""
    spare = max(0, flight.samples - round(seconds / flight.dt)) // 2
    if not spare:
        return flight
    return Flight(flight.name, flight.dt, {c: x[spare : len(x) - spare] for c, x in flight.channels.items()})


def _with_arms(pair: Pair, flight: Flight) -> Iterator[tuple[Side, ...]]:
    """Sides of each piece of a flight; then with what an IMU feels 1 m off along each axis, and a fall, as right."""
    if flight.has(*pair.channels):
        axis = VELOCITIES.index(pair.left_name)
        arms = [replace(pair, right=arm_of_imu(axis, one)) for one in torch.eye(3, dtype=torch.float64)]
        falls = replace(pair, right=lambda f: gravity_in_body(f.bridged(ATTITUDES[:2]), 1.0)[:, axis].numpy())
        for parts in zip(*(sides_of(one, flight) for one in (pair, *arms, falls)), strict=True):
            yield tuple(side for _, side in parts)


def _of_arm(parts: Sequence[tuple[Side, ...]], lag: int) -> tuple[Array, int]:
    """Products (7, 7) of what an axis leaves, the columns of its lag, its scale, the arm and gravity; samples."""
    products, samples = np.zeros((7, 7)), 0
    for side, *arms, falls in parts:
        right = side.moved(lag)
        columns = [side.left - right, -np.gradient(right, 2.0 * STEP_S), right, *(-arm.moved(lag) for arm in arms)]
        columns.append(falls.moved(lag))
        rows = np.stack(columns, axis=1)
        rows = rows[np.isfinite(rows).all(axis=1)]
        rows = rows - rows.mean(axis=0) if len(rows) else rows
        products, samples = products + rows.T @ rows, samples + len(rows)
    return products, samples


def _solved_arm(products: Sequence[tuple[Array, int]], *, alone: bool = False) -> tuple[Array, Array]:
    """Lags and scales of all axes, the arm and gravity (2 n + 4), and their covariance, each axis by what it leaves.

    `alone`: the arm stands alone, all else is zero and known.
    """
    count = len(products)
    size = 2 * count + 4
    of_arm = [*range(size)[ARM]]
    free = of_arm if alone else [*range(size)]
    prior = np.zeros((size, size))
    prior[of_arm, of_arm] = 1.0 / NEAR_M**2
    solution, covariance = np.zeros(size), np.zeros((size, size))
    places = [[j, count + j, *range(size - 4, size)] for j in range(count)]
    for _ in range(ROUNDS):
        normal, response = prior.copy(), np.zeros(size)
        for at, (one, samples) in zip(places, products, strict=True):
            left = np.concatenate([[-1.0], solution[at]])
            weight = samples / (TOGETHER * max(float(left @ one @ left), np.finfo(float).tiny))
            normal[np.ix_(at, at)] += weight * one[1:, 1:]
            response[at] += weight * one[1:, 0]
        normal += np.finfo(float).eps * np.trace(normal) * np.eye(size)  # a column that never moves
        covariance[np.ix_(free, free)] = np.linalg.inv(normal[np.ix_(free, free)])
        solution[free] = covariance[np.ix_(free, free)] @ response[free]
    return solution, covariance


def placed_pairs(dataset: Dataset) -> tuple[Pair, ...]:
    """`velocity_pairs` with the IMU where it is."""
    return velocity_pairs(dataset, place_of_imu(dataset).tensor)


def exact_pairs(dataset: Dataset) -> tuple[Pair, ...]:
    """Attitude against rates, and velocity against specific force where kinematics are exact."""
    return (*attitude_pairs(), *(pair for pair in placed_pairs(dataset) if pair.exact))
