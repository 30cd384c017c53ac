"""What the unscented filter is given and what it gives; what it refuses, in one line each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.errors import InputError

Dynamics = Callable[[Tensor, Tensor], Tensor]
"""f(x[..., nx], u[..., nu]) -> dx/dt [..., nx], or h(x, u) -> y [..., ny]"""


@dataclass(frozen=True, eq=False)
class Problem:
    """What `unscented_filter` is given, in float64: x0 [..., nx], P0 [..., nx, nx] and the rest as there."""

    f: Dynamics
    h: Dynamics
    x0: Tensor
    P0: Tensor
    Q: Tensor
    R: Tensor
    controls: Tensor
    outputs: Tensor
    dt: float


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        *batch, samples, states = self.means.shape
        smoothed = "" if self.smoothed_means is None else ", smoothed"
        lead = f"batch {tuple(batch)}, " if batch else ""
        likelihood = ", ".join(f"{v:.6g}" for v in self.log_likelihood.flatten()[:6].tolist())
        return f"Filtered{smoothed}: {lead}{samples} samples, {states} states, log-likelihood {likelihood}"


def check(problem: Problem) -> None:
    """Everything the user hands in.

    Raises
    ------
    InputError : shapes that do not fit, functions that do not broadcast, NaN or infinity, a covariance that is none.
    """
    x0, outputs, controls = problem.x0, problem.outputs, problem.controls
    if outputs.dim() < 2 or outputs.shape[-2] < 1:
        raise _wrong("outputs", f"has shape {tuple(outputs.shape)}", "(..., T, ny) with at least one sample")
    nx, ny, samples = (x0.shape[-1] if x0.dim() else 0), outputs.shape[-1], outputs.shape[-2]
    if nx == 0:
        raise _wrong("x0", f"has shape {tuple(x0.shape)}", "(..., nx)")
    if controls.dim() < 2 or controls.shape[-2] != samples:
        raise _wrong("controls", f"has shape {tuple(controls.shape)}", f"(..., {samples}, nu) like the outputs")
    for key, matrix, n in (("P0", problem.P0, nx), ("Q", problem.Q, nx), ("R", problem.R, ny)):
        _check_covariance(key, matrix, n)
    for key, value in (("x0", x0), ("controls", controls)):
        if not value.isfinite().all():
            raise _wrong(key, "holds NaN or infinity", "finite numbers")
    if outputs.isinf().any():
        raise _wrong("outputs", "holds infinity", "numbers, NaN where missing")
    if not problem.dt > 0.0:
        raise _wrong("dt", f"is {problem.dt}", "a sample interval above zero, s")
    leading = [x0.shape[:-1], problem.P0.shape[:-2], controls.shape[:-2], outputs.shape[:-2]]
    try:
        batch = torch.broadcast_shapes(*leading)
    except RuntimeError as error:
        shapes = ", ".join(str(tuple(shape)) for shape in leading)
        raise _wrong("x0", f"P0, controls and outputs have leading shapes {shapes}", "shapes that broadcast") from error
    for key, function, n in (("f", problem.f, nx), ("h", problem.h, ny)):
        _check_function(key, function, x0.expand(*batch, nx), controls[..., 0, :].expand(*batch, controls.shape[-1]), n)


def _check_function(key: str, function: Callable[[Tensor, Tensor], Tensor], x: Tensor, u: Tensor, n: int) -> None:
    """As the filter calls it, with sigma points as one more dimension; their number is nobody's size by chance."""
    x, u = (a.unsqueeze(-2).expand(*a.shape[:-1], x.shape[-1] + n + 1, a.shape[-1]) for a in (x, u))
    wanted = (*x.shape[:-1], n)
    expected = f"{wanted} for x of shape {tuple(x.shape)}: write x[..., 0], not x[0]"
    try:
        value = function(x, u)
    except (RuntimeError, IndexError, ValueError) as error:
        raise _wrong(key, f"fails: {str(error).splitlines()[0]}", expected) from error
    if value.shape != wanted:
        raise _wrong(key, f"returns shape {tuple(value.shape)}", expected)


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
