"""Sensors against each other: clocks, time base, scales, biases; controls against what they command."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorid_torch.consistency import imu_place, sensor_pairs
from rotorid_torch.consistency.correction import without_errors
from rotorid_torch.consistency.equations import UNITS, of_part_of_a_vector
from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.examination.frames import frames, time
from rotorid_torch.consistency.pairs.alignment import (
    FLIGHTS,
    MOVES,
    Alignment,
    alignment,
    angle_of,
    axes_of,
    force_turn,
    right_angles,
    rotation,
)
from rotorid_torch.consistency.pairs.axes import feels
from rotorid_torch.consistency.pairs.clock_rate import ClockRate, clock_rate
from rotorid_torch.consistency.pairs.drawn_attitude import drawn
from rotorid_torch.consistency.pairs.far_lags import (
    FarLag,
    lag_of_controls,
    lag_of_velocities,
    late_positions,
)
from rotorid_torch.consistency.pairs.late_controls import (
    LateControls,
    coming_first,
    followed_sticks,
    known_responses,
    late_controls,
)
from rotorid_torch.consistency.pairs.odd_flights import Pace, odd_constant, odd_flights, other_paces, with_only
from rotorid_torch.consistency.pairs.precedence import Following
from rotorid_torch.consistency.pairs.signs import right_signs
from rotorid_torch.consistency.pairs.velocity_clock import IMITATED_S
from rotorid_torch.consistency.sensor_errors.drift import Drift, drifts
from rotorid_torch.consistency.sensor_pairs import REACH_S, WITHIN_S, Agreement, Pair, agreement
from rotorid_torch.consistency.smoothing import EVERY_S, WIDTH_S
from rotorid_torch.core import names
from rotorid_torch.core.statistics import weighted_mean
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight

Group = tuple[str, str, Callable[[Dataset], tuple[Pair, ...]]]

GROUPS: tuple[Group, ...] = (
    ("attitude", "the body rates", lambda _: sensor_pairs.attitude_pairs()),
    ("rates", "angular accelerations", lambda _: sensor_pairs.acceleration_pairs()),
    ("velocity", "attitude, rates and specific force", imu_place.placed_pairs),
    ("position", "velocity", lambda _: sensor_pairs.position_pairs()),
)
ANGULAR = float(1.0 / (np.sqrt(2.0) * WIDTH_S))
"""1/s: rms of the slope of white noise behind the Gaussian over its own, as limits of p' q' r' to those of p q r."""
BIAS = {"rad/s": 0.004, "rad/s²": 0.004 * ANGULAR, "m/s²": 0.15, "m/s": 0.15}
"""Constant difference that is worth a word."""
TILTS = {"u": ("theta", -1.0), "v": ("phi", 1.0), "w": ("", 0.0)}
"""Angle that tilts gravity into the axis of a velocity in level flight, and the sign."""
SCALE = 0.04
"""Scale error that is worth a word."""
KNOWN = 0.6
"""R² from which on a lag is known."""
BETTER = 0.8
"""Share of what velocities leave that a lag of the accelerometers leaves at most where velocities have no lag."""
AGREES = 0.3
"""R² below which two sides are not compared."""
CONTRADICT = {"attitude": 0.5, "rates": 0.5, "velocity": 0.3, "position": 0.3}
"""R² below which two sides that move far above their noise contradict each other."""
LEAST_RMS = {"rad/s": 0.02, "rad/s²": 0.02 * ANGULAR, "m/s²": 0.2}
"""Motion that one side must show besides, rms: what an estimator has smoothed seems to have no noise."""
CLOCKS = {"attitude": ("attitude", "rates"), "velocity": ("velocities", "accelerations")}
"""Units whose clock a group of pairs compares."""
ANSWERED_S, PRECEDING_S, FAR_S = 1.0, 0.1, 0.2
"""Longest delay of a vehicle's answer to its controls, and by how much it may seem to come first, in s; controls late
by `FAR_S` more are on another clock, for pairs of records do not reach so far."""
DELAYED_S = 0.25
"""Longest equivalent delay in s with which an aircraft can be flown: Level 3 of MIL-F-8785C, table XIV."""
SPUN_S = 0.4
"""Longest delay of motors: of the slowest propellers four time constants."""
LITTLE = 0.1
"""Share of the response that the controls as recorded must leave for their clock to be far off."""
FAR, KNOWN_S = 0.4, 0.25
"""Share of what those lags leave that a far lag of the controls may leave, and its largest standard error, s."""
MOUNTED = 3.0
"""Degrees within which a turn is a mounting by right angles."""
TURNED = 0.7
"""Share of what biases of the accelerometers leave that a turn of them leaves at most, to be told instead."""
SOON_S = 3.0
"""Lag up to which the clock of a single flight is known: in a few periods of motion others agree by chance."""
SURE, SURE_LAG = 4.0, 3.0
"""Standard errors that make a finding; of a lag, whose size must mean something besides."""


