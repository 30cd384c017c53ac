"""Equations' residuals that were made up: noise beside signals that wander, and something in one equation."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES, MOMENTS
from rotorid_torch.trace.evidence.residual import LeftOver

ROWS = (*FORCES, *MOMENTS)
NAMES = ("u", "p", "q", "col")
FLIGHTS, SAMPLES, STEP = 4, 240, 0.05
TIME = STEP * torch.arange(SAMPLES, dtype=torch.float64).repeat(FLIGHTS)
PARTS = ("residual", "signals", "time", "constants", "tilts", "flight", "named")


def left(row: str, extra: Tensor | None, noise: float = 0.05) -> LeftOver:
    chance = torch.Generator().manual_seed(1)
    made = torch.randn(FLIGHTS * SAMPLES, len(NAMES), generator=chance, dtype=torch.float64).cumsum(0)
    signals = made - made.view(FLIGHTS, SAMPLES, -1).mean(1).repeat_interleave(SAMPLES, 0)
    signals = signals / signals.std(0)
    residual = noise * torch.randn(len(signals), 6, generator=chance, dtype=torch.float64)
    if extra is not None:
        residual[:, ROWS.index(row)] += extra
    own = torch.eye(FLIGHTS, dtype=torch.float64).repeat_interleave(SAMPLES, 0)
    none = residual.new_zeros(*residual.shape, 0)
    return LeftOver(ROWS, residual, NAMES, signals, TIME, own, signals[:, :0], own.argmax(dim=1), none)


def after(onset: float) -> Tensor:
    """One from a time on [N]."""
    return (TIME >= onset).to(torch.float64)


def shorter(over: LeftOver, end: float) -> LeftOver:
    """The same until a time."""
    early = over.time < end
    return replace(over, **{n: getattr(over, n)[early] for n in PARTS})


SIGNALS = left("L", None).signals
U, P, Q, COL = SIGNALS.mT
