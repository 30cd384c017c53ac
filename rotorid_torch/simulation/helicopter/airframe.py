"""Fuselage, fin and tailplane, and the main rotor's wake that blows on them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rotorid_torch.simulation.helicopter.section import Section
from rotorid_torch.simulation.rigid import Array


@dataclass(frozen=True)
class Fuselage:
    """Bluff body with lift and unstable moments.

    `drag_area` along the body axes and `lift_area` to the side and downwards (lift slope x area), m^2; `pitch_volume`
    and `yaw_volume` of the unstable pressure field, m^3; `wake_factor`: downwash over mean induced velocity.
    """

    position: tuple[float, float, float]
    drag_area: tuple[float, float, float]
    lift_area: tuple[float, float]
    pitch_volume: float
    yaw_volume: float
    wake_factor: float


@dataclass(frozen=True)
class Surface:
    """Fin (`upright`: it lifts to the side) or tailplane.

    The incidence goes from `incidence[0]` to `incidence[1]` around `schedule` m/s.
    """

    position: tuple[float, float, float]
    area: float
    section: Section
    upright: bool
    incidence: tuple[float, float]
    schedule: float
    wake_factor: float
    shading: float  # part of the dynamic pressure that hub and fuselage leave

    schedule_width = 8.0  # m/s

    @cached_property
    def normal(self) -> Array:
        """Unit vector against which a positive angle of attack lifts, body axes (down, or right)."""
        return np.array([0.0, 1.0, 0.0] if self.upright else [0.0, 0.0, 1.0])


def downwash(radius: float | Array, places: Array, sweep: Array, mean: Array) -> Array:
    """Downwash of the main rotor at points of the airframe, m/s.

    A swept cylinder with a soft edge: inside it the wake blows with the mean induced velocity, outside it does not.
    Distance and radius are taken across the wake, which gets flat where it is swept far.

    places : [3, point, 1] positions from the hub, (aft, right, up), m.
    sweep : [2, flight] `inflow.wake_sweep`.
    mean : [flight] mean induced velocity, m/s.

    Returns [point, flight].
    """
    aft, right, up = places
    square = (sweep * sweep).sum(0)
    cosine, sine = (1.0 - square) / (1.0 + square), sweep * (2.0 / (1.0 + square))
    away = np.hypot(aft * cosine + up * sine[0], right * cosine + up * sine[1])
    return mean * (0.5 - 0.5 * np.tanh((away / radius - WAKE_RADIUS * cosine) / WAKE_EDGE))


WAKE_RADIUS, WAKE_EDGE = 0.8, 0.35  # of the rotor's radius: contracted wake, width of its edge


def fuselage_loads(fuselage: Fuselage, velocity: Array, wash: Array, density: float) -> tuple[Array, Array]:
    """Force (N) and moment about the fuselage's own point (N m), body axes, [3, flight].

    velocity : [3, flight] of that point through the free air.
    wash : [flight] downwash, m/s.

    Source: Padfield, Helicopter Flight Dynamics, section 3A.4 (fuselage as areas and volumes); Hoerner, Fluid-Dynamic
    Drag, section 3-11 (cross-flow principle).
    """
    air = velocity.copy()
    air[2] -= fuselage.wake_factor * wash
    # Cross-flow principle: the flow along the body and the flow across it do not feel each other.
    across = np.hypot(air[1], air[2])
    flow = np.stack([np.abs(air[0]), across, across])
    force = (-0.5 * density) * np.asarray(fuselage.drag_area)[:, None] * air * flow
    force[1:] -= (0.5 * density) * np.asarray(fuselage.lift_area)[:, None] * flow[0] * velocity[1:]
    moment = np.zeros_like(force)
    moment[1] = (0.5 * density * fuselage.pitch_volume) * velocity[0] * velocity[2]
    moment[2] = (-0.5 * density * fuselage.yaw_volume) * velocity[0] * velocity[1]
    return force, moment


def surface_force(surface: Surface, velocity: Array, wash: Array, density: float) -> Array:
    """Force of a fin or tailplane, N, body axes, [3, flight].

    velocity : [3, flight] of the surface through the free air.
    wash : [flight] downwash, m/s.
    """
    across = velocity[1] if surface.upright else velocity[2] - surface.wake_factor * wash
    ahead = velocity[0]
    blend = 0.5 * (1.0 + np.tanh((np.abs(ahead) - surface.schedule) / surface.schedule_width))
    incidence = surface.incidence[0] + blend * (surface.incidence[1] - surface.incidence[0])
    lift, drag = surface.section.coefficients(incidence + np.arctan2(across, ahead))
    pressure = (0.5 * density * surface.area * surface.shading) * np.sqrt(ahead * ahead + across * across)
    normal = -pressure * (lift * ahead + drag * across)
    force = surface.normal[:, None] * normal
    force[0] += pressure * (lift * across - drag * ahead)
    return force
