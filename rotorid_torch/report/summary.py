"""What a report says in few words: each list's score against its yardsticks, and what to do next."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from rotorid_torch.arguments import enumerated, listed
from rotorid_torch.core import names
from rotorid_torch.data.velocities.source import DECLARED_SPEED
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS
from rotorid_torch.printable import percent
from rotorid_torch.report.records import (
    LISTS,
    ChannelRecord,
    EffectRecord,
    FitRecord,
    FlightRecord,
    ParameterRecord,
    Report,
)
from rotorid_torch.report.short_horizon import NAMES, explained, short_horizon, too_far_ahead
from rotorid_torch.validate.lists import ShortHorizon

# Shares of the motion explained, from which on a model is called so.
GOOD, USABLE = 0.90, 0.70
GRADES = ((0.97, "very good"), (GOOD, "good"), (USABLE, "usable with care"), (0.0, "poor"))
WORSE_THAN_TRIM = "worse than holding trim"
RESOLVED_S = 0.02
"""Interval of the records that trajectories are fitted to: what is faster acts at once there."""
MOSTLY = 0.7
"""R² of a response below which something is missing from the model."""
NOTHING = "Nothing stands out. Use the model within the range of motion that the flights covered."
"""What is to be done where nothing is."""
DECIDING = ("validate", "acid", "identify")
"""Lists of flights in the order in which they say whether a model is of use: unseen before fitted."""
NAMED = 4
"""Parameters that a sentence names, at most."""
SHOWN = 12
"""Flights of each list that pictures and tables of channels show; scores are those of all."""
THEIL_PARTS = (
    "an offset: look at the trim and the sensor biases",
    "a wrong amplitude: look at the gains (control and damping derivatives) of that axis",
    "a wrong shape: look for delay, missing dynamics or gusts",
)


@dataclass(frozen=True)
class ListSummary:
    """Score of one list of flights between what the sensor noise alone scores and what holding trim scores.

    J_fed : with the gusts of the flights fed in, which then is what counts: no model foresees gusts.
    """

    name: str
    flights: int
    J: float | None
    J_noise: float | None
    J_trim: float | None
    J_fed: float | None = None

    @property
    def judged(self) -> float | None:
        """The score that counts."""
        return self.J if self.J_fed is None else self.J_fed

    @property
    def explained(self) -> float | None:
        """Share of the motion that the model explains, noise removed; minus infinity where it flies away.

        None where no flight is scored, or nothing moves.
        """
        if self.J_noise is None or self.J_trim is None or self.J_trim <= self.J_noise:
            return None
        J = math.inf if self.judged is None else self.judged
        left = max(J**2 - self.J_noise**2, 0.0)
        return 1.0 - left / (self.J_trim**2 - self.J_noise**2)

    @property
    def worse_than_trim(self) -> bool:
        """Whether holding trim describes these flights better than the model does, noise removed."""
        return self.explained is not None and self.explained < 0.0

    @property
    def grade(self) -> str:
        """The share in a word."""
        share = self.explained
        if share is None:
            return "not scored"
        return next((word for limit, word in GRADES if share >= limit), WORSE_THAN_TRIM)


def list_summaries(fit: FitRecord) -> list[ListSummary]:
    """One summary for each list that has flights, in the order identify, validate, acid."""
    summaries = []
    for name in LISTS:
        flights = [flight for flight in fit.flights.values() if flight.list == name]
        if flights:
            yardsticks = (_rms(f.J_noise for f in flights), _rms(f.J_trim for f in flights))
            in_gusts = _rms(f.J_fed for f in flights)
            summaries.append(ListSummary(name, len(flights), getattr(fit.scores, name), *yardsticks, in_gusts))
    return summaries


def air_of(fit: FitRecord) -> str:
    """What was found of the air in a sentence; empty where nothing was."""
    if not fit.gusts:
        return ""
    size = lambda value, se: f"{_text(value)} ± {_text(se)}"  # noqa: E731
    each = [
        f"{g.axis} {size(g.intensity, g.intensity_se)} m/s, length {size(g.length, g.length_se)} m" for g in fit.gusts
    ]
    said = f"gusts in the identify flights: {'; '.join(each)}{_common(fit)}"
    lists = {name: [f for f in fit.flights.values() if f.list == name and f.J_gust is not None] for name in LISTS}
    scored = [
        f"{name} {_text(_rms(f.J_gust for f in flights))} and {_text(_rms(f.J_fed for f in flights))}"
        for name, flights in lists.items()
        if flights
    ]
    if not scored:
        return said
    return (
        f"{said}. Free runs know nothing of them: J of what gusts alone would do, and J with the gusts fed in that a"
        f" smoother finds in the same flights, by which the model is judged: {', '.join(scored)}"
    )


def _common(fit: FitRecord) -> str:
    """How strong a steady wind the identify flights may have in common, where gusts are slower than a flight."""
    count = sum(flight.list == "identify" for flight in fit.flights.values())
    if not count or any(g.intensity is None for g in fit.gusts):
        return ""
    strongest = max(g.intensity or 0.0 for g in fit.gusts) / count**0.5
    return (
        f"; what their {count} flights have in common, {strongest:.2g} m/s or so along an axis, is a steady wind that"
        " nothing tells from trims: the model flies in calm air as it would in that wind"
    )


def shown_flights(fit: FitRecord) -> dict[str, FlightRecord]:
    """The first flights of each list, which pictures and tables show."""
    ordered = [[name for name, flight in fit.flights.items() if flight.list == which] for which in LISTS]
    return {name: fit.flights[name] for flights in ordered for name in flights[:SHOWN]}


GRADED = "the data set is "
"""What a run's first warning begins with where its data set is not ready for identification."""
NOT_USABLE = f"{GRADED}not usable"


