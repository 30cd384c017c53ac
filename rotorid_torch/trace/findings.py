"""What is said of each effect that was tested, from the search that tested it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from rotorid_torch.trace.decide import errors, not_joined, smallest_visible
from rotorid_torch.trace.finding import Finding
from rotorid_torch.trace.fits import Fitted, control_by_control
from rotorid_torch.trace.screen import Screen
from rotorid_torch.trace.search import Search


def findings(
    search: Search,
    final: Fitted,
    structure: Sequence[str],
    accepted: Sequence[str],
    undeclared: Sequence[str],
    first: Screen,
    floors: Mapping[str, float],
) -> list[Finding]:
    """One finding for each effect that was tested.

    final : the model with what was accepted. structure, accepted : what joined it. undeclared : what was tried.
    first : their screen before anything joined. floors : by effect.
    """
    found = [Finding(e, "structure", "accepted", search.why(e), values=errors(final, e, {})) for e in structure]
    found += search.ordinary.values()
    found += [_placed(search, final, effect, accepted) for effect in search.placed]
    last = search.screened(final, [e for e in undeclared if e not in accepted])
    left = dict.fromkeys(undeclared, last) | _each_control(search, final, accepted)
    tried = {**floors, **search.alone, **search.beside}
    joined = [e for e in accepted if e not in search.placed]
    grouped = {e: best for best, others in search.groups.items() if best in accepted for e in others}
    for effect in undeclared:
        gained, floor = search.gained.get(effect, (first.gain([effect]), floors[effect]))
        visible = smallest_visible(first, effect, floors[effect])
        seen = Finding(effect, "undeclared", "accepted", "", gained, floor, visible)
        if effect in accepted:
            found.append(_accepted(seen, search, final))
        elif effect in grouped:
            best = grouped[effect]
            group = (best, *(e for e in search.groups[best] if e != effect))
            said = f"these flights cannot tell it from {best}"
            found.append(replace(seen, verdict="indistinguishable", reason=said, group=group))
        elif effect in search.rejected and left[effect].gain([effect]) > tried[effect]:
            said, gained, values = search.rejected[effect]
            known = {"gain": gained, "floor": tried[effect], "values": values}
            found.append(replace(seen, verdict="rejected", reason=said, **known))
        else:
            least = search.beside.get(effect, floors[effect])
            found.append(not_joined(last, effect, least, joined, effect in search.hot))
    return found


def _placed(search: Search, final: Fitted, effect: str, accepted: Collection[str]) -> Finding:
    """Of an effect of where the vehicle flies, that explains what trims differ by."""
    gained, floor = search.placed[effect]
    if effect in accepted:
        said = "it explains how trims differ between flights, and flights that no fit has seen are better described"
        values = errors(final, effect, search.spread)
        return Finding(effect, "undeclared", "accepted", said, gained, floor, values=values)
    said, gained, values = search.rejected[effect]
    return Finding(effect, "undeclared", "rejected", said, gained, floor, values=values)


def _accepted(seen: Finding, search: Search, final: Fitted) -> Finding:
    """Of an effect that joined, alone or in the name of a group."""
    group, values = search.groups.get(seen.id, ()), errors(final, seen.id, search.spread)
    said = "no other effect explains it, and flights that no fit has seen are better described"
    if group:
        said = f"something of this kind acts, but these flights cannot tell it from {', '.join(group)}"
    verdict = "indistinguishable" if group else "accepted"
    return replace(seen, verdict=verdict, reason=said + search.apart.get(seen.id, ""), group=group, values=values)


def _each_control(search: Search, final: Fitted, accepted: Collection[str]) -> dict[str, Screen]:
    """The screen beside what joined of effects that were tried on each control by itself."""
    alone = [e for e in search.alone if e not in accepted]
    return dict.fromkeys(alone, search.screened(control_by_control(final, alone), alone)) if alone else {}
