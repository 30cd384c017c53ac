"""The flight-test aircraft put together: states, and their rates from rotor, tails, fuselage and the body's motion.

Arrays are [component, flight] (blades: [component, blade, flight]); all flights are one batch. Inside, every main rotor
turns counter-clockwise; `flight_test` mirrors an aircraft whose rotor turns the other way.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorid_torch.fly.airframe import Fuselage, Surface, downwash, fuselage_loads, surface_force
from rotorid_torch.fly.inflow import inflow_rates
from rotorid_torch.fly.rotor import (
    RootLoads,
    Rotor,
    air_loads,
    blade_motion,
    blade_rates,
    cross,
    dot,
    root_loads,
    skew,
)
from rotorid_torch.fly.section import Array
from rotorid_torch.fly.tail import TailRotor, tail_rotor

BODY, RATES, EULER, PLACE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
CONTROLS, INFLOW, TAIL_INFLOW = slice(12, 16), slice(16, 19), 19
AZIMUTH, SPEED, TORQUE, SPEED_ERROR, BLADES = 20, 21, 22, 23, 24
"""Rows of the state: u v w | p q r | phi theta psi | north east height | lon lat col ped at the blades | lambda0
lambda_c lambda_s | tail inflow | rotor azimuth, speed | engine torque, integrated speed error | flap, flap rate, lag,
lag rate of each blade."""

CONTROL_NAMES = ("lon", "lat", "col", "ped")


@dataclass(frozen=True)
class Governor:
    """Rotor-speed governor and engine; `held`: the speed is constant, whatever torque that takes.

    Gains on the speed error, N m per rad/s (per rad, per rad/s^2); `lag` of the engine, s; `inertia` of the
    drive as the rotor sees it, kg m^2.

    Source: Hilbert, NASA TM-85890, table 3 (UH-60 engine and governor).
    """

    held: bool
    proportional: float
    integral: float
    derivative: float
    lag: float
    inertia: float


@dataclass(frozen=True)
class Aircraft:
    """Everything that flies, frozen: an effect is a changed copy.

    `mass` and `inertia` are those of the body without blades, about its own centre of gravity; `limits` (4 pairs, rad)
    and `actuator_lag` (s) belong to lon, lat, col, ped. `clockwise`: the rotor turns clockwise seen from above.
    """

    name: str
    mass: float
    inertia: tuple[tuple[float, float, float], ...]
    gravity: float
    air_density: float
    imu: tuple[float, float, float]
    rotor: Rotor
    tail: TailRotor
    fuselage: Fuselage
    fin: Surface
    tailplane: Surface
    governor: Governor
    limits: tuple[tuple[float, float], ...]
    actuator_lag: float
    clockwise: bool

    @property
    def states(self) -> int:
        """Number of rows of the state."""
        return BLADES + 4 * self.rotor.blades

    @cached_property
    def own_matrix(self) -> Array:
        """7 x 7: mass and inertia of the body, and of the drive (fast shafts, seen from the rotor)."""
        out = np.zeros((7, 7))
        out[:3, :3] = self.mass * np.eye(3)
        out[3:6, 3:6] = self.inertia
        out[6, 6] = self.governor.inertia
        return out

    @cached_property
    def inertia_matrix(self) -> Array:
        """3 x 3 kg m^2."""
        return np.asarray(self.inertia, dtype=np.float64)

    @cached_property
    def levers(self) -> Array:
        """[3 x 5, 3]: matrices r x for hub, tail rotor, fuselage, fin, tailplane."""
        points = (
            self.rotor.hub,
            self.tail.position,
            self.fuselage.position,
            self.fin.position,
            self.tailplane.position,
        )
        return np.concatenate([skew(point) for point in points])

    @cached_property
    def loads_to_moment(self) -> Array:
        """[3, 3 x 4]: moment by the forces at tail rotor, fuselage, fin, tailplane."""
        return np.concatenate(list(self.levers.reshape(5, 3, 3)[1:]), axis=1)

    @cached_property
    def washed_places(self) -> Array:
        """[3, 3, 1]: fuselage, fin, tailplane from the hub, (aft, right, up)."""
        points = np.array([self.fuselage.position, self.fin.position, self.tailplane.position])
        return (self.rotor.to_shaft @ (points - np.asarray(self.rotor.hub)).T)[:, :, None]

    @cached_property
    def limit_rows(self) -> tuple[Array, Array]:
        """Lower and upper limits of the controls, (4, 1)."""
        pairs = np.asarray(self.limits)
        return pairs[:, :1], pairs[:, 1:]


@dataclass(frozen=True)
class Motion:
    """What the accelerations and loads of one instant are, body axes, [3, flight].

    `specific_force`: acceleration of the centre of gravity minus gravity, m/s^2; `angular`: rad/s^2; `force` (N) and
    `moment` (N m) act on the body from outside, gravity not among them, about its centre of gravity; [flight]:
    `shaft_torque` that the engine gives, N m, and `speed_rate` of the rotor, rad/s^2.
    """

    specific_force: Array
    angular: Array
    force: Array
    moment: Array
    shaft_torque: Array
    speed_rate: Array


def rates(aircraft: Aircraft, x: Array, command: Array) -> tuple[Array, Motion]:
    """Rates of all states, and the motion that goes with them.

    Parameters
    ----------
    x : [states, flight].
    command : [4, flight] commanded lon, lat, col, ped, rad; the actuators follow.
    """
    rotor, density, flights = aircraft.rotor, aircraft.air_density, x.shape[1]
    omega, speed = x[RATES], x[SPEED]
    local = x[BODY] - (aircraft.levers @ omega).reshape(5, 3, flights)
    at_hub = rotor.to_shaft @ local[0]
    blades = x[BLADES:].reshape(4, rotor.blades, flights)
    motion = blade_motion(rotor, blades, rotor.to_shaft @ omega, x[AZIMUTH], speed)
    air = air_loads(rotor, motion, at_hub, x[INFLOW], x[CONTROLS], speed, density)
    over_tip = at_hub / (speed * rotor.radius)
    dx = np.zeros_like(x)
    dx[INFLOW], sweep = inflow_rates(x[INFLOW], air.loading, over_tip[:2], over_tip[2], speed)
    force, moment, dx[TAIL_INFLOW] = _airframe_loads(aircraft, x, local, sweep)
    centripetal = cross(omega, local[0] - x[BODY])
    root = root_loads(rotor, motion, air, rotor.to_shaft @ centripetal, speed)
    balance = _solve(aircraft, x, root, force, moment)
    _kinematics(aircraft, x, balance, dx)
    low, high = aircraft.limit_rows
    dx[CONTROLS] = (np.clip(command, low, high) - x[CONTROLS]) / aircraft.actuator_lag
    _drive(aircraft, x, balance, dx)
    linear = rotor.to_shaft @ (balance.specific_force - aircraft.levers[:3] @ balance.angular)
    angular = rotor.to_shaft @ balance.angular
    angular[2] += balance.speed_rate
    dx[BLADES:] = blade_rates(rotor, motion, air, root, linear, angular, speed).reshape(-1, flights)
    return dx, balance


def _airframe_loads(aircraft: Aircraft, x: Array, local: Array, sweep: Array) -> tuple[Array, Array, Array]:
    """Force and moment of all but the main rotor about the centre of gravity, and the rate of the tail rotor's inflow.

    `local`: [5, 3, flight] velocities at hub, tail rotor, fuselage, fin, tailplane.
    """
    density, radius = aircraft.air_density, aircraft.rotor.radius
    mean = x[INFLOW][0] * x[SPEED] * radius
    wash = downwash(radius, aircraft.washed_places, sweep, mean)
    tail, rate = tail_rotor(aircraft.tail, local[1], x[TAIL_INFLOW], x[CONTROLS][3], x[SPEED], density)
    body, turning = fuselage_loads(aircraft.fuselage, local[2], wash[0], density)
    fin = surface_force(aircraft.fin, local[3], wash[1], density)
    plane = surface_force(aircraft.tailplane, local[4], wash[2], density)
    moment = aircraft.loads_to_moment @ np.concatenate([tail, body, fin, plane])
    return tail + body + fin + plane, moment + turning, rate


def _solve(aircraft: Aircraft, x: Array, root: RootLoads, force: Array, moment: Array) -> Motion:
    """Newton and Euler for the body with all blades hanging on it, and the shaft: six unknowns, seven if it is free."""
    omega, up, flights = x[RATES], aircraft.rotor.to_shaft[2][:, None], x.shape[1]
    arm = root.arm + np.asarray(aircraft.rotor.hub)[:, None, None]
    gyroscopic = cross(omega, aircraft.inertia_matrix @ omega)
    known = np.empty((7, flights))
    known[:3] = force + root.force.sum(1)
    known[3:6] = moment + (cross(arm, root.force) + root.moment).sum(1) - gyroscopic
    known[6] = ((cross(root.arm, root.force) + root.moment).sum(1) * up).sum(0)
    columns = _jacobian(arm, root, up)
    reaction = columns.swapaxes(1, 2) @ columns
    total = aircraft.own_matrix + reaction
    size = 6 if aircraft.governor.held else 7
    driven = known.copy()
    driven[6] += x[TORQUE]
    found = np.zeros((flights, 7, 1))
    found[:, :size] = np.linalg.solve(total[:, :size, :size], driven[:size].T[:, :, None])
    answer, torque = (reaction @ found)[:, :6, 0].T, (total[:, 6:] @ found)[:, 0, 0] - known[6]
    solved = found[:, :, 0].T
    about = known[3:6] + gyroscopic - answer[3:]
    return Motion(solved[:3], solved[3:6], known[:3] - answer[:3], about, torque, solved[6])


def _jacobian(arm: Array, root: RootLoads, up: Array) -> Array:
    """Square root of the blades' reaction matrix: rows of all blades, columns of the unknown accelerations.

    The reaction of a blade to the acceleration a = J y of its hinge is -J' (light 1 + heavy d d') J y.
    """
    blades, flights = arm.shape[1:]
    rows = np.zeros((flights, blades, 4, 7))
    light, heavy = np.sqrt(root.light), np.sqrt(root.heavy)
    x, y, z = light * arm.transpose(0, 2, 1)
    rows[:, :, 0, 0] = rows[:, :, 1, 1] = rows[:, :, 2, 2] = light
    rows[:, :, 0, 4], rows[:, :, 0, 5] = z, -y
    rows[:, :, 1, 3], rows[:, :, 1, 5] = -z, x
    rows[:, :, 2, 3], rows[:, :, 2, 4] = y, -x
    swing = cross(up[:, :, None], root.arm)
    rows[:, :, :3, 6] = light * swing.transpose(2, 1, 0)
    rows[:, :, 3, :3] = heavy * root.d.transpose(2, 1, 0)
    rows[:, :, 3, 3:6] = heavy * cross(arm, root.d).transpose(2, 1, 0)
    rows[:, :, 3, 6] = heavy * dot(swing, root.d).T
    return rows.reshape(flights, 4 * blades, 7)


def _kinematics(aircraft: Aircraft, x: Array, balance: Motion, dx: Array) -> None:
    """Rates of velocity, body rates, Euler angles and position."""
    velocity, omega = x[BODY], x[RATES]
    (phi, theta, psi), (u, v, w), (p, q, r) = x[EULER], velocity, omega
    cp, sp, ct, st, cs, ss = np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi)
    dx[BODY] = balance.specific_force - cross(omega, velocity)
    dx[0] -= aircraft.gravity * st
    dx[1] += aircraft.gravity * ct * sp
    dx[2] += aircraft.gravity * ct * cp
    dx[RATES] = balance.angular
    turning = q * sp + r * cp
    dx[6], dx[7], dx[8] = p + turning * st / ct, q * cp - r * sp, turning / ct
    level, side = u * ct + (v * sp + w * cp) * st, v * cp - w * sp
    dx[9], dx[10], dx[11] = level * cs - side * ss, level * ss + side * cs, u * st - (v * sp + w * cp) * ct


def _drive(aircraft: Aircraft, x: Array, balance: Motion, dx: Array) -> None:
    """Rates of azimuth, rotor speed, engine torque and the governor's integral."""
    governor = aircraft.governor
    dx[AZIMUTH] = x[SPEED]
    if governor.held:
        return
    error = aircraft.rotor.speed - x[SPEED]
    dx[SPEED], dx[SPEED_ERROR] = balance.speed_rate, error
    wanted = governor.proportional * error + governor.integral * x[SPEED_ERROR] - governor.derivative * dx[SPEED]
    dx[TORQUE] = (wanted - x[TORQUE]) / governor.lag
