"""Sensor errors from kinematics: found where they are, nowhere else, and taken out again."""

import numpy as np
import pytest

from rotorid_torch.data.dataset import load
from rotorid_torch.trace.kinematics import kinematic_findings
from tests.helpers import shared
from tests.trace.kinematic_cases import data

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
