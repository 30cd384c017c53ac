"""What a stage starts from: initial states that fit the first part of each segment, and the noise the records show."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.identification.estimate.likelihood import Likelihood, Place
from rotorid_torch.identification.estimate.residuals import Noise
from rotorid_torch.identification.estimate.segments import Records, Segments

FEWEST = 8
"""Samples that an initial state is fitted to, at least."""
STEPS = 3
"""Gauss-Newton steps for initial states, at most: outputs are nearly linear in these."""


def smallest_noise(records: Records, ranks: Ranks = ALONE) -> Tensor:
    """Where no sensor noise is declared: so little that only a noiseless output feels it (no infinite weights)."""
    flat = records.outputs.flatten(0, 1)
    centred = flat - _mean(flat, ranks)
    return 1e-7 * _mean(centred.square(), ranks).sqrt().nan_to_num(0.0) + 1e-12


def _mean(values: Tensor, ranks: Ranks) -> Tensor:
    """Mean [ny] of the values [N, ny] of all ranks; NaN = missing."""
    return ranks.sum(values.nansum(dim=0)) / ranks.sum((~values.isnan()).sum(dim=0))


def filled(x0: Tensor, records: Records, segments: Segments) -> Tensor:
    """Initial states [S, nx] with what is unknown taken from the flight's first sample, or zero."""
    first = records.states[segments.flight, 0]
    return torch.where(x0.isnan(), first, x0).nan_to_num(0.0)


def fitted_states(problem: Likelihood, theta: Tensor) -> Tensor:
    """Initial states [S, nx] that fit the first part of each segment best, the parameters held.

    Directions that the outputs do not show within that part stay at the guess.
    """
    fewest = FEWEST * int(problem.records.spacing().max())
    samples = min(problem.segments.samples, max(fewest, problem.segments.samples // 4))
    held = Noise("held", problem.noise.least, torch.diag(roughness(problem.records, problem.ranks) ** 2))
    no_prior = torch.full_like(problem.prior_sd, math.inf)
    head = replace(problem, segments=problem.segments.head(samples), noise=held, prior_sd=no_prior)

    def stepped(place: Place) -> Place:
        assert place.locals is not None
        nx = place.x0.shape[-1]
        triangle, right_side = place.locals.segment[:, :, :nx], place.locals.segment[:, :, -1:]
        norms = torch.linalg.vector_norm(triangle, dim=1, keepdim=True).clamp_min(1e-12)
        step = least_squares(triangle / norms, right_side, rcond=1e-3) / norms.mT
        return replace(head, x0=place.x0 + step.squeeze(-1)).evaluate(theta)

    return _descended(head, head.evaluate(theta), stepped).x0


def best_states(problem: Likelihood, theta: Tensor) -> Place:
    """The place with the best initial states, the parameters held."""
    return _descended(problem, problem.evaluate(theta), lambda place: problem.evaluate(theta, place))


def _descended(problem: Likelihood, place: Place, stepped: Callable[[Place], Place]) -> Place:
    """The place after steps from where it has been linearised, as long as its cost falls."""
    for _ in range(STEPS):
        if not math.isfinite(place.cost):
            break
        problem.linearise(place)
        better = stepped(place)
        if not better.cost < place.cost:
            break
        place = better
    return place


def roughness(records: Records, ranks: Ranks = ALONE) -> Tensor:
    """[ny] standard deviation of the outputs' sample-to-sample noise, from second differences."""
    if records.every is None:
        second = torch.diff(records.outputs, n=2, dim=1).flatten(0, 1)
    else:
        second = torch.cat([torch.diff(one, n=2, dim=0) for one in records.measured(records.outputs)])
    noise = (_mean(second.square(), ranks) / 6.0).sqrt().nan_to_num(1.0)
    return noise + smallest_noise(records, ranks)
