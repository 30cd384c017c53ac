"""Statistics: quantiles for few data, jackknife, records without their straight lines."""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TypeVar

import numpy as np
from scipy.special import ndtr, stdtrit
from torch import Tensor

Values = TypeVar("Values", Tensor, np.ndarray)


def normal_quantile(upper_tail: float) -> float:
    """Normal deviate that is exceeded with this probability."""
    return NormalDist().inv_cdf(1.0 - upper_tail)


def student_quantile(normal: float, freedom: float) -> float:
    """Student's t with so many degrees of freedom that is as improbable as this normal deviate, sign kept."""
    return math.copysign(float(stdtrit(freedom, ndtr(-abs(normal)))), normal)


def jackknife_variance(without_one: Values) -> Values:
    """Variance [...] of an estimate from its values [K, ...] with each of K parts left out; zero where there is one.

    (K - 1)/K times the sum of (value - mean)^2.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), eq. 11.5.
    """
    count, moved = len(without_one), without_one - without_one.mean(0)
    return (moved * moved).sum(0) * ((count - 1) / count)  # pyright: ignore[reportReturnType]


def without_line(values: np.ndarray, along: np.ndarray | None = None) -> np.ndarray:
    """Columns (T, n) without their straight lines of least squares over the samples, or along other places (T,)."""
    place = np.linspace(-1.0, 1.0, len(values)) if along is None else along - along[0]
    line = np.stack([np.ones(len(values)), place], axis=1)
    return values - line @ np.linalg.lstsq(line, values, rcond=None)[0]
