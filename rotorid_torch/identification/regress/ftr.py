"""Fourier transform regression: closed-form least squares on finite transforms, noisy regressors, honest errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument, Numbers, Sizes
from rotorid_torch.core.parameters import ParameterTable
from rotorid_torch.data.use.pictures import over
from rotorid_torch.errors import InputError
from rotorid_torch.identification.regress.feedback import acting_back
from rotorid_torch.identification.regress.noisy_least_squares import Solution, noisy_least_squares, smooth_variance
from rotorid_torch.identification.regress.rows import KINDS, NOISES, Rows, Transform, flight_rows, total_noise

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = 6
"""R2 of a batch that a regression shows of itself, at most."""
REACH = 3
"""Harmonics on each side over which the colour of the residual is taken for smooth."""
FEWEST = 3
"""Samples of a record, at least."""
PRIOR_PASSES = 3
"""Repetitions in which the weight of a prior follows the residual variance."""


@dataclass(frozen=True)
class Coefficient:
    """One coefficient as tables have it; errors are NaN where the data do not tell it.

    se : for coloured residuals and noisy regressors. se_white : what white residuals and exact regressors would leave.
    """

    name: str
    value: float
    se: float
    se_white: float
    status: str  # "free" or "not identifiable"
    at_bound: bool = False


@dataclass(frozen=True, repr=False)
class Regression(ParameterTable):
    """Result of a Fourier transform regression: `result["q"]` is a `Coefficient`, "0" the first where none has a name.

    coefficients, standard_errors : (..., n); a coefficient that the data cannot tell is 0 with an infinite error.
    uncorrected_errors : (..., n) what white residuals and exact regressors would leave; smaller where residuals are
    coloured. covariance : (..., n, n), for coloured residuals and noisy regressors.
    r2 : (...) in the band, nuisance removed.
    residual : (..., M) complex residual spectrum per square root of T. frequencies : (M,) Hz, flight after flight.
    reliability : (..., n) share of each regressor's in-band power that is not noise.
    reliability_beyond : (..., n) the same for the part that the other regressors do not explain.
    condition : (...) condition number on unit columns. vif : (..., n) variance inflation factors.
    information : independent real data, two per 1/T of band, less nuisance columns. band : Hz.
    names, selected : of the candidates, and of those held.
    notes : what the user must know.
    """

    coefficients: Tensor
    standard_errors: Tensor
    uncorrected_errors: Tensor
    covariance: Tensor
    r2: Tensor
    residual: Tensor
    frequencies: Tensor
    reliability: Tensor
    reliability_beyond: Tensor
    condition: Tensor
    vif: Tensor
    information: float
    band: tuple[float, float]
    names: tuple[str, ...] = ()
    selected: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    columns = shown = ("name", "value", "se", "se_white", "status")

    @property
    def title(self) -> str:
        """Band, and R2 of the first regressions of a batch."""
        low, high = self.band
        r2 = ", ".join(f"{v:.4g}" for v in self.r2.flatten()[:SHOWN].tolist())
        shape = tuple(self.coefficients.shape[:-1])
        return f"Regression{f' of a batch {shape}, its first' if shape else ''}, {low:g} to {high:g} Hz, R2 {r2}"

    @property
    def _estimates(self) -> list[Coefficient]:
        """Of the first of a batch."""
        batch = (0,) * (self.coefficients.dim() - 1)
        names = self.names or tuple(str(k) for k in range(self.coefficients.shape[-1]))
        columns = (self.coefficients, self.standard_errors, self.uncorrected_errors)
        blind = math.nan, math.nan, "not identifiable"
        rows = zip(names, *(column[batch].tolist() for column in columns), strict=True)
        return [Coefficient(n, b, *((se, white, "free") if math.isfinite(se) else blind)) for n, b, se, white in rows]

    def plot(self) -> Figure:
        """Size of the residual's spectrum by frequency, of the first of a batch, as a matplotlib figure."""
        residual = self.residual[(0,) * (self.residual.dim() - 1)].abs()
        order = self.frequencies.argsort()
        return over("residual spectrum", ("frequency, Hz", self.frequencies[order]), {"residual": residual[order]})

    def __repr__(self) -> str:
        return "\n".join((super().__repr__(), *self.notes))


