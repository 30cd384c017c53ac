"""The first screen of a report: the discovery in one sentence, before and after, the worst channel, what to do next."""

import math
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rotorid_torch.arguments import enumerated
from rotorid_torch.core import names
from rotorid_torch.printable import percent
from rotorid_torch.report.records import ChannelRecord, EffectRecord, FitRecord, Report, UnknownRecord
from rotorid_torch.report.short_horizon import NAMES, left_out, predicted, short_horizon, weakest_response
from rotorid_torch.report.summary import (
    GRADED,
    GRADES,
    NOT_USABLE,
    NOTHING,
    ListSummary,
    deciding,
    failing,
    headline,
    list_summaries,
    motions,
    next_steps,
    weakest_channel,
    worse_than_trim,
)
from rotorid_torch.report.words.effects import words_of
from rotorid_torch.report.words.sizes import sentence_of, size, sizes_of, smallest_size
from rotorid_torch.validate.lists import described

STEPS = 5
"""Steps that a report names, at most."""
LONGEST_STEP = 160
"""Characters of a grade that a step quotes, where that has several reasons."""
CLOSE_LOOP = "Ask by name what the model lacks: rotorid close-loop DATASET --out LOOP."
EXPORT = "rotorid export RUN --fmu model.fmu writes the model for other tools."
ALIKE = 0.02
"""Relative change of a score below which two models describe flights alike."""
AWAY = 10.0
"""Error of a channel over its usual motion from which on the number says nothing more."""
OF_SILENCE = ("control.delay", "environment.wind", "propulsion.motor_lag", "sensors.delay")
"""Effects whose smallest visible size says what the silence of a run is worth, as many as `SHOWN`."""
SHOWN = 2
WOULD_TELL = "would tell"
"""How a reason ends that says which flights decide."""
SILENT = ("nothing undeclared", "structure")
OWN_RESIDUALS = "critical values come from the data's own residuals"
"""How a warning begins where no clean aircraft could be flown; why is what it ends with."""
KINDS_OF_ERROR = ("an offset", "a wrong amplitude", "a wrong shape")
AXES = {"X": "the forward force", "Y": "the side force", "Z": "the vertical force"}
AXES |= {"L": "the rolling moment", "M": "the pitching moment", "N": "the yawing moment"}
_PLACES = re.compile(r"\b(DATASET|RUN|LOOP)\b")
_MISSING_IN = re.compile(rf"( missing in |; )([{''.join(AXES)}]):")
"""Where a sentence about what has no name says an equation by its letter."""
_GOES_WITH = re.compile(r"\b(goe?s? with) (\w+)")
"""Where it says a signal by its name."""
_SQUARED = re.compile(r"(?<=/s)2\b")


@dataclass(frozen=True)
class Grade:
    """How good one fit is.

    title : "before", "after" or nothing. share : explained of the motion of flights not seen, 0 to 1; None where
    none is scored. word : the same as a word. of : what it is a share of. worst : the worst channel, as a sentence.
    """

    title: str
    share: float | None
    word: str
    of: str
    worst: str


def opening(report: Report) -> str:
    """What a run discovered, in one plain sentence with units."""
    verdict = report.verdict
    if verdict is None or report.fit is None:
        return headline(report)
    accepted = [e for e in report.effects if e.id in verdict.effects and e.verdict == "accepted"]
    if verdict.kind in ("undeclared", "group"):
        return _undeclared(report, accepted)
    if verdict.kind == "structure":
        joined = enumerated([words_of(e.id).noun for e in accepted])
        poor = failing(report.fit)
        nothing = "Something without a name is missing" if poor else "These flights show nothing undeclared"
        return f"{nothing}; ordinary physics joins the model: {joined}."
    if verdict.kind == "nothing undeclared":
        if not failing(report.fit):
            return "These flights show nothing that is not declared."
        if next(iter(report.warnings), "").startswith(NOT_USABLE):
            return headline(report)
    suspects = _suspects(report)
    if report.unknown is None and suspects:
        poor = failing(report.fit)
        first = f"{poor[:1].upper()}{poor[1:]}. " if poor else ""
        return f"{first}Something is missing that these flights do not name. Suspected: {enumerated(suspects)}."
    said = verdict.sentence if report.unknown is None else report.unknown.sentence
    said = _MISSING_IN.sub(lambda row: f"{row[1]}{AXES[row[2]]} ({row[2]}):", said)
    return _SQUARED.sub("²", _GOES_WITH.sub(lambda signal: f"{signal[1]} {_meaning(signal[2], 'the ')}", said))


