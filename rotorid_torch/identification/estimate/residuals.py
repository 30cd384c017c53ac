"""Residuals: their covariance, residuals and derivatives in units of it, and whether they are white."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.statistics import autocorrelation

LEAST_EIGENVALUE = 1e-6
"""Of the residuals' correlation matrix."""


@dataclass(frozen=True)
class Moments:
    """Sums over residuals: products [ny, ny], and how many samples each is made of [ny, ny]."""

    products: Tensor
    count: Tensor

    @property
    def mean_square(self) -> Tensor:
        """[ny]; NaN where there is nothing."""
        return self.products.diagonal() / self.count.diagonal()


def products(residual: Tensor) -> Tensor:
    """Of each segment of a residual [S, T, ny], NaN = missing: products and numbers of samples, [S, 2, ny, ny]."""
    present = ~residual.isnan()
    filled, weights = torch.where(present, residual, 0.0), present.to(residual)
    return torch.stack([filled.mT @ filled, weights.mT @ weights], dim=1)


@dataclass(frozen=True)
class Noise:
    """How the residual's covariance comes about.

    `kind` "diagonal" or "full" is estimated from the residuals themselves, at least `least` (standard deviations [ny]);
    "held" is `matrix` [ny, ny].
    """

    kind: str
    least: Tensor
    matrix: Tensor | None = None

    def covariance(self, moments: Moments) -> Tensor:
        """[ny, ny] from the residuals' sums."""
        if self.matrix is not None:
            return self.matrix
        pairs = moments.products / moments.count.clamp_min(1.0)
        if self.kind == "diagonal":
            return torch.diag(torch.maximum(pairs.diagonal(), self.least**2))
        return _definite(pairs + torch.diag((self.least**2 - pairs.diagonal()).clamp_min(0.0)))


def _definite(covariance: Tensor) -> Tensor:
    """With the correlations' eigenvalues at least so large that it can be inverted."""
    sd = covariance.diagonal().clamp_min(1e-300).sqrt()
    values, vectors = torch.linalg.eigh(covariance / sd / sd[:, None])
    return (vectors * values.clamp_min(LEAST_EIGENVALUE)) @ vectors.mT * sd * sd[:, None]


@dataclass(frozen=True)
class Whitener:
    """Residuals and their derivatives in units of the noise; missing samples become zero, exactly as if left out."""

    covariance: Tensor
    valid: Tensor  # [S, T, ny]
    table: Tensor | None = None  # [patterns, ny, ny] for a full covariance
    pattern: Tensor | None = None  # [S, T]

    @classmethod
    def of(cls, covariance: Tensor, valid: Tensor) -> Whitener:
        """With one whitening matrix for each pattern of missing channels."""
        if bool((covariance == torch.diag(covariance.diagonal())).all()):
            return cls(covariance, valid)
        rows, pattern = torch.unique(valid.flatten(0, 1), dim=0, return_inverse=True)
        table = covariance.new_zeros(len(rows), *covariance.shape)
        for k, row in enumerate(rows):
            measured = row.nonzero()[:, 0]
            chosen = covariance[measured[:, None], measured]
            root, eye = torch.linalg.cholesky(chosen), torch.eye(len(measured)).to(chosen)
            table[k, measured[:, None], measured] = torch.linalg.solve_triangular(root, eye, upper=False)
        return cls(covariance, valid, table, pattern.view(valid.shape[:2]))

    def apply(self, values: Tensor, first: int = 0) -> Tensor:
        """Values [S, k, ny, n] of the samples from `first` on."""
        part = slice(first, first + values.shape[1])
        values = torch.where(self.valid[:, part, :, None], values, 0.0)
        if self.table is None or self.pattern is None:
            return values / self.covariance.diagonal().sqrt()[:, None]
        return self.table[self.pattern[:, part]] @ values

    def log_determinants(self) -> Tensor:
        """Of the covariance, summed over the samples of each segment [S]."""
        if self.table is None or self.pattern is None:
            return self.valid.sum(dim=1).to(self.covariance) @ self.covariance.diagonal().log()
        diagonals = self.table.diagonal(dim1=-2, dim2=-1)
        logs = -2.0 * torch.where(diagonals > 0, diagonals, 1.0).log().sum(-1)
        return logs[self.pattern].sum(dim=1)


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
    present = ~innovations.isnan()
    safe = torch.where(present.any(-1)[..., None, None], spreads, torch.eye(innovations.shape[-1]).to(spreads))
    root = torch.linalg.cholesky(safe)
    white = torch.linalg.solve_triangular(root, innovations.nan_to_num(0.0).unsqueeze(-1), upper=False).squeeze(-1)
    white = torch.where(present, white, 0.0)
    lags = min(LAGS, innovations.shape[1] // 4)
    r = autocorrelation(torch.where(present, white, torch.nan), lags, centred=False, pooled=True, share="pairs")
    n = [(present[:, lag:] & present[:, :-lag]).sum(dim=(0, 1)).clamp_min(1) for lag in range(1, lags + 1)]
    statistic = (r.square() * torch.stack(n)).sum(dim=0)
    p = torch.special.gammaincc(torch.full_like(statistic, lags / 2.0), statistic / 2.0)
    return Whiteness(lags, r[0], statistic, p)


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
    lag_one = autocorrelation(residual, 1, centred=False, pooled=True, share="overlap")[0]
    gain = -0.5 * both.sum(dim=(0, 1)) * torch.log1p(-lag_one.square().clamp(max=1.0 - 1e-12))
    return Colour(lag_one, float(gain.sum()))
