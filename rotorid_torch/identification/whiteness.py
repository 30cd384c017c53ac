"""Are innovations white? Correlation of successive ones, and the portmanteau test of many lags, output by output."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

LAGS = 20
"""Samples over which innovations are compared with themselves."""
COLOURED = 0.5
"""Correlation of successive residuals above which they are no sensors' noise."""


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


@dataclass(frozen=True)
class Colour:
    """How far residuals are from white: by output the correlation of successive ones, and what knowing it would tell.

    gain : rise of the log-likelihood if each residual were predicted from the one before it, all outputs together.
    """

    lag_one: Tensor
    gain: float

    @property
    def outputs(self) -> list[int]:
        """Outputs whose residuals are no sensors' noise."""
        return (self.lag_one > COLOURED).nonzero()[:, 0].tolist()


def colour(residual: Tensor) -> Colour:
    """Of residuals [F, T, ny], NaN = missing.

    Source: Box, Jenkins and Reinsel, Time Series Analysis, sec. 7.1 (likelihood of a first-order process).
    """
    both = ~(residual[:, 1:].isnan() | residual[:, :-1].isnan())
    one, other = (torch.where(both, part, 0.0) for part in (residual[:, 1:], residual[:, :-1]))
    power = (one.square().sum(dim=(0, 1)) * other.square().sum(dim=(0, 1))).sqrt().clamp_min(1e-300)
    lag_one = (one * other).sum(dim=(0, 1)) / power
    gain = -0.5 * both.sum(dim=(0, 1)) * torch.log1p(-lag_one.square().clamp(max=1.0 - 1e-12))
    return Colour(lag_one, float(gain.sum()))
