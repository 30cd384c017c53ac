"""Constants learnt by filter and smoother: linearise again, about what the whole record says, until nothing changes.

A filter that starts from a wide prior linearises its first samples where it knows nothing, and never takes that back.
Here both functions are fitted anew at every sample, by statistical linear regression over the *smoothed* density of
the pass before; what remains is linear and is solved from the prior as it was given, so that the prior counts once.
Forward it is the Kalman filter, backward the information filter of the samples to come, both in square-root form:
neither divides by a predicted covariance or by the dynamics, so that process noise and variances may be zero.

Sources: Garcia-Fernandez, Svensson, Morelande and Sarkka, IEEE Trans. Signal Processing 63 (2015), on the iteration;
Fraser and Potter, IEEE Trans. Automatic Control 14 (1969), on the smoother as a combination of two filters;
Bierman, Factorization Methods for Discrete Sequential Estimation (1977), on the arrays.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.identification.reconstruct.filter_problem import Dynamics, Filtered, Problem, onward
from rotorid_torch.identification.reconstruct.sigma_points import root

PASSES = 12
"""More are not made; three are the rule."""
SETTLED = 1e-3
"""Change between two passes, in standard errors, that is none."""
NARROWER = 0.01
"""Of the prior's covariance, for a second first pass where the first one led nowhere; it only says where to start."""
LEAST_REACH = 1e-8
"""Eigenvalue of the correlations below which a direction is taken for that wide: its points must not coincide."""
PROBES = 8
"""States drawn from the prior at which rates are looked at."""
STRAIGHT = 1e-9
"""Second difference, over the values' size, that is rounding."""


class Affine(NamedTuple):
    """About a point: value [T, ..., m], slope [T, ..., m, n], covariance of what is not linear [T, ..., m, m]."""

    value: Tensor
    slope: Tensor
    bend: Tensor


class _Linear(NamedTuple):
    """The system linearised about a trajectory, time first: step, outputs, root of the noise between samples, data."""

    move: Affine
    sense: Affine
    noise: Tensor
    R: Tensor
    outputs: Tensor
    about: Tensor


class _Forward(NamedTuple):
    """Of the Kalman filter, time first, as distance from the point: before and after each sample, with roots."""

    ahead: Tensor
    ahead_root: Tensor
    mean: Tensor
    root: Tensor


class _Pass(NamedTuple):
    """Where it was linearised, what came of it, and which flights [...] stayed where they were."""

    about: Tensor
    sense: Affine
    forward: _Forward
    mean: Tensor
    cov: Tensor
    settled: Tensor


def learns_constants(problem: Problem) -> bool:
    """Whether a state is a constant to be estimated, and f or h not linear, so that one pass cannot be the best.

    A constant has a rate of zero wherever one looks, and doubt in the prior. A force modelled as a random walk has
    a rate of zero too; it is none, for over the record it may wander further than the prior doubts.
    """
    count = problem.outputs.shape[-2]
    generator = torch.Generator("cpu").manual_seed(0)
    draws = torch.randn(PROBES, problem.x0.shape[-1], generator=generator, dtype=torch.float64, device="cpu")
    away = draws.to(problem.P0.device) @ root(problem.P0).mT
    u = problem.controls[..., torch.linspace(0, count - 1, PROBES).long(), :]
    batch = np.broadcast_shapes(problem.x0.shape[:-1], away.shape[:-2], u.shape[:-2])
    away, u = away.expand(*batch, *away.shape[-2:]), u.expand(*batch, *u.shape[-2:])
    x = problem.x0.unsqueeze(-2).expand_as(away)
    rates = problem.f(x + away, u)
    still = (rates == 0.0).flatten(0, -2).all(dim=0)
    doubt = problem.P0.diagonal(dim1=-2, dim2=-1)
    constant = still & (doubt > 0.0) & (problem.Q.diagonal() * (count - 1) < doubt)
    return bool(constant.any()) and not (_straight(problem.f, x, away, u) and _straight(problem.h, x, away, u))


def _straight(function: Dynamics, x: Tensor, away: Tensor, u: Tensor) -> bool:
    plus, middle, minus = function(x + away, u), function(x, u), function(x - away, u)
    size = plus.abs() + 2.0 * middle.abs() + minus.abs()
    return bool(((plus + minus - 2.0 * middle).abs() <= STRAIGHT * size).all())


def iterated(problem: Problem, single_pass: Callable[[Tensor], Filtered]) -> Filtered:
    """Filter and smoother, repeated until what they say of every sample stays.

    problem : the problem.
    single_pass : filter and smoother from x0 and the covariance handed in: where the first linearisation is made.

    A flight of the batch that settles neither from the first pass nor from a narrower prior's keeps its first pass.
    Means, innovations and likelihood are those of the last linear problem: they use the record to come in their
    linearisation, though not in their data.
    """
    first = single_pass(problem.P0)
    result, settled = _repeat(problem, first)
    if not settled.all():
        again, settled_again = _repeat(problem, single_pass(NARROWER * problem.P0))
        result = _choose(settled, result, _choose(settled_again, again, first))
    return result


