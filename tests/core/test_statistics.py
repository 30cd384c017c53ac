"""Quantiles against SciPy; means of values with errors, and autocorrelation, by NumPy, by hand, in closed form."""

import math
from itertools import permutations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from scipy.signal import lfilter

from rotorid_torch.core.statistics import (
    Share,
    autocorrelation,
    normal_quantile,
    paired,
    regression,
    stretches,
    student_quantile,
    variance_between,
    weighted_mean,
)


@pytest.mark.parametrize("tail", [0.3, 1e-2, 1e-4])
@pytest.mark.parametrize("freedom", [1, 2, 3, 4.5, 7, 30])
def test_student_is_the_exact_quantile(tail: float, freedom: float) -> None:
    assert normal_quantile(tail) == pytest.approx(stats.norm.isf(tail))
    exact = stats.t.isf(tail, freedom)
    assert student_quantile(normal_quantile(tail), freedom) == pytest.approx(exact, rel=1e-6)
    assert student_quantile(-normal_quantile(tail), freedom) == pytest.approx(-exact, rel=1e-6)


@given(arrays(np.float64, (4, 4), elements=st.floats(-1.0, 1.0)))
def test_pairs_have_the_largest_sum_of_all(sizes: np.ndarray) -> None:
    every = [sum(sizes[row, column] for row, column in enumerate(order)) for order in permutations(range(4))]
    order = paired(sizes)
    assert sorted(order) == [0, 1, 2, 3]
    assert sizes[np.arange(4), order].sum() == pytest.approx(max(every))


def column(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)[:, None]


def test_autocorrelation_by_hand():
    assert torch.allclose(autocorrelation(column(1.0, -1.0, 1.0, -1.0), 2), column(-0.75, 0.5))
    assert torch.allclose(autocorrelation(column(1.0, -1.0, 1.0, -1.0), 2, share="pairs"), column(-1.0, 1.0))
    gap = column(1.0, 2.0, math.nan, 3.0, 4.0)
    assert torch.allclose(autocorrelation(gap, 2, centred=False), column(14.0 / 30.0, 6.0 / 30.0))
    pairs = autocorrelation(gap, 1, centred=False, share="pairs")
    assert torch.allclose(pairs, column((14.0 / 2.0) / (30.0 / 4.0)))
    overlap = autocorrelation(gap, 1, centred=False, share="overlap")
    assert torch.allclose(overlap, column(14.0 / math.sqrt((1.0 + 9.0) * (4.0 + 16.0))))
    assert not autocorrelation(column(0.0, 0.0, 0.0), 2).any()


@pytest.mark.parametrize("centred", [False, True])
def test_autocorrelation_is_that_of_numpy(centred: bool):
    records = torch.randn(3, 50, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) + 0.3
    each, pooled = (
        autocorrelation(records, 49, centred=centred),
        autocorrelation(records, 49, centred=centred, pooled=True),
    )
    sums = np.zeros((50, 2))
    for k, record in enumerate(records.numpy()):
        x = record - record.mean(axis=0) if centred else record
        full = np.stack([np.correlate(c, c, "full")[49:] for c in x.T], axis=1)
        assert each[k].numpy() == pytest.approx(full[1:] / full[0])
        sums += full
    assert pooled.numpy() == pytest.approx(sums[1:] / sums[0])


@pytest.mark.parametrize("share", ["whole", "pairs", "overlap"])
def test_autocorrelation_of_a_first_order_process_falls_as_its_powers(share: Share):
    noise = np.random.default_rng(1).standard_normal((20, 5000))
    process = torch.from_numpy(lfilter([1.0], [1.0, -0.8], noise))[..., None]
    r = autocorrelation(process, 10, pooled=True, share=share)[:, 0]
    assert r.numpy() == pytest.approx(0.8 ** np.arange(1, 11), abs=0.015)


def test_white_records_stay_in_their_band():
    white = torch.randn(4000, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    inside = autocorrelation(white, 50).abs() < 1.96 / math.sqrt(4000)
    assert inside.double().mean().item() >= 0.88


def test_a_weighted_mean_is_that_of_numpy_and_of_generalised_least_squares():
    values, errors = np.array([1.0, 2.0, 4.0]), np.array([0.5, 1.0, 2.0])
    mean, error = weighted_mean(values, errors)
    assert mean == pytest.approx(np.average(values, weights=errors**-2.0))
    assert error == pytest.approx(np.linalg.inv(np.ones((1, 3)) @ np.diag(errors**-2.0) @ np.ones((3, 1)))[0, 0] ** 0.5)


def test_variance_between_is_what_equal_errors_leave():
    values = np.array([0.0, 1.0, 5.0])
    assert variance_between(values, [0.3] * 3) == pytest.approx(values.var(ddof=1) - 0.09)
    assert variance_between(values, [9.0] * 3) == variance_between([2.0], [0.1]) == 0.0
    rng, errors = np.random.default_rng(0), np.linspace(0.5, 2.0, 4000)
    assert variance_between(rng.normal(1.0, np.hypot(errors, 0.7)), errors) == pytest.approx(0.49, rel=0.15)


@given(arrays(bool, st.integers(0, 30)))
def test_stretches_are_what_is_true_and_nothing_else(true: np.ndarray):
    found = np.zeros(len(true), dtype=bool)
    for first, last in stretches(true):
        assert first < last
        assert first == 0 or not true[first - 1]
        assert last == len(true) or not true[last]
        found[first:last] = True
    assert (found == true).all()


def test_regression_of_products_is_least_squares_of_the_columns():
    """Complex columns of sizes 1e-3 to 1e3, one of them the sum of two: the fit is that of the columns themselves."""
    chance = np.random.default_rng(0)
    z = (chance.standard_normal((60, 5)) + 1j * chance.standard_normal((60, 5))) * [1.0, 1e3, 1e-3, 1.0, 1.0]
    z = np.concatenate([z, z[:, 3:4] + z[:, 4:5]], axis=1)
    x, left = regression(z.conj().T @ z, 2)
    fit = np.linalg.lstsq(z[:, 2:], z[:, :2], rcond=None)[0]
    assert z[:, 2:] @ x == pytest.approx(z[:, 2:] @ fit)
    rest = z[:, :2] - z[:, 2:] @ fit
    assert left == pytest.approx((np.abs(rest) ** 2).sum(0) / (np.abs(z[:, :2]) ** 2).sum(0))
    assert regression(np.array([[2.0]]))[1] == pytest.approx([1.0])  # nothing explains
