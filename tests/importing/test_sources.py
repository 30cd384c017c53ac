"""Which source of a log is taken: outputs of several groups, instances with content, flags, timers, faster messages."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rotorid_torch import import_log, load
from rotorid_torch.errors import InputError
from rotorid_torch.importing.logs import Imported
from tests.importing.log_writers import motion, px4_topics, quaternion, write_dataflash, write_ulog
from tests.importing.test_flown import clock, commands, copter, floats, gyro, imported, outputs, px4, speeds, wired

TIME = clock()
SINCE = TIME - TIME[0]
ASKED = commands(TIME)
MOTORS = wired({i: i for i in range(1, 5)})


def functions(prefix: str, motors: tuple[int, ...] = (1, 2, 3, 4)) -> dict[str, float]:
    return {f"{prefix}_FUNC{i}": 100 + motor for i, motor in enumerate(motors, 1)}


def right(channels: dict[str, np.ndarray], tolerance: float = 2e-3) -> bool:
    return all(np.abs(channels[f"motor{i + 1}"] - ASKED[i]).max() < tolerance for i in range(4))


def told_by(topics: dict[str, tuple], hertz: float = 100.0) -> dict[str, tuple]:
    """The same log with commands at this rate, its rates added."""
    time = clock(hertz=hertz)
    asked = floats({f"control[{i}]": row for i, row in enumerate(commands(time))})
    return {"vehicle_angular_velocity": gyro(TIME), "actuator_motors": (time, asked)} | topics


# PX4


@pytest.mark.parametrize("low", [150, 0])
def test_outputs_of_a_simulator_have_the_range_of_its_settings(low: int, tmp_path: Path):
    topics = told_by({"actuator_outputs": (TIME, outputs(TIME, low, 1000.0, 0.0))}, hertz=10.0)
    ends = {f"SIM_GZ_EC_{end}{i}": value for i in range(1, 5) for end, value in (("MIN", low), ("MAX", 1000))}
    done, channels = px4(tmp_path, topics, functions("SIM_GZ_EC") | ends)
    assert done.channels["motor1"].source == "actuator_outputs.output[0]"
    assert right(channels)


@pytest.mark.parametrize(("low", "high", "rest"), [(1000.0, 2000.0, 900.0), (1.0, 1999.0, 0.0)])
def test_some_timers_with_pulses_and_some_with_dshot(low: float, high: float, rest: float, tmp_path: Path):
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, outputs(TIME, low, high, rest))}
    _, channels = px4(tmp_path, topics, functions("PWM_MAIN") | {"PWM_MAIN_TIM0": 400, "PWM_MAIN_TIM1": -3})
    assert right(channels)


@pytest.mark.parametrize("swapped", [False, True])
def test_motors_on_two_groups_of_outputs(swapped: bool, tmp_path: Path):
    every = outputs(TIME, 1000.0, 2000.0, 900.0, order=(0, 1, 2, 3))
    idle = np.zeros(len(TIME), "<f4")
    halves = [{f"output[{i}]": every[f"output[{i + first}]"] if i < 2 else idle for i in range(16)} for first in (0, 2)]
    main, auxiliary = ((3, 4), (1, 2)) if swapped else ((1, 2), (3, 4))
    first, second = halves[::-1] if swapped else halves
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, first)}
    topics["actuator_outputs[1]"] = (TIME, second)
    _, channels = px4(tmp_path, topics, functions("PWM_MAIN", main) | functions("PWM_AUX", auxiliary))
    assert right(channels)


def test_a_group_without_its_outputs_is_told(tmp_path: Path):
    topics = {"vehicle_angular_velocity": gyro(TIME)}
    topics["actuator_outputs"] = (TIME, outputs(TIME, 1000.0, 2000.0, 900.0))
    done, channels = px4(tmp_path, topics, functions("PWM_MAIN", (1, 2, 3)) | functions("UAVCAN_EC", (4,)))
    assert "motor4" not in channels
    assert any("no data: motor4 (no actuator_outputs of UAVCAN_EC)" in told for told in done.warnings)


def test_a_reversed_output_is_refused(tmp_path: Path):
    topics = {"vehicle_angular_velocity": gyro(TIME)}
    topics["actuator_outputs"] = (TIME, outputs(TIME, 1000.0, 2000.0, 900.0))
    with pytest.raises(InputError, match=r"output\[1\] .motor2.: is reversed by PWM_MAIN_REV"):
        px4(tmp_path, topics, functions("PWM_MAIN") | {"PWM_MAIN_REV": 2})


def test_an_output_that_its_own_setting_reverses_is_refused(tmp_path: Path):
    """Of firmware before 1.13."""
    topics = {"vehicle_angular_velocity": gyro(TIME)}
    topics["actuator_outputs"] = (TIME, outputs(TIME, 1000.0, 2000.0, 900.0))
    with pytest.raises(InputError, match=r"output\[2\] .motor3.: is reversed by PWM_MAIN_REV3"):
        px4(tmp_path, topics, {"PWM_MAIN_REV2": 0, "PWM_MAIN_REV3": 1})


def test_brushed_motors_have_the_range_of_their_settings(tmp_path: Path):
    """A duty cycle of 8 bits, whose least value is 0."""
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, outputs(TIME, 0.0, 255.0, 0.0))}
    ends = {f"PWM_MAIN_{end}{i}": value for i in range(1, 5) for end, value in (("MIN", 0), ("MAX", 255))}
    _, channels = px4(tmp_path, topics, functions("PWM_MAIN") | ends | {"PWM_MAIN_TIM0": 3921})
    assert right(channels)


def test_the_instance_with_content(tmp_path: Path):
    silent = {name: 0 * values for name, values in speeds(TIME, (1, 2, 3, 4)).items()}
    topics = {"esc_status": (TIME, silent), "esc_status[1]": (TIME, speeds(TIME, (1, 2, 3, 4)))}
    topics["battery_status"] = (TIME, floats({"voltage_v": 0.0 * TIME}))
    topics["battery_status[1]"] = (TIME, floats({"voltage_v": 16.0 + 0.1 * np.sin(SINCE)}))
    done, channels = px4(tmp_path, told_by(topics))
    assert np.abs(channels["voltage"] - 16.0 - 0.1 * np.sin(SINCE)).max() < 1e-3
    assert np.abs(channels["omega3"] - 10_000.0 * np.sqrt(0.2 + ASKED[2]) * np.pi / 30.0).max() < 0.2
    assert "battery_status.voltage_v left: all zero or not a number" in done.channels["voltage"].reason


@pytest.mark.parametrize("never", ["v_xy_valid", "xy_valid"])
def test_positions_that_the_estimator_never_called_valid(never: str, tmp_path: Path):
    flags = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")
    state = floats({name: np.sin(SINCE) for name in ("vx", "vy", "vz", "x", "y", "z")})
    state |= {flag: np.full(len(TIME), flag != never, "<u1") for flag in flags}
    turned = quaternion(*(motion(SINCE)[name] for name in ("phi", "theta", "psi")))
    topics = {"vehicle_attitude": (TIME, floats({f"q[{i}]": turned[i] for i in range(4)}))}
    done, channels = px4(tmp_path, told_by(topics | {"vehicle_local_position": (TIME, state)}))
    absent = {"u", "v", "w"} if never == "v_xy_valid" else {"north", "east"}
    assert channels.keys().isdisjoint(absent)
    assert "height" in channels
    assert any(f"left: {never} is never set" in told for told in done.warnings)


@pytest.mark.parametrize(
    ("prefix", "low", "high", "ends"), [("VOXL_ESC", 5500, 15000, True), ("TAP_ESC", 1200, 1900, False)]
)
def test_outputs_of_controllers_on_a_bus_have_the_range_of_their_driver(
    prefix: str, low: int, high: int, ends: bool, tmp_path: Path
):
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, outputs(TIME, low, high, low - 10.0))}
    settings = {f"{prefix}_RPM_MIN": low, f"{prefix}_RPM_MAX": high} if ends else {}
    _, channels = px4(tmp_path, topics, functions(prefix) | settings)
    assert right(channels)


def test_the_range_of_a_driver_that_nothing_tells_is_asked_for(tmp_path: Path):
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_outputs": (TIME, outputs(TIME, 1000.0, 2000.0, 900.0))}
    with pytest.raises(InputError, match=r"runs from .*; expected settings of its range"):
        px4(tmp_path, topics, functions("NEW_ESC"))


@pytest.mark.parametrize("telemetry", [False, True])
def test_motors_in_the_order_of_betaflight(telemetry: bool, tmp_path: Path):
    placed = (3, 0, 1, 2)  # the motor, from 0, on each output
    topics = {"vehicle_angular_velocity": gyro(TIME)}
    topics["actuator_outputs"] = (TIME, outputs(TIME, 1000.0, 2000.0, 900.0, order=placed))
    if telemetry:
        turning = speeds(TIME, tuple(motor + 1 for motor in placed))
        topics["esc_status"] = (TIME, {n: v for n, v in turning.items() if "function" not in n})
    done, channels = px4(tmp_path, topics, {"MOT_ORDERING": 1})
    assert right(channels)
    assert "MOT_ORDERING 1" in done.channels["motor1"].reason
    if telemetry:
        assert np.abs(channels["omega1"] - 10_000.0 * np.sqrt(0.2 + ASKED[0]) * np.pi / 30.0).max() < 0.2


def test_commands_that_never_change_give_way_to_outputs(tmp_path: Path):
    still = floats({f"control[{i}]": 0.0 * TIME for i in range(4)})
    topics = {"vehicle_angular_velocity": gyro(TIME), "actuator_motors": (TIME, still)}
    topics["actuator_outputs"] = (TIME, outputs(TIME, 1000.0, 2000.0, 900.0))
    done, channels = px4(tmp_path, topics)
    assert right(channels)
    assert done.channels["motor1"].reason == "actuator_motors left: never changes"


@pytest.mark.parametrize("still", [False, True])
def test_an_estimator_of_its_own_topic_is_taken_where_it_is_faster_or_moves(still: bool, tmp_path: Path):
    m, slow = motion(SINCE), clock(hertz=5.0)
    turned = quaternion(*(motion(slow - slow[0])[name] for name in ("phi", "theta", "psi")))
    kept = [[1.0, 0.0, 0.0, 0.0][i] * np.ones(len(slow)) if still else turned[i] for i in range(4)]
    topics = {"vehicle_attitude": (slow, floats({f"q[{i}]": kept[i] for i in range(4)}))}
    full = quaternion(*(m[name] for name in ("phi", "theta", "psi")))
    topics["estimator_attitude"] = (TIME, floats({f"q[{i}]": full[i] for i in range(4)}))
    done, channels = px4(tmp_path, told_by(topics))
    assert np.abs(channels["phi"] - m["phi"]).max() < 1e-3
    assert "vehicle_attitude.q[0] left" in done.channels["phi"].reason


# ArduPilot


def ardupilot(tmp_path: Path, topics: dict[str, tuple], settings: dict[str, float] | None = None):
    return imported(write_dataflash(tmp_path / "log.bin", topics, MOTORS | (settings or {})), tmp_path)


def by_pulses(pulses: np.ndarray | None = None) -> dict[str, tuple]:
    return copter(TIME, 1000.0 + 1000.0 * ASKED if pulses is None else pulses)


@pytest.mark.parametrize(("topic", "source"), [("RATE", "RATE.R"), ("GYR", "GYR.GyrX")])
def test_body_rates_of_a_faster_message(topic: str, source: str, tmp_path: Path):
    slow = clock(hertz=20.0)
    topics = by_pulses() | {"IMU": copter(slow, ASKED[:, : len(slow)])["IMU"]}
    m = motion(SINCE)
    if topic == "RATE":
        topics[topic] = (TIME, floats({"R": np.degrees(m["p"]), "P": np.degrees(m["q"]), "Y": np.degrees(m["r"])}))
    else:
        topics[topic] = (TIME, floats({f"Gyr{a}": m[n] for a, n in zip("XYZ", "pqr", strict=True)}))
    done, channels = ardupilot(tmp_path, topics)
    assert done.channels["p"].source == source
    assert np.abs(channels["q"] - m["q"])[5:-5].max() < 1e-3


def test_motors_with_the_range_of_their_servo(tmp_path: Path):
    settings = {"MOT_PWM_TYPE": 8, "MOT_PWM_MIN": 1000, "MOT_PWM_MAX": 2000}
    settings |= {f"SERVO{i}_{end}": value for i in range(1, 5) for end, value in (("MIN", 1100), ("MAX", 1900))}
    _, channels = ardupilot(tmp_path, by_pulses(1100.0 + 800.0 * ASKED), settings)
    assert right(channels)


def test_the_tail_of_a_tricopter_is_no_motor(tmp_path: Path):
    pulses = np.vstack([1000.0 + 1000.0 * ASKED[:3], 1520.0 + 200.0 * np.sin(SINCE)])
    settings = {"SERVO3_FUNCTION": 36, "SERVO4_FUNCTION": 39, "FRAME_CLASS": 7, "SERVO4_MIN": 1120}
    settings |= {"SERVO4_TRIM": 1520, "SERVO4_MAX": 1920}
    done, channels = ardupilot(tmp_path, by_pulses(pulses), settings)
    assert {name for name in channels if name.startswith("motor")} == {"motor1", "motor2", "motor4"}
    assert np.abs(channels["ped"] - 0.5 * np.sin(SINCE)).max() < 2e-3
    assert done.units["ped"] == "norm"


@pytest.mark.parametrize("frame", [8, 9])
def test_fins_are_no_motors(frame: int, tmp_path: Path):
    with pytest.raises(InputError, match=f"has fins for motors 1 to 4 .FRAME_CLASS {frame}."):
        ardupilot(tmp_path, by_pulses(), {"FRAME_CLASS": frame})


@pytest.mark.parametrize(("topic", "field", "channel"), [("BAT", "Volt", "voltage"), ("ARSP", "Airspeed", "airspeed")])
def test_the_second_battery_and_airspeed_sensor(topic: str, field: str, channel: str, tmp_path: Path):
    both = np.sort(np.concatenate([TIME, TIME + 1e-4]))
    number = np.tile([0, 1], len(TIME)).astype("<u1")
    values = np.where(number == 0, 0.0, 14.0 + np.sin(both - both[0]))
    topics = by_pulses() | {topic: (both, {"Inst": number} | floats({field: values}))}
    _, channels = ardupilot(tmp_path, topics)
    assert np.abs(channels[channel] - 14.0 - np.sin(SINCE)).max() < 1e-2


@pytest.mark.parametrize("frame", ["SINGLE", "COAX"])
def test_fins_that_older_firmware_names(frame: str, tmp_path: Path):
    file = write_dataflash(
        tmp_path / "log.bin", by_pulses(), {"MOT_PWM_MIN": 1000}, f"ArduCopter V3.3.3; Frame: {frame}"
    )
    with pytest.raises(InputError, match=f"has fins for motors 1 to 4 .Frame: {frame}."):
        imported(file, tmp_path)


def test_the_tail_of_a_tricopter_that_older_firmware_names(tmp_path: Path):
    topics = by_pulses()
    time, columns = topics["RCOU"]
    tail = np.round(1500.0 + 200.0 * np.sin(SINCE)).astype("<u2")
    topics["RCOU"] = (time, {**columns, "C3": 0 * tail + 1000, "C7": tail})
    file = write_dataflash(tmp_path / "log.bin", topics, {"MOT_PWM_MIN": 1000}, "ArduCopter V3.4.6; Frame: TRI")
    _, channels = imported(file, tmp_path)
    assert {name for name in channels if name.startswith("motor")} == {"motor1", "motor2", "motor4"}
    assert np.abs(channels["ped"] - 0.4 * np.sin(SINCE)).max() < 3e-3


def test_a_servo_output_that_is_reversed_is_refused(tmp_path: Path):
    settings = {"MOT_PWM_TYPE": 8, "SERVO2_REVERSED": 1}
    with pytest.raises(InputError, match=r"RCOU.C2 .motor2.: is reversed by SERVO2_REVERSED"):
        ardupilot(tmp_path, by_pulses(2000.0 - 1000.0 * ASKED), settings)


def test_outputs_by_their_older_names(tmp_path: Path):
    topics = by_pulses()
    time, columns = topics["RCOU"]
    topics["RCOU"] = (time, {name.replace("C", "Ch"): values for name, values in columns.items()})
    _, channels = imported(write_dataflash(tmp_path / "log.bin", topics, {"FRAME": 1}), tmp_path)
    assert right(channels)


def test_a_lane_switch_that_only_an_error_tells(tmp_path: Path):
    topics = by_pulses() | {"ERR": (np.array([26.0]), {"Subsys": np.array([24], "<u1"), "ECode": np.array([1], "<u1")})}
    topics["ATT"][1]["Yaw"] += np.where(SINCE > 6.0, 40.0, 0.0).astype("<f4")
    done, _ = ardupilot(tmp_path, topics)
    assert len(done.flights) == 2
    assert any("lane switch of the estimator (ERR 24, to 1)" in told for told in done.warnings)


SAID = (
    "IMU0 MAG0 in-flight yaw alignment complete",
    "IMU0 ground mag anomaly, yaw re-aligned",
    "IMU0 yaw aligned to GPS",
)


@pytest.mark.parametrize("said", SAID)
def test_a_heading_that_is_aligned_in_flight(said: str, tmp_path: Path):
    topics = by_pulses()
    topics["ATT"][1]["Yaw"] += np.where(SINCE > 6.0, 40.0, 0.0).astype("<f4")
    file = write_dataflash(tmp_path / "log.bin", topics, MOTORS)
    message = b"\xa3\x95\x03" + struct.pack("<Q64s", round(1e6 * (TIME[0] + 6.1)), f"EKF3 {said}".encode())
    file.write_bytes(file.read_bytes() + message)
    done, _ = imported(file, tmp_path)
    assert len(done.flights) == 2
    assert any("yaw" in told and "psi by +0.698" in told for told in done.warnings)


NED, LEVEL, BODY = (
    {"new": 1, "old": 0, "oldest": 0},
    {"new": 2, "old": 1, "oldest": 1},
    {"new": 3, "old": 3, "oldest": 3},
)


def odometry(form: str, pose: int, moving: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The known flight as PX4's odometry; a heading of any zero is a radian further."""
    time = np.arange(0.0, 12.0, 0.01)
    m = motion(time)
    turned = 1.0 * (pose == LEVEL[form])
    attitude = Rotation.from_euler("ZYX", np.stack([m["psi"] + turned, m["theta"], m["phi"]], -1))
    velocity = Rotation.from_euler("Z", turned).apply(np.stack([m["vn"], m["ve"], m["vd"]], -1))
    velocity = attitude.inv().apply(velocity) if moving == BODY[form] else velocity
    columns = {f"q[{i}]": v for i, v in enumerate(attitude.as_quat(scalar_first=True).T)}
    names = [("x", "y", "z"), ("vx", "vy", "vz")]
    if form == "new":
        names = [[f"{name}[{i}]" for i in range(3)] for name in ("position", "velocity")]
    columns |= dict(zip(names[0], (0.1 * time, 0.2 * time, -0.3 * time), strict=True))
    columns |= dict(zip(names[1], velocity.T, strict=True))
    said = (
        {"pose_frame" if form == "new" else "local_frame": pose, "velocity_frame": moving} if form != "oldest" else {}
    )
    return 100.0 + time, floats(columns) | {name: np.full(len(time), n, "<u1") for name, n in said.items()}


