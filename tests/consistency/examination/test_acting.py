"""Each control acts on what its name, or its declared place, says; flapping goes with the moments."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from rotorid_torch.consistency.examination.acting import acting
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.records.answers import SURE, astray_in_flights, by_flight
from rotorid_torch.consistency.records.excitation import control_axes
from rotorid_torch.data import Dataset, load
from rotorid_torch.simulation import fly
from tests.consistency.examination.test_grade import flown
from tests.helpers import shared

PLACES = ((0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2))
SPINS = ("ccw", "cw", "ccw", "cw")
Arrays = dict[str, np.ndarray]


def said(flight: Arrays, **more: Any) -> list[tuple[str, str, str]]:
    data = Dataset.from_arrays({"f": flight}, identify=["f"], **more)
    words = ("answers", "acts from", "thrust falls", "exchanged", "wrong sign", "the other way")
    return [(f.severity, f.channel, f.sentence) for f in check(data).findings if any(w in f.sentence for w in words)]


def sticks(flight: Arrays, **col: str) -> list[tuple[str, str, str]]:
    controls = {stick: {"unit": "rad"} for stick in ("lat", "lon", "col", "ped")}
    controls["col"] |= col
    return said(flight, controls=controls)


def exchanged(flight: Arrays, one: str, other: str) -> Arrays:
    return flight | {one: flight[other], other: flight[one]}


def test_sticks_of_their_axes_are_right():
    assert sticks(flown()) == []


@pytest.mark.parametrize(("one", "other"), [("lat", "lon"), ("lat", "ped"), ("col", "lon")])
def test_exchanged_sticks_are_an_error(one: str, other: str):
    ((severity, channels, sentence),) = sticks(exchanged(flown(), one, other))
    assert severity == "error"
    assert {*channels.split()} == {one, other}
    assert "exchanged" in sentence


def test_a_collective_that_is_turned_is_told_unless_it_is_declared():
    turned = flown() | {"col": -flown()["col"]}
    assert [(severity, channel) for severity, channel, _ in sticks(turned)] == [("warning", "col")]
    assert sticks(turned, positive="descent") == []


def hovering(seed: int = 0) -> Arrays:
    """A quadrotor whose motors move by random steps, with damping."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, 0.01)
    motors = []
    for _ in range(4):
        switches = np.cumsum(rng.uniform(0.2, 0.8, 120))
        motors.append(0.05 * rng.choice([-1.0, 0.0, 1.0], 121)[np.searchsorted(switches, time)] * (time > 1.0))
    m, spin = np.stack(motors), np.array([1.0, -1.0, 1.0, -1.0])
    x, y = np.array(PLACES).T
    flight = {"time": time} | {f"motor{i + 1}": 0.5 + m[i] for i in range(4)}
    for name, row, power in (("p", -y, 200.0), ("q", x, 180.0), ("r", spin, 5.0)):
        asked, rate = power * row @ m, np.zeros(len(time))
        for i in range(1, len(time)):
            rate[i] = rate[i - 1] + 0.01 * (asked[i - 1] - 3.0 * rate[i - 1])
        flight[name] = rate + 1e-3 * rng.standard_normal(len(time))
    return flight | {"az": -9.8 - 5.0 * m.sum(axis=0) + 1e-2 * rng.standard_normal(len(time))}


def motors(flight: Arrays, places: Any = PLACES, spins: Any = SPINS) -> list[tuple[str, str, str]]:
    table = [{"position": [*place, 0.0], "spin": spin} for place, spin in zip(places, spins, strict=True)]
    return said(flight, kind="multirotor", vehicle={"motors": table})


def test_motors_of_their_places_are_right():
    assert motors(hovering()) == []


@pytest.mark.parametrize("order", [(2, 1, 3, 4), (1, 3, 2, 4), (2, 3, 4, 1), (3, 4, 1, 2), (4, 3, 2, 1)])
def test_motors_of_other_places_are_named(order: tuple[int, ...]):
    flight = hovering()
    moved = flight | {f"motor{i}": flight[f"motor{k}"] for i, k in enumerate(order, 1)}
    ((severity, channels, sentence),) = motors(moved)
    assert severity == "error"
    assert channels.split() == [f"motor{i}" for i, k in enumerate(order, 1) if i != k]
    assert all(f"motor{i} acts from where motor{k} is declared" in sentence for i, k in enumerate(order, 1) if i != k)


