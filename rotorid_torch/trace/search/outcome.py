"""How a search ended: what the names explain, what is said of each effect, what stays without a name."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic

from torch import Tensor

from rotorid_torch.effects.registry import registered
from rotorid_torch.trace.evidence.critical_values import Draws
from rotorid_torch.trace.evidence.family import Family
from rotorid_torch.trace.evidence.fits import Fitted, FittedT, total
from rotorid_torch.trace.evidence.screen import PATH
from rotorid_torch.trace.evidence.unattributed import Description, Shape
from rotorid_torch.trace.search.by_control import by_control
from rotorid_torch.trace.search.decide import Reason, Row, decide, errors_of
from rotorid_torch.trace.search.forward_selection import Search, Trial
from rotorid_torch.trace.search.localisation import deflected, in_control_path, localised
from rotorid_torch.trace.search.words import explained_by, finding, reason, size_details
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED, Candidate
from rotorid_torch.trace.terms.finding import EffectFinding, Unknown
from rotorid_torch.trace.terms.settings import SETTINGS

UNJUDGED = "No clean aircraft tells how much of this is ordinary."
UNCONFIRMED = "No flight was kept back that could confirm it."


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

    @property
    def accepted(self) -> tuple[str, ...]:
        """Ids of the effects that joined, where they explain enough."""
        return tuple(c.effect for c in self.search.joined) if self.adequate else ()

    def findings(self, effects: Sequence[str]) -> list[EffectFinding]:
        """One for each of these effects."""
        return [self._finding(effect) for effect in effects]

    def _finding(self, effect: str) -> EffectFinding:
        """What is said of an effect, with the evidence of the family in which it was tested."""
        assert self.search.first is not None
        tested = self.search.tested.get(effect, self.search.first)
        row, observed, draws, p = self._row(effect), tested.family, tested.draws, tested.of(effect)
        if not p:
            return self._said(effect, row)
        best, critical = min(p, key=lambda name: p[name]), draws.critical_values(observed.statistics)
        target = max(draws.visible(effect, critical[effect]), 0.0) if effect in critical else 0.0
        if self._trial(effect) is None:  # what was tried was significant beside what joined before
            row = replace(row, significant=p[best] <= SETTINGS.level)
        row = replace(row, observable=observed.screen.expected(effect) >= target)
        return replace(
            self._said(effect, row),
            p=p[best],
            statistic=observed.statistics[best],
            critical_value=critical[best],
            smallest_visible=observed.screen.visible(effect, target) if target > 0.0 else None,  # none of all sizes
        )

    def _trial(self, effect: str) -> Trial[FittedT] | None:
        """The last trial of an effect."""
        return next((t for c, t in reversed(self.search.trials.items()) if c.effect == effect), None)

    def _joined(self, effect: str) -> Candidate | None:
        return next((c for c in self.search.joined if c.effect == effect), None)

    def _best(self, effect: str) -> str | None:
        """The effect that joined of which this one is a rival."""
        return next((e for e, others in self.search.rivals.items() if effect in others), None)

    def _row(self, effect: str) -> Row:
        """What was observed of an effect."""
        joined = self._joined(effect)
        if joined is not None:
            rivals = self.search.rivals.get(effect, ())
            return replace(self.search.trials[joined].row, alone=not rivals, adequate=self.adequate)
        if self._best(effect) is not None:
            return Row(alone=False)
        rejected = [t.row for c, t in self.search.trials.items() if c.effect == effect and not t.stands]
        return rejected[-1] if rejected else Row(still=False, in_set=False)

    def _said(self, effect: str, row: Row) -> EffectFinding:
        """Verdict, reason and values of an effect of which this was observed."""
        rivals, best, trial = self.search.rivals, self._best(effect), self._trial(effect)
        drawn = {} if trial is None else self.search.drawn_errors(effect, trial.fitted)
        group, values, (verdict, why) = tuple[str, ...](), {}, decide(row)
        details: dict[str, object] = {"explained_by": explained_by([c.effect for c in self.search.joined])}
        if trial is not None:
            details |= size_details(trial.null, trial.fitted, effect, drawn)
        if self._joined(effect) is not None:
            group, values = rivals.get(effect, ()), errors_of(self.final, effect, self.spread)
            details |= {"others": ", ".join(group)}
            if self.share is not None:
                details |= {"share": 100.0 * max(self.share, 0.0)}
        elif best is not None and verdict == "indistinguishable":
            group, why = (best, *(e for e in rivals[best] if e != effect)), Reason.OTHER_NAMED
            details |= {"others": best}
        elif why is Reason.ABSORBED:
            assert self.search.first is not None
            group = self.search.first.family.screen.imitators(effect)
            by = f"{', '.join(group)} take its place" if group else "it hardly moves what was measured"
            details |= {"imitators": by, "flights": registered()[effect].separated_by}
        elif trial is not None:
            values = errors_of(trial.fitted, effect, drawn)
        said = reason(why, **details) + self.by_control.get(effect, "")
        return replace(finding(effect, row, said), group=group, values=values)


def how_it_ended(
    search: Search[FittedT], final: FittedT, effects: Sequence[str]
) -> tuple[Outcome[FittedT], Unknown | None]:
    """How the search ended, and what stays without a name."""
    names = [c.effect for c in search.joined]
    comparison = search.family_beside(final, effects)
    assert search.first is not None
    observed, first, draws = comparison.family, search.first.family, search.first.draws
    low = [n for n, one in comparison.p.items() if n.startswith(UNATTRIBUTED) and one <= SETTINGS.level]
    residuals = observed.residuals  # by which names of trajectories are judged; accelerations have judged their own
    by_accelerations = residuals is not None and not residuals.fitted.derivatives
    low = _beyond_chance(low, observed, search.seed) if by_accelerations else low
    shares = list[float]()
    if names and low and draws.clean and not by_accelerations:
        explained = total((search.null or first.null).log_ratios(final))
        of_motion = explained / max(explained + observed.nameless(low), 1e-300)
        if of_motion > 1.0 - SETTINGS.level:  # an imitation leaves more of its cause than next to nothing
            low = []
        else:
            before, after = first.evidence_without_name, observed.evidence_without_name
            kinds = [kind for kind in ([PATH], of_motion_alone(after)) if not {*kind}.isdisjoint(low)]
            shares = [of_motion, *(share_explained(before, after, kind, draws) for kind in kinds)]
    outcome = Outcome(search, final, min(shares, default=None), {}, search.spread(final))
    unknown = _nameless(observed, low, draws) if low else None
    return outcome, unknown


def _beyond_chance(members: Sequence[str], observed: Family[FittedT], seed: int) -> list[str]:
    """Members that show more than the residual itself turned in time: real vehicles leave more over than drawn ones."""
    assert observed.residuals is not None
    turned = observed.residuals.by_chance(SETTINGS.draws, seed)
    return [n for n in members if observed.statistics[n] > float(turned[n].max())]


def of_motion_alone(members: Iterable[str]) -> list[str]:
    """Curves, products and what begins at some time, among members without a name.

    What swings by itself (a load on a cable) is no curve over any signal. It follows the motion otherwise later in a
    flight than before, as what begins does. A step is an event beside whatever else acts.
    """
    kinds = tuple(f", {shape.value}" for shape in Shape if shape is not Shape.STEP)
    return [name for name in members if name.endswith(kinds)]


def share_explained(
    before: Mapping[str, Tensor], after: Mapping[str, Tensor], members: Collection[str], draws: Draws
) -> float:
    """Share that names explain of members without a name.

    With T_k the statistic of a member and m_k its mean size over the draws, the share is
    1 - max_k(T_k / m_k beside the names) / max_k(T_k / m_k beside the null).

    before, after : evidence of members beside the null and beside the names, by flight [F + V].
    """
    first, last = (
        max(float(one[n].sum()) / size if n in one else 0.0 for n, size in _usual(members, draws).items())
        for one in (before, after)
    )
    return 1.0 - last / max(first, 1e-300)


def _usual(members: Collection[str], draws: Draws) -> dict[str, float]:
    """Mean size of members' T where nothing is missing."""
    return {n: float(draws.statistics[n].abs().mean()) + 1e-300 for n in members if n in draws.statistics}


