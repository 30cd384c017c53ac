"""Where the filter error method starts: noises that let the filter follow the flights, so that any start will do.

A filter with much process noise predicts one sample ahead from what is measured, as an equation error does: poor
parameters and an unstable vehicle cannot make it diverge. The likelihood then takes the noise back as far as the
parameters have come to explain the motion.
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.identification.estimate.initial_states import roughness
from rotorid_torch.identification.estimate.system import by_inputs
from rotorid_torch.identification.filter_error.extended_kalman import FilterProblem
from rotorid_torch.identification.filter_error.innovations import FilterEngine

SHARES = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4, 1e-6)
"""Parts of the states' mean square change per second that are tried as process noise."""


def first(
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
