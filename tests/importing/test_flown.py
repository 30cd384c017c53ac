"""Import reads what flew: ranges by protocol, motors by function, the core in use, resets, flips, late samples."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from rotorid_torch.importing.logs import Imported
from tests.importing.log_writers import motion, px4_topics, quaternion, write_dataflash, write_ulog

QUAD = {"MAV_TYPE": 2}
Columns = dict[str, np.ndarray]


def clock(seconds: float = 12.0, hertz: float = 100.0, start: float = 20.0) -> np.ndarray:
    return start + np.arange(0.0, seconds, 1.0 / hertz)


def floats(columns: Mapping[str, np.ndarray]) -> Columns:
    return {name: np.asarray(values, "<f4") for name, values in columns.items()}


def gyro(time: np.ndarray) -> tuple[np.ndarray, Columns]:
    m = motion(time - time[0])
    return time, floats({f"xyz[{i}]": m[n] for i, n in enumerate("pqr")})


def commands(time: np.ndarray) -> np.ndarray:
    """Commands (4, T) of four motors, none for the first two seconds."""
    m = motion(time - time[0])
    flown = np.stack([m[f"motor{i}"] for i in range(1, 5)])
    return np.where(time - time[0] < 2.0, 0.0, flown)


def outputs(time: np.ndarray, low: float, high: float, rest: float, order: tuple[int, ...] = (0, 1, 2, 3)) -> Columns:
    """Outputs that stand for the commands of motors in this order."""
    asked = commands(time)
    values = np.where(asked == 0.0, rest, np.round(low + (high - low) * asked, 3))
    columns = {f"output[{i}]": values[motor] for i, motor in enumerate(order)}
    return floats(columns | {f"output[{i}]": 0.0 * time for i in range(len(order), 16)})


def imported(file: Path, where: Path) -> tuple[Imported, Columns]:
    """The import and the channels of its first flight."""
    done = rotorid.import_log(file, where / "set")
    flight = rotorid.load(done.folder).flights[next(iter(done.flights))]
    return done, {name: values.numpy() for name, values in flight.channels.items()}


def px4(where: Path, topics: Mapping[str, tuple], parameters: Mapping[str, float] | None = None):
    return imported(write_ulog(where / "log.ulg", topics, QUAD | dict(parameters or {})), where)


PROTOCOLS = {
    "DShot by DSHOT_CONFIG": ({"DSHOT_CONFIG": 600}, (1.0, 1999.0, 0.0)),
    "DShot by a timer": ({"PWM_MAIN_TIM0": -3, **{f"PWM_MAIN_FUNC{i}": 100 + i for i in range(1, 5)}}, (1, 1999, 0)),
    "UAVCAN": ({"UAVCAN_ENABLE": 3, "DSHOT_CONFIG": 0}, (1.0, 8191.0, 0.0)),
    "UAVCAN by functions": ({f"UAVCAN_EC_FUNC{i}": 100 + i for i in range(1, 5)}, (1.0, 8191.0, 0.0)),
    "OneShot125": ({"PWM_RATE": 0, "PWM_MIN": 1000, "PWM_MAX": 2000}, (125.0, 250.0, 112.5)),
    "pulses by group": ({"PWM_MAIN_MIN": 1075, "PWM_MAIN_MAX": 1950}, (1075.0, 1950.0, 900.0)),
    "pulses by output": (
        {
            **{f"PWM_MAIN_FUNC{i}": 100 + i for i in range(1, 5)},
            **{f"PWM_MAIN_MIN{i}": 1100 for i in range(1, 5)},
            **{f"PWM_MAIN_MAX{i}": 1900 for i in range(1, 5)},
        },
        (1100.0, 1900.0, 1000.0),
    ),
    "simulated": ({}, (0.0, 1.0, 0.0)),
}


@pytest.mark.parametrize("name", PROTOCOLS)
def test_outputs_have_the_range_of_their_protocol(name: str, tmp_path: Path):
    parameters, (low, high, rest) = PROTOCOLS[name]
    time = clock()
    topics = {"vehicle_angular_velocity": gyro(time), "actuator_outputs": (time, outputs(time, low, high, rest))}
    _, channels = px4(tmp_path, topics, parameters)
    asked = commands(time)
    for i in range(4):
        assert np.abs(channels[f"motor{i + 1}"] - asked[i]).max() < 2e-3


@pytest.mark.parametrize(
    ("parameters", "span", "told"),
    [
        ({"DSHOT_CONFIG": 600}, (1.0, 8191.0), r"runs from 0 to 5734; expected 1 to 1999 \(DShot, by DSHOT_CONFIG\)"),
        ({}, (1.0, 1999.0), r"runs from 0 to 1399.*; expected 1000 to 2000"),
        ({}, (0.0, 100.0), r"runs from 0 to 70; expected 1000 to 2000"),
        ({"PWM_MIN": 1400, "PWM_MAX": 1600}, (1000.0, 2000.0), "expected 1400 to 1600 .PWM_MIN, PWM_MAX"),
    ],
)
def test_outputs_beyond_the_range_of_their_settings_are_refused(parameters, span, told: str, tmp_path: Path):
    time = clock()
    low, high = span
    topics = {"vehicle_angular_velocity": gyro(time), "actuator_outputs": (time, outputs(time, low, high, 0.0))}
    with pytest.raises(InputError, match=told):
        px4(tmp_path, topics, parameters)


def copter(time: np.ndarray, pulses: np.ndarray, first: int = 1) -> dict[str, tuple]:
    """Messages of an ArduPilot multirotor with the pulses (n, T) of its outputs from `first` on."""
    m = motion(time - time[0])
    forces = {"AccX": 0.1 * np.sin(time), "AccY": 0.1 * np.cos(time), "AccZ": -9.8 + 0.1 * np.sin(time)}
    imu = {f"Gyr{a}": m[n] for a, n in zip("XYZ", "pqr", strict=True)} | forces
    servos = {f"C{i}": np.full(len(time), 1500, "<u2") for i in range(1, 15)}
    servos |= {f"C{first + i}": np.round(row).astype("<u2") for i, row in enumerate(pulses)}
    angles = {n: np.degrees(m[k]) for n, k in (("Roll", "phi"), ("Pitch", "theta"), ("Yaw", "psi"))}
    return {"IMU": (time, floats(imu)), "RCOU": (time, servos), "ATT": (time, floats(angles))}


def wired(functions: Mapping[int, int]) -> dict[str, float]:
    return {f"SERVO{output}_FUNCTION": 32 + motor for output, motor in functions.items()}


RANGES = {
    "settings": ({"MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900}, (1100.0, 1900.0)),
    "DShot is logged as 1000 to 2000": ({"MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1900, "MOT_PWM_TYPE": 6}, (1000, 2000)),
    "OneShot125": ({"MOT_PWM_TYPE": 2}, (125.0, 250.0)),
    "the throttle's": ({"RC3_MIN": 1050, "RC3_MAX": 1950}, (1050.0, 1950.0)),
    "brushed": ({"MOT_PWM_TYPE": 3, "MOT_PWM_MIN": 0, "MOT_PWM_MAX": 16000}, (0.0, 16000.0)),
}


@pytest.mark.parametrize("name", RANGES)
def test_pulses_of_ardupilot_have_the_range_of_its_settings(name: str, tmp_path: Path):
    parameters, (low, high) = RANGES[name]
    time, asked = clock(), commands(clock())
    topics = copter(time, low + (high - low) * asked)
    file = write_dataflash(tmp_path / "log.bin", topics, wired({i: i for i in range(1, 5)}) | parameters)
    _, channels = imported(file, tmp_path)
    assert np.abs(channels["motor2"] - asked[1]).max() < (6e-3 if high < 300 else 1e-3)
    bad = write_dataflash(tmp_path / "bad.bin", copter(time, 1.0 + 1998.0 * asked), wired({i: i for i in range(1, 5)}))
    with pytest.raises(InputError, match=r"RCOU\.C1 \(motor1\): runs from 1 to 1\d\d\d"):
        rotorid.import_log(bad, tmp_path / "bad")


def test_a_map_in_the_wrong_range_is_refused_and_not_clipped(tmp_path: Path):
    time, m = np.arange(0.0, 8.0, 0.01), motion(np.arange(0.0, 8.0, 0.01))
    table = np.stack([time, m["p"], 48.0 + 1999.0 * m["motor1"]], -1)
    np.savetxt(tmp_path / "t.csv", table, "%.6f", ",", header="time,p,raw", comments="")
    given = {"kind": "multirotor", "channels": {"p": "p", "motor1": {"field": "raw", "unit": "us"}}}
    with pytest.raises(InputError, match=r"runs from .*beyond what stands for commands 0 to 1"):
        rotorid.import_log(tmp_path / "t.csv", tmp_path / "set", given)


def speeds(time: np.ndarray, order: tuple[int, ...], functions: bool = True) -> Columns:
    """Messages of speed controllers whose motors are in this order."""
    columns: Columns = {}
    for i, motor in enumerate(order):
        rpm = 10_000.0 * np.sqrt(0.2 + commands(time)[motor - 1])
        columns[f"esc[{i}].esc_rpm"] = rpm.astype("<i4")
        columns[f"esc[{i}].actuator_function"] = np.full(len(time), (100 + motor) * functions, "<u1")
    return columns


@pytest.mark.parametrize("functions", [True, False])
def test_rotor_speeds_belong_to_the_motors_of_their_functions(functions: bool, tmp_path: Path):
    time, order = clock(), (4, 1, 2, 3)
    topics = {"vehicle_angular_velocity": gyro(time), "esc_status": (time, speeds(time, order, functions))}
    topics["actuator_motors"] = (time, floats({f"control[{i}]": row for i, row in enumerate(commands(time))}))
    done, channels = px4(tmp_path, topics, {f"PWM_MAIN_FUNC{i + 1}": 100 + m for i, m in enumerate(order)})
    for i in range(1, 5):
        true = 10_000.0 * np.sqrt(0.2 + commands(time)[i - 1]) * np.pi / 30.0
        assert np.abs(channels[f"omega{i}"] - true).max() < 0.2
    assert done.channels["omega1"].source == "esc_status.esc[1].esc_rpm"
    assert "esc[0] is motor 4" in done.channels["omega1"].reason


def test_outputs_belong_to_the_motors_of_their_functions(tmp_path: Path):
    time, order = clock(), (3, 0, 1, 2)
    topics = {"vehicle_angular_velocity": gyro(time)}
    topics["actuator_outputs"] = (time, outputs(time, 1000.0, 2000.0, 900.0, order))
    _, channels = px4(tmp_path, topics, {f"PWM_AUX_FUNC{i + 1}": 101 + motor for i, motor in enumerate(order)})
    assert all(np.abs(channels[f"motor{i + 1}"] - commands(time)[i]).max() < 1e-3 for i in range(4))


@pytest.mark.parametrize(
    ("motors", "instances"), [({1: 3, 2: 1, 3: 4, 4: 2}, (0, 1, 2, 3)), ({9: 1, 10: 2, 11: 3, 12: 4}, (0, 1, 2, 3))]
)
def test_ardupilot_telemetry_belongs_to_the_output_that_it_is_on(motors: dict, instances: tuple, tmp_path: Path):
    time, first = clock(), min(motors)
    pulses = np.stack([1000.0 + 1000.0 * commands(time)[motor - 1] for motor in motors.values()])
    topics = copter(time, pulses, first)
    each = [np.full(len(time), i, "<u1") for i in instances]
    rpm = [5000.0 * np.sqrt(0.2 + commands(time)[motor - 1]) for motor in motors.values()]
    rows = np.argsort(np.concatenate([time + 1e-5 * i for i in instances]), kind="stable")
    together = {"Instance": np.concatenate(each)[rows], "RPM": np.concatenate(rpm)[rows].astype("<f4")}
    topics["ESC"] = (np.concatenate([time] * 4)[rows], together)
    _, channels = imported(write_dataflash(tmp_path / "log.bin", topics, wired(motors)), tmp_path)
    for i in range(1, 5):
        assert np.abs(channels[f"motor{i}"] - commands(time)[i - 1]).max() < 1e-3
        true = 5000.0 * np.sqrt(0.2 + commands(time)[i - 1]) * np.pi / 30.0
        assert np.abs(channels[f"omega{i}"] - true).max() < 0.2


def test_speeds_that_are_known_better_than_commands_are_the_controls(tmp_path: Path):
    """ArduCopter writes RCOU at 10 Hz; telemetry of DShot comes at 100 Hz."""
    time = clock(hertz=100.0)
    topics = copter(time, 1000.0 + 1000.0 * commands(time))
    stamps, pulses = topics["RCOU"]
    topics["RCOU"] = (stamps[::10], {name: values[::10] for name, values in pulses.items()})
    topics["ESC"] = (
        np.repeat(time, 4),
        {
            "Instance": np.tile(np.arange(4, dtype="<u1"), len(time)),
            "RPM": (5000.0 * np.sqrt(0.2 + commands(time))).T.ravel().astype("<f4"),
        },
    )
    wires = wired({i: i for i in range(1, 5)})
    file = write_dataflash(tmp_path / "log.bin", topics, wires)
    done, _ = imported(file, tmp_path)
    recorded = [name for name, found in done.channels.items() if found.source]
    assert [name for name in recorded if name.startswith(("motor", "omega"))] == [f"omega{i}" for i in range(1, 5)]
    assert any("motor4 left out: recorded less often than the rotors' speeds" in said for said in done.warnings)
    assert rotorid.load(done.folder).controls == ("motor1", "motor2", "motor3", "motor4")


def test_the_faster_source_of_commands_is_taken_and_told(tmp_path: Path):
    fast, slow = clock(hertz=400.0), clock(hertz=10.0)
    topics = {"vehicle_angular_velocity": gyro(fast)}
    topics["actuator_motors"] = (slow, floats({f"control[{i}]": row for i, row in enumerate(commands(slow))}))
    topics["actuator_outputs"] = (fast, outputs(fast, 1000.0, 2000.0, 900.0))
    done, _ = px4(tmp_path, topics)
    assert done.channels["motor1"].source == "actuator_outputs.output[0]"
    assert done.channels["motor1"].reason == "actuator_motors left: 10 Hz against 400 Hz"


# resets


def with_reset(at: float, psi: float, sizes: bool, place: tuple[float, float] = (12.0, -7.0)) -> dict[str, tuple]:
    """Topics of a quadrotor whose estimator is reset at a time: heading, position and velocity step."""
    time = clock(20.0, start=1.0)
    m, later = motion(time - 1.0), (time >= at).astype(float)
    turned = quaternion(m["phi"], m["theta"], m["psi"] + psi * later)
    half = 0.5 * psi * sizes
    counts = {"quat_reset_counter": later.astype("<u1")}
    delta = {f"delta_q_reset[{i}]": np.full(len(time), v) for i, v in enumerate((np.cos(half), 0.0, 0.0, np.sin(half)))}
    attitude = floats({f"q[{i}]": turned[i] for i in range(4)} | delta) | counts
    state = {
        "x": np.sin(time) + place[0] * later,
        "y": np.cos(time) + place[1] * later,
        "z": -10.0 + 0.1 * np.sin(time),
    }
    state |= {"vx": np.cos(time) + 1.5 * later, "vy": -np.sin(time), "vz": 0.1 * np.cos(time)}
    if sizes:
        logged = (("delta_xy[0]", place[0]), ("delta_xy[1]", place[1]), ("delta_vxy[0]", 1.5), ("delta_vxy[1]", 0.0))
        state |= {name: np.full(len(time), value) for name, value in logged}
    counters = {f"{name}_reset_counter": later.astype("<u1") for name in ("xy", "vxy")}
    motors = floats({f"control[{i}]": m[f"motor{i + 1}"] for i in range(4)})
    topics = {"vehicle_angular_velocity": gyro(time), "vehicle_attitude": (time, attitude)}
    return topics | {"vehicle_local_position": (time, floats(state) | counters), "actuator_motors": (time, motors)}


def test_a_reset_without_its_size_ends_the_flight(tmp_path: Path):
    done, channels = px4(tmp_path, with_reset(8.0, 1.55, sizes=False))
    assert [round(seconds, 1) for seconds, _ in done.flights.values()] == [7.0, 13.0]
    assert any("at 8.00 s: psi by +1.55" in told and "cut there" in told for told in done.warnings)
    assert np.abs(np.diff(channels["psi"])).max() < 0.02
    assert np.abs(np.diff(channels["north"])).max() < 0.02


@pytest.mark.parametrize("psi", [1.55, -3.0, 0.3])
def test_a_reset_whose_size_is_logged_is_undone(psi: float, tmp_path: Path):
    done, channels = px4(tmp_path, with_reset(8.0, psi, sizes=True))
    assert len(done.flights) == 1
    assert any("undone" in told for told in done.warnings)
    assert all(np.abs(np.diff(channels[n])).max() < 0.05 for n in ("psi", "phi", "north", "east", "u", "v"))
    m = motion(channels["time"])
    left = channels["psi"] - m["psi"] - psi
    assert np.abs(left - 2.0 * np.pi * np.round(left / (2.0 * np.pi))).max() < 1e-3


def test_a_counter_that_goes_on_without_a_step_changes_nothing(tmp_path: Path):
    done, _ = px4(tmp_path, with_reset(8.0, 0.0, sizes=False, place=(0.0, 0.0)) | {})
    assert not any("psi" in told for told in done.warnings)


def test_a_heading_whose_reset_only_the_position_counts_is_turned_back(tmp_path: Path):
    topics = with_reset(8.0, 1.2, sizes=False, place=(0.0, 0.0))
    (time, attitude), (_, place) = topics["vehicle_attitude"], topics["vehicle_local_position"]
    later = (time >= 8.0).astype("<u1")
    place |= {"heading_reset_counter": later, "delta_heading": 1.2 * later.astype("<f4")}
    place["vx"] = np.cos(time).astype("<f4")
    topics["vehicle_attitude"] = (time, {name: v for name, v in attitude.items() if name.startswith("q[")})
    done, channels = px4(tmp_path, topics)
    assert any("psi by +1.2 in one step, undone" in told for told in done.warnings)
    assert np.abs(np.diff(channels["psi"])).max() < 0.05


def test_a_yaw_reset_of_ardupilot_ends_the_flight(tmp_path: Path):
    time = clock(20.0)
    topics = copter(time, 1000.0 + 1000.0 * commands(time))
    topics["ATT"][1]["Yaw"] = ((topics["ATT"][1]["Yaw"] + 70.0 * (time >= 30.0)) % 360.0).astype("<f4")
    topics["EV"] = (np.array([21.0, 30.2]), {"Id": np.array([10, 62], "<u1")})
    done, channels = imported(
        write_dataflash(tmp_path / "log.bin", topics, wired({i: i for i in range(1, 5)})), tmp_path
    )
    assert [round(seconds) for seconds, _ in done.flights.values()] == [10, 10]
    assert np.abs(np.diff(channels["psi"])).max() < 0.02


# cores, sensors, instances


def two_cores(time: np.ndarray, topic: str = "XKF1") -> dict[str, tuple]:
    """Messages of a copter with two cores and two sensors; core 0 runs away, gyro 0 is 0.5 rad/s off."""
    topics = copter(time, 1000.0 + 1000.0 * commands(time))
    sensed, columns = topics["IMU"]
    m = motion(time - time[0])
    state = {n: m[k] for n, k in (("VN", "vn"), ("VE", "ve"), ("VD", "vd"))} | {
        "PN": 0.1 * time,
        "PE": time,
        "PD": time,
    }
    rows = np.arange(2 * len(time))
    twice = np.repeat(time, 2)
    core = (rows % 2).astype("<u1")
    both = {name: np.repeat(values, 2).astype("<f4") for name, values in state.items()}
    both["VN"] = (both["VN"] + 0.5 * np.maximum(twice - 26.0, 0.0) * (core == 0)).astype("<f4")
    topics["XKF1"] = (twice, {"C": core, **both})
    topics["XKF4"] = (twice, {"C": core, "PI": (twice > 27.0).astype("<u1")})
    imus = {name: np.repeat(values, 2) for name, values in columns.items()}
    imus["GyrX"] = (imus["GyrX"] + 0.5 * (core == 0)).astype("<f4")
    topics["IMU"] = (np.repeat(sensed, 2), {"I": core, **imus})
    return topics


def test_the_primary_core_and_its_sensor_are_taken(tmp_path: Path):
    time = clock()
    file = write_dataflash(tmp_path / "log.bin", two_cores(time), wired({i: i for i in range(1, 5)}))
    done, channels = imported(file, tmp_path)
    assert done.channels["north"].source == "XKF1[1].PN"
    assert done.channels["north"].reason == "core 1, primary at last by XKF4.PI; core 0 left"
    assert done.channels["p"].source == "IMU[1].GyrX"
    assert np.abs(channels["p"] - motion(channels["time"])["p"]).max() < 1e-3


@pytest.mark.parametrize("rows", [0, 40])
def test_instances_that_are_declared_after_the_first_samples(rows: int, tmp_path: Path):
    """An autopilot writes units (FMTU) once all formats are out, and samples in between."""
    units = {"IMU": "s#EEEooo", "XKF1": "s#nnnmmm", "XKF4": "s#-"}
    settings = wired({i: i for i in range(1, 5)})
    file = write_dataflash(tmp_path / "log.bin", two_cores(clock()), settings, units=units)
    data, size = file.read_bytes(), 3 + 8 + 1 + 32
    at, samples = data.find(b"\xa3\x95\x04"), rows * (3 + 8 + 1 + 24)
    declared, after = data[at : at + 3 * size], data[at + 3 * size :]
    assert after[samples : samples + 2] == b"\xa3\x95"
    file.write_bytes(data[:at] + after[:samples] + declared + after[samples:])
    done, channels = imported(file, tmp_path)
    assert done.channels["p"].source == "IMU[1].GyrX"
    assert np.abs(channels["p"] - motion(channels["time"])["p"])[5:-5].max() < 1e-3


def test_a_sensor_out_of_use_is_left(tmp_path: Path):
    time = clock()
    topics = two_cores(time)
    topics.pop("XKF4")
    functions = wired({i: i for i in range(1, 5)})
    done, _ = imported(write_dataflash(tmp_path / "log.bin", topics, functions | {"INS_USE": 0}), tmp_path)
    assert done.channels["p"].source == "IMU[1].GyrX"
    assert "0 left (INS_USE)" in done.channels["p"].reason


def test_older_logs_have_topics_for_the_second_core_and_sensor(tmp_path: Path):
    time = clock()
    topics = copter(time, 1000.0 + 1000.0 * commands(time))
    state = floats({n: 0.1 * np.sin(time + i) for i, n in enumerate(("VN", "VE", "VD", "PN", "PE", "PD"))})
    topics |= {"IMU2": topics["IMU"], "NKF1": (time, state), "NKF6": (time, state)}
    topics["NKF4"] = (time, {"PI": np.ones(len(time), "<u1")})
    done, _ = imported(write_dataflash(tmp_path / "log.bin", topics, wired({i: i for i in range(1, 5)})), tmp_path)
    assert done.channels["p"].source == "IMU2.GyrX"
    assert done.channels["north"].source == "NKF6.PN"


def test_the_estimator_and_sensor_that_px4_selected(tmp_path: Path):
    time = clock()
    m = motion(time - time[0])
    turned = quaternion(m["phi"], m["theta"], m["psi"])
    good = floats({f"q[{i}]": turned[i] for i in range(4)})
    bad = floats({f"q[{i}]": turned[i] + 0.2 * np.sin(time) for i in range(4)})
    rates = floats(dict(zip("xyz", (m["p"], m["q"], m["r"]), strict=True)))
    topics = {
        f"sensor_gyro{'[1]' * i}": (time, {"device_id": np.full(len(time), 7 + i, "<i4"), **rates}) for i in (0, 1)
    }
    topics |= {"estimator_attitude": (time, bad), "estimator_attitude[1]": (time, good)}
    topics["sensor_selection"] = (time[:5], {"gyro_device_id": np.full(5, 8, "<i4")})
    topics["estimator_selector_status"] = (time[:5], {"primary_instance": np.ones(5, "<u1")})
    topics["actuator_motors"] = (time, floats({f"control[{i}]": row for i, row in enumerate(commands(time))}))
    done, channels = px4(tmp_path, topics)
    assert done.channels["p"].source == "sensor_gyro[1].x"
    assert "by sensor_selection" in done.channels["p"].reason
    assert done.channels["phi"].source == "estimator_attitude[1].q"
    assert np.abs(channels["phi"] - m["phi"]).max() < 1e-3


def test_a_column_numbers_instances_only_where_the_format_says_so(tmp_path: Path):
    time = clock()
    topics = copter(time, 1000.0 + 1000.0 * commands(time))
    count = {"I": (10 + time % 5).astype("<u1"), "Volt": (16.0 - 0.1 * (time - 20.0)).astype("<f4")}
    topics["BAT"] = (time, count)
    functions = wired({i: i for i in range(1, 5)})
    marked = write_dataflash(tmp_path / "log.bin", topics, functions, units={"IMU": "s------"})
    done, channels = imported(marked, tmp_path)
    assert done.channels["voltage"].hertz == pytest.approx(100.0, rel=0.01)
    assert done.channels["voltage"].source == "BAT.Volt"
    assert np.abs(channels["voltage"] - (16.0 - 0.1 * channels["time"])).max() < 1e-3
    numbered = {"A": (np.arange(len(time)) % 2).astype("<u1"), "Volt": count["Volt"]}
    topics["BAT"] = (time, numbered)
    marked = write_dataflash(tmp_path / "two.bin", topics, functions, units={"BAT": "s#v"})
    done = rotorid.import_log(marked, tmp_path / "two")
    assert done.channels["voltage"].hertz == pytest.approx(50.0, rel=0.01)


# kinds of vehicle


def sticks(time: np.ndarray) -> Columns:
    asked = commands(time) - 0.5
    return floats({n: asked[i] for i, n in enumerate(("ROut", "POut", "YOut", "AOut"))})


@pytest.mark.parametrize(
    ("parameters", "about"),
    [
        ({"H_SWASH_TYPE": 0, "H_COL_MIN": 1250}, "APM:Copter V3.4.6"),
        ({"H_SW_TYPE": 1}, "ArduCopter V4.0"),
        ({}, "APM:Copter V3.3; Frame: HELI"),
        ({"FRAME_CLASS": 13, "SERVO1_FUNCTION": 33}, "ArduCopter V4.5.7; Frame: HELI_QUAD"),
        ({"FRAME_CLASS": 11}, ""),
    ],
)
def test_helicopters_by_all_evidence(parameters: dict, about: str, tmp_path: Path):
    time = clock()
    topics = copter(time, 1000.0 + 1000.0 * commands(time)) | {"RATE": (time, sticks(time))}
    done, _ = imported(write_dataflash(tmp_path / "log.bin", topics, parameters, about), tmp_path)
    assert (done.kind, done.channels["lon"].source) == ("helicopter", "RATE.POut")


@pytest.mark.parametrize("parameters", [{"MAV_TYPE": 4}, {"CA_AIRFRAME": 11, "MAV_TYPE": 2}, {"SYS_AUTOSTART": 16001}])
def test_helicopters_of_px4(parameters: dict, tmp_path: Path):
    time = clock()
    asked = floats({f"control[{i}]": commands(time)[i] - 0.5 for i in range(4)})
    topics = {"vehicle_angular_velocity": gyro(time), "actuator_controls_0": (time, asked)}
    done = rotorid.import_log(write_ulog(tmp_path / "log.ulg", topics, parameters), tmp_path / "set")
    assert (done.kind, sorted(done.units)) == ("helicopter", ["col", "lat", "lon", "ped"])


def test_blade_angles_and_rotor_speed_of_a_helicopter(tmp_path: Path):
    time = clock()
    topics = copter(time, 1000.0 + 1000.0 * commands(time)) | {"RATE": (time, sticks(time))}
    asked = commands(time) - 0.5
    topics["SWSH"] = (
        time,
        floats({"Col": 8.0 * asked[0], "TCyc": asked[1], "Pit": 5.0 * asked[1], "Rol": 4.0 * asked[2]}),
    )
    topics["RPM"] = (time, floats({"rpm1": 1500.0 + 20.0 * np.sin(time), "rpm2": 0.0 * time}))
    done, channels = imported(write_dataflash(tmp_path / "log.bin", topics, {"FRAME_CLASS": 6}), tmp_path)
    assert (done.units["lon"], done.units["ped"]) == ("rad", "norm")
    assert np.abs(channels["lon"] - np.radians(5.0 * asked[1])).max() < 1e-5
    assert np.abs(channels["omega"] - (1500.0 + 20.0 * np.sin(time)) * np.pi / 30.0).max() < 1e-2
    topics["RPM"] = (time, {"rpm1": topics["RPM"][1]["rpm2"], "rpm2": topics["RPM"][1]["rpm1"]})
    done, second = imported(write_dataflash(tmp_path / "log.bin", topics, {"FRAME_CLASS": 6}), tmp_path)
    assert "RPM.rpm1 left: all zero" in done.channels["omega"].reason
    assert np.abs(second["omega"] - channels["omega"]).max() < 1e-6


# content, flips, late samples


def test_an_attitude_without_content_gives_way_to_the_next(tmp_path: Path):
    time = clock()
    m = motion(time - time[0])
    topics = copter(time, 1000.0 + 1000.0 * commands(time))
    angles = floats({n: np.degrees(m[k]) for n, k in (("Roll", "phi"), ("Pitch", "theta"), ("Yaw", "psi"))})
    for none in (0.0, np.nan):
        topics["ATT"] = (time, {name: np.full(len(time), none, "<f4") for name in angles})
        topics["AHR2"] = (time, angles)
        done, channels = imported(write_dataflash(tmp_path / "log.bin", topics, wired({1: 1, 2: 2})), tmp_path)
        assert done.channels["phi"].source == "AHR2.Roll"
        assert done.channels["phi"].reason == "ATT.Roll left: all zero or not a number"
        assert np.abs(channels["phi"] - m["phi"]).max() < 1e-3


def turning(kind: str, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Attitudes that pass where Euler angles jump: a roll, a loop, a roll on another heading."""
    turn = 2.0 * np.pi * np.clip((time - 26.0013) / 0.8, 0.0, 1.0)
    zero = 0.02 * np.sin(time)
    return {"roll": (turn, zero, zero), "loop": (zero, turn, zero), "heading": (turn, zero, zero + 2.0)}[kind]


