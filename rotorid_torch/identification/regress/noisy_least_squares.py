"""Least squares with noisy regressors, Gaussian priors and residuals of any colour; batched, in torch alone."""

from dataclasses import dataclass

import torch
from torch import Tensor

NOISE_SHARE_LIMIT = 0.75
"""Largest share of noise taken out of a direction of regressor space: none is stretched more than fourfold."""
NULL_DIRECTION = 1e-10
"""Singular value on unit columns, of the largest, below which a direction is not identifiable."""


@dataclass(frozen=True)
class Solution:
    """Coefficients and the algebra around them.

    coefficients : (..., n). inverse : (..., n, n) of the normal matrix less noise plus prior.
    leverage : (..., m) of the rows. unknown : (..., n) true where a null direction touches the coefficient.
    noise_filled : (...) true where noise fills a direction so far that taking it out had to be limited.
    condition, vif, reliability_beyond : see `Regression`.
    """

    coefficients: Tensor
    inverse: Tensor
    leverage: Tensor
    unknown: Tensor
    noise_filled: Tensor
    condition: Tensor
    vif: Tensor
    reliability_beyond: Tensor


def noisy_least_squares(z: Tensor, y: Tensor, noise: Tensor, prior: tuple[Tensor, Tensor] | None = None) -> Solution:
    """Solve (Z'Z - noise + prior) theta = Z'y by singular values of the column-scaled rows.

    In the orthonormal coordinates of the rows the noise is a matrix with eigenvalues between 0 (clean) and 1 (nothing
    but noise); each is limited, so the corrected normal matrix stays positive definite whatever the noise.

    z : (..., m, n) rows. y : (..., m). noise : (..., n) noise power of each column, summed over the rows.
    prior : mean (..., n) and weight (..., n), the residual variance over the prior variance; zero weight is no prior.

    Source: Fuller, Measurement Error Models, section 2.5 (modified to stay positive definite).
    """
    rows, columns = z.shape[-2:]
    scale = torch.linalg.vector_norm(z, dim=-2)
    scale = torch.where(scale > 0.0, scale, 1.0)
    unit, target = z / scale.unsqueeze(-2), y
    if prior is not None:
        root = prior[1].sqrt().expand(scale.shape)
        unit = torch.cat((unit, torch.diag_embed(root / scale)), dim=-2)
        target = torch.cat((y, root * prior[0]), dim=-1)
    u, s, vh = torch.linalg.svd(unit, full_matrices=False)
    determined = s > NULL_DIRECTION * s[..., :1]
    whiten = vh.mT * torch.where(determined, 1.0 / torch.where(determined, s, 1.0), 0.0).unsqueeze(-2)
    shares = whiten.mT @ ((noise / scale.square()).unsqueeze(-1) * whiten)
    share, axes = torch.linalg.eigh(shares)
    stretch = (axes / (1.0 - share.clamp(max=NOISE_SHARE_LIMIT)).unsqueeze(-2)) @ axes.mT
    back = whiten @ stretch / scale.unsqueeze(-1)
    plain = whiten @ whiten.mT
    beyond = (plain.square() * (noise / scale.square()).unsqueeze(-2)).sum(-1)
    vif = plain.diagonal(dim1=-2, dim2=-1)
    unknown = (vh.square() * ~determined.unsqueeze(-1)).sum(-2) > 1e-8
    return Solution(
        coefficients=(back @ (u.mT @ target.unsqueeze(-1))).squeeze(-1),
        inverse=back @ whiten.mT / scale.unsqueeze(-2),
        leverage=u[..., :rows, :].square().sum(-1),
        unknown=unknown,
        noise_filled=share[..., columns - 1] > NOISE_SHARE_LIMIT,
        condition=torch.where(s[..., -1] > 0.0, s[..., 0] / s[..., -1], torch.inf),
        vif=torch.where(unknown, torch.inf, vif),
        reliability_beyond=torch.where(unknown, 0.0, 1.0 - beyond / vif.clamp(min=1e-300)),
    )


def smooth_variance(power: Tensor, freedom: Tensor, reach: int) -> Tensor:
    """Variance at each frequency, a moving mean over its neighbours: sum of squares over sum of degrees of freedom.

    power : (..., 2 M) squared residuals, real over imaginary parts.
    freedom : (..., 2 M) share of each row left after the fit.
    reach : neighbours on each side.

    Returns (..., 2 M), the same for the real and the imaginary part.
    """
    both, free = (a.unflatten(-1, (2, -1)).sum(-2) for a in (power, freedom))
    index = torch.arange(both.shape[-1], device=power.device)
    near = ((index.unsqueeze(0) - index.unsqueeze(1)).abs() <= reach).to(power.dtype)
    variance = (both @ near) / (free @ near).clamp(min=1e-3)
    return torch.cat((variance, variance), dim=-1)
