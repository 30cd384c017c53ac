"""Whether what a regression leaves acts back on its regressors, through feedback, which biases the coefficients.

Without it, the residual and the regressors are strangers at all lags. With it, a regressor follows the residual: their
correlation is large where the regressor comes later, and larger than where it comes first.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

LAGS = 24
"""Lags that are looked at to either side, apart by half the inverse of the band."""
SURE = 4.5
"""Of the standard deviation that chance leaves in a correlation."""
STRONG = 0.3
"""Correlation that is told."""
LATER = 1.2
"""How many times larger it is where the regressor comes later than where it comes first."""


class Follower(NamedTuple):
    """A record that follows another: its place, the correlation, and after how long, s."""

    place: int
    correlation: float
    seconds: float


def acting_back(residual: Tensor, regressors: Sequence[Tensor], frequencies: Tensor) -> Iterator[str]:
    """A sentence on the regressors that follow the residual of a regression; nothing for a batch.

    residual : (M,) complex spectrum. regressors : of each flight (2 M', n), real over imaginary. frequencies : (M,) Hz.
    """
    if residual.dim() > 1:
        return
    spectra = torch.cat([torch.complex(*rows.chunk(2, dim=-2)) for rows in regressors])
    for one in followers(residual, spectra, frequencies):
        yield (
            f"regressor {one.place} follows the residual (correlation {one.correlation:.2f} after {one.seconds:.2g} s):"
            " what is not explained acts back on it, through feedback or in moving air; its coefficient may be biased"
        )


def followers(residual: Tensor, others: Tensor, frequencies: Tensor) -> Iterator[Follower]:
    """Which of some records follow a residual.

    residual : (M,) complex spectrum. others : (M, n) spectra. frequencies : (M,) Hz, flight after flight.

    Source: Ljung, System Identification (2nd ed.), sec. 16.6 (correlation of residuals and inputs at negative lags).
    """
    band = float(frequencies.max() - frequencies.min()) if len(frequencies) else 0.0
    power = residual.abs().square().sum() * others.abs().square().sum(dim=0)
    if band <= 0.0 or not bool((power > 0.0).any()):
        return
    lags = torch.arange(1, LAGS + 1, dtype=torch.float64) / (2.0 * band)
    cross = residual.conj().unsqueeze(-1) * others
    scale = power.clamp(min=1e-300).sqrt()
    chance = cross.abs().square().sum(dim=0).mul(0.5).sqrt() / scale
    turn = torch.exp(2j * torch.pi * lags[:, None] * frequencies)
    later, earlier = ((way @ cross).real / scale for way in (turn, turn.conj()))
    largest, place = later.abs().max(dim=0)
    for j in range(others.shape[-1]):
        size = float(largest[j])
        first = float(earlier[:, j].abs().max())
        if size > max(STRONG, SURE * float(chance[j]), LATER * first):
            yield Follower(j, float(later[place[j], j]), float(lags[place[j]]))
