"""Quantiles of the normal distribution, and of Student's t for few data."""

from __future__ import annotations

import math
from statistics import NormalDist


def normal_quantile(upper_tail: float) -> float:
    """Normal deviate that is exceeded with this probability."""
    return NormalDist().inv_cdf(1.0 - upper_tail)


def student_quantile(normal: float, freedom: float) -> float:
    """Student's t with so many degrees of freedom that is as improbable as this normal deviate, sign kept.

    Source: Wallace, Annals of Mathematical Statistics 30 (1959), 1124, solved for t; too large, on the safe side, below
    four degrees.
    """
    scale = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
    exponent = min((normal / scale) ** 2 / freedom, 700.0)
    return math.copysign(math.sqrt(freedom * math.expm1(exponent)), normal)
