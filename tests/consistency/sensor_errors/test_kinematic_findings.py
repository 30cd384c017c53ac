"""Sensor errors from kinematics: found where they are, nowhere else, and taken out again."""

import math
import re

import numpy as np
import pytest

from rotorid_torch import fly
from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.sensor_errors.kinematic_findings import kinematic_findings
from rotorid_torch.data.dataset import Dataset, load
from tests.consistency.sensor_errors.kinematic_cases import data
from tests.helpers import shared

INJECTED = {
    "delay.attitude": 0.06,
    "filter.velocities": 0.05,
    "scale.q": 0.05,
    "bias.p": 0.01,
    "misalignment.y": np.radians(2.0),
    "lever_arm.x": 0.4,
}


@pytest.mark.parametrize("name", INJECTED)
@pytest.mark.parametrize("size", [1.0, 0.5])
def test_one_error_is_named_alone_within_four_standard_errors(name: str, size: float) -> None:
    found = kinematic_findings(data({name: size * INJECTED[name]}, seed=1, flights=5))
    effect = f"sensors.{name.partition('.')[0]}"
    # 25 ms of lag are no different from 25 ms of delay below 1.5 Hz, nor 30 ms of delay from a filter of 47 rad/s
    pair = {"sensors.delay", "sensors.filter"} if name.startswith(("filter", "delay")) and size < 1.0 else {effect}
    assert {f.id for f in found.findings if f.verdict in ("accepted", "indistinguishable")} == pair
    if found.effects != (effect,):
        return
    parameter = next(p for f in found.findings for p in f.parameters if p.name == f"sensors.{name}")
    assert parameter.accepted
    assert abs(parameter.value - size * INJECTED[name]) < 4.0 * parameter.se
    assert parameter.smallest_visible < size * INJECTED[name]


def test_a_filter_of_second_order_has_its_frequency_and_damping() -> None:
    unit, frequency, damping = "rates", 18.8, 0.6
    period, damped = f"filter.{unit}_period", f"filter.{unit}_damping"
    found = kinematic_findings(data({period: 1.0 / frequency, damped: damping}, 1, flights=5))
    assert found.effects == ("sensors.filter",)
    assert found.values[f"sensors.{period}"] == pytest.approx(1.0 / frequency, rel=0.03)
    assert found.values[f"sensors.{damped}"] == pytest.approx(damping, rel=0.03)
    assert "natural frequency 18.8 rad/s" in found["sensors.filter"].reason


@pytest.mark.parametrize(("unit", "frequency"), [("rates", 60.0), ("velocities", 25.0)])
def test_far_below_its_frequency_a_filter_is_a_group_with_delay(unit: str, frequency: float) -> None:
    found = kinematic_findings(data({f"filter.{unit}_period": 1.0 / frequency}, 1, flights=5))
    pair = {f.id for f in found.findings if f.verdict == "indistinguishable"}
    assert pair == {"sensors.delay", "sensors.filter"}
    assert found.values == {f"sensors.delay.{unit}": pytest.approx(1.4 / frequency, rel=0.05)}


