"""Step 3 where the air moves: the filter error method, maximum likelihood with process noise, on anybody's model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.core.gauss_newton import Minimum, Region, minimise
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.errors import InputError
from rotorid_torch.identification.arguments import (
    InitialStates,
    floor_of,
    noise_of,
    refuse_search,
    refuse_too_few,
    state_names,
)
from rotorid_torch.identification.estimate.initial_states import smallest_noise
from rotorid_torch.identification.estimate.output_error import (
    Between,
    ParameterEstimate,
    Search,
    drawn,
    estimates,
    fitted_in_steps,
    prepared,
    result_of,
    sentence,
    settings_of,
)
from rotorid_torch.identification.estimate.own_models.steps import Stepped, in_steps
from rotorid_torch.identification.estimate.progressive_fit import FINE, Fit, Monitor
from rotorid_torch.identification.estimate.residuals import Whiteness, whiteness
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.estimate.uncertainty import Uncertainty
from rotorid_torch.identification.filter_error.extended_kalman import CovarianceForm, Filtered, FilterProblem, form
from rotorid_torch.identification.filter_error.held_gain import HeldEngine, Unknowns, alternated
from rotorid_torch.identification.filter_error.innovations import (
    FilterEngine,
    FilterPlace,
    InnovationLikelihood,
    NativeFilter,
    filter_engine,
)
from rotorid_torch.identification.filter_error.smoother import smoothed
from rotorid_torch.identification.filter_error.start import first
from rotorid_torch.identification.filter_error.uncertainty import uncertainty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LITTLE = 1e-3
"""Part of the process noise with which a fit is tried again from where it ended."""
LEAST_GAIN = 1e-2
"""In the log-likelihood, for which another optimum is taken."""


@dataclass(frozen=True, repr=False)
class FilterError(ParameterTable):
    """What `filter_error` found; what has a name of `OutputError` is the same.

    Attributes
    ----------
    model : a copy of the module with the fitted parameters, in float64.
    parameters : one record each, in the order of `covariance`.
    covariance : [P, P], corrected for coloured innovations; NaN for parameters on a bound or not identifiable.
    process_noise : standard deviations of the noise in the states' rates, per square root of a second, by state; for
        "full" also correlations. Empty where it was held.
    process_covariance : [nx, nx] its spectral density, covariance per second.
    measurement_noise : the same of the outputs' noise, by output. noise : [ny, ny] its covariance.
    initial_states : [F, nx] at each flight's first sample.
    converged, message : whether the optimum was reached, and a sentence that also names parameters in doubt.
    history : cost after each accepted step.
    innovations : per flight (T, ny) measured minus predicted from all samples before, NaN = missing.
    states, state_errors : per flight (T, nx) by all samples of the flight (smoothed), and their standard errors, with
        parameters and initial states believed.
    log_likelihood : of all innovations. times : per flight (T,) s of the samples.
    whiteness : of the innovations in units of their own covariance.
    uncertainty : Cramer-Rao, coloured and jackknife apart.
    """

    model: nn.Module
    parameters: list[ParameterEstimate]
    covariance: Tensor
    process_noise: list[ParameterEstimate]
    process_covariance: Tensor
    measurement_noise: list[ParameterEstimate]
    noise: Tensor
    initial_states: Tensor
    converged: bool
    message: str
    history: list[float]
    innovations: list[Tensor]
    states: list[Tensor]
    state_errors: list[Tensor]
    log_likelihood: float
    whiteness: Whiteness
    uncertainty: Uncertainty

    times: list[Tensor] = field(default_factory=list)

    @property
    def title(self) -> str:
        """Kind of the estimate, and what is to be said of its end."""
        return f"{type(self).__name__}: {self.message}"

    def plot(self) -> list[Figure]:
        """Innovations of each flight over time, as matplotlib figures."""
        return drawn("innovation", self.times, self.innovations)


def filter_error(
    model: nn.Module,
    flights: Sequence[Mapping[str, Any]],
    free: Sequence[str] | None = None,
    process_noise: str | Sequence[str] | Tensor = "diagonal",
    noise: str | Tensor = "diagonal",
    x0: str = "free",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise_floor: Sequence[float] | Tensor | None = None,
    max_iterations: int = 100,
    gain: str = "exact",
    engine: str | None = None,
    delays: Mapping[int, float] | None = None,
    angles: Sequence[int] = (),
    monitor: Monitor | None = None,
) -> FilterError:
    """Maximum-likelihood estimate of the free parameters of any module from flights in moving air.

    Output error takes gusts for the vehicle's own motion. Here the states' rates have white noise of unknown size, and
    what is fitted are the innovations of an extended Kalman filter: measured minus predicted from all samples before.

    Parameters
    ----------
    model : module with forward(t, x, u) -> dx/dt and output(x, u) -> y; it is left as it is. Its states are called
        x[0], x[1], ..., or as its attribute `states` (a sequence of words) or its `layout` says.
    flights : dicts of time (T,), controls (T, nu), outputs (T, ny; NaN = missing), x0 (nx,).
    free : names of the parameters to estimate, all by default; entries of a tensor are named name[i].
    process_noise : "diagonal" (a size for each state), "full" (correlated), names of the states that have it, or the
        spectral density [nx, nx] to hold (covariance per second). Of zeros it leaves output error.
    noise : of the outputs: "diagonal", "full", or a covariance [ny, ny] to hold.
    x0 : "free" estimates the initial states, from those given; "fixed" believes them.
    bounds : lower and upper bound by name.
    noise_floor : [ny] standard deviation of the sensors, below which no noise is believed.
    gain : "exact", or "held" for models of many states and parameters: the filter's gain is held while parameters move,
        which costs little more than output error. Parameters are a little less certain, as their errors say; errors of
        the noises then believe the parameters.
    engine : "native" or "reference" (torch, slow); by default native code where the model can be compiled.
    delays, angles : pure delays of controls, outputs that are angles; as in `output_error`.
    monitor : called after each accepted step with iteration, cost, theta.

    Raises
    ------
    InputError
        Where the flights, a name or a matrix do not fit, or the filter diverges from the start.

    Source: Maine and Iliff (1981), SIAM J. Appl. Math. 41; Jategaonkar, Flight Vehicle System Identification, ch. 5.

    Examples
    --------
    A lag x' = a x + b u in gusts, with a = -2 and b = 3:

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
    >>> rng, dt = np.random.default_rng(0), 0.02
    >>> time, x = dt * np.arange(1000), np.zeros((1000, 1))
    >>> controls = np.sin(0.1 * time[:, None] ** 2)
    >>> for k in range(999):
    ...     gust = 0.2 * np.sqrt(dt) * rng.standard_normal()
    ...     x[k + 1] = x[k] + dt * (-2.0 * x[k] + 3.0 * controls[k]) + gust
    >>> outputs = x + 0.02 * rng.standard_normal(x.shape)
    >>> flight = {"time": time, "controls": controls, "outputs": outputs, "x0": [0.0]}
    >>> result = rotorid.filter_error(Lag(), [flight])
    >>> abs(result["a"].value + 2.0) < 3.0 * result["a"].se
    True
    >>> print(f"{result.process_noise[0].value:.1f} {result.process_noise[0].unit}")
    0.2 /sqrt(s)
    """
    system, records = prepared(model, flights, free, bounds, Between(delays=delays, angles=angles))
    arguments.word(Argument("arguments", "x0"), x0, ("free", "fixed"))
    arguments.word(Argument("arguments", "engine"), engine or "native", ("native", "reference"))
    arguments.word(Argument("arguments", "gain"), gain, ("exact", "held"))
    refuse_search(max_iterations, monitor)
    ny, nx = records.outputs.shape[-1], records.states.shape[-1]
    refuse_too_few(records.outputs, len(system.theta), 0 if x0 == "fixed" else nx)
    states, units = state_names(model, nx)
    problem = FilterProblem(
        system,
        records,
        form("process_noise", process_noise, states, units),
        _outputs_form(noise, getattr(model, "body", None), ny),
        torch.zeros(nx, nx, dtype=torch.float64),
    )
    floor = _floor(noise_floor, records)
    if x0 == "fixed" and bool(records.states[:, 0].isnan().any()):
        raise InputError("flights", "x0", "absent", 'the initial state of every flight where x0 is "fixed"')
    if problem.process.matrix is not None and not bool(problem.process.matrix.any()):
        calm = Search(noise, noise_floor, max_iterations=max_iterations)
        settings = settings_of(records, InitialStates(x0), calm)
        return _without_gusts(problem, fitted_in_steps(system, records, settings, monitor))
    search = _Search(problem, floor, x0 == "free", max_iterations, gain, engine, monitor)

    def solve(records: Records, theta: Tensor) -> Maximum:
        return replace(search, problem=replace(problem, records=records)).ended(theta)

    def end(maximum: Maximum) -> tuple[Tensor, Tensor]:
        place = maximum.minimum.point
        return place.theta[: len(system.theta)], maximum.engine.filter(place.theta, place.x0).states

    return _result(in_steps(system, records, solve, end))


class Maximum(NamedTuple):
    """Where a search ended."""

    engine: FilterEngine
    likelihood: InnovationLikelihood
    minimum: Minimum[FilterPlace]


@dataclass(frozen=True)
class _Search:
    """How the maximum of the likelihood is looked for."""

    problem: FilterProblem
    floor: Tensor
    free: bool
    iterations: int
    gain: str
    engine: str | None
    monitor: Monitor | None

    def ended(self, theta: Tensor) -> Maximum:
        """From where the filter follows the flights with parameters near theta, to the maximum."""
        problem, system = self.problem, self.problem.system
        theta, start = torch.clamp(theta, system.lower, system.upper), problem.records.states[:, 0]
        beginning, psi, cost = first(self._engine(theta), theta, start.nan_to_num(0.0), self.floor, self.free)
        if not math.isfinite(cost):
            raise diverged(problem, beginning.filter(psi, start.nan_to_num(0.0)))
        seek = self._alternating if isinstance(beginning, HeldEngine) else self._descending
        return seek(beginning, psi, start.nan_to_num(0.0))  # pyright: ignore[reportArgumentType]

    def _engine(self, theta: Tensor) -> FilterEngine:
        ones = torch.ones(max(len(self.problem.process.names), len(self.floor)), dtype=torch.float64)
        noises = self.problem.process.numbers(ones[: len(self.problem.process.names)])
        psi = torch.cat([theta, noises, self.problem.noise.numbers(ones[: len(self.floor)])])
        if self.gain == "exact" or not self.problem.process.count + self.problem.noise.count:
            return filter_engine(self.problem, psi, self.engine)
        try:
            return HeldEngine(NativeFilter.of(self.problem, psi, held=len(theta)))
        except Unsupported as error:
            raise InputError("arguments", "gain", f"the model cannot be compiled: {error}", '"exact"') from error

    @property
    def _region(self) -> Region:
        system, problem = self.problem.system, self.problem
        nothing = torch.zeros(len(problem.process.names), dtype=torch.float64)
        noises = [problem.process.lower(nothing), problem.noise.lower(self.floor.square())]
        lower = torch.cat([system.lower, *noises])
        more = torch.full((len(lower) - len(system.upper),), math.inf, dtype=torch.float64)
        return Region(lower, torch.cat([system.upper, more]))

    def _watch(self, iteration: int, cost: float, psi: Tensor) -> None:
        if self.monitor is not None:
            self.monitor(iteration, cost, psi[: len(self.problem.system.theta)])

    def _descending(self, engine: FilterEngine, psi: Tensor, x0: Tensor) -> Maximum:
        """Gauss-Newton on all unknowns, and once more from hardly any process noise."""
        likelihood = InnovationLikelihood(engine, x0, self.free)
        options = replace(FINE, max_iterations=self.iterations)
        descend = lambda start: minimise(  # noqa: E731
            likelihood.evaluate, likelihood.linearise, start, self._region, options, self._watch
        )
        best = descend(psi)
        calmer = likelihood.at(_with_less(self.problem, best.point.theta), best.point.x0)
        if self.problem.process.count and math.isfinite(calmer.cost):
            other = descend(calmer)
            best = other if other.point.cost < best.point.cost - LEAST_GAIN else best
        return Maximum(engine, likelihood, best)

    def _alternating(self, engine: HeldEngine, psi: Tensor, x0: Tensor) -> Maximum:
        """Noises and parameters in turn, gains held while parameters move."""
        rounds = max(1, self.iterations)
        held = alternated(engine.filtering, Unknowns(psi, x0, self.free), self._region, rounds, self._watch)
        likelihood = InnovationLikelihood(engine, held.x0, self.free)
        place = likelihood.evaluate(held.psi)
        said = "converged: the likelihood stands still" if held.converged else f"stopped after {rounds} rounds"
        linear = likelihood.linearise(place)
        ended = held.at_bound, held.blind, held.converged, said, len(held.history) - 1, held.history
        return Maximum(engine, likelihood, Minimum(place, linear, *ended))


def _with_less(problem: FilterProblem, psi: Tensor) -> Tensor:
    """Unknowns with hardly any process noise: an unstable vehicle's likelihood may have a second optimum there."""
    first, psi = len(problem.system.theta), psi.clone()
    psi[first : first + len(problem.process.which) * (problem.process.count > 0)] *= LITTLE
    return psi


