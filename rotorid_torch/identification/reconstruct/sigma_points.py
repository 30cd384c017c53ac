"""Sigma points, roots of covariances and process noise: what the engines of the unscented filter have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.native.filtering import Weights

ROUNDING = 2.0**-52
"""Relative rounding of float64; a pivot below nx times this is that of a state known exactly."""


def scaled_weights(nx: int) -> Weights:
    """Mean +- sqrt(nx) columns of the covariance's root; the mean itself counts in covariances.

    Source: Wan and van der Merwe, IEEE AS-SPCC symposium (2000), alpha 1, beta 2, kappa 0.
    """
    return Weights(math.sqrt(nx), 2.0, 0.5 / nx)


@dataclass(frozen=True, eq=False)
class ProcessNoise:
    """Covariance of the noise that enters the state between sample k and k + 1, by its entries that are not zero.

    nx : states. rows, columns : [n] places of the entries, rows <= columns. values : [..., T - 1 or 1, n] the entries.
    """

    nx: int
    rows: Tensor
    columns: Tensor
    values: Tensor

    @classmethod
    def constant(cls, Q: Tensor) -> ProcessNoise:
        """The same [nx, nx] for all flights and times."""
        rows, columns = torch.triu(Q != 0.0).nonzero(as_tuple=True)
        return cls(len(Q), rows, columns, Q[rows, columns].unsqueeze(0))

    def at(self, k: int) -> Tensor:
        """Covariance from sample k to k + 1 [..., nx, nx]."""
        entries = self.values[..., k if self.values.shape[-2] > 1 else 0, :]
        Q = entries.new_zeros(*entries.shape[:-1], self.nx, self.nx)
        Q[..., self.rows, self.columns] = entries
        Q[..., self.columns, self.rows] = entries
        return Q


def offsets(root: Tensor, weights: Weights) -> Tensor:
    """Sigma points about the mean [..., 2 nx + 1, nx]: none, + and - the columns of the root."""
    columns = weights.reach * root.mT
    return torch.cat([torch.zeros_like(columns[..., :1, :]), columns, -columns], dim=-2)


def mean_of(points: Tensor, weights: Weights) -> Tensor:
    """[..., n] of the images of the sigma points [..., 2 nx + 1, n]; exact where all agree."""
    centre = points[..., :1, :]
    return centre.squeeze(-2) + weights.other * (points - centre).sum(dim=-2)


def root_weights(mean: Tensor, weights: Weights) -> Tensor:
    """Square roots of the weights in covariances [2 nx + 1, 1], on the device of the mean [..., nx]."""
    weight = torch.full((2 * mean.shape[-1] + 1, 1), weights.other, dtype=torch.float64, device=mean.device)
    weight[0] = weights.centre
    return weight.sqrt()


def root(cov: Tensor) -> Tensor:
    """Lower A with A A' = cov: Cholesky; the column of a state that is known exactly is zero."""
    lower, failed = torch.linalg.cholesky_ex(cov)
    least = cov.shape[-1] * ROUNDING * cov.diagonal(dim1=-2, dim2=-1)
    if not failed.any() and bool((lower.diagonal(dim1=-2, dim2=-1).square() > least).all()):
        return lower
    left, columns = cov.clone(), []
    for j in range(cov.shape[-1]):
        pivot = left[..., j, j]
        determined = ~(pivot > least[..., j])
        column = torch.where(determined, 0.0, pivot).sqrt().unsqueeze(-1)
        column = left[..., :, j] / torch.where(determined.unsqueeze(-1), torch.inf, column)
        column = torch.cat([torch.zeros_like(column[..., :j]), column[..., j:]], dim=-1)
        left = left - column.unsqueeze(-1) * column.unsqueeze(-2)
        columns.append(column)
    return torch.stack(columns, dim=-1)


def divide(cross: Tensor, cov: Tensor) -> Tensor:
    """Cross times the inverse of cov; states that are known exactly are left out."""
    lower = root(cov)
    pivot = lower.diagonal(dim1=-2, dim2=-1)
    huge = torch.zeros_like(pivot).masked_fill(pivot <= 0.0, 1e300)
    return torch.cholesky_solve(cross.mT, lower + torch.diag_embed(huge)).mT
