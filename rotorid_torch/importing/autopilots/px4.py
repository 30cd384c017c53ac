"""The built-in map of PX4: stock topics by their newer and older names, in ULog and in sdlog2.

Source: PX4 Autopilot, msg/*.msg; MAVLink, MAV_TYPE.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing import frames
from rotorid_torch.importing.autopilots import px4_odometry
from rotorid_torch.importing.autopilots.px4_motors import FIELDS, last, motors, speeds
from rotorid_torch.importing.signals import resets
from rotorid_torch.importing.signals.mapping import Entry
from rotorid_torch.importing.signals.plan import (
    Chosen,
    Group,
    Plan,
    first_or_faster,
    imu_line,
    lowest,
    merged,
    triple,
)
from rotorid_torch.importing.signals.streams import Log, is_numbers

XYZ = ("xyz[0]", "xyz[1]", "xyz[2]")
Q = ("q[0]", "q[1]", "q[2]", "q[3]")
POSITION = ("vx", "vy", "vz", "x", "y", "z")
ATTITUDES = (
    triple("vehicle_attitude", "q0 q1 q2 q3", Q),
    triple("estimator_attitude", "q0 q1 q2 q3", Q),
    triple("ATT", "q0 q1 q2 q3", ("qw", "qx", "qy", "qz")),
    triple("ATT", "phi theta psi", ("Roll", "Pitch", "Yaw")),
)
PLACES = (
    triple("vehicle_local_position", "vn ve vd north east height", POSITION, "", "+++++-"),
    triple("estimator_local_position", "vn ve vd north east height", POSITION, "", "+++++-"),
    triple("LPOS", "vn ve vd north east height", ("VX", "VY", "VZ", "X", "Y", "Z"), "", "+++++-"),
)
GROUPS: tuple[tuple[Group, ...], ...] = (
    ATTITUDES,
    PLACES,
    (
        triple("vehicle_angular_velocity", "p q r", XYZ),
        triple("sensor_combined", "p q r", [f"gyro_rad[{i}]" for i in range(3)]),
        triple("sensor_gyro", "p q r", ("x", "y", "z"), spare=True),
        triple("IMU", "p q r", ("GyroX", "GyroY", "GyroZ")),
    ),
    (
        triple("vehicle_acceleration", "ax ay az", XYZ),
        triple("sensor_combined", "ax ay az", [f"accelerometer_m_s2[{i}]" for i in range(3)]),
        triple("sensor_accel", "ax ay az", ("x", "y", "z"), spare=True),
        triple("IMU", "ax ay az", ("AccX", "AccY", "AccZ")),
    ),
    (
        triple("battery_status", "voltage", ("voltage_v",)),
        triple("BATT", "voltage", ("V",)),
    ),
    (
        triple("airspeed_validated", "airspeed", ("true_airspeed_m_s",)),
        triple("airspeed", "airspeed", ("true_airspeed_m_s",)),
    ),
)
"""Per group of channels the topics that may hold them, best first."""
HELICOPTER = (
    Group(
        "vehicle_torque_setpoint",
        {"lat": Entry("xyz[0]", "norm"), "lon": Entry("xyz[1]", "norm"), "ped": Entry("xyz[2]", "norm")},
    ),
    Group(
        "actuator_controls_0",
        {
            "lat": Entry("control[0]", "norm"),
            "lon": Entry("control[1]", "norm"),
            "ped": Entry("control[2]", "norm"),
            "col": Entry("control[3]", "norm"),
        },
    ),
    Group(
        "ATTC",
        {
            "lat": Entry("Roll", "norm"),
            "lon": Entry("Pitch", "norm"),
            "ped": Entry("Yaw", "norm"),
            "col": Entry("Thrust", "norm"),
        },
    ),
)
THRUST = (Group("vehicle_thrust_setpoint", {"col": Entry("xyz[2]", "norm", -1)}),)
SELECTED = {"sensor_gyro": "gyro_device_id", "sensor_accel": "accel_device_id"}
"""Topics of single sensors, with the field of `sensor_selection` that names the one flown with."""
SELECTOR = "estimator_selector_status"
VALID = {"xy_valid": "north east", "z_valid": "height", "v_xy_valid": "vn ve", "v_z_valid": "vd"}
"""Flags of a local position, and the channels that mean nothing where they are not set."""
EXTRA = {
    **FIELDS,
    px4_odometry.TOPIC: px4_odometry.FIELDS,
    "sensor_selection": [*SELECTED.values()],
    SELECTOR: ["primary_instance"],
    **{topic: ["device_id"] for topic in SELECTED},
    **{topic: [name for reset in some for name in reset.fields] + [*VALID] for topic, some in resets.PX4.items()},
}
MOTORS_OF = {2: 4, 3: 2, 13: 6, 14: 8, 15: 3, 19: 2, 20: 4, 21: 4, 22: 4, 29: 12, 35: 10}
"""Motors by MAV_TYPE."""
VTOL = (19, 20, 21, 22, 23, 24, 25)
OTHERS = {
    1: "a fixed wing",
    7: "an airship",
    8: "a balloon",
    9: "a rocket",
    10: "a rover",
    11: "a boat",
    12: "a submarine",
}
HELICOPTER_TYPE = 4
AIRFRAMES = {1: 1, 2: 22, 3: 21, 4: 19, 5: 10, 6: 10, 10: 4, 11: 4, 12: 4}
"""MAV_TYPE by CA_AIRFRAME, where that says more than "multirotor"."""
STARTS = ((2000, 2999, 1), (3000, 3999, 1), (13000, 13999, 22), (16000, 16999, 4))
"""MAV_TYPE by SYS_AUTOSTART: first and last number of a class of airframes."""


def fields(topic: str, names: Sequence[str]) -> list[str]:
    """Fields that the map may need."""
    groups = [group for alternatives in (*GROUPS, HELICOPTER, THRUST) for group in alternatives]
    wanted = {entry.field for group in groups if group.topic == topic for entry in group.entries.values()}
    return [name for name in names if name in wanted or name in EXTRA.get(topic, ())]


def plan(log: Log) -> Plan:
    """Channels of a PX4 log. Raises InputError where it is of no rotorcraft."""
    kind, notes = _kind(log)
    if kind in OTHERS:
        wrong = f"is the log of {OTHERS[kind]} (MAV_TYPE {kind})"
        raise InputError(log.file, "", wrong, "a helicopter or a multirotor, or --map to name its controls")
    notes += [f"MAV_TYPE {kind} is a VTOL: only its hover is a rotorcraft"] if kind in VTOL else []
    alone = not any(log.instances(group.topic) for group in (*ATTITUDES, *PLACES))
    *spare, said = px4_odometry.spare(log, alone)
    chosen = [
        first_or_faster(log, (*alternatives, *more), lambda t, n: _instance(log, t, n))
        for alternatives, more in zip_longest(GROUPS, spare, fillvalue=())
    ]
    notes += said
    chosen = [_valid(log, one) for one in chosen]
    place = imu_line(log.parameters, [f"EKF2_IMU_POS_{axis}" for axis in "XYZ"])
    if kind == HELICOPTER_TYPE:
        controls = first_or_faster(log, HELICOPTER)
        thrust = Chosen() if "col" in controls.entries else first_or_faster(log, THRUST)
        return replace(merged("helicopter", [*chosen, controls, thrust], notes), lines=place)
    number = _number(log, kind)
    commands, group = motors(log, number)
    turning, wrong = speeds(log, group, number)
    plan = merged("multirotor", [*chosen, commands, turning], [*notes, *wrong], _geometry(log, len(commands.entries)))
    return replace(plan, frame=frames.of_px4(log.parameters), lines=place)


def _kind(log: Log) -> tuple[int, list[str]]:
    """MAV_TYPE by all that settings say, and a sentence where they do not agree."""
    parameters = log.parameters
    said = {
        "MAV_TYPE": int(parameters.get("MAV_TYPE", 0)),
        "CA_AIRFRAME": AIRFRAMES.get(int(parameters.get("CA_AIRFRAME", -1)), 0),
    }
    start = int(parameters.get("SYS_AUTOSTART", 0))
    said["SYS_AUTOSTART"] = next((kind for low, high, kind in STARTS if low <= start <= high), 0)
    of_helicopter = [key for key, kind in said.items() if kind == HELICOPTER_TYPE]
    if of_helicopter and said["MAV_TYPE"] not in (0, HELICOPTER_TYPE):
        reason = (
            f"{of_helicopter[0]} {parameters[of_helicopter[0]]:g} is a helicopter's, MAV_TYPE {said['MAV_TYPE']} is not"
        )
        return HELICOPTER_TYPE, [f"{reason}: taken for a helicopter"]
    return next((kind for kind in said.values() if kind), 0), []


def _number(log: Log, kind: int) -> int:
    """Number of motors: that of the control allocation, but for vehicles that need some of them to fly forward only."""
    allocated = 0 if kind in VTOL else int(log.parameters.get("CA_ROTOR_COUNT", 0))
    return allocated if allocated > 0 else MOTORS_OF.get(kind, 0) or frames.motors_of_px4(log.parameters)


def _instance(log: Log, topic: str, numbers: Sequence[int]) -> tuple[int, str]:
    """Instance of a topic that the vehicle flew with: the selected sensor, the primary estimator; else the lowest."""
    left = f"; {', '.join(map(str, numbers))} are there" if len(numbers) > 1 else ""
    if topic in SELECTED and log.instances("sensor_selection"):
        wanted = last(log.streams["sensor_selection", log.instances("sensor_selection")[0]], SELECTED[topic])
        for number in numbers:
            if wanted is not None and last(log.streams[topic, number], "device_id") == wanted:
                return number, f"instance {number}, by sensor_selection{left}" if left else ""
    if topic.startswith("estimator_") and log.instances(SELECTOR):
        primary = last(log.streams[SELECTOR, log.instances(SELECTOR)[0]], "primary_instance")
        if primary is not None and int(primary) in numbers:
            return int(primary), f"instance {int(primary)}, primary by {SELECTOR}{left}" if left else ""
    return lowest(topic, numbers)


def _valid(log: Log, chosen: Chosen) -> Chosen:
    """Position and velocity without the channels that the estimator never called valid."""
    if "vn" not in chosen.entries:
        return chosen
    stream, left, partly = log.stream(log.source(chosen.entries["vn"].field, "vn")), list[str](), list[str]()
    for flag, channels in VALID.items():
        values = stream.columns.get(flag, np.empty(0))
        if not is_numbers(values) or not len(values) or (share := float((values != 0).mean())) == 1.0:
            continue
        words = channels.replace(" ", ", ")
        left += channels.split() if share == 0.0 else []
        partly.append(
            f"{words} left: {flag} is never set" if share == 0.0 else f"{flag} is set for {share:.0%} of the log"
        )
    entries = {name: entry for name, entry in chosen.entries.items() if name not in left}
    reason = "; ".join(filter(None, (chosen.reason, *partly)))
    return (
        Chosen(entries, chosen.hertz, reason) if entries else Chosen(missing=f"vn ve vd north east height ({reason})")
    )


def _geometry(log: Log, motors: int) -> dict[str, object]:
    """Places and spins of the motors from the control allocation's settings, where all of them are there."""
    if int(log.parameters.get("CA_ROTOR_COUNT", 0)) != motors or not motors:
        return {}
    keys = [[f"CA_ROTOR{i}_{axis}" for axis in ("PX", "PY", "PZ", "KM")] for i in range(motors)]
    if not all(key in log.parameters for row in keys for key in row):
        return {}
    rows = [[round(log.parameters[key], 6) for key in row] for row in keys]
    return {"motors": [{"position": row[:3], "spin": "ccw" if row[3] > 0 else "cw"} for row in rows]}
