"""Non-augmented unscented Kalman filter with two concatenated unscented transforms, and the unscented RTS smoother.

Sigma points sit at the mean and at +- sqrt(n) columns of the covariance's root (alpha 1, kappa 0, beta 2): every
weight is positive, so that each covariance is a sum of squares (Joseph form) and stays symmetric positive definite.
Sources: Julier and Uhlmann, Proc. IEEE 92 (2004); Wu et al., IEEE Signal Processing Letters 12 (2005), on redrawing
the sigma points after the process noise; Sarkka, IEEE Trans. Automatic Control 53 (2008), on the smoother.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from rotorid_torch.core.integrate import step
from rotorid_torch.errors import InputError

Dynamics = Callable[[Tensor, Tensor], Tensor]
"""f(x[..., nx], u[..., nu]) -> dx/dt [..., nx], or h(x, u) -> y [..., ny]"""
NoiseAt = Callable[[int], Tensor]
"""covariance of the process noise [..., nx, nx] that enters between sample k and k + 1"""


@dataclass(frozen=True)
class Filtered:
    """What filter and smoother know, sample by sample.

    means, covariances : [..., T, nx], [..., T, nx, nx] state, given the outputs up to and with each sample.
    innovations : [..., T, ny] output minus its prediction, NaN where the output is missing.
    innovation_covariances : [..., T, ny, ny] of these predictions, measurement noise included.
    log_likelihood : [...] sum over all samples of the log density of the outputs that are present.
    smoothed_means, smoothed_covariances : the same as means and covariances given all outputs; None without smoothing.
    """

    means: Tensor
    covariances: Tensor
    innovations: Tensor
    innovation_covariances: Tensor
    log_likelihood: Tensor
    smoothed_means: Tensor | None
    smoothed_covariances: Tensor | None


def unscented_filter(
    f: Dynamics,
    h: Dynamics,
    x0: Any,
    P0: Any,
    Q: Any,
    R: Any,
    controls: Any,
    outputs: Any,
    dt: float,
    smooth: bool = True,
) -> Filtered:
    """Filter and smooth sampled outputs of dx/dt = f(x, u) + noise, y = h(x, u) + noise, for any f and h.

    Parameters
    ----------
    f, h : f(x, u) -> dx/dt [..., nx] and h(x, u) -> y [..., ny]; both broadcast over x [..., nx], u [..., nu].
        f is integrated by one Runge-Kutta step a sample, controls linear between samples.
    x0, P0 : [..., nx], [..., nx, nx] mean and covariance of the first sample's state before its outputs are seen.
    Q : [nx, nx] covariance of the noise added to the state at each sample.
    R : [ny, ny] covariance of the outputs' noise.
    controls : [..., T, nu]; nu may be 0.
    outputs : [..., T, ny]; NaN marks a missing one, which is left out exactly.
    dt : sample interval, s.
    smooth : also run the Rauch-Tung-Striebel smoother.

    Leading dimensions (flights) are a batch. Arrays of numpy are taken as well; all is done in float64.
    To estimate a constant parameter, append it to the state with a rate of zero.

    Returns
    -------
    Filtered : .means .covariances .innovations .innovation_covariances .log_likelihood .smoothed_means
        .smoothed_covariances

    Raises
    ------
    InputError : shapes that do not fit, NaN in anything but the outputs, a covariance that is not symmetric.
    """
    x0, P0, Q, R, controls, outputs = (
        torch.as_tensor(a, dtype=torch.float64) for a in (x0, P0, Q, R, controls, outputs)
    )
    _check(f, h, x0, P0, Q, R, controls, outputs, dt)
    with torch.no_grad():
        return filter_and_smooth(f, h, (x0, P0), lambda k: Q, R, controls, outputs, dt, smooth)


def filter_and_smooth(
    f: Dynamics,
    h: Dynamics,
    prior: tuple[Tensor, Tensor],
    noise_at: NoiseAt,
    R: Tensor,
    controls: Tensor,
    outputs: Tensor,
    dt: float,
    smooth: bool = True,
) -> Filtered:
    """`unscented_filter` without its checks, and with process noise that may change with time."""
    batch = torch.broadcast_shapes(prior[0].shape[:-1], prior[1].shape[:-2], controls.shape[:-2], outputs.shape[:-2])
    tape = _Tape(batch, outputs.shape[-2], prior[0].shape[-1], outputs.shape[-1], smooth)
    u = controls.expand(*batch, *controls.shape[-2:]).movedim(-2, 0).unsqueeze(-2)
    y = outputs.expand(*batch, *outputs.shape[-2:]).movedim(-2, 0)
    missing = y.isnan()
    gaps = missing.flatten(1).any(dim=1).tolist()
    weights = _weights(prior[0].shape[-1])
    root_R = _root(R)
    mean, cov = (a.expand(*batch, *a.shape[-k:]) for k, a in zip((1, 2), prior, strict=True))
    for k in range(len(y)):
        if k:
            mean, cov = _predict(tape, k - 1, f, mean, cov, noise_at(k - 1), u[k - 1], u[k], dt, weights)
        mean, cov = _update(tape, k, h, mean, cov, R, root_R, u[k], y[k], missing[k] if gaps[k] else None, weights)
    if smooth:
        _smooth(tape)
    return tape.result()


class _Tape:
    """What filter and smoother write down, time first; the smoother overwrites `leak` and reads `gain`."""

    def __init__(self, batch: torch.Size, samples: int, nx: int, ny: int, smooth: bool) -> None:
        def empty(rows: int, *shape: int) -> Tensor:
            return torch.empty(rows, *batch, *shape, dtype=torch.float64)

        self.mean, self.cov = empty(samples, nx), empty(samples, nx, nx)
        self.innovation, self.spread = empty(samples, ny), empty(samples, ny, ny)
        self.log_likelihood = torch.zeros(batch, dtype=torch.float64)
        kept = samples if smooth else 0
        self.predicted, self.gain, self.leak = empty(kept, nx), empty(kept, nx, nx), empty(kept, nx, nx)
        self.smoothed = empty(kept, nx)

    def result(self) -> Filtered:
        kept = bool(self.smoothed.shape[0])
        return Filtered(
            means=self.mean.movedim(0, -2),
            covariances=_symmetric(self.cov).movedim(0, -3),
            innovations=self.innovation.movedim(0, -2),
            innovation_covariances=_symmetric(self.spread).movedim(0, -3),
            log_likelihood=self.log_likelihood,
            smoothed_means=self.smoothed.movedim(0, -2) if kept else None,
            smoothed_covariances=_symmetric(self.leak).movedim(0, -3) if kept else None,
        )


def _predict(
    tape: _Tape,
    k: int,
    f: Dynamics,
    mean: Tensor,
    cov: Tensor,
    Q: Tensor,
    u0: Tensor,
    u1: Tensor,
    dt: float,
    weights: tuple[Tensor, float],
) -> tuple[Tensor, Tensor]:
    """Process transform from sample k to k + 1; the smoother's gain and the covariance it cannot remove."""
    root_weight, reach = weights
    offsets = _offsets(_root(cov), reach)
    points = step(lambda t, x, u: f(x, u), torch.zeros(()), mean.unsqueeze(-2) + offsets, u0, u1, dt)
    ahead = points[..., 1:, :].mean(dim=-2)
    spread = root_weight * (points - ahead.unsqueeze(-2))
    cov_ahead = spread.mT @ spread + Q
    if tape.gain.shape[0]:
        start = root_weight * offsets
        gain = _divide(start.mT @ spread, cov_ahead)
        rest = start - spread @ gain.mT
        tape.predicted[k + 1], tape.gain[k], tape.leak[k] = ahead, gain, rest.mT @ rest + gain @ Q @ gain.mT
    return ahead, cov_ahead