def test_motors_that_one_flight_has_in_another_order_are_told_with_the_flight():
    flights = {f"f{seed}": hovering(seed) for seed in range(4)}
    flights["f2"] = exchanged(flights["f2"], "motor1", "motor3")
    data = Dataset.from_arrays(flights, kind="multirotor", identify=["f0", "f1"], validate=["f2"], acid=["f3"])
    ((flight, channels),) = [(f.flight, f.channel) for f in acting(data)]
    assert (flight, channels) == ("f2", "motor1 motor3")


def test_motors_that_are_recorded_long_before_the_motion_act_from_their_places():
    """Swings of 2 Hz: at lags that are too short each motor seems to be its opposite."""
    time, mix = np.arange(0.0, 20.0, 0.01), np.array([[-1, -1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1]])
    asked = np.stack([np.sin(2.0 * np.pi * f * time + f * np.sin(0.3 * time)) for f in (1.9, 2.1, 2.3)])
    noise = np.random.default_rng(0).standard_normal((3, len(time)))
    rates = np.cumsum(asked, axis=1) * 0.01 * np.array([[8.0], [7.0], [2.0]]) + 1e-3 * noise
    flight = {"time": time} | {f"motor{i + 1}": 0.5 + 0.02 * m for i, m in enumerate(mix.T @ asked)}
    flight |= dict(zip("pqr", rates, strict=True))
    early = {c: x[40:] if c.startswith("motor") else x[:-40] for c, x in flight.items()}
    assert motors(flight) == motors(early) == []


def test_spins_and_sides_that_are_declared_the_other_way():
    ((_, _, spins),) = motors(hovering(), spins=("cw", "ccw", "cw", "ccw"))
    assert "spins are the other way round" in spins
    ((_, _, sides),) = motors(hovering(), places=[(x, -y) for x, y in PLACES])
    assert "left and right" in sides


def test_axes_of_motors_without_places_are_those_of_what_they_do():
    data = Dataset.from_arrays({"f": hovering()}, identify=["f"], kind="multirotor")
    axes = {axis.name: axis.weights for axis in control_axes(data)}
    assert {*axes} == {"thrust", "roll", "pitch", "yaw"}
    assert np.allclose(np.abs(np.stack([*axes.values()])), 0.25, atol=0.03)
    assert not [f for f in check(data).findings if "feedback" in f.sentence and f.severity == "warning"]


def test_reversed_commands_are_told_without_places_too():
    flight = hovering()
    turned = flight | {f"motor{i}": 1.0 - flight[f"motor{i}"] for i in range(1, 5)}
    ((severity, _, sentence),) = said(turned, kind="multirotor")
    assert severity == "error"
    assert "reversed" in sentence


def test_flapping_is_exchanged_or_has_a_wrong_sign():
    flight = flown()
    slope = {name: np.gradient(flight[rate], flight["time"]) for name, rate in (("b1", "p"), ("a1", "q"))}
    flight |= {name: np.convolve(0.01 * values, np.ones(5) / 5.0, "same") for name, values in slope.items()}
    assert sticks(flight) == []
    ((_, channels, _),) = sticks(exchanged(flight, "a1", "b1"))
    assert channels == "a1 b1"
    ((_, channels, sentence),) = sticks(flight | {"a1": -flight["a1"]})
    assert channels == "a1"
    assert "wrong sign" in sentence


@pytest.mark.parametrize("name", ["crazyflie-motors", "nanodrone", "uh60-hover", "trex550-rates"])
def test_nothing_is_told_of_measured_and_simulated_sets(name: str):
    from rotorid_torch.consistency.examination.acting import acting

    assert [*acting(load(shared("flightdata", name)))] == []


