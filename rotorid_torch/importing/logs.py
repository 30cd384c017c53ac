"""`rotorid import`: logs to a data set, from reading to the lists of flights."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core import names
from rotorid_torch.data.write import declarations, declared_vehicle, refuse_unless_free, write_dataset
from rotorid_torch.errors import InputError
from rotorid_torch.importing import manoeuvres
from rotorid_torch.importing.flights import FASTEST_HZ, Record, flights_of, record_of
from rotorid_torch.importing.formats import built_in_fields, read_log
from rotorid_torch.importing.frames import template
from rotorid_torch.importing.signals import units
from rotorid_torch.importing.signals.boots import boots
from rotorid_torch.importing.signals.derive import ANGLES
from rotorid_torch.importing.signals.mapping import Map, read_map
from rotorid_torch.importing.signals.outputs import DSHOT_RAW, PULSE
from rotorid_torch.importing.signals.plan import QUATERNION
from rotorid_torch.importing.signals.streams import Log, choose
from rotorid_torch.importing.tables.columns import apart
from rotorid_torch.printable import printable

IMPORTED = "Imported from"
"""What the description of an imported data set begins with."""
RATES_HZ = (1.0, 10_000.0)
"""What may be asked for."""


@dataclass(frozen=True)
class Taken:
    """A channel: where it came from, how often it was recorded, and why it was taken where there was a choice.

    `source` is empty for what was computed.
    """

    source: str
    hertz: float
    reason: str = ""


@dataclass(frozen=True)
class Imported:
    """What was imported.

    Attributes
    ----------
    folder : the data set.
    kind : "helicopter" or "multirotor".
    rate : of the grid, Hz.
    flights : by name the seconds and what moves most: the control, or body rate, of a manoeuvre; several of a flight.
    lists : names of flights in identify, validate, acid.
    channels : where each came from.
    units : of the controls, as dataset.toml declares them.
    warnings : what was left out, taken out or chosen.
    """

    folder: Path
    kind: str
    rate: float
    flights: Mapping[str, tuple[float, str]]
    lists: Mapping[str, Sequence[str]]
    channels: Mapping[str, Taken]
    units: Mapping[str, str]
    warnings: tuple[str, ...]


def import_log(
    paths: Sequence[str | Path] | str | Path,
    out: str | Path,
    mapping: str | Path | Mapping[str, Any] | None = None,
    rate: float | None = None,
    split: bool = False,
) -> Imported:
    """Import logs as a data set; each file is a flight, or a stream of one where the map says `together`.

    Parameters
    ----------
    paths : PX4 ULog, ArduPilot or sdlog2 logs, MATLAB, CSV, Parquet or NPZ files.
    out : folder of the data set; one that was imported earlier is replaced whole, what it declared is kept beside.
    mapping : a map (TOML file, or the same as a dict); without it the built-in one of the log's maker, and in tables
        the columns that are named as channels.
    rate : of the data set in Hz; without it that of the body rates, at most 250.
    split : cut flights into manoeuvres by control activity.

    Raises InputError: a log cannot be read, lacks controls, or has clocks that disagree; nothing is written then.
    """
    asked = _asked(paths, out, mapping, rate, split)
    earlier = declarations(asked.out)
    records = _records(asked.files, asked.map)
    _refuse_two_ranges(records)
    grid_hz = asked.rate or _usual_rate(records)
    flights, kinds, durations, channels, remarks, files = _cut(records, grid_hz, split)
    lists = manoeuvres.share_out([(name, kinds[name], seconds) for name, (seconds, _) in durations.items()])
    kind, controls = _vehicle_kind(records, asked.map), _controls(records, flights)
    sources = f"{IMPORTED} {printable(', '.join(file.name for file in asked.files), layout=False)} at"
    vehicle, source = _vehicle(asked, records[0], sources)
    plan, motors = records[0].plan, sum(map(names.is_motor, controls)) or sum(map(names.is_rotor_speed, channels))
    with _blamed(source, files):
        write_dataset(
            asked.out,
            flights,
            identify=lists["identify"],
            validate=lists["validate"],
            acid=lists["acid"],
            kind=kind,
            description=f"{sources} {grid_hz:g} Hz.",
            vehicle=vehicle or None,
            controls=controls,
            texts=earlier,
            comment=template(motors if kind == "multirotor" else None, plan.frame, vehicle, plan.lines),
        )
    stays = bool(vehicle) and source == asked.out / "dataset.toml"
    notes = [*_alike(remarks), *_of_lists(lists), *_of_vehicles(records), *_of_earlier(asked.out, earlier, stays)]
    measured = {name: table["unit"] for name, table in controls.items()}
    return Imported(asked.out, kind, grid_hz, durations, lists, channels, measured, tuple(dict.fromkeys(notes)))


@contextmanager
def _blamed(source: str | Path, files: Mapping[str, Path]) -> Iterator[None]:
    """What is wrong with the vehicle is so in the file that has it, and what is wrong with a flight in its log."""
    try:
        yield
    except InputError as error:
        log = files.get(str(error.file).removeprefix("arrays: flight "))
        if error.key.startswith("vehicle"):
            raise InputError(source, error.key, error.wrong, error.expected) from None
        if log is None:
            raise
        raise InputError(log, error.key, error.wrong, f"{error.expected}; a map (--map) says a field's unit") from None


def _vehicle(asked: "_Asked", first: Record, sources: str) -> tuple[dict[str, Any], str | Path]:
    """The table [vehicle] and the file that has it: a map's, that of the same logs' earlier data set, or the log's.

    sources : what the description of a data set of these logs begins with.
    """
    if asked.map and asked.map.vehicle:
        return asked.map.vehicle, asked.map_file
    place = asked.out / "dataset.toml"
    filled = declared_vehicle(place, sources)
    return (filled, place) if filled else (dict(first.plan.vehicle), first.file)


def _of_lists(lists: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """What to do where several flights leave none to judge by."""
    if len(lists["identify"]) > 1 and not lists["validate"]:
        yield (
            "no flight is left for validate: each moves what no other does, and identify needs all. Nothing judges the"
            " model: fly each manoeuvre twice, cut flights with --split, or move one in dataset.toml"
        )


def _of_earlier(out: Path, earlier: Mapping[str, str], stays: bool) -> Iterator[str]:
    """What became of the data set that was at this place, by its declarations; stays : its vehicle does."""
    if replaced := [file for file in earlier if (out / file).exists()]:
        replaces = f"{out.name}: the data set that was here is replaced{', its [vehicle] stays' if stays else ''}"
        yield f"{replaces}; what it declared is kept: {', '.join(replaced)}"


def _of_vehicles(records: Sequence[Record]) -> Iterator[str]:
    """Logs whose settings or motors say that another vehicle flew."""

    def vehicle_of(record: Record) -> tuple[object, ...]:
        motors = sum(map(names.is_motor, record.entries))
        return record.plan.kind, record.plan.frame, record.plan.vehicle, motors

    others = dict.fromkeys(r.file.name for r in records if vehicle_of(r) != vehicle_of(records[0]))
    if others:
        first, listed = records[0].file.name, arguments.listed(list(others))
        yield f"{listed}: other motors or settings of the vehicle than in {first}; one data set is of one vehicle"


def _refuse_two_ranges(records: Sequence[Record]) -> None:
    """Motors of one vehicle that are read as servo pulses in one log and as counts of DShot in another."""
    motors = [(r.file, r.entries["motor1"]) for r in records if "motor1" in r.entries]
    pulses, counts = (next((f for f, e in motors if e == one.entry(e.field)), None) for one in (PULSE, DSHOT_RAW))
    if pulses is not None and counts is not None:
        wrong = f"is taken for {PULSE}, but in {counts.name} for {DSHOT_RAW}: one vehicle has one range"
        expected = "logs decoded with their header, or a map (--map) with scale and offset of each motor"
        raise InputError(pulses, "motor1", wrong, expected)


class _Cut(NamedTuple):
    """Flights of all logs, what moves in each, seconds and that in words, where channels come from, remarks, files."""

    flights: dict[str, dict[str, np.ndarray]]
    kinds: dict[str, frozenset[str]]
    durations: dict[str, tuple[float, str]]
    channels: dict[str, Taken]
    remarks: list[tuple[str, str]]
    files: dict[str, Path]


def _cut(records: Sequence[Record], grid_hz: float, split: bool) -> _Cut:
    flights, kinds, remarks = dict[str, dict[str, np.ndarray]](), dict[str, str](), list[tuple[str, str]]()
    channels, files = dict[str, Taken](), dict[str, Path]()
    for record in records:
        cut, more = flights_of(record, grid_hz, split, set(flights))
        channels |= {n: taken for n, taken in _taken(record, cut).items() if n not in channels}
        record.signals.clear()  # the next log needs the memory
        remarks += [(record.file.name, sentence) for sentence in (*record.warnings, *more)]
        flights |= {name: arrays for name, (arrays, _) in cut.items()}
        files |= dict.fromkeys(cut, record.file)
        kinds |= {name: kind for name, (_, kind) in cut.items()}
    whole = manoeuvres.moved({name: flights[name] for name, kind in kinds.items() if not kind}, 1.0 / grid_hz)
    moves = {name: whole.get(name) or frozenset(filter(None, (kind,))) for name, kind in kinds.items()}
    durations = {
        name: (float(arrays["time"][-1]), " ".join(n for n in arrays if n in moves[name]))
        for name, arrays in flights.items()
    }
    return _Cut(flights, moves, durations, channels, remarks, files)


@dataclass(frozen=True)
class _Asked:
    """What an import was asked for, checked."""

    files: Sequence[Path]
    out: Path
    map: Map | None
    map_file: str | Path
    rate: float | None


def _asked(paths: Any, out: Any, mapping: Any, rate: Any, split: Any) -> _Asked:
    """The arguments of an import. Raises InputError with the one at fault."""
    of, several = "import_log", [paths] if isinstance(paths, str | Path) else paths
    place = arguments.place(Argument(of, "out"), out)
    listed = arguments.sequence(Argument(of, "paths"), several, "a path, or a list of paths")
    files = [arguments.place(Argument(of, "paths"), p) for p in listed]
    rate = None if rate is None else arguments.number(Argument(of, "rate"), rate, "Hz")
    arguments.flag(Argument(of, "split"), split)
    refuse_unless_free(place, IMPORTED, [*files, *([Path(mapping)] if isinstance(mapping, str | Path) else [])])
    if not files:
        raise InputError("import", "", "has no log", "at least one file")
    if rate is not None and not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        raise InputError("--rate", str(rate), "is out of range", f"{RATES_HZ[0]:g} to {RATES_HZ[1]:g} Hz")
    file = mapping if isinstance(mapping, str | Path) else "mapping"
    return _Asked(files, place, read_map(mapping) if mapping is not None else None, file, rate)


def _records(files: Sequence[Path], user_map: Map | None) -> list[Record]:
    """Every boot of every log as signals; logs are one where they are streams of one flight."""
    if user_map is not None and user_map.together:
        logs = [_joined([_read(file, user_map, together=True) for file in files])]
        return [record_of(boot, user_map) for log in logs for boot in boots(log)]
    parts = (part for file in files for part in _flights_of(file, user_map))
    return [record_of(boot, user_map) for log in parts for boot in boots(log)]


def _flights_of(file: Path, user_map: Map | None) -> list[Log]:
    """A file's log, or those of its structs where each is a flight and no map says otherwise."""
    log = _read(file, user_map, together=False)
    return apart(log) if user_map is None else [log]


