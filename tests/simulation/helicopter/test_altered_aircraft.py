"""What effects do to rotor, wake, airframe and ground effect, on the trimmed and linearised aircraft."""

import numpy as np
import pytest

from rotorid_torch.simulation.flight.augmentation import design
from rotorid_torch.simulation.flight.linear import linearise
from rotorid_torch.simulation.flight.motion import rates
from rotorid_torch.simulation.flight.sensors import MEASURED
from rotorid_torch.simulation.flight.simulation import Programme, fly_batch
from rotorid_torch.simulation.flight.trim import Trim, find_trim
from rotorid_torch.simulation.helicopter.aircraft import INFLOW, SPEED
from rotorid_torch.simulation.helicopter.hidden import HIDDEN
from rotorid_torch.simulation.helicopter.inflow import ground_factor
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft
from tests.simulation.derivatives import derivatives

AIRCRAFT = load_aircraft()


def altered(effect: str, size: float = 1.0):
    """The UH-60 with an effect."""
    return HIDDEN[effect].change(AIRCRAFT, size)


def test_wake_distortion_turns_the_off_axis_response_and_leaves_the_damping(hover):
    """L by q loses its sign, as in flight; L by p and M by q stay within a tenth."""
    aircraft = altered("rotor.wake_distortion")
    trim = find_trim(aircraft, 0.0)
    flying = ((AIRCRAFT, hover.trim), (aircraft, trim))
    was, now = (derivatives(linearise(one, state), state)[3:5, 3:5] for one, state in flying)
    assert was[0, 1] < -1.0
    assert now[0, 1] > 0.5
    np.testing.assert_allclose(np.diag(now), np.diag(was), rtol=0.1)


def test_inflow_takes_twice_as_long(hover):
    """Half the rates at the same state, for all three."""
    x = hover.trim.state[:, None].copy()
    x[INFLOW] += [[0.01], [0.004], [-0.003]]
    was, _ = rates(AIRCRAFT, x, x[12:16])
    now, _ = rates(altered("rotor.inflow"), x, x[12:16])
    np.testing.assert_allclose(now[INFLOW], 0.5 * was[INFLOW], rtol=1e-12)


def test_flap_springs_raise_the_frequency():
    """Rotating flap frequency from offset and spring: 1.035 to 1.06 per revolution."""
    rotor = altered("rotor.flap_second_order").rotor
    stiffness = rotor.hinge_offset * rotor.first_moment + rotor.flap_spring / rotor.speed**2
    assert np.sqrt(1.0 + stiffness / rotor.flap_inertia) == pytest.approx(1.064, abs=0.002)


def test_worn_dampers_leave_the_lag_undamped():
    """The regressive lag mode, 2.9 Hz: a third of the damping."""
    aircraft = altered("rotor.lead_lag")
    modes = np.linalg.eigvals(linearise(aircraft, find_trim(aircraft, 0.0)).full_a)
    nearest = min(modes, key=lambda mode: abs(mode - (-0.8 + 18.1j)))
    assert nearest.real == pytest.approx(-2.3 / 3.0, rel=0.4)


def test_governor_lets_the_speed_droop_and_nothing_measures_it(hover):
    """Some per cent after a collective step; half the size, about half the droop."""
    droop = []
    for size in (0.5, 1.0):
        aircraft = altered("rotor.speed", size)
        record = fly_batch(
            aircraft, find_trim(aircraft, 0.0), design(hover.linear), Programme(["dbl_col_p"], 1.5, substeps=1)
        )
        droop.append(np.abs(record.states[:, SPEED, 0] / 27.0 - 1.0).max())
    assert 0.002 < droop[0] < 0.8 * droop[1] < 0.05
    assert "omega" not in MEASURED


def test_stall_takes_lift_at_high_angles_only():
    """Beyond 9 degrees; the attached lift stays."""
    was, now = AIRCRAFT.rotor.section, altered("rotor.stall").rotor.section
    low, high = np.array([0.08]), np.array([0.2])
    assert now.coefficients(low)[0][0] == pytest.approx(was.coefficients(low)[0][0], rel=5e-3)
    assert now.coefficients(high)[0][0] < 0.6 * was.coefficients(high)[0][0]


@pytest.fixture(scope="module")
def at_speed() -> Trim:
    """The clean aircraft at 10 m/s."""
    return find_trim(AIRCRAFT, 10.0)


@pytest.mark.parametrize(
    ("effect", "row", "low", "high"),
    [
        ("forces.drag", 7, -0.02, -0.002),
        ("forces.translational_lift", 14, -0.03, -0.005),
        ("forces.tail_interference", 7, 0.005, 0.02),
    ],
)
def test_speed_effects_need_speed(effect, row, low, high, hover, at_speed):
    """Change of trim: nose lower by drag, less collective by lift, nose higher by the wake; in hover hardly any."""
    change = find_trim(altered(effect), 10.0).state[row] - at_speed.state[row]
    assert low < change < high
    assert abs(find_trim(altered(effect), 0.0).state[row] - hover.trim.state[row]) < 0.3 * abs(change)


def test_quadratic_damping_grows_with_the_square(hover):
    """1.5 rad/s^2 at 1 rad/s in roll for the body alone; its blades share it."""
    x = np.repeat(hover.trim.state[:, None], 3, axis=1)
    x[3] += [0.1, 0.2, -0.2]
    lost = rates(altered("forces.quadratic_damping"), x, x[12:16])[0][3] - rates(AIRCRAFT, x, x[12:16])[0][3]
    assert lost[1] / lost[0] == pytest.approx(4.0, rel=0.01)
    assert lost[2] == pytest.approx(-lost[1], rel=0.01)
    assert -1.5 * 0.04 < lost[1] < -1.0 * 0.04


def test_ground_effect_is_cheeseman_and_bennetts():
    """Thrust ratio 1 / (1 - part) by height of the rotor in radii, in hover; speed blows it away."""
    heights, rest = np.array([0.5, 0.75, 1.0, 1.5, 2.0]), np.zeros(5)
    part = ground_factor(1.0, 8.0, 8.0 * heights, rest, rest + 12.0)
    np.testing.assert_allclose(1.0 / (1.0 - part), [1.333, 1.125, 1.067, 1.029, 1.016], atol=1e-3)
    fast = ground_factor(1.0, 8.0, np.array([8.0]), np.array([24.0]), np.array([12.0]))
    assert fast[0] == pytest.approx(part[2] / 5.0)


def test_near_the_ground_the_collective_is_lower():
    """At 5 m by about half a degree, at 27 m not."""
    aircraft = altered("environment.ground")
    near, far = find_trim(aircraft, 0.0, 5.0), find_trim(aircraft, 0.0, 27.4)
    assert -1.2 < np.rad2deg(near.controls[2] - far.controls[2]) < -0.3
    assert far.controls[2] == pytest.approx(find_trim(AIRCRAFT, 0.0).controls[2], abs=1e-3)