def diverged(problem: FilterProblem, run: Filtered) -> InputError:
    """Where a filter that diverged did so, and with which state."""
    expected = "parameters, x0 and process noise from which the filter follows the flight"
    if run.lost is None:
        return InputError("flights", "filter", "the innovations' covariance is not positive definite", expected)
    flight, sample, state = run.lost
    time = float(problem.records.start[flight]) + sample * problem.records.dt
    return InputError(
        f"flights[{flight}]", problem.process.names[state], f"the filter diverges at {time:.4g} s", expected
    )


def _outputs_form(noise: str | Tensor, body: Any, ny: int) -> CovarianceForm:
    named = getattr(body, "outputs", ())
    names = tuple(named) if len(named) == ny else tuple(f"y[{i}]" for i in range(ny))
    kind, matrix = noise_of(noise, ny)
    return form("noise", kind if matrix is None else matrix, names, ("",) * ny)


def _floor(noise_floor: Sequence[float] | Tensor | None, records: Records) -> Tensor:
    smallest = smallest_noise(records)
    floor = floor_of(noise_floor, len(smallest))
    return smallest if floor is None else torch.maximum(floor, smallest)


def _result(stepped: Stepped[Maximum]) -> FilterError:
    engine, likelihood, minimum = stepped.fit
    problem, place = likelihood.problem, minimum.point
    system, records, psi, count = problem.system, problem.records, place.theta, len(problem.system.theta)
    local = place.x0.numel() if likelihood.free else 0
    loss = likelihood.samples / max(likelihood.samples - count - local, 1)
    covariance = uncertainty(engine, likelihood, minimum, loss)
    theta, Q, R = problem.split(psi)
    run = engine.filter(psi, place.x0)
    states, covariances = smoothed(problem, psi, place.x0, run)
    identified = _head(covariance, count).without(
        (minimum.at_bound | minimum.not_identifiable | (not stepped.mended))[:count]
    )
    parameters = estimates(system, theta, minimum, identified)
    errors = covariance.covariance
    q, r = slice(count, count + problem.process.count), slice(count + problem.process.count, len(psi))
    rooted = covariances.diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()
    innovations, spreads = (records.measured(part) for part in (run.innovations, run.spreads))
    return FilterError(
        model=system.fitted(theta),
        parameters=parameters,
        covariance=identified.covariance,
        process_noise=sizes(problem.process, psi[q], errors[q, q], loss, "/sqrt(s)"),
        process_covariance=Q * loss if problem.process.count else Q,
        measurement_noise=sizes(problem.noise, psi[r], errors[r, r], loss, ""),
        noise=R * loss if problem.noise.count else R,
        initial_states=states[:, 0],
        converged=minimum.converged and stepped.mended,
        message="; ".join(part for part in (sentence(minimum.message, parameters), stepped.remark) if part),
        history=minimum.history,
        innovations=innovations,
        states=records.measured(states),
        state_errors=records.measured(rooted),
        log_likelihood=-float(run.cost.sum()) - 0.5 * likelihood.samples * math.log(2.0 * math.pi),
        whiteness=whiteness(_padded(innovations, math.nan), _padded(spreads, 0.0)),
        uncertainty=identified,
        times=records.times(),
    )