def kinematics(dataset: Dataset) -> Iterator[Finding]:
    """Attitude against rates, velocity against specific force, position against velocity; large errors first."""
    by = alignment(dataset)
    if by.mirror:
        dataset, angle = right_signs(dataset)
        yield _mirrored(by, angle)
        by = replace(alignment(dataset), turn=np.zeros(3))  # with what is left of a mirror
    righted = without_errors(dataset, by.errors) if by.errors else dataset
    flights = righted.flights.values()
    if by.angle > 0.0:
        yield _turned(by)
        yield from _not_turned_back(dataset) if not by.gyros_alone else ()
    rate = clock_rate([righted.flights[name] for name in dataset.some(FLIGHTS)])
    if rate is not None:
        yield _unequal(rate)
    lags: dict[str, list[Agreement]] = {}
    by_forces = _forces_turned(flights, dataset.vehicle.gravity)
    if by_forces is not None:
        yield by_forces
    for left, right, pairs in GROUPS:
        if left == "velocity" and by_forces is not None:
            continue  # one cause, told once
        late = {*late_positions(dataset)} if left == "position" else set[str]()  # another clock, told as that
        compared = [pair for pair in pairs(dataset) if pair.left_name not in late]
        place = imu_place.place_of_imu(dataset) if left == "velocity" else imu_place.Place()
        results = [place.doubted(a, a.pair.left_name) for p in compared if (a := agreement(p, flights)) is not None]
        agreeing = [a for a in results if a.r2 > KNOWN and a.pair.exact]
        forces = _forces(dataset, flights) if left == "velocity" else []
        yield from _velocities_late(righted) if left == "velocity" and not feels(dataset) else ()
        about = _forces_late(forces, results) if not lags.get("attitude") else []
        yield from _far_off(left, by, agreeing, forces)
        constant = not about and not (left == "attitude" and rate)
        lags[left] = [a for a in agreeing if _off(a) and not _moved(left, by)] if constant else []
        if about and not _moved(left, by):
            yield _late("specific force", "velocity and attitude", {"specific force": about})
        elif lags[left]:
            yield _late(left, right, lags)
        elif agreeing and not _moved(left, by) and (constant or about):
            lag_words = ", ".join(f"{a.pair.left_name} {a.lag_s:+.3f} s" for a in agreeing)
            yield finding("good", _channels(agreeing), f"{left} keeps time with {right} ({lag_words}).")
        for result in agreeing if left == "attitude" or not (about or lags["attitude"]) else []:
            yield from _drift(result)
        for result in results:
            if result.pair.exact:
                yield from _disagreement(result, dataset, left)
                yield from _bias(result, dataset) if result.r2 > AGREES else ()
                yield from _odd_constant(result, dataset) if left == "velocity" else ()
                yield from _scale(result)


def attitude(dataset: Dataset) -> Iterator[Finding]:
    """An attitude that is drawn to the accelerometers, or made of them."""
    shares = drawn(dataset)
    if shares is None:
        return
    sentence = f"by the body rates {shares.by_rates:.0%} of the attitude's motion is not explained, and"
    follows = f"it follows the accelerometers (then {shares.by_both:.1%}):"
    cause = "drawn to them by a filter, or made of them, it is wrong where the vehicle accelerates."
    grave: Severity = "error" if shares.by_rates > 1.0 - CONTRADICT["attitude"] else "warning"
    yield finding(grave, "phi theta", sentence, follows, cause, "Take another estimator's, or leave it out.")


