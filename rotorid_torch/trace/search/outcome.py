"""How a search ended: what the names explain, what stays without a name, and how far sizes scatter."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

from rotorid_torch.trace.evidence.critical_values import Draws, adjusted_p
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.fits import Fitted, total
from rotorid_torch.trace.evidence.screen import PATH
from rotorid_torch.trace.evidence.slips import deflected
from rotorid_torch.trace.evidence.unattributed import Shape
from rotorid_torch.trace.search.by_control import by_control
from rotorid_torch.trace.search.findings import Outcome
from rotorid_torch.trace.search.forward_selection import Search
from rotorid_torch.trace.search.localisation import in_control_path, localised
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED
from rotorid_torch.trace.terms.finding import Unknown
from rotorid_torch.trace.terms.settings import SETTINGS

IN_PATH = f"{UNATTRIBUTED}{PATH}"
"""Whatever filter lies between recorded controls and rotor; asked beside names of the control path alone."""
UNJUDGED = "No clean aircraft tells how much of this is ordinary."
UNCONFIRMED = "No flight was kept back that could confirm it."


def how_it_ended(
    search: Search[Fitted], held: Sequence[str], final: Fitted, effects: Sequence[str]
) -> tuple[Outcome[Fitted], Unknown | None]:
    """How the search ended, and what stays without a name."""
    names = [c.effect for c in search.joined]
    observed, p, _ = search.beside(final, effects)
    assert search.first is not None
    first, _, draws = search.first
    low = [n for n, one in p.items() if n.startswith(UNATTRIBUTED) and one <= SETTINGS.level]
    curves = _extreme_curves(observed, draws) if names and draws.clean else []
    shares, of_motion = list[float](), None
    if names and draws.clean and low:
        explained = total((search.null or first.null).log_ratios(final))
        of_motion = explained / max(explained + observed.nameless(low), 1e-300)
        shares = [of_motion, *([_share(first, observed, [IN_PATH], draws)] if IN_PATH in low else [])]
    if curves:
        shares.append(_share(first, observed, {*curves, *_extreme_curves(first, draws)}, draws))
    outcome = Outcome(search, final, min(shares, default=None), *_spread(search, held, final))
    next_to_nothing = of_motion is not None and of_motion > 1.0 - SETTINGS.level
    unknown = None
    if (low and not next_to_nothing) or not outcome.adequate:
        unknown = _nameless(observed, low or curves, draws)
    return outcome, unknown


def _extreme_curves(observed: Family[Fitted], draws: Draws) -> list[str]:
    """Members that are curves and products of signals, by equation, with p at most the level among their kind."""
    curves = [n for n in draws.statistics if n.startswith(UNATTRIBUTED) and n.endswith(Shape.CURVE.value)]
    p = adjusted_p(
        {n: observed.statistics[n] for n in curves if n in observed.statistics}, draws.statistics, draws.least
    )
    return [n for n, one in p.items() if one <= SETTINGS.level]


def _share(before: Family[Fitted], after: Family[Fitted], members: Collection[str], draws: Draws) -> float:
    """Share that names explain of members without a name that are extreme beside a null, or beside the names.

    With T_k the statistic of a member and m_k its mean size over the draws, the share is
    1 - max_k(T_k / m_k beside the names) / max_k(T_k / m_k beside the null).
    """
    usual = {n: float(draws.statistics[n].abs().mean()) + 1e-300 for n in members}
    first, last = (max(one.statistics.get(n, 0.0) / size for n, size in usual.items()) for one in (before, after))
    return 1.0 - last / max(first, 1e-300)


def _nameless(observed: Family[Fitted], members: Sequence[str], draws: Draws) -> Unknown:
    """Where these members say that something acts."""
    described = [observed.descriptions.get(n.removeprefix(UNATTRIBUTED)) for n in members]
    sentences, flights = [one for one in described if one is not None], observed.null.flights
    unknown = in_control_path(flights)
    if sentences and observed.residuals is not None:
        unknown = localised(sentences, observed.residuals, deflected(observed.null.model))
    doubts = [*([] if draws.clean else [UNJUDGED]), *([] if flights.dataset.validate else [UNCONFIRMED])]
    return replace(unknown, sentence=" ".join([unknown.sentence, *doubts]), judged=draws.clean)


def _spread(search: Search[Fitted], held: Sequence[str], final: Fitted) -> tuple[dict[str, str], dict[str, float]]:
    """Words on how controls differ, and standard errors by the scatter of sizes over flights, controls and draws."""
    words, spread = dict[str, str](), search.spread(final)
    for effect in (c.effect for c in search.joined):
        sizes = by_control(final, effect, held)
        if sizes is not None:
            errors = [e for e in (final.error(sizes.parameter), spread.get(sizes.parameter, 0.0)) if math.isfinite(e)]
            spread[sizes.parameter] = math.hypot(max(errors, default=0.0), sizes.spread)
            words[effect] = f"; {sizes}"
            search.say(f"{effect}: {sizes}")
    return words, spread
