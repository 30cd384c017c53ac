"""The built-in map of ArduPilot: Copter's messages by their newer and older names.

Source: ArduPilot, "Onboard Message Log Messages" (Copter); parameters SERVOn_FUNCTION, MOT_PWM_MIN, FRAME_CLASS,
EK3_IMU_MASK, INS_USE, AHRS_EKF_TYPE.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing import frames
from rotorid_torch.importing.signals.mapping import Entry
from rotorid_torch.importing.signals.outputs import (
    OF_THE_SERVO,
    TWO_WAYS,
    both_ways_in_ardupilot,
    of_ardupilot,
    range_of,
)
from rotorid_torch.importing.signals.plan import (
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

ATTITUDE = ("Roll", "Pitch", "Yaw")
STATE = ("VN", "VE", "VD", "PN", "PE", "PD")
GYRO, FORCE = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
FILTERS = {3: ("XKF1", "XKF6", "XKF4"), 2: ("NKF1", "NKF6", "NKF4")}
"""By AHRS_EKF_TYPE: topic of the states, of those of core 1 in older logs, and of what tells the primary core."""
SENSED = ("IMU", "IMU2", "IMU3")
COMMON: tuple[tuple[Group, ...], ...] = (
    (triple("BAT", "voltage", ("Volt",)), triple("CURR", "voltage", ("Volt",))),
    (triple("ARSP", "airspeed", ("Airspeed",)),),
)
"""Per group of channels the messages that may hold them, best first."""
SWASH = (Group("SWSH", {"col": Entry("Col", "deg"), "lon": Entry("Pit", "deg"), "lat": Entry("Rol", "deg")}),)
"""Blade angles that the swashplate makes."""
STICKS = (
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
"""What the controller asks of the axes of a helicopter."""
ROTOR = (
    *(triple("RPM", "omega", (sensor,), "rpm") for sensor in ("rpm1", "rpm2", "RPM")),
    triple("HELI", "omega", ("ERRPM",), "rpm"),
)
FUNCTIONS = {
    **{33 + i: i + 1 for i in range(8)},
    **{82 + i: i + 9 for i in range(4)},
    **{160 + i: i + 13 for i in range(20)},
}
"""Motor by SERVOn_FUNCTION."""
OUTPUTS = {"RCOU": range(1, 15), "RCO2": range(15, 19), "RCO3": range(19, 33)}
TRICOPTER, TAIL = 7, 39
"""FRAME_CLASS of a tricopter, and the function of the servo that tilts its tail motor (elsewhere motor 7)."""
OLD_TRICOPTER, OLD_TAIL = {1: 1, 2: 2, 4: 4}, 7
"""Output of each motor, and of the tail's servo, of firmware without SERVOn_FUNCTION."""
FINS = (8, 9)
"""FRAME_CLASS of vehicles whose motors 1 to 4 are fins in the wake."""
HELICOPTERS = (6, 11, 13)
"""FRAME_CLASS of a helicopter with one main rotor, two, four."""
OTHERS = {
    "Plane": "a fixed wing",
    "Rover": "a rover",
    "Sub": "a submarine",
    "Tracker": "an antenna",
    "Blimp": "an airship",
}
EXTRA = {
    **{topic: [f"{c}{i}" for i in outputs for c in ("C", "Ch")] for topic, outputs in OUTPUTS.items()},
    **{topic: ["PI", "OFN", "OFE"] for topic in ("XKF4", "NKF4")},
    **{topic: ["GH", "AH"] for topic in SENSED},
    **{topic: ["RPM"] for topic in ("ESC", *(f"ESC{i}" for i in range(1, 9)))},
    "EV": ["Id"],
    "ERR": ["Subsys", "ECode"],
    "RCIN": [f"C{i}" for i in range(1, 9)],
}


