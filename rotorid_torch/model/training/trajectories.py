"""Trajectories of a model with gradients: native code and its discrete adjoint, torch where that cannot be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from rotorid_torch.core.integrate import simulate
from rotorid_torch.core.native.adjoint import Adjoint, trajectories
from rotorid_torch.core.native.build import compiled_or_none
from rotorid_torch.core.native.dynamics import Dynamics

Motion = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""(theta [P], x [..., nx], u [..., nu]) -> rates [..., nx], outputs [..., ny]."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Motion over time; `compiled` is None where native code does not know it."""

    motion: Motion
    compiled: Adjoint | None

    @classmethod
    def of(cls, motion: Motion, theta: Tensor, x: Tensor, u: Tensor) -> Trajectories:
        """Trace and compile at a state [nx] and controls [nu], or say once why that cannot be."""

        def adjoint() -> Adjoint:
            compiled = Adjoint(Dynamics.of(lambda x, u, theta: motion(theta, x, u), x, u, theta.detach()))
            compiled.build()
            return compiled

        slow = "free runs are differentiated in torch, many times slower than compiled"
        return cls(motion, compiled_or_none(adjoint, slow, theta))

    def __call__(self, theta: Tensor, x0: Tensor, controls: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """States [B, T, nx] and outputs [B, T, ny] from x0 [B, nx] under controls [B, T, nu]."""
        if self.compiled is not None:
            return trajectories(self.compiled, theta, x0, controls, dt)
        states = simulate(lambda t, x, u: self.motion(theta, x, u)[0], x0, controls, dt)
        return states, self.motion(theta, states, controls)[1]
