"""Constants learnt by the repeated filter: exact where linear, and at the Cramer-Rao bound where not."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from rotorid_torch.core.integrate import step
from rotorid_torch.identification.reconstruct.filter_problem import Filtered, Problem
from rotorid_torch.identification.reconstruct.iterated import iterated, learns_constants
from rotorid_torch.identification.reconstruct.sigma_points import ProcessNoise
from rotorid_torch.identification.reconstruct.unscented_filter import SampledSystem, filter_and_smooth, unscented_filter
from tests.identification.reconstruct import test_unscented_filter as plain

TRUTH = plain.SHORT_PERIOD
RMS = torch.tensor([0.87, 0.063, 1.4], dtype=torch.float64)
"""Rms of w (m/s), q (rad/s) and az (m/s2) in such a flight."""


def rates(x: Tensor, u: Tensor) -> Tensor:
    motion = plain.short_period_rates(x[..., :2], u, x[..., 2:])
    return torch.cat([motion, torch.zeros_like(x[..., 2:])], dim=-1)


def sensors(x: Tensor, u: Tensor) -> Tensor:
    return torch.cat([x[..., :2], plain.short_period_forces(x[..., :2], u, x[..., 2:])[0].unsqueeze(-1)], dim=-1)


def closed_loop(samples: int, dt: float) -> tuple[Tensor, Tensor]:
    """Elevator and true states with constants; feedback is solved for, so that the elevator is linear in between."""
    time = torch.arange(samples, dtype=torch.float64) * dt
    pilot = torch.zeros(samples, 1, dtype=torch.float64)
    for begin, end, sign in ((0.5, 1.4, 1), (1.4, 2.0, -1), (2.0, 2.3, 1), (2.3, 2.6, -1)):
        pilot[(time >= begin - 1e-9) & (time < end - 1e-9)] = 0.05 * sign
    x, elevator = torch.cat([torch.zeros(2, dtype=torch.float64), TRUTH]), pilot[0]
    states, controls = [x], [elevator]
    for k in range(1, samples):
        held = elevator
        for _ in range(8):
            x = step(lambda t, s, u: rates(s, u), torch.zeros(()), states[-1], elevator, held, dt)
            held = pilot[k] + x[:2] @ plain.FEEDBACK[:, None]
        elevator = held
        states.append(x)
        controls.append(elevator)
    return torch.stack(controls), torch.stack(states)


def bound(elevator: Tensor, truth: Tensor, given: Problem) -> Tensor:
    """Standard errors of the constants: Kalman filter of the system linearised along the true flight."""
    zero, n = torch.zeros(()), truth.shape[-1]
    P, eye = given.P0, torch.eye(n, dtype=torch.float64)
    for k in range(len(truth)):
        if k:
            u0, u1 = elevator[k - 1], elevator[k]
            F = torch.autograd.functional.jacobian(
                lambda x, a=u0, b=u1: step(lambda t, s, u: rates(s, u), zero, x, a, b, given.dt), truth[k - 1]
            )
            assert isinstance(F, Tensor)
            P = F @ P @ F.T + given.Q
        H = torch.autograd.functional.jacobian(lambda x, a=elevator[k]: sensors(x, a), truth[k])
        assert isinstance(H, Tensor)
        K = torch.linalg.solve(H @ P @ H.T + given.R, H @ P).T
        P = (eye - K @ H) @ P @ (eye - K @ H).T + K @ given.R @ K.T
    return P.diagonal().sqrt()[2:]


def problem(relative: float, start: Tensor, spread: Tensor, runs: int, samples: int, dt: float, q: float) -> Problem:
    elevator, truth = closed_loop(samples, dt)
    noise = relative * RMS
    generator = torch.Generator().manual_seed(3)
    clean = sensors(truth, elevator)
    outputs = clean + noise * torch.randn(runs, *clean.shape, generator=generator, dtype=torch.float64)
    x0 = torch.cat([torch.zeros(2, dtype=torch.float64), start])
    P0 = torch.diag(torch.cat([torch.tensor([0.5, 0.05], dtype=torch.float64), spread]).square())
    Q = torch.diag(torch.tensor([q, q * 1e-4] + [0.0] * 6, dtype=torch.float64))
    return Problem(rates, sensors, x0, P0, Q, torch.diag(noise.square()), elevator, outputs, dt)


def run(given: Problem, smooth: bool = True) -> Filtered:
    return unscented_filter(**{name: part for name, part in vars(given).items() if name != "parts"}, smooth=smooth)


@pytest.mark.parametrize("q", [0.0, 1e-8])
@pytest.mark.parametrize("spread", [TRUTH.abs(), torch.full_like(TRUTH, 10.0)])
def test_the_cramer_rao_bound_is_reached_from_nothing(spread: Tensor, q: float) -> None:
    """Records of 0.1 % noise, parameters started at zero; a single pass is up to several bounds off."""
    given = problem(1e-3, torch.zeros_like(TRUTH), spread, 12, 251, 0.04, q)
    error = bound(*closed_loop(251, 0.04), given)
    got = run(given)
    assert got.smoothed_means is not None
    assert got.smoothed_covariances is not None
    claimed = got.smoothed_covariances[:, -1].diagonal(dim1=-2, dim2=-1).sqrt()[:, 2:]
    assert torch.allclose(claimed, error.expand_as(claimed), rtol=0.02)
    off = got.smoothed_means[:, -1, 2:] - TRUTH
    assert (off / error).square().mean().sqrt() < 1.25
    assert (off / error).abs().max() < 4.0
    assert (off / TRUTH).abs().max() < 0.01


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.5])
def test_the_start_does_not_matter(factor: float) -> None:
    known = run(problem(3e-3, TRUTH, 3.0 * TRUTH.abs(), 3, 201, 0.04, 1e-8))
    started = run(problem(3e-3, factor * TRUTH, 3.0 * TRUTH.abs(), 3, 201, 0.04, 1e-8))
    assert torch.allclose(known.means[:, -1], started.means[:, -1], rtol=2e-3)


def test_a_prior_that_sends_the_first_pass_astray_is_narrowed_for_the_start() -> None:
    """Standard deviations of 100 about zero for derivatives as small as 0.2."""
    got = run(problem(3e-3, torch.zeros_like(TRUTH), torch.full_like(TRUTH, 100.0), 8, 401, 0.05, 1e-8))
    assert (got.means[:, -1, 2:] / TRUTH - 1.0).abs().max() < 0.05


def test_without_smoothing_the_means_are_the_same() -> None:
    given = problem(3e-3, 0.5 * TRUTH, TRUTH.abs(), 2, 151, 0.04, 1e-8)
    whole, forward = run(given), run(given, smooth=False)
    assert torch.equal(whole.means, forward.means)
    assert forward.smoothed_means is None
    assert forward.smoothed_covariances is None


def test_covariances_are_symmetric_positive_definite_and_the_last_sample_is_smoothed_already() -> None:
    given = problem(1e-3, 0.5 * TRUTH, TRUTH.abs(), 2, 151, 0.04, 1e-8)
    got = run(given)
    assert got.smoothed_means is not None
    assert got.smoothed_covariances is not None
    for cov in (got.covariances, got.smoothed_covariances, got.innovation_covariances):
        assert torch.equal(cov, cov.mT)
        scale = cov.diagonal(dim1=-2, dim2=-1).sqrt()
        assert torch.linalg.eigvalsh(cov / scale[..., None] / scale[..., None, :]).min() > 0.0
    assert torch.allclose(got.smoothed_means[:, -1], got.means[:, -1], rtol=1e-9)


@pytest.mark.parametrize("gaps", [False, True])
def test_a_pass_of_a_linear_problem_is_the_exact_kalman_filter_and_smoother(gaps: bool) -> None:
    """Called directly, for a linear problem is never repeated by itself."""
    controls, outputs = plain.record(np.random.default_rng(1), 120, gaps)
    f, h = plain.linear(plain.A, plain.B), plain.linear(plain.C, plain.D)
    arrays = (plain.X0, plain.P0, plain.Q, plain.R, controls, outputs)
    x0, P0, Q, R, u, y = (torch.tensor(a) for a in arrays)
    given = Problem(f, h, x0, P0, Q, R, u, y, plain.DT)
    noise = ProcessNoise.constant(Q)
    got = iterated(given, lambda cov: filter_and_smooth(SampledSystem(f, h, (x0, cov), noise, R, u, y, plain.DT)))
    for name, exact in plain.exact_kalman(controls, outputs).items():
        assert plain.relative(getattr(got, name), exact) < 1e-9, name
    assert not learns_constants(given)


def test_what_is_no_constant_is_not_taken_for_one() -> None:
    """A random walk that wanders further than its prior, a constant known exactly, and a linear constant."""
    given = problem(1e-3, TRUTH, TRUTH.abs(), 1, 101, 0.04, 1e-8)
    assert learns_constants(given)
    still = torch.tensor([0.0, 0.0] + [1.0] * 6, dtype=torch.float64)
    walk = Problem(**(vars(given) | {"Q": given.Q + torch.diag(still * given.P0.diagonal())}))
    known = Problem(**(vars(given) | {"P0": given.P0 * torch.diag(1.0 - still)}))
    assert not learns_constants(walk)
    assert not learns_constants(known)
    biased = torch.tensor([[-1.0, 1.0], [0.0, 0.0]], dtype=torch.float64)
    small = (torch.zeros(2), torch.eye(2), torch.diag(torch.tensor([1.0, 0.0])), torch.eye(1))
    x0, P0, Q, R = (a.to(torch.float64) for a in small)
    empty, y = torch.zeros(20, 0, dtype=torch.float64), torch.zeros(20, 1, dtype=torch.float64)
    assert not learns_constants(
        Problem(lambda x, u: x @ biased.mT, lambda x, u: x[..., :1], x0, P0, Q, R, empty, y, 0.1)
    )


def test_a_missing_channel_is_as_if_it_were_not_there() -> None:
    given = problem(1e-3, 0.5 * TRUTH, TRUTH.abs(), 1, 151, 0.04, 1e-8)
    outputs = given.outputs.clone()
    outputs[..., 0] = torch.nan
    gone = run(Problem(**(vars(given) | {"outputs": outputs})))
    fewer = {"h": lambda x, u: sensors(x, u)[..., 1:], "R": given.R[1:, 1:], "outputs": outputs[..., 1:]}
    never = run(Problem(**(vars(given) | fewer)))
    assert torch.allclose(gone.means, never.means, rtol=1e-6, atol=1e-9)
    assert torch.allclose(gone.log_likelihood, never.log_likelihood, rtol=1e-6)
    assert gone.innovations[..., 0].isnan().all()