@pytest.mark.parametrize("kind", ["roll", "loop", "heading"])
@pytest.mark.parametrize("maker", ["PX4", "ArduPilot"])
def test_flips_are_data(kind: str, maker: str, tmp_path: Path):
    from scipy.spatial.transform import Rotation

    time = clock(hertz=200.0)
    q = quaternion(*turning(kind, time))
    true = Rotation.from_quat(q.T, scalar_first=True)
    if maker == "PX4":
        topics = px4_topics(12.0, 20.0) | {"vehicle_attitude": (time, floats({f"q[{i}]": q[i] for i in range(4)}))}
        _, channels = px4(tmp_path, topics)
    else:
        topics = copter(time, 1000.0 + 1000.0 * commands(time))
        yaw, pitch, roll = true.as_euler("ZYX", degrees=True).T
        topics["ATT"] = (time, floats({"Roll": roll, "Pitch": pitch, "Yaw": yaw % 360.0}))
        _, channels = imported(write_dataflash(tmp_path / "log.bin", topics, wired({1: 1, 2: 2})), tmp_path)
    angles = np.stack([channels[n] for n in ("psi", "theta", "phi")], -1)
    at = np.interp(channels["time"], time - time[0], np.arange(len(time))).round().astype(int)
    known = np.isfinite(angles).all(-1) & (channels["time"] > 0.1) & (channels["time"] < 11.8)
    flown = Rotation.from_quat(true.as_quat()[at[known]])
    away = (Rotation.from_euler("ZYX", angles[known]).inv() * flown).magnitude()
    assert known.mean() > 0.9
    assert np.quantile(away, 0.99) < 0.05


