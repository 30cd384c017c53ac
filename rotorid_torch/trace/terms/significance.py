"""What is more than chance: residuals that mean nothing, whether unseen flights gain, what shares are sure."""

import math
from dataclasses import dataclass
from typing import Self

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


@dataclass(frozen=True)
class Share:
    """Share of what is missing that something explains, its standard error, and the flights that tell both."""

    value: float
    error: float = 0.0
    flights: int = 2

    @classmethod
    def of(cls, before: Tensor, after: Tensor) -> Self:
        """1 - sum after / sum before of evidence by flight [F], with the error of the jackknife over the flights."""
        without_one = 1.0 - (after.sum() - after) / (before.sum() - before).clamp_min(1e-300)
        value = 1.0 - float(after.sum()) / max(float(before.sum()), 1e-300)
        return cls(value, float(jackknife_variance(without_one).sqrt()), len(before))

    @property
    def at_least(self) -> float:
        """The share that is exceeded with the confidence of a set of explanations, by Student's t."""
        quantile = student_quantile(normal_quantile(1.0 - SETTINGS.confidence), max(self.flights - 1, 1))
        return self.value - quantile * self.error
