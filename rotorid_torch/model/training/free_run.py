"""Free runs of a model from places in flights, side by side and with gradients."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from rotorid_torch import arguments
from rotorid_torch.arguments import Argument
from rotorid_torch.data.flight import Flight
from rotorid_torch.errors import InputError
from rotorid_torch.model.training.equilibrium import Flown, at_rest

FIRST = 0.25
"""s of measurement that the initial state is taken from."""


class Trained(Flown, Protocol):
    """What is asked of a model beyond its rates."""

    def tape(self, controls: Tensor, dt: float) -> Tensor:
        """Controls as they reach the rotor."""
        ...

    def recorded(self, outputs: Tensor, dt: float) -> Tensor:
        """Outputs as the sensors record them."""
        ...

    def trajectories(self, x0: Tensor, controls: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """States and outputs."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class FreeRun:
    """Free runs, all tensors with the leading dimensions of the starts; gradients flow through states and outputs.

    time : [T] s from the start. states : [..., T, nx]. outputs, measured : [..., T, ny], NaN where nothing was
    measured. `run["q"]` is an output or a state by its name, [..., T].
    """

    time: Tensor
    states: Tensor
    outputs: Tensor
    measured: Tensor
    names: tuple[tuple[str, ...], tuple[str, ...]]

    def __repr__(self) -> str:
        states, outputs = self.names
        lead = f"{tuple(self.outputs.shape[:-2])} starts, " if self.outputs.dim() > 2 else ""
        seconds = f"{len(self.time)} samples over {float(self.time[-1]):.4g} s"
        return f"FreeRun: {lead}{seconds}; outputs {arguments.listed(outputs)}; states {arguments.listed(states)}"

    def __getitem__(self, name: str) -> Tensor:
        """An output, or a state, by its name [..., T]; KeyError names those that exist."""
        states, outputs = self.names
        if name in outputs:
            return self.outputs[..., outputs.index(name)]
        if name not in states:
            raise KeyError(f"the run has no '{name}', but {', '.join(dict.fromkeys((*outputs, *states)))}")
        return self.states[..., states.index(name)]

    @property
    def residual(self) -> Tensor:
        """Measured minus output [..., T, ny], zero where nothing was measured."""
        present = ~self.measured.isnan()
        return torch.where(present, self.measured.nan_to_num(0.0) - self.outputs, 0.0)


Flights = Flight | Sequence[Flight]
Starts = float | Sequence[float] | Tensor


def free_run(model: Trained, flights: Flights, starts: Starts, seconds: float, x0: Tensor | None) -> FreeRun:
    """See `Model.free_run`."""
    arguments.refuse_half(Argument("free_run", "model"), model.theta)
    starts = arguments.numbers(Argument("free_run", "start"), starts)
    seconds = arguments.number(Argument("free_run", "seconds"), seconds, "s", above=0.0)
    single = isinstance(flights, Flight) and starts.dim() == 0
    pieces = _places(flights, starts, seconds)
    dt, samples = pieces[0][0].dt, round(seconds / pieces[0][0].dt) + 1
    controls = _taken(pieces, samples, lambda flight: model.tape(_controls(model, flight), dt))
    measured = _taken(pieces, samples, lambda flight: flight.stack(model.body.outputs).to(model.theta))
    start = _measured_start(model, pieces) if x0 is None else _given_start(x0, len(pieces))
    start = _completed(model, start.expand(len(pieces), -1), controls[:, 0], pieces)
    states, outputs = model.trajectories(start, controls, dt)
    outputs = model.recorded(outputs, dt)
    time = dt * torch.arange(samples, dtype=torch.float64)
    names = model.layout.names, tuple(model.body.outputs)
    if single:
        states, outputs, measured = states[0], outputs[0], measured[0]
    return FreeRun(time, states, outputs, measured, names)


def _given_start(x0: Any, runs: int) -> Tensor:
    """Initial states [1 or runs, n] as the caller hands them in; a tensor keeps its gradients."""
    argument = Argument("free_run", "x0")
    checked = arguments.numbers(argument, x0)
    if checked.dim() not in (1, 2) or (checked.dim() == 2 and len(checked) not in (1, runs)):
        raise argument.wrong(f"has shape {tuple(checked.shape)}", f"(n,), or ({runs}, n) for {runs} starts")
    start = x0 if isinstance(x0, Tensor) else checked
    return start.unsqueeze(0) if start.dim() == 1 else start