def fields(topic: str, names: Sequence[str]) -> list[str]:
    """Fields that the map may need."""
    primary = [_groups(kind, core, number) for kind in FILTERS for core in (0, 1) for number in (0, 1, 2)]
    groups = [g for some in (*primary, COMMON, (SWASH, STICKS, ROTOR)) for alternatives in some for g in alternatives]
    wanted = {entry.field for group in groups if group.topic == topic for entry in group.entries.values()}
    return [name for name in names if name in wanted or name in EXTRA.get(topic, ())]


def _groups(kind: int, core: int, imu: int) -> tuple[tuple[Group, ...], ...]:
    """Messages of rates, specific force, attitude and state; `core` and `imu` choose those of older logs."""
    filters = (kind, *(other for other in FILTERS if other != kind))
    states = [topic for one in filters for topic in (FILTERS[one][:1] if core == 0 else FILTERS[one][1::-1])]
    sensor = SENSED[imu] if imu < len(SENSED) else SENSED[0]
    sensed = [sensor] if sensor == SENSED[0] else [sensor, SENSED[0]]
    attitude = [triple(topic, "phi theta psi", ATTITUDE, "deg") for topic in ("ATT", *states)]
    attitude.append(triple("AHR2", "phi theta psi", ATTITUDE, "deg", spare=True))
    return (
        (
            *(triple(t, "p q r", GYRO) for t in sensed),
            triple("RATE", "p q r", ("R", "P", "Y"), "deg/s"),
            triple("GYR", "p q r", GYRO),
        ),
        (*(triple(t, "ax ay az", FORCE) for t in sensed), triple("ACC", "ax ay az", FORCE)),
        tuple(attitude),
        tuple(triple(t, "vn ve vd north east height", STATE, "", "+++++-") for t in (*states, "EKF1")),
    )


def plan(log: Log) -> Plan:
    """Channels of an ArduPilot log. Raises InputError where it is of no rotorcraft."""
    other = next(
        (what for name, what in OTHERS.items() if re.search(rf"(Ardu|APM:? ?|Antenna|^){name}", log.about)), ""
    )
    tilted = log.parameters.get("Q_ENABLE", 0.0) > 0
    if other and not (other == "a fixed wing" and tilted):
        wrong = f"is the log of {other} ({log.about.partition(';')[0][:60]})"
        raise InputError(log.file, "", wrong, "a helicopter or a multirotor, or --map to name its controls")
    log = replace(log, parameters=_as_of_a_copter(log.parameters)) if tilted else log
    notes = ["Q_ENABLE tells of a VTOL: only its hover is a rotorcraft"] if tilted else []
    flown = _Flown(log)
    chosen = [first_or_faster(log, some, flown.instance) for some in (*flown.groups, *COMMON)]
    if evidence := _helicopter(log):
        sticks, wrong = _sticks(log)
        helicopter = merged("helicopter", [*chosen, *sticks, first_or_faster(log, ROTOR)], [*notes, evidence, *wrong])
        return replace(helicopter, lines=flown.place)
    motors, wrong, outputs = _motors(log)
    speeds, left = _speeds(log, outputs)
    multirotor = merged("multirotor", [*chosen, motors, speeds], [*notes, *wrong, *left])
    return replace(multirotor, frame=frames.of_ardupilot(log.parameters), lines=flown.place)


def _as_of_a_copter(settings: Mapping[str, float]) -> dict[str, float]:
    """Settings of a VTOL, those of its hover by the names that a multirotor has: Q_M_PWM_TYPE is MOT_PWM_TYPE."""
    hover = {key.replace("Q_M_", "MOT_").removeprefix("Q_"): v for key, v in settings.items() if key.startswith("Q_")}
    return {**settings, **hover}


def _helicopter(log: Log) -> str:
    """What says that a log is a traditional helicopter's, as a sentence; empty where nothing does."""
    frame = int(log.parameters.get("FRAME_CLASS", 0))
    if frame in HELICOPTERS:
        return f"a helicopter, by FRAME_CLASS {frame}"
    if match := re.search(r"Frame: HELI\w*", log.about):
        return f"a helicopter, by '{match[0]}'"
    parameter = next((name for name in log.parameters if re.match(r"H_[A-Z]", name)), "")
    return f"a helicopter, by its setting {parameter}" if parameter else ""