def test_a_roll_that_is_unwrapped_in_a_table_is_data(tmp_path: Path):
    time = np.arange(0.0, 12.0, 0.01)
    phi = 2.0 * np.pi * np.clip((time - 6.0) / 0.8, 0.0, 1.0) + 0.1 * np.sin(2.0 * time)
    columns = {"time": time, "lat": 0.1 * np.sin(3.0 * time), "p": np.gradient(phi, time), "phi": phi}
    np.savetxt(
        tmp_path / "t.csv", np.stack([*columns.values()], -1), "%.8f", ",", header=",".join(columns), comments=""
    )
    done = rotorid.import_log(tmp_path / "t.csv", tmp_path / "set")
    channels = rotorid.load(done.folder).flights["t"].channels
    assert np.abs(channels["phi"].numpy() - phi).max() < 1e-6


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_angles_that_are_counted_from_zero_to_a_turn(unit: str, tmp_path: Path):
    time = clock(start=0.0)
    m = motion(time)
    turn = 360.0 if unit == "deg" else 2.0 * np.pi
    columns = {"time": time, **{name: m[name] for name in ("p", "q", "r", "motor1", "motor2")}}
    columns |= {f"{name} [{unit}]": m[name] * turn / (2.0 * np.pi) % turn for name in ("phi", "theta")}
    np.savetxt(
        tmp_path / "t.csv", np.stack([*columns.values()], -1), "%.8f", ",", header=",".join(columns), comments=""
    )
    _, channels = imported(tmp_path / "t.csv", tmp_path)
    assert all(np.abs(channels[name] - m[name]).max() < 1e-5 for name in ("phi", "theta"))


