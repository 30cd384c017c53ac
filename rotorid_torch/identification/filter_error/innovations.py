"""The likelihood of innovations: Gauss-Newton's view of the extended Kalman filter, initial states eliminated.

Cost, gradient and Fisher's information are exact for the filter's own model: state, covariance and gain move with every
unknown. The filter runs in native code where the model can be compiled, else in torch.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Linear
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.core.native.innovations import FlightsToFollow, Innovations
from rotorid_torch.core.native.observer import Gains
from rotorid_torch.errors import say_once
from rotorid_torch.identification.estimate.sensitivity import control_slopes, controls_at, with_time
from rotorid_torch.identification.filter_error.extended_kalman import FilterProblem, KalmanRun, filtered, rows

SINGULAR = 1e-13
"""Eigenvalue of scaled normal equations, over the largest, below which a direction is nothing but rounding."""


class LikelihoodEngine(Protocol):
    """What the likelihood asks of an engine."""

    def cost(self, psi: Tensor, x0: Tensor) -> Tensor:
        """[F] from x0 [F, nx]."""
        ...

    def normal_equations(self, psi: Tensor, x0: Tensor) -> Tensor:
        """Products of the rows' columns of each flight [F, nx + n + 1, nx + n + 1]: x0, psi, b."""
        ...


@dataclass(frozen=True, eq=False)
class FilterEngine(ABC):
    """What a filter can tell of flights beyond that."""

    problem: FilterProblem

    @abstractmethod
    def filter(self, psi: Tensor, x0: Tensor) -> KalmanRun:
        """The flights filtered from x0 [F, nx], with all histories."""

    @abstractmethod
    def cost(self, psi: Tensor, x0: Tensor) -> Tensor:
        """[F] from x0 [F, nx]."""

    @abstractmethod
    def rows(self, psi: Tensor, x0: Tensor) -> Tensor:
        """The rows themselves [F, T, ny + ny (ny + 1) / 2, nx + n + 1], those of innovations first."""

    def normal_equations(self, psi: Tensor, x0: Tensor) -> Tensor:
        """Products of the rows' columns of each flight [F, nx + n + 1, nx + n + 1]: x0, psi, b."""
        flat = self.rows(psi, x0).flatten(1, 2)
        return flat.mT @ flat


