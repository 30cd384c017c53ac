"""The built-in map of PX4: stock topics by their newer and older names, in ULog and in sdlog2.

Source: PX4 Autopilot, msg/*.msg; MAVLink, MAV_TYPE.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing.log import Log, is_numbers
from rotorid_torch.importing.mapping import Entry
from rotorid_torch.importing.plan import Group, Plan, first_or_faster, moving, named, pulse, triple

XYZ = ("xyz[0]", "xyz[1]", "xyz[2]")
Q = ("q[0]", "q[1]", "q[2]", "q[3]")
GROUPS: tuple[tuple[Group, ...], ...] = (
    (
        triple("vehicle_angular_velocity", "p q r", XYZ),
        triple("sensor_combined", "p q r", [f"gyro_rad[{i}]" for i in range(3)]),
        triple("IMU", "p q r", ("GyroX", "GyroY", "GyroZ")),
    ),
    (
        triple("vehicle_acceleration", "ax ay az", XYZ),
        triple("sensor_combined", "ax ay az", [f"accelerometer_m_s2[{i}]" for i in range(3)]),
        triple("IMU", "ax ay az", ("AccX", "AccY", "AccZ")),
    ),
    (
        triple("vehicle_attitude", "q0 q1 q2 q3", Q),
        triple("ATT", "q0 q1 q2 q3", ("qw", "qx", "qy", "qz")),
        triple("ATT", "phi theta psi", ("Roll", "Pitch", "Yaw")),
    ),
    (
        triple("vehicle_local_position", "vn ve vd north east height", ("vx", "vy", "vz", "x", "y", "z"), "", "+++++-"),
        triple("LPOS", "vn ve vd north east height", ("VX", "VY", "VZ", "X", "Y", "Z"), "", "+++++-"),
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
)
THRUST = (Group("vehicle_thrust_setpoint", {"col": Entry("xyz[2]", "norm", -1)}),)
MOTORS, PULSES, ESC = "actuator_motors", "actuator_outputs", "esc_status"
MOST = 12
EXTRA = {
    MOTORS: [f"control[{i}]" for i in range(MOST)],
    PULSES: [f"output[{i}]" for i in range(16)],
    "OUT0": [f"Out{i}" for i in range(8)],
    ESC: [f"esc[{i}].esc_rpm" for i in range(MOST)],
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


def fields(topic: str, names: Sequence[str]) -> list[str]:
    """Fields that the map may need."""
    groups = [group for alternatives in (*GROUPS, HELICOPTER, THRUST) for group in alternatives]
    wanted = {entry.field for group in groups if group.topic == topic for entry in group.entries.values()}
    return [name for name in names if name in wanted or name in EXTRA.get(topic, ())]


def plan(log: Log) -> Plan:
    """Channels of a PX4 log. Raises InputError where it is of no rotorcraft."""
    kind = int(log.parameters.get("MAV_TYPE", 0))
    if kind in OTHERS:
        told = f"is the log of {OTHERS[kind]} (MAV_TYPE {kind})"
        raise InputError(log.file, "", told, "a helicopter or a multirotor, or --map to name its controls")
    notes = [f"MAV_TYPE {kind} is a VTOL: only its hover is a rotorcraft"] if kind in VTOL else []
    entries: dict[str, Entry] = {}
    for alternatives in GROUPS:
        entries |= first_or_faster(log, alternatives)
    if kind == 4:
        controls = first_or_faster(log, HELICOPTER)
        controls |= {} if "col" in controls else first_or_faster(log, THRUST)
        return Plan("helicopter", entries | controls, tuple(notes))
    motors, told = _motors(log, MOTORS_OF.get(kind, 0))
    return Plan(
        "multirotor", entries | motors | _speeds(log, len(motors)), (*notes, *told), _geometry(log, len(motors))
    )


def _motors(log: Log, number: int) -> tuple[dict[str, Entry], list[str]]:
    """Motor commands 0 to 1, and how they were found."""
    if log.instances(MOTORS):
        columns = log.streams[MOTORS, log.instances(MOTORS)[0]].columns
        used = [i for i in range(MOST) if np.isfinite(columns.get(f"control[{i}]", np.array([np.nan]))).any()]
        motors = {f"motor{n}": Entry(f"control[{i}]", "norm") for n, i in enumerate(used[: number or MOST], 1)}
        return named(Group(MOTORS, motors), log.instances(MOTORS)[0]), []
    topic = next((t for t in (PULSES, "OUT0") if log.instances(t)), "")
    if not topic:
        return {}, []
    form = "Out{}" if topic == "OUT0" else "output[{}]"
    stirred = {
        instance: sum(map(moving, _outputs(log, topic, instance, form, number)[: number or 8]))
        for instance in log.instances(topic)
    }
    chosen = max(stirred, key=lambda instance: stirred[instance])
    notes = []
    if len(stirred) > 1:
        why = "most outputs move there" if stirred[chosen] else "no output moves in any"
        notes = [f"{topic} has instances {', '.join(map(str, stirred))}: {chosen} is used ({why})"]
    outputs = _outputs(log, topic, chosen, form, number)
    count = number or sum(map(moving, outputs[:8])) or 4
    motors = {f"motor{i + 1}": _command(log, form.format(i), values) for i, values in enumerate(outputs[:count])}
    return named(Group(topic, motors), chosen), notes


def _outputs(log: Log, topic: str, instance: int, form: str, number: int) -> list[np.ndarray]:
    """Outputs of one instance in a row. Raises InputError where one is missing before the last, or of so many."""
    columns = log.streams[topic, instance].columns
    there = [i for i in range(16) if form.format(i) in columns and is_numbers(columns[form.format(i)])]
    count = max(number, 4, there[-1] + 1 if there else 0)
    if missing := next((form.format(i) for i in range(count) if i not in there), ""):
        raise InputError(
            log.file, f"{topic}.{missing}", "is missing", f"outputs {form.format(0)} to {form.format(count - 1)}"
        )
    return [columns[form.format(i)] for i in range(count)]


def _command(log: Log, name: str, values: np.ndarray) -> Entry:
    """Entry of an output, by its size: pulses in us, thousandths (simulation), or 0 to 1."""
    largest = float(np.nanmax(values, initial=0.0))
    if largest <= 1.5:
        return Entry(name, "norm")
    if largest <= 1000.0 and float(np.nanmin(values, initial=1000.0)) < 700.0:
        return Entry(name, "norm", 1, 1e-3)
    given = log.parameters
    low = given.get("PWM_MIN") or given.get("PWM_MAIN_MIN", 1000.0)
    return pulse(name, low, given.get("PWM_MAX") or given.get("PWM_MAIN_MAX", 2000.0))


def _speeds(log: Log, motors: int) -> dict[str, Entry]:
    """Rotor speeds, where a speed controller told any."""
    if not log.instances(ESC) or not motors:
        return {}
    instance = log.instances(ESC)[0]
    columns = log.streams[ESC, instance].columns
    turning = [i for i in range(motors) if moving(columns.get(f"esc[{i}].esc_rpm", np.zeros(1)))]
    return named(Group(ESC, {f"omega{i + 1}": Entry(f"esc[{i}].esc_rpm", "rpm") for i in turning}), instance)


def _geometry(log: Log, motors: int) -> dict[str, object]:
    """Places and spins of the motors from the control allocation's settings, where all of them are there."""
    if int(log.parameters.get("CA_ROTOR_COUNT", 0)) != motors or not motors:
        return {}
    keys = [[f"CA_ROTOR{i}_{axis}" for axis in ("PX", "PY", "PZ", "KM")] for i in range(motors)]
    if not all(key in log.parameters for row in keys for key in row):
        return {}
    rows = [[round(log.parameters[key], 6) for key in row] for row in keys]
    return {"motors": [{"position": row[:3], "spin": "ccw" if row[3] > 0 else "cw"} for row in rows]}
