"""The two engines behind the likelihood: torch, for any model and solver, and native code, for what can be compiled.

Both simulate segments, eliminate initial states from the segments' linear models, and hand on what is left for the
parameters: torch as triangles (QR), native code as products of columns (normal equations), which are many times
cheaper and lose half of the digits of a condition number that the scaling of columns keeps small.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from torch import Tensor

from rotorid_torch.core.native.adjoint import Adjoint, trajectories
from rotorid_torch.core.native.build import threads
from rotorid_torch.core.native.dynamics import Dynamics, LinearProblem
from rotorid_torch.core.native.graph.tracing import Unsupported
from rotorid_torch.errors import InputError, say_once
from rotorid_torch.identification.estimate import sensitivity
from rotorid_torch.identification.estimate.residuals import Whitener
from rotorid_torch.identification.estimate.segments import Records, Segments
from rotorid_torch.identification.estimate.system import System

WEAK = 1e-9
"""Weight that keeps an initial state no output depends on where it is, relative to its column."""
SAME = 1e-13
"""Part of a column's squared length that is nothing where initial states have explained the rest, as in native code."""


@dataclass(frozen=True, eq=False)
class Part:
    """Some of the segments under given parameters: which of all, their run, residual [S, T, ny] (NaN = missing)."""

    which: Tensor
    segments: Segments
    run: sensitivity.Run
    residual: Tensor

    @property
    def valid(self) -> Tensor:
        """[S, T, ny] True where an output was measured."""
        return ~self.segments.outputs.isnan()


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What the columns of a part's linear model are: initial states (their prior), theta.

    x0_sd, x0_rows : [S, nx] prior's standard deviations and its rows at the place; None where they are held.
    """

    x0_sd: Tensor | None
    x0_rows: Tensor


@dataclass(frozen=True, eq=False)
class Elimination:
    """A part without its initial states: their triangles' rows [S, nx, n], what is left of each segment [S, m, m].

    passage : [S, nx, nx] last state by first. transitions : [T - 1, S, nx, nx] of every step, where they are at hand.
    """

    starts: Tensor
    joined: Tensor
    passage: Tensor
    transitions: Tensor | None = None


@dataclass(frozen=True, eq=False)
class TorchEngine:
    """What the likelihood asks of an engine, by torch: any module, any solver of torchdiffeq."""

    system: System
    solver: str = "rk4"

    def run(
        self, theta: Tensor, records: Records, segments: Segments, x0: Tensor, near: Tensor, steps: Tensor | None
    ) -> sensitivity.Run:
        """Trajectories of segments from x0 [S, nx]; near [S, T, nx] and its steps' transitions are known ones.

        By Newton's method from the near trajectory where that converges.
        """
        run = None
        if self.solver == "rk4":
            run = sensitivity.corrected(self.system, theta, records, segments, x0, sensitivity.Near(near, steps))
        return sensitivity.simulated(self.system, theta, records, segments, x0, self.solver) if run is None else run

    def differentiable(self, theta: Tensor, records: Records, segments: Segments, x0: Tensor) -> sensitivity.Run:
        """Trajectories of segments from x0 [S, nx], with torch's gradients by theta and x0."""
        return sensitivity.traced(self.system, theta, records, segments, x0, self.solver)

    def eliminate(self, records: Records, part: Part, whitener: Whitener, unknowns: Unknowns) -> Elimination:
        """The linear model of a part, initial states eliminated; QR of the rows, block by block."""
        triangles, transitions = None, []
        for rows, more in self._blocks(records, part, whitener, unknowns):
            stack = rows if triangles is None else torch.cat([triangles, rows], dim=1)
            triangles = torch.linalg.qr(stack, mode="r").R
            transitions.append(more)
        assert triangles is not None
        steps = torch.cat(transitions)
        passage = torch.eye(part.run.states.shape[-1], dtype=torch.float64).expand(len(part.segments), -1, -1)
        for step, inside in zip(steps, part.segments.inside.mT[1:, :, None, None], strict=True):
            passage = torch.where(inside, step @ passage, passage)
        nx = 0 if unknowns.x0_sd is None else len(unknowns.x0_sd.mT)
        triangles = _with_prior(triangles, unknowns)
        whole, joined = triangles.square().sum(dim=1)[:, nx:-1], triangles[:, nx:, nx:]
        nothing = joined.square().sum(dim=1)[:, :-1] <= SAME * whole
        joined[:, :, :-1].masked_fill_(nothing[:, None], 0.0)
        return Elimination(triangles[:, :nx], joined, passage, steps)

    def rows(self, records: Records, part: Part, whitener: Whitener, unknowns: Unknowns) -> Tensor:
        """The linear model's whitened rows themselves [S, T ny, nx + P + 1]."""
        return torch.cat([rows for rows, _ in self._blocks(records, part, whitener, unknowns)], dim=1)

    def _blocks(
        self, records: Records, part: Part, whitener: Whitener, unknowns: Unknowns
    ) -> Iterator[tuple[Tensor, Tensor]]:
        """Whitened rows [S, k ny, nx + P + 1] of successive blocks of samples, and the steps' transitions."""
        skip = part.run.states.shape[-1] if unknowns.x0_sd is None else 0
        for block in sensitivity.sensitivities(self.system, part.run, records, part.segments):
            slopes = block.outputs[..., skip:].transpose(0, 1)
            residual = part.residual[:, block.first : block.first + slopes.shape[1]].unsqueeze(-1)
            yield whitener.apply(torch.cat([slopes, residual], dim=-1), block.first).flatten(1, 2), block.transitions

    def joined(self, rests: Tensor, rows: Tensor) -> Tensor:
        """What is left of several [k, m, m] and further rows [r, m], as one [m, m]; triangles."""
        return _square(torch.linalg.qr(torch.cat([rests.flatten(0, 1), rows]), mode="r").R)

    def triangle(self, left: Tensor) -> Tensor:
        """The linear model's triangle [m - 1, m] by what is left [m, m], which it is already."""
        return left[:-1]


