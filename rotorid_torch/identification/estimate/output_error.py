"""Step 3, output error: maximum likelihood on anybody's model, from flights given as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, listed
from rotorid_torch.core.gauss_newton import Minimum
from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.data.use.pictures import over
from rotorid_torch.errors import InputError
from rotorid_torch.identification import arguments as fit_arguments
from rotorid_torch.identification.estimate.own_models import remarks
from rotorid_torch.identification.estimate.own_models.steps import Stepped, in_steps
from rotorid_torch.identification.estimate.progressive_fit import FINE, Fit, Monitor, Settings, Start, fit
from rotorid_torch.identification.estimate.residuals import Colour, colour
from rotorid_torch.identification.estimate.segments import Records, records_from
from rotorid_torch.identification.estimate.system import System, first_name
from rotorid_torch.identification.estimate.uncertainty import Uncertainty
from rotorid_torch.identification.own_model import OwnModel, unwrapped, warn_of_turns

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter as the report has it: value, standard error and bounds in its unit.

    se : corrected for coloured residuals, NaN where a bound holds the parameter or the data do not tell it.
    se_white : what it would be if residuals were white (Cramer-Rao), NaN likewise.
    """

    name: str
    value: float
    se: float
    unit: str
    bounds: tuple[float, float]
    at_bound: bool
    status: str  # "free" or "not identifiable"
    se_white: float = math.nan


@dataclass(frozen=True, repr=False, kw_only=True)
class ModuleEstimate(ParameterTable):
    """What maximum likelihood says of a module.

    Attributes
    ----------
    model : a copy of the module with the fitted parameters, in float64.
    parameters : one record each, in the order of `covariance`.
    covariance : [P, P], corrected for what is coloured; NaN for parameters on a bound or not identifiable.
    noise : [ny, ny] covariance of the outputs' noise: of the residuals of output error.
    initial_states : [F, nx] at each flight's first sample.
    converged, message : whether the optimum was reached, and a sentence that also names parameters in doubt.
    history : cost after each accepted step of the last stage.
    uncertainty : Cramer-Rao, coloured and jackknife apart.
    times : per flight (T,) s of the samples.
    """

    model: nn.Module
    parameters: list[ParameterEstimate]
    covariance: Tensor
    noise: Tensor
    initial_states: Tensor
    converged: bool
    message: str
    history: list[float]
    uncertainty: Uncertainty
    times: list[Tensor]

    LEFT: ClassVar[str]
    """What is left of the measurement: its attribute's name is this with an s."""

    def __getitem__(self, name: str) -> Any:
        """The parameter of a name, also where its tensor has a second one."""
        return super().__getitem__(first_name(self.model, name))

    @property
    def title(self) -> str:
        """Kind of the estimate, and what is to be said of its end."""
        return f"{type(self).__name__}: {self.message}"

    def plot(self) -> list[Figure]:
        """What is left of each flight's outputs over time, as matplotlib figures."""
        records = zip(self.times, getattr(self, f"{self.LEFT}s"), strict=True)
        return [
            over(f"flight {k}", ("time, s", time), {f"{self.LEFT} {i}": column for i, column in enumerate(record.mT)})
            for k, (time, record) in enumerate(records)
        ]


@dataclass(frozen=True, repr=False, kw_only=True)
class OutputError(ModuleEstimate):
    """What `output_error` found: `ModuleEstimate`, and this.

    The message also says where residuals are coloured as gusts colour them, and which parameters `x0="fixed"` would
    move by more than a standard error.

    Attributes
    ----------
    residuals : per flight (T, ny) measured minus model, NaN = missing.
    model_error_ratio : [ny] residual over sensor noise (declared, or the white part of the residual).
    stages : what each stage did.
    segment_seconds : length of the longest segments that the estimate rests on, infinite where these are whole flights.
    whole : how the model flies whole flights from their first samples: residuals, rms, ratio to those of the segments.
    """

    residuals: list[Tensor]
    model_error_ratio: Tensor
    stages: tuple[str, ...]
    segment_seconds: float
    whole: remarks.WholeFlights

    LEFT = "residual"
    columns = (*ParameterTable.columns, "se_white")


