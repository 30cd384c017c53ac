"""Induced velocity of a rotor by momentum theory, in climb, level flight and descent, and its thrust in such flow."""

from typing import NamedTuple

import torch
from torch import Tensor

ITERATIONS = 4
"""Steps of Newton: errors are below 1e-8 of the induced velocity in hover."""
STILL = 1e-12
"""m4/s4 and m2/s2 that keep roots and quotients finite at no thrust and no flow."""
RING = 0.75
"""Descents, over the induced velocity in hover, from 1 to where momentum theory first has several solutions."""
STEEPEST = 0.75
"""Share of its slope that the flow may lose to descent in a step."""
USUAL_RATIO, USUAL_PITCH = 0.07, 0.2
"""Induced velocity over the speed of the tips in hover, sqrt(C_T/2) at C_T = 0.01, and the pitch, rad, that it takes.

6 C_T/(sigma a) + 1.5 sqrt(C_T/2) with a solidity of 0.1 (Leishman, Principles of Helicopter Aerodynamics, sec. 3.3).
"""
USUAL_TILT = 1.0 / (4.0 / 3.0 * USUAL_PITCH / USUAL_RATIO - 1.0)
"""Share of a disc's tilt by speed that doubling the flow through it takes away: 2 lambda/(8/3 theta - 2 lambda)."""
LEAST_INFLOW = 1e-6
"""m/s."""
LEAST_THRUST = 0.01
"""Of the usual thrust, below which the speed of a rotor falls no more."""


def induced_velocity(
    thrust: Tensor, across: Tensor, climb: Tensor, loss: Tensor | float = 0.0, still: Tensor | float = 0.0
) -> Tensor:
    """Induced velocity v, m/s, that solves v sqrt(across + (v + climb)^2) = thrust - loss (v + climb - still).

    thrust : T/(2 rho A), m2/s2, the square of the velocity in hover. across : square of the speed in the disc, m2/s2.
    climb : m/s along the thrust. loss : of that thrust by each m/s that flows through the disc beyond `still`, m/s.
    Steep descents faster than the velocity in hover (vortex ring, windmill) have several solutions or none that is
    steady: `across` counts there for climb^2/2 at least, with which there is one, continuous in all three. From 1 to
    1.75 times the velocity in hover this limit grows to its whole size.

    Source: Glauert (1926); Padfield, Helicopter Flight Dynamics, eq. 3.118 ff.; Leishman, Principles of Helicopter
    Aerodynamics, sec. 3.3 (blade elements: thrust falls in proportion to the flow).
    """
    # the thrust enters by its size: a free run that has gone astray must not end in NaN
    fourth = thrust * thrust + STILL
    size = torch.sqrt(fourth)
    descent = torch.relu(-climb)
    ring = torch.clamp((descent / torch.sqrt(size) - 1.0) / RING, 0.0, 1.0)
    across = torch.maximum(across, 0.5 * ring * descent * descent)
    level = fourth / (0.5 * across + torch.sqrt(0.25 * across * across + fourth))
    part = 0.5 * climb * level / size
    v = torch.sqrt(part * part + level) - part  # exact without climb, and without speed across
    for _ in range(ITERATIONS):
        through = v + climb
        speed = torch.sqrt(across + through * through + STILL)
        left = v * speed - size + loss * (through - still)
        v = v - left / (speed + torch.maximum(v * through / speed, -STEEPEST * speed) + loss)
    return v


class Flow(NamedTuple):
    """Flow through the rotors of a vehicle [..., motors] and what it takes of their thrust.

    across : square of each hub's speed in its disc, m2/s2. climb : along the thrust, m/s. hover : induced velocity in
    hover at the usual thrust, m/s. loss : thrust over the usual by each m/s that flows through the disc, at the usual
    rotor speed, s/m; `felt` is the part of it that lowers the induced velocity, by momentum theory all of it. pitch :
    blades' pitch over the speed of their tips, at the usual rotor speed, s/m.
    """

    across: Tensor
    climb: Tensor
    hover: Tensor
    loss: Tensor
    felt: Tensor
    pitch: Tensor

    def share(self, hovering: Tensor) -> Tensor:
        """Thrust over the usual, of rotors that would have `hovering` of it in hover at their speed.

        With sigma = sqrt(hovering) the speed of a rotor over the usual, v_h the induced velocity in hover,
        T = hovering - loss (sigma (v + climb - sigma v_h) - pitch across) and v that of this thrust.

        Source: Leishman, Principles of Helicopter Aerodynamics, sec. 3.3 and 3.5 (blade elements with uniform inflow,
        in hover and in forward flight: C_T = sigma a/2 (theta/3 (1 + 3/2 mu^2) - lambda/2)).
        """
        sigma = torch.sqrt(torch.clamp(hovering, min=LEAST_THRUST))
        return hovering - self.loss * sigma * (self._through(sigma) - self._still(sigma))

    def tilt(self, sigma: Tensor) -> Tensor:
        """Tilt of discs by speed across, over that in the flow of hover, at this speed of the rotors over the usual.

        1 + e (1 - (v + climb)/(sigma v_h)): an advancing blade rises by its lift, which flow through the disc lowers.

        Source: Bramwell, Helicopter Dynamics, ch. 3: a1 = mu (8/3 theta - 2 lambda)/(1 - mu^2/2), for small mu.
        """
        usual = sigma * self.hover.clamp(min=LEAST_INFLOW)
        return (1.0 + USUAL_TILT * (1.0 - self._through(sigma) / usual)).clamp(min=0.0)  # no disc tilts ahead

    def _through(self, sigma: Tensor) -> Tensor:
        square = self.hover * self.hover
        thrust, loss = square * sigma * sigma, self.felt * sigma * square
        return induced_velocity(thrust, self.across, self.climb, loss, self._still(sigma)) + self.climb

    def _still(self, sigma: Tensor) -> Tensor:
        return self.hover * sigma + self.pitch * self.across / sigma
