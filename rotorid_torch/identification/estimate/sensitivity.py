"""Trajectories of all segments side by side, and their derivatives, which are not sequential.

Once a trajectory is known, the derivatives of all its single steps are independent of each other and are taken at once;
what is left to do one sample after the other is a small matrix product. In the same way a trajectory near a known one
is found by correcting all steps at once and carrying the corrections on.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from rotorid_torch.core.integrate import NODES, simulate, step, step_jacobian, step_stages
from rotorid_torch.identification.estimate.segments import Records, Segments
from rotorid_torch.identification.estimate.system import System

BLOCK_NUMBERS = 1_000_000
"""Numbers in the largest array of a block of samples; bounds the memory."""
SWEEPS = 25
"""Corrections of a whole trajectory before it is simulated sample by sample instead."""
EXACT = 1e-11
"""Error left in a corrected trajectory, relative to each state's size."""


Tape = tuple[Tensor, Tensor]
"""Parameters the control path depends on, and the controls' derivatives by them [..., nu, n]."""


@dataclass(frozen=True)
class Run:
    """Segments under given parameters: controls after the control path, states and outputs."""

    theta: Tensor
    controls: Tensor  # [S, T, nu]
    states: Tensor  # [S, T, nx]
    outputs: Tensor  # [S, T, ny]


def controls_at(system: System, theta: Tensor, records: Records, segments: Segments) -> Tensor:
    """Controls of the segments [S, T, nu] behind the control path, which sees the whole flight."""
    flights, place = torch.unique(segments.flight, return_inverse=True)
    return system.tape(theta, records.controls[flights], records.dt)[place[:, None], segments.place]


def with_time(controls: Tensor, segments: Segments) -> Tensor:
    """Controls [S, T, nu] and time, s, behind them: for rates that depend on it."""
    return torch.cat([controls, sample_times(segments).mT.unsqueeze(-1)], dim=-1)


def control_slopes(system: System, theta: Tensor, records: Records, segments: Segments) -> Tape:
    """Parameters the control path depends on [n], and the controls' derivatives by them [S, T, nu, n]."""
    flights, place = torch.unique(segments.flight, return_inverse=True)
    which, slopes = system.tape_jacobian(theta, records.controls[flights], records.dt)
    return which, slopes[place[:, None], segments.place]


@torch.no_grad()
def simulated(
    system: System, theta: Tensor, records: Records, segments: Segments, x0: Tensor, solver: str = "rk4"
) -> Run:
    """The segments simulated from x0 [S, nx], one sample after the other."""
    return traced(system, theta, records, segments, x0, solver)


def traced(system: System, theta: Tensor, records: Records, segments: Segments, x0: Tensor, solver: str = "rk4") -> Run:
    """The same, with torch's gradients flowing where theta or x0 ask for them."""
    controls = controls_at(system, theta, records, segments)

    def use(model: nn.Module) -> Tensor:
        rates = lambda t, x, u: model(t + segments.start, x, u)  # noqa: E731
        return simulate(rates, x0, controls, segments.dt, solver, records.hold)

    states = system.at(theta, use)
    return Run(theta, controls, states, system.output(theta, states, controls))


class Near(NamedTuple):
    """A trajectory [S, T, nx] near the wanted one; its steps' derivatives [T - 1, S, nx, nx], where at hand."""

    states: Tensor
    transitions: Tensor | None = None


@torch.no_grad()
def corrected(
    system: System, theta: Tensor, records: Records, segments: Segments, x0: Tensor, near: Near
) -> Run | None:
    """The segments' trajectories from a near one by Newton's method over all samples at once.

    Derivatives of steps that are not at hand are taken along each new trajectory. The result is that of `simulated`
    with "rk4" to rounding; None where the corrections do not shrink fast enough.

    Source: Bellen and Zennaro (1989), J. Comput. Appl. Math. 25 (parallel solution of difference equations).
    """
    controls = controls_at(system, theta, records, segments)
    ends, x = step_ends(controls.transpose(0, 1), records.hold), near.states.transpose(0, 1).clone()
    x[0] = x0
    inside = segments.inside.mT[1:, :, None]
    size = torch.where(segments.inside.mT[..., None], x.abs(), 0.0).amax(dim=(0, 1)).clamp_min(1e-12)
    times = sample_times(segments)[:-1]
    before, slowest = torch.inf, 2.0 if near.transitions is None else 0.5
    for _ in range(SWEEPS):
        after = step(lambda t, x, u: system.rates(theta, t, x, u), times, x[:-1], *ends, segments.dt)
        along = near.transitions
        if along is None:
            along = step_transitions(system, theta, times, x[:-1], ends, segments.dt)
        change = _carried(along, torch.where(inside, after - x[1:], 0.0))
        x[1:] += change
        largest = float((change.abs() / size).max())
        shrinks = largest / before if before < torch.inf else 1.0
        if largest * shrinks < EXACT:
            states = x.transpose(0, 1).contiguous()
            return Run(theta, controls, states, system.output(theta, states, controls))
        if not largest < torch.inf or (before < torch.inf and not shrinks < slowest):
            return None
        before = largest
    return None


def step_ends(u: Tensor, hold: bool) -> tuple[Tensor, Tensor]:
    """What is linear within steps (a record [T, S, ...]), at their starts and at their ends."""
    return u[:-1], u[:-1] if hold else u[1:]