def output_error(
    model: nn.Module,
    flights: Sequence[Mapping[str, Any]],
    free: Sequence[str] | None = None,
    x0: str | Mapping[int | str, str | tuple[float, float]] = "free",
    noise: str | Tensor = "diagonal",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise_floor: Sequence[float] | Tensor | None = None,
    segment_lengths: Sequence[float] | None = None,
    solver: str = "rk4",
    optimiser: str = "gauss-newton",
    max_iterations: int = 50,
    controls: str = "linear",
    delays: Mapping[int, float] | None = None,
    angles: Sequence[int] = (),
    monitor: Monitor | None = None,
) -> OutputError:
    """Output-error estimate of the free parameters of any module from flights.

    Parameters
    ----------
    model : module with forward(t, x, u) -> dx/dt and output(x, u) -> y; it is left as it is.
    flights : dicts of time (T,), controls (T, nu), outputs (T, ny; NaN = missing), x0 (nx,); optionally states (T, nx),
        what is known of the states beforehand, for a start only.
    free : names of the parameters to estimate; by default all that ask for gradients. Entries of a tensor are named
        name[i] or name[i,j].
    x0 : "free" estimates the initial states, from those given; "fixed" believes them. By place or name of a state one
        of the words or bounds: {0: "fixed", 1: (-0.1, 0.1)}; states that are not named are free.
    noise : "diagonal", "full", or a covariance [ny, ny] to hold.
    bounds : lower and upper bound by name.
    noise_floor : [ny] standard deviation of the sensors, below which no residual is believed.
    segment_lengths : of the stages, s, infinite for whole flights; chosen from the data by default.
    solver : method of torchdiffeq for the trajectories; derivatives are exact for "rk4".
    optimiser : "gauss-newton" or "lbfgs".
    controls : between samples: "linear", or "held" as they were at the last sample, as digital controllers send them.
    delays : pure delays that are estimated, start in s by place of the control: {0: 0.02} adds the parameter delay[0].
    angles : places of outputs that are angles, rad: they are compared within half a turn.
    monitor : called after each accepted step with iteration, cost, theta.

    Samples are taken in several steps where the model's poles are too fast for one, and the message says so.

    Raises
    ------
    InputError
        Where the flights or a name do not fit, runs from the start diverge, or a pole is too fast.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), ch. 6; Jategaonkar, Flight Vehicle System
    Identification, ch. 4 and 9 (unstable aircraft).

    Examples
    --------
    A lag x' = a x + b u with a = -2 and b = 3, from its answer to a step:

    >>> import numpy as np
    >>> import torch
    >>> import rotorid_torch as rotorid
    >>> class Lag(torch.nn.Module):
    ...     def __init__(self):
    ...         super().__init__()
    ...         self.a = torch.nn.Parameter(torch.tensor(-1.0))
    ...         self.b = torch.nn.Parameter(torch.tensor(1.0))
    ...
    ...     def forward(self, t, x, u):
    ...         return self.a * x + self.b * u
    ...
    ...     def output(self, x, u):
    ...         return x
    >>> time = np.arange(0.0, 4.0, 0.02)
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(200)
    >>> outputs = 1.5 * (1.0 - np.exp(-2.0 * time)) + noise
    >>> flight = {"time": time, "controls": np.ones((200, 1)), "outputs": outputs[:, None], "x0": [0.0]}
    >>> found = rotorid.output_error(Lag(), [flight], x0="fixed")
    >>> print(f"{found['a'].value:.1f} {found['b'].value:.1f}")
    -2.0 3.0
    """
    system, records = prepared(model, flights, free, bounds, Between(controls, delays, angles))
    fit_arguments.refuse_search(max_iterations, monitor)
    starts = fit_arguments.initial_states_of(x0, fit_arguments.state_names(model, records.states.shape[-1])[0])
    search = SearchArguments(noise, noise_floor, segment_lengths, solver, optimiser, max_iterations)
    settings = settings_of(records, starts, search)
    fit_arguments.refuse_too_few(records.outputs, len(system.theta), 0 if x0 == "fixed" else records.states.shape[-1])
    stepped = fitted_in_steps(system, records, settings, monitor)
    result = result_of(system, stepped)
    moved = remarks.with_starts_held(system, stepped, settings, [p.se for p in result.parameters])
    return replace(result, message=f"{result.message}; {moved}") if moved else result


