"""One log to flights: its signals by a map, the times when all of them are there, the grid, the manoeuvres."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from msgspec import structs

from rotorid_torch.core import names
from rotorid_torch.data.reading.read import SAMPLES
from rotorid_torch.data.reading.suspicion import beyond_half_a_turn
from rotorid_torch.errors import InputError
from rotorid_torch.importing import manoeuvres
from rotorid_torch.importing.formats import built_in_plan
from rotorid_torch.importing.resample import on_grid
from rotorid_torch.importing.signals.derive import (
    ANGLES,
    VELOCITY,
    angles_on_grid,
    before_resampling,
    body_velocity,
    by_rates,
    wrapped,
)
from rotorid_torch.importing.signals.fields import Signal, possible, signals, without_false_percent
from rotorid_torch.importing.signals.mapping import Entry, Map, unknown_names
from rotorid_torch.importing.signals.plan import QUATERNION, Plan, moving
from rotorid_torch.importing.signals.resets import repaired
from rotorid_torch.importing.signals.streams import TOLD, Log, header_name, joined
from rotorid_torch.importing.signals.units import find_unit

FASTEST_HZ = 250.0
"""Rate of the grid at most, unless one is asked for."""
PAUSE_S = 10.0
"""A longer pause of all controls and rates ends a flight and begins another."""
LEAST_S = 1.5
"""Shortest flight that an identification can use."""
BEYOND_S = 5.0
"""What is looked at before and after a flight at least: its ends lie between samples of slow channels."""
RECORDED = {
    "PX4": "actuator_motors or actuator_outputs (SDLOG_PROFILE: high rate, system identification)",
    "ArduPilot": "RCOU (LOG_BITMASK: RCOUT, fast attitude, fast IMU)",
}
"""What a log of each maker must hold, and the setting that records it."""
SLOW = 0.5
"""Controls recorded at less than this share of the body rates' rate are told."""
SMOOTH = frozenset((*QUATERNION, *ANGLES, *VELOCITY, *names.VELOCITIES, *names.POSITIONS))
"""Integrals of what sensors feel, which have no corners between their samples."""
FORMS = ((names.VELOCITIES, VELOCITY), (ANGLES, QUATERNION), (("north", "east"), ("latitude", "longitude")))
"""Vectors, and the other forms in which a log may have the same."""
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Record:
    """One log on its way: signals by channel, what is told of it, times in s at which a flight must end."""

    file: Path
    plan: Plan
    entries: Mapping[str, Entry]
    signals: dict[str, Signal]
    warnings: list[str]
    cuts: tuple[float, ...] = ()


def record_of(log: Log, user_map: Map | None) -> Record:
    """Signals of a log by its map, cleaned; with what follows from them."""
    plan = built_in_plan(log) if user_map is None or user_map.takes_built_in else Plan(user_map.kind, {})
    mapped = user_map.entries() if user_map else {}
    entries = {**plan.entries, **{n: _in_header_unit(log, n, e) for n, e in mapped.items()}}
    if not names.acting(entries):
        columns = [joined(topic, column) for topic, some in log.fields.items() for column in some]
        listed = ", ".join((sorted(log.fields) if log.system and not log.fields.get("") else columns)[:TOLD])
        known = ((names.meant(place.rpartition(".")[2]), place) for place in columns)
        name, place = next((one for one in known if names.is_control(one[0])), ("lon", "FIELD"))
        wanted = "a map (--map) that names lon, lat, col, ped or motor1, motor2, ..., as "
        wanted += f"{name} = '{place}' below [channels]"
        wanted += f", or a log with {RECORDED[log.system]}" if log.system in RECORDED else ""
        raise InputError(log.file, "", f"has no control that is known (it has {listed or 'nothing'})", wanted)
    entries, percent = without_false_percent(log, entries)
    extracted, notes = signals(log, entries, "channels")
    notes += percent
    clean, extracted = dict[str, Signal](), _within_half_a_turn(extracted)
    for name, signal in extracted.items():
        unit = find_unit(entries[name].unit)
        clean[name], sentences = possible(signal, unit.measures if unit else "", log.file)
        notes += sentences
    clean, turned = _turning_one_way(clean)
    clean, order = (clean, "") if log.system else by_rates(clean)
    clean, doubled = _with_content(clean)
    notes += [*turned, *filter(None, (order,)), *doubled]
    chosen = {*user_map.channels} if user_map else set[str]()
    reasons = {
        "recorded less often than the motor commands": _slow_speeds(clean),
        "recorded less often than the rotors' speeds, which are the controls": _slow_commands(clean),
        "never changes": _dead(clean),
    }
    for why, left in reasons.items():
        left_out = [name for name in left if name not in chosen and log.system]
        clean = {name: signal for name, signal in clean.items() if name not in left_out}
        notes += [f"{', '.join(left_out)} left out: {why}"] if left_out else []
    mended = repaired(log, clean)
    unknown = unknown_names(user_map.entries()) if user_map else ()
    warnings = [*log.warnings, *plan.notes, *unknown, *notes, *mended.notes]
    return Record(log.file, plan, entries, before_resampling(mended.signals), warnings, mended.cuts)


