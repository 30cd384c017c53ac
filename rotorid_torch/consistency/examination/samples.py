"""Samples of single channels: stamps, values that stand still, repeat, are cut off, stand alone, or jump; copies."""

from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter

import numpy as np

from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.imu_place import placed_pairs
from rotorid_torch.consistency.records.clock_steps import ClockStep, clock_steps
from rotorid_torch.consistency.records.copies import Copy, copies
from rotorid_torch.consistency.records.repeated import CLIPPED, LIVE, Samples, examine
from rotorid_torch.consistency.records.stamps import clocks
from rotorid_torch.consistency.records.steps import SURE, Step, steps
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

FROZEN_S = 1.0
"""A measurement that repeats itself exactly for so long, while it moves otherwise, is frozen."""
HELD = 0.6
"""Share of samples that repeat the one before, from which on a channel is renewed more slowly than it is recorded."""
LOST = 0.01
"""Share of rows that repeat, to speak of lost samples."""
TOLD = 6
"""Steps that one sentence names."""
IMPACT_S = 0.06
"""s before and after a touch-down within which its bumps change the velocity."""
ANSWERED_S = 0.02
"""Lateness of a control that counts as a delay of the aircraft."""
COARSE, SPOILT = 0.05, 0.2
"""Step over the rms of the motion, from which on it is told, and from which on it spoils."""


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
    yield from _steps(dataset, by_channel)
    yield from _slow(dataset, by_channel)


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
    listed = names.channel(channel)
    governed = listed is not None and listed.kind == "rotor"  # a governor, or a simulator's battery, rests at a value
    cut = [] if governed else [n for n, s in flights.items() if s.at_edge >= CLIPPED]
    if cut:
        longest = max(flights[name].at_edge for name in cut)
        sentence = f"stays at its largest or least value for up to {longest} samples ({', '.join(cut)}):"
        yield finding(
            "warning",
            channel,
            sentence,
            "cut off by its range. Mark them as missing (NaN), and record with a larger range.",
        )
    alone = {n: _no_impact(dataset, n, channel, s.alone) for n, s in flights.items()}
    if count := sum(map(len, alone.values())):
        where = ", ".join(name for name, places in alone.items() if len(places))
        sentence = f"{count} samples stand alone ({where}), far from their neighbours:"
        yield finding("warning", channel, sentence, "look at them, and mark as missing (NaN) what is no motion.")


def _no_impact(dataset: Dataset, name: str, channel: str, places: np.ndarray) -> np.ndarray:
    """Those of the samples of an accelerometer that the velocity does not answer: a touch-down changes it."""
    flight = dataset.flights[name]
    pair = next((pair for pair in placed_pairs(dataset) if pair.right_name == channel), None)
    if not len(places) or pair is None or not flight.has(*pair.channels):
        return places
    velocity, pushed = pair.left(flight), pair.right(flight)
    felt = flight.bridged([channel])[:, 0].numpy()
    return np.array([k for k in places if not _answered(velocity, pushed, felt, int(k), flight)], int)


