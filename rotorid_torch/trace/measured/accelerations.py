"""Accelerations at measured states as what a search goes by: no free run of a multirotor means much."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

from rotorid_torch.core.processes.forks import forked_each
from rotorid_torch.effects.registry import registered
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.rotor_regression import curved
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.family import Family, Scored
from rotorid_torch.trace.measured.fitted import FittedAtStates
from rotorid_torch.trace.measured.measured_family import SHUFFLED, measured_family
from rotorid_torch.trace.terms.candidate import Candidate

Message = tuple[dict[str, Any], Tensor, dict[str, float], dict[str, Tensor]]
"""A fit as it travels between ranks: its spec, theta, errors, and theta without each flight."""


@dataclass(frozen=True, eq=False)
class MeasuredAccelerations(Scored[FittedAtStates]):
    """Fits to accelerations at measured states.

    A candidate that is not linear in all its parameters acts otherwise beside other values of what joined before: loss
    by climbing and lift by wind nearly cancel at the wind that suits a model without them. A line about that model
    shows nothing, so it is fitted in full first, and the way from the null to that fit is a signature too. So is one
    that acts through another effect, with that: their product bends the equations, and neither may show alone.
    """

    _ahead: dict[FittedAtStates, dict[Candidate, FittedAtStates]] = field(default_factory=dict, repr=False)

    by_chance, drawn_with_effects = SHUFFLED, True

    def fitted(self, spec: ModelSpec) -> FittedAtStates:
        """The model of a spec."""
        return FittedAtStates.of(spec, self.flights)

    def family(
        self, null: FittedAtStates, effects: Sequence[str], accepted: Sequence[str] = (), turned: int = 0, seed: int = 0
    ) -> Family[FittedAtStates]:
        """The family of these effects beside a fitted model."""
        ends = [one for c, one in self._ahead.get(null, {}).items() if c.effect in effects]
        return measured_family(null, effects, accepted, turned, seed, ends)

    def fit_ahead(self, null: FittedAtStates, effects: Sequence[str], accepted: Sequence[str]) -> None:
        """Those that act through another effect; beside a named one those with parameters that bend the equations.

        Of controls a line tells enough.
        """
        model = build(null.spec.with_effects(*effects))
        ahead = [e for e in effects if registered()[e].acts_through or (accepted and curved(model, e))]
        self._ahead.clear()
        self._ahead[null] = self._fitted(null, [Candidate(e) for e in ahead])

    def refitted(self, spec: ModelSpec, near: FittedAtStates) -> FittedAtStates:
        """The model of a spec, fitted from where another fit ended."""
        return replace(self.fitted(near.started(spec)), origin=near)

    def candidates(
        self, null: FittedAtStates, observed: Family[FittedAtStates], candidates: Sequence[Candidate]
    ) -> dict[Candidate, FittedAtStates]:
        """The null with one more effect, for each of these, fitted in full."""
        done = self._ahead.get(null, {})
        more = self._fitted(null, [c for c in candidates if c not in done])
        return {c: done[c] if c in done else more[c] for c in candidates}

    def _fitted(self, null: FittedAtStates, candidates: Sequence[Candidate]) -> dict[Candidate, FittedAtStates]:
        specs = [null.started(c.joined_to(null.spec)) for c in candidates]
        carry = forked_each if self.ranks.size == 1 else self.ranks.carry
        return dict(zip(candidates, carry(specs, self.fitted, _message, self._again), strict=True))

    def settled(self, fitted: FittedAtStates) -> FittedAtStates:
        """The fit itself, which has converged."""
        return fitted

    def _again(self, _: ModelSpec, message: Message) -> FittedAtStates:
        spec, theta, errors, without = ModelSpec.from_plain(message[0]), *message[1:]
        model = build(spec)
        model.put(theta)
        return FittedAtStates(spec, model, self.flights, errors, without)


def _message(fitted: FittedAtStates) -> Message:
    return fitted.spec.plain(), fitted.model.theta.detach().clone(), dict(fitted.errors), dict(fitted.without)
