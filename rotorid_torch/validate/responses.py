"""How well a model explains accelerations at measured states: specific force, angular acceleration, rotor speed.

Where a free run means little, because a vehicle that was flown in closed loop is a chain of integrators, this is what a
model can be judged by: nothing is integrated, so that no error grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.names import RATES
from rotorid_torch.data.flight import Flight
from rotorid_torch.effects.signal_operations import averaged
from rotorid_torch.model.accelerations import Accelerations
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model

SMOOTHED_S = 0.03
"""Length of the centred mean that measurement and model both pass before the rates are differentiated."""


@dataclass(frozen=True)
class Response:
    """One response of a flight: rms of measured minus model in its unit, and R2 = 1 - sum(error^2)/sum(deviation^2).

    constant : mean of measured minus model. r2_without_constant : R2 with that taken out of the error.
    """

    rmse: float
    r2: float
    constant: float
    r2_without_constant: float


def responses(model: Model, flight: Flight, smoothed: float = SMOOTHED_S) -> dict[str, Response]:
    """R2 of each response of a flight that is measured: rates differentiated, accelerometers, rotor speeds."""
    return {name: _judged(*pair) for name, pair in compared(model, flight, smoothed).items()}


def compared(model: Model, flight: Flight, smoothed: float = SMOOTHED_S) -> dict[str, tuple[Tensor, Tensor]]:
    """Each response of a flight that is measured, (T,), and what the model makes of measured states and inputs.

    Measurement and model both pass a centred mean over `smoothed` seconds; then rates are differentiated by central
    differences. Gaps are bridged by straight lines; states that are no channels are taken at the reference.
    """
    x = measured_states(model, flight)
    with torch.no_grad():
        taped = model.tape(flight.bridged(model.body.controls), flight.dt)
        modelled = Accelerations(model)(model.theta, x, taped, flight.dt)
    half = round(smoothed / flight.dt / 2.0)
    pairs = {}
    for name, values in modelled.items():
        channel = RATES[ANGULAR_ACCELERATIONS.index(name)] if name in ANGULAR_ACCELERATIONS else name
        if not flight.has(channel):
            continue
        measured = averaged(flight.bridged([channel])[:, 0], half)
        if channel != name:
            measured = torch.gradient(measured, spacing=flight.dt)[0]
        inner = slice(half + 1, len(measured) - half - 1)
        pairs[name] = measured[inner], averaged(values, half)[inner]
    return pairs


def _judged(measured: Tensor, model: Tensor) -> Response:
    error = measured - model
    spread = (measured - measured.mean()).square().sum()
    explained = [float(1.0 - e.square().sum() / spread) for e in (error, error - error.mean())]
    return Response(float(error.square().mean().sqrt()), explained[0], float(error.mean()), explained[1])


def measured_states(model: Model, flight: Flight) -> Tensor:
    """States [T, nx] by their channels, gaps bridged; at the reference where there is none."""
    columns = []
    for state in model.layout.states:
        channel = state.channel or state.name
        at = torch.full((flight.samples,), model.reference.get(state.name, 0.0), dtype=torch.float64)
        columns.append(flight.bridged([channel])[:, 0] if flight.has(channel) else at)
    return torch.stack(columns, dim=-1)
