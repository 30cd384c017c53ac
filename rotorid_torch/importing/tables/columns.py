"""Tables (CSV, Parquet, NPZ, MATLAB) as logs: which column is the clock, and what a header says of units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from msgspec import structs

from rotorid_torch.core import names
from rotorid_torch.core.ranges import of_channel
from rotorid_torch.errors import InputError, nearest
from rotorid_torch.importing.signals import units
from rotorid_torch.importing.signals.mapping import Clock, Entry, measures
from rotorid_torch.importing.signals.plan import QUATERNION, Plan
from rotorid_torch.importing.signals.streams import TOLD, Log, Stream, header_name, is_numbers, joined

CLOCKS = {
    **dict.fromkeys(("time", "t", "timestamp", "seconds", "sec"), "s"),
    **{f"{name}_{unit}": unit for unit in units.CLOCKS for name in ("time", "t", "timestamp")},
    **{"timems": "ms", "timeus": "us", "timens": "ns"},
}
"""Columns taken for the clock where no map names one, in small letters."""
_HALF = re.compile(r"(|(?:.*[._])?(?:t|tv|time|timestamp|stamp|clock)[._])([a-z]+)", re.IGNORECASE)
"""A clock in two columns, as ROS has it (`header.stamp.secs`, `header.stamp.nsecs`): its stem, and a unit."""
DATA = ("Data", "data", "values", "Values")
"""Column of a topic that holds one channel, named as the topic is: a time series of MATLAB's."""
_OF_DAY = re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d+)?)")
_BY_YEAR = re.compile(r"\d{4}/\d\d/\d\d.+")
AS_DATES = "2024-02-29 23:59:50, 29.2.2024 23:59:50, 29/2/2024 23:59:50 or 23:59:50"
"""Ways to write a date and a time of day that tables are read by."""
_YEAR_LAST = re.compile(r"(\d{1,2})([./-])(\d{1,2})\2(\d{4})[ T]+(\d{1,2})(:.*)")
_LETTERED = re.compile(r"(?:q|quat|quaternion|orientation)[_.]?([wxyz])", re.IGNORECASE)
_COLUMN = re.compile(r"(q|quat|quaternion|motor|omega)\[(\d{1,2})\]")
WHOLE = (QUATERNION, ("vn", "ve", "vd"))
"""What becomes channels where all of it is there."""
USUAL_S = (1e-5, 2.0)
"""Shortest and longest usual interval of a record; beyond them the clock has another unit."""
RUNS = 0.9
"""Share of the steps of a clock that lead one way; a temperature or a count of whole seconds has less."""
FASTEST_S = 0.5
"""Longest usual interval of the fastest table of a file that names no unit: a count of 1 ms is no second."""
WHOLE_DEGREES, TURN = 1e-7, 360.0
"""Degrees of one count where a receiver's angles are whole numbers (degE7 of MAVLink), and of a turn."""
STEEPEST = 0.6
"""rad: no blade is turned so far by a pilot; blades stall at a third of it."""
SLOW = {"omega": 100.0, "omega1": 1000.0}
"""Number up to which speeds of a main rotor, and of motors, are in rad/s: as rpm they would be 10 and 105 rad/s, and
the slowest helicopter's, a Hughes XH-17's, were 9; motors of drones are faster."""
Columns = Mapping[str, np.ndarray]


def is_clock(topic: str, column: str, clock: Clock | None) -> bool:
    """Whether a column may be the clock."""
    if clock is not None:
        return clock.field in (column, joined(topic, column), header_name(joined(topic, column))[0])
    return _named(column) or _half(column) is not None


def _named(column: str) -> bool:
    return header_name(column)[0].lower() in CLOCKS


def _half(column: str) -> tuple[str, float] | None:
    """Stem and seconds of a column that may hold whole seconds of a clock, or what is beyond them."""
    half = _HALF.fullmatch(column)
    seconds = units.clock_unit(half[2]) if half else None
    return (half[1], seconds) if half and seconds and seconds <= 1.0 else None


def _with_whole_clock(columns: Columns) -> Columns:
    """Columns with a clock of whole seconds and one of what is beyond them as one `time_s`; else as they are."""
    halves = [(column, *half) for column in columns if (half := _half(column))]
    for whole, stem, unit in halves:
        parts = [(column, size) for column, other, size in halves if other == stem and size < unit == 1.0]
        for part, size in parts:
            seconds, beyond = (np.asarray(columns[c], np.float64) for c in (whole, part))
            finite = np.isfinite(seconds) & np.isfinite(beyond)
            inside = (beyond[finite] >= 0.0) & (size * beyond[finite] < 1.0) & (seconds[finite] % 1.0 == 0.0)
            if finite.any() and inside.all():
                others = {column: values for column, values in columns.items() if column not in (whole, part)}
                return others | {"time_s": seconds + size * beyond}
    return columns


