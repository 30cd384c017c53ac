"""The air of flights by a model's values: intensity and length of gusts per axis, and their history.

Process noise of an extended Kalman filter enters as air velocities (`model.gusts`); beside them the rates of body and
flapping have a little white noise, for what the model lacks. The noises' sizes, the model's trims, and the rows that
gusts kept step 2 from telling are those of the largest likelihood of the innovations, all other derivatives held; a
smoother then gives gusts at every sample by the whole flight. What all flights have in common is no gust: it belongs to
the trims.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from rotorid_torch.core.gauss_newton import Linear, Minimum, Options, Region, minimise
from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.identification.estimate.initial_states import smallest_noise
from rotorid_torch.identification.estimate.progressive_fit import Estimate
from rotorid_torch.identification.estimate.segments import Records
from rotorid_torch.identification.estimate.system import System
from rotorid_torch.identification.estimate.uncertainty import among_all, inverse_triangle, jackknife, larger_of
from rotorid_torch.identification.filter_error.extended_kalman import CovarianceForm, FilterProblem
from rotorid_torch.identification.filter_error.held_gain import FollowingModel, Noises
from rotorid_torch.identification.filter_error.innovations import (
    FilterPlace,
    InnovationLikelihood,
    NativeFilter,
    linear_model,
)
from rotorid_torch.identification.filter_error.smoother import smoothed_states
from rotorid_torch.model.gusts import GUSTS, QUICK, QUICK_FORCES, in_gusts, noisy_states, passing_speed
from rotorid_torch.model.model import Model

GUST_SEARCH = Options(max_iterations=4, absolute=0.5)
"""Of one search for the noises' sizes."""
SEARCHES = 2
"""The spread of gusts where a flight begins follows from the search before."""
WIDER = (4.0, 16.0, 64.0, 256.0)
"""Variances of outputs over the sensors' that are tried in turn until the filter follows the flights."""
FIRST, QUICK_FIRST, WHITE_FIRST = 0.4, 0.05, 1e-4
"""Spectral densities to start from: of gusts and their quick part, (m/s)2/s, of rates and flapping, per s."""


Histories = dict[str, tuple[Tensor, Tensor]]
"""Time (T,), s, and gusts (T, 3), m/s, by flight."""


@dataclass(frozen=True)
class GustAxis:
    """Gusts along one body axis: rms, m/s, and scale length, m, with standard errors that believe the model.

    A length at the end of its range has an infinite one.
    """

    axis: str
    intensity: float
    intensity_se: float
    length: float
    length_se: float


@dataclass(frozen=True)
class Air:
    """The air as it was estimated.

    axes : one each of u v w. speed : with which eddies pass, m/s. dt : interval of the histories, s.
    velocities, errors : [F, T, 3] smoothed gusts of the flights, m/s, and their standard errors; zero beyond a
    flight's end.
    unknowns : of the filter, and common [3] what all flights have in common, m/s: with both, gusts of other flights.
    variances : [P] of the parameters when gusts are as uncertain as the filter leaves them, NaN where nothing tells.
    steady : [3] standard deviation of the wind that all flights have in common and do not tell, m/s.
    doubtful : parameters that were estimated together with the air.
    """

    axes: tuple[GustAxis, ...]
    speed: float
    dt: float
    velocities: Tensor
    errors: Tensor
    variances: Tensor
    unknowns: Tensor
    common: Tensor
    steady: Tensor
    doubtful: tuple[str, ...] = ()


@dataclass(frozen=True)
class Weather:
    """What flights in the same air share.

    intensity, length : rms of gusts, m/s, and their scale lengths, m, of u v w. speed : with which they pass, m/s.
    densities : spectral densities of the process noise by state. noise : variances of the outputs' noise by channel.
    """

    intensity: tuple[float, float, float]
    length: tuple[float, float, float]
    speed: float
    densities: dict[str, float]
    noise: dict[str, float]

    @classmethod
    def of(cls, air: Air, model: Model) -> Weather:
        """Of the air that was estimated with a model."""
        layout, outputs = in_gusts(model).layout, model.body.outputs
        states = [layout.names[i] for i in layout.places(noisy_states(model))]
        density, noise = air.unknowns[-len(states) - len(outputs) :].split([len(states), len(outputs)])
        (iu, lu), (iv, lv), (iw, lw) = ((axis.intensity, axis.length) for axis in air.axes)
        densities = dict(zip(states, density.tolist(), strict=True))
        return cls((iu, iv, iw), (lu, lv, lw), air.speed, densities, dict(zip(outputs, noise.tolist(), strict=True)))


