"""A multirotor's model fitted to accelerations at measured states, and how well it explains them beside another one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import msgspec
import torch
from torch import Tensor

from rotorid_torch.core.names import MOMENTS
from rotorid_torch.effects.spec import ModelSpec
from rotorid_torch.identification.measured_states import MeasuredStates, centred
from rotorid_torch.identification.rotor_equations import seen_flights
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS
from rotorid_torch.model.nominal import build
from rotorid_torch.trace.evidence.fits import FittedModel, Flights
from rotorid_torch.trace.terms.settings import SETTINGS
from rotorid_torch.validate.rotor_moments import of_moments, regressed_rotors, with_moments

Errors = Mapping[str, Tensor]
"""Measured less modelled by row, about its mean (T,)."""


@dataclass(frozen=True, eq=False)
class FittedAtStates(FittedModel):
    """A model fitted to accelerations at measured states.

    spec : its structure, with all moments free. model : where moments that it does not explain are held at zero.
    errors : standard errors of the estimated parameters by full name. without : theta of all identify flights but one,
    by that one's name: to it, that flight is unseen. origin : the fit whose values this one began from, if any.
    """

    errors: Mapping[str, float]
    without: Mapping[str, Tensor]
    origin: FittedAtStates | None = None

    @classmethod
    def of(cls, spec: ModelSpec, flights: Flights) -> FittedAtStates:
        """By step 2, which is least squares of these accelerations, from the spec's values where it has any."""
        spec = with_moments(spec)
        begun = any(name.startswith("rotors.thrust.") for name in spec.values)
        silenced, regressions = regressed_rotors(spec, flights.dataset, flights.reconstruction, begun)
        model = build(silenced)
        model.put(regressions.theta)
        return cls(spec, model, flights, regressions.errors, regressions.without)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""
        return tuple(self.errors)

    @property
    def silent(self) -> tuple[str, ...]:
        """Moments that are held at zero."""
        return tuple(row for row in MOMENTS if self.values.get(f"rotors.power.{row}") == 0.0)

    @cached_property
    def sigma(self) -> dict[str, float]:
        """Rms of what is left of each row on the identify flights."""
        rows: dict[str, list[Tensor]] = {}
        for errors in self._identified:
            for row, error in errors.items():
                rows.setdefault(row, []).append(error)
        return {row: max(float(torch.cat(parts).square().mean().sqrt()), 1e-300) for row, parts in rows.items()}

    @property
    def per_sample(self) -> float:
        """Measured values of the identify flights."""
        return float(sum(len(error) for errors in self._identified for error in errors.values()))

    @property
    def cost(self) -> float:
        """Minus log-likelihood of the identify flights, each row with the scale that suits it best."""
        return self.per_sample * sum(math.log(s) for s in self.sigma.values()) / len(self.sigma)

    def error(self, name: str) -> float:
        """Standard error of a parameter, infinite where it was not estimated."""
        return self.errors.get(name, math.inf)

    def scatter(self, effect: str) -> dict[str, float]:
        """None by leaving out flights, of which one may tell all; errors hold for residuals that are alike."""
        return {}

    def log_ratios(self, other: Self) -> Tensor:
        """Mean over the rows of log(rms of this model / rms of the other) of blocks of unseen flights [B]."""
        return log_ratios(self._unseen, other._unseen, self.block)

    def unseen_log_ratios(self, other: Self) -> Tensor:
        """The same of whole flights: validate flights, and each identify flight by a fit of all others [F]."""
        return log_ratios(self._unseen, other._unseen, None)

    def started(self, spec: ModelSpec) -> ModelSpec:
        """A spec that begins with the values that parameters have here, but for moments that are not explained here."""
        effects = {e: f"{e}." for e in (*self.spec.effects, *spec.effects)}
        others = {n: v for n, v in spec.values.items() if not n.startswith(tuple(effects.values()))}
        silent = of_moments(spec, self.silent)
        shared = (*(effects[e] for e in spec.effects if e in self.spec.effects), "rotors.", "speed.", "surfaces.")
        values = {n: v for n, v in self.values.items() if n.startswith(shared) and n not in silent}
        return msgspec.structs.replace(spec, values={**others, **values})

    @cached_property
    def block(self) -> int:
        """Samples of a block."""
        steps = [one.step for one in self.states(self.flights.dataset.identify[:1]).equations.flights]
        return max(1, round(SETTINGS.segment_s / steps[0]))

    def states(self, listed: Sequence[str]) -> MeasuredStates:
        """Responses of some flights at measured states, and the model of them."""
        return MeasuredStates.of(self.model, list(seen_flights(self.model, self.flights.records(self.model, listed))))

    def _errors(self, states: MeasuredStates, theta: Tensor) -> list[Errors]:
        """Of each flight; a moment that the rotors do not explain is explained by nothing else."""
        silent = {ANGULAR_ACCELERATIONS[MOMENTS.index(row)] for row in self.silent}
        return [
            {row: centred(measured[row] if row in silent else r).nan_to_num(0.0) for row, r in left.items()}
            for left, measured in zip(states.remainders(theta), states.measured, strict=True)
        ]

    @cached_property
    def _identified(self) -> list[Errors]:
        return self._errors(self.states(self.flights.dataset.identify), self.model.theta.detach())

    @cached_property
    def _unseen(self) -> list[Errors]:
        """Of validate flights, and of each identify flight by the theta of all others; of the latter's own if alone."""
        dataset = self.flights.dataset
        errors: list[Errors] = []
        if dataset.validate:
            errors += self._errors(self.states(dataset.validate), self.model.theta.detach())
        for name, theta in self.without.items():
            errors += self._errors(self.states([name]), theta)
        return errors or self._identified


def log_ratios(before: Sequence[Errors], after: Sequence[Errors], block: int | None) -> Tensor:
    """Of each flight or block, d = mean over rows of log((e_before^2 + s^2)/(e_after^2 + s^2))/2.

    s is the rms of the row over all flights after: what a flight leaves alone counts little in it.
    """
    rows = [row for row in before[0] if all(row in one for one in (*before, *after))]
    usual = {row: torch.cat([one[row] for one in after]).square().mean() for row in rows}

    def squares(error: Tensor) -> Tensor:
        count = len(error) if block is None else min(block, len(error))
        whole = max(len(error) // count, 1) * count
        return error[:whole].unflatten(0, (-1, count)).square().mean(dim=1)

    def ratio(row: str, without: Errors, with_it: Errors) -> Tensor:
        squared = [(squares(one[row]) + usual[row]).clamp_min(1e-300) for one in (without, with_it)]
        return 0.5 * (squared[0] / squared[1]).log()

    pairs = zip(before, after, strict=True)
    return torch.cat([torch.stack([ratio(row, *pair) for row in rows]).mean(dim=0) for pair in pairs])