def drifting(dataset: Dataset) -> Iterator[Finding]:
    """Gyros and accelerometers whose zero drifts within flights."""
    by_channel: dict[str, list[Drift]] = {}
    for drift in drifts(dataset):
        by_channel.setdefault(drift.channel, []).append(drift)
    for channel, several in by_channel.items():
        most = max(several, key=lambda drift: abs(drift.grown))
        where = f"{most.flight} ({len(several)} of {len(dataset.flights)} flights drift)"
        gyro = channel in names.RATES
        size = f"{most.grown:+.3g} {'rad/s' if gyro else 'm/s²'} (± {most.se:.1g})"
        cause = "a gyro that warms up" if gyro else "an accelerometer that warms up, or the attitude's tilt"
        sentence = f"drifts by {size} within the {most.seconds:.0f} s of {where}: {cause}."
        yield finding("warning", channel, sentence, "No constant bias repairs it: take the line out.")


def each_flight(dataset: Dataset) -> Iterator[Finding]:
    """Flights whose stamps are other ones, or whose sensors alone contradict each other, each with its cause."""
    paces = other_paces(dataset)
    for name, compared in odd_flights(dataset).items():
        alone = with_only(dataset, (name,))
        if name in paces:
            by = [*time(alone)] if not paces[name].usual_dt else []
            one = by[0] if by else _other_pace(paces[name], dataset.facts[name].dt)
            yield replace(one, severity="error", flight=name)
            continue
        framed = [*frames(alone)]
        far = any(abs(seconds) > SOON_S for seconds in alignment(alone).clocks.values())
        unsure = ("contradict", "the other streams") if far else ("contradict",)
        clear = [
            f
            for f in (*kinematics(alone), *framed)
            if (f.severity == "error" or "time" in f.channel.split() or f in framed)
            and not any(words in f.sentence for words in unsure)
        ]
        sentence = "sensors contradict each other in this flight, and agree in the others:"
        advice = "its mounting, units or stamps are others. Mend it, or leave it out."
        plain = finding("error", " ".join(compared), sentence, advice)
        yield replace((clear or [plain])[0], severity="error", flight=name)


def _other_pace(pace: Pace, dt: float) -> Finding:
    """Attitude that turns too fast in one flight alone, which may be sampled so much faster than the others."""
    sentence = f"attitude turns {pace.ratio:.2f} times as fast as the body rates say, and"
    if pace.usual_dt:
        more = "the flight is sampled so many times as fast as the others: its stamps are wrong."
        return finding("error", "time", sentence, more, f"Samples are {pace.usual_dt:.4g} s apart.")
    more = "in the other flights it does not: the flight's stamps, or the unit of its rates, are others."
    return finding(
        "error", "time p q r", sentence, more, f"Samples are {pace.ratio * dt:.4g} s apart, or leave it out."
    )


def _forces(dataset: Dataset, flights: Iterable[Flight]) -> list[Agreement]:
    """Accelerometers against velocity and attitude."""
    place = imu_place.place_of_imu(dataset)
    pairs = sensor_pairs.force_pairs(dataset, place.tensor)
    return [place.doubted(a, pair.right_name) for pair in pairs if (a := agreement(pair, flights)) is not None]


def _velocities_late(dataset: Dataset) -> Iterator[Finding]:
    """Velocities that gravity by the attitude and drag explain best at another time."""
    lag = lag_of_velocities([dataset.flights[name] for name in dataset.identify[:FLIGHTS]], dataset.vehicle.gravity)
    if lag is None or lag.left > BETTER * lag.left_near or abs(lag.seconds) < max(1.5 * IMITATED_S, SURE_LAG * lag.se):
        return
    word = "late" if lag.seconds > 0.0 else "early"
    sentence = (
        f"{abs(lag.seconds):.3f} s {word} (± {max(lag.se, IMITATED_S / SURE_LAG):.3f}) against attitude and rates,"
    )
    how = "by gravity and drag, for no accelerometer says what pushed the aircraft. Shift the stream,"
    yield finding("warning", "u v w", sentence, how, "or let sensors.delay be estimated.")


def _forces_late(forces: Sequence[Agreement], moved: Sequence[Agreement]) -> list[Agreement]:
    """Accelerometers whose lag explains more than that of the velocities does; none where it does not."""
    late = [a for a in forces if a.r2 > KNOWN and _off(a)]
    of_velocities, of_forces = sum(a.misfit for a in moved if a.pair.exact), sum(a.misfit for a in forces)
    either = any(_off(a) for a in moved if a.r2 > KNOWN)
    return late if of_forces < (1.0 if either else BETTER) * of_velocities else []


