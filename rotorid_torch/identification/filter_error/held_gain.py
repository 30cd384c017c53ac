"""The filter error method for large models: gains are held while parameters move, and found anew where they end.

With all unknowns in the derivatives of state, covariance and gain, a model of 15 states and 160 parameters takes a
hundred times the time of output error. Here two problems alternate. The noises' sizes are those of the exact
likelihood, the parameters held: few columns. The parameters minimise the innovations that a model makes which follows
the flights with the gains of that filter: columns of states alone, as in output error. At the true gain innovations are
white, so that a change of the gain does not correlate with them: neglected are terms of mean zero, not of the optimum.

Source: Ljung, System Identification (2nd ed.), sec. 7.2 and 8.4 (prediction errors; gains that do not depend on the
parameters); Maine and Iliff (1981), SIAM J. Appl. Math. 41 (gains held within an iteration).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Options, Region, minimise
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.innovations import FlightsToFollow
from rotorid_torch.core.native.observer import Gains, Observer
from rotorid_torch.identification.estimate.sensitivity import control_slopes
from rotorid_torch.identification.filter_error.innovations import (
    FilterEngine,
    FilterPlace,
    InnovationLikelihood,
    NativeFilter,
)

SHARES = (1.0, 0.5, 0.2, 0.05)
"""Of a step of the parameters with gains held, tried in turn."""
ENOUGH = 1.0
"""Fall of minus log-likelihood in one alternation below which the search ends."""
NOISES, PARAMETERS = Options(max_iterations=4, absolute=0.2), Options(max_iterations=3, absolute=0.2)
"""Of the two problems, each time."""


@dataclass(frozen=True, eq=False)
class Noises:
    """Engine of the noises, and of what else is told by innovations alone: psi without its first parameters."""

    filter: NativeFilter
    theta: Tensor  # the first ones

    def cost(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        return self.filter.cost(torch.cat([self.theta, psi]), x0)

    def normal_equations(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`, without initial states."""
        return NativeFilter.normal_equations(self.filter, torch.cat([self.theta, psi]), x0)


@dataclass(frozen=True, eq=False)
class FollowingModel:
    """Engine of the parameters: a model that follows with known gains; psi is theta."""

    filter: NativeFilter
    dynamics: Dynamics
    gains: Gains
    observers: dict[tuple[int, ...], Observer] = field(default_factory=dict)

    @classmethod
    def of(cls, filter: NativeFilter, theta: Tensor, x0: Tensor, gains: Gains) -> FollowingModel:
        """Trace the system."""
        system, u = filter.problem.system, filter.problem.records.controls[0, 0]
        nu, inputs = len(u), torch.cat([u, u.new_zeros(1)])
        traced = Dynamics.of(lambda x, u, theta: system.motion(theta, u[nu], x, u[:nu]), x0[0], inputs, theta)
        return cls(filter, traced if filter.timed else replace(traced, nu=nu), gains)

    def cost(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`; infinite where the model flies away."""
        observer, flights = self._flown(psi, x0)
        return observer.cost(psi, x0, flights, self.gains, threads()).nan_to_num(math.inf, math.inf)

    def normal_equations(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        observer, flights = self._flown(psi, x0)
        return observer.normal_equations(psi, x0, flights, self.gains, threads())

    def rows(self, psi: Tensor, x0: Tensor) -> Tensor:
        """Of the innovations alone [F, T, ny, m]."""
        observer, flights = self._flown(psi, x0)
        return observer.rows(psi, x0, flights, self.gains, threads())

    def _flown(self, theta: Tensor, x0: Tensor) -> tuple[Observer, FlightsToFollow]:
        _, flights = self.filter.flown(theta, x0)
        problem = self.filter.problem
        which, _ = control_slopes(problem.system, theta, problem.records, problem.segments)
        key = tuple(which.tolist())
        if key not in self.observers:
            self.observers[key] = Observer(replace(self.dynamics, path=key))
        return self.observers[key], flights


@dataclass(frozen=True, eq=False)
class HeldFilter(NativeFilter):
    """The filter, and rows in which parameters act through the followed state alone, noises through all."""

    normal_equations = FilterEngine.normal_equations

    def rows(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        count, held = len(self.problem.system.theta), self.compiled.held
        following = FollowingModel.of(self, psi[:count], x0, self.gains(psi, x0))
        first, by_noise = following.rows(psi[:count], x0), super().rows(psi, x0)
        wide = torch.nn.functional.pad(by_noise, (x0.shape[-1] + held, 0))
        wide[:, :, : first.shape[2], : x0.shape[-1] + held] = first[..., : x0.shape[-1] + held]
        return wide


@dataclass(frozen=True, eq=False)
class Beginning:
    """Parameters and noises psi, initial states x0 [F, nx], and whether those are unknown too."""

    psi: Tensor
    x0: Tensor
    free: bool = True


@dataclass(frozen=True, eq=False)
class Held:
    """Where the alternation ended.

    psi, x0 : all unknowns. history : minus log-likelihood of the filter, and of what is known beforehand, at the start
    and after each round.
    """

    psi: Tensor
    x0: Tensor
    converged: bool
    history: list[float]


def alternated(
    filter: NativeFilter,
    start: Beginning,
    region: Region,
    rounds: range,
    monitor: Callable[[int, float, Tensor], None] | None = None,
) -> Held:
    """Noises and parameters in turn until the likelihood stands still.

    filter : of which the parameters from `filter.compiled.held` on belong to the noises.
    start : the filter must not diverge there. region : of psi. rounds : numbers, from 0, of those that may be taken.
    monitor : called after each round with round, cost, theta.
    """
    psi, x0, count, held = start.psi, start.x0, len(filter.problem.system.theta), filter.compiled.held
    noises_region = region.part(slice(held, None), region.mask[held:])
    theta_region = region.part(slice(count), torch.arange(count) < held)
    following = FollowingModel.of(filter, psi[:count], x0, filter.gains(psi, x0))
    history, settled = [float(filter.cost(psi, x0).sum())], False
    for k in rounds:
        noises = InnovationLikelihood(Noises(filter, psi[:held]), x0, free=False)
        noise_fit = minimise(noises.evaluate, noises.linearise, psi[held:], noises_region, NOISES)
        psi = torch.cat([psi[:held], noise_fit.point.theta])
        following = replace(following, gains=filter.gains(psi, x0))
        likelihood = InnovationLikelihood(following, x0, start.free)
        fit = minimise(likelihood.evaluate, likelihood.linearise, psi[:count], theta_region, PARAMETERS)
        moved = _believed(filter, psi, x0, fit.point, noise_fit.point.cost)
        if moved is not None:
            psi, x0 = moved
        history.append(noise_fit.point.cost if moved is None else float(filter.cost(psi, x0).sum()))
        if monitor is not None:
            monitor(k + 1, history[-1], psi[:count])
        settled = history[-2] - history[-1] < ENOUGH
        if settled:
            break
    return Held(psi, x0, settled, history)


def _believed(
    filter: NativeFilter, psi: Tensor, x0: Tensor, end: FilterPlace, before: float
) -> tuple[Tensor, Tensor] | None:
    """As far from psi and x0 towards where gains that were held led as the filter's own likelihood is better there."""
    count = len(end.theta)
    for share in SHARES:
        theta = psi[:count] + share * (end.theta - psi[:count])
        trial, initial = torch.cat([theta, psi[count:]]), x0 + share * (end.x0 - x0)
        if float(filter.cost(trial, initial).sum()) < before:
            return trial, initial
    return None
