"""Settings that decide what a number means: number of motors, protocol of outputs, reversed sticks, clocks by names."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import rotorid_torch as rotorid
from rotorid_torch.errors import InputError
from rotorid_torch.importing.logs import Imported
from tests.importing.log_writers import Topics, message, motion, px4_topics, write_dataflash, write_ulog

TIME = np.arange(0.0, 8.0, 0.01)
MOTORS = tuple(f"motor{i}" for i in range(1, 5))


def imported(file: Path) -> tuple[Imported, dict[str, np.ndarray]]:
    """The import and the channels of its first flight."""
    done = rotorid.import_log(file, file.parent / "set")
    flight = rotorid.load(done.folder).flights[next(iter(done.flights))]
    return done, {name: values.numpy() for name, values in flight.channels.items()}


def floats(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: np.asarray(values, "<f4") for name, values in columns.items()}


def hexa() -> dict[str, tuple]:
    topics = px4_topics(seconds=8.0)
    time, commands = topics["actuator_motors"]
    more = {f"control[{i}]": commands[f"control[{i - 4}]"] for i in (4, 5)}
    return topics | {"actuator_motors": (time, commands | more)}


def test_the_number_of_motors_is_that_of_the_control_allocation(tmp_path: Path):
    settings = {"MAV_TYPE": 2, "CA_AIRFRAME": 0, "CA_ROTOR_COUNT": 6}
    _, channels = imported(write_ulog(tmp_path / "log.ulg", hexa(), settings))
    assert [name for name in channels if name.startswith("motor")] == [f"motor{i}" for i in range(1, 7)]


def test_the_pusher_of_a_vtol_is_no_motor_of_its_hover(tmp_path: Path):
    settings = {"MAV_TYPE": 22, "CA_AIRFRAME": 2, "CA_ROTOR_COUNT": 5}
    _, channels = imported(write_ulog(tmp_path / "log.ulg", hexa(), settings))
    assert [name for name in channels if name.startswith("motor")] == [*MOTORS]


def with_outputs(low: float, high: float, rest: float) -> Topics:
    """A quadrotor of older firmware, whose outputs rest for two seconds and then run between low and high."""
    topics = px4_topics(seconds=8.0)
    time, commands = topics.pop("actuator_motors")
    asked = {i: np.where(time < time[0] + 2.0, np.nan, commands[f"control[{i}]"]) for i in range(4)}
    outputs = {f"output[{i}]": np.nan_to_num(low + (high - low) * asked[i], nan=rest) for i in range(4)}
    idle = {f"output[{i}]": np.zeros(len(time)) for i in range(4, 16)}
    return topics | {"actuator_outputs": (time, floats(outputs | idle))}


@pytest.mark.parametrize("settings", [{"UAVCAN_ENABLE": 3}, {"DSHOT_CONFIG": 600}])
def test_pulses_beside_another_protocol_are_known_by_their_rest(settings: dict, tmp_path: Path):
    file = write_ulog(tmp_path / "log.ulg", with_outputs(1000.0, 2000.0, 900.0), {"MAV_TYPE": 2, **settings})
    _, channels = imported(file)
    time = 0.004 * np.arange(len(channels["motor1"]))
    flown = (time > 2.2) & (time < 7.9)
    assert channels["motor1"][flown] == pytest.approx(motion(time)["motor1"][flown], abs=0.01)


@pytest.mark.parametrize("settings", [{"DSHOT_CONFIG": 600}, {"PWM_MAIN_TIM0": -5}, {"UAVCAN_ENABLE": 3}])
def test_counts_that_never_rest_are_no_pulses(settings: dict, tmp_path: Path):
    """Of a log that begins and ends in flight; the least count lies where pulses have their rest."""
    topics = px4_topics(seconds=8.0)
    time, commands = topics.pop("actuator_motors")
    high = 8191.0 if "UAVCAN_ENABLE" in settings else 1999.0
    counts = {f"output[{i}]": np.round(700.0 + 800.0 * commands[f"control[{i}]"]) for i in range(4)}
    assert 900.0 < min(float(row.min()) for row in counts.values()) < 1000.0
    topics["actuator_outputs"] = (time, floats(counts | {f"output[{i}]": 0.0 * time for i in range(4, 16)}))
    settings = {"MAV_TYPE": 2, **settings} | {f"PWM_MAIN_FUNC{i}": 100 + i for i in range(1, 5)}
    _, channels = imported(write_ulog(tmp_path / "log.ulg", topics, settings))
    assert channels["motor1"].max() == pytest.approx((counts["output[0]"].max() - 1.0) / (high - 1.0), abs=2e-3)


@pytest.mark.parametrize(("settings", "high"), [({"UAVCAN_ENABLE": 3}, 8191.0), ({"DSHOT_CONFIG": 600}, 1999.0)])
def test_the_other_protocol_is_known_by_its_rest_too(settings: dict, high: float, tmp_path: Path):
    file = write_ulog(tmp_path / "log.ulg", with_outputs(1.0, high, 0.0), {"MAV_TYPE": 2, **settings})
    _, channels = imported(file)
    assert channels["motor1"].max() == pytest.approx(0.7, abs=0.01)


def pulses(low: float, high: float) -> Topics:
    """A quadrotor of ArduPilot with outputs between low and high."""
    m = motion(TIME)
    return {
        "IMU": (TIME + 20.0, floats({f"Gyr{a}": m[n] for a, n in zip("XYZ", "pqr", strict=True)})),
        "RCOU": (
            TIME + 20.0,
            {f"C{i}": np.round(low + (high - low) * m[f"motor{i}"]).astype("<u2") for i in range(1, 5)},
        ),
    }


FUNCTIONS = {f"SERVO{i}_FUNCTION": 32.0 + i for i in range(1, 5)}
BOTH_WAYS = [
    ({"MOT_PWM_TYPE": 6.0, "SERVO_BLH_3DMASK": 15.0}, "SERVO_BLH_3DMASK"),
    ({"SERVO_BLH_OTYPE": 5.0, "SERVO_BLH_3DMASK": 2.0}, "SERVO_BLH_3DMASK"),
    ({"MOT_PWM_TYPE": 9.0}, "MOT_PWM_TYPE 9"),
]


@pytest.mark.parametrize(("settings", "told"), BOTH_WAYS)
def test_motors_that_settings_of_ardupilot_turn_both_ways_are_refused(settings: dict, told: str, tmp_path: Path):
    file = write_dataflash(tmp_path / "log.bin", pulses(1000.0, 2000.0), FUNCTIONS | settings, "ArduCopter V4.5.1")
    with pytest.raises(InputError, match=f"turns both ways, by {told}"):
        imported(file)


def test_a_mask_of_both_ways_means_nothing_to_pulses(tmp_path: Path):
    settings = FUNCTIONS | {"SERVO_BLH_3DMASK": 15.0, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}
    _, channels = imported(write_dataflash(tmp_path / "log.bin", pulses(1000.0, 2000.0), settings, "ArduCopter V4.5.1"))
    assert channels["motor1"] == pytest.approx(motion(TIME)["motor1"], abs=2e-3)


def test_motors_of_a_vtol_have_the_range_of_its_own_settings(tmp_path: Path):
    settings = FUNCTIONS | {"Q_ENABLE": 1.0, "RC3_MIN": 982.0, "RC3_MAX": 2006.0}
    settings |= {"Q_M_PWM_TYPE": 0.0, "Q_M_PWM_MIN": 1100.0, "Q_M_PWM_MAX": 1900.0}
    _, channels = imported(write_dataflash(tmp_path / "log.bin", pulses(1100.0, 1900.0), settings, "ArduPlane V4.5.1"))
    assert channels["motor1"] == pytest.approx(motion(TIME)["motor1"], abs=2e-3)


@pytest.mark.parametrize("reversed_by", [("RC{}_REVERSED", 1.0), ("RC{}_REV", -1.0)])
def test_reversed_sticks_are_turned_back(reversed_by: tuple[str, float], tmp_path: Path):
    key, value = reversed_by
    m = motion(TIME)
    sticks = [0.6 * np.sin(TIME), 0.4 * np.cos(TIME), 0.5 + 0.2 * np.sin(2.0 * TIME), 0.1 * TIME / 8.0]
    pulses = [1500.0 + 500.0 * sticks[0], 1500.0 - 500.0 * sticks[1], 2000.0 - 1000.0 * sticks[2]]
    pulses.append(1500.0 + 500.0 * sticks[3])
    topics = {
        "IMU": (TIME + 20.0, floats({f"Gyr{a}": m[n] for a, n in zip("XYZ", "pqr", strict=True)})),
        "RCIN": (TIME + 20.0, {f"C{i + 1}": np.round(row).astype("<u2") for i, row in enumerate(pulses)}),
    }
    settings = {"FRAME_CLASS": 6.0, key.format(2): value, key.format(3): value}
    _, channels = imported(write_dataflash(tmp_path / "log.bin", topics, settings, "ArduCopter V4.5.1"))
    for name, asked in zip(("lat", "lon", "col", "ped"), sticks, strict=True):
        assert channels[name] == pytest.approx(asked, abs=3e-3)


def test_sticks_whose_trim_is_not_in_the_middle_reach_one_at_their_far_end(tmp_path: Path):
    m, pulses = motion(TIME), np.round(1400.0 + 600.0 * np.sin(TIME).clip(-0.6, 1.0)).astype("<u2")
    topics = {
        "IMU": (TIME + 20.0, floats({f"Gyr{a}": m[n] for a, n in zip("XYZ", "pqr", strict=True)})),
        "RCIN": (TIME + 20.0, {f"C{i}": pulses for i in range(1, 5)}),
    }
    file = write_dataflash(tmp_path / "log.bin", topics, {"FRAME_CLASS": 6.0, "RC1_TRIM": 1400.0}, "ArduCopter V4.5.1")
    _, channels = imported(file)
    assert channels["lat"] == pytest.approx((pulses - 1400.0) / 600.0, abs=3e-3)


def table(clock: str, stamps: np.ndarray, folder: Path) -> Path:
    m = motion(TIME)
    columns = {clock: stamps, **{name: m[name] for name in ("p", "q", "r", *MOTORS)}}
    rows = "\n".join(",".join(f"{v:.12g}" for v in row) for row in zip(*columns.values(), strict=True))
    file = folder / "t.csv"
    file.write_text(",".join(columns) + "\n" + rows, encoding="utf-8")
    return file


CLOCKS = {
    "time (milliseconds)": 1e3,
    "time (usec)": 1e6,
    "Time [\N{GREEK SMALL LETTER MU}s]": 1e6,
    "Time [\N{MICRO SIGN}s]": 1e6,
    "t [minutes]": 1.0 / 60.0,
    "timestamp [hours]": 1.0 / 3600.0,
    "time_msec": 1e3,
    "Timestamp_sec": 1.0,
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_units_of_clocks_are_believed_as_people_write_them(clock: str, tmp_path: Path):
    _, channels = imported(table(clock, CLOCKS[clock] * TIME, tmp_path))
    assert len(channels["p"]) == len(TIME)
    assert channels["p"] == pytest.approx(motion(TIME)["p"], abs=1e-3)


def test_a_count_of_milliseconds_is_not_taken_for_seconds(tmp_path: Path):
    with pytest.raises(InputError, match=r"time.*samples 1 s apart; expected time in s"):
        imported(table("time", 100.0 * TIME, tmp_path))


@pytest.mark.parametrize(("ticks", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns"), (1.0 / 86400.0, "days")])
def test_the_map_that_a_refused_clock_asks_for_is_accepted(ticks: float, unit: str, tmp_path: Path):
    file = table("time", ticks * TIME, tmp_path)
    with pytest.raises(InputError, match=f'unit = "{unit}"'):
        imported(file)
    given = {"time": {"field": "time", "unit": unit}, "built_in": True}
    assert rotorid.import_log(file, tmp_path / "timed", given).rate == pytest.approx(
        1.0 / (TIME[1] - TIME[0]), rel=0.01
    )


def test_a_unit_that_a_map_gives_the_clock_is_believed(tmp_path: Path):
    by = tmp_path / "map.toml"
    by.write_text(
        'time = { field = "time", unit = "s" }\n[channels]\np = "p"\nq = "q"\nr = "r"\nmotor1 = "motor1"\n',
        encoding="utf-8",
    )
    done = rotorid.import_log(table("time", 100.0 * TIME, tmp_path), tmp_path / "set", by)
    assert done.rate == 1.0


def test_a_channel_that_is_in_two_columns_says_which_is_taken(tmp_path: Path):
    file = table("time", TIME, tmp_path)
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([f"{head},p [deg/s],gust", *(f"{row},{row.split(',')[1]},0" for row in rows)]))
    done, _ = imported(file)
    assert any("p [deg/s] is left out: p is taken from p" in w for w in done.warnings)
    assert any(w.endswith("no channel has such a name and unit: gust") for w in done.warnings)


def test_body_rates_in_one_matrix_are_no_rotor_speeds(tmp_path: Path):
    m = motion(TIME)
    rates = np.stack([m[name] for name in "pqr"], 1)
    np.savez(tmp_path / "m.npz", time=TIME, omega=rates, **{name: m[name] for name in ("p", "q", "r", *MOTORS)})
    done, channels = imported(tmp_path / "m.npz")
    assert not [name for name in channels if name.startswith("omega")]
    assert any("omega[0]" in warning for warning in done.warnings)


def box(folder: Path, low: float, high: float) -> Path:
    """A blackbox without a header, with outputs for commands 0 and 1 at these values."""
    m = motion(TIME)
    columns = {"loopIteration": np.arange(len(TIME)), "time (us)": 1e6 * TIME}
    columns |= {f"gyroADC[{i}]": np.degrees(s * m[n]) for i, (n, s) in enumerate((("p", 1), ("q", -1), ("r", -1)))}
    columns |= {f"motor[{i}]": low + (high - low) * m[name] for i, name in enumerate(MOTORS)}
    rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True))
    (folder / "b.csv").write_text(",".join(columns) + "\n" + rows)
    return folder / "b.csv"


def test_a_blackbox_says_that_it_has_no_attitude(tmp_path: Path):
    done, _ = imported(box(tmp_path, 1000.0, 2000.0))
    assert any("no data" in warning and "phi theta psi" in warning for warning in done.warnings)


def test_outputs_of_a_blackbox_that_two_ranges_hold_say_so(tmp_path: Path):
    told = "48 to 2047 (DShot with the first 48 values for orders) would hold them too"
    assert any(told in warning for warning in imported(box(tmp_path, 1000.0, 2000.0))[0].warnings)
    assert not any("would hold" in warning for warning in imported(box(tmp_path, 48.0, 2047.0))[0].warnings)


def test_blackboxes_of_one_vehicle_are_not_read_by_two_ranges_of_its_motors(tmp_path: Path):
    """Without headers, outputs of 48 to 2047 that stay above 1000 look like servo pulses."""
    files = []
    for name, (low, high) in {"a": (1000.0, 2000.0), "b": (48.0, 2047.0)}.items():
        (tmp_path / name).mkdir()
        files.append(box(tmp_path / name, low, high).rename(tmp_path / f"{name}.csv"))
    with pytest.raises(InputError, match=r"a\.csv.*motor1.* 1000 to 2000 .*b\.csv.* 48 to 2047.*header"):
        rotorid.import_log(files, tmp_path / "set")


@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (50.0, 150.0), (0.0, 255.0)])
def test_outputs_of_a_blackbox_that_use_little_of_a_range_are_no_dshot(low: float, high: float, tmp_path: Path):
    with pytest.raises(InputError, match=r"runs from .* expected 1000 to 2000 .* or 48 to 2047"):
        imported(box(tmp_path, low, high))


@pytest.mark.parametrize(
    ("settings", "about"),
    [({"FRAME_CLASS": 1.0}, "ArduCopter V3.6"), ({}, "ArduCopter V3.3.3; Frame: QUAD"), ({}, "Frame: QUAD/X")],
)
def test_a_gimbal_behind_the_motors_of_a_frame_is_no_motor(settings: dict, about: str, tmp_path: Path):
    m = motion(TIME)
    pulses = {f"C{i}": np.full(len(TIME), 1500, "<u2") for i in range(1, 9)}
    pulses |= {f"C{i + 1}": np.round(1000.0 + 1000.0 * m[name]).astype("<u2") for i, name in enumerate(MOTORS)}
    pulses["C6"] = np.round(1500.0 + 300.0 * np.sin(TIME)).astype("<u2")
    rates = floats({f"Gyr{a}": m[n] for a, n in zip("XYZ", "pqr", strict=True)})
    topics = {"IMU": (TIME + 20.0, rates), "RCOU": (TIME + 20.0, pulses)}
    _, channels = imported(write_dataflash(tmp_path / "log.bin", topics, settings, about))
    assert [name for name in channels if name.startswith("motor")] == [*MOTORS]


@pytest.mark.parametrize(("settings", "motors"), [({"SYS_AUTOSTART": 4001}, 4), ({}, 5)])
def test_a_moving_output_behind_the_motors_of_px4(settings: dict, motors: int, tmp_path: Path):
    topics = dict(with_outputs(1000.0, 2000.0, 900.0))
    time, outputs = topics["actuator_outputs"]
    topics["actuator_outputs"] = (time, outputs | floats({"output[4]": 1500.0 + 200.0 * np.sin(time)}))
    done, channels = imported(write_ulog(tmp_path / "log.ulg", topics, settings))
    assert len([name for name in channels if name.startswith("motor")]) == motors
    assert any("no setting says which output drives which motor" in w for w in done.warnings) is (not settings)


def setting(kind: str, name: str, value: float) -> bytes:
    """A setting as a log has it where it changes."""
    if kind == "bin":
        return b"\xa3\x95\x02" + struct.pack("<Q16sf", 9_000_000, name.encode(), value)
    key = f"float {name}".encode()
    return message("P", bytes([len(key)]) + key + struct.pack("<f", value))


@pytest.mark.parametrize("kind", ["ulg", "bin"])
def test_a_range_that_changes_while_it_is_logged_is_told_and_the_last_is_taken(kind: str, tmp_path: Path):
    time, commands = TIME + 5.0, motion(TIME)
    low, high, file = 1100.0, 1900.0, tmp_path / f"log.{kind}"
    outputs = [(low + (high - low) * commands[name]).astype("<f4") for name in MOTORS]
    if kind == "ulg":
        topics = {**px4_topics(seconds=8.0, start=5.0)}
        del topics["actuator_motors"]
        topics["actuator_outputs"] = (time, {f"output[{i}]": values for i, values in enumerate(outputs)})
        write_ulog(file, topics, {"PWM_MIN": 1000.0, "PWM_MAX": 2000.0, "MPC_XY_P": 1.0})
        later = {"PWM_MIN": low, "PWM_MAX": high, "MPC_XY_P": 2.0}
    else:
        rates = floats({f"Gyr{axis}": commands[name] for axis, name in zip("XYZ", "pqr", strict=True)})
        topics = {"IMU": (time, rates), "RCOU": (time, {f"C{i}": v for i, v in enumerate(outputs, 1)})}
        write_dataflash(file, topics, {"MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0, "ATC_RAT_RLL_P": 1.0})
        later = {"MOT_PWM_MIN": low, "MOT_PWM_MAX": high, "ATC_RAT_RLL_P": 2.0}
    file.write_bytes(file.read_bytes() + b"".join(setting(kind, *one) for one in later.items()))
    done, channels = imported(file)
    (told,) = (sentence for sentence in done.warnings if "settings change" in sentence)
    assert all(f"{name} (" in told for name in later if "PWM" in name)
    assert "_P (" not in told
    np.testing.assert_allclose(
        channels["motor1"], np.interp(channels["time"] + time[0], time, commands["motor1"]), atol=2e-3
    )


def test_commands_of_a_simulator_are_read(tmp_path: Path):
    topics = px4_topics(seconds=8.0)
    time, commands = topics.pop("actuator_motors")
    outputs = {f"output[{i}]": commands[f"control[{i}]"] for i in range(4)}
    _, channels = imported(write_ulog(tmp_path / "log.ulg", {**topics, "actuator_outputs_sim": (time, outputs)}))
    np.testing.assert_allclose(
        channels["motor3"], np.interp(channels["time"] + time[0], time, outputs["output[2]"]), atol=1e-3
    )


@pytest.mark.parametrize(("hertz", "stay"), [(200.0, True), (50.0, False)])
def test_speeds_as_fast_as_the_body_rates_stay_beside_faster_commands(hertz: float, stay: bool, tmp_path: Path):
    topics = px4_topics(seconds=8.0, fast=200.0)
    time = topics["vehicle_angular_velocity"][0]
    fine = time[0] + np.arange(0.0, 8.0, 1.0 / 400.0)
    topics["actuator_motors"] = (fine, floats({f"control[{i}]": motion(fine)[name] for i, name in enumerate(MOTORS)}))
    seldom = time[0] + np.arange(0.0, 8.0, 1.0 / hertz)
    turns = {f"esc[{i}].esc_rpm": (6000.0 * motion(seldom)[name]).astype("<i4") for i, name in enumerate(MOTORS)}
    _, channels = imported(write_ulog(tmp_path / "log.ulg", {**topics, "esc_status": (seldom, turns)}))
    assert ("omega1" in channels) == stay
