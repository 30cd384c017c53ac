"""Free runs: controls measured, initial state from the first second, no measurement after that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.native.dynamics import Dynamics
from rotorid_torch.core.native.fallback import say_once
from rotorid_torch.core.native.trace import Unsupported
from rotorid_torch.data.dataset import Dataset
from rotorid_torch.model.model import Model

FIRST = 1.0
"""s of measurement that the initial state of the body is fitted on."""
ITERATIONS = 4
"""Gauss-Newton steps of that fit; the problem is nearly linear."""
PROBE = 1e-4
"""Perturbation of a body state for its derivative, in the state's unit."""
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

    def pick(self, which: Sequence[int]) -> Windows:
        """Some of the pieces."""
        chosen = list(which)
        names, starts = tuple(self.names[i] for i in chosen), tuple(self.starts[i] for i in chosen)
        return Windows(self.dt, names, starts, self.controls[chosen], self.measured[chosen], self.noise)


def windows(model: Model, dataset: Dataset, places: Sequence[tuple[str, int]], samples: int) -> Windows:
    """Cut pieces of `samples` samples that begin at (flight, first sample); all flights have one sample interval."""
    controls, outputs = [], []
    for name, start in places:
        flight = dataset.flights[name]
        index = torch.arange(start, start + samples)
        inside = index.clamp(max=flight.samples - 1)
        with torch.no_grad():
            tape = model.tape(flight.bridged(model.body.controls), flight.dt)
        controls.append(tape[inside])
        measured = flight.stack(model.body.outputs)[inside]
        outputs.append(torch.where((index < flight.samples)[:, None], measured, torch.nan))
    dt = dataset.flights[places[0][0]].dt
    names, starts = zip(*places, strict=True)
    noise = torch.tensor([dataset.noise(c) for c in model.body.outputs], dtype=torch.float64)
    return Windows(dt, names, starts, torch.stack(controls), torch.stack(outputs), noise)


@torch.no_grad()
def free_run(model: Model, pieces: Windows, run: Runs | None = None) -> tuple[Tensor, Tensor]:
    """States [W, T, nx] and outputs [W, T, ny] of the free runs of all pieces.

    The body's initial state is fitted to the measured outputs of the first second by the same model; the effects'
    own states are in equilibrium with it. `run` serves many calls; made where it is not given.
    """
    run = run or Runs.of(model)
    x0 = _initial(run, pieces)
    return run(x0, pieces.controls, pieces.dt)


@dataclass(frozen=True)
class Runs:
    """Trajectories of a model that are held in range: in native code where it can be compiled, else in torch."""

    model: Model
    compiled: Dynamics | None

    @classmethod
    def of(cls, model: Model) -> Runs:
        """Compile the model, or say once why that cannot be."""
        x, u = (
            torch.tensor([model.reference.get(n, 0.0) for n in names], dtype=torch.float64)
            for names in (model.layout.names, model.body.controls)
        )
        try:
            dynamics = Dynamics.of(
                lambda x, u, theta: model.rates(theta, x, u),
                lambda x, u, theta: model.outputs_at(theta, x, u),
                x,
                u,
                model.theta.detach(),
            )
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
        made = self.compiled.simulate(
            self.model.theta.detach(), x0.reshape(-1, x0.shape[-1]), flat, dt, STRAYED, threads()
        )
        return made[0].unflatten(0, shape), made[1].unflatten(0, shape)

    def _in_torch(self, x0: Tensor, controls: Tensor, dt: float) -> Tensor:
        def rates(t: Tensor, x: Tensor, u: Tensor) -> Tensor:
            held = x.clamp(-STRAYED, STRAYED)
            return self.model.rates(self.model.theta, held, u).nan_to_num(0.0).clamp(-STRAYED, STRAYED)

        return simulate(rates, x0, controls, dt)


def _initial(run: Runs, pieces: Windows) -> Tensor:
    """Initial states [W, nx] by Gauss-Newton on the first second, all perturbed bodies as further rows of one batch."""
    model = run.model
    body, samples = model.body.states, max(2, min(round(FIRST / pieces.dt) + 1, pieces.controls.shape[1]))
    controls, outputs = pieces.controls[:, :samples], [i for i, c in enumerate(model.body.outputs) if c in body]
    wanted = pieces.measured[:, :samples, outputs]
    known = ~wanted.isnan()
    weight = known / pieces.noise[outputs]
    columns = [body.index(model.body.outputs[i]) for i in outputs]
    x = torch.tensor([model.reference.get(n, 0.0) for n in body], dtype=torch.float64).repeat(len(wanted), 1)
    first = wanted[:, : max(1, samples // 8)].nanmean(dim=1)
    x[:, columns] = torch.where(first.isnan(), x[:, columns], first)
    probes = PROBE * torch.eye(len(body), dtype=torch.float64)
    for _ in range(ITERATIONS):
        trials = torch.cat([x[None], x + probes[:, None]])
        x0 = equilibrium(model, trials, controls[:, 0])
        runs = run(x0, controls, pieces.dt)[0][..., columns]
        jacobian = ((runs[1:] - runs[0]) / PROBE * weight).permute(1, 2, 3, 0).flatten(1, 2)
        residual = torch.where(known, (wanted - runs[0]) * weight, 0.0).flatten(1, 2)
        norms = jacobian.norm(dim=1, keepdim=True).clamp_min(1e-12)
        step = torch.linalg.lstsq(jacobian / norms, residual.unsqueeze(-1), rcond=1e-8, driver="gelsd").solution
        x = x + step.squeeze(-1) / norms[:, 0]
    return equilibrium(model, x, controls[:, 0])


@torch.no_grad()
def equilibrium(model: Model, body: Tensor, controls: Tensor) -> Tensor:
    """Whole state [..., nx] with the effects' own states at rest under body states and controls; Newton's method."""
    own = len(model.layout) - body.shape[-1]
    if own == 0:
        return body
    n = body.shape[-1]
    start = torch.tensor([model.reference.get(s, 0.0) for s in model.layout.names[n:]], dtype=torch.float64)
    x = torch.cat([body, start.expand(*body.shape[:-1], own)], dim=-1)
    steps = PROBE * torch.eye(len(model.layout), dtype=torch.float64)[n:]
    for _ in range(4):
        rows = torch.cat([x[None], x + steps.view(own, *(1,) * (x.dim() - 1), -1)])
        rates = model.rates(model.theta, rows, controls)[..., n:]
        slopes = ((rates[1:] - rates[0]) / PROBE).movedim(0, -1)
        change = torch.linalg.lstsq(slopes, rates[0].unsqueeze(-1)).solution.squeeze(-1)
        x = torch.cat([x[..., :n], x[..., n:] - change.nan_to_num(0.0)], dim=-1)
    return x