def _carried(transitions: Tensor, defects: Tensor) -> Tensor:
    """Corrections d[k + 1] = transition[k] d[k] + defect[k], d[0] = 0; [T - 1, S, nx]."""
    carried = defects.unsqueeze(-1).clone()
    for k in range(1, len(carried)):
        torch.baddbmm(carried[k], transitions[k], carried[k - 1], out=carried[k])
    return carried.squeeze(-1)


def sample_times(segments: Segments) -> Tensor:
    """[T, S] time at the samples, s."""
    return segments.start + segments.dt * torch.arange(segments.samples, dtype=torch.float64)[:, None]


@dataclass(frozen=True)
class Block:
    """Derivatives of the outputs at some samples [k, S, ny, nx + P], initial state first, and the transitions."""

    first: int
    outputs: Tensor
    transitions: Tensor  # [k, S, nx, nx], from these samples to the next ones


@torch.no_grad()
def sensitivities(system: System, run: Run, records: Records, segments: Segments) -> Iterator[Block]:
    """Exact derivatives of the segments' outputs by their initial states and by theta, in blocks of samples."""
    theta, nx, total = run.theta, run.states.shape[-1], segments.samples
    x, u, times = run.states.transpose(0, 1), run.controls.transpose(0, 1), sample_times(segments)
    which, by_tape = control_slopes(system, theta, records, segments)
    width = nx + len(theta)
    length = max(2, BLOCK_NUMBERS // (len(segments) * nx * width))
    carried = x.new_zeros(len(segments), nx, width)
    carried[:, :, :nx] = torch.eye(nx, dtype=x.dtype)
    for k in range(0, max(total - 1, 1), length):
        end = total if k + length >= total - 1 else k + length  # no block of one sample: it has no step
        upto = min(end + 1, total)  # the step out of the block needs the next controls
        tape = (which, by_tape[:, k:upto].transpose(0, 1))
        ends, slopes = step_ends(u[k:upto], records.hold), step_ends(tape[1], records.hold)
        start = times[k : upto - 1], x[k : upto - 1]
        transitions, inputs = _steps(system, theta, start, ends, segments.dt, (which, slopes))
        path = x.new_empty(end - k, len(segments), nx, width)
        path[0] = carried
        for i in range(1, end - k):
            torch.baddbmm(inputs[i - 1], transitions[i - 1], path[i - 1], out=path[i])
        if end < total:
            carried = torch.baddbmm(inputs[-1], transitions[-1], path[-1])
        yield Block(k, _outputs(system, theta, x[k:end], u[k:end], path, tape), transitions)


Ends = tuple[Tensor, Tensor]
"""What is linear within a step, at its start and at its end."""


def _steps(
    system: System, theta: Tensor, start: tuple[Tensor, Tensor], u: Ends, dt: float, tape: tuple[Tensor, Ends]
) -> tuple[Tensor, Tensor]:
    """Derivatives of the steps by their start [k, S, nx, nx], by initial state (none) and theta [k, S, nx, nx + P].

    start : times and states where the steps start. tape : as `Tape`, the derivatives at starts and ends of the steps.
    """
    t, x = start
    shape, points = _stages(system, theta, t, x, u, dt)
    by_x, by_u, by_theta = (d.unflatten(0, shape) for d in system.rates_jacobian(theta, *points))
    which, (first, last) = tape
    if len(which):
        nodes = torch.tensor(NODES, dtype=x.dtype).view(4, 1, 1)
        by_theta[..., which] += by_u @ (first + nodes[..., None, None] * (last - first))
    transitions, inputs = step_jacobian(by_x, by_theta, dt)
    return transitions, torch.nn.functional.pad(inputs, (x.shape[-1], 0))


def _stages(
    system: System, theta: Tensor, t: Tensor, x: Tensor, u: Ends, dt: float
) -> tuple[tuple[int, ...], tuple[Tensor, Tensor, Tensor]]:
    """Times, states and controls of all stages of all steps as a flat list of points, and its shape [4, k, S]."""
    _, stages = step_stages(lambda t, x, u: system.rates(theta, t, x, u), t, x, *u, dt)
    nodes = torch.tensor(NODES, dtype=x.dtype).view(4, 1, 1)
    controls = u[0] + nodes[..., None] * (u[1] - u[0])
    flat = (t + dt * nodes).flatten(), stages.flatten(0, -2), controls.flatten(0, -2)
    return tuple(stages.shape[:-1]), flat


def step_transitions(system: System, theta: Tensor, t: Tensor, x: Tensor, u: Ends, dt: float) -> Tensor:
    """Derivatives of the steps by their start [k, S, nx, nx]."""
    nx, parts = x.shape[-1], []
    length = max(1, BLOCK_NUMBERS // (x.shape[1] * nx * nx))
    for k in range(0, len(x), length):
        some = slice(k, k + length)
        shape, points = _stages(system, theta, t[some], x[some], (u[0][some], u[1][some]), dt)
        by_x = system.state_jacobian(theta, *points).unflatten(0, shape)
        parts.append(step_jacobian(by_x, by_x[..., :0], dt)[0])
    return torch.cat(parts)


def _outputs(system: System, theta: Tensor, x: Tensor, u: Tensor, path: Tensor, tape: Tape) -> Tensor:
    shape, nx = x.shape[:-1], x.shape[-1]
    flat = system.output_jacobian(theta, x.flatten(0, -2), u.flatten(0, -2))
    by_x, by_u, by_theta = (d.unflatten(0, shape) for d in flat)
    which, slopes = tape
    if len(which):
        by_theta[..., which] += by_u @ slopes[: len(x)]
    total = by_x @ path
    total[..., nx:] += by_theta
    return total
