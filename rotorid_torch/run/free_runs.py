"""Free runs of models that were identified again: which is best, which is worse by more than chance, what stays."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from rotorid_torch.report.records import FlightRecord
from rotorid_torch.report.summary import ListSummary, list_summaries
from rotorid_torch.run.result import Run
from rotorid_torch.trace.evidence.critical_values import Null
from rotorid_torch.trace.loop import Tracing
from rotorid_torch.trace.search.decide import Interval, Reason, Row, Size, decide, size_by
from rotorid_torch.trace.search.words import reason
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds

DECIDING = ("validate", "identify")
"""Lists whose free runs decide: flights that no fit has seen, and the fitted ones where those are fewer than two, for
one flight does not tell what is chance; never the acid."""
FLOWN_AWAY = 10.0
"""J of a run that has none because its states left all bounds, and the largest that counts: held trim scores 1.

How far away a model flies says nothing more, and one such flight would hide what all the others say.
"""


def score_of(run: Run) -> float:
    """J of the flights which no fit has seen, or without any of the fitted; infinite where there is none."""
    return _of_one_list(run, lambda one: one.judged)


def unfed_score(run: Run) -> float:
    """The same without gusts fed in, for a smoother finds those in the flights that are judged."""
    return _of_one_list(run, lambda one: one.J)


def _of_one_list(run: Run, score: Callable[[ListSummary], float | None]) -> float:
    """Of the same list for all runs of a data set: a model that flies away there is not judged by the others."""
    scores = {one.name: score(one) for one in list_summaries(run.fit)}
    J = next((scores[n] for n in DECIDING if n in scores), None)
    return math.inf if J is None or math.isnan(J) else J


def worse_than_trim(run: Run) -> bool:
    """Whether holding trim describes the flights that decide better than the model does, noise removed."""
    shares = {one.name: one.explained for one in list_summaries(run.fit)}
    share = next((shares[n] for n in DECIDING if shares.get(n) is not None), None)
    return share is not None and share < 0.0


def free_run_gain(without: Run, after: Run) -> Tensor:
    """log(J without / J with) of each flight that decides [F]; of two that fly away, or have no score, zero."""
    J = torch.tensor([_deciding(run) for run in (without, after)], dtype=torch.float64)
    before, now = J.clamp(max=FLOWN_AWAY).log()
    return before - now


def worse(without: Run, after: Run) -> bool:
    """Whether free runs of the flights that decide are worse, in the mean of log J, at the level of the search."""
    return exceeds(-free_run_gain(without, after), 1.0 - SETTINGS.level)


def worse_on_average(without: Run, after: Run) -> bool:
    """Whether the mean of log J of the flights that decide is larger: four hardly ever show more than chance."""
    return float(free_run_gain(without, after).mean()) < 0.0


def with_structure_unless(is_worse: Callable[[Run, Run], bool], whole: Run, *bare: Run) -> Run:
    """The run with ordinary physics; one without where free runs are worse with it, or fly away.

    Every rotor has such physics, so that a tie speaks for it. is_worse : of a run without and the run with it.
    """
    away = torch.tensor(_deciding(whole)).isinf()
    better = [one for one in bare if is_worse(one, whole) or bool(torch.tensor(_deciding(one))[away].isfinite().any())]
    return better[0] if better else whole


def _deciding(run: Run) -> list[float]:
    """J of each flight of the lists that decide, with gusts fed in where some were found; infinite without a score."""
    flights: list[FlightRecord] = []
    for name in DECIDING:
        flights += [f for f in run.fit.flights.values() if f.list == name] if len(flights) < 2 else []
    scores = [f.J if f.J_fed is None else f.J_fed for f in flights]
    return [math.inf if one is None or math.isnan(one) else one for one in scores]


def before_and_after(
    first: Run, tracing: Tracing, sensors: bool, wrong: Callable[..., Run], right: Callable[..., Run]
) -> tuple[Run, Run | None, Tracing]:
    """The best run without what was traced, that with it or none where nothing stays, and the tracing that stands.

    first : the nominal model. sensors : whether sensors err. wrong, right : the three steps again for a spec from
    values, on records as they are and on those without the sensors' errors. Structure alone stays unless free runs of
    unseen flights are worse with it on average, as in cross-validation, for it accuses nothing. Beside names it stays
    unless they are worse by more than chance: the size of an effect would take up what structure explains.
    Names whose interval holds nothing in the model that is reported go first. A model that is worse than holding trim
    names nothing. A multirotor's free runs decide nothing.
    """

    def shapes(one: Null) -> list[Run]:
        """On right records, with the structure that was traced, and without."""
        both = [one.spec, *([one.spec.without(tracing.structure)] if tracing.structure else [])]
        return [right(shape, one.values) for shape in both]

    null = tracing.null
    plain = (
        with_structure_unless(worse_on_average, wrong(null.spec, null.values), first) if tracing.structure else first
    )
    while tracing.accepted:
        whole, *bare = shapes(tracing.final)
        idle = _within_error(whole, tracing)
        if idle:
            why = Reason.WITHIN_ERROR
            said = {e: reason(why, parameter=s.parameter, value=s.value, error=s.error) for e, s in idle.items()}
            tracing = tracing.without(why, said)
            continue
        if first.spec.motors:
            return plain, whole, tracing
        after = with_structure_unless(worse, whole, *bare)
        without = with_structure_unless(worse_on_average, *shapes(null)) if sensors else plain
        verdict, why = decide(Row(runs_worse=worse(without, after), useful=not worse_than_trim(after)))
        if verdict == "accepted":
            return plain, after, tracing
        gains = free_run_gain(without, after)
        said = reason(why, worse=int((gains < 0.0).sum()), count=len(gains))
        tracing = tracing.without(why, dict.fromkeys(tracing.accepted, said))
    if sensors:
        return plain, with_structure_unless(worse_on_average, *shapes(null)), tracing
    return first, None if plain is first else plain, tracing


def _within_error(run: Run, tracing: Tracing) -> dict[str, Size]:
    """Names of which all 95 % intervals of a fit hold nothing, by the errors that are reported, and their sizes."""
    errors = {p.name: max(p.se, tracing.spread.get(p.name, 0.0)) for p in run.fit.parameters if p.se is not None}
    fitted = [e for e in tracing.accepted if any(name.startswith(f"{e}.") for name in errors)]
    sizes = {effect: size_by(run.model, errors, effect) for effect in fitted}
    return {e: one for e, one in sizes.items() if one.estimate is Interval.WITHIN_ERROR and math.isfinite(one.error)}