def _update(
    tape: _Tape,
    k: int,
    h: Dynamics,
    mean: Tensor,
    cov: Tensor,
    R: Tensor,
    root_R: Tensor,
    u: Tensor,
    y: Tensor,
    missing: Tensor | None,
    weights: tuple[Tensor, float],
) -> tuple[Tensor, Tensor]:
    """Measurement transform on redrawn sigma points; rows that are missing get no cross covariance, so no gain."""
    root_weight, reach = weights
    offsets = _offsets(_root(cov), reach)
    points = h(mean.unsqueeze(-2) + offsets, u)
    expected = points[..., 1:, :].mean(dim=-2)
    start, spread = root_weight * offsets, root_weight * (points - expected.unsqueeze(-2))
    innovation, S = y - expected, spread.mT @ spread + R
    tape.innovation[k], tape.spread[k] = innovation, S
    count = y.shape[-1]
    if missing is not None:
        present = (~missing).to(S.dtype)
        innovation, spread = innovation.nan_to_num(nan=0.0), spread * present.unsqueeze(-2)
        S = S * present.unsqueeze(-1) * present.unsqueeze(-2) + torch.diag_embed(1.0 - present)
        count = present.sum(dim=-1)
    root_S = torch.linalg.cholesky(S)
    gain = torch.cholesky_solve(spread.mT @ start, root_S).mT
    factor = torch.cat([start - spread @ gain.mT, (gain @ root_R).mT], dim=-2)
    white = torch.linalg.solve_triangular(root_S, innovation.unsqueeze(-1), upper=False).squeeze(-1)
    logdet = root_S.diagonal(dim1=-2, dim2=-1).log().sum(dim=-1)
    tape.log_likelihood -= 0.5 * (white.square().sum(dim=-1) + count * math.log(2.0 * math.pi)) + logdet
    tape.mean[k] = mean = mean + (gain @ innovation.unsqueeze(-1)).squeeze(-1)
    tape.cov[k] = cov = factor.mT @ factor
    return mean, cov


