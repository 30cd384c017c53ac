"""Blade elements of a propeller with uniform inflow, integrated over radius and azimuth in closed form.

A blade at azimuth psi (0 aft of the motion) meets the air with u_T = Omega r + V sin psi in the disc and with u_P down
through it; an element lifts rho/2 c a (theta u_T^2 - u_P u_T) and drags rho/2 c (c_d u_T^2 + a (theta u_T u_P -
u_P^2)). With sections that are linear, a pitch that is linear in the radius and no reversed flow, means over a
revolution are polynomials. Blades flap against a spring at the centre, first harmonics in balance at every instant.

Rows are rotors, columns vehicles in flight: [rotor, column].

Source: Leishman, Principles of Helicopter Aerodynamics, chapters 3 and 4 (blade elements), 2.14 (momentum theory);
Bramwell, Helicopter Dynamics, chapter 3 (flapping with a spring).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rotorid_torch.simulation.multirotor.craft import Propeller
from rotorid_torch.simulation.rigid import Array


class Flow(NamedTuple):
    """Air at the rotors: `down` through the disc beside the induced velocity, and `lift` and `drag`: in the disc.

    m/s. `lift` is the speed that counts for thrust, `drag` [2, rotor, column] the velocity that counts for forces in
    the disc; `spared` the share of the induced velocity that the ground takes away.
    """

    down: Array
    lift: Array
    drag: Array
    spared: Array | float = 0.0


class Loads(NamedTuple):
    """Of each rotor: thrust, N; force in the disc, N, and moment on the hub, N m, along x and y; shaft torque, N m."""

    thrust: Array
    across: Array
    hub: Array
    torque: Array


@dataclass(frozen=True)
class Blades:
    """Constants of the integrals for a column each, [column]; `of` makes them for vehicles side by side."""

    density: Array
    radius: Array
    disc: Array
    area: Array
    slope: Array
    drag: Array
    pitch: Array
    pitch0: Array
    lock: Array
    stiffness: Array
    count: Array

    @classmethod
    def of(cls, propellers: list[Propeller], density: Array) -> Blades:
        """`area` : blades times chord times radius; `pitch`, `pitch0` : moments of the pitch over the radius."""

        def row(name: str) -> Array:
            return np.array([float(getattr(one, name)) for one in propellers])

        radius, theta, twist = row("radius"), row("pitch"), row("twist")
        return cls(
            density=density,
            radius=radius,
            disc=np.pi * radius**2,
            area=row("blades") * row("chord") * radius,
            slope=row("lift_slope"),
            drag=row("drag"),
            pitch=theta / 3.0 + twist / 4.0,
            pitch0=theta + twist / 2.0,
            lock=row("lock"),
            stiffness=row("stiffness"),
            count=row("blades"),
        )

    def thrust_parts(self, speed: Array, lift: Array | float, strength: Array | float) -> tuple[Array, Array]:
        """Thrust without flow through the disc, N, and how much of it a flow of 1 m/s takes, N s/m."""
        tip = speed * self.radius
        scale = 0.5 * self.density * self.area * self.slope * strength
        return scale * (tip * tip * self.pitch + 0.5 * lift * lift * self.pitch0), 0.5 * scale * tip

    def inflow_step(self, speed: Array, induced: Array, flow: Flow, strength: Array, dt: float) -> Array:
        """Induced velocity, m/s, a step of dt later: air mass that is accelerated by thrust less momentum flow.

        One linearly implicit step; where inflow settles within a step it is that of momentum theory.

        Source: Pitt and Peters, Vertica 5 (1981): 8/(3 pi) rho A R dv/dt = T - 2 rho A v sqrt(V^2 + (v + V_c)^2).
        """
        still, loss = self.thrust_parts(speed, flow.lift, strength)
        stream = induced + flow.down
        through = np.sqrt(flow.lift * flow.lift + stream * stream) + 1e-9
        mass_flow = 2.0 * self.density * self.disc
        share = 1.0 - flow.spared
        surplus = still - loss * (share * induced + flow.down) - mass_flow * induced * through
        slope = loss * share + mass_flow * np.maximum(through + induced * stream / through, 0.2 * through)
        inert = (8.0 / (3.0 * np.pi)) * self.density * self.disc * self.radius
        return np.maximum(induced + dt * surplus / (inert + dt * slope), 0.0)

    def loads(self, speed: Array, induced: Array, flow: Flow, strength: Array, spins: Array) -> Loads:
        """Loads at rotor speeds, rad/s, and induced velocities, m/s; `spins` as of `craft.Multirotor`, [rotor, 1]."""
        still, loss = self.thrust_parts(speed, flow.lift, strength)
        down = (1.0 - flow.spared) * induced + flow.down
        thrust = still - loss * down
        tip = speed * self.radius
        scale = 0.5 * self.density * self.area
        profile = self.drag * (0.25 * tip * tip + 0.25 * flow.lift * flow.lift)
        carried = self.slope * strength * down * (tip * self.pitch - 0.5 * down)
        torque = scale * self.radius * (profile + carried)
        drag = scale * (0.5 * self.drag * tip + 0.5 * self.slope * strength * down * self.pitch0)
        back, side = self._flapping(tip, down)
        hub = (0.5 * self.density * self.area * self.slope / self.lock) * self.stiffness * tip * tip * self.radius
        u, v = flow.drag
        drag, right = drag + thrust * back, spins * side
        across = np.stack([-drag * u - thrust * right * v, -drag * v + thrust * right * u])
        moment = np.stack([hub * (right * u - back * v), hub * (right * v + back * u)])
        return Loads(thrust, across, moment, torque)

    def _flapping(self, tip: Array, down: Array) -> tuple[Array, Array]:
        """Tilt of the disc backwards and to the advancing side per m/s of velocity in the disc, rad s/m."""
        driven = 0.5 * self.lock / tip * (2.0 * self.pitch - 0.5 * down / tip)
        damping = self.lock / 8.0
        size = driven / (self.stiffness**2 + damping**2)
        return damping * size, -self.stiffness * size


def hover_thrust(propeller: Propeller, density: float, speed: float) -> tuple[float, float, float]:
    """Thrust, N, torque, N m, and induced velocity, m/s, of a rotor that hovers alone.

    Blade elements and momentum theory agree where 2 rho A v^2 = still - loss v.
    """
    blades = Blades.of([propeller], np.array([density]))
    still, loss = (float(part[0]) for part in blades.thrust_parts(np.array([speed]), 0.0, 1.0))
    flow = 2.0 * density * propeller.disc
    induced = (np.sqrt(loss * loss + 4.0 * flow * still) - loss) / (2.0 * flow)
    calm = Flow(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((2, 1, 1)))
    one = np.ones((1, 1))
    loads = blades.loads(speed * one, induced * one, calm, one, one)
    return float(loads.thrust[0, 0]), float(loads.torque[0, 0]), float(induced)


def lift_for(propeller: Propeller, density: float, share: float) -> float:
    """Lift of the sections over the usual with which a rotor that hovers alone gives this share of the usual thrust.

    At the same speed; less thrust makes less inflow, so that lift falls by more than thrust does.
    """
    blades = Blades.of([propeller], np.array([density]))
    still, loss = (float(part[0]) for part in blades.thrust_parts(np.ones(1), 0.0, 1.0))
    thrust, _, induced = hover_thrust(propeller, density, 1.0)
    return share * thrust / (still - loss * induced * np.sqrt(share))
