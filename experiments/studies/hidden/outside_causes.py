"""Two causes that are in no library, for the studies of the closed loop: what is recorded does not reach the blades.

"outside.slipped_control" : at 6 s of each flight a control run slips: from then on only half of its deviation from trim
arrives, shifted by a part of its range. "outside.product" : the tail rotor's blade angle picks up the product of the
collective's deviation and the roll rate: a yawing moment that no linear term and no effect of the library has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.flight.augmentation import FEEDBACK, Augmentation
from rotorid_torch.simulation.flight.manoeuvres import SAMPLE_RATE, pilot
from rotorid_torch.simulation.flight.motion import Motion, rates
from rotorid_torch.simulation.flight.runge_kutta import runge_kutta
from rotorid_torch.simulation.flight.simulation import FlightHistory
from rotorid_torch.simulation.flight.trim import STEP_ANGLE, Trim
from rotorid_torch.simulation.helicopter.aircraft import CONTROL_NAMES, CONTROLS, RATES, Aircraft
from rotorid_torch.simulation.rigid import Array

ONSET = 6.0  # s
LEFT, SLIP = 0.5, 0.015  # part of a slipped control's deviation that arrives; shift as a part of its range
PICKED_UP = 15.0  # rad of tail rotor collective per rad of collective and rad/s of roll
COL, PED = 2, 3

Angles = Callable[[float, Array, Array], Array]
"""angles(time, states, trimmed controls): lon lat col ped at the blades, rad, [4, flight]."""


@dataclass(frozen=True)
class Cause:
    """What it does to an aircraft of a number at a size, and what a right localisation says of it.

    `where` : equations in which it shows, by the aircraft's number. `goes_with` : states, controls, factors of their
    products. `since_s` : its onset in each flight, s.
    """

    at_blades: Callable[[int, Aircraft, float], Angles]
    where: Callable[[int], tuple[str, ...]]
    goes_with: Callable[[int], tuple[str, ...]]
    since_s: float | None


SLIPPING = ("lat", "lon", "ped")
"""One of those that the augmentation moves all the time, by number of the aircraft."""
EQUATIONS = {"lon": ("M", "a1", "X"), "lat": ("L", "b1", "Y"), "ped": ("N", "Y")}


def _slipping(number: int) -> str:
    return SLIPPING[number % len(SLIPPING)]


def _slipped(number: int, aircraft: Aircraft, size: float) -> Angles:
    place = CONTROL_NAMES.index(_slipping(number))
    low, high = aircraft.limits[place]
    lost, shift = min((1.0 - LEFT) * size, 1.0), SLIP * (high - low) * size

    def angles(time: float, x: Array, trimmed: Array) -> Array:
        out = x[CONTROLS].copy()
        if time >= ONSET:
            out[place] += shift - lost * (out[place] - trimmed[place])
        return out

    return angles


def _product(number: int, aircraft: Aircraft, size: float) -> Angles:
    def angles(time: float, x: Array, trimmed: Array) -> Array:
        out = x[CONTROLS].copy()
        out[PED] += PICKED_UP * size * (out[COL] - trimmed[COL]) * x[RATES][0]
        return out

    return angles


CAUSES = {
    "outside.slipped_control": Cause(
        _slipped, lambda number: EQUATIONS[_slipping(number)], lambda number: (_slipping(number),), ONSET
    ),
    "outside.product": Cause(_product, lambda number: ("N", "Y"), lambda number: ("col", "p"), None),
}


LOADS = ("specific_force", "angular", "force", "moment")


def fly_with(
    aircraft: Aircraft,
    trims: Sequence[Trim],
    augmentations: Sequence[Augmentation],
    flights: Sequence[str],
    seconds: float,
    angles: Angles,
) -> FlightHistory:
    """Fly manoeuvres from trim, the blades at angles of their own.

    Time runs in steps of the sample, or parts of it; a stick's jump belongs to the step that begins there.
    """
    dt = 1.0 / SAMPLE_RATE
    parts = int(np.ceil(aircraft.rotor.speed * dt / STEP_ANGLE - 1e-6))
    samples, step = round(seconds * SAMPLE_RATE) + 1, dt / parts
    x = np.stack([one.state for one in trims], axis=1)
    trimmed = np.stack([one.controls for one in trims], axis=1)
    gains, neutral = np.stack([one.gains for one in augmentations]), x[FEEDBACK].copy()
    low, high = aircraft.limit_rows
    starts = step * np.arange(samples * parts)
    times = starts[:, None] + step * np.array([1e-6, 0.5, 1.0 - 1e-6])
    stick = pilot(flights, times.ravel(), aircraft.limits).reshape(4, *times.shape, len(flights))

    def respond(state: Array, hand: Array) -> tuple[Array, Motion]:
        command = trimmed + hand[:4] + np.einsum("kij,jk->ik", gains, state[FEEDBACK] - neutral)
        felt = state.copy()
        felt[CONTROLS] = angles(float(hand[4, 0]), state, trimmed)
        dx, motion = rates(aircraft, felt, command)
        dx[CONTROLS] = (np.clip(command, low, high) - state[CONTROLS]) / aircraft.actuator_lag
        return dx, motion

    states, loads_of = [], {name: [] for name in LOADS}
    for k in range((samples - 1) * parts + 1):
        hands = [np.vstack([stick[:, k, stage], np.full((1, len(flights)), times[k, stage])]) for stage in range(3)]
        first, motion = respond(x, hands[0])
        if k % parts == 0:
            states.append(x)
            for name in LOADS:
                loads_of[name].append(getattr(motion, name))
        x = runge_kutta(lambda s, u: respond(s, u)[0], x, first, (hands[0], hands[1], hands[2]), step)
    time, loads = np.arange(samples, dtype=np.float64) * dt, [np.stack(loads_of[name]) for name in LOADS]
    return FlightHistory(time, np.stack(states), loads[0], loads[1], loads[2], loads[3])