def test_a_bench_answers_nothing():
    flight, rng = hovering(), np.random.default_rng(1)
    bench = {channel: 1e-3 * rng.standard_normal(2000) for channel in ("p", "q", "r")}
    sums = np.sum([flight[f"motor{i}"] for i in range(1, 5)], axis=0)
    assert motors(flight | bench | {"az": -9.8 + 0.02 * (sums - sums.mean())}) == []


def test_sticks_are_exchanged_whether_yaw_moves_or_not():
    flight, rng = exchanged(flown(), "lat", "lon"), np.random.default_rng(2)
    flight |= {channel: 1e-3 * rng.standard_normal(len(flight["time"])) for channel in ("r", "ped")}
    ((severity, channels, _),) = sticks(flight)
    assert severity == "error"
    assert {*channels.split()} == {"lat", "lon"}


def driven_by_a_mixer(seed: int) -> Arrays:
    """Six motors that thrust, roll, pitch and yaw drive, each command with noise of its own."""
    rng = np.random.default_rng(seed)
    time, angles = np.arange(0.0, 30.0, 0.01), np.pi / 3.0 * np.arange(6)
    asked = [np.repeat(rng.choice([-0.05, 0.0, 0.05], size=60), 50) for _ in range(4)]
    mixer = np.stack([np.ones(6), np.sin(angles), np.cos(angles), np.tile([1.0, -1.0], 3)])
    commands = 0.5 + np.stack(asked).T @ mixer
    rates = [np.cumsum(0.01 * 100.0 * (asked[k] - 0.3 * np.roll(asked[k], 30))) * 0.02 for k in (1, 2, 3)]
    flight = {"time": time, "az": -9.8 - 20.0 * asked[0] + 0.02 * rng.standard_normal(len(time))}
    flight |= {c: r + 0.002 * rng.standard_normal(len(time)) for c, r in zip("pqr", rates, strict=True)}
    return flight | {f"motor{k + 1}": commands[:, k] + 4e-4 * rng.standard_normal(len(time)) for k in range(6)}


@pytest.mark.parametrize("seed", range(4))
def test_what_a_motor_does_beside_its_mixer_is_not_known(seed: int):
    flight = driven_by_a_mixer(seed)
    assert said(flight, kind="multirotor") == []
    ((severity, channel, _),) = said(flight | {"motor4": 1.0 - flight["motor4"]}, kind="multirotor")
    assert (severity, channel) == ("error", "motor4")


def test_a_motor_that_is_off_hides_no_reversed_commands():
    flight = hovering()
    flight |= {name: 1.0 - values for name, values in flight.items() if name.startswith("motor")}
    data = Dataset.from_arrays({"f": flight | {"motor5": np.zeros(len(flight["time"]))}}, identify=["f"])
    assert [f.severity for f in check(data).findings if "thrust falls" in f.sentence] == ["error"]


@pytest.mark.parametrize("recorded", [True, False])
def test_one_motor_whose_command_is_reversed_is_named(recorded: bool):
    flight = {c: v for c, v in hovering().items() if recorded or c != "az"}
    ((severity, channel, sentence),) = motors(flight | {"motor3": 1.0 - flight["motor3"]})
    assert (severity, channel) == ("error", "motor3")
    assert "reversed" in sentence


def test_turbulence_reverses_no_motor():
    """Commands answer the thrust there, so that one motor seems to take it away; its moments say otherwise."""
    air = [("environment.wind", 1.0), ("environment.turbulence", 1.0)]
    made = fly(None, vehicle="multirotor-2", flights=["roll_p", "pitch_p"], effects=air, seconds=15.0)
    assert [f.sentence for f in check(made.dataset()).findings if "reversed" in f.sentence] == []