@pytest.mark.parametrize("times", [2, 3])
def test_rows_that_were_written_several_times_count_once(times: int, tmp_path: Path):
    time = clock(start=0.0)
    columns = {"time": time, **{name: motion(time)[name] for name in ("p", "q", "r", "motor1", "motor2")}}
    table = np.repeat(np.stack([*columns.values()], -1), times, axis=0)
    np.savetxt(tmp_path / "t.csv", table, "%.8f", ",", header=",".join(columns), comments="")
    done, channels = imported(tmp_path / "t.csv", tmp_path)
    assert np.abs(channels["p"] - columns["p"]).max() < 1e-5
    assert any(f"{(times - 1) * len(time)} rows that repeat the one before" in told for told in done.warnings)


def test_a_table_that_begins_with_its_last_row_is_turned_round(tmp_path: Path):
    time = clock(start=0.0)
    columns = {"time": time, **{name: motion(time)[name] for name in ("p", "q", "r", "motor1", "motor2")}}
    table = np.stack([*columns.values()], -1)[::-1]
    np.savetxt(tmp_path / "t.csv", table, "%.8f", ",", header=",".join(columns), comments="")
    done, channels = imported(tmp_path / "t.csv", tmp_path)
    assert np.abs(channels["p"] - columns["p"]).max() < 1e-5
    assert any("were sorted in" in told for told in done.warnings)


