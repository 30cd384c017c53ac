"""Samples of single channels: stamps, values that stand still, repeat, are cut off, or stand alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.records.stamps import clocks
from rotorid_torch.core import names
from rotorid_torch.core.statistics import stretches
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.reading.spikes import running_median

FROZEN_S = 1.0
"""A measurement that repeats itself exactly for so long, while it moves otherwise, is frozen."""
HELD = 0.6
"""Share of samples that repeat the one before, from which on a channel is renewed more slowly than it is recorded."""
CLIPPED = 4
"""Samples in a row at a channel's own largest or least value that make a limit."""
STEPS = 2.5
"""Least differences of a record by which one that is stored in steps, and moves slowly, comes to its largest value."""
ALONE = 15.0
"""A sample this many times farther from its neighbours than half of them are stands alone."""
LIVE, LOST = 4, 0.01
"""Channels that must repeat at once, and the share of rows that do, to speak of lost samples."""
FEWEST = 0.001
"""Share of samples that are exactly 0, from which on they are no chance."""
FEW_VALUES = 0.1
"""Different values over samples, up to which a record is stored in steps; longest run of lost samples over all."""
JUMP = 5.0
"""Times the usual change from sample to sample, from which on a change is a jump."""
COARSE, SPOILT = 0.05, 0.2
"""Step over the rms of the motion, from which on it is told, and from which on it spoils."""
OUTLIERS = 0.7
"""The same as a share of the channel's whole range in the flight."""


@dataclass(frozen=True)
class Samples:
    """What repeats in one channel of one flight.

    Share of samples that repeat the one before, longest stretch without a change in s, longest run of samples at the
    largest or least value where nothing else repeats so long, number of samples that stand alone, how often a second
    the value changes, share of samples that are exactly 0 where no other value repeats, and least step between values
    where these are few (else 0).
    """

    repeated: float
    longest_s: float
    at_edge: int
    alone: int
    renewed_hz: float
    zeros: float = 0.0
    step: float = 0.0


def stamps(dataset: Dataset) -> Iterator[Finding]:
    """Jitter of the record's own clock."""
    by_flight = clocks(dataset)
    uneven = {name: clock for name, clock in by_flight.items() if clock.uneven > 0.001}
    if by_flight and not uneven:
        rates = sorted({round(1.0 / clock.median, 1) for clock in by_flight.values()})
        shown = f"{rates[0]:g}" if len(rates) == 1 else f"{rates[0]:g} to {rates[-1]:g}"
        yield finding("good", "time", f"stamps are even within 1 % ({shown} Hz).")
    if uneven:
        share = max(clock.uneven for clock in uneven.values())
        shortest = min(clock.shortest for clock in uneven.values()) * 1e3
        longest = max(clock.longest for clock in uneven.values()) * 1e3
        median = float(np.median([c.median for c in uneven.values()])) * 1e3
        where = f"stamps jitter in {len(uneven)} of {len(by_flight)} flights"
        sentence = f"{where}: intervals of {shortest:.3g} to {longest:.3g} ms,"
        more = f"median {median:.4g} ms, up to {share:.0%} of them over 1 % off; resampled to a uniform grid."
        grave: Severity = "warning" if longest > 3.0 * median else "note"
        yield finding(grave, "time", sentence, more, "Record on one clock if fast dynamics matter.")


def repeats(dataset: Dataset) -> Iterator[Finding]:
    """Channels that freeze, are renewed slowly, are cut off, or hold samples that stand alone."""
    by_channel: dict[str, dict[str, Samples]] = {}
    for name, flight in dataset.flights.items():
        for channel, values in flight.channels.items():
            if channel != "time" and names.channel(channel) is not None:
                by_channel.setdefault(channel, {})[name] = examine(values.numpy(), flight.dt)
    yield from _frozen(dataset, by_channel)
    for channel, flights in by_channel.items():
        yield from _told(dataset, channel, flights)
    yield from _zeros({c: flights for c, flights in by_channel.items() if c not in dataset.controls})
    yield from _steps(dataset, by_channel)
    yield from _slow({channel: flights for channel, flights in by_channel.items() if channel not in dataset.controls})