@pytest.mark.parametrize("turned", [(), (3,)])
def test_what_motors_hardly_do_reverses_none_of_them(turned: tuple[int, ...]):
    """A hexacopter that pitches and heaves; something else of az goes with a thousandth of its commands."""
    rng, time = np.random.default_rng(0), 0.01 * np.arange(2000)
    pitching, heaving, other = (
        np.sin(w * time + a) * np.sin(0.3 * w * time) for w, a in ((3.1, 0.0), (1.3, 1.0), (4.7, 2.0))
    )
    rows = np.array([[1, 0.5, -0.5, -1, -0.5, 0.5], [1] * 6, [-1, 0.5, 0.5, -1, 0.5, 0.5]])
    commands = 0.5 + (np.stack([0.06 * pitching, 0.06 * heaving, 0.002 * other], axis=1) @ rows)
    q = 0.01 * np.cumsum(20.0 * 0.06 * pitching)
    still = {c: 0.002 * rng.standard_normal(2000) for c in ("p", "r")}
    flight = {"time": time, "q": q + 0.002 * rng.standard_normal(2000), **still}
    flight["az"] = -9.8 - 60.0 * 0.06 * heaving - 0.5 * other + 0.02 * rng.standard_normal(2000)
    flight |= {f"motor{i + 1}": commands[:, i] + 2e-4 * rng.standard_normal(2000) for i in range(6)}
    flight |= {f"motor{i}": 1.0 - flight[f"motor{i}"] for i in turned}
    told = [f.channel for f in acting(Dataset.from_arrays({"f": flight}, identify=["f"])) if "reversed" in f.sentence]
    assert told == [f"motor{i}" for i in turned]


def answered(seed: int) -> Arrays:
    """A flight whose rates follow their sticks by a lag of 0.5 s."""
    time, rng = 0.01 * np.arange(1500), np.random.default_rng(seed)
    flight = {"time": time}
    for stick, rate in (("lat", "p"), ("lon", "q"), ("ped", "r")):
        steps = np.repeat(rng.uniform(-0.1, 0.1, 15), 100)
        smooth = np.convolve(steps, np.hanning(21) / 10.0, "same")
        follows = np.convolve(10.0 * smooth, 0.01 * np.exp(-2.0 * time))[: len(time)]
        flight |= {stick: smooth, rate: follows + 0.002 * rng.standard_normal(len(time))}
    return flight


@pytest.mark.parametrize("turned", [{}, {"f1": "lat"}, {"f1": "lon", "f3": "ped"}])
def test_a_stick_that_one_flight_has_turned_is_told_with_the_flight(turned: dict[str, str]):
    flights = {f"f{seed}": answered(seed) for seed in range(5)}
    for name, stick in turned.items():
        flights[name][stick] = -flights[name][stick]
    findings = check(Dataset.from_arrays(flights, identify=["f0", "f1", "f2"], validate=["f3", "f4"])).findings
    told = {f.flight: f.channel for f in findings if "the other way than in the other flights" in f.sentence}
    assert told == turned


STICKS = ("lat", "lon", "ped")
ASTRAY = {
    "late": (lambda flights: {c: np.roll(flights["f1"][c], 40) for c in STICKS}, r"0\.4\d s late"),
    "early": (lambda flights: {c: np.roll(flights["f1"][c], -60) for c in STICKS}, r"0\.\d+ s early"),
    "of another flight": (lambda flights: {c: flights["f3"][c][::-1] for c in STICKS}, "another flight's"),
    "in another unit": (lambda flights: {c: 4.0 * flights["f1"][c] for c in STICKS}, r"as (3\.\d+|4\.\d+|4) times"),
}


@pytest.mark.parametrize("fault", ASTRAY)
def test_controls_of_one_flight_that_are_not_its_own_are_told_with_it(fault: str):
    flights = {f"f{seed}": answered(seed) for seed in range(6)}
    change, words = ASTRAY[fault]
    flights["f1"] |= change(flights)
    found = check(Dataset.from_arrays(flights, identify=[*flights])).findings
    (told,) = [f for f in found if "in the other flights they leave" in f.sentence]
    assert (told.severity, told.flight) == ("error", "f1")
    assert re.search(words, told.sentence)


def test_flights_of_one_control_each_do_not_judge_each_other():
    flown = {f"f{seed}": answered(seed) for seed in range(3)}
    flights = {
        name: f | dict.fromkeys({*STICKS} - {c}, np.zeros(1500))
        for (name, f), c in zip(flown.items(), STICKS, strict=True)
    }
    assert not [f for f in check(Dataset.from_arrays(flights, identify=[*flights])).of("error") if f.flight]


