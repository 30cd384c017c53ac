"""Ordinary physics that the nominal model leaves out: no accusation, so held-out evidence alone decides.

What every rotor has joins first, so that no candidate earns what any rotor has; unless an effect of the control path
explains more: lag motions have so many sizes that they stand for a delay. Other structure joins where flights that no
fit has seen are better described. What did not join is asked again beside the effects that did. In the end structure
stays whose size excludes nothing, or by which those flights gain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rotorid_torch.data.on_demand import OnDemand
from rotorid_torch.effects.registry import registered
from rotorid_torch.trace.evidence.fits import CAREFUL, Fitted, refit, total
from rotorid_torch.trace.evidence.parallel_fits import Wanted, fits
from rotorid_torch.trace.evidence.screen import screen
from rotorid_torch.trace.search.decide import Interval, Row, errors_of, improves, likelihood_gain, size_of
from rotorid_torch.trace.search.forward_selection import Search, Trial, row_of
from rotorid_torch.trace.search.trajectories import Trajectories
from rotorid_torch.trace.search.words import finding, size_details
from rotorid_torch.trace.terms.candidate import Candidate, of_control_path
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.significance import exceeds

ORDINARY = "every rotor has it: it joins the model without a test, and describes the fitted flights better"
WANTED = "ordinary physics that flights not fitted ask for"
NOT_WANTED = "flights not fitted do not gain by it"
WAITS = "an effect of the control path explains more"


def with_structure(
    search: Search[Fitted], shared: Trajectories, null: Fitted, effects: Sequence[str], tested: Sequence[str] = ()
) -> tuple[Fitted, list[EffectFinding]]:
    """The null with the structure that joins it, and a finding for each of these effects.

    tested : effects that the search asks behind the structure.
    """
    ordinary = [e for e in effects if registered()[e].ordinary]
    null, findings = _with_ordinary(search, shared, null, ordinary, of_control_path(tested))
    null = _over_short(search, shared, null) if search.first is None else null
    others = [e for e in effects if e not in ordinary]
    while others:
        screened = screen(null, others)
        promising = {e: screened.evidence(e) for e in others}
        best = max(promising, key=lambda e: float(promising[e].sum()))
        if not exceeds(promising[best]):
            break
        candidate = Candidate(best)
        fitted = shared.fitted(null, {candidate: screened.starts(best)})[candidate]
        null = search.improved(null, {candidate: fitted})
        trial = Trial(candidate, null, fitted, row_of(null, fitted, candidate))
        search.say(f"structure: {trial}")
        one = finding(best, trial.row, WANTED if trial.stands else "", **size_details(null, fitted, best))
        findings.append(replace(one, values=_sizes(fitted, best)))
        null = fitted if trial.stands else null
        others.remove(best)
    return null, findings + [finding(e, Row(significant=False), NOT_WANTED) for e in others]


def without_idle(
    search: Search[Fitted], shared: Trajectories, final: Fitted, structure: Sequence[str]
) -> tuple[Fitted, list[str]]:
    """The model without structure of no certain size by which flights not fitted do not gain, and what left it.

    An interval that holds nothing does not make a hinge or a lag motion nothing: the fitted flights may not tell sizes
    apart that other flights need.
    """
    left: list[str] = []
    for e in structure:
        if size_of(final, e).estimate is Interval.SIZE:
            continue
        without = shared.refitted(final.spec.without([e]), final)
        helps = improves(without.unseen_log_ratios(final))
        search.say(f"structure: {e}, without a certain size: {'stays' if helps else 'leaves'} by flights not fitted")
        if not helps:
            final = without
            left.append(e)
    return final, left


def _with_ordinary(
    search: Search[Fitted], shared: Trajectories, null: Fitted, effects: Sequence[str], path: Sequence[str]
) -> tuple[Fitted, list[EffectFinding]]:
    """The null with what every rotor has, where a fit gains by that at all, and more than by any of the control path.

    path : effects of the control path that may be missing.
    """
    if not effects:
        return null, []
    screened = screen(null, [*effects, *path])
    spec = null.spec.with_effects(*effects)
    richer = refit(spec, shared.flights, {**null.values, **screened.sizes(effects)}, shared.held, near=null)
    gained = likelihood_gain(null, richer)
    search.say(f"structure: {' and '.join(effects)}, log-likelihood gain {gained:.3g} per sample")
    if gained <= 0.0:
        return null, [finding(e, Row(fitted=False)) for e in effects]
    by_path = max((float(screened.evidence(e).sum()) for e in path), default=0.0)
    if by_path > max(total(null.log_ratios(richer)), 0.0):
        search.say(f"structure: waits, for {WAITS}, {by_path:.3g}")
        return null, [finding(e, Row(significant=False), WAITS) for e in effects]
    said = WANTED if exceeds(null.unseen_log_ratios(richer)) else ORDINARY
    return richer, [replace(finding(e, Row(), said), values=_sizes(richer, e)) for e in effects]


def _over_short(search: Search[Fitted], shared: Trajectories, null: Fitted) -> Fitted:
    """The null, or what a fit over short segments first makes of it where that ends better.

    Not where flights that no fit has seen are described worse: derivatives that are no vehicle's may imitate what a
    model lacks in the fitted flights.
    """
    again = fits([Wanted(null.spec, null.values, null, short_first=True)], shared.held, CAREFUL, shared.ranks)[0]
    unseen = null.unseen_log_ratios(again)
    gained = likelihood_gain(null, again)
    if gained <= 0.0 or not bool(unseen.isfinite().all()) or float(unseen.mean()) < 0.0:
        return null
    search.say(f"the model without candidates gains {gained:.3g} per sample over short segments first")
    return again


def _sizes(fitted: Fitted, effect: str) -> Mapping[str, tuple[float, float]]:
    """Sizes of an effect with standard errors, which take as long as a fit: computed where they are asked for."""
    names = [p.name for p in fitted.model.parameter_set.sizes(effect) if p.name in fitted.names]
    return OnDemand(names, lambda name: errors_of(fitted, effect)[name])