def _usual_by_row(descriptions: Mapping[str, Description], draws: Draws) -> dict[str, float]:
    """The largest mean T of an equation's kinds, which have one unit, where nothing is missing."""
    sizes = _usual(descriptions, draws)
    rows = {descriptions[n].row for n in sizes}
    return {row: max(size for n, size in sizes.items() if descriptions[n].row == row) for row in rows}


def _nameless(observed: Family[FittedT], members: Sequence[str], draws: Draws) -> Unknown:
    """Where these members say that something acts."""
    described = [observed.descriptions[n] for n in members if n in observed.descriptions]
    flights = observed.null.flights
    unknown = in_control_path(flights)
    if described and observed.residuals is not None:
        usual = {} if observed.residuals.fitted.derivatives else _usual_by_row(observed.descriptions, draws)
        unknown = localised(described, observed.residuals, deflected(observed.null.model), usual)
    doubts = [*([] if draws.clean else [UNJUDGED]), *([] if flights.dataset.validate else [UNCONFIRMED])]
    return replace(unknown, sentence=" ".join([unknown.sentence, *doubts]), judged=draws.clean)


def with_each_control(outcome: Outcome[Fitted], held: Sequence[str]) -> Outcome[Fitted]:
    """With words on how controls differ, and standard errors by the scatter of sizes over these too."""
    words, spread = dict[str, str](), dict(outcome.spread)
    for effect in (c.effect for c in outcome.search.joined):
        sizes = by_control(outcome.final, effect, held)
        if sizes is not None:
            spread[sizes.parameter] = math.hypot(spread.get(sizes.parameter, 0.0), sizes.spread)
            words[effect] = f"; {sizes}"
            outcome.search.say(f"{effect}: {sizes}")
    return replace(outcome, by_control=words, spread=spread)