def test_records_that_were_smoothed_after_the_flight_are_told_with_their_band() -> None:
    sigma = 0.06
    found = kinematic_findings(data({"filter.rates_smoothing": sigma**2}, 1, flights=5))
    assert set(found.values) == {"sensors.filter.rates_smoothing"}
    said = re.search("without phase .*half power at ([0-9.]+) Hz", found["sensors.filter"].reason)
    assert said
    assert float(said[1]) == pytest.approx(math.sqrt(math.log(2.0)) / (2.0 * math.pi * sigma), rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_sensors_without_error_are_left_alone(seed: int) -> None:
    found = kinematic_findings(data({}, seed=seed, flights=5))
    assert found.effects == ()
    assert all(f.verdict == "below floor" for f in found.findings)


@pytest.mark.parametrize("name", ["uh60-hover", "uh60-60kt", "uh60-delay", "ah1-hover", "uh60b-hover"])
def test_nothing_is_named_in_clean_simulated_flights(name: str) -> None:
    assert kinematic_findings(load(shared("flightdata", name))).effects == ()


def test_attitude_late_and_rates_early_are_one_thing_without_velocities() -> None:
    found = kinematic_findings(
        data({"delay.attitude": 0.06}, 1, flights=5, keep=("p", "q", "r", "phi", "theta", "psi"))
    )
    assert found.values == {"sensors.delay.attitude": pytest.approx(0.06, abs=0.002)}
    assert "rates" in found["sensors.delay"].reason
    assert found["sensors.lever_arm"].verdict == "not testable"


def test_rates_alone_cannot_be_tested() -> None:
    found = kinematic_findings(data({}, 1, flights=2, keep=("p", "q", "r", "ax", "ay", "az")))
    assert {f.verdict for f in found.findings} == {"not testable"}
    assert all("attitude" in f.reason for f in found.findings)


def test_a_constant_per_flight_that_is_declared_free_is_no_finding() -> None:
    free = kinematic_findings(data({"bias.p": 0.01}, 1, flights=5, channels={"p": {"bias": "free"}}))
    assert free.effects == ()
    none = kinematic_findings(data({"bias.p": 0.001}, 1, flights=5, channels={"p": {"bias": "none"}}))
    assert none.effects == ("sensors.bias",)


def test_a_tilt_of_the_attitude_is_named_where_flights_say_that_it_is_the_same_in_all() -> None:
    hidden = {"bias.theta": 0.06}
    five = kinematic_findings(data(hidden, 1, flights=5))
    assert five.values["sensors.bias.theta"] == pytest.approx(0.06, rel=0.1)
    two = kinematic_findings(data(hidden, 1, flights=2))["sensors.bias"]
    assert two.verdict == "rejected"
    assert "2 flights that show it do not tell" in two.reason
    assert two.smallest_visible is not None
    assert two.smallest_visible[0] > 0.06
    declared = kinematic_findings(data(hidden, 1, flights=2, channels={"theta": {"bias": "none"}}))
    assert declared.values["sensors.bias.theta"] == pytest.approx(0.06, rel=0.1)


def test_two_errors_at_once_are_both_named() -> None:
    hidden = {"delay.velocities": 0.1, "lever_arm.x": 0.4}
    found = kinematic_findings(data(hidden, 1, flights=5))
    assert set(found.effects) == {"sensors.delay", "sensors.lever_arm"}
    for name, value in hidden.items():
        assert found.values[f"sensors.{name}"] == pytest.approx(value, rel=0.05)


def test_noise_declared_too_small_raises_no_alarm() -> None:
    wrong = {c: {"noise": 0.0005} for c in ("p", "q", "r", "phi", "theta", "psi")}
    found = kinematic_findings(data({}, 1, flights=5, channels=wrong))
    assert found.effects == ()
    assert found.levels["phi"] > 4.0


def test_attitudes_of_which_half_are_drawn_between_have_no_wrong_scale() -> None:
    """The drawn samples hide the noise, and a scale of both sides shrinks what is left, on one axis at a time."""
    names = ["thrust_p", "roll_p", "pitch_p", "yaw_p"]
    flown = fly(None, vehicle="quad", flights=names).dataset()
    turning = ("time", "p", "q", "r", "phi", "theta", "psi", *flown.controls)
    flights = {n: {c: flown[n][c].numpy() for c in turning} for n in names}
    for channels in flights.values():
        time = channels["time"]
        channels |= {c: np.interp(time, time[::2], channels[c][::2]) for c in ("phi", "theta", "psi")}
    drawn = Dataset.from_arrays(
        flights, identify=names, kind="multirotor", controls={c: {"unit": "norm"} for c in flown.controls}
    )
    found = kinematic_findings(drawn)
    assert found.effects == ()
    assert max(found.levels.values()) > 10.0


@pytest.mark.slow
def test_standard_errors_cover_and_nothing_is_named_in_sixty_clean_sets() -> None:
    z, named = [], 0
    for seed in range(60):
        found = kinematic_findings(data({}, seed, flights=4, motions=seed % 5))
        named += bool(found.effects)
        z.append([p.value / p.se for f in found.findings for p in f.parameters])
    assert named <= 1
    assert np.abs(np.mean(z, axis=0)).max() < 4.0 / np.sqrt(60)
    assert np.std(z) < 1.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uh60-hover", "ah1-hover"])
@pytest.mark.parametrize("error", ["delay.attitude", "scale.q", "bias.p", "misalignment.y", "lever_arm.x"])
def test_errors_put_into_simulated_flights_are_named(name: str, error: str) -> None:
    clean = load(shared("flightdata", name))
    # what takes the negative error out puts the error in; the noise goes with it
    wrong = without_errors(clean, {error: -INJECTED[error]})
    found = kinematic_findings(wrong)
    assert found.effects == (f"sensors.{error.partition('.')[0]}",)
    assert found.values[f"sensors.{error}"] == pytest.approx(INJECTED[error], rel=0.1)
