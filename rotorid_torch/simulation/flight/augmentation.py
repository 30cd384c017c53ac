"""Stability augmentation: rates and attitude fed back to the blade angles, nothing that holds the speed."""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.flight.linear import LinearAircraft
from rotorid_torch.simulation.helicopter.aircraft import EULER, RATES
from rotorid_torch.simulation.rigid import Array

FEEDBACK = slice(RATES.start, EULER.stop)
"""Rows of the state that are fed back: p q r phi theta psi."""


@dataclass(frozen=True)
class Augmentation:
    """Command = trim + pilot + gains (p q r phi theta psi - their trim); `gains` [4, 6] for lon lat col ped."""

    gains: Array


PITCH, ROLL, YAW = 1.2, 1.6, 1.0  # rad/s: attitude frequencies that the feedback aims at
DAMPING = 0.7  # of the attitude, over critical


def design(linear: LinearAircraft) -> Augmentation:
    """Gains that give each axis the wanted attitude frequency and damping, from the aircraft's own derivatives.

    Source: McRuer, Ashkenas, Graham, Aircraft Dynamics and Automatic Control, chapter 8 (attitude and rate to control).
    """
    gains = np.zeros((4, 6))
    for axis, control, frequency in ((0, 1, ROLL), (1, 0, PITCH), (2, 3, YAW)):
        power, damping = linear.b[3 + axis, control], linear.a[3 + axis, 3 + axis]
        gains[control, 3 + axis] = -(frequency**2) / power
        gains[control, axis] = -max(2.0 * DAMPING * frequency + damping, 0.0) / power
    return Augmentation(gains)