def _with_prior(triangles: Tensor, unknowns: Unknowns) -> Tensor:
    """Triangles [S, n, n] with the rows of the initial states' prior, and a weak pull where nothing else holds them."""
    if unknowns.x0_sd is None:
        return _square(triangles)
    nx = unknowns.x0_sd.shape[-1]
    pull = triangles.new_zeros(len(triangles), 2 * nx, triangles.shape[-1])
    pull[:, :nx, :nx] = torch.diag_embed(1.0 / unknowns.x0_sd)
    pull[:, :nx, -1] = unknowns.x0_rows
    norms = torch.linalg.vector_norm(triangles[:, :, :nx], dim=1)
    pull[:, nx:, :nx] = torch.diag_embed(WEAK * norms + 1e-12)
    return _square(torch.linalg.qr(torch.cat([triangles, pull], dim=1), mode="r").R)


def _square(triangles: Tensor) -> Tensor:
    """Triangles [..., m, n] with m <= n filled up with rows of zeros."""
    missing = triangles.shape[-1] - triangles.shape[-2]
    return torch.nn.functional.pad(triangles, (0, 0, 0, missing)) if missing > 0 else triangles


@dataclass(frozen=True, eq=False)
class NativeEngine:
    """A module that has become native code; `variants` by whether initial states are unknowns, and the control path.

    timed : whether the rates depend on time, which then is one more control.
    """

    system: System
    traced: Dynamics
    timed: bool
    variants: dict[tuple[bool, tuple[int, ...]], Dynamics] = field(default_factory=dict)

    @classmethod
    def of(cls, system: System, states: Tensor, controls: Tensor, hold: bool = False) -> NativeEngine:
        """Trace the system at a state [nx] and controls [nu]; `hold`: controls are held within a step.

        Raises Unsupported: it holds an operation that native code does not know, or there is no compiler.
        """
        nu = len(controls)
        example = torch.cat([controls, controls.new_zeros(1)])
        traced = Dynamics.of(lambda x, u, theta: system.motion(theta, u[nu], x, u[:nu]), states, example, system.theta)
        traced = replace(traced, hold=hold)
        timed = traced.depends_on("u", nu)
        engine = cls(system, traced if timed else replace(traced, nu=nu), timed)
        engine.traced.build(derivatives=True)  # now: what cannot be compiled is told before anything depends on it
        return engine

    def run(
        self, theta: Tensor, records: Records, segments: Segments, x0: Tensor, near: Tensor, steps: Tensor | None
    ) -> sensitivity.Run:
        """See `TorchEngine`; simulated anew, which is cheaper than any correction."""
        controls = sensitivity.controls_at(self.system, theta, records, segments)
        path = self._given(controls, segments)
        states, outputs = self.traced.simulate(theta, x0, path, segments.dt, threads=threads())
        return sensitivity.Run(theta, controls, states, outputs)

    def differentiable(self, theta: Tensor, records: Records, segments: Segments, x0: Tensor) -> sensitivity.Run:
        """See `TorchEngine`; by the discrete adjoint."""
        controls = sensitivity.controls_at(self.system, theta, records, segments)
        path = self._given(controls, segments)
        states, outputs = trajectories(self.adjoint, theta, x0, path, segments.dt)
        return sensitivity.Run(theta, controls, states, outputs)

    @cached_property
    def adjoint(self) -> Adjoint:
        """What carries derivatives back."""
        return Adjoint(self.traced)

    def _given(self, controls: Tensor, segments: Segments) -> Tensor:
        """Controls, and time behind them where the rates ask for it."""
        return sensitivity.with_time(controls, segments) if self.timed else controls

    def eliminate(self, records: Records, part: Part, whitener: Whitener, unknowns: Unknowns) -> Elimination:
        """See `TorchEngine`; normal equations."""
        dynamics, problem = self._problem(records, part, whitener, unknowns)
        H, passage = dynamics.normal_equations(problem, threads())
        if not math.isfinite(float(H.sum())) and bool(part.run.outputs.isfinite().all()):
            raise self._infinite(H)
        nx = 0 if unknowns.x0_sd is None else unknowns.x0_sd.shape[-1]
        if unknowns.x0_sd is not None:
            H[:, :nx, :nx] += torch.diag_embed(unknowns.x0_sd**-2.0)
            H[:, :nx, -1] += unknowns.x0_rows / unknowns.x0_sd
        starts, remaining = dynamics.triangles(H, nx, WEAK)
        return Elimination(starts, remaining, passage)

    def _infinite(self, H: Tensor) -> InputError:
        """The refusal of products of columns that are not finite although the trajectories are."""
        names = self.system.names
        lost = (~H.diagonal(dim1=-2, dim2=-1).isfinite()).any(dim=0)[-1 - len(names) : -1].tolist()
        names_lost = ", ".join(name for name, bad in zip(names, lost, strict=True) if bad) or "the initial states"
        wrong = f"the trajectories are finite, but not their derivatives by {names_lost}"
        wish = "no root or quotient at zero, and a start from which runs stay small"
        return InputError("model", "forward", wrong, wish)

    def rows(self, records: Records, part: Part, whitener: Whitener, unknowns: Unknowns) -> Tensor:
        """See `TorchEngine`."""
        dynamics, problem = self._problem(records, part, whitener, unknowns)
        return dynamics.whitened_rows(problem, threads())

    def joined(self, rests: Tensor, rows: Tensor) -> Tensor:
        """See `TorchEngine`; products add up."""
        return rests.sum(dim=0) + rows.mT @ rows

    def triangle(self, left: Tensor) -> Tensor:
        """See `TorchEngine`; Cholesky's rows."""
        return self.traced.triangles(left.unsqueeze(0), len(left) - 1, 0.0)[0][0]

    def _problem(
        self, records: Records, part: Part, whitener: Whitener, unknowns: Unknowns
    ) -> tuple[Dynamics, LinearProblem]:
        which, slopes = sensitivity.control_slopes(self.system, part.run.theta, records, part.segments)
        if self.timed and len(which):
            slopes = torch.nn.functional.pad(slopes, (0, 0, 0, 1))
        whitening = whitener.table
        problem = LinearProblem(
            dt=part.segments.dt,
            length=part.segments.inside.sum(dim=1).to(torch.int32),
            controls=self._given(part.run.controls, part.segments).contiguous(),
            path=slopes,
            residual=part.residual.contiguous(),
            x0=part.run.states[:, 0].contiguous(),
            theta=part.run.theta,
            weight=whitener.covariance.diagonal().rsqrt().contiguous(),
            pattern=None if whitener.pattern is None else whitener.pattern.to(torch.int32).contiguous(),
            table=None if whitening is None else whitening.contiguous(),
        )
        key = unknowns.x0_sd is not None, tuple(which.tolist())
        if key not in self.variants:
            self.variants[key] = replace(self.traced, initial=key[0], path=key[1])
        return self.variants[key], problem


Engine = TorchEngine | NativeEngine


def engine_for(system: System, records: Records, solver: str, wanted: str | None = None) -> Engine:
    """Native code where the solver is its own and the system can be compiled; torch otherwise, with a line of why.

    wanted : "native" (which may then raise) or "reference", to choose.
    """
    if wanted == "reference" or (wanted is None and solver != "rk4"):
        return TorchEngine(system, solver)
    states = records.states.flatten(0, 1).nan_to_num(0.0).mean(dim=0)
    try:
        return NativeEngine.of(system, states, records.controls[0, 0], records.hold)
    except Unsupported as error:
        if wanted == "native":
            raise
        say_once(f"step 3 runs in torch, many times slower than compiled: {error}")
        return TorchEngine(system, solver)
