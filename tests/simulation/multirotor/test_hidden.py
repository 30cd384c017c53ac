"""Every effect of a multirotor changes what it should, by the size that it should."""

import json

import numpy as np
import pytest

from rotorid_torch.simulation import MultirotorTest, fly
from rotorid_torch.simulation.multirotor.flight import Hover
from rotorid_torch.simulation.multirotor.hidden import DELAY, HIDDEN, LAG, LOADED, WEAK, felt_per_speed
from rotorid_torch.simulation.multirotor.rotor import Blades
from rotorid_torch.simulation.multirotor.vehicles import multirotor

G = 9.80665


def flown(effect, flights, size=1.0, seconds=4.0):
    made = fly(None, vehicle="quad", flights=flights, effects=[(effect, size)], seconds=seconds)
    assert isinstance(made, MultirotorTest)
    return made


@pytest.fixture(scope="module")
def clean():
    flights = ["thrust_p", "eight_p", "translate_p", "hover_p", "fast_p", "low_p"]
    return fly(None, vehicle="quad", flights=flights, seconds=8.0).truth


def slope(response, *regressors):
    table = np.stack([*regressors, np.ones_like(response)], axis=1)
    return np.linalg.lstsq(table, response, rcond=None)[0]


def lift(truth):
    """Thrust of the declared curve over the weight."""
    motors = fly_curve()
    m = np.stack([truth[f"motor{k + 1}"] for k in range(4)])
    return np.polynomial.polynomial.polyval(m, motors).sum(0) / (multirotor("quad").mass * G)


def fly_curve():
    from rotorid_torch.simulation.multirotor.channels import declare

    return declare(multirotor("quad"), "", ("hover_p",), "")["vehicle"]["motors"][0]["thrust"]


@pytest.mark.parametrize("effect", HIDDEN)
def test_size_zero_is_the_clean_vehicle(effect):
    craft = multirotor("quad")
    changed = HIDDEN[effect].change(craft, 0.0)
    for name in ("mass", "inertia", "places", "lifts", "drive", "air", "load", "imu", "reference"):
        assert getattr(changed, name) == getattr(craft, name), name
    assert all(value == 0.0 for value in (*changed.sensors.bias.values(), *changed.sensors.delay.values()))


@pytest.fixture(scope="module")
def pure():
    return fly(None, vehicle="quad", flights=["hover_p"], seconds=0.5)


@pytest.mark.parametrize("effect", HIDDEN)
def test_what_is_hidden_stands_in_the_truth_and_not_in_the_declaration(effect, pure, tmp_path):
    made = fly(tmp_path / "set", vehicle="quad", flights=["hover_p"], effects=[(effect, 0.5)], seconds=0.5)
    (told,) = json.loads((tmp_path / "set" / "truth" / "effects.json").read_text())["effects"]
    assert (told["id"], told["size"]) == (effect, 0.5)
    assert told["changes"]
    assert made.declaration["vehicle"] == pure.declaration["vehicle"]
    assert made.declaration["description"] == pure.declaration["description"]


def test_motors_lag_and_slow_down_later_than_they_speed_up():
    """Speeds follow commands with the time constant at hover; falling ones later."""
    truth = flown("propulsion.motor_lag", ["thrust_p"]).truth["thrust_p"]
    drive = multirotor("quad").drive
    asked = drive.full_speed * (drive.idle + (1.0 - drive.idle) * truth["motor1"])
    rate = np.gradient(truth["omega1"], truth["time"])
    gap = asked - truth["omega1"]
    rising, falling = gap > 5.0, gap < -5.0
    (up, _), (down, _) = (slope(rate[some], gap[some]) for some in (rising, falling))
    assert 1.0 / up == pytest.approx(LAG, rel=0.15)
    assert 1.2 * LAG < 1.0 / down < 1.7 * LAG


