"""Linear model of the trimmed aircraft from its passage map, rotor and inflow residualised.

The matrix logarithm of the map's Jacobian is the constant system that passes through the same points (Floquet's
theorem); with the blades' exchange of places it is at the same time the change to the fixed frame.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import logm

from rotorid_torch.simulation.flight.trim import Trim, passage, passage_time, unknown_rows, with_held_speed
from rotorid_torch.simulation.helicopter.aircraft import CONTROLS, Aircraft
from rotorid_torch.simulation.rigid import Array

BODY_STATES = ("u", "v", "w", "p", "q", "r", "phi", "theta")


@dataclass(frozen=True)
class LinearAircraft:
    """dx/dt = a x + b u about trim.

    `a` [8, 8] and `b` [8, 4] are of the `BODY_STATES`, `full_a` with rotor and inflow. Controls are lon,
    lat, col, ped at the blades, rad. Gravity and kinematic terms are in `a`.
    """

    a: Array
    b: Array
    full_a: Array


SHIFT = 1e-4
"""Perturbation of a state or control, SI: small for the aircraft, large for rounding."""


def linearise(aircraft: Aircraft, trim: Trim) -> LinearAircraft:
    """Linear model about a trim by central differences over one blade passage, rotor speed held.

    Source: Johnson, Helicopter Theory, section 8.6 (Floquet theory); Padfield, Helicopter Flight Dynamics, section 2.3
    (reduction to the body's states).
    """
    rows = [*unknown_rows(aircraft), *range(CONTROLS.start, CONTROLS.stop)]
    size = len(rows)
    shifts = np.hstack([SHIFT * np.eye(size), -SHIFT * np.eye(size)])
    batch = np.repeat(trim.state[:, None], 2 * size, axis=1)
    batch[rows] += shifts
    after = passage(with_held_speed(aircraft), batch)[rows]
    jump = (after[:, :size] - after[:, size:]) / (2.0 * SHIFT)
    generator = np.real(logm(jump)) / passage_time(aircraft)
    states = size - 4
    full_a, full_b = generator[:states, :states], generator[:states, states:]
    body, rotor = slice(0, len(BODY_STATES)), slice(len(BODY_STATES), states)
    across = np.linalg.solve(full_a[rotor, rotor], np.hstack([full_a[rotor, body], full_b[rotor]]))
    a = full_a[body, body] - full_a[body, rotor] @ across[:, : len(BODY_STATES)]
    b = full_b[body] - full_a[body, rotor] @ across[:, len(BODY_STATES) :]
    return LinearAircraft(a, b, full_a)