def pedalled(seed: int, size: float) -> Dataset:
    """Six flights, in all but the last of which pedals move by this much; yaw follows them in all."""
    flights, rng = {f"f{k}": answered(10 * seed + k) for k in range(6)}, np.random.default_rng(seed)
    for flight in [*flights.values()][:5]:
        pedals = np.convolve(np.repeat(rng.uniform(-size, size, 15), 100), np.hanning(21) / 10.0, "same")
        yaw = np.convolve(10.0 * pedals, 0.01 * np.exp(-2.0 * flight["time"]))[:1500]
        flight |= {"ped": pedals, "r": yaw + 0.002 * rng.standard_normal(1500)}
    return Dataset.from_arrays(flights, identify=[*flights])


@pytest.mark.parametrize("size", [0.0003, 0.001])
def test_flights_in_which_a_control_hardly_moves_know_how_little_they_know_of_it(size: float):
    """What they leave of a right flight is, on average, what the errors of their effects leave, noise being white."""
    left, unknown = [], []
    for seed in range(12):
        flights = by_flight(pedalled(seed, size))
        assert flights is not None
        left.append(flights.left_of(5, range(5)).share)
        unknown.append(flights.unknown_of(5, range(5)))
    assert 0.3 < np.mean(left) / np.mean(unknown) < 1.5
    assert max(left) < SURE**2 * min(unknown)


def test_flights_in_which_a_control_moves_judge_it():
    flights = by_flight(pedalled(0, 0.1))
    assert flights is not None
    assert flights.unknown_of(5, range(5)) < 1e-3


def controlled(seed: int, steered: float) -> Arrays:
    """A flight in gusts, whose pedals are steered by a yaw damper and by this much besides."""
    flight, rng = answered(seed), np.random.default_rng(100 + seed)
    steps = np.convolve(np.repeat(rng.uniform(-steered, steered, 15), 100), np.hanning(21) / 10.0, "same")
    gust = np.convolve(rng.standard_normal(1500), np.hanning(41) / 20.0, "same")
    r, pedals = np.zeros(1500), np.zeros(1500)
    for k in range(1499):
        pedals[k] = steps[k] - 0.1 * r[k]
        r[k + 1] = r[k] + 0.01 * (10.0 * pedals[k] - 2.0 * r[k] + 8.0 * gust[k])
    return flight | {"ped": pedals, "r": r + 0.002 * rng.standard_normal(1500)}


@pytest.mark.parametrize("seed", range(3))
def test_flights_with_inputs_that_contradict_those_of_a_controller_together_are_right(seed: int):
    """Where only the yaw damper moves them the pedals answer the gusts, and seem to do what gusts do."""
    flights = {f"f{k}": controlled(10 * seed + k, 0.03 if k < 3 else 0.003) for k in range(9)}
    assert astray_in_flights(Dataset.from_arrays(flights, identify=[*flights])) == []


def test_two_flights_with_the_controls_of_others_are_told():
    flights = {f"f{seed}": answered(seed) for seed in range(8)}
    for name, other in (("f1", "f3"), ("f4", "f6")):
        flights[name] |= {c: flights[other][c][::-1] for c in STICKS}
    astray = astray_in_flights(Dataset.from_arrays(flights, identify=[*flights]))
    assert [one.flight for one in astray] == ["f1", "f4"]


def test_what_a_controller_may_feed_back_is_much_where_it_alone_moves_a_control():
    """Of a flight with inputs, by eight of the controller alone, and by eight with inputs."""
    inputs = {f"f{k}": controlled(k, 0.1) for k in range(9)}
    alone = {f"f{k}": controlled(k, 0.1 if k == 0 else 0.003) for k in range(9)}
    by = [by_flight(Dataset.from_arrays(one, identify=[*one])) for one in (inputs, alone)]
    steered, fed = (one.fed_back(0, range(1, 9)) for one in by if one is not None)
    assert fed > 10.0 * steered