def table_log(
    file: Path,
    tables: Mapping[str, Columns],
    fields: Mapping[str, Sequence[str]],
    clock: Clock | None,
    warnings: Sequence[str] = (),
) -> Log:
    """Log of one table or several (by topic), each with a clock among its columns. Raises InputError without one."""
    streams, fastest, notes = {}, ("", np.inf), [*warnings]
    for topic, table in tables.items():
        columns = table if clock else _with_whole_clock(table)
        clocks = _clocks(topic, columns, clock)
        if not clocks:
            continue
        name = clocks[0]
        notes += [f"{joined(topic, other)} left out: the clock is {joined(topic, name)}" for other in clocks[1:]]
        stamps = np.asarray(columns[name], np.float64) * seconds_of(name, clock)
        if not _unit_of(name, clock):
            fastest = min(fastest, (name, _interval(file, name, stamps)), key=lambda one: one[1])
        others = {column: values for column, values in columns.items() if column != name or len(columns) == 1}
        streams[topic, 0] = Stream(stamps, others)
    if not streams:
        listed = [joined(topic, name) for topic, columns in fields.items() for name in columns]
        wanted = clock.field if clock else "time"
        near = nearest(wanted, listed) or f" (there are {', '.join(listed[:TOLD])})"
        expected = "a clock: a column time in s, or a map with time = { field = ..., unit = ... }"
        if listed and all(map(str.isdigit, listed)):
            raise InputError(file, "", "has no row of names", 'one, or a map with columns = ["time", "motor1", ...]')
        raise InputError(file, wanted, f"is missing{near if listed else ''}", expected)
    if fastest[1] > FASTEST_S and np.isfinite(fastest[1]):
        raise _other_unit(file, *fastest)
    return Log(file, "", "", streams, fields, warnings=tuple(notes))


def _clocks(topic: str, columns: Columns, clock: Clock | None) -> list[str]:
    """Columns that may be the clock, the best first: one that runs on, then as they stand in `CLOCKS`."""
    named = [c for c in columns if (is_clock(topic, c, clock) if clock else _named(c))]
    if clock is not None or len(named) < 2:
        return named
    order = [*CLOCKS]

    def rank(column: str) -> tuple[bool, int]:
        steps = np.diff(np.asarray(columns[column], np.float64))
        runs = max(float(np.mean(steps > 0.0)), float(np.mean(steps < 0.0))) if len(steps) else 0.0
        return runs < RUNS, order.index(header_name(column)[0].lower())

    return sorted(named, key=rank)


def seconds_of(column: str, clock: Clock | None) -> float:
    """Seconds of one unit of the clock."""
    unit = _unit_of(column, clock) or (clock.unit if clock else CLOCKS[header_name(column)[0].lower()])
    return units.clock_unit(unit) or 1.0


def _unit_of(column: str, clock: Clock | None) -> str:
    """Unit of a clock by its map, its brackets or its name's ending; empty where nothing says it."""
    name, bracketed = header_name(column)
    by_name = CLOCKS.get(name.lower(), "") if "_" in name and not clock else ""
    return (clock.unit if clock else "") or bracketed or by_name


def in_either_order(text: str) -> str:
    """The date of a text in which day or month may come first, as 29/2/2024; empty for other texts."""
    match = _YEAR_LAST.fullmatch(text)
    return match.group(0)[: match.end(4)] if match and match[2] != "." else ""


def time_of_day(text: str, month_first: bool = False) -> float | None:
    """Seconds of a date and time as ISO 8601 or 29.2.2024 12:30:15, or of a time of day; None for other texts.

    month_first : of 2/29/2024 and 2-29-2024.
    """
    if match := _OF_DAY.fullmatch(text):
        return 3600.0 * float(match[1]) + 60.0 * float(match[2]) + float(match[3].replace(",", "."))
    if match := _YEAR_LAST.fullmatch(text):
        month, day = (match[1], match[3]) if month_first and match[2] != "." else (match[3], match[1])
        text = f"{match[4]}-{month:0>2}-{day:0>2}T{match[5]:0>2}{match[6].replace(',', '.')}"
    try:
        moment = datetime.fromisoformat(text.replace("/", "-") if _BY_YEAR.fullmatch(text) else text)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _interval(file: Path, name: str, stamps: np.ndarray) -> float:
    """Usual interval of a clock, s; 0 where it mostly stands. Raises InputError where its unit must be another one."""
    steps, ordered = np.diff(stamps[np.isfinite(stamps)]), np.diff(np.unique(stamps[np.isfinite(stamps)]))
    typical = float(np.median(ordered)) if len(ordered) else 0.0
    if typical and not USUAL_S[0] <= typical <= USUAL_S[1]:
        raise _other_unit(file, name, typical)
    return typical if typical and float(np.median(steps)) > 0.0 else 0.0


