"""Candidates scored by trajectories over segments: fits from several starts, gone on with until they have converged."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.evidence.family import TURNED, Family, Scored, family
from rotorid_torch.trace.evidence.fits import BEGINNING, CAREFUL, Fitted, refit, total
from rotorid_torch.trace.evidence.force_evidence import derivatives_beside, seen_in_forces
from rotorid_torch.trace.evidence.parallel_fits import Wanted, fits
from rotorid_torch.trace.search.decide import likelihood_gain
from rotorid_torch.trace.terms.candidate import Candidate

LONGEST = 4
"""Times that a fit may go on, at most."""


class Trajectories(Scored[Fitted]):
    """Fits to trajectories over segments."""

    by_chance = TURNED

    def family(
        self, null: Fitted, effects: Sequence[str], accepted: Sequence[str] = (), turned: int = 0, seed: int = 0
    ) -> Family[Fitted]:
        """The family of these effects beside a fitted model.

        A straight line about a model that has not converged tells nothing of what is not proportional to its size: play
        or a rate limit leads the fit without them astray. Their evidence is that of fits in full.
        """
        asked = family(null, effects, accepted, turned, seed)
        bent = [c for c in asked.candidates if not (c.each_control or registered()[c.effect].proportional)]
        return asked if turned or null.fit.minimum.converged else self.in_full(asked, bent)

    def in_full(self, observed: Family[Fitted], candidates: Sequence[Candidate]) -> Family[Fitted]:
        """The family with the evidence of these candidates from fits in full.

        The model without them starts once more from the best of these fits: what that gains is none of theirs.
        """
        null, more = observed.null, [c for c in candidates if c not in observed.fitted]
        if not more:
            return observed
        fitted = {**observed.fitted, **self.candidates(null, observed, more)}
        best = min(fitted.values(), key=lambda one: one.cost)
        without = min(null, self.refitted(null.spec, best), key=lambda one: one.cost)
        statistics = {c.name: total(without.log_ratios(one)) for c, one in fitted.items()}
        return replace(observed, fitted=fitted, in_full=statistics)

    def refitted(self, spec: ModelSpec, near: Fitted) -> Fitted:
        """The model of a spec, fitted from where another fit ended."""
        return self.settled(refit(spec, self.flights, near.values, self.held, near=near))

    def candidates(
        self, null: Fitted, observed: Family[Fitted], candidates: Sequence[Candidate]
    ) -> dict[Candidate, Fitted]:
        """The null with one more effect, for each of these, fitted in full."""
        done = {c: observed.fitted[c] for c in candidates if c in observed.fitted}
        more = self.fitted(null, {c: self._starts(observed, c) for c in candidates if c not in done})
        return {c: done[c] if c in done else more[c] for c in candidates}

    def fitted(
        self, null: Fitted, starts: Mapping[Candidate, Sequence[Mapping[str, float]]]
    ) -> dict[Candidate, Fitted]:
        """The null with one more effect, for each of these, fitted in full: the best of several starts goes on.

        starts : sizes of the effect. What is not proportional to its size is far from a straight line, and derivatives
        of the null lead astray: it starts once more with derivatives of the measured motion.
        """
        wanted: list[tuple[Candidate, Wanted]] = []
        for c, sizes in starts.items():
            spec = c.joined_to(null.spec)
            values = [{**null.values, **size} for size in sizes]
            wanted += [(c, Wanted(spec, start, null)) for start in values]
            wanted.append((c, Wanted(spec, values[0], null, short_first=True)))
            if not registered()[c.effect].proportional:
                wanted += [(c, Wanted(spec, derivatives_beside(null, spec, size, self.held), null)) for size in sizes]
        begun: dict[Candidate, Fitted] = {}
        for (c, _), one in zip(wanted, fits([w for _, w in wanted], self.held, BEGINNING, self.ranks), strict=True):
            begun[c] = min(begun.get(c, one), one, key=lambda fitted: fitted.cost)
        return dict(zip(begun, self.longer([*begun.values()]), strict=True))

    @staticmethod
    def _starts(observed: Family[Fitted], candidate: Candidate) -> Sequence[Mapping[str, float]]:
        """Sizes by the screen, and those that the forces on the measured motion ask for."""
        starts, forces, alike = observed.screen.starts(candidate.name), observed.forces, Candidate(candidate.effect)
        if forces is not None and alike in forces.candidates:
            return [*starts, forces.shown(alike.name)]
        if not registered()[candidate.effect].proportional and observed.residuals is not None:
            forces = seen_in_forces(observed.null, observed.residuals.fitted, [candidate], whole=True)
            starts += [forces.shown(one.name) for one in forces.candidates]
        return starts

    def longer(self, fitted: Sequence[Fitted]) -> list[Fitted]:
        """Fits gone on with until they have converged, or gain no more."""
        now, going = [*fitted], [*range(len(fitted))]
        for _ in range(LONGEST):
            going = [k for k in going if not now[k].fit.minimum.converged]
            wanted = [Wanted(now[k].spec, now[k].values, now[k]) for k in going]
            more = dict(zip(going, fits(wanted, self.held, CAREFUL, self.ranks), strict=True))
            going = [k for k, one in more.items() if likelihood_gain(now[k], one) > 0.0]
            for k in going:
                now[k] = more[k]
        return now

    def settled(self, fitted: Fitted) -> Fitted:
        """One fit gone on with."""
        return self.longer([fitted])[0]