def _places(flights: Flights, starts: Tensor, seconds: float) -> list[tuple[Flight, int]]:
    """Flight and first sample of each run."""
    argument, first = Argument("free_run", "flight"), starts.reshape(-1).tolist()
    expected = 'a Flight, as data["NAME"], or a list of them'
    listed = [flights] * len(first) if isinstance(flights, Flight) else arguments.sequence(argument, flights, expected)
    for flight in listed:
        arguments.instance(argument, flight, Flight, expected)
    if len(listed) != len(first) or not first:
        raise InputError("free_run", "start", f"{len(first)} starts for {len(listed)} flights", "one start per flight")
    pieces, dt = [], listed[0].dt
    for flight, start in zip(listed, first, strict=True):
        if abs(flight.dt - dt) > 1e-9 * dt:
            wrong = f"sample interval {flight.dt:.6g} s"
            raise InputError(f"flight {flight.name}", "time", wrong, f"{dt:.6g} s as in {listed[0].name}")
        last = (flight.samples - 1) * dt
        if not 0.5 * dt < seconds <= last + 0.5 * dt:
            raise InputError(f"flight {flight.name}", "seconds", f"is {seconds:g}", f"{dt:.4g} to {last:.4g} s")
        if not -0.5 * dt <= start <= last - seconds + 0.5 * dt:
            wrong = f"{start:g} s, {seconds:g} s on, leaves the flight"
            raise InputError(f"flight {flight.name}", "start", wrong, f"0 to {last - seconds:.4g} s")
        pieces.append((flight, round(start / dt)))
    return pieces


def _controls(model: Trained, flight: Flight) -> Tensor:
    """Recorded controls [T, nu] of a flight, missing samples bridged."""
    for name in model.body.controls:
        if not flight.has(name):
            raise InputError(f"flight {flight.name}", name, "control is missing", "the controls of the model")
    return flight.bridged(model.body.controls).to(model.theta)


def _taken(pieces: Sequence[tuple[Flight, int]], samples: int, of: Callable[[Flight], Tensor]) -> Tensor:
    """Pieces [W, samples, n] of what is made once of each flight."""
    whole: dict[int, Tensor] = {}
    parts = []
    for flight, first in pieces:
        if id(flight) not in whole:
            whole[id(flight)] = of(flight)
        parts.append(whole[id(flight)][first : first + samples])
    return torch.stack(parts)


def _measured_start(model: Trained, pieces: Sequence[tuple[Flight, int]]) -> Tensor:
    """Body states [W, n] where straight lines through the first measurements begin; the reference where none are."""
    reference = [model.reference.get(n, 0.0) for n in model.body.states]
    fitted = _begun(pieces, model.body.states)
    return torch.where(fitted.isnan(), torch.tensor(reference, dtype=torch.float64), fitted).to(model.theta)


def _begun(pieces: Sequence[tuple[Flight, int]], channels: Sequence[str]) -> Tensor:
    """Values [W, n] at the start of least-squares lines through the first measurements; NaN where there are none."""
    samples = round(FIRST / pieces[0][0].dt) + 1
    rows = []
    for flight, first in pieces:
        record = flight.stack(channels)[first : first + samples]
        present = ~record.isnan()
        time = torch.arange(len(record), dtype=torch.float64)[:, None].expand_as(record)
        mean_time, mean = (torch.where(present, part, torch.nan).nanmean(dim=0) for part in (time, record))
        centred = torch.where(present, time - mean_time, 0.0)
        slope = (centred * record.nan_to_num(0.0)).sum(dim=0) / centred.square().sum(dim=0).clamp_min(1e-300)
        rows.append(mean - slope * mean_time)
    return torch.stack(rows)


def _completed(model: Trained, start: Tensor, controls: Tensor, pieces: Sequence[tuple[Flight, int]]) -> Tensor:
    """Whole states [W, nx]: those of the effects rest, or start at their channel, where the body alone is told."""
    states, n = model.own_states, len(model.body.states)
    if start.shape[-1] not in (n, n + len(states)):
        wrong = f"has {start.shape[-1]} columns"
        raise InputError("free_run", "x0", wrong, f"{n} (the body's) or {n + len(states)} (all states)")
    if start.shape[-1] == n + len(states):
        return start
    channels = [s.channel or "" for s in states]
    begun = _begun(pieces, channels).to(start)
    reference = [model.reference.get(c, torch.nan) if c else torch.nan for c in channels]
    begun = torch.where(begun.isnan(), torch.tensor(reference, dtype=torch.float64).to(start), begun)
    return at_rest(model, start, controls, begun)
