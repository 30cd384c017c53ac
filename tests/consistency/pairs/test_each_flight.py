"""What is wrong in some flights, or from some time on: samples that were lost, another mounting, other stamps."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.examination.finding import Finding
from rotorid_torch.consistency.records.clock_steps import clock_steps, without_clock_steps
from rotorid_torch.data import Dataset
from rotorid_torch.simulation import fly
from tests.consistency.examination.test_check import placed

Arrays = dict[str, np.ndarray]


def grave(flights: dict[str, Arrays]) -> list[Finding]:
    found = check(Dataset.from_arrays(flights, identify=list(flights))).findings
    return [f for f in found if f.severity in ("warning", "error") and "missing" not in f.sentence]


def lost(flight: Arrays, channels: tuple[str, ...], at: int, count: int) -> Arrays:
    """The flight with so many samples lost in channels, of which the later ones come too early."""
    ends = np.full(count, np.nan)
    return flight | {c: np.concatenate([flight[c][:at], flight[c][at + count :], ends]) for c in channels}


LOST = [(("phi", "theta", "psi"), 25), (("phi", "theta", "psi"), 90), (("u", "v", "w"), 90)]
LOST += [(("north", "east", "height"), 90)]


@pytest.mark.parametrize(("channels", "count"), LOST, ids=str)
def test_samples_lost_in_the_middle_are_told_with_place_and_time(channels: tuple[str, ...], count: int):
    flights = {f"f{seed}": lost(placed(seed), channels, 800 + 100 * seed, count) for seed in range(3)}
    found = [f for f in grave(flights) if "nowhere follow" not in f.sentence]
    (one,) = [f for f in found if "early" not in f.sentence]
    assert (one.severity, {*one.channel.split()}) == ("error", {*channels})
    for seed in range(3):
        told = re.search(rf"by ([-+.0-9]+) s at ([.0-9]+) s of f{seed}", one.sentence)
        assert told
        assert float(told[1]) == pytest.approx(-0.01 * count, abs=0.12)
        assert float(told[2]) == pytest.approx(8.0 + seed, abs=0.6)


def test_a_clock_that_was_set_is_told_and_put_back():
    flight = placed(0)
    flights = {
        "f": flight | {c: np.concatenate([v[:900], v[880:-20]]) for c, v in flight.items() if c in ("p", "q", "r")}
    }
    data = Dataset.from_arrays(flights, identify=["f"])
    (step,) = clock_steps(data)
    assert step.seconds == pytest.approx(-0.2, abs=0.04)  # rates that come late are attitudes that come early
    assert clock_steps(without_clock_steps(data, [step])) == ()


def test_clocks_of_right_records_do_not_jump():
    flights = {f"f{seed}": placed(seed) for seed in range(3)}
    late = {
        n: {c: v[:-20] if c in ("phi", "theta", "psi") else v[20:] for c, v in f.items()} for n, f in flights.items()
    }
    for one in (flights, late):
        assert clock_steps(Dataset.from_arrays(one, identify=list(one))) == ()


TURNED = {
    "another mounting": lambda f: f | {"p": f["q"], "q": -f["p"], "ax": f["ay"], "ay": -f["ax"]},
    "a wrong sign": lambda f: f | {"q": -f["q"]},
    "other stamps": lambda f: f | {"time": 0.5 * f["time"]},
    "another unit": lambda f: f | {c: f[c] / 0.5144 for c in ("u", "v", "w")},
}


@pytest.mark.parametrize("fault", TURNED)
def test_one_flight_that_is_wrong_is_named(fault: str):
    flights = {f"f{seed}": placed(seed) for seed in range(4)}
    for flight in flights.values():
        del flight["north"], flight["east"], flight["height"]
    found = grave(flights | {"f2": TURNED[fault](flights["f2"])})
    assert {f.flight for f in found if f.severity == "error"} == {"f2"}
    assert not [f for f in found if f.flight != "f2" and "nowhere follow" not in f.sentence]


def test_a_heading_that_one_flight_has_from_another_direction_is_told_with_it():
    flights = {f"f{seed}": placed(seed) for seed in range(4)}
    flights["f2"] |= {"psi": flights["f2"]["psi"] + 0.5 * np.pi}
    (one,) = (f for f in grave(flights) if f.severity == "error")
    assert (one.flight, one.channel) == ("f2", "north east")
    assert re.search(r"turned by -(89|90)\.\d°", one.sentence)


@pytest.mark.parametrize("seconds", [2.0, -1.5])
def test_an_attitude_that_is_late_all_along_has_no_clock_that_jumps(seconds: float):
    names = ("roll_p", "pitch_p", "yaw_p", "sweep_p", "translate_p")
    flown = fly(None, vehicle="multirotor-4", flights=names, seconds=12.0, seed=2).dataset()
    flights = {}
    for name, flight in flown.flights.items():
        time = flight.time.numpy()
        attitude = {c: np.unwrap(flight.channels[c].numpy()) for c in ("phi", "theta", "psi")}
        late = {c: np.interp(time - seconds, time, v, left=np.nan, right=np.nan) for c, v in attitude.items()}
        flights[name] = {"time": time, **{c: v.numpy() for c, v in flight.channels.items()}, **late}
    data = Dataset.from_arrays(
        flights, identify=names, kind="multirotor", vehicle=flown.vehicle, channels=flown.channel_specs
    )
    (one,) = check(data).of("error")
    assert f"attitude {abs(seconds):.3f} s" in one.sentence


def test_an_estimator_that_settles_after_a_landing_is_no_clock_that_jumps():
    time = np.arange(0.0, 31.0, 0.01)
    chance = np.random.default_rng(0)
    climb = 0.8 * np.exp(-0.5 * ((time - 20.0) / 0.9) ** 2) - 0.7 / (1.0 + np.exp(-6.0 * (time - 22.5)))
    landed = np.maximum(time - 26.0, 0.0)
    climb = np.where(time < 26.0, climb, 0.1 - 0.8 * np.exp(-landed / 0.6))
    said = np.where(time < 26.3, climb, -0.7 * np.exp(-np.maximum(landed - 0.3, 0.0) / 1.6))
    noise = {c: 0.005 * chance.standard_normal(len(time)) for c in ("p", "q", "r", "u", "v")}
    angles = {c: 0.01 * np.cumsum(noise[r]) for c, r in (("phi", "p"), ("theta", "q"), ("psi", "r"))}
    places = {"north": 0.01 * np.sin(0.5 * time), "east": 0.01 * np.cos(0.5 * time), "height": 0.01 * np.cumsum(climb)}
    flight = {"time": time, "motor1": 0.5 + 0.1 * climb, "w": -said, **noise, **angles, **places}
    assert clock_steps(Dataset.from_arrays({"f": flight}, identify=["f"])) == ()


@pytest.mark.parametrize("factor", [1.15, 0.9])
def test_a_flight_with_slightly_other_stamps_is_told(factor: float):
    flights = {f"f{seed}": placed(seed) for seed in range(4)}
    flights["f2"]["time"] = factor * flights["f2"]["time"]
    (one,) = (f for f in grave(flights) if f.severity == "error")
    assert (one.flight, one.channel) == ("f2", "time")


@pytest.mark.parametrize("factor", [1.15, 0.9])
def test_slightly_other_stamps_of_one_flight_are_told_by_the_axis_that_moves(factor: float):
    chance = np.random.default_rng(3)
    flights = {f"f{seed}": placed(seed) for seed in range(5)}
    time = flights["f2"]["time"]
    noise = {c: 0.004 * chance.standard_normal(len(time)) for c in ("p", "q", "r", "phi", "theta", "psi")}
    yaw = {"psi": 0.1 * np.sin(2.0 * time), "r": 0.2 * np.cos(2.0 * time)}
    rest = {
        "phi": 0.008 * np.sin(2.0 * time),
        "p": 0.016 * np.cos(2.0 * time),
        **dict.fromkeys(("u", "v", "w"), 0.0 * time),
    }
    still = {"ax": 0.0 * time, "ay": -9.80665 * np.sin(rest["phi"]), "az": -9.80665 * np.cos(rest["phi"])}
    flight = flights["f2"] | yaw | rest | still | {"q": 0.0 * time, "theta": 0.0 * time}
    flights["f2"] = flight | {c: flight[c] + x for c, x in noise.items()} | {"time": factor * time}
    for channel in ("north", "east", "height"):
        del flights["f2"][channel]
    (one,) = (f for f in grave(flights) if f.severity == "error")
    assert (one.flight, one.channel) == ("f2", "time")


def test_one_flight_that_is_resampled_by_wrong_stamps_is_named():
    flights = {f"f{seed}": placed(seed) for seed in range(5)}
    time = flights["f2"]["time"]
    flights["f2"] = {c: x if c == "time" else np.interp(time / 1.15, time, x) for c, x in flights["f2"].items()}
    found = grave(flights)
    (one,) = (f for f in found if f.severity == "error")
    assert (one.flight, "times as fast" in one.sentence) == ("f2", True)
    assert not [f for f in found if f is not one and "nowhere follow" not in f.sentence]


def test_one_weakly_moving_flight_with_exchanged_rates_is_named_and_the_rest_is_usable():
    """Test inputs of a helicopter turn it by a few degrees a second: far above noise, and less than sporty drones."""
    chance = np.random.default_rng(4)
    flights = {f"f{seed}": placed(seed) for seed in range(5)}
    for flight in flights.values():
        slow = 0.15 * np.stack([flight[c] for c in ("phi", "theta", "psi")])
        phi, theta, _ = slow
        dphi, dtheta, dpsi = np.gradient(slow, flight["time"], axis=1)
        flight |= dict(zip(("phi", "theta", "psi"), slow, strict=True))
        flight["p"] = dphi - np.sin(theta) * dpsi
        flight["q"] = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
        flight["r"] = np.cos(phi) * np.cos(theta) * dpsi - np.sin(phi) * dtheta
        for channel in ("u", "v", "w", "ax", "ay", "az", "north", "east", "height"):
            del flight[channel]
        flight |= {c: flight[c] + 0.002 * chance.standard_normal(len(phi)) for c in ("p", "q", "r", "phi", "theta")}
    flights["f3"] |= {"p": flights["f3"]["q"], "q": flights["f3"]["p"]}
    found = grave(flights)
    assert {f.flight for f in found if f.severity == "error"} == {"f3"}
    assert not [f for f in found if f.flight != "f3" and "nowhere follow" not in f.sentence]


@pytest.mark.parametrize(
    ("channel", "size"), [("phi", np.radians(8.0)), ("theta", np.radians(-5.0)), ("ay", 1.0), ("az", -0.8)]
)
def test_one_flight_with_a_constant_that_the_others_do_not_have_is_named(channel: str, size: float):
    flights = {f"f{seed}": placed(seed) for seed in range(5)}
    found = grave(flights | {"f2": flights["f2"] | {channel: flights["f2"][channel] + size}})
    (one,) = [f for f in found if f.severity == "error"]
    assert (one.flight, channel in one.channel.split()) == ("f2", True)
    told = re.search(rf"{channel} (?:is|reads) ([.0-9]+)(°| m/s²) too (\w+)", one.sentence)
    assert told
    assert float(told[1]) == pytest.approx(abs(np.degrees(size) if told[2] == "°" else size), rel=0.05)
    assert (told[3] in ("large", "high")) == (size > 0.0)