def _read(file: Path, user_map: Map | None, together: bool) -> Log:
    if user_map is None:
        return read_log(file, lambda topic, fields: built_in_fields(topic, list(fields)), None)
    stem = f"{file.stem}." if together else ""
    mapped = choose(e.field.removeprefix(stem) for e in user_map.entries().values() if e.field.startswith(stem))
    built_in = user_map.takes_built_in

    def wanted(topic: str, fields: Sequence[str]) -> list[str]:
        return [*mapped(topic, fields), *(built_in_fields(topic, list(fields)) if built_in else ())]

    return read_log(file, wanted, user_map.clock(), user_map.form())


def _joined(logs: Sequence[Log]) -> Log:
    """Streams of several files as one log, each topic behind the file's name."""

    def name(log: Log, topic: str) -> str:
        return f"{log.file.stem}.{topic}" if topic else log.file.stem

    if len({log.file.stem for log in logs}) < len(logs):
        raise InputError(logs[0].file, "", "has the name of another file", "files of different names for one flight")
    return replace(
        logs[0],
        streams={(name(log, topic), i): s for log in logs for (topic, i), s in log.streams.items()},
        fields={name(log, topic): fields for log in logs for topic, fields in log.fields.items()},
        warnings=tuple(f"{log.file.name}: {sentence}" for log in logs for sentence in log.warnings),
    )


