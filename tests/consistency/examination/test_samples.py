"""Samples that were lost as zeros, cut off, stored in steps, or never changed; each is one finding with its size."""

from __future__ import annotations

import numpy as np

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.finding import Finding
from rotorid_torch.data import Dataset
from tests.consistency.examination.test_acting import hovering
from tests.consistency.examination.test_check import rolling

Arrays = dict[str, np.ndarray]
MARK = "0 stands for a missing sample"


def grave(flight: Arrays, words: str, **more: str) -> list[Finding]:
    data = Dataset.from_arrays({"f": flight}, identify=["f"], **more)
    return [f for f in check(data).findings if words in f.sentence]


def test_missing_samples_that_were_written_as_zeros():
    flight, lost = rolling(), np.random.default_rng(0).random(len(rolling()["time"])) < 0.02
    for channel in ("q", "theta"):
        flight[channel] = np.where(lost, 0.0, flight[channel])
    (one,) = grave(flight, MARK)
    assert one.channel.split() == ["q", "theta"]
    assert grave(rolling(), MARK) == []


def test_a_rest_at_zero_and_a_coarse_record_lose_nothing():
    flight = rolling()
    flight["p"][:300] = 0.0
    flight["q"] = np.round(flight["q"], 2)
    assert grave(flight, MARK) == []


def test_what_is_cut_off_by_its_range_is_not_frozen():
    flight = rolling()
    flight["q"] = np.minimum(flight["q"], np.quantile(flight["q"], 0.6))
    assert [f.channel for f in grave(flight, "cut off")] == ["q"]
    assert grave(flight, "frozen") == []


def test_channels_that_freeze_together_are_one_finding():
    flight = rolling()
    for first, channel in ((400, "p"), (700, "q")):
        flight[channel][first : first + 200] = flight[channel][first]
    (one,) = grave(flight, "frozen")
    assert {*one.channel.split()} == {"p", "q"}


def test_angles_in_whole_degrees_are_told_with_their_step():
    flight = rolling()
    for channel in ("phi", "theta"):
        flight[channel] = np.radians(np.round(np.degrees(flight[channel])))
    (one,) = grave(flight, "stored in steps")
    assert {*one.channel.split()} == {"phi", "theta"}
    assert "0.0175" in one.sentence
    assert grave(rolling(), "stored in steps") == []


def test_a_motor_that_never_changes_is_an_error_and_no_feedback():
    flight = hovering()
    flight["motor3"] = np.full_like(flight["motor3"], 0.5)
    (one,) = grave(flight, "never changes", kind="multirotor")
    assert (one.severity, one.channel) == ("error", "motor3")
    assert grave(flight, "feedback", kind="multirotor") == []


def test_a_doublet_without_noise_is_not_stored_in_steps():
    flight = rolling()
    third = len(flight["time"]) // 3
    flight["lat"] = np.repeat([0.0, 0.02, -0.02], [len(flight["time"]) - 2 * third, third, third])
    assert grave(flight, "stored in steps") == []


def test_a_short_rest_and_a_limit_at_zero_are_no_lost_samples():
    flight = rolling()
    flight["p"][:30] = 0.0
    flight["q"] = np.maximum(flight["q"], 0.0)
    assert grave(flight, MARK) == []


def test_a_motor_that_is_off_spoils_no_axis():
    flight, sentence = hovering(), "stays at 0 in every flight"
    plain = check(Dataset.from_arrays({"f": flight}, identify=["f"], kind="multirotor"))
    data = Dataset.from_arrays({"f": flight | {"motor5": 0.0 * flight["motor1"]}}, identify=["f"], kind="multirotor")
    with_pusher = check(data)
    assert [f.severity for f in with_pusher.findings if sentence in f.sentence] == ["note"]
    grave_ones = [
        [f.sentence for f in one.findings if f.severity in ("error", "warning")] for one in (plain, with_pusher)
    ]
    assert grave_ones[0] == grave_ones[1]


def test_rotors_that_are_off_before_the_start_are_neither_cut_off_nor_frozen():
    flight = hovering()
    speed = 1000.0 * np.sqrt(np.abs(flight["motor1"])) + np.random.default_rng(3).standard_normal(len(flight["time"]))
    speed[:75] = 0.0
    assert grave(flight | {"omega1": speed}, "cut off", kind="multirotor") == []
    assert grave(flight | {"omega1": speed}, "frozen", kind="multirotor") == []


def test_a_simulator_s_battery_that_rests_at_its_least_is_neither_cut_off_nor_frozen():
    flight = hovering()
    voltage = np.maximum(16.2 - 0.1 * np.arange(len(flight["time"])) / len(flight["time"]) * 4.0, 15.95)
    voltage[: len(voltage) // 10] = 16.8
    told = grave(flight | {"voltage": voltage}, "", kind="multirotor")
    assert [f.sentence for f in told if "voltage" in f.channel.split()] == []


def test_controls_that_are_stored_coarsely_or_held_are_told():
    flight = rolling()
    wave = 0.05 * np.sin(1.3 * flight["time"])
    for lat, words in ((0.02 * np.round(wave / 0.02), "stored in steps"), (np.repeat(wave[::20], 20), "held between")):
        (one,) = grave(flight | {"lat": lat}, words)
        assert (one.severity, one.channel) == ("warning", "lat")
    drawn = np.interp(flight["time"], flight["time"][::20], wave[::20])
    (one,) = grave(flight | {"lat": drawn}, "drawn straight between")
    assert (one.severity, one.channel) == ("warning", "lat")
    chance = np.random.default_rng(4)
    two = 0.02 * chance.choice([-1.0, 1.0], len(wave))  # a binary sequence, and a staircase, are commands
    for command in (np.repeat(two[::20], 20), 0.02 * chance.standard_normal(len(wave))[np.arange(len(wave)) // 100]):
        assert grave(flight | {"lat": command[: len(wave)]}, "held between") == []
    assert grave(flight | {"lat": wave}, "drawn straight") == []
    assert grave(flight | {"lat": wave}, "stored in steps") == grave(flight | {"lat": wave}, "held between") == []


def test_motors_that_were_read_too_seldom_limit_every_axis():
    """Commands of 10 Hz on a record of 100 Hz: nothing tells lag and delay, and what was faster is folded."""
    flight = hovering()
    time = flight["time"]
    slow = {m: np.interp(time, time[::10], flight[m][::10]) for m in flight if m.startswith("motor")}
    (one,) = grave(flight | slow, "drawn straight between", kind="multirotor")
    assert (one.severity, one.channel) == ("warning", "motor1 motor2 motor3 motor4 p q r az")
    assert grave(flight, "drawn straight between", kind="multirotor") == []
