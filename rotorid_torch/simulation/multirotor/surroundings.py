"""What surrounds the vehicle: images of the rotors below the ground, wind and gusts.

Arrays have a column for each vehicle in flight.
"""

from collections.abc import Sequence

import numpy as np

from rotorid_torch.simulation.helicopter.atmosphere import Passage, Turbulence, gusts
from rotorid_torch.simulation.multirotor.craft import Multirotor
from rotorid_torch.simulation.rigid import Array

LOWEST = 0.3
"""Height of a rotor over its radius, below which the images do not come nearer."""


def ground_share(height: Array, spacing: Array, radius: Array, ratio: Array) -> Array:
    """Share of each rotor's induced velocity that the images of all rotors below the ground take away, [rotor, column].

    Each rotor is a source on its disc, its image an equal one as far below the ground; the wake is swept away from
    below by motion through the air.

    height : of the rotors, m, [rotor, column]. spacing : squares of the distances between rotors, m^2, [rotor, rotor,
        column]. radius : m, [column]. ratio : velocity in the disc over the induced velocity, [rotor, column].

    Source: Cheeseman and Bennett, ARC R&M 3021 (1955) (one rotor, R^2/16 z^2); Sanchez-Cuevas, Heredia and Ollero,
    International Journal of Aerospace Engineering (2017) (sources of all rotors).
    """
    apart = 2.0 * np.maximum(height, LOWEST * radius)
    distance = apart[:, None] ** 2 + spacing
    share = (0.25 * radius**2) * (apart[:, None] / (distance * np.sqrt(distance))).sum(1)
    return np.minimum(share / (1.0 + ratio * ratio), 0.9)


def turbulence(craft: Sequence[Multirotor], names: Sequence[str], steps: int, dt: float, seed: int) -> Array | None:
    """Gusts of all columns at steps 0 to `steps`, north east down, m/s, [steps + 1, 3, column]; None where none blow.

    Every flight has a stream of its own.

    Source: MIL-F-8785C, as in `helicopter.atmosphere`.
    """
    if not any(one.air.gusts for one in craft):
        return None
    rows = np.zeros((steps + 1, 3, len(craft)))
    for column, (one, name) in enumerate(zip(craft, names, strict=True)):
        if one.air.gusts:
            passage = Passage(one.height, max(one.speed, float(np.hypot(*one.air.wind[:2]))))
            rows[:, :, column] = gusts(Turbulence(one.air.gusts), passage, dt, steps, name, seed).T
    return rows