def regress(
    response: Numbers,
    regressors: Numbers,
    dt: float | Sequence[float],
    band: tuple[float, float] = (0.1, 2.0),
    kind: str = "derivative",
    *,
    noise: str | Numbers = "estimated",
    trend: bool = True,
    oversample: int = 1,
) -> Regression:
    """Regress a response, or its derivative, on sampled regressors over a band of frequencies.

    Finite transforms with exact ends at the harmonics k/T of each flight; the derivative is j w x(w) plus end terms.
    Records are taken for smooth between samples; beside a derivative for straight lines where they have edges. Values
    that go together at the samples give coefficients to rounding.
    Per flight, a constant, a trend and the two end terms (whose samples are noisy) are nuisance columns. White noise
    of the regressors is taken out of the normal matrix. Standard errors hold for residuals of any colour that is
    smooth over a few harmonics, and count two data per 1/T.

    Parameters
    ----------
    response : (..., T), or a list of flights of any lengths that share the coefficients. Leading dimensions are
        regressions of their own and broadcast.
    regressors : (..., T, n), or a list of as many flights; columns of pandas give the coefficients their names.
    dt : sample interval, s; or one per flight.
    band : lowest and highest frequency, Hz.
    kind : "derivative" regresses d(response)/dt, "value" the response itself.
    noise : standard deviation of a sample of each regressor (n,); "estimated" from each record's high differences;
        or "none".
    trend : whether a trend in time joins the constant as nuisance.
    oversample : points per 1/T. More than one make a finer picture; they count as data no more than the harmonics do.

    Returns
    -------
    Regression, with `.coefficients .standard_errors .covariance` (..., n) and `.r2` (...).
    Missing samples (NaN) are filled by straight lines, and `.notes` says so, as it does of regressors that cannot be
    told apart, and of those that follow the residual, through feedback or in moving air.

    Raises
    ------
    InputError : shapes that do not fit, a band without enough points, infinite samples, a record mostly missing.

    Source: Morelli and Klein, Aircraft System Identification, 2nd ed., ch. 7; Fuller, Measurement Error Models, ch. 2.

    Examples
    --------
    >>> import numpy as np
    >>> import rotorid_torch as rotorid
    >>> time = np.arange(0.0, 20.0, 0.02)
    >>> regressors = np.stack([np.sin(time), np.cos(2.3 * time)], axis=-1)
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(1000)
    >>> found = rotorid.regress(regressors @ [1.0, -2.0] + noise, regressors, dt=0.02, kind="value")
    >>> [round(value, 2) for value in found.coefficients.tolist()]
    [1.0, -2.0]
    """
    responses, matrices, steps = _records(response, regressors, dt)
    band, noise = _band(band), _noise(noise, matrices[0].shape[-1])
    arguments.word(Argument("regress", "kind"), kind, KINDS)
    arguments.flag(Argument("regress", "trend"), trend)
    oversample = int(arguments.number(Argument("regress", "oversample"), oversample, least=1, whole=True))
    notes: list[str] = []
    transform = Transform(band, kind, noise, trend=trend, oversample=oversample)
    moved = [y - y.nanmedian(dim=-1, keepdim=True).values for y in responses]  # one that stands still is zero
    rows = [flight_rows(y, x, dt, transform, notes) for y, x, dt in zip(moved, matrices, steps, strict=True)]
    regression = solve(rows, band, names=_names(regressors), notes=notes)
    identifiable = regression.standard_errors.isfinite()
    coefficients = torch.where(identifiable, regression.coefficients, 0.0)
    unknown = torch.where(regression.r2.isnan(), torch.inf, 0.0).unsqueeze(-1)  # of a response that stands still
    acting = acting_back(regression.residual, [row.regressors for row in rows], regression.frequencies)
    itself = _response_itself(responses, matrices) if kind == "value" else []
    notes = [*regression.notes, *itself, *_unidentifiable(identifiable), *acting]
    return replace(
        regression,
        coefficients=coefficients,
        standard_errors=regression.standard_errors + unknown,
        uncorrected_errors=regression.uncorrected_errors + unknown,
        covariance=regression.covariance + torch.diag_embed(unknown.expand_as(coefficients)),
        notes=tuple(notes),
    )