def _in_header_unit(log: Log, name: str, entry: Entry) -> Entry:
    """An entry that names no unit, in that of its column's header."""
    field = log.source(entry.field, f"channels.{name}").field
    return entry if entry.unit else structs.replace(entry, unit=header_name(field)[1])


def _within_half_a_turn(extracted: dict[str, Signal]) -> dict[str, Signal]:
    """Signals with wrapped angles where these count from zero, or roll goes on turning as its rate says."""
    records = {name: (signal.time, signal.values) for name, signal in extracted.items()}
    turned = {name: extracted[name] for name in beyond_half_a_turn(records, records.get("p"))}
    return extracted | {name: replace(signal, values=wrapped(signal.values)) for name, signal in turned.items()}


def _with_content(extracted: dict[str, Signal]) -> tuple[dict[str, Signal], list[str]]:
    """Signals without vectors that never change beside the same ones in another form, which do; and sentences."""

    def moves(some: Sequence[str]) -> bool:
        return any(moving(extracted[name].values) for name in some)

    notes = []
    for usual, other in FORMS:
        both = all(name in extracted for name in (*usual, *other))
        if both and moves(other) and not moves(usual):
            extracted = {name: signal for name, signal in extracted.items() if name not in usual}
            notes.append(f"{', '.join(usual)} never change: taken from {', '.join(other)}")
    return extracted, notes


def _turning_one_way(extracted: dict[str, Signal]) -> tuple[dict[str, Signal], list[str]]:
    """Signals with speeds of rotors that are logged negative, by their way round, taken positive; and a sentence."""
    speeds = {name: signal for name, signal in extracted.items() if names.is_rotor_speed(name)}
    back = [n for n, s in speeds.items() if np.nanmax(s.values, initial=-np.inf) <= 0.0 and moving(s.values)]
    positive = {name: replace(speeds[name], values=-speeds[name].values) for name in back}
    note = f"{', '.join(back)} are logged negative, by the way that the rotors turn: taken positive"
    return {**extracted, **positive}, [note] if back else []


def _dead(extracted: Mapping[str, Signal]) -> list[str]:
    """Channels that are there by name only, as position and velocity without a receiver are.

    Angles of an attitude of which one moves are measured, also where the others stand exactly still.
    """
    exempt = {*names.RATES, *QUATERNION}
    if any(moving(extracted[name].values) for name in ANGLES if name in extracted):
        exempt |= {*ANGLES}
    still = (name for name in extracted if not names.is_control(name) and name not in exempt)
    return [name for name in still if not moving(extracted[name].values)]


def _slow_speeds(extracted: Mapping[str, Signal]) -> list[str]:
    """Rotor speeds that would replace commands which are better known on the grid."""
    commands = [signal.hertz for name, signal in extracted.items() if names.is_motor(name)]
    grid = [FASTEST_HZ, *(signal.hertz for name, signal in extracted.items() if name in names.RATES)]
    speeds = [name for name in extracted if names.is_rotor_speed(name)]
    return [name for name in speeds if commands and extracted[name].hertz < 0.8 * min(*commands, *grid)]


def _slow_commands(extracted: Mapping[str, Signal]) -> list[str]:
    """Motor commands that the speeds of as many rotors, which turn, know better."""
    commands = {name: signal.hertz for name, signal in extracted.items() if names.is_motor(name)}
    turning = [s.hertz for n, s in extracted.items() if names.is_rotor_speed(n) and moving(s.values)]
    better_known = len(turning) >= len(commands) > 0 and max(commands.values()) < SLOW * min(turning)
    return list(commands) if better_known else []


def flights_of(
    record: Record, hertz: float, split: bool, taken: set[str]
) -> tuple[dict[str, tuple[Arrays, str]], list[str]]:
    """Flights of a record with their kinds, on the grid, and what was left out."""
    notes = _slow_controls(record)
    spans, left = _spans(record)
    notes += left
    flights: dict[str, tuple[Arrays, str]] = {}
    for number, (start, stop) in enumerate(spans, 1):
        name = _free(_plain(record.file.stem) + (f"_{number}" if len(spans) > 1 else ""), taken | {*flights})
        arrays, sentence = _gridded(record, start, stop, hertz)
        notes += [sentence] if sentence and sentence not in notes else []
        pieces = manoeuvres.cut(arrays, 1.0 / hertz) if split else []
        if split and not pieces:
            notes.append(f"{name}: no control moves for {manoeuvres.SHORTEST_S:g} s: not cut")
        for piece in pieces:
            at = arrays["time"][piece.start]
            part = {channel: values[piece.start : piece.stop] for channel, values in arrays.items()}
            part["time"] = part["time"] - at
            flights[_free(f"{name}_{round(at):04d}s_{piece.kind}", taken | {*flights})] = (part, piece.kind)
        if not pieces:
            flights[name] = (arrays, "")
    return flights, notes


