"""Quantiles for few data against SciPy."""

import pytest
from scipy import stats

from rotorid_torch.trace.significance import normal_quantile, student_quantile


@pytest.mark.parametrize("tail", [1e-2, 1e-4])
@pytest.mark.parametrize("freedom", [4, 7, 30])
def test_student_is_near_the_exact_quantile(tail: float, freedom: int) -> None:
    assert normal_quantile(tail) == pytest.approx(stats.norm.isf(tail))
    exact = stats.t.isf(tail, freedom)
    assert 0.98 * exact < student_quantile(normal_quantile(tail), freedom) < 1.12 * exact
