"""Step 3, output error: maximum likelihood on anybody's model, from flights given as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.errors import InputError
from rotorid_torch.identification.estimate.progressive_fit import FINE, Fit, Monitor, Settings, fit
from rotorid_torch.identification.estimate.residuals import Colour, colour
from rotorid_torch.identification.estimate.segments import Records, records_from
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.estimate.uncertainty import Uncertainty


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter as the report has it: value, standard error and bounds in its unit."""

    name: str
    value: float
    se: float
    unit: str
    bounds: tuple[float, float]
    at_bound: bool
    status: str  # "free" or "not identifiable"


@dataclass(frozen=True, repr=False)
class OutputError(ParameterTable):
    """What `output_error` found.

    Attributes
    ----------
    model : a copy of the module with the fitted parameters, in float64.
    parameters : one record each, in the order of `covariance`.
    covariance : [P, P], corrected for coloured residuals; zero for parameters on a bound or not identifiable.
    noise : [ny, ny] covariance of the residuals.
    initial_states : [F, nx] at each flight's first sample.
    converged, message : whether the optimum was reached, and a sentence that also names parameters in doubt, and says
        where residuals are coloured as gusts colour them.
    history : cost after each accepted step of the last stage.
    residuals : per flight (T, ny) measured minus model, NaN = missing.
    model_error_ratio : [ny] residual over sensor noise (declared, or the white part of the residual).
    uncertainty : Cramer-Rao, coloured and jackknife apart.
    stages : what each stage did.
    """

    model: nn.Module
    parameters: list[ParameterEstimate]
    covariance: Tensor
    noise: Tensor
    initial_states: Tensor
    converged: bool
    message: str
    history: list[float]
    residuals: list[Tensor]
    model_error_ratio: Tensor
    uncertainty: Uncertainty
    stages: tuple[str, ...]

    @property
    def title(self) -> str:
        """Kind of the estimate, and what is to be said of its end."""
        return f"{type(self).__name__}: {self.message}"


def output_error(
    model: nn.Module,
    flights: Sequence[Mapping[str, Any]],
    free: Sequence[str] | None = None,
    x0: str = "free",
    noise: str | Tensor = "diagonal",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise_floor: Sequence[float] | Tensor | None = None,
    segment_lengths: Sequence[float] | None = None,
    solver: str = "rk4",
    optimiser: str = "gauss-newton",
    max_iterations: int = 50,
    monitor: Monitor | None = None,
) -> OutputError:
    """Output-error estimate of the free parameters of any module from flights.

    Parameters
    ----------
    model : module with forward(t, x, u) -> dx/dt and output(x, u) -> y; it is left as it is.
    flights : dicts of time (T,), controls (T, nu), outputs (T, ny; NaN = missing), x0 (nx,); optionally states (T, nx),
        what is known of the states beforehand, for a start only.
    free : names of the parameters to estimate, all by default; entries of a tensor are named name[i].
    x0 : "free" estimates the initial states, from those given; "fixed" believes them.
    noise : "diagonal", "full", or a covariance [ny, ny] to hold.
    bounds : lower and upper bound by name.
    noise_floor : [ny] standard deviation of the sensors, below which no residual is believed.
    segment_lengths : of the stages, s, infinite for whole flights; chosen from the data by default.
    solver : method of torchdiffeq for the trajectories; derivatives are exact for "rk4".
    optimiser : "gauss-newton" or "lbfgs".
    monitor : called after each accepted step with iteration, cost, theta.

    Raises
    ------
    InputError
        Where the flights or a name do not fit.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), ch. 6; Jategaonkar, Flight Vehicle System
    Identification, ch. 4 and 9 (unstable aircraft).
    """
    system, records = System(model, free, bounds), records_from(flights)
    settings = settings_of(records, x0, noise, noise_floor, segment_lengths, solver, optimiser, max_iterations)
    check_shapes(system, records)
    return result_of(system, records, fit(system, records, settings=settings, monitor=monitor))


