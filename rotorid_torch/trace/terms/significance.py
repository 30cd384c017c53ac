"""What is more than chance: residuals that mean nothing, whether unseen flights gain."""

import math

import torch
from torch import Tensor

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