def _answered(velocity: np.ndarray, pushed: np.ndarray, felt: np.ndarray, at: int, flight: Flight) -> bool:
    """Whether velocity (T,) changes by the acceleration (T,) around a sample, by half of what the sample adds.

    pushed : the acceleration; felt : what the accelerometer reads, both (T,).
    """
    reach = max(3, round(IMPACT_S / flight.dt))
    first, last = at - reach, at + reach
    if first < reach or last + reach >= len(velocity):
        return False
    before, after = (float(np.median(velocity[k - reach // 2 : k + reach // 2 + 1])) for k in (first, last))
    by = float(pushed[first : last + 1].sum() - 0.5 * (pushed[first] + pushed[last])) * flight.dt
    added = float((felt[first : last + 1] - np.median(felt[first - reach : last + reach + 1])).sum()) * flight.dt
    return abs(after - before - by) < 0.5 * abs(added)


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


def _steps(dataset: Dataset, by_channel: Mapping[str, Mapping[str, Samples]]) -> Iterator[Finding]:
    """Controls and motion that are stored in coarse steps, in one sentence."""
    motion = (*names.RATES, *names.ATTITUDES, *names.SPECIFIC_FORCES, *names.VELOCITIES)
    steps = {c: [s.step for s in by_channel[c].values()] for c in (*dataset.controls, *motion) if c in by_channel}
    scales = dataset.scales()
    # a control rests in many flights
    sizes = {c: max(some) if c in dataset.controls else float(np.median(some)) for c, some in steps.items()}
    coarse = {c: step for c, step in sizes.items() if c in scales and step > COARSE * scales[c]}
    if coarse:
        listed = ", ".join(f"{c} {step:.3g}" for c, step in coarse.items())
        share = max(step / scales[c] for c, step in coarse.items())
        sentence = f"stored in steps ({listed}), up to {share:.0%} of their motion: the steps are noise of that size,"
        grave: Severity = "warning" if share > SPOILT else "note"
        yield finding(grave, " ".join(coarse), sentence, "and rates of change show them most. Record more digits.")


def _slow(dataset: Dataset, by_channel: Mapping[str, Mapping[str, Samples]]) -> Iterator[Finding]:
    """Channels whose values are held between updates, sensors and controls; controls that are drawn between them.

    A control that is held may be the command itself: it is told where all its values last equally long.
    """
    sensors = {
        channel: float(np.median([s.renewed_hz for s in flights.values()]))
        for channel, flights in by_channel.items()
        if channel not in dataset.controls and HELD < np.median([s.repeated for s in flights.values()]) < 1.0
    }
    commands = {c: by_channel[c].values() for c in dataset.controls if c in by_channel}
    held, drawn = (
        {c: 1.0 / float(np.median(times)) for c, of in commands.items() if (times := [*filter(None, map(time, of))])}
        for time in (attrgetter("held_s"), attrgetter("drawn_s"))
    )
    for rates in filter(None, (sensors, held, drawn)):
        slowest, listed = min(rates.values()), ", ".join(f"{c} {hertz:.3g} Hz" for c, hertz in rates.items())
        spoils = rates is not sensors and 0.5 / slowest > ANSWERED_S
        answers = [c for c in (*names.RATES, "az") if spoils and names.is_motor(next(iter(rates))) and c in by_channel]
        grave: Severity = "warning" if spoils else "note"
        how, who = "drawn straight" if rates is drawn else "held", "the commands are " if answers else ""
        more = f"late by up to {0.5 / slowest:.2g} s on average. Interpolate between the updates before use."
        if rates is drawn:
            more = f"what they did faster than {0.5 * slowest:.2g} Hz is not known. Log them faster."
        yield finding(
            grave,
            " ".join((*rates, *answers)),
            f"{who}renewed more slowly than recorded and {how} between ({listed}): {more}",
        )


def jumps(dataset: Dataset) -> Iterator[Finding]:
    """Steps of attitude, velocity and position that no motion makes, with their times."""
    by_flight: dict[str, list[Step]] = {}
    for step in steps(dataset):
        by_flight.setdefault(step.flight, []).append(step)
    for flight, jumped in by_flight.items():
        listed = ", ".join(f"{s.channel} {s.size:+.3g} {names.unit(s.channel)} at {s.at:.2f} s" for s in jumped[:TOLD])
        more = f" and {len(jumped) - TOLD} more" if len(jumped) > TOLD else ""
        channels = " ".join(dict.fromkeys(s.channel for s in jumped))
        sentence = f"steps from one sample to the next ({listed}{more}), which no motion makes:"
        cause = "an estimator was reset. Cut the flight there, or undo the step; no bias is told from it."
        if _rows_lost(dataset.flights[flight], jumped):
            cause = (
                "the sensors jump with them: a stretch is missing there. Cut the flight, or leave a gap in the stamps."
            )
        yield finding("warning", channels, sentence, cause, flight=flight)


def _rows_lost(flight: Flight, jumped: Sequence[Step]) -> bool:
    """Whether body rates or specific force, which no estimator sets, jump at the same samples."""
    sensors = [flight.channels[c].numpy() for c in (*names.RATES, *names.SPECIFIC_FORCES) if flight.has(c)]
    at = np.unique([round(step.at / flight.dt) - 1 for step in jumped])
    changes = [np.abs(np.diff(values)) for values in sensors]
    beyond = [change[at] > SURE * np.nanmedian(change) for change in changes if len(change) > at.max()]
    return bool(np.any(beyond, axis=0).all()) if beyond else False


def clocks_that_jump(dataset: Dataset) -> Iterator[Finding]:
    """Streams whose clock jumps within a flight, with time and size; those of one stream share a sentence."""
    alike: dict[tuple[str, str, bool], list[ClockStep]] = {}
    for step in clock_steps(dataset):
        alike.setdefault((" ".join(step.channels), step.against, step.seconds < 0.0), []).append(step)
    for (channels, against, early), several in alike.items():
        where = [f"by {step.seconds:+.2f} s at {step.at:.1f} s" for step in several]
        where = [f"{place} of {s.flight}" for place, s in zip(where, several, strict=True)] if len(where) > 1 else where
        more = f" and {len(where) - TOLD} more" if len(where) > TOLD else ""
        sentence = f"against {against} the clock jumps {', '.join(where[:TOLD])}{more}:"
        cause = f"samples of {channels if early else against} were lost there, or a clock was set."
        flight = several[0].flight if len(several) == 1 else ""
        yield finding("error", channels, sentence, cause, "Put the later samples back, or cut there.", flight=flight)


def twice(dataset: Dataset) -> Iterator[Finding]:
    """Flights and stretches that are there twice; an error where a list is judged by what another one was fitted to."""
    lists = {name: word for word in ("identify", "validate", "acid") for name in getattr(dataset, word)}
    for one in copies(dataset):
        across = lists.get(one.flight) != lists.get(one.of)
        where = _where(one, dataset)
        if across:
            sentence = f"{where}: {lists.get(one.flight)} is then judged by what {lists.get(one.of)} holds."
            yield finding("error", "", sentence, "Leave one of the two out.", flight=one.flight)
        else:
            sentence = f"{where}: it counts twice."
            yield finding("warning", "", sentence, "Leave one of the two out.", flight=one.flight)


def _where(one: Copy, dataset: Dataset) -> str:
    whole = one.seconds > 0.98 * dataset.facts[one.flight].seconds
    if whole and one.flight != one.of:
        return f"is a copy of {one.of}, sample by sample"
    here = "itself" if one.flight == one.of else one.of
    stretch = f"{one.seconds:.1f} s from {one.at:.1f} s on"
    return f"{stretch} repeat {here} from {one.of_at:.1f} s on, sample by sample"
