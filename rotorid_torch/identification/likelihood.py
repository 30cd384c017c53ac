"""The output-error likelihood of segments: whitened residuals, linear model, initial states and biases eliminated."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from rotorid_torch.identification.gauss_newton import Linear
from rotorid_torch.identification.segments import Records, Segments
from rotorid_torch.identification.sensitivity import Run, corrected, sensitivities, simulated
from rotorid_torch.identification.system import System

WEAK = 1e-9
"""Weight that keeps an initial state no output depends on where it is, relative to its column."""

LEAST_EIGENVALUE = 1e-6
"""Of the residuals' correlation matrix."""


@dataclass(frozen=True)
class Noise:
    """How the residual's covariance comes about.

    `kind` "diagonal" or "full" is estimated from the residuals themselves, at least `floor` (standard deviations [ny]);
    "held" is `matrix` [ny, ny].
    """

    kind: str
    floor: Tensor
    matrix: Tensor | None = None

    def covariance(self, residual: Tensor) -> Tensor:
        """[ny, ny] from residuals [S, T, ny], NaN = missing."""
        if self.matrix is not None:
            return self.matrix
        valid = ~residual.isnan()
        filled = torch.where(valid, residual, 0.0).flatten(0, 1)
        count = valid.flatten(0, 1).to(filled)
        if self.kind == "diagonal":
            return torch.diag(torch.maximum(filled.square().sum(0) / count.sum(0).clamp_min(1.0), self.floor**2))
        pairs = filled.mT @ filled / (count.mT @ count).clamp_min(1.0)
        return _definite(pairs + torch.diag((self.floor**2 - pairs.diagonal()).clamp_min(0.0)))


def _definite(covariance: Tensor) -> Tensor:
    """With the correlations' eigenvalues at least so large that it can be inverted."""
    sd = covariance.diagonal().clamp_min(1e-300).sqrt()
    values, vectors = torch.linalg.eigh(covariance / sd / sd[:, None])
    return (vectors * values.clamp_min(LEAST_EIGENVALUE)) @ vectors.mT * sd * sd[:, None]


@dataclass(frozen=True)
class Whitener:
    """Residuals and their derivatives in units of the noise; missing samples become zero, exactly as if left out."""

    covariance: Tensor
    valid: Tensor  # [S, T, ny]
    table: Tensor | None = None  # [patterns, ny, ny] for a full covariance
    pattern: Tensor | None = None  # [S, T]

    @classmethod
    def of(cls, covariance: Tensor, valid: Tensor) -> Whitener:
        """With one whitening matrix for each pattern of missing channels."""
        if bool((covariance == torch.diag(covariance.diagonal())).all()):
            return cls(covariance, valid)
        rows, pattern = torch.unique(valid.flatten(0, 1), dim=0, return_inverse=True)
        table = covariance.new_zeros(len(rows), *covariance.shape)
        for k, row in enumerate(rows):
            there = row.nonzero()[:, 0]
            chosen = covariance[there[:, None], there]
            inverse = torch.linalg.solve_triangular(
                torch.linalg.cholesky(chosen), torch.eye(len(there)).to(chosen), upper=False
            )
            table[k, there[:, None], there] = inverse
        return cls(covariance, valid, table, pattern.view(valid.shape[:2]))

    def apply(self, values: Tensor, first: int = 0) -> Tensor:
        """Values [S, k, ny, n] of the samples from `first` on."""
        part = slice(first, first + values.shape[1])
        values = torch.where(self.valid[:, part, :, None], values, 0.0)
        if self.table is None or self.pattern is None:
            return values / self.covariance.diagonal().sqrt()[:, None]
        return self.table[self.pattern[:, part]] @ values

    def log_determinant(self) -> float:
        """Of the covariance, summed over the samples."""
        if self.table is None or self.pattern is None:
            return float((self.valid.sum(dim=(0, 1)) * self.covariance.diagonal().log()).sum())
        diagonals = self.table.diagonal(dim1=-2, dim2=-1)
        logs = -2.0 * torch.where(diagonals > 0, diagonals, 1.0).log().sum(-1)
        return float(logs[self.pattern].sum())


@dataclass(frozen=True)
class Locals:
    """How initial states and biases follow a step of the shared parameters: triangles of the elimination."""

    segment: Tensor  # [S, nx, nx + nb + P + 1]
    flight: Tensor  # [F, nb, nb + P + 1]

    def move(self, step: Tensor, flight: Tensor, share: float) -> tuple[Tensor, Tensor]:
        """Steps of the initial states [S, nx] and of the biases [F, nb], `share` of their own."""
        return self.carry(step, flight, share * self.segment[:, :, -1], share * self.flight[:, :, -1])

    def carry(self, step: Tensor, flight: Tensor, own: Tensor, own_bias: Tensor) -> tuple[Tensor, Tensor]:
        """The same for any steps of their own, in units of their standard errors: [S, nx] and [F, nb]."""
        bias = _back(self.flight, own_bias, step.expand(len(self.flight), -1))
        return _back(self.segment, own, torch.cat([bias[flight], step.expand(len(flight), -1)], dim=1)), bias

    def own(self) -> float:
        """Decrease of the cost by initial states and biases alone."""
        return 0.5 * float(self.segment[:, :, -1].square().sum() + self.flight[:, :, -1].square().sum())


