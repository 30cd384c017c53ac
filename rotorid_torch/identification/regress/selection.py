"""Structure of an equation: stepwise selection judged on flights left out, and what the data cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rotorid_torch.identification.regress.equation import Equation, choose_band, columns_of, equation_rows, fit_rows
from rotorid_torch.identification.regress.fourier import noise_floor
from rotorid_torch.identification.regress.ftr import Regression, solve
from rotorid_torch.identification.regress.noisy_least_squares import noisy_least_squares
from rotorid_torch.identification.regress.rows import Rows, total_noise

RELIABLE = 0.5
"""Least reliability that every held regressor must keep beyond the others."""
MARGIN = 0.01
"""Relative fall of the error on flights left out that pays for one more regressor."""


@dataclass(frozen=True)
class Beyond:
    """What a regressor carries beyond others.

    share : of its in-band power without noise, not explained by the others.
    reliability : of that remainder; 0 where it is nothing but noise.
    sigma : by how many standard deviations the remainder exceeds what noise alone leaves.
    gains : the others' coefficients, name ~ sum of gains times others: with a small share only the combination of
        their derivatives with gain times that of this regressor is identifiable.
    """

    name: str
    share: float
    reliability: float
    sigma: float
    gains: dict[str, float]


@dataclass(frozen=True)
class _Folds:
    """Triangular rows [Z y] of all flights and of all but one, and of each flight, with their noise."""

    together: Tensor  # (F + 1, n + 1, n + 1), the last one with all flights
    together_noise: Tensor  # (F + 1, n)
    apart: Tensor  # (F, n + 1, n + 1)
    apart_noise: Tensor  # (F, n)
    information: float
    prior: tuple[Tensor, Tensor] | None  # mean and weight (n,)


def select(equation: Equation, forced: Sequence[str] = (), driven: Sequence[str] = ()) -> Regression:
    """Choose the regressors of an equation and fit them.

    Forward: of the candidates that leave every regressor reliable beyond the others, the one that lowers the squared
    error most, as long as the predicted squared error falls. Then, of the path, the smallest set whose error on
    flights left out in turn is within one per cent of the least; then every regressor that is not missed is dropped.
    With one flight the predicted squared error alone decides.

    Parameters
    ----------
    forced : names that stay in whatever the data say.
    driven : names that the other candidates may drive (flapping): each one that carries nothing reliable beyond all
        the others is left out from the start, for it and what drives it are one regressor.

    Returns
    -------
    Regression with `.selected` in the order of the equation's names and `.reasons` for each regressor left out.

    Source: Morelli and Klein, Aircraft System Identification, ch. 5 (orthogonalised stepwise, predicted squared error).
    """
    notes: list[str] = []
    band = equation.band or choose_band(equation, notes)
    flights = equation_rows(equation, band, notes)
    folds = _folds(equation, flights)
    index = equation.index(forced)
    barred = _barred(folds, equation.index(driven), index)
    held = _backward(folds, _forward(folds, index, barred), index)
    chosen = tuple(name for i, name in enumerate(equation.names) if i in held)
    result = fit_rows(equation, flights, band, chosen, notes)
    return replace(result, reasons=_reasons(equation, folds, held, barred))


def beyond(equation: Equation, targets: Sequence[str], conditions: Sequence[str]) -> list[Beyond]:
    """Tell what each target carries in the band beyond the given regressors, one by one.

    Controls against states show how much of a control is not feedback; flapping against what drives it shows whether
    both can be held in one equation.
    """
    band = equation.band or choose_band(equation)
    flights = equation_rows(equation, band)
    information = sum(f.information for f in flights)
    others = [columns_of(f, equation.index(conditions)) for f in flights]
    z, noise = torch.cat([f.regressors for f in others], dim=-2), total_noise(others)
    results = []
    for name, column in zip(targets, equation.index(targets), strict=True):
        y = torch.cat([f.regressors[..., column] for f in flights], dim=-1)
        column_noise = sum(f.noise[..., column] for f in flights)
        gains = noisy_least_squares(z, y, noise).coefficients
        left = (y - z @ gains).square().sum()
        free = information - len(conditions)
        chance = (column_noise + (gains.square() * noise).sum()) * free / information
        excess = left - chance
        results.append(
            Beyond(
                name=name,
                share=float((excess / (y.square().sum() - column_noise).clamp(min=1e-300)).clamp(0.0, 1.0)),
                reliability=float((excess / left.clamp(min=1e-300)).clamp(0.0, 1.0)),
                sigma=float(excess / (chance * (2.0 / free) ** 0.5).clamp(min=1e-300)),
                gains=dict(zip(conditions, gains.tolist(), strict=True)),
            )
        )
    return results


def redundant(equation: Equation, targets: Sequence[str], conditions: Sequence[str]) -> list[str]:
    """Targets that carry nothing reliable beyond the given regressors: hold them or what drives them, not both."""
    return [result.name for result in beyond(equation, targets, conditions) if result.reliability < RELIABLE]


def response_lag(equation: Equation) -> tuple[float, float]:
    """Lag of a response behind its regressors: tau in x + tau dx/dt = sum of gains times regressors.

    A response that follows its regressors at once (algebraic flapping) has a lag that is small against the sample
    interval or not significant; then its derivative must not be regressed. x and dx/dt bear the same noise, but in
    quadrature, so that only the power of each counts.

    Parameters
    ----------
    equation : of kind "value".

    Returns
    -------
    tau and its standard error, s.
    """
    noise = equation.regressor_noise
    if noise is not None:
        lagged_noise = equation.response_noise
        lagged_noise = (
            float(noise_floor(torch.as_tensor(next(iter(equation.response))))) if lagged_noise is None else lagged_noise
        )
        noise = [*torch.as_tensor(noise).tolist(), lagged_noise]
    band = equation.band or choose_band(equation)
    both = [
        torch.cat((x, y.unsqueeze(-1)), dim=-1) for x, y in zip(equation.regressors, equation.response, strict=True)
    ]
    swapped = []
    for flight in equation_rows(replace(equation, kind="derivative", regressors=both, regressor_noise=noise), band):
        rate_noise = (flight.response_noise * (1.0 - flight.leverage)).sum(-1, keepdim=True)
        swapped.append(
            replace(
                flight,
                response=flight.regressors[:, -1],
                regressors=torch.cat((flight.regressors[:, :-1], -flight.response.unsqueeze(-1)), dim=-1),
                noise=torch.cat((flight.noise[:-1], rate_noise)),
                response_noise=(flight.noise[-1:] / flight.information).expand_as(flight.response),
            )
        )
    result = solve(swapped, band)
    return float(result.coefficients[-1]), float(result.standard_errors[-1])


def _folds(equation: Equation, flights: Sequence[Rows]) -> _Folds:
    apart = torch.stack([_triangle(torch.cat((f.regressors, f.response.unsqueeze(-1)), dim=-1)) for f in flights])
    noise = torch.stack([f.noise for f in flights])
    count, size = apart.shape[0], apart.shape[-1]
    keep = [[g for g in range(count) if g != f] for f in range(count)] + [list(range(count))]
    together = torch.stack([_triangle(apart[rows].reshape(-1, size)) for rows in keep])
    information = sum(f.information for f in flights)
    folds = _Folds(together, torch.stack([noise[rows].sum(0) for rows in keep]), apart, noise, information, None)
    prior = equation.prior()
    if prior is None:
        return folds
    every = list(range(len(equation.names)))
    variance = _errors(folds, [every])[0] * float(together[-1][:, -1].square().sum()) / information
    return replace(folds, prior=(prior[0], variance / prior[1].square()))


def _triangle(rows: Tensor) -> Tensor:
    """Square triangular rows with the same normal matrix, padded with zeros where there are fewer."""
    size = rows.shape[-1]
    if rows.shape[0] < size:
        rows = torch.cat((rows, rows.new_zeros(size - rows.shape[0], size)))
    return torch.linalg.qr(rows, mode="r").R


def _fits(folds: _Folds, sets: Sequence[Sequence[int]]) -> tuple[Tensor, Tensor]:
    """Coefficients (F + 1, K, s) of K sets of columns on all folds; reliability beyond the others (K, s)."""
    index = torch.tensor([list(s) for s in sets])
    z = folds.together[:, :, index].permute(0, 2, 1, 3)
    y = folds.together[:, None, :, -1].expand(z.shape[:-1])
    prior = None if folds.prior is None else (folds.prior[0][index], folds.prior[1][index])
    solution = noisy_least_squares(z, y, folds.together_noise[:, index], prior)
    return solution.coefficients, solution.reliability_beyond[-1]


def _errors(folds: _Folds, sets: Sequence[Sequence[int]]) -> tuple[Tensor, Tensor, Tensor]:
    """Squared error of K sets over that of the response: on the flights fitted, on flights left out; reliabilities.

    The part of the error that noise of the regressors makes is taken off.
    """
    index = torch.tensor([list(s) for s in sets])
    total = folds.together[-1, :, -1].square().sum()
    if index.shape[-1] == 0:
        return torch.ones(len(sets)), torch.ones(len(sets)), torch.ones(len(sets), 0)
    theta, reliability = _fits(folds, sets)

    def error(rows: Tensor, noise: Tensor, theta: Tensor) -> Tensor:
        left = rows[..., None, :, -1] - (rows[:, :, index].permute(0, 2, 1, 3) @ theta.unsqueeze(-1)).squeeze(-1)
        return left.square().sum(-1) - (noise[:, index] * theta.square()).sum(-1)

    fitted = error(folds.together[-1:], folds.together_noise[-1:], theta[-1:])[0] / total
    left_out = error(folds.apart, folds.apart_noise, theta[:-1]).sum(0) / total
    return fitted, left_out, reliability


def _barred(folds: _Folds, driven: list[int], forced: list[int]) -> list[int]:
    """Driven regressors that carry nothing reliable beyond all that are not driven."""
    count = folds.together.shape[-1] - 1
    drivers = [i for i in range(count) if i not in driven]
    candidates = [i for i in driven if i not in forced]
    if not candidates or not drivers:
        return []
    reliability = _fits(folds, [[*drivers, i] for i in candidates])[1][:, -1]
    return [i for i, value in zip(candidates, reliability.tolist(), strict=True) if value < RELIABLE]


def _forward(folds: _Folds, forced: list[int], barred: list[int]) -> list[int]:
    """Grow the set; return the smallest one of the path with about the least error on flights left out."""
    count = folds.together.shape[-1] - 1
    path = [list(forced)]
    fitted, left_out, _ = _errors(folds, path)
    error, scores = float(fitted[0]), [float(left_out[0])]
    floor = max(float(_errors(folds, [range(count)])[0][0]), 1e-12)
    while len(path[-1]) < min(count - len(barred), int(folds.information) - 1):
        candidates = [[*path[-1], i] for i in range(count) if i not in path[-1] and i not in barred]
        fitted, left_out, reliability = _errors(folds, candidates)
        fitted = torch.where(_reliable(reliability, len(forced)), fitted, torch.inf)
        best = int(fitted.argmin())
        if not error - float(fitted[best]) > 2.0 * floor / folds.information:
            break
        path.append(candidates[best])
        error = float(fitted[best])
        scores.append(float(left_out[best]))
    if len(folds.apart) < 2:
        return path[-1]
    return next(s for s, score in zip(path, scores, strict=True) if score <= min(scores) * (1.0 + MARGIN))


def _backward(folds: _Folds, held: list[int], forced: list[int]) -> list[int]:
    """Drop, one by one, what the flights left out do not miss."""
    if len(folds.apart) < 2:
        return held
    score = float(_errors(folds, [held])[1][0])
    while len(held) > len(forced):
        smaller = [[i for i in held if i != j] for j in held if j not in forced]
        left_out = _errors(folds, smaller)[1]
        best = int(left_out.argmin())
        if float(left_out[best]) > score * (1.0 + MARGIN):
            break
        held, score = smaller[best], min(score, float(left_out[best]))
    return held


def _reliable(reliability: Tensor, forced: int) -> Tensor:
    """Whether every regressor of a set that was chosen is reliable beyond the others."""
    return (reliability[..., forced:] >= RELIABLE).all(-1)


def _reasons(equation: Equation, folds: _Folds, held: list[int], barred: list[int]) -> dict[str, str]:
    """Say for each regressor left out why, or what would happen with it in."""
    free = [i for i in range(len(equation.names)) if i not in held]
    if not free:
        return {}
    now = float(_errors(folds, [held])[1][0])
    _, left_out, reliability = _errors(folds, [[*held, i] for i in free])
    reasons = {}
    for i, score, reliable in zip(free, left_out.tolist(), reliability.tolist(), strict=True):
        worst = min(range(len(reliable)), key=lambda k: reliable[k])
        if i in barred:
            reason = "carries nothing reliable beyond what drives it"
        elif reliable[worst] < RELIABLE:
            name = equation.names[[*held, i][worst]]
            reason = (
                f"with it {name} is explained by the others (reliability beyond them {max(reliable[worst], 0.0):.2f})"
            )
        elif len(folds.apart) < 2:
            reason = "predicted squared error does not fall"
        else:
            reason = f"error on flights left out {100.0 * score:.3g} % with it, {100.0 * now:.3g} % without"
        reasons[equation.names[i]] = reason
    return reasons
