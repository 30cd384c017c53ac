"""The search for what a model lacks: forward selection while p is below the level, then back, and so on by turns.

Each round: evidence of the whole family beside the model, p by flights with nothing missing, full fits of the
candidates whose p is below the level. Of those that stand the one that explains most joins; those that flights cannot
tell from it are its rivals. What explains nothing more beside the others leaves, and the rest of the family is asked
again, so that the names do not depend on the order in which they joined (stepwise regression; Efroymson 1960).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic

from rotorid_torch.trace.evidence.critical_values import Draws, Joined, Null
from rotorid_torch.trace.evidence.family import Family, Scored
from rotorid_torch.trace.evidence.fits import FittedT
from rotorid_torch.trace.search.decide import (
    NO_SCATTER,
    Interval,
    Row,
    decide,
    errors_of,
    improves,
    likelihood_gain,
    size_of,
)
from rotorid_torch.trace.terms.candidate import UNATTRIBUTED, Candidate, effect_of, of_control_path
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.trace.terms.significance import exceeds

Say = Callable[[str], None]
DrawClean = Callable[[Null, Sequence[str], Family[Any]], Draws | str]
"""Statistics of effects on clean aircraft for a null and the data's family; or, in words, why none can be drawn."""
STILL = "they fly in still air, far from the ground: what stays without a name is not compared with them"


@dataclass(frozen=True, eq=False)
class Comparison(Generic[FittedT]):
    """A family beside a model, the p of its members, and the draws that p comes from."""

    family: Family[FittedT]
    p: Mapping[str, float]
    draws: Draws

    @classmethod
    def by(cls, family: Family[FittedT], draws: Draws) -> Comparison[FittedT]:
        """With the p by these draws."""
        return cls(family, draws.p_values(family.contest), draws)

    def of(self, effect: str) -> dict[str, float]:
        """Those p that are an effect's."""
        return {name: p for name, p in self.p.items() if effect_of(name) == effect}

    @property
    def significant(self) -> set[str]:
        """Effects of which any p is no more than the level."""
        return {effect_of(name) for name, p in self.p.items() if p <= SETTINGS.level}


@dataclass(frozen=True, eq=False)
class Trial(Generic[FittedT]):
    """A candidate that was fitted in full: beside which null, and what was observed of it."""

    candidate: Candidate
    null: FittedT
    fitted: FittedT
    row: Row

    @property
    def stands(self) -> bool:
        """Whether nothing speaks against it."""
        return decide(self.row)[0] == "accepted"

    def __str__(self) -> str:
        """What it gained, and why it stands or not."""
        gained = likelihood_gain(self.null, self.fitted)
        why = decide(self.row)[1].name.lower()
        return f"{self.candidate.name}: log-likelihood gain {gained:.3g} per sample: {why}"