def fitted_in_steps(system: System, records: Records, settings: Settings, monitor: Monitor | None) -> Stepped[Fit]:
    """The fit in steps that are short enough for the model."""

    def solve(records: Records, theta: Tensor) -> Fit:
        return fit(system, records, Start(theta), settings, monitor)

    def end(fitted: Fit) -> tuple[Tensor, Tensor]:
        point, problem = fitted.minimum.point, fitted.likelihood
        return point.theta, problem.states_at(point, torch.full_like(problem.records.states, math.nan))

    return in_steps(system, records, solve, end)


@dataclass(frozen=True)
class SearchArguments:
    """How the search is to go: arguments of `output_error`, not checked."""

    noise: str | Tensor
    noise_floor: Sequence[float] | Tensor | None = None
    segment_lengths: Sequence[float] | None = None
    solver: str = "rk4"
    optimiser: str = "gauss-newton"
    max_iterations: int = 50


def settings_of(records: Records, x0: fit_arguments.InitialStates, search: SearchArguments) -> Settings:
    """Settings of a fit from the arguments of `output_error`, checked."""
    ny = records.outputs.shape[-1]
    arguments.word(Argument("arguments", "optimiser"), search.optimiser, ("gauss-newton", "lbfgs"))
    arguments.word(Argument("arguments", "solver"), search.solver, fit_arguments.SOLVERS)
    kind, matrix = fit_arguments.noise_of(search.noise, ny)
    first = records.states[:, 0].isnan()
    if bool((first if x0.whole == "fixed" else first & (x0.held if x0.held is not None else False)).any()):
        raise InputError("flights", "x0", "absent", 'the initial state of every flight where x0 is "fixed"')
    if search.optimiser == "lbfgs" and x0.bounds is not None:
        raise Argument("arguments", "x0").wrong("has bounds", 'none with optimiser "lbfgs", which bounds parameters')
    return Settings(
        noise=kind,
        matrix=matrix,
        sensor_noise=fit_arguments.floor_of(search.noise_floor, ny),
        lengths=fit_arguments.lengths_of(search.segment_lengths, records.dt),
        x0=x0.whole,
        x0_held=x0.held,
        x0_bounds=x0.bounds,
        solver=search.solver,
        optimiser=search.optimiser,
        options=replace(FINE, max_iterations=search.max_iterations),
    )


@dataclass(frozen=True)
class Between:
    """What stands between a model and the records: `controls`, `delays` and `angles` as in `output_error`."""

    controls: str = "linear"
    delays: Mapping[int, float] | None = None
    angles: Sequence[int] = ()


def prepared(
    model: nn.Module, flights: Any, free: Sequence[str] | None, bounds: Any, between: Between
) -> tuple[System, Records]:
    """What is estimated and from what, a model that fits the flights.

    Raises InputError: a flight, a name or the model does not fit.
    """
    arguments.word(Argument("arguments", "controls"), between.controls, ("linear", "held"))
    records, model = records_from(flights, hold=between.controls == "held"), fit_arguments.module(model)
    fit_arguments.refuse_unmeasured(records.outputs)
    nu, ny = records.controls.shape[-1], records.outputs.shape[-1]
    longest = (int(records.lengths.max()) - 1) * records.dt
    angles = fit_arguments.angles_of("arguments", between.angles, ny)
    delays = fit_arguments.delays_of(between.delays, nu, longest)
    warn_of_turns(records.outputs, angles)
    around = (lambda copied: OwnModel(copied, nu, angles, delays)) if angles or delays else None
    system = System(model, free, bounds, around)
    module_alone = system.model.model if isinstance(system.model, OwnModel) else system.model
    fit_arguments.refuse_unfit(module_alone, records.start, records.states[:, 0], records.controls[:, 0], ny)
    if angles:
        outputs = records.outputs.clone()
        for i in angles:
            outputs[..., i] = unwrapped(outputs[..., i])  # jumps are no noise
        measured = outputs[..., list(angles)].nan_to_num(0.0)
        records = replace(records, outputs=outputs, controls=torch.cat([records.controls, measured], dim=-1))
    return system, records


