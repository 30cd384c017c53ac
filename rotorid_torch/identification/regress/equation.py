"""One equation of a model as data: response, candidate regressors, noise, prior and band; its rows and its fit."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import ceil

import torch
from torch import Tensor

from rotorid_torch.identification.regress.ftr import Regression, solve
from rotorid_torch.identification.regress.noisy_least_squares import noisy_least_squares
from rotorid_torch.identification.regress.rows import Rows, Transform, flight_rows, total_noise

HIGHEST = 8.0
"""Hz: default cap of a band chosen from the data."""
SAMPLES_PER_PERIOD = 5.0
"""No band goes higher than this allows."""
COHERENT = 0.5
"""Multiple coherence below which a response no longer follows its regressors."""
MISSED = 0.2
"""Share of a response at the top of its band that one set of coefficients may miss."""
START = 1.0
"""Hz: upper edge of the smallest band tried."""


@dataclass(frozen=True)
class Equation:
    """A response and its candidate regressors on several flights; a known part is subtracted from the response before.

    name : for people. response : one (T,) per flight. regressors : one (T, n) per flight. names : (n) of regressors.
        Records are read flight by flight and may be made on demand.
    dt : s, of each flight. kind : "derivative" or "value", see `regress`.
    regressor_noise : (n,) standard deviation of a sample. response_noise : the same, or None to estimate it.
    prior : mean and standard deviation (n,) of the coefficients, Gaussian; an infinite deviation is none.
    band : Hz, or None to choose it from the data. highest : cap of that choice, Hz.
    """

    name: str
    response: Collection[Tensor]
    regressors: Collection[Tensor]
    names: tuple[str, ...]
    dt: Sequence[float]
    kind: str
    regressor_noise: Sequence[float]
    response_noise: float | None = None
    prior: tuple[Tensor, Tensor] | None = None
    band: tuple[float, float] | None = None
    highest: float = HIGHEST

    def index(self, names: Sequence[str]) -> list[int]:
        """Columns of the named regressors."""
        return [self.names.index(name) for name in names]


def equation_rows(equation: Equation, band: tuple[float, float], notes: list[str] | None = None) -> list[Rows]:
    """Transform every flight of an equation; see `flight_rows`."""
    transform = Transform(band, equation.kind, equation.regressor_noise, equation.response_noise, trend=False)
    flights = zip(equation.response, equation.regressors, equation.dt, strict=True)
    return [flight_rows(*flight, transform, [] if notes is None else notes) for flight in flights]


def columns_of(rows: Rows, columns: Sequence[int]) -> Rows:
    """Keep the given columns of the regressors."""
    chosen = list(columns)
    return replace(rows, regressors=rows.regressors[..., chosen], noise=rows.noise[..., chosen])


def fit_equation(equation: Equation, columns: Sequence[str] | None = None) -> Regression:
    """Regress an equation on all its regressors or on the named ones, in its band or one chosen from the data.

    Returns Regression whose coefficients are in the order of `.selected`.
    """
    notes: list[str] = []
    band = equation.band or choose_band(equation, notes)
    held = equation.names if columns is None else tuple(columns)
    index, mean_sd = equation.index(held), equation.prior
    prior = None if mean_sd is None else (mean_sd[0][index], mean_sd[1][index])
    flights = [columns_of(f, index) for f in equation_rows(equation, band, notes)]
    result = solve(flights, band, prior=prior, names=equation.names, notes=notes)
    return replace(result, selected=held)


def choose_band(equation: Equation, notes: list[str] | None = None) -> tuple[float, float]:
    """Choose the band of an equation: from 2/T up to where it stops holding.

    The band grows from `START` as long as, in the harmonics just below its upper edge, the response still follows its
    regressors (multiple coherence) and one set of coefficients for the whole band leaves little but noise.
    It ends where either fails twice in a row: by noise, or by dynamics that the equation does not have.

    Returns lowest and highest frequency, Hz; notes says where an equation does not hold even in the smallest band.

    Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, ch. 9 (multiple coherence).
    """
    lowest = 2.0 / max((len(y) - 1) * dt for y, dt in zip(equation.response, equation.dt, strict=True))
    cap = max(min(equation.highest, 1.0 / (SAMPLES_PER_PERIOD * max(equation.dt))), 4.0 * lowest)
    flights = equation_rows(equation, (lowest, cap))
    density = sum(f.information for f in flights) / (cap - lowest)
    start = lowest + 2.0 * (len(equation.names) + 4) / density
    start = min(max(start, START, 4.0 * lowest), cap)
    edge, failures = start, 0
    for centre in max((f.frequencies for f in flights), key=len).tolist():
        if centre < start:
            continue
        coherence, missed = _top_of_band(flights, centre)
        holds = coherence >= COHERENT and missed <= MISSED
        failures = 0 if holds else failures + 1
        edge = centre if holds else edge
        if failures == 2:
            break
    if edge <= start and failures and notes is not None:
        notes.append(f"{equation.name}: does not hold even up to {start:.2g} Hz; smallest band")
    return lowest, edge


def independent_shares(equation: Equation, targets: Sequence[str], others: Sequence[str]) -> dict[str, float]:
    """Share of each target's in-band power, without noise, that other regressors of the equation do not explain.

    (|y - Z g|^2 - (n_y + sum g^2 n_Z) (N - n) / N) / (|y|^2 - n_y), between 0 and 1: g by least squares without the
    noise of Z, n_y and n_Z the powers of noise, n the number of the others, N the independent values of the band.

    Controls against states show how much of a control is not feedback; flapping against what drives it, whether both
    can be held in one equation.
    """
    flights = equation_rows(equation, equation.band or choose_band(equation))
    information = sum(f.information for f in flights)
    explaining = [columns_of(f, equation.index(others)) for f in flights]
    z, noise = torch.cat([f.regressors for f in explaining], dim=-2), total_noise(explaining)
    shares = {}
    for name, column in zip(targets, equation.index(targets), strict=True):
        y = torch.cat([f.regressors[..., column] for f in flights], dim=-1)
        own_noise = sum(f.noise[..., column] for f in flights)
        gains = noisy_least_squares(z, y, noise).coefficients
        chance = (own_noise + (gains.square() * noise).sum()) * (information - len(others)) / information
        excess = (y - z @ gains).square().sum() - chance
        shares[name] = float((excess / (y.square().sum() - own_noise).clamp(min=1e-300)).clamp(0.0, 1.0))
    return shares


def _top_of_band(flights: Sequence[Rows], edge: float) -> tuple[float, float]:
    """Look at the top harmonics of a band that ends at edge.

    Returns the multiple coherence there, corrected for the number of regressors, and the share of the response,
    without noise, that the fit of the whole band misses there.
    """
    z, y = torch.cat([f.regressors for f in flights], dim=-2), torch.cat([f.response for f in flights], dim=-1)
    frequency = torch.cat([f.frequencies.repeat(2) for f in flights])
    response_noise = torch.cat([f.response_noise for f in flights])
    noise = total_noise(flights) / sum(f.information for f in flights)
    longest = max((f.frequencies for f in flights), key=len)
    harmonics = max(4.0, ceil(2.0 * z.shape[-1] / len(flights)))
    inside = frequency <= edge * (1.0 + 1e-9)
    top = inside & (frequency > edge - (harmonics - 0.5) * (longest[1] - longest[0]))
    theta = noisy_least_squares(z[inside], y[inside], noise * inside.sum()).coefficients
    total = y[top].square().sum()
    chance = (response_noise[top] + (noise * theta.square()).sum()).sum()
    missed = ((y[top] - z[top] @ theta).square().sum() - chance) / (total - response_noise[top].sum()).clamp(min=1e-300)
    local = noisy_least_squares(z[top], y[top], torch.zeros_like(noise)).coefficients
    misfit = (y[top] - z[top] @ local).square().sum() / total.clamp(min=1e-300)
    freedom = float(top.sum()) / max(float(top.sum()) - z.shape[-1], 1.0)
    return 1.0 - float(misfit) * freedom, float(missed)
