"""Statistics: quantiles, means with errors, jackknife, pairs, autocorrelation, records without straight lines."""

import math
from collections.abc import Sequence
from functools import lru_cache
from statistics import NormalDist
from typing import Literal, TypeVar

import numpy as np
import torch
from torch import Tensor

Values = TypeVar("Values", Tensor, np.ndarray)
Numbers = Sequence[float] | np.ndarray


def normal_quantile(upper_tail: float) -> float:
    """Normal deviate that is exceeded with this probability."""
    return NormalDist().inv_cdf(1.0 - upper_tail)


def student_quantile(normal: float, freedom: float) -> float:
    """Student's t with so many degrees of freedom that is as improbable as this normal deviate, sign kept."""
    from scipy.special import ndtr, stdtrit  # slow to import

    return math.copysign(float(stdtrit(freedom, ndtr(-abs(normal)))), normal)


def jackknife_variance(without_one: Values) -> Values:
    """Variance [...] of an estimate from its values [K, ...] with each of K parts left out; zero where there is one.

    (K - 1)/K times the sum of (value - mean)^2.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), eq. 11.5.
    """
    count, moved = len(without_one), without_one - without_one.mean(0)
    return (moved * moved).sum(0) * ((count - 1) / count)  # pyright: ignore[reportReturnType]


def weighted_mean(values: Numbers, errors: Numbers) -> tuple[float, float]:
    """Mean of values (n,) with these standard errors (n,), each weighing by one over its square, and its own error."""
    weights = np.asarray(errors, dtype=float) ** -2.0
    return float(weights @ np.asarray(values) / weights.sum()), float(weights.sum() ** -0.5)


def variance_between(values: Numbers, errors: Numbers) -> float:
    """Variance by which values (n,) differ beyond their standard errors (n,); zero where fewer than two have one.

    (Q - (n - 1)) / (W - sum w^2 / W), no less than zero; weights w = 1/error^2, W their sum, Q the weighted sum of
    squares about their mean.

    Source: DerSimonian and Laird (1986), Controlled Clinical Trials 7, eq. 8 (random effects by moments).
    """
    weights = np.asarray(errors, dtype=float) ** -2.0
    away = np.asarray(values) - weighted_mean(values, errors)[0]
    spare = weights.sum() - (weights**2).sum() / weights.sum()
    excess = weights @ away**2 - (len(away) - 1)
    return max(0.0, float(excess / spare)) if spare > 1e-9 * weights.sum() else 0.0


def paired(sizes: np.ndarray) -> list[int]:
    """The column of each row of a square matrix (n, n): all of them differ, and their sum of sizes is the largest."""
    largest = [int(row.argmax()) for row in sizes]
    if len(set(largest)) == len(largest):
        return largest
    from scipy.optimize import linear_sum_assignment  # slow to import

    return linear_sum_assignment(-sizes)[1].tolist()


def stretches(true: np.ndarray) -> list[tuple[int, int]]:
    """First and last + 1 sample of each stretch of a record (T,) that is true throughout, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def without_line(values: np.ndarray, along: np.ndarray | None = None) -> np.ndarray:
    """Columns (T, n) without their straight lines of least squares over the samples, or along other places (T,)."""
    if not len(values):
        return values
    place = _evenly(len(values)) if along is None else along - along.mean()
    level = values - np.add.reduce(values) / len(values)
    slope = place @ level / max(float(place @ place), 1e-300)
    return level - place[:, None] * slope


@lru_cache(maxsize=8)
def _evenly(samples: int) -> np.ndarray:
    return np.linspace(-1.0, 1.0, samples)


Share = Literal["whole", "pairs", "overlap"]
"""What products of samples are compared with, see `autocorrelation`."""


def regression(products: np.ndarray, responses: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of the first columns on all others, from the products (n, n) of columns that may be complex.

    Coefficients B = (Z^H Z)^+ Z^H Y (n - responses, responses), Y the first columns and Z the others, and the share
    |y - Z b|^2 / |y|^2 of each response's power that the others leave. Columns are scaled to one size first;
    combinations of them below 1e-10 of the largest count as none.

    Source: Bendat and Piersol, Random Data, 4th ed., ch. 7 (multiple coherence is one less that share).
    """
    size = np.sqrt(np.maximum(np.real(np.diag(products)), np.finfo(float).tiny))
    scaled = products / np.outer(size, size)
    outer = scaled[responses:, :responses]
    x = np.linalg.lstsq(scaled[responses:, responses:], outer, rcond=1e-10)[0]
    left = 1.0 - np.real((outer.conj() * x).sum(axis=0))
    return x * size[:responses] / size[responses:, None], left


def autocorrelation(
    records: Tensor, lags: int, *, centred: bool = True, pooled: bool = False, share: Share = "whole"
) -> Tensor:
    """Autocorrelation r_k of records [..., T, n], NaN = missing, at lags k = 1 to `lags`: [..., lags, n].

    centred : about the mean of each record, else about zero. pooled : sums over all leading dimensions, [lags, n].
    share : "whole": sum x(t) x(t+k) / sum x(t)^2, biased towards zero by k/T; "pairs": both sums as means over their
    terms; "overlap": over the root of the products' two sums of squares, never beyond one. White records stay inside
    plus or minus 1.96 / sqrt(T) at 95 % of the lags. Records without power have zeros.

    Source: Box, Jenkins and Reinsel, Time Series Analysis, 4th ed., sec. 2.1.5 (whole); Oppenheim and Schafer,
    Discrete-Time Signal Processing, 3rd ed., sec. 8.7 (products of all lags by one transform).
    """
    present = ~records.isnan()
    x = (records - records.nanmean(dim=-2, keepdim=True) if centred else records).nan_to_num(0.0)
    counted, square = present.to(x.dtype), x.square()

    def lagged(a: Tensor, b: Tensor) -> Tensor:
        """Sums [..., lags, n] of a(t) b(t+k)."""
        one, other = (torch.fft.rfft(part, n=2 * x.shape[-2], dim=-2) for part in (a, b))
        return total(torch.fft.irfft(one.conj() * other, n=2 * x.shape[-2], dim=-2)[..., 1 : lags + 1, :])

    def total(sums: Tensor) -> Tensor:
        return sums.flatten(0, -3).sum(dim=0) if pooled and sums.dim() > 2 else sums

    products = lagged(x, x)
    if share == "overlap":
        power = (lagged(square, counted) * lagged(counted, square)).clamp_min(0.0).sqrt()
    else:
        power = total(square.sum(dim=-2, keepdim=True))
    if share == "pairs":
        power = power / total(counted.sum(dim=-2, keepdim=True)).clamp_min(1.0)
        power = power * lagged(counted, counted).round().clamp_min(1.0)
    return products / power.clamp_min(1e-300)


def correlation_time(correlation: Tensor) -> Tensor:
    """Samples [n] that tell as much as one, from autocorrelation at all lags from 1 on [lags, n]: until it is zero.

    Source: Priestley, Spectral Analysis and Time Series, sec. 5.3.2 (variance of the mean of a correlated record).
    """
    before_zero = (correlation > 0.0).to(correlation.dtype).cumprod(dim=0)
    return 1.0 + 2.0 * (correlation * before_zero).sum(dim=0)  # both sides
