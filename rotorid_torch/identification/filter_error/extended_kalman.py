"""The extended Kalman filter of a module with process noise: innovations, their covariances, derivatives of both.

Between samples, state and covariance are integrated together by one Runge-Kutta step,

    dx/dt = f(x, u),   dP/dt = A P + P A' + Q,   A = df/dx at the estimate,

so that the step that moves the state also moves its uncertainty, whatever the sample interval; Q is a spectral density
(covariance per second). At a sample the measured outputs correct both. The gain varies with time: it follows the
estimate through a non-linear model, and is exact where samples are missing and at the start of a flight, which a
steady gain is not. Initial states are numbers to estimate or to believe, with a covariance of their own: without one,
noise that vanishes would explain the first sample exactly, and the likelihood would have no maximum.

Source: Jategaonkar, Flight Vehicle System Identification, ch. 5; Gelb, Applied Optimal Estimation, sec. 6.1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor
from torch.func import jvp, vmap

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, Sizes
from rotorid_torch.core.integrate import NODES, step_stages
from rotorid_torch.identification.estimate.segments import Records, Segments, cut
from rotorid_torch.identification.estimate.sensitivity import controls_at
from rotorid_torch.identification.estimate.system import System, by_inputs


@dataclass(frozen=True)
class CovarianceForm:
    """A covariance as a function of free numbers, positive semi-definite whatever they are: L D L'.

    names, units : of the rows. which : rows that are not zero. full : whether L has entries below its diagonal of ones.
    matrix : [size, size] to hold, without any free number.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    which: tuple[int, ...]
    full: bool = False
    matrix: Tensor | None = None

    @property
    def size(self) -> int:
        """Rows."""
        return len(self.names)

    @cached_property
    def below(self) -> list[tuple[int, int]]:
        """Places in `which` of the entries below the diagonal of L."""
        m = len(self.which) if self.full else 0
        return [(i, j) for i in range(m) for j in range(i)]

    @property
    def count(self) -> int:
        """Free numbers: D, then L row by row."""
        return 0 if self.matrix is not None else len(self.which) + len(self.below)

    def at(self, numbers: Tensor) -> Tensor:
        """The covariance [size, size] of the numbers [count]."""
        if self.matrix is not None:
            return self.matrix
        m, zero, one = len(self.which), numbers.new_zeros(()), numbers.new_ones(())
        place = {pair: m + k for k, pair in enumerate(self.below)}
        entry = lambda i, j: one if i == j else numbers[place[i, j]] if (i, j) in place else zero  # noqa: E731
        rows = [[zero] * self.size for _ in range(self.size)]
        for i, a in enumerate(self.which):
            for j, b in enumerate(self.which[: i + 1]):
                if i == j or self.full:
                    terms = [entry(i, k) * entry(j, k) * numbers[k] for k in (range(j + 1) if self.full else (i,))]
                    rows[a][b] = rows[b][a] = sum(terms, start=zero)
        return torch.stack([torch.stack(row) for row in rows]) if rows else numbers.new_zeros(0, 0)

    def numbers(self, variances: Tensor) -> Tensor:
        """Free numbers [count] of a diagonal covariance with variances [size]."""
        if self.matrix is not None:
            return variances.new_zeros(0)
        return torch.cat([variances[list(self.which)], variances.new_zeros(len(self.below))])

    def lower(self, variances: Tensor) -> Tensor:
        """Lower bounds [count], the diagonal's being variances [size]; there are no upper ones."""
        below = torch.full((self.count,), -torch.inf, dtype=torch.float64)
        if self.matrix is None:
            below[: len(self.which)] = variances[list(self.which)]
        return below


def form(key: str, wanted: str | Sequence[str] | Tensor, names: Sequence[str], units: Sequence[str]) -> CovarianceForm:
    """The form that "diagonal", "full", names of rows, or a matrix to hold asks for.

    Raises InputError where a name is unknown, or the matrix is no covariance.
    """
    names, units = tuple(names), tuple(units)
    everything, argument = tuple(range(len(names))), Argument("arguments", key)
    if arguments.is_word(wanted):
        wanted = arguments.word(argument, wanted, ("diagonal", "full"), ", a list of states, or a matrix")
        return CovarianceForm(names, units, everything, wanted == "full")
    listed = list(wanted) if isinstance(wanted, Iterable) and not hasattr(wanted, "__array__") else [wanted]
    if all(isinstance(name, str) for name in listed):
        chosen = arguments.names(argument, listed, names, "state")
        if not chosen:
            raise argument.wrong("names no state", f"some of {arguments.listed(names)}, or a matrix of zeros for none")
        return CovarianceForm(names, units, tuple(i for i, name in enumerate(names) if name in chosen))
    n = len(names)
    matrix = arguments.covariance(argument, wanted, f"{n} {n}", Sizes())
    return CovarianceForm(names, units, everything, matrix=(matrix + matrix.mT) / 2.0)


