"""How the maximum of the innovations' likelihood is looked for, from a start that follows the flights.

A filter with much process noise predicts one sample ahead from what is measured, as an equation error does: poor
parameters and an unstable vehicle cannot make it diverge. The likelihood then takes the noise back as far as the
parameters have come to explain the motion.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Minimum, Options, Region, masks, minimise
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.initial_states import roughness
from rotorid_torch.identification.estimate.own_models.steps import Stepped, in_steps
from rotorid_torch.identification.estimate.progressive_fit import FINE, Monitor
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.estimate.system import by_inputs
from rotorid_torch.identification.filter_error.extended_kalman import FilterProblem, KalmanRun
from rotorid_torch.identification.filter_error.held_gain import Beginning, Held, HeldFilter, alternated
from rotorid_torch.identification.filter_error.innovations import (
    FilterEngine,
    FilterPlace,
    InnovationLikelihood,
    filter_engine,
)

SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4, 1e-6)
"""Parts of the states' mean square change per second that are tried as process noise."""
LITTLE = 1e-3
"""Part of the process noise with which a fit is tried again from where it ended."""
NEAR = Options(max_iterations=20, absolute=1.0)
"""Of the first part of a search, which has only to come near."""
LEAST_GAIN = 1e-2
"""In the log-likelihood, for which another optimum is taken."""


class Maximum(NamedTuple):
    """Where a search ended."""

    engine: FilterEngine
    likelihood: InnovationLikelihood
    minimum: Minimum[FilterPlace]


@dataclass(frozen=True)
class MaximumSearch:
    """How the maximum of the likelihood is looked for.

    iterations : at most, of all parts of the search together.
    """

    problem: FilterProblem
    floor: Tensor
    free: bool
    iterations: int
    gain: str
    engine: str | None
    monitor: Monitor | None

    def in_steps(self) -> Stepped[Maximum]:
        """To the maximum, in steps that are short enough for the model."""
        system = self.problem.system

        def solve(records: Records, theta: Tensor) -> Maximum:
            return replace(self, problem=replace(self.problem, records=records)).ended(theta)

        def end(maximum: Maximum) -> tuple[Tensor, Tensor]:
            place = maximum.minimum.point
            return place.theta[: len(system.theta)], maximum.engine.filter(place.theta, place.x0).states

        return in_steps(system, self.problem.records, solve, end)

    def ended(self, theta: Tensor) -> Maximum:
        """From where the filter follows the flights with parameters near theta, to the maximum."""
        problem, system = self.problem, self.problem.system
        theta, start = torch.clamp(theta, system.lower, system.upper), problem.records.states[:, 0]
        beginning, psi, cost = started(self._engine(theta), theta, start.nan_to_num(0.0), self.floor, self.free)
        if not math.isfinite(cost):
            raise diverged(problem, beginning.filter(psi, start.nan_to_num(0.0)))
        seek = self._alternating if isinstance(beginning, HeldFilter) else self._descending
        return seek(beginning, psi, start.nan_to_num(0.0))  # pyright: ignore[reportArgumentType]

    def _engine(self, theta: Tensor) -> FilterEngine:
        ones = torch.ones(max(len(self.problem.process.names), len(self.floor)), dtype=torch.float64)
        noises = self.problem.process.numbers(ones[: len(self.problem.process.names)])
        psi = torch.cat([theta, noises, self.problem.noise.numbers(ones[: len(self.floor)])])
        if self.gain == "exact" or not self.problem.process.count + self.problem.noise.count:
            return filter_engine(self.problem, psi, self.engine)
        try:
            return HeldFilter.of(self.problem, psi, held=len(theta))
        except Unsupported as error:
            raise InputError("arguments", "gain", f"the model cannot be compiled: {error}", '"exact"') from error

    @cached_property
    def _region(self) -> Region:
        system, problem = self.problem.system, self.problem
        nothing = torch.zeros(len(problem.process.names), dtype=torch.float64)
        noises = [problem.process.lower(nothing), problem.noise.lower(self.floor.square())]
        lower = torch.cat([system.lower, *noises])
        more = torch.full((len(lower) - len(system.upper),), math.inf, dtype=torch.float64)
        return Region(lower, torch.cat([system.upper, more]))

    @cached_property
    def _regions(self) -> list[Region]:
        """Parameters alone first, then noises too, then their correlations.

        Noises of the start let the filter follow any parameters. Far from the maximum they would settle on these: one
        could vanish, and hold all others to what it belongs to.
        """
        forms, count = (self.problem.process, self.problem.noise), len(self.problem.system.theta)
        alone, none = torch.ones(count, dtype=torch.bool), [torch.zeros(f.count, dtype=torch.bool) for f in forms]
        single = [torch.arange(f.count) < len(f.which) for f in forms]
        masks = [torch.cat([alone, *none]), torch.cat([alone, *single])]
        return [*(replace(self._region, free=m) for m in masks if not bool(m.all())), self._region]

    def _watch(self, iteration: int, cost: float, psi: Tensor) -> None:
        if self.monitor is not None:
            self.monitor(iteration, cost, psi[: len(self.problem.system.theta)])

    def _descending(self, engine: FilterEngine, psi: Tensor, x0: Tensor) -> Maximum:
        """Gauss-Newton, and once more from hardly any process noise."""
        likelihood = InnovationLikelihood(engine, x0, self.free)
        options = replace(FINE, max_iterations=self.iterations)
        near = replace(NEAR, max_iterations=min(NEAR.max_iterations, self.iterations))

        def within(region: Region, start: Tensor | FilterPlace, how: Options = options) -> Minimum[FilterPlace]:
            return minimise(likelihood.evaluate, likelihood.linearise, start, region, how, self._watch)

        def continued(end: Minimum[FilterPlace], regions: Sequence[Region]) -> Minimum[FilterPlace]:
            for region in regions:
                before, end = end.history, within(region, end.point, replace(options, before=end.iterations))
                end = replace(end, history=before + end.history)
            return end

        first, *later = self._regions
        best = continued(within(first, psi, near if later else options), later)
        calmer = likelihood.at(_with_less(self.problem, best.point.theta), best.point.x0)
        if self.problem.process.count and math.isfinite(calmer.cost):
            first, *later = self._regions[1:] or self._regions
            other = continued(within(first, calmer, replace(options, before=best.iterations)), later)
            best = other if other.point.cost < best.point.cost - LEAST_GAIN else best
        return Maximum(engine, likelihood, best)

    def _alternating(self, engine: HeldFilter, psi: Tensor, x0: Tensor) -> Maximum:
        """Noises and parameters in turn, gains held while parameters move."""
        ended, history, rounds = Held(psi, x0, converged=False, history=[]), [], 0
        for region in self._regions:
            start = Beginning(ended.psi, ended.x0, self.free)
            ended = alternated(engine, start, region, range(rounds, self.iterations), self._watch)
            history, rounds = history + ended.history, rounds + len(ended.history) - 1
        likelihood = InnovationLikelihood(engine, ended.x0, self.free)
        place = likelihood.evaluate(ended.psi)
        said = "converged: the likelihood stands still" if ended.converged else f"stopped after {rounds} rounds"
        linear = likelihood.linearise(place)
        which = masks(linear, ended.psi, self._region)
        return Maximum(engine, likelihood, Minimum(place, linear, *which, ended.converged, said, rounds, history))