def _turned(by: Alignment) -> Finding:
    """The IMU's axes are not the attitude's."""
    angle, axis = np.degrees(by.angle), by.turn / by.angle
    nearest = min(right_angles(), key=lambda m: float(np.linalg.norm(m - rotation(by.turn))))
    square = np.degrees(angle_of(rotation(by.turn).T @ nearest)) < MOUNTED
    mounted = f" (a mounting by right angles: p q r read {axes_of(nearest.T)})" if square else ""
    who, back = "IMU is", "p q r and ax ay az back; close-loop names it as sensors.misalignment"
    if by.gyros_alone:
        who, back = "gyros alone are", "p q r back, and leave ax ay az: these agree with attitude and velocity"
    return finding(
        "error",
        "p q r" if by.gyros_alone else "p q r phi theta psi",
        f"the {who} turned by {angle:.1f}° (± {np.degrees(by.turn_se):.1g}) about the body axis",
        f"({axis[0]:+.2f}, {axis[1]:+.2f}, {axis[2]:+.2f}) against the attitude{mounted}: turned back, the attitude",
        f"leaves {by.after:.1%} of the rates' variance instead of {min(by.before, 9.99):.0%}. Turn {back}.",
    )


def _not_turned_back(dataset: Dataset) -> Iterator[Finding]:
    """Channels of a turned IMU that read a vector of which an axis is not recorded."""
    recorded = {name for facts in dataset.facts.values() for name in facts.spreads}
    if partial := sorted(of_part_of_a_vector(recorded)):
        sentence = (
            f"{', '.join(partial)} cannot be turned back, for the other axes of the same vector are not recorded:"
        )
        yield finding("error", " ".join(partial), sentence, "record it, or leave these out.")


def _forces_turned(flights: Iterable[Flight], gravity: float) -> Finding | None:
    """The accelerometers' axes are not those of velocity and attitude, and no biases explain it as well."""
    by = force_turn(flights, gravity)
    if by is None or by.left > TURNED * by.by_bias:
        return None
    mirrored = float(np.linalg.det(by.matrix)) < 0.0
    angle = 180.0 if mirrored else float(np.degrees(angle_of(by.matrix)))
    if angle < MOUNTED:
        return None
    reads = axes_of(by.matrix).translate(str.maketrans("pqr", "xyz"))
    what = "a wrong sign or exchanged axes" if mirrored else f"turned by {angle:.1f}° against velocity and attitude"
    nearest = f" (they read {reads}, by the nearest axes)" if reads != "+x +y +z" else ""
    sentence = f"the accelerometers alone are not in body axes: {what}{nearest}."
    left = f"So taken, they leave {by.left:.2g} (m/s²)² instead of {by.by_bias:.2g} with biases."
    return finding("error", "ax ay az", sentence, left, "Correct their signs, order or mounting.")


def _unequal(rate: ClockRate) -> Finding:
    """Stamps of one stream run faster than those of the other."""
    faster = "slower" if rate.drift > 0.0 else "faster"
    return finding(
        "error",
        "p q r phi theta psi",
        f"the clock of the body rates runs {abs(rate.drift):.2%} (± {rate.se:.2%}) {faster} than that of the attitude:",
        f"their lag changes by {abs(rate.grown_s):.2f} s within a flight, and no constant delay is it.",
        "Put both on one clock before anything else.",
    )


def _mirrored(by: Alignment, angle: str) -> Finding:
    """No rotation but a sign or an exchange of axes makes the rates those of the attitude."""
    if angle:
        sentence = f"{angle} has the wrong sign: so turned it agrees with rates and velocities,"
        return finding("error", "phi theta psi", sentence, f"and as recorded p q r read {by.mirror} by it. Turn it.")
    return finding(
        "error",
        "p q r phi theta psi",
        f"by the attitude p q r read {by.mirror}: a wrong sign or exchanged axes, which no mounting makes. Turned so,",
        f"the attitude leaves {by.after:.1%} of the rates' variance instead of {min(by.before, 9.99):.0%}.",
        "Correct signs and order of the rates, or of the attitude.",
    )


