"""Predictions over parts of a second: from measured states on, by the model alone, against holding everything.

Source: the protocol of Busetto and others (2026), nanodrone system identification benchmark: from every sample of a
flight so many steps ahead, the mean over the samples of the norm of the error vector.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from rotorid_torch.core.integrate import integral
from rotorid_torch.core.names import ATTITUDES, MOMENTS, POSITIONS, RATES, VELOCITIES
from rotorid_torch.core.rigid import euler_rates, position_rates
from rotorid_torch.data.flight import Flight
from rotorid_torch.model.accelerations import Accelerations
from rotorid_torch.model.model import Model
from rotorid_torch.validate.free_run import Runs
from rotorid_torch.validate.judged import Prediction
from rotorid_torch.validate.responses import measured_states

HORIZONS_S = (0.1, 0.5, 1.0)
"""Lengths of the predictions."""
USUAL_S = 0.5
"""Seconds at a flight's end in which no prediction starts; longer ones end where their flight does."""
STARTS = 800
"""Samples of a flight from which it is predicted, where nobody asks for all."""
WORSE = 1.1
"""Ratio of the error predicted to that of holding from which on a moment is not explained."""
TOGETHER = 200_000
"""Samples that are predicted at once."""
UNITS = {"position": "m", "velocity": "m/s", "attitude": "rad", "rates": "rad/s"}


