"""Trim: a periodic flight of the whole simulator, found by Newton's method over one blade passage.

With identical blades the aircraft in steady flight repeats itself after 1/blades of a revolution, each blade then being
where the next one was. Trim is the fixed point of that map: rotor states, body motion, attitude and controls together,
such that the passage also covers speed x time over ground, without climb, drift or turn. Nothing is held and nothing is
left to settle: a flight that starts there stays there, up to its own instability.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.simulation.flight.motion import rates
from rotorid_torch.simulation.flight.runge_kutta import runge_kutta
from rotorid_torch.simulation.helicopter.aircraft import (
    AZIMUTH,
    BLADES,
    CONTROLS,
    EULER,
    INFLOW,
    SPEED,
    SPEED_ERROR,
    TAIL_INFLOW,
    TORQUE,
    Aircraft,
)
from rotorid_torch.simulation.rigid import Array

STEP_ANGLE = np.deg2rad(5.1)  # largest azimuth step; two steps per sample at 27 rad/s and 154 Hz


@dataclass(frozen=True)
class Trim:
    """A trimmed flight.

    `state` [states] at azimuth zero; `controls` lon lat col ped, rad; `speed`, m/s; `residual`: largest mean
    acceleration that is left, SI.
    """

    state: Array
    controls: Array
    speed: float
    residual: float


def passage_time(aircraft: Aircraft) -> float:
    """Time in which a blade takes the place of the next one, s."""
    return 2.0 * np.pi / (aircraft.rotor.blades * aircraft.rotor.speed)


def passage(aircraft: Aircraft, x: Array) -> Array:
    """State after one blade passage with held controls, each blade's states handed to the place it has reached.

    x : [states, flight].
    """
    duration, controls, blades = passage_time(aircraft), x[CONTROLS].copy(), aircraft.rotor.blades
    steps = int(np.ceil(2.0 * np.pi / (blades * STEP_ANGLE)))

    def slope(state: Array, command: Array) -> Array:
        return rates(aircraft, state, command)[0]

    for _ in range(steps):
        x = runge_kutta(slope, x, slope(x, controls), (controls, controls, controls), duration / steps)
    x = x.copy()
    x[AZIMUTH] -= 2.0 * np.pi / blades
    rows = aircraft.blade_rows
    x[rows] = np.roll(x[rows].reshape(4, blades, -1), 1, axis=1).reshape(4 * blades, -1)
    return x


def with_held_speed(aircraft: Aircraft) -> Aircraft:
    """The same aircraft with its rotor speed held."""
    return replace(aircraft, governor=replace(aircraft.governor, held=True))


def unknown_rows(aircraft: Aircraft) -> list[int]:
    """Rows of the state that trim looks for: velocity, rates, bank, pitch, inflows, blades, wake, load."""
    return [*range(8), *range(INFLOW.start, INFLOW.stop), TAIL_INFLOW, *range(BLADES, aircraft.settled_rows)]


def find_trim(aircraft: Aircraft, speed: float, height: float = 27.4, heading: float = 0.0) -> Trim:
    """Level flight along a heading (rad) at a speed over ground, without drift.

    Raises InputError: no trim at this speed (too heavy for its rotor, too fast, an impossible vehicle).
    """
    free = not aircraft.governor.held
    aircraft = with_held_speed(aircraft)
    reached, x, step = 0.0, _guess(aircraft, height), 10.0
    x[EULER.stop - 1] = heading
    x, residual = _newton(aircraft, x, 0.0)
    while residual < LOOSE and reached < speed:
        nearer = min(reached + step, speed)
        tried, residual = _newton(aircraft, _moved(x, nearer - reached), nearer)
        if residual < LOOSE:
            x, reached = tried, nearer
        elif step > 0.5:
            step, residual = 0.5 * step, 0.0
    low, high = aircraft.limit_rows
    controls = x[CONTROLS]
    if residual >= LOOSE or np.any(controls < low[:, 0]) or np.any(controls > high[:, 0]):
        beyond = f"needs controls {np.round(controls, 3).tolist()} rad to trim"
        why = "cannot be trimmed" if residual >= LOOSE else beyond
        raise InputError(aircraft.name, "speed", f"the aircraft {why} at {speed:g} m/s", "a flyable vehicle and speed")
    if free:
        x[TORQUE] = _mean_torque(aircraft, x)
        x[SPEED_ERROR] = x[TORQUE] / aircraft.governor.integral
    return Trim(x, controls.copy(), speed, residual)


NEWTON_STEPS = 40  # at most
LOOSE, TIGHT = 1e-6, 1e-10  # residual acceleration: converged at all, and Newton's goal


def _moved(x: Array, gain: float) -> Array:
    """A trimmed state, its speed raised by `gain`: the guess for the next one."""
    x = x.copy()
    x[0] += gain * np.cos(x[7])
    x[2] += gain * np.sin(x[7])
    return x


def _guess(aircraft: Aircraft, height: float) -> Array:
    """Momentum-theory guess of the hover."""
    rotor, tail = aircraft.rotor, aircraft.tail
    below = aircraft.load.mass if aircraft.load else 0.0
    weight = (aircraft.mass + rotor.blades * rotor.blade_mass + below) * aircraft.gravity
    tip_speed = rotor.speed * rotor.radius
    thrust = weight / (aircraft.air_density * rotor.disc * tip_speed**2)
    solidity, mean = rotor.blades * rotor.chord / (np.pi * rotor.radius), np.sqrt(thrust / 2.0)
    slope = 0.5 * solidity * rotor.section.lift_slope
    collective = 3.0 * (thrust / slope + 0.5 * mean) * 1.1 - 0.75 * rotor.twist
    torque = weight * mean * tip_speed * 1.35 / rotor.speed
    side = torque / abs(tail.position[0]) / tail.fin_blockage
    tail_tip = tail.gear * tip_speed / rotor.radius * tail.radius
    tail_thrust = side / (aircraft.air_density * np.pi * tail.radius**2 * tail_tip**2)
    tail_mean = np.sqrt(tail_thrust / 2.0)
    pedal = 3.3 * (2.0 * tail_thrust / (tail.solidity * tail.lift_slope) + 0.5 * tail_mean) - 0.75 * tail.twist
    x = np.zeros(aircraft.states)
    x[11], x[SPEED], x[INFLOW.start], x[TAIL_INFLOW] = height, rotor.speed, mean, tail_mean
    x[CONTROLS] = 0.0, 0.0, collective, pedal
    x[6], x[7] = -side / weight, rotor.tilt
    spin = rotor.flap_inertia + rotor.hinge_offset * rotor.first_moment
    x[BLADES : BLADES + rotor.blades] = 0.7 * weight / rotor.blades * rotor.radius / (spin * rotor.speed**2)
    return x


def _residual(aircraft: Aircraft, before: Array, after: Array, speed: float) -> Array:
    """What is left to trim, per second of the passage, [unknowns, flight]."""
    duration, rows = passage_time(aircraft), unknown_rows(aircraft)
    ground = after[8:12] - before[8:12]
    heading = before[EULER.stop - 1]
    ground[1] -= speed * np.cos(heading) * duration
    ground[2] -= speed * np.sin(heading) * duration
    return np.concatenate([after[rows] - before[rows], ground]) / duration


def _newton(aircraft: Aircraft, x: Array, speed: float) -> tuple[Array, float]:
    """Newton's method with step control; the Jacobian by differences, all perturbed flights in one batch."""
    rows = [*unknown_rows(aircraft), *range(CONTROLS.start, CONTROLS.stop)]
    shifts = 1e-6 * np.hstack([np.zeros((len(rows), 1)), np.eye(len(rows))])
    size, damping = np.inf, 1.0
    base = x
    direction = np.zeros(len(rows))
    for _ in range(NEWTON_STEPS):
        trial = base.copy()
        trial[rows] += damping * direction
        batch = np.repeat(trial[:, None], len(rows) + 1, axis=1)
        batch[rows] += shifts
        with np.errstate(all="ignore"):
            left = _residual(aircraft, batch, passage(aircraft, batch), speed)
        norm = float(np.abs(left[:, 0]).max()) if np.isfinite(left).all() else np.inf
        if norm > 2.0 * size and damping > 0.02:
            damping *= 0.5
            continue
        base, size, damping = trial, norm, 1.0
        if size < TIGHT or not np.isfinite(size):
            break
        jacobian = (left[:, 1:] - left[:, :1]) / 1e-6
        direction = -np.linalg.lstsq(jacobian, left[:, 0], rcond=None)[0]
        damping = min(1.0, 0.3 / np.abs(direction[8:]).max())
    return base, size


def _mean_torque(aircraft: Aircraft, x: Array) -> float:
    """Torque at the shaft that holds the rotor speed, N m, mean over a blade passage."""
    duration, total, steps = passage_time(aircraft), 0.0, 18
    state, controls = x[:, None], x[CONTROLS, None]

    def slope(state: Array, command: Array) -> Array:
        return rates(aircraft, state, command)[0]

    for _ in range(steps):
        first, motion = rates(aircraft, state, controls)
        total += float(motion.shaft_torque[0])
        state = runge_kutta(slope, state, first, (controls, controls, controls), duration / steps)
    return total / steps
