"""Velocities from specific forces and attitude: the integral, and the drift that is taken off it."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core import rigid
from rotorid_torch.core.names import ATTITUDES, RATES, SPECIFIC_FORCES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.velocities.positions import FEW, with_velocity

SPACING = 1.0
"""s between the knots of a drift."""
TILT, WANDER = math.radians(1.0), 60.0
"""rad and s: usual error of an attitude, and the time in which it changes; gravity makes a drift of it."""
UNSTEADY = 0.05
"""m/s2: usual acceleration of a vehicle that is trimmed."""
GAP = 0.25
"""s over which a straight line still follows forces and attitude of a helicopter."""
HELD = 5.0
"""s for which a speed about the reference is usually held."""
SCATTER = 1.0
"""Standard deviation of the logarithms of sizes about their usual values: a factor of e."""
LONGEST = 120
"""Knots of a flight by which sizes are found, at most."""
ROUNDING = 1e-4
"""m2/s2 added to a speed's variance, against rounding."""


@dataclass(frozen=True)
class Sizes:
    """Standard deviations of a speed about that at the start, of the start's own error, and of what makes it drift.

    speed, start : m/s. acceleration : m/s2.
    """

    speed: float = 2.0
    start: float = 0.2
    acceleration: float = UNSTEADY

    def covariances(self, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of drift and of speed [K, K] at knots [K], s, that are evenly spaced.

        The speed's is speed^2 exp(-|t - s| / HELD); the drift's that of its start and of the integral of an
        acceleration with acceleration^2 exp(-|t - s| / WANDER).
        """
        apart = np.abs(knots[:, None] - knots)
        summed = SPACING * (np.tril(np.ones_like(apart)) - 0.5 * np.eye(len(knots)))
        summed[:, 0] -= 0.5 * SPACING
        accelerations = self.acceleration**2 * np.exp(-apart / WANDER)
        speeds = self.speed**2 * np.exp(-apart / HELD) + ROUNDING * np.eye(len(knots))
        return self.start**2 + summed @ accelerations @ summed.T, speeds

    def drift(self, knots: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Mean of the drift [K, 3] in a dead-reckoned velocity [K, 3]: K_d (K_d + K_v)^-1 D."""
        drift, speed = self.covariances(knots)
        return np.asarray(drift @ np.linalg.solve(drift + speed, velocity))

    def implausibility(self, flights: Iterable[tuple[np.ndarray, np.ndarray]]) -> float:
        """Minus log-likelihood of flights' knots and velocities, and of the sizes about the usual ones."""
        from scipy.linalg import cho_factor, cho_solve  # slow to import

        usual, logs = Sizes(), 0.0
        for name, size in vars(self).items():
            logs += 0.5 * (math.log(size / getattr(usual, name)) / SCATTER) ** 2
        for knots, velocity in flights:
            factor = cho_factor(sum(self.covariances(knots)), lower=True)
            logs += 0.5 * float((velocity * cho_solve(factor, velocity)).sum())
            logs += velocity.shape[1] * float(np.log(np.diag(factor[0])).sum())
        return logs


def likeliest(flights: Sequence[tuple[np.ndarray, np.ndarray]]) -> Sizes:
    """The sizes that make flights' knots [K], s, and dead-reckoned velocities [K, 3], m/s, likeliest."""
    from scipy.optimize import minimize  # slow to import

    def implausibility(logs: np.ndarray) -> float:
        return Sizes(*np.exp(logs).tolist()).implausibility(flights)

    usual = np.log(list(vars(Sizes()).values()))
    minimum = minimize(implausibility, usual, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02})
    return Sizes(*np.exp(minimum.x).tolist())


