"""Slow channels are drawn, the ground is left out, a motor whose signal is lost is named; none of it costs an axis."""

from __future__ import annotations

import numpy as np
import pytest

from rotorid_torch.consistency.records.ground import in_the_air, on_ground
from rotorid_torch.consistency.records.slow import drawn_between, slow_channels
from rotorid_torch.data import Dataset
from rotorid_torch.run.check import Check, check
from tests.consistency.examination.test_acting import PLACES, SPINS, hovering

Arrays = dict[str, np.ndarray]
RATES = ("p", "q", "r", "az")


def stirred() -> Arrays:
    """A quadrotor whose motors never rest: a controller answers noise."""
    flight, rng = hovering(), np.random.default_rng(3)
    noise = {f"motor{i}": flight[f"motor{i}"] + 1e-3 * rng.standard_normal(len(flight["time"])) for i in range(1, 5)}
    return flight | noise


def dataset(flight: Arrays) -> Dataset:
    places = [{"position": [*p, 0.0], "spin": s} for p, s in zip(PLACES, SPINS, strict=True)]
    controls = {f"motor{i}": {"limits": [0.0, 1.0]} for i in range(1, 5)}
    return Dataset.from_arrays(
        {"f": flight}, identify=["f"], kind="multirotor", vehicle={"motors": places}, controls=controls
    )


def axes(result: Check) -> dict[str, str]:
    return {one.axis: one.grade for one in result.axes}


@pytest.mark.parametrize("every", [2, 5, 10])
def test_channels_with_one_row_in_so_many_are_drawn_between(every: int):
    time = np.arange(0.0, 20.0, 0.01)
    curve = np.sin(2.0 * np.pi * 0.7 * time)
    slow = np.where(np.arange(len(time)) % every == 0, curve, np.nan)
    slow[800:1000] = np.nan
    flight = {"time": time, "lat": np.sign(curve), "p": curve, "q": slow, "r": np.where(time < 10.0, curve, np.nan)}
    data = Dataset.from_arrays({"f": flight}, identify=["f"])
    assert slow_channels(data) == {"q": pytest.approx(100.0 / every)}
    drawn = drawn_between(data).flights["f"].channels["q"].numpy()
    assert np.isnan(drawn[810:990]).all()
    assert np.nanmax(np.abs(drawn - curve)) < 0.02
    assert np.isfinite(drawn[:790]).all()


def test_channels_too_slow_for_what_is_compared_stay_missing():
    """Of 5 Hz a cubic holds other motion than the comparisons, which reach 4.9 Hz."""
    time = np.arange(0.0, 20.0, 0.01)
    curve = np.sin(2.0 * np.pi * 0.7 * time)
    slow = np.where(np.arange(len(time)) % 20 == 0, curve, np.nan)
    data = Dataset.from_arrays({"f": {"time": time, "lat": np.sign(curve), "p": curve, "q": slow}}, identify=["f"])
    assert slow_channels(data) == {}
    assert drawn_between(data) is data


def test_slow_rates_show_that_an_axis_was_flown():
    flight = stirred()
    rows = np.arange(len(flight["time"])) % 5 == 0
    result = check(dataset(flight | {c: np.where(rows, flight[c], np.nan) for c in RATES}))
    assert axes(result) == axes(check(dataset(flight)))
    assert not [f for f in result.findings if "are missing" in f.sentence]
    assert [f.severity for f in result.findings if "sampled more slowly" in f.sentence] == ["note"]


def test_samples_that_are_missing_here_and_there_cost_no_axis():
    flight, rng = stirred(), np.random.default_rng(4)
    holes = {c: np.where(rng.random(len(flight[c])) < 0.02, np.nan, flight[c]) for c in RATES}
    assert axes(check(dataset(flight | holes))) == axes(check(dataset(flight)))


