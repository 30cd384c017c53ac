"""What the model that was identified again with effects says of them beside the one without, above all by free runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from rotorid_torch.run.pipeline import Run
from rotorid_torch.run.records import FlightRecord
from rotorid_torch.run.summary import GOOD, USABLE, list_summaries
from rotorid_torch.trace.candidates import of_control_path
from rotorid_torch.trace.decide import at_edge, clearly_worse, nothing
from rotorid_torch.trace.loop import Tracing

WORSE = "it describes segments of flights, but identified again with it, the model's free runs are clearly worse"
NO_BETTER = "free runs of flights that no fit has seen are no better by it, and segments gain no more than by chance"
STILL_POOR = (
    "free runs of unseen flights are no better by it, and leave more than a tenth of the motion: it may imitate that"
)
WORSE_FITTED = "identified again with it, the model's free runs of the very flights that are fitted are clearly worse"
FAILS = "the model with it still does not describe the flights: something else acts, or more than this"
"""Said of unseen flights as of those that were fitted: what a fit leaves even there, its terms may imitate."""
DECIDING = ("validate", "identify")
"""Lists whose free runs decide, the first that has flights: those no fit has seen, or the fitted; never the acid."""
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
    if clearly_worse(free_run_gain(without, after, "identify")):
        return WORSE_FITTED
    explained = _explained(after, *DECIDING)
    if best_of([without, after]) is without:
        # a model that imitates the effect drifts no more where little is left over; where much is, it is to be less
        if not tracing.sure:
            return NO_BETTER
        if explained < GOOD:
            return STILL_POOR
    if explained < USABLE:
        return FAILS
    missing = tracing.unknown
    if missing is not None and missing.judged:
        if 1.0 - explained > 0.5 * (1.0 - _explained(without, *DECIDING)):
            return IMITATES
        if missing.since_s is not None and of_control_path(tracing.accepted) == [*tracing.accepted]:
            return CHANGED
    # last, for what is said above keeps what has no name
    return FAILS if _explained(after, "identify") < USABLE else None


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


def free_run_gain(without: Run, after: Run, *lists: str) -> Tensor:
    """log(J without / J with) of each flight of a list [F]; of two that fly away, or have no score, zero.

    lists : of which the first that has flights is taken; without any, those that decide.
    """
    flown = [_first_of(lists or DECIDING, run) for run in (without, after)]
    J = [[FLOWN_AWAY if f.J is None or math.isnan(f.J) else f.J for f in flights] for flights in flown]
    before, now = torch.tensor(J, dtype=torch.float64).clamp(max=FLOWN_AWAY).log()
    return before - now


def _explained(run: Run, *lists: str) -> float:
    """Share of the motion that a run explains, noise removed, over the first of the lists that is scored.

    One where none is, which tells nothing against the run; zero where nothing moved beyond the noise.
    """
    scored = {s.name: s for s in list_summaries(run.fit) if s.J is not None and not math.isnan(s.J)}
    found = next((scored[name] for name in lists if name in scored), None)
    return 1.0 if found is None else found.explained or 0.0


def _first_of(lists: Sequence[str], run: Run) -> list[FlightRecord]:
    """Flights of the first of these lists that has any."""
    by_list = ([f for f in run.fit.flights.values() if f.list == name] for name in lists)
    return next((flights for flights in by_list if flights), [])