def _smooth(tape: _Tape) -> None:
    """Rauch-Tung-Striebel recursion; the covariance is the leak plus what the next sample passes back."""
    tape.smoothed[-1], tape.leak[-1] = tape.mean[-1], tape.cov[-1]
    for k in range(len(tape.mean) - 2, -1, -1):
        change = tape.smoothed[k + 1] - tape.predicted[k + 1]
        tape.smoothed[k] = tape.mean[k] + (tape.gain[k] @ change.unsqueeze(-1)).squeeze(-1)
        tape.leak[k] += tape.gain[k] @ tape.leak[k + 1] @ tape.gain[k].mT


def _weights(nx: int) -> tuple[Tensor, float]:
    """Square roots of the covariance's weights [2 nx + 1, 1] (the centre's is beta) and the reach of the points."""
    weight = torch.full((2 * nx + 1, 1), 0.5 / nx, dtype=torch.float64)
    weight[0] = 2.0
    return weight.sqrt(), math.sqrt(nx)


def _offsets(root: Tensor, reach: float) -> Tensor:
    """Sigma points about the mean [..., 2 nx + 1, nx]: none, + and - the columns of the root."""
    columns = reach * root.mT
    return torch.cat([torch.zeros_like(columns[..., :1, :]), columns, -columns], dim=-2)


def _root(cov: Tensor) -> Tensor:
    """A with A A' = cov: Cholesky, or from eigenvalues where a state is known exactly (zero variance)."""
    root, failed = torch.linalg.cholesky_ex(cov)
    if not failed.any():
        return root
    scale = _scale(cov)
    value, vector = torch.linalg.eigh(cov / (scale.unsqueeze(-1) * scale.unsqueeze(-2)))
    return scale.unsqueeze(-1) * vector * value.clamp(min=0.0).sqrt().unsqueeze(-2)


