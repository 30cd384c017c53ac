"""What the filter error method says of where it ended."""

import math
from dataclasses import dataclass, fields

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from rotorid_torch.identification.estimate.output_error import ModuleEstimate, ParameterEstimate, estimates, sentence
from rotorid_torch.identification.estimate.output_error import result_of as calm_result
from rotorid_torch.identification.estimate.own_models.steps import Stepped
from rotorid_torch.identification.estimate.progressive_fit import Fit
from rotorid_torch.identification.estimate.residuals import Whiteness, whiteness
from rotorid_torch.identification.estimate.uncertainty import Uncertainty
from rotorid_torch.identification.filter_error.covariance import covariance_of
from rotorid_torch.identification.filter_error.extended_kalman import CovarianceForm, FilterProblem
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

    def described(numbers: Tensor) -> Tensor:
        matrix = form.at(numbers)[which][:, which]
        sd = matrix.diagonal().clamp_min(1e-300).sqrt()
        return torch.cat([sd * loss**0.5, *(matrix[i, j, None] / sd[i] / sd[j] for i, j in form.below)])

    values, slopes = described(numbers), torch.func.jacrev(described)(numbers)
    errors = ((slopes @ covariance) * slopes).sum(dim=1).clamp_min(0.0).sqrt()
    names = [form.names[i] for i in which] + [f"{form.names[which[i]]}, {form.names[which[j]]}" for i, j in form.below]
    units = [form.units[i] + per for i in which] + [""] * len(form.below)
    bounds = [(0.0, math.inf)] * len(which) + [(-1.0, 1.0)] * len(form.below)
    return [
        ParameterEstimate(
            name=name,
            value=value if abs(value) > 1e-149 else 0.0,
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