def rows(dataset: Dataset) -> Iterator[Finding]:
    """Rows that repeat the one before in every channel: samples that were lost, and filled by holding the last."""
    lost: dict[str, float] = {}
    for name, flight in dataset.flights.items():
        moving = [values.numpy() for channel, values in flight.channels.items() if channel != "time"]
        moving = [values for values in moving if np.mean(np.diff(values) == 0.0) < HELD]
        if len(moving) >= LIVE:
            same = np.all([np.diff(values) == 0.0 for values in moving], axis=0)
            lost[name] = float(same.mean())
    many = {name: share for name, share in lost.items() if share > LOST}
    if many:
        shares = ", ".join(f"{name} {share:.0%}" for name, share in many.items())
        reason = (
            f"rows repeat the one before in every channel ({shares} of them): samples were lost and the last one held."
        )
        yield finding("warning", "", reason, "Mark them as missing (NaN); held samples are late and spoil derivatives.")


def _told(dataset: Dataset, channel: str, flights: Mapping[str, Samples]) -> Iterator[Finding]:
    if channel in dataset.controls:
        return
    cut = [n for n, s in flights.items() if s.at_edge >= CLIPPED]
    if cut:
        longest = max(flights[name].at_edge for name in cut)
        sentence = f"stays at its largest or least value for up to {longest} samples ({', '.join(cut)}):"
        yield finding(
            "warning",
            channel,
            sentence,
            "cut off by its range. Mark them as missing (NaN), and record with a larger range.",
        )
    alone = {n: s.alone for n, s in flights.items() if s.alone and s.zeros < FEWEST}
    if alone:
        sentence = f"{sum(alone.values())} samples stand alone ({', '.join(alone)}), far from their neighbours:"
        yield finding("warning", channel, sentence, "look at them, and mark as missing (NaN) what is no motion.")


def _frozen(dataset: Dataset, by_channel: Mapping[str, Mapping[str, Samples]]) -> Iterator[Finding]:
    """Channels that stand still and move otherwise; those that do so in the same flights share a sentence."""
    alike: dict[tuple[str, ...], dict[str, float]] = {}
    for channel, flights in by_channel.items():
        still = {
            n: s.longest_s for n, s in flights.items() if s.longest_s > FROZEN_S and s.longest_s * s.renewed_hz > 20.0
        }
        if still and channel not in dataset.controls:
            alike.setdefault(tuple(still), {})[channel] = max(still.values())
    for flights, channels in alike.items():
        verb, other = ("stand", "move") if len(channels) > 1 else ("stands", "moves")
        lasts, where = max(channels.values()), ", ".join(flights)
        sentence = f"{verb} exactly still for up to {lasts:.2g} s and {other} otherwise ({where}): frozen."
        advice = "Mark these samples as missing (NaN), or leave the flight out."
        yield finding("warning", " ".join(channels), sentence, advice)


def _zeros(by_channel: Mapping[str, Mapping[str, Samples]]) -> Iterator[Finding]:
    """Samples of sensors that were lost and written as 0, in one sentence; a control may rest there."""
    zeros = {channel: max(s.zeros for s in flights.values()) for channel, flights in by_channel.items()}
    if lost := {channel: share for channel, share in zeros.items() if share >= FEWEST}:
        shares = ", ".join(f"{channel} {share:.2g}" for channel, share in ((c, 100.0 * x) for c, x in lost.items()))
        sentence = f"exactly 0 in up to so many percent of the samples ({shares}), and no other value repeats:"
        cause = "missing samples were written as 0. Mark them as missing (NaN)."
        yield finding("warning", " ".join(lost), sentence, cause)


def _steps(dataset: Dataset, by_channel: Mapping[str, Mapping[str, Samples]]) -> Iterator[Finding]:
    """Motion that is stored in coarse steps, in one sentence."""
    motion = (*names.RATES, *names.ATTITUDES, *names.SPECIFIC_FORCES, *names.VELOCITIES)
    steps = {c: float(np.median([s.step for s in by_channel[c].values()])) for c in motion if c in by_channel}
    scales = dataset.scales()
    coarse = {c: step for c, step in steps.items() if c in scales and step > COARSE * scales[c]}
    if coarse:
        listed = ", ".join(f"{c} {step:.3g}" for c, step in coarse.items())
        share = max(step / scales[c] for c, step in coarse.items())
        sentence = f"stored in steps ({listed}), up to {share:.0%} of their motion: the steps are noise of that size,"
        grave: Severity = "warning" if share > SPOILT else "note"
        yield finding(grave, " ".join(coarse), sentence, "and rates of change show them most. Record more digits.")