@pytest.mark.parametrize("every", [20, 4, 2])
def test_samples_that_were_written_late_are_sorted_in(every: int, tmp_path: Path):
    time = clock()
    order = np.arange(len(time))
    for i in range(10, len(time) - 1, every):
        order[i], order[i + 1] = order[i + 1], order[i]
    topics = px4_topics(12.0, 20.0)
    rates, (stamps, motors) = gyro(time)[1], topics["actuator_motors"]
    topics["vehicle_angular_velocity"] = (time[order], {name: values[order] for name, values in rates.items()})
    done, channels = px4(tmp_path, topics | {"actuator_motors": (stamps, motors)})
    assert any("sorted in" in told for told in done.warnings)
    assert np.abs(channels["p"] - motion(channels["time"])["p"])[5:-5].max() < 1e-3


def test_rotor_speeds_are_the_controls_where_no_commands_are_logged(tmp_path: Path):
    time, order = clock(), (1, 2, 3, 4)
    topics = {"vehicle_angular_velocity": gyro(time), "esc_status": (time, speeds(time, order))}
    done, _ = px4(tmp_path, topics, {f"PWM_MAIN_FUNC{i + 1}": 100 + m for i, m in enumerate(order)})
    assert done.kind == "multirotor"
    assert not any(name.startswith("motor") for name in done.channels)
    data = rotorid.load(done.folder)
    assert data.controls == ("motor1", "motor2", "motor3", "motor4")
    assert any("the rotor speeds are the controls" in sentence for sentence in data.warnings)
    (flight,) = data.flights.values()
    largest = max(float(flight.channels[f"omega{i}"].max()) for i in range(1, 5))
    for i in range(1, 5):
        np.testing.assert_allclose(flight.channels[f"motor{i}"], flight.channels[f"omega{i}"] / largest, atol=1e-12)


