"""Further logs of the kinds that users reported: other protocols, columns, makers and defects than the first ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.importing.signals.boots import boots
from rotorid_torch.importing.signals.streams import Log, Stream
from tests.importing.log_writers import motion, quaternion, write_dataflash, write_ulog
from tests.importing.test_flown import QUAD, clock, commands, copter, floats, gyro, imported, outputs, px4, wired

MOTORS = wired({i: i for i in range(1, 5)})
TIME = clock()
KNOWN = motion(TIME - TIME[0])


def table(file: Path, columns: dict[str, np.ndarray], header: str = "") -> Path:
    text = header or ",".join(columns)
    np.savetxt(file, np.stack([*columns.values()], axis=1), "%.9g", ",", header=text, comments="")
    return file


def plain() -> dict[str, np.ndarray]:
    names = ("p", "q", "r", "phi", "theta", "psi", "motor1", "motor2", "motor3", "motor4")
    return {"time": TIME - TIME[0], **{name: KNOWN[name] for name in names}}


def asked() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    return TIME, floats({f"control[{i}]": KNOWN[f"motor{i + 1}"] for i in range(4)})


def test_outputs_are_those_of_the_group_that_drives_the_motors(tmp_path: Path):
    """Motors on the second group, while servos move on the first."""
    servos = floats({f"output[{i}]": 1500.0 + 200.0 * np.sin(TIME + i) for i in range(16)})
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, servos)}
    topics["actuator_outputs[1]"] = (TIME, outputs(TIME, 1.0, 1999.0, 0.0))
    functions = {f"PWM_AUX_FUNC{i}": 100 + i for i in range(1, 5)} | {"PWM_AUX_TIM0": -4}
    done, channels = px4(tmp_path, topics, functions)
    assert done.channels["motor1"].source == "actuator_outputs[1].output[0]"
    assert np.abs(channels["motor3"] - commands(TIME)[2]).max() < 2e-3


def test_one_shot_by_a_timer(tmp_path: Path):
    functions = {f"PWM_MAIN_FUNC{i}": 100 + i for i in range(1, 5)} | {"PWM_MAIN_TIM0": -1}
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, outputs(TIME, 125.0, 250.0, 112.5))}
    _, channels = px4(tmp_path, topics, functions)
    assert np.abs(channels["motor1"] - commands(TIME)[0]).max() < 2e-3


@pytest.mark.parametrize("start", [20.0, 5.0, 3.0])
@pytest.mark.parametrize("kind", ["csv", "bin", "npz"])
def test_two_boots_are_two_flights(kind: str, start: float, tmp_path: Path):
    file, later = tmp_path / f"log.{kind}", clock(start=start)
    if kind == "bin":
        parts = [
            write_dataflash(file, copter(t, 1000 + 1000 * commands(t)), MOTORS).read_bytes() for t in (TIME, later)
        ]
        file.write_bytes(b"".join(parts))
    else:
        first, second = plain() | {"time": TIME}, plain() | {"time": later}
        both = {name: np.concatenate([first[name], second[name]]) for name in first}
        _ = table(file, both) if kind == "csv" else np.savez(file, **both)
    done = rotorid.import_log(file, tmp_path / "set")
    assert [seconds for seconds, _ in done.flights.values()] == pytest.approx([11.99, 11.99], abs=0.02)
    assert any("2 boots, each a flight of its own" in told for told in done.warnings)
    for flight in rotorid.load(done.folder).flights.values():
        assert np.abs(flight.channels["p"].numpy() - KNOWN["p"][: flight.samples])[5:-5].max() < 1e-3


def test_one_topic_whose_clock_begins_again_makes_no_boots(tmp_path: Path):
    topics = copter(TIME, 1000.0 + 1000.0 * commands(TIME))
    again = np.where(TIME < 26.0, TIME, TIME - 6.0)
    topics["BAT"] = (again, floats({"Volt": 16.0 + 0.1 * np.sin(TIME)}))
    done = rotorid.import_log(write_dataflash(tmp_path / "t.bin", topics, MOTORS), tmp_path / "set")
    assert len(done.flights) == 1


def zero_attitude(kind: str, file: Path) -> tuple[Path, str]:
    """A log whose first attitude holds nothing, and where the next one is."""
    angles = {"phi": KNOWN["phi"], "theta": KNOWN["theta"], "psi": KNOWN["psi"]}
    q = quaternion(**angles)
    turned = floats({f"q[{i}]": q[i] for i in range(4)})
    if kind == "ArduPilot":
        topics = copter(TIME, 1000.0 + 1000.0 * commands(TIME))
        good = topics.pop("ATT")
        topics |= {"ATT": (TIME, {n: 0.0 * v for n, v in good[1].items()}), "AHR2": good}
        return write_dataflash(file.with_suffix(".bin"), topics, MOTORS), "AHR2.Roll"
    empty = np.nan if kind == "not a number" else 0.0
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_motors": asked(), "estimator_attitude": (TIME, turned)}
    topics["vehicle_attitude"] = (TIME, {n: np.full_like(v, empty) for n, v in turned.items()})
    return write_ulog(file.with_suffix(".ulg"), topics, QUAD), "estimator_attitude.q"


@pytest.mark.parametrize("kind", ["ArduPilot", "not a number", "all zero"])
def test_attitudes_are_chosen_by_content(kind: str, tmp_path: Path):
    file, source = zero_attitude(kind, tmp_path / "log")
    done, channels = imported(file, tmp_path)
    assert done.channels["phi"].source == source
    assert any("left: all zero or not a number" in told for told in done.warnings)
    assert np.abs(channels["phi"] - KNOWN["phi"])[5:-5].max() < 2e-3


def test_channels_without_data_say_why(tmp_path: Path):
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_motors": asked()}
    topics["vehicle_attitude"] = (TIME, floats({f"q[{i}]": 0.0 * TIME for i in range(4)}))
    (sentence,) = [told for told in px4(tmp_path, topics)[0].warnings if "no data: " in told]
    assert "phi theta psi (vehicle_attitude.q[0] left: all zero or not a number)" in sentence
    assert "ax ay az (no vehicle_acceleration, sensor_combined, sensor_accel, IMU)" in sentence
    assert "omega1 omega2 ... (no esc_status)" in sentence


def test_a_channel_that_ends_before_a_flight_begins_is_told(tmp_path: Path):
    rows = plain()
    rows["time"] = np.where(rows["time"] < 6.0, rows["time"], rows["time"] + 20.0)
    rows["u"] = np.where(rows["time"] < 6.0, 1.0 + np.sin(rows["time"]), np.nan)
    done = rotorid.import_log(table(tmp_path / "t.csv", rows), tmp_path / "set")
    assert any("u left out of the flight at 26 s: no samples in it" in told for told in done.warnings)


@pytest.mark.parametrize("kind", ["csv", "bin"])
def test_late_samples_of_other_formats_are_sorted_in(kind: str, tmp_path: Path):
    order = np.arange(len(TIME))
    for k in range(20, len(TIME) - 5, 37):
        order[[k, k + 1]] = order[[k + 1, k]]
    if kind == "csv":
        file = table(tmp_path / "t.csv", {name: values[order] for name, values in plain().items()})
    else:
        topics = copter(TIME, 1000.0 + 1000.0 * commands(TIME))
        topics["IMU"] = (TIME[order], {name: values[order] for name, values in topics["IMU"][1].items()})
        file = write_dataflash(tmp_path / "t.bin", topics, MOTORS)
    done, channels = imported(file, tmp_path)
    assert any("were sorted in" in told for told in done.warnings)
    assert np.abs(channels["p"] - KNOWN["p"])[5:-5].max() < 1e-3


@pytest.mark.parametrize(("topic", "column"), [("BAT", "I"), ("CURR", "C"), ("BAT", "Curr")])
def test_a_current_numbers_no_instances(topic: str, column: str, tmp_path: Path):
    topics = copter(TIME, 1000.0 + 1000.0 * commands(TIME))
    supply = floats({"Volt": 16.0 - 0.01 * (TIME - 20.0), column: 3.0 + 3.0 * np.sin(TIME)})
    done, _ = imported(write_dataflash(tmp_path / "t.bin", topics | {topic: (TIME, supply)}, MOTORS), tmp_path)
    assert done.channels["voltage"].source == f"{topic}.Volt"
    assert done.channels["voltage"].hertz == pytest.approx(100.0, rel=0.01)


UNITS = {
    "all": ("s", "deg/s", "deg/s", "deg/s", "deg", "deg", "deg", "%", "%", "%", "%"),
    "spelt out": ("sec", "degrees/sec", "°/s", "deg/s", "degrees", "°", "deg", "%", "%", "%", "%"),
    "in brackets": ("(s)", "(deg/s)", "(deg/s)", "(deg/s)", "(deg)", "(deg)", "(deg)", "(%)", "(%)", "(%)", "(%)"),
}


@pytest.mark.parametrize("before", ["", "Flight 7\n"])
@pytest.mark.parametrize("units", UNITS)
def test_a_row_of_units_is_believed(units: str, before: str, tmp_path: Path):
    rows = plain()
    for name in rows:
        rows[name] = rows[name] * (1.0 if name == "time" else 100.0 if "motor" in name else 180.0 / np.pi)
    file = table(tmp_path / "t.csv", rows, f"{before}{','.join(rows)}\n{','.join(UNITS[units])}")
    _, channels = imported(file, tmp_path)
    for name in ("p", "q", "r", "phi", "motor1", "motor4"):
        assert np.abs(channels[name] - KNOWN[name])[5:-5].max() < 1e-3


@pytest.mark.parametrize("first", ["motor[0]", "rcCommand[0]"])
def test_a_blackbox_without_a_count_of_loops(first: str, tmp_path: Path):
    rows = {"time (us)": 1e6 * TIME, first: 1200.0 + 100.0 * np.sin(TIME)}
    rows |= {f"gyroADC[{i}]": np.degrees(KNOWN[n]) * (1 if i == 0 else -1) for i, n in enumerate("pqr")}
    rows |= {f"motor[{i}]": 1000.0 + 1000.0 * KNOWN[f"motor{i + 1}"] for i in range(4)}
    _, channels = imported(table(tmp_path / "t.csv", rows), tmp_path)
    assert np.abs(channels["q"] - KNOWN["q"])[5:-5].max() < 1e-3
    assert np.abs(channels["motor2"] - KNOWN["motor2"])[5:-5].max() < 1e-3


@pytest.mark.parametrize("settings", [{"H_CYC_MAX": 2500, "FRAME_CLASS": 1}, {"H_RSC_MODE": 2, "FRAME_CLASS": 0}])
def test_any_setting_of_a_swashplate_makes_a_helicopter(settings: dict, tmp_path: Path):
    asked_of = commands(TIME) - 0.5
    rates = floats({n: asked_of[i] for i, n in enumerate(("ROut", "POut", "YOut", "AOut"))})
    topics = copter(TIME, 1000.0 + 1000.0 * commands(TIME)) | {"RATE": (TIME, rates)}
    done, _ = imported(write_dataflash(tmp_path / "t.bin", topics, settings), tmp_path)
    assert done.kind == "helicopter"


@pytest.mark.parametrize("first", ["fast", "slow"])
def test_boots_are_those_of_most_samples_whatever_the_order(first: str):
    whole, restarted = np.arange(0.0, 20.0, 0.1), np.tile(np.arange(0.0, 10.0, 0.01), 2)
    streams = {("slow", 0): Stream(whole, {}), ("fast", 0): Stream(restarted, {})}
    order = sorted(streams, key=lambda place: place[0] != first)
    log = Log(Path("log"), "", "", {place: streams[place] for place in order}, {})
    assert [[*part.streams] for part in boots(log)] == [[("fast", 0)], [("fast", 0)]]