@dataclass(frozen=True)
class DeadReckoning:
    """Velocities of one data set's flights by an IMU alone.

    In level axes dV/dt = R f + g, with the specific force f at the IMU and R from body axes. Its mean before the pilot
    acts, where the vehicle is trimmed, is an error of sensors and attitude, and is taken off. The integral D is V + d:
    a velocity about that at the start, and a drift. The drift is the mean of one Gaussian process beneath another, with
    the sizes that are likeliest for the identify flights.

    speed : at the start, m/s in level flight; None: the recorded airspeed. gravity : m/s2. arm : [3] m, of the IMU.

    Source: Titterton and Weston, Strapdown Inertial Navigation Technology (2nd ed.), ch. 3 and 12; Rasmussen and
    Williams, Gaussian Processes for Machine Learning, eq. 2.25 and 5.8.
    """

    dataset: Dataset
    speed: float | None
    gravity: float
    arm: Tensor
    sizes: Sizes = Sizes()

    @classmethod
    def of(cls, dataset: Dataset, speed: float | None) -> "DeadReckoning":
        """By the IMU's declared place, and the sizes that the identify flights make likeliest."""
        arm = torch.tensor(dataset.vehicle.imu or (0.0, 0.0, 0.0), dtype=torch.float64)
        usual = cls(dataset, speed, dataset.vehicle.gravity, arm)
        flights = [usual.integral(dataset.flights[name])[:2] for name in dataset.some(FEW)]
        flights = [(knots[:LONGEST], velocity[:LONGEST]) for knots, velocity in flights]
        return cls(dataset, speed, usual.gravity, arm, likeliest(flights))

    @property
    def noise(self) -> float:
        """Standard deviation that noise of the sensors makes of a velocity within WANDER, m/s."""
        facts = self.dataset.facts.values()
        force, tilt = (max(map(self.dataset.noise, channels)) for channels in (SPECIFIC_FORCES, ATTITUDES[:2]))
        seconds = min(max(one.samples * one.dt for one in facts), WANDER)
        return math.hypot(force, self.gravity * tilt) * math.sqrt(seconds * max(one.dt for one in facts))

    def flight(self, flight: Flight) -> Flight:
        """The flight with u v w of the reference point, missing from its first gap on."""
        from scipy.interpolate import CubicSpline  # slow to import

        knots, coarse, level = self.integral(flight)
        attitude = _attitude(flight)
        time = flight.dt * np.arange(len(level))
        velocity = torch.full((flight.samples, 3), torch.nan, dtype=torch.float64)
        velocity[: len(level)] = torch.from_numpy(level - CubicSpline(knots, self.sizes.drift(knots, coarse))(time))
        quiet = self.dataset.quiet(flight.name)
        airspeed = self.speed is None
        start = flight.bridged(["airspeed"])[:quiet].mean() if airspeed else torch.tensor(self.speed)
        heading = attitude[:quiet, 2].mean()
        velocity += start * torch.stack((torch.cos(heading), torch.sin(heading), torch.zeros_like(heading)))
        at_imu = rigid.velocity_in_body(velocity, attitude)
        return with_velocity(flight, at_imu - rigid.cross(flight.bridged(RATES), self.arm))

    def integral(self, flight: Flight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Knots [K], s, change of the velocity in level axes there [K, 3], and at every sample [T', 3], m/s.

        Up to the first gap: what pushed the vehicle in it is unknown.
        """
        acceleration = rigid.position_rates(flight.bridged(SPECIFIC_FORCES), _attitude(flight))
        acceleration[:, 2] -= self.gravity
        trimmed = acceleration[: max(2, self.dataset.quiet(flight.name))]
        acceleration -= _at_trim(trimmed, self.gravity * TILT)
        velocity = _integral(acceleration[: first_stretch(flight)], flight.dt).numpy()
        knots = np.arange(0.0, (len(velocity) - 1) * flight.dt + SPACING, SPACING)
        at = np.minimum(np.round(knots / flight.dt).astype(int), len(velocity) - 1)
        return knots, velocity[at], velocity


def first_stretch(flight: Flight) -> int:
    """Samples up to the first gap of what velocities are dead reckoned from; all where there is none."""
    stretch = flight.stretches([c for c in (*SPECIFIC_FORCES, *RATES, *ATTITUDES) if flight.has(c)], GAP)
    return int((stretch == 0).nonzero()[-1]) + 1 if bool((stretch == 0).any()) else 2


def _attitude(flight: Flight) -> Tensor:
    """Phi theta psi [T, 3], rad; a heading that is not recorded is the integral of the turn."""
    attitude = flight.bridged(ATTITUDES)
    if flight.has(ATTITUDES[2]):
        return attitude
    turn = rigid.euler_rates(flight.bridged(RATES), attitude)[:, 2:]
    return torch.cat((attitude[:, :2], _integral(turn, flight.dt)), dim=-1)


def _at_trim(acceleration: Tensor, sd: float) -> Tensor:
    """Error [3] of accelerations [Q, 3] in trim, m/s2; sd : its standard deviation."""
    first, second = (half.mean(dim=0) for half in acceleration.tensor_split(2))
    unsteady = UNSTEADY**2 + (first - second).square() / 4.0
    return 0.5 * (first + second) * sd**2 / (sd**2 + unsteady)


def _integral(slope: Tensor, dt: float) -> Tensor:
    """Integral of [T, n] over time from zero, by the trapezoidal rule."""
    steps = 0.5 * dt * (slope[1:] + slope[:-1])
    return torch.cat((torch.zeros_like(slope[:1]), steps.cumsum(0)))