def settings_of(
    records: Records,
    x0: str,
    noise: str | Tensor,
    noise_floor: Sequence[float] | Tensor | None,
    segment_lengths: Sequence[float] | None,
    solver: str,
    optimiser: str,
    max_iterations: int,
) -> Settings:
    """Settings of a fit from the arguments of `output_error`, checked."""
    ny = records.outputs.shape[-1]
    one_of("x0", x0, ("free", "fixed"))
    one_of("optimiser", optimiser, ("gauss-newton", "lbfgs"))
    if isinstance(noise, str):
        one_of("noise", noise, ("diagonal", "full"))
    matrix = None if isinstance(noise, str) else torch.as_tensor(noise).to(torch.float64)
    if matrix is not None and (matrix.shape != (ny, ny) or not bool((torch.linalg.eigvalsh(matrix) > 0).all())):
        raise InputError(
            "arguments", "noise", f"matrix of shape {tuple(matrix.shape)}", f"{ny} by {ny}, positive definite"
        )
    floor = None if noise_floor is None else torch.as_tensor(noise_floor).to(torch.float64)
    if floor is not None and (floor.shape != (ny,) or not bool((floor >= 0).all())):
        raise InputError("arguments", "noise_floor", f"shape {tuple(floor.shape)}", f"{ny} numbers, none negative")
    if x0 == "fixed" and bool(records.states[:, 0].isnan().any()):
        raise InputError("flights", "x0", "absent", 'the initial state of every flight where x0 is "fixed"')
    return Settings(
        noise=noise if isinstance(noise, str) else "held",
        matrix=matrix,
        floor=floor,
        lengths=None if segment_lengths is None else tuple(segment_lengths),
        x0=x0,
        solver=solver,
        optimiser=optimiser,
        options=replace(FINE, max_iterations=max_iterations),
    )


def one_of(key: str, value: str, allowed: Sequence[str]) -> None:
    """Raise InputError where an argument is none of the words that are allowed."""
    if value not in allowed:
        raise InputError("arguments", key, repr(value), " or ".join(f'"{a}"' for a in allowed))


def check_shapes(system: System, records: Records) -> None:
    """One evaluation, so that a model that does not fit the data says so and not its tenth matrix product."""
    x, u = records.states[:, 0].nan_to_num(0.0), records.controls[:, 0]
    rates = system.rates(system.theta, records.start, x, u)
    outputs = system.output(system.theta, x, u)
    for key, got, wanted in (("forward", rates.shape, x.shape), ("output", outputs.shape, records.outputs[:, 0].shape)):
        if got != wanted:
            raise InputError("model", key, f"returns shape {tuple(got)} for {len(x)} states", f"shape {tuple(wanted)}")


def result_of(system: System, records: Records, fitted: Fit) -> OutputError:
    """A fit as the caller gets it."""
    minimum, place = fitted.minimum, fitted.minimum.point
    se, theta = fitted.uncertainty.standard_errors, place.theta
    parameters = [
        ParameterEstimate(
            name=e.name,
            value=float(theta[i]),
            se=float(se[i]),
            unit=e.unit,
            bounds=(e.lower, e.upper),
            at_bound=bool(minimum.at_bound[i]),
            status="not identifiable" if bool(minimum.not_identifiable[i]) else "free",
        )
        for i, e in enumerate(system.entries)
    ]
    residual = torch.full_like(records.outputs, math.nan)
    for part in fitted.likelihood.parts(place):
        part.segments.write(part.residual, residual)
    first = (fitted.likelihood.segments.place[:, 0] == 0).nonzero()[:, 0]
    return OutputError(
        model=system.fitted(theta),
        parameters=parameters,
        covariance=fitted.uncertainty.covariance,
        noise=fitted.noise,
        initial_states=place.x0[first],
        converged=minimum.converged,
        message=sentence(minimum.message, parameters) + _coloured(colour(residual)),
        history=minimum.history,
        residuals=[r[:n] for r, n in zip(residual, records.lengths.tolist(), strict=True)],
        model_error_ratio=fitted.model_error_ratio,
        uncertainty=fitted.uncertainty,
        stages=fitted.stages,
    )


def _coloured(colour: Colour) -> str:
    """What to say where residuals are none of the sensors' noise, as in moving air."""
    if not colour.outputs:
        return ""
    listed = ", ".join(f"{float(colour.lag_one[i]):.2f} of output {i}" for i in colour.outputs)
    return (
        f"; successive residuals are correlated ({listed}): where the air moves, filter_error tells more;"
        f" predicting each from the one before would raise the log-likelihood by {colour.gain:.0f}"
    )


def sentence(message: str, parameters: Sequence[ParameterEstimate]) -> str:
    """How a fit ended, and which parameters are in doubt."""
    bound = [p.name for p in parameters if p.at_bound]
    blind = [p.name for p in parameters if p.status == "not identifiable"]
    parts = [message]
    parts += [f"on a bound: {', '.join(bound)}"] if bound else []
    parts += [f"not identifiable: {', '.join(blind)}"] if blind else []
    return "; ".join(parts)