def find_gusts(
    model: Model, names: Sequence[str], flights: Records, floor: Tensor, doubtful: Sequence[str] = ()
) -> Air:
    """The air of flights, by a model that is believed but for its trims and what is doubtful.

    names : of its parameters that are estimated. floor : [ny] sensor noise. doubtful : those of them that are
        estimated together with the air.

    Raises Unsupported: the model cannot be compiled.
    """
    floor = torch.maximum(floor, smallest_noise(flights)).square()
    problem, held = _problem(model, names, doubtful, flights, floor.sqrt())
    system = problem.system
    minimum, engine, x0 = _noises(problem, held, floor)
    psi = torch.cat([system.theta[:held], minimum.point.theta])
    engine = replace(engine, problem=_with_spread(problem, psi))
    gusts, errors, inside = _smoothed(engine, psi)
    common = gusts.sum(dim=(0, 1)) / inside.sum()
    gusts = torch.where(inside, gusts - common, 0.0)
    seconds, before, speed = flights.lengths * flights.dt, len(system.names) - held - 3, passing_speed(model)
    axes = _axes(minimum, before, speed, seconds)
    steady = torch.tensor([steady_wind(speed / a.length, a.intensity, seconds) for a in axes], dtype=torch.float64)
    estimated = system.names[:-3]
    by_name = dict(zip(estimated, _variances(engine, psi, x0, model, estimated).tolist(), strict=True))
    variances = torch.tensor([by_name[n] for n in names], dtype=torch.float64)
    return Air(axes, speed, flights.dt, gusts, errors, variances, psi, common, steady, tuple(doubtful))


def follow(model: Model, names: Sequence[str], air: Air, flights: Records) -> Tensor:
    """Gusts [F, T, 3] of other flights, by the filter of the first; arguments as `find_gusts`."""
    noise = air.unknowns[-flights.outputs.shape[-1] :]
    problem, _ = _problem(model, names, air.doubtful, flights, noise.sqrt())
    gusts, _, inside = _smoothed(_believing(problem, air.unknowns), air.unknowns)
    return torch.where(inside, gusts - air.common, 0.0)


def in_weather(model: Model, weather: Weather, flights: Records, floor: Tensor) -> Tensor:
    """Smoothed gusts [F, T, 3] of flights in such weather, by a model that is believed.

    floor : [ny] sensor noise.
    """
    floor = torch.maximum(floor, smallest_noise(flights)).square()
    problem, _ = _problem(model, model.parameter_set.free, (), flights, floor.sqrt())
    process, lengths = problem.process, torch.tensor(weather.length, dtype=torch.float64)
    densities = [weather.densities.get(process.names[i], WHITE_FIRST) for i in process.which]
    noise = torch.tensor([weather.noise.get(n, 0.0) for n in model.body.outputs], dtype=torch.float64)
    noise = torch.maximum(noise, floor)
    density = torch.tensor(densities, dtype=torch.float64)
    psi = torch.cat([problem.system.theta[:-3], weather.speed / lengths, density, noise])
    engine = _believing(problem, psi)
    gusts, _, inside = _smoothed(engine, _followed(engine, psi, noise, problem.records.states[:, 0]))
    return torch.where(inside, gusts - gusts.sum(dim=(0, 1)) / inside.sum(), 0.0)


def histories(names: Sequence[str], flights: Records, gusts: Tensor) -> Histories:
    """Gusts [F, T, 3] by name of the flight."""
    return {
        name: (start + flights.dt * torch.arange(count, dtype=torch.float64), one[:count])
        for name, start, count, one in zip(names, flights.start, flights.lengths.tolist(), gusts, strict=True)
    }


