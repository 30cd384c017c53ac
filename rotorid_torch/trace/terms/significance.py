"""What is more than chance: residuals that mean nothing, whether unseen flights gain, what shares are sure."""

import math

import torch
from torch import Tensor

from rotorid_torch.core.statistics import jackknife_variance, normal_quantile, student_quantile
from rotorid_torch.trace.terms.settings import SETTINGS


def exceeds(better: Tensor, confidence: float = SETTINGS.confidence) -> bool:
    """Whether the mean of log ratios [F] lies above zero, by a one-sided t-test; of one flight, whether it does."""
    better = better[better.isfinite()]
    if len(better) < 2:
        return bool((better > 0.0).any())
    from scipy.special import stdtrit  # slow to import

    error = float(better.std()) / math.sqrt(len(better))
    return float(better.mean()) > float(stdtrit(len(better) - 1, confidence)) * error


def turned(record: Tensor, count: int, chance: torch.Generator) -> Tensor:
    """Residuals of the same colour that cannot know of the motion [T, n, count], made of a flight's own [T, n].

    Each is the record from another time on, what was before at its end, all channels alike; its sign is drawn.
    """
    turns = torch.randint(1, max(2, len(record)), (count,), generator=chance)
    signs = 2.0 * torch.randint(0, 2, (count,), generator=chance) - 1.0
    records = [float(sign) * record.roll(int(n), dims=0) for n, sign in zip(turns, signs, strict=True)]
    return torch.stack(records, dim=-1) if records else record.new_zeros(*record.shape, 0)


def share_at_least(before: Tensor, after: Tensor) -> float:
    """Share 1 - sum after / sum before of evidence by flight [F] that is exceeded with the confidence of a set.

    By Student's t, with the standard error of the jackknife over the flights.
    """
    without_one = 1.0 - (after.sum() - after) / (before.sum() - before).clamp_min(1e-300)
    share, error = 1.0 - float(after.sum()) / max(float(before.sum()), 1e-300), jackknife_variance(without_one).sqrt()
    quantile = student_quantile(normal_quantile(1.0 - SETTINGS.confidence), max(len(before) - 1, 1))
    return share - quantile * float(error)