def _other_unit(file: Path, name: str, interval: float) -> InputError:
    smaller = (unit for unit in ("ms", "us", "ns") if interval * units.CLOCKS[unit] <= FASTEST_S)
    unit = next(smaller, "ns") if interval > USUAL_S[0] else "days"
    wrong = f"has samples {interval:.4g} s apart"
    return InputError(file, name, wrong, f'time in s, or a map with time = {{ field = "{name}", unit = "{unit}" }}')


def apart(log: Log) -> list[Log]:
    """One log for each struct of a table file that has a control which another one has too; else the log itself."""
    inside: dict[str, dict[str, Sequence[str]]] = {}
    for topic, columns in log.fields.items() if not log.system else ():
        if topic and any(name == topic for name, _ in log.streams):
            inside.setdefault(topic.partition(".")[0], {})[topic] = columns
    controls = {root: set(names.acting(own_entries(fields))) for root, fields in inside.items()}
    flown = [root for root, some in controls.items() if any(some & controls[o] for o in controls if o != root)]
    if not flown:
        return [log]
    note = f"{', '.join(flown)} have the same controls: each is a flight of its own"
    return [
        replace(
            log,
            fields=inside[root],
            streams={place: stream for place, stream in log.streams.items() if place[0] in inside[root]},
            warnings=(*log.warnings, *([note] if root == flown[0] else [])),
        )
        for root in flown
    ]


def own_plan(log: Log) -> Plan:
    """Plan of a table by its names, with what was left and why."""
    entries = own_entries(log.fields)
    used = {entry.field for entry in entries.values()}
    listed = [(t, c) for t, columns in log.fields.items() for c in columns if c and not is_clock(t, c, None)]
    unused = {joined(t, c): own_entries({t: [c]}) for t, c in listed if joined(t, c) not in used}
    again = {place: name for place, meant in unused.items() for name in meant if name in entries}
    left = [place for place in unused if place not in again]
    more = f" and {len(left) - TOLD} more" if len(left) > TOLD else ""
    notes = [f"left out, for no channel has such a name and unit: {', '.join(left[:TOLD])}{more}"] if left else []
    plain = {place: header_name(place)[0].rpartition(".")[2] for place in left}
    meant = {names.meant(name): place for place, name in plain.items()}
    lines = [
        f'{name} = {{ field = "{place}", unit = ... }}' for name, place in meant.items() if name and name not in entries
    ]
    notes += [f"a map (--map) takes them by lines of [channels] such as {', '.join(lines[:TOLD])}"] if lines else []
    notes += [f"{place} is left out: {name} is taken from {entries[name].field}" for place, name in again.items()]
    if "latitude" in entries:
        whole = [name for name in ("latitude", "longitude") if _beyond_a_turn(log, entries[name])]
        entries |= {name: structs.replace(entries[name], scale=WHOLE_DEGREES) for name in whole}
        place = f"{entries['latitude'].field} and {entries['longitude'].field}"
        counts = f"counts of {WHOLE_DEGREES:g} " if whole else ""
        notes.append(f"{place} are latitude and longitude in {counts}degrees, for motors are the controls")
    speeds, more = _speeds(log, entries)
    return Plan("", entries | speeds, (*notes, *more, *_untold(log, entries)))


def _untold(log: Log, entries: Mapping[str, Entry]) -> list[str]:
    """A sentence on sticks that move farther than blades do, and whose unit no header says: no kinematics tells it."""
    sticks = [name for name, entry in entries.items() if name in names.STICKS and not entry.unit]
    far = any(np.max(_sizes(log, entries[name]), initial=0.0) > STEEPEST for name in sticks)
    said = f"no header says a unit: {', '.join(sticks)} taken in rad of a blade (else write lon [%])"
    return [said] if far else []


def _speeds(log: Log, entries: Mapping[str, Entry]) -> tuple[dict[str, Entry], list[str]]:
    """Rotor speeds of which no header says the unit in the only one that they can have, and a sentence.

    Raises InputError where both rad/s and rpm are rotors.
    """
    bare = [name for name, e in entries.items() if not e.unit and (name == "omega" or names.is_rotor_speed(name))]
    sizes = {name: _sizes(log, entries[name]) for name in bare}
    usual = {name: float(np.quantile(size, 0.9)) for name, size in sizes.items() if len(size)}  # no spikes
    if not usual:
        return {}, []
    largest, most = max(usual.values()), SLOW["omega" if "omega" in usual else "omega1"]
    unit = "rad/s" if largest <= most else "rpm"
    if most < largest <= of_channel("omega").samples.high:
        listed = ", ".join(usual)
        raise InputError(
            log.file, listed, f"has no unit: {largest:.4g} may be rad/s or rpm", f"{listed} [rpm] or [rad/s]"
        )
    said = f"no header says a unit: {', '.join(usual)} taken in {unit} (else write omega1 [rpm] or [rad/s])"
    return {name: structs.replace(entries[name], unit=unit) for name in usual}, [said]


