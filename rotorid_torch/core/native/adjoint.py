"""Trajectories of a native model that torch can differentiate: the discrete adjoint of every Runge-Kutta step.

A pass back costs a few passes forward, however many parameters there are; the weights of a network may be among them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from rotorid_torch.core.native.build import address, library, threads
from rotorid_torch.core.native.dynamics import Dynamics, evaluation, sizes
from rotorid_torch.core.native.graph.derivatives import pullback
from rotorid_torch.core.native.graph.emit import SHARED, Constants, straight_line
from rotorid_torch.errors import InputError

ALONG = "l"
"""What the code calls the weights of the results whose derivatives it takes."""


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Derivatives of a cost by initial states, controls and parameters, from those by states and outputs."""

    dynamics: Dynamics

    @cached_property
    def code(self) -> tuple[str, Tensor]:
        """C++, and the numbers in it."""
        d = self.dynamics
        constants = Constants(d.graph, d.count)
        f = evaluation(d.graph, "rates", d.rates, constants)
        pulls = self._pull("rates", d.rates, constants) + self._pull("outputs", d.outputs, constants)
        size = sizes(NX=d.nx, NU=d.nu, NY=d.ny, COUNT=d.count)
        return f'#include "lanes.h"\n{size}{constants.prepare()}{f}{pulls}#include "adjoint.h"\n', constants.numbers()

    def build(self) -> None:
        """Compile the code of trajectories and derivatives now.

        Raises Unsupported: there is no compiler, or it refuses the model.
        """
        with ThreadPoolExecutor() as side_by_side:
            list(side_by_side.map(library, (self.dynamics.simulation[0], self.code[0])))

    def _pull(self, name: str, results: Sequence[int], constants: Constants) -> str:
        """C++: NAME_pull(x, u, c, l, gx, gu, gt), and NAME_BY, the parameters whose derivatives gt holds."""
        d, none = self.dynamics, self.dynamics.graph.constant(0.0)
        by = pullback(d.graph, results, ALONG)
        reached = [p for p in range(d.count) if (SHARED, p) in by]
        wanted = {f"gx[{i}]": by.get(("x", i), none) for i in range(d.nx)}
        wanted |= {f"gu[{j}]": by.get(("u", j), none) for j in range(d.nu)}
        wanted |= {f"gt[{k}]": by[SHARED, p] for k, p in enumerate(reached)}
        arguments = f"const vd* x, const vd* u, const double* c, const vd* {ALONG}, vd* gx, vd* gu, vd* gt"
        return (
            f"enum {{ {name.upper()}_N = {len(reached)} }};\n"
            f"static const int {name.upper()}_BY[] = {{{', '.join(map(str, (*reached, 0)))}}};\n"
            f"static void {name}_pull({arguments}) {{\n"
            f"{straight_line(d.graph, wanted, constants.name, 'vd')}\n}}\n"
        )

    def pull(self, theta: Tensor, controls: Tensor, states: Tensor, by: tuple[Tensor, Tensor], dt: float) -> Pulled:
        """Derivatives of a cost from those by states [B, T, nx] and outputs [B, T, ny], along such trajectories."""
        source, numbers = self.code
        theta = torch.cat([theta, numbers]).contiguous()
        by_states, by_outputs = (part.contiguous() for part in by)
        (count, samples, nx), parameters = states.shape, self.dynamics.count
        pulled = states.new_empty(count, nx), torch.empty_like(controls), theta.new_empty(parameters)
        places = [address(a) for a in (controls, states, theta, by_states, by_outputs, *pulled)]
        library(source).pull(count, samples, ctypes.c_double(dt), *places, threads())
        return pulled


Pulled = tuple[Tensor, Tensor, Tensor]
"""Derivatives of a cost by initial states [B, nx], controls [B, T, nu] and parameters [P]."""


def trajectories(adjoint: Adjoint, theta: Tensor, x0: Tensor, controls: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """States [B, T, nx] and outputs [B, T, ny] from x0 [B, nx] under controls [B, T, nu], linear between samples.

    Torch differentiates them once, by parameters theta [P], x0 and controls.

    Raises Unsupported: there is no compiler, or it refuses the model.

    Source: Hager (2000), Numer. Math. 87 (Runge-Kutta methods and their discrete adjoint).
    """
    return _Trajectories.apply(adjoint, theta, x0, controls, dt)


class _Trajectories(torch.autograd.Function):
    """Native code, forward and back."""

    @staticmethod
    def forward(
        ctx: Any, adjoint: Adjoint, theta: Tensor, x0: Tensor, controls: Tensor, dt: float
    ) -> tuple[Tensor, Tensor]:
        controls = controls.contiguous()
        states, outputs = adjoint.dynamics.simulate(theta, x0, controls, dt, threads=threads())
        ctx.adjoint, ctx.dt = adjoint, dt
        ctx.save_for_backward(theta, controls, states)
        return states, outputs

    @staticmethod
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        if torch.is_grad_enabled():  # a second derivative would lack this part where there are others
            raise InputError("free run", "create_graph", "is True", "False: free runs have first derivatives alone")
        theta, controls, states = ctx.saved_tensors
        by_states, by_outputs = grad_outputs
        by_x0, by_controls, by_theta = ctx.adjoint.pull(theta, controls, states, (by_states, by_outputs), ctx.dt)
        return None, by_theta, by_x0, by_controls, None
