"""Sensors made wrong: the errors are those that their formulas say, the table counts what was said, the quick form."""

import math
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from tests.experiments.test_experiments import quick
from tests.helpers import shared

pytest.importorskip("tyro", reason="experiments need the extra 'experiments'")
pytest.importorskip("torch.utils.tensorboard")

DT = 0.01
TIME = DT * np.arange(1000)


def wrong(kind: str, member: str, size: float, **records: np.ndarray) -> dict[str, np.ndarray]:
    return import_module("wrong_sensors").WRONG[kind](records, member, size, DT)


def test_a_delay_and_a_filter_act_on_one_unit_by_their_exact_solutions() -> None:
    late = wrong("delay", "attitude", 0.0237, phi=TIME, p=TIME)
    assert list(late) == ["phi"]
    np.testing.assert_allclose(late["phi"][10:], TIME[10:] - 0.0237, atol=1e-12)
    slow = wrong("filter", "rates", 0.05, q=TIME)["q"]  # a ramp that passes a lag is a ramp less lag times slope
    np.testing.assert_allclose(slow, TIME - 0.05 * (1.0 - np.exp(-TIME / 0.05)), atol=1e-12)


def test_a_filter_of_second_order_follows_a_ramp_at_twice_the_damping_times_the_period() -> None:
    late = TIME - wrong("second_order", "rates", 0.03, q=TIME)["q"]
    np.testing.assert_allclose(late[200:], 2.0 * 0.7 * 0.03, atol=1e-9)


def test_a_displaced_unit_feels_the_turning() -> None:
    still = {c: np.zeros_like(TIME) for c in ("ax", "ay", "az", "q", "r")}
    felt = wrong("lever_arm", "z", 0.5, p=0.2 * TIME, **still)  # point below the centre: y by -p' z, z by -p² z
    np.testing.assert_allclose(felt["ay"][20:-20], -0.1, atol=1e-12)
    np.testing.assert_allclose(felt["az"][20:-20], -0.5 * (0.2 * TIME[20:-20]) ** 2, atol=1e-6)
    assert not felt["ax"][20:-20].any()


def test_a_turned_unit_reads_along_its_own_axes() -> None:
    still = {c: np.zeros(3) for c in ("q", "r", "ax", "ay")}
    read = wrong("misalignment", "y", 0.3, p=np.ones(3), az=np.ones(3), **still)
    np.testing.assert_allclose((read["p"], read["r"]), [[math.cos(0.3)] * 3, [math.sin(0.3)] * 3])
    np.testing.assert_allclose((read["ax"], read["az"]), [[-math.sin(0.3)] * 3, [math.cos(0.3)] * 3])


def test_the_table_counts_what_was_said() -> None:
    module = import_module("wrong_sensors")
    delay, late = "sensors.delay", "sensors.delay.rates"
    one = {"kind": "delay", "hidden": [delay], "member": late, "accepted": [late], "group": [], "size": 0.05}
    sized = {"found": 0.06, "se": 0.002}
    lines = [
        one | sized | {"named": [delay]},
        one | {"named": [], "group": [delay, "sensors.filter"]},
        one | {"named": [delay, "sensors.bias"]},
        one | {"named": [delay], "accepted": ["sensors.delay.attitude"]},
        one | {"named": [], "group": ["sensors.filter", "sensors.scale"]},
        {"kind": "nothing", "hidden": [], "named": [], "group": []},
    ]
    said = ["named", "in a group", "false name", "false name", "false name", "silent"]
    assert [module.outcome(line) for line in lines] == said
    text = module.table(lines)
    assert "| sensors.delay | 5 | 1 | 1 |  | 3 | 1.200 | 5.0 | 5.0 |" in text
    assert "| nothing | 1 |  |  | 1 |  |  |  |  |" in text
    assert "Named alone: 1 of 5 (20 %;" in text


def test_errors_in_other_peoples_records_are_named(tmp_path: Path) -> None:
    data = shared("flightdata")
    result = quick("studies/wrong_sensors", tmp_path, "--data", str(data), "--out", str(tmp_path / "study"))
    assert result["runs"] == 8
    assert "false name" not in result["wrong"]
    assert result["wrong"]["named"] >= 5
    assert result["right"] == {"silent": 1}