def _slow_controls(record: Record) -> list[str]:
    rates = [s.hertz for n, s in record.signals.items() if n in names.RATES]
    slow = {n: record.signals[n].hertz for n in names.acting(record.signals) if rates}
    slow = {name: hertz for name, hertz in slow.items() if hertz < SLOW * max(rates)}
    if not slow:
        return []
    hertz = min(slow.values())
    rates_words = f"{', '.join(slow)} recorded at {hertz:.3g} Hz, the body rates at {max(rates):.3g} Hz"
    return [f"{rates_words}: above {hertz / 2:.2g} Hz nothing is known of the controls"]


def _spans(record: Record) -> tuple[list[tuple[float, float]], list[str]]:
    """Times from and to which all controls and body rates are there, one per flight; what was left out."""
    acting = names.acting(record.signals)
    needed = {n: s for n, s in record.signals.items() if n in acting or n in names.RATES}
    stamps = {n: s.time[np.isfinite(s.values)] for n, s in needed.items()}
    if empty := next((n for n, time in stamps.items() if len(time) < 2), None):
        raise InputError(record.file, f"{needed[empty].source} ({empty})", "has no samples", "a recorded channel")
    clock = min(stamps.values(), key=len)
    cuts = np.searchsorted(clock, record.cuts)
    edges = np.union1d(np.flatnonzero(np.diff(clock) > PAUSE_S), cuts[(cuts > 0) & (cuts < len(clock))] - 1).astype(int)
    starts, stops = clock[np.concatenate([[0], edges + 1])], clock[np.concatenate([edges, [len(clock) - 1]])]
    spans, short = [], 0
    for start, stop in zip(starts, stops, strict=True):
        first, last = _within(record, start, stop, 1.0)
        inside = [time[slice(*np.searchsorted(time, (first, last)))] for time in stamps.values()]
        low = max((time[0] for time in inside if len(time)), default=stop)
        high = min((time[-1] for time in inside if len(time)), default=start)
        whole = all(map(len, inside)) and high - low >= LEAST_S
        spans += [(float(low), float(high))] if whole else []
        short += not whole
    if spans:
        return spans, [f"{short} stretches of under {LEAST_S:g} s or without all controls left out"] if short else []
    ends = {n: f"{time[0]:.6g} to {time[-1]:.6g} s" for n, time in stamps.items()}
    first = min(stamps, key=lambda n: stamps[n][-1])
    last = max(stamps, key=lambda n: stamps[n][0])
    lasts = max(time[-1] for time in stamps.values()) - min(time[0] for time in stamps.values())
    if lasts < 2.0 * LEAST_S or len({*ends.values()}) == 1:
        wrong = f"lasts {lasts:.2g} s" if lasts < PAUSE_S else f"has no {LEAST_S:g} s without a pause of {PAUSE_S:g} s"
        raise InputError(record.file, "time", wrong, f"a flight of {LEAST_S:g} s at least")
    wrong = f"{first} runs from {ends[first]}, {last} from {ends[last]}: less than {LEAST_S:g} s in common"
    raise InputError(record.file, "time", wrong, "controls and body rates on one clock")


def _within(record: Record, start: float, stop: float, beyond: float) -> tuple[float, float]:
    """Times so many seconds before and after a flight, but not beyond a cut."""
    before = max((cut for cut in record.cuts if cut <= start + 1e-9), default=-np.inf)
    after = min((cut for cut in record.cuts if cut > stop), default=np.inf)
    return max(start - beyond, before), min(stop + beyond, after)


def _gridded(record: Record, start: float, stop: float, hertz: float) -> tuple[Arrays, str]:
    """Channels on the grid between two times, with what is computed there; a sentence where something could not be."""
    count = int((stop - start) * hertz + 1e-6) + 1
    if count > SAMPLES:
        raise InputError(record.file, "time", f"makes {count} samples at {hertz:g} Hz", f"at most {SAMPLES}")
    grid = start + np.arange(count) / hertz
    reach = {name: max(BEYOND_S, 3.0 / s.hertz, 8.0 / hertz) for name, s in record.signals.items()}
    ends = {
        name: np.searchsorted(s.time, _within(record, start, stop, reach[name])) for name, s in record.signals.items()
    }
    parts = {name: (s, slice(*ends[name])) for name, s in record.signals.items()}
    arrays = {name: on_grid(s.time[part], s.values[part], grid, name in SMOOTH) for name, (s, part) in parts.items()}
    arrays, sentence = body_velocity(angles_on_grid(arrays))
    measured = {name: values for name, values in arrays.items() if np.isfinite(values).any()}
    if absent := [name for name in arrays if name not in measured]:
        none = f"{', '.join(absent)} left out of the flight at {start:.6g} s: no samples in it"
        sentence = "; ".join(filter(None, (sentence, none)))
    return {"time": np.arange(count) / hertz, **measured}, sentence


def _plain(stem: str) -> str:
    """File's name as a flight's: letters, digits and a few signs, and no way out of the folder."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", stem).strip("._-")[:60] or "flight"


def _free(name: str, taken: set[str]) -> str:
    if name not in taken:
        return name
    return next(f"{name}_{number}" for number in range(2, len(taken) + 3) if f"{name}_{number}" not in taken)
