"""What is said of each effect that was tested, from the search that tested it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic

from rotorid_torch.effects.registry import registered
from rotorid_torch.trace.evidence.family import effect_of
from rotorid_torch.trace.evidence.fits import FittedT
from rotorid_torch.trace.search.decide import Reason, Row, decide, errors_of
from rotorid_torch.trace.search.forward_selection import Search
from rotorid_torch.trace.search.words import explained_by, reason, size_details
from rotorid_torch.trace.terms.candidate import Candidate
from rotorid_torch.trace.terms.finding import EffectFinding
from rotorid_torch.trace.terms.settings import SETTINGS


@dataclass(frozen=True, eq=False)
class Outcome(Generic[FittedT]):
    """How a search ended.

    final : the model with what joined. share : of what is missing that the names explain; None where nothing without a
    name is significant. by_control : words on how controls differ, by effect. spread : standard errors of parameters by
    their scatter over flights, controls and draws.
    """

    search: Search[FittedT]
    final: FittedT
    share: float | None
    by_control: Mapping[str, str]
    spread: Mapping[str, float]

    @property
    def adequate(self) -> bool:
        """Whether the names explain enough of what is missing."""
        return self.share is None or self.share >= SETTINGS.adequate

    def findings(self, effects: Sequence[str]) -> list[EffectFinding]:
        """One for each of these effects."""
        return [self._finding(effect) for effect in effects]

    def _finding(self, effect: str) -> EffectFinding:
        assert self.search.first is not None
        observed, p, draws = self.search.tested.get(effect, self.search.first)
        members = [name for name in p if effect_of(name) == effect]
        finding = EffectFinding(effect, "undeclared", "below floor", "")
        if members:
            best, critical = min(members, key=lambda name: p[name]), draws.critical_values(observed.statistics)
            target = max(draws.visible(effect, critical[effect]), 0.0) if effect in critical else 0.0
            visible = observed.common.visible(effect, target)
            observable = observed.common.expected(effect) >= target
            finding = replace(
                finding, p=p[best], gain=observed.statistics[best], floor=critical[best], smallest_visible=visible
            )
            row = self._row(effect)
            tried = any(c.effect == effect for c in self.search.trials)  # significant beside what joined before
            significant = row.significant if tried else p[best] <= SETTINGS.level
            row = replace(row, significant=significant, observable=observable)
        else:
            row = self._row(effect)
        return self._told(finding, row)

    def _joined(self, effect: str) -> Candidate | None:
        return next((c for c in self.search.joined if c.effect == effect), None)

    def _row(self, effect: str) -> Row:
        """What was observed of an effect."""
        trials = [t for c, t in self.search.trials.items() if c.effect == effect]
        joined = self._joined(effect)
        if joined is not None:
            rivals = self.search.rivals.get(effect, ())
            return replace(self.search.trials[joined].row, alone=not rivals, adequate=self.adequate)
        if any(effect in others for others in self.search.rivals.values()):
            return Row(alone=False)
        refused = [t.row for t in trials if not t.stands]
        return refused[-1] if refused else Row(still=False, in_set=False)

    def _told(self, finding: EffectFinding, row: Row) -> EffectFinding:
        """The finding with verdict, reason and values."""
        effect, (verdict, why) = finding.id, decide(row)
        drawn = self.search.drawn_scatter(effect)
        joined, names = self._joined(effect), [c.effect for c in self.search.joined]
        trial = next((t for c, t in reversed(self.search.trials.items()) if c.effect == effect), None)
        details: dict[str, object] = {"explained_by": explained_by(names)}
        if trial is not None:
            details |= size_details(trial.null, trial.fitted, effect, drawn)
        if joined is not None:
            group = self.search.rivals.get(effect, ())
            details |= {"others": ", ".join(group), "share": 100.0 * max(self.share or 0.0, 0.0)}
            said = reason(why, **details) + self.by_control.get(effect, "")
            values = errors_of(self.final, effect, self.spread)
            return replace(finding, verdict=verdict, reason=said, group=group, values=values)
        best = next((e for e, others in self.search.rivals.items() if effect in others), None)
        if best is not None and verdict == "indistinguishable":
            group = (best, *(e for e in self.search.rivals[best] if e != effect))
            said = reason(Reason.OTHER_NAMED, others=best)
            return replace(finding, verdict=verdict, reason=said, group=group)
        if why is Reason.ABSORBED:
            assert self.search.first is not None
            absorbed = self.search.first[0].common.imitators(effect)
            by = f"{', '.join(absorbed)} take its place" if absorbed else "it hardly moves what was measured"
            said = reason(why, imitators=by, flights=registered()[effect].separated_by)
            return replace(finding, verdict=verdict, reason=said, group=absorbed)
        values = {} if trial is None else errors_of(trial.fitted, effect, trial.fitted.scatter(effect), drawn)
        return replace(finding, verdict=verdict, reason=reason(why, **details), values=values)