@dataclass(frozen=True, eq=False)
class FilterProblem:
    """What is filtered: flights, a system, and how its process noise and its outputs' noise come about.

    The unknowns are psi [n]: the system's parameters, the numbers of `process`, those of `noise`; and the
    mean x0 [F, nx] of the initial states, whose covariance P0 [nx, nx] is held.
    """

    system: System
    records: Records
    process: CovarianceForm
    noise: CovarianceForm
    P0: Tensor

    @cached_property
    def segments(self) -> Segments:
        """The flights, whole."""
        return cut(self.records, int(self.records.lengths.max()))

    @cached_property
    def samples(self) -> int:
        """Measured values, all outputs together."""
        return int((~self.segments.outputs.isnan()).sum())

    def alone(self, flight: int) -> FilterProblem:
        """The same for one of the flights."""
        return replace(self, records=self.records.pick(torch.tensor([flight])))

    def split(self, psi: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Parameters, spectral density of the process noise [nx, nx], covariance of the outputs' noise [ny, ny]."""
        theta, q, r = psi.split([len(self.system.theta), self.process.count, self.noise.count])
        return theta, self.process.at(q), self.noise.at(r)


@dataclass(frozen=True, eq=False)
class KalmanRun:
    """Flights filtered; F of T samples each.

    cost : [F] half of the sum of e' S^-1 e + log det S; infinite where the filter diverged. innovations : [F, T, ny],
    NaN = missing. spreads : [F, T, ny, ny] their covariances; the identity's rows where samples are missing.
    states, covariances : [F, T, nx], [F, T, nx, nx] after each sample.
    lost : flight, sample and state where it diverged.
    """

    cost: Tensor
    innovations: Tensor
    spreads: Tensor
    states: Tensor
    covariances: Tensor
    lost: tuple[int, int, int] | None = None


@torch.no_grad()
def filtered(problem: FilterProblem, psi: Tensor, x0: Tensor) -> KalmanRun:
    """The flights filtered from initial states x0 [F, nx]."""
    e, S, x, P = _run(problem, psi, x0)
    root, info = torch.linalg.cholesky_ex(S)
    white = torch.linalg.solve_triangular(root, e.unsqueeze(-1), upper=False).squeeze(-1)
    cost = 0.5 * white.square().sum(dim=(1, 2)) + root.diagonal(dim1=-2, dim2=-1).log().sum(dim=(1, 2))
    bad = ~(x.isfinite() & P.diagonal(dim1=-2, dim2=-1).isfinite()) & problem.segments.inside[..., None]
    cost = torch.where(bad.any(2).any(1) | (info > 0).any(1) | ~cost.isfinite(), torch.inf, cost)
    e = e.masked_fill(problem.segments.outputs.isnan(), torch.nan)
    return KalmanRun(cost, e, S, x, P, _first(bad))


def _first(bad: Tensor) -> tuple[int, int, int] | None:
    places = bad.nonzero()
    if not len(places):
        return None
    flight, sample, state = places[places[:, 1].argmin()].tolist()
    return flight, sample, state


@torch.no_grad()
def rows(problem: FilterProblem, psi: Tensor, x0: Tensor) -> tuple[Tensor, Tensor]:
    """Linear model of the likelihood's rows, exact derivatives through state, covariance and gain.

    Of each sample: the whitened innovation's ny rows, and ny (ny + 1) / 2 rows of the whitened covariance V of its
    derivative. Half of the squared length of A is Fisher's information, -A'b the cost's exact gradient.

    Returns [F, T, ny, nx + n + 1] and [F, T, ny (ny + 1) / 2, nx + n + 1]: columns of x0, psi and b.
    """
    nx, n = x0.shape[-1], len(psi)
    run = lambda psi, x0: _run(problem, psi, x0)[:2]  # noqa: E731

    def along(direction: Tensor) -> tuple[Tensor, Tensor]:
        return jvp(run, (psi, x0), (direction[nx:], direction[:nx].expand_as(x0)))[1]

    e, S = run(psi, x0)
    de, dS = vmap(along)(torch.eye(nx + n, dtype=torch.float64))
    W = torch.linalg.inv(torch.linalg.cholesky(S))
    white, moved, spread = (W @ e.unsqueeze(-1)).squeeze(-1), (W @ de.unsqueeze(-1)).squeeze(-1), W @ dS @ W.mT
    present = ~problem.segments.outputs.isnan()
    ny = e.shape[-1]
    i, j = torch.tril_indices(ny, ny)
    weight = torch.where(i == j, 0.5, 1.0).to(e) ** 0.5
    second = (white[..., i] * white[..., j] - (i == j).to(e)) * weight * (present[..., i] & present[..., j])
    return (
        torch.cat([-moved.movedim(0, -1), white.unsqueeze(-1)], dim=-1),
        torch.cat([(spread[..., i, j] * weight).movedim(0, -1), second.unsqueeze(-1)], dim=-1),
    )


def _run(problem: FilterProblem, psi: Tensor, x0: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Innovations (zero where missing), their covariances, states and covariances after each sample."""
    theta, Q, R = problem.split(psi)
    segments, system = problem.segments, problem.system
    u = controls_at(system, theta, problem.records, segments)
    x, P = x0, problem.P0.expand(len(x0), -1, -1)
    history: list[tuple[Tensor, ...]] = []
    for k in range(segments.samples):
        e, S, PH = _innovation(system, theta, (x, P), (u[:, k], segments.outputs[:, k]), R)
        K = torch.linalg.solve(S, PH.mT).mT
        x, P = x + (K @ e.unsqueeze(-1)).squeeze(-1), P - K @ PH.mT
        P = (P + P.mT) / 2.0
        history.append((e, S, x, P))
        if k + 1 < segments.samples:
            t = segments.start + k * segments.dt
            x, P = _predicted(system, theta, (x, P), SampleInterval(t, u[:, k], u[:, k + 1], segments.dt), Q)
    e, S, x, P = (torch.stack(parts, dim=1) for parts in zip(*history, strict=True))
    return e, S, x, P


class SampleInterval(NamedTuple):
    """From one sample to the next: time at its start, controls at both ends, its length."""

    t: Tensor
    u0: Tensor
    u1: Tensor
    dt: float


def _innovation(
    system: System, theta: Tensor, state: tuple[Tensor, Tensor], sample: tuple[Tensor, Tensor], R: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Innovation, its covariance, and P H' of a state x, P and a sample u, y.

    A missing output is an uncorrelated one of variance 1, as expected.
    """
    (x, P), (u, y) = state, sample
    present = ~y.isnan()
    both = present.unsqueeze(-1) & present.unsqueeze(-2)
    H = torch.where(present.unsqueeze(-1), by_inputs(lambda x, u: system.output(theta, x, u), x, u)[0], 0.0)
    e = torch.where(present, y.nan_to_num(0.0) - system.output(theta, x, u), 0.0)
    PH = P @ H.mT
    return e, H @ PH + torch.where(both, R, 0.0) + torch.diag_embed((~present).to(x)), PH


def _predicted(
    system: System, theta: Tensor, state: tuple[Tensor, Tensor], interval: SampleInterval, Q: Tensor
) -> tuple[Tensor, Tensor]:
    """State and covariance one sample later, by the 3/8 rule for both."""
    (x, P), (t, u0, u1, dt) = state, interval
    after, stages = step_stages(lambda t, x, u: system.rates(theta, t, x, u), t, x, u0, u1, dt)

    def slope(g: int, P: Tensor) -> Tensor:
        node = NODES[g]
        A = system.state_jacobian(theta, t + node * dt, stages[g], u0 + node * (u1 - u0))
        return A @ P + P @ A.mT + Q

    k1 = slope(0, P)
    k2 = slope(1, P + k1 * (dt / 3.0))
    k3 = slope(2, P + (k2 - k1 / 3.0) * dt)
    k4 = slope(3, P + (k1 - k2 + k3) * dt)
    return after, P + (k1 + 3.0 * (k2 + k3) + k4) * (dt / 8.0)