def predictions(
    model: Model, flight: Flight, run: Runs | None = None, starts: int | None = STARTS
) -> tuple[Prediction, ...]:
    """Errors of position, velocity (earth axes), attitude (angle of the rotation) and rates, where they are measured.

    Initial states are measured samples, none of them in a gap; the effects' own follow the measured motion. Inputs are
    measured throughout.
    Velocity and position need u v w, phi, theta and psi among the channels. `starts` : from how many samples, spread
    over the flight; None: from every one.
    """
    run = run or Runs.of(model)
    longest, usual = (round(seconds / flight.dt) for seconds in (HORIZONS_S[-1], USUAL_S))
    if flight.samples <= usual:
        return ()
    measured = _measured(flight)
    with torch.no_grad():
        taped = model.tape(flight.bridged(model.body.controls), flight.dt)
        states = Accelerations(model).inside(measured_states(model, flight), taped, flight.dt)
        count = flight.samples - usual
        places = torch.arange(0, count, 1 if starts is None else max(1, count // starts))
        channels = [state.channel or state.name for state in model.layout.states]
        places = places[flight.stretches([c for c in channels if flight.has(c)])[places] >= 0]
        errors: dict[tuple[str, float], list[Tensor]] = {}
        for some in places.split(max(1, TOGETHER // longest)):
            _predicted(model, run, Record(flight.dt, states, taped, measured), some, errors)
    means = {about: torch.cat(error).nanmean(0).tolist() for about, error in errors.items() if any(map(len, error))}
    rows = [(q, s, UNITS[q], error, held) for (q, s), (error, held) in means.items()]
    return tuple(Prediction(quantity=q, seconds=s, unit=u, error=error, held=held) for q, s, u, error, held in rows)


def unexplained_moments(model: Model, flights: Iterable[Flight]) -> tuple[str, ...]:
    """Rows of L M N that predict their rate over the first horizon clearly worse than holding it does.

    Errors count without their mean in a flight. Where roll and pitch both fail, so does yaw: the records of commands
    and rates do not belong together then.
    """
    run, sums = Runs.of(model), torch.zeros(2, 3, dtype=torch.float64)
    places = [model.body.outputs.index(name) for name in RATES]
    for flight in flights:
        ahead = round(HORIZONS_S[0] / flight.dt)
        starts = torch.arange(0, flight.samples - ahead, max(1, (flight.samples - ahead) // STARTS))
        stretch = flight.stretches(RATES)
        starts = starts[(stretch[starts] >= 0) & (stretch[starts + ahead] >= 0)]
        if not len(starts):
            continue
        with torch.no_grad():
            taped = model.tape(flight.bridged(model.body.controls), flight.dt)
            states = Accelerations(model).inside(measured_states(model, flight), taped, flight.dt)
            ends = starts[:, None] + torch.arange(ahead + 1)
            predicted = run(states[starts], taped[ends], flight.dt)[1][:, -1, places]
        rates = flight.bridged(RATES)
        truth = rates[starts + ahead]
        sums += torch.stack([(predicted - truth).std(0), (rates[starts] - truth).std(0)])
    worse = (sums[0] > WORSE * sums[1]).tolist()
    return MOMENTS if worse[0] and worse[1] else tuple(row for row, bad in zip(MOMENTS, worse, strict=True) if bad)


class Record(NamedTuple):
    """A flight to predict: sample interval, states and controls as the model takes them, what was measured."""

    dt: float
    states: Tensor
    taped: Tensor
    measured: Mapping[str, Tensor]


def _predicted(
    model: Model, run: Runs, record: Record, places: Tensor, errors: dict[tuple[str, float], list[Tensor]]
) -> None:
    """Append errors of model and of holding [starts, 2] of each quantity after each horizon."""
    dt, states, taped, measured = record
    window = (places[:, None] + torch.arange(round(HORIZONS_S[-1] / dt) + 1)).clamp(max=len(taped) - 1)
    outputs = run(states[places], taped[window], dt)[1]
    path = dict(zip(model.body.outputs, outputs.unbind(-1), strict=True))
    if not set(RATES) <= set(path):
        return
    motion = _motion(path, measured, places, dt)
    for seconds in HORIZONS_S:
        k = round(seconds / dt)
        inside = places + k < len(taped)
        for quantity, values in motion.items():
            truth, starts = measured[quantity], places[inside]
            both = (values[inside, k], truth[starts])
            distances = torch.stack([_distance(quantity, value, truth[starts + k]) for value in both], dim=-1)
            distances[distances.isnan().any(dim=-1)] = torch.nan  # model and holding are judged by the same starts
            errors.setdefault((quantity, seconds), []).append(distances)


def _motion(path: Mapping[str, Tensor], measured: Mapping[str, Tensor], places: Tensor, dt: float) -> dict[str, Tensor]:
    """Predicted quantities [starts, T, 3] that are measured: heading and position integrated from the outputs."""
    stack = lambda names: torch.stack([path[n] for n in names], dim=-1)  # noqa: E731
    rates = stack(RATES)
    moved = {"rates": rates}
    if "attitude" not in measured or not set(ATTITUDES[:2]) <= set(path):
        return moved
    level = stack(ATTITUDES[:2])
    psi = measured["attitude"][places, 2:][:, None] + integral(euler_rates(rates, level)[..., 2:], dt, 1)
    moved["attitude"] = torch.cat([level, psi], dim=-1)
    if "velocity" in measured and set(VELOCITIES) <= set(path):
        moved["velocity"] = position_rates(stack(VELOCITIES), moved["attitude"])
        if "position" in measured:
            moved["position"] = measured["position"][places][:, None] + integral(moved["velocity"], dt, 1)
    return moved


def _distance(quantity: str, value: Tensor, truth: Tensor) -> Tensor:
    """Norm of the difference [n]; of attitudes the angle of the rotation between them."""
    if quantity != "attitude":
        return torch.linalg.vector_norm(value - truth, dim=-1)
    cosine = 0.5 * ((_rotation(value).mT @ _rotation(truth)).diagonal(dim1=-2, dim2=-1).sum(-1) - 1.0)
    return torch.arccos(cosine.clamp(-1.0, 1.0))


def _rotation(attitude: Tensor) -> Tensor:
    """Body to earth axes [n, 3, 3]."""
    axes = torch.eye(3, dtype=attitude.dtype)
    columns = [position_rates(axis.expand(len(attitude), 3), attitude) for axis in axes]
    return torch.stack(columns, dim=-1)


def _measured(flight: Flight) -> dict[str, Tensor]:
    """Quantities (T, 3) that the flight has: rates, attitude, velocity in earth axes, position."""

    def has(names: Sequence[str]) -> bool:
        return flight.has(*names)

    channels = {"rates": flight.stack(RATES)} if has(RATES) else {}
    if has(ATTITUDES):
        channels["attitude"] = flight.stack(ATTITUDES)
        if has(VELOCITIES):
            channels["velocity"] = position_rates(flight.stack(VELOCITIES), channels["attitude"])
            if has(POSITIONS):
                channels["position"] = flight.stack(POSITIONS)
    return channels