def _undeclared(report: Report, accepted: list[EffectRecord]) -> str:
    """One effect in its own sentence; all that is missing in one sentence, with sizes, where there is more."""
    assert report.verdict is not None
    sizes = {e.id: f" ({said})" for e in report.effects if (said := sizes_of(e))}
    certain = {e.id: f"{words_of(e.id).noun}{sizes.get(e.id, '')}" for e in accepted}
    others = [f"{words_of(name).noun}{sizes.get(name, '')}" for name in report.verdict.effects if name not in certain]
    if report.unknown is None and not others and len(accepted) == 1:
        return sentence_of(accepted[0])
    if report.unknown is None and not certain:
        either = f"Something acts on this vehicle that is not declared: {enumerated(others, 'or')}."
        return f"{either} These flights cannot tell which."
    group = [f"either {enumerated(others, 'or')} (these flights cannot tell which)"] if others else []
    more = [_unnamed(report.unknown)] if report.unknown else []
    return f"The flights show what is not declared: {enumerated([*certain.values(), *group, *more])}."


def consequence(report: Report) -> str:
    """What the discovery does for the model; where none was looked for how far a multirotor's model predicts."""
    if report.fit is None:
        return ""
    if report.verdict is None:
        return "".join(map(predicted, short_horizon(report.fit)[-1:]))
    poor = failing(report.fit)
    care = f"Take care: {poor}." if poor and poor.lower() not in opening(report).lower() else ""
    silence = "" if poor or report.verdict.kind not in SILENT else _silence(report)
    does = _improvement(report) or ("" if poor else headline(report))
    return " ".join(part for part in (does, silence, care) if part)


def _silence(report: Report) -> str:
    """How large what was not found would have to be."""
    visible = {e.id: e.smallest_visible for e in report.effects if e.verdict == "below floor"}
    pairs = [(name, v) for name in OF_SILENCE if (v := visible.get(name)) is not None and v.value is not None]
    said = [f"{words_of(name).noun} of {smallest_size(v.value or 0.0, v.unit)}" for name, v in pairs[:SHOWN]]
    return f"The flights would have shown {enumerated(said, 'or')} in four cases of five." if said else ""


def _improvement(report: Report) -> str:
    before, after = report.before, report.after
    if before is None or after is None:
        return ""
    short = short_horizon(after)
    if short:
        first, last = (described(short_horizon(fit)[-1], short[-1]) for fit in (before, after))
        return (
            f"With {_added(report)} in the model, {percent(last)} instead of {percent(first)} of the accelerations"
            f" of the {short[-1].name} flights are explained.{left_out(short[-1])}"
        )
    pairs = zip(list_summaries(before), list_summaries(after), strict=True)
    said = [sentence for b, a in pairs if a.name != "identify" and (sentence := _changed(b, a, (before, after)))]
    return f"With {_added(report)} in the model, {'; '.join(said)}." if said else ""


def _added(report: Report) -> str:
    """What the second model has more: by name where the opening speaks of what has none."""
    joined = [words_of(e.id).noun for e in report.effects if e.verdict == "accepted"]
    unnamed = report.verdict is not None and report.verdict.kind == "unknown"
    return enumerated(joined) if joined and unnamed else "that"


def grades(report: Report) -> tuple[Grade, ...]:
    """One for each fit, before and after."""
    fits = [("before", report.before), ("after", report.after)] if report.after else [("", report.before)]
    return tuple(_grade(title, fit, report.fit or fit) for title, fit in fits if fit is not None)


def steps(report: Report) -> list[str]:
    """What to do next, the discovery first; never empty. Commands have DATASET, RUN and LOOP for folders."""
    first = next(iter(report.warnings), "")
    graded = f"rotorid check says: {_in_short(first.removeprefix(GRADED))}." if first.startswith(GRADED) else ""
    mend = [f"Mend the data first. {graded}"] if first.startswith(NOT_USABLE) else []
    care = [f"Better data would tell more. {graded}"] if graded and not mend else []
    asks = report.command == "identify" and report.fit is not None and not worse_than_trim(report.fit)
    ask = [CLOSE_LOOP] if asks else []
    said = list(dict.fromkeys([*mend, *_of_discovery(report), *ask, *care, *next_steps(report)]))
    return [step for step in said if step != NOTHING or len(said) == 1][:STEPS]


