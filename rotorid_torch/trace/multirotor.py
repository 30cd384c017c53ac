"""Which effects a multirotor's model lacks: the search by accelerations at measured states, and what balances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.balance import out_of_balance
from rotorid_torch.trace.evidence.fits import Flights
from rotorid_torch.trace.loop import DrawClean, Traced, Tracing, draws_of, notes_of
from rotorid_torch.trace.measured.accelerations import MeasuredAccelerations
from rotorid_torch.trace.search.forward_selection import Search
from rotorid_torch.trace.search.outcome import Outcome
from rotorid_torch.trace.search.screening_sizes import with_screening_sizes
from rotorid_torch.trace.terms.eligible import candidates, untried
from rotorid_torch.trace.terms.finding import EffectFinding

UNSEEN_STATE = "it has a motion of its own, which no channel tells; accelerations at measured states show nothing of it"


def trace_rotors(
    spec: ModelSpec,
    flights: Flights,
    draw: DrawClean,
    say: Callable[[str], None] = lambda line: None,
    seed: int = 0,
    ranks: Ranks = ALONE,
) -> Tracing:
    """Which undeclared effects the model of a multirotor lacks.

    draw : statistics of effects on clean multirotors. say : told what happens, a line at a time.
    seed : of the residuals turned in time. ranks : processes that share the candidates; each calls this.
    """
    testable, settled = candidates(spec)
    tested: list[str] = []
    for effect in (e for e in testable if registered()[e].role is Role.UNDECLARED):
        why = _untested(spec, effect)
        settled += [why] if why is not None else []
        tested += [effect] if why is None else []
    shared = MeasuredAccelerations(flights, ranks=ranks)
    null = shared.fitted(spec)
    sized, tested, unmoved = with_screening_sizes(null.spec, null.values, flights.dataset, tested)
    null = replace(null, spec=sized)
    search = Search(shared, lambda observed, effects: draws_of(search, observed, effects, (), draw, seed), say)
    final = search.back(search.forward(null, tested), tested)
    outcome = Outcome(search, final, None, {}, search.spread(final))
    balanced = bool(spec.motors) and spec.found_places is None  # of arms that are not known nothing balances
    dataset = flights.dataset
    centre, missing = (
        out_of_balance(final.model, final.spec, dataset, dataset.unseen, seed) if balanced else (None, None)
    )
    findings = (*outcome.findings(tested), *settled, *unmoved)
    return Tracing(
        Traced(null.spec, null.values),
        Traced(final.spec, final.values),
        (),
        outcome.accepted,
        outcome.groups,
        tuple(centre if centre and f.id == centre.id else f for f in findings),
        (*notes_of(search), *untried(dataset)),
        missing,
        outcome.spread,
    )


def _untested(spec: ModelSpec, effect: str) -> EffectFinding | None:
    """Why accelerations at measured states do not tell an effect; None where they may."""
    if registered()[effect].swings:
        return EffectFinding(effect, "undeclared", "not testable", UNSEEN_STATE)
    absorbed = registered()[effect].absorbed_by(spec)
    if not absorbed:
        return None
    said = f"{absorbed} stand for it in these flights; weigh the vehicle, or swing it, to tell"
    return EffectFinding(effect, "undeclared", "indistinguishable", said, group=(absorbed,))
