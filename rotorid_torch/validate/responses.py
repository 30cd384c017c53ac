"""How well a model explains accelerations at measured states: specific force, angular acceleration, rotor speed.

Where a free run means little, because a vehicle that was flown in closed loop is a chain of integrators, this is what a
model can be judged by: nothing is integrated, so that no error grows.
"""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from rotorid_torch.core.names import RATES, SPECIFIC_FORCES
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight, bridged_but_gaps
from rotorid_torch.effects.signal_operations import averaged, but_gaps, half_of
from rotorid_torch.identification.measured_states import centred
from rotorid_torch.identification.rotor_equations import SMOOTHED_S
from rotorid_torch.model.accelerations import Accelerations
from rotorid_torch.model.model import ANGULAR_ACCELERATIONS, Model
from rotorid_torch.validate.judged import Response

CLEAR = 2.0
"""Standard deviation of a response over its noise from which on a flight moves it: a perfect model explains 3/4."""
USUAL = 0.25
"""The same over that of all identify flights."""
BARELY = 0.05
"""Standard deviation of the modelled over that of the measured response, below which the model does not describe it."""


UNITS = dict.fromkeys(ANGULAR_ACCELERATIONS, "rad/s2") | dict.fromkeys(SPECIFIC_FORCES, "m/s2")
"""Of responses; rotor speeds are in rad/s."""


def responses(
    model: Model, flight: Flight, smoothed: float = SMOOTHED_S, least: Mapping[str, float] | None = None
) -> dict[str, Response]:
    """R2 of each response of a flight that is measured: rates differentiated, accelerometers, rotor speeds.

    least : standard deviation by response from which on a flight moves it (`least_motion`); none: all are moved.
    """
    pairs = compared(model, flight, smoothed)
    return {name: _judged(name, pair, (least or {}).get(name, 0.0), flight.dt) for name, pair in pairs.items()}


def least_motion(dataset: Dataset, smoothed: float = SMOOTHED_S) -> dict[str, float]:
    """Standard deviation from which on a flight of a data set moves a response, by response.

    That is `CLEAR` times the noise of the channel behind the same mean and derivative, white noise at the identify
    flights' median interval, and `USUAL` of the identify flights' rms about their means.
    """
    spans, moved = sorted(dataset.facts[name].dt for name in dataset.identify), dict[str, list[Tensor]]()
    dt = spans[len(spans) // 2]
    for flight in (dataset.flights[name] for name in dataset.identify):
        speeds = [c for c in flight.channels if c.startswith("omega")]
        for name in (*ANGULAR_ACCELERATIONS, *SPECIFIC_FORCES, *speeds):
            if flight.has(_channel(name)):
                values = _measured(name, flight, smoothed)
                moved.setdefault(name, []).append(centred(values))
    half = half_of(smoothed, dt)
    noise = {name: dataset.noise(_channel(name)) * _passed(name, half, dt) for name in moved}
    usual = {name: float(torch.cat(parts).square().nanmean().sqrt()) for name, parts in moved.items()}
    return {name: max(CLEAR * noise[name], USUAL * usual[name]) for name in moved}


def _passed(name: str, half: int, dt: float) -> float:
    """Standard deviation of white noise of one behind a mean of 2 half + 1 samples, and a central difference."""
    if name not in ANGULAR_ACCELERATIONS:
        return (2 * half + 1) ** -0.5
    return 1.0 / ((2 * half + 1) * dt) if half else 1.0 / (math.sqrt(2.0) * dt)


def _channel(name: str) -> str:
    return RATES[ANGULAR_ACCELERATIONS.index(name)] if name in ANGULAR_ACCELERATIONS else name


def _inner(record: Tensor, half: int) -> Tensor:
    """A record [T] without the ends that a mean and a derivative do not reach."""
    return record[half + 1 : len(record) - half - 1]


def _measured(name: str, flight: Flight, smoothed: float) -> Tensor:
    """A response of a flight as measured [T'], missing in gaps and where these reach into a mean."""
    half = half_of(smoothed, flight.dt)
    recorded = bridged_but_gaps(flight.stack([_channel(name)]), 2 * half + 1)[:, 0]
    measured = but_gaps(lambda record: averaged(record, half), recorded)
    if name in ANGULAR_ACCELERATIONS:
        measured = torch.gradient(measured, spacing=flight.dt)[0]
    return _inner(measured, half)


def compared(model: Model, flight: Flight, smoothed: float = SMOOTHED_S) -> dict[str, tuple[Tensor, Tensor]]:
    """Each response of a flight that is measured, (T,), and what the model makes of measured states and inputs.

    Measurement and model both pass a centred mean over `smoothed` seconds; then rates are differentiated by central
    differences. In its gaps a response is missing; gaps of states and controls are bridged by straight lines, and
    states that are no channels are taken at the reference.
    """
    x = measured_states(model, flight)
    with torch.no_grad():
        taped = model.tape(flight.bridged(model.body.controls), flight.dt)
        modelled = Accelerations(model)(model.theta, x, taped, flight.dt)
    half = half_of(smoothed, flight.dt)
    return {
        name: (_measured(name, flight, smoothed), _inner(averaged(values, half), half))
        for name, values in modelled.items()
        if flight.has(_channel(name))
    }


def _judged(name: str, pair: tuple[Tensor, Tensor], least: float, dt: float) -> Response:
    present = ~pair[0].isnan()
    measured, model = (record[present] for record in pair)
    error = measured - model
    deviation = measured - measured.mean()
    spread = deviation.square().sum()
    explained = [float(1.0 - e.square().sum() / spread) for e in (error, error - error.mean())]
    moved = float(deviation.square().mean().sqrt()) >= least
    described = bool(model.std() > BARELY * deviation.std())
    return Response(
        rmse=float(error.square().mean().sqrt()),
        r2=explained[0],
        unit=UNITS.get(name, "rad/s"),
        constant=float(error.mean()),
        r2_without_constant=explained[1],
        moved=moved,
        described=described,
        seconds=len(error) * dt,
    )


def measured_states(model: Model, flight: Flight) -> Tensor:
    """States [T, nx] by their channels, gaps bridged; at the reference where there is none."""
    columns = []
    for state in model.layout.states:
        channel = state.channel or state.name
        at = torch.full((flight.samples,), model.reference.get(state.name, 0.0), dtype=torch.float64)
        columns.append(flight.bridged([channel])[:, 0] if flight.has(channel) else at)
    return torch.stack(columns, dim=-1)
