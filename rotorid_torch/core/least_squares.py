"""Linear least squares of any rank, as all of identification and tracing ask for it."""

from __future__ import annotations

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
        found = torch.linalg.lstsq(left, right, rcond=rcond, driver="gelsd")
    except torch.linalg.LinAlgError:  # pyright: ignore[reportPrivateImportUsage]
        # hundreds of equal singular values, as heavy damping makes them, may not converge by dividing
        found = torch.linalg.lstsq(left, right, rcond=rcond, driver="gelss")
    return torch.where(finite, found.solution, torch.nan).to(A.device)
