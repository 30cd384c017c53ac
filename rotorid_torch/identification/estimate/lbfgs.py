"""L-BFGS on the output-error likelihood, by gradients through the trajectories: the alternative optimiser."""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import FLOOR, Minimum, Options, Region, masks
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place

MEMORY = 20
"""Steps whose gradients are remembered."""
ROUND = 5
"""Iterations between looks at the progress."""
ROUNDS = 10
"""Iterations allowed for one of Gauss-Newton."""


def minimise_lbfgs(
    problem: Likelihood, start: Place, options: Options, monitor: Callable[[int, float, Tensor], None] | None = None
) -> Minimum[Place]:
    """The likelihood's minimum by torch's L-BFGS, in variables that the linear model at the start makes round.

    A search that no longer falls begins anew, with variables and memory of where it is: a line search may have failed.
    Bounds of parameters are held by evaluating at the nearest point inside and pulling the variable back to it; initial
    states have none. Standard errors come from the linear model at the end, as with Gauss-Newton.

    Source: Liu and Nocedal (1989), Math. Programming 45.
    """
    place, history, iteration, converged = start, [start.cost], 0, False
    most = ROUNDS * options.max_iterations

    def same(before: float) -> bool:
        return before - history[-1] <= options.tolerance * abs(before) + options.absolute

    while iteration < most and not converged:
        begun, settled = history[-1], False
        variables = _Variables(problem, place)
        search = _search(variables)
        while iteration < most and not settled:
            history.append(search())
            iteration += ROUND
            settled = same(history[-2])
            if monitor is not None:
                monitor(iteration, history[-1], variables.values()[0].detach())
        place = variables.place()
        converged = settled and same(begun)
    linear = problem.linearise(place)
    masked = masks(linear, place.theta, Region(problem.system.lower, problem.system.upper))
    message = "converged: the cost no longer falls" if converged else f"stopped after {iteration} iterations"
    return Minimum(place, linear, *masked, converged, message, iteration, history)


def _blind_with_held_states(problem: Likelihood, start: Place) -> Tensor:
    """Mask [P] of the parameters that have no effect at the start, initial states held."""
    held = replace(problem, x0=start.x0, x0_sd=None)
    return torch.linalg.vector_norm(held.linearise(held.evaluate(start.theta)).A, dim=0) <= FLOOR


class _Variables:
    """Steps of parameters and initial states in units of their standard errors, as leaves for torch."""

    def __init__(self, problem: Likelihood, start: Place) -> None:
        self.problem, self.start = problem, start
        A = problem.linearise(start).A
        norms = torch.linalg.vector_norm(A, dim=0)
        blind = norms <= FLOOR  # a network's first weights, while those behind them are zero: in their own unit
        norms = torch.where(blind, 1.0, norms)
        self.taken = blind & ~_blind_with_held_states(problem, start) if bool(blind.any()) else blind
        weak = torch.diag(torch.where(blind, 1.0, 1e-6))
        self.triangle, self.norms = torch.linalg.qr(torch.cat([A / norms, weak]), mode="r").R, norms
        assert start.locals is not None
        self.locals = start.locals
        self.shared = torch.zeros_like(start.theta)
        self.x0 = torch.zeros_like(start.locals.segment[:, :, -1])
        self.free = [v.requires_grad_() for v in (self.shared, self.x0) if v.numel()]

    def values(self) -> tuple[Tensor, Tensor, Tensor]:
        """Parameters within bounds, initial states, and half the squared distance to what was wanted."""
        step = torch.linalg.solve_triangular(self.triangle, self.shared.unsqueeze(-1), upper=True).squeeze(-1)
        step = (step / self.norms).masked_fill(self.taken, 0.0)  # what initial states take over stays
        wanted = self.start.theta + step
        theta = torch.minimum(torch.maximum(wanted, self.problem.system.lower), self.problem.system.upper)
        step = self.locals.carry(theta - self.start.theta, self.x0)
        x0 = self.start.x0 + step if step.numel() else self.start.x0
        return theta, x0, 0.5 * ((wanted - theta) * self.norms).square().sum()

    def cost(self) -> Tensor:
        """Minus log-likelihood and the pull back to the bounds."""
        (theta, x0, pull), p = self.values(), self.problem
        run = p.engine.differentiable(theta, p.records, p.segments, x0)
        return p.total(p.place(theta, x0, run)) + pull

    @torch.no_grad()
    def place(self) -> Place:
        """Where the variables are."""
        (theta, x0, _), p = self.values(), self.problem
        return p.place(theta, x0, p.engine.differentiable(theta, p.records, p.segments, x0))


def _search(variables: _Variables) -> Callable[[], float]:
    """Some iterations of torch's L-BFGS from where the variables are; gives the cost there."""
    optimiser = torch.optim.LBFGS(
        variables.free,
        max_iter=ROUND,
        history_size=MEMORY,
        line_search_fn="strong_wolfe",
        tolerance_grad=0.0,
        tolerance_change=0.0,
    )

    def closure() -> Tensor:
        optimiser.zero_grad()
        cost = variables.cost()
        cost.backward()
        return cost.detach()

    def search() -> float:
        optimiser.step(closure)  # pyright: ignore[reportArgumentType]
        return float(variables.cost().detach())

    return search
