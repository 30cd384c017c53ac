"""Sensor errors, exact against the truth of a made-up motion."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rotorid_torch.simulation.helicopter.hidden import HIDDEN
from rotorid_torch.simulation.helicopter.sensor_errors import GYROS, SensorErrors, readings
from rotorid_torch.simulation.vehicles.vehicle import load_aircraft

TIME = np.arange(463) / 154.0
TURNS = {name: 2.0 + k for k, name in enumerate((*GYROS, "ax", "ay", "az", "u"))}
TRUTH = {
    "time": TIME,
    **{name: np.sin(speed * TIME) for name, speed in TURNS.items()},
    **{f"{name}dot": TURNS[name] * np.cos(TURNS[name] * TIME) for name in GYROS},
}


def read(**errors) -> dict[str, np.ndarray]:
    """Readings of the made-up motion."""
    return readings(SensorErrors(**errors), TRUTH, 27.0 * TIME)


def test_faultless_sensors_read_the_truth():
    """Nothing differs, so nothing is listed; every error lists only the channels it touches."""
    assert read() == {}
    assert set(read(bias={"p": 0.01})) == {"p"}
    assert set(read(lever_arm=(0.1, 0.0, 0.0))) == {"ax", "ay", "az"}
    assert set(read(delay={"u": 0.1})) == {"u"}


def test_bias_and_scale():
    """(1 + scale) x + bias."""
    out = read(bias={"p": 0.01}, scale={"p": 0.05})["p"]
    np.testing.assert_allclose(out, 1.05 * TRUTH["p"] + 0.01, rtol=1e-14)


def test_delay():
    """The signal a delay ago; held before the record."""
    out = read(delay={"p": 0.06})["p"]
    np.testing.assert_allclose(out, np.sin(2.0 * np.maximum(TIME - 0.06, 0.0)), atol=1e-7)


def test_filter_is_a_first_order_lag():
    """Against another integrator."""
    out = read(lag={"q": 0.05})["q"]
    exact = solve_ivp(lambda t, y: (np.sin(3.0 * t) - y) / 0.05, (0, 3), [0.0], t_eval=TIME, rtol=1e-9, atol=1e-11).y[0]
    np.testing.assert_allclose(out, exact, atol=1e-5 * 5)


def test_lever_arm_is_that_of_a_rigid_body():
    """The acceleration of a point that turns with the body, by differences of its velocity in space."""
    arm = np.array([0.3, 0.1, -0.25])
    out = read(lever_arm=tuple(arm))
    omega = np.stack([TRUTH[c] for c in GYROS], axis=1)
    velocity = np.cross(omega, arm)
    rate = np.gradient(velocity, TIME, axis=0) + np.cross(omega, velocity)
    extra = np.stack([out[c] - TRUTH[c] for c in ("ax", "ay", "az")], axis=1)
    np.testing.assert_allclose(extra[1:-1], rate[1:-1], atol=2e-3)


def test_misaligned_axes_keep_lengths():
    """A vector reads as the same vector in turned axes: turned about z to the right, x sees a part of y."""
    out = read(rotation=(0.0, 0.0, 0.035))
    np.testing.assert_allclose(out["p"], np.cos(0.035) * TRUTH["p"] + np.sin(0.035) * TRUTH["q"], atol=1e-14)
    np.testing.assert_array_equal(out["r"], TRUTH["r"])
    length = sum(out[c] ** 2 for c in ("ax", "ay", "az"))
    np.testing.assert_allclose(length, sum(TRUTH[c] ** 2 for c in ("ax", "ay", "az")), atol=1e-12)


def test_vibration_has_its_lines_and_nothing_else():
    """Amplitudes at 1/rev and 4/rev, by fitting sines."""
    errors = HIDDEN["environment.vibration"].change(load_aircraft(), 1.0).sensors
    out = readings(errors, TRUTH, 27.0 * TIME)
    for name, once, passing in (("az", 0.15, 0.7), ("p", 0.006, 0.010)):
        shaken = out[name] - TRUTH[name]
        waves = np.stack([f(n * 27.0 * TIME) for n in (1, 4) for f in (np.cos, np.sin)], axis=1)
        fit, left, *_ = np.linalg.lstsq(waves, shaken, rcond=None)
        assert np.hypot(*fit[:2]) == pytest.approx(once)
        assert np.hypot(*fit[2:]) == pytest.approx(passing)
        assert left < 1e-20


def test_several_errors_join():
    """One effect after the other: none is lost."""
    aircraft = load_aircraft()
    for effect in ("bias", "delay", "lever_arm", "misalignment"):
        aircraft = HIDDEN[f"sensors.{effect}"].change(aircraft, 0.5)
    aircraft = HIDDEN["environment.vibration"].change(aircraft, 0.5)
    errors = aircraft.sensors
    assert errors.bias["p"] == pytest.approx(0.005)
    assert errors.delay["q"] == pytest.approx(0.03)
    assert errors.lever_arm == pytest.approx((0.15, 0.05, -0.125))
    assert np.linalg.norm(errors.rotation) == pytest.approx(0.0175)
    assert len(errors.vibration) == 2
    assert dataclasses.replace(aircraft, sensors=SensorErrors()) == load_aircraft()
