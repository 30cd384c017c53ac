"""What one flight has that the others have not: a value that by chance is not theirs."""

from collections.abc import Callable, Collection, Hashable, Sequence
from typing import TypeVar

import numpy as np

from rotorid_torch.core.statistics import student_quantile, variance_between

SURE = 4.0
"""Standard errors by which a value is apart."""
WRONG = 0.35
"""Share that is left from which on it is wrong."""

One = TypeVar("One", bound=Hashable)
Estimate = tuple[float, float]


def outliers(
    some: Collection[One],
    of: Callable[[One, Sequence[One]], Estimate],
    least: float,
    misfit: Callable[[Sequence[One]], float] | None = None,
) -> dict[One, float]:
    """Those whose value is not that of the others by chance, and how far it is from their mean: more than `least`.

    of : value of one and its standard error, by what others say. misfit : how badly some agree, by default the variance
    of their values. While one is apart by the errors alone, that is left out without which the others agree best, as
    long as most stay; they come back, the last first, but for those that are apart: wrong ones hide no others.

    Source: Hadi (1992), Journal of the Royal Statistical Society B 54, 761 (a clean part that grows).
    """
    right, out, apart = [*some], list[One](), dict[One, float]()
    badly = misfit or (lambda part: float(np.var([of(one, part)[0] for one in part])))

    def clear(one: One) -> bool:
        size, error, _ = _away(one, right, of, least)
        return abs(size) > SURE * error

    while len(right) > len(out) + 2 and any(map(clear, right)):
        out.append(min(right, key=lambda one: badly([other for other in right if other != one])))
        right.remove(out[-1])
    for one in reversed(out):
        size, _, with_others = _away(one, right, of, least)
        if abs(size) > SURE * with_others:
            apart[one] = size
        else:
            right.append(one)
    return apart


def large_shares(
    some: Collection[One],
    of: Callable[[One, Sequence[One]], Estimate],
    misfit: Callable[[Sequence[One]], float] | None = None,
) -> dict[One, float]:
    """Those that leave more of what is to be explained than the others do; what is usual in these is its error.

    of : share of one, and what of it errors of what others say may leave.
    """

    def estimate(one: One, right: Sequence[One]) -> Estimate:
        share, unknown = of(one, right)
        usual = float(np.median([of(other, right)[0] for other in right if other != one]))
        return share, max(SURE * unknown, usual)  # of four standard errors the power is sixteen times

    return {one: size for one, size in outliers(some, estimate, WRONG, misfit).items() if size > 0.0}


def _away(
    one: One, right: Sequence[One], of: Callable[[One, Sequence[One]], Estimate], least: float
) -> tuple[float, float, float]:
    """How far a value is from the mean of others, its standard error, and that with what the others differ by besides.

    The first error is what is known, `SURE` times at least `least`. What others differ by is an estimate from few: its
    Student's t is taken for the normal deviate that is as improbable.
    """
    estimates = np.array([of(other, right) for other in (one, *(other for other in right if other != one))])
    estimates[:, 1] = np.maximum(estimates[:, 1], least / SURE)
    (value, error), (values, errors) = estimates[0], estimates[1:].T
    between = variance_between(values, errors)
    weights = 1.0 / (errors**2 + between)
    weights = weights / weights.sum()
    alike = float(weights @ weights)
    known = error**2 + float(weights**2 @ errors**2)
    student = student_quantile(SURE, max(1.0 / alike - 1.0, 1.0)) / SURE
    unknown = student**2 * between * (1.0 + alike)
    return value - float(weights @ values), float(np.sqrt(known)), float(np.sqrt(known + unknown))