class _Flown:
    """The estimator, its core and the inertial sensor that the vehicle flew with, and why."""

    def __init__(self, log: Log) -> None:
        filters = [kind for kind, topics in FILTERS.items() if log.instances(topics[0])]
        asked = int(log.parameters.get("AHRS_EKF_TYPE", 3))
        self.kind = asked if asked in filters else (filters or [3])[0]
        states, _, notes = FILTERS[self.kind]
        self.core, self.why = _primary(log, notes)
        self.cores = log.instances(states)
        numbers = log.instances("IMU") if len(log.instances("IMU")) > 1 else []
        numbers = numbers or [i for i, topic in enumerate(SENSED) if log.instances(topic)]
        self.imu, self.why_imu = _sensor(log, self.core if self.why else 0, numbers)
        self.groups = _groups(self.kind, self.core, self.imu)
        self.place = imu_line(log.parameters, [f"INS_POS{self.imu + 1}_{axis}" for axis in "XYZ"])

    def instance(self, topic: str, numbers: Sequence[int]) -> tuple[int, str]:
        """Instance of a topic, and why."""
        if topic in [t for kind in FILTERS.values() for t in kind[:2]]:
            if self.core in numbers and self.why:
                others = [n for n in numbers if n != self.core]
                left = f"; core {', '.join(map(str, others))} left" if others else ""
                return self.core, f"core {self.core}, {self.why}{left}" if left else ""
            if topic in [kind[1] for kind in FILTERS.values()] and self.core:
                return numbers[0], f"core {self.core}, {self.why}; {topic.replace('6', '1')} left"
        if topic in (*SENSED, "GYR", "ACC"):
            chosen = self.imu if self.imu in numbers else min(numbers)
            return chosen, self.why_imu
        return lowest(topic, numbers)


def _primary(log: Log, topic: str) -> tuple[int, str]:
    """The core that was primary last: an estimator leaves a core because another one is better."""
    numbers = log.instances(topic)
    said = log.streams[topic, numbers[0]].columns.get("PI", np.empty(0)) if numbers else np.empty(0)
    if not is_numbers(said) or not len(said):
        return 0, ""
    core, earlier = int(said[-1]), {int(value) for value in np.unique(said[:-1])} - {int(said[-1])}
    return core, f"primary {'at last ' if earlier else ''}by {topic}.PI"


def _sensor(log: Log, core: int, numbers: Sequence[int]) -> tuple[int, str]:
    """The inertial sensor of the primary core, if in use and healthy, else the first that is; and why, of several."""
    parameters = log.parameters
    used = [n for n in numbers if parameters.get(f"INS_USE{n + 1 if n else ''}", 1.0) != 0.0]
    healthy = [n for n in used if _healthy(log, n)]
    mask = int(parameters.get("EK3_IMU_MASK", parameters.get("EK2_IMU_MASK", 0.0)))
    of_cores = [bit for bit in range(8) if mask >> bit & 1] or list(range(8))
    instance_of_core = of_cores[core] if core < len(of_cores) else 0
    usable = healthy or used or list(numbers) or [0]
    chosen = instance_of_core if instance_of_core in usable else usable[0]
    if len(numbers) < 2:
        return chosen, ""
    left = [
        f"{n} left ({'INS_USE' if n not in used else 'unhealthy' if n not in healthy else 'another core'})"
        for n in numbers
        if n != chosen
    ]
    return chosen, f"IMU {chosen}, in use{f' by core {core}' if chosen == instance_of_core else ''}; {', '.join(left)}"


def _healthy(log: Log, number: int) -> bool:
    """Whether a sensor's gyros were healthy for most of the log, where that is told."""
    stream = log.streams.get(("IMU", number)) or log.streams.get((SENSED[min(number, 2)], 0))
    health = stream.columns.get("GH") if stream is not None else None
    return health is None or not is_numbers(health) or float(np.mean(health != 0)) > 0.5