def _slow(by_channel: Mapping[str, Mapping[str, Samples]]) -> Iterator[Finding]:
    """Channels whose values are held between updates, in one sentence."""
    rates = {
        channel: float(np.median([s.renewed_hz for s in flights.values()]))
        for channel, flights in by_channel.items()
        if HELD < np.median([s.repeated for s in flights.values()]) < 1.0
    }
    if rates:
        hertz_of = ", ".join(f"{channel} {hertz:.3g} Hz" for channel, hertz in rates.items())
        late = max(0.5 / hertz for hertz in rates.values())
        yield finding(
            "note",
            " ".join(rates),
            f"renewed more slowly than recorded and held between ({hertz_of}): late by up to {late:.2g} s on average.",
            "Interpolate between the updates before use.",
        )


def examine(values: np.ndarray, dt: float) -> Samples:
    """Figures of one record (T,), see `Samples`."""
    x = values[np.isfinite(values)]
    if len(x) < 16 or np.ptp(x) == 0.0:
        return Samples(1.0, len(x) * dt, 0, 0, 0.0)
    same = np.diff(x) == 0.0
    edges = (x == x.max()) | (x == x.min())
    usual = _longest(same & ~edges[1:])  # what repeats elsewhere is no limit
    rests = (x == 0.0) & (x.min() == 0.0)  # rotors that do not turn, a pitot without wind
    edge = max(_beyond_steps(x, x == x.max()), _beyond_steps(x, (x == x.min()) & ~rests))
    edge = edge if edge > 2 * (usual + 1) else 0
    changes = int((~same).sum())
    inside = same & ~(edges[1:] if edge >= CLIPPED else rests[1:])  # what is cut off by its range is not frozen
    levels, counts = np.unique(x, return_counts=True)
    zeros, others = int(counts[levels == 0.0].sum()), int(counts[levels != 0.0].max(initial=0))
    few = len(levels) < FEW_VALUES * len(x)
    return Samples(
        repeated=float(same.mean()),
        longest_s=_beyond_steps(x, inside) * dt,
        at_edge=edge,
        alone=_alone(x),
        renewed_hz=changes / (len(x) * dt),
        zeros=zeros / len(x) if zeros >= LIVE and others < 0.2 * zeros and _lost(x) > max(LIVE, 0.2 * zeros) else 0.0,
        step=float(np.median(np.diff(levels))) if few else 0.0,
    )


def _lost(x: np.ndarray) -> int:
    """Samples at 0 that a record jumps to and from, by more than it moves otherwise: not at rest or a limit."""
    moved = np.abs(np.diff(x))
    least = JUMP * float(np.median(moved[moved > 0.0]))
    inside = ((a, b) for a, b in stretches(x == 0.0) if a > 0 and b < len(x))
    return sum(b - a for a, b in inside if min(moved[a - 1], moved[b - 1]) > least and b - a <= FEW_VALUES * len(x))


def _longest(true: np.ndarray) -> int:
    return max((last - first for first, last in stretches(true)), default=0)


def _beyond_steps(x: np.ndarray, true: np.ndarray) -> int:
    """Longest run that is entered or left by more than the record's least steps: else it is resolution.

    `true` is of each sample, or of each change between two.
    """
    moved = np.abs(np.diff(x))
    least = STEPS * float(moved[moved > 0.0].min())
    after = len(true) - len(moved)  # a run of samples is left by the change before its end
    beyond = [
        b - a
        for a, b in stretches(true)
        if max(moved[a - 1] if a else 0.0, moved[b - after] if b - after < len(moved) else 0.0) > least
    ]
    return int(max(beyond, default=0))


def _alone(x: np.ndarray) -> int:
    """Samples far from the median of their neighbours, by their usual distance and by the record's range."""
    jumps = np.abs(np.diff(x))
    if jumps.max() < 0.5 * OUTLIERS * np.ptp(x):
        return 0
    middle = running_median(x, 3)
    away = np.abs(x - middle)
    usual = float(np.median(away[away > 0.0])) if (away > 0.0).any() else 0.0
    return int((away > max(ALONE * usual, OUTLIERS * float(np.ptp(middle)))).sum())
