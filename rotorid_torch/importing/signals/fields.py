"""From fields of a log to signals: a clean clock, SI units, impossible samples taken out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from msgspec.structs import replace as replace_entry

from rotorid_torch.core import names
from rotorid_torch.core.ranges import of_channel
from rotorid_torch.data.plausible import without_impossible
from rotorid_torch.data.reading.marks import without_marks
from rotorid_torch.errors import InputError
from rotorid_torch.importing.signals import units
from rotorid_torch.importing.signals.mapping import Entry, check_unit
from rotorid_torch.importing.signals.outputs import STRAY, beyond
from rotorid_torch.importing.signals.plan import rate_of
from rotorid_torch.importing.signals.streams import Log, Source, Stream, is_numbers

OUT_OF_ORDER = 0.1
"""Share of stamps that may repeat, or run back far; more are two clocks."""
PULSE_SPANS = 3.0
"""Spans between the pulses of 0 and 1 about their middle, within which a pulse, or none, is that of a motor."""
ASTRAY_S = 1.0
"""A single stamp this far from those around it is damaged."""


@dataclass(frozen=True)
class Signal:
    """One channel of a log: time (T,) in s, increasing; values (T,) in SI, NaN where missing; where it comes from."""

    name: str
    time: np.ndarray
    values: np.ndarray
    source: Source

    @property
    def hertz(self) -> float:
        """Usual rate of samples that are there: a table may have a row for every message."""
        return rate_of(self.time[np.isfinite(self.values)])


class BadClock(Exception):
    """A stream's clock that cannot be used; says why and what was expected."""

    def __init__(self, wrong: str, expected: str) -> None:
        self.wrong, self.expected = wrong, expected
        super().__init__(wrong)


def signals(log: Log, entries: Mapping[str, Entry], key: str) -> tuple[dict[str, Signal], list[str]]:
    """Signals of all entries, and sentences on what was taken out or left out.

    `key` is where the entries stand, for messages. A channel whose clock cannot be used is left out with a sentence,
    but for a control or a body rate, without which there is nothing to import.

    Raises InputError: for a field that is not there, a unit that does not fit, a control or rate without a usable
    clock.
    """
    extracted, notes, clocks = dict[str, Signal](), list[str](), dict[tuple[str, int], np.ndarray | BadClock]()
    for name, entry in entries.items():
        source = log.source(entry.field, f"{key}.{name}")
        check_unit(name, entry, log.file, key=f"'{entry.field}'")
        place = (source.topic, source.instance)
        if place not in clocks:
            clocks[place] = _usable(log.streams[place], source, notes)
        usable = clocks[place]
        if isinstance(usable, BadClock):
            if names.is_control(name) or name in names.RATES:
                raise InputError(log.file, f"{source} ({name})", usable.wrong, usable.expected)
            notes.append(f"{name} is left out: the clock of {source.topic or 'the table'} {usable.wrong}")
            continue
        stream = log.streams[place]
        values = _taken(log, source, stream)[usable]
        extracted[name] = Signal(name, stream.time[usable], _in_si(name, values, entry, log, source), source)
    return extracted, notes


def without_false_percent(log: Log, entries: Mapping[str, Entry]) -> tuple[dict[str, Entry], list[str]]:
    """Entries of which controls in percent that all stay within one percent are the shares 0 to 1; and a sentence."""
    listed = {n: e for n, e in entries.items() if names.is_control(n) and units.find_unit(e.unit) is units.UNITS["%"]}
    plain = {name: entry for name, entry in listed.items() if (entry.scale, entry.offset) == (1.0, 0.0)}
    largest = 0.0
    for entry in plain.values():
        source = log.source(entry.field, "channels")
        values = _taken(log, source, log.streams[source.topic, source.instance])
        largest = max(largest, float(np.nanmax(np.abs(values.astype(np.float64)), initial=0.0)))
    if not plain or len(plain) < len(listed) or not 0.0 < largest <= 1.0:
        return dict(entries), []
    note = f"{', '.join(plain)} reach {largest:.3g} at most: shares of 1 and no percent, taken as they are"
    return {**entries, **{name: replace_entry(entry, unit="norm") for name, entry in plain.items()}}, [note]


def _taken(log: Log, source: Source, stream: Stream) -> np.ndarray:
    values = stream.columns[source.field]
    if not is_numbers(values):
        raise InputError(log.file, str(source), "is text", "a field of numbers")
    return values


def _usable(stream: Stream, source: Source, notes: list[str]) -> np.ndarray | BadClock:
    """Samples of a stream in the order of their stamps, as indices (n,)."""
    new = np.flatnonzero(~_repeated(stream))
    try:
        usable = new[increasing(stream.time[new])]
    except BadClock as bad:
        return bad
    where = source.topic or "the table"
    if moved := int((np.diff(usable) < 0).sum()):
        notes.append(f"{where}: {moved} samples with a stamp before the last one were sorted in")
    if twice := len(stream.time) - len(new):
        notes.append(f"{where}: {twice} rows that repeat the one before, stamp and all, were left out")
    if lost := len(new) - len(usable):
        notes.append(f"{where}: {lost} samples with a stamp that repeats or runs back were left out")
    return usable


