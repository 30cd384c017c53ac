"""Tail rotor, fuselage, fin and tailplane of a batch of helicopters, and the main rotor's wake that blows on them."""

import numpy as np

from rotorid_torch.simulation.helicopter.airframe import downwash
from rotorid_torch.simulation.helicopter.inflow import MASS
from rotorid_torch.simulation.multiblade.craft import Craft, to_shaft
from rotorid_torch.simulation.rigid import Array, cross

STALL = 0.3  # tangent of the angle of attack at which half of a surface's flow is separated


def airframe_loads(craft: Craft, x: Array, pedal: Array, sweep: Array) -> tuple[Array, Array, Array]:
    """Force (N) and moment (N m) of all but the main rotor, body axes, and the rate of the tail rotor's inflow.

    x : [31, aircraft, flight] states; pedal : [aircraft, flight] rad; sweep : [2, aircraft, flight] of the wake.
    """
    velocity, omega, speed = x[0:3], x[3:6], x[28]
    mean = x[24] * speed * craft.radius
    force, rate = _tail(craft, _at(craft.tail_position, velocity, omega), x[27], pedal, speed)
    moment = cross(craft.tail_position, force)
    body, turning = _fuselage(craft, _at(craft.fuselage_position, velocity, omega), sweep, mean)
    for place, load in (
        (craft.fuselage_position, body),
        (craft.fin_position, _fin(craft, _at(craft.fin_position, velocity, omega))),
        (craft.plane_position, _plane(craft, _at(craft.plane_position, velocity, omega), sweep, mean)),
    ):
        force = force + load
        moment += cross(place, load)
    return force, moment + turning, rate


def _at(place: Array, velocity: Array, omega: Array) -> Array:
    """Velocity of a point of the body."""
    return velocity - cross(place, omega)


def _wash(craft: Craft, place: Array, sweep: Array, mean: Array) -> Array:
    """Downwash at a point, m/s."""
    return downwash(craft.radius, to_shaft(craft.tilt, place - craft.hub), sweep, mean)


def _tail(craft: Craft, velocity: Array, inflow: Array, pitch: Array, rotor_speed: Array) -> tuple[Array, Array]:
    """Force of the tail rotor, N, and the rate of its inflow, 1/s.

    Source: Bailey, NACA Report 716 (thrust with tip loss); Pitt and Peters (1981), uniform component.
    """
    speed, b = craft.tail_gear * rotor_speed, craft.tail_tip_loss
    tip_speed = speed * craft.tail_radius
    side, upward = np.cos(craft.tail_cant), -np.sin(craft.tail_cant)
    axial = (side * velocity[1] + upward * velocity[2]) / tip_speed
    square = np.maximum((velocity * velocity).sum(0) / (tip_speed * tip_speed) - axial * axial, 0.0)
    through = inflow + axial
    cone = 0.5 * craft.tail_lock * craft.tail_delta3
    coning = cone * (b**5 / 5.0 * craft.tail_twist - b**3 / 3.0 * through)
    blade = (pitch - coning) / (1.0 + cone * b**4 / 4.0)
    lift = (b**3 / 3.0 + 0.5 * b * square) * blade + 0.25 * b**2 * (b**2 + square) * craft.tail_twist
    thrust = 0.5 * craft.tail_solidity * craft.tail_lift_slope * (lift - 0.5 * b**2 * through)
    rate = speed / MASS[0] * (thrust - 2.0 * inflow * np.sqrt(square + through * through))
    size = craft.tail_blockage * craft.density * np.pi * craft.tail_radius**2 * tip_speed * tip_speed * thrust
    return np.stack([np.zeros_like(size), side * size, upward * size]), rate


def _fuselage(craft: Craft, velocity: Array, sweep: Array, mean: Array) -> tuple[Array, Array]:
    """Force and free moment of the fuselage.

    Source: Padfield, Helicopter Flight Dynamics, section 3A.4 (areas and volumes); Hoerner, Fluid-Dynamic Drag,
    section 3-11 (cross-flow principle).
    """
    along, right, down = velocity
    down_flow = down - craft.fuselage_wake * _wash(craft, craft.fuselage_position, sweep, mean)
    across, ahead = np.hypot(right, down_flow), np.abs(along)
    half = -0.5 * craft.density
    back = half * craft.fuselage_drag[0] * along * ahead
    side = half * (craft.fuselage_drag[1] * across + craft.fuselage_lift[0] * ahead) * right
    below = half * (craft.fuselage_drag[2] * across * down_flow + craft.fuselage_lift[1] * ahead * down)
    pitching, yawing = -half * craft.fuselage_pitch * along * down, half * craft.fuselage_yaw * along * right
    return np.stack([back, side, below]), np.stack([np.zeros_like(along), pitching, yawing])


def _surface(density: Array, area: Array, slope: Array, chordwise: Array, normal: Array) -> Array:
    """Normal force of a thin surface, N: linear lift that gives way to a flat plate's.

    Source: Hoerner, Fluid-Dynamic Drag (flat plate: normal force 2 sin(alpha)).
    """
    fourth = (chordwise * chordwise) ** 2
    attached = fourth / (fourth + (normal * normal / STALL**2) ** 2 + 1e-9)
    total = np.hypot(chordwise, normal)
    return -0.5 * density * area * normal * (attached * slope * np.abs(chordwise) + (1.0 - attached) * 2.0 * total)


def _fin(craft: Craft, velocity: Array) -> Array:
    """Side force of the fin; `fin_area` counts what hub and fuselage leave of the flow."""
    side = _surface(craft.density, craft.fin_area, craft.fin_lift_slope, velocity[0], velocity[1])
    return np.stack([np.zeros_like(side), side, np.zeros_like(side)])


def _plane(craft: Craft, velocity: Array, sweep: Array, mean: Array) -> Array:
    """Force of the tailplane, in stream and wake; its incidence may go with the speed."""
    incidence = craft.plane_incidence + craft.plane_schedule * (velocity[0] - craft.plane_speed)
    c, s = np.cos(incidence), np.sin(incidence)
    down = velocity[2] - craft.plane_wake * _wash(craft, craft.plane_position, sweep, mean)
    chordwise, normal = c * velocity[0] - s * down, c * down + s * velocity[0]
    size = _surface(craft.density, craft.plane_area, craft.plane_lift_slope, chordwise, normal)
    return np.stack([s * size, np.zeros_like(size), c * size])