def _divide(cross: Tensor, cov: Tensor) -> Tensor:
    """Cross times the inverse of cov, or its pseudo-inverse where a state is known exactly."""
    root, failed = torch.linalg.cholesky_ex(cov)
    if not failed.any():
        return torch.cholesky_solve(cross.mT, root).mT
    scale = _scale(cov)
    inverse = torch.linalg.pinv(cov / (scale.unsqueeze(-1) * scale.unsqueeze(-2)), rtol=1e-13, hermitian=True)
    return cross @ (inverse / (scale.unsqueeze(-1) * scale.unsqueeze(-2)))


def _scale(cov: Tensor) -> Tensor:
    """Standard deviations, 1 where zero."""
    deviation = cov.diagonal(dim1=-2, dim2=-1).clamp(min=0.0).sqrt()
    return torch.where(deviation > 0.0, deviation, 1.0)


def _symmetric(cov: Tensor) -> Tensor:
    """Rounding of the matrix products taken out, in place; piece by piece, to spare memory."""
    for part in cov.split(256):
        part.copy_(0.5 * (part + part.mT))
    return cov


def _check(
    f: Dynamics,
    h: Dynamics,
    x0: Tensor,
    P0: Tensor,
    Q: Tensor,
    R: Tensor,
    controls: Tensor,
    outputs: Tensor,
    dt: float,
) -> None:
    """Shapes and values of everything the user hands in."""
    if outputs.dim() < 2 or outputs.shape[-2] < 1:
        raise _wrong("outputs", f"has shape {tuple(outputs.shape)}", "(..., T, ny) with at least one sample")
    nx, ny, samples = (x0.shape[-1] if x0.dim() else 0), outputs.shape[-1], outputs.shape[-2]
    if nx == 0:
        raise _wrong("x0", f"has shape {tuple(x0.shape)}", "(..., nx)")
    if controls.dim() < 2 or controls.shape[-2] != samples:
        raise _wrong("controls", f"has shape {tuple(controls.shape)}", f"(..., {samples}, nu) like the outputs")
    for key, matrix, n in (("P0", P0, nx), ("Q", Q, nx), ("R", R, ny)):
        _check_covariance(key, matrix, n)
    for key, value in (("x0", x0), ("controls", controls)):
        if not value.isfinite().all():
            raise _wrong(key, "holds NaN or infinity", "finite numbers")
    if outputs.isinf().any():
        raise _wrong("outputs", "holds infinity", "numbers, NaN where missing")
    if not dt > 0.0:
        raise _wrong("dt", f"is {dt}", "a sample interval above zero, s")
    with torch.no_grad():
        first = controls[..., 0, :]
        for key, value, n in (("f", f(x0, first), nx), ("h", h(x0, first), ny)):
            if value.shape[-1:] != (n,):
                raise _wrong(key, f"returns shape {tuple(value.shape)}", f"(..., {n})")


def _check_covariance(key: str, matrix: Tensor, n: int) -> None:
    if matrix.shape[-2:] != (n, n) or (key != "P0" and matrix.dim() != 2):
        raise _wrong(key, f"has shape {tuple(matrix.shape)}", f"({n}, {n})")
    if not matrix.isfinite().all():
        raise _wrong(key, "holds NaN or infinity", "a covariance")
    size = matrix.diagonal(dim1=-2, dim2=-1).abs().max()
    if (matrix - matrix.mT).abs().max() > 1e-9 * size:
        raise _wrong(key, "is not symmetric", "a covariance")
    lowest = torch.linalg.eigvalsh(matrix).min()
    if lowest < -1e-9 * size or (key == "R" and lowest <= 0.0):
        raise _wrong(key, f"has eigenvalue {lowest:.3g}", "a covariance" + (" without zeros" if key == "R" else ""))


def _wrong(key: str, wrong: str, expected: str) -> InputError:
    return InputError("unscented_filter", key, wrong, expected)