def headline(report: Report) -> str:
    """The grade of a data set that is not usable, else how well the model does on unseen flights, in few words."""
    first = next(iter(report.warnings), "")
    if first.startswith(NOT_USABLE) or (report.fit is None and first.startswith(GRADED)):
        return f"{first[0].upper()}{first[1:]}."
    if report.fit is None:
        return "No model was fitted in this run."
    short = short_horizon(report.fit)
    if short:
        return explained(short[-1])
    unseen = _unseen(report.fit)
    if not unseen:
        unknown = "No flight was kept back, so nothing is known about flights that no fit has seen."
        if not worse_than_trim(report.fit):
            return unknown
        poor = failing(report.fit)
        return f"{poor[:1].upper()}{poor[1:]}: do not use the model. {unknown}"
    decides, also = unseen[0], unseen[1:]
    share, grade = decides.explained, decides.grade
    more = "".join(f"; on the {a.name} flights {_share(a)}" for a in also)
    if share is None or share < 0.0:
        return f"On the {decides.name} flights the model is {WORSE_THAN_TRIM}: do not use the model yet{more}."
    fed = "alone" if decides.J_fed is None else "and the gusts that a smoother finds in them"
    return (
        f"On the {decides.name} flights, which no fit has seen, the model explains {percent(share)} of the motion"
        f" over 8 s from the controls {fed} ({grade}){more}."
    )


def _share(summary: ListSummary) -> str:
    """What is explained of a list, in per cent and as a word; below nothing the word says enough."""
    share = summary.explained
    return summary.grade if share is None or share < 0.0 else f"{percent(share)} ({summary.grade})"


def place_of(effect: EffectRecord) -> str:
    """Whether an effect that was asked for earned its place, in words."""
    if effect.verdict == "accepted":
        return "earns its place"
    unknown = effect.verdict in ("not testable", "indistinguishable")
    return "cannot be told from a model without it" if unknown else "does not earn its place"


def shortened(reason: str) -> str:
    """A reason with no more than the first names of a long list."""
    names = re.search(r"(?<=: )[\w.]+(?:, [\w.]+){3,}", reason)
    return reason if names is None else reason.replace(names[0], listed(names[0].split(", "), NAMED - 1))


def failing(fit: FitRecord) -> str:
    """How badly a model does on the flights that decide; empty where it is of use, or no flight is scored.

    Those are the flights that no fit has seen, validate before acid; without any, the flights that were fitted.
    """
    ahead = {flights.name: flights for flights in short_horizon(fit)}
    if ahead:
        return _failing_ahead(next(ahead[name] for name in DECIDING if name in ahead))
    decides = deciding(fit)
    share = None if decides is None else decides.explained
    if decides is None or share is None or share >= USABLE:
        return ""
    how = f"is {WORSE_THAN_TRIM}" if decides.worse_than_trim else f"explains only {100.0 * share:.0f} % of the motion"
    return f"on the {decides.name} flights the model {how}"


def worse_than_trim(fit: FitRecord) -> bool:
    """Whether holding trim describes those flights better than the model does; a multirotor's trim is none."""
    decides = None if short_horizon(fit) else deciding(fit)
    return decides is not None and decides.worse_than_trim


