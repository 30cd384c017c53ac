"""What the unscented filter is given and what it gives; what it refuses, in one line each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, Sizes
from rotorid_torch.core.integrate import step
from rotorid_torch.core.native.filtering import FilteredFlights
from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.data.use.pictures import over
from rotorid_torch.identification.estimate.own_models.steps import MOST, POINTS, fastest_of, shorter, unfollowed
from rotorid_torch.identification.own_model import near

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Dynamics = Callable[[Tensor, Tensor], Tensor]
"""f(x[..., nx], u[..., nu]) -> dx/dt [..., nx], or h(x, u) -> y [..., ny]"""


@dataclass(frozen=True, eq=False)
class Problem:
    """What `unscented_filter` is given, in float64: x0 [..., nx], P0 [..., nx, nx] and the rest as there.

    parts : steps that a sample is taken in.
    """

    f: Dynamics
    h: Dynamics
    x0: Tensor
    P0: Tensor
    Q: Tensor
    R: Tensor
    controls: Tensor
    outputs: Tensor
    dt: float
    parts: int = 1


def onward(f: Dynamics, x: Tensor, u0: Tensor, u1: Tensor, dt: float, parts: int) -> Tensor:
    """States [..., nx] a sample later, in so many steps, the controls linear in between."""
    ends = [u0, *(torch.lerp(u0, u1, k / parts) for k in range(1, parts)), u1]
    for k in range(parts):
        x = step(lambda t, x, u: f(x, u), torch.zeros(()), x, ends[k], ends[k + 1], dt / parts)
    return x


def refined(problem: Problem, x: Tensor) -> int:
    """Steps that a sample is to be taken in for the poles at states [..., T or 1, nx] of the record.

    Raises InputError: a pole that is too fast for the shortest steps.
    """
    samples = torch.linspace(0, problem.controls.shape[-2] - 1, POINTS).long().unique()
    u = problem.controls[..., samples, :]
    x = x[..., samples, :] if x.shape[-2] > 1 else x
    batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
    rows = (a.expand(*batch, a.shape[-1]).flatten(0, -2) for a in (x, u))
    pole = fastest_of(_slopes(problem.f, *rows))
    parts = min(problem.parts * shorter(pole, problem.dt / problem.parts), MOST)
    if shorter(pole, problem.dt / parts) > 1:
        raise Argument("unscented_filter", "f").wrong(*unfollowed(pole, problem.dt, MOST))
    return parts


def _slopes(f: Dynamics, x: Tensor, u: Tensor) -> Tensor:
    """Derivatives [n, nx, nx] of rates by states [n, nx]; nothing is asked of functions beyond being differentiable."""
    with torch.enable_grad():
        x = x.detach().clone().requires_grad_()
        rates = f(x, u)
        if not rates.requires_grad:
            return torch.zeros(*x.shape, x.shape[-1]).to(x)
        grad = partial(torch.autograd.grad, inputs=x, retain_graph=True, materialize_grads=True)
        return torch.stack([grad(r.sum())[0] for r in rates.unbind(-1)], dim=-2)


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


@dataclass(frozen=True)
class LastState:
    """A state at the last sample, where constants are known best; se : its standard deviation."""

    name: str
    value: float
    se: float


@dataclass(frozen=True, eq=False, repr=False)
class Filtered(FilteredFlights, ParameterTable):
    """What filter and smoother know, sample by sample; `result["x[1]"]` is the second state at the last sample.

    Of a batch its places stand before: "x[0,1]" is that of the first flight.

    means, covariances : [..., T, nx], [..., T, nx, nx] state, given the outputs up to and with each sample.
    innovations : [..., T, ny] output minus its prediction, NaN where the output is missing.
    innovation_covariances : [..., T, ny, ny] of these predictions, measurement noise included.
    log_likelihood : [...] sum over all samples of the log density of the outputs that are present.
    smoothed_means, smoothed_covariances : the same as means and covariances given all outputs; None without smoothing.
    """

    innovation_covariances: Tensor  # pyright: ignore[reportIncompatibleVariableOverride]

    columns = shown = ("name", "value", "se")

    def plot(self) -> list[Figure]:
        """States and innovations of each member of a batch by sample, as matplotlib figures."""
        means = self.means if self.smoothed_means is None else self.smoothed_means
        names = [f"state {i}" for i in range(means.shape[-1])]
        names += [f"innovation {i}" for i in range(self.innovations.shape[-1])]
        records = torch.cat([means, self.innovations], dim=-1)
        members = records.reshape(-1, *records.shape[-2:])
        return [
            over(f"flight {k}", ("sample", torch.arange(len(member))), dict(zip(names, member.unbind(-1), strict=True)))
            for k, member in enumerate(members)
        ]

    @property
    def title(self) -> str:
        """Size of the record and how well it was foretold; innovations of 1 where P0, Q and R are right."""
        *batch, samples, states = self.means.shape
        smoothed = "" if self.smoothed_means is None else ", smoothed"
        lead = f"batch {tuple(batch)}, " if batch else ""
        likelihood = ", ".join(f"{v:.6g}" for v in self.log_likelihood.flatten()[:6].tolist())
        spread = self.innovation_covariances.diagonal(dim1=-2, dim2=-1).sqrt()
        ratio = float((self.innovations / spread).square().nanmean().sqrt())
        likely = f"log-likelihood {likelihood}, innovations {ratio:.2g} times what P0, Q and R say"
        return f"Filtered{smoothed}: {lead}{samples} samples, {states} states, {likely}; at the end"

    @property
    def _estimates(self) -> list[LastState]:
        last = self.means[..., -1, :]
        errors = self.covariances[..., -1, :, :].diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()
        rows = zip(np.ndindex(*last.shape), last.flatten().tolist(), errors.flatten().tolist(), strict=True)
        return [LastState(f"x[{','.join(map(str, place))}]", value, se) for place, value, se in rows]


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
        wrong = f"have leading shapes {', '.join(str(tuple(shape)) for shape in leading)}"
        raise Argument(of, "x0, P0, controls, outputs").wrong(wrong, "some that broadcast") from error
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
