"""Quantiles for few data against SciPy; unseen flights gain by more than chance, or do not."""

import pytest
import torch
from scipy import stats

from rotorid_torch.trace.significance import helps, normal_quantile, student_quantile


@pytest.mark.parametrize("tail", [0.3, 1e-2, 1e-4])
@pytest.mark.parametrize("freedom", [1, 2, 3, 4.5, 7, 30])
def test_student_is_the_exact_quantile(tail: float, freedom: float) -> None:
    assert normal_quantile(tail) == pytest.approx(stats.norm.isf(tail))
    exact = stats.t.isf(tail, freedom)
    assert student_quantile(normal_quantile(tail), freedom) == pytest.approx(exact, rel=1e-6)
    assert student_quantile(-normal_quantile(tail), freedom) == pytest.approx(-exact, rel=1e-6)


@pytest.mark.parametrize(
    ("better", "answer"),
    [
        ((0.1, 0.12, 0.08, 0.11), True),
        ((0.3, -0.2, -0.1, 0.25), False),
        ((1.0, -0.01, -0.01, -0.01), False),
        ((-0.1, -0.1), False),
        ((0.1,), True),
        ((0.1, 0.3, 0.05, float("inf")), True),
        ((float("inf"), -0.1, -0.1, -0.1), False),
        ((float("nan"), 0.1, 0.1, 0.1), False),
    ],
)
def test_flights_that_no_fit_has_seen_gain_more_than_by_chance(better: tuple[float, ...], answer: bool):
    assert helps(torch.tensor(better, dtype=torch.float64)) is answer
