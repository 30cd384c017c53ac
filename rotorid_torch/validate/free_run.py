"""Free runs: controls measured, initial state from the first second, no measurement after that."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from rotorid_torch.core import names
from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.least_squares import least_squares
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.data.flight import Flight
from rotorid_torch.errors import say_once
from rotorid_torch.model.model import Model
from rotorid_torch.model.training.equilibrium import PROBE, equilibrium
from rotorid_torch.validate.scores import r2, rmse

FIRST = 1.0
"""s of measurement that the initial state of the body is fitted on."""
ITERATIONS = 4
"""Gauss-Newton steps of that fit; the problem is nearly linear."""
MOMENT = 8
"""The first second's part whose mean starts that fit, and the states that have a channel."""
STRAYED = 1e6
"""A run that leaves this range is held there: it has diverged, and its score says so."""


@dataclass(frozen=True)
class Windows:
    """Pieces of flights of one length [W, T, ...], the flight and first sample of each; NaN beyond a flight's end."""

    dt: float
    names: tuple[str, ...]
    starts: tuple[int, ...]
    controls: Tensor  # [W, T, nu], after the control path, held beyond the end
    measured: Tensor  # [W, T, ny]
    noise: Tensor  # [ny] of a sample
    starts_at: Tensor  # [W, n] of the effects' own states, where a channel gives it; NaN = in equilibrium

    def pick(self, which: Sequence[int]) -> Windows:
        """Some of the pieces."""
        chosen = list(which)
        names, starts = tuple(self.names[i] for i in chosen), tuple(self.starts[i] for i in chosen)
        per_piece = self.controls[chosen], self.measured[chosen], self.noise, self.starts_at[chosen]
        return Windows(self.dt, names, starts, *per_piece)


def windows(model: Model, dataset: Dataset, places: Sequence[tuple[str, int]], samples: int) -> Windows:
    """Cut pieces of `samples` samples that begin at (flight, first sample); all flights have one sample interval."""
    controls, outputs, starts_at = [], [], []
    tapes = dict[str, Tensor]()
    for name, start in places:
        flight = dataset.flights[name]
        index = torch.arange(start, start + samples)
        inside = index.clamp(max=flight.samples - 1)
        if name not in tapes:
            with torch.no_grad():
                tapes[name] = model.tape(flight.bridged(model.body.controls), flight.dt)
        controls.append(tapes[name][inside])
        measured = flight.stack(model.body.outputs)[inside]
        outputs.append(torch.where((index < flight.samples)[:, None], measured, torch.nan))
        starts_at.append(_measured_starts(model, flight, start))
    dt = dataset.flights[places[0][0]].dt
    names, starts = zip(*places, strict=True)
    noise = torch.tensor([dataset.noise(c) for c in model.body.outputs], dtype=torch.float64)
    return Windows(dt, names, starts, torch.stack(controls), torch.stack(outputs), noise, torch.stack(starts_at))


def _measured_starts(model: Model, flight: Flight, start: int) -> Tensor:
    """Values at which the effects' own states start by a channel [n]; NaN for the others."""
    starts = [measured_start(flight, state.channel, start) for state in model.own_states]
    return torch.tensor(starts, dtype=torch.float64)