def _padded(records: list[Tensor], filling: float) -> Tensor:
    """Records of several flights as one batch."""
    return pad_sequence(records, batch_first=True, padding_value=filling)


def _head(whole: Uncertainty, count: int) -> Uncertainty:
    """Of the first parameters alone."""
    square = slice(count), slice(count)
    return Uncertainty(
        whole.cramer_rao[square],
        whole.coloured[square],
        whole.jackknife[:count],
        whole.covariance[square],
        whole.standard_errors[:count],
    )


def sizes(form: CovarianceForm, numbers: Tensor, covariance: Tensor, loss: float, per: str) -> list[ParameterEstimate]:
    """Standard deviations and, for a full covariance, correlations, with errors by the numbers' covariance [n, n].

    loss : by which the covariance at the numbers is too small. per : what follows each unit.
    """
    if not form.count:
        return []
    which = list(form.which)
    pairs = [(i, j) for i in range(len(which)) for j in range(i)] if form.full else []

    def described(numbers: Tensor) -> Tensor:
        matrix = form.at(numbers)[which][:, which]
        sd = matrix.diagonal().clamp_min(1e-300).sqrt()
        return torch.cat([sd * loss**0.5, *(matrix[i, j, None] / sd[i] / sd[j] for i, j in pairs)])

    values, slopes = described(numbers), torch.func.jacrev(described)(numbers)
    errors = ((slopes @ covariance) * slopes).sum(dim=1).clamp_min(0.0).sqrt()
    names = [form.names[i] for i in which] + [f"{form.names[which[i]]}, {form.names[which[j]]}" for i, j in pairs]
    units = [form.units[i] + per for i in which] + [""] * len(pairs)
    bounds = [(0.0, math.inf)] * len(which) + [(-1.0, 1.0)] * len(pairs)
    return [
        ParameterEstimate(
            name=name,
            value=value if value > 1e-149 else 0.0,
            se=error if low + 1e-149 < value < high else math.nan,
            unit=unit,
            bounds=(low, high),
            at_bound=not low + 1e-149 < value < high,
            status="free",
        )
        for name, unit, (low, high), value, error in zip(
            names, units, bounds, values.tolist(), errors.tolist(), strict=True
        )
    ]


