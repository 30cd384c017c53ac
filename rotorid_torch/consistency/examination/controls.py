"""Controls: limits, excitation, feedback, folded commands, the band of the responses, how flights begin and end."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from rotorid_torch.consistency.examination.finding import Finding, Severity, finding
from rotorid_torch.consistency.records.coherence import Coherence, coherences
from rotorid_torch.consistency.records.excitation import (
    BAND_HZ,
    TURNS,
    Excitation,
    excitations,
    share_at,
)
from rotorid_torch.consistency.records.ground import on_ground
from rotorid_torch.core import names
from rotorid_torch.core.statistics import paired, stretches
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.data.reading.noise import running_mean

FEEDBACK = 0.1
"""Share of an axis's own motion below which only a combination of derivatives can be found."""
TEST_INPUT = 30.0
"""Power in the band over that of the white part there, below which nothing was flown on an axis."""
SURE = 5.0
"""Standard errors."""
FOLDED = 0.1
"""White part over the power in the band from which on a motor command was folded by sampling."""
FOLLOWS, STRAYS = 0.8, 0.6
"""Mean correlation of rotor speeds with the commands that they follow best, and with those of their own numbers, from
and up to which they are paired with other motors."""
UNRELATED = 0.3
"""The same up to which they follow no command."""
SPEED_MEAN_S = 0.1
"""s: mean that commands and rotor speeds pass before they are compared."""
CLEAR = 3.0
"""Rms over that of noise from which on something moves."""
SPEED_LAGS_S = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2)
"""Lags of a rotor that are tried."""
LEAST_MOTORS = 3
"""Motors from which on they do something apart from what they do together."""
LOST_S = 1.0
"""s that a control stands exactly still while all others change from sample to sample: a limit is left sooner."""
LEAST_STEP = 1e-6
"""Change from sample to sample, as a share of the largest, that counts as one: single precision ends there."""
RESTLESS = 0.95
"""Share of the other samples in which a stick changes whose stillness is none of the pilot's."""
JUMPS = 6.0
"""Usual changes from sample to sample from which on a command jumps."""
LIMITED = 0.1
"""Share of a flight that a control may be on a limit: a test input of full deflection is there for a second or two."""
FREE_RUN_S = 8.0
PERIODS = 2.0
"""A mode needs so many of its periods in a flight."""
RESPONSES = (*names.RATES, *names.SPECIFIC_FORCES, *names.VELOCITIES)


def controls(dataset: Dataset) -> Iterator[Finding]:
    """Saturation, declared limits, excitation and its share that is not feedback."""
    yield from _limits(dataset)
    still_motors = _still_motors(dataset)
    off = [c for c in still_motors if all(f.spreads[c].high == 0.0 for f in dataset.facts.values())]
    stuck = [c for c in still_motors if c not in off]
    if off:
        yield finding("note", " ".join(off), "stays at 0 in every flight: off.")
    if stuck:
        sentence = "never changes while the other motors do: not recorded, or stuck. What it does is then nobody's:"
        yield finding("error", " ".join(stuck), sentence, "record it, or leave these flights out.")
    every = excitations(dataset)
    idle = [e for e in every if e.above_white < TEST_INPUT and (e.moved or names.is_motor(e.axis.controls[0]))]
    still = [e for e in every if not e.moved and e not in idle]
    if still:
        sentence = (
            "hardly moves in any identify flight: its derivatives cannot be found. Fly a 3-2-1-1 or doublet on it."
        )
        yield finding(
            "warning", _channels(still), f"{_named(still)} {sentence}" if len(still[0].axis.controls) > 1 else sentence
        )
    for e in every:
        if e.moved and len(e.axis.controls) == 1:
            yield from _rests(dataset, e)
    if idle:
        yield _no_test_input(idle)
    yield from _folded([e for e in every if _folds(e)], dataset)
    flown = [e for e in every if e.moved and e not in idle and not _folds(e)]
    bound = [e for e in flown if e.independent < FEEDBACK]
    if (feedback := [e for e in bound if not e.leads]) and not stuck:
        yield _feedback(feedback)
    if answered := [e for e in bound if e.leads]:
        yield _answered(answered)
    for e in flown:
        if e.independent >= FEEDBACK:
            yield finding("good", _channels([e]), _moves(dataset, e))


def grounded(dataset: Dataset) -> Iterator[Finding]:
    """Ends of flights on the ground, and controls that stand still in flight."""
    if ends := on_ground(dataset):
        longest = max(ends, key=lambda name: sum(ends[name]))
        sentence = f"all motors are off for up to {sum(ends[longest]):.1f} s at the ends of {len(ends)} flights"
        advice = "there the vehicle stands, and no model of flight holds. Cut them off."
        yield finding("warning", "", f"{sentence} ({longest} most):", advice)
    for control, (seconds, where) in _lost(dataset).items():
        motor = names.is_motor(control)
        sentence = f"stands exactly still for {seconds:.1f} s of {', '.join(where)} while the other"
        what = f"{'motors' if motor else 'controls'} move: its signal was lost. Leave out what flew then."
        yield finding("warning", f"{control} p q r az" if motor else control, sentence, what)