def two_ways(time: np.ndarray, low: float, high: float) -> dict[str, tuple]:
    return {"vehicle_angular_velocity": gyro(time), "actuator_outputs": (time, outputs(time, low, high, 0.0))}


def test_motors_that_turn_both_ways_are_refused(tmp_path: Path):
    time = clock()
    with pytest.raises(InputError, match=r"motor1.: turns both ways, by DSHOT_3D_ENABLE"):
        px4(tmp_path, two_ways(time, 1.0, 1999.0), {"DSHOT_CONFIG": 600, "DSHOT_3D_ENABLE": 1})
    asked = 2.0 * commands(time) - 1.0
    topics = {
        "vehicle_angular_velocity": gyro(time),
        "actuator_motors": (time, floats({f"control[{i}]": asked[i] for i in range(4)})),
    }
    with pytest.raises(InputError, match=r"control.0. .motor1.: runs from -1 to .*turns both ways"):
        px4(tmp_path, topics)


def test_speeds_that_are_logged_with_the_way_round_are_positive(tmp_path: Path):
    time = clock()
    asked = commands(time)
    turns = {f"esc[{i}].esc_rpm": (9000.0 * s * asked[i]).astype("<i4") for i, s in enumerate((1, -1, 1, -1))}
    topics = {
        "vehicle_angular_velocity": gyro(time),
        "actuator_motors": (time, floats({f"control[{i}]": asked[i] for i in range(4)})),
        "esc_status": (time, turns),
    }
    done, channels = px4(tmp_path, topics)
    assert any("omega2, omega4 are logged negative" in said for said in done.warnings)
    for i in range(4):
        assert np.abs(channels[f"omega{i + 1}"] - 300.0 * np.pi * asked[i]).max() < 0.5