def test_what_stands_on_the_ground_is_told_and_left_out():
    flight, rng = stirred(), np.random.default_rng(5)
    still = {c: np.concatenate([flight[c], 1e-3 * rng.standard_normal(800) - 9.8 * (c == "az")]) for c in RATES}
    off = {f"motor{i}": np.concatenate([flight[f"motor{i}"], np.zeros(800)]) for i in range(1, 5)}
    data = dataset(still | off | {"time": 0.01 * np.arange(2800)})
    assert on_ground(data) == {"f": (0.0, pytest.approx(8.0))}
    assert in_the_air(data).flights["f"].samples == 2000
    result = check(data)
    assert axes(result) == axes(check(dataset(flight)))
    assert any("all motors are off for up to 8.0 s" in f.sentence for f in result.findings)


def test_a_motor_whose_signal_is_lost_is_named():
    flight = stirred()
    assert not [f for f in check(dataset(flight)).findings if "signal was lost" in f.sentence]
    lost = np.where(flight["time"] > 12.0, 0.0, flight["motor3"])
    (one,) = [f for f in check(dataset(flight | {"motor3": lost})).findings if "signal was lost" in f.sentence]
    assert one.channel.startswith("motor3")


def test_a_motor_that_a_controller_takes_back_to_idle_is_not_lost():
    flight = stirred()
    command, time = flight["motor3"], flight["time"]
    down = np.clip(np.minimum((time - 8.0) / 0.2, (9.9 - time) / 0.2), 0.0, 1.0)
    idle = np.maximum(command - 1.5 * command.max() * down, 0.0)
    assert (idle == 0.0).sum() > 160
    assert not [f for f in check(dataset(flight | {"motor3": idle})).findings if "signal was lost" in f.sentence]
    lost = np.where((time > 8.0) & (time < 9.9), 0.0, command)
    assert [f for f in check(dataset(flight | {"motor3": lost})).findings if "signal was lost" in f.sentence]


@pytest.mark.parametrize(("factor", "in_rpm"), [(1.0, False), (60.0 / (2.0 * np.pi), True)])
def test_rotor_speeds_in_revolutions_a_minute_are_told(factor: float, in_rpm: bool):
    flight = stirred()
    speeds = {f"omega{i}": factor * 600.0 * np.sqrt(flight[f"motor{i}"]) for i in range(1, 5)}
    fast = [f for f in check(dataset(flight | speeds)).findings if "beyond sound" in f.sentence]
    assert [f.channel for f in fast] == (["omega1 omega2 omega3 omega4"] if in_rpm else [])
    single = {"omega": factor * (27.0 + 0.1 * np.sin(flight["time"]))} | {c: flight[c] for c in ("time", "p", "q", "r")}
    vehicle = {"rotor": {"speed": 27.0}}
    data = Dataset.from_arrays({"f": single | {"lat": flight["motor1"]}}, identify=["f"], vehicle=vehicle)
    assert any("times the declared rotor.speed (rpm?)" in f.sentence for f in check(data).findings) == in_rpm


def test_a_stick_whose_signal_is_lost_is_named_and_one_that_rests_is_not():
    def helicopter(flight):
        return Dataset.from_arrays({"f": flight}, identify=["f"])

    flight, rng = stirred(), np.random.default_rng(6)
    count = len(flight["time"])
    sticks = {c: 0.002 * rng.standard_normal(count).cumsum() for c in ("lon", "lat", "ped")}
    sticks |= {"col": 0.1 * rng.standard_normal(20).repeat(count // 20 + 1)[:count]}
    flight = {c: x for c, x in flight.items() if not c.startswith("motor")} | sticks
    dying = np.where(np.arange(count) < 1000, flight["lat"], 1e-9 * np.exp(-0.2 * (np.arange(count) - 1000.0)))
    dying = np.where(np.arange(count) < 1500, dying, 0.0)
    for still in (flight, flight | {"lat": dying, "col": flight["lon"] ** 2}):
        assert not [f for f in check(helicopter(still)).findings if "signal was lost" in f.sentence]
    lost = np.where((flight["time"] > 8.0) & (flight["time"] < 11.0), flight["lat"][800], flight["lat"])
    flight |= {"lat": lost, "col": 0.002 * rng.standard_normal(count).cumsum()}
    (one,) = [f for f in check(helicopter(flight)).findings if "signal was lost" in f.sentence]
    assert (one.channel, one.severity) == ("lat", "warning")