def _names(regressors: Any) -> tuple[str, ...]:
    """Names of the columns of a table of pandas, or of the first of several; none of other arrays."""
    first = regressors[0] if isinstance(regressors, list | tuple) else regressors
    columns = list(map(str, getattr(first, "columns", ())))
    return arguments.names(Argument("regress", "regressors"), columns, columns, "column")


def _response_itself(responses: Sequence[Tensor], matrices: Sequence[Tensor]) -> list[str]:
    """What to say of regressors that are the response in every flight."""
    apart = [x - y.unsqueeze(-1) for y, x in zip(responses, matrices, strict=True)]
    same = torch.stack([(one.nan_to_num() == 0.0).flatten(0, -2).all(dim=0) for one in apart]).all(dim=0)
    columns = same.nonzero()[:, 0].tolist()
    return [f"regressors {columns}: are the response itself, which explains all and says nothing"] if columns else []


def _unidentifiable(identifiable: Tensor) -> list[str]:
    """What to say of coefficients that the data do not tell."""
    columns = sorted({int(i) for i in (~identifiable).nonzero()[:, -1]})
    said = f"regressors {columns}: do not move in the band, or are combinations of each other; not identifiable"
    return [said] if columns else []


def solve(
    flights: Sequence[Rows],
    band: tuple[float, float],
    *,
    prior: tuple[Tensor, Tensor] | None = None,
    names: tuple[str, ...] = (),
    notes: Sequence[str] = (),
) -> Regression:
    """Least squares over the rows of several flights, noise taken out, with an optional Gaussian prior.

    prior : mean and standard deviation (n,) of the coefficients; an infinite deviation is no prior.
    """
    z, y = torch.cat([f.regressors for f in flights], dim=-2), torch.cat([f.response for f in flights], dim=-1)
    noise, information = total_noise(flights), sum(f.information for f in flights)
    if information <= z.shape[-1]:
        wrong = f"{information:.0f} independent data in the band for {z.shape[-1]} coefficients"
        raise InputError("arrays", "band", wrong, "a wider band, longer flights or fewer regressors")
    plain = solution = noisy_least_squares(z, y, noise)
    prior_power = torch.zeros_like(solution.coefficients)
    if prior is not None:
        solution, prior_power = _with_prior(z, y, noise, prior, solution, information)
    covariance = solution.inverse @ _scatter(flights, solution, prior_power) @ solution.inverse.mT
    covariance = covariance + torch.diag_embed(torch.where(solution.unknown, torch.inf, 0.0))
    residual = _residual(z, y, solution)
    error, signal = residual.square().sum(-1), y.square().sum(-1)
    if bool((signal == 0.0).any()):
        notes = [*notes, "the response does not move in the band: coefficients of zero say nothing"]
    if bool(solution.noise_filled.any()):
        notes = [*notes, "noise fills a combination of the regressors; leave one of them out"]
    return Regression(
        coefficients=solution.coefficients,
        standard_errors=covariance.diagonal(dim1=-2, dim2=-1).clamp(min=0.0).sqrt(),
        uncorrected_errors=_white_errors(z, y, solution, information),
        covariance=covariance,
        r2=1.0 - error / signal,
        residual=_as_spectrum(residual, flights),
        frequencies=torch.cat([f.frequencies for f in flights]),
        reliability=1.0 - noise / z.square().sum(-2),
        reliability_beyond=plain.reliability_beyond,
        condition=plain.condition,
        vif=plain.vif,
        information=information,
        band=band,
        names=names,
        selected=names,
        notes=tuple(dict.fromkeys(notes)),
    )


