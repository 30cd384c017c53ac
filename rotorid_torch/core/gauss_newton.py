"""Bounded Gauss-Newton: Levenberg-Marquardt damping scaled by the columns, projected active set, least squares by QR.

Knows nothing of flight. The problem is stated by two functions: `evaluate(theta, base, share)` gives the point there
(one simulation; `base` is the point the step started from, `share` the part of their own step that eliminated unknowns
are to make), `linearise(point)` the linear model of its residual (one Jacobian), asked for only after acceptance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares

FLOOR = 1e-12
"""A column of the whitened Jacobian shorter than this is zero."""
ROUNDING = 1e-20
"""Cost over the first cost that is nothing but rounding."""
STIFFEST = 1e4
"""Damping at which the parameters hardly move. A step that needs more waits for what is eliminated to settle; the next
one begins with no more than this, for then they must be able to move again."""
TRIALS = 12
"""Damped steps that one iteration tries."""
NAMED_SHARE = 0.1
"""Share of a direction that cannot be told above which a parameter in it is named."""


class Point(Protocol):
    """A place the optimiser has looked at; the cost is infinite or NaN where there is no solution."""

    @property
    def theta(self) -> Tensor:
        """Parameters [n]."""
        ...

    @property
    def cost(self) -> float:
        """Half the sum of squared residuals, or what has the same gradient there."""
        ...


P = TypeVar("P", bound=Point)
Evaluate = Callable[[Tensor, P | None, float], P]


@dataclass(frozen=True)
class Region:
    """Where parameters may be: bounds [n], infinite where there are none, and a mask [n], False for what is held.

    Where both bounds are finite their distance is also the range beyond which a direction's standard error makes it not
    identifiable (residuals are whitened).
    """

    lower: Tensor
    upper: Tensor
    free: Tensor | None = None

    @property
    def mask(self) -> Tensor:
        """What is free; all where nothing is said."""
        return torch.ones_like(self.lower, dtype=torch.bool) if self.free is None else self.free

    def part(self, which: slice, free: Tensor | None = None) -> Region:
        """The region of some of the parameters."""
        return Region(self.lower[which], self.upper[which], free)

    def on_bound(self, theta: Tensor) -> Tensor:
        """Mask [n] of the parameters on or beyond a bound."""
        return (theta <= self.lower) | (theta >= self.upper)


class Linear(NamedTuple):
    """Near a point the cost is 1/2 |b - A step|^2 plus a constant, A [m, n], b [m].

    `prior_cost` is the decrease that comes with any step, of unknowns that were eliminated from A.
    """

    A: Tensor
    b: Tensor
    prior_cost: float = 0.0

    def decrease(self, step: Tensor) -> float:
        """Predicted for a step, without what is its own."""
        return float(0.5 * (self.b @ self.b - (self.b - self.A @ step).square().sum()))


@dataclass(frozen=True)
class Options:
    """When to stop, and how careful to start.

    max_iterations : all together, those before this search too. before : these.
    """

    max_iterations: int = 50
    tolerance: float = 1e-8  # predicted decrease of the cost, over the cost's size
    absolute: float = 0.0  # the same without that; for a log-likelihood 1e-4 is a hundredth of a standard error
    damping: float = 1e-3
    before: int = 0


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """Where it ended: the point, the linear model there, the masks of the parameters, and a sentence.

    determined : of those whose columns the covariance is of: free, on no bound, and of each direction that the data
    cannot tell one held. Others in such a direction are determined by that one alone, and not identifiable too.
    dampings : Levenberg-Marquardt damping after each accepted step; none of other methods.
    """

    point: P
    linear: Linear
    at_bound: Tensor
    not_identifiable: Tensor
    determined: Tensor
    converged: bool
    message: str
    iterations: int
    history: list[float] = field(default_factory=list)
    dampings: list[float] = field(default_factory=list)


class InfiniteCost(ValueError):
    """A fit cannot begin: its start has no finite cost."""

    def __init__(self) -> None:
        super().__init__("the start has no finite cost")


@dataclass(frozen=True)
class _Subproblem:
    linear: Linear
    region: Region
    lower: Tensor  # of the step
    upper: Tensor
    free: Tensor
    scale: Tensor


def minimise(
    evaluate: Evaluate[P],
    linearise: Callable[[P], Linear],
    start: Tensor | P,
    region: Region,
    options: Options | None = None,
    monitor: Callable[[int, float, Tensor], None] | None = None,
) -> Minimum[P]:
    """Minimum of half a sum of squares within bounds.

    evaluate : the point at theta [n]; must not fail, a cost of infinity or NaN rejects the step.
    linearise : linear model of the residual at an accepted point.
    start : parameters [n], or a point already evaluated.
    monitor : called after each accepted step with iteration, cost, theta.

    Raises InfiniteCost: the start has none that is finite.

    Source: Levenberg (1944), Marquardt (1963); projected active set: Bertsekas (1982), SIAM J. Control Optim. 20(2);
    held directions: Jategaonkar, Flight Vehicle System Identification, sec. 4.
    """
    options = options or Options()
    point = evaluate(torch.clamp(start, region.lower, region.upper), None, 1.0) if isinstance(start, Tensor) else start
    damping, history, message, converged, iteration = options.damping, [point.cost], "", False, options.before
    dampings: list[float] = []
    while True:
        linear = linearise(point)
        if not math.isfinite(point.cost):
            raise InfiniteCost
        problem, _ = _subproblem(linear, point.theta, region)
        whole = linear.decrease(_bounded_step(problem, 0.0)) + linear.prior_cost
        if whole <= options.tolerance * abs(point.cost) + options.absolute + ROUNDING * abs(history[0]):
            converged, message = True, "converged: the predicted decrease is below the tolerance"
            break
        if iteration >= options.max_iterations:
            message = f"stopped after {iteration} iterations"
            break
        better, damping = _descend(evaluate, point, problem, damping)
        if better is None:
            converged = whole <= 1e-6 * abs(point.cost)
            message = "converged: no step lowers the cost" if converged else "no step lowers the cost"
            break
        point, iteration = better, iteration + 1
        history.append(point.cost)
        dampings.append(damping)
        if monitor is not None:
            monitor(iteration, point.cost, point.theta)
    return Minimum(point, linear, *masks(linear, point.theta, region), converged, message, iteration, history, dampings)


def masks(linear: Linear, theta: Tensor, region: Region) -> tuple[Tensor, Tensor, Tensor]:
    """Masks [n] of the parameters at a point: on a bound, not identifiable, determined, as `Minimum` has them."""
    problem, blind = _subproblem(linear, theta, region)
    on_bound = region.mask & region.on_bound(theta)
    return on_bound, region.mask & blind, problem.free & ~on_bound


def _subproblem(linear: Linear, theta: Tensor, region: Region) -> tuple[_Subproblem, Tensor]:
    """The bounded linear problem at a point, directions that the data cannot tell held; and the mask of those named."""
    (A, b, prior_weight), lower, upper = linear, region.lower, region.upper
    norms = torch.linalg.vector_norm(A, dim=0)
    A, norms = (torch.where(norms.isfinite(), part, 0.0) for part in (A, norms))  # what has exploded tells nothing
    zero = norms <= FLOOR
    gradient = -(A.mT @ b)
    inward = ~(((theta <= lower) & (gradient > 0)) | ((theta >= upper) & (gradient < 0)))
    mask = region.mask & inward & ~zero
    mask, named = _determined(A, norms, upper - lower, mask)
    scale = torch.where(zero, torch.ones_like(norms), norms)
    linear = Linear(A, b, prior_weight)
    return _Subproblem(linear, region, lower - theta, upper - theta, mask, scale), zero | named


def _determined(A: Tensor, norms: Tensor, span: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """The mask without a parameter for each direction that the data cannot tell, and all parameters in such directions.

    A direction cannot be told where its standard error exceeds the bounds' range, without finite bounds where it is
    singular to working precision. The parameter with the largest part in it is held, the others follow from it.
    A column that explodes counts no more than rounding allows, lest its rounding tell what nothing does.
    """
    mask, named = mask.clone(), torch.zeros_like(mask)
    size = torch.where(torch.isfinite(span), torch.minimum(span, 1e12 / norms), 1e9 / norms)
    while bool(mask.any()):
        place = mask.nonzero()[:, 0]
        if _surely_determined((A * size)[:, mask]):
            break
        _, values, rows = torch.linalg.svd((A * size)[:, mask], full_matrices=True)
        blind = len(place) - int((values >= 1.0).sum())
        if not blind:
            break
        held, inside = _dependent_places(rows[-blind:].flip(0))
        named[place[inside]] = True
        mask[place[held]] = False
    return mask, named


def _dependent_places(directions: Tensor) -> tuple[list[int], Tensor]:
    """Places that are held, one for each of some directions [k, n], the blindest first; and a mask [n] of all in them.

    What is left of the directions after a place is held are those of the other places. As many would be held one after
    the other: without a column, the singular values lie between those before.
    """
    directions, held = directions.clone(), []
    inside = torch.zeros(directions.shape[1], dtype=torch.bool)
    for k in range(len(directions)):
        direction = directions[k] / torch.linalg.vector_norm(directions[k])
        place = int(direction.abs().argmax())
        inside |= direction.square() > NAMED_SHARE
        held.append(place)
        directions -= torch.outer(directions[:, place] / direction[place], direction)
    return held, inside


def _surely_determined(A: Tensor) -> bool:
    """Whether no singular value is below 1, by a bound that needs no singular values: a third of their time."""
    if A.shape[0] < A.shape[1]:
        return False
    triangle = torch.linalg.qr(A, mode="r").R
    if bool((triangle.diagonal() == 0.0).any()):
        return False
    inverse = torch.linalg.solve_triangular(triangle, torch.eye(len(triangle)).to(triangle), upper=True)
    return float(torch.linalg.matrix_norm(inverse)) <= 1.0


def _bounded_step(problem: _Subproblem, damping: float) -> Tensor:
    """Step of the damped problem within the bounds: who would cross is set on its bound, the rest solved again."""
    A, b, _ = problem.linear
    if damping > 0.0:
        A = torch.cat([A, torch.diag(damping**0.5 * problem.scale)])
        b = torch.cat([b, torch.zeros_like(problem.scale)])
    scaled = A / problem.scale
    move = problem.free.clone()
    step = torch.zeros_like(problem.lower)
    while bool(move.any()):
        remainder = b - A[:, ~move] @ step[~move]
        step[move] = least_squares(scaled[:, move], remainder.unsqueeze(-1))[:, 0] / problem.scale[move]
        inside = torch.clamp(step, problem.lower, problem.upper)
        crossed = move & (inside != step)
        if not bool(crossed.any()):
            break
        step = torch.where(crossed, inside, step)
        move = move & ~crossed
    return step


def _moved(theta: Tensor, step: Tensor, problem: _Subproblem) -> Tensor:
    """Theta after the step, exactly on a bound where the step ends there."""
    on_bound = (step <= problem.lower) | (step >= problem.upper)
    bound = torch.where(step <= problem.lower, problem.region.lower, problem.region.upper)
    return torch.where(on_bound, bound, theta + step)


def _descend(evaluate: Evaluate[P], point: P, problem: _Subproblem, damping: float) -> tuple[P | None, float]:
    """The first damped step that lowers the cost, and the damping to go on with."""
    for attempt in range(TRIALS):
        step = _bounded_step(problem, damping)
        share = 0.5 ** max(attempt - 2, 0)
        trial = evaluate(_moved(point.theta, step, problem), point, share)
        predicted = problem.linear.decrease(step) + (2.0 - share) * share * problem.linear.prior_cost
        gain = (point.cost - trial.cost) / max(predicted, 1e-300)
        if trial.cost < point.cost and gain > 1e-4:
            if gain > 0.75:
                damping = damping / 10.0 if damping > 1e-10 else 0.0
            elif gain < 0.25:
                damping = max(damping, 1e-6) * 4.0
            return trial, min(damping, STIFFEST)
        damping = max(damping, 1e-5) * 8.0
    return None, damping
