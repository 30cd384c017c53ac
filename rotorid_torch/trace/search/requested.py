"""Whether effects that somebody asked for earn their place in an identified model, each beside the others.

The evidence is the closed loop's: more than by chance, a size whose interval excludes nothing, flights that no fit has
seen.
"""

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.trace.evidence.family import Scored
from rotorid_torch.trace.evidence.fits import FittedT
from rotorid_torch.trace.search.decide import Reason, Row, errors_of
from rotorid_torch.trace.search.eligible import ELSEWHERE
from rotorid_torch.trace.search.forward_selection import Search, Trial, row_of
from rotorid_torch.trace.search.outcome import Outcome
from rotorid_torch.trace.search.screening_sizes import with_screening_sizes
from rotorid_torch.trace.search.words import finding, reason, size_details
from rotorid_torch.trace.terms.candidate import Candidate
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds

NOT_IN_TRAJECTORIES = "trajectories do not show it; rotorid close-loop looks for it in sensors and spectra"


def earned(scored: Scored[FittedT], whole: FittedT, effects: Sequence[str], seed: int = 0) -> list[EffectFinding]:
    """A finding for each of these effects of a model.

    scored : the residual that tells. whole : the model with all of them, as identified. seed : of the residuals
    turned in time that say what chance explains.
    """
    spec, flights = whole.spec, whole.flights
    shown = [e for e in effects if registered()[e].showing not in ELSEWHERE]
    sized, tested, unmoved = with_screening_sizes(spec.without(shown), whole.values, flights.dataset, shown)
    findings = {f.id: f for f in unmoved}
    findings |= {e: finding(e, Row(testable=False), lacking=NOT_IN_TRAJECTORIES) for e in effects if e not in shown}
    if tested:
        richer = msgspec.structs.replace(spec, screening_sizes=sized.screening_sizes)
        whole = scored.refitted(richer, whole)
        findings |= {e: _finding(scored, whole, e, seed) for e in tested}
    return [findings[e] for e in effects]


def _finding(scored: Scored[FittedT], whole: FittedT, effect: str, seed: int) -> EffectFinding:
    """What a model without the effect, fitted with the same care, says of it."""
    role, search = registered()[effect].role, Search(scored, seed=seed)
    null = scored.refitted(whole.spec.without([effect]), whole)
    if role is Role.LEARNT:  # a network has no size of its own
        better = null.unseen_log_ratios(whole)
        flights = {"better": int((better > 0).sum()), "count": len(better)}
        helps = exceeds(better)
        return finding(effect, Row(unseen_better=helps), reason(Reason.HELPS, **flights) if helps else "", **flights)
    candidate = Candidate(effect, effect in whole.spec.each_control)
    p = search.family_beside(null, [effect]).of(effect)
    significant = min(p.values(), default=0.0) <= SETTINGS.level
    row = replace(row_of(null, whole, candidate), significant=significant)
    search.trials[candidate] = Trial(candidate, null, whole, row)
    search.joined += [candidate] if search.trials[candidate].stands else []
    said = Outcome(search, whole, None, {}, {}).findings([effect])[0]
    if said.verdict == "accepted":
        said = replace(said, reason=reason(Reason.HELPS, **size_details(null, whole, effect)))
    return replace(said, role=role.value, values=errors_of(whole, effect))
