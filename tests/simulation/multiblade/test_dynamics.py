"""The helicopter in multi-blade coordinates against the flight-test aircraft and against theory."""

from dataclasses import replace

import numpy as np
import pytest

from rotorid_torch.data.schema import Rotor, Vehicle
from rotorid_torch.simulation import fly
from rotorid_torch.simulation.flight import linear
from rotorid_torch.simulation.flight.runge_kutta import runge_kutta
from rotorid_torch.simulation.flight.trim import find_trim
from rotorid_torch.simulation.helicopter.rotor import LOCK_SLOPE
from rotorid_torch.simulation.multiblade.craft import FLAP, INFLOW, LAG, SPEED, TAIL_INFLOW
from rotorid_torch.simulation.multiblade.dynamics import respond
from rotorid_torch.simulation.multiblade.priors import build, numbers
from rotorid_torch.simulation.multiblade.trim import find_trims, linearise, settle
from tests.simulation.derivatives import derivatives

EXCURSIONS = np.array([0.56, 0.74, 0.48, 0.064, 0.041, 0.033, 0.0122, 0.0058, 0.0071, 0.0138])
"""Usual ones of u v w p q r lon lat col ped in the flights of the UH-60."""


def kind(steady=False, stiff=False, uniform=False, count=1):
    """One kind of rotor."""
    return np.tile([steady, stiff, uniform], (count, 1))


def twin(aircraft, speed=0.0, rotor=None, held=True, **changed):
    """The helicopter in multi-blade coordinates with the numbers of an aircraft of `fly`."""
    own = aircraft.rotor
    lock = LOCK_SLOPE * aircraft.air_density * own.chord * own.radius**4 / own.flap_inertia
    table = Rotor(own.blades, own.radius, own.chord, own.speed, "ccw", own.hinge_offset, lock)
    vehicle = Vehicle(
        aircraft.mass,
        aircraft.inertia,
        ("blades",),
        aircraft.gravity,
        aircraft.air_density,
        own.hub,
        aircraft.imu,
        table,
    )
    values = {name: np.array([number.value]) for name, number in numbers(vehicle, speed).items()}
    same = {"swash_phase": own.swash_phase, "lift_slope": own.section.lift_slope, "tip_loss": own.tip_loss}
    for name, value in {**same, "tail_cant": aircraft.tail.cant, **changed}.items():
        values[name] = np.array([value])
    return build(values, kind() if rotor is None else rotor, vehicle, held, 1.0 / 154.0)


@pytest.fixture(scope="module")
def multiblade(hover):
    """Twin of the hovering UH-60, trimmed."""
    craft = twin(hover.aircraft)
    return craft, find_trims(craft, np.zeros(3))


def test_trim_is_the_flight_test_aircrafts(hover, multiblade):
    """Attitude, blade angles, inflow: 0.001; flapping, which the other one has per blade: coning 0.002."""
    _, trims = multiblade
    assert trims.converged.all()
    x = trims.state[:, 0, 0]
    np.testing.assert_allclose(x[6:8], hover.trim.state[6:8], atol=1e-3)
    np.testing.assert_allclose(trims.controls[:, 0, 0], hover.trim.controls, atol=1e-3)
    np.testing.assert_allclose(x[INFLOW], hover.trim.state[16:19], atol=5e-4)
    blades = hover.trim.state[24:28]
    assert x[FLAP.start] == pytest.approx(blades.mean(), abs=2e-3)
    assert x[LAG.start] == pytest.approx(hover.trim.state[32:36].mean(), abs=2e-3)


@pytest.mark.parametrize("speed", [0.0, 30.9])
def test_derivatives_are_the_flight_test_aircrafts(hover, speed):
    """Every contribution within 6 % of its row's largest; the largest ones within 4 % of themselves."""
    craft = twin(hover.aircraft, speed)
    trims = find_trims(craft, np.array([speed, 0.0, 0.0]))
    ours = linearise(craft, trims).derivatives()[0] * EXCURSIONS
    trim = find_trim(hover.aircraft, speed)
    full = derivatives(linear.linearise(hover.aircraft, trim), trim) * EXCURSIONS
    largest = np.abs(full).max(1, keepdims=True)
    assert np.all(np.abs(ours - full) < 0.06 * largest), np.round((ours - full) / largest, 3)
    main = np.abs(full) == largest
    np.testing.assert_allclose(ours[main], full[main], rtol=0.04)


def test_rotor_modes_are_the_flight_test_aircrafts(hover, multiblade):
    """Lag (three), coning, flap advancing: the nearest Floquet exponent within 8 %."""
    craft, trims = multiblade
    modes = np.linalg.eigvals(linearise(craft, trims).inner[0])
    for mode in (-2.3 + 18.1j, -2.8 + 7.5j, -3.1 + 39.0j, -10.9 + 50.7j, -10.2 + 23.8j):
        full = min(np.linalg.eigvals(hover.linear.full_a), key=lambda found: abs(found - mode))
        nearest = min(modes, key=lambda found: abs(found - mode))
        assert abs(nearest - full) < 0.08 * abs(full), (nearest, full)


