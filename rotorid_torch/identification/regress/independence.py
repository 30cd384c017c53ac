"""What a regressor of an equation carries beyond others: how far a control is fed back, flapping only follows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from rotorid_torch.identification.regress.equation import Equation, choose_band, columns_of, equation_rows
from rotorid_torch.identification.regress.noisy_least_squares import noisy_least_squares
from rotorid_torch.identification.regress.rows import total_noise


@dataclass(frozen=True)
class Beyond:
    """What a regressor carries beyond others.

    share : of its in-band power without noise, not explained by the others.
    reliability : of that remainder; 0 where it is nothing but noise.
    sigma : by how many standard deviations the remainder exceeds what noise alone leaves.
    gains : the others' coefficients, name ~ sum of gains times others: with a small share only the combination of
        their derivatives with gain times that of this regressor is identifiable.
    """

    name: str
    share: float
    reliability: float
    sigma: float
    gains: dict[str, float]


def beyond(equation: Equation, targets: Sequence[str], conditions: Sequence[str]) -> list[Beyond]:
    """Tell what each target carries in the band beyond the given regressors, one by one.

    Controls against states show how much of a control is not feedback; flapping against what drives it shows whether
    both can be held in one equation.
    """
    band = equation.band or choose_band(equation)
    flights = equation_rows(equation, band)
    information = sum(f.information for f in flights)
    others = [columns_of(f, equation.index(conditions)) for f in flights]
    z, noise = torch.cat([f.regressors for f in others], dim=-2), total_noise(others)
    results = []
    for name, column in zip(targets, equation.index(targets), strict=True):
        y = torch.cat([f.regressors[..., column] for f in flights], dim=-1)
        column_noise = sum(f.noise[..., column] for f in flights)
        gains = noisy_least_squares(z, y, noise).coefficients
        left = (y - z @ gains).square().sum()
        free = information - len(conditions)
        chance = (column_noise + (gains.square() * noise).sum()) * free / information
        excess = left - chance
        results.append(
            Beyond(
                name=name,
                share=float((excess / (y.square().sum() - column_noise).clamp(min=1e-300)).clamp(0.0, 1.0)),
                reliability=float((excess / left.clamp(min=1e-300)).clamp(0.0, 1.0)),
                sigma=float(excess / (chance * (2.0 / free) ** 0.5).clamp(min=1e-300)),
                gains=dict(zip(conditions, gains.tolist(), strict=True)),
            )
        )
    return results