def _repeated(stream: Stream) -> np.ndarray:
    """Rows (T,) that are the one before once more, with its stamp; none where the clock stands all along."""
    same = np.concatenate([[False], np.diff(stream.time) == 0.0])[: len(stream.time)]
    for values in (values for values in stream.columns.values() if same.any() and is_numbers(values)):
        same[1:] &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    return same & (not same[1:].all())


def increasing(time: np.ndarray) -> np.ndarray:
    """Samples (n,) to take, in this order, so that time increases.

    What was written a little late is sorted in; a stamp that is far astray or repeats is given up.

    Raises BadClock: where time stands still or repeats, or runs back so far that there are two clocks.
    """
    finite = np.isfinite(time)
    if len(time) < 2:
        raise BadClock(f"holds {'one sample' if len(time) else 'no sample'}", "at least two")
    if not finite.any():
        raise BadClock("has no stamp", "time in s for every sample")
    steps = np.diff(time)
    if finite.all() and len(steps) and (steps > 0).all() and steps.max() < ASTRAY_S:
        return np.arange(len(time))
    places = np.flatnonzero(finite)
    places = places[~astray(time[places])]
    stamps = time[places]
    if len(stamps) < 2 or stamps.min() == stamps.max():
        raise BadClock(f"stands still at {time[finite][0]:.6g} s", "a clock that runs")
    if (np.diff(stamps) < 0.0).mean() > 1.0 - OUT_OF_ORDER:  # newest first
        places, stamps = places[::-1], stamps[::-1]
    late = np.maximum.accumulate(stamps) - stamps
    if late.max() > ASTRAY_S:
        ahead = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
        if (~ahead).mean() > OUT_OF_ORDER:
            at = int(np.flatnonzero(stamps[1:] < stamps[:-1])[0])
            wrong = f"runs back from {stamps[at]:.6g} to {stamps[at + 1]:.6g} s: two time bases?"
            raise BadClock(wrong, "one clock that runs on")
        return places[ahead]
    order = np.argsort(stamps, kind="stable")
    new = np.concatenate([[True], np.diff(stamps[order]) > 0.0])
    if (~new).mean() > OUT_OF_ORDER:
        raise BadClock(f"repeats its stamps ({(~new).mean():.0%} of them)", "a stamp for every sample")
    return places[order][new]


def astray(time: np.ndarray) -> np.ndarray:
    """Single stamps, or pairs, far from the median of the five around them."""
    if len(time) < 5:
        return np.zeros(len(time), bool)
    padded = np.concatenate([time[2:0:-1], time, time[-2:-4:-1]])
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    return np.abs(time - middle) > max(ASTRAY_S, 20.0 * float(np.median(np.abs(np.diff(middle)))))


def _in_si(name: str, values: np.ndarray, entry: Entry, log: Log, source: Source) -> np.ndarray:
    """Convert to SI as the entry says; a pulse of a motor at rest is 0, one that no servo takes stays as it is.

    Raises InputError: for a motor's commands whose range is another one, so that clipping would flatten them.
    """
    unit = units.find_unit(entry.unit) or units.Unit("")
    factor, offset = unit.factor, unit.offset
    with np.errstate(all="ignore"):  # whatever bytes a damaged log holds
        result = entry.sign * (entry.scale * values.astype(np.float64) + entry.offset) * factor + offset
    if names.is_motor(name):
        near = np.abs(result - 0.5) <= PULSE_SPANS
        if beyond(result[near], 0.0, 1.0) > STRAY * max(int(near.sum()), 1):
            low, high = float(np.nanmin(values[near])), float(np.nanmax(values[near]))
            wrong = f"runs from {low:g} to {high:g}, beyond what stands for commands 0 to 1"
            both = " (a motor that turns both ways?)" if low < 0.0 else ""
            wanted = "the range of its protocol: scale and offset in a map"
            raise InputError(log.file, f"{source} ({name})", f"{wrong}{both}", wanted)
        if entry.unit == "us" or entry.offset:
            result = np.where(near, np.clip(result, 0.0, 1.0), result)
    return result


def possible(signal: Signal, unit: str, file: object) -> tuple[Signal, list[str]]:
    """The signal with samples as NaN that no aircraft has or that stand for a missing one, and sentences on these.

    `unit` is that of a stick, in SI.

    Raises InputError where so many are impossible that the unit is another.
    """
    allowed = of_channel(signal.name, unit).samples
    key = f"{signal.source} ({signal.name})"
    marked, sentences = without_marks({signal.name: signal.values}, {signal.name: unit})
    values, sentence = without_impossible(signal.name, marked[signal.name], allowed, str(file), key)
    return replace(signal, values=values), [*sentences, *filter(None, [sentence])]
