"""Covariance of what the filter error method has estimated, as for output error."""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.gauss_newton import Minimum
from rotorid_torch.identification.estimate.uncertainty import (
    ColouredErrors,
    FlightRows,
    Uncertainty,
    basis_of,
    fast,
    inverse_triangle,
    jackknife,
    larger_of,
)
from rotorid_torch.identification.filter_error.innovations import FilterEngine, FilterPlace, InnovationLikelihood


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
    plain = torch.zeros(len(identifiable), len(identifiable), dtype=torch.float64)
    if not bool(identifiable.any()):
        return Uncertainty(plain, plain, plain.diagonal(), plain, plain.diagonal())
    inverse, square = inverse_triangle(minimum.linear, identifiable), identifiable[:, None] & identifiable
    plain[square] = loss * (inverse @ inverse.mT).flatten()
    rows, information = _rows(engine, likelihood, place)
    segments = engine.problem.segments

    def flights() -> Iterator[FlightRows]:
        for starts, derivatives, white, present in rows:
            sd = torch.full((starts.shape[-1],), math.inf, dtype=torch.float64)
            basis = basis_of(starts.flatten(0, 1)[None], sd).unflatten(1, present.shape)
            yield FlightRows(derivatives[None], basis, white[None], present[None])

    covariance = ColouredErrors.of(flights, fast(2 * segments.samples), len(rows), inverse, identifiable).covariance()
    gain, coloured = inverse @ inverse.mT, torch.zeros_like(plain)
    coloured[square] = (covariance + gain @ information[identifiable][:, identifiable] @ gain).flatten()
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
        blocks.append(
            tuple(torch.cat([p, p.new_zeros(missing, *p.shape[1:])]) if missing else p.clone() for p in parts)
        )
    return blocks, information
