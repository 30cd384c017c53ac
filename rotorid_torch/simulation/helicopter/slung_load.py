"""A load on a cable below the aircraft: a point mass on a rigid cable that may swing both ways, and pulls at the hook.

The cable's direction is a unit vector c from hook to load; its north and east components and their rates are the
states, so that a load at rest hangs at zero whatever the aircraft's attitude. The tension is
m (l |dc/dt|^2 - c.f) + c.D with the specific force f of the hook and the air's force D on the load; as for the blades,
the unknown part of f enters by a matrix, here m c c'.

Source: Cicolani and Kanning, NASA TP-3280 (equations of slung-load systems), for one load on one cable.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rotorid_torch.simulation.rigid import Array, cross, dot, turned


@dataclass(frozen=True)
class SlungLoad:
    """`mass` kg, `cable` m, `hook` from the centre of gravity in body axes, m; `drag_area` m^2.

    `damping`: of the swing in still air, as a part of critical (swivel, tumbling wake), felt as a force on the load.
    """

    mass: float
    cable: float
    hook: tuple[float, float, float]
    drag_area: float
    damping: float


@dataclass(frozen=True)
class Pull:
    """The cable at an instant, body axes: `direction`, its lever cross product `turning`, known `force`, [3, flight].

    `direction_earth`, `rate_earth`, `air_earth` (specific force of the air on the load, m/s^2) are north, east, down.
    """

    direction: Array
    turning: Array
    force: Array
    centripetal: Array
    direction_earth: Array
    rate_earth: Array
    air_earth: Array


class Surroundings(NamedTuple):
    """Where the load hangs: `to_earth` [3, 3, flight], air density, kg/m^3, gravity, m/s^2."""

    earth: Array
    density: float
    gravity: float


def cable_pull(load: SlungLoad, swing: Array, velocity: Array, omega: Array, surroundings: Surroundings) -> Pull:
    """What the cable does to the hook, but for the part that the unknown accelerations bring.

    swing : [4, flight] north and east component of the cable's direction, and their rates, 1/s.
    velocity, omega : [3, flight] of the centre of gravity through the air (m/s) and of the body (rad/s), body axes.
    """
    earth, density, gravity = surroundings
    north, east, dn, de = swing
    down = np.sqrt(np.maximum(1.0 - north * north - east * east, 0.01))
    c, rate = np.stack([north, east, down]), np.stack([dn, de, -(north * dn + east * de) / down])
    hook = np.asarray(load.hook)[:, None] + np.zeros_like(omega)
    around = cross(omega, hook)
    through = turned(earth, velocity + around) + load.cable * rate
    size = np.sqrt(dot(through, through))
    natural = np.sqrt(gravity / load.cable)
    air = -(0.5 * density * load.drag_area / load.mass) * size * through
    air = air - (2.0 * load.damping * natural * load.cable) * rate
    direction = turned(earth.swapaxes(0, 1), c)
    centripetal = cross(omega, around)
    tension_terms = load.mass * (load.cable * dot(rate, rate) - dot(direction, centripetal) + dot(c, air))
    return Pull(direction, cross(hook, direction), tension_terms * direction, centripetal, c, rate, air)


def swing_rates(load: SlungLoad, pull: Pull, specific_force: Array, angular: Array, earth: Array) -> Array:
    """Rates of the four states, once specific force (m/s^2) and angular acceleration of the body are known."""
    hook = np.asarray(load.hook)[:, None] + np.zeros_like(angular)
    felt = turned(earth, specific_force + cross(angular, hook) + pull.centripetal)
    c, rate = pull.direction_earth, pull.rate_earth
    driven = (pull.air_earth - felt) / load.cable
    second = driven - (dot(c, driven) + dot(rate, rate)) * c
    return np.stack([rate[0], rate[1], second[0], second[1]])
