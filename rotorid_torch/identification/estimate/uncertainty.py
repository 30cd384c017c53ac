"""Covariance of estimated parameters: Cramer-Rao, corrected for coloured residuals, and the jackknife over flights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Linear
from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.native.side_by_side import side_by_side
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.core.statistics import jackknife_variance
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place

SMOOTHING = 20
"""Spectral lines to each side over which the residuals' spectrum of one segment is averaged; fewer of more segments."""
LEAST_SMOOTHING = 3
LEAST_LEFT = 0.1
"""Share of a line that the fit is never believed to have left below."""
MOST_COLOUR = 0.99
"""Correlation of successive residuals taken out before averaging, at most."""
KEPT_NUMBERS = 16_000_000
"""Of the flights' rows that stay in memory from the residuals' spectrum to the covariance; more are made again."""
STUDENT = (1.96**2 + 1.0) / 4.0
"""Student's 95 % quantile is that of the normal distribution times 1 + this over the degrees of freedom.

The first term of its expansion, t = z + (z^3 + z)/(4 nu), z = 1.96.
Source: Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.5.
"""
CHANCE = 2.326  # normal quantile of 99 %
"""The jackknife counts where it exceeds the other estimate by more than this quantile of its own scatter."""


@dataclass(frozen=True)
class Uncertainty:
    """Covariances [P, P] of the estimate, zero for what was held; standard errors [P] are the larger of two kinds."""

    cramer_rao: Tensor
    coloured: Tensor
    jackknife: Tensor  # variances [P], NaN with fewer than three flights
    covariance: Tensor
    standard_errors: Tensor

    @classmethod
    def none(cls, identifiable: Tensor) -> Uncertainty:
        """Where nothing was estimated of so many parameters."""
        nothing = torch.zeros(len(identifiable), len(identifiable), dtype=torch.float64)
        return cls(nothing, nothing, nothing.diagonal(), nothing, nothing.diagonal())

    def without(self, held: Tensor) -> Uncertainty:
        """NaN for parameters that were not told [P]: on a bound, or not identifiable."""
        pairs = held[:, None] | held
        covariances = (part.masked_fill(pairs, torch.nan) for part in (self.cramer_rao, self.coloured, self.covariance))
        cramer_rao, coloured, covariance = covariances
        variances, errors = (part.masked_fill(held, torch.nan) for part in (self.jackknife, self.standard_errors))
        return Uncertainty(cramer_rao, coloured, variances, covariance, errors)


def among_all(covariance: Tensor, identifiable: Tensor) -> Tensor:
    """A covariance of the parameters in a mask [P] as one of all [P, P], zero of the others."""
    whole = covariance.new_zeros(len(identifiable), len(identifiable))
    whole[identifiable[:, None] & identifiable] = covariance.flatten()
    return whole


def covariances(likelihood: Likelihood, place: Place, linear: Linear, identifiable: Tensor, loss: float) -> Uncertainty:
    """Covariance of the estimate at its optimum.

    The noise is taken as coloured (its spectrum that of the residuals), as in Morelli and Klein; leaving one flight out
    in turn judges it without any assumption on the noise within a flight, but with few flights it scatters by
    sqrt(1/(2 (F - 1))): it replaces the other estimate only where it is larger by more than chance.

    linear : linear model at the place, as `Likelihood.linearise` gives it.
    identifiable : [P] mask of the parameters estimated (not held, not on a bound, identifiable).
    loss : samples over samples minus estimated numbers, by which residuals are too small.

    Source: Morelli and Klein, Aircraft System Identification (2nd ed.), sec. 6.3.2 (coloured residuals);
    Efron and Stein (1981), Ann. Statist. 9 (jackknife).
    """
    if not bool(identifiable.any()):
        return Uncertainty.none(identifiable)
    inverse = inverse_triangle(linear, identifiable)
    plain = among_all(loss * (inverse @ inverse.mT), identifiable)
    coloured = among_all(colour_of(likelihood, place, inverse, identifiable).covariance(), identifiable)
    variances = jackknife(place.blocks, likelihood.prior_rows(place), identifiable, likelihood.ranks)
    return larger_of(plain, coloured, variances, len(place.blocks))


def errors_of(likelihood: Likelihood, place: Place, linear: Linear, identifiable: Tensor, asked: Tensor) -> Tensor:
    """Standard errors [n] of the parameters in the mask `asked` [P], as `covariances` has them, without all others.

    Infinite where a parameter is not estimated.
    """
    errors, which = torch.full(identifiable.shape, torch.inf, dtype=torch.float64), identifiable & asked
    if bool(which.any()):
        colour = colour_of(likelihood, place, inverse_triangle(linear, identifiable), identifiable)
        coloured = colour.covariance(asked[identifiable])
        variances = jackknife(place.blocks, likelihood.prior_rows(place), identifiable, likelihood.ranks)
        errors[which] = larger_of(coloured, coloured, variances[which], len(place.blocks)).standard_errors
    return errors[asked]


