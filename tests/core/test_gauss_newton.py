"""Bounded Gauss-Newton against SciPy's trf, optima on bounds, and parameters the data cannot tell."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from torch import Tensor
from torch.func import jacrev

from rotorid_torch.core.gauss_newton import Linear, Minimum, Options, Region, minimise


@dataclass
class Where:
    theta: Tensor
    cost: float


def solve(
    residual: Callable[[Tensor], Tensor], start: Tensor, lower: Tensor, upper: Tensor, free: Tensor | None = None
) -> Minimum[Where]:
    def evaluate(theta: Tensor, base: Where | None, share: float) -> Where:
        return Where(theta, 0.5 * float(residual(theta).square().sum()))

    def linearise(point: Where) -> Linear:
        return Linear(jacrev(residual)(point.theta), -residual(point.theta))

    return minimise(evaluate, linearise, start, Region(lower, upper, free), Options(tolerance=1e-12))


TIMES = torch.linspace(0.0, 3.0, 60, dtype=torch.float64)


def decay(theta: Tensor) -> Tensor:
    """Gain, rate and offset of a decay whose best offset lies below the bound zero."""
    truth = 2.0 * torch.exp(-1.5 * TIMES) - 0.05 + 0.01 * torch.sin(37.0 * TIMES)
    return (theta[0] * torch.exp(-theta[1] * TIMES) + theta[2] - truth) / 0.01


def tensor(*numbers: float) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


def test_optimum_on_a_bound_from_forty_starts() -> None:
    lower, upper = tensor(0.0, 0.0, 0.0), tensor(10.0, 20.0, 1.0)
    rng = np.random.default_rng(0)
    reference = least_squares(
        lambda th: decay(tensor(*th)).numpy(),
        [1.0, 1.0, 0.1],
        bounds=(lower.numpy(), upper.numpy()),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    for _ in range(40):
        start = torch.tensor(rng.uniform([0.1, 0.1, 0.0], [10.0, 10.0, 1.0]))
        found = solve(decay, start, lower, upper)
        assert found.converged
        assert found.at_bound.tolist() == [False, False, True]
        assert float(found.point.theta[2]) == 0.0
        np.testing.assert_allclose(found.point.theta[:2].numpy(), reference.x[:2], rtol=1e-5)


def test_rosenbrock_and_a_held_parameter() -> None:
    def valley(theta: Tensor) -> Tensor:
        return torch.stack([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]])

    wide = tensor(math.inf, math.inf)
    found = solve(valley, tensor(-1.2, 1.0), -wide, wide)
    torch.testing.assert_close(found.point.theta, tensor(1.0, 1.0), rtol=1e-6, atol=1e-6)
    held = solve(valley, tensor(-1.2, 1.0), -wide, wide, free=torch.tensor([True, False]))
    assert float(held.point.theta[1]) == 1.0
    assert abs(float(held.point.theta[0])) > 0.9


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10_000))
def test_linear_problems_in_a_box_as_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.standard_normal((12, 4)) * 10.0 ** rng.uniform(1, 4, 4), 500.0 * rng.standard_normal(12)
    size = np.abs(np.linalg.lstsq(A, b, rcond=None)[0]) + 1e-9
    lower, upper = -0.5 * size, 0.7 * size
    wide = torch.tensor(A), torch.tensor(b)
    found = solve(
        lambda th: wide[0] @ th - wide[1], torch.zeros(4, dtype=torch.float64), torch.tensor(lower), torch.tensor(upper)
    )
    reference = least_squares(
        lambda th: A @ (th * size) - b,
        np.zeros(4),
        bounds=(lower / size, upper / size),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    assert found.point.cost <= reference.cost * (1 + 1e-6)


def test_names_what_the_data_cannot_tell() -> None:
    rng = np.random.default_rng(3)
    A = torch.tensor(rng.standard_normal((30, 4)))
    A[:, 1] = A[:, 0]  # only their sum matters
    A[:, 3] = 0.0
    b = A @ tensor(1.0, 1.0, -2.0, 5.0)
    lower, upper = tensor(-4, -4, -4, -9), tensor(4, 4, 4, 9)
    found = solve(lambda th: 100.0 * (A @ th - b), tensor(0.5, 0.1, 0.0, 3.0), lower, upper)
    assert found.converged
    assert found.not_identifiable.tolist() == [True, True, False, True]
    assert found.determined[:2].sum() == 1
    assert found.determined[2:].tolist() == [True, False]
    theta = found.point.theta
    assert float(theta[3]) == 3.0
    torch.testing.assert_close(theta[0] + theta[1], tensor(2.0)[0], rtol=1e-7, atol=0)
    assert float(theta[0]) == 0.5 or float(theta[1]) == 0.1  # one is held, the other follows


def test_what_explodes_tells_nothing_by_its_rounding() -> None:
    A = torch.tensor(np.random.default_rng(3).standard_normal((30, 3)))
    A[:, 0] *= 1e25  # one unstable motion in two parameters, far beyond working precision
    A[:, 1] = 0.3 * A[:, 0]
    found = solve(lambda th: 100.0 * (A @ th), tensor(0.0, 0.0, 0.0), tensor(-4, -4, -4), tensor(4, 4, 4))
    assert found.not_identifiable.tolist() == [True, True, False]


def test_a_failed_trial_costs_no_jacobian_and_the_monitor_sees_accepted_steps() -> None:
    jacobians, seen = [], []

    def residual(theta: Tensor) -> Tensor:
        return torch.atan(5.0 * theta) + 0.01 * theta

    def evaluate(theta: Tensor, base: Where | None, share: float) -> Where:
        return Where(theta, 0.5 * float(residual(theta).square().sum()))

    def linearise(point: Where) -> Linear:
        jacobians.append(point.cost)
        return Linear(jacrev(residual)(point.theta), -residual(point.theta))

    wide = tensor(math.inf)
    found = minimise(
        evaluate,
        linearise,
        tensor(3.0),
        Region(-wide, wide),
        Options(damping=1e-6),
        monitor=lambda i, c, th: seen.append(c),
    )
    assert abs(float(found.point.theta)) < 1e-3
    assert len(jacobians) == found.iterations + 1
    assert seen == found.history[1:]
    assert all(b < a for a, b in zip(found.history[:-1], found.history[1:], strict=True))


def test_parameters_move_again_once_what_is_eliminated_has_settled() -> None:
    """Other unknowns settle in twelve small shares of their steps, whatever the parameters do meanwhile."""

    @dataclass
    class Settling(Where):
        left: int

    def evaluate(theta: Tensor, base: Settling | None, share: float) -> Settling:
        left = 12 if base is None else max(base.left - 1, 0)
        refused = base is not None and base.left > 0 and share > 0.02
        cost = math.inf if refused else left + 0.5 * float((theta - 2.0).square().sum())
        return Settling(theta, cost, left)

    def linearise(point: Settling) -> Linear:
        return Linear(torch.eye(1, dtype=torch.float64), 2.0 - point.theta, 1.0 if point.left else 0.0)

    wide = tensor(math.inf)
    found = minimise(evaluate, linearise, tensor(1.0), Region(-wide, wide), Options(max_iterations=25))
    assert found.converged
    assert float(found.point.theta) == pytest.approx(2.0, abs=1e-3)


def test_many_directions_that_the_data_do_not_tell_are_found_at_once() -> None:
    """As in a network: as many are held as the rank lacks, and no decomposition for each of them."""
    chance = torch.Generator().manual_seed(0)
    A = torch.randn(80, 30, generator=chance).double() @ torch.randn(30, 120, generator=chance).double()
    free = torch.full((120,), math.inf, dtype=torch.float64)
    with torch.autograd.profiler.profile() as profile:
        found = solve(lambda theta: A @ theta - 1.0, torch.zeros(120, dtype=torch.float64), -free, free)
    calls = {event.key: event.count for event in profile.key_averages()}
    assert calls["aten::_linalg_svd"] <= 4 * (found.iterations + 1)
    assert int(found.determined.sum()) == 30
    assert int(torch.linalg.matrix_rank(A[:, found.determined])) == 30
    best = float((A @ torch.linalg.lstsq(A, torch.ones(80, 1).double(), driver="gelsd").solution - 1.0).square().sum())
    assert 2.0 * found.point.cost == pytest.approx(best, rel=1e-9)