def _moved(group: str, by: Alignment) -> bool:
    """Whether a clock of this group was set right before its pairs were compared."""
    return bool({*CLOCKS.get(group, ())} & {*by.clocks})


def _far_off(
    group: str, by: Alignment, agreeing: Sequence[Agreement], forces: Sequence[Agreement]
) -> Iterator[Finding]:
    """Clocks that are off by more than pairs of channels are searched for, with what these still say."""
    for unit in (unit for unit in CLOCKS.get(group, ()) if unit in by.clocks):
        sure = [a for a in forces if a.r2 > KNOWN]
        pairs = sure if unit == "accelerations" and sure else agreeing
        remaining_lag, error = 0.0, EVERY_S / 2.0
        if pairs:
            remaining_lag, error = weighted_mean([a.lag_s for a in pairs], [max(a.lag_se, 1e-3) for a in pairs])
        forward = unit in ("attitude", "velocities") or pairs is sure
        seconds = by.clocks[unit] + (remaining_lag if forward else -remaining_lag)
        word = "late" if seconds > 0.0 else "early"
        sentence = f"{unit} {abs(seconds):.3f} s {word} (± {max(error, 1e-3):.3f}) against the other streams:"
        what = (
            "two clocks, or one that began later. Shift the stream; nothing that compares channels means much before."
        )
        yield finding("error", " ".join(UNITS[unit]), sentence, what)


def _disagreement(a: Agreement, dataset: Dataset, group: str) -> Iterator[Finding]:
    """Two sensors that move far above their noise and do not agree, or too little motion to compare them."""
    left, right = a.pair.left_name, a.pair.right_name
    if a.r2 >= CONTRADICT[group]:
        return
    dt = float(np.median([dataset.facts[name].dt for name in dataset.identify]))
    noise = a.noise_power((dataset.noise(left), max(dataset.noise(name) for name in right.split())), dt)
    strength, least = max(a.power) / max(noise), LEAST_RMS.get(a.pair.unit, 0.0) ** 2
    if strength > MOVES and max(a.power) > least and group != "position":
        moving, still = (left, right) if a.power[0] > a.power[1] else (right, left)
        sentence = f"{moving} moves far above the noise of both ({strength:.0f} times its power), and {still} does not"
        more = f"follow by kinematics (R² {a.r2:.2f}, in no lag up to {REACH_S:g} s): they contradict each other."
        yield finding(
            "error", f"{left} {right}", sentence, more, "One of the two is wrong: axes, unit, clock or sensor."
        )
    elif a.r2 < AGREES:
        yield finding(
            "note", left, f"too little motion, or too much noise, to compare {left} with {right} (R² {a.r2:.2f})."
        )


def _off(a: Agreement) -> bool:
    exact = a.pair.exact or not a.pair.differentiate  # accelerometers
    return abs(a.lag_s) > max(SURE_LAG * a.lag_se, 0.008 if exact else 0.06)


def _channels(results: Sequence[Agreement]) -> str:
    return " ".join(a.pair.left_name for a in results)


def _late(left: str, right: str, lags: dict[str, list[Agreement]]) -> Finding:
    late = lags[left]
    lag_words = ", ".join(
        f"{a.pair.left_name} {abs(a.lag_s):.3f} s {'late' if a.lag_s > 0 else 'early'} (± {a.lag_se:.3f})" for a in late
    )
    grave: Severity = "warning" if max(abs(a.lag_s) for a in late) >= 0.02 else "note"
    cause = ""
    if left == "velocity" and any(a.lag_s > 0.02 for a in lags["attitude"]) and sum(a.lag_s for a in late) < 0:
        cause = "Both comparisons say it: the attitude is late."
    early = sum(a.lag_s for a in late) < 0
    who = f"{right} late, or {left} early" if early else f"{left} late, or {right} early"
    advice = f"A clock or a filter is off ({who}): shift the streams onto one clock, or let sensors.delay be estimated."
    return finding(grave, _channels(late), f"{lag_words} against {right}.", *([cause] if cause else []), advice)


