"""Each record by itself: gaps, units, flights upside down, gravity, noise, vibration."""

import re
from collections.abc import Iterator, Sequence

import numpy as np

from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.records.slow import drawn_between, rhythms, slow_channels
from rotorid_torch.consistency.records.vibration import content_ends, lines, spectrum
from rotorid_torch.core import names
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.reading.noise import white_noise
from rotorid_torch.data.velocities.source import DECLARED_SPEED, inertial, starts_at_speed

RARER = 0.3
"""Share of samples that repeat the one before, or lie on a line with the last two, from which on readings are rarer."""
UP = "Where all channels are in axes forward, left, up, turn v w q r theta psi ay and east too."
"""What else a specific force that points down may mean."""
UPWARD = 0.3
"""Share of gravity that an axis which points up reads at least; less is an accelerometer without gravity."""
IN_G = 0.7, 1.4
"""What an accelerometer that tells shares of gravity reads where a flight begins."""
OVERSHOOT = 0.15
"""Of the range: how far a step from one end to the other may swing beyond where a low-pass drew it on a slower grid."""
RPM = 60.0 / (2.0 * np.pi)
"""Revolutions a minute of one rad/s."""
FILLS, SOUND = 0.8, 340.0
"""Radius of a rotor over half the distance of the nearest motors, about the least; m/s that no tip exceeds."""
FEW = 0.005
"""Share of missing samples that does no harm."""


def reading(dataset: Dataset) -> Iterator[Finding]:
    """What had to be changed or left out on reading."""
    told_by_clock = dataset.path is not None  # the stamps are told from the files then
    for flight, sentence in condensed(dataset.warnings):
        if flight and "taken as missing" in sentence:
            channel, _, text = sentence.partition(": ")
            several = all(map(names.channel, channel.split()))
            channel, sentence = (channel, text) if several else (sentence.partition(" ")[0], sentence)
            advice = "Look at the telemetry; nothing that follows sees these samples."
            yield finding("warning", channel, f"{sentence}.", advice, flight=flight)
        elif flight and not (told_by_clock and sentence.startswith("time is not uniform")):
            advice = "Record on one clock if fast dynamics matter."
            yield finding("note", "time", f"{sentence}.", advice, flight=flight)
        elif flight:
            continue
        else:
            yield finding("note", "", f"{sentence}.")
    rates = sorted({round(1.0 / facts.dt, 2) for facts in dataset.facts.values()})
    if rates[-1] > 1.05 * rates[0]:
        yield finding("note", "time", f"flights are sampled at {rates[0]:g} to {rates[-1]:g} Hz.")


def dead(dataset: Dataset) -> Iterator[Finding]:
    """Channels that were left out because they never change; body rates, which every step needs, are errors."""
    for one in (one for one in dataset.dead if one.channel not in names.RATES):
        yield finding("warning", one.channel, one.sentence)


def inverted(dataset: Dataset) -> Iterator[Finding]:
    """Flights in which a helicopter turns over: its forces and moments are linear about a trim."""
    for flight in dataset if dataset.kind == "helicopter" else ():
        over = np.flatnonzero(np.cos(flight.stack(("phi", "theta")).numpy()).prod(axis=1) < 0.0)
        if len(over):
            sentence = f"upside down from {over[0] * flight.dt:.1f} s on: no model about a trim holds there."
            yield finding(
                "warning", "p q r", sentence, "End the flight before it departs, or leave it out.", flight=flight.name
            )


def condensed(warnings: Sequence[str]) -> list[tuple[str, str]]:
    """Flight and sentence of a data set's warnings; those that begin alike become one, the first flight's."""
    first, others = dict[str, tuple[str, str]](), dict[str, list[str]]()
    for sentence in warnings:
        name, _, remainder = sentence.partition(": ")
        flight, text = (
            (name.removeprefix("flight "), remainder) if name.startswith("flight ") and remainder else ("", sentence)
        )
        words = " ".join(text.split()[:2]).removesuffix("s") if flight else text
        kind = re.sub("[0-9]+ ", "# ", words)
        if kind in first and flight not in (first[kind][0], *others[kind]):
            others[kind].append(flight)
        elif kind not in first:
            first[kind], others[kind] = (flight, text), []
    likewise = {kind: f" (likewise in {', '.join(flights)})" if flights else "" for kind, flights in others.items()}
    return [(flight, text + likewise[kind]) for kind, (flight, text) in first.items()]