def of_odometry(
    folder: Path, form: str, pose: int, moving: int, *others: str
) -> tuple[dict[str, np.ndarray], Imported]:
    topics = px4_topics()
    kept = {n: t for n, t in topics.items() if n not in ("vehicle_attitude", "vehicle_local_position") or n in others}
    kept["vehicle_odometry"] = odometry(form, pose, moving)
    done = import_log(write_ulog(folder / "a.ulg", kept, {"MAV_TYPE": 2.0, "CA_ROTOR_COUNT": 4.0}), folder / "set")
    return load(done.folder)["a"].to_numpy(), done


def off(channels: dict[str, np.ndarray], name: str) -> float:
    """Largest error of a channel away from the ends; velocities are in body axes."""
    known = motion(channels["time"])
    turned = Rotation.from_euler("ZYX", np.stack([known[n] for n in ("psi", "theta", "phi")], -1))
    known |= dict(zip("uvw", turned.inv().apply(np.stack([known[n] for n in ("vn", "ve", "vd")], -1)).T, strict=True))
    return float(np.abs(channels[name] - known[name])[100:-100].max())


@pytest.mark.parametrize(
    ("form", "frames"),
    [
        ("new", "NN"),
        ("new", "NB"),
        ("new", "LL"),
        ("new", "LB"),
        ("old", "NN"),
        ("old", "NB"),
        ("old", "LL"),
        ("oldest", "NN"),
    ],
)
def test_an_odometry_stands_for_attitude_and_place(form: str, frames: str, tmp_path: Path):
    number = {"N": NED, "L": LEVEL, "B": BODY}
    channels, done = of_odometry(tmp_path, form, *(number[frame][form] for frame in frames))
    assert max(off(channels, name) for name in ("phi", "theta", "u", "v", "w")) < 0.01
    assert ("height" in channels) == (frames[0] == "N")
    assert (off(channels, "psi") < 0.01) == (frames[0] == "N")
    assert any("psi does not count from north" in told for told in done.warnings) == (frames[0] == "L")
    if frames[0] == "N":
        assert np.allclose((channels["height"] - 0.3 * channels["time"])[10:-10], 0.0, atol=0.01)


@pytest.mark.parametrize("frames", [(1, 2), (2, 1), (1, 0), (0, 0), (0, 1)])
def test_velocities_that_no_attitude_turns_are_left(frames: tuple[int, int], tmp_path: Path):
    channels, _ = of_odometry(tmp_path, "new", *frames)
    assert not {"u", "v", "w"} & channels.keys()


def test_a_heading_of_any_zero_does_not_go_with_other_topics(tmp_path: Path):
    for kept, lacking in (("vehicle_attitude", "u"), ("vehicle_local_position", "phi")):
        (tmp_path / kept).mkdir()
        assert lacking not in of_odometry(tmp_path / kept, "new", 2, 2, kept)[0]
    (tmp_path / "body").mkdir()
    assert off(of_odometry(tmp_path / "body", "new", 2, 3, "vehicle_attitude")[0], "u") < 0.01


def test_attitude_and_local_position_come_before_an_odometry(tmp_path: Path):
    _, done = of_odometry(tmp_path, "new", 2, 2, "vehicle_attitude", "vehicle_local_position")
    assert done.channels["phi"].source.startswith("vehicle_attitude")
    assert not any("vehicle_odometry" in told for told in done.warnings)