def _lost(dataset: Dataset) -> dict[str, tuple[float, list[str]]]:
    """By control the longest stretch in s without a change while others change, and the flights that have one.

    A stick may rest; one that does so in no other sample does not.
    """
    motors, lost = [c for c in dataset.controls if names.is_motor(c)], dict[str, tuple[float, list[str]]]()
    controls = motors or dataset.controls
    for flight in dataset if len(controls) >= LEAST_MOTORS else ():
        values = flight.stack(controls).numpy()
        changes = np.diff(values, axis=0) != 0.0
        for k, control in enumerate(controls):
            others = np.delete(changes, k, axis=1).all(axis=1)
            spec = dataset.control_specs.get(control)
            highest = math.inf if spec is None or spec.limits is None else spec.limits[1]
            still = ~changes[:, k] & others & (values[1:, k] < highest)  # a motor at its limit gives what it can
            away = [ends for ends in stretches(still) if not _idles(values[:, k], *ends)]
            count = max((last - first for first, last in away), default=0)
            steps = np.abs(np.diff(values[:, k]))  # a filter's last bits, as a stick comes to rest, are none
            moved = int((steps > LEAST_STEP * steps.max()).sum())
            restless = moved > RESTLESS * (len(changes) - count) or bool(motors)
            if count * flight.dt > LOST_S and changes[:, k].any() and restless:
                seconds, where = lost.get(control, (0.0, []))
                lost[control] = max(seconds, count * flight.dt), [*where, flight.name]
    return lost


def _idles(command: np.ndarray, first: int, last: int) -> bool:
    """Whether a command (T,) that stands still after these samples is at its least and comes and goes as ever.

    A controller takes a motor back to idle; a signal that is lost jumps.
    """
    steps = np.diff(command)
    jump = np.abs(steps[[i for i in (first - 1, last) if 0 <= i < len(steps)]]).max(initial=0.0)
    return bool(command[last] <= command.min() and jump < JUMPS * float(np.sqrt(np.mean(steps**2))))


def _still_motors(dataset: Dataset) -> list[str]:
    """Motors that stand still in every flight, beside others that move."""
    spreads = {c: [f.spreads[c] for f in dataset.facts.values()] for c in dataset.controls if names.is_motor(c)}
    still = [c for c, some in spreads.items() if all(s.low == s.high for s in some)]
    return still if len(still) < len(spreads) else []


def _channels(every: Sequence[Excitation]) -> str:
    return " ".join(dict.fromkeys(control for e in every for control in e.axis.controls))


def _named(every: Sequence[Excitation]) -> str:
    return ", ".join(e.axis.name for e in every)


def _rests(dataset: Dataset, e: Excitation) -> Iterator[Finding]:
    """Flights in which a control does not move at all: less than a hundredth of what it does elsewhere."""
    control = e.axis.name
    spreads = {name: facts.spreads[control] for name, facts in dataset.facts.items()}
    rests = [name for name, s in spreads.items() if s.high - s.low < 0.01 * e.travel]
    if rests:
        sentence = f"does not move at all in {len(rests)} of {len(spreads)} flights ({', '.join(rests)}):"
        yield finding(
            "note", control, sentence, "what it does is known from the others alone. Fly it, or leave it out."
        )


def _no_test_input(idle: Sequence[Excitation]) -> Finding:
    sizes = ", ".join(f"{e.axis.name} {e.above_white:.1f} times its white part" for e in idle)
    answers = [TURNS[e.axis.name] for e in idle if e.axis.name in TURNS]
    return finding(
        "warning",
        " ".join([_channels(idle), *answers]),
        f"no test input on {_named(idle)}: from {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz the power is no more than {sizes}.",
        "What moves is the controller's answer to noise and air: control power, damping, lag and delay of"
        " these axes cannot be told apart, and damping comes out too large. Fly doublets or sweeps on top of the"
        " controller, one axis at a time; until then believe none of them alone.",
    )


def _folds(e: Excitation) -> bool:
    return names.is_motor(e.axis.controls[0]) and e.white**2 > FOLDED * e.in_band**2 and e.to_end