def gaps(dataset: Dataset) -> Iterator[Finding]:
    """Missing samples: channels that lack few, many or too many are one finding each."""
    rows, slow, every = 1.0 / dataset.facts[dataset.identify[0]].dt, slow_channels(dataset), rhythms(dataset)
    seldom = {channel: rate for channel, rate in every.items() if channel not in slow}
    between = "drawn between the samples here; faster motion is not in them.", "nothing is known of the motion between."
    for some, what in zip((slow, seldom), between, strict=True):
        hertz = ", ".join(f"{channel} {rate:.3g} Hz" for channel, rate in some.items())
        sentence = f"sampled more slowly than the rows of {rows:.0f} Hz and missing between ({hertz}):"
        yield from [finding("note", " ".join(some), sentence, what)] if some else []
    alike: dict[tuple[Severity, bool, str], dict[str, dict[str, float]]] = {}
    for name, flight in drawn_between(dataset).flights.items():
        for channel, values in flight.channels.items():
            share = float(values.isnan().double().mean())
            share -= 1.0 - seldom[channel] * flight.dt if channel in seldom else 0.0
            if share > (FEW if channel in every else 0.0):  # of a slow channel some rows at the ends
                use = "bridged by a straight line" if channel in dataset.controls else "skipped"
                kind: Severity = "warning" if share > 0.05 else "note"
                alike.setdefault((kind, share > FEW, use), {}).setdefault(name, {})[channel] = share
    for (kind, many, use), flights in alike.items():
        shares = {name: max(channels.values()) for name, channels in flights.items()}
        most = max(shares, key=lambda name: shares[name])
        where = f" in {len(flights)} of {len(dataset.flights)} flights, most in {most}" if len(flights) > 1 else ""
        channels = " ".join(dict.fromkeys(channel for flight in flights.values() for channel in flight))
        sentence = f"up to {100.0 * shares[most]:.3g} % of the samples are missing{where}; they are {use}."
        advice = ["Leave out a flight that has lost what it is for."] if many else []
        yield finding(kind, channels, sentence, *advice, flight="" if where else most)


def units(dataset: Dataset) -> Iterator[Finding]:
    """Sizes that speak of another unit."""
    bounds = ((names.RATES, 35.0, "degrees per second?"), (names.VELOCITIES, 150.0, "knots or feet per second?"))
    for channels, bound, guess in bounds:
        for channel in channels:
            largest = max(_largest(dataset, channel), default=0.0)
            if largest > bound:
                sentence = f"reaches {largest:.3g} {names.unit(channel)} ({guess})."
                yield finding("warning", channel, sentence, "Check its unit and look for spikes.")
    for control in filter(names.is_motor, dataset.controls):
        spreads = [facts.spreads[control] for facts in dataset.facts.values()]
        low, high = min(spread.low for spread in spreads), max(spread.high for spread in spreads)
        if low < -OVERSHOOT or high > 1.0 + OVERSHOOT:
            yield finding("error", control, f"runs from {low:.4g} to {high:.4g}. Scale the motor command to 0…1.")
    yield from _rotor_speeds(dataset)


def _rotor_speeds(dataset: Dataset) -> Iterator[Finding]:
    """Speeds of rotors that no rotor has: far from the declared one, or with tips faster than sound."""
    rotor, means = dataset.vehicle.rotor, dict[str, float]()
    for channel in (c for c in dataset.scales() if c == "omega" or names.is_rotor_speed(c)):
        spreads = [facts.spreads[channel] for facts in dataset.facts.values() if facts.has(channel)]
        means[channel] = float(np.median([abs(spread.mean()) for spread in spreads]))
    if rotor and rotor.speed and "omega" in means and not 0.5 < (ratio := means["omega"] / rotor.speed) < 2.0:
        unit = " (rpm?)" if abs(ratio / RPM - 1.0) < 0.1 else ""
        sentence = f"turns at {means['omega']:.3g} rad/s, {ratio:.3g} times the declared rotor.speed{unit}."
        yield finding("error", "omega", sentence, "Correct its unit, or the declaration.")
    places = np.array([motor.position for motor in dataset.vehicle.motors or ()]).reshape(-1, 3)
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    reach = 0.5 * float(apart[apart > 1e-3].min(initial=np.inf))
    fast = [c for c, mean in means.items() if c != "omega" and np.isfinite(reach) and FILLS * reach * mean > SOUND]
    if fast:
        tips = f"{FILLS * reach * max(means[c] for c in fast):.0f} m/s"
        sentence = f"turns so fast ({max(means[c] for c in fast):.4g} rad/s) that tips of rotors which fit between the"
        yield finding("warning", " ".join(fast), f"{sentence} motors reach {tips}: beyond sound. Is it in rpm?")


