"""A gyro that drifts is told as that, and an attitude that follows the accelerometers is none of its own."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.pairs.drawn_attitude import drawn
from rotorid_torch.consistency.sensor_errors.drift import drifts, without_drifts
from rotorid_torch.core import names
from rotorid_torch.data import Dataset
from tests.consistency.examination.test_check import rolling

Arrays = dict[str, np.ndarray]


def flown(**change: np.ndarray) -> Dataset:
    return Dataset.from_arrays({"f": rolling(0) | change}, identify=["f"])


def test_a_ramp_of_a_gyro_is_measured_and_taken_out():
    flight = rolling(0)
    ramp = 0.03 * (flight["time"] - flight["time"][0]) / np.ptp(flight["time"])
    assert drifts(flown()) == ()
    assert drifts(flown(q=flight["q"] + 0.03)) == ()
    assert drifts(flown(q=1.05 * flight["q"] + 0.03 * flight["p"])) == ()  # a scale and a turn go with the motion
    drifting = flown(q=flight["q"] + ramp)
    (one,) = drifts(drifting)
    assert (one.flight, one.channel) == ("f", "q")
    assert abs(one.grown - 0.03) < 3.0 * one.se < 0.01
    assert drifts(without_drifts(drifting, (one,))) == ()


def filtered(flight: Arrays, seconds: float) -> Arrays:
    """Roll and pitch angle of a complementary filter with this time constant, integrated by Euler."""
    ax, ay, az = (flight[c] for c in names.SPECIFIC_FORCES)
    tilt = np.stack([np.arctan2(-ay, -az), np.arctan2(ax, np.hypot(ay, az))], axis=1)
    rates, dt = np.stack([flight[c] for c in names.RATES], axis=1), float(np.diff(flight["time"]).mean())
    angles = tilt[:1].repeat(len(tilt), axis=0)
    for k in range(1, len(tilt)):
        (phi, theta), (p, q, r) = angles[k - 1], rates[k]
        about_z = q * np.sin(phi) + r * np.cos(phi)
        turning = np.array([p + np.tan(theta) * about_z, q * np.cos(phi) - r * np.sin(phi)])
        angles[k] = angles[k - 1] + dt * (turning + (tilt[k] - angles[k - 1]) / seconds)
    return dict(zip(names.ATTITUDES, angles.T, strict=False))


@pytest.mark.parametrize("seconds", [0.1, 0.5, 2.0])
def test_an_attitude_that_a_filter_draws_to_the_accelerometers_is_told(seconds: float):
    flight = rolling(0)
    shares = drawn(flown(**filtered(flight, seconds)))
    assert shares is not None
    assert shares.by_both < 0.1 * shares.by_rates


def test_other_errors_of_the_attitude_are_not_taken_for_that():
    flight = rolling(0)
    late = {c: np.interp(flight["time"] - 0.15, flight["time"], flight[c]) for c in ("phi", "theta")}
    for change in (
        {},
        late,
        {"p": 1.3 * flight["p"]},
        {"ay": flight["ay"] + 2.0},
        {"p": -flight["q"], "q": flight["p"]},
    ):
        assert drawn(flown(**change)) is None


@pytest.mark.parametrize("channel", names.SPECIFIC_FORCES)
def test_a_ramp_of_an_accelerometer_is_measured_and_is_no_bias(channel: str):
    flights = {f"f{seed}": rolling(seed) for seed in range(3)}
    assert drifts(Dataset.from_arrays(flights, identify=[*flights])) == ()
    for flight in flights.values():
        flight[channel] = flight[channel] + 0.8 * (flight["time"] - flight["time"][0]) / np.ptp(flight["time"])
    drifting = Dataset.from_arrays(flights, identify=[*flights])
    found = drifts(drifting)
    assert {(one.flight, one.channel) for one in found} == {(name, channel) for name in flights}
    assert all(abs(one.grown - 0.8) < 0.02 for one in found)
    told = [f for f in check(drifting).findings if f.severity in ("warning", "error") and "bias" in f.sentence]
    assert ["drifts by" in f.sentence for f in told] == [True]