def test_flapping_in_a_vacuum_turns_with_the_theorys_frequencies(hover):
    """Without air: coning at nu, and the tip path at nu +- 1 times the rotor speed, nu^2 = 1 + e S / I.

    Source: Johnson, Helicopter Theory, section 9.2.
    """
    craft = replace(twin(hover.aircraft, rotor=kind(stiff=True)), density=np.full((1, 1), 1e-9))
    heavy = replace(craft, mass=craft.mass * 1e6, inertia=craft.inertia * 1e6)
    trims = find_trims(twin(hover.aircraft, rotor=kind(stiff=True)), np.zeros(3))
    x = trims.state.copy()
    x[FLAP] = x[INFLOW] = x[TAIL_INFLOW] = 0.0
    held = replace(trims, state=x, controls=0.0 * trims.controls, setting=settle(heavy, x, trims.controls))
    modes = np.linalg.eigvals(linearise(heavy, held).inner[0][:6, :6])
    nu = np.sqrt(1.0 + (craft.hinge_offset * craft.first_moment / craft.flap_inertia)[0, 0])
    expected = np.array([nu - 1.0, nu, nu + 1.0]) * x[SPEED, 0, 0]
    np.testing.assert_allclose(np.sort(modes.imag[modes.imag > 0.0]), expected, rtol=1e-4)


def test_a_free_fall_of_everything_is_felt_nowhere(hover):
    """Without air nothing accelerates but by gravity: specific force zero, blades stay straight (momentum balance)."""
    craft = replace(twin(hover.aircraft), density=np.full((1, 1), 1e-9))
    trims = find_trims(twin(hover.aircraft), np.zeros(3))
    x = trims.state.copy()
    x[FLAP], x[LAG], x[INFLOW] = 0.0, 0.0, 0.0
    _, response = respond(craft, settle(craft, x, trims.controls), x, trims.controls)
    np.testing.assert_allclose(response.specific_force, 0.0, atol=1e-5)
    np.testing.assert_allclose(response.angular, 0.0, atol=1e-5)


@pytest.mark.parametrize("uniform", [False, True])
def test_quasi_steady_flapping_trims_as_the_dynamic_one_and_has_no_rotor_modes(hover, uniform):
    """Trim flap is nearly the same (the blades' weight aside); its states return within a few samples."""
    craft = twin(hover.aircraft, rotor=kind(steady=True, stiff=True, uniform=uniform))
    trims = find_trims(craft, np.zeros(3))
    dynamic = find_trims(twin(hover.aircraft), np.zeros(3))
    assert trims.converged.all()
    np.testing.assert_allclose(trims.controls, dynamic.controls, atol=0.02)
    modes = np.linalg.eigvals(linearise(craft, trims).inner[0][:3, :3])
    np.testing.assert_allclose(modes, -154.0, rtol=0.05)
    gradient = trims.state[INFLOW][1:]
    assert (np.abs(gradient).max() < 1e-9) == uniform


def test_a_batch_is_its_members(hover):
    """Aircraft side by side do not feel each other."""
    craft = twin(hover.aircraft)
    trims = find_trims(craft, np.zeros(3))
    rng = np.random.default_rng(0)
    x = trims.state + 1e-3 * rng.standard_normal((31, 1, 5))
    x[28] = 27.0
    u = trims.controls + 1e-3 * rng.standard_normal((4, 1, 5))
    together = respond(craft, trims.setting, x, u)[0]
    alone = np.concatenate([respond(craft, trims.setting, x[..., [k]], u[..., [k]])[0] for k in range(5)], axis=2)
    np.testing.assert_allclose(together, alone, rtol=1e-10, atol=1e-12)


def test_response_to_a_doublet_is_the_flight_test_aircrafts(hover, multiblade):
    """The simulation and multi-blade coordinates under the same blade angles: 2.5 s within 5 % of the largest."""
    craft, trims = multiblade
    flight = fly(None, flights=("dbl_lat_p",), seconds=2.6).truth["dbl_lat_p"]
    hands = np.stack([flight[name] for name in ("lon", "lat", "col", "ped")])[:, :, None, None]
    hands = hands - hands[:, :1] + trims.controls[:, None]
    x, states = trims.state, []

    def slope(state, u):
        return respond(craft, trims.setting, state, u)[0]

    for t in range(round(2.5 * 154)):
        states.append(x[:, 0, 0])
        ends = hands[:, t], 0.5 * (hands[:, t] + hands[:, t + 1]), hands[:, t + 1]
        x = runge_kutta(slope, x, slope(x, hands[:, t]), ends, 1.0 / 154.0)
    ours = np.array(states).T
    for row, name in ((1, "v"), (3, "p"), (4, "q"), (5, "r"), (6, "phi"), (7, "theta"), (13, "a1"), (14, "b1")):
        theirs = flight[name][: ours.shape[1]] - flight[name][0]
        assert np.abs(ours[row] - ours[row, 0] - theirs).max() < 0.05 * np.abs(theirs).max() + 2e-4, name


def test_a_gust_is_a_velocity_through_the_air(hover, multiblade):
    """Forces are those of flight at the velocity less the gust; where the vehicle goes is its velocity over ground."""
    craft, trims = multiblade
    x, u, gust = trims.state.copy(), trims.controls, np.array([1.0, -2.0, 0.5])[:, None, None]
    x[3:6] += 0.1
    through = x.copy()
    through[:3] -= gust
    (rates, response), (same, other) = (
        respond(craft, trims.setting, x, u, gust),
        respond(craft, trims.setting, through, u),
    )
    np.testing.assert_array_equal(response.specific_force, other.specific_force)
    np.testing.assert_array_equal(rates[12:], same[12:])
    turning = np.cross(x[3:6, 0, 0], gust[:, 0, 0])
    np.testing.assert_allclose((rates - same)[:3, 0, 0], -turning, atol=1e-12)
    assert np.abs((rates - respond(craft, trims.setting, x, u)[0])[:3]).max() > 0.01