def _back(triangles: Tensor, own: Tensor, known: Tensor) -> Tensor:
    n = own.shape[1]
    rest = own - (triangles[:, :, n:-1] @ known.unsqueeze(-1)).squeeze(-1)
    return torch.linalg.solve_triangular(triangles[:, :, :n], rest.unsqueeze(-1), upper=True).squeeze(-1)


@dataclass
class Place:
    """A place in the space of parameters, initial states and biases, with all that is known of it."""

    theta: Tensor
    x0: Tensor  # [S, nx]
    bias: Tensor  # [F, nb]
    run: Run
    residual: Tensor  # [S, T, ny] measured - model, NaN = missing
    whitener: Whitener
    cost: float
    locals: Locals | None = None
    transitions: Tensor | None = None
    flights: list[tuple[Tensor, Tensor]] = field(default_factory=list)

    def pick(self, which: Tensor) -> Place:
        """The same for some of the segments, without the linear model."""
        run = Run(self.run.theta, self.run.controls[which], self.run.states[which], self.run.outputs[which])
        w = self.whitener
        pattern = None if w.pattern is None else w.pattern[which]
        whitener = Whitener(w.covariance, w.valid[which], w.table, pattern)
        return Place(self.theta, self.x0[which], self.bias, run, self.residual[which], whitener, self.cost)