def measured_start(flight: Flight, channel: str | None, start: int) -> float:
    """A channel's mean over the first moments from a sample on; NaN where there is none."""
    if channel is None or not flight.has(channel):
        return math.nan
    return float(flight.stack([channel])[start : start + max(1, _first(flight.dt) // MOMENT), 0].nanmean())


def _first(dt: float) -> int:
    """Samples of the first second."""
    return round(FIRST / dt) + 1


@torch.no_grad()
def free_run(model: Model, pieces: Windows, run: Runs | None = None) -> tuple[Tensor, Tensor]:
    """States [W, T, nx] and outputs [W, T, ny] of the free runs of all pieces.

    The body's initial state is fitted to the measured outputs of the first second by the same model; the effects'
    own states are in equilibrium with it, or start where their channel was measured. Outputs are as the sensors record
    them. `run` serves many calls; made where it is not given.
    """
    run = run or Runs.of(model)
    states, outputs = run(_initial(run, pieces), pieces.controls, pieces.dt)
    return states, model.recorded(outputs, pieces.dt)


@dataclass(frozen=True)
class Runs:
    """Trajectories of a model that are held in range: in native code where it can be compiled, else in torch."""

    model: Model
    compiled: Dynamics | None

    @classmethod
    def of(cls, model: Model) -> Runs:
        """Compile the model, or say once why that cannot be."""
        numbers = ([model.reference.get(n, 0.0) for n in names] for names in (model.layout.names, model.body.controls))
        x, u = (torch.tensor(values, dtype=torch.float64) for values in numbers)
        try:
            dynamics = Dynamics.of(lambda x, u, theta: model.motion(theta, x, u), x, u, model.theta.detach())
            dynamics.build()
        except Unsupported as error:
            say_once(f"free runs are simulated in torch, many times slower than compiled: {error}")
            return cls(model, None)
        return cls(model, dynamics)

    def __call__(self, x0: Tensor, controls: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """States [..., W, T, nx] and outputs [..., W, T, ny] from x0 [..., W, nx] under controls [W, T, nu]."""
        if self.compiled is None:
            states = self._in_torch(x0, controls, dt)
            return states, self.model.output(states, controls)
        shape = x0.shape[:-1]
        flat = controls.expand(*shape, *controls.shape[-2:]).reshape(-1, *controls.shape[-2:])
        simulated = self.compiled.simulate(
            self.model.theta.detach(), x0.reshape(-1, x0.shape[-1]), flat, dt, STRAYED, threads()
        )
        return simulated[0].unflatten(0, shape), simulated[1].unflatten(0, shape)

    def _in_torch(self, x0: Tensor, controls: Tensor, dt: float) -> Tensor:
        def rates(t: Tensor, x: Tensor, u: Tensor) -> Tensor:
            held = x.clamp(-STRAYED, STRAYED)
            return self.model.rates(self.model.theta, held, u).nan_to_num(0.0).clamp(-STRAYED, STRAYED)

        return simulate(rates, x0, controls, dt)


def _initial(run: Runs, pieces: Windows) -> Tensor:
    """Initial states [W, nx]: the body's by `fitted_start`, all perturbed bodies as further rows of one batch."""
    model = run.model

    def outputs(trials: Tensor, samples: int) -> Tensor:
        controls = pieces.controls[:, :samples]
        x0 = equilibrium(model, trials, controls[:, 0], pieces.starts_at)
        return model.recorded(run(x0, controls, pieces.dt)[1], pieces.dt)

    reference = {n: model.reference.get(n, 0.0) for n in model.body.states}
    body = fitted_start(outputs, reference, model.body.outputs, pieces)
    return equilibrium(model, body, pieces.controls[:, 0], pieces.starts_at)


def fitted_start(
    run: Callable[[Tensor, int], Tensor], reference: Mapping[str, float], names: Sequence[str], pieces: Windows
) -> Tensor:
    """Initial body states [W, n] by Gauss-Newton on the measured outputs of the first second.

    run : recorded outputs [K, W, samples, ny] from body states [K, W, n] over so many samples. reference : of the body
    states, in their order. names : of the outputs.
    """
    states = list(reference)
    samples = max(2, min(_first(pieces.dt), pieces.controls.shape[1]))
    outputs = [i for i, c in enumerate(names) if c in reference]
    wanted = pieces.measured[:, :samples, outputs]
    present = ~wanted.isnan()
    weight = present / pieces.noise[outputs]
    columns = [states.index(names[i]) for i in outputs]
    x = torch.tensor([*reference.values()], dtype=torch.float64).repeat(len(wanted), 1)
    first = wanted[:, : max(1, samples // MOMENT)].nanmean(dim=1)
    x[:, columns] = torch.where(first.isnan(), x[:, columns], first)
    probes = PROBE * torch.eye(len(states), dtype=torch.float64)
    for _ in range(ITERATIONS):
        runs = run(torch.cat([x[None], x + probes[:, None]]), samples)[..., outputs]
        jacobian = ((runs[1:] - runs[0]) / PROBE * weight).permute(1, 2, 3, 0).flatten(1, 2)
        residual = torch.where(present, (wanted - runs[0]) * weight, 0.0).flatten(1, 2)
        norms = jacobian.norm(dim=1, keepdim=True).clamp_min(1e-12)
        step = least_squares(jacobian / norms, residual.unsqueeze(-1), rcond=1e-8)
        x = x + step.squeeze(-1) / norms[:, 0]
    return x


@dataclass(frozen=True)
class Fidelity:
    """How a free run follows one measured channel: root mean square error, in its unit, and R² (1 is perfect)."""

    rmse: float
    r2: float
    unit: str


def fidelity(free: Mapping[str, np.ndarray], flight: Flight) -> dict[str, Fidelity]:
    """By measured channel, how a free run on a flight follows it; free : channels (T,) with its `time`."""
    first, samples = round((free["time"][0] - float(flight.time[0])) / flight.dt), len(free["time"])
    by_channel = {}
    for channel, run in free.items():
        if channel == "time" or names.channel(channel) is None or not flight.has(channel):
            continue
        measured = flight[channel][first : first + samples, None]
        error = torch.from_numpy(run)[:, None] - measured
        by_channel[channel] = Fidelity(float(rmse(error)), float(r2(error, measured)), names.unit(channel))
    return by_channel