def _with_prior(
    z: Tensor, y: Tensor, noise: Tensor, prior: tuple[Tensor, Tensor], plain: Solution, information: float
) -> tuple[Solution, Tensor]:
    """The solution with a prior (mean, sd), whose weight follows the residual, and the prior's power (..., n) in it."""
    (mean, sd), solution = prior, plain
    weight = torch.zeros_like(solution.coefficients)
    for _ in range(PRIOR_PASSES):
        weight = _variance(z, y, solution, information).unsqueeze(-1) / sd.square()
        solution = noisy_least_squares(z, y, noise, (mean, weight))
    return solution, torch.where(weight > 0.0, weight.square() * sd.square(), 0.0)


def _residual(z: Tensor, y: Tensor, solution: Solution) -> Tensor:
    return y - (z @ solution.coefficients.unsqueeze(-1)).squeeze(-1)


def _variance(z: Tensor, y: Tensor, solution: Solution, information: float) -> Tensor:
    """Mean residual variance of one independent datum."""
    return _residual(z, y, solution).square().sum(-1) / (information - z.shape[-1])


def _white_errors(z: Tensor, y: Tensor, solution: Solution, information: float) -> Tensor:
    """Standard errors (..., n) of plain least squares."""
    spread = _variance(z, y, solution, information).unsqueeze(-1) * solution.inverse.diagonal(dim1=-2, dim2=-1)
    return torch.where(solution.unknown, torch.inf, spread.clamp(min=0.0).sqrt())


def _scatter(flights: Sequence[Rows], solution: Solution, prior_power: Tensor) -> Tensor:
    """Covariance (..., n, n) of the normal equations' right-hand side, given the truth.

    Coloured residual times regressors, noise of the regressors times its own share of the residual, doubt about an
    estimated noise power, and the prior.
    """
    total, start = torch.diag_embed(prior_power), 0
    for flight in flights:
        stop = start + flight.response.shape[-1]
        variance = _residual_variance(flight, solution, solution.leverage[..., start:stop])
        shared = flight.noise * solution.coefficients
        total = total + flight.regressors.mT @ (variance.unsqueeze(-1) * flight.regressors)
        total = total + shared.unsqueeze(-1) * shared.unsqueeze(-2) / flight.information
        total = total + torch.diag_embed((flight.noise_scatter * shared).square())
        start = stop
    return total


def _residual_variance(flight: Rows, solution: Solution, leverage: Tensor) -> Tensor:
    """Variance (..., 2 M) of one independent datum's residual: smooth over REACH harmonics, relative to a shape.

    The shape is what noise leaves (for a derivative it rises with the square of frequency) plus a flat rest.
    """
    freedom = 1.0 / flight.oversample - leverage - flight.leverage
    power = _residual(flight.regressors, flight.response, solution).square()
    through = (flight.noise * solution.coefficients.square()).sum(-1, keepdim=True) / flight.information
    shape = flight.response_noise * flight.oversample + through
    mean = (power.sum(-1) / freedom.sum(-1).clamp(min=1.0)).unsqueeze(-1)
    shape = shape + (mean - shape.mean(-1, keepdim=True)).clamp(min=0.0)
    shape = torch.where(shape > 0.0, shape, 1.0)
    return shape * smooth_variance(power / shape, freedom, REACH * flight.oversample)


def _as_spectrum(rows: Tensor, flights: Sequence[Rows]) -> Tensor:
    """Rows of all flights back to one complex spectrum (..., M), flight after flight."""
    parts = rows.split([f.response.shape[-1] for f in flights], dim=-1)
    return torch.cat([torch.complex(*part.chunk(2, dim=-1)) for part in parts], dim=-1)