def _believing(problem: FilterProblem, psi: Tensor) -> NativeFilter:
    """A filter without unknowns."""
    return NativeFilter.of(_with_spread(problem, psi), psi, len(psi))


def _smoothed(engine: NativeFilter, psi: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gusts and their standard errors [F, T, 3], and where a flight is [F, T, 1].

    Where gusts begin so far apart that the filter loses the flights, with more noise of the outputs.
    """
    problem = engine.problem
    x0 = problem.records.states[:, 0]
    run = engine.filter(psi, x0)
    if not bool(run.cost.isfinite().all()):
        psi = _followed(engine, psi, psi[-problem.noise.count :], x0)
        run = engine.filter(psi, x0)
    states, covariances = smoothed_states(problem, psi, x0, run)
    places = [problem.process.names.index(n) for n in GUSTS]
    inside = problem.segments.inside.unsqueeze(-1)
    variances = covariances.diagonal(dim1=-2, dim2=-1)[..., places].clamp_min(0.0)
    return torch.where(inside, states[..., places], 0.0), torch.where(inside, variances.sqrt(), 0.0), inside


def _variances(engine: NativeFilter, psi: Tensor, x0: Tensor, model: Model, names: Sequence[str]) -> Tensor:
    """Of the parameters, first in psi, by the innovations with gains held, and by the jackknife over flights."""
    count, nx = len(engine.problem.system.theta), x0.shape[-1]
    following = FollowingModel.of(engine, psi[:count], x0, engine.gains(psi, x0))
    each = following.normal_equations(psi[:count], x0)[:, nx:, nx:]
    columns = torch.tensor([*range(len(names)), count])
    each = each[:, columns][:, :, columns]
    numbers, places = model.parameter_set, [model.parameter_set.index(n) for n in names]
    sd, finite = numbers.prior_sd[places], torch.isfinite(numbers.prior_sd[places])
    prior = torch.diag(1.0 / sd)[finite], ((numbers.values[places] - psi[: len(names)]) / sd)[finite]
    A, _ = linear_model(each.sum(dim=0))
    A = torch.cat([A, prior[0]])
    identifiable = torch.linalg.vector_norm(A, dim=0) > 0.0
    inverse = inverse_triangle(Linear(A, A[:, 0]), identifiable)
    plain = among_all(inverse @ inverse.mT, identifiable)
    jackknifed = jackknife([linear_model(one) for one in each], prior, identifiable)
    return torch.where(identifiable, larger_of(plain, plain, jackknifed, len(each)).standard_errors.square(), math.nan)


def widened(estimate: Estimate, variances: Tensor) -> Estimate:
    """The estimate with standard errors no smaller than the roots of variances [P]; correlations stay."""
    before = estimate.uncertainty
    errors, least = before.standard_errors, variances.sqrt().nan_to_num(0.0)
    stretch = torch.where(errors > 0.0, least / errors.clamp_min(1e-300), 1.0).clamp_min(1.0)
    covariance = before.covariance * stretch * stretch[:, None]
    return replace(estimate, uncertainty=replace(before, covariance=covariance, standard_errors=errors * stretch))


def steady_wind(rate: float, intensity: float, seconds: Tensor) -> float:
    """Standard deviation of the mean of gusts dg/dt = -rate g + noise over all flights together, of `seconds` [F] each.

    Source: variance of a time average by the autocovariance, Priestley, Spectral Analysis and Time Series, sec. 5.3.1.
    """
    passed = rate * seconds
    each = 2.0 * (passed + torch.expm1(-passed)) / rate**2
    return intensity * float(each.sum()) ** 0.5 / float(seconds.sum())


def in_steady_wind(estimate: Estimate, names: Sequence[str], values: Mapping[str, float], air: Air) -> Estimate:
    """The estimate with trims as uncertain as those of calm air are.

    The wind c that all flights have in common moves the trim of each row by minus its derivatives by the velocities
    times c. The flights do not tell it: it adds G var(c) G' to the covariance, G [P, 3] these derivatives in the rows
    of trims, and zero in those of derivatives, which are the same in any steady wind.

    Trims whose row has its derivatives among the parameters (X.trim, X.u) are those of helicopters. A multirotor's
    (trim.X) have errors without the wind: what moves them are derivatives of its rotors, which are no parameters.

    names : of the parameters [P]. values : of all parameters by name.
    """
    before = estimate.uncertainty
    moved = [[values.get(n.removesuffix("trim") + v, 0.0) * n.endswith(".trim") for v in VELOCITIES] for n in names]
    G = torch.tensor(moved, dtype=torch.float64) * air.steady * (before.standard_errors > 0.0)[:, None]
    covariance = before.covariance + G @ G.mT
    errors = covariance.diagonal().clamp_min(0.0).sqrt()
    return replace(estimate, uncertainty=replace(before, covariance=covariance, standard_errors=errors))


def _problem(
    model: Model, names: Sequence[str], doubtful: Sequence[str], flights: Records, sd: Tensor
) -> tuple[FilterProblem, int]:
    """Flights with gusts among their states, which begin at what is known of them; how many parameters are held.

    sd : [ny] of the outputs that are states, where flights begin.
    """
    free = [n for n in names if n.endswith(".trim") or n in doubtful]
    held = [n for n in names if n not in free]
    rates = [f"gusts.rate_{n}" for n in VELOCITIES]
    model = in_gusts(model)
    system = System(model, [*held, *free, *rates])
    names, nothing = model.layout.names, (*GUSTS, *QUICK_FORCES)
    measured = iter(flights.states.unbind(-1))
    zero = torch.zeros_like(flights.states[..., 0])
    states = torch.stack([zero if n in nothing else next(measured) for n in names], dim=-1)
    states = torch.where(states.isnan(), model.reference_point[0], states)
    noise = dict(zip(model.body.outputs, sd.tolist(), strict=True))
    moved = dict(zip(names, states.flatten(0, 1).std(dim=0).tolist(), strict=True))
    spread = torch.tensor([noise.get(n, max(moved[n], 1e-3)) for n in names], dtype=torch.float64)
    outputs = model.body.outputs
    process = CovarianceForm(names, ("",) * len(names), tuple(model.layout.places(noisy_states(model))))
    measured_noise = CovarianceForm(outputs, ("",) * len(outputs), tuple(range(len(outputs))))
    flights, P0 = replace(flights, states=states), torch.diag(spread.square())
    return FilterProblem(system, flights, process, measured_noise, P0), len(held)


def _with_spread(problem: FilterProblem, psi: Tensor) -> FilterProblem:
    """Gusts begin anywhere in their stationary distribution."""
    P0, count = problem.P0.clone(), len(problem.system.theta)
    density = psi[count : count + problem.process.count]
    rates = torch.cat([psi[count - 3 : count], torch.full((3,), QUICK, dtype=torch.float64)])
    names = problem.process.names
    which = [problem.process.which.index(names.index(n)) for n in (*GUSTS, *QUICK_FORCES)]
    for name, variance in zip((*GUSTS, *QUICK_FORCES), density[which] / (2.0 * rates), strict=True):
        P0[names.index(name), names.index(name)] = variance
    return replace(problem, P0=P0)


def _noises(problem: FilterProblem, held: int, floor: Tensor) -> tuple[Minimum[FilterPlace], NativeFilter, Tensor]:
    """Trims, rates of gusts and sizes of noise [n] of the largest likelihood; the filter, initial states [F, nx]."""
    system, x0 = problem.system, problem.records.states[:, 0]
    wanted = [problem.process.names[i] for i in problem.process.which]
    first = [FIRST if n in GUSTS else QUICK_FIRST if n in QUICK_FORCES else WHITE_FIRST for n in wanted]
    theta, density = system.theta, torch.tensor(first, dtype=torch.float64)
    psi = torch.cat([theta, density, floor])
    lower = torch.cat([system.lower, torch.full_like(density, 1e-12), floor])
    upper = torch.cat([system.upper, torch.full((len(lower) - len(theta),), math.inf, dtype=torch.float64)])
    engine = NativeFilter.of(problem, psi, held)
    minimum: Minimum[FilterPlace] | None = None
    for _ in range(SEARCHES):
        engine = replace(engine, problem=_with_spread(problem, psi))
        psi = _followed(engine, psi, floor, x0) if minimum is None else psi
        likelihood = InnovationLikelihood(Noises(engine, psi[:held]), x0, free=False)
        noises = Region(lower[held:], upper[held:])
        minimum = minimise(likelihood.evaluate, likelihood.linearise, psi[held:], noises, GUST_SEARCH)
        psi = torch.cat([psi[:held], minimum.point.theta])
    assert minimum is not None
    return minimum, engine, x0


def _followed(engine: NativeFilter, psi: Tensor, floor: Tensor, x0: Tensor) -> Tensor:
    """Psi with so much noise of the outputs that the filter follows the flights."""
    louder = (torch.cat([psi[: len(psi) - len(floor)], wider * floor]) for wider in WIDER)
    return next((tried for tried in louder if bool(engine.cost(tried, x0).isfinite().all())), psi)


def least_error(rate: float, seconds: float, flights: int) -> float:
    """Standard error of the logarithm of a length by gusts that were measured without any noise; of an intensity half.

    A path dg/dt = -rate g + noise tells its noise exactly, and of log rate the information rate T / 2; that each
    flight's first gust is as large as the stationary ones adds 1 / 2 a flight (T : of all flights together). No
    estimate without bias has less.

    Source: Kutoyants, Statistical Inference for Ergodic Diffusion Processes, sec. 2.1 (Ornstein-Uhlenbeck process).
    """
    return (0.5 * rate * seconds + 0.5 * flights) ** -0.5


def _axes(minimum: Minimum[FilterPlace], before: int, speed: float, seconds: Tensor) -> tuple[GustAxis, ...]:
    """Intensity sqrt(q/(2 rate)) and length V/rate of each axis, with errors no less than `least_error`.

    before : trims before the rates among the unknowns. seconds : of each flight. A rate at its bound is as uncertain
        as that.
    """
    identifiable = minimum.determined
    inverse = inverse_triangle(minimum.linear, identifiable)
    covariance = torch.zeros(len(identifiable), len(identifiable), dtype=torch.float64)
    covariance[identifiable[:, None] & identifiable] = (inverse @ inverse.mT).flatten()
    axes = []
    for k, name in enumerate(VELOCITIES):
        place = [before + k, before + 3 + k]
        rate, density = minimum.point.theta[place].tolist()
        relative = torch.tensor([1.0 / rate, 1.0 / density], dtype=torch.float64)
        C = covariance[place][:, place] * relative * relative[:, None]
        missing = max(least_error(rate, float(seconds.sum()), len(seconds)) ** 2 - float(C[0, 0]), 0.0)
        C[0, 0] += missing
        slopes = torch.tensor([-0.5, 0.5], dtype=torch.float64)
        intensity, length = math.sqrt(density / (2.0 * rate)), speed / rate
        intensity_se = intensity * float((slopes @ C @ slopes).clamp_min(0.0)) ** 0.5
        length_se = length * float(C[0, 0]) ** 0.5 if bool(identifiable[before + k]) else math.inf
        axes.append(GustAxis(name, intensity, intensity_se, length, length_se))
    return tuple(axes)


def fed_in(flights: Records, air: Air, ranks: Ranks = ALONE) -> Records:
    """Flights of this rank with their gusts as three more controls."""
    before = sum(ranks.gather(len(flights.lengths))[: ranks.rank])
    gusts = air.velocities[before : before + len(flights.lengths), : flights.samples]
    return replace(flights, controls=torch.cat([flights.controls, gusts], dim=-1))


def of_all(flights: Records, ranks: Ranks) -> Records:
    """Flights of all ranks, rank after rank."""
    parts = ranks.gather(flights)
    longest = max(part.samples for part in parts)

    def joined(records: list[Tensor], value: float) -> Tensor:
        return torch.cat([pad(r, (0, 0, 0, longest - r.shape[1]), value=value) for r in records])

    lengths, starts = torch.cat([part.lengths for part in parts]), torch.cat([part.start for part in parts])
    outputs, states = (joined([getattr(part, of) for part in parts], math.nan) for of in ("outputs", "states"))
    return Records(flights.dt, lengths, starts, joined([part.controls for part in parts], 0.0), outputs, states)