@dataclass(frozen=True, eq=False)
class TorchFilter(FilterEngine):
    """Any module."""

    def filter(self, psi: Tensor, x0: Tensor) -> KalmanRun:
        """See `FilterEngine`."""
        return filtered(self.problem, psi, x0)

    def cost(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        return filtered(self.problem, psi, x0).cost

    def rows(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        return torch.cat(rows(self.problem, psi, x0), dim=2)


@dataclass(frozen=True, eq=False)
class NativeFilter(FilterEngine):
    """A module that has become native code.

    timed : whether the rates depend on time, which then is one more control.
    """

    compiled: Innovations
    timed: bool
    variants: dict[tuple[int, ...], Innovations] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: FilterProblem, psi: Tensor, held: int = 0) -> Self:
        """Trace the problem at the mean of the known states; the first `held` of psi are no unknowns.

        Raises Unsupported: it holds an operation that native code does not know, or there is no compiler.
        """
        records = problem.records
        x = records.states.flatten(0, 1).nan_to_num(0.0).mean(dim=0)
        u = records.controls[0, 0]
        nu = len(u)

        def parts(x: Tensor, u: Tensor, psi: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
            theta, Q, R = problem.split(psi)
            return *problem.system.motion(theta, u[nu], x, u[:nu]), Q, R

        compiled = Innovations.of(parts, x, torch.cat([u, u.new_zeros(1)]), psi, held)
        timed = compiled.depends_on("u", nu)
        engine = cls(problem, compiled if timed else replace(compiled, nu=nu), timed)
        flown, _ = engine.flown(psi, records.states[:, 0])
        flown.build()  # now: what cannot be compiled is told before anything depends on it
        return engine

    def filter(self, psi: Tensor, x0: Tensor) -> KalmanRun:
        """See `FilterEngine`."""
        compiled, flights = self.flown(psi, x0)
        answer = compiled.filter(psi, flights, threads(), histories=True)
        diverged = (answer.lost[:, 0] >= 0).nonzero()[:, 0].tolist()
        lost = (diverged[0], *answer.lost[diverged[0]].tolist()) if diverged else None
        return KalmanRun(answer.cost, *answer.histories(), lost)

    def gains(self, psi: Tensor, x0: Tensor) -> Gains:
        """How the filter follows the flights."""
        compiled, flights = self.flown(psi, x0)
        answer = compiled.filter(psi, flights, threads(), histories=True)
        assert answer.gains is not None
        assert answer.white is not None
        return Gains(answer.gains.nan_to_num(0.0), answer.white.nan_to_num(0.0))

    def cost(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        compiled, flights = self.flown(psi, x0)
        return compiled.filter(psi, flights, threads()).cost

    def normal_equations(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        compiled, flights = self.flown(psi, x0)
        return compiled.normal_equations(psi, flights, threads())[1]

    def rows(self, psi: Tensor, x0: Tensor) -> Tensor:
        """See `FilterEngine`."""
        compiled, flights = self.flown(psi, x0)
        return compiled.rows(psi, flights, threads())

    def flown(self, psi: Tensor, x0: Tensor) -> tuple[Innovations, FlightsToFollow]:
        """The code for what the controls depend on, and the flights with these controls."""
        problem, segments = self.problem, self.problem.segments
        theta = psi[: len(problem.system.theta)]
        controls = controls_at(problem.system, theta, problem.records, segments)
        which, slopes = control_slopes(problem.system, theta, problem.records, segments)
        if self.timed:
            controls = with_time(controls, segments)
            slopes = torch.nn.functional.pad(slopes, (0, 0, 0, 1))
        key = () if self.compiled.held else tuple(which.tolist())
        if key not in self.variants:
            self.variants[key] = replace(self.compiled, path=key)
        length = segments.inside.sum(dim=1).to(torch.int32)
        start = x0.contiguous(), problem.P0.expand(len(x0), -1, -1).contiguous()
        records = controls.contiguous(), slopes, segments.outputs.contiguous()
        return self.variants[key], FlightsToFollow(segments.dt, length, *records, *start)


def filter_engine(problem: FilterProblem, psi: Tensor, wanted: str | None = None) -> FilterEngine:
    """Native code where the problem can be compiled; torch otherwise, with a line of why.

    wanted : "native" (which may then raise) or "reference", to choose.
    """
    if wanted == "reference":
        return TorchFilter(problem)
    try:
        return NativeFilter.of(problem, psi)
    except Unsupported as error:
        if wanted == "native":
            raise
        records = problem.records
        first = records.start, records.states[:, 0].nan_to_num(0.0), records.controls[:, 0]
        problem.system.refuse_numbers(problem.split(psi)[0], *first)
        say_once(f"the filter runs in torch, many times slower than compiled: {error}")
        return TorchFilter(problem)


@dataclass
class FilterPlace:
    """A place in the space of unknowns: psi [n] (what flights share), x0 [F, nx], the cost.

    moves : [F, nx, n + 1] how the initial states follow psi, and their own step. flights : each one's linear model.
    """

    theta: Tensor
    x0: Tensor
    cost: float
    moves: Tensor | None = None
    flights: list[tuple[Tensor, Tensor]] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class InnovationLikelihood:
    """Minus log-likelihood of the innovations (up to a constant).

    x0 : [F, nx] initial states, to start from or, where they are not free, to hold.
    """

    engine: LikelihoodEngine
    x0: Tensor
    free: bool

    def evaluate(self, psi: Tensor, base: FilterPlace | None = None, share: float = 1.0) -> FilterPlace:
        """The place at psi: initial states follow from the linear model at `base`."""
        x0 = self.x0
        if base is not None and base.moves is not None:
            x0 = base.x0 + share * base.moves[..., -1] - base.moves[..., :-1] @ (psi - base.theta)
        return self.at(psi, x0)

    def at(self, psi: Tensor, x0: Tensor) -> FilterPlace:
        """The place at psi and x0."""
        cost = float(self.engine.cost(psi, x0).sum())
        return FilterPlace(psi, x0, cost if math.isfinite(cost) else math.inf)

    def linearise(self, place: FilterPlace) -> Linear:
        """Linear model in psi; the place remembers the elimination of the initial states."""
        H = self.engine.normal_equations(place.theta, place.x0)
        nx = H.shape[-1] - 1 - len(place.theta)  # none where they are no unknowns
        reduced, prior_cost = H[:, nx:, nx:], 0.0
        if self.free:
            place.moves = solved(H[:, :nx, :nx], H[:, :nx, nx:])
            reduced = reduced - H[:, nx:, :nx] @ place.moves
            prior_cost = float(0.5 * (H[:, :nx, -1] * place.moves[..., -1]).sum())
        place.flights = [linear_model(one) for one in reduced]
        return Linear(*linear_model(reduced.sum(dim=0)), prior_cost)


def solved(H: Tensor, right: Tensor) -> Tensor:
    """H^+ right for symmetric H [..., n, n] that may be singular: what nothing tells stays where it is."""
    size = H.diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()
    scale = torch.where(size > 0.0, 1.0 / size, 0.0)
    values, vectors = torch.linalg.eigh(H * scale[..., :, None] * scale[..., None, :])
    inverse = torch.where(values > SINGULAR * values[..., -1:], 1.0 / values, 0.0)
    turned = vectors.mT @ (right * scale.unsqueeze(-1))
    return (vectors @ (turned * inverse.unsqueeze(-1))) * scale.unsqueeze(-1)


def linear_model(products: Tensor) -> tuple[Tensor, Tensor]:
    """A [n, n] and b [n] with the products [n + 1, n + 1] of the columns of A and b."""
    size = products.diagonal()[:-1].clamp_min(0.0).sqrt()
    scale = torch.where(size > 0.0, 1.0 / size, 0.0)
    values, vectors = torch.linalg.eigh(products[:-1, :-1] * scale[:, None] * scale)
    root = torch.where(values > SINGULAR * values[-1], values.clamp_min(0.0), 0.0).sqrt()
    b = torch.where(root > 0.0, (vectors.mT @ (products[:-1, -1] * scale)) / root.clamp_min(1e-300), 0.0)
    return root[:, None] * vectors.mT * size, b
