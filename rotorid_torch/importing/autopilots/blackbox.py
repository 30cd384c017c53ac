"""The built-in map of Betaflight's and Rotorflight's blackbox, as CSV of the decoder or of the Blackbox Explorer.

Betaflight's axes are x forward, y left, z up. A unit in a name (by the decoder's options) is believed.
Without one its gyros are in deg/s, those of older firmware in counts of the header's scale.

Source: Betaflight, src/main/blackbox/blackbox.c (fields and header); blackbox-tools, `blackbox_decode --help` (units);
Rotorflight, Blackbox Explorer.
"""

import math
import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from rotorid_torch.errors import InputError
from rotorid_torch.importing.signals import units
from rotorid_torch.importing.signals.mapping import Clock, Entry
from rotorid_torch.importing.signals.outputs import DSHOT_RAW, PULSE, TWO_WAYS, OutputRange, range_of
from rotorid_torch.importing.signals.plan import Chosen, Plan, merged, moving
from rotorid_torch.importing.signals.streams import Log

SYSTEM = "blackbox"
GYROS, FORCES = ("gyroADC", "gyroData"), ("accSmooth", "accADC")
MOTORS, TURNS = "motor", "eRPM"
FINER, TIMES = "blackbox_high_resolution", 10.0
"""Setting by which counts of gyros are so many times finer."""
OF_A_BLACKBOX = ("motor[0]", "servo[0]", "mixer[0]", "setpoint[0]", "rcCommand[0]")
"""Fields of which a blackbox has one beside its gyros."""
ACC_1G, POLES = 2048.0, 14.0
"""What the header says unless it says otherwise: counts of an accelerometer at 1 g, magnets of a motor."""
TENTHS, NEWER = (3, 1), (4, 0)
"""Firmware from which the battery is logged in 0.1 V, in 0.01 V."""
TURNS_BOTH_WAYS = 1 << 12
"""Bit of `features` of motors that turn both ways (3D)."""
STICK = 1000.0
"""Full travel of what Rotorflight's mixer is asked."""
CONTROLS = {"lat": ("mixer[0]", 1), "lon": ("mixer[1]", -1), "ped": ("mixer[2]", -1), "col": ("mixer[3]", 1)}
ASKED = {"lat": ("setpoint[0]", 1), "lon": ("setpoint[1]", -1), "ped": ("setpoint[2]", -1), "col": ("setpoint[3]", 1)}
_NAME = re.compile(r"\s*([A-Za-z]\w*(?:\[\d\])?)\s*(?:\(([^)]*)\))?\s*")
_HUNDREDS = "(/100)"
"""What some decoders write into the name of electrical revolutions, which are in hundreds a minute by any name."""


def is_blackbox(names: Sequence[str]) -> bool:
    """Whether a table's names are a blackbox's."""
    bare = {_bare(name) for name in names}
    gyros = any(f"{gyro}[0]" in bare for gyro in GYROS)
    return "time" in bare and ("loopIteration" in bare or (gyros and not bare.isdisjoint(OF_A_BLACKBOX)))


def clock(names: Sequence[str]) -> Clock:
    """The clock of a blackbox, in us."""
    name = next(name for name in names if _bare(name) == "time")
    return Clock(name, "s" if _unit(name) == "s" else "us")


def settings(rows: Iterable[Sequence[str]]) -> dict[str, float]:
    """Numbers of the rows of keys and values before the names; of a list `name[0]`, `name[1]`, ..."""
    numbers: dict[str, float] = {}
    for row in rows:
        if len(row) < 2:
            continue
        fields = [part for field in row[1:] for part in field.split(",")]
        for index, part in enumerate(fields):
            try:
                bits = part.strip().lower()
                number = struct.unpack(">f", bytes.fromhex(bits[2:]))[0] if bits.startswith("0x") else float(part)
            except (ValueError, struct.error):
                continue
            numbers[f"{row[0]}[{index}]" if len(fields) > 1 else row[0]] = number
    return numbers


