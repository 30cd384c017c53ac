"""What a stage starts from: initial states that fit the first part of each segment, and the noise the records show."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.processes.ranks import ALONE, Ranks
from rotorid_torch.identification.estimate.likelihood import Likelihood
from rotorid_torch.identification.estimate.residuals import Noise
from rotorid_torch.identification.estimate.segments import Records, Segments

FEWEST = 8
"""Samples that an initial state is fitted to, at least."""


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
    ny = problem.records.outputs.shape[-1]
    fewest = FEWEST * int(problem.records.spacing().max())
    samples = min(problem.segments.samples, max(fewest, problem.segments.samples // 4))
    held = Noise("held", problem.noise.floor, torch.diag(roughness(problem.records, problem.ranks) ** 2))
    head = replace(problem, segments=problem.segments.head(samples), noise=held)
    head = replace(
        head, bias_sd=torch.zeros(ny, dtype=torch.float64), prior_sd=torch.full_like(problem.prior_sd, math.inf)
    )
    best = head.evaluate(theta)
    for _ in range(3):
        if not math.isfinite(best.cost):
            break
        head.linearise(best)
        assert best.locals is not None
        nx = best.x0.shape[-1]
        triangle, right_side = best.locals.segment[:, :, :nx], best.locals.segment[:, :, -1:]
        norms = torch.linalg.vector_norm(triangle, dim=1, keepdim=True).clamp_min(1e-12)
        step = least_squares(triangle / norms, right_side, rcond=1e-3) / norms.mT
        trial = replace(head, x0=best.x0 + step.squeeze(-1)).evaluate(theta)
        if not trial.cost < best.cost:
            break
        best = trial
    return best.x0


def roughness(records: Records, ranks: Ranks = ALONE) -> Tensor:
    """[ny] standard deviation of the outputs' sample-to-sample noise, from second differences."""
    if records.every is None:
        second = torch.diff(records.outputs, n=2, dim=1).flatten(0, 1)
    else:
        second = torch.cat([torch.diff(one, n=2, dim=0) for one in records.measured(records.outputs)])
    noise = (_mean(second.square(), ranks) / 6.0).sqrt().nan_to_num(1.0)
    return noise + smallest_noise(records, ranks)