def _drift(a: Agreement) -> Iterator[Finding]:
    """Lags that differ between flights by more than their errors."""
    inside = [one for one in a.lags_s.values() if abs(one[0]) < WITHIN_S]
    if len(inside) < 2:
        return
    (first, first_se), (last, last_se) = min(inside), max(inside)
    if last - first > max(0.06, 6.0 * (first_se + last_se)):
        sentence = f"against {a.pair.right_name} the lag runs from {first:+.3f} to {last:+.3f} s from flight to flight:"
        yield finding("warning", a.pair.left_name, sentence, "the clocks drift, and one common delay cannot repair it.")


def _scale(a: Agreement) -> Iterator[Finding]:
    left, right, (low, high) = a.pair.left_name, a.pair.right_name, a.bounds
    if a.r2 > 0.9 and high < 0.0:
        sentence = (
            f"the rate of {left} goes against what {right} says by kinematics ({a.scale:.3f} ± {a.scale_se:.3f} times):"
        )
        yield finding("error", left, sentence, f"one of the two has the wrong sign. Turn {left} or {right}.")
    elif a.r2 > 0.9 and (low > 1.0 + SCALE or high < 1.0 - SCALE) and abs(a.scale - 1.0) > SURE * a.scale_se:
        sentence = f"the rate of {left} is {a.scale:.3f} (± {a.scale_se:.3f}) times what {right} says by kinematics:"
        cause = "a scale factor or unit of one of the two is off. Calibrate, or let sensors.scale be estimated."
        yield finding("warning", left, sentence, cause)


def _bias(a: Agreement, dataset: Dataset) -> Iterator[Finding]:
    left, right, unit = a.pair.left_name, a.pair.right_name, a.pair.unit
    threshold = BIAS[unit]
    if abs(a.bias) <= max(threshold, SURE * a.bias_se):
        return
    sensor = left if unit == "m/s" else right
    if unit == "m/s":
        sentence = f"changes by {a.bias:+.3g} {unit} (± {a.bias_se:.1g}) more than {right} say:"
    else:
        word = "low" if a.bias > 0 else "high"
        sentence = f"reads {abs(a.bias):.3g} {unit} (± {a.bias_se:.1g}) too {word} by the kinematics of {left}:"
    use = "is estimated per flight" if dataset.bias(sensor) == "free" else 'is estimated only with bias = "free"'
    yield finding(
        "warning" if abs(a.bias) > 3.0 * threshold else "note", sensor, sentence, f"a sensor bias, which {use}."
    )


def _odd_constant(a: Agreement, dataset: Dataset) -> Iterator[Finding]:
    """A flight with a constant that the others do not have, by the sensor alone whose trim is another one too."""
    name, size = odd_constant(a)
    flight, sensor, (angle, sign) = name.partition(" from ")[0], a.pair.right_name, TILTS[a.pair.left_name]
    if abs(size) < 3.0 * BIAS[a.pair.unit]:
        return
    reads = {sensor: (-size, f"{sensor} reads {abs(size):.3g} m/s² too {'low' if size > 0.0 else 'high'}")}
    if angle:
        tilt = -sign * float(np.arcsin(np.clip(size / dataset.vehicle.gravity, -1.0, 1.0)))
        reads[angle] = tilt, f"{angle} is {np.degrees(abs(tilt)):.1f}° too {'large' if tilt > 0.0 else 'small'}"
    moved = [c for c, (error, _) in reads.items() if 0.5 < _other_trim(dataset, flight, c) / error < 1.5]
    blamed = moved if len(moved) == 1 else [*reads]
    sentence = f"{' or '.join(reads[c][1] for c in blamed)} by the kinematics of {a.pair.left_name},"
    advice = "unlike the other flights: it was set or mounted otherwise. Take it off, or leave the flight out."
    yield finding("error", " ".join(blamed), sentence, advice, flight=flight)


def _other_trim(dataset: Dataset, name: str, channel: str) -> float:
    """How far a channel's first half second is from that of the other flights, less four of their deviations."""
    first = {f.name: f.channels[channel][: round(0.5 / f.dt)] for f in dataset.flights.values() if f.has(channel)}
    means = {flight: float(values.nanmean()) for flight, values in first.items()}
    apart, others = means.pop(name), np.array([*means.values()])
    apart -= float(np.nanmean(others))
    return float(np.sign(apart) * max(abs(apart) - SURE * np.nanstd(others), 0.0))