def _largest(dataset: Dataset, channel: str) -> Iterator[float]:
    for facts in dataset.facts.values():
        if facts.has(channel):
            yield max(abs(facts.spreads[channel].low), abs(facts.spreads[channel].high))


def gravity(dataset: Dataset) -> Iterator[Finding]:
    """Whether the vertical accelerometer reads gravity where the flights begin."""
    expected = -dataset.vehicle.gravity
    records = {n: flight.channels["az"] for n, flight in dataset.flights.items() if flight.has("az")}
    starts = {name: float(record[: dataset.quiet(name)].nanmean()) for name, record in records.items()}
    starts = {name: start for name, start in starts.items() if np.isfinite(start)}
    if not starts:
        return
    az = float(np.median([*starts.values()]))
    sentence, wrong = f"reads {az:.2f} m/s² at the start of the flights", _wrong_gravity(az, expected)
    for name, start in starts.items():
        usual = float(records[name].nanmedian())  # a flight may begin in a manoeuvre
        if (other := _wrong_gravity(start, expected)) not in ("", wrong) and other == _wrong_gravity(usual, expected):
            one = f"reads {start:.2f} m/s² at its start, {usual:.2f} m/s² usually, unlike in the other flights"
            yield finding("error", "az", f"{one}{other}", flight=name)
    if wrong:
        yield finding("error", "az", f"{sentence}{wrong}")
    elif abs(az / expected - 1.0) > 0.03:
        reason = "the flights begin in a manoeuvre, or the accelerometer has a bias or a scale error"
        yield finding(
            "note", "az", f"{sentence} instead of {expected:.2f}: {reason}. Calibrate it before believing mass."
        )
    else:
        yield finding("good", "az", f"{sentence}, as gravity demands.")


def _wrong_gravity(az: float, expected: float) -> str:
    """What is wrong with a vertical specific force of level flight, and what to do; empty where nothing is for sure."""
    level = f"; level flight reads {expected:.2f}."
    if az > UPWARD * -expected:
        return f"{level} Turn the axis: z points down. {UP}"
    if az > -IN_G[0]:
        return f"{level} It is without gravity. Subtract gravity in body axes, or leave the accelerometers out."
    if IN_G[0] < -az < IN_G[1]:
        return f". It seems to be in g: multiply by {-expected:.4g}."
    if IN_G[0] < az / expected / -expected < IN_G[1]:
        return f". It seems to be m/s² taken for g: divide by {-expected:.4g}."
    return ""