def worse_lists(fit: FitRecord) -> str:
    """On which lists of flights holding trim is better than the model, with both scores; empty where on none."""
    worse = [one for one in list_summaries(fit) if one.worse_than_trim]
    each = [f"{one.name} (J {_text(one.judged)} against {_text(one.J_trim)})" for one in worse]
    return f"{WORSE_THAN_TRIM} on the {enumerated(each)} flights" if each else ""


def deciding(fit: FitRecord) -> ListSummary | None:
    """The first list that is scored, in the order in which lists decide; also where the model flies away there."""
    scored = {s.name: s for s in list_summaries(fit) if s.explained is not None}
    return next((scored[name] for name in DECIDING if name in scored), None)


def _failing_ahead(flights: ShortHorizon) -> str:
    """The same for a multirotor: what it predicts worse than holding, else the mean R²."""
    if flights.worse:
        poor = too_far_ahead(flights)
        return f"on the {flights.name} flights the model predicts {poor} worse than holding what was measured"
    shares = [*flights.accelerations.values()]
    mean = sum(shares) / len(shares) if shares else 1.0
    if mean >= MOSTLY:
        return ""
    share = f"{100.0 * max(mean, 0.0):.0f} % of the accelerations (mean R² at measured states)"
    return f"on the {flights.name} flights the model explains only {share}"


def _unseen(fit: FitRecord) -> list[ListSummary]:
    """Scored lists that no fit has seen: validate first, which decides, then acid."""
    return [s for s in list_summaries(fit) if s.name != "identify" and s.explained is not None]


def next_steps(report: Report) -> list[str]:
    """What an engineer would look at next, most important first; never empty."""
    if report.fit is None:
        return ["Identify a model from these flights: rotorid identify."]
    traced = report.verdict is not None
    scores = partial(_steps_of_responses, traced=traced) if short_horizon(report.fit) else _steps_of_scores
    steps = [*scores(report.fit), *_steps_of_parameters(report.fit.parameters)]
    return steps or [NOTHING]


def weakest_channel(fit: FitRecord) -> tuple[str, str, float] | None:
    """Flight, body channel and relative error that is largest among flights not fitted; None where none is scored.

    The error is relative to the channel's motion on the flight that moves it most, so that an axis that a flight leaves
    alone (R² means nothing there) does not come out as the weakest.
    """
    motion = motions(fit)
    candidates = [
        (flight, name, (channel.rmse or 0.0) / motion[name])
        for flight, record in fit.flights.items()
        if record.list != "identify"
        for name, channel in record.channels.items()
        if name in names.BODY and motion[name] > 0.0
    ]
    return max(candidates, key=lambda c: c[2], default=None)


def motions(fit: FitRecord) -> dict[str, float]:
    """Motion of each channel on the flight that moves it most, as a standard deviation."""
    motion: dict[str, float] = {}
    for record in fit.flights.values():
        for name, channel in record.channels.items():
            motion[name] = max(motion.get(name, 0.0), _motion(channel))
    return motion


def _motion(channel: ChannelRecord) -> float:
    """Standard deviation of the measured channel, from R² = 1 - (rmse / deviation)²."""
    if channel.rmse is None or channel.r2 is None or channel.r2 >= 1.0:
        return 0.0
    return channel.rmse / math.sqrt(1.0 - channel.r2)


def _steps_of_scores(fit: FitRecord) -> Iterator[str]:
    lists = {summary.name: summary for summary in list_summaries(fit)}
    worse = worse_lists(fit)
    if worse:
        yield (
            f"The model is {worse}. Do not use the model: run rotorid check, then look at the error over time below."
        )
    by = {p.name.rpartition(".")[2] for p in fit.parameters if p.name.startswith("forces.")}
    decides = deciding(fit)
    share = None if decides is None else decides.explained
    if by and not by & {*names.VELOCITIES} and share is not None and share < GOOD:
        yield (
            "Speeds move the vehicle and are no states, so that other derivatives stand in for them: record velocities,"
            " or position and attitude. Accelerometers and attitude do where the data set declares"
            f" {DECLARED_SPEED}."
        )
    fitted, judged = lists.get("identify"), lists.get("validate")
    if fitted and judged and fitted.explained is not None and judged.explained is not None:
        if judged.explained < 0.9 and 1.0 - judged.explained > 3.0 * (1.0 - fitted.explained):
            yield (
                "The model follows the flights it was made from much better than the others: it lacks something, or"
                " these flights move too little for so many parameters, and more identify flights would help."
            )
    weakest = weakest_channel(fit)
    if weakest and weakest[2] > 0.3:
        flight, name, relative = weakest
        shares = [share or 0.0 for share in fit.flights[flight].channels[name].theil_parts]
        largest = shares.index(max(shares))
        yield (
            f"The largest error is in {name} on {flight}: {100 * relative:.0f} % of that channel's usual motion."
            f" {100 * shares[largest]:.0f} % of its square is {THEIL_PARTS[largest]}."
        )
    for mode in fit.modes:
        real, imaginary = mode.eigenvalue
        if real is not None and real > 0.05 and (imaginary or 0.0) >= 0.0:
            yield (
                f"The mode '{mode.name}' is unstable (time to double {math.log(2) / real:.1f} s): close a loop around"
                " the model for simulations that last longer than a few of these times."
            )