def _folded(white: Sequence[Excitation], dataset: Dataset) -> Iterator[Finding]:
    if white:
        sizes = ", ".join(f"{e.axis.name} {e.white:.2g} white, {e.in_band:.2g} in the band" for e in white)
        rate = 1.0 / dataset.facts[dataset.identify[0]].dt
        yield finding(
            "warning",
            _channels(white),
            f"the recorded commands are white to {rate / 2:.0f} Hz ({sizes}): a command has no sensor noise, so they",
            f"change faster than the {rate:.0f} Hz of the record and were sampled without a filter (folded).",
            "Regression on them is biased low. Log at the controller's rate, or low-pass before sampling.",
        )


def _feedback(bound: Sequence[Excitation]) -> Finding:
    shares = ", ".join(f"{e.independent:.0%} of {e.axis.name}" for e in bound)
    return finding(
        "warning",
        _channels(bound),
        f"only {shares} from {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz is the control's own motion, the rest follows",
        "the aircraft and the other controls (feedback): only combinations of derivatives can be found.",
        "Fly test inputs on top of the controller, one control at a time.",
    )


def _answered(bound: Sequence[Excitation]) -> Finding:
    parts = ", ".join(f"{1.0 - e.independent:.0%} of {e.axis.name}" for e in bound)
    return finding(
        "note",
        _channels(bound),
        f"the motion moves with {parts} from {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz, and follows it: the aircraft answers",
        "so quickly that its damping and the control's power are told mostly by their ratio. Sharper inputs part them.",
    )


def _moves(dataset: Dataset, e: Excitation) -> str:
    unit = dataset.control_specs[e.axis.controls[0]].unit
    where = f"in {len(e.moved)} of {len(dataset.identify)} identify flights"
    independence = (
        f"{e.independent:.0%} of its motion from {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz is its own, not feedback"
    )
    name = f"{e.axis.name} (of all motors) " if len(e.axis.controls) > 1 else ""
    return f"{name}moves up to {e.travel:.3g} {unit} {where}; {independence}."


def _limits(dataset: Dataset) -> Iterator[Finding]:
    every = {control: share_at(dataset, control) for control in dataset.controls}
    full = {control: share for control, (share, _) in every.items() if share > 0.01}
    if full:
        shares = ", ".join(f"{control} {share:.0%}" for control, share in full.items())
        most = f"on a limit for up to {max(full.values()):.0%} of a flight ({shares}):"
        reason = "what was asked beyond the limit is not in the record. Use smaller inputs."
        grave: Severity = "warning" if max(full.values()) > LIMITED else "note"
        yield finding(grave, " ".join(full), most, reason)
    for control, (_, outside) in every.items():
        limits = dataset.control_specs[control].limits
        if limits and outside > 0.02 * (limits[1] - limits[0]):
            sentence = f"goes {outside:.3g} beyond its declared limits {list(limits)}. Check limits and unit."
            yield finding("warning", control, sentence)


def trim(dataset: Dataset) -> Iterator[Finding]:
    """Whether the identify flights begin quietly enough to know the trim."""
    moving = [name for name in dataset.identify if dataset.quiet(name) * dataset.facts[name].dt < 0.8]
    if not moving:
        yield finding("good", "", "every identify flight begins with a quiet second: the trim is well known.")
        return
    whole = "every identify flight" if len(moving) == len(dataset.identify) else ", ".join(moving)
    sentence = f"controls move within the first second of {whole}: the trim is only the mean of 0.5 s there."
    yield finding("note", "", sentence, "Begin records a second before the input.")


def length(dataset: Dataset) -> Iterator[Finding]:
    """Whether the flights last long enough for what is to be identified from them.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., ch. 5 (record length).
    """
    seconds = sorted(dataset.facts[name].seconds for name in dataset.identify)
    lowest = PERIODS / seconds[-1]
    span = f"{seconds[0]:.3g} to {seconds[-1]:.3g} s" if seconds[-1] > 1.02 * seconds[0] else f"{seconds[-1]:.3g} s"
    span_sentence = f"identify flights last {span}: motion from {lowest:.2g} Hz on has {PERIODS:g} periods in one;"
    slower = "slower modes and derivatives by speed rest on trends. For those fly sweeps of 60 to 90 s."
    short = [name for name, facts in dataset.facts.items() if facts.seconds < FREE_RUN_S]
    if short:
        many = f"{len(short)} of {len(dataset.facts)} flights"
        short_sentence = (
            f"{many} are shorter than the {FREE_RUN_S:g} s of a free run and are judged over their own length."
        )
        yield finding("note", "", f"{span_sentence} {slower}", short_sentence)
    else:
        yield finding("good", "", span_sentence, slower)


