"""Whether effects that somebody asked for earn their place in an identified model, each beside the others.

The evidence is the closed loop's: gain over chance, sizes that are physics, flights that no fit has seen, free runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from rotorid_torch.effects.base import Role
from rotorid_torch.effects.registry import registered
from rotorid_torch.trace.candidates import ELSEWHERE, NOT_IN_TRAJECTORIES
from rotorid_torch.trace.decide import (
    errors,
    gain,
    not_joined,
    objection,
    smallest_visible,
    unseen_gain,
)
from rotorid_torch.trace.finding import Finding
from rotorid_torch.trace.fits import Fitted, refit
from rotorid_torch.trace.floor import Floors
from rotorid_torch.trace.screening_sizes import with_screening_sizes
from rotorid_torch.trace.search import Search
from rotorid_torch.trace.significance import helps


def earned(whole: Fitted, effects: Sequence[str], held: Sequence[str] = (), seed: int = 0) -> list[Finding]:
    """A finding for each of these effects of a model.

    whole : the model with all of them, as identified. held : parameters that keep their values. seed : of the residuals
    turned in time that say what chance explains.
    """
    spec, flights = whole.spec, whole.flights
    shown = [e for e in effects if registered()[e].showing not in ELSEWHERE]
    bare = spec.without(shown)
    sized, tested, unmoved = with_screening_sizes(bare, whole.values, flights.dataset, shown)
    findings = {f.id: f for f in unmoved}
    for e in effects:
        if e not in shown:
            findings[e] = Finding(e, registered()[e].role.value, "not testable", NOT_IN_TRAJECTORIES)
    if tested:
        search = Search(flights, tuple(held), Floors({}, ""), lambda line: None, seed)
        richer = msgspec.structs.replace(spec, screening_sizes=sized.screening_sizes)
        whole = search.settled(refit(richer, flights, whole.values, held), 0.0)
        findings |= {e: _finding(search, whole, e) for e in tested}
    return [findings[e] for e in effects]


def _finding(search: Search, whole: Fitted, effect: str) -> Finding:
    """What a model without the effect, fitted with the same care, says of it."""
    role = registered()[effect].role
    near = refit(whole.spec.without([effect]), search.flights, whole.values, search.held, near=whole)
    null = search.settled(near, 0.0)
    gained, better = gain(null, whole), unseen_gain(null, whole)
    counted = f"{int((better > 0).sum())} of {len(better)} better"
    sizes = errors(whole, effect, whole.scatter(effect))
    said = f"flights that no fit has seen are better described with it ({counted})"
    if role is Role.LEARNT:  # a network has no size of its own
        why = None if helps(better) else f"it does not help on flights that no fit has seen ({counted})"
        return Finding(effect, role.value, "rejected" if why else "accepted", why or said, gained)
    screened = search.screened(null, [effect])
    floor = Floors.chance(screened, [effect])[effect]
    numbers = {"gain": gained, "floor": floor, "smallest_visible": smallest_visible(screened, effect, floor)}
    if gained <= floor:
        absorbed = not_joined(screened, effect, floor, (), hot=False)
        if absorbed.verdict == "indistinguishable":
            return replace(absorbed, gain=gained, values=sizes)
        return Finding(effect, role.value, "below floor", "it explains no more than by chance", **numbers, values=sizes)
    why = objection(null, whole, effect, floor, whole.scatter(effect))
    return Finding(effect, role.value, "rejected" if why else "accepted", why or said, **numbers, values=sizes)
