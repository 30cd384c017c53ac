"""Tail rotor: blade-element thrust in closed form with coning through the delta-three hinge, one inflow state."""

from dataclasses import dataclass

import numpy as np

from rotorid_torch.simulation.helicopter.inflow import MASS
from rotorid_torch.simulation.rigid import Array


@dataclass(frozen=True)
class TailRotor:
    """Tail rotor, all in SI. `cant` tilts its thrust (to the right) upwards; `gear` is its speed over the rotor's.

    `wake_factor`: how much of the main rotor's downwash at its place blows through it.
    """

    position: tuple[float, float, float]
    blades: int
    radius: float
    chord: float
    gear: float
    cant: float
    twist: float
    delta3: float
    lift_slope: float
    lock_number: float
    tip_loss: float
    fin_blockage: float
    wake_factor: float = 0.0

    @property
    def axis(self) -> Array:
        """Direction of the thrust, body axes."""
        return np.array([0.0, np.cos(self.cant), -np.sin(self.cant)])

    @property
    def solidity(self) -> float:
        """Blade area over disc area."""
        return self.blades * self.chord / (np.pi * self.radius)


def tail_rotor(
    tail: TailRotor, velocity: Array, inflow: Array, pitch: Array, rotor_speed: Array, density: float
) -> tuple[Array, Array]:
    """Force of the tail rotor and the rate of its inflow.

    velocity : [3, flight] of the tail rotor through the air, body axes.
    inflow : [flight] induced inflow ratio.
    pitch : [flight] collective, rad.
    rotor_speed : [flight] of the main rotor, rad/s.

    Returns [3, flight] N, body axes, and [flight] 1/s.

    Source: Bailey, NACA Report 716 (thrust with tip loss); Pitt and Peters (1981), uniform component.
    """
    speed = tail.gear * rotor_speed
    tip_speed, b = speed * tail.radius, tail.tip_loss
    axial = (tail.axis @ velocity) / tip_speed
    square = np.maximum((velocity * velocity).sum(0) / (tip_speed * tip_speed) - axial * axial, 0.0)
    through = inflow + axial
    # Coning by thrust takes pitch off through the delta-three hinge: solved in closed form.
    cone = 0.5 * tail.lock_number * np.tan(tail.delta3)
    coning = cone * (b**5 / 5.0 * tail.twist - b**3 / 3.0 * through)
    blade = (pitch - coning) / (1.0 + cone * b**4 / 4.0)
    lift = (b**3 / 3.0 + 0.5 * b * square) * blade + 0.25 * b**2 * (b**2 + square) * tail.twist - 0.5 * b**2 * through
    thrust = 0.5 * tail.solidity * tail.lift_slope * lift
    rate = speed / MASS[0] * (thrust - 2.0 * inflow * np.sqrt(square + through * through))
    scale = tail.fin_blockage * density * np.pi * tail.radius**2
    return tail.axis[:, None] * (scale * tip_speed * tip_speed * thrust), rate
