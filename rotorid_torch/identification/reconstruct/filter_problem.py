"""What the unscented filter is given and what it gives; what it refuses, in one line each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, Sizes
from rotorid_torch.core.native.filtering import FilteredFlights
from rotorid_torch.data.use.pictures import over
from rotorid_torch.identification.own_model import near
from rotorid_torch.printable import html_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def with_angles(problem: Problem, angles: Sequence[int]) -> Problem:
    """The same, h giving these outputs within half a turn of the measured ones, which are further controls."""
    if not angles:
        return problem
    nu, measured = problem.controls.shape[-1], problem.outputs[..., list(angles)].nan_to_num(0.0)
    batch = np.broadcast_shapes(problem.controls.shape[:-2], measured.shape[:-2])
    parts = [part.expand(*batch, *part.shape[-2:]) for part in (problem.controls, measured)]
    return replace(
        problem,
        f=lambda x, u: problem.f(x, u[..., :nu]),
        h=lambda x, u: near(problem.h(x, u[..., :nu]), u[..., nu:], angles),
        controls=torch.cat(parts, dim=-1),
    )


@dataclass(frozen=True, repr=False)
class Filtered(FilteredFlights):
    """What filter and smoother know, sample by sample.

    means, covariances : [..., T, nx], [..., T, nx, nx] state, given the outputs up to and with each sample.
    innovations : [..., T, ny] output minus its prediction, NaN where the output is missing.
    innovation_covariances : [..., T, ny, ny] of these predictions, measurement noise included.
    log_likelihood : [...] sum over all samples of the log density of the outputs that are present.
    smoothed_means, smoothed_covariances : the same as means and covariances given all outputs; None without smoothing.
    """

    innovation_covariances: Tensor  # pyright: ignore[reportIncompatibleVariableOverride]

    def plot(self) -> list[Figure]:
        """States and innovations of each member of a batch by sample, as matplotlib figures."""
        means = self.means if self.smoothed_means is None else self.smoothed_means
        names = [f"state {i}" for i in range(means.shape[-1])]
        names += [f"innovation {i}" for i in range(self.innovations.shape[-1])]
        records = torch.cat([means, self.innovations], dim=-1)
        members = records.reshape(-1, *records.shape[-2:])
        return [
            over(
                f"flight {k}",
                ("sample", torch.arange(len(member))),
                dict(zip(names, member.unbind(-1), strict=True)),
            )
            for k, member in enumerate(members)
        ]

    def _repr_html_(self) -> str:
        """Where the states are at the end of each member of a batch, for a notebook."""
        last = self.means[..., -1, :].reshape(-1, self.means.shape[-1]).tolist()
        variances = self.covariances[..., -1, :, :].diagonal(dim1=-2, dim2=-1)
        errors = variances.clamp_min(0.0).sqrt().reshape(-1, self.means.shape[-1]).tolist()
        rows = (
            (flight, state, f"{value:.5g}", f"{error:.2g}")
            for flight, member in enumerate(zip(last, errors, strict=True))
            for state, (value, error) in enumerate(zip(*member, strict=True))
        )
        return html_table(repr(self), ("flight", "state", "at the end", "standard deviation"), rows)

    def __repr__(self) -> str:
        *batch, samples, states = self.means.shape
        smoothed = "" if self.smoothed_means is None else ", smoothed"
        lead = f"batch {tuple(batch)}, " if batch else ""
        likelihood = ", ".join(f"{v:.6g}" for v in self.log_likelihood.flatten()[:6].tolist())
        return f"Filtered{smoothed}: {lead}{samples} samples, {states} states, log-likelihood {likelihood}"


def checked(problem: Problem) -> Problem:
    """What the caller hands in, arrays of any kind, as a problem in float64.

    Raises InputError: shapes that do not fit, functions that do not broadcast or leave torch, NaN or infinity, no
    covariance.
    """
    sizes, of = Sizes(), "unscented_filter"
    x0 = arguments.shaped(Argument(of, "x0"), problem.x0, "... nx", sizes)
    if x0.dim() > 1 and x0.shape[-1] == 1 < x0.shape[-2] and np.shape(problem.P0)[-1:] == x0.shape[-2:-1]:
        raise Argument(of, "x0").wrong(f"has shape {tuple(x0.shape)}", f"(..., {x0.shape[-2]}), a vector as P0 says")
    P0 = arguments.covariance(Argument(of, "P0"), problem.P0, "... nx nx", sizes)
    Q = arguments.covariance(Argument(of, "Q"), problem.Q, "nx nx", sizes)
    outputs = arguments.shaped(Argument(of, "outputs"), problem.outputs, "... T ny", sizes, missing=True)
    controls = arguments.shaped(Argument(of, "controls"), problem.controls, "... T nu", sizes)
    R = arguments.covariance(Argument(of, "R"), problem.R, "ny ny", sizes, definite=True)
    if not outputs.numel() or bool(outputs.isnan().all()):
        raise Argument(of, "outputs").wrong("hold no value", "measured outputs, NaN where one is missing")
    if not x0.shape[-1]:
        raise Argument(of, "x0").wrong("is empty", "(..., nx) with at least one state")
    interval = arguments.number(Argument(of, "dt"), problem.dt, "the sample interval, s", above=0.0)
    problem = Problem(problem.f, problem.h, x0, P0, Q, R, controls, outputs, interval)
    leading = [x0.shape[:-1], P0.shape[:-2], controls.shape[:-2], outputs.shape[:-2]]
    try:
        batch = np.broadcast_shapes(*leading)
    except ValueError as error:
        shapes = ", ".join(str(tuple(shape)) for shape in leading)
        raise Argument(of, "x0, P0, controls, outputs").wrong(
            f"have leading shapes {shapes}", "some that broadcast"
        ) from error
    x, u = x0.expand(*batch, -1), controls[..., 0, :].expand(*batch, -1)
    for key, function, n, form in (
        ("f", problem.f, x.shape[-1], "f(x, u) -> dx/dt"),
        ("h", problem.h, outputs.shape[-1], "h(x, u) -> y"),
    ):
        # sigma points are one more dimension; their number here is nobody's size by chance
        points = (a.unsqueeze(-2).expand(*batch, x.shape[-1] + n + 1, a.shape[-1]) for a in (x, u))
        wanted = (*batch, x.shape[-1] + n + 1, n)
        if not bool(arguments.evaluated(Argument(of, key), function, tuple(points), wanted, form).isfinite().all()):
            raise Argument(of, key).wrong("gives NaN or infinity at x0 and the first controls", f"numbers; {form}")
    return problem
