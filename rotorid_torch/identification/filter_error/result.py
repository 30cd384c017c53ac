"""What the filter error method says of where it ended."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.core.gauss_newton import Minimum
from rotorid_torch.identification.estimate.output_error import ModuleEstimate, ParameterEstimate, estimates, sentence
from rotorid_torch.identification.estimate.output_error import result_of as calm_result
from rotorid_torch.identification.estimate.own_models.remarks import counted_twice
from rotorid_torch.identification.estimate.own_models.steps import Stepped
from rotorid_torch.identification.estimate.progressive_fit import Fit
from rotorid_torch.identification.estimate.residuals import Whiteness, whiteness
from rotorid_torch.identification.estimate.uncertainty import (
    ColouredErrors,
    FlightRows,
    Uncertainty,
    among_all,
    basis_of,
    inverse_triangle,
    jackknife,
    larger_of,
    lines_of,
)
from rotorid_torch.identification.filter_error.extended_kalman import CovarianceForm, FilterProblem
from rotorid_torch.identification.filter_error.innovations import FilterEngine, FilterPlace, InnovationLikelihood
from rotorid_torch.identification.filter_error.search import Maximum
from rotorid_torch.identification.filter_error.smoother import smoothed_states


@dataclass(frozen=True, repr=False, kw_only=True)
class FilterError(ModuleEstimate):
    """What `filter_error` found: `ModuleEstimate`, and this.

    Attributes
    ----------
    process_noise : standard deviations of the noise in the states' rates, per square root of a second, by state; for
        "full" also correlations. Empty where it was held.
    process_covariance : [nx, nx] its spectral density, covariance per second.
    measurement_noise : the same of the outputs' noise, by output.
    innovations : per flight (T, ny) measured minus predicted from all samples before, NaN = missing.
    states, state_errors : per flight (T, nx) by all samples of the flight (smoothed), and their standard errors, with
        parameters and initial states believed.
    log_likelihood : of all innovations.
    whiteness : of the innovations in units of their own covariance.
    """

    process_noise: list[ParameterEstimate]
    process_covariance: Tensor
    measurement_noise: list[ParameterEstimate]
    innovations: list[Tensor]
    states: list[Tensor]
    state_errors: list[Tensor]
    log_likelihood: float
    whiteness: Whiteness

    LEFT = "innovation"


def result_of(stepped: Stepped[Maximum]) -> FilterError:
    """What is said of a maximum."""
    engine, likelihood, minimum = stepped.fit
    problem, place = engine.problem, minimum.point
    system, records, psi, count = problem.system, problem.records, place.theta, len(problem.system.theta)
    local = place.x0.numel() if likelihood.free else 0
    loss = problem.samples / max(problem.samples - count - local, 1)
    covariance = covariance_of(engine, likelihood, minimum, loss)
    theta, Q, R = problem.split(psi)
    run = engine.filter(psi, place.x0)
    states, covariances = smoothed_states(problem, psi, place.x0, run)
    held = minimum.at_bound | minimum.not_identifiable | (not stepped.mended)
    identified = _head(covariance, count).without(held[:count])
    parameters = estimates(system, theta, minimum, identified)
    errors = covariance.covariance
    q, r = slice(count, count + problem.process.count), slice(count + problem.process.count, len(psi))
    rooted = covariances.diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt()
    said = (sentence(minimum.message, parameters), stepped.remark, counted_twice(records))
    innovations, spreads = (records.measured(part) for part in (run.innovations, run.spreads))
    return FilterError(
        model=system.fitted(theta),
        parameters=parameters,
        covariance=identified.covariance,
        process_noise=sizes(problem.process, psi[q], errors[q, q], minimum.at_bound[q], loss, "/sqrt(s)"),
        process_covariance=Q * loss if problem.process.count else Q,
        measurement_noise=sizes(problem.noise, psi[r], errors[r, r], minimum.at_bound[r], loss, ""),
        noise=R * loss if problem.noise.count else R,
        initial_states=states[:, 0],
        converged=minimum.converged and stepped.mended,
        message="; ".join(filter(None, said)),
        history=minimum.history,
        innovations=innovations,
        states=records.measured(states),
        state_errors=records.measured(rooted),
        log_likelihood=-float(run.cost.sum()) - 0.5 * problem.samples * math.log(2.0 * math.pi),
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
    cramer_rao, coloured, covariance = whole.cramer_rao[square], whole.coloured[square], whole.covariance[square]
    return Uncertainty(cramer_rao, coloured, whole.jackknife[:count], covariance, whole.standard_errors[:count])


def covariance_of(
    engine: FilterEngine, likelihood: InnovationLikelihood, minimum: Minimum[FilterPlace], loss: float
) -> Uncertainty:
    """Of all unknowns psi: innovations that are still coloured count as such, and the jackknife over flights.

    With H = A'A of the whitened rows of the innovations, and I the information in their covariances, the covariance is
    H^-1 (K + I) H^-1: H^-1 K H^-1 is that of `ColouredErrors`. `larger_of` stretches it.

    Source: White, Econometrica 50 (1982), 1 (maximum likelihood of a misspecified model).

    engine : what makes the likelihood's rows. loss : samples over samples minus estimated numbers.
    """
    place, identifiable = minimum.point, minimum.determined
    if not bool(identifiable.any()):
        return Uncertainty.none(identifiable)
    inverse = inverse_triangle(minimum.linear, identifiable)
    gain = inverse @ inverse.mT
    rows, information = _rows(engine, likelihood, place)
    segments = engine.problem.segments

    def flights() -> Iterator[FlightRows]:
        for starts, derivatives, white, present in rows:
            sd = torch.full((starts.shape[-1],), math.inf, dtype=torch.float64)
            basis = basis_of(starts.flatten(0, 1)[None], sd).unflatten(1, present.shape)
            yield FlightRows(derivatives[None], basis, white[None], present[None])

    colour = ColouredErrors.of(flights, lines_of(segments.samples), len(rows), inverse, identifiable)
    coloured = colour.covariance() + gain @ information[identifiable][:, identifiable] @ gain
    plain, coloured = among_all(loss * gain, identifiable), among_all(coloured, identifiable)
    nothing = plain.new_zeros(0, len(identifiable)), plain.new_zeros(0)
    return larger_of(plain, coloured, jackknife(place.flights, nothing, identifiable), len(place.flights))


def _rows(
    engine: FilterEngine, likelihood: InnovationLikelihood, place: FilterPlace
) -> tuple[list[tuple[Tensor, ...]], Tensor]:
    """Rows of the innovations of each flight, and the information [n, n] in the innovations' covariances.

    Of each flight: derivatives by x0 [T, ny, nx] and, freed of these, by psi [T, ny, n], whitened innovations and where
    they are [T, ny]. Flight by flight, for rows of covariances are many.
    """
    problem, nx = engine.problem, place.x0.shape[-1]
    ny, longest = problem.records.outputs.shape[-1], problem.segments.samples
    blocks, information = [], torch.zeros(len(place.theta), len(place.theta), dtype=torch.float64)
    for f in range(len(place.x0)):
        one = problem.alone(f)
        rows = replace(engine, problem=one).rows(place.theta, place.x0[f : f + 1])[0]
        starts, derivatives = rows[..., :nx], rows[..., nx:-1]
        if place.moves is not None:
            derivatives = derivatives - starts @ place.moves[f, :, :-1]
        flat = derivatives[:, ny:].flatten(0, 1)
        information += flat.mT @ flat
        starts = starts if likelihood.free else starts[..., :0]
        parts = starts[:, :ny], derivatives[:, :ny], rows[:, :ny, -1], ~one.segments.outputs[0].isnan()
        missing = longest - len(rows)
        blocks.append(tuple(torch.cat([p, p.new_zeros(missing, *p.shape[1:])]) for p in parts))
    return blocks, information


def sizes(
    form: CovarianceForm, numbers: Tensor, covariance: Tensor, held: Tensor, loss: float, per: str
) -> list[ParameterEstimate]:
    """Standard deviations and, for a full covariance, correlations, with errors by the numbers' covariance [n, n].

    held : mask [n] of the numbers on a bound: what is no larger than such a one has no error.
    loss : by which the covariance at the numbers is too small. per : what follows each unit.
    """
    if not form.count:
        return []
    which = list(form.which)

    def described(numbers: Tensor) -> Tensor:
        matrix = form.at(numbers)[which][:, which]
        sd = matrix.diagonal().clamp_min(1e-300).sqrt()
        return torch.cat([sd * loss**0.5, *(matrix[i, j, None] / sd[i] / sd[j] for i, j in form.below)])

    values, slopes = described(numbers), torch.func.jacrev(described)(numbers)
    errors = ((slopes @ covariance) * slopes).sum(dim=1).clamp_min(0.0).sqrt()
    names = [form.names[i] for i in which] + [f"{form.names[which[i]]}, {form.names[which[j]]}" for i, j in form.below]
    units = [form.units[i] + per for i in which] + [""] * len(form.below)
    bounds = [(0.0, math.inf)] * len(which) + [(-1.0, 1.0)] * len(form.below)
    low, high = values.new_tensor(bounds).T
    at_bound, sizes = (values <= low + 1e-149) | (values >= high), slice(0, len(which))
    at_bound[sizes] |= held[sizes] & (form.at(numbers).diagonal()[which] <= (1.0 + 1e-9) * numbers[sizes])
    values, errors = torch.where(values.abs() > 1e-149, values, 0.0), errors.masked_fill(at_bound, math.nan)
    rows = zip(names, values.tolist(), errors.tolist(), units, bounds, at_bound.tolist(), strict=True)
    return [ParameterEstimate(*row, status="free") for row in rows]


def without_gusts(problem: FilterProblem, stepped: Stepped[Fit]) -> FilterError:
    """Output error in the words of the filter error method."""
    fitted, records = stepped.fit, stepped.records
    place, calm = fitted.minimum.point, calm_result(problem.system, stepped)
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
        **{one.name: getattr(calm, one.name) for one in fields(ModuleEstimate)},
        process_noise=[],
        process_covariance=torch.zeros(states.shape[-1], states.shape[-1], dtype=torch.float64),
        measurement_noise=[
            ParameterEstimate(name, sd[i], sd[i] / (2.0 * max(count[i], 1)) ** 0.5, "", (0.0, math.inf), False, "free")
            for i, name in enumerate(names)
        ],
        innovations=calm.residuals,
        states=records.measured(states),
        state_errors=[torch.zeros_like(one) for one in records.measured(states)],
        log_likelihood=-float(cost) - 0.5 * sum(count) * math.log(2.0 * math.pi),
        whiteness=whiteness(_padded(records.measured(residual), math.nan), _padded(records.measured(spreads), 0.0)),
    )