def _beyond_a_turn(log: Log, entry: Entry) -> bool:
    """Whether an angle is more than a turn in degrees, and less in counts of 1e-7 degrees."""
    sizes = _sizes(log, entry)
    return len(sizes) > 0 and bool(np.median(sizes) > TURN >= WHOLE_DEGREES * sizes.max())


def _sizes(log: Log, entry: Entry) -> np.ndarray:
    """Absolute values (n,) of a field of numbers, as recorded, without missing ones."""
    source = log.source(entry.field, "channels")
    values = log.streams[source.topic, source.instance].columns[source.field]
    return np.abs(values[np.isfinite(values)]).astype(np.float64) if is_numbers(values) else np.empty(0)


def own_entries(fields: Mapping[str, Sequence[str]]) -> dict[str, Entry]:
    """Map of a table whose columns are named as our channels are: `p`, `p [deg/s]`, `p_deg`, or all in capitals.

    `lat` and `lon` beside motors, and without the controls of a helicopter, are a place on the globe. Quaternions and
    velocities north, east and down are taken whole, quaternions also as `qw qx qy qz`, as `q1` to `q4` or as columns of
    a matrix. Where there is a `motor0`, motors are counted from 0. A matrix `omega` of three columns is a vector.
    """
    entries: dict[str, Entry] = {}
    for topic, columns in fields.items():
        capitals = all(header_name(column)[0].isupper() for column in columns)
        bases = [header_name(column)[0].lower() if capitals else header_name(column)[0] for column in columns]
        three = {kind: f"{kind}[2]" in bases and f"{kind}[3]" not in bases for kind in ("omega", "motor")}
        vector = three["omega"] and not three["motor"]
        usual = {base: base if vector and base.startswith("omega[") else _usual(base) for base in bases}
        bare = {*usual.values()}
        one = {f"q{i}" for i in range(1, 5)} <= bare and "q0" not in bare
        whole = {n for some in WHOLE for n in some if bare.issuperset(some) or (one and some == QUATERNION)}
        zero = {kind for kind in ("motor", "omega") if f"{kind}0" in bare}
        for column in columns:
            name, unit = _channel(topic, column, capitals)
            name = usual.get(name, name)
            if one and name in (*QUATERNION, "q4"):
                name = f"q{int(name[1]) - 1}"
            if name[:5] in zero and name[5:].isdigit():
                name = f"{name[:5]}{int(name[5:]) + 1}"
            usable = name in whole or (names.channel(name) is not None and name != "time")
            if usable and name not in entries:
                entries[name] = Entry(joined(topic, column), unit)
    angles = all(name in entries and entries[name].unit in ("", "deg", "rad") for name in ("lat", "lon"))
    if angles and any(map(names.is_motor, entries)) and not {"col", "ped"} & entries.keys():
        for stick, name in (("lat", "latitude"), ("lon", "longitude")):
            entry = entries.pop(stick)
            entries[name] = structs.replace(entry, unit=entry.unit or "deg")
    return entries


def _usual(name: str) -> str:
    """`qw`, `quat_x`, `q[0]` as q0, q1, q0, and `motor[0]` as motor1, for columns of a matrix count from 0."""
    if lettered := _LETTERED.fullmatch(name):
        return f"q{'wxyz'.index(lettered[1].lower())}"
    if column := _COLUMN.fullmatch(name):
        first = column[1] in ("motor", "omega")
        return f"{column[1]}{int(column[2]) + 1}" if first else f"q{column[2]}"
    return name


def _channel(topic: str, column: str, capitals: bool) -> tuple[str, str]:
    """Name and unit of a column; the name is no channel's where its unit measures something else."""
    name, unit = header_name(column)
    if name in DATA and names.channel(topic.rpartition(".")[2]) is not None:
        return topic.rpartition(".")[2], unit
    name = name.lower() if capitals else name
    stem, _, tail = name.partition("_")
    measure = units.find_unit(tail)
    if names.channel(stem) is not None and measure is not None:
        fits = measure.measures == measures(stem) or (stem in names.STICKS and measure.measures in ("rad", "m", "norm"))
        return (stem, tail) if fits else (column, "")
    return name, unit
