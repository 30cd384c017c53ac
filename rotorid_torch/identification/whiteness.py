"""Are innovations white? Correlation of successive ones, and the portmanteau test of many lags, output by output."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

LAGS = 20
"""Samples over which innovations are compared with themselves."""


@dataclass(frozen=True)
class Whiteness:
    """Of innovations in units of their own covariance, one number per output.

    lag_one : correlation of successive samples. statistic : Ljung's and Box's, of `lags` lags; chi-square with as many
    degrees of freedom where they are white. p : probability of a larger one then.
    """

    lags: int
    lag_one: Tensor
    statistic: Tensor
    p: Tensor


def whiteness(innovations: Tensor, spreads: Tensor) -> Whiteness:
    """Test of innovations [F, T, ny] (NaN = missing) with covariances [F, T, ny, ny].

    Source: Ljung and Box (1978), Biometrika 65.
    """
    there = ~innovations.isnan()
    safe = torch.where(there.any(-1)[..., None, None], spreads, torch.eye(innovations.shape[-1]).to(spreads))
    root = torch.linalg.cholesky(safe)
    white = torch.linalg.solve_triangular(root, innovations.nan_to_num(0.0).unsqueeze(-1), upper=False).squeeze(-1)
    white = torch.where(there, white, 0.0)
    count, power = there.sum(dim=(0, 1)), white.square().sum(dim=(0, 1)).clamp_min(1e-300)
    lags = min(LAGS, innovations.shape[1] // 4)
    correlations, pairs = [], []
    for lag in range(1, lags + 1):
        pairs.append((there[:, lag:] & there[:, :-lag]).sum(dim=(0, 1)).clamp_min(1))
        products = (white[:, lag:] * white[:, :-lag]).sum(dim=(0, 1))
        correlations.append(products / pairs[-1] / (power / count.clamp_min(1)))
    r, n = torch.stack(correlations), torch.stack(pairs)
    statistic = (r.square() * n).sum(dim=0)
    return Whiteness(
        lags, r[0], statistic, torch.special.gammaincc(torch.full_like(statistic, lags / 2.0), statistic / 2.0)
    )
