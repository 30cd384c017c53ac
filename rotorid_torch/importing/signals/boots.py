"""Several boots in one log: clocks that begin again make one log each."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorid_torch.importing.signals.fields import ASTRAY_S, OUT_OF_ORDER, astray
from rotorid_torch.importing.signals.streams import Log, Stream

LEAST = 50
"""Samples of a stream that has a say in how many boots there are."""
COUNTS_S = [2.0**bits * unit for unit in (1e-6, 1e-3) for bits in (16, 24, 31, 32)]
PERIODS_S = (*COUNTS_S, 3600.0, 86400.0, 604800.0)
"""What clocks count to: 16, 24, 31 or 32 bits of us or ms, an hour, a day, the week of satellites."""
SPAN = 5.0
"""Usual intervals within which the next stamp comes where a clock runs on."""
MOST = 20
"""Boots of a log; a clock that begins again more often is none."""


def boots(log: Log) -> list[Log]:
    """One log for each boot, in the file's order; the log itself where no clock begins again.

    Streams that do not begin again as often as those with most samples are left out, for nothing says to which boot
    they belong.
    """
    runs = {place: _running_on(stream.time) for place, stream in log.streams.items()}
    if wrapped := {period for _, period in runs.values() if period}:
        listed = ", ".join(f"{period:.10g} s" for period in sorted(wrapped))
        streams = {place: replace(stream, time=runs[place][0]) for place, stream in log.streams.items()}
        note = f"the clock begins again after {listed}, all that it counts to: it runs on"
        log = replace(log, streams=streams, warnings=(*log.warnings, note))
    begun = {place: _beginnings(stream.time) for place, stream in log.streams.items()}
    samples: dict[int, int] = {}
    for place, starts in begun.items():
        if len(log.streams[place].time) >= LEAST:
            samples[len(starts)] = samples.get(len(starts), 0) + len(log.streams[place].time)
    count = max(samples, key=lambda boots: (samples[boots], boots), default=1)
    if count == 1:
        return [log]
    whole = {place: starts for place, starts in begun.items() if len(starts) == count}
    left = [topic for topic, instance in begun if (topic, instance) not in whole and topic]
    note = f"the clock begins again: {count} boots, each a flight of its own"
    note += f" ({', '.join(dict.fromkeys(left))} left out: not in every boot)" if left else ""
    return [
        replace(log, streams=_part(log, whole, i), warnings=(*log.warnings, *([note] if i == 0 else [])))
        for i in range(count)
    ]


def _running_on(time: np.ndarray) -> tuple[np.ndarray, float]:
    """A clock (T,) in s that runs on where it came to the end of what it counts, and its period; 0 where it never did.

    At such an end the next stamp, a period later, is where it belongs: a usual interval after the last one.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < -ASTRAY_S)
    forward = steps[steps > 0.0]
    if not 0 < len(back) <= MOST or not len(forward):
        return time, 0.0
    most = SPAN * float(np.median(forward))
    period = next((p for p in PERIODS_S if ((steps[back] + p > 0.0) & (steps[back] + p < most)).all()), 0.0)
    turns = np.zeros(len(time))
    turns[back + 1] = period
    return time + np.cumsum(turns), period


def _part(log: Log, begun: Mapping[tuple[str, int], list[int]], number: int) -> dict[tuple[str, int], Stream]:
    parts = {}
    for place, starts in begun.items():
        stream = log.streams[place]
        part = slice(starts[number], (*starts, len(stream.time))[number + 1])
        parts[place] = Stream(stream.time[part], {name: values[part] for name, values in stream.columns.items()})
    return parts


def _beginnings(time: np.ndarray) -> list[int]:
    """First sample of each boot of a clock (T,) in s.

    A clock begins again where it runs back by over `ASTRAY_S` and on from there, for long enough to be a record.
    """
    finite = np.flatnonzero(np.isfinite(time))
    usual = finite[~astray(time[finite])]
    back = usual[1:][np.diff(time[usual]) < -ASTRAY_S]
    starts = [0, *back.tolist()]
    lengths = np.diff([*starts, len(time)])
    return starts if len(starts) <= MOST and lengths.min() >= OUT_OF_ORDER * lengths.max() else [0]