def started(
    engine: FilterEngine, theta: Tensor, x0: Tensor, floor: Tensor, free: bool
) -> tuple[FilterEngine, Tensor, float]:
    """The engine with what is uncertain in the initial states, unknowns psi to start from, and their cost.

    Psi has the most likely among several sizes of process noise. Initial states that are to be estimated are as
    uncertain about their mean as one sample of the outputs leaves them, which keeps the likelihood bounded.

    x0 : [F, nx] initial states to start from. floor : [ny] smallest standard deviation of the outputs' noise.
    free : whether they are to be estimated.
    """
    problem = engine.problem
    noise = torch.maximum(roughness(problem.records), floor).square()
    residual, change = _seen(problem, theta, x0, noise)
    if free:
        engine = replace(engine, problem=replace(problem, P0=torch.diag(residual)))
    shares = SHARES if problem.process.count else (1.0,)
    if problem.process.count:
        run = engine.filter(_joined(problem, theta, change, noise), x0)
        path = torch.diff(run.states, dim=1).flatten(0, 1).square().nanmean(dim=0) / problem.records.dt
        change = torch.maximum(change, path.nan_to_num(0.0, posinf=0.0))
    tried = [_joined(problem, theta, share * change, noise) for share in shares]
    costs = [float(engine.cost(psi, x0).sum()) for psi in tried]
    costs = [cost if math.isfinite(cost) else math.inf for cost in costs]
    best = min(range(len(costs)), key=costs.__getitem__)
    return engine, tried[best], costs[best]


def _joined(problem: FilterProblem, theta: Tensor, process: Tensor, noise: Tensor) -> Tensor:
    return torch.cat([theta, problem.process.numbers(process), problem.noise.numbers(noise)])


def _seen(problem: FilterProblem, theta: Tensor, x0: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Of the states that outputs show: variance by one sample [nx], mean square change per second [nx]."""
    records = problem.records
    H = by_inputs(lambda x, u: problem.system.output(theta, x, u), x0, records.controls[:, 0])[0].mean(dim=0)
    inverse = (torch.linalg.pinv(H / noise.sqrt().unsqueeze(-1), rtol=1e-6) / noise.sqrt()).square()
    every = records.spacing().tolist()
    apart = zip(records.measured(records.outputs), every, strict=True)
    changes = torch.cat([torch.diff(one, dim=0).square() / step for one, step in apart]).nanmean(dim=0).nan_to_num(0.0)
    sample = sum(every) / len(every)
    return inverse @ noise, inverse @ (changes - 2.0 * noise / sample).clamp_min(0.1 * noise / sample) / records.dt


def _with_less(problem: FilterProblem, psi: Tensor) -> Tensor:
    """Unknowns with hardly any process noise: an unstable vehicle's likelihood may have a second optimum there."""
    first, psi = len(problem.system.theta), psi.clone()
    psi[first : first + len(problem.process.which) * (problem.process.count > 0)] *= LITTLE
    return psi


def diverged(problem: FilterProblem, run: KalmanRun) -> InputError:
    """Where a filter that diverged did so, and with which state."""
    expected = "parameters, x0 and process noise from which the filter follows the flight"
    if run.lost is None:
        return InputError("flights", "filter", "the innovations' covariance is not positive definite", expected)
    flight, sample, state = run.lost
    wrong = f"the filter diverges at {float(problem.records.start[flight]) + sample * problem.records.dt:.4g} s"
    return InputError(f"flights[{flight}]", problem.process.names[state], wrong, expected)