def test_commands_arrive_late():
    truth = flown("control.delay", ["thrust_p"]).truth["thrust_p"]
    drive = multirotor("quad").drive
    asked = drive.full_speed * (drive.idle + (1.0 - drive.idle) * truth["motor1"])
    late = np.interp(truth["time"] - DELAY, truth["time"], asked)
    assert np.abs(truth["omega1"] - late).max() < 0.1 * np.abs(truth["omega1"] - asked).max()


def test_voltage_slows_the_rotors():
    truth = flown("propulsion.voltage", ["thrust_p"]).truth["thrust_p"]
    craft = multirotor("quad")
    asked = craft.drive.full_speed * (craft.drive.idle + (1.0 - craft.drive.idle) * truth["motor1"])
    np.testing.assert_allclose(truth["omega1"] / asked, truth["voltage"] / craft.battery.reference, rtol=1e-9)
    assert np.corrcoef(np.gradient(truth["voltage"]), np.gradient(-lift(truth)))[0, 1] > 0.3  # it sags by current


def test_rotors_drag(clean):
    truth = flown("propulsion.rotor_drag", ["eight_p"], seconds=6.0).truth["eight_p"]
    by_u, by_v = slope(truth["ax"], truth["u"])[0], slope(truth["ay"], truth["v"])[0]
    assert -0.6 < by_u < -0.1
    assert by_v == pytest.approx(by_u, rel=0.1)
    assert np.abs(clean["eight_p"]["ax"]).max() == 0.0
    half = flown("propulsion.rotor_drag", ["eight_p"], 0.5, seconds=6.0).truth["eight_p"]
    assert slope(half["ax"], half["u"])[0] == pytest.approx(0.5 * by_u, rel=0.1)


def test_discs_that_tilt_turn_the_body_by_speed():
    """Thrusts balance what the hubs turn, in the translation by the size of the library's effect; nothing drags."""
    craft, truth = multirotor("quad"), flown("propulsion.flapping", ["translate_p"], seconds=8.0).truth["translate_p"]
    curve, places = fly_curve(), np.array(craft.places)[:, 0]
    pitch = sum(x * np.polynomial.polynomial.polyval(truth[f"motor{k + 1}"], curve) for k, x in enumerate(places))
    turning = np.gradient(truth["q"], truth["time"])
    by_speed = slope(pitch, truth["u"], turning)[0] / craft.inertia_matrix[1, 1]
    assert by_speed == pytest.approx(-felt_per_speed(craft)[2], rel=0.2)
    assert np.abs(truth["ax"]).max() < 1e-3


def test_climbing_costs_thrust(clean):
    truth = flown("propulsion.axial_inflow", ["thrust_p"]).truth["thrust_p"]

    def by_climb(t):
        return slope(t["az"] / G + lift(t), t["w"])[0]

    assert by_climb(truth) < -0.01  # climbing (w below zero) makes az less than the curve says
    assert abs(by_climb(clean["thrust_p"])) < 0.1 * abs(by_climb(truth))


@pytest.mark.parametrize("effect", ["forces.translational_lift", "propulsion.axial_inflow"])
def test_speed_gives_lift(clean, effect):
    truth = flown(effect, ["fast_p"], seconds=6.0).truth["fast_p"]
    speed = truth["u"] ** 2 + truth["v"] ** 2
    more = -truth["az"] / G - lift(truth)
    assert slope(more, speed)[0] > 0.0
    assert np.ptp(more) > 0.02
    assert np.ptp(-clean["fast_p"]["az"] / G - lift(clean["fast_p"])) < 0.5 * np.ptp(more)


def test_body_drags(clean):
    truth = flown("forces.drag", ["fast_p"], seconds=6.0).truth["fast_p"]
    speed = np.sqrt(sum(truth[c] ** 2 for c in "uvw"))
    assert slope(truth["ax"], speed * truth["u"])[0] == pytest.approx(-0.02, rel=1e-3)
    assert slope(truth["ay"], speed * truth["v"])[0] == pytest.approx(-0.024, rel=1e-3)