def with_places(command: str, dataset: Path | None, run: Path | None) -> str:
    """A command with the folders at hand, as a shell reads them; the loop's lies beside the run's or the flights'."""
    loop = f"{run}-loop" if run else f"{dataset}-run" if dataset and dataset.name else None
    places = {"DATASET": dataset, "RUN": run, "LOOP": loop}
    return _PLACES.sub(lambda place: shlex.quote(str(places[place[0]] or place[0])), command)


def _in_short(grade: str) -> str:
    """A grade with as many of its reasons as fit into a step, the first in any case."""
    reasons = grade.split("; ")
    count = max(sum(len("; ".join(reasons[: k + 1])) <= LONGEST_STEP for k in range(len(reasons))), 1)
    short = "; ".join(reasons[:count])
    return short if count == len(reasons) else f"{short}{')' if short.count('(') > short.count(')') else ''}, and more"


def worst_of(fit: FitRecord) -> str:
    """The channel that the model describes worst on flights it has not seen, as a sentence; empty where none is."""
    short = short_horizon(fit)
    if short:
        worst = weakest_response(fit)
        if worst is None:
            return f"on the {short[-1].name} flights the model moves none of the accelerations"
        return f"{_meaning(worst[1])} on the {short[-1].name} flights, {percent(max(worst[2], 0.0))} explained"
    weakest = weakest_channel(fit)
    if weakest is None:
        return ""
    flight, name, relative = weakest
    channel = fit.flights[flight].channels[name]
    if relative > AWAY:
        return f"{_meaning(name)} on {flight}, off by more than {AWAY:.0f} times its usual motion: the model flies away"
    error = f"{size(channel.rmse or 0.0, None, names.unit(name))} rms, {percent(relative)} of its usual motion"
    return f"{_meaning(name)} on {flight}, off by {error}: mostly {kind_of(channel)}"


def kind_of(channel: ChannelRecord) -> str:
    """The largest of Theil's parts of an error, in words."""
    parts = [part or 0.0 for part in channel.theil_parts]
    return KINDS_OF_ERROR[parts.index(max(parts))]


def _grade(title: str, fit: FitRecord, last: FitRecord) -> Grade:
    short = short_horizon(fit)
    if short:
        share = described(short[-1], short_horizon(last)[-1])
        word = next((w for limit, w in GRADES if share >= limit), "worse than the mean")
        return Grade(title, share, word, f"of the accelerations of {short[-1].name} flights", worst_of(fit))
    decides = deciding(fit)
    if decides is None:
        return Grade(title, None, "not scored", "no flight is scored", worst_of(fit))
    flights = "flights it was made from" if decides.name == "identify" else "unseen flights"
    return Grade(title, decides.explained, decides.grade, f"of the motion of {flights}", worst_of(fit))


def _changed(before: ListSummary, after: ListSummary, fits: tuple[FitRecord, FitRecord]) -> str:
    """How much better one list is described, by its scores; where it is worse, in which channel."""
    if not before.judged or after.judged is None or not math.isfinite(after.judged):
        return ""
    change, scores = after.judged / before.judged - 1.0, f"J {before.judged:.3f} to {after.judged:.3f}"
    flights = "unseen flights" if after.name == "validate" else f"the {after.name} flights"
    if before.worse_than_trim and not after.worse_than_trim:
        scores = f"J {after.judged:.3f} of {before.J_trim or 0.0:.3f}"
        return f"{flights} are described better than by held trim ({scores}), without it worse"
    if abs(change) < ALIKE:
        return f"{flights} are described as before ({scores})"
    if change < 0.0:
        return f"{flights} are described {percent(-change)} better ({scores})"
    return f"{flights} are described {percent(change)} worse ({scores}){_because(after.name, *fits)}"


