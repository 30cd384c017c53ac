"""Which method step 3 takes: output error in calm air, filter error where its residuals show that the air moves."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from rotorid_torch.core.names import VELOCITIES
from rotorid_torch.identification.estimate.likelihood import Likelihood, Part, Place

METHODS = ("auto", "output-error", "filter-error")
NAMES = {"output-error": "output error", "filter-error": "the filter error method"}
"""The methods in words."""
GUSTY = 0.5
"""Correlation of successive residuals of a velocity over the first stage's segments, above which the air moves.

Velocities sum up what acts: gusts wander there, where sensors' noise is white. Clean aircraft in calm air show 0.25 at
most, whatever their models lack; in turbulence of 0.25 m/s 0.67, of 0.5 m/s 0.84, of 1 m/s 0.91 and more.
"""


def velocities_colour(outputs: Sequence[str], problem: Likelihood, place: Place) -> float:
    """Largest correlation of successive residuals of the velocities among the outputs; zero where none is measured.

    sum e(t) e(t+1) / sqrt(sum e(t)^2 sum e(t+1)^2), over pairs of samples of all segments that were both measured.

    Source: Box, Jenkins and Reinsel, Time Series Analysis, 4th ed., sec. 2.1.5.
    """
    which = [outputs.index(n) for n in VELOCITIES if n in outputs]
    if not which or problem.segments.samples < 2:
        return 0.0

    def pairs(part: Part) -> Tensor:
        residual = part.residual.detach().masked_fill(~part.valid, math.nan)[..., which]
        both = torch.cat([residual[:, 1:], residual[:, :-1]], dim=-1)
        missing = (residual[:, 1:].isnan() | residual[:, :-1].isnan()).repeat(1, 1, 2)
        return both.masked_fill(missing, math.nan)

    sums, n = problem.moments(place, pairs).products, len(which)
    power = (sums.diagonal()[:n] * sums.diagonal()[n:]).sqrt().clamp_min(1e-300)
    return float((sums[:n, n:].diagonal() / power).max())


def sentence(asked: str, chosen: str, colour: float, why_not: str) -> str:
    """How the method of step 3 was chosen.

    asked : one of `METHODS`. colour : as `velocities_colour`. why_not : why the filter error method cannot be taken.
    """
    by = f"fitted by {NAMES[chosen]}"
    if asked != "auto":
        return f"{by}, as asked for"
    if why_not:
        return f"{by}: {why_not}"
    colours = f"successive residuals of the velocities by output error correlate by up to {colour:.2f}"
    air = "the air moves" if chosen == "filter-error" else "the air is calm"
    return f"{by}: {air}, for {colours} ({GUSTY:g} or less in calm air)"
