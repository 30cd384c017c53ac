"""L-BFGS on the output-error likelihood, by torch's gradients through the trajectories: the alternative optimiser."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from rotorid_torch.identify.gauss_newton import Minimum, Options
from rotorid_torch.identify.likelihood import Likelihood, Place
from rotorid_torch.identify.sensitivity import traced

MEMORY = 20
"""Steps whose gradients are remembered."""


def minimise_lbfgs(
    problem: Likelihood, start: Place, options: Options, monitor: Callable[[int, float, Tensor], None] | None = None
) -> Minimum[Place]:
    """The likelihood's minimum by torch's L-BFGS, in variables scaled by their Gauss-Newton columns.

    Bounds are held by evaluating at the nearest point inside and pulling the variable back to it. Standard errors come
    from the linear model at the end, as with Gauss-Newton.
    """
    linear = problem.linearise(start)
    scale = 1.0 / torch.linalg.vector_norm(linear[0], dim=0).clamp_min(1e-12)
    assert start.locals is not None
    spread = 1.0 / torch.linalg.vector_norm(start.locals.segment[:, :, : start.x0.shape[-1]], dim=1).clamp_min(1e-12)
    moves = [torch.zeros_like(start.theta), torch.zeros_like(spread), torch.zeros_like(start.bias)]
    free = moves[: 1 if problem.x0_sd is None else 2] + ([moves[2]] if start.bias.shape[1] else [])
    for move in free:
        move.requires_grad_()
    lower, upper = problem.system.lower, problem.system.upper
    history = [start.cost]

    def state() -> tuple[Tensor, Tensor, Tensor, Tensor]:
        wanted = start.theta + scale * moves[0]
        inside = torch.minimum(torch.maximum(wanted, lower), upper)
        pull = 0.5 * ((wanted - inside) / scale).square().sum()
        x0 = start.x0 if problem.x0_sd is None else start.x0 + spread * moves[1]
        return inside, x0, start.bias + moves[2], pull

    def closure() -> Tensor:
        optimiser.zero_grad()
        theta, x0, bias, pull = state()
        run = traced(problem.system, theta, problem.records, problem.segments, x0, problem.solver)
        cost = problem.total(problem.place(theta, x0, bias, run))
        (cost + pull).backward()
        return (cost + pull).detach()

    optimiser = torch.optim.LBFGS(
        free, max_iter=1, history_size=MEMORY, line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0
    )
    message, converged, iteration, calm = "", False, 0, 0
    best = math.inf
    while True:
        cost = float(optimiser.step(closure))  # pyright: ignore[reportArgumentType]
        calm = calm + 1 if best - cost < options.tolerance * abs(cost) + 0.1 * options.absolute else 0
        best = min(best, cost)
        if calm >= 3:
            message, converged = "converged: the cost no longer falls", True
            break
        if iteration >= 20 * options.max_iterations:
            message = f"stopped after {iteration} iterations"
            break
        iteration += 1
        history.append(cost)
        if monitor is not None:
            monitor(iteration, cost, state()[0].detach())
    with torch.no_grad():
        theta, x0, bias, _ = state()
        run = traced(problem.system, theta, problem.records, problem.segments, x0, problem.solver)
    place = problem.place(theta, x0, bias, run)
    linear = problem.linearise(place)
    at_bound = (theta <= lower) | (theta >= upper)
    blind = torch.linalg.vector_norm(linear[0], dim=0) <= 1e-12
    return Minimum(place, linear, at_bound, blind, converged, message, iteration, history)
