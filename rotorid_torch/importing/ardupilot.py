"""The built-in map of ArduPilot: Copter's messages by their newer and older names.

Source: ArduPilot, "Onboard Message Log Messages" (Copter); parameters SERVOn_FUNCTION, MOT_PWM_MIN, FRAME_CLASS.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from rotorid_torch.errors import InputError
from rotorid_torch.importing.log import Log
from rotorid_torch.importing.mapping import Entry
from rotorid_torch.importing.plan import Group, Plan, first_or_faster, moving, named, pulse, triple

ATTITUDE = ("Roll", "Pitch", "Yaw")
STATE = ("VN", "VE", "VD", "PN", "PE", "PD")
GROUPS: tuple[tuple[Group, ...], ...] = (
    (
        triple("IMU", "p q r", ("GyrX", "GyrY", "GyrZ")),
        triple("RATE", "p q r", ("R", "P", "Y"), "deg/s"),
    ),
    (triple("IMU", "ax ay az", ("AccX", "AccY", "AccZ")),),
    (
        triple("ATT", "phi theta psi", ATTITUDE, "deg"),
        triple("XKF1", "phi theta psi", ATTITUDE, "deg"),
        triple("NKF1", "phi theta psi", ATTITUDE, "deg"),
        triple("AHR2", "phi theta psi", ATTITUDE, "deg"),
    ),
    tuple(triple(t, "vn ve vd north east height", STATE, "", "+++++-") for t in ("XKF1", "NKF1", "EKF1")),
    (triple("BAT", "voltage", ("Volt",)), triple("CURR", "voltage", ("Volt",))),
    (triple("ARSP", "airspeed", ("Airspeed",)),),
)
"""Per group of channels the messages that may hold them, best first."""
HELICOPTER = (
    Group(
        "RATE",
        {
            "lat": Entry("ROut", "norm"),
            "lon": Entry("POut", "norm"),
            "ped": Entry("YOut", "norm"),
            "col": Entry("AOut", "norm"),
        },
    ),
)
FUNCTIONS = {33 + i: i + 1 for i in range(8)} | {82 + i: i + 9 for i in range(4)}
"""Motor by SERVOn_FUNCTION."""
HELICOPTERS = (6, 11, 13)
"""FRAME_CLASS of a helicopter with one main rotor, two, four."""
OTHERS = {
    "Plane": "a fixed wing",
    "Rover": "a rover",
    "Sub": "a submarine",
    "Tracker": "an antenna",
    "Blimp": "an airship",
}


def fields(topic: str, names: Sequence[str]) -> list[str]:
    """Fields that the map may need."""
    groups = [group for alternatives in (*GROUPS, HELICOPTER) for group in alternatives]
    wanted = {entry.field for group in groups if group.topic == topic for entry in group.entries.values()}
    if topic == "RCOU":
        wanted = {f"C{i}" for i in range(1, 15)}
    elif re.fullmatch("ESC[1-8]?", topic):
        wanted = {"RPM"}
    return [name for name in names if name in wanted]


def plan(log: Log) -> Plan:
    """Channels of an ArduPilot log. Raises InputError where it is of no rotorcraft."""
    other = next(
        (what for name, what in OTHERS.items() if re.search(rf"(Ardu|APM:? ?|Antenna|^){name}", log.about)), ""
    )
    tilted = log.parameters.get("Q_ENABLE", 0.0) > 0
    if other and not (other == "a fixed wing" and tilted):
        told = f"is the log of {other} ({log.about.partition(';')[0][:60]})"
        raise InputError(log.file, "", told, "a helicopter or a multirotor, or --map to name its controls")
    entries: dict[str, Entry] = {}
    for alternatives in GROUPS:
        entries |= first_or_faster(log, alternatives)
    notes = ["Q_ENABLE tells of a VTOL: only its hover is a rotorcraft"] if tilted else []
    if int(log.parameters.get("FRAME_CLASS", 0)) in HELICOPTERS or "H_SW_TYPE" in log.parameters:
        return Plan("helicopter", entries | first_or_faster(log, HELICOPTER), tuple(notes))
    motors, told = _motors(log)
    return Plan("multirotor", entries | motors | _speeds(log, len(motors)), (*notes, *told))


def _motors(log: Log) -> tuple[dict[str, Entry], list[str]]:
    """Motor commands 0 to 1 from the servo outputs that drive motors."""
    if not log.instances("RCOU"):
        return {}, []
    instance = log.instances("RCOU")[0]
    given, columns = log.parameters, log.streams["RCOU", instance].columns
    outputs = {FUNCTIONS[f]: i for i in range(1, 15) if (f := int(given.get(f"SERVO{i}_FUNCTION", 0))) in FUNCTIONS}
    notes = []
    if not outputs:
        outputs = {i: i for i in range(1, 9) if f"C{i}" in columns and moving(columns[f"C{i}"])}
        notes = [f"no SERVOn_FUNCTION says which output drives which motor: RCOU outputs {[*outputs]} are motors"]
    low, high = (given.get(f"MOT_PWM_{end}") or default for end, default in (("MIN", 1000.0), ("MAX", 2000.0)))
    if missing := next((f"C{i}" for _, i in sorted(outputs.items()) if f"C{i}" not in columns), ""):
        raise InputError(log.file, f"RCOU.{missing}", "is missing", "an output for every motor of SERVOn_FUNCTION")
    motors = {f"motor{m}": pulse(f"C{i}", low, high) for m, i in sorted(outputs.items())}
    return named(Group("RCOU", motors), instance), notes if motors else []


def _speeds(log: Log, motors: int) -> dict[str, Entry]:
    """Rotor speeds: instance by instance of ESC, or ESC1, ESC2, ... of older logs."""
    found: dict[str, Entry] = {}
    for number in range(1, motors + 1):
        topic, instance = ("ESC", number - 1) if log.instances("ESC") else (f"ESC{number}", 0)
        stream = log.streams.get((topic, instance))
        if stream is not None and "RPM" in stream.columns and moving(stream.columns["RPM"]):
            found |= named(Group(topic, {f"omega{number}": Entry("RPM", "rpm")}), instance)
    return found