def _choose(where: Tensor, one: Filtered, other: Filtered) -> Filtered:
    """Flight by flight."""
    chosen: dict[str, Tensor] = {}
    for name, a in vars(one).items():
        chosen[name] = torch.where(where[(..., *(None,) * (a.dim() - where.dim()))], a, vars(other)[name])
    return replace(one, **chosen)


def _repeat(problem: Problem, first: Filtered) -> tuple[Filtered, Tensor]:
    """The last pass, and which flights [...] have settled."""
    assert first.smoothed_means is not None
    assert first.smoothed_covariances is not None
    batch = first.log_likelihood.shape
    u = problem.controls.expand(*batch, *problem.controls.shape[-2:]).movedim(-2, 0).unsqueeze(-2)
    y = problem.outputs.expand(*batch, *problem.outputs.shape[-2:]).movedim(-2, 0)
    prior = problem.x0.expand(*batch, -1), problem.P0.expand(*batch, *problem.P0.shape[-2:])
    last = _pass(problem, prior, u, y, first.smoothed_means.movedim(-2, 0), first.smoothed_covariances.movedim(-3, 0))
    for _ in range(PASSES - 1):
        if last.settled.all():
            break
        last = _pass(problem, prior, u, y, last.mean, last.cov)
    return _result(first, last, problem.R, y), last.settled


def _pass(problem: Problem, prior: tuple[Tensor, Tensor], u: Tensor, y: Tensor, mean: Tensor, cov: Tensor) -> _Pass:
    """Linearise over smoothed densities, filter, smooth; all time first, u [T, ..., 1, nu]."""
    about, cov = _sound(mean, cov, prior)
    move = _linearise(lambda x: _after_step(problem, x, u), about[:-1], cov[:-1])
    sense = _linearise(lambda x: problem.h(x, u.expand(*x.shape[:-1], -1)), about, cov)
    noise = root(problem.Q + move.bend)
    system = _Linear(move, sense, noise, problem.R, y, about)
    forward = _filter(system, (prior[0] - about[0], root(prior[1])))
    mean, cov = _smooth(system, forward)
    small = (mean - about).abs() <= SETTLED * cov.diagonal(dim1=-2, dim2=-1).sqrt()
    settled = (small | (mean == about)).all(dim=0).all(dim=-1)
    return _Pass(about, sense, forward, mean, cov, settled)


def _after_step(problem: Problem, x: Tensor, u: Tensor) -> Tensor:
    u = u.expand(-1, *x.shape[1:-1], -1)
    return onward(problem.f, x, u[:-1], u[1:], problem.dt, problem.parts)