def _sticks(log: Log) -> tuple[list[Chosen], list[str]]:
    """Controls of a helicopter: blade angles of a logged swashplate, else what the controller asks, else sticks."""
    swash, asked = first_or_faster(log, SWASH), first_or_faster(log, STICKS)
    if swash.entries:
        pedal = {name: entry for name, entry in asked.entries.items() if name == "ped"}
        return [Chosen(pedal, asked.hertz), swash], ["col, lon and lat are blade angles (SWSH), ped is what was asked"]
    if asked.entries or not log.instances("RCIN"):
        return [asked], []
    parameters, entries = log.parameters, {}
    for axis, (name, axis_name) in enumerate(
        zip(("ROLL", "PITCH", "THROTTLE", "YAW"), ("lat", "lon", "col", "ped"), strict=True), 1
    ):
        number = int(parameters.get(f"RCMAP_{name}", axis))
        entry = _centred(f"C{number}", parameters, f"RC{number}", one_sided=axis_name == "col")
        entries |= {axis_name: entry} if entry else {}
    instance = log.instances("RCIN")[0]
    logged = {n: e for n, e in entries.items() if e.field in log.streams["RCIN", instance].columns}
    reason = "no RATE and no SWSH: the pilot's sticks (RCIN) are the controls"
    return [Chosen(named(Group("RCIN", logged), instance), rate_of(log.streams["RCIN", instance].time))], [reason]


def _centred(name: str, settings: Mapping[str, float], prefix: str, one_sided: bool = False) -> Entry | None:
    """Pulses as -1 to 1 about their trim, or as 0 to 1, by PREFIX_MIN, _TRIM and _MAX; None without a range.

    A log has pulses as they came: those of a channel that is reversed (PREFIX_REVERSED, older PREFIX_REV) are turned.
    """
    low, high = settings.get(f"{prefix}_MIN", 1000.0), settings.get(f"{prefix}_MAX", 2000.0)
    turned = settings.get(f"{prefix}_REVERSED", 0.0) > 0.0 or settings.get(f"{prefix}_REV", 1.0) < 0.0
    end = high if turned else low
    middle = end if one_sided else settings.get(f"{prefix}_TRIM", 0.5 * (low + high))
    span = high - low if one_sided else max(high - middle, middle - low)  # the trim is seldom in the middle
    return Entry(name, "norm", -1 if turned else 1, 1.0 / span, -middle / span) if span > 0.0 else None