@dataclass
class Search(Generic[FittedT]):
    """What a search goes by, and what it has come upon.

    scored : the residual that candidates are scored by. draw : of clean aircraft; without, critical values come from
    residuals by chance. say : told what happens, a line at a time. seed : of residuals by chance, turned in time or
    (multirotors) shuffled by blocks.
    first : the family beside the null, its p by member, and the draws. null : without candidates, as it ends once the
    first of them are fitted. trials : the last of each candidate. tested : the family in which an effect was
    significant when its last trial was made. joined : in their order. rivals : of each, those that flights cannot tell
    from it. scatter : standard errors of parameters by what trims of flights say. last : the family beside the model
    that was asked last. left : effects that joined and went again.
    """

    scored: Scored[FittedT]
    draw: DrawClean = lambda null, effects, observed: ""
    say: Say = lambda line: None
    seed: int = 0
    first: Comparison[FittedT] | None = None
    null: FittedT | None = None
    trials: dict[Candidate, Trial[FittedT]] = field(default_factory=dict)
    tested: dict[str, Comparison[FittedT]] = field(default_factory=dict)
    joined: list[Candidate] = field(default_factory=list)
    rivals: dict[str, tuple[str, ...]] = field(default_factory=dict)
    scatter: dict[str, float] = field(default_factory=dict)
    last: Comparison[FittedT] | None = None
    left: set[str] = field(default_factory=set)

    @property
    def tests(self) -> int:
        """Effects that are tested."""
        return 1 if self.first is None else max(len({c.effect for c in self.first.family.candidates}), 1)

    @property
    def notes(self) -> tuple[str, ...]:
        """Where the critical values come from, and those of effects that were tested against other draws."""
        if self.first is None:
            return ()
        usual = self.first.draws.note
        others = {effect: tested.draws.note for effect, tested in self.tested.items()}
        return (usual, *(f"of {effect} {note}" for effect, note in others.items() if note != usual))

    def selected(self, null: FittedT, effects: Sequence[str]) -> FittedT:
        """The null with the effects that explain something beside each other; what leaves makes room for others."""
        final, left = self.back(self.forward(null, effects), effects), 0
        while len(self.left) > left:
            left, before = len(self.left), [*self.joined]
            more = self.forward(final, effects)
            final = self.back(more, effects) if self.joined != before else final
        return final

    def forward(self, null: FittedT, effects: Sequence[str]) -> FittedT:
        """The null with the effects that join it, one after the other, until none stands."""
        while True:
            tested = self.family_beside(null, effects)
            self._settle_rivals(tested.significant)
            promising = self._promising(tested)
            if not promising:
                return null
            null, best = self._joining(self.scored.settled(null), tested, promising)
            if best is None:
                return null
            for brought in map(Candidate, best.candidate.brings(null.spec)):
                self.trials[brought], self.tested[brought.effect] = replace(best, candidate=brought), tested
                self._joins(brought)
            null = best.fitted
            self._joins(best.candidate)

    def _joining(
        self, null: FittedT, tested: Comparison[FittedT], promising: Sequence[Candidate]
    ) -> tuple[FittedT, Trial[FittedT] | None]:
        """The null, from the best start that fits of candidates came upon, and the candidate that joins, if any stands.

        Those of largest evidence are fitted first; others where none of these stands.
        """
        for first in range(0, len(promising), SETTINGS.fits):
            batch = promising[first : first + SETTINGS.fits]
            fitted = self.scored.candidates(null, tested.family, batch)
            null = self.improved(null, fitted)
            self.null = self.null or null
            self.tested |= {c.effect: tested for c in batch}
            best = self._best(null, fitted)
            if best is not None:
                return null, best
        return null, None

    def _joins(self, candidate: Candidate) -> None:
        """What joins is a rival no more."""
        self.joined.append(candidate)
        self.rivals = {e: tuple(one for one in others if one != candidate.effect) for e, others in self.rivals.items()}

    def family_beside(self, model: FittedT, effects: Sequence[str]) -> Comparison[FittedT]:
        """The family beside a model with the effects that joined, and the p of its members; made once for a model."""
        named = tuple(c.effect for c in self.joined)
        if self.last is None or self.last.family.null is not model or self.last.family.accepted != named:
            others = [e for e in effects if e not in named]
            self.scored.fit_ahead(model, others, named)
            asked = self.scored.family(model, others, named)
            self.last = self.tested_beside(asked, effects)
        return self.last

    def tested_beside(self, observed: Family[FittedT], effects: Sequence[str]) -> Comparison[FittedT]:
        """Adjusted p of each member: against clean aircraft, drawn once, or the model's own turned residuals.

        Effects of the control path stand for each other about a model that lacks one of them: a long delay looks like a
        lag on a straight line. So where one of them is significant, all are fitted in full.
        """
        drawn = None if self.first is None or not self.first.draws.clean else self.first.draws
        drawn = drawn or self._drawn(observed, effects)
        tested = Comparison.by(observed, drawn)
        path = of_control_path(dict.fromkeys(c.effect for c in observed.candidates))
        if tested.significant & {*path}:
            tested = Comparison.by(self.scored.in_full(observed, [Candidate(e) for e in path]), drawn)
        self.first = self.first or tested
        return tested

    def _drawn(self, observed: Family[FittedT], effects: Sequence[str]) -> Draws:
        """Statistics where nothing is missing, of clean aircraft where these can be drawn.

        Clean aircraft fly in still air far from the ground; what wind or ground, which joined before any draw, leave
        over these cannot say.
        """
        null, placed = observed.null, [c.effect for c in self.joined]
        if self.first is not None:  # where none could be drawn there are none beside what joined either
            return self.scored.draws_by_chance(observed, effects, self.seed, self.first.draws.note)
        bare = Null(null.spec.without(placed), null.values, self.scored.held, null.flights.weather)
        drawn = self.draw(bare, effects, observed)
        if isinstance(drawn, str):
            note = f"{self.scored.by_chance}: {drawn}" if drawn else ""
            return self.scored.draws_by_chance(observed, effects, self.seed, note)
        if not placed:
            return drawn
        library = {n: t for n, t in drawn.statistics.items() if not n.startswith(UNATTRIBUTED)}
        return replace(drawn, statistics=library, note=f"{drawn.note}; {STILL}")

    def _promising(self, tested: Comparison[FittedT]) -> list[Candidate]:
        """Candidates whose p is below the level, those of largest evidence first.

        Of an effect with a size of each control only where flights, held out, are better predicted than with one size.
        """
        observed, low = tested.family, tested.significant - self.left
        each = {c.effect for c in observed.candidates if c.each_control and exceeds(observed.over_one_size(c.effect))}
        chosen = [c for c in observed.candidates if c.effect in low and c.each_control == (c.effect in each)]
        return sorted(chosen, key=lambda c: -observed.statistics[c.name])

    def improved(self, null: FittedT, fitted: Mapping[Candidate, FittedT]) -> FittedT:
        """The null fitted again from where the best candidate ended: what it gains so is not the candidate's."""
        best = max(fitted.values(), key=lambda one: likelihood_gain(null, one))
        again = self.scored.refitted(null.spec, best)
        gained = likelihood_gain(null, again)
        if gained <= 0.0:
            return null
        self.say(f"the model without candidates gains {gained:.3g} per sample from a better start")
        return again

    def _best(self, null: FittedT, fitted: Mapping[Candidate, FittedT]) -> Trial[FittedT] | None:
        """The trial of the candidate that joins, its rivals noted; one that brings another where none alone stands."""
        rows = self.scored.ranks.share(
            list(fitted), lambda c: row_of(null, fitted[c], c, self.tests, self.drawn_errors(c.effect, fitted[c]))
        )
        trials = dict(zip(fitted, rows, strict=True))
        for c, row in trials.items():
            self.trials[c] = Trial(c, null, fitted[c], row)
            self.say(f"{self.trials[c]}")
        standing = [self.trials[c] for c in trials if self.trials[c].stands]
        if not standing:
            return None
        alone = [t for t in standing if not t.candidate.brings(null.spec)]
        best = max(alone or standing, key=lambda one: likelihood_gain(null, one.fitted))
        near = [t for t in alone if t is not best and not exceeds(t.fitted.log_ratios(best.fitted))]
        self.rivals[best.candidate.effect] = tuple(t.candidate.effect for t in near)
        said = f", not to be told from {', '.join(t.candidate.name for t in near)}" if near else ""
        self.say(f"{best.candidate.name} joins{said}")
        return best

    def _settle_rivals(self, significant: Collection[str]) -> None:
        """Rivals of what joined last that explain something beside it are causes of their own, and no rivals."""
        if self.joined:
            last = self.joined[-1].effect
            self.rivals[last] = tuple(e for e in self.rivals.get(last, ()) if e not in significant)

    def settle_groups(self, final: FittedT) -> None:
        """Asks rivals again beside all that joined: where only the effect fits the others, its rival is none."""
        for c in self.joined if len(self.joined) > 1 else ():
            near = [Candidate(e) for e in self.rivals.get(c.effect, ())]
            if near and self.first is not None:
                without = self.scored.refitted(final.spec.without([c.effect]), final)
                fitted = self.scored.candidates(without, self.first.family, near)
                stay = [r.effect for r in near if not exceeds(fitted[r].log_ratios(final))]
                self.rivals[c.effect] = tuple(stay)
                self.say(f"{c.name} beside all others: not to be told from {', '.join(stay) or 'any'}")

    def drawn_errors(self, effect: str, fitted: FittedT) -> Mapping[str, float]:
        """Standard errors of an effect's sizes in a fit by what they seem to be on clean aircraft."""
        if self.first is None:
            return NO_SCATTER
        sizes = fitted.model.parameter_set.sizes(effect)
        return self.first.draws.errors({p.name: fitted.values[p.name] - p.value for p in sizes})

    def spread(self, final: FittedT) -> dict[str, float]:
        """Standard errors of the named effects' parameters, or scatter over trims, flights and draws where larger."""
        spread = dict(self.scatter)
        for effect in (c.effect for c in self.joined):
            errors = errors_of(final, effect, self.scatter, self.drawn_errors(effect, final))
            spread |= {name: error for name, (_, error) in errors.items() if math.isfinite(error)}
        return spread

    def back(self, final: FittedT, effects: Sequence[str]) -> FittedT:
        """The final model without the effects that explain nothing more beside the others, by the same test.

        The one that explains least goes first, and the others are asked again. Where all pass, the one that explains
        least is tested once more, against aircraft that have the others: what a model leaves over of an effect is in no
        other draw.

        effects : all that are tested, the family of which an effect is one.
        """
        while self.joined:
            trials = {c: self._left_out(c, final, effects) for c in self.joined}
            failing = [c for c, trial in trials.items() if not trial.stands]
            if not failing:
                least = min(self.joined, key=lambda c: likelihood_gain(trials[c].null, final))
                trials[least] = self._against_others(trials[least], effects)
                if trials[least].stands:
                    break
                failing = [least]
            # what the least leaves may be what others need
            c = min(failing, key=lambda c: likelihood_gain(trials[c].null, final))
            before, after = self.joined[: self.joined.index(c) + 1], self.joined[self.joined.index(c) + 1 :]
            if after and likelihood_gain(self.trials[c].fitted, trials[c].null) <= 0.0:
                # those behind it take its place, and explain less than it did without them
                final, going = self._as_joined(c, before, effects), after
                self.joined = before
            else:
                final, going = trials[c].null, [c]
                self.joined.remove(c)
            for one in going:
                row = replace(trials[one].row, still=False, in_set=False) if one is not c else trials[c].row
                self.say(f"{one.name}: {decide(row)[1].name.lower()} in the end")
                self.trials[one] = replace(trials[one], row=row)
                self.left.add(one.effect)
                self.rivals.pop(one.effect, None)
        return final

    def _as_joined(self, candidate: Candidate, joined: Sequence[Candidate], effects: Sequence[str]) -> FittedT:
        """The model as a candidate joined it, without what stood before it and has left since."""
        fitted, stay = self.trials[candidate].fitted, {c.effect for c in joined}
        left = [e for e in fitted.spec.effects if e in effects and e not in stay]
        return self.scored.refitted(fitted.spec.without(left), fitted) if left else fitted

    def _left_out(self, candidate: Candidate, final: FittedT, effects: Sequence[str]) -> Trial[FittedT]:
        """A candidate that joined, tried again beside the others that did."""
        assert self.first is not None
        size = size_of(final, candidate.effect, self.tests, self.drawn_errors(candidate.effect, final))
        row = replace(self.trials[candidate].row, estimate=size.estimate)
        untested = len(self.joined) == 1 or candidate.effect not in self.first.draws.statistics
        if untested and row.estimate is Interval.SIZE:
            return Trial(candidate, self.trials[candidate].null, final, row)
        without = self.scored.refitted(final.spec.without([candidate.effect]), final)
        if untested:
            return Trial(candidate, without, final, row)
        named, others = self._others(candidate, effects)
        tested = self.tested_beside(self.scored.family(without, others, named), others)
        return Trial(candidate, without, final, _retested(row, candidate, tested))

    def _others(self, candidate: Candidate, effects: Sequence[str]) -> tuple[list[str], list[str]]:
        """Other effects that joined; and all tested ones but these, among them the candidate's."""
        named = [c.effect for c in self.joined if c is not candidate]
        return named, [e for e in effects if e not in named]

    def _against_others(self, trial: Trial[FittedT], effects: Sequence[str]) -> Trial[FittedT]:
        """A trial beside all others that joined, against aircraft that have these, where such can be drawn.

        Sizes count in two digits, so that draws serve all that are near.
        """
        effect = trial.candidate.effect
        named, others = self._others(trial.candidate, effects)
        if not named or not self.scored.drawn_with_effects:
            return trial
        null = trial.null
        sizes = {n: float(f"{size:.1e}") for n, size in of_effects(null.values, named).items()}
        joined = Joined(tuple(named), effect)
        observed = self.scored.family(null, others, named)
        drawn = self.draw(
            Null(null.spec, {**null.values, **sizes}, self.scored.held, null.flights.weather, joined), others, observed
        )
        if isinstance(drawn, str):
            earlier = self.tested[effect]
            note = f"{earlier.draws.note}, and none with {' and '.join(named)}: {drawn}"
            self.tested[effect] = replace(earlier, draws=replace(earlier.draws, note=note))
            return trial
        self.tested[effect] = tested = Comparison.by(observed, drawn)
        return replace(trial, row=_retested(trial.row, trial.candidate, tested))


def _retested(row: Row, candidate: Candidate, tested: Comparison[FittedT]) -> Row:
    """What was observed of a candidate that joined, with whether it is significant in another test."""
    low = candidate.effect in tested.significant
    return replace(row, still=low, in_set=low)


def row_of(
    null: FittedT, fitted: FittedT, candidate: Candidate, tests: int = 1, drawn: Mapping[str, float] = NO_SCATTER
) -> Row:
    """What a full fit says of a candidate, one of so many effects that are tested.

    drawn : errors of sizes on clean aircraft, by full name.
    """
    return Row(
        fitted=likelihood_gain(null, fitted) > 0.0,
        estimate=size_of(fitted, candidate.effect, tests, drawn).estimate,
        unseen_better=improves(null.unseen_log_ratios(fitted)),
    )


def of_effects(values: Mapping[str, float], effects: Collection[str]) -> dict[str, float]:
    """The parameters of these effects alone."""
    return {n: v for n, v in values.items() if any(n.startswith(f"{e}.") for e in effects)}
