"""Large errors first: an IMU turned by any angle, streams off by any time, signs and exchanged axes; no other name."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rotorid_torch.consistency.correction import without_errors_of_flight
from rotorid_torch.consistency.examination.check import check
from rotorid_torch.consistency.pairs.alignment import (
    alignment,
    angle_of,
    force_turn,
    right_angles,
    rotation,
    rotation_vector,
)
from rotorid_torch.consistency.pairs.odd_flights import with_only
from rotorid_torch.consistency.sensor_errors.clocks import sensor_findings
from rotorid_torch.consistency.sensor_errors.kinematic_findings import kinematic_findings
from rotorid_torch.data import Dataset, load
from rotorid_torch.data.facts import Facts
from rotorid_torch.data.flight import Flight
from tests.consistency.sensor_errors.kinematic_cases import UNITS, motion, read
from tests.helpers import shared

TRUTH = motion(3, 4, seconds=20.0)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0), "between": (0.5, -0.7, 0.51)}


def flights(turn: np.ndarray | None = None) -> dict[str, dict[str, np.ndarray]]:
    made = {}
    for k, truth in enumerate(TRUTH):
        flight = read(truth, {}, seed=k)
        time = flight["time"]
        flight |= {"lat": 0.1 * np.sin(2.0 * time), "lon": 0.1 * np.cos(1.3 * time)}
        for triad in (("p", "q", "r"), ("ax", "ay", "az")):
            if turn is not None:
                seen = rotation(turn).T @ np.stack([flight[c] for c in triad])
                flight |= dict(zip(triad, seen, strict=True))
        made[f"f{k}"] = flight
    return made


def dataset(made: dict[str, dict[str, np.ndarray]]) -> Dataset:
    return Dataset.from_arrays(made, identify=[*made])


def late(made: dict, channels: tuple[str, ...], seconds: float) -> dict:
    """The flights with these channels so much later than the others; shorter by that."""
    moved = {}
    for name, flight in made.items():
        by, count = round(seconds / 0.01), len(flight["time"])
        first, last = max(by, 0), count + min(by, 0)
        kept = {c: v[first - by : last - by] if c in channels else v[first:last] for c, v in flight.items()}
        moved[name] = kept | {"time": 0.01 * np.arange(last - first)}
    return moved


def away(a: np.ndarray, b: np.ndarray) -> float:
    """Angle in degrees between two rotation vectors."""
    return float(np.degrees(Rotation.from_matrix(rotation(a).T @ rotation(b)).magnitude()))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.0, 3.1, math.pi])
def test_the_angle_of_a_turn(angle: float):
    assert angle_of(rotation(angle * np.array([0.6, 0.0, -0.8]))) == pytest.approx(angle, rel=1e-9, abs=1e-15)


def test_records_without_large_errors_have_none():
    found = alignment(dataset(flights()))
    assert (found.angle, dict(found.clocks), found.mirror) == (0.0, {}, "")
    assert len(right_angles()) == 24
    assert rotation_vector(rotation(np.array([0.3, -0.2, 2.0]))) == pytest.approx([0.3, -0.2, 2.0])


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("degrees", [10, 14, 25, 45, 90, 135, 180])
def test_a_turned_imu_is_right_to_half_a_degree(degrees: int, axis: str):
    vector = np.array(AXES[axis])
    turn = np.radians(degrees) * vector / np.linalg.norm(vector)
    found = alignment(dataset(flights(turn)))
    assert away(found.turn, turn) < 0.5
    assert not found.clocks


@pytest.mark.parametrize("share", [0.3, 0.5, 0.65])
@pytest.mark.parametrize("degrees", [5, 10, 90])
def test_a_turned_imu_is_right_where_angles_are_missing(degrees: int, share: float):
    turn = np.radians(degrees) * np.array([-0.94, -0.18, 0.29])
    found = alignment(dataset(without(("phi",), "end", share, flights(turn))))
    assert away(found.turn, turn) < 0.5
    assert not found.clocks


@pytest.mark.parametrize("degrees", [45, 180])
def test_a_turned_imu_is_one_error_and_no_bias(degrees: int):
    turn = np.radians(degrees) * np.array([0.0, 0.6, 0.8])
    turned = dataset(flights(turn))
    found = check(turned)
    assert not found.fit
    (error,) = found.of("error")
    assert f"turned by {degrees}.0°" in error.sentence
    assert not any("sensor bias" in f.sentence or "off by" in f.sentence for f in found.findings)
    values = kinematic_findings(turned).values
    assert {name.rpartition(".")[0] for name in values} == {"sensors.misalignment"}
    assert away(np.array([values[f"sensors.misalignment.{a}"] for a in "xyz"]), turn) < 0.2


@pytest.mark.parametrize("moving", [True, False])
@pytest.mark.parametrize("degrees", [10, 33, 90])
def test_gyros_that_are_turned_alone_are_one_error(degrees: int, moving: bool):
    turn, made = np.radians(degrees) * np.array([0.0, 0.6, 0.8]), flights()
    for flight in made.values():
        seen = rotation(turn).T @ np.stack([flight[c] for c in ("p", "q", "r")])
        flight |= dict(zip(("p", "q", "r"), seen, strict=True))
        for channel in ("u", "v", "w") if not moving else ():
            del flight[channel]
    (error,) = check(dataset(made)).of("error")
    assert error.channel == "p q r"
    assert f"the gyros alone are turned by {degrees}.0°" in error.sentence


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("degrees", [10, 45, 135])
def test_a_turned_imu_of_another_simulator_is_the_only_name(degrees: int, half: bool):
    recorded, turn = load(shared("flightdata", "uh60-hover")), np.radians(degrees) * np.array([-0.64, -0.48, 0.6])

    def changed(flight: Flight) -> Flight:
        channels = dict(flight.channels)
        for triad in (("p", "q", "r"), ("ax", "ay", "az")):
            seen = rotation(turn).T @ np.stack([channels[c].numpy() for c in triad])
            channels |= {c: channels[c].new_tensor(row) for c, row in zip(triad, seen, strict=True)}
        if half:
            channels["phi"] = channels["phi"].clone()
            channels["phi"][flight.samples // 2 :] = float("nan")
        return replace(flight, channels=channels)

    flights = {name: changed(flight) for name, flight in recorded.flights.items()}
    turned = replace(recorded, flights=flights, facts={name: Facts.of(one) for name, one in flights.items()})
    (error,) = check(turned).of("error")
    (said,) = re.findall(r"turned by ([\d.]+)°", error.sentence)
    assert float(said) == pytest.approx(degrees, abs=0.5)
    found = sensor_findings(turned)
    named = {f.id for f in found.findings if f.verdict in ("accepted", "indistinguishable")}
    assert named == {"sensors.misalignment"}
    assert away(np.array([found.values[f"sensors.misalignment.{a}"] for a in "xyz"]), turn) < 0.5


def test_a_mounting_by_right_angles_is_told_by_its_axes():
    (error,) = check(dataset(flights(np.radians(90.0) * np.array([0.0, 0.0, 1.0])))).of("error")
    assert "p q r read +q -p +r" in error.sentence


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"q": ("q", -1.0)}, "+p -q +r"),
        ({"p": ("q", 1.0), "q": ("p", 1.0)}, "+q +p +r"),
        ({c: (c, -1.0) for c in "pqr"}, "-p -q -r"),
    ],
)
def test_signs_and_exchanged_axes_are_told(change: dict, told: str):
    made = {name: f | {c: s * f[source] for c, (source, s) in change.items()} for name, f in flights().items()}
    assert any(told in f.sentence for f in check(dataset(made)).of("error"))


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("seconds", [0.9, -0.81, 1.3, -3.2, 5.0, -5.0])
def test_streams_that_are_far_off_are_told_with_their_time(unit: str, seconds: float):
    found = alignment(dataset(late(flights(), UNITS[unit], seconds)))
    assert {*found.clocks} == {unit}
    assert found.clocks[unit] == pytest.approx(seconds, abs=0.1)
    assert found.angle == 0.0


@pytest.mark.parametrize("unit", ["attitude", "rates", "accelerations", "velocities"])
@pytest.mark.parametrize("seconds", [4.5, -4.5, 5.0, -5.0])
def test_streams_are_far_off_where_the_inputs_are_over_when_they_meet(unit: str, seconds: float):
    made = flights()
    for flight in made.values():
        truth = {c: flight[c].copy() for c in ("phi", "theta", "psi")}
        fades = 0.04 + 0.96 * np.exp(-(((flight["time"] - 4.0) / 3.0) ** 2))
        phi, theta, psi = (fades * truth[c] for c in ("phi", "theta", "psi"))
        dphi, dtheta, dpsi = (np.gradient(angle, 0.01) for angle in (phi, theta, psi))
        flight |= {"phi": phi, "theta": theta, "psi": psi, "p": dphi - np.sin(theta) * dpsi}
        flight["q"] = np.cos(phi) * dtheta + np.sin(phi) * np.cos(theta) * dpsi
        flight["r"] = np.cos(phi) * np.cos(theta) * dpsi - np.sin(phi) * dtheta
        for channel in UNITS["velocities"]:
            flight[channel] *= fades
        u, v, w = (flight[c] for c in UNITS["velocities"])
        flight["ax"] = np.gradient(u, 0.01) + flight["q"] * w - flight["r"] * v + 9.80665 * np.sin(theta)
        flight["ay"] = np.gradient(v, 0.01) + flight["r"] * u - flight["p"] * w
        flight["ay"] -= 9.80665 * np.cos(theta) * np.sin(phi)
        flight["az"] = np.gradient(w, 0.01) + flight["p"] * v - flight["q"] * u
        flight["az"] -= 9.80665 * np.cos(theta) * np.cos(phi)
    short = {name: {c: x[:1500] for c, x in flight.items()} for name, flight in made.items()}
    clocks = alignment(dataset(late(short, UNITS[unit], seconds))).clocks
    assert clocks == {unit: pytest.approx(seconds, abs=0.01)}


def without(
    channels: tuple[str, ...], end: str, share: float, made: dict[str, dict[str, np.ndarray]] | None = None
) -> dict[str, dict[str, np.ndarray]]:
    """Flights with these channels missing for a share at the begin or the end of each."""
    changed = made or flights()
    for flight in changed.values():
        count = len(flight["time"])
        part = slice(0, round(share * count)) if end == "begin" else slice(round((1.0 - share) * count), count)
        for channel in channels:
            flight[channel] = flight[channel].copy()
            flight[channel][part] = np.nan
    return changed


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("share", [0.2, 0.36, 0.5, 0.7])
@pytest.mark.parametrize("end", ["begin", "end"])
@pytest.mark.parametrize("channels", [("phi",), ("p",), UNITS["attitude"], UNITS["rates"], UNITS["velocities"]])
def test_missing_samples_are_no_far_clock(channels: tuple[str, ...], end: str, share: float):
    by = alignment(dataset(without(channels, end, share)))
    assert (by.angle, dict(by.clocks), by.mirror) == (0.0, {}, "")


@pytest.mark.parametrize("end", ["begin", "end"])
def test_a_far_clock_is_told_where_samples_are_missing(end: str):
    by = alignment(dataset(late(without(("phi",), end, 0.4), UNITS["attitude"], 1.3)))
    assert by.clocks == {"attitude": pytest.approx(1.3, abs=0.1)}


@pytest.mark.filterwarnings("error")
def test_streams_that_never_meet_are_not_compared():
    never, other = without(UNITS["attitude"], "begin", 0.5), without(UNITS["rates"], "end", 0.5)
    for name, flight in never.items():
        flight |= {channel: other[name][channel] for channel in UNITS["rates"]}
    by = alignment(dataset(never))
    assert (by.angle, dict(by.clocks), by.mirror) == (0.0, {}, "")


@pytest.mark.parametrize("seconds", [1.3, -3.2])
def test_a_far_clock_is_known_to_5_ms_and_is_the_only_name(seconds: float):
    moved = dataset(late(flights(), UNITS["rates"], seconds))
    (error,) = check(moved).of("error")
    assert f"rates {abs(seconds):.2f}" in error.sentence
    values = kinematic_findings(moved).values
    assert values == {"sensors.delay.rates": pytest.approx(seconds, abs=5e-3)}


def accelerometers(matrix: np.ndarray, bias: float = 0.0) -> Dataset:
    """The flights with accelerometers alone that read a matrix (3, 3) times specific force, and a bias of ay."""
    made = flights()
    for flight in made.values():
        flight |= dict(zip(("ax", "ay", "az"), matrix @ np.stack([flight[c] for c in ("ax", "ay", "az")]), strict=True))
        flight["ay"] = flight["ay"] + bias
    return dataset(made)


@pytest.mark.parametrize("degrees", [15, 30, 90])
def test_accelerometers_that_are_turned_alone_are_one_error_and_no_bias(degrees: int):
    turned = accelerometers(rotation(np.radians(degrees) * np.array([0.6, 0.0, 0.8])).T)
    findings = check(turned).findings
    (error,) = [f for f in findings if f.severity == "error"]
    assert f"turned by {degrees}" in error.sentence or f"turned by {degrees - 1}.9" in error.sentence
    assert not any("bias" in f.sentence and f is not error for f in findings if f.severity == "warning")


def test_a_wrong_sign_of_an_accelerometer_is_an_error_and_a_bias_is_a_bias():
    (error,) = check(accelerometers(np.diag([1.0, -1.0, 1.0]))).of("error")
    assert "they read +x -y +z" in error.sentence
    biased = check(accelerometers(np.eye(3), 0.8))
    assert not biased.of("error")
    assert any("0.8" in f.sentence and "a sensor bias" in f.sentence for f in biased.findings)


@pytest.mark.parametrize("unit", ["velocities", "accelerations"])
@pytest.mark.parametrize("seconds", [0.2, -0.3, 0.5, 0.8, -0.64, 1.5, -3.0, 5.0])
def test_the_time_that_is_told_is_right_to_5_ms_or_3_errors(unit: str, seconds: float):
    told = []
    for one in check(dataset(late(flights(), UNITS[unit], seconds))).findings:
        if {*one.channel.split()} <= {*UNITS[unit]}:
            told += re.findall(r"\w+ ([.\d]+) s (late|early) \(± ([.\d]+)\)", one.sentence)
    assert told
    for value, word, error in told:
        assert {"late": 1, "early": -1}[word] * float(value) == pytest.approx(seconds, abs=max(5e-3, 3 * float(error)))


def test_turned_and_late_at_once():
    turn = np.radians(60.0) * np.array([0.0, 0.0, 1.0])
    found = alignment(dataset(late(flights(turn), UNITS["attitude"], 2.0)))
    assert away(found.turn, turn) < 0.5
    assert dict(found.clocks) == {"attitude": pytest.approx(2.0, abs=0.05)}


def test_what_is_aligned_is_as_if_nothing_had_been_wrong():
    turn = np.radians(120.0) * np.array([1.0, 1.0, 1.0]) / np.sqrt(3.0)
    turned = dataset(flights(turn))
    right = without_errors_of_flight(turned.flights["f0"], alignment(turned).errors)
    for channel in ("p", "q", "r", "ax", "az"):
        assert np.abs(right.channels[channel].numpy() - flights()["f0"][channel]).max() < 0.1


def test_rates_of_another_flight_contradict_the_attitude():
    made = flights()
    for name, other in (("f0", "f1"), ("f1", "f0"), ("f2", "f3"), ("f3", "f2")):
        made[name] |= {c: flights()[other][c] for c in "pqr"}
    told = [f.sentence for f in check(dataset(made)).of("error")]
    assert any("contradict each other" in sentence for sentence in told)
    assert not any("too little motion" in f.sentence for f in check(dataset(made)).findings)


@pytest.mark.parametrize("axis", ["lon", "lat", "ped"])
def test_rates_that_are_exchanged_are_one_error_where_an_axis_hardly_moves(axis: str):
    data = with_only(load(shared("flightdata", "uh60-hover")), (f"f321_{axis}", f"dbl_{axis}_p", f"dbl_{axis}_n"))

    def exchanged(f: Flight) -> Flight:
        return Flight(f.name, f.dt, {**f.channels, "p": f.channels["q"], "q": f.channels["p"]})

    examined = check(data.changed(exchanged))
    assert not [f for f in examined.of("warning") if {"phi", "p", "u"} & {*f.channel.split()}]
    (told,) = examined.of("error")
    assert "by the attitude p q r read +q +p +r" in told.sentence


@pytest.mark.parametrize("angle", ["phi", "theta"])
def test_an_angle_of_the_other_sign_is_one_error(angle: str):
    data = load(shared("flightdata", "uh60-hover")).changed(
        lambda f: Flight(f.name, f.dt, {**f.channels, angle: -f.channels[angle]})
    )
    (told,) = check(data).of("error")
    assert told.sentence.startswith(f"{angle} has the wrong sign")


@pytest.mark.parametrize("seed", range(8))
def test_a_turn_is_no_mirror_where_one_axis_does_not_move(seed: int):
    """Motion in the longitudinal plane: the sign of the third axis is that of noise."""
    rng, made = np.random.default_rng(seed), flights()
    turn = rotation(np.radians(30.0) * np.array([0.0, 1.0, 0.0])).T
    for flight in made.values():
        time = flight["time"]
        noise = 0.02 * rng.standard_normal((3, len(time)))
        pitch, speed = 0.2 * np.sin(0.7 * time), np.sin(1.3 * time)
        flight |= {c: 1e-4 * rng.standard_normal(len(time)) for c in ("v", "w", "p", "r", "phi", "psi")}
        flight |= {"theta": pitch, "q": 0.14 * np.cos(0.7 * time), "u": speed}
        force = (
            1.3 * np.cos(1.3 * time) + 9.80665 * np.sin(pitch),
            0.0 * time,
            -flight["q"] * speed - 9.80665 * np.cos(pitch),
        )
        flight |= dict(zip(("ax", "ay", "az"), turn @ np.stack(force) + noise, strict=True))
    found = force_turn(list(dataset(made).flights.values()), 9.80665)
    assert found is not None
    assert np.linalg.det(found.matrix) == pytest.approx(1.0)
    assert np.degrees(np.arccos((np.trace(found.matrix) - 1.0) / 2.0)) == pytest.approx(30.0, abs=1.5)


def level(seed: int, fast: float = 1.0) -> dict[str, np.ndarray]:
    """A flight of pitch and climb that no force along the body's x or y axis makes: it tilts, and gravity pulls."""
    rng, time = np.random.default_rng(seed), 0.01 * np.arange(2001)
    pitch, q = 0.2 / fast * np.sin(fast * time + seed), 0.2 * np.cos(fast * time + seed)
    w, climb = 0.5 * np.sin(1.7 * time + seed), 0.85 * np.cos(1.7 * time + seed)
    u = 0.01 * np.cumsum(-9.80665 * np.sin(pitch) - q * w)
    still = dict.fromkeys(("v", "p", "r", "phi", "psi", "ax", "ay"), 0.0 * time)
    moving = {"u": u, "w": w, "q": q, "theta": pitch, "az": climb - q * u - 9.80665 * np.cos(pitch)}
    noise = {"ax": 0.02, "ay": 0.02, "az": 0.02, "u": 0.01, "v": 0.01, "w": 0.01}
    flown = {c: x + noise.get(c, 1e-3) * rng.standard_normal(2001) for c, x in {**still, **moving}.items()}
    return {"time": time, "lat": 0.1 * np.sin(2.0 * time), "lon": 0.1 * np.cos(1.3 * time), **flown}