def _steps_of_responses(fit: FitRecord, traced: bool) -> Iterator[str]:
    """For a multirotor, of which free runs tell nothing; traced : whether effects were looked for already."""
    last = short_horizon(fit)[-1]
    unmoved = [NAMES[row] for row in ANGULAR_ACCELERATIONS if row in last.silent]
    if unmoved:
        yield (
            f"Nothing in the model makes {enumerated(unmoved, 'or')}: the warnings say why. Declare where the motors"
            " are, and fly larger inputs on these axes."
        )
    weak = [NAMES.get(name, name) for name, r2 in last.counted.items() if r2 < MOSTLY]
    if weak:
        look = (
            "no effect of the library explains the rest; rotorid check tells what these channels can show"
            if traced
            else "look for motor lag, delay, voltage or rotor drag with rotorid close-loop, or name them with --effect"
        )
        said = f"Of {listed(weak, NAMED)} less than {100 * MOSTLY:.0f} % is explained on the {last.name} flights"
        yield f"{said}: {look}."
    if last.worse:
        yield f"Do not predict {too_far_ahead(last)} with the model: what was measured last is nearer."


def at_an_edge(parameters: Iterable[ParameterRecord]) -> list[str]:
    """Parameters on a bound of their range; nothing or all of something and a time too short to be seen are none."""
    bounded = (p for p in parameters if p.at_bound and p.status != "nuisance")
    return [p.name for p in bounded if not (p.value == p.bounds[0] == 0.0 or _all(p) or _unresolved(p))]


def at_once(parameters: Iterable[ParameterRecord]) -> list[str]:
    """Time constants that are shorter than the records resolve."""
    return [p.name for p in parameters if p.at_bound and _unresolved(p)]


def _all(p: ParameterRecord) -> bool:
    """Whether a share is all of it."""
    return p.unit == "1" and p.bounds == (0.0, 1.0) and p.value == 1.0


def _unresolved(p: ParameterRecord) -> bool:
    """Whether a time is no longer than the interval of the records that are fitted."""
    return p.unit == "s" and p.value is not None and 0.0 < p.value <= RESOLVED_S


def _steps_of_parameters(parameters: Iterable[ParameterRecord]) -> Iterator[str]:
    parameters = list(parameters)
    bound = at_an_edge(parameters)
    if bound:
        yield (
            f"{listed(bound, NAMED)} at a bound: the value is the bound's, not the data's. Check the declared vehicle,"
            " the units and the sign of the controls."
        )
    silent = [p.name for p in parameters if p.status == "not identifiable"]
    if silent:
        yield f"The data do not tell {listed(silent, NAMED)}: fly a manoeuvre that moves what they multiply."
    free = [p for p in parameters if p.status == "free" and p.se and p.value is not None]
    vague = [p.name for p in free if (p.se or 0.0) > abs(p.value or 0.0)]
    if vague:
        yield f"{_could_be_zero(vague, len(free))} Longer flights on every axis would make them sure."


def _could_be_zero(vague: Sequence[str], free: int) -> str:
    """Few parameters whose error is larger than their value by name, many by their number."""
    if len(vague) <= NAMED:
        return f"Do not read anything into {enumerated(vague)}: the error is larger than the value."
    return (
        f"{len(vague)} of {free} estimated parameters could as well be zero, for their errors are larger than their"
        " values: the tables of the model tell which."
    )


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _rms(values: Iterable[float | None]) -> float | None:
    """Of values that are known; a flight without a sample that could be scored has none (NaN), as in the lists' J."""
    finite = [value for value in values if value is not None and not math.isnan(value)]
    return math.sqrt(sum(v * v for v in finite) / len(finite)) if finite else None
