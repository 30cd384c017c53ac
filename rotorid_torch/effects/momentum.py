"""Induced velocity of a rotor by momentum theory, in climb, level flight and descent."""

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


def induced_velocity(thrust: Tensor, across: Tensor, climb: Tensor) -> Tensor:
    """Induced velocity v, m/s, that solves v sqrt(across + (v + climb)^2) = thrust.

    thrust : T/(2 rho A), m2/s2, the square of the velocity in hover. across : square of the speed in the disc, m2/s2.
    climb : m/s along the thrust. Steep descents faster than the velocity in hover (vortex ring, windmill) have several
    solutions or none that is steady: `across` counts there for climb^2/2 at least, with which there is one, continuous
    in all three. From 1 to 1.75 times the velocity in hover this limit grows to its whole size.

    Source: Glauert (1926); Padfield, Helicopter Flight Dynamics, eq. 3.118 ff.
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
        v = v - (v * speed - size) / (speed + torch.maximum(v * through / speed, -STEEPEST * speed))
    return v