def noise(dataset: Dataset) -> Iterator[Finding]:
    """Declared noise against the record's, estimates where none is declared, records that were filtered.

    What was drawn between other stamps, or holds samples, has less noise than its sensor.
    """
    estimated, smooth, wrong = [], [], dict[str, str]()
    resampled = any("time is not uniform" in sentence for sentence in dataset.warnings)
    for channel in (c for c in dataset.scales() if names.channel(c) is not None):
        records = dataset.records(channel)
        white, spec = white_noise(records), dataset.control_specs.get(channel) or dataset.channel_specs.get(channel)
        if spec is None or spec.noise is None:
            estimated.append(f"{channel} {dataset.noise(channel):.2g}")
            sensor = channel in (*names.RATES, *names.SPECIFIC_FORCES)
            if sensor and white < 2e-3 * dataset.scales()[channel]:
                dt = dataset.facts[dataset.identify[0]].dt
                smooth.append((channel, content_ends(*spectrum(records, dt))))
        elif spec.noise > 0.0 and not 0.6 < white / spec.noise < 1.6 and np.isfinite(white):
            lower = white < spec.noise and (resampled or _held(records))
            answered = white > spec.noise and names.is_motor(channel)  # a controller answers the noise of its sensors
            wrong |= {} if lower or answered else {channel: f"{spec.noise:.3g}, {white:.3g} {names.unit(channel)}"}
    if wrong:
        listed = ", ".join(f"{channel} {sizes}" if len(wrong) > 1 else sizes for channel, sizes in wrong.items())
        sentence = f"declared noise is not the record's white floor ({listed})."
        yield finding(
            "warning", " ".join(wrong), sentence, "Correct dataset.toml, or leave it out to have it estimated."
        )
    if smooth:
        ends = ", ".join(f"{channel} ends at {hertz:.0f} Hz" for channel, hertz in smooth)
        sentence = f"almost no noise: filtered before recording ({ends}), or simulated."
        yield finding("note", " ".join(c for c, _ in smooth), sentence, "A filter's lag will count as the aircraft's.")
    if estimated:
        how = "standard deviation of a sample, in the channel's unit"
        sentence = f"noise estimated from the spectra: {', '.join(estimated)} ({how})."
        yield finding("note", "", sentence, "Declare it in dataset.toml if the sensors' data sheets say otherwise.")


def _held(records: Sequence[np.ndarray]) -> bool:
    """Whether a channel repeats itself, or lies on lines or cubics between readings, in a good part of its samples."""
    still = [np.diff(values[np.isfinite(values)], n) for values in records for n in (1, 2, 4)]
    return any(float(np.mean(np.abs(x) <= 1e-9 * max(np.ptp(x), 1e-300))) > RARER for x in still if len(x))


def vibration(dataset: Dataset) -> Iterator[Finding]:
    """Lines of rotor vibration in rates and specific force."""
    rotor = dataset.vehicle.rotor
    for channel in (*names.RATES, *names.SPECIFIC_FORCES):
        records = dataset.records(channel)
        if not records:
            continue
        strongest = lines(*spectrum(records, dataset.facts[dataset.identify[0]].dt))
        shown = [line for line in strongest if line.share > 0.03 and line.rms > 0.3 * dataset.noise(channel)]
        if not shown:
            continue
        vibrations = ", ".join(
            f"{line.hertz:.1f} Hz"
            + (f" ({line.hertz * 2 * np.pi / rotor.speed:.2f} per revolution)" if rotor and rotor.speed else "")
            + f" {line.rms:.2g} {names.unit(channel)} rms, {line.share:.0%} of the channel's variance"
            for line in shown
        )
        declared = rotor is not None and rotor.speed is not None
        guess = "" if declared else f" ({2 * np.pi * shown[0].hertz:.0f} rad/s if this is once per revolution)"
        advice = f"Isolate the sensor, or declare the rotor's speed{guess}, so that this is not taken for motion."
        yield finding("warning" if shown[0].share > 0.2 else "note", channel, f"vibration at {vibrations}.", advice)


def speeds(dataset: Dataset) -> Iterator[Finding]:
    """Velocities of a helicopter that no flight has, and that nothing tells."""
    tells = (*names.VELOCITIES, *names.POSITIONS)
    if dataset.kind != "helicopter" or any(facts.has(c) for facts in dataset.facts.values() for c in tells):
        return
    advice = "Record velocities, or position, or accelerometers beside the attitude."
    if inertial(dataset):
        if starts_at_speed(dataset):
            return
        advice = f"Declare {DECLARED_SPEED}."
    sentence = "u v w are not recorded: a model lacks moments by speed, and other derivatives stand in for them."
    yield finding("note", "", sentence, advice)


def supply(dataset: Dataset) -> Iterator[Finding]:
    """A battery that sags: the same command then gives less thrust."""
    spreads = [facts.spreads["voltage"] for facts in dataset.facts.values() if facts.has("voltage")]
    low, high = min((s.low for s in spreads), default=0.0), max((s.high for s in spreads), default=0.0)
    if high > 0.0 and high - low > 0.1 * high:
        sentence = f"runs from {low:.3g} to {high:.3g} V over the flights:"
        sentence += " the same command gives another rotor speed and thrust, which goes with its square."
        yield finding("note", "voltage", sentence, "Let propulsion.voltage be weighed, or use measured rotor speeds.")
