"""How a model that was fitted over segments flies whole flights: one run each, from the initial state found."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.identification.estimate.progressive_fit import Fit
from rotorid_torch.identification.estimate.segments import Records, cut

WORSE = 1.5
"""Residuals of whole flights over those of the segments, above which it is said."""


@dataclass(frozen=True, repr=False)
class WholeFlights:
    """Free runs over whole flights.

    residuals : per flight (T, ny) measured minus model, NaN = missing. rms : [ny] their root mean square, infinite
    where a run diverges. ratio : [ny] over that of the segments that the fit took.
    """

    residuals: list[Tensor]
    rms: Tensor
    ratio: Tensor

    def __repr__(self) -> str:
        each = ", ".join(f"{rms:.4g}" for rms in self.rms.tolist())
        return f"WholeFlights: {len(self.residuals)} flights, residuals of {each} (rms by output)"

    @property
    def remark(self) -> str:
        """What to say where whole flights leave much more than the segments; else nothing."""
        worst = float(self.ratio.nan_to_num(0.0).max())
        if worst < WORSE:
            return ""
        much = "diverge" if math.isinf(worst) else f"leave up to {worst:.2g} times the residuals"
        return f"flown free from the first sample, whole flights {much}"


def whole_flights(records: Records, fitted: Fit) -> WholeFlights:
    """Free runs of the fitted model from the initial states that the fit found."""
    problem, place = fitted.likelihood, fitted.minimum.point
    segments = cut(records, records.samples)
    x0 = place.x0[(problem.segments.place[:, 0] == 0).nonzero()[:, 0]]
    near = x0[:, None].expand(-1, segments.samples, -1)
    run = problem.engine.run(place.theta, records, segments, x0, near, None)
    residuals = records.measured(segments.outputs - run.outputs)
    rms = _rms(residuals, [~one.isnan() for one in records.measured(records.outputs)])
    assert place.moments is not None
    return WholeFlights(residuals, rms, rms / place.moments.mean_square.sqrt().clamp_min(1e-300))


def _rms(residuals: list[Tensor], present: list[Tensor]) -> Tensor:
    """Root mean square [ny] where something was measured; infinite where a run has none that is finite there."""
    flat, measured = torch.cat(residuals), torch.cat(present)
    squares = torch.where(measured, flat.nan_to_num(math.inf).square(), 0.0)
    return (squares.sum(dim=0) / measured.sum(dim=0)).sqrt()