def result_of(system: System, stepped: Stepped[Fit]) -> OutputError:
    """A fit as the caller gets it; steps that are too long leave no standard errors."""
    fitted, records = stepped.fit, stepped.records
    minimum, place = fitted.minimum, fitted.minimum.point
    held = minimum.at_bound | minimum.not_identifiable | (not stepped.mended)
    errors = fitted.uncertainty.without(held)
    parameters = estimates(system, place.theta, minimum, errors)
    residual = torch.full_like(records.outputs, math.nan)
    for part in fitted.likelihood.parts(place):
        part.segments.write(part.residual, residual)
    missed = f"not reached: {fitted.stages[-1]}" if any("not tried" in stage for stage in fitted.stages) else ""
    whole, residuals = remarks.whole_flights(records, fitted), records.measured(residual)
    parts = [sentence(minimum.message, parameters), _over(fitted, records), missed, whole.remark, stepped.remark]
    parts += [remarks.counted_twice(records), _starts_on_bounds(fitted), remarks.acting_back(residuals, records)]
    parts.append(coloured(colour(pad_sequence(residuals, batch_first=True, padding_value=math.nan))))
    first = (fitted.likelihood.segments.place[:, 0] == 0).nonzero()[:, 0]
    return OutputError(
        model=system.fitted(place.theta),
        parameters=parameters,
        covariance=errors.covariance,
        noise=fitted.noise,
        initial_states=place.x0[first],
        converged=minimum.converged and stepped.mended and not missed,
        message="; ".join(part for part in parts if part),
        history=minimum.history,
        residuals=residuals,
        model_error_ratio=fitted.model_error_ratio,
        uncertainty=errors,
        stages=fitted.stages,
        segment_seconds=_seconds(fitted, records),
        times=records.times(),
        whole=whole,
    )


def _starts_on_bounds(fitted: Fit) -> str:
    """Which initial states rest on a bound."""
    held, segments = fitted.minimum.point.held, fitted.likelihood.segments
    if held is None or not bool(held.any()):
        return ""
    rows = held.nonzero().tolist()
    return "initial states on a bound: " + listed(f"x[{i}] of flight {int(segments.flight[s])}" for s, i in rows)


def _seconds(fitted: Fit, records: Records) -> float:
    """Length of the longest segments, infinite for whole flights."""
    longest = fitted.likelihood.longest
    return math.inf if longest >= int(records.lengths.max()) else longest * records.dt


def _over(fitted: Fit, records: Records) -> str:
    """Over which segments the estimate was found, where these are not whole flights."""
    seconds = _seconds(fitted, records)
    return "" if math.isinf(seconds) else f"found over segments of {seconds:.3g} s"


def estimates(system: System, theta: Tensor, minimum: Minimum[Any], errors: Uncertainty) -> list[ParameterEstimate]:
    """The parameters at theta with their errors, in the order of the system."""
    white = errors.cramer_rao.diagonal().clamp_min(0.0).sqrt()
    return [
        ParameterEstimate(
            name=e.name,
            value=float(theta[i]),
            se=float(errors.standard_errors[i]),
            unit=e.unit,
            bounds=(e.lower, e.upper),
            at_bound=bool(minimum.at_bound[i]),
            status="not identifiable" if bool(minimum.not_identifiable[i]) else "free",
            se_white=float(white[i]),
        )
        for i, e in enumerate(system.entries)
    ]


def coloured(colour: Colour) -> str:
    """What to say where residuals are none of the sensors' noise, as in moving air."""
    if not colour.outputs:
        return ""
    listed = ", ".join(f"{float(colour.lag_one[i]):.2f} of output {i}" for i in colour.outputs)
    tells = f"predicting each from the one before would raise the log-likelihood by {colour.gain:.0f}"
    return f"successive residuals are correlated ({listed}): where the air moves, filter_error tells more; {tells}"


def sentence(message: str, parameters: Sequence[ParameterEstimate]) -> str:
    """How a fit ended, and which parameters are in doubt."""
    bound = [p.name for p in parameters if p.at_bound]
    blind = [p.name for p in parameters if p.status == "not identifiable"]
    parts = [message]
    parts += [f"on a bound: {listed(bound)}"] if bound else []
    parts += [f"not identifiable: {listed(blind)}"] if blind else []
    return "; ".join(parts)
