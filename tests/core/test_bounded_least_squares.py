"""Least squares in a box: optimality conditions, an independent solver, and boxes that a clamp gets wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from rotorid_torch.core.least_squares import bounded_least_squares


def problem(n: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n + 3, n)) @ np.diag(10.0 ** rng.uniform(-3, 3, n))
    low, high = np.sort(rng.standard_normal((2, n)), axis=0)
    G, d = A.T @ A, A.T @ rng.standard_normal(n + 3)
    return torch.tensor(G), torch.tensor(d), torch.tensor(low), torch.tensor(high)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 7), st.integers(0, 10_000))
def test_the_gradient_vanishes_inside_and_points_out_of_the_box_at_its_sides(n: int, seed: int):
    G, d, low, high = problem(n, seed)
    x = bounded_least_squares(G, d, low, high)
    assert bool(((low <= x) & (x <= high)).all())
    scale = G.diagonal().sqrt()
    slope = (G @ x - d) / scale
    tolerance = 1e-7 * float((d / scale).abs().max())
    assert bool((slope[x < high] > -tolerance).all())
    assert bool((slope[x > low] < tolerance).all())


def test_a_value_that_was_outside_comes_back_when_another_meets_its_bound():
    """Without bounds x = -0.8, y = 2.3: clamped one after the other that is (0, 2), but beside x = 0 y is 0.7."""
    A = torch.tensor([[1.0, 1.0], [3.0, 1.0]], dtype=torch.float64)
    b = torch.tensor([1.5, -0.1], dtype=torch.float64)
    G, d = A.mT @ A, A.mT @ b
    low, high = torch.zeros(2, dtype=torch.float64), torch.full((2,), 2.0, dtype=torch.float64)
    x = bounded_least_squares(G, d, low, high)
    torch.testing.assert_close(x, torch.tensor([0.0, 0.7], dtype=torch.float64))


@pytest.mark.parametrize("seed", range(5))
def test_as_a_general_minimiser(seed: int):
    G, d, low, high = problem(4, seed)
    scale = 1.0 / G.diagonal().sqrt()
    H, g = (scale[:, None] * G * scale).numpy(), (scale * d).numpy()
    box = list(zip((low / scale).tolist(), (high / scale).tolist(), strict=True))
    start = np.mean(box, axis=1)
    found = minimize(
        lambda x: 0.5 * x @ H @ x - g @ x, start, jac=lambda x: H @ x - g, bounds=box,
        method="L-BFGS-B", options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 10_000},
    )  # fmt: skip
    x = (bounded_least_squares(G, d, low, high) / scale).numpy()
    assert 0.5 * x @ H @ x - g @ x <= found.fun + 1e-9 * abs(found.fun)


def test_columns_that_depend_on_each_other_share_and_nothing_moves_without_a_column():
    one = torch.ones(2, 2, dtype=torch.float64)
    wide = torch.full((2,), math.inf, dtype=torch.float64)
    torch.testing.assert_close(bounded_least_squares(one, one[0], -wide, wide), 0.5 * one[0])
    nothing = torch.zeros(2, 2, dtype=torch.float64)
    assert not bounded_least_squares(nothing, nothing[0], -wide, wide).any()


def test_what_is_not_finite_has_no_answer():
    one, nothing = torch.ones(1, dtype=torch.float64), torch.full((1, 1), math.nan, dtype=torch.float64)
    assert bounded_least_squares(nothing, one, -one, one).isnan().all()