@dataclass(frozen=True)
class Likelihood:
    """Minus log-likelihood of the segments (up to a constant), the noise's covariance being its best value throughout.

    Parameters
    ----------
    prior_mean, prior_sd : [P] Gaussian prior of the parameters, infinite sd where there is none.
    states : [F, T, nx] trajectories to start from, NaN where nothing is known.
    x0 : [S, nx] where initial states start from; they are held there where `x0_sd` is None.
    x0_mean, x0_sd : [S, nx] prior of the initial states, infinite sd where there is none.
    bias_sd : [ny] prior about zero of a constant per flight and output: 0 for none, infinite for a free one.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), sec. 6.3; Jategaonkar, Flight Vehicle System
    Identification, sec. 4.
    """

    system: System
    records: Records
    segments: Segments
    states: Tensor
    noise: Noise
    x0: Tensor
    x0_mean: Tensor
    x0_sd: Tensor | None
    prior_mean: Tensor
    prior_sd: Tensor
    bias_sd: Tensor
    solver: str = "rk4"

    @property
    def biased(self) -> Tensor:
        """Outputs with a constant per flight."""
        return (self.bias_sd > 0).nonzero()[:, 0]

    @property
    def locals_per_segment(self) -> int:
        """Initial states estimated per segment."""
        return 0 if self.x0_sd is None else self.x0.shape[-1]

    def evaluate(self, theta: Tensor, base: Place | None = None, share: float = 1.0) -> Place:
        """The place at theta: initial states and biases follow from the linear model at `base`."""
        x0, bias, run = self.x0, self.x0.new_zeros(len(self.records.lengths), len(self.biased)), None
        near, transitions = self._guess(), None
        if base is not None and base.locals is not None:
            x0_step, bias_step = base.locals.move(theta - base.theta, self.segments.flight, share)
            x0, bias = base.x0 + (x0_step if self.x0_sd is not None else 0.0), base.bias + bias_step
            near, transitions = base.run.states, base.transitions
        if self.solver == "rk4":
            run = corrected(self.system, theta, self.records, self.segments, x0, near, transitions)
        if run is None:
            run = simulated(self.system, theta, self.records, self.segments, x0, self.solver)
        return self.place(theta, x0, bias, run)

    def _guess(self) -> Tensor:
        """Trajectories [S, T, nx] to start from: what is known of the states, else the initial ones."""
        known = self.segments.take(self.states)
        return torch.where(known.isnan(), self.x0[:, None], known)

    def place(self, theta: Tensor, x0: Tensor, bias: Tensor, run: Run) -> Place:
        """What a run says: residual, noise, cost."""
        constants = torch.zeros(len(bias), run.outputs.shape[-1], dtype=bias.dtype).index_copy(1, self.biased, bias)
        residual = self.segments.outputs - run.outputs - constants[self.segments.flight][:, None]
        valid = ~self.segments.outputs.isnan()
        seen = residual.detach().masked_fill(~valid, math.nan)
        if not bool(torch.isfinite(seen[valid]).all()):
            unit = torch.eye(seen.shape[-1], dtype=seen.dtype)
            return Place(theta, x0, bias, run, residual, Whitener(unit, valid), math.inf)
        whitener = Whitener.of(self.noise.covariance(seen), valid)
        place = Place(theta, x0, bias, run, residual, whitener, math.inf)
        cost = float(self.total(place).detach())
        place.cost = cost if math.isfinite(cost) else math.inf
        return place

    def total(self, place: Place) -> Tensor:
        """Minus log-likelihood and priors at a place; its gradient is right although the noise's covariance is held."""
        white = place.whitener.apply(place.residual.unsqueeze(-1))
        rows = [
            white.flatten(),
            self.prior_rows(place)[1],
            self._x0_rows(place).flatten(),
            self._bias_rows(place).flatten(),
        ]
        spread = 0.0 if self.noise.matrix is not None else 0.5 * place.whitener.log_determinant()
        return 0.5 * torch.cat(rows).square().sum() + spread

    def prior_rows(self, place: Place) -> tuple[Tensor, Tensor]:
        """Rows of the parameters' prior."""
        there = torch.isfinite(self.prior_sd)
        rows = torch.diag(1.0 / self.prior_sd)[there]
        return rows, (self.prior_mean - place.theta)[there] / self.prior_sd[there]

    def _x0_rows(self, place: Place) -> Tensor:
        return self.x0.new_zeros(0) if self.x0_sd is None else (self.x0_mean - place.x0) / self.x0_sd

    def _bias_rows(self, place: Place) -> Tensor:
        return -place.bias / self.bias_sd[self.biased]

    @torch.no_grad()
    def linearise(self, place: Place) -> Linear:
        """Linear model of the whitened residual in the shared parameters; the place remembers the elimination."""
        nx, nb = self.locals_per_segment, len(self.biased)
        triangles, transitions = self._triangles(place)
        place.transitions = transitions
        flights = []
        for f in range(len(self.records.lengths)):
            rows = triangles[self.segments.flight == f][:, nx:, nx:].flatten(0, 1)
            pull = rows.new_zeros(nb, rows.shape[1])
            pull[:, :nb] = torch.diag(1.0 / self.bias_sd[self.biased])
            pull[:, -1] = self._bias_rows(place)[f]
            flights.append(torch.linalg.qr(torch.cat([rows, pull]), mode="r").R)
        stack = torch.stack([_square(r) for r in flights])
        place.locals = Locals(triangles[:, :nx], stack[:, :nb])
        place.flights = [(r[nb:, nb:-1], r[nb:, -1]) for r in stack]
        A, b = self.prior_rows(place)
        A, b = torch.cat([a for a, _ in place.flights] + [A]), torch.cat([c for _, c in place.flights] + [b])
        return Linear(A, b, place.locals.own())

    def _triangles(self, place: Place) -> tuple[Tensor, Tensor]:
        """QR of each segment's rows [initial state | bias | theta | residual], block by block; and the transitions."""
        triangles, transitions = None, []
        for rows, more in self.rows(place):
            stack = rows if triangles is None else torch.cat([triangles, rows], dim=1)
            triangles = torch.linalg.qr(stack, mode="r").R
            transitions.append(more)
        assert triangles is not None
        return self._with_x0_prior(triangles, place), torch.cat(transitions)

    def _with_x0_prior(self, triangles: Tensor, place: Place) -> Tensor:
        nx, width = self.locals_per_segment, triangles.shape[-1]
        pull = triangles.new_zeros(len(triangles), 2 * nx, width)
        if self.x0_sd is not None:
            pull[:, :nx, :nx] = torch.diag_embed(1.0 / self.x0_sd)
            pull[:, :nx, -1] = self._x0_rows(place)
            norms = torch.linalg.vector_norm(triangles[:, :, :nx], dim=1)
            pull[:, nx:, :nx] = torch.diag_embed(WEAK * norms + 1e-12)
        triangles = torch.linalg.qr(torch.cat([triangles, pull], dim=1), mode="r").R
        return _square(triangles)

    def rows(self, place: Place) -> Iterator[tuple[Tensor, Tensor]]:
        """Whitened rows [S, k ny, nx + nb + P + 1] of successive blocks of samples, and the steps' transitions."""
        skip = place.run.states.shape[-1] - self.locals_per_segment
        constant = torch.eye(place.residual.shape[-1], dtype=torch.float64)[:, self.biased]
        for block in sensitivities(self.system, place.run, self.records, self.segments):
            slopes = block.outputs[..., skip:].transpose(0, 1)
            k, nx = slopes.shape[1], self.locals_per_segment
            residual = place.residual[:, block.first : block.first + k].unsqueeze(-1)
            parts = [slopes[..., :nx], constant.expand(*slopes.shape[:2], *constant.shape), slopes[..., nx:], residual]
            yield place.whitener.apply(torch.cat(parts, dim=-1), block.first).flatten(1, 2), block.transitions

    def with_pieces(self, which: Tensor) -> Likelihood:
        """The same for some of the segments."""
        sd = None if self.x0_sd is None else self.x0_sd[which]
        return replace(
            self, segments=self.segments.pick(which), x0=self.x0[which], x0_mean=self.x0_mean[which], x0_sd=sd
        )


def _square(triangles: Tensor) -> Tensor:
    """Triangles [..., m, n] with m <= n filled up with rows of zeros."""
    missing = triangles.shape[-1] - triangles.shape[-2]
    return torch.nn.functional.pad(triangles, (0, 0, 0, missing)) if missing > 0 else triangles