def _motors(log: Log) -> tuple[Chosen, list[str], dict[int, int]]:
    """Motor commands 0 to 1 from the outputs that drive motors, how these are known, and the output of each motor."""
    parameters = log.parameters
    functions = {i: int(parameters.get(f"SERVO{i}_FUNCTION", 0)) for some in OUTPUTS.values() for i in some}
    frame = int(parameters.get("FRAME_CLASS", 0))
    said = re.search(r"Frame: (SINGLE|COAX|TRI)\b", log.about)
    if frame in FINS or (said and said[1] != "TRI"):
        evidence = said[0] if said else f"FRAME_CLASS {frame}"
        raise InputError(log.file, "", f"has fins for motors 1 to 4 ({evidence})", "a map (--map)")
    tricopter = frame == TRICOPTER or bool(said)
    tails = [i for i, f in functions.items() if tricopter and f == TAIL]
    outputs = dict(sorted((FUNCTIONS[f], i) for i, f in functions.items() if f in FUNCTIONS and i not in tails))
    if not log.instances("RCOU"):
        return Chosen(), [], outputs
    columns, notes = log.streams["RCOU", log.instances("RCOU")[0]].columns, list[str]()
    letter = "C" if "C1" in columns else "Ch"
    if not outputs and tricopter:
        outputs, tails = dict(OLD_TRICOPTER), [OLD_TAIL]
    elif not outputs:
        count = frames.motors_of_ardupilot(parameters, log.about) or 8
        outputs = {i: i for i in range(1, count + 1) if moving(columns.get(f"{letter}{i}", np.zeros(1)))}
        reason = f"no SERVOn_FUNCTION says which output drives which motor: RCOU outputs {[*outputs]} are motors"
        notes = [reason] if outputs else []
    entries, hertz = dict[str, Entry](), 0.0
    for motor, output in outputs.items():
        topic = next(name for name, some in OUTPUTS.items() if output in some)
        stream = log.streams.get((topic, 0))
        name = f"{letter}{output}"
        if stream is None or name not in stream.columns:
            reason = "an output for every motor of SERVOn_FUNCTION"
            raise InputError(log.file, f"{topic}.{name}", "is missing", reason)
        values = _numbers(log, stream, topic, name)
        key = f"{topic}.{name} (motor{motor})"
        if parameters.get("MOT_PWM_TYPE") == OF_THE_SERVO and parameters.get(f"SERVO{output}_REVERSED"):
            wrong = f"is reversed by SERVO{output}_REVERSED"
            raise InputError(log.file, key, wrong, "a map (--map) with scale and offset")
        if setting := both_ways_in_ardupilot(parameters, output):
            raise InputError(log.file, key, f"turns both ways, by {setting}", TWO_WAYS)
        fitting = range_of(log.file, key, values, of_ardupilot(parameters, output))
        entries |= named(Group(topic, {f"motor{motor}": fitting.entry(name)}), 0)
        hertz = rate_of(stream.time)
    for output in tails:
        entry = _centred(f"{letter}{output}", parameters, f"SERVO{output}")
        entries |= named(Group("RCOU", {"ped": entry}), 0) if entry and entry.field in columns else {}
        notes.append(f"RCOU.{letter}{output} tilts the tail motor: ped")
    return Chosen(entries, hertz), notes, outputs


def _numbers(log: Log, stream: Stream, topic: str, name: str) -> np.ndarray:
    values = stream.columns[name]
    if not is_numbers(values):
        raise InputError(log.file, f"{topic}.{name}", "is text", "a field of numbers")
    return values.astype(np.float64)


def _speeds(log: Log, outputs: dict[int, int]) -> tuple[Chosen, list[str]]:
    """Rotor speeds by motor: instance i of ESC, or ESC1, ESC2, ... of older logs, is that of output i + 1.

    Boards that count from their first motor's output have all numbers shifted by one constant.
    """
    sources = {number: ("ESC", number) for number in log.instances("ESC")}
    sources = sources or {i - 1: (f"ESC{i}", 0) for i in range(1, 9) if log.instances(f"ESC{i}")}
    turning = {i: place for i, place in sources.items() if moving(log.streams[place].columns.get("RPM", np.zeros(1)))}
    if not turning:
        return Chosen(missing="omega1 omega2 ... (no ESC that turns)"), []
    motors = {output: motor for motor, output in outputs.items()} or {i + 1: i + 1 for i in turning}
    shift = 0
    if not any(i + 1 in motors for i in turning):
        shift = min(motors) - 1 - min(turning)
    pairs = sorted((motors[i + 1 + shift], place) for i, place in turning.items() if i + 1 + shift in motors)
    entries, hertz = dict[str, Entry](), 0.0
    for motor, (topic, instance) in pairs:
        entries |= named(Group(topic, {f"omega{motor}": Entry("RPM", "rpm")}), instance)
        hertz = rate_of(log.streams[topic, instance].time)
    left = [f"{place[0]}[{place[1]}]" for i, place in turning.items() if i + 1 + shift not in motors]
    notes = [f"{', '.join(left)} on outputs that drive no motor: left out"] if left else []
    crossed = ", ".join(f"{t}[{i}] is motor {m}" for m, (t, i) in pairs if t == "ESC" and m != i + 1)
    return Chosen(entries, hertz, crossed), notes
