"""Sensor errors from kinematics: found where they are, nowhere else, and taken out again."""

import numpy as np
import pytest

from rotorid_torch.data.dataset import load
from rotorid_torch.trace.sensors.correction import without_errors
from rotorid_torch.trace.sensors.kinematics import kinematic_findings
from tests.helpers import shared
from tests.trace.sensors.kinematic_cases import data

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
    # 25 ms of lag are no different from 25 ms of delay below 1.5 Hz
    pair = {"sensors.delay", "sensors.filter"} if name.startswith("filter") and size < 1.0 else {effect}
    assert {f.id for f in found.findings if f.verdict in ("accepted", "indistinguishable")} == pair
    if found.effects != (effect,):
        return
    parameter = next(p for f in found.findings for p in f.parameters if p.name == f"sensors.{name}")
    assert parameter.accepted
    assert abs(parameter.value - size * INJECTED[name]) < 4.0 * parameter.se
    assert parameter.smallest_visible < size * INJECTED[name]


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
