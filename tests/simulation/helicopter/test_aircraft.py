"""The coupled motion of body and blades: conservation in vacuum, equations of motion, another integrator."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorid_torch.simulation.flight.motion import rates
from rotorid_torch.simulation.flight.runge_kutta import runge_kutta
from rotorid_torch.simulation.helicopter.aircraft import AZIMUTH, BLADES, SPEED, Aircraft
from rotorid_torch.simulation.helicopter.rotor import blade_motion, turn_back
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft


def in_vacuum(aircraft: Aircraft, blades: int) -> Aircraft:
    """Without air, damper and engine: nothing but inertia, springs and gravity."""
    rotor = dataclasses.replace(aircraft.rotor, blades=blades, lag_damper=0.0, flap_spring=3e4)
    governor = dataclasses.replace(
        aircraft.governor, held=False, proportional=0.0, integral=0.0, derivative=0.0, inertia=900.0
    )
    return dataclasses.replace(aircraft, rotor=rotor, governor=governor, air_density=1e-30)


def tumbling(aircraft: Aircraft) -> np.ndarray:
    """A violent initial state, [states, 1]."""
    rng = np.random.default_rng(5)
    x = np.zeros((aircraft.states, 1))
    x[:12, 0] = [5.0, -3.0, 2.0, 0.9, -0.7, 0.8, 0.3, -0.2, 0.4, 0.0, 0.0, 100.0]
    x[16:20, 0] = 0.05
    x[SPEED] = 27.0
    scale = np.repeat([0.15, 1.5, 0.1, 1.0], aircraft.rotor.blades)
    x[BLADES:, 0] = scale * rng.standard_normal(len(scale))
    return x


def body_to_earth(x: np.ndarray) -> np.ndarray:
    """Rotation matrix of the Euler angles, north-east-down."""
    (cp, ct, cs), (sp, st, ss) = np.cos(x[6:9, 0]), np.sin(x[6:9, 0])
    return np.array(
        [
            [ct * cs, sp * st * cs - cp * ss, cp * st * cs + sp * ss],
            [ct * ss, sp * st * ss + cp * cs, cp * st * ss - sp * cs],
            [-st, sp * ct, cp * ct],
        ]
    )


def whole(aircraft: Aircraft, x: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre of mass of body and blades (north, east, down), and the energy, from positions and velocities."""
    rotor = aircraft.rotor
    m, s, i, e = rotor.blade_mass, rotor.first_moment, rotor.flap_inertia, rotor.hinge_offset
    omega, to_body = x[3:6, 0], rotor.to_shaft.T
    blades = x[BLADES:].reshape(4, rotor.blades, 1)
    motion = blade_motion(rotor, blades, rotor.to_shaft @ x[3:6], x[AZIMUTH], x[SPEED])

    def body(vector: np.ndarray) -> np.ndarray:
        return to_body @ turn_back(vector, motion.cosine, motion.sine)[:, :, 0]

    d, arm = body(motion.d), body(np.stack([np.full_like(motion.lag, e), 0 * motion.lag, 0 * motion.lag]))
    d_rate = body(motion.n * motion.normal_rate + motion.t * motion.lagging_rate)
    hub = np.asarray(rotor.hub)
    hinge_rate = x[:3] + np.cross(omega, hub)[:, None] + body(np.cross(motion.spin, [e, 0, 0], axis=0))
    total = aircraft.mass + rotor.blades * m
    earth, place = body_to_earth(x), x[9:12, 0] * [1.0, 1.0, -1.0]
    centre = place + earth @ (m * (hub[:, None] + arm) + s * d).sum(1) / total
    moving = 0.5 * aircraft.mass * (x[:3] ** 2).sum() + 0.5 * omega @ aircraft.inertia_matrix @ omega
    moving += 0.5 * aircraft.governor.inertia * x[SPEED, 0] ** 2
    moving += 0.5 * (m * hinge_rate**2 + 2 * s * hinge_rate * d_rate + i * d_rate**2).sum()
    springs = 0.5 * (rotor.flap_spring * blades[0] ** 2 + rotor.lag_spring * blades[2] ** 2).sum()
    return centre, float(moving + springs - total * aircraft.gravity * centre[2])


