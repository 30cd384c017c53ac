"""What the model that was identified again with effects says of them beside the one without, above all by free runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from rotorid_torch.run.pipeline import Run
from rotorid_torch.run.records import FlightRecord
from rotorid_torch.run.summary import GOOD, USABLE
from rotorid_torch.trace.candidates import of_control_path
from rotorid_torch.trace.decide import at_edge, clearly_worse, nothing
from rotorid_torch.trace.loop import Tracing

WORSE = "it describes segments of flights, but identified again with it, the model's free runs are clearly worse"
NO_BETTER = "free runs of flights that no fit has seen are no better by it, and segments gain no more than by chance"
STILL_POOR = (
    "free runs of unseen flights are no better by it, and leave more than a tenth of the motion: it may imitate that"
)
FAILS = "the model with it still does not describe the flights: something else acts, or more than this"
"""Said of unseen flights as of those that were fitted: what a fit leaves even there, its terms may imitate."""
FLOWN_AWAY = 1e9
"""J of a run that has none because its states left all bounds."""
IMITATES = "what is left over beside it, without a name, is larger than what it explains: it may imitate that"
AGAIN = "identified again with it, "
CHANGED = "beside it something begins in the midst of the flights, and it acts all the time: it may imitate that"


def best_of(runs: Sequence[Run]) -> Run:
    """The run that describes best the flights which no fit has seen, or without any the fitted; of equals the last."""

    def score(run: Run) -> float:
        J = run.scores["validate"]
        J = run.scores["identify"] if J is None else J
        return math.inf if J is None or math.isnan(J) else J

    return min(reversed(runs), key=score)


def objection(without: Run, after: Run, tracing: Tracing) -> str | None:
    """Why effects that were accepted are no finding, or None.

    What explains less than what then stays without a name may be no more than its imitation; so may a control path
    that is late, slow or loose from the start where something begins later. Nor is an effect one whose size is nothing,
    or no physics, once the three steps have run again with it.
    """
    doubts = idle([after], tracing.accepted)
    if doubts:
        return next(iter(doubts.values()))
    if clearly_worse(free_run_gain(without, after)):
        return WORSE
    deciding = _deciding(after)
    left = _beyond_noise(deciding)
    if best_of([without, after]) is without:
        # a model that imitates the effect drifts no more where little is left over; where much is, it is to be less
        if not tracing.sure:
            return NO_BETTER
        if left > (1.0 - GOOD) * _moved(deciding):
            return STILL_POOR
    if left > (1.0 - USABLE) * _moved(deciding):
        return FAILS
    missing = tracing.unknown
    if missing is not None and missing.judged:
        if left > 0.5 * _beyond_noise(_deciding(without)):
            return IMITATES
        if missing.since_s is not None and of_control_path(tracing.accepted) == [*tracing.accepted]:
            return CHANGED
    # last, for what is said above keeps what has no name
    fitted = _listed(after, "identify")
    return FAILS if _beyond_noise(fitted) > (1.0 - USABLE) * _moved(fitted) else None


def idle(runs: Sequence[Run], effects: Sequence[str]) -> dict[str, str]:
    """Effects that are nothing, or no physics, in each run of the three steps again with them, and why in the first."""

    def doubt(run: Run, effect: str) -> str | None:
        return at_edge(run.model, effect) or nothing(run.model, partial(_error, run), effect)

    doubts = {e: [doubt(run, e) for run in runs] for e in effects}
    return {e: f"{AGAIN}{whys[0]}" for e, whys in doubts.items() if None not in whys}


def _error(run: Run, name: str) -> float:
    """Standard error of a parameter of a run, infinite where it was estimated but cannot be told."""
    told = next((p for p in run.fit.parameters if p.name == name), None)
    if told is None or told.at_bound or told.status == "not identifiable":
        return math.inf
    return told.se or 0.0


def free_run_gain(without: Run, after: Run) -> Tensor:
    """log(J without / J with) of each flight that decides [F]; of two that fly away, or have no score, zero."""
    J = [[FLOWN_AWAY if f.J is None or math.isnan(f.J) else f.J for f in _deciding(run)] for run in (without, after)]
    before, now = torch.tensor(J, dtype=torch.float64).clamp(max=FLOWN_AWAY).log()
    return before - now


def _beyond_noise(flights: Sequence[FlightRecord]) -> float:
    """Mean of J² less what the sensors' noise makes of it, over flights."""
    return sum(max((f.J or 0.0) ** 2 - (f.J_noise or 0.0) ** 2, 0.0) for f in flights) / max(len(flights), 1)


def _moved(flights: Sequence[FlightRecord]) -> float:
    """The same of a model that holds trim; infinite where it is not known."""
    known = [f.J_trim**2 - (f.J_noise or 0.0) ** 2 for f in flights if f.J_trim is not None]
    return sum(max(one, 0.0) for one in known) / len(flights) if flights and len(known) == len(flights) else math.inf


def _deciding(run: Run) -> list[FlightRecord]:
    """Flights whose free runs decide: those that no fit has seen, without any the fitted; never the acid ones."""
    return _listed(run, "validate") or _listed(run, "identify")


def _listed(run: Run, name: str) -> list[FlightRecord]:
    """Flights of one list, but for those without a sample that could be scored."""
    flights = (f for f in run.fit.flights.values() if f.list == name)
    return [f for f in flights if f.J_trim is None or not math.isnan(f.J_trim)]