def precedence(dataset: Dataset) -> Iterator[Finding]:
    """Responses that seem to come before their controls, delays that differ between flights, and right ones."""
    flights = [dataset.flights[name] for name in dataset.identify[:FLIGHTS]]
    if far := _on_another_clock(flights, dataset.controls):
        yield _far_controls(far, dataset)
        return
    sticks = followed_sticks(dataset)
    for a in sticks:
        yield from _drift(a)
    late = late_controls(dataset)
    if late is not None and late.sticks:
        yield _late_sticks(late)
    elif late is not None:
        yield _late_controls(late, dataset)
    elif not sticks and (responses := known_responses(dataset)):
        if coming_first(dataset, responses):  # what swings below moves the vehicle first too
            return
        lags = _lags(responses, 1.0)
        sentence = f"the accelerations follow the controls: {lags} (delay and lag of the whole path together)."
        yield finding("good", " ".join(r.channel for r in responses), sentence)


def _on_another_clock(flights: Sequence[Flight], controls: Sequence[str]) -> FarLag | None:
    """Lag of controls that is no delay of a vehicle; None where there is none, or none is known.

    Under a controller motion explains half of the accelerations at any lag, so that no lag beside it is the only one.
    Then two lags have to agree: that beside the motion, and that of the controls alone, which is the only one.
    """
    motors = all(map(names.is_motor, controls))
    first, last = (-SPUN_S, PRECEDING_S) if motors else (-ANSWERED_S, PRECEDING_S + FAR_S)
    far = lag_of_controls(flights, controls, (first, PRECEDING_S))
    if far is None:
        return None
    sure = LITTLE < far.left_near > far.left / FAR and far.se < KNOWN_S
    if sure and (motors or far.alone) and not first < far.seconds < last:
        return far
    if motors or len(flights) < 2 or -DELAYED_S < far.seconds < last:
        return None
    alone = lag_of_controls(flights, controls, (-DELAYED_S, PRECEDING_S), alone=True)
    if alone is None or not alone.alone or abs(far.seconds - alone.seconds) > FAR_S:
        return None
    beyond = all(not -DELAYED_S - SURE * a.se < a.seconds < last for a in (far, alone))
    return replace(alone, seconds=far.seconds, se=far.se) if beyond else None


def _far_controls(far: FarLag, dataset: Dataset) -> Finding:
    word, more = ("late", "more") if far.seconds > 0.0 else ("early", "less")
    return finding(
        "error",
        " ".join(dataset.controls),
        f"the controls are {abs(far.seconds):.2f} s {word} (± {far.se:.2f}) against the angular accelerations,",
        f"{more} by the delay of the vehicle: there they explain {1.0 - far.left:.0%} of these, as recorded",
        f"{max(1.0 - far.left_near, 0.0):.0%} at most. Shift the stream; nothing else can be told before.",
    )


def _late_sticks(late: LateControls) -> Finding:
    lag_words = ", ".join(
        f"{a.pair.right_name} against {a.pair.left_name} {-a.lag_s:.3f} s (± {a.lag_se:.3f})" for a in late.sticks
    )
    return finding(
        "warning",
        " ".join(a.pair.right_name for a in late.sticks),
        f"the sticks are stamped {late.seconds:.3f} s (± {late.se:.3f}) late against the rates ({lag_words}):",
        "the response seems to come first, which no aircraft does: the streams are misaligned by that and by what",
        f"the aircraft lags besides. Shift all sticks {late.seconds:.3f} s earlier (close-loop does), or expect every",
        "delay at its bound of zero; no lag or delay of the control path can be told from these streams.",
    )


def _late_controls(late: LateControls, dataset: Dataset) -> Finding:
    sentence = f"{_lags(late.accelerations, -1.0)} before the controls move: the response seems to come first."
    cause = f"The controls' stream is late by at least {late.seconds:.3f} s, or these streams are early."
    advice = "Shift them onto one clock before identifying, or let sensors.delay be found by close-loop."
    return finding("warning", " ".join(dataset.controls), sentence, cause, advice)


def _lags(responses: Sequence[Following], sign: float) -> str:
    return ", ".join(f"{r.acceleration} {sign * r.lag_s:.3f} s (± {r.lag_se:.3f})" for r in responses)