@pytest.mark.parametrize("blades", [2, 4, 5])
def test_energy_and_momentum_are_conserved_in_vacuum(blades):
    """Blades, hinges, springs, shaft and body exchange energy and momentum, and lose none."""
    aircraft = in_vacuum(load_aircraft(), blades)
    x, dt, steps = tumbling(aircraft), 5e-4, 600
    command = np.zeros((4, 1))
    centres, energies = [], []
    for _ in range(steps + 1):
        centre, energy = whole(aircraft, x)
        centres.append(centre)
        energies.append(energy)
        slope = rates(aircraft, x, command)[0]
        x = runge_kutta(lambda state, hand: rates(aircraft, state, hand)[0], x, slope, (command,) * 3, dt)
    assert np.ptp(energies) < 1e-7 * abs(energies[0])
    time = dt * np.arange(steps + 1)
    fall = np.array(centres) - 0.5 * aircraft.gravity * time[:, None] ** 2 * [0.0, 0.0, 1.0]
    straight = fall[:1] + (fall[-1:] - fall[:1]) * (time / time[-1])[:, None]
    np.testing.assert_allclose(fall, straight, atol=1e-7)


@pytest.mark.parametrize("held", [True, False])
def test_loads_satisfy_the_equations_of_motion_of_the_declared_body(hover, held):
    """F = m (a - g) and M = J omega' + omega x J omega, whatever the state; far from trim too."""
    governor = dataclasses.replace(hover.aircraft.governor, held=held)
    aircraft = dataclasses.replace(hover.aircraft, governor=governor)
    rng = np.random.default_rng(0)
    x = np.repeat(hover.trim.state[:, None], 20, axis=1) + 0.1 * rng.standard_normal((aircraft.states, 20))
    dx, motion = rates(aircraft, x, x[12:16])
    omega, inertia = x[3:6], aircraft.inertia_matrix
    phi, theta = x[6], x[7]
    gravity = 9.80665 * np.stack([-np.sin(theta), np.sin(phi) * np.cos(theta), np.cos(phi) * np.cos(theta)])
    force = aircraft.mass * (dx[:3] + np.cross(omega, x[:3], axis=0) - gravity)
    moment = inertia @ dx[3:6] + np.cross(omega, inertia @ omega, axis=0)
    np.testing.assert_allclose(motion.force, force, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(motion.moment, moment, rtol=1e-9, atol=1e-5)


def test_free_response_equals_another_integrator(hover):
    """Half a second from a disturbed hover with a control step: our steps of 5 degrees against DOP853 at 1e-10."""
    aircraft = hover.aircraft
    x0 = hover.trim.state.copy()
    x0[[0, 3, 4, 7, 24]] += [1.0, 0.1, -0.1, 0.02, 0.02]
    command = hover.trim.controls[:, None] + np.array([[0.03], [-0.02], [0.01], [0.03]])

    def slope(state: np.ndarray, hand: np.ndarray) -> np.ndarray:
        return rates(aircraft, state, hand)[0]

    dt, x = 1.0 / 308.0, x0[:, None]
    for _ in range(154):
        x = runge_kutta(slope, x, slope(x, command), (command, command, command), dt)
    exact = solve_ivp(
        lambda _, state: slope(state[:, None], command)[:, 0], (0.0, 0.5), x0, method="DOP853", rtol=1e-10, atol=1e-12
    ).y[:, -1]
    moved = np.abs(exact[:12] - x0[:12])
    np.testing.assert_allclose(x[:12, 0], exact[:12], atol=2e-5 * (1.0 + moved.max()))
    np.testing.assert_allclose(x[12:, 0], exact[12:], atol=2e-4)


def test_blades_flap_at_their_natural_frequency(hover):
    """Rotating flap 1.035/rev and lag 0.29/rev (7.9 rad/s) from offset, first moment, inertia and spring."""
    rotor = hover.aircraft.rotor
    stiffening = rotor.hinge_offset * rotor.first_moment / rotor.flap_inertia
    assert np.sqrt(1.0 + stiffening) == pytest.approx(1.035, abs=0.002)
    lag = np.sqrt(rotor.speed**2 * stiffening + rotor.lag_spring / rotor.flap_inertia)
    assert lag == pytest.approx(7.9, abs=0.1)