def colour_of(likelihood: Likelihood, place: Place, inverse: Tensor, identifiable: Tensor) -> ColouredErrors:
    """The residuals' colour at a place; inverse and identifiable as `ColouredErrors` has them."""
    lines = lines_of(-(-likelihood.longest // _apart(likelihood)))
    flights, width = partial(_flights, likelihood, place), likelihood.locals_per_segment + len(identifiable)
    if likelihood.segments.outputs.numel() * width <= KEPT_NUMBERS:
        rows = tuple(flights())
        flights = lambda: rows  # noqa: E731
    return ColouredErrors.of(flights, lines, likelihood.pieces, inverse, identifiable, likelihood.ranks)


def larger_of(plain: Tensor, coloured: Tensor, variances: Tensor, flights: int) -> Uncertainty:
    """The coloured covariance [P, P], stretched where the jackknife says more by more than chance.

    C_ij s_i s_j, s_i the root of jackknife over coloured variance where that ratio is beyond its 99 % quantile, else 1.
    """
    larger = variances > _chance(flights - 1) * coloured.diagonal()
    stretch = torch.where(larger, (variances / coloured.diagonal()).sqrt(), 1.0)
    covariance = coloured * stretch * stretch[:, None]
    return Uncertainty(plain, coloured, variances, covariance, covariance.diagonal().sqrt())


def _chance(freedom: int) -> float:
    """Variance over true variance that only one jackknife in a hundred exceeds (Wilson and Hilferty 1931)."""
    if freedom < 2:
        return torch.inf
    return (1.0 - 2.0 / (9.0 * freedom) + CHANCE * (2.0 / (9.0 * freedom)) ** 0.5) ** 3


def inverse_triangle(linear: Linear, identifiable: Tensor) -> Tensor:
    """Inverse of the triangle of A's told columns: covariance is this times its transpose."""
    A = linear[0][:, identifiable]
    norms = torch.linalg.vector_norm(A, dim=0)
    triangle = torch.linalg.qr(A / norms, mode="r").R
    eye = torch.eye(len(norms), dtype=A.dtype, device=A.device)
    return torch.linalg.solve_triangular(triangle, eye, upper=True) / norms[:, None]


@dataclass(frozen=True)
class FlightRows:
    """Whitened rows of one flight's segments: derivatives freed of initial states, their basis, residual."""

    derivatives: Tensor  # [s, T, ny, P]
    basis: Tensor  # [s, T, ny, local] orthonormal columns that initial states take out
    residual: Tensor  # [s, T, ny]
    valid: Tensor  # [s, T, ny]


Flights = Callable[[], Iterable[FlightRows]]
"""Flights one after the other."""


@dataclass(frozen=True, eq=False)
class ColouredErrors:
    """How residuals are coloured, and what they so make of the estimate of the told parameters.

    root : [lines, 2 ny, 2 ny] factors of the residuals' spectrum S, real above imaginary parts, each with the weight of
    its line. lines : of the Fourier transforms. pieces : segments of all ranks. inverse : [n, n] times its transpose is
    the covariance for white residuals. identifiable : [P] mask of the told parameters.

    In the frequency domain the covariance is the sum over lines of K^H S K, K the transform of how each sample moves
    the estimate; sources at `covariances`.
    """

    flights: Flights
    root: Tensor
    lines: int
    pieces: int
    inverse: Tensor
    identifiable: Tensor
    ranks: Ranks

    @classmethod
    def of(
        cls, flights: Flights, lines: int, pieces: int, inverse: Tensor, identifiable: Tensor, ranks: Ranks = ALONE
    ) -> ColouredErrors:
        """From the residuals' spectrum.

        The fit has taken its share out of the residuals, most where the derivatives have their power: each line is
        divided by the share left to it (one minus its leverage; MacKinnon and White, J. Econometrics 29, 1985).
        """
        power, left = _powers(flights(), _directions(inverse, identifiable), lines)
        power = torch.view_as_complex(ranks.sum(torch.view_as_real(power)))
        spectrum = _spectrum(power, ranks.sum(left), lines, _reach(pieces))
        weights = torch.full((lines // 2 + 1,), 2.0 / lines, dtype=torch.float64)
        weights[0] = weights[-1] = 1.0 / lines
        value, vector = torch.linalg.eigh(spectrum)
        root = _real((vector * (value.clamp_min(0.0) * weights[:, None]).sqrt()[:, None, :]).mH)
        return cls(flights, root, lines, pieces, inverse, identifiable, ranks)

    def covariance(self, asked: Tensor | None = None) -> Tensor:
        """Covariance [m, m] of the told parameters, or of those of them in the mask `asked` [n].

        The spectrum rests on few lines and scatters; the covariance is widened so that 1.96 standard errors hold 95 %
        as Student's t would.
        """
        gain = self.inverse @ self.inverse.mT
        gain = gain if asked is None else gain[:, asked]
        covariance, share = gain.new_zeros(gain.shape[1], gain.shape[1]), gain.new_zeros(1)
        directions = _directions(gain, self.identifiable)
        for moved in side_by_side(partial(self._moved, directions), self.flights()):  # all need not fit the memory
            covariance, share = covariance + moved[0], share + moved[1]
        covariance, share = self.ranks.sum(covariance), self.ranks.sum(share)
        freedom = self.pieces / _smoothed(share / share.sum(dim=0), _reach(self.pieces)).square().sum(dim=0)
        widened = 1.0 + STUDENT / freedom
        return covariance * widened * widened[:, None]

    def _moved(self, directions: Tensor, flight: FlightRows) -> tuple[Tensor, Tensor]:
        """A flight's part of the covariance along directions [P, m], [m, m], and its part by line [lines, m]."""
        width = directions.shape[1]
        covariance, share = directions.new_zeros(width, width), directions.new_zeros(len(self.root), width)
        for piece in flight.derivatives @ directions:
            transform = torch.fft.rfft(piece, n=self.lines, dim=0)
            moves = torch.bmm(self.root, torch.cat([transform.real, transform.imag], dim=1))  # in units of the noise
            flat = moves.flatten(0, 1)
            covariance.addmm_(flat.mT, flat)
            share += moves.square_().sum(dim=1)
        return covariance, share


def _reach(pieces: int) -> int:
    """Lines to each side over which the spectrum is averaged."""
    return max(LEAST_SMOOTHING, round(SMOOTHING / pieces))


def _directions(columns: Tensor, identifiable: Tensor) -> Tensor:
    """Columns [n, m] of the told parameters as directions [P, m] of all."""
    directions = columns.new_zeros(len(identifiable), columns.shape[1])
    directions[identifiable] = columns
    return directions


def lines_of(samples: int) -> int:
    """Lines of a spectrum of records of so many samples: twice as many or more, even, and transformed fast."""
    from scipy.fft import next_fast_len  # slow to import

    half = next_fast_len(samples, real=True)
    assert half is not None
    return 2 * half


def _real(matrices: Tensor) -> Tensor:
    """Complex matrices [..., m, n] as real ones [..., 2 m, 2 n], real above imaginary parts: products cost half."""
    real, imag = matrices.real, matrices.imag
    return torch.cat([torch.cat([real, -imag], dim=-1), torch.cat([imag, real], dim=-1)], dim=-2)


def _powers(flights: Iterable[FlightRows], directions: Tensor, lines: int) -> tuple[Tensor, Tensor]:
    """Products [lines, ny, ny] of the residuals' transforms, and the share left of each line and output [lines, ny].

    directions : [P, n] of the parameters, of unit variance; with the basis they span what the fit has taken.
    """
    power, left = torch.zeros((), dtype=torch.complex128), torch.zeros((), dtype=torch.float64)
    for products, samples, taken in side_by_side(partial(_power, directions, lines), flights):
        power, left = power + products, left + samples
        for part in taken:
            left = left - part
    return power, left


def _power(directions: Tensor, lines: int, flight: FlightRows) -> tuple[Tensor, Tensor, list[Tensor]]:
    """A flight's products [lines, ny, ny], its samples [ny], and what the fit has taken of each segment [lines, ny]."""
    residual, parts = torch.fft.rfft(flight.residual, n=lines, dim=1), []
    for part in torch.cat([flight.basis, flight.derivatives @ directions], dim=-1):  # the basis may be empty
        taken = torch.fft.rfft(part.movedim(0, -1), n=lines)  # [ny, n, lines]
        parts.append((taken.real.square() + taken.imag.square()).sum(1).mT)
    return torch.einsum("slc,sld->lcd", residual, residual.conj()), flight.valid.sum(dim=(0, 1)), parts


def _spectrum(power: Tensor, left: Tensor, lines: int, reach: int) -> Tensor:
    """Spectrum [lines, ny, ny] of the whitened noise: one where it is white."""
    filters = _prewhitening(_per_line(_smoothed(power, LEAST_SMOOTHING), _smoothed(left, LEAST_SMOOTHING)), lines)
    flat = filters[:, :, None] * power * filters[:, None, :].conj()
    flat = _per_line(_smoothed(flat, reach), _smoothed(left, reach))
    return flat / filters[:, :, None] / filters[:, None, :].conj()


def _prewhitening(spectrum: Tensor, lines: int) -> Tensor:
    """Transfer functions [lines, ny] of first-order filters that take most of the colour out of each output.

    Averaging over lines is harmless where the spectrum is flat, not where it is steep.

    Source: Andrews and Monahan (1992), Econometrica 60.
    """
    turn = torch.exp(-2j * torch.pi * torch.arange(len(spectrum), dtype=torch.float64) / lines)[:, None]
    density = spectrum.diagonal(dim1=-2, dim2=-1).real
    weights = torch.full((len(spectrum), 1), 2.0, dtype=torch.float64)
    weights[0] = weights[-1] = 1.0
    lag = (weights * density * turn.real).sum(0) / (weights * density).sum(0).clamp_min(1e-300)
    return 1.0 - lag.clamp(-MOST_COLOUR, MOST_COLOUR) * turn


def _per_line(power: Tensor, left: Tensor) -> Tensor:
    root = torch.maximum(left, LEAST_LEFT * left.amax(dim=0)).clamp_min(1e-9).sqrt()
    return power / root[:, :, None] / root[:, None, :]


def _smoothed(lines: Tensor, m: int) -> Tensor:
    """Averaged over m lines to each side; the spectrum goes on beyond its ends as its own mirror image."""
    m, n = min(m, len(lines) - 1), len(lines)
    wide = torch.cat([lines[1 : m + 1].flip(0).conj(), lines, lines[n - m - 1 : n - 1].flip(0).conj()])
    return torch.stack([wide[k : k + n] for k in range(2 * m + 1)]).mean(dim=0)


def _apart(likelihood: Likelihood) -> int:
    """Steps that all measured samples are multiples of."""
    return math.gcd(*likelihood.records.spacing().tolist())


def _flights(likelihood: Likelihood, place: Place) -> Iterator[FlightRows]:
    """Each flight with its derivatives."""
    nx, apart = likelihood.locals_per_segment, _apart(likelihood)
    for part, whitener, rows in likelihood.by_flight(place):
        sd = rows.new_zeros(len(part.which), 0) if likelihood.x0_sd is None else likelihood.x0_sd[part.which]
        basis = basis_of(rows[..., :nx], sd)
        freed = torch.baddbmm(rows[..., nx:-1], basis, basis.mT @ rows[..., nx:-1], alpha=-1.0)
        shape = part.residual.shape
        white = whitener.apply(part.residual.unsqueeze(-1)).squeeze(-1)
        whole = freed.unflatten(1, shape[1:]), basis.contiguous().unflatten(1, shape[1:]), white, part.valid
        yield FlightRows(*(one[:, ::apart] for one in whole))  # in between nothing is measured


def basis_of(columns: Tensor, prior_sd: Tensor) -> Tensor:
    """The part of the columns [..., m, n] that an estimate with this prior takes out of the rows."""
    norms = torch.linalg.vector_norm(columns, dim=-2, keepdim=True).clamp_min(1e-12)
    stack = torch.cat([columns / norms, torch.diag_embed(1.0 / prior_sd) / norms], dim=-2)
    return torch.linalg.qr(stack).Q[..., : columns.shape[-2], :]


def jackknife(
    flights: Sequence[tuple[Tensor, Tensor]], prior: tuple[Tensor, Tensor], identifiable: Tensor, ranks: Ranks = ALONE
) -> Tensor:
    """Variances [P] by leaving out one flight in turn, one Gauss-Newton step each; NaN below three flights.

    The step without flight f is (A'A - A_f'A_f)^-1 (A'b - A_f'b_f), in units of the parameters; their scatter is that
    of `jackknife_variance`.

    flights : rows [m, P] and right sides [m] of each. prior : the same of the prior. identifiable : [P].
    """
    variances = torch.full(identifiable.shape, torch.nan, dtype=torch.float64)
    count = len(flights)
    if count < 3:
        return variances
    steps = torch.zeros(count, int(identifiable.sum()), dtype=torch.float64)
    for left_out in ranks.mine(range(count)):
        others = [flights[f] for f in range(count) if f != left_out] + [prior]
        A, b = torch.cat([a for a, _ in others])[:, identifiable], torch.cat([c for _, c in others])
        norms = torch.linalg.vector_norm(A, dim=0).clamp_min(1e-12)
        steps[left_out] = least_squares(A / norms, b.unsqueeze(-1))[:, 0] / norms
    moved = ranks.sum(steps)
    variances[identifiable] = jackknife_variance(moved)
    return variances
