"""Trim against the UH-60A's published and recomputed values, and against the simulator itself."""

import dataclasses

import numpy as np
import pytest

from rotorid_torch.errors import InputError
from rotorid_torch.simulation.flight.motion import rates
from rotorid_torch.simulation.flight.sensors import flapping
from rotorid_torch.simulation.flight.trim import find_trim, passage
from rotorid_torch.simulation.helicopter.aircraft import BLADES, TORQUE


def test_hover_attitude_flapping_and_inflow_are_those_of_the_uh60(hover):
    """TM-85890, table 4: theta 5.05, phi -2.34 deg; GENHEL: theta 4.82, phi -2.40, a0 3.1, a1 -1.4, b1 -1.2."""
    x = hover.trim.state
    phi, theta = np.rad2deg(x[6:8])
    assert phi == pytest.approx(-2.4, abs=0.3)
    assert theta == pytest.approx(4.8, abs=0.6)
    a0, a1, b1 = (float(np.rad2deg(angle[0])) for angle in flapping(hover.aircraft, x[None]))
    assert a0 == pytest.approx(3.1, abs=0.4)
    assert a1 == pytest.approx(-1.4, abs=0.3)
    assert b1 == pytest.approx(-1.2, abs=0.4)
    assert x[16] == pytest.approx(0.0533, rel=0.03)
    lag = np.rad2deg(x[BLADES + 2 * 4 : BLADES + 3 * 4].mean())
    assert lag == pytest.approx(5.5, abs=1.5)


def test_hover_controls_and_power_are_those_of_the_uh60(hover):
    """GENHEL: collective 17.4, longitudinal -1.4, lateral 1.0, tail 19.4 deg; 2 x 680 kW with tail rotor and losses."""
    lon, lat, col, ped = np.rad2deg(hover.trim.controls)
    assert lon == pytest.approx(-1.4, abs=0.5)
    assert lat == pytest.approx(1.0, abs=0.5)
    assert col == pytest.approx(17.4, abs=2.0)
    assert ped == pytest.approx(19.4, abs=4.0)
    _, motion = rates(hover.aircraft, hover.trim.state[:, None], hover.trim.controls[:, None])
    assert 0.95e6 < motion.shaft_torque[0] * hover.aircraft.rotor.speed < 1.36e6


def test_trim_is_a_fixed_point_of_the_passage(hover):
    """After one blade passage the trimmed aircraft is where it was."""
    before = hover.trim.state[:, None]
    after = passage(hover.aircraft, before)
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert hover.trim.residual < 1e-9


@pytest.mark.parametrize("speed", [20.6, 51.4])
def test_forward_flight_is_level_and_straight(hover, speed):
    """TM-85890, table 4: pitch attitude 4.3 deg at 40 kt, 2.5 deg at 100 kt."""
    trim = find_trim(hover.aircraft, speed)
    u, v, w = trim.state[:3]
    assert np.sqrt(u * u + v * v + w * w) == pytest.approx(speed, rel=1e-3)
    assert np.rad2deg(trim.state[7]) == pytest.approx({20.6: 4.3, 51.4: 2.5}[speed], abs=1.5)
    assert np.abs(trim.state[3:6]).max() < 1e-3


def test_free_rotor_trims_with_the_torque_that_holds_its_speed(hover):
    """The governor starts in equilibrium: the rotor's speed stays."""
    free = dataclasses.replace(hover.aircraft, governor=dataclasses.replace(hover.aircraft.governor, held=False))
    trim = find_trim(free, 0.0)
    assert trim.state[TORQUE] == pytest.approx(42_000, rel=0.05)
    after = passage(free, trim.state[:, None])
    assert after[21, 0] == pytest.approx(27.0, abs=1e-4)


def test_what_cannot_be_trimmed_says_so(hover):
    """Twice the mass: beyond the collective's limit."""
    heavy = dataclasses.replace(hover.aircraft, mass=20_000.0)
    with pytest.raises(InputError, match="trim"):
        find_trim(heavy, 0.0)
