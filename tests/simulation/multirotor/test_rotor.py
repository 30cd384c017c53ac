"""Closed forms of the blade elements against sums over radius and azimuth, momentum theory, a blade that flaps."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorid_torch.simulation.multirotor.craft import Propeller
from rotorid_torch.simulation.multirotor.rotor import Blades, Flow, hover_thrust
from rotorid_torch.simulation.multirotor.surroundings import ground_share

PROPELLER = Propeller(radius=0.12, chord=0.02, blades=2, pitch=0.36, twist=-0.2, stiffness=0.0)
DENSITY, SPEED = 1.2, 500.0
ONE = np.ones((1, 1))


def blades(propeller=PROPELLER):
    return Blades.of([propeller], np.array([DENSITY]))


def flow(down=0.0, across=(0.0, 0.0)):
    u, v = across
    return Flow(down * ONE, np.hypot(u, v) * ONE, np.stack([u * ONE, v * ONE]))


def summed(propeller, down, across):
    """Loads of a rotor that turns counter-clockwise and does not flap, by sums over 200 radii and 360 azimuths."""
    r = (np.arange(200) + 0.5) * propeller.radius / 200
    psi = np.deg2rad(np.arange(360))[:, None]
    tangential = SPEED * r + across * np.sin(psi)
    theta = propeller.pitch + propeller.twist * r / propeller.radius
    scale = 0.5 * DENSITY * propeller.chord * propeller.radius / 200
    lift = scale * propeller.lift_slope * (theta * tangential**2 - down * tangential)
    induced = propeller.lift_slope * (theta * tangential * down - down**2)
    against = scale * (propeller.drag * tangential**2 + induced)
    mean = propeller.blades / 360.0
    thrust, torque, drag = mean * lift.sum(), mean * (against * r).sum(), mean * (against * np.sin(psi)).sum()
    return thrust, torque, drag, (lift * r).sum(1)


@pytest.mark.parametrize(("down", "across"), [(4.0, 0.0), (5.0, 6.0), (2.0, -9.0)])
def test_loads_are_the_sums_over_blade_elements(down, across):
    stiff = dataclasses.replace(PROPELLER, stiffness=1e9)
    loads = blades(stiff).loads(SPEED * ONE, 0.0 * ONE, flow(down, (across, 0.0)), ONE, ONE)
    thrust, torque, drag, moment = summed(stiff, down, across)
    assert loads.thrust.item() == pytest.approx(thrust, rel=1e-4)
    assert loads.torque.item() == pytest.approx(torque, rel=1e-4)
    assert loads.across[0].item() == pytest.approx(-drag, rel=1e-4, abs=1e-9)
    psi = np.deg2rad(np.arange(360))
    rolling = stiff.blades / 360.0 * (moment * np.sin(psi)).sum()  # a stiff blade hands its moment to the hub
    assert loads.hub[0].item() == pytest.approx(-rolling, rel=1e-4, abs=1e-9)
    assert loads.hub[1].item() == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("stiffness", [0.0, 0.4, 2.0])
def test_disc_tilts_as_a_flapping_blade_does(stiffness):
    """The flapping equation of one blade, integrated over 40 revolutions, against the balance of first harmonics."""
    propeller = dataclasses.replace(PROPELLER, stiffness=stiffness, lock=3.0)
    down, across = 4.0, 5.0
    inertia = DENSITY * propeller.lift_slope * propeller.chord * propeller.radius**4 / propeller.lock
    r = (np.arange(100) + 0.5) * propeller.radius / 100
    theta = propeller.pitch + propeller.twist * r / propeller.radius
    scale = 0.5 * DENSITY * propeller.chord * propeller.lift_slope * propeller.radius / 100

    def rates(psi, state):
        beta, slope = state
        tangential = SPEED * r + across * np.sin(psi)
        # the blade's own motion meets the air of hover: what flapping adds at higher harmonics is left out
        lift = theta * tangential**2 - down * tangential - SPEED * slope * r * (SPEED * r)
        return [slope, (scale * lift * r).sum() / (inertia * SPEED**2) - (1.0 + stiffness) * beta]

    turns = np.linspace(0.0, 2.0 * np.pi, 361)[:-1]
    end = 80.0 * np.pi
    solved = solve_ivp(rates, (0.0, end), [0.0, 0.0], t_eval=end - 2.0 * np.pi + turns, rtol=1e-8, atol=1e-10)
    back, right = -2.0 * (solved.y[0] * np.cos(turns)).mean(), -2.0 * (solved.y[0] * np.sin(turns)).mean()
    flat = dataclasses.replace(propeller, stiffness=1e12)
    tilted, level = (
        blades(one).loads(SPEED * ONE, 0.0 * ONE, flow(down, (across, 0.0)), ONE, ONE) for one in (propeller, flat)
    )
    thrust = tilted.thrust.item()
    assert (level.across[0] - tilted.across[0]).item() / thrust == pytest.approx(back, rel=1e-3, abs=1e-6)
    assert tilted.across[1].item() / thrust == pytest.approx(right, rel=1e-3, abs=1e-6)


def test_hover_is_that_of_momentum_theory():
    thrust, torque, induced = hover_thrust(PROPELLER, DENSITY, SPEED)
    assert thrust == pytest.approx(2.0 * DENSITY * PROPELLER.disc * induced**2, rel=1e-12)
    profile = 0.125 * DENSITY * 2 * PROPELLER.chord * PROPELLER.drag * SPEED**3 * PROPELLER.radius**4
    assert torque * SPEED == pytest.approx(thrust * induced + profile, rel=1e-3)
    twice = hover_thrust(PROPELLER, DENSITY, 2.0 * SPEED)
    assert twice[0] == pytest.approx(4.0 * thrust, rel=1e-12)
    assert twice[2] == pytest.approx(2.0 * induced, rel=1e-12)


@pytest.mark.parametrize(("climb", "across"), [(0.0, 0.0), (3.0, 0.0), (0.0, 8.0), (-1.0, 5.0), (2.0, 20.0)])
def test_inflow_settles_at_momentum_theory(climb, across):
    """T = 2 rho A v sqrt(V^2 + (v + V_c)^2), by a hundred steps of 2.5 ms from rest."""
    rotor, induced = blades(), 0.0 * ONE
    air = flow(climb, (across, 0.0))
    for _ in range(400):
        induced = rotor.inflow_step(SPEED * ONE, induced, air, ONE, 0.0025)
    thrust, v = rotor.loads(SPEED * ONE, induced, air, ONE, ONE).thrust.item(), induced.item()
    assert thrust == pytest.approx(2.0 * DENSITY * PROPELLER.disc * v * np.hypot(across, v + climb), rel=1e-6)


def test_climb_costs_thrust_and_speed_gives_it_back():
    rotor = blades()

    def thrust(air):
        induced = 4.0 * ONE
        for _ in range(200):
            induced = rotor.inflow_step(SPEED * ONE, induced, air, ONE, 0.0025)
        return rotor.loads(SPEED * ONE, induced, air, ONE, ONE).thrust.item()

    assert thrust(flow(2.0)) < thrust(flow()) < thrust(flow(-1.0))
    assert thrust(flow(across=(8.0, 0.0))) > 1.03 * thrust(flow())


def test_mirrored_rotor_has_mirrored_loads():
    rotor, air = blades(dataclasses.replace(PROPELLER, stiffness=0.5)), flow(4.0, (6.0, 0.0))
    ccw, cw = (rotor.loads(SPEED * ONE, 0.0 * ONE, air, ONE, spin * ONE) for spin in (1.0, -1.0))
    assert cw.across[1].item() == pytest.approx(-ccw.across[1].item())
    assert cw.hub[0].item() == pytest.approx(-ccw.hub[0].item())
    assert cw.hub[1].item() == pytest.approx(ccw.hub[1].item())
    assert cw.thrust.item() == ccw.thrust.item()


def test_direction_of_motion_turns_the_loads():
    rotor = blades(dataclasses.replace(PROPELLER, stiffness=0.5))
    ahead = rotor.loads(SPEED * ONE, 4.0 * ONE, flow(0.0, (6.0, 0.0)), ONE, ONE)
    right = rotor.loads(SPEED * ONE, 4.0 * ONE, flow(0.0, (0.0, 6.0)), ONE, ONE)
    for name in ("across", "hub"):
        x, y = getattr(ahead, name)[:, 0, 0]
        np.testing.assert_allclose(getattr(right, name)[:, 0, 0], [-y, x], rtol=1e-12)


def test_one_rotor_near_the_ground_is_that_of_cheeseman_and_bennett():
    """R^2/16 z^2 in hover; a rotor beside it adds; motion takes it away."""
    radius, z = np.array([0.1]), np.array([[0.15]])
    alone = ground_share(z, np.zeros((1, 1, 1)), radius, np.zeros((1, 1)))
    assert alone.item() == pytest.approx(0.1**2 / (16.0 * 0.15**2), rel=1e-12)
    pair = ground_share(np.repeat(z, 2, 0), np.array([[[0.0], [0.0625]], [[0.0625], [0.0]]]), radius, np.zeros((2, 1)))
    assert np.all(pair > alone)
    assert np.all(pair < 2.0 * alone)
    assert ground_share(z, np.zeros((1, 1, 1)), radius, np.ones((1, 1))).item() == pytest.approx(0.5 * alone.item())
    far = ground_share(100.0 * z, np.zeros((1, 1, 1)), radius, np.zeros((1, 1)))
    assert far.item() < 1e-5