def _usual_rate(records: Sequence[Record]) -> float:
    """Rate of the body rates, else of the fastest control; of the slowest log."""
    usual = []
    for record in records:
        rates = [s.hertz for n, s in record.signals.items() if n in names.RATES]
        controls = [record.signals[n].hertz for n in names.acting(record.signals)]
        usual.append(max(rates or controls))
    return float(f"{min(*usual, FASTEST_HZ):.9g}")  # without rounding of the stamps' differences


def _alike(remarks: Sequence[tuple[str, str]]) -> list[str]:
    """What was said of logs, by file and sentence; what is said of several once."""
    files: dict[str, list[str]] = {}
    for file, sentence in dict.fromkeys(remarks):
        files.setdefault(sentence, []).append(file)
    more = {
        sentence: f" (likewise in {', '.join(others)})" if others else "" for sentence, (_, *others) in files.items()
    }
    return [f"{first}: {sentence}{more[sentence]}" for sentence, (first, *_) in files.items()]


def _vehicle_kind(records: Sequence[Record], user_map: Map | None) -> str:
    if user_map is not None and user_map.kind:
        return user_map.kind
    motors = any(names.is_motor(n) or names.is_rotor_speed(n) for record in records for n in record.entries)
    return records[0].plan.kind or ("multirotor" if motors else "helicopter")


def _controls(records: Sequence[Record], flights: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, Any]:
    """Tables of the controls with their units: motors are 0 to 1, sticks what their map says."""
    declared: dict[str, Any] = {}
    for name in names.ordered_controls({name for arrays in flights.values() for name in arrays}):
        entry = next(record.entries[name] for record in records if name in record.entries)
        unit = units.find_unit(entry.unit)
        declared[name] = {"unit": "norm" if names.is_motor(name) else unit.measures if unit else "rad"}
    return declared


def _taken(record: Record, flights: Mapping[str, tuple[Mapping[str, np.ndarray], str]]) -> dict[str, Taken]:
    """Where each channel of a record's flights came from; what was computed on the grid has no source."""
    taken: dict[str, Taken] = {}
    for name in {channel: None for arrays, _ in flights.values() for channel in arrays if channel != "time"}:
        signal = record.signals.get(name) or (record.signals.get(QUATERNION[0]) if name in ANGLES else None)
        reason = record.plan.reasons.get(QUATERNION[0] if name in ANGLES else name) or record.plan.reasons.get(name, "")
        taken[name] = Taken(str(signal.source) if signal else "", signal.hertz if signal else 0.0, reason)
    return taken