def _records(response: Any, regressors: Any, dt: Any) -> tuple[list[Tensor], list[Tensor], list[float]]:
    """Responses (..., T), regressors (..., T, n) and sample intervals of each flight.

    A list of records is one of flights; a list of numbers is a single record.
    """
    responses, matrices = _flights("response", response, 1), _flights("regressors", regressors, 2)
    if len(matrices) != len(responses):
        wrong = f"are of {len(matrices)} flight{'s' * (len(matrices) != 1)}"
        raise Argument("regress", "regressors").wrong(wrong, f"{len(responses)}, as many as responses")
    common, checked = Sizes(), []
    for i, (y, x) in enumerate(zip(responses, matrices, strict=True)):
        place = "" if len(responses) == 1 else f"[{i}]"
        sizes = common.without("T")
        argument = Argument("regress", f"response{place}")
        y = arguments.shaped(argument, y, "... T", sizes, missing=True)
        if y.shape[-1] < FEWEST:
            wrong = f"has shape {tuple(y.shape)}: {y.shape[-1]} samples"
            raise argument.wrong(wrong, f"{FEWEST} or more along the last dimension, (..., T): y[:, 0] of a column")
        x = arguments.shaped(Argument("regress", f"regressors{place}"), x, "... T n", sizes, missing=True)
        if not x.shape[-1]:
            raise Argument("regress", f"regressors{place}").wrong("have no column", "(..., T, n), n at least 1")
        try:
            np.broadcast_shapes(y.shape[:-1], x.shape[:-2])
        except ValueError:
            wrong = f"have leading shape {tuple(x.shape[:-2])}, the response {tuple(y.shape[:-1])}"
            raise Argument("regress", f"regressors{place}").wrong(wrong, "some that broadcast") from None
        common = sizes
        checked.append((y, x))
    return [y for y, _ in checked], [x for _, x in checked], _steps(dt, len(responses))


def _flights(key: str, records: Any, dims: int) -> list[Any]:
    """A record, or a list of them, as a list; nested lists of numbers are told from lists of flights by their depth."""
    if isinstance(records, list | tuple):
        if not records:
            raise Argument("regress", key).wrong("is empty", "one record or more")
        first, depth = records[0], 0
        while isinstance(first, list | tuple) and first:
            first, depth = first[0], depth + 1
        depth += int(getattr(first, "ndim", 0))
        if depth >= dims:
            return list(records)
    return [records]


def _steps(dt: Any, flights: int) -> list[float]:
    """One sample interval per flight."""
    argument = Argument("regress", "dt")
    if isinstance(dt, list | tuple) or getattr(dt, "ndim", 0):
        steps = [arguments.number(argument, step, "the sample interval, s", above=0.0) for step in list(dt)]
        if len(steps) not in (1, flights):
            hint = "one number: the sample interval, s" if flights == 1 else f"one number, or {flights}, s"
            raise argument.wrong(f"holds {len(steps)} numbers for {flights} flights", hint)
        return steps * flights if len(steps) == 1 else steps
    return [arguments.number(argument, dt, "the sample interval, s", above=0.0)] * flights


def _band(band: Any) -> tuple[float, float]:
    """Lowest and highest frequency, Hz."""
    argument, expected = Argument("regress", "band"), "a lower and a higher frequency (low, high), Hz"
    edges = arguments.sequence(argument, band, expected)
    if len(edges) != 2:
        raise argument.wrong(f"holds {len(edges)} numbers", expected)
    low, high = (arguments.number(argument, edge, least=0.0) for edge in edges)
    if not low < high:
        raise argument.wrong(f"is {low:g} to {high:g}", expected)
    return low, high


def _noise(noise: Any, columns: int) -> str | Tensor:
    """A word, or standard deviations (n,) of the regressors' samples."""
    argument = Argument("regress", "noise")
    if arguments.is_word(noise):
        return arguments.word(argument, noise, NOISES, " or standard deviations, one per regressor")
    sd = arguments.numbers(argument, noise)
    if sd.dim() and sd.shape != (columns,):
        raise argument.wrong(f"has shape {tuple(sd.shape)}", f"({columns},), one per regressor")
    if bool((sd < 0).any()):
        raise argument.wrong(f"is {sd.tolist()}", "standard deviations, none negative")
    return sd
