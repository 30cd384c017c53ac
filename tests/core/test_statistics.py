"""Quantiles for few data against SciPy."""

import pytest
from scipy import stats

from rotorid_torch.core.statistics import normal_quantile, student_quantile


@pytest.mark.parametrize("tail", [0.3, 1e-2, 1e-4])
@pytest.mark.parametrize("freedom", [1, 2, 3, 4.5, 7, 30])
def test_student_is_the_exact_quantile(tail: float, freedom: float) -> None:
    assert normal_quantile(tail) == pytest.approx(stats.norm.isf(tail))
    exact = stats.t.isf(tail, freedom)
    assert student_quantile(normal_quantile(tail), freedom) == pytest.approx(exact, rel=1e-6)
    assert student_quantile(-normal_quantile(tail), freedom) == pytest.approx(-exact, rel=1e-6)
