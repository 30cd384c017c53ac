"""Linear least squares of any rank, as all of identification and tracing ask for it."""

import torch
from torch import Tensor


def least_squares(A: Tensor, B: Tensor, rcond: float | None = None) -> Tensor:
    """The shortest X [..., n, k] with the least |A X - B|, for A [..., m, n] and B [..., m, k]; NaN where not finite.

    By singular values, which torch has on the processor only; those below `rcond` times the largest count as none.
    Never by torch's pivoted factors ("gelsy"), which told a wrong rank.

    Source: LAPACK Users' Guide, 3rd ed., 1999, sec. 2.3.2.
    """
    left, right = A.cpu(), B.cpu()
    finite = (left.isfinite().all(-1) & right.isfinite().all(-1)).all(-1)[..., None, None]  # LAPACK refuses the others
    left, right = (torch.where(finite, part, 0.0) for part in (left, right))
    try:
        fit = torch.linalg.lstsq(left, right, rcond=rcond, driver="gelsd")
    except torch.linalg.LinAlgError:  # pyright: ignore[reportPrivateImportUsage]
        # hundreds of equal singular values, as heavy damping makes them, may not converge by dividing
        fit = torch.linalg.lstsq(left, right, rcond=rcond, driver="gelss")
    return torch.where(finite, fit.solution, torch.nan).to(A.device)


DEPENDENT = 1e-10
"""Share of a column's square that is nothing but rounding."""


def bounded_least_squares(G: Tensor, d: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The x [n] that minimises ½ xᵀG x − dᵀx with low <= x <= high, of several the shortest; NaN where not finite.

    G : [n, n] positive semi-definite; d, low, high : [n]. Columns that depend on others count as rounding.

    Source: Stark and Parker, Computational Statistics 10 (1995), bounded variables; minimum norm by eigenvalues.
    """
    if not (bool(G.isfinite().all()) and bool(d.isfinite().all())):
        return torch.full_like(d, torch.nan)
    scale = G.diagonal().clamp_min(1e-300).sqrt()
    values, vectors = torch.linalg.eigh(G / scale / scale[:, None])
    several = values > DEPENDENT
    root, across = values[several].sqrt(), vectors[:, several].mT
    target = across @ (d / scale) / root
    free = across.mT @ (target / root) / scale
    inside = free.clamp(low, high)
    if len(d) == 1 or len(root) == 0 or bool((inside == free).all()):
        return inside
    from scipy.optimize import lsq_linear  # slow to import

    box = (low * scale).numpy(), (high * scale).numpy()
    best = lsq_linear((root[:, None] * across).numpy(), target.numpy(), box, method="bvls", max_iter=100 * len(d))
    side = torch.from_numpy(best.active_mask)
    return torch.where(side < 0, low, torch.where(side > 0, high, torch.from_numpy(best.x) / scale)).clamp(low, high)
