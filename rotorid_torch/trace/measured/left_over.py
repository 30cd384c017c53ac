"""What a multirotor's model leaves of the accelerations at measured states, and the motion that this may go with."""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from rotorid_torch.core.names import FORCES, MOMENTS, SPECIFIC_FORCES, VELOCITIES
from rotorid_torch.effects.signal_operations import smoothed
from rotorid_torch.identification.measured_states import MeasuredStates
from rotorid_torch.identification.rotor_equations import LinearRows, Seen
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS
from rotorid_torch.trace.evidence.residual import SMOOTH_S, LeftOver
from rotorid_torch.trace.evidence.unattributed import Residuals
from rotorid_torch.trace.measured.fitted import FittedAtStates

EQUATIONS = dict(zip((*SPECIFIC_FORCES, *ANGULAR_ACCELERATIONS), (*FORCES, *MOMENTS), strict=True))
"""By the acceleration that shows each."""


def residuals_at_states(fitted: FittedAtStates) -> Residuals | None:
    """What a model leaves over; None where it explains no acceleration that all flights have measured."""
    dataset = fitted.flights.dataset
    listed = [names for names in (dataset.identify, dataset.validate) if names]
    sides = [fitted.states(names) for names in listed]
    left_alone = {ANGULAR_ACCELERATIONS[MOMENTS.index(row)] for row in fitted.silent}
    if not fitted.model.layout.has(*VELOCITIES):  # what air does across the rotors is not to be seen
        left_alone |= {*SPECIFIC_FORCES[:2]}
    rows = [r for r in EQUATIONS if r not in left_alone and all(r in one for side in sides for one in side.measured)]
    pairs = zip(sides, listed, strict=True)
    return Residuals(*(_left_over(fitted, *pair, rows) for pair in pairs)) if rows else None


def _left_over(fitted: FittedAtStates, states: MeasuredStates, listed: Sequence[str], rows: Sequence[str]) -> LeftOver:
    """Of the listed flights, two samples to a width of the smoothing; parameters and lines of flights are taken up.

    A step halfway has half its rms beyond a line.
    """
    model, flights = fitted.model, states.equations.flights
    linear = states.equations.linear(model.theta.detach().clone(), fitted.names)
    parts = [_thinned(*one, rows) for one in zip(flights, states.measured, linear, strict=True)]
    residual, changes = (torch.cat(part) for part in zip(*parts, strict=True))
    step = flights[0].step * _every(flights[0])
    times = [step * torch.arange(len(one), dtype=torch.float64) for one, _ in parts]
    lines = [torch.stack([torch.ones_like(t), t - t.mean()], dim=-1) for t in times]
    names = (*model.body.states, *model.body.controls)
    usual = residual.new_tensor([model.reference.get(name, 0.0) for name in names])
    states_of_body = len(model.body.states)
    motions = [torch.cat([one.states[:, :states_of_body], one.means(one.controls)], dim=-1) for one in flights]
    records = [_thin(motion - usual, one) for motion, one in zip(motions, flights, strict=True)]
    flight = torch.repeat_interleave(torch.tensor([len(t) for t in times]))
    return LeftOver(
        tuple(EQUATIONS[row] for row in rows),
        residual,
        names,
        torch.cat(records),
        torch.cat(times),
        torch.block_diag(*lines),
        residual[:, :0],
        flight,
        changes,
        None if model.body.inertia is None else model.inertia.diagonal(),
        derivatives=False,
        levels=0.5 * residual.new_tensor([states.spreads[row] for row in rows]),
        flights=tuple(listed),
    )


def _thinned(
    flight: Seen, measured: Mapping[str, Tensor], linear: LinearRows, rows: Sequence[str]
) -> tuple[Tensor, Tensor]:
    """Residual [T', rows] of a flight, and its changes by the parameters [T', rows, P]."""
    values, slopes = linear.of(rows)
    left = (torch.stack([measured[row] for row in rows]) - values).mT
    changes = slopes.permute(2, 1, 0).masked_fill(left.isnan()[..., None], 0.0)
    return _thin(left.nan_to_num(0.0), flight), _thin(changes.flatten(1), flight).unflatten(1, changes.shape[1:])


def _thin(record: Tensor, flight: Seen) -> Tensor:
    return smoothed(record, max(1, round(SMOOTH_S / flight.step)))[:: _every(flight)]


def _every(flight: Seen) -> int:
    return max(1, round(0.5 * SMOOTH_S / flight.step))
