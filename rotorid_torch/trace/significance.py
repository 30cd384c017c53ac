"""What is more than chance: quantiles of few data, residuals that mean nothing, whether unseen flights gain."""

from __future__ import annotations

import math
from statistics import NormalDist

import torch
from scipy.special import ndtr, stdtrit
from torch import Tensor

FAR = math.log(10.0)
"""Log ratio of errors beyond which a model flies away."""


def normal_quantile(upper_tail: float) -> float:
    """Normal deviate that is exceeded with this probability."""
    return NormalDist().inv_cdf(1.0 - upper_tail)


def student_quantile(normal: float, freedom: float) -> float:
    """Student's t with so many degrees of freedom that is as improbable as this normal deviate, sign kept."""
    return math.copysign(float(stdtrit(freedom, ndtr(-abs(normal)))), normal)


def helps(better: Tensor) -> bool:
    """Whether unseen flights [F] gain, by log ratios: in the mean by more than its standard error, and half of them.

    One in which a model flew away tells no more than that it did.
    """
    count, limited = len(better), better.clamp(-FAR, FAR)
    error = float(limited.std() / math.sqrt(count)) if count > 1 else 0.0
    return float(limited.mean()) > error and int((better > 0).sum()) * 2 >= count


def turned(record: Tensor, count: int, chance: torch.Generator) -> Tensor:
    """Residuals of the same colour that cannot know of the motion [T, n, count], made of a flight's own [T, n].

    Each is the record from another time on, what was before at its end, all channels alike; its sign is drawn.
    """
    turns = torch.randint(1, max(2, len(record)), (count,), generator=chance)
    signs = 2.0 * torch.randint(0, 2, (count,), generator=chance) - 1.0
    made = [float(sign) * record.roll(int(n), dims=0) for n, sign in zip(turns, signs, strict=True)]
    return torch.stack(made, dim=-1) if made else record.new_zeros(*record.shape, 0)
