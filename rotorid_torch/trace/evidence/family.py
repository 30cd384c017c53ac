"""The family of candidates: evidence of all that a model may lack, computed alike for the data and for each draw.

Members are effects of the library in trajectories (with a size of all controls, and of each control), effects in the
forces on the measured motion, and pseudo-effects for what the library has no name for, by equation and kind.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Generic

import torch
from torch import Tensor

from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.trace.evidence.critical_values import Draws
from rotorid_torch.trace.evidence.fits import Fitted, FittedT, Flights
from rotorid_torch.trace.evidence.force_evidence import seen_in_forces
from rotorid_torch.trace.evidence.residual import AT_ONCE, left_over
from rotorid_torch.trace.evidence.screen import PATH, Screen, screen
from rotorid_torch.trace.evidence.unattributed import Description, Residuals
from rotorid_torch.trace.terms.candidate import EACH, IN_FORCES, Candidate, of_control_path
from rotorid_torch.trace.terms.settings import SETTINGS

TURNED = "critical values come from the data's own residuals, turned in time"


@dataclass(frozen=True, eq=False)
class Family(Generic[FittedT]):
    """Evidence beside a model.

    null : the model. accepted : its effects that have a name. screen : of effects with a size of all controls, and of
    each control. forces : the same in the forces on the measured motion. residuals, descriptions : what has no name,
    where the residual that is scored has descriptions of that. in_full, fitted : statistics by fits in
    full, and these, of candidates of which a straight line about a model that has not converged is no evidence.
    """

    null: FittedT
    accepted: tuple[str, ...]
    screen: Screen
    forces: Screen | None = None
    residuals: Residuals | None = None
    descriptions: Mapping[str, Description] = field(default_factory=dict)
    fitted: Mapping[Candidate, FittedT] = field(default_factory=dict)
    in_full: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def statistics(self) -> dict[str, float]:
        """T of each member."""
        statistics = {c.name: float(self.screen.evidence(c.name).sum()) for c in self.candidates}
        statistics |= self.in_full
        if self.forces is not None:
            in_forces = [c.name for c in self.forces.candidates]
            statistics |= {f"{name}{IN_FORCES}": float(self.forces.evidence(name).sum()) for name in in_forces}
        return statistics | {n: float(one.sum()) for n, one in self.evidence_without_name.items()}

    @cached_property
    def evidence_without_name(self) -> dict[str, Tensor]:
        """Evidence of each pseudo-effect by flight [F + V]."""
        in_path = {PATH: self.screen.evidence(PATH)} if Candidate(PATH) in self.screen.candidates else {}
        return in_path | {name: one.evidence for name, one in self.descriptions.items()}

    @property
    def contest(self) -> dict[str, float]:
        """T of the members that are compared with the draws.

        The pseudo-effect of the control path only judges names of that kind: any filter of the controls is ordinary.
        """
        named = bool(of_control_path(self.accepted))
        return {name: t for name, t in self.statistics.items() if named or name != PATH}

    @property
    def least(self) -> dict[str, float]:
        """T of any one more parameter, by member that acts on motion: half a unit of log-likelihood in each flight."""
        flights = len(self.screen.equations.fitted)
        one = 0.5 * flights**2 / self.null.per_sample
        return {name: one for name in self.statistics if name not in self.descriptions}

    @property
    def candidates(self) -> list[Candidate]:
        """Those of the library."""
        return [c for c in self.screen.candidates if c.effect != PATH]

    def over_one_size(self, effect: str) -> Tensor:
        """Evidence of a size of each control over one size of all, flight by flight [F + V]."""
        return self.screen.evidence(f"{effect}{EACH}") - self.screen.evidence(effect)

    def nameless(self, members: Sequence[str]) -> float:
        """The largest of pseudo-effects, as evidence in trajectories: one equation is one of all that are measured."""
        rows = 1 if self.residuals is None else len([r for r in self.residuals.fitted.rows if r not in AT_ONCE])
        log_ratios = [self.descriptions[name].log_ratio / rows for name in members if name in self.descriptions]
        return max([*log_ratios, *(self.statistics[name] for name in members if name == PATH)], default=0.0)

    def sizes(self) -> dict[str, float]:
        """Sizes of all effects beyond nothing by the straight line, whatever their bounds, by full name."""
        return {n: v for c in self.candidates for n, v in self.screen.unbounded(c.name).items()}


@dataclass(frozen=True)
class Scored(ABC, Generic[FittedT]):
    """The residual that a search scores candidates by: what is fitted to it, and the evidence in it.

    Trajectories over segments, or accelerations at measured states. held : parameters that keep their values. ranks :
    among which fits of several candidates are spread; everything else is the same at each.
    """

    flights: Flights
    held: tuple[str, ...] = ()
    ranks: Ranks = ALONE

    by_chance: ClassVar[str]
    """What stands for flights where nothing is missing, in words, where none can be drawn."""
    drawn_with_effects: ClassVar[bool] = False
    """Whether clean aircraft can be drawn with effects that joined."""

    @abstractmethod
    def family(
        self, null: FittedT, effects: Sequence[str], accepted: Sequence[str] = (), turned: int = 0, seed: int = 0
    ) -> Family[FittedT]:
        """The family of these effects beside a fitted model.

        accepted : effects of the model that have a name. turned : residuals that know nothing of the motion.
        """

    def fit_ahead(self, null: FittedT, effects: Sequence[str], accepted: Sequence[str]) -> None:
        """Fits in full, ahead of the family, effects of which a straight line about the null tells little.

        `family` and `candidates` then know these fits. None by default. accepted : the null's effects that have a name.
        """

    def in_full(self, observed: Family[FittedT], candidates: Sequence[Candidate]) -> Family[FittedT]:
        """The family with the evidence of these candidates from fits in full, where a straight line is not enough."""
        return observed

    @abstractmethod
    def refitted(self, spec: ModelSpec, near: FittedT) -> FittedT:
        """The model of a spec, fitted from where another fit ended."""

    @abstractmethod
    def candidates(
        self, null: FittedT, observed: Family[FittedT], candidates: Sequence[Candidate]
    ) -> dict[Candidate, FittedT]:
        """The null with one more effect, for each of these, fitted in full."""

    @abstractmethod
    def settled(self, fitted: FittedT) -> FittedT:
        """A fit gone on with, where it has not converged."""

    def draws_by_chance(self, observed: Family[FittedT], effects: Sequence[str], seed: int, note: str = "") -> Draws:
        """Statistics of the family beside a model where nothing is missing, by its residuals turned in time."""
        count, named = SETTINGS.draws, observed.accepted
        turned = self.family(observed.null, [e for e in effects if e not in named], named, count, seed)
        statistics = {
            c.name: torch.stack([turned.screen.evidence(c.name, 1 + r).sum() for r in range(count)])
            for c in turned.screen.candidates
        }
        statistics |= {} if turned.residuals is None else turned.residuals.by_chance(count, seed)
        return Draws(statistics, note or self.by_chance, clean=False, least=turned.least)


def family(
    null: Fitted, effects: Sequence[str], accepted: Sequence[str] = (), turned: int = 0, seed: int = 0
) -> Family[Fitted]:
    """The family of these effects beside a fitted model.

    accepted : effects of the model that have a name. turned : residuals that know nothing of the motion, for
    `Scored.draws_by_chance`.
    """
    path = of_control_path(effects) if len(null.spec.controls) > 1 and not of_control_path(accepted) else []
    screened = screen(null, [*effects, PATH], path, turned, seed)
    listed = null.flights.dataset, null.flights.reconstruction
    validate = null.flights.dataset.validate
    unseen = left_over(null.model, *listed, validate, accepted) if validate else None
    residuals = Residuals(left_over(null.model, *listed, null.flights.dataset.identify, accepted), unseen)
    still, over = null.in_still_air, residuals.fitted
    if still is not null:
        over = left_over(still.model, *listed, null.flights.dataset.identify, accepted)
    forces = seen_in_forces(still, over, [Candidate(e) for e in effects])
    return Family(null, tuple(accepted), screened, forces, residuals, residuals.descriptions())