@pytest.mark.parametrize("seconds", [-0.25, 1.11, -4.03])
def test_late_accelerometers_are_told_where_level_motion_agrees_without_them(seconds: float):
    made = {f"f{seed}": level(seed) for seed in range(3)}
    assert alignment(dataset(made)).clocks == {}
    (told,) = alignment(dataset(late(made, ("ax", "ay", "az"), seconds))).clocks.items()
    assert told == ("accelerations", pytest.approx(seconds, abs=0.004))


def test_offsets_of_each_flight_are_no_turn_of_the_accelerometers():
    made = {"f0": level(0), "f1": level(1)}
    for flight, offset in zip(made.values(), (0.15, -0.15), strict=True):
        flight |= {"ay": flight["ay"] + offset, "phi": flight["phi"] + offset / 9.80665}  # as turned by half a turn
    assert not check(dataset(made)).of("error")


def test_a_clock_that_is_off_in_all_flights_is_not_told_of_the_fastest_again():
    made = {f"f{seed}": level(seed, 2.2 if seed == 0 else 0.6) for seed in range(5)}
    errors = check(dataset(late(made, ("p", "q", "r"), -0.34))).of("error")
    assert {finding.flight or "" for finding in errors} == {""}


def test_velocities_after_a_reset_are_told_as_a_step_alone():
    """What they are wrong by turns with the body, and contradicts the forces from then on."""
    made = {f"f{seed}": level(seed) for seed in range(4)}
    made["f1"]["w"][900:] += 9.0
    findings = check(dataset(made)).findings
    assert [f for f in findings if f.flight == "f1" and "which no motion makes" in f.sentence]
    assert not [f for f in findings if f.severity == "error"]
