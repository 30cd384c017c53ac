"""The built-in map of PX4: stock topics by their newer and older names, in ULog and in sdlog2.

Source: PX4 Autopilot, msg/*.msg; MAVLink, MAV_TYPE.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing import frames
from rotorid_torch.importing.signals import resets
from rotorid_torch.importing.signals.mapping import Entry
from rotorid_torch.importing.signals.outputs import of_px4, range_of
from rotorid_torch.importing.signals.plan import (
    FASTER,
    Chosen,
    Group,
    Plan,
    first_or_faster,
    imu_line,
    lowest,
    merged,
    moving,
    named,
    rate_of,
    triple,
)
from rotorid_torch.importing.signals.streams import Log, Stream, is_numbers

XYZ = ("xyz[0]", "xyz[1]", "xyz[2]")
Q = ("q[0]", "q[1]", "q[2]", "q[3]")
POSITION = ("vx", "vy", "vz", "x", "y", "z")
GROUPS: tuple[tuple[Group, ...], ...] = (
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
        triple("vehicle_attitude", "q0 q1 q2 q3", Q),
        triple("estimator_attitude", "q0 q1 q2 q3", Q, spare=True),
        triple("ATT", "q0 q1 q2 q3", ("qw", "qx", "qy", "qz")),
        triple("ATT", "phi theta psi", ("Roll", "Pitch", "Yaw")),
    ),
    (
        triple("vehicle_local_position", "vn ve vd north east height", POSITION, "", "+++++-"),
        triple("estimator_local_position", "vn ve vd north east height", POSITION, "", "+++++-", spare=True),
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
MOTORS, PULSES, OLDER, ESC = "actuator_motors", "actuator_outputs", "OUT0", "esc_status"
MOST = 12
WIRED = ("PWM_MAIN", "PWM_AUX", "UAVCAN_EC", "HIL_ACT", "PCA9685")
"""Groups of outputs; a setting PREFIX_FUNCn says what output n of a group drives."""
FIRST_MOTOR = 101
"""Function of the first motor."""
SELECTED = {"sensor_gyro": "gyro_device_id", "sensor_accel": "accel_device_id"}
"""Topics of single sensors, with the field of `sensor_selection` that names the one flown with."""
SELECTOR = "estimator_selector_status"
EXTRA = {
    MOTORS: [f"control[{i}]" for i in range(MOST)],
    PULSES: [f"output[{i}]" for i in range(16)],
    OLDER: [f"Out{i}" for i in range(8)],
    ESC: [f"esc[{i}].{name}" for i in range(MOST) for name in ("esc_rpm", "actuator_function")],
    "sensor_selection": [*SELECTED.values()],
    SELECTOR: ["primary_instance"],
    **{topic: ["device_id"] for topic in SELECTED},
    **{topic: [name for reset in some for name in reset.fields] for topic, some in resets.PX4.items()},
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
    chosen = [first_or_faster(log, alternatives, lambda t, n: _instance(log, t, n)) for alternatives in GROUPS]
    place = imu_line(log.parameters, [f"EKF2_IMU_POS_{axis}" for axis in "XYZ"])
    if kind == HELICOPTER_TYPE:
        controls = first_or_faster(log, HELICOPTER)
        thrust = Chosen() if "col" in controls.entries else first_or_faster(log, THRUST)
        return replace(merged("helicopter", [*chosen, controls, thrust], notes), known=place)
    number = MOTORS_OF.get(kind, 0)
    motors, outputs = _motors(log, number)
    speeds, wrong = _speeds(log, outputs, number)
    plan = merged("multirotor", [*chosen, motors, speeds], [*notes, *wrong], _geometry(log, len(motors.entries)))
    return replace(plan, frame=frames.of_px4(log.parameters), known=place)


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


def _instance(log: Log, topic: str, numbers: Sequence[int]) -> tuple[int, str]:
    """Instance of a topic that the vehicle flew with: the selected sensor, the primary estimator; else the lowest."""
    left = f"; {', '.join(map(str, numbers))} are there" if len(numbers) > 1 else ""
    if topic in SELECTED and log.instances("sensor_selection"):
        wanted = _last(log.streams["sensor_selection", log.instances("sensor_selection")[0]], SELECTED[topic])
        for number in numbers:
            if wanted is not None and _last(log.streams[topic, number], "device_id") == wanted:
                return number, f"instance {number}, by sensor_selection{left}" if left else ""
    if topic.startswith("estimator_") and log.instances(SELECTOR):
        primary = _last(log.streams[SELECTOR, log.instances(SELECTOR)[0]], "primary_instance")
        if primary is not None and int(primary) in numbers:
            return int(primary), f"instance {int(primary)}, primary by {SELECTOR}{left}" if left else ""
    return lowest(topic, numbers)


def _last(stream: Stream, name: str) -> float | None:
    """The last value of a column that is not zero, or that is all there is; None without one."""
    values = stream.columns.get(name, np.empty(0))
    if not is_numbers(values) or not len(values):
        return None
    used = values[values != 0]
    return float(used[-1] if len(used) and name.endswith("_id") else values[-1])


def _motors(log: Log, number: int) -> tuple[Chosen, str]:
    """Motor commands 0 to 1 from the faster of their sources, and the group of outputs (`PWM_MAIN`, ...)."""
    commands = _commands(log, number)
    prefix, outputs = _group(log)
    topic = next((t for t in (PULSES, OLDER) if log.instances(t)), "")
    hertz = max((rate_of(log.streams[topic, i].time) for i in log.instances(topic)), default=0.0)
    if not topic or (commands.entries and hertz <= FASTER * commands.hertz):
        return commands, prefix
    actuators = _from_outputs(log, topic, prefix, outputs, number)
    if not commands.entries:
        return actuators, prefix
    if not any(
        moving(log.stream(log.source(e.field, c)).columns[log.source(e.field, c).field])
        for c, e in actuators.entries.items()
    ):
        return commands, prefix
    reason = f"{MOTORS} left: {commands.hertz:.3g} Hz against {actuators.hertz:.3g} Hz"
    return replace(actuators, reason="; ".join(filter(None, (actuators.reason, reason)))), prefix


def _commands(log: Log, number: int) -> Chosen:
    """Commands as the control allocation gave them; one that is never a number drives nothing."""
    if not log.instances(MOTORS):
        return Chosen()
    instance = log.instances(MOTORS)[0]
    stream = log.streams[MOTORS, instance]
    logged = {i: stream.columns[name] for i in range(MOST) if (name := f"control[{i}]") in stream.columns}
    used = [i for i, values in logged.items() if is_numbers(values) and np.isfinite(values).any()]
    motors = {f"motor{i + 1}": Entry(f"control[{i}]", "norm") for i in used[: number or MOST]}
    return Chosen(named(Group(MOTORS, motors), instance), rate_of(stream.time))


def _group(log: Log) -> tuple[str, dict[int, int]]:
    """The group of outputs that drives most motors by its functions, with the output (from 1) of each motor."""
    groups: dict[str, dict[int, int]] = {}
    for prefix in WIRED:
        functions = {n: int(log.parameters.get(f"{prefix}_FUNC{n}", 0)) for n in range(1, 17)}
        motors = {f - FIRST_MOTOR + 1: n for n, f in functions.items() if 0 <= f - FIRST_MOTOR < MOST}
        groups[prefix] = dict(sorted(motors.items()))
    best = max(groups, key=lambda prefix: len(groups[prefix]))
    return (best, groups[best]) if groups[best] else ("", {})


def _from_outputs(log: Log, topic: str, prefix: str, wired: Mapping[int, int], number: int) -> Chosen:
    """Commands from what the outputs were told, by what each of them drives and by the range of its protocol."""
    form = "Out{}" if topic == OLDER else "output[{}]"
    places = [n - 1 for n in wired.values()]

    def stirred(instance: int) -> int:
        outputs = _outputs(log, topic, instance, form, number)
        return sum(map(moving, [outputs[i] for i in places if i < len(outputs)] or outputs[: number or 8]))

    counts = {instance: stirred(instance) for instance in log.instances(topic)}
    later = prefix not in ("", WIRED[0])  # drivers publish in this order, PWM_MAIN first
    chosen = max(counts, key=lambda instance: (counts[instance], instance if later else -instance))
    reason = ""
    if len(counts) > 1:
        why = (
            f"most outputs{f' of {prefix}' if prefix else ''} move there"
            if counts[chosen]
            else "no output moves in any"
        )
        reason = f"{topic} has instances {', '.join(map(str, counts))}: {chosen} is used ({why})"
    outputs = _outputs(log, topic, chosen, form, number)
    count = number or sum(map(moving, outputs[:8])) or 4
    motors = wired or {m: m for m in range(1, count + 1)}
    group = prefix or ("PWM_AUX" if chosen == 1 else "PWM_MAIN")
    entries = {}
    for motor, output in motors.items():
        if output > len(outputs):
            raise InputError(
                log.file, f"{topic}.{form.format(output - 1)}", "is missing", f"the output of motor {motor}"
            )
        field, raw = form.format(output - 1), [outputs[n - 1] for n in motors.values() if n <= len(outputs)]
        allowed = of_px4(log.parameters, group, output, raw)
        fitting = range_of(log.file, f"{topic}.{field} (motor{motor})", outputs[output - 1], allowed)
        entries[f"motor{motor}"] = fitting.entry(field)
    hertz = rate_of(log.streams[topic, chosen].time)
    return Chosen(named(Group(topic, entries), chosen), hertz, reason)


def _outputs(log: Log, topic: str, instance: int, form: str, number: int) -> list[np.ndarray]:
    """Outputs of one instance in a row. Raises InputError where one is missing before the last, or of so many."""
    columns = log.streams[topic, instance].columns
    logged = [i for i in range(16) if form.format(i) in columns and is_numbers(columns[form.format(i)])]
    count = max(number, 4, logged[-1] + 1 if logged else 0)
    if missing := next((form.format(i) for i in range(count) if i not in logged), ""):
        raise InputError(
            log.file, f"{topic}.{missing}", "is missing", f"outputs {form.format(0)} to {form.format(count - 1)}"
        )
    return [columns[form.format(i)] for i in range(count)]


def _speeds(log: Log, prefix: str, number: int) -> tuple[Chosen, list[str]]:
    """Rotor speeds by motor: a speed controller belongs to the motor of its function, or of its output."""
    if not log.instances(ESC):
        return Chosen(missing=f"omega1 omega2 ... (no {ESC})"), []
    instance = log.instances(ESC)[0]
    stream = log.streams[ESC, instance]
    turning = [i for i in range(MOST) if moving(stream.columns.get(f"esc[{i}].esc_rpm", np.zeros(1)))]
    motors = {i: _motor_of(log, stream, prefix, i) for i in turning}
    notes = [f"esc[{i}] drives no motor: its speed is left out" for i, motor in motors.items() if not motor]
    pairs = sorted((motor, i) for i, motor in motors.items() if motor and (not number or motor <= number))
    if len({motor for motor, _ in pairs}) < len(pairs):
        return Chosen(), [*notes, "two speed controllers name the same motor: rotor speeds are left out"]
    entries = {f"omega{motor}": Entry(f"esc[{i}].esc_rpm", "rpm") for motor, i in pairs}
    crossed = ", ".join(f"esc[{i}] is motor {motor}" for motor, i in pairs if motor != i + 1)
    return Chosen(named(Group(ESC, entries), instance), rate_of(stream.time), crossed), notes


def _motor_of(log: Log, stream: Stream, prefix: str, index: int) -> int:
    """Motor (from 1) that a speed controller drives; 0 where it drives something else."""
    function = _last(stream, f"esc[{index}].actuator_function")
    if not function and prefix:
        function = log.parameters.get(f"{prefix}_FUNC{index + 1}")
    if not function:
        return index + 1
    motor = int(function) - FIRST_MOTOR + 1
    return motor if 1 <= motor <= MOST else 0


def _geometry(log: Log, motors: int) -> dict[str, object]:
    """Places and spins of the motors from the control allocation's settings, where all of them are there."""
    if int(log.parameters.get("CA_ROTOR_COUNT", 0)) != motors or not motors:
        return {}
    keys = [[f"CA_ROTOR{i}_{axis}" for axis in ("PX", "PY", "PZ", "KM")] for i in range(motors)]
    if not all(key in log.parameters for row in keys for key in row):
        return {}
    rows = [[round(log.parameters[key], 6) for key in row] for row in keys]
    return {"motors": [{"position": row[:3], "spin": "ccw" if row[3] > 0 else "cw"} for row in rows]}
