"""The numbers of a batch of helicopters, the rows of their state, and what an instant gives (see `dynamics`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorid_torch.simulation.rigid import Array

BODY, RATES, EULER, PLACE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
FLAP, FLAP_RATE, LAG, LAG_RATE = slice(12, 15), slice(15, 18), slice(18, 21), slice(21, 24)
INFLOW, TAIL_INFLOW, SPEED, TORQUE, SPEED_ERROR, STATES = slice(24, 27), 27, 28, 29, 30, 31
"""Rows of the state: u v w | p q r | phi theta psi | north east height | a0 a1 b1, their rates | lag: mean, cosine,
sine, their rates | lambda0 lambda_c lambda_s | tail inflow | rotor speed | engine torque | integrated speed error."""
Mask = NDArray[np.bool_]
Choice = NDArray[np.intp] | slice
"""Which aircraft of a batch."""


@dataclass(frozen=True)
class Craft:
    """Numbers of a batch of helicopters, each [aircraft, 1] (vectors [3, aircraft, 1]) unless said otherwise; SI.

    `inertia` [3, 3, aircraft, 1] about the declared centre of gravity; `with_blades`: mass and inertia include them.
    Rotor and airframe as in `rotor.Rotor`, `tail.TailRotor` and `airframe`; `delta3`: tangent of the angle that takes
    pitch off a flapped blade. `inflow_gain`: static inflow over momentum theory's, mean and gradient [2, ...];
    `inflow_speed`: the same of the rates, a zero holds the gradient at nothing. `steady_flap`: flapping is quasi-steady
    [aircraft]; `stiff_lag`: blades do not lag [aircraft]. `relaxation`: s, in which a quasi-steady flap is reached.
    """

    blades: int
    with_blades: bool
    held: bool
    relaxation: float
    gravity: float
    steady_flap: Mask
    stiff_lag: Mask
    density: Array
    mass: Array
    inertia: Array
    hub: Array
    imu: Array
    tilt: Array
    radius: Array
    chord: Array
    speed: Array
    hinge_offset: Array
    blade_mass: Array
    first_moment: Array
    flap_inertia: Array
    flap_spring: Array
    lag_spring: Array
    lag_damper: Array
    swash_phase: Array
    delta3: Array
    twist: Array
    root_cutout: Array
    tip_loss: Array
    lift_slope: Array
    drag: Array
    drag_rise: Array
    inflow_gain: Array
    inflow_speed: Array
    tail_position: Array
    tail_radius: Array
    tail_solidity: Array
    tail_gear: Array
    tail_cant: Array
    tail_twist: Array
    tail_delta3: Array
    tail_lift_slope: Array
    tail_lock: Array
    tail_tip_loss: Array
    tail_blockage: Array
    fuselage_position: Array
    fuselage_drag: Array
    fuselage_lift: Array
    fuselage_pitch: Array
    fuselage_yaw: Array
    fuselage_wake: Array
    fin_position: Array
    fin_area: Array
    fin_lift_slope: Array
    plane_position: Array
    plane_area: Array
    plane_lift_slope: Array
    plane_incidence: Array
    plane_schedule: Array
    plane_speed: Array
    plane_wake: Array
    governor_proportional: Array
    governor_integral: Array
    governor_derivative: Array
    governor_lag: Array
    drive_inertia: Array

    @property
    def count(self) -> int:
        """Number of aircraft."""
        return self.mass.shape[0]


@dataclass(frozen=True)
class Setting:
    """What is constant while a batch flies: blade elements, and the mass matrix at trim.

    `stations`, `weights` [element, 1, aircraft, 1]: distance from the hinge, m, and half density x chord x lift slope x
    length, with the distance multiplied in for the second of them; `inverse` [aircraft, 13, 13] of the mass matrix with
    zeros for what does not move; `relax` [aircraft, 3, 3]: rates of a quasi-steady flap by its unbalanced moment;
    `body`: first moment and inertia of `body_inertia`.
    """

    stations: Array
    weights: tuple[Array, Array]
    inverse: Array
    relax: Array
    body: tuple[Array, Array]


@dataclass(frozen=True)
class Response:
    """What one instant brings, [3, aircraft, flight].

    Specific force of the reference point, m/s^2; angular acceleration, rad/s^2; moment on a0 a1 b1, N m; `shaft`
    [aircraft, flight]: torque that it takes to hold the rotor speed, N m.
    """

    specific_force: Array
    angular: Array
    flap_moment: Array
    shaft: Array


def to_shaft(tilt: Array, vector: Array) -> Array:
    """Body axes to (aft, right, up)."""
    c, s = np.cos(tilt), np.sin(tilt)
    return np.stack([-c * vector[0] - s * vector[2], vector[1], s * vector[0] - c * vector[2]])


def to_body(tilt: Array, vector: Array) -> Array:
    """(aft, right, up) to body axes."""
    c, s = np.cos(tilt), np.sin(tilt)
    return np.stack([-c * vector[0] + s * vector[2], vector[1], -s * vector[0] - c * vector[2]])