def _because(listed: str, before: FitRecord, after: FitRecord) -> str:
    """The channel of a list's flights whose error grew most, over its usual motion, and what kind of error it is."""
    motion = motions(after)
    grown = [
        ((now.rmse or 0.0) - (then.rmse or 0.0), flight, name)
        for flight, record in after.flights.items()
        if record.list == listed and flight in before.flights
        for name, now in record.channels.items()
        if name in names.BODY and motion.get(name) and (then := before.flights[flight].channels.get(name))
    ]
    if not grown:
        return ""
    _, flight, name = max(grown, key=lambda g: g[0] / motion[g[2]])
    now, then = (fit.flights[flight].channels[name] for fit in (after, before))
    errors = [size(channel.rmse or 0.0, None, names.unit(name)) for channel in (now, then)]
    return f", because on {flight} {_meaning(name)} is off by {errors[0]} instead of {errors[1]}: mostly {kind_of(now)}"


def _of_discovery(report: Report) -> Iterator[str]:
    verdict = report.verdict
    if verdict is None:
        return
    records = {e.id: e for e in report.effects}
    if verdict.kind not in SILENT and verdict.effects:
        for said in (w for w in report.warnings if w.startswith(OWN_RESIDUALS)):
            why = said.partition(": ")[2]
            yield f"Take names with care: no clean aircraft could be flown to show what chance does, for {why}."
    for name in verdict.effects:
        record = records.get(name)
        if record is None:
            continue
        if record.verdict == "accepted" and record.role == "undeclared" and words_of(name).then:
            yield words_of(name).then
        if record.verdict == "indistinguishable":
            yield _to_tell(record)
    if report.unknown is not None:
        yield _look_for(report)
        if verdict.effects:
            yield "Take what is named with care until that is found: a cause without a name may stand behind it."
    for suspect in _suspects(report):
        yield f"Suspected, for it explains a part: {suspect}."
    if verdict.kind in SILENT and report.fit is not None and not failing(report.fit):
        yield f"Use the model within the range of motion that the flights covered; {EXPORT}"


def _suspects(report: Report) -> list[str]:
    """Effects that are only suspected, each with its sizes."""
    suspects = [e for e in report.effects if e.verdict == "suspected"]
    return [f"{words_of(e.id).noun}{f' ({sizes})' if (sizes := sizes_of(e)) else ''}" for e in suspects]


def _to_tell(record: EffectRecord) -> str:
    """What would tell a member of a group: what its reason says last, else what to do if it is this one."""
    words, last = words_of(record.id), record.reason.rpartition(";")[2].strip()
    if last.endswith(WOULD_TELL):
        return f"{last[:1].upper()}{last[1:]} {words.noun} from what takes its place."
    if words.then:
        return f"If {words.noun} is the cause: {words.then[0].lower()}{words.then[1:]}"
    return f"To tell {words.noun} from what takes its place: fly at another speed, height or mass."


def _unnamed(unknown: UnknownRecord) -> str:
    """What is missing beside what is named, as a thing."""
    where = _axes(unknown.where)
    goes = f", which goes with {_signals(unknown.goes_with)}" if unknown.goes_with else ""
    return f"something without a name in {where}{goes}"


def _axes(where: str) -> str:
    """Equations by their letters, one after another, in words; another place as it is."""
    return enumerated([AXES[letter] for letter in where]) if set(where) <= set(AXES) else where


def _signals(goes_with: str) -> str:
    """Signals and products of signals, in words."""
    return enumerated([_product(one) for one in goes_with.split(" and ")])


def _product(signals: str) -> str:
    """One signal or a product of two by their names; words stay as they are."""
    factors = signals.split()
    if not all(name in NAMES or names.channel(name) for name in factors):
        return signals
    said = enumerated([_meaning(name, "the ") for name in factors])
    return said if len(factors) == 1 else f"the product of {said}"


def _look_for(report: Report) -> str:
    unknown = report.unknown
    assert unknown is not None
    low, high = unknown.band_hz
    band = f" between {low:.2g} and {high:.2g} Hz" if low is not None and high is not None else ""
    goes = f", in step with {_signals(unknown.goes_with)}" if unknown.goes_with else ""
    return (
        f"What is missing acts on {_axes(unknown.where)}{band}{goes}: compare flights with and without that, look for"
        " what was changed on the vehicle, and add a channel that shows the cause."
    )


def _meaning(name: str, article: str = "") -> str:
    about = NAMES.get(name) or names.about(name).partition(",")[0]
    return f"{article}{about} ({name})" if about else name