def _without_gusts(problem: FilterProblem, stepped: Stepped[Fit]) -> FilterError:
    """Output error in the words of the filter error method."""
    fitted, records = stepped.fit, stepped.records
    place, calm = fitted.minimum.point, result_of(problem.system, stepped)
    states = fitted.likelihood.states_at(place, torch.full_like(records.states, math.nan))
    present = ~records.outputs.isnan()
    residual = torch.full_like(records.outputs, math.nan)
    for part in fitted.likelihood.parts(place):
        part.segments.write(part.residual, residual)
    spreads = torch.where(present.unsqueeze(-1) & present.unsqueeze(-2), place.covariance, 0.0)
    spreads = spreads + torch.diag_embed((~present).to(spreads))
    root = torch.linalg.cholesky(spreads)
    white = torch.linalg.solve_triangular(root, residual.nan_to_num(0.0).unsqueeze(-1), upper=False)
    cost = 0.5 * white.square().sum() + root.diagonal(dim1=-2, dim2=-1).log().sum()
    count = present.sum(dim=(0, 1)).tolist()
    sd = calm.noise.diagonal().sqrt().tolist()
    names = problem.noise.names if problem.noise.count else ()
    return FilterError(
        model=calm.model,
        parameters=calm.parameters,
        covariance=calm.covariance,
        process_noise=[],
        process_covariance=torch.zeros(states.shape[-1], states.shape[-1], dtype=torch.float64),
        measurement_noise=[
            ParameterEstimate(name, sd[i], sd[i] / (2.0 * max(count[i], 1)) ** 0.5, "", (0.0, math.inf), False, "free")
            for i, name in enumerate(names)
        ],
        noise=calm.noise,
        initial_states=calm.initial_states,
        converged=calm.converged,
        message=calm.message,
        history=calm.history,
        innovations=calm.residuals,
        states=records.measured(states),
        state_errors=[torch.zeros_like(one) for one in records.measured(states)],
        log_likelihood=-float(cost) - 0.5 * sum(count) * math.log(2.0 * math.pi),
        whiteness=whiteness(_padded(records.measured(residual), math.nan), _padded(records.measured(spreads), 0.0)),
        uncertainty=calm.uncertainty,
        times=calm.times,
    )