def _sound(mean: Tensor, cov: Tensor, prior: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Densities to linearise over; a flight whose numbers have run away starts at its prior."""
    fine = mean.isfinite().all(dim=0).all(dim=-1) & cov.isfinite().all(dim=0).flatten(-2).all(dim=-1)
    fine = fine.unsqueeze(-1)
    return torch.where(fine, mean, prior[0]), torch.where(fine.unsqueeze(-1), cov, prior[1])


def _linearise(function: Callable[[Tensor], Tensor], mean: Tensor, cov: Tensor) -> Affine:
    """Statistical linear regression over the densities of all samples at once, on the points of the cubature rule."""
    n = mean.shape[-1]
    deviation = cov.diagonal(dim1=-2, dim2=-1).sqrt()
    deviation = torch.where(deviation > 0.0, deviation, 1.0).unsqueeze(-1)
    eigenvalues, vectors = torch.linalg.eigh(cov / (deviation * deviation.mT))
    reach = (n * eigenvalues.clamp(min=LEAST_REACH)).sqrt().unsqueeze(-1)
    away = reach * (deviation * vectors).mT
    values = function(mean.unsqueeze(-2) + torch.cat([away, -away], dim=-2))
    plus, minus = values[..., :n, :], values[..., n:, :]
    value = values.mean(dim=-2)
    slope = (0.5 * (plus - minus) / reach).mT @ (vectors / deviation).mT
    bend = (0.5 * (plus + minus) - value.unsqueeze(-2)) / math.sqrt(n)
    return Affine(value, slope, bend.mT @ bend)


def _sensed(sense: Affine, R: Tensor, outputs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Outputs minus value, slope, root of the noise; a missing row is zero, with noise 1 of its own."""
    present = (~outputs.isnan()).to(R.dtype)
    noise = (R + sense.bend) * present.unsqueeze(-1) * present.unsqueeze(-2) + torch.diag_embed(1.0 - present)
    return (outputs - sense.value).nan_to_num(nan=0.0).unsqueeze(-1), sense.slope * present.unsqueeze(-1), root(noise)


def _filter(system: _Linear, start: tuple[Tensor, Tensor]) -> _Forward:
    """Kalman filter on arrays; start: distance and root of the prior."""
    move, noise = system.move, system.noise
    v, H, sensor = _sensed(system.sense, system.R, system.outputs)
    ny, nothing = H.shape[-2], torch.zeros_like(H[0].mT)
    drift = (move.value - system.about[1:]).unsqueeze(-1)
    mean, half = start[0].unsqueeze(-1), start[1]
    steps: list[tuple[Tensor, ...]] = []
    for k in range(len(system.outputs)):
        if k:
            mean = move.slope[k - 1] @ mean + drift[k - 1]
            half = _lower(torch.cat([move.slope[k - 1] @ half, noise[k - 1]], dim=-1))
        ahead = mean, half
        above = torch.cat([sensor[k], H[k] @ half], dim=-1)
        array = _lower(torch.cat([above, torch.cat([nothing, half], dim=-1)], dim=-2))
        white = torch.linalg.solve_triangular(array[..., :ny, :ny], v[k] - H[k] @ mean, upper=False)
        mean, half = mean + array[..., ny:, :ny] @ white, array[..., ny:, ny:]
        steps.append((*ahead, mean, half))
    ahead_mean, ahead_root, mean, half = (torch.stack(part) for part in zip(*steps, strict=True))
    return _Forward(ahead_mean.squeeze(-1), ahead_root, mean.squeeze(-1), half)


def _smooth(system: _Linear, forward: _Forward) -> tuple[Tensor, Tensor]:
    """Smoothed means and covariances: the filter's, and rows W x = w + white noise that say what the rest brings."""
    move, noise, outputs, about = system.move, system.noise, system.outputs, system.about
    v, H, sensor = _sensed(system.sense, system.R, outputs)
    n, eye = H.shape[-1], torch.eye(H.shape[-1], dtype=H.dtype, device=H.device).expand(*H.shape[1:-2], -1, -1)
    rows = torch.linalg.solve_triangular(sensor, torch.cat([H, v], dim=-1), upper=False)
    drift = (move.value - about[1:]).unsqueeze(-1)
    above = torch.cat([eye, torch.zeros_like(eye), torch.zeros_like(eye[..., :1])], dim=-1)
    later = torch.zeros(*about.shape, n + 1, dtype=H.dtype, device=H.device)
    for k in range(len(outputs) - 2, -1, -1):
        W, w = torch.cat([later[k + 1], rows[k + 1]], dim=-2).split([n, 1], dim=-1)
        said = torch.cat([W @ noise[k], W @ move.slope[k], w - W @ drift[k]], dim=-1)
        later[k] = _upper(torch.cat([above, said], dim=-2))[..., n : 2 * n, n:]
    W, w = later.split([n, 1], dim=-1)
    above = torch.cat([eye, torch.zeros_like(eye[..., :1])], dim=-1).expand(len(outputs), *eye.shape[:-1], n + 1)
    said = torch.cat([W @ forward.root, w - W @ forward.mean.unsqueeze(-1)], dim=-1)
    weight, target = _upper(torch.cat([above, said], dim=-2))[..., :n, :].split([n, 1], dim=-1)
    half = torch.linalg.solve_triangular(weight.mT, forward.root.mT, upper=False)
    return about + forward.mean + (half.mT @ target).squeeze(-1), _square(half.mT)


def _result(first: Filtered, last: _Pass, R: Tensor, outputs: Tensor) -> Filtered:
    """Time back to its place, and the likelihood."""
    sense, forward = last.sense, last.forward
    innovations = outputs - sense.value - (sense.slope @ forward.ahead.unsqueeze(-1)).squeeze(-1)
    spread = _square(sense.slope @ forward.ahead_root) + R + sense.bend
    white, _, half = _sensed(Affine(outputs - innovations, sense.slope, spread - R), R, outputs)
    white = torch.linalg.solve_triangular(half, white, upper=False)
    logdet = half.diagonal(dim1=-2, dim2=-1).log().sum(dim=(0, -1))
    count = (~outputs.isnan()).sum(dim=(0, -1), dtype=outputs.dtype)
    return replace(
        first,
        means=(last.about + forward.mean).movedim(0, -2),
        covariances=_square(forward.root).movedim(0, -3),
        innovations=innovations.movedim(0, -2),
        innovation_covariances=spread.movedim(0, -3),
        log_likelihood=-0.5 * (white.square().sum(dim=(0, -2, -1)) + count * math.log(2.0 * math.pi)) - logdet,
        smoothed_means=last.mean.movedim(0, -2),
        smoothed_covariances=last.cov.movedim(0, -3),
    )


def _upper(array: Tensor) -> Tensor:
    """Triangle with the same square: R'R = array' array."""
    return torch.linalg.qr(array, mode="r")[1]


def _lower(array: Tensor) -> Tensor:
    """Triangle L with L L' = array array'."""
    return _upper(array.mT).mT


def _square(half: Tensor) -> Tensor:
    cov = half @ half.mT
    return 0.5 * (cov + cov.mT)