def fields(topic: str, names: Sequence[str]) -> list[str]:
    """Fields that the map may need."""
    if topic or not is_blackbox(names):
        return []
    wanted = (*GYROS, *FORCES, MOTORS, TURNS, "mixer", "setpoint", "headspeed", "vbat", "Vbat")
    return [name for name in names if _bare(name).startswith(wanted)]


def plan(log: Log) -> Plan:
    """Channels of a blackbox. Raises InputError where the motors' outputs have an unknown range."""
    columns = log.streams["", 0].columns
    full_names = {_bare(name): name for name in columns}
    angles = Chosen(missing="phi theta psi (name attitudes in a map: firmware differs in their units and signs)")
    chosen = [*_sensors(log, full_names), _voltage(log, full_names), angles]
    if "headspeed" in full_names or any("rotorflight" in str(key).lower() for key in (log.about, *log.parameters)):
        speed = Chosen({"omega": Entry(full_names["headspeed"], "rpm")}) if "headspeed" in full_names else Chosen()
        return merged("helicopter", [*chosen, _sticks(full_names, columns), speed], ["a helicopter: Rotorflight"])
    plan = merged("multirotor", [*chosen, _motors(log, full_names), _speeds(log, full_names)], [])
    return replace(plan, frame="quad X in Betaflight's order")


def _bare(name: str) -> str:
    """`gyroADC[0] (deg/s)` as gyroADC[0]."""
    match = _NAME.fullmatch(name.replace(_HUNDREDS, ""))
    return match[1] if match else name


def _unit(name: str) -> str:
    """`gyroADC[0] (deg/s)` as deg/s; empty without a known unit in brackets."""
    match = _NAME.fullmatch(name)
    unit = match[2] if match and match[2] else ""
    return unit if units.find_unit(unit) or units.clock_unit(unit) else ""


def _entry(name: str, sign: Literal[1, -1], unit: str, scale: float = 1.0) -> Entry:
    """Entry of a field in the unit of its name; without one in `unit`, so many of it for a count."""
    return Entry(name, _unit(name), sign) if _unit(name) else Entry(name, unit, sign, scale)


def _gyro_scale(settings: Mapping[str, float]) -> float:
    """Deg/s of one count of a gyro: the Explorer writes the header's scale in rad/us, the header itself its bits."""
    finer = TIMES if settings.get(FINER, 0.0) > 0.0 else 1.0
    if "gyroScale" in settings:
        return math.degrees(settings["gyroScale"] * 1e6) / finer
    return settings.get("gyro_scale", settings.get("gyro.scale", 1.0)) / finer


def _sensors(log: Log, full_names: Mapping[str, str]) -> list[Chosen]:
    """Body rates, and specific forces, from counts where the names say no unit."""
    rates, forces, counted = dict[str, Entry](), dict[str, Entry](), False
    gyro, acc = (next((name for name in some if f"{name}[0]" in full_names), some[0]) for some in (GYROS, FORCES))
    axes: tuple[tuple[str, str, Literal[1, -1]], ...] = (("p", "ax", 1), ("q", "ay", -1), ("r", "az", -1))
    for i, (rate, force, sign) in enumerate(axes):
        if f"{gyro}[{i}]" in full_names:
            rates[rate] = _entry(full_names[f"{gyro}[{i}]"], sign, "deg/s", _gyro_scale(log.parameters))
        if f"{acc}[{i}]" in full_names:
            counted = not _unit(full_names[f"{acc}[{i}]"])
            forces[force] = _entry(full_names[f"{acc}[{i}]"], sign, "g", 1.0 / log.parameters.get("acc_1G", ACC_1G))
    reason = _by_default(log, "acc_1G", f"{ACC_1G:g} counts for 1 g") if counted else ""
    missing = "" if forces else f"ax ay az (no {', '.join(FORCES)})"
    return [Chosen(rates), Chosen(forces, reason=reason, missing=missing)]


def _by_default(log: Log, key: str, taken: str) -> str:
    """A sentence on what is taken where the header has no such key."""
    return (
        "" if key in log.parameters else f"{taken}, by default: the log has no header with {key}; others scale in a map"
    )