def test_one_rotor_gives_less():
    made = flown("propulsion.unequal", ["hover_p"])
    speeds = [made.truth["hover_p"][f"omega{k}"].mean() for k in range(1, 5)]
    assert speeds[1] == max(speeds)
    hover = Hover.of([made.craft], Blades.of([made.craft.propeller], np.array([made.craft.air_density])))
    assert hover.curve[:, 0] / hover.curve[0, 0] == pytest.approx([1.0, 1.0 - WEAK, 1.0, 1.0])


def test_payload_takes_thrust(clean):
    truth = flown("mass.payload", ["hover_p"]).truth["hover_p"]
    assert lift(truth).mean() / lift(clean["hover_p"]).mean() == pytest.approx(1.0 + LOADED, rel=0.01)


def test_centre_of_gravity_is_where_thrusts_balance():
    made = flown("mass.cg", ["hover_p"])
    truth = made.truth["hover_p"]
    place = np.array([one["position"] for one in made.declaration["vehicle"]["motors"]])
    thrust = np.array([np.polynomial.polynomial.polyval(truth[f"motor{k + 1}"], fly_curve()).mean() for k in range(4)])
    centre = thrust @ place / thrust.sum()
    np.testing.assert_allclose(centre[:2], -np.array(made.craft.reference)[:2], rtol=0.1)


def test_inertia_takes_moments():
    made = flown("mass.inertia", ["roll_p"])
    truth = made.truth["roll_p"]
    declared = made.declaration["vehicle"]["inertia"][0][0]
    assert slope(truth["L"], truth["pdot"])[0] / declared == pytest.approx(1.25, rel=1e-3)


def test_ground_carries(clean):
    truth = flown("environment.ground", ["low_p"], seconds=8.0).truth["low_p"]
    ours, usual = lift(truth), lift(clean["low_p"])
    low = truth["height"] < 0.35 * np.max(truth["height"])
    assert ours[low].mean() < 0.97 * usual[low].mean()
    assert truth["effect_ground"].max() > 0.05
    far = flown("environment.ground", ["hover_p"]).truth["hover_p"]["effect_ground"]
    assert far.max() < 1e-3


def test_wind_leans_the_vehicle_into_it():
    """From 40 degrees: nose down, and right side down."""
    truth = flown("environment.wind", ["hover_p"]).truth["hover_p"]
    assert truth["theta"].mean() < -0.02
    assert truth["phi"].mean() > 0.02
    assert truth["effect_wind_u"].mean() == pytest.approx(-multirotor("quad").speed * np.cos(np.deg2rad(40.0)), rel=0.1)


def test_gusts_shake_the_vehicle(clean):
    truth = flown("environment.turbulence", ["hover_p"]).truth["hover_p"]
    assert truth["effect_wind_u"].std() > 0.2
    assert truth["q"].std() > 2.0 * clean["hover_p"]["q"].std()


@pytest.mark.parametrize(
    ("effect", "channel", "check"),
    [
        ("sensors.bias", "p", lambda read, true: np.allclose(read - true, 0.02)),
        ("sensors.scale", "q", lambda read, true: np.allclose(read, 1.05 * true)),
        ("sensors.misalignment", "az", lambda read, true: 1e-4 < np.abs(read - true).mean() < 0.2),
        ("sensors.lever_arm", "ax", lambda read, true: np.abs(read - true).max() > 1e-3),
        ("sensors.delay", "p", lambda read, true: np.allclose(read[3:], true[:-3], atol=1e-6)),
        ("sensors.filter", "p", lambda read, true: 0.0 < np.abs(read - true).max() < np.abs(true).max()),
    ],
)
def test_sensors_err(effect, channel, check):
    truth = flown(effect, ["mixed_n"]).truth["mixed_n"]
    assert check(truth[f"effect_{channel}"], truth[channel])