def rotor_speeds(dataset: Dataset) -> Iterator[Finding]:
    """Whether omegaN follows motorN, by what each motor does beyond all of them together.

    Nothing is said where motors hardly differ: what is left then is noise.
    """
    count = len(dataset.controls)
    speeds = [f"omega{n}" for n in range(1, count + 1)]
    flights = [dataset.flights[name] for name in dataset.identify if dataset.flights[name].has(*speeds)]
    recorded = all(map(names.is_motor, dataset.controls)) and not {*dataset.controls} & {*dataset.derived}
    if not flights or not recorded or count < LEAST_MOTORS:
        return
    if not _differ(dataset, flights, dataset.controls) or not _differ(dataset, flights, speeds):
        return
    by_lag = [_following(flights, dataset.controls, speeds, lag) for lag in SPEED_LAGS_S]
    best, by_number, order = max(by_lag, key=lambda one: one[0])
    if best > FOLLOWS and by_number < STRAYS:
        pairs = ", ".join(f"{s} follows {dataset.controls[k]}" for s, k in zip(speeds, order, strict=True))
        sentence = (
            f"rotor speeds are paired with other motors: {pairs} (correlation {best:.2f}, by number {by_number:.2f})."
        )
        yield finding("error", " ".join(speeds), sentence, "Number speeds and commands alike.")
    elif best < UNRELATED:
        sentence = f"rotor speeds and commands contradict each other: no speed follows one (correlation {best:.2f})."
        yield finding("error", " ".join(speeds), sentence, "One of them is of another flight, clock or motor.")
    elif best > FOLLOWS:
        yield finding("good", " ".join(speeds), f"every rotor speed follows its command (correlation {by_number:.2f}).")


def _differ(dataset: Dataset, flights: Sequence[Flight], channels: Sequence[str]) -> bool:
    """Whether channels do more beside their mean than noise behind a mean of `SPEED_MEAN_S` would."""
    moved, noise = 0.0, 0.0
    for flight in flights:
        width = max(1, round(SPEED_MEAN_S / flight.dt))
        values = flight.bridged(channels).nan_to_num(0.0).numpy()
        smooth = np.stack([running_mean(x, width) for x in (values - values.mean(axis=1, keepdims=True)).T])
        moved += float(smooth.var(axis=1).sum())
        noise += sum(dataset.noise(c) ** 2 for c in channels) / width
    return moved > CLEAR**2 * noise and moved > 0.0


def _following(
    flights: Sequence[Flight], motors: Sequence[str], speeds: Sequence[str], lag_s: float
) -> tuple[float, float, Sequence[int]]:
    """Mean correlation of speeds with commands, paired best and by number, and the best command of each speed."""
    total = np.zeros((2 * len(motors), 2 * len(motors)))
    for flight in flights:
        by, width = round(lag_s / flight.dt), max(1, round(SPEED_MEAN_S / flight.dt))
        asked, turned = (flight.bridged(channels).nan_to_num(0.0).numpy() for channels in (motors, speeds))
        both = [asked[: len(asked) - by], turned[by:]]
        smooth = [np.stack([running_mean(x, width) for x in (b - b.mean(axis=1, keepdims=True)).T]) for b in both]
        total += np.concatenate([x - x.mean(axis=1, keepdims=True) for x in smooth]) @ np.concatenate(smooth).T
    size = np.sqrt(np.maximum(np.diag(total), np.finfo(float).tiny))
    correlation = (total / np.outer(size, size))[len(motors) :, : len(motors)]
    columns = paired(correlation)
    best = correlation[np.arange(len(columns)), columns]
    return float(best.mean()), float(np.diag(correlation).mean()), columns


def band(dataset: Dataset) -> Iterator[Finding]:
    """Rates and specific forces (else velocities) that follow the controls, and those that nowhere do."""
    measured = coherences(dataset, RESPONSES)
    good = [c for c in measured if c.band is not None]
    forces = set(names.SPECIFIC_FORCES) <= {c.channel for c in measured}
    lost = [c for c in measured if c.band is None and not (forces and c.channel in names.VELOCITIES)]
    if all(map(names.is_motor, dataset.controls)):  # thrust is along z: drag alone pushes a multirotor along x and y
        lost = [c for c in lost if c.channel not in names.SPECIFIC_FORCES[:2]]
    if good:
        sentence = f"follow the controls with coherence above 0.6: {', '.join(map(_stretch, good))}."
        yield finding(
            "good", " ".join(c.channel for c in good), sentence, "Outside that fits and scores see other causes."
        )
    if lost:
        sentence = "nowhere follow the controls with coherence above 0.6: noise, air or a controller moves them."
        advice = "Models of them rest on little: fly larger inputs, in calm air, on one control at a time."
        yield finding("warning", " ".join(c.channel for c in lost), sentence, advice)


def _stretch(c: Coherence) -> str:
    low, high = c.band or (0.0, 0.0)
    return f"{c.channel} {low:.1g} to {high:.2g} Hz"