def _voltage(log: Log, full_names: Mapping[str, str]) -> Chosen:
    """Voltage of the battery; without a unit in 0.01 V, in 0.1 V by Betaflight before 4.0, none before 3.1."""
    name = next((name for bare, name in full_names.items() if bare.lower() in ("vbatlatest", "vbat")), "")
    if not name:
        return Chosen()
    others = re.search("inav|rotorflight", log.about, re.IGNORECASE)  # with versions of their own
    version = None if others else re.search(r"firmware\D*(\d+)\.(\d+)", log.about, re.IGNORECASE)
    recorded = (int(version[1]), int(version[2])) if version else NEWER
    if recorded < TENTHS and not _unit(name):
        return Chosen(missing=f"voltage ({name}: firmware before 3.1 logs counts of its converter)")
    return Chosen({"voltage": _entry(name, 1, "V", 0.01 if recorded >= NEWER else 0.1)})


def _sticks(full_names: Mapping[str, str], columns: Mapping[str, np.ndarray]) -> Chosen:
    """What the mixer is asked, else what the pilot asks."""
    mixed = all(field in full_names for field, _ in CONTROLS.values())
    table = CONTROLS if mixed else ASKED
    logged = {name: (full_names[field], sign) for name, (field, sign) in table.items() if field in full_names}
    return Chosen({n: Entry(f, "norm", 1 if sign > 0 else -1, 1.0 / STICK) for n, (f, sign) in logged.items()})


def _motors(log: Log, full_names: Mapping[str, str]) -> Chosen:
    """Motor commands by the range that the header names, else the only one that holds the outputs."""
    parameters, columns = log.parameters, log.streams["", 0].columns
    if int(parameters.get("features", 0)) & TURNS_BOTH_WAYS:
        raise InputError(log.file, f"{MOTORS}[0] (motor1)", "turns both ways, by features (3D)", TWO_WAYS)
    low, high = parameters.get("motorOutput[0]"), parameters.get("motorOutput[1]")
    if low is not None and high is not None and low < high:
        allowed = [OutputRange(low, high, "motorOutput")]
    elif "minthrottle" in parameters:
        allowed = [
            OutputRange(parameters["minthrottle"], parameters.get("maxthrottle", 2000.0), "minthrottle, maxthrottle")
        ]
    else:
        allowed = [PULSE, DSHOT_RAW]
    raw = {n: columns[full_names[f"{MOTORS}[{n}]"]] for n in range(8) if f"{MOTORS}[{n}]" in full_names}
    used = {n: values for n, values in raw.items() if moving(values)} or raw
    ranges = [range_of(log.file, f"{full_names[f'{MOTORS}[{n}]']} (motor{n + 1})", v, allowed) for n, v in used.items()]
    widest = DSHOT_RAW if DSHOT_RAW in ranges else ranges[0] if ranges else PULSE
    others = [one for one in allowed if one != widest and all(one.holds(values) for values in used.values())]
    reason = f"outputs {widest}" if len(allowed) > 1 else ""
    if others:
        reason += f"; {others[0]} would hold them too, and the log has no header (motorOutput, minthrottle) that says"
        reason += " which: keep the header when decoding, or name scale and offset in a map"
    return Chosen({f"motor{n + 1}": widest.entry(full_names[f"{MOTORS}[{n}]"]) for n in used}, reason=reason)


def _speeds(log: Log, full_names: Mapping[str, str]) -> Chosen:
    """Rotor speeds from electrical revolutions, in hundreds a minute, and pairs of magnets."""
    pairs = log.parameters.get("motor_poles", POLES) / 2.0
    logged = [n for n in range(8) if f"{TURNS}[{n}]" in full_names]
    entries = {f"omega{n + 1}": Entry(full_names[f"{TURNS}[{n}]"], "rpm", 1, 100.0 / pairs) for n in logged}
    return Chosen(entries, reason=_by_default(log, "motor_poles", f"{POLES:g} magnets of a motor"))
